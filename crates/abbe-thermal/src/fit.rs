//! Gains and time constants by variable projection.

use abbe_core::{Error, Result};
use faer::{Mat, MatRef};

use crate::basis::Basis;
use crate::log::SensorLog;
use crate::starts::starts;

/// Readings of an output during one run.
#[derive(Debug, Clone, PartialEq)]
pub struct Readings {
    /// Their times, s, within the log of the run.
    pub times: Vec<f64>,
    /// The readings, counted from the reference of the output in this run.
    pub values: Vec<f64>,
}

/// What follows thermal states.
#[derive(Debug, Clone, PartialEq)]
pub struct Output {
    /// Its name.
    pub name: String,
    /// Its readings of each run, as many as there are logs.
    pub runs: Vec<Readings>,
    /// Standard uncertainty of a reading, if it is known: else it follows from the residuals of this output.
    pub standard_uncertainty: Option<f64>,
}

impl Output {
    /// An output of one run.
    pub fn of_run(name: impl Into<String>, times: Vec<f64>, values: Vec<f64>) -> Self {
        Self { name: name.into(), runs: vec![Readings { times, values }], standard_uncertainty: None }
    }

    /// Number of its readings.
    pub fn count(&self) -> usize {
        self.runs.iter().map(|run| run.values.len()).sum()
    }

    /// All its readings, run by run.
    pub(crate) fn values(&self) -> impl Iterator<Item = f64> + '_ {
        self.runs.iter().flat_map(|run| run.values.iter().copied())
    }

    /// Its times, run by run.
    pub(crate) fn times(&self) -> Vec<&[f64]> {
        self.runs.iter().map(|run| run.times.as_slice()).collect()
    }
}

/// Which terms an output has.
#[derive(Debug, Clone, PartialEq)]
pub struct Structure {
    /// Sensors that drive states, by their index in the log.
    pub inputs: Vec<usize>,
    /// Sensors that outputs follow at once.
    pub at_once: Vec<usize>,
    /// Number of time constants, shared by all inputs and outputs.
    pub time_constants: usize,
    /// States at the beginning of a run are unknown: one for each run, time constant and output.
    pub starts_warm: bool,
    /// First guesses of the time constants, s. Without them several are tried.
    pub guess: Option<Vec<f64>>,
}

impl Structure {
    /// Gains of an output of some runs: states by input and time constant, then what it follows at once, then states at the beginning
    /// of each run.
    pub fn gains(&self, runs: usize) -> usize {
        let beginnings = if self.starts_warm { runs * self.time_constants } else { 0 };
        self.of_any_run() + beginnings
    }

    /// Gains that any run has: all but the states at the beginning.
    pub fn of_any_run(&self) -> usize {
        self.inputs.len() * self.time_constants + self.at_once.len()
    }

    /// The place of a gain among those of an output: `input` counts among [`inputs`](Self::inputs), `time_constant` from 0.
    pub fn gain(&self, input: usize, time_constant: usize) -> usize {
        input * self.time_constants + time_constant
    }
}

/// What a log and its outputs tell.
#[derive(Debug, Clone, PartialEq)]
pub struct Fitted {
    /// The structure that was fitted.
    pub structure: Structure,
    /// Time constants, s, shortest first.
    pub time_constants: Vec<f64>,
    /// Standard uncertainties of the logarithms of the time constants: relative ones of the time constants. From residuals alone; where
    /// inputs are noisy, or the model lacks something, this is optimistic.
    pub relative_uncertainties: Vec<f64>,
    /// For each output its gains, as [`Structure::gain`] orders them.
    pub gains: Vec<Vec<f64>>,
    /// Standard uncertainties of the gains, in the same order. Optimistic in the same way.
    pub gain_uncertainties: Vec<Vec<f64>>,
    /// Covariance of everything: logarithms of time constants, then the gains of each output. Optimistic in the same way.
    pub covariance: Mat<f64>,
    /// Condition number of the derivatives of all readings, columns of norm 1.
    pub condition: f64,
    /// For each output the root mean square of its residuals, by degrees of freedom.
    pub scatter: Vec<f64>,
    /// For each output its residuals, run by run.
    pub residuals: Vec<Vec<f64>>,
    /// Passes of the iteration.
    pub passes: usize,
}

