//! What a kernel offers and what it may rely on.
//!
//! The driver in [`crate::spectral`] sees both layouts as one picture, cuts it into tiles of lanes and ranges of
//! images, and gives a kernel one such piece at a time:
//!
//! - images are `(batch, points, lanes)`: grid, points = H·W and lanes = C; tokens, points = X and lanes = Y;
//! - weights are `(bins, lanes, 2)`: grid, bins = H·(W/2+1); tokens, `(X, Y/2+1, 2)`.
//!
//! In an image view the lanes are contiguous, batch and point strides are positive and otherwise arbitrary; an image of all
//! lanes, and a weight of all lanes, has no gaps. In a
//! weight view real and imaginary part are neighbors and the stride of the lanes is 2. No dimension is zero, and
//! weights, gradient sums and the team's scratches have exactly the lengths that the kernel asked for, and
//! begin where a vector may; the driver has seen to it.
//! A team has several members only where a call is one single piece, or all workers pack or unpack one weight together; results must
//! not depend on how many.

use std::ops::Range;

use ndarray::{ArrayView2, ArrayView3, ArrayViewMut2, ArrayViewMut3};

use crate::parallel::Team;
use crate::simd::Stored;

/// The transform of one [`crate::Shape`], planned once, for images of `X`.
///
/// Every image is treated by itself: its result does not depend on its neighbors, so that any split of a batch gives
/// the same bits.
pub(crate) trait Kernel<X: Stored>: Send + Sync {
    /// Most lanes of a view: the last tile may have fewer. In tokens the tile is all of Y, more than the one lane of a grid.
    fn tile(&self) -> usize;

    /// Least lanes of a view, but for the last tile: tiles are made of such, where wider ones would make too few pieces.
    fn narrowest_tile(&self) -> usize {
        self.tile()
    }

    /// Images that go through the transforms together: with fewer of them a piece takes as long.
    fn images_together(&self) -> usize {
        1
    }

    /// Numbers of scratch that each member of a team of so many needs, with any content; for packing and unpacking also where the
    /// team is larger.
    fn scratch_len(&self, members: usize) -> usize;

    /// How a weight is packed, unless the kernel reads it as it is, all of it.
    fn packing(&self) -> Option<&dyn Packing<X::Real>>;

    /// Numbers in the gradient sum of a tile of at most `lanes` lanes. That of a tile is those of its narrowest tiles, one after
    /// the other. It is as long as a packed weight, unless the kernel says otherwise.
    fn sum_len(&self, lanes: usize) -> usize {
        self.packing().map_or(0, |packing| packing.packed_len(lanes))
    }

    /// `y = irfft2(rfft2(x) · W)`, overwriting `y`.
    fn forward(
        &self,
        x: ArrayView3<'_, X>,
        weight: &[X::Real],
        y: ArrayViewMut3<'_, X>,
        team: &mut Team<'_, X::Real>,
    );

    /// The gradients that `pass` asks for.
    fn backward(&self, pass: Backward<'_, X>, team: &mut Team<'_, X::Real>);

    /// Brings a gradient sum to natural order, times `c_v / (rows · columns)`, overwriting `grad_weight`;
    /// `c_v` is 1 in the columns of DC and Nyquist and 2 between them, which stand for two columns each.
    fn unpack_gradient(
        &self,
        grad_sum: &[X::Real],
        grad_weight: ArrayViewMut3<'_, X::Real>,
        team: &mut Team<'_, X::Real>,
    );

    /// Whether the members of a team had better share the work on a batch of so many images, if threads would idle otherwise. Then a
    /// piece is all images, in several parts.
    fn shares(&self, _images: usize) -> bool {
        false
    }

    /// The kernel's way for one image, if it has one of its own.
    fn single(&self) -> Option<&dyn Single<X>> {
        None
    }
}

/// How a weight, or its conjugate, is brought from natural order to a kernel's own, scaled by the norm of the transform.
pub(crate) trait Packing<T>: Sync {
    /// Numbers in the packed weight of a tile of at most `lanes` lanes. That of a tile is those of its narrowest tiles, one
    /// after the other.
    fn packed_len(&self, lanes: usize) -> usize;

    /// Where the packed weight of the lanes from `lane` on begins, in tiles of a multiple of `granule` lanes.
    fn offset(&self, granule: usize, lane: usize) -> usize {
        lane.div_ceil(granule).saturating_mul(self.packed_len(granule))
    }

    /// Packs a factor made of the weight of one tile, `lanes` of the images; the team's scratches are the kernel's. `weight` has all
    /// lanes. A last tile narrower than a vector is packed together with the lanes before it; packed weights and sums have its own
    /// lanes at the vector's end.
    fn pack(
        &self,
        weight: ArrayView3<'_, T>,
        lanes: Range<usize>,
        factor: Factor,
        packed: &mut [T],
        team: &mut Team<'_, T>,
    );
}

/// What spectra are multiplied by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Factor {
    /// The weight, on the way forward.
    Weight,
    /// Its conjugate, on the way backward.
    Conjugate,
}

/// One image, for which bringing a weight to kernel order and a gradient back would not pay: both stay in natural order.
/// `y` and the gradient of `x` have the same bits as with [`Kernel::forward`] and [`Kernel::backward`].
pub(crate) trait Single<X: Stored>: Sync {
    /// As [`Kernel::forward`].
    fn forward(
        &self,
        x: ArrayView2<'_, X>,
        weight: ArrayView3<'_, X::Real>,
        y: ArrayViewMut2<'_, X>,
        team: &mut Team<'_, X::Real>,
    );

    /// The gradients that `pass` asks for.
    fn backward(&self, pass: SingleBackward<'_, X>, team: &mut Team<'_, X::Real>);
}

/// As [`Backward`], for one image.
pub(crate) struct SingleBackward<'a, X: Stored> {
    pub(crate) grad: ArrayView2<'a, X>,
    pub(crate) x: ArrayView2<'a, X>,
    pub(crate) weight: ArrayView3<'a, X::Real>,
    pub(crate) grad_x: Option<ArrayViewMut2<'a, X>>,
    pub(crate) grad_weight: Option<ArrayViewMut3<'a, X::Real>>,
}

/// One piece of a backward pass. `G` and `X` are the spectra of `grad` and `x`.
pub(crate) struct Backward<'a, X: Stored> {
    /// Gradient of the filter's output.
    pub(crate) grad: ArrayView3<'a, X>,
    /// Input of the filter; read only for `grad_sum`.
    pub(crate) x: ArrayView3<'a, X>,
    /// The conjugate weight, packed, or the weight itself where the kernel reads that as it is; read only for `grad_x`.
    pub(crate) weight: &'a [X::Real],
    /// Becomes `irfft2(G · conj W)`.
    pub(crate) grad_x: Option<ArrayViewMut3<'a, X>>,
    /// Grows by `Σ_b conj(X_b) · G_b` in kernel order, image by image; one sum after the other where there are several parts.
    pub(crate) grad_sum: Option<&'a mut [X::Real]>,
    /// Images of a part, each with a sum of its own.
    pub(crate) images_each: usize,
}
