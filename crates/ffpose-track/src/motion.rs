//! How a state moves on between two frames: constant velocity, or that of an orbit, and the rotation of a free rigid body, with
//! white accelerations.

use libm::{ceil, exp, sqrt};
use nalgebra::{Matrix3, SMatrix, UnitQuaternion, Vector3};

use crate::filter::{
    ATTITUDE, ATTITUDE_BIAS, Covariance, Filter, MOTION, POSITION, POSITION_BIAS, RATE, VELOCITY,
    turn_rows,
};
use crate::parameters::Parameters;
use crate::rotation::{Quotients, Turn, hat};

impl Filter {
    /// Moves on by `t` seconds, with noise discretized exactly for any `t` where the angular velocity is constant.
    ///
    /// That of a body with moments that differ follows Euler's equations, in steps in which it hardly turns.
    /// `camera_rate` is the camera's own angular velocity, rad/s along its axes, as a gyro measures it, or zero. Velocity and
    /// angular velocity are then those against a camera that does not turn; velocity along the axes of the one that does. In an
    /// orbit the angular velocity is, too; velocity is relative to the camera.
    ///
    /// Returns the angle, radians, by which the object has turned as the camera sees it.
    pub fn predict(&mut self, t: f64, camera_rate: &Vector3<f64>, parameters: &Parameters) -> f64 {
        let Some(body) = Body::new(parameters) else {
            let turn = Turn::new(&self.rate, t);
            return self.move_on(t, camera_rate, parameters, &turn);
        };
        let steps = ceil(self.rate.norm() * t / RADIANS_A_STEP).clamp(1.0, MOST_STEPS);
        let t = t / steps;
        let (mut angle, mut left) = (0.0, steps);
        while left > 0.5 {
            left -= 1.0;
            let after = body.rate_after(&self.rate, t);
            self.rate = body.rate_after(&self.rate, t / 2.0);
            let turn = Turn::new(&self.rate, t).changing(&body.change(&self.rate), t);
            angle += self.move_on(t, camera_rate, parameters, &turn);
            self.rate = after;
        }
        angle
    }

    /// Moves on by `t` seconds at a constant angular velocity, whose errors change as `turn` says.
    fn move_on(
        &mut self,
        t: f64,
        camera_rate: &Vector3<f64>,
        parameters: &Parameters,
        turn: &Turn,
    ) -> f64 {
        let angle = self.angle_turned(t, parameters);
        let way = Way::new(parameters, t);
        (self.position, self.velocity) = way.of(&self.position, &self.velocity);
        let of_camera = UnitQuaternion::from_scaled_axis(parameters.orbital_rate() * t);
        let of_object = UnitQuaternion::from_scaled_axis(self.rate * t);
        self.orientation = of_camera.inverse() * self.orientation * of_object;
        self.orientation.renormalize();
        move_rows(&mut self.cross, &way, turn);
        for (bias, scale) in
            [(POSITION_BIAS, parameters.position_angle), (ATTITUDE_BIAS, parameters.attitude_angle)]
        {
            let mut columns = self.cross.fixed_columns_mut::<3>(bias);
            columns *= exp(-angle / scale);
        }
        let p = &mut self.covariance;
        for _ in 0..2 {
            move_rows(p, &way, turn);
            p.transpose_mut();
        }
        let white = parameters.acceleration * parameters.acceleration;
        let [of_position, across, of_velocity] = spread(parameters, t);
        add(p, POSITION, POSITION, &(of_position * white));
        add(p, POSITION, VELOCITY, &(across * white));
        add(p, VELOCITY, VELOCITY, &(of_velocity * white));
        // a body whose angular acceleration is unknown, a share of ω² that lasts for a radian, and torques
        let speed = self.rate.norm();
        let white = parameters.angular_acceleration * parameters.angular_acceleration
            + parameters.asymmetry * parameters.asymmetry * speed * speed * speed;
        add(p, ATTITUDE, ATTITUDE, &(turn.square * white));
        add(p, ATTITUDE, RATE, &(turn.cross * white));
        add(p, RATE, RATE, &Matrix3::from_diagonal_element(white * t));
        if *camera_rate != Vector3::zeros() {
            self.turn_camera(&UnitQuaternion::from_scaled_axis(camera_rate * t));
        }
        self.tidy();
        angle
    }

