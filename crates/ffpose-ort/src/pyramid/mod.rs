//! The operator `SamplePyramid`.

mod sampling;
#[cfg(test)]
mod tests;

use std::ffi::CStr;

use self::sampling::{LEVELS, sample_pyramid};
use crate::border::{Context, Element, ElementType, Failure, Info, Kernel};

/// Inputs before the pyramid's levels.
const BEFORE: usize = 3;

/// Images of virtual cameras, sampled from pyramids.
pub(crate) struct SamplePyramid;

impl Kernel for SamplePyramid {
    const NAME: &'static CStr = c"SamplePyramid";
    const INPUTS: &'static [ElementType] = &[f32::TYPE; BEFORE + LEVELS];
    const LIKE_FIRST: bool = false;

    fn create(_: &Info<'_>) -> Result<Self, Failure> {
        Ok(Self)
    }

    fn compute(&self, context: Context<'_>) -> Result<(), Failure> {
        let input = |index| context.input::<f32>(index);
        let (homographies, levels, plane) = (input(0)?, input(1)?, input(2)?);
        let [finest, half, quarter, eighth] = std::array::from_fn(|level| input(BEFORE + level));
        let pyramid = [finest?, half?, quarter?, eighth?];
        let [&[views, ..], &[_, channels, ..], &[_, height, width]] =
            [homographies.shape(), pyramid[0].shape(), plane.shape()]
        else {
            return Err(Failure::invalid(format!(
                "expected homographies (V, 3, 3), levels of shape (B, C, H, W) and plane (2, h, w), got {:?}, {:?} and {:?}",
                homographies.shape(),
                pyramid[0].shape(),
                plane.shape()
            )));
        };
        let (y, pool) = context.into_output(&[views, channels, height, width])?;
        Ok(sample_pyramid(homographies, levels, plane, pyramid, y, &pool)?)
    }
}
