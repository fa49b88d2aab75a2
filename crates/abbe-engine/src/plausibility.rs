//! Errors that no machine has: a run with them fails, with the mistake that explains them.

use std::collections::BTreeSet;
use std::f64::consts::PI;
use std::iter::repeat_n;
use std::ops::RangeInclusive;

use abbe_core::{
    Calibration, Class, Dataset, Error, Fit, ImplausibleValue, Kind, KinematicModel, ObservationSet, ParameterRole,
    Problem, Quantity, Result, Status, Unit,
};
use abbe_estimation::{
    LargeError, Plausible, absurd_error, contradicted, dead_channels, implausible_errors, large_errors, likely_causes,
    likely_mistakes, opposite_factor, spoiling_row,
};
use abbe_recipe::Stage;

use crate::groups::stage_name;
use crate::outcome::Failure;
use crate::prepare::Prepared;
use crate::run::has_rows;

/// Most implausible errors that a message names.
const NAMED: usize = 3;

/// The estimates of known factors and of what the recipe states that cannot be true.
fn of_statements(fit: &Fit) -> Vec<Error> {
    let mut errors = Vec::new();
    if let Some((name, value)) = opposite_factor(&fit.problem, &fit.calibration) {
        let message = format!(
            "no machine has such errors: `{name}` = {value:.3}; what it multiplies would act the other way round"
        );
        errors.push(Error::data(message).help("look for a wrong sign of a coefficient or of the temperatures"));
    }
    for stated in contradicted(&fit.problem, &fit.calibration).iter().filter(|stated| stated.is_mistake()) {
        let help = "look for a wrong digit or unit in the statement or in the temperatures; if less is known, state a larger standard \
                    uncertainty";
        errors.push(Error::data(format!("one of two must be wrong: {}", stated.describe())).help(help));
    }
    errors
}

/// The scatter of residuals below which data are exact: they repeat to the last digit.
pub(crate) const EXACT: f64 = 0.01;

/// Channels that no working instrument has.
fn of_instruments(fit: &Fit) -> Vec<Error> {
    if fit.calibration.fit.sigma <= EXACT {
        return Vec::new();
    }
    let help = "measure again, or leave these rows out: what is estimated from them is not that of the machine";
    dead_channels(&fit.problem).into_iter().map(|words| Error::data(words).help(help)).collect()
}

/// The feature that is found farthest beyond where it may be: the tool length or a place has another unit.
fn of_features(plausible: &Plausible, fit: &Fit) -> Option<Error> {
    let at = fit.problem.with_values(&fit.problem.values_of(&fit.calibration));
    let of_set = |set: &ObservationSet| {
        let own = set.info().unknowns.iter().zip(set.own.iter().zip(&set.info().start));
        let features = own.filter(|(own, _)| own.role == ParameterRole::Feature && own.unit == Unit::MM);
        let judged = features.map(|(own, (value, start))| {
            let name = format!("{}.{}", set.name, own.name);
            let most = plausible.stated(&name, own.unit).unwrap_or(FEATURES[0]);
            (name, (value - start).abs(), most)
        });
        judged.collect::<Vec<_>>()
    };
    let beyond = at.sets.iter().flat_map(of_set).filter(|(_, off, most)| off > most);
    let (name, off, most) = beyond.max_by(|(_, one, _), (_, other, _)| one.total_cmp(other))?;
    let message = format!(
        "no artefact is so far off: `{name}` is found {off:.0} mm from its nominal place; {most} mm is plausible at most"
    );
    let help = format!(
        "look for a wrong unit, tool length or work offset, and at the nominal places, or say in the estimate \
         `plausible: {{ mm: {{ \"{name}\": .. }} }}`"
    );
    Some(Error::data(message).help(help))
}

