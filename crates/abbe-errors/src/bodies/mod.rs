//! Bodies between the frames of a machine that grow and bend with their temperatures (Soons 1993, 3.4.2, eq. 3.56 to 3.62).
//!
//! A body is no family: its temperatures move a frame in all directions at once, and one number, the factor of the body, multiplies all
//! that. [`Body`] has the settings, [`BodyTerms`] are the six errors that they become at a frame of the model ([`Mount`]).

mod geometry;
mod temperatures;
mod terms;

use std::collections::BTreeMap;

use abbe_core::{Dataset, PathItem, Quantity, SettingsError, not_negative, positive};
use abbe_thermal::sensor_faults;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use terms::{BodyTerms, Guide, Mount};

use crate::log::{self, Columns, check_label, key};
use geometry::{difference, dot, norm};

/// A body of the machine: a straight beam with temperatures at sections. What stands still is held at `held_at_mm`, what it carries is
/// at its end. Points are machine coordinates with all axes at zero.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[allow(non_snake_case, reason = "units are written as in column names")]
pub struct Body {
    /// What holds it: `bed`, or the axis that carries it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from: Option<String>,
    /// What it carries: the next axis, `tool` or `workpiece`. Several bodies between the same two follow one another.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to: Option<String>,
    /// It is the guideway of this linear axis: straightness and rotation of the carriage along it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub guideway: Option<String>,
    /// It is the scale of this linear axis: positioning error.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scale: Option<String>,
    /// Where it begins, on its axis.
    pub begin_mm: [f64; 3],
    /// Where it ends.
    pub end_mm: [f64; 3],
    /// Where it is held, from its beginning: elongation, and bending unless it slides, count from there. Of a scale, and of a body that
    /// slides: where the scale (or its reading head) is fixed to it.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub held_at_mm: f64,
    /// Place from its beginning that is at the carriage (guideway), at the reading head (scale) or in the guide (a body that slides)
    /// with the axis at zero.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_zero_mm: Option<f64>,
    /// It moves through its guide, as a ram does: the place where it is guided follows the command of the axis `from`. A scale that
    /// slides is fixed to what moves.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub slides: bool,
    /// A point of the line that the scale measures along, with the axis at zero: where rotation of the carriage moves nothing along
    /// the guideway. Default: the guideway itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scale_point_mm: Option<[f64; 3]>,
    /// Sections with sensors, from the beginning. Temperatures run straight between sections and stay before the first and behind the
    /// last one.
    pub sections: Vec<Section>,
    /// Coefficient of linear thermal expansion.
    pub expansion_per_K: f64,
    /// Its standard uncertainty: that of the factor `body[name].factor`, if this is not estimated. Bodies are independent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub standard_uncertainty_per_K: Option<f64>,
    /// Temperature at which the body has its nominal shape. Default 20.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference_degC: Option<f64>,
    /// Each column of a log counts from the mean of its rows up to this time instead: idle minutes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference_until_s: Option<f64>,
    /// Longest time between two rows of the log. Default: five times the median.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub longest_gap_s: Option<f64>,
    /// The body is colder than its sensors while it turns: a tool.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub turning: Option<Turning>,
    /// Column of labels (`day`, `run`): each of its series of measurements has a log of its own, with its own clock and idle minutes, in
    /// rows with the same label.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub series: Option<String>,
    /// The columns of the log, as a calibration keeps them. Without them, those of the stage under `logs` of the machine.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub log: BTreeMap<String, Vec<f64>>,
    /// The logs by the labels of `series`, as a calibration keeps them.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub logs: BTreeMap<String, BTreeMap<String, Vec<f64>>>,
}

