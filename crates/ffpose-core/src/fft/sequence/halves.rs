//! Real lines of even length: even and odd points as real and imaginary part of a complex line of half the length.
//!
//! Of `2 M` points let `X` be the spectrum and `Z` that of the complex line. With `θ = πk / M` and `κ = cos θ / (1 + sin θ)`,
//!
//! ```text
//! U = Z(M - k) + κ i conj Z(k)
//! V = Z(k) - κ i conj Z(M - k)
//! ```
//!
//! are the conjugates of `X(k)` and `X(M - k)`, each but for a number of modulus `sqrt(1 + κ²)`, whose phase matters neither to a
//! product with a weight nor to its gradient. The same rotation of `U` and `V` leads back, times `1 + κ²`, by which packed factors
//! are divided. To take the spectra of even and odd points apart and to join them would take three times as many operations; to
//! multiply without coming to `X`, as many as this, with errors relative to the larger of the two bins.

use ndarray::{ArrayView3, ArrayViewMut3};

use crate::fft::codelets::root;
use crate::fft::transform::Transform;
use crate::kernel::Factor;
use crate::simd::{
    Algorithm, Complex, Element, Isa, Tile, TileMut, Vector, complex_vectors, complex_vectors_of,
};
use crate::tuning::{PLACES_AHEAD, SEQUENCE_VECTORS};

/// The plan for real lines of one even length.
pub(super) struct Halves<T> {
    isa: Isa,
    transform: Transform<T>,
    /// `κ` and `1 / (1 + κ²)` for each `k`.
    twiddles: Vec<[T; 2]>,
    /// What a factor is multiplied by, and a gradient, too, unless its bin is its own mirror.
    norm: T,
}

impl<T: Element> Halves<T> {
    pub(super) fn new(isa: Isa, length: usize) -> Self {
        let twiddle = |k| {
            let (cos, sin) = root(k, length);
            [T::nearest(cos / (1.0 + sin)), T::nearest(0.5 + 0.5 * sin)]
        };
        Self {
            isa,
            transform: Transform::new(isa, length / 2),
            twiddles: (0..=length / 4).map(twiddle).collect(),
            norm: T::nearest(2.0 / length as f64),
        }
    }

    pub(super) fn transform(&self) -> &Transform<T> {
        &self.transform
    }

    /// Complex vectors from one line to the next, an odd number.
    pub(super) fn pitch(&self) -> usize {
        self.transform.len() | 1
    }

    /// Numbers of a packed factor, and of a gradient's sum.
    pub(super) fn packed_len(&self) -> usize {
        self.numbers(2 * self.twiddles.len())
    }

    pub(super) fn work_len(&self) -> usize {
        self.numbers(self.transform.work_len())
    }

    /// Numbers in complex vectors.
    fn numbers(&self, vectors: usize) -> usize {
        2 * self.isa.lanes::<T>() * vectors
    }

    /// A factor made of `weight` `(bins, lanes, 2)`, of one vector or more, to `packed`, one vector of lanes after the other.
    pub(super) fn pack(&self, weight: ArrayView3<'_, T>, factor: Factor, packed: &mut [T]) {
        let weight = Tile::of_complex(weight);
        self.isa.run(Pack { plan: self, weight, factor, packed });
    }

    /// As [`crate::kernel::Kernel::unpack_gradient`], for one vector or more.
    pub(super) fn unpack(&self, sum: &[T], gradient: ArrayViewMut3<'_, T>) {
        let gradient = TileMut::of_complex(gradient);
        self.isa.run(Unpack { plan: self, sum, gradient });
    }

