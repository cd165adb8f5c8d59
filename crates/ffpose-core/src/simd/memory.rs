//! Buffers as elements far apart, and as vectors. Every function checks its bounds once, for all the elements that it touches.

use std::mem::MaybeUninit;

use bytemuck::allocation::try_zeroed_vec;

use super::{Complex, Element, Vector};
use crate::Error;

/// Whether `first`, `first + step` and so on, `count` indices, at least one, are below `len`.
#[inline(always)]
pub(super) fn is_within(first: usize, count: usize, step: usize, len: usize) -> bool {
    let span = count.checked_sub(1).and_then(|steps| steps.checked_mul(step));
    span.and_then(|span| span.checked_add(first)).is_some_and(|last| last < len)
}

/// `buffer[first]`, `buffer[first + step]`, ...
#[inline(always)]
pub(crate) fn gather<E: Copy, const N: usize>(buffer: &[E], first: usize, step: usize) -> [E; N] {
    assert!(is_within(first, N, step, buffer.len()));
    // SAFETY: an array of uninitialized elements needs no initialization.
    let mut elements: [MaybeUninit<E>; N] = unsafe { MaybeUninit::uninit().assume_init() };
    for (i, element) in elements.iter_mut().enumerate() {
        // SAFETY: at most the index checked above.
        element.write(unsafe { *buffer.get_unchecked(first + i * step) });
    }
    // SAFETY: the loop wrote every element; the two types have the same layout.
    unsafe { std::mem::transmute_copy(&elements) }
}

/// `buffer[first] = elements[0]`, `buffer[first + step] = elements[1]`, ...
#[inline(always)]
pub(crate) fn scatter<E: Copy, const N: usize>(
    buffer: &mut [E],
    first: usize,
    step: usize,
    elements: [E; N],
) {
    assert!(is_within(first, N, step, buffer.len()));
    for (i, &element) in elements.iter().enumerate() {
        // SAFETY: at most the index checked above.
        unsafe { *buffer.get_unchecked_mut(first + i * step) = element };
    }
}

/// `buffer[first + offsets[0] * step]`, ..., these offsets below `span`.
#[inline(always)]
pub(crate) fn gather_at<E: Copy, const N: usize>(
    buffer: &[E],
    first: usize,
    offsets: [usize; N],
    step: usize,
    span: usize,
) -> [E; N] {
    assert!(is_within(first, span, step, buffer.len()));
    // SAFETY: an array of uninitialized elements needs no initialization.
    let mut elements: [MaybeUninit<E>; N] = unsafe { MaybeUninit::uninit().assume_init() };
    for (element, &offset) in elements.iter_mut().zip(&offsets) {
        assert!(offset < span); // constants, as a rule
        // SAFETY: at most the index checked above.
        element.write(unsafe { *buffer.get_unchecked(first + offset * step) });
    }
    // SAFETY: the loop wrote every element; the two types have the same layout.
    unsafe { std::mem::transmute_copy(&elements) }
}

/// `buffer[first + offsets[0] * step] = elements[0]`, ..., these offsets below `span`.
#[inline(always)]
pub(crate) fn scatter_at<E: Copy, const N: usize>(
    buffer: &mut [E],
    first: usize,
    offsets: [usize; N],
    step: usize,
    span: usize,
    elements: [E; N],
) {
    assert!(is_within(first, span, step, buffer.len()));
    for (&element, &offset) in elements.iter().zip(&offsets) {
        assert!(offset < span); // constants, as a rule
        // SAFETY: at most the index checked above.
        unsafe { *buffer.get_unchecked_mut(first + offset * step) = element };
    }
}

/// Bytes of a cache line and of the widest vector: where buffers begin, and what two threads should not write at once.
pub(crate) const LINE_BYTES: usize = 64;

/// Elements that [`aligned`] may leave out.
pub(crate) const fn slack<T>() -> usize {
    LINE_BYTES / size_of::<T>()
}

/// `buffer` from its first aligned element on: at most [`slack`] elements less.
pub(crate) fn aligned<T>(buffer: &mut [T]) -> &mut [T] {
    let skipped = buffer.as_ptr().align_offset(LINE_BYTES);
    &mut buffer[skipped..]
}

/// Numbers of its own, from an aligned element on.
#[derive(Debug)]
pub(crate) struct Aligned<T> {
    memory: Vec<T>,
    skipped: usize,
    len: usize,
}

impl<T: Element> Aligned<T> {
    /// So many zeros.
    ///
    /// # Errors
    /// [`Error::Memory`] if there is no room for them.
    pub(crate) fn new(len: usize) -> Result<Self, Error> {
        let needed = len.saturating_add(slack::<T>());
        let bytes = needed.saturating_mul(size_of::<T>());
        let memory: Vec<T> = try_zeroed_vec(needed).map_err(|()| Error::Memory { bytes })?;
        let skipped = memory.as_ptr().align_offset(LINE_BYTES);
        Ok(Self { memory, skipped, len })
    }

    /// A copy of a table of a plan, for which a call has asked whether there is room.
    pub(crate) fn copy_of(values: &[T]) -> Self {
        let mut copy = Self::new(values.len()).expect("room for a plan");
        copy.numbers_mut().copy_from_slice(values);
        copy
    }

    pub(crate) fn numbers(&self) -> &[T] {
        &self.memory[self.skipped..][..self.len]
    }

    pub(crate) fn numbers_mut(&mut self) -> &mut [T] {
        &mut self.memory[self.skipped..][..self.len]
    }
}

/// `buffer`, a part of an aligned one, as complex vectors.
#[inline(always)]
pub(crate) fn complex_vectors<V: Vector>(buffer: &mut [V::Element]) -> &mut [Complex<V>] {
    // SAFETY: a `Complex<V>` is numbers of type `V::Element` without padding, for which any bits are a value.
    let (before, vectors, _) = unsafe { buffer.align_to_mut() };
    assert!(before.is_empty(), "buffers of vectors are aligned");
    vectors
}

/// As [`complex_vectors`], to read.
#[inline(always)]
pub(crate) fn complex_vectors_of<V: Vector>(buffer: &[V::Element]) -> &[Complex<V>] {
    // SAFETY: a `Complex<V>` is numbers of type `V::Element` without padding, for which any bits are a value.
    let (before, vectors, _) = unsafe { buffer.align_to() };
    assert!(before.is_empty(), "buffers of vectors are aligned");
    vectors
}
