//! Two real lines as one complex line, `Z = A + iB`, where `A` and `B` are the spectra of the real lines `a` and `b`.

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
