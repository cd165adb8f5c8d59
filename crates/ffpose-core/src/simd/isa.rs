//! The instruction sets: which the machine has, which one is used, and the way into code compiled for it.

use std::sync::OnceLock;

#[cfg(target_arch = "aarch64")]
use super::neon;
#[cfg(target_arch = "x86_64")]
use super::x86;
use super::{Algorithm, Element, Vector};
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
        if is_x86_feature_detected!("avx2")
            && is_x86_feature_detected!("fma")
            && is_x86_feature_detected!("f16c")
        {
            if cfg!(feature = "avx2") {
                found.push(Self(Kind::Avx2));
            }
            if cfg!(feature = "avx512")
                && is_x86_feature_detected!("avx512f")
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

    /// The one in use: the fastest, or the one that `FFPOSE_ISA` names. Read once a process: by
    /// [`initialize`](crate::initialize), or here.
    ///
    /// # Errors
    /// [`Error::Isa`] if the variable names none that this machine has.
    pub fn current() -> Result<Self, Error> {
        static CURRENT: OnceLock<Result<Isa, Error>> = OnceLock::new();
        CURRENT
            .get_or_init(|| match std::env::var_os(VARIABLE) {
                Some(name) if !name.is_empty() => Self::named(&name.to_string_lossy()),
                _ => Ok(Self::available().last().copied().unwrap_or(Self(Kind::Scalar))),
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

    /// The one whose vectors have half the lanes, if the machine has it.
    pub(crate) fn narrower(self) -> Option<Self> {
        match self.0 {
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512 if cfg!(feature = "avx2") => Some(Self(Kind::Avx2)),
            _ => None,
        }
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
        T::lanes(self)
    }

    /// Whether it has vectors of `T`, of several lanes. Double precision is needed for its digits more than for its speed: it has
    /// none, and no code to compile.
    pub(crate) fn has_vectors<T: Element>(self) -> bool {
        self.lanes::<T>() > 1
    }

    /// Runs `algorithm` with the vectors of this instruction set.
    ///
    /// # Panics
    /// Unless it [has any](Self::has_vectors).
    #[inline(always)]
    pub(crate) fn run<T: Element>(self, algorithm: impl Algorithm<T>) {
        T::run(self, algorithm);
    }

    /// Runs `loops` as compiled for this instruction set.
    #[inline(always)]
    pub fn run_loops(self, loops: impl Loops) {
        if self.has_vectors::<f32>() {
            self.run(Plain(loops));
        } else {
            loops.run();
        }
    }
}

/// A computation in plain loops, of which the compiler makes vectors.
///
/// `run` and all that it calls in a loop must be `#[inline(always)]`.
pub trait Loops {
    /// Computes.
    fn run(self);
}

/// `Loops` as an algorithm that names no vectors.
struct Plain<L>(L);

impl<L: Loops> Algorithm<f32> for Plain<L> {
    #[inline(always)]
    fn run<V: Vector<Element = f32>>(self) {
        self.0.run();
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

/// The ways into an algorithm: below each everything is inlined and compiled with its features.
///
/// The compiler gives a method to the unit of its type's module. So kernels are compiled with the module of their algorithm,
/// side by side with those of others, and not one after the other with this one.
trait Entries<T: Element>: Algorithm<T> + Sized {
    /// With what every machine of the architecture has.
    #[cfg(target_arch = "aarch64")]
    #[inline(never)]
    fn baseline<V: Vector<Element = T>>(self) {
        self.run::<V>();
    }

    /// # Safety
    /// The processor has these features.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma,f16c")]
    unsafe fn avx2<V: Vector<Element = T>>(self) {
        align_stack();
        self.run::<V>();
    }

    /// # Safety
    /// The processor has these features.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f,avx512dq,avx512bw,avx512vl")]
    unsafe fn avx512<V: Vector<Element = T>>(self) {
        align_stack();
        self.run::<V>();
    }
}

impl<T: Element, A: Algorithm<T>> Entries<T> for A {}

macro_rules! nearest {
    () => {
        #[inline(always)]
        #[allow(clippy::cast_possible_truncation)] // the rounding is what is asked for
        fn nearest(value: f64) -> Self {
            value as Self
        }
    };
}

#[allow(private_bounds, private_interfaces)] // algorithms are this crate's alone, the trait is sealed
impl Element for f32 {
    nearest!();

    fn lanes(isa: Isa) -> usize {
        match isa.0 {
            Kind::Scalar => 1,
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2 => x86::F32x8::LANES,
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512 => x86::F32x16::LANES,
            #[cfg(target_arch = "aarch64")]
            Kind::Neon => neon::F32x4::LANES,
        }
    }

    fn run<A: Algorithm<Self>>(isa: Isa, algorithm: A) {
        match isa.0 {
            // SAFETY: an `Isa` of this kind exists only where `available` found these features.
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2 if cfg!(feature = "avx2") => unsafe { algorithm.avx2::<x86::F32x8>() },
            // SAFETY: an `Isa` of this kind exists only where `available` found these features.
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512 if cfg!(feature = "avx512") => unsafe {
                algorithm.avx512::<x86::F32x16>();
            },
            #[cfg(target_arch = "aarch64")]
            Kind::Neon => algorithm.baseline::<neon::F32x4>(),
            _ => unreachable!("no vectors of {}", isa.name()),
        }
    }
}

#[allow(private_bounds, private_interfaces)] // as above
impl Element for f64 {
    nearest!();

    fn lanes(_: Isa) -> usize {
        1
    }

    fn run<A: Algorithm<Self>>(_: Isa, _: A) {
        unreachable!("no vectors of double precision")
    }
}
