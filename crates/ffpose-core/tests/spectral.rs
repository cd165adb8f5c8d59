//! The filter and its gradients against the sums that define them, for every instruction set of the machine.

mod common;
#[cfg(target_arch = "x86_64")]
mod disassembly;

use common::{Numbers, exact, filter, weight_gradient};
use ffpose_core::{
    Bf16, Error, F16, Gradients, Isa, Layout, Number, Planned, Pool, Real, Scratch, Shape,
    SpectralFilter, StdThreads,
};
use ndarray::{ArrayD, Axis};
use rustfft::num_traits::FromPrimitive;

/// Sizes with a reason: the networks', powers of two, odd, prime, long and flat.
const GRIDS: [[usize; 4]; 37] = [
    [1, 14, 14, 20],
    [2, 7, 7, 9],
    [1, 28, 28, 5],
    [1, 56, 56, 3],
    [3, 8, 16, 17],
    [1, 32, 32, 2],
    [2, 1, 1, 3],
    [2, 1, 6, 4],
    [2, 5, 1, 4],
    [1, 2, 2, 40],
    [2, 13, 11, 7],
    [1, 17, 31, 2],
    [1, 9, 15, 33],
    [1, 12, 10, 8],
    [1, 3, 50, 1],
    [1, 37, 4, 16],
    [32, 2, 2, 600], // tiles, and parts of the batch that are summed apart
    // sequences
    [2, 1, 50, 40],
    [3, 1, 49, 17],
    [1, 1, 134, 5],
    // of few channels, some by squares of vectors
    [3, 1, 96, 3],
    [2, 1, 140, 7],
    [1, 1, 4576, 1],
    [1, 40, 60, 1],
    [2, 9, 803, 7],
    [1, 67, 131, 5],
    [1, 131, 40, 4],
    [1, 33, 127, 2],
    // several images of few channels together
    [33, 1, 12, 7],
    [18, 1, 15, 3],
    [70, 1, 8, 1],
    [19, 1, 21, 1],
    [20, 6, 5, 2],
    [3, 4, 4, 15],
    // one channel, as tokens
    [9, 1, 256, 1],
    [1, 1, 1024, 1],
    [2, 49, 64, 1],
];
const TOKENS: [[usize; 3]; 33] = [
    [2, 14, 16],
    [9, 520, 2],
    [1, 196, 64],
    [1, 28, 128],
    [3, 49, 32],
    [2, 1, 1],
    [2, 1, 8],
    [2, 8, 1],
    [2, 2, 2],
    [5, 7, 13],
    [1, 31, 37],
    [2, 12, 30],
    [1, 64, 9],
    [1, 3, 256],
    [9, 5, 6],
    [2, 49, 64],
    [1, 56, 192],
    [1, 98, 128],
    [3, 1, 96],
    [1, 192, 128],
    [1, 768, 32],
    [2, 67, 40], // a large prime
    [1, 30, 134],
    [2, 67, 30], // half spectra of a vector, and of one more
    [1, 33, 32],
    // one row, or one codelet along X
    [3, 1, 512],
    [1, 1, 1024],
    [1, 1, 2048],
    [7, 8, 128],
    [1, 12, 256],
    // several images together
    [18, 50, 2],
    [19, 2, 50],
    [3, 40, 1],
];

/// Threads that take a share of any work, however little.
struct Eager(usize);

impl Pool for Eager {
    fn threads(&self) -> usize {
        self.0
    }

    fn grain(&self) -> usize {
        1
    }

    fn run(&self, workers: usize, work: &(dyn Fn(usize) + Sync)) {
        StdThreads(self.0).run(workers, work);
    }
}

fn cases() -> Vec<(Layout, Vec<usize>)> {
    let grids = GRIDS.iter().map(|shape| (Layout::Grid, shape.to_vec()));
    grids.chain(TOKENS.iter().map(|shape| (Layout::Tokens, shape.to_vec()))).collect()
}

fn forward<X: Number, W: Number<Real = X::Real>>(
    filter: &SpectralFilter<X::Real>,
    x: &ArrayD<X>,
    weight: &ArrayD<W>,
    threads: usize,
) -> ArrayD<X> {
    let mut y = ArrayD::from_elem(x.raw_dim(), X::default());
    let scratch = &mut Scratch::poisoned();
    filter.forward(x.view(), weight.view(), y.view_mut(), &Eager(threads), scratch).unwrap();
    y
}

