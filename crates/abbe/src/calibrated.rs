//! What commands that act upon a calibration share: reading it, its age, and files that are written whole or not at all.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use abbe_core::{Calibration, Error, KinematicModel, Registry, Result};
use abbe_engine::{RunRecord, model_of};
use abbe_files::{LARGEST_RESULT, LARGEST_TEXT, read_text};
use clap::Args;
use serde_json::Value;

/// A calibration, and what is asked of it.
#[derive(Debug, Clone, Args)]
pub struct Asked {
    /// The calibration: `<estimate>.calibration.json` of a run.
    calibration: PathBuf,
    /// Machine file of the machine that this is for. The calibration of one with another chain, or other axes, is refused.
    #[arg(long, value_name = "FILE")]
    machine: Option<PathBuf>,
    /// Refuse a calibration of a run that is older than this; `run.json` beside it tells when it was.
    #[arg(long, value_name = "DAYS", value_parser = days)]
    max_age_days: Option<f64>,
}

impl Asked {
    /// Reads the calibration and builds its model.
    pub fn read(&self, registry: &Registry) -> Result<(Calibration, Arc<dyn KinematicModel>)> {
        let file = &self.calibration;
        let calibration = read(file)?;
        self.max_age_days.map_or(Ok(()), |most| check_age(file, most))?;
        self.machine.as_ref().map_or(Ok(()), |machine| check_machine(&calibration, file, machine))?;
        let model = model_of(&calibration, registry).map_err(|error| error.in_file(file))?;
        Ok((calibration, model))
    }
}

fn read(file: &Path) -> Result<Calibration> {
    let unreadable = |error: std::io::Error| Error::usage(format!("the file cannot be read: {error}")).in_file(file);
    let text = read_text(file, LARGEST_RESULT).map_err(unreadable)?;
    Calibration::from_json(&text).map_err(|error| error.in_file(file))
}

fn days(text: &str) -> std::result::Result<f64, String> {
    let days = text.parse::<f64>().ok().filter(|days| *days > 0.0 && days.is_finite());
    days.ok_or_else(|| "a number of days above 0 was expected".to_owned())
}

/// Refuses a calibration of a run that is too old, or of which the time is not known.
fn check_age(file: &Path, most: f64) -> Result<()> {
    let record = file.with_file_name("run.json");
    let read = read_text(&record, LARGEST_RESULT).ok().and_then(|text| RunRecord::from_json(&text).ok());
    let Some(run) = read else {
        let message = format!("how old the calibration is cannot be told without `{}`", record.display());
        return Err(Error::data(message).in_file(file));
    };
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
fn check_machine(calibration: &Calibration, file: &Path, machine: &Path) -> Result<()> {
    let unreadable = |error: std::io::Error| Error::usage(format!("the file cannot be read: {error}")).in_file(machine);
    let text = read_text(machine, LARGEST_TEXT).map_err(unreadable)?;
    let wrong = |error: serde_yaml::Error| Error::usage(format!("this is no machine file: {error}")).in_file(machine);
    let theirs: Value = serde_yaml::from_str(&text).map_err(wrong)?;
    let ours = &calibration.model.settings;
    let words = |settings: &Value| {
        settings["chain"].as_str().map(|chain| chain.split_whitespace().map(str::to_owned).collect::<Vec<_>>())
    };
    let Some(chain) = words(&theirs) else {
        return Err(Error::usage("the machine file has no `chain`").in_file(machine));
    };
    if words(ours).as_ref() != Some(&chain) {
        let own = ours["chain"].as_str().unwrap_or("none");
        let message = format!("this is the calibration of another machine: its chain is `{own}`");
        return Err(Error::data(message).in_file(file).help(format!(
            "{} has `{}`",
            machine.display(),
            chain.join(" ")
        )));
    }
    let axes = theirs["axes"].as_object().into_iter().flatten();
    for (axis, described) in axes {
        for key in ["direction", "reverse"] {
            let (one, other) = (&described[key], &ours["axes"][axis.as_str()][key]);
            if one != other {
                let message = format!("this is the calibration of another machine: `{key}` of axis {axis} is {other}");
                let help = format!("{} has {one}", machine.display());
                return Err(Error::data(message).in_file(file).help(help));
            }
        }
    }
    Ok(())
}

/// What was found, and what is to be written.
pub struct Written {
    /// What to print.
    pub text: String,
    /// The files: where, and what.
    pub files: Vec<(PathBuf, String)>,
}

impl Written {
    /// Writes the files, none of which may exist: all of them or none.
    pub fn write(&self) -> Result<()> {
        self.files.iter().try_for_each(|(path, _)| is_free(path))?;
        let wrong = |path: &Path, error: &std::io::Error| {
            Error::data(format!("{} cannot be written: {}", path.display(), error.kind()))
        };
        let filled = |(path, text): &(PathBuf, String)| {
            let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
            let mut file = tempfile::Builder::new().prefix(".abbe-").tempfile_in(folder)?;
            file.write_all(text.as_bytes())?;
            Ok(file)
        };
        let filled: Vec<_> = (self.files.iter())
            .map(|file| filled(file).map_err(|error| wrong(&file.0, &error)))
            .collect::<Result<_>>()?;
        let mut written: Vec<&Path> = Vec::new();
        for (file, (path, _)) in filled.into_iter().zip(&self.files) {
            if let Err(error) = file.persist_noclobber(path) {
                // What was written a moment ago is this program's own.
                written.iter().for_each(|path| drop(std::fs::remove_file(path)));
                return Err(wrong(path, &error.error));
            }
            written.push(path);
        }
        Ok(())
    }
}

/// Fails if there is something of this name.
pub fn is_free(path: &Path) -> Result<()> {
    match path.symlink_metadata() {
        Ok(_) => {
            let message = format!("{} is there already; it is not replaced", path.display());
            Err(Error::data(message).help("name another file"))
        }
        Err(_) => Ok(()),
    }
}

/// A number of things: "1 move", "2 moves".
pub fn counted(count: usize, what: &str) -> String {
    format!("{count} {what}{}", if count == 1 { "" } else { "s" })
}
