//! Logs of sensors with their own clock.

use abbe_core::ranges::TEMPERATURES;
use abbe_core::{Error, Result, SettingsError};

use crate::stuck::{LONG, stuck_part};

/// How an input runs between two samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Hold {
    /// Along a straight line: temperatures.
    #[default]
    FirstOrder,
    /// It stays until the next sample: speeds.
    ZeroOrder,
}

/// From which value inputs are counted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Reference {
    /// From that of the first row.
    FirstRow,
    /// From the mean of rows up to this time, s: idle minutes.
    MeanUntil(f64),
    /// From this one, for all sensors: the machine was at one temperature.
    Value(f64),
}

/// How a log is counted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Counting {
    /// How inputs run between two rows.
    pub hold: Hold,
    /// From which value they count.
    pub reference: Reference,
    /// Longest time between two rows, s. None: five times the median.
    pub longest_gap: Option<f64>,
}

/// The longest gap, in medians of the times between rows.
const GAP: f64 = 5.0;

/// A jump of a temperature and back that no machine makes from one row to the next, K.
const SPIKE: f64 = 5.0;

/// Part of the variance of the noise that is left, in the mean, between two rows that a line joins.
const BETWEEN: f64 = 2.0 / 3.0;

/// The noise of a sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SensorNoise {
    /// Standard deviation of a reading, in its unit.
    pub scatter: f64,
    /// Standard deviation of what the sensor follows.
    pub moves: f64,
    /// Part by which the gain of what follows this sensor alone comes out too small.
    pub share: f64,
}

/// What sensors read over time.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorLog {
    times: Vec<f64>,
    names: Vec<String>,
    /// For each sensor its readings.
    values: Vec<Vec<f64>>,
    hold: Hold,
}

impl SensorLog {
    /// A log of sensors, each with a reading at every time (s). Readings may be further apart than `longest_gap` nowhere.
    ///
    /// Fails for times that do not increase, for gaps, for readings that are no numbers, and for names that are there twice.
    pub fn new(
        times: Vec<f64>,
        sensors: Vec<(String, Vec<f64>)>,
        hold: Hold,
        longest_gap: Option<f64>,
    ) -> Result<Self> {
        if times.len() < 2 {
            return Err(Error::data("a log of at least two rows was expected"));
        }
        if let Some(row) = times.iter().position(|time| !time.is_finite()) {
            return Err(Error::data(format!("row {} of the log has no time", row + 1)));
        }
        for (row, pair) in times.windows(2).enumerate() {
            let by = pair[1] - pair[0];
            if by <= 0.0 {
                let message = format!("time goes from {} s to {} s in row {} of the log", pair[0], pair[1], row + 2);
                return Err(Error::data(message).help("did the clock jump, or are rows there twice?"));
            }
            if longest_gap.is_some_and(|longest| by > longest) {
                let message = format!("the log has a gap of {by} s before row {}", row + 2);
                return Err(Error::data(message)
                    .help("states are not known behind a gap; allow a longer one, or cut the log there"));
            }
        }
        for (place, (name, values)) in sensors.iter().enumerate() {
            if sensors[..place].iter().any(|(other, _)| other == name) {
                return Err(Error::data(format!("the sensor {name} is in the log twice")));
            }
            if values.len() != times.len() {
                let message = format!("{name} has {} readings, and the log {} rows", values.len(), times.len());
                return Err(Error::data(message));
            }
            if let Some(row) = values.iter().position(|value| !value.is_finite()) {
                return Err(Error::data(format!("{name} has no reading in row {} of the log", row + 1)));
            }
        }
        let (names, values) = sensors.into_iter().unzip();
        Ok(Self { times, names, values, hold })
    }

