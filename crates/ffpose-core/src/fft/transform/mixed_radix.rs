//! DFTs of smooth lengths along a line of complex vectors, in place.
//!
//! The length is split into coprime prime powers, which need no twiddles between them (Good–Thomas); a prime power is split into
//! radices with twiddles (Cooley–Tukey, decimation in frequency forward and in time back). Nothing is put in order:
//! [`MixedRadix::inputs`] says where the input goes, [`MixedRadix::outputs`] where the output is.

use super::prime::{self, PrimeRoots};
use crate::fft::codelets::{Codelet, Dft, has_codelet, root, with_codelet};
use crate::simd::{Algorithm, Complex, Element, Isa, Vector, complex_vectors, gather, scatter};
use crate::tuning::LARGEST_PRIME;

/// A planned DFT of a length without primes above [`LARGEST_PRIME`].
pub(crate) struct MixedRadix<T> {
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
    /// For a radix without a codelet.
    prime: Option<PrimeRoots<T>>,
}

/// Positions are `[outer][radix][middle][inner]`; butterflies differ in twiddles by their middle digit.
#[derive(Clone, Copy)]
pub(crate) struct Digits {
    pub(crate) outer: usize,
    pub(crate) middle: usize,
    pub(crate) inner: usize,
}

impl<T: Element> MixedRadix<T> {
    /// The plan for `length`, or nothing if it has too large a prime.
    pub(crate) fn new(isa: Isa, length: usize) -> Option<Self> {
        let groups = groups(length);
        if groups.iter().flatten().any(|&radix| radix > LARGEST_PRIME) {
            return None;
        }
        let (mut inputs, mut frequencies) = (vec![0], vec![0]);
        let mut passes = Vec::new();
        let mut outer = 1;
        for group in &groups {
            let size: usize = group.iter().product();
            let inner = length / (outer * size);
            let (group_inputs, group_frequencies) = group_passes(group, outer, inner, &mut passes);
            let (cofactor, join) = (length / size, remainders(outer, size));
            inputs = product(&inputs, &group_inputs, |n, m| (n + cofactor * m) % length);
            frequencies = product(&frequencies, &group_frequencies, |&k, &l| join(k, l));
            outer *= size;
        }
        Some(Self { isa, inputs: inverted(&inputs), outputs: inverted(&frequencies), list: passes })
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
        self.list
            .iter()
            .filter(|pass| pass.prime.is_some())
            .map(|pass| pass.radix)
            .max()
            .unwrap_or(0)
    }

    /// `X[k] = Σ_n x[n] exp(-2πi k n / N)`.
    pub(crate) fn forward(&self, line: &mut [T], work: &mut [T]) {
        for pass in &self.list {
            pass.run::<false>(self.isa, line, work);
        }
    }

    /// The unnormalised inverse of [`forward`](Self::forward).
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
            _ => isa.run(RunPrimePass::<T, INVERSE> { pass: self, line, work }));
    }

    pub(crate) fn radix(&self) -> usize {
        self.radix
    }

    pub(crate) fn twiddles(&self) -> &[Complex<T>] {
        &self.twiddles
    }
}

/// The butterflies of radix `R`, then their twiddles.
#[inline(always)]
pub(crate) fn forward<V: Vector, const R: usize>(
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
                let mut z = Codelet::dft(gather::<_, R>(line, start, stride));
                if middle > 0 {
                    for k in 1..R {
                        z[k] = z[k].times(twiddles[middle][k].splat());
                    }
                }
                scatter(line, start, stride, z);
            }
        }
    }
}

/// Undoes [`forward`] up to a factor `R`.
#[inline(always)]
pub(crate) fn inverse<V: Vector, const R: usize>(
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
                if middle > 0 {
                    for k in 1..R {
                        z[k] = z[k].times_conj(twiddles[middle][k].splat());
                    }
                }
                scatter(line, start, stride, Codelet::idft(z));
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
        if INVERSE {
            inverse::<V, R>(line, *digits, twiddles);
        } else {
            forward::<V, R>(line, *digits, twiddles);
        }
    }
}

struct RunPrimePass<'a, T, const INVERSE: bool> {
    pass: &'a Pass<T>,
    line: &'a mut [T],
    work: &'a mut [T],
}

impl<T: Element, const INVERSE: bool> Algorithm<T> for RunPrimePass<'_, T, INVERSE> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let Pass { radix, digits: Digits { outer, middle, inner }, twiddles, prime } = self.pass;
        let roots = prime.as_ref().expect("a radix without codelet has its roots");
        let (line, work) = (complex_vectors::<V>(self.line), complex_vectors::<V>(self.work));
        let stride = middle * inner;
        for butterfly in 0..outer * stride {
            let (outer, offset) = (butterfly / stride, butterfly % stride);
            let start = outer * radix * stride + offset;
            let twiddles = &twiddles[offset / inner * radix..][..*radix];
            if INVERSE {
                for (k, twiddle) in twiddles.iter().enumerate() {
                    line[start + k * stride] = line[start + k * stride].times_conj(twiddle.splat());
                }
            }
            prime::dft::<V, INVERSE>(roots, line, start, stride, work);
            if !INVERSE {
                for (k, twiddle) in twiddles.iter().enumerate() {
                    line[start + k * stride] = line[start + k * stride].times(twiddle.splat());
                }
            }
        }
    }
}

