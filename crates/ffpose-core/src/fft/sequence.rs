//! The filter on sequences, which are grids of height one: lanes are channels, up to two vectors of them at a time.
//!
//! A channel sees nothing of the others: of a real line of even length the even and the odd points are real and imaginary part of
//! a complex line of half the length, which the product takes apart and joins again ([`crate::fft::codelets::pair`]). A line of odd length is the
//! real part of a complex one.

use ndarray::{ArrayView2, ArrayView3, ArrayViewMut2, ArrayViewMut3, Axis, s};

use crate::fft::columns::order::{BinOrder, Bins, Scales};
use crate::fft::columns::{Columns, First};
use crate::fft::transform::inverted;
use crate::kernel::{Backward, Kernel, Packing};
use crate::parallel::Team;
use crate::simd::{
    Algorithm, Complex, Element, Isa, LINE_BYTES, Stored, Tile, TileMut, Vector, aligned,
    complex_vectors, slack,
};
use crate::tuning::{SEQUENCE_AHEAD, SEQUENCE_VECTORS};

/// The plan for sequences of one length.
pub(crate) struct Sequence<T> {
    isa: Isa,
    /// Lanes of a vector.
    lanes: usize,
    length: usize,
    columns: Columns<T>,
    order: BinOrder<T>,
}

/// The scratch of one call, cut into its uses.
struct SequenceBuffers<'a, T> {
    spectrum: &'a mut [T],
    other: &'a mut [T],
    work: &'a mut [T],
    padded: &'a mut [T],
    /// A weight, or its gradient, of fewer lanes than two vectors.
    bins: &'a mut [T],
}

impl<T: Element> Sequence<T> {
    pub(crate) fn new(isa: Isa, length: usize) -> Self {
        let columns = if length.is_multiple_of(2) {
            Columns::new(isa, length / 2, 1, First::halves(length))
        } else {
            Columns::new(isa, length, 1, First::Complex)
        };
        let order = order(length, columns.transform().outputs());
        Self { isa, lanes: isa.lanes::<T>(), length, columns, order }
    }

    /// Most lanes of a tile.
    fn most(&self) -> usize {
        SEQUENCE_VECTORS * self.lanes
    }

    fn scratch<'a>(&self, scratch: &'a mut [T]) -> SequenceBuffers<'a, T> {
        let spectra = SEQUENCE_VECTORS * self.columns.len();
        let (spectrum, rest) = aligned(scratch).split_at_mut(spectra);
        let (other, rest) = rest.split_at_mut(spectra);
        let (work, rest) = rest.split_at_mut(self.columns.work_len());
        let (padded, rest) = rest.split_at_mut(self.length * self.most());
        SequenceBuffers { spectrum, other, work, padded, bins: &mut rest[..self.bins_len()] }
    }

    /// Numbers of a weight of a tile.
    fn bins_len(&self) -> usize {
        2 * self.most() * (self.length / 2 + 1)
    }

    /// `room` as a weight `(bins, lanes, 2)`.
    fn bins<'a>(&self, room: &'a mut [T], lanes: usize) -> ArrayViewMut3<'a, T> {
        let bins = self.length / 2 + 1;
        let room = &mut room[..2 * lanes * bins];
        ArrayViewMut3::from_shape((bins, lanes, 2), room).expect("room for a tile")
    }

    /// Lines for so many lanes.
    fn lines<'a>(&self, spectrum: &'a mut [T], lanes: usize) -> &'a mut [T] {
        &mut spectrum[..lanes.div_ceil(self.lanes) * self.columns.len()]
    }

    /// A sequence `(points, lanes)` to lines; `padded` holds it if its lanes are not whole vectors.
    fn enter<X: Stored<Real = T>>(
        &self,
        image: ArrayView2<'_, X>,
        lines: &mut [T],
        padded: &mut [T],
    ) {
        let lanes = image.ncols();
        let whole = lanes.next_multiple_of(self.lanes);
        if lanes < whole {
            let padded = &mut padded[..self.length * whole];
            let mut view = ArrayViewMut2::from_shape((self.length, whole), &mut *padded)
                .expect("room for a tile");
            view.fill(T::default());
            view.slice_mut(s![.., ..lanes]).zip_mut_with(&image, |wide, x| *wide = x.widened());
            self.isa.run(EnterPoints { plan: self, image: Tile::dense(padded, whole), lines });
        } else {
            self.isa.run(EnterPoints { plan: self, image: Tile::new(image), lines });
        }
    }

    /// Lines to a sequence `(points, lanes)`, by way of `padded` if its lanes are not whole vectors.
    fn leave<X: Stored<Real = T>>(
        &self,
        lines: &mut [T],
        mut image: ArrayViewMut2<'_, X>,
        padded: &mut [T],
    ) {
        let lanes = image.ncols();
        let whole = lanes.next_multiple_of(self.lanes);
        if lanes < whole {
            let padded = &mut padded[..self.length * whole];
            self.isa.run(LeavePoints { plan: self, image: TileMut::dense(padded, whole), lines });
            let whole =
                ArrayView2::from_shape((self.length, whole), padded).expect("room for a tile");
            image.zip_mut_with(&whole.slice(s![.., ..lanes]), |x, &wide| *x = X::nearest_to(wide));
        } else {
            self.isa.run(LeavePoints { plan: self, image: TileMut::new(image), lines });
        }
    }
}

