//! What the touches of a method tell of a machine, found by asking the estimator.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use abbe_core::{
    AxisKind, Class, Error, Identifiability, KinematicModel, Monitor, ParameterRole, Registry, Result, Unit,
};
use abbe_engine::{Planned, Prepared, prepare};
use abbe_kinematics::{NamedAxis, StructuralLoop};

use crate::interrupt::{TemporaryFolder, no_temporary_file};

use super::methods::{Choice, turns_about_two};
use super::texts::{Errors, Recipe, machine};
use super::{Controller, Method, poses};

/// What is written, and what it tells.
#[derive(Debug)]
pub struct Beginning {
    /// Texts by the names of their files.
    pub files: BTreeMap<PathBuf, String>,
    /// File of the nominal places, if there are some.
    pub nominal: Option<&'static str>,
    /// Rows of the data file.
    pub rows: usize,
    /// Different positions of the rotary axes.
    pub indexations: usize,
    /// Errors of the machine that they tell.
    pub errors: usize,
    /// Those that the touches do not tell.
    pub left_out: Vec<String>,
    /// Name, unit and expected standard uncertainty of the unknowns of the machine.
    pub expected: Vec<(String, String, f64)>,
    /// Sentences for the user.
    pub remarks: Vec<String>,
}

/// Condition beyond which an unknown is left out although it is determined: micrometres of noise make a metre of it.
const WEAK: f64 = 1e5;

/// Folds of the validation by positions that were left out.
const FOLDS: usize = 4;

/// A folder in which recipes are tried.
struct Trial<'a> {
    folder: TemporaryFolder,
    registry: &'a Registry,
    /// Asked before every trial.
    monitor: &'a Monitor,
    files: BTreeMap<PathBuf, String>,
}

impl Trial<'_> {
    fn write(&mut self, name: &str, text: String) -> Result<()> {
        fs::write(self.folder.path().join(name), &text).map_err(no_temporary_file)?;
        self.files.insert(PathBuf::from(name), text);
        Ok(())
    }

    fn prepared(&mut self, recipe: &Recipe<'_>) -> Result<Prepared> {
        self.monitor.check()?;
        self.write(RECIPE, recipe.text())?;
        prepare(&self.folder.path().join(RECIPE), self.registry).map_err(|error| Error { place: None, ..error })
    }

    /// What the fit of a recipe can determine.
    fn checked(&mut self, recipe: &Recipe<'_>) -> Result<Planned> {
        let mut planned = self.prepared(recipe)?.check()?;
        planned.pop().ok_or_else(|| Error::data("the recipe has no fit"))
    }
}

const RECIPE: &str = "recipe.yaml";
const MACHINE: &str = "machine.yaml";

/// The files of a first calibration.
///
/// Fails with the reason if this method tells nothing of this machine.
pub fn begin(
    chain: &StructuralLoop,
    method: Method,
    controller: Option<Controller>,
    registry: &Registry,
    monitor: &Monitor,
) -> Result<Beginning> {
    let linear = linear_axes(chain).count();
    if linear < 3 && method.needs_three_linear_axes() {
        let message = format!("a machine with {linear} linear axes cannot bring its tool to all places of an artefact");
        return Err(Error::usage(message).help("`--method poses` takes poses of a target: see docs/robots.md"));
    }
    let folder = TemporaryFolder::new().map_err(no_temporary_file)?;
    let at = folder.path().to_owned();
    let trial = Trial { folder, registry, monitor, files: BTreeMap::new() };
    begun(trial, chain, method, controller).map_err(|error| of_user(error, &at, chain))
}

/// An error without the temporary file in which it was found: users have none yet. What they have is the machine.
fn of_user(error: Error, at: &Path, chain: &StructuralLoop) -> Error {
    let is_temporary = error.place.as_ref().is_some_and(|place| place.file.starts_with(at));
    if !is_temporary {
        return error;
    }
    let message = format!("a machine with the axes {chain}: {}", error.message);
    Error { place: None, stage: None, message, ..error }
}

