//! Rows of an estimate that are read in batches: what validators ask of them, in memory that does not grow with their number.

use std::collections::{BTreeMap, BTreeSet};

use abbe_core::{Error, Figure, Fit, Parts, Problem, Quantity, Result, RowIndex, SetIndex, SizeSums, Unknown};
use abbe_estimation::{ChangedParts, RowsInParts, looked_at};

use crate::figures::{ListedOutliers, UM, URAD};
use crate::folds::{LabelCounts, LabelsOfRows, TrainedFit, contained, reduced, without_effect};

/// Sums of residuals. Lengths and angles are kept apart: they cannot be added.
#[derive(Debug, Clone, Copy, Default)]
pub struct ResidualSizes {
    /// mm
    lengths: SizeSums,
    /// rad
    angles: SizeSums,
}

impl ResidualSizes {
    /// Adds a residual, mm or rad.
    pub fn push(&mut self, quantity: Quantity, residual: f64) {
        let sums = if quantity == Quantity::Angle { &mut self.angles } else { &mut self.lengths };
        *sums = sums.with(&SizeSums::of([residual]));
    }

    /// Adds those of other rows.
    pub fn join(&mut self, other: &Self) {
        *self = Self { lengths: self.lengths.with(&other.lengths), angles: self.angles.with(&other.angles) };
    }

    /// The root mean square of lengths, µm; none if there are none.
    pub fn rms_of_lengths(&self) -> Option<f64> {
        (self.lengths.count > 0).then(|| rms(&self.lengths) * 1e3)
    }

    /// Largest, mean and rms of those that there are, with their units; of lengths if there are none.
    pub fn sizes(&self) -> impl Iterator<Item = ([f64; 3], &'static str)> {
        let (lengths, angles) = (self.lengths.count > 0, self.angles.count > 0);
        let of = |sums: &SizeSums, unit: f64| {
            let largest = if sums.count > 0 { sums.max } else { f64::NAN };
            [largest, sums.absolute / sums.count as f64, rms(sums)].map(|size| size * unit)
        };
        let all =
            [(lengths || !angles).then(|| (of(&self.lengths, 1e3), UM)), angles.then(|| (of(&self.angles, 1e6), URAD))];
        all.into_iter().flatten()
    }

    /// Their size as figures.
    pub fn figures(&self, of: &str) -> Vec<Figure> {
        let of_one = |([max, mean, rms], unit): ([f64; 3], &'static str)| {
            [("max", max), ("mean", mean), ("rms", rms)].map(|(name, value)| Figure::new(of, name, value, unit))
        };
        self.sizes().flat_map(of_one).collect()
    }
}

fn rms(sums: &SizeSums) -> f64 {
    (sums.squares / sums.count as f64).sqrt()
}

/// Sums of residuals by label, in the order in which the labels appear first.
#[derive(Debug, Clone, Default)]
pub struct SizesByLabel {
    index: BTreeMap<String, usize>,
    all: Vec<(String, ResidualSizes)>,
}

impl SizesByLabel {
    /// Those of a label.
    pub fn of(&mut self, label: &str) -> &mut ResidualSizes {
        let index = match self.index.get(label) {
            Some(&index) => index,
            None => {
                self.index.insert(label.to_owned(), self.all.len());
                self.all.push((label.to_owned(), ResidualSizes::default()));
                self.all.len() - 1
            }
        };
        &mut self.all[index].1
    }

    /// Adds those of later rows.
    pub fn join(&mut self, later: &Self) {
        later.all.iter().for_each(|(label, sizes)| self.of(label).join(sizes));
    }

    /// Labels and sums.
    pub fn iter(&self) -> impl Iterator<Item = &(String, ResidualSizes)> {
        self.all.iter()
    }
}

/// The rows of an estimate in parts, some of which are held out by their labels.
pub struct HeldOut<'a> {
    /// The estimate.
    pub fit: &'a Fit,
    /// Its rows.
    pub parts: &'a dyn Parts,
    /// The stage whose rows are held out.
    pub stage: &'a str,
    /// The column of the labels.
    pub column: &'a str,
}

/// How rows of a fold were predicted.
#[derive(Debug, Default)]
pub struct Predicted {
    /// All residuals.
    pub all: ResidualSizes,
    /// Those of each label.
    pub by_label: SizesByLabel,
    /// Rows that were predicted.
    pub rows: usize,
    /// Rows that are outliers.
    pub outliers: usize,
    /// Rows that only tell what nothing else does.
    pub untold: usize,
    /// What only they tell.
    pub missing: Vec<String>,
}

