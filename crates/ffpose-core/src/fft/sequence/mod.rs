//! The filter on sequences, which are grids of height one: lanes are channels, some vectors of them at a time.
//!
//! A channel sees nothing of the others: of a real line of even length the even and the odd points are real and imaginary part of
//! a complex line of half the length ([`halves`]). A line of odd length is the real part of a complex one.

mod halves;
mod lines;

use std::ops::Range;

use ndarray::{ArrayView2, ArrayView3, ArrayViewMut2, ArrayViewMut3, Axis};

use self::lines::Lines;
use crate::kernel::{Backward, Factor, Kernel, Packing};
use crate::parallel::Team;
use crate::simd::{
    Algorithm, Complex, Element, Isa, LINE_BYTES, Stored, Tile, TileMut, Vector, aligned,
    complex_vectors, slack,
};
use crate::tuning::{L1_CACHE, SEQUENCE_AHEAD, SEQUENCE_VECTORS};
use crate::views::{self, BATCH};

/// The plan for sequences of one length and number of channels.
pub(crate) struct Sequence<T> {
    isa: Isa,
    /// Lanes of a vector.
    lanes: usize,
    length: usize,
    lines: Lines<T>,
    /// Vectors of the widest tile.
    vectors: usize,
}

/// The scratch of one call, cut into its uses.
struct SequenceBuffers<'a, T> {
    spectrum: &'a mut [T],
    other: &'a mut [T],
    work: &'a mut [T],
    padded: &'a mut [T],
    /// A weight, or its gradient, of fewer lanes than a vector has.
    bins: &'a mut [T],
}

impl<T: Element> Sequence<T> {
    pub(crate) fn new(isa: Isa, length: usize, channels: usize) -> Self {
        let (lanes, lines) = (isa.lanes::<T>(), Lines::new(isa, length));
        let bytes = 2 * lanes * lines.pitch() * size_of::<T>();
        let fits = |vectors: usize| vectors * bytes <= L1_CACHE;
        let half = SEQUENCE_VECTORS / 2;
        let vectors = if fits(half) && !fits(SEQUENCE_VECTORS) { half } else { SEQUENCE_VECTORS };
        // or three, where that leaves no rest of less than a vector: such a rest is copied
        let has_rest = |vectors: &usize| (1..lanes).contains(&(channels % (vectors * lanes)));
        let three = SEQUENCE_VECTORS - 1;
        let vectors = [vectors, three].into_iter().find(|v| !has_rest(v)).unwrap_or(vectors);
        Self { isa, lanes, length, lines, vectors }
    }

    /// Most lanes of a tile.
    fn most(&self) -> usize {
        self.vectors * self.lanes
    }

    fn scratch<'a>(&self, scratch: &'a mut [T]) -> SequenceBuffers<'a, T> {
        let spectra = self.vectors * self.line_len();
        let (spectrum, rest) = aligned(scratch).split_at_mut(spectra);
        let (other, rest) = rest.split_at_mut(spectra);
        let (work, rest) = rest.split_at_mut(self.lines.work_len());
        let (padded, rest) = rest.split_at_mut(self.length * self.lanes);
        SequenceBuffers { spectrum, other, work, padded, bins: &mut rest[..self.bins_len()] }
    }

    /// Numbers of a weight of one vector.
    fn bins_len(&self) -> usize {
        2 * self.lanes * (self.length / 2 + 1)
    }

    /// Numbers of one line of vectors.
    fn line_len(&self) -> usize {
        2 * self.lanes * self.lines.pitch()
    }

    /// Lines for so many lanes.
    fn lines<'a>(&self, spectrum: &'a mut [T], lanes: usize) -> &'a mut [T] {
        &mut spectrum[..lanes.div_ceil(self.lanes) * self.line_len()]
    }

    /// A sequence `(points, lanes)` to lines; `padded` holds it if its lanes do not fill a vector.
    fn enter<X: Stored<Real = T>>(
        &self,
        image: ArrayView2<'_, X>,
        lines: &mut [T],
        padded: &mut [T],
    ) {
        if image.ncols() < self.lanes {
            let image = Tile::dense(views::padded(image, self.lanes, padded), self.lanes);
            self.isa.run(EnterPoints { plan: self, image, lines });
        } else {
            self.isa.run(EnterPoints { plan: self, image: Tile::new(image), lines });
        }
    }

    /// Lines to a sequence `(points, lanes)`, by way of `padded` if its lanes do not fill a vector.
    fn leave<X: Stored<Real = T>>(
        &self,
        lines: &mut [T],
        image: ArrayViewMut2<'_, X>,
        padded: &mut [T],
    ) {
        if image.ncols() < self.lanes {
            let whole = TileMut::dense(&mut *padded, self.lanes);
            self.isa.run(LeavePoints { plan: self, image: whole, lines });
            views::unpadded(padded, self.lanes, image);
        } else {
            self.isa.run(LeavePoints { plan: self, image: TileMut::new(image), lines });
        }
    }
}

impl<T: Element> Packing<T> for Sequence<T> {
    fn packed_len(&self, lanes: usize) -> usize {
        lanes.div_ceil(self.lanes) * self.lines.packed_len()
    }

    fn pack(
        &self,
        weight: ArrayView3<'_, T>,
        lanes: Range<usize>,
        factor: Factor,
        packed: &mut [T],
        team: &mut Team<'_, T>,
    ) {
        let packed = &mut packed[..self.packed_len(lanes.len())];
        let weight = views::bins_of(weight, lanes, self.lanes);
        if weight.len_of(Axis(1)) < self.lanes {
            let room = self.scratch(team.scratch()).bins;
            self.lines.pack(views::padded_bins(weight, self.lanes, room), factor, packed);
        } else {
            self.lines.pack(weight, factor, packed);
        }
    }
}

