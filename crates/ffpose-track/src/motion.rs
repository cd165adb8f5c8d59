//! How a state moves on between two frames: constant velocity and angular velocity, with white accelerations.

use libm::{exp, sqrt};
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use crate::filter::{
    ATTITUDE, ATTITUDE_BIAS, Covariance, Filter, POSITION, POSITION_BIAS, RATE, VELOCITY,
};
use crate::parameters::Parameters;
use crate::rotation::Turn;

impl Filter {
    /// Moves on by `t` seconds, with noise discretized exactly for any `t`.
    ///
    /// `camera_rate` is the camera's own angular velocity, rad/s along its axes, as a gyro measures it, or zero. Velocity and
    /// angular velocity are then those against a camera that does not turn, along the axes of the one that does.
    ///
    /// Returns the angle, radians, by which the object has turned as the camera sees it.
    pub fn predict(&mut self, t: f64, camera_rate: &Vector3<f64>, parameters: &Parameters) -> f64 {
        let angle = self.angle_turned(t);
        let turn = Turn::new(&self.rate, t);
        self.position += self.velocity * t;
        self.orientation *= UnitQuaternion::from_scaled_axis(self.rate * t);
        self.orientation.renormalize();
        let p = &mut self.covariance;
        let kept =
            [exp(-angle / parameters.position_angle), exp(-angle / parameters.attitude_angle)];
        move_rows(p, t, &turn, kept);
        p.transpose_mut();
        move_rows(p, t, &turn, kept);
        let white = parameters.acceleration * parameters.acceleration;
        add(p, POSITION, POSITION, &Matrix3::from_diagonal_element(white * t * t * t / 3.0));
        add(p, POSITION, VELOCITY, &Matrix3::from_diagonal_element(white * t * t / 2.0));
        add(p, VELOCITY, VELOCITY, &Matrix3::from_diagonal_element(white * t));
        let white = parameters.angular_acceleration * parameters.angular_acceleration;
        add(p, ATTITUDE, ATTITUDE, &(turn.square * white));
        add(p, ATTITUDE, RATE, &(turn.cross * white));
        add(p, RATE, RATE, &Matrix3::from_diagonal_element(white * t));
        for (place, kept) in [POSITION_BIAS, ATTITUDE_BIAS].into_iter().zip(kept) {
            add(p, place, place, &Matrix3::from_diagonal_element(1.0 - kept * kept));
        }
        if *camera_rate != Vector3::zeros() {
            self.turn_camera(&UnitQuaternion::from_scaled_axis(camera_rate * t));
        }
        self.tidy();
        angle
    }

    /// The angle, radians, by which the object will have turned after `t` seconds as the camera sees it.
    ///
    /// The side that is seen changes with the object's rotation and with the direction in which it stands. An uncertain
    /// angular velocity counts with its variance.
    fn angle_turned(&self, t: f64) -> f64 {
        let square = self.position.norm_squared().max(f64::MIN_POSITIVE);
        let of_ray = self.position.cross(&self.velocity) / square;
        let seen = self.rate - self.orientation.inverse_transform_vector(&of_ray);
        let variance = self.covariance.fixed_view::<3, 3>(RATE, RATE).trace();
        sqrt(seen.norm_squared() + variance) * t
    }

    /// Expresses the state along the axes of a camera that has turned by `turn`, along its own axes.
    fn turn_camera(&mut self, turn: &UnitQuaternion<f64>) {
        let back = turn.inverse();
        self.position = back * self.position;
        self.velocity = back * self.velocity;
        self.position_bias = back * self.position_bias;
        self.orientation = back * self.orientation;
        let matrix = back.to_rotation_matrix().into_inner();
        for _ in 0..2 {
            for place in [POSITION, VELOCITY, POSITION_BIAS] {
                let rows = matrix * self.covariance.fixed_rows::<3>(place);
                self.covariance.fixed_rows_mut::<3>(place).copy_from(&rows);
            }
            self.covariance.transpose_mut();
        }
    }
}

/// `F P`, where `F` is the transition of the errors.
fn move_rows(p: &mut Covariance, t: f64, turn: &Turn, kept: [f64; 2]) {
    let rows = p.fixed_rows::<3>(POSITION) + p.fixed_rows::<3>(VELOCITY) * t;
    p.fixed_rows_mut::<3>(POSITION).copy_from(&rows);
    let rows = turn.error * p.fixed_rows::<3>(ATTITUDE) + turn.of_rate * p.fixed_rows::<3>(RATE);
    p.fixed_rows_mut::<3>(ATTITUDE).copy_from(&rows);
    for (place, kept) in [POSITION_BIAS, ATTITUDE_BIAS].into_iter().zip(kept) {
        let mut rows = p.fixed_rows_mut::<3>(place);
        rows *= kept;
    }
}

/// Adds a block, and its mirror image off the diagonal.
fn add(p: &mut Covariance, row: usize, column: usize, block: &Matrix3<f64>) {
    let mut place = p.fixed_view_mut::<3, 3>(row, column);
    place += block;
    if row != column {
        let mut place = p.fixed_view_mut::<3, 3>(column, row);
        place += block.transpose();
    }
}
