//! Errors and scores of estimated poses, sample by sample: the estimate before the truth, everywhere.
//!
//! Translations are `(N, 3)` in meters, orientations `(N, 4)` as in [`crate::quaternion`], of any norm above zero; `q`
//! and `-q` are one orientation. Results are `(N,)`. NaN and infinity are errors: a mean must not hide them.

use std::f64::consts::PI;

use ndarray::{ArrayD, ArrayViewD, Axis};

use crate::arrays::{array_of, finite_rows_of};
use crate::{Error, Real};

/// Relative translation error below which SPEED+ counts none.
const SPEED_PLUS_TRANSLATION: f64 = 0.002_173;

/// Rotation error, in radians, below which SPEED+ counts none.
const SPEED_PLUS_ROTATION: f64 = 0.169 * PI / 180.0;

/// An estimated row and the true one.
type Pair<const M: usize> = ([f64; M], [f64; M]);

/// Estimated and true translations and orientations of N samples.
#[derive(Clone, Debug)]
pub struct PosePairs<'a, T> {
    /// Estimated translations `(N, 3)`.
    pub t_hat: ArrayViewD<'a, T>,
    /// Estimated orientations `(N, 4)`.
    pub q_hat: ArrayViewD<'a, T>,
    /// True translations `(N, 3)`.
    pub t: ArrayViewD<'a, T>,
    /// True orientations `(N, 4)`.
    pub q: ArrayViewD<'a, T>,
}

/// `‖t_hat - t‖` in meters.
///
/// # Errors
/// [`Error::Shape`]; [`Error::NotFinite`] with the row.
pub fn translation_error<T: Real>(
    t_hat: ArrayViewD<'_, T>,
    t: ArrayViewD<'_, T>,
) -> Result<ArrayD<T>, Error> {
    each_pair(["t_hat", "t"], &t_hat, &t, |_, t_hat, t| Ok(distance(t_hat, t)))
}

/// The angle of the rotation that takes `q` to `q_hat`, in degrees from 0 to 180.
///
/// Twice the arctangent of vector over scalar part of `q⁻¹ · q_hat`, which, unlike an arccosine, keeps small angles.
///
/// # Errors
/// [`Error::Shape`]; [`Error::NotFinite`] and [`Error::ZeroNorm`] with the row.
pub fn rotation_error<T: Real>(
    q_hat: ArrayViewD<'_, T>,
    q: ArrayViewD<'_, T>,
) -> Result<ArrayD<T>, Error> {
    each_pair(["q_hat", "q"], &q_hat, &q, |row, q_hat, q| Ok(angle(row, q_hat, q)?.to_degrees()))
}

/// The score of ESA's Kelvins pose estimation challenge, 2019: `‖t_hat - t‖ / ‖t‖` plus the rotation error in radians.
///
/// # Errors
/// [`Error::Shape`]; [`Error::NotFinite`] and [`Error::ZeroNorm`] with the row.
pub fn esa_score<T: Real>(pairs: &PosePairs<'_, T>) -> Result<ArrayD<T>, Error> {
    score(pairs, |translation, rotation| translation + rotation)
}

/// The score of the SPEED+ challenge, 2021: as [`esa_score`], but a relative translation error below 0.002173 and a
/// rotation error below 0.169° count as zero, each for itself.
///
/// # Errors
/// [`Error::Shape`]; [`Error::NotFinite`] and [`Error::ZeroNorm`] with the row.
pub fn speed_plus_score<T: Real>(pairs: &PosePairs<'_, T>) -> Result<ArrayD<T>, Error> {
    let counted = |error, least| if error < least { 0.0 } else { error };
    score(pairs, |translation, rotation| {
        counted(translation, SPEED_PLUS_TRANSLATION) + counted(rotation, SPEED_PLUS_ROTATION)
    })
}

/// `combine(relative translation error, rotation error)` for each sample.
fn score<T: Real>(
    pairs: &PosePairs<'_, T>,
    combine: impl Fn(f64, f64) -> f64,
) -> Result<ArrayD<T>, Error> {
    let PosePairs { t_hat, q_hat, t, q } = pairs;
    let translations = finite_pairs(["t_hat", "t"], t_hat, t, None)?;
    let rotations = finite_pairs(["q_hat", "q"], q_hat, q, Some(t.shape()[0]))?;
    let scores = translations.zip(rotations).enumerate().map(|(row, (translation, rotation))| {
        let ((t_hat, t), (q_hat, q)) = (translation?, rotation?);
        let range = distance(t, [0.0; 3]);
        if range == 0.0 {
            return Err(Error::ZeroNorm { name: "t", row });
        }
        Ok([combine(distance(t_hat, t) / range, angle(row, q_hat, q)?)])
    });
    Ok(array_of(t.shape(), scores)?.remove_axis(Axis(1)))
}

/// `error(row, estimate, truth)` for each row of two arrays `(N, M)`.
fn each_pair<T: Real, const M: usize>(
    names: [&'static str; 2],
    estimates: &ArrayViewD<'_, T>,
    truths: &ArrayViewD<'_, T>,
    error: impl Fn(usize, [f64; M], [f64; M]) -> Result<f64, Error>,
) -> Result<ArrayD<T>, Error> {
    let errors = finite_pairs(names, estimates, truths, None)?.enumerate().map(|(row, pair)| {
        let (estimate, truth) = pair?;
        Ok([error(row, estimate, truth)?])
    });
    Ok(array_of(truths.shape(), errors)?.remove_axis(Axis(1)))
}

/// The rows of two arrays `(count, M)`, all finite; `count` is that of the first where it is not given.
fn finite_pairs<'a, T: Real, const M: usize>(
    [estimate, truth]: [&'static str; 2],
    estimates: &'a ArrayViewD<'_, T>,
    truths: &'a ArrayViewD<'_, T>,
    count: Option<usize>,
) -> Result<impl Iterator<Item = Result<Pair<M>, Error>> + use<'a, T, M>, Error> {
    let estimates = finite_rows_of(estimate, estimates, count)?;
    let truths = finite_rows_of(truth, truths, Some(estimates.len()))?;
    Ok(estimates.zip(truths).map(|(row, other)| Ok((row?, other?))))
}

/// `‖a - b‖`, without overflow or underflow on the way.
fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1]).hypot(a[2] - b[2])
}

/// The angle between two orientations of any norm above zero, in radians.
fn angle(row: usize, q_hat: [f64; 4], q: [f64; 4]) -> Result<f64, Error> {
    let [a, b, c, d] = scaled("q_hat", row, q_hat)?;
    let [w, x, y, z] = scaled("q", row, q)?;
    let scalar = w * a + x * b + y * c + z * d;
    let vector = [
        w * b - x * a - (y * d - z * c),
        w * c - y * a - (z * b - x * d),
        w * d - z * a - (x * c - y * b),
    ];
    Ok(2.0 * distance(vector, [0.0; 3]).atan2(scalar.abs()))
}

/// `q` with a largest component of one, so that its products neither overflow nor vanish.
fn scaled(name: &'static str, row: usize, q: [f64; 4]) -> Result<[f64; 4], Error> {
    let largest = q.into_iter().map(f64::abs).fold(0.0, f64::max);
    if largest == 0.0 {
        return Err(Error::ZeroNorm { name, row });
    }
    Ok(q.map(|value| value / largest))
}
