//! The way to a touch and away from it, each leg checked: travel of axes, and the probe against what stands on the table.

use abbe_core::{Axis, AxisKind, Error, KinematicModel, Result, Target};
use abbe_estimation::InverseKinematics;
use nalgebra::Vector3;

use crate::settings::{Clearance, Measuring};
use crate::solid::Solid;
use crate::touch::{Touch, Touches};
use crate::world::{Except, SOLID, World};

/// Why there is no way.
pub enum Refusal {
    /// The touch cannot be reached; the reason follows "touch 3: ".
    Reason(String),
    /// The model failed.
    Failed(Error),
}

impl From<Error> for Refusal {
    fn from(error: Error) -> Self {
        Self::Failed(error)
    }
}

fn reason<T>(text: impl Into<String>) -> Result<T, Refusal> {
    Err(Refusal::Reason(text.into()))
}

/// A part of the way, as the status at its end.
#[derive(Debug, Clone, PartialEq)]
pub enum Leg {
    /// All linear axes.
    Move(Vec<f64>),
    /// One linear axis, from wherever the machine stands before the program begins.
    First(usize, Vec<f64>),
    /// The rotary axes.
    Swing(Vec<f64>),
}

/// The statuses of a touch.
#[derive(Debug, Clone, PartialEq)]
pub struct Stop {
    /// From where the tip comes down.
    above: Vec<f64>,
    /// Where it comes down to, so that axes that stand during the touch have come from the planned side; then it goes to `approach`.
    before: Vec<f64>,
    /// Where the touch begins.
    pub approach: Vec<f64>,
    /// Where it gives up.
    pub end: Vec<f64>,
    /// Where the tip goes up to.
    pub retreat: Vec<f64>,
    /// From which side each axis comes.
    directions: Vec<Option<f64>>,
}

/// Everything that ways are made from.
pub struct Path<'a> {
    settings: &'a Measuring,
    world: World<'a>,
    axes: &'a [Axis],
    /// The axis of a plane of clearance.
    retract: Option<usize>,
    sphere: Option<Solid>,
    lift: f64,
    dry: bool,
}

/// An axis that moves less than this during a touch stands, mm.
const STANDS: f64 = 1e-4;

/// Rounding beyond the end of a travel that is none, mm or rad.
const AT_END: f64 = 1e-6;

impl<'a> Path<'a> {
    pub fn new(
        settings: &'a Measuring,
        touches: &Touches,
        targets: &[Target],
        model: &'a dyn KinematicModel,
        lift: Option<f64>,
    ) -> Result<Self> {
        let axes = &model.info().axes;
        let mut solids = touches.solids(targets, model.info().stylus_radius, settings.facets);
        let numbered = settings.solids.iter().enumerate();
        solids.extend(numbered.map(|(index, solid)| (format!("{SOLID}{} of `solids`", index + 1), *solid)));
        let (retract, sphere) = match &settings.clearance {
            Clearance::Plane { axis: name, at_mm } => {
                let is_it = |axis: &Axis| axis.name == *name && axis.kind == AxisKind::Linear;
                let Some(index) = axes.iter().position(is_it) else {
                    let linear = axes.iter().filter(|axis| axis.kind == AxisKind::Linear);
                    let error = Error::usage(format!("the machine has no linear axis {name}")).setting("clearance");
                    return Err(error.suggest(name, linear.map(|axis| axis.name.as_str())));
                };
                if let Some(far) = beyond(&axes[index], *at_mm) {
                    return Err(
                        Error::usage(format!("the plane of clearance is out of reach: {far}")).setting("clearance")
                    );
                }
                (Some(index), None)
            }
            Clearance::Sphere { centre_mm, radius_mm } => {
                (None, Some(Solid::Sphere { centre_mm: *centre_mm, radius_mm: *radius_mm }))
            }
        };
        let world = World::new(model, &settings.probe, solids, settings.margin_mm);
        let (dry, lift) = (lift.is_some(), lift.unwrap_or_default());
        Ok(Self { settings, world, axes, retract, sphere, lift, dry })
    }

