//! The specification: `irfft2(rfft2(x) · W)` by the sums that define it, in `f64`, and numbers to try it on.

use std::f64::consts::TAU;

use ffpose_core::{Layout, Real};
use ndarray::{Array2, Array3, Array4, ArrayD, Axis, IxDyn};
use num_complex::Complex64;

/// `Σ_k line(k) · exp(sign · 2πi · jk / n)` along each line of an axis.
fn dft(plane: &Array2<Complex64>, axis: Axis, sign: f64) -> Array2<Complex64> {
    let n = plane.len_of(axis);
    let roots: Vec<_> = (0..n).map(|k| Complex64::cis(sign * TAU * k as f64 / n as f64)).collect();
    let mut out = plane.clone();
    for (line, mut out) in plane.lanes(axis).into_iter().zip(out.lanes_mut(axis)) {
        for (j, out) in out.iter_mut().enumerate() {
            // `j k` modulo `n`, without a division for each
            let turns = (0..n).scan(n - j, |turn, _| {
                *turn = (*turn + j) - if *turn + j >= n { n } else { 0 };
                Some(*turn)
            });
            *out = line.iter().zip(turns).map(|(x, turn)| x * roots[turn]).sum();
        }
    }
    out
}

/// The half spectrum of a real plane.
fn rfft2(plane: &Array2<f64>) -> Array2<Complex64> {
    let complex = plane.mapv(|value| Complex64::new(value, 0.0));
    let mut spectrum = dft(&dft(&complex, Axis(1), -1.0), Axis(0), -1.0);
    spectrum.slice_collapse(ndarray::s![.., ..plane.ncols() / 2 + 1]);
    spectrum
}

/// The real plane of a half spectrum; what is not Hermitian in the columns of DC and Nyquist is lost.
fn irfft2(half: &Array2<Complex64>, columns: usize) -> Array2<f64> {
    let rows = half.nrows();
    let half = dft(half, Axis(0), 1.0);
    let whole = Array2::from_shape_fn((rows, columns), |(r, v)| match v {
        v if v == 0 || 2 * v == columns => Complex64::new(half[(r, v)].re, 0.0),
        v if 2 * v < columns => half[(r, v)],
        v => half[(r, columns - v)].conj(),
    });
    dft(&whole, Axis(1), 1.0).mapv(|value| value.re / (rows * columns) as f64)
}

/// Images `(batch, rows, columns, channels)`: tokens have one channel.
fn images(layout: Layout, x: &ArrayD<f64>) -> Array4<f64> {
    let x = if layout == Layout::Tokens { x.clone().insert_axis(Axis(3)) } else { x.clone() };
    x.into_dimensionality().unwrap()
}

/// A complex weight `(rows, columns/2+1, channels)`.
fn weights(layout: Layout, weight: &ArrayD<f64>) -> Array3<Complex64> {
    let parts = Axis(weight.ndim() - 1);
    let weight = weight.map_axis(parts, |w| Complex64::new(w[0], w[1]));
    let weight = if layout == Layout::Tokens { weight.insert_axis(Axis(2)) } else { weight };
    weight.into_dimensionality().unwrap()
}

/// The filter of `x (batch, X, Y)` or `(batch, H, W, C)`; the last axis of `weight` holds the parts.
pub fn filter(layout: Layout, x: &ArrayD<f64>, weight: &ArrayD<f64>) -> ArrayD<f64> {
    let weight = weights(layout, weight);
    let mut y = images(layout, x);
    for mut image in y.outer_iter_mut() {
        for (mut plane, weight) in image.axis_iter_mut(Axis(2)).zip(weight.axis_iter(Axis(2))) {
            let product = rfft2(&plane.to_owned()) * weight;
            let filtered = irfft2(&product, plane.ncols());
            plane.assign(&filtered);
        }
    }
    y.into_shape_with_order(x.raw_dim()).unwrap()
}

/// The gradient of `⟨grad, filter(x)⟩` with respect to the weight: `copies / N · Σ_b conj(X_b) · G_b`.
pub fn weight_gradient(
    layout: Layout,
    grad: &ArrayD<f64>,
    x: &ArrayD<f64>,
    weight: &ArrayD<f64>,
) -> ArrayD<f64> {
    let mut sums = weights(layout, &ArrayD::zeros(weight.raw_dim()));
    let (grad, x) = (images(layout, grad), images(layout, x));
    let (rows, columns) = (x.len_of(Axis(1)), x.len_of(Axis(2)));
    for (grad, x) in grad.outer_iter().zip(x.outer_iter()) {
        let planes = grad.axis_iter(Axis(2)).zip(x.axis_iter(Axis(2)));
        for (mut sum, (grad, x)) in sums.axis_iter_mut(Axis(2)).zip(planes) {
            sum += &(rfft2(&x.to_owned()).mapv(|value| value.conj()) * rfft2(&grad.to_owned()));
        }
    }
    let parts = sums.indexed_iter().flat_map(|((_, v, _), sum)| {
        let copies = if v == 0 || 2 * v == columns { 1.0 } else { 2.0 };
        let scaled = sum * copies / (rows * columns) as f64;
        [scaled.re, scaled.im]
    });
    ArrayD::from_shape_vec(weight.raw_dim(), parts.collect()).unwrap()
}

/// Repeatable numbers, uniform in -1..1 (`SplitMix64`).
pub struct Numbers(pub u64);

impl Numbers {
    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut bits = self.0;
        bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        bits ^ (bits >> 31)
    }

    fn one(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    /// A whole number from zero to below `end`.
    #[allow(dead_code)] // not every test file asks for one
    pub fn below(&mut self, end: u32) -> usize {
        usize::try_from(self.bits() % u64::from(end)).expect("less than 32 bits")
    }

    /// An array of such numbers, rounded to its element type.
    pub fn array<T: Real>(&mut self, shape: &[usize]) -> ArrayD<T> {
        ArrayD::from_shape_simple_fn(IxDyn(shape), || T::nearest(self.one()))
    }
}

/// The same numbers in `f64`.
pub fn exact<T: Real>(array: &ArrayD<T>) -> ArrayD<f64> {
    array.mapv(Into::into)
}
