//! Transforms against the sums that define them, for every instruction set of the machine.

use super::grid::Grid;
use super::grid::row_codelets::Place;
use super::grid::rows::Rows;
use crate::fft::transform::Transform;
use crate::kernel::Kernel;
use crate::simd::{Bf16, Isa, LINE_BYTES, Tile, TileMut, aligned, slack};
use crate::tuning::Tuning;
use crate::{Layout, Real, Shape};

/// Real and imaginary part.
type Number = (f64, f64);

/// `Σ_n x(n) exp(-2πi k n / N)`.
fn dft(x: &[Number], k: usize) -> Number {
    x.iter().enumerate().fold((0.0, 0.0), |(re, im), (n, z)| {
        let (s, c) = (-std::f64::consts::TAU * (k * n % x.len()) as f64 / x.len() as f64).sin_cos();
        (re + z.0 * c - z.1 * s, im + z.0 * s + z.1 * c)
    })
}

/// A number in -1..1 for each index, without a pattern.
fn number(index: usize) -> f64 {
    (index as f64 * 12.9898 + 78.233).sin()
}

/// Memory for complex vectors of `lanes`, with the numbers of `value(vector, lane)`.
fn filled<T: Real>(vectors: usize, lanes: usize, value: impl Fn(usize, usize) -> Number) -> Vec<T> {
    let mut memory = vec![T::default(); 2 * vectors * lanes + slack::<T>()];
    for (i, number) in aligned(&mut memory)[..2 * vectors * lanes].iter_mut().enumerate() {
        let (vector, lane) = (i / (2 * lanes), i % lanes);
        let (re, im) = value(vector, lane);
        *number = T::nearest(if i % (2 * lanes) < lanes { re } else { im });
    }
    memory
}

/// The complex number in a lane of a vector.
fn read<T: Real>(memory: &[T], vector: usize, lane: usize, lanes: usize) -> Number {
    let start = 2 * vector * lanes + lane;
    (memory[start].into(), memory[start + lanes].into())
}

#[track_caller]
fn assert_close(got: Number, expected: Number, tolerance: f64, what: &str) {
    let error = (got.0 - expected.0).hypot(got.1 - expected.1);
    assert!(error <= tolerance, "{what}: got {got:?}, expected {expected:?}");
}

/// Four roundings for each doubling of the length, relative to the largest number.
fn tolerance(eps: f64, length: usize, largest: f64) -> f64 {
    4.0 * eps * (length as f64).log2().max(1.0) * largest
}

fn transform_agrees<T: Real>(isa: Isa, length: usize, eps: f64) {
    let (transform, lanes) = (Transform::<T>::new(isa, length), isa.lanes::<T>());
    let x = |n: usize, lane: usize| {
        let index = 2 * (n * lanes + lane);
        let round = |x| Into::<f64>::into(T::nearest(x));
        (round(number(index)), round(number(index + 1)))
    };
    let inputs = transform.inputs();
    let at = |position| inputs.iter().position(|&p| p == position).unwrap();
    let mut memory = filled::<T>(length, lanes, |position, lane| x(at(position), lane));
    let mut work = filled::<T>(transform.work_len(), lanes, |_, _| (f64::NAN, f64::NAN));
    let (line, work) = (&mut aligned(&mut memory)[..2 * lanes * length], aligned(&mut work));

    transform.forward(line, work);
    for lane in [0, lanes - 1] {
        let values: Vec<_> = (0..length).map(|n| x(n, lane)).collect();
        let expected: Vec<_> = (0..length).map(|k| dft(&values, k)).collect();
        let largest = expected.iter().fold(0.0, |most: f64, z| most.max(z.0.hypot(z.1)));
        for (k, expected) in expected.into_iter().enumerate() {
            let got = read(line, transform.outputs()[k], lane, lanes);
            let what = format!("{} length {length} frequency {k}", isa.name());
            assert_close(got, expected, tolerance(eps, length, largest), &what);
        }
    }
    transform.inverse(line, work);
    for n in 0..length {
        let (re, im) = read(line, inputs[n], lanes - 1, lanes);
        let got = (re / length as f64, im / length as f64);
        assert_close(got, x(n, lanes - 1), tolerance(eps, length, 2.0), "inverse");
    }
}

