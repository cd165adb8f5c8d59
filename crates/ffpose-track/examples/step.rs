//! The time of a step of the tracker that follows one attitude: `cargo run --release -p ffpose-track --example step`.

#[path = "../tests/common/mod.rs"]
mod common;

use std::hint::black_box;
use std::time::Instant;

use common::{Random, Shown};
use ffpose_track::{Parameters, Tracker};

/// Steps that are timed together, and how often.
const STEPS: u32 = 1000;
const REPEATS: usize = 101;

fn main() -> Result<(), ffpose_track::Error> {
    let mut random = Random(1);
    let times: Vec<f64> = (1..=STEPS).map(|step| 0.5 * f64::from(step)).collect();
    let frames: Vec<_> =
        times.iter().map(|time| Shown::tumbling(*time, &mut random).measurement()).collect();
    let usual = Parameters { coasting: f64::INFINITY, ..Parameters::default() };
    let inertia = [1.0, 2.0, 2.5, 0.1, -0.2, 0.05];
    for (what, parameters, coasts) in [
        ("with a frame", usual, false),
        (
            "with a frame, inertia known, in an orbit",
            Parameters { inertia, orbital_rate: [1.1e-3, 0.0, 0.0], ..usual },
            false,
        ),
        ("without a frame", usual, true),
    ] {
        let mut took = vec![];
        for _ in 0..REPEATS {
            let mut tracker = Tracker::new(parameters)?;
            for time in -10..1 {
                let time = 0.5 * f64::from(time);
                let frame = Shown::tumbling(time, &mut random).measurement();
                tracker.step(time, Some(&frame), [0.0; 3])?;
            }
            let begin = Instant::now();
            for (time, frame) in times.iter().zip(&frames) {
                black_box(tracker.step(*time, (!coasts).then_some(frame), [0.0; 3])?);
            }
            took.push(begin.elapsed().as_secs_f64() / f64::from(STEPS));
        }
        took.sort_by(f64::total_cmp);
        println!("{:.2} µs a step {what}", 1e6 * took[REPEATS / 2]);
    }
    Ok(())
}
