//! DFTs of any length along a line of complex vectors, in place.
//!
//! The length is split into coprime prime powers, which need no twiddles between them (Good–Thomas); a prime power is split into
//! radices with twiddles (Cooley–Tukey, decimation in frequency forward and in time back). Nothing is put in order:
//! [`Transform::inputs`] says where the input goes, [`Transform::outputs`] where the output is.

use super::factors::{groups, inverted, product, remainders};
use super::prime;
use super::rader::Rader;
use crate::fft::codelets::{Codelet, Dft, has_codelet, twiddle, with_codelet};
use crate::simd::{Algorithm, Complex, Element, Isa, Vector, complex_vectors, gather, scatter};
use crate::tuning::DEFINED_PRIMES;

/// A planned DFT of one length.
pub(crate) struct Transform<T> {
    isa: Isa,
    inputs: Vec<usize>,
    outputs: Vec<usize>,
    list: Vec<Pass<T>>,
}

/// Butterflies over one digit of the positions.
pub(crate) struct Pass<T> {
    radix: usize,
    digits: Digits,
    /// `[middle][radix]`: what the outputs of a butterfly are multiplied by; ones for `middle == 0`.
    twiddles: Vec<Complex<T>>,
    butterfly: Butterfly<T>,
}

/// How a radix is transformed.
enum Butterfly<T> {
    Codelet,
    Definition(Vec<Complex<T>>),
    Convolution(Box<Rader<T>>),
}

/// Positions are `[outer][radix][middle][inner]`; butterflies differ in twiddles by their middle digit.
#[derive(Clone, Copy)]
pub(crate) struct Digits {
    pub(crate) outer: usize,
    pub(crate) middle: usize,
    pub(crate) inner: usize,
}

impl<T: Element> Transform<T> {
    /// The plan for a length.
    pub(crate) fn new(isa: Isa, length: usize) -> Self {
        let groups = groups(length);
        let (mut inputs, mut frequencies) = (vec![0], vec![0]);
        let mut passes = Vec::new();
        let mut outer = 1;
        for group in &groups {
            let size: usize = group.iter().product();
            let inner = length / (outer * size);
            let (group_inputs, group_frequencies) =
                group_passes(isa, group, outer, inner, &mut passes);
            let (cofactor, join) = (length / size, remainders(outer, size));
            inputs = product(&inputs, &group_inputs, |n, m| (n + cofactor * m) % length);
            frequencies = product(&frequencies, &group_frequencies, |&k, &l| join(k, l));
            outer *= size;
        }
        Self { isa, inputs: inverted(&inputs), outputs: inverted(&frequencies), list: passes }
    }

    pub(crate) fn len(&self) -> usize {
        self.inputs.len()
    }

    /// The position of input `n` of the forward transform, and of output `n` of the inverse.
    pub(crate) fn inputs(&self) -> &[usize] {
        &self.inputs
    }

    /// The position of frequency `k`.
    pub(crate) fn outputs(&self) -> &[usize] {
        &self.outputs
    }

    pub(crate) fn passes(&self) -> &[Pass<T>] {
        &self.list
    }

    /// Complex vectors of scratch that a run needs.
    pub(crate) fn work_len(&self) -> usize {
        let work_len = |pass: &Pass<T>| match &pass.butterfly {
            Butterfly::Codelet => 0,
            Butterfly::Definition(_) => pass.radix,
            Butterfly::Convolution(rader) => rader.work_len(),
        };
        self.list.iter().map(work_len).max().unwrap_or(0)
    }

    /// `X[k] = Σ_n x[n] exp(-2πi k n / N)`.
    pub(crate) fn forward(&self, line: &mut [T], work: &mut [T]) {
        for pass in &self.list {
            pass.run::<false>(self.isa, line, work);
        }
    }

    /// The unnormalized inverse of [`forward`](Self::forward).
    pub(crate) fn inverse(&self, line: &mut [T], work: &mut [T]) {
        for pass in self.list.iter().rev() {
            pass.run::<true>(self.isa, line, work);
        }
    }
}

impl<T: Element> Pass<T> {
    fn run<const INVERSE: bool>(&self, isa: Isa, line: &mut [T], work: &mut [T]) {
        with_codelet!(radix self.radix,
        R => isa.run(RunPass::<T, INVERSE, R> { pass: self, line }),
        _ => match &self.butterfly {
            Butterfly::Convolution(rader) => self.convolve::<INVERSE>(rader, line, work),
            Butterfly::Definition(roots) => {
                isa.run(RunPrimePass::<T, INVERSE> { pass: self, roots, line, work });
            }
            Butterfly::Codelet => unreachable!("radix {} has no codelet", self.radix),
        });
    }

    fn convolve<const INVERSE: bool>(&self, rader: &Rader<T>, line: &mut [T], work: &mut [T]) {
        let stride = self.digits.middle * self.digits.inner;
        for (start, twiddles) in self.starts() {
            rader.run::<INVERSE>(line, [start, stride], twiddles, work);
        }
    }

