//! Every number that was found by measurement, and where it was found.
//!
//! Machines: *Xeon*, two cores of an Intel server with AVX-512 and 2 MB of L2 cache a core; *Zen 4* and *Zen 5*, AMD's with
//! 1 MB. Where none is named it is the Xeon. What plans and pieces follow from is a `Tuning`, which a test may choose; constants
//! are compiled into kernels.

use std::sync::LazyLock;

use crate::simd::{LINE_BYTES, fetches_ahead, l2_cache};

/// Elements of work below which another of a pool's waiting threads costs more than it brings: an empty call of two takes 1.4
/// microseconds.
pub const WORTH_A_THREAD: usize = 1 << 14;

/// The same of threads that a call starts: about 20 microseconds each.
pub(crate) const WORTH_A_NEW_THREAD: usize = 1 << 17;

/// Bytes of scratch that a process keeps for its next calls: page faults would cost more than the filter.
pub const SCRATCH_KEPT: usize = 64 << 20;

/// The same for each core of a process that uses all of them: what one call takes there.
pub const SCRATCH_KEPT_FOR_A_CORE: usize = 4 << 20;

/// Bytes of the plans that a process keeps for its next calls, by an upper estimate of each: that of a plane of 2880×2880.
pub const PLANS_KEPT: usize = 256 << 20;

/// The same of each thread, which finds these without a lock.
pub(crate) const PLANS_KEPT_BY_A_THREAD: usize = 16 << 20;

/// Points ahead of the work, counted along a grid, that are at least prefetched.
pub(crate) const GRID_AHEAD: usize = 28;

/// The same along a sequence.
pub(crate) const SEQUENCE_AHEAD: usize = 16;

/// Places ahead of the work whose weight is prefetched.
pub(crate) const PLACES_AHEAD: usize = 16;

/// Most vectors of a tile of sequences: points at a distance of a power of two meet in the same few sets of the cache, the less
/// the longer the run of memory is that is taken from each. On Zen 5 two took 1.4 times as long at 512 channels.
pub(crate) const SEQUENCE_VECTORS: usize = 4;

/// Bytes of an L1 cache. Where the lines of half a tile fit and those of all of it do not, the half took 0.9 of the time.
pub(crate) const L1_CACHE: usize = 1 << 15;

/// Points of an image of several channels that are copied before those of the next: their lines stay in the L1 cache.
pub(crate) const COPIED_POINTS: usize = 64;

/// Points of a row of many channels that are copied to the rows of its lanes together: their lines meet in the same few sets of the cache.
pub(crate) const GATHERED_POINTS: usize = 8;

/// The largest primes `p` that are transformed from the definition: where `p - 1` has codelets, and where not. Of the first a convolution
/// takes three quarters of the time at 41 and 61, and longer than the definition up to 37; of the others 1.4 times as long at 59.
pub(crate) const DEFINED_PRIMES: [usize; 2] = [37, 61];

/// Bytes of a column's line, and of the lines of a row's lanes, up to which squares of vectors are transposed between them: beyond a
/// cache, lines along memory are faster.
pub(crate) const LONGEST_LINE: usize = 1 << 20;

/// Numbers of a gradient's sum that one member of a team adds up at a time.
pub(crate) const ADDED_TOGETHER: usize = 1 << 12;

/// `[5, 2]`: one codelet is all of the transform along X up to 5 X = 2 Y. On Zen 4 28×64 and 48×64 took 0.95 to 1.25 of the time of
/// squares of vectors, 28×128 and 48×128 0.77 to 0.99, longer rows less.
pub(crate) const CODELET_ROWS: [usize; 2] = [5, 2];

/// Bytes of images of tokens, as they are computed with, that a thread takes through a pass together. On Zen 4, 32 images of 8×64 took
/// 0.9 of the time that they took one by one.
pub(crate) const TOKENS_AT_ONCE: usize = 1 << 14;

/// Points of a sequence of one channel from which on each goes by itself, if it has codelets as tokens. On Zen 4 one of 256 points took
/// 0.17 of the time of a vector of them, 32 of them 1.3; of 1024 points 0.06 and 0.84.
pub(crate) const LONG_SEQUENCE: usize = 1 << 8;

