//! The one transform that crosses lanes, with what is done to the spectrum in between.
//!
//! Items are the slots of rows, in order; as many as there are lanes are a group. A square of vectors is transposed, so that
//! lanes are items; each is turned by `exp(-2πi k y / Y)`, where `k` is its frequency along the line and `y` the lane that it
//! came from, and transformed over `y`. Vector `j` of a group is then frequency `k + M j` along Y. The same back.
//!
//! A group fills all registers, so that it is moved in halves. Item `r` and item `r + L / 2` exchange halves: then one vector has
//! lanes `y < L / 2` of both, the other the rest. Their sum and difference are of even and odd `j = 2 c + p`. What is left stays
//! in the half `p`, and in registers: to transpose inside the halves of its vectors, and a DFT of `L / 2` vectors.
//!
//! Rows come in pairs of `u` and `-u`, since slot 0 is two real lines as one complex line: they part to slot 0 of the two rows.

use std::hint::black_box;

use super::columns::Block;
use crate::fft::butterfly::{Codelet, Dft};
use crate::fft::pair::{join, split};
use crate::fft::unroll::unroll;
use crate::simd::{Algorithm, Complex, Element, Vector, complex_vectors, complex_vectors_of};

/// Halves of a group, and of the lanes of a vector.
const HALVES: usize = 2;

/// The rows of a block in the order of their groups.
#[derive(Clone, Copy)]
pub(super) struct Turns<'a, T> {
    /// Positions of `u` and `-u` in turn.
    pub(super) rows: &'a [usize],
    /// The least number of rows in pairs whose slots fill groups without a rest.
    pub(super) rows_each: usize,
    pub(super) slots: usize,
    /// What the odd half is turned by, and what the items of such rows are: for each group, each `r` and each half of `y` a
    /// complex vector.
    pub(super) twiddles: &'a [T],
}

/// A group of `2 J` items.
#[derive(Clone, Copy)]
pub(super) struct Group<'a, V, const J: usize> {
    /// Its number in the block.
    place: usize,
    /// Where the items are among the vectors of the block.
    items: [[usize; J]; HALVES],
    /// What items `r` and `r + J` are turned by, once they have exchanged halves.
    turns: &'a [[Complex<V>; HALVES]; J],
    /// What the odd half is turned by.
    odd: &'a Complex<V>,
}

/// What is done to the spectrum of a group.
pub(super) trait Middle<T: Element> {
    /// Whether the spectrum goes back to its block.
    const INVERSE: bool;

    /// Makes the slots 0 of `rows` ready.
    fn begin<V: Vector<Element = T>>(&mut self, rows: &[usize]);

    /// Makes a group ready, and checks all bounds: later the compiler would keep vectors on the stack meanwhile.
    fn enter<V: Vector<Element = T>, const J: usize>(&mut self, group: Group<'_, V, J>);

    /// The new values of vectors `p`, `p + 2`, ... of a group.
    fn apply<V: Vector<Element = T>, const J: usize>(
        &mut self,
        group: Group<'_, V, J>,
        p: usize,
        z: [Complex<V>; J],
    ) -> [Complex<V>; J]
    where
        Codelet: Dft<J>;
}

/// The product with a packed weight, or with its conjugate.
#[derive(Clone, Copy)]
pub(super) struct Product<'a, T, const CONJUGATE: bool>(pub(super) &'a [T]);

impl<T: Element, const CONJUGATE: bool> Middle<T> for Product<'_, T, CONJUGATE> {
    const INVERSE: bool = true;

    #[inline(always)]
    fn begin<V: Vector<Element = T>>(&mut self, _: &[usize]) {}

    #[inline(always)]
    fn enter<V: Vector<Element = T>, const J: usize>(&mut self, group: Group<'_, V, J>) {
        let _: &[[_; HALVES]; J] = group.part(complex_vectors_of::<V>(self.0));
    }

    #[inline(always)]
    fn apply<V: Vector<Element = T>, const J: usize>(
        &mut self,
        group: Group<'_, V, J>,
        p: usize,
        mut z: [Complex<V>; J],
    ) -> [Complex<V>; J]
    where
        Codelet: Dft<J>,
    {
        let weight = group.part(complex_vectors_of(self.0));
        for c in 0..J {
            let weight = weight[c][p];
            z[c] = if CONJUGATE { z[c].times_conj(weight) } else { z[c].times(weight) };
        }
        z
    }
}

/// `sum += conj(x) · z` with the spectrum of the block `x`, which is spent; `z` is passed on.
pub(super) struct Accumulate<'a, T> {
    pub(super) x: Block<'a, T>,
    pub(super) sum: &'a mut [T],
}

