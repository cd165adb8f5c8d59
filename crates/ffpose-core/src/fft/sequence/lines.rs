//! The real lines of a sequence as complex lines: of even length half as long, of odd length with imaginary part zero.

use ndarray::{ArrayView3, ArrayViewMut3};

use super::halves::Halves;
use crate::fft::columns::order::{BinOrder, Bins, Scales};
use crate::fft::columns::{Columns, First};
use crate::fft::transform::{Transform, inverted};
use crate::kernel::Factor;
use crate::simd::{Element, Isa};

/// The plan for lines of one length, each of as many lanes as a vector has.
pub(super) enum Lines<T> {
    Even(Halves<T>),
    Odd(Isa, Columns<T>, BinOrder<T>),
}

impl<T: Element> Lines<T> {
    pub(super) fn new(isa: Isa, length: usize) -> Self {
        if length.is_multiple_of(2) {
            return Self::Even(Halves::new(isa, length));
        }
        let columns = Columns::new(isa, length, 1, First::Complex);
        let bins = Bins { rows: 1, columns: length };
        let frequencies = inverted(columns.transform().outputs());
        let others = frequencies[1..].iter().map(|&k| bins.of(0, k)).collect();
        let norm = 1.0 / length as f64;
        let scales =
            |plain| Scales { hermitian: T::nearest(plain / 2.0), plain: T::nearest(plain) };
        let hermitian = vec![bins.with_mirror(0, 0)];
        let (weight, gradient) = (scales(norm), scales(2.0 * norm));
        let order = BinOrder { hermitian, others, weight, gradient };
        Self::Odd(isa, columns, order)
    }

    pub(super) fn transform(&self) -> &Transform<T> {
        match self {
            Self::Even(halves) => halves.transform(),
            Self::Odd(_, columns, _) => columns.transform(),
        }
    }

    /// Complex vectors from one line to the next.
    pub(super) fn pitch(&self) -> usize {
        match self {
            Self::Even(halves) => halves.pitch(),
            Self::Odd(_, columns, _) => columns.pitch(),
        }
    }

    /// Numbers of a packed factor, and of a gradient's sum.
    pub(super) fn packed_len(&self) -> usize {
        match self {
            Self::Even(halves) => halves.packed_len(),
            Self::Odd(_, columns, _) => columns.packed_len(),
        }
    }

    pub(super) fn work_len(&self) -> usize {
        match self {
            Self::Even(halves) => halves.work_len(),
            Self::Odd(_, columns, _) => columns.work_len(),
        }
    }

    /// A factor made of `weight` `(bins, lanes, 2)`, of one vector or more, to `packed`, one vector of lanes after the other.
    pub(super) fn pack(&self, weight: ArrayView3<'_, T>, factor: Factor, packed: &mut [T]) {
        match self {
            Self::Even(halves) => halves.pack(weight, factor, packed),
            Self::Odd(isa, _, order) => order.pack(*isa, weight, factor, packed),
        }
    }

    /// As [`crate::kernel::Kernel::unpack_gradient`], for one vector or more.
    pub(super) fn unpack(&self, sum: &[T], gradient: ArrayViewMut3<'_, T>) {
        match self {
            Self::Even(halves) => halves.unpack(sum, gradient),
            Self::Odd(isa, _, order) => order.unpack(*isa, sum, gradient),
        }
    }

    /// The lines times a packed factor.
    pub(super) fn filter(&self, lines: &mut [T], factor: &[T], work: &mut [T]) {
        match self {
            Self::Even(halves) => halves.filter(lines, factor, work),
            Self::Odd(_, columns, _) => columns.filter(lines, factor, work),
        }
    }

    /// `sum += conj(x) · grad`, and `grad · factor` if there is a factor; else `grad` is lost. `x` is transformed.
    pub(super) fn gradient(
        &self,
        grad: &mut [T],
        x: &mut [T],
        factor: Option<&[T]>,
        sum: &mut [T],
        work: &mut [T],
    ) {
        match self {
            Self::Even(halves) => halves.gradient(grad, x, factor, sum, work),
            Self::Odd(_, columns, _) => columns.gradient(grad, x, factor, sum, work),
        }
    }
}
