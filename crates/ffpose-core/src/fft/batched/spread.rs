//! Copies between runs of few elements and longer ones.

use bytemuck::Pod;

use crate::simd::Element;

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
pub(super) fn spread<E: Copy>(
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
pub(super) fn collect<E: Copy>(
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
