//! Half precision: how 16 bits become `f32` and back, and elements of any type as the numbers that kernels compute with.
//!
//! Kernels know `f32` and `f64`. Images of half precision are widened one by one into memory that stays in cache, and
//! the result is rounded once, to nearest and ties to even. No instructions for half precision are asked for: the
//! loops below are integer arithmetic, compiled for each instruction set.

use std::hint::black_box;

use ndarray::{ArrayView3, ArrayViewMut3};

use crate::simd::{Algorithm, Vector, prefetch};
use crate::{Isa, Real};

/// bfloat16: the upper half of an `f32`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(transparent)]
pub struct Bf16(pub u16);

/// float16: IEEE's binary16.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(transparent)]
pub struct F16(pub u16);

mod sealed {
    pub trait Sealed {}
    impl Sealed for f32 {}
    impl Sealed for f64 {}
    impl Sealed for super::Bf16 {}
    impl Sealed for super::F16 {}
}

/// An element of images and weights: `f32`, `f64`, [`Bf16`] or [`F16`].
pub trait Number: Copy + Default + Send + Sync + sealed::Sealed + 'static {
    /// What is computed in.
    type Real: Real;
    /// Whether it is something else than the element itself.
    const WIDENED: bool;

    /// `view` in what is computed in; where that is something else, a copy in `wide`.
    #[doc(hidden)]
    fn read<'a>(
        isa: Isa,
        view: ArrayView3<'a, Self>,
        wide: &'a mut [Self::Real],
    ) -> ArrayView3<'a, Self::Real>;

    /// Lets `compute` fill `view`, by way of `wide` where what is computed in is something else.
    #[doc(hidden)]
    fn write(
        isa: Isa,
        view: ArrayViewMut3<'_, Self>,
        wide: &mut [Self::Real],
        compute: impl FnOnce(ArrayViewMut3<'_, Self::Real>),
    );
}

macro_rules! computed_in_itself {
    ($real:ty) => {
        impl Number for $real {
            type Real = Self;
            const WIDENED: bool = false;

            fn read<'a>(
                _: Isa,
                view: ArrayView3<'a, Self>,
                _: &'a mut [Self],
            ) -> ArrayView3<'a, Self> {
                view
            }

            fn write(
                _: Isa,
                view: ArrayViewMut3<'_, Self>,
                _: &mut [Self],
                compute: impl FnOnce(ArrayViewMut3<'_, Self>),
            ) {
                compute(view);
            }
        }
    };
}

computed_in_itself!(f32);
computed_in_itself!(f64);

macro_rules! computed_in_f32 {
    ($half:ident) => {
        impl Number for $half {
            type Real = f32;
            const WIDENED: bool = true;

            fn read<'a>(
                isa: Isa,
                view: ArrayView3<'a, Self>,
                wide: &'a mut [f32],
            ) -> ArrayView3<'a, f32> {
                let dim = view.dim();
                let wide = &mut wide[..view.len()];
                isa.run(Widen { from: view, to: wide });
                ArrayView3::from_shape(dim, wide).expect("as many numbers")
            }

            fn write(
                isa: Isa,
                view: ArrayViewMut3<'_, Self>,
                wide: &mut [f32],
                compute: impl FnOnce(ArrayViewMut3<'_, f32>),
            ) {
                let wide = &mut wide[..view.len()];
                let target = ArrayViewMut3::from_shape(view.dim(), &mut *wide);
                compute(target.expect("as many numbers"));
                isa.run(Narrow { from: wide, to: view });
            }
        }
    };
}

computed_in_f32!(Bf16);
computed_in_f32!(F16);

/// [`Bf16`] or [`F16`].
pub trait Half: Number<Real = f32> {
    /// The same value in single precision.
    fn widened(self) -> f32;
    /// The value of this type nearest to `value`, the even one of two that are as near.
    fn nearest(value: f32) -> Self;
}

impl Half for Bf16 {
    #[inline(always)]
    fn widened(self) -> f32 {
        f32::from_bits(u32::from(self.0) << 16)
    }

    #[inline(always)]
    fn nearest(value: f32) -> Self {
        let bits = value.to_bits();
        let rounded = bits.wrapping_add(0x7fff + (bits >> 16 & 1));
        let quiet = bits | 0x0040_0000; // rounding could carry a NaN over to infinity
        Self(upper_half(if value.is_nan() { quiet } else { rounded }))
    }
}

impl Half for F16 {
    /// The bits of both formats stand alike but for the bias of the exponent, which a product corrects, exactly.
    #[inline(always)]
    fn widened(self) -> f32 {
        let bits = u32::from(self.0);
        let shifted = (bits & 0x7fff) << 13;
        let scaled = (f32::from_bits(shifted) * f32::from_bits(0x7780_0000)).to_bits(); // 2^112
        let finite = if shifted < 0x0f80_0000 { scaled } else { shifted | 0x7f80_0000 };
        f32::from_bits(finite | (bits & 0x8000) << 16)
    }

    /// Below the smallest normal number a sum rounds at the right place, and above it integers do.
    #[inline(always)]
    fn nearest(value: f32) -> Self {
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
}

#[inline(always)]
#[allow(clippy::cast_possible_truncation)] // the upper bits are shifted out of the way
fn upper_half(bits: u32) -> u16 {
    (bits >> 16) as u16
}

/// Rows ahead of the work that are brought to the cache, where rows are apart from each other: no processor guesses them.
const ROWS_AHEAD: isize = 16;

struct Widen<'a, H> {
    from: ArrayView3<'a, H>,
    to: &'a mut [f32],
}