    /// The statuses of a touch, with the way down and up checked.
    pub fn stop(&self, touch: &Touch) -> Result<Stop, Refusal> {
        let place = self.world.place(&touch.status)?;
        let contact_tip = place.tip + self.lift * place.up;
        let contact = self.reach(&touch.status, contact_tip, "the place of the touch")?;
        let normal = touch.normal;
        let approach =
            self.reach(&contact, contact_tip + self.settings.approach_mm * normal, "the beginning of the touch")?;
        let end = self.reach(&contact, contact_tip - self.settings.overtravel_mm * normal, "the end of the touch")?;
        let before = self.before(touch, &approach, &end)?;
        let (above, retreat) = (self.lifted(&before)?, self.lifted(&approach)?);
        for status in [&approach, &end, &before, &above, &retreat] {
            self.in_travel(status)?;
        }
        let surface = place.tip - self.world.model.info().stylus_radius * normal;
        let met = self.world.touched(&touch.feature, surface, normal);
        let touched = Except { touched: &met, ..Except::default() };
        let ignored = Except { ignored: &met, ..Except::default() };
        self.clear(&above, &before, Except::default(), "on the way down")?;
        self.clear(&before, &approach, Except::default(), "on the way to the beginning of the touch")?;
        self.clear(&approach, &contact, touched, "during the touch")?;
        self.clear(&contact, &end, ignored, "beyond the nominal contact")?;
        self.clear(&approach, &retreat, Except::default(), "on the way up")?;
        Ok(Stop { above, before, approach, end, retreat, directions: touch.directions.clone() })
    }

    /// From above one touch to the beginning of the next; from wherever the machine stands to the first.
    pub fn way(&self, last: Option<&Stop>, stop: &Stop) -> Result<Vec<Leg>, Refusal> {
        let mut legs = Vec::new();
        match last {
            None => {
                legs.extend(self.retract.map(|axis| Leg::First(axis, stop.above.clone())));
                legs.extend(self.turns(&stop.above, stop)?.into_iter().map(Leg::Swing));
            }
            Some(last) => {
                let mut at = last.retreat.clone();
                let rotary = self.axes.iter().enumerate().filter(|(_, axis)| axis.kind == AxisKind::Rotary);
                let differs = |(index, axis): (usize, &Axis)| {
                    at[axis.status] != stop.above[axis.status] || last.directions[index] != stop.directions[index]
                };
                if rotary.into_iter().any(differs) {
                    at = self.swing(at, stop, &mut legs)?;
                }
                self.clear(&at, &stop.above, Except::default(), "on the way from the touch before")?;
            }
        }
        legs.extend([Leg::Move(stop.above.clone()), Leg::Move(stop.before.clone()), Leg::Move(stop.approach.clone())]);
        Ok(legs)
    }

    /// Statuses at which rotary axes turn: beside their positions, where the plan has a side, and at them.
    fn turns(&self, at: &[f64], stop: &Stop) -> Result<Vec<Vec<f64>>, Refusal> {
        let (mut beside, mut there) = (at.to_vec(), at.to_vec());
        for (index, axis) in self.axes.iter().enumerate().filter(|(_, axis)| axis.kind == AxisKind::Rotary) {
            there[axis.status] = stop.above[axis.status];
            let side = stop.directions[index].unwrap_or(0.0);
            beside[axis.status] = stop.above[axis.status] - side * self.settings.overshoot_deg.to_radians();
        }
        self.in_travel(&beside)?;
        Ok(if beside == there { vec![there] } else { vec![beside, there] })
    }

    /// Turns the rotary axes where nothing is in the way; gives where the machine stands then.
    fn swing(&self, at: Vec<f64>, stop: &Stop, legs: &mut Vec<Leg>) -> Result<Vec<f64>, Refusal> {
        let heights: &[f64] = if self.sphere.is_some() { &[0.0, 0.5, 1.0, 2.0] } else { &[0.0] };
        let radius = match self.sphere {
            Some(Solid::Sphere { radius_mm, .. }) => radius_mm,
            _ => 0.0,
        };
        let except = Except { further: self.sphere.as_ref(), ..Except::default() };
        let mut refused = None;
        for height in heights {
            let place = self.world.place(&at)?;
            let tried = self.reach(&at, place.tip + height * radius * place.up, "a place to turn the rotary axes");
            let raised = match tried {
                Ok(raised) => raised,
                Err(refusal) => return Err(refused.unwrap_or(refusal)),
            };
            let turns = self.turns(&raised, stop)?;
            let mut from = &raised;
            let mut clear = self.clear(&at, &raised, except, "on the way up");
            for turn in &turns {
                clear = clear.and_then(|()| self.clear(from, turn, except, "while rotary axes move"));
                from = turn;
            }
            match clear {
                Ok(()) => {
                    let turned = from.clone();
                    legs.push(Leg::Move(raised.clone()));
                    legs.extend(turns.into_iter().map(Leg::Swing));
                    let lifted = self.lifted(&turned)?;
                    self.in_travel(&lifted)?;
                    self.clear(&turned, &lifted, Except::default(), "after rotary axes have moved")?;
                    legs.push(Leg::Move(lifted.clone()));
                    return Ok(lifted);
                }
                Err(failed @ Refusal::Failed(_)) => return Err(failed),
                Err(refusal) => refused = refused.or(Some(refusal)),
            }
        }
        Err(refused.unwrap_or_else(|| Refusal::Reason("rotary axes cannot move".to_owned())))
    }

