//! Simple convex solids, and the distance between two of them.

use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A solid that stands on the table, in the table frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Solid {
    /// A sphere.
    Sphere {
        /// Its centre.
        centre_mm: [f64; 3],
        /// Its radius.
        radius_mm: f64,
    },
    /// A box whose edges are parallel to the axes of the table frame.
    Box {
        /// The corner with the smallest coordinates.
        from_mm: [f64; 3],
        /// The corner with the largest coordinates.
        to_mm: [f64; 3],
    },
    /// A cylinder with flat ends.
    Cylinder {
        /// Centre of one end.
        from_mm: [f64; 3],
        /// Centre of the other end.
        to_mm: [f64; 3],
        /// Its radius.
        radius_mm: f64,
    },
}

impl Solid {
    /// What is wrong with its numbers.
    pub fn fault(&self) -> Option<&'static str> {
        let finite = |point: &[f64; 3]| point.iter().all(|part| part.is_finite());
        match self {
            Self::Sphere { centre_mm, radius_mm } => {
                (!finite(centre_mm) || *radius_mm <= 0.0 || !radius_mm.is_finite())
                    .then_some("a finite centre and a radius above 0 were expected")
            }
            Self::Box { from_mm, to_mm } => {
                let ordered = from_mm.iter().zip(to_mm).all(|(from, to)| from < to);
                (!finite(from_mm) || !finite(to_mm) || !ordered)
                    .then_some("every number of `from_mm` has to be below that of `to_mm`")
            }
            Self::Cylinder { from_mm, to_mm, radius_mm } => {
                let length = (Vector3::from(*to_mm) - Vector3::from(*from_mm)).norm();
                (length <= 0.0 || !length.is_finite() || *radius_mm <= 0.0 || !radius_mm.is_finite())
                    .then_some("two different ends and a radius above 0 were expected")
            }
        }
    }

    /// A sphere around it: centre and radius.
    pub fn bounds(&self) -> (Vector3<f64>, f64) {
        match *self {
            Self::Sphere { centre_mm, radius_mm } => (centre_mm.into(), radius_mm),
            Self::Box { from_mm, to_mm } => {
                let (from, to) = (Vector3::from(from_mm), Vector3::from(to_mm));
                ((from + to) / 2.0, (to - from).norm() / 2.0)
            }
            Self::Cylinder { from_mm, to_mm, radius_mm } => {
                let (from, to) = (Vector3::from(from_mm), Vector3::from(to_mm));
                ((from + to) / 2.0, ((to - from).norm() / 2.0).hypot(radius_mm))
            }
        }
    }

    /// The point of the solid that is nearest to a point.
    pub fn nearest(&self, point: Vector3<f64>) -> Vector3<f64> {
        match *self {
            Self::Sphere { centre_mm, radius_mm } => {
                let centre = Vector3::from(centre_mm);
                let from = point - centre;
                if from.norm() <= radius_mm { point } else { centre + from * (radius_mm / from.norm()) }
            }
            Self::Box { from_mm, to_mm } => Vector3::from_fn(|axis, _| point[axis].clamp(from_mm[axis], to_mm[axis])),
            Self::Cylinder { from_mm, to_mm, radius_mm } => {
                let (from, to) = (Vector3::from(from_mm), Vector3::from(to_mm));
                let length = (to - from).norm();
                let along = (to - from) / length;
                let height = (point - from).dot(&along);
                let across = point - from - height * along;
                let inside = if across.norm() <= radius_mm { across } else { across * (radius_mm / across.norm()) };
                from + height.clamp(0.0, length) * along + inside
            }
        }
    }

    /// How far the solid reaches along a unit vector, from the origin, mm.
    pub fn support(&self, along: Vector3<f64>) -> f64 {
        match *self {
            Self::Sphere { centre_mm, radius_mm } => along.dot(&Vector3::from(centre_mm)) + radius_mm,
            Self::Box { from_mm, to_mm } => {
                let further = |axis: usize| f64::max(along[axis] * from_mm[axis], along[axis] * to_mm[axis]);
                (0..3).map(further).sum()
            }
            Self::Cylinder { from_mm, to_mm, radius_mm } => {
                let (from, to) = (Vector3::from(from_mm), Vector3::from(to_mm));
                let across = along.cross(&(to - from).normalize()).norm();
                along.dot(&from).max(along.dot(&to)) + radius_mm * across
            }
        }
    }

    /// The distance to another solid, mm; 0 if they overlap. Distances beyond `enough` need not be exact: at least `enough` is given.
    pub fn distance(&self, other: &Self, enough: f64) -> f64 {
        let ((one, radius), (two, other_radius)) = (self.bounds(), other.bounds());
        let apart = (two - one).norm() - radius - other_radius;
        if apart >= enough {
            return apart;
        }
        // Alternating projections between convex sets end at the nearest pair of points (Cheney & Goldstein 1959).
        let (mut here, mut distance) = (self.nearest(two), f64::INFINITY);
        for _ in 0..STEPS {
            let there = other.nearest(here);
            here = self.nearest(there);
            let now = (there - here).norm();
            if distance - now < SMALL {
                return now;
            }
            distance = now;
        }
        distance
    }
}

