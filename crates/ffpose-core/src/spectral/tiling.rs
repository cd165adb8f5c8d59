//! Cuts images and weights into the pieces that jobs take: a tile of lanes, a part of the batch.

use std::ops::Range;

use ndarray::{ArrayView3, ArrayViewMut3, Axis, Slice};

use crate::tuning::Tuning;
use crate::views::{BATCH, chunks_mut};
use crate::{Layout, Shape};

const IMAGE_LANES: Axis = Axis(2);
const WEIGHT_LANES: Axis = Axis(1);

/// Pieces are numbered tile by tile, and part by part within a tile: neighbors share the tile's weight.
#[derive(Clone, Copy)]
pub(crate) struct Tiling {
    images: usize,
    images_each: usize,
    lanes: usize,
    lanes_each: usize,
    weight_lanes_each: usize,
}

/// What pieces are made of.
#[derive(Clone, Copy)]
pub(crate) struct PieceSizes {
    /// Lanes of a tile: a multiple of the least up to the most, or the most alone if that is less.
    pub(crate) least: usize,
    pub(crate) most: usize,
    /// Images that stay together.
    pub(crate) together: usize,
    pub(crate) tuning: &'static Tuning,
}

impl Tiling {
    /// Parts of at most `images_each` images, with at most `tile` lanes in a piece.
    pub(crate) fn new(shape: Shape, tile: usize, images: usize, images_each: usize) -> Self {
        let weight_lanes_each = match shape.layout {
            Layout::Tokens => shape.half(),
            Layout::Grid => tile,
        };
        Self { images, images_each, lanes: shape.lanes, lanes_each: tile, weight_lanes_each }
    }

    /// Pieces that let `threads` share a batch evenly: parts of it, and narrower tiles where these are too few.
    pub(crate) fn even(shape: Shape, images: usize, sizes: PieceSizes, threads: usize) -> Self {
        if threads == 1 {
            return Self::new(shape, sizes.most, images, images);
        }
        let groups = images.div_ceil(sizes.together);
        let tile = sizes.tile(shape.lanes, groups, threads);
        let tiles = shape.lanes.div_ceil(tile);
        let groups_each =
            groups.div_ceil(even_parts(tiles, groups, threads, sizes.tuning.pieces_each));
        Self::new(shape, tile, images, groups_each * sizes.together)
    }

    /// As [`even`](Self::even), with the parts that a gradient is summed in, which follow from shapes and the images that stay
    /// together alone.
    pub(crate) fn summed(shape: Shape, images: usize, sizes: PieceSizes, threads: usize) -> Self {
        let images_each = images.div_ceil(sum_parts(shape, images, sizes.tuning));
        let images_each = images_each.next_multiple_of(sizes.together);
        let tile = sizes.tile(shape.lanes, images.div_ceil(images_each), threads);
        Self::new(shape, tile, images, images_each)
    }

    /// Images of the batch.
    pub(crate) fn images_len(&self) -> usize {
        self.images
    }

    /// Most lanes in a piece.
    pub(crate) fn lanes_each(&self) -> usize {
        self.lanes_each
    }

    /// Most images in a piece.
    pub(crate) fn images_each(&self) -> usize {
        self.images_each
    }

    /// Tiles of one image.
    pub(crate) fn tiles(&self) -> usize {
        self.lanes.div_ceil(self.lanes_each)
    }

    /// Parts of the batch.
    pub(crate) fn parts(&self) -> usize {
        self.images.div_ceil(self.images_each)
    }

    /// Pieces of the batch.
    pub(crate) fn pieces(&self) -> usize {
        self.parts() * self.tiles()
    }

    /// The tile and the part that a piece is.
    pub(crate) fn place_of(&self, piece: usize) -> (usize, usize) {
        (piece / self.parts(), piece % self.parts())
    }

    /// The lanes of a tile.
    pub(crate) fn lanes_of(&self, tile: usize) -> Range<usize> {
        tile * self.lanes_each..self.lanes.min((tile + 1) * self.lanes_each)
    }

    /// One piece of `view (batch, points, lanes)`.
    pub(crate) fn images<'a, T>(&self, view: ArrayView3<'a, T>, piece: usize) -> ArrayView3<'a, T> {
        let (tile, part) = self.place_of(piece);
        chunk(chunk(view, BATCH, self.images_each, part), IMAGE_LANES, self.lanes_each, tile)
    }

    /// All pieces of `view (batch, points, lanes)`, in order.
    pub(crate) fn images_mut<'a, T>(
        &self,
        view: ArrayViewMut3<'a, T>,
    ) -> impl Iterator<Item = ArrayViewMut3<'a, T>> {
        let images_each = self.images_each;
        chunks_mut(view, IMAGE_LANES, self.lanes_each)
            .flat_map(move |tile| chunks_mut(tile, BATCH, images_each))
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

impl PieceSizes {
    /// Lanes of a tile with which `threads` are done soonest with `rows` of `lanes` lanes.
    fn tile(self, lanes: usize, rows: usize, threads: usize) -> usize {
        let Self { least, most, tuning, .. } = self;
        let pieces = |tile: usize| lanes.div_ceil(tile).saturating_mul(rows);
        if threads == 1 {
            return most;
        }
        // as wide as the others, so that nobody gets a narrow rest
        let alike = |tile: usize| lanes.div_ceil(lanes.div_ceil(tile)).next_multiple_of(least);
        if pieces(most) >= tuning.pieces_each * threads {
            return alike(most);
        }
        let tiles = (1..=most / least).rev().map(|steps| alike(steps * least));
        // a tile takes the time of its lanes and, measured, of a third of `least` besides; threads that have no tile in common
        // need not wait for its weight
        let time = |tile: &usize| {
            let each = pieces(*tile).div_ceil(threads);
            let is_uneven = 4 * each * tile * threads > 5 * lanes * rows;
            let is_apart = lanes.div_ceil(*tile).is_multiple_of(threads);
            (is_uneven, each * (3 * tile + least) * if is_apart { 16 } else { 17 })
        };
        tiles.min_by_key(time).unwrap_or(most)
    }
}

/// The fewest parts of `groups` that let `threads` share `tiles` of each evenly, within a sixteenth, or else many.
fn even_parts(tiles: usize, groups: usize, threads: usize, pieces_each: usize) -> usize {
    let many = groups.min((pieces_each * threads).div_ceil(tiles)).max(1);
    let is_even = |parts: &usize| {
        let largest = (tiles * parts).div_ceil(threads) * groups.div_ceil(*parts);
        16 * threads * largest <= 17 * tiles * groups
    };
    (1..many).find(is_even).unwrap_or(many)
}

/// Parts in which a gradient is summed over `images`. They follow from shapes alone, so that the order of the sum depends on
/// neither threads nor caches.
fn sum_parts(shape: Shape, images: usize, tuning: &Tuning) -> usize {
    let apart = match shape.layout {
        Layout::Tokens => 1,
        Layout::Grid => shape.lanes.div_ceil(tuning.sum_lanes),
    };
    let wanted = tuning.sum_pieces.div_ceil(apart).next_power_of_two().min(tuning.most_sum_parts);
    wanted.min(images.div_ceil(tuning.sum_images)).max(1)
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
