//! Settings of the Monte Carlo calculation.

use std::collections::BTreeMap;
use std::path::PathBuf;

use abbe_core::{PathItem, SettingsError, Whole, positive};
use abbe_numerics::Generator;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// A number of trials.
pub type TrialCount = Whole<1, 10_000_000>;

/// A number of digits.
pub type Digits = Whole<1, 4>;

/// Settings of the Monte Carlo calculation.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Number of trials.
    #[serde(default = "default_trials")]
    pub trials: TrialCount,
    /// Continue until the results are stable, instead of a fixed number of trials (JCGM 101, 7.9.4).
    #[serde(default)]
    pub adaptive: Option<AdaptiveSetting>,
    /// Seed of the random numbers: the same seed gives the same result on any number of threads.
    #[serde(default = "default_seed")]
    pub seed: u64,
    /// Probability that the intervals cover.
    #[serde(default = "default_probability")]
    pub coverage_probability: f64,
    /// Meaningful digits of the standard uncertainties, for the comparison with the GUM result (JCGM 101, clause 8).
    #[serde(default = "default_digits")]
    pub digits: Digits,
    /// Distribution of the rows' errors, with their standard uncertainties.
    #[serde(default)]
    pub rows: RowDistribution,
    /// Distributions of known inputs by name; normal unless listed.
    #[serde(default)]
    pub inputs: BTreeMap<String, Distribution>,
    /// Model parameters that are not estimated and vary from trial to trial: neglected errors.
    #[serde(default)]
    pub vary: Vec<Neglected>,
    /// Lobing of the probe, of unknown amplitude and phase.
    #[serde(default)]
    pub lobing: Vec<LobingSetting>,
    /// Keep the values of every trial, for `export: parquet`. They take 8 bytes for each trial and unknown.
    #[serde(default)]
    pub keep_samples: bool,
    /// A block of the trials alone, whose values are kept. `abbe fleet` deals trials out so and puts them together again: a block
    /// by itself is no result.
    #[serde(default)]
    pub block: Option<Block>,
    /// File with the values of all trials, which were solved before in blocks: trials x unknowns numbers of 8 bytes (IEEE 754, least
    /// significant byte first) in the units used in memory; not a number for a trial that failed.
    #[serde(default)]
    pub solved: Option<PathBuf>,
    /// Number of threads. Default: all cores. The result does not depend on it.
    #[serde(default)]
    pub threads: Option<Whole<1, 1024>>,
}

/// Trials that follow each other.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Block {
    /// Number of the first one, from 0.
    pub first: Whole<0, 10_000_000>,
    /// How many they are.
    pub count: TrialCount,
}

/// When to stop.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AdaptiveSetting {
    /// Digits of the standard uncertainties that have to be stable.
    #[serde(default = "default_digits")]
    pub digits: Digits,
    /// Most trials.
    #[serde(default = "default_most")]
    pub most: TrialCount,
}

/// A distribution of zero mean and unit variance: its name, or `{ student: degrees of freedom }`.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Distribution {
    /// Normal.
    #[default]
    Normal,
    /// Rectangular.
    Uniform,
    /// Student's t with these degrees of freedom, more than 2, scaled to unit variance.
    Student(f64),
}

/// The distribution of the rows' errors: that of [`Distribution`], or `resampled`.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum RowDistribution {
    /// Normal.
    #[default]
    Normal,
    /// Rectangular.
    Uniform,
    /// Student's t with these degrees of freedom, more than 2, scaled to unit variance.
    Student(f64),
    /// Drawn from the residuals of the estimate, artefact by artefact.
    Resampled,
}

/// Fewest degrees of freedom of Student's distribution. With 2 it has no variance; with little more its variance lies in draws so rare that
/// no number of trials has them.
const LEAST_FREEDOM: f64 = 2.5;

/// Reads a distribution: here, because the derived reader could not say what is wrong with `{ student: two }`.
fn read(value: &Value, resampled: bool) -> Result<Option<Distribution>, String> {
    let choices = if resampled { ", uniform, resampled" } else { ", uniform" };
    let expected = || format!("{value} is no distribution; normal{choices} or {{ student: 5 }} was expected");
    match value {
        Value::String(name) => match name.as_str() {
            "normal" => Ok(Some(Distribution::Normal)),
            "uniform" => Ok(Some(Distribution::Uniform)),
            "resampled" if resampled => Ok(None),
            _ => Err(expected()),
        },
        Value::Object(map) if map.len() == 1 => {
            let freedom = map.get("student").and_then(Value::as_f64).ok_or_else(expected)?;
            if freedom >= LEAST_FREEDOM {
                return Ok(Some(Distribution::Student(freedom)));
            }
            Err(format!(
                "{freedom} degrees of freedom have no variance that trials could show; at least {LEAST_FREEDOM} were expected"
            ))
        }
        _ => Err(expected()),
    }
}

impl<'de> Deserialize<'de> for Distribution {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let value = Value::deserialize(deserializer)?;
        read(&value, false).map(Option::unwrap_or_default).map_err(serde::de::Error::custom)
    }
}

impl<'de> Deserialize<'de> for RowDistribution {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let value = Value::deserialize(deserializer)?;
        Ok(match read(&value, true).map_err(serde::de::Error::custom)? {
            None => Self::Resampled,
            Some(Distribution::Normal) => Self::Normal,
            Some(Distribution::Uniform) => Self::Uniform,
            Some(Distribution::Student(freedom)) => Self::Student(freedom),
        })
    }
}

