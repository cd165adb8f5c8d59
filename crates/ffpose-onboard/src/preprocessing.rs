//! From an image to the network's input, as `ffpose.imaging.preprocessing` in Python does it, to the bit.

use serde_json::Value;

use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::estimator::Deadline;
use crate::picture::{MAX_PIXELS, MAX_SIDE, Picture};
use crate::reprojection::Reprojection;
use crate::resize::{Axis, Filter, resize};

/// Frame over crop.
const CROP_MARGIN: f64 = 256.0 / 224.0;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Mode {
    /// The whole image becomes the input, each axis by its own factor.
    Resize,
    /// The image is resized, its aspect kept, beyond the input's size, and the center is cut out.
    CenterCrop,
}

/// Turns an image into the network's input.
#[derive(Debug)]
pub struct Preprocessing {
    /// Height of the network's input, in pixels.
    pub height: usize,
    /// Width of the network's input, in pixels.
    pub width: usize,
    mode: Mode,
    mean: [f32; 3],
    std: [f32; 3],
    filter: Filter,
    /// How images of another camera than that of the images trained on come to the network's view.
    pub reprojection: Option<Reprojection>,
}

impl Preprocessing {
    /// Reads what `ffpose export` writes: size, mode, mean, std and interpolation.
    ///
    /// # Errors
    /// A field is missing, unknown or cannot be used.
    pub fn from_json(document: &Value) -> Result<Self> {
        let known = ["size", "mode", "mean", "std", "interpolation"];
        let fields =
            document.as_object().ok_or_else(|| unusable("preprocessing", "an object", document))?;
        if let Some(name) = fields.keys().find(|name| !known.contains(&name.as_str())) {
            return Err(Error::new(format!(
                "preprocessing: expected {}, got {name}",
                known.join(", ")
            )));
        }
        let [height, width] = sizes(&document["size"])?;
        Ok(Self {
            height,
            width,
            mode: match document["mode"].as_str() {
                Some("resize") => Mode::Resize,
                Some("center_crop") => Mode::CenterCrop,
                _ => return Err(unusable("mode", "resize or center_crop", &document["mode"])),
            },
            mean: colors("mean", &document["mean"], f64::NEG_INFINITY)?,
            std: colors("std", &document["std"], 0.0)?,
            filter: match document["interpolation"].as_str() {
                Some("bilinear") => Filter::Bilinear,
                Some("bicubic") => Filter::Bicubic,
                _ => {
                    return Err(unusable(
                        "interpolation",
                        "bilinear or bicubic",
                        &document["interpolation"],
                    ));
                }
            },
            reprojection: None,
        })
    }

    /// Returns the input of an image, of shape `(3, height, width)`; None where the deadline comes before it is done.
    ///
    /// # Errors
    /// It is reprojected, and its camera cannot have taken it or sees nothing of the view.
    pub fn input(&self, picture: &Picture, deadline: Deadline) -> Result<Option<Vec<f32>>> {
        if deadline.is_past() {
            return Ok(None);
        }
        let window = match &self.reprojection {
            None => Some(self.window(picture)),
            Some(reprojection) => reprojection.view(picture, self.filter, deadline)?,
        };
        let Some(window) = window.filter(|_| !deadline.is_past()) else {
            return Ok(None);
        };
        let mut input = Vec::with_capacity(window.pixels.len());
        for (channel, (mean, std)) in self.mean.into_iter().zip(self.std).enumerate() {
            let values: [f32; 256] =
                std::array::from_fn(|sample| (sample as f32 / 255.0 - mean) / std);
            let pixels = window.pixels.chunks_exact(3);
            input.extend(pixels.map(|pixel| values[usize::from(pixel[channel])]));
        }
        Ok(Some(input))
    }

    /// Returns the camera that sees the input, given that of the image.
    pub fn camera(&self, camera: &Camera) -> Camera {
        let (height, width) = self.frame_size(camera.width, camera.height);
        let (top, left) = ((height - self.height) / 2, (width - self.width) / 2);
        camera.resized(width, height).cropped(left, top, self.width, self.height)
    }

    /// Returns the middle of the resized image, the only part of it that is computed: the whole of a thin image would not fit in
    /// memory.
    fn window(&self, picture: &Picture) -> Picture {
        let (frame_height, frame_width) = self.frame_size(picture.width, picture.height);
        let middle = |size, frame, kept| {
            let first = (frame - kept) / 2;
            Axis { kept: first..first + kept, ..Axis::whole(size, frame) }
        };
        let across = middle(picture.width, frame_width, self.width);
        let down = middle(picture.height, frame_height, self.height);
        resize(picture, &across, &down, self.filter)
    }