impl<H: Half> Algorithm<f32> for Widen<'_, H> {
    #[inline(always)]
    fn run<V: Vector<Element = f32>>(self) {
        let Self { from, to } = self;
        if let Some(from) = from.to_slice() {
            widen(from, to, 0);
            return;
        }
        let (_, points, lanes) = from.dim();
        let ahead = ROWS_AHEAD * from.strides()[1];
        for (from, to) in from.outer_iter().zip(to.chunks_exact_mut(points * lanes)) {
            for (from, to) in from.outer_iter().zip(to.chunks_exact_mut(lanes)) {
                widen(from.to_slice().expect("lanes are contiguous"), to, ahead);
            }
        }
    }
}

struct Narrow<'a, H> {
    from: &'a [f32],
    to: ArrayViewMut3<'a, H>,
}

impl<H: Half> Algorithm<f32> for Narrow<'_, H> {
    #[inline(always)]
    fn run<V: Vector<Element = f32>>(self) {
        let Self { from, mut to } = self;
        if let Some(to) = to.as_slice_mut() {
            narrow(from, to, 0);
            return;
        }
        let (_, points, lanes) = to.dim();
        let ahead = ROWS_AHEAD * to.strides()[1];
        for (mut to, from) in to.outer_iter_mut().zip(from.chunks_exact(points * lanes)) {
            for (to, from) in to.outer_iter_mut().zip(from.chunks_exact(lanes)) {
                narrow(from, to.into_slice().expect("lanes are contiguous"), ahead);
            }
        }
    }
}

/// Elements converted together, which become vectors. Between these groups the compiler is kept from looking across: it would
/// else make vectors of the first elements of several groups, and gather each number alone.
const GROUP: usize = 16;

/// `from` as numbers; what is `ahead` elements further is brought to the cache.
#[inline(always)]
fn widen<H: Half>(from: &[H], to: &mut [f32], ahead: isize) {
    let (groups, last) = from.as_chunks::<GROUP>();
    let (to_groups, to_last) = to.as_chunks_mut::<GROUP>();
    for (group, to) in groups.iter().zip(to_groups) {
        prefetch(group.as_ptr().wrapping_offset(ahead));
        *to = each(group, H::widened);
        black_box(());
    }
    for (from, to) in last.iter().zip(to_last) {
        *to = from.widened();
    }
}

/// `from` rounded; what is `ahead` elements further than its place is brought to the cache.
#[inline(always)]
fn narrow<H: Half>(from: &[f32], to: &mut [H], ahead: isize) {
    let (groups, last) = from.as_chunks::<GROUP>();
    let (to_groups, to_last) = to.as_chunks_mut::<GROUP>();
    for (group, to) in groups.iter().zip(to_groups) {
        prefetch(to.as_ptr().wrapping_offset(ahead));
        *to = each(group, H::nearest);
        black_box(());
    }
    for (from, to) in last.iter().zip(to_last) {
        *to = H::nearest(*from);
    }
}

/// `function` of each number of a group; the library's `map` would be a call out of the instruction set.
#[inline(always)]
fn each<A: Copy, B: Copy + Default>(group: &[A; GROUP], function: impl Fn(A) -> B) -> [B; GROUP] {
    let mut results = [B::default(); GROUP];
    for n in 0..GROUP {
        results[n] = function(group[n]);
    }
    results
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // values of halves are exact
mod tests {
    use super::*;

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

    fn widens_every_value<H: Half>(half: impl Fn(u16) -> H, exponent_bits: u32) {
        for bits in 0..=u16::MAX {
            let expected = by_definition(bits, exponent_bits, 15 - exponent_bits);
            let value = half(bits).widened();
            assert!(f64::from(value) == expected || value.is_nan() && expected.is_nan(), "{bits}");
            let back = H::nearest(value).widened();
            assert!(back.to_bits() == value.to_bits() || value.is_nan() && back.is_nan(), "{bits}");
        }
    }

    /// Midpoints go to the even neighbour, and what is next to them to the nearer.
    fn rounds_between_all_neighbours<H: Half + PartialEq + std::fmt::Debug>(
        half: impl Fn(u16) -> H,
        largest: u16,
    ) {
        for bits in 0..largest {
            let (below, above) = (half(bits), half(bits + 1));
            let middle = below.widened().midpoint(above.widened());
            let even = if bits % 2 == 0 { below } else { above };
            assert_eq!(H::nearest(middle), even, "{bits}");
            assert_eq!(H::nearest(middle.next_down()), below, "{bits}");
            assert_eq!(H::nearest(middle.next_up()), above, "{bits}");
            assert_eq!(H::nearest(-middle.next_up()).widened(), -above.widened(), "{bits}");
        }
    }

    #[test]
    fn every_half_has_its_value() {
        widens_every_value(Bf16, 8);
        widens_every_value(F16, 5);
    }

    #[test]
    fn halves_are_rounded_to_nearest_even() {
        rounds_between_all_neighbours(Bf16, 0x7f7f);
        rounds_between_all_neighbours(F16, 0x7bff);
    }

    #[test]
    fn what_is_too_large_is_infinite() {
        assert_eq!(F16::nearest(65_520.0).widened(), f32::INFINITY);
        assert_eq!(F16::nearest(65_519.996).widened(), 65_504.0);
        assert_eq!(F16::nearest(-1e30).widened(), f32::NEG_INFINITY);
        assert_eq!(Bf16::nearest(f32::MAX).widened(), f32::INFINITY);
    }
}
