//! Whether estimated errors can be errors of a machine at all.
//!
//! A wrong sign, a swapped column or a wrong unit is absorbed by the parameters: the fit may look good while a scale is off by 200 %.
//! So every estimated error is held against what such an error can be.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use abbe_core::{
    Absent, AxisKind, Calibration, Owner, Parameter, ParameterRole, ProbeTerm, Problem, Quantity, Result, Status,
    StatusRole, Unit, Unknown,
};

use crate::plausible::Plausible;
use crate::separation::thinned;

/// Largest plausible error motion over the recorded travel, mm and rad.
const MOTION: [f64; 2] = [10.0, 20e-3];

/// Largest plausible offset and tilt of an axis, mm and rad.
const LOCATION: [f64; 2] = [10.0, 20e-3];

/// Largest plausible offset and tilt of a set-up, mm and rad: tools are measured, workpieces are clamped.
const SET_UP: [f64; 2] = [20.0, 50e-3];

/// Largest plausible deviation of an effective stylus radius, and of its variation with the direction, mm: styli are measured.
const STYLUS_RADIUS: f64 = 0.5;
const LOBE: f64 = 0.2;

/// Longest plausible time from the contact to the recorded position, s: radio and slow inputs take milliseconds.
const DELAY: f64 = 0.05;

/// Longest plausible lag of an axis behind its command, s: the slowest loops of position (a gain of 0.5 m/min a mm) have 0.12 s.
const LAG: f64 = 0.2;

/// The same for a position that is recorded before the contact: a control that corrects its delay may do so by too much, s.
const EARLY: f64 = 5e-3;

/// Largest plausible change for each kelvin, by the powers of length in its unit: mm/K, and 1/K (plastics expand by 100 µm/(m K)); rad/K,
/// and rad/(mm K).
const LENGTH_PER_KELVIN: [f64; 2] = [0.2, 1e-4];
const ANGLE_PER_KELVIN: [f64; 2] = [1e-3, 1e-5];

/// Part of a bound from which an error is told, though it may be real.
const TOLD: f64 = 0.2;

/// Standard uncertainties that a value may be off by.
const COVERED: f64 = 3.0;

/// An estimated error that is larger than it can be, or nearly so.
#[derive(Debug, Clone, PartialEq)]
pub struct LargeError {
    /// The parameter.
    pub unknown: Unknown,
    /// The error that it makes at most over the recorded travel, mm, rad or s, with the sign of the parameter.
    pub size: f64,
    /// What it may be off by, mm, rad or s: three standard uncertainties.
    pub margin: f64,
    /// What is plausible, mm, rad or s.
    pub bound: f64,
}

impl LargeError {
    /// Whether it is beyond what is plausible.
    pub fn is_implausible(&self) -> bool {
        self.size.abs() - self.margin > self.bound
    }

    /// The error and its bound, for people.
    pub fn describe(&self) -> String {
        let is_error_motion = self.unknown.unit.per.is_some() || self.unknown.unit.of == Quantity::PerTemperature;
        let over = if is_error_motion { " over the recorded travel" } else { "" };
        format!("{} = {}{over}", self.unknown.name, self.of_size(self.size))
    }

    /// What is plausible, for people.
    pub fn plausible(&self) -> String {
        self.of_size(self.bound)
    }

    /// The setting that states what is plausible.
    pub fn setting(&self) -> &'static str {
        match self.unknown.unit.of {
            Quantity::Angle => "mrad",
            Quantity::Time => "s",
            _ => "mm",
        }
    }

    fn of_size(&self, size: f64) -> String {
        match self.unknown.unit.of {
            Quantity::Angle => format!("{} mrad", rounded(size * 1e3)),
            Quantity::Time => format!("{} s", rounded(size)),
            _ => format!("{} mm", rounded(size)),
        }
    }
}

/// Three digits.
fn rounded(value: f64) -> f64 {
    let scale = 10f64.powi(2 - value.abs().max(1e-12).log10().floor() as i32);
    (value * scale).round() / scale
}

