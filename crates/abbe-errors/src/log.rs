//! Columns of a log that errors follow: found among the data sets, kept by a calibration, and counted from a reference.

use std::collections::{BTreeMap, BTreeSet};

use abbe_core::{Dataset, LabelText, PathItem, Quantity, SettingsError, Values};
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

/// Columns of a log by their names with units, as a calibration keeps them.
pub(crate) type Columns = BTreeMap<String, Vec<f64>>;

/// The log of a series, or the only one.
#[derive(Debug)]
pub(crate) struct SeriesLog {
    /// The label of the series, and its index among all; none for a single log.
    pub label: Option<String>,
    pub place: Option<usize>,
    pub log: SensorLog,
}

/// The logs of a machine by the labels of their series.
#[derive(Debug, Default)]
pub(crate) struct SeriesLogs {
    /// The column of labels; none for a single log.
    pub series: Option<String>,
    /// None before they are known.
    pub logs: Vec<SeriesLog>,
}

impl SeriesLogs {
    /// Counted logs with the labels of their series, which have these indices.
    pub fn new(series: Option<&String>, logs: Vec<(Option<&str>, SensorLog)>, labels: &[String]) -> Self {
        let place = |label: Option<&str>| labels.iter().position(|own| Some(own.as_str()) == label);
        let of = |(label, log): (Option<&str>, SensorLog)| SeriesLog {
            label: label.map(str::to_owned),
            place: place(label),
            log,
        };
        Self { series: series.cloned(), logs: logs.into_iter().map(of).collect() }
    }

    /// The log of a pose, by its index; none where its time is not known, or where its series has none. `label` is the index of the
    /// label of the pose.
    pub fn of(&self, time: f64, label: Option<f64>) -> Option<usize> {
        if time.is_nan() {
            return None;
        }
        match self.series {
            None => (!self.logs.is_empty()).then_some(0),
            Some(_) => (self.logs.iter()).position(|own| own.place.is_some_and(|place| Some(place as f64) == label)),
        }
    }

    /// Why a pose has no readings, in words.
    pub fn refused(&self, time: f64, label: Option<f64>) -> Option<String> {
        let Some(found) = self.of(time, label) else {
            // Without a series a pose is on no clock.
            let on_no_clock = !time.is_nan() && !self.logs.is_empty();
            return on_no_clock.then(|| {
                format!("a pose with a time belongs to no `{}` with a log", self.series.as_deref().unwrap_or_default())
            });
        };
        let times = self.logs[found].log.times();
        let (first, last) = (times[0], times[times.len() - 1]);
        (!(first..=last).contains(&time)).then(|| {
            format!("the time {time} s is outside the log of temperatures, which goes from {first} s to {last} s")
        })
    }
}

/// Something of each log that is kept, of the single one or by the labels of a series.
///
/// Fails as `of` does, and says of which series.
pub(crate) fn each<'a, T>(
    (log, logs): (&'a Columns, &'a BTreeMap<String, Columns>),
    series: Option<&str>,
    of: impl Fn(&Columns) -> Result<T, SettingsError>,
) -> Result<Vec<(Option<&'a str>, T)>, SettingsError> {
    if !log.is_empty() {
        return Ok(vec![(None, of(log)?)]);
    }
    let of_label = |(label, log): (&'a String, &Columns)| {
        let found = of(log).map_err(|error| {
            let message = format!("{} {label}: {}", series.unwrap_or_default(), error.message);
            SettingsError { message, ..error }
        });
        Ok((Some(label.as_str()), found?))
    };
    logs.iter().map(of_label).collect()
}

/// Refuses rows of a series without a log.
pub(crate) fn check_series(
    data: &[&Dataset],
    series: &str,
    logs: &BTreeMap<String, Columns>,
) -> Result<(), SettingsError> {
    for data in data.iter().filter(|data| !data.is_log) {
        let file = data.files.first().map_or(String::new(), |file| format!(" ({})", file.display()));
        let Some(labels) = data.labels(series) else {
            let message = format!("the rows{file} have no column of labels `{series}`, by which their log is found");
            return Err(SettingsError::new("series", message));
        };
        if let Some(label) = labels.iter().find(|label| !logs.contains_key(label.as_str())) {
            let message = format!("no log has rows with {series} {label}, and the rows{file} have some");
            return Err(SettingsError::new("series", message).suggest(label, logs.keys().map(String::as_str)));
        }
    }
    Ok(())
}

/// Refuses a column of a series that is no column of labels.
pub(crate) fn check_label(series: Option<&String>) -> Result<(), SettingsError> {
    match series.filter(|series| Quantity::of_column(series).1 != Quantity::Label) {
        None => Ok(()),
        Some(series) => {
            Err(SettingsError::new("series", format!("`{series}` is a column of numbers; labels were expected")))
        }
    }
}

/// Times and columns of a log, by their names with units.
pub(crate) fn kept(log: &Dataset, columns: &[&str]) -> Columns {
    let wanted = log.columns.iter().filter_map(|column| {
        let name = column.header.name.as_str();
        // The column itself is at hand: to look it up by its name takes time with the square of the columns.
        match &column.values {
            Values::Numbers(values) if name == "time" || columns.contains(&name) => {
                Some((format!("{name}{}", column.header.quantity.usual_suffix()), values.clone()))
            }
            _ => None,
        }
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
) -> Result<BTreeMap<String, Columns>, SettingsError> {
    let mut found: BTreeMap<String, Columns> = BTreeMap::new();
    let fits = |log: &&&Dataset| {
        log.is_log && log.labels(series).is_some() && columns.iter().all(|name| log.numbers(name).is_some())
    };
    for log in data.iter().filter(fits) {
        let Some(labels) = log.labels(series) else { continue };
        let all = kept(log, columns);
        let own: BTreeSet<&LabelText> = labels.iter().collect();
        for label in own {
            let of_label = |values: &Vec<f64>| {
                values.iter().zip(labels).filter(|(_, own)| *own == label).map(|(value, _)| *value).collect()
            };
            let part = all.iter().map(|(header, values)| (header.clone(), of_label(values))).collect();
            if found.insert(label.to_string(), part).is_some() {
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
pub(crate) fn readings<'a>(kept: &'a Columns, name: &str) -> Option<&'a [f64]> {
    let column = kept.iter().find(|(header, _)| Quantity::of_column(header).0 == name);
    column.map(|(_, values)| values.as_slice())
}

/// The log of some columns, counted from its reference.
///
/// Fails without one of the columns, for gaps, clocks that jump, readings that are missing, and sensors that read the same all the
/// time.
pub(crate) fn sensor_log<'a>(
    kept: &Columns,
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
