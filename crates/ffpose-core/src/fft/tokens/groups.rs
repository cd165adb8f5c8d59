//! The one transform that crosses lanes, with what is done to the spectrum in between.
//!
//! Items are the slots of rows, in the order of their frequencies; as many as there are lanes are a group. A square of vectors is
//! transposed, so that lanes are items; each is turned by `exp(-2πi k y / Y)`, where `k` is its frequency along the line and `y`
//! the lane that it came from, and transformed over `y`. Vector `j` of a group is then frequency `k + M j` along Y. The same
//! back, with the norm.
//!
//! A group fills all registers, so that it is moved in halves. Item `r` and item `r + L / 2` exchange halves: then one vector has
//! lanes `y < L / 2` of both, the other the rest. Their sum and difference are of even and odd `j = 2 c + p`. What is left stays
//! in the half `p`, and in registers: to transpose inside the halves of its vectors, and a DFT of `L / 2` vectors.
//!
//! Rows come in pairs of `u` and `-u`, since slot 0 is two real lines as one complex line, `k = 0` and `k = M / 2`. The row of `u`
//! gets the first, at `u`, so that its frequencies are 0 to `M / 2 - 1`; that of `-u` the second, at `-u`: 1 to `M / 2`.

use std::hint::black_box;

use super::blocks::Block;
use super::weight::Run;
use crate::fft::codelets::{Codelet, Dft, TurnedDft, unroll};
use crate::simd::{
    Algorithm, Complex, Element, MAX_LANES, Vector, complex_vectors, complex_vectors_of, joined,
    parts,
};

/// Halves of a group, and of the lanes of a vector.
pub(super) const HALVES: usize = 2;

/// The rows of a block in the order of their groups.
#[derive(Clone, Copy)]
pub(super) struct Turns<'a, T> {
    /// Positions of `u` and `-u` in turn.
    pub(super) rows: &'a [usize],
    /// The least number of rows in pairs whose items fill groups without a rest.
    pub(super) rows_each: usize,
    /// The runs of all groups.
    pub(super) runs: &'a [Run],
    pub(super) slots: usize,
    /// The tables of [`super::twiddles`].
    pub(super) twiddles: &'a [T],
}

/// A group of `2 J` items in runs of `RUN`.
#[derive(Clone, Copy)]
pub(super) struct Group<'a, V, const RUN: usize, const J: usize> {
    /// Its number in the block.
    place: usize,
    pub(super) runs: &'a [Run],
    /// Where each run begins among the vectors of the block.
    firsts: [usize; MAX_LANES],
    /// What the second half of items `r` and `r + J` is turned by against the first.
    halfway: &'a [Complex<V>; J],
    /// The factors of the transform of each half.
    pub(super) factors: [&'a [Complex<V>]; HALVES],
    /// What the odd half is turned by on the way back, conjugate.
    odd: &'a Complex<V>,
    /// What the halves of items `r` and `r + J` are multiplied by at last, conjugate.
    back: &'a [[Complex<V>; HALVES]; J],
}

/// What is done to the spectrum of a group.
pub(super) trait GroupPointwise<T: Element> {
    /// Whether the spectrum goes back to its block.
    const INVERSE: bool;

    /// What is known of a group beforehand.
    type Ready<const RUN: usize, const J: usize>;

    /// Makes the slots 0 of `rows` ready.
    #[inline(always)]
    fn begin<V: Vector<Element = T>>(&mut self, _: &[usize]) {}

    /// Makes a group ready, and checks all bounds: later the compiler would keep vectors on the stack meanwhile.
    fn enter<V: Vector<Element = T>, const RUN: usize, const J: usize>(
        &mut self,
        group: Group<'_, V, RUN, J>,
    ) -> Self::Ready<RUN, J>;

