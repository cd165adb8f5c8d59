//! What a network says of one frame.

use libm::{fabs, sqrt};
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

use crate::error::Error;
use crate::symmetry::{Symmetry, product};

/// The most attitudes that a network may offer for one frame.
pub const MODES: usize = 2;

/// How far from one the norm of a quaternion may be, which is then normalized.
const NORM_TOLERANCE: f64 = 1e-3;

/// How far from symmetric a covariance may be, as a share of its largest element.
const SYMMETRY_TOLERANCE: f64 = 1e-5;

/// The product of unit quaternions of two modes that are one attitude: cos 2.5°, as they are then 5° apart.
const ONE_ATTITUDE: f64 = 0.999_048;

/// Sweeps within which the eigenvalues of a matrix of three rows are found: a handful is usual.
const SWEEPS: usize = 100;

/// One pose that a frame may show, checked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mode {
    pub(crate) position: Vector3<f64>,
    pub(crate) orientation: UnitQuaternion<f64>,
    /// Covariance of the position, m², camera axes, and its symmetric root.
    pub(crate) position_covariance: Matrix3<f64>,
    pub(crate) position_root: Matrix3<f64>,
    /// Covariance of the rotation vector, rad², turned to the object's axes, and its symmetric root.
    pub(crate) attitude_covariance: Matrix3<f64>,
    pub(crate) attitude_root: Matrix3<f64>,
    pub(crate) probability: f64,
}

impl Mode {
    /// Takes a pose as networks give it.
    ///
    /// - `position`: meters, camera frame.
    /// - `orientation`: unit quaternion `(w, x, y, z)`, of either sign, from the object's to the camera's axes.
    /// - `position_covariance`: m², camera axes, rows or columns first, as it is symmetric.
    /// - `rotation_covariance`: rad², *camera* axes: of the vector `r` with `R_true = exp([r]×) R`.
    /// - `probability`: of this pose among those of the frame, 0…1.
    ///
    /// # Errors
    ///
    /// A number is not finite, the quaternion's norm not one, a covariance not symmetric and positive definite, or the
    /// probability outside of 0…1.
    pub fn new(
        position: [f64; 3],
        orientation: [f64; 4],
        position_covariance: [[f64; 3]; 3],
        rotation_covariance: [[f64; 3]; 3],
        probability: f64,
    ) -> Result<Self, Error> {
        let position = Vector3::from(position);
        finite("position", position.iter())?;
        finite("orientation", orientation.iter())?;
        let [w, x, y, z] = orientation;
        let quaternion = Quaternion::new(w, x, y, z);
        let norm = quaternion.norm();
        if fabs(norm - 1.0) > NORM_TOLERANCE {
            return Err(Error::Norm { got: norm });
        }
        let orientation = UnitQuaternion::new_normalize(quaternion);
        if !(0.0..=1.0).contains(&probability) {
            return Err(Error::Probability { got: probability });
        }
        let position_covariance = covariance("position_covariance", position_covariance)?;
        let in_camera = covariance("rotation_covariance", rotation_covariance)?;
        let turn = orientation.to_rotation_matrix();
        let attitude_covariance =
            symmetric(&(turn.matrix().transpose() * in_camera * turn.matrix()));
        Ok(Self {
            position,
            orientation,
            position_covariance,
            position_root: root("position_covariance", &position_covariance)?,
            attitude_covariance,
            attitude_root: root("rotation_covariance", &attitude_covariance)?,
            probability,
        })
    }

    /// The pose with another orientation, which looks the same: its errors are the same along the camera's axes.
    fn turned(self, orientation: UnitQuaternion<f64>) -> Self {
        let turn = (self.orientation.inverse() * orientation).to_rotation_matrix();
        let along = |matrix: &Matrix3<f64>| {
            symmetric(&(turn.matrix().transpose() * matrix * turn.matrix()))
        };
        Self {
            orientation,
            attitude_covariance: along(&self.attitude_covariance),
            attitude_root: along(&self.attitude_root),
            ..self
        }
    }
}

