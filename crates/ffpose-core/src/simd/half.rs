//! Half precision: conversion to `f32` and back, of single elements and of vectors as they are loaded and stored.
//!
//! Kernels compute in `f32` and `f64`. A result in half precision is rounded once, to nearest and ties to even.

use bytemuck::{Pod, Zeroable};

use super::{Algorithm, Element, Vector};

/// bfloat16: the upper half of an `f32`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(transparent)]
pub struct Bf16(pub u16);

/// float16: IEEE's binary16.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(transparent)]
pub struct F16(pub u16);

// SAFETY: it is a `u16`, in which all bits zero are a value.
unsafe impl Zeroable for Bf16 {}
// SAFETY: it is a `u16`: any bits are a value, there is no padding and no pointer.
unsafe impl Pod for Bf16 {}
// SAFETY: as above.
unsafe impl Zeroable for F16 {}
// SAFETY: as above.
unsafe impl Pod for F16 {}

/// An element in memory that vectors are loaded from: that of the vectors, or one of half their precision.
pub trait Stored: Pod + Send + Sync {
    /// The elements of the vectors.
    type Real: Element;

    /// Whether it has half the precision of `Real`.
    const HALF: bool = size_of::<Self>() < size_of::<Self::Real>();

    /// The same value as an element of a vector.
    fn widened(self) -> Self::Real;

    /// The value of this type nearest to `value`, the even one of two that are as near.
    fn nearest_to(value: Self::Real) -> Self;

    /// # Safety
    /// `LANES` elements are readable at `from`.
    #[doc(hidden)]
    #[allow(private_bounds)] // vectors are this crate's alone
    unsafe fn load<V: Vector<Element = Self::Real>>(from: *const Self) -> V;

    /// # Safety
    /// `LANES` elements are writable at `to`.
    #[doc(hidden)]
    #[allow(private_bounds)] // as above
    unsafe fn store<V: Vector<Element = Self::Real>>(vector: V, to: *mut Self);
}

/// How vectors are loaded and stored, by the methods of [`Vector`].
macro_rules! moved_by {
    ($load:ident, $store:ident) => {
        #[inline(always)]
        #[allow(private_bounds)] // as above
        unsafe fn load<V: Vector<Element = Self::Real>>(from: *const Self) -> V {
            // SAFETY: the caller promises the elements.
            unsafe { V::$load(from) }
        }

        #[inline(always)]
        #[allow(private_bounds)] // as above
        unsafe fn store<V: Vector<Element = Self::Real>>(vector: V, to: *mut Self) {
            // SAFETY: the caller promises the elements.
            unsafe { vector.$store(to) }
        }
    };
}

macro_rules! stored_as_it_is {
    ($real:ty) => {
        impl Stored for $real {
            type Real = Self;

            #[inline(always)]
            fn widened(self) -> Self {
                self
            }

            #[inline(always)]
            fn nearest_to(value: Self) -> Self {
                value
            }

            moved_by!(load, store);
        }
    };
}

stored_as_it_is!(f32);
stored_as_it_is!(f64);

impl Stored for Bf16 {
    type Real = f32;

    #[inline(always)]
    fn widened(self) -> f32 {
        f32::from_bits(u32::from(self.0) << 16)
    }

    #[inline(always)]
    fn nearest_to(value: f32) -> Self {
        let bits = value.to_bits();
        let rounded = bits.wrapping_add(0x7fff + (bits >> 16 & 1));
        // rounding could carry a NaN over to infinity
        Self(upper_half(if value.is_nan() { f32::NAN.to_bits() } else { rounded }))
    }

    moved_by!(load_bf16, store_bf16);
}

impl Stored for F16 {
    type Real = f32;