impl Prepared {
    /// Fails for an estimate with errors that no machine has: a long calculation with it says nothing.
    pub(crate) fn check_plausible(&self, fit: &Fit) -> Result<()> {
        let stage = self.recipe_stage(stage_name(&fit.name))?;
        let Some(plausible) = self.plausible.get(&stage.name).filter(|_| has_rows(&stage)) else { return Ok(()) };
        let large = large_errors(plausible, &fit.problem, &fit.calibration)?;
        match large.iter().any(LargeError::is_implausible) {
            true => Err(Error::data(format!("it needs `{}`, which failed: no machine has its errors", fit.name))),
            false => Ok(()),
        }
    }

    /// The estimates from measurements with errors that are implausible; these are marked in their calibrations. What is large, and may
    /// be real, is told only.
    pub(crate) fn implausible(&self, fits: &mut [Fit]) -> Result<Vec<Failure>> {
        let mut failures = Vec::new();
        for fit in fits {
            let stage = self.recipe_stage(stage_name(&fit.name))?;
            if !has_rows(&stage) {
                if let Some(absurd) = absurd_error(&fit.problem) {
                    let error = Error::data(format!("no machine has such errors: {absurd}"))
                        .help("look for a wrong unit or digit in the values of this stage");
                    failures.push(Failure::own(stage, self.recipe.locate(error.stage(&stage.name))));
                }
                continue;
            }
            let errors =
                of_statements(fit).into_iter().chain(of_instruments(fit)).map(|error| error.stage(&stage.name));
            failures.extend(errors.map(|error| Failure::own(stage, self.recipe.locate(error))));
            let plausible = &self.plausible[&stage.name];
            let mut large = self.located(stage, large_errors(plausible, &fit.problem, &fit.calibration))?;
            // Beside an error that no machine has, large ones need no word.
            let is_implausible = large.iter().any(LargeError::is_implausible);
            large.retain(|large| large.is_implausible() == is_implausible);
            let causes = likely_causes(&fit.problem, &fit.calibration, &large);
            let Some(worst) = large.first().filter(|_| is_implausible) else {
                causes.iter().for_each(|sentence| tracing::warn!("{}: {sentence}", fit.name));
                let error = of_features(plausible, fit).map(|error| self.recipe.locate(error.stage(&stage.name)));
                failures.extend(error.map(|error| Failure::own(stage, error)));
                continue;
            };
            // Rows that lie in parts are not at hand: nothing can be tried.
            let row = (fit.problem.equations() > 0).then(|| spoiling_row(&fit.problem, plausible)).flatten();
            if let Some(row) = row {
                // What errors look like is no cause where one row makes them.
                let error = implausible_error(worst, &large, [row].into_iter(), WRONG_DATA);
                fit.calibration.fit.implausible = large.iter().map(record).collect();
                failures.push(Failure::own(stage, self.recipe.locate(error.stage(&stage.name))));
                continue;
            }
            let tried =
                if fit.problem.equations() == 0 { Ok(Vec::new()) } else { likely_mistakes(&fit.problem, plausible) };
            let mistakes = match tried {
                Err(error) if error.out_of_time => Vec::new(),
                mistakes => self.located(stage, mistakes)?,
            };
            let error = implausible_error(worst, &large, mistakes.into_iter().chain(causes), WRONG_DATA);
            fit.calibration.fit.implausible = large.iter().map(record).collect();
            failures.push(Failure::own(stage, self.recipe.locate(error.stage(&stage.name))));
        }
        Ok(failures)
    }

    /// Refuses true values that no machine has. What the recipe says to be plausible for one of the estimates of this machine may be
    /// true.
    pub(crate) fn check_truth(&self, machine: &str, truth: &Problem) -> Result<()> {
        let (mut refused, mut plausible): (Option<Vec<LargeError>>, Vec<&Plausible>) = (None, Vec::new());
        for stage in self.stages(Kind::Estimate).filter(has_rows) {
            if self.is_of(stage, machine)? {
                plausible.push(&self.plausible[&stage.name]);
                let found = implausible_errors(&self.plausible[&stage.name], truth)?;
                let names: BTreeSet<&String> = found.iter().map(|error| &error.unknown.name).collect();
                refused = Some(match refused {
                    Some(all) => all.into_iter().filter(|error| names.contains(&error.unknown.name)).collect(),
                    None => found.clone(),
                });
            }
        }
        match refused.unwrap_or_default().as_slice() {
            [] => check_own(&plausible, truth),
            all @ [worst, ..] => {
                let none = std::iter::empty();
                Err(Error { class: Class::Use, ..implausible_error(worst, all, none, WRONG_TRUTH) })
            }
        }
    }

