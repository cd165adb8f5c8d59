//! Cameras: pinholes, and such behind a lens that distorts, as `ffpose.geometry` in Python has them.

use std::fmt;
use std::path::Path;

use serde_json::Value;

use crate::error::{Error, Result};
use crate::files;

/// Largest number of bytes of a camera's file.
const MAX_BYTES: u64 = 1 << 16;

const NAMES: [&str; 6] = ["width", "height", "fx", "fy", "cx", "cy"];

/// A camera, in pixels: the image covers `[0, width] x [0, height]`, its first pixel has its center at `(0.5, 0.5)`.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Width of the image.
    pub width: usize,
    /// Height of the image.
    pub height: usize,
    /// Focal length across.
    pub fx: f64,
    /// Focal length down.
    pub fy: f64,
    /// Place of the principal point across.
    pub cx: f64,
    /// Place of the principal point down.
    pub cy: f64,
    /// `k1, k2, p1, p2, k3` of a lens that distorts, in `OpenCV`'s model and order.
    pub distortion: Option<[f64; 5]>,
}

impl Camera {
    /// Reads a camera from a JSON file.
    ///
    /// # Errors
    /// It is no file that can be read, or no camera.
    pub fn read(path: &Path) -> Result<Self> {
        let data = files::read(path, MAX_BYTES);
        let value = data.and_then(|data| {
            serde_json::from_slice(&data).map_err(|error| Error::new(error.to_string()))
        });
        value.and_then(|value| Self::from_json(&value)).map_err(|error| error.of(path.display()))
    }

    /// Reads a camera of the keys width, height, fx, fy, cx, cy and, where there is a lens, distortion.
    ///
    /// # Errors
    /// A key is missing or another, a number is not finite, or a size or focal length is not above zero.
    pub fn from_json(value: &Value) -> Result<Self> {
        let expected = |what: &str| Error::new(format!("camera: expected {what}, got {value}"));
        let fields = value.as_object().ok_or_else(|| expected("an object"))?;
        let is_known = |name: &String| NAMES.contains(&name.as_str()) || name == "distortion";
        if !fields.keys().all(is_known) || NAMES.iter().any(|name| !fields.contains_key(*name)) {
            return Err(expected(&format!("the keys {}", NAMES.join(", "))));
        }
        let side = |name: &str| {
            let side = fields[name].as_u64().filter(|&side| side > 0);
            side.and_then(|side| usize::try_from(side).ok())
                .ok_or_else(|| expected(&format!("a {name} of at least 1")))
        };
        let number = |name: &str| {
            let number = fields[name].as_f64().filter(|number| number.is_finite());
            number.ok_or_else(|| expected(&format!("a finite {name}")))
        };
        let distortion = fields.get("distortion").map(|value| {
            let numbers = serde_json::from_value::<[f64; 5]>(value.clone()).ok();
            numbers.ok_or_else(|| expected("a distortion of five numbers"))
        });
        let camera = Self {
            width: side("width")?,
            height: side("height")?,
            fx: number("fx")?,
            fy: number("fy")?,
            cx: number("cx")?,
            cy: number("cy")?,
            distortion: distortion.transpose()?,
        };
        if camera.fx.min(camera.fy) > 0.0 { Ok(camera) } else { Err(expected("fx > 0 and fy > 0")) }
    }

    /// Refuses an image of another aspect ratio than this camera's.
    ///
    /// # Errors
    /// The aspect ratio is another.
    pub fn expect_aspect(&self, width: usize, height: usize) -> Result<()> {
        if width as u128 * self.height as u128 == height as u128 * self.width as u128 {
            return Ok(());
        }
        Err(Error::new(format!(
            "expected the aspect ratio of its camera, {self}, got an image of {width}x{height} pixels, which another camera \
             took: name that one (--camera FILE), or resize any image to the network's input (--resize)"
        )))
    }

    /// Returns the camera of this camera's image resized to `width` x `height`.
    pub fn resized(&self, width: usize, height: usize) -> Self {
        let (x, y) = (width as f64 / self.width as f64, height as f64 / self.height as f64);
        let (fx, fy, cx, cy) = (self.fx * x, self.fy * y, self.cx * x, self.cy * y);
        Self { width, height, fx, fy, cx, cy, distortion: self.distortion }
    }

