//! Puts a serial chain together: statuses, bases of functions, parameters.

use std::collections::BTreeMap;

use abbe_core::{
    Absent, Axis, AxisKind, Parameter, ParameterRole, PathItem, Quantity, SettingsError, StatusColumn, StatusRole,
    Unit, matches,
};
use abbe_errors::{Argument, Constant, Declaration, Functions, Group, StylusIndicator, Subject};
use abbe_kinematics::{Chain, StructuralLoop};
use abbe_probe::{parameter as probe_parameter, read as probe_term};
use nalgebra::Vector3;

use crate::model::{CoefficientPlace, FunctionBasis, ParameterUse, Range, Source};
use crate::settings::Settings;

/// Letters of the six components of an error, in the order of slots.
pub(crate) const COMPONENTS: [char; 6] = ['X', 'Y', 'Z', 'A', 'B', 'C'];
const TOOL_SET_UP: [&str; 6] = ["dxt", "dyt", "dzt", "dat", "dbt", "dct"];
const WORKPIECE_SET_UP: [&str; 6] = ["dxw", "dyw", "dzw", "daw", "dbw", "dcw"];

/// Collects statuses, bases and parameters.
pub(crate) struct Builder {
    pub chain: Chain,
    pub axes: Vec<Axis>,
    pub status: Vec<StatusColumn>,
    pub parameters: Vec<Parameter>,
    pub nominal: Vec<f64>,
    pub uses: Vec<ParameterUse>,
    pub bases: Vec<FunctionBasis>,
    pub functions: usize,
    pub tips: Vec<Vector3<f64>>,
    pub stylus_status: Option<usize>,
    pub candidates: Vec<(Group, Candidate)>,
}

/// An error that a family may list.
#[derive(Debug, Clone)]
pub(crate) struct Candidate {
    pub symbol: String,
    pub slot: usize,
    pub component: usize,
    pub axis: Option<usize>,
    pub role: ParameterRole,
}

