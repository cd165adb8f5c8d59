//! The Earth and its air as seen from a low orbit, evaluated for each ray in three dimensions.
//!
//! Lengths are in Earth radii. The air is one layer of exponential density with the zenith optical depths of Rayleigh
//! scattering and a little haze; light is scattered once. Land, clouds and city lights are fractal noise on the sphere, so
//! nothing has texture pixels, seams or poles.
//!
//! Loops are over the lanes of a block, as in [`crate::noise`]; what no lane of a block needs is left out.

use std::iter::successors;

use ndarray::{Array1, Array2, ArrayView2, ArrayViewD, ArrayViewMut1, ArrayViewMut2, Axis};

use ffpose_core::{Error, Isa, Loops};

use crate::noise::{BLOCK, Block, Block3, block, octaves, rays};

type Vec3 = [f32; 3];

/// Vertical optical depth of the air for red, green and blue.
const OPTICAL_DEPTH: Vec3 = [0.07, 0.13, 0.28];

/// Height over which the air thins by e: 9 km, with some of the haze above the true 8.
const SCALE_HEIGHT: f32 = 0.0014;

const HORIZON_AIR_MASS: f32 = 38.0;

/// How far from the Earth's center a ray still meets air.
const TOP: f32 = 1.018;

/// Radiance of endless air under the sun.
const SKY_LIGHT: f32 = 0.36;

const OCEAN: Vec3 = [0.010, 0.026, 0.058];
const FOREST: Vec3 = [0.040, 0.062, 0.026];
const DESERT: Vec3 = [0.27, 0.22, 0.115];
const ICE: Vec3 = [0.70, 0.73, 0.76];
const CLOUD: f32 = 0.80;

/// Radiance of a bright city by night, raised a hundredfold so that eight bits can show it.
const CITY: Vec3 = [0.040, 0.028, 0.013];

/// The green glow of the upper air by night: its radiance, raised as that of the cities, its height and its thickness.
/// Lower rays cross the layer at a slant and meet less of it.
const AIRGLOW: Vec3 = [0.0012, 0.0030, 0.0014];
const AIRGLOW_HEIGHT: f32 = 0.0141;
const AIRGLOW_DEPTH: f32 = 0.0012;

/// GGX alpha of wind-roughened water, squared.
const WAVE_SLOPE: f32 = 0.12 * 0.12;

/// Where the Earth is, and what lights it, in the frame of the camera.
#[derive(Clone, Copy, Debug)]
pub struct Earth {
    /// Unit vector to its center.
    pub nadir: Vec3,
    /// Height of the camera above the ground, Earth radii.
    pub altitude: f32,
    /// Unit vector to the sun.
    pub sun: Vec3,
    /// Rows of the rotation into the frame of land and clouds.
    pub ground: [Vec3; 3],
    /// Octaves of the clouds: finer pictures need more.
    pub detail: u8,
    /// Angle of one pixel in radians, over which the rim is smoothed.
    pub pixel_angle: f32,
}

impl Earth {
    fn check(&self) -> Result<(), Error> {
        let vector = |name, got: &[f32]| finite(name, got, None);
        vector("nadir", &self.nadir)?;
        vector("sun", &self.sun)?;
        vector("ground", self.ground.as_flattened())?;
        for (name, got) in [("altitude", self.altitude), ("pixel_angle", self.pixel_angle)] {
            if !(got > 0.0 && got.is_finite()) {
                let expected = "finite and above zero";
                return Err(Error::Vector { name, expected, got: vec![got], column: None });
            }
        }
        Ok(())
    }
}

/// Comparisons with NaN are false, so that a ray with one would pass beside the Earth, as black sky.
fn check_rays(rays: ArrayView2<'_, f32>) -> Result<(), Error> {
    if rays.iter().all(|x| x.is_finite()) {
        return Ok(());
    }
    rays.columns()
        .into_iter()
        .enumerate()
        .try_for_each(|(column, ray)| finite("rays", &ray.to_vec(), Some(column)))
}

fn finite(name: &'static str, got: &[f32], column: Option<usize>) -> Result<(), Error> {
    if got.iter().all(|x| x.is_finite()) {
        return Ok(());
    }
    Err(Error::Vector { name, expected: "finite", got: got.to_vec(), column })
}

