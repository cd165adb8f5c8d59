//! Real lines of length `P Q` to half spectra and back: `P` across, then the rows that this leaves.
//!
//! `P` even, `Q` coprime to it: no twiddles (Good–Thomas). Both powers of two: twiddles between (Cooley–Tukey). The real DFTs across
//! leave `P / 2` rows of `Q`: row 0 is two real lines, the others are complex. Slot `s Q + k` of the spectrum is frequency `k` of
//! row `s`, with row 0 as [`TwoReal`] has it.

use crate::fft::codelets::{Codelet, Dft, RealDft, TwoReal, times_root, unroll};
use crate::fft::transform::remainders;
use crate::simd::{Complex, Stored, Tile, TileMut, Vector, gather, scatter};

/// A line of `P Q`; `ROWS` is `P / 2`.
pub(crate) struct CompositeRow<const P: usize, const Q: usize, const ROWS: usize>;

impl<const P: usize, const Q: usize, const ROWS: usize> CompositeRow<P, Q, ROWS>
where
    Codelet: RealDft<P, ROWS> + TwoReal<Q> + Dft<Q>,
{
    const LENGTH: usize = P * Q;
    const COPRIME: bool = Q % 2 == 1;
    /// The frequency modulo `P` of each row.
    const ACROSS: [usize; ROWS] = <Codelet as RealDft<P, ROWS>>::FREQUENCIES;

    /// The frequency of each slot.
    pub(crate) fn frequencies() -> Vec<usize> {
        let coprime = Self::COPRIME.then(|| remainders(P, Q));
        let join = |p, q| coprime.as_ref().map_or(p + P * q, |join| join(p, q));
        let zeroth = <Codelet as TwoReal<Q>>::FREQUENCIES;
        let zeroth = zeroth.into_iter().map(|(line, q)| join(line * P / 2, q));
        zeroth
            .chain(Self::ACROSS[1..].iter().flat_map(|&p| (0..Q).map(move |q| join(p, q))))
            .collect()
    }

    /// Where element `p` of column `q` is on the line.
    #[inline(always)]
    fn column(q: usize) -> [usize; P] {
        let mut points = [0; P];
        for (p, point) in points.iter_mut().enumerate() {
            *point = if Self::COPRIME { (Q * p + P * q) % Self::LENGTH } else { Q * p + q };
        }
        points
    }

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
            let column = image.gather_at::<V, P>(first, Self::column(q), Self::LENGTH);
            let rows = <Codelet as RealDft<P, ROWS>>::real_dft(column);
            zeroth[q] = rows[0];
            for row in 1..ROWS {
                work[(row - 1) * Q + q] = rows[row];
            }
        });
        scatter(spectrum, position, pitch, <Codelet as TwoReal<Q>>::two_real_dft(*zeroth));
        unroll!(row in 1..ROWS {
            let mut line = gather::<_, Q>(work, (row - 1) * Q, 1);
            if !Self::COPRIME {
                for q in 1..Q {
                    line[q] = times_root::<V, 64>(line[q], 64 / Self::LENGTH * q * Self::ACROSS[row]);
                }
            }
            scatter(spectrum, position + row * Q * pitch, pitch, <Codelet as Dft<Q>>::dft(line));
        });
    }

    /// Undoes [`forward`](Self::forward) up to a factor `P Q`, for spectra whose slots after the first are doubled.
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
        unroll!(row in 1..ROWS {
            let mut line = <Codelet as Dft<Q>>::idft(gather(spectrum, position + row * Q * pitch, pitch));
            if !Self::COPRIME {
                for q in 1..Q {
                    let turns = 64 / Self::LENGTH * q * Self::ACROSS[row];
                    line[q] = times_root::<V, 64>(line[q].swap(), turns).swap();
                }
            }
            scatter(work, (row - 1) * Q, 1, line);
        });
        *zeroth = <Codelet as TwoReal<Q>>::two_real_idft(gather(spectrum, position, pitch));
        unroll!(q in 0..Q {
            let mut rows = [zeroth[q]; ROWS];
            for row in 1..ROWS {
                rows[row] = work[(row - 1) * Q + q];
            }
            let column = <Codelet as RealDft<P, ROWS>>::real_idft(rows);
            image.scatter_at::<V, P>(first, Self::column(q), Self::LENGTH, column);
        });
    }
}