    /// The error of a fit that does not converge, with the mistake that explains why.
    pub(crate) fn with_mistakes(&self, stage: &Stage, problem: &Problem, error: Error) -> Error {
        if error.convergence.is_none() || error.class != Class::Data || error.fatal {
            return error;
        }
        match likely_mistakes(problem, &self.plausible[&stage.name]) {
            Ok(mistakes) if !mistakes.is_empty() => {
                let help = error.help.clone().map_or_else(String::new, |help| format!("; {help}"));
                error.help(format!("{}{help}", mistakes.join("; ")))
            }
            _ => error,
        }
    }
}

/// How far the truth of an artefact may be from what is stated of it, mm and rad: features, other unknowns (the place of an observer),
/// and what certificates and measured styli say.
const FEATURES: [f64; 2] = [1e3, 0.2];
const OTHERS: [f64; 2] = [1e5, PI];
const INPUTS: [f64; 2] = [20.0, 0.05];

/// Smallest stated size, mm, whose true value is above zero: certificates are nearer to the truth than that.
const LEAST_SIZE: f64 = 0.1;

/// Refuses true values of artefacts and known inputs that nobody can mean, if no estimate says that they are plausible.
fn check_own(plausible: &[&Plausible], truth: &Problem) -> Result<()> {
    for set in &truth.sets {
        let info = set.info();
        let own = info.unknowns.iter().zip(set.own.iter().zip(&info.start)).map(|(parameter, (value, start))| {
            let mut most = if parameter.role == ParameterRole::Feature { FEATURES } else { OTHERS };
            let name = format!("{}.{}", set.name, parameter.name);
            let stated = plausible.iter().filter_map(|plausible| plausible.stated(&name, parameter.unit));
            most[0] = stated.filter(|_| parameter.unit == Unit::MM).fold(most[0], f64::max);
            (parameter, value - start, most)
        });
        for (input, value) in info.inputs.iter().zip(&set.inputs) {
            // What is stated as a size (a radius, a length) is one; a coordinate near zero may have either sign.
            if input.parameter.unit == Unit::MM && input.value > LEAST_SIZE && *value <= 0.0 {
                let name = &input.parameter.name;
                let message = format!(
                    "`{name}` of `{}` is {value} mm, and {} mm is stated: a number above 0 was expected",
                    set.name, input.value
                );
                return Err(Error::usage(message).help(WRONG_TRUTH));
            }
        }
        let inputs = info.inputs.iter().zip(&set.inputs);
        let inputs = inputs.map(|(input, value)| (&input.parameter, value - input.value, INPUTS));
        for (parameter, off, most) in own.chain(inputs) {
            let (most, unit, scale) = match (parameter.unit.of, parameter.unit.per) {
                (Quantity::Length, None) => (most[0], "mm", 1.0),
                (Quantity::Angle, None) => (most[1], "mrad", 1e3),
                _ => continue,
            };
            if off.abs() > most {
                let (name, off, most) = (&parameter.name, off * scale, most * scale);
                let message = format!(
                    "`{name}` of `{}` is {off:.4} {unit} from what is stated; at most {most} {unit} were expected",
                    set.name
                );
                return Err(Error::usage(message).help(WRONG_TRUTH));
            }
        }
    }
    Ok(())
}

/// Standard uncertainties of rows that are read, mm and rad.
const STATED: RangeInclusive<f64> = 1e-9..=1e6;

