//! DFTs of large prime lengths as a cyclic convolution of one point less (Rader's algorithm).
//!
//! The powers of a primitive root `g` go through all indices but 0: with `n = g^q` and `k = g^-s`, `X[k] - x[0]` is the convolution
//! of `x[g^q]` with `exp(-2πi g^-q / p)`, which is the product of their spectra. `p - 1` is even, so that its primes are smaller.
//! Source: C. M. Rader, "Discrete Fourier transforms when the number of data samples is prime", Proc. IEEE 56(6), 1968.

use num_complex::Complex64;
use rustfft::FftPlanner;

use super::Transform;
use crate::fft::codelets::root;
use crate::simd::{Algorithm, Complex, Element, Isa, Vector, complex_vectors};

/// A planned DFT of one prime length.
pub(super) struct Rader<T> {
    isa: Isa,
    convolution: Transform<T>,
    /// For each position of the convolution's input the index in `1..p` of the line's.
    inputs: Vec<usize>,
    /// The same of its output, whose positions are those of the input.
    outputs: Vec<usize>,
    /// The spectrum that is multiplied with, over `p - 1`, as the convolution leaves frequencies.
    spectrum: Vec<Complex<T>>,
}

impl<T: Element> Rader<T> {
    pub(super) fn new(isa: Isa, p: usize) -> Self {
        let convolution = Transform::new(isa, p - 1);
        let powers = powers(p);
        let backward = |q: usize| powers[(p - 1 - q) % (p - 1)];
        let (mut inputs, mut outputs) = (vec![0; p - 1], vec![0; p - 1]);
        for (q, &position) in convolution.inputs().iter().enumerate() {
            (inputs[position], outputs[position]) = (powers[q], backward(q));
        }
        let mut kernel: Vec<_> = (0..p - 1)
            .map(|q| root(backward(q), p))
            .map(|(c, s)| Complex64::new(c, -s) / (p - 1) as f64)
            .collect();
        FftPlanner::new().plan_fft_forward(p - 1).process(&mut kernel);
        let mut spectrum = vec![Complex::new(T::default(), T::default()); p - 1];
        for (value, &position) in kernel.iter().zip(convolution.outputs()) {
            spectrum[position] = Complex::new(T::nearest(value.re), T::nearest(value.im));
        }
        Self { isa, convolution, inputs, outputs, spectrum }
    }

    /// Complex vectors of scratch that a run needs.
    pub(super) fn work_len(&self) -> usize {
        self.convolution.len() + self.convolution.work_len()
    }

    /// The DFT, or its inverse, of `line[start]`, `line[start + stride]`, ..., in place. Inputs of the inverse are multiplied by the
    /// conjugate of `twiddles` first, outputs of the other by them.
    pub(super) fn run<const INVERSE: bool>(
        &self,
        line: &mut [T],
        [start, stride]: [usize; 2],
        twiddles: Option<&[Complex<T>]>,
        work: &mut [T],
    ) {
        let len = 2 * self.isa.lanes::<T>() * self.convolution.len();
        let (points, work) = work.split_at_mut(len);
        self.isa.run(Enter::<_, INVERSE> { rader: self, line, start, stride, twiddles, points });
        self.convolution.forward(points, work);
        self.isa.run(Multiply { rader: self, line, start, points });
        self.convolution.inverse(points, work);
        self.isa.run(Leave::<_, INVERSE> { rader: self, line, start, stride, twiddles, points });
    }
}

/// The points of a line but the first, in the order of the convolution.
struct Enter<'a, T, const INVERSE: bool> {
    rader: &'a Rader<T>,
    line: &'a mut [T],
    start: usize,
    stride: usize,
    twiddles: Option<&'a [Complex<T>]>,
    points: &'a mut [T],
}

impl<T: Element, const INVERSE: bool> Algorithm<T> for Enter<'_, T, INVERSE> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let Self { rader, start, stride, .. } = self;
        let (line, points) = (complex_vectors::<V>(self.line), complex_vectors::<V>(self.points));
        for (point, &input) in points.iter_mut().zip(&rader.inputs) {
            *point = line[start + input * stride];
            if let (true, Some(twiddles)) = (INVERSE, self.twiddles) {
                *point = point.times_conj(twiddles[input].splat());
            }
        }
    }
}

/// The spectrum of the points times that of the roots; the first point of the line counts in each of the others, and they in it.
struct Multiply<'a, T> {
    rader: &'a Rader<T>,
    line: &'a mut [T],
    start: usize,
    points: &'a mut [T],
}

impl<T: Element> Algorithm<T> for Multiply<'_, T> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let (line, points) = (complex_vectors::<V>(self.line), complex_vectors::<V>(self.points));
        let first = line[self.start];
        let zero = self.rader.convolution.outputs()[0];
        line[self.start] = first + points[zero];
        for (point, value) in points.iter_mut().zip(&self.rader.spectrum) {
            *point = point.times(value.splat());
        }
        points[zero] = points[zero] + first;
    }
}

/// Undoes [`Enter`] for the points of the convolution: those of an inverse are mirrored.
struct Leave<'a, T, const INVERSE: bool> {
    rader: &'a Rader<T>,
    line: &'a mut [T],
    start: usize,
    stride: usize,
    twiddles: Option<&'a [Complex<T>]>,
    points: &'a mut [T],
}

impl<T: Element, const INVERSE: bool> Algorithm<T> for Leave<'_, T, INVERSE> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let Self { rader, start, stride, .. } = self;
        let (line, points) = (complex_vectors::<V>(self.line), complex_vectors::<V>(self.points));
        for (&point, &output) in points.iter().zip(&rader.outputs) {
            if INVERSE {
                line[start + (points.len() + 1 - output) * stride] = point;
            } else {
                line[start + output * stride] = match self.twiddles {
                    Some(twiddles) => point.times(twiddles[output].splat()),
                    None => point,
                };
            }
        }
    }
}

/// The powers of a primitive root of the prime `p`: all of `1..p`.
fn powers(p: usize) -> Vec<usize> {
    let powers_of = |g: usize| {
        let powers = std::iter::successors(Some(1), move |power| Some(power * g % p));
        powers.take(p - 1).collect::<Vec<_>>()
    };
    // those of other numbers come back to 1 before
    let is_root = |powers: &Vec<usize>| !powers[1..].contains(&1);
    (1..p).map(powers_of).find(is_root).expect("a prime has a primitive root")
}
