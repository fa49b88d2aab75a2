//! The kinematic model of a serial chain: parameters, statuses, poses in batches.

use std::collections::BTreeMap;

use abbe_core::{
    Absent, Axis, AxisKind, Dataset, Error, ErrorFunction, KinematicModel, Parameter, PathItem, Poses, PosesMut,
    Quantity, Result, SettingsError, StatusColumn, Unit, Values, Variable, matches,
};
use abbe_errors::{
    Argument, Constant, Declaration, Drift, FourierSeries, Functions, LegendreInTime, NaturalSpline,
    OrdinaryPolynomial, Per, Reversal, StylusIs,
};
use abbe_kinematics::{Chain, ChainAxis, ErrorFrame, Errors, Evaluation as Pose, NamedAxis, StructuralLoop};
use nalgebra::Vector3;
use serde_json::Value;

use crate::settings::{self, Evaluation, Settings};

/// Letters of the six components of an error, in the order of slots.
const COMPONENTS: [char; 6] = ['X', 'Y', 'Z', 'A', 'B', 'C'];
const TOOL_SET_UP: [&str; 6] = ["dxt", "dyt", "dzt", "dat", "dbt", "dct"];
const WORKPIECE_SET_UP: [&str; 6] = ["dxw", "dyw", "dzw", "daw", "dbw", "dcw"];

/// A serial chain with its error families.
pub struct SerialChain {
    chain: Chain,
    axes: Vec<Axis>,
    status: Vec<StatusColumn>,
    parameters: Vec<Parameter>,
    /// Where each parameter acts and which function it multiplies.
    places: Vec<Place>,
    bases: Vec<Basis>,
    /// Number of functions of all bases together.
    functions: usize,
    tips: Vec<Vector3<f64>>,
    stylus_status: Option<usize>,
    stylus_radius: f64,
    first_order: bool,
    resolved: Value,
}

/// Where a parameter acts: slot and component of the chain, and its function among all functions.
#[derive(Debug, Clone, Copy)]
struct Place {
    slot: usize,
    component: usize,
    function: usize,
}

/// Functions that several errors share, with the statuses that they are functions of.
#[derive(Debug)]
struct Basis {
    functions: Box<dyn Functions>,
    arguments: Vec<usize>,
    first: usize,
    count: usize,
    /// The axis whose command is the first argument.
    moves_with: Option<usize>,
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
        finite("tool_length_mm", settings.tool_length_mm)?;
        finite("stylus_radius_mm", settings.stylus_radius_mm)?;
        if settings.stylus_radius_mm < 0.0 {
            return Err(SettingsError::new("stylus_radius_mm", "a radius cannot be negative"));
        }
        let chain_axes = named.axes.iter().map(|axis| chain_axis(axis, settings)).collect::<Result<Vec<_>, _>>()?;
        let mut builder = Builder::new(Chain::new(chain_axes), &named, settings)?;
        builder.set_up(settings)?;
        let mut declarations = Vec::new();
        for (index, line) in settings.errors.iter().enumerate() {
            let at = [key("errors"), PathItem::Index(index)];
            let mut declaration = Declaration::read(line).map_err(|error| error.under(at.clone()))?;
            if let Declaration::Drift(drift) = &mut declaration {
                settle_time(drift, data).map_err(|error| error.under(at.clone()))?;
            }
            builder.declare(&declaration).map_err(|error| error.under(at))?;
            declarations.push(declaration);
        }
        let mut resolved = settings.clone();
        resolved.errors = declarations.iter().map(|line| serde_json::to_value(line).unwrap_or_default()).collect();
        let resolved = serde_json::to_value(resolved)
            .map_err(|error| SettingsError::new("", format!("the settings cannot be written: {error}")))?;
        Ok(builder.finish(settings, resolved))
    }

    fn work(&self) -> Work {
        Work {
            values: vec![0.0; self.functions],
            slopes: vec![0.0; self.functions],
            errors: vec![[0.0; 6]; self.chain.slots()],
            commands: vec![0.0; self.axes.len()],
            pose: Pose::default(),
        }
    }

    fn functions_at(&self, status: &[f64], values: &mut [f64], mut slopes: Option<&mut [f64]>) {
        let mut arguments = [0.0; 4];
        for basis in &self.bases {
            for (argument, &index) in arguments.iter_mut().zip(&basis.arguments) {
                *argument = status[index];
            }
            let (range, arguments) = (basis.first..basis.first + basis.count, &arguments[..basis.arguments.len()]);
            basis.functions.values(arguments, &mut values[range.clone()]);
            if let Some(slopes) = slopes.as_deref_mut() {
                basis.functions.slopes(arguments, &mut slopes[range]);
            }
        }
    }

    fn tip(&self, status: &[f64]) -> Result<&Vector3<f64>> {
        let Some(column) = self.stylus_status else { return Ok(&self.tips[0]) };
        // A NaN (a stylus that no setting describes) is no index.
        self.tips.get(status[column] as usize).filter(|_| status[column] >= 0.0).ok_or_else(|| {
            Error::data("a row names a stylus that the model does not describe")
                .help("add it under `styli` of the model")
        })
    }
}

