//! The columns of an image: forward transform, what is done with the spectrum, and inverse, one column at a time in cache.
//!
//! A packed weight, and a gradient sum, holds for each column its places in turn. The places of two real columns, those of DC and
//! Nyquist, packed together are `W(0), N(0), W(1), N(1), ...` up to row frequency `H / 2`; both are Hermitian in it.

mod fused;
mod geometry;
pub(crate) mod order;
pub(crate) mod pointwise;

use self::fused::Fused;
use self::geometry::Geometry;
use self::pointwise::{Accumulate, At, Pointwise, Product};
use crate::fft::codelets::pair::{join, split};
use crate::fft::transform::Transform;
use crate::simd::{
    Algorithm, Complex, Element, Isa, Tile, TileMut, Vector, complex_vectors, scatter,
};

/// How the columns of some lanes are transformed, all vectors of a column before the next column.
pub(crate) struct Columns<T> {
    isa: Isa,
    transform: Transform<T>,
    fused: Option<Fused>,
    count: usize,
    first: First,
}

/// What column 0 is.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum First {
    /// As the others.
    Complex,
    /// Two real columns, as real and imaginary part.
    TwoReal,
}

impl<T: Element> Columns<T> {
    pub(crate) fn new(isa: Isa, length: usize, count: usize, first: First) -> Self {
        let transform = Transform::new(isa, length);
        Self { isa, fused: Fused::of(&transform), transform, count, first }
    }

    pub(crate) fn transform(&self) -> &Transform<T> {
        &self.transform
    }

    /// Complex vectors from one column to the next: room for the places of column 0, and odd, since an even number would meet
    /// the same few sets of the cache.
    pub(crate) fn pitch(&self) -> usize {
        self.first_places() | 1
    }

    /// Numbers in all columns of one vector.
    pub(crate) fn len(&self) -> usize {
        self.numbers(self.count * self.pitch())
    }

    /// Places of column 0.
    fn first_places(&self) -> usize {
        let length = self.transform.len();
        match self.first {
            First::Complex => length,
            First::TwoReal => 2 * (length / 2 + 1),
        }
    }

    /// Numbers in a packed weight of one vector.
    pub(crate) fn packed_len(&self) -> usize {
        self.numbers(self.places())
    }

    fn places(&self) -> usize {
        self.first_places() + (self.count - 1) * self.transform.len()
    }

    /// Numbers of scratch that a run needs.
    pub(crate) fn work_len(&self) -> usize {
        self.numbers(self.first_places() + self.transform.work_len())
    }

    /// Numbers in complex vectors.
    fn numbers(&self, vectors: usize) -> usize {
        2 * self.isa.lanes::<T>() * vectors
    }

    /// `spectrum · factor` for all columns.
    pub(crate) fn filter(&self, spectrum: &mut [T], factor: &[T], work: &mut [T]) {
        let factor = Tile::dense(factor, self.isa.lanes::<T>());
        self.through::<_, true>(spectrum, Product { factor, places: self.places() }, work);
    }

    /// `sum += conj(x) · grad`, and `grad · factor` if there is a factor; else `grad` is lost. `x` is transformed.
    pub(crate) fn gradient(
        &self,
        grad: &mut [T],
        x: &mut [T],
        factor: Option<&[T]>,
        sum: &mut [T],
        work: &mut [T],
    ) {
        let (lanes, places) = (self.isa.lanes::<T>(), self.places());
        self.through::<_, false>(x, (), work);
        let (x, sum) = (Tile::dense(x, lanes), TileMut::dense(sum, lanes));
        let accumulate = Accumulate { x, sum, places };
        match factor {
            Some(factor) => {
                let product = Product { factor: Tile::dense(factor, lanes), places };
                self.through::<_, true>(grad, (accumulate, product), work);
            }
            None => self.look(grad, accumulate, work),
        }
    }

    /// Forward transform, then `pointwise` on the spectrum, which stays. The gradient of the weight alone, without that of the image, is
    /// rare, and not worth kernels of its own.
    pub(crate) fn look<M: Pointwise<T>>(
        &self,
        spectrum: &mut [T],
        mut pointwise: M,
        work: &mut [T],
    ) {
        self.through::<_, false>(spectrum, (), work);
        let geometry = self.geometry();
        for (column, vector) in geometry.lines(spectrum.len() / self.numbers(geometry.pitch)) {
            let at = geometry.at(column, vector);
            let places = if column == 0 { self.first_places() } else { self.transform.len() };
            let line = &mut spectrum[self.numbers(at.position)..][..self.numbers(places)];
            self.isa.run(PointwiseStep { line, pointwise: &mut pointwise, at });
        }
    }