    /// The bits of both formats stand alike but for the bias of the exponent. No step has a subnormal `f32`, which a processor
    /// may be told to take for zero.
    #[inline(always)]
    fn widened(self) -> f32 {
        let bits = u32::from(self.0);
        let shifted = (bits & 0x7fff) << 13;
        let least = f32::from_bits(0x3880_0000); // 2^-14, the smallest normal number
        let tiny = f32::from_bits(shifted | least.to_bits()) - least;
        let size = match shifted {
            0..0x0080_0000 => tiny.to_bits(),
            0x0080_0000..0x0f80_0000 => shifted + (112 << 23),
            _ => shifted | 0x7f80_0000,
        };
        f32::from_bits(size | (bits & 0x8000) << 16)
    }

    /// Below the smallest normal number a sum rounds at the right place, and above it integers do.
    #[inline(always)]
    fn nearest_to(value: f32) -> Self {
        let bits = value.to_bits();
        let size = bits & 0x7fff_ffff;
        let tiny = (f32::from_bits(size) + 0.5).to_bits().wrapping_sub(0.5_f32.to_bits()) << 16;
        let normal = size.wrapping_add(0xc800_0fff + (size >> 13 & 1)) << 3;
        let infinite = if size > 0x7f80_0000 { 0x7e00_0000 } else { 0x7c00_0000 };
        let rounded = match size {
            0..0x3880_0000 => tiny,             // below 2^-14
            0x3880_0000..0x4780_0000 => normal, // below 2^16; what rounds up to that is infinity's bits
            _ => infinite,
        };
        Self(upper_half(rounded | bits & 0x8000_0000))
    }

    moved_by!(load_f16, store_f16);
}

#[inline(always)]
#[allow(clippy::cast_possible_truncation)] // the upper bits are shifted out of the way
fn upper_half(bits: u32) -> u16 {
    (bits >> 16) as u16
}

/// Elements as those of another type, rounded, as many.
pub(crate) struct Convert<'a, A, B>(pub(crate) &'a [A], pub(crate) &'a mut [B]);