/// Buffers for one pose.
struct Work {
    values: Vec<f64>,
    slopes: Vec<f64>,
    errors: Vec<Errors>,
    commands: Vec<f64>,
    pose: Pose,
}

impl KinematicModel for SerialChain {
    fn axes(&self) -> &[Axis] {
        &self.axes
    }

    fn status(&self) -> &[StatusColumn] {
        &self.status
    }

    fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }

    fn stylus_radius(&self) -> f64 {
        self.stylus_radius
    }

    fn evaluate(
        &self,
        statuses: &[f64],
        values: &[f64],
        wanted: &[Variable],
        orientation: bool,
        out: &mut Poses,
    ) -> Result<()> {
        out.reset(statuses.len() / self.status.len().max(1), wanted.len(), orientation);
        self.evaluate_into(statuses, values, wanted, orientation, out.as_mut())
    }

    fn evaluate_into(
        &self,
        statuses: &[f64],
        values: &[f64],
        wanted: &[Variable],
        orientation: bool,
        out: PosesMut<'_>,
    ) -> Result<()> {
        let width = self.status.len();
        let mut work = self.work();
        let moved = wanted.iter().any(|variable| matches!(variable, Variable::Command(_)));
        for (index, status) in statuses.chunks_exact(width).enumerate() {
            self.functions_at(status, &mut work.values, moved.then_some(&mut work.slopes[..]));
            work.errors.fill([0.0; 6]);
            for (place, value) in self.places.iter().zip(values) {
                if *value != 0.0 {
                    work.errors[place.slot][place.component] += value * work.values[place.function];
                }
            }
            work.commands.copy_from_slice(&status[..self.axes.len()]);
            let tip = self.tip(status)?;
            if self.first_order {
                self.chain.evaluate_first_order(&work.commands, &work.errors, tip, &mut work.pose);
            } else {
                self.chain.evaluate(&work.commands, &work.errors, tip, orientation, &mut work.pose);
            }
            out.positions[index] = work.pose.position.into();
            let range = index * wanted.len()..(index + 1) * wanted.len();
            let pose = &work.pose;
            self.derivatives(
                wanted,
                values,
                &work,
                (&pose.by_error, &pose.by_command),
                &mut out.position_derivatives[range.clone()],
            );
            if orientation {
                out.orientations[index] = pose.quaternion();
                let turns = (&pose.turn_by_error[..], &pose.turn_by_command[..]);
                self.derivatives(wanted, values, &work, turns, &mut out.rotation_derivatives[range]);
            }
        }
        Ok(())
    }

    fn settings(&self) -> Value {
        self.resolved.clone()
    }

    fn error_functions(&self) -> Vec<ErrorFunction> {
        let mut functions = Vec::new();
        for (axis, named) in self.axes.iter().enumerate() {
            for (component, letter) in COMPONENTS.iter().enumerate() {
                let slot = self.chain.motion_slot(axis);
                if self.places.iter().any(|place| place.slot == slot && place.component == component) {
                    let symbol = format!("E{letter}{}", named.name);
                    functions.push(ErrorFunction { symbol, axis, component, quantity: quantity_of(component) });
                }
            }
        }
        functions
    }

    fn error_terms(&self, function: &ErrorFunction, status: &[f64]) -> Vec<(usize, f64)> {
        let mut values = vec![0.0; self.functions];
        self.functions_at(status, &mut values, None);
        let slot = self.chain.motion_slot(function.axis);
        let places = self.places.iter().enumerate();
        places
            .filter(|(_, place)| place.slot == slot && place.component == function.component)
            .map(|(parameter, place)| (parameter, values[place.function]))
            .collect()
    }
}

