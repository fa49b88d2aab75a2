//! `abbe compensate --dialect`: NC programs, corrected and checked.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead, BufReader, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::rc::Rc;

use abbe_compensation::{Settings, Temperatures, check_confounded_anywhere};
use abbe_controllers::{
    Checked, Coordinates, Dialect, Machine, Options, Summary, Tools, check, compensate, mark, place,
};
use abbe_core::{Error, Quantity, Registry, Result, machine_values};
use abbe_engine::{model_with_log, temporary_file};
use abbe_files::{LARGEST_RESULT, read_text};
use abbe_report::number::short;
use clap::{Args, ValueEnum};
use serde_json::json;

use crate::calibrated::{Known, check_constants, counted, tell_tool};
use crate::interrupt;
use crate::outputs::{cannot_be_written, is_file_name, is_free};
use crate::written_out::{Origins, WrittenOut};

/// Positions of axes by their place among letters; one value of an option.
type Positions = Vec<(usize, f64)>;

/// What is asked of the correction of a program.
#[derive(Debug, Clone, Args)]
pub struct ProgramOptions {
    /// The language of an NC program: the second file is one, and no set-points. linuxcnc, iso, fanuc, siemens, heidenhain or grbl.
    #[arg(long, value_parser = dialect)]
    dialect: Option<Dialect>,
    /// Length of every tool of the program, from the gauge line of the spindle, mm.
    #[arg(long, value_name = "MM", value_parser = length, allow_negative_numbers = true, requires = "dialect", conflicts_with = "tools")]
    tool_length_mm: Option<f64>,
    /// Tool table of LinuxCNC with the lengths of tools: lines `T1 P1 Z120.5`, mm.
    #[arg(long, value_name = "FILE", requires = "dialect")]
    tools: Option<PathBuf>,
    /// A work offset, mm and degrees: `G54=X100,Y-50,Z0`. May be repeated. Those that are not given count as zero.
    #[arg(long, value_parser = offset, requires = "dialect")]
    offset: Vec<(usize, Positions)>,
    /// Where the axes stand before the program, machine coordinates: `X0,Y0,Z0`.
    #[arg(long, value_parser = positions, requires = "dialect", allow_hyphen_values = true)]
    start: Option<Positions>,
    /// Largest distance of the corrected tip from the programmed path along feed moves, µm. Moves are split where it needs that.
    #[arg(long, value_name = "UM", default_value_t = 1.0, value_parser = positive, allow_negative_numbers = true)]
    tolerance_um: f64,
    /// Decimals of numbers in mm; numbers in inches have one more.
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u8).range(2..=9))]
    decimals: u8,
    /// Decimals of degrees.
    #[arg(long, default_value_t = 6, value_parser = clap::value_parser!(u8).range(3..=9))]
    rotary_decimals: u8,
    /// How the switch of the control for blocks with `/` stands.
    #[arg(long, value_enum, requires = "dialect")]
    block_delete: Option<Switch>,
    /// Numbers without a point are mm, on a control where they may be micrometres.
    #[arg(long, requires = "dialect")]
    integers_are_mm: bool,
    /// What F is under G93, where that differs from control to control.
    #[arg(long, value_enum, requires = "dialect")]
    inverse_time: Option<InverseTime>,
    /// Whether axes stand after a change of the tool (M6) where they stood before. By default their positions are not known then, until
    /// the program names them.
    #[arg(long, value_enum, requires = "dialect", default_value = "moves")]
    tool_change: ToolChange,
    /// What errors depend on and no program tells, as it is while the program runs: `load_N=3500`. The name is that of the data column,
    /// with its unit. May be repeated.
    #[arg(long, value_name = "NAME=VALUE", value_parser = constant, requires = "dialect", allow_hyphen_values = true)]
    constant: Vec<(String, (Quantity, f64))>,
    /// Let LinuxCNC's own interpreter, `rs274`, write out subprograms, loops, variables and cycles first. Comments are lost then, and
    /// positions have 0.1 µm.
    #[arg(long, requires = "dialect")]
    write_out: bool,
    /// Read the corrected program again and tell the largest error that remains along its path. A file of `--out` that is there already
    /// is only checked.
    #[arg(long, requires = "dialect")]
    check: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Switch {
    On,
    Off,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ToolChange {
    Moves,
    Stays,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum InverseTime {
    Minutes,
    Seconds,
}

fn dialect(text: &str) -> std::result::Result<Dialect, String> {
    Dialect::of_name(text).ok_or_else(|| {
        let names: Vec<&str> = Dialect::ALL.iter().map(|dialect| dialect.name()).collect();
        format!("one of {} was expected", names.join(", "))
    })
}

fn length(text: &str) -> std::result::Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|number| (0.0..1e5).contains(number));
    number.ok_or_else(|| "a length from the gauge line of the spindle, mm, not below 0, was expected".to_owned())
}