    /// Where each butterfly begins, and its twiddles unless they are ones.
    fn starts(&self) -> impl Iterator<Item = (usize, Option<&[Complex<T>]>)> {
        let (Digits { outer, middle, inner }, radix) = (self.digits, self.radix);
        let stride = middle * inner;
        (0..outer * stride).map(move |butterfly| {
            let (outer, offset) = (butterfly / stride, butterfly % stride);
            let first = offset / inner * radix;
            let twiddles = (first > 0).then(|| &self.twiddles[first..][..radix]);
            (outer * radix * stride + offset, twiddles)
        })
    }

    pub(crate) fn radix(&self) -> usize {
        self.radix
    }

    pub(crate) fn twiddles(&self) -> &[Complex<T>] {
        &self.twiddles
    }
}

/// The butterflies of radix `R`, then their twiddles; the inverse undoes them up to a factor `R`.
#[inline(always)]
pub(crate) fn butterflies<V: Vector, const R: usize, const INVERSE: bool>(
    line: &mut [Complex<V>],
    Digits { outer, middle, inner }: Digits,
    twiddles: &[Complex<V::Element>],
) where
    Codelet: Dft<R>,
{
    let stride = middle * inner;
    let twiddles = &twiddles.as_chunks::<R>().0[..middle];
    for outer in 0..outer {
        for middle in 0..middle {
            for inner_digit in 0..inner {
                let start = outer * R * stride + middle * inner + inner_digit;
                let mut z = gather::<_, R>(line, start, stride);
                if !INVERSE {
                    z = Codelet::dft(z);
                }
                if middle > 0 {
                    for k in 1..R {
                        let twiddle = twiddles[middle][k].splat();
                        z[k] = if INVERSE { z[k].times_conj(twiddle) } else { z[k].times(twiddle) };
                    }
                }
                scatter(line, start, stride, if INVERSE { Codelet::idft(z) } else { z });
            }
        }
    }
}

struct RunPass<'a, T, const INVERSE: bool, const R: usize> {
    pass: &'a Pass<T>,
    line: &'a mut [T],
}

impl<T: Element, const INVERSE: bool, const R: usize> Algorithm<T> for RunPass<'_, T, INVERSE, R>
where
    Codelet: Dft<R>,
{
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let line = complex_vectors::<V>(self.line);
        let Pass { digits, twiddles, .. } = self.pass;
        butterflies::<V, R, INVERSE>(line, *digits, twiddles);
    }
}

struct RunPrimePass<'a, T, const INVERSE: bool> {
    pass: &'a Pass<T>,
    roots: &'a [Complex<T>],
    line: &'a mut [T],
    work: &'a mut [T],
}

impl<T: Element, const INVERSE: bool> Algorithm<T> for RunPrimePass<'_, T, INVERSE> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let (line, work) = (complex_vectors::<V>(self.line), complex_vectors::<V>(self.work));
        let stride = self.pass.digits.middle * self.pass.digits.inner;
        for (start, twiddles) in self.pass.starts() {
            let twiddles = twiddles.into_iter().flatten().enumerate();
            if INVERSE {
                for (k, twiddle) in twiddles.clone() {
                    line[start + k * stride] = line[start + k * stride].times_conj(twiddle.splat());
                }
            }
            prime::dft::<V, INVERSE>(self.roots, line, start, stride, work);
            if !INVERSE {
                for (k, twiddle) in twiddles {
                    line[start + k * stride] = line[start + k * stride].times(twiddle.splat());
                }
            }
        }
    }
}

/// Whether a prime is transformed from the definition, not by a convolution.
fn is_defined(prime: usize) -> bool {
    let has_codelets = groups(prime - 1).iter().flatten().all(|&radix| has_codelet!(radix radix));
    prime <= DEFINED_PRIMES[usize::from(!has_codelets)]
}

/// Appends the passes of a prime power, given as its radices, over positions `[outer][group][inner]`; the input and the
/// frequency at each position of the group.
fn group_passes<T: Element>(
    isa: Isa,
    radices: &[usize],
    outer: usize,
    inner: usize,
    passes: &mut Vec<Pass<T>>,
) -> (Vec<usize>, Vec<usize>) {
    let Some((&radix, rest)) = radices.split_first() else { return (vec![0], vec![0]) };
    let middle: usize = rest.iter().product();
    let pass = passes.len();
    passes.push(Pass {
        radix,
        digits: Digits { outer, middle, inner },
        twiddles: Vec::new(),
        butterfly: match radix {
            radix if has_codelet!(radix radix) => Butterfly::Codelet,
            radix if is_defined(radix) => {
                Butterfly::Definition((0..radix).map(|k| twiddle(k, radix)).collect())
            }
            _ => Butterfly::Convolution(Box::new(Rader::new(isa, radix))),
        },
    });
    let (inputs, frequencies) = group_passes(isa, rest, outer * radix, inner, passes);
    let digits: Vec<_> = (0..radix).collect();
    passes[pass].twiddles = product(&inputs, &digits, |n, p| twiddle(n * p, radix * middle));
    (
        product(&digits, &inputs, |p, n| middle * p + n),
        product(&digits, &frequencies, |p, k| p + radix * k),
    )
}