/// Derivatives of position or rotation to the errors of every slot, and to the command of every axis.
type ByErrorAndCommand<'a> = (&'a [[Vector3<f64>; 6]], &'a [Vector3<f64>]);

impl SerialChain {
    /// Derivatives of position or rotation, whichever `by` has, to the wanted variables.
    fn derivatives(
        &self,
        wanted: &[Variable],
        values: &[f64],
        work: &Work,
        by: ByErrorAndCommand<'_>,
        out: &mut [[f64; 3]],
    ) {
        for (out, variable) in out.iter_mut().zip(wanted) {
            *out = match variable {
                Variable::Parameter(index) => {
                    let place = self.places[*index];
                    by.0[place.slot][place.component] * work.values[place.function]
                }
                Variable::Command(axis) => self.by_command(*axis, values, work, by),
            }
            .into();
        }
    }

    /// The motion itself, and the motion errors that change on the way.
    fn by_command(&self, axis: usize, values: &[f64], work: &Work, by: ByErrorAndCommand<'_>) -> Vector3<f64> {
        let mut total = by.1[axis];
        for basis in self.bases.iter().filter(|basis| basis.moves_with == Some(axis)) {
            for (place, value) in self.places.iter().zip(values) {
                if *value != 0.0 && (basis.first..basis.first + basis.count).contains(&place.function) {
                    total += by.0[place.slot][place.component] * (value * work.slopes[place.function]);
                }
            }
        }
        total
    }
}

/// Collects statuses, bases and parameters.
struct Builder {
    chain: Chain,
    axes: Vec<Axis>,
    status: Vec<StatusColumn>,
    parameters: Vec<Parameter>,
    places: Vec<Place>,
    bases: Vec<Basis>,
    functions: usize,
    tips: Vec<Vector3<f64>>,
    stylus_status: Option<usize>,
    candidates: BTreeMap<&'static str, Vec<Candidate>>,
}

/// An error that a family may list.
#[derive(Debug, Clone)]
struct Candidate {
    symbol: String,
    slot: usize,
    component: usize,
    axis: Option<usize>,
}

