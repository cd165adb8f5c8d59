//! The settings of a tracker: what it expects of the motion, of the network's errors, and how it decides.

use core::slice;

use libm::fabs;
use nalgebra::{Matrix3, Vector3};

use crate::error::Error;
use crate::measurement::finite;

/// The settings of a [`Tracker`](crate::Tracker), in SI units and radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameters {
    /// White acceleration of the relative motion, m/s² per √Hz.
    pub acceleration: f64,
    /// White angular acceleration, rad/s² per √Hz.
    pub angular_acceleration: f64,
    /// What is not known of the angular acceleration of a free body, as a share of the square of its angular velocity, white
    /// over the time of a radian: for want of its inertia, or for the errors of it.
    pub asymmetry: f64,
    /// Inertia about the object's axes, of any unit: xx, yy, zz, xy, xz, yz. The object turns as a free rigid body does, a sphere at
    /// a constant angular velocity.
    pub inertia: [f64; 6],
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
    /// Independent views that count as much as the network's own covariances for how large its errors are in a track; infinite
    /// where its covariances alone count.
    pub said_views: f64,
    /// Mean squared Mahalanobis distance (6 degrees of freedom) of frames whose errors are as large as the network says.
    pub ordinary_nis: f64,
    /// Frames in agreement that make a track.
    pub agreeing: f64,
    /// Seconds without a believed frame after which the track is lost, told by frames that say nothing or not.
    pub coasting: f64,
    /// The orbit's angular velocity, rad/s along the camera's axes, of a camera that keeps its attitude to the Earth:
    /// position and velocity then move as Clohessy and Wiltshire's equations say; zero for straight lines.
    pub orbital_rate: [f64; 3],
    /// Unit vector away from the Earth, along the camera's axes; counts with an orbital rate alone.
    pub zenith: [f64; 3],
}

/// How many numbers [`Parameters`] are.
pub(crate) const NUMBERS: usize = 27;

/// The inertia of a sphere.
const SPHERE: [f64; 6] = [1.0, 1.0, 1.0, 0.0, 0.0, 0.0];

impl Default for Parameters {
    fn default() -> Self {
        Self {
            acceleration: 1e-4,
            angular_acceleration: 0.001f64.to_radians(),
            asymmetry: 0.12,
            inertia: SPHERE,
            velocity: 0.3,
            rate: 5f64.to_radians(),
            position_angle: 20f64.to_radians(),
            attitude_angle: 15f64.to_radians(),
            position_noise: 0.2,
            attitude_noise: 0.3,
            gate: 60.0,
            tails: 3.0,
            said_views: 3.0,
            ordinary_nis: 2.0,
            agreeing: 4.0,
            coasting: 10.0,
            orbital_rate: [0.0; 3],
            zenith: [0.0, -1.0, 0.0],
        }
    }
}

/// How far from one the norm of the zenith may be, and from zero its cosine with the orbit's normal.
const DIRECTION_TOLERANCE: f64 = 1e-3;

/// By what share of its trace an inertia may be rounded.
const INERTIA_TOLERANCE: f64 = 1e-6;

