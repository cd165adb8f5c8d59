//! DFTs of small fixed lengths across vectors.
//!
//! A codelet takes and gives an array by value: inlined, the array is registers. Input and output are in natural order.
//! Lengths: powers of two to 16, odd primes to 13.

use super::roots::Roots;
use super::unroll::unroll;
use crate::simd::{Complex, Element, Vector, mirrored, parts};

/// Where the codelets live: `Codelet: Dft<N>` for every length `N` that has one.
pub(crate) struct Codelet;

/// `X[k] = Σ_n x[n] exp(-2πi k n / N)` for an array of `N` complex vectors.
pub(crate) trait Dft<const N: usize> {
    fn dft<V: Vector>(x: [Complex<V>; N]) -> [Complex<V>; N];

    /// The unnormalized inverse: the forward codelet between two exchanges of real and imaginary parts, which cost nothing, as
    /// they rename registers.
    #[inline(always)]
    fn idft<V: Vector>(x: [Complex<V>; N]) -> [Complex<V>; N] {
        swap(Self::dft(swap(x)))
    }
}

macro_rules! codelets {
    ($($length:literal $dft:expr),*) => {
        $(impl Dft<$length> for Codelet {
            #[inline(always)]
            fn dft<V: Vector>(x: [Complex<V>; $length]) -> [Complex<V>; $length] {
                $dft(x)
            }
        })*
    };
}

codelets!(
    1 dft1,
    2 dft2,
    3 odd::<V, 3, 2>,
    4 dft4,
    5 odd::<V, 5, 3>,
    7 odd::<V, 7, 4>,
    8 dft8,
    11 odd::<V, 11, 6>,
    13 odd::<V, 13, 7>,
    16 dft16
);

#[inline(always)]
fn swap<V: Vector, const N: usize>(mut x: [Complex<V>; N]) -> [Complex<V>; N] {
    for z in &mut x {
        *z = z.swap();
    }
    x
}

#[inline(always)]
pub(super) fn constant<V: Vector>(x: f64) -> V {
    V::splat(V::Element::nearest(x))
}

#[inline(always)]
fn dft1<V: Vector>(x: [Complex<V>; 1]) -> [Complex<V>; 1] {
    x
}

#[inline(always)]
fn dft2<V: Vector>([a, b]: [Complex<V>; 2]) -> [Complex<V>; 2] {
    [a + b, a - b]
}

#[inline(always)]
fn dft4<V: Vector>([a, b, c, d]: [Complex<V>; 4]) -> [Complex<V>; 4] {
    let (p, q, r, s) = (a + c, a - c, b + d, b - d);
    [p + r, q.sub_i(s), p - r, q.add_i(s)]
}

/// Even and odd inputs; the turns by an eighth are folded in the last additions.
#[inline(always)]
fn dft8<V: Vector>(x: [Complex<V>; 8]) -> [Complex<V>; 8] {
    let half = constant(std::f64::consts::FRAC_1_SQRT_2);
    let e = dft4([x[0], x[2], x[4], x[6]]);
    let o = dft4([x[1], x[3], x[5], x[7]]);
    let one = o[1].sub_i(o[1]); // √2 w o
    let three = o[3].add_i(o[3]); // -√2 w³ o
    [
        e[0] + o[0],
        one.scale_add(half, e[1]),
        e[2].sub_i(o[2]),
        three.neg_scale_add(half, e[3]),
        e[0] - o[0],
        one.neg_scale_add(half, e[1]),
        e[2].add_i(o[2]),
        three.scale_add(half, e[3]),
    ]
}

/// Odd length `N` from its definition, with the sums and differences of mirrored inputs shared by mirrored outputs; `END` is
/// `N / 2 + 1`.
#[inline(always)]
fn odd<V: Vector, const N: usize, const END: usize>(x: [Complex<V>; N]) -> [Complex<V>; N] {
    let (mut sum, mut difference) = (x, x);
    let mut out = x;
    unroll!(j in 1..END {
        sum[j] = x[j] + x[N - j];
        difference[j] = x[j] - x[N - j];
        out[0] = out[0] + sum[j];
    });
    // real parts of all outputs, then imaginary ones: either half is as many numbers as fit in registers
    unroll!(k in 1..END {
        let even = plus_cosines::<V, N, END>(k, x[0].re, parts(sum).0);
        out[k].re = plus_sines::<V, N, END>(k, even, parts(difference).1);
        out[N - k].re = mirrored(even, out[k].re);
    });
    unroll!(k in 1..END {
        let even = plus_cosines::<V, N, END>(k, x[0].im, parts(sum).1);
        out[N - k].im = plus_sines::<V, N, END>(k, even, parts(difference).0);
        out[k].im = mirrored(even, out[N - k].im);
    });
    out
}

/// `start + Σ_j a[j] cos(2π j k / N)` for `0 < j < END`
#[inline(always)]
fn plus_cosines<V: Vector, const N: usize, const END: usize>(k: usize, start: V, a: [V; N]) -> V {
    let mut total = start;
    unroll!(j in 1..END {
        total = a[j].mul_add(constant(Roots::<N>::TABLE[j * k % N].0), total);
    });
    total
}

/// `start + Σ_j a[j] sin(2π j k / N)` for `0 < j < END`
#[inline(always)]
fn plus_sines<V: Vector, const N: usize, const END: usize>(k: usize, start: V, a: [V; N]) -> V {
    let mut total = start;
    unroll!(j in 1..END {
        total = a[j].mul_add(constant(Roots::<N>::TABLE[j * k % N].1), total);
    });
    total
}

/// 4 by 4: input `n = 4 p + q`, a twiddle, output `k = p + 4 q`.
#[inline(always)]
fn dft16<V: Vector>(x: [Complex<V>; 16]) -> [Complex<V>; 16] {
    let mut rows = [[x[0]; 4]; 4];
    for q in 0..4 {
        let column = dft4([x[q], x[4 + q], x[8 + q], x[12 + q]]);
        for p in 0..4 {
            rows[p][q] = times_root::<V, 16>(column[p], p * q);
        }
    }
    let mut out = x;
    for p in 0..4 {
        let row = dft4(rows[p]);
        for q in 0..4 {
            out[p + 4 * q] = row[q];
        }
    }
    out
}

/// `z exp(-2πi k / N)`, `k` a constant once inlined.
#[inline(always)]
pub(crate) fn times_root<V: Vector, const N: usize>(z: Complex<V>, k: usize) -> Complex<V> {
    let half: V = constant(std::f64::consts::FRAC_1_SQRT_2);
    let eighths = 8 * (k % N);
    if eighths == 0 {
        z
    } else if eighths == N {
        z.sub_i(z).scale(half)
    } else if eighths == 2 * N {
        Complex::new(z.im, -z.re)
    } else if eighths == 3 * N {
        Complex::new((z.im - z.re) * half, (z.re + z.im) * -half)
    } else {
        let (c, s) = Roots::<N>::TABLE[k % N];
        z.times_conj(Complex::new(constant(c), constant(s)))
    }
}