fn positive(text: &str) -> std::result::Result<f64, String> {
    crate::calibrated::above_zero(text, "µm", 1e4)
}

/// `X100,Y-50,Z0`.
fn positions(text: &str) -> std::result::Result<Positions, String> {
    let one = |part: &str| {
        let part = part.trim();
        let letter = part.bytes().next().map(|byte| byte.to_ascii_uppercase())?;
        Some((place(letter)?, part.get(1..)?.parse::<f64>().ok().filter(|number| number.is_finite())?))
    };
    let found: Option<Positions> = text.split(',').map(one).collect();
    let found = found.ok_or_else(|| "positions of axes, `X0,Y0,Z0`, were expected".to_owned())?;
    match (1..found.len()).any(|index| found[..index].iter().any(|(place, _)| *place == found[index].0)) {
        true => Err("an axis stands there twice".to_owned()),
        false => Ok(found),
    }
}

/// Work offsets.
const SYSTEMS: [&str; 9] = ["G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3"];

/// `G54=X100,Y-50`.
fn offset(text: &str) -> std::result::Result<(usize, Positions), String> {
    let (name, values) = text.split_once('=').ok_or("`G54=X100,Y-50,Z0` was expected")?;
    let system = SYSTEMS.iter().position(|system| system.eq_ignore_ascii_case(name.trim()));
    let system = system.ok_or("a work offset, G54 to G59.3, was expected before `=`")?;
    Ok((system, positions(values)?))
}

/// `load_N=3500`: the name of a status, its quantity, and its value in the units of memory.
fn constant(text: &str) -> std::result::Result<(String, (Quantity, f64)), String> {
    let expected = || "the name of a column with its unit and a number were expected: `load_N=3500`".to_owned();
    let (header, value) = text.split_once('=').ok_or_else(expected)?;
    let value = value.trim().parse::<f64>().ok().filter(|value| value.is_finite()).ok_or_else(expected)?;
    let (name, quantity, factor) = Quantity::of_column(header.trim());
    Ok((name.to_owned(), (quantity, value * factor)))
}

/// A program to correct: what was asked, with the calibration.
pub struct Asked<'a> {
    /// The options of programs.
    pub options: &'a ProgramOptions,
    /// The program.
    pub program: &'a Path,
    /// The calibration file.
    pub calibration: &'a Path,
    /// Where to write.
    pub out: Option<&'a Path>,
    /// What is corrected.
    pub settings: Settings,
    /// Whether JSON is printed.
    pub json: bool,
}

impl ProgramOptions {
    /// Whether a program is to be corrected, and not set-points.
    pub fn is_program(&self) -> bool {
        self.dialect.is_some()
    }

    /// Refuses what LinuxCNC's interpreter cannot write out.
    fn check_written_out(&self, options: &Options) -> Result<()> {
        if self.write_out && options.dialect != Dialect::Linuxcnc {
            return Err(Error::usage("only programs of LinuxCNC are written out: `--dialect linuxcnc`"));
        }
        if self.write_out && options.tolerance < 1e-4 {
            let message = "LinuxCNC's interpreter writes positions with 0.1 µm, and the tolerance is less";
            return Err(Error::usage(message).help("allow more: `--tolerance-um 0.2`"));
        }
        Ok(())
    }