/// A section of a body with its sensors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[allow(non_snake_case, reason = "units are written as in column names")]
pub struct Section {
    /// Its place from the beginning of the body.
    pub at_mm: f64,
    /// Columns of a log or of the measurements, without unit (`T34` is the column `T34_degC`), each with the place of the sensor from the
    /// axis of the body in the directions of the machine.
    pub sensors: BTreeMap<String, [f64; 3]>,
    /// Coefficient of expansion from here to the next section, if it is not that of the body.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expansion_per_K: Option<f64>,
}

/// Forced convection cools what turns (Soons 1993, 5.1.3). At rest the body has the temperature T that its sensors read; while it turns it
/// tends to air + share (T - air).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Turning {
    /// Column of the log with the spindle speed: `n` is the column `n_rpm`.
    pub speed: String,
    /// The speed at which the share holds. It falls straight from 1 at rest, and stays at higher speeds.
    pub at_rpm: f64,
    /// Part of the elevation over the air that is left, 0 to 1.
    pub share: f64,
    /// Column of the log with the temperature of the air, without its unit.
    pub air: String,
    /// How slowly it follows.
    pub time_constant_s: f64,
}

/// The reference temperature of all lengths, °C (ISO 1).
const REFERENCE: f64 = 20.0;

/// The farthest that a sensor may be off the plane of its section, mm.
const OFF_PLANE: f64 = 0.5;

/// No material expands by more, 1/K.
const LARGEST: f64 = 1e-3;

