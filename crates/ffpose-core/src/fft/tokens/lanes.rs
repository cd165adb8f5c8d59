//! The one transform that crosses lanes, with what is done to the spectrum in between.
//!
//! Items are the slots of rows, in order; as many as there are lanes are a group. A square of vectors is transposed, so that
//! lanes are items; each is turned by `exp(-2πi k y / Y)`, where `k` is its frequency along the line and `y` the lane that it
//! came from, and transformed over `y`. Vector `j` of a group is then frequency `k + M j` along Y. The same back.
//!
//! A group fills all registers, so that it is never moved as a whole: lane `y = J q + r` is element `r` of block `q` of a vector,
//! and `j = p + Q c`. Transposing inside blocks takes `J` items at a time, transposing blocks and the DFT over `q` takes `Q`
//! vectors of one `r`, and the DFT over `r`, the product and the way back take `J` vectors of one `p`.
//!
//! Rows come in pairs of `u` and `-u`, since slot 0 is two real lines as one complex line: they part to slot 0 of the two rows.

use std::hint::black_box;

use super::columns::Block;
use crate::fft::butterfly::{Codelet, Dft, turn};
use crate::fft::pair::{join, split};
use crate::fft::unroll::unroll;
use crate::simd::{
    Algorithm, Complex, Element, MAX_LANES, Tile, Vector, complex_vectors, gather, scatter,
};

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

    /// Makes a group ready. `RUN` divides the lanes and the slots of a row.
    fn enter<V: Vector<Element = T>, const Q: usize, const J: usize, const RUN: usize>(
        &mut self,
        group: Group<'_, T>,
    ) where
        Codelet: Dft<Q> + Dft<J>;

    /// The new values of vectors `p`, `p + Q`, ... of a group.
    fn apply<V: Vector<Element = T>, const Q: usize, const J: usize, const RUN: usize>(
        &mut self,
        group: Group<'_, T>,
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
    fn enter<V: Vector<Element = T>, const Q: usize, const J: usize, const RUN: usize>(
        &mut self,
        _: Group<'_, T>,
    ) where
        Codelet: Dft<Q> + Dft<J>,
    {
    }

    #[inline(always)]
    fn apply<V: Vector<Element = T>, const Q: usize, const J: usize, const RUN: usize>(
        &mut self,
        group: Group<'_, T>,
        p: usize,
        mut z: [Complex<V>; J],
    ) -> [Complex<V>; J]
    where
        Codelet: Dft<J>,
    {
        let weight: [_; J] = vectors(self.0, group.place * V::LANES + p, Q);
        for c in 0..J {
            z[c] = if CONJUGATE { z[c].times_conj(weight[c]) } else { z[c].times(weight[c]) };
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
    fn enter<V: Vector<Element = T>, const Q: usize, const J: usize, const RUN: usize>(
        &mut self,
        group: Group<'_, T>,
    ) where
        Codelet: Dft<Q> + Dft<J>,
    {
        let (block, pitch) = (complex_vectors::<V>(self.x.vectors), self.x.pitch);
        let rows = group.rows_of::<V, Q, J, RUN>(block, pitch);
        unroll!(p in 0..Q {
            group.set_items::<V, J, RUN>(block, pitch, p, rows[p]);
        });
    }

    #[inline(always)]
    fn apply<V: Vector<Element = T>, const Q: usize, const J: usize, const RUN: usize>(
        &mut self,
        group: Group<'_, T>,
        p: usize,
        z: [Complex<V>; J],
    ) -> [Complex<V>; J]
    where
        Codelet: Dft<J>,
    {
        let block = complex_vectors::<V>(self.x.vectors);
        let x = Codelet::dft(group.items::<V, J, RUN>(block, self.x.pitch, p));
        let sums = complex_vectors::<V>(self.sum);
        let first = group.place * V::LANES + p;
        let mut sum: [_; J] = gather(sums, first, Q);
        for c in 0..J {
            let Complex { re, im } = sum[c];
            sum[c].re = x[c].im.mul_add(z[c].im, x[c].re.mul_add(z[c].re, re));
            sum[c].im = x[c].im.neg_mul_add(z[c].re, x[c].re.mul_add(z[c].im, im));
        }
        scatter(sums, first, Q, sum);
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
    fn enter<V: Vector<Element = T>, const Q: usize, const J: usize, const RUN: usize>(
        &mut self,
        group: Group<'_, T>,
    ) where
        Codelet: Dft<Q> + Dft<J>,
    {
        self.0.enter::<V, Q, J, RUN>(group);
        self.1.enter::<V, Q, J, RUN>(group);
    }

    #[inline(always)]
    fn apply<V: Vector<Element = T>, const Q: usize, const J: usize, const RUN: usize>(
        &mut self,
        group: Group<'_, T>,
        p: usize,
        z: [Complex<V>; J],
    ) -> [Complex<V>; J]
    where
        Codelet: Dft<J>,
    {
        let z = self.0.apply::<V, Q, J, RUN>(group, p, z);
        self.1.apply::<V, Q, J, RUN>(group, p, z)
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
        match (V::LANES / V::BLOCK, V::BLOCK) {
            (1, 2) => self.run_lanes::<V, 1, 2>(),
            (2, 2) => self.run_lanes::<V, 2, 2>(),
            (4, 2) => self.run_lanes::<V, 4, 2>(),
            (1, 4) => self.run_lanes::<V, 1, 4>(),
            (2, 4) => self.run_lanes::<V, 2, 4>(),
            (4, 4) => self.run_lanes::<V, 4, 4>(),
            _ => unreachable!("no transform across {} lanes", V::LANES),
        }
    }
}

impl<T: Element, M: Middle<T>, const RUN: usize> Filter<'_, T, M, RUN> {
    #[inline(always)]
    fn run_lanes<V: Vector<Element = T>, const Q: usize, const J: usize>(mut self)
    where
        Codelet: Dft<Q> + Dft<J>,
    {
        assert!(RUN <= Q * J, "a run is part of a group");
        let Turns { rows, rows_each, slots, twiddles } = self.turns;
        let Block { vectors, pitch } = self.block;
        let block = complex_vectors::<V>(vectors);
        let groups = rows_each * slots / V::LANES;
        for (turn, rows) in rows.chunks_exact(rows_each).enumerate() {
            split_rows(block, pitch, rows);
            self.middle.begin::<V>(rows);
            for number in 0..groups {
                let place = turn * groups + number;
                let group = Group { place, rows, slots, twiddles, number };
                self.middle.enter::<V, Q, J, RUN>(group);
                let mut square = group.rows_of::<V, Q, J, RUN>(block, pitch);
                unroll!(p in 0..Q {
                    let z = <Codelet as Dft<J>>::dft(square[p]);
                    let z = self.middle.apply::<V, Q, J, RUN>(group, p, z);
                    if M::INVERSE {
                        square[p] = <Codelet as Dft<J>>::idft(z);
                    }
                });
                if M::INVERSE {
                    group.put_rows::<V, Q, J, RUN>(square, block, pitch);
                }
            }
            if M::INVERSE {
                join_rows(block, pitch, rows);
            }
        }
    }
}

/// Complex vectors `first`, `first + step`, ... of a table.
#[inline(always)]
fn vectors<V: Vector, const N: usize>(
    table: &[V::Element],
    first: usize,
    step: usize,
) -> [Complex<V>; N] {
    let tile = Tile::dense(table, V::LANES);
    let (re, im) = (tile.gather(2 * first, 2 * step), tile.gather(2 * first + 1, 2 * step));
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

impl<T: Element> Group<'_, T> {
    /// Where an item is in the block.
    #[inline(always)]
    fn position<V: Vector, const RUN: usize>(&self, item: usize, pitch: usize) -> usize {
        let run = self.number * V::LANES + item / RUN * RUN;
        self.rows[run / self.slots] * pitch + run % self.slots + item % RUN
    }

    /// Items `J i` and following.
    #[inline(always)]
    fn items<V: Vector, const J: usize, const RUN: usize>(
        &self,
        block: &[Complex<V>],
        pitch: usize,
        i: usize,
    ) -> [Complex<V>; J] {
        if RUN >= J {
            return gather(block, self.position::<V, RUN>(i * J, pitch), 1);
        }
        let mut items = [Complex::zero(); J];
        for item in (0..J).step_by(RUN) {
            let run: [_; RUN] = gather(block, self.position::<V, RUN>(i * J + item, pitch), 1);
            items[item..item + RUN].copy_from_slice(&run);
        }
        items
    }

    /// Writes what [`items`](Self::items) reads.
    #[inline(always)]
    fn set_items<V: Vector, const J: usize, const RUN: usize>(
        &self,
        block: &mut [Complex<V>],
        pitch: usize,
        i: usize,
        items: [Complex<V>; J],
    ) {
        if RUN >= J {
            scatter(block, self.position::<V, RUN>(i * J, pitch), 1, items);
            return;
        }
        for item in (0..J).step_by(RUN) {
            let mut run = [items[item]; RUN];
            run.copy_from_slice(&items[item..item + RUN]);
            scatter(block, self.position::<V, RUN>(i * J + item, pitch), 1, run);
        }
    }

    /// All but the last transform of a group: a DFT of `[p]` is vectors `p`, `p + Q`, ... of its spectrum.
    #[inline(always)]
    fn rows_of<V: Vector<Element = T>, const Q: usize, const J: usize, const RUN: usize>(
        &self,
        block: &[Complex<V>],
        pitch: usize,
    ) -> [[Complex<V>; J]; Q]
    where
        Codelet: Dft<Q>,
    {
        let mut square = [[Complex::zero(); J]; Q];
        unroll!(i in 0..Q {
            let (mut re, mut im) = parts(self.items::<V, J, RUN>(block, pitch, i));
            V::transpose_in_blocks(&mut re);
            V::transpose_in_blocks(&mut im);
            square[i] = complex(re, im);
        });
        unroll!(r in 0..J {
            let (mut re, mut im) = parts(column(&square, r));
            V::transpose_blocks(&mut re);
            V::transpose_blocks(&mut im);
            let mut z: [_; Q] = complex(re, im);
            let twiddles: [_; Q] = vectors(self.twiddles, self.number * V::LANES + r, J);
            for q in 0..Q {
                if q + r > 0 {
                    z[q] = z[q].times(twiddles[q]);
                }
            }
            let z = <Codelet as Dft<Q>>::dft(z);
            for p in 0..Q {
                square[p][r] = lane_turn::<V>(z[p], p * r);
            }
        });
        square
    }

    /// Undoes [`rows_of`](Self::rows_of) up to a factor.
    #[inline(always)]
    fn put_rows<V: Vector<Element = T>, const Q: usize, const J: usize, const RUN: usize>(
        &self,
        mut square: [[Complex<V>; J]; Q],
        block: &mut [Complex<V>],
        pitch: usize,
    ) where
        Codelet: Dft<Q>,
    {
        // loaded again: the compiler would keep them on the stack
        let number = black_box(self.number);
        unroll!(r in 0..J {
            let mut z: [_; Q] = column(&square, r);
            for p in 0..Q {
                z[p] = lane_turn::<V>(z[p].swap(), p * r).swap();
            }
            let mut z = <Codelet as Dft<Q>>::idft(z);
            let twiddles: [_; Q] = vectors(self.twiddles, number * V::LANES + r, J);
            for q in 0..Q {
                if q + r > 0 {
                    z[q] = z[q].times_conj(twiddles[q]);
                }
            }
            let (mut re, mut im) = parts(z);
            V::transpose_blocks(&mut re);
            V::transpose_blocks(&mut im);
            for q in 0..Q {
                square[q][r] = Complex::new(re[q], im[q]);
            }
        });
        unroll!(i in 0..Q {
            let (mut re, mut im) = parts(square[i]);
            V::transpose_in_blocks(&mut re);
            V::transpose_in_blocks(&mut im);
            self.set_items::<V, J, RUN>(block, pitch, i, complex(re, im));
        });
    }
}

/// Element `r` of each row.
#[inline(always)]
fn column<V: Vector, const Q: usize, const J: usize>(
    square: &[[Complex<V>; J]; Q],
    r: usize,
) -> [Complex<V>; Q] {
    let mut column = [square[0][r]; Q];
    for q in 0..Q {
        column[q] = square[q][r];
    }
    column
}

/// `z exp(-2πi k / L)` for `L` lanes.
#[inline(always)]
fn lane_turn<V: Vector>(z: Complex<V>, k: usize) -> Complex<V> {
    turn::<V, MAX_LANES>(z, MAX_LANES / V::LANES * k)
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
