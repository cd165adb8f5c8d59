//! The two element types of every array in this crate.

use bytemuck::Pod;
use rustfft::FftNum;

use crate::simd::Element;

/// `f32` or `f64`.
pub trait Real: Element + FftNum + Pod + Into<f64> {}

impl Real for f32 {}
impl Real for f64 {}