/// Most passes of the search for time constants.
const PASSES: usize = 200;

/// Relative change of time constants below which they stand.
const SETTLED: f64 = 1e-13;

/// Rounds of weights: the scatter of outputs follows from what is found with the weights before.
const ROUNDS: usize = 3;

/// Weights that change by less than this part are the same.
const SAME_WEIGHT: f64 = 0.01;

/// Scatter below this part of the size of an output is rounding.
const EXACT: f64 = 1e-8;

/// A time constant longer than the longest log by this factor is none: the state is the integral of its input.
const BEYOND: f64 = 10.0;

/// Time constants nearer to each other than this ratio are one.
const SAME: f64 = 1.05;

/// Fits outputs to the states of the logs of one or more runs. All runs share gains and time constants.
///
/// Fails for readings outside their log, for fewer readings than gains, for inputs that do not tell their terms apart, and where two
/// time constants become one.
pub fn fit(logs: &[SensorLog], outputs: &[Output], structure: &Structure) -> Result<Fitted> {
    check(logs, outputs, structure)?;
    let guesses = match &structure.guess {
        Some(guess) => vec![guess.clone()],
        None => starts(logs, structure.time_constants),
    };
    let mut best: Option<(f64, Search<'_>)> = None;
    let mut told = None;
    for guess in guesses {
        let logarithms = guess.iter().map(|time| time.ln()).collect();
        let mut search = Search::new(logs, outputs, structure, sizes(outputs), logarithms);
        match search.search_from_guess() {
            Ok(likelihood) if best.as_ref().is_none_or(|(best, _)| likelihood < *best) => {
                best = Some((likelihood, search));
            }
            Ok(_) => {}
            Err(error) => told = Some(error),
        }
    }
    let none = || told.unwrap_or_else(|| Error::data("no time constants are found"));
    best.ok_or_else(none)?.1.fitted()
}

/// What outputs are divided by as long as their scatter is not known.
fn sizes(outputs: &[Output]) -> Vec<f64> {
    outputs.iter().map(|output| output.standard_uncertainty.unwrap_or_else(|| size(output))).collect()
}

/// Root mean square, or 1 for an output that does not move.
fn size(output: &Output) -> f64 {
    let size = (output.values().map(|value| value * value).sum::<f64>() / output.count().max(1) as f64).sqrt();
    if size > 0.0 { size } else { 1.0 }
}

fn check(logs: &[SensorLog], outputs: &[Output], structure: &Structure) -> Result<()> {
    let Some(log) = logs.first().filter(|_| !outputs.is_empty()) else {
        return Err(Error::usage("at least one output and one log were expected"));
    };
    if logs.iter().any(|other| other.names() != log.names()) {
        return Err(Error::data("the logs of the runs have different sensors"));
    }
    if structure.inputs.is_empty() != (structure.time_constants == 0) {
        return Err(Error::usage("inputs and time constants belong together: both, or none of them, were expected"));
    }
    if let Some(sensor) = structure.inputs.iter().chain(&structure.at_once).find(|sensor| **sensor >= log.names().len())
    {
        return Err(Error::usage(format!("the log has no sensor number {sensor}")));
    }
    if let Some(guess) = &structure.guess {
        let is_time = |time: &f64| time.is_finite() && *time > 0.0;
        if guess.len() != structure.time_constants || !guess.iter().all(is_time) {
            let message = format!("{} times above 0 s were expected as first guess", structure.time_constants);
            return Err(Error::usage(message));
        }
    }
    for output in outputs {
        if output.runs.len() != logs.len() {
            return Err(Error::usage(format!("{} has readings of as many runs as there are logs", output.name)));
        }
        for run in &output.runs {
            if run.times.len() != run.values.len() {
                return Err(Error::usage(format!("{} has as many times as readings", output.name)));
            }
            if let Some(row) = run.values.iter().position(|value| !value.is_finite()) {
                return Err(Error::data(format!("{} has no reading in row {}", output.name, row + 1)));
            }
        }
        if output.standard_uncertainty.is_some_and(|value| !(value.is_finite() && value > 0.0)) {
            return Err(Error::usage(format!("the standard uncertainty of {} has to be above 0", output.name)));
        }
        if output.count() <= structure.gains(logs.len()) + structure.time_constants {
            let message = format!(
                "{} has {} readings, and {} gains and {} time constants are to be found",
                output.name,
                output.count(),
                structure.gains(logs.len()),
                structure.time_constants
            );
            return Err(Error::data(message));
        }
    }
    Ok(())
}

/// The search for the logarithms of the time constants.
pub(crate) struct Search<'a> {
    pub(crate) logs: &'a [SensorLog],
    pub(crate) structure: &'a Structure,
    pub(crate) outputs: &'a [Output],
    /// Outputs with the same times share their states: the first of each group, and the group of each output.
    pub(crate) groups: Vec<Vec<usize>>,
    /// What an output is divided by.
    pub(crate) scales: Vec<f64>,
    pub(crate) logarithms: Vec<f64>,
    cost: f64,
    pub(crate) passes: usize,
}

