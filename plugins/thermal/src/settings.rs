//! Which columns of a run drive states, which follow, and how both are counted.

use abbe_core::{
    ColumnHeader, DataRow, Dataset, Error, PathItem, Quantity, Result, SettingsError, Unit, matches, positive,
};
use abbe_thermal::{
    Bootstrap, Counting, Hold, Readings, Reference, SensorLog, Structure, not_copied, possible_temperature,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Settings of thermal states; a calibration keeps them with the names of all outputs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[allow(non_snake_case, reason = "units are written as in column names")]
pub struct Settings {
    /// Columns that drive states, without their units: `T34` is the column `T34_degC`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub inputs: Vec<String>,
    /// Columns that follow, without their units: names and patterns with `?` and `*`.
    pub outputs: Vec<String>,
    /// Columns that outputs follow at once.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub at_once: Vec<String>,
    /// Number of time constants, which all inputs and outputs share. Default: as many as first guesses.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time_constants: Option<usize>,
    /// First guesses of the time constants. Without them several are tried.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schemars(inner(range(min = 1e-3, max = 1e8)))]
    pub time_constants_s: Vec<f64>,
    /// `prediction`: leaves out inputs and time constants without which readings that a fit has not seen are predicted as well.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub select: Option<Select>,
    /// States at the beginning of a run are unknown.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub starts_warm: bool,
    /// Temperatures count from this one, and other outputs from zero: the machine was isothermal. Without it columns count from the
    /// first row of their run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference_degC: Option<f64>,
    /// Columns count from the mean of the rows of the first seconds of their run: idle minutes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference_until_s: Option<f64>,
    /// Inputs stay from one row to the next (speeds), and do not run straight (temperatures).
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub zero_order_hold: bool,
    /// Longest time between two rows. Default: five times the median.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub longest_gap_s: Option<f64>,
    /// What standard uncertainties follow from.
    #[serde(default)]
    pub uncertainty: Uncertainty,
    /// Length of the blocks in which residuals are drawn again. Default: the longest time constant, a tenth of the longest run at most.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub block_s: Option<f64>,
    /// Number of draws.
    #[serde(default = "draws")]
    #[schemars(range(min = 50, max = 100_000))]
    pub draws: usize,
    /// Seed of the draws.
    #[serde(default)]
    pub seed: u64,
}

fn draws() -> usize {
    400
}

/// How inputs and time constants are selected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Select {
    /// By the prediction of readings that were left out: whole runs where there are several, else quarters of the run.
    Prediction,
}

/// What standard uncertainties follow from.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Uncertainty {
    /// Residuals that are drawn again in blocks: those that follow each other count as few.
    #[default]
    Blocks,
    /// Residuals as if they were independent. Too small where inputs are noisy, or where the model lacks something.
    Ordinary,
}

/// The column of times.
pub const TIME: &str = "time";

/// Most time constants: states of more than three are hardly ever told apart.
const MOST: usize = 6;

/// Numbers of draws: few tell no scatter, more tell nothing more.
const DRAWS: std::ops::RangeInclusive<usize> = 50..=100_000;

/// One run: its log of inputs, counted from its reference, and what followed.
pub struct Run {
    pub log: SensorLog,
    /// Name, quantity and readings of each output.
    pub outputs: Vec<(String, Quantity, Readings)>,
}