    fn options(&self, program: &Path, calibration: String) -> Result<Options> {
        let mut options = Options::new(self.dialect.unwrap_or(Dialect::Iso));
        options.file = program.to_owned();
        options.tolerance = self.tolerance_um * 1e-3;
        options.decimals = usize::from(self.decimals);
        options.rotary_decimals = usize::from(self.rotary_decimals);
        options.tools = Tools { only: self.tool_length_mm, by_number: BTreeMap::new() };
        if let Some(file) = &self.tools {
            let unreadable =
                |error| Error::usage(format!("the file cannot be read: {}", abbe_files::why(&error))).in_file(file);
            options.tools = Tools::read(&read_text(file, LARGEST_RESULT).map_err(unreadable)?, file)?;
        }
        for (system, values) in &self.offset {
            let mut offset: Coordinates = [0.0; 9];
            values.iter().for_each(|(place, value)| offset[*place] = *value);
            if options.offsets.insert(*system, offset).is_some() {
                return Err(Error::usage("a work offset is given twice"));
            }
        }
        for (place, value) in self.start.iter().flatten() {
            options.start[*place] = Some(*value);
        }
        options.block_delete = self.block_delete.map(|switch| switch == Switch::On);
        options.integers_are_mm = self.integers_are_mm;
        options.inverse_is_seconds = self.inverse_time.map(|meaning| meaning == InverseTime::Seconds);
        options.stays_at_tool_change = self.tool_change == ToolChange::Stays;
        options.calibration = calibration;
        Ok(options)
    }
}

