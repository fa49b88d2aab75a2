//! Validator `repeatability`: how much of the scatter of repeated measurements is repeatability, how much is the surface
//! and how much is drift (Rahman 2016, equations 4-9 to 4-16 and 7-1 to 7-4).
//!
//! Every point is measured in every cycle. Windows of a few successive measurements of one point contain neither the surface
//! nor much of the drift. The means of points over all cycles show the surface, the means of cycles over all points the
//! drift.

use std::collections::{BTreeMap, BTreeSet};

use abbe_core::{
    AxisKind, Context, DataRow, Dataset, Error, Figure, Findings, Fit, LabelText, Names, PathItem, Problem, Quantity,
    Result, RowIndex, SetIndex, SettingsError, Validate, Whole,
};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::figures::{Limits, ONE, Sample, UM, URAD, apply_limits, check_limits, key, outliers};
use crate::folds::set_of;

abbe_core::register!(
    Validate,
    "repeatability",
    "repeatability, surface and drift in repeated measurements of the same points",
    Settings,
    example,
    build,
    "../reference/validate-repeatability.md",
);

/// Settings of the repeatability.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// The artefact stage whose residuals in the fit under `of` are the measurements.
    #[serde(default)]
    rows: Option<String>,
    /// The column (without unit) of the data set under `from` that holds the measurements, lengths or angles.
    #[serde(default)]
    value: Option<String>,
    /// The column whose labels name the points, or several columns that name them together. Default: `feature`, with
    /// `group` if the data have it and it is not used for another purpose.
    #[serde(default)]
    point: Option<Names>,
    /// The column whose labels are the cycles, or several (`[day, cycle]`), in the order of their numbers, or of their
    /// rows if they are no numbers. Default: the first measurements of all points make the first cycle, and so on.
    #[serde(default)]
    cycle: Option<Names>,
    /// A column for whose labels the analysis is done separately: directions of probing.
    #[serde(default)]
    direction: Option<String>,
    /// Number of successive measurements of a point within which the drift is negligible.
    #[serde(default = "default_window")]
    window: Whole<2, 1_000_000>,
    /// Largest admissible values: `repeatability_um`, `pooled_repeatability_um`, `surface_standard_deviation_um`,
    /// `surface_range_um`, `drift_standard_deviation_um`, `drift_range_um`, `total_standard_deviation_um`,
    /// `total_range_um`, or the same in `_urad`; `outliers`.
    #[serde(default)]
    limits: Limits,
}

fn default_window() -> Whole<2, 1_000_000> {
    Whole::new(5)
}

/// The figures, in the order of [`Variability::values`].
const FIGURES: [&str; 8] = [
    "repeatability",
    "pooled repeatability",
    "surface standard deviation",
    "surface range",
    "drift standard deviation",
    "drift range",
    "total standard deviation",
    "total range",
];

/// The first figure of drift.
const DRIFT: usize = 4;

/// The keys of limits for measurements in a unit.
fn keys(unit: &str) -> Vec<String> {
    FIGURES.iter().map(|name| key(name, unit)).chain(["outliers".to_owned()]).collect()
}

fn example() -> Value {
    json!({ "rows": "table", "point": ["feature", "group"], "cycle": ["day", "cycle"], "window": 5, "limits": { "repeatability_um": 1 } })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    if settings.rows.is_some() == settings.value.is_some() {
        let message = "either `rows`, an artefact stage, or `value`, a column of the data under `from`, was expected";
        return Err(SettingsError::new("", message));
    }
    let keys: Vec<String> = [UM, URAD].into_iter().flat_map(keys).collect();
    check_limits(&settings.limits, &keys.iter().map(String::as_str).collect::<Vec<_>>())?;
    Ok(Box::new(Repeatability { settings }))
}

struct Repeatability {
    settings: Settings,
}

impl Validate for Repeatability {
    fn observations(&self) -> Vec<(&'static str, String)> {
        self.settings.rows.iter().map(|rows| ("rows", rows.clone())).collect()
    }

    fn accepts_data(&self) -> bool {
        true
    }

