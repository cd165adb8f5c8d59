//! Transforms along X, between an image and a block: one for each slot, of as many rows as a codelet is long.
//!
//! Rows of an image are slots, each the vector of its real and that of its imaginary parts.
//!
//! Where registers do not hold a column, all that the transforms across leave but the last waits in scratch: the compiler would
//! choose by itself what does, and keep more on the stack.
//!
//! Functions between a job and its codelet are always inlined: a processor waits where one has written the fields of an argument
//! one by one and the next reads two of them at once.

use std::hint::black_box;

use crate::fft::codelets::{Codelet, Dft, unroll, with_codelet};
use crate::simd::{
    Algorithm, Complex, Element, Isa, Tile, TileMut, Vector, complex_vectors, gather_at, scatter_at,
};

/// Rows of complex vectors in scratch, `pitch` apart.
pub(super) struct Block<'a, T> {
    pub(super) vectors: &'a mut [T],
    pub(super) pitch: usize,
}

/// Transforms all rows of `image` to the first rows of `block`; `work` has room for as many complex vectors as there are rows.
///
/// The inverse multiplies its input by the conjugate of `twiddles`, one for each row.
#[inline(always)]
pub(super) fn image_to_block<T: Element, const INVERSE: bool>(
    isa: Isa,
    image: Tile<'_, T>,
    twiddles: &[Complex<T>],
    block: Block<'_, T>,
    work: &mut [T],
) {
    with_codelet!(factor image.points(), (P, Q) => {
        isa.run(ImageToBlock::<T, P, Q, INVERSE> { image, twiddles, block, work });
    }, _ => unreachable!("planned lengths"));
}

/// Transforms the first rows of `block` to all rows of `image`; `work` as in [`image_to_block`].
///
/// The forward transform multiplies its output by `twiddles`, one for each row.
#[inline(always)]
pub(super) fn block_to_image<T: Element, const INVERSE: bool>(
    isa: Isa,
    block: Block<'_, T>,
    twiddles: &[Complex<T>],
    image: TileMut<'_, T>,
    work: &mut [T],
) {
    with_codelet!(factor image.reader().points(), (P, Q) => {
        isa.run(BlockToImage::<T, P, Q, INVERSE> { block, twiddles, image, work });
    }, _ => unreachable!("planned lengths"));
}

/// A DFT of length `P Q`, coprime: `P` across, then `Q`, without twiddles (Good–Thomas).
struct GoodThomas<const P: usize, const Q: usize>;

impl<const P: usize, const Q: usize> GoodThomas<P, Q>
where
    Codelet: Dft<P> + Dft<Q>,
{
    const LENGTH: usize = P * Q;

    /// The inputs of transform `q` across.
    const INPUTS: [[usize; P]; Q] = {
        let mut inputs = [[0; P]; Q];
        let mut n = 0;
        while n < P * Q {
            let (p, q) = (n / Q, n % Q);
            inputs[q][p] = (Q * p + P * q) % (P * Q);
            n += 1;
        }
        inputs
    };

    /// The outputs of transform `p` along `Q`.
    const OUTPUTS: [[usize; Q]; P] = {
        let mut outputs = [[0; Q]; P];
        let mut k = 0;
        while k < P * Q {
            outputs[k % P][k % Q] = k;
            k += 1;
        }
        outputs
    };
}

struct ImageToBlock<'a, T, const P: usize, const Q: usize, const INVERSE: bool> {
    image: Tile<'a, T>,
    twiddles: &'a [Complex<T>],
    block: Block<'a, T>,
    work: &'a mut [T],
}

impl<T, const P: usize, const Q: usize, const INVERSE: bool> ImageToBlock<'_, T, P, Q, INVERSE> {
    /// Whether registers do not hold a column.
    const WAITS: bool = Q > 2;
}

impl<T: Element, const P: usize, const Q: usize, const INVERSE: bool> Algorithm<T>
    for ImageToBlock<'_, T, P, Q, INVERSE>
