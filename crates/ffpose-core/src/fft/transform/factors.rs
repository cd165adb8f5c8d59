//! Lengths as prime powers, and the order of what they leave behind.

use crate::fft::codelets::has_codelet;

/// `f(a, b)` for every `a`, and for each every `b`.
pub(super) fn product<R>(a: &[usize], b: &[usize], f: impl Fn(&usize, &usize) -> R) -> Vec<R> {
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
pub(super) fn remainders(m: usize, n: usize) -> impl Fn(usize, usize) -> usize {
    let inverse = (0..n).find(|i| i * m % n == 1 % n).expect("coprime moduli");
    move |a, b| {
        let a = a % m;
        a + (b % n + n - a % n) * inverse % n * m
    }
}

/// The radices of each prime power of `length`; primes without a codelet first, so that the last pass has one if any has, and
/// the power of two last, as [`crate::fft::columns`] expects.
pub(super) fn groups(length: usize) -> Vec<Vec<usize>> {
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

/// `p` to the `exponent` as radices: a power of two up to 16 is one, a larger one as few as possible up to 8, of even size
/// (two radices of 16 are slower than three smaller ones).
fn radices(p: usize, exponent: usize) -> Vec<usize> {
    if p != 2 {
        return vec![p; exponent];
    }
    let count = if exponent <= 4 { 1 } else { exponent.div_ceil(3) };
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