impl Asked<'_> {
    /// Carries it out: the text to print, and the exit status.
    pub fn run(&self, known: &Known, registry: &Registry) -> Result<(String, u8)> {
        let unreadable = |error| {
            Error::usage(format!("the file cannot be read: {}", abbe_files::why(&error))).in_file(self.calibration)
        };
        let text = read_text(self.calibration, LARGEST_RESULT).map_err(unreadable)?;
        let options = self.options.options(self.program, mark(text.as_bytes()))?;
        check_confounded_anywhere(known.model.as_ref(), &known.calibration, &BTreeMap::new())?;
        let has_tools = options.tools.only.is_some() || !options.tools.by_number.is_empty();
        tell_tool(&known.calibration, has_tools);
        check_constants(known, &self.options.constant)?;
        self.options.check_written_out(&options)?;
        let build = |length: Option<f64>| self.machine(known, registry, length);
        let is_there = self.out.is_some_and(|out| out.symlink_metadata().is_ok());
        if self.options.check && self.out.is_none() {
            return Err(Error::usage("`--check` reads the corrected program").help("name it: `--out FILE`"));
        }
        let summary = match self.options.check && is_there {
            true => None,
            false => Some(self.write(&build, &options)?),
        };
        let checked = match (self.options.check, self.out) {
            (true, Some(out)) => {
                let (mut source, mut corrected) = (self.source(&options)?, opened(out)?);
                let found = check(&mut source.reader, &mut corrected, &build, &options, out);
                let mut checked = source.told(found, &options)?;
                for worst in [&mut checked.path, &mut checked.rapid] {
                    worst.of = source.line_of(worst.of);
                }
                Some(checked)
            }
            _ => None,
        };
        let holds = checked.as_ref().is_none_or(|checked| is_within(checked, &options));
        let text = match self.json {
            true => crate::pretty(&json!({
                "program": summary.as_ref().map(summary_json),
                "check": checked.as_ref().map(checked_json),
                "tolerance_um": options.tolerance * 1e3,
                "files": summary.as_ref().and(self.out).map(|out| out.display().to_string()),
            }))?,
            false => self.text(summary.as_ref(), checked.as_ref(), &options),
        };
        Ok((text, if holds { 0 } else { 3 }))
    }

    /// Writes the corrected program whole or not at all.
    fn write(&self, build: &abbe_controllers::MachineOf<'_>, options: &Options) -> Result<Summary> {
        let mut source = self.source(options)?;
        let Some(out) = self.out else {
            let summary = compensate(&mut source.reader, &mut std::io::sink(), build, options);
            return source.told(summary, options).map(|summary| source.completed(summary));
        };
        is_file_name(out)?;
        is_free(out)?;
        let folder = out.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let failed = |error: std::io::Error| cannot_be_written(out, &error);
        let file = temporary_file(folder).map_err(failed)?;
        let _noted = interrupt::TemporaryFile::at(file.path());
        let mut writer = Remembering { into: BufWriter::new(file.as_file()), error: None };
        let summary = compensate(&mut source.reader, &mut writer, build, options);
        let summary = (source.told(summary, options).map(|summary| source.completed(summary)))
            .and_then(|summary| writer.flush().map(|()| summary).map_err(failed));
        if interrupt::happened() {
            return Err(Error::interrupted());
        }
        // What cannot be written is told of the file, and not of the program.
        if let Some(error) = writer.error.take() {
            return Err(failed(error));
        }
        let summary = summary?;
        drop(writer);
        interrupt::while_writing(|| file.persist_noclobber(out).map_err(|error| cannot_be_written(out, &error.error)))?;
        Ok(summary)
    }

    /// The program, as it is or as LinuxCNC's interpreter writes it out.
    fn source(&self, options: &Options) -> Result<Source> {
        if !self.options.write_out {
            return Ok(Source { reader: Box::new(opened(self.program)?), origins: None, remarks: Vec::new() });
        }
        let written = WrittenOut::start(self.program, options)?;
        let mut remarks = vec![format!(
            "Written out by LinuxCNC's interpreter: comments are lost, positions have {} µm",
            if written.has_inches { "2.54" } else { "0.1" }
        )];
        if written.has_inches && options.tolerance < 2.54e-3 {
            let message = "LinuxCNC's interpreter writes inches with four decimals, 2.54 µm, and the tolerance is less";
            return Err(Error::usage(message).help("allow more: `--tolerance-um 3`; or write the program in mm"));
        }
        if !written.has_unit {
            remarks.push("Neither G20 nor G21 stands in the program; numbers count as mm".to_owned());
        }
        let origins = Some(written.origins());
        Ok(Source { reader: Box::new(BufReader::new(written)), origins, remarks })
    }

    fn machine(&self, known: &Known, registry: &Registry, length: Option<f64>) -> Result<Machine> {
        let own = known.calibration.model.settings.get("tool_length_mm").and_then(serde_json::Value::as_f64);
        let model = match length {
            Some(length) if own != Some(length) => {
                let mut calibration = known.calibration.clone();
                calibration.model.settings["tool_length_mm"] = json!(length);
                model_with_log(&calibration, known.log.as_ref().map(Temperatures::data), registry)?
            }
            _ => known.model.clone(),
        };
        let values = machine_values(model.as_ref(), &known.calibration);
        let constants: BTreeMap<String, (Quantity, f64)> = self.options.constant.iter().cloned().collect();
        let length = length.or(own).unwrap_or(0.0);
        Machine::with_constants(model, values, self.settings.clone(), length, known.time, &constants)
    }

    fn text(&self, summary: Option<&Summary>, checked: Option<&Checked>, options: &Options) -> String {
        let mut text = String::new();
        if let Some(summary) = summary {
            text.push_str(&format!(
                "{}: {} of motion, {} written\n",
                counted(summary.lines, "line"),
                counted(summary.moves, "block"),
                counted(summary.blocks, "block")
            ));
            if summary.arcs[0] > 0 {
                text.push_str(&format!("{}, {} written\n", counted(summary.arcs[0], "arc"), summary.arcs[1]));
            }
            text.push_str(&format!("Largest correction: {} µm\n", short(summary.largest * 1e3)));
            // A program of rapid moves alone has no such line.
            if summary.remaining_line > 0 {
                text.push_str(&format!(
                    "Remaining along feed moves: {} µm at most (line {} of the program), {} µm allowed\n",
                    short(summary.remaining * 1e3),
                    summary.remaining_line,
                    short(options.tolerance * 1e3)
                ));
            }
            if summary.take_ups > 0 {
                let moves = counted(summary.take_ups, "move");
                text.push_str(&format!(
                    "Added: {moves} that bring axes to a start, after reversals or uncorrected moves\n"
                ));
            }
            if summary.uncorrected > 0 {
                let moves = counted(summary.uncorrected, "rapid move");
                text.push_str(&format!(
                    "Not corrected: {moves}, to reference points, in machine coordinates, or before all positions are known\n"
                ));
            }
            for system in &summary.assumed {
                let name = SYSTEMS[*system];
                text.push_str(&format!("{name} counts as zero: `--offset {name}=X..,Y..,Z..` says where it is\n"));
            }
            summary.remarks.iter().for_each(|remark| text.extend([remark, "\n"]));
            if let Some(out) = self.out {
                text.push_str(&format!("\nWritten: {}\n", out.display()));
            }
        }
        if let Some(checked) = checked {
            text.push_str(&checked_text(checked, options));
        }
        text
    }
}

/// A program that is read.
struct Source {
    reader: Box<dyn BufRead>,
    /// Where its lines come from, if they are written out.
    origins: Option<Rc<RefCell<Origins>>>,
    remarks: Vec<String>,
}