/// As [`forward`], in place.
fn forward_in_place<X: Number, W: Number<Real = X::Real>>(
    filter: &SpectralFilter<X::Real>,
    x: &ArrayD<X>,
    weight: &ArrayD<W>,
    threads: usize,
) -> ArrayD<X> {
    let mut y = x.clone();
    let scratch = &mut Scratch::poisoned();
    filter.forward_in_place(y.view_mut(), weight.view(), &Eager(threads), scratch).unwrap();
    y
}

fn backward<X: Number, W: Number<Real = X::Real>>(
    filter: &SpectralFilter<X::Real>,
    (grad, x, weight): (&ArrayD<X>, &ArrayD<X>, &ArrayD<W>),
    threads: usize,
) -> (ArrayD<X>, ArrayD<W>) {
    let mut grad_x = ArrayD::from_elem(x.raw_dim(), X::default());
    let mut grad_weight = ArrayD::from_elem(weight.raw_dim(), W::default());
    let gradients = Gradients { x: Some(grad_x.view_mut()), weight: Some(grad_weight.view_mut()) };
    let scratch = &mut Scratch::poisoned();
    let (grad, x, weight) = (grad.view(), x.view(), weight.view());
    filter.backward(grad, x, weight, gradients, &Eager(threads), scratch).unwrap();
    (grad_x, grad_weight)
}

/// Four roundings for each doubling of the plane, relative to the largest number.
fn assert_close<T: Real>(
    got: &ArrayD<T>,
    expected: &ArrayD<f64>,
    shape: Shape,
    eps: f64,
    what: &str,
) {
    let largest = expected.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
    let tolerance = 4.0 * eps * ((shape.rows * shape.columns) as f64).log2().max(1.0) * largest;
    let error = got.iter().zip(expected).map(|(a, b)| ((*a).into() - b).abs());
    let worst = error.fold(0.0, |most: f64, e| if e <= most { most } else { e });
    assert!(worst <= tolerance, "{what}: error {worst:e}, tolerance {tolerance:e}");
}

/// All that this machine has, or the one that `FFPOSE_ISA` names: in an emulator each takes minutes.
fn isas() -> Vec<Isa> {
    match std::env::var("FFPOSE_ISA") {
        Ok(name) if !name.is_empty() => vec![Isa::named(&name).unwrap()],
        _ => Isa::available(),
    }
}

fn plans<T: Planned>(shape: Shape) -> impl Iterator<Item = SpectralFilter<T>> {
    isas().into_iter().map(move |isa| SpectralFilter::new(isa, shape))
}

fn agree_with_the_sums<T: Real + Number<Real = T>>(cases: Vec<(Layout, Vec<usize>)>, eps: f64) {
    for (layout, dim) in cases {
        let shape = Shape::of_images(layout, &dim).unwrap();
        let mut numbers = Numbers(dim.iter().product::<usize>() as u64);
        let (x, grad) = (numbers.array::<T>(&dim), numbers.array::<T>(&dim));
        let weight = numbers.array::<T>(&shape.weight());
        let [x64, grad64, weight64] = [&x, &grad, &weight].map(exact);
        let mut conjugate = weight64.clone();
        conjugate.map_axis_mut(Axis(weight.ndim() - 1), |mut w| w[1] = -w[1]);
        let y = filter(layout, &x64, &weight64);
        let expected_x = filter(layout, &grad64, &conjugate);
        let expected_weight = weight_gradient(layout, &grad64, &x64, &weight64);
        for plan in plans::<T>(shape) {
            let close = |what, got: &_, expected: &_| {
                assert_close(got, expected, shape, eps, &format!("{what} {layout:?} {dim:?}"));
            };
            let (grad_x, grad_weight) = backward(&plan, (&grad, &x, &weight), 1);
            close("y", &forward(&plan, &x, &weight, 1), &y);
            close("grad_x", &grad_x, &expected_x);
            close("grad_weight", &grad_weight, &expected_weight);
        }
    }
}

#[test]
fn single_precision_agrees_with_the_sums() {
    agree_with_the_sums::<f32>(cases(), f32::EPSILON.into());
}

#[test]
fn double_precision_agrees_with_the_sums() {
    agree_with_the_sums::<f64>(cases(), f64::EPSILON);
}

/// Along each axis: with a codelet, of several factors, and with large primes.
#[test]
fn lengths_of_all_kinds_agree_with_the_sums() {
    let lengths = (1..=70).chain([89, 97, 98, 100, 128, 134, 167, 196, 200, 251, 256, 360]);
    let along_each = |length| {
        let grids = [[1, 1, length, 16], [1, 3, length, 17], [1, length, 4, 8]];
        let grids = grids.map(|dim| (Layout::Grid, dim.to_vec()));
        grids.into_iter().chain([(Layout::Tokens, vec![1, length, 24])])
    };
    agree_with_the_sums::<f32>(lengths.flat_map(along_each).collect(), f32::EPSILON.into());
}

