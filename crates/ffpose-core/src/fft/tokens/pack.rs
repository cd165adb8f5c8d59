//! A weight in natural order to the order of the groups, and a gradient back.
//!
//! Vector `j` of a group is frequency `k + M j` along Y, with `k` that of the lane. Below `Y / 2` these stand in the weight's row
//! of `u`, above it in that of `-u` in reverse; either way the lanes of a run are neighbours.

use super::order::Step;
use crate::simd::{Algorithm, Complex, Element, MAX_LANES, Tile, TileMut, Vector};

/// The rows of a weight: real and imaginary part of each bin.
#[derive(Clone, Copy)]
pub(super) struct Plan {
    /// Along X and Y.
    pub(super) points: usize,
    pub(super) width: usize,
    pub(super) slots: usize,
}

impl Plan {
    fn norm(self) -> f64 {
        1.0 / (self.points * self.width) as f64
    }

    /// Columns of a weight.
    fn half(self) -> usize {
        self.width / 2 + 1
    }

    /// Frequencies from one vector of a group to the next: `M`.
    fn stride(self) -> usize {
        2 * self.slots
    }

    /// The run of `RUN` items from `first` on of rows in pairs; none in fillers, which are behind the last pair.
    #[inline(always)]
    fn run<const RUN: usize>(self, pairs: &[[usize; 2]], first: usize) -> Option<Run> {
        let row = first / self.slots;
        let &[u, minus_u] = pairs.get(row / 2)?;
        let is_minus = row % 2;
        let (own, mirror) = if is_minus == 0 { (u, minus_u) } else { (minus_u, u) };
        let k = first % self.slots + is_minus;
        Some(Run { rows: [own, mirror], columns: [k, self.stride() + 1 - k - RUN] })
    }

    /// Of each pair of rows where among packed numbers the real part of `k = 0` is.
    fn zeroth(self, pairs: usize, lanes: usize) -> impl Iterator<Item = usize> {
        (0..pairs).map(move |pair| {
            let item = 2 * pair * self.slots;
            item / lanes * 2 * lanes * lanes + item % lanes
        })
    }
}

/// Lanes of neighbouring frequencies of a row: its row and that of its mirror, and among `M` columns of each the least that has
/// one of them.
#[derive(Clone, Copy, Default)]
struct Run {
    rows: [usize; 2],
    columns: [usize; 2],
}

/// `weight` `(X, Y/2+1)` of complex numbers to the groups of a step.
pub(super) struct Pack<'a, T, const RUN: usize> {
    pub(super) plan: Plan,
    pub(super) step: &'a Step,
    pub(super) weight: &'a [T],
    pub(super) packed: &'a mut [T],
}

impl<T: Element, const RUN: usize> Algorithm<T> for Pack<'_, T, RUN> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let Self { plan, step, weight, packed } = self;
        let pairs = &step.frequencies;
        let (weight, half, stride) = (weight.as_chunks::<2>().0, plan.half(), plan.stride());
        for (number, group) in packed.chunks_exact_mut(2 * V::LANES * V::LANES).enumerate() {
            let (mut own, mut mirror) = ([0; MAX_LANES], [0; MAX_LANES]);
            for i in 0..V::LANES / RUN {
                // what fillers are multiplied by is of no account
                let first = number * V::LANES + i * RUN;
                let Run { rows, columns } = plan.run::<RUN>(pairs, first).unwrap_or_default();
                own[i] = rows[0] * half + columns[0];
                mirror[V::LANES / RUN - 1 - i] = rows[1] * half + columns[1];
            }
            let (low, high) = group.split_at_mut(V::LANES * V::LANES);
            for (j, packed) in low.chunks_exact_mut(2 * V::LANES).enumerate() {
                let z = runs_at::<V, RUN>(weight, &own, stride * j);
                TileMut::dense(packed, V::LANES).scatter(0, 1, [z.re, z.im]);
            }
            for (j, packed) in high.chunks_exact_mut(2 * V::LANES).rev().enumerate() {
                let z = reversed(runs_at::<V, RUN>(weight, &mirror, stride * j));
                TileMut::dense(packed, V::LANES).scatter(0, 1, [z.re, z.im]);
            }
        }
        // of the columns of zero and Nyquist, the Hermitian part
        for (&[u, minus_u], place) in pairs.iter().zip(plan.zeroth(pairs.len(), V::LANES)) {
            for (j, k) in [(0, 0), (V::LANES / 2, plan.width / 2)] {
                let (z, m) = (weight[u * half + k], weight[minus_u * half + k]);
                let place = place + 2 * V::LANES * j;
                packed[place] = (z[0] + m[0]) * T::nearest(0.5);
                packed[place + V::LANES] = (z[1] - m[1]) * T::nearest(0.5);
            }
        }
    }
}

