//! Transforms across vectors in both directions: squares of vectors are transposed between rows and columns.
//!
//! As many rows as two vectors have lanes go together, as real and imaginary part of one complex line for each lane of the image
//! ([`pair`](crate::fft::codelets::pair)): a *band*. Frequencies of a row that fill a vector are a *group*. The spectra of an image are
//! `(bands, lanes of the image, groups, rows of a band)` complex vectors; a packed weight has the places of each group in turn.

use ndarray::{ArrayView2, ArrayViewMut2, ArrayViewMut3, Axis, s};

use super::{Spectra, Sum};
use crate::fft::codelets::pair::{join, split};
use crate::fft::columns::{Columns, First};
use crate::fft::transform::Transform;
use crate::parallel::Team;
use crate::simd::{
    Algorithm, Complex, Element, Isa, MAX_LANES, Stored, Tile, TileMut, Vector, complex_vectors,
    complex_vectors_of, squares, transpose_square,
};
use crate::tuning::LONGEST_LINE;
use crate::views::{chunks_mut, in_order};
use crate::{Real, Shape};

/// Rows that go together, in vectors.
const HALVES: usize = 2;

pub(crate) struct Across<T> {
    isa: Isa,
    lanes: usize,
    along_rows: Transform<T>,
    along_columns: Columns<T>,
    groups: usize,
    /// For each number of a row its place in the lines of the image's lanes.
    places: Vec<usize>,
    /// For each frequency of all groups its place in a line, and that of its mirror. What fills the last group is a repetition.
    mirrored: Vec<[usize; 2]>,
}

impl<T: Real> Across<T> {
    /// The plan for a shape, unless its rows are shorter than a vector, its columns than half of one, or either are
    /// too long for a cache.
    pub(crate) fn new(isa: Isa, shape: Shape) -> Option<Self> {
        let (Shape { rows, columns: width, .. }, lanes) = (shape, shape.channels());
        let vector = isa.lanes::<T>();
        let is_long =
            rows.max(width * lanes).saturating_mul(2 * vector * size_of::<T>()) > LONGEST_LINE;
        if width * lanes < vector || 2 * rows < vector || is_long {
            return None;
        }
        let along_rows = Transform::new(isa, width);
        let groups = shape.half().div_ceil(vector);
        let place = |number| number % lanes * width + along_rows.inputs()[number / lanes];
        let outputs = along_rows.outputs();
        let mirrored = |v: usize| {
            let v = v.min(width / 2);
            [outputs[v], outputs[(width - v) % width]]
        };
        Some(Self {
            isa,
            lanes,
            groups,
            places: (0..width * lanes).map(place).collect(),
            mirrored: (0..groups * vector).map(mirrored).collect(),
            along_rows,
            along_columns: Columns::new(isa, rows, 1, First::Complex),
        })
    }

    /// Numbers of complex vectors.
    fn len_of(&self, vectors: usize) -> usize {
        2 * self.isa.lanes::<T>() * vectors
    }

    /// Groups of all lanes.
    fn columns_len(&self) -> usize {
        self.lanes * self.groups
    }

    /// Rows of a band.
    fn rows_each(&self) -> usize {
        HALVES * self.isa.lanes::<T>()
    }

    fn rows(&self) -> usize {
        self.along_columns.transform().len()
    }

    /// Bands of an image.
    fn bands(&self) -> usize {
        self.rows().div_ceil(self.rows_each())
    }

    /// Numbers of the spectra of a band.
    fn band_len(&self) -> usize {
        self.len_of(self.columns_len() * self.rows_each())
    }

