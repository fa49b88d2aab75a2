//! Nominal axes, time scales of drifts and temperatures of scales, from settings and data.

use std::collections::BTreeSet;

use abbe_core::{AxisKind, Dataset, PathItem, SettingsError, Values};
use abbe_errors::{Body, Drift, Expansion, Per};
use abbe_kinematics::{ChainAxis, ErrorFrame, NamedAxis};
use nalgebra::Vector3;

use crate::builder::key;
use crate::settings::{self, Settings};

/// No axis goes farther, mm and degrees.
pub(crate) const FARTHEST: f64 = 1e6;

/// Longest tool that nobody asks about, mm, and in longest travels of linear axes.
const LONG_MM: f64 = 500.0;
const LONG: f64 = 3.0;

/// The sentence on a tool of a length below zero, or on one that with its probe and styli is far longer than the machine moves: its sign,
/// its unit or a digit is wrong. Where lengths alone are measured no residual tells it, and errors far from the axes are wrong.
pub(crate) fn doubtful_tool(settings: &Settings) -> Option<String> {
    let length = settings.tool_length_mm;
    if length < 0.0 {
        return Some(format!(
            "`tool_length_mm` is {length}: a tool reaches from the end of the chain to -z by its length; is its sign right?"
        ));
    }
    let travels = settings.axes.values().filter_map(|axis| axis.range_mm).map(|[from, to]| to - from);
    let longest = travels.reduce(f64::max)?;
    let offset = settings.probe_offset_mm.map(|offset| ("`probe_offset_mm`".to_owned(), offset));
    let tips = settings.styli.iter().filter_map(|(number, stylus)| Some((number, stylus.tip()?)));
    let tips = tips.map(|(number, tip)| (format!("the tip of stylus {number}"), tip));
    let places = offset.into_iter().chain(tips).map(|(name, place)| (name, Vector3::from(place).amax()));
    let tool = std::iter::once(("`tool_length_mm`".to_owned(), length));
    let (name, length) = tool.chain(places).find(|(_, length)| *length > LONG_MM.max(LONG * longest))?;
    Some(format!(
        "{name} is {length}, {:.0} times the longest travel of a linear axis ({longest} mm): is it in millimetres?",
        length / longest
    ))
}

/// Nominal geometry of one axis.
pub(crate) fn chain_axis(named: &NamedAxis, settings: &Settings) -> Result<ChainAxis, SettingsError> {
    let given = settings.axes.get(&named.name).cloned().unwrap_or_default();
    let at = |setting: &str, message: String| {
        Err(SettingsError::new(setting, message).under([key("axes"), key(&named.name)]))
    };
    let kind = named.kind();
    let (fits, wrong, right) = match kind {
        AxisKind::Linear => (given.range_mm, given.range_deg.map(|_| "range_deg"), "a length: `range_mm`"),
        AxisKind::Rotary => (given.range_deg, given.range_mm.map(|_| "range_mm"), "an angle: `range_deg`"),
    };
    if let Some(wrong) = wrong {
        return at(wrong, format!("the range of axis {} is {right}", named.name));
    }
    if let Some([from, to]) = fits
        && !(from.abs() <= FARTHEST && to.abs() <= FARTHEST && from < to)
    {
        let setting = if kind == AxisKind::Linear { "range_mm" } else { "range_deg" };
        let message = format!("a range is two numbers from -{FARTHEST} to {FARTHEST}, the smaller one first");
        return at(setting, message);
    }
    if given.endless && kind == AxisKind::Linear {
        return at("endless", format!("axis {} is linear, and has an end", named.name));
    }
    let direction = Vector3::from(given.direction.unwrap_or(named.direction()));
    if !(direction.norm() > 1e-6 && direction.norm().is_finite()) {
        return at("direction", "a direction is three numbers that are not all zero".to_owned());
    }
    let point = Vector3::from(given.point_mm.unwrap_or_default());
    if !point.norm().is_finite() {
        return at("point_mm", "three finite numbers were expected".to_owned());
    }
    let error_frame = match given.error_frame.unwrap_or(settings.error_frame) {
        settings::ErrorFrame::Moving => ErrorFrame::Moving,
        settings::ErrorFrame::Fixed => ErrorFrame::Fixed,
    };
    let name = named.name.clone();
    Ok(ChainAxis { name, kind, branch: named.branch, direction, point, reverse: given.reverse, error_frame })
}

