//! Cuts images and weights into the pieces that jobs take: a tile of lanes, a part of the batch.

use ndarray::{ArrayView3, ArrayViewMut3, Axis, Slice};

use crate::{Layout, Shape};

const BATCH: Axis = Axis(0);
const IMAGE_LANES: Axis = Axis(2);
const WEIGHT_LANES: Axis = Axis(1);

/// Pieces are numbered part by part, and tile by tile within a part.
pub(crate) struct Tiling {
    images: usize,
    images_each: usize,
    tiles: usize,
    lanes_each: usize,
    weight_lanes_each: usize,
}

impl Tiling {
    /// A batch of images in about `parts` parts of whole groups of `together`, with at most `tile` lanes in a piece.
    pub(crate) fn new(
        shape: Shape,
        tile: usize,
        (images, together): (usize, usize),
        parts: usize,
    ) -> Self {
        let weight_lanes_each = match shape.layout {
            Layout::Tokens => shape.half(),
            Layout::Grid => tile,
        };
        Self {
            images,
            images_each: images.div_ceil(together).div_ceil(parts) * together,
            tiles: shape.lanes.div_ceil(tile),
            lanes_each: tile,
            weight_lanes_each,
        }
    }

    /// Most lanes in a piece.
    pub(crate) fn lanes_each(&self) -> usize {
        self.lanes_each
    }

    /// Tiles of one image.
    pub(crate) fn tiles(&self) -> usize {
        self.tiles
    }

    /// The tile that a piece belongs to.
    pub(crate) fn tile_of(&self, piece: usize) -> usize {
        piece % self.tiles
    }

    /// Pieces of the batch.
    pub(crate) fn pieces(&self) -> usize {
        self.images.div_ceil(self.images_each) * self.tiles
    }

    /// One piece of `view (batch, points, lanes)`.
    pub(crate) fn images<'a, T>(&self, view: ArrayView3<'a, T>, piece: usize) -> ArrayView3<'a, T> {
        let view = chunk(view, BATCH, self.images_each, piece / self.tiles);
        chunk(view, IMAGE_LANES, self.lanes_each, self.tile_of(piece))
    }

    /// All pieces of `view (batch, points, lanes)`, in order.
    pub(crate) fn images_mut<'a, T>(
        &self,
        view: ArrayViewMut3<'a, T>,
    ) -> impl Iterator<Item = ArrayViewMut3<'a, T>> {
        let lanes_each = self.lanes_each;
        chunks_mut(view, BATCH, self.images_each)
            .flat_map(move |part| chunks_mut(part, IMAGE_LANES, lanes_each))
    }

    /// One tile of `view (bins, lanes, 2)`.
    pub(crate) fn bins<'a, T>(&self, view: ArrayView3<'a, T>, tile: usize) -> ArrayView3<'a, T> {
        chunk(view, WEIGHT_LANES, self.weight_lanes_each, tile)
    }

    /// All tiles of `view (bins, lanes, 2)`, in order.
    pub(crate) fn bins_mut<'a, T>(
        &self,
        view: ArrayViewMut3<'a, T>,
    ) -> impl Iterator<Item = ArrayViewMut3<'a, T>> {
        chunks_mut(view, WEIGHT_LANES, self.weight_lanes_each)
    }
}

/// Chunk number `index` of `view` along `axis`; the last one may be shorter.
fn chunk<T>(
    mut view: ArrayView3<'_, T>,
    axis: Axis,
    each: usize,
    index: usize,
) -> ArrayView3<'_, T> {
    let len = view.len_of(axis);
    if len > each {
        let from = index * each;
        view.slice_axis_inplace(axis, Slice::from(from..len.min(from + each)));
    }
    view
}

/// All chunks of `view` along `axis`; the last one may be shorter.
fn chunks_mut<T>(
    view: ArrayViewMut3<'_, T>,
    axis: Axis,
    each: usize,
) -> impl Iterator<Item = ArrayViewMut3<'_, T>> {
    let mut rest = Some(view);
    std::iter::from_fn(move || {
        let view = rest.take()?;
        if view.len_of(axis) <= each {
            return Some(view);
        }
        let (head, tail) = view.split_at(axis, each);
        rest = Some(tail);
        Some(head)
    })
}
