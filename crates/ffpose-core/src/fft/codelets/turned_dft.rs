//! DFTs of which each vector is turned first: `X[c] = Σ_y z[y] s^y exp(-2πi c y / J)`, the values of a polynomial at the points
//! `s exp(-2πi c / J)`.
//!
//! Its even and its odd coefficients are polynomials in the square of the point. A sum and a difference with one product in
//! them are six instructions for a complex vector, so that the turns cost nothing beyond the transform's own.

use super::dft::Codelet;
use crate::simd::{Complex, Vector};

/// The transform of length `J`.
pub(crate) trait TurnedDft<const J: usize> {
    /// What the transform multiplies by, in its order: powers of `s`, each turned by so many eighths.
    const FACTORS: &'static [(usize, usize)];

    fn turned_dft<V: Vector>(z: [Complex<V>; J], factors: &[Complex<V>]) -> [Complex<V>; J];
}

impl TurnedDft<1> for Codelet {
    const FACTORS: &'static [(usize, usize)] = &[];

    #[inline(always)]
    fn turned_dft<V: Vector>(z: [Complex<V>; 1], _: &[Complex<V>]) -> [Complex<V>; 1] {
        z
    }
}

impl TurnedDft<2> for Codelet {
    const FACTORS: &'static [(usize, usize)] = &[(1, 0)];

    #[inline(always)]
    fn turned_dft<V: Vector>([a, b]: [Complex<V>; 2], s: &[Complex<V>]) -> [Complex<V>; 2] {
        butterfly(a, b, s[0])
    }
}

impl TurnedDft<4> for Codelet {
    const FACTORS: &'static [(usize, usize)] = &[(2, 0), (1, 0)];

    #[inline(always)]
    fn turned_dft<V: Vector>(z: [Complex<V>; 4], s: &[Complex<V>]) -> [Complex<V>; 4] {
        let e = Self::turned_dft([z[0], z[2]], s);
        let o = Self::turned_dft([z[1], z[3]], s);
        let ([a, c], [b, d]) = (butterfly(e[0], o[0], s[1]), butterfly_i(e[1], o[1], s[1]));
        [a, b, c, d]
    }
}

impl TurnedDft<8> for Codelet {
    const FACTORS: &'static [(usize, usize)] = &[(4, 0), (2, 0), (1, 0), (1, 1)];

    #[inline(always)]
    fn turned_dft<V: Vector>(z: [Complex<V>; 8], s: &[Complex<V>]) -> [Complex<V>; 8] {
        let e = Self::turned_dft([z[0], z[2], z[4], z[6]], s);
        let o = Self::turned_dft([z[1], z[3], z[5], z[7]], s);
        let ([x0, x4], [x1, x5]) = (butterfly(e[0], o[0], s[2]), butterfly(e[1], o[1], s[3]));
        let ([x2, x6], [x3, x7]) = (butterfly_i(e[2], o[2], s[2]), butterfly_i(e[3], o[3], s[3]));
        [x0, x1, x2, x3, x4, x5, x6, x7]
    }
}

/// `a + b w` and `a - b w`
#[inline(always)]
fn butterfly<V: Vector>(a: Complex<V>, b: Complex<V>, w: Complex<V>) -> [Complex<V>; 2] {
    let sum = a.plus_times(b, w);
    [sum, a.mirrored(sum)]
}

/// `a - i b w` and `a + i b w`
#[inline(always)]
fn butterfly_i<V: Vector>(a: Complex<V>, b: Complex<V>, w: Complex<V>) -> [Complex<V>; 2] {
    let sum = a.minus_i_times(b, w);
    [sum, a.mirrored(sum)]
}
