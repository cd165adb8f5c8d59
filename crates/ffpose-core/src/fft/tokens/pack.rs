//! A weight in natural order to the order of the groups, and a gradient back.
//!
//! Vector `j` of a group is frequency `k + M j` along Y, with `k` that of the lane's slot. Below `Y / 2` these stand in the
//! weight's row of `u`, above it in that of `-u` in reverse; either way the lanes of a run are neighbours. Not so the slots 0:
//! those of a pair of rows are frequencies `M j` and `M / 2 + M j` of `u`, and are put in their places one by one.

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

/// Lanes of neighbouring slots of a row.
#[derive(Clone, Copy, Default)]
struct Run {
    /// The rows of `u` and of `-u`.
    rows: [usize; 2],
    /// Of the first lane.
    slot: usize,
}

/// The slots 0 of a pair of rows.
struct Lone {
    /// The rows of `u` and of `-u`.
    rows: [usize; 2],
    /// Of frequencies `M j`, and of `M / 2 + M j`: where among packed numbers the real part is for `j = 0`.
    places: [usize; 2],
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

    /// Where the lanes of a run are among `M` columns of the row of `u`, counted from column 0, and of that of `-u`, counted from
    /// column 1 and in reverse.
    fn columns<const RUN: usize>(self, slot: usize) -> (usize, usize) {
        (slot, self.stride() - slot - RUN)
    }

    /// The slots 0 of pairs of rows in groups of so many lanes.
    fn lone(self, pairs: &[[usize; 2]], lanes: usize) -> impl Iterator<Item = Lone> {
        pairs.iter().enumerate().map(move |(pair, &rows)| {
            let places = [0, 1].map(|i| {
                let item = (2 * pair + i) * self.slots;
                item / lanes * 2 * lanes * lanes + item % lanes
            });
            Lone { rows, places }
        })
    }
}

/// The runs of `RUN` lanes of pairs of rows, one after the other.
struct Runs<'a, const RUN: usize> {
    pairs: &'a [[usize; 2]],
    slots: usize,
    row: usize,
    slot: usize,
}

impl<'a, const RUN: usize> Runs<'a, RUN> {
    fn new(plan: Plan, pairs: &'a [[usize; 2]]) -> Self {
        Self { pairs, slots: plan.slots, row: 0, slot: 0 }
    }