    /// Forward transform, `pointwise` and inverse, for every vector of lanes in `spectrum`. Without inverse the spectrum stays, a
    /// pair as its places.
    pub(crate) fn through<M: Pointwise<T>, const INVERSE: bool>(
        &self,
        spectrum: &mut [T],
        mut pointwise: M,
        work: &mut [T],
    ) {
        let (isa, transform, geometry) = (self.isa, &self.transform, self.geometry());
        if let Some(fused) = self.fused {
            let columns = Through { geometry, spectrum, pointwise, work };
            fused.run::<T, M, INVERSE>(isa, transform.passes(), columns);
            return;
        }
        let (length, pitch) = (self.numbers(transform.len()), self.numbers(geometry.pitch));
        for (column, vector) in geometry.lines(spectrum.len() / pitch) {
            let at = geometry.at(column, vector);
            let line = &mut spectrum[self.numbers(at.position)..][..pitch];
            transform.forward(&mut line[..length], work);
            if geometry.is_pair(column) {
                isa.run(PairStep::<T, M, INVERSE> {
                    geometry,
                    column: line,
                    places: work,
                    pointwise: &mut pointwise,
                    at,
                });
            } else {
                isa.run(PointwiseStep { line: &mut line[..length], pointwise: &mut pointwise, at });
            }
            if INVERSE {
                transform.inverse(&mut line[..length], work);
            }
        }
    }

    fn geometry(&self) -> Geometry<'_> {
        Geometry {
            outputs: self.transform.outputs(),
            count: self.count,
            pitch: self.pitch(),
            first: self.first,
            first_places: self.first_places(),
        }
    }
}

/// Columns that go forward, through a pointwise operation, and back.
pub(crate) struct Through<'a, T, M> {
    pub(crate) geometry: Geometry<'a>,
    pub(crate) spectrum: &'a mut [T],
    pub(crate) pointwise: M,
    /// Room for the places of column 0.
    pub(crate) work: &'a mut [T],
}

/// `pointwise` on a column.
struct PointwiseStep<'a, T, M> {
    line: &'a mut [T],
    pointwise: &'a mut M,
    at: At,
}

impl<T: Element, M: Pointwise<T>> Algorithm<T> for PointwiseStep<'_, T, M> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        for (i, z) in complex_vectors::<V>(self.line).iter_mut().enumerate() {
            [*z] = self.pointwise.apply(self.at.plus(i), [*z]);
        }
    }
}

/// [`pair_step`] on vectors of an instruction set.
struct PairStep<'a, T, M, const INVERSE: bool> {
    geometry: Geometry<'a>,
    column: &'a mut [T],
    places: &'a mut [T],
    pointwise: &'a mut M,
    at: At,
}

impl<T: Element, M: Pointwise<T>, const INVERSE: bool> Algorithm<T>
    for PairStep<'_, T, M, INVERSE>
{
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let (column, places) =
            (complex_vectors::<V>(self.column), complex_vectors::<V>(self.places));
        pair_step::<V, M, INVERSE>(self.geometry, column, places, self.pointwise, self.at);
    }
}

/// `pointwise` on the packed column 0, and its real columns packed again if the inverse follows, else left as places.
#[inline(always)]
pub(crate) fn pair_step<V: Vector, M: Pointwise<V::Element>, const INVERSE: bool>(
    geometry: Geometry<'_>,
    column: &mut [Complex<V>],
    places: &mut [Complex<V>],
    pointwise: &mut M,
    at: At,
) {
    let outputs = geometry.outputs;
    let length = outputs.len();
    for k in 0..=length / 2 {
        // a division would take as long as the arithmetic
        let (position, mirror) = (outputs[k], outputs[if k == 0 { 0 } else { length - k }]);
        let both = pointwise.apply(at.plus(2 * k), split(column[position], column[mirror]));
        if INVERSE {
            let (z, opposite) = join(both);
            column[position] = z;
            column[mirror] = opposite;
        } else {
            scatter(places, 2 * k, 1, both);
        }
    }
    if !INVERSE {
        let count = length / 2 * 2 + 2;
        column[..count].copy_from_slice(&places[..count]);
    }
}
