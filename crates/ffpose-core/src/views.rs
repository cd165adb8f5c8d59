//! Parts of views of images, for the driver and for kernels that cut a piece further.

use ndarray::{ArrayView2, ArrayViewMut2, ArrayViewMut3, Axis, s};

use crate::simd::Stored;

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

/// `view` `(points, lanes)` with zeros up to `lanes` whole vectors, at the start of `room`, in what is computed in.
pub(crate) fn padded<'a, X: Stored>(
    view: ArrayView2<'_, X>,
    lanes: usize,
    room: &'a mut [X::Real],
) -> &'a [X::Real] {
    let room = &mut room[..view.nrows() * lanes];
    let whole = ArrayViewMut2::from_shape((view.nrows(), lanes), &mut *room);
    let mut whole = whole.expect("room for a tile");
    whole.fill(X::Real::default());
    whole.slice_mut(s![.., ..view.ncols()]).zip_mut_with(&view, |wide, x| *wide = x.widened());
    room
}

/// Undoes [`padded`]: what `room` has of `lanes` lanes to `view`, rounded.
pub(crate) fn unpadded<X: Stored>(room: &[X::Real], lanes: usize, mut view: ArrayViewMut2<'_, X>) {
    let whole = ArrayView2::from_shape((view.nrows(), lanes), room).expect("room for a tile");
    let whole = whole.slice_move(s![.., ..view.ncols()]);
    view.zip_mut_with(&whole, |x, &wide| *x = X::nearest_to(wide));
}