impl Parameters {
    /// The numbers, in the order of the fields.
    pub(crate) fn to_array(self) -> [f64; NUMBERS] {
        let p = self;
        let ([rx, ry, rz], [zx, zy, zz]) = (p.orbital_rate, p.zenith);
        let [ixx, iyy, izz, ixy, ixz, iyz] = p.inertia;
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
            rx,
            ry,
            rz,
            zx,
            zy,
            zz,
            p.asymmetry,
            ixx,
            iyy,
            izz,
            ixy,
            ixz,
            iyz,
            p.said_views,
            p.ordinary_nis,
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
            orbital_rate: [n[12], n[13], n[14]],
            zenith: [n[15], n[16], n[17]],
            asymmetry: n[18],
            inertia: [n[19], n[20], n[21], n[22], n[23], n[24]],
            said_views: n[25],
            ordinary_nis: n[26],
        }
    }

    /// Sets a setting by its name: a number, or those of a vector; angles and their rates in degrees.
    ///
    /// # Errors
    ///
    /// There is no such setting, or it has another number of numbers.
    pub fn set(&mut self, name: &str, values: &[f64]) -> Result<(), Error> {
        const DEGREE: f64 = core::f64::consts::PI / 180.0;
        let (place, unit): (&mut [f64], f64) = match name {
            "acceleration" => (slice::from_mut(&mut self.acceleration), 1.0),
            "angular_acceleration" => (slice::from_mut(&mut self.angular_acceleration), DEGREE),
            "asymmetry" => (slice::from_mut(&mut self.asymmetry), 1.0),
            "inertia" => (&mut self.inertia, 1.0),
            "velocity" => (slice::from_mut(&mut self.velocity), 1.0),
            "rate" => (slice::from_mut(&mut self.rate), DEGREE),
            "position_angle" => (slice::from_mut(&mut self.position_angle), DEGREE),
            "attitude_angle" => (slice::from_mut(&mut self.attitude_angle), DEGREE),
            "position_noise" => (slice::from_mut(&mut self.position_noise), 1.0),
            "attitude_noise" => (slice::from_mut(&mut self.attitude_noise), 1.0),
            "gate" => (slice::from_mut(&mut self.gate), 1.0),
            "tails" => (slice::from_mut(&mut self.tails), 1.0),
            "said_views" => (slice::from_mut(&mut self.said_views), 1.0),
            "ordinary_nis" => (slice::from_mut(&mut self.ordinary_nis), 1.0),
            "agreeing" => (slice::from_mut(&mut self.agreeing), 1.0),
            "coasting" => (slice::from_mut(&mut self.coasting), 1.0),
            "orbital_rate" => (&mut self.orbital_rate, DEGREE),
            "zenith" => (&mut self.zenith, 1.0),
            _ => return Err(Error::Setting),
        };
        if place.len() != values.len() {
            return Err(Error::Numbers { expected: place.len() });
        }
        for (place, value) in place.iter_mut().zip(values) {
            *place = value * unit;
        }
        Ok(())
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
            (
                "asymmetry",
                self.asymmetry,
                "a finite number of at least 0",
                at_least_zero(self.asymmetry),
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
            ("said_views", self.said_views, "a number above 0", self.said_views > 0.0),
            (
                "ordinary_nis",
                self.ordinary_nis,
                "a finite number above 0",
                above_zero(self.ordinary_nis),
            ),
            ("agreeing", self.agreeing, "a number of at least 1", self.agreeing >= 1.0),
            ("coasting", self.coasting, "a number above 0", self.coasting > 0.0),
        ] {
            if !accept {
                return Err(Error::Parameter { name, expected, got });
            }
        }
        self.check_body()?;
        self.check_orbit()
    }

    /// Whether the angular velocity of a free body changes.
    pub(crate) fn has_body(&self) -> bool {
        self.inertia[..3] != [self.inertia[0]; 3] || self.inertia[3..] != [0.0; 3]
    }

    /// The inertia as a matrix.
    pub(crate) fn inertia(&self) -> Matrix3<f64> {
        let [xx, yy, zz, xy, xz, yz] = self.inertia;
        Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)
    }

    /// The principal moments of a body are positive, and none is larger than the others' sum.
    fn check_body(&self) -> Result<(), Error> {
        finite("inertia", self.inertia.iter())?;
        let inertia = self.inertia();
        // of the mass: ∫ r rᵀ dm
        let spread = Matrix3::from_diagonal_element(inertia.trace() / 2.0) - inertia;
        let scale = inertia.trace();
        for (matrix, least) in [(inertia, 0.0), (spread, -INERTIA_TOLERANCE * scale)] {
            let got = matrix.symmetric_eigenvalues().min();
            if got <= least {
                let (name, expected) = (
                    "inertia",
                    "that of a body: three positive moments, none larger than the others' sum",
                );
                return Err(Error::Parameter { name, expected, got });
            }
        }
        Ok(())
    }

    /// Whether position and velocity move as in an orbit.
    pub(crate) fn has_orbit(&self) -> bool {
        self.orbital_rate.iter().any(|part| *part != 0.0)
    }

    fn check_orbit(&self) -> Result<(), Error> {
        let (rate, zenith) = (Vector3::from(self.orbital_rate), Vector3::from(self.zenith));
        finite("orbital_rate", rate.iter())?;
        finite("zenith", zenith.iter())?;
        if fabs(zenith.norm() - 1.0) > DIRECTION_TOLERANCE {
            let (name, expected) = ("zenith", "a vector of norm 1");
            return Err(Error::Parameter { name, expected, got: zenith.norm() });
        }
        if fabs(rate.dot(&zenith)) > DIRECTION_TOLERANCE * rate.norm() {
            let (name, expected) = ("orbital_rate", "a vector across the zenith, a cosine of 0");
            return Err(Error::Parameter { name, expected, got: rate.dot(&zenith) / rate.norm() });
        }
        Ok(())
    }
}

fn share(x: f64) -> bool {
    x > 0.0 && x <= 1.0
}