/// What comes along rays: light `(3, N)`, and the part `(N,)` of what lies behind that still shows.
#[derive(Debug)]
pub struct Seen {
    /// Radiance of Earth and air: red, green, blue.
    pub radiance: Array2<f32>,
    /// 1 beside the Earth and its air, 0 on the Earth.
    pub behind: Array1<f32>,
}

/// What the Earth and its air send along `directions (3, N)`, unit vectors in the frame of the camera.
///
/// The result has the same bits on every machine.
///
/// # Errors
/// [`Error::Shape`]; [`Error::Vector`] with what is not finite, or not above zero, and the column of a ray; [`Error::Isa`] as for
/// [`Isa::current`].
pub fn shade(earth: &Earth, directions: ArrayViewD<'_, f32>) -> Result<Seen, Error> {
    let directions = rays("rays", directions)?;
    earth.check()?;
    check_rays(directions)?;
    let (isa, planet) = (Isa::current()?, Planet::new(earth));
    let count = directions.ncols();
    let mut seen = Seen { radiance: Array2::zeros((3, count)), behind: Array1::zeros(count) };
    for ((rays, radiance), behind) in directions
        .axis_chunks_iter(Axis(1), BLOCK)
        .zip(seen.radiance.axis_chunks_iter_mut(Axis(1), BLOCK))
        .zip(seen.behind.axis_chunks_iter_mut(Axis(0), BLOCK))
    {
        isa.run_loops(Shade { planet: &planet, rays: block(rays), radiance, behind });
    }
    Ok(seen)
}

struct Shade<'a> {
    planet: &'a Planet,
    rays: Block3,
    radiance: ArrayViewMut2<'a, f32>,
    behind: ArrayViewMut1<'a, f32>,
}

impl Loops for Shade<'_> {
    #[inline(always)]
    fn run(mut self) {
        let (light, behind) = self.planet.shade(&self.rays);
        for (mut out, light) in self.radiance.rows_mut().into_iter().zip(light) {
            out.iter_mut().zip(light).for_each(|(out, light)| *out = light);
        }
        self.behind.iter_mut().zip(behind).for_each(|(out, behind)| *out = behind);
    }
}

/// The heights of octaves, each a constant times the one before, whose sum is one.
struct Heights(Vec<f32>);

impl Heights {
    fn new(count: u8, gain: f32) -> Self {
        let powers = successors(Some(1.0), |power: &f32| Some(power * gain));
        let powers: Vec<f32> = powers.take(usize::from(count)).collect();
        let sum: f32 = powers.iter().sum();
        Self(powers.into_iter().map(|power| power / sum).collect())
    }

    #[inline(always)]
    fn fractal(&self, places: &Block3) -> Block {
        octaves(places, &self.0)
    }
}

/// An [`Earth`] with all that is the same for every ray.
struct Planet {
    earth: Earth,
    /// The camera seen from the Earth's center.
    camera: Vec3,
    /// Squared distance to the horizon.
    horizon: f32,
    weather: Heights,
    clouds: Heights,
    tops: Heights,
    relief: Heights,
    ground: Heights,
    coast: Heights,
    regions: Heights,
    streets: Heights,
}

/// What covers the ground.
struct Cover {
    albedo: Block3,
    /// How much of it is open sea.
    sea: Block,
}

impl Planet {
    fn new(earth: &Earth) -> Self {
        Self {
            earth: *earth,
            camera: earth.nadir.map(|x| -x * (1.0 + earth.altitude)),
            horizon: earth.altitude * (2.0 + earth.altitude),
            weather: Heights::new(3, 0.5),
            clouds: Heights::new(earth.detail, 0.58),
            tops: Heights::new(4, 0.7),
            relief: Heights::new(earth.detail, 0.55),
            ground: Heights::new(4, 0.6),
            coast: Heights::new(4, 0.55),
            regions: Heights::new(3, 0.6),
            streets: Heights::new(4, 0.9),
        }
    }

