//! Drift of readings over time, in the manner of ISO 230-3: environment, warm-up of a spindle, movement of axes.

use std::collections::BTreeMap;

use abbe_core::{
    DataRow, Dataset, Error, Figure, Findings, PathItem, Quantity, Result, SettingsError, not_negative, positive,
};
use abbe_standards::thermal_drift::{largest_range, range, slope_at_end, time_to_part};
use abbe_thermal::{exchanged, in_another_unit, is_dead, not_copied, stuck};
use schemars::JsonSchema;
use serde::Deserialize;

use crate::settings::{TIME, quantity};
use crate::states::temperatures;
use crate::validate::{Limits, check_limits, limited};

/// Drift of readings over time. ISO 230-3 calls it environmental temperature variation error where the machine stands, and thermal
/// distortion where its spindle turns or its axes move.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DriftSettings {
    /// Columns of lengths or angles, without their units.
    readings: Vec<String>,
    /// Angles from two columns of lengths: (second - first) / distance, by name.
    #[serde(default)]
    angles: BTreeMap<String, AngleSettings>,
    /// Columns of temperatures whose range is told; drift is told by kelvin of the first one.
    #[serde(default)]
    temperatures: Vec<String>,
    /// Begin of the part of the run that is judged, from its first row.
    #[serde(default)]
    from_s: f64,
    /// End of the part of the run that is judged, from its first row. Default: the last row.
    #[serde(default)]
    until_s: Option<f64>,
    /// Length of the window of `first range` and `largest range in a window`.
    #[serde(default = "hour")]
    window_s: f64,
    /// Length of the part at the end that the slope is taken from.
    #[serde(default = "minutes")]
    slope_window_s: f64,
    /// Part of the way from the first to the last reading after which readings have to stay.
    #[serde(default = "part")]
    part: f64,
    /// Standard uncertainty of a reading of length.
    #[serde(default)]
    standard_uncertainty_um: f64,
    /// Largest admissible values of every reading: `range_um`, `first_range_um`, `window_range_um`, `end_um`, `slope_um_per_min`, those
    /// of angles with `urad`, and `time_min`.
    #[serde(default)]
    limits: Limits,
}

/// An angle from two readings of length.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct AngleSettings {
    /// The two columns.
    of: [String; 2],
    /// Distance of the two sensors.
    distance_mm: f64,
}

fn hour() -> f64 {
    3600.0
}

fn minutes() -> f64 {
    300.0
}

fn part() -> f64 {
    0.95
}

/// Figures that may have limits, before their unit.
const KEYS: [&str; 5] = ["range", "first_range", "window_range", "end", "slope"];

/// Readings in the unit of their figures.
struct Readings {
    name: String,
    unit: &'static str,
    values: Vec<f64>,
    standard_uncertainty: f64,
}

impl DriftSettings {
    /// Refuses settings that contradict each other.
    pub fn check(&self) -> Result<(), SettingsError> {
        if self.readings.is_empty() && self.angles.is_empty() {
            return Err(SettingsError::new("readings", "at least one column was expected"));
        }
        for (name, angle) in &self.angles {
            let at = ["angles", name].map(|key| PathItem::Key(key.to_owned()));
            positive("distance_mm", angle.distance_mm).map_err(|error| error.under(at))?;
        }
        not_negative("from_s", self.from_s)?;
        not_negative("standard_uncertainty_um", self.standard_uncertainty_um)?;
        positive("window_s", self.window_s)?;
        positive("slope_window_s", self.slope_window_s)?;
        if self.until_s.is_some_and(|until| !(until.is_finite() && until > self.from_s)) {
            return Err(SettingsError::new("until_s", "a time after `from_s` was expected"));
        }
        if !(self.part > 0.0 && self.part < 1.0) {
            return Err(SettingsError::new("part", "a number between 0 and 1 was expected"));
        }
        let keys: Vec<String> = KEYS
            .iter()
            .flat_map(|key| ["um", "urad"].map(|unit| key_of(key, unit)))
            .chain(["time_min".to_owned()])
            .collect();
        check_limits(&self.limits, &keys.iter().map(String::as_str).collect::<Vec<_>>())
    }