    /// Returns the camera of a piece of the image, whose first pixel is `(left, top)`.
    pub fn cropped(&self, left: usize, top: usize, width: usize, height: usize) -> Self {
        let (cx, cy) = (self.cx - left as f64, self.cy - top as f64);
        Self { width, height, cx, cy, ..self.clone() }
    }

    /// Whether size and intrinsics are another's, but for a thousandth.
    pub fn agrees_with(&self, other: &Self) -> bool {
        let numbers = |camera: &Self| {
            let (width, height) = (camera.width as f64, camera.height as f64);
            [width, height, camera.fx, camera.fy, camera.cx, camera.cy]
        };
        let mut pairs = numbers(self).into_iter().zip(numbers(other));
        pairs.all(|(one, two)| (one - two).abs() <= 1e-3 * one.abs().max(two.abs()))
    }
}

impl fmt::Display for Camera {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}x{}", self.width, self.height)
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn document() -> Value {
        json!({"width": 128, "height": 96, "fx": 100, "fy": 101.5, "cx": 64, "cy": 48})
    }

    #[test]
    fn a_camera_is_read() {
        let mut fields = document();
        let camera = Camera::from_json(&fields).unwrap();
        assert_eq!((camera.width, camera.height, camera.fy, camera.cx), (128, 96, 101.5, 64.0));
        assert_eq!((camera.distortion, camera.to_string().as_str()), (None, "128x96"));
        fields["distortion"] = json!([0.1, 0, -0.2, 1e-3, 0]);
        let distortion = Camera::from_json(&fields).unwrap().distortion;
        assert_eq!(distortion, Some([0.1, 0.0, -0.2, 0.001, 0.0]));
    }

    #[test]
    fn what_is_no_camera_is_refused() {
        for (name, value, message) in [
            ("width", json!(0), "expected a width of at least 1"),
            ("height", json!(96.5), "expected a height of at least 1"),
            ("fx", json!("100"), "expected a finite fx"),
            ("fy", json!(0), "expected fx > 0 and fy > 0"),
            ("cx", Value::Null, "expected a finite cx"),
            ("skew", json!(0), "expected the keys width, height, fx, fy, cx, cy"),
            ("distortion", json!([0, 0, 0, 0]), "expected a distortion of five numbers"),
            ("distortion", Value::Null, "expected a distortion of five numbers"),
        ] {
            let mut fields = document();
            fields[name] = value;
            let error = Camera::from_json(&fields).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
        assert!(Camera::from_json(&json!({"width": 128, "height": 96})).is_err());
        assert!(Camera::from_json(&json!([128, 96])).is_err());
        assert!(Camera::read(Path::new("/nowhere/at/all")).is_err());
    }

    #[test]
    fn resizes_and_crops_move_the_principal_point() {
        let camera = Camera::from_json(&document()).unwrap();
        let expected = json!({"width": 64, "height": 192, "fx": 50, "fy": 203, "cx": 32, "cy": 96});
        assert_eq!(camera.resized(64, 192), Camera::from_json(&expected).unwrap());
        let crop = camera.cropped(10, 20, 30, 40);
        assert_eq!((crop.width, crop.height, crop.cx, crop.cy), (30, 40, 54.0, 28.0));
        assert_eq!((crop.fx, crop.fy), (100.0, 101.5));
    }

    #[test]
    fn cameras_agree_within_a_thousandth() {
        let camera = Camera::from_json(&document()).unwrap();
        let with = |fx| Camera { fx, ..camera.clone() };
        assert!(camera.agrees_with(&with(100.0999)) && camera.agrees_with(&with(99.9001)));
        assert!(!camera.agrees_with(&with(100.2)));
        assert!(!camera.agrees_with(&camera.resized(127, 96)));
        camera.expect_aspect(64, 48).unwrap();
        let error = camera.expect_aspect(64, 64).unwrap_err().to_string();
        assert!(error.contains("128x96, got an image of 64x64"), "{error}");
    }
}
