//! How well thermal states predict runs that they were not fitted to.

use std::fmt::Write as _;

use abbe_core::{
    Calibration, Dataset, Error, Figure, Findings, Fit, NamedCovariance, Quantity, Result, SettingsError,
    from_settings, not_negative,
};
use abbe_thermal::{SensorLog, Terms};
use schemars::JsonSchema;
use serde::Deserialize;

use crate::settings::{Run, Settings};
use crate::states::{MINUTE, NAME, terms};
use crate::validate::{Limits, check_limits, limited, run_name};

/// Predictions of runs that the estimate has not seen.
#[derive(Debug, Clone, Default, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PredictionSettings {
    /// Rows before this time of a run are not judged: what a warm beginning leaves is not predicted.
    #[serde(default)]
    after_s: f64,
    /// Largest admissible values over all runs: `max_um`, `rms_um` of lengths, `max_K`, `rms_K` of temperatures.
    #[serde(default)]
    limits: Limits,
}

/// A quantity of outputs, the unit of its figures, and the factor to it.
const KINDS: [(Quantity, &str, f64); 3] =
    [(Quantity::Length, "um", 1e3), (Quantity::Temperature, "K", 1.0), (Quantity::Angle, "urad", 1e6)];

/// Predictions that scatter by this factor more than the estimate promises get a word.
const OPTIMISTIC: f64 = 1.5;

/// The figure of an ordinary fit.
const ORDINARY: &str = "standard uncertainty of predictions, ordinary fit";

/// Part of the squares of what is predicted wrong that is left, of each kind of reading, when sensors were exchanged.
const MUCH_BETTER: f64 = 0.25;

/// Sums over readings of one kind.
#[derive(Default, Clone, Copy)]
struct Sums {
    squares: f64,
    variances: f64,
    /// The variances of an ordinary fit, where those of the calibration are other ones.
    ordinary: f64,
    largest: f64,
    count: usize,
}

impl Sums {
    fn add(&mut self, other: &Self) {
        self.squares += other.squares;
        self.variances += other.variances;
        self.ordinary += other.ordinary;
        self.largest = self.largest.max(other.largest);
        self.count += other.count;
    }

    fn root(&self, of: f64) -> f64 {
        (of / self.count.max(1) as f64).sqrt()
    }
}

impl PredictionSettings {
    /// Refuses limits of figures that do not exist.
    pub fn check(&self) -> Result<(), SettingsError> {
        not_negative("after_s", self.after_s)?;
        check_limits(&self.limits, &["max_um", "rms_um", "max_K", "rms_K", "max_urad", "rms_urad"])
    }

    /// Figures of one estimate.
    pub fn judge(&self, fit: &Fit, data: &[&Dataset], findings: &mut Findings) -> Result<()> {
        let calibration = &fit.calibration;
        if calibration.model.plugin != NAME {
            let message = format!("`{}` is no estimate of thermal states: it predicts no readings", fit.name);
            return Err(Error::usage(message).setting("of"));
        }
        let known = Known::new(calibration)?;
        let mut all = [Sums::default(); KINDS.len()];
        let (mut details, mut seen) = (Vec::new(), Vec::new());
        for data in data {
            let run = known.settings.run(data)?;
            let name = run_name(data);
            if is_seen(calibration, data) {
                seen.push(name.clone());
            }
            let mut table = String::from("time_s,output,reading,predicted,standard_uncertainty\n");
            let mut of_run = [Sums::default(); KINDS.len()];
            for output in 0..run.outputs.len() {
                let (kind, unit, sums) = self.output(&known, &run, output, &mut table)?;
                of_run[kind].add(&sums);
                let label = format!("{}, {name}", run.outputs[output].0);
                let detail =
                    |what: &str, value| Figure::new(&fit.name, format!("{what}[{label}]"), value, unit).detail();
                details.extend([detail("rms", sums.root(sums.squares)), detail("max", sums.largest)]);
                details.push(detail("standard uncertainty of predictions", sums.root(sums.variances)));
            }
            findings.tables.insert(format!("prediction-{}-{name}.csv", fit.name), table);
            all.iter_mut().zip(&of_run).for_each(|(all, of_run)| all.add(of_run));
            if let Some(mistake) = self.mistake(&known, &run, &of_run)? {
                findings.remarks.push(format!("{}: {name} is predicted far better with {mistake}", fit.name));
            }
        }
        let first = findings.figures.len();
        for ((_, unit, _), sums) in KINDS.iter().zip(&all).filter(|(_, sums)| sums.count > 0) {
            let figure = |what: &str, value| {
                limited(Figure::new(&fit.name, what, value, unit), &format!("{what}_{unit}"), &self.limits)
            };
            let (rms, stated) = (sums.root(sums.squares), sums.root(sums.variances));
            findings.figures.extend([figure("max", sums.largest), figure("rms", rms)]);
            findings.figures.push(figure("standard uncertainty of predictions", stated));
            let ordinary = known.ordinary.map(|_| sums.root(sums.ordinary));
            findings.figures.extend(ordinary.map(|value| figure(ORDINARY, value)));
            if rms > OPTIMISTIC * stated {
                let symbol = unit.replace('u', "µ");
                let ordinary = ordinary.map_or_else(String::new, |value| {
                    format!(" by residuals that are drawn again in blocks, and {value:.3} {symbol} by an ordinary fit")
                });
                findings.remarks.push(format!(
                    "{}: take {rms:.3} {symbol} as standard uncertainty of a prediction; that of the estimate alone, {stated:.3} \
                     {symbol}{ordinary}, knows neither the noise of readings nor what the model lacks",
                    fit.name
                ));
            }
        }
        if !seen.is_empty() {
            let why = format!("{} is a run that the estimate was made from: this is no prediction", seen.join(", "));
            for figure in findings.figures[first..].iter_mut().filter(|figure| figure.limit.is_some()) {
                figure.inconclusive = Some(why.clone());
            }
            findings.remarks.push(format!("{}: {why}; name runs under `from` that it has not seen", fit.name));
        }
        findings.figures.extend(details);
        Ok(())
    }

