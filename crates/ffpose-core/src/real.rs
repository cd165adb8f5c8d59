//! The two element types of every array in this crate.

use bytemuck::Pod;
use rustfft::FftNum;

use crate::fft::Plan;
use crate::kernel::Kernel;
use crate::simd::Element;
use crate::tuning::Tuning;
use crate::{Isa, Shape};

pub(crate) mod sealed {
    use super::{Isa, Kernel, Plan, Real, Shape, Tuning};

    /// The types are named here, so that kernels are compiled with this crate, once, and not with each crate that filters.
    #[allow(private_interfaces)] // sealed: nobody outside can name the trait
    pub trait Sealed: Sized {
        /// Plans the kernel for a shape.
        fn plan(isa: Isa, shape: Shape, tuning: &'static Tuning) -> Plan<Self>
        where
            Self: Real;

        /// The kernel of a plan.
        fn kernel(plan: &Plan<Self>) -> &dyn Kernel<Self>
        where
            Self: Real;
    }
}

/// `f32` or `f64`.
pub trait Real: Element + FftNum + Pod + Into<f64> + sealed::Sealed {}

macro_rules! real {
    ($type:ty) => {
        #[allow(private_interfaces)] // as above
        impl sealed::Sealed for $type {
            #[inline(never)]
            fn plan(isa: Isa, shape: Shape, tuning: &'static Tuning) -> Plan<Self> {
                Plan::new(isa, shape, tuning)
            }

            #[inline(never)]
            fn kernel(plan: &Plan<Self>) -> &dyn Kernel<Self> {
                plan.kernel()
            }
        }

        impl Real for $type {}
    };
}

real!(f32);
real!(f64);
