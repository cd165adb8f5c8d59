//! The settings of a tracker: what it expects of the motion, of the network's errors, and how it decides.

use crate::error::Error;

/// The settings of a [`Tracker`](crate::Tracker), in SI units and radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameters {
    /// White acceleration of the relative motion, m/s² per √Hz.
    pub acceleration: f64,
    /// White angular acceleration, rad/s² per √Hz.
    pub angular_acceleration: f64,
    /// Standard deviation of each component of a velocity not yet seen, m/s.
    pub velocity: f64,
    /// Standard deviation of each component of an angular velocity not yet seen, rad/s.
    pub rate: f64,
    /// Angle turned at which the correlation of the position's errors has fallen to 1/e, rad.
    pub position_angle: f64,
    /// The same of the attitude's errors, rad.
    pub attitude_angle: f64,
    /// Share of the position's variance that is new in each frame, 0…1.
    pub position_noise: f64,
    /// The same of the attitude's, 0…1.
    pub attitude_noise: f64,
    /// Squared Mahalanobis distance (6 degrees of freedom) above which a frame is not believed; infinite for none.
    pub gate: f64,
    /// Degrees of freedom of the errors' tails, by which frames far off count less; infinite for Gaussian errors.
    pub tails: f64,
    /// Frames in agreement that make a track.
    pub agreeing: f64,
    /// Seconds without a believed frame after which the track is lost.
    pub coasting: f64,
}

/// How many numbers [`Parameters`] are.
pub(crate) const NUMBERS: usize = 12;

impl Default for Parameters {
    fn default() -> Self {
        Self {
            acceleration: 2e-3,
            angular_acceleration: 1e-3,
            velocity: 0.3,
            rate: 5f64.to_radians(),
            position_angle: 40f64.to_radians(),
            attitude_angle: 25f64.to_radians(),
            position_noise: 0.02,
            attitude_noise: 0.02,
            gate: 30.0,
            tails: 5.0,
            agreeing: 4.0,
            coasting: 10.0,
        }
    }
}

impl Parameters {
    /// The numbers, in the order of the fields.
    pub(crate) fn to_array(self) -> [f64; NUMBERS] {
        let p = self;
        [
            p.acceleration,
            p.angular_acceleration,
            p.velocity,
            p.rate,
            p.position_angle,
            p.attitude_angle,
            p.position_noise,
            p.attitude_noise,
            p.gate,
            p.tails,
            p.agreeing,
            p.coasting,
        ]
    }

    /// The settings of [`Self::to_array`].
    pub(crate) fn from_array(n: [f64; NUMBERS]) -> Self {
        Self {
            acceleration: n[0],
            angular_acceleration: n[1],
            velocity: n[2],
            rate: n[3],
            position_angle: n[4],
            attitude_angle: n[5],
            position_noise: n[6],
            attitude_noise: n[7],
            gate: n[8],
            tails: n[9],
            agreeing: n[10],
            coasting: n[11],
        }
    }

    /// Checks each setting.
    ///
    /// # Errors
    ///
    /// A setting is out of its range, or not a number.
    pub fn check(&self) -> Result<(), Error> {
        let finite = f64::is_finite;
        let at_least_zero = |x: f64| finite(x) && x >= 0.0;
        let above_zero = |x: f64| finite(x) && x > 0.0;
        for (name, got, expected, accept) in [
            (
                "acceleration",
                self.acceleration,
                "a finite number of at least 0",
                at_least_zero(self.acceleration),
            ),
            (
                "angular_acceleration",
                self.angular_acceleration,
                "a finite number of at least 0",
                at_least_zero(self.angular_acceleration),
            ),
            ("velocity", self.velocity, "a finite number above 0", above_zero(self.velocity)),
            ("rate", self.rate, "a finite number above 0", above_zero(self.rate)),
            (
                "position_angle",
                self.position_angle,
                "an angle above 0",
                above_zero(self.position_angle),
            ),
            (
                "attitude_angle",
                self.attitude_angle,
                "an angle above 0",
                above_zero(self.attitude_angle),
            ),
            (
                "position_noise",
                self.position_noise,
                "a share above 0, up to 1",
                share(self.position_noise),
            ),
            (
                "attitude_noise",
                self.attitude_noise,
                "a share above 0, up to 1",
                share(self.attitude_noise),
            ),
            ("gate", self.gate, "a number above 0", self.gate > 0.0),
            ("tails", self.tails, "a number above 0", self.tails > 0.0),
            ("agreeing", self.agreeing, "a number of at least 1", self.agreeing >= 1.0),
            ("coasting", self.coasting, "a number above 0", self.coasting > 0.0),
        ] {
            if !accept {
                return Err(Error::Parameter { name, expected, got });
            }
        }
        Ok(())
    }
}

fn share(x: f64) -> bool {
    x > 0.0 && x <= 1.0
}