    /// The new values of vectors `p`, `p + 2`, ... of a group.
    fn apply<V: Vector<Element = T>, const RUN: usize, const J: usize>(
        &mut self,
        ready: &Self::Ready<RUN, J>,
        group: Group<'_, V, RUN, J>,
        p: usize,
        z: [Complex<V>; J],
    ) -> [Complex<V>; J]
    where
        Codelet: TurnedDft<J>;
}

/// `pointwise` on all groups of a block, there and back. `RUN` divides the lanes and the slots of a row.
pub(super) struct Filter<'a, T, M, const RUN: usize> {
    pub(super) block: Block<'a, T>,
    pub(super) turns: Turns<'a, T>,
    pub(super) pointwise: M,
}

impl<T: Element, M: GroupPointwise<T>, const RUN: usize> Algorithm<T> for Filter<'_, T, M, RUN> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        match V::LANES {
            2 => self.run_lanes::<V, 1>(),
            4 => self.run_lanes::<V, 2>(),
            8 => self.run_lanes::<V, 4>(),
            16 => self.run_lanes::<V, 8>(),
            lanes => unreachable!("no transform across {lanes} lanes"),
        }
    }
}

impl<T: Element, M: GroupPointwise<T>, const RUN: usize> Filter<'_, T, M, RUN> {
    #[inline(always)]
    fn run_lanes<V: Vector<Element = T>, const J: usize>(mut self)
    where
        Codelet: Dft<J> + TurnedDft<J>,
    {
        assert!(RUN <= HALVES * J, "a run is part of a group");
        let Turns { rows, rows_each, runs, slots, twiddles } = self.turns;
        let (odd, tables) = complex_vectors_of::<V>(twiddles).split_first().expect("a table");
        let factors_len = <Codelet as TurnedDft<J>>::FACTORS.len();
        let table_len = 3 * J + 2 * factors_len;
        let Block { vectors, pitch } = self.block;
        let block = complex_vectors::<V>(vectors);
        let groups = rows_each * slots / V::LANES;
        for (turn, rows) in rows.chunks_exact(rows_each).enumerate() {
            split_rows(block, pitch, rows);
            self.pointwise.begin::<V>(rows);
            for number in 0..groups {
                let place = turn * groups + number;
                let runs = &runs[place * (V::LANES / RUN)..][..V::LANES / RUN];
                let mut firsts = [0; MAX_LANES];
                for i in 0..V::LANES / RUN {
                    firsts[i] = runs[i].item;
                }
                let table = &tables[number * table_len..][..table_len];
                let (halfway, table) = table.split_first_chunk().expect("a table");
                let (factors, back) = table.split_at(2 * factors_len);
                let group = Group {
                    place,
                    runs,
                    firsts,
                    halfway,
                    factors: [&factors[..factors_len], &factors[factors_len..]],
                    odd,
                    back: back.as_chunks().0.first_chunk().expect("a table"),
                };
                group.check(block);
                let ready = self.pointwise.enter::<V, RUN, J>(group);
                let mut halves = group.halves_of(block);
                unroll!(p in 0..HALVES {
                    let z = Codelet::turned_dft(transposed(halves[p]), group.factors[p]);
                    let z = self.pointwise.apply(&ready, group, p, z);
                    if M::INVERSE {
                        halves[p] = transposed(Codelet::idft(z));
                    }
                });
                if M::INVERSE {
                    group.put_halves(halves, block);
                }
            }
            if M::INVERSE {
                join_rows(block, pitch, rows);
            }
        }
    }
}