impl Settings {
    /// Refuses settings that contradict each other.
    pub fn check(&self) -> Result<(), SettingsError> {
        if self.inputs.is_empty() && self.at_once.is_empty() {
            return Err(SettingsError::new("inputs", "at least one column, here or under `at_once`, was expected"));
        }
        if self.outputs.is_empty() {
            return Err(SettingsError::new("outputs", "at least one column was expected"));
        }
        for (setting, list) in [("inputs", &self.inputs), ("at_once", &self.at_once), ("outputs", &self.outputs)] {
            for (index, name) in list.iter().enumerate() {
                let at = [PathItem::Key(setting.to_owned()), PathItem::Index(index)];
                check_name(name, setting == "outputs").map_err(|error| error.under(at.clone()))?;
                if list[..index].contains(name) {
                    return Err(SettingsError::new("", format!("{name} stands here twice")).under(at));
                }
            }
        }
        let count = self.count();
        if count > MOST || (count == 0) != self.inputs.is_empty() {
            let message =
                format!("1 to {MOST} time constants for states of inputs, and none without inputs, were expected");
            return Err(SettingsError::new("time_constants", message));
        }
        if !self.time_constants_s.is_empty() && self.time_constants_s.len() != count {
            let message = format!("{count} times were expected, one for each time constant");
            return Err(SettingsError::new("time_constants_s", message));
        }
        for (index, time) in self.time_constants_s.iter().enumerate() {
            let at = [PathItem::Key("time_constants_s".to_owned()), PathItem::Index(index)];
            positive("", *time).map_err(|error| error.under(at))?;
        }
        if self.starts_warm && self.inputs.is_empty() {
            return Err(SettingsError::new(
                "starts_warm",
                "there is no state: the outputs follow their columns at once",
            ));
        }
        if self.reference_degC.is_some() && self.reference_until_s.is_some() {
            return Err(SettingsError::new("reference_until_s", "there is `reference_degC` already"));
        }
        for (setting, value) in [
            ("reference_until_s", self.reference_until_s),
            ("longest_gap_s", self.longest_gap_s),
            ("block_s", self.block_s),
        ] {
            value.map_or(Ok(()), |value| positive(setting, value).map(drop))?;
        }
        if !DRAWS.contains(&self.draws) {
            let message =
                format!("{}: a whole number from {} to {} was expected", self.draws, DRAWS.start(), DRAWS.end());
            return Err(SettingsError::new("draws", message));
        }
        self.reference_degC.map_or(Ok(()), possible_temperature)
    }

    /// Number of time constants.
    fn count(&self) -> usize {
        self.time_constants.unwrap_or(self.time_constants_s.len())
    }

    /// The terms of an output in the log of a run.
    pub fn structure(&self) -> Structure {
        let place = |name: &String| self.columns().position(|own| own == name);
        let sensors = |names: &[String]| names.iter().filter_map(place).collect();
        Structure {
            inputs: sensors(&self.inputs),
            at_once: sensors(&self.at_once),
            time_constants: self.count(),
            starts_warm: self.starts_warm,
            guess: (!self.time_constants_s.is_empty()).then(|| self.time_constants_s.clone()),
        }
    }

    /// The sensors of a log: inputs, then those that are followed at once and are no inputs.
    pub fn columns(&self) -> impl Iterator<Item = &String> {
        self.inputs.iter().chain(self.at_once.iter().filter(|name| !self.inputs.contains(name)))
    }

    /// How residuals are drawn again.
    ///
    /// Fails for blocks that hold less than a row, and for those of which a run has not two.
    pub fn bootstrap(&self, logs: &[SensorLog], time_constants: &[f64]) -> Result<Bootstrap> {
        let length = |log: &SensorLog| log.times()[log.times().len() - 1] - log.times()[0];
        let longest = logs.iter().map(length).fold(0.0, f64::max);
        let steps = logs.iter().flat_map(|log| log.times().windows(2).map(|pair| pair[1] - pair[0]));
        let shortest = steps.fold(f64::INFINITY, f64::min);
        if let Some(block) = self.block_s.filter(|block| !(shortest..=longest / 2.0).contains(block)) {
            let message = format!(
                "{block:e} s: a time from one row to the next ({shortest} s) to half of the longest run ({} s) was expected",
                longest / 2.0
            );
            return Err(Error::data(message).setting("block_s"));
        }
        let block = time_constants.iter().copied().fold(0.0, f64::max).clamp(0.0, longest / 10.0);
        Ok(Bootstrap { draws: self.draws, block: self.block_s.unwrap_or(block), seed: self.seed })
    }

    /// The outputs among some columns, by names and patterns. Inputs and times are none.
    ///
    /// Fails for a name or pattern without a column of numbers.
    pub fn chosen(&self, headers: &[ColumnHeader]) -> Result<Vec<String>> {
        let mut chosen: Vec<String> = Vec::new();
        for (setting, names) in [("inputs", &self.inputs), ("at_once", &self.at_once)] {
            for (index, name) in names.iter().enumerate() {
                let setting = vec![PathItem::Key(setting.to_owned()), PathItem::Index(index)];
                number_column(headers, name).map_err(|error| Error { setting, ..error })?;
            }
        }
        number_column(headers, TIME)?;
        for (index, pattern) in self.outputs.iter().enumerate() {
            let fits = |header: &&ColumnHeader| {
                let own = header.name.as_str();
                header.quantity != Quantity::Label
                    && own != TIME
                    && !self.columns().any(|input| input == own)
                    && matches(pattern, own)
            };
            let found: Vec<String> = headers.iter().filter(fits).map(|header| header.name.clone()).collect();
            if found.is_empty() {
                let mut error = Error::usage(format!("`{pattern}` matches no column of numbers that is no input"))
                    .suggest(pattern, headers.iter().map(|header| header.name.as_str()));
                error.setting = vec![PathItem::Key("outputs".to_owned()), PathItem::Index(index)];
                return Err(error);
            }
            let new: Vec<String> = found.into_iter().filter(|name| !chosen.contains(name)).collect();
            chosen.extend(new);
        }
        Ok(chosen)
    }

