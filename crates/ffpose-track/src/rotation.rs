//! Rotation vectors, and the integrals of a rotation that turns steadily.

use libm::{cos, sin};
use nalgebra::{Matrix3, Vector3};

/// Angle, radians, below which series take the place of quotients: their first term left out is then below 1e-16.
const SMALL: f64 = 1e-2;

/// `[v]×`, the matrix of the cross product.
pub(crate) fn hat(v: &Vector3<f64>) -> Matrix3<f64> {
    v.cross_matrix()
}

/// The integrals over `0…t` that a steady turn at the rate ω needs, of `E(s) = exp(-[ω]× s)` and `J(s) = ∫ E`.
pub(crate) struct Turn {
    /// `E(t)`: what is left of an attitude error.
    pub error: Matrix3<f64>,
    /// `J(t) = ∫ E(s) ds`: what an error of the rate has become.
    pub of_rate: Matrix3<f64>,
    /// What is left of an error of the rate: 1 for a steady turn.
    pub rate: Matrix3<f64>,
    /// `∫ J(s) ds`.
    pub cross: Matrix3<f64>,
    /// `∫ J(s) J(s)ᵀ ds`.
    pub square: Matrix3<f64>,
}

impl Turn {
    /// The integrals for the rate `rate`, rad/s, over `t` seconds.
    ///
    /// `E` turns the plane across ω by `-ωs` and leaves its axis, so that each integral is a sum of `1`, `[ω]×` and `[ω]×²`.
    pub(crate) fn new(rate: &Vector3<f64>, t: f64) -> Self {
        let unit = rate * t; // the turn as a rotation vector
        let (w, w2) = (hat(&unit), hat(&unit) * hat(&unit));
        let c = Quotients::new(unit.norm());
        let one = Matrix3::identity();
        Self {
            error: one - w * c.sine + w2 * c.cosine,
            rate: one,
            of_rate: (one - w * c.cosine + w2 * c.sine_rest) * t,
            cross: (one * 0.5 - w * c.sine_rest + w2 * c.cosine_rest) * (t * t),
            square: (one / 3.0 + w2 * c.square) * (t * t * t),
        }
    }

    /// Errors of a rate that changes by `change` of themselves a second, to second order in the short time `t`.
    pub(crate) fn changing(self, change: &Matrix3<f64>, t: f64) -> Self {
        let step = change * t;
        let one = Matrix3::identity();
        Self {
            rate: one + step + step * step * 0.5,
            of_rate: self.of_rate * (one + step * 0.5),
            ..self
        }
    }
}

/// `J_r(v)`, the right Jacobian of the exponential: `exp(v + ε) = exp(v) exp(J_r(v) ε)` to first order.
pub(crate) fn right_jacobian(v: &Vector3<f64>) -> Matrix3<f64> {
    Turn::new(v, 1.0).of_rate
}

/// The quotients of an angle `x` that integrals of steady turns share.
pub(crate) struct Quotients {
    /// `sin x / x`.
    pub sine: f64,
    /// `(1 - cos x) / x²`.
    pub cosine: f64,
    /// `(x - sin x) / x³`.
    pub sine_rest: f64,
    /// `(x²/2 + cos x - 1) / x⁴`.
    cosine_rest: f64,
    /// `(1/3 - 2 (x - sin x) / x³) / x²`.
    square: f64,
}

impl Quotients {
    pub fn new(x: f64) -> Self {
        let x2 = x * x;
        if x < SMALL {
            return Self {
                sine: 1.0 - x2 / 6.0 * (1.0 - x2 / 20.0 * (1.0 - x2 / 42.0)),
                cosine: 0.5 - x2 / 24.0 * (1.0 - x2 / 30.0 * (1.0 - x2 / 56.0)),
                sine_rest: 1.0 / 6.0 - x2 / 120.0 * (1.0 - x2 / 42.0 * (1.0 - x2 / 72.0)),
                cosine_rest: 1.0 / 24.0 - x2 / 720.0 * (1.0 - x2 / 56.0 * (1.0 - x2 / 90.0)),
                square: 1.0 / 60.0 - x2 / 2520.0 * (1.0 - x2 / 72.0 * (1.0 - x2 / 110.0)),
            };
        }
        let (sin, cos) = (sin(x), cos(x));
        let sine_rest = (x - sin) / (x2 * x);
        Self {
            sine: sin / x,
            cosine: (1.0 - cos) / x2,
            sine_rest,
            cosine_rest: (x2 / 2.0 + cos - 1.0) / (x2 * x2),
            square: (1.0 / 3.0 - 2.0 * sine_rest) / x2,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The integrals by the midpoint rule, from the series of the exponential alone.
    fn summed(rate: &Vector3<f64>, t: f64) -> Turn {
        const PARTS: u32 = 4000;
        let exp = |s: f64| {
            let (step, mut term, mut sum) =
                (hat(rate) * -s, Matrix3::identity(), Matrix3::identity());
            for n in 1..40 {
                term = term * step / f64::from(n);
                sum += term;
            }
            sum
        };
        let ds = t / f64::from(PARTS);
        let zero = Matrix3::zeros();
        let mut turn = Turn {
            error: exp(t),
            rate: Matrix3::identity(),
            of_rate: zero,
            cross: zero,
            square: zero,
        };
        for part in 0..PARTS {
            let middle = turn.of_rate + exp((f64::from(part) + 0.25) * ds) * (ds / 2.0);
            turn.cross += middle * ds;
            turn.square += middle * middle.transpose() * ds;
            turn.of_rate += exp((f64::from(part) + 0.5) * ds) * ds;
        }
        turn
    }

    #[test]
    fn integrals_are_those_of_a_sum_over_small_steps() {
        let axis = Vector3::new(0.6, -0.48, 0.64);
        for (rate, t) in [(0.0, 0.5), (0.002, 2.0), (0.0199, 0.5), (0.021, 0.5), (0.9, 3.0)] {
            let (got, expected) = (Turn::new(&(axis * rate), t), summed(&(axis * rate), t));
            for (got, expected) in [
                (got.error, expected.error),
                (got.of_rate, expected.of_rate),
                (got.cross, expected.cross),
                (got.square, expected.square),
            ] {
                assert!((got - expected).norm() < 1e-6 * expected.norm(), "{rate} {got}{expected}");
            }
        }
    }

    #[test]
    fn series_and_quotients_meet() {
        let axis = Vector3::new(0.6, -0.48, 0.64);
        let (below, above) = (
            Turn::new(&(axis * 0.999_999 * SMALL), 1.0),
            Turn::new(&(axis * 1.000_001 * SMALL), 1.0),
        );
        assert!((below.square - above.square).norm() < 1e-7);
        assert!((below.cross - above.cross).norm() < 1e-7);
    }
}
