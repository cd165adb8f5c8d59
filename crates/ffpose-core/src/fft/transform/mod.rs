//! DFTs of lengths without large primes along a line of complex vectors, in place.

mod factors;
pub(crate) mod mixed_radix;
mod prime;

pub(crate) use self::factors::{has_transform, inverted};
pub(crate) use self::mixed_radix::Transform;
