//! Antialiased resizing, to the bit as Pillow's `Image.resize`, which networks are trained with.
//!
//! Each axis is a convolution at the output's pixels with a filter that is stretched by the scale where the image shrinks; across
//! first, then down (of tall images the other way round), each rounded to 8 bits. Weights are integers of [`BITS`] bits behind the point.

#![allow(
    clippy::cast_possible_truncation, // toward zero, as Pillow does: of weights, and of places within an image; its boxes are f32
    clippy::cast_sign_loss // after a comparison with zero
)]

use std::ops::Range;

use crate::picture::Picture;

/// Fractional bits of a weight: 32 less the 8 of a pixel and 2 for sums beyond its range.
const BITS: u32 = 22;

/// The filters that networks are trained with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Filter {
    /// A triangle, of radius 1.
    Bilinear,
    /// Keys' cubic (1981) with a = -1/2, of radius 2.
    Bicubic,
}

impl Filter {
    /// Pixels that the filter reaches to either side, of the coarser of image and output.
    pub fn radius(self) -> f64 {
        match self {
            Self::Bilinear => 1.0,
            Self::Bicubic => 2.0,
        }
    }

    fn at(self, x: f64) -> f64 {
        const A: f64 = -0.5;
        let x = x.abs();
        match self {
            Self::Bilinear => (1.0 - x).max(0.0),
            Self::Bicubic if x < 1.0 => ((A + 2.0) * x - (A + 3.0)) * x * x + 1.0,
            Self::Bicubic if x < 2.0 => (((x - 5.0) * x + 8.0) * x - 4.0) * A,
            Self::Bicubic => 0.0,
        }
    }
}

/// How an axis of an image is resized, or a piece of it.
///
/// Beyond the image there may be black pixels, which are never stored.
#[derive(Clone, Debug)]
pub struct Axis {
    /// Pixels of the image.
    pub size: usize,
    /// Black pixels before it.
    pub before: usize,
    /// Pixels of the axis, black ones included.
    pub all: usize,
    /// Where the piece begins, counted from the first black pixel.
    pub start: f32,
    /// Where the piece ends.
    pub end: f32,
    /// Pixels that the piece becomes.
    pub to: usize,
    /// Those of them that are computed.
    pub kept: Range<usize>,
}

/// The weights of the pixels from `first` on, for one pixel of the output.
struct Taps {
    first: usize,
    weights: Vec<i32>,
}

/// The taps of an axis, and the pixels of the image that they reach; `first` counts from the first of these.
struct Weights {
    reached: Range<usize>,
    taps: Vec<Taps>,
}

impl Axis {
    /// All of an axis of `size` pixels, which becomes one of `to`.
    pub fn whole(size: usize, to: usize) -> Self {
        Self { size, before: 0, all: size, start: 0.0, end: size as f32, to, kept: 0..to }
    }

    /// Pixels that the axis loses.
    fn lost(&self) -> usize {
        self.all.saturating_sub(self.to)
    }

    fn weights(&self, filter: Filter) -> Weights {
        let mut taps: Vec<Taps> = self.kept.clone().map(|place| self.taps(place, filter)).collect();
        let seen = || taps.iter().filter(|taps| !taps.weights.is_empty());
        let first = seen().map(|taps| taps.first).min().unwrap_or(0);
        let last = seen().map(|taps| taps.first + taps.weights.len()).max().unwrap_or(0);
        for taps in &mut taps {
            taps.first = if taps.weights.is_empty() { 0 } else { taps.first - first };
        }
        Weights { reached: first..last, taps }
    }

    fn taps(&self, place: usize, filter: Filter) -> Taps {
        let scale = f64::from(self.end - self.start) / self.to as f64;
        let stretch = scale.max(1.0);
        let reach = filter.radius() * stretch;
        let shrink = 1.0 / stretch;
        let center = f64::from(self.start) + (place as f64 + 0.5) * scale;
        let first = (center - reach + 0.5).max(0.0) as usize;
        let last = ((center + reach + 0.5) as usize).min(self.all);
        let at = |pixel: usize| filter.at((pixel as f64 - center + 0.5) * shrink);
        let sum: f64 = (first..last).map(at).sum();
        // Black pixels count in the sum alone.
        let (first, last) = (first.max(self.before), last.min(self.before + self.size));
        let weights = (first..last).map(|pixel| fixed(at(pixel) / sum)).collect();
        Taps { first: first - self.before, weights }
    }
}

