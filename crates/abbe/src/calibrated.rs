//! What commands that act upon a calibration share: reading it, its age, its machine.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use abbe_compensation::{Temperatures, check_no_drift, extrapolated, follows_log};
use abbe_core::{
    Axis, AxisKind, Branch, Build, Calibration, Context, Error, Kind, KinematicModel, Poses, Quantity, Registry, Result,
};
use abbe_engine::{RunRecord, model_with_log};
use abbe_files::{LARGEST_RESULT, read_text};
use clap::Args;
use serde_json::{Value, json};

/// A calibration, and what is asked of it.
#[derive(Debug, Clone, Args)]
pub struct Asked {
    /// The calibration: `<estimate>.calibration.json` of a run.
    calibration: PathBuf,
    /// Machine file of the machine that this is for. The calibration of one with another chain, or other axes, is refused.
    #[arg(long, value_name = "FILE")]
    machine: Option<PathBuf>,
    /// Refuse a calibration of a run that is older than this; `run.json` beside it tells when it was.
    #[arg(long, value_name = "DAYS", value_parser = days, allow_negative_numbers = true)]
    max_age_days: Option<f64>,
    /// Log of temperatures, CSV, where errors follow temperatures: `time_s` on the clock of the set-points, and the sensors. It takes
    /// the place of the log of the calibration.
    #[arg(long, value_name = "FILE")]
    log: Option<PathBuf>,
    /// The time of all set-points on the clock of the log, or `end` for its last row, if they have no column `time_s`.
    #[arg(long, value_name = "SECONDS", value_parser = moment, allow_negative_numbers = true, requires = "log")]
    at: Option<Moment>,
    /// The machine has the temperatures from which its errors count: leave out all that follows temperatures, or time.
    #[arg(long, conflicts_with = "log")]
    at_reference: bool,
}

/// A time of a log.
#[derive(Debug, Clone, Copy)]
enum Moment {
    Seconds(f64),
    End,
}

fn moment(text: &str) -> std::result::Result<Moment, String> {
    let seconds = text.parse::<f64>().ok().filter(|seconds| seconds.is_finite());
    match (text, seconds) {
        ("end", _) => Ok(Moment::End),
        (_, Some(seconds)) => Ok(Moment::Seconds(seconds)),
        _ => Err("a number of seconds, or `end`, was expected".to_owned()),
    }
}

/// A calibration with its model, and the time of set-points if it was given.
pub struct Known {
    /// The calibration.
    pub calibration: Calibration,
    /// Its model; errors follow the log that was given.
    pub model: Arc<dyn KinematicModel>,
    /// The time of all set-points, s; NaN for a machine at its reference temperatures.
    pub time: Option<f64>,
    /// The log that was given.
    pub log: Option<Temperatures>,
}

impl Asked {
    /// The calibration file.
    pub fn file(&self) -> &Path {
        &self.calibration
    }

    /// Reads the calibration and builds its model.
    pub fn read(&self, registry: &Registry) -> Result<Known> {
        self.read_for(registry, true)
    }

    /// The same for a program, which has tools of its own.
    pub fn read_for_program(&self, registry: &Registry) -> Result<Known> {
        self.read_for(registry, false)
    }

    fn read_for(&self, registry: &Registry, of_own_tool: bool) -> Result<Known> {
        let file = &self.calibration;
        let calibration = read(file)?;
        check_as_written(file)?;
        self.max_age_days.map_or(Ok(()), |most| check_age(file, most))?;
        let log = self.log.as_deref().map(|log| temperatures(&calibration, log)).transpose()?;
        if log.is_none() && !self.at_reference && follows_log(&calibration) {
            let error = Error::usage("errors of this calibration follow temperatures, and the log is missing");
            let help = "give the temperatures of now: `--log FILE`; `--at-reference` leaves them out";
            return Err(error.help(help).in_file(file));
        }
        let model = model_with_log(&calibration, log.as_ref().map(Temperatures::data), registry);
        let model = model.map_err(|error| error.in_file(self.log.as_ref().unwrap_or(file)))?;
        let time = match (self.at, &log) {
            (Some(Moment::Seconds(time)), _) => Some(time),
            (Some(Moment::End), Some(log)) => Some(log.end()),
            _ => self.at_reference.then_some(f64::NAN),
        };
        if let Some(machine) = &self.machine {
            check_machine(model.as_ref(), &calibration, file, machine, registry)?;
            tell_tool_and_travel(model.as_ref(), &calibration, machine, of_own_tool)?;
        }
        tell_unknown_travel(model.as_ref());
        Ok(Known { calibration, model, time, log })
    }
}

