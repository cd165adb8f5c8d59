//! Copies between runs of few elements and longer ones.

use bytemuck::Pod;

use crate::simd::{Algorithm, Element, MAX_LANES, Stored, Tile, TileMut, Vector};

/// Runs `$run` with the constant `$c` equal to `$channels`, fewer than a vector has lanes: a copy of so many is few instructions.
macro_rules! with_channels {
    ($channels:expr, $c:ident => $run:expr) => {
        with_channels!(@ $channels, $c, $run, 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15)
    };
    (@ $channels:expr, $c:ident, $run:expr, $($of:literal)*) => {
        match $channels {
            $($of => {
                const $c: usize = $of;
                $run
            })*
            channels => unreachable!("{channels} channels are no fewer than lanes"),
        }
    };
}

/// Copies `image` `(points, channels)` to `stage` `(points, lanes)`, from lane `first` on.
pub(in crate::fft) fn spread<E: Copy>(
    channels: usize,
    image: &[E],
    stage: &mut [E],
    lanes: usize,
    first: usize,
) {
    with_channels!(channels, C => {
        assert!(first + C <= lanes); // once, and not for each point
        for (from, to) in image.as_chunks::<C>().0.iter().zip(stage.chunks_exact_mut(lanes)) {
            to[first..][..C].copy_from_slice(from);
        }
    });
}

/// Undoes [`spread`].
pub(in crate::fft) fn collect<E: Copy>(
    channels: usize,
    stage: &[E],
    lanes: usize,
    first: usize,
    image: &mut [E],
) {
    with_channels!(channels, C => {
        assert!(first + C <= lanes); // once, and not for each point
        for (to, from) in image.as_chunks_mut::<C>().0.iter_mut().zip(stage.chunks_exact(lanes)) {
            to.copy_from_slice(&from[first..][..C]);
        }
    });
}

/// Copies `image` `(points, channels)` as often as it fits to each of the runs of `lanes` that `stage` is; what is left is zero.
pub(super) fn repeat<E: Pod>(channels: usize, image: &[E], stage: &mut [E], lanes: usize) {
    with_channels!(channels, C => {
        for (from, to) in image.as_chunks::<C>().0.iter().zip(stage.chunks_exact_mut(lanes)) {
            let (copies, rest) = to.as_chunks_mut::<C>();
            copies.fill(*from);
            rest.fill(E::zeroed());
        }
    });
}

/// Adds what [`repeat`] would have made of `image`, in this order: complex numbers.
pub(super) fn fold<T: Element>(
    channels: usize,
    stage: &[[T; 2]],
    lanes: usize,
    image: &mut [[T; 2]],
) {
    with_channels!(channels, C => {
        for (to, from) in image.as_chunks_mut::<C>().0.iter_mut().zip(stage.chunks_exact(lanes)) {
            let copies = from.as_chunks::<C>().0;
            *to = copies[0];
            for copy in &copies[1..] {
                for (sum, term) in to.iter_mut().zip(copy) {
                    *sum = [sum[0] + term[0], sum[1] + term[1]];
                }
            }
        }
    });
}

/// Line `i` of `lines` to lane `i` of `stage`, as far as whole squares go; lanes without a line become zero.
pub(super) struct Transpose<'a, X> {
    pub(super) lines: Tile<'a, X>,
    pub(super) stage: TileMut<'a, X>,
}

impl<X: Stored> Algorithm<X::Real> for Transpose<'_, X> {
    #[inline(always)]
    fn run<V: Vector<Element = X::Real>>(mut self) {
        let count = self.lines.points();
        for first in (0..=self.lines.lanes() - V::LANES).step_by(V::LANES) {
            let mut square = [V::splat(X::Real::default()); MAX_LANES];
            let lines = self.lines.skip_lanes(first);
            for i in 0..V::LANES {
                if i < count {
                    [square[i]] = lines.gather(i, 1);
                }
            }
            V::transpose(&mut square[..V::LANES]);
            for i in 0..V::LANES {
                self.stage.scatter(first + i, 1, [square[i]]);
            }
        }
    }
}

/// Undoes [`Transpose`].
pub(super) struct TransposeBack<'a, X> {
    pub(super) stage: Tile<'a, X>,
    pub(super) lines: TileMut<'a, X>,
}

impl<X: Stored> Algorithm<X::Real> for TransposeBack<'_, X> {
    #[inline(always)]
    fn run<V: Vector<Element = X::Real>>(mut self) {
        let (count, len) = (self.lines.reader().points(), self.lines.reader().lanes());
        for first in (0..=len - V::LANES).step_by(V::LANES) {
            let mut square = [V::splat(X::Real::default()); MAX_LANES];
            for i in 0..V::LANES {
                [square[i]] = self.stage.gather(first + i, 1);
            }
            V::transpose(&mut square[..V::LANES]);
            let mut lines = self.lines.skip_lanes(first);
            for i in 0..V::LANES {
                if i < count {
                    lines.scatter(i, 1, [square[i]]);
                }
            }
        }
    }
}
