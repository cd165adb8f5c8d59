//! One track: an error-state Kalman filter over motion and the network's errors.

use nalgebra::{
    Cholesky, Const, Matrix3, Matrix6, SMatrix, SVector, UnitQuaternion, Vector3, Vector6,
};

use crate::measurement::Mode;
use crate::parameters::Parameters;
use crate::rotation::right_jacobian;

/// Where the parts of the error stand; each is three numbers.
pub(crate) const POSITION: usize = 0;
pub(crate) const VELOCITY: usize = 3;
pub(crate) const ATTITUDE: usize = 6;
pub(crate) const RATE: usize = 9;

/// Where those of the network's errors stand.
pub(crate) const POSITION_BIAS: usize = 0;
pub(crate) const ATTITUDE_BIAS: usize = 3;

/// The numbers of the motion's error, and of the network's.
pub(crate) const MOTION: usize = 12;
pub(crate) const ERRORS: usize = 6;

/// The covariance of the motion's error `(δp, δv, θ, δω)`: m, m/s, rad, rad/s.
pub type Covariance = SMatrix<f64, MOTION, MOTION>;

/// The covariance of the motion's error with the network's, which are of unit variance.
pub(crate) type Cross = SMatrix<f64, MOTION, ERRORS>;

/// The 95 % quantile of χ² with 6 degrees of freedom, above which tails count.
const ORDINARY: f64 = 12.591_587;

/// One track.
///
/// A frame's position is `p + S a + n` and its orientation `R exp([S b + n]×)`: `a` and `b` have unit variance and
/// are correlated from frame to frame, `n` is new in each frame, and the roots `S` are those of the covariance that the network
/// gives with the frame. What correlates is thus measured in the network's own standard deviations, which differ from view to view.
///
/// `a` and `b` are *considered*, not estimated (Schmidt, *Advances in Control Systems* 3, 1966): their covariances with the motion
/// are kept, and their estimates are zero. Errors do not follow the standard deviations so closely that the change of
/// these from frame to frame could tell `S a` from `p`, which is what an estimate of them would rest on. So the covariance of `a` and `b`
/// is one at all times, and is not held.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Filter {
    /// Position of the object, m, camera frame.
    pub position: Vector3<f64>,
    /// Velocity, m/s, camera axes.
    pub velocity: Vector3<f64>,
    /// Orientation, from the object's to the camera's axes.
    pub orientation: UnitQuaternion<f64>,
    /// Angular velocity, rad/s, object's axes; with a gyro or in an orbit that against a camera that does not turn.
    pub rate: Vector3<f64>,
    /// Covariance of their errors, in this order.
    pub covariance: Covariance,
    /// Covariance of them with `a` and `b`.
    pub(crate) cross: Cross,
}

/// What a frame would change, and how surprising it is.
#[derive(Clone, Copy, Debug)]
pub struct Innovation {
    /// Squared Mahalanobis distance (6 degrees of freedom) of the frame from what was expected.
    pub nis: f64,
    residual: Vector6<f64>,
    /// Covariances of the residual with the motion's error, and with `a` and `b`.
    of_motion: Cross,
    of_errors: Matrix6<f64>,
    /// Covariance of the residual, and its factor.
    covariance: Matrix6<f64>,
    factor: Cholesky<f64, Const<6>>,
    /// Covariance of what is new in the frame.
    noise: Matrix6<f64>,
    /// The roots `S` of what correlates.
    roots: Matrix6<f64>,
}

impl Filter {
    /// Starts at the pose of a frame; velocities are unknown.
    #[must_use]
    pub fn new(mode: &Mode, parameters: &Parameters) -> Self {
        let (mut covariance, mut cross) = (Covariance::zeros(), Cross::zeros());
        let roots = correlated_roots(mode, parameters);
        for (place, block, rows) in [
            (POSITION, mode.position_covariance, roots.fixed_rows::<3>(POSITION_BIAS)),
            (ATTITUDE, mode.attitude_covariance, roots.fixed_rows::<3>(ATTITUDE_BIAS)),
        ] {
            covariance.fixed_view_mut::<3, 3>(place, place).copy_from(&block);
            cross.fixed_rows_mut::<3>(place).copy_from(&-rows);
        }
        for (place, sd) in [(VELOCITY, parameters.velocity), (RATE, parameters.rate)] {
            covariance.fixed_view_mut::<3, 3>(place, place).fill_diagonal(sd * sd);
        }
        let zero = Vector3::zeros();
        Self {
            position: mode.position,
            velocity: zero,
            orientation: mode.orientation,
            rate: zero,
            covariance,
            cross,
        }
    }