/// Diameters of a stylus tip that are of the same one, mm: a calibrated tip is smaller than its name by less than that.
const SAME_TIP: f64 = 0.1;

/// Fails if the header of a file states another stylus tip than the machine has.
pub(crate) fn check_tips(data: &Dataset, model: &dyn KinematicModel) -> Result<()> {
    let of_machine = 2.0 * model.info().stylus_radius;
    let Some(tip) = data.stated_tips.iter().find(|tip| (tip.diameter - of_machine).abs() > SAME_TIP) else {
        return Ok(());
    };
    let [stated, of_machine] = [tip.diameter, of_machine].map(|diameter| (diameter * 1e4).round() / 1e4);
    let message =
        format!("measured with a stylus tip of {stated} mm diameter, and the machine has one of {of_machine} mm");
    let help = "which one is right? Correct `stylus_radius_mm` of the machine, or the tip in the header of this file";
    Err(Error::data(message).at(&data.files[tip.file], tip.line, None).help(help))
}

/// Refuses rows with a standard uncertainty that nothing has: it is in another unit, or a slip.
pub(crate) fn check_stated(set: &ObservationSet) -> Result<()> {
    let layout = &set.info().layout;
    let rows = set.rows.iter().flat_map(|&row| repeat_n(row, layout.rows[row].equations));
    for (row, equation) in rows.zip(set.taken()) {
        let stated = set.uncertainty.standard[equation];
        if STATED.contains(&stated) {
            continue;
        }
        let message =
            format!("the standard uncertainty of this row is {stated:e} (mm or rad); 1e-9 to 1e6 was expected");
        let error = match layout.rows[row].data_row {
            Some(data_row) => layout.data.error_at(data_row, message),
            None => Error::data(message),
        };
        return Err(error.help("look at what the artefact stage states, and at its unit"));
    }
    Ok(())
}

/// Refuses a value that is called estimated with a standard uncertainty of zero: no measurement is that good.
pub(crate) fn check_uncertainties(calibration: &Calibration) -> Result<()> {
    let mut all = calibration.parameters.iter().chain(&calibration.artefacts);
    let exact = all.find(|found| found.status == Status::Estimated && found.standard_uncertainty == 0.0);
    match exact {
        None => Ok(()),
        Some(_) if calibration.fit.sigma == 0.0 => Err(Error::data(
            "all residuals are exactly zero: their scatter says nothing of uncertainties",
        )
        .help(
            "set `trust_uncertainties: true` to take the stated uncertainties, if these readings were really measured",
        )),
        Some(exact) => Err(Error::data(format!("the standard uncertainty of `{}` would be zero", exact.name))
            .help("state the standard uncertainties of the rows that determine it")),
    }
}

fn record(large: &LargeError) -> ImplausibleValue {
    ImplausibleValue { name: large.unknown.name.clone(), size: large.size, plausible: large.bound }
}

/// Where to look for the mistake.
const WRONG_DATA: &str = "look for a wrong sign, column or unit in the recipe and the data";
const WRONG_TRUTH: &str = "look for a wrong unit or digit (values are in mm and rad)";

/// `implausible` are all of them, with the worst one first.
fn implausible_error(
    worst: &LargeError,
    implausible: &[LargeError],
    causes: impl Iterator<Item = String>,
    look: &str,
) -> Error {
    let named: Vec<String> = implausible.iter().take(NAMED).map(LargeError::describe).collect();
    let more = implausible.len().saturating_sub(NAMED);
    let rest = if more > 0 { format!(" and {more} more") } else { String::new() };
    let message =
        format!("no machine has such errors: {}{rest}; {} is plausible at most", named.join(", "), worst.plausible());
    let (unit, name) = (worst.setting(), &worst.unknown.name);
    let widen = format!("{look}, or say in the estimate `plausible: {{ {unit}: {{ \"{name}\": .. }} }}`");
    let help: Vec<String> = causes.chain([widen]).collect();
    Error::data(message).help(help.join("; "))
}
