//! Rows held out in folds, and the fits on what is left.

use std::collections::{BTreeMap, BTreeSet};

use abbe_core::{
    Calibration, Error, Figure, Findings, Fit, Label, LabelText, Layout, Limit, Owner, PathItem, Problem, Result,
    RowIndex, SetIndex, SettingsError, Termination, Unknown,
};
use abbe_estimation::Judgement;
use abbe_numerics::Factor;
use schemars::JsonSchema;
use serde::Deserialize;

use crate::figures::ONE;

/// Which rows are held out together.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(untagged, expecting = "a whole number of folds (2 or more) or a list of lists of labels was expected")]
pub enum Folds {
    /// Number of folds. The labels are distributed to the folds in turn, in the order in which they appear.
    Number(usize),
    /// The labels of every fold.
    Labels(Vec<Vec<Label>>),
}

impl Folds {
    /// Refuses settings that are wrong whatever the data.
    pub fn check(&self) -> Result<(), SettingsError> {
        match self {
            Self::Number(number) if *number < 2 => {
                Err(SettingsError::new("folds", format!("{number} folds hold out nothing or everything"))
                    .help("write 2 or more, or the labels to hold out: `[[5, 8]]`"))
            }
            Self::Number(_) => Ok(()),
            Self::Labels(folds) if folds.is_empty() => {
                Err(SettingsError::new("folds", "at least one fold was expected"))
            }
            Self::Labels(folds) => {
                let mut seen = BTreeSet::new();
                for (index, labels) in folds.iter().enumerate() {
                    let at = [PathItem::Key("folds".to_owned()), PathItem::Index(index)];
                    if labels.is_empty() {
                        return Err(SettingsError::new("", "a fold without labels holds out nothing").under(at));
                    }
                    if let Some(twice) = labels.iter().find(|label| !seen.insert(*label)) {
                        let message = format!("the label {} is listed twice", twice.0);
                        return Err(SettingsError::new("", message).under(at));
                    }
                }
                Ok(())
            }
        }
    }

    /// The folds of the rows of a set by the labels of `column`.
    pub fn split(&self, problem: &Problem, set: SetIndex, column: &str) -> Result<Vec<Fold>> {
        let labels = LabelsOfRows::new(problem, set, column)?;
        let fold =
            |of_fold: Vec<String>| Fold { rows: labels.rows(&problem.sets[set].rows, &of_fold).0, labels: of_fold };
        let mut known = LabelCounts::default();
        problem.sets[set].rows.iter().filter_map(|row| labels.of(*row)).for_each(|label| known.add(label, 1));
        Ok(self.labels(&known, &problem.sets[set].name, column)?.into_iter().map(fold).collect())
    }

    /// The labels of every fold, by all labels of a column in the rows of a stage.
    pub fn labels(&self, known: &LabelCounts, stage: &str, column: &str) -> Result<Vec<Vec<String>>> {
        let order = &known.order;
        let of_folds: Vec<Vec<String>> = match self {
            Self::Number(number) if *number > order.len() => {
                return Err(Error::data(format!(
                    "{number} folds were asked for, but `{column}` has {} different labels in `{stage}`",
                    order.len()
                ))
                .setting("folds"));
            }
            Self::Number(number) => {
                (0..*number).map(|fold| order.iter().skip(fold).step_by(*number).cloned().collect()).collect()
            }
            Self::Labels(folds) => {
                folds.iter().map(|labels| labels.iter().map(|label| label.0.clone()).collect()).collect()
            }
        };
        for labels in &of_folds {
            let mut held = 0;
            for label in labels {
                held += known.rows.get(label).ok_or_else(|| {
                    Error::data(format!("no row of `{stage}` has the {column} {label}"))
                        .suggest(label, order.iter().map(String::as_str))
                        .setting("folds")
                })?;
            }
            if held == known.rows.values().sum::<usize>() {
                return Err(Error::data(format!(
                    "the fold with {column} {} holds out every row of `{stage}`: nothing is left to estimate from",
                    labels.join(", ")
                ))
                .setting("folds"));
            }
        }
        Ok(of_folds)
    }
}