impl Builder {
    fn new(chain: Chain, named: &StructuralLoop, settings: &Settings) -> Result<Self, SettingsError> {
        let mut axes = Vec::new();
        let mut status = Vec::new();
        for (index, (axis, named)) in chain.axes().iter().zip(&named.axes).enumerate() {
            let given = settings.axes.get(&axis.name).cloned().unwrap_or_default();
            let quantity = match axis.kind {
                AxisKind::Linear => Quantity::Length,
                AxisKind::Rotary => Quantity::Angle,
            };
            axes.push(Axis {
                name: axis.name.clone(),
                kind: axis.kind,
                branch: axis.branch,
                sense: axis.sense(),
                direction: axis.direction.into(),
                range: given.range_mm.or(given.range_deg.map(|range| range.map(f64::to_radians))),
                indexed: named.indexed,
                status: index,
            });
            // A spindle that the data do not mention was not turned.
            let absent = if named.indexed { Absent::Taken(0.0) } else { Absent::Refused };
            status.push(StatusColumn { name: axis.name.clone(), quantity, levels: Vec::new(), absent });
        }
        let mut candidates: BTreeMap<&'static str, Vec<Candidate>> = BTreeMap::new();
        for (index, axis) in axes.iter().enumerate() {
            for (component, letter) in COMPONENTS.iter().enumerate() {
                let mut add = |family, symbol, slot| {
                    let candidate = Candidate { symbol, slot, component, axis: Some(index) };
                    candidates.entry(family).or_default().push(candidate);
                };
                add("location", format!("E{letter}0{}", axis.name), chain.location_slot(index));
                add("motion", format!("E{letter}{}", axis.name), chain.motion_slot(index));
            }
        }
        for (symbols, slot) in [(TOOL_SET_UP, chain.tool_slot()), (WORKPIECE_SET_UP, chain.workpiece_slot())] {
            for (component, symbol) in symbols.iter().enumerate() {
                let candidate = Candidate { symbol: (*symbol).to_owned(), slot, component, axis: None };
                candidates.entry("set-up").or_default().push(candidate);
            }
        }
        Ok(Self {
            chain,
            axes,
            status,
            parameters: Vec::new(),
            places: Vec::new(),
            bases: Vec::new(),
            functions: 0,
            tips: Vec::new(),
            stylus_status: None,
            candidates,
        })
    }

    /// Set-up parameters of tool, workpiece and further styli: these always exist.
    fn set_up(&mut self, settings: &Settings) -> Result<(), SettingsError> {
        let offset = Vector3::from(settings.probe_offset_mm.unwrap_or_default());
        self.tips.push(offset - Vector3::new(0.0, 0.0, settings.tool_length_mm));
        let mut styli = Vec::new();
        for (number, stylus) in &settings.styli {
            let at = [key("styli"), key(number)];
            let tip = stylus.tip().filter(|tip| tip.iter().all(|coordinate| coordinate.is_finite()));
            let tip = Vector3::from(tip.ok_or_else(|| {
                SettingsError::new("", "a tip was expected")
                    .help("write `tip_mm: [x, y, z]`, or `x_mm`, `y_mm` and `length_mm`")
                    .under(at.clone())
            })?);
            if number != "1" {
                styli.push((number, tip));
            } else if tip != self.tips[0] {
                let error = SettingsError::new("", "stylus 1 is the tool itself; this is another tip");
                return Err(error.help("`tool_length_mm` says where it is; number further styli from 2").under(at));
            }
        }
        if !styli.is_empty() {
            let levels = std::iter::once("1").chain(styli.iter().map(|(number, _)| number.as_str()));
            let levels = levels.map(str::to_owned).collect();
            self.stylus_status = Some(self.status.len());
            let status =
                StatusColumn { name: "stylus".into(), quantity: Quantity::Label, levels, absent: Absent::Taken(0.0) };
            self.status.push(status);
        }
        for candidate in self.candidates["set-up"].clone() {
            // The offsets of the tip are stylus 1's own where there are several.
            let of_stylus = candidate.slot == self.chain.tool_slot() && candidate.component < 3;
            let first = match self.stylus_status {
                Some(stylus) if of_stylus => self.basis(Box::new(StylusIs(0)), vec![stylus], None),
                _ => self.basis(Box::new(Constant), Vec::new(), None),
            };
            self.add(&candidate, first, &[])?;
        }
        for (index, (number, tip)) in styli.into_iter().enumerate() {
            self.tips.push(tip);
            for (component, letter) in ["x", "y", "z"].iter().enumerate() {
                let symbol = format!("stylus[{number}].{letter}");
                let candidate = Candidate { symbol, slot: self.chain.tool_slot(), component, axis: None };
                let arguments = self.stylus_status.into_iter().collect();
                let first = self.basis(Box::new(StylusIs(index + 1)), arguments, None);
                self.add(&candidate, first, &[])?;
            }
        }
        Ok(())
    }

