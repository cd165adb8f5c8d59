//! DFTs of small fixed lengths across real vectors, and their inverses.
//!
//! Of the frequencies `k` and `-k` of a real line either one is enough, so each codelet keeps the one that it gets without a
//! negation, in the order in which it comes; [`RealDft::FREQUENCIES`] says which. A line of even length packs its two real
//! frequencies, 0 and `N / 2`, as real and imaginary part of slot 0.

use super::dft::{Codelet, Dft, constant};
use super::roots::Roots;
use crate::simd::{Complex, Vector, joined, mirrored, parts};

/// The DFT of an array of `N` real vectors, as `S = ceil(N / 2)` complex ones.
pub(crate) trait RealDft<const N: usize, const S: usize> {
    /// The frequency, in `0..N`, of each slot. Slot 0 is frequency 0 and, for even `N`, `N / 2` in its imaginary part.
    const FREQUENCIES: [usize; S];

    fn real_dft<V: Vector>(x: [V; N]) -> [Complex<V>; S];

    /// `x[n] = X[0] + (-1)ⁿ X[N/2] + Σ_slots Re(Y exp(2πi k n / N))`: the inverse DFT of a line whose slots after the
    /// first hold twice their frequency.
    fn real_idft<V: Vector>(spectrum: [Complex<V>; S]) -> [V; N];
}

/// Length 2.
impl RealDft<2, 1> for Codelet {
    const FREQUENCIES: [usize; 1] = [0];

    #[inline(always)]
    fn real_dft<V: Vector>([a, b]: [V; 2]) -> [Complex<V>; 1] {
        [Complex::new(a + b, a - b)]
    }

    #[inline(always)]
    fn real_idft<V: Vector>([z]: [Complex<V>; 1]) -> [V; 2] {
        [z.re + z.im, z.re - z.im]
    }
}

/// Length 4.
impl RealDft<4, 2> for Codelet {
    const FREQUENCIES: [usize; 2] = [0, 1];

    #[inline(always)]
    fn real_dft<V: Vector>([a, b, c, d]: [V; 4]) -> [Complex<V>; 2] {
        let (even, odd) = (a + c, b + d);
        [Complex::new(even + odd, even - odd), Complex::new(a - c, d - b)]
    }

    #[inline(always)]
    fn real_idft<V: Vector>([z, y]: [Complex<V>; 2]) -> [V; 4] {
        let (even, odd) = (z.re + z.im, z.re - z.im);
        [even + y.re, odd - y.im, even - y.re, odd + y.im]
    }
}

/// Odd length 7 from its definition; slot `k` is frequency `-k`.
impl RealDft<7, 4> for Codelet {
    const FREQUENCIES: [usize; 4] = [0, 6, 5, 4];

    #[inline(always)]
    fn real_dft<V: Vector>(x: [V; 7]) -> [Complex<V>; 4] {
        let sum = [x[1] + x[6], x[2] + x[5], x[3] + x[4]];
        let difference = [x[1] - x[6], x[2] - x[5], x[3] - x[4]];
        let mut out = [Complex::new(x[0] + sum[0] + (sum[1] + sum[2]), constant(0.0)); 4];
        for k in 1..4 {
            out[k] = Complex::new(plus_cosines(k, sum, x[0]), sines(k, difference));
        }
        out
    }

    #[inline(always)]
    fn real_idft<V: Vector>(y: [Complex<V>; 4]) -> [V; 7] {
        let (re, im) = ([y[1].re, y[2].re, y[3].re], [y[1].im, y[2].im, y[3].im]);
        let mut out = [y[0].re + re[0] + (re[1] + re[2]); 7];
        for n in 1..4 {
            let even = plus_cosines(n, re, y[0].re);
            out[n] = plus_sines(n, im, even);
            out[7 - n] = mirrored(even, out[n]);
        }
        out
    }
}

/// `start + Σ_j a[j] cos(2π (j + 1) k / 7)`
#[inline(always)]
fn plus_cosines<V: Vector>(k: usize, a: [V; 3], start: V) -> V {
    let c = |j: usize| Roots::<7>::TABLE[j * k % 7].0;
    a[2].mul_add(constant(c(3)), a[1].mul_add(constant(c(2)), a[0].mul_add(constant(c(1)), start)))
}

