//! Views of memory as points of lanes. Every function checks its bounds once, for all the elements that it touches.

use std::marker::PhantomData;
use std::mem::MaybeUninit;

use ndarray::{ArrayView2, ArrayView3, ArrayViewMut2, ArrayViewMut3};

use super::memory::is_within;
use super::prefetch::{prefetch, prefetch_lines};
use super::{Complex, Element, Stored, Vector};

/// Points to read, each a run of contiguous elements (its lanes), at a constant distance.
#[derive(Clone, Copy)]
pub(crate) struct Tile<'a, T> {
    start: *const T,
    points: usize,
    lanes: usize,
    stride: usize,
    view: PhantomData<&'a [T]>,
}

/// Points to write, each a run of contiguous elements (its lanes), at a constant distance.
pub(crate) struct TileMut<'a, T> {
    start: *mut T,
    points: usize,
    lanes: usize,
    stride: usize,
    view: PhantomData<&'a mut [T]>,
}

/// `(points, lanes, stride)` of a view `(points, lanes)`.
fn layout(shape: (usize, usize), strides: &[isize]) -> (usize, usize, usize) {
    assert!(shape.1 <= 1 || strides[1] == 1, "the lanes of a tile are contiguous");
    let stride = usize::try_from(strides[0]).expect("the points of a tile go forward");
    (shape.0, shape.1, stride)
}

/// `(points, lanes, stride)` of a view `(points, lanes / 2, 2)`.
fn complex_layout(shape: (usize, usize, usize), strides: &[isize]) -> (usize, usize, usize) {
    assert!(
        shape.2 == 2 && strides[2] == 1 && (shape.1 <= 1 || strides[1] == 2),
        "complex numbers are contiguous"
    );
    layout((shape.0, 2 * shape.1), &[strides[0], 1])
}

impl<'a, T: Stored> Tile<'a, T> {
    /// The tile of `view` `(points, lanes)`.
    pub(crate) fn new(view: ArrayView2<'a, T>) -> Self {
        let (points, lanes, stride) = layout(view.dim(), view.strides());
        Self { start: view.as_ptr(), points, lanes, stride, view: PhantomData }
    }

    /// `slice` as points of `lanes` elements without gaps.
    #[inline(always)]
    pub(crate) fn dense(slice: &'a [T], lanes: usize) -> Self {
        let (start, points) = (slice.as_ptr(), slice.len() / lanes);
        Self { start, points, lanes, stride: lanes, view: PhantomData }
    }

    /// The first `LANES` lanes of the points `first`, `first + step`, ...
    #[inline(always)]
    pub(crate) fn gather<V: Vector<Element = T::Real>, const N: usize>(
        &self,
        first: usize,
        step: usize,
    ) -> [V; N] {
        assert!(V::LANES <= self.lanes && is_within(first, N, step, self.points));
        // SAFETY: an array of uninitialized elements needs no initialization.
        let mut vectors: [MaybeUninit<V>; N] = unsafe { MaybeUninit::uninit().assume_init() };
        for (i, vector) in vectors.iter_mut().enumerate() {
            // SAFETY: the point is one of the view's, which holds `lanes >= LANES` elements there (checked above).
            vector.write(unsafe { T::load(self.start.add((first + i * step) * self.stride)) });
        }
        // SAFETY: the loop wrote every element; the two types have the same layout.
        unsafe { std::mem::transmute_copy(&vectors) }
    }

    /// The first `LANES` lanes of the points `first + offsets[0]`, `first + offsets[1]`, ..., these offsets below `span`.
    #[inline(always)]
    pub(crate) fn gather_at<V: Vector<Element = T::Real>, const N: usize>(
        &self,
        first: usize,
        offsets: [usize; N],
        span: usize,
    ) -> [V; N] {
        assert!(V::LANES <= self.lanes && is_within(first, span, 1, self.points));
        // SAFETY: an array of uninitialized elements needs no initialization.
        let mut vectors: [MaybeUninit<V>; N] = unsafe { MaybeUninit::uninit().assume_init() };
        for (vector, &offset) in vectors.iter_mut().zip(&offsets) {
            assert!(offset < span); // constants, as a rule
            // SAFETY: the point is one of the view's, which holds `lanes >= LANES` elements there (checked above).
            vector.write(unsafe { T::load(self.start.add((first + offset) * self.stride)) });
        }
        // SAFETY: the loop wrote every element; the two types have the same layout.
        unsafe { std::mem::transmute_copy(&vectors) }
    }

    pub(crate) fn points(&self) -> usize {
        self.points
    }

    pub(crate) fn lanes(&self) -> usize {
        self.lanes
    }

