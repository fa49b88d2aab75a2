//! The log that thermal errors follow.

use std::collections::BTreeMap;

use abbe_core::{Dataset, PathItem, Quantity, SettingsError};
use abbe_thermal::{Hold, Reference, SensorLog};

use super::Thermal;
use crate::log::{self, key};

/// Noise that makes gains smaller by this part is told.
const TOLD: f64 = 0.01;

impl Thermal {
    /// Takes the log from the data set that has its columns. A log among the data takes the place of one that the settings keep: gains
    /// hold from the reference of the latter, and states begin at rest, because nobody knows what was before.
    ///
    /// Fails if no log, or more than one, has the columns, and for logs with gaps, clocks that jump, and sensors without a reading.
    pub fn settle(&mut self, data: &[&Dataset]) -> Result<(), SettingsError> {
        let columns: Vec<String> = self.columns().map(str::to_owned).collect();
        let columns: Vec<&str> = columns.iter().map(String::as_str).collect();
        let has_log = data.iter().any(|data| data.is_log);
        match (&self.series, self.is_settled()) {
            (Some(series), false) => {
                self.logs = log::by_series(data, &columns, series).map_err(|error| match error.path.is_empty() {
                    true => error.under([key("thermal")]),
                    false => error,
                })?;
            }
            (_, is_settled) if has_log || !is_settled => {
                let found = log::with_columns(data, &columns).map_err(|error| error.under([key("thermal")]))?;
                match (found, is_settled) {
                    (Some(found), true) => self.exchange(log::kept(found, &columns))?,
                    (Some(found), false) => self.log = log::kept(found, &columns),
                    (None, _) => {}
                }
            }
            _ => {}
        }
        if !self.is_settled() {
            return Ok(());
        }
        self.check_rows(data)?;
        // What is wrong with it is told now, and not by the first row that needs it.
        self.sensor_logs().map(drop)
    }

    /// Whether the log is known.
    fn is_settled(&self) -> bool {
        !self.log.is_empty() || !self.logs.is_empty()
    }

    /// Refuses rows with a column of the log, and rows of a series without a log.
    fn check_rows(&self, data: &[&Dataset]) -> Result<(), SettingsError> {
        for data in data.iter().filter(|data| !data.is_log) {
            let file = data.files.first().map_or(String::new(), |file| format!(" ({})", file.display()));
            if let Some(name) = self.columns().find(|name| data.numbers(name).is_some()) {
                let message = format!(
                    "the rows{file} have a column `{name}` of their own, and so has the log: which one counts?"
                );
                return Err(
                    SettingsError::new("thermal", message).help("take it out of the rows: the log gives it by time")
                );
            }
        }
        match &self.series {
            Some(series) => log::check_series(data, series, &self.logs),
            None => Ok(()),
        }
    }

    /// Another log in the place of that of the calibration.
    fn exchange(&mut self, log: BTreeMap<String, Vec<f64>>) -> Result<(), SettingsError> {
        match (&self.series, self.reference_degC) {
            (None, _) => self.references = self.counted_from()?,
            (Some(_), Some(reference)) => {
                self.references = self.columns().map(|name| (name.to_owned(), reference)).collect();
            }
            (Some(series), None) => {
                let message = format!("each {series} of the calibration counts from a reference of its own");
                return Err(SettingsError::new("reference_degC", message)
                    .help("gains hold for another log if all count from the same temperature: state it"));
            }
        }
        (self.reference_degC, self.reference_until_s) = (None, None);
        // What the states were when the measurement began is nothing that another log has.
        (self.starts_warm, self.starts_at_rest) = (false, true);
        (self.series, self.logs) = (None, BTreeMap::new());
        self.log = log;
        Ok(())
    }

    /// What each column counts from.
    fn counted_from(&self) -> Result<BTreeMap<String, f64>, SettingsError> {
        let Some(counted) = self.sensor_log()? else { return Ok(BTreeMap::new()) };
        let of = |name: &String| {
            let first = log::readings(&self.log, name)?.first()?;
            let elevation = counted.sensor(name).ok().and_then(|sensor| counted.values(sensor).first())?;
            Some((name.clone(), first - elevation))
        };
        Ok(counted.names().iter().filter_map(of).collect())
    }