/// The log that takes the place of the one of a calibration.
fn temperatures(calibration: &Calibration, file: &Path) -> Result<Temperatures> {
    if !follows_log(calibration) {
        return Err(Error::usage("no error of this calibration follows a log of temperatures").in_file(file));
    }
    check_no_drift(calibration)?;
    let log = Temperatures::read(file)?;
    log.check_moves(calibration).map_err(|error| error.in_file(file))?;
    for beyond in log.beyond(calibration) {
        tracing::warn!("{beyond}: corrections are extrapolated");
    }
    if let Some(sentence) = log.too_fast(calibration) {
        tracing::warn!("{sentence}");
    }
    Ok(log)
}

fn read(file: &Path) -> Result<Calibration> {
    let unreadable = |error: std::io::Error| {
        Error::usage(format!("the file cannot be read: {}", abbe_files::why(&error))).in_file(file)
    };
    let text = read_text(file, LARGEST_RESULT).map_err(unreadable)?;
    Calibration::from_json(&text).map_err(|error| error.in_file(file))
}

/// A length above 0, at most that of a setting in mm.
pub fn positive_mm(text: &str) -> std::result::Result<f64, String> {
    above_zero(text, "mm", 1e6)
}

/// An angle above 0, at most that of a setting in mrad.
pub fn positive_mrad(text: &str) -> std::result::Result<f64, String> {
    above_zero(text, "mrad", 1e4)
}

fn days(text: &str) -> std::result::Result<f64, String> {
    above_zero(text, "days", 1e6)
}

/// A number above 0 of some unit.
pub fn above_zero(text: &str, unit: &str, most: f64) -> std::result::Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|number| *number > 0.0 && *number <= most);
    number.ok_or_else(|| format!("a number of {unit} above 0, at most {most}, was expected"))
}

/// Refuses a calibration that was changed after its run; says so where the record of the run is there and cannot tell.
fn check_as_written(file: &Path) -> Result<()> {
    let (record, Some(name)) = (file.with_file_name("run.json"), file.file_name()) else { return Ok(()) };
    if record.symlink_metadata().is_err() {
        return Ok(());
    }
    let text = read_text(&record, LARGEST_RESULT).map_err(|error| abbe_files::why(&error));
    match text.and_then(|text| RunRecord::from_json(&text).map_err(|error| error.message)) {
        Ok(run) => {
            let folder = file.parent().unwrap_or(Path::new(""));
            run.written_text(folder, &name.to_string_lossy()).map(drop)
        }
        Err(why) => {
            tracing::warn!(
                "whether {} is as its run wrote it cannot be told: {} is no record of a run: {why}",
                file.display(),
                record.display()
            );
            Ok(())
        }
    }
}

/// Refuses a calibration of a run that is too old, or of which the time is not known.
fn check_age(file: &Path, most: f64) -> Result<()> {
    let record = file.with_file_name("run.json");
    if record.symlink_metadata().is_err() {
        let message = format!("how old the calibration is cannot be told without `{}`", record.display());
        return Err(Error::data(message).in_file(file).help("use the calibration in the folder of its run"));
    }
    let broken = |why: &str| {
        let message = format!("how old the calibration is cannot be told: this is no record of a run: {why}");
        let help = "use the calibration in a folder that `abbe run` wrote, with `run.json` as it was written";
        Error::data(message).in_file(&record).help(help)
    };
    let text = read_text(&record, LARGEST_RESULT).map_err(|error| broken(&error.to_string()))?;
    let run = RunRecord::from_json(&text).map_err(|error| broken(&error.message))?;
    let name = file.file_name().unwrap_or_default().to_string_lossy();
    if !abbe_files::read(file, LARGEST_RESULT).is_ok_and(|content| run.wrote(&name, &content)) {
        let message = format!("`{}` is not of the run that wrote this file as it is now", record.display());
        return Err(Error::data(message).help("use the calibration in the folder of its run").in_file(file));
    }
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or(Duration::ZERO).as_secs_f64();
    let days = (now - run.started_unix_s as f64) / 86_400.0;
    if days < -1.0 {
        let message = format!("`{}` is {:.1} days in the future: is the clock right?", record.display(), -days);
        return Err(Error::data(message).in_file(file));
    }
    if days > most {
        let message = format!("the calibration is {days:.1} days old; at most {most} were allowed");
        return Err(Error::data(message).help("calibrate again").in_file(file));
    }
    Ok(())
}