impl<X: Stored> Kernel<X> for Sequence<X::Real> {
    fn tile(&self) -> usize {
        self.most()
    }

    /// Whole cache lines, as far as tiles are made of them.
    fn narrowest_tile(&self) -> usize {
        let line = (LINE_BYTES / size_of::<X>()).next_multiple_of(self.lanes).min(self.most());
        if self.most().is_multiple_of(line) { line } else { self.lanes }
    }

    fn scratch_len(&self, _: usize) -> usize {
        let padded = self.length * self.lanes;
        let spectra = 2 * self.vectors * self.line_len();
        slack::<X::Real>() + spectra + self.lines.work_len() + padded + self.bins_len()
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
        let SequenceBuffers { spectrum, work, padded, .. } = self.scratch(team.scratch());
        let lines = self.lines(spectrum, x.len_of(Axis(2)));
        for (x, y) in x.outer_iter().zip(y.outer_iter_mut()) {
            self.enter(x, lines, padded);
            self.lines.filter(lines, packed, work);
            self.leave(lines, y, padded);
        }
    }

    fn backward(&self, pass: Backward<'_, X>, team: &mut Team<'_, X::Real>) {
        let Backward { grad, x, weight, mut grad_x, mut grad_sum, .. } = pass;
        let SequenceBuffers { spectrum, other, work, padded, .. } = self.scratch(team.scratch());
        let lanes = grad.len_of(Axis(2));
        let (lines, other) = (self.lines(spectrum, lanes), self.lines(other, lanes));
        for (image, grad) in grad.outer_iter().enumerate() {
            self.enter(grad, lines, padded);
            let weight = grad_x.is_some().then_some(weight);
            if let Some(sum) = grad_sum.as_deref_mut() {
                self.enter(x.index_axis(BATCH, image), other, padded);
                self.lines.gradient(lines, other, weight, sum, work);
            } else if let Some(weight) = weight {
                self.lines.filter(lines, weight, work);
            }
            if let Some(grad_x) = &mut grad_x {
                self.leave(lines, grad_x.index_axis_mut(BATCH, image), padded);
            }
        }
    }

    fn unpack_gradient(
        &self,
        grad_sum: &[X::Real],
        grad_weight: ArrayViewMut3<'_, X::Real>,
        team: &mut Team<'_, X::Real>,
    ) {
        let lanes = grad_weight.len_of(Axis(1));
        let grad_sum = &grad_sum[..self.packed_len(lanes)];
        if lanes < self.lanes {
            let mut whole = views::bins(self.scratch(team.scratch()).bins, self.lanes);
            self.lines.unpack(grad_sum, whole.view_mut());
            views::unpadded_bins(whole.view(), grad_weight);
        } else {
            self.lines.unpack(grad_sum, grad_weight);
        }
    }
}

/// Real lines to complex ones.
struct EnterPoints<'a, X: Stored> {
    plan: &'a Sequence<X::Real>,
    image: Tile<'a, X>,
    lines: &'a mut [X::Real],
}

impl<X: Stored> Algorithm<X::Real> for EnterPoints<'_, X> {
    #[inline(always)]
    fn run<V: Vector<Element = X::Real>>(self) {
        let Self { plan: Sequence { lines: plan, length, .. }, image, lines } = self;
        let (inputs, pitch) = (plan.transform().inputs(), plan.pitch());
        let lines = complex_vectors::<V>(lines);
        let halves = length.is_multiple_of(2);
        let parts: [_; SEQUENCE_VECTORS] = image.parts(V::LANES);
        for (n, &input) in inputs.iter().enumerate() {
            for (line, image) in lines.chunks_exact_mut(pitch).zip(&parts) {
                line[input] = if halves {
                    image.prefetch(2 * n + SEQUENCE_AHEAD, 2);
                    let [re, im] = image.gather(2 * n, 1);
                    Complex::new(re, im)
                } else {
                    image.prefetch(n + SEQUENCE_AHEAD, 1);
                    let [re] = image.gather(n, 1);
                    Complex::new(re, V::splat(X::Real::default()))
                };
            }
        }
    }
}

/// Undoes [`EnterPoints`].
struct LeavePoints<'a, X: Stored> {
    plan: &'a Sequence<X::Real>,
    image: TileMut<'a, X>,
    lines: &'a mut [X::Real],
}

impl<X: Stored> Algorithm<X::Real> for LeavePoints<'_, X> {
    #[inline(always)]
    fn run<V: Vector<Element = X::Real>>(self) {
        let Self { plan: Sequence { lines: plan, length, .. }, mut image, lines } = self;
        let (inputs, pitch) = (plan.transform().inputs(), plan.pitch());
        let lines = complex_vectors::<V>(lines);
        let halves = length.is_multiple_of(2);
        let mut parts: [_; SEQUENCE_VECTORS] = image.parts(V::LANES);
        for (n, &input) in inputs.iter().enumerate() {
            for (line, image) in lines.chunks_exact(pitch).zip(&mut parts) {
                let Complex { re, im } = line[input];
                if halves {
                    image.reader().prefetch(2 * n + SEQUENCE_AHEAD, 2);
                    image.scatter(2 * n, 1, [re, im]);
                } else {
                    image.reader().prefetch(n + SEQUENCE_AHEAD, 1);
                    image.scatter(n, 1, [re]);
                }
            }
        }
    }
}
