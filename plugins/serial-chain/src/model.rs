//! The kinematic model of a serial chain: parameters, statuses, poses in batches.

use std::collections::BTreeSet;

use abbe_core::{
    Axis, AxisKind, Dataset, Error, ErrorFunction, FactoredPoses, KinematicModel, ModelInfo, MotionError, PathItem,
    PoseBatch, PosesMut, Result, SettingsError, Variable,
};
use abbe_errors::{Declaration, Functions};
use abbe_kinematics::{Chain, StructuralLoop};
use nalgebra::Vector3;

use crate::builder::{Builder, finite, key};
use crate::derivatives::{At, of_one_error};
use crate::evaluate::AtPose;
use crate::nominal::{
    FARTHEST, chain_axis, doubtful_tool, settle_body, settle_time, temperature_is_there, time_is_there,
};
use crate::settings::Settings;

/// A serial chain with its error families.
pub struct SerialChain {
    pub(crate) chain: Chain,
    pub(crate) info: ModelInfo,
    /// The use of each parameter.
    pub(crate) uses: Vec<ParameterUse>,
    pub(crate) bases: Vec<FunctionBasis>,
    /// Number of functions of all bases together.
    pub(crate) functions: usize,
    pub(crate) tips: Vec<Vector3<f64>>,
    pub(crate) stylus_status: Option<usize>,
    pub(crate) first_order: bool,
}

/// The use of a parameter.
#[derive(Debug, Clone, Copy)]
pub(crate) enum ParameterUse {
    /// It multiplies a function, in one error of one slot of the chain.
    Coefficient(CoefficientPlace),
    /// It is an argument of the functions of a basis, and maybe of others: a wavelength, a time constant.
    Shape(usize),
    /// It multiplies all functions of a basis, in several errors of one slot: the factor of a body.
    Factor(usize),
    /// It belongs to the effective stylus radius; poses do not depend on it.
    Radius,
}

/// Where a coefficient acts: slot and component of the chain, and its function among all functions.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CoefficientPlace {
    pub slot: usize,
    pub component: usize,
    pub function: usize,
    pub basis: usize,
}

/// Where an argument of a function comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Source {
    /// A status of the pose.
    Status(usize),
    /// A parameter of the model.
    Parameter(usize),
}

/// Functions that several errors share, with their arguments.
#[derive(Debug)]
pub(crate) struct FunctionBasis {
    pub functions: Box<dyn Functions>,
    pub arguments: Vec<Source>,
    pub first: usize,
    pub count: usize,
    /// Where the functions are defined: an axis, the range of its commands, and the name of an error with these functions.
    pub range: Option<Range>,
    /// The coefficients: parameters with their places.
    pub coefficients: Vec<(usize, CoefficientPlace)>,
}

/// A range of commands.
#[derive(Debug, Clone)]
pub(crate) struct Range {
    pub axis: usize,
    pub ends: [f64; 2],
    pub error: String,
}

/// Commands beyond a range by up to this part of its width are taken as its end.
const BEYOND: f64 = 0.01;

impl Range {
    /// Refuses a command outside the range, where the functions are not known.
    #[inline]
    fn check(&self, status: &[f64], axes: &[Axis]) -> Result<()> {
        let (command, [from, to]) = (status[self.axis], self.ends);
        let allowed = BEYOND * (to - from);
        // A command that is not a number is reported elsewhere.
        match command < from - allowed || command > to + allowed {
            true => Err(self.refused(command, axes)),
            false => Ok(()),
        }
    }

    /// The error for a command outside the range.
    fn refused(&self, command: f64, axes: &[Axis]) -> Error {
        let [from, to] = self.ends;
        let axis = &axes[self.axis];
        let (unit, factor) = if axis.kind == AxisKind::Rotary { ("deg", 1f64.to_degrees()) } else { ("mm", 1.0) };
        let [from, to] = [from, to].map(|end| (end * factor * 1e6).round() / 1e6);
        // Rounded to the digits that separate it from the ends: the command at contact differs a little from that of the
        // data.
        let digits = 10_f64.powf(3.0 - (to - from).log10().floor());
        let command = (command * factor * digits).round() / digits;
        let message = format!(
            "{} is needed with {} at {command} {unit}, beyond its range of {from} to {to} {unit}",
            self.error, axis.name
        );
        Error::data(message).help("widen the range of the axis or of the line under `errors`, or leave the row out")
    }
}

