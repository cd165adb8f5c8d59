//! Textures on the faces of a mesh: levels of averaged texels (Williams 1983, "Pyramidal parametrics"), read between the four
//! nearest texels.

// Numbers that become whole ones are clamped to the sides and levels of a texture first, of which none is beyond `MOST_SIDE`.
#![allow(clippy::cast_possible_truncation, clippy::cast_possible_wrap, clippy::cast_sign_loss)]

use ndarray::{Array2, ArrayView1, ArrayView2, ArrayViewD, ArrayViewMut2, Ix1, Ix2};

use ffpose_core::{Error, Isa, Loops};

/// Largest side of a texture: places of texels fit an `i32`.
pub const MOST_SIDE: u32 = 1 << 14;

/// Coordinates beyond so many texels are taken for that many.
const LARGEST: f32 = 1_073_741_824.0;

/// Points computed at once, and their values.
const BLOCK: usize = 32;
const VALUES: usize = 4 * BLOCK;

/// What lies beyond the border of a texture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wrap {
    /// The texture again.
    Repeat,
    /// The texture mirrored.
    Mirror,
    /// The texel at the border.
    Clamp,
}

/// A texture. Numbers of float16 are given by their bits and finite.
pub struct Texture<'a> {
    /// `(T, 4)`: all levels one after the other, row by row, each half as large as the one before, the last of one texel.
    pub texels: ArrayViewD<'a, u16>,
    /// Width and height of the first level, powers of two up to [`MOST_SIDE`].
    pub sides: [u32; 2],
    /// To the right and downward.
    pub wrap: [Wrap; 2],
}

/// The faces that have a texture.
pub struct Faces<'a> {
    /// `(F, 6)`: coordinates of the three corners to the right and downward, 0…1 once over the texture.
    pub corners: ArrayViewD<'a, f32>,
    /// `(F, 4)`: the texture's mean over each face, as float16.
    pub means: ArrayViewD<'a, u16>,
}

/// Points on faces.
pub struct Points<'a> {
    /// `(N,)`: their faces.
    pub face: ArrayViewD<'a, i32>,
    /// `(3, N)`: barycentric weights of the face's corners.
    pub weights: ArrayViewD<'a, f32>,
    /// `(N,)`: the level to read, 0 is the first; the nearest one is read, the last for what is beyond.
    pub levels: ArrayViewD<'a, f32>,
    /// `(N,)`: the share of the face's mean, 0…1; the rest is the texture's.
    pub shares: ArrayViewD<'a, f32>,
}

/// Values `(4, N)` of a texture at points, the same bits on every machine that takes no subnormal number for zero.
///
/// # Errors
/// [`Error::Shape`]; [`Error::Vector`] for a face that there is not; [`Error::Isa`] as for [`Isa::current`].
///
/// # Panics
/// Unless the texture's sides are as said there.
pub fn sample(
    texture: &Texture<'_>,
    faces: &Faces<'_>,
    points: &Points<'_>,
) -> Result<Array2<f32>, Error> {
    assert!(texture.sides.iter().all(|side| side.is_power_of_two() && *side <= MOST_SIDE));
    let isa = Isa::current()?;
    let (table, texels) = table(texture.sides);
    let (count, faces_count) = (points.face.len(), faces.corners.shape().first().map_or(0, |f| *f));
    let face = vector("face", &points.face, count)?;
    if let Some(n) = face.iter().position(|face| *face < 0 || *face as usize >= faces_count) {
        let (name, expected, got) = ("face", "one of the faces of corners", vec![face[n] as f32]);
        return Err(Error::Vector { name, expected, got, column: Some(n) });
    }
    let mut values = Array2::zeros((4, count));
    isa.run_loops(Sample {
        texels: rows("texels", &texture.texels, texels)?,
        table: &table,
        wrap: texture.wrap,
        corners: rows("corners", &faces.corners, faces_count)?,
        means: rows("means", &faces.means, faces_count)?,
        face,
        weights: plane("weights", &points.weights, count)?,
        levels: vector("levels", &points.levels, count)?,
        shares: vector("shares", &points.shares, count)?,
        values: values.view_mut(),
    });
    Ok(values)
}

/// `array` as the `count` rows of `K` that it must be.
fn rows<'a, T, const K: usize>(
    name: &'static str,
    array: &'a ArrayViewD<'_, T>,
    count: usize,
) -> Result<&'a [[T; K]], Error> {
    let rows = array.as_slice().filter(|_| array.shape() == [count, K]);
    let rows = rows.ok_or_else(|| Error::shape(name, &format!("({count}, {K})"), array.shape()))?;
    Ok(rows.as_chunks().0)
}

/// `array` as the `(count,)` that it must be.
fn vector<'a, T>(
    name: &'static str,
    array: &'a ArrayViewD<'_, T>,
    count: usize,
) -> Result<ArrayView1<'a, T>, Error> {
    let vector = array.view().into_dimensionality::<Ix1>().ok().filter(|v| v.len() == count);
    vector.ok_or_else(|| Error::shape(name, &format!("({count},)"), array.shape()))
}

/// `array` as the `(3, count)` that it must be.
fn plane<'a>(
    name: &'static str,
    array: &'a ArrayViewD<'_, f32>,
    count: usize,
) -> Result<ArrayView2<'a, f32>, Error> {
    let plane = array.view().into_dimensionality::<Ix2>().ok().filter(|p| p.dim() == (3, count));
    plane.ok_or_else(|| Error::shape(name, &format!("(3, {count})"), array.shape()))
}

/// A level of a texture.
#[derive(Clone, Copy)]
struct Level {
    width: i32,
    height: i32,
    /// Its first texel.
    start: i32,
}

