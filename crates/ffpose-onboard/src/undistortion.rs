//! Images without the distortion of the lens, as `ffpose.imaging.undistortion` in Python computes them, to the bit.

#![allow(
    clippy::cast_possible_truncation, // toward zero, of places within an image
    clippy::cast_sign_loss
)]

use crate::camera::Camera;
use crate::picture::Picture;

/// Returns an image as a pinhole sees it that has the intrinsics of `camera`, which took it, interpolated bilinearly.
///
/// It is black where the original shows nothing. `distortion` is that of the camera.
pub fn undistort(picture: &Picture, camera: &Camera, distortion: [f64; 5]) -> Picture {
    let Picture { width, height, .. } = *picture;
    let ray = |place: usize, center, focal| (place as f64 + 0.5 - center) / focal;
    let across: Vec<f64> = (0..width).map(|column| ray(column, camera.cx, camera.fx)).collect();
    let mut pixels = Vec::with_capacity(picture.pixels.len());
    for row in 0..height {
        let y = ray(row, camera.cy, camera.fy);
        for &x in &across {
            let [u, v] = bend([x, y], distortion);
            // The first pixel, whose center is 0.5, is 1, behind a black border of one pixel.
            let u = (u * camera.fx + camera.cx + 0.5).clamp(0.0, (width + 1) as f64);
            let v = (v * camera.fy + camera.cy + 0.5).clamp(0.0, (height + 1) as f64);
            pixels.extend(between(picture, u, v));
        }
    }
    Picture { width, height, pixels }
}

/// Returns where the lens sends a ray `(x/z, y/z)`; the order of operations is that of Python.
pub fn bend([x, y]: [f64; 2], [k1, k2, p1, p2, k3]: [f64; 5]) -> [f64; 2] {
    let square = x * x + y * y;
    let radial = 1.0 + square * (k1 + square * (k2 + square * k3));
    let u = x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x);
    let v = y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y;
    [u, v]
}

/// Returns the color between the four pixels about a place, which counts from a black border of one pixel.
fn between(picture: &Picture, u: f64, v: f64) -> [u8; 3] {
    let (left, top) = (u.min(picture.width as f64) as usize, v.min(picture.height as f64) as usize);
    let (across, down) = (u - left as f64, v - top as f64);
    let mut sums = [0.0_f32; 3];
    for (right, low) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
        let weight = [1.0 - across, across][right] * [1.0 - down, down][low];
        let pixel = bordered(picture, left + right, top + low);
        for (sum, value) in sums.iter_mut().zip(pixel) {
            *sum += f32::from(value) * weight as f32;
        }
    }
    sums.map(|sum| sum.round_ties_even() as u8)
}

fn bordered(picture: &Picture, column: usize, row: usize) -> [u8; 3] {
    if !(1..=picture.width).contains(&column) || !(1..=picture.height).contains(&row) {
        return [0; 3];
    }
    let first = 3 * ((row - 1) * picture.width + column - 1);
    let pixel = &picture.pixels[first..first + 3];
    [pixel[0], pixel[1], pixel[2]]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Camera {
        Camera { width: 4, height: 3, fx: 4.0, fy: 4.0, cx: 2.0, cy: 1.5, distortion: None }
    }

    fn ramp() -> Picture {
        let pixels = (0..36_u8).map(|value| 7 * value).collect();
        Picture { width: 4, height: 3, pixels }
    }

    #[test]
    fn a_lens_that_does_not_distort_changes_nothing() {
        assert_eq!(undistort(&ramp(), &camera(), [0.0; 5]), ramp());
    }

    #[test]
    fn a_ray_goes_where_opencv_says() {
        // r^2 = 0.05; 1 + 0.05 (0.1 + 0.05 (0.2 + 0.05 * 0.5)) = 1.0055625
        let [u, v] = bend([0.1, 0.2], [0.1, 0.2, 0.01, 0.02, 0.5]);
        // 0.1 * 1.0055625 + 2 * 0.01 * 0.02 + 0.02 (0.05 + 0.02); 0.2 * 1.0055625 + 0.01 (0.05 + 0.08) + 2 * 0.02 * 0.02
        assert!((u - 0.102_356_25).abs() < 1e-12 && (v - 0.203_212_5).abs() < 1e-12, "{u} {v}");
    }

    #[test]
    fn half_a_pixel_is_the_mean_and_what_is_beyond_is_black() {
        let picture = Picture { width: 2, height: 1, pixels: vec![10, 20, 30, 20, 40, 61] };
        assert_eq!(between(&picture, 1.5, 1.0), [15, 30, 46]); // 45.5 to the even
        assert_eq!(between(&picture, 2.5, 1.0), [10, 20, 30]); // 30.5 to the even
        assert_eq!(between(&picture, 1.0, 1.75), [2, 5, 8]); // 2.5, 5, 7.5
        for (u, v) in [(0.0, 0.0), (3.0, 2.0), (f64::NAN, 1.0)] {
            assert_eq!(between(&picture, u, v), [0; 3]);
        }
    }
}
