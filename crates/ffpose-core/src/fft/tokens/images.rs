//! An image through all passes, forward and backward.

use bytemuck::cast_slice_mut;
use ndarray::{ArrayView2, ArrayViewMut2, ArrayViewMut3};

use super::Tokens;
use super::blocks::Block;
use super::gradient::{GradientRows, UnpackGroups};
use super::passes::{StepRows, TokensBuffers};
use super::pointwise::{GroupAccumulate, GroupProduct};
use super::steps::Step;
use super::weight::NaturalWeight;
use crate::parallel::Team;
use crate::simd::{Element, Stored};
use crate::views::in_order;

/// One image of a backward pass.
pub(super) struct BackwardImage<'a, X> {
    pub(super) grad: ArrayView2<'a, X>,
    pub(super) x: ArrayView2<'a, X>,
    pub(super) grad_x: Option<ArrayViewMut2<'a, X>>,
}

impl<'a, X> BackwardImage<'a, X> {
    /// The same image, borrowed for a shorter time.
    pub(super) fn reborrow<'b>(self) -> BackwardImage<'b, X>
    where
        'a: 'b,
    {
        let Self { grad, x, grad_x } = self;
        let grad_x = grad_x.map(ArrayViewMut2::reborrow);
        BackwardImage { grad: grad.reborrow(), x: x.reborrow(), grad_x }
    }
}

/// Images whose gradients of the weight are added up in their order, or whose own are not wanted.
pub(super) struct SumPart<'a, X: Stored> {
    pub(super) images: Vec<BackwardImage<'a, X>>,
    /// Where the gradient of the weight is added up, for each step in the order of its groups.
    pub(super) sums: Option<Vec<&'a mut [X::Real]>>,
}

/// What images are filtered with, besides the plan.
pub(super) struct Context<'a, 'b, T> {
    /// Room for the spectrum of each image, used where the output is of half precision; in a backward pass, for two.
    pub(super) spectra: &'a mut [T],
    /// Whether memory is to be asked for ahead. What is near anyway would only be made to wait.
    pub(super) far: bool,
    pub(super) team: &'a mut Team<'b, T>,
}

/// The spectra of an image on its way, and its result where that is of half precision.
struct ImageSpectra<'a, X: Stored> {
    spectrum: ArrayViewMut2<'a, X::Real>,
    of_x: Option<ArrayViewMut2<'a, X::Real>>,
    result: Option<ArrayViewMut2<'a, X>>,
}

/// Rows of a spectrum, and of that of `x` if there is one.
type RowsOfImage<'a, T> = (StepRows<'a, T>, Option<StepRows<'a, T>>);

impl<'a, X: Stored> ImageSpectra<'a, X> {
    /// By way of the result, unless that is of half precision or not wanted; then through the next of `room`.
    fn new(
        result: Option<ArrayViewMut2<'a, X>>,
        of_x: Option<ArrayViewMut2<'a, X::Real>>,
        room: &mut impl Iterator<Item = ArrayViewMut2<'a, X::Real>>,
    ) -> Self {
        match result {
            Some(result) if !X::HALF => {
                let dim = result.dim();
                let numbers = cast_slice_mut(result.into_slice().expect("rows without gaps"));
                let spectrum = ArrayViewMut2::from_shape(dim, numbers).expect("as many numbers");
                Self { spectrum, of_x, result: None }
            }
            result => Self { spectrum: room.next().expect("room for each image"), of_x, result },
        }
    }
}

impl<T: Element> Tokens<T> {
    /// Filters images, pass by pass all of them.
    pub(super) fn forward_images<'a, X: Stored<Real = T> + 'a>(
        &self,
        images: Vec<(ArrayView2<'a, X>, ArrayViewMut2<'a, X>)>,
        weight: &[T],
        Context { spectra, far, team }: Context<'a, '_, T>,
    ) {
        let mut room = spectra.chunks_exact_mut(self.spectrum_len()).map(|room| self.image(room));
        let (images, mut ways): (Vec<_>, Vec<_>) = images
            .into_iter()
            .map(|(x, y)| (x, ImageSpectra::new(Some(y), None, &mut room)))
            .unzip();
        let entering = images.into_iter().zip(ways.iter_mut().map(|way| way.spectrum.view_mut()));
        self.first_pass(entering, far, team);
        let steps = ways
            .iter_mut()
            .flat_map(|way| self.steps.iter().zip(self.rows_of_steps(way.spectrum.view_mut())));
        team.run(steps, |(step, mut rows), scratch| {
            let TokensBuffers { block, work, .. } = self.scratch(scratch);
            self.gather(step, &rows, block, work);
            let product = GroupProduct::<T, false>(NaturalWeight::new(self.shape, weight));
            self.filter(step, block, product);
            self.put(block, &mut rows, work);
        });
        self.last_pass(ways.into_iter().map(|way| (way.spectrum, way.result)), far, team);
    }