/// One case of the property: everything that a caller may choose, from one number.
fn any_case_agrees<X: Number<Real: Number<Real = X::Real>> + PartialEq>(
    numbers: &mut Numbers,
    layout: Layout,
    dim: &[usize],
    eps: f64,
) {
    let shape = Shape::of_images(layout, dim).unwrap();
    let eps = eps.max(rounding::<X>());
    let [x, grad] = [(); 2].map(|()| numbers.array::<X::Real>(dim).mapv(X::nearest_to));
    let weight = numbers.array::<X::Real>(&shape.weight());
    let [x64, grad64] = [&x, &grad].map(|a| exact(&a.mapv(X::widened)));
    let weight64 = exact(&weight);
    let mut conjugate = weight64.clone();
    conjugate.map_axis_mut(Axis(weight.ndim() - 1), |mut w| w[1] = -w[1]);
    let threads = 1 + numbers.below(9);
    let wanted = [[true, false], [false, true], [true, true]][numbers.below(3)];
    let y = filter(layout, &x64, &weight64);
    let expected_x = wanted[0].then(|| filter(layout, &grad64, &conjugate));
    let expected_weight = wanted[1].then(|| weight_gradient(layout, &grad64, &x64, &weight64));
    for plan in plans::<X::Real>(shape) {
        let what = |name| format!("{name} {layout:?} {dim:?}, {threads} threads, {wanted:?}");
        let close = |name, got: ArrayD<X::Real>, expected: &ArrayD<f64>, scale: f64| {
            let tolerance = 4.0 * eps * ((shape.rows * shape.columns) as f64).log2().max(1.0);
            let error = (exact(&got) - expected).mapv(f64::abs);
            let worst = error.iter().fold(0.0, |most: f64, &e| if e <= most { most } else { e });
            assert!(worst <= tolerance * scale, "{}: error {worst:e}", what(name));
        };
        let largest =
            |a: &ArrayD<f64>| a.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
        close("y", forward(&plan, &x, &weight, threads).mapv(X::widened), &y, largest(&y));
        let mut results = (ArrayD::from_elem(dim, X::default()), ArrayD::zeros(shape.weight()));
        let gradients = Gradients {
            x: wanted[0].then(|| results.0.view_mut()),
            weight: wanted[1].then(|| results.1.view_mut()),
        };
        let (pool, scratch) = (Eager(threads), &mut Scratch::poisoned());
        plan.backward(grad.view(), x.view(), weight.view(), gradients, &pool, scratch).unwrap();
        if let Some(expected) = &expected_x {
            close("grad_x", results.0.mapv(X::widened), expected, largest(expected));
        }
        if let Some(expected) = &expected_weight {
            // a sum of products of two spectra may cancel: the sizes of the images count
            let scale = 2.0 * (&x64 * &x64).sum().sqrt() * (&grad64 * &grad64).sum().sqrt();
            close("grad_weight", results.1, expected, scale);
        }
    }
}

/// Half a unit in the last place of what results are rounded to.
fn rounding<X: Number + PartialEq>() -> f64 {
    let nearest = |value: f64| X::nearest_to(X::Real::from_f64(value).unwrap());
    let steps = (1..60).map(|bit| 0.5_f64.powi(bit));
    steps.take_while(|step| nearest(1.0 + step) != nearest(1.0)).last().unwrap() / 2.0
}

#[test]
fn any_shape_type_threads_and_gradients_agree_with_the_sums() {
    let mut numbers = Numbers(2026);
    let cases = if cfg!(target_arch = "aarch64") { 50 } else { 150 }; // an emulator's minute
    for _ in 0..cases {
        let batch = 1 + numbers.below(5);
        let [rows, columns] = [(); 2].map(|()| 1 + numbers.below(24));
        let (layout, dim) = match numbers.below(3) {
            0 => (Layout::Tokens, vec![batch, 4 * rows, 4 * columns]),
            1 => (Layout::Grid, vec![batch, rows, columns, 1 + numbers.below(70)]),
            _ => (Layout::Grid, vec![batch, 1, rows * columns, 1 + numbers.below(40)]),
        };
        let eps = f32::EPSILON.into();
        match numbers.below(5) {
            0 => any_case_agrees::<Bf16>(&mut numbers, layout, &dim, eps),
            1 => any_case_agrees::<F16>(&mut numbers, layout, &dim, eps),
            2 => any_case_agrees::<f64>(&mut numbers, layout, &dim, f64::EPSILON),
            _ => any_case_agrees::<f32>(&mut numbers, layout, &dim, eps),
        }
    }
}

