//! The filter on images of few channels: the lanes of a vector are the channels of several images.
//!
//! Images that go together are copied side by side, to one image `(points, lanes)` of as many lanes as a vector has, and another
//! kernel filters that. Lanes do not see each other, so that an image is filtered the same way in any company.
//!
//! Gradients of the weight that lie in other lanes are added at the end, so that the order of that sum follows from the number of
//! lanes. To add them image by image, in the same order everywhere, took 1.06 to 1.31 times as long (backward passes of 64 images).

mod side_by_side;
mod spread;

use std::ops::Range;

use bytemuck::{cast_slice, cast_slice_mut};
use ndarray::{ArrayView3, ArrayViewMut3, Slice};

use self::side_by_side::{Enter, Leave};
use self::spread::{collect, fold, repeat, spread};
use crate::fft::grid::Grid;
use crate::fft::sequence::Sequence;
use crate::kernel::{Backward, Factor, Kernel, Packing};
use crate::parallel::Team;
use crate::simd::{Element, Isa, Stored, Tile, TileMut};
use crate::tuning::{COPIED_POINTS, Tuning};
use crate::views::BATCH;
use crate::{Layout, Shape};

/// The plan for images of fewer channels than a vector has lanes; tokens have one.
pub(crate) struct Batched<T> {
    isa: Isa,
    inner: Inner<T>,
    shape: Shape,
    /// Points of a plane.
    points: usize,
    channels: usize,
    /// Lanes of a vector.
    lanes: usize,
}

/// Whether images are filtered several together. One alone takes as long as all of them, so that large ones are not.
pub(super) fn pays<T: Element>(isa: Isa, shape: Shape, tuning: &Tuning) -> bool {
    let Shape { layout, rows, columns, .. } = shape;
    let (channels, lanes) = (shape.channels(), isa.lanes::<T>());
    match layout {
        _ if rows == 1 => channels < lanes && columns <= tuning.batched_sequence * channels,
        // two columns fill a small part of the vectors across them
        Layout::Tokens => columns <= 2 && rows <= tuning.batched_sequence,
        Layout::Grid => channels < lanes && rows * columns <= tuning.batched_plane * channels,
    }
}

/// Whether tokens of several rows for which there are no codelets are filtered several images together: in batches of 64 and more,
/// squares of vectors or `RustFFT` take 3 to 10 times as long, and longer than `torch.fft`. One alone takes up to twice as long, so that
/// those of more points, half of what a grid of one channel may have, are not.
pub(super) fn pays_without_codelets(shape: Shape, tuning: &Tuning) -> bool {
    shape.layout == Layout::Tokens && 2 * shape.rows * shape.columns <= tuning.batched_plane
}

/// What filters several images as one.
enum Inner<T> {
    Sequence(Sequence<T>),
    Grid(Grid<T>),
}

impl<T: Element> Batched<T> {
    pub(crate) fn new(isa: Isa, shape: Shape, tuning: &'static Tuning) -> Self {
        let lanes = isa.lanes::<T>();
        let whole = Shape { layout: Layout::Grid, lanes, ..shape };
        let inner = match shape.rows {
            1 => Inner::Sequence(Sequence::new(isa, shape.columns, lanes)),
            _ => Inner::Grid(Grid::new(isa, whole, tuning)),
        };
        Self { isa, inner, shape, points: whole.points(), channels: shape.channels(), lanes }
    }

    fn inner<X: Stored<Real = T>>(&self) -> &dyn Kernel<X> {
        match &self.inner {
            Inner::Sequence(sequence) => sequence,
            Inner::Grid(grid) => grid,
        }
    }

    fn packing_of_inner(&self) -> &dyn Packing<T> {
        self.inner::<T>().packing().expect("its weights are packed")
    }

    /// Images that go together.
    fn together(&self) -> usize {
        self.lanes / self.channels
    }

    /// Numbers of an image of all lanes.
    fn stage_len(&self) -> usize {
        self.points * self.lanes
    }