/// Where the places of kernel order come from, for transforms whose frequency `k` is at `outputs[k]`.
fn order<T: Element>(length: usize, outputs: &[usize]) -> BinOrder<T> {
    let bins = Bins { rows: 1, columns: length };
    let norm = 1.0 / length as f64;
    let scales = |plain| Scales { hermitian: T::nearest(plain / 2.0), plain: T::nearest(plain) };
    if length.is_multiple_of(2) {
        let half = length / 2;
        let places = (1..=half / 2).flat_map(|k| [bins.of(0, k), bins.of(0, half - k)]);
        let ends = vec![bins.with_mirror(0, 0), bins.with_mirror(0, half)];
        // the product sees doubled spectra, and each half of the way back doubles them
        BinOrder::new(ends, places.collect(), scales(norm / 2.0), scales(norm / 2.0))
    } else {
        let places = inverted(outputs)[1..].iter().map(|&k| bins.of(0, k)).collect();
        let ends = vec![bins.with_mirror(0, 0)];
        BinOrder::new(ends, places, scales(norm), scales(2.0 * norm))
    }
}

impl<T: Element> Packing<T> for Sequence<T> {
    fn packed_len(&self, lanes: usize) -> usize {
        lanes.div_ceil(self.lanes) * self.columns.packed_len()
    }

    fn pack(&self, weight: ArrayView3<'_, T>, packed: &mut [T], team: &mut Team<'_, T>) {
        let lanes = weight.len_of(Axis(1));
        let whole = lanes.next_multiple_of(self.lanes);
        let packed = &mut packed[..whole / self.lanes * self.columns.packed_len()];
        if lanes < whole {
            let mut padded = self.bins(self.scratch(team.scratch()).bins, whole);
            padded.slice_mut(s![.., lanes.., ..]).fill(T::default());
            padded.slice_mut(s![.., ..lanes, ..]).assign(&weight);
            self.order.pack(self.isa, padded.view(), packed);
        } else {
            self.order.pack(self.isa, weight, packed);
        }
    }
}

impl<X: Stored> Kernel<X> for Sequence<X::Real> {
    fn tile(&self) -> usize {
        self.most()
    }

    /// Whole cache lines, as far as a tile has them.
    fn narrowest_tile(&self) -> usize {
        (LINE_BYTES / size_of::<X>()).next_multiple_of(self.lanes).min(self.most())
    }

    fn scratch_len(&self) -> usize {
        let padded = self.length * self.most();
        let spectra = 2 * SEQUENCE_VECTORS * self.columns.len();
        slack::<X::Real>() + spectra + self.columns.work_len() + padded + self.bins_len()
    }

    fn packing(&self) -> Option<&dyn Packing<X::Real>> {
        Some(self)
    }

    fn sum_len(&self, lanes: usize) -> usize {
        self.packed_len(lanes)
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
            self.columns.filter::<false>(lines, packed, work);
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
                self.enter(x.index_axis(Axis(0), image), other, padded);
                self.columns.gradient(lines, other, weight, sum, work);
            } else if let Some(weight) = weight {
                self.columns.filter::<true>(lines, weight, work);
            }
            if let Some(grad_x) = &mut grad_x {
                self.leave(lines, grad_x.index_axis_mut(Axis(0), image), padded);
            }
        }
    }

    fn unpack_gradient(
        &self,
        grad_sum: &[X::Real],
        mut grad_weight: ArrayViewMut3<'_, X::Real>,
        team: &mut Team<'_, X::Real>,
    ) {
        let lanes = grad_weight.len_of(Axis(1));
        let whole = lanes.next_multiple_of(self.lanes);
        let grad_sum = &grad_sum[..whole / self.lanes * self.columns.packed_len()];
        if lanes < whole {
            let mut padded = self.bins(self.scratch(team.scratch()).bins, whole);
            self.order.unpack(self.isa, grad_sum, padded.view_mut());
            grad_weight.assign(&padded.slice(s![.., ..lanes, ..]));
        } else {
            self.order.unpack(self.isa, grad_sum, grad_weight);
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
        let Self { plan: Sequence { columns, length, .. }, image, lines } = self;
        let (inputs, pitch) = (columns.transform().inputs(), columns.pitch());
        let lines = complex_vectors::<V>(lines);
        let halves = length.is_multiple_of(2);
        for (n, &input) in inputs.iter().enumerate() {
            for (vector, line) in lines.chunks_exact_mut(pitch).enumerate() {
                let image = image.skip_lanes(vector * V::LANES);
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
        let Self { plan: Sequence { columns, length, .. }, mut image, lines } = self;
        let (inputs, pitch) = (columns.transform().inputs(), columns.pitch());
        let lines = complex_vectors::<V>(lines);
        let halves = length.is_multiple_of(2);
        for (n, &input) in inputs.iter().enumerate() {
            for (vector, line) in lines.chunks_exact(pitch).enumerate() {
                let mut image = image.skip_lanes(vector * V::LANES);
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