/// What a frame says: one pose or several, of which one is true, or that it shows no object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measurement {
    modes: [Option<Mode>; MODES],
}

impl Measurement {
    /// Takes one to [`MODES`] poses, of which those of probability zero are left out.
    ///
    /// # Errors
    ///
    /// There are none, or too many, or none has a probability above zero.
    pub fn new(modes: &[Mode]) -> Result<Self, Error> {
        if modes.is_empty() || modes.len() > MODES {
            return Err(Error::Modes { got: modes.len() });
        }
        let mut kept = [None; MODES];
        for (place, mode) in kept.iter_mut().zip(modes) {
            *place = Some(*mode).filter(|mode| mode.probability > 0.0);
        }
        if kept.iter().all(Option::is_none) {
            return Err(Error::Modes { got: 0 });
        }
        Ok(Self { modes: kept })
    }

    /// Of a frame that does not show the object, as the network says (it is flagged).
    #[must_use]
    pub fn flagged() -> Self {
        Self { modes: [None; MODES] }
    }

    /// The poses with the attitudes of their looks that are nearest to any that are expected; two that look alike become one.
    pub(crate) fn unfolded(
        &self,
        symmetry: &Symmetry,
        expected: &[Option<UnitQuaternion<f64>>],
    ) -> Self {
        if symmetry.is_trivial() {
            return *self;
        }
        let mut kept: [Option<Mode>; MODES] = [None; MODES];
        for (place, mode) in self.modes() {
            let alike = |one: &&mut Mode| {
                let q = symmetry.nearest(&mode.orientation, [one.orientation].into_iter());
                product(&one.orientation, &q) > ONE_ATTITUDE
            };
            if let Some(one) = kept.iter_mut().flatten().find(alike) {
                one.probability = (one.probability + mode.probability).min(1.0);
            } else {
                let wanted = expected.iter().flatten().copied();
                kept[place] = Some(mode.turned(symmetry.nearest(&mode.orientation, wanted)));
            }
        }
        Self { modes: kept }
    }

    /// The poses with their places.
    pub(crate) fn modes(&self) -> impl Iterator<Item = (usize, &Mode)> {
        self.modes.iter().enumerate().filter_map(|(place, mode)| Some((place, mode.as_ref()?)))
    }
}

pub(crate) fn finite<'a>(
    name: &'static str,
    mut numbers: impl Iterator<Item = &'a f64>,
) -> Result<(), Error> {
    if numbers.all(|number| number.is_finite()) { Ok(()) } else { Err(Error::NotFinite { name }) }
}

fn covariance(name: &'static str, rows: [[f64; 3]; 3]) -> Result<Matrix3<f64>, Error> {
    let matrix = Matrix3::from(rows);
    finite(name, matrix.iter())?;
    if (matrix - matrix.transpose()).amax() > SYMMETRY_TOLERANCE * matrix.amax() {
        return Err(Error::Covariance { name, expected: "a symmetric matrix" });
    }
    Ok(symmetric(&matrix))
}

/// The symmetric square root of a covariance, which turns as the covariance does.
fn root(name: &'static str, matrix: &Matrix3<f64>) -> Result<Matrix3<f64>, Error> {
    let fault = Error::Covariance { name, expected: "a positive definite matrix" };
    let eigen = matrix.try_symmetric_eigen(f64::EPSILON, SWEEPS).ok_or(fault)?;
    if !eigen.eigenvalues.iter().all(|value| *value > 0.0) {
        return Err(fault);
    }
    let roots = Matrix3::from_diagonal(&eigen.eigenvalues.map(sqrt));
    Ok(symmetric(&(eigen.eigenvectors * roots * eigen.eigenvectors.transpose())))
}

fn symmetric(matrix: &Matrix3<f64>) -> Matrix3<f64> {
    (matrix + matrix.transpose()) * 0.5
}
