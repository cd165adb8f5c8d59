//! Rotations of an object that leave its look unchanged, modulo which a network tells attitudes.

use libm::{cos, fabs, sin, sqrt};
use nalgebra::{Quaternion, Unit, UnitQuaternion, Vector3};

use crate::error::Error;

/// The most turns about an axis.
const FOLD: u32 = 60;

/// The rotations of the largest finite group: those of a prism of 60 sides, about its axis and over it.
const ROTATIONS: usize = 2 * FOLD as usize;

/// The product of unit quaternions, or axes, that are taken for one: half a degree apart, a quarter.
const ALIKE: f64 = 0.999_990_5;

/// An axis about which turns leave the look unchanged.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axis {
    /// Along the object's axes, of any length.
    pub direction: [f64; 3],
    /// The turns are by 360 degrees divided by it; 0 for any angle.
    pub fold: u32,
}

/// The group of rotations that axes of symmetry generate.
///
/// With such a rotation `g`, along the object's axes, the attitudes `R` and `R g` give the same image.
#[derive(Clone, Debug, PartialEq)]
pub struct Symmetry {
    /// The first `count` are the group's, the identity first; with an axis of any angle they stand for all that differ by a turn
    /// about it.
    rotations: [UnitQuaternion<f64>; ROTATIONS],
    count: usize,
    any_angle: Option<Unit<Vector3<f64>>>,
}

impl Default for Symmetry {
    /// The identity alone, of an object whose attitudes all look different.
    fn default() -> Self {
        Self { rotations: [UnitQuaternion::identity(); ROTATIONS], count: 1, any_angle: None }
    }
}

impl Symmetry {
    /// The group that some axes generate; the identity alone without any.
    ///
    /// # Errors
    ///
    /// A number is out of range, or the axes go together in no finite group, or leave no attitude, as a sphere's.
    pub fn new(axes: &[Axis]) -> Result<Self, Error> {
        let mut group = Self::default();
        for axis in axes {
            let length = Vector3::from(axis.direction).norm();
            if !(length > 0.0 && length.is_finite()) || axis.fold > FOLD {
                let expected = "directions that are not zero, with 0 to 60 turns";
                return Err(Error::Symmetry { expected });
            }
        }
        let turns = || axes.iter().filter(|axis| axis.fold > 0).map(Axis::turn);
        let mut place = 0;
        while place < group.count {
            for turn in turns() {
                group.add(group.rotations[place] * turn)?;
            }
            place += 1;
        }
        let mut any_angle = axes.iter().filter(|axis| axis.fold == 0).map(Axis::unit);
        let Some(axis) = any_angle.next() else { return Ok(group) };
        let along = |turned: Unit<Vector3<f64>>| turned.dot(&axis);
        let rotations = || group.rotations[..group.count].iter();
        let one_axis = any_angle.all(|other| fabs(along(other)) > ALIKE);
        if !one_axis || rotations().any(|rotation| fabs(along(rotation * axis)) < ALIKE) {
            return Err(Error::Symmetry { expected: "axes that leave an attitude" });
        }
        // All others turn about the axis, or reverse it, and one that does stands for them.
        let reversed = rotations().find(|rotation| along(*rotation * axis) < 0.0).copied();
        let mut group = Self { any_angle: Some(axis), ..Self::default() };
        reversed.map_or(Ok(()), |rotation| group.add(rotation))?;
        Ok(group)
    }

    /// Whether all attitudes look different.
    pub(crate) fn is_trivial(&self) -> bool {
        self.count == 1 && self.any_angle.is_none()
    }

    /// Of the attitudes that look as `q` does the one that is nearest to any of some; itself without any.
    pub(crate) fn nearest(
        &self,
        q: &UnitQuaternion<f64>,
        wanted: impl Iterator<Item = UnitQuaternion<f64>>,
    ) -> UnitQuaternion<f64> {
        if self.is_trivial() {
            return *q;
        }
        let mut best = (UnitQuaternion::identity(), -1.0);
        for each in wanted {
            let between = q.inverse() * each;
            for rotation in &self.rotations[..self.count] {
                let found = self.closest(rotation, &between);
                if found.1 > best.1 {
                    best = found;
                }
            }
        }
        q * best.0
    }

    /// Of a rotation and those that differ from it by a turn of any angle the one nearest to another, and their product.
    fn closest(
        &self,
        rotation: &UnitQuaternion<f64>,
        other: &UnitQuaternion<f64>,
    ) -> (UnitQuaternion<f64>, f64) {
        let Some(axis) = &self.any_angle else { return (*rotation, product(rotation, other)) };
        // Of the turns `cos + axis sin` the product with `left` is largest where both are along its parts.
        let left = rotation.inverse() * other;
        let (cosine, sine) = (left.w, left.imag().dot(axis));
        let size = sqrt(cosine * cosine + sine * sine);
        if size == 0.0 {
            return (*rotation, 0.0); // all are equally far
        }
        let spin = Quaternion::from_parts(cosine, axis.into_inner() * sine);
        (rotation * UnitQuaternion::new_normalize(spin), size)
    }