    /// Returns height and width of the resized image that the input is cut from.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a whole number above zero
    fn frame_size(&self, width: usize, height: usize) -> (usize, usize) {
        if self.mode == Mode::Resize {
            return (self.height, self.width);
        }
        let (height, width) = (height as f64, width as f64);
        let scale = CROP_MARGIN * (self.height as f64 / height).max(self.width as f64 / width);
        let rounded = |length: f64| (length * scale).round_ties_even() as usize;
        (rounded(height), rounded(width))
    }
}

fn sizes(value: &Value) -> Result<[usize; 2]> {
    let read = |side: &Value| side.as_u64().and_then(|side| usize::try_from(side).ok());
    let sides = value.as_array().map(|sides| sides.iter().filter_map(read).collect::<Vec<_>>());
    match sides.as_deref() {
        Some(&[height, width])
            if height.min(width) > 0
                && height.max(width) <= MAX_SIDE
                && height * width <= MAX_PIXELS =>
        {
            Ok([height, width])
        }
        _ => {
            let expected = format!(
                "height and width, each from 1 to {MAX_SIDE}, and at most {MAX_PIXELS} pixels"
            );
            Err(unusable("size", &expected, value))
        }
    }
}

/// Reads three numbers above `limit`, of red, green and blue.
fn colors(name: &str, value: &Value, limit: f64) -> Result<[f32; 3]> {
    let numbers = value
        .as_array()
        .map(|numbers| numbers.iter().filter_map(Value::as_f64).collect::<Vec<_>>());
    match numbers.as_deref() {
        #[allow(clippy::cast_possible_truncation)] // to the nearest, as NumPy does
        Some(&[red, green, blue]) if red.min(green).min(blue) > limit => {
            Ok([red, green, blue].map(|x| x as f32))
        }
        _ => Err(unusable(name, "three finite numbers (of std, above 0)", value)),
    }
}

fn unusable(name: &str, expected: &str, got: &Value) -> Error {
    Error::new(format!("{name}: expected {expected}, got {got}"))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn description(size: [usize; 2], mode: &str) -> Value {
        json!({"size": size, "mode": mode, "mean": [0.5, 0.0, 1.0], "std": [0.5, 1.0, 2.0], "interpolation": "bilinear"})
    }

    #[test]
    fn the_input_is_standardized_channel_by_channel() {
        let picture = Picture { width: 2, height: 1, pixels: vec![255, 51, 0, 0, 255, 255] };
        let preprocessing = Preprocessing::from_json(&description([1, 2], "resize")).unwrap();
        // (1 - 0.5) / 0.5 and (0 - 0.5) / 0.5; 51 / 255 and 1; (0 - 1) / 2 and (1 - 1) / 2
        let none = Deadline::default();
        let input = preprocessing.input(&picture, none).unwrap().unwrap();
        assert_eq!(input, [1.0, -1.0, 0.2, 1.0, -0.5, 0.0]);
        let past = Deadline(Some(std::time::Instant::now()));
        assert_eq!(preprocessing.input(&picture, past).unwrap(), None);
    }

    #[test]
    fn the_crop_is_cut_from_the_middle_of_a_frame() {
        let preprocessing =
            Preprocessing::from_json(&description([224, 224], "center_crop")).unwrap();
        let blank = |width, height| Picture { width, height, pixels: vec![0; 3 * width * height] };
        assert_eq!(preprocessing.frame_size(640, 480), (256, 341)); // 341.33
        assert_eq!(preprocessing.frame_size(480, 640), (341, 256));

        // A frame of the image's own size, 8 x 8, whose red pixel is the window's first.
        let preprocessing = Preprocessing::from_json(&description([7, 7], "center_crop")).unwrap();
        let mut picture = blank(8, 8);
        picture.pixels[0] = 255;
        assert_eq!(preprocessing.frame_size(8, 8), (8, 8));
        let input = preprocessing.input(&picture, Deadline::default()).unwrap().unwrap();
        assert_eq!((input.len(), input[0], input[1]), (3 * 49, 1.0, -1.0));
    }

    #[test]
    fn what_cannot_be_used_is_refused() {
        for (name, value) in [
            ("size", json!([0, 4])),
            ("size", json!([4])),
            ("size", json!([4, -4])),
            ("size", json!([1_u64 << 60, 4])),
            ("size", json!([1 << 14, 1 << 14])),
            ("mode", json!("stretch")),
            ("mean", json!([0, 1])),
            ("std", json!([1, 1, 0])),
            ("std", json!("red")),
            ("interpolation", json!("nearest")),
            ("source", json!({})),
        ] {
            let mut fields = description([4, 4], "resize");
            fields[name] = value;
            let error = Preprocessing::from_json(&fields).unwrap_err().to_string();
            assert!(error.contains(name) && error.contains("expected"), "{error}");
        }
        assert!(Preprocessing::from_json(&json!({"size": [4, 4]})).is_err());
        assert!(Preprocessing::from_json(&json!({})).is_err());
    }
}
