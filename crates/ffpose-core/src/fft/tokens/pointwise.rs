//! What is done to the spectrum of a group between its transforms.

use super::blocks::Block;
use super::groups::{Group, GroupPointwise, HALVES, split_rows, transposed};
use super::weight::{GroupWeight, NaturalWeight};
use crate::fft::codelets::{Codelet, TurnedDft, unroll};
use crate::simd::{Complex, Element, Vector, complex_vectors};

/// The product with a weight, or with its conjugate.
pub(super) struct GroupProduct<'a, T, const CONJUGATE: bool>(pub(super) NaturalWeight<'a, T>);

impl<'a, T: Element, const CONJUGATE: bool> GroupPointwise<T> for GroupProduct<'a, T, CONJUGATE> {
    const INVERSE: bool = true;
    type Ready<const RUN: usize, const J: usize> = GroupWeight<'a, T, RUN, J>;

    #[inline(always)]
    fn enter<V: Vector<Element = T>, const RUN: usize, const J: usize>(
        &mut self,
        group: Group<'_, V, RUN, J>,
    ) -> Self::Ready<RUN, J> {
        self.0.group::<V, RUN, J>(group.runs)
    }

    #[inline(always)]
    fn apply<V: Vector<Element = T>, const RUN: usize, const J: usize>(
        &mut self,
        ready: &Self::Ready<RUN, J>,
        _: Group<'_, V, RUN, J>,
        p: usize,
        mut z: [Complex<V>; J],
    ) -> [Complex<V>; J]
    where
        Codelet: TurnedDft<J>,
    {
        unroll!(c in 0..J {
            z[c] = ready.times::<V, CONJUGATE>(HALVES * c + p, z[c]);
        });
        z
    }
}

/// `sum += conj(x) · z` with the spectrum of the block `x`, which is spent; `z` is passed on.
pub(super) struct GroupAccumulate<'a, T> {
    pub(super) x: Block<'a, T>,
    pub(super) sum: &'a mut [T],
}

impl<T: Element> GroupPointwise<T> for GroupAccumulate<'_, T> {
    const INVERSE: bool = false;
    type Ready<const RUN: usize, const J: usize> = ();

    #[inline(always)]
    fn begin<V: Vector<Element = T>>(&mut self, rows: &[usize]) {
        split_rows::<V>(complex_vectors(self.x.vectors), self.x.pitch, rows);
    }

    #[inline(always)]
    fn enter<V: Vector<Element = T>, const RUN: usize, const J: usize>(
        &mut self,
        group: Group<'_, V, RUN, J>,
    ) -> Self::Ready<RUN, J> {
        let _: &mut [[_; HALVES]; J] = group.part_mut(complex_vectors::<V>(self.sum));
        let x = complex_vectors::<V>(self.x.vectors);
        group.check(x);
        let halves = group.halves_of(x);
        unroll!(p in 0..HALVES {
            unroll!(r in 0..J {
                *group.item_mut(x, p * J + r) = halves[p][r];
            });
        });
    }

    #[inline(always)]
    fn apply<V: Vector<Element = T>, const RUN: usize, const J: usize>(
        &mut self,
        (): &Self::Ready<RUN, J>,
        group: Group<'_, V, RUN, J>,
        p: usize,
        z: [Complex<V>; J],
    ) -> [Complex<V>; J]
    where
        Codelet: TurnedDft<J>,
    {
        let block = complex_vectors::<V>(self.x.vectors);
        let mut x = z;
        for r in 0..J {
            x[r] = *group.item(block, p * J + r);
        }
        let x = Codelet::turned_dft(transposed(x), group.factors[p]);
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
impl<T: Element, A: GroupPointwise<T>, B: GroupPointwise<T>> GroupPointwise<T> for (A, B) {
    const INVERSE: bool = A::INVERSE || B::INVERSE;
    type Ready<const RUN: usize, const J: usize> = (A::Ready<RUN, J>, B::Ready<RUN, J>);

    #[inline(always)]
    fn begin<V: Vector<Element = T>>(&mut self, rows: &[usize]) {
        self.0.begin::<V>(rows);
        self.1.begin::<V>(rows);
    }

    #[inline(always)]
    fn enter<V: Vector<Element = T>, const RUN: usize, const J: usize>(
        &mut self,
        group: Group<'_, V, RUN, J>,
    ) -> Self::Ready<RUN, J> {
        (self.0.enter(group), self.1.enter(group))
    }

    #[inline(always)]
    fn apply<V: Vector<Element = T>, const RUN: usize, const J: usize>(
        &mut self,
        ready: &Self::Ready<RUN, J>,
        group: Group<'_, V, RUN, J>,
        p: usize,
        z: [Complex<V>; J],
    ) -> [Complex<V>; J]
    where
        Codelet: TurnedDft<J>,
    {
        let z = self.0.apply(&ready.0, group, p, z);
        self.1.apply(&ready.1, group, p, z)
    }
}
