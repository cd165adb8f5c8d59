//! Quaternions `(w, x, y, z)`: Hamilton, scalar first. Angles in degrees.
//!
//! Arrays are `(..., 4)`, or `(..., 3)` for Euler angles. Rows are computed in `f64`, degrees too, and rounded once. NaN in a
//! row goes through to its result; a zero vector is no rotation and an error.

use ndarray::{ArrayD, ArrayViewD};

use crate::arrays::{array_of, rows_of};
use crate::error::tuple;
use crate::{Error, Real};

/// cos(pitch) below which roll and yaw turn about the same axis and only their sum is known.
const GIMBAL_LOCK: f64 = 1e-8;

/// `q / ‖q‖` for the rows of `q (..., 4)`.
///
/// # Errors
/// [`Error::Shape`]; [`Error::ZeroNorm`] with the row.
pub fn normalize<T: Real>(q: ArrayViewD<'_, T>) -> Result<ArrayD<T>, Error> {
    let units = rows_of("q", &q)?.enumerate().map(|(row, q)| Ok(unit(row, q)?.0));
    array_of(q.shape(), units)
}

/// The gradient of [`normalize`] with respect to `q`: `(grad - u ⟨u, grad⟩) / ‖q‖` with `u = q / ‖q‖`.
///
/// # Errors
/// [`Error::Shape`]; [`Error::ZeroNorm`] with the row.
pub fn normalize_backward<T: Real>(
    grad: ArrayViewD<'_, T>,
    q: ArrayViewD<'_, T>,
) -> Result<ArrayD<T>, Error> {
    if grad.shape() != q.shape() {
        return Err(Error::shape("grad", &tuple(q.shape()), grad.shape()));
    }
    let pairs = rows_of::<_, 4>("grad", &grad)?.zip(rows_of("q", &q)?).enumerate();
    let gradients = pairs.map(|(row, (grad, q))| {
        let (u, norm) = unit(row, q)?;
        let along: f64 = u.iter().zip(grad).map(|(u, g)| u * g).sum();
        Ok(std::array::from_fn::<_, 4, _>(|i| (grad[i] - u[i] * along) / norm))
    });
    array_of(q.shape(), gradients)
}

/// The one of `q` and `-q` whose first component other than zero is positive: `w > 0`, or `w = 0` and `x > 0`, and so on.
///
/// # Errors
/// [`Error::Shape`]; [`Error::ZeroNorm`] with the row.
pub fn canonical<T: Real>(q: ArrayViewD<'_, T>) -> Result<ArrayD<T>, Error> {
    let rows = rows_of::<_, 4>("q", &q)?.enumerate().map(|(row, q)| {
        if q.iter().all(|value| *value == 0.0) {
            Err(Error::ZeroNorm { name: "q", row })
        } else {
            Ok(signed(q))
        }
    });
    array_of(q.shape(), rows)
}

/// Roll, pitch and yaw `(..., 3)`, degrees, of `q (..., 4)`, which need not be normalized: turns about x, then y, then z of the
/// fixed frame (ZYX), as in Ye et al., Eq. 12, with the sign of the pitch that inverts [`from_euler`].
///
/// Roll and yaw are in `(-180, 180]`. Pitch is in `[-90, 90]`, by an arctangent that equals the clamped arcsine and keeps its
/// digits near the ends; there, in gimbal lock, roll is zero and yaw takes the whole turn. `q` and `-q` give the same.
///
/// # Errors
/// [`Error::Shape`]; [`Error::ZeroNorm`] with the row.
pub fn to_euler<T: Real>(q: ArrayViewD<'_, T>) -> Result<ArrayD<T>, Error> {
    let angles = rows_of("q", &q)?
        .enumerate()
        .map(|(row, q)| Ok(euler(signed(unit(row, q)?.0)).map(f64::to_degrees)));
    let angles: ArrayD<T> = array_of(q.shape(), angles)?;
    // also where rounding has made half a turn of a little less
    Ok(angles.mapv_into(|angle| if angle.into() <= -180.0 { T::nearest(180.0) } else { angle }))
}

/// The canonical unit quaternions `(..., 4)` of roll, pitch and yaw `(..., 3)`, degrees: the inverse of [`to_euler`].
///
/// # Errors
/// [`Error::Shape`].
pub fn from_euler<T: Real>(angles: ArrayViewD<'_, T>) -> Result<ArrayD<T>, Error> {
    let rows = rows_of("rpy", &angles)?.map(|row: [f64; 3]| {
        let [(sr, cr), (sp, cp), (sy, cy)] = row.map(|angle| (0.5 * angle.to_radians()).sin_cos());
        let q = [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ];
        Ok(signed(q.map(|value| T::nearest(value).into()))) // rounding may make a zero
    });
    array_of(angles.shape(), rows)
}

/// The canonical one of `q` and `-q`.
fn signed(q: [f64; 4]) -> [f64; 4] {
    let is_negative = q.iter().find(|value| **value != 0.0).is_some_and(|first| *first < 0.0);
    if is_negative { q.map(|value| 0.0 - value) } else { q }
}

/// `q / ‖q‖` and `‖q‖`, without overflow or underflow on the way.
fn unit(row: usize, q: [f64; 4]) -> Result<([f64; 4], f64), Error> {
    let largest = q.into_iter().map(f64::abs).fold(0.0, f64::max);
    if largest == 0.0 && !q.into_iter().any(f64::is_nan) {
        return Err(Error::ZeroNorm { name: "q", row });
    }
    let scaled = q.map(|value| value / largest);
    let norm = scaled.iter().map(|value| value * value).sum::<f64>().sqrt();
    Ok((scaled.map(|value| value / norm), largest * norm))
}

/// Roll, pitch and yaw of a canonical unit quaternion, radians.
fn euler([w, x, y, z]: [f64; 4]) -> [f64; 3] {
    let sin_pitch = 2.0 * (w * y - x * z);
    let (roll_sin, roll_cos) = (2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y));
    let cos_pitch = roll_sin.hypot(roll_cos);
    let pitch = sin_pitch.atan2(cos_pitch);
    if cos_pitch < GIMBAL_LOCK {
        return [0.0, pitch, -2.0 * sin_pitch.signum() * x.atan2(w)];
    }
    let yaw = (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z));
    [roll_sin.atan2(roll_cos), pitch, yaw]
}