    /// Where the linear axes bring the tip to a point.
    fn reach(&self, status: &[f64], tip: Vector3<f64>, what: &str) -> Result<Vec<f64>, Refusal> {
        let inverse = InverseKinematics::new(self.world.model, self.world.values(), None);
        match inverse.solve(vec![status.to_vec()], &[tip.into()])?.pop().flatten() {
            Some(status) => Ok(status),
            None => reason(format!("the linear axes do not reach {what}")),
        }
    }

    /// Where the tip comes down to: standing axes with a side are beside their positions.
    fn before(&self, touch: &Touch, approach: &[f64], end: &[f64]) -> Result<Vec<f64>, Refusal> {
        let mut before = approach.to_vec();
        for (index, axis) in self.axes.iter().enumerate().filter(|(_, axis)| axis.kind == AxisKind::Linear) {
            let Some(side) = touch.directions[index] else { continue };
            let moves = end[axis.status] - approach[axis.status];
            if moves.abs() < STANDS {
                before[axis.status] -= side * self.settings.overshoot_mm;
            } else if moves * side < 0.0 {
                return reason(format!("{} touches in the direction that is not the planned one", axis.name));
            }
        }
        Ok(before)
    }

    /// Where nothing is in the way, straight up from a status.
    fn lifted(&self, status: &[f64]) -> Result<Vec<f64>, Refusal> {
        let place = self.world.place(status)?;
        match (self.retract, &self.settings.clearance) {
            (Some(axis), Clearance::Plane { at_mm, .. }) => {
                let mut lifted = status.to_vec();
                lifted[self.axes[axis].status] = *at_mm;
                let up = (self.world.place(&lifted)?.tip - place.tip).dot(&place.up);
                match up >= -AT_END {
                    true => Ok(lifted),
                    // A dry run may be higher than the plane.
                    false if self.dry => Ok(status.to_vec()),
                    false => {
                        reason(format!("it lies beyond the plane of clearance, {} at {at_mm} mm", self.axes[axis].name))
                    }
                }
            }
            (_, Clearance::Sphere { centre_mm, radius_mm }) => {
                let outside = radius_mm + self.world.model.info().stylus_radius + self.settings.margin_mm;
                let up = outside - (place.tip - Vector3::from(*centre_mm)).dot(&place.up);
                if up <= 0.0 {
                    return Ok(status.to_vec());
                }
                self.reach(status, place.tip + up * place.up, "the outside of the sphere of clearance")
            }
            (None, Clearance::Plane { .. }) => Ok(status.to_vec()),
        }
    }

    fn in_travel(&self, status: &[f64]) -> Result<(), Refusal> {
        match self.axes.iter().find_map(|axis| beyond(axis, status[axis.status])) {
            Some(far) => reason(far),
            None => Ok(()),
        }
    }

    fn clear(&self, from: &[f64], to: &[f64], except: Except<'_>, when: &str) -> Result<(), Refusal> {
        match self.world.meets(from, to, except)? {
            Some(met) => reason(format!("{when} {met}")),
            None => Ok(()),
        }
    }
}

/// Says that an axis cannot stand there, mm or rad.
fn beyond(axis: &Axis, place: f64) -> Option<String> {
    let [from, to] = axis.range.filter(|_| !axis.endless)?;
    if (from - AT_END..=to + AT_END).contains(&place) {
        return None;
    }
    let (factor, unit) = if axis.kind == AxisKind::Rotary { (1f64.to_degrees(), "degrees") } else { (1.0, "mm") };
    let [place, from, to] = [place, from, to].map(|value| (value * factor * 1e3).round() / 1e3);
    Some(format!("{} would stand at {place} {unit}; it goes from {from} to {to}", axis.name))
}
