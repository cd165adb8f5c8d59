//! Rows of an image, as real lines of vectors, to slots of a block and back.
//!
//! A line of `M` vectors has `M / 2` slots: slot `k` is frequency `k`, and slot 0 has the two real frequencies 0 and `M / 2` as
//! real and imaginary part. `M = P Q`: `P` real across, then `Q`; for odd `Q` without twiddles (Good–Thomas), for a power of two
//! with (Cooley–Tukey).

use super::blocks::Block;
use crate::fft::codelets::{Codelet, Dft, RealDft, TwoReal, times_root, unroll, with_codelet};
use crate::simd::{
    Algorithm, Complex, Isa, Stored, Tile, TileMut, Vector, complex_vectors, gather, scatter,
};

/// Rows of `image` to rows of `block`; `work` has room for half a line of complex vectors. Where memory is far, `target` is where
/// the rows go after that: it is asked for in time, and so are the rows of the next call.
#[inline(always)]
pub(super) fn forward<X: Stored>(
    isa: Isa,
    image: Tile<'_, X>,
    target: Option<Tile<'_, X::Real>>,
    block: Block<'_, X::Real>,
    work: &mut [X::Real],
) {
    with_codelet!(line image.lanes() / isa.lanes::<X::Real>(), (P, Q, ROWS) => {
        isa.run_tuned(LinesForward::<X, P, Q, ROWS> { image, target, block, work });
    }, _ => unreachable!("planned lengths"));
}

/// Rows of `block`, doubled but for slot 0, to rows of `image`, up to a factor of their length. Where memory is far, the rows of
/// the next call are asked for.
#[inline(always)]
pub(super) fn inverse<X: Stored>(
    isa: Isa,
    block: Block<'_, X::Real>,
    image: TileMut<'_, X>,
    work: &mut [X::Real],
    far: bool,
) {
    with_codelet!(line image.reader().lanes() / isa.lanes::<X::Real>(), (P, Q, ROWS) => {
        isa.run_tuned(LinesInverse::<X, P, Q, ROWS> { block, image, work, far });
    }, _ => unreachable!("planned lengths"));
}

/// A line of `P Q`; `ROWS` is `P / 2`.
struct Line<const P: usize, const Q: usize, const ROWS: usize>;

impl<const P: usize, const Q: usize, const ROWS: usize> Line<P, Q, ROWS>
where
    Codelet: RealDft<P, ROWS> + TwoReal<Q>,
{
    const LENGTH: usize = P * Q;
    const COPRIME: bool = Q % 2 == 1;

    /// The points of transform `q` across.
    const POINTS: [[usize; P]; Q] = {
        let mut points = [[0; P]; Q];
        let mut n = 0;
        while n < P * Q {
            let (p, q) = (n / Q, n % Q);
            points[q][p] = if Self::COPRIME { (Q * p + P * q) % (P * Q) } else { n };
            n += 1;
        }
        points
    };

    /// The frequency of element `k` of row `row`, as the codelets leave it.
    const fn frequency(row: usize, k: usize) -> usize {
        if row > 0 {
            return Self::joined(<Codelet as RealDft<P, ROWS>>::FREQUENCIES[row], k);
        }
        let (line, k) = <Codelet as TwoReal<Q>>::FREQUENCIES[k];
        Self::joined(line * P / 2, k)
    }

    /// The frequency that is `p` modulo `P` and, across, `q` modulo `Q`.
    const fn joined(p: usize, q: usize) -> usize {
        if !Self::COPRIME {
            return p + P * q;
        }
        let mut k = p;
        while k % Q != q {
            k += P;
        }
        k
    }

    /// The slot of each element of the rows, and whether it holds its conjugate.
    const SLOTS: [[(usize, bool); Q]; ROWS] = {
        let mut slots = [[(0, false); Q]; ROWS];
        let mut i = 0;
        while i < ROWS * Q {
            let k = Self::frequency(i / Q, i % Q);
            slots[i / Q][i % Q] = if 2 * k > P * Q { (P * Q - k, true) } else { (k, false) };
            i += 1;
        }
        slots
    };
}

struct LinesForward<'a, X: Stored, const P: usize, const Q: usize, const ROWS: usize> {
    image: Tile<'a, X>,
    target: Option<Tile<'a, X::Real>>,
    block: Block<'a, X::Real>,
    work: &'a mut [X::Real],
}

impl<X: Stored, const P: usize, const Q: usize, const ROWS: usize> Algorithm<X::Real>
    for LinesForward<'_, X, P, Q, ROWS>
