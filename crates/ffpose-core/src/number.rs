//! The elements of images and weights, and weights as the numbers that are computed with.

use bytemuck::{cast_slice, cast_slice_mut};
use ndarray::{ArrayView3, ArrayViewMut3};

use crate::Isa;
use crate::fft::{Plan, Planned};
use crate::kernel::Kernel;
use crate::simd::{Bf16, Convert, F16, Stored};

/// An element of images and weights: `f32`, `f64`, [`Bf16`] or [`F16`]. `Real` is what is computed in.
pub trait Number: Default + Stored<Real: Planned> + 'static {
    /// The kernel of a plan, for images of this type.
    #[doc(hidden)]
    #[allow(private_interfaces)] // sealed: nobody outside can name the supertrait
    fn kernel_of(plan: &Plan<Self::Real>) -> &dyn Kernel<Self>;
}

macro_rules! numbers {
    ($($number:ty),*) => {
        $(#[allow(private_interfaces)] // as above
        impl Number for $number {
            #[inline(never)] // or each crate that calls it would compile the kernels
            fn kernel_of(plan: &Plan<Self::Real>) -> &dyn Kernel<Self> {
                plan.kernel()
            }
        })*
    };
}

numbers!(f32, f64, Bf16, F16);

/// A weight in what is computed in; where that is something else, a copy in `wide`.
pub(crate) fn read<'a, N: Number>(
    isa: Isa,
    weight: ArrayView3<'a, N>,
    wide: &'a mut [N::Real],
) -> ArrayView3<'a, N::Real> {
    let numbers = weight.to_slice().expect("a weight has no gaps");
    let numbers = if N::HALF {
        let wide = &mut wide[..numbers.len()];
        convert(isa, numbers, wide);
        &*wide
    } else {
        cast_slice(numbers)
    };
    ArrayView3::from_shape(weight.dim(), numbers).expect("as many numbers")
}

/// Lets `compute` fill a weight, by way of `wide` where what is computed in is something else.
pub(crate) fn write<N: Number>(
    isa: Isa,
    weight: ArrayViewMut3<'_, N>,
    wide: &mut [N::Real],
    compute: impl FnOnce(ArrayViewMut3<'_, N::Real>),
) {
    let dim = weight.dim();
    let numbers = weight.into_slice().expect("a weight has no gaps");
    if !N::HALF {
        let weight = ArrayViewMut3::from_shape(dim, cast_slice_mut(numbers));
        return compute(weight.expect("as many numbers"));
    }
    let wide = &mut wide[..numbers.len()];
    compute(ArrayViewMut3::from_shape(dim, &mut *wide).expect("as many numbers"));
    convert(isa, wide, numbers);
}

fn convert<A: Stored, B: Stored<Real = A::Real>>(isa: Isa, from: &[A], to: &mut [B]) {
    if isa.has_vectors::<A::Real>() {
        isa.run(Convert(from, to));
    } else {
        to.iter_mut().zip(from).for_each(|(to, from)| *to = B::nearest_to(from.widened()));
    }
}