/// No point is farther, mm.
const FARTHEST: f64 = 1e6;

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde asks for a reference")]
fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// What a body is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BodyKind<'a> {
    /// It lies between two frames.
    Between(&'a str, &'a str),
    /// It guides this axis.
    Guideway(&'a str),
    /// It measures this axis.
    Scale(&'a str),
}

impl Body {
    /// What it is.
    ///
    /// Fails unless it is one of the three.
    pub fn kind(&self) -> Result<BodyKind<'_>, SettingsError> {
        match (&self.from, &self.to, &self.guideway, &self.scale) {
            (Some(from), Some(to), None, None) => Ok(BodyKind::Between(from, to)),
            (None, None, Some(axis), None) => Ok(BodyKind::Guideway(axis)),
            (None, None, None, Some(axis)) => Ok(BodyKind::Scale(axis)),
            _ => Err(SettingsError::new("", "`from` and `to`, or `guideway`, or `scale` was expected")),
        }
    }

    /// Its length, mm.
    pub fn length(&self) -> f64 {
        norm(difference(self.end_mm, self.begin_mm))
    }

    /// The direction from its beginning to its end, machine frame.
    pub fn direction(&self) -> [f64; 3] {
        difference(self.end_mm, self.begin_mm).map(|way| way / self.length())
    }

    /// Names of its sensors, each once.
    pub fn sensors(&self) -> Vec<&str> {
        let mut names: Vec<&str> = Vec::new();
        for name in self.sections.iter().flat_map(|section| section.sensors.keys()) {
            if !names.contains(&name.as_str()) {
                names.push(name);
            }
        }
        names
    }

    /// Sensors that are columns of the measurements and not of a log.
    pub fn sensors_of_rows(&self) -> Vec<&str> {
        let mut names = self.sensors();
        names.retain(|name| !self.columns().any(|header| Quantity::of_column(header).0 == *name));
        names
    }

    /// The columns of its log, or of each of its logs, by their names with units; none before they are known.
    pub(super) fn columns(&self) -> impl Iterator<Item = &String> {
        std::iter::once(&self.log)
            .chain(self.logs.values())
            .find(|log| !log.is_empty())
            .into_iter()
            .flat_map(Columns::keys)
    }

    /// Whether it finds temperatures by time.
    pub fn has_log(&self) -> bool {
        self.columns().next().is_some()
    }

    /// Checks the settings as far as they do not depend on the machine.
    pub fn check(&self) -> Result<(), SettingsError> {
        let kind = self.kind()?;
        for (setting, point) in [("begin_mm", self.begin_mm), ("end_mm", self.end_mm)] {
            within(setting, &point)?;
        }
        if self.length() < 1e-3 {
            return Err(SettingsError::new("end_mm", "the body ends where it begins: another point was expected"));
        }
        self.scale_point_mm.map_or(Ok(()), |point| within("scale_point_mm", &point))?;
        if self.scale_point_mm.is_some() && !matches!(kind, BodyKind::Guideway(_)) {
            return Err(SettingsError::new("scale_point_mm", "only a guideway has one"));
        }
        if self.slides && matches!(kind, BodyKind::Guideway(_)) {
            let error = SettingsError::new("slides", "a guideway stands still; what slides in it is another body");
            return Err(error.help("give the body that moves `from` this axis, `to` the next, and `slides: true`"));
        }
        self.on_body("held_at_mm", self.held_at_mm)?;
        match (self.at_zero_mm, self.slides || !matches!(kind, BodyKind::Between(..))) {
            (Some(place), true) if place.is_finite() => (),
            (None, false) => (),
            (None, true) => {
                let message = "the place on the body that the axis is at when its command is zero was expected";
                return Err(SettingsError::new("at_zero_mm", message));
            }
            (Some(_), true) => return Err(SettingsError::new("at_zero_mm", "a finite number was expected")),
            (Some(_), false) => {
                return Err(SettingsError::new("at_zero_mm", "only guideways, scales and bodies that slide have one"));
            }
        }
        self.check_sections()?;
        expansion("expansion_per_K", self.expansion_per_K)?;
        not_negative("standard_uncertainty_per_K", self.standard_uncertainty_per_K.unwrap_or(0.0))?;
        if self.reference_degC.is_some() && self.reference_until_s.is_some() {
            return Err(SettingsError::new("reference_until_s", "there is `reference_degC` already"));
        }
        for (setting, value) in [("reference_degC", self.reference_degC), ("reference_until_s", self.reference_until_s)]
        {
            if value.is_some_and(|value| !value.is_finite()) {
                return Err(SettingsError::new(setting, "a finite number was expected"));
            }
        }
        self.longest_gap_s.map_or(Ok(()), |gap| positive("longest_gap_s", gap).map(drop))?;
        check_label(self.series.as_ref())?;
        self.turning.as_ref().map_or(Ok(()), |turning| turning.check().map_err(|error| error.under([key("turning")])))
    }

    /// Refuses a place beyond the ends.
    fn on_body(&self, setting: &str, place: f64) -> Result<(), SettingsError> {
        let length = self.length();
        if (-1e-9..=length + 1e-9).contains(&place) {
            return Ok(());
        }
        Err(SettingsError::new(
            setting,
            format!("{place} mm is beyond the ends of the body, which is {length:.3} mm long"),
        ))
    }

    fn check_sections(&self) -> Result<(), SettingsError> {
        if self.sections.is_empty() {
            return Err(SettingsError::new("sections", "at least one section with a sensor was expected"));
        }
        let direction = self.direction();
        for (index, section) in self.sections.iter().enumerate() {
            let at = [key("sections"), PathItem::Index(index)];
            self.on_body("at_mm", section.at_mm).map_err(|error| error.under(at.clone()))?;
            if index > 0 && self.sections[index - 1].at_mm >= section.at_mm {
                return Err(SettingsError::new("at_mm", "these have to increase").under(at));
            }
            if let Some(value) = section.expansion_per_K {
                if index + 1 == self.sections.len() {
                    let message = "no section follows; that of the section before holds to the end";
                    return Err(SettingsError::new("expansion_per_K", message).under(at));
                }
                expansion("expansion_per_K", value).map_err(|error| error.under(at.clone()))?;
            }
            if section.sensors.is_empty() {
                return Err(SettingsError::new("sensors", "at least one sensor was expected").under(at));
            }
            for (name, place) in &section.sensors {
                let at = [key("sections"), PathItem::Index(index), key("sensors")];
                column(name, name).map_err(|error| error.under(at.clone()))?;
                within(name, place).map_err(|error| error.under(at.clone()))?;
                let off = dot(*place, direction);
                if off.abs() > OFF_PLANE {
                    let message = format!(
                        "the sensor is {off:.3} mm off the plane of its section, which is at right angles to the body"
                    );
                    let error = SettingsError::new(name, message);
                    return Err(error
                        .help("give its place from the axis of the body, or a section of its own")
                        .under(at));
                }
            }
        }
        Ok(())
    }

    /// Takes the columns of a log that has its sensors. It takes the place of one that the settings keep. Sensors that no log has are
    /// columns of the measurements.
    ///
    /// Fails if logs have only some of the columns each, and for logs with gaps, clocks that jump, and sensors without a reading. Another
    /// log than that of the settings has no idle minutes that they could mean.
    pub fn settle(&mut self, data: &[&Dataset]) -> Result<(), SettingsError> {
        if self.has_log() && data.iter().any(|data| data.is_log) {
            if self.reference_until_s.is_some() {
                let message =
                    "counts from the idle minutes of the log that it was measured with, and another log is given";
                let error = SettingsError::new("reference_until_s", message);
                return Err(error.help("calibrate with `reference_degC`"));
            }
            let columns: Vec<String> = self.columns().map(|header| Quantity::of_column(header).0.to_owned()).collect();
            let columns: Vec<&str> = columns.iter().map(String::as_str).filter(|name| *name != "time").collect();
            let found = log::with_columns(data, &columns).map_err(|error| error.under([key("sections")]))?;
            if let Some(found) = found {
                self.log = log::kept(found, &columns);
                (self.series, self.logs) = (None, BTreeMap::new());
            }
        }
        if !self.has_log() && !data.is_empty() {
            let in_a_log = |name: &&str| data.iter().any(|data| data.is_log && data.numbers(name).is_some());
            let mut columns = self.sensors();
            match &self.turning {
                Some(turning) => columns.extend([turning.speed.as_str(), turning.air.as_str()]),
                None => columns.retain(in_a_log),
            }
            let columns: Vec<String> = columns.into_iter().map(str::to_owned).collect();
            self.find(data, &columns.iter().map(String::as_str).collect::<Vec<_>>())?;
        }
        if let (Some(series), false) = (&self.series, data.is_empty()) {
            log::check_series(data, series, &self.logs)?;
        }
        if let (Some(name), Some(_), false) = (self.sensors_of_rows().first(), self.reference_until_s, data.is_empty())
        {
            let message = format!("`{name}` is no column of a log of the machine; only a log has idle minutes");
            let error = SettingsError::new("reference_until_s", message);
            return Err(error.help("name the log by `logs: sensors` at the machine, or give `reference_degC`"));
        }
        temperatures::Temperatures::new(self, &[]).map(drop)
    }

    /// Takes these columns of a log, or of each log of its series.
    fn find(&mut self, data: &[&Dataset], columns: &[&str]) -> Result<(), SettingsError> {
        let at_sections = |error: SettingsError| match error.path.is_empty() {
            true => error.under([key("sections")]),
            false => error,
        };
        match &self.series {
            Some(series) if columns.is_empty() => {
                let message =
                    format!("no sensor of this body is a column of a log, which could have one for each {series}");
                Err(SettingsError::new("series", message))
            }
            Some(series) => {
                self.logs = log::by_series(data, columns, series).map_err(at_sections)?;
                Ok(())
            }
            None if columns.is_empty() => Ok(()),
            None => {
                let found = log::with_columns(data, columns).map_err(at_sections)?;
                self.log = found.map(|found| log::kept(found, columns)).unwrap_or_default();
                Ok(())
            }
        }
    }
}