where
    Codelet: Dft<P> + Dft<Q>,
{
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let Block { vectors, pitch } = self.block;
        let block = complex_vectors::<V>(vectors);
        let twiddles = self.twiddles;
        assert!(!INVERSE || twiddles.len() == P * Q);
        let work = &mut complex_vectors::<V>(self.work)[..P * Q];
        for slot in 0..self.image.lanes() / (2 * V::LANES) {
            let re = self.image.skip_lanes(2 * slot * V::LANES);
            let im = self.image.skip_lanes((2 * slot + 1) * V::LANES);
            let mut across = [[Complex::zero(); Q]; P];
            unroll!(q in 0..Q {
                let inputs = GoodThomas::<P, Q>::INPUTS[q];
                let re = re.gather_at::<V, P>(0, inputs, GoodThomas::<P, Q>::LENGTH);
                let im = im.gather_at::<V, P>(0, inputs, GoodThomas::<P, Q>::LENGTH);
                let mut z = [Complex::zero(); P];
                for p in 0..P {
                    z[p] = Complex::new(re[p], im[p]);
                    if INVERSE && inputs[p] > 0 {
                        z[p] = z[p].times_conj(twiddles[inputs[p]].splat());
                    }
                }
                let z = dft::<V, P, INVERSE>(z);
                for p in 0..P {
                    if Self::WAITS && q + 1 < Q {
                        work[Q * p + q] = z[p];
                    } else {
                        across[p][q] = z[p];
                    }
                }
            });
            let waiting = if Self::WAITS { black_box(&*work) } else { &*work };
            unroll!(p in 0..P {
                if Self::WAITS {
                    across[p][..Q - 1].copy_from_slice(&waiting[Q * p..][..Q - 1]);
                }
                let z = dft::<V, Q, INVERSE>(across[p]);
                scatter_at(block, slot, GoodThomas::<P, Q>::OUTPUTS[p], pitch, P * Q, z);
            });
        }
    }
}

struct BlockToImage<'a, T, const P: usize, const Q: usize, const INVERSE: bool> {
    block: Block<'a, T>,
    twiddles: &'a [Complex<T>],
    image: TileMut<'a, T>,
    work: &'a mut [T],
}

impl<T, const P: usize, const Q: usize, const INVERSE: bool> BlockToImage<'_, T, P, Q, INVERSE> {
    /// As in [`ImageToBlock`]; twiddles of the results take registers too.
    const WAITS: bool = if INVERSE { Q > 2 } else { Q > 1 };
}

impl<T: Element, const P: usize, const Q: usize, const INVERSE: bool> Algorithm<T>
    for BlockToImage<'_, T, P, Q, INVERSE>
where
    Codelet: Dft<P> + Dft<Q>,
{
    #[inline(always)]
    fn run<V: Vector<Element = T>>(mut self) {
        let Block { vectors, pitch } = self.block;
        let block = complex_vectors::<V>(vectors);
        let twiddles = self.twiddles;
        assert!(INVERSE || twiddles.len() == P * Q);
        let work = &mut complex_vectors::<V>(self.work)[..P * Q];
        for slot in 0..self.image.reader().lanes() / (2 * V::LANES) {
            let mut across = [[Complex::zero(); Q]; P];
            unroll!(q in 0..Q {
                let inputs = GoodThomas::<P, Q>::INPUTS[q];
                let z = dft::<V, P, INVERSE>(gather_at(block, slot, inputs, pitch, P * Q));
                for p in 0..P {
                    if Self::WAITS && q + 1 < Q {
                        work[Q * p + q] = z[p];
                    } else {
                        across[p][q] = z[p];
                    }
                }
            });
            let waiting = if Self::WAITS { black_box(&*work) } else { &*work };
            unroll!(p in 0..P {
                if Self::WAITS {
                    across[p][..Q - 1].copy_from_slice(&waiting[Q * p..][..Q - 1]);
                }
                let outputs = GoodThomas::<P, Q>::OUTPUTS[p];
                let z = dft::<V, Q, INVERSE>(across[p]);
                let (mut re, mut im) = ([z[0].re; Q], [z[0].im; Q]);
                for q in 0..Q {
                    let mut z = z[q];
                    if !INVERSE && outputs[q] > 0 {
                        z = z.times(twiddles[outputs[q]].splat());
                    }
                    (re[q], im[q]) = (z.re, z.im);
                }
                let mut image = self.image.skip_lanes(2 * slot * V::LANES);
                image.scatter_at(0, outputs, GoodThomas::<P, Q>::LENGTH, re);
                image.skip_lanes(V::LANES).scatter_at(0, outputs, GoodThomas::<P, Q>::LENGTH, im);
            });
        }
    }
}

#[inline(always)]
fn dft<V: Vector, const N: usize, const INVERSE: bool>(z: [Complex<V>; N]) -> [Complex<V>; N]
where
    Codelet: Dft<N>,
{
    if INVERSE { Codelet::idft(z) } else { Codelet::dft(z) }
}
