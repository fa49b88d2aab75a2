//! What sensors of temperature record: the temperature with their noise, their offset and their resolution.

use std::collections::BTreeMap;

use abbe_core::{Dataset, Error, Quantity, Result, SettingsError, Values, from_settings, not_negative};
use abbe_numerics::Generator;
use serde::Deserialize;
use serde_json::{Map, Value};

use crate::truth::{key, known_only};

/// How sensors of temperature differ from the temperature that the machine follows.
#[derive(Debug, Clone, PartialEq, Default)]
#[allow(non_snake_case, reason = "units are written as in column names")]
pub struct Sensors {
    /// Standard deviation of each reading, K; independent from row to row.
    pub sigma_K: BySensor,
    /// Standard deviation of the offset of a sensor, K, which it has in all rows and files.
    pub offset_sigma_K: BySensor,
    /// Step of readings, K; 0 if they have none.
    pub resolution_K: f64,
}

/// A size in K.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(untagged, expecting = "a number, or a map of sensors and numbers, was expected")]
pub enum BySensor {
    /// The same for all sensors.
    All(f64),
    /// By sensor, the name of its column without the unit; zero for those that are not named.
    Named(BTreeMap<String, f64>),
}

impl Default for BySensor {
    fn default() -> Self {
        Self::All(0.0)
    }
}

impl BySensor {
    fn of(&self, sensor: &str) -> f64 {
        match self {
            Self::All(size) => *size,
            Self::Named(sizes) => sizes.get(sensor).copied().unwrap_or(0.0),
        }
    }

    fn named(&self) -> impl Iterator<Item = &String> {
        match self {
            Self::All(_) => None,
            Self::Named(sizes) => Some(sizes.keys()),
        }
        .into_iter()
        .flatten()
    }

    fn check(&self, name: &str) -> Result<(), SettingsError> {
        match self {
            Self::All(value) => size(name, *value),
            Self::Named(values) => {
                let mut values = values.iter();
                values.try_for_each(|(sensor, value)| size(sensor, *value).map_err(|error| error.under([key(name)])))
            }
        }
    }

    fn is_zero(&self) -> bool {
        match self {
            Self::All(value) => *value == 0.0,
            Self::Named(values) => values.values().all(|value| *value == 0.0),
        }
    }

    fn summary(&self, what: &str) -> Vec<String> {
        match self {
            Self::All(0.0) => Vec::new(),
            Self::All(size) => vec![format!("sensors: {what} {size} K")],
            Self::Named(sizes) => sizes.iter().map(|(sensor, size)| format!("{sensor}: {what} {size} K")).collect(),
        }
    }
}

/// `sensors` as it stands in a truth file.
#[derive(Deserialize)]
#[allow(non_snake_case, reason = "units are written as in column names")]
struct Written {
    sigma_K: Option<BySensor>,
    offset_sigma_K: Option<BySensor>,
    resolution_K: Option<f64>,
}

const KEYS: [&str; 3] = ["sigma_K", "offset_sigma_K", "resolution_K"];

/// A column of a data set, and what is recorded there instead of the temperature, °C.
pub type Recorded = (String, Vec<f64>);

impl Sensors {
    /// Reads `sensors` of the noise of a truth file.
    pub(crate) fn from_json(sensors: &Map<String, Value>) -> Result<Self, SettingsError> {
        let written: Written = from_settings(&known_only("noise.sensors", sensors, &KEYS, &[]))?;
        Ok(Self {
            sigma_K: written.sigma_K.unwrap_or_default(),
            offset_sigma_K: written.offset_sigma_K.unwrap_or_default(),
            resolution_K: written.resolution_K.unwrap_or(0.0),
        })
    }

    /// Refuses values that are not finite, and negative ones.
    pub(crate) fn check(&self) -> Result<(), SettingsError> {
        self.sigma_K.check("sigma_K")?;
        self.offset_sigma_K.check("offset_sigma_K")?;
        size("resolution_K", self.resolution_K)
    }

    /// Whether sensors record the temperature itself.
    pub fn are_exact(&self) -> bool {
        self.sigma_K.is_zero() && self.offset_sigma_K.is_zero() && self.resolution_K == 0.0
    }

    /// Refuses sensors that no data have.
    pub fn known<'a>(&self, data: impl IntoIterator<Item = &'a Dataset>) -> Result<()> {
        let columns = data.into_iter().flat_map(|data| &data.columns).filter(|column| is_temperature(column));
        let columns: Vec<&str> = columns.map(|column| column.header.name.as_str()).collect();
        let mut named = self.sigma_K.named().chain(self.offset_sigma_K.named());
        match named.find(|name| !columns.contains(&name.as_str())) {
            None => Ok(()),
            Some(name) => Err(Error::usage(format!("noise.sensors: no data have the temperature `{name}`"))
                .suggest(name, columns.iter().copied())),
        }
    }

    /// What the sensors of a data set record. It depends on the seed, the sensor, and the file and line of the row alone.
    pub fn recorded(&self, data: &Dataset, seed: u64) -> Vec<Recorded> {
        let of_column = |column: &abbe_core::Column| {
            let Values::Numbers(values) = &column.values else { return None };
            let sensor = column.header.name.as_str();
            let offset = self.offset_sigma_K.of(sensor) * normal(seed, &[sensor.as_bytes()]);
            let sigma = self.sigma_K.of(sensor);
            let of_row = |(value, origin): (&f64, &abbe_core::RowOrigin)| {
                let file = data.files.get(origin.file).and_then(|file| file.file_name()).unwrap_or_default();
                let place = [sensor.as_bytes(), file.as_encoded_bytes(), &origin.line.to_le_bytes()];
                let read = value + offset + if sigma > 0.0 { sigma * normal(seed, &place) } else { 0.0 };
                if self.resolution_K > 0.0 { (read / self.resolution_K).round() * self.resolution_K } else { read }
            };
            Some((column.header.header.clone(), values.iter().zip(&data.origins).map(of_row).collect()))
        };
        data.columns.iter().filter(|column| is_temperature(column)).filter_map(of_column).collect()
    }

    /// The deviations, as lines of the summary.
    pub(crate) fn summary(&self) -> Vec<String> {
        let mut lines = self.sigma_K.summary("standard deviation");
        lines.extend(self.offset_sigma_K.summary("standard deviation of the offset"));
        if self.resolution_K > 0.0 {
            lines.push(format!("sensors: resolution {} K", self.resolution_K));
        }
        lines
    }
}

