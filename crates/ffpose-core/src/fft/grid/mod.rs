//! The filter on grids: lanes are channels, a tile of them at a time.
//!
//! Rows forward to columns of complex vectors, each column forward, times the weight and back while it is in cache, rows
//! back. Transforms do not put anything in order; the weight is brought to their order, or read bin by bin for a single image
//! ([`crate::fft::columns::order`]).

mod packing;
pub(crate) mod row_codelets;
mod row_pairs;
pub(crate) mod rows;
mod single;

use std::ops::Range;

use ndarray::{ArrayView2, ArrayView3, ArrayViewMut2, ArrayViewMut3, Axis, s};

use self::row_codelets::Place;
use self::rows::Rows;
use crate::Shape;
use crate::fft::columns::order::{BinOrder, Bins, Scales};
use crate::fft::columns::{Columns, First};
use crate::fft::transform::inverted;
use crate::kernel::{Backward, Kernel, Packing, Single};
use crate::parallel::Team;
use crate::simd::{Element, Isa, LINE_BYTES, Stored, Tile, TileMut, aligned, slack};
use crate::tuning::Tuning;
use crate::views::{self, BATCH};

/// Lanes of tiles that share `lanes` evenly, of at most `most` unless that is less than a narrow tile; whole cache lines, of half
/// precision too.
fn tile<T>(lanes: usize, most: usize, tuning: &Tuning) -> usize {
    let [narrow, widest] = [tuning.narrow_tile, tuning.widest_tile].map(|b| b / size_of::<T>());
    lanes.div_ceil(lanes.div_ceil(most.clamp(narrow, widest))).next_multiple_of(narrow / 2)
}

/// The plan for grids of one shape.
pub(crate) struct Grid<T> {
    isa: Isa,
    tuning: &'static Tuning,
    /// Lanes of a vector.
    lanes: usize,
    /// Most lanes of a tile.
    tile: usize,
    /// Lanes that go through the transforms together: of several images, and of one alone.
    together: usize,
    alone: usize,
    points: usize,
    /// Numbers in a weight of one vector of lanes, where a tile may have fewer lanes than that.
    padded_bins: usize,
    rows: Rows<T>,
    columns: Columns<T>,
    order: BinOrder<T>,
}

/// The scratch of one call, cut into its uses.
struct GridBuffers<'a, T> {
    spectrum: &'a mut [T],
    other: &'a mut [T],
    work: &'a mut [T],
    padded: &'a mut [T],
    /// A weight and a gradient of fewer lanes than a vector has.
    bins: [&'a mut [T]; 2],
}

impl<T: Element> Grid<T> {
    pub(crate) fn new(isa: Isa, shape: Shape, tuning: &'static Tuning) -> Self {
        let (height, width) = (shape.rows, shape.columns);
        let rows = Rows::new(isa, width);
        let row_frequencies = rows.frequencies();
        let even = width.is_multiple_of(2);
        let first = if even { First::TwoReal } else { First::Complex };
        let columns = Columns::new(isa, height, row_frequencies.len(), first);
        let bins = Bins { rows: height, columns: width };
        let frequencies = inverted(columns.transform().outputs());
        let hermitian = if even {
            (0..=height / 2)
                .flat_map(|u| [bins.with_mirror(u, 0), bins.with_mirror(u, width / 2)])
                .collect()
        } else {
            frequencies.iter().map(|&u| bins.with_mirror(u, 0)).collect()
        };
        let others = row_frequencies[1..]
            .iter()
            .flat_map(|&v| frequencies.iter().map(move |&u| bins.of(u, v)))
            .collect();
        let norm = 1.0 / (height * width) as f64;
        let gain = rows.gain();
        let first_gain = if even { 2.0 * gain } else { gain }; // `split` doubles
        // a weight's and a gradient's alike: columns after the first come back by a factor of 2 / gain
        let plain = T::nearest(2.0 * norm / (gain * gain));
        let weight = Scales { hermitian: T::nearest(norm / first_gain / 2.0), plain };
        let gradient = Scales { hermitian: T::nearest(norm / (first_gain * first_gain)), plain };
        let lanes = isa.lanes::<T>();
        let bytes = columns.packed_len() * size_of::<T>() / lanes;
        let tile = tile::<T>(shape.lanes, tuning.l2_cache / tuning.packed_share / bytes, tuning);
        // a power of two, so that a narrow tile has no rest
        let together = |bytes: usize| {
            let fitting = bytes / (columns.len() * size_of::<T>()) * lanes;
            1 << fitting.min(tile).max(lanes).ilog2()
        };
        let alone = tuning.l2_cache.saturating_sub(tuning.streamed);
        let alone = together(alone.clamp(tuning.least_spectra, tuning.spectra));
        let together = together(tuning.spectra);
        let is_whole = shape.lanes.is_multiple_of(lanes);
        Self {
            isa,
            tuning,
            lanes,
            tile,
            together,
            alone,
            points: height * width,
            padded_bins: if is_whole { 0 } else { 2 * lanes * shape.bins_len() },
            rows,
            columns,
            order: BinOrder { hermitian, others, weight, gradient },
        }
    }

