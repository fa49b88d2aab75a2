//! Errors that follow temperatures.

use std::collections::BTreeMap;
use std::sync::{Arc, RwLock};

use abbe_core::{PathItem, Quantity, SettingsError, Unit, positive};
use abbe_thermal::{History, SensorLog, possible_temperature};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Argument, Family, Functions, Group, Subject, Term};

/// Errors that follow the temperatures of a log: states that lag behind them (`dzt[T34:1]`, the gain at rest of the state that T34
/// drives with `time_constant[1]_s`), temperatures themselves (`dzt[T34]`), and slopes along an axis (`EXX[1*T34:1]`) (Soons 1993, 3.4).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[allow(non_snake_case, reason = "units are written as in column names")]
pub struct Thermal {
    /// Errors by their symbols: `dzt`, `EXX`, `EA0B`.
    pub thermal: Vec<String>,
    /// Columns of the log that drive states, without their units: `T34` is the column `T34_degC`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub inputs: Vec<String>,
    /// Time constants: their values if they are not estimated, first guesses otherwise. All lines of a machine share them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub time_constants_s: Vec<f64>,
    /// Columns of the log that the errors follow at once.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub at_once: Vec<String>,
    /// The errors grow with the command of their axis, from its zero.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub slope: bool,
    /// States at the beginning of the log are unknown: `dzt[start:1]` is what the first one adds there.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub starts_warm: bool,
    /// Temperatures count from this one: the machine was isothermal. Without it they count from the first row of the log.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference_degC: Option<f64>,
    /// Columns count from the mean of their rows up to this time: idle minutes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference_until_s: Option<f64>,
    /// What columns count from, by their names without units, in the units of memory (temperatures in °C): `{ T34: 20.1 }`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub references: BTreeMap<String, f64>,
    /// The machine had long stood at the first readings when the log begins: states begin with them. Without it they begin with the
    /// reference.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub starts_at_rest: bool,
    /// Columns stay from one row to the next (speeds), and do not run straight (temperatures).
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub zero_order_hold: bool,
    /// Longest time between two rows of the log. Default: five times the median.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub longest_gap_s: Option<f64>,
    /// Patterns of coefficients that are zero.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub zero: Vec<String>,
    /// The log itself, by columns, as a calibration keeps it. Without it, that of the stage under `logs` of the machine.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub log: BTreeMap<String, Vec<f64>>,
}

/// Most time constants: states of more than three are hardly ever told apart.
const MOST: usize = 6;

impl Family for Thermal {
    fn symbols(&self) -> &[String] {
        &self.thermal
    }

    fn group(&self) -> Group {
        Group::Any
    }

    fn zero(&self) -> &[String] {
        &self.zero
    }

    fn check(&self) -> Result<(), SettingsError> {
        if self.inputs.is_empty() && self.at_once.is_empty() {
            return Err(SettingsError::new("inputs", "at least one column, here or under `at_once`, was expected"));
        }
        for (setting, list) in [("inputs", &self.inputs), ("at_once", &self.at_once)] {
            for (index, name) in list.iter().enumerate() {
                let at = [PathItem::Key(setting.to_owned()), PathItem::Index(index)];
                let (base, quantity, _) = Quantity::of_column(name);
                if quantity != Quantity::Label || base.is_empty() || name.contains(['[', ']', ':', '*']) {
                    let message = format!("the name of a column without its unit was expected, not `{name}`");
                    return Err(SettingsError::new("", message).help("`T34` is the column `T34_degC`").under(at));
                }
                if list[..index].contains(name) {
                    return Err(SettingsError::new("", format!("{name} stands here twice")).under(at));
                }
            }
        }
        if self.inputs.is_empty() != self.time_constants_s.is_empty() || self.time_constants_s.len() > MOST {
            let message = format!("1 to {MOST} times, one for each state of an input, were expected");
            return Err(SettingsError::new("time_constants_s", message));
        }
        for (index, time) in self.time_constants_s.iter().enumerate() {
            let at = [PathItem::Key("time_constants_s".to_owned()), PathItem::Index(index)];
            positive("", *time).map_err(|error| error.under(at.clone()))?;
            if index > 0 && self.time_constants_s[index - 1] >= *time {
                return Err(SettingsError::new("", "these have to increase").under(at));
            }
        }
        if self.starts_warm && self.inputs.is_empty() {
            return Err(SettingsError::new("starts_warm", "there is no state without `inputs`"));
        }
        if self.starts_warm && self.starts_at_rest {
            return Err(SettingsError::new("starts_at_rest", "there is `starts_warm` already"));
        }
        if self.reference_degC.is_some() && self.reference_until_s.is_some() {
            return Err(SettingsError::new("reference_until_s", "there is `reference_degC` already"));
        }
        self.check_references()?;
        for (setting, value) in [("reference_degC", self.reference_degC), ("reference_until_s", self.reference_until_s)]
        {
            if value.is_some_and(|value| !value.is_finite()) {
                return Err(SettingsError::new(setting, "a finite number was expected"));
            }
        }
        self.reference_degC.map_or(Ok(()), possible_temperature)?;
        self.longest_gap_s.map_or(Ok(()), |gap| positive("longest_gap_s", gap).map(drop))
    }