impl Distribution {
    /// A number of this distribution.
    pub fn draw(self, generator: &mut Generator) -> f64 {
        match self {
            Self::Normal => generator.normal(),
            Self::Uniform => generator.uniform(),
            Self::Student(freedom) => generator.student(freedom),
        }
    }
}

impl RowDistribution {
    /// The distribution that is no resampling.
    pub fn fixed(self) -> Option<Distribution> {
        match self {
            Self::Normal => Some(Distribution::Normal),
            Self::Uniform => Some(Distribution::Uniform),
            Self::Student(freedom) => Some(Distribution::Student(freedom)),
            Self::Resampled => None,
        }
    }
}

/// Errors of the machine that the estimate neglects.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Neglected {
    /// Names or patterns of parameters that the model has and the estimate does not choose.
    pub parameters: Vec<String>,
    /// Distribution of each.
    #[serde(default)]
    pub distribution: Distribution,
    /// Standard uncertainty in the unit of the parameter (mm, rad and their powers).
    #[serde(default)]
    pub standard_uncertainty: Option<f64>,
    /// Standard uncertainty of the error that the parameter makes where it is largest in the data; for lengths.
    #[serde(default)]
    pub at_end_of_travel_um: Option<f64>,
    /// The same for angles.
    #[serde(default)]
    pub at_end_of_travel_urad: Option<f64>,
}

/// Lobing of a probe of which only the size is known.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LobingSetting {
    /// The artefact stage whose touches it affects.
    pub artefact: String,
    /// Standard uncertainty of the amplitude.
    pub amplitude_um: f64,
    /// Number of lobes in one turn.
    #[serde(default = "default_lobes")]
    pub lobes: Whole<0, 1000>,
    /// Phase in the tool frame. Default: all phases are equally probable.
    #[serde(default)]
    pub phase_deg: Option<f64>,
}

fn default_trials() -> TrialCount {
    Whole::new(10_000)
}

fn default_seed() -> u64 {
    1
}

fn default_probability() -> f64 {
    0.95
}

fn default_digits() -> Digits {
    Whole::new(1)
}

fn default_most() -> TrialCount {
    Whole::new(1_000_000)
}

fn default_lobes() -> Whole<0, 1000> {
    Whole::new(3)
}

impl Settings {
    /// Refuses settings with which nothing can be calculated.
    pub fn check(&self) -> Result<(), SettingsError> {
        let probability = self.coverage_probability;
        if !(probability > 0.0 && probability < 1.0) {
            return Err(SettingsError::new("coverage_probability", "a number between 0 and 1 was expected"));
        }
        let of_parts = [("block", self.block.is_some()), ("solved", self.solved.is_some())];
        let parts: Vec<&str> = of_parts.iter().filter(|(_, is_given)| *is_given).map(|(name, _)| *name).collect();
        if let ([name, ..], true) = (parts.as_slice(), self.adaptive.is_some()) {
            let message = "trials in blocks need a number that is fixed before: `trials`, and not `adaptive`";
            return Err(SettingsError::new(name, message));
        }
        if parts.len() > 1 {
            return Err(SettingsError::new(
                "block",
                "a block is solved, and not read: `block` or `solved` was expected",
            ));
        }
        if let Some(block) = self.block {
            let (end, all) = (block.first.get() + block.count.get(), self.trials.get());
            let message = || format!("the block ends with trial {end}, and there are {all} trials");
            return if end <= all { Ok(()) } else { Err(SettingsError::new("block", message())) };
        }
        if let Some(adaptive) = &self.adaptive {
            let under = |error: SettingsError| error.under([PathItem::Key("adaptive".to_owned())]);
            crate::enough(adaptive.most.get(), probability)
                .map_err(|message| under(SettingsError::new("most", message)))?;
        } else {
            crate::enough(self.trials.get(), probability).map_err(|message| SettingsError::new("trials", message))?;
        }
        for (index, neglected) in self.vary.iter().enumerate() {
            let under = |error: SettingsError| error.under([PathItem::Key("vary".to_owned()), PathItem::Index(index)]);
            neglected.check().map_err(under)?;
        }
        for (index, lobing) in self.lobing.iter().enumerate() {
            let under =
                |error: SettingsError| error.under([PathItem::Key("lobing".to_owned()), PathItem::Index(index)]);
            positive("amplitude_um", lobing.amplitude_um).map_err(under)?;
        }
        Ok(())
    }
}

impl Neglected {
    fn check(&self) -> Result<(), SettingsError> {
        let sizes = [
            ("standard_uncertainty", self.standard_uncertainty),
            ("at_end_of_travel_um", self.at_end_of_travel_um),
            ("at_end_of_travel_urad", self.at_end_of_travel_urad),
        ];
        let given: Vec<(&str, f64)> = sizes.iter().filter_map(|(name, size)| Some((*name, (*size)?))).collect();
        match given.as_slice() {
            [(name, size)] => positive(name, *size).map(drop),
            _ => Err(SettingsError::new(
                "",
                "one size was expected: `standard_uncertainty`, `at_end_of_travel_um` or `at_end_of_travel_urad`",
            )),
        }
    }
}
