//! Two real lines as one complex line, `Z = A + iB`, where `A` and `B` are the spectra of the real lines `a` and `b`.
//!
//! These may be the even and the odd points of one line `x` of `2 N`: then `X(k) = A(k) + exp(-πi k / N) B(k)`, and
//! `X(N - k)` is the conjugate of the difference.

use crate::simd::{Complex, Vector};

/// `2 A(k)` and `2 B(k)` from `Z(k)` and `Z(-k)`.
#[inline(always)]
pub(crate) fn split<V: Vector>(z: Complex<V>, mirror: Complex<V>) -> [Complex<V>; 2] {
    [
        Complex::new(z.re + mirror.re, z.im - mirror.im),
        Complex::new(z.im + mirror.im, mirror.re - z.re),
    ]
}

/// `Z(k)` and `Z(-k)` from `A(k)` and `B(k)`.
#[inline(always)]
pub(crate) fn join<V: Vector>([a, b]: [Complex<V>; 2]) -> (Complex<V>, Complex<V>) {
    (a.add_i(b), Complex::new(a.re + b.im, b.re - a.im))
}

/// From `[A(k), B(k)]` `[X(k), X(N - k)]`, with the twiddle factor `exp(-πi k / N)`.
#[inline(always)]
pub(crate) fn merge<V: Vector>([a, b]: [Complex<V>; 2], twiddle: Complex<V>) -> [Complex<V>; 2] {
    let turned = b.times(twiddle);
    [a + turned, Complex::new(a.re - turned.re, turned.im - a.im)]
}

/// Undoes [`merge`] up to a factor 2.
#[inline(always)]
pub(crate) fn unmerge<V: Vector>(
    [x, mirror]: [Complex<V>; 2],
    twiddle: Complex<V>,
) -> [Complex<V>; 2] {
    let sum = Complex::new(x.re + mirror.re, x.im - mirror.im);
    let difference = Complex::new(x.re - mirror.re, x.im + mirror.im);
    [sum, difference.times_conj(twiddle)]
}