/// The estimated parameters of the machine that are larger than it can be, or nearly so; the largest first. What may be large by
/// chance, for its uncertainty, is none of them.
pub fn large_errors(plausible: &Plausible, problem: &Problem, calibration: &Calibration) -> Result<Vec<LargeError>> {
    let estimated =
        |unknown: &Unknown| calibration.get(&unknown.name).is_some_and(|found| found.status == Status::Estimated);
    let unknowns: Vec<Unknown> = problem.machine_unknowns().into_iter().filter(estimated).collect();
    let values = |unknown: &Unknown| {
        // A fit that explains nothing has large uncertainties, which are no excuse for large errors.
        let scale = calibration.fit.sigma.max(1.0);
        calibration.get(&unknown.name).map_or((0.0, 0.0), |found| (found.value, found.standard_uncertainty / scale))
    };
    judged(plausible, &problem.with_values(&problem.values_of(calibration)), &unknowns, values)
}

/// Factor from which on known errors act the other way round. A control that corrects a little too much leaves a small one.
const OPPOSITE: f64 = -0.2;

/// An estimated factor of known errors ([`ParameterRole::Factor`]) that turns them round, with its value.
pub fn opposite_factor(problem: &Problem, calibration: &Calibration) -> Option<(String, f64)> {
    let factors = problem.machine_unknowns().into_iter();
    let factors = factors.filter(|own| problem.model.info().parameters[own.index].role == ParameterRole::Factor);
    let found = factors.filter_map(|own| calibration.get(&own.name).map(|found| (own.name, found)));
    let scale = calibration.fit.sigma.max(1.0);
    let is_opposite = |value: f64, u: f64| value + COVERED * u / scale < OPPOSITE;
    let mut opposite = found
        .filter(|(_, found)| found.status == Status::Estimated && is_opposite(found.value, found.standard_uncertainty));
    opposite.next().map(|(name, found)| (name, found.value))
}

/// An estimate of a parameter whose value the recipe states with a standard uncertainty, from which it is far.
#[derive(Debug, Clone, PartialEq)]
pub struct Contradicted {
    /// The parameter.
    pub name: String,
    /// Its unit; the values are in it.
    pub unit: Unit,
    /// Estimate and its standard uncertainty.
    pub found: [f64; 2],
    /// Stated value and its standard uncertainty.
    pub stated: [f64; 2],
}

/// Standard uncertainties, of the statement and of the estimate together, that an estimate may be off by.
const CONTRADICTED: f64 = 4.0;

/// Ratio of an estimate to a statement that it contradicts, or of the statement to it, from which one of them is a mistake.
const MISTAKEN: f64 = 3.0;

impl Contradicted {
    /// Whether statement or data must be a mistake: what is known of a material is not off by a factor of three.
    pub fn is_mistake(&self) -> bool {
        let ratio = self.found[0] / self.stated[0];
        self.stated[0] != 0.0 && !(1.0 / MISTAKEN..=MISTAKEN).contains(&ratio)
    }

    /// What contradicts what, for people.
    pub fn describe(&self) -> String {
        let (symbol, factor) = self.unit.for_people();
        let symbol = if symbol == "1" { String::new() } else { format!(" {symbol}") };
        let [value, u] = self.found.map(|number| rounded(number * factor));
        let [stated, of_stated] = self.stated.map(|number| rounded(number * factor));
        format!("`{}` is found as {value} ± {u}{symbol}, and {stated} ± {of_stated}{symbol} is stated", self.name)
    }
}

/// The estimated parameters of the machine that contradict their statements: coefficients of expansion, factors of bodies.
pub fn contradicted(problem: &Problem, calibration: &Calibration) -> Vec<Contradicted> {
    let info = problem.model.info();
    let of = |unknown: Unknown| {
        let found = calibration.get(&unknown.name).filter(|found| found.status == Status::Estimated)?;
        let stated = [info.nominal[unknown.index], info.nominal_uncertainties[unknown.index]];
        let both = stated[1].hypot(found.standard_uncertainty);
        let is_far = stated[1] > 0.0 && (found.value - stated[0]).abs() > CONTRADICTED * both;
        is_far.then_some(Contradicted {
            name: unknown.name,
            unit: unknown.unit,
            found: [found.value, found.standard_uncertainty],
            stated,
        })
    };
    problem.machine_unknowns().into_iter().filter_map(of).collect()
}

/// The errors of a machine whose true values are known, estimated or not, that are larger than an error can be; the largest first.
pub fn implausible_errors(plausible: &Plausible, at: &Problem) -> Result<Vec<LargeError>> {
    let unknown = |(index, parameter): (usize, &Parameter)| Unknown {
        name: parameter.name.clone(),
        unit: parameter.unit,
        owner: Owner::Machine,
        index,
    };
    let all: Vec<Unknown> = at.model.info().parameters.iter().enumerate().map(unknown).collect();
    let mut found = judged(plausible, at, &all, |unknown| (at.machine_values[unknown.index], 0.0))?;
    found.retain(LargeError::is_implausible);
    Ok(found)
}