    /// Compares a frame with what is expected; None where the numbers do not allow it.
    #[must_use]
    pub fn innovation(&self, mode: &Mode, parameters: &Parameters) -> Option<Innovation> {
        let roots = correlated_roots(mode, parameters);
        let turned = (self.orientation.inverse() * mode.orientation).scaled_axis();
        let mut residual = Vector6::zeros();
        residual.fixed_rows_mut::<3>(0).copy_from(&(mode.position - self.position));
        residual.fixed_rows_mut::<3>(3).copy_from(&turned);

        let of_motion = seen(&self.covariance) + self.cross * roots;
        let of_errors = seen(&self.cross.transpose()) + roots;
        let noise = block_diagonal(
            &(mode.position_covariance * parameters.position_noise),
            &(mode.attitude_covariance * parameters.attitude_noise),
        );
        let covariance = seen(&of_motion.transpose()).transpose() + roots * of_errors + noise;
        let covariance = (covariance + covariance.transpose()) * 0.5;
        let factor = Cholesky::new(covariance)?;
        let nis = residual.dot(&factor.solve(&residual));
        nis.is_finite().then_some(Innovation {
            nis,
            residual,
            of_motion,
            of_errors,
            covariance,
            factor,
            noise,
            roots,
        })
    }

    /// Takes a frame in, with the weight of errors of such tails, 1 for an ordinary frame.
    ///
    /// Student's t: a residual counts as one of a covariance larger by the inverse of the weight. The covariance after it
    /// is of Joseph's form, and the attitude's error is turned to the new attitude (the reset).
    pub fn correct(&mut self, innovation: &Innovation, parameters: &Parameters) {
        let tails = parameters.tails;
        let weight = if tails.is_finite() && innovation.nis > ORDINARY {
            (tails + ORDINARY) / (tails + innovation.nis)
        } else {
            1.0
        };
        // all that is not explained by the state counts as noise
        let noise = innovation.noise + innovation.covariance * (1.0 / weight - 1.0);
        let gain = innovation.factor.solve(&innovation.of_motion.transpose()).transpose() * weight;
        let change = gain * innovation.residual;

        // (1 - K H) P (1 - K H)ᵀ + K R Kᵀ, one factor at a time
        let left = self.covariance - gain * innovation.of_motion.transpose();
        self.cross -= gain * innovation.of_errors.transpose();
        let rest = gain * noise - seen(&left) - self.cross * innovation.roots;
        self.covariance = left + rest * gain.transpose();
        self.apply(&change);
        self.tidy();
    }

    /// Adds the estimated error to the state, after which none is left.
    fn apply(&mut self, change: &SVector<f64, MOTION>) {
        let part = |place: usize| Vector3::from(change.fixed_rows::<3>(place));
        self.position += part(POSITION);
        self.velocity += part(VELOCITY);
        self.rate += part(RATE);
        let turn = part(ATTITUDE);
        self.orientation *= UnitQuaternion::from_scaled_axis(turn);
        self.orientation.renormalize();
        let reset = right_jacobian(&turn);
        turn_rows(&mut self.cross, ATTITUDE, &reset);
        for _ in 0..2 {
            turn_rows(&mut self.covariance, ATTITUDE, &reset);
            self.covariance.transpose_mut();
        }
    }

    /// Takes from the covariance what rounding has left on one side of the diagonal.
    pub(crate) fn tidy(&mut self) {
        let mirrored = self.covariance.transpose();
        self.covariance = (self.covariance + mirrored) * 0.5;
    }

    /// Whether all numbers are finite and the covariance, the network's errors included, is positive definite.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        let parts = [self.position, self.velocity, self.rate];
        parts.iter().flatten().chain(&self.orientation.coords).all(|number| number.is_finite())
            && Cholesky::new(self.covariance - self.cross * self.cross.transpose()).is_some()
    }
}

/// The roots of the share of the covariances that correlates from frame to frame.
fn correlated_roots(mode: &Mode, parameters: &Parameters) -> Matrix6<f64> {
    block_diagonal(
        &(mode.position_root * libm::sqrt(1.0 - parameters.position_noise)),
        &(mode.attitude_root * libm::sqrt(1.0 - parameters.attitude_noise)),
    )
}

fn block_diagonal(position: &Matrix3<f64>, attitude: &Matrix3<f64>) -> Matrix6<f64> {
    let mut matrix = Matrix6::zeros();
    matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(position);
    matrix.fixed_view_mut::<3, 3>(3, 3).copy_from(attitude);
    matrix
}

/// The columns of what a frame shows: position and attitude.
fn seen<const ROWS: usize>(all: &SMatrix<f64, ROWS, MOTION>) -> SMatrix<f64, ROWS, 6> {
    let mut columns = SMatrix::<f64, ROWS, 6>::zeros();
    columns.fixed_columns_mut::<3>(0).copy_from(&all.fixed_columns::<3>(POSITION));
    columns.fixed_columns_mut::<3>(3).copy_from(&all.fixed_columns::<3>(ATTITUDE));
    columns
}

/// Multiplies three rows by a matrix.
pub(crate) fn turn_rows<const COLUMNS: usize>(
    all: &mut SMatrix<f64, MOTION, COLUMNS>,
    place: usize,
    by: &Matrix3<f64>,
) {
    let rows = by * all.fixed_rows::<3>(place);
    all.fixed_rows_mut::<3>(place).copy_from(&rows);
}
