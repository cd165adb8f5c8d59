//! Arrays read and written as rows of `f64`.

use ndarray::{ArrayD, ArrayViewD};

use crate::{Error, Real};

/// The rows of `array (..., N)`, in C order.
pub(crate) fn rows_of<'a, T: Real, const N: usize>(
    name: &'static str,
    array: &'a ArrayViewD<'_, T>,
) -> Result<impl ExactSizeIterator<Item = [f64; N]> + use<'a, T, N>, Error> {
    match array.shape() {
        [.., last] if *last == N => {
            Ok(array.rows().into_iter().map(|row| std::array::from_fn(|i| row[i].into())))
        }
        other => Err(Error::shape(name, &format!("(..., {N})"), other)),
    }
}

/// The rows of `array (count, N)`, all finite.
pub(crate) fn finite_rows_of<'a, T: Real, const N: usize>(
    name: &'static str,
    array: &'a ArrayViewD<'_, T>,
    count: Option<usize>,
) -> Result<impl ExactSizeIterator<Item = Result<[f64; N], Error>> + use<'a, T, N>, Error> {
    let expected = count.map_or_else(|| format!("(N, {N})"), |count| format!("({count}, {N})"));
    if array.ndim() != 2 || count.is_some_and(|count| count != array.shape()[0]) {
        return Err(Error::shape(name, &expected, array.shape()));
    }
    let rows = rows_of(name, array).map_err(|_| Error::shape(name, &expected, array.shape()))?;
    Ok(rows.enumerate().map(move |(index, row)| {
        let bad = row.into_iter().find(|value| !value.is_finite());
        bad.map_or(Ok(row), |got| Err(Error::NotFinite { name, row: index, got }))
    }))
}

/// An array `(..., N)` of rounded rows, with the leading axes of `like (..., M)`.
pub(crate) fn array_of<T: Real, const N: usize>(
    like: &[usize],
    rows: impl Iterator<Item = Result<[f64; N], Error>>,
) -> Result<ArrayD<T>, Error> {
    let leading = &like[..like.len().saturating_sub(1)];
    let mut values = Vec::with_capacity(N * leading.iter().product::<usize>());
    for row in rows {
        values.extend(row?.map(T::nearest));
    }
    let shape = [leading, &[N]].concat();
    Ok(ArrayD::from_shape_vec(shape, values).expect("one row out for each row in"))
}
