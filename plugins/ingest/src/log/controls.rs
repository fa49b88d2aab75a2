//! Ingest plugins of the controls whose programs write lines of the common form: what each prints besides these lines.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use abbe_core::{ColumnHeader, Context, Dataset, Error, Ingest, InputFile, Label, Result, SettingsError};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use super::far::Bounds;
use super::matched::{Aborted, Repeats, Time, Told, Wanted, matched};
use super::plan::Plan;
use super::record::{Builder, Log};
use abbe_assembly::{Assembly, Filters, Paths, emptied};

/// The log of a measuring program.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct Settings {
    /// The file or files, as of `ingest: csv`. Each file is one log.
    pub(crate) path: Paths,
    /// The plan that the measuring program was made from, a CSV file: the expected positions of all axes, features and what else
    /// is known of each touch. Its column `touch` has the numbers of the touches; without it rows are counted.
    pub(crate) plan: String,
    /// What becomes of repeats of a touch.
    #[serde(default)]
    pub(crate) repeats: Repeats,
    /// What becomes of a log whose program did not come to its end.
    #[serde(default)]
    pub(crate) aborted: Aborted,
    /// Which run of the program counts where a file has several: a control that appends leaves one behind the other.
    #[serde(default)]
    pub(crate) runs: Runs,
    /// Where the times of the touches come from.
    #[serde(default)]
    pub(crate) time: Time,
    /// How far from the plan the linear axes may have stood at a touch, mm.
    #[serde(default = "two")]
    #[schemars(range(min = 0.001, max = 1000.0))]
    pub(crate) far_mm: f64,
    /// How far from the plan a rotary axis may have stood at a touch.
    #[serde(default = "tenth")]
    #[schemars(range(min = 0.0001, max = 180.0))]
    pub(crate) far_deg: f64,
    /// The length of the tool that has to stand in the header of the log.
    #[schemars(range(min = 0.0, max = 10000.0))]
    pub(crate) tool_length_mm: Option<f64>,
    /// The diameter of the stylus tip that has to stand in the header of the log.
    #[schemars(range(min = 0.0, max = 1000.0))]
    pub(crate) stylus_diameter_mm: Option<f64>,
    /// As of `ingest: csv`.
    #[serde(default)]
    pub(crate) constants: BTreeMap<String, Label>,
    /// As of `ingest: csv`.
    #[serde(default)]
    pub(crate) ignore: Filters,
    /// As of `ingest: csv`.
    #[serde(default)]
    pub(crate) keep: Filters,
}

fn two() -> f64 {
    2.0
}

fn tenth() -> f64 {
    0.1
}

/// Which run of a program counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Runs {
    /// The only one; a file with several is refused.
    #[default]
    Only,
    /// The last one that came to its end; if none did, the last one.
    Last,
}

/// What makes a log of the lines of a text from the first of these to before the other.
pub(crate) type Understand = Box<dyn Fn(&Path, &str, (usize, usize)) -> Result<Log> + Send + Sync>;

/// The stage of all these plugins.
pub(crate) struct Logs {
    assembly: Assembly,
    plan: PathBuf,
    wanted: Wanted,
    runs: Runs,
    understand: Understand,
}

impl Logs {
    pub(crate) fn new(settings: Settings, context: &Context, understand: Understand) -> Result<Self, SettingsError> {
        let Settings { path, plan, constants, ignore, keep, .. } = settings;
        let wanted = Wanted {
            repeats: settings.repeats,
            aborted: settings.aborted,
            time: settings.time,
            bounds: Bounds { length: settings.far_mm, angle: settings.far_deg.to_radians() },
            tool_length: settings.tool_length_mm,
            stylus_diameter: settings.stylus_diameter_mm,
        };
        let assembly = Assembly::new(path, constants, None, [ignore, keep], context)?;
        Ok(Self { assembly, plan: context.path(&plan), wanted, runs: settings.runs, understand })
    }

    fn load(&self, path: &Path, plan: &Plan) -> Result<Told> {
        let text = abbe_table::read_text(path)?;
        let runs = runs(&text);
        let (log, remark) = match (&runs[..], self.runs) {
            ([_, _, ..], Runs::Only) => {
                let message = format!("a second run of a program begins here; the file has {} of them", runs.len());
                let help = "the control appends to its log: delete it there before a program starts, give each run a file of its own, or write `runs: last`";
                return Err(Error::data(message).at(path, runs[1].0, None).help(help));
            }
            ([_, _, ..], Runs::Last) => self.last(path, &text, &runs)?,
            _ => ((self.understand)(path, &text, (1, usize::MAX))?, None),
        };
        let (data, mut remarks) = matched(path, &log, plan, &self.wanted)?;
        remarks.extend(remark);
        Ok((data, remarks))
    }

    /// The last run that came to its end, or the last one. Runs that nobody wants may be cut anywhere.
    fn last(&self, path: &Path, text: &str, runs: &[(usize, usize)]) -> Result<(Log, Option<String>)> {
        let whole = runs.iter().rev().find_map(|lines| {
            let log = (self.understand)(path, text, *lines).ok().filter(|log| log.has_ended);
            log.map(|log| (log, *lines))
        });
        let (log, (from, _)) = match (whole, runs.last()) {
            (Some(whole), _) => whole,
            (None, last) => {
                let lines = last.copied().unwrap_or((1, usize::MAX));
                ((self.understand)(path, text, lines)?, lines)
            }
        };
        Ok((log, Some(format!("{} runs of a program; that from line {from} on is taken", runs.len()))))
    }
}

impl Ingest for Logs {
    fn inputs(&self) -> Vec<InputFile> {
        let mut inputs = self.assembly.inputs();
        inputs.push(InputFile { setting: "plan", path: self.plan.clone() });
        inputs
    }