    /// Figures of one run.
    pub fn judge(&self, data: &Dataset, run: &str, findings: &mut Findings) -> Result<()> {
        let times = data.required_numbers(TIME)?;
        if let Some(row) = (1..times.len()).find(|&row| times[row] <= times[row - 1]) {
            let message = format!("time goes from {} s to {} s", times[row - 1], times[row]);
            return Err(data.error_at(DataRow(row), message).help("did the clock jump, or are rows there twice?"));
        }
        let begin = times.first().copied().unwrap_or_default();
        let first = times.partition_point(|time| *time < begin + self.from_s);
        let last = self.until_s.map_or(times.len(), |until| times.partition_point(|time| *time <= begin + until));
        if last < first + 2 {
            let message = format!("fewer than two readings from {} s on", self.from_s);
            return Err(Error::data(message).setting("from_s"));
        }
        if let (Some(until), Some(end)) = (self.until_s, times.last().map(|last| last - begin))
            && until > end
        {
            findings.remarks.push(format!(
                "{run}: `until_s` is {until} s, and the log ends {end:.0} s after its first row: what came later is not judged"
            ));
        }
        let rows = first..last;
        let times = &times[rows.clone()];
        not_copied(data, self.readings.iter().chain(self.angles.values().flat_map(|angle| &angle.of)))?;
        for readings in self.all(data, rows.clone())? {
            let Readings { name, values, .. } = &readings;
            if is_dead(values) {
                let message = format!("{name} reads the same in all rows that are judged");
                return Err(data
                    .error_at(DataRow(first), message)
                    .help("is the sensor connected, and within its range?"));
            }
            findings.remarks.extend(stuck(name, values, first + 1).map(|doubt| format!("{run}: {doubt}")));
            findings.figures.extend(self.figures(times, &readings, run));
        }
        let doubts = exchanged(data).or_else(|| self.other_unit(data));
        let doubts = doubts.into_iter().chain(at_rest(data, rows.clone())).chain(self.beside(data, rows.clone())?);
        findings.remarks.extend(doubts.map(|doubt| format!("{run}: {doubt}")));
        self.environment(data, rows, run, findings)
    }

    /// What is wrong with the unit of displacements of a run.
    fn other_unit(&self, data: &Dataset) -> Option<String> {
        let names = self.readings.iter().filter(|name| quantity(data, name) == Quantity::Length);
        let lengths: Vec<(&str, &[f64])> =
            names.filter_map(|name| Some((name.as_str(), data.numbers(name)?))).collect();
        in_another_unit(&lengths, &temperatures(data))
    }

    /// The reading with a limit that moves far more in the whole log than in the rows that are judged.
    fn beside(&self, data: &Dataset, rows: std::ops::Range<usize>) -> Result<Option<String>> {
        if self.limits.is_empty() || rows.len() == data.rows() {
            return Ok(None);
        }
        let times = data.required_numbers(TIME)?;
        let (judged, whole) = (self.all(data, rows.clone())?, self.all(data, 0..data.rows())?);
        let pairs = judged.iter().zip(&whole).map(|(judged, whole)| {
            (whole, whole_range(&times[rows.clone()], &judged.values), whole_range(times, &whole.values))
        });
        let far = pairs.filter(|(_, judged, whole)| *whole > FAR_MORE * judged);
        let most = far.max_by(|(_, one, all), (_, other, of_all)| (all / one).total_cmp(&(of_all / other)));
        Ok(most.map(|(Readings { name, unit, .. }, judged, whole)| {
            let unit = if *unit == "um" { "µm" } else { "µrad" };
            format!(
                "{name} has a range of {judged:.1} {unit} in the rows that are judged, and of {whole:.0} {unit} in the whole log: are `from_s` \
                 and `until_s` what is meant, in seconds?"
            )
        }))
    }

    /// All readings and angles of the judged rows.
    fn all(&self, data: &Dataset, rows: std::ops::Range<usize>) -> Result<Vec<Readings>> {
        let length = |name: &String, at: &[PathItem]| -> Result<Vec<f64>> {
            let values = match quantity(data, name) {
                Quantity::Length => Ok(data.required_numbers(name)?[rows.clone()].iter().map(|mm| 1e3 * mm).collect()),
                Quantity::Label => Err(data.required_numbers(name).err().unwrap_or_else(|| Error::data("no numbers"))),
                _ => Err(in_file(data, Error::usage(format!("{name} is no length")))),
            };
            values.map_err(|error| Error { setting: at.to_vec(), ..error })
        };
        let at = |keys: &[&str], index: usize| {
            let keys = std::iter::once("drift").chain(keys.iter().copied());
            let keys = keys.map(|key| PathItem::Key(key.to_owned()));
            keys.chain([PathItem::Index(index)]).collect::<Vec<PathItem>>()
        };
        let u = self.standard_uncertainty_um;
        let mut all = Vec::new();
        for (index, name) in self.readings.iter().enumerate() {
            let is_angle = quantity(data, name) == Quantity::Angle;
            let values = match is_angle {
                true => data.required_numbers(name)?[rows.clone()].iter().map(|rad| 1e6 * rad).collect(),
                false => length(name, &at(&["readings"], index))?,
            };
            let (unit, standard_uncertainty) = if is_angle { ("urad", 0.0) } else { ("um", u) };
            all.push(Readings { name: name.clone(), unit, values, standard_uncertainty });
        }
        for (name, angle) in &self.angles {
            let of = |end: usize| length(&angle.of[end], &at(&["angles", name, "of"], end));
            let [one, other] = [of(0)?, of(1)?];
            let scale = 1e3 / angle.distance_mm;
            let values = one.iter().zip(other).map(|(one, other)| scale * (other - one)).collect();
            let standard_uncertainty = 2.0_f64.sqrt() * u * scale;
            all.push(Readings { name: name.clone(), unit: "urad", values, standard_uncertainty });
        }
        Ok(all)
    }