/// Refuses the calibration of a machine with another chain than that of a machine file, or with axes of other directions.
fn check_machine(
    model: &dyn KinematicModel,
    calibration: &Calibration,
    file: &Path,
    machine: &Path,
    registry: &Registry,
) -> Result<()> {
    let plugin = &calibration.model.plugin;
    let wrong = |error: &dyn std::fmt::Display| {
        Error::usage(format!("this is no machine file of `{plugin}`: {error}")).in_file(machine)
    };
    let described = abbe_recipe::machine_description(machine)?;
    let of_calibration = |key: &str, absent: Value| calibration.model.settings.get(key).cloned().unwrap_or(absent);
    let mut nominal = json!({ "axes": described.get("axes").unwrap_or(&json!({})), "stylus_radius_mm": 0 });
    match described.get("robot") {
        // A robot has its tip in its description.
        Some(robot) => {
            nominal["robot"] = robot.clone();
            nominal["tool_length_mm"] = json!(0);
        }
        // Tool and stylus do not matter here: those of the calibration.
        None => {
            nominal["chain"] = described["chain"].clone();
            nominal["tool_length_mm"] = of_calibration("tool_length_mm", json!(0));
            nominal["probe_offset_mm"] = of_calibration("probe_offset_mm", Value::Null);
        }
    }
    let found = registry.find(Kind::Model, plugin).map_err(|error| wrong(&error))?;
    let Build::Model(constructor) = &found.build else { return Err(wrong(&"it is no model")) };
    let context = Context { base: machine.parent().unwrap_or(Path::new(".")).to_owned() };
    let other = constructor
        .build(&nominal, &context)
        .map_err(|error| wrong(&error))?
        .build(&[])
        .map_err(|error| wrong(&error))?;
    let of = |model: &dyn KinematicModel| -> Vec<(String, Branch, [f64; 3], f64)> {
        let axes = model.info().axes.iter();
        let directed = |axis: &Axis| axis.direction.map(|part| part * axis.sense);
        axes.map(|axis| (axis.name.clone(), axis.branch, directed(axis), axis.sense)).collect()
    };
    let (ours, theirs) = (of(model), of(other.as_ref()));
    let refused = |message: String| {
        Err(Error::data(format!("this is the calibration of another machine: {message}")).in_file(file))
    };
    let names = |axes: &[(String, Branch, [f64; 3], f64)]| {
        let side = |branch| if branch == Branch::Workpiece { "'" } else { "" };
        axes.iter().map(|(name, branch, ..)| format!("{name}{}", side(*branch))).collect::<Vec<_>>().join(" ")
    };
    if names(&ours) != names(&theirs) {
        let message = format!("its axes are {}, those of {} are {}", names(&ours), machine.display(), names(&theirs));
        return refused(message);
    }
    for ((axis, _, own, sense), (.., direction, of_other)) in ours.iter().zip(&theirs) {
        let apart: f64 = own.iter().zip(direction).map(|(one, other)| (one - other).abs()).sum();
        if apart > 1e-6 {
            // As machine files state them, and without minus zeros.
            let stated = |direction: &[f64; 3], sense: f64| direction.map(|part| part * sense + 0.0);
            let (own, direction) = (stated(own, *sense), stated(direction, *of_other));
            let message =
                format!("its axis {axis} has the direction {own:?}, that of {} {direction:?}", machine.display());
            return refused(message);
        }
    }
    let apart = tips_apart(model, other.as_ref())?;
    if apart > SAME_TIP {
        let message = format!(
            "without errors its tip is up to {apart:.6} mm from that of {}: points or directions of axes differ",
            machine.display()
        );
        return refused(message);
    }
    Ok(())
}

/// Says where the tool and the travels of a calibration are not those of a machine file: a recipe may have set others, or it is another
/// machine of the same kind.
fn tell_tool_and_travel(
    model: &dyn KinematicModel,
    calibration: &Calibration,
    machine: &Path,
    of_own_tool: bool,
) -> Result<()> {
    let described = abbe_recipe::machine_description(machine)?;
    let length = |settings: &Value| settings.get("tool_length_mm").and_then(Value::as_f64);
    if let (Some(own), Some(other)) = (length(&calibration.model.settings), length(&described))
        && of_own_tool
        && (own - other).abs() > SAME_LENGTH
    {
        tracing::warn!(
            "the tool of the calibration is {own} mm long, that of {} is {other} mm: is it the machine and the tool of this calibration?",
            machine.display()
        );
    }
    for axis in &model.info().axes {
        let (key, factor, unit) = match axis.kind {
            AxisKind::Linear => ("range_mm", 1.0, "mm"),
            AxisKind::Rotary => ("range_deg", 1_f64.to_degrees(), "°"),
        };
        let ends = described.get("axes").and_then(|axes| axes.get(&axis.name)?.get(key)?.as_array());
        let ends: Option<Vec<f64>> = ends.and_then(|ends| ends.iter().map(Value::as_f64).collect());
        let (Some(own), Some([from, to])) = (axis.range, ends.as_deref()) else { continue };
        let own = own.map(|end| (end * factor * 1e6).round() / 1e6);
        if (own[0] - from).abs() > SAME_LENGTH || (own[1] - to).abs() > SAME_LENGTH {
            tracing::warn!(
                "{} goes from {} to {} {unit} in the calibration, and from {from} to {to} {unit} in {}: is it this machine?",
                axis.name,
                own[0],
                own[1],
                machine.display()
            );
        }
    }
    Ok(())
}

