//! Real lines of length `P Q` to half spectra and back: `P` across, then the rows that this leaves.
//!
//! `Q` odd, coprime to `P`: no twiddles (Good–Thomas). Both powers of two: twiddles between (Cooley–Tukey). The real DFTs across
//! leave `ceil(P / 2)` rows of `Q`: row 0 is two real lines, or with `Q = 1` one number, the others are complex.

use super::{Codelet, Dft, RealDft, TwoReal, times_root, unroll};
use crate::simd::{Complex, Stored, Tile, TileMut, Vector, gather, gather_at, scatter, scatter_at};

/// Parts of a turn that twiddles are whole numbers of: the longest line of powers of two.
const TURN: usize = 128;

/// A line of `P Q` in `ROWS` rows. Slot `s Q + k` is element `k` of row `s`, as the codelets leave it; or, `IN_ORDER`, slot `k` is
/// frequency `k`.
pub(crate) struct RealLine<const P: usize, const Q: usize, const ROWS: usize, const IN_ORDER: bool>;

impl<const P: usize, const Q: usize, const ROWS: usize, const IN_ORDER: bool>
    RealLine<P, Q, ROWS, IN_ORDER>
where
    Codelet: RealDft<P, ROWS> + TwoReal<Q> + Dft<Q>,
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

    /// The frequency of each element of the rows.
    pub(crate) const FREQUENCIES: [[usize; Q]; ROWS] = {
        let mut frequencies = [[0; Q]; ROWS];
        let mut i = 0;
        while i < ROWS * Q {
            let (row, k) = (i / Q, i % Q);
            let (p, q) = if row > 0 {
                (<Codelet as RealDft<P, ROWS>>::FREQUENCIES[row], k)
            } else {
                let (line, k) = <Codelet as TwoReal<Q>>::FREQUENCIES[k];
                (line * P / 2, k)
            };
            // what is `p` modulo `P` and, across, `q` modulo `Q`
            let mut joined = if Self::COPRIME { p } else { p + P * q };
            while Self::COPRIME && joined % Q != q {
                joined += P;
            }
            frequencies[row][k] = joined;
            i += 1;
        }
        frequencies
    };

    /// The slot of each element of the rows, and whether it holds its conjugate.
    const SLOTS: [([usize; Q], [bool; Q]); ROWS] = {
        let mut slots = [([0; Q], [false; Q]); ROWS];
        let mut i = 0;
        while i < ROWS * Q {
            let k = Self::FREQUENCIES[i / Q][i % Q];
            let conjugate = IN_ORDER && 2 * k > P * Q;
            slots[i / Q].0[i % Q] = match (IN_ORDER, conjugate) {
                (false, _) => i,
                (_, true) => P * Q - k,
                (_, false) => k,
            };
            slots[i / Q].1[i % Q] = conjugate;
            i += 1;
        }
        slots
    };

    /// Whether row 0 stays in registers: with more rows there are none left for it.
    const IN_REGISTERS: bool = ROWS <= 2;

    /// The line from point `first` of `image` on, to `spectrum[position]`, `spectrum[position + pitch]`, ...
    #[inline(always)]
    pub(crate) fn forward<V: Vector, X: Stored<Real = V::Element>>(
        image: Tile<'_, X>,
        first: usize,
        spectrum: &mut [Complex<V>],
        position: usize,
        pitch: usize,
        work: &mut [Complex<V>],
    ) {
        let (first_row, work) = work[..ROWS * Q].split_first_chunk_mut().expect("a row");
        let mut registers = [Complex::zero(); Q];
        let zeroth = if Self::IN_REGISTERS { &mut registers } else { first_row };
        unroll!(q in 0..Q {
            let column = image.gather_at::<V, P>(first, Self::POINTS[q], Self::LENGTH);
            let rows = <Codelet as RealDft<P, ROWS>>::real_dft(column);
            if Q == 1 {
                for row in 0..ROWS {
                    Self::put(spectrum, position, pitch, row, [rows[row]; Q]);
                }
                return;
            }
            zeroth[q] = rows[0];
            for row in 1..ROWS {
                work[(row - 1) * Q + q] = rows[row];
            }
        });
        Self::put(spectrum, position, pitch, 0, <Codelet as TwoReal<Q>>::two_real_dft(*zeroth));
        unroll!(row in 1..ROWS {
            let mut line = gather::<_, Q>(work, (row - 1) * Q, 1);
            if !Self::COPRIME {
                for q in 1..Q {
                    line[q] = times_root::<V, TURN>(line[q], Self::turns(row, q));
                }
            }
            Self::put(spectrum, position, pitch, row, <Codelet as Dft<Q>>::dft(line));
        });
    }

    /// Undoes [`forward`](Self::forward) up to a factor `P Q`, for spectra that are doubled but for slot 0.
    #[inline(always)]
    pub(crate) fn inverse<V: Vector, X: Stored<Real = V::Element>>(
        spectrum: &[Complex<V>],
        position: usize,
        pitch: usize,
        image: &mut TileMut<'_, X>,
        first: usize,
        work: &mut [Complex<V>],
    ) {
        let (first_row, work) = work[..ROWS * Q].split_first_chunk_mut().expect("a row");
        let mut registers = [Complex::zero(); Q];
        let zeroth = if Self::IN_REGISTERS { &mut registers } else { first_row };
        if Q > 1 {
            unroll!(row in 1..ROWS {
                let line = Self::get(spectrum, position, pitch, row);
                let mut line = <Codelet as Dft<Q>>::idft(line);
                if !Self::COPRIME {
                    for q in 1..Q {
                        line[q] = times_root::<V, TURN>(line[q].swap(), Self::turns(row, q)).swap();
                    }
                }
                scatter(work, (row - 1) * Q, 1, line);
            });
            *zeroth = Self::get(spectrum, position, pitch, 0);
            *zeroth = <Codelet as TwoReal<Q>>::two_real_idft(*zeroth);
        }
        unroll!(q in 0..Q {
            let mut rows = [zeroth[q]; ROWS];
            for row in 0..ROWS {
                if Q == 1 {
                    rows[row] = Self::get(spectrum, position, pitch, row)[0];
                } else if row > 0 {
                    rows[row] = work[(row - 1) * Q + q];
                }
            }
            let column = <Codelet as RealDft<P, ROWS>>::real_idft(rows);
            image.scatter_at::<V, P>(first, Self::POINTS[q], Self::LENGTH, column);
        });
    }

    /// The twiddle of an element, in parts of a turn.
    #[inline(always)]
    const fn turns(row: usize, q: usize) -> usize {
        TURN / Self::LENGTH * q * <Codelet as RealDft<P, ROWS>>::FREQUENCIES[row]
    }

    /// Writes the elements of a row to their slots.
    #[inline(always)]
    fn put<V: Vector>(
        spectrum: &mut [Complex<V>],
        position: usize,
        pitch: usize,
        row: usize,
        mut z: [Complex<V>; Q],
    ) {
        let (slots, conjugate) = Self::SLOTS[row];
        for q in 0..Q {
            z[q] = if conjugate[q] { z[q].conj() } else { z[q] };
        }
        scatter_at(spectrum, position, slots, pitch, ROWS * Q, z);
    }

    /// Reads the elements of a row from their slots.
    #[inline(always)]
    fn get<V: Vector>(
        spectrum: &[Complex<V>],
        position: usize,
        pitch: usize,
        row: usize,
    ) -> [Complex<V>; Q] {
        let (slots, conjugate) = Self::SLOTS[row];
        let mut z = gather_at(spectrum, position, slots, pitch, ROWS * Q);
        for q in 0..Q {
            z[q] = if conjugate[q] { z[q].conj() } else { z[q] };
        }
        z
    }
}