/// `start + Σ_j a[j] sin(2π (j + 1) k / 7)`
#[inline(always)]
fn plus_sines<V: Vector>(k: usize, a: [V; 3], start: V) -> V {
    let s = |j: usize| Roots::<7>::TABLE[j * k % 7].1;
    a[2].mul_add(constant(s(3)), a[1].mul_add(constant(s(2)), a[0].mul_add(constant(s(1)), start)))
}

/// `Σ_j a[j] sin(2π (j + 1) k / 7)`
#[inline(always)]
fn sines<V: Vector>(k: usize, a: [V; 3]) -> V {
    let s = |j: usize| Roots::<7>::TABLE[j * k % 7].1;
    a[2].mul_add(constant(s(3)), a[1].mul_add(constant(s(2)), a[0] * constant(s(1))))
}

/// Powers of two: sums and differences of halves, then one real half and one shifted.
macro_rules! real_power_of_two {
    ($n:literal, $half:literal, $frequencies:expr) => {
        impl RealDft<$n, $half> for Codelet {
            const FREQUENCIES: [usize; $half] = $frequencies;

            #[inline(always)]
            fn real_dft<V: Vector>(x: [V; $n]) -> [Complex<V>; $half] {
                let mut halves = [Complex::new(x[0], x[0]); $half];
                for n in 0..$half {
                    halves[n] = Complex::new(x[n] + x[n + $half], x[n] - x[n + $half]);
                }
                Self::two_real_dft(halves)
            }

            #[inline(always)]
            fn real_idft<V: Vector>(spectrum: [Complex<V>; $half]) -> [V; $n] {
                let halves = Self::two_real_idft(spectrum);
                let mut x = [spectrum[0].re; $n];
                for n in 0..$half {
                    let Complex { re, im } = halves[n];
                    (x[n], x[n + $half]) = (re + im, re - im);
                }
                x
            }
        }
    };
}

real_power_of_two!(8, 4, [0, 2, 1, 5]);
real_power_of_two!(16, 8, [0, 4, 2, 10, 1, 5, 9, 13]);

/// The two real lines, as real and imaginary part of an array of `Q`, that a real DFT of an even length `P` across a line of
/// `P Q` leaves in its slot 0: those of frequencies 0 and `P / 2` modulo `P`.
///
/// `Q = 7`, coprime to `P`: a real DFT of each. `Q` a power of two: the second line is turned by `exp(-πi q / Q)`, which makes
/// it the odd frequencies of a line of `2 Q`, of which `4 m + 1` stand for all.
pub(crate) trait TwoReal<const Q: usize> {
    /// Line of each slot, and the frequency modulo `Q` in it.
    const FREQUENCIES: [(usize, usize); Q];

    /// Slot 0 is frequency 0 and the middle of the whole line of `P Q`.
    fn two_real_dft<V: Vector>(lines: [Complex<V>; Q]) -> [Complex<V>; Q];

    fn two_real_idft<V: Vector>(spectrum: [Complex<V>; Q]) -> [Complex<V>; Q];
}

/// Nothing to do.
impl TwoReal<1> for Codelet {
    const FREQUENCIES: [(usize, usize); 1] = [(0, 0)];

    #[inline(always)]
    fn two_real_dft<V: Vector>(lines: [Complex<V>; 1]) -> [Complex<V>; 1] {
        lines
    }

    #[inline(always)]
    fn two_real_idft<V: Vector>(spectrum: [Complex<V>; 1]) -> [Complex<V>; 1] {
        spectrum
    }
}

impl TwoReal<3> for Codelet {
    const FREQUENCIES: [(usize, usize); 3] = [(0, 0), (0, 2), (1, 2)];

    #[inline(always)]
    fn two_real_dft<V: Vector>([x, y, z]: [Complex<V>; 3]) -> [Complex<V>; 3] {
        let (c, s): (V, V) = (constant(-0.5), constant(Roots::<3>::TABLE[1].1));
        let (sum, difference) = (y + z, y - z);
        let (even, odd) = (sum.scale_add(c, x), difference.scale(s));
        [x + sum, Complex::new(even.re, odd.re), Complex::new(even.im, odd.im)]
    }

