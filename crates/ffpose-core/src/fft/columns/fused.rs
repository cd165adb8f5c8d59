//! Columns of short lengths: the last pass forward, what is done with the spectrum, and the first pass back share registers.

use super::pointwise::Pointwise;
use super::{Geometry, Through, pair_step};
use crate::fft::codelets::{Codelet, Dft, has_codelet, with_codelet};
use crate::fft::transform::Transform;
use crate::fft::transform::mixed_radix::{Digits, Pass, butterflies};
use crate::simd::{Algorithm, Complex, Element, Isa, Vector, complex_vectors, gather, scatter};

/// A length `P Q` as two passes known at compile time; `P` may be 1.
#[derive(Clone, Copy)]
pub(crate) struct Fused {
    radices: (usize, usize),
}

impl Fused {
    /// How `transform` is fused, if it is short.
    pub(crate) fn of<T: Element>(transform: &Transform<T>) -> Option<Self> {
        let radices = match transform.passes() {
            [last] => (1, last.radix()),
            [first, last] => (first.radix(), last.radix()),
            _ => return None,
        };
        has_codelet!(column radices).then_some(Self { radices })
    }

    /// Transforms the columns, applies the pointwise operation and transforms back; without `INVERSE` the spectrum stays.
    pub(crate) fn run<T: Element, M: Pointwise<T>, const INVERSE: bool>(
        self,
        isa: Isa,
        passes: &[Pass<T>],
        columns: Through<'_, T, M>,
    ) {
        with_codelet!(column self.radices, (P, Q) => {
            isa.run(RunFused::<T, M, INVERSE, P, Q> { passes, columns });
        }, _ => unreachable!("planned radices"));
    }
}

struct RunFused<'a, T, M, const INVERSE: bool, const P: usize, const Q: usize> {
    passes: &'a [Pass<T>],
    columns: Through<'a, T, M>,
}

impl<T: Element, M: Pointwise<T>, const INVERSE: bool, const P: usize, const Q: usize>
    RunFused<'_, T, M, INVERSE, P, Q>
where
    Codelet: Dft<P> + Dft<Q>,
{
    /// Powers of two have twiddles between the passes.
    const DIGITS: Digits = if P.is_multiple_of(2) {
        Digits { outer: 1, middle: Q, inner: 1 }
    } else {
        Digits { outer: 1, middle: 1, inner: Q }
    };

    /// The first pass forward, or the last one back.
    #[inline(always)]
    fn outer<V: Vector<Element = T>, const BACK: bool>(&self, line: &mut [Complex<V>]) {
        if P > 1 {
            butterflies::<V, P, BACK>(line, Self::DIGITS, self.passes[0].twiddles());
        }
    }
}

impl<T: Element, M: Pointwise<T>, const INVERSE: bool, const P: usize, const Q: usize> Algorithm<T>
    for RunFused<'_, T, M, INVERSE, P, Q>
where
    Codelet: Dft<P> + Dft<Q>,
{
    #[inline(always)]
    fn run<V: Vector<Element = T>>(mut self) {
        let geometry @ Geometry { pitch, .. } = self.columns.geometry;
        let spectrum = complex_vectors::<V>(std::mem::take(&mut self.columns.spectrum));
        let places = complex_vectors::<V>(std::mem::take(&mut self.columns.work));
        for (column, vector) in geometry.lines(spectrum.len() / pitch) {
            let at = geometry.at(column, vector);
            let line = &mut spectrum[at.position..][..pitch];
            self.outer::<V, false>(line);
            if geometry.is_pair(column) {
                for start in (0..P * Q).step_by(Q) {
                    scatter(line, start, 1, <Codelet as Dft<Q>>::dft(gather(line, start, 1)));
                }
                pair_step::<_, _, INVERSE>(geometry, line, places, &mut self.columns.pointwise, at);
                if INVERSE {
                    for start in (0..P * Q).step_by(Q) {
                        scatter(line, start, 1, <Codelet as Dft<Q>>::idft(gather(line, start, 1)));
                    }
                }
            } else {
                for start in (0..P * Q).step_by(Q) {
                    let z = <Codelet as Dft<Q>>::dft(gather(line, start, 1));
                    let z = self.columns.pointwise.apply(at.plus(start), z);
                    let z = if INVERSE { <Codelet as Dft<Q>>::idft(z) } else { z };
                    scatter(line, start, 1, z);
                }
            }
            if INVERSE {
                self.outer::<V, true>(line);
            }
        }
    }
}
