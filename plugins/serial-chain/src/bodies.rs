//! Bodies between the frames of a chain: where they act, and the factor that multiplies what they do.

use abbe_core::{AxisKind, Branch, Parameter, ParameterRole, Quantity, SettingsError, Unit};
use abbe_errors::{Body, BodyKind, BodyTerms, Functions, Guide, Mount};
use abbe_kinematics::{Chain, ErrorFrame};
use nalgebra::Vector3;

use crate::builder::Builder;
use crate::model::{CoefficientPlace, ParameterUse, Source};

/// A frame of the chain that a body can carry, in the order from the bed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Frame {
    /// Where an axis is located.
    Axis(usize),
    Tool,
    Workpiece,
}

/// A branch from the bed outwards: its axes, and what is at its end.
fn frames(chain: &Chain, branch: Branch) -> Vec<Frame> {
    let on_it = (0..chain.axes().len()).filter(|axis| chain.axes()[*axis].branch == branch);
    match branch {
        Branch::Tool => on_it.map(Frame::Axis).chain([Frame::Tool]).collect(),
        Branch::Workpiece => {
            let mut frames: Vec<Frame> = on_it.map(Frame::Axis).collect();
            frames.reverse();
            frames.push(Frame::Workpiece);
            frames
        }
    }
}

fn name(chain: &Chain, frame: Frame) -> &str {
    match frame {
        Frame::Axis(axis) => &chain.axes()[axis].name,
        Frame::Tool => "tool",
        Frame::Workpiece => "workpiece",
    }
}

/// The nominal origin of a frame, machine coordinates with all axes at zero: the point of the last rotary axis up to it.
fn origin(chain: &Chain, branch: Branch, frame: Frame) -> Vector3<f64> {
    let frames = frames(chain, branch);
    let up_to = frames.iter().position(|other| *other == frame).map_or(0, |place| place + 1);
    let mut points = frames[..up_to].iter().filter_map(|frame| match frame {
        Frame::Axis(axis) => Some(&chain.axes()[*axis]).filter(|axis| axis.kind == AxisKind::Rotary),
        Frame::Tool | Frame::Workpiece => None,
    });
    points.next_back().map_or_else(Vector3::zeros, |axis| axis.point)
}

/// The frame that a body carries, and the one before it; none if that is the bed.
fn carried(chain: &Chain, from: &str, to: &str) -> Result<(Branch, Frame, Option<usize>), SettingsError> {
    let branches = [Branch::Tool, Branch::Workpiece].map(|branch| (branch, frames(chain, branch)));
    let is_frame = |wanted: &str| branches.iter().flat_map(|(_, frames)| frames).any(|it| name(chain, *it) == wanted);
    let known = || branches.iter().flat_map(|(_, frames)| frames).map(|frame| name(chain, *frame));
    for (setting, given, is_one) in [("from", from, from == "bed" || is_frame(from)), ("to", to, is_frame(to))] {
        if !is_one {
            let error = SettingsError::new(setting, format!("`{given}` is no frame of this chain"));
            return Err(error.suggest(given, std::iter::once("bed").chain(known())));
        }
    }
    for (branch, frames) in &branches {
        let Some(place) = frames.iter().position(|frame| name(chain, *frame) == to) else { continue };
        let before = place.checked_sub(1).map(|place| frames[place]);
        let carrier = before.map_or("bed", |frame| name(chain, frame));
        if carrier != from {
            let message = format!("a body lies between frames that follow one another; {to} follows {carrier}");
            return Err(SettingsError::new("from", message));
        }
        let axis = match before {
            Some(Frame::Axis(axis)) => Some(axis),
            _ => None,
        };
        return Ok((*branch, frames[place], axis));
    }
    Err(SettingsError::new("to", "no frame of this chain"))
}