    #[inline(always)]
    fn shade(&self, rays: &Block3) -> (Block3, Block) {
        let radius = 1.0 + self.earth.altitude;
        let rim = 1.0 / (self.earth.pixel_angle * self.horizon.sqrt());
        let (mut along, mut closest, mut disc) = ([0.0; BLOCK], [0.0; BLOCK], [0.0; BLOCK]);
        for n in 0..BLOCK {
            along[n] = dot(self.earth.nadir, lane(rays, n)) * radius;
            // Above zero: a ray to the very middle has a direction from it too.
            closest[n] = (radius * radius - along[n] * along[n]).max(1e-12).sqrt();
            let inside = (0.5 - (closest[n] - 1.0) * rim).clamp(0.0, 1.0);
            disc[n] = if along[n] > 0.0 { inside } else { 0.0 };
        }
        let mut radiance = [[0.0; BLOCK]; 3];
        let mut behind = disc.map(|disc| 1.0 - disc);
        if (0..BLOCK).any(|n| along[n] > 0.0 && disc[n] < 1.0 && closest[n] < TOP) {
            self.add_limb(rays, &along, &closest, &mut radiance, &mut behind);
        }
        if disc.iter().any(|disc| *disc > 0.0) {
            let surface = self.surface(rays, &along);
            for (radiance, surface) in radiance.iter_mut().zip(surface) {
                for n in 0..BLOCK {
                    radiance[n] += disc[n] * surface[n];
                }
            }
        }
        (radiance, behind)
    }

    /// Air above the limb: its glow, and what it takes from what lies behind.
    #[inline(always)]
    fn add_limb(
        &self,
        rays: &Block3,
        along: &Block,
        closest: &Block,
        radiance: &mut Block3,
        behind: &mut Block,
    ) {
        for n in 0..BLOCK {
            let ray = lane(rays, n);
            let over: Vec3 =
                std::array::from_fn(|k| (ray[k] * along[n] + self.camera[k]) / closest[n]);
            let sun_height = dot(self.earth.sun, over);
            let sky = self.sky(ray, sun_height);
            let height = (closest[n] - 1.0).max(0.0);
            let met = along[n] > 0.0 && closest[n] < TOP;
            let air = if met { exp(-height / SCALE_HEIGHT) } else { 0.0 };
            let above = (height - AIRGLOW_HEIGHT) / AIRGLOW_DEPTH;
            let layer = exp(-square(above.max(0.0))) / (1.0 - 2.0 * above.min(0.0)).sqrt();
            let night = if met { smoothstep(-sun_height, 0.1, 0.25) * layer } else { 0.0 };
            let through = OPTICAL_DEPTH.map(|depth| exp(-2.0 * HORIZON_AIR_MASS * depth * air));
            for k in 0..3 {
                let glow = (1.0 - through[k]) * sky[k] + AIRGLOW[k] * night;
                radiance[k][n] = glow * behind[n];
            }
            behind[n] *= through[1];
        }
    }

    /// Ground, sea, clouds and the air before them.
    #[inline(always)]
    fn surface(&self, rays: &Block3, along: &Block) -> Block3 {
        let (mut place, mut fixed) = ([[0.0; BLOCK]; 3], [[0.0; BLOCK]; 3]);
        let mut height = [0.0; BLOCK];
        for n in 0..BLOCK {
            let ray = lane(rays, n);
            let chord = (along[n] * along[n] - self.horizon).max(0.0).sqrt();
            let at = unit(std::array::from_fn(|k| ray[k] * (along[n] - chord) + self.camera[k]));
            height[n] = dot(self.earth.sun, at);
            for k in 0..3 {
                place[k][n] = at[k];
                fixed[k][n] = dot(self.earth.ground[k], at);
            }
        }
        let mut out = [[0.0; BLOCK]; 3];
        if height.iter().any(|height| *height > 0.0) {
            self.add_day(rays, &place, &fixed, &height, &mut out);
        }
        if height.iter().any(|height| *height < 0.0) {
            self.add_cities(&fixed, &height, &mut out);
        }
        for n in 0..BLOCK {
            let (ray, at) = (lane(rays, n), lane(&place, n));
            let path = 1.0 / ((-dot(ray, at)).max(0.0) + 1.0 / HORIZON_AIR_MASS);
            let sky = self.sky(ray, height[n]);
            for k in 0..3 {
                let through = exp(-OPTICAL_DEPTH[k] * path);
                out[k][n] = out[k][n] * through + (1.0 - through) * sky[k];
            }
        }
        out
    }

