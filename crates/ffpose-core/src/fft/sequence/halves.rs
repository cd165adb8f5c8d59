//! Real lines of even length: even and odd points as real and imaginary part of a complex line of half the length.
//!
//! Of `2 M` points let `Z` be the spectrum of the complex line, `Y(k)` the conjugate of `Z(M - k)`, and `W` the factor, with
//! `W(M + k)` the conjugate of `W(M - k)`. To take `Z` apart into the spectra of even and odd points, join these to that of the
//! whole line, multiply and go back is linear in `Z(k)` and `Y(k)`; with `S, D = (W(k) ± W(M + k)) / 2` and `θ = πk / M` it is
//!
//! ```text
//! Z(k) <- (S - D sin θ) Z(k) + i D cos θ Y(k)
//! Y(k) <- (S + D sin θ) Y(k) - i D cos θ Z(k)
//! ```
//!
//! which takes 16 multiplications and additions where the detour takes 28. A packed factor has these three numbers for each pair.

use ndarray::{ArrayView3, ArrayViewMut3};

use crate::fft::codelets::pair::{merge, split};
use crate::fft::codelets::root;
use crate::fft::columns::order::{BinOrder, Bins, Scales};
use crate::fft::transform::Transform;
use crate::kernel::Factor;
use crate::simd::{
    Algorithm, Complex, Element, Isa, Tile, Vector, complex_vectors, complex_vectors_of,
};
use crate::tuning::PLACES_AHEAD;

/// Numbers of a packed factor for each pair of frequencies, and of a gradient's sum.
const FACTORS: usize = 3;
const SUMS: usize = 2;

/// The plan for real lines of one even length.
pub(super) struct Halves<T> {
    isa: Isa,
    transform: Transform<T>,
    /// `exp(-iθ)` for each `k`.
    turns: Vec<Complex<T>>,
    /// What a factor is multiplied by.
    norm: T,
    /// The order of a gradient's sum: `X(0), X(M), X(1), X(M - 1), ...`.
    order: BinOrder<T>,
}

impl<T: Element> Halves<T> {
    pub(super) fn new(isa: Isa, length: usize) -> Self {
        let (half, bins) = (length / 2, Bins { rows: 1, columns: length });
        let turns = (0..=half / 2).map(|k| {
            let (c, s) = root(k, length);
            Complex::new(T::nearest(c), T::nearest(-s))
        });
        let norm = 1.0 / length as f64;
        let ends = vec![bins.with_mirror(0, 0), bins.with_mirror(0, half)];
        let places = (1..=half / 2).flat_map(|k| [bins.of(0, k), bins.of(0, half - k)]);
        // the sum is of spectra that come doubled
        let scales = Scales { hermitian: T::nearest(norm / 4.0), plain: T::nearest(norm / 2.0) };
        Self {
            isa,
            transform: Transform::new(isa, half),
            turns: turns.collect(),
            norm: T::nearest(norm),
            order: BinOrder::new(ends, places.collect(), scales, scales),
        }
    }

    pub(super) fn transform(&self) -> &Transform<T> {
        &self.transform
    }

    /// Complex vectors from one line to the next, an odd number.
    pub(super) fn pitch(&self) -> usize {
        self.transform.len() | 1
    }

    pub(super) fn packed_len(&self) -> usize {
        self.numbers(FACTORS * self.turns.len())
    }

    pub(super) fn sum_len(&self) -> usize {
        self.numbers(SUMS * self.turns.len())
    }

    pub(super) fn work_len(&self) -> usize {
        self.numbers(self.transform.work_len())
    }

    /// Numbers in complex vectors.
    fn numbers(&self, vectors: usize) -> usize {
        2 * self.isa.lanes::<T>() * vectors
    }

    /// A factor made of `weight` `(bins, lanes, 2)`, of whole vectors, to `packed`, one vector of lanes after the other.
    pub(super) fn pack(&self, weight: ArrayView3<'_, T>, factor: Factor, packed: &mut [T]) {
        let weight = Tile::of_complex(weight);
        self.isa.run(Pack { plan: self, weight, factor, packed });
    }

    /// As [`crate::kernel::Kernel::unpack_gradient`], for whole vectors.
    pub(super) fn unpack(&self, sum: &[T], gradient: ArrayViewMut3<'_, T>) {
        self.order.unpack(self.isa, sum, gradient);
    }

    /// The lines times a packed factor.
    pub(super) fn filter(&self, lines: &mut [T], factor: &[T], work: &mut [T]) {
        let lines = lines.chunks_exact_mut(self.numbers(self.pitch()));
        for (line, factor) in lines.zip(factor.chunks_exact(self.packed_len())) {
            let line = &mut line[..self.numbers(self.transform.len())];
            self.transform.forward(line, work);
            self.isa.run(Product { outputs: self.transform.outputs(), line, factor });
            self.transform.inverse(line, work);
        }
    }