    /// All columns of spectra, `(bands, numbers)`.
    fn columns_of<'a>(&self, spectra: &'a mut [T]) -> impl Iterator<Item = ArrayViewMut2<'a, T>> {
        let dim = (self.bands(), self.columns_len(), self.len_of(self.rows_each()));
        let spectra = ArrayViewMut3::from_shape(dim, spectra).expect("the spectra of an image");
        chunks_mut(spectra, Axis(1), 1).map(|column| column.index_axis_move(Axis(1), 0))
    }

    /// Sets the imaginary parts of DC and Nyquist to zero in a column of groups.
    fn make_real(&self, index: usize, column: &mut ArrayViewMut2<'_, T>) {
        let (vector, width) = (self.isa.lanes::<T>(), self.along_rows.len());
        let first = index % self.groups * vector;
        for v in [0, width / 2].into_iter().filter(|v| (2 * v).is_multiple_of(width)) {
            if (first..first + vector).contains(&v) {
                column.slice_mut(s![.., vector + v - first..;2 * vector]).fill(T::default());
            }
        }
    }

    /// The lines of some rows, with what their transform needs.
    fn lines<'a>(&self, scratch: &'a mut [T]) -> (&'a mut [T], &'a mut [T]) {
        scratch.split_at_mut(self.len_of(self.lanes * self.along_rows.len()))
    }

    /// Where each column of groups begins in a row of a weight of `len` numbers; they are as far apart as there are lanes.
    fn firsts(&self, len: usize) -> impl Iterator<Item = usize> {
        let each = self.isa.lanes::<T>() * self.lanes;
        (0..self.lanes).flat_map(move |lane| (lane..len).step_by(each))
    }

    /// Where a packed weight has frequency `u` of a column of groups.
    fn place(&self, u: usize, column: usize) -> usize {
        self.len_of(column * self.rows() + self.along_columns.transform().outputs()[u])
    }

    fn run_rows<const INVERSE: bool>(&self, lines: &mut [T], work: &mut [T]) {
        for line in lines.chunks_exact_mut(self.len_of(self.along_rows.len())) {
            if INVERSE {
                self.along_rows.inverse(line, work);
            } else {
                self.along_rows.forward(line, work);
            }
        }
    }
}

impl<T: Real> Spectra<T> for Across<T> {
    fn numbers(&self) -> usize {
        self.bands() * self.band_len()
    }

    fn scratch_len(&self) -> usize {
        let (rows, columns) = (&self.along_rows, &self.along_columns);
        let of_rows = self.len_of(self.lanes * rows.len() + rows.work_len());
        of_rows.max(2 * columns.len() + columns.work_len())
    }

    fn gain(&self) -> f64 {
        2.0
    }

    fn pack(&self, weight: &[[T; 2]], norm: [T; 2], packed: &mut [T], team: &mut Team<'_, T>) {
        let row_len = weight.len() / self.rows();
        let columns = packed.chunks_exact_mut(self.len_of(self.rows())).zip(self.firsts(row_len));
        team.run(columns, |(column, first), _| {
            self.isa.run(PackColumn { across: self, weight, row_len, first, norm, column });
        });
    }

    fn unpack(&self, u: usize, sum: &[T], row: &mut [[T; 2]]) {
        let vector = self.isa.lanes::<T>();
        for (column, first) in self.firsts(row.len()).enumerate() {
            let (real, imaginary) = sum[self.place(u, column)..][..2 * vector].split_at(vector);
            let numbers = row[first..].iter_mut().step_by(self.lanes);
            for ((number, &re), &im) in numbers.zip(real).zip(imaginary) {
                *number = [re, im];
            }
        }
    }

    /// Fewer images than bands: as many members work on an image.
    fn shares(&self, images: usize) -> bool {
        images < self.bands()
    }

    fn enter<X: Stored<Real = T>>(
        &self,
        image: ArrayView2<'_, X>,
        spectra: &mut [T],
        team: &mut Team<'_, T>,
    ) {
        let bands = spectra.chunks_mut(self.band_len()).enumerate();
        team.run(bands, |(index, band), scratch| {
            let (lines, work) = self.lines(scratch);
            let (image, first) = (Tile::new(image), index * self.rows_each());
            self.isa.run(EnterRows { image, first, places: &self.places, lines: &mut *lines });
            self.run_rows::<false>(lines, work);
            self.isa.run(SplitRows { across: self, lines, band });
        });
    }

    fn filter_columns(
        &self,
        spectra: &mut [T],
        factor: Option<&[T]>,
        sum: Option<Sum<'_, T>>,
        team: &mut Team<'_, T>,
    ) {
        let (x, sum) = sum.map(|Sum { x, sum }| (x, sum)).unzip();
        let (len, count) = (self.along_columns.packed_len(), self.columns_len());
        let x = in_order(count, x.map(|x| self.columns_of(x)));
        let sums = in_order(count, sum.map(|sum| sum.chunks_exact_mut(len)));
        let columns = self.columns_of(spectra).zip(x).zip(sums).enumerate();
        let inputs = self.along_columns.transform().inputs();
        team.run(columns, |(index, ((mut column, x), sum)), scratch| {
            let (line, scratch) = scratch.split_at_mut(self.along_columns.len());
            let (of_x, work) = scratch.split_at_mut(self.along_columns.len());
            self.isa.run(EnterColumn { column: column.view(), inputs, line: &mut *line });
            let factor = factor.map(|factor| &factor[index * len..][..len]);
            if let (Some(x), Some(sum)) = (x, sum) {
                self.isa.run(EnterColumn { column: x.view(), inputs, line: &mut *of_x });
                self.along_columns.gradient(line, of_x, factor, sum, work);
            } else if let Some(factor) = factor {
                self.along_columns.filter(line, factor, work);
            }
            if factor.is_some() {
                self.isa.run(LeaveColumn { column: column.view_mut(), inputs, line });
                self.make_real(index, &mut column);
            }
        });
    }

