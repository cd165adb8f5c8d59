//! A weight in natural order to the order of the groups, and a gradient back.
//!
//! Vector `j` of a group is frequency `k + M j` along Y, with `k` that of the lane's slot. Up to `Y / 2` these stand in the
//! weight's row of `u`, beyond it in that of `-u` in reverse; either way the lanes of a run are neighbours. The items of slots 0
//! are frequencies 0 and `M / 2` of one pair of rows, put in their places one by one.

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

/// Where a frequency stands among those of a real line of `Y`.
enum Bin {
    /// In the row of `u`.
    Direct(usize),
    /// In the row of `-u`, conjugated.
    Mirror(usize),
    /// In both: the column of DC or of Nyquist.
    Both(usize),
}

/// Where the complex numbers of a run of lanes stand in a weight, before frequencies `M j` are added.
#[derive(Clone, Copy, Default)]
struct Run {
    /// In the row of `u`; the first lane's.
    direct: usize,
    /// In the row of `-u`; the last lane's.
    mirror: usize,
    /// Lanes without a row have no numbers.
    is_filler: bool,
}

impl Plan {
    fn norm(self) -> f64 {
        1.0 / (self.points * self.width) as f64
    }

    /// Columns of a weight.
    fn half(self) -> usize {
        self.width / 2 + 1
    }

    fn bin(self, k: usize) -> Bin {
        match k {
            0 => Bin::Both(0),
            k if 2 * k < self.width => Bin::Direct(k),
            k if 2 * k == self.width => Bin::Both(k),
            k => Bin::Mirror(self.width - k),
        }
    }

    /// The runs of `RUN` lanes of a group.
    #[inline(always)]
    fn runs<const RUN: usize>(self, step: &Step, group: usize, lanes: usize) -> [Run; MAX_LANES] {
        let mut runs = [Run::default(); MAX_LANES];
        for (i, run) in runs.iter_mut().take(lanes / RUN).enumerate() {
            let item = group * lanes + i * RUN;
            let (row, slot) = (item / self.slots, item % self.slots);
            *run = match (step.frequencies[row], step.frequencies[row ^ 1]) {
                (Some(u), Some(minus_u)) => Run {
                    direct: u * self.half() + slot,
                    mirror: minus_u * self.half() + self.width - slot - (RUN - 1),
                    is_filler: false,
                },
                _ => Run { is_filler: true, ..Run::default() },
            };
        }
        runs
    }

    /// The items of slots 0 of a step of so many lanes, each in turn with the bins of its vectors: calls `put` with the rows of `u`
    /// and `-u`, the place of the real part and the bin.
    #[inline(always)]
    fn lone(self, step: &Step, lanes: usize, mut put: impl FnMut([usize; 2], usize, Bin)) {
        for (row, &u) in step.frequencies.iter().enumerate() {
            let pair = row - row % 2;
            let (Some(_), Some(u), Some(minus_u)) =
                (u, step.frequencies[pair], step.frequencies[pair + 1])
            else {
                continue;
            };
            let item = row * self.slots;
            for j in 0..lanes {
                let place = (item / lanes * lanes + j) * 2 * lanes + item % lanes;
                put([u, minus_u], place, self.bin(row % 2 * self.slots + 2 * self.slots * j));
            }
        }
    }
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
        let (weight, half) = (weight.as_chunks::<2>().0, plan.half());
        let scale = V::splat(T::nearest(2.0 * plan.norm()));
        let groups = packed.chunks_exact_mut(2 * V::LANES * V::LANES);
        for (group, packed) in groups.enumerate() {
            let runs = plan.runs::<RUN>(step, group, V::LANES);
            let (direct, mirror) = packed.split_at_mut(V::LANES * V::LANES);
            for j in 0..V::LANES / 2 {
                let mut numbers = [T::default(); 2 * MAX_LANES];
                for (i, run) in
                    runs[..V::LANES / RUN].iter().enumerate().filter(|(_, run)| !run.is_filler)
                {
                    let from = &weight[run.direct + 2 * plan.slots * j..][..RUN];
                    numbers.as_chunks_mut().0[i * RUN..][..RUN].copy_from_slice(from);
                }
                let z = Tile::dense(&numbers, 2 * V::LANES).complex::<V>(0).scale(scale);
                TileMut::dense(direct, V::LANES).scatter(2 * j, 1, [z.re, z.im]);
            }
            for j in 0..V::LANES / 2 {
                let mut numbers = [T::default(); 2 * MAX_LANES];
                for (i, run) in
                    runs[..V::LANES / RUN].iter().enumerate().filter(|(_, run)| !run.is_filler)
                {
                    let from = &weight[run.mirror - 2 * plan.slots * (V::LANES / 2 + j)..][..RUN];
                    numbers.as_chunks_mut().0[V::LANES - (i + 1) * RUN..][..RUN]
                        .copy_from_slice(from);
                }
                let z = Tile::dense(&numbers, 2 * V::LANES).complex::<V>(0).scale(scale);
                TileMut::dense(mirror, V::LANES).scatter(
                    2 * j,
                    1,
                    [z.re.reverse(), -z.im.reverse()],
                );
            }
        }
        let once = T::nearest(0.5 * plan.norm());
        let shared = T::nearest(0.25 * plan.norm());
        plan.lone(step, V::LANES, |[u, minus_u], place, bin| {
            let (re, im) = match bin {
                Bin::Direct(k) => {
                    let z = weight[u * half + k];
                    (z[0] * once, z[1] * once)
                }
                Bin::Mirror(k) => {
                    let z = weight[minus_u * half + k];
                    (z[0] * once, (T::default() - z[1]) * once)
                }
                Bin::Both(k) => {
                    let (z, mirror) = (weight[u * half + k], weight[minus_u * half + k]);
                    ((z[0] + mirror[0]) * shared, (z[1] - mirror[1]) * shared)
                }
            };
            (packed[place], packed[place + V::LANES]) = (re, im);
        });
    }
}

