//! The log that thermal errors follow.

use std::collections::BTreeMap;

use abbe_core::{Dataset, PathItem, Quantity, SettingsError};
use abbe_thermal::{Counting, Hold, Reference, SensorLog};

use super::Thermal;

/// The column of times.
const TIME: &str = "time_s";

impl Thermal {
    /// Takes the log from the data set that has its columns. A log among the data takes the place of one that the settings keep: gains
    /// hold from the reference of the latter, and states begin at rest, because nobody knows what was before.
    ///
    /// Fails if no log, or more than one, has the columns, and for logs with gaps, clocks that jump, and sensors without a reading.
    pub fn settle(&mut self, data: &[&Dataset]) -> Result<(), SettingsError> {
        let logs: Vec<&Dataset> = data.iter().copied().filter(|data| data.is_log).collect();
        if self.log.is_empty() && !data.is_empty() {
            self.log = self.columns_of(self.own(&logs)?);
        } else if !self.log.is_empty() && !logs.is_empty() {
            let columns = self.columns_of(self.own(&logs)?);
            self.references = self.counted_from()?;
            (self.reference_degC, self.reference_until_s) = (None, None);
            // What the states were when the measurement began is nothing that another log has.
            (self.starts_warm, self.starts_at_rest) = (false, true);
            self.log = columns;
        }
        // What is wrong with it is told now, and not by the first row that needs it.
        self.sensor_log().map(drop)
    }

    /// The one log that has all columns.
    fn own<'a>(&self, logs: &[&'a Dataset]) -> Result<&'a Dataset, SettingsError> {
        let has = |data: &&&Dataset| {
            data.numbers("time").is_some() && self.columns().all(|name| data.numbers(name).is_some())
        };
        let mut fitting = logs.iter().filter(has);
        match (fitting.next(), fitting.next()) {
            (Some(found), None) => Ok(found),
            (Some(_), Some(_)) => Err(SettingsError::new("thermal", "more than one log has these columns")),
            (None, _) if logs.is_empty() => {
                let error = SettingsError::new("thermal", "the machine has no log of these columns");
                Err(error.help("name the ingest stage that reads it: `logs: sensors` at the machine"))
            }
            (None, _) => {
                let lacks = |name: &&str| !logs.iter().any(|log| log.numbers(name).is_some());
                let name = std::iter::once("time").chain(self.columns()).find(lacks).unwrap_or("time");
                Err(SettingsError::new("thermal", format!("the log has no column of numbers `{name}`")))
            }
        }
    }

    /// Times and own columns of a log, by their headers.
    fn columns_of(&self, log: &Dataset) -> BTreeMap<String, Vec<f64>> {
        let is_own = |name: &str| name == "time" || self.columns().any(|own| own == name);
        let columns = log.columns.iter().filter(|column| is_own(&column.header.name));
        let written = columns.filter_map(|column| {
            let (name, quantity) = (&column.header.name, column.header.quantity);
            Some((format!("{name}{}", quantity.usual_suffix()), log.numbers(name)?.to_vec()))
        });
        written.collect()
    }

    /// What each column counts from.
    fn counted_from(&self) -> Result<BTreeMap<String, f64>, SettingsError> {
        let Some(counted) = self.sensor_log()? else { return Ok(BTreeMap::new()) };
        let of = |name: &String| {
            let column = self.log.iter().find(|(header, _)| Quantity::of_column(header).0 == name);
            let first = column.and_then(|(_, values)| values.first())?;
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

    /// Inputs, then what is followed at once.
    pub(super) fn columns(&self) -> impl Iterator<Item = &str> {
        self.inputs.iter().chain(&self.at_once).map(String::as_str)
    }

    /// The log, counted from its reference; none before it is known.
    ///
    /// Fails as [`settle`](Self::settle) does.
    pub fn sensor_log(&self) -> Result<Option<SensorLog>, SettingsError> {
        if self.log.is_empty() {
            return Ok(None);
        }
        let wrong = |error: abbe_core::Error| {
            let told = SettingsError::new("log", error.message);
            match error.help {
                Some(help) => told.help(help),
                None => told,
            }
        };
        let times = self.log.get(TIME).cloned();
        let times = times.ok_or_else(|| SettingsError::new("log", format!("the column `{TIME}` is missing")))?;
        let mut sensors: Vec<(String, Vec<f64>)> = Vec::new();
        for name in self.columns() {
            let column = self.log.iter().find(|(header, _)| Quantity::of_column(header).0 == name);
            let Some((_, values)) = column else {
                return Err(SettingsError::new("log", format!("the column `{name}` is missing")));
            };
            let from = self.references.get(name).copied().unwrap_or(0.0);
            if !sensors.iter().any(|(known, _)| known == name) {
                sensors.push((name.to_owned(), values.iter().map(|value| value - from).collect()));
            }
        }
        let reference = match (self.reference_degC, self.reference_until_s) {
            (Some(value), _) => Reference::Value(value),
            _ if !self.references.is_empty() => Reference::Value(0.0),
            (None, Some(until)) => Reference::MeanUntil(until),
            (None, None) => Reference::FirstRow,
        };
        let hold = if self.zero_order_hold { Hold::ZeroOrder } else { Hold::FirstOrder };
        let how = Counting { hold, reference, longest_gap: self.longest_gap_s };
        SensorLog::counted(times, sensors, &how).map(Some).map_err(wrong)
    }

    /// The quantity of a column; temperature before the log is known.
    pub(super) fn quantity(&self, name: &str) -> Quantity {
        let of = self.log.keys().map(|header| Quantity::of_column(header));
        of.into_iter().find(|(own, ..)| *own == name).map_or(Quantity::Temperature, |(_, quantity, _)| quantity)
    }
}
