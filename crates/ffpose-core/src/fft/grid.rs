//! The filter on grids: lanes are channels, a tile of them at a time.
//!
//! Rows forward to columns of complex vectors, each column forward, times the weight and back while it is in cache, rows
//! back. Transforms do not put anything in order; the weight is brought to their order ([`super::pack`]).

use ndarray::{Array3, ArrayView2, ArrayView3, ArrayViewMut2, ArrayViewMut3, Axis, s};

use super::columns::Columns;
use super::pack::{Bins, Packing, Scales};
use super::passes::inverted;
use super::rows::{Place, Rows};
use crate::kernel::{Backward, Kernel};
use crate::parallel::Team;
use crate::simd::{Element, Isa, Tile, TileMut, aligned, slack};

/// Bytes of the lanes of one tile: a cache line, so that every line of an image is used whole.
const TILE_BYTES: usize = 64;

/// The plan for grids of one height and width.
pub(crate) struct Grid<T> {
    isa: Isa,
    lanes: usize,
    points: usize,
    rows: Rows<T>,
    columns: Columns<T>,
    packing: Packing<T>,
}

/// Scratch of one call.
struct Scratch<'a, T> {
    spectrum: &'a mut [T],
    other: &'a mut [T],
    work: &'a mut [T],
    padded: &'a mut [T],
}

impl<T: Element> Grid<T> {
    pub(crate) fn new(isa: Isa, height: usize, width: usize) -> Self {
        let rows = Rows::new(isa, width);
        let row_frequencies = rows.frequencies();
        let even = width.is_multiple_of(2);
        let columns = Columns::new(isa, height, row_frequencies.len(), even);
        let bins = Bins { rows: height, columns: width };
        let frequencies = inverted(columns.transform().outputs());
        let hermitian = if even {
            (0..=height / 2)
                .flat_map(|u| [bins.with_mirror(u, 0), bins.with_mirror(u, width / 2)])
                .collect()
        } else {
            frequencies.iter().map(|&u| bins.with_mirror(u, 0)).collect()
        };
        let plain = row_frequencies[1..]
            .iter()
            .flat_map(|&v| frequencies.iter().map(move |&u| bins.of(u, v)))
            .collect();
        let norm = 1.0 / (height * width) as f64;
        let gain = rows.gain();
        let first_gain = if even { 2.0 * gain } else { gain }; // `split` doubles
        let weight = Scales {
            hermitian: T::nearest(norm / first_gain / 2.0),
            plain: T::nearest(norm / gain * rows.inverse_gain()),
        };
        let gradient = Scales {
            hermitian: T::nearest(norm / (first_gain * first_gain)),
            plain: T::nearest(2.0 * norm / (gain * gain)),
        };
        Self {
            isa,
            lanes: isa.lanes::<T>(),
            points: height * width,
            rows,
            columns,
            packing: Packing::new(hermitian, plain, weight, gradient),
        }
    }

    fn work_len(&self) -> usize {
        (2 * self.lanes * self.rows.work_len()).max(self.columns.work_len())
    }

    fn scratch<'a>(&self, scratch: &'a mut [T]) -> Scratch<'a, T> {
        let (spectrum, rest) = aligned(scratch).split_at_mut(self.columns.len());
        let (other, rest) = rest.split_at_mut(self.columns.len());
        let (work, padded) = rest.split_at_mut(self.work_len());
        Scratch { spectrum, other, work, padded: &mut padded[..self.points * self.lanes] }
    }

    fn place(&self) -> Place<'_> {
        Place { positions: self.columns.transform().inputs(), pitch: self.columns.pitch() }
    }

    /// An image `(points, lanes)` to `spectrum`; `padded` holds it if it has too few lanes.
    fn rows_forward(
        &self,
        image: ArrayView2<'_, T>,
        spectrum: &mut [T],
        work: &mut [T],
        padded: &mut [T],
    ) {
        let lanes = image.ncols();
        let image = if lanes < self.lanes {
            let mut whole = ArrayViewMut2::from_shape((self.points, self.lanes), padded)
                .expect("room for a tile");
            whole.fill(T::default());
            whole.slice_mut(s![.., ..lanes]).assign(&image);
            Tile::dense(padded, self.lanes)
        } else {
            Tile::new(image)
        };
        self.rows.forward(self.isa, image, self.place(), spectrum, work);
    }

    /// `spectrum` to an image `(points, lanes)`, by way of `padded` if it has too few lanes.
    fn rows_inverse(
        &self,
        spectrum: &mut [T],
        mut image: ArrayViewMut2<'_, T>,
        work: &mut [T],
        padded: &mut [T],
    ) {
        let lanes = image.ncols();
        if lanes < self.lanes {
            self.rows.inverse(
                self.isa,
                spectrum,
                self.place(),
                TileMut::dense(padded, self.lanes),
                work,
            );
            let whole =
                ArrayView2::from_shape((self.points, self.lanes), padded).expect("room for a tile");
            image.assign(&whole.slice(s![.., ..lanes]));
        } else {
            self.rows.inverse(self.isa, spectrum, self.place(), TileMut::new(image), work);
        }
    }

    /// Adds the product of the spectra of `x` and `grad` to `sum`; `grad_x` if it is wanted.
    fn backward_lanes(
        &self,
        grad: ArrayView2<'_, T>,
        x: ArrayView2<'_, T>,
        grad_x: Option<(ArrayViewMut2<'_, T>, &[T])>,
        sum: Option<&mut [T]>,
        scratch: &mut Scratch<'_, T>,
    ) {
        let Scratch { spectrum, other, work, padded } = scratch;
        self.rows_forward(grad, spectrum, work, padded);
        match (sum, &grad_x) {
            (Some(sum), grad_x) => {
                self.rows_forward(x, other, work, padded);
                let weight = grad_x.as_ref().map(|(_, weight)| *weight);
                self.columns.gradient(spectrum, other, weight, sum, work);
            }
            (None, Some((_, weight))) => self.columns.filter::<true>(spectrum, weight, work),
            (None, None) => {}
        }
        if let Some((grad_x, _)) = grad_x {
            self.rows_inverse(spectrum, grad_x, work, padded);
        }
    }
}