/// `⟨grad, filter(x, w)⟩` is linear in each of `x` and `w`, so the gradients are its coefficients.
#[test]
fn gradients_are_adjoint_to_the_filter() {
    let dot = |a: &ArrayD<f64>, b: &ArrayD<f64>| (a * b).sum();
    for (layout, dim) in cases() {
        let shape = Shape::of_images(layout, &dim).unwrap();
        let mut numbers = Numbers(7);
        let [grad, x, other] = [(); 3].map(|()| numbers.array::<f64>(&dim));
        let [weight, step] = [(); 2].map(|()| numbers.array::<f64>(&shape.weight()));
        let by_x = dot(&grad, &filter(layout, &other, &weight));
        let by_weight = dot(&grad, &filter(layout, &x, &step));
        for plan in plans(shape) {
            let (grad_x, grad_weight) = backward(&plan, (&grad, &x, &weight), 1);
            let scale = 1e-12 * x.len() as f64;
            assert!((dot(&grad_x, &other) - by_x).abs() < scale, "x {layout:?} {dim:?}");
            assert!((dot(&grad_weight, &step) - by_weight).abs() < scale, "w {layout:?} {dim:?}");
        }
    }
}

#[test]
fn threads_and_batches_do_not_change_a_bit() {
    let large = [
        (Layout::Grid, vec![3, 28, 28, 250]),
        (Layout::Grid, vec![2, 14, 14, 390]), // wide tiles for few threads, narrow ones for many
        (Layout::Grid, vec![32, 7, 7, 500]),
        (Layout::Grid, vec![1, 28, 28, 350]), // one image, a thread for each few of its tiles
        (Layout::Grid, vec![1, 90, 100, 60]), // one tile, cut into narrower ones
        (Layout::Grid, vec![40, 30, 30, 10]),
        (Layout::Grid, vec![16, 90, 100, 3]),
        (Layout::Grid, vec![120, 1, 720, 7]), // several sequences together
        (Layout::Grid, vec![530, 1, 1024, 1]),
        (Layout::Grid, vec![200, 1, 675, 3]),
        (Layout::Grid, vec![40, 1, 75, 100]),
        (Layout::Grid, vec![40, 1, 336, 36]), // tiles of three vectors with AVX2
        (Layout::Grid, vec![60, 1, 200, 17]), // one lane behind whole vectors
        (Layout::Tokens, vec![300, 1000, 2]),
        (Layout::Tokens, vec![37, 70, 128]),
        (Layout::Tokens, vec![37, 8, 256]),
        (Layout::Grid, vec![70, 1, 512, 1]),
        (Layout::Grid, vec![30, 49, 128, 1]),
        (Layout::Tokens, vec![10, 151, 251]),
        (Layout::Tokens, vec![1, 784, 512]), // one image, shared by threads
        (Layout::Tokens, vec![1, 151, 251]), // the same by squares of vectors
        (Layout::Grid, vec![1, 131, 140, 3]),
        (Layout::Tokens, vec![9, 196, 128]),
    ];
    for (layout, dim) in large {
        let shape = Shape::of_images(layout, &dim).unwrap();
        let mut numbers = Numbers(3);
        let (x, grad) = (numbers.array::<f32>(&dim), numbers.array::<f32>(&dim));
        let weight = numbers.array::<f32>(&shape.weight());
        for isa in isas() {
            let plan = SpectralFilter::new(isa, shape);
            let y = forward(&plan, &x, &weight, 1);
            let gradients = backward(&plan, (&grad, &x, &weight), 1);
            // Without vectors it takes ten times as long, and in an emulator of ARM a hundred times; pieces are cut in the same way.
            let all: &[_] = match isa.name() {
                "scalar" => &[3],
                "neon" => &[3, 24],
                _ => &[2, 3, 8, 24, 64],
            };
            for &threads in all {
                assert_eq!(forward(&plan, &x, &weight, threads), y);
                assert_eq!(forward_in_place(&plan, &x, &weight, threads), y);
                assert_eq!(backward(&plan, (&grad, &x, &weight), threads), gradients);
            }
            let last = x.slice_axis(Axis(0), (-1..).into()).to_owned();
            let expected = y.slice_axis(Axis(0), (-1..).into()).to_owned();
            assert_eq!(forward(&plan, &last, &weight, 1), expected);
            let last_grad = grad.slice_axis(Axis(0), (-1..).into()).to_owned();
            let expected = gradients.0.slice_axis(Axis(0), (-1..).into()).to_owned();
            assert_eq!(backward(&plan, (&last_grad, &last, &weight), 1).0, expected);
        }
    }
}

