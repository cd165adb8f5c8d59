//! The operator `SpectralFilter`, for each combination of element types.

use std::ffi::CStr;
use std::marker::PhantomData;
use std::sync::{Arc, Mutex, PoisonError};

use ffpose_core::tuning::SCRATCH_KEPT;
use ffpose_core::{Error, Isa, Layout, Prepared, Scratches, Shape, SpectralFilter};
use ndarray::ArrayViewD;

use crate::border::{Context, Element, ElementType, Failure, Info, Kernel, Sizes};

/// What runs worked in, kept for the next ones.
static SCRATCHES: Scratches = Scratches::new(SCRATCH_KEPT);

/// A weight in kernel order, and the shape of the images that it is for.
type PreparedFor<T> = (Shape, Arc<Prepared<T>>);

/// `y = irfft2(rfft2(x) · weight)`, of elements `X` with a weight of elements `W`.
pub(crate) struct Filter<X: Element, W> {
    layout: Layout,
    /// Whether every run has the same weight.
    is_constant: bool,
    /// For images of the last run's shape; a model has one.
    prepared: Mutex<Option<PreparedFor<X::Real>>>,
    elements: PhantomData<fn(W)>,
}

impl<X: Element, W: Element<Real = X::Real>> Kernel for Filter<X, W> {
    const NAME: &'static CStr = c"SpectralFilter";
    const INPUTS: &'static [ElementType] = &[X::TYPE, W::TYPE];
    const LIKE_FIRST: bool = true;

    fn create(info: &Info<'_>) -> Result<Self, Failure> {
        let layout = info.string(c"layout").map_err(|failure| {
            failure.at("expected the attribute layout, \"tokens\" or \"grid\"")
        })?;
        let layout = layout.parse()?;
        Isa::current()?;
        check_sizes(layout, info.sizes(0)?.as_ref(), info.sizes(1)?.as_ref())?;
        let is_constant = info.is_constant(1)?;
        Ok(Self { layout, is_constant, prepared: Mutex::default(), elements: PhantomData })
    }

    fn compute(&self, context: Context<'_>) -> Result<(), Failure> {
        let (x, weight) = (context.input::<X>(0)?, context.input::<W>(1)?);
        let shape = Shape::of_images(self.layout, x.shape())?;
        if self.is_constant {
            let prepared = self.prepared(shape, weight)?;
            let (y, pool) = context.into_output(x.shape())?;
            SCRATCHES.lend(|scratch| prepared.forward(x, y, &pool, scratch))?;
        } else {
            let filter = SpectralFilter::planned(shape)?;
            let (y, pool) = context.into_output(x.shape())?;
            SCRATCHES.lend(|scratch| filter.forward(x, weight, y, &pool, scratch))?;
        }
        Ok(())
    }
}

impl<X: Element, W: Element<Real = X::Real>> Filter<X, W> {
    /// The constant weight in kernel order, for images of this shape.
    fn prepared(
        &self,
        shape: Shape,
        weight: ArrayViewD<'_, W>,
    ) -> Result<Arc<Prepared<X::Real>>, Error> {
        let mut kept = self.prepared.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((of, prepared)) = &*kept
            && *of == shape
        {
            return Ok(prepared.clone());
        }
        let prepared = Arc::new(SpectralFilter::planned(shape)?.prepare(weight)?);
        *kept = Some((shape, prepared.clone()));
        Ok(prepared)
    }
}

/// Checks what the graph knows of the inputs' shapes; the rest shows in a run.
fn check_sizes(layout: Layout, x: Option<&Sizes>, weight: Option<&Sizes>) -> Result<(), Failure> {
    let (image, bins) = match layout {
        Layout::Tokens => ("(..., X, Y)", "(X, Y/2+1, 2)"),
        Layout::Grid => ("(..., H, W, C)", "(H, W/2+1, C, 2)"),
    };
    let wrong = |name, expected: &str, got| {
        Err(Failure::invalid(format!("{name} must have shape {expected}, got {got}")))
    };
    let axes = if layout == Layout::Tokens { 2 } else { 3 };
    let any = vec![None; axes];
    let sizes = match x {
        Some(x) if x.0.len() < axes => return wrong("x", image, x),
        Some(x) => &x.0[x.0.len() - axes..],
        None => &any,
    };
    let Some(weight) = weight else { return Ok(()) };
    let half = sizes[1].map(|columns| columns / 2 + 1);
    let expected: Vec<_> = [&[sizes[0], half], &sizes[2..], &[Some(2)]].concat();
    let fits = |(got, expected): (&Option<usize>, &Option<usize>)| {
        got.is_none() || expected.is_none() || got == expected
    };
    if weight.0.len() == expected.len() && weight.0.iter().zip(&expected).all(fits) {
        return Ok(());
    }
    let expected = Sizes(expected);
    wrong("weight", &format!("{bins} = {expected}"), weight)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(layout: &str, x: &[i64], weight: &[i64]) -> Result<(), Failure> {
        let sizes = |s: &[i64]| Sizes(s.iter().map(|&size| usize::try_from(size).ok()).collect());
        check_sizes(layout.parse().unwrap(), Some(&sizes(x)), Some(&sizes(weight)))
    }

    #[test]
    fn shapes_that_may_fit_pass() {
        for (layout, x, weight) in [
            ("tokens", &[-1, 6, 16][..], &[6, 9, 2][..]),
            ("tokens", &[6, 17], &[6, 9, 2]),
            ("tokens", &[-1, -1], &[6, 9, 2]),
            ("tokens", &[3, 6, 16], &[-1, -1, -1]),
            ("grid", &[-1, 5, 4, 3], &[5, 3, 3, 2]),
            ("grid", &[5, -1, -1], &[5, 3, 3, 2]),
        ] {
            assert_eq!(check(layout, x, weight), Ok(()));
        }
        for layout in [Layout::Tokens, Layout::Grid] {
            assert_eq!(check_sizes(layout, None, None), Ok(()));
        }
    }

    #[test]
    fn shapes_that_never_fit_are_told() {
        for (layout, x, weight, message) in [
            ("tokens", &[-1][..], &[6, 9, 2][..], "x must have shape (..., X, Y), got (?)"),
            (
                "tokens",
                &[-1, 6, 18],
                &[6, 9, 2],
                "weight must have shape (X, Y/2+1, 2) = (6, 10, 2), got (6, 9, 2)",
            ),
            (
                "grid",
                &[5, 4, 3],
                &[5, 3, 2],
                "weight must have shape (H, W/2+1, C, 2) = (5, 3, 3, 2), got (5, 3, 2)",
            ),
            (
                "grid",
                &[5, -1, 3],
                &[5, -1, 4, 2],
                "weight must have shape (H, W/2+1, C, 2) = (5, ?, 3, 2), got (5, ?, 4, 2)",
            ),
        ] {
            assert_eq!(check(layout, x, weight), Err(Failure::invalid(message.into())));
        }
        let three_parts = Sizes(vec![Some(6), Some(9), Some(3)]);
        assert!(check_sizes(Layout::Tokens, None, Some(&three_parts)).is_err());
    }
}
