//! Settings that are increasing numbers: knots, positions of axes.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::settings::{PathItem, SettingsError};

/// Increasing numbers, one by one or at equal distances.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum Series {
    /// One by one, increasing.
    Listed(Vec<f64>),
    /// At equal distances.
    Even(EvenSeries),
}

/// Numbers at equal distances.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EvenSeries {
    /// The first number.
    pub from: f64,
    /// The last number.
    pub to: f64,
    /// Distance from each number to the next.
    pub step: f64,
}

impl<'de> Deserialize<'de> for Series {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        // The two forms are distinguished here, because an untagged enum could not say what is wrong in them.
        match serde_json::Value::deserialize(deserializer)? {
            map @ serde_json::Value::Object(_) => crate::from_settings(&map).map(Self::Even),
            list => crate::from_settings(&list).map(Self::Listed),
        }
        .map_err(serde::de::Error::custom)
    }
}

/// Most intervals. More are probably a mistake, such as a step in the wrong unit.
const MOST: f64 = 1000.0;

impl Series {
    /// The numbers; fails unless they are finite and increase.
    pub fn values(&self) -> Result<Vec<f64>, SettingsError> {
        let values = match self {
            Self::Listed(values) => values.clone(),
            Self::Even(even) => even.values()?,
        };
        if values.first().is_some_and(|first| !first.is_finite()) {
            return Err(SettingsError::new("", "finite numbers were expected")
                .help("list them: [0, 50, 100]")
                .under([PathItem::Index(0)]));
        }
        match values.windows(2).position(|pair| !(pair[0] < pair[1] && pair[1].is_finite())) {
            None => Ok(values),
            Some(index) => {
                Err(SettingsError::new("", format!("these have to increase; {} does not", values[index + 1]))
                    .help("list each once, in ascending order")
                    .under([PathItem::Index(index + 1)]))
            }
        }
    }
}

impl EvenSeries {
    fn values(self) -> Result<Vec<f64>, SettingsError> {
        let Self { from, to, step } = self;
        let intervals = (to - from) / step;
        if !(step > 0.0 && intervals > 0.0) {
            let message = format!(
                "from {from} to {to} in steps of {step}: a smaller `from`, a larger `to` and a positive `step` were expected"
            );
            return Err(SettingsError::new("", message).help("write `{ from: 0, to: 300, step: 50 }`"));
        }
        if intervals > MOST {
            let message = format!("from {from} to {to} in steps of {step} are more than {MOST} steps");
            return Err(SettingsError::new("step", message).help("take a larger step"));
        }
        if (intervals - intervals.round()).abs() > 1e-9 * intervals {
            let message = format!("the step {step} does not divide the way from {from} to {to}");
            return Err(SettingsError::new("step", message).help("take another step, or another end"));
        }
        let last = intervals.round();
        // Both ends are exact.
        Ok((0..=last as usize).map(|k| (from * (last - k as f64) + to * k as f64) / last).collect())
    }
}
