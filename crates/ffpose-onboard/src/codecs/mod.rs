//! The kinds of image files.

pub mod jpeg;
pub mod pgm;
pub mod png;