    /// The log of sensors of a machine, each counted from its reference.
    ///
    /// Fails as [`new`](Self::new) and [`elevations`](Self::elevations) do, and for a sensor that reads the same all the time: it is
    /// stuck, or not connected.
    pub fn counted(times: Vec<f64>, sensors: Vec<(String, Vec<f64>)>, how: &Counting) -> Result<Self> {
        let longest = how.longest_gap.or_else(|| Some(GAP * median_step(&times)?));
        let log = Self::new(times, sensors, how.hold, longest)?;
        let is_long = log.times().len() >= LONG;
        if let Some(name) = log.stuck().first().filter(|_| is_long) {
            return Err(Error::data(format!(
                "the sensor {name} reads the same all the time, and others move: it is stuck"
            )));
        }
        let log = log.elevations(how.reference)?;
        let still = (0..log.names().len()).find(|&sensor| log.values(sensor).iter().all(|value| value.abs() < 1e-9));
        match still.filter(|_| is_long) {
            None => Ok(log),
            Some(sensor) => {
                let name = &log.names()[sensor];
                Err(Error::data(format!("{name} reads the same all the time: the sensor is stuck, or not connected")))
            }
        }
    }

    /// Times of the rows, s.
    pub fn times(&self) -> &[f64] {
        &self.times
    }

    /// The usual time between two rows, s.
    pub fn step(&self) -> f64 {
        median_step(&self.times).unwrap_or(f64::NAN)
    }

    /// The same log with times this many times as long.
    pub fn stretched(&self, factor: f64) -> Self {
        Self { times: self.times.iter().map(|time| time * factor).collect(), ..self.clone() }
    }

    /// Names of the sensors.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// How inputs run between two rows.
    pub fn hold(&self) -> Hold {
        self.hold
    }

    /// The readings of a sensor.
    pub fn values(&self, sensor: usize) -> &[f64] {
        &self.values[sensor]
    }

    /// The index of a sensor; fails if there is none of this name.
    pub fn sensor(&self, name: &str) -> Result<usize> {
        self.names.iter().position(|own| own == name).ok_or_else(|| {
            Error::data(format!("the log has no sensor {name}")).suggest(name, self.names.iter().map(String::as_str))
        })
    }

    /// The same log with the readings of two sensors exchanged.
    pub fn exchanged(&self, one: usize, other: usize) -> Self {
        let mut exchanged = self.clone();
        exchanged.values.swap(one, other);
        exchanged
    }

    /// The same log, each sensor counted from its reference.
    ///
    /// Fails if no row is within the span of the reference.
    pub fn elevations(mut self, reference: Reference) -> Result<Self> {
        let rows = match reference {
            Reference::MeanUntil(until) => self.times.partition_point(|time| *time <= until),
            Reference::FirstRow | Reference::Value(_) => 1,
        };
        if rows == 0 {
            return Err(Error::data(format!(
                "the log begins at {} s, behind the span of its reference",
                self.times[0]
            )));
        }
        for values in &mut self.values {
            let from = match reference {
                Reference::Value(value) => value,
                _ => values[..rows].iter().sum::<f64>() / rows as f64,
            };
            values.iter_mut().for_each(|value| *value -= from);
        }
        Ok(self)
    }

    /// Sensors that read the same number all the time while others move: they are stuck, or not connected.
    pub fn stuck(&self) -> Vec<&str> {
        let moves = |values: &[f64]| values.iter().any(|value| *value != values[0]);
        if !self.values.iter().any(|values| moves(values)) {
            return Vec::new();
        }
        let names = self.names.iter().zip(&self.values).filter(|(_, values)| !moves(values));
        names.map(|(name, _)| name.as_str()).collect()
    }

    /// What looks like the fault of a sensor, in words ([`sensor_faults`]).
    pub fn faults(&self, sensor: usize) -> Vec<String> {
        sensor_faults(&self.names[sensor], &self.values[sensor])
    }

    /// The same log with the readings of all sensors in reverse order.
    pub fn turned(&self) -> Self {
        let mut turned = self.clone();
        turned.values.iter_mut().for_each(|values| values.reverse());
        turned
    }