    fn validate(&self, fits: &[&Fit], data: &[&Dataset]) -> Result<Findings> {
        let mut findings = Findings::default();
        match (&self.settings.rows, &self.settings.value, data) {
            (_, Some(value), [data]) => self.judge_column(data, value, &mut findings)?,
            (_, Some(_), _) => {
                let message = format!("`value` is a column of one ingest stage under `from`, not of {}", data.len());
                return Err(Error::usage(message).setting("value"));
            }
            (Some(rows), _, []) => {
                for fit in fits {
                    self.judge_residuals(fit, rows, &mut findings)?;
                }
            }
            _ => {
                let error = Error::usage("the residuals of `rows` need no data under `from`");
                return Err(error.help("say which column holds the measurements with `value` instead").setting("rows"));
            }
        }
        Ok(findings)
    }
}

/// A measurement of a point.
struct Reading {
    /// Row of the data set.
    row: DataRow,
    /// In the unit of figures.
    value: f64,
}

impl Repeatability {
    /// The deviations of an artefact's rows, along the normal of what they touch, without outliers.
    fn judge_residuals(&self, fit: &Fit, rows: &str, findings: &mut Findings) -> Result<()> {
        let problem = &fit.problem;
        let set = set_of(fit, "rows", rows)?;
        let layout = &problem.sets[set].info().layout;
        if let Some(row) = problem.sets[set].rows.iter().find(|&&row| {
            let row = &layout.rows[row];
            row.data_row.is_some() && row.equations != 1
        }) {
            let message = format!("the rows of `{rows}` have {} equations each", layout.rows[*row].equations);
            let error = Error::usage(message).help("repeatability is that of one number a row");
            return Err(error.setting("rows"));
        }
        let left_out = outliers(problem, &fit.calibration);
        let residuals = problem.residuals(&problem.values_of(&fit.calibration))?;
        let of_set = problem.equation_rows().into_iter().zip(residuals).filter(|((of, _), _)| *of == set);
        let kept = of_set.filter(|(row, _)| !left_out.contains(row));
        let angles =
            problem.sets[set].rows.iter().any(|&row| problem.sets[set].info().quantity(row, 0) == Quantity::Angle);
        let (unit, factor) = if angles { (URAD, 1e6) } else { (UM, 1e3) };
        let readings: Vec<Reading> = kept
            .filter_map(|((_, row), value)| Some(Reading { row: layout.rows[row].data_row?, value: value * factor }))
            .collect();
        let points = self.points(&layout.data)?;
        self.same_positions(problem, set, &points)?;
        let skipped = left_out.iter().filter(|(of, _)| *of == set).count();
        self.judge(Some(&fit.name), &layout.data, &readings, unit, findings)?;
        let limit = self.settings.limits.get("outliers").copied();
        findings.figures.push(Figure::new(&fit.name, "outliers", skipped as f64, ONE).limited(limit));
        Ok(())
    }

    /// The points of all rows.
    fn points(&self, data: &Dataset) -> Result<Labelled> {
        if let Some(names) = &self.settings.point {
            return Labelled::new(data, names.as_slice(), "point");
        }
        let used = |name: &str| {
            let cycles = self.settings.cycle.iter().flat_map(Names::as_slice);
            cycles.chain(&self.settings.direction).any(|other| other == name)
        };
        let mut names = vec!["feature".to_owned()];
        names.extend(Some("group".to_owned()).filter(|group| data.labels(group).is_some() && !used(group)));
        Labelled::new(data, &names, "point")
    }

