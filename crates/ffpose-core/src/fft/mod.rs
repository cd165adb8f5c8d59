//! Transforms across vector lanes, and the spectral filters made of them.
//!
//! Lanes hold independent transforms, so that no transform shuffles inside a vector and any length takes any number of lanes.
//! The words are those of the glossary in `CONTRIBUTING.md`.
//!
//! # Map
//!
//! A [`crate::SpectralFilter`] cuts a batch into pieces (`spectral::tiling`, `spectral::batch`) and gives each to the kernel of
//! its shape, which [`plan`] chooses and of which it knows the traits of [`crate::kernel`] alone. A kernel takes the images of a
//! piece, one after the other or several side by side, to spectra in scratch (tokens: in the result), applies a *pointwise*
//! operation to these (the product with the weight, the sum of the weight's gradient, or both), and takes them back. In a grid:
//!
//! ```text
//! image -> rows forward -> columns forward -> pointwise -> columns inverse -> rows inverse -> image
//!                                                ^
//! weight (natural order) -> pack -> packed weight (kernel order); gradient sum -> unpack -> gradient
//! ```
//!
//! Tokens go along parts of both axes in turn. Nothing reorders a spectrum: transforms leave frequencies where the last pass puts
//! them, and the weight is packed to match.
//!
//! ## Kernels
//!
//! - **[`grid`]**: lanes are channels. `rows` takes the real rows of a tile to columns, by codelets where the width has one
//!   (`row_codelets`), else two rows as one complex line (`row_pairs`). [`columns`] takes each column forward,
//!   through the pointwise operation and back while it is in the L1 cache, and `columns::fused` does so for short columns
//!   without leaving the registers. `packing` brings the weight to kernel order, tile by tile; `single` does without for an
//!   image alone, whose weight is read bin by bin. Where channels do not fill whole vectors, here and in a sequence, the last
//!   vector overlaps the one before it.
//! - **[`sequence`]**: a grid of one row. Even and odd points of a channel are one complex line (`halves`), or an odd number of
//!   points the real part of one; `lines` has the choice.
//! - **[`tokens`]**: both axes of one plane, tokens or a grid of one channel, whose sizes have codelets: `X = A B` rows of lines of
//!   vectors. Three passes (`passes`), on one image or several (`images`): `lines` along Y without the lanes and `blocks` over `A`;
//!   for each step (`steps`) `blocks` over `B`, then `groups`, which transposes squares of vectors for the transform across lanes,
//!   with the product (`pointwise`) between; and back. An image of one row, as a long sequence of one channel, goes through all of
//!   them by itself (`rows`). The weight is read in natural order (`weight`); `gradient` brings the sums there.
//! - **[`batched`]**: fewer channels than lanes otherwise. Images are copied side by side to fill vectors for grid or sequence.
//! - **[`planes`]**: all else. Other tokens and large images of few channels go `across` vectors, with squares of vectors transposed
//!   between rows and columns; double precision, machines without vectors, images too small for squares and very long lines `along`
//!   memory, by realfft and rustfft.
//!
//! ## What they are made of
//!
//! - **[`codelets`]**: DFTs of fixed lengths in registers, complex (`dft`), real (`real_dft`; `real_line` of two factors)
//!   and turned (`turned_dft`), and the table of their lengths (`lengths`); two real lines as one complex line (`pair`); roots of
//!   unity.
//! - **[`transform`]**: complex lines of any length ([`transform::mixed_radix`]; primes without a codelet in `prime`, and large ones
//!   in `rader`).
//! - **[`columns`]**: columns through a pointwise operation, for grid, sequence and planes; `pointwise` has the operations, `geometry`
//!   where columns are, `order` which bin of a weight each place is.
//! - [`crate::simd`]: vectors and views of memory as vectors; [`crate::tuning`]: every constant that was measured.
//!
//! # Where to add
//!
//! - *An instruction set*: a vector type in `simd`; its `Kind` in `simd::isa` with `available`, `name`, `narrower`, a way into an algorithm
//!   (`Entries`) and the arms of both element types; a feature in `Cargo.toml`, handed on by `ffpose-py` and `ffpose-ort`;
//!   `tests/disassembly`, which checks its machine code.
//! - *An element type* to store: [`crate::simd::Stored`] and [`crate::Number`], the loads and stores of `Vector`; `with_dtype!`
//!   and `Dtype` of `ffpose-py`, the element types of `ffpose-ort`. To compute in: [`crate::simd::Element`] and [`crate::Real`]
//!   too.
//! - *A layout*: [`crate::Layout`] and its shapes in `shape`, [`crate::kernel`] for the axes of its views, a branch of [`plan`],
//!   `spectral::tiling` for its weight's lanes, and a kernel here.
//! - *A kernel*: a room here with a type that is a [`crate::kernel::Kernel`], an arm of [`Plan`], and when it is chosen in
//!   [`Plan::new`].
//! - *A codelet length*: a line of `codelets::lengths`, and the codelet, if it is made of none that there are.
//! - *A constant found by measurement*: [`crate::tuning`], with the machine.

#![allow(clippy::needless_range_loop)] // indices say which numbers meet; closures would not be inlined

mod batched;
mod codelets;
mod columns;
mod grid;
mod plan;
mod planes;
mod sequence;
mod tokens;
mod transform;

pub(crate) use plan::Plan;
pub use plan::Planned;
