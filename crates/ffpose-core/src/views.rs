//! Parts of views of images, for the driver and for kernels that cut a piece further.

use ndarray::{ArrayViewMut3, Axis};

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
