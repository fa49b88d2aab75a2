//! The baseline and the runs that are compared with it.

use std::path::Path;
use std::sync::Arc;

use abbe_core::{
    AxisKind, DataRow, Dataset, Error, Fit, LabelText, Problem, Quantity, Result, StatusColumn, StatusRole, Values,
};

use crate::candidates::{self, Candidates};
use crate::copies::{Copied, copied};
use crate::diagnosis::Pattern;
use crate::points::{ELSEWHERE_ANGLE, Point, Points, Touch, check_trigger, holds_trigger};

/// The readings of one point in the baseline.
#[derive(Debug, Clone, PartialEq)]
pub struct Probed {
    /// The nominal point.
    pub point: Point,
    /// Smallest reading of all repeats, mm.
    pub min: f64,
    /// Largest reading.
    pub max: f64,
    /// Mean reading.
    pub mean: f64,
    /// Every reading, in the order of the data.
    readings: Vec<f64>,
    /// Status of the machine, the approach axis at the mean reading.
    status: Vec<f64>,
    /// Its first row in the data of the baseline.
    first: DataRow,
}

/// The machine and the artefact as they were after the calibration.
pub struct Baseline {
    /// The estimate.
    problem: Problem,
    /// The points, in the order of the nominal file.
    pub points: Vec<Probed>,
    /// The readings that it was made from.
    data: Arc<Dataset>,
    /// Whether the columns of approach axes hold where touches were measured.
    holds_trigger: bool,
}

/// A run to be judged.
#[derive(Debug, Clone, PartialEq)]
pub struct Run {
    /// Its name: that of its file.
    pub name: String,
    /// One reading for every point of the baseline, mm.
    pub readings: Vec<f64>,
}

/// Largest difference, mm and rad, from the baseline of axes that do not move until contact. It moves the point of contact on
/// the facet and does not change the reading.
const ELSEWHERE: (f64, f64) = (0.05, ELSEWHERE_ANGLE);

/// Largest distance, mm, of a touch of the baseline beside its nominal point: an artefact that stands a little elsewhere than planned.
const BESIDE: f64 = 10.0;

const AS_BEFORE: &str = "runs have to probe the points as the baseline did";

/// A cell of a column, as text.
fn cell(data: &Dataset, name: &str, row: DataRow) -> Option<String> {
    Some(match &data.column(name)?.values {
        Values::Numbers(numbers) => numbers[row].to_string(),
        Values::Labels(labels) => labels[row].to_string(),
    })
}

impl Baseline {
    /// The baseline that an estimate was made from.
    pub fn new(fit: &Fit, nominal: &Path) -> Result<Self> {
        let nominal = Points::read(nominal)?;
        let problem = fit.problem.starting_from(&fit.calibration);
        let has_points = |set: &&abbe_core::ObservationSet| {
            let data = &set.info().layout.data;
            data.labels("point").is_some() && data.numbers("measured").is_some()
        };
        let set = problem.sets.iter().find(has_points).ok_or_else(|| {
            Error::usage(format!("`{}` observes no probed points", fit.name))
                .help("`of` takes the estimate of the baseline: an artefact stage with the columns `point` and `measured_mm`")
                .setting("of")
        })?;
        let layout = &set.info().layout;
        let (labels, measured) = (layout.data.required_labels("point")?, layout.data.required_numbers("measured")?);
        let (mut points, mut touched) = (Vec::new(), Vec::new());
        for (nominal_row, point) in DataRow::enumerate(&nominal.list) {
            let taken = set.rows.iter().map(|&row| layout.rows[row]).filter_map(|row| Some((row, row.data_row?)));
            let rows: Vec<_> = taken.filter(|(_, data_row)| labels[*data_row] == point.label).collect();
            let Some((first, first_row)) = rows.first() else { continue };
            let readings: Vec<f64> = rows.iter().map(|(_, data_row)| measured[*data_row]).collect();
            for (_, row) in &rows {
                nominal.check_touched(nominal_row, problem.model.as_ref(), (&layout.data, *row))?;
            }
            touched.extend(rows.iter().map(|(_, row)| (*row, point.axis.as_str(), measured[*row])));
            let mean = readings.iter().sum::<f64>() / readings.len() as f64;
            let status = set.poses().row(first.first_pose);
            let mut touch = Touch::new(problem.model.as_ref(), point, status)?;
            touch.status[problem.model.info().axes[touch.axis].status] = mean;
            nominal.check_approach(nominal_row, &touch)?;
            let beside = touch.beside_here(&problem.machine_values)?;
            if beside > BESIDE || beside.is_nan() {
                let message = format!("point {} is touched {beside:.1} mm beside its nominal point", point.label);
                let help = "are the columns of the axes in their order and unit, and is this the nominal file of the artefact?";
                return Err(layout.data.error_at(*first_row, message).help(help));
            }
            points.push(Probed {
                point: point.clone(),
                min: readings.iter().copied().fold(f64::INFINITY, f64::min),
                max: readings.iter().copied().fold(f64::NEG_INFINITY, f64::max),
                mean,
                readings,
                status: touch.status,
                first: *first_row,
            });
        }
        if points.is_empty() {
            return Err(Error::data("the baseline has no point of the nominal file"));
        }
        let data = layout.data.clone();
        let holds_trigger = holds_trigger(&data, &touched)?;
        Ok(Self { problem, points, data, holds_trigger })
    }

