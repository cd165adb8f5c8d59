//! The border to ONNX Runtime: its functions made safe, and the functions that it calls.
//!
//! # Who owns what
//! - Operators and their domain are made once for each ONNX Runtime in the process and never freed: options and sessions
//!   keep pointers to them, and nobody tells when the last one goes.
//! - A kernel is its session's, which frees it. Runs on several threads may use it at the same time.
//! - Whatever a tensor's description or a status holds is copied, and what was lent is given back at once.

mod api;
mod context;
mod info;
mod operator;
mod pool;
mod register;
mod sys;
mod tensor;
#[cfg(test)]
mod tests;

pub(crate) use api::{Api, Failure};
pub(crate) use context::Context;
pub(crate) use info::{Info, Sizes};
pub(crate) use operator::{Kernel, Operator};
pub(crate) use tensor::{Element, ElementType};
