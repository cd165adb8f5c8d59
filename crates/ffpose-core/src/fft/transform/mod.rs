//! DFTs of any length along a line of complex vectors, in place.

mod bluestein;
mod factors;
pub(crate) mod mixed_radix;
mod prime;

use self::bluestein::Bluestein;
pub(crate) use self::factors::{inverted, remainders};
use self::mixed_radix::{MixedRadix, Pass};
use crate::simd::{Element, Isa};

/// A planned DFT of one length.
pub(crate) enum Transform<T> {
    MixedRadix(MixedRadix<T>),
    Bluestein(Bluestein<T>),
}

macro_rules! delegate {
    ($(#[doc = $doc:literal])* $name:ident($($argument:ident: $type:ty),*) $(-> $result:ty)?) => {
        $(#[doc = $doc])*
        pub(crate) fn $name(&self, $($argument: $type),*) $(-> $result)? {
            match self {
                Self::MixedRadix(passes) => passes.$name($($argument),*),
                Self::Bluestein(chirp) => chirp.$name($($argument),*),
            }
        }
    };
}

impl<T: Element> Transform<T> {
    pub(crate) fn new(isa: Isa, length: usize) -> Self {
        MixedRadix::new(isa, length)
            .map_or_else(|| Self::Bluestein(Bluestein::new(isa, length)), Self::MixedRadix)
    }

    pub(crate) fn len(&self) -> usize {
        self.inputs().len()
    }

    /// The passes of a transform that is no more than that.
    pub(crate) fn passes(&self) -> &[Pass<T>] {
        match self {
            Self::MixedRadix(passes) => passes.passes(),
            Self::Bluestein(_) => &[],
        }
    }

    delegate! {
        /// The position of input `n` of the forward transform, and of output `n` of the inverse.
        inputs() -> &[usize]
    }
    delegate! {
        /// The position of frequency `k`.
        outputs() -> &[usize]
    }
    delegate! {
        /// Complex vectors of scratch that a run needs.
        work_len() -> usize
    }
    delegate! {
        /// `X[k] = Σ_n x[n] exp(-2πi k n / N)`.
        forward(line: &mut [T], work: &mut [T])
    }
    delegate! {
        /// The unnormalized inverse of `forward`.
        inverse(line: &mut [T], work: &mut [T])
    }
}