    /// Adds functions of some statuses; gives the index of the basis.
    fn basis(&mut self, functions: Box<dyn Functions>, arguments: Vec<usize>, moves_with: Option<usize>) -> usize {
        let count = functions.terms().len();
        self.bases.push(Basis { functions, arguments, first: self.functions, count, moves_with });
        self.functions += count;
        self.bases.len() - 1
    }

    /// Adds the parameters of an error on a basis, apart from those that are zero by definition.
    fn add(&mut self, candidate: &Candidate, basis: usize, zero: &[String]) -> Result<(), SettingsError> {
        let of = quantity_of(candidate.component);
        let command = candidate.axis.map_or(Quantity::Ratio, |axis| self.status[axis].quantity);
        let basis = &self.bases[basis];
        for (index, term) in basis.functions.terms().iter().enumerate() {
            let name = format!("{}{}", candidate.symbol, term.suffix);
            if zero.iter().any(|pattern| matches(pattern, &name)) {
                continue;
            }
            if self.parameters.iter().any(|parameter| parameter.name == name) {
                return Err(SettingsError::new("", format!("`{name}` is declared twice")));
            }
            let unit = if term.power == 0 { Unit::per(of, command, 0) } else { term.unit(of, command) };
            self.parameters.push(Parameter { name, unit });
            let place = Place { slot: candidate.slot, component: candidate.component, function: basis.first + index };
            self.places.push(place);
        }
        Ok(())
    }

    /// The status column of that name, added if it is new; labels that are new to it are added to it.
    fn status(&mut self, name: String, quantity: Quantity, levels: Vec<String>, absent: f64) -> usize {
        if let Some(index) = self.status.iter().position(|status| status.name == name) {
            let known = &mut self.status[index].levels;
            for level in levels {
                if !known.contains(&level) {
                    known.push(level);
                }
            }
            return index;
        }
        self.status.push(StatusColumn { name, quantity, levels, absent: Absent::Taken(absent) });
        self.status.len() - 1
    }

    /// Adds what one line under `errors` declares.
    fn declare(&mut self, declaration: &Declaration) -> Result<(), SettingsError> {
        let group = match declaration {
            Declaration::Location(_) => "location",
            Declaration::Polynomial(_)
            | Declaration::Backlash(_)
            | Declaration::Spline(_)
            | Declaration::Fourier(_) => "motion",
            Declaration::Drift(_) => "set-up",
        };
        let mut shared: BTreeMap<Option<usize>, Vec<usize>> = BTreeMap::new();
        let mut names: Vec<String> = Vec::new();
        for (index, pattern) in declaration.symbols().iter().enumerate() {
            let at = [key(declaration.family()), PathItem::Index(index)];
            let candidates = &self.candidates[group];
            let listed: Vec<Candidate> =
                candidates.iter().filter(|candidate| matches(pattern, &candidate.symbol)).cloned().collect();
            if listed.is_empty() {
                let what = format!("`{pattern}` is no {group} error of this chain");
                let symbols = candidates.iter().map(|candidate| candidate.symbol.as_str());
                let near = abbe_core::nearest(pattern, symbols).map(|near| format!("did you mean `{near}`?"));
                let error = SettingsError::new("", what).under(at);
                return Err(match near {
                    Some(near) => error.help(near),
                    None => error,
                });
            }
            for candidate in listed {
                if let Some(axis) = candidate.axis {
                    declaration.check_axis(self.status[axis].quantity)?;
                }
                // Errors of the same axis share their functions.
                let bases = match shared.get(&candidate.axis) {
                    Some(bases) => bases.clone(),
                    None => self.bases_of(declaration, candidate.axis)?,
                };
                for &basis in &bases {
                    self.add(&candidate, basis, declaration.zero()).map_err(|error| error.under(at.clone()))?;
                    let terms = self.bases[basis].functions.terms().into_iter();
                    names.extend(terms.map(|term| format!("{}{}", candidate.symbol, term.suffix)));
                }
                shared.insert(candidate.axis, bases);
            }
        }
        for (index, pattern) in declaration.zero().iter().enumerate() {
            if !names.iter().any(|name| matches(pattern, name)) {
                let error = SettingsError::new("", format!("`{pattern}` is no coefficient of this line"))
                    .suggest(pattern, names.iter().map(String::as_str));
                return Err(error.under([key("zero"), PathItem::Index(index)]));
            }
        }
        Ok(())
    }