/// Refuses data without the temperature of a scale: its expansion would be left out without a message.
pub(crate) fn temperature_is_there(expansion: &Expansion, data: &[&Dataset]) -> Result<(), SettingsError> {
    let name = expansion.temperature.as_str();
    let Some(file) = lacks_temperature(name, data) else { return Ok(()) };
    let message = format!(
        "{file} has no column `{name}_degC`, the temperature of the scale; write it into the file, or `constants: {{ {name}_degC: 20 }}` at its ingest stage"
    );
    Err(SettingsError::new("temperature", message))
}

/// The first file of measurements without the column of a temperature.
fn lacks_temperature(name: &str, data: &[&Dataset]) -> Option<String> {
    // Data with several poses a row may have one column for each: `T_X`, or `T_X1` and `T_X2`.
    let is_it =
        |header: &str| header.strip_prefix(name).is_some_and(|end| end.chars().all(|digit| digit.is_ascii_digit()));
    let lacks = |data: &&&Dataset| !data.is_log && !data.columns.iter().any(|column| is_it(&column.header.name));
    data.iter().find(lacks).map(|data| file_of(data))
}

fn file_of(data: &Dataset) -> String {
    data.files.first().map_or_else(|| "a data set".to_owned(), |file| file.display().to_string())
}

/// Refuses data without times: their thermal errors would be left out without a message.
pub(crate) fn time_is_there(data: &[&Dataset]) -> Result<(), SettingsError> {
    let lacks = |data: &&&Dataset| data.numbers("time").is_none();
    let Some(data) = data.iter().find(lacks) else { return Ok(()) };
    let error = SettingsError::new(
        "thermal",
        format!("{} has no column `time_s`, by which temperatures are found", file_of(data)),
    );
    Err(error
        .help("write it into the file, on the clock of the log, or `constants: { time_s: 0 }` at its ingest stage"))
}

/// Checks a body, and takes its temperatures from the data: from a log, or from the measurements, which then have to have them. `told` are
/// faults of sensors that have been told of other bodies.
pub(crate) fn settle_body(
    body: &mut Body,
    data: &[&Dataset],
    told: &mut BTreeSet<String>,
) -> Result<(), SettingsError> {
    body.check()?;
    body.settle(data)?;
    if !data.is_empty() {
        let faults = body.faults().into_iter();
        // Bodies share sensors.
        faults.filter(|fault| told.insert(fault.clone())).for_each(|fault| tracing::warn!("{fault}"));
    }
    if body.has_log() {
        let sections = |error: SettingsError| SettingsError { path: vec![key("sections")], ..error };
        time_is_there(data).map_err(sections)?;
    }
    for name in body.sensors_of_rows() {
        let Some(file) = lacks_temperature(name, data) else { continue };
        let section = body.sections.iter().position(|section| section.sensors.contains_key(name)).unwrap_or_default();
        let message =
            format!("the machine has no log with the column `{name}_degC`, and {file} does not have it either");
        let error =
            SettingsError::new(name, message).under([key("sections"), PathItem::Index(section), key("sensors")]);
        return Err(error.help("`logs` at the machine names the ingest stage that reads the temperatures"));
    }
    Ok(())
}

/// First and last time of every series of a drift: those of the settings, else those of the data. So the time scale stays the
/// same in folds and subsets of the rows.
pub(crate) fn settle_time(drift: &mut Drift, data: &[&Dataset]) -> Result<(), SettingsError> {
    if drift.time_s.is_empty() {
        for data in data.iter().filter(|data| !data.is_log) {
            let Some(times) = data.numbers("time") else { continue };
            let labels = drift.per.column().and_then(|column| data.column(column)).map(|column| &column.values);
            for (row, &time) in times.iter().enumerate() {
                let label = match (drift.per, labels) {
                    (Per::DataSet, _) => "",
                    (_, Some(Values::Labels(labels))) => &labels[row],
                    _ => continue,
                };
                let range = drift.time_s.entry(label.to_owned()).or_insert([time, time]);
                *range = [range[0].min(time), range[1].max(time)];
            }
        }
        if drift.time_s.is_empty() && !data.is_empty() {
            let columns = drift.per.column().map_or(String::new(), |column| format!(" and `{column}`"));
            return Err(SettingsError::new("drift", format!("no data set has the columns `time_s`{columns}")));
        }
    }
    if drift.time_s.is_empty() && drift.per == Per::DataSet {
        drift.time_s.insert(String::new(), [0.0, 1.0]);
    }
    match drift.time_s.iter().find(|(_, range)| !data.is_empty() && range[0] >= range[1]) {
        None => Ok(()),
        Some((label, range)) => Err(SettingsError::new(
            "drift",
            format!("the series `{label}` has the single time {} s; a drift needs a span of time", range[0]),
        )),
    }
}