/// Normal equations of the logarithms, gains projected out.
pub(crate) struct Normal {
    pub(crate) matrix: Mat<f64>,
    gradient: Mat<f64>,
    cost: f64,
}

impl<'a> Search<'a> {
    pub(crate) fn new(
        logs: &'a [SensorLog],
        outputs: &'a [Output],
        structure: &'a Structure,
        scales: Vec<f64>,
        logarithms: Vec<f64>,
    ) -> Self {
        let mut groups: Vec<Vec<usize>> = Vec::new();
        for (index, output) in outputs.iter().enumerate() {
            match groups.iter_mut().find(|group| outputs[group[0]].times() == output.times()) {
                Some(group) => group.push(index),
                None => groups.push(vec![index]),
            }
        }
        Self { logs, structure, outputs, groups, scales, logarithms, cost: f64::INFINITY, passes: 0 }
    }

    /// The readings of a group of outputs, divided by their scales, and the states at their times.
    pub(crate) fn group(&self, group: &[usize], logarithms: &[f64]) -> Result<(Mat<f64>, Basis)> {
        let first = &self.outputs[group[0]];
        let mut values = Mat::zeros(first.count(), group.len());
        for (place, &output) in group.iter().enumerate() {
            for (row, value) in self.outputs[output].values().enumerate() {
                values[(row, place)] = value / self.scales[output];
            }
        }
        Ok((values, Basis::new(self.logs, self.structure, logarithms, &first.times())?))
    }

    /// The term of an output that each logarithm changes.
    pub(crate) fn changed(&self, basis: &Basis, gains: &Mat<f64>, time_constant: usize) -> Mat<f64> {
        let structure = self.structure;
        let own = structure.of_any_run();
        let runs = if structure.starts_warm { self.logs.len() } else { 0 };
        let beginnings = (0..runs).map(|run| own + run * structure.time_constants + time_constant);
        let mut changed = Mat::zeros(basis.columns.nrows(), gains.ncols());
        let states = (0..structure.inputs.len()).map(|input| structure.gain(input, time_constant));
        for column in states.chain(beginnings) {
            changed += basis.slopes.as_ref().subcols(column, 1) * gains.as_ref().subrows(column, 1);
        }
        changed
    }

    pub(crate) fn normal(&self, logarithms: &[f64]) -> Result<Normal> {
        let count = logarithms.len();
        let (mut matrix, mut gradient, mut cost) = (Mat::zeros(count, count), Mat::zeros(count, 1), 0.0);
        for group in &self.groups {
            let (values, basis) = self.group(group, logarithms)?;
            let gains = basis.gains(values.as_ref());
            let residuals = &values - &basis.columns * &gains;
            cost += residuals.squared_norm_l2();
            let columns: Vec<Mat<f64>> =
                (0..count).map(|index| basis.rest(self.changed(&basis, &gains, index))).collect();
            for (row, one) in columns.iter().enumerate() {
                gradient[(row, 0)] += product(one, &residuals);
                for (column, other) in columns.iter().enumerate() {
                    matrix[(row, column)] += product(one, other);
                }
            }
        }
        Ok(Normal { matrix, gradient, cost })
    }

