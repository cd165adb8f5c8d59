//! Errors and scores of estimated poses, sample by sample.
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

/// A true row and its estimate.
type Pair<const M: usize> = ([f64; M], [f64; M]);

/// True and estimated translations and orientations of N samples.
#[derive(Clone, Debug)]
pub struct PosePairs<'a, T> {
    /// True translations `(N, 3)`.
    pub t: ArrayViewD<'a, T>,
    /// True orientations `(N, 4)`.
    pub q: ArrayViewD<'a, T>,
    /// Estimated translations `(N, 3)`.
    pub t_hat: ArrayViewD<'a, T>,
    /// Estimated orientations `(N, 4)`.
    pub q_hat: ArrayViewD<'a, T>,
}

/// `‖t - t_hat‖` in meters.
///
/// # Errors
/// [`Error::Shape`]; [`Error::NotFinite`] with the row.
pub fn translation_error<T: Real>(
    t: ArrayViewD<'_, T>,
    t_hat: ArrayViewD<'_, T>,
) -> Result<ArrayD<T>, Error> {
    each_pair(["t", "t_hat"], &t, &t_hat, |_, t, t_hat| Ok(distance(t, t_hat)))
}

/// The angle of the rotation that takes `q` to `q_hat`, in radians from 0 to π.
///
/// Twice the arctangent of vector over scalar part of `q⁻¹ · q_hat`, which, unlike an arccosine, keeps small angles.
///
/// # Errors
/// [`Error::Shape`]; [`Error::NotFinite`] and [`Error::ZeroNorm`] with the row.
pub fn rotation_error<T: Real>(
    q: ArrayViewD<'_, T>,
    q_hat: ArrayViewD<'_, T>,
) -> Result<ArrayD<T>, Error> {
    each_pair(["q", "q_hat"], &q, &q_hat, angle)
}

/// The score of ESA's Kelvins pose estimation challenge, 2019: `‖t - t_hat‖ / ‖t‖` plus the rotation error in radians.
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
    let PosePairs { t, q, t_hat, q_hat } = pairs;
    let translations = finite_pairs(["t", "t_hat"], t, t_hat, None)?;
    let rotations = finite_pairs(["q", "q_hat"], q, q_hat, Some(t.shape()[0]))?;
    let scores = translations.zip(rotations).enumerate().map(|(row, (translation, rotation))| {
        let ((t, t_hat), (q, q_hat)) = (translation?, rotation?);
        let range = distance(t, [0.0; 3]);
        if range == 0.0 {
            return Err(Error::ZeroNorm { name: "t", row });
        }
        Ok([combine(distance(t, t_hat) / range, angle(row, q, q_hat)?)])
    });
    Ok(array_of(t.shape(), scores)?.remove_axis(Axis(1)))
}

/// `error(row, truth, estimate)` for each row of two arrays `(N, M)`.
fn each_pair<T: Real, const M: usize>(
    names: [&'static str; 2],
    truth: &ArrayViewD<'_, T>,
    estimate: &ArrayViewD<'_, T>,
    error: impl Fn(usize, [f64; M], [f64; M]) -> Result<f64, Error>,
) -> Result<ArrayD<T>, Error> {
    let errors = finite_pairs(names, truth, estimate, None)?.enumerate().map(|(row, pair)| {
        let (truth, estimate) = pair?;
        Ok([error(row, truth, estimate)?])
    });
    Ok(array_of(truth.shape(), errors)?.remove_axis(Axis(1)))
}

/// The rows of two arrays `(count, M)`, all finite; `count` is that of the first where it is not given.
fn finite_pairs<'a, T: Real, const M: usize>(
    [truth, estimate]: [&'static str; 2],
    rows: &'a ArrayViewD<'_, T>,
    others: &'a ArrayViewD<'_, T>,
    count: Option<usize>,
) -> Result<impl Iterator<Item = Result<Pair<M>, Error>> + use<'a, T, M>, Error> {
    let rows = finite_rows_of(truth, rows, count)?;
    let others = finite_rows_of(estimate, others, Some(rows.len()))?;
    Ok(rows.zip(others).map(|(row, other)| Ok((row?, other?))))
}

/// `‖a - b‖`, without overflow or underflow on the way.
fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1]).hypot(a[2] - b[2])
}

/// The angle between two orientations of any norm above zero, in radians.
fn angle(row: usize, q: [f64; 4], q_hat: [f64; 4]) -> Result<f64, Error> {
    let [w, x, y, z] = scaled("q", row, q)?;
    let [a, b, c, d] = scaled("q_hat", row, q_hat)?;
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