/// The sums of the groups of a step to its rows of `gradient` `(X, Y/2+1)` of complex numbers.
pub(super) struct Unpack<'a, T, const RUN: usize> {
    pub(super) plan: Plan,
    pub(super) step: &'a Step,
    pub(super) sum: &'a [T],
    pub(super) gradient: &'a mut [T],
}

impl<T: Element, const RUN: usize> Algorithm<T> for Unpack<'_, T, RUN> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let Self { plan, step, sum, gradient } = self;
        let (gradient, half) = (gradient.as_chunks_mut::<2>().0, plan.half());
        let scale = V::splat(T::nearest(2.0 * plan.norm()));
        for (group, sum) in sum.chunks_exact(2 * V::LANES * V::LANES).enumerate() {
            let runs = plan.runs::<RUN>(step, group, V::LANES);
            let sum = Tile::dense(sum, V::LANES);
            for j in 0..V::LANES {
                let [re, im] = sum.gather::<V, 2>(2 * j, 1);
                let z = Complex::new(re, im).scale(scale);
                let is_direct = 2 * j < V::LANES;
                let z = if is_direct { z } else { Complex::new(z.re.reverse(), -z.im.reverse()) };
                let mut numbers = [T::default(); 2 * MAX_LANES];
                TileMut::dense(&mut numbers, 2 * V::LANES).set_complex(0, z);
                for (i, run) in
                    runs[..V::LANES / RUN].iter().enumerate().filter(|(_, run)| !run.is_filler)
                {
                    let (to, lane) = if is_direct {
                        (run.direct + 2 * plan.slots * j, i * RUN)
                    } else {
                        (run.mirror - 2 * plan.slots * j, V::LANES - (i + 1) * RUN)
                    };
                    gradient[to..][..RUN].copy_from_slice(&numbers.as_chunks().0[lane..][..RUN]);
                }
            }
        }
        let once = T::nearest(0.5 * plan.norm());
        let shared = T::nearest(0.25 * plan.norm());
        plan.lone(step, V::LANES, |[u, minus_u], place, bin| {
            let (re, im) = (sum[place], sum[place + V::LANES]);
            let minus = T::default() - im;
            match bin {
                Bin::Direct(k) => gradient[u * half + k] = [re * once, im * once],
                Bin::Mirror(k) => gradient[minus_u * half + k] = [re * once, minus * once],
                Bin::Both(k) => {
                    gradient[minus_u * half + k] = [re * shared, minus * shared];
                    gradient[u * half + k] = [re * shared, im * shared];
                }
            }
        });
    }
}
