//! AVX2 with FMA and F16C, and AVX-512 (F, DQ, BW, VL).

#[allow(clippy::wildcard_imports)] // intrinsics
use std::arch::x86_64::*;
use std::ops::{Add, Mul, Neg, Sub};

use super::register::{of_registers, vector};
use super::{Bf16, F16, Vector};

vector!(F32x8(__m256); _mm256_set1_ps _mm256_loadu_ps _mm256_storeu_ps _mm256_add_ps _mm256_sub_ps _mm256_mul_ps
    neg_f32x8 _mm256_fmadd_ps _mm256_fnmadd_ps _mm256_fmsub_ps interleave_f32x8 deinterleave_f32x8 deinterleave_reversed_f32x8
    reverse_f32x8 exchange_halves_f32x8 transpose_in_halves_f32x8
    load_bf16x8 store_bf16x8 load_f16x8 store_f16x8);
vector!(F32x16(__m512); _mm512_set1_ps _mm512_loadu_ps _mm512_storeu_ps _mm512_add_ps _mm512_sub_ps _mm512_mul_ps
    neg_f32x16 _mm512_fmadd_ps _mm512_fnmadd_ps _mm512_fmsub_ps interleave_f32x16 deinterleave_f32x16 deinterleave_reversed_f32x16 reverse_f32x16
    exchange_halves_f32x16 transpose_in_halves_f32x16
    load_bf16x16 store_bf16x16 load_f16x16 store_f16x16);

#[inline]
#[target_feature(enable = "avx2")]
fn neg_f32x8(a: __m256) -> __m256 {
    _mm256_xor_ps(a, _mm256_set1_ps(-0.0))
}

#[inline]
#[target_feature(enable = "avx512f,avx512dq")]
fn neg_f32x16(a: __m512) -> __m512 {
    _mm512_xor_ps(a, _mm512_set1_ps(-0.0))
}

#[inline]
#[target_feature(enable = "avx2")]
fn interleave_f32x8(a: __m256, b: __m256) -> (__m256, __m256) {
    let (p, q) = (_mm256_unpacklo_ps(a, b), _mm256_unpackhi_ps(a, b)); // quarters 0 and 2, quarters 1 and 3
    (_mm256_permute2f128_ps::<0x20>(p, q), _mm256_permute2f128_ps::<0x31>(p, q))
}

#[inline]
#[target_feature(enable = "avx2")]
fn deinterleave_f32x8(low: __m256, high: __m256) -> (__m256, __m256) {
    let in_order =
        |halves| _mm256_castpd_ps(_mm256_permute4x64_pd::<0xd8>(_mm256_castps_pd(halves)));
    (in_order(_mm256_shuffle_ps::<0x88>(low, high)), in_order(_mm256_shuffle_ps::<0xdd>(low, high)))
}

#[inline]
#[target_feature(enable = "avx2")]
fn deinterleave_reversed_f32x8(low: __m256, high: __m256) -> (__m256, __m256) {
    // in each half of a vector two numbers of `low`, then two of `high`
    let order = _mm256_setr_epi32(7, 6, 3, 2, 5, 4, 1, 0);
    let reversed = |halves| _mm256_permutevar8x32_ps(halves, order);
    (reversed(_mm256_shuffle_ps::<0x88>(low, high)), reversed(_mm256_shuffle_ps::<0xdd>(low, high)))
}

#[inline]
#[target_feature(enable = "avx512f")]
fn interleave_f32x16(a: __m512, b: __m512) -> (__m512, __m512) {
    let low = _mm512_setr_epi32(0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23);
    let high = _mm512_setr_epi32(8, 24, 9, 25, 10, 26, 11, 27, 12, 28, 13, 29, 14, 30, 15, 31);
    (_mm512_permutex2var_ps(a, low, b), _mm512_permutex2var_ps(a, high, b))
}

