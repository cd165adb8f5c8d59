//! What can be wrong with a caller's arguments. Each variant says what was expected and what came.

use std::fmt::{self, Display, Formatter};

/// An argument that the mathematics cannot take.
#[derive(Clone, Debug, PartialEq)]
pub enum Error {
    /// An array of another shape.
    Shape {
        /// The argument.
        name: &'static str,
        /// The shape wanted, as a user would write it.
        expected: String,
        /// The shape of the argument.
        got: Vec<usize>,
    },
    /// An array that is not C-contiguous.
    Strides {
        /// The argument.
        name: &'static str,
        /// The strides of the argument, in elements.
        got: Vec<isize>,
    },
    /// A layout that does not exist.
    Layout {
        /// The name that was given.
        got: String,
    },
    /// An instruction set that this machine does not have.
    Isa {
        /// The names of those that it has.
        expected: String,
        /// The name that was given.
        got: String,
    },
    /// A plane whose transform could not be addressed in memory.
    TooLarge {
        /// Rows of the plane.
        rows: usize,
        /// Columns of the plane.
        columns: usize,
        /// Channels, or 1.
        lanes: usize,
    },
    /// Working memory that there is not.
    Memory {
        /// The bytes that the call needs.
        bytes: usize,
    },
    /// A vector of length zero where a direction or a distance is needed.
    ZeroNorm {
        /// The argument.
        name: &'static str,
        /// Which vector, counted from zero in C order.
        row: usize,
    },
    /// NaN or infinity where a measurement must not hide it.
    NotFinite {
        /// The argument.
        name: &'static str,
        /// Which vector, counted from zero in C order.
        row: usize,
        /// The offending value.
        got: f64,
    },
    /// A vector with NaN or infinity, or a number that is not above zero where a length is needed.
    Vector {
        /// The argument.
        name: &'static str,
        /// What it must be.
        expected: &'static str,
        /// Its numbers.
        got: Vec<f32>,
        /// Where it stands among others.
        column: Option<usize>,
    },
}

impl Error {
    /// An array of another shape than `expected`, as a user would write it.
    #[must_use]
    pub fn shape(name: &'static str, expected: &str, got: &[usize]) -> Self {
        Self::Shape { name, expected: expected.to_owned(), got: got.to_vec() }
    }
}

impl std::error::Error for Error {}

/// By hand: a procedural macro would compile this crate once for each set of features that the crates beside it give `syn`.
impl Display for Error {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Shape { name, expected, got } => {
                write!(f, "{name} must have shape {expected}, got {}", tuple(got))
            }
            Self::Strides { name, got } => {
                write!(f, "{name} must be C-contiguous, got strides {got:?} (elements)")
            }
            Self::Layout { got } => {
                write!(f, "layout must be \"tokens\" or \"grid\", got {got:?}")
            }
            Self::Isa { expected, got } => {
                write!(f, "FFPOSE_ISA must be one of {expected} on this machine, got {got:?}")
            }
            Self::TooLarge { rows, columns, lanes } => write!(
                f,
                "a {rows} x {columns} plane in {lanes} lanes is larger than memory can address"
            ),
            Self::Memory { bytes } => write!(
                f,
                "expected {bytes} bytes of working memory, got none: there is not so much"
            ),
            Self::ZeroNorm { name, row } => {
                write!(f, "{name} must have a norm above zero, got a zero vector in row {row}")
            }
            Self::NotFinite { name, row, got } => {
                write!(f, "{name} must be finite, got {got} in row {row}")
            }
            Self::Vector { name, expected, got, column } => {
                write!(f, "{name} must be {expected}, got {got:?}")?;
                column.map_or(Ok(()), |column| write!(f, " in column {column}"))
            }
        }
    }
}

/// A shape as Python writes it.
pub(crate) fn tuple(shape: &[usize]) -> String {
    match shape {
        [one] => format!("({one},)"),
        many => format!("({})", many.iter().map(usize::to_string).collect::<Vec<_>>().join(", ")),
    }
}
