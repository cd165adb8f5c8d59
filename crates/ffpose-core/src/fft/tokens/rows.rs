//! Images of one row, which nothing is done to along X: all passes over one, before the next.

use std::collections::VecDeque;

use ndarray::{ArrayView2, ArrayViewMut2};

use super::blocks::Block;
use super::images::BackwardImage;
use super::passes::TokensBuffers;
use super::pointwise::GroupProduct;
use super::weight::NaturalWeight;
use super::{Tokens, lines};
use crate::parallel::Team;
use crate::simd::{Element, Stored, Tile, TileMut};

/// Images whose gradients of the weight are added up in their order, and the sum.
type Part<'a, 's, X, T> = (VecDeque<BackwardImage<'a, X>>, Option<&'s mut [T]>);

impl<T: Element> Tokens<T> {
    /// Filters images.
    pub(super) fn forward_rows<'a, X: Stored<Real = T> + 'a>(
        &self,
        images: impl Iterator<Item = (ArrayView2<'a, X>, ArrayViewMut2<'a, X>)>,
        weight: &[T],
        team: &mut Team<'_, T>,
    ) {
        team.run(images, |(x, y), scratch| {
            let TokensBuffers { block, work, .. } = self.scratch(scratch);
            self.enter_row(x, block, work);
            let product = GroupProduct::<T, false>(NaturalWeight::new(self.shape, weight));
            self.filter(&self.steps[0], block, product);
            self.leave_row(block, y, work);
        });
    }

    /// The gradients of images, part by part, each with its sum.
    pub(super) fn backward_rows<'a, X: Stored<Real = T> + 'a>(
        &self,
        parts: Vec<Part<'a, '_, X, T>>,
        weight: &[T],
        team: &mut Team<'_, T>,
    ) {
        team.run(parts.into_iter(), |(images, mut sum), scratch| {
            let TokensBuffers { block, other, work } = self.scratch(scratch);
            for BackwardImage { grad, x, grad_x } in images {
                self.enter_row(grad, block, work);
                let sum = sum.as_deref_mut().map(|sum| {
                    self.enter_row(x, other, work);
                    (&mut *other, sum)
                });
                let weight = grad_x.is_some().then_some(weight);
                self.filter_backward(&self.steps[0], block, sum, weight);
                if let Some(grad_x) = grad_x {
                    self.leave_row(block, grad_x, work);
                }
            }
        });
    }

    /// The row of an image to a block.
    fn enter_row<X: Stored<Real = T>>(
        &self,
        image: ArrayView2<'_, X>,
        block: &mut [T],
        work: &mut [T],
    ) {
        let vectors = Block { vectors: &mut *block, pitch: self.shape.pitch() };
        lines::forward(self.isa, Tile::new(image), None, vectors, work);
        self.fill(&self.steps[0], block);
    }

    /// Undoes [`enter_row`](Self::enter_row), up to a factor.
    fn leave_row<X: Stored<Real = T>>(
        &self,
        vectors: &mut [T],
        image: ArrayViewMut2<'_, X>,
        work: &mut [T],
    ) {
        let block = Block { vectors, pitch: self.shape.pitch() };
        lines::inverse(self.isa, block, TileMut::new(image), work, false);
    }
}
