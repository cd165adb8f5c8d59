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
//!
//! # Map
//!
//! - **[`SpectralFilter`]** (`spectral`): checks shapes, plans once for each (`plans`), cuts a batch into pieces (`tiling`, `batch`),
//!   lends them to threads, adds gradient sums up in a fixed order; [`Prepared`] weights.
//! - **Kernels** (`fft`, whose page is their map): what computes one piece, behind the traits of `kernel`.
//! - **Vectors** (`simd`): the vector trait and its instruction sets, memory as vectors; the only unsafe code.
//! - **Elements**: `real` is what is computed in, `number` what is stored; `shape` the layouts; `views` parts of images.
//! - **Machine**: `parallel` the threads, `scratch` the memory, [`tuning`] each constant that was measured.
//! - **Poses**: [`quaternion`], [`pose_error`], over `arrays`; no filter.

#![deny(unsafe_code)]

mod arrays;
mod error;
mod fft;
mod kernel;
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
mod views;

pub use error::Error;
pub use fft::Planned;
pub use number::Number;
pub use parallel::{Guarded, Pool, StdThreads};
pub use real::Real;
pub use scratch::{Scratch, Scratches};
pub use shape::{Layout, Shape};
pub use simd::{Bf16, F16, Isa, Loops};
pub use spectral::{Gradients, Prepared, SpectralFilter};

/// Asks the machine what every later call needs to know of it: instruction set, caches. A library that may be loaded into a process
/// that forks does so as it is loaded: a child that was forked while another thread asked would wait for that thread for ever.
///
/// `FFPOSE_ISA` is read here; what is wrong with it is the error of [`Isa::current`].
pub fn initialize() {
    let _ = Isa::current(); // it is told where it is needed
    tuning::Tuning::of_machine();
}
