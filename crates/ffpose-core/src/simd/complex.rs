//! Complex numbers of two vectors.

use std::ops::{Add, Sub};

use super::{Element, Vector};

/// `LANES` complex numbers, or one, if `V` is an element.
#[derive(Clone, Copy)]
#[repr(C)]
pub(crate) struct Complex<V> {
    pub(crate) re: V,
    pub(crate) im: V,
}

impl<V> Complex<V> {
    #[inline(always)]
    pub(crate) const fn new(re: V, im: V) -> Self
    where
        V: Copy,
    {
        Self { re, im }
    }
}

impl<T: Element> Complex<T> {
    /// The same number in every lane.
    #[inline(always)]
    pub(crate) fn splat<V: Vector<Element = T>>(self) -> Complex<V> {
        Complex::new(V::splat(self.re), V::splat(self.im))
    }
}

impl<V: Vector> Complex<V> {
    #[inline(always)]
    pub(crate) fn zero() -> Self {
        Complex::new(V::Element::default(), V::Element::default()).splat()
    }

    #[inline(always)]
    pub(crate) fn conj(self) -> Self {
        Self::new(self.re, -self.im)
    }

    /// Real and imaginary part exchanged: `i * conj(self)`.
    #[inline(always)]
    pub(crate) fn swap(self) -> Self {
        Self::new(self.im, self.re)
    }

    /// `self - i * other`
    #[inline(always)]
    pub(crate) fn sub_i(self, other: Self) -> Self {
        Self::new(self.re + other.im, self.im - other.re)
    }

    /// `self + i * other`
    #[inline(always)]
    pub(crate) fn add_i(self, other: Self) -> Self {
        Self::new(self.re - other.im, self.im + other.re)
    }

    #[inline(always)]
    pub(crate) fn scale(self, by: V) -> Self {
        Self::new(self.re * by, self.im * by)
    }

    /// `self * by + c` for a real `by`
    #[inline(always)]
    pub(crate) fn scale_add(self, by: V, c: Self) -> Self {
        Self::new(self.re.mul_add(by, c.re), self.im.mul_add(by, c.im))
    }

    /// `c - self * by` for a real `by`
    #[inline(always)]
    pub(crate) fn neg_scale_add(self, by: V, c: Self) -> Self {
        Self::new(self.re.neg_mul_add(by, c.re), self.im.neg_mul_add(by, c.im))
    }

    /// `self * w`
    #[inline(always)]
    pub(crate) fn times(self, w: Self) -> Self {
        Self::new(self.im.neg_mul_add(w.im, self.re * w.re), self.re.mul_add(w.im, self.im * w.re))
    }

    /// `self + b * w`
    #[inline(always)]
    pub(crate) fn plus_times(self, b: Self, w: Self) -> Self {
        Self::new(
            b.im.neg_mul_add(w.im, b.re.mul_add(w.re, self.re)),
            b.re.mul_add(w.im, b.im.mul_add(w.re, self.im)),
        )
    }

    /// `self + b * conj(w)`
    #[inline(always)]
    pub(crate) fn plus_times_conj(self, b: Self, w: Self) -> Self {
        Self::new(
            b.im.mul_add(w.im, b.re.mul_add(w.re, self.re)),
            b.re.neg_mul_add(w.im, b.im.mul_add(w.re, self.im)),
        )
    }

    /// `self - i * b * w`
    #[inline(always)]
    pub(crate) fn minus_i_times(self, b: Self, w: Self) -> Self {
        Self::new(
            b.re.mul_add(w.im, b.im.mul_add(w.re, self.re)),
            b.im.mul_add(w.im, b.re.neg_mul_add(w.re, self.im)),
        )
    }

    /// `self - difference` from `sum`, which is `self + difference`: with one instruction for each part, where the product that
    /// `difference` may be would have to be made anew.
    #[inline(always)]
    pub(crate) fn mirrored(self, sum: Self) -> Self {
        Self::new(mirrored(self.re, sum.re), mirrored(self.im, sum.im))
    }

    /// `self * conj(w)`
    #[inline(always)]
    pub(crate) fn times_conj(self, w: Self) -> Self {
        Self::new(self.im.mul_add(w.im, self.re * w.re), self.re.neg_mul_add(w.im, self.im * w.re))
    }
}

impl<V: Vector> Add for Complex<V> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self::new(self.re + other.re, self.im + other.im)
    }
}

impl<V: Vector> Sub for Complex<V> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self::new(self.re - other.re, self.im - other.im)
    }
}

/// `a - b` from `a + b`, where `b` need not be known by itself.
#[inline(always)]
pub(crate) fn mirrored<V: Vector>(a: V, sum: V) -> V {
    a.mul_sub(V::splat(V::Element::nearest(2.0)), sum)
}

/// The real and the imaginary parts of complex vectors.
#[inline(always)]
pub(crate) fn parts<V: Vector, const N: usize>(z: [Complex<V>; N]) -> ([V; N], [V; N]) {
    let (mut re, mut im) = ([z[0].re; N], [z[0].im; N]);
    for n in 0..N {
        (re[n], im[n]) = (z[n].re, z[n].im);
    }
    (re, im)
}

/// Undoes [`parts`].
#[inline(always)]
pub(crate) fn joined<V: Vector, const N: usize>(re: [V; N], im: [V; N]) -> [Complex<V>; N] {
    let mut z = [Complex::new(re[0], im[0]); N];
    for n in 0..N {
        z[n] = Complex::new(re[n], im[n]);
    }
    z
}
