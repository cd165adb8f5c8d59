//! The sums of a weight's gradient, in the order of the groups, brought to natural order.

use super::steps::Step;
use super::weight::{Run, TokenShape};
use crate::simd::{Algorithm, Complex, Element, MAX_LANES, Tile, TileMut, Vector};

/// The rows of a gradient that belong to a step, of complex numbers, by position.
pub(super) type GradientRows<'a, T> = Vec<&'a mut [[T; 2]]>;

/// The sums of the groups of a step to the gradient.
pub(super) struct UnpackGroups<'a, 'b, T, const RUN: usize> {
    pub(super) shape: TokenShape,
    pub(super) step: &'a Step,
    pub(super) sum: &'a [T],
    pub(super) gradient: &'a mut GradientRows<'b, T>,
}

impl<T: Element, const RUN: usize> Algorithm<T> for UnpackGroups<'_, '_, T, RUN> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let Self { shape, step, sum, gradient } = self;
        let (stride, each) = (shape.stride(), V::LANES / RUN);
        let (twice, once) = (T::nearest(2.0 * shape.norm()), T::nearest(0.5 * shape.norm()));
        let groups = sum.chunks_exact(2 * V::LANES * V::LANES);
        for (group, runs) in groups.zip(step.gradient_runs.chunks(each)) {
            let mut scales = [twice; MAX_LANES];
            for (i, run) in runs.iter().enumerate() {
                for lane in 0..RUN {
                    if (run.columns[0] + lane).is_multiple_of(shape.slots) {
                        scales[i * RUN + lane] = once;
                    }
                }
            }
            let [scale] = Tile::dense(&scales, MAX_LANES).gather::<V, 1>(0, 1);
            for (j, sum) in group.chunks_exact(2 * V::LANES).enumerate() {
                let [re, im] = Tile::dense(sum, V::LANES).gather::<V, 2>(0, 1);
                let z = Complex::new(re, im).scale(scale);
                let is_mirrored = 2 * j >= V::LANES;
                let z = if is_mirrored { Complex::new(z.re.reverse(), -z.im.reverse()) } else { z };
                let mut lanes = [[T::default(); 2]; MAX_LANES];
                TileMut::dense(lanes.as_flattened_mut(), 2 * V::LANES).set_complex(0, z);
                for (i, &Run { rows, columns, .. }) in runs.iter().enumerate() {
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
        let shared = T::nearest(0.25 * shape.norm());
        let pairs = &step.positions;
        for (&[u, minus_u], place) in pairs.iter().zip(shape.zeroth(pairs.len(), V::LANES)) {
            for (j, k) in [(0, 0), (V::LANES / 2, shape.width / 2)] {
                let place = place + 2 * V::LANES * j;
                let (re, im) = (sum[place] * shared, sum[place + V::LANES] * shared);
                gradient[minus_u][k] = [re, T::default() - im];
                gradient[u][k] = [re, im];
            }
        }
    }
}
