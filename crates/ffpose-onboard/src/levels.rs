//! Gray images of more than 8 bits, whose white level the model's weights state, as `ffpose.imaging.images` in Python reads them.

#![allow(
    clippy::cast_possible_truncation, // of numbers from 0 to 255, and of places among the pixels
    clippy::cast_sign_loss
)]

use std::fmt::{self, Display, Formatter};

use serde_json::Value;

use crate::error::{Error, Result};

/// What becomes 255, as does all above.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum White {
    /// A level: 4095 for 12 bits.
    Level(f64),
    /// The level that this percentage of an image's pixels do not exceed.
    Percentile(f64),
}

impl White {
    /// Reads a level above zero, or a percentile such as `"p99.5"`.
    ///
    /// # Errors
    /// It is neither.
    pub fn from_json(value: &Value) -> Result<Self> {
        let level = value.as_f64().filter(|level| *level > 0.0 && level.is_finite());
        let percentage = value.as_str().and_then(|text| text.strip_prefix('p'));
        let percentage = percentage.filter(|text| text.starts_with(|c: char| c.is_ascii_digit()));
        let percentage = percentage.and_then(|text| text.parse().ok());
        let percentage = percentage.filter(|value| *value > 0.0 && *value <= 100.0);
        let white = level.map(Self::Level).or(percentage.map(Self::Percentile));
        white.ok_or_else(|| {
            Error::new(format!(
                "white: expected a positive level, or a percentile such as \"p99.5\", got {value}"
            ))
        })
    }

    /// Returns 8 bits for each of an image's levels: 0 stays 0, and white becomes 255.
    ///
    /// # Errors
    /// The percentile's level is zero.
    pub fn scale(self, levels: &[u16]) -> Result<Vec<u8>> {
        let white = match self {
            Self::Level(level) => level,
            Self::Percentile(percentage) => percentile(levels, percentage),
        };
        if white <= 0.0 {
            return Err(Error::new(format!(
                "expected a level above 0 that is white ({self}), got {white}"
            )));
        }
        let scaled = |level| (f64::from(level) / white).min(1.0) * 255.0;
        let table: Vec<u8> =
            (0..=u16::MAX).map(|level| scaled(level).round_ties_even() as u8).collect();
        Ok(levels.iter().map(|&level| table[usize::from(level)]).collect())
    }
}

impl Display for White {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Level(level) => write!(f, "{level}"),
            Self::Percentile(percentage) => write!(f, "p{percentage}"),
        }
    }
}

/// Returns a percentile as NumPy does by default, between the two levels about it in sorted order.
fn percentile(levels: &[u16], percentage: f64) -> f64 {
    let mut counts = vec![0; 1 << 16];
    for &level in levels {
        counts[usize::from(level)] += 1;
    }
    let place = (levels.len() - 1) as f64 * (percentage / 100.0);
    let below = place.floor();
    let a = nth(&counts, below as usize);
    let b = nth(&counts, (below as usize + 1).min(levels.len() - 1));
    let share = place - below;
    if share < 0.5 { a + (b - a) * share } else { b - (b - a) * (1.0 - share) }
}

/// Returns the level at a place in sorted order, given how often each one is there.
fn nth(counts: &[usize], place: usize) -> f64 {
    let mut seen = 0;
    let is_past = |count: &usize| {
        seen += count;
        seen > place
    };
    counts.iter().position(is_past).unwrap_or(0) as f64
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn white_becomes_255_and_half_of_it_the_even_neighbor() {
        let levels = [0, 1, 2047, 4095, 5000];
        // 255 / 4095 is 0.06; 2047 / 4095 is 127.47
        assert_eq!(White::Level(4095.0).scale(&levels).unwrap(), [0, 0, 127, 255, 255]);
        assert_eq!(White::Level(510.0).scale(&[1, 3, 5]).unwrap(), [0, 2, 2]); // 0.5, 1.5, 2.5
    }

    #[test]
    fn a_percentile_lies_between_two_levels() {
        let levels: Vec<u16> = (0..=100).rev().map(|level| 10 * level).collect();
        for (percentage, expected) in [(50.0, 500.0), (99.5, 995.0), (12.5, 125.0), (100.0, 1000.0)]
        {
            assert!((percentile(&levels, percentage) - expected).abs() < 1e-9);
        }
        assert!((percentile(&[7], 30.0) - 7.0).abs() < 1e-9);
        assert_eq!(White::Percentile(100.0).scale(&[0, 200]).unwrap(), [0, 255]);
        let error = White::Percentile(50.0).scale(&[0, 0, 9]).unwrap_err().to_string();
        assert_eq!(error, "expected a level above 0 that is white (p50), got 0");
    }

    #[test]
    fn levels_and_percentiles_are_read() {
        assert_eq!(White::from_json(&json!(4095)).unwrap(), White::Level(4095.0));
        assert_eq!(White::from_json(&json!("p99.5")).unwrap(), White::Percentile(99.5));
        for value in [
            json!(0),
            json!(-1),
            json!("p0"),
            json!("p101"),
            json!("99"),
            json!("p"),
            json!("pNaN"),
        ] {
            assert!(White::from_json(&value).is_err(), "{value}");
        }
    }
}
