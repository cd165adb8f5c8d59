//! Which kernel filters the images of a shape.

use super::batched::{self, Batched};
use super::grid::Grid;
use super::planes::{Across, Along, Planes};
use super::sequence::Sequence;
use super::tokens::Tokens;
use crate::kernel::Kernel;
use crate::simd::{Isa, Stored};
use crate::tuning::{LONG_SEQUENCE, Tuning};
use crate::{Layout, Real, Shape};

/// The kernel of one shape, planned.
pub(crate) enum Plan<T: Real> {
    Across(Planes<Across<T>>),
    Along(Planes<Along<T>>),
    Batched(Batched<T>),
    Grid(Grid<T>),
    Sequence(Sequence<T>),
    Tokens(Tokens<T>),
}

impl<T: Real> Plan<T> {
    /// The plan for a shape without zeros: one channel as tokens, by codelets; several images together of few channels, or of few tokens
    /// without codelets; many channels by vectors across its lines; else, or where half of every vector would be empty, by squares of
    /// vectors; what is left goes along memory.
    pub(crate) fn new(isa: Isa, shape: Shape, tuning: &'static Tuning) -> Self {
        let Shape { layout, rows, columns, lanes } = shape;
        let along = || Self::Along(Planes::new(shape, Along::new(shape)));
        if !isa.has_vectors::<T>() {
            return along();
        }
        let together = batched::pays::<T>(isa, shape, tuning);
        let is_long = rows == 1 && columns >= LONG_SEQUENCE;
        // one channel is a plane of tokens in either layout
        if shape.channels() == 1
            && (!together || is_long)
            && let Some(tokens) = Tokens::new(isa, rows, columns, tuning)
        {
            return Self::Tokens(tokens);
        }
        if together || batched::pays_without_codelets(shape, tuning) {
            return Self::Batched(Batched::new(isa, shape, tuning));
        }
        match layout {
            Layout::Grid if 2 * lanes <= isa.lanes::<T>() => {}
            Layout::Grid if rows == 1 => return Self::Sequence(Sequence::new(isa, columns, lanes)),
            Layout::Grid => return Self::Grid(Grid::new(isa, shape, tuning)),
            Layout::Tokens => {}
        }
        // a band of rows that half the lanes hold would be half empty
        let narrow = isa.narrower().filter(|narrow| rows <= 2 * narrow.lanes::<T>());
        match Across::new(narrow.unwrap_or(isa), shape) {
            Some(across) => Self::Across(Planes::new(shape, across)),
            None => along(),
        }
    }

    /// The kernel, for images of what is computed in or of half its precision.
    pub(crate) fn kernel<X: Stored<Real = T>>(&self) -> &dyn Kernel<X> {
        match self {
            Self::Across(kernel) => kernel,
            Self::Along(kernel) => kernel,
            Self::Batched(kernel) => kernel,
            Self::Grid(kernel) => kernel,
            Self::Sequence(kernel) => kernel,
            Self::Tokens(kernel) => kernel,
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