impl Source {
    /// The line of the file from which a line comes.
    fn line_of(&self, line: usize) -> usize {
        self.origins.as_ref().and_then(|origins| origins.borrow().line_of(line)).unwrap_or(line)
    }

    /// Errors are those of the file, and not of what was written out.
    fn told<T>(&self, result: Result<T>, options: &Options) -> Result<T> {
        let Some(origins) = &self.origins else { return result };
        if let Some(error) = origins.borrow_mut().failed() {
            return Err(error);
        }
        result.map_err(|mut error| {
            if let Some(place) = error.place.as_mut().filter(|place| place.file == options.file) {
                (place.line, place.column) = (place.line.map(|line| self.line_of(line)), None);
            }
            error
        })
    }

    fn completed(&self, mut summary: Summary) -> Summary {
        summary.remaining_line = self.line_of(summary.remaining_line);
        summary.remarks.extend(self.remarks.iter().cloned());
        summary
    }
}

fn opened(file: &Path) -> Result<BufReader<File>> {
    let opened = abbe_files::open(file);
    opened
        .map(BufReader::new)
        .map_err(|error| Error::usage(format!("the program cannot be read: {}", abbe_files::why(&error))).in_file(file))
}

fn is_within(checked: &Checked, options: &Options) -> bool {
    let is_own = checked.mark.as_ref().is_none_or(|mark| mark.contains(&options.calibration));
    is_own && checked.path.distance.max(checked.rapid.distance) <= options.tolerance
}

fn checked_text(checked: &Checked, options: &Options) -> String {
    let mut text = format!("\nChecked: {}, {} places\n", counted(checked.blocks, "block"), checked.places);
    for (what, worst) in [("along feed moves", checked.path), ("at ends of rapid moves", checked.rapid)] {
        if worst.line > 0 {
            text.push_str(&format!(
                "Remaining {what}: {} µm at most, line {} (line {} of the program)\n",
                short(worst.distance * 1e3),
                worst.line,
                worst.of
            ));
        }
    }
    if checked.mark.as_ref().is_some_and(|mark| !mark.contains(&options.calibration)) {
        text.push_str("It was corrected with another calibration.\n");
    }
    if !is_within(checked, options) {
        text.push_str(&format!("Failed: {} µm are allowed\n", short(options.tolerance * 1e3)));
    }
    text
}

/// A writer that remembers why it failed.
struct Remembering<W> {
    into: W,
    error: Option<std::io::Error>,
}

impl<W: Write> Remembering<W> {
    fn remembered<T>(&mut self, result: std::io::Result<T>) -> std::io::Result<T> {
        result.map_err(|error| {
            let told = std::io::Error::from(error.kind());
            self.error = Some(error);
            told
        })
    }
}

impl<W: Write> Write for Remembering<W> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        // A long program ends within a block, so that its temporary file goes with it.
        if interrupt::happened() {
            return Err(std::io::ErrorKind::Other.into());
        }
        let written = self.into.write(bytes);
        // Who is interrupted tries again.
        match written {
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => Err(error),
            written => self.remembered(written),
        }
    }

    fn flush(&mut self) -> std::io::Result<()> {
        let flushed = self.into.flush();
        self.remembered(flushed)
    }
}

fn summary_json(summary: &Summary) -> serde_json::Value {
    json!({
        "lines": summary.lines, "moves": summary.moves, "blocks": summary.blocks,
        "arcs": { "programmed": summary.arcs[0], "written": summary.arcs[1] },
        "take_ups": summary.take_ups, "uncorrected": summary.uncorrected,
        "largest_correction_um": summary.largest * 1e3,
        "remaining_um": summary.remaining * 1e3, "remaining_line": summary.remaining_line,
        "remarks": summary.remarks,
        "offsets_taken_as_zero": summary.assumed.iter().map(|system| SYSTEMS[*system]).collect::<Vec<_>>(),
    })
}

fn checked_json(checked: &Checked) -> serde_json::Value {
    let worst = |worst: abbe_controllers::Worst| json!({ "remaining_um": worst.distance * 1e3, "line": worst.line, "line_of_program": worst.of });
    json!({
        "blocks": checked.blocks, "places": checked.places, "mark": checked.mark,
        "path": worst(checked.path), "rapid": worst(checked.rapid),
    })
}