    fn leave<X: Stored<Real = T>>(
        &self,
        spectra: &mut [T],
        image: ArrayViewMut2<'_, X>,
        team: &mut Team<'_, T>,
    ) {
        let images = chunks_mut(image.insert_axis(Axis(0)), Axis(1), self.rows_each());
        let bands = spectra.chunks(self.band_len()).zip(images);
        team.run(bands, |(band, image), scratch| {
            let (lines, work) = self.lines(scratch);
            self.isa.run(JoinRows { across: self, lines: &mut *lines, band });
            self.run_rows::<true>(lines, work);
            let image = TileMut::new(image.index_axis_move(Axis(0), 0));
            self.isa.run(LeaveRows { image, places: &self.places, lines });
        });
    }
}

/// A column of groups of a weight, times `norm`; `first` is where it begins in a row of `row_len` numbers.
struct PackColumn<'a, T> {
    across: &'a Across<T>,
    weight: &'a [[T; 2]],
    row_len: usize,
    first: usize,
    norm: [T; 2],
    column: &'a mut [T],
}

impl<T: Real> Algorithm<T> for PackColumn<'_, T> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let Self { across, weight, row_len, first, .. } = self;
        let [norm, of_imaginary] = self.norm.map(V::splat);
        let column = complex_vectors::<V>(self.column);
        let outputs = across.along_columns.transform().outputs();
        for (row, &place) in weight.chunks_exact(row_len).zip(outputs) {
            let row = &row[first..];
            let (re, im) = if across.lanes == 1 && row.len() >= V::LANES {
                let [low, high] = Tile::dense(row.as_flattened(), V::LANES).gather(0, 1);
                V::deinterleave(low, high)
            } else {
                let mut parts = [[T::default(); MAX_LANES]; 2];
                for (i, number) in row.iter().step_by(across.lanes).take(V::LANES).enumerate() {
                    (parts[0][i], parts[1][i]) = (number[0], number[1]);
                }
                let [re, im] = Tile::dense(parts.as_flattened(), MAX_LANES).gather(0, 1);
                (re, im)
            };
            column[place] = Complex::new(re * norm, im * of_imaginary);
        }
    }
}

/// Rows of an image from `first` on as lines; below the last row that is repeated.
struct EnterRows<'a, X: Stored> {
    image: Tile<'a, X>,
    first: usize,
    places: &'a [usize],
    lines: &'a mut [X::Real],
}

impl<X: Stored> Algorithm<X::Real> for EnterRows<'_, X> {
    #[inline(always)]
    fn run<V: Vector<Element = X::Real>>(self) {
        let lines = complex_vectors::<V>(self.lines);
        for start in squares::<V>(self.places.len()) {
            let image = self.image.skip_lanes(start);
            for half in 0..HALVES {
                let mut square = [V::splat(X::Real::default()); MAX_LANES];
                for i in 0..V::LANES {
                    let row = (self.first + half * V::LANES + i).min(image.points() - 1);
                    [square[i]] = image.gather(row, 1);
                }
                transpose_square(&mut square);
                for (i, &place) in self.places[start..][..V::LANES].iter().enumerate() {
                    let z = &mut lines[place];
                    *(if half == 0 { &mut z.re } else { &mut z.im }) = square[i];
                }
            }
        }
    }
}

/// Undoes [`EnterRows`] for the rows that there are.
struct LeaveRows<'a, X: Stored> {
    image: TileMut<'a, X>,
    places: &'a [usize],
    lines: &'a mut [X::Real],
}

impl<X: Stored> Algorithm<X::Real> for LeaveRows<'_, X> {
    #[inline(always)]
    fn run<V: Vector<Element = X::Real>>(mut self) {
        let lines = complex_vectors::<V>(self.lines);
        let rows = self.image.reader().points();
        for start in squares::<V>(self.places.len()) {
            let mut image = self.image.skip_lanes(start);
            for half in 0..rows.div_ceil(V::LANES) {
                let mut square = [V::splat(X::Real::default()); MAX_LANES];
                for (i, &place) in self.places[start..][..V::LANES].iter().enumerate() {
                    let z = lines[place];
                    square[i] = if half == 0 { z.re } else { z.im };
                }
                transpose_square(&mut square);
                let first = half * V::LANES;
                for i in 0..V::LANES.min(rows - first) {
                    image.scatter(first + i, 1, [square[i]]);
                }
            }
        }
    }
}

