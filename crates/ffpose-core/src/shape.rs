//! Layouts, and the shapes that belong together.

use std::str::FromStr;

use ndarray::{ArrayBase, Ix3, IxDyn, RawData};

use crate::Error;
use crate::error::tuple;

/// Which axes of an image are transformed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Layout {
    /// `x (..., X, Y)`, transformed over X and Y; `weight (X, Y/2+1, 2)`.
    Tokens,
    /// `x (..., H, W, C)`, transformed over H and W for each channel; `weight (H, W/2+1, C, 2)`.
    Grid,
}

impl FromStr for Layout {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self, Error> {
        match name {
            "tokens" => Ok(Self::Tokens),
            "grid" => Ok(Self::Grid),
            _ => Err(Error::Layout { got: name.to_owned() }),
        }
    }
}

/// The shape of one image, which is all that a filter's plan depends on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Shape {
    /// The axes that are transformed.
    pub layout: Layout,
    /// Length of the first transformed axis: X, or H.
    pub rows: usize,
    /// Length of the second transformed axis: Y, or W.
    pub columns: usize,
    /// Length of the last axis of an image: Y (again), or C.
    pub lanes: usize,
}

impl Shape {
    /// The shape of the images in `x`, an array with any number of leading axes.
    ///
    /// # Errors
    /// [`Error::Shape`] if `x` has too few axes; [`Error::TooLarge`] if its spectrum could not be addressed.
    pub fn of_images(layout: Layout, x: &[usize]) -> Result<Self, Error> {
        let shape = match (layout, x) {
            (Layout::Tokens, &[.., rows, columns]) => {
                Self { layout, rows, columns, lanes: columns }
            }
            (Layout::Grid, &[.., rows, columns, lanes]) => Self { layout, rows, columns, lanes },
            (Layout::Tokens, _) => return Err(Error::shape("x", "(..., X, Y)", x)),
            (Layout::Grid, _) => return Err(Error::shape("x", "(..., H, W, C)", x)),
        };
        shape.check_size()?;
        Ok(shape)
    }

    /// The shape of the weight that filters images of this shape.
    #[must_use]
    pub fn weight(&self) -> Vec<usize> {
        match self.layout {
            Layout::Tokens => vec![self.rows, self.half(), 2],
            Layout::Grid => vec![self.rows, self.half(), self.lanes, 2],
        }
    }

    /// Columns of the half spectrum.
    #[must_use]
    pub fn half(&self) -> usize {
        self.columns / 2 + 1
    }

    /// Planes of an image: tokens are one.
    pub(crate) fn channels(&self) -> usize {
        if self.layout == Layout::Grid { self.lanes } else { 1 }
    }

    /// Numbers in the half spectrum of a plane.
    pub(crate) fn bins_len(&self) -> usize {
        self.rows.saturating_mul(self.half())
    }

    /// Whether an image has no elements.
    pub(crate) fn is_empty(&self) -> bool {
        self.rows == 0 || self.columns == 0 || self.lanes == 0
    }

    /// `array` as `(batch, points, lanes)`; `expected` is the shape it shares with others of the call.
    pub(crate) fn images<S: RawData>(
        &self,
        name: &'static str,
        expected: &[usize],
        array: ArrayBase<S, IxDyn>,
    ) -> Result<ArrayBase<S, Ix3>, Error> {
        let batch = self.batch(name, expected, array.shape())?;
        contiguous(name, array, (batch, self.points(), self.lanes))
    }

    /// `weight` as `(bins, lanes, 2)`, with the lanes of a tile on an axis of their own.
    pub(crate) fn bins<S: RawData>(
        &self,
        name: &'static str,
        weight: ArrayBase<S, IxDyn>,
    ) -> Result<ArrayBase<S, Ix3>, Error> {
        let dim = self.bins_dim(name, weight.shape())?;
        contiguous(name, weight, dim)
    }

    /// Positions of one image: rows of its matrix form `(points, lanes)`.
    pub(crate) fn points(&self) -> usize {
        match self.layout {
            Layout::Tokens => self.rows,
            Layout::Grid => self.rows * self.columns,
        }
    }

    /// Images in an array of shape `got`.
    fn batch(&self, name: &'static str, expected: &[usize], got: &[usize]) -> Result<usize, Error> {
        let image: &[usize] = match self.layout {
            Layout::Tokens => &[self.rows, self.columns],
            Layout::Grid => &[self.rows, self.columns, self.lanes],
        };
        if got != expected {
            return Err(Error::shape(name, &tuple(expected), got));
        }
        let leading = got.strip_suffix(image);
        let expected = || tuple(image).replacen('(', "(..., ", 1);
        Ok(leading.ok_or_else(|| Error::shape(name, &expected(), got))?.iter().product())
    }

    fn bins_dim(&self, name: &'static str, got: &[usize]) -> Result<(usize, usize, usize), Error> {
        let (rows, half, lanes) = (self.rows, self.half(), self.lanes);
        match self.layout {
            Layout::Tokens if got == [rows, half, 2] => Ok((rows, half, 2)),
            Layout::Grid if got == [rows, half, lanes, 2] => Ok((rows * half, lanes, 2)),
            _ => Err(Error::shape(name, &tuple(&self.weight()), got)),
        }
    }

    /// A spectrum with scratch takes a few times the plane; the bound leaves room for it.
    fn check_size(&self) -> Result<(), Error> {
        const MOST: usize = isize::MAX as usize / 256;
        let (rows, columns, lanes) = (self.rows, self.columns, self.channels());
        [columns / 2 + 1, lanes.max(1), 2]
            .iter()
            .try_fold(rows.max(1), |size, n| size.checked_mul(*n))
            .filter(|size| *size <= MOST)
            .map(|_| ())
            .ok_or(Error::TooLarge { rows, columns, lanes })
    }
}

/// `array` in three axes, without a copy.
fn contiguous<S: RawData>(
    name: &'static str,
    array: ArrayBase<S, IxDyn>,
    dim: (usize, usize, usize),
) -> Result<ArrayBase<S, Ix3>, Error> {
    if !array.is_standard_layout() {
        return Err(Error::Strides { name, got: array.strides().to_vec() });
    }
    Ok(array.into_shape_with_order(dim).expect("as many elements, in order"))
}
