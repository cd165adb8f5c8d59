//! Fractal noise against values worked out by hand, and against its laws.

use ffpose_core::Error;
use ffpose_scene::noise::fractal;
use ndarray::{Array, ArrayD, IxDyn};

fn array(shape: &[usize], values: &[f32]) -> ArrayD<f32> {
    ArrayD::from_shape_vec(IxDyn(shape), values.to_vec()).unwrap()
}

/// Points given one by one, as `(3, N)`.
fn points(places: &[[f32; 3]]) -> ArrayD<f32> {
    Array::from_shape_fn((3, places.len()), |(axis, n)| places[n][axis]).into_dyn()
}

fn noise(places: &[[f32; 3]], heights: &[f32]) -> Vec<f32> {
    let heights = array(&[heights.len()], heights);
    fractal(points(places).view(), heights.view()).unwrap().to_vec()
}

#[track_caller]
fn assert_close(got: &[f32], expected: &[f32], tolerance: f32) {
    assert_eq!(got.len(), expected.len());
    for (got, expected) in got.iter().zip(expected) {
        assert!((got - expected).abs() <= tolerance, "{got} is not {expected}");
    }
}

#[test]
fn values_between_whole_numbers_are_smoothed() {
    let corner = |place| noise(&[place], &[1.0])[0];
    let (first, right) = (corner([-2.0, 5.0, 9.0]), corner([-1.0, 5.0, 9.0]));
    let (up, both) = (corner([-2.0, 6.0, 9.0]), corner([-1.0, 6.0, 9.0]));
    // A quarter of the way is 3/16 - 2/64 = 5/32 after smoothing.
    let places = [[-1.75, 5.0, 9.0], [-2.0, 5.25, 9.0], [-1.5, 5.5, 9.0]];
    let expected = [
        first + (right - first) * 0.156_25,
        first + (up - first) * 0.156_25,
        (first + right + up + both) / 4.0,
    ];
    assert_close(&noise(&places, &[1.0]), &expected, 1e-6);
}

#[test]
fn values_lie_within_one_and_differ() {
    let places: Vec<[f32; 3]> = (0..1000).map(|n| [n as f32 - 500.0, 3.0, -7.0]).collect();
    let mut values = noise(&places, &[1.0]);
    assert!(values.iter().all(|value| value.abs() <= 1.0));
    values.sort_by(f32::total_cmp);
    values.dedup();
    assert_eq!(values.len(), 1000);
}

#[test]
fn octaves_add_up() {
    let place = [[1.3_f32, 2.9, -4.2]];
    let [x, y, z] = place[0];
    // A turn by 60 degrees about (1, 1, 1) has the rows (2, -1, 2) / 3 and their cyclic shifts.
    let turned = |a: f32, b: f32, c: f32| 1.97 / 3.0 * (2.0 * a - b + 2.0 * c) + 17.3;
    let finer = [[turned(x, y, z), turned(y, z, x), turned(z, x, y)]];
    let (first, second) = (noise(&place, &[1.0])[0], noise(&finer, &[1.0])[0]);
    assert_close(&noise(&place, &[0.75, -0.5]), &[0.75 * first - 0.5 * second], 1e-4);
    assert_close(&noise(&place, &[]), &[0.0], 0.0);
}

#[test]
fn nan_goes_through_and_infinity_does_not_panic() {
    let found = noise(
        &[
            [f32::NAN, 0.5, 0.5],
            [0.5, 0.5, 0.5],
            [f32::INFINITY, 0.0, f32::NEG_INFINITY],
            [3e38; 3],
        ],
        &[1.0, 0.5],
    );
    assert!(found[0].is_nan());
    assert!(found[1].is_finite());
}

#[test]
fn wrong_shapes_are_named() {
    let (good, heights) = (points(&[[0.0; 3], [1.0; 3]]), array(&[1], &[1.0]));
    let name = |result: Result<_, Error>| match result {
        Err(Error::Shape { name, .. }) => name,
        other => panic!("{other:?}"),
    };
    let flat = array(&[3], &[0.0; 3]);
    assert_eq!(name(fractal(flat.view(), heights.view())), "points");
    assert_eq!(name(fractal(good.t(), heights.view())), "points");
    assert_eq!(name(fractal(good.view(), good.view())), "heights");
}
