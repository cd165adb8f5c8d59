//! Fractal value noise in three dimensions: the land and clouds of rendered scenes.
//!
//! Random values on a periodic lattice, smoothed between its points (K. Perlin, "An image synthesizer", 1985), summed over
//! octaves that are turned against each other so that the lattice does not show.

use ndarray::{Array1, ArrayView1, ArrayView2, ArrayView3, ArrayViewD, Axis, Ix1, Ix2, Ix3};

use crate::Error;
use crate::shape::wrong;

/// Takes the points of one octave to those of the next: a turn by 60° about (1, 1, 1), times 1.97.
const TURN: [[f32; 3]; 3] = [
    [1.313_333, -0.656_667, 1.313_333],
    [1.313_333, 1.313_333, -0.656_667],
    [-0.656_667, 1.313_333, 1.313_333],
];

/// What is added after the turn, so that the origin is no special place.
const SHIFT: f32 = 17.3;

/// Points computed at once.
const BLOCK: usize = 32;

type Block = [f32; BLOCK];
type Block3 = [Block; 3];

/// `Σ_k heights[k] · noise(p_k)` for each of N points, with `p_0` the point itself and `p_k` in a frame about twice as fine
/// as that of `p_{k-1}`.
///
/// - `points (3, N)`: one unit is one cell of the lattice in the first octave. In no octave may a coordinate leave ±2²¹;
///   what lies beyond has no meaning.
/// - `lattice (L, L, L)`, L a power of two: the random values. The noise meets them at whole numbers, and has period L.
/// - `heights (K,)`: one for each octave.
///
/// NaN in a point goes through to its result. The result has the same bits on every machine.
///
/// # Errors
/// [`Error::Shape`]; [`Error::Strides`] if `lattice` is not C-contiguous.
pub fn fractal(
    points: ArrayViewD<'_, f32>,
    lattice: ArrayViewD<'_, f32>,
    heights: ArrayViewD<'_, f32>,
) -> Result<Array1<f32>, Error> {
    let (points, lattice, heights) = checked(points, &lattice, heights)?;
    let mut sums = Array1::zeros(points.ncols());
    for (sums, points) in
        sums.axis_chunks_iter_mut(Axis(0), BLOCK).zip(points.axis_chunks_iter(Axis(1), BLOCK))
    {
        let mut places = [[0.0; BLOCK]; 3];
        for (places, points) in places.iter_mut().zip(points.rows()) {
            places.iter_mut().zip(points).for_each(|(place, point)| *place = *point);
        }
        sums.into_iter().zip(lattice.octaves(places, heights)).for_each(|(sum, new)| *sum = new);
    }
    Ok(sums)
}

/// The arguments of [`fractal`] in the shapes that it wants.
#[allow(clippy::type_complexity)] // three arrays, in the order of the arguments
fn checked<'a>(
    points: ArrayViewD<'a, f32>,
    lattice: &'a ArrayViewD<'_, f32>,
    heights: ArrayViewD<'a, f32>,
) -> Result<(ArrayView2<'a, f32>, Lattice<'a>, ArrayView1<'a, f32>), Error> {
    let got = points.shape().to_vec();
    let points = points.into_dimensionality::<Ix2>().ok().filter(|points| points.nrows() == 3);
    let points = points.ok_or_else(|| wrong("points", "(3, N)", &got))?;
    let lattice = Lattice::new(lattice.view())?;
    let got = heights.shape().to_vec();
    let heights = heights.into_dimensionality::<Ix1>();
    Ok((points, lattice, heights.map_err(|_| wrong("heights", "(K,)", &got))?))
}

/// A cube of random values, its side a power of two.
struct Lattice<'a> {
    values: &'a [f32],
    side: u32,
}

impl<'a> Lattice<'a> {
    /// Largest side: its cube is still an index of 32 bits.
    const MOST: usize = 1 << 10;

    fn new(lattice: ArrayViewD<'a, f32>) -> Result<Self, Error> {
        let (got, strides) = (lattice.shape().to_vec(), lattice.strides().to_vec());
        let cube: Option<ArrayView3<'_, f32>> = lattice.into_dimensionality::<Ix3>().ok();
        let side =
            got.first().copied().filter(|side| side.is_power_of_two() && *side <= Self::MOST);
        match (cube, side) {
            (Some(cube), Some(side)) if got == [side; 3] => {
                let values =
                    cube.to_slice().ok_or(Error::Strides { name: "lattice", got: strides })?;
                let side = u32::try_from(side).expect("at most 1024");
                Ok(Self { values, side })
            }
            _ => Err(wrong("lattice", "(L, L, L), L a power of two up to 1024", &got)),
        }
    }

    /// The sum of the octaves at `places`.
    fn octaves(&self, mut places: Block3, heights: ArrayView1<'_, f32>) -> Block {
        let mut sums = [0.0; BLOCK];
        for (octave, height) in heights.iter().enumerate() {
            if octave > 0 {
                places = finer(&places);
            }
            let values = self.noise(&places);
            sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += height * value);
        }
        sums
    }

    /// The smoothed values at `places`.
    fn noise(&self, places: &Block3) -> Block {
        let corners = self.corners(&places.each_ref().map(|axis| axis.map(|x| cell(x).0)));
        let parts = places.each_ref().map(|axis| axis.map(|x| smooth(cell(x).1)));
        std::array::from_fn(|n| {
            let along_z =
                |row: usize| mix(corners[2 * row][n], corners[2 * row + 1][n], parts[2][n]);
            let along_y = |side: usize| mix(along_z(2 * side), along_z(2 * side + 1), parts[1][n]);
            mix(along_y(0), along_y(1), parts[0][n])
        })
    }

    /// The values at the eight corners of each cell, z running fastest. Looked up by themselves, so that the loops before
    /// and after are of vectors.
    fn corners(&self, cells: &[[u32; BLOCK]; 3]) -> [Block; 8] {
        let mask = self.side - 1;
        let scaled = |axis: usize, step: u32, scale: u32| -> [u32; BLOCK] {
            cells[axis].map(|low| (low.wrapping_add(step) & mask) * scale)
        };
        let x = [0, 1].map(|step| scaled(0, step, self.side * self.side));
        let y = [0, 1].map(|step| scaled(1, step, self.side));
        let z = [0, 1].map(|step| scaled(2, step, 1));
        std::array::from_fn(|corner| {
            let (x, y, z) = (&x[corner >> 2], &y[corner >> 1 & 1], &z[corner & 1]);
            std::array::from_fn(|n| self.values[(x[n] + y[n] + z[n]) as usize])
        })
    }
}

/// The whole number at or below `coordinate`, modulo 2²², and the part of the way to the next.
///
/// The sum with 1.5 · 2²³ has the nearest whole number in its last bits.
#[inline(always)]
fn cell(coordinate: f32) -> (u32, f32) {
    const WHOLE: f32 = 12_582_912.0;
    let sum = coordinate + WHOLE;
    let nearest = sum - WHOLE;
    let above = nearest > coordinate;
    (
        sum.to_bits().wrapping_sub(u32::from(above)),
        coordinate - nearest + f32::from(u8::from(above)),
    )
}

#[inline(always)]
fn smooth(part: f32) -> f32 {
    part * part * (3.0 - 2.0 * part)
}

#[inline(always)]
fn mix(first: f32, second: f32, part: f32) -> f32 {
    first + (second - first) * part
}

/// The places of points in the next octave.
fn finer(places: &Block3) -> Block3 {
    let [x, y, z] = places;
    TURN.map(|[a, b, c]| std::array::from_fn(|n| a * x[n] + b * y[n] + c * z[n] + SHIFT))
}