    /// The bases of a declaration for an axis (or a set-up parameter).
    fn bases_of(&mut self, declaration: &Declaration, axis: Option<usize>) -> Result<Vec<usize>, SettingsError> {
        let functions: Vec<Box<dyn Functions>> = match declaration {
            Declaration::Location(_) => vec![Box::new(Constant)],
            Declaration::Polynomial(polynomial) => {
                vec![Box::new(OrdinaryPolynomial { degrees: polynomial.degrees.clone() })]
            }
            Declaration::Backlash(_) => vec![Box::new(Reversal)],
            Declaration::Spline(spline) => vec![Box::new(NaturalSpline::new(spline.knots()?))],
            Declaration::Fourier(fourier) => vec![Box::new(FourierSeries { orders: fourier.orders.clone() })],
            Declaration::Drift(drift) => {
                // The labels are shared by all drifts of the column, whichever of its series each of them has.
                let labels = drift.per.column().map(|column| {
                    let levels = drift.time_s.keys().cloned().collect();
                    let status = self.status(column.to_owned(), Quantity::Label, levels, f64::NAN);
                    self.status[status].levels.clone()
                });
                let series = drift.time_s.iter().map(|(label, time)| {
                    Box::new(LegendreInTime {
                        degrees: drift.degrees.clone(),
                        time: *time,
                        series: labels.as_ref().and_then(|labels| labels.iter().position(|known| known == label)),
                        prefix: drift.per.prefix(label),
                    }) as Box<dyn Functions>
                });
                series.collect()
            }
        };
        let mut bases = Vec::new();
        for functions in functions {
            let arguments = functions.arguments().iter().map(|argument| self.argument(*argument, axis, declaration));
            let arguments: Vec<usize> = arguments.collect();
            let moves_with = functions.arguments().first().filter(|first| **first == Argument::Command).and(axis);
            bases.push(self.basis(functions, arguments, moves_with));
        }
        Ok(bases)
    }

    /// The status that an argument of a function is.
    fn argument(&mut self, argument: Argument, axis: Option<usize>, declaration: &Declaration) -> usize {
        let series = match declaration {
            Declaration::Drift(drift) => drift.per.column().map(|column| (column, drift)),
            _ => None,
        };
        match (argument, axis, series) {
            (Argument::Command, Some(axis), _) => axis,
            (Argument::Direction, Some(axis), _) => {
                let name = format!("dir_{}", self.axes[axis].name);
                self.status(name, Quantity::Ratio, Vec::new(), 0.0)
            }
            (Argument::Series, _, Some((column, drift))) => {
                let levels = drift.time_s.keys().cloned().collect();
                self.status(column.to_owned(), Quantity::Label, levels, f64::NAN)
            }
            _ => self.status("time".to_owned(), Quantity::Time, Vec::new(), f64::NAN),
        }
    }

    fn finish(self, settings: &Settings, resolved: Value) -> SerialChain {
        SerialChain {
            chain: self.chain,
            axes: self.axes,
            status: self.status,
            parameters: self.parameters,
            places: self.places,
            bases: self.bases,
            functions: self.functions,
            tips: self.tips,
            stylus_status: self.stylus_status,
            stylus_radius: settings.stylus_radius_mm,
            first_order: settings.evaluation == Evaluation::FirstOrder,
            resolved,
        }
    }
}

