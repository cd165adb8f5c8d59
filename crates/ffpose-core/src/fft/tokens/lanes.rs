//! The one transform that crosses lanes, with what is done to the spectrum in between.
//!
//! Items are the slots of rows, in order; as many as there are lanes are a group. A square of vectors is transposed, so that
//! lanes are items; each is turned by `exp(-2πi k y / Y)`, where `k` is its frequency along the line and `y` the lane that it
//! came from, and transformed over `y`. Vector `j` of a group is then frequency `k + M j` along Y. The same back.
//!
//! Rows come in pairs of `u` and `-u`, since slot 0 is two real lines as one complex line: they part to slot 0 of the two rows.

use std::hint::black_box;

use super::columns::Block;
use crate::fft::butterfly::{Codelet, Dft};
use crate::fft::pair::{join, split};
use crate::simd::{Algorithm, Complex, Element, Tile, Vector, complex_vectors, gather, scatter};

/// The rows of a block in the order of their groups.
#[derive(Clone, Copy)]
pub(super) struct Turns<'a, T> {
    /// Positions of `u` and `-u` in turn.
    pub(super) rows: &'a [usize],
    /// The least number of rows in pairs whose slots fill groups without a rest.
    pub(super) rows_each: usize,
    pub(super) slots: usize,
    /// What the items of such rows are turned by: for each group and each `y` a complex vector.
    pub(super) twiddles: &'a [T],
}

/// A group: its number in the block, its rows and its number among those of its turn.
#[derive(Clone, Copy)]
pub(super) struct Group<'a, T> {
    place: usize,
    rows: &'a [usize],
    slots: usize,
    twiddles: &'a [T],
    number: usize,
}

/// What is done to the spectrum of a group.
pub(super) trait Middle<T: Element> {
    /// Whether the spectrum goes back to its block.
    const INVERSE: bool;

    /// Makes the slots 0 of `rows` ready.
    fn begin<V: Vector<Element = T>>(&mut self, rows: &[usize]);

    /// `RUN` divides the lanes and the slots of a row.
    fn apply<V: Vector<Element = T>, const N: usize, const RUN: usize>(
        &mut self,
        group: Group<'_, T>,
        z: [Complex<V>; N],
    ) -> [Complex<V>; N]
    where
        Codelet: Dft<N>;
}

/// The product with a packed weight, or with its conjugate.
pub(super) struct Product<'a, T, const CONJUGATE: bool>(pub(super) &'a [T]);

