//! Columns of short lengths: the last pass forward, what is done with the spectrum, and the first pass back share registers.

use super::butterfly::{Codelet, Dft};
use super::middle::Middle;
use super::passes::{Digits, Pass, forward, inverse};
use super::transform::Transform;
use crate::simd::{Algorithm, Element, Isa, Vector, complex_vectors, gather, scatter};

/// A length `P Q` as two passes known at compile time; `P` may be 1.
#[derive(Clone, Copy)]
pub(crate) struct Fused {
    radices: (usize, usize),
}

/// Runs `$run` with constants `$p` and `$q` equal to `$radices` if that is a supported pair, else `$otherwise`.
macro_rules! with_radices {
    ($radices:expr, ($p:ident, $q:ident) => $run:expr, _ => $otherwise:expr) => {
        with_radices!(@ $radices, $p, $q, $run, $otherwise, 1 7, 1 8, 1 16, 2 7, 4 7, 8 7, 4 8, 8 8)
    };
    (@ $radices:expr, $p:ident, $q:ident, $run:expr, $otherwise:expr, $($p_of:literal $q_of:literal),*) => {
        match $radices {
            $(($p_of, $q_of) => {
                const $p: usize = $p_of;
                const $q: usize = $q_of;
                $run
            })*
            _ => $otherwise,
        }
    };
}

impl Fused {
    /// How `transform` is fused, if it is short.
    pub(crate) fn of<T: Element>(transform: &Transform<T>) -> Option<Self> {
        let radices = match transform.passes() {
            [last] => (1, last.radix()),
            [first, last] => (first.radix(), last.radix()),
            _ => return None,
        };
        with_radices!(radices, (P, Q) => { let _ = (P, Q); Some(Self { radices }) }, _ => None)
    }

    /// Transforms `line`, applies `middle` from `position` and `place` on, and transforms back.
    pub(crate) fn run<T: Element, M: Middle<T>>(
        self,
        isa: Isa,
        passes: &[Pass<T>],
        line: &mut [T],
        middle: &mut M,
        position: usize,
        place: usize,
    ) {
        with_radices!(self.radices, (P, Q) => {
            isa.run(Run::<T, M, P, Q> { passes, line, middle, position, place });
        }, _ => unreachable!("supported pairs only"));
    }
}

struct Run<'a, T, M, const P: usize, const Q: usize> {
    passes: &'a [Pass<T>],
    line: &'a mut [T],
    middle: &'a mut M,
    position: usize,
    place: usize,
}

impl<T: Element, M: Middle<T>, const P: usize, const Q: usize> Run<'_, T, M, P, Q> {
    /// Powers of two have twiddles between the passes.
    const DIGITS: Digits = if Q.is_multiple_of(2) {
        Digits { outer: 1, middle: Q, inner: 1 }
    } else {
        Digits { outer: 1, middle: 1, inner: Q }
    };
}

impl<T: Element, M: Middle<T>, const P: usize, const Q: usize> Algorithm<T> for Run<'_, T, M, P, Q>
where
    Codelet: Dft<P> + Dft<Q>,
{
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let line = &mut complex_vectors::<V>(self.line)[..P * Q];
        let twiddles = self.passes[0].twiddles();
        if P > 1 {
            forward::<V, P>(line, Self::DIGITS, twiddles);
        }
        for p in 0..P {
            let start = p * Q;
            let spectrum = <Codelet as Dft<Q>>::dft(gather(line, start, 1));
            let spectrum = self.middle.apply(self.position + start, self.place + start, spectrum);
            scatter(line, start, 1, <Codelet as Dft<Q>>::idft(spectrum));
        }
        if P > 1 {
            inverse::<V, P>(line, Self::DIGITS, twiddles);
        }
    }
}