    /// Searches from a guess; outputs weigh by what they scatter. Gives the logarithm of the likelihood of the time constants found,
    /// with its sign turned, that of unknown scatter.
    ///
    /// Fails where time constants do not stand, or are none that the logs can tell.
    fn search_from_guess(&mut self) -> Result<f64> {
        for round in 0..ROUNDS {
            let scatter = self.scatter()?;
            // Where nothing scatters but rounding, all outputs weigh by their size.
            let is_exact = scatter.iter().zip(sizes(self.outputs)).any(|(scatter, size)| *scatter < EXACT * size);
            let stated = self.outputs.iter().map(|output| output.standard_uncertainty).zip(&scatter);
            let scales = match is_exact {
                true => sizes(self.outputs),
                false => stated.map(|(stated, scatter)| stated.unwrap_or(*scatter)).collect(),
            };
            let is_same = self.scales.iter().zip(&scales).all(|(own, new)| (own / new).ln().abs() < SAME_WEIGHT);
            self.scales = scales;
            if round > 0 && is_same {
                break;
            }
            self.run()?;
        }
        self.check()?;
        let scatter = self.scatter()?.into_iter().zip(self.outputs);
        Ok(scatter.map(|(scatter, output)| output.count() as f64 * scatter.max(1e-12 * size(output)).ln()).sum())
    }

    /// Levenberg's and Marquardt's steps until time constants stand.
    fn run(&mut self) -> Result<()> {
        let count = self.logarithms.len();
        let mut now = self.normal(&self.logarithms)?;
        self.cost = now.cost;
        if count == 0 {
            return Ok(());
        }
        let mut damping = 1e-3;
        for pass in 1..=PASSES {
            self.passes = pass;
            let mut damped = now.matrix.clone();
            (0..count).for_each(|index| damped[(index, index)] *= 1.0 + damping);
            let step = solved(&damped, &now.gradient);
            let largest = step.iter().fold(0.0_f64, |largest, part| largest.max(part.abs()));
            if !largest.is_finite() {
                return Err(Error::data("the readings do not determine the time constants"));
            }
            // A time constant changes by a factor of e at most.
            let part = (1.0 / largest).min(1.0);
            let next: Vec<f64> = self.logarithms.iter().zip(&step).map(|(own, by)| own + part * by).collect();
            let found = self.normal(&next)?;
            if largest < SETTLED {
                self.cost = now.cost;
                return Ok(());
            }
            if found.cost < now.cost {
                (self.logarithms, now, damping) = (next, found, (damping * 0.1).max(1e-15));
            } else if largest < 1e-9 || damping > 1e12 {
                // Rounding alone moves the cost.
                self.cost = now.cost;
                return Ok(());
            } else {
                damping *= 10.0;
            }
        }
        Err(Error::data("the search for time constants does not end: the readings do not determine them")
            .help("fewer time constants may explain these readings"))
    }

    /// Fails where terms cannot be told apart, and for time constants that no log of this length and sampling tells.
    fn check(&self) -> Result<()> {
        let lengths = self.logs.iter().map(|log| log.times()[log.times().len() - 1] - log.times()[0]);
        let longest = lengths.fold(0.0, f64::max);
        if let Some(beyond) = self.logarithms.iter().map(|time| time.exp()).find(|time| *time > BEYOND * longest) {
            let message = format!("a time constant grows beyond {beyond:.0} s, and the longest log has {longest:.0} s");
            return Err(Error::data(message).help("fewer time constants explain these readings"));
        }
        let mut sorted = self.logarithms.clone();
        sorted.sort_by(f64::total_cmp);
        if let Some(pair) = sorted.windows(2).find(|pair| pair[1] - pair[0] < SAME.ln()) {
            let message = format!("two time constants become one, {:.0} s", pair[0].exp());
            return Err(Error::data(message).help("fewer time constants explain these readings"));
        }
        for group in &self.groups {
            let (_, basis) = self.group(group, &self.logarithms)?;
            if let Some(column) = basis.dependent() {
                let name = self.term(column);
                let output = &self.outputs[group[0]].name;
                let message = format!("{output}: {name} cannot be told from the terms before it");
                return Err(Error::data(message).help("leave out an input, or record one that moves by itself"));
            }
        }
        Ok(())
    }

