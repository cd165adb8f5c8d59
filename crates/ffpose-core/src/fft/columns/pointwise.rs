//! What is done with a spectrum between a transform and its inverse.

use super::order::BinOrder;
use crate::kernel::Factor;
use crate::simd::{Complex, Element, Tile, TileMut, Vector};

/// Where the first of some vectors of one column is.
#[derive(Clone, Copy)]
pub(crate) struct At {
    /// Which of the vectors of lanes that go together.
    pub(crate) vector: usize,
    /// The number of the complex vector in the spectra of all of them.
    pub(crate) position: usize,
    /// Its place in the weight of one vector of lanes.
    pub(crate) place: usize,
}

impl At {
    /// `count` vectors further.
    #[inline(always)]
    pub(crate) fn plus(self, count: usize) -> Self {
        Self { position: self.position + count, place: self.place + count, ..self }
    }
}

/// A step on complex vectors, in registers.
pub(crate) trait Pointwise<T: Element> {
    /// The new values of the `R` vectors of the spectrum from `at` on.
    fn apply<V: Vector<Element = T>, const R: usize>(
        &mut self,
        at: At,
        spectrum: [Complex<V>; R],
    ) -> [Complex<V>; R];
}

/// Nothing.
impl<T: Element> Pointwise<T> for () {
    #[inline(always)]
    fn apply<V: Vector<Element = T>, const R: usize>(
        &mut self,
        _: At,
        spectrum: [Complex<V>; R],
    ) -> [Complex<V>; R] {
        spectrum
    }
}

/// Both see the same spectrum; the result is the second's, and it goes first. What the first writes often has the same offset in
/// a page as what the second reads, and a read soon after such a write waits for it.
impl<T: Element, A: Pointwise<T>, B: Pointwise<T>> Pointwise<T> for (A, B) {
    #[inline(always)]
    fn apply<V: Vector<Element = T>, const R: usize>(
        &mut self,
        at: At,
        spectrum: [Complex<V>; R],
    ) -> [Complex<V>; R] {
        let result = self.1.apply(at, spectrum);
        self.0.apply(at, spectrum);
        result
    }
}

/// The product with a packed factor.
pub(crate) struct Product<'a, T> {
    pub(crate) factor: Tile<'a, T>,
    /// Places of one vector.
    pub(crate) places: usize,
}

impl<T: Element> Pointwise<T> for Product<'_, T> {
    #[inline(always)]
    fn apply<V: Vector<Element = T>, const R: usize>(
        &mut self,
        at: At,
        mut spectrum: [Complex<V>; R],
    ) -> [Complex<V>; R] {
        let (re, im) = parts::<V, R>(self.factor, at.vector * self.places + at.place);
        for i in 0..R {
            spectrum[i] = spectrum[i].times(Complex::new(re[i], im[i]));
        }
        spectrum
    }
}

/// `sum += conj(x) · spectrum`; the spectrum itself is passed on.
pub(crate) struct Accumulate<'a, T> {
    /// By position.
    pub(crate) x: Tile<'a, T>,
    /// By place, for each vector.
    pub(crate) sum: TileMut<'a, T>,
    /// Places of one vector.
    pub(crate) places: usize,
}

impl<T: Element> Pointwise<T> for Accumulate<'_, T> {
    #[inline(always)]
    fn apply<V: Vector<Element = T>, const R: usize>(
        &mut self,
        at: At,
        spectrum: [Complex<V>; R],
    ) -> [Complex<V>; R] {
        let place = at.vector * self.places + at.place;
        let (x_re, x_im) = parts::<V, R>(self.x, at.position);
        let (mut re, mut im) = parts::<V, R>(self.sum.reader(), place);
        for i in 0..R {
            let g = spectrum[i];
            re[i] = x_im[i].mul_add(g.im, x_re[i].mul_add(g.re, re[i]));
            im[i] = x_im[i].neg_mul_add(g.re, x_re[i].mul_add(g.im, im[i]));
        }
        self.sum.scatter(2 * place, 2, re);
        self.sum.scatter(2 * place + 1, 2, im);
        spectrum
    }
}

/// As [`Product`], with a factor made of a weight in natural order.
pub(crate) struct NaturalProduct<'a, T> {
    pub(crate) order: &'a BinOrder<T>,
    /// Complex numbers, as pairs of real ones.
    pub(crate) weight: Tile<'a, T>,
    pub(crate) factor: Factor,
}

impl<T: Element> Pointwise<T> for NaturalProduct<'_, T> {
    #[inline(always)]
    fn apply<V: Vector<Element = T>, const R: usize>(
        &mut self,
        at: At,
        mut spectrum: [Complex<V>; R],
    ) -> [Complex<V>; R] {
        let weight = self.weight.part(at.vector, 2 * V::LANES);
        self.order.read::<V, R>(weight, self.factor, at.place, &mut spectrum);
        spectrum
    }
}

/// `conj(x) · spectrum` as a gradient in natural order; the spectrum itself is passed on.
pub(crate) struct NaturalGradient<'a, T> {
    pub(crate) order: &'a BinOrder<T>,
    /// By position.
    pub(crate) x: Tile<'a, T>,
    /// Complex numbers, as pairs of real ones.
    pub(crate) gradient: TileMut<'a, T>,
}

impl<T: Element> Pointwise<T> for NaturalGradient<'_, T> {
    #[inline(always)]
    fn apply<V: Vector<Element = T>, const R: usize>(
        &mut self,
        at: At,
        spectrum: [Complex<V>; R],
    ) -> [Complex<V>; R] {
        let (re, im) = parts::<V, R>(self.x, at.position);
        let mut products = spectrum;
        for i in 0..R {
            products[i] = spectrum[i].times_conj(Complex::new(re[i], im[i]));
        }
        let mut gradient = self.gradient.part(at.vector, 2 * V::LANES);
        self.order.write(&mut gradient, at.place, products);
        spectrum
    }
}

/// Real and imaginary parts of complex vectors number `first` and following, in a tile where they are alternate points.
#[inline(always)]
fn parts<V: Vector, const R: usize>(tile: Tile<'_, V::Element>, first: usize) -> ([V; R], [V; R]) {
    (tile.gather(2 * first, 2), tile.gather(2 * first + 1, 2))
}
