//! NEON, which every 64-bit ARM has.

#[allow(clippy::wildcard_imports)] // intrinsics
use std::arch::aarch64::*;
use std::arch::asm;
use std::ops::{Add, Mul, Neg, Sub};

use super::{Bf16, F16, Vector};

/// A vector type from the names of its intrinsics, which need no more than the base architecture.
macro_rules! vector {
    ($name:ident($raw:ty), $element:ty; $splat:ident $load:ident $store:ident $add:ident $sub:ident $mul:ident $neg:ident
     $mul_add:ident $neg_mul_add:ident $zip1:ident $zip2:ident $uzp1:ident $uzp2:ident $reverse:ident
     $exchange_halves:ident $transpose_in_halves:ident
     $(; $load_bf16:ident $store_bf16:ident $load_f16:ident $store_f16:ident)?) => {
        #[derive(Clone, Copy)]
        #[repr(transparent)]
        pub(crate) struct $name($raw);

        vector!(@operator $name, Add, add, $add);
        vector!(@operator $name, Sub, sub, $sub);
        vector!(@operator $name, Mul, mul, $mul);

        impl Neg for $name {
            type Output = Self;
            #[inline(always)]
            fn neg(self) -> Self {
                // SAFETY: every 64-bit ARM has the instruction.
                Self(unsafe { $neg(self.0) })
            }
        }

        // SAFETY: a register is its floats without padding; loads and stores move a whole one.
        unsafe impl Vector for $name {
            type Element = $element;
            const LANES: usize = size_of::<$raw>() / size_of::<$element>();

            #[inline(always)]
            fn splat(x: $element) -> Self {
                // SAFETY: every 64-bit ARM has the instruction.
                Self(unsafe { $splat(x) })
            }

            #[inline(always)]
            fn mul_add(self, b: Self, c: Self) -> Self {
                // SAFETY: every 64-bit ARM has the instruction.
                Self(unsafe { $mul_add(c.0, self.0, b.0) })
            }

            #[inline(always)]
            fn neg_mul_add(self, b: Self, c: Self) -> Self {
                // SAFETY: every 64-bit ARM has the instruction.
                Self(unsafe { $neg_mul_add(c.0, self.0, b.0) })
            }

            #[inline(always)]
            fn mul_sub(self, b: Self, c: Self) -> Self {
                -self.neg_mul_add(b, c)
            }

            #[inline(always)]
            unsafe fn load(from: *const $element) -> Self {
                // SAFETY: the caller promises the elements; the instruction needs no alignment.
                Self(unsafe { $load(from) })
            }

            #[inline(always)]
            unsafe fn store(self, to: *mut $element) {
                // SAFETY: the caller promises the elements; the instruction needs no alignment.
                unsafe { $store(to, self.0) }
            }

            $(
                #[inline(always)]
                unsafe fn load_bf16(from: *const Bf16) -> Self {
                    // SAFETY: the caller promises the elements; the instruction needs no alignment.
                    Self(unsafe { $load_bf16(from) })
                }

                #[inline(always)]
                unsafe fn store_bf16(self, to: *mut Bf16) {
                    // SAFETY: the caller promises the elements; the instruction needs no alignment.
                    unsafe { $store_bf16(self.0, to) }
                }

                #[inline(always)]
                unsafe fn load_f16(from: *const F16) -> Self {
                    // SAFETY: the caller promises the elements; the instruction needs no alignment.
                    Self(unsafe { $load_f16(from) })
                }

                #[inline(always)]
                unsafe fn store_f16(self, to: *mut F16) {
                    // SAFETY: the caller promises the elements; the instruction needs no alignment.
                    unsafe { $store_f16(self.0, to) }
                }
            )?

            #[inline(always)]
            fn interleave(a: Self, b: Self) -> (Self, Self) {
                // SAFETY: every 64-bit ARM has the instructions.
                unsafe { (Self($zip1(a.0, b.0)), Self($zip2(a.0, b.0))) }
            }

            #[inline(always)]
            fn deinterleave(low: Self, high: Self) -> (Self, Self) {
                // SAFETY: every 64-bit ARM has the instructions.
                unsafe { (Self($uzp1(low.0, high.0)), Self($uzp2(low.0, high.0))) }
            }

            #[inline(always)]
            fn reverse(self) -> Self {
                // SAFETY: every 64-bit ARM has the instructions.
                Self(unsafe { $reverse(self.0) })
            }

            #[inline(always)]
            fn exchange_halves(a: Self, b: Self) -> (Self, Self) {
                // SAFETY: every 64-bit ARM has the instructions.
                let (first, second) = unsafe { $exchange_halves(a.0, b.0) };
                (Self(first), Self(second))
            }

            #[inline(always)]
            fn transpose_in_halves(vectors: &mut [Self]) {
                let vectors: &mut [Self; Self::LANES / 2] = vectors.try_into().expect("half a square");
                // SAFETY: every 64-bit ARM has the instructions.
                *vectors = unsafe { $transpose_in_halves(vectors.map(|vector| vector.0)) }.map(Self);
            }
        }
    };
    (@operator $name:ident, $trait:ident, $method:ident, $intrinsic:ident) => {
        impl $trait for $name {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                // SAFETY: every 64-bit ARM has the instruction.
                Self(unsafe { $intrinsic(self.0, other.0) })
            }
        }
    };
}