impl SerialChain {
    /// Builds the model; without data, series of a drift that are not in the settings get a provisional time scale.
    pub fn new(settings: &Settings, data: &[&Dataset]) -> Result<Self, SettingsError> {
        let named: StructuralLoop = settings
            .chain
            .parse()
            .map_err(|error: abbe_kinematics::ChainError| SettingsError::new("chain", error.0))?;
        if named.axes.is_empty() {
            return Err(SettingsError::new("chain", "a machine needs at least one axis between workpiece and tool"));
        }
        for name in settings.axes.keys() {
            if !named.axes.iter().any(|axis| axis.name == *name) {
                let error = SettingsError::new("", format!("the chain has no axis {name}"))
                    .suggest(name, named.axes.iter().map(|axis| axis.name.as_str()));
                return Err(error.under([key("axes"), key(name)]));
            }
        }
        for (setting, length) in
            [("tool_length_mm", settings.tool_length_mm), ("stylus_radius_mm", settings.stylus_radius_mm)]
        {
            finite(setting, length)?;
            if length.abs() > FARTHEST {
                return Err(SettingsError::new(setting, format!("a length of at most {FARTHEST} mm was expected")));
            }
        }
        if settings.stylus_radius_mm < 0.0 {
            return Err(SettingsError::new("stylus_radius_mm", "a radius cannot be negative"));
        }
        let chain_axes = named.axes.iter().map(|axis| chain_axis(axis, settings)).collect::<Result<Vec<_>, _>>()?;
        if let Some(words) = doubtful_tool(settings).filter(|_| !data.is_empty()) {
            tracing::warn!("{words}");
        }
        let mut builder = Builder::new(Chain::new(chain_axes), &named, settings)?;
        builder.set_up(settings)?;
        let mut declarations = Vec::new();
        for (index, line) in settings.errors.iter().enumerate() {
            let at = [key("errors"), PathItem::Index(index)];
            let mut declaration = Declaration::read(line).map_err(|error| error.under(at.clone()))?;
            if let Declaration::Drift(drift) = &mut declaration {
                settle_time(drift, data).map_err(|error| error.under(at.clone()))?;
            }
            if let Declaration::Expansion(expansion) = &declaration {
                temperature_is_there(expansion, data).map_err(|error| error.under(at.clone()))?;
            }
            if let Declaration::Thermal(thermal) = &mut declaration {
                thermal.settle(data).and_then(|()| time_is_there(data)).map_err(|error| error.under(at.clone()))?;
                if !data.is_empty() {
                    thermal.faults().iter().for_each(|fault| tracing::warn!("{fault}"));
                }
            }
            builder.declare(&declaration).map_err(|error| error.under(at))?;
            declarations.push(declaration);
        }
        builder.probe(settings)?;
        let mut resolved = settings.clone();
        let mut told = BTreeSet::new();
        for (name, body) in &mut resolved.bodies {
            let at = [key("bodies"), key(name)];
            settle_body(body, data, &mut told)
                .and_then(|()| builder.body(name, body))
                .map_err(|error| error.under(at))?;
        }
        resolved.errors = declarations.iter().map(|line| serde_json::to_value(line).unwrap_or_default()).collect();
        let resolved = serde_json::to_value(resolved)
            .map_err(|error| SettingsError::new("", format!("the settings cannot be written: {error}")))?;
        Ok(builder.finish(settings, resolved))
    }

