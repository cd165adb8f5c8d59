//! The passes over an image, each as jobs on rows of their own.

use ndarray::{ArrayBase, ArrayView2, ArrayViewMut2, Axis, Ix2, Ix3, RawData};

use super::blocks::{Block, block_to_image, image_to_block};
use super::groups::{Filter, GroupPointwise, Turns};
use super::steps::Step;
use super::{Tokens, lines};
use crate::parallel::Team;
use crate::simd::{Element, Stored, Tile, TileMut, aligned, slack};
use crate::views::{chunks_mut, in_order};

/// The rows of blocks `u1` and, unless it is the same, `-u1`.
pub(super) type StepRows<'a, T> = [Option<ArrayViewMut2<'a, T>>; 2];

/// The scratch of one member of a team.
pub(super) struct TokensBuffers<'a, T> {
    /// The rows of two blocks, and of those of `x` in a backward pass.
    pub(super) block: &'a mut [T],
    pub(super) other: &'a mut [T],
    /// Room for half a line of complex vectors, and for a column of them.
    pub(super) work: &'a mut [T],
}

impl<T: Element> Tokens<T> {
    /// Numbers of a block of any step.
    fn block_len(&self) -> usize {
        let rows = self.steps.iter().map(|step| step.fillers.end).max().unwrap_or(0);
        2 * self.lanes * self.shape.pitch() * rows.max(self.factors[0])
    }

    /// Numbers of half a line, or of a column, of complex vectors.
    fn work_len(&self) -> usize {
        let [a, b] = self.factors;
        self.shape.width.max(2 * self.lanes * a.max(b))
    }

    /// Scratch of one member of a team.
    pub(super) fn member_len(&self) -> usize {
        slack::<T>() + 2 * self.block_len() + self.work_len()
    }

