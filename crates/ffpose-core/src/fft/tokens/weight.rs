//! A weight in natural order, read in that of the groups.
//!
//! Vector `j` of a group is frequency `k + M j` along Y, with `k` that of the lane. Below `Y / 2` these stand in the weight's row
//! of `u`, above it in that of `-u` in reverse; either way the lanes of a run are neighbors.

use crate::simd::{Complex, Element, MAX_LANES, Runs, Tile, Vector};

/// The rows of a weight: real and imaginary part of each bin.
#[derive(Clone, Copy)]
pub(super) struct TokenShape {
    /// Along X and Y.
    pub(super) points: usize,
    pub(super) width: usize,
    pub(super) slots: usize,
}

impl TokenShape {
    pub(super) fn norm(self) -> f64 {
        1.0 / (self.points * self.width) as f64
    }

    /// Columns of a weight.
    pub(super) fn half(self) -> usize {
        self.width / 2 + 1
    }

    /// Frequencies from one vector of a group to the next: `M`.
    pub(super) fn stride(self) -> usize {
        2 * self.slots
    }

    /// Complex vectors from one row of a block to the next: one more than slots, where the row of `-u` has its last frequency. Odd,
    /// since an even number would meet the same few sets of the cache.
    pub(super) fn pitch(self) -> usize {
        self.slots + 1
    }

    /// The runs of `len` items of rows in pairs of `u` and `-u`, which are at `rows` of the block. What has no pair is a filler.
    pub(super) fn runs(self, rows: &[usize], pairs: &[[usize; 2]], len: usize) -> Vec<Run> {
        let run = |(place, first): (usize, usize)| {
            // what fillers are multiplied by is of no account
            let [u, minus_u] = pairs.get(place / 2).copied().unwrap_or_default();
            let is_minus = place % 2;
            let k = first + is_minus;
            Run {
                item: rows[place] * self.pitch() + k,
                rows: if is_minus == 0 { [u, minus_u] } else { [minus_u, u] },
                columns: [k, self.stride() + 1 - k - len],
            }
        };
        let firsts = |place| (0..self.slots).step_by(len).map(move |first| (place, first));
        (0..rows.len()).flat_map(firsts).map(run).collect()
    }

    /// Indices of the real part of `k = 0` among the sums of a step, one for each pair of rows.
    pub(super) fn zeroth(self, pairs: usize, lanes: usize) -> impl Iterator<Item = usize> {
        (0..pairs).map(move |pair| {
            let item = 2 * pair * self.slots;
            item / lanes * 2 * lanes * lanes + item % lanes
        })
    }
}

/// Items of neighboring frequencies of a row.
pub(super) struct Run {
    /// The first among the vectors of a block.
    pub(super) item: usize,
    /// Its row and that of its mirror, and among `M` columns of each the least that has one of the frequencies.
    pub(super) rows: [usize; 2],
    pub(super) columns: [usize; 2],
}

/// A weight `(X, Y/2+1)` in natural order.
pub(super) struct NaturalWeight<'a, T> {
    shape: TokenShape,
    bins: &'a [[T; 2]],
}

/// The weight of a group of `2 J` vectors.
pub(super) struct GroupWeight<'a, T, const RUN: usize, const J: usize> {
    /// Weights of the frequencies below `Y / 2`, and of those above it, whose vectors and lanes are in reverse.
    own: Runs<'a, T, RUN, J>,
    mirror: Runs<'a, T, RUN, J>,
    /// Instead of vectors 0 and `J`, which have the columns of zero and Nyquist, where the Hermitian part counts.
    edges: [[[T; 2]; MAX_LANES]; 2],
}

impl<'a, T: Element> NaturalWeight<'a, T> {
    pub(super) fn new(shape: TokenShape, weight: &'a [T]) -> Self {
        Self { shape, bins: weight.as_chunks().0 }
    }

    /// The weight of the group of such runs.
    #[inline(always)]
    pub(super) fn group<V: Vector<Element = T>, const RUN: usize, const J: usize>(
        &self,
        runs: &[Run],
    ) -> GroupWeight<'a, T, RUN, J> {
        let (shape, half, stride) = (self.shape, self.shape.half(), self.shape.stride());
        let (mut own, mut mirror) = ([0; MAX_LANES], [0; MAX_LANES]);
        let mut edges = [[[T::default(); 2]; MAX_LANES]; 2];
        for i in 0..V::LANES / RUN {
            let (lane, mirrored) = (i * RUN, V::LANES - (i + 1) * RUN);
            let Run { rows: [u, minus_u], columns, .. } = runs[i];
            own[i] = u * half + columns[0];
            mirror[mirrored / RUN] = minus_u * half + columns[1];
            let nyquist = mirror[mirrored / RUN] + stride * (J - 1);
            edges[0][lane..][..RUN].copy_from_slice(&self.bins[own[i]..][..RUN]);
            edges[1][mirrored..][..RUN].copy_from_slice(&self.bins[nyquist..][..RUN]);
            if columns[0] == 0 {
                let last = shape.width / 2;
                let bin = |row: usize, k: usize| self.bins[row * half + k];
                edges[0][lane] = hermitian(bin(u, 0), bin(minus_u, 0));
                edges[1][V::LANES - 1 - lane] = hermitian(bin(minus_u, last), bin(u, last));
            }
        }
        GroupWeight {
            own: Runs::new::<V>(self.bins, &own, stride),
            mirror: Runs::new::<V>(self.bins, &mirror, stride),
            edges,
        }
    }
}

impl<T: Element, const RUN: usize, const J: usize> GroupWeight<'_, T, RUN, J> {
    /// `z` times vector `j`, or times its conjugate.
    #[inline(always)]
    pub(super) fn times<V: Vector<Element = T>, const CONJUGATE: bool>(
        &self,
        j: usize,
        z: Complex<V>,
    ) -> Complex<V> {
        let is_mirrored = j >= J;
        let weight = if j.is_multiple_of(J) {
            let [low, high] = Tile::dense(self.edges[j / J].as_flattened(), V::LANES).gather(0, 1);
            let (re, im) = if is_mirrored {
                V::deinterleave_reversed(low, high)
            } else {
                V::deinterleave(low, high)
            };
            Complex::new(re, im)
        } else if is_mirrored {
            self.mirror.complex_reversed(2 * J - 1 - j)
        } else {
            self.own.complex(j)
        };
        if CONJUGATE == is_mirrored { z.times(weight) } else { z.times_conj(weight) }
    }
}

/// The mean of a number and the conjugate of another.
fn hermitian<T: Element>(a: [T; 2], b: [T; 2]) -> [T; 2] {
    let half = T::nearest(0.5);
    [(a[0] + b[0]) * half, (a[1] - b[1]) * half]
}