    /// A mistake without which a run is predicted much better: two sensors that are exchanged, times in minutes. In words.
    fn mistake(&self, known: &Known, run: &Run, as_it_is: &[Sums]) -> Result<Option<String>> {
        let doubtful = |sums: &Sums| sums.count > 0 && sums.squares > (OPTIMISTIC * OPTIMISTIC) * sums.variances;
        if !as_it_is.iter().any(doubtful) {
            return Ok(None);
        }
        let names = run.log.names();
        let pairs = (0..names.len()).flat_map(|one| (one + 1..names.len()).map(move |other| (one, other)));
        let exchanged = pairs.map(|(one, other)| {
            let words = format!("{} in the place of {}: are these sensors exchanged?", names[one], names[other]);
            (words, run.log.exchanged(one, other), 1.0)
        });
        let words = "times that are 60 times as long: are they in minutes, under `time_s`?".to_owned();
        let in_minutes = (words, run.log.stretched(MINUTE), MINUTE);
        let mut best: Option<(f64, String)> = None;
        for (words, log, factor) in exchanged.chain([in_minutes]) {
            let squares = self.squares(known, run, (&log, factor))?;
            let judged = || as_it_is.iter().zip(&squares).filter(|(sums, _)| sums.count > 0);
            let part = judged().map(|(sums, squares)| squares / sums.squares).fold(0.0, f64::max);
            if part < MUCH_BETTER && best.as_ref().is_none_or(|(least, _)| part < *least) {
                best = Some((part, words));
            }
        }
        Ok(best.map(|(_, words)| words))
    }

    /// Sums of squares of what is predicted wrong with another log, of each kind; times of readings are this many times as long.
    fn squares(&self, known: &Known, run: &Run, (log, factor): (&SensorLog, f64)) -> Result<[f64; KINDS.len()]> {
        let mut squares = [0.0; KINDS.len()];
        let begin = run.log.times()[0] + self.after_s;
        for (name, quantity, readings) in &run.outputs {
            let Some(kind) = KINDS.iter().position(|(own, ..)| own == quantity) else { continue };
            let times: Vec<f64> = readings.times.iter().map(|time| factor * time).collect();
            let predicted = known.values(log, name, &times)?.values;
            let rows = readings.times.iter().zip(readings.values.iter().zip(predicted));
            let later = rows.filter(|(time, _)| **time >= begin);
            squares[kind] +=
                later.map(|(_, (value, predicted))| (KINDS[kind].2 * (value - predicted)).powi(2)).sum::<f64>();
        }
        Ok(squares)
    }

    /// One output of one run: its kind, unit and sums.
    fn output(
        &self,
        known: &Known,
        run: &Run,
        output: usize,
        table: &mut String,
    ) -> Result<(usize, &'static str, Sums)> {
        let (name, quantity, readings) = &run.outputs[output];
        let kind = KINDS
            .iter()
            .position(|(own, ..)| own == quantity)
            .ok_or_else(|| Error::usage(format!("{name} is no length, angle or temperature: it cannot be judged")))?;
        let (_, unit, factor) = KINDS[kind];
        let (predicted, [variances, ordinary]) = known.predict(run, name, &readings.times)?;
        let mut sums = Sums::default();
        let begin = run.log.times()[0] + self.after_s;
        for (row, time) in readings.times.iter().enumerate().filter(|(_, time)| **time >= begin) {
            let off = factor * (readings.values[row] - predicted[row]);
            let variance = factor * factor * variances[row];
            sums.squares += off * off;
            sums.variances += variance;
            sums.ordinary += factor * factor * ordinary[row];
            sums.largest = sums.largest.max(off.abs());
            sums.count += 1;
            let (reading, predicted) = (factor * readings.values[row], factor * predicted[row]);
            // Writing to a text does not fail.
            let _ = writeln!(table, "{time},{name}_{unit},{reading},{predicted},{}", variance.sqrt());
        }
        if sums.count == 0 {
            return Err(Error::data(format!("no reading of {name} is later than `after_s`")).setting("after_s"));
        }
        Ok((kind, unit, sums))
    }
}

