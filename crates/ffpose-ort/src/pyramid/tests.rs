//! Samples of pyramids, against bilinear interpolation pixel by pixel in f64.

// Small images.
#![allow(clippy::cast_possible_truncation, clippy::cast_possible_wrap, clippy::cast_sign_loss)]

use ffpose_core::{Error, StdThreads};
use ndarray::{Array, ArrayD, Axis, IxDyn};

use super::sampling::{LEVELS, sample_pyramid};

/// Numbers in -1…1 without a pattern.
fn numbers(shape: &[usize], mut seed: u64) -> ArrayD<f32> {
    Array::from_shape_simple_fn(IxDyn(shape), || {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (seed >> 40) as f32 / f32::from(1_u16 << 12) / 2048.0 - 1.0
    })
}

fn pyramid(batch: usize) -> [ArrayD<f32>; LEVELS] {
    std::array::from_fn(|level| numbers(&[batch, 3, 24 >> level, 40 >> level], level as u64))
}

/// The value of an image between the centers of its pixels; zero outside.
fn between(image: &ArrayD<f32>, place: [usize; 2], u: f64, v: f64) -> f64 {
    let (x, y) = (u - 0.5, v - 0.5);
    let mut sum = 0.0;
    for (row, down) in [(y.floor(), 1.0 - (y - y.floor())), (y.floor() + 1.0, y - y.floor())] {
        for (column, across) in
            [(x.floor(), 1.0 - (x - x.floor())), (x.floor() + 1.0, x - x.floor())]
        {
            let is_inside = (0.0..image.len_of(Axis(2)) as f64).contains(&row)
                && (0.0..image.len_of(Axis(3)) as f64).contains(&column);
            if is_inside {
                let [batch, channel] = place;
                sum += down
                    * across
                    * f64::from(image[[batch, channel, row as usize, column as usize]]);
            }
        }
    }
    sum
}

fn sampled(
    homographies: &ArrayD<f32>,
    levels: &ArrayD<f32>,
    plane: &ArrayD<f32>,
    pyramid: &[ArrayD<f32>; LEVELS],
    threads: usize,
) -> Result<ArrayD<f32>, Error> {
    let (views, size) = (homographies.len_of(Axis(0)), plane.shape());
    let mut y = ArrayD::from_elem(IxDyn(&[views, 3, size[1], size[2]]), f32::NAN);
    let pool = StdThreads(threads);
    let levels_of = pyramid.each_ref().map(|level| level.view());
    let plane = plane.view();
    sample_pyramid(homographies.view(), levels.view(), plane, levels_of, y.view_mut(), &pool)?;
    Ok(y)
}

#[test]
fn every_level_is_interpolated_and_zero_outside() {
    let plane = &numbers(&[2, 7, 70], 9) * 30.0;
    let mut homographies = numbers(&[8, 3, 3], 5);
    for mut matrix in homographies.outer_iter_mut() {
        matrix[[0, 2]] = 20.0;
        matrix[[1, 2]] = 12.0;
        matrix.index_axis_mut(Axis(0), 2).mapv_inplace(|number| number * 0.02);
        matrix[[2, 2]] = 1.0;
    }
    let levels = Array::from_iter((0..8_u8).map(|view| f32::from(view % 4))).into_dyn();
    let pyramid = pyramid(2);
    let y = sampled(&homographies, &levels, &plane, &pyramid, 1).unwrap();
    let mut seen = 0;
    for (at, &got) in y.indexed_iter() {
        let (view, channel, row, column) = (at[0], at[1], at[2], at[3]);
        let along = |axis: usize| {
            let (p, q) = (plane[[0, row, column]], plane[[1, row, column]]);
            let number = |n: usize| f64::from(homographies[[view, axis, n]]);
            number(0) * f64::from(p) + number(1) * f64::from(q) + number(2)
        };
        let (level, depth) = (levels[view] as usize, along(2));
        let scale = 0.5_f64.powi(level as i32);
        let expected = if depth > 1e-3 {
            let (u, v) = (along(0) / depth * scale, along(1) / depth * scale);
            between(&pyramid[level], [view / 4, channel], u, v)
        } else {
            0.0
        };
        assert!((f64::from(got) - expected).abs() < 1e-4, "{at:?}: {got} {expected}");
        seen += usize::from(expected != 0.0);
    }
    assert!(seen > y.len() / 10 && seen < y.len());
    for threads in [2, 5] {
        assert_eq!(sampled(&homographies, &levels, &plane, &pyramid, threads).unwrap(), y);
    }
}

#[test]
fn what_is_not_finite_or_behind_sees_nothing() {
    let plane = numbers(&[2, 2, 3], 1);
    for number in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX] {
        let homographies = ArrayD::from_elem(IxDyn(&[1, 3, 3]), number);
        for level in [0.0, -3.0, 99.0, f32::NAN] {
            let levels = ArrayD::from_elem(IxDyn(&[1]), level);
            let y = sampled(&homographies, &levels, &plane, &pyramid(1), 1).unwrap();
            assert!(y.iter().all(|number| number.is_finite()));
        }
    }
}

#[test]
fn wrong_shapes_are_told() {
    let (homographies, levels) = (numbers(&[3, 3, 3], 0), numbers(&[3], 0));
    let plane = numbers(&[2, 2, 3], 0);
    let told = |result: Result<_, Error>| result.unwrap_err().to_string();
    let error = told(sampled(&homographies, &levels, &plane, &pyramid(2), 1));
    assert!(error.contains("homographies") && error.contains("multiple of 2"), "{error}");
    let error = told(sampled(&homographies, &numbers(&[2], 0), &plane, &pyramid(1), 1));
    assert!(error.contains("levels"), "{error}");
    let error = told(sampled(&homographies, &levels, &numbers(&[3, 2, 3], 0), &pyramid(1), 1));
    assert!(error.contains("plane"), "{error}");
}
