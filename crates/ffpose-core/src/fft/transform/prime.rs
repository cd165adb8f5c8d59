//! DFTs of odd prime lengths without a codelet, from the definition: `p²` operations, half of them shared by mirrored outputs.

use crate::simd::{Complex, Vector};

/// Outputs computed together, so that each input is loaded once for all of them.
const TOGETHER: usize = 2;

/// The DFT, or its inverse, of `line[start]`, `line[start + stride]`, ..., in place; `work` has a place for each,
/// and `roots` are `exp(-2πi k / p)`.
#[inline(always)]
pub(crate) fn dft<V: Vector, const INVERSE: bool>(
    roots: &[Complex<V::Element>],
    line: &mut [Complex<V>],
    start: usize,
    stride: usize,
    work: &mut [Complex<V>],
) {
    let p = roots.len();
    let half = p / 2;
    let pairs = &mut work.as_chunks_mut::<2>().0[..half];
    let first = line[start];
    let mut total = first;
    for (j, pair) in pairs.iter_mut().enumerate() {
        let (a, b) = (line[start + (j + 1) * stride], line[start + (p - j - 1) * stride]);
        *pair = if INVERSE { [a + b, b - a] } else { [a + b, a - b] };
        total = total + pair[0];
    }
    line[start] = total;
    for k in (1..=half).step_by(TOGETHER) {
        let together: [usize; TOGETHER] = [k, (k + 1).min(half)];
        let mut even = [first; TOGETHER];
        let mut odd = [Complex::zero(); TOGETHER];
        let mut index = [0; TOGETHER];
        for [sum, difference] in &*pairs {
            for i in 0..TOGETHER {
                index[i] += together[i];
                if index[i] >= p {
                    index[i] -= p;
                }
                let root = roots[index[i]];
                even[i] = sum.scale_add(V::splat(root.re), even[i]);
                odd[i] = difference.scale_add(V::splat(root.im), odd[i]);
            }
        }
        for i in 0..TOGETHER {
            line[start + together[i] * stride] = even[i].add_i(odd[i]);
            line[start + (p - together[i]) * stride] = even[i].sub_i(odd[i]);
        }
    }
}