/// Whether an estimate was made from these rows: from as many of the same file.
fn is_seen(calibration: &Calibration, data: &Dataset) -> bool {
    let count = |place: usize| data.origins.iter().filter(|origin| origin.file == place).count();
    data.files.iter().enumerate().any(|(place, file)| {
        let name = file.display().to_string();
        let used = calibration.data.iter().filter(|record| record.file == name);
        let rows = used.flat_map(|record| &record.rows).map(|[first, last]| last - first + 1).sum::<usize>();
        rows > 0 && rows == count(place)
    })
}

/// What a calibration knows of thermal states.
struct Known<'a> {
    settings: Settings,
    calibration: &'a Calibration,
    /// The covariance of an ordinary fit, where that of the calibration is another one.
    ordinary: Option<&'a NamedCovariance>,
    time_constants: Vec<f64>,
}

/// An output as it is predicted.
struct Predicted {
    values: Vec<f64>,
    terms: Terms,
    /// Names and values of the gains of the terms.
    names: Vec<String>,
    gains: Vec<f64>,
}

impl<'a> Known<'a> {
    fn new(calibration: &'a Calibration) -> Result<Self> {
        let settings: Settings = from_settings(&calibration.model.settings)
            .map_err(|error| Error::data(format!("the settings of this calibration: {error}")))?;
        let settings = Settings { starts_warm: false, ..settings };
        let count = settings.structure().time_constants;
        let time = |index: usize| value(calibration, &format!("time_constant[{}]_s", index + 1));
        let time_constants = (0..count).map(time).collect::<Result<Vec<f64>>>()?;
        let ordinary = calibration.fit.ordinary_covariance.as_ref();
        Ok(Self { settings, calibration, ordinary, time_constants })
    }

    /// An output at some times, with what it is made of.
    fn values(&self, log: &SensorLog, name: &str, times: &[f64]) -> Result<Predicted> {
        let structure = self.settings.structure();
        let terms_of_log = Terms::new(log, &structure, &self.time_constants, times)?;
        let suffixes = terms(&structure, log.names(), 1).into_iter();
        let names: Vec<String> = suffixes.map(|(suffix, _)| format!("{name}{suffix}")).collect();
        let gains = names.iter().map(|name| value(self.calibration, name)).collect::<Result<Vec<f64>>>()?;
        Ok(Predicted { values: terms_of_log.output(&gains), terms: terms_of_log, names, gains })
    }

    /// An output at some times, and the variances of these predictions: by the calibration, and by an ordinary fit (zero without one).
    fn predict(&self, run: &Run, name: &str, times: &[f64]) -> Result<(Vec<f64>, [Vec<f64>; 2])> {
        let structure = self.settings.structure();
        let Predicted { values: predicted, terms: found, names, gains } = self.values(&run.log, name, times)?;
        let states = self.time_constants.len();
        let mut order: Vec<String> = (1..=states).map(|index| format!("time_constant[{index}]_s")).collect();
        order.extend(names);
        let derivatives = |row: usize| {
            let mut derivatives = vec![0.0; order.len()];
            for gain in 0..gains.len() {
                derivatives[states + gain] = found.columns[(row, gain)];
                if gain < structure.inputs.len() * states {
                    let index = gain % states;
                    derivatives[index] += gains[gain] * found.slopes[(row, gain)] / self.time_constants[index];
                }
            }
            derivatives
        };
        let variances = [Some(&self.calibration.covariance), self.ordinary].map(|covariance| {
            let block = covariance.map(|covariance| covariance.block(&order));
            let variance = |row: usize| {
                block.as_ref().map_or(0.0, |block| form(|row, column| block[(row, column)], &derivatives(row)))
            };
            (0..times.len()).map(|row| variance(row).max(0.0)).collect()
        });
        Ok((predicted, variances))
    }
}

/// The quadratic form of a covariance.
fn form(covariance: impl Fn(usize, usize) -> f64, derivatives: &[f64]) -> f64 {
    let size = derivatives.len();
    let products = (0..size).flat_map(|row| (0..size).map(move |column| (row, column)));
    products.map(|(row, column)| derivatives[row] * covariance(row, column) * derivatives[column]).sum()
}

fn value(calibration: &Calibration, name: &str) -> Result<f64> {
    let found = calibration.get(name).map(|estimated| estimated.value);
    found.ok_or_else(|| Error::data(format!("the calibration has no `{name}`")))
}