    /// Refuses a point that is measured at different positions of rotary axes: these would not be repeats.
    fn same_positions(&self, problem: &Problem, set: SetIndex, points: &Labelled) -> Result<()> {
        let layout = &problem.sets[set].info().layout;
        let axes = &problem.model.info().axes;
        let rotary = || axes.iter().filter(|axis| axis.kind == AxisKind::Rotary);
        let mut first: BTreeMap<&str, RowIndex> = BTreeMap::new();
        for &row in &problem.sets[set].rows {
            let Some(data_row) = layout.rows[row].data_row else { continue };
            let label = points.of_rows[data_row].as_str();
            let other = layout.rows[*first.entry(label).or_insert(row)].first_pose;
            for (number, pose) in layout.rows[row].pose_indices().enumerate() {
                let (one, other) = (layout.poses.row(pose), layout.poses.row(other + number));
                let Some(axis) = rotary().find(|axis| (one[axis.status] - other[axis.status]).abs() > SAME_POSITION)
                else {
                    continue;
                };
                let message =
                    format!("{} {label} was measured at another position of {} before", points.name, axis.name);
                let error = layout.data.error_at(data_row, message);
                return Err(error
                    .help("list the columns that tell the points: `point: [feature, group]`")
                    .setting("point"));
            }
        }
        Ok(())
    }

    /// The readings in a column.
    fn judge_column(&self, data: &Dataset, name: &str, findings: &mut Findings) -> Result<()> {
        let numbers = data.required_numbers(name).map_err(|error| error.setting("value"))?;
        let (unit, factor) = match data.column(name).map(|column| column.header.quantity) {
            Some(Quantity::Length) => (UM, 1e3),
            Some(Quantity::Angle) => (URAD, 1e6),
            _ => {
                let message = format!("the column `{name}` holds neither lengths nor angles");
                return Err(Error::usage(message).setting("value"));
            }
        };
        let readings = DataRow::enumerate(numbers).map(|(row, value)| Reading { row, value: value * factor });
        self.judge(None, data, &readings.collect::<Vec<_>>(), unit, findings)
    }

    /// Figures of readings: the largest of all directions, and of each as details.
    fn judge(
        &self,
        of: Option<&str>,
        data: &Dataset,
        readings: &[Reading],
        unit: &str,
        findings: &mut Findings,
    ) -> Result<()> {
        let keys = keys(unit);
        if let Some(other) = self.settings.limits.keys().find(|limit| !keys.contains(limit)) {
            let mut error = Error::usage(format!("the measurements are in {unit}, `{other}` limits nothing"));
            error.setting = vec![PathItem::Key("limits".to_owned()), PathItem::Key(other.clone())];
            return Err(error);
        }
        let start = findings.figures.len();
        let new = |name: String, value: f64, unit: &str| {
            let figure = Figure::new(of.unwrap_or_default(), name, value, unit);
            Figure { of: of.map(str::to_owned), ..figure }
        };
        let (mut found, points) = (Vec::new(), self.points(data)?);
        let point = &points.name;
        for (label, series) in self.series(data, readings, &points)? {
            let variability = series.variability(self.settings.window.get());
            let name = of.map_or(String::new(), |of| format!("{of}: "));
            let place = label.as_ref().map_or(String::new(), |label| format!(" in direction {label}"));
            if variability.repeats == 0 {
                return Err(Error::data(format!("{name}no {point} is measured twice{place}")));
            }
            if !variability.single.is_empty() {
                let single = variability.single.join(", ");
                findings.remarks.push(format!("{name}{point} measured once only{place}, no repeatability: {single}"));
            }
            if variability.values[DRIFT].is_nan() {
                findings.remarks.push(format!("{name}no {point} is measured in all cycles{place}: no drift is told"));
            }
            found.push((label, variability));
        }
        for (index, name) in FIGURES.into_iter().enumerate() {
            let values = found.iter().map(|(_, variability)| variability.values[index]).collect();
            findings.figures.push(new(name.to_owned(), Sample(values).max(), unit));
        }
        let readings = found.iter().map(|(_, variability)| variability.readings).sum::<usize>();
        findings.figures.push(new("measurements".to_owned(), readings as f64, ONE));
        for (label, variability) in &found {
            let Some(label) = label else { continue };
            let details = FIGURES.into_iter().zip(variability.values);
            findings.figures.extend(details.map(|(name, value)| new(format!("{name}[{label}]"), value, unit).detail()));
        }
        apply_limits(&self.settings.limits, &mut findings.figures[start..]);
        Ok(())
    }