impl<V: Vector, const RUN: usize, const J: usize> Group<'_, V, RUN, J> {
    /// The vectors of this group in the sums of a step.
    #[inline(always)]
    pub(super) fn part_mut<'a>(
        &self,
        sums: &'a mut [Complex<V>],
    ) -> &'a mut [[Complex<V>; HALVES]; J] {
        let pairs = sums.as_chunks_mut().0;
        pairs[self.place * J..].first_chunk_mut().expect("a whole group")
    }

    /// All items are in `block`.
    #[inline(always)]
    pub(super) fn check(&self, block: &[Complex<V>]) {
        for i in 0..V::LANES / RUN {
            let _ = &block[self.firsts[i]..][..RUN];
        }
    }

    #[inline(always)]
    pub(super) fn item<'a>(&self, block: &'a [Complex<V>], item: usize) -> &'a Complex<V> {
        &block[self.firsts[item / RUN]..][..RUN][item % RUN]
    }

    #[inline(always)]
    pub(super) fn item_mut<'a>(
        &self,
        block: &'a mut [Complex<V>],
        item: usize,
    ) -> &'a mut Complex<V> {
        &mut block[self.firsts[item / RUN]..][..RUN][item % RUN]
    }

    /// The group up to what is done to each half alone.
    #[inline(always)]
    pub(super) fn halves_of(&self, block: &[Complex<V>]) -> [[Complex<V>; J]; HALVES] {
        let mut halves = [[Complex::zero(); J]; HALVES];
        unroll!(r in 0..J {
            let [low, high] = exchanged(*self.item(block, r), *self.item(block, J + r));
            halves[0][r] = low.plus_times(high, self.halfway[r]);
            halves[1][r] = low.mirrored(halves[0][r]);
        });
        halves
    }

    /// Undoes [`halves_of`](Self::halves_of) and the turns, with the norm.
    #[inline(always)]
    fn put_halves(&self, halves: [[Complex<V>; J]; HALVES], block: &mut [Complex<V>]) {
        // loaded again: the compiler would keep them on the stack
        let (back, odd) = (black_box(self.back), *black_box(self.odd));
        unroll!(r in 0..J {
            let low = halves[0][r].plus_times_conj(halves[1][r], odd);
            let high = halves[0][r].mirrored(low);
            let [by_low, by_high] = back[r];
            let [first, second] = exchanged(low.times_conj(by_low), high.times_conj(by_high));
            *self.item_mut(block, r) = first;
            *self.item_mut(block, J + r) = second;
        });
    }
}

/// The first halves of two complex vectors, and the second ones.
#[inline(always)]
fn exchanged<V: Vector>(a: Complex<V>, b: Complex<V>) -> [Complex<V>; HALVES] {
    let (first_re, second_re) = V::exchange_halves(a.re, b.re);
    let (first_im, second_im) = V::exchange_halves(a.im, b.im);
    [Complex::new(first_re, first_im), Complex::new(second_re, second_im)]
}

/// Transposed inside the halves of the vectors.
#[inline(always)]
pub(super) fn transposed<V: Vector, const J: usize>(z: [Complex<V>; J]) -> [Complex<V>; J] {
    let (mut re, mut im) = parts(z);
    V::transpose_in_halves(&mut re);
    V::transpose_in_halves(&mut im);
    joined(re, im)
}

/// Slot 0 of each pair of rows, `Z = A + iB` of real lines `a` and `b`, to `2 A(u)` and, behind the last slot, `2 B(-u)`.
#[inline(always)]
pub(super) fn split_rows<V: Vector>(block: &mut [Complex<V>], pitch: usize, rows: &[usize]) {
    for &[u, minus_u] in rows.as_chunks().0 {
        let (z, mirror) = (block[u * pitch], block[minus_u * pitch]);
        block[u * pitch] = Complex::new(z.re + mirror.re, z.im - mirror.im);
        block[(minus_u + 1) * pitch - 1] = Complex::new(z.im + mirror.im, z.re - mirror.re);
    }
}

/// Undoes [`split_rows`] up to a factor.
#[inline(always)]
fn join_rows<V: Vector>(block: &mut [Complex<V>], pitch: usize, rows: &[usize]) {
    for &[u, minus_u] in rows.as_chunks().0 {
        let (a, b) = (block[u * pitch], block[(minus_u + 1) * pitch - 1]);
        block[u * pitch] = Complex::new(a.re + b.im, a.im + b.re);
        block[minus_u * pitch] = Complex::new(a.re - b.im, b.re - a.im);
    }
}
