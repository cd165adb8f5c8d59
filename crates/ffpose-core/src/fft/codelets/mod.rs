//! DFTs of small fixed lengths in registers, and what else transforms are made of.

mod dft;
mod lengths;
pub(crate) mod pair;
mod real_dft;
mod real_line;
mod roots;
mod turned_dft;
mod unroll;

use dft::times_root;
pub(crate) use dft::{Codelet, Dft};
pub(crate) use lengths::{has_codelet, with_codelet};
pub(crate) use real_dft::{RealDft, TwoReal};
pub(crate) use real_line::RealLine;
pub(crate) use roots::{root, twiddle};
pub(crate) use turned_dft::TurnedDft;
pub(crate) use unroll::unroll;