    /// A data set as a run.
    ///
    /// Fails for columns that are missing, and for logs that cannot be used.
    pub fn run(&self, data: &Dataset) -> Result<Run> {
        let in_file = |error: Error| match data.files.first() {
            Some(file) => error.in_file(file),
            None => error,
        };
        let chosen = self.chosen(&data.headers()).map_err(in_file)?;
        not_copied(data, &chosen)?;
        let times = data.required_numbers(TIME)?;
        let begin = times.first().copied().unwrap_or_default();
        let end = times.last().copied().unwrap_or_default();
        if let Some(row) = (1..times.len()).find(|row| times[*row] < times[row - 1]).filter(|_| end < begin) {
            let message = format!("the time falls from {} s to {} s", times[row - 1], times[row]);
            return Err(data.error_at(DataRow(row), message).help("put the rows of the log into their order"));
        }
        if let Some(until) = self.reference_until_s.filter(|until| *until >= end - begin) {
            let message =
                format!("{until} s: the log is {} s long, and columns count from its first seconds", end - begin);
            return Err(in_file(Error::data(message).setting("reference_until_s")));
        }
        let reference = match (self.reference_degC, self.reference_until_s) {
            (Some(value), _) => Reference::Value(value),
            (None, Some(until)) => Reference::MeanUntil(begin + until),
            (None, None) => Reference::FirstRow,
        };
        let hold = if self.zero_order_hold { Hold::ZeroOrder } else { Hold::FirstOrder };
        let how = Counting { hold, reference, longest_gap: self.longest_gap_s };
        let sensors = self.columns().map(|name| Ok((name.clone(), data.required_numbers(name)?.to_vec())));
        let log = SensorLog::counted(times.to_vec(), sensors.collect::<Result<_>>()?, &how).map_err(in_file)?;
        let outputs = chosen.into_iter().map(|name| {
            let quantity = quantity(data, &name);
            let values = data.required_numbers(&name)?;
            // What a reading of another quantity counts from when temperatures count from a stated one.
            let reference = match reference {
                Reference::Value(_) if quantity != Quantity::Temperature => Reference::Value(0.0),
                other => other,
            };
            let counted = SensorLog::new(times.to_vec(), vec![(name.clone(), values.to_vec())], hold, None)
                .and_then(|log| log.elevations(reference))
                .map_err(in_file)?;
            let readings = Readings { times: times.to_vec(), values: counted.values(0).to_vec() };
            Ok((name, quantity, readings))
        });
        Ok(Run { outputs: outputs.collect::<Result<_>>()?, log })
    }
}

/// The quantity of a column of a data set.
pub fn quantity(data: &Dataset, name: &str) -> Quantity {
    data.column(name).map_or(Quantity::Label, |column| column.header.quantity)
}

/// The unit of the gain of an output that follows an input.
pub fn gain_unit(output: Quantity, input: Quantity) -> Unit {
    if output == input { Unit::of(Quantity::Ratio) } else { Unit::per(output, input, 1) }
}

fn number_column(headers: &[ColumnHeader], name: &str) -> Result<()> {
    match headers.iter().find(|header| header.name == name) {
        Some(header) if header.quantity != Quantity::Label => Ok(()),
        Some(header) => Err(Error::usage(format!("the column `{}` has no unit; numbers were expected", header.header))
            .help("names of numbers end in their unit: `time_s`, `T34_degC`, `speed_rpm`")),
        None => Err(Error::usage(format!("there is no column `{name}`"))
            .suggest(name, headers.iter().map(|header| header.name.as_str()))),
    }
}

/// Refuses what cannot be the name of a column.
fn check_name(name: &str, pattern: bool) -> Result<(), SettingsError> {
    let (base, quantity, _) = Quantity::of_column(name);
    let has_letters_of_names = name.contains(['[', ']', ':']) || (!pattern && name.contains(['*', '?']));
    if quantity != Quantity::Label || base.is_empty() || has_letters_of_names {
        let message = format!("the name of a column without its unit was expected, not `{name}`");
        return Err(SettingsError::new("", message).help("`T34` is the column `T34_degC`"));
    }
    Ok(())
}
