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
    /// position and velocity then move as Clohessy and Wiltshire's equations say, and the object turns against the stars; zero
    /// for straight lines.
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

/// An orbit slower than this, rad/s, is none: its square is nothing, and so would be its direction.
const LEAST_RATE: f64 = 1e-100;

/// By what share of its trace an inertia may be rounded.
const INERTIA_TOLERANCE: f64 = 1e-6;

/// A setting: its name, that of 1 in its unit to those who set it, what it may be, and its numbers.
struct Setting<'a>(&'static str, f64, Range, &'a mut [f64]);

/// What a number may be, in words and as a condition.
type Range = (&'static str, fn(f64) -> bool);

const AT_LEAST_0: Range = ("a finite number of at least 0", |x| x.is_finite() && x >= 0.0);
const FINITE: Range = ("a finite number above 0", |x| x.is_finite() && x > 0.0);
const ANGLE: Range = ("an angle above 0", FINITE.1);
const SHARE: Range = ("a share above 0, up to 1", |x| x > 0.0 && x <= 1.0);
const ABOVE_0: Range = ("a number above 0", |x| x > 0.0);
const AT_LEAST_1: Range = ("a number of at least 1", |x| x >= 1.0);
/// That of vectors, which are checked as such.
const ANY: Range = ("a number", |_| true);

const DEGREE: f64 = core::f64::consts::PI / 180.0;

impl Parameters {
    /// The settings, in the order of a saved state.
    fn settings(&mut self) -> [Setting<'_>; 18] {
        let one = slice::from_mut::<f64>;
        [
            Setting("acceleration", 1.0, AT_LEAST_0, one(&mut self.acceleration)),
            Setting(
                "angular_acceleration",
                DEGREE,
                AT_LEAST_0,
                one(&mut self.angular_acceleration),
            ),
            Setting("velocity", 1.0, FINITE, one(&mut self.velocity)),
            Setting("rate", DEGREE, FINITE, one(&mut self.rate)),
            Setting("position_angle", DEGREE, ANGLE, one(&mut self.position_angle)),
            Setting("attitude_angle", DEGREE, ANGLE, one(&mut self.attitude_angle)),
            Setting("position_noise", 1.0, SHARE, one(&mut self.position_noise)),
            Setting("attitude_noise", 1.0, SHARE, one(&mut self.attitude_noise)),
            Setting("gate", 1.0, ABOVE_0, one(&mut self.gate)),
            Setting("tails", 1.0, ABOVE_0, one(&mut self.tails)),
            Setting("agreeing", 1.0, AT_LEAST_1, one(&mut self.agreeing)),
            Setting("coasting", 1.0, ABOVE_0, one(&mut self.coasting)),
            Setting("orbital_rate", DEGREE, ANY, &mut self.orbital_rate),
            Setting("zenith", 1.0, ANY, &mut self.zenith),
            Setting("asymmetry", 1.0, AT_LEAST_0, one(&mut self.asymmetry)),
            Setting("inertia", 1.0, ANY, &mut self.inertia),
            Setting("said_views", 1.0, ABOVE_0, one(&mut self.said_views)),
            Setting("ordinary_nis", 1.0, FINITE, one(&mut self.ordinary_nis)),
        ]
    }

    /// The numbers of all settings, in SI units and radians.
    pub(crate) fn to_array(mut self) -> [f64; NUMBERS] {
        let (mut numbers, mut at) = ([0.0; NUMBERS], 0);
        for Setting(_, _, _, own) in self.settings() {
            numbers[at..at + own.len()].copy_from_slice(own);
            at += own.len();
        }
        numbers
    }

    /// The settings of [`Self::to_array`].
    pub(crate) fn from_array(numbers: [f64; NUMBERS]) -> Self {
        let (mut all, mut at) = (Self::default(), 0);
        for Setting(_, _, _, own) in all.settings() {
            own.copy_from_slice(&numbers[at..at + own.len()]);
            at += own.len();
        }
        all
    }

    /// Sets a setting by its name: a number, or those of a vector; angles and their rates in degrees.
    ///
    /// # Errors
    ///
    /// There is no such setting, or it has another number of numbers.
    pub fn set(&mut self, name: &str, values: &[f64]) -> Result<(), Error> {
        let found = self.settings().into_iter().find(|setting| setting.0 == name);
        let Setting(_, unit, _, own) = found.ok_or(Error::Setting)?;
        if own.len() != values.len() {
            return Err(Error::Numbers { expected: own.len() });
        }
        for (own, value) in own.iter_mut().zip(values) {
            *own = value * unit;
        }
        Ok(())
    }

    /// Checks each setting.
    ///
    /// # Errors
    ///
    /// A setting is out of its range, or not a number.
    pub fn check(&self) -> Result<(), Error> {
        let mut all = *self;
        for Setting(name, _, (expected, holds), own) in all.settings() {
            if let Some(got) = own.iter().find(|number| !holds(**number)) {
                return Err(Error::Parameter { name, expected, got: *got });
            }
        }
        self.check_body()?;
        self.check_orbit()
    }

    /// Whether the angular velocity of a free body changes.
    pub(crate) fn has_body(&self) -> bool {
        self.inertia[..3] != [self.inertia[0]; 3] || self.inertia[3..] != [0.0; 3]
    }

    /// The largest number of the inertia, 1 where all are zero.
    fn inertia_unit(&self) -> f64 {
        let largest = self.inertia.iter().fold(0.0, |most, part| fabs(*part).max(most));
        if largest > 0.0 { largest } else { 1.0 }
    }

    /// The inertia as a matrix, in units of its largest number.
    pub(crate) fn inertia(&self) -> Matrix3<f64> {
        let unit = self.inertia_unit();
        let [xx, yy, zz, xy, xz, yz] = self.inertia.map(|part| part / unit);
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
                let got = got * self.inertia_unit();
                return Err(Error::Parameter { name, expected, got });
            }
        }
        Ok(())
    }

    /// Whether position and velocity move as in an orbit.
    pub(crate) fn has_orbit(&self) -> bool {
        self.orbital_rate().norm() > LEAST_RATE
    }

    /// The camera's angular velocity in its orbit, rad/s along its axes; zero without one.
    pub(crate) fn orbital_rate(&self) -> Vector3<f64> {
        Vector3::from(self.orbital_rate)
    }

    fn check_orbit(&self) -> Result<(), Error> {
        let (rate, zenith) = (self.orbital_rate(), Vector3::from(self.zenith));
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
