//! What holds for any track: equivariance, the quaternion's two signs, soundness over a million steps.

mod common;

use common::{Random, Shown, trusting};
use ffpose_track::{Estimate, Measurement, Outcome, Parameters, Tracker};
use nalgebra::{Matrix3, Quaternion, SMatrix, UnitQuaternion, Vector3};

const STILL: [f64; 3] = [0.0; 3];

fn close(a: &[f64], b: &[f64], tolerance: f64) {
    for (x, y) in a.iter().zip(b) {
        assert!((x - y).abs() <= tolerance, "{a:?} {b:?}");
    }
}

/// Each frame of a sequence with uneven intervals, as `see` changes it.
fn tracked(see: impl Fn(&Shown) -> Measurement, rate: [f64; 3]) -> Vec<Estimate> {
    let (mut random, mut t) = (Random(7), 0.0);
    let mut tracker = Tracker::new(trusting()).unwrap();
    let mut estimates = vec![];
    for _ in 0..60 {
        t += 0.1 + random.uniform();
        let shown = Shown::tumbling(t, &mut random);
        let step = tracker.step(t, Some(&see(&shown)), rate).unwrap();
        assert_eq!(step.outcome, Outcome::Accepted);
        estimates.push(step.estimate.unwrap());
    }
    estimates
}

#[test]
fn a_turned_camera_gives_the_turned_track() {
    let turn = UnitQuaternion::from_euler_angles(0.7, -1.1, 2.3);
    let m = turn.to_rotation_matrix().into_inner();
    let mut whole = SMatrix::<f64, 12, 12>::identity();
    for place in [0, 3] {
        whole.fixed_view_mut::<3, 3>(place, place).copy_from(&m);
    }
    let plain = tracked(Shown::measurement, STILL);
    let other = tracked(|shown| shown.turned(&turn).measurement(), STILL);
    for (a, b) in plain.iter().zip(&other) {
        close((turn * Vector3::from(a.position)).as_slice(), &b.position, 1e-9);
        close((turn * Vector3::from(a.velocity)).as_slice(), &b.velocity, 1e-9);
        close(&a.rate, &b.rate, 1e-9);
        let expected = whole * a.covariance * whole.transpose();
        close(expected.as_slice(), b.covariance.as_slice(), 1e-9);
    }
}

#[test]
fn both_signs_of_a_quaternion_are_one_orientation() {
    let plain = tracked(Shown::measurement, STILL);
    let other = tracked(|shown| Measurement::new(&[shown.mode(-1.0, 1.0)]).unwrap(), STILL);
    for (a, b) in plain.iter().zip(&other) {
        close(&a.orientation, &b.orientation, 1e-12);
        close(a.covariance.as_slice(), b.covariance.as_slice(), 1e-12);
    }
}

#[test]
fn a_gyro_takes_the_cameras_own_turning_out() {
    // a camera that turns by 4°/s sees the object of a still one along its own axes
    let rate = Vector3::new(0.02, -0.05, 0.04);
    let (mut random, mut noise, mut t, mut last) = (Random(7), Random(9), 0.0, 0.0);
    let mut still = Tracker::new(trusting()).unwrap();
    let mut turning = Tracker::new(trusting()).unwrap();
    for _ in 0..60 {
        t += 0.1 + random.uniform();
        let shown = Shown::tumbling(t, &mut noise);
        let turn = UnitQuaternion::from_scaled_axis(rate * t);
        let seen = shown.turned(&turn.inverse());
        let a = still.step(t, Some(&shown.measurement()), STILL).unwrap().estimate.unwrap();
        let own = if last == 0.0 { STILL } else { rate.into() };
        let b = turning.step(t, Some(&seen.measurement()), own).unwrap().estimate.unwrap();
        close(a.position.as_slice(), (turn * Vector3::from(b.position)).as_slice(), 1e-9);
        close(a.velocity.as_slice(), (turn * Vector3::from(b.velocity)).as_slice(), 1e-9);
        close(
            &a.covariance.diagonal().as_slice()[6..],
            &b.covariance.diagonal().as_slice()[6..],
            1e-9,
        );
        last = t;
    }
}

#[test]
fn two_steps_without_a_frame_are_one() {
    let mut random = Random(3);
    let mut once = Tracker::new(trusting()).unwrap();
    for t in 0..8 {
        let shown = Shown::tumbling(f64::from(t), &mut random);
        once.step(f64::from(t), Some(&shown.measurement()), STILL).unwrap();
    }
    let mut twice = once.clone();
    let one = once.step(9.5, None, STILL).unwrap().estimate.unwrap();
    twice.step(8.1, None, STILL).unwrap();
    let two = twice.step(9.5, None, STILL).unwrap().estimate.unwrap();
    close(&one.position, &two.position, 1e-12);
    close(&one.orientation, &two.orientation, 1e-12);
    close(one.covariance.as_slice(), two.covariance.as_slice(), 1e-12);
}

