//! Quaternions and pose errors against values worked out by hand, and against their laws.

use std::f64::consts::FRAC_1_SQRT_2;

use ffpose_core::pose_error::{
    PosePairs, esa_score, rotation_error, speed_plus_score, translation_error,
};
use ffpose_core::{Error, Real, quaternion};
use ndarray::{ArrayD, IxDyn};

fn rows<T: Real, const N: usize>(rows: &[[f64; N]]) -> ArrayD<T> {
    let values = rows.iter().flatten().map(|value| T::nearest(*value)).collect();
    ArrayD::from_shape_vec(IxDyn(&[rows.len(), N]), values).unwrap()
}

#[track_caller]
fn assert_close<T: Real>(got: &ArrayD<T>, expected: &[f64], tolerance: f64) {
    assert_eq!(got.len(), expected.len());
    for (got, expected) in got.iter().zip(expected) {
        let got: f64 = (*got).into();
        assert!((got - expected).abs() <= tolerance, "{got} is not {expected}");
    }
}

/// The quaternion of a turn about z.
fn about_z(angle: f64) -> [f64; 4] {
    [(angle / 2.0).cos(), 0.0, 0.0, (angle / 2.0).sin()]
}

#[test]
fn normalizing_divides_by_the_norm() {
    let q = rows::<f64, 4>(&[[3.0, 0.0, 0.0, -4.0], [1.0, 1.0, 1.0, 1.0]]);
    let unit = quaternion::normalize(q.view()).unwrap();
    assert_close(&unit, &[0.6, 0.0, 0.0, -0.8, 0.5, 0.5, 0.5, 0.5], 1e-16);
}

#[test]
fn normalizing_neither_overflows_nor_vanishes() {
    for scale in [1e-300, 1e300, 5e-324] {
        let unit = quaternion::normalize(rows::<f64, 4>(&[[0.0, scale, 0.0, -scale]]).view());
        assert_close(&unit.unwrap(), &[0.0, FRAC_1_SQRT_2, 0.0, -FRAC_1_SQRT_2], 1e-15);
    }
    let single = quaternion::normalize(rows::<f32, 4>(&[[3e38, 3e38, 3e38, 3e38]]).view());
    assert_close(&single.unwrap(), &[0.5; 4], 0.0);
}

#[test]
fn nan_goes_through_a_normalization() {
    let q = rows::<f32, 4>(&[[f64::NAN, 0.0, 0.0, 0.0], [0.0, 2.0, 0.0, 0.0]]);
    let unit = quaternion::normalize(q.view()).unwrap();
    assert!(unit.iter().take(4).all(|value| value.is_nan()));
    assert!(unit.iter().skip(4).eq(&[0.0, 1.0, 0.0, 0.0]));
}

#[test]
fn the_gradient_is_across_the_quaternion_over_its_norm() {
    let q = rows::<f64, 4>(&[[2.0, 0.0, 0.0, 0.0], [0.6, 0.8, 0.0, 0.0]]);
    let grad = rows::<f64, 4>(&[[5.0, 6.0, 7.0, 8.0], [1.0, 0.0, 0.0, 1.0]]);
    let by_q = quaternion::normalize_backward(grad.view(), q.view()).unwrap();
    assert_close(&by_q, &[0.0, 3.0, 3.5, 4.0, 0.64, -0.48, 0.0, 1.0], 1e-15);
}

#[test]
fn the_canonical_one_has_its_first_component_above_zero() {
    let q = rows::<f32, 4>(&[
        [-1.0, 2.0, -3.0, 4.0],
        [1.0, -2.0, 3.0, -4.0],
        [0.0, -1.0, 5.0, 0.0],
        [-0.0, 0.0, 0.0, -2.0],
    ]);
    let expected =
        [1.0, -2.0, 3.0, -4.0, 1.0, -2.0, 3.0, -4.0, 0.0, 1.0, -5.0, 0.0, 0.0, 0.0, 0.0, 2.0];
    assert_close(&quaternion::canonical(q.view()).unwrap(), &expected, 0.0);
}

