//! `abbe new`: the beginning of a calibration: a machine file, an artefact, the touches to make and a recipe that evaluates them.

mod determined;
mod texts;

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::{self, BufRead, IsTerminal, Write as _};
use std::path::PathBuf;

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
}

/// What the machine measures with its touch probe.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Method {
    /// Faces of the machine's own table, or of a block on it.
    Table,
    /// One ball on the table.
    Ball,
    /// Several balls on the table.
    Balls,
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
        interrupt::cancel_on_signal(Monitor::default())?;
        can_write_folder(&self.folder)?;
        let chain = match &self.chain {
            Some(chain) => chain.clone(),
            None => asked("chain", "Axes from the workpiece to the tool, b is the bed, as \"w C' A' b X Y Z t\": ")?,
        };
        let chain: StructuralLoop = chain.parse().map_err(|error| {
            Error::usage(format!("{error}")).help("the notation is that of ISO 10791-6: see `abbe model --help`")
        })?;
        let method = match self.method {
            Some(method) => method,
            None => {
                let answer = asked("method", "What is touched (table, ball or balls): ")?;
                Method::from_str(&answer, true)
                    .map_err(|_| Error::usage(format!("`{answer}` is none of table, ball and balls")))?
            }
        };
        let beginning = begin(&chain, method, self.controller, &libraries.registry(None)?)?;
        let bytes = |(name, text): (&PathBuf, &String)| (name.clone(), text.clone().into_bytes());
        let files: BTreeMap<PathBuf, Vec<u8>> = beginning.files.iter().map(bytes).collect();
        write_folder(&self.folder, &files)?;
        Ok(self.told(&beginning))
    }

    fn told(&self, beginning: &Beginning) -> String {
        let names: Vec<String> = beginning.files.keys().map(|file| file.display().to_string()).collect();
        let mut text = format!("Written: {} ({})\n", self.folder.display(), names.join(", "));
        let _ = writeln!(
            text,
            "\n{} touches at {} tell {}. Expected standard uncertainties, 2 µm a touch:\n",
            beginning.touches,
            counted(beginning.indexations, "position of the rotary axes", "positions of the rotary axes"),
            counted(beginning.errors, "error of the machine", "errors of the machine")
        );
        let rows = beginning.expected.iter().map(|(name, unit, value)| vec![name.clone(), short(*value), unit.clone()]);
        text.push_str(&table::text(&rows.collect::<Vec<_>>(), &[1]));
        if !beginning.left_out.is_empty() {
            let _ = writeln!(text, "\nNot told by these touches, and left out: {}", beginning.left_out.join(", "));
        }
        beginning.remarks.iter().for_each(|remark| text.push_str(&format!("\n{remark}\n")));
        let folder = self.folder.display();
        let _ = write!(
            text,
            "\nNext\n  1. Put the ranges and places of your axes, tool length and stylus into {folder}/machine.yaml, and the\n     \
             places of what is touched into {folder}/{}.\n  2. `abbe plan {folder}/recipe.yaml --out {folder}/plan` chooses the touches; \
             plan/candidates.csv\n     takes the place of touches.csv.\n  3. Measure them, write the positions of the axes into \
             touches.csv, and `abbe run {folder}/recipe.yaml`.\n",
            beginning.nominal
        );
        text
    }
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
