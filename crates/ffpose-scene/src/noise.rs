//! Fractal value noise in three dimensions: the land and clouds of rendered scenes.
//!
//! Random values at whole numbers, smoothed between them (K. Perlin, "An image synthesizer", 1985), summed over octaves
//! that are turned against each other so that the whole numbers do not show. The values are hashes of their places, worked
//! out in vectors: with AVX2 that takes less than half the time of looking them up in a table.
//!
//! Loops run over the lanes of a block and what they call is inlined and has no branches, so that the compiler makes vectors
//! of the instruction set that `Isa::run_loops` opens. It fuses no multiplication with an addition, so all of them agree.

use ndarray::{Array1, ArrayView2, ArrayViewD, ArrayViewMut1, Axis, Ix1, Ix2};

use ffpose_core::{Error, Isa, Loops};

/// Takes the points of one octave to those of the next: a turn by 60° about (1, 1, 1), times 1.97.
const TURN: [[f32; 3]; 3] = [
    [1.313_333, -0.656_667, 1.313_333],
    [1.313_333, 1.313_333, -0.656_667],
    [-0.656_667, 1.313_333, 1.313_333],
];

/// What is added after the turn, so that the origin is no special place.
const SHIFT: f32 = 17.3;

/// Odd factors without a pattern in their bits: one for each axis, and one that mixes.
const FACTORS: [u32; 3] = [0x9E37_79B1, 0x85EB_CA77, 0xC2B2_AE3D];
const MIX: u32 = 0x27D4_EB2F;

/// Points computed at once.
pub(crate) const BLOCK: usize = 32;

pub(crate) type Block = [f32; BLOCK];
pub(crate) type Block3 = [Block; 3];

/// `Σ_k heights[k] · noise(p_k)` for each of N points, with `p_0` the point itself and `p_k` in a frame about twice as fine
/// as that of `p_{k-1}`.
///
/// - `points (3, N)`: one unit is the way from one random value to the next in the first octave. In no octave may a
///   coordinate leave ±2²¹; what lies beyond has no meaning.
/// - `heights (K,)`: one for each octave.
///
/// NaN in a point goes through to its result. The result has the same bits on every machine.
///
/// # Errors
/// [`Error::Shape`]; [`Error::Isa`] as for [`Isa::current`].
pub fn fractal(
    points: ArrayViewD<'_, f32>,
    heights: ArrayViewD<'_, f32>,
) -> Result<Array1<f32>, Error> {
    let points = rays("points", points)?;
    let got = heights.shape().to_vec();
    let heights = heights.into_dimensionality::<Ix1>();
    let heights = heights.map_err(|_| Error::shape("heights", "(K,)", &got))?.to_vec();
    let (isa, mut sums) = (Isa::current()?, Array1::zeros(points.ncols()));
    for (sums, points) in
        sums.axis_chunks_iter_mut(Axis(0), BLOCK).zip(points.axis_chunks_iter(Axis(1), BLOCK))
    {
        isa.run_loops(Fractal { places: block(points), heights: &heights, sums });
    }
    Ok(sums)
}

/// `array` as the (3, N) that it must be.
pub(crate) fn rays<'a>(
    name: &'static str,
    array: ArrayViewD<'a, f32>,
) -> Result<ArrayView2<'a, f32>, Error> {
    let got = array.shape().to_vec();
    let array = array.into_dimensionality::<Ix2>().ok().filter(|array| array.nrows() == 3);
    array.ok_or_else(|| Error::shape(name, "(3, N)", &got))
}

/// At most `BLOCK` columns, with zeros behind.
pub(crate) fn block(columns: ArrayView2<'_, f32>) -> Block3 {
    let mut block = [[0.0; BLOCK]; 3];
    for (block, columns) in block.iter_mut().zip(columns.rows()) {
        block.iter_mut().zip(columns).for_each(|(block, column)| *block = *column);
    }
    block
}

struct Fractal<'a> {
    places: Block3,
    heights: &'a [f32],
    sums: ArrayViewMut1<'a, f32>,
}

impl Loops for Fractal<'_> {
    #[inline(always)]
    fn run(self) {
        let sums = octaves(&self.places, self.heights);
        self.sums.into_iter().zip(sums).for_each(|(out, sum)| *out = sum);
    }
}

/// The sum of the octaves at `places`.
#[inline(always)]
pub(crate) fn octaves(places: &Block3, heights: &[f32]) -> Block {
    let mut places = *places;
    let mut sums = [0.0; BLOCK];
    for (octave, height) in heights.iter().enumerate() {
        if octave > 0 {
            places = finer(&places);
        }
        for n in 0..BLOCK {
            sums[n] += height * noise([places[0][n], places[1][n], places[2][n]]);
        }
    }
    sums
}

/// The smoothed values at `place`, in -1…1.
#[inline(always)]
fn noise(place: [f32; 3]) -> f32 {
    let (x, y, z) = (cell(place[0]), cell(place[1]), cell(place[2]));
    let [a, b, c] = FACTORS;
    let (x0, y0, z0) = (x.0.wrapping_mul(a), y.0.wrapping_mul(b), z.0.wrapping_mul(c));
    let (x1, y1, z1) = (x0.wrapping_add(a), y0.wrapping_add(b), z0.wrapping_add(c));
    let part = smooth(z.1);
    let along_z = |xy: u32| mix(value(xy ^ z0), value(xy ^ z1), part);
    let part = smooth(y.1);
    let along_y = |x: u32| mix(along_z(x ^ y0), along_z(x ^ y1), part);
    mix(along_y(x0), along_y(x1), smooth(x.1))
}

/// A number in -1…1 for each pattern of bits, without a pattern of its own.
#[inline(always)]
fn value(mut bits: u32) -> f32 {
    bits ^= bits >> 15;
    bits = bits.wrapping_mul(MIX);
    bits ^= bits >> 13;
    bits = bits.wrapping_mul(MIX);
    bits.cast_signed() as f32 * (1.0 / 2_147_483_648.0)
}

/// The whole number at or below `coordinate`, in two's complement, and the part of the way to the next.
///
/// The sum with 1.5 · 2²³ has the nearest whole number in its last bits.
#[inline(always)]
fn cell(coordinate: f32) -> (u32, f32) {
    const WHOLE: f32 = 12_582_912.0;
    let sum = coordinate + WHOLE;
    let nearest = sum - WHOLE;
    let above = nearest > coordinate;
    (
        sum.to_bits().wrapping_sub(WHOLE.to_bits()).wrapping_sub(u32::from(above)),
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
#[inline(always)]
fn finer(places: &Block3) -> Block3 {
    let [x, y, z] = places;
    let mut next = [[0.0; BLOCK]; 3];
    for (next, [a, b, c]) in next.iter_mut().zip(TURN) {
        for n in 0..BLOCK {
            next[n] = a * x[n] + b * y[n] + c * z[n] + SHIFT;
        }
    }
    next
}
