//! Poses from images without Python: a model of `ffpose export` in ONNX Runtime, for the program and for C (`c.rs`).
//!
//! `frames → picture (codecs) → preprocessing (reprojection, resize) → estimator (model, runtime, watch) → pose → answers`; a
//! track follows the poses (`track.rs`, by the crate ffpose-track) and says where the next look goes.

pub mod answers;
mod c;
mod camera;
mod codecs;
pub mod error;
pub mod estimator;
mod files;
pub mod frames;
mod graph;
mod json;
mod levels;
mod metadata;
mod model;
pub mod options;
mod picture;
mod pose;
mod preprocessing;
mod records;
mod reprojection;
mod resize;
mod runtime;
pub mod track;
mod undistortion;
mod watch;