    /// The lines times a packed factor.
    pub(super) fn filter(&self, lines: &mut [T], factor: &[T], work: &mut [T]) {
        let lines = lines.chunks_exact_mut(self.numbers(self.pitch()));
        for (line, factor) in lines.zip(factor.chunks_exact(self.packed_len())) {
            let line = &mut line[..self.numbers(self.transform.len())];
            self.transform.forward(line, work);
            self.isa.run(Product { plan: self, line, factor });
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
        for (i, ((grad, x), sum)) in lines.zip(sum.chunks_exact_mut(self.packed_len())).enumerate()
        {
            let (grad, x) = (&mut grad[..line], &mut x[..line]);
            self.transform.forward(x, work);
            self.transform.forward(grad, work);
            self.isa.run(Accumulate { plan: self, grad, x, sum });
            if let Some(factor) = factor {
                let factor = &factor[i * self.packed_len()..][..self.packed_len()];
                self.isa.run(Product { plan: self, line: grad, factor });
                self.transform.inverse(grad, work);
            }
        }
    }

    /// The positions of `Z(k)` and `Z(M - k)`, and `κ`, for each `k`.
    #[inline(always)]
    fn pairs(&self) -> impl Iterator<Item = ((usize, usize), T)> {
        let outputs = self.transform.outputs();
        let mirrors = std::iter::once(&outputs[0]).chain(outputs.iter().rev());
        let positions = outputs.iter().copied().zip(mirrors.copied());
        positions.zip(self.twiddles.iter().map(|twiddle| twiddle[0]))
    }
}

/// `U` and `V` from `Z(k)` and `Z(M - k)`; or these, `1 + κ²` times, from `U` and `V`.
#[inline(always)]
fn rotated<V: Vector>(z: Complex<V>, mirror: Complex<V>, kappa: V) -> [Complex<V>; 2] {
    [z.swap().scale_add(kappa, mirror), mirror.swap().neg_scale_add(kappa, z)]
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
        let Halves { twiddles, transform, norm, .. } = self.plan;
        let half = transform.len();
        let packed = complex_vectors::<V>(self.packed);
        let weights: [_; SEQUENCE_VECTORS] = self.weight.parts(2 * V::LANES);
        for (k, twiddle) in twiddles.iter().enumerate() {
            let norm = V::splat(*norm * twiddle[1]);
            let im_norm = match self.factor {
                _ if k == 0 => V::splat(T::default()),
                Factor::Weight => -norm,
                Factor::Conjugate => norm,
            };
            for (weight, packed) in weights.iter().zip(packed.chunks_exact_mut(2 * twiddles.len()))
            {
                weight.prefetch_complex::<V>(half.saturating_sub(k + PLACES_AHEAD));
                for (to, bin) in packed[2 * k..].iter_mut().zip([k, half - k]) {
                    let w = weight.complex::<V>(bin);
                    *to = Complex::new(w.re * norm, w.im * im_norm);
                }
            }
        }
    }
}

struct Unpack<'a, T> {
    plan: &'a Halves<T>,
    sum: &'a [T],
    gradient: TileMut<'a, T>,
}

impl<T: Element> Algorithm<T> for Unpack<'_, T> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(mut self) {
        let Halves { twiddles, transform, norm, .. } = self.plan;
        let half = transform.len();
        let sums = complex_vectors_of::<V>(self.sum);
        let mut gradients: [_; SEQUENCE_VECTORS] = self.gradient.parts(2 * V::LANES);
        for (k, twiddle) in twiddles.iter().enumerate() {
            let norm = *norm * twiddle[1];
            let (norm, im_norm) = match k {
                0 => (V::splat(norm * T::nearest(0.5)), V::splat(T::default())),
                _ => (V::splat(norm), -V::splat(norm)),
            };
            for (gradient, sums) in gradients.iter_mut().zip(sums.chunks_exact(2 * twiddles.len()))
            {
                for (sum, bin) in sums[2 * k..].iter().zip([k, half - k]) {
                    gradient.set_complex(bin, Complex::new(sum.re * norm, sum.im * im_norm));
                }
            }
        }
    }
}

struct Product<'a, T> {
    plan: &'a Halves<T>,
    line: &'a mut [T],
    factor: &'a [T],
}

impl<T: Element> Algorithm<T> for Product<'_, T> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let line = complex_vectors::<V>(self.line);
        let (factors, _) = complex_vectors_of::<V>(self.factor).as_chunks::<2>();
        for (((position, opposite), kappa), factors) in self.plan.pairs().zip(factors) {
            let kappa = V::splat(kappa);
            let [u, v] = rotated(line[position], line[opposite], kappa);
            let (u, v) = (u.times(factors[0]), v.times(factors[1]));
            let [z, mirror] = rotated(u, v, kappa);
            line[position] = z;
            line[opposite] = mirror;
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
        let (grad, x) = (complex_vectors_of::<V>(self.grad), complex_vectors_of::<V>(self.x));
        let (sums, _) = complex_vectors::<V>(self.sum).as_chunks_mut::<2>();
        for (((position, opposite), kappa), sums) in self.plan.pairs().zip(sums) {
            let kappa = V::splat(kappa);
            let g = rotated(grad[position], grad[opposite], kappa);
            let x = rotated(x[position], x[opposite], kappa);
            for i in 0..2 {
                sums[i] = sums[i].plus_times_conj(g[i], x[i]);
            }
        }
    }
}
