//! Images of one camera as another one at the same place sees them, as `ffpose.imaging.reprojection` in Python computes them, to the bit.
//!
//! Without rotation that is a scale and a shift of each axis: a resize of a piece.

#![allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // of whole numbers, within bounds

use std::ops::Range;

use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::estimator::Deadline;
use crate::picture::Picture;
use crate::resize::{Axis, Filter, resize};
use crate::undistortion::undistort;

/// An edge this close to a border of pixels, in pixels, is taken to be on it.
const SNAP: f64 = 1e-6;

/// Turns images of one camera into those of another.
#[derive(Clone, Debug)]
pub struct Reprojection {
    /// Camera of the images, whose distortion is taken out of them.
    pub source: Camera,
    /// Camera of what they become.
    pub view: Camera,
}

impl Reprojection {
    /// Returns what the view sees of an image, black beyond it; None where the deadline comes once the distortion is taken out.
    ///
    /// # Errors
    /// The aspect ratio is not that of its camera, or it covers less than a pixel of the view.
    pub fn view(
        &self,
        picture: &Picture,
        filter: Filter,
        deadline: Deadline,
    ) -> Result<Option<Picture>> {
        self.source.expect_aspect(picture.width, picture.height)?;
        let source = self.source.resized(picture.width, picture.height);
        let Some(lens) = source.distortion else {
            return self.reproject(picture, &source, filter).map(Some);
        };
        let straight = undistort(picture, &source, lens);
        if deadline.is_past() {
            return Ok(None);
        }
        self.reproject(&straight, &source, filter).map(Some)
    }

    fn reproject(&self, picture: &Picture, source: &Camera, filter: Filter) -> Result<Picture> {
        let view = &self.view;
        let across = One { size: source.width, focal: source.fx, center: source.cx };
        let down = One { size: source.height, focal: source.fy, center: source.cy };
        let across =
            across.seen_by(One { size: view.width, focal: view.fx, center: view.cx }, filter);
        let down = down.seen_by(One { size: view.height, focal: view.fy, center: view.cy }, filter);
        let (Some((columns, across)), Some((rows, down))) = (across, down) else {
            return Err(Error::new(format!(
                "expected a camera that sees at least a pixel of the network's view, {view}, got {source}"
            )));
        };
        let seen = resize(picture, &across, &down, filter);
        let mut pixels = vec![0; 3 * view.width * view.height];
        let places = pixels.chunks_exact_mut(3 * view.width).skip(rows.start);
        for (place, row) in places.zip(seen.pixels.chunks_exact(3 * columns.len())) {
            place[3 * columns.start..3 * columns.end].copy_from_slice(row);
        }
        Ok(Picture { width: view.width, height: view.height, pixels })
    }
}

/// One axis of a camera: pixels, focal length and place of the principal point.
#[derive(Clone, Copy)]
struct One {
    size: usize,
    focal: f64,
    center: f64,
}

impl One {
    /// Returns the pixels of the view's axis that can show the image, and the resize that gives them; `None` where none can.
    ///
    /// Pixels beyond twice the reach of the filter are excluded, so that what is resized is at most a few times as large as the
    /// image, however wide the view.
    fn seen_by(&self, view: Self, filter: Filter) -> Option<(Range<usize>, Axis)> {
        let (size, view_size) = (self.size as f64, view.size as f64);
        let scale = self.focal / view.focal; // pixels of the image for one of the view
        let origin = self.center - view.center * scale;
        if snap(scale) > size || origin + view_size * scale <= 0.0 || origin >= size {
            return None;
        }
        let reach = (2.0 * filter.radius() * (1.0 / scale).max(1.0)).ceil();
        let first = ((-origin / scale).floor() - reach).max(0.0);
        let last = (((size - origin) / scale).ceil() + reach).min(view_size);
        let (start, end) = (snap(origin + first * scale), snap(origin + last * scale));
        let shown = first as usize..last as usize;
        let before = -start.min(0.0).floor();
        let all = before + end.max(size).ceil();
        let axis = Axis {
            size: self.size,
            before: before as usize,
            all: all as usize,
            // Pillow's boxes are of float32.
            start: (start + before) as f32,
            end: (end + before) as f32,
            to: shown.len(),
            kept: 0..shown.len(),
        };
        (!shown.is_empty()).then_some((shown, axis))
    }
}