impl<T: Element> Middle<T> for Accumulate<'_, T> {
    const INVERSE: bool = false;

    #[inline(always)]
    fn begin<V: Vector<Element = T>>(&mut self, rows: &[usize]) {
        split_rows::<V>(complex_vectors(self.x.vectors), self.x.pitch, rows);
    }

    #[inline(always)]
    fn enter<V: Vector<Element = T>, const J: usize>(&mut self, group: Group<'_, V, J>) {
        let _: &mut [[_; HALVES]; J] = group.part_mut(complex_vectors::<V>(self.sum));
        let x = complex_vectors::<V>(self.x.vectors);
        group.check(x);
        let halves = group.halves_of(x);
        unroll!(p in 0..HALVES {
            unroll!(r in 0..J {
                x[group.items[p][r]] = halves[p][r];
            });
        });
    }

    #[inline(always)]
    fn apply<V: Vector<Element = T>, const J: usize>(
        &mut self,
        group: Group<'_, V, J>,
        p: usize,
        z: [Complex<V>; J],
    ) -> [Complex<V>; J]
    where
        Codelet: Dft<J>,
    {
        let block = complex_vectors::<V>(self.x.vectors);
        let mut x = z;
        for r in 0..J {
            x[r] = block[group.items[p][r]];
        }
        let x = Codelet::dft(transposed(x));
        let sum = group.part_mut(complex_vectors::<V>(self.sum));
        for c in 0..J {
            let Complex { re, im } = sum[c][p];
            let re = x[c].im.mul_add(z[c].im, x[c].re.mul_add(z[c].re, re));
            let im = x[c].im.neg_mul_add(z[c].re, x[c].re.mul_add(z[c].im, im));
            sum[c][p] = Complex::new(re, im);
        }
        z
    }
}

/// One after the other.
impl<T: Element, A: Middle<T>, B: Middle<T>> Middle<T> for (A, B) {
    const INVERSE: bool = A::INVERSE || B::INVERSE;

    #[inline(always)]
    fn begin<V: Vector<Element = T>>(&mut self, rows: &[usize]) {
        self.0.begin::<V>(rows);
        self.1.begin::<V>(rows);
    }

    #[inline(always)]
    fn enter<V: Vector<Element = T>, const J: usize>(&mut self, group: Group<'_, V, J>) {
        self.0.enter(group);
        self.1.enter(group);
    }

    #[inline(always)]
    fn apply<V: Vector<Element = T>, const J: usize>(
        &mut self,
        group: Group<'_, V, J>,
        p: usize,
        z: [Complex<V>; J],
    ) -> [Complex<V>; J]
    where
        Codelet: Dft<J>,
    {
        let z = self.0.apply(group, p, z);
        self.1.apply(group, p, z)
    }
}

/// `middle` on all groups of a block, there and back. `RUN` divides the lanes and the slots of a row.
pub(super) struct Filter<'a, T, M, const RUN: usize> {
    pub(super) block: Block<'a, T>,
    pub(super) turns: Turns<'a, T>,
    pub(super) middle: M,
}

impl<T: Element, M: Middle<T>, const RUN: usize> Algorithm<T> for Filter<'_, T, M, RUN> {
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

