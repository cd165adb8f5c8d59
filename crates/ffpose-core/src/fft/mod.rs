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
//! Planes go along X first, tokens along parts of both in turn. Nothing reorders a spectrum: transforms leave frequencies where
//! the last pass puts them, and the weight is packed to match.
//!
//! ## Kernels
//!
//! - **[`grid`]**: lanes are channels. `rows` takes the real rows of a tile to columns, by codelets where the width has one
//!   (`row_codelets`, `composite`), else two rows as one complex line (`row_pairs`). [`columns`] takes each column forward,
//!   through the pointwise operation and back while it is in the L1 cache, and `columns::fused` does so for short columns
//!   without leaving the registers. `packing` brings the weight to kernel order, tile by tile; `single` does without for an
//!   image alone, whose weight is read bin by bin.
//! - **[`sequence`]**: a grid of one row. Even and odd points of a channel are one complex line (`halves`), or an odd number of
//!   points the real part of one; `lines` has the choice.
//! - **[`polyphase`]**: sequences of few channels. Phases of the points fill a vector; their spectra are put together `across` them.
//! - **[`batched`]**: fewer channels than lanes. Images are copied side by side to fill vectors for grid or sequence.
//! - **[`tokens`]**: both axes of one plane, whose sizes have codelets: `X = A B` rows of lines of vectors. Three passes
//!   (`passes`), on one image or several (`images`): `lines` along Y without the lanes and `blocks` over `A`; for each step
//!   (`steps`) `blocks` over `B`, then `groups`, which transposes squares of vectors for the transform across lanes, with the
//!   product (`pointwise`) between; and back. It reads the weight in natural order (`weight`); `gradient` brings the sums there.
//! - **[`planes`]**: tokens of any other size. Transforms along X, two `vectors` of a row as one complex line, then along Y as
//!   columns of as many rows as there are lanes, transposed by `squares`; `order` is that of its weight.
//! - **[`along`]**: so few lines that vectors across them would be half empty: rustfft along the lines.
//!
//! ## What they are made of
//!
//! - **[`codelets`]**: DFTs of fixed lengths in registers, complex (`dft`), real (`real_dft`) and turned (`turned_dft`), and
//!   the table of their lengths (`lengths`); two real lines as one complex line (`pair`); roots of unity.
//! - **[`transform`]**: complex lines of any length: [`transform::mixed_radix`] where primes are small (those without a codelet
//!   in `prime`), Bluestein's algorithm for all others.
//! - **[`columns`]**: columns through a pointwise operation, for grid, sequence and planes; `pointwise` has the operations,
//!   `geometry` where columns are, `order` which bin of a weight each place is.
//! - [`crate::simd`]: vectors and views of memory as vectors; [`crate::tuning`]: every constant that was measured.
//!
//! # Where to add
//!
//! - *An instruction set*: a vector type in `simd`; its `Kind` in `simd::isa` with `available`, `name`, a way into an algorithm
//!   (`Entries`) and the arms of both element types; a feature in `Cargo.toml`, handed on by `ffpose-py` and `ffpose-ort`;
//!   `tests/disassembly`, which checks its machine code.
//! - *An element type* to store: [`crate::simd::Stored`] and [`crate::Number`], the loads and stores of `Vector`; `with_dtype!`
//!   and `Dtype` of `ffpose-py`, the element types of `ffpose-ort`. To compute in: [`crate::simd::Element`] and [`crate::Real`]
//!   too.
//! - *A layout*: [`crate::Layout`] and its shapes in `shape`, [`crate::kernel`] for the axes of its views, a branch of [`plan`],
//!   `spectral::tiling` for its weight's lanes, and a kernel here.
//! - *A kernel*: a room here with a type that is a [`crate::kernel::Kernel`], an arm of [`Plan`] (twice, if it loads half
//!   precision itself), and when it is chosen in [`Plan::new`].
//! - *A codelet length*: a line of `codelets::lengths`, and the codelet, if it is made of none that there are.
//! - *A constant found by measurement*: [`crate::tuning`], with the machine.

#![allow(clippy::needless_range_loop)] // indices say which numbers meet; closures would not be inlined

mod along;
mod batched;
mod codelets;
mod columns;
mod grid;
mod plan;
mod planes;
mod polyphase;
mod sequence;
#[cfg(test)]
mod tests;
mod tokens;
mod transform;

pub(crate) use plan::Plan;
pub use plan::Planned;
