//! The filter on tokens: one plane, whose second axis is contiguous.
//!
//! Transforms along X first: lanes are elements of Y, two vectors of them one complex line, so that all of it is complex
//! transforms without a shuffle. Half of the spectrum in X is kept, as rows of Y. Then transforms along Y, for as many rows
//! together as there are lanes: squares of vectors are transposed on the way in and on the way out, next to the product. Then
//! back along X. Rows 0 and `X / 2`, which stand for real lines, need nothing of their own: their weight is Hermitian.

mod order;
mod squares;
mod vectors;

use ndarray::{ArrayView2, ArrayView3, ArrayViewMut2, ArrayViewMut3};

use self::order::SquareOrder;
use self::squares::{Gather, Put, RowBlock};
use self::vectors::{EnterVectors, JoinVectors, LeaveVectors, SplitVectors};
use crate::fft::columns::{Columns, First};
use crate::fft::transform::Transform;
use crate::kernel::{Backward, Factor, Kernel, Packing};
use crate::parallel::Team;
use crate::simd::{Element, Isa, Tile, TileMut, aligned, slack};
use crate::views::{self, BATCH};

/// The plan for planes `(points, width)`.
pub(crate) struct Planes<T> {
    isa: Isa,
    lanes: usize,
    width: usize,
    along_x: Transform<T>,
    along_y: Columns<T>,
    order: SquareOrder<T>,
}

/// The scratch of one call, cut into its uses.
struct PlanesBuffers<'a, T> {
    spectrum: &'a mut [T],
    other: &'a mut [T],
    line: &'a mut [T],
    other_line: &'a mut [T],
    work: &'a mut [T],
    padded: &'a mut [T],
}

/// Rows of a spectrum, `pitch` complex vectors apart.
#[derive(Clone, Copy)]
struct SpectrumRows {
    count: usize,
    pitch: usize,
}

impl<T: Element> Planes<T> {
    pub(crate) fn new(isa: Isa, points: usize, width: usize) -> Self {
        let along_x = Transform::new(isa, points);
        let along_y = Columns::new(isa, width, 1, First::Complex);
        let outputs = along_y.transform().outputs().to_vec();
        let order = SquareOrder::new(points, outputs, isa.lanes::<T>());
        Self { isa, lanes: isa.lanes::<T>(), width, along_x, along_y, order }
    }

    /// Width up to a whole number of pairs of vectors.
    fn padded_width(&self) -> usize {
        self.width.next_multiple_of(2 * self.lanes)
    }

    /// Rows of the half spectrum; an odd pitch, since an even one would meet the same few sets of the cache.
    fn rows(&self) -> SpectrumRows {
        SpectrumRows {
            count: self.along_x.len() / 2 + 1,
            pitch: (self.padded_width() / self.lanes) | 1,
        }
    }

    /// Blocks of rows that are transformed together.
    fn blocks(&self) -> usize {
        self.rows().count.div_ceil(self.lanes)
    }

    fn spectrum_len(&self) -> usize {
        2 * self.lanes * self.rows().count * self.rows().pitch
    }

    fn line_len(&self) -> usize {
        2 * self.lanes * self.along_x.len().max(self.along_y.pitch())
    }

    fn work_len(&self) -> usize {
        (2 * self.lanes * self.along_x.work_len()).max(self.along_y.work_len())
    }

    fn padded_len(&self) -> usize {
        if self.width < self.padded_width() { self.along_x.len() * self.padded_width() } else { 0 }
    }

    fn scratch<'a>(&self, scratch: &'a mut [T]) -> PlanesBuffers<'a, T> {
        let (spectrum, rest) = aligned(scratch).split_at_mut(self.spectrum_len());
        let (other, rest) = rest.split_at_mut(self.spectrum_len());
        let (line, rest) = rest.split_at_mut(self.line_len());
        let (other_line, rest) = rest.split_at_mut(self.line_len());
        let (work, rest) = rest.split_at_mut(self.work_len());
        let padded = &mut rest[..self.padded_len()];
        PlanesBuffers { spectrum, other, line, other_line, work, padded }
    }

    /// An image `(points, width)` to rows of its spectrum; `padded` holds it if its width is no multiple of two vectors.
    fn forward_x(
        &self,
        image: ArrayView2<'_, T>,
        spectrum: &mut [T],
        line: &mut [T],
        work: &mut [T],
        padded: &mut [T],
    ) {
        let image = if padded.is_empty() {
            Tile::new(image)
        } else {
            let width = self.padded_width();
            Tile::dense(views::padded(image, width, padded), width)
        };
        let line = &mut line[..2 * self.lanes * self.along_x.len()];
        for pair in 0..self.padded_width() / (2 * self.lanes) {
            let image = image.skip_lanes(2 * pair * self.lanes);
            self.isa.run(EnterVectors { image, inputs: self.along_x.inputs(), line });
            self.along_x.forward(line, work);
            let outputs = self.along_x.outputs();
            self.isa.run(SplitVectors { outputs, line, spectrum, rows: self.rows(), pair });
        }
    }

    /// Undoes [`forward_x`](Self::forward_x), up to a factor.
    fn inverse_x(
        &self,
        spectrum: &mut [T],
        image: ArrayViewMut2<'_, T>,
        line: &mut [T],
        work: &mut [T],
        padded: &mut [T],
    ) {
        if padded.is_empty() {
            self.inverse_tile(spectrum, TileMut::new(image), line, work);
        } else {
            let width = self.padded_width();
            self.inverse_tile(spectrum, TileMut::dense(padded, width), line, work);
            views::unpadded(padded, width, image);
        }
    }

    fn inverse_tile(
        &self,
        spectrum: &mut [T],
        mut image: TileMut<'_, T>,
        line: &mut [T],
        work: &mut [T],
    ) {
        let line = &mut line[..2 * self.lanes * self.along_x.len()];
        let (inputs, outputs) = (self.along_x.inputs(), self.along_x.outputs());
        for pair in 0..self.padded_width() / (2 * self.lanes) {
            self.isa.run(JoinVectors { outputs, line, spectrum, rows: self.rows(), pair });
            self.along_x.inverse(line, work);
            let image = image.skip_lanes(2 * pair * self.lanes);
            self.isa.run(LeaveVectors { image, inputs, line });
        }
    }

    /// Lanes of a block from and to rows, in the order of the transform along Y.
    fn block(&self, block: usize) -> RowBlock<'_> {
        let inputs = self.along_y.transform().inputs();
        RowBlock { rows: self.rows(), first: block * self.lanes, inputs }
    }

    /// The block's numbers of a packed weight.
    fn block_len(&self) -> usize {
        self.along_y.packed_len()
    }
}