impl Predicted {
    /// Predicts rows of a set that an estimate was made without; outliers, and rows that only tell something, are counted.
    pub fn new(
        (problem, set): (&Problem, SetIndex),
        rows: &[RowIndex],
        column: &str,
        trained: &TrainedFit,
        outliers: &BTreeSet<(SetIndex, RowIndex)>,
    ) -> Result<Self> {
        let good: Vec<RowIndex> = rows.iter().copied().filter(|row| !outliers.contains(&(set, *row))).collect();
        let mut found = Self { outliers: rows.len() - good.len(), ..Self::default() };
        let is_lost = |unknown: &&Unknown| trained.undetermined.iter().any(|lost| lost.name == unknown.name);
        let undetermined: Vec<Unknown> = problem.unknowns.iter().filter(is_lost).cloned().collect();
        let held = reduced(problem, &trained.calibration, set, good, undetermined);
        let lost = contained(&held)?;
        let missing: BTreeSet<usize> = lost.iter().flatten().copied().collect();
        found.missing = missing.into_iter().map(|column| held.unknowns[column].name.clone()).collect();
        let told = held.sets[set].rows.iter().zip(&lost).filter(|(_, lost)| lost.is_empty());
        let told: Vec<RowIndex> = told.map(|(row, _)| *row).collect();
        (found.rows, found.untold) = (told.len(), lost.len() - told.len());
        let held = reduced(problem, &trained.calibration, set, told, Vec::new());
        let labels = LabelsOfRows::new(problem, set, column)?;
        let equations = held.equation_rows().into_iter().zip(held.quantities());
        for (residual, ((_, row), quantity)) in held.residuals(&[])?.into_iter().zip(equations) {
            found.all.push(quantity, residual);
            if let Some(label) = labels.of(row) {
                found.by_label.of(label).push(quantity, residual);
            }
        }
        Ok(found)
    }

    /// Adds those of later rows.
    pub fn join(&mut self, later: Self) {
        self.all.join(&later.all);
        self.by_label.join(&later.by_label);
        self.rows += later.rows;
        self.outliers += later.outliers;
        self.untold += later.untold;
        let new = later.missing.into_iter().filter(|name| !self.missing.contains(name)).collect::<Vec<_>>();
        self.missing.extend(new);
    }
}

/// The rows of a part that have some labels.
struct Labelled<'a> {
    stage: &'a str,
    column: &'a str,
    labels: &'a [String],
}

/// The rows of a set with some labels, and the others.
struct Parted {
    set: SetIndex,
    held: Vec<RowIndex>,
    others: Vec<RowIndex>,
}

impl Labelled<'_> {
    /// The rows of the set that is asked about; none if a part has no rows of that artefact.
    fn rows(&self, part: &Problem) -> Result<Option<Parted>> {
        let Some(set) = part.set_named(self.stage) else { return Ok(None) };
        let (held, others) = LabelsOfRows::new(part, set, self.column)?.rows(&part.sets[set].rows, self.labels);
        Ok(Some(Parted { set, held, others }))
    }

    /// A part without these rows.
    fn rest(&self, part: &Problem) -> Result<Problem> {
        Ok(match self.rows(part)? {
            Some(Parted { set, others, .. }) => part.with_rows(set, others),
            None => part.clone(),
        })
    }
}

impl HeldOut<'_> {
    /// The labels of all rows.
    pub fn labels(&self) -> Result<LabelCounts> {
        let (stage, column) = (self.stage, self.column);
        let look = |part: &Problem| {
            let mut known = LabelCounts::default();
            if let Some(set) = part.set_named(stage) {
                let labels = LabelsOfRows::new(part, set, column)?;
                part.sets[set].rows.iter().filter_map(|row| labels.of(*row)).for_each(|label| known.add(label, 1));
            }
            Ok(known)
        };
        let found = looked_at(self.parts, &look, &|known: &mut LabelCounts, later| known.join(&later))?;
        Ok(found.unwrap_or_default())
    }

    fn labelled<'a>(&'a self, labels: &'a [String]) -> Labelled<'a> {
        Labelled { stage: self.stage, column: self.column, labels }
    }

    /// Estimates again, by the estimator of the fit, without the rows of these labels.
    pub fn train(&self, labels: &[String]) -> Result<TrainedFit> {
        let held = self.labelled(labels);
        let problem = self.fit.problem.watched_by(self.fit.problem.monitor.without_events());
        let problem = problem.starting_from(&self.fit.calibration);
        let without = |_: usize, part: &Problem| held.rest(part);
        let nominal = RowsInParts::new(&problem, &ChangedParts::new(self.parts, &without)).at_nominal_geometry()?;
        let undetermined = without_effect(&problem, &nominal);
        let is_lost = |unknown: &Unknown| undetermined.iter().any(|lost| lost.name == unknown.name);
        let told = |_: usize, part: &Problem| Ok(held.rest(part)?.without_unknowns(is_lost));
        let reduced = problem.without_unknowns(is_lost);
        let calibration = self.fit.estimator.estimate_parts(&reduced, &ChangedParts::new(self.parts, &told));
        TrainedFit::new(self.fit, labels, calibration, undetermined.clone())
    }

    /// How well an estimate without the rows of these labels predicts them.
    pub fn predict(&self, labels: &[String], trained: &TrainedFit, outliers: &ListedOutliers<'_>) -> Result<Predicted> {
        let held = self.labelled(labels);
        let look = |part: &Problem| match held.rows(part)? {
            Some(Parted { set, held: rows, .. }) => {
                Predicted::new((part, set), &rows, held.column, trained, &outliers.among(part))
            }
            None => Ok(Predicted::default()),
        };
        let found = looked_at(self.parts, &look, &|all: &mut Predicted, later| all.join(later))?;
        found.ok_or_else(|| Error::data("there are no rows"))
    }
}
