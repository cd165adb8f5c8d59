//! A weight in kernel order, for as many calls as it stays the same.

use ndarray::{ArrayViewD, ArrayViewMutD};

use super::batch::{Batch, Weight};
use super::{SpectralFilter, widened_len};
use crate::fft::Planned;
use crate::kernel::Factor;
use crate::number::{self, Number};
use crate::parallel::{Pool, StdThreads};
use crate::scratch::Scratch;
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
        let (kernel, granule, pool) =
            (W::kernel_of(plan), T::kernel(plan).narrowest_tile(), StdThreads(1));
        let packing = kernel.packing();
        let len = packing.map_or(weight.len(), |packing| packing.offset(granule, self.shape.lanes));
        let mut prepared = Aligned::new(len)?;
        let batch = Batch::new(self.shape, kernel, granule, (1, false), &pool, self.tuning);
        let mut scratch = Scratch::default();
        let (mut workers, wide) =
            scratch.lend(&pool, batch.needs(widened_len::<W>(weight.len())))?;
        let (weight, numbers) = (number::read(self.isa, weight, wide), prepared.numbers_mut());
        match packing {
            Some(packing) => batch.pack(packing, (weight, Factor::Weight), numbers, &mut workers),
            None => numbers.iter_mut().zip(weight).for_each(|(to, from)| *to = *from),
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
