//! The Earth's light against geometry; its formulas are compared with NumPy's in the Python tests.

use ffpose_core::Error;
use ffpose_scene::earth::{Earth, Seen, shade};
use ndarray::{Array, ArrayD, Axis};

/// An Earth ahead whose horizon is asin(1 / 1.0628) = 70.21 degrees from the middle.
fn earth(sun: [f32; 3]) -> Earth {
    let ground = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    Earth { nadir: [0.0, 0.0, 1.0], altitude: 0.0628, sun, ground, detail: 6, pixel_angle: 1e-3 }
}

/// Rays so many degrees from nadir, as `(3, N)`.
fn rays(degrees: &[f32]) -> ArrayD<f32> {
    let component = |(axis, n): (usize, usize)| {
        let (sin, cos) = degrees[n].to_radians().sin_cos();
        [sin, 0.0, cos][axis]
    };
    Array::from_shape_fn((3, degrees.len()), component).into_dyn()
}

fn seen(sun: [f32; 3], degrees: &[f32]) -> Seen {
    shade(&earth(sun), rays(degrees).view()).unwrap()
}

const BEHIND: [f32; 3] = [0.0, 0.0, -1.0];

#[test]
fn the_earth_ends_at_the_horizon() {
    let seen = seen(BEHIND, &[0.0, 40.0, 69.9, 76.0, 120.0, 180.0]);
    assert_eq!(seen.behind.to_vec(), [0.0, 0.0, 0.0, 1.0, 1.0, 1.0]);
    for (n, light) in seen.radiance.columns().into_iter().enumerate() {
        assert!(light.iter().all(|light| if n < 3 { *light > 0.01 } else { *light == 0.0 }));
    }
}

#[test]
fn the_limb_is_blue_by_day_and_green_by_night() {
    let day = seen(BEHIND, &[70.6]);
    assert!(day.radiance[[2, 0]] > day.radiance[[1, 0]] && day.behind[0] > 0.0);
    // 90 km up: acos(1.0141 / 1.0628) from the horizontal is 72.6 degrees from nadir.
    let night = seen([0.0, 0.0, 1.0], &[70.6, 72.6]);
    let [low, high] = [0, 1].map(|n| night.radiance.column(n));
    assert!(high[1] > high[0] && high[1] > high[2] && high[1] > low[1]);
}

#[test]
fn a_ray_to_the_middle_is_finite_beside_one_through_the_limb() {
    let seen = seen(BEHIND, &[0.0, 70.6]);
    assert!(seen.radiance.iter().all(|light| light.is_finite()), "{}", seen.radiance);
    assert!(seen.radiance[[1, 0]] > 0.01);
}

#[test]
fn places_of_rays_do_not_matter() {
    let degrees: Vec<f32> = (0..100).map(|n| 0.75 * n as f32).collect();
    let together = seen([0.6, 0.0, -0.8], &degrees);
    for n in [0, 31, 32, 63, 99] {
        let alone = seen([0.6, 0.0, -0.8], &degrees[n..=n]);
        assert_eq!(together.radiance.column(n), alone.radiance.column(0));
    }
}

#[test]
fn rays_of_another_shape_are_named() {
    let result = shade(&earth(BEHIND), rays(&[0.0, 1.0]).t());
    assert!(matches!(result, Err(Error::Shape { name: "rays", .. })));
}

#[test]
fn rays_and_earths_that_are_not_finite_are_named() {
    let degrees = [0.0, 30.0, 60.0, 180.0];
    for bad in [f32::NAN, f32::INFINITY] {
        for axis in 0..3 {
            let mut rays = rays(&degrees);
            rays[[axis, 2]] = bad;
            let got: Vec<f32> = rays.index_axis(Axis(1), 2).iter().copied().collect();
            let error = shade(&earth(BEHIND), rays.view()).unwrap_err();
            let expected = format!("rays must be finite, got {got:?} in column 2");
            assert_eq!(error.to_string(), expected);
        }
        let good = earth(BEHIND);
        let mut ground = good.ground;
        ground[1][2] = bad;
        for (name, earth) in [
            ("nadir", Earth { nadir: [0.0, bad, 1.0], ..good }),
            ("sun", Earth { sun: [bad, 0.0, 1.0], ..good }),
            ("ground", Earth { ground, ..good }),
            ("altitude", Earth { altitude: bad, ..good }),
            ("pixel_angle", Earth { pixel_angle: bad, ..good }),
        ] {
            let error = shade(&earth, rays(&degrees).view()).unwrap_err();
            assert!(matches!(error, Error::Vector { name: got, .. } if got == name), "{error}");
        }
    }
    for altitude in [0.0, -0.1] {
        let error = shade(&Earth { altitude, ..earth(BEHIND) }, rays(&degrees).view()).unwrap_err();
        let expected = format!("altitude must be finite and above zero, got [{altitude:?}]");
        assert_eq!(error.to_string(), expected);
    }
}