/// The doubled spectra of the rows of each line, by columns.
struct SplitRows<'a, T> {
    across: &'a Across<T>,
    lines: &'a mut [T],
    band: &'a mut [T],
}

impl<T: Real> Algorithm<T> for SplitRows<'_, T> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let (lines, band) = (complex_vectors::<V>(self.lines), complex_vectors::<V>(self.band));
        let mut columns = band.chunks_exact_mut(HALVES * V::LANES);
        for line in lines.chunks_exact(self.across.along_rows.len()) {
            for mirrored in self.across.mirrored.chunks_exact(V::LANES) {
                let column = columns.next().expect("a column for each group");
                for half in 0..HALVES {
                    let (mut re, mut im) = ([line[0].re; MAX_LANES], [line[0].im; MAX_LANES]);
                    for (i, &[place, mirror]) in mirrored.iter().enumerate() {
                        let z = split(line[place], line[mirror])[half];
                        (re[i], im[i]) = (z.re, z.im);
                    }
                    transpose_square(&mut re);
                    transpose_square(&mut im);
                    for i in 0..V::LANES {
                        column[half * V::LANES + i] = Complex::new(re[i], im[i]);
                    }
                }
            }
        }
    }
}

/// Undoes [`SplitRows`] up to a factor 2.
struct JoinRows<'a, T> {
    across: &'a Across<T>,
    lines: &'a mut [T],
    band: &'a [T],
}

impl<T: Real> Algorithm<T> for JoinRows<'_, T> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let lines = complex_vectors::<V>(self.lines);
        let mut columns = complex_vectors_of::<V>(self.band).chunks_exact(HALVES * V::LANES);
        let width = self.across.along_rows.len();
        for line in lines.chunks_exact_mut(width) {
            let mut left = width / 2 + 1; // frequencies, without repetitions
            for mirrored in self.across.mirrored.chunks_exact(V::LANES) {
                let (first, second) =
                    columns.next().expect("a column for each group").split_at(V::LANES);
                for mirror in [true, false] {
                    let (mut re, mut im) = ([first[0].re; MAX_LANES], [first[0].im; MAX_LANES]);
                    for i in 0..V::LANES {
                        let (z, opposite) = join([first[i], second[i]]);
                        let z = if mirror { opposite } else { z };
                        (re[i], im[i]) = (z.re, z.im);
                    }
                    transpose_square(&mut re);
                    transpose_square(&mut im);
                    for (i, places) in mirrored.iter().take(left).enumerate() {
                        line[places[usize::from(mirror)]] = Complex::new(re[i], im[i]);
                    }
                }
                left = left.saturating_sub(V::LANES);
            }
        }
    }
}

/// A column as a line.
struct EnterColumn<'a, T> {
    column: ArrayView2<'a, T>,
    inputs: &'a [usize],
    line: &'a mut [T],
}

impl<T: Element> Algorithm<T> for EnterColumn<'_, T> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(self) {
        let line = complex_vectors::<V>(self.line);
        let bands = self.column.outer_iter().zip(self.inputs.chunks(HALVES * V::LANES));
        for (band, inputs) in bands {
            let band = band.to_slice().expect("a band has no gaps");
            for (&z, &input) in complex_vectors_of::<V>(band).iter().zip(inputs) {
                line[input] = z;
            }
        }
    }
}

/// Undoes [`EnterColumn`].
struct LeaveColumn<'a, T> {
    column: ArrayViewMut2<'a, T>,
    inputs: &'a [usize],
    line: &'a mut [T],
}

impl<T: Element> Algorithm<T> for LeaveColumn<'_, T> {
    #[inline(always)]
    fn run<V: Vector<Element = T>>(mut self) {
        let line = complex_vectors::<V>(self.line);
        let bands = self.column.outer_iter_mut().zip(self.inputs.chunks(HALVES * V::LANES));
        for (band, inputs) in bands {
            let band = band.into_slice().expect("a band has no gaps");
            let (rows, missing) = complex_vectors::<V>(band).split_at_mut(inputs.len());
            for (z, &input) in rows.iter_mut().zip(inputs) {
                *z = line[input];
            }
            // what is large there would cost its partner's digits
            missing.fill(Complex::zero());
        }
    }
}