    /// Sunlight off ground, sea and clouds, without the air before them.
    #[inline(always)]
    fn add_day(
        &self,
        rays: &Block3,
        place: &Block3,
        fixed: &Block3,
        height: &Block,
        out: &mut Block3,
    ) {
        let cover = self.cover(fixed);
        for n in 0..BLOCK {
            let light = height[n].max(0.0);
            // Half of the air: much of what is bright are clouds, and they lie high.
            let path = (0.5 / (light + 0.03)).min(15.0);
            let glint = cover.sea[n] * self.glint(lane(rays, n), lane(place, n));
            for k in 0..3 {
                out[k][n] += (cover.albedo[k][n] + glint) * light * exp(-OPTICAL_DEPTH[k] * path);
            }
        }
    }

    /// Light that endless air would scatter: white by day, red when the sun is low.
    #[inline(always)]
    fn sky(&self, ray: Vec3, sun_height: f32) -> Vec3 {
        let rise = smoothstep(sun_height, -0.12, 0.22);
        let path = (1.0 / (rise + 0.07) - 1.0 / 1.07).min(12.0);
        let cosine = dot(self.earth.sun, ray);
        // Rayleigh's phase function and some forward scattering by haze.
        let forward = square(square(square(cosine.max(0.0))));
        let strength = SKY_LIGHT * rise * (0.75 * (1.0 + cosine * cosine) + 0.4 * forward);
        OPTICAL_DEPTH.map(|depth| exp(-depth * path) * strength)
    }

    /// Mirror of the sun on the sea, as a factor of the light that falls in.
    #[inline(always)]
    fn glint(&self, ray: Vec3, place: Vec3) -> f32 {
        let half = unit(std::array::from_fn(|k| self.earth.sun[k] - ray[k]));
        let facing = dot(half, place).max(0.0);
        let lobe = facing * facing * (WAVE_SLOPE - 1.0) + 1.0;
        let grazing = 1.0 - dot(self.earth.sun, half).clamp(0.0, 1.0);
        let fresnel = 0.02 + 0.98 * square(square(grazing)) * grazing;
        let view = (-dot(ray, place)).max(0.0) + 0.15;
        (fresnel * WAVE_SLOPE / (lobe * lobe) / (4.0 * view)).min(4.0)
    }

    #[inline(always)]
    fn cover(&self, fixed: &Block3) -> Cover {
        let weather = self.weather.fractal(&scaled(fixed, 4.0, 0.0));
        let mut swirl = scaled(fixed, 15.0, 0.0);
        for axis in &mut swirl {
            for n in 0..BLOCK {
                axis[n] += 1.3 * weather[n];
            }
        }
        let mut cloud = self.clouds.fractal(&swirl);
        let (mut cover, mut tops) = ([0.0; BLOCK], [0.0; BLOCK]);
        for n in 0..BLOCK {
            cloud[n] += 0.55 * weather[n];
            let part = smoothstep(cloud[n], 0.03, 0.36);
            cover[n] = part * part.sqrt().sqrt();
            tops[n] = CLOUD * (0.72 + 0.6 * smoothstep(cloud[n], 0.1, 1.0));
        }
        if cover.iter().any(|cover| *cover > 0.1) {
            let bumps = self.tops.fractal(&scaled(&swirl, 9.0, 0.0));
            for n in 0..BLOCK {
                tops[n] *= 1.0 + 0.45 * smoothstep(cover[n], 0.1, 0.3) * bumps[n];
            }
        }
        if cover.iter().all(|cover| *cover >= 1.0) {
            return Cover { albedo: [tops; 3], sea: [0.0; BLOCK] };
        }
        let (mut albedo, mut sea) = self.ground(fixed, &weather);
        for n in 0..BLOCK {
            for axis in &mut albedo {
                axis[n] = mix(axis[n], tops[n], cover[n]);
            }
            sea[n] *= 1.0 - cover[n];
        }
        Cover { albedo, sea }
    }

