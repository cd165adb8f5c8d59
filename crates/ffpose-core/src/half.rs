//! Elements of images and weights of any type, as the numbers that kernels compute with.
//!
//! Kernels that read and write no half precision themselves get images of it widened one by one, in memory that stays in
//! cache.

use ndarray::{ArrayView2, ArrayView3, ArrayViewMut2, ArrayViewMut3, Axis, Slice};

use crate::kernel::{Backward, Kernel, Single, SingleBackward, TakesHalf};
use crate::parallel::Team;
use crate::simd::{Algorithm, Bf16, F16, Stored, Vector, narrow, slack, widen};
use crate::{Isa, Real, Shape};

const BATCH: Axis = Axis(0);
const LANES: Axis = Axis(2);

/// An element of images and weights: `f32`, `f64`, [`Bf16`] or [`F16`]. `Real` is what is computed in.
pub trait Number: Default + Stored<Real: Real> + 'static {
    /// `kernel` for images of this type; `widened` is the same one.
    #[doc(hidden)]
    #[allow(private_interfaces)] // sealed: nobody outside can name the supertrait
    fn kernel<'a>(
        kernel: &'a dyn Kernel<Self::Real>,
        widened: &'a Widened<'a, Self::Real>,
    ) -> &'a dyn Kernel<Self>;

    /// `view` in what is computed in; where that is something else, a copy in `wide`.
    #[doc(hidden)]
    fn read<'a>(
        isa: Isa,
        view: ArrayView3<'a, Self>,
        wide: &'a mut [Self::Real],
    ) -> ArrayView3<'a, Self::Real>;

    /// Lets `compute` fill `view`, by way of `wide` where what is computed in is something else.
    #[doc(hidden)]
    fn write(
        isa: Isa,
        view: ArrayViewMut3<'_, Self>,
        wide: &mut [Self::Real],
        compute: impl FnOnce(ArrayViewMut3<'_, Self::Real>),
    );
}

macro_rules! computed_in_itself {
    ($real:ty) => {
        #[allow(private_interfaces)] // as above
        impl Number for $real {
            fn kernel<'a>(
                kernel: &'a dyn Kernel<Self>,
                _: &'a Widened<'a, Self>,
            ) -> &'a dyn Kernel<Self> {
                kernel
            }

            fn read<'a>(
                _: Isa,
                view: ArrayView3<'a, Self>,
                _: &'a mut [Self],
            ) -> ArrayView3<'a, Self> {
                view
            }

            fn write(
                _: Isa,
                view: ArrayViewMut3<'_, Self>,
                _: &mut [Self],
                compute: impl FnOnce(ArrayViewMut3<'_, Self>),
            ) {
                compute(view);
            }
        }
    };
}

computed_in_itself!(f32);
computed_in_itself!(f64);

macro_rules! computed_in_f32 {
    ($half:ident) => {
        #[allow(private_interfaces)] // as above
        impl Number for $half {
            fn kernel<'a>(
                kernel: &'a dyn Kernel<f32>,
                widened: &'a Widened<'a, f32>,
            ) -> &'a dyn Kernel<Self> {
                match kernel.takes_half() {
                    Some(TakesHalf::Grid(grid)) => grid,
                    Some(TakesHalf::Sequence(sequence)) => sequence,
                    Some(TakesHalf::Tokens(tokens)) => tokens,
                    None => widened,
                }
            }

            fn read<'a>(
                isa: Isa,
                view: ArrayView3<'a, Self>,
                wide: &'a mut [f32],
            ) -> ArrayView3<'a, f32> {
                let dim = view.dim();
                let wide = &mut wide[..view.len()];
                isa.run(Widen { from: view, to: wide });
                ArrayView3::from_shape(dim, wide).expect("as many numbers")
            }

            fn write(
                isa: Isa,
                view: ArrayViewMut3<'_, Self>,
                wide: &mut [f32],
                compute: impl FnOnce(ArrayViewMut3<'_, f32>),
            ) {
                let wide = &mut wide[..view.len()];
                let target = ArrayViewMut3::from_shape(view.dim(), &mut *wide);
                compute(target.expect("as many numbers"));
                isa.run(Narrow { from: wide, to: view });
            }
        }
    };
}

computed_in_f32!(Bf16);
computed_in_f32!(F16);

/// A kernel for images of another type, which it gets widened.
pub(crate) struct Widened<'a, T: Real> {
    isa: Isa,
    kernel: &'a dyn Kernel<T>,
    /// Numbers with room for the largest image of a piece.
    image_len: usize,
}

impl<'a, T: Real> Widened<'a, T> {
    pub(crate) fn new(isa: Isa, shape: Shape, kernel: &'a dyn Kernel<T>) -> Self {
        let image_len = shape.points().saturating_mul(kernel.tile().min(shape.lanes));
        Self {
            isa,
            kernel,
            image_len: image_len.div_ceil(slack::<T>()).saturating_mul(slack::<T>()),
        }
    }

    fn wide_len(&self) -> usize {
        self.image_len.saturating_mul(3)
    }

    /// The kernel's way for one image; to be asked for only where it has one.
    fn one(&self) -> &'a dyn Single<T> {
        self.kernel.single().expect("a way for one image")
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

