//! Bad arguments, and states that are saved and taken up.

mod common;

use common::{Random, Shown, trusting};
use ffpose_track::{Error, Measurement, Mode, Outcome, Parameters, Tracker};

const STILL: [f64; 3] = [0.0; 3];
const ONE: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
const UNIT: [f64; 4] = [1.0, 0.0, 0.0, 0.0];

fn after(frames: i32) -> Tracker {
    let (mut random, mut tracker) = (Random(1), Tracker::new(Parameters::default()).unwrap());
    for i in 0..frames {
        let seen = Shown::tumbling(f64::from(i), &mut random).measurement();
        tracker.step(f64::from(i), Some(&seen), STILL).unwrap();
    }
    tracker
}

#[test]
fn times_that_repeat_go_back_or_are_none_change_nothing() {
    let mut tracker = after(6);
    let before = tracker.clone();
    for (time, text) in [
        (5.0, "time: expected later than 5 s, the frame before, got 5 s"),
        (4.0, "time: expected later than 5 s, the frame before, got 4 s"),
        (f64::NAN, "time: expected finite numbers, got NaN or infinity"),
    ] {
        let error = tracker.step(time, None, STILL).unwrap_err();
        assert_eq!(error.to_string(), text);
        assert_eq!(tracker, before);
    }
    let error = tracker.step(6.0, None, [0.0, f64::INFINITY, 0.0]).unwrap_err();
    assert_eq!(error.to_string(), "camera_rate: expected finite numbers, got NaN or infinity");
    assert_eq!(tracker, before);
}

#[test]
fn one_wrong_time_is_a_gap_and_no_more() {
    for wrong in [f64::MAX, 1e300, 1.7e9, 30.0] {
        for seen in [None, Some(Shown::tumbling(6.0, &mut Random(4)).measurement())] {
            let mut tracker = after(6);
            let step = tracker.step(wrong, seen.as_ref(), STILL).unwrap();
            assert_eq!(step.outcome, Outcome::Lost);
            let state = tracker.to_bytes(&[0; 32]);
            let mut again = Tracker::from_bytes(&state, &[0; 32]).unwrap();
            for tracker in [&mut tracker, &mut again] {
                let outcomes = [6.0, 7.0, 8.0, 9.0, 10.0].map(|time| {
                    let shown = Shown::tumbling(time, &mut Random(5)).measurement();
                    tracker.step(time, Some(&shown), STILL).unwrap().outcome
                });
                assert_eq!(outcomes[..3], [Outcome::Acquiring; 3], "{wrong}");
                assert_eq!(outcomes[3..], [Outcome::Accepted; 2]);
            }
        }
    }
}

#[test]
fn one_wrong_time_is_a_gap_for_a_tracker_that_believes_the_first_frame() {
    let mut random = Random(19);
    let mut tracker = Tracker::new(trusting()).unwrap();
    for time in [0.0_f64, 0.5, 1.0, 1.7e9, 1.5, 2.0] {
        let shown = Shown::tumbling(f64::min(time, 2.0), &mut random).measurement();
        assert!(tracker.step(time, Some(&shown), STILL).unwrap().estimate.is_some());
    }
}

#[test]
fn frames_that_do_not_agree_yet_keep_their_order() {
    let mut tracker = after(2);
    let before = tracker.clone();
    for time in [1.0, 0.5, -9.0] {
        assert!(matches!(tracker.step(time, None, STILL), Err(Error::Time { .. })));
        assert_eq!(tracker, before);
    }
    tracker.step(-9.5, None, STILL).unwrap();
    assert_eq!(tracker.time(), Some(-9.5));
}

#[test]
fn a_tracker_that_is_reset_is_a_new_one() {
    let mut tracker = after(9);
    tracker.reset();
    assert_eq!(tracker, Tracker::new(Parameters::default()).unwrap());
}

#[test]
fn poses_that_are_none_are_refused() {
    let told = |p: [f64; 3], q, c, r, probability| {
        Mode::new(p, q, c, r, probability).unwrap_err().to_string()
    };
    let mut nan = ONE;
    nan[1][1] = f64::NAN;
    let mut skew = ONE;
    skew[0][1] = 0.5;
    let mut flat = ONE;
    flat[2][2] = 0.0;
    let at = [0.0, 0.0, 9.0];
    assert_eq!(
        told([0.0, f64::NAN, 9.0], UNIT, ONE, ONE, 1.0),
        "position: expected finite numbers, got NaN or infinity"
    );
    assert_eq!(
        told(at, [0.5, 0.0, 0.0, 0.0], ONE, ONE, 1.0),
        "orientation: expected a unit quaternion, got norm 0.5"
    );
    assert_eq!(
        told(at, UNIT, nan, ONE, 1.0),
        "position_covariance: expected finite numbers, got NaN or infinity"
    );
    assert_eq!(told(at, UNIT, ONE, skew, 1.0), "rotation_covariance: expected a symmetric matrix");
    assert_eq!(
        told(at, UNIT, ONE, flat, 1.0),
        "rotation_covariance: expected a positive definite matrix"
    );
    assert_eq!(told(at, UNIT, ONE, ONE, 1.5), "probability: expected a number in 0…1, got 1.5");
    assert_eq!(Measurement::new(&[]), Err(Error::Modes { got: 0 }));
    let impossible = Mode::new(at, UNIT, ONE, ONE, 0.0).unwrap();
    assert_eq!(Measurement::new(&[impossible; 2]), Err(Error::Modes { got: 0 }));
}

#[test]
fn settings_out_of_range_are_refused() {
    let fault = |parameters| Tracker::new(parameters).unwrap_err().to_string();
    let usual = Parameters::default();
    assert_eq!(
        fault(Parameters { attitude_noise: 0.0, ..usual }),
        "attitude_noise: expected a share above 0, up to 1, got 0"
    );
    assert_eq!(
        fault(Parameters { gate: f64::NAN, ..usual }),
        "gate: expected a number above 0, got NaN"
    );
}

#[test]
fn a_state_goes_on_as_the_tracker_itself() {
    let mut tracker = after(9);
    let bytes = tracker.to_bytes(&[3; 32]);
    let mut again = Tracker::from_bytes(&bytes, &[3; 32]).unwrap();
    assert_eq!(again, tracker);
    let seen = Shown::tumbling(9.5, &mut Random(2)).measurement();
    assert_eq!(again.step(9.5, Some(&seen), STILL), tracker.step(9.5, Some(&seen), STILL));
    let new = Tracker::new(Parameters::default()).unwrap();
    assert_eq!(Tracker::from_bytes(&new.to_bytes(&[0; 32]), &[0; 32]).unwrap(), new);
}

#[test]
fn states_of_others_and_damaged_ones_are_refused() {
    let bytes = after(9).to_bytes(&[3; 32]);
    let fault = |bytes: &[u8], tag| Tracker::from_bytes(bytes, &[tag; 32]).unwrap_err().to_string();
    assert_eq!(
        fault(&bytes, 4),
        "state: expected one of this model and camera, got that of another"
    );
    assert_eq!(
        fault(&bytes[..500], 3),
        "state: expected the saved state of a tracker, got it cut short or longer"
    );
    assert_eq!(fault(b"{}", 3), "state: expected the saved state of a tracker, got other bytes");
    let other =
        "state: expected a state of this version, got that of another, which is to be removed";
    assert_eq!(fault(b"FFTRACK1 and its numbers", 3), other);
    let mut damaged = bytes;
    damaged[777] ^= 4;
    assert_eq!(fault(&damaged, 3), "state: damaged: its checksum is not that of its bytes");
}