/// Returns the nearest integer of a weight, halves away from zero.
fn fixed(weight: f64) -> i32 {
    let scaled = weight * f64::from(1 << BITS);
    (scaled + 0.5_f64.copysign(scaled)) as i32
}

/// Returns what is kept of a resized image; no more of the image is computed than that takes.
pub fn resize(picture: &Picture, across: &Axis, down: &Axis, filter: Filter) -> Picture {
    let (width, height) = (across.kept.len(), down.kept.len());
    let is_column_first = is_column_first(across, down);
    let (across, down) = (across.weights(filter), down.weights(filter));
    let (rows, columns) = (down.reached, across.reached);
    if rows.is_empty() || columns.is_empty() {
        return Picture { width, height, pixels: vec![0; 3 * width * height] };
    }
    let reached: Vec<&[u8]> = picture.pixels.chunks_exact(3 * picture.width).collect();
    let reached = reached[rows].iter().map(|row| &row[3 * columns.start..3 * columns.end]);
    let reached: Vec<&[u8]> = reached.collect();
    let pixels = if is_column_first {
        let low = resize_columns(&reached, &down.taps);
        let low: Vec<&[u8]> = low.chunks_exact(3 * columns.len()).collect();
        resize_rows(&low, &across.taps)
    } else {
        let narrow = resize_rows(&reached, &across.taps);
        let narrow: Vec<&[u8]> = narrow.chunks_exact(3 * width).collect();
        resize_columns(&narrow, &down.taps)
    };
    Picture { width, height, pixels }
}

/// Whether to resize down first, as Pillow does since version 13 where that leaves less to do: where the height loses more
/// than twice what the width does.
fn is_column_first(across: &Axis, down: &Axis) -> bool {
    down.lost() > 2 * across.lost()
}

/// Resizes across, for rows of one length.
fn resize_rows(rows: &[&[u8]], taps: &[Taps]) -> Vec<u8> {
    // Sums of so few taps are compiled without a loop.
    match taps.iter().map(|taps| taps.weights.len()).max() {
        Some(2) => resize_rows_by::<2>(rows, taps),
        Some(3) => resize_rows_by::<3>(rows, taps),
        Some(4) => resize_rows_by::<4>(rows, taps),
        Some(5) => resize_rows_by::<5>(rows, taps),
        Some(6) => resize_rows_by::<6>(rows, taps),
        _ => {
            let mut result = Vec::with_capacity(3 * rows.len() * taps.len());
            for row in rows {
                for taps in taps {
                    result.extend(weighted(&taps.weights, &row[3 * taps.first..]));
                }
            }
            result
        }
    }
}

/// The same for at most `N` taps, of which rows have as many pixels.
fn resize_rows_by<const N: usize>(rows: &[&[u8]], taps: &[Taps]) -> Vec<u8> {
    let last = rows.first().map_or(0, |row| row.len() / 3 - N);
    let padded = |taps: &Taps| {
        let first = taps.first.min(last);
        let mut weights = [0; N];
        weights[taps.first - first..][..taps.weights.len()].copy_from_slice(&taps.weights);
        (3 * first, weights)
    };
    let taps: Vec<_> = taps.iter().map(padded).collect();
    let mut result = Vec::with_capacity(3 * rows.len() * taps.len());
    for row in rows {
        for (first, weights) in &taps {
            result.extend(weighted(weights, &row[*first..][..3 * N]));
        }
    }
    result
}

/// The sums of as many pixels as there are weights, by channel.
#[inline]
fn weighted(weights: &[i32], pixels: &[u8]) -> [u8; 3] {
    let mut sums = [1 << (BITS - 1); 3];
    for (weight, pixel) in weights.iter().zip(pixels.chunks_exact(3)) {
        for (sum, &value) in sums.iter_mut().zip(pixel) {
            *sum += weight * i32::from(value);
        }
    }
    sums.map(rounded)
}

/// Resizes down, for rows of one length.
fn resize_columns(rows: &[&[u8]], taps: &[Taps]) -> Vec<u8> {
    let length = rows.first().map_or(0, |row| row.len());
    let mut result = Vec::with_capacity(length * taps.len());
    let mut sums = vec![0; length];
    for Taps { first, weights } in taps {
        sums.fill(1 << (BITS - 1));
        for (weight, row) in weights.iter().zip(&rows[*first..]) {
            for (sum, &value) in sums.iter_mut().zip(*row) {
                *sum += weight * i32::from(value);
            }
        }
        result.extend(sums.iter().copied().map(rounded));
    }
    result
}