    /// The gradients of images, pass by pass all of them. The images of a part are taken in turn.
    pub(super) fn backward_images<'a, X: Stored<Real = T> + 'a>(
        &self,
        parts: Vec<SumPart<'a, X>>,
        weight: &[T],
        Context { spectra, far, team }: Context<'a, '_, T>,
    ) {
        let inverse = parts.iter().flat_map(|part| &part.images).any(|i| i.grad_x.is_some());
        let mut room = spectra.chunks_exact_mut(self.spectrum_len()).map(|room| self.image(room));
        let (mut entering, mut ways, mut sums) = (Vec::new(), Vec::new(), Vec::new());
        for SumPart { images, sums: of_part } in parts {
            let mut ways_of_part = Vec::with_capacity(images.len());
            for BackwardImage { grad, x, grad_x } in images {
                let of_x = of_part.is_some().then(|| room.next().expect("room for two"));
                entering.push((grad, of_part.is_some().then_some(x)));
                ways_of_part.push(ImageSpectra::new(grad_x, of_x, &mut room));
            }
            ways.push(ways_of_part);
            sums.push(of_part);
        }
        let targets = ways.iter_mut().flatten();
        let entering = entering.into_iter().zip(targets).flat_map(|((grad, x), way)| {
            let of_x = x.zip(way.of_x.as_mut().map(|x| x.view_mut()));
            std::iter::once((grad, way.spectrum.view_mut())).chain(of_x)
        });
        self.first_pass(entering, far, team);
        let jobs = ways.iter_mut().zip(sums).flat_map(|(ways, sums)| {
            let sums = in_order(self.steps.len(), sums.map(Vec::into_iter));
            self.steps.iter().zip(self.rows_of_parts(ways)).zip(sums)
        });
        team.run(jobs, |((step, images), sum), scratch| {
            self.backward_step(step, images, inverse.then_some(weight), sum, scratch);
        });
        if inverse {
            let ways = ways.into_iter().flatten();
            self.last_pass(ways.map(|way| (way.spectrum, way.result)), far, team);
        }
    }

    /// A step of the images of a part, in their order.
    fn backward_step(
        &self,
        step: &Step,
        images: Vec<(StepRows<'_, T>, Option<StepRows<'_, T>>)>,
        weight: Option<&[T]>,
        mut sum: Option<&mut [T]>,
        scratch: &mut [T],
    ) {
        let TokensBuffers { block, other, work } = self.scratch(scratch);
        for (mut rows, x) in images {
            self.gather(step, &rows, block, work);
            let sum = x.zip(sum.as_deref_mut()).map(|(x, sum)| {
                self.gather(step, &x, other, work);
                (&mut *other, sum)
            });
            self.filter_backward(step, block, sum, weight);
            if weight.is_some() {
                self.put(block, &mut rows, work);
            }
        }
    }

    /// The spectrum of a block times the conjugate weight, if there is one. Of `sum`, the block of `x` and the sum of a gradient, the
    /// latter grows by the product with that spectrum.
    pub(super) fn filter_backward(
        &self,
        step: &Step,
        block: &mut [T],
        sum: Option<(&mut [T], &mut [T])>,
        weight: Option<&[T]>,
    ) {
        let product =
            weight.map(|weight| GroupProduct::<T, true>(NaturalWeight::new(self.shape, weight)));
        let accumulate = sum.map(|(vectors, sum)| {
            let x = Block { vectors, pitch: self.shape.pitch() };
            GroupAccumulate { x, sum }
        });
        match (accumulate, product) {
            (Some(accumulate), Some(product)) => self.filter(step, block, (accumulate, product)),
            (Some(accumulate), None) => self.filter(step, block, accumulate),
            (None, Some(product)) => self.filter(step, block, product),
            (None, None) => {}
        }
    }

    /// For each step its rows of each image.
    fn rows_of_parts<'a, X: Stored<Real = T> + 'a>(
        &self,
        ways: &'a mut [ImageSpectra<'_, X>],
    ) -> Vec<Vec<RowsOfImage<'a, T>>> {
        let mut of_steps: Vec<_> = self.steps.iter().map(|_| Vec::new()).collect();
        for ImageSpectra { spectrum, of_x, .. } in ways {
            let of_x = of_x.as_mut().map(|x| self.rows_of_steps(x.view_mut()).into_iter());
            let of_x = in_order(self.steps.len(), of_x);
            let rows = self.rows_of_steps(spectrum.view_mut()).into_iter().zip(of_x);
            of_steps.iter_mut().zip(rows).for_each(|(step, rows)| step.push(rows));
        }
        of_steps
    }

    pub(super) fn unpack(&self, step: &Step, sum: &[T], gradient: &mut GradientRows<'_, T>) {
        let shape = self.shape;
        with_run!(self.run, RUN => self.isa.run(UnpackGroups::<T, RUN> { shape, step, sum, gradient }));
    }

    /// The rows of a weight's gradient that belong to each step.
    pub(super) fn gradients_of_steps<'a>(
        &self,
        gradient: ArrayViewMut3<'a, T>,
    ) -> impl Iterator<Item = GradientRows<'a, T>> {
        let [a, b] = self.factors;
        let gradient = gradient.into_slice().expect("a whole weight");
        let mut rows: Vec<_> = (0..a).map(|_| Vec::with_capacity(b)).collect();
        for (u, row) in gradient.chunks_exact_mut(self.shape.width + 2).enumerate() {
            rows[u % a].push(row.as_chunks_mut().0);
        }
        (0..=a / 2).map(move |u1| {
            let mut block = std::mem::take(&mut rows[u1]);
            if let Some(mirror) = rows.get_mut(a - u1) {
                block.append(mirror);
            }
            block
        })
    }
}