    /// `sum += conj(x) · grad`, and `grad · factor` if there is a factor; else `grad` is lost. `x` is transformed.
    pub(super) fn gradient(
        &self,
        grad: &mut [T],
        x: &mut [T],
        factor: Option<&[T]>,
        sum: &mut [T],
        work: &mut [T],
    ) {
        let (pitch, line) = (self.numbers(self.pitch()), self.numbers(self.transform.len()));
        let lines = grad.chunks_exact_mut(pitch).zip(x.chunks_exact_mut(pitch));
        for (i, ((grad, x), sum)) in lines.zip(sum.chunks_exact_mut(self.sum_len())).enumerate() {
            let (grad, x) = (&mut grad[..line], &mut x[..line]);
            self.transform.forward(x, work);
            self.transform.forward(grad, work);
            self.isa.run(Accumulate { plan: self, grad, x, sum });
            if let Some(factor) = factor {
                let factor = &factor[i * self.packed_len()..][..self.packed_len()];
                let outputs = self.transform.outputs();
                self.isa.run(Product { outputs, line: grad, factor });
                self.transform.inverse(grad, work);
            }
        }
    }
}

/// The positions of each frequency up to half of them, and of its mirror.
#[inline(always)]
fn pairs(outputs: &[usize]) -> impl Iterator<Item = (usize, usize)> {
    let mirrors = std::iter::once(&outputs[0]).chain(outputs.iter().rev());
    outputs[..=outputs.len() / 2].iter().copied().zip(mirrors.copied())
}

struct Pack<'a, T> {
    plan: &'a Halves<T>,
    weight: Tile<'a, T>,
    factor: Factor,
    packed: &'a mut [T],
}

impl<T: Element> Algorithm<T> for Pack<'_, T> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let Self { plan: Halves { turns, transform, norm, .. }, weight, factor, packed } = self;
        let (half, norm) = (transform.len(), V::splat(*norm));
        let packed = complex_vectors::<V>(packed);
        for (k, turn) in turns.iter().enumerate() {
            let turn = turn.splat::<V>();
            for (i, packed) in packed.chunks_exact_mut(FACTORS * turns.len()).enumerate() {
                let weight = weight.skip_lanes(2 * i * V::LANES);
                weight.prefetch_complex::<V>(half.saturating_sub(k + PLACES_AHEAD));
                let (mut w, mut mirror) =
                    (weight.complex::<V>(k).scale(norm), weight.complex::<V>(half - k).scale(norm));
                if k == 0 {
                    (w.im, mirror.im) = (Complex::zero().im, Complex::zero().im);
                }
                match factor {
                    Factor::Weight => mirror = mirror.conj(),
                    Factor::Conjugate => w = w.conj(),
                }
                let (sum, difference) = (w + mirror, w - mirror);
                packed[FACTORS * k] = difference.scale_add(turn.im, sum);
                packed[FACTORS * k + 1] = difference.neg_scale_add(turn.im, sum);
                packed[FACTORS * k + 2] = difference.scale(-turn.re);
            }
        }
    }
}

struct Product<'a, T> {
    outputs: &'a [usize],
    line: &'a mut [T],
    factor: &'a [T],
}

impl<T: Element> Algorithm<T> for Product<'_, T> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let line = complex_vectors::<V>(self.line);
        let (factors, _) = complex_vectors_of::<V>(self.factor).as_chunks::<FACTORS>();
        for ((position, opposite), [of_z, of_mirror, across]) in pairs(self.outputs).zip(factors) {
            let (z, mirror) = (line[position], line[opposite]);
            line[position] = z.times(*of_z).minus_i_times(mirror.conj(), *across);
            line[opposite] = mirror.times_conj(*of_mirror).minus_i_times(z.conj(), across.conj());
        }
    }
}

struct Accumulate<'a, T> {
    plan: &'a Halves<T>,
    grad: &'a [T],
    x: &'a [T],
    sum: &'a mut [T],
}

impl<T: Element> Algorithm<T> for Accumulate<'_, T> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let Halves { transform, turns, .. } = self.plan;
        let (grad, x) = (complex_vectors_of::<V>(self.grad), complex_vectors_of::<V>(self.x));
        let (sums, _) = complex_vectors::<V>(self.sum).as_chunks_mut::<SUMS>();
        for (((position, opposite), turn), sums) in pairs(transform.outputs()).zip(turns).zip(sums)
        {
            let turn = turn.splat();
            let g = merge(split(grad[position], grad[opposite]), turn);
            let x = merge(split(x[position], x[opposite]), turn);
            for i in 0..SUMS {
                sums[i] = sums[i].plus_times_conj(g[i], x[i]);
            }
        }
    }
}
