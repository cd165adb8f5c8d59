//! Textures against values worked out by hand.

use ffpose_core::Error;
use ffpose_scene::textures::{Faces, Points, Texture, Wrap, sample};
use ndarray::{Array, ArrayD, IxDyn};

/// Bits of 0, 1/2, 1, -2 and of 2⁻²⁴, the smallest number of float16.
const ZERO: u16 = 0;
const HALF: u16 = 0x3800;
const ONE: u16 = 0x3c00;
const LESS: u16 = 0xc000;
const TINY: u16 = 1;

fn array<T: Clone>(shape: &[usize], values: &[T]) -> ArrayD<T> {
    Array::from_shape_vec(IxDyn(shape), values.to_vec()).unwrap()
}

/// The texture of `texels` on one face, read where its coordinates are, with the share of its mean, which is 1.
fn read(
    texels: &[[u16; 4]],
    sides: [u32; 2],
    wrap: Wrap,
    places: &[[f32; 2]],
    level: f32,
    share: f32,
) -> Result<Vec<f32>, Error> {
    let count = places.len();
    let texels = array(&[texels.len(), 4], texels.as_flattened());
    let corners: Vec<f32> = places.iter().flat_map(|place| place.repeat(3)).collect();
    let (corners, means) =
        (array(&[count, 6], &corners), array(&[count, 4], &vec![ONE; 4 * count]));
    let face = Array::from_iter((0..).take(count)).into_dyn();
    let weights = array(&[3, count], &vec![1.0 / 3.0; 3 * count]);
    let (levels, shares) =
        (array(&[count], &vec![level; count]), array(&[count], &vec![share; count]));
    let values = sample(
        &Texture { texels: texels.view(), sides, wrap: [wrap; 2] },
        &Faces { corners: corners.view(), means: means.view() },
        &Points {
            face: face.view(),
            weights: weights.view(),
            levels: levels.view(),
            shares: shares.view(),
        },
    )?;
    Ok(values.row(0).to_vec())
}

#[track_caller]
fn assert_close(got: &[f32], expected: &[f32]) {
    assert_eq!(got.len(), expected.len());
    for (got, expected) in got.iter().zip(expected) {
        assert!((got - expected).abs() <= 1e-6 * expected.abs(), "{got} is not {expected}");
    }
}

#[test]
fn between_texels_and_beyond_the_border() {
    let texels = [[ZERO; 4], [ONE; 4], [HALF; 4]];
    let at = |wrap, x: f32| read(&texels, [2, 1], wrap, &[[x, 0.5]], 0.0, 0.0).unwrap()[0];
    for (x, expected) in [(0.25, 0.0), (0.375, 0.25), (0.5, 0.5), (0.75, 1.0)] {
        for wrap in [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp] {
            assert_close(&[at(wrap, x)], &[expected]);
        }
    }
    for (x, expected) in [(1.0, 0.5), (1.25, 0.0), (-0.25, 1.0), (7.25, 0.0)] {
        assert_close(&[at(Wrap::Repeat, x)], &[expected]);
    }
    for (x, expected) in [(1.0, 1.0), (1.25, 1.0), (1.75, 0.0), (-0.25, 0.0), (3.0, 1.0)] {
        assert_close(&[at(Wrap::Mirror, x)], &[expected]);
    }
    for (x, expected) in [(1.0, 1.0), (9.0, 1.0), (-9.0, 0.0), (1e30, 1.0), (-1e30, 0.0)] {
        assert_close(&[at(Wrap::Clamp, x)], &[expected]);
    }
}

#[test]
fn the_nearest_level_is_read_and_mixed_with_the_mean() {
    let texels = [[ZERO; 4], [LESS; 4], [HALF; 4]];
    let at = |level, share| {
        read(&texels, [1, 2], Wrap::Repeat, &[[0.5, 0.75]], level, share).unwrap()[0]
    };
    for level in [f32::NEG_INFINITY, -3.0, 0.0, 0.4] {
        assert_close(&[at(level, 0.0)], &[-2.0]);
    }
    for level in [0.6, 1.0, 30.0, f32::INFINITY] {
        assert_close(&[at(level, 0.0)], &[0.5]);
    }
    assert_close(&[at(1.0, 0.25), at(1.0, 1.0)], &[0.625, 1.0]);
    assert!(at(f32::NAN, 0.0).is_finite());
}

#[test]
fn all_numbers_of_float16_are_widened_and_every_point_of_a_block_is_its_own() {
    let texels = [[TINY; 4], [LESS; 4], [HALF; 4], [ONE; 4], [ZERO; 4], [ZERO; 4], [ZERO; 4]];
    let places: Vec<[f32; 2]> = (0..75).map(|n| [(n % 4) as f32 / 4.0 + 0.125, 0.5]).collect();
    let values = read(&texels, [4, 1], Wrap::Clamp, &places, 0.0, 0.0).unwrap();
    let expected = [2.0_f32.powi(-24), -2.0, 0.5, 1.0];
    assert_close(&values, &expected.into_iter().cycle().take(75).collect::<Vec<_>>());
}

#[test]
fn what_does_not_fit_is_refused() {
    let texels = [[ONE; 4]; 3];
    let place = [[0.5, 0.5]];
    let error = read(&texels, [2, 2], Wrap::Clamp, &place, 0.0, 0.0).unwrap_err();
    assert_eq!(error, Error::shape("texels", "(5, 4)", &[3, 4]));
    let (corners, means) = (array(&[1, 6], &[0.5; 6]), array(&[1, 4], &[ONE; 4]));
    let one = array(&[1], &[0.0]);
    for (face, got) in [(-1, -1.0), (1, 1.0)] {
        let error = sample(
            &Texture {
                texels: array(&[3, 4], texels.as_flattened()).view(),
                sides: [2, 1],
                wrap: [Wrap::Clamp; 2],
            },
            &Faces { corners: corners.view(), means: means.view() },
            &Points {
                face: array(&[1], &[face]).view(),
                weights: array(&[3, 1], &[0.0; 3]).view(),
                levels: one.view(),
                shares: one.view(),
            },
        );
        let (name, expected) = ("face", "one of the faces of corners");
        let expected = Error::Vector { name, expected, got: vec![got], column: Some(0) };
        assert_eq!(error.unwrap_err(), expected);
    }
}
