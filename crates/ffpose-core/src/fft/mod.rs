//! Transforms across vector lanes, and the spectral filters made of them.
//!
//! Lanes hold independent transforms, so that no transform shuffles inside a vector and any length takes any number of lanes.

#![allow(clippy::needless_range_loop)] // indices say which numbers meet; closures would not be inlined

mod batched;
mod butterfly;
mod chirp;
mod columns;
mod fused;
mod grid;
mod lines;
mod middle;
mod pack;
mod pair;
mod passes;
mod planes;
mod planes_pack;
mod prime;
mod real;
mod roots;
mod rows;
mod sequence;
mod spread;
#[cfg(test)]
mod tests;
mod tokens;
mod transform;
mod unroll;

use std::sync::Arc;

pub(crate) use batched::Batched;
pub(crate) use grid::Grid;
use planes::Planes;
pub(crate) use sequence::Sequence;
pub(crate) use tokens::Tokens;

use crate::kernel::Kernel;
use crate::simd::Isa;
use crate::{Layout, Real, Shape};

/// The kernel for a shape without zeros.
pub(crate) fn plan<T: Real>(isa: Isa, shape: Shape) -> Arc<dyn Kernel<T>> {
    match shape.layout {
        Layout::Grid if shape.rows == 1 => Arc::new(Sequence::new(isa, shape.columns)),
        Layout::Grid => Arc::new(Grid::new(isa, shape)),
        Layout::Tokens => match Tokens::new(isa, shape.rows, shape.columns) {
            Some(tokens) => Arc::new(tokens),
            None => Arc::new(Planes::new(isa, shape.rows, shape.columns)),
        },
    }
}