    fn work_len(&self) -> usize {
        (2 * self.lanes * self.rows.work_len()).max(self.columns.work_len())
    }

    fn scratch<'a>(&self, scratch: &'a mut [T]) -> GridBuffers<'a, T> {
        let spectra = self.spectra(self.together);
        let (spectrum, rest) = aligned(scratch).split_at_mut(spectra);
        let (other, rest) = rest.split_at_mut(spectra);
        let (work, rest) = rest.split_at_mut(self.work_len());
        let (padded, rest) = rest.split_at_mut(self.points * self.lanes);
        let (weight, rest) = rest.split_at_mut(self.padded_bins);
        GridBuffers { spectrum, other, work, padded, bins: [weight, &mut rest[..self.padded_bins]] }
    }

    /// `far`: whether images are likely to be in memory, as several are, rather than in cache.
    fn place(&self, far: bool) -> Place<'_> {
        Place {
            positions: self.columns.transform().inputs(),
            pitch: self.columns.pitch(),
            set: self.columns.len() / (2 * self.lanes),
            far,
        }
    }

    /// For several images whose lanes are a part of `x`, with `others` as large as they are.
    fn place_of_several<X>(&self, x: &ArrayView3<'_, X>, others: usize) -> Place<'_> {
        let image = x.stride_of(BATCH).unsigned_abs(); // with the lanes of other parts
        let bytes = (1 + others) * x.len_of(BATCH) * image * size_of::<X>();
        let each = x.len() / x.len_of(BATCH) * size_of::<X>();
        self.place(!self.tuning.are_prefetched(bytes, each))
    }

    /// Parts of `lanes` lanes, at most `together` in each. None has fewer than a vector, unless there are fewer: the last one may
    /// overlap the one before it.
    fn parts(&self, lanes: usize, together: usize) -> impl Iterator<Item = Range<usize>> {
        let last = lanes.saturating_sub(self.lanes);
        (0..lanes).step_by(together).map(move |start| start.min(last)..lanes.min(start + together))
    }

    /// Numbers in the spectra of an image of `lanes` lanes.
    fn spectra(&self, lanes: usize) -> usize {
        lanes.div_ceil(self.lanes) * self.columns.len()
    }

    /// An image `(points, lanes)` to `spectrum`; `padded` holds it if its lanes do not fill a vector.
    fn rows_forward<X: Stored<Real = T>>(
        &self,
        place: Place<'_>,
        image: ArrayView2<'_, X>,
        spectrum: &mut [T],
        work: &mut [T],
        padded: &mut [T],
    ) {
        if image.ncols() < self.lanes {
            let image = Tile::dense(views::padded(image, self.lanes, padded), self.lanes);
            self.rows.forward(self.isa, image, place, spectrum, work);
        } else {
            // a last vector that overlaps goes by itself: rows of 56 points took 1.15 times as long with it among the others
            let (vectors, image) = (image.ncols() / self.lanes, Tile::new(image));
            let (whole, rest) = spectrum.split_at_mut(vectors * self.columns.len());
            self.rows.forward(self.isa, image, place, whole, work);
            if !rest.is_empty() {
                self.rows.forward(self.isa, image.part(vectors, self.lanes), place, rest, work);
            }
        }
    }

    /// `spectrum` to an image `(points, lanes)`, by way of `padded` if its lanes do not fill a vector.
    fn rows_inverse<X: Stored<Real = T>>(
        &self,
        place: Place<'_>,
        spectrum: &mut [T],
        image: ArrayViewMut2<'_, X>,
        work: &mut [T],
        padded: &mut [T],
    ) {
        if image.ncols() < self.lanes {
            let whole = TileMut::dense(&mut *padded, self.lanes);
            self.rows.inverse(self.isa, spectrum, place, whole, work);
            views::unpadded(padded, self.lanes, image);
        } else {
            let (vectors, mut image) = (image.ncols() / self.lanes, TileMut::new(image));
            let (whole, rest) = spectrum.split_at_mut(vectors * self.columns.len());
            if !rest.is_empty() {
                let image = image.part(vectors, self.lanes);
                self.rows.inverse(self.isa, rest, place, image, work);
            }
            self.rows.inverse(self.isa, whole, place, image, work);
        }
    }

    /// Adds the product of the spectra of `x` and `grad` to `sum`; `grad_x` if it is wanted.
    fn backward_lanes<X: Stored<Real = T>>(
        &self,
        place: Place<'_>,
        [grad, x]: [ArrayView2<'_, X>; 2],
        packed: &[T],
        grad_x: Option<ArrayViewMut2<'_, X>>,
        sum: Option<&mut [T]>,
        scratch: &mut GridBuffers<'_, T>,
    ) {
        let GridBuffers { spectrum, other, work, padded, .. } = scratch;
        let spectrum = &mut spectrum[..self.spectra(grad.ncols())];
        let other = &mut other[..spectrum.len()];
        self.rows_forward(place, grad, spectrum, work, padded);
        if sum.is_some() {
            self.rows_forward(place, x, other, work, padded);
        }
        let weight = grad_x.is_some().then_some(packed);
        match (sum, weight) {
            (Some(sum), _) => self.columns.gradient(spectrum, other, weight, sum, work),
            (None, Some(weight)) => self.columns.filter(spectrum, weight, work),
            (None, None) => {}
        }
        if let Some(grad_x) = grad_x {
            self.rows_inverse(place, spectrum, grad_x, work, padded);
        }
    }
}

impl<X: Stored> Kernel<X> for Grid<X::Real> {
    fn tile(&self) -> usize {
        self.tile
    }

    fn narrowest_tile(&self) -> usize {
        LINE_BYTES / size_of::<X>()
    }

    fn scratch_len(&self, _: usize) -> usize {
        slack::<X::Real>()
            + 2 * self.spectra(self.together)
            + self.work_len()
            + self.points * self.lanes
            + 2 * self.padded_bins
    }

    fn packing(&self) -> Option<&dyn Packing<X::Real>> {
        Some(self)
    }

    fn forward(
        &self,
        x: ArrayView3<'_, X>,
        packed: &[X::Real],
        mut y: ArrayViewMut3<'_, X>,
        team: &mut Team<'_, X::Real>,
    ) {
        let GridBuffers { spectrum, work, padded, .. } = self.scratch(team.scratch());
        let packed_len = self.columns.packed_len();
        let place = self.place_of_several(&x, 1);
        for image in 0..x.len_of(BATCH) {
            for lanes in self.parts(x.len_of(Axis(2)), self.together) {
                let spectrum = &mut spectrum[..self.spectra(lanes.len())];
                let packed = &packed[lanes.start.div_ceil(self.lanes) * packed_len..];
                let part = s![image, .., lanes];
                self.rows_forward(place, x.slice(part), spectrum, work, padded);
                self.columns.filter(spectrum, packed, work);
                self.rows_inverse(place, spectrum, y.slice_mut(part), work, padded);
            }
        }
    }

    fn backward(&self, pass: Backward<'_, X>, team: &mut Team<'_, X::Real>) {
        let Backward { grad, x, weight, mut grad_x, mut grad_sum, .. } = pass;
        let mut scratch = self.scratch(team.scratch());
        let (lanes, packed_len) = (grad.len_of(Axis(2)), self.columns.packed_len());
        let place = self.place_of_several(&grad, 2);
        for image in 0..grad.len_of(BATCH) {
            for lanes in self.parts(lanes, self.together) {
                let start = lanes.start.div_ceil(self.lanes) * packed_len;
                let part = s![image, .., lanes];
                self.backward_lanes(
                    place,
                    [grad.slice(part), x.slice(part)],
                    &weight[start..],
                    grad_x.as_mut().map(|grad_x| grad_x.slice_mut(part)),
                    grad_sum.as_deref_mut().map(|sum| &mut sum[start..]),
                    &mut scratch,
                );
            }
        }
    }

    fn unpack_gradient(
        &self,
        grad_sum: &[X::Real],
        grad_weight: ArrayViewMut3<'_, X::Real>,
        team: &mut Team<'_, X::Real>,
    ) {
        let lanes = grad_weight.len_of(Axis(1));
        let grad_sum = &grad_sum[..self.packed_len(lanes)];
        if lanes < self.lanes {
            let mut whole = views::bins(self.scratch(team.scratch()).bins[0], self.lanes);
            self.order.unpack(self.isa, grad_sum, whole.view_mut());
            views::unpadded_bins(whole.view(), grad_weight);
        } else {
            self.order.unpack(self.isa, grad_sum, grad_weight);
        }
    }

    fn single(&self) -> Option<&dyn Single<X>> {
        Some(self)
    }
}
