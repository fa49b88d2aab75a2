//! `abbe compensate`: corrected set-points for a calibrated machine.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use abbe_compensation::{CompensatedPath, Correct, Method, Settings, Travel, figures};
use abbe_core::{AxisKind, Calibration, Error, KinematicModel, Registry, Result};
use abbe_engine::{RunRecord, model_of};
use abbe_files::{LARGEST_RESULT, read_text};
use clap::{Args, ValueEnum};
use serde_json::{Value, json};

use crate::number::short;
use crate::table;

/// What `abbe compensate` is asked for.
#[derive(Debug, Clone, Args)]
pub struct Compensate {
    /// The calibration: `<estimate>.calibration.json` of a run.
    calibration: PathBuf,
    /// CSV file with the set-points: a column for the command of each axis (X_mm, B_deg), and for all that its errors depend on.
    setpoints: PathBuf,
    /// File for the corrected set-points. It must not exist. Without it only the figures are printed.
    #[arg(long)]
    out: Option<PathBuf>,
    /// File for the errors of every set-point before and after the correction, CSV. It must not exist.
    #[arg(long)]
    report: Option<PathBuf>,
    /// What is corrected: `position` of the tip, `five-axes` (the tool axis, too), or linear axes: `X,Z`.
    #[arg(long, default_value = "position", value_parser = correct)]
    correct: Correct,
    /// `exact`, or `first-order` to compare.
    #[arg(long, value_enum, default_value_t)]
    method: MethodName,
    /// What happens where a corrected command would leave the travel of its axis.
    #[arg(long, value_enum, default_value_t)]
    travel: TravelName,
    /// Correct only the component of the error in this direction of the table frame: `0,0,1`.
    #[arg(long, value_name = "X,Y,Z", value_parser = direction, allow_hyphen_values = true)]
    sensitive_direction: Option<[f64; 3]>,
    /// Largest correction of the tip, mm.
    #[arg(long, value_name = "MM", default_value_t = 1.0)]
    largest_tip_correction_mm: f64,
    /// Largest correction of the tool axis, mrad.
    #[arg(long, value_name = "MRAD", default_value_t = 1.0)]
    largest_axis_correction_mrad: f64,
    /// Largest correction of the command of a rotary axis, mrad.
    #[arg(long, value_name = "MRAD", default_value_t = 50.0)]
    largest_rotary_correction_mrad: f64,
    /// Refuse a calibration of a run that is older than this; `run.json` beside it tells when it was.
    #[arg(long, value_name = "DAYS", value_parser = days)]
    max_age_days: Option<f64>,
    /// Print the figures as JSON.
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Clone, Copy, Default, ValueEnum)]
enum MethodName {
    #[default]
    Exact,
    FirstOrder,
}

#[derive(Debug, Clone, Copy, Default, ValueEnum)]
enum TravelName {
    /// It is an error.
    #[default]
    Refuse,
    /// The axis stands at the end of its travel.
    Hold,
}

fn correct(text: &str) -> std::result::Result<Correct, String> {
    match text {
        "position" => Ok(Correct::Position),
        "five-axes" => Ok(Correct::FiveAxes),
        axes if axes.split(',').all(|axis| axis.len() == 1) => {
            Ok(Correct::Axes(axes.split(',').map(str::to_owned).collect()))
        }
        _ => Err("`position`, `five-axes` or names of linear axes (`X,Z`) were expected".to_owned()),
    }
}

fn direction(text: &str) -> std::result::Result<[f64; 3], String> {
    let numbers: std::result::Result<Vec<f64>, _> = text.split(',').map(|part| part.trim().parse()).collect();
    let numbers = numbers.ok().and_then(|numbers| <[f64; 3]>::try_from(numbers).ok());
    numbers.ok_or_else(|| "three numbers, `X,Y,Z`, were expected".to_owned())
}

fn days(text: &str) -> std::result::Result<f64, String> {
    let days = text.parse::<f64>().ok().filter(|days| *days > 0.0 && days.is_finite());
    days.ok_or_else(|| "a number of days above 0 was expected".to_owned())
}

