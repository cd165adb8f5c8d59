//! Images of virtual cameras: pyramids of 2x2 means, sampled where homographies take the pixels of a view.
//!
//! Loops over the coordinates of a block have no branches, so that the compiler makes vectors of the instruction set that
//! `Isa::run_loops` opened; the samples themselves are gathered one by one, with weights that all channels share.

// Images have far fewer than 2^31 pixels, and coordinates are clamped to them; a lazy operator would be a branch.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    clippy::needless_bitwise_bool
)]

use std::sync::{Mutex, PoisonError};

use ffpose_core::{Error, Isa, Loops, Pool};
use ndarray::{ArrayViewD, ArrayViewMut4, ArrayViewMutD, Axis, Ix1, Ix3, Ix4};

/// Levels of a pyramid, the finest first; each has half the size of the one before.
pub(super) const LEVELS: usize = 4;

/// Least depth of a ray in the source camera's frame; other rays see nothing.
const LEAST_DEPTH: f32 = 1e-3;

/// A coordinate outside of every image.
const FAR_OUTSIDE: f32 = -1e6;

/// Pixels computed at once.
const BLOCK: usize = 32;

/// Elements of work that a sample of one channel is worth, of those that a pool's grain counts.
const WORK: usize = 8;

/// Samples, for each view, one level of the pyramid of its image: bilinear, zeros outside.
///
/// - `homographies (V, 3, 3)`: from the places of a view's pixels to pixels of the finest level.
/// - `levels (V,)`: whole numbers below [`LEVELS`]; others are taken for the nearest of these.
/// - `plane (2, h, w)`: the places of a view's pixels.
/// - `pyramid`: `(B, C, H, W)` of each level; image `b` has the views from `b V / B` on.
/// - `y (V, C, h, w)`.
///
/// # Errors
/// [`Error::Shape`], [`Error::Strides`]; [`Error::Isa`] as for [`Isa::current`].
pub(super) fn sample_pyramid(
    homographies: ArrayViewD<'_, f32>,
    levels: ArrayViewD<'_, f32>,
    plane: ArrayViewD<'_, f32>,
    pyramid: [ArrayViewD<'_, f32>; LEVELS],
    y: ArrayViewMutD<'_, f32>,
    pool: &dyn Pool,
) -> Result<(), Error> {
    let isa = Isa::current()?;
    let homographies = expected::<Ix3>("homographies", "(V, 3, 3)", homographies)?;
    let views = homographies.len_of(Axis(0));
    if homographies.shape()[1..] != [3, 3] {
        return Err(Error::shape("homographies", "(V, 3, 3)", homographies.shape()));
    }
    let levels = expected::<Ix1>("levels", "(V,)", levels)?;
    let plane = expected::<Ix3>("plane", "(2, h, w)", plane)?;
    let (height, width) = (plane.len_of(Axis(1)), plane.len_of(Axis(2)));
    if levels.len() != views || plane.len_of(Axis(0)) != 2 {
        let (name, got) = if levels.len() == views {
            ("plane", plane.shape())
        } else {
            ("levels", levels.shape())
        };
        return Err(Error::shape(
            name,
            "(2, h, w) of plane, and as many levels as homographies",
            got,
        ));
    }
    let mut images = Vec::with_capacity(LEVELS);
    for level in pyramid {
        images.push(expected::<Ix4>("pyramid", "(B, C, H, W)", level)?);
    }
    let (batch, channels) = (images[0].len_of(Axis(0)), images[0].len_of(Axis(1)));
    if let Some(level) = images.iter().find(|level| level.shape()[..2] != [batch, channels]) {
        return Err(Error::shape(
            "pyramid",
            &format!("({batch}, {channels}, H, W)"),
            level.shape(),
        ));
    }
    if views > 0 && (batch == 0 || views % batch != 0) {
        return Err(Error::shape(
            "homographies",
            &format!("(V, 3, 3), V a multiple of {batch}"),
            &[views, 3, 3],
        ));
    }
    let shape = [views, channels, height, width];
    let got = y.shape().to_vec();
    let y = y.into_dimensionality::<Ix4>().ok().filter(|y| y.shape() == shape);
    let mut y = y.ok_or_else(|| Error::shape("y", &format!("{shape:?}"), &got))?;
    if y.is_empty() {
        return Ok(());
    }
    let places = plane.as_slice().expect("contiguous");
    let workers = pool.threads().min(WORK * y.len() / pool.grain()).max(1);
    let rows = Mutex::new(y.exact_chunks_mut((1, channels, 1, width)).into_iter().enumerate());
    let next = || rows.lock().unwrap_or_else(PoisonError::into_inner).next();
    let sample = |index: usize, y| {
        let (view, row) = (index / height, index % height);
        let matrix = homographies.index_axis(Axis(0), view);
        let level = levels[view].clamp(0.0, (LEVELS - 1) as f32) as usize;
        let image = images[level].index_axis(Axis(0), view / (views / batch));
        let coordinates = |axis| &places[(axis * height + row) * width..][..width];
        isa.run_loops(Row {
            matrix: std::array::from_fn(|n| matrix[[n / 3, n % 3]]),
            scale: 0.5_f32.powi(level as i32),
            plane: [0, 1].map(coordinates),
            pixels: image.to_slice().expect("contiguous"),
            size: [image.len_of(Axis(1)), image.len_of(Axis(2))],
            y,
        });
    };
    pool.run(workers, &|_| {
        while let Some((index, y)) = next() {
            sample(index, y);
        }
    });
    Ok(())
}

/// `array` in as many axes as it must have, contiguous.
fn expected<'a, D: ndarray::Dimension>(
    name: &'static str,
    shape: &str,
    array: ArrayViewD<'a, f32>,
) -> Result<ndarray::ArrayView<'a, f32, D>, Error> {
    let got = array.shape().to_vec();
    let array = array.into_dimensionality::<D>().map_err(|_| Error::shape(name, shape, &got))?;
    if array.is_standard_layout() {
        return Ok(array);
    }
    Err(Error::Strides { name, got: array.strides().to_vec() })
}

