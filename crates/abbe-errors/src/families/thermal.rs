//! Errors that follow temperatures.

use std::collections::BTreeMap;
use std::sync::RwLock;

use abbe_core::{PathItem, Quantity, SettingsError, Unit, positive};
use abbe_thermal::possible_temperature;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::thermal_terms::{Along, ThermalTerms};
use super::{Family, Functions, Group, Knots, Subject, suits};
use crate::log::{SeriesLogs, check_label};

/// Errors that follow the temperatures of a log: states that lag behind them (`dzt[T34:1]`, the gain at rest of the state that T34
/// drives with `time_constant[1]_s`), temperatures themselves (`dzt[T34]`), slopes along an axis (`EXX[1*T34:1]`), and gains at
/// positions of an axis (`EYX[at0*T34:1]`) (Soons 1993, 3.4).
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
    /// The errors grow with the command of their axis, from its zero: `EXX[1*T34:1]`.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub slope: bool,
    /// Positions of a linear axis, each with gains of its own: `EYX[at0*T34:1]`, `EYX[at1*T34:1]`, ... Between two of them errors run
    /// straight. There are none before the first and beyond the last one: commands there are refused.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub positions_mm: Option<Knots>,
    /// The same for a rotary axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub positions_deg: Option<Knots>,
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
    /// Column of labels (`day`, `run`): each of its series of measurements has a log of its own, with its own clock, reference and
    /// beginning, in rows with the same label. Gains and time constants are those of the machine.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub series: Option<String>,
    /// Patterns of coefficients that are zero.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub zero: Vec<String>,
    /// The log itself, by columns, as a calibration keeps it. Without it, that of the stage under `logs` of the machine.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub log: BTreeMap<String, Vec<f64>>,
    /// The logs by the labels of `series`, as a calibration keeps them.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub logs: BTreeMap<String, BTreeMap<String, Vec<f64>>>,
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
        self.along()?;
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
        check_label(self.series.as_ref())?;
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
        let along = self.along()?;
        let (setting, what) = match (&along, &self.positions_deg) {
            (Along::All, _) => ("", ""),
            (Along::Slope, _) => ("slope", "grows with its command"),
            (Along::Positions(_), None) => ("positions_mm", "has gains at positions"),
            (Along::Positions(_), Some(_)) => ("positions_deg", "has gains at positions"),
        };
        if !setting.is_empty() && (subject.location || subject.command == Quantity::Ratio) {
            return Err(SettingsError::new(setting, format!("only a motion error of an axis {what}")));
        }
        suits(("positions", "positions"), subject, self.positions_mm.is_some(), self.positions_deg.is_some())?;
        let of = if self.slope { Unit::per(subject.of, subject.command, 1) } else { Unit::of(subject.of) };
        let unit = |name: &String| match (of, self.quantity(name)) {
            (Unit { of: Quantity::Length, per: Some((Quantity::Length, _)), .. }, Quantity::Temperature) => {
                Unit::of(Quantity::PerTemperature)
            }
            (of, per) => of.and_per(per),
        };
        let logs = SeriesLogs::new(self.series.as_ref(), self.sensor_logs()?, subject.labels);
        let sensors = |names: &[String]| -> Vec<usize> {
            let names = names.iter();
            names.filter_map(|name| logs.logs.first().and_then(|own| own.log.sensor(name).ok())).collect()
        };
        Ok(vec![Box::new(ThermalTerms {
            inputs: self.inputs.iter().map(|name| (name.clone(), unit(name))).collect(),
            at_once: self.at_once.iter().map(|name| (name.clone(), unit(name))).collect(),
            sensors: [sensors(&self.inputs), sensors(&self.at_once)],
            time_constants: self.time_constants_s.clone(),
            along,
            start: self.starts_warm.then_some(of),
            at_rest: self.starts_at_rest,
            logs,
            histories: RwLock::default(),
        })])
    }
}