    /// One point as points of `lanes` lanes.
    #[inline(always)]
    pub(crate) fn point(&self, point: usize, lanes: usize) -> Self {
        assert!(point < self.points);
        // SAFETY: the point is one of the view's (checked above).
        let start = unsafe { self.start.add(point * self.stride) };
        Self { start, points: self.lanes / lanes, lanes, stride: lanes, view: PhantomData }
    }

    /// Asks for the cache lines where `count` points from `first` on begin. They may lie behind the last point: then it
    /// is memory of a neighbor, if any.
    #[inline(always)]
    pub(crate) fn prefetch(&self, first: usize, count: usize) {
        let mut address = self.start.wrapping_add(first * self.stride);
        for _ in 0..count {
            prefetch(address);
            address = address.wrapping_add(self.stride);
        }
    }

    /// Asks for the cache lines of one of `shares` equal shares of `count` points from `first` on, which may lie behind the
    /// last point.
    #[inline(always)]
    pub(crate) fn prefetch_share(&self, first: usize, count: usize, share: usize, shares: usize) {
        let each = count.div_ceil(shares);
        for point in first + (share * each).min(count)..first + (share * each + each).min(count) {
            prefetch_lines(self.start.wrapping_add(point * self.stride), self.lanes);
        }
    }

    /// As [`prefetch_share`](Self::prefetch_share), by a call: kernels of long rows are slower with it inside, by up to a sixth on
    /// Zen 5, wanted or not.
    #[inline(never)]
    pub(crate) fn call_prefetch_share(
        &self,
        first: usize,
        count: usize,
        share: usize,
        shares: usize,
    ) {
        self.prefetch_share(first, count, share, shares);
    }

    /// Asks for all cache lines of the points, which are without gaps.
    #[inline(always)]
    pub(crate) fn prefetch_all(&self) {
        prefetch_lines(self.start, self.points * self.lanes);
    }

    /// As [`prefetch_all`](Self::prefetch_all), for as much memory behind the points.
    #[inline(always)]
    pub(crate) fn prefetch_behind(&self) {
        let len = self.points * self.lanes;
        prefetch_lines(self.start.wrapping_add(len), len);
    }

    /// This tile without its first lanes.
    #[inline(always)]
    pub(crate) fn skip_lanes(self, lane: usize) -> Self {
        assert!(lane <= self.lanes);
        // SAFETY: `lane` is inside the run of each point, or just behind it.
        Self { start: unsafe { self.start.add(lane) }, lanes: self.lanes - lane, ..self }
    }

    /// Part number `index` of `width` lanes. The last one ends where the lanes do: where they are no multiple of `width`, it begins
    /// inside the part before it.
    #[inline(always)]
    pub(crate) fn part(self, index: usize, width: usize) -> Self {
        assert!(width <= self.lanes);
        let lane = (index * width).min(self.lanes - width);
        // SAFETY: `width` lanes from `lane` on are inside the run of each point.
        Self { start: unsafe { self.start.add(lane) }, lanes: width, ..self }
    }

    /// The first `N` parts of `width` lanes, as [`part`](Self::part); behind the last one it is the last again.
    #[inline(always)]
    pub(crate) fn parts<const N: usize>(self, width: usize) -> [Self; N] {
        std::array::from_fn(|index| self.part(index, width))
    }
}

/// Tiles of elements of vectors, not of half their precision.
impl<'a, T: Element> Tile<'a, T> {
    /// The tile of `view` `(points, lanes, 2)` of complex numbers, whose lanes are alternately real and imaginary.
    pub(crate) fn of_complex(view: ArrayView3<'a, T>) -> Self {
        let (points, lanes, stride) = complex_layout(view.dim(), view.strides());
        Self { start: view.as_ptr(), points, lanes, stride, view: PhantomData }
    }

    /// Asks for the cache lines of what [`complex`](Self::complex) reads.
    #[inline(always)]
    pub(crate) fn prefetch_complex<V: Vector<Element = T>>(&self, point: usize) {
        prefetch_lines(self.start.wrapping_add(point * self.stride), 2 * V::LANES);
    }

    /// The complex numbers of a point whose lanes are alternately real and imaginary.
    #[inline(always)]
    pub(crate) fn complex<V: Vector<Element = T>>(&self, point: usize) -> Complex<V> {
        let [low] = self.gather(point, 1);
        let [high] = self.skip_lanes(V::LANES).gather(point, 1);
        let (re, im) = V::deinterleave(low, high);
        Complex::new(re, im)
    }
}

impl<'a, T: Stored> TileMut<'a, T> {
    /// The tile of `view` `(points, lanes)`.
    pub(crate) fn new(mut view: ArrayViewMut2<'a, T>) -> Self {
        let (points, lanes, stride) = layout(view.dim(), view.strides());
        Self { start: view.as_mut_ptr(), points, lanes, stride, view: PhantomData }
    }

