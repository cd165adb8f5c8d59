//! What can be wrong with a caller's arguments. Each variant says what was expected and what came.

use core::fmt::{self, Display, Formatter};

/// An argument that the tracker cannot take; it has changed nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Error {
    /// A frame that is not later than the one before.
    Time {
        /// The time of the frame before, seconds.
        last: f64,
        /// The time that was given, seconds.
        got: f64,
    },
    /// NaN or infinity.
    NotFinite {
        /// The argument.
        name: &'static str,
    },
    /// A quaternion that is no rotation.
    Norm {
        /// Its norm.
        got: f64,
    },
    /// A covariance that is not symmetric, or not positive definite.
    Covariance {
        /// The argument.
        name: &'static str,
        /// What it is not.
        expected: &'static str,
    },
    /// A probability outside of 0 to 1.
    Probability {
        /// The value that was given.
        got: f64,
    },
    /// A number of modes that a measurement cannot have.
    Modes {
        /// The number that was given.
        got: usize,
    },
    /// A setting out of its range.
    Parameter {
        /// The setting.
        name: &'static str,
        /// Its range.
        expected: &'static str,
        /// The value that was given.
        got: f64,
    },
    /// A setting that there is not.
    Setting,
    /// A setting of another number of numbers.
    Numbers {
        /// How many it has.
        expected: usize,
    },
    /// Axes of symmetry that go together in no group.
    Symmetry {
        /// What they are not.
        expected: &'static str,
    },
    /// A saved state that cannot be taken up.
    State {
        /// Why.
        reason: &'static str,
    },
}

impl Display for Error {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Time { last, got } => {
                write!(f, "time: expected later than {last} s, the frame before, got {got} s")
            }
            Self::NotFinite { name } => {
                write!(f, "{name}: expected finite numbers, got NaN or infinity")
            }
            Self::Norm { got } => {
                write!(f, "orientation: expected a unit quaternion, got norm {got}")
            }
            Self::Covariance { name, expected } => write!(f, "{name}: expected {expected}"),
            Self::Probability { got } => {
                write!(f, "probability: expected a number in 0…1, got {got}")
            }
            Self::Modes { got } => {
                write!(
                    f,
                    "modes: expected 1 to {} of a probability above 0, got {got}",
                    crate::MODES
                )
            }
            Self::Parameter { name, expected, got } => {
                write!(f, "{name}: expected {expected}, got {got}")
            }
            Self::Setting => write!(f, "expected a setting of the tracker"),
            Self::Numbers { expected: 1 } => write!(f, "expected a number"),
            Self::Numbers { expected } => write!(f, "expected {expected} numbers"),
            Self::Symmetry { expected } => write!(f, "symmetry: expected {expected}"),
            Self::State { reason } => write!(f, "state: {reason}"),
        }
    }
}

impl core::error::Error for Error {}