    fn functions(&self, subject: &Subject<'_>) -> Result<Vec<Box<dyn Functions>>, SettingsError> {
        if self.slope && (subject.location || subject.command == Quantity::Ratio) {
            return Err(SettingsError::new("slope", "only a motion error of an axis grows with its command"));
        }
        if self.slope && !(subject.of == Quantity::Length && subject.command == Quantity::Length) {
            let message = "the slope of a length along a linear axis was expected (EXX, EYX, ..)";
            return Err(SettingsError::new("slope", message));
        }
        let unit = |name: &String| {
            let per = self.quantity(name);
            match (self.slope, per) {
                (false, _) => Unit { of: subject.of, per: Some((per, 1)) },
                (true, Quantity::Temperature) => Unit { of: Quantity::PerTemperature, per: None },
                (true, _) => Unit { of: Quantity::Ratio, per: Some((per, 1)) },
            }
        };
        let log = self.sensor_log()?.map(Arc::new);
        let sensors = |names: &[String]| -> Vec<usize> {
            let names = names.iter();
            names.filter_map(|name| log.as_ref().and_then(|log| log.sensor(name).ok())).collect()
        };
        Ok(vec![Box::new(ThermalTerms {
            inputs: self.inputs.iter().map(|name| (name.clone(), unit(name))).collect(),
            at_once: self.at_once.iter().map(|name| (name.clone(), unit(name))).collect(),
            sensors: [sensors(&self.inputs), sensors(&self.at_once)],
            time_constants: self.time_constants_s.clone(),
            slope: self.slope,
            start: self.starts_warm.then_some(Unit { of: subject.of, per: None }),
            at_rest: self.starts_at_rest,
            log,
            histories: RwLock::default(),
        })])
    }
}

/// States by input and time constant, temperatures, and what states at the beginning add; all are zero where the time, or the log, is
/// not known.
#[derive(Debug)]
pub struct ThermalTerms {
    /// Names of the inputs, and units of their gains.
    inputs: Vec<(String, Unit)>,
    at_once: Vec<(String, Unit)>,
    /// Their places in the log.
    sensors: [Vec<usize>; 2],
    /// Nominal time constants, s.
    time_constants: Vec<f64>,
    slope: bool,
    /// Unit of states at the beginning, if they are unknown.
    start: Option<Unit>,
    /// States begin with the first readings.
    at_rest: bool,
    log: Option<Arc<SensorLog>>,
    /// States over the log, of the time constants that were needed last.
    histories: RwLock<Vec<Known>>,
}

/// Sensor, bits of the time constant, and the states.
type Known = ((usize, u64), Arc<History>);

/// States that are kept: those of a step of an iteration and of its derivatives by differences.
const KEPT: usize = 16;

impl ThermalTerms {
    /// The place of the first time constant among the arguments.
    fn first(&self) -> usize {
        1 + usize::from(self.slope)
    }

