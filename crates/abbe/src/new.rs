//! `abbe new`: the beginning of a calibration: a machine file, an artefact, the touches to make and a recipe that evaluates them.

mod determined;
mod methods;
mod poses;
mod program;
mod texts;

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::{self, BufRead, IsTerminal, Write as _};
use std::path::PathBuf;
use std::time::Duration;

use abbe_core::{Error, Monitor, Result};
use abbe_engine::{can_write_folder, write_folder};
use abbe_kinematics::StructuralLoop;
use abbe_report::number::short;
use clap::{Args, ValueEnum};

use crate::interrupt;
use crate::libraries::Libraries;
use crate::table;
use determined::{Beginning, begin};

/// What is asked for. On a terminal what is missing is asked; elsewhere it is an error.
#[derive(Debug, Args)]
pub struct New {
    /// Folder to write. It must be empty, or not exist.
    folder: PathBuf,
    /// The chain of axes in the notation of ISO 10791-6, workpiece to tool, as "w C' A' b X Y Z t".
    #[arg(long)]
    chain: Option<String>,
    /// What is measured.
    #[arg(long, value_enum)]
    method: Option<Method>,
    /// The control that gets the corrections.
    #[arg(long, value_enum)]
    controller: Option<Controller>,
    /// Time limit, seconds: machines with many axes take long.
    #[arg(long, value_name = "SECONDS", value_parser = interrupt::seconds, allow_negative_numbers = true)]
    time_limit: Option<Duration>,
}

/// What is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Method {
    /// Faces of the machine's own table, or of a block on it.
    Table,
    /// One ball on the table.
    Ball,
    /// Several balls on the table.
    Balls,
    /// A ball bar between the tool and a ball on the table.
    BallBar,
    /// Poses of a target on the table, seen from the tool: a camera, the 6-dof probe of a laser tracker.
    Poses,
    /// Calibrated lengths on the table: a bar, or a step gauge.
    Lengths,
}

/// Controls.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Controller {
    /// LinuxCNC.
    Linuxcnc,
    /// Fanuc.
    Fanuc,
    /// Siemens SINUMERIK.
    Siemens,
    /// Heidenhain TNC.
    Heidenhain,
    /// grbl and its relatives.
    Grbl,
}

impl New {
    /// Writes the folder; gives what to print.
    pub fn run(&self, libraries: &Libraries) -> Result<String> {
        let monitor = match self.time_limit {
            Some(limit) => Monitor::default().with_time_limit(limit),
            None => Monitor::default(),
        };
        interrupt::cancel_on_signal(monitor.clone())?;
        interrupt::end_after(self.time_limit, interrupt::GRACE, false, "nothing is written")?;
        can_write_folder(&self.folder)?;
        let chain = match &self.chain {
            Some(chain) => chain.clone(),
            None => asked("chain", "Axes from the workpiece to the tool, b is the bed, as \"w C' A' b X Y Z t\": ")?,
        };
        let chain: StructuralLoop = chain.parse().map_err(|error| {
            Error::usage(format!("{error}")).help("the notation is that of ISO 10791-6: see `abbe model --help`")
        })?;
        check_size(&chain)?;
        let method = match self.method {
            Some(method) => method,
            None => {
                let answer = asked("method", &format!("What is measured ({}): ", methods()))?;
                Method::from_str(&answer, true)
                    .map_err(|_| Error::usage(format!("`{answer}` is none of {}", methods())))?
            }
        };
        let beginning = begin(&chain, method, self.controller, &libraries.registry(None)?, &monitor)?;
        let bytes = |(name, text): (&PathBuf, &String)| (name.clone(), text.clone().into_bytes());
        let files: BTreeMap<PathBuf, Vec<u8>> = beginning.files.iter().map(bytes).collect();
        interrupt::while_writing(|| write_folder(&self.folder, &files))?;
        Ok(self.told(&beginning, method, &chain))
    }