/// Most projections: cylinders that touch along a line converge slowly, and then to much better than a tenth of a millimetre.
const STEPS: usize = 200;

/// A projection that brings less than this is the last one, mm.
const SMALL: f64 = 1e-6;

#[cfg(test)]
mod tests {
    use super::*;

    const BALL: Solid = Solid::Sphere { centre_mm: [0.0, 0.0, 0.0], radius_mm: 10.0 };

    #[test]
    fn distances_are_those_of_geometry() {
        let near = |one: &Solid, other: &Solid, expected: f64| {
            for distance in [one.distance(other, 1e3), other.distance(one, 1e3)] {
                assert!((distance - expected).abs() < 1e-3, "{one:?} {other:?}: {distance}, {expected} expected");
            }
        };
        near(&BALL, &Solid::Sphere { centre_mm: [30.0, 40.0, 0.0], radius_mm: 5.0 }, 35.0);
        let block = Solid::Box { from_mm: [20.0, -5.0, -5.0], to_mm: [40.0, 5.0, 5.0] };
        near(&BALL, &block, 10.0);
        near(&BALL, &Solid::Box { from_mm: [13.0, 14.0, -5.0], to_mm: [40.0, 50.0, 5.0] }, 365f64.sqrt() - 10.0);
        let rod = |from_mm, to_mm| Solid::Cylinder { from_mm, to_mm, radius_mm: 2.0 };
        near(&BALL, &rod([20.0, 0.0, -50.0], [20.0, 0.0, 50.0]), 8.0);
        // The flat end looks at the ball, then the rim.
        near(&BALL, &rod([0.0, 0.0, 15.0], [0.0, 0.0, 90.0]), 5.0);
        near(&BALL, &rod([20.0, 0.0, 15.0], [20.0, 0.0, 90.0]), 18f64.hypot(15.0) - 10.0);
        // Crossed rods, and a rod in a block.
        near(&rod([0.0, 0.0, -9.0], [0.0, 0.0, 9.0]), &rod([10.0, -9.0, 0.0], [10.0, 9.0, 0.0]), 6.0);
        near(&rod([0.0, 0.0, 0.0], [30.0, 0.0, 0.0]), &block, 0.0);
    }

    /// No point of a solid is farther along a direction, and the nearest one to a point far away is nearly as far.
    #[test]
    fn a_solid_reaches_as_far_as_its_farthest_point() {
        let solids = [
            BALL,
            Solid::Box { from_mm: [20.0, -5.0, -5.0], to_mm: [40.0, 5.0, 15.0] },
            Solid::Cylinder { from_mm: [3.0, -9.0, 2.0], to_mm: [20.0, 7.0, 50.0], radius_mm: 4.0 },
        ];
        for (trial, solid) in (0..300).flat_map(|trial| solids.iter().map(move |solid| (trial, solid))) {
            let angle = f64::from(trial) * 2.4;
            let z = f64::from(trial) / 150.0 - 1.0;
            let along = Vector3::new((1.0 - z * z).sqrt() * angle.cos(), (1.0 - z * z).sqrt() * angle.sin(), z);
            let farthest = solid.nearest(1e7 * along).dot(&along);
            assert!((solid.support(along) - farthest).abs() < 1e-3, "{solid:?} {along}: {farthest}");
        }
    }

    /// No point of one solid is nearer to the other than the distance: random pairs against random points.
    #[test]
    fn no_pair_of_points_is_nearer() {
        let mut state = 7u64;
        let mut random = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 11) as f64 / (1u64 << 53) as f64 * 2.0 - 1.0
        };
        for trial in 0..300 {
            let mut point = |size: f64| [random() * size, random() * size, random() * size];
            let (one, two, three) = (point(30.0), point(30.0), point(60.0));
            let a = Solid::Cylinder { from_mm: one, to_mm: two, radius_mm: 4.0 };
            let corner = [0, 1, 2].map(|axis| three[axis] + 8.0);
            let b = match trial % 3 {
                0 => Solid::Box { from_mm: three, to_mm: corner },
                1 => Solid::Cylinder { from_mm: three, to_mm: corner, radius_mm: 3.0 },
                _ => Solid::Sphere { centre_mm: three, radius_mm: 5.0 },
            };
            let distance = a.distance(&b, 1e3);
            let mut nearest = f64::INFINITY;
            for _ in 0..300 {
                let on_a = a.nearest(Vector3::from(point(80.0)));
                nearest = nearest.min((b.nearest(on_a) - on_a).norm());
            }
            assert!(distance <= nearest + 1e-3, "{a:?} {b:?}: {distance} {nearest}");
            assert!(a.distance(&b, distance / 2.0) >= distance / 2.0);
        }
    }
}