    #[inline(always)]
    fn two_real_idft<V: Vector>([x, a, b]: [Complex<V>; 3]) -> [Complex<V>; 3] {
        let (c, s): (V, V) = (constant(-0.5), constant(Roots::<3>::TABLE[1].1));
        let (sum, difference) = (Complex::new(a.re, b.re), Complex::new(a.im, b.im));
        let even = sum.scale_add(c, x);
        [x + sum, difference.scale_add(s, even), difference.neg_scale_add(s, even)]
    }
}

impl TwoReal<7> for Codelet {
    const FREQUENCIES: [(usize, usize); 7] =
        [(0, 0), (0, 6), (0, 5), (0, 4), (1, 6), (1, 5), (1, 4)];

    #[inline(always)]
    fn two_real_dft<V: Vector>(lines: [Complex<V>; 7]) -> [Complex<V>; 7] {
        let (re, im) = parts(lines);
        let (a, b): ([Complex<V>; 4], [Complex<V>; 4]) = (Self::real_dft(re), Self::real_dft(im));
        [Complex::new(a[0].re, b[0].re), a[1], a[2], a[3], b[1], b[2], b[3]]
    }

    #[inline(always)]
    fn two_real_idft<V: Vector>(y: [Complex<V>; 7]) -> [Complex<V>; 7] {
        let a: [V; 7] = Self::real_idft([y[0], y[1], y[2], y[3]]);
        let b: [V; 7] = Self::real_idft([y[0].swap(), y[4], y[5], y[6]]);
        joined(a, b)
    }
}

macro_rules! two_real_power_of_two {
    ($q:literal, $half:literal) => {
        impl TwoReal<$q> for Codelet {
            const FREQUENCIES: [(usize, usize); $q] = {
                let mut frequencies = [(0, 0); $q];
                let mut slot = 0;
                while slot < $half {
                    let even = <Self as RealDft<$q, $half>>::FREQUENCIES[slot];
                    (frequencies[slot], frequencies[slot + $half]) = ((0, even), (1, 2 * slot));
                    slot += 1;
                }
                frequencies
            };

            #[inline(always)]
            fn two_real_dft<V: Vector>(lines: [Complex<V>; $q]) -> [Complex<V>; $q] {
                let (re, im) = parts(lines);
                let even: [Complex<V>; $half] = Self::real_dft(re);
                let mut odd = [even[0]; $half];
                for n in 0..$half {
                    // (a - ib) exp(-πi n / Q)
                    let (a, b) = (im[n], im[n + $half]);
                    let (c, s) = Roots::<{ 2 * $q }>::TABLE[n];
                    odd[n] = Complex::new(
                        b.neg_mul_add(constant(s), a * constant(c)),
                        b.neg_mul_add(constant(c), a * constant(-s)),
                    );
                }
                let odd = Self::dft(odd);
                let mut out = lines;
                for n in 0..$half {
                    (out[n], out[n + $half]) = (even[n], odd[n]);
                }
                out
            }

            #[inline(always)]
            fn two_real_idft<V: Vector>(y: [Complex<V>; $q]) -> [Complex<V>; $q] {
                let (mut even, mut odd) = ([y[0]; $half], [y[0]; $half]);
                for n in 0..$half {
                    (even[n], odd[n]) = (y[n], y[n + $half]);
                }
                let re: [V; $q] = Self::real_idft(even);
                let odd = Self::idft(odd);
                let mut im = re;
                for n in 0..$half {
                    let z = odd[n];
                    let (c, s) = Roots::<{ 2 * $q }>::TABLE[n];
                    im[n] = z.im.neg_mul_add(constant(s), z.re * constant(c));
                    im[n + $half] = z.im.neg_mul_add(constant(c), z.re * constant(-s));
                }
                joined(re, im)
            }
        }
    };
}

two_real_power_of_two!(4, 2);
two_real_power_of_two!(8, 4);