/// What plans and pieces follow from.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tuning {
    /// Bytes of the L2 cache of a core.
    pub(crate) l2_cache: usize,
    /// Whether the hardware prefetcher brings what the L3 cache has, as Intel's do.
    pub(crate) fetches_ahead: bool,

    /// Bytes of the lanes of a grid's narrow tile, as they are computed with. Neighboring lines of an image soon after each other
    /// are what memory is quick at; alone, lines at a distance of a power of two meet in the same few sets of the cache.
    pub(crate) narrow_tile: usize,
    /// The same of the widest tile.
    pub(crate) widest_tile: usize,
    /// What part of the L2 cache the packed weight of a tile wider than a narrow one takes at most.
    pub(crate) packed_share: usize,
    /// Bytes of a grid's spectrum up to which lanes of a tile go together: about what an L2 cache holds. Several images come from
    /// memory, which is quicker at longer runs.
    pub(crate) spectra: usize,
    /// Bytes of the L2 cache that one image alone, likely to be there, leaves to what streams through beside its spectrum.
    pub(crate) streamed: usize,
    /// What the spectrum of one image alone has at least.
    pub(crate) least_spectra: usize,

    /// Images of at most this part of the L2 cache are small.
    pub(crate) small_share: usize,
    /// L2 caches up to which small images, and others, with their results and what else is as large, the hardware prefetcher
    /// brings. Prefetching by software too cost the Xeon up to 25 %, not doing so beyond up to 40 %, or 60 % where images are not
    /// small. On Zen 5 not doing so cost half as much again.
    pub(crate) small_prefetched: usize,
    pub(crate) prefetched: usize,

    /// Points of a plane, for each channel, up to which images of few channels are filtered several together. One alone takes as
    /// long as all of them: of sequences of up to these lengths a batch of 32 took a third to a fifth of the time of rustfft
    /// along the lines, a single one of the longest twice as long. ([`LONG_SEQUENCE`] is for those of one channel with codelets.)
    pub(crate) batched_plane: usize,
    /// The same of sequences and tokens.
    pub(crate) batched_sequence: usize,

    /// Pieces for each thread from which on no narrower ones are worth making.
    pub(crate) pieces_each: usize,

    /// Pieces in which gradients are summed, as far as there are images for them. This and the next three decide the order of
    /// sums, so that they must not follow from the machine.
    pub(crate) sum_pieces: usize,
    /// The most parts of a sum: each has memory of its own.
    pub(crate) most_sum_parts: usize,
    /// Images that a part of a sum has at least: adding the part takes about a fifth of the time of one.
    pub(crate) sum_images: usize,
    /// Lanes of a grid that are summed apart from each other in any case.
    pub(crate) sum_lanes: usize,
}

static OF_MACHINE: LazyLock<Tuning> = LazyLock::new(|| Tuning {
    l2_cache: l2_cache(),
    fetches_ahead: fetches_ahead(),
    narrow_tile: 8 * LINE_BYTES,
    widest_tile: 32 * LINE_BYTES,
    packed_share: 8,
    spectra: 1 << 20,
    streamed: 3 << 18,
    least_spectra: 1 << 18,
    small_share: 8,
    small_prefetched: 8,
    prefetched: 3,
    batched_plane: 1 << 10,
    batched_sequence: 1 << 12,
    pieces_each: 8,
    sum_pieces: 64,
    most_sum_parts: 8,
    sum_images: 4,
    sum_lanes: 16,
});

impl Tuning {
    /// That of the machine that this runs on.
    pub(crate) fn of_machine() -> &'static Self {
        &OF_MACHINE
    }

    /// Whether images, each of `each` bytes, come to the L2 cache by the hardware prefetcher; with their results and what else is
    /// as large they are `bytes`.
    pub(crate) fn are_prefetched(&self, bytes: usize, each: usize) -> bool {
        let is_small = each <= self.l2_cache / self.small_share;
        let caches = if is_small { self.small_prefetched } else { self.prefetched };
        self.fetches_ahead && bytes <= caches * self.l2_cache
    }

    /// Whether the hardware prefetcher brings one image alone to the L2 cache; with its result and its weight it is `bytes`. On Zen 5
    /// it does up to ten L2 caches, which is as far as was measured: software prefetch took up to 1.4 times as long.
    pub(crate) fn is_prefetched(&self, bytes: usize) -> bool {
        !self.fetches_ahead || bytes <= self.prefetched * self.l2_cache
    }

    /// This one for as long as the program runs, as plans want it.
    #[cfg(test)]
    pub(crate) fn kept(self) -> &'static Self {
        Box::leak(Box::new(self))
    }
}