    fn figures(&self, times: &[f64], readings: &Readings, run: &str) -> Vec<Figure> {
        let Readings { name, unit, values, standard_uncertainty } = readings;
        let (begin, end) = (times[0], times[times.len() - 1]);
        // A range and a difference are of two readings.
        let u = 2.0_f64.sqrt() * standard_uncertainty;
        let figure = |what: &str, value: Option<f64>, unit: &str, key: String, u: f64| {
            let figure = Figure::new("", format!("{what}[{name}, {run}]"), value.unwrap_or(f64::NAN), unit);
            let figure = Figure { of: None, ..figure }.uncertain((u > 0.0).then_some(u));
            value.is_some().then(|| limited(figure, &key, &self.limits))
        };
        let per_minute = format!("{unit}/min");
        let slope = slope_at_end(times, values, self.slope_window_s).map(|slope| 60.0 * slope);
        let change = values[values.len() - 1] - values[0];
        let time = time_to_part(times, values, self.part).map(|seconds| seconds / 60.0);
        let key = |what: &str| key_of(what, unit);
        let window = self.window_s;
        let all = [
            figure("range", range(times, values, begin, end), unit, key("range"), u),
            figure("first range", range(times, values, begin, begin + window), unit, key("first_range"), u),
            figure("largest range in a window", largest_range(times, values, window), unit, key("window_range"), u),
            figure("end", Some(change), unit, key("end"), u),
            figure("slope at the end", slope, &per_minute, key("slope"), 0.0),
            figure(&format!("time to {} %", 100.0 * self.part), time, "min", "time_min".to_owned(), 0.0),
        ];
        all.into_iter().flatten().map(absolute).collect()
    }

    /// Ranges of temperatures, and drift by kelvin.
    fn environment(
        &self,
        data: &Dataset,
        rows: std::ops::Range<usize>,
        run: &str,
        findings: &mut Findings,
    ) -> Result<()> {
        for (index, name) in self.temperatures.iter().enumerate() {
            if quantity(data, name) != Quantity::Temperature {
                let message = format!("{name} is no column of temperatures");
                let mut error = in_file(data, Error::usage(message));
                error.setting = ["drift", "temperatures"].map(|key| PathItem::Key(key.to_owned())).to_vec();
                error.setting.push(PathItem::Index(index));
                return Err(error);
            }
            let times = &data.required_numbers(TIME)?[rows.clone()];
            let values = &data.required_numbers(name)?[rows.clone()];
            let found = whole_range(times, values);
            let figure = Figure::new("", format!("range[{name}, {run}]"), found, "K");
            findings.figures.push(Figure { of: None, ..figure });
            if index > 0 || found == 0.0 {
                continue;
            }
            for readings in self.all(data, rows.clone())? {
                let spread = whole_range(times, &readings.values);
                let label = format!("range by kelvin of {name}[{}, {run}]", readings.name);
                let figure = Figure::new("", label, spread / found, &format!("{}/K", readings.unit)).detail();
                findings.figures.push(Figure { of: None, ..figure });
            }
        }
        Ok(())
    }
}

/// The range of all readings at these times.
fn whole_range(times: &[f64], values: &[f64]) -> f64 {
    range(times, values, times[0], times[times.len() - 1]).unwrap_or_default()
}

/// How many times as far a reading moves in the whole log as in the rows that are judged, from where on it is told.
const FAR_MORE: f64 = 10.0;

/// A spindle that turns in some rows, and in none of those that are judged.
fn at_rest(data: &Dataset, rows: std::ops::Range<usize>) -> Option<String> {
    let speeds = data.numbers("speed")?;
    let turns = |speeds: &[f64]| speeds.iter().any(|speed| *speed != 0.0);
    (turns(speeds) && !turns(&speeds[rows])).then(|| {
        "the spindle stands in all rows that are judged, and turns in others (column `speed`): a machine at rest is judged".to_owned()
    })
}

/// An error about the columns of a data set.
fn in_file(data: &Dataset, error: Error) -> Error {
    match data.files.first() {
        Some(file) => error.in_file(file),
        None => error,
    }
}

/// The key of a limit.
fn key_of(what: &str, unit: &str) -> String {
    if what == "slope" { format!("slope_{unit}_per_min") } else { format!("{what}_{unit}") }
}

/// A limit bounds the size of a figure that may be negative.
fn absolute(figure: Figure) -> Figure {
    let is_limited = figure.limit.is_some();
    Figure { value: figure.value.map(|value| if is_limited { value.abs() } else { value }), ..figure }
}
