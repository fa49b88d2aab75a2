//! Whether the probe stays clear of everything while the nominal machine moves.

use abbe_core::{AxisKind, KinematicModel, Poses, Result};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use crate::settings::Section;
use crate::solid::Solid;

/// The probe and what it must not meet, table frame.
pub struct World<'a> {
    pub(crate) model: &'a dyn KinematicModel,
    values: Vec<f64>,
    probe: &'a [Section],
    /// Solids with their names.
    solids: Vec<(String, Solid)>,
    margin: f64,
}

/// Where the probe is, table frame.
#[derive(Debug, Clone, Copy)]
pub struct Place {
    /// Centre of the tip.
    pub tip: Vector3<f64>,
    /// Unit vector from the tip to the spindle.
    pub up: Vector3<f64>,
}

/// Which solids a move is checked against.
#[derive(Debug, Clone, Copy, Default)]
pub struct Except<'a> {
    /// What is touched ([`World::touched`]): the tip may meet it, and the rest of the probe may be nearer to it than the margin.
    pub touched: &'a [&'a str],
    /// What is not looked at: beyond contact with it the probe has stopped.
    pub ignored: &'a [&'a str],
    /// A further solid, such as a sphere of clearance.
    pub further: Option<&'a Solid>,
}

/// Shortest step along a move, as a part of it.
const LEAST_STEP: f64 = 1.0 / 4096.0;

/// Distance along a move between two checks where nothing can be near in between, mm.
const SHORT: f64 = 0.2;

/// Largest sum of turns of rotary axes in a step, rad: an arc is then hardly longer than its chord.
const ARC: f64 = 0.1;

/// A solid that stands out of the plane of contact by less is flush with it, mm.
const FLUSH: f64 = 0.01;

/// How names of solids of the settings begin; others are those of features.
pub const SOLID: &str = "solid ";

/// Distances beyond this are not computed exactly, mm.
const FAR: f64 = 40.0;

impl<'a> World<'a> {
    pub(crate) fn new(
        model: &'a dyn KinematicModel,
        probe: &'a [Section],
        solids: Vec<(String, Solid)>,
        margin: f64,
    ) -> Self {
        Self { model, values: model.info().without_errors(), probe, solids, margin }
    }

    /// Values of the parameters of the nominal machine.
    pub(crate) fn values(&self) -> &[f64] {
        &self.values
    }

    /// Where the probe is.
    pub fn place(&self, status: &[f64]) -> Result<Place> {
        let mut poses = Poses::default();
        self.model.poses(status, &self.values, &[], true, &mut poses)?;
        let [w, x, y, z] = poses.orientations[0];
        let up = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)) * Vector3::z();
        Ok(Place { tip: poses.positions[0].into(), up })
    }

    /// What a touch at this point meets: the feature, and the solids that it is a face of. These lie behind the plane of contact, and
    /// come nearer to the point than the margin.
    pub fn touched<'s>(&'s self, feature: &'s str, point: Vector3<f64>, normal: Vector3<f64>) -> Vec<&'s str> {
        let is_face_of = |(_, solid): &&(String, Solid)| {
            let before = solid.support(normal) - point.dot(&normal);
            before < FLUSH && (solid.nearest(point) - point).norm() < self.margin
        };
        let behind = self.solids.iter().filter(is_face_of).map(|(name, _)| name.as_str());
        [feature].into_iter().chain(behind.filter(|name| name.starts_with(SOLID))).collect()
    }

    /// What the probe comes too near to on a move, all axes in proportion; none if it stays clear.
    pub fn meets(&self, from: &[f64], to: &[f64], except: Except<'_>) -> Result<Option<String>> {
        let at = |part: f64| -> Vec<f64> { from.iter().zip(to).map(|(a, b)| between(*a, *b, part)).collect() };
        let mut part = 0.0;
        let mut place = self.place(from)?;
        let end = self.place(to)?;
        let rotary = self.model.info().axes.iter().filter(|axis| axis.kind == AxisKind::Rotary);
        // From +0.0: an empty sum is -0.0, and the longest step would be negative.
        let turn = rotary.fold(0.0, |turn, axis| turn + (to[axis.status] - from[axis.status]).abs());
        loop {
            let clear = match self.clearance(&place, except) {
                Ok(clear) => clear,
                Err(name) => return Ok(Some(name)),
            };
            if part >= 1.0 {
                return Ok(None);
            }
            // The longest step on which no point of the probe moves further than it is clear.
            let allowed = clear.max(SHORT);
            let mut step = f64::min(1.0 - part, ARC / turn);
            loop {
                let next = if part + step >= 1.0 { end } else { self.place(&at(part + step))? };
                if step <= LEAST_STEP || self.moved(&place, &next) <= allowed {
                    place = next;
                    part += step;
                    break;
                }
                step /= 2.0;
            }
        }
    }

    /// How far a point of the probe moves, at most, between two places: twice the straight way, because it may go in an arc.
    fn moved(&self, one: &Place, other: &Place) -> f64 {
        let length: f64 = self.probe.iter().map(|section| section.length_mm).sum();
        let widest = self.probe.iter().map(|section| section.diameter_mm / 2.0).fold(0.0, f64::max);
        let turned = (other.up - one.up).norm();
        let top = (other.tip + length * other.up - one.tip - length * one.up).norm();
        let straight = (other.tip - one.tip).norm().max(top) + widest * turned;
        if turned > 1e-9 { 2.0 * straight } else { straight }
    }

    /// How far the probe may move in any direction; the name of what is too near.
    fn clearance(&self, place: &Place, except: Except<'_>) -> Result<f64, String> {
        let tip = Solid::Sphere { centre_mm: place.tip.into(), radius_mm: self.model.info().stylus_radius.max(1e-3) };
        let mut low = 0.0;
        let sections: Vec<Solid> = self
            .probe
            .iter()
            .map(|section| {
                let high = low + section.length_mm;
                let ends = [place.tip + low * place.up, place.tip + high * place.up];
                low = high;
                Solid::Cylinder { from_mm: ends[0].into(), to_mm: ends[1].into(), radius_mm: section.diameter_mm / 2.0 }
            })
            .collect();
        let further = except.further.map(|solid| ("the sphere of clearance".to_owned(), *solid));
        let mut least = FAR;
        for (name, solid) in self.solids.iter().chain(&further) {
            if except.ignored.contains(&name.as_str()) {
                continue;
            }
            let touched = except.touched.contains(&name.as_str());
            let margin = if touched || except.further == Some(solid) { 0.0 } else { self.margin };
            let parts = sections.iter().chain((!touched).then_some(&tip));
            for (index, part) in parts.enumerate() {
                let distance = part.distance(solid, FAR + margin);
                let what = if index < sections.len() { "the probe's shank" } else { "the tip" };
                if distance <= 0.0 || distance < margin - SLACK {
                    let solid = if except.further.is_some() && name.starts_with("the sphere") {
                        name.clone()
                    } else {
                        self.named(name)
                    };
                    return Err(format!("{what} would come to {distance:.2} mm from {solid}"));
                }
                least = least.min(distance - margin);
            }
        }
        Ok(least)
    }

    fn named(&self, name: &str) -> String {
        if name.starts_with(SOLID) { name.to_owned() } else { format!("feature {name}") }
    }
}

/// Rounding that is no collision, mm.
const SLACK: f64 = 1e-3;

/// Between two values of a status; what does not change may be NaN.
fn between(a: f64, b: f64, part: f64) -> f64 {
    if a == b || a.is_nan() { a } else { a + part * (b - a) }
}