impl<T: Element, M: Middle<T>, const RUN: usize> Filter<'_, T, M, RUN> {
    #[inline(always)]
    fn run_lanes<V: Vector<Element = T>, const J: usize>(mut self)
    where
        Codelet: Dft<J>,
    {
        assert!(RUN <= HALVES * J, "a run is part of a group");
        let Turns { rows, rows_each, slots, twiddles } = self.turns;
        let (odd, turns) = complex_vectors_of::<V>(twiddles).split_first().expect("a table");
        let Block { vectors, pitch } = self.block;
        let block = complex_vectors::<V>(vectors);
        let groups = rows_each * slots / V::LANES;
        for (turn, rows) in rows.chunks_exact(rows_each).enumerate() {
            split_rows(block, pitch, rows);
            self.middle.begin::<V>(rows);
            for number in 0..groups {
                let mut items = [[0; J]; HALVES];
                unroll!(p in 0..HALVES {
                    unroll!(r in 0..J {
                        let item = p * J + r;
                        let run = number * V::LANES + item / RUN * RUN;
                        items[p][r] = rows[run / slots] * pitch + run % slots + item % RUN;
                    });
                });
                let place = turn * groups + number;
                let group = Group { place, items, turns: part(turns, number), odd };
                group.check(block);
                self.middle.enter(group);
                let mut halves = group.halves_of(block);
                unroll!(p in 0..HALVES {
                    let z = Codelet::dft(transposed(halves[p]));
                    let z = self.middle.apply(group, p, z);
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

/// The vectors of a group in a table.
#[inline(always)]
fn part<V, const J: usize>(table: &[Complex<V>], group: usize) -> &[[Complex<V>; HALVES]; J] {
    let pairs = table.as_chunks().0;
    pairs[group * J..].first_chunk().expect("a whole group")
}

#[inline(always)]
fn complex<V: Vector, const N: usize>(re: [V; N], im: [V; N]) -> [Complex<V>; N] {
    let mut z = [Complex::new(re[0], im[0]); N];
    for j in 0..N {
        z[j] = Complex::new(re[j], im[j]);
    }
    z
}

#[inline(always)]
fn parts<V: Vector, const N: usize>(z: [Complex<V>; N]) -> ([V; N], [V; N]) {
    let (mut re, mut im) = ([z[0].re; N], [z[0].im; N]);
    for j in 0..N {
        (re[j], im[j]) = (z[j].re, z[j].im);
    }
    (re, im)
}

impl<V: Vector, const J: usize> Group<'_, V, J> {
    /// The vectors of this group in a packed weight.
    #[inline(always)]
    fn part<'a>(&self, packed: &'a [Complex<V>]) -> &'a [[Complex<V>; HALVES]; J] {
        part(packed, self.place)
    }

    /// As [`part`](Self::part), to write.
    #[inline(always)]
    fn part_mut<'a>(&self, packed: &'a mut [Complex<V>]) -> &'a mut [[Complex<V>; HALVES]; J] {
        let pairs = packed.as_chunks_mut().0;
        pairs[self.place * J..].first_chunk_mut().expect("a whole group")
    }

    /// All items are in `block`.
    #[inline(always)]
    fn check(&self, block: &[Complex<V>]) {
        unroll!(p in 0..HALVES {
            unroll!(r in 0..J {
                assert!(self.items[p][r] < block.len());
            });
        });
    }

    /// The group up to what is done to each half alone.
    #[inline(always)]
    fn halves_of(&self, block: &[Complex<V>]) -> [[Complex<V>; J]; HALVES] {
        let mut halves = [[Complex::zero(); J]; HALVES];
        unroll!(r in 0..J {
            let [low, high] = exchanged(block[self.items[0][r]], block[self.items[1][r]]);
            let [by_low, by_high] = self.turns[r];
            let (low, high) = (low.times(by_low), high.times(by_high));
            halves[0][r] = low + high;
            halves[1][r] = (low - high).times(*self.odd);
        });
        halves
    }

    /// Undoes [`halves_of`](Self::halves_of) up to a factor.
    #[inline(always)]
    fn put_halves(&self, halves: [[Complex<V>; J]; HALVES], block: &mut [Complex<V>]) {
        // loaded again: the compiler would keep them on the stack
        let (turns, odd) = (black_box(self.turns), *black_box(self.odd));
        unroll!(r in 0..J {
            let (even, odd) = (halves[0][r], halves[1][r].times_conj(odd));
            let [by_low, by_high] = turns[r];
            let (low, high) = ((even + odd).times_conj(by_low), (even - odd).times_conj(by_high));
            let [first, second] = exchanged(low, high);
            block[self.items[0][r]] = first;
            block[self.items[1][r]] = second;
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
fn transposed<V: Vector, const J: usize>(z: [Complex<V>; J]) -> [Complex<V>; J] {
    let (mut re, mut im) = parts(z);
    V::transpose_in_halves(&mut re);
    V::transpose_in_halves(&mut im);
    complex(re, im)
}

/// Slot 0 of each pair of rows to the doubled spectra of its two real lines.
#[inline(always)]
fn split_rows<V: Vector>(block: &mut [Complex<V>], pitch: usize, rows: &[usize]) {
    for &[a, b] in rows.as_chunks().0 {
        let [first, second] = split(block[a * pitch], block[b * pitch]);
        block[a * pitch] = first;
        block[b * pitch] = second;
    }
}

/// Undoes [`split_rows`] up to a factor.
#[inline(always)]
fn join_rows<V: Vector>(block: &mut [Complex<V>], pitch: usize, rows: &[usize]) {
    for &[a, b] in rows.as_chunks().0 {
        let (first, second) = join([block[a * pitch], block[b * pitch]]);
        block[a * pitch] = first;
        block[b * pitch] = second;
    }
}
