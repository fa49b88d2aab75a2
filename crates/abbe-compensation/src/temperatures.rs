//! Temperatures of the time at which a machine is corrected.

use std::collections::BTreeMap;
use std::path::Path;

use abbe_core::{Calibration, Dataset, Error, Quantity, Result, from_settings};
use abbe_errors::{Body, Declaration};
use abbe_thermal::{Hold, SensorLog};

/// Rows from which on a sensor that reads the same all the time is stuck.
const LONG: usize = 20;

/// A log of sensors with its own clock, which takes the place of the one that a calibration keeps.
#[derive(Debug, Clone, PartialEq)]
pub struct Temperatures {
    data: Dataset,
}

impl Temperatures {
    /// Reads a log from a CSV file: `time_s` and a column for each sensor.
    ///
    /// Fails for a file that is no table, and for one without times or rows.
    pub fn read(path: &Path) -> Result<Self> {
        let text = abbe_table::read_text(path)?;
        let data = Dataset { is_log: true, ..abbe_table::parse(path, text.as_bytes())? };
        match data.numbers("time") {
            Some([_, .., last]) if last.is_finite() => Ok(Self { data }),
            Some(_) => Err(Error::data("a log of at least two rows was expected").in_file(path)),
            None => {
                let error = Error::usage("the log of temperatures has no column `time_s`").in_file(path);
                Err(error.help("its clock has to be that of the set-points"))
            }
        }
    }

    /// The log as a model takes it.
    pub fn data(&self) -> &Dataset {
        &self.data
    }

    /// The time of its last row, s.
    pub fn end(&self) -> f64 {
        self.data.numbers("time").and_then(|times| times.last().copied()).unwrap_or(f64::NAN)
    }

    /// Refuses a sensor of the calibration that reads the same all the time while others move ([`SensorLog::stuck`]): its part of the
    /// correction would be missing. Short logs are not judged.
    pub fn check_moves(&self, calibration: &Calibration) -> Result<()> {
        let times = self.data.numbers("time").unwrap_or_default();
        if times.len() < LONG {
            return Ok(());
        }
        let moved =
            logged(calibration).into_iter().filter(|(_, known)| ends(known).is_some_and(|[from, to]| from < to));
        let sensors = moved.filter_map(|(header, _)| {
            let readings = self.data.numbers(Quantity::of_column(&header).0)?.to_vec();
            Some((header, readings))
        });
        let log = SensorLog::new(times.to_vec(), sensors.collect(), Hold::default(), None)?;
        match log.stuck().first() {
            None => Ok(()),
            Some(sensor) => {
                let message = format!("{sensor} reads the same all the time, and others move: it is stuck");
                Err(Error::data(message).help("repair or connect the sensor, and give a log of it that moves"))
            }
        }
    }

    /// What a calibration does not know of this log: readings beyond those of its own one, by more than a tenth of their range; and
    /// pairs of sensors that read what the other one read then.
    pub fn beyond(&self, calibration: &Calibration) -> Vec<String> {
        let mut told = Vec::new();
        let mut outside: Vec<Compared> = Vec::new();
        for (header, known) in logged(calibration) {
            let (name, ..) = Quantity::of_column(&header);
            let (Some(own), Some(known)) = (self.data.numbers(name).and_then(ends), ends(&known)) else { continue };
            if !within(own, known) {
                told.push(format!(
                    "{header} goes from {:.2} to {:.2}; gains were found from {:.2} to {:.2}",
                    own[0], own[1], known[0], known[1]
                ));
                outside.push(Compared { name: name.to_owned(), own, known });
            }
        }
        for (index, one) in outside.iter().enumerate() {
            let is_other = |other: &&Compared| within(one.own, other.known) && within(other.own, one.known);
            if let Some(other) = outside[index + 1..].iter().find(is_other) {
                told.push(format!(
                    "each of them reads what the other one read then: are {} and {} exchanged?",
                    one.name, other.name
                ));
            }
        }
        told
    }

    /// A word if most sensors that move changed much less, within a time as long as this log, when the machine was calibrated: times in
    /// minutes that are read as seconds look like that.
    pub fn too_fast(&self, calibration: &Calibration) -> Option<String> {
        let times = self.data.numbers("time")?;
        let duration = times.last()? - times.first()?;
        let logs = logs(calibration);
        let mut ratios = Vec::new();
        for (header, known) in logged(calibration) {
            let (Some(own), Some(known)) =
                (self.data.numbers(Quantity::of_column(&header).0).and_then(ends), ends(&known))
            else {
                continue;
            };
            let [own, range] = [own, known].map(|[from, to]| to - from);
            let of_logs = logs.iter().filter_map(|log| Some((log.get(TIME)?, log.get(&header)?)));
            let then = of_logs.map(|(times, readings)| largest_change(times, readings, duration)).fold(0.0, f64::max);
            // A sensor that hardly moves shows its noise. More than the whole range of the calibration is told as that.
            if then > 0.0 && own >= MOVES * range {
                ratios.push(own.min(range) / then);
            }
        }
        // Half of the sensors say it: one near a heater may be quick by itself.
        ratios.sort_by(f64::total_cmp);
        let median = ratios.get(ratios.len() / 2).copied().filter(|median| *median > TOO_FAST)?;
        Some(format!(
            "within {duration:.0} s temperatures change {median:.0} times as much as when the machine was calibrated: is \
             `{TIME}` in minutes?"
        ))
    }
}

/// The column of times of a log.
const TIME: &str = "time_s";