#[test]
fn transforms_of_all_kinds_of_lengths_agree_with_the_sums() {
    for isa in Isa::available() {
        for length in (1..=70).chain([89, 97, 100, 128, 134, 196, 197, 202, 251, 256, 360, 784]) {
            transform_agrees::<f32>(isa, length, f32::EPSILON.into());
            transform_agrees::<f64>(isa, length, f64::EPSILON);
        }
    }
}

fn rows_agree<T: Real>(isa: Isa, width: usize, eps: f64) {
    const ROWS: usize = 3; // one pair and one alone
    let (rows, lanes) = (Rows::<T>::new(isa, width), isa.lanes::<T>());
    let image: Vec<T> = (0..ROWS * width * lanes).map(|i| T::nearest(number(i))).collect();
    let frequencies = rows.frequencies();
    let set = ROWS * frequencies.len();
    let place = Place { positions: &[2, 0, 1], pitch: ROWS, set, far: true };
    let nan = |_, _| (f64::NAN, f64::NAN);
    let mut spectrum = filled::<T>(ROWS * frequencies.len(), lanes, nan);
    let mut work = filled::<T>(rows.work_len(), lanes, nan);
    let work = aligned(&mut work);
    let spectrum = &mut aligned(&mut spectrum)[..2 * lanes * ROWS * frequencies.len()];

    rows.forward(isa, Tile::dense(&image, lanes), place, spectrum, work);
    for (row, &position) in place.positions.iter().enumerate() {
        let line: Vec<_> =
            (0..width).map(|n| (image[(row * width + n) * lanes].into(), 0.0)).collect();
        for (slot, &k) in frequencies.iter().enumerate() {
            let mut expected = dft(&line, k);
            if slot == 0 && width.is_multiple_of(2) {
                expected.1 = dft(&line, width / 2).0;
            }
            let (re, im) = read(spectrum, slot * ROWS + position, 0, lanes);
            let got = (re / rows.gain(), im / rows.gain());
            let what = format!("{} width {width} frequency {k}", isa.name());
            assert_close(got, expected, tolerance(eps, width, width as f64), &what);
        }
    }

    for number in &mut spectrum[2 * lanes * ROWS..] {
        *number = *number * T::nearest(rows.inverse_gain());
    }
    let mut back = vec![T::nearest(f64::NAN); image.len()];
    rows.inverse(isa, spectrum, place, TileMut::dense(&mut back, lanes), work);
    for (back, x) in back.into_iter().zip(image) {
        let got = back.into() / (width as f64 * rows.gain());
        assert_close((got, 0.0), (x.into(), 0.0), tolerance(eps, width, 2.0), "inverse");
    }
}

#[test]
fn rows_of_all_kinds_of_widths_agree_with_the_sums() {
    for isa in Isa::available() {
        for width in (1..=34).chain([49, 56, 64, 67, 100, 128, 200]) {
            rows_agree::<f32>(isa, width, f32::EPSILON.into());
            rows_agree::<f64>(isa, width, f64::EPSILON);
        }
    }
}

#[test]
fn tiles_of_a_grid_share_its_lanes_evenly_in_whole_cache_lines_of_half_precision() {
    const ROUNDING: usize = 64; // lanes
    for isa in Isa::available() {
        for (side, lanes) in [(7, 1), (7, 512), (7, 5000), (14, 129), (14, 384), (28, 600)] {
            let shape = Shape { layout: Layout::Grid, rows: side, columns: side, lanes };
            let grid = Grid::<f32>::new(isa, shape, Tuning::of_machine());
            for tile in [Kernel::<f32>::tile(&grid), Kernel::<Bf16>::narrowest_tile(&grid)] {
                assert_eq!(tile * size_of::<Bf16>() % LINE_BYTES, 0, "{tile} of {lanes}");
            }
            let tile = Kernel::<f32>::tile(&grid);
            let rest = lanes.next_multiple_of(tile) - lanes;
            assert!(rest < lanes.div_ceil(tile) * ROUNDING, "{tile} of {lanes}");
        }
    }
}

#[test]
fn an_unknown_instruction_set_lists_those_there_are() {
    let error = Isa::named("sse9").unwrap_err().to_string();
    assert!(error.contains("sse9"), "{error}");
    for isa in Isa::available() {
        assert!(error.contains(isa.name()), "{error}");
        assert_eq!(Isa::named(isa.name()), Ok(isa));
    }
}