fn snap(edge: f64) -> f64 {
    let whole = edge.round_ties_even();
    if (edge - whole).abs() < SNAP { whole } else { edge }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(width: usize, height: usize, focal: f64) -> Camera {
        let (cx, cy) = (width as f64 / 2.0, height as f64 / 2.0);
        Camera { width, height, fx: focal, fy: focal, cx, cy, distortion: None }
    }

    fn ramp(width: usize, height: usize) -> Picture {
        let pixels = (0..3 * width * height).map(|i| (i * i % 251) as u8).collect();
        Picture { width, height, pixels }
    }

    fn view(picture: &Picture, source: Camera, view: Camera) -> Picture {
        let reprojection = Reprojection { source, view };
        let seen = reprojection.view(picture, Filter::Bilinear, Deadline::default());
        seen.unwrap().unwrap()
    }

    #[test]
    fn one_camera_changes_nothing_and_a_smaller_one_resizes() {
        let picture = ramp(8, 6);
        assert_eq!(view(&picture, camera(8, 6, 9.0), camera(8, 6, 9.0)), picture);
        assert_eq!(view(&picture, camera(16, 12, 18.0), camera(8, 6, 9.0)), picture);
        let expected = resize(&picture, &Axis::whole(8, 4), &Axis::whole(6, 3), Filter::Bilinear);
        assert_eq!(view(&picture, camera(8, 6, 9.0), camera(4, 3, 4.5)), expected);
    }

    #[test]
    fn a_narrower_view_is_the_middle_and_a_wider_one_has_a_black_border() {
        let picture = ramp(8, 6);
        let middle = view(&picture, camera(8, 6, 9.0), camera(4, 2, 9.0));
        let row = |y: usize| &picture.pixels[3 * (8 * y + 2)..3 * (8 * y + 6)];
        assert_eq!(middle.pixels, [row(2), row(3)].concat());
        let wide = view(&picture, camera(8, 6, 9.0), camera(40, 6, 9.0));
        for (seen, row) in wide.pixels.chunks_exact(120).zip(picture.pixels.chunks_exact(24)) {
            assert_eq!(&seen[48..72], row);
            assert!(seen[..48].iter().chain(&seen[72..]).all(|&value| value == 0));
        }
    }

    #[test]
    fn what_the_view_does_not_see_is_refused() {
        let picture = ramp(8, 6);
        let error = |source, view| {
            let reprojection = Reprojection { source, view };
            reprojection
                .view(&picture, Filter::Bicubic, Deadline::default())
                .unwrap_err()
                .to_string()
        };
        let aside = Camera { cx: 100.0, ..camera(8, 6, 9.0) };
        assert!(error(aside, camera(8, 6, 9.0)).contains("expected a camera that sees"));
        assert!(
            error(camera(8, 6, 9e9), camera(8, 6, 9.0)).contains("expected a camera that sees")
        );
        assert!(
            error(camera(8, 5, 9.0), camera(8, 6, 9.0)).contains("aspect ratio of its camera, 8x5")
        );
    }

    #[test]
    fn what_is_late_ends_once_the_lens_is_taken_out() {
        let late = Deadline(Some(std::time::Instant::now()));
        for (distortion, is_seen) in [(None, true), (Some([0.0; 5]), false)] {
            let source = Camera { distortion, ..camera(8, 6, 9.0) };
            let reprojection = Reprojection { source, view: camera(8, 6, 9.0) };
            let seen = reprojection.view(&ramp(8, 6), Filter::Bicubic, late).unwrap();
            assert_eq!(seen.is_some(), is_seen);
        }
    }

    #[test]
    fn no_focal_length_is_too_much() {
        let picture = ramp(8, 6);
        for focal in [f64::MIN_POSITIVE, 1e-300, 1e-9, 1e9, 1e300, f64::MAX] {
            for other in [f64::MIN_POSITIVE, 1e-9, 9.0, 1e9, f64::MAX] {
                for center in [-1e300, -1.0, 0.0, 4.0, 1e300] {
                    let source = Camera { cx: center, ..camera(8, 6, focal) };
                    let reprojection = Reprojection { source, view: camera(8, 6, other) };
                    let _ = reprojection.view(&picture, Filter::Bicubic, Deadline::default());
                }
            }
        }
    }
}