    /// What a gain belongs to.
    fn term(&self, column: usize) -> String {
        let structure = self.structure;
        let states = structure.inputs.len() * structure.time_constants;
        let names = self.logs[0].names();
        if column < states {
            let input = &names[structure.inputs[column / structure.time_constants]];
            return format!("{input} with time constant {}", column % structure.time_constants + 1);
        }
        match structure.at_once.get(column - states) {
            Some(sensor) => format!("{} at once", names[*sensor]),
            None => "the state at the beginning".to_owned(),
        }
    }

    /// Root mean squares of residuals by degrees of freedom, in the units of the outputs.
    pub(crate) fn scatter(&self) -> Result<Vec<f64>> {
        let mut scatter = vec![0.0; self.outputs.len()];
        let shared = self.logarithms.len() as f64 / self.outputs.len() as f64;
        for group in &self.groups {
            let (values, basis) = self.group(group, &self.logarithms)?;
            let residuals = &values - &basis.columns * basis.gains(values.as_ref());
            let freedom = values.nrows() as f64 - self.structure.gains(self.logs.len()) as f64 - shared;
            for (place, &output) in group.iter().enumerate() {
                let squares = residuals.col(place).squared_norm_l2();
                scatter[output] = self.scales[output] * (squares / freedom.max(1.0)).sqrt();
            }
        }
        Ok(scatter)
    }

    fn fitted(&self) -> Result<Fitted> {
        let mut order: Vec<usize> = (0..self.logarithms.len()).collect();
        order.sort_by(|one, other| self.logarithms[*one].total_cmp(&self.logarithms[*other]));
        let logarithms: Vec<f64> = order.iter().map(|&index| self.logarithms[index]).collect();
        let sorted = Self { logarithms, groups: self.groups.clone(), scales: self.scales.clone(), ..*self };
        sorted.all()
    }
}

pub(crate) fn product(one: &Mat<f64>, other: &Mat<f64>) -> f64 {
    let columns = one.col_iter().zip(other.col_iter());
    columns.map(|(one, other)| one.iter().zip(other.iter()).map(|(a, b)| a * b).sum::<f64>()).sum()
}

/// The solution of a small symmetric system, columns scaled; infinite where it has none.
fn solved(matrix: &Mat<f64>, right: &Mat<f64>) -> Vec<f64> {
    let scaled = inverse(matrix) * right;
    (0..right.nrows()).map(|row| scaled[(row, 0)]).collect()
}

/// The inverse of a small symmetric matrix, by QR of the scaled one.
pub(crate) fn inverse(matrix: &Mat<f64>) -> Mat<f64> {
    use faer::linalg::solvers::Solve;
    let count = matrix.nrows();
    let size = |index: usize| matrix[(index, index)].sqrt();
    let scaled = Mat::from_fn(count, count, |row, column| matrix[(row, column)] / (size(row) * size(column)));
    let found = scaled.as_ref().col_piv_qr().solve(Mat::<f64>::identity(count, count));
    Mat::from_fn(count, count, |row, column| found[(row, column)] / (size(row) * size(column)))
}

pub(crate) fn inverse_of_upper(upper: MatRef<'_, f64>) -> Mat<f64> {
    let mut inverse = Mat::identity(upper.ncols(), upper.ncols());
    faer::linalg::triangular_solve::solve_upper_triangular_in_place(upper, inverse.as_mut(), faer::Par::Seq);
    inverse
}