impl<T: Element> Kernel<T> for Grid<T> {
    fn tile(&self) -> usize {
        self.lanes.max(TILE_BYTES / size_of::<T>())
    }

    fn packed_len(&self) -> usize {
        self.tile() / self.lanes * self.columns.packed_len()
    }

    fn scratch_len(&self) -> usize {
        slack::<T>() + 2 * self.columns.len() + self.work_len() + self.points * self.lanes
    }

    fn pack(&self, weight: ArrayView3<'_, T>, packed: &mut [T], _: &mut Team<'_, T>) {
        let lanes = weight.axis_chunks_iter(Axis(1), self.lanes);
        for (weight, packed) in lanes.zip(packed.chunks_exact_mut(self.columns.packed_len())) {
            let (bins, lanes, _) = weight.dim();
            if lanes < self.lanes {
                let mut whole = Array3::from_elem((bins, self.lanes, 2), T::default());
                whole.slice_mut(s![.., ..lanes, ..]).assign(&weight);
                self.packing.pack(self.isa, whole.view(), packed);
            } else {
                self.packing.pack(self.isa, weight, packed);
            }
        }
    }

    fn forward(
        &self,
        x: ArrayView3<'_, T>,
        packed: &[T],
        mut y: ArrayViewMut3<'_, T>,
        team: &mut Team<'_, T>,
    ) {
        let Scratch { spectrum, work, padded, .. } = self.scratch(team.scratch());
        for (x, mut y) in x.outer_iter().zip(y.outer_iter_mut()) {
            let lanes = x
                .axis_chunks_iter(Axis(1), self.lanes)
                .zip(y.axis_chunks_iter_mut(Axis(1), self.lanes));
            for ((x, y), weight) in lanes.zip(packed.chunks_exact(self.columns.packed_len())) {
                self.rows_forward(x, spectrum, work, padded);
                self.columns.filter::<false>(spectrum, weight, work);
                self.rows_inverse(spectrum, y, work, padded);
            }
        }
    }

    fn backward(&self, pass: Backward<'_, T>, team: &mut Team<'_, T>) {
        let Backward { grad, x, packed, mut grad_x, mut grad_sum } = pass;
        let mut scratch = self.scratch(team.scratch());
        for image in 0..grad.len_of(Axis(0)) {
            for (tile, start) in (0..grad.len_of(Axis(2))).step_by(self.lanes).enumerate() {
                let lanes = s![image, .., start..(start + self.lanes).min(grad.len_of(Axis(2)))];
                let places =
                    tile * self.columns.packed_len()..(tile + 1) * self.columns.packed_len();
                let sum = grad_sum.as_deref_mut().map(|sum| &mut sum[places.clone()]);
                let grad_x =
                    grad_x.as_mut().map(|grad_x| (grad_x.slice_mut(lanes), &packed[places]));
                self.backward_lanes(grad.slice(lanes), x.slice(lanes), grad_x, sum, &mut scratch);
            }
        }
    }

    fn unpack_gradient(
        &self,
        grad_sum: &[T],
        mut grad_weight: ArrayViewMut3<'_, T>,
        _: &mut Team<'_, T>,
    ) {
        let lanes = grad_weight.axis_chunks_iter_mut(Axis(1), self.lanes);
        for (mut gradient, sum) in lanes.zip(grad_sum.chunks_exact(self.columns.packed_len())) {
            let (bins, lanes, _) = gradient.dim();
            if lanes < self.lanes {
                let mut whole = Array3::from_elem((bins, self.lanes, 2), T::default());
                self.packing.unpack(self.isa, sum, whole.view_mut());
                gradient.assign(&whole.slice(s![.., ..lanes, ..]));
            } else {
                self.packing.unpack(self.isa, sum, gradient);
            }
        }
    }
}