/// Difference of a sensor from the middle of all in idle minutes, K: parts of a machine at rest are not that far apart.
const APART: f64 = 10.0;

impl Body {
    /// What looks like the fault of a sensor, in words: one that jumps or is stuck, or reads far from the others in the idle minutes.
    pub fn faults(&self) -> Vec<String> {
        let each = log::each((&self.log, &self.logs), None, |log| Ok(self.faults_in(log))).unwrap_or_default();
        let of = |label: Option<&str>| match (&self.series, label) {
            (Some(series), Some(label)) => format!(" ({series} {label})"),
            _ => String::new(),
        };
        each.into_iter().flat_map(|(label, told)| told.into_iter().map(move |told| told + &of(label))).collect()
    }

    fn faults_in(&self, log: &Columns) -> Vec<String> {
        let of_each = |name: &str| sensor_faults(name, log::readings(log, name).unwrap_or_default());
        let mut told: Vec<String> = self.sensors().iter().flat_map(|name| of_each(name)).collect();
        told.extend(self.apart_in(log));
        told
    }

    /// Sensors that read far from what the others read in the idle minutes.
    fn apart_in(&self, log: &Columns) -> Vec<String> {
        let (Some(until), Some(times)) = (self.reference_until_s, log::readings(log, "time")) else {
            return Vec::new();
        };
        let rows = times.iter().filter(|time| **time <= until).count();
        let mean = |name: &&str| {
            let readings = log::readings(log, name)?.get(..rows).filter(|rows| !rows.is_empty())?;
            Some(readings.iter().sum::<f64>() / readings.len() as f64)
        };
        let sensors = self.sensors();
        let means: Vec<(&str, f64)> = sensors.iter().filter_map(|name| Some((*name, mean(name)?))).collect();
        let mut sorted: Vec<f64> = means.iter().map(|(_, mean)| *mean).collect();
        sorted.sort_by(f64::total_cmp);
        let Some(middle) = sorted.get(sorted.len() / 2).copied().filter(|_| sorted.len() > 2) else {
            return Vec::new();
        };
        let apart = means.iter().filter(|(_, mean)| (mean - middle).abs() > APART);
        let words = |(name, mean): &(&str, f64)| {
            format!(
                "{name} reads {mean:.1} °C in the idle minutes, and the middle one of the sensors of this body {middle:.1} °C: is it in °C?"
            )
        };
        apart.map(words).collect()
    }
}