fn begun(
    mut trial: Trial<'_>,
    chain: &StructuralLoop,
    method: Method,
    controller: Option<Controller>,
) -> Result<Beginning> {
    if let Some(nominal) = method.nominal_file() {
        trial.write(nominal, method.nominal())?;
    }
    let (errors, set_up, model) = trial.errors(chain, method)?;
    trial.write(MACHINE, machine(chain, &errors))?;

    let mut parameters = errors.locations.clone();
    parameters.extend(set_up);
    parameters.extend(errors.scales.iter().map(|scale| format!("{scale}[1]")));
    let mut recipe = Recipe {
        chain,
        method,
        parameters: &[],
        program: None,
        left_out: &[],
        choice: Choice::Rows(1),
        folds: None,
        export: None,
        remarks: &[],
        judged: false,
    };
    let all = parameters.clone();
    let candidates = match method.generates() {
        true => trial.prepared(&Recipe { parameters: &all, ..recipe.clone() })?.candidates()?,
        false => poses::seen(model.as_ref())?,
    };
    let (rows, groups) = counts(&candidates);
    recipe.choice = method.choice(rows, groups);
    trial.write(method.data_file(), candidates)?;
    trial.leave_out_lost(&recipe, &mut parameters)?;
    let is_of_machine = |name: &&String| errors.locations.contains(*name) || name.ends_with("[1]");
    let told = parameters.iter().filter(is_of_machine).count();
    if told == 0 {
        return Err(nothing(method, chain));
    }

    let left_out: Vec<String> = all.iter().filter(|name| !parameters.contains(name)).cloned().collect();
    recipe.left_out = &left_out;
    recipe.judged = true;
    if method.chooses(recipe.choice, rows, groups) {
        let chosen = trial.prepared(&Recipe { parameters: &parameters, judged: false, ..recipe.clone() })?.plan()?;
        let text =
            chosen.files.get(Path::new("candidates.csv")).map(|bytes| String::from_utf8_lossy(bytes).into_owned());
        trial.write(method.data_file(), text.unwrap_or_default())?;
    }
    let by_rows = matches!(method, Method::Poses | Method::Lengths);
    recipe.folds = (by_rows || groups > FOLDS).then_some(FOLDS);
    let recipe = Recipe { parameters: &parameters, ..recipe };
    let (recipe, planned, remarks) = trial.with_export(recipe, controller)?;
    if !planned.accepted || !planned.identifiability.null_space.is_empty() {
        return Err(nothing(method, chain));
    }
    trial.write(RECIPE, Recipe { remarks: &remarks, program: controller, ..recipe }.text())?;
    let (rows, indexations) = counts(&trial.files[Path::new(method.data_file())]);
    Ok(Beginning {
        rows,
        indexations,
        errors: told,
        nominal: method.nominal_file(),
        expected: expected(&planned.identifiability, &parameters),
        left_out,
        remarks,
        files: trial.files,
    })
}

fn linear_axes(chain: &StructuralLoop) -> impl Iterator<Item = &NamedAxis> {
    chain.axes.iter().filter(|axis| axis.kind() == AxisKind::Linear)
}

/// The positioning error of a linear axis: `EXX`, and `EXU` of one that is called U.
fn positioning(axis: &NamedAxis) -> String {
    let along = axis.direction().iter().position(|part| *part != 0.0).unwrap_or_default();
    format!("E{}{}", ["X", "Y", "Z"][along], axis.name)
}

/// The error of a method that tells nothing.
fn nothing(method: Method, chain: &StructuralLoop) -> Error {
    Error::usage(format!(
        "{} cannot calibrate a machine with the axes {chain}: {}",
        method.measured(),
        method.useless()
    ))
}

/// Rows of a data file, and different labels in its first column, the indexations.
fn counts(touches: &str) -> (usize, usize) {
    let lines = touches.lines().filter(|line| !line.starts_with('#')).skip(1);
    let labels: Vec<&str> = lines.filter_map(|line| line.split(',').next()).collect();
    (labels.len(), labels.iter().collect::<BTreeSet<_>>().len())
}

/// Name, unit and standard uncertainty of unknowns of the machine, as people read them.
fn expected(found: &Identifiability, parameters: &[String]) -> Vec<(String, String, f64)> {
    let budget = found.uncertainty.iter().flat_map(|budget| &budget.parameters);
    let own = budget.filter(|parameter| parameters.contains(&parameter.name));
    own.map(|parameter| {
        let (symbol, factor) = parameter.unit.parse::<Unit>().map_or((parameter.unit.clone(), 1.0), Unit::for_people);
        (parameter.name.clone(), symbol, parameter.standard_uncertainty * factor)
    })
    .collect()
}