/// Nothing of a sensor is larger, K.
const LARGEST: f64 = 100.0;

fn size(setting: &str, value: f64) -> Result<(), SettingsError> {
    not_negative(setting, value)?;
    match value <= LARGEST {
        true => Ok(()),
        false => Err(SettingsError::new(setting, format!("at most {LARGEST} K were expected"))),
    }
}

fn is_temperature(column: &abbe_core::Column) -> bool {
    column.header.quantity == Quantity::Temperature
}

/// A normal number that belongs to a place.
fn normal(seed: u64, place: &[&[u8]]) -> f64 {
    // FNV-1a, with a mark between the parts.
    let mut stream = 0xcbf2_9ce4_8422_2325_u64;
    for part in place {
        for byte in part.iter().chain(&[0xff]) {
            stream = (stream ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }
    Generator::new(seed, stream).normal()
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use abbe_core::{Column, ColumnHeader, RowOrigin};
    use serde_json::json;

    use super::*;

    fn log(rows: usize) -> Dataset {
        let column = |header: &str, of: &dyn Fn(usize) -> f64| Column {
            header: ColumnHeader::parse(header),
            values: Values::Numbers((0..rows).map(of).collect()),
        };
        Dataset {
            columns: vec![
                column("time_s", &|row| 60.0 * row as f64),
                column("T1_degC", &|row| 20.0 + 1e-3 * row as f64),
                column("T2_degC", &|_| 21.0),
                column("n_rpm", &|_| 3000.0),
            ],
            origins: (0..rows).map(|row| RowOrigin { file: 0, line: row + 2, row: row + 1 }).collect(),
            files: vec![PathBuf::from("log.csv")],
            ..Dataset::default()
        }
    }

    fn sensors(settings: Value) -> Sensors {
        let sensors = Sensors::from_json(settings.as_object().expect("a map")).expect("settings");
        sensors.check().expect("valid");
        sensors
    }

    #[test]
    fn readings_scatter_as_stated() {
        let (rows, log) = (20_000, log(20_000));
        let of = sensors(json!({ "sigma_K": { "T1": 0.2 }, "offset_sigma_K": 0.5 }));
        let recorded = of.recorded(&log, 7);
        assert_eq!(recorded.iter().map(|(header, _)| header.as_str()).collect::<Vec<_>>(), ["T1_degC", "T2_degC"]);
        let off = |column: usize, name: &str| -> Vec<f64> {
            let truth = log.numbers(name).expect("numbers");
            recorded[column].1.iter().zip(truth).map(|(read, truth)| read - truth).collect()
        };
        let (one, other) = (off(0, "T1"), off(1, "T2"));
        let mean = one.iter().sum::<f64>() / rows as f64;
        let sigma = (one.iter().map(|off| (off - mean).powi(2)).sum::<f64>() / rows as f64).sqrt();
        assert!((sigma / 0.2 - 1.0).abs() < 0.02, "{sigma}");
        // Without noise the offset alone is left, and each sensor has its own.
        assert!(other.iter().all(|off| (off - other[0]).abs() < 1e-12) && (mean - other[0]).abs() > 0.02);
        assert_eq!(recorded, of.recorded(&log, 7));
        assert_ne!(recorded, of.recorded(&log, 8));
        let offsets: Vec<f64> = (0..2000).map(|seed| of.recorded(&self::log(1), seed)[1].1[0] - 21.0).collect();
        let sigma = (offsets.iter().map(|offset| offset * offset).sum::<f64>() / 2000.0).sqrt();
        assert!((sigma / 0.5 - 1.0).abs() < 0.06, "{sigma}");
    }

    #[test]
    fn readings_have_their_resolution() {
        let of = sensors(json!({ "resolution_K": 0.0625 }));
        assert!(!of.are_exact() && sensors(json!({ "sigma_K": 0 })).are_exact());
        for (_, readings) in of.recorded(&log(50), 1) {
            assert!(readings.iter().all(|reading| (reading * 16.0).fract() == 0.0), "{readings:?}");
        }
    }

    #[test]
    fn wrong_settings_are_named() {
        let refused = |settings: Value| -> String {
            let sensors = Sensors::from_json(settings.as_object().expect("a map"));
            sensors.and_then(|sensors| sensors.check()).expect_err("it is refused").to_string()
        };
        assert!(refused(json!({ "sigma_K": -0.1 })).starts_with("sigma_K: "));
        assert!(refused(json!({ "offset_sigma_K": { "T1": -1 } })).starts_with("offset_sigma_K.T1: "));
        assert!(refused(json!({ "sigma_K": "much" })).contains("a number, or a map of sensors"));
        let unknown = sensors(json!({ "sigma_K": { "T3": 0.1 } })).known([&log(2)]).expect_err("unknown");
        assert!(unknown.to_string().contains("no data have the temperature `T3`"), "{unknown}");
    }
}