impl Turning {
    fn check(&self) -> Result<(), SettingsError> {
        column("speed", &self.speed)?;
        column("air", &self.air)?;
        positive("at_rpm", self.at_rpm)?;
        positive("time_constant_s", self.time_constant_s)?;
        if !(0.0..=1.0).contains(&self.share) {
            return Err(SettingsError::new("share", format!("{}: a number from 0 to 1 was expected", self.share)));
        }
        Ok(())
    }

    /// The share at a speed, rpm.
    fn share_at(&self, speed: f64) -> f64 {
        1.0 - (1.0 - self.share) * (speed.abs() / self.at_rpm).min(1.0)
    }
}

/// Refuses what is no name of a column without its unit.
fn column(setting: &str, name: &str) -> Result<(), SettingsError> {
    let (base, quantity, _) = Quantity::of_column(name);
    if quantity == Quantity::Label && !base.is_empty() {
        return Ok(());
    }
    let message = format!("the name of a column without its unit was expected, not `{name}`");
    Err(SettingsError::new(setting, message).help("`T34` is the column `T34_degC`"))
}

fn within(setting: &str, point: &[f64; 3]) -> Result<(), SettingsError> {
    if point.iter().all(|coordinate| coordinate.abs() <= FARTHEST) {
        return Ok(());
    }
    Err(SettingsError::new(setting, format!("three numbers from -{FARTHEST} to {FARTHEST} were expected")))
}

fn expansion(setting: &str, value: f64) -> Result<(), SettingsError> {
    if value != 0.0 && value.abs() <= LARGEST {
        return Ok(());
    }
    let error =
        SettingsError::new(setting, format!("{value}: a coefficient up to {LARGEST} per K, not 0, was expected"));
    Err(error.help("steel has 11.5e-6"))
}
