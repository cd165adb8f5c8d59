//! Operators of ffpose for ONNX Runtime, as a C library that needs neither Python nor torch.
//!
//! `ffpose::SpectralFilter(x, weight) -> y`, attribute `layout` (`"tokens"` or `"grid"`): the filter of
//! [`ffpose_core::SpectralFilter`], with its shapes. A sequence is a grid of one row.
//!
//! `ffpose::SamplePyramid(homographies, levels, plane, finest, half, quarter, eighth) -> y`: the images of virtual cameras
//! (`pyramid`), float32.
//!
//! The library links no ONNX Runtime: `RegisterCustomOps`, its one symbol, gets the table of functions of the runtime that
//! loads it, 1.17 or any later one.

#![deny(unsafe_code)]

#[allow(unsafe_code)] // fenced in this one folder
mod border;
mod filter;
mod pyramid;

use ffpose_core::{Bf16, F16};

use border::{Api, Operator};
use filter::Filter;
use pyramid::SamplePyramid;

/// The operators, one for each combination of element types; ONNX Runtime takes the one that fits a node.
fn operators(api: Api) -> [Operator; 7] {
    [
        Operator::new::<Filter<f32, f32>>(api),
        Operator::new::<Filter<f64, f64>>(api),
        Operator::new::<Filter<Bf16, f32>>(api),
        Operator::new::<Filter<Bf16, Bf16>>(api),
        Operator::new::<Filter<F16, f32>>(api),
        Operator::new::<Filter<F16, F16>>(api),
        Operator::new::<SamplePyramid>(api),
    ]
}
