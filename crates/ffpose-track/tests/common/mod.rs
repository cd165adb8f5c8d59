//! Frames of an object that moves steadily, with errors that a test draws.

#![allow(dead_code)] // each file of tests uses some of it

use ffpose_track::{Measurement, Mode, Parameters};
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

/// Uniform numbers by xorshift64*, and normal ones by sums of twelve.
pub struct Random(pub u64);

impl Random {
    pub fn uniform(&mut self) -> f64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 11) as f64 / (1u64 << 53) as f64
    }

    pub fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }

    pub fn vector(&mut self) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.normal())
    }
}

/// A pose and the covariances that a network gives with it, in the camera's axes.
#[derive(Clone, Copy)]
pub struct Shown {
    pub position: Vector3<f64>,
    pub orientation: UnitQuaternion<f64>,
    pub position_covariance: Matrix3<f64>,
    pub rotation_covariance: Matrix3<f64>,
}

impl Shown {
    /// The pose after `t` seconds of a steady tumble, with errors of a centimeter and a quarter of a degree.
    pub fn tumbling(t: f64, random: &mut Random) -> Self {
        let spread = Matrix3::from_diagonal(&Vector3::new(0.02, 0.03, 0.1));
        let turned = Matrix3::from_diagonal(&Vector3::new(0.01, 0.012, 0.006));
        let rate = Vector3::new(0.01, -0.02, 0.03);
        let start = UnitQuaternion::from_euler_angles(0.4, -0.3, 2.0);
        Self {
            position: Vector3::new(1.0 + 0.01 * t, -0.5, 20.0 - 0.05 * t)
                + spread * random.vector() * 0.2,
            orientation: start
                * UnitQuaternion::from_scaled_axis(rate * t)
                * UnitQuaternion::from_scaled_axis(turned * random.vector() * 0.2),
            position_covariance: spread * spread,
            rotation_covariance: turned * turned,
        }
    }

    /// The same as another camera sees it, turned by `turn`.
    pub fn turned(&self, turn: &UnitQuaternion<f64>) -> Self {
        let m = turn.to_rotation_matrix().into_inner();
        Self {
            position: turn * self.position,
            orientation: turn * self.orientation,
            position_covariance: m * self.position_covariance * m.transpose(),
            rotation_covariance: m * self.rotation_covariance * m.transpose(),
        }
    }

    pub fn mode(&self, sign: f64, probability: f64) -> Mode {
        let q = self.orientation.quaternion();
        Mode::new(
            self.position.into(),
            [q.w, q.i, q.j, q.k].map(|number| number * sign),
            self.position_covariance.into(),
            self.rotation_covariance.into(),
            probability,
        )
        .unwrap()
    }

    pub fn measurement(&self) -> Measurement {
        Measurement::new(&[self.mode(1.0, 1.0)]).unwrap()
    }
}

/// Settings of a tracker that believes the first frame.
pub fn trusting() -> Parameters {
    Parameters { agreeing: 1.0, ..Parameters::default() }
}
