//! Columns of a log that errors follow: found among the data sets, kept by a calibration, and counted from a reference.

use std::collections::{BTreeMap, BTreeSet};

use abbe_core::{Dataset, PathItem, Quantity, SettingsError};
use abbe_thermal::{Counting, Hold, Reference, SensorLog};

/// The column of times.
const TIME: &str = "time_s";

pub(crate) fn key(name: &str) -> PathItem {
    PathItem::Key(name.to_owned())
}

/// The one log with these columns; none if there are no data yet.
///
/// Fails if no log, or more than one, has them.
pub(crate) fn with_columns<'a>(data: &[&'a Dataset], columns: &[&str]) -> Result<Option<&'a Dataset>, SettingsError> {
    let logs: Vec<&'a Dataset> = data.iter().copied().filter(|data| data.is_log).collect();
    let has_all =
        |log: &&Dataset| log.numbers("time").is_some() && columns.iter().all(|name| log.numbers(name).is_some());
    let mut fitting = logs.iter().copied().filter(has_all);
    match (fitting.next(), fitting.next()) {
        (None, _) if data.is_empty() => Ok(None),
        (Some(found), None) => Ok(Some(found)),
        (Some(_), Some(_)) => Err(SettingsError::new("", "more than one log has these columns")),
        (None, _) if logs.is_empty() => Err(SettingsError::new("", "the machine has no log of these columns")
            .help("name the ingest stage that reads it: `logs: sensors` at the machine")),
        (None, _) => {
            let lacks = |name: &&str| !logs.iter().any(|log| log.numbers(name).is_some());
            let name = std::iter::once("time").chain(columns.iter().copied()).find(lacks);
            Err(SettingsError::new(
                "",
                match name {
                    Some(name) => format!("the log has no column of numbers `{name}`"),
                    None => "no log has all of these columns".to_owned(),
                },
            ))
        }
    }
}

/// Times and columns of a log, by their names with units.
pub(crate) fn kept(log: &Dataset, columns: &[&str]) -> BTreeMap<String, Vec<f64>> {
    let wanted = log.columns.iter().filter_map(|column| {
        let name = column.header.name.as_str();
        let values = log.numbers(name).filter(|_| name == "time" || columns.contains(&name))?;
        Some((format!("{name}{}", column.header.quantity.usual_suffix()), values.to_vec()))
    });
    wanted.collect()
}

/// Logs with these columns by the labels of a series, from all data sets that have both; none if there are no data yet. Rows of a series
/// keep their order.
///
/// Fails if no log has the columns, and for a label in more than one data set.
pub(crate) fn by_series(
    data: &[&Dataset],
    columns: &[&str],
    series: &str,
) -> Result<BTreeMap<String, BTreeMap<String, Vec<f64>>>, SettingsError> {
    let mut found: BTreeMap<String, BTreeMap<String, Vec<f64>>> = BTreeMap::new();
    let fits = |log: &&&Dataset| {
        log.is_log && log.labels(series).is_some() && columns.iter().all(|name| log.numbers(name).is_some())
    };
    for log in data.iter().filter(fits) {
        let Some(labels) = log.labels(series) else { continue };
        let all = kept(log, columns);
        let own: BTreeSet<&String> = labels.iter().collect();
        for label in own {
            let of_label = |values: &Vec<f64>| {
                values.iter().zip(labels).filter(|(_, own)| *own == label).map(|(value, _)| *value).collect()
            };
            let part = all.iter().map(|(header, values)| (header.clone(), of_label(values))).collect();
            if found.insert(label.clone(), part).is_some() {
                let message = format!("two logs have rows with {series} {label}");
                return Err(SettingsError::new("series", message));
            }
        }
    }
    if !found.is_empty() || data.is_empty() {
        return Ok(found);
    }
    // What is wrong with it, if it is not the column of labels alone.
    with_columns(data, columns)?;
    Err(SettingsError::new("series", format!("the log has no column of labels `{series}`")))
}

/// The readings of a column that was kept, by its name without unit.
pub(crate) fn readings<'a>(kept: &'a BTreeMap<String, Vec<f64>>, name: &str) -> Option<&'a [f64]> {
    let column = kept.iter().find(|(header, _)| Quantity::of_column(header).0 == name);
    column.map(|(_, values)| values.as_slice())
}

/// The log of some columns, counted from its reference.
///
/// Fails without one of the columns, for gaps, clocks that jump, readings that are missing, and sensors that read the same all the
/// time.
pub(crate) fn sensor_log<'a>(
    kept: &BTreeMap<String, Vec<f64>>,
    columns: impl Iterator<Item = &'a str>,
    hold: Hold,
    longest_gap: Option<f64>,
    reference: Reference,
) -> Result<SensorLog, SettingsError> {
    let wrong = |error: abbe_core::Error| {
        let told = SettingsError::new("log", error.message);
        match error.help {
            Some(help) => told.help(help),
            None => told,
        }
    };
    let missing = |name: &str| SettingsError::new("log", format!("the column `{name}` is missing"));
    let times = kept.get(TIME).cloned().ok_or_else(|| missing(TIME))?;
    let mut sensors: Vec<(String, Vec<f64>)> = Vec::new();
    for name in columns {
        let values = readings(kept, name).ok_or_else(|| missing(name))?;
        if !sensors.iter().any(|(known, _)| known == name) {
            sensors.push((name.to_owned(), values.to_vec()));
        }
    }
    SensorLog::counted(times, sensors, &Counting { hold, reference, longest_gap }).map_err(wrong)
}
