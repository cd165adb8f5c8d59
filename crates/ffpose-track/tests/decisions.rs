//! Acquisition, loss, outliers and attitudes that look alike.

mod common;

use common::{Random, Shown};
use ffpose_track::{Measurement, Outcome, Parameters, Tracker};
use nalgebra::{UnitQuaternion, Vector3};

const STILL: [f64; 3] = [0.0; 3];

fn tracker() -> Tracker {
    Tracker::new(Parameters::default()).unwrap()
}

fn turned(shown: &Shown, axis: Vector3<f64>) -> Shown {
    let half = UnitQuaternion::from_scaled_axis(axis * std::f64::consts::PI);
    Shown { orientation: shown.orientation * half, ..*shown }
}

fn flipped(shown: &Shown) -> Shown {
    turned(shown, Vector3::y())
}

fn away(estimate: &ffpose_track::Estimate, shown: &Shown) -> f64 {
    let [w, x, y, z] = estimate.orientation;
    UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z))
        .angle_to(&shown.orientation)
}

#[test]
fn a_track_needs_frames_that_agree() {
    let mut random = Random(1);
    let mut tracker = tracker();
    let outcomes: Vec<Outcome> = (0..5)
        .map(|i| {
            let t = f64::from(i) * 0.5;
            let shown = Shown::tumbling(t, &mut random);
            tracker.step(t, Some(&shown.measurement()), STILL).unwrap().outcome
        })
        .collect();
    assert_eq!(outcomes[..3], [Outcome::Acquiring; 3]);
    assert_eq!(outcomes[3..], [Outcome::Accepted; 2]);
}

#[test]
fn poses_that_never_agree_make_no_track() {
    let mut random = Random(2);
    let mut tracker = tracker();
    for i in 0..200 {
        let t = f64::from(i) * 0.5;
        let mut shown = Shown::tumbling(t, &mut random);
        shown.position = Vector3::new(0.0, 0.0, 25.0) + random.vector() * 5.0;
        shown.orientation = UnitQuaternion::from_scaled_axis(random.vector() * 2.0);
        let step = tracker.step(t, Some(&shown.measurement()), STILL).unwrap();
        assert_eq!((step.outcome, step.estimate), (Outcome::Acquiring, None));
    }
}

#[test]
fn a_long_flip_is_gated_and_a_longer_one_is_believed() {
    let mut random = Random(4);
    let mut tracker = tracker();
    let mut switched = None;
    for i in 0..400 {
        let t = f64::from(i) * 0.5;
        let shown = Shown::tumbling(t, &mut random);
        // 16 frames on end, 17°; then for good
        let wrong = (100..116).contains(&i) || i >= 160;
        let seen = if wrong { flipped(&shown) } else { shown };
        let step = tracker.step(t, Some(&seen.measurement()), STILL).unwrap();
        if i < 160 && i > 4 {
            assert_eq!(step.outcome == Outcome::Gated, wrong, "frame {i}");
            assert!(away(&step.estimate.unwrap(), &shown) < 0.1);
        }
        if step.outcome == Outcome::Switched {
            switched = Some(i);
        }
    }
    assert!(switched.is_some_and(|frame| frame > 170), "{switched:?}");
}

#[test]
fn gated_frames_tell_nothing_of_how_large_errors_are() {
    let mut random = Random(13);
    let mut seeing = tracker();
    let mut see = |i: i32| Shown::tumbling(f64::from(i) * 0.5, &mut random);
    for i in 0..60 {
        seeing.step(f64::from(i) * 0.5, Some(&see(i).measurement()), STILL).unwrap();
    }
    let mut coasting = seeing.clone();
    for i in 60..76 {
        let (t, flip) = (f64::from(i) * 0.5, flipped(&see(i)).measurement());
        let gated = seeing.step(t, Some(&flip), STILL).unwrap();
        assert_eq!(gated.outcome, Outcome::Gated);
        assert_eq!(gated.estimate, coasting.step(t, None, STILL).unwrap().estimate);
    }
    let seen = see(76).measurement();
    let after = seeing.step(38.0, Some(&seen), STILL).unwrap();
    assert_eq!(after.outcome, Outcome::Accepted);
    assert_eq!(after.estimate, coasting.step(38.0, Some(&seen), STILL).unwrap().estimate);
}

