//! A weight in kernel order, for as many calls as it stays the same.

use ndarray::{ArrayViewD, ArrayViewMutD};

use super::batch::{Batch, Weight};
use super::tiling::Tiling;
use super::{SpectralFilter, widened_len};
use crate::fft::Planned;
use crate::kernel::Factor;
use crate::number::Number;
use crate::parallel::{Pool, StdThreads};
use crate::scratch::{Needs, Scratch};
use crate::simd::Aligned;
use crate::{Error, Real};

/// A filter with its weight, which no call brings to kernel order again.
pub struct Prepared<T: Real> {
    filter: SpectralFilter<T>,
    /// As the kernel reads it.
    weight: Aligned<T>,
}

impl<T: Planned> SpectralFilter<T> {
    /// This filter with `weight`, which is copied.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Strides`] or [`Error::Memory`].
    pub fn prepare<W: Number<Real = T>>(
        &self,
        weight: ArrayViewD<'_, W>,
    ) -> Result<Prepared<T>, Error> {
        let weight = self.shape.bins("weight", weight)?;
        let filter = self.clone();
        let Some(plan) = self.plan.as_deref() else {
            return Ok(Prepared { filter, weight: Aligned::new(0)? });
        };
        let (kernel, packing) = (T::kernel(plan), T::kernel(plan).packing());
        let granule = kernel.narrowest_tile();
        let len = packing.map_or(weight.len(), |packing| packing.offset(granule, self.shape.lanes));
        let mut prepared = Aligned::new(len)?;
        let shared = widened_len::<W>(weight.len());
        let needs = Needs { workers: 1, members: 1, kernel: kernel.scratch_len(), shared };
        let mut scratch = Scratch::default();
        let (mut workers, wide) = scratch.lend(&StdThreads(1), needs)?;
        let weight = W::read(self.isa, weight, wide);
        let Some(packing) = packing else {
            prepared.numbers_mut().iter_mut().zip(&weight).for_each(|(to, from)| *to = *from);
            return Ok(Prepared { filter, weight: prepared });
        };
        let tiling = Tiling::new(self.shape, kernel.tile(), 1, 1);
        for tile in 0..tiling.tiles() {
            let lanes = tiling.lanes_of(tile);
            let packed = &mut prepared.numbers_mut()[packing.offset(granule, lanes.start)..];
            let packed = &mut packed[..packing.packed_len(lanes.len())];
            packing.pack(
                tiling.bins(weight, tile),
                Factor::Weight,
                packed,
                &mut workers.together(),
            );
        }
        Ok(Prepared { filter, weight: prepared })
    }
}

impl<T: Planned> Prepared<T> {
    /// Filters `x` into `y`, with the same bits as [`SpectralFilter::forward`].
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Strides`] or [`Error::Memory`]; `y` is then untouched.
    pub fn forward<X: Number<Real = T>>(
        &self,
        x: ArrayViewD<'_, X>,
        y: ArrayViewMutD<'_, X>,
        pool: &dyn Pool,
        scratch: &mut Scratch,
    ) -> Result<(), Error> {
        let (filter, images) = (&self.filter, self.filter.images(x, y)?);
        let count = images.0.dim().0;
        let Some(plan) = filter.plan.as_deref().filter(|_| count > 0) else {
            return Ok(());
        };
        let granule = T::kernel(plan).narrowest_tile();
        let kernel = X::kernel_of(plan);
        let batch = Batch::new(filter.shape, kernel, granule, (count, false), pool, filter.tuning);
        let (mut workers, _) = scratch.lend(pool, batch.needs(0))?;
        batch.forward(
            (Some(images.0), images.1),
            Weight::Prepared(self.weight.numbers()),
            &mut [],
            &mut workers,
        );
        Ok(())
    }
}