#[inline]
#[target_feature(enable = "avx512f")]
fn deinterleave_f32x16(low: __m512, high: __m512) -> (__m512, __m512) {
    let even = _mm512_setr_epi32(0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
    let odd = _mm512_setr_epi32(1, 3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23, 25, 27, 29, 31);
    (_mm512_permutex2var_ps(low, even, high), _mm512_permutex2var_ps(low, odd, high))
}

#[inline]
#[target_feature(enable = "avx512f")]
fn deinterleave_reversed_f32x16(low: __m512, high: __m512) -> (__m512, __m512) {
    let even = _mm512_setr_epi32(30, 28, 26, 24, 22, 20, 18, 16, 14, 12, 10, 8, 6, 4, 2, 0);
    let odd = _mm512_setr_epi32(31, 29, 27, 25, 23, 21, 19, 17, 15, 13, 11, 9, 7, 5, 3, 1);
    (_mm512_permutex2var_ps(low, even, high), _mm512_permutex2var_ps(low, odd, high))
}

#[inline]
#[target_feature(enable = "avx2")]
fn reverse_f32x8(a: __m256) -> __m256 {
    _mm256_permutevar8x32_ps(a, _mm256_setr_epi32(7, 6, 5, 4, 3, 2, 1, 0))
}

#[inline]
#[target_feature(enable = "avx512f")]
fn reverse_f32x16(a: __m512) -> __m512 {
    let order = _mm512_setr_epi32(15, 14, 13, 12, 11, 10, 9, 8, 7, 6, 5, 4, 3, 2, 1, 0);
    _mm512_permutexvar_ps(order, a)
}

#[inline]
#[target_feature(enable = "avx2")]
fn exchange_halves_f32x8(a: __m256, b: __m256) -> (__m256, __m256) {
    (_mm256_permute2f128_ps::<0x20>(a, b), _mm256_permute2f128_ps::<0x31>(a, b))
}

#[inline]
#[target_feature(enable = "avx512f")]
fn exchange_halves_f32x16(a: __m512, b: __m512) -> (__m512, __m512) {
    (_mm512_shuffle_f32x4::<0x44>(a, b), _mm512_shuffle_f32x4::<0xee>(a, b))
}

#[inline]
#[target_feature(enable = "avx2")]
fn transpose_in_halves_f32x8([a, b, c, d]: [__m256; 4]) -> [__m256; 4] {
    let (p, q) = (_mm256_unpacklo_ps(a, b), _mm256_unpackhi_ps(a, b));
    let (r, s) = (_mm256_unpacklo_ps(c, d), _mm256_unpackhi_ps(c, d));
    [
        _mm256_shuffle_ps::<0x44>(p, r),
        _mm256_shuffle_ps::<0xee>(p, r),
        _mm256_shuffle_ps::<0x44>(q, s),
        _mm256_shuffle_ps::<0xee>(q, s),
    ]
}

/// Transposes inside blocks of 128 bits, then the blocks of each half.
#[inline]
#[target_feature(enable = "avx512f")]
fn transpose_in_halves_f32x16([a, b, c, d, e, f, g, h]: [__m512; 8]) -> [__m512; 8] {
    let ([a, b, c, d], [e, f, g, h]) =
        (transpose_in_blocks_f32x16([a, b, c, d]), transpose_in_blocks_f32x16([e, f, g, h]));
    let blocks = |a, e| {
        let (a, e) = transpose_blocks_in_halves(_mm512_castps_pd(a), _mm512_castps_pd(e));
        (_mm512_castpd_ps(a), _mm512_castpd_ps(e))
    };
    let ((a, e), (b, f), (c, g), (d, h)) = (blocks(a, e), blocks(b, f), blocks(c, g), blocks(d, h));
    [a, b, c, d, e, f, g, h]
}

/// Transposes inside blocks of 128 bits, then the blocks of each half.
#[inline]
#[target_feature(enable = "avx512f")]
fn transpose_in_blocks_f32x16([a, b, c, d]: [__m512; 4]) -> [__m512; 4] {
    let (p, q) = (_mm512_unpacklo_ps(a, b), _mm512_unpackhi_ps(a, b));
    let (r, s) = (_mm512_unpacklo_ps(c, d), _mm512_unpackhi_ps(c, d));
    [
        _mm512_shuffle_ps::<0x44>(p, r),
        _mm512_shuffle_ps::<0xee>(p, r),
        _mm512_shuffle_ps::<0x44>(q, s),
        _mm512_shuffle_ps::<0xee>(q, s),
    ]
}

/// The first blocks of each half of two vectors, and the second blocks.
#[inline]
#[target_feature(enable = "avx512f")]
fn transpose_blocks_in_halves(a: __m512d, b: __m512d) -> (__m512d, __m512d) {
    let first = _mm512_setr_epi64(0, 1, 8, 9, 4, 5, 12, 13);
    let second = _mm512_setr_epi64(2, 3, 10, 11, 6, 7, 14, 15);
    (_mm512_permutex2var_pd(a, first, b), _mm512_permutex2var_pd(a, second, b))
}

/// # Safety
/// 8 elements are readable at `from`.
#[inline]
#[target_feature(enable = "avx2")]
unsafe fn load_bf16x8(from: *const Bf16) -> __m256 {
    // SAFETY: the caller promises the elements; the instruction needs no alignment.
    let halves = unsafe { _mm_loadu_si128(from.cast()) };
    _mm256_castsi256_ps(_mm256_slli_epi32::<16>(_mm256_cvtepu16_epi32(halves)))
}

/// # Safety
/// 8 elements are writable at `to`.
#[inline]
#[target_feature(enable = "avx2")]
unsafe fn store_bf16x8(a: __m256, to: *mut Bf16) {
    let bits = _mm256_castps_si256(a);
    let odd = _mm256_and_si256(_mm256_srli_epi32::<16>(bits), _mm256_set1_epi32(1));
    let rounded = _mm256_add_epi32(bits, _mm256_add_epi32(odd, _mm256_set1_epi32(0x7fff)));
    let nan = _mm256_cmp_ps::<_CMP_UNORD_Q>(a, a); // rounding could carry it over to infinity
    let rounded = _mm256_blendv_ps(_mm256_castsi256_ps(rounded), _mm256_set1_ps(f32::NAN), nan);
    let upper = _mm256_set1_epi64x(0x0f0e_0b0a_0706_0302); // of each number, in each block of 128 bits
    let halves = _mm256_shuffle_epi8(_mm256_castps_si256(rounded), upper);
    let halves = _mm256_permute4x64_epi64::<0x08>(halves);
    // SAFETY: the caller promises the elements; the instruction needs no alignment.
    unsafe { _mm_storeu_si128(to.cast(), _mm256_castsi256_si128(halves)) }
}

/// # Safety
/// 8 elements are readable at `from`.
#[inline]
#[target_feature(enable = "avx2,f16c")]
unsafe fn load_f16x8(from: *const F16) -> __m256 {
    // SAFETY: the caller promises the elements; the instruction needs no alignment.
    _mm256_cvtph_ps(unsafe { _mm_loadu_si128(from.cast()) })
}

/// # Safety
/// 8 elements are writable at `to`.
#[inline]
#[target_feature(enable = "avx2,f16c")]
unsafe fn store_f16x8(a: __m256, to: *mut F16) {
    let halves = _mm256_cvtps_ph::<_MM_FROUND_TO_NEAREST_INT>(a);
    // SAFETY: the caller promises the elements; the instruction needs no alignment.
    unsafe { _mm_storeu_si128(to.cast(), halves) }
}

/// # Safety
/// 16 elements are readable at `from`.
#[inline]
#[target_feature(enable = "avx512f")]
unsafe fn load_bf16x16(from: *const Bf16) -> __m512 {
    // SAFETY: the caller promises the elements; the instruction needs no alignment.
    let halves = unsafe { _mm256_loadu_si256(from.cast()) };
    _mm512_castsi512_ps(_mm512_slli_epi32::<16>(_mm512_cvtepu16_epi32(halves)))
}

/// # Safety
/// 16 elements are writable at `to`.
#[inline]
#[target_feature(enable = "avx512f,avx512bw")]
unsafe fn store_bf16x16(a: __m512, to: *mut Bf16) {
    let bits = _mm512_castps_si512(a);
    let odd = _mm512_and_si512(_mm512_srli_epi32::<16>(bits), _mm512_set1_epi32(1));
    let rounded = _mm512_add_epi32(bits, _mm512_add_epi32(odd, _mm512_set1_epi32(0x7fff)));
    let nan = _mm512_cmp_ps_mask::<_CMP_UNORD_Q>(a, a); // rounding could carry it over to infinity
    let quiet = _mm512_castps_si512(_mm512_set1_ps(f32::NAN));
    let rounded = _mm512_mask_mov_epi32(rounded, nan, quiet);
    let upper = _mm512_castsi256_si512(_mm256_setr_epi16(
        1, 3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23, 25, 27, 29, 31,
    ));
    let halves = _mm512_permutexvar_epi16(upper, rounded);
    // SAFETY: the caller promises the elements; the instruction needs no alignment.
    unsafe { _mm256_storeu_si256(to.cast(), _mm512_castsi512_si256(halves)) }
}

/// # Safety
/// 16 elements are readable at `from`.
#[inline]
#[target_feature(enable = "avx512f")]
unsafe fn load_f16x16(from: *const F16) -> __m512 {
    // SAFETY: the caller promises the elements; the instruction needs no alignment.
    _mm512_cvtph_ps(unsafe { _mm256_loadu_si256(from.cast()) })
}

/// # Safety
/// 16 elements are writable at `to`.
#[inline]
#[target_feature(enable = "avx512f")]
unsafe fn store_f16x16(a: __m512, to: *mut F16) {
    let halves = _mm512_cvtps_ph::<_MM_FROUND_TO_NEAREST_INT>(a);
    // SAFETY: the caller promises the elements; the instruction needs no alignment.
    unsafe { _mm256_storeu_si256(to.cast(), halves) }
}