/// Whatever the batch, and wherever in it an image is.
#[test]
fn an_image_is_filtered_alone_as_in_a_batch() {
    for (layout, dim) in cases() {
        let shape = Shape::of_images(layout, &dim).unwrap();
        let mut numbers = Numbers(17);
        let [grad, x] = [(); 2].map(|()| numbers.array::<f32>(&dim));
        let weight = numbers.array::<f32>(&shape.weight());
        for plan in plans::<f32>(shape) {
            let y = forward(&plan, &x, &weight, 1);
            let (grad_x, _) = backward(&plan, (&grad, &x, &weight), 1);
            for split in 1..dim[0].min(20) {
                for part in [ndarray::Slice::from(..split), ndarray::Slice::from(split..)] {
                    let of = |array: &ArrayD<f32>| array.slice_axis(Axis(0), part).to_owned();
                    assert_eq!(forward(&plan, &of(&x), &weight, 1), of(&y), "{layout:?} {dim:?}");
                    let (part_x, _) = backward(&plan, (&of(&grad), &of(&x), &weight), 1);
                    assert_eq!(part_x, of(&grad_x), "{layout:?} {dim:?}");
                }
            }
        }
    }
}

/// Grids whose channels take all ways through the kernels.
const CHANNELS: [[usize; 4]; 14] = [
    [2, 1, 50, 40],
    [1, 1, 49, 33],
    [3, 1, 67, 20],
    [1, 1, 134, 16],
    [5, 1, 12, 7],
    [20, 1, 9, 2],
    [3, 1, 48, 3],
    [2, 1, 64, 7],
    [2, 14, 14, 33],
    [1, 14, 14, 20],
    [3, 5, 6, 40],
    [2, 9, 7, 18],
    [5, 6, 7, 3],
    [1, 100, 90, 3],
];

/// Bit by bit, whatever the numbers of one channel are.
fn a_channel_depends_on_itself_alone<T, X>(large: [T; 3])
where
    T: Number<Real = T> + Real,
    X: Number<Real = T> + PartialEq,
{
    let round = |array: ArrayD<T>| array.mapv(X::nearest_to);
    for dim in CHANNELS {
        let shape = Shape::of_images(Layout::Grid, &dim).unwrap();
        let mut numbers = Numbers(19);
        let [grad, x] = [(); 2].map(|()| round(numbers.array(&dim)));
        let weight = numbers.array::<T>(&shape.weight());
        for plan in plans::<T>(shape) {
            let results = |grad: &_, x: &_| {
                let (grad_x, grad_weight) = backward(&plan, (grad, x, &weight), 1);
                (forward(&plan, x, &weight, 1), grad_x, grad_weight)
            };
            let expected = results(&grad, &x);
            for channel in [0, dim[3] / 2] {
                for value in large.map(X::nearest_to) {
                    let (mut grad, mut x) = (grad.clone(), x.clone());
                    grad.index_axis_mut(Axis(3), channel).fill(value);
                    x.index_axis_mut(Axis(3), channel).fill(value);
                    let got = results(&grad, &x);
                    for other in (0..dim[3]).filter(|&other| other != channel) {
                        let same = got.0.index_axis(Axis(3), other)
                            == expected.0.index_axis(Axis(3), other)
                            && got.1.index_axis(Axis(3), other)
                                == expected.1.index_axis(Axis(3), other)
                            && got.2.index_axis(Axis(2), other)
                                == expected.2.index_axis(Axis(2), other);
                        assert!(same, "channel {other} of {dim:?} depends on channel {channel}");
                    }
                }
            }
        }
    }
}

#[test]
fn a_channel_depends_on_no_other() {
    let large = [f32::INFINITY, f32::NAN, 1e30];
    a_channel_depends_on_itself_alone::<f32, f32>(large);
    a_channel_depends_on_itself_alone::<f64, f64>(large.map(f64::from));
    a_channel_depends_on_itself_alone::<f32, Bf16>(large);
    a_channel_depends_on_itself_alone::<f32, F16>(large);
}

/// The error of a channel is relative to its own numbers.
#[test]
fn small_channels_are_as_exact_as_large_ones() {
    for length in [50, 49] {
        let shape = Shape::of_images(Layout::Grid, &[1, 1, length, 32]).unwrap();
        let mut x = Numbers(23).array::<f32>(&[1, 1, length, 32]);
        x.slice_axis_mut(Axis(3), (..16).into()).mapv_inplace(|value| 1e4 * value);
        let mut identity = ArrayD::<f32>::zeros(shape.weight());
        identity.index_axis_mut(Axis(3), 0).fill(1.0);
        for plan in plans::<f32>(shape) {
            let y = forward(&plan, &x, &identity, 1);
            for (got, expected) in y.axis_iter(Axis(3)).zip(x.axis_iter(Axis(3))) {
                let (got, expected) = (got.to_owned(), exact(&expected.to_owned()));
                assert_close(&got, &expected, shape, f32::EPSILON.into(), "identity");
            }
        }
    }
}