    /// The next run; none, for fillers, behind the last pair.
    #[inline(always)]
    fn next(&mut self) -> Option<Run> {
        let &[u, minus_u] = self.pairs.get(self.row / 2)?;
        let rows = if self.row.is_multiple_of(2) { [u, minus_u] } else { [minus_u, u] };
        let run = Run { rows, slot: self.slot };
        self.slot += RUN;
        if self.slot == self.slots {
            (self.row, self.slot) = (self.row + 1, 0);
        }
        Some(run)
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
        let (weight, half, stride) = (weight.as_chunks::<2>().0, plan.half(), plan.stride());
        let scale = V::splat(T::nearest(2.0 * plan.norm()));
        let mut runs = Runs::<RUN>::new(plan, &step.frequencies);
        let mut vectors = [[[T::default(); 2]; MAX_LANES]; MAX_LANES];
        for group in packed.chunks_exact_mut(2 * V::LANES * V::LANES) {
            for lane in (0..V::LANES).step_by(RUN) {
                // what fillers are multiplied by is of no account
                let Run { rows: [u, minus_u], slot } = runs.next().unwrap_or_default();
                let columns = plan.columns::<RUN>(slot);
                for (j, row) in weight[u * half..][..half - 1].chunks_exact(stride).enumerate() {
                    vectors[j][lane..][..RUN].copy_from_slice(&row[columns.0..][..RUN]);
                }
                let mirror = weight[minus_u * half + 1..][..half - 1].chunks_exact(stride);
                for (j, row) in mirror.enumerate() {
                    vectors[V::LANES - 1 - j][V::LANES - lane - RUN..][..RUN]
                        .copy_from_slice(&row[columns.1..][..RUN]);
                }
            }
            for (j, packed) in group.chunks_exact_mut(2 * V::LANES).enumerate() {
                let z = Tile::dense(vectors[j].as_flattened(), 2 * V::LANES).complex::<V>(0);
                let z = if 2 * j < V::LANES { z } else { reversed(z) }.scale(scale);
                TileMut::dense(packed, V::LANES).scatter(0, 1, [z.re, z.im]);
            }
        }
        let once = T::nearest(0.5 * plan.norm());
        let shared = T::nearest(0.25 * plan.norm());
        let minus = T::default() - once;
        for Lone { rows: [u, minus_u], places: [even, odd] } in
            plan.lone(&step.frequencies, V::LANES)
        {
            let row = &weight[u * half..][..half];
            let mirror = &weight[minus_u * half..][..half];
            let mut put = |place: usize, j: usize, re: T, im: T| {
                let place = place + 2 * V::LANES * j;
                (packed[place], packed[place + V::LANES]) = (re, im);
            };
            for (j, k) in [(0, 0), (V::LANES / 2, plan.width / 2)] {
                let (z, m) = (row[k], mirror[k]);
                put(even, j, (z[0] + m[0]) * shared, (z[1] - m[1]) * shared);
            }
            for j in 1..V::LANES / 2 {
                let k = plan.stride() * j;
                put(even, j, row[k][0] * once, row[k][1] * once);
                put(even, V::LANES - j, mirror[k][0] * once, mirror[k][1] * minus);
            }
            for j in 0..V::LANES / 2 {
                let k = plan.slots + plan.stride() * j;
                put(odd, j, row[k][0] * once, row[k][1] * once);
                put(odd, V::LANES - 1 - j, mirror[k][0] * once, mirror[k][1] * minus);
            }
        }
    }
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
        let (half, stride) = (plan.half(), plan.stride());
        let scale = V::splat(T::nearest(2.0 * plan.norm()));
        let mut runs = Runs::<RUN>::new(plan, &step.positions);
        let mut vectors = [[[T::default(); 2]; MAX_LANES]; MAX_LANES];
        for group in sum.chunks_exact(2 * V::LANES * V::LANES) {
            for (j, sum) in group.chunks_exact(2 * V::LANES).enumerate() {
                let [re, im] = Tile::dense(sum, V::LANES).gather::<V, 2>(0, 1);
                let z = Complex::new(re, im).scale(scale);
                let z = if 2 * j < V::LANES { z } else { reversed(z) };
                TileMut::dense(vectors[j].as_flattened_mut(), 2 * V::LANES).set_complex(0, z);
            }
            for lane in (0..V::LANES).step_by(RUN) {
                let Some(Run { rows: [u, minus_u], slot }) = runs.next() else { break };
                let columns = plan.columns::<RUN>(slot);
                for (j, row) in gradient[u][..half - 1].chunks_exact_mut(stride).enumerate() {
                    row[columns.0..][..RUN].copy_from_slice(&vectors[j][lane..][..RUN]);
                }
                let mirror = gradient[minus_u][1..].chunks_exact_mut(stride);
                for (j, row) in mirror.enumerate() {
                    row[columns.1..][..RUN].copy_from_slice(
                        &vectors[V::LANES - 1 - j][V::LANES - lane - RUN..][..RUN],
                    );
                }
            }
        }
        let once = T::nearest(0.5 * plan.norm());
        let shared = T::nearest(0.25 * plan.norm());
        let (minus, shared_minus) = (T::default() - once, T::default() - shared);
        for Lone { rows: [row, mirror], places: [even, odd] } in
            plan.lone(&step.positions, V::LANES)
        {
            let at = |place: usize, j: usize| {
                let place = place + 2 * V::LANES * j;
                (sum[place], sum[place + V::LANES])
            };
            for (j, k) in [(0, 0), (V::LANES / 2, plan.width / 2)] {
                let (re, im) = at(even, j);
                gradient[mirror][k] = [re * shared, im * shared_minus];
                gradient[row][k] = [re * shared, im * shared];
            }
            for j in 1..V::LANES / 2 {
                let k = plan.stride() * j;
                let ((re, im), (m_re, m_im)) = (at(even, j), at(even, V::LANES - j));
                gradient[mirror][k] = [m_re * once, m_im * minus];
                gradient[row][k] = [re * once, im * once];
            }
            for j in 0..V::LANES / 2 {
                let k = plan.slots + plan.stride() * j;
                let ((re, im), (m_re, m_im)) = (at(odd, j), at(odd, V::LANES - 1 - j));
                gradient[mirror][k] = [m_re * once, m_im * minus];
                gradient[row][k] = [re * once, im * once];
            }
        }
    }
}