/// The labels of a column of the rows of a set.
pub struct LabelsOfRows<'a> {
    layout: &'a Layout,
    labels: &'a [LabelText],
}

impl<'a> LabelsOfRows<'a> {
    /// Fails without such a column of labels.
    pub fn new(problem: &'a Problem, set: SetIndex, column: &str) -> Result<Self> {
        let layout = &problem.sets[set].info().layout;
        let labels = abbe_table::labels(&layout.data, column).map_err(|error| error.setting("column"))?;
        Ok(Self { layout, labels })
    }

    /// The rows that have one of these labels, and the others.
    pub fn rows(&self, rows: &[RowIndex], labels: &[String]) -> (Vec<RowIndex>, Vec<RowIndex>) {
        let labels: BTreeSet<&str> = labels.iter().map(String::as_str).collect();
        rows.iter().partition(|row| self.of(**row).is_some_and(|own| labels.contains(own)))
    }

    /// The label of a row; none for a row that no data have.
    pub fn of(&self, row: RowIndex) -> Option<&'a str> {
        self.layout.rows[row].data_row.map(|data_row| self.labels[data_row].as_str())
    }
}

/// Labels in the order in which they appear, with their numbers of rows.
#[derive(Debug, Default)]
pub struct LabelCounts {
    order: Vec<String>,
    rows: BTreeMap<String, usize>,
}

impl LabelCounts {
    /// Adds rows with a label.
    pub fn add(&mut self, label: &str, rows: usize) {
        match self.rows.get_mut(label) {
            Some(known) => *known += rows,
            None => {
                self.order.push(label.to_owned());
                self.rows.insert(label.to_owned(), rows);
            }
        }
    }

    /// Adds later rows.
    pub fn join(&mut self, later: &Self) {
        later.order.iter().for_each(|label| self.add(label, later.rows[label]));
    }
}

/// The column of labels unless the settings name one.
pub fn default_column() -> String {
    "group".to_owned()
}

/// Rows of one set that are held out together.
#[derive(Debug, Clone, PartialEq)]
pub struct Fold {
    /// Their labels.
    pub labels: Vec<String>,
    /// Their indices.
    pub rows: Vec<RowIndex>,
}

/// A fit without the rows of a fold.
pub struct TrainedFit {
    /// Its result.
    pub calibration: Calibration,
    /// Unknowns of the full fit that no remaining row depends on.
    pub undetermined: Vec<Unknown>,
    /// A remark that the iteration did not converge.
    pub remark: Option<String>,
}

impl Fold {
    /// Estimates again, by the estimator of the fit, without the rows of this fold.
    pub fn train(&self, fit: &Fit, set: SetIndex) -> Result<TrainedFit> {
        let rows = fit.problem.sets[set].rows.iter().copied();
        let kept = rows.filter(|row| self.rows.binary_search(row).is_err()).collect();
        let training = fit.problem.watched_by(fit.problem.monitor.without_events()).with_rows(set, kept);
        let judged = Judgement::new(&training.with_values(&training.values_of(&fit.calibration)), None)?;
        let undetermined = without_effect(&training, judged.factor());
        let calibration = fit.estimator.estimate(&training.without_unknowns(|unknown| undetermined.contains(unknown)));
        TrainedFit::new(fit, &self.labels, calibration, undetermined)
    }
}

/// The unknowns of a problem on which no row depends, by the factor of the rows.
pub fn without_effect(problem: &Problem, factor: &Factor) -> Vec<Unknown> {
    let idle = problem.unknowns.iter().zip(factor.norms()).filter(|(_, norm)| **norm == 0.0);
    idle.map(|(unknown, _)| unknown.clone()).collect()
}

impl TrainedFit {
    /// The result of an estimate without rows of some labels.
    pub fn new(
        fit: &Fit,
        labels: &[String],
        calibration: Result<Calibration>,
        undetermined: Vec<Unknown>,
    ) -> Result<Self> {
        let name = format!("{} without {}", fit.name, labels.join(", "));
        let calibration = calibration.map_err(|mut error| {
            error.message = format!("{name}: {}", error.message);
            error
        })?;
        let remark = not_converged(&name, &calibration);
        Ok(Self { calibration, undetermined, remark })
    }
}