    fn is_of_tables(&self) -> bool {
        false
    }

    fn headers(&self) -> Result<Vec<ColumnHeader>> {
        // Which columns there are is known only with the touches.
        let plan = Plan::read(&self.plan)?;
        Ok(self.assembly.without_rows(&|path| Ok(emptied(self.load(path, &plan)?.0)))?.headers())
    }

    fn read(&self) -> Result<Dataset> {
        let plan = Plan::read(&self.plan)?;
        self.assembly.read(&|path| {
            let (data, remarks) = self.load(path, &plan)?;
            remarks.iter().for_each(|remark| tracing::warn!("{}: {remark}", path.display()));
            Ok(data)
        })
    }
}

/// A control whose program writes the common form.
pub(crate) struct Control {
    /// The word behind `CONTROL`.
    pub(crate) name: &'static str,
    /// The part of a line that the program has written; nothing for lines of the control's own.
    pub(crate) written: fn(&str) -> &str,
}

pub(crate) const LINUXCNC: Control = Control { name: "LINUXCNC", written: |line| line };

pub(crate) const FANUC: Control = Control {
    name: "FANUC",
    // POPEN and PCLOS send these around the lines; a host writes what it receives.
    written: |line| line.trim_matches(|it: char| it == '%' || it.is_control()),
};

pub(crate) const SIEMENS: Control = Control {
    name: "SIEMENS",
    // A file of the NCK begins with its name and its folder.
    written: |line| if line.starts_with("%_N_") || line.trim_start().starts_with(';') { "" } else { line },
};

pub(crate) const HEIDENHAIN: Control = Control { name: "HEIDENHAIN", written: |line| line };

impl Control {
    /// The log that a text is.
    pub(crate) fn log(&self, path: &Path, text: &str, (from, to): (usize, usize)) -> Result<Log> {
        let mut builder = Builder::new(path, self.name);
        for (line, content) in lines(text, self.written).filter(|(line, _)| (from..to).contains(line)) {
            builder.line(line, content)?;
        }
        builder.finish()
    }

    fn stage(&'static self, settings: Settings, context: &Context) -> Result<Box<dyn Ingest>, SettingsError> {
        let understand: Understand = Box::new(|path, text, of| self.log(path, text, of));
        Ok(Box::new(Logs::new(settings, context, understand)?))
    }
}

/// Where the runs of a program begin and end in a file, by their headers. The first one begins with the file.
fn runs(text: &str) -> Vec<(usize, usize)> {
    // A console shows the comment of a line that was sent, behind what the host puts before it.
    let begins = |line: &str| {
        let own = line.trim_start_matches(|it: char| !it.is_ascii_alphanumeric()).trim_end();
        own == "ABBE 1" || line.contains("(ABBE 1)")
    };
    let mut found: Vec<usize> =
        text.lines().enumerate().filter(|(_, line)| begins(line)).map(|(index, _)| index + 1).collect();
    if let Some(first) = found.first_mut() {
        *first = 1;
    }
    let ends = found.iter().skip(1).copied().chain([usize::MAX]).collect::<Vec<_>>();
    found.into_iter().zip(ends).collect()
}

/// The lines of a log with their numbers, without empty ones. A last line that does not end may be cut within a number: it is
/// not taken, unless it is the end of the log.
pub(crate) fn lines(text: &str, written: fn(&str) -> &str) -> impl Iterator<Item = (usize, &str)> {
    let whole = text.rfind('\n').map_or(0, |end| end + 1);
    let rest = &text[whole..];
    let taken = if written(rest).trim() == "END" { text } else { &text[..whole] };
    let lines = taken.lines().enumerate().map(move |(index, line)| (index + 1, written(line)));
    lines.filter(|(_, content)| !content.trim().is_empty())
}

/// An example of the settings, for a log of this name.
pub(crate) fn example(path: &str) -> Value {
    json!({ "path": path, "plan": "plan.csv", "repeats": "average", "tool_length_mm": 120, "far_mm": 1 })
}

pub(super) fn linuxcnc(settings: Settings, context: &Context) -> Result<Box<dyn Ingest>, SettingsError> {
    LINUXCNC.stage(settings, context)
}

fn fanuc(settings: Settings, context: &Context) -> Result<Box<dyn Ingest>, SettingsError> {
    FANUC.stage(settings, context)
}

fn siemens(settings: Settings, context: &Context) -> Result<Box<dyn Ingest>, SettingsError> {
    SIEMENS.stage(settings, context)
}

fn heidenhain(settings: Settings, context: &Context) -> Result<Box<dyn Ingest>, SettingsError> {
    HEIDENHAIN.stage(settings, context)
}

abbe_core::register!(
    Ingest,
    "linuxcnc-log",
    "reads the log of a measuring program on LinuxCNC, matched to its plan",
    Settings,
    || example("measure.log"),
    linuxcnc,
    "../../reference/ingest-linuxcnc-log.md",
);

abbe_core::register!(
    Ingest,
    "dprnt",
    "reads what a measuring program prints by DPRNT on Fanuc or Haas, matched to its plan",
    Settings,
    || example("dprnt.txt"),
    fanuc,
    "../../reference/ingest-dprnt.md",
);

abbe_core::register!(
    Ingest,
    "siemens-log",
    "reads the log of a measuring program on SINUMERIK, matched to its plan",
    Settings,
    || example("_N_MEASURE_LOG_MPF"),
    siemens,
    "../../reference/ingest-siemens-log.md",
);

abbe_core::register!(
    Ingest,
    "heidenhain-log",
    "reads the log of a measuring program on a Heidenhain TNC, matched to its plan",
    Settings,
    || example("measure.txt"),
    heidenhain,
    "../../reference/ingest-heidenhain-log.md",
);