fn quantity_of(component: usize) -> Quantity {
    if component < 3 { Quantity::Length } else { Quantity::Angle }
}

fn key(name: &str) -> PathItem {
    PathItem::Key(name.to_owned())
}

fn finite(setting: &str, value: f64) -> Result<(), SettingsError> {
    if value.is_finite() { Ok(()) } else { Err(SettingsError::new(setting, "a finite number was expected")) }
}

/// Nominal geometry of one axis.
fn chain_axis(named: &NamedAxis, settings: &Settings) -> Result<ChainAxis, SettingsError> {
    let given = settings.axes.get(&named.name).cloned().unwrap_or_default();
    let at = |setting: &str, message: String| {
        Err(SettingsError::new(setting, message).under([key("axes"), key(&named.name)]))
    };
    let kind = named.kind();
    let (fits, wrong, right) = match kind {
        AxisKind::Linear => (given.range_mm, given.range_deg.map(|_| "range_deg"), "a length: `range_mm`"),
        AxisKind::Rotary => (given.range_deg, given.range_mm.map(|_| "range_mm"), "an angle: `range_deg`"),
    };
    if let Some(wrong) = wrong {
        return at(wrong, format!("the range of axis {} is {right}", named.name));
    }
    if let Some([from, to]) = fits
        && !(from.is_finite() && to.is_finite() && from < to)
    {
        let setting = if kind == AxisKind::Linear { "range_mm" } else { "range_deg" };
        return at(setting, "a range is two numbers, the smaller one first".to_owned());
    }
    let direction = Vector3::from(given.direction.unwrap_or(named.direction()));
    if !(direction.norm() > 1e-6 && direction.norm().is_finite()) {
        return at("direction", "a direction is three numbers that are not all zero".to_owned());
    }
    let point = Vector3::from(given.point_mm.unwrap_or_default());
    if !point.norm().is_finite() {
        return at("point_mm", "three finite numbers were expected".to_owned());
    }
    let error_frame = match given.error_frame.unwrap_or(settings.error_frame) {
        settings::ErrorFrame::Moving => ErrorFrame::Moving,
        settings::ErrorFrame::Fixed => ErrorFrame::Fixed,
    };
    let name = named.name.clone();
    Ok(ChainAxis { name, kind, branch: named.branch, direction, point, reverse: given.reverse, error_frame })
}

/// First and last time of every series of a drift: those of the settings, else those of the data. The scale so stays
/// the same in folds and subsets of the rows.
fn settle_time(drift: &mut Drift, data: &[&Dataset]) -> Result<(), SettingsError> {
    if drift.time_s.is_empty() {
        for data in data {
            let Some(times) = data.numbers("time") else { continue };
            let labels = drift.per.column().and_then(|column| data.column(column)).map(|column| &column.values);
            for (row, &time) in times.iter().enumerate() {
                let label = match (drift.per, labels) {
                    (Per::DataSet, _) => "",
                    (_, Some(Values::Labels(labels))) => &labels[row],
                    _ => continue,
                };
                let range = drift.time_s.entry(label.to_owned()).or_insert([time, time]);
                *range = [range[0].min(time), range[1].max(time)];
            }
        }
        if drift.time_s.is_empty() && !data.is_empty() {
            let columns = drift.per.column().map_or(String::new(), |column| format!(" and `{column}`"));
            return Err(SettingsError::new("drift", format!("no data set has the columns `time_s`{columns}")));
        }
    }
    if drift.time_s.is_empty() && drift.per == Per::DataSet {
        drift.time_s.insert(String::new(), [0.0, 1.0]);
    }
    match drift.time_s.iter().find(|(_, range)| !data.is_empty() && range[0] >= range[1]) {
        None => Ok(()),
        Some((label, range)) => Err(SettingsError::new(
            "drift",
            format!("the series `{label}` has the single time {} s; a drift needs a span of time", range[0]),
        )),
    }
}