impl<T: Element> Packing<T> for Planes<T> {
    fn packed_len(&self, _: usize) -> usize {
        self.blocks() * self.block_len()
    }

    fn pack(
        &self,
        weight: ArrayView3<'_, T>,
        factor: Factor,
        packed: &mut [T],
        _: &mut Team<'_, T>,
    ) {
        self.order.pack(self.isa, weight, factor, packed);
    }
}

impl<T: Element> Kernel<T> for Planes<T> {
    fn tile(&self) -> usize {
        self.width
    }

    fn scratch_len(&self) -> usize {
        let lines = 2 * (self.spectrum_len() + self.line_len());
        slack::<T>() + lines + self.work_len() + self.padded_len()
    }

    fn packing(&self) -> Option<&dyn Packing<T>> {
        Some(self)
    }

    fn sum_len(&self, lanes: usize) -> usize {
        self.packed_len(lanes)
    }

    fn forward(
        &self,
        x: ArrayView3<'_, T>,
        packed: &[T],
        mut y: ArrayViewMut3<'_, T>,
        team: &mut Team<'_, T>,
    ) {
        let PlanesBuffers { spectrum, line, work, padded, .. } = self.scratch(team.scratch());
        for (x, y) in x.outer_iter().zip(y.outer_iter_mut()) {
            self.forward_x(x, spectrum, line, work, padded);
            for (block, weight) in packed.chunks_exact(self.block_len()).enumerate() {
                let block = self.block(block);
                self.isa.run(Gather { block, spectrum, line });
                self.along_y.filter(&mut line[..self.along_y.len()], weight, work);
                self.isa.run(Put { block, spectrum, line });
            }
            self.inverse_x(spectrum, y, line, work, padded);
        }
    }

    fn backward(&self, pass: Backward<'_, T>, team: &mut Team<'_, T>) {
        let Backward { grad, x, weight: packed, mut grad_x, mut grad_sum, .. } = pass;
        let PlanesBuffers { spectrum, other, line, other_line, work, padded } =
            self.scratch(team.scratch());
        for image in 0..grad.len_of(BATCH) {
            self.forward_x(grad.index_axis(BATCH, image), spectrum, line, work, padded);
            if grad_sum.is_some() {
                self.forward_x(x.index_axis(BATCH, image), other, line, work, padded);
            }
            for block in 0..self.blocks() {
                let places = block * self.block_len()..(block + 1) * self.block_len();
                let block = self.block(block);
                self.isa.run(Gather { block, spectrum, line });
                if let Some(sum) = &mut grad_sum {
                    self.isa.run(Gather { block, spectrum: other, line: other_line });
                    let weight = grad_x.is_some().then(|| &packed[places.clone()]);
                    let len = self.along_y.len();
                    let (line, other_line) = (&mut line[..len], &mut other_line[..len]);
                    self.along_y.gradient(line, other_line, weight, &mut sum[places], work);
                } else {
                    let line = &mut line[..self.along_y.len()];
                    self.along_y.filter(line, &packed[places], work);
                }
                if grad_x.is_some() {
                    self.isa.run(Put { block, spectrum, line });
                }
            }
            if let Some(grad_x) = &mut grad_x {
                let grad_x = grad_x.index_axis_mut(BATCH, image);
                self.inverse_x(spectrum, grad_x, line, work, padded);
            }
        }
    }

    fn unpack_gradient(
        &self,
        grad_sum: &[T],
        grad_weight: ArrayViewMut3<'_, T>,
        _: &mut Team<'_, T>,
    ) {
        self.order.unpack(self.isa, grad_sum, grad_weight);
    }
}
