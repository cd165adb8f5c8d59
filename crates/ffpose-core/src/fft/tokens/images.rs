//! An image through all passes, forward and backward.

use ndarray::{ArrayView2, ArrayViewMut2, ArrayViewMut3};

use super::Tokens;
use super::columns::Block;
use super::lanes::{Accumulate, Product};
use super::order::Step;
use super::passes::Parts;
use super::weight::{GradientRows, Unpack, Weight};
use crate::parallel::Team;
use crate::simd::{Element, Stored};

/// Where the gradient of the weight of a step goes.
pub(super) enum StepGradient<'a, T> {
    /// Added up in the order of the groups.
    Sum(&'a mut [T]),
    /// Written in natural order.
    Natural(GradientRows<'a, T>),
}

/// What images are filtered with, besides the plan.
pub(super) struct Means<'a, 'b, T> {
    /// Room for the spectrum of one image, used where the output is of half precision; in a backward pass, for two.
    pub(super) spectra: &'a mut [T],
    /// Whether memory is to be asked for ahead. What is near anyway would only be made to wait.
    pub(super) far: bool,
    pub(super) team: &'a mut Team<'b, T>,
}

impl<T: Element> Tokens<T> {
    pub(super) fn forward_image<X: Stored<Real = T>>(
        &self,
        x: ArrayView2<'_, X>,
        y: ArrayViewMut2<'_, X>,
        weight: &[T],
        Means { spectra: spectrum, far, team }: Means<'_, '_, T>,
    ) {
        let (mut spectrum, y) = match X::as_real(y) {
            Ok(y) => (y, None),
            Err(y) => (self.image(spectrum), Some(y)),
        };
        self.first_pass(x, spectrum.view_mut(), far, team);
        let steps = self.steps.iter().zip(self.rows_of_steps(spectrum.view_mut()));
        team.run(steps, |(step, mut rows), scratch| {
            let Parts { block, work, .. } = self.scratch(scratch);
            self.gather(step, &rows, block, work);
            self.filter(step, block, Product::<T, false>(Weight::new(self.plan, weight)));
            self.put(block, &mut rows, work);
        });
        match y {
            None => self.last_pass(spectrum, far, team),
            Some(y) => self.last_pass_to(spectrum, y, far, team),
        }
    }

    pub(super) fn backward_image<'a, X: Stored<Real = T>>(
        &self,
        [grad, x]: [ArrayView2<'_, X>; 2],
        grad_x: Option<ArrayViewMut2<'_, X>>,
        weight: &[T],
        gradients: Option<impl Iterator<Item = StepGradient<'a, T>>>,
        Means { spectra, far, team }: Means<'_, '_, T>,
    ) where
        T: 'a,
    {
        let inverse = grad_x.is_some();
        let (spectrum, other) = spectra.split_at_mut(self.spectrum_len());
        let (mut spectrum, grad_x) = match grad_x.map(X::as_real) {
            Some(Ok(grad_x)) => (grad_x, None),
            Some(Err(grad_x)) => (self.image(spectrum), Some(grad_x)),
            None => (self.image(spectrum), None),
        };
        self.first_pass(grad, spectrum.view_mut(), far, team);
        let x = gradients.is_some().then(|| {
            let mut other = self.image(other);
            self.first_pass(x, other.view_mut(), far, team);
            self.rows_of_steps(other)
        });
        let gradients = x.into_iter().flatten().zip(gradients.into_iter().flatten()).map(Some);
        let gradients_if_wanted = gradients.chain(std::iter::repeat_with(|| None));
        let steps = self.steps.iter().zip(self.rows_of_steps(spectrum.view_mut()));
        let steps = steps.zip(gradients_if_wanted);
        team.run(steps, |((step, mut rows), gradient), scratch| {
            let Parts { block, other, sum, work } = self.scratch(scratch);
            self.gather(step, &rows, block, work);
            let product = inverse.then(|| Product::<T, true>(Weight::new(self.plan, weight)));
            match gradient {
                Some((x, gradient)) => {
                    self.gather(step, &x, other, work);
                    let (sum, natural) = match gradient {
                        StepGradient::Sum(sum) => (sum, None),
                        StepGradient::Natural(rows) => {
                            let sum = &mut sum[..self.sum_len_of(step)];
                            sum.fill(T::default());
                            (sum, Some(rows))
                        }
                    };
                    let x = Block { vectors: other, pitch: self.plan.pitch() };
                    let accumulate = Accumulate { x, sum: &mut *sum };
                    match product {
                        Some(product) => self.filter(step, block, (accumulate, product)),
                        None => self.filter(step, block, accumulate),
                    }
                    if let Some(mut rows) = natural {
                        self.unpack(step, sum, &mut rows);
                    }
                }
                None => {
                    if let Some(product) = product {
                        self.filter(step, block, product);
                    }
                }
            }
            if inverse {
                self.put(block, &mut rows, work);
            }
        });
        match grad_x {
            Some(grad_x) => self.last_pass_to(spectrum, grad_x, far, team),
            None if inverse => self.last_pass(spectrum, far, team),
            None => {}
        }
    }

    pub(super) fn unpack(&self, step: &Step, sum: &[T], gradient: &mut GradientRows<'_, T>) {
        let plan = self.plan;
        with_run!(self.run, RUN => self.isa.run_tuned(Unpack::<T, RUN> { plan, step, sum, gradient }));
    }

    /// The rows of a weight's gradient that belong to each step.
    pub(super) fn gradients_of_steps<'a>(
        &self,
        gradient: ArrayViewMut3<'a, T>,
    ) -> impl Iterator<Item = GradientRows<'a, T>> {
        let [a, b] = self.factors;
        let gradient = gradient.into_slice().expect("a whole weight");
        let mut rows: Vec<_> = (0..a).map(|_| Vec::with_capacity(b)).collect();
        for (u, row) in gradient.chunks_exact_mut(self.plan.width + 2).enumerate() {
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
