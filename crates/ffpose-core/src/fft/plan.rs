//! Which kernel filters the images of a shape.

use super::along::AlongLines;
use super::batched::{self, Batched};
use super::grid::Grid;
use super::planes::Planes;
use super::polyphase::{self, Polyphase};
use super::sequence::Sequence;
use super::tokens::Tokens;
use crate::kernel::Kernel;
use crate::simd::{Isa, Stored};
use crate::tuning::Tuning;
use crate::{Layout, Real, Shape};

/// The kernel of one shape, planned.
pub(crate) enum Plan<T: Real> {
    AlongLines(AlongLines<T>),
    Batched(Batched<T>),
    Grid(Grid<T>),
    Planes(Planes<T>),
    Polyphase(Polyphase<T>),
    Sequence(Sequence<T>),
    Tokens(Tokens<T>),
}

impl<T: Real> Plan<T> {
    /// The plan for a shape without zeros: vectors across its lines, unless these would leave half of every vector empty. Then
    /// across the phases of a sequence, or across several images; or, measured with AVX2, rustfft along the lines is two to six
    /// times faster, and else two to fourteen times slower.
    pub(crate) fn new(isa: Isa, shape: Shape, tuning: &'static Tuning) -> Self {
        let Shape { layout, rows, columns, lanes } = shape;
        let lines = match layout {
            Layout::Tokens => rows,
            Layout::Grid => lanes,
        };
        if let Some((isa, phases)) = polyphase::chosen::<T>(isa, shape, tuning) {
            return Self::Polyphase(Polyphase::new(isa, shape, phases));
        }
        if batched::pays::<T>(isa, shape, tuning) {
            return Self::Batched(Batched::new(isa, shape, tuning));
        }
        if 2 * lines <= isa.lanes::<T>() {
            return Self::AlongLines(AlongLines::new(shape));
        }
        match layout {
            Layout::Grid if rows == 1 => Self::Sequence(Sequence::new(isa, columns)),
            Layout::Grid => Self::Grid(Grid::new(isa, shape, tuning)),
            Layout::Tokens => match Tokens::new(isa, rows, columns, tuning) {
                Some(tokens) => Self::Tokens(tokens),
                None => Self::Planes(Planes::new(isa, rows, columns)),
            },
        }
    }

    /// The kernel for images of what is computed in.
    pub(crate) fn kernel(&self) -> &dyn Kernel<T> {
        match self {
            Self::AlongLines(kernel) => kernel,
            Self::Batched(kernel) => kernel,
            Self::Grid(kernel) => kernel,
            Self::Planes(kernel) => kernel,
            Self::Polyphase(kernel) => kernel,
            Self::Sequence(kernel) => kernel,
            Self::Tokens(kernel) => kernel,
        }
    }

    /// The kernel for images of half precision, if it takes any.
    pub(crate) fn kernel_of_half<X: Stored<Real = T>>(&self) -> Option<&dyn Kernel<X>> {
        match self {
            Self::AlongLines(_) | Self::Planes(_) => None,
            Self::Batched(kernel) => Some(kernel),
            Self::Grid(kernel) => Some(kernel),
            Self::Polyphase(kernel) => Some(kernel),
            Self::Sequence(kernel) => Some(kernel),
            Self::Tokens(kernel) => Some(kernel),
        }
    }
}

/// A [`Real`] that filters are planned for.
///
/// The types are named here, so that kernels are compiled with this crate, once, and not with each crate that filters.
#[allow(private_interfaces)] // nobody outside can name the plan
pub trait Planned: Real {
    /// [`Plan::new`].
    #[doc(hidden)]
    fn plan(isa: Isa, shape: Shape, tuning: &'static Tuning) -> Plan<Self>;

    /// [`Plan::kernel`].
    #[doc(hidden)]
    fn kernel(plan: &Plan<Self>) -> &dyn Kernel<Self>;
}

macro_rules! planned {
    ($type:ty) => {
        #[allow(private_interfaces)] // as above
        impl Planned for $type {
            #[inline(never)]
            fn plan(isa: Isa, shape: Shape, tuning: &'static Tuning) -> Plan<Self> {
                Plan::new(isa, shape, tuning)
            }

            #[inline(never)]
            fn kernel(plan: &Plan<Self>) -> &dyn Kernel<Self> {
                plan.kernel()
            }
        }
    };
}

planned!(f32);
planned!(f64);