/// A row of a view's pixels.
struct Row<'a> {
    matrix: [f32; 9],
    /// Pixels of the level per pixel of the finest.
    scale: f32,
    /// Places of the row's pixels.
    plane: [&'a [f32]; 2],
    /// The level's channels, one after the other.
    pixels: &'a [f32],
    /// Rows and columns of the level.
    size: [usize; 2],
    /// `(1, C, 1, w)`
    y: ArrayViewMut4<'a, f32>,
}

/// Of each pixel of a block the four samples' places in a channel, and their weights: zero where they lie outside.
struct Samples {
    places: [[u32; BLOCK]; 4],
    weights: [[f32; BLOCK]; 4],
}

impl Loops for Row<'_> {
    #[inline(always)]
    fn run(mut self) {
        let (width, area) = (self.plane[0].len(), self.size[0] * self.size[1]);
        if area == 0 {
            return self.y.fill(0.0);
        }
        for start in (0..width).step_by(BLOCK) {
            let len = BLOCK.min(width - start);
            let samples = self.samples(start, len);
            for (channel, mut y) in self.y.axis_iter_mut(Axis(1)).enumerate() {
                let pixels = &self.pixels[channel * area..][..area];
                let y = &mut y.as_slice_mut().expect("a row")[start..start + len];
                // Of as many, so that `n` needs no check.
                for (n, y) in y.iter_mut().take(BLOCK).enumerate() {
                    let part = |corner: usize| {
                        samples.weights[corner][n] * pixels[samples.places[corner][n] as usize]
                    };
                    *y = part(0) + part(1) + part(2) + part(3);
                }
            }
        }
    }
}

impl Row<'_> {
    #[inline(always)]
    fn samples(&self, start: usize, len: usize) -> Samples {
        let mut place = [[0.0; BLOCK]; 2];
        for (place, row) in place.iter_mut().zip(self.plane) {
            place[..len].copy_from_slice(&row[start..start + len]);
        }
        let mut samples = Samples { places: [[0; BLOCK]; 4], weights: [[0.0; BLOCK]; 4] };
        let [a, b, c, d, e, f, g, h, i] = self.matrix;
        let [rows, columns] = self.size;
        let ends = [rows as f32, columns as f32];
        let [last_row, last_column] = [rows as i32 - 1, columns as i32 - 1];
        for n in 0..BLOCK {
            let (x, y) = (place[0][n], place[1][n]);
            let depth = g * x + h * y + i;
            let is_ahead = depth > LEAST_DEPTH;
            let over = 1.0 / if is_ahead { depth } else { 1.0 };
            let u = if is_ahead { (a * x + b * y + c) * over } else { FAR_OUTSIDE };
            let v = if is_ahead { (d * x + e * y + f) * over } else { FAR_OUTSIDE };
            let (left, to_right) = cell(u * self.scale, ends[1]);
            let (top, to_bottom) = cell(v * self.scale, ends[0]);
            let (right, bottom) = (left + 1, top + 1);
            let within = |place: i32, last: i32, weight: f32| {
                if (place >= 0) & (place <= last) { weight } else { 0.0 }
            };
            let across =
                [within(left, last_column, 1.0 - to_right), within(right, last_column, to_right)];
            let down =
                [within(top, last_row, 1.0 - to_bottom), within(bottom, last_row, to_bottom)];
            // Not `clamp`, which asks whether its bounds are in order.
            let places = [top, bottom].map(|row| row.max(0).min(last_row) * columns as i32);
            let columns = [left, right].map(|column| column.max(0).min(last_column));
            for corner in 0..4 {
                let (row, column) = (corner / 2, corner % 2);
                samples.places[corner][n] = (places[row] + columns[column]).cast_unsigned();
                samples.weights[corner][n] = down[row] * across[column];
            }
        }
        samples
    }
}

/// The pixel whose center is at or before a coordinate, and the part of the way to the next. It is -1 at least and `end` at most, so
/// that beyond, and for NaN, all weight is that of pixels outside.
#[inline(always)]
fn cell(coordinate: f32, end: f32) -> (i32, f32) {
    // Half a pixel further, so that the conversion to a whole number rounds down.
    let shifted = (coordinate + 0.5).max(0.0).min(end + 1.0);
    let whole = shifted as i32;
    (whole - 1, shifted - whole as f32)
}