/// As [`large_errors`], of values without a calibration; the unknowns stand at them.
pub(crate) fn large_errors_at(plausible: &Plausible, at: &Problem) -> Result<Vec<LargeError>> {
    judged(plausible, at, &at.machine_unknowns(), |unknown| (at.value_of(unknown), 0.0))
}

fn judged(
    plausible: &Plausible,
    at: &Problem,
    unknowns: &[Unknown],
    value: impl Fn(&Unknown) -> (f64, f64),
) -> Result<Vec<LargeError>> {
    let motions = Motions::of(at)?;
    let mut found = Vec::new();
    for unknown in unknowns {
        let (value, standard_uncertainty) = value(unknown);
        let nominal = at.model.info().nominal[unknown.index];
        let Some(bound) = bound(plausible, at, unknown, value - nominal) else { continue };
        let is_lag = is_lag(at, unknown);
        let Some(effect) = (if is_lag { Some(1.0) } else { motions.effect(unknown) }) else { continue };
        let bound = match per_kelvin(unknown.unit) {
            Some(most) if plausible.stated(&unknown.name, unknown.unit).is_none() => bound.min(most * effect),
            _ => bound,
        };
        // Terms that are large where the travel is far from zero may cancel: what counts is the error motion that they make together.
        let whole = motions.whole(at, unknown).filter(|_| !is_lag).unwrap_or(f64::INFINITY);
        let size = ((value - nominal) * effect).clamp(-whole, whole);
        let margin = COVERED * standard_uncertainty * effect;
        if size.abs() - margin > TOLD * bound {
            found.push(LargeError { unknown: unknown.clone(), size, margin, bound });
        }
    }
    found.sort_by(|a, b| (b.size.abs() / b.bound).total_cmp(&(a.size.abs() / a.bound)));
    Ok(found)
}

/// Largest errors of an axis over its travel, mm and rad, in a statement or a calibration from elsewhere: ten times what is plausible.
const STATED: [f64; 2] = [100.0, 0.2];

/// Travel, mm and rad, of an axis whose range is not known.
const TRAVEL: [f64; 2] = [500.0, PI];

/// An error that no machine has, among those of a fit without rows: the larger end of the travel of each axis counts. None if there is
/// none.
pub fn absurd_error(problem: &Problem) -> Option<String> {
    let (info, values) = (problem.model.info(), &problem.machine_values);
    let unit = |index: usize| if index == 0 { "mm" } else { "rad" };
    let is_absurd = |size: f64, index: usize| size.is_nan() || size.abs() > STATED[index];
    for (parameter, value) in info.parameters.iter().zip(values) {
        let index = usize::from(parameter.unit.of == Quantity::Angle);
        if matches!(parameter.role, ParameterRole::Location { .. }) && is_absurd(*value, index) {
            return Some(format!("{} = {value:e} {}", parameter.name, unit(index)));
        }
    }
    let at_rest: Vec<f64> = (info.status.iter())
        .map(|column| match (&column.role, column.absent) {
            (StatusRole::Direction(_), _) => 1.0,
            (_, Absent::Default(value)) => value,
            (_, Absent::Required) => 0.0,
        })
        .collect();
    for function in &info.error_functions {
        let axis = &info.axes[function.axis];
        let travel = TRAVEL[usize::from(axis.kind == AxisKind::Rotary)];
        let index = usize::from(function.quantity == Quantity::Angle);
        for end in axis.range.unwrap_or([-travel, travel]) {
            let mut status = at_rest.clone();
            status[axis.status] = end;
            // An error that cannot be evaluated here is not judged here.
            let Ok(error) = problem.model.motion_error(function, values, &status) else { continue };
            if is_absurd(error.value, index) {
                return Some(format!(
                    "{} = {:e} {} at an end of the travel",
                    function.symbol,
                    error.value,
                    unit(index)
                ));
            }
        }
    }
    None
}