#[test]
fn what_is_not_seen_for_long_is_lost_and_found_again() {
    let mut random = Random(5);
    let mut tracker = tracker();
    let mut outcomes = vec![];
    for i in 0..60 {
        let t = f64::from(i) * 0.5;
        let shown = Shown::tumbling(t, &mut random).measurement();
        let seen = Some(&shown).filter(|_| !(10..40).contains(&i));
        outcomes.push(tracker.step(t, seen, STILL).unwrap().outcome);
    }
    assert!(outcomes[10..29].iter().all(|outcome| *outcome == Outcome::Coasted));
    assert_eq!(outcomes[30], Outcome::Lost);
    assert!(outcomes[31..43].iter().all(|outcome| *outcome == Outcome::Acquiring));
    assert!(outcomes[43..].iter().all(|outcome| *outcome == Outcome::Accepted));
}

/// A track of `agreeing` frames or more, and what a frame `pause` seconds later makes of it, which shows another pose.
fn after_a_pause(agreeing: f64, pause: f64) -> (Tracker, f64, Shown, ffpose_track::Step) {
    let mut random = Random(7);
    let mut tracker = Tracker::new(Parameters { agreeing, ..Parameters::default() }).unwrap();
    for i in 0..8 {
        let shown = Shown::tumbling(f64::from(i) * 0.5, &mut random).measurement();
        tracker.step(f64::from(i) * 0.5, Some(&shown), STILL).unwrap();
    }
    let time = 3.5 + pause;
    let mut other = flipped(&Shown::tumbling(time, &mut random));
    other.position *= 0.5;
    let step = tracker.step(time, Some(&other.measurement()), STILL).unwrap();
    (tracker, time, other, step)
}

#[test]
fn what_is_seen_elsewhere_after_a_loss_must_be_seen_again() {
    let (mut tracker, time, other, step) = after_a_pause(4.0, 11.0);
    assert_eq!((step.outcome, step.estimate, step.nis), (Outcome::Lost, None, None));
    let outcomes = [0.5, 1.0, 1.5, 2.0].map(|later| {
        tracker.step(time + later, Some(&other.measurement()), STILL).unwrap().outcome
    });
    assert_eq!(outcomes[..2], [Outcome::Acquiring; 2]);
    assert_eq!(outcomes[2..], [Outcome::Accepted; 2]);
    // where one frame is enough, the track is another one
    let (_, _, other, step) = after_a_pause(1.0, 11.0);
    assert_eq!(step.outcome, Outcome::Switched);
    assert!(away(&step.estimate.unwrap(), &other) < 0.01);
}

#[test]
fn a_long_silence_is_one_that_was_told() {
    for steps in [21, 120, 600, 7200] {
        let gap = f64::from(steps) * 0.5;
        for told in [false, true] {
            let mut random = Random(7);
            let mut tracker = tracker();
            for i in 0..60 {
                let shown = Shown::tumbling(f64::from(i) * 0.5, &mut random).measurement();
                tracker.step(f64::from(i) * 0.5, Some(&shown), STILL).unwrap();
            }
            let mut outcomes = vec![];
            for i in (1..steps).filter(|_| told) {
                let time = 29.5 + f64::from(i) * 0.5;
                outcomes.push(tracker.step(time, None, STILL).unwrap().outcome);
                let next = time + 0.5;
                assert_eq!(tracker.expected(next, STILL).is_some(), next - 29.5 <= 10.0);
            }
            let mut other = flipped(&Shown::tumbling(29.5 + gap, &mut random));
            other.position *= 0.5;
            for i in 0..4 {
                let time = 29.5 + gap + f64::from(i) * 0.5;
                let seen = Some(other.measurement());
                outcomes.push(tracker.step(time, seen.as_ref(), STILL).unwrap().outcome);
            }
            let lost = outcomes.iter().filter(|outcome| **outcome == Outcome::Lost).count();
            assert_eq!(lost, 1, "{gap} s, told: {told}");
            let [.., third, last] = outcomes[..] else { unreachable!() };
            assert_eq!([third, last], [Outcome::Acquiring, Outcome::Accepted]);
            let estimate = tracker.estimate().unwrap();
            assert!(away(&estimate, &other) < 0.1);
        }
    }
}

#[test]
fn another_attitude_that_leads_without_a_frame_has_accepted_none() {
    let mut random = Random(3);
    let mut still = |turned: bool, t: f64| {
        let mut shown = Shown::tumbling(t, &mut random);
        shown.orientation = Shown::tumbling(0.0, &mut Random(3)).orientation;
        if turned { flipped(&shown) } else { shown }
    };
    let mut tracker = tracker();
    let mut time = 0.0;
    // a leader with more evidence than what is seen after it, and was seen later
    for i in 0..52 {
        time = f64::from(i) * 0.5;
        let seen = still(i >= 40, time).measurement();
        let step = tracker.step(time, Some(&seen), STILL).unwrap();
        assert_eq!(step.accepted, step.outcome == Outcome::Accepted);
    }
    assert!(tracker.alternative().is_some());
    let other = tracker.alternative().unwrap().orientation;
    let mut switched = 0;
    for _ in 0..30 {
        time += 0.5;
        let step = tracker.step(time, None, STILL).unwrap();
        assert!(!step.accepted && step.nis.is_none(), "{step:?}");
        if step.outcome == Outcome::Switched {
            switched += 1;
            let q = step.estimate.unwrap().orientation;
            let product: f64 = q.iter().zip(other).map(|(a, b)| a * b).sum();
            assert!(product.abs() > 0.9);
        }
    }
    assert_eq!(switched, 1);
}

