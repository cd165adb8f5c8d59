//! The mathematics of ffpose: learnable spectral filters, quaternions and pose errors. No Python, no torch, no ONNX.
//!
//! # Conventions
//!
//! - **Layouts.** [`Layout::Tokens`]: images `(..., X, Y)`, transformed over both axes. [`Layout::Grid`]: channels-last
//!   images `(..., H, W, C)`, transformed over H and W for each channel.
//! - **Spectra** are real arrays with real and imaginary part on the last axis, of half the spectrum: `(X, Y/2+1, 2)` or
//!   `(H, W/2+1, C, 2)`.
//! - **Normalization.** That of `torch.fft.rfft2` and `irfft2` by default: none forward, one over the points of the
//!   plane inverse.
//! - **Elements** are `f32` or `f64`; filters also take half precision, computed in `f32`.
//! - **Threads** are the caller's: a [`Pool`] lends them.
//! - **Quaternions** are Hamilton's, scalar first `(w, x, y, z)`. Angles are in degrees, translations in meters.

#![deny(unsafe_code)]

mod arrays;
pub mod earth;
mod error;
mod fft;
mod kernel;
pub mod noise;
mod number;
mod parallel;
pub mod pose_error;
pub mod quaternion;
mod real;
mod scratch;
mod shape;
#[allow(unsafe_code)] // fenced in this one folder
mod simd;
mod spectral;
pub mod tuning;

pub use error::Error;
pub use number::Number;
pub use parallel::{Pool, StdThreads};
pub use real::Real;
pub use scratch::{Scratch, Scratches};
pub use shape::{Layout, Shape};
pub use simd::{Bf16, F16, Isa};
pub use spectral::{Gradients, Prepared, SpectralFilter};

/// Asks the machine what every later call needs to know of it: instruction set, caches. A library that may be loaded into a process
/// that forks does so as it is loaded: a child that was forked while another thread asked would wait for that thread for ever.
///
/// `FFPOSE_ISA` is read here; what is wrong with it is the error of [`Isa::current`].
pub fn initialize() {
    let _ = Isa::current(); // it is told where it is needed
    tuning::Tuning::of_machine();
}
