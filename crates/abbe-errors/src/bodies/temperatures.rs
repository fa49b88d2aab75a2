//! The temperatures of a body above its reference, from a log or from the measurements.

use abbe_core::{Quantity, SettingsError};
use abbe_thermal::{History, Hold, Reference, SensorLog};

use super::{Body, REFERENCE, Turning};
use crate::log;

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
    log: Option<SensorLog>,
    /// One for each sensor, if the body follows them slowly.
    slow: Vec<Slow>,
    reference: f64,
}

impl Temperatures {
    pub fn new(body: &Body) -> Result<Self, SettingsError> {
        let (names, of_rows) = (body.sensors(), body.sensors_of_rows());
        let of_log: Vec<&str> = names.iter().copied().filter(|name| !of_rows.contains(name)).collect();
        let mut found = Self {
            of_rows: of_rows.iter().map(|name| (*name).to_owned()).collect(),
            sources: Vec::new(),
            log: None,
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
            if log::readings(&body.log, name).is_some() && !body.log.keys().any(is_one) {
                let message = format!("the column `{name}` of the log is no temperature: `{name}_degC` was expected");
                return Err(SettingsError::new("sections", message));
            }
        }
        let reference = body.reference_until_s.map_or(Reference::Value(found.reference), Reference::MeanUntil);
        let log = log::sensor_log(&body.log, columns.iter().copied(), Hold::FirstOrder, body.longest_gap_s, reference)?;
        match &body.turning {
            Some(turning) => {
                let (tends, slow) = turned(body, turning, &log)?;
                (found.log, found.slow) = (Some(tends), slow);
            }
            None => found.log = Some(log),
        }
        Ok(found)
    }

    /// Whether they are found by time.
    pub fn by_time(&self) -> bool {
        self.log.is_some()
    }

    /// Elevations of all sensors, K; none where one is not known.
    pub fn at(&self, time: Option<f64>, of_rows: &[f64]) -> Option<Vec<f64>> {
        let of = |source: &Source| match (*source, &self.log, time) {
            (Source::Row(place), ..) => of_rows.get(place).map(|value| value - self.reference),
            (Source::Log(sensor), Some(log), Some(time)) => match self.slow.get(sensor) {
                Some((first, history)) => history.at(log, time).ok().map(|[state, _]| first + state),
                None => log.at(sensor, time).ok(),
            },
            (Source::Log(_), ..) => None,
        };
        self.sources.iter().map(|source| of(source).filter(|value| !value.is_nan())).collect()
    }

    /// Which sensors are this temperature of the pose: 1, and 0 for all others.
    pub fn slope(&self, place: usize) -> Vec<f64> {
        self.sources.iter().map(|source| f64::from(u8::from(*source == Source::Row(place)))).collect()
    }

    /// Why there are none at this time.
    pub fn refused(&self, time: f64) -> Option<String> {
        let log = self.log.as_ref().filter(|_| !time.is_nan())?;
        let (first, last) = (log.times()[0], log.times()[log.times().len() - 1]);
        (!(first..=last).contains(&time)).then(|| {
            format!("the time {time} s is outside the log of temperatures, which goes from {first} s to {last} s")
        })
    }
}

/// What a body that turns tends to, above its first value, and how it follows.
fn turned(body: &Body, turning: &Turning, log: &SensorLog) -> Result<(SensorLog, Vec<Slow>), SettingsError> {
    let lacks = || SettingsError::new("turning", format!("the log has no column of numbers `{}`", turning.speed));
    let speeds = log::readings(&body.log, &turning.speed).ok_or_else(lacks)?;
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
