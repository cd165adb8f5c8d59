//! The transforms across the phases, `L` points each, with what is done with the spectrum in between.
//!
//! As many frequencies of the phases' lines as there are phases go together, as places: there a lane is a place of a channel, and
//! each vector a phase.

use super::Polyphase;
use crate::fft::codelets::pair::{join, merge, split, unmerge};
use crate::fft::codelets::{Codelet, Dft, unroll};
use crate::simd::{
    Algorithm, Complex, Element, Vector, complex_vectors, complex_vectors_of, joined, parts,
};

/// What is done with the spectrum.
pub(super) enum Spectrum<'a, T> {
    /// It is kept, and the line is lost.
    Kept(&'a mut [T]),
    /// It is multiplied by a packed factor.
    Product(&'a [T]),
    /// `conj(x)` times it is added to a sum; then it is multiplied by a packed factor, or the line is lost.
    Gradient { x: &'a [T], sum: &'a mut [T], factor: Option<&'a [T]> },
}

/// [`Spectrum`] for the spectrum of `line`, and the inverse.
pub(super) struct Across<'a, T, const L: usize> {
    pub(super) plan: &'a Polyphase<T>,
    pub(super) line: &'a mut [T],
    pub(super) spectrum: Spectrum<'a, T>,
}

impl<T: Element, const L: usize> Algorithm<T> for Across<'_, T, L>
where
    Codelet: Dft<L>,
{
    #[inline(always)]
    fn run<V: Vector<Element = T>>(mut self) {
        assert!(L <= V::LANES); // as planned; the compiler then makes no code for more
        let Polyphase { transform, turns, twiddles, .. } = self.plan;
        let outputs = transform.outputs();
        let line = complex_vectors::<V>(self.line);
        let (twiddles, pairs) = (complex_vectors_of::<V>(twiddles.numbers()), L / 2);
        for group in 0..turns.len().div_ceil(pairs) {
            let mut z = [Complex::zero(); L];
            for i in 0..pairs {
                let k = (group * pairs + i).min(turns.len() - 1);
                let pair = split(line[outputs[k]], line[outputs[opposite(k, outputs.len())]]);
                [z[i], z[i + pairs]] = merge(pair, turns[k].splat());
            }
            to_phases(&mut z);
            let twiddles = &twiddles[group * (L - 1)..][..L - 1];
            for l in 1..L {
                z[l] = z[l].times(twiddles[l - 1]);
            }
            let Some(z) = self.spectrum.apply(group * L, Codelet::dft(z)) else { continue };
            let mut z = Codelet::idft(z);
            for l in 1..L {
                z[l] = z[l].times_conj(twiddles[l - 1]);
            }
            to_places(&mut z);
            for i in 0..pairs {
                let k = (group * pairs + i).min(turns.len() - 1);
                let (z, opposed) = join(unmerge([z[i], z[i + pairs]], turns[k].splat()));
                line[outputs[k]] = z;
                line[outputs[opposite(k, outputs.len())]] = opposed;
            }
        }
    }
}

/// From a vector of lanes `[phase][slot]` for each place a vector of lanes `[slot][place]` for each phase. To interleave two
/// vectors exchanges the highest digit of a lane's number for that of the vector, which becomes the lane's lowest.
#[inline(always)]
fn to_phases<V: Vector, const L: usize>(z: &mut [Complex<V>; L]) {
    if L == V::LANES {
        return transpose(z);
    }
    interleave::<_, 8, L>(z);
    interleave::<_, 4, L>(z);
    interleave::<_, 2, L>(z);
    interleave::<_, 1, L>(z);
}

/// Undoes [`to_phases`].
#[inline(always)]
fn to_places<V: Vector, const L: usize>(z: &mut [Complex<V>; L]) {
    if L == V::LANES {
        return transpose(z);
    }
    deinterleave::<_, 1, L>(z);
    deinterleave::<_, 2, L>(z);
    deinterleave::<_, 4, L>(z);
    deinterleave::<_, 8, L>(z);
}

#[inline(always)]
fn transpose<V: Vector, const L: usize>(z: &mut [Complex<V>; L]) {
    let (mut re, mut im) = parts(*z);
    V::transpose(&mut re);
    V::transpose(&mut im);
    *z = joined(re, im);
}

/// Interleaves vectors whose numbers differ in one digit, which is worth `DIGIT`.
#[inline(always)]
fn interleave<V: Vector, const DIGIT: usize, const L: usize>(z: &mut [Complex<V>; L]) {
    unroll!(i in 0..L {
        if i & DIGIT == 0 && i + DIGIT < L {
            let (a, b) = (z[i], z[i + DIGIT]);
            (z[i].re, z[i + DIGIT].re) = V::interleave(a.re, b.re);
            (z[i].im, z[i + DIGIT].im) = V::interleave(a.im, b.im);
        }
    });
}

/// Undoes [`interleave`].
#[inline(always)]
fn deinterleave<V: Vector, const DIGIT: usize, const L: usize>(z: &mut [Complex<V>; L]) {
    unroll!(i in 0..L {
        if i & DIGIT == 0 && i + DIGIT < L {
            let (a, b) = (z[i], z[i + DIGIT]);
            (z[i].re, z[i + DIGIT].re) = V::deinterleave(a.re, b.re);
            (z[i].im, z[i + DIGIT].im) = V::deinterleave(a.im, b.im);
        }
    });
}

/// The frequency `-k`, below `length`, of one below that.
#[inline(always)]
fn opposite(k: usize, length: usize) -> usize {
    if k == 0 { 0 } else { length - k }
}

impl<T: Element> Spectrum<'_, T> {
    /// The new values of `z`, complex vectors `first` and following of the spectrum, if they are wanted.
    #[inline(always)]
    fn apply<V: Vector<Element = T>, const L: usize>(
        &mut self,
        first: usize,
        mut z: [Complex<V>; L],
    ) -> Option<[Complex<V>; L]> {
        match self {
            Self::Kept(spectrum) => {
                complex_vectors::<V>(spectrum)[first..][..L].copy_from_slice(&z);
                None
            }
            Self::Product(factor) => {
                let factor = &complex_vectors_of::<V>(factor)[first..][..L];
                for l in 0..L {
                    z[l] = z[l].times(factor[l]);
                }
                Some(z)
            }
            Self::Gradient { x, sum, factor } => {
                let x = &complex_vectors_of::<V>(x)[first..][..L];
                let sum = &mut complex_vectors::<V>(sum)[first..][..L];
                for l in 0..L {
                    sum[l] = sum[l].plus_times_conj(z[l], x[l]);
                }
                let factor = &complex_vectors_of::<V>((*factor)?)[first..][..L];
                for l in 0..L {
                    z[l] = z[l].times(factor[l]);
                }
                Some(z)
            }
        }
    }
}