    /// References by column: of all columns, or of none, and the only ones.
    pub(super) fn check_references(&self) -> Result<(), SettingsError> {
        if self.references.is_empty() {
            return Ok(());
        }
        if self.reference_degC.is_some() || self.reference_until_s.is_some() {
            return Err(SettingsError::new("references", "there is another reference already"));
        }
        if let Some(name) = self.columns().find(|name| !self.references.contains_key(*name)) {
            return Err(SettingsError::new("references", format!("the reference of {name} is missing")));
        }
        let wrong = |(name, value): &(&String, &f64)| !value.is_finite() || !self.columns().any(|own| own == *name);
        match self.references.iter().find(wrong) {
            Some((name, value)) if value.is_finite() => Err(SettingsError::new(name, "this line has no such column")
                .suggest(name, self.columns())
                .under([PathItem::Key("references".to_owned())])),
            Some((name, _)) => Err(SettingsError::new(name, "a finite number was expected")
                .under([PathItem::Key("references".to_owned())])),
            None => Ok(()),
        }
    }

    /// What looks like faults of its sensors of temperature, in words, and noise that makes gains small.
    pub fn faults(&self) -> Vec<String> {
        let Ok(logs) = self.sensor_logs() else { return Vec::new() };
        let mut faults = Vec::new();
        for (label, log) in logs {
            let of = match (&self.series, label) {
                (Some(series), Some(label)) => format!(" ({series} {label})"),
                _ => String::new(),
            };
            for (sensor, name) in log.names().iter().enumerate() {
                if self.quantity(name) == Quantity::Temperature {
                    faults.extend(log.faults(sensor).into_iter().map(|fault| fault + &of));
                    faults.extend(self.noise(&log, sensor).map(|noise| noise + &of));
                }
            }
        }
        faults
    }

    /// What the noise of a sensor does to gains, if that is more than a hundredth.
    fn noise(&self, log: &SensorLog, sensor: usize) -> Option<String> {
        let name = &log.names()[sensor];
        let shortest = self.time_constants_s.first().filter(|_| self.inputs.contains(name));
        let at_once = self.at_once.contains(name).then_some(0.0);
        let noise = log.noise(sensor, at_once.or(shortest.copied())?)?;
        (noise.share > TOLD).then(|| {
            format!(
                "{name} scatters by {:.2} K from row to row, and moves by {:.2} K (RMS): gains of what follows it come out too \
                 small by {:.0} % or more, and the covariance of the estimate does not count that; filter the log, or trust \
                 the prediction of runs that no estimate has seen",
                noise.scatter,
                noise.moves,
                100.0 * noise.share
            )
        })
    }

    /// Inputs, then what is followed at once.
    fn columns(&self) -> impl Iterator<Item = &str> {
        self.inputs.iter().chain(&self.at_once).map(String::as_str)
    }

    /// The log, counted from its reference; none before it is known, and where there is one for each series.
    ///
    /// Fails as [`settle`](Self::settle) does.
    pub fn sensor_log(&self) -> Result<Option<SensorLog>, SettingsError> {
        if self.log.is_empty() { Ok(None) } else { self.counted(&self.log).map(Some) }
    }

    /// The logs by the labels of their series; a single one has no label.
    ///
    /// Fails as [`settle`](Self::settle) does.
    pub fn sensor_logs(&self) -> Result<Vec<(Option<&str>, SensorLog)>, SettingsError> {
        log::each((&self.log, &self.logs), self.series.as_deref(), |log| self.counted(log))
    }

    fn counted(&self, log: &BTreeMap<String, Vec<f64>>) -> Result<SensorLog, SettingsError> {
        let reference = match (self.reference_degC, self.reference_until_s) {
            (Some(value), _) => Reference::Value(value),
            _ if !self.references.is_empty() => Reference::Value(0.0),
            (None, Some(until)) => Reference::MeanUntil(until),
            (None, None) => Reference::FirstRow,
        };
        let hold = if self.zero_order_hold { Hold::ZeroOrder } else { Hold::FirstOrder };
        log::sensor_log(&self.elevations(log), self.columns(), hold, self.longest_gap_s, reference)
    }

    /// Columns of a log, less their own references if they have them.
    fn elevations(&self, log: &BTreeMap<String, Vec<f64>>) -> BTreeMap<String, Vec<f64>> {
        let of = |(header, values): (&String, &Vec<f64>)| {
            let from = self.references.get(Quantity::of_column(header).0).copied().unwrap_or(0.0);
            (header.clone(), values.iter().map(|value| value - from).collect())
        };
        log.iter().map(of).collect()
    }

    /// The quantity of a column; temperature before the log is known.
    pub(super) fn quantity(&self, name: &str) -> Quantity {
        let headers = self.log.keys().chain(self.logs.values().flat_map(BTreeMap::keys));
        let of = headers.map(|header| Quantity::of_column(header));
        of.into_iter().find(|(own, ..)| *own == name).map_or(Quantity::Temperature, |(_, quantity, _)| quantity)
    }
}