impl Builder {
    /// Adds a body whose settings are checked, with its factor.
    pub fn body(&mut self, name: &str, body: &Body) -> Result<(), SettingsError> {
        if name.is_empty() || !name.chars().all(|letter| letter.is_alphanumeric() || "-_".contains(letter)) {
            return Err(SettingsError::new("", "a name of letters, digits, - and _ was expected"));
        }
        let (slot, mount, axis) = match body.kind()? {
            BodyKind::Between(from, to) => self.between(body, from, to)?,
            BodyKind::Guideway(axis) => self.along(axis, "guideway")?,
            BodyKind::Scale(axis) => self.along(axis, "scale")?,
        };
        let range = axis.and_then(|axis| self.axes[axis].range);
        let levels = body.logs.keys().cloned().collect();
        let labels = self.labels(body.series.as_deref(), levels);
        let terms = BodyTerms::new(body, mount, range, &labels)?;
        let components = terms.components();
        let mut arguments = Vec::new();
        for argument in terms.arguments() {
            arguments.push(Source::Status(self.argument(argument, axis)?));
        }
        let basis = self.basis(Box::new(terms), arguments, None);
        let unit = Unit::of(Quantity::Ratio);
        let factor = Parameter::new(format!("body[{name}].factor"), unit).with_role(ParameterRole::Factor);
        let parameter = self.parameter(factor, 1.0, ParameterUse::Factor(basis))?;
        let first = self.bases[basis].first;
        let place = |component| CoefficientPlace { slot, component, function: first + component, basis };
        let own = (0..6).filter(|component| components[*component]);
        self.bases[basis].coefficients = own.map(|component| (parameter, place(component))).collect();
        Ok(())
    }

    /// Slot and mount of a body between two frames, and the axis whose motion it follows if it slides.
    fn between(&self, body: &Body, from: &str, to: &str) -> Result<(usize, Mount, Option<usize>), SettingsError> {
        let chain = &self.chain;
        let (branch, frame, carrier) = carried(chain, from, to)?;
        let at = origin(chain, branch, frame);
        let (slot, origins) = match frame {
            Frame::Axis(axis) => (chain.location_slot(axis), vec![at.into()]),
            Frame::Workpiece => (chain.workpiece_slot(), vec![at.into()]),
            // Errors of the tool act at its tip.
            Frame::Tool => (chain.tool_slot(), self.tips.iter().map(|tip| (at + tip).into()).collect()),
        };
        if !body.slides {
            return Ok((slot, Mount { origins, guide: None }, None));
        }
        let linear = carrier.filter(|axis| chain.axes()[*axis].kind == AxisKind::Linear);
        let axis = linear.ok_or_else(|| {
            SettingsError::new("slides", format!("a body slides with a linear axis, and {from} is none"))
        })?;
        Ok((slot, Mount { origins, guide: Some(guide(chain, axis)) }, Some(axis)))
    }

    /// Slot and mount of what guides or measures an axis.
    fn along(&self, axis: &str, setting: &str) -> Result<(usize, Mount, Option<usize>), SettingsError> {
        let chain = &self.chain;
        let names = || chain.axes().iter().map(|axis| axis.name.as_str());
        let Some(index) = names().position(|name| name == axis) else {
            let error = SettingsError::new(setting, format!("the chain has no axis {axis}"));
            return Err(error.suggest(axis, names()));
        };
        if chain.axes()[index].kind == AxisKind::Rotary {
            return Err(SettingsError::new(setting, format!("{axis} is rotary; a linear axis was expected")));
        }
        let at = origin(chain, chain.axes()[index].branch, Frame::Axis(index));
        let mount = Mount { origins: vec![at.into()], guide: Some(guide(chain, index)) };
        Ok((chain.motion_slot(index), mount, Some(index)))
    }
}

fn guide(chain: &Chain, axis: usize) -> Guide {
    let axis = &chain.axes()[axis];
    let along = (axis.direction * axis.sense()).into();
    Guide { axis: axis.name.clone(), along, moving: axis.error_frame == ErrorFrame::Moving }
}
