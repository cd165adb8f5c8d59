//! A spacecraft's motion from the poses of its images, for flight software: `no_std`, and nothing is allocated.
//!
//! [`Tracker`] takes one [`Measurement`] for each frame and gives position, velocity, orientation, angular velocity and their
//! covariance. Frames of its own are the camera's (x right, y down, z forward, meters) and the object's; `p_camera = R(q) p_object + t`.
//!
//! - `Filter` is a multiplicative extended Kalman filter (Lefferts, Markley and Shuster, *Journal of Guidance, Control,
//!   and Dynamics* 5(5), 1982; Markley, *ibid.* 26(2), 2003): the orientation is a unit quaternion, its error a rotation
//!   vector along the object's axes, `R_true = R exp([θ]×)`.
//! - A network's errors are functions of what it sees: they repeat while the object shows the same side, however many frames
//!   are taken. Beside twelve numbers of the motion six are such errors, first-order Gauss–Markov processes in the *angle turned*.
//! - Of the attitudes that look alike by a [`Symmetry`] of the object a frame's is the one that continues a filter.
//! - [`Tracker`] holds up to three filters, one for each attitude that the frames speak for, and says which of them leads.

#![no_std]

mod error;
mod filter;
mod measurement;
mod motion;
mod parameters;
mod rotation;
mod state;
mod symmetry;
mod tracker;

pub use error::Error;
pub use filter::Covariance;
pub use measurement::{MODES, Measurement, Mode};
pub use parameters::Parameters;
pub use state::{STATE_BYTES, TAG_BYTES};
pub use symmetry::{Axis, Symmetry};
pub use tracker::{Estimate, Outcome, Step, Tracker};