/// Lengths and positions, mm and degrees, that are the same in a calibration and a machine file.
const SAME_LENGTH: f64 = 1e-6;

/// Distance of tips, mm, that is rounding of numbers in files.
const SAME_TIP: f64 = 1e-6;

/// The largest distance of the nominal tips of two machines with the same axes, at some commands.
fn tips_apart(one: &dyn KinematicModel, other: &dyn KinematicModel) -> Result<f64> {
    let tips = |model: &dyn KinematicModel| -> Result<Vec<[f64; 3]>> {
        let info = model.info();
        let mut statuses = Vec::new();
        for point in 0..8_u32 {
            let mut status = vec![0.0; info.status.len()];
            for (place, axis) in info.axes.iter().enumerate() {
                // No two axes and no two points have the same command.
                let part = (f64::from(point) * 0.618 + place as f64 * 0.287).fract() - 0.5;
                status[axis.status] = part * if axis.kind == AxisKind::Linear { 100.0 } else { 2.0 };
            }
            statuses.extend(status);
        }
        let mut poses = Poses::default();
        model.poses(&statuses, &info.nominal, &[], false, &mut poses)?;
        Ok(poses.positions)
    };
    let distance =
        |(one, other): ([f64; 3], [f64; 3])| (0..3).map(|axis| (one[axis] - other[axis]).powi(2)).sum::<f64>().sqrt();
    Ok(tips(one)?.into_iter().zip(tips(other)?).map(distance).fold(0.0, f64::max))
}

/// Errors of the set-up belong to one tool: tells so where a program has tools of its own.
pub fn tell_tool(calibration: &Calibration, has_tools: bool) {
    let own = ["dxt", "dyt", "dzt"].into_iter();
    let set_up: Vec<&str> = own.filter(|name| calibration.get(name).is_some_and(|known| known.value != 0.0)).collect();
    if has_tools && !set_up.is_empty() {
        tracing::warn!(
            "{} belong to the tool of the calibration, and are corrected for the tools of this program, too",
            set_up.join(", ")
        );
    }
}

/// Tells, or refuses, loads and temperatures of a program that the calibration does not know ([`extrapolated`]).
pub fn check_constants(known: &Known, constants: &[(String, (Quantity, f64))]) -> Result<()> {
    let model = known.model.as_ref();
    let value = |name: &str| {
        let found = constants.iter().find(|(of, (quantity, _))| of == name && *quantity != Quantity::Label);
        found.map_or(0.0, |(_, (_, value))| *value)
    };
    let mut status: Vec<f64> = model.info().status.iter().map(|column| value(&column.name)).collect();
    // Somewhere within the travel: at zero many errors vanish.
    for axis in &model.info().axes {
        status[axis.status] = axis.range.map_or(0.1, |[from, to]| from + 0.63 * (to - from));
    }
    let told = extrapolated(model, &known.calibration, &status).map_err(|error| {
        let message = format!("--constant: {}", error.message);
        Error { message, pose: None, ..error }
    })?;
    told.iter().for_each(|(_, sentence)| tracing::warn!("--constant: {sentence}"));
    Ok(())
}

/// Says which axes have no known travel: whether the machine was measured where it is asked for is then not known.
fn tell_unknown_travel(model: &dyn KinematicModel) {
    let axes = model.info().axes.iter().filter(|axis| axis.range.is_none() && !axis.endless);
    let names: Vec<&str> = axes.map(|axis| axis.name.as_str()).collect();
    if !names.is_empty() {
        tracing::warn!(
            "the travel of {} is not known: whether the machine was measured at these positions cannot be told; \
             write ranges into the machine description",
            names.join(", ")
        );
    }
}

/// A number of things: "1 move", "2 moves".
pub fn counted(count: usize, what: &str) -> String {
    format!("{count} {what}{}", if count == 1 { "" } else { "s" })
}
