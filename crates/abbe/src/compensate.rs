//! `abbe compensate`: corrected set-points for a calibrated machine.

use std::path::{Path, PathBuf};

use abbe_compensation::{CompensatedPath, Correct, Method, SetPoints, Settings, Travel, figures};
use abbe_core::{Axis, AxisKind, Error, KinematicModel, Registry, Result};
use clap::{Args, ValueEnum};
use serde_json::{Value, json};

use crate::calibrated::{Asked, Known, counted, positive_mm, positive_mrad};
use crate::nc_program::{self, ProgramOptions};
use crate::outputs::{Written, are_different, is_free};
use crate::table;
use abbe_report::number::short;

/// What `abbe compensate` is asked for.
#[derive(Debug, Clone, Args)]
pub struct Compensate {
    #[command(flatten)]
    calibrated: Asked,
    /// CSV file with the set-points: a column for the command of each axis (X_mm, B_deg), and for all that its errors depend on. With
    /// `--dialect` it is an NC program.
    setpoints: PathBuf,
    #[command(flatten)]
    program: ProgramOptions,
    /// File for the corrected set-points, or the corrected program. It must not exist. Without it only the figures are printed.
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
    #[arg(long, value_name = "X,Y,Z", value_parser = three, allow_hyphen_values = true)]
    sensitive_direction: Option<[f64; 3]>,
    /// Weights of the components of the error in the table frame, where less than three linear axes correct: `1,1,4`.
    #[arg(long, value_name = "X,Y,Z", value_parser = three, allow_hyphen_values = true)]
    weights: Option<[f64; 3]>,
    /// Largest correction of the tip, mm.
    #[arg(long, value_name = "MM", default_value_t = 1.0, value_parser = positive_mm, allow_negative_numbers = true)]
    largest_tip_correction_mm: f64,
    /// Largest correction of the tool axis, mrad.
    #[arg(long, value_name = "MRAD", default_value_t = 1.0, value_parser = positive_mrad, allow_negative_numbers = true)]
    largest_axis_correction_mrad: f64,
    /// Largest correction of the command of a rotary axis, mrad.
    #[arg(long, value_name = "MRAD", default_value_t = 50.0, value_parser = positive_mrad, allow_negative_numbers = true)]
    largest_rotary_correction_mrad: f64,
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
    /// It may leave it: the control has limits of its own.
    Allow,
}

fn correct(text: &str) -> std::result::Result<Correct, String> {
    match text {
        "position" => Ok(Correct::Position),
        "five-axes" => Ok(Correct::FiveAxes),
        axes if axes
            .split(',')
            .all(|axis| axis.len() == 1 && axis.chars().all(|letter| letter.is_ascii_alphabetic())) =>
        {
            Ok(Correct::Axes(axes.split(',').map(str::to_owned).collect()))
        }
        _ => Err("`position`, `five-axes` or names of linear axes (`X,Z`) were expected".to_owned()),
    }
}

fn three(text: &str) -> std::result::Result<[f64; 3], String> {
    let numbers: std::result::Result<Vec<f64>, _> = text.split(',').map(|part| part.trim().parse()).collect();
    let numbers = numbers.ok().and_then(|numbers| <[f64; 3]>::try_from(numbers).ok());
    numbers.ok_or_else(|| "three numbers, `X,Y,Z`, were expected".to_owned())
}

impl Compensate {
    fn settings(&self) -> Settings {
        Settings {
            correct: self.correct.clone(),
            method: match self.method {
                MethodName::Exact => Method::Exact,
                MethodName::FirstOrder => Method::FirstOrder,
            },
            weights: self.weights,
            sensitive_direction: self.sensitive_direction,
            largest_rotary_correction_mrad: self.largest_rotary_correction_mrad,
            largest_tip_correction_mm: self.largest_tip_correction_mm,
            largest_axis_correction_mrad: self.largest_axis_correction_mrad,
            travel: match self.travel {
                TravelName::Refuse => Travel::Refuse,
                TravelName::Hold => Travel::Hold,
                TravelName::Allow => Travel::Allow,
            },
        }
    }

    /// Whether it is about a program.
    pub fn is_program(&self) -> bool {
        self.program.is_program()
    }

    /// Corrects a program: what to print, and the exit status.
    pub fn run_program(&self, registry: &Registry) -> Result<(String, u8)> {
        if self.report.is_some() {
            return Err(Error::usage("`--report` is for set-points").help("`--check` tells what remains of a program"));
        }
        let settings = self.settings();
        settings.check().map_err(|wrong| Error::usage(wrong.to_string()))?;
        let known = self.calibrated.read_for_program(registry)?;
        let asked = nc_program::Asked {
            options: &self.program,
            program: &self.setpoints,
            calibration: self.calibrated.file(),
            out: self.out.as_deref(),
            settings,
            json: self.json,
        };
        asked.run(&known, registry)
    }

    /// Carries it out; nothing is written yet.
    pub fn run(&self, registry: &Registry) -> Result<Written> {
        let named = [("--out", &self.out), ("--report", &self.report)];
        let named: Vec<(&str, &Path)> =
            named.into_iter().filter_map(|(option, path)| Some((option, path.as_deref()?))).collect();
        are_different(&named)?;
        named.iter().try_for_each(|(_, path)| is_free(path))?;
        let Known { calibration, model, time, .. } = self.calibrated.read(registry)?;
        let model = model.as_ref();
        let points = SetPoints::read_at(&self.setpoints, model, time)?;
        let path = CompensatedPath::of(model, &calibration, points, &self.settings())?;
        let mut files = Vec::new();
        if let Some(out) = &self.out {
            files.push((out.clone(), path.set_points_text(model)?.into_bytes()));
        }
        if let Some(report) = &self.report {
            files.push((report.clone(), path.errors_text(model).into_bytes()));
        }
        let text = if self.json { self.json(model, &path, &files)? } else { self.text(model, &path, &files) };
        Ok(Written { text, files })
    }