    /// Albedo under the clouds, and how much of it is sea.
    #[inline(always)]
    fn ground(&self, fixed: &Block3, weather: &Block) -> (Block3, Block) {
        let relief = self.relief.fractal(&scaled(fixed, 2.6, 31.0));
        let (mut albedo, mut sea) = ([[0.0; BLOCK]; 3], [0.0; BLOCK]);
        for n in 0..BLOCK {
            let land = smoothstep(relief[n], 0.045, 0.055);
            let dry = smoothstep(weather[n] + 1.5 * relief[n], 0.0, 0.5);
            let ice = smoothstep(fixed[2][n].abs() + 0.25 * relief[n], 0.90, 0.94);
            for k in 0..3 {
                let soil = mix(FOREST[k], DESERT[k], dry) * (0.7 + 2.0 * relief[n]);
                albedo[k][n] = mix(mix(OCEAN[k], soil, land), ICE[k], ice);
            }
            sea[n] = (1.0 - land) * (1.0 - ice);
        }
        if sea.iter().any(|sea| *sea < 1.0) {
            let texture = self.ground.fractal(&scaled(fixed, 90.0, 0.0));
            for n in 0..BLOCK {
                let rough = 1.0 + 0.9 * (1.0 - sea[n]) * texture[n];
                for axis in &mut albedo {
                    axis[n] *= rough;
                }
            }
        }
        (albedo, sea)
    }

    /// Lights on the night side.
    #[inline(always)]
    fn add_cities(&self, fixed: &Block3, height: &Block, out: &mut Block3) {
        let coast = self.coast.fractal(&scaled(fixed, 2.6, 31.0));
        if coast.iter().all(|coast| *coast < 0.04) {
            return;
        }
        let region = self.regions.fractal(&scaled(fixed, 30.0, 0.0));
        let street = self.streets.fractal(&scaled(fixed, 260.0, 0.0));
        for n in 0..BLOCK {
            let street = smoothstep(street[n], 0.05, 0.7);
            let bright = smoothstep(region[n], 0.05, 0.6)
                * street
                * street
                * smoothstep(coast[n], 0.04, 0.08)
                * smoothstep(-height[n], 0.02, 0.15);
            for k in 0..3 {
                out[k][n] += CITY[k] * bright;
            }
        }
    }
}

#[inline(always)]
fn lane(block: &Block3, n: usize) -> Vec3 {
    [block[0][n], block[1][n], block[2][n]]
}

#[inline(always)]
fn scaled(block: &Block3, scale: f32, shift: f32) -> Block3 {
    let mut out = *block;
    out.iter_mut().flatten().for_each(|x| *x = *x * scale + shift);
    out
}

#[inline(always)]
fn dot(a: Vec3, b: Vec3) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
fn unit(a: Vec3) -> Vec3 {
    let scale = 1.0 / dot(a, a).sqrt();
    a.map(|x| x * scale)
}

#[inline(always)]
fn square(x: f32) -> f32 {
    x * x
}

#[inline(always)]
fn mix(first: f32, second: f32, part: f32) -> f32 {
    first + (second - first) * part
}

/// 0 below `low`, 1 above `high`, smooth between.
#[inline(always)]
fn smoothstep(x: f32, low: f32, high: f32) -> f32 {
    let part = ((x - low) / (high - low)).clamp(0.0, 1.0);
    part * part * (3.0 - 2.0 * part)
}

/// `e^x` for x ≤ 0, to a few parts in 10⁷; the library's would not be in vectors, nor the same everywhere.
#[inline(always)]
fn exp(x: f32) -> f32 {
    const WHOLE: f32 = 12_582_912.0;
    let x = x.max(-87.0) * std::f32::consts::LOG2_E;
    let sum = x + WHOLE;
    let part = (x - (sum - WHOLE)) * std::f32::consts::LN_2;
    let series = [1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0];
    let mut power = 0.0;
    for term in series {
        power = power * part + term;
    }
    power * f32::from_bits(sum.to_bits().wrapping_add(127) << 23)
}