#[test]
fn a_frame_just_within_the_time_of_coasting_is_believed() {
    let (_, _, _, step) = after_a_pause(4.0, 10.0); // of another pose
    assert_eq!(step.outcome, Outcome::Gated);
    let mut random = Random(7);
    let mut tracker = tracker();
    let outcomes = [0.0, 0.5, 1.0, 1.5, 2.0, 12.0].map(|time| {
        let shown = Shown::tumbling(time, &mut random).measurement();
        tracker.step(time, Some(&shown), STILL).unwrap().outcome
    });
    assert_eq!(outcomes[3..], [Outcome::Accepted; 3]);
}

#[test]
fn frames_that_no_longer_agree_end_a_track() {
    let mut random = Random(9);
    let mut tracker = tracker();
    for i in 0..100 {
        let t = f64::from(i) * 0.5;
        let mut shown = Shown::tumbling(t, &mut random);
        if i >= 10 {
            shown.orientation = UnitQuaternion::from_scaled_axis(random.vector() * 2.0);
        }
        let step = tracker.step(t, Some(&shown.measurement()), STILL).unwrap();
        match step.estimate {
            None => assert_ne!(step.outcome, Outcome::Gated),
            Some(one) => assert!(i < 40 && away(&one, &Shown::tumbling(t, &mut random)) < 0.2),
        }
    }
}

#[test]
fn five_seconds_without_frames_are_coasted() {
    let mut random = Random(6);
    let mut tracker = tracker();
    for i in 0..60 {
        let t = f64::from(i) * 0.5;
        let shown = Shown::tumbling(t, &mut random);
        let seen = shown.measurement();
        let step = tracker.step(t, Some(&seen).filter(|_| !(20..30).contains(&i)), STILL).unwrap();
        if i >= 30 {
            assert_eq!(step.outcome, Outcome::Accepted);
            assert!(away(&step.estimate.unwrap(), &shown) < 0.05);
        }
    }
}

/// The network's error changes with the light, which the object's rotation does not tell, and by less than makes another track.
#[test]
fn errors_that_change_at_rest_make_no_unlikely_attitude_lead() {
    let mut random = Random(14);
    let mut tracker = tracker();
    let mut last = f64::NAN;
    for i in 0..300 {
        let t = f64::from(i) * 0.5;
        let mut shown = Shown::tumbling(0.0, &mut random);
        let right = shown;
        if i < 100 {
            shown.position += Vector3::new(0.1, 0.1, 0.6);
            shown.orientation *= UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.07, 0.0));
        }
        let modes = [shown.mode(1.0, 0.995), flipped(&shown).mode(1.0, 1e-4)];
        let seen = Measurement::new(&modes).unwrap();
        if let Some(one) = tracker.step(t, Some(&seen), STILL).unwrap().estimate {
            last = away(&one, &right);
            assert!(last < 0.2, "frame {i}: {last}");
        }
    }
    assert!(last < 0.02, "{last}");
}

#[test]
fn an_attitude_that_is_less_likely_than_a_new_one_does_not_lead() {
    let mut random = Random(15);
    let mut tracker = Tracker::new(Parameters { agreeing: 12.0, ..Parameters::default() }).unwrap();
    let mut outcomes = Vec::new();
    for i in 0..60 {
        let t = f64::from(i) * 0.5;
        let shown = Shown::tumbling(t, &mut random);
        let (unlikely, new) = (flipped(&shown), turned(&shown, Vector3::x()));
        let (likely, p) = if i < 20 { (shown, 0.6) } else { (new, 0.99) };
        let modes = [likely.mode(1.0, p), unlikely.mode(1.0, 1e-3)];
        let step = tracker.step(t, Some(&Measurement::new(&modes).unwrap()), STILL).unwrap();
        outcomes.push(step.outcome);
        if let Some(one) = step.estimate {
            assert!(away(&one, &unlikely) > 1.0, "frame {i}");
        }
        if i == 59 {
            assert!(away(&step.estimate.unwrap(), &new) < 0.1);
        }
    }
    assert!(outcomes.contains(&Outcome::Lost), "{outcomes:?}");
}

