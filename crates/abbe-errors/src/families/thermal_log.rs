//! The log that thermal errors follow.

use std::collections::BTreeMap;

use abbe_core::{Dataset, PathItem, Quantity, SettingsError};
use abbe_thermal::{Hold, Reference, SensorLog};

use super::Thermal;
use crate::log::{self, key};

impl Thermal {
    /// Takes the log from the data set that has its columns. A log among the data takes the place of one that the settings keep: gains
    /// hold from the reference of the latter, and states begin at rest, because nobody knows what was before.
    ///
    /// Fails if no log, or more than one, has the columns, and for logs with gaps, clocks that jump, and sensors without a reading.
    pub fn settle(&mut self, data: &[&Dataset]) -> Result<(), SettingsError> {
        let columns: Vec<String> = self.columns().map(str::to_owned).collect();
        let columns: Vec<&str> = columns.iter().map(String::as_str).collect();
        let has_log = data.iter().any(|data| data.is_log);
        if self.log.is_empty() || has_log {
            let found = log::with_columns(data, &columns).map_err(|error| error.under([key("thermal")]))?;
            match (found, self.log.is_empty()) {
                (Some(found), true) => self.log = log::kept(found, &columns),
                (Some(found), false) => self.exchange(log::kept(found, &columns))?,
                (None, true) => return Ok(()),
                (None, false) => {}
            }
        }
        for data in data.iter().filter(|data| !data.is_log) {
            if let Some(name) = self.columns().find(|name| data.numbers(name).is_some()) {
                let file = data.files.first().map_or(String::new(), |file| format!(" ({})", file.display()));
                let message = format!(
                    "the rows{file} have a column `{name}` of their own, and so has the log: which one counts?"
                );
                return Err(
                    SettingsError::new("thermal", message).help("take it out of the rows: the log gives it by time")
                );
            }
        }
        // What is wrong with it is told now, and not by the first row that needs it.
        self.sensor_log().map(drop)
    }

    /// Another log in the place of that of the calibration.
    fn exchange(&mut self, log: BTreeMap<String, Vec<f64>>) -> Result<(), SettingsError> {
        self.references = self.counted_from()?;
        (self.reference_degC, self.reference_until_s) = (None, None);
        // What the states were when the measurement began is nothing that another log has.
        (self.starts_warm, self.starts_at_rest) = (false, true);
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

    /// What looks like faults of its sensors of temperature, in words.
    pub fn faults(&self) -> Vec<String> {
        let Ok(Some(log)) = self.sensor_log() else { return Vec::new() };
        let is_temperature = |sensor: &usize| self.quantity(&log.names()[*sensor]) == Quantity::Temperature;
        (0..log.names().len()).filter(is_temperature).flat_map(|sensor| log.faults(sensor)).collect()
    }

    /// Inputs, then what is followed at once.
    fn columns(&self) -> impl Iterator<Item = &str> {
        self.inputs.iter().chain(&self.at_once).map(String::as_str)
    }

    /// The log, counted from its reference; none before it is known.
    ///
    /// Fails as [`settle`](Self::settle) does.
    pub fn sensor_log(&self) -> Result<Option<SensorLog>, SettingsError> {
        if self.log.is_empty() {
            return Ok(None);
        }
        let reference = match (self.reference_degC, self.reference_until_s) {
            (Some(value), _) => Reference::Value(value),
            _ if !self.references.is_empty() => Reference::Value(0.0),
            (None, Some(until)) => Reference::MeanUntil(until),
            (None, None) => Reference::FirstRow,
        };
        let hold = if self.zero_order_hold { Hold::ZeroOrder } else { Hold::FirstOrder };
        log::sensor_log(&self.elevations(), self.columns(), hold, self.longest_gap_s, reference).map(Some)
    }

    /// Columns of the log, less their own references if they have them.
    fn elevations(&self) -> BTreeMap<String, Vec<f64>> {
        let of = |(header, values): (&String, &Vec<f64>)| {
            let from = self.references.get(Quantity::of_column(header).0).copied().unwrap_or(0.0);
            (header.clone(), values.iter().map(|value| value - from).collect())
        };
        self.log.iter().map(of).collect()
    }

    /// The quantity of a column; temperature before the log is known.
    pub(super) fn quantity(&self, name: &str) -> Quantity {
        let of = self.log.keys().map(|header| Quantity::of_column(header));
        of.into_iter().find(|(own, ..)| *own == name).map_or(Quantity::Temperature, |(_, quantity, _)| quantity)
    }
}
