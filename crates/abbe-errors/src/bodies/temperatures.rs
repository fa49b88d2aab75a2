//! The temperatures of a body above its reference, from a log or from the measurements.

use abbe_core::{Quantity, SettingsError};
use abbe_thermal::{History, Hold, Reference, SensorLog};

use super::{Body, REFERENCE, Turning};
use crate::log::{self, Columns, SeriesLogs};

/// Where the reading of a sensor comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Source {
    /// A sensor of the log, by its index.
    Log(usize),
    /// A temperature of the pose, by its place among them.
    Row(usize),
}

/// A body's own elevation at the first row of the log, K, and how it goes on from there.
type Slow = (f64, History);

/// The temperatures of the sensors of a body.
#[derive(Debug)]
pub(super) struct Temperatures {
    /// Names of those that are temperatures of the pose.
    pub of_rows: Vec<String>,
    sources: Vec<Source>,
    /// Elevations by time.
    logs: SeriesLogs,
    /// For each log one for each sensor, if the body follows them slowly.
    slow: Vec<Vec<Slow>>,
    reference: f64,
}

impl Temperatures {
    /// Those of a body whose log is known; the series of its logs have these labels.
    pub fn new(body: &Body, labels: &[String]) -> Result<Self, SettingsError> {
        let (names, of_rows) = (body.sensors(), body.sensors_of_rows());
        let of_log: Vec<&str> = names.iter().copied().filter(|name| !of_rows.contains(name)).collect();
        let mut found = Self {
            of_rows: of_rows.iter().map(|name| (*name).to_owned()).collect(),
            sources: Vec::new(),
            logs: SeriesLogs::default(),
            slow: Vec::new(),
            reference: body.reference_degC.unwrap_or(REFERENCE),
        };
        let place = |list: &[&str], name: &str| list.iter().position(|other| *other == name);
        for name in &names {
            let in_log = place(&of_log, name).map(Source::Log);
            found.sources.extend(in_log.or(place(&of_rows, name).map(Source::Row)));
        }
        if of_log.is_empty() {
            return Ok(found);
        }
        let mut columns = of_log;
        columns.extend(body.turning.as_ref().map(|turning| turning.air.as_str()));
        for name in &columns {
            let is_one = |header: &String| Quantity::of_column(header) == (*name, Quantity::Temperature, 1.0);
            let is_there = body.columns().any(|header| Quantity::of_column(header).0 == *name);
            if is_there && !body.columns().any(is_one) {
                let message = format!("the column `{name}` of the log is no temperature: `{name}_degC` was expected");
                return Err(SettingsError::new("sections", message));
            }
        }
        let reference = body.reference_until_s.map_or(Reference::Value(found.reference), Reference::MeanUntil);
        let counted = |kept: &Columns| {
            let log = log::sensor_log(kept, columns.iter().copied(), Hold::FirstOrder, body.longest_gap_s, reference)?;
            match &body.turning {
                Some(turning) => turned(body, turning, (kept, &log)),
                None => Ok((log, Vec::new())),
            }
        };
        let (mut logs, mut slow) = (Vec::new(), Vec::new());
        for (label, (log, of_log)) in log::each((&body.log, &body.logs), body.series.as_deref(), counted)? {
            logs.push((label, log));
            slow.push(of_log);
        }
        (found.logs, found.slow) = (SeriesLogs::new(body.series.as_ref(), logs, labels), slow);
        Ok(found)
    }

    /// Whether they are found by time.
    pub fn by_time(&self) -> bool {
        !self.logs.logs.is_empty()
    }

    /// The column of labels by which the log of a pose is found; none for a single log.
    pub fn series(&self) -> Option<&String> {
        self.logs.series.as_ref()
    }

    /// Elevations of all sensors, K; none where one is not known. `label` is the index of that of the series.
    pub fn at(&self, time: Option<f64>, label: Option<f64>, of_rows: &[f64]) -> Option<Vec<f64>> {
        let found = time.and_then(|time| Some((time, self.logs.of(time, label)?)));
        let of = |source: &Source| match (*source, found) {
            (Source::Row(place), _) => of_rows.get(place).map(|value| value - self.reference),
            (Source::Log(sensor), Some((time, place))) => {
                let log = &self.logs.logs[place].log;
                match self.slow[place].get(sensor) {
                    Some((first, history)) => history.at(log, time).ok().map(|[state, _]| first + state),
                    None => log.at(sensor, time).ok(),
                }
            }
            (Source::Log(_), None) => None,
        };
        self.sources.iter().map(|source| of(source).filter(|value| !value.is_nan())).collect()
    }

    /// Which sensors are this temperature of the pose: 1, and 0 for all others.
    pub fn slope(&self, place: usize) -> Vec<f64> {
        self.sources.iter().map(|source| f64::from(u8::from(*source == Source::Row(place)))).collect()
    }

    /// Why there are none at this time.
    pub fn refused(&self, time: f64, label: Option<f64>) -> Option<String> {
        self.logs.refused(time, label)
    }
}

/// What a body that turns tends to, above its first value, and how it follows.
fn turned(
    body: &Body,
    turning: &Turning,
    (kept, log): (&Columns, &SensorLog),
) -> Result<(SensorLog, Vec<Slow>), SettingsError> {
    let lacks = || SettingsError::new("turning", format!("the log has no column of numbers `{}`", turning.speed));
    let speeds = log::readings(kept, &turning.speed).ok_or_else(lacks)?;
    let wrong = |error: abbe_core::Error| SettingsError::new("turning", error.message);
    if speeds.len() != log.times().len() || speeds.iter().any(|speed| !speed.is_finite()) {
        return Err(SettingsError::new("turning", format!("a speed in every row of `{}` was expected", turning.speed)));
    }
    let air = log.values(log.sensor(&turning.air).map_err(wrong)?);
    let (mut firsts, mut tends) = (Vec::new(), Vec::new());
    for name in body.sensors() {
        let warm = log.values(log.sensor(name).map_err(wrong)?);
        let each = warm.iter().zip(air).zip(speeds);
        let values: Vec<f64> = each.map(|((warm, air), &speed)| air + turning.share_at(speed) * (warm - air)).collect();
        let first = values[0];
        tends.push((name.to_owned(), values.iter().map(|value| value - first).collect()));
        firsts.push(first);
    }
    let tends = SensorLog::new(log.times().to_vec(), tends, Hold::FirstOrder, None).map_err(wrong)?;
    let history = |(sensor, first)| (first, History::new(&tends, sensor, turning.time_constant_s));
    let slow = firsts.into_iter().enumerate().map(history).collect();
    Ok((tends, slow))
}