/// Bit by bit the result in single precision, rounded once.
fn half_precision_is_rounded_once<H: Number<Real = f32> + PartialEq + std::fmt::Debug>() {
    let cases = [
        (Layout::Grid, vec![3, 14, 14, 20]),
        (Layout::Grid, vec![1, 14, 14, 150]),
        (Layout::Grid, vec![1, 70, 80, 50]), // one tile, cut in two for two threads
        (Layout::Grid, vec![3, 1, 50, 20]),
        (Layout::Grid, vec![40, 1, 336, 36]), // tiles of three vectors with AVX2
        (Layout::Grid, vec![60, 1, 200, 17]), // one lane behind whole vectors
        (Layout::Grid, vec![2, 12, 9, 1]),
        (Layout::Grid, vec![37, 1, 20, 3]), // several images together
        (Layout::Grid, vec![2, 100, 90, 2]), // too large for that
        (Layout::Grid, vec![19, 1, 512, 1]),
        (Layout::Tokens, vec![9, 8, 128]),
        (Layout::Tokens, vec![19, 30, 2]),
        (Layout::Tokens, vec![3, 28, 37]),
        (Layout::Tokens, vec![1, 49, 64]),
        // two threads: together, each some images, by the general kernels
        (Layout::Tokens, vec![1, 784, 512]),
        (Layout::Tokens, vec![7, 196, 256]),
        (Layout::Tokens, vec![7, 191, 200]),
        (Layout::Grid, vec![16, 90, 100, 2]),
    ];
    for (layout, dim) in cases {
        let shape = Shape::of_images(layout, &dim).unwrap();
        let mut numbers = Numbers(13);
        let rounded = |array: ArrayD<f32>| array.mapv(H::nearest_to);
        let [x, grad] = [(); 2].map(|()| rounded(numbers.array(&dim)));
        let weight = rounded(numbers.array::<f32>(&shape.weight()));
        let [x32, grad32, weight32] = [&x, &grad, &weight].map(|array| array.mapv(H::widened));
        for plan in plans::<f32>(shape) {
            let y = rounded(forward(&plan, &x32, &weight32, 1));
            assert!(forward(&plan, &x, &weight, 2) == y, "{layout:?} {dim:?}");
            assert!(forward(&plan, &x, &weight32, 1) == y, "{layout:?} {dim:?}");
            let (grad_x, grad_weight) = backward(&plan, (&grad32, &x32, &weight32), 1);
            let grad_x = rounded(grad_x);
            let got = backward(&plan, (&grad, &x, &weight32), 1);
            assert!(got.0 == grad_x, "{layout:?} {dim:?}");
            assert!(got.1 == grad_weight, "{layout:?} {dim:?}");
            let single = rounded(got.1);
            let got = backward(&plan, (&grad, &x, &weight), 2);
            assert!(got == (grad_x, single), "{layout:?} {dim:?}");
        }
    }
}

/// A filter of one pixel multiplies: every half comes in, and numbers on all sides of every rounding go out.
fn halves_pass_a_filter_of_one_pixel<H: Number<Real = f32>>(half: impl Fn(u16) -> H) {
    let finite = |&half: &H| half.widened().is_finite();
    let halves: Vec<H> = (0..=u16::MAX).map(&half).filter(finite).collect();
    let near = |pair: &[H]| {
        let middle = pair[0].widened().midpoint(pair[1].widened());
        [middle.next_down(), middle, middle.next_up()]
    };
    let numbers = halves.windows(2).flat_map(near).chain([65_519.996, 65_520.0]);
    let numbers: Vec<f32> = numbers.filter(|number| number.abs() < 1e38).collect(); // as sums of a few are finite
    let case = |dim: [usize; 4]| (Shape::of_images(Layout::Grid, &dim).unwrap(), dim.to_vec());
    let (shape, dim) = case([1, 1, 1, halves.len()]);
    let x = ArrayD::from_shape_vec(dim, halves).unwrap();
    for plan in plans::<f32>(shape) {
        let mut one = ArrayD::<f32>::zeros(shape.weight());
        one.index_axis_mut(Axis(3), 0).fill(1.0);
        let y = forward(&plan, &x, &one, 1);
        assert!(y.mapv(H::widened) == x.mapv(H::widened)); // of zeros any sign
    }
    let (shape, dim) = case([1, 1, 1, numbers.len()]);
    let ones = ArrayD::from_elem(dim, H::nearest_to(1.0));
    for plan in plans::<f32>(shape) {
        let mut weight = ArrayD::<f32>::zeros(shape.weight());
        let real = weight.index_axis_mut(Axis(3), 0);
        real.into_iter().zip(&numbers).for_each(|(to, &number)| *to = number);
        let y = forward(&plan, &ones, &weight, 1);
        let got: Vec<f32> = y.iter().map(|half| half.widened()).collect();
        let expected: Vec<f32> = numbers.iter().map(|&n| H::nearest_to(n).widened()).collect();
        assert!(got == expected);
    }
}