    fn history(&self, log: &SensorLog, sensor: usize, time_constant: f64) -> Arc<History> {
        let key = (sensor, time_constant.to_bits());
        let of = |known: &Vec<Known>| known.iter().find(|(own, _)| *own == key).map(|(_, history)| history.clone());
        if let Some(found) = self.histories.read().ok().and_then(|known| of(&known)) {
            return found;
        }
        let made = match self.at_rest {
            true => History::from_rest(log, sensor, time_constant),
            false => History::new(log, sensor, time_constant),
        };
        let made = Arc::new(made);
        if let Ok(mut known) = self.histories.write()
            && of(&known).is_none()
        {
            known.push((key, made.clone()));
            let more = known.len().saturating_sub(KEPT * self.inputs.len().max(1));
            known.drain(..more);
        }
        made
    }

    /// Value and derivative to the logarithm of its time constant of every term, before it is multiplied by the command.
    fn each(&self, arguments: &[f64], mut put: impl FnMut(usize, [f64; 2], Option<usize>)) {
        let Some(log) = self.log.as_ref().filter(|_| !arguments[0].is_nan()) else { return };
        let time_constants = &arguments[self.first()..];
        let mut place = 0;
        for &sensor in &self.sensors[0] {
            for (index, &time_constant) in time_constants.iter().enumerate() {
                // Iterations may try what is no time.
                if time_constant > 0.0
                    && let Ok(state) = self.history(log, sensor, time_constant).at(log, arguments[0])
                {
                    put(place, state, Some(index));
                }
                place += 1;
            }
        }
        for &sensor in &self.sensors[1] {
            if let Ok(value) = log.at(sensor, arguments[0]) {
                put(place, [value, 0.0], None);
            }
            place += 1;
        }
        if self.start.is_some() {
            for (index, &time_constant) in time_constants.iter().enumerate().filter(|(_, time)| **time > 0.0) {
                let a = (arguments[0] - log.times()[0]) / time_constant;
                put(place + index, [(-a).exp(), a * (-a).exp()], Some(index));
            }
        }
    }

    fn lever(&self, arguments: &[f64]) -> f64 {
        if self.slope { arguments[1] } else { 1.0 }
    }
}

impl Functions for ThermalTerms {
    fn arguments(&self) -> Vec<Argument> {
        let unit = Unit { of: Quantity::Time, per: None };
        let shapes = (self.time_constants.iter().enumerate())
            .map(|(index, time)| Argument::SharedShape(format!("time_constant[{}]_s", index + 1), *time, unit));
        let command = self.slope.then_some(Argument::Command);
        std::iter::once(Argument::Time).chain(command).chain(shapes).collect()
    }

    fn terms(&self) -> Vec<Term> {
        let slope = if self.slope { "1*" } else { "" };
        let term = |suffix: String, unit: Unit| Term { unit: Some(unit), ..Term::new(suffix, 0) };
        let mut terms = Vec::new();
        for (name, unit) in &self.inputs {
            let states = 1..=self.time_constants.len();
            terms.extend(states.map(|index| term(format!("[{slope}{name}:{index}]"), *unit)));
        }
        terms.extend(self.at_once.iter().map(|(name, unit)| term(format!("[{slope}{name}]"), *unit)));
        if let Some(unit) = self.start {
            let unit = if self.slope { Unit { of: Quantity::Ratio, per: None } } else { unit };
            let states = 1..=self.time_constants.len();
            terms.extend(states.map(|index| term(format!("[{slope}start:{index}]"), unit)));
        }
        terms
    }

    fn values(&self, arguments: &[f64], out: &mut [f64]) {
        out.fill(0.0);
        let lever = self.lever(arguments);
        self.each(arguments, |place, [value, _], _| out[place] = lever * value);
    }

    fn slopes(&self, by: usize, arguments: &[f64], out: &mut [f64]) {
        out.fill(0.0);
        if self.slope && by == 1 {
            return self.each(arguments, |place, [value, _], _| out[place] = value);
        }
        let Some(wanted) = by.checked_sub(self.first()) else { return };
        let factor = self.lever(arguments) / arguments[by];
        self.each(arguments, |place, [_, slope], index| {
            if index == Some(wanted) {
                out[place] = factor * slope;
            }
        });
    }