    /// The readings of every direction by point and cycle; a single direction without a label if none is asked for.
    fn series<'a>(
        &self,
        data: &'a Dataset,
        readings: &[Reading],
        points: &'a Labelled,
    ) -> Result<Vec<(Option<&'a str>, Series<'a>)>> {
        let labels = |name: &str, setting: &str| abbe_table::labels(data, name).map_err(|error| error.setting(setting));
        let directions = self.settings.direction.as_deref().map(|name| labels(name, "direction")).transpose()?;
        let cycles = self.settings.cycle.as_ref().map(|names| Labelled::new(data, names.as_slice(), "cycle"));
        let cycles = cycles.transpose()?;
        let mut all: Vec<(Option<&str>, Series)> = Vec::new();
        for reading in readings {
            let direction = directions.map(|labels| labels[reading.row].as_str());
            let index = all.iter().position(|(other, _)| *other == direction).unwrap_or_else(|| {
                all.push((direction, Series::default()));
                all.len() - 1
            });
            let point = all[index].1.point(&points.of_rows[reading.row]);
            let cycle = cycles.as_ref().map_or(point.len(), |cycles| cycles.places[reading.row.0]);
            if point.insert(cycle, reading.value).is_some() {
                let (name, point) = (&points.name, &points.of_rows[reading.row]);
                let cycle = cycles.as_ref().map_or("", |cycles| cycles.of_rows[reading.row].as_str());
                return Err(data
                    .error_at(reading.row, format!("{name} {point} is measured twice in cycle {cycle}"))
                    .setting("cycle"));
            }
        }
        Ok(all)
    }
}

/// Largest difference between equal positions of rotary axes, rad: recorded positions differ a little.
const SAME_POSITION: f64 = 1e-3;

/// The labels of rows by one column or several columns together.
struct Labelled {
    /// Names of the columns, `feature.group`.
    name: String,
    /// The labels of every data row, `3.7`.
    of_rows: Vec<String>,
    /// The rank of every data row's label in the order of all, column by column.
    places: Vec<usize>,
}

impl Labelled {
    fn new(data: &Dataset, names: &[String], setting: &str) -> Result<Self> {
        if names.is_empty() {
            return Err(Error::usage("a column was expected").setting(setting));
        }
        let columns = names.iter().map(|name| abbe_table::labels(data, name).map_err(|error| error.setting(setting)));
        let columns: Vec<&[LabelText]> = columns.collect::<Result<_>>()?;
        let orders: Vec<BTreeMap<&str, usize>> = columns.iter().map(|column| ordered(column)).collect();
        let of_row = |row: DataRow| columns.iter().map(move |column| column[row].as_str());
        let key =
            |row: DataRow| -> Vec<usize> { of_row(row).zip(&orders).map(|(label, order)| order[label]).collect() };
        let keys: Vec<Vec<usize>> = data.row_indices().map(key).collect();
        let different: BTreeSet<&Vec<usize>> = keys.iter().collect();
        let place: BTreeMap<&Vec<usize>, usize> = different.into_iter().zip(0..).collect();
        Ok(Self {
            name: names.join("."),
            of_rows: data.row_indices().map(|row| of_row(row).collect::<Vec<_>>().join(".")).collect(),
            places: keys.iter().map(|key| place[key]).collect(),
        })
    }
}

/// The place of every label: by number if all are numbers, else as they appear.
fn ordered(labels: &[LabelText]) -> BTreeMap<&str, usize> {
    let mut seen = BTreeSet::new();
    let mut different: Vec<&str> = labels.iter().map(LabelText::as_str).filter(|label| seen.insert(*label)).collect();
    let numbers: Option<Vec<f64>> = different.iter().map(|label| label.parse().ok()).collect();
    if let Some(numbers) = numbers {
        let mut numbered: Vec<(f64, &str)> = numbers.into_iter().zip(different).collect();
        numbered.sort_by(|a, b| a.0.total_cmp(&b.0));
        different = numbered.into_iter().map(|(_, label)| label).collect();
    }
    different.into_iter().enumerate().map(|(place, label)| (label, place)).collect()
}

