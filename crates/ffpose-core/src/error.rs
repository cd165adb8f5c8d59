//! What can be wrong with a caller's arguments. Each variant says what was expected and what came.

use thiserror::Error;

use crate::shape::tuple;

/// An argument that the mathematics cannot take.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Error {
    /// An array of another shape.
    #[error("{name} must have shape {expected}, got {}", tuple(got))]
    Shape {
        /// The argument.
        name: &'static str,
        /// The shape wanted, as a user would write it.
        expected: String,
        /// The shape of the argument.
        got: Vec<usize>,
    },
    /// An array that is not C-contiguous.
    #[error("{name} must be C-contiguous, got strides {got:?} (elements)")]
    Strides {
        /// The argument.
        name: &'static str,
        /// The strides of the argument, in elements.
        got: Vec<isize>,
    },
    /// A layout that does not exist.
    #[error("layout must be \"tokens\" or \"grid\", got {got:?}")]
    Layout {
        /// The name that was given.
        got: String,
    },
    /// An instruction set that this machine does not have.
    #[error("FFPOSE_ISA must be one of {expected} on this machine, got {got:?}")]
    Isa {
        /// The names of those that it has.
        expected: String,
        /// The name that was given.
        got: String,
    },
    /// A plane whose transform could not be addressed in memory.
    #[error("a {rows} x {columns} plane in {lanes} lanes is larger than memory can address")]
    TooLarge {
        /// Rows of the plane.
        rows: usize,
        /// Columns of the plane.
        columns: usize,
        /// Channels, or 1.
        lanes: usize,
    },
    /// Working memory that there is not.
    #[error("expected {bytes} bytes of working memory, got none: there is not so much")]
    Memory {
        /// The bytes that the call needs.
        bytes: usize,
    },
    /// A vector of length zero where a direction or a distance is needed.
    #[error("{name} must have a norm above zero, got a zero vector in row {row}")]
    ZeroNorm {
        /// The argument.
        name: &'static str,
        /// Which vector, counted from zero in C order.
        row: usize,
    },
    /// NaN or infinity where a measurement must not hide it.
    #[error("{name} must be finite, got {got} in row {row}")]
    NotFinite {
        /// The argument.
        name: &'static str,
        /// Which vector, counted from zero in C order.
        row: usize,
        /// The offending value.
        got: f64,
    },
}