impl<A: Stored, B: Stored<Real = A::Real>> Algorithm<A::Real> for Convert<'_, A, B> {
    #[inline(always)]
    fn run<V: Vector<Element = A::Real>>(self) {
        let Self(from, to) = self;
        assert_eq!(from.len(), to.len());
        let whole = from.len() - from.len() % V::LANES;
        for first in (0..whole).step_by(V::LANES) {
            // SAFETY: `LANES` elements follow in both, which are as long (checked above).
            unsafe { B::store(A::load::<V>(from.as_ptr().add(first)), to.as_mut_ptr().add(first)) };
        }
        for (from, to) in from[whole..].iter().zip(&mut to[whole..]) {
            *to = B::nearest_to(from.widened());
        }
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // values of halves are exact
mod tests {
    use super::*;
    use crate::Isa;

    /// The value of a half by its definition: sign, exponent and fraction of so many bits.
    fn by_definition(bits: u16, exponent_bits: u32, fraction_bits: u32) -> f64 {
        let bits = u32::from(bits);
        let fraction = f64::from(bits & ((1 << fraction_bits) - 1)) / f64::from(1 << fraction_bits);
        let exponent = (bits >> fraction_bits & ((1 << exponent_bits) - 1)).cast_signed();
        let bias = (1 << (exponent_bits - 1)) - 1;
        let size = match exponent {
            0 => fraction * 2_f64.powi(1 - bias),
            e if e == (1 << exponent_bits) - 1 => {
                if fraction == 0.0 {
                    f64::INFINITY
                } else {
                    f64::NAN
                }
            }
            e => (1.0 + fraction) * 2_f64.powi(e - bias),
        };
        if bits >> 15 == 1 { -size } else { size }
    }

    fn widens_every_value<H: Stored<Real = f32>>(half: impl Fn(u16) -> H, exponent_bits: u32) {
        for bits in 0..=u16::MAX {
            let expected = by_definition(bits, exponent_bits, 15 - exponent_bits);
            let value = half(bits).widened();
            assert!(f64::from(value) == expected || value.is_nan() && expected.is_nan(), "{bits}");
            let back = H::nearest_to(value).widened();
            assert!(back.to_bits() == value.to_bits() || value.is_nan() && back.is_nan(), "{bits}");
        }
    }

    /// Midpoints go to the even neighbor, and what is next to them to the nearer.
    fn rounds_between_all_neighbors<H: Stored<Real = f32> + PartialEq + std::fmt::Debug>(
        half: impl Fn(u16) -> H,
        largest: u16,
    ) {
        for bits in 0..largest {
            let (below, above) = (half(bits), half(bits + 1));
            let middle = below.widened().midpoint(above.widened());
            let even = if bits % 2 == 0 { below } else { above };
            assert_eq!(H::nearest_to(middle), even, "{bits}");
            assert_eq!(H::nearest_to(middle.next_down()), below, "{bits}");
            assert_eq!(H::nearest_to(middle.next_up()), above, "{bits}");
            assert_eq!(H::nearest_to(-middle.next_up()).widened(), -above.widened(), "{bits}");
        }
    }

    /// Every value, its neighbors in single precision and the midpoints, in vectors as one by one.
    fn vectors_convert_as_numbers_do<H: Stored<Real = f32>>(half: impl Fn(u16) -> H) {
        let halves: Vec<_> = (0..=u16::MAX).chain([7; 5]).map(&half).collect(); // five: no whole vector
        let mut wide = vec![0.0_f32; halves.len()];
        for isa in Isa::available().into_iter().filter(|isa| isa.has_vectors::<f32>()) {
            isa.run(Convert(&halves, &mut wide));
            for (&half, &wide) in halves.iter().zip(&wide) {
                let one = half.widened();
                assert!(one.to_bits() == wide.to_bits() || one.is_nan() && wide.is_nan());
            }
            let near = |pair: &[f32]| {
                let middle = pair[0].midpoint(pair[1]);
                [pair[0], pair[0].next_up(), middle.next_down(), middle, middle.next_up()]
            };
            // what rounding would carry over to infinity or to zero
            let nans = [0x7f80_0001, 0x7fff_ffff, 0xff80_0001, 0xffff_ffff].map(f32::from_bits);
            let infinite = [65_520.0, -65_520.0, 65_519.996, -65_519.996, f32::MAX]; // or just not
            let any = (0..=u32::MAX).step_by(65_521).map(f32::from_bits); // a prime: all bits vary
            let numbers = wide.windows(2).flat_map(near).chain(nans.repeat(9)).chain(infinite);
            let numbers: Vec<_> = numbers.chain(any).collect();
            let mut narrowed = vec![half(0); numbers.len()];
            isa.run(Convert(&numbers, &mut narrowed));
            for (&number, narrowed) in numbers.iter().zip(&narrowed) {
                let (one, narrowed) = (H::nearest_to(number).widened(), narrowed.widened());
                assert_eq!(one.is_nan(), number.is_nan());
                assert!(one.to_bits() == narrowed.to_bits() || one.is_nan() && narrowed.is_nan());
            }
        }
    }

    #[test]
    fn halves_are_converted_alike_in_vectors() {
        vectors_convert_as_numbers_do(Bf16);
        vectors_convert_as_numbers_do(F16);
    }

    #[test]
    fn every_half_has_its_value() {
        widens_every_value(Bf16, 8);
        widens_every_value(F16, 5);
    }

    #[test]
    fn halves_are_rounded_to_nearest_even() {
        rounds_between_all_neighbors(Bf16, 0x7f7f);
        rounds_between_all_neighbors(F16, 0x7bff);
    }

    #[test]
    fn what_is_too_large_is_infinite() {
        assert_eq!(F16::nearest_to(65_520.0).widened(), f32::INFINITY);
        assert_eq!(F16::nearest_to(65_519.996).widened(), 65_504.0);
        assert_eq!(F16::nearest_to(-1e30).widened(), f32::NEG_INFINITY);
        assert_eq!(Bf16::nearest_to(f32::MAX).widened(), f32::INFINITY);
    }
}