    /// What a run is a copy of, as a whole or in part: one repeat of the baseline, or an earlier run. `scatter` is the standard deviation of
    /// the difference of one reading between healthy runs, mm.
    pub fn copied(&self, run: &Run, earlier: &[Run], scatter: f64) -> Option<Copied> {
        let repeats = self.points.iter().map(|probed| probed.readings.len()).max().unwrap_or_default();
        let repeat = |repeat: usize| {
            let readings = self.points.iter().map(|probed| probed.readings.get(repeat).copied().unwrap_or(f64::NAN));
            ("the baseline", readings.collect())
        };
        let runs = earlier.iter().map(|other| (other.name.as_str(), other.readings.clone()));
        copied(&run.readings, (0..repeats).map(repeat).chain(runs), scatter)
    }

    fn touch<'a>(&'a self, probed: &'a Probed) -> Result<Touch<'a>> {
        Touch::new(self.problem.model.as_ref(), &probed.point, &probed.status)
    }

    /// Effects of the candidates on the readings, then those of changes of the artefact.
    pub fn patterns(&self, candidates: &Candidates) -> Result<Vec<Pattern>> {
        let mut patterns = candidates.of(self.problem.model.as_ref())?;
        for probed in &self.points {
            candidates::add_effects(&mut patterns, &self.touch(probed)?, &self.problem.machine_values)?;
        }
        Ok(patterns)
    }

    /// The change of every reading, mm, when parameters change by `size`, by the full nonlinear equations of the touches.
    pub fn changes(&self, parameters: &[usize], size: f64) -> Result<Vec<f64>> {
        let mut changed = self.problem.machine_values.clone();
        parameters.iter().for_each(|&parameter| changed[parameter] += size);
        let change = |probed: &Probed| {
            let touch = self.touch(probed)?;
            // Errors that the model lacks make the baseline miss contact; that distance stays the same.
            let goal = touch.distance_here(&self.problem.machine_values)?;
            Ok(touch.reading(&changed, goal)? - probed.mean)
        };
        self.points.iter().map(change).collect()
    }

    /// The runs in some data sets, one a file.
    pub fn runs(&self, data: &[&Dataset]) -> Result<Vec<Run>> {
        let mut runs: Vec<Run> = Vec::new();
        for data in data {
            let labels = abbe_table::labels(data, "point")?;
            let measured = abbe_table::numbers(data, "measured", Quantity::Length)?;
            let files = abbe_table::labels(data, "file")?;
            let mut names: Vec<&LabelText> = Vec::new();
            files.iter().for_each(|file| {
                if !names.contains(&file) {
                    names.push(file)
                }
            });
            for name in names {
                if runs.iter().any(|run| run.name == *name) {
                    return Err(Error::usage(format!("two runs are called `{name}`")).setting("from"));
                }
                let mut readings = vec![None; self.points.len()];
                let (mut last, mut touched) = (DataRow(0), Vec::new());
                for row in data.row_indices().filter(|&row| files[row] == *name) {
                    last = row;
                    let place = self.points.iter().position(|probed| probed.point.label == labels[row]);
                    let place = place
                        .ok_or_else(|| data.error_at(row, format!("point {} is not in the baseline", labels[row])))?;
                    self.is_there(data, row, &self.points[place])?;
                    touched.push((row, self.points[place].point.axis.as_str(), measured[row]));
                    if readings[place].replace(measured[row]).is_some() {
                        return Err(data.error_at(row, format!("point {} is probed a second time", labels[row])));
                    }
                }
                let missing = readings.iter().position(Option::is_none);
                if let Some(missing) = missing {
                    let label = &self.points[missing].point.label;
                    return Err(data
                        .error_at(last, format!("{name} has no point {label}"))
                        .help("a verify run probes every point of the baseline"));
                }
                // A program that says where it sends the axes says so of the baseline, too.
                match self.holds_trigger {
                    true => check_trigger(data, &touched)?,
                    false => drop(holds_trigger(data, &touched)?),
                }
                runs.push(Run { name: name.to_string(), readings: readings.into_iter().flatten().collect() });
            }
        }
        Ok(runs)
    }

    /// Refuses a row whose axes do not stand where they stood at the baseline.
    fn is_there(&self, data: &Dataset, row: DataRow, probed: &Probed) -> Result<()> {
        for axis in self.problem.model.info().axes.iter().filter(|axis| axis.name != probed.point.axis) {
            let Some(commands) = data.numbers(&axis.name) else { continue };
            let (allowed, unit, factor) = match axis.kind {
                AxisKind::Linear => (ELSEWHERE.0, "mm", 1.0),
                AxisKind::Rotary => (ELSEWHERE.1, "deg", 1.0_f64.to_degrees()),
            };
            let (here, there) = (commands[row], probed.status[axis.status]);
            if (here - there).abs() > allowed || here.is_nan() {
                let message = format!(
                    "point {} is probed at {} = {:.4} {unit}; at the baseline it was {:.4} {unit}",
                    probed.point.label,
                    axis.name,
                    here * factor,
                    there * factor
                );
                return Err(data.error_at(row, message).help(AS_BEFORE));
            }
        }
        self.is_approached_alike(data, row, probed)
    }

    /// Refuses a row that was probed with another stylus or from another side, as far as both files say it.
    fn is_approached_alike(&self, data: &Dataset, row: DataRow, probed: &Probed) -> Result<()> {
        let of_stylus_or_side =
            |status: &&StatusColumn| matches!(status.role, StatusRole::Direction(_) | StatusRole::Stylus);
        let statuses = self.problem.model.info().status.iter().filter(of_stylus_or_side);
        for name in statuses.map(|status| status.name.as_str()).chain(["stylus", "approach"]) {
            let (here, there) = (cell(data, name, row), cell(&self.data, name, probed.first));
            if let (Some(here), Some(there)) = (here, there)
                && here != there
            {
                let label = &probed.point.label;
                let message = format!("point {label} is probed with {name} {here}; at the baseline it was {there}");
                return Err(data.error_at(row, message).help(AS_BEFORE));
            }
        }
        Ok(())
    }
}