where
    Codelet: RealDft<P, ROWS> + TwoReal<Q> + Dft<Q>,
{
    #[inline(always)]
    fn run<V: Vector<Element = X::Real>>(self) {
        let Block { vectors, pitch } = self.block;
        let block = complex_vectors::<V>(vectors);
        let work = &mut complex_vectors::<V>(self.work)[..ROWS * Q];
        for row in 0..self.image.points() {
            let line = self.image.point(row, V::LANES);
            if let Some(target) = self.target {
                line.prefetch_behind(); // of the next `x2`
                target.point(row, V::LANES).prefetch_all();
            }
            let slots = &mut block[row * pitch..][..ROWS * Q];
            unroll!(q in 0..Q {
                let points = Line::<P, Q, ROWS>::POINTS[q];
                let across = line.gather_at::<V, P>(0, points, Line::<P, Q, ROWS>::LENGTH);
                scatter(work, q, Q, <Codelet as RealDft<P, ROWS>>::real_dft(across));
            });
            let zeroth = <Codelet as TwoReal<Q>>::two_real_dft(gather(work, 0, 1));
            Line::<P, Q, ROWS>::put(slots, 0, zeroth);
            unroll!(row in 1..ROWS {
                let mut z = gather::<_, Q>(work, row * Q, 1);
                if !Line::<P, Q, ROWS>::COPRIME {
                    for q in 1..Q {
                        z[q] = times_root::<V, 64>(z[q], Line::<P, Q, ROWS>::turns(row, q));
                    }
                }
                Line::<P, Q, ROWS>::put(slots, row, <Codelet as Dft<Q>>::dft(z));
            });
        }
    }
}

impl<const P: usize, const Q: usize, const ROWS: usize> Line<P, Q, ROWS>
where
    Codelet: RealDft<P, ROWS> + TwoReal<Q>,
{
    /// The twiddle of an element, in parts of 64 of a turn.
    #[inline(always)]
    const fn turns(row: usize, q: usize) -> usize {
        64 / Self::LENGTH * q * <Codelet as RealDft<P, ROWS>>::FREQUENCIES[row]
    }

    /// Writes the elements of a row to their slots.
    #[inline(always)]
    fn put<V: Vector>(slots: &mut [Complex<V>], row: usize, z: [Complex<V>; Q]) {
        for q in 0..Q {
            let (slot, conjugate) = Self::SLOTS[row][q];
            slots[slot] = if conjugate { z[q].conj() } else { z[q] };
        }
    }

    /// Reads the elements of a row from their slots.
    #[inline(always)]
    fn get<V: Vector>(slots: &[Complex<V>], row: usize) -> [Complex<V>; Q] {
        let mut z = [Complex::zero(); Q];
        for q in 0..Q {
            let (slot, conjugate) = Self::SLOTS[row][q];
            z[q] = if conjugate { slots[slot].conj() } else { slots[slot] };
        }
        z
    }
}

struct LinesInverse<'a, X: Stored, const P: usize, const Q: usize, const ROWS: usize> {
    block: Block<'a, X::Real>,
    image: TileMut<'a, X>,
    work: &'a mut [X::Real],
    far: bool,
}

impl<X: Stored, const P: usize, const Q: usize, const ROWS: usize> Algorithm<X::Real>
    for LinesInverse<'_, X, P, Q, ROWS>
where
    Codelet: RealDft<P, ROWS> + TwoReal<Q> + Dft<Q>,
{
    #[inline(always)]
    fn run<V: Vector<Element = X::Real>>(mut self) {
        let Block { vectors, pitch } = self.block;
        let block = complex_vectors::<V>(vectors);
        let work = &mut complex_vectors::<V>(self.work)[..ROWS * Q];
        for row in 0..self.image.reader().points() {
            let slots = &block[row * pitch..][..ROWS * Q];
            let zeroth = Line::<P, Q, ROWS>::get(slots, 0);
            scatter(work, 0, 1, <Codelet as TwoReal<Q>>::two_real_idft(zeroth));
            unroll!(row in 1..ROWS {
                let z = Line::<P, Q, ROWS>::get(slots, row);
                let mut z = <Codelet as Dft<Q>>::idft(z);
                if !Line::<P, Q, ROWS>::COPRIME {
                    for q in 1..Q {
                        let turns = Line::<P, Q, ROWS>::turns(row, q);
                        z[q] = times_root::<V, 64>(z[q].swap(), turns).swap();
                    }
                }
                scatter(work, row * Q, 1, z);
            });
            let mut line = self.image.point(row, V::LANES);
            if self.far {
                line.reader().prefetch_behind(); // of the next `x2`
            }
            unroll!(q in 0..Q {
                let across = <Codelet as RealDft<P, ROWS>>::real_idft(gather(work, q, Q));
                let points = Line::<P, Q, ROWS>::POINTS[q];
                line.scatter_at::<V, P>(0, points, Line::<P, Q, ROWS>::LENGTH, across);
            });
        }
    }
}
