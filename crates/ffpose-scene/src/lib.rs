//! What rendered scenes need at speed: the Earth's light along rays, and fractal noise.
//!
//! Both run for the instruction set of [`ffpose_core::Isa::current`], and give the same bits for each.

#![forbid(unsafe_code)]

pub mod earth;
pub mod noise;
