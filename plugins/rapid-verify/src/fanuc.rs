//! Exporter `verify-fanuc`: baseline and verify programs for Fanuc and Haas controllers with Custom Macro B.
//!
//! `G31` stops at the skip signal, and `#5061` to `#5063` hold where, in the work coordinates that are active; without a signal they
//! hold the end of the block. The program runs in a work offset that is zero, which it checks, so that these are machine
//! coordinates. Variables follow Table 2 of Muelaner et al. 2014: tolerance, readings, minima, maxima, flags, without gaps.

use abbe_core::{Context, Error, Export, Result, SettingsError};
use abbe_measuring::language::fanuc::{
    STOPPED_MM, alarm, guarded, remark, skipped, stop, until_contact, was_stopped, zero_offset,
};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value as Json, json};

use crate::controller::{Common, Dialect, Kind, number, short_number};
use crate::plan::Motion;
use crate::program::{Condition, Fault, Programme, Step, Target, Value, Variable};

abbe_core::register!(
    Export,
    "verify-fanuc",
    "baseline and verify programs for Fanuc and Haas controllers, which need no computer beside the machine",
    Settings,
    example,
    build,
    "../reference/export-verify-fanuc.md",
);

/// Settings of the programs.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// CSV file of the nominal points.
    nominal: String,
    /// Tolerance of every reading.
    #[schemars(range(max = 1e4))]
    tolerance_um: f64,
    /// How the machine moves.
    motion: Motion,
    /// Number of the variable with the tolerance; all other variables follow it. It has to be a variable that keeps its
    /// value.
    #[serde(default = "first_variable")]
    first_variable: u32,
    /// Number of the baseline program; verify has the next one.
    #[serde(default = "program")]
    program: u32,
    /// The word that moves until the skip signal.
    #[serde(default = "skip")]
    skip: String,
    /// A work offset that is zero in all axes.
    #[serde(default = "work_offset")]
    work_offset: String,
    /// First number of the alarms (`#3000`).
    #[serde(default = "first_alarm")]
    first_alarm: u32,
    /// The block that orients the spindle, which a stylus beside the spindle line needs.
    #[serde(default = "orientation")]
    orientation: String,
}

fn first_variable() -> u32 {
    800
}

fn program() -> u32 {
    9801
}

fn skip() -> String {
    "G31".to_owned()
}

fn work_offset() -> String {
    "G59".to_owned()
}

fn first_alarm() -> u32 {
    100
}

fn orientation() -> String {
    "M19".to_owned()
}

fn example() -> Json {
    json!({ "nominal": "points.csv", "tolerance_um": 12, "motion": { "retract_mm": 150 }, "first_variable": 800 })
}

/// Refuses a setting that is not one word or a few of a program.
fn is_block(name: &str, text: &str) -> Result<(), SettingsError> {
    let letters = |letter: char| letter.is_ascii_uppercase() || letter.is_ascii_digit() || ". ".contains(letter);
    let ends = |word: &str| ["M0", "M00", "M1", "M01", "M2", "M02", "M30", "M98", "M99"].contains(&word);
    if text.split(' ').any(ends) {
        return Err(SettingsError::new(name, format!("`{text}` would end or leave the program")));
    }
    match text.starts_with(|letter: char| letter.is_ascii_uppercase()) && text.chars().all(letters) {
        true => Ok(()),
        false => Err(SettingsError::new(name, format!("`{text}` is no word of a program; `G31` would be one"))),
    }
}

/// Whether a block chooses a work offset: one of Fanuc's, or of Haas.
fn is_work_offset(block: &str) -> bool {
    let (code, rest) = block.split_once(' ').map_or((block, None), |(code, rest)| (code, Some(rest)));
    match (code, rest) {
        ("G54.1" | "G154", Some(number)) => {
            number.strip_prefix('P').is_some_and(|number| number.parse::<u32>().is_ok_and(|number| number > 0))
        }
        (_, None) => {
            let number = code.strip_prefix('G').and_then(|number| number.parse::<u32>().ok());
            number.is_some_and(|number| (54..=59).contains(&number) || (110..=129).contains(&number))
        }
        _ => false,
    }
}

