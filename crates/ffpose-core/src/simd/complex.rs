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
