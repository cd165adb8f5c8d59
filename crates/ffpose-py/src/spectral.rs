//! The spectral filter, for NumPy arrays and for torch tensors.

use std::sync::LazyLock;
use std::thread;

use ffpose_core::tuning::{SCRATCH_KEPT, SCRATCH_KEPT_FOR_A_CORE};
use ffpose_core::{
    Bf16, Error, Gradients, Isa, Planned, Scratch, Scratches, Shape, SpectralFilter, StdThreads,
};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;

use crate::array::{Array, empty_like, with_dtype};
use crate::border::{Threads, enter, enter_sized};
use crate::pool::TorchPool;
use crate::tensor::{Dtype, Tensor, TensorElement};

/// A gradient or None.
type Gradient<'py> = Option<Bound<'py, PyAny>>;

/// Scratch that the process keeps for its next calls, whatever the number of its threads.
static SCRATCHES: LazyLock<Scratches> = LazyLock::new(|| {
    let cores = thread::available_parallelism().map_or(1, Into::into);
    Scratches::new(SCRATCH_KEPT.max(SCRATCH_KEPT_FOR_A_CORE.saturating_mul(cores)))
});

/// Asks the machine what later calls need to know, before another thread might be at it while this process is forked.
pub(crate) fn initialize() {
    ffpose_core::initialize();
    LazyLock::force(&SCRATCHES);
}

/// irfft2(rfft2(x) * weight): out, which may be x, or a new array like x.
#[pyfunction]
#[pyo3(
    signature = (x, weight, layout, num_threads = Threads(1), out = None),
    text_signature = "(x, weight, layout, num_threads=1, out=None)"
)]
pub(crate) fn spectral_filter<'py>(
    py: Python<'py>,
    x: &Bound<'py, PyAny>,
    weight: &Bound<'py, PyAny>,
    layout: &str,
    num_threads: Threads,
    out: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let pool = StdThreads(num_threads.0);
    with_dtype!(x, T => {
        let weight = Array::<T>::new("weight", weight)?;
        if out.is_some_and(|out| out.is(x)) {
            let images = Array::new("out", x)?;
            let uses = [weight.used(false), images.used(true)];
            let images = images.view_mut(&[&weight])?;
            let weight = weight.view();
            enter(py, &uses, || {
                let filter = planned(layout, images.shape())?;
                with_scratch(|scratch| filter.forward_in_place(images, weight, &pool, scratch))
            })?;
            return Ok(x.clone());
        }
        let y = out.map_or_else(|| empty_like(x), |out| Ok(out.clone()))?;
        let (x, out) = (Array::new("x", x)?, Array::new("out", &y)?);
        let uses = [x.used(false), weight.used(false), out.used(true)];
        let out = out.view_mut(&[&x, &weight])?;
        let (x, weight) = (x.view(), weight.view());
        enter(py, &uses, || {
            let filter = planned(layout, x.shape())?;
            with_scratch(|scratch| filter.forward(x, weight, out, &pool, scratch))
        })?;
        Ok(y)
    })
}

/// The gradients of `spectral_filter` with respect to x and to weight, each None unless it is needed.
#[pyfunction]
#[pyo3(
    signature = (grad, x, weight, layout, need_x, need_weight, num_threads = Threads(1)),
    text_signature = "(grad, x, weight, layout, need_x, need_weight, num_threads=1)"
)]
#[allow(clippy::too_many_arguments)] // Python passes them one by one
pub(crate) fn spectral_filter_backward<'py>(
    py: Python<'py>,
    grad: &Bound<'py, PyAny>,
    x: &Bound<'py, PyAny>,
    weight: &Bound<'py, PyAny>,
    layout: &str,
    need_x: bool,
    need_weight: bool,
    num_threads: Threads,
) -> PyResult<(Gradient<'py>, Gradient<'py>)> {
    with_dtype!(x, T => {
        let grad_x = need_x.then(|| empty_like(x)).transpose()?;
        let grad_weight = need_weight.then(|| empty_like(weight)).transpose()?;
        let inputs = [Array::<T>::new("grad", grad)?, Array::new("x", x)?, Array::new("weight", weight)?];
        let out_x = grad_x.as_ref().map(|g| Array::new("grad_x", g)).transpose()?;
        let out_weight = grad_weight.as_ref().map(|g| Array::new("grad_weight", g)).transpose()?;
        let reads = inputs.iter().map(|array| array.used(false));
        let writes = out_x.iter().chain(&out_weight).map(|array| array.used(true));
        let uses: Vec<_> = reads.chain(writes).collect();
        let [grad, x, weight] = &inputs;
        let others: Vec<_> = inputs.iter().chain(&out_weight).collect();
        let out_x = out_x.map(|g| g.view_mut(&others)).transpose()?;
        let out_weight = out_weight.map(|g| g.view_mut(&[grad, x, weight])).transpose()?;
        let gradients = Gradients { x: out_x, weight: out_weight };
        let (grad, x, weight) = (grad.view(), x.view(), weight.view());
        enter(py, &uses, || {
            let filter = planned(layout, x.shape())?;
            let pool = StdThreads(num_threads.0);
            with_scratch(|scratch| filter.backward(grad, x, weight, gradients, &pool, scratch))
        })?;
        Ok((grad_x, grad_weight))
    })
}