/// Part of a sensor's range in the calibration from which on it moves.
const MOVES: f64 = 0.25;

/// How many times as much as in the calibration temperatures may change within the same time without a word.
const TOO_FAST: f64 = 3.0;

/// The largest range of readings within a duration, of windows that begin a quarter of it after each other. The times ascend; readings
/// without a time of their own are not looked at.
fn largest_change(times: &[f64], readings: &[f64], duration: f64) -> f64 {
    let rows = times.len().min(readings.len());
    let (times, readings) = (&times[..rows], &readings[..rows]);
    let (mut largest, mut start) = (0.0_f64, 0);
    while start < rows {
        let first_after = |span: f64| times.partition_point(|time| *time <= times[start] + span);
        // Neighbours count even if they are further apart than the duration.
        let end = first_after(duration).max(start + 2).min(rows);
        largest = largest.max(ends(&readings[start..end]).map_or(0.0, |[from, to]| to - from));
        start = first_after(0.25 * duration).max(start + 1);
    }
    largest
}

/// A sensor whose readings, smallest and largest, are not those of the calibration.
struct Compared {
    name: String,
    own: [f64; 2],
    known: [f64; 2],
}

/// Whether readings are among others, or beyond them by no more than a part of their range.
fn within(own: [f64; 2], [from, to]: [f64; 2]) -> bool {
    let more = BEYOND * (to - from);
    own[0] >= from - more && own[1] <= to + more
}

/// Part of the range of a sensor by which readings may be beyond those of the calibration without a word.
const BEYOND: f64 = 0.1;

/// The smallest and the largest number.
fn ends(values: &[f64]) -> Option<[f64; 2]> {
    let first = *values.first()?;
    Some(values.iter().fold([first; 2], |[least, most], value| [least.min(*value), most.max(*value)]))
}

/// The lines of errors of a calibration's machine; none if it is described in another way.
pub(crate) fn declarations(calibration: &Calibration) -> Vec<Declaration> {
    let lines = calibration.model.settings.get("errors").and_then(|lines| lines.as_array());
    lines.into_iter().flatten().filter_map(|line| Declaration::read(line).ok()).collect()
}

/// The logs that a calibration keeps for its errors and bodies: the readings of each column by its header.
fn logs(calibration: &Calibration) -> Vec<BTreeMap<String, Vec<f64>>> {
    let bodies = calibration.model.settings.get("bodies").and_then(|bodies| bodies.as_object());
    let bodies = bodies.into_iter().flatten().filter_map(|(_, body)| from_settings::<Body>(body).ok());
    let of_bodies = bodies.flat_map(|body| body.logs.into_values().chain([body.log]));
    let of_line = |line| match line {
        Declaration::Thermal(thermal) => thermal.logs.into_values().chain([thermal.log]).collect(),
        _ => Vec::new(),
    };
    let of_lines = declarations(calibration).into_iter().flat_map(of_line);
    of_bodies.chain(of_lines).collect()
}

/// Columns of [`logs`] without times: header and readings, those of several logs one after another.
fn logged(calibration: &Calibration) -> Vec<(String, Vec<f64>)> {
    let mut columns: Vec<(String, Vec<f64>)> = Vec::new();
    let all = logs(calibration).into_iter().flatten();
    for (header, values) in all.filter(|(header, _)| Quantity::of_column(header).1 != Quantity::Time) {
        match columns.iter_mut().find(|(known, _)| *known == header) {
            Some((_, known)) => known.extend(values),
            None => columns.push((header, values)),
        }
    }
    columns
}

/// Whether errors of a calibration follow the log of its measurement.
pub fn follows_log(calibration: &Calibration) -> bool {
    !logged(calibration).is_empty()
}

/// Refuses a calibration with a drift in time that is not zero: on the clock of another log it would be carried on without a bound.
pub fn check_no_drift(calibration: &Calibration) -> Result<()> {
    for line in declarations(calibration) {
        let Declaration::Drift(_) = line else { continue };
        let of_line = |name: &str| {
            let (symbol, term) = name.split_once('[').unwrap_or((name, ""));
            let term = term.trim_end_matches(']').rsplit('.').next().unwrap_or_default();
            let degree = term.strip_prefix('t').is_some_and(|degree| degree.parse::<u8>().is_ok());
            degree && line.family().symbols().iter().any(|own| abbe_core::matches(own, symbol))
        };
        if let Some(found) = calibration.parameters.iter().find(|known| of_line(&known.name) && known.value != 0.0) {
            let message =
                format!("`{}` is a drift in the time of the calibration, which another log does not have", found.name);
            return Err(Error::data(message).help("estimate it without a drift in time, or leave out the log"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::largest_change;

    #[test]
    fn the_largest_change_of_a_ramp_is_its_slope() {
        let times: Vec<f64> = (0..1000).map(f64::from).collect();
        let ramp: Vec<f64> = times.iter().map(|time| (time - 400.0).clamp(0.0, 200.0) * 0.1).collect();
        assert!((largest_change(&times, &ramp, 50.0) - 5.0).abs() < 1e-12);
        assert!((largest_change(&times, &ramp, 2000.0) - 20.0).abs() < 1e-12);
        // Neighbours, if the duration is shorter than a step; and no more than there is.
        assert!((largest_change(&times, &ramp, 0.0) - 0.1).abs() < 1e-9);
        assert_eq!(largest_change(&times, &ramp[..3], 50.0), 0.0);
        assert_eq!(largest_change(&[], &[], 50.0), 0.0);
    }
}