    /// `slice` as points of `lanes` elements without gaps.
    #[inline(always)]
    pub(crate) fn dense(slice: &'a mut [T], lanes: usize) -> Self {
        let (start, points) = (slice.as_mut_ptr(), slice.len() / lanes);
        Self { start, points, lanes, stride: lanes, view: PhantomData }
    }

    /// This tile without its first lanes.
    #[inline(always)]
    pub(crate) fn skip_lanes(&mut self, lane: usize) -> TileMut<'_, T> {
        assert!(lane <= self.lanes);
        // SAFETY: `lane` is inside the run of each point, or just behind it.
        let start = unsafe { self.start.add(lane) };
        let (points, stride) = (self.points, self.stride);
        TileMut { start, points, lanes: self.lanes - lane, stride, view: PhantomData }
    }

    /// As [`Tile::part`].
    #[inline(always)]
    pub(crate) fn part(&mut self, index: usize, width: usize) -> TileMut<'_, T> {
        assert!(width <= self.lanes);
        let lane = (index * width).min(self.lanes - width);
        // SAFETY: `width` lanes from `lane` on are inside the run of each point.
        let start = unsafe { self.start.add(lane) };
        let (points, stride) = (self.points, self.stride);
        TileMut { start, points, lanes: width, stride, view: PhantomData }
    }

    /// As [`Tile::parts`]. They may overlap: what is written last stays.
    #[inline(always)]
    pub(crate) fn parts<const N: usize>(&mut self, width: usize) -> [TileMut<'_, T>; N] {
        let (points, stride) = (self.points, self.stride);
        std::array::from_fn(|index| {
            let start = self.part(index, width).start;
            TileMut { start, points, lanes: width, stride, view: PhantomData }
        })
    }

    /// One point as points of `lanes` lanes.
    #[inline(always)]
    pub(crate) fn point(&mut self, point: usize, lanes: usize) -> TileMut<'_, T> {
        assert!(point < self.points);
        // SAFETY: the point is one of the view's (checked above).
        let start = unsafe { self.start.add(point * self.stride) };
        TileMut { start, points: self.lanes / lanes, lanes, stride: lanes, view: PhantomData }
    }

    /// The same points, to read.
    #[inline(always)]
    pub(crate) fn reader(&self) -> Tile<'_, T> {
        let Self { start, points, lanes, stride, .. } = *self;
        Tile { start, points, lanes, stride, view: PhantomData }
    }

    /// Writes the first `LANES` lanes of the points `first`, `first + step`, ...
    #[inline(always)]
    pub(crate) fn scatter<V: Vector<Element = T::Real>, const N: usize>(
        &mut self,
        first: usize,
        step: usize,
        vectors: [V; N],
    ) {
        assert!(V::LANES <= self.lanes && is_within(first, N, step, self.points));
        for (i, vector) in vectors.iter().enumerate() {
            // SAFETY: the point is one of the view's, which holds `lanes >= LANES` elements there (checked above).
            unsafe { T::store(*vector, self.start.add((first + i * step) * self.stride)) };
        }
    }

    /// Writes the first `LANES` lanes of the points `first + offsets[0]`, ..., these offsets below `span`.
    #[inline(always)]
    pub(crate) fn scatter_at<V: Vector<Element = T::Real>, const N: usize>(
        &mut self,
        first: usize,
        offsets: [usize; N],
        span: usize,
        vectors: [V; N],
    ) {
        assert!(V::LANES <= self.lanes && is_within(first, span, 1, self.points));
        for (vector, &offset) in vectors.iter().zip(&offsets) {
            assert!(offset < span); // constants, as a rule
            // SAFETY: the point is one of the view's, which holds `lanes >= LANES` elements there (checked above).
            unsafe { T::store(*vector, self.start.add((first + offset) * self.stride)) };
        }
    }
}

/// Tiles of elements of vectors, not of half their precision.
impl<'a, T: Element> TileMut<'a, T> {
    /// The tile of `view` `(points, lanes, 2)` of complex numbers, whose lanes are alternately real and imaginary.
    pub(crate) fn of_complex(mut view: ArrayViewMut3<'a, T>) -> Self {
        let (points, lanes, stride) = complex_layout(view.dim(), view.strides());
        Self { start: view.as_mut_ptr(), points, lanes, stride, view: PhantomData }
    }

    /// Writes the complex numbers of a point whose lanes are alternately real and imaginary.
    #[inline(always)]
    pub(crate) fn set_complex<V: Vector<Element = T>>(&mut self, point: usize, z: Complex<V>) {
        assert!(2 * V::LANES <= self.lanes && point < self.points);
        let (low, high) = V::interleave(z.re, z.im);
        // SAFETY: the point is one of the view's, which holds `lanes >= 2 LANES` elements there (checked above).
        unsafe {
            let start = self.start.add(point * self.stride);
            low.store(start);
            high.store(start.add(V::LANES));
        }
    }
}
