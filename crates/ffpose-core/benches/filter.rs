//! The filter and its gradients without Python and torch: `cargo bench -p ffpose-core`.
//!
//! For profiles and for comparing two states of the code. `FFPOSE_ISA` chooses the instruction set, and `-- WORD` the cases
//! whose line has the word. What a user of torch gains is told by `python -m benchmarks filter`.

use std::env;
use std::fmt;
use std::hint::black_box;
use std::time::{Duration, Instant};

use ffpose_core::{Gradients, Layout, Scratch, Shape, SpectralFilter, StdThreads};
use ndarray::ArrayD;

fn main() {
    for case in CASES {
        forward(case);
        backward(case);
    }
}

/// Prints the median time of a call, and the rate at which it reads and writes so many arrays of images.
fn measure(what: &str, case: Case, arrays: usize, mut call: impl FnMut()) {
    let name = format!("{what} {case}");
    let words: Vec<_> = env::args().skip(1).filter(|word| !word.starts_with('-')).collect();
    if !words.iter().all(|word| name.contains(word.as_str())) {
        return;
    }
    let (begun, mut times) = (Instant::now(), vec![]);
    while times.len() < 20 || begun.elapsed() < Duration::from_millis(500) {
        let before = Instant::now();
        call();
        times.push(before.elapsed());
    }
    times.sort_unstable();
    let median = times[times.len() / 2];
    let rate = (arrays * case.bytes()) as f64 / median.as_secs_f64() / 1e9;
    println!("{name:30} {median:>12.2?} {rate:6.1} GB/s");
}

/// Images of one shape, the batch first.
#[derive(Clone, Copy)]
struct Case(Layout, &'static [usize]);

const CASES: [Case; 12] = [
    Case(Layout::Grid, &[1, 7, 7, 512]),
    Case(Layout::Grid, &[1, 14, 14, 256]),
    Case(Layout::Grid, &[32, 14, 14, 256]),
    Case(Layout::Grid, &[1, 28, 28, 256]),
    Case(Layout::Grid, &[1, 56, 56, 64]),
    Case(Layout::Grid, &[1, 31, 31, 64]),
    Case(Layout::Grid, &[8, 1, 50, 64]),
    Case(Layout::Tokens, &[1, 196, 128]),
    Case(Layout::Tokens, &[1, 196, 256]),
    Case(Layout::Tokens, &[32, 196, 256]),
    Case(Layout::Tokens, &[1, 784, 256]),
    Case(Layout::Tokens, &[1, 197, 256]),
];

impl fmt::Display for Case {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sizes: Vec<_> = self.1.iter().map(ToString::to_string).collect();
        write!(formatter, "{:?} {}", self.0, sizes.join("x"))
    }
}

impl Case {
    fn shape(self) -> Shape {
        Shape::of_images(self.0, self.1).unwrap()
    }

    fn filter(self) -> SpectralFilter<f32> {
        SpectralFilter::planned(self.shape()).unwrap()
    }

    /// Bytes of the images.
    fn bytes(self) -> usize {
        size_of::<f32>() * self.1.iter().product::<usize>()
    }
}

/// Numbers about zero without a pattern that a transform could like.
fn numbers(shape: &[usize]) -> ArrayD<f32> {
    let mut state = 1_u32;
    ArrayD::from_shape_simple_fn(shape, || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 23) as f32 - 1.0
    })
}

fn forward(case: Case) {
    let (x, weight) = (numbers(case.1), numbers(&case.shape().weight()));
    let mut y = ArrayD::zeros(case.1);
    let (filter, mut scratch) = (case.filter(), Scratch::default());
    measure("forward", case, 2, || {
        let x = black_box(x.view());
        filter.forward(x, weight.view(), y.view_mut(), &StdThreads(1), &mut scratch).unwrap();
    });
}

fn backward(case: Case) {
    let (x, grad, weight) = (numbers(case.1), numbers(case.1), numbers(&case.shape().weight()));
    let (mut for_x, mut for_weight) = (ArrayD::zeros(case.1), ArrayD::zeros(weight.shape()));
    let (filter, mut scratch) = (case.filter(), Scratch::default());
    measure("backward", case, 3, || {
        let gradients =
            Gradients { x: Some(for_x.view_mut()), weight: Some(for_weight.view_mut()) };
        let (grad, pool) = (black_box(grad.view()), StdThreads(1));
        filter.backward(grad, x.view(), weight.view(), gradients, &pool, &mut scratch).unwrap();
    });
}
