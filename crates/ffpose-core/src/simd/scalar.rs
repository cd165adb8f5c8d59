//! One lane: any machine, and the reference for the other instruction sets.

use std::ops::{Add, Mul, Neg, Sub};

use super::{Element, Vector};

#[derive(Clone, Copy)]
#[repr(transparent)]
pub(crate) struct Scalar<T>(T);

macro_rules! operator {
    ($trait:ident, $method:ident) => {
        impl<T: Element> $trait for Scalar<T> {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                Self(self.0.$method(other.0))
            }
        }
    };
}
operator!(Add, add);
operator!(Sub, sub);
operator!(Mul, mul);

impl<T: Element + Neg<Output = T>> Neg for Scalar<T> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self(-self.0)
    }
}

/// `mul_add` rounds twice: without the instruction a fused one is a call of the C library, a hundred times slower.
// SAFETY: a float is one element, which loads and stores move.
unsafe impl<T: Element + Neg<Output = T>> Vector for Scalar<T> {
    type Element = T;
    const LANES: usize = 1;

    #[inline(always)]
    fn splat(x: T) -> Self {
        Self(x)
    }

    #[inline(always)]
    fn mul_add(self, b: Self, c: Self) -> Self {
        self * b + c
    }

    #[inline(always)]
    fn neg_mul_add(self, b: Self, c: Self) -> Self {
        c - self * b
    }

    #[inline(always)]
    fn mul_sub(self, b: Self, c: Self) -> Self {
        self * b - c
    }

    #[inline(always)]
    unsafe fn load(from: *const T) -> Self {
        // SAFETY: the caller promises one readable element.
        Self(unsafe { *from })
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut T) {
        // SAFETY: the caller promises one writable element.
        unsafe { *to = self.0 }
    }

    #[inline(always)]
    fn interleave(a: Self, b: Self) -> (Self, Self) {
        (a, b)
    }

    #[inline(always)]
    fn deinterleave(low: Self, high: Self) -> (Self, Self) {
        (low, high)
    }

    #[inline(always)]
    fn reverse(self) -> Self {
        self
    }

    #[inline(always)]
    fn exchange_halves(a: Self, b: Self) -> (Self, Self) {
        (a, b)
    }

    #[inline(always)]
    fn transpose_in_halves(_: &mut [Self]) {}
}