    /// The noise of a sensor, seen from row to row, and what it does to the gain of a state with this time constant (zero: of what
    /// follows at once). None for few rows and for readings that stay from row to row.
    pub fn noise(&self, sensor: usize, time_constant: f64) -> Option<SensorNoise> {
        let (times, values) = (&self.times, &self.values[sensor]);
        if times.len() < LONG || self.hold == Hold::ZeroOrder {
            return None;
        }
        // How far each reading is from the line through its neighbours, as noise of one reading.
        let mut off: Vec<f64> = (1..times.len() - 1)
            .map(|row| {
                let part = (times[row] - times[row - 1]) / (times[row + 1] - times[row - 1]);
                let between = (1.0 - part) * values[row - 1] + part * values[row + 1];
                (values[row] - between).abs() / (1.0 + part.powi(2) + (1.0 - part).powi(2)).sqrt()
            })
            .collect();
        off.sort_by(f64::total_cmp);
        // Half of normal numbers are nearer than this to their mean; so it counts no steps of the temperature.
        let scatter = off[off.len() / 2] / 0.6745;
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / values.len() as f64;
        // Between rows the noise of both counts; a state takes the mean over its time constant.
        let left = match time_constant > 0.0 {
            true => (median_step(times)? / (2.0 * time_constant)).min(BETWEEN),
            false => BETWEEN,
        };
        let moves = (variance - scatter * scatter).max(0.0).sqrt();
        let share = left * scatter * scatter / (left * scatter * scatter + moves * moves);
        share.is_finite().then_some(SensorNoise { scatter, moves, share })
    }

    /// The interval of a time (index of its first row) and the time in it, s.
    ///
    /// Fails for a time outside the log.
    pub(crate) fn interval(&self, time: f64) -> Result<(usize, f64)> {
        let last = self.times.len() - 1;
        if !(self.times[0]..=self.times[last]).contains(&time) {
            let message =
                format!("{time} s is outside the log, which goes from {} s to {} s", self.times[0], self.times[last]);
            return Err(Error::data(message).help("do both clocks count from the same beginning?"));
        }
        let row = self.times.partition_point(|own| *own <= time).clamp(1, last) - 1;
        Ok((row, time - self.times[row]))
    }

    /// Readings of a sensor at both ends of the part of an interval up to `within` (s), as its hold says.
    pub(crate) fn ends(&self, sensor: usize, row: usize, within: f64) -> [f64; 2] {
        let values = &self.values[sensor];
        let before = values[row];
        match self.hold {
            Hold::ZeroOrder => [before, before],
            Hold::FirstOrder => {
                let part = within / (self.times[row + 1] - self.times[row]);
                [before, before + part * (values[row + 1] - before)]
            }
        }
    }

    /// What a sensor reads at a time, between its samples as its hold says.
    ///
    /// Fails for a time outside the log.
    pub fn at(&self, sensor: usize, time: f64) -> Result<f64> {
        let (row, within) = self.interval(time)?;
        let is_next = self.hold == Hold::ZeroOrder && time == self.times[row + 1];
        Ok(if is_next { self.values[sensor][row + 1] } else { self.ends(sensor, row, within)[1] })
    }
}

/// What looks like the fault of a sensor of temperature, in words: a reading that jumps by many kelvin and comes back with the next
/// row, and one that stands still for long while the same sensor moves in most rows before and after it. It may
/// stand at the beginning, while the machine rests.
pub fn sensor_faults(name: &str, values: &[f64]) -> Vec<String> {
    let mut faults = Vec::new();
    let spike = (1..values.len().saturating_sub(1)).find(|&row| {
        let (up, down) = (values[row] - values[row - 1], values[row] - values[row + 1]);
        up * down > 0.0 && up.abs().min(down.abs()) > SPIKE && (values[row + 1] - values[row - 1]).abs() < SPIKE / 5.0
    });
    if let Some(row) = spike {
        let by = values[row] - values[row - 1];
        faults
            .push(format!("{name} jumps by {by:.1} K in row {} of the log, and back: a fault of the sensor?", row + 1));
    }
    if let Some((first, count)) = stuck_part(values) {
        faults.push(format!(
            "{name} reads the same from row {} to row {} of the log, and moves in others: was it stuck?",
            first + 1,
            first + count
        ));
    }
    faults
}

/// The median of the times between rows.
fn median_step(times: &[f64]) -> Option<f64> {
    let mut steps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    steps.sort_by(f64::total_cmp);
    steps.get(steps.len() / 2).copied()
}

/// Refuses a reference that is no temperature of a machine in °C: it may be in kelvin or in degrees Fahrenheit.
pub fn possible_temperature(value: f64) -> std::result::Result<(), SettingsError> {
    if TEMPERATURES.contains(&value) {
        return Ok(());
    }
    let (from, to) = (TEMPERATURES.start(), TEMPERATURES.end());
    Err(SettingsError::new("reference_degC", format!("{value}: a temperature from {from} to {to} °C was expected")))
}
