//! The twiddle factors of the transform across lanes.

use super::groups::HALVES;
use crate::fft::codelets::{Codelet, TurnedDft, root};
use crate::simd::Element;

/// The twiddle factors of [`super::groups::Filter`], as vectors of real and vectors of imaginary parts: `exp(-2πi y / L)` for
/// `y < J = L / 2`, and for each group of `rows` rows its halfway, its factors, and those of the inverse transform, which are
/// normalized for `points` lines.
pub(super) fn twiddles<T: Element>(
    [points, width]: [usize; 2],
    lanes: usize,
    rows: usize,
) -> Vec<T> {
    let (slots, half) = (width / lanes / 2, lanes / 2);
    let mut numbers = Vec::new();
    let mut push = |number_of: &dyn Fn(usize) -> (f64, f64)| {
        let values: Vec<_> = (0..lanes).map(number_of).collect();
        numbers.extend(values.iter().map(|&(c, _)| T::nearest(c)));
        numbers.extend(values.iter().map(|&(_, s)| T::nearest(-s)));
    };
    push(&|lane| root(lane % half, lanes));
    for group in 0..rows * slots / lanes {
        let frequency = |place: usize| {
            let item = group * lanes + place;
            item % slots + item / slots % 2
        };
        for r in 0..half {
            push(&|lane| root(frequency(lane / half * half + r) * half, width));
        }
        for p in 0..HALVES {
            for &(power, eighths) in factors_of(half) {
                let turned = power * p * (width / lanes) + eighths * width / 8;
                push(&|lane| root(power * frequency(lane) + turned, width));
            }
        }
        for (r, y) in (0..half).flat_map(|r| [(r, 0), (r, half)]) {
            push(&|lane| {
                let k = frequency(lane / half * half + r);
                // a line's own two real frequencies were doubled, the others were left out with their mirrors
                let once = if k % slots == 0 { 0.5 } else { 2.0 };
                let norm = once / (points * width) as f64;
                let (c, s) = root(k * (y + lane % half), width);
                (norm * c, norm * s)
            });
        }
    }
    numbers
}

/// The factors of the transform of length `half`.
fn factors_of(half: usize) -> &'static [(usize, usize)] {
    match half {
        1 => <Codelet as TurnedDft<1>>::FACTORS,
        2 => <Codelet as TurnedDft<2>>::FACTORS,
        4 => <Codelet as TurnedDft<4>>::FACTORS,
        8 => <Codelet as TurnedDft<8>>::FACTORS,
        half => unreachable!("no transform across {half} vectors"),
    }
}
