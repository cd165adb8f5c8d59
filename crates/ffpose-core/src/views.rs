//! Parts of views of images and weights, for the driver and for kernels that cut a piece further.

use std::ops::Range;

use ndarray::{ArrayView2, ArrayView3, ArrayViewMut2, ArrayViewMut3, Axis, s};

use crate::simd::{Element, Stored};

/// The axis of the images in a view `(batch, points, lanes)`.
pub(crate) const BATCH: Axis = Axis(0);

/// All chunks of `view` along `axis`; the last one may be shorter.
pub(crate) fn chunks_mut<T>(
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

/// The items in `Some`, or `None` for each of `len`.
pub(crate) fn in_order<I: Iterator>(
    len: usize,
    items: Option<I>,
) -> impl Iterator<Item = Option<I::Item>> {
    let absent = if items.is_some() { 0 } else { len };
    items.into_iter().flatten().map(Some).chain((0..absent).map(|_| None))
}

/// `view` `(points, lanes)` in the last of `lanes` lanes, those of a vector, with zeros before it, in `room` and in what is computed in.
/// Last, because a vector that overlaps the one before it ([`crate::simd::Tile::part`]) has the same lanes there.
pub(crate) fn padded<'a, X: Stored>(
    view: ArrayView2<'_, X>,
    lanes: usize,
    room: &'a mut [X::Real],
) -> &'a [X::Real] {
    let room = &mut room[..view.nrows() * lanes];
    let whole = ArrayViewMut2::from_shape((view.nrows(), lanes), &mut *room);
    let mut whole = whole.expect("room for a tile");
    whole.fill(X::Real::default());
    let own = s![.., lanes - view.ncols()..];
    whole.slice_mut(own).zip_mut_with(&view, |wide, x| *wide = x.widened());
    room
}

/// Undoes [`padded`]: what `room` has of `lanes` lanes to `view`, rounded.
pub(crate) fn unpadded<X: Stored>(room: &[X::Real], lanes: usize, mut view: ArrayViewMut2<'_, X>) {
    let whole = ArrayView2::from_shape((view.nrows(), lanes), room).expect("room for a tile");
    let whole = whole.slice_move(s![.., lanes - view.ncols()..]);
    view.zip_mut_with(&whole, |x, &wide| *x = X::nearest_to(wide));
}

/// `lanes` of a weight `(bins, lanes, 2)`, with those before them that fill a vector of `vector` lanes, if there are so many.
pub(crate) fn bins_of<T>(
    weight: ArrayView3<'_, T>,
    lanes: Range<usize>,
    vector: usize,
) -> ArrayView3<'_, T> {
    let last = weight.len_of(Axis(1)).saturating_sub(vector);
    weight.slice_move(s![.., lanes.start.min(last)..lanes.end, ..])
}

/// `room` as a weight `(bins, lanes, 2)`.
pub(crate) fn bins<T>(room: &mut [T], lanes: usize) -> ArrayViewMut3<'_, T> {
    ArrayViewMut3::from_shape((room.len() / (2 * lanes), lanes, 2), room).expect("room for bins")
}

/// As [`padded`], of a weight `(bins, lanes, 2)`, for all of `room`.
pub(crate) fn padded_bins<'a, T: Element>(
    weight: ArrayView3<'_, T>,
    lanes: usize,
    room: &'a mut [T],
) -> ArrayView3<'a, T> {
    let mut whole = bins(room, lanes);
    whole.fill(T::default());
    whole.slice_mut(s![.., lanes - weight.len_of(Axis(1)).., ..]).assign(&weight);
    ArrayView3::from_shape(whole.raw_dim(), room).expect("room for bins")
}

/// Undoes [`padded_bins`], of a gradient.
pub(crate) fn unpadded_bins<T: Element>(
    whole: ArrayView3<'_, T>,
    mut gradient: ArrayViewMut3<'_, T>,
) {
    let lanes = whole.len_of(Axis(1)) - gradient.len_of(Axis(1))..;
    gradient.assign(&whole.slice_move(s![.., lanes, ..]));
}