    fn told(&self, beginning: &Beginning, method: Method, chain: &StructuralLoop) -> String {
        let names: Vec<String> = beginning.files.keys().map(|file| file.display().to_string()).collect();
        let mut text = format!("Written: {} ({})\n", self.folder.display(), names.join(", "));
        let [row, rows, known] = method.rows();
        let places = match method {
            Method::Poses | Method::Lengths => String::new(),
            _ => format!(
                " at {}",
                counted(beginning.indexations, "position of the rotary axes", "positions of the rotary axes")
            ),
        };
        let verb = if beginning.rows == 1 { "tells" } else { "tell" };
        let _ = writeln!(
            text,
            "\n{}{places} {verb} {}. Expected standard uncertainties, {known}:\n",
            counted(beginning.rows, row, rows),
            counted(beginning.errors, "error of the machine", "errors of the machine")
        );
        let lines =
            beginning.expected.iter().map(|(name, unit, value)| vec![name.clone(), short(*value), unit.clone()]);
        text.push_str(&table::text(&lines.collect::<Vec<_>>(), &[1]));
        if !beginning.left_out.is_empty() {
            let _ = writeln!(text, "\nNot told by these {rows}, and left out: {}", beginning.left_out.join(", "));
        }
        beginning.remarks.iter().for_each(|remark| text.push_str(&format!("\n{remark}\n")));
        let has_program = self.controller.is_some() && program::is_written(method, chain);
        text.push_str(&self.next(beginning, method, has_program));
        text
    }

    /// What comes next.
    fn next(&self, beginning: &Beginning, method: Method, has_program: bool) -> String {
        let (folder, data, [_, rows, _]) = (self.folder.display(), method.data_file(), method.rows());
        let places = match beginning.nominal {
            Some(nominal) => format!(", and the\n     places of the artefact into {folder}/{nominal}"),
            None => String::new(),
        };
        let chosen = if method.generates() { "candidates.csv" } else { data };
        let begin = format!(
            "\nNext\n  1. Put the ranges and places of your axes, tool length and stylus into {folder}/machine.yaml{places}.\n  \
             2. `abbe plan {folder}/recipe.yaml --out {folder}/plan` chooses the {rows}"
        );
        if has_program {
            return format!(
                "{begin} and writes the program that\n     measures them, by the probe and solids under `program` of the recipe: put yours in their \
                 place.\n  3. Run its dry run, then the program, copy its log to {folder}/measure.log, and let `{}` of the recipe\n     \
                 read it, as its comment says; then `abbe run {folder}/recipe.yaml`.\n",
                method.ingest()
            );
        }
        format!(
            "{begin}; plan/{chosen}\n     takes the place of {data}.\n  3. Measure them, write what was measured into {data}, and \
             `abbe run {folder}/recipe.yaml`.\n"
        )
    }
}

/// Axes of the longest chain that a calibration is begun for.
const MOST_AXES: usize = 12;

/// Refuses chains on which to try what measurements tell would take hours.
fn check_size(chain: &StructuralLoop) -> Result<()> {
    let axes = chain.axes.len();
    if axes <= MOST_AXES {
        return Ok(());
    }
    let message = format!("a chain of {axes} axes: a calibration is begun for {MOST_AXES} axes at most");
    Err(Error::usage(message).help("leave out axes that stand while it is measured"))
}

/// The methods, for people.
fn methods() -> String {
    let names: Vec<String> = Method::value_variants()
        .iter()
        .filter_map(|method| method.to_possible_value().map(|value| value.get_name().to_owned()))
        .collect();
    names.join(", ")
}

fn counted(number: usize, one: &str, many: &str) -> String {
    if number == 1 { format!("one {one}") } else { format!("{number} {many}") }
}

/// An answer from the terminal. Fails where nobody can answer.
fn asked(option: &str, question: &str) -> Result<String> {
    if !(io::stdin().is_terminal() && io::stderr().is_terminal()) {
        return Err(Error::usage(format!("`--{option}` is missing")).help("see `abbe new --help`"));
    }
    let failed = |error: io::Error| Error::data(format!("nothing can be asked: {error}"));
    let mut to_user = io::stderr().lock();
    to_user.write_all(question.as_bytes()).and_then(|()| to_user.flush()).map_err(failed)?;
    let mut answer = String::new();
    io::stdin().lock().read_line(&mut answer).map_err(failed)?;
    Ok(answer.trim().to_owned())
}
