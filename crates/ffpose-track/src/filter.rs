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
pub(crate) const POSITION_BIAS: usize = 12;
pub(crate) const ATTITUDE_BIAS: usize = 15;

/// The numbers of an error.
const STATES: usize = 18;

/// The covariance of the error `(δp, δv, θ, δω, a, b)`: m, m/s, rad, rad/s, and two of unit variance.
pub type Covariance = SMatrix<f64, STATES, STATES>;

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
/// these from frame to frame could tell `S a` from `p`, which is what an estimate of them would rest on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Filter {
    /// Position of the object, m, camera frame.
    pub position: Vector3<f64>,
    /// Velocity, m/s, camera axes.
    pub velocity: Vector3<f64>,
    /// Orientation, from the object's to the camera's axes.
    pub orientation: UnitQuaternion<f64>,
    /// Angular velocity, rad/s, object's axes.
    pub rate: Vector3<f64>,
    /// Covariance of the errors, in this order.
    pub covariance: Covariance,
}

/// What a frame would change, and how surprising it is.
#[derive(Clone, Copy, Debug)]
pub struct Innovation {
    /// Squared Mahalanobis distance (6 degrees of freedom) of the frame from what was expected.
    pub nis: f64,
    residual: Vector6<f64>,
    /// `H P`.
    projected: SMatrix<f64, 6, STATES>,
    /// Covariance of the residual.
    covariance: Matrix6<f64>,
    /// Covariance of what is new in the frame.
    noise: Matrix6<f64>,
    roots: [Matrix3<f64>; 2],
}

impl Filter {
    /// Starts at the pose of a frame; velocities are unknown.
    #[must_use]
    pub fn new(mode: &Mode, parameters: &Parameters) -> Self {
        let mut covariance = Covariance::identity();
        let roots = correlated_roots(mode, parameters);
        for (place, bias, block, root) in [
            (POSITION, POSITION_BIAS, mode.position_covariance, roots[0]),
            (ATTITUDE, ATTITUDE_BIAS, mode.attitude_covariance, roots[1]),
        ] {
            covariance.fixed_view_mut::<3, 3>(place, place).copy_from(&block);
            covariance.fixed_view_mut::<3, 3>(place, bias).copy_from(&-root);
            covariance.fixed_view_mut::<3, 3>(bias, place).copy_from(&-root);
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

        let p = &self.covariance;
        let mut projected = SMatrix::<f64, 6, STATES>::zeros();
        let rows = p.fixed_rows::<3>(POSITION) + roots[0] * p.fixed_rows::<3>(POSITION_BIAS);
        projected.fixed_rows_mut::<3>(0).copy_from(&rows);
        let rows = p.fixed_rows::<3>(ATTITUDE) + roots[1] * p.fixed_rows::<3>(ATTITUDE_BIAS);
        projected.fixed_rows_mut::<3>(3).copy_from(&rows);

        let mut noise = Matrix6::zeros();
        noise
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&(mode.position_covariance * parameters.position_noise));
        noise
            .fixed_view_mut::<3, 3>(3, 3)
            .copy_from(&(mode.attitude_covariance * parameters.attitude_noise));
        let covariance = observed(&projected, &roots) + noise;
        let covariance = (covariance + covariance.transpose()) * 0.5;
        let solved = Cholesky::new(covariance)?.solve(&residual);
        let nis = residual.dot(&solved);
        nis.is_finite().then_some(Innovation { nis, residual, projected, covariance, noise, roots })
    }

    /// Takes a frame in, with the weight of errors of such tails; returns the weight, 1 for an ordinary frame.
    ///
    /// Student's t: a residual counts as one of a covariance larger by the inverse of the weight. The covariance after it
    /// is of Joseph's form, and the attitude's error is turned to the new attitude (the reset).
    pub fn correct(&mut self, innovation: &Innovation, parameters: &Parameters) -> f64 {
        let tails = parameters.tails;
        let weight = if tails.is_finite() && innovation.nis > ORDINARY {
            (tails + ORDINARY) / (tails + innovation.nis)
        } else {
            1.0
        };
        let covariance = innovation.covariance / weight;
        let Some(factor) = Cholesky::new(covariance) else { return 0.0 };
        // all that is not explained by the state counts as noise
        let noise = innovation.noise + innovation.covariance * (1.0 / weight - 1.0);
        let mut gain: SMatrix<f64, STATES, 6> = factor.solve(&innovation.projected).transpose();
        gain.fixed_rows_mut::<6>(POSITION_BIAS).fill(0.0);
        let change = gain * innovation.residual;

        // (1 - K H) P (1 - K H)ᵀ + K R Kᵀ, one factor at a time
        let left = self.covariance - gain * innovation.projected;
        let seen = observed(&left, &innovation.roots);
        self.covariance = left - seen * gain.transpose() + gain * noise * gain.transpose();
        self.apply(&change);
        self.tidy();
        weight
    }

    /// Adds the estimated error to the state, after which none is left.
    fn apply(&mut self, change: &SVector<f64, STATES>) {
        let part = |place: usize| Vector3::from(change.fixed_rows::<3>(place));
        self.position += part(POSITION);
        self.velocity += part(VELOCITY);
        self.rate += part(RATE);
        let turn = part(ATTITUDE);
        self.orientation *= UnitQuaternion::from_scaled_axis(turn);
        self.orientation.renormalize();
        let reset = right_jacobian(&turn);
        for _ in 0..2 {
            let rows = reset * self.covariance.fixed_rows::<3>(ATTITUDE);
            self.covariance.fixed_rows_mut::<3>(ATTITUDE).copy_from(&rows);
            self.covariance.transpose_mut();
        }
    }

    /// Takes from the covariance what rounding has left on one side of the diagonal.
    pub(crate) fn tidy(&mut self) {
        let mirrored = self.covariance.transpose();
        self.covariance = (self.covariance + mirrored) * 0.5;
    }

    /// Whether all numbers are finite and the covariance is positive definite.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        let parts = [self.position, self.velocity, self.rate];
        parts.iter().flatten().chain(&self.orientation.coords).all(|number| number.is_finite())
            && Cholesky::<f64, Const<STATES>>::new(self.covariance).is_some()
    }
}

/// The roots of the share of the covariances that correlates from frame to frame.
fn correlated_roots(mode: &Mode, parameters: &Parameters) -> [Matrix3<f64>; 2] {
    [
        mode.position_root * libm::sqrt(1.0 - parameters.position_noise),
        mode.attitude_root * libm::sqrt(1.0 - parameters.attitude_noise),
    ]
}

/// `A Hᵀ`.
fn observed<const ROWS: usize>(
    a: &SMatrix<f64, ROWS, STATES>,
    roots: &[Matrix3<f64>; 2],
) -> SMatrix<f64, ROWS, 6> {
    let mut seen = SMatrix::<f64, ROWS, 6>::zeros();
    let columns = a.fixed_columns::<3>(POSITION) + a.fixed_columns::<3>(POSITION_BIAS) * roots[0];
    seen.fixed_columns_mut::<3>(0).copy_from(&columns);
    let columns = a.fixed_columns::<3>(ATTITUDE) + a.fixed_columns::<3>(ATTITUDE_BIAS) * roots[1];
    seen.fixed_columns_mut::<3>(3).copy_from(&columns);
    seen
}