    fn json(&self, model: &dyn KinematicModel, path: &CompensatedPath, files: &[(PathBuf, Vec<u8>)]) -> Result<String> {
        let found = figures(&path.corrections);
        let of = |before: f64, after: f64| json!({ "before": before, "after": after });
        let corrections: serde_json::Map<String, Value> = (model.info().axes.iter().enumerate())
            .map(|(index, axis)| {
                let (unit, factor) = position_unit(axis);
                (format!("{}_{unit}", axis.name), json!(path.largest_correction(model, index) * factor))
            })
            .collect();
        let reversed: Vec<Value> = (path.reversed.iter())
            .map(|moves| {
                json!({
                    "axis": model.info().axes[moves.axis].name, "moves": moves.count,
                    "while_standing": moves.while_standing, "reversal_um": moves.reversal * 1e3,
                })
            })
            .collect();
        crate::pretty(&json!({
            "points": path.points.len(),
            "tip_max_um": of(found.tip_before.max * 1e3, found.tip_after.max * 1e3),
            "tip_rms_um": of(found.tip_before.rms * 1e3, found.tip_after.rms * 1e3),
            "axis_max_urad": of(found.axis_before.max * 1e6, found.axis_after.max * 1e6),
            "axis_rms_urad": of(found.axis_before.rms * 1e6, found.axis_after.rms * 1e6),
            "largest_corrections": corrections,
            "largest_standard_uncertainty_um": path.largest_uncertainty() * 1e3,
            "bounded_points": found.bounded,
            "held_points": found.held,
            "reversed_moves": reversed,
            "files": files.iter().map(|(path, _)| path.display().to_string()).collect::<Vec<_>>(),
        }))
    }

    fn text(&self, model: &dyn KinematicModel, path: &CompensatedPath, files: &[(PathBuf, Vec<u8>)]) -> String {
        let found = figures(&path.corrections);
        let axes = &model.info().axes;
        let rows = [
            ("tip, largest µm", found.tip_before.max * 1e3, found.tip_after.max * 1e3),
            ("tip, RMS µm", found.tip_before.rms * 1e3, found.tip_after.rms * 1e3),
            ("tool axis, largest µrad", found.axis_before.max * 1e6, found.axis_after.max * 1e6),
            ("tool axis, RMS µrad", found.axis_before.rms * 1e6, found.axis_after.rms * 1e6),
        ];
        let mut table = vec![["", "before", "after"].map(str::to_owned).to_vec()];
        table.extend(rows.map(|(name, before, after)| vec![name.to_owned(), short(before), short(after)]));
        let mut text = format!("{}\n\n{}", counted(path.points.len(), "set-point"), table::text(&table, &[1, 2]));
        let corrected: Vec<String> = (axes.iter().enumerate())
            .map(|(index, axis)| (axis, path.largest_correction(model, index)))
            .filter(|(_, largest)| *largest > 0.0)
            .map(|(axis, largest)| format!("{} {}", axis.name, of_people(axis, largest)))
            .collect();
        let corrected = if corrected.is_empty() { "none".to_owned() } else { corrected.join(", ") };
        text.push_str(&format!("\nLargest corrections: {corrected}\n"));
        if path.largest_uncertainty() > 0.0 {
            text.push_str(&format!(
                "Largest standard uncertainty of the tip, from the calibration: {} µm\n",
                short(path.largest_uncertainty() * 1e3)
            ));
        }
        if found.bounded > 0 {
            text.push_str(&format!(
                "Near a pole: at {} the bound of {} mrad on rotary corrections leaves a part of the error of the tool axis\n",
                counted(found.bounded, "set-point"),
                self.largest_rotary_correction_mrad
            ));
        }
        if found.held > 0 {
            let points = counted(found.held, "set-point");
            text.push_str(&format!("Held: at {points} an axis stands at the end of its travel\n"));
        }
        for moves in &path.reversed {
            let also = match moves.while_standing {
                0 => String::new(),
                count => format!(", and {} while it stands in the program", counted(count, "move")),
            };
            text.push_str(&format!(
                "Reversed: {} of {}{also}; its reversal there moves the tip by {} µm at most\n",
                counted(moves.count, "move"),
                axes[moves.axis].name,
                short(moves.reversal * 1e3)
            ));
        }
        for (path, _) in files {
            text.push_str(&format!("\nWritten: {}", path.display()));
        }
        if !files.is_empty() {
            text.push('\n');
        }
        text
    }
}

/// The unit of positions in files, and the factor from the unit in memory.
fn position_unit(axis: &Axis) -> (&'static str, f64) {
    match axis.kind {
        AxisKind::Linear => ("mm", 1.0),
        AxisKind::Rotary => ("deg", 1_f64.to_degrees()),
    }
}

fn of_people(axis: &Axis, size: f64) -> String {
    match axis.kind {
        AxisKind::Linear => format!("{} µm", short(size * 1e3)),
        AxisKind::Rotary => format!("{} µrad", short(size * 1e6)),
    }
}
