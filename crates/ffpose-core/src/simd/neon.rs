//! NEON, which every 64-bit ARM has.

#[allow(clippy::wildcard_imports)] // intrinsics
use std::arch::aarch64::*;
use std::arch::asm;
use std::ops::{Add, Mul, Neg, Sub};

use super::register::{of_registers, vector};
use super::{Bf16, F16, Vector};

vector!(F32x4(float32x4_t); vdupq_n_f32 vld1q_f32 vst1q_f32 vaddq_f32 vsubq_f32 vmulq_f32 vnegq_f32
    mul_add_f32x4 neg_mul_add_f32x4 mul_sub_f32x4 interleave_f32x4 deinterleave_f32x4 deinterleave_reversed_f32x4
    reverse_f32x4 exchange_halves_f32x4 transpose_in_halves_f32x4
    load_bf16x4 store_bf16x4 load_f16x4 store_f16x4);

#[inline]
#[target_feature(enable = "neon")]
fn mul_add_f32x4(a: float32x4_t, b: float32x4_t, c: float32x4_t) -> float32x4_t {
    vfmaq_f32(c, a, b)
}

#[inline]
#[target_feature(enable = "neon")]
fn neg_mul_add_f32x4(a: float32x4_t, b: float32x4_t, c: float32x4_t) -> float32x4_t {
    vfmsq_f32(c, a, b)
}

#[inline]
#[target_feature(enable = "neon")]
fn mul_sub_f32x4(a: float32x4_t, b: float32x4_t, c: float32x4_t) -> float32x4_t {
    vnegq_f32(vfmsq_f32(c, a, b))
}

#[inline]
#[target_feature(enable = "neon")]
fn interleave_f32x4(a: float32x4_t, b: float32x4_t) -> (float32x4_t, float32x4_t) {
    (vzip1q_f32(a, b), vzip2q_f32(a, b))
}

#[inline]
#[target_feature(enable = "neon")]
fn deinterleave_f32x4(low: float32x4_t, high: float32x4_t) -> (float32x4_t, float32x4_t) {
    (vuzp1q_f32(low, high), vuzp2q_f32(low, high))
}

#[inline]
#[target_feature(enable = "neon")]
fn deinterleave_reversed_f32x4(low: float32x4_t, high: float32x4_t) -> (float32x4_t, float32x4_t) {
    let (a, b) = deinterleave_f32x4(low, high);
    (reverse_f32x4(a), reverse_f32x4(b))
}

#[inline]
#[target_feature(enable = "neon")]
fn reverse_f32x4(a: float32x4_t) -> float32x4_t {
    let swapped = vrev64q_f32(a);
    vextq_f32::<2>(swapped, swapped)
}

#[inline]
#[target_feature(enable = "neon")]
fn exchange_halves_f32x4(a: float32x4_t, b: float32x4_t) -> (float32x4_t, float32x4_t) {
    let first = vcombine_f32(vget_low_f32(a), vget_low_f32(b));
    (first, vcombine_f32(vget_high_f32(a), vget_high_f32(b)))
}

#[inline]
#[target_feature(enable = "neon")]
fn transpose_in_halves_f32x4([a, b]: [float32x4_t; 2]) -> [float32x4_t; 2] {
    [vtrn1q_f32(a, b), vtrn2q_f32(a, b)]
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
