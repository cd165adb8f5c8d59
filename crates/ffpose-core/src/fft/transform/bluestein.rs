//! DFTs of any length as a convolution of a smooth length (Bluestein): `k n = (k² + n² - (k - n)²) / 2`.

use super::mixed_radix::MixedRadix;
use crate::fft::codelets::root;
use crate::simd::{Algorithm, Complex, Element, Isa, Vector, complex_vectors};

/// A DFT of `turns.len()` as a convolution of `passes.len()`.
pub(crate) struct Bluestein<T> {
    isa: Isa,
    /// `exp(-πi n² / N)`
    turns: Vec<Complex<T>>,
    /// The spectrum of the conjugate chirp by position, over the length of the convolution.
    spectrum: Vec<Complex<T>>,
    passes: MixedRadix<T>,
    natural: Vec<usize>,
}

impl<T: Element> Bluestein<T> {
    pub(crate) fn new(isa: Isa, length: usize) -> Self {
        let chirp = |n: usize| {
            let (c, s) = root(n * n % (2 * length), 2 * length);
            Complex::new(c, -s)
        };
        let round = |z: Complex<f64>| Complex::new(T::nearest(z.re), T::nearest(z.im));
        let passes = smooth(isa, 2 * length - 1);
        let chirps: Vec<_> = (0..length).map(chirp).collect();
        Self {
            isa,
            spectrum: filter(&chirps, passes.len()).into_iter().map(round).collect(),
            turns: chirps.into_iter().map(round).collect(),
            passes,
            natural: (0..length).collect(),
        }
    }

    /// Lines are in natural order.
    pub(crate) fn inputs(&self) -> &[usize] {
        &self.natural
    }

    /// Lines are in natural order.
    pub(crate) fn outputs(&self) -> &[usize] {
        &self.natural
    }

    pub(crate) fn work_len(&self) -> usize {
        self.passes.len() + self.passes.work_len()
    }

    pub(crate) fn forward(&self, line: &mut [T], work: &mut [T]) {
        self.run::<false>(line, work);
    }

    pub(crate) fn inverse(&self, line: &mut [T], work: &mut [T]) {
        self.run::<true>(line, work);
    }

    fn run<const INVERSE: bool>(&self, line: &mut [T], work: &mut [T]) {
        let (padded, work) = work.split_at_mut(2 * self.isa.lanes::<T>() * self.passes.len());
        self.isa.run(Modulate::<T, INVERSE> { plan: self, line, padded });
        self.passes.forward(padded, work);
        self.isa.run(Multiply { by: &self.spectrum, padded });
        self.passes.inverse(padded, work);
        self.isa.run(Demodulate::<T, INVERSE> { plan: self, line, padded });
    }
}

/// The line times the chirp, padded with zeros.
struct Modulate<'a, T, const INVERSE: bool> {
    plan: &'a Bluestein<T>,
    line: &'a mut [T],
    padded: &'a mut [T],
}

impl<T: Element, const INVERSE: bool> Algorithm<T> for Modulate<'_, T, INVERSE> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let (line, padded) = (complex_vectors::<V>(self.line), complex_vectors::<V>(self.padded));
        padded.fill(Complex::zero());
        for ((z, chirp), &position) in
            line.iter().zip(&self.plan.turns).zip(self.plan.passes.inputs())
        {
            let z = if INVERSE { z.swap() } else { *z };
            padded[position] = z.times(chirp.splat());
        }
    }
}

/// The product with one number for each position.
struct Multiply<'a, T> {
    by: &'a [Complex<T>],
    padded: &'a mut [T],
}

impl<T: Element> Algorithm<T> for Multiply<'_, T> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        for (z, factor) in complex_vectors::<V>(self.padded).iter_mut().zip(self.by) {
            *z = z.times(factor.splat());
        }
    }
}

/// The convolution times the chirp.
struct Demodulate<'a, T, const INVERSE: bool> {
    plan: &'a Bluestein<T>,
    line: &'a mut [T],
    padded: &'a mut [T],
}

impl<T: Element, const INVERSE: bool> Algorithm<T> for Demodulate<'_, T, INVERSE> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let (line, padded) = (complex_vectors::<V>(self.line), complex_vectors::<V>(self.padded));
        for ((z, chirp), &position) in
            line.iter_mut().zip(&self.plan.turns).zip(self.plan.passes.inputs())
        {
            let product = padded[position].times(chirp.splat());
            *z = if INVERSE { product.swap() } else { product };
        }
    }
}

/// The spectrum of the conjugate chirp wrapped to `length`, over `length`, by position of a plan of that length.
fn filter(chirp: &[Complex<f64>], length: usize) -> Vec<Complex<f64>> {
    let passes = MixedRadix::new(Isa::scalar(), length).expect("a smooth length");
    let mut numbers = vec![0.0; 2 * length];
    for (n, z) in chirp.iter().enumerate() {
        for m in [n, (length - n) % length] {
            let position = passes.inputs()[m];
            numbers[2 * position] = z.re / length as f64;
            numbers[2 * position + 1] = -z.im / length as f64;
        }
    }
    passes.forward(&mut numbers, &mut []);
    numbers.as_chunks::<2>().0.iter().map(|&[re, im]| Complex::new(re, im)).collect()
}

/// The plan for the smallest length from `least` on whose only primes are 2, 3, 5 and 7.
fn smooth<T: Element>(isa: Isa, least: usize) -> MixedRadix<T> {
    let is_smooth = |n: &usize| {
        let mut rest = *n;
        for p in [2, 3, 5, 7] {
            while rest.is_multiple_of(p) {
                rest /= p;
            }
        }
        rest == 1
    };
    let length = (least..=2 * least).find(is_smooth).expect("there is a power of two");
    MixedRadix::new(isa, length).expect("a smooth length")
}