/// Appends the passes of a prime power, given as its radices, over positions `[outer][group][inner]`; the input and the
/// frequency at each position of the group.
fn group_passes<T: Element>(
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
        prime: (!has_codelet!(radix radix)).then(|| PrimeRoots::new(radix)),
    });
    let (inputs, frequencies) = group_passes(rest, outer * radix, inner, passes);
    let digits: Vec<_> = (0..radix).collect();
    let twiddle = |n| {
        let (c, s) = root(n, radix * middle);
        Complex::new(T::nearest(c), T::nearest(-s))
    };
    passes[pass].twiddles = product(&inputs, &digits, |n, p| twiddle(n * p));
    (
        product(&digits, &inputs, |p, n| middle * p + n),
        product(&digits, &frequencies, |p, k| p + radix * k),
    )
}

/// `f(a, b)` for every `a`, and for each every `b`.
fn product<R>(a: &[usize], b: &[usize], f: impl Fn(&usize, &usize) -> R) -> Vec<R> {
    a.iter().flat_map(|a| b.iter().map(|b| f(a, b)).collect::<Vec<_>>()).collect()
}

/// The permutation that undoes `permutation`.
pub(crate) fn inverted(permutation: &[usize]) -> Vec<usize> {
    let mut inverse = vec![0; permutation.len()];
    for (i, &p) in permutation.iter().enumerate() {
        inverse[p] = i;
    }
    inverse
}

/// For coprime `m` and `n` the function that gives the number below `m n` which is `a` modulo `m` and `b` modulo `n`.
pub(crate) fn remainders(m: usize, n: usize) -> impl Fn(usize, usize) -> usize {
    let inverse = (0..n).find(|i| i * m % n == 1 % n).expect("coprime moduli");
    move |a, b| {
        let a = a % m;
        a + (b % n + n - a % n) * inverse % n * m
    }
}

/// The radices of each prime power of `length`; primes without a codelet first, so that the last pass has one if any has, and
/// the power of two last, as [`crate::fft::columns::fused`] expects.
fn groups(length: usize) -> Vec<Vec<usize>> {
    let mut groups = Vec::new();
    let (mut rest, mut p) = (length, 2);
    while rest > 1 {
        if p * p > rest {
            p = rest; // a prime
        }
        let mut exponent = 0;
        while rest % p == 0 {
            rest /= p;
            exponent += 1;
        }
        if exponent > 0 {
            groups.push(radices(p, exponent));
        }
        p += 1;
    }
    groups.sort_by_key(|group| (has_codelet!(radix group[0]), group[0].is_multiple_of(2)));
    groups
}

/// `p` to the `exponent` as radices: powers of two as few as possible up to 16, and of even size.
fn radices(p: usize, exponent: usize) -> Vec<usize> {
    if p != 2 {
        return vec![p; exponent];
    }
    let count = exponent.div_ceil(4);
    (0..count).map(|i| 1 << ((exponent + i) / count)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_has_its_remainders() {
        for (m, n) in [(1, 1), (1, 9), (9, 1), (7, 2), (9, 16), (16, 9), (49, 25), (61, 1024)] {
            let join = remainders(m, n);
            let numbers = (0..3 * m).flat_map(|a| (0..n).map(move |b| (a, b)));
            assert!(numbers.clone().all(|(a, b)| join(a, b) < m * n));
            assert!(numbers.clone().all(|(a, b)| join(a, b) % m == a % m && join(a, b) % n == b));
        }
    }

    #[test]
    fn groups_are_the_prime_powers_of_a_length() {
        for length in 1..3000 {
            let groups = groups(length);
            assert_eq!(groups.iter().flatten().product::<usize>(), length);
            let smallest = |n: usize| (2..=n).find(|p| n.is_multiple_of(*p)).unwrap();
            let mut primes: Vec<_> = groups.iter().map(|group| smallest(group[0])).collect();
            let of_one_prime = |(group, p): (&Vec<usize>, &usize)| {
                group.iter().all(|&radix| (1..=4).any(|power| p.pow(power) == radix))
            };
            assert!(groups.iter().zip(&primes).all(of_one_prime), "{length}");
            primes.sort_unstable();
            primes.dedup();
            assert_eq!(primes.len(), groups.len(), "{length}");
        }
    }
}
