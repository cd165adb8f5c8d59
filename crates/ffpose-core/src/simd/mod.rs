//! Vectors of real numbers behind one trait, and the choice of the instruction set at run time.
//!
//! A generic algorithm is a [`Algorithm`]; [`Isa::run`] runs it with the vector type of an instruction set. The concrete types
//! are private to this module and are reached through that door alone, which opens only where the processor has the
//! instructions: that is why the operations of [`Vector`] are safe to call.
//!
//! Speed needs every generic function between the door and the intrinsics to be `#[inline(always)]`: what is not inlined is
//! compiled without the instruction set. For the same reason such code has loops where closures would be natural.
//!
//! All unsafe code of the crate is in this folder.

mod cache;
mod complex;
mod half;
mod isa;
mod memory;
#[cfg(target_arch = "aarch64")]
mod neon;
mod prefetch;
mod register;
mod runs;
mod tile;
#[cfg(target_arch = "x86_64")]
mod x86;

use std::fmt::Debug;
use std::ops::{Add, Mul, Neg, Sub};

pub(crate) use cache::{fetches_ahead, l2_cache};
pub(crate) use complex::{Complex, joined, mirrored, parts};
pub(crate) use half::Convert;
pub use half::{Bf16, F16, Stored};
pub use isa::{Isa, Loops};
pub(crate) use memory::{
    Aligned, LINE_BYTES, aligned, complex_vectors, complex_vectors_of, gather, gather_at, scatter,
    scatter_at, slack,
};
pub(crate) use runs::Runs;
pub(crate) use tile::{Tile, TileMut};

/// The most lanes that a [`Vector`] of this crate has.
pub(crate) const MAX_LANES: usize = 16;

/// An element type that is computed in.
pub trait Element:
    Copy
    + Debug
    + Default
    + Send
    + Sync
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Stored<Real = Self>
    + 'static
{
    /// The value of this type nearest to `value`.
    fn nearest(value: f64) -> Self;

    /// Elements in one vector of `isa`.
    #[doc(hidden)]
    fn lanes(isa: Isa) -> usize;

    /// Runs `algorithm` with the vectors of `isa`.
    #[doc(hidden)]
    #[allow(private_bounds, private_interfaces)] // algorithms are this crate's alone, the trait is sealed
    fn run<A: Algorithm<Self>>(isa: Isa, algorithm: A);
}

/// A vector of [`LANES`](Vector::LANES) elements; arithmetic is lane by lane.
///
/// # Safety
/// A value is `LANES` elements without padding, for which any bits are a value, and `LANES` is a power of two, at most
/// [`MAX_LANES`]. `load` and `store` touch these elements and no others.
pub(crate) unsafe trait Vector:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Neg<Output = Self>
{
    type Element: Element;
    /// A power of two, at most [`MAX_LANES`].
    const LANES: usize;

    fn splat(x: Self::Element) -> Self;

    /// `self * b + c`, fused where the instruction set has it.
    fn mul_add(self, b: Self, c: Self) -> Self;

    /// `c - self * b`, fused where the instruction set has it.
    fn neg_mul_add(self, b: Self, c: Self) -> Self;

    /// `self * b - c`, fused where the instruction set has it.
    fn mul_sub(self, b: Self, c: Self) -> Self;

    /// # Safety
    /// `LANES` elements are readable at `from`.
    unsafe fn load(from: *const Self::Element) -> Self;

    /// # Safety
    /// `LANES` elements are writable at `to`.
    unsafe fn store(self, to: *mut Self::Element);

    /// As [`load`](Vector::load), from half precision.
    ///
    /// # Safety
    /// `LANES` elements are readable at `from`.
    unsafe fn load_bf16(from: *const Bf16) -> Self;

    /// As [`store`](Vector::store), in half precision.
    ///
    /// # Safety
    /// `LANES` elements are writable at `to`.
    unsafe fn store_bf16(self, to: *mut Bf16);

    /// As [`load`](Vector::load), from half precision.
    ///
    /// # Safety
    /// `LANES` elements are readable at `from`.
    unsafe fn load_f16(from: *const F16) -> Self;

    /// As [`store`](Vector::store), in half precision.
    ///
    /// # Safety
    /// `LANES` elements are writable at `to`.
    unsafe fn store_f16(self, to: *mut F16);

    /// `(a0 a1 .., b0 b1 ..)` to `(a0 b0 a1 b1 .., .. )`: the first and the second half of the alternating sequence.
    fn interleave(a: Self, b: Self) -> (Self, Self);

    /// Undoes [`interleave`](Vector::interleave).
    fn deinterleave(low: Self, high: Self) -> (Self, Self);

    /// As [`deinterleave`](Vector::deinterleave), with the lanes in reverse.
    fn deinterleave_reversed(low: Self, high: Self) -> (Self, Self);

    /// The lanes in reverse.
    fn reverse(self) -> Self;

    /// The first halves of two vectors, and the second halves.
    fn exchange_halves(a: Self, b: Self) -> (Self, Self);

    /// Transposes `LANES / 2` vectors inside each half: element `i` of either half of vector `j` becomes element `j` of that half
    /// of vector `i`.
    fn transpose_in_halves(vectors: &mut [Self]);
}

/// Transposes the first `LANES` vectors: element `i` of vector `j` becomes element `j` of vector `i`.
#[inline(always)]
pub(crate) fn transpose_square<V: Vector>(vectors: &mut [V; MAX_LANES]) {
    let half = V::LANES / 2;
    let (first, second) = vectors[..V::LANES].split_at_mut(half);
    for i in 0..half {
        (first[i], second[i]) = V::exchange_halves(first[i], second[i]);
    }
    V::transpose_in_halves(first);
    V::transpose_in_halves(second);
}

/// Where the squares of `len` numbers, at least a vector, begin: the last one may begin again in the one before.
#[inline(always)]
pub(crate) fn squares<V: Vector>(len: usize) -> impl Iterator<Item = usize> {
    (0..len.div_ceil(V::LANES)).map(move |square| (square * V::LANES).min(len - V::LANES))
}

/// An algorithm for any vector type of element `T`.
///
/// `run` and all that it calls for each vector must be `#[inline(always)]`.
pub(crate) trait Algorithm<T: Element> {
    fn run<V: Vector<Element = T>>(self);
}