/// The measurements of every point by cycle, points in the order in which they appear.
#[derive(Default)]
struct Series<'a> {
    index: BTreeMap<&'a str, usize>,
    points: Vec<(&'a str, BTreeMap<usize, f64>)>,
}

/// The figures of a series.
struct Variability {
    /// In the order of [`FIGURES`]; NaN where a figure is not determined.
    values: [f64; 8],
    readings: usize,
    /// Measurements that repeat an earlier one of their point.
    repeats: usize,
    /// Points that are measured once only.
    single: Vec<String>,
}

impl<'a> Series<'a> {
    fn point(&mut self, label: &'a str) -> &mut BTreeMap<usize, f64> {
        let index = *self.index.entry(label).or_insert_with(|| {
            self.points.push((label, BTreeMap::new()));
            self.points.len() - 1
        });
        &mut self.points[index].1
    }

    fn variability(&self, window: usize) -> Variability {
        let points: Vec<Sample> =
            self.points.iter().map(|(_, cycles)| Sample(cycles.values().copied().collect())).collect();
        let all = Sample(points.iter().flat_map(|point| point.0.iter().copied()).collect());
        let within: Vec<PooledVariance> =
            points.iter().map(|point| PooledVariance::of_windows(point, window)).collect();
        let repeated = within.iter().filter(|pooled| pooled.degrees_of_freedom > 0);
        let repeatability = Sample(repeated.map(PooledVariance::standard_deviation).collect()).max();
        let pooled = within.iter().fold(PooledVariance::default(), |sum, point| sum.and(point)).standard_deviation();
        let surface = Sample(points.iter().map(Sample::mean).collect());
        let drift = self.cycle_means();
        let single = self.points.iter().filter(|(_, cycles)| cycles.len() == 1);
        Variability {
            values: [
                repeatability,
                pooled,
                surface.standard_deviation(),
                range(&surface),
                drift.standard_deviation(),
                range(&drift),
                all.standard_deviation(),
                range(&all),
            ],
            readings: all.0.len(),
            repeats: all.0.len() - points.len(),
            single: single.map(|(label, _)| (*label).to_owned()).collect(),
        }
    }

    /// Means of the cycles over the points that are measured in all of them (equation 4-16).
    fn cycle_means(&self) -> Sample {
        let points = || self.points.iter().map(|(_, point)| point);
        let cycles: BTreeSet<usize> = points().flat_map(|point| point.keys().copied()).collect();
        let complete: Vec<&BTreeMap<usize, f64>> = points().filter(|point| point.len() == cycles.len()).collect();
        let mean = |cycle| Sample(complete.iter().map(|point| point[cycle]).collect()).mean();
        Sample(cycles.iter().map(mean).collect())
    }
}

/// Largest less smallest of several values.
fn range(sample: &Sample) -> f64 {
    if sample.0.len() < 2 { f64::NAN } else { sample.max() - sample.min() }
}

/// A variance from several samples (equations 4-12 and 7-1).
#[derive(Debug, Clone, Copy, Default)]
struct PooledVariance {
    squares: f64,
    degrees_of_freedom: usize,
}

impl PooledVariance {
    /// Of windows of successive values; the last one may be shorter.
    fn of_windows(sample: &Sample, window: usize) -> Self {
        let windows = sample.0.chunks(window).map(|values| {
            let mean = Sample(values.to_vec()).mean();
            let squares = values.iter().map(|value| (value - mean).powi(2)).sum();
            Self { squares, degrees_of_freedom: values.len() - 1 }
        });
        windows.fold(Self::default(), |sum, window| sum.and(&window))
    }

    fn and(self, other: &Self) -> Self {
        Self {
            squares: self.squares + other.squares,
            degrees_of_freedom: self.degrees_of_freedom + other.degrees_of_freedom,
        }
    }

    fn standard_deviation(&self) -> f64 {
        (self.squares / self.degrees_of_freedom as f64).sqrt()
    }
}

#[cfg(test)]
mod tests;
