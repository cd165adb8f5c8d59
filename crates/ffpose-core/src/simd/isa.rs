//! The instruction sets: which the machine has, which one is used, and the way into code compiled for it.

use std::sync::OnceLock;

#[cfg(target_arch = "aarch64")]
use super::neon;
#[cfg(target_arch = "x86_64")]
use super::x86;
use super::{Algorithm, Element, scalar};
use crate::Error;

/// The environment variable that forces an instruction set.
const VARIABLE: &str = "FFPOSE_ISA";

/// An instruction set that this machine has: a value of this type is the proof.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Isa(Kind);

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Kind {
    Scalar,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "x86_64")]
    Avx512,
    #[cfg(target_arch = "aarch64")]
    Neon,
}

impl Isa {
    /// What this machine has, slowest first.
    #[must_use]
    pub fn available() -> Vec<Self> {
        #[allow(unused_mut)] // other architectures have the scalar path alone
        let mut found = vec![Self(Kind::Scalar)];
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx2")
                && is_x86_feature_detected!("fma")
                && is_x86_feature_detected!("f16c")
            {
                found.push(Self(Kind::Avx2));
            }
            if is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512bw")
                && is_x86_feature_detected!("avx512vl")
            {
                found.push(Self(Kind::Avx512));
            }
        }
        #[cfg(target_arch = "aarch64")]
        found.push(Self(Kind::Neon)); // part of the base architecture
        found
    }

    /// The one in use: the fastest, or the one that `FFPOSE_ISA` names. Read once a process.
    ///
    /// # Errors
    /// [`Error::Isa`] if the variable names none that this machine has.
    pub fn current() -> Result<Self, Error> {
        static CURRENT: OnceLock<Result<Isa, Error>> = OnceLock::new();
        CURRENT
            .get_or_init(|| match std::env::var_os(VARIABLE) {
                Some(name) if !name.is_empty() => Self::named(&name.to_string_lossy()),
                _ => Ok(Self::available().last().copied().unwrap_or_else(Self::scalar)),
            })
            .clone()
    }

    /// The instruction set called `name`.
    ///
    /// # Errors
    /// [`Error::Isa`] if this machine has none of that name.
    pub fn named(name: &str) -> Result<Self, Error> {
        let found = Self::available().into_iter().find(|isa| isa.name() == name);
        found.ok_or_else(|| Error::Isa {
            expected: Self::available().into_iter().map(Self::name).collect::<Vec<_>>().join(", "),
            got: name.to_owned(),
        })
    }

    /// The one that every machine has.
    pub(crate) fn scalar() -> Self {
        Self(Kind::Scalar)
    }

    /// `scalar`, `avx2`, `avx512` or `neon`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self.0 {
            Kind::Scalar => "scalar",
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2 => "avx2",
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512 => "avx512",
            #[cfg(target_arch = "aarch64")]
            Kind::Neon => "neon",
        }
    }

    /// Elements of type `T` in one vector.
    #[must_use]
    pub(crate) fn lanes<T: Element>(self) -> usize {
        let bytes = match self.0 {
            Kind::Scalar => return 1,
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2 => 32,
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512 => 64,
            #[cfg(target_arch = "aarch64")]
            Kind::Neon => 16,
        };
        bytes / size_of::<T>()
    }

    /// Runs `algorithm` with the vectors of this instruction set.
    #[inline]
    pub(crate) fn run<T: Element>(self, algorithm: impl Algorithm<T>) {
        T::run(self, algorithm);
    }
}

/// Makes the caller's stack begin at a cache line: vectors that do not fit in registers are kept there, and the compiler
/// would let most of them lie across two lines.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn align_stack() {
    use std::hint::black_box;
    use std::mem::MaybeUninit;

    #[repr(align(64))]
    struct Line([MaybeUninit<u8>; 64]);
    black_box(&Line([MaybeUninit::uninit(); 64]).0);
}

/// One entry for each instruction set and algorithm: below it everything is inlined and compiled with its features.
macro_rules! element {
    ($element:ty, $avx2:ident, $avx512:ident, $neon:ident) => {
        #[allow(private_bounds, private_interfaces)] // algorithms are this crate's alone, the trait is sealed
        impl Element for $element {
            #[inline(always)]
            #[allow(clippy::cast_possible_truncation)] // the rounding is what is asked for
            fn nearest(value: f64) -> Self {
                value as Self
            }

            fn run<A: Algorithm<Self>>(isa: Isa, algorithm: A) {
                #[cfg(target_arch = "x86_64")]
                #[target_feature(enable = "avx2,fma,f16c")]
                fn avx2<A: Algorithm<$element>>(algorithm: A) {
                    align_stack();
                    algorithm.run::<x86::$avx2>();
                }
                #[cfg(target_arch = "x86_64")]
                #[target_feature(enable = "avx512f,avx512dq,avx512bw,avx512vl")]
                fn avx512<A: Algorithm<$element>>(algorithm: A) {
                    align_stack();
                    algorithm.run::<x86::$avx512>();
                }
                match isa.0 {
                    Kind::Scalar => algorithm.run::<scalar::Scalar<Self>>(),
                    // SAFETY: an `Isa` of this kind exists only where `available` found these features.
                    #[cfg(target_arch = "x86_64")]
                    Kind::Avx2 => unsafe { avx2(algorithm) },
                    // SAFETY: an `Isa` of this kind exists only where `available` found these features.
                    #[cfg(target_arch = "x86_64")]
                    Kind::Avx512 => unsafe { avx512(algorithm) },
                    #[cfg(target_arch = "aarch64")]
                    Kind::Neon => algorithm.run::<neon::$neon>(),
                }
            }
        }
    };
}

element!(f32, F32x8, F32x16, F32x4);
element!(f64, F64x4, F64x8, F64x2);