/// Calls a function for the element types of two tensors: one type, or bfloat16 with a float32 weight. float16, rare on CPUs,
/// would be another tenth of the library.
macro_rules! with_types_of {
    ($x:ident, $weight:ident, $function:ident $arguments:tt) => {
        match ($x.dtype(), $weight.dtype()) {
            (Dtype::F32, Dtype::F32) => $function::<f32, f32> $arguments,
            (Dtype::F64, Dtype::F64) => $function::<f64, f64> $arguments,
            (Dtype::BF16, Dtype::F32) => $function::<Bf16, f32> $arguments,
            (Dtype::BF16, Dtype::BF16) => $function::<Bf16, Bf16> $arguments,
            (x, weight) => Err(PyTypeError::new_err(format!(
                "x must be float32, float64 or bfloat16, and weight of its dtype, or float32 beside bfloat16, got {x} and {weight}"
            ))),
        }
    };
}

/// Writes irfft2(rfft2(x) * weight) to y, a tensor like x or x itself.
#[pyfunction]
pub(crate) fn filter_tensors(
    py: Python<'_>,
    x: &Bound<'_, PyAny>,
    weight: &Bound<'_, PyAny>,
    y: &Bound<'_, PyAny>,
    layout: &str,
    num_threads: Threads,
) -> PyResult<()> {
    let (x, weight) = (Tensor::new("x", x)?, Tensor::new("weight", weight)?);
    let y = Tensor::new("out", y)?;
    // before dtypes: what is refused for its dtype alone is converted by the caller
    y.check_apart(&[&x, &weight][usize::from(y.is(&x))..])?;
    with_types_of!(x, weight, forward(py, &x, &weight, y, layout, num_threads.0))
}

fn forward<X: TensorElement, W: TensorElement<Real = X::Real>>(
    py: Python<'_>,
    x: &Tensor<'_>,
    weight: &Tensor<'_>,
    y: Tensor<'_>,
    layout: &str,
    threads: usize,
) -> PyResult<()> {
    let pool = TorchPool::new(threads);
    if y.is(x) {
        let uses = [weight.used(false), y.used(true)];
        let images = y.view_mut::<X>(&[weight])?;
        let weight = weight.view::<W>()?;
        return enter_sized(py, &uses, images.len(), || {
            let filter = planned(layout, images.shape())?;
            with_scratch(|scratch| filter.forward_in_place(images, weight, &pool, scratch))
        });
    }
    let uses = [x.used(false), weight.used(false), y.used(true)];
    let y = y.view_mut::<X>(&[x, weight])?;
    let (x, weight) = (x.view::<X>()?, weight.view::<W>()?);
    enter_sized(py, &uses, x.len(), || {
        let filter = planned(layout, x.shape())?;
        with_scratch(|scratch| filter.forward(x, weight, y, &pool, scratch))
    })
}

/// Writes the gradients of `filter_tensors` to those of two tensors that are not None.
#[pyfunction]
#[allow(clippy::too_many_arguments)] // Python passes them one by one
pub(crate) fn filter_tensors_backward(
    py: Python<'_>,
    grad: &Bound<'_, PyAny>,
    x: &Bound<'_, PyAny>,
    weight: &Bound<'_, PyAny>,
    grad_x: Option<&Bound<'_, PyAny>>,
    grad_weight: Option<&Bound<'_, PyAny>>,
    layout: &str,
    num_threads: Threads,
) -> PyResult<()> {
    let inputs = [Tensor::new("grad", grad)?, Tensor::new("x", x)?, Tensor::new("weight", weight)?];
    let grad_x = grad_x.map(|g| Tensor::new("grad_x", g)).transpose()?;
    let grad_weight = grad_weight.map(|g| Tensor::new("grad_weight", g)).transpose()?;
    let [_, x, weight] = &inputs;
    with_types_of!(x, weight, backward(py, &inputs, grad_x, grad_weight, layout, num_threads.0))
}

fn backward<X: TensorElement, W: TensorElement<Real = X::Real>>(
    py: Python<'_>,
    inputs: &[Tensor<'_>; 3],
    grad_x: Option<Tensor<'_>>,
    grad_weight: Option<Tensor<'_>>,
    layout: &str,
    threads: usize,
) -> PyResult<()> {
    let [grad, x, weight] = inputs;
    let others: Vec<_> = inputs.iter().chain(&grad_weight).collect();
    let reads = inputs.iter().map(|tensor| tensor.used(false));
    let writes = grad_x.iter().chain(&grad_weight).map(|tensor| tensor.used(true));
    let uses: Vec<_> = reads.chain(writes).collect();
    let grad_x = grad_x.map(|g| g.view_mut(&others)).transpose()?;
    let grad_weight = grad_weight.map(|g| g.view_mut(&[grad, x, weight])).transpose()?;
    let gradients = Gradients { x: grad_x, weight: grad_weight };
    let (grad, x, weight) = (grad.view::<X>()?, x.view::<X>()?, weight.view::<W>()?);
    enter_sized(py, &uses, x.len(), || {
        let filter = planned(layout, x.shape())?;
        let pool = TorchPool::new(threads);
        with_scratch(|scratch| filter.backward(grad, x, weight, gradients, &pool, scratch))
    })
}

/// The plan for the images of an array.
fn planned<T: Planned>(layout: &str, x: &[usize]) -> Result<SpectralFilter<T>, Error> {
    SpectralFilter::planned(Shape::of_images(layout.parse()?, x)?)
}

/// Runs `compute` with a scratch of the process.
fn with_scratch<R>(compute: impl FnOnce(&mut Scratch) -> R) -> R {
    SCRATCHES.lend(compute)
}

/// The names of the instruction sets that this machine has, slowest first.
#[pyfunction]
pub(crate) fn isas() -> Vec<&'static str> {
    Isa::available().into_iter().map(Isa::name).collect()
}

/// The instruction set that the filters use: "scalar", "avx2", "avx512" or "neon".
#[pyfunction]
pub(crate) fn isa(py: Python<'_>) -> PyResult<&'static str> {
    enter(py, &[], || Ok(Isa::current()?.name()))
}