/// Whether a block is `G31`, as such (`G31.1` of some controls), perhaps with the number of a signal (`G31 P1`).
fn moves_until_signal(skip: &str) -> bool {
    let is_number = |text: &str| !text.is_empty() && text.chars().all(|digit| digit.is_ascii_digit());
    let mut words = skip.split(' ');
    let code = words.next().and_then(|word| word.strip_prefix("G31"));
    let moves = code.is_some_and(|rest| rest.is_empty() || rest.strip_prefix('.').is_some_and(is_number));
    moves && words.all(|word| word.strip_prefix('P').is_some_and(is_number))
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Export>, SettingsError> {
    if !(1..=9998).contains(&settings.program) {
        return Err(SettingsError::new("program", "a number from 1 to 9998 was expected"));
    }
    if !(100..=990).contains(&settings.first_variable) {
        return Err(SettingsError::new("first_variable", "a common variable from 100 to 990 was expected"));
    }
    if settings.first_alarm > 190 {
        return Err(SettingsError::new("first_alarm", "a number up to 190 was expected"));
    }
    is_block("skip", &settings.skip)?;
    if !moves_until_signal(&settings.skip) {
        let message =
            format!("`{}` does not stop at the skip signal: with it the probe would be driven on", settings.skip);
        return Err(SettingsError::new("skip", format!("{message}; `G31`, `G31.1` or `G31 P1` were expected")));
    }
    is_block("work_offset", &settings.work_offset)?;
    if !is_work_offset(&settings.work_offset) {
        let message = format!("`{}` is no work offset", settings.work_offset);
        let expected = "`G54` to `G59`, `G54.1 P1`, and on a Haas `G154 P1` or `G110` to `G129`, were expected";
        return Err(SettingsError::new("work_offset", format!("{message}; {expected}")));
    }
    is_block("orientation", &settings.orientation)?;
    let common = Common::new(context, &settings.nominal, settings.tolerance_um, &settings.motion)?;
    Ok(common.exporter(Fanuc { settings }))
}

struct Fanuc {
    settings: Settings,
}

/// The last common variable.
const LAST_VARIABLE: usize = 999;

impl Dialect for Fanuc {
    fn file(&self, kind: Kind) -> String {
        format!("O{:04}.nc", self.number(kind))
    }

    fn program(&self, programme: &Programme, kind: Kind, steps: &[Step]) -> Result<String> {
        let points = programme.stops.len();
        let last = self.settings.first_variable as usize + 3 * points + 3;
        if last > LAST_VARIABLE {
            let message = format!("{points} points need #{} to #{last}", self.settings.first_variable);
            let error = Error::usage(format!("{message}; the last common variable is #{LAST_VARIABLE}"));
            return Err(error.setting("first_variable").help("use fewer points or a smaller first variable"));
        }
        let axes = programme.stops.iter().map(|stop| &stop.axis).chain([&programme.retract.0]);
        if let Some(axis) = axes.into_iter().find(|axis| skipped(axis).is_none()) {
            return Err(Error::usage(format!("`G31` along {axis}: the first three axes are X, Y and Z here")));
        }
        let mut text = Text { settings: &self.settings, points, label: 0, loops: 0, lines: Vec::new() };
        text.head(kind, self.number(kind));
        text.steps(steps)?;
        text.lines.extend(["M30".to_owned(), "%".to_owned()]);
        Ok(text.lines.join("\n") + "\n")
    }
}

impl Fanuc {
    fn number(&self, kind: Kind) -> u32 {
        self.settings.program + if kind == Kind::Baseline { 0 } else { 1 }
    }
}

struct Text<'a> {
    settings: &'a Settings,
    points: usize,
    /// Last label that was used.
    label: u32,
    /// Loops that are open.
    loops: u32,
    lines: Vec<String>,
}