#[test]
fn euler_angles_of_single_turns() {
    let h = FRAC_1_SQRT_2;
    let q = rows::<f64, 4>(&[[h, h, 0.0, 0.0], [h, 0.0, h, 0.0], [-h, 0.0, 0.0, -h]]);
    let expected = [90.0, 0.0, 0.0, 0.0, 90.0, 0.0, 0.0, 0.0, 90.0];
    assert_close(&quaternion::to_euler(q.view()).unwrap(), &expected, 1e-13);
}

#[test]
fn euler_angles_come_back() {
    let angles = rows::<f64, 3>(&[[20.0, -40.0, 140.0], [-170.0, 85.0, -5.0], [60.0, 0.0, -179.0]]);
    let q = quaternion::from_euler(angles.view()).unwrap();
    assert!(q.rows().into_iter().all(|q| q[0] >= 0.0));
    let back = quaternion::to_euler(q.view()).unwrap();
    assert_close(&back, angles.as_slice().unwrap(), 1e-11);
}

#[test]
fn a_locked_gimbal_keeps_the_rotation() {
    let locked = [[20.0, 90.0, -50.0], [20.0, -90.0, -50.0], [170.0, 90.0, 110.0]];
    let q = quaternion::from_euler(rows::<f64, 3>(&locked).view()).unwrap();
    let angles = quaternion::to_euler(q.view()).unwrap();
    assert!(angles.rows().into_iter().all(|angles| angles[0] == 0.0));
    let back = quaternion::from_euler(angles.view()).unwrap();
    assert_close(&rotation_error(back.view(), q.view()).unwrap(), &[0.0; 3], 1e-5);
}

/// Half a turn is a little more than π in single precision, which has the other sign.
#[test]
fn half_a_turn_is_the_same_in_both_precisions() {
    let half_turns = [[180.0, 0.0, 0.0], [0.0, 180.0, 0.0], [0.0, 0.0, 180.0], [180.0, 0.0, 90.0]];
    let q = quaternion::from_euler(rows::<f32, 3>(&half_turns).view()).unwrap();
    let twin = quaternion::from_euler(rows::<f64, 3>(&half_turns).view()).unwrap();
    let twin: Vec<[f64; 4]> = twin.rows().into_iter().map(|q| [q[0], q[1], q[2], q[3]]).collect();
    assert_eq!(q, rows::<f32, 4>(&twin));
    let angles = quaternion::to_euler(rows::<f32, 4>(&[[0.0, 1.0, 0.0, 0.0]]).view()).unwrap();
    assert_eq!(angles.as_slice().unwrap(), [180.0, 0.0, 0.0]);
}

#[test]
fn translation_errors_are_distances() {
    let t = rows::<f32, 3>(&[[1.0, 2.0, 3.0], [0.0, 0.0, 0.0]]);
    let t_hat = rows::<f32, 3>(&[[1.0, 5.0, 7.0], [2.0, 3.0, 6.0]]);
    assert_close(&translation_error(t_hat.view(), t.view()).unwrap(), &[5.0, 7.0], 0.0);
}

#[test]
fn rotation_errors_ignore_sign_and_norm() {
    let [w, x, y, z] = about_z(60_f64.to_radians());
    let q = rows::<f64, 4>(&[[1.0, 0.0, 0.0, 0.0]; 4]);
    let q_hat = rows(&[
        [w, x, y, z],
        [-w, -x, -y, -z],
        [3.0 * w, 0.0, 0.0, 3.0 * z],
        [0.0, 0.0, 9e200, 0.0],
    ]);
    let errors = rotation_error(q_hat.view(), q.view()).unwrap();
    assert_close(&errors, &[60.0, 60.0, 60.0, 180.0], 1e-13);
}

/// An arccosine in single precision would give zero below 0.02°.
#[test]
fn rotation_errors_keep_small_angles_in_single_precision() {
    let q = rows::<f32, 4>(&[[1.0, 0.0, 0.0, 0.0]; 2]);
    let q_hat = rows::<f32, 4>(&[1e-3, 1e-7].map(|degrees: f64| about_z(degrees.to_radians())));
    let errors = rotation_error(q_hat.view(), q.view()).unwrap();
    assert_close(&errors, &[1e-3, 1e-7], 1e-10);
}

