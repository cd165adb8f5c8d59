//! A network's outputs as a pose, checked, and as a JSON line: meters, `(w, x, y, z)`, degrees.

use serde_json::{Map, Value, json};

use crate::error::{Error, Result};

/// Deviation of a quaternion's norm from one that is normalized.
const TOLERANCE: f64 = 1e-3;

/// Cosine of the pitch below which roll and yaw turn about one axis.
const GIMBAL_LOCK: f64 = 1e-8;

/// What a network gives for one image.
#[derive(Clone, Debug)]
pub struct Outputs {
    /// Meters, camera frame; from a network that locates the camera its center, in the frame of the world.
    pub translation: [f64; 3],
    /// `(w, x, y, z)`, of norm 1 and either sign.
    pub orientation: [f64; 4],
    /// Where the network knows it.
    pub uncertainty: Option<Uncertainty>,
}

/// How far a pose may be off.
#[derive(Clone, Debug)]
pub struct Uncertainty {
    /// Square meters, camera frame.
    pub translation_covariance: [[f64; 3]; 3],
    /// Square radians, camera frame.
    pub rotation_covariance: [[f64; 3]; 3],
    /// Probability that the object is in the image at all.
    pub in_view: f64,
    /// The second most likely orientation, as [`Outputs::orientation`].
    pub alternative: [f64; 4],
    /// Probabilities that the true orientation is near the one, and near the other.
    pub probabilities: [f64; 2],
}

/// What a model says of how to read its outputs.
#[derive(Clone, Copy, Debug, Default)]
pub struct Meaning {
    /// An image whose probability that the object is in view lies below this is flagged.
    pub in_view_threshold: Option<f64>,
    /// Of the t distributions of the errors of translation and rotation; `None` for Gaussian errors.
    pub degrees_of_freedom: Option<[f64; 2]>,
    /// Whether the network gives the camera's center in the world in place of a translation.
    pub locates_camera: bool,
}

impl Outputs {
    /// Returns the outputs with orientations of norm 1 and canonical sign.
    ///
    /// # Errors
    /// A number is not finite, an orientation has not norm 1, or a probability is none.
    pub fn checked(mut self) -> Result<Self> {
        expect_finite("translation", &self.translation)?;
        self.orientation = unit("orientation", self.orientation)?;
        if let Some(said) = &mut self.uncertainty {
            expect_finite("translation_covariance", said.translation_covariance.as_flattened())?;
            expect_finite("rotation_covariance", said.rotation_covariance.as_flattened())?;
            expect_probability("in_view", said.in_view)?;
            for probability in said.probabilities {
                expect_probability("probabilities", probability)?;
            }
            said.alternative = unit("alternative", said.alternative)?;
        }
        Ok(self)
    }

    /// Returns whether the network says that the object is not in view; None where it does not tell.
    pub fn flagged(&self, meaning: &Meaning) -> Option<bool> {
        Some(self.uncertainty.as_ref()?.in_view < meaning.in_view_threshold?)
    }
}

/// Returns the document of a pose, with the names of `ffpose predict --json` but for the image's.
///
/// Where the network locates the camera, the pose is that of the world in the camera frame, and the camera's center is there too.
///
/// The outputs are those of [`Outputs::checked`].
pub fn document(outputs: &Outputs, meaning: &Meaning) -> Map<String, Value> {
    let locates_camera = meaning.locates_camera;
    let q = outputs.orientation;
    let mut fields = Map::new();
    let mut put = |name: &str, value: Value| fields.insert(name.into(), value);
    let translation = if locates_camera {
        rotated(q, outputs.translation).map(|value| 0.0 - value)
    } else {
        outputs.translation
    };
    put("translation_m", json!(translation));
    put("orientation_wxyz", json!(q));
    put("roll_pitch_yaw_deg", json!(euler(q).map(f64::to_degrees)));
    if locates_camera {
        put("locates", json!("camera"));
        put("camera_center_m", json!(outputs.translation));
    }
    if let Some(uncertainty) = &outputs.uncertainty {
        put("translation_covariance_m2", json!(uncertainty.translation_covariance));
        put("rotation_covariance_rad2", json!(uncertainty.rotation_covariance));
        put("degrees_of_freedom", json!(meaning.degrees_of_freedom));
        put("alternative_wxyz", json!(uncertainty.alternative));
        put("probabilities", json!(uncertainty.probabilities));
        put("in_view", json!(uncertainty.in_view));
        if let Some(flagged) = outputs.flagged(meaning) {
            put("flagged", json!(flagged));
        }
    }
    fields
}