    /// Where the object will be after `t` seconds, m along the axes of the camera, which turns at `camera_rate` until then.
    pub(crate) fn position_after(
        &self,
        t: f64,
        camera_rate: &Vector3<f64>,
        parameters: &Parameters,
    ) -> Vector3<f64> {
        let (position, _) = Way::new(parameters, t).of(&self.position, &self.velocity);
        UnitQuaternion::from_scaled_axis(camera_rate * t).inverse() * position
    }

    /// The angle, radians, by which the object will have turned after `t` seconds as the camera sees it.
    ///
    /// The side that is seen changes with the object's rotation and with the direction in which it stands. An uncertain
    /// angular velocity counts with its variance.
    fn angle_turned(&self, t: f64, parameters: &Parameters) -> f64 {
        let square = self.position.norm_squared().max(f64::MIN_POSITIVE);
        let of_ray = parameters.orbital_rate() + self.position.cross(&self.velocity) / square;
        let seen = self.rate - self.orientation.inverse_transform_vector(&of_ray);
        let variance = self.covariance.fixed_view::<3, 3>(RATE, RATE).trace();
        sqrt(seen.norm_squared() + variance) * t
    }

    /// Expresses the state along the axes of a camera that has turned by `turn`, along its own axes.
    fn turn_camera(&mut self, turn: &UnitQuaternion<f64>) {
        let back = turn.inverse();
        self.position = back * self.position;
        self.velocity = back * self.velocity;
        self.orientation = back * self.orientation;
        let matrix = back.to_rotation_matrix().into_inner();
        for place in [POSITION, VELOCITY] {
            turn_rows(&mut self.cross, place, &matrix);
        }
        let columns = self.cross.fixed_columns::<3>(POSITION_BIAS) * matrix.transpose();
        self.cross.fixed_columns_mut::<3>(POSITION_BIAS).copy_from(&columns);
        for _ in 0..2 {
            for place in [POSITION, VELOCITY] {
                turn_rows(&mut self.covariance, place, &matrix);
            }
            self.covariance.transpose_mut();
        }
    }
}

/// The most that a body turns in one step, radians.
const RADIANS_A_STEP: f64 = 0.05;
/// The most steps between two frames.
const MOST_STEPS: f64 = 64.0;

/// A free rigid body, by Euler's equations.
struct Body {
    inertia: Matrix3<f64>,
    inverse: Matrix3<f64>,
}

impl Body {
    /// None for a sphere, whose angular velocity is constant.
    fn new(parameters: &Parameters) -> Option<Self> {
        let inertia = parameters.inertia();
        let inverse = parameters.has_body().then(|| inertia.try_inverse())??;
        Some(Self { inertia, inverse })
    }

    /// The angular acceleration, `I⁻¹ (I ω × ω)`.
    fn acceleration(&self, rate: &Vector3<f64>) -> Vector3<f64> {
        self.inverse * (self.inertia * rate).cross(rate)
    }

    /// How it changes with the angular velocity.
    fn change(&self, rate: &Vector3<f64>) -> Matrix3<f64> {
        self.inverse * (hat(&(self.inertia * rate)) - hat(rate) * self.inertia)
    }

    /// The angular velocity after `t` seconds, by Runge and Kutta's fourth order.
    fn rate_after(&self, rate: &Vector3<f64>, t: f64) -> Vector3<f64> {
        let a = self.acceleration(rate);
        let b = self.acceleration(&(rate + a * (t / 2.0)));
        let c = self.acceleration(&(rate + b * (t / 2.0)));
        let d = self.acceleration(&(rate + c * t));
        rate + (a + (b + c) * 2.0 + d) * (t / 6.0)
    }
}

/// How position and velocity follow from those before: blocks of a matrix, by rows.
struct Way {
    of_position: [Matrix3<f64>; 2],
    of_velocity: [Matrix3<f64>; 2],
}