/// Fewest positions: errors run straight between two.
const FEWEST: usize = 2;

impl Thermal {
    /// How the errors depend on the command of their axis.
    fn along(&self) -> Result<Along, SettingsError> {
        let places = |setting: &str, positions: &Knots| {
            let places = positions.values().map_err(|error| error.under([PathItem::Key(setting.to_owned())]))?;
            match places.len() < FEWEST {
                true => Err(SettingsError::new(setting, format!("{FEWEST} positions at least were expected"))),
                false => Ok(places),
            }
        };
        match (&self.positions_mm, &self.positions_deg, self.slope) {
            (None, None, false) => Ok(Along::All),
            (None, None, true) => Ok(Along::Slope),
            (Some(_), Some(_), _) => Err(SettingsError::new("positions_deg", "there is `positions_mm` already")),
            (_, _, true) => Err(SettingsError::new("slope", "there are gains at positions already")),
            (Some(mm), ..) => places("positions_mm", mm).map(Along::Positions),
            (_, Some(deg), _) => {
                let places = places("positions_deg", deg)?;
                Ok(Along::Positions(places.into_iter().map(f64::to_radians).collect()))
            }
        }
    }

    /// What the bracket of a coefficient of this line says without the place on the axis: `T34:1` for `1*T34:1` or `at0*T34:1`; none
    /// if the line has no such place.
    pub fn without_place<'a>(&self, bracket: &'a str) -> Option<&'a str> {
        let along = self.along().ok()?;
        (0..along.places()).find_map(|place| bracket.strip_prefix(along.prefix(place).as_str()))
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
        assert!(thermal.functions(&subject(Quantity::Length, Quantity::Ratio)).is_err());
        let location = Subject { location: true, ..subject(Quantity::Angle, Quantity::Length) };
        assert!(thermal.functions(&location).is_err());
    }

    #[test]
    fn units_of_slopes() {
        let thermal = |extra: serde_json::Value| {
            let mut settings = json!({ "thermal": ["ECX"], "inputs": ["T2"], "time_constants_s": [250.0], "starts_warm": true,
                "log": step() });
            settings.as_object_mut().expect("a map").extend(extra.as_object().expect("a map").clone());
            family(settings)
        };
        for (of, command, gain, start) in [
            (Quantity::Length, Quantity::Length, "1/K", "mm/mm"),
            (Quantity::Angle, Quantity::Length, "rad/(mm K)", "rad/mm"),
            (Quantity::Angle, Quantity::Angle, "rad/(rad K)", "rad/rad"),
            (Quantity::Length, Quantity::Angle, "mm/(rad K)", "mm/rad"),
        ] {
            let functions = thermal(json!({ "slope": true })).functions(&subject(of, command)).expect("functions");
            let units = functions[0].terms().into_iter().map(|term| term.unit(of, command).to_string());
            assert_eq!(units.collect::<Vec<_>>(), [gain, start]);
        }
        let at = thermal(json!({ "positions_mm": [0, 50] })).functions(&subject(Quantity::Angle, Quantity::Length));
        let units = at.expect("functions")[0].terms().into_iter().map(|term| term.unit.expect("a unit").to_string());
        assert_eq!(units.collect::<Vec<_>>(), ["rad/K", "rad", "rad/K", "rad"]);
    }

    #[test]
    fn gains_at_positions_are_interpolated_and_not_beyond() {
        let thermal =
            family(json!({ "thermal": ["EYX"], "inputs": ["T2"], "time_constants_s": [250.0], "at_once": ["T1"],
            "positions_mm": [-100, 50, 300], "log": step() }));
        let functions = thermal.functions(&subject(Quantity::Length, Quantity::Length)).expect("functions");
        let functions = functions[0].as_ref();
        let expected = ["[at0*T2:1]", "[at0*T1]", "[at1*T2:1]", "[at1*T1]", "[at2*T2:1]", "[at2*T1]"];
        assert_eq!(names(functions), expected);
        assert_eq!((functions.range(), functions.breaks()), (Some([-100.0, 300.0]), &[50.0][..]));
        let at_rest =
            family(json!({ "thermal": ["EYX"], "inputs": ["T2"], "time_constants_s": [250.0], "at_once": ["T1"],
            "log": step() }));
        let everywhere = at_rest.functions(&subject(Quantity::Length, Quantity::Length)).expect("functions");
        let [state, reading] = values(everywhere[0].as_ref(), &[700.0, 250.0])[..] else { panic!("two terms") };
        for (command, weights) in [
            (-100.0, [1.0, 0.0, 0.0]),
            (-40.0, [0.6, 0.4, 0.0]),
            (50.0, [0.0, 1.0, 0.0]),
            (100.0, [0.0, 0.8, 0.2]),
            (300.0, [0.0, 0.0, 1.0]),
            // The model refuses what is beyond by more than a hundredth of the way.
            (302.0, [0.0, 0.0, 1.0]),
        ] {
            let found = values(functions, &[700.0, command, 250.0]);
            for (place, weight) in weights.into_iter().enumerate() {
                assert!((found[2 * place] - weight * state).abs() < 1e-15, "{command}: {found:?}");
                assert!((found[2 * place + 1] - weight * reading).abs() < 1e-15, "{command}: {found:?}");
            }
        }
        assert_eq!(thermal.without_place("at2*T2:1"), Some("T2:1"));
        assert_eq!(thermal.without_place("at3*T2:1"), None);
        assert_eq!(thermal.without_place("T2:1"), None);
        assert!(thermal.functions(&subject(Quantity::Length, Quantity::Ratio)).is_err());
        let said =
            thermal.functions(&subject(Quantity::Length, Quantity::Angle)).expect_err("a rotary axis").to_string();
        assert!(said.starts_with("positions_mm: the positions of a rotary axis are angles: `positions_deg`"), "{said}");
    }

    proptest::proptest! {
        #[test]
        fn slopes_are_those_of_the_values(time in 1.0..999.0_f64, constant in 20.0..5e3_f64, q in -500.0..500.0_f64) {
            for along in [json!(null), json!({ "slope": true }), json!({ "positions_mm": [-500, -499.5, 120, 500] })] {
                let mut settings = json!({ "thermal": ["EXX"], "inputs": ["T1", "T2"], "time_constants_s": [9.0, 250.0],
                    "at_once": ["T2"], "starts_warm": true, "reference_degC": 20.0, "log": step() });
                let has_command = along.is_object();
                settings.as_object_mut().expect("a map").extend(along.as_object().cloned().unwrap_or_default());
                let thermal = family(settings);
                let functions = thermal.functions(&subject(Quantity::Length, Quantity::Length)).expect("functions");
                let mut arguments = vec![time];
                arguments.extend(has_command.then_some(q));
                arguments.extend([constant / 10.0, constant]);
                // Not over a position.
                let near = |place: &f64| (q - place).abs() < 0.06;
                if has_command && [-500.0, -499.5, 120.0, 500.0].iter().any(near) {
                    continue;
                }
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
            (
                json!({ "thermal": ["EYX"], "at_once": ["T1"], "positions_mm": [5] }),
                "positions_mm: 2 positions at least were expected",
            ),
            (
                json!({ "thermal": ["EYX"], "at_once": ["T1"], "positions_mm": [5, 4] }),
                "positions_mm[1]: these have to increase",
            ),
            (
                json!({ "thermal": ["EYX"], "at_once": ["T1"], "positions_mm": [5, 6], "slope": true }),
                "slope: there are gains at positions already",
            ),
            (
                json!({ "thermal": ["EYX"], "at_once": ["T1"], "positions_mm": [5, 6], "positions_deg": [5, 6] }),
                "positions_deg: there is `positions_mm` already",
            ),
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