#[test]
fn a_free_body_keeps_its_angular_momentum_and_its_energy() {
    let inertia = [1.0, 2.0, 2.5, 0.1, -0.2, 0.05];
    let matrix = Matrix3::new(1.0, 0.1, -0.2, 0.1, 2.0, 0.05, -0.2, 0.05, 2.5);
    for orbital_rate in [0.0, 1.1e-3] {
        let orbital_rate = [orbital_rate, 0.0, 0.0];
        let mut random = Random(3);
        let mut tracker = Tracker::new(Parameters { inertia, orbital_rate, ..trusting() }).unwrap();
        let mut kept = vec![];
        for t in 0..18 {
            let seen = (t < 9).then(|| Shown::tumbling(f64::from(t), &mut random).measurement());
            let one = tracker.step(f64::from(t), seen.as_ref(), STILL).unwrap().estimate.unwrap();
            let [w, x, y, z] = one.orientation;
            let turn = UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z));
            // against the stars, along the axes that the camera had at first
            let of_camera = Vector3::from(orbital_rate);
            let rate = Vector3::from(one.rate) + turn.inverse() * of_camera;
            let camera = UnitQuaternion::from_scaled_axis(of_camera * f64::from(t));
            let momentum = camera * turn * (matrix * rate);
            kept.push([momentum.x, momentum.y, momentum.z, rate.dot(&(matrix * rate))]);
        }
        for after in &kept[9..] {
            close(after, &kept[8], 2e-6); // of some 0.05; the attitude goes on in steps
        }
    }
}

#[test]
fn settings_that_mean_the_same_give_the_same_track() {
    let follow = |parameters| {
        let mut random = Random(5);
        let mut tracker = Tracker::new(parameters).unwrap();
        for t in 0..9 {
            let shown = Shown::tumbling(f64::from(t), &mut random);
            tracker.step(f64::from(t), Some(&shown.measurement()), STILL).unwrap();
        }
        tracker.step(60.0, None, STILL).unwrap().estimate.unwrap()
    };
    let same = |a: Parameters, b: Parameters| {
        let (a, b) = (
            follow(Parameters { coasting: 99.0, ..a }),
            follow(Parameters { coasting: 99.0, ..b }),
        );
        close(&a.position, &b.position, 1e-6); // m
        close(&a.orientation, &b.orientation, 1e-9);
        close(a.covariance.as_slice(), b.covariance.as_slice(), 1e-6);
    };
    let of = |orbital_rate, zenith| Parameters { orbital_rate, zenith, ..trusting() };
    let half = core::f64::consts::FRAC_1_SQRT_2;
    // a zenith as it is typed, and a rate too small to be one
    same(of([1.1e-3, 0.0, 0.0], [0.0, -half, half]), of([1.1e-3, 0.0, 0.0], [0.0, -0.707, 0.707]));
    for rate in [1e-200, 3e-162] {
        same(of([0.0; 3], [0.0, -1.0, 0.0]), of([rate, 0.0, 0.0], [0.0, -1.0, 0.0]));
    }
    // an inertia in any unit
    let body = |unit: f64| {
        let inertia = [1.0, 2.0, 2.5, 0.1, -0.2, 0.05].map(|part| part * unit);
        Parameters { inertia, ..trusting() }
    };
    for unit in [1e-110, 1e150, 6e307] {
        same(body(1.0), body(unit));
    }
}

#[test]
fn a_time_is_told_before_there_is_a_frame() {
    let (mut random, mut tracker) = (Random(5), Tracker::new(Parameters::default()).unwrap());
    tracker.check_time(-1e9).unwrap();
    for t in 0..9 {
        let shown = Shown::tumbling(f64::from(t), &mut random);
        tracker.step(f64::from(t), Some(&shown.measurement()), STILL).unwrap();
    }
    for time in [8.0, -1e9, f64::NAN] {
        let expected = tracker.clone().step(time, None, STILL).unwrap_err();
        assert_eq!(tracker.check_time(time).unwrap_err().to_string(), expected.to_string());
    }
    tracker.check_time(8.1).unwrap();
}

#[test]
fn a_million_steps_with_gaps_and_outliers_stay_sound() {
    let (mut random, mut t) = (Random(11), 0.0);
    let mut tracker = Tracker::new(Parameters::default()).unwrap();
    let mut tracked = 0;
    for _ in 0..1_000_000 {
        t += 0.05 + random.uniform().powi(8) * 20.0;
        let mut shown = Shown::tumbling(t % 300.0, &mut random);
        if random.uniform() < 0.05 {
            shown.orientation = UnitQuaternion::from_scaled_axis(random.vector() * 2.0);
            shown.position += random.vector() * 3.0;
        }
        let seen = (random.uniform() < 0.9).then(|| shown.measurement());
        let step = tracker.step(t, seen.as_ref(), STILL).unwrap();
        assert!(step.accepted || step.outcome != Outcome::Accepted);
        let Some(estimate) = step.estimate else { continue };
        tracked += 1;
        assert!(estimate.covariance.iter().all(|number| number.is_finite()));
        assert_eq!(estimate.covariance, estimate.covariance.transpose());
        assert!(estimate.covariance.cholesky().is_some());
    }
    assert!(tracked > 500_000, "{tracked}");
}
