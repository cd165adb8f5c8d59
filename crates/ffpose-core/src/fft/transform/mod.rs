//! DFTs of any length along a line of complex vectors, in place.

mod factors;
pub(crate) mod mixed_radix;
mod prime;
mod rader;

pub(crate) use self::factors::inverted;
pub(crate) use self::mixed_radix::Transform;