impl Trial<'_> {
    /// The errors that the machine may have, and the names of its set-up.
    fn errors(
        &mut self,
        chain: &StructuralLoop,
        method: Method,
    ) -> Result<(Errors, Vec<String>, Arc<dyn KinematicModel>)> {
        let mut errors = Errors::default();
        self.write(MACHINE, machine(chain, &errors))?;
        let text = "abbe: 1\nname: A machine\nstages:\n  machine: { model: serial-chain, file: machine.yaml }\n";
        let path = self.folder.path().join("alone.yaml");
        let described = abbe_engine::prepare_text(&path, text, self.registry)?.described()?;
        let machine = described.first().ok_or_else(|| Error::data(format!("no machine for {}", method.measured())))?;
        if let Some(locations) = &machine.locations {
            let independent: Vec<&str> = locations.independent().map(|error| error.name.as_str()).collect();
            errors.locations = independent.iter().map(|name| (*name).to_owned()).collect();
            let others =
                locations.all.iter().map(|error| error.name.as_str()).filter(|name| !independent.contains(name));
            errors.others = others.map(str::to_owned).collect();
        }
        errors.scales = linear_axes(chain).map(positioning).collect();
        let info = machine.model.info();
        // Where the workpiece stands is among the unknowns of what is measured, and so is the tool where it is an observer that has to
        // be found. A tip does not tell how the tool is turned; a pose does.
        let told: &[&str] = match method {
            Method::Poses if turns_about_two(chain) => &[],
            Method::Poses => &["dxt", "dyt", "dzt", "dat", "dbt", "dct"],
            _ => &["dxt", "dyt", "dzt"],
        };
        let set_up = info.parameters.iter().filter(|parameter| matches!(parameter.role, ParameterRole::SetUp));
        let set_up = set_up.map(|parameter| parameter.name.clone()).filter(|name| told.contains(&name.as_str()));
        Ok((errors, set_up.collect(), machine.model.clone()))
    }

    /// Leaves out one unknown after the other until the rest is determined: first scales, then the set-up, then location errors, the
    /// last one of those that cannot be told apart.
    fn leave_out_lost(&mut self, recipe: &Recipe<'_>, parameters: &mut Vec<String>) -> Result<()> {
        while !parameters.is_empty() {
            let found = self.checked(&Recipe { parameters, ..recipe.clone() })?.identifiability;
            let weakest = found.weakest.first().filter(|_| found.condition > WEAK);
            let Some(lost) = found.null_space.first().or(weakest) else { return Ok(()) };
            let rank = |place: usize, name: &str| match name {
                name if name.ends_with("[1]") => (0, place),
                name if name.starts_with('d') => (1, place),
                _ => (2, usize::MAX - place),
            };
            let among = parameters.iter().enumerate();
            let among = among.filter(|(_, name)| lost.combination.iter().any(|part| part.name == **name));
            let Some((place, _)) = among.min_by_key(|(place, name)| rank(*place, name)) else { return Ok(()) };
            parameters.remove(place);
        }
        Ok(())
    }

    /// The recipe with an exporter for the control, if one takes this machine; else a sentence.
    fn with_export<'a>(
        &mut self,
        recipe: Recipe<'a>,
        controller: Option<Controller>,
    ) -> Result<(Recipe<'a>, Planned, Vec<String>)> {
        let mut remarks = Vec::new();
        for export in controller.into_iter().flat_map(exporters) {
            let with = Recipe { export: Some(export), ..recipe.clone() };
            match self.checked(&with) {
                Ok(planned) => return Ok((with, planned, Vec::new())),
                Err(error) if matches!(error.class, Class::Use | Class::Data) => {
                    remarks.push(format!("`export: {export}` was left out: {}", error.message));
                }
                Err(error) => return Err(error),
            }
        }
        let planned = self.checked(&recipe)?;
        Ok((recipe, planned, remarks))
    }
}

/// Exporters for a control, the one that corrects most first.
fn exporters(controller: Controller) -> &'static [&'static str] {
    match controller {
        Controller::Linuxcnc => &["linuxcnc-kinematics", "linuxcnc-five-axis", "linuxcnc"],
        Controller::Fanuc => &["fanuc-five-axis", "fanuc-pitch"],
        Controller::Siemens => &["siemens-kinematics", "siemens-tables"],
        Controller::Heidenhain => &["heidenhain-kinematics", "heidenhain-tables"],
        Controller::Grbl => &["grbl"],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_name_no_temporary_file() {
        let (chain, at) = ("w b X Y Z t".parse().unwrap(), Path::new("trial"));
        let error = Error::usage("there is no model plugin `serial-chain`").stage("machine");
        let found = of_user(error.clone().at(&at.join("alone.yaml"), 4, None), at, &chain);
        assert_eq!((found.place, found.stage), (None, None));
        assert_eq!(found.message, format!("a machine with the axes w b X Y Z t: {}", error.message));
        // What a user has is named.
        let own = error.at(Path::new("machine.yaml"), 4, None);
        assert_eq!(of_user(own.clone(), at, &chain).place, own.place);
    }
}
