//! The two element types of every array in this crate.

use std::sync::Arc;

use bytemuck::Pod;
use rustfft::FftNum;

use crate::kernel::Kernel;
use crate::simd::Element;
use crate::{Isa, Shape, spectral};

pub(crate) mod sealed {
    use super::{Arc, Isa, Kernel, Shape};

    #[allow(private_interfaces)] // sealed: nobody outside can name the trait
    pub trait Sealed: Sized {
        /// Plans the kernel for a shape. The types are named here, so that kernels are compiled with this crate, once,
        /// and not with each crate that filters.
        fn plan(isa: Isa, shape: Shape) -> Arc<dyn Kernel<Self>>;
    }
}

/// `f32` or `f64`.
pub trait Real: Element + FftNum + Pod + Into<f64> + sealed::Sealed {}

macro_rules! real {
    ($type:ty) => {
        #[allow(private_interfaces)] // as above
        impl sealed::Sealed for $type {
            fn plan(isa: Isa, shape: Shape) -> Arc<dyn Kernel<Self>> {
                spectral::plan_kernel(isa, shape)
            }
        }

        impl Real for $type {}
    };
}

real!(f32);
real!(f64);