impl<T: Element, const CONJUGATE: bool> Middle<T> for Product<'_, T, CONJUGATE> {
    const INVERSE: bool = true;

    #[inline(always)]
    fn begin<V: Vector<Element = T>>(&mut self, _: &[usize]) {}

    #[inline(always)]
    fn apply<V: Vector<Element = T>, const N: usize, const RUN: usize>(
        &mut self,
        group: Group<'_, T>,
        mut z: [Complex<V>; N],
    ) -> [Complex<V>; N]
    where
        Codelet: Dft<N>,
    {
        let weight = vectors::<V, N>(self.0, group.place);
        for j in 0..N {
            z[j] = if CONJUGATE { z[j].times_conj(weight[j]) } else { z[j].times(weight[j]) };
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
    fn apply<V: Vector<Element = T>, const N: usize, const RUN: usize>(
        &mut self,
        group: Group<'_, T>,
        z: [Complex<V>; N],
    ) -> [Complex<V>; N]
    where
        Codelet: Dft<N>,
    {
        let block = complex_vectors::<V>(self.x.vectors);
        let x = spectrum::<V, N, RUN>(block, self.x.pitch, group);
        let sum = &mut complex_vectors::<V>(self.sum)[group.place * N..][..N];
        for j in 0..N {
            let Complex { re, im } = sum[j];
            sum[j].re = x[j].im.mul_add(z[j].im, x[j].re.mul_add(z[j].re, re));
            sum[j].im = x[j].im.neg_mul_add(z[j].re, x[j].re.mul_add(z[j].im, im));
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
    fn apply<V: Vector<Element = T>, const N: usize, const RUN: usize>(
        &mut self,
        group: Group<'_, T>,
        z: [Complex<V>; N],
    ) -> [Complex<V>; N]
    where
        Codelet: Dft<N>,
    {
        let z = self.0.apply::<V, N, RUN>(group, z);
        self.1.apply::<V, N, RUN>(group, z)
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
            2 => self.run_lanes::<V, 2>(),
            4 => self.run_lanes::<V, 4>(),
            8 => self.run_lanes::<V, 8>(),
            16 => self.run_lanes::<V, 16>(),
            lanes => unreachable!("no transform across {lanes} lanes"),
        }
    }
}

impl<T: Element, M: Middle<T>, const RUN: usize> Filter<'_, T, M, RUN> {
    #[inline(always)]
    fn run_lanes<V: Vector<Element = T>, const N: usize>(mut self)
    where
        Codelet: Dft<N>,
    {
        assert!(RUN <= N, "a run is part of a group");
        let Turns { rows, rows_each, slots, twiddles } = self.turns;
        let Block { vectors, pitch } = self.block;
        let block = complex_vectors::<V>(vectors);
        let groups = rows_each * slots / N;
        for (turn, rows) in rows.chunks_exact(rows_each).enumerate() {
            split_rows(block, pitch, rows);
            self.middle.begin::<V>(rows);
            for number in 0..groups {
                let place = turn * groups + number;
                let group = Group { place, rows, slots, twiddles, number };
                let z = spectrum::<V, N, RUN>(block, pitch, group);
                let z = self.middle.apply::<V, N, RUN>(group, z);
                if M::INVERSE {
                    back::<V, N, RUN>(block, pitch, group, z);
                }
            }
            if M::INVERSE {
                join_rows(block, pitch, rows);
            }
        }
    }
}

/// Complex vectors number `place * N` and following of a table.
#[inline(always)]
fn vectors<V: Vector, const N: usize>(table: &[V::Element], place: usize) -> [Complex<V>; N] {
    let tile = Tile::dense(table, V::LANES);
    let (re, im) =
        (tile.gather::<V, N>(2 * place * N, 2), tile.gather::<V, N>(2 * place * N + 1, 2));
    complex(re, im)
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

impl<T> Group<'_, T> {
    /// Where items `run * RUN` and following are in the block.
    #[inline(always)]
    fn position<const N: usize, const RUN: usize>(&self, run: usize, pitch: usize) -> usize {
        let item = self.number * N + run * RUN;
        self.rows[item / self.slots] * pitch + item % self.slots
    }
}

/// The spectrum of a group.
#[inline(always)]
fn spectrum<V: Vector, const N: usize, const RUN: usize>(
    block: &[Complex<V>],
    pitch: usize,
    group: Group<'_, V::Element>,
) -> [Complex<V>; N]
where
    Codelet: Dft<N>,
{
    let mut z = [Complex::zero(); N];
    for run in 0..N / RUN {
        let items = gather::<_, RUN>(block, group.position::<N, RUN>(run, pitch), 1);
        for i in 0..RUN {
            z[run * RUN + i] = items[i];
        }
    }
    let (mut re, mut im) = parts(z);
    V::transpose(&mut re);
    V::transpose(&mut im);
    let (mut z, twiddles) = (complex(re, im), vectors::<V, N>(group.twiddles, group.number));
    for y in 1..N {
        z[y] = z[y].times(twiddles[y]);
    }
    Codelet::dft(z)
}

/// Undoes [`spectrum`] up to a factor.
#[inline(always)]
fn back<V: Vector, const N: usize, const RUN: usize>(
    block: &mut [Complex<V>],
    pitch: usize,
    group: Group<'_, V::Element>,
    z: [Complex<V>; N],
) where
    Codelet: Dft<N>,
{
    // loaded again: the compiler would keep them on the stack
    let twiddles = vectors::<V, N>(group.twiddles, black_box(group.number));
    let mut z = Codelet::idft(z);
    for y in 1..N {
        z[y] = z[y].times_conj(twiddles[y]);
    }
    let (mut re, mut im) = parts(z);
    V::transpose(&mut re);
    V::transpose(&mut im);
    let z = complex(re, im);
    for run in 0..N / RUN {
        let mut items = [z[0]; RUN];
        for i in 0..RUN {
            items[i] = z[run * RUN + i];
        }
        scatter(block, group.position::<N, RUN>(run, pitch), 1, items);
    }
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
