//! Complex vectors of runs that are apart in memory.

use std::marker::PhantomData;

use super::{Complex, Element, MAX_LANES, Tile, Vector};

/// As many complex vectors as `COUNT`, each of runs of `RUN` neighboring complex numbers that alternate real and imaginary part:
/// run `i` of vector `j` begins at `starts[i] + j * stride`.
#[derive(Clone, Copy)]
pub(crate) struct Runs<'a, T, const RUN: usize, const COUNT: usize> {
    starts: [*const T; MAX_LANES],
    known: usize,
    stride: usize,
    numbers: PhantomData<&'a [[T; 2]]>,
}

impl<'a, T: Element, const RUN: usize, const COUNT: usize> Runs<'a, T, RUN, COUNT> {
    /// Vectors of `LANES` complex numbers, whose runs are the first of `starts`.
    #[inline(always)]
    pub(crate) fn new<V: Vector<Element = T>>(
        numbers: &'a [[T; 2]],
        starts: &[usize; MAX_LANES],
        stride: usize,
    ) -> Self {
        let mut pointers = [numbers.as_ptr().cast(); MAX_LANES];
        let span = (COUNT - 1).checked_mul(stride).and_then(|last| last.checked_add(RUN));
        for i in 0..V::LANES / RUN {
            let end = span.and_then(|span| span.checked_add(starts[i]));
            assert!(end.is_some_and(|end| end <= numbers.len()));
            // SAFETY: the start of the run is inside the slice (checked above).
            pointers[i] = unsafe { numbers.as_ptr().add(starts[i]).cast() };
        }
        Self { starts: pointers, known: V::LANES / RUN, stride, numbers: PhantomData }
    }

    /// Vector `j`.
    #[inline(always)]
    pub(crate) fn complex<V: Vector<Element = T>>(&self, j: usize) -> Complex<V> {
        let (low, high) = self.vectors::<V>(j);
        let (re, im) = V::deinterleave(low, high);
        Complex::new(re, im)
    }

    /// As [`complex`](Self::complex), with the numbers in reverse.
    #[inline(always)]
    pub(crate) fn complex_reversed<V: Vector<Element = T>>(&self, j: usize) -> Complex<V> {
        let (low, high) = self.vectors::<V>(j);
        let (re, im) = V::deinterleave_reversed(low, high);
        Complex::new(re, im)
    }

    #[inline(always)]
    fn vectors<V: Vector<Element = T>>(&self, j: usize) -> (V, V) {
        assert!(j < COUNT && self.known * RUN == V::LANES);
        let mut numbers = [T::default(); 2 * MAX_LANES];
        for i in 0..V::LANES / RUN {
            // SAFETY: `new` found `RUN` complex numbers there, for any `j` below `COUNT`, of this run, which is one of `known`.
            unsafe {
                let run = self.starts[i].add(2 * j * self.stride);
                std::ptr::copy_nonoverlapping(run, numbers.as_mut_ptr().add(2 * i * RUN), 2 * RUN);
            }
        }
        let [low, high] = Tile::dense(&numbers[..2 * V::LANES], V::LANES).gather(0, 1);
        (low, high)
    }
}