vector!(F32x4(float32x4_t), f32; vdupq_n_f32 vld1q_f32 vst1q_f32 vaddq_f32 vsubq_f32 vmulq_f32 vnegq_f32
    vfmaq_f32 vfmsq_f32 vzip1q_f32 vzip2q_f32 vuzp1q_f32 vuzp2q_f32 reverse_f32x4
    exchange_halves_f32x4 transpose_in_halves_f32x4;
    load_bf16x4 store_bf16x4 load_f16x4 store_f16x4);
vector!(F64x2(float64x2_t), f64; vdupq_n_f64 vld1q_f64 vst1q_f64 vaddq_f64 vsubq_f64 vmulq_f64 vnegq_f64
    vfmaq_f64 vfmsq_f64 vzip1q_f64 vzip2q_f64 vuzp1q_f64 vuzp2q_f64 reverse_f64x2
    exchange_halves_f64x2 transpose_in_halves_f64x2);

#[inline]
#[target_feature(enable = "neon")]
fn reverse_f32x4(a: float32x4_t) -> float32x4_t {
    let swapped = vrev64q_f32(a);
    vextq_f32::<2>(swapped, swapped)
}

#[inline]
#[target_feature(enable = "neon")]
fn reverse_f64x2(a: float64x2_t) -> float64x2_t {
    vextq_f64::<1>(a, a)
}

#[inline]
#[target_feature(enable = "neon")]
fn exchange_halves_f32x4(a: float32x4_t, b: float32x4_t) -> (float32x4_t, float32x4_t) {
    let first = vcombine_f32(vget_low_f32(a), vget_low_f32(b));
    (first, vcombine_f32(vget_high_f32(a), vget_high_f32(b)))
}

#[inline]
#[target_feature(enable = "neon")]
fn exchange_halves_f64x2(a: float64x2_t, b: float64x2_t) -> (float64x2_t, float64x2_t) {
    (vzip1q_f64(a, b), vzip2q_f64(a, b))
}

#[inline]
#[target_feature(enable = "neon")]
fn transpose_in_halves_f32x4([a, b]: [float32x4_t; 2]) -> [float32x4_t; 2] {
    [vtrn1q_f32(a, b), vtrn2q_f32(a, b)]
}

#[inline]
#[target_feature(enable = "neon")]
fn transpose_in_halves_f64x2(vectors: [float64x2_t; 1]) -> [float64x2_t; 1] {
    vectors
}

/// # Safety
/// 4 elements are readable at `from`.
#[inline]
#[target_feature(enable = "neon")]
unsafe fn load_bf16x4(from: *const Bf16) -> float32x4_t {
    // SAFETY: the caller promises the elements; the instruction needs no alignment.
    let halves = unsafe { vld1_u16(from.cast()) };
    vreinterpretq_f32_u32(vshll_n_u16::<16>(halves))
}

/// # Safety
/// 4 elements are writable at `to`.
#[inline]
#[target_feature(enable = "neon")]
unsafe fn store_bf16x4(a: float32x4_t, to: *mut Bf16) {
    let bits = vreinterpretq_u32_f32(a);
    let even = vceqzq_u32(vandq_u32(bits, vdupq_n_u32(1 << 16))); // -1 as an integer: the midpoint goes down
    let number = vceqq_f32(a, a); // rounding could carry a NaN over to infinity
    let bits = vbslq_u32(number, bits, vdupq_n_u32(f32::NAN.to_bits()));
    let halves = vraddhn_u32(bits, even); // the upper half of the sum, rounded
    // SAFETY: the caller promises the elements; the instruction needs no alignment.
    unsafe { vst1_u16(to.cast(), halves) }
}

/// # Safety
/// 4 elements are readable at `from`.
#[inline]
#[target_feature(enable = "neon")]
unsafe fn load_f16x4(from: *const F16) -> float32x4_t {
    // SAFETY: the caller promises the elements; the instruction needs no alignment.
    let halves = unsafe { vld1_u16(from.cast()) };
    let wide: float32x4_t;
    // SAFETY: every 64-bit ARM has the instruction, which reads and writes these registers and flags alone. Its intrinsic needs
    // a type for halves that came to Rust after 1.89.
    unsafe {
        asm!("fcvtl {:v}.4s, {:v}.4h", lateout(vreg) wide, in(vreg) halves, options(pure, nomem, nostack));
    }
    wide
}

/// # Safety
/// 4 elements are writable at `to`.
#[inline]
#[target_feature(enable = "neon")]
unsafe fn store_f16x4(a: float32x4_t, to: *mut F16) {
    let halves: uint16x4_t;
    // SAFETY: every 64-bit ARM has the instruction, which reads and writes these registers and flags alone.
    unsafe {
        asm!("fcvtn {:v}.4h, {:v}.4s", lateout(vreg) halves, in(vreg) a, options(pure, nomem, nostack));
    }
    // SAFETY: the caller promises the elements; the instruction needs no alignment.
    unsafe { vst1_u16(to.cast(), halves) }
}
