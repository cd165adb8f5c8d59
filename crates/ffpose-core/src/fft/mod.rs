//! Transforms across vector lanes, and the spectral filters made of them.
//!
//! Lanes hold independent transforms, so that no transform shuffles inside a vector and any length takes any number of lanes.
//!
//! # Map
//!
//! A [`crate::SpectralFilter`] cuts a batch into pieces ([`crate::batch`], [`crate::tiling`]) and gives each to the kernel of
//! its shape ([`crate::kernel`]), which [`plan`] chooses. A kernel takes a piece of an image to a spectrum in scratch, applies a
//! *middle* to it (the product with the packed weight, the gradient sum, or both), and takes it back:
//!
//! ```text
//! image -> rows forward -> columns forward -> middle -> columns inverse -> rows inverse -> image
//!                                               ^
//! weight (natural order) -> pack -> packed weight (kernel order); gradient sum -> unpack -> gradient
//! ```
//!
//! Nothing reorders a spectrum: transforms leave frequencies where the last pass puts them, and the weight is packed to match.
//!
//! - **[`grid`]**: lanes are channels. [`rows`] takes the real rows of a tile to columns (by codelets made in [`lines`] where the
//!   width has one, else two rows as one complex line of [`transform`]); [`columns`] takes each column forward, through the
//!   [`middle`] and back while it is in the L1 cache, and [`fused`] does so for short columns without leaving the registers.
//!   [`pack`] is the order of the weight.
//! - **[`sequence`]**: a grid of one row. Even and odd points of a channel are one complex column ([`pair`]).
//! - **[`batched`]**: fewer channels than lanes. Images are copied side by side ([`spread`]) to fill vectors for one of the two above.
//! - **[`tokens`]**: both axes of one plane, whose sizes have codelets. All transforms but one go across vectors; that one
//!   transposes squares of vectors beside the product. It reads the weight in natural order.
//! - **[`planes`]**: tokens of any other size; [`planes_pack`] is the order of its weight.
//! - **[`crate::general`]**: so few lines that vectors across them would be half empty: rustfft along the lines.
//!
//! What they are made of, from the smallest: [`roots`] of unity; [`unroll`]; codelets for complex lines ([`butterfly`],
//! [`prime`]) and for real ones ([`real`]); [`passes`] for smooth lengths and [`chirp`] for all others, which [`transform`]
//! chooses between.
//!
//! # Where to add
//!
//! - *An instruction set*: a vector type in `simd`, its kind in `simd::isa` (`available`, `name`, and the ways into an algorithm
//!   of each element type); `tests/disassembly` checks its machine code.
//! - *An element type*: [`crate::simd::Stored`] for what is stored and converted at loads and stores, [`crate::simd::Element`]
//!   for what is computed in; [`crate::Number`]; the type tables of `ffpose-py` and `ffpose-ort`.
//! - *A layout*: [`crate::Layout`] and its shapes in `shape`, a branch of [`plan`], and a kernel here.
//! - *A codelet length*: `butterfly` or `real`, then the tables that name lengths: `rows` and `lines` for grids, `fused` for
//!   their columns, `tokens::columns::LENGTHS` and `tokens::lines` for tokens.

#![allow(clippy::needless_range_loop)] // indices say which numbers meet; closures would not be inlined

mod along;
mod batched;
mod codelets;
mod columns;
mod grid;
mod plan;
mod planes;
mod sequence;
#[cfg(test)]
mod tests;
mod tokens;
mod transform;

pub(crate) use plan::Plan;
