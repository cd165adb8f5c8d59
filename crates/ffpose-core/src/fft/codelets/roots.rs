//! Roots of unity in float64, at compile time and at run time.

use std::f64::consts::PI;

use crate::simd::{Complex, Element};

/// `(cos, sin)` of `2π k / n`, exact at multiples of an eighth of a turn up to rounding.
///
/// The angle is brought to an eighth of a turn with integers; there the two Taylor series are exact in float64.
pub(crate) const fn root(k: usize, n: usize) -> (f64, f64) {
    let eighths = 8 * (k % n); // in units of 1/n of an eighth
    let (octant, rest) = (eighths / n, eighths % n);
    // odd octants count down from the next axis or diagonal, so that the angle is at most an eighth of a turn
    let part = if octant % 2 == 0 { rest } else { n - rest };
    let (c, s) = taylor(PI / 4.0 * part as f64 / n as f64);
    match octant {
        0 => (c, s),
        1 => (s, c),
        2 => (-s, c),
        3 => (-c, s),
        4 => (-c, -s),
        5 => (-s, -c),
        6 => (s, -c),
        _ => (c, -s),
    }
}

/// `(cos x, sin x)` for `0 <= x <= π/4`.
const fn taylor(x: f64) -> (f64, f64) {
    const TERMS: usize = 10; // the next term is below 1e-20
    let (mut c, mut s) = (1.0, 1.0);
    let mut i = TERMS;
    while i > 0 {
        let n = 2.0 * i as f64;
        c = 1.0 - x * x / (n * (n - 1.0)) * c;
        s = 1.0 - x * x / (n * (n + 1.0)) * s;
        i -= 1;
    }
    (c, x * s)
}

/// The roots of unity of order `N` as constants.
pub(crate) struct Roots<const N: usize>;

impl<const N: usize> Roots<N> {
    /// `(cos, sin)` of `2π k / N`.
    pub(crate) const TABLE: [(f64, f64); N] = {
        let mut table = [(0.0, 0.0); N];
        let mut k = 0;
        while k < N {
            table[k] = root(k, N);
            k += 1;
        }
        table
    };
}

/// `exp(-2πi k / n)`.
pub(crate) fn twiddle<T: Element>(k: usize, n: usize) -> Complex<T> {
    let (c, s) = root(k, n);
    Complex::new(T::nearest(c), T::nearest(-s))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Up to the rounding of the angle, which is larger than that of the root.
    #[test]
    fn agrees_with_the_standard_library() {
        for n in [1, 2, 3, 8, 49, 196, 1000, 1021] {
            for k in 0..2 * n {
                let (sin, cos) = (2.0 * PI * (k % n) as f64 / n as f64).sin_cos();
                let (c, s) = root(k, n);
                assert!(
                    (c - cos).abs() < 2e-15 && (s - sin).abs() < 2e-15,
                    "{k}/{n}: {c} {cos} {s} {sin}"
                );
            }
        }
    }
}