    fn packed_len(&self) -> usize {
        self.kernel.packed_len()
    }

    fn scratch_len(&self) -> usize {
        self.kernel.scratch_len().saturating_add(self.wide_len())
    }

    fn pack(
        &self,
        weight: ArrayView3<'_, X::Real>,
        packed: &mut [X::Real],
        team: &mut Team<'_, X::Real>,
    ) {
        self.kernel.pack(weight, packed, &mut self.share(team).1);
    }

    fn forward(
        &self,
        x: ArrayView3<'_, X>,
        packed: &[X::Real],
        mut y: ArrayViewMut3<'_, X>,
        team: &mut Team<'_, X::Real>,
    ) {
        let ([wide_x, wide_y, _], mut team) = self.share(team);
        for image in 0..x.len_of(BATCH) {
            let image = Slice::from(image..image + 1);
            let x = X::read(self.isa, x.slice_axis(BATCH, image), wide_x);
            X::write(self.isa, y.slice_axis_mut(BATCH, image), wide_y, |y| {
                self.kernel.forward(x, packed, y, &mut team);
            });
        }
    }

    fn backward(&self, pass: Backward<'_, X>, team: &mut Team<'_, X::Real>) {
        let Backward { grad, x, packed, mut grad_x, mut grad_sum } = pass;
        let ([wide_grad, wide_x, wide_grad_x], mut team) = self.share(team);
        for image in 0..grad.len_of(BATCH) {
            let image = Slice::from(image..image + 1);
            let grad = X::read(self.isa, grad.slice_axis(BATCH, image), wide_grad);
            let x = X::read(self.isa, x.slice_axis(BATCH, image), wide_x);
            let mut run = |grad_x: Option<ArrayViewMut3<'_, X::Real>>| {
                let grad_sum = grad_sum.as_deref_mut();
                let pass = Backward { grad, x, packed, grad_x, grad_sum };
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

    fn single(&self) -> Option<&dyn Single<X>> {
        self.kernel.single().map(|_| self as &dyn Single<X>)
    }
}

impl<X: Number> Single<X> for Widened<'_, X::Real> {
    fn narrowest_tile(&self) -> usize {
        self.one().narrowest_tile()
    }

    fn forward(
        &self,
        x: ArrayView2<'_, X>,
        weight: ArrayView3<'_, X::Real>,
        y: ArrayViewMut2<'_, X>,
        team: &mut Team<'_, X::Real>,
    ) {
        let ([wide_x, wide_y, _], mut team) = self.share(team);
        let x = X::read(self.isa, x.insert_axis(BATCH), wide_x).index_axis_move(BATCH, 0);
        X::write(self.isa, y.insert_axis(BATCH), wide_y, |y| {
            self.one().forward(x, weight, y.index_axis_move(BATCH, 0), &mut team);
        });
    }

    fn backward(&self, pass: SingleBackward<'_, X>, team: &mut Team<'_, X::Real>) {
        let SingleBackward { grad, x, weight, grad_x, grad_weight } = pass;
        let ([wide_grad, wide_x, wide_grad_x], mut team) = self.share(team);
        let grad = X::read(self.isa, grad.insert_axis(BATCH), wide_grad).index_axis_move(BATCH, 0);
        let x = X::read(self.isa, x.insert_axis(BATCH), wide_x).index_axis_move(BATCH, 0);
        let run = |grad_x: Option<ArrayViewMut3<'_, X::Real>>| {
            let grad_x = grad_x.map(|grad_x| grad_x.index_axis_move(BATCH, 0));
            let pass = SingleBackward { grad, x, weight, grad_x, grad_weight };
            self.one().backward(pass, &mut team);
        };
        match grad_x {
            Some(grad_x) => {
                X::write(self.isa, grad_x.insert_axis(BATCH), wide_grad_x, |g| run(Some(g)));
            }
            None => run(None),
        }
    }
}

struct Widen<'a, H> {
    from: ArrayView3<'a, H>,
    to: &'a mut [f32],
}

impl<H: Stored<Real = f32>> Algorithm<f32> for Widen<'_, H> {
    #[inline(always)]
    fn run<V: Vector<Element = f32>>(self) {
        let Self { from, to } = self;
        if let Some(from) = from.to_slice() {
            return widen::<V, H>(from, to);
        }
        let points = from.lanes(LANES).into_iter();
        for (from, to) in points.zip(to.chunks_exact_mut(from.len_of(LANES))) {
            widen::<V, H>(from.to_slice().expect("lanes are contiguous"), to);
        }
    }
}

struct Narrow<'a, H> {
    from: &'a [f32],
    to: ArrayViewMut3<'a, H>,
}

impl<H: Stored<Real = f32>> Algorithm<f32> for Narrow<'_, H> {
    #[inline(always)]
    fn run<V: Vector<Element = f32>>(self) {
        let Self { from, mut to } = self;
        if let Some(to) = to.as_slice_mut() {
            return narrow::<V, H>(from, to);
        }
        let lanes = to.len_of(LANES);
        for (to, from) in to.lanes_mut(LANES).into_iter().zip(from.chunks_exact(lanes)) {
            narrow::<V, H>(from, to.into_slice().expect("lanes are contiguous"));
        }
    }
}
