//! Lets a kernel that takes no half precision filter such images: each is widened, in memory that stays in cache.

use ndarray::{ArrayView3, ArrayViewMut3, Slice};

use crate::kernel::{Backward, Kernel, Packing};
use crate::number::Number;
use crate::parallel::Team;
use crate::simd::slack;
use crate::views::BATCH;
use crate::{Isa, Real, Shape};

/// A kernel, and how it is given widened images.
pub(crate) struct Widened<'a, T: Real> {
    isa: Isa,
    kernel: &'a dyn Kernel<T>,
    /// Numbers of the largest image of a piece, rounded up to whole cache lines.
    image_len: usize,
}

impl<'a, T: Real> Widened<'a, T> {
    pub(crate) fn new(isa: Isa, shape: Shape, kernel: &'a dyn Kernel<T>) -> Self {
        let image_len = shape.points().saturating_mul(kernel.tile().min(shape.lanes));
        Self {
            isa,
            kernel,
            image_len: image_len.checked_next_multiple_of(slack::<T>()).unwrap_or(usize::MAX),
        }
    }

    fn wide_len(&self) -> usize {
        self.image_len.saturating_mul(3)
    }

    /// Room for three images, and the team that the kernel expects.
    fn share<'b>(&self, team: &'b mut Team<'_, T>) -> ([&'b mut [T]; 3], Team<'b, T>) {
        let (wide, team) = team.share(self.wide_len());
        let (first, rest) = wide.split_at_mut(self.image_len);
        let (second, third) = rest.split_at_mut(self.image_len);
        ([first, second, third], team)
    }
}

impl<X: Number> Kernel<X> for Widened<'_, X::Real> {
    fn tile(&self) -> usize {
        self.kernel.tile()
    }

    fn narrowest_tile(&self) -> usize {
        self.kernel.narrowest_tile()
    }

    fn images_together(&self) -> usize {
        self.kernel.images_together()
    }

    fn scratch_len(&self) -> usize {
        self.kernel.scratch_len().saturating_add(self.wide_len())
    }

    fn packing(&self) -> Option<&dyn Packing<X::Real>> {
        self.kernel.packing()
    }

    fn sum_len(&self, lanes: usize) -> usize {
        self.kernel.sum_len(lanes)
    }

    fn forward(
        &self,
        x: ArrayView3<'_, X>,
        weight: &[X::Real],
        mut y: ArrayViewMut3<'_, X>,
        team: &mut Team<'_, X::Real>,
    ) {
        let ([wide_x, wide_y, _], mut team) = self.share(team);
        for image in 0..x.len_of(BATCH) {
            let image = Slice::from(image..image + 1);
            let x = X::read(self.isa, x.slice_axis(BATCH, image), wide_x);
            X::write(self.isa, y.slice_axis_mut(BATCH, image), wide_y, |y| {
                self.kernel.forward(x, weight, y, &mut team);
            });
        }
    }

    fn backward(&self, pass: Backward<'_, X>, team: &mut Team<'_, X::Real>) {
        let Backward { grad, x, weight, mut grad_x, mut grad_sum, images_each } = pass;
        let ([wide_grad, wide_x, wide_grad_x], mut team) = self.share(team);
        for image in 0..grad.len_of(BATCH) {
            let image = Slice::from(image..image + 1);
            let grad = X::read(self.isa, grad.slice_axis(BATCH, image), wide_grad);
            let x = match grad_sum {
                Some(_) => X::read(self.isa, x.slice_axis(BATCH, image), wide_x),
                None => grad, // not looked at
            };
            let mut run = |grad_x: Option<ArrayViewMut3<'_, X::Real>>| {
                let grad_sum = grad_sum.as_deref_mut();
                let pass = Backward { grad, x, weight, grad_x, grad_sum, images_each };
                self.kernel.backward(pass, &mut team);
            };
            match &mut grad_x {
                Some(grad_x) => {
                    let grad_x = grad_x.slice_axis_mut(BATCH, image);
                    X::write(self.isa, grad_x, wide_grad_x, |grad_x| run(Some(grad_x)));
                }
                None => run(None),
            }
        }
    }

    fn unpack_gradient(
        &self,
        grad_sum: &[X::Real],
        grad_weight: ArrayViewMut3<'_, X::Real>,
        team: &mut Team<'_, X::Real>,
    ) {
        self.kernel.unpack_gradient(grad_sum, grad_weight, &mut self.share(team).1);
    }
}