/// The results of `train` for every fold; a fold that fails is reported, and costs no other one.
///
/// Fails if all folds do, if the estimator cannot be used any more, and where the work was asked to end.
pub fn trained<F, T>(
    fit: &Fit,
    folds: Vec<F>,
    findings: &mut Findings,
    mut train: impl FnMut(&F) -> Result<T>,
) -> Result<Vec<(F, T)>> {
    let (all, mut done, mut failures) = (folds.len(), Vec::new(), Vec::new());
    for (index, fold) in folds.into_iter().enumerate() {
        fit.problem.monitor.parts_done("folds", index, Some(all));
        match train(&fold) {
            Ok(result) => done.push((fold, result)),
            Err(error) if error.fatal => return Err(error),
            Err(error) => failures.push(error),
        }
    }
    if let (true, Some(error)) = (done.is_empty(), failures.first()) {
        return Err(error.clone());
    }
    report(fit, "failed folds", failures, findings);
    Ok(done)
}

/// Reports estimates that failed, of which none may.
pub fn report(fit: &Fit, name: &str, failures: Vec<Error>, findings: &mut Findings) {
    if !failures.is_empty() {
        let figure = Figure::new(&fit.name, name, failures.len() as f64, ONE);
        findings.figures.push(figure.limited(Limit::from(0.0)).detail());
        findings.remarks.extend(failures.into_iter().map(|error| format!("not judged: {}", error.message)));
    }
}

/// What to tell people about an iteration that did not converge: its figures mean little.
pub fn not_converged(name: &str, calibration: &Calibration) -> Option<String> {
    (calibration.fit.termination != Termination::Converged)
        .then(|| format!("{name} did not converge within {} iterations", calibration.fit.iterations))
}

/// The index of the observations of a stage in a fit.
pub fn set_of(fit: &Fit, setting: &str, stage: &str) -> Result<SetIndex> {
    fit.problem.set_named(stage).ok_or_else(|| {
        let names = fit.problem.sets.iter().map(|set| set.name.as_str());
        Error::usage(format!("{} does not observe `{stage}`", fit.name)).suggest(stage, names).setting(setting)
    })
}

/// A problem with the values of a calibration, reduced to some rows of one set and to these unknowns.
pub fn reduced(
    problem: &Problem,
    calibration: &Calibration,
    set: SetIndex,
    rows: Vec<RowIndex>,
    unknowns: Vec<Unknown>,
) -> Problem {
    let mut reduced = problem.starting_from(calibration);
    reduced.sets.iter_mut().for_each(|other| other.rows.clear());
    reduced.sets[set].rows = rows;
    reduced.unknowns = unknowns;
    reduced
}

/// For every row of a [`reduced`] problem, which of its unknowns the row's equations contain.
pub fn contained(problem: &Problem) -> Result<Vec<BTreeSet<usize>>> {
    let mut found: Vec<BTreeSet<usize>> = Vec::new();
    let (rows, mut last) = (problem.equation_rows(), None);
    problem.linearise(&problem.start(), |block| {
        for (equation, _, line) in block.lines() {
            let row = rows[equation];
            if last != Some(row) {
                found.push(BTreeSet::new());
                last = Some(row);
            }
            let columns = line.iter().enumerate().filter(|(_, derivative)| **derivative != 0.0);
            if let Some(row) = found.last_mut() {
                row.extend(columns.map(|(column, _)| column));
            }
        }
    })?;
    Ok(found)
}

/// An own unknown of a set.
pub fn own_unknown(problem: &Problem, set: SetIndex, index: usize) -> Unknown {
    let observations = &problem.sets[set];
    let parameter = &observations.observations.info().unknowns[index];
    let name = format!("{}.{}", observations.name, parameter.name);
    Unknown { name, unit: parameter.unit, owner: Owner::Set(set), index }
}