impl Text<'_> {
    fn add(&mut self, text: impl Into<String>) {
        self.lines.push(text.into());
    }

    fn head(&mut self, kind: Kind, program: u32) {
        let title = if kind == Kind::Baseline { "BASELINE" } else { "VERIFY" };
        let (of, last) = (|variable| self.variable(variable), self.points - 1);
        let lines = [
            "%".to_owned(),
            format!("O{program:04}(RAPID VERIFICATION {title})"),
            format!("({} TOLERANCE, MM)", of(Variable::Tolerance)),
            format!(
                "({} TO {} BASELINE READINGS, MACHINE COORDINATES)",
                of(Variable::Value(0)),
                of(Variable::Value(last))
            ),
            format!("({} TO {} SMALLEST ADMISSIBLE READINGS)", of(Variable::Min(0)), of(Variable::Min(last))),
            format!("({} TO {} LARGEST ADMISSIBLE READINGS)", of(Variable::Max(0)), of(Variable::Max(last))),
            format!(
                "({} BASELINE RUNS, {} POINTS OUT, {} FIRST POINT OUT)",
                of(Variable::Runs),
                of(Variable::Out),
                of(Variable::FirstOut)
            ),
            "(CALL THE PROBE AND SWITCH IT ON BEFORE THIS PROGRAM)".to_owned(),
            "G21 G17 G40 G49 G80 G90 G94".to_owned(),
            self.settings.work_offset.clone(),
        ];
        self.lines.extend(lines);
        self.lines.extend(zero_offset(&self.alarm(Fault::WorkOffset, "work offset is not zero")));
        self.add(self.settings.orientation.clone());
    }

    fn variable(&self, variable: Variable) -> String {
        let common = |offset: usize| format!("#{}", self.settings.first_variable as usize + offset);
        match variable {
            Variable::Tolerance => common(0),
            Variable::Value(point) => common(point + 1),
            Variable::Min(point) => common(self.points + point + 1),
            Variable::Max(point) => common(2 * self.points + point + 1),
            Variable::Runs => common(3 * self.points + 1),
            Variable::Out => common(3 * self.points + 2),
            Variable::FirstOut => common(3 * self.points + 3),
            Variable::Measured => "#1".to_owned(),
            Variable::Touched => "#2".to_owned(),
            Variable::Attempts => "#3".to_owned(),
            Variable::IsOut => "#4".to_owned(),
            Variable::IsFirst => "#5".to_owned(),
        }
    }

    fn value(&self, value: Value) -> String {
        match value {
            Value::Number(value) => short_number(value),
            Value::Of(variable) => self.variable(variable),
            Value::Sum(one, other) => format!("{}+{}", self.variable(one), self.variable(other)),
            Value::Next(variable) => format!("{}+1", self.variable(variable)),
            Value::Difference(one, other) => format!("{}-{}", self.variable(one), self.variable(other)),
        }
    }

    fn condition(&self, condition: Condition) -> String {
        let bracketed = |value: Value| match value {
            Value::Number(_) | Value::Of(_) => self.value(value),
            _ => format!("[{}]", self.value(value)),
        };
        match condition {
            Condition::Less(variable, value) => format!("[{} LT {}]", self.variable(variable), bracketed(value)),
            Condition::NotLess(variable, value) => format!("[{} GE {}]", self.variable(variable), bracketed(value)),
        }
    }

    fn alarm(&self, fault: Fault, text: &str) -> String {
        alarm(self.settings.first_alarm + fault.number(), text)
    }

    fn steps(&mut self, steps: &[Step]) -> Result<()> {
        for step in steps {
            self.step(step)?;
        }
        Ok(())
    }

    fn step(&mut self, step: &Step) -> Result<()> {
        let Motion { probing_feed_mm_per_min, positioning_feed_mm_per_min, .. } = &self.settings.motion;
        let (probing, positioning) = (number(*probing_feed_mm_per_min), number(*positioning_feed_mm_per_min));
        let skip = &self.settings.skip;
        match step {
            Step::Comment(text) => self.add(remark(text)),
            Step::Set(variable, value) => self.add(format!("{}={}", self.variable(*variable), self.value(*value))),
            Step::If(condition, inner) => {
                self.label += 1;
                let label = self.label;
                self.add(format!("IF {} GOTO {label}", self.condition(condition.opposite())));
                self.steps(inner)?;
                self.add(format!("N{label}"));
            }
            Step::While(condition, inner) => {
                self.loops += 1;
                let number = self.loops;
                self.add(format!("WHILE {} DO{number}", self.condition(*condition)));
                self.steps(inner)?;
                self.add(format!("END{number}"));
                self.loops -= 1;
            }
            Step::Rapid(target) => self.add(format!("G0 {}", words(target))),
            Step::Guarded(axis, at) => {
                let alarm = self.alarm(Fault::Obstacle, "obstacle before a point");
                let stopped = STOPPED_MM.to_string();
                self.lines.extend(guarded(skip, &[(axis, number(*at))], [&positioning, &stopped], &alarm));
            }
            Step::Back(axis, at) => self.add(format!("G1 {axis}{} F{positioning}", number(*at))),
            Step::Probe(axis, to) => {
                // The axes of all stops have one: `program` looks.
                let (skipped, end) = (skipped(axis).unwrap_or_default(), number(*to));
                self.add(until_contact(skip, &format!("{axis}{end}"), &probing));
                self.add(format!("#1={skipped}"));
                self.add("#2=0");
                self.add(format!("IF {} THEN #2=1", was_stopped("#1", &end, &STOPPED_MM.to_string())));
            }
            Step::Alarm(fault, text) => self.add(self.alarm(*fault, text)),
            Step::Stop(text) => self.add(stop(text)),
            // A message without a stop is a comment on the screen that shows the running block.
            Step::Message(text) => self.add(remark(text)),
        }
        Ok(())
    }
}

fn words(target: &Target) -> String {
    let words: Vec<String> = target.iter().map(|(axis, at)| format!("{axis}{}", number(*at))).collect();
    words.join(" ")
}
