//! A weight of tokens in natural order to kernel order, and a gradient back, by squares of vectors.
//!
//! Kernel order: blocks of as many row frequencies as there are lanes, from 0 to `X / 2`; in each block a complex vector for
//! every column frequency of the full width, in the order of the transform along Y.

use ndarray::{ArrayView3, ArrayViewMut3};

use crate::fft::columns::order::Scales;
use crate::kernel::Factor;
use crate::simd::{Algorithm, Complex, Element, Isa, MAX_LANES, Tile, TileMut, Vector};

/// How the frequencies of one shape are ordered and scaled.
pub(crate) struct SquareOrder<T> {
    points: usize,
    /// The place of each column frequency.
    outputs: Vec<usize>,
    blocks: usize,
    /// Factors on the weight, and on its gradient.
    scales: Scales<T>,
}

impl<T: Element> SquareOrder<T> {
    /// For spectra that come doubled.
    pub(crate) fn new(points: usize, outputs: Vec<usize>, lanes: usize) -> Self {
        let norm = 1.0 / (points * outputs.len()) as f64;
        Self {
            points,
            blocks: (points / 2 + 1).div_ceil(lanes),
            outputs,
            scales: Scales { hermitian: T::nearest(norm / 4.0), plain: T::nearest(norm / 2.0) },
        }
    }

    /// A factor made of `weight` `(X, Y/2+1, 2)` to `packed`.
    pub(crate) fn pack(
        &self,
        isa: Isa,
        weight: ArrayView3<'_, T>,
        factor: Factor,
        packed: &mut [T],
    ) {
        isa.run(PackSquares { order: self, weight: Tile::of_complex(weight), factor, packed });
    }

    /// `sum`, packed, to `gradient` `(X, Y/2+1, 2)`.
    pub(crate) fn unpack(&self, isa: Isa, sum: &[T], gradient: ArrayViewMut3<'_, T>) {
        isa.run(UnpackSquares { order: self, sum, gradient: TileMut::of_complex(gradient) });
    }

    /// Whether the mirrored column frequency is the same.
    fn is_hermitian(&self, v: usize) -> bool {
        v == 0 || 2 * v == self.outputs.len()
    }

    /// Row frequency of a lane, that of the last row for lanes without one, and its mirror.
    fn row(&self, row: usize) -> (usize, usize) {
        let u = row.min(self.points / 2);
        (u, (self.points - u) % self.points)
    }
}

/// Complex numbers of as many rows as there are lanes.
#[derive(Clone, Copy)]
struct Square<V> {
    re: [V; MAX_LANES],
    im: [V; MAX_LANES],
}

impl<V: Vector> Square<V> {
    #[inline(always)]
    fn new() -> Self {
        let zero = Complex::<V>::zero().re;
        Self { re: [zero; MAX_LANES], im: [zero; MAX_LANES] }
    }

    #[inline(always)]
    fn get(&self, i: usize) -> Complex<V> {
        Complex::new(self.re[i], self.im[i])
    }

    #[inline(always)]
    fn set(&mut self, i: usize, z: Complex<V>) {
        (self.re[i], self.im[i]) = (z.re, z.im);
    }

    #[inline(always)]
    fn transpose(&mut self) {
        V::transpose(&mut self.re[..V::LANES]);
        V::transpose(&mut self.im[..V::LANES]);
    }

    #[inline(always)]
    fn conjugate(&mut self) {
        for im in &mut self.im[..V::LANES] {
            *im = -*im;
        }
    }
}

struct PackSquares<'a, T> {
    order: &'a SquareOrder<T>,
    weight: Tile<'a, T>,
    factor: Factor,
    packed: &'a mut [T],
}

impl<T: Element> Algorithm<T> for PackSquares<'_, T> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let SquareOrder { outputs, blocks, scales, .. } = self.order;
        let (hermitian, plain) = (V::splat(scales.hermitian), V::splat(scales.plain));
        let (width, mut packed) = (outputs.len(), TileMut::dense(self.packed, V::LANES));
        let (mut square, mut mirror) = (Square::<V>::new(), Square::<V>::new());
        for block in 0..*blocks {
            for start in (0..=width / 2).step_by(V::LANES) {
                for lane in 0..V::LANES {
                    let (u, minus_u) = self.order.row(block * V::LANES + lane);
                    square.set(lane, self.weight.complex_from(u, start));
                    mirror.set(lane, self.weight.complex_from(minus_u, start));
                }
                square.transpose();
                mirror.transpose();
                if self.factor == Factor::Conjugate {
                    square.conjugate();
                    mirror.conjugate();
                }
                for (i, v) in (start..(start + V::LANES).min(width / 2 + 1)).enumerate() {
                    let (z, mirror) = (square.get(i), mirror.get(i).conj());
                    let place = 2 * (block * width + outputs[v]);
                    if self.order.is_hermitian(v) {
                        let z = (z + mirror).scale(hermitian);
                        packed.scatter(place, 1, [z.re, z.im]);
                    } else {
                        let (z, mirror) = (z.scale(plain), mirror.scale(plain));
                        packed.scatter(place, 1, [z.re, z.im]);
                        let place = 2 * (block * width + outputs[width - v]);
                        packed.scatter(place, 1, [mirror.re, mirror.im]);
                    }
                }
            }
        }
    }
}

struct UnpackSquares<'a, T> {
    order: &'a SquareOrder<T>,
    sum: &'a [T],
    gradient: TileMut<'a, T>,
}

impl<T: Element> Algorithm<T> for UnpackSquares<'_, T> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(mut self) {
        let SquareOrder { outputs, blocks, scales, points, .. } = self.order;
        let (hermitian, plain) = (V::splat(scales.hermitian), V::splat(scales.plain));
        let (width, sum) = (outputs.len(), Tile::dense(self.sum, V::LANES));
        let (mut square, mut mirror) = (Square::<V>::new(), Square::<V>::new());
        for block in 0..*blocks {
            for start in (0..=width / 2).step_by(V::LANES) {
                for (i, v) in (start..(start + V::LANES).min(width / 2 + 1)).enumerate() {
                    let scale = if self.order.is_hermitian(v) { hermitian } else { plain };
                    let [re, im] = sum.gather(2 * (block * width + outputs[v]), 1);
                    square.set(i, Complex::new(re, im).scale(scale));
                    let [re, im] =
                        sum.gather(2 * (block * width + outputs[(width - v) % width]), 1);
                    mirror.set(i, Complex::new(re, im).conj().scale(scale));
                }
                square.transpose();
                mirror.transpose();
                for lane in 0..V::LANES.min(points / 2 + 1 - block * V::LANES) {
                    let (u, minus_u) = self.order.row(block * V::LANES + lane);
                    self.gradient.set_complex_from(minus_u, start, mirror.get(lane));
                    self.gradient.set_complex_from(u, start, square.get(lane));
                }
            }
        }
    }
}
