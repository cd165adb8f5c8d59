//! Fractal noise against values worked out by hand, and against its laws.

use ffpose_core::Error;
use ffpose_core::noise::fractal;
use ndarray::{Array, ArrayD, IxDyn};

fn array(shape: &[usize], values: &[f32]) -> ArrayD<f32> {
    ArrayD::from_shape_vec(IxDyn(shape), values.to_vec()).unwrap()
}

/// Points given one by one, as `(3, N)`.
fn points(places: &[[f32; 3]]) -> ArrayD<f32> {
    Array::from_shape_fn((3, places.len()), |(axis, n)| places[n][axis]).into_dyn()
}

/// Values without a pattern, in -1…1.
fn lattice(side: usize) -> ArrayD<f32> {
    let value = |(x, y, z)| (12.9 * x as f32 + 78.2 * y as f32 + 37.7 * z as f32).sin();
    Array::from_shape_fn((side, side, side), value).into_dyn()
}

fn noise(places: &[[f32; 3]], lattice: &ArrayD<f32>, heights: &[f32]) -> Vec<f32> {
    let heights = array(&[heights.len()], heights);
    fractal(points(places).view(), lattice.view(), heights.view()).unwrap().to_vec()
}

#[track_caller]
fn assert_close(got: &[f32], expected: &[f32], tolerance: f32) {
    assert_eq!(got.len(), expected.len());
    for (got, expected) in got.iter().zip(expected) {
        assert!((got - expected).abs() <= tolerance, "{got} is not {expected}");
    }
}

#[test]
fn values_between_lattice_points_are_smoothed() {
    // Corner (x, y, z) holds 4x + 2y + z; a quarter of the way is 3/16 - 2/64 = 5/32 after smoothing.
    let lattice = array(&[2, 2, 2], &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
    let places =
        [[0.0, 0.0, 0.0], [0.0, 1.0, 1.0], [0.25, 0.0, 0.0], [0.5, 0.5, 0.5], [0.0, 0.0, 0.75]];
    let expected = [0.0, 3.0, 0.625, 3.5, 1.0 - 0.156_25];
    assert_close(&noise(&places, &lattice, &[1.0]), &expected, 1e-6);
}

#[test]
fn the_lattice_repeats() {
    let (lattice, places) = (lattice(8), [[0.3, 1.7, 6.9], [7.5, 7.25, 7.125]]);
    let there = places.map(|place| [place[0] - 8.0, place[1] + 16.0, place[2] - 24.0]);
    assert_close(&noise(&there, &lattice, &[1.0]), &noise(&places, &lattice, &[1.0]), 1e-5);
}

#[test]
fn octaves_add_up() {
    let (lattice, place) = (lattice(16), [[1.3_f32, 2.9, -4.2]]);
    let [x, y, z] = place[0];
    // A turn by 60 degrees about (1, 1, 1) has the rows (2, -1, 2) / 3 and their cyclic shifts.
    let turned = |a: f32, b: f32, c: f32| 1.97 / 3.0 * (2.0 * a - b + 2.0 * c) + 17.3;
    let finer = [[turned(x, y, z), turned(y, z, x), turned(z, x, y)]];
    let first = noise(&place, &lattice, &[1.0])[0];
    let second = noise(&finer, &lattice, &[1.0])[0];
    let expected = [0.75 * first - 0.5 * second];
    assert_close(&noise(&place, &lattice, &[0.75, -0.5]), &expected, 1e-4);
    assert_close(&noise(&place, &lattice, &[]), &[0.0], 0.0);
}

#[test]
fn nan_goes_through_and_infinity_does_not_panic() {
    let lattice = lattice(4);
    let found = noise(
        &[
            [f32::NAN, 0.5, 0.5],
            [0.5, 0.5, 0.5],
            [f32::INFINITY, 0.0, f32::NEG_INFINITY],
            [3e38; 3],
        ],
        &lattice,
        &[1.0, 0.5],
    );
    assert!(found[0].is_nan());
    assert!(found[1].is_finite());
}

#[test]
fn wrong_shapes_are_named() {
    let (good, cube, heights) = (points(&[[0.0; 3]]), lattice(4), array(&[1], &[1.0]));
    let name = |result: Result<_, Error>| match result {
        Err(Error::Shape { name, .. } | Error::Strides { name, .. }) => name,
        other => panic!("{other:?}"),
    };
    let flat = array(&[3], &[0.0; 3]);
    assert_eq!(name(fractal(flat.view(), cube.view(), heights.view())), "points");
    assert_eq!(name(fractal(good.t(), cube.view(), heights.view())), "points");
    for side in [0, 3] {
        assert_eq!(name(fractal(good.view(), lattice(side).view(), heights.view())), "lattice");
    }
    assert_eq!(name(fractal(good.view(), flat.view(), heights.view())), "lattice");
    assert_eq!(name(fractal(good.view(), cube.t(), heights.view())), "lattice");
    assert_eq!(name(fractal(good.view(), cube.view(), good.view())), "heights");
}