    /// Room for three images or for a weight, of all lanes, and the team that the inner kernel expects.
    fn share<'b>(&self, team: &'b mut Team<'_, T>) -> (&'b mut [T], Team<'b, T>) {
        team.share(3 * self.stage_len())
    }

    /// Room for three images of all lanes.
    fn stages<'b, X: Stored<Real = T>>(&self, stage: &'b mut [T]) -> [&'b mut [X]; 3] {
        let (first, rest) = cast_slice_mut(stage).split_at_mut(self.stage_len());
        let (second, rest) = rest.split_at_mut(self.stage_len());
        [first, second, &mut rest[..self.stage_len()]]
    }

    /// The images of a group side by side in `stage`. Lanes without one are zero from the first group on: what was there might be
    /// numbers too small to be normal, which are slow.
    fn enter<'b, X: Stored<Real = T>>(
        &self,
        batch: ArrayView3<'_, X>,
        group: Slice,
        stage: &'b mut [X],
    ) -> ArrayView3<'b, X> {
        let images = batch.slice_axis(BATCH, group);
        if self.is_transposed() {
            let images = images.to_slice().expect("a batch has no gaps");
            let (images, points) = (Tile::dense(images, self.points), self.points);
            self.isa.run(Enter { images, points, stage: &mut *stage });
            return self.staged(stage);
        }
        let lanes = images.len_of(BATCH) * self.channels;
        let is_full = images.len_of(BATCH) == self.together();
        if lanes < self.lanes && (group.start == 0 || !is_full) {
            stage.fill(X::zeroed());
        }
        let images = images.to_slice().expect("a batch has no gaps");
        for first in (0..self.points).step_by(COPIED_POINTS) {
            for (i, image) in images.chunks_exact(self.points * self.channels).enumerate() {
                let (image, stage) = (&image[self.block(first)], &mut stage[first * self.lanes..]);
                spread(self.channels, image, stage, self.lanes, i * self.channels);
            }
        }
        self.staged(stage)
    }

    fn staged<'b, X>(&self, stage: &'b [X]) -> ArrayView3<'b, X> {
        ArrayView3::from_shape((1, self.points, self.lanes), stage).expect("as many numbers")
    }

    /// Whether images go side by side by squares of vectors. For more channels, whole vectors in place of runs took 1.0 to 2 times as
    /// long.
    fn is_transposed(&self) -> bool {
        self.channels == 1 && self.points >= self.lanes
    }

    /// Undoes [`enter`](Self::enter).
    fn leave<X: Stored<Real = T>>(&self, stage: &[X], mut images: ArrayViewMut3<'_, X>) {
        let images = images.as_slice_mut().expect("a batch has no gaps");
        if self.is_transposed() {
            let (images, points) = (TileMut::dense(images, self.points), self.points);
            return self.isa.run(Leave { stage, points, images });
        }
        for first in (0..self.points).step_by(COPIED_POINTS) {
            for (i, image) in images.chunks_exact_mut(self.points * self.channels).enumerate() {
                let (stage, image) = (&stage[first * self.lanes..], &mut image[self.block(first)]);
                collect(self.channels, stage, self.lanes, i * self.channels, image);
            }
        }
    }

    /// The block of an image from point `first` on.
    fn block(&self, first: usize) -> Range<usize> {
        first * self.channels..(first + COPIED_POINTS).min(self.points) * self.channels
    }

    /// The images of a batch that go together, by the number of the first.
    fn groups(&self, images: usize) -> impl Iterator<Item = Slice> {
        let firsts = (0..images).step_by(self.together());
        firsts.map(move |first| Slice::from(first..images.min(first + self.together())))
    }
}

impl<T: Element> Packing<T> for Batched<T> {
    fn packed_len(&self, _: usize) -> usize {
        self.packing_of_inner().packed_len(self.lanes)
    }

    fn pack(
        &self,
        weight: ArrayView3<'_, T>,
        _: Range<usize>,
        factor: Factor,
        packed: &mut [T],
        team: &mut Team<'_, T>,
    ) {
        let (stage, mut team) = self.share(team);
        let stage = &mut stage[..2 * self.shape.bins_len() * self.lanes];
        let weight = cast_slice(weight.to_slice().expect("a weight has no gaps"));
        let copies: &mut [[T; 2]] = cast_slice_mut(stage);
        repeat(self.channels, weight, copies, self.lanes);
        let weight = ArrayView3::from_shape((self.shape.bins_len(), self.lanes, 2), stage);
        let weight = weight.expect("as many numbers");
        self.packing_of_inner().pack(weight, 0..self.lanes, factor, packed, &mut team);
    }
}

impl<X: Stored> Kernel<X> for Batched<X::Real> {
    fn tile(&self) -> usize {
        self.shape.lanes
    }

    fn images_together(&self) -> usize {
        self.together()
    }

    fn scratch_len(&self, members: usize) -> usize {
        3 * self.stage_len() + self.inner::<X>().scratch_len(members)
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
        let (stage, mut team) = self.share(team);
        let [stage, _, result] = self.stages(stage);
        for group in self.groups(x.len_of(BATCH)) {
            let x = self.enter(x, group, stage);
            let staged = ArrayViewMut3::from_shape(x.raw_dim(), &mut *result);
            self.inner().forward(x, packed, staged.expect("as many numbers"), &mut team);
            self.leave(result, y.slice_axis_mut(BATCH, group));
        }
    }

    fn backward(&self, pass: Backward<'_, X>, team: &mut Team<'_, X::Real>) {
        let Backward { grad, x, weight, mut grad_x, mut grad_sum, .. } = pass;
        let (stage, mut team) = self.share(team);
        let [stage, other, result] = self.stages(stage);
        for group in self.groups(grad.len_of(BATCH)) {
            let grad = self.enter(grad, group, stage);
            let x = match grad_sum {
                Some(_) => self.enter(x, group, other),
                None => grad, // not looked at
            };
            let staged = ArrayViewMut3::from_shape(x.raw_dim(), &mut *result);
            let staged = grad_x.is_some().then(|| staged.expect("as many numbers"));
            let grad_sum = grad_sum.as_deref_mut();
            let pass = Backward { grad, x, weight, grad_x: staged, grad_sum, images_each: 1 };
            self.inner().backward(pass, &mut team);
            if let Some(grad_x) = &mut grad_x {
                self.leave(result, grad_x.slice_axis_mut(BATCH, group));
            }
        }
    }

    /// Adds what the images that go together bring, in their order.
    fn unpack_gradient(
        &self,
        grad_sum: &[X::Real],
        mut grad_weight: ArrayViewMut3<'_, X::Real>,
        team: &mut Team<'_, X::Real>,
    ) {
        let (stage, mut team) = self.share(team);
        let stage = &mut stage[..2 * self.shape.bins_len() * self.lanes];
        let sums = ArrayViewMut3::from_shape((self.shape.bins_len(), self.lanes, 2), &mut *stage);
        self.inner::<X>().unpack_gradient(grad_sum, sums.expect("as many numbers"), &mut team);
        let grad_weight = grad_weight.as_slice_mut().expect("a weight has no gaps");
        let sums: &[[X::Real; 2]] = cast_slice(stage);
        fold(self.channels, sums, self.lanes, cast_slice_mut(grad_weight));
    }
}