impl Builder {
    pub fn new(chain: Chain, named: &StructuralLoop, settings: &Settings) -> Result<Self, SettingsError> {
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
                endless: given.endless,
                status: index,
            });
            // A spindle that the data do not mention is at zero.
            let absent = if named.indexed { Absent::Default(0.0) } else { Absent::Required };
            let (name, role) = (axis.name.clone(), StatusRole::Command(index));
            status.push(StatusColumn { name, role, quantity, levels: Vec::new(), absent });
        }
        let mut candidates = Vec::new();
        for (index, axis) in axes.iter().enumerate() {
            for (component, letter) in COMPONENTS.iter().enumerate() {
                let mut add = |group, role, symbol, slot| {
                    candidates.push((group, Candidate { symbol, slot, component, axis: Some(index), role }));
                };
                let location = ParameterRole::Location { axis: index, component };
                add(Group::Location, location, format!("E{letter}0{}", axis.name), chain.location_slot(index));
                let motion = ParameterRole::Motion { axis: index, component };
                add(Group::Motion, motion, format!("E{letter}{}", axis.name), chain.motion_slot(index));
            }
        }
        for (symbols, slot) in [(TOOL_SET_UP, chain.tool_slot()), (WORKPIECE_SET_UP, chain.workpiece_slot())] {
            for (component, symbol) in symbols.iter().enumerate() {
                let (symbol, role) = ((*symbol).to_owned(), ParameterRole::SetUp);
                let candidate = Candidate { symbol, slot, component, axis: None, role };
                candidates.push((Group::SetUp, candidate));
            }
        }
        Ok(Self {
            chain,
            axes,
            status,
            parameters: Vec::new(),
            nominal: Vec::new(),
            uses: Vec::new(),
            bases: Vec::new(),
            functions: 0,
            tips: Vec::new(),
            stylus_status: None,
            candidates,
        })
    }

    /// Set-up parameters of tool, workpiece and further styli: these always exist.
    pub fn set_up(&mut self, settings: &Settings) -> Result<(), SettingsError> {
        let offset = Vector3::from(settings.probe_offset_mm.unwrap_or_default());
        self.tips.push(offset - Vector3::new(0.0, 0.0, settings.tool_length_mm));
        let styli = self.further_styli(settings)?;
        if !styli.is_empty() {
            let levels = std::iter::once("1").chain(styli.iter().map(|(number, _)| number.as_str()));
            let levels = levels.map(str::to_owned).collect();
            self.stylus_status = Some(self.status.len());
            let (name, role, absent) = ("stylus".to_owned(), StatusRole::Stylus, Absent::Default(0.0));
            self.status.push(StatusColumn { name, role, quantity: Quantity::Label, levels, absent });
        }
        let set_up: Vec<Candidate> = self.among(Group::SetUp).cloned().collect();
        for candidate in set_up {
            // The offsets of the tip are stylus 1's own where there are several.
            let of_stylus = candidate.slot == self.chain.tool_slot() && candidate.component < 3;
            let first = match self.stylus_status {
                Some(stylus) if of_stylus => {
                    self.basis(Box::new(StylusIndicator(0)), vec![Source::Status(stylus)], None)
                }
                _ => self.basis(Box::new(Constant), Vec::new(), None),
            };
            self.add(&candidate, first, &[])?;
        }
        for (index, (number, tip)) in styli.into_iter().enumerate() {
            self.tips.push(tip);
            for (component, letter) in ["x", "y", "z"].iter().enumerate() {
                let symbol = format!("stylus[{number}].{letter}");
                let (slot, role) = (self.chain.tool_slot(), ParameterRole::SetUp);
                let candidate = Candidate { symbol, slot, component, axis: None, role };
                let arguments = self.stylus_status.map(Source::Status).into_iter().collect();
                let first = self.basis(Box::new(StylusIndicator(index + 1)), arguments, None);
                self.add(&candidate, first, &[])?;
            }
        }
        Ok(())
    }

    /// Coefficients of the effective stylus radius, for every stylus.
    pub fn probe(&mut self, settings: &Settings) -> Result<(), SettingsError> {
        let further = settings.styli.keys().filter(|number| *number != "1");
        let prefixes: Vec<String> =
            std::iter::once(String::new()).chain(further.map(|number| format!("stylus[{number}]."))).collect();
        for (stylus, prefix) in prefixes.iter().enumerate() {
            for (index, text) in settings.probe.iter().enumerate() {
                let at = |error: SettingsError| error.under([key("probe"), PathItem::Index(index)]);
                let term = probe_term(text).map_err(|message| at(SettingsError::new("", message)))?;
                let parameter = probe_parameter(prefix, stylus, term);
                self.parameter(parameter, 0.0, ParameterUse::Radius).map_err(at)?;
            }
        }
        Ok(())
    }

    /// Numbers and nominal tips of the styli other than the tool itself, which may be listed as stylus 1.
    fn further_styli<'a>(&self, settings: &'a Settings) -> Result<Vec<(&'a String, Vector3<f64>)>, SettingsError> {
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
        Ok(styli)
    }

    /// The errors of a group.
    fn among(&self, group: Group) -> impl Iterator<Item = &Candidate> {
        let belongs = move |own: Group| match group {
            Group::LocationOrMotion => own != Group::SetUp,
            Group::Any => true,
            other => own == other,
        };
        self.candidates.iter().filter(move |(own, _)| belongs(*own)).map(|(_, candidate)| candidate)
    }

    /// Adds functions of some arguments; returns the index of the basis.
    pub fn basis(&mut self, functions: Box<dyn Functions>, arguments: Vec<Source>, range: Option<Range>) -> usize {
        let count = functions.terms().len();
        let first = self.functions;
        self.bases.push(FunctionBasis { functions, arguments, first, count, range, coefficients: Vec::new() });
        self.functions += count;
        self.bases.len() - 1
    }

    /// Adds the parameters of an error on a basis, except those that are zero by definition.
    fn add(&mut self, candidate: &Candidate, basis: usize, zero: &[String]) -> Result<(), SettingsError> {
        let of = quantity_of(candidate.component);
        let command = candidate.axis.map_or(Quantity::Ratio, |axis| self.status[axis].quantity);
        let nominal = self.bases[basis].functions.nominal();
        for (index, term) in self.bases[basis].functions.terms().iter().enumerate() {
            let name = format!("{}{}", candidate.symbol, term.suffix);
            if zero.iter().any(|pattern| matches(pattern, &name)) {
                continue;
            }
            let function = self.bases[basis].first + index;
            let place = CoefficientPlace { slot: candidate.slot, component: candidate.component, function, basis };
            let parameter = Parameter::new(name, term.unit(of, command)).with_role(candidate.role);
            let parameter = self.parameter(parameter, nominal, ParameterUse::Coefficient(place))?;
            self.bases[basis].coefficients.push((parameter, place));
        }
        Ok(())
    }

    pub fn parameter(
        &mut self,
        parameter: Parameter,
        nominal: f64,
        role: ParameterUse,
    ) -> Result<usize, SettingsError> {
        if self.parameters.iter().any(|other| other.name == parameter.name) {
            return Err(SettingsError::new("", format!("`{}` is declared twice", parameter.name)));
        }
        self.parameters.push(parameter);
        self.nominal.push(nominal);
        self.uses.push(role);
        Ok(self.parameters.len() - 1)
    }

    /// The status column of that name, added if it is new; labels that are new to it are added to it.
    fn status(
        &mut self,
        name: String,
        role: StatusRole,
        (quantity, levels): (Quantity, Vec<String>),
        absent: f64,
    ) -> usize {
        if let Some(index) = self.status.iter().position(|status| status.name == name) {
            let known = &mut self.status[index].levels;
            for level in levels {
                if !known.contains(&level) {
                    known.push(level);
                }
            }
            return index;
        }
        self.status.push(StatusColumn { name, role, quantity, levels, absent: Absent::Default(absent) });
        self.status.len() - 1
    }

    /// Adds what one line under `errors` declares.
    pub fn declare(&mut self, declaration: &Declaration) -> Result<(), SettingsError> {
        let family = declaration.family();
        let (column, levels) = match declaration {
            Declaration::Drift(drift) => (drift.per.column(), drift.time_s.keys().cloned().collect()),
            Declaration::Thermal(thermal) => (thermal.series.as_deref(), thermal.logs.keys().cloned().collect()),
            _ => (None, Vec::new()),
        };
        let labels = self.labels(column, levels);
        let mut shared: BTreeMap<(Option<usize>, bool), Vec<usize>> = BTreeMap::new();
        let mut names: Vec<String> = Vec::new();
        for (index, pattern) in family.symbols().iter().enumerate() {
            let at = [key(declaration.key()), PathItem::Index(index)];
            for candidate in self.listed(pattern, family.group()).map_err(|error| error.under(at.clone()))? {
                let location = candidate.axis.is_some_and(|axis| candidate.slot == self.chain.location_slot(axis));
                // Errors of the same axis share their functions, unless these have a shape of their own.
                let bases = match shared.get(&(candidate.axis, location)) {
                    Some(bases) => bases.clone(),
                    None => self.bases_of(declaration, &candidate, location, &labels)?,
                };
                let mut shaped = false;
                for &basis in &bases {
                    self.add(&candidate, basis, family.zero()).map_err(|error| error.under(at.clone()))?;
                    let functions = &self.bases[basis].functions;
                    names.extend(functions.terms().iter().map(|term| format!("{}{}", candidate.symbol, term.suffix)));
                    shaped |= functions.arguments().iter().any(|argument| matches!(argument, Argument::Shape(..)));
                }
                if !shaped && family.shares_functions() {
                    shared.insert((candidate.axis, location), bases);
                }
            }
        }
        for (index, pattern) in family.zero().iter().enumerate() {
            if !names.iter().any(|name| matches(pattern, name)) {
                let error = SettingsError::new("", format!("`{pattern}` is no coefficient of this line"))
                    .suggest(pattern, names.iter().map(String::as_str));
                return Err(error.under([key("zero"), PathItem::Index(index)]));
            }
        }
        Ok(())
    }

    /// The errors that a pattern lists; it is wrong if there are none.
    fn listed(&self, pattern: &str, group: Group) -> Result<Vec<Candidate>, SettingsError> {
        let listed: Vec<Candidate> =
            self.among(group).filter(|candidate| matches(pattern, &candidate.symbol)).cloned().collect();
        if !listed.is_empty() {
            return Ok(listed);
        }
        let what = match group {
            Group::Location => "location",
            Group::Motion => "motion",
            Group::LocationOrMotion => "location or motion",
            Group::SetUp => "set-up",
            Group::Any => "location, motion or set-up",
        };
        let symbols = self.among(group).map(|candidate| candidate.symbol.as_str());
        let near = abbe_core::nearest(pattern, symbols).map(|near| format!("did you mean `{near}`?"));
        let error = SettingsError::new("", format!("`{pattern}` is no {what} error of this chain"));
        Err(match near {
            Some(near) => error.help(near),
            None => error,
        })
    }

    /// The labels of a column of series. All lines and bodies of the column share these labels, also if each has only some of the series.
    pub fn labels(&mut self, column: Option<&str>, levels: Vec<String>) -> Vec<String> {
        let Some(column) = column else { return Vec::new() };
        let status = self.status(column.to_owned(), StatusRole::Series, (Quantity::Label, levels), f64::NAN);
        self.status[status].levels.clone()
    }

    /// The bases of a declaration for an error, with the parameters that shape their functions.
    fn bases_of(
        &mut self,
        declaration: &Declaration,
        candidate: &Candidate,
        location: bool,
        labels: &[String],
    ) -> Result<Vec<usize>, SettingsError> {
        let axes: Vec<_> =
            (self.axes.iter()).map(|axis| (axis.name.clone(), self.status[axis.status].quantity)).collect();
        let axis = candidate.axis.map(|axis| &self.axes[axis]);
        let subject = Subject {
            location,
            of: quantity_of(candidate.component),
            command: axis.map_or(Quantity::Ratio, |axis| self.status[axis.status].quantity),
            along: match (axis, candidate.component) {
                (Some(axis), component @ 0..3) => axis.sense * axis.direction[component],
                _ => 0.0,
            },
            range: axis.and_then(|axis| axis.range),
            axes: &axes,
            labels,
        };
        let mut bases = Vec::new();
        for functions in declaration.family().functions(&subject)? {
            let mut arguments = Vec::new();
            let basis = self.bases.len();
            for argument in functions.arguments() {
                arguments.push(match argument {
                    Argument::Shape(suffix, nominal) => {
                        let unit = Unit::per(subject.command, Quantity::Ratio, 0);
                        let name = format!("{}{suffix}", candidate.symbol);
                        let shape = Parameter::new(name, unit).with_role(ParameterRole::Shape);
                        Source::Parameter(self.parameter(shape, nominal, ParameterUse::Shape(basis))?)
                    }
                    Argument::SharedShape(name, nominal, unit) => {
                        Source::Parameter(self.shared_shape(name, nominal, unit, basis)?)
                    }
                    other => Source::Status(self.argument(other, candidate.axis)?),
                });
            }
            let ends = functions.range();
            let range =
                ends.zip(candidate.axis).map(|(ends, axis)| Range { axis, ends, error: candidate.symbol.clone() });
            bases.push(self.basis(functions, arguments, range));
        }
        Ok(bases)
    }

    /// The parameter of that name that shapes functions of several errors, added if it is new.
    fn shared_shape(&mut self, name: String, nominal: f64, unit: Unit, basis: usize) -> Result<usize, SettingsError> {
        let known = self.parameters.iter().position(|parameter| parameter.name == name);
        match known {
            Some(index) if self.nominal[index] == nominal => Ok(index),
            Some(index) => {
                let message = format!("`{name}` is {} in another line, and {nominal} here", self.nominal[index]);
                Err(SettingsError::new("", message).help("all lines share it"))
            }
            None => {
                let shape = Parameter::new(name, unit).with_role(ParameterRole::Shape);
                self.parameter(shape, nominal, ParameterUse::Shape(basis))
            }
        }
    }

    /// The status that is an argument of a function.
    pub fn argument(&mut self, argument: Argument, axis: Option<usize>) -> Result<usize, SettingsError> {
        Ok(match (argument, axis) {
            (Argument::Command, Some(axis)) => axis,
            (Argument::CommandOf(name), axis) => {
                self.axes.iter().position(|axis| axis.name == name).or(axis).ok_or_else(|| {
                    SettingsError::new("errors", format!("an error follows axis {name}, which the chain does not have"))
                })?
            }
            (Argument::Direction, Some(axis)) => {
                let role = StatusRole::Direction(axis);
                self.status(role.column_name(&self.axes).unwrap_or_default(), role, (Quantity::Ratio, Vec::new()), 0.0)
            }
            (Argument::Velocity, Some(axis)) => {
                let role = StatusRole::Velocity(axis);
                self.status(role.column_name(&self.axes).unwrap_or_default(), role, (Quantity::Speed, Vec::new()), 0.0)
            }
            (Argument::Load, _) => self.status("load".to_owned(), StatusRole::Load, (Quantity::Force, Vec::new()), 0.0),
            (Argument::Temperature(name), _) => {
                self.status(name, StatusRole::Temperature, (Quantity::Temperature, Vec::new()), f64::NAN)
            }
            (Argument::LoadZ, _) => {
                self.status("load_z".to_owned(), StatusRole::Other, (Quantity::Length, Vec::new()), 0.0)
            }
            (Argument::Series(column), _) => {
                self.status(column, StatusRole::Series, (Quantity::Label, Vec::new()), f64::NAN)
            }
            (Argument::Time, _) => {
                self.status("time".to_owned(), StatusRole::Time, (Quantity::Time, Vec::new()), f64::NAN)
            }
            (Argument::Stylus, _) if self.stylus_status.is_some() => self.stylus_status.unwrap_or_default(),
            (
                other @ (Argument::Command
                | Argument::Direction
                | Argument::Velocity
                | Argument::Stylus
                | Argument::Shape(..)
                | Argument::SharedShape(..)),
                _,
            ) => {
                let message = format!("an error follows {other:?}, which it does not have here");
                return Err(SettingsError::new("errors", message));
            }
        })
    }
}

pub(crate) fn quantity_of(component: usize) -> Quantity {
    if component < 3 { Quantity::Length } else { Quantity::Angle }
}

pub(crate) fn key(name: &str) -> PathItem {
    PathItem::Key(name.to_owned())
}

pub(crate) fn finite(setting: &str, value: f64) -> Result<(), SettingsError> {
    if value.is_finite() { Ok(()) } else { Err(SettingsError::new(setting, "a finite number was expected")) }
}