    /// The bases that have to be evaluated: those of coefficients that are not zero, or whose derivatives are wanted.
    pub(crate) fn in_use(&self, values: &[f64], wanted: &[Variable]) -> Vec<usize> {
        let mut used = vec![false; self.bases.len()];
        let basis_of = |role: &ParameterUse| match role {
            ParameterUse::Coefficient(place) => Some(place.basis),
            ParameterUse::Factor(basis) => Some(*basis),
            ParameterUse::Shape(_) | ParameterUse::Radius => None,
        };
        for (role, _) in self.uses.iter().zip(values).filter(|(_, value)| **value != 0.0) {
            basis_of(role).into_iter().for_each(|basis| used[basis] = true);
        }
        for variable in wanted {
            if let Variable::Parameter(index) = variable {
                basis_of(&self.uses[*index]).into_iter().for_each(|basis| used[basis] = true);
            }
        }
        (0..used.len()).filter(|basis| used[*basis]).collect()
    }

    /// The arguments of a basis at a status. Fails where its functions are not known.
    #[inline]
    pub(crate) fn arguments_known<'a>(
        &self,
        basis: &FunctionBasis,
        At { status, values }: At<'a>,
        room: &'a mut Room,
    ) -> Result<&'a [f64]> {
        if let Some(range) = &basis.range {
            range.check(status, &self.info.axes)?;
        }
        let arguments = basis.arguments_at(status, values, room);
        basis.functions.refused(arguments).map_or(Ok(arguments), |why| Err(Error::data(why)))
    }

    pub(crate) fn tip(&self, status: &[f64]) -> Result<&Vector3<f64>> {
        let Some(column) = self.stylus_status else { return Ok(&self.tips[0]) };
        // A NaN (a stylus that no setting describes) is no index.
        self.tips.get(status[column] as usize).filter(|_| status[column] >= 0.0).ok_or_else(|| {
            Error::data("a row names a stylus that the model does not describe")
                .help("add it under `styli` of the model")
        })
    }
}

/// Most arguments that a function has, the temperatures of a body aside.
const FEW: usize = 9;

/// Room for the arguments of functions.
#[derive(Default)]
pub(crate) struct Room {
    few: [f64; FEW],
    many: Vec<f64>,
}

impl FunctionBasis {
    /// Whether its functions, or the range where they are known, follow columns of the status that change.
    pub fn follows(&self, changes: &[bool]) -> bool {
        let of_range = self.range.as_ref().is_some_and(|range| changes[range.axis]);
        of_range || self.arguments.iter().any(|source| matches!(source, Source::Status(column) if changes[*column]))
    }

    #[inline]
    pub fn arguments_at<'a>(&self, status: &'a [f64], values: &[f64], room: &'a mut Room) -> &'a [f64] {
        // Nearly all functions have one argument: the command of an axis.
        if let [Source::Status(index)] = self.arguments[..] {
            return std::slice::from_ref(&status[index]);
        }
        let count = self.arguments.len();
        let arguments = match count <= FEW {
            true => &mut room.few[..count],
            false => {
                room.many.resize(count, 0.0);
                &mut room.many[..]
            }
        };
        for (argument, source) in arguments.iter_mut().zip(&self.arguments) {
            *argument = match source {
                Source::Status(index) => status[*index],
                Source::Parameter(index) => values[*index],
            };
        }
        arguments
    }

    /// Writes the arguments at poses that are evaluated together, one after another in `statuses`: arguments x `width` places. Places
    /// without a pose get what the first one has.
    pub fn arguments_side_by_side(
        &self,
        statuses: &[f64],
        columns: usize,
        (values, width): (&[f64], usize),
        out: &mut Vec<f64>,
    ) {
        out.clear();
        for source in &self.arguments {
            match source {
                Source::Status(column) => {
                    let at = |place: usize| statuses.get(place * columns + column).copied();
                    out.extend((0..width).map(|place| at(place).unwrap_or(statuses[*column])));
                }
                Source::Parameter(index) => out.extend(std::iter::repeat_n(values[*index], width)),
            }
        }
    }

    /// Slot, component and value of every error that the coefficients contribute to, with these values of the functions.
    pub fn errors(&self, values: &[f64], functions: &[f64]) -> impl Iterator<Item = (usize, usize, f64)> {
        // Terms of one error are summed first: its coefficients stand side by side.
        self.coefficients.chunk_by(of_one_error).map(move |coefficients| {
            let CoefficientPlace { slot, component, .. } = coefficients[0].1;
            let terms = coefficients
                .iter()
                .map(|(parameter, place)| values[*parameter] * functions[place.function - self.first]);
            (slot, component, terms.sum())
        })
    }

