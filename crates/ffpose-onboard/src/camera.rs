//! Cameras: pinholes, and such behind a lens that distorts, as `ffpose.geometry` in Python has them.

use std::fmt;
use std::path::Path;

use serde_json::{Map, Value};

use crate::error::{Error, Result};
use crate::json;
use crate::undistortion::bend;

/// Above any side: from here on not every whole number is a float.
const SIDE_LIMIT: f64 = 9_007_199_254_740_992.0; // 2^53

/// Parts of each side of the image at whose corners a distortion is checked.
const PARTS: u32 = 32;

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
        let fields = json::read_fields(path);
        fields.and_then(|fields| Self::of(&fields)).map_err(|error| error.of(path.display()))
    }

    /// Reads a camera of the keys width, height, fx, fy, cx, cy and, where there is a lens, distortion.
    ///
    /// # Errors
    /// As of [`Self::of`], or it is no object.
    pub fn from_json(value: &Value) -> Result<Self> {
        let fields = value.as_object();
        fields.ok_or_else(|| refused("an object", value)).and_then(Self::of)
    }

    /// Reads a camera of fields; width and height may have a fraction of zero.
    ///
    /// # Errors
    /// A key is missing or another, a number is not finite, a size or focal length is not above zero, or the distortion folds the
    /// image.
    fn of(fields: &Map<String, Value>) -> Result<Self> {
        let keys = format!("the keys {}, and distortion of a lens that has it", NAMES.join(", "));
        if let Some(missing) = NAMES.iter().find(|name| !fields.contains_key(**name)) {
            return Err(refused(&keys, format!("none of the name {missing}")));
        }
        let is_known = |name: &String| NAMES.contains(&name.as_str()) || name == "distortion";
        if let Some(other) = fields.keys().find(|name| !is_known(name)) {
            return Err(refused(&keys, format!("{other} too")));
        }
        let side = |name: &str| {
            let is_side = |side: &f64| (1.0..SIDE_LIMIT).contains(side) && side.fract() == 0.0;
            let side = fields[name].as_f64().filter(is_side);
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
            // a whole number, as it was tested
            let side = side.and_then(|side| usize::try_from(side as u64).ok());
            side.ok_or_else(|| refused(&format!("a {name} of 1 pixel or more"), &fields[name]))
        };
        let number = |name: &str| {
            let number = fields[name].as_f64().filter(|number| number.is_finite());
            number.ok_or_else(|| refused(&format!("a finite {name}"), &fields[name]))
        };
        let distortion = fields.get("distortion").map(|value| {
            let numbers = serde_json::from_value::<[f64; 5]>(value.clone()).ok();
            numbers.ok_or_else(|| refused("a distortion of five numbers", value))
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
        let (fx, fy) = (camera.fx, camera.fy);
        if fx.min(fy) <= 0.0 {
            return Err(refused("fx > 0 and fy > 0", format!("{fx}, {fy}")));
        }
        match camera.distortion {
            Some(lens) if camera.is_folded(lens) => Err(refused(
                "different pixels for different rays of the image",
                format!("a distortion of {lens:?}, which folds it"),
            )),
            _ => Ok(camera),
        }
    }

    /// The numbers as bytes, other ones for each other camera.
    pub fn to_bytes(&self) -> Vec<u8> {
        let Self { width, height, fx, fy, cx, cy, distortion } = self;
        let numbers = [*width as f64, *height as f64, *fx, *fy, *cx, *cy];
        let lens = distortion.iter().flatten();
        numbers.iter().chain(lens).flat_map(|number| number.to_le_bytes()).collect()
    }

    /// Whether a lens turns a cell of a grid of the pinhole's pixels over into the image; the order of operations is that of Python.
    fn is_folded(&self, lens: [f64; 5]) -> bool {
        let (width, height) = (self.width as f64, self.height as f64);
        let share = |place: u32| f64::from(place) / f64::from(PARTS);
        let seen = |row: u32, column: u32| {
            let x = (share(column) * width - self.cx) / self.fx;
            let y = (share(row) * height - self.cy) / self.fy;
            let [u, v] = bend([x, y], lens);
            [u * self.fx + self.cx, v * self.fy + self.cy]
        };
        let is_turned = |row: u32, column: u32| {
            let [u, v] = seen(row, column);
            let ([right, low], [left, down]) = (seen(row, column + 1), seen(row + 1, column));
            let area = (right - u) * (down - v) - (low - v) * (left - u);
            area <= 0.0 && (0.0..=width).contains(&u) && (0.0..=height).contains(&v)
        };
        (0..PARTS).any(|row| (0..PARTS).any(|column| is_turned(row, column)))
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

    /// The distortion of its images; `None` for none.
    pub fn lens(&self) -> Option<[f64; 5]> {
        self.distortion.filter(|numbers| numbers.iter().any(|number| *number != 0.0))
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

fn refused(expected: &str, got: impl fmt::Display) -> Error {
    Error::new(format!("camera: expected {expected}, got {got}"))
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
        fields["width"] = json!(128.0);
        assert_eq!(Camera::from_json(&fields).unwrap(), camera);
        fields["distortion"] = json!([0.1, 0, -0.2, 1e-3, 0]);
        let distortion = Camera::from_json(&fields).unwrap().distortion;
        assert_eq!(distortion, Some([0.1, 0.0, -0.2, 0.001, 0.0]));
    }

    #[test]
    fn what_is_no_camera_is_refused() {
        for (name, value, message) in [
            ("width", json!(0), "expected a width of 1 pixel or more, got 0"),
            ("width", json!("128"), "expected a width of 1 pixel or more, got \"128\""),
            ("width", json!(9_007_199_254_740_992_u64), "expected a width of 1 pixel or more"),
            ("height", json!(96.5), "expected a height of 1 pixel or more, got 96.5"),
            ("fx", json!("100"), "expected a finite fx"),
            ("fy", json!(0), "expected fx > 0 and fy > 0"),
            ("cx", Value::Null, "expected a finite cx"),
            ("skew", json!(0), "expected the keys width, height, fx, fy, cx, cy, and distortion"),
            ("skew", json!(0), "got skew too"),
            ("distortion", json!([0, 0, 0, 0]), "expected a distortion of five numbers"),
            ("distortion", Value::Null, "expected a distortion of five numbers"),
            ("distortion", json!([-0.9, 0, 0, 0, 0]), "[-0.9, 0.0, 0.0, 0.0, 0.0], which folds it"),
        ] {
            let mut fields = document();
            fields[name] = value;
            let error = Camera::from_json(&fields).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
        let error = |value| Camera::from_json(&value).unwrap_err().to_string();
        assert!(error(json!({"width": 128, "height": 96})).contains("got none of the name fx"));
        assert!(error(json!([128, 96])).contains("expected an object, got [128,96]"));
        assert!(Camera::read(Path::new("/nowhere/at/all")).is_err());
    }

    #[test]
    fn a_lens_folds_the_image_where_rays_farther_out_are_seen_nearer() {
        // x (1 + k1 x²) rises up to x² = -1 / (3 k1): the image reaches to 0.64 across, from a cell that begins at 0.6
        let mut fields = document();
        fields["cy"] = json!(0);
        fields["height"] = json!(1);
        for (k1, is_folded) in [(-0.8, false), (-0.9, true)] {
            fields["distortion"] = json!([k1, 0, 0, 0, 0]);
            assert_eq!(Camera::from_json(&fields).is_err(), is_folded, "{k1}");
        }
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