fn rounded(sum: i32) -> u8 {
    (sum >> BITS).clamp(0, 255) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An image of one row, whose channels are `values`, their halves and zero.
    fn row(values: &[u8]) -> Picture {
        let pixels = values.iter().flat_map(|&value| [value, value / 2, 0]).collect();
        Picture { width: values.len(), height: 1, pixels }
    }

    fn column(values: &[u8]) -> Picture {
        let row = row(values);
        Picture { width: 1, height: row.width, ..row }
    }

    fn whole(picture: &Picture, width: usize, height: usize, filter: Filter) -> Picture {
        let (across, down) =
            (Axis::whole(picture.width, width), Axis::whole(picture.height, height));
        resize(picture, &across, &down, filter)
    }

    fn red(picture: &Picture) -> Vec<u8> {
        picture.pixels.iter().step_by(3).copied().collect()
    }

    #[test]
    fn half_the_size_weighs_three_three_one() {
        // The triangle of radius 2 about 1: 3/4 at 0.5 and 1.5, 1/4 at 2.5; the pixels beyond the edge do not count.
        let expected = [50, 70]; // (3 * 0 + 3 * 70 + 140) / 7 and (70 + 3 * 140 + 3 * 0) / 7
        let values = [0, 70, 140, 0];
        assert_eq!(red(&whole(&row(&values), 2, 1, Filter::Bilinear)), expected);
        assert_eq!(red(&whole(&column(&values), 1, 2, Filter::Bilinear)), expected);
    }

    #[test]
    fn twice_the_size_weighs_the_cubic_at_quarters() {
        // 0.8671875, 0.2265625, -0.0703125, -0.0234375 at distances 1/4, 3/4, 5/4, 7/4; sums are clamped to 8 bits.
        let got = whole(&row(&[0, 0, 0, 128, 128, 128]), 12, 1, Filter::Bicubic);
        assert_eq!(red(&got)[4..8], [0, 26, 102, 137]);
        let bright = whole(&row(&[0, 0, 0, 255, 255, 255]), 12, 1, Filter::Bicubic);
        assert_eq!(red(&bright)[7], 255);
    }

    #[test]
    fn tall_images_are_resized_down_first() {
        let is_first =
            |height, to, narrow| is_column_first(&Axis::whole(3, narrow), &Axis::whole(height, to));
        assert!(!is_first(6, 2, 1)); // 4 rows of 6, 2 columns of 3
        assert!(is_first(7, 2, 1));
        assert!(is_first(3, 2, 5));
        assert!(!is_first(2, 2, 5));
    }

    #[test]
    fn what_is_kept_is_cut_from_the_whole() {
        let samples = (0..3 * 23 * 31_u32).map(|i| (i * i % 251) as u8).collect();
        let picture = Picture { width: 23, height: 31, pixels: samples };
        for (width, height) in [(7, 9), (40, 9), (7, 60), (50, 60)] {
            for filter in [Filter::Bilinear, Filter::Bicubic] {
                let all = whole(&picture, width, height, filter);
                let across = Axis { kept: 2..6, ..Axis::whole(23, width) };
                let down = Axis { kept: 5..8, ..Axis::whole(31, height) };
                let expected = all.pixels.chunks_exact(3 * width).skip(5).take(3);
                let expected: Vec<u8> = expected.flat_map(|row| row[6..18].to_vec()).collect();
                let got = resize(&picture, &across, &down, filter);
                assert_eq!((got.width, got.height, got.pixels), (4, 3, expected));
            }
        }
    }

    #[test]
    fn one_size_changes_nothing_and_channels_stay_apart() {
        for filter in [Filter::Bilinear, Filter::Bicubic] {
            let picture = row(&[0, 90, 255, 7]);
            assert_eq!(whole(&picture, 4, 1, filter), picture);
            let flat = Picture { width: 5, height: 3, pixels: [9, 80, 250].repeat(15) };
            let expected = Picture { width: 7, height: 2, pixels: [9, 80, 250].repeat(14) };
            assert_eq!(whole(&flat, 7, 2, filter), expected);
        }
    }
}