/// What was found, and what is to be written.
pub struct Compensated {
    /// What to print.
    pub text: String,
    files: Vec<(PathBuf, String)>,
}

impl Compensated {
    /// Writes the files, none of which may exist.
    pub fn write(&self) -> Result<()> {
        self.files.iter().try_for_each(|(path, _)| is_free(path))?;
        self.files.iter().try_for_each(|(path, text)| {
            let wrong = |error: std::io::Error| Error::data(format!("{} cannot be written: {error}", path.display()));
            let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
            // Whole or not at all.
            let mut under_way = tempfile::Builder::new().prefix(".abbe-").tempfile_in(folder).map_err(wrong)?;
            under_way.write_all(text.as_bytes()).map_err(wrong)?;
            under_way.persist_noclobber(path).map(drop).map_err(|error| wrong(error.error))
        })
    }
}

fn is_free(path: &Path) -> Result<()> {
    match path.symlink_metadata() {
        Ok(_) => {
            let message = format!("{} is there already; it is not replaced", path.display());
            Err(Error::data(message).help("name another file with `--out` or `--report`"))
        }
        Err(_) => Ok(()),
    }
}

impl Compensate {
    fn settings(&self) -> Settings {
        Settings {
            correct: self.correct.clone(),
            method: match self.method {
                MethodName::Exact => Method::Exact,
                MethodName::FirstOrder => Method::FirstOrder,
            },
            weights: None,
            sensitive_direction: self.sensitive_direction,
            largest_rotary_correction_mrad: self.largest_rotary_correction_mrad,
            largest_tip_correction_mm: self.largest_tip_correction_mm,
            largest_axis_correction_mrad: self.largest_axis_correction_mrad,
            travel: match self.travel {
                TravelName::Refuse => Travel::Refuse,
                TravelName::Hold => Travel::Hold,
            },
        }
    }