/// The complex numbers of runs that begin at `starts`, counted from `offset`.
#[inline(always)]
fn runs_at<V: Vector, const RUN: usize>(
    numbers: &[[V::Element; 2]],
    starts: &[usize; MAX_LANES],
    offset: usize,
) -> Complex<V> {
    let mut lanes = [[V::Element::default(); 2]; MAX_LANES];
    for i in 0..V::LANES / RUN {
        lanes[i * RUN..][..RUN].copy_from_slice(&numbers[starts[i] + offset..][..RUN]);
    }
    Tile::dense(lanes.as_flattened(), 2 * V::LANES).complex(0)
}

/// The conjugate with the lanes in reverse.
#[inline(always)]
fn reversed<V: Vector>(z: Complex<V>) -> Complex<V> {
    Complex::new(z.re.reverse(), -z.im.reverse())
}

/// The rows of a gradient that belong to a step, of complex numbers, by position.
pub(super) type GradientRows<'a, T> = Vec<&'a mut [[T; 2]]>;

/// The sums of the groups of a step to the gradient.
pub(super) struct Unpack<'a, 'b, T, const RUN: usize> {
    pub(super) plan: Plan,
    pub(super) step: &'a Step,
    pub(super) sum: &'a [T],
    pub(super) gradient: &'a mut GradientRows<'b, T>,
}

impl<T: Element, const RUN: usize> Algorithm<T> for Unpack<'_, '_, T, RUN> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let Self { plan, step, sum, gradient } = self;
        let (stride, pairs) = (plan.stride(), &step.positions);
        let (twice, once) = (T::nearest(2.0 * plan.norm()), T::nearest(0.5 * plan.norm()));
        for (number, group) in sum.chunks_exact(2 * V::LANES * V::LANES).enumerate() {
            let mut scales = [twice; MAX_LANES];
            let mut runs = [Run::default(); MAX_LANES];
            let mut known = 0; // runs before fillers
            for i in 0..V::LANES / RUN {
                let first = number * V::LANES + i * RUN;
                let Some(run) = plan.run::<RUN>(pairs, first) else { break };
                for lane in 0..RUN {
                    if (run.columns[0] + lane).is_multiple_of(plan.slots) {
                        scales[i * RUN + lane] = once;
                    }
                }
                (runs[i], known) = (run, i + 1);
            }
            let [scale] = Tile::dense(&scales, MAX_LANES).gather::<V, 1>(0, 1);
            for (j, sum) in group.chunks_exact(2 * V::LANES).enumerate() {
                let [re, im] = Tile::dense(sum, V::LANES).gather::<V, 2>(0, 1);
                let z = Complex::new(re, im).scale(scale);
                let is_mirrored = 2 * j >= V::LANES;
                let z = if is_mirrored { reversed(z) } else { z };
                let mut lanes = [[T::default(); 2]; MAX_LANES];
                TileMut::dense(lanes.as_flattened_mut(), 2 * V::LANES).set_complex(0, z);
                for i in 0..known {
                    let Run { rows, columns } = runs[i];
                    let (row, column, lane) = if is_mirrored {
                        let above = stride * (V::LANES - 1 - j);
                        (rows[1], columns[1] + above, V::LANES - (i + 1) * RUN)
                    } else {
                        (rows[0], columns[0] + stride * j, i * RUN)
                    };
                    gradient[row][column..][..RUN].copy_from_slice(&lanes[lane..][..RUN]);
                }
            }
        }
        // of the columns of zero and Nyquist, to both rows, each of which is a column of its own
        let shared = T::nearest(0.25 * plan.norm());
        for (&[u, minus_u], place) in pairs.iter().zip(plan.zeroth(pairs.len(), V::LANES)) {
            for (j, k) in [(0, 0), (V::LANES / 2, plan.width / 2)] {
                let place = place + 2 * V::LANES * j;
                let (re, im) = (sum[place] * shared, sum[place + V::LANES] * shared);
                gradient[minus_u][k] = [re, T::default() - im];
                gradient[u][k] = [re, im];
            }
        }
    }
}