#[test]
fn scores_add_relative_distance_and_angle() {
    let t = rows::<f64, 3>(&[[0.0, 0.0, 10.0]; 4]);
    let q = rows::<f64, 4>(&[[1.0, 0.0, 0.0, 0.0]; 4]);
    let t_hat = rows(&[[0.0, 3.0, 14.0], [0.0, 0.0, 10.02], [0.0, 0.0, 10.03], [0.0, 0.0, 10.02]]);
    let small = 0.16_f64.to_radians();
    let q_hat = rows(&[about_z(0.25), about_z(0.25), about_z(small), about_z(small)]);
    let pairs = PosePairs { t_hat: t_hat.view(), q_hat: q_hat.view(), t: t.view(), q: q.view() };
    let esa = [0.75, 0.252, 0.003 + small, 0.002 + small];
    assert_close(&esa_score(&pairs).unwrap(), &esa, 1e-14);
    assert_close(&speed_plus_score(&pairs).unwrap(), &[0.75, 0.25, 0.003, 0.0], 1e-14);
}

#[test]
fn zero_vectors_are_named() {
    let zero = |name, row| Error::ZeroNorm { name, row };
    let q = rows::<f64, 4>(&[[1.0, 0.0, 0.0, 0.0], [0.0; 4]]);
    let ones = rows::<f64, 4>(&[[1.0; 4]; 2]);
    assert_eq!(quaternion::normalize(q.view()), Err(zero("q", 1)));
    assert_eq!(quaternion::normalize_backward(ones.view(), q.view()), Err(zero("q", 1)));
    assert_eq!(quaternion::canonical(q.view()), Err(zero("q", 1)));
    assert_eq!(quaternion::to_euler(q.view()), Err(zero("q", 1)));
    assert_eq!(rotation_error(q.view(), ones.view()), Err(zero("q_hat", 1)));
    let t = rows::<f64, 3>(&[[0.0; 3]; 2]);
    let pairs = PosePairs { t_hat: t.view(), q_hat: ones.view(), t: t.view(), q: ones.view() };
    assert_eq!(esa_score(&pairs), Err(zero("t", 0)));
}

#[test]
fn measurements_do_not_hide_what_is_not_finite() {
    let good = rows::<f64, 3>(&[[1.0; 3]; 2]);
    let bad = rows::<f64, 3>(&[[1.0; 3], [0.0, f64::INFINITY, 0.0]]);
    let error = Error::NotFinite { name: "t_hat", row: 1, got: f64::INFINITY };
    assert_eq!(translation_error(bad.view(), good.view()), Err(error));
    let nan = rows::<f64, 4>(&[[f64::NAN, 0.0, 0.0, 0.0]]);
    let error = rotation_error(nan.view(), nan.view()).unwrap_err();
    assert!(matches!(error, Error::NotFinite { name: "q_hat", row: 0, got } if got.is_nan()));
}

#[test]
fn shapes_that_do_not_fit_are_refused() {
    let wrong = |name, expected: &str, got: &[usize]| {
        Err(Error::Shape { name, expected: expected.into(), got: got.to_vec() })
    };
    let zeros = |shape: &[usize]| ArrayD::<f64>::zeros(shape);
    let normalize = |shape: &[usize]| quaternion::normalize(zeros(shape).view());
    assert_eq!(normalize(&[2, 3]), wrong("q", "(..., 4)", &[2, 3]));
    assert_eq!(normalize(&[]), wrong("q", "(..., 4)", &[]));
    assert_eq!(normalize(&[3, 0, 4]).unwrap().shape(), [3, 0, 4]);
    let compare = |a: &[usize], b: &[usize]| translation_error(zeros(a).view(), zeros(b).view());
    assert_eq!(compare(&[3], &[3]), wrong("t_hat", "(N, 3)", &[3]));
    assert_eq!(compare(&[2, 3], &[1, 3]), wrong("t", "(2, 3)", &[1, 3]));
    assert_eq!(compare(&[0, 3], &[0, 3]).unwrap().shape(), [0]);
}

#[test]
fn errors_say_expected_and_got() {
    let error = Error::Shape { name: "q", expected: "(..., 4)".into(), got: vec![3] };
    assert_eq!(error.to_string(), "q must have shape (..., 4), got (3,)");
    let error = Error::ZeroNorm { name: "q", row: 7 };
    assert_eq!(error.to_string(), "q must have a norm above zero, got a zero vector in row 7");
}
