//! A weight in natural order to kernel order, and a gradient back.
//!
//! Every place of kernel order is one bin of the half spectrum, or the conjugate of the mirrored bin, times a real number. In
//! columns that a real inverse transform makes Hermitian (DC and Nyquist) it is the mean of the two.

use ndarray::{ArrayView3, ArrayViewMut3};

use crate::kernel::Factor;
use crate::simd::{Algorithm, Complex, Element, Isa, Tile, TileMut, Vector};
use crate::tuning::PLACES_AHEAD;

/// Where the places of kernel order come from.
pub(crate) struct BinOrder<T> {
    /// Places of the first column: the bin and its mirror.
    pub(crate) hermitian: Vec<(usize, usize)>,
    /// Places of all others: the bin, and whether it is conjugated.
    pub(crate) others: Vec<(usize, bool)>,
    pub(crate) weight: Scales<T>,
    pub(crate) gradient: Scales<T>,
}

/// What bins are multiplied by.
#[derive(Clone, Copy)]
pub(crate) struct Scales<T> {
    /// In the columns of DC and Nyquist.
    pub(crate) hermitian: T,
    pub(crate) plain: T,
}

/// A frequency of the full spectrum `(rows, columns)` as a bin of the half spectrum `(rows, columns / 2 + 1)`.
#[derive(Clone, Copy)]
pub(crate) struct Bins {
    pub(crate) rows: usize,
    pub(crate) columns: usize,
}

impl Bins {
    /// The bin of row frequency `u` and column frequency `v`, at most `columns / 2`, and its mirror in `u`.
    pub(crate) fn with_mirror(self, u: usize, v: usize) -> (usize, usize) {
        let half = self.columns / 2 + 1;
        (u * half + v, (self.rows - u) % self.rows * half + v)
    }

    /// The bin that holds the frequency or its conjugate, and which.
    pub(crate) fn of(self, u: usize, v: usize) -> (usize, bool) {
        if v <= self.columns / 2 {
            (self.with_mirror(u, v).0, false)
        } else {
            (self.with_mirror(u, self.columns - v).1, true)
        }
    }
}

impl<T: Element> BinOrder<T> {
    /// Numbers in a packed weight of one vector of lanes.
    fn packed_len(&self, lanes: usize) -> usize {
        2 * lanes * self.places()
    }

    fn places(&self) -> usize {
        self.hermitian.len() + self.others.len()
    }

    /// Gives `to`, in turn, the factor at `R` places of one column, `first` and following, from a weight in natural order.
    #[inline(always)]
    pub(crate) fn read<V: Vector<Element = T>, const R: usize>(
        &self,
        weight: Tile<'_, T>,
        factor: Factor,
        first: usize,
        to: &mut impl Factors<V>,
    ) {
        let conjugate = factor == Factor::Conjugate;
        if let Some(first) = first.checked_sub(self.hermitian.len()) {
            let scale = V::splat(self.weight.plain);
            let places = &self.others[first..first + R];
            let im_scale = if places[0].1 == conjugate { scale } else { -scale };
            for i in 0..R {
                let z = weight.complex::<V>(places[i].0);
                to.take(i, Complex::new(z.re * scale, z.im * im_scale));
            }
        } else {
            let mean = V::splat(self.weight.hermitian);
            let im_mean = if conjugate { -mean } else { mean };
            let places = &self.hermitian[first..first + R];
            for i in 0..R {
                let (bin, mirror) = places[i];
                let (z, mirror) = (weight.complex::<V>(bin), weight.complex::<V>(mirror));
                to.take(i, Complex::new((z.re + mirror.re) * mean, (z.im - mirror.im) * im_mean));
            }
        }
    }

    /// Asks for the weight of a place behind those of the first column: bins are far apart and in no order, so that no processor
    /// guesses them.
    #[inline(always)]
    pub(crate) fn prefetch<V: Vector<Element = T>>(&self, weight: Tile<'_, T>, place: usize) {
        if let Some(&(bin, _)) = self.others.get(place.wrapping_sub(self.hermitian.len())) {
            weight.prefetch_complex::<V>(bin);
        }
    }

