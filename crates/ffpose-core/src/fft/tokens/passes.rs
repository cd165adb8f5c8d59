//! The passes over an image, each as jobs on rows of their own.

use ndarray::{ArrayView2, ArrayViewMut2, ArrayViewMut3, Axis, Ix2, SliceInfo, SliceInfoElem, s};

use super::columns::{Block, block_to_image, image_to_block};
use super::lanes::{Filter, Middle, Turns};
use super::order::SPARE;
use super::pack::Chunk;
use super::{Tokens, lines};
use crate::parallel::Team;
use crate::simd::{Element, Tile, TileMut, aligned, slack};

/// The rows of blocks `u1` and, unless it is the same, `-u1`.
pub(super) type Rows<'a, T> = [Option<ArrayViewMut2<'a, T>>; 2];

impl<T: Element> Tokens<T> {
    /// Numbers of a block of any step.
    fn block_len(&self) -> usize {
        let [a, b] = self.factors;
        let lines = a * pitch(self.slots());
        let chunk = (2 * b + SPARE) * pitch(self.slots_each());
        2 * self.lanes * lines.max(chunk)
    }

    /// Scratch of one member of a team.
    pub(super) fn member_len(&self) -> usize {
        slack::<T>() + 2 * self.block_len() + self.width
    }

    /// Two blocks, and room for half a line of complex vectors.
    pub(super) fn scratch<'a>(&self, scratch: &'a mut [T]) -> [&'a mut [T]; 3] {
        let (block, rest) = aligned(scratch).split_at_mut(self.block_len());
        let (other, rest) = rest.split_at_mut(self.block_len());
        [block, other, &mut rest[..self.width]]
    }

    /// `spectrum` as an image.
    pub(super) fn image<'a>(&self, spectrum: &'a mut [T]) -> ArrayViewMut2<'a, T> {
        ArrayViewMut2::from_shape((self.points(), self.width), spectrum).expect("room for an image")
    }

    /// An image to the transforms of its lines and of their parts `x1`.
    pub(super) fn first_pass(
        &self,
        x: ArrayView2<'_, T>,
        spectrum: ArrayViewMut2<'_, T>,
        team: &mut Team<'_, T>,
    ) {
        let ([a, b], pitch) = (self.factors, pitch(self.slots()));
        let x = x.into_shape_with_order((a, b, self.width)).expect("rows without gaps");
        let mut spectrum = self.blocks(spectrum);
        let columns = x.axis_iter(Axis(1)).zip(spectrum.axis_iter_mut(Axis(1)));
        team.run(columns.zip(self.twiddles.chunks_exact(a)), |((x, y), twiddles), scratch| {
            let [vectors, _, work] = self.scratch(scratch);
            lines::forward(self.isa, Tile::new(x), Block { vectors, pitch }, work);
            block_to_image::<T, false>(
                self.isa,
                Block { vectors, pitch },
                twiddles,
                TileMut::new(y),
            );
        });
    }

    /// Undoes [`first_pass`](Self::first_pass) in place, up to a factor.
    pub(super) fn last_pass(&self, y: ArrayViewMut2<'_, T>, team: &mut Team<'_, T>) {
        let ([a, _], pitch) = (self.factors, pitch(self.slots()));
        let mut y = self.blocks(y);
        let columns = y.axis_iter_mut(Axis(1)).zip(self.twiddles.chunks_exact(a));
        team.run(columns, |(y, twiddles), scratch| {
            let [vectors, _, work] = self.scratch(scratch);
            let image = TileMut::new(y);
            image_to_block::<T, true>(self.isa, image.reader(), twiddles, Block { vectors, pitch });
            lines::inverse(self.isa, Block { vectors, pitch }, image, work);
        });
    }

    /// Rows `(X, Y)` as `(A, B, Y)`.
    fn blocks<'a>(&self, rows: ArrayViewMut2<'a, T>) -> ArrayViewMut3<'a, T> {
        let [a, b] = self.factors;
        rows.into_shape_with_order((a, b, self.width)).expect("rows without gaps")
    }

    /// The rows of each step.
    pub(super) fn rows_of_steps<'a>(&self, spectrum: ArrayViewMut2<'a, T>) -> Vec<Rows<'a, T>> {
        let a = self.factors[0];
        let (mut blocks, mut rest) = (Vec::with_capacity(a), self.blocks(spectrum));
        for _ in 0..a {
            let (first, others) = rest.split_at(Axis(0), 1);
            blocks.push(Some(first.index_axis_move(Axis(0), 0)));
            rest = others;
        }
        (0..=a / 2)
            .map(|u1| [blocks[u1].take(), blocks.get_mut(a - u1).and_then(Option::take)])
            .collect()
    }

    /// The columns of a chunk in an image.
    fn columns(&self, chunk: Chunk<'_>) -> SliceInfo<[SliceInfoElem; 2], Ix2, Ix2> {
        let column = |slot| 2 * self.lanes * slot;
        s![.., column(chunk.first)..column(chunk.first + chunk.slots)]
    }

    /// Scratch as the block of a chunk.
    pub(super) fn chunk_block<'a>(&self, vectors: &'a mut [T]) -> Block<'a, T> {
        Block { vectors, pitch: pitch(self.slots_each()) }
    }

    /// The rows of a chunk to `block`, transformed.
    pub(super) fn gather(&self, chunk: Chunk<'_>, rows: &Rows<'_, T>, block: &mut [T]) {
        let row = 2 * self.lanes * pitch(chunk.slots);
        for (rows, block) in rows.iter().flatten().zip(block.chunks_mut(self.factors[1] * row)) {
            let image = Tile::new(rows.slice(self.columns(chunk)));
            image_to_block::<T, false>(self.isa, image, &[], self.chunk_block(block));
        }
        for &(from, to) in &chunk.step.copies {
            block.copy_within(from * row..(from + 1) * row, to * row);
        }
        block[chunk.step.fillers * row..][..2 * row].fill(T::default());
    }

    /// Undoes [`gather`](Self::gather), up to a factor.
    pub(super) fn put(&self, chunk: Chunk<'_>, block: &mut [T], rows: &mut Rows<'_, T>) {
        let row = 2 * self.lanes * pitch(chunk.slots);
        for (rows, block) in rows.iter_mut().flatten().zip(block.chunks_mut(self.factors[1] * row))
        {
            let image = TileMut::new(rows.slice_mut(self.columns(chunk)));
            block_to_image::<T, true>(self.isa, self.chunk_block(block), &[], image);
        }
    }

    /// `middle` on the spectrum of a block.
    pub(super) fn filter(&self, chunk: Chunk<'_>, block: &mut [T], middle: impl Middle<T>) {
        let len = self.rows_each * chunk.slots * 2 * self.lanes;
        let turns = Turns {
            rows: &chunk.step.rows,
            rows_each: self.rows_each,
            slots: chunk.slots,
            is_first: chunk.first == 0,
            twiddles: &self.turns.values()[chunk.first / chunk.slots * len..][..len],
        };
        let block = self.chunk_block(block);
        with_run!(self.run(), RUN => self.isa.run(Filter::<T, _, RUN> { block, turns, middle }));
    }
}

/// Complex vectors from one row of a block to the next: odd, since an even number would meet the same few sets of the cache.
fn pitch(slots: usize) -> usize {
    slots | 1
}