    #[inline(always)]
    pub(super) fn scratch<'a>(&self, scratch: &'a mut [T]) -> TokensBuffers<'a, T> {
        let (block, rest) = aligned(scratch).split_at_mut(self.block_len());
        let (other, rest) = rest.split_at_mut(self.block_len());
        TokensBuffers { block, other, work: &mut rest[..self.work_len()] }
    }

    /// `spectrum` as an image.
    pub(super) fn image<'a>(&self, spectrum: &'a mut [T]) -> ArrayViewMut2<'a, T> {
        ArrayViewMut2::from_shape((self.shape.points, self.shape.width), spectrum)
            .expect("room for an image")
    }

    /// Images to the transforms of their lines and of their parts `x1`.
    pub(super) fn first_pass<'a, X: Stored<Real = T> + 'a>(
        &self,
        images: impl Iterator<Item = (ArrayView2<'a, X>, ArrayViewMut2<'a, T>)>,
        far: bool,
        team: &mut Team<'_, T>,
    ) {
        let ([a, b], pitch) = (self.factors, self.shape.pitch());
        let columns = images.flat_map(|(x, spectrum)| {
            let x = self.blocks(x);
            let x = (0..b).map(move |x2| x.index_axis_move(Axis(1), x2));
            x.zip(self.columns(spectrum)).zip(self.twiddles.chunks_exact(a))
        });
        team.run(columns, |((x, y), twiddles), scratch| {
            let TokensBuffers { block: vectors, work, .. } = self.scratch(scratch);
            let y = TileMut::new(y);
            let target = far.then(|| y.reader());
            lines::forward(self.isa, Tile::new(x), target, Block { vectors, pitch }, work);
            block_to_image::<T, false>(self.isa, Block { vectors, pitch }, twiddles, y, work);
        });
    }

    /// Undoes [`first_pass`](Self::first_pass) up to a factor: in place, or to an image of its own where there is one.
    pub(super) fn last_pass<'a, X: Stored<Real = T> + 'a>(
        &self,
        images: impl Iterator<Item = (ArrayViewMut2<'a, T>, Option<ArrayViewMut2<'a, X>>)>,
        far: bool,
        team: &mut Team<'_, T>,
    ) {
        let ([a, b], pitch) = (self.factors, self.shape.pitch());
        let columns = images.flat_map(|(spectrum, image)| {
            let images = in_order(b, image.map(|image| self.columns(image)));
            self.columns(spectrum).zip(images).zip(self.twiddles.chunks_exact(a))
        });
        team.run(columns, |((spectrum, image), twiddles), scratch| {
            let TokensBuffers { block: vectors, work, .. } = self.scratch(scratch);
            let spectrum = TileMut::new(spectrum);
            let block = Block { vectors: &mut *vectors, pitch };
            image_to_block::<T, true>(self.isa, spectrum.reader(), twiddles, block, work);
            let block = Block { vectors, pitch };
            match image {
                Some(image) => lines::inverse(self.isa, block, TileMut::new(image), work, far),
                None => lines::inverse(self.isa, block, spectrum, work, far),
            }
        });
    }

    /// For each `x2` the rows `x = B x1 + x2`.
    fn columns<'a, X>(
        &self,
        rows: ArrayViewMut2<'a, X>,
    ) -> impl Iterator<Item = ArrayViewMut2<'a, X>> + use<'a, X, T> {
        let columns = chunks_mut(self.blocks(rows), Axis(1), 1);
        columns.map(|column| column.index_axis_move(Axis(1), 0))
    }

    /// Rows `(X, Y)` as `(A, B, Y)`.
    fn blocks<S: RawData>(&self, rows: ArrayBase<S, Ix2>) -> ArrayBase<S, Ix3> {
        let [a, b] = self.factors;
        rows.into_shape_with_order((a, b, self.shape.width)).expect("rows without gaps")
    }

    /// The rows of each step.
    pub(super) fn rows_of_steps<'a>(&self, spectrum: ArrayViewMut2<'a, T>) -> Vec<StepRows<'a, T>> {
        let a = self.factors[0];
        let blocks = chunks_mut(self.blocks(spectrum), Axis(0), 1);
        let mut blocks: Vec<_> =
            blocks.map(|block| Some(block.index_axis_move(Axis(0), 0))).collect();
        (0..=a / 2)
            .map(|u1| [blocks[u1].take(), blocks.get_mut(a - u1).and_then(Option::take)])
            .collect()
    }

    /// The blocks of a step to `block`, transformed.
    #[inline(always)]
    pub(super) fn gather(
        &self,
        step: &Step,
        rows: &StepRows<'_, T>,
        block: &mut [T],
        work: &mut [T],
    ) {
        let (pitch, row) = (self.shape.pitch(), 2 * self.lanes * self.shape.pitch());
        for (rows, vectors) in rows.iter().flatten().zip(block.chunks_mut(self.factors[1] * row)) {
            let (image, block) = (Tile::new(rows.view()), Block { vectors, pitch });
            image_to_block::<T, false>(self.isa, image, &[], block, work);
        }
        self.fill(step, block);
    }

    /// Adds to the rows of a step its copies and fillers.
    #[inline(always)]
    pub(super) fn fill(&self, step: &Step, block: &mut [T]) {
        let row = 2 * self.lanes * self.shape.pitch();
        for &(from, to) in &step.copies {
            block.copy_within(from * row..(from + 1) * row, to * row);
        }
        block[step.fillers.start * row..step.fillers.end * row].fill(T::default());
    }

    /// Undoes [`gather`](Self::gather), up to a factor.
    #[inline(always)]
    pub(super) fn put(&self, block: &mut [T], rows: &mut StepRows<'_, T>, work: &mut [T]) {
        let (pitch, row) = (self.shape.pitch(), 2 * self.lanes * self.shape.pitch());
        for (rows, vectors) in
            rows.iter_mut().flatten().zip(block.chunks_mut(self.factors[1] * row))
        {
            let image = TileMut::new(rows.view_mut());
            block_to_image::<T, true>(self.isa, Block { vectors, pitch }, &[], image, work);
        }
    }

    /// `pointwise` on the spectrum of a block.
    #[inline(always)]
    pub(super) fn filter(&self, step: &Step, block: &mut [T], pointwise: impl GroupPointwise<T>) {
        let turns = Turns {
            rows: &step.rows,
            rows_each: self.rows_each,
            runs: &step.runs,
            slots: self.shape.slots,
            twiddles: self.turns.numbers(),
        };
        let block = Block { vectors: block, pitch: self.shape.pitch() };
        with_run!(self.run, RUN => self.isa.run(Filter::<T, _, RUN> { block, turns, pointwise }));
    }
}