    /// Adds a rotation that is not there yet.
    fn add(&mut self, rotation: UnitQuaternion<f64>) -> Result<(), Error> {
        if self.rotations[..self.count].iter().any(|each| product(each, &rotation) > ALIKE) {
            return Ok(());
        }
        let Some(place) = self.rotations.get_mut(self.count) else {
            return Err(Error::Symmetry { expected: "axes of a finite group" });
        };
        *place = rotation;
        self.count += 1;
        Ok(())
    }
}

impl Axis {
    fn unit(&self) -> Unit<Vector3<f64>> {
        Unit::new_normalize(Vector3::from(self.direction))
    }

    /// The smallest of its turns.
    fn turn(&self) -> UnitQuaternion<f64> {
        let half = core::f64::consts::PI / f64::from(self.fold);
        let axis = self.unit().into_inner();
        UnitQuaternion::new_normalize(Quaternion::from_parts(cos(half), axis * sin(half)))
    }
}

/// The product of unit quaternions: the cosine of half the angle between two rotations.
pub(crate) fn product(one: &UnitQuaternion<f64>, other: &UnitQuaternion<f64>) -> f64 {
    fabs(one.coords.dot(&other.coords))
}

#[cfg(test)]
mod tests {
    use core::f64::consts::PI;

    use super::*;

    fn group(axes: &[([f64; 3], u32)]) -> Result<Symmetry, Error> {
        let mut all = [Axis { direction: [1.0, 0.0, 0.0], fold: 1 }; 3];
        for (place, (direction, fold)) in all.iter_mut().zip(axes) {
            *place = Axis { direction: *direction, fold: *fold };
        }
        Symmetry::new(&all[..axes.len()])
    }

    fn rotation(x: f64, y: f64, z: f64) -> UnitQuaternion<f64> {
        UnitQuaternion::from_scaled_axis(Vector3::new(x, y, z))
    }

    #[test]
    fn groups_have_as_many_rotations_as_solids() {
        for (axes, count) in [
            (&[][..], 1),
            (&[([0.0, 0.0, 2.0], 4)][..], 4), // a pyramid
            (&[([0.0, 0.0, 1.0], 2), ([1.0, 0.0, 0.0], 2)][..], 4), // a box
            (&[([0.0, 0.0, 1.0], 4), ([1.0, 0.0, 0.0], 4)][..], 24), // a cube
            (&[([0.0, 0.0, 1.0], 60), ([1.0, 0.0, 0.0], 2)][..], 120), // a prism
            (&[([1.0, 1.0, 1.0], 3), ([0.0, 0.0, 1.0], 2)][..], 12), // a tetrahedron
            (&[([0.0, 0.0, 1.0], 0), ([0.0, 0.0, 1.0], 4)][..], 1), // a cone
            (&[([0.0, 0.0, 1.0], 0), ([1.0, 0.0, 0.0], 2)][..], 2), // a cylinder
        ] {
            assert_eq!(group(axes).unwrap().count, count, "{axes:?}");
        }
    }

    #[test]
    fn axes_that_go_together_in_no_group_are_refused() {
        for (axes, message) in [
            (&[([0.0; 3], 2)][..], "not zero"),
            (&[([f64::NAN, 0.0, 1.0], 2)][..], "not zero"),
            (&[([0.0, 0.0, 1.0], 61)][..], "0 to 60 turns"),
            (&[([0.0, 0.0, 1.0], 7), ([1.0, 0.0, 0.0], 5)][..], "a finite group"),
            (&[([0.0, 0.0, 1.0], 0), ([1.0, 0.0, 0.0], 0)][..], "leave an attitude"),
            (&[([0.0, 0.0, 1.0], 0), ([1.0, 0.0, 1.0], 2)][..], "leave an attitude"),
        ] {
            let Err(Error::Symmetry { expected }) = group(axes) else { panic!("{axes:?}") };
            assert!(expected.contains(message), "{axes:?}: {expected}");
        }
    }

    #[test]
    fn the_nearest_attitude_is_that_of_a_search_through_all() {
        let (q, wanted) = (rotation(0.3, -1.9, 0.8), rotation(-1.2, 0.4, 1.5));
        let axis = Vector3::new(0.48, 0.6, 0.64);
        let across = Vector3::new(0.8, 0.0, -0.6);
        let cylinder = group(&[(axis.into(), 0), (across.into(), 2)]).unwrap();
        let found = cylinder.nearest(&q, [wanted].into_iter());
        let mut best = 0.0_f64;
        for step in 0..36_000 {
            let turn = UnitQuaternion::from_scaled_axis(axis * (f64::from(step) * PI / 18_000.0));
            for flip in [UnitQuaternion::identity(), UnitQuaternion::from_scaled_axis(across * PI)]
            {
                best = best.max(product(&(q * flip * turn), &wanted));
            }
        }
        assert!(fabs(product(&found, &wanted) - best) < 1e-8);
        let cube = group(&[([0.0, 0.0, 1.0], 4), ([1.0, 0.0, 0.0], 4)]).unwrap();
        let found = cube.nearest(&q, [wanted, q].into_iter());
        assert!(product(&found, &q) > 1.0 - 1e-12, "it is nearest to itself");
        let found = cube.nearest(&q, [wanted].into_iter());
        assert!(found.angle_to(&wanted) < 62.9_f64.to_radians(), "the farthest of 24");
        assert!(cube.rotations.iter().any(|each| product(&(q * each), &found) > 1.0 - 1e-12));
    }
}