/// The largest plausible coefficient of temperature of this unit; none for other units.
fn per_kelvin(unit: Unit) -> Option<f64> {
    let kelvin = Quantity::Temperature;
    if unit == Unit::of(Quantity::PerTemperature) {
        return Some(LENGTH_PER_KELVIN[1]);
    }
    let power = match (unit.per, unit.and_per) {
        (Some((of, 1)), None) if of == kelvin => 0,
        (Some((Quantity::Length, 1)), Some(of)) if of == kelvin => 1,
        _ => return None,
    };
    match unit.of {
        Quantity::Length => Some(LENGTH_PER_KELVIN[power]),
        Quantity::Angle => Some(ANGLE_PER_KELVIN[power]),
        _ => None,
    }
}

/// What is plausible of a parameter, mm, rad or s; none where nothing is known of its kind. `change` is what it is off its nominal
/// value: what a recipe states holds on both sides, and a delay before the contact is less plausible than one after it.
fn bound(plausible: &Plausible, problem: &Problem, unknown: &Unknown, change: f64) -> Option<f64> {
    let role = problem.model.info().parameters[unknown.index].role;
    let index = match unknown.unit.of {
        Quantity::Length | Quantity::PerTemperature => 0,
        Quantity::Angle => 1,
        Quantity::Time if matches!(role, ParameterRole::Probe { .. }) || is_lag(problem, unknown) => 2,
        _ => return None,
    };
    if let Some(bound) = plausible.stated(&unknown.name, unknown.unit) {
        return Some(bound);
    }
    match role {
        ParameterRole::Motion { .. } if index == 2 => Some(LAG),
        ParameterRole::Motion { .. } => MOTION.get(index).copied(),
        ParameterRole::Location { .. } => LOCATION.get(index).copied(),
        ParameterRole::SetUp => SET_UP.get(index).copied(),
        ParameterRole::Probe { term: ProbeTerm::Radius, .. } => Some(STYLUS_RADIUS),
        ParameterRole::Probe { term: ProbeTerm::Delay, .. } => Some(if change < 0.0 { EARLY } else { DELAY }),
        ParameterRole::Probe { .. } => Some(LOBE),
        ParameterRole::Shape | ParameterRole::Factor | ParameterRole::Feature | ParameterRole::Other => None,
    }
}

/// Whether it is the lag of an axis, which is judged as a time: slow paths make little of it.
fn is_lag(problem: &Problem, unknown: &Unknown) -> bool {
    let role = problem.model.info().parameters[unknown.index].role;
    unknown.unit == Unit::of(Quantity::Time) && matches!(role, ParameterRole::Motion { .. })
}

/// Error motions over the recorded statuses.
struct Motions {
    /// The largest error that each parameter makes, mm or rad for each unit of its value.
    effects: BTreeMap<usize, f64>,
    /// The largest error of each component of each axis, mm or rad.
    whole: BTreeMap<(usize, usize), f64>,
}

impl Motions {
    fn of(problem: &Problem) -> Result<Self> {
        let (mut effects, mut whole): (BTreeMap<usize, f64>, BTreeMap<(usize, usize), f64>) = Default::default();
        for set in &thinned(problem).sets {
            for pose in set.poses_of(&set.rows) {
                let status = set.poses().row(pose);
                for function in &problem.model.info().error_functions {
                    // An error that cannot be evaluated here has no part in this row.
                    let Ok(error) = problem.model.motion_error(function, &problem.machine_values, status) else {
                        continue;
                    };
                    for (index, by) in error.derivatives.into_iter().filter(|(_, by)| by.is_finite()) {
                        let effect = effects.entry(index).or_default();
                        *effect = effect.max(by.abs());
                    }
                    let largest = whole.entry((function.axis, function.component)).or_default();
                    *largest = largest.max(error.value.abs());
                }
            }
        }
        Ok(Self { effects, whole })
    }

    /// The effect of one parameter; none where it is not known.
    fn effect(&self, unknown: &Unknown) -> Option<f64> {
        match unknown.unit.per {
            None if unknown.unit.of != Quantity::PerTemperature => Some(1.0),
            _ => self.effects.get(&unknown.index).copied(),
        }
    }

    /// The whole error motion that a parameter is a part of; none for other parameters.
    fn whole(&self, problem: &Problem, unknown: &Unknown) -> Option<f64> {
        match problem.model.info().parameters[unknown.index].role {
            ParameterRole::Motion { axis, component } => self.whole.get(&(axis, component)).copied(),
            _ => None,
        }
    }
}