    /// Carries it out; nothing is written yet.
    pub fn run(&self, registry: &Registry) -> Result<Compensated> {
        if self.out.is_some() && self.out == self.report {
            return Err(Error::usage("`--out` and `--report` name the same file"));
        }
        let files = [&self.out, &self.report];
        files.iter().copied().flatten().try_for_each(|path| is_free(path))?;
        let unreadable = |error: std::io::Error| {
            Error::usage(format!("the file cannot be read: {error}")).in_file(&self.calibration)
        };
        let text = read_text(&self.calibration, LARGEST_RESULT).map_err(unreadable)?;
        let calibration = Calibration::from_json(&text).map_err(|error| error.in_file(&self.calibration))?;
        self.check_age()?;
        let model = model_of(&calibration, registry).map_err(|error| error.in_file(&self.calibration))?;
        let model = model.as_ref();
        let path = CompensatedPath::new(model, &calibration, &self.setpoints, &self.settings())?;
        let CompensatedPath { points, statuses, corrections, turned } = &path;
        let mut files = Vec::new();
        if let Some(out) = &self.out {
            files.push((out.clone(), path.set_points_text(model)?));
        }
        if let Some(report) = &self.report {
            files.push((report.clone(), path.errors_text(model)));
        }
        let found = figures(corrections);
        let axes = &model.info().axes;
        let name = |axis: usize| axes[axis].name.as_str();
        let largest = |axis: usize| {
            let (width, place) = (model.info().status.len(), axes[axis].status);
            let pairs = statuses.chunks(width).zip(points.statuses().chunks(width));
            pairs.map(|(now, before)| (now[place] - before[place]).abs()).fold(0.0, f64::max)
        };
        let rows = [
            ("tip, largest µm", found.tip_before.max * 1e3, found.tip_after.max * 1e3),
            ("tip, RMS µm", found.tip_before.rms * 1e3, found.tip_after.rms * 1e3),
            ("tool axis, largest µrad", found.axis_before.max * 1e6, found.axis_after.max * 1e6),
            ("tool axis, RMS µrad", found.axis_before.rms * 1e6, found.axis_after.rms * 1e6),
        ];
        if self.json {
            let figures: Value = rows
                .iter()
                .map(|(name, before, after)| json!({ "name": name, "before": before, "after": after }))
                .collect();
            let corrections: serde_json::Map<String, Value> = (0..axes.len())
                .map(|axis| (name(axis).to_owned(), json!(largest(axis) * position_factor(model, axis))))
                .collect();
            let turned: Vec<Value> = turned
                .iter()
                .map(|turned| json!({ "axis": name(turned.axis), "moves": turned.count, "reversal_um": turned.reversal * 1e3 }))
                .collect();
            let value = json!({
                "points": points.len(), "errors": figures, "largest_corrections": corrections, "bounded": found.bounded,
                "held": found.held, "turned_moves": turned,
                "files": files.iter().map(|(path, _)| path.display().to_string()).collect::<Vec<_>>(),
            });
            return Ok(Compensated { text: crate::pretty(&value)?, files });
        }
        let mut table = vec![["", "before", "after"].map(str::to_owned).to_vec()];
        table.extend(rows.map(|(name, before, after)| vec![name.to_owned(), short(before), short(after)]));
        let mut text = format!("{} set-points\n\n{}", points.len(), table::text(&table, &[1, 2]));
        let corrected: Vec<String> = (0..axes.len())
            .filter(|&axis| largest(axis) > 0.0)
            .map(|axis| format!("{} {}", name(axis), of_people(model, axis, largest(axis))))
            .collect();
        text.push_str(&format!("\nLargest corrections: {}\n", corrected.join(", ")));
        if found.bounded > 0 {
            text.push_str(&format!(
                "{} points near a pole: the bound of {} mrad on rotary corrections leaves a part of the error of the tool axis\n",
                found.bounded, self.largest_rotary_correction_mrad
            ));
        }
        if found.held > 0 {
            text.push_str(&format!("{} points have an axis at the end of its travel\n", found.held));
        }
        for moves in turned {
            text.push_str(&format!(
                "Turned round: {} of the moves of {}; its reversal there moves the tip by {} µm at most\n",
                moves.count,
                name(moves.axis),
                short(moves.reversal * 1e3)
            ));
        }
        for (path, _) in &files {
            text.push_str(&format!("\nWritten: {}", path.display()));
        }
        if !files.is_empty() {
            text.push('\n');
        }
        Ok(Compensated { text, files })
    }

    /// Refuses a calibration of a run that is too old, or of which the time is not known.
    fn check_age(&self) -> Result<()> {
        let Some(most) = self.max_age_days else { return Ok(()) };
        let record = self.calibration.with_file_name("run.json");
        let read = read_text(&record, LARGEST_RESULT).ok().and_then(|text| RunRecord::from_json(&text).ok());
        let Some(run) = read else {
            let message = format!("how old the calibration is cannot be told without `{}`", record.display());
            return Err(Error::data(message).in_file(&self.calibration));
        };
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or(Duration::ZERO).as_secs_f64();
        let days = (now - run.started_unix_s as f64) / 86_400.0;
        if days < -1.0 {
            let message = format!("`{}` is {:.1} days in the future: is the clock right?", record.display(), -days);
            return Err(Error::data(message).in_file(&self.calibration));
        }
        if days > most {
            let message = format!("the calibration is {days:.1} days old; at most {most} were allowed");
            return Err(Error::data(message).help("calibrate again").in_file(&self.calibration));
        }
        Ok(())
    }
}

/// Positions in files over positions in memory.
fn position_factor(model: &dyn KinematicModel, axis: usize) -> f64 {
    match model.info().axes[axis].kind {
        AxisKind::Linear => 1.0,
        AxisKind::Rotary => 1_f64.to_degrees(),
    }
}

fn of_people(model: &dyn KinematicModel, axis: usize, size: f64) -> String {
    match model.info().axes[axis].kind {
        AxisKind::Linear => format!("{} µm", short(size * 1e3)),
        AxisKind::Rotary => format!("{} µrad", short(size * 1e6)),
    }
}