fn expect_finite(name: &str, values: &[f64]) -> Result<()> {
    if values.iter().all(|value| value.is_finite()) {
        return Ok(());
    }
    Err(Error::new(format!("{name}: expected finite numbers, got {values:?}")))
}

fn expect_probability(name: &str, value: f64) -> Result<()> {
    if (0.0..=1.0).contains(&value) {
        return Ok(());
    }
    Err(Error::new(format!("{name}: expected a probability, got {value}")))
}

/// Returns the unit quaternion whose first nonzero component is positive.
fn unit(name: &str, q: [f64; 4]) -> Result<[f64; 4]> {
    let norm = q.iter().map(|value| value * value).sum::<f64>().sqrt();
    if (norm - 1.0).abs() <= TOLERANCE {
        let is_negative = q.iter().find(|value| **value != 0.0).is_some_and(|first| *first < 0.0);
        let scale = if is_negative { -norm } else { norm };
        return Ok(q.map(|value| value / scale + 0.0)); // no negative zero
    }
    Err(Error::new(format!("{name}: expected norm 1 within {TOLERANCE}, got {norm}")))
}

/// Returns a vector rotated by a unit quaternion: `v + 2 w (u × v) + 2 u × (u × v)` with `q = (w, u)`.
fn rotated([w, axis @ ..]: [f64; 4], v: [f64; 3]) -> [f64; 3] {
    let once = cross(axis, v);
    let twice = cross(axis, once);
    std::array::from_fn(|i| v[i] + 2.0 * (w * once[i] + twice[i]))
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Returns roll, pitch and yaw, radians: rotations about fixed x, then y, then z, as `ffpose.quaternion_to_euler`.
///
/// Ye et al., Sensors 2023, 23(20), 8633, Eq. 12, with the minus in the pitch that inverts its arctangents; in gimbal lock roll is
/// zero. Roll and yaw are in `(-π, π]`.
fn euler([w, x, y, z]: [f64; 4]) -> [f64; 3] {
    let sin_pitch = 2.0 * (w * y - x * z);
    let (roll_sin, roll_cos) = (2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y));
    let cos_pitch = roll_sin.hypot(roll_cos);
    let pitch = sin_pitch.atan2(cos_pitch);
    let (roll, yaw) = if cos_pitch < GIMBAL_LOCK {
        (0.0, -2.0 * sin_pitch.signum() * x.atan2(w))
    } else {
        let yaw = (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z));
        (roll_sin.atan2(roll_cos), yaw)
    };
    [roll, pitch, yaw].map(|angle| if angle <= -std::f64::consts::PI { -angle } else { angle })
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_1_SQRT_2;

    use super::*;

    fn document(outputs: &Outputs, meaning: &Meaning) -> Result<Map<String, Value>> {
        Ok(super::document(&outputs.clone().checked()?, meaning))
    }

    fn outputs(orientation: [f64; 4], in_view: Option<f64>) -> Outputs {
        let covariance = [[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0]];
        let uncertainty = in_view.map(|in_view| Uncertainty {
            translation_covariance: covariance,
            rotation_covariance: covariance,
            in_view,
            alternative: [0.0, -0.6, 0.0, 0.8],
            probabilities: [0.75, 0.125],
        });
        Outputs { translation: [1.0, 2.0, 10.0], orientation, uncertainty }
    }

    fn flagging(in_view_threshold: Option<f64>) -> Meaning {
        Meaning { in_view_threshold, ..Meaning::default() }
    }

    fn angles(orientation: [f64; 4]) -> [f64; 3] {
        let document = document(&outputs(orientation, None), &Meaning::default()).unwrap();
        serde_json::from_value(document["roll_pitch_yaw_deg"].clone()).unwrap()
    }

    #[test]
    fn the_sign_is_canonical_and_the_norm_one() {
        for (q, expected) in [
            ([-0.6, 0.8, 0.0, 0.0], [0.6, -0.8, 0.0, 0.0]),
            ([0.0, 0.0, 0.0, -1.0005], [0.0, 0.0, 0.0, 1.0]),
        ] {
            let document = document(&outputs(q, None), &flagging(Some(0.5))).unwrap();
            assert_eq!(document["orientation_wxyz"], json!(expected));
            assert_eq!(document["translation_m"], json!([1.0, 2.0, 10.0]));
            assert_eq!(document.len(), 3);
        }
    }

    #[test]
    fn quarter_and_half_turns_have_their_angles() {
        const H: f64 = FRAC_1_SQRT_2;
        for (q, expected) in [
            ([1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0]),
            ([H, H, 0.0, 0.0], [90.0, 0.0, 0.0]),
            ([H, 0.0, H, 0.0], [0.0, 90.0, 0.0]),
            ([H, 0.0, 0.0, -H], [0.0, 0.0, -90.0]),
            ([0.0, 1.0, 0.0, 0.0], [180.0, 0.0, 0.0]),
            ([0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 180.0]),
            ([0.5, -0.5, 0.5, 0.5], [0.0, 90.0, 90.0]), // gimbal lock: yaw less roll of 90 degrees
        ] {
            for (got, expected) in angles(q).into_iter().zip(expected) {
                assert!((got - expected).abs() < 1e-6, "{q:?}: {:?}", angles(q));
            }
        }
    }

    #[test]
    fn a_located_camera_becomes_the_pose_of_the_world() {
        const H: f64 = FRAC_1_SQRT_2;
        for (q, expected) in [
            ([1.0, 0.0, 0.0, 0.0], [-1.0, -2.0, -10.0]),
            ([H, 0.0, 0.0, H], [2.0, -1.0, -10.0]), // x to y: (1, 2, 10) becomes (-2, 1, 10)
            ([H, H, 0.0, 0.0], [-1.0, 10.0, -2.0]), // y to z: (1, 2, 10) becomes (1, -10, 2)
        ] {
            let meaning = Meaning { locates_camera: true, ..Meaning::default() };
            let document = document(&outputs(q, None), &meaning).unwrap();
            assert_eq!(document["locates"], json!("camera"));
            assert_eq!(document["camera_center_m"], json!([1.0, 2.0, 10.0]));
            let t: [f64; 3] = serde_json::from_value(document["translation_m"].clone()).unwrap();
            assert!(t.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{t:?}");
        }
    }

    #[test]
    fn a_doubtful_view_is_flagged() {
        let q = [1.0, 0.0, 0.0, 0.0];
        let flagged = |in_view, threshold| {
            let document = document(&outputs(q, Some(in_view)), &flagging(threshold)).unwrap();
            document.get("flagged").cloned()
        };
        assert_eq!(flagged(0.4, Some(0.5)), Some(json!(true)));
        assert_eq!(flagged(0.5, Some(0.5)), Some(json!(false)));
        assert_eq!(flagged(0.5, None), None);
        let document = document(&outputs(q, Some(0.5)), &Meaning::default()).unwrap();
        assert_eq!(document["translation_covariance_m2"][1], json!([0.0, 2.0, 0.0]));
        assert_eq!(document["rotation_covariance_rad2"][2][2], json!(3.0));
        assert_eq!(document["degrees_of_freedom"], Value::Null);
        let meaning = Meaning { degrees_of_freedom: Some([4.5, 3.25]), ..Meaning::default() };
        let document = self::document(&outputs(q, Some(0.5)), &meaning).unwrap();
        assert_eq!(document["degrees_of_freedom"], json!([4.5, 3.25]));
    }

    #[test]
    fn the_second_orientation_has_its_canonical_sign_and_both_their_probabilities() {
        let document =
            document(&outputs([1.0, 0.0, 0.0, 0.0], Some(0.5)), &Meaning::default()).unwrap();
        assert_eq!(document["alternative_wxyz"], json!([0.0, 0.6, 0.0, -0.8]));
        assert_eq!(document["probabilities"], json!([0.75, 0.125]));
    }

    #[test]
    fn what_is_no_pose_is_refused() {
        let q = [1.0, 0.0, 0.0, 0.0];
        let nan = Outputs { translation: [f64::NAN, 0.0, 0.0], ..outputs(q, None) };
        let mut infinite = outputs(q, Some(0.5));
        infinite.uncertainty.as_mut().unwrap().rotation_covariance[1][2] = f64::INFINITY;
        let (mut none, mut twice) = (outputs(q, Some(0.5)), outputs(q, Some(0.5)));
        none.uncertainty.as_mut().unwrap().alternative = [0.0; 4];
        twice.uncertainty.as_mut().unwrap().probabilities = [0.5, 2.0];
        for (outputs, message) in [
            (nan, "translation: expected finite numbers, got [NaN"),
            (infinite, "rotation_covariance: expected finite"),
            (none, "alternative: expected norm 1 within 0.001, got 0"),
            (twice, "probabilities: expected a probability, got 2"),
            (outputs([0.0; 4], None), "orientation: expected norm 1 within 0.001, got 0"),
            (outputs([f64::NAN; 4], None), "norm 1 within 0.001, got NaN"),
            (outputs(q, Some(1.5)), "in_view: expected a probability, got 1.5"),
            (outputs(q, Some(f64::NAN)), "in_view: expected a probability, got NaN"),
        ] {
            let error = document(&outputs, &Meaning::default()).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
    }
}