#[test]
fn every_half_is_converted_as_a_number() {
    halves_pass_a_filter_of_one_pixel(Bf16);
    halves_pass_a_filter_of_one_pixel(F16);
}

#[test]
fn half_precision_is_computed_in_single_precision() {
    half_precision_is_rounded_once::<Bf16>();
    half_precision_is_rounded_once::<F16>();
}

#[test]
fn a_gradient_is_the_same_alone() {
    let cases = [
        (Layout::Grid, vec![5, 6, 7, 9]),
        (Layout::Grid, vec![1, 7, 7, 150]),
        (Layout::Tokens, vec![2, 196, 64]),
        (Layout::Tokens, vec![1, 196, 64]),
        (Layout::Tokens, vec![2, 1, 512]),
        (Layout::Tokens, vec![6, 8, 128]),
        (Layout::Grid, vec![5, 49, 64, 1]),
    ];
    for (layout, dim) in cases {
        let shape = Shape::of_images(layout, &dim).unwrap();
        let mut numbers = Numbers(5);
        let [grad, x] = [(); 2].map(|()| numbers.array::<f32>(&dim));
        let weight = numbers.array::<f32>(&shape.weight());
        gradients_are_the_same_alone(shape, (&grad, &x, &weight));
    }
}

fn gradients_are_the_same_alone(
    shape: Shape,
    (grad, x, weight): (&ArrayD<f32>, &ArrayD<f32>, &ArrayD<f32>),
) {
    for plan in plans::<f32>(shape) {
        let (grad_x, grad_weight) = backward(&plan, (grad, x, weight), 1);
        let (mut alone_x, mut alone_weight) = (grad_x.clone() * 0.0, grad_weight.clone() * 0.0);
        let mut scratch = Scratch::poisoned();
        let mut run = |gradients| {
            plan.backward(
                grad.view(),
                x.view(),
                weight.view(),
                gradients,
                &StdThreads(1),
                &mut scratch,
            )
            .unwrap();
        };
        run(Gradients { x: Some(alone_x.view_mut()), weight: None });
        run(Gradients { x: None, weight: Some(alone_weight.view_mut()) });
        run(Gradients { x: None, weight: None });
        assert_eq!((alone_x, alone_weight), (grad_x, grad_weight));
    }
}

#[test]
fn one_scratch_serves_filters_of_all_shapes() {
    let mut scratch = Scratch::poisoned();
    for (layout, dim) in cases() {
        let shape = Shape::of_images(layout, &dim).unwrap();
        let mut numbers = Numbers(11);
        let (x, weight) = (numbers.array::<f32>(&dim), numbers.array::<f32>(&shape.weight()));
        let plan = SpectralFilter::planned(shape).unwrap();
        let mut y = ArrayD::zeros(x.raw_dim());
        plan.forward(x.view(), weight.view(), y.view_mut(), &StdThreads(1), &mut scratch).unwrap();
        assert_eq!(y, forward(&plan, &x, &weight, 1));
    }
}

fn rounded<H: Number<Real = f32>>(array: &ArrayD<f32>) -> ArrayD<H> {
    array.mapv(H::nearest_to)
}

#[test]
fn a_prepared_weight_changes_no_bit() {
    for (layout, dim) in cases().into_iter().chain([(Layout::Grid, vec![3, 14, 14, 150])]) {
        let shape = Shape::of_images(layout, &dim).unwrap();
        let mut numbers = Numbers(17);
        let (x, weight) = (numbers.array::<f32>(&dim), numbers.array::<f32>(&shape.weight()));
        let one = x.slice_axis(Axis(0), (..1).into()).to_owned();
        let halves: ArrayD<Bf16> = rounded(&x);
        for plan in plans::<f32>(shape) {
            let prepared = plan.prepare(weight.view()).unwrap();
            for threads in [1, 3] {
                let (pool, scratch) = (Eager(threads), &mut Scratch::poisoned());
                for x in [&x, &one] {
                    let mut y = ArrayD::zeros(x.raw_dim());
                    prepared.forward(x.view(), y.view_mut(), &pool, scratch).unwrap();
                    assert_eq!(y, forward(&plan, x, &weight, 1), "{layout:?} {dim:?}");
                }
                let mut y = halves.clone();
                prepared.forward(halves.view(), y.view_mut(), &pool, scratch).unwrap();
                assert_eq!(y, forward(&plan, &halves, &weight, 1), "{layout:?} {dim:?}");
                assert_eq!(y, forward_in_place(&plan, &halves, &weight, threads), "{dim:?}");
                assert_eq!(y, forward_in_place(&plan, &halves, &weight, 1), "{dim:?}");
            }
        }
    }
}