impl Way {
    /// A straight line, or the solution of W. H. Clohessy and R. S. Wiltshire (*Journal of the Aerospace Sciences* 27(9), 1960)
    /// for a camera on a circular orbit that keeps its attitude to the Earth.
    fn new(parameters: &Parameters, t: f64) -> Self {
        let one = Matrix3::identity();
        if !parameters.has_orbit() {
            return Self { of_position: [one, one * t], of_velocity: [Matrix3::zeros(), one] };
        }
        let rate = parameters.orbital_rate();
        let n = rate.norm();
        let (zenith, normal) = (Vector3::from(parameters.zenith), rate / n);
        let up = (zenith - normal * normal.dot(&zenith)).normalize(); // it was given rounded
        let along = normal.cross(&up);
        let x = n * t;
        let q = Quotients::new(x);
        let (sine, versine) = (x * q.sine, x * x * q.cosine); // sin x and 1 - cos x
        let (radial, forward, across) =
            (up * up.transpose(), along * along.transpose(), normal * normal.transpose());
        let lag = along * up.transpose();
        let swirl = lag.transpose() - lag;
        let plane = radial + across;
        Self {
            of_position: [
                one + radial * (3.0 * versine)
                    - across * versine
                    - lag * (6.0 * x * x * x * q.sine_rest),
                plane * (t * q.sine)
                    + forward * (t * (4.0 * q.sine - 3.0))
                    + swirl * (2.0 * t * x * q.cosine),
            ],
            of_velocity: [
                (radial * 3.0 - across) * (n * sine) - lag * (6.0 * n * versine),
                one - plane * versine - forward * (4.0 * versine) + swirl * (2.0 * sine),
            ],
        }
    }

    fn of(&self, p: &Vector3<f64>, v: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
        let Self { of_position, of_velocity } = self;
        (of_position[0] * p + of_position[1] * v, of_velocity[0] * p + of_velocity[1] * v)
    }
}

/// What a white acceleration of density one has made of position, position with velocity, and velocity after `t` seconds.
fn spread(parameters: &Parameters, t: f64) -> [Matrix3<f64>; 3] {
    if !parameters.has_orbit() {
        return [t * t * t / 3.0, t * t / 2.0, t].map(Matrix3::from_diagonal_element);
    }
    // The integral by the rule of Gauss and Legendre: exact for powers up to nine, and an orbit turns little in `t`.
    let mut sums = [Matrix3::zeros(); 3];
    for (place, weight) in GAUSS {
        let way = Way::new(parameters, t * (0.5 + place));
        let (p, v) = (&way.of_position[1], &way.of_velocity[1]);
        for (sum, product) in
            sums.iter_mut().zip([p * p.transpose(), p * v.transpose(), v * v.transpose()])
        {
            *sum += product * (weight * t);
        }
    }
    sums
}

/// Places from the middle of an interval of length one and their weights, of the rule of five points.
const GAUSS: [(f64, f64); 5] = [
    (-0.453_089_922_969_332, 0.118_463_442_528_094_54),
    (-0.269_234_655_052_841_55, 0.239_314_335_249_683_23),
    (0.0, 0.284_444_444_444_444_44),
    (0.269_234_655_052_841_55, 0.239_314_335_249_683_23),
    (0.453_089_922_969_332, 0.118_463_442_528_094_54),
];

/// `F P`, where `F` is the transition of the errors.
fn move_rows<const COLUMNS: usize>(p: &mut SMatrix<f64, MOTION, COLUMNS>, way: &Way, turn: &Turn) {
    let (positions, velocities) = (p.fixed_rows::<3>(POSITION), p.fixed_rows::<3>(VELOCITY));
    let moved = [way.of_position, way.of_velocity]
        .map(|[of_position, of_velocity]| of_position * positions + of_velocity * velocities);
    p.fixed_rows_mut::<3>(POSITION).copy_from(&moved[0]);
    p.fixed_rows_mut::<3>(VELOCITY).copy_from(&moved[1]);
    let rows = turn.error * p.fixed_rows::<3>(ATTITUDE) + turn.of_rate * p.fixed_rows::<3>(RATE);
    p.fixed_rows_mut::<3>(ATTITUDE).copy_from(&rows);
    turn_rows(p, RATE, &turn.rate);
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
