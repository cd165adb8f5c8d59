//! The elements of images and weights, and arrays of them as the numbers that are computed with.

use ndarray::{ArrayView3, ArrayViewMut3, Axis};

use crate::Isa;
use crate::fft::{Plan, Planned};
use crate::kernel::Kernel;
use crate::simd::{Algorithm, Bf16, F16, Stored, Vector, narrow, widen};

const LANES: Axis = Axis(2);

/// An element of images and weights: `f32`, `f64`, [`Bf16`] or [`F16`]. `Real` is what is computed in.
pub trait Number: Default + Stored<Real: Planned> + 'static {
    /// The kernel of a plan, for images of this type.
    #[doc(hidden)]
    #[allow(private_interfaces)] // sealed: nobody outside can name the supertrait
    fn kernel_of(plan: &Plan<Self::Real>) -> &dyn Kernel<Self>;

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
            #[inline(never)] // or each crate that calls it would compile the kernels
            fn kernel_of(plan: &Plan<Self>) -> &dyn Kernel<Self> {
                plan.kernel()
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
            #[inline(never)] // as above
            fn kernel_of(plan: &Plan<f32>) -> &dyn Kernel<Self> {
                plan.kernel()
            }

            fn read<'a>(
                isa: Isa,
                view: ArrayView3<'a, Self>,
                wide: &'a mut [f32],
            ) -> ArrayView3<'a, f32> {
                let dim = view.dim();
                let wide = &mut wide[..view.len()];
                if isa.has_vectors::<f32>() {
                    isa.run(Widen { from: view, to: wide });
                } else {
                    wide.iter_mut().zip(view).for_each(|(to, from)| *to = from.widened());
                }
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
                if isa.has_vectors::<f32>() {
                    isa.run(Narrow { from: wide, to: view });
                } else {
                    view.into_iter().zip(wide).for_each(|(to, from)| *to = Self::nearest_to(*from));
                }
            }
        }
    };
}

computed_in_f32!(Bf16);
computed_in_f32!(F16);

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