    fn refused(&self, arguments: &[f64]) -> Option<String> {
        if arguments[self.first()..].iter().any(|time| *time <= 0.0) {
            return Some("a time constant is above 0 s".to_owned());
        }
        let log = self.log.as_ref().filter(|_| !arguments[0].is_nan())?;
        let (first, last) = (log.times()[0], log.times()[log.times().len() - 1]);
        let outside = !(first..=last).contains(&arguments[0]);
        outside.then(|| {
            format!(
                "the time {} s is outside the log of temperatures, which goes from {first} s to {last} s",
                arguments[0]
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::families::testing::{names, slopes_agree_by, values};
    use serde_json::json;

    fn family(settings: serde_json::Value) -> Thermal {
        let family: Thermal = serde_json::from_value(settings).expect("settings");
        family.check().expect("valid");
        family
    }

    fn subject(of: Quantity, command: Quantity) -> Subject<'static> {
        Subject { location: false, of, command, along: 1.0, range: None, axes: &[], labels: &[] }
    }

    fn step() -> serde_json::Value {
        // A step of 2 K at the beginning, from a reference of 20 °C; the other sensor rises by 1 K in 1,000 s.
        json!({ "time_s": [0.0, 500.0, 1000.0], "T1_degC": [22.0, 22.0, 22.0], "T2_degC": [20.0, 20.5, 21.0] })
    }

    #[test]
    fn values_by_hand() {
        let thermal = family(json!({ "thermal": ["dzt"], "inputs": ["T1", "T2"], "time_constants_s": [100.0, 400.0],
            "at_once": ["T2"], "reference_degC": 20.0, "log": step() }));
        let functions = thermal.functions(&subject(Quantity::Length, Quantity::Ratio)).expect("functions");
        let expected = ["[T1:1]", "[T1:2]", "[T2:1]", "[T2:2]", "[T2]"];
        assert_eq!(names(functions[0].as_ref()), expected);
        assert_eq!(functions[0].terms()[0].unit(Quantity::Length, Quantity::Ratio).to_string(), "mm/K");
        let at = |time: f64| values(functions[0].as_ref(), &[time, 100.0, 400.0]);
        for (time, a) in [(300.0_f64, [3.0_f64, 0.75]), (900.0, [9.0, 2.25])] {
            let found = at(time);
            // A ramp of r K/s: r (t - T (1 - exp(-t/T))).
            let ramp = |a: f64, constant: f64| 1e-3 * (time - constant * (1.0 - (-a).exp()));
            let by_hand = [
                2.0 * (1.0 - (-a[0]).exp()),
                2.0 * (1.0 - (-a[1]).exp()),
                ramp(a[0], 100.0),
                ramp(a[1], 400.0),
                1e-3 * time,
            ];
            for (found, by_hand) in found.iter().zip(by_hand) {
                assert!((found - by_hand).abs() < 1e-13, "{time}: {found} {by_hand}");
            }
        }
        assert_eq!(at(f64::NAN), [0.0; 5]);
        assert!(functions[0].refused(&[1000.5, 100.0, 400.0]).expect("outside").contains("outside the log"));
        assert!(functions[0].refused(&[1000.0, 100.0, 400.0]).is_none());
    }

    #[test]
    fn slopes_and_beginnings() {
        let thermal = family(json!({ "thermal": ["EXX"], "inputs": ["T2"], "time_constants_s": [250.0], "slope": true,
            "starts_warm": true, "log": step() }));
        let functions = thermal.functions(&subject(Quantity::Length, Quantity::Length)).expect("functions");
        assert_eq!(names(functions[0].as_ref()), ["[1*T2:1]", "[1*start:1]"]);
        assert_eq!(functions[0].terms()[0].unit(Quantity::Length, Quantity::Length).to_string(), "1/K");
        let one = values(functions[0].as_ref(), &[500.0, 1.0, 250.0]);
        let many = values(functions[0].as_ref(), &[500.0, -300.0, 250.0]);
        assert!((one[1] - (-2.0_f64).exp()).abs() < 1e-15);
        assert!(one.iter().zip(many).all(|(one, many)| (-300.0 * one - many).abs() < 1e-10));
        assert!(thermal.functions(&subject(Quantity::Angle, Quantity::Length)).is_err());
        assert!(thermal.functions(&subject(Quantity::Length, Quantity::Ratio)).is_err());
    }

    proptest::proptest! {
        #[test]
        fn slopes_are_those_of_the_values(time in 1.0..999.0_f64, constant in 20.0..5e3_f64, q in -500.0..500.0_f64) {
            for slope in [false, true] {
                let thermal = family(json!({ "thermal": ["EXX"], "inputs": ["T1", "T2"], "time_constants_s": [9.0, 250.0],
                    "slope": slope, "starts_warm": true, "reference_degC": 20.0, "log": step() }));
                let functions = thermal.functions(&subject(Quantity::Length, Quantity::Length)).expect("functions");
                let mut arguments = vec![time];
                arguments.extend(slope.then_some(q));
                arguments.extend([constant / 10.0, constant]);
                for by in 1..arguments.len() {
                    slopes_agree_by(functions[0].as_ref(), by, &arguments, 1e-4 * arguments[by].abs().max(1.0), 1e-5);
                }
            }
        }
    }

    #[test]
    fn wrong_settings_are_named() {
        for (settings, expected) in [
            (json!({ "thermal": ["dzt"] }), "inputs: at least one column"),
            (json!({ "thermal": ["dzt"], "inputs": ["T1"] }), "time_constants_s: 1 to 6 times"),
            (
                json!({ "thermal": ["dzt"], "inputs": ["T1_degC"], "time_constants_s": [9] }),
                "inputs[0]: the name of a column",
            ),
            (
                json!({ "thermal": ["dzt"], "inputs": ["T1", "T1"], "time_constants_s": [9] }),
                "inputs[1]: T1 stands here twice",
            ),
            (
                json!({ "thermal": ["dzt"], "inputs": ["T1"], "time_constants_s": [9, 8] }),
                "time_constants_s[1]: these have to increase",
            ),
            (json!({ "thermal": ["dzt"], "inputs": ["T1"], "time_constants_s": [0] }), "time_constants_s[0]: "),
            (json!({ "thermal": ["dzt"], "at_once": ["T1"], "starts_warm": true }), "starts_warm: there is no state"),
            (
                json!({ "thermal": ["dzt"], "at_once": ["T1"], "reference_degC": 20, "reference_until_s": 5 }),
                "reference_until_s: there is",
            ),
            (json!({ "thermal": ["dzt"], "at_once": ["T1"], "longest_gap_s": -1 }), "longest_gap_s: "),
        ] {
            let family: Thermal = serde_json::from_value(settings).expect("settings");
            let error = family.check().expect_err(expected).to_string();
            assert!(error.starts_with(expected), "{error}");
        }
    }

    #[test]
    fn logs_that_are_wrong_are_named() {
        let with = |log: serde_json::Value| {
            let mut thermal = family(json!({ "thermal": ["dzt"], "at_once": ["T1", "T2"], "log": log }));
            thermal.settle(&[]).expect_err("it is refused").to_string()
        };
        let log = |times: &[f64], t1: &[f64], t2: &[f64]| json!({ "time_s": times, "T1_degC": t1, "T2_degC": t2 });
        let rising = [20.0, 21.0, 22.0, 23.0];
        assert!(with(json!({ "T1_degC": rising, "T2_degC": rising })).contains("`time_s` is missing"));
        assert!(with(json!({ "time_s": rising, "T1_degC": rising })).contains("`T2` is missing"));
        assert!(with(log(&[0.0, 1.0, 2.0, 30.0], &rising, &rising)).contains("a gap of 28 s before row 4"));
        assert!(with(log(&[0.0, 1.0, 2.0, 1.5], &rising, &rising)).contains("in row 4"));
        let many: Vec<f64> = (0..30).map(|row| 20.0 + 0.1 * f64::from(row)).collect();
        let said = with(log(&many, &many, &[20.0; 30]));
        assert!(said.contains("the sensor T2 reads the same all the time"), "{said}");
    }
}