    /// Sums the slopes of the functions to all arguments that come from `source`; returns whether there are such arguments.
    pub fn slopes_by(
        &self,
        source: Source,
        status: &[f64],
        values: &[f64],
        each: &mut [f64],
        out: &mut Vec<f64>,
    ) -> bool {
        out.clear();
        if !self.arguments.contains(&source) {
            return false;
        }
        let mut room = Room::default();
        let arguments = self.arguments_at(status, values, &mut room);
        let each = &mut each[..self.count];
        for by in (0..self.arguments.len()).filter(|by| self.arguments[*by] == source) {
            self.functions.slopes(by, arguments, each);
            match out.is_empty() {
                true => out.extend_from_slice(each),
                false => out.iter_mut().zip(each.iter()).for_each(|(sum, slope)| *sum += *slope),
            }
        }
        true
    }
}

impl KinematicModel for SerialChain {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn evaluate(&self, batch: PoseBatch<'_>, out: PosesMut<'_>) -> Result<()> {
        let count = batch.wanted.len();
        self.at_each_pose(batch, &mut self.wanted(&batch), |index, wanted, AtPose { functions, pose }| {
            out.positions[index] = pose.position().into();
            let range = index * count..(index + 1) * count;
            wanted.write(functions, pose.of_position(), &mut out.position_derivatives[range.clone()]);
            if batch.orientation {
                out.orientations[index] = pose.quaternion();
                wanted.write(functions, pose.of_rotation(), &mut out.rotation_derivatives[range]);
            }
        })
    }

    fn factored(&self, batch: PoseBatch<'_>, out: &mut FactoredPoses) -> Result<()> {
        let mut wanted = self.wanted(&batch);
        out.reset(batch.statuses.len() / self.info.status.len(), batch.orientation, wanted.terms());
        self.at_each_pose(batch, &mut wanted, |index, wanted, AtPose { functions, pose }| {
            out.poses.positions[index] = pose.position().into();
            wanted.add_factors(functions, &mut out.factors);
            wanted.add_effects(pose.of_position(), &mut out.position_effects);
            if batch.orientation {
                out.poses.orientations[index] = pose.quaternion();
                wanted.add_effects(pose.of_rotation(), &mut out.rotation_effects);
            }
        })
    }

    fn motion_error(&self, function: &ErrorFunction, values: &[f64], status: &[f64]) -> Result<MotionError> {
        let mut error = MotionError::default();
        let (mut functions, mut each, mut slopes) = (vec![0.0; self.functions], vec![0.0; self.functions], Vec::new());
        let slot = self.chain.motion_slot(function.axis);
        for basis in &self.bases {
            let own = |place: &CoefficientPlace| place.slot == slot && place.component == function.component;
            let coefficients: Vec<_> = basis.coefficients.iter().filter(|(_, place)| own(place)).collect();
            if coefficients.is_empty() {
                continue;
            }
            let mut room = Room::default();
            let arguments = self.arguments_known(basis, At { status, values }, &mut room)?;
            basis.functions.values(arguments, &mut functions[basis.first..basis.first + basis.count]);
            for (parameter, place) in &coefficients {
                error.value += values[*parameter] * functions[place.function];
                error.derivatives.push((*parameter, functions[place.function]));
            }
            for source in &basis.arguments {
                let Source::Parameter(shape) = *source else { continue };
                basis.slopes_by(*source, status, values, &mut each, &mut slopes);
                let terms = coefficients
                    .iter()
                    .map(|(parameter, place)| values[*parameter] * slopes[place.function - basis.first]);
                let slope: f64 = terms.sum();
                // Several lines may share a shape.
                match error.derivatives.iter_mut().find(|(known, _)| *known == shape) {
                    Some((_, sum)) => *sum += slope,
                    None => error.derivatives.push((shape, slope)),
                }
            }
        }
        Ok(error)
    }

    fn poses_in_c(&self, functions: &[(&str, &[f64])]) -> Result<String> {
        self.in_c(functions)
    }
}
