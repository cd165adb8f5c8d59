//! What rendered scenes need at speed: the Earth's light along rays, fractal noise, and textures.
//!
//! All run for the instruction set of [`ffpose_core::Isa::current`], and give the same bits for each.

#![forbid(unsafe_code)]

pub mod earth;
pub mod noise;
pub mod textures;
