//! Slow drift of set-up parameters.

use std::collections::BTreeMap;

use abbe_core::{SettingsError, Whole};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::travel::legendre;
use super::{Argument, Family, Functions, Group, Subject, Term, check_numbers, numbers};

/// Slow drift of set-up parameters: Legendre polynomials in the time scaled to -1..1, `dzt[t1]`, `dzt[t2]`, ...
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Drift {
    /// Set-up parameters, e.g. dzt.
    pub drift: Vec<String>,
    /// The degrees, from 1 to 9; the constant part is the set-up parameter itself.
    pub degrees: Vec<Whole<1, 9>>,
    /// Which rows share one drift.
    #[serde(default)]
    pub per: Per,
    /// First and last time in s of each series. Default: those of the data.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub time_s: BTreeMap<String, [f64; 2]>,
}

/// Which rows share one drift.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Per {
    /// One drift over all rows that have a time.
    #[default]
    DataSet,
    /// One for each file (column `file`).
    File,
    /// One for each day (column `day`).
    Day,
    /// One for each cycle (column `cycle`).
    Cycle,
}

impl Per {
    /// The label column that tells the series apart.
    pub fn column(self) -> Option<&'static str> {
        match self {
            Self::DataSet => None,
            Self::File => Some("file"),
            Self::Day => Some("day"),
            Self::Cycle => Some("cycle"),
        }
    }

    /// Prefix of the names of a series' terms inside the bracket: `day2.` of `dzt[day2.t1]`.
    pub fn prefix(self, label: &str) -> String {
        match self {
            Self::DataSet => String::new(),
            Self::File => format!("{label}."),
            Self::Day => format!("day{label}."),
            Self::Cycle => format!("cycle{label}."),
        }
    }
}

impl Family for Drift {
    fn symbols(&self) -> &[String] {
        &self.drift
    }

    fn group(&self) -> Group {
        Group::SetUp
    }

    fn check(&self) -> Result<(), SettingsError> {
        check_numbers("degrees", "degree", &self.degrees)
    }

    fn functions(&self, subject: &Subject<'_>) -> Result<Vec<Box<dyn Functions>>, SettingsError> {
        let series = self.time_s.iter().map(|(label, time)| {
            Box::new(LegendreInTime {
                degrees: numbers(&self.degrees),
                time: *time,
                series: self.per.column().and_then(|column| {
                    let place = subject.labels.iter().position(|known| known == label)?;
                    Some((column.to_owned(), place))
                }),
                prefix: self.per.prefix(label),
            }) as Box<dyn Functions>
        });
        Ok(series.collect())
    }
}

/// Legendre polynomials of the time scaled to -1..1 over a series; zero in other series and without a time.
#[derive(Debug, Clone, PartialEq)]
pub struct LegendreInTime {
    /// The degrees.
    pub degrees: Vec<u8>,
    /// First and last time of the series, s.
    pub time: [f64; 2],
    /// The column of series and the index of this one's label; none if there is one series only.
    pub series: Option<(String, usize)>,
    /// Prefix of the names inside the bracket: `day2.`.
    pub prefix: String,
}

impl Functions for LegendreInTime {
    fn arguments(&self) -> Vec<Argument> {
        let series = self.series.as_ref().map(|(column, _)| Argument::Series(column.clone()));
        std::iter::once(Argument::Time).chain(series).collect()
    }

    fn terms(&self) -> Vec<Term> {
        self.degrees.iter().map(|degree| Term::new(format!("[{}t{degree}]", self.prefix), 0)).collect()
    }

    fn values(&self, arguments: &[f64], out: &mut [f64]) {
        let elsewhere = self.series.as_ref().is_some_and(|(_, series)| arguments[1] != *series as f64);
        if elsewhere || arguments[0].is_nan() {
            return out.fill(0.0);
        }
        let [from, to] = self.time;
        let scaled = if to > from { (2.0 * arguments[0] - from - to) / (to - from) } else { 0.0 };
        for (value, &degree) in out.iter_mut().zip(&self.degrees) {
            *value = legendre(degree, scaled).0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::families::testing::values;

    #[test]
    fn values_at_known_times() {
        let drift = |series: Option<usize>| LegendreInTime {
            degrees: vec![1, 2, 4],
            time: [10.0, 30.0],
            series: series.map(|place| ("day".to_owned(), place)),
            prefix: String::new(),
        };
        assert_eq!(values(&drift(None), &[10.0]), [-1.0, 1.0, 1.0]);
        assert_eq!(values(&drift(None), &[20.0]), [0.0, -0.5, 0.375]);
        assert_eq!(values(&drift(None), &[f64::NAN]), [0.0; 3]);
        assert_eq!(values(&drift(Some(1)), &[30.0, 1.0]), [1.0; 3]);
        assert_eq!(values(&drift(Some(1)), &[30.0, 0.0]), [0.0; 3]);
    }

    #[test]
    fn names_of_terms() {
        let drift = LegendreInTime {
            degrees: vec![2],
            time: [0.0, 1.0],
            series: Some(("day".to_owned(), 0)),
            prefix: Per::Day.prefix("2"),
        };
        assert_eq!(drift.terms()[0].suffix, "[day2.t2]");
    }
}