/// The levels of a texture, and the number of texels of all of them.
fn table(sides: [u32; 2]) -> (Vec<Level>, usize) {
    let (mut levels, mut start) = (Vec::new(), 0);
    for halvings in 0..=sides[0].max(sides[1]).ilog2() {
        let [width, height] = sides.map(|side| (side >> halvings).max(1) as i32);
        levels.push(Level { width, height, start });
        start += width * height;
    }
    (levels, start as usize)
}

struct Sample<'a> {
    texels: &'a [[u16; 4]],
    table: &'a [Level],
    wrap: [Wrap; 2],
    corners: &'a [[f32; 6]],
    means: &'a [[u16; 4]],
    face: ArrayView1<'a, i32>,
    weights: ArrayView2<'a, f32>,
    levels: ArrayView1<'a, f32>,
    shares: ArrayView1<'a, f32>,
    values: ArrayViewMut2<'a, f32>,
}

impl Loops for Sample<'_> {
    #[inline(always)]
    fn run(mut self) {
        for start in (0..self.face.len()).step_by(BLOCK) {
            let count = BLOCK.min(self.face.len() - start);
            let values = self.block(start, count);
            for (channel, mut row) in self.values.rows_mut().into_iter().enumerate() {
                (0..count).for_each(|n| row[start + n] = values[4 * n + channel]);
            }
        }
    }
}

impl Sample<'_> {
    /// The values of at most `BLOCK` points, those of a point together.
    #[inline(always)]
    fn block(&self, start: usize, count: usize) -> [f32; VALUES] {
        let [mut width, mut height, mut first] = [[1; BLOCK]; 3];
        let [mut across, mut down, mut share] = [[0.0; BLOCK]; 3];
        let last = (self.table.len() - 1) as f32;
        for n in 0..count {
            let at = start + n;
            let level = self.levels[at].round_ties_even().clamp(0.0, last);
            let level = self.table[level as usize];
            (width[n], height[n], first[n]) = (level.width, level.height, level.start);
            let corners = self.corners[self.face[at] as usize];
            let weights = [self.weights[[0, at]], self.weights[[1, at]], self.weights[[2, at]]];
            let blend = |k: usize| {
                weights[0] * corners[k] + weights[1] * corners[2 + k] + weights[2] * corners[4 + k]
            };
            (across[n], down[n]) = (blend(0), blend(1));
            share[n] = self.shares[at];
        }
        let (left, right) = neighbors(&mut across, &width, self.wrap[0]);
        let (top, bottom) = neighbors(&mut down, &height, self.wrap[1]);
        let texels = |row: &[i32; BLOCK], column: &[i32; BLOCK]| {
            widened(count, |n| self.texels[(first[n] + row[n] * width[n] + column[n]) as usize])
        };
        let upper = mixed(&texels(&top, &left), &texels(&top, &right), &across);
        let lower = mixed(&texels(&bottom, &left), &texels(&bottom, &right), &across);
        let values = mixed(&upper, &lower, &down);
        let means = widened(count, |n| self.means[self.face[start + n] as usize]);
        mixed(&values, &means, &share)
    }
}

/// The texels before and after coordinates, which become the parts of the way from one to the other.
#[inline(always)]
fn neighbors(
    coordinates: &mut [f32; BLOCK],
    counts: &[i32; BLOCK],
    wrap: Wrap,
) -> ([i32; BLOCK], [i32; BLOCK]) {
    let [mut first, mut second] = [[0; BLOCK]; 2];
    for n in 0..BLOCK {
        let mut coordinate = coordinates[n];
        if wrap == Wrap::Repeat {
            coordinate -= coordinate.floor();
        }
        let place = coordinate * counts[n] as f32 - 0.5;
        let below = place.floor();
        coordinates[n] = place - below;
        first[n] = below.clamp(-LARGEST, LARGEST) as i32;
        second[n] = first[n] + 1;
    }
    for index in [&mut first, &mut second] {
        for n in 0..BLOCK {
            let (there, last) = (index[n], counts[n] - 1);
            index[n] = match wrap {
                Wrap::Repeat => there & last,
                Wrap::Mirror => {
                    let there = there & (2 * last + 1);
                    there.min(2 * last + 1 - there)
                }
                Wrap::Clamp => there.max(0).min(last),
            };
        }
    }
    (first, second)
}

/// Numbers of float16, by their bits: those are the bits of numbers of float32 that are 2¹¹² times as small.
#[inline(always)]
fn widened(count: usize, texel: impl Fn(usize) -> [u16; 4]) -> [f32; VALUES] {
    let (mut bits, mut values) = ([0; VALUES], [0.0; VALUES]);
    for (n, bits) in bits.as_chunks_mut().0.iter_mut().take(count).enumerate() {
        *bits = texel(n);
    }
    for n in 0..VALUES {
        let bits = u32::from(bits[n]);
        let size = f32::from_bits((bits & 0x7fff) << 13) * f32::from_bits((127 + 112) << 23);
        values[n] = f32::from_bits(size.to_bits() | (bits & 0x8000) << 16);
    }
    values
}

/// What is a part of the way from values to others.
#[inline(always)]
fn mixed(from: &[f32; VALUES], to: &[f32; VALUES], part: &[f32; BLOCK]) -> [f32; VALUES] {
    let mut mixed = [0.0; VALUES];
    for (n, part) in part.iter().enumerate() {
        for k in 4 * n..4 * n + 4 {
            mixed[k] = from[k] + (to[k] - from[k]) * part;
        }
    }
    mixed
}