    /// The sums of places `first` and following of one column as a gradient in natural order.
    #[inline(always)]
    pub(crate) fn write<V: Vector<Element = T>, const R: usize>(
        &self,
        gradient: &mut TileMut<'_, T>,
        first: usize,
        sums: [Complex<V>; R],
    ) {
        if let Some(first) = first.checked_sub(self.hermitian.len()) {
            let scale = V::splat(self.gradient.plain);
            let places = &self.others[first..first + R];
            let im_scale = if places[0].1 { -scale } else { scale };
            for i in 0..R {
                let z = Complex::new(sums[i].re * scale, sums[i].im * im_scale);
                gradient.set_complex(places[i].0, z);
            }
        } else {
            let scale = V::splat(self.gradient.hermitian);
            let places = &self.hermitian[first..first + R];
            for i in 0..R {
                let ((bin, mirror), z) = (places[i], sums[i].scale(scale));
                gradient.set_complex(mirror, z.conj());
                gradient.set_complex(bin, z);
            }
        }
    }

    /// A factor made of `weight` `(bins, lanes, 2)`, of one vector or more, to `packed`, one vector of lanes after the other.
    pub(crate) fn pack(
        &self,
        isa: Isa,
        weight: ArrayView3<'_, T>,
        factor: Factor,
        packed: &mut [T],
    ) {
        isa.run(PackLanes { order: self, weight: Tile::of_complex(weight), factor, packed });
    }

    /// `sum`, packed, to `gradient` `(bins, lanes, 2)`, of one vector or more.
    pub(crate) fn unpack(&self, isa: Isa, sum: &[T], gradient: ArrayViewMut3<'_, T>) {
        isa.run(UnpackLanes { order: self, sum, gradient: TileMut::of_complex(gradient) });
    }
}

/// Receives the factors of successive places. A trait, since compilers do not inline every closure.
pub(crate) trait Factors<V> {
    fn take(&mut self, i: usize, factor: Complex<V>);
}

/// A spectrum is multiplied.
impl<V: Vector, const R: usize> Factors<V> for [Complex<V>; R] {
    #[inline(always)]
    fn take(&mut self, i: usize, factor: Complex<V>) {
        self[i] = self[i].times(factor);
    }
}

/// Real and imaginary part are written, one point after the other.
impl<V: Vector> Factors<V> for TileMut<'_, V::Element> {
    #[inline(always)]
    fn take(&mut self, i: usize, factor: Complex<V>) {
        self.scatter::<V, 2>(2 * i, 1, [factor.re, factor.im]);
    }
}

struct PackLanes<'a, T> {
    order: &'a BinOrder<T>,
    weight: Tile<'a, T>,
    factor: Factor,
    packed: &'a mut [T],
}

/// All lanes of a bin, then the next bin: whole runs of memory.
impl<T: Element> Algorithm<T> for PackLanes<'_, T> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let len = self.order.packed_len(V::LANES);
        for place in 0..self.order.places() {
            for (i, packed) in self.packed.chunks_exact_mut(len).enumerate() {
                let weight = self.weight.part(i, 2 * V::LANES);
                self.order.prefetch::<V>(weight, place + PLACES_AHEAD);
                let mut packed = TileMut::dense(packed, 2 * V::LANES);
                self.order.read::<V, 1>(
                    weight,
                    self.factor,
                    place,
                    &mut packed.point(place, V::LANES),
                );
            }
        }
    }
}

struct UnpackLanes<'a, T> {
    order: &'a BinOrder<T>,
    sum: &'a [T],
    gradient: TileMut<'a, T>,
}

impl<T: Element> Algorithm<T> for UnpackLanes<'_, T> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(mut self) {
        let sums = self.sum.chunks_exact(self.order.packed_len(V::LANES));
        for place in 0..self.order.places() {
            for (i, sum) in sums.clone().enumerate() {
                let [re, im] = Tile::dense(sum, V::LANES).gather::<V, 2>(2 * place, 1);
                let mut gradient = self.gradient.part(i, 2 * V::LANES);
                self.order.write(&mut gradient, place, [Complex::new(re, im)]);
            }
        }
    }
}