#[test]
fn a_likely_attitude_beside_passing_ones_is_acquired() {
    let mut random = Random(16);
    let mut tracker = tracker();
    for i in 0..40 {
        let t = f64::from(i) * 0.5;
        let shown = Shown::tumbling(t, &mut random);
        let orientation = UnitQuaternion::from_scaled_axis(random.vector() * 2.0);
        let passing = Shown { orientation, ..shown };
        let modes = [shown.mode(1.0, 0.45), passing.mode(1.0, 0.05)];
        let step = tracker.step(t, Some(&Measurement::new(&modes).unwrap()), STILL).unwrap();
        if i > 3 {
            assert!(away(&step.estimate.unwrap(), &shown) < 0.1, "frame {i}");
        }
    }
}

#[test]
fn one_wrong_frame_ends_no_track_of_two_attitudes_that_look_alike() {
    let mut random = Random(17);
    let mut tracker = tracker();
    for i in 0..300 {
        let t = f64::from(i) * 0.5;
        let shown = Shown::tumbling(t, &mut random);
        let wrong = i > 100 && i % 50 == 0;
        let seen = if wrong { turned(&shown, Vector3::x() * 0.5) } else { shown };
        let modes = [seen.mode(1.0, 0.45), flipped(&seen).mode(1.0, 0.45)];
        let step = tracker.step(t, Some(&Measurement::new(&modes).unwrap()), STILL).unwrap();
        if i > 3 {
            assert!(step.estimate.is_some(), "frame {i}");
        }
    }
}

/// A frame counts by the angle turned since the last, however often the tracker is asked where the object is between them.
#[test]
fn steps_without_a_frame_change_no_decision() {
    let switched = |between: i32| {
        let mut random = Random(18);
        let mut tracker = tracker();
        (0..200).find(|i| {
            let t = f64::from(*i) * 2.0;
            for part in 1..between {
                let before = t - 2.0 + 2.0 * f64::from(part) / f64::from(between);
                tracker.step(before, None, STILL).unwrap();
            }
            let shown = Shown::tumbling(t, &mut random);
            let p = if *i < 60 { 0.95 } else { 0.05 };
            let modes = [shown.mode(1.0, p), flipped(&shown).mode(1.0, 1.0 - p)];
            let step = tracker.step(t, Some(&Measurement::new(&modes).unwrap()), STILL).unwrap();
            step.outcome == Outcome::Switched
        })
    };
    assert!(switched(1).is_some_and(|frame| frame > 60));
    assert_eq!(switched(1), switched(20));
}

#[test]
fn two_attitudes_are_followed_while_there_are_two() {
    let mut random = Random(8);
    let mut tracker = tracker();
    for i in 0..80 {
        let t = f64::from(i) * 0.5;
        let shown = Shown::tumbling(t, &mut random);
        let other = flipped(&shown);
        // as likely as each other for a while, then the first is the less likely one
        let likely = if i < 40 { 0.5 } else { 0.05 };
        let modes = [shown.mode(1.0, likely), other.mode(1.0, 1.0 - likely)];
        tracker.step(t, Some(&Measurement::new(&modes).unwrap()), STILL).unwrap();
        if (5..40).contains(&i) {
            let pair = [tracker.estimate().unwrap(), tracker.alternative().unwrap()];
            let nearest =
                |to: &Shown| pair.iter().map(|one| away(one, to)).fold(f64::MAX, f64::min);
            assert!(nearest(&shown) < 0.1 && nearest(&other) < 0.1);
        }
        if i == 79 {
            assert!(away(&tracker.estimate().unwrap(), &other) < 0.1);
        }
    }
}

#[test]
fn the_likelier_of_two_new_attitudes_takes_the_one_free_place() {
    let mut random = Random(12);
    let mut tracker = tracker();
    for i in 0..=40 {
        let t = f64::from(i) * 0.5;
        let shown = Shown::tumbling(t, &mut random);
        let likelier = turned(&shown, Vector3::x());
        let modes = if i < 25 {
            [shown.mode(1.0, 0.9), flipped(&shown).mode(1.0, 0.9)]
        } else {
            [likelier.mode(1.0, 0.9), turned(&shown, Vector3::z()).mode(1.0, 0.1)]
        };
        tracker.step(t, Some(&Measurement::new(&modes).unwrap()), STILL).unwrap();
        if i == 24 {
            assert!(tracker.alternative().is_some());
        }
        if i == 40 {
            assert!(away(&tracker.estimate().unwrap(), &likelier) < 0.1);
        }
    }
}