#[test]
fn nothing_is_filtered_to_nothing() {
    for dim in [vec![0, 4, 6, 3], vec![2, 0, 6, 3], vec![2, 4, 0, 3], vec![2, 4, 6, 0]] {
        let shape = Shape::of_images(Layout::Grid, &dim).unwrap();
        let (x, weight) = (ArrayD::<f32>::zeros(dim), ArrayD::<f32>::zeros(shape.weight()));
        for plan in plans(shape) {
            assert!(forward(&plan, &x, &weight, 1).is_empty());
            assert!(forward_in_place(&plan, &x, &weight, 1).is_empty());
            let (_, grad_weight) = backward(&plan, (&x, &x, &weight), 1);
            assert_eq!(grad_weight, weight);
            let (prepared, mut y) = (plan.prepare(weight.view()).unwrap(), x.clone());
            prepared.forward(x.view(), y.view_mut(), &Eager(2), &mut Scratch::poisoned()).unwrap();
        }
    }
}

#[test]
fn wrong_shapes_are_refused() {
    let shape = Shape::of_images(Layout::Tokens, &[4, 6]).unwrap();
    let plan = SpectralFilter::<f32>::planned(shape).unwrap();
    let short = ArrayD::<f32>::zeros(vec![4, 3, 2]);
    assert!(matches!(plan.prepare(short.view()).err(), Some(Error::Shape { .. })));
    let attempt = |x: &[usize], weight: &[usize], y: &[usize]| {
        let [x, weight, mut y] = [x, weight, y].map(|dim| ArrayD::<f32>::zeros(dim.to_vec()));
        plan.forward(
            x.view(),
            weight.view(),
            y.view_mut(),
            &StdThreads(1),
            &mut Scratch::poisoned(),
        )
    };
    let wrong = |name, expected: &str, got: &[usize]| {
        Err(Error::Shape { name, expected: expected.into(), got: got.to_vec() })
    };
    assert_eq!(attempt(&[4, 6], &[4, 4, 2], &[4, 6]), Ok(()));
    assert_eq!(attempt(&[4, 7], &[4, 4, 2], &[4, 7]), wrong("x", "(..., 4, 6)", &[4, 7]));
    assert_eq!(attempt(&[4, 6], &[4, 3, 2], &[4, 6]), wrong("weight", "(4, 4, 2)", &[4, 3, 2]));
    assert_eq!(attempt(&[4, 6], &[4, 4, 2], &[1, 4, 6]), wrong("y", "(4, 6)", &[1, 4, 6]));
    assert_eq!(
        Shape::of_images(Layout::Tokens, &[3]),
        wrong("x", "(..., X, Y)", &[3]).map(|()| shape)
    );
}

#[test]
fn strides_are_refused() {
    let shape = Shape::of_images(Layout::Tokens, &[4, 4]).unwrap();
    let plan = SpectralFilter::<f32>::planned(shape).unwrap();
    let [x, weight, mut y] = [vec![4, 4], vec![4, 3, 2], vec![4, 4]].map(ArrayD::<f32>::zeros);
    let result =
        plan.forward(x.t(), weight.view(), y.view_mut(), &StdThreads(1), &mut Scratch::poisoned());
    assert_eq!(result, Err(Error::Strides { name: "x", got: vec![1, 4] }));
}

#[test]
fn a_plane_larger_than_memory_is_refused() {
    let huge = usize::MAX / 4;
    let error = Shape::of_images(Layout::Grid, &[0, huge, 2, 2]).unwrap_err();
    assert_eq!(error, Error::TooLarge { rows: huge, columns: 2, lanes: 2 });
    assert!(Shape::of_images(Layout::Tokens, &[huge, huge]).is_err());
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

#[test]
fn layouts_have_names() {
    assert_eq!("grid".parse(), Ok(Layout::Grid));
    assert_eq!("tokens".parse(), Ok(Layout::Tokens));
    assert_eq!("Grid".parse::<Layout>(), Err(Error::Layout { got: "Grid".into() }));
}
