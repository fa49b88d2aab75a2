//! Exporter `verify-siemens`: baseline and verify programs for SINUMERIK 840D and its relatives.
//!
//! Positions are those of the machine: `SUPA` suppresses all offsets in its block, tool offsets are off (`D0`). `MEAS=1` measures with
//! deletion of the distance to go; `$AC_MEA[1]` then says whether the probe switched, `$AA_MM[axis]` where, in machine coordinates.
//! Results are R parameters in blocks of a hundred, as in the paper: values, minima, maxima, tolerance (Muelaner et al. 2014, 4.1).

use abbe_core::{Context, Error, Export, Result, SettingsError};
use abbe_measuring::language::siemens::{alarm, measured, message, remark, stop, to, touched, until_contact, watch};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value as Json, json};

use crate::controller::{Common, Dialect, Kind, number, short_number};
use crate::plan::Motion;
use crate::program::{Condition, Fault, Programme, Step, Target, Value, Variable};

abbe_core::register!(
    Export,
    "verify-siemens",
    "baseline and verify programs for Siemens controllers, which need no computer beside the machine",
    Settings,
    example,
    build,
    "../reference/export-verify-siemens.md",
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
    /// R parameter before the first value: R1001 is the first with 1000.
    #[serde(default = "first_variable")]
    first_variable: u32,
    /// Measuring input of the probe.
    #[serde(default = "probe_input")]
    probe_input: u32,
    /// First number of the alarms; users have 65000 to 69999.
    #[serde(default = "first_alarm")]
    first_alarm: u32,
    /// First part of the names of the programs.
    #[serde(default = "program")]
    program: String,
    /// Orientation of the spindle with the probe, which a stylus beside the spindle line needs.
    #[serde(default)]
    #[schemars(range(min = -360.0, max = 360.0))]
    spindle_deg: f64,
}

fn first_variable() -> u32 {
    1000
}

fn probe_input() -> u32 {
    1
}

fn first_alarm() -> u32 {
    65000
}

fn program() -> String {
    "RAPID".to_owned()
}

fn example() -> Json {
    json!({ "nominal": "points.csv", "tolerance_um": 12, "motion": { "retract_mm": 150 }, "first_variable": 1000 })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Export>, SettingsError> {
    if !(1..=2).contains(&settings.probe_input) {
        return Err(SettingsError::new("probe_input", "1 or 2 was expected"));
    }
    if !(65000..=69990).contains(&settings.first_alarm) {
        return Err(SettingsError::new("first_alarm", "a number from 65000 to 69990 was expected"));
    }
    let is_name = |text: &str| {
        let mut letters = text.chars();
        letters.next().is_some_and(|letter| letter.is_ascii_alphabetic())
            && letters.all(|letter| letter.is_ascii_alphanumeric() || letter == '_')
    };
    if !is_name(&settings.program) || settings.program.len() > 16 {
        return Err(SettingsError::new("program", "up to 16 letters, digits and `_` were expected, a letter first"));
    }
    if !(-360.0..=360.0).contains(&settings.spindle_deg) {
        return Err(SettingsError::new("spindle_deg", "a number from -360 to 360 was expected"));
    }
    let common = Common::new(context, &settings.nominal, settings.tolerance_um, &settings.motion)?;
    Ok(common.exporter(Siemens { settings }))
}

struct Siemens {
    settings: Settings,
}

/// The highest R parameter that a controller can have.
const LAST_VARIABLE: u32 = 32535;

impl Dialect for Siemens {
    fn file(&self, kind: Kind) -> String {
        format!("{}_{}.MPF", self.settings.program, if kind == Kind::Baseline { "BASELINE" } else { "VERIFY" })
    }

    fn program(&self, programme: &Programme, kind: Kind, steps: &[Step]) -> Result<String> {
        let text = Text { settings: &self.settings, block: block(programme.stops.len()) };
        let last = self.settings.first_variable as usize + 3 * text.block + 3;
        if last > LAST_VARIABLE as usize {
            let message = format!("the last R parameter would be R{last}; there are R0 to R{LAST_VARIABLE}");
            return Err(Error::usage(message).setting("first_variable"));
        }
        Ok(text.program(programme, kind, steps, last))
    }
}

/// Variables from one kind to the next: a hundred, or as many hundreds as the points need.
fn block(points: usize) -> usize {
    (points + 1).div_ceil(100) * 100
}

struct Text<'a> {
    settings: &'a Settings,
    block: usize,
}

impl Text<'_> {
    fn program(&self, programme: &Programme, kind: Kind, steps: &[Step], last: usize) -> String {
        let points = programme.stops.len();
        let title = if kind == Kind::Baseline { "BASELINE" } else { "VERIFY" };
        let of = |variable| self.variable(variable);
        let mut lines = vec![
            format!("; RAPID VERIFICATION: {title}, {points} POINTS"),
            format!(
                "; {} TO {}: BASELINE READINGS, MACHINE COORDINATES",
                of(Variable::Value(0)),
                of(Variable::Value(points - 1))
            ),
            format!("; {} TO {}: SMALLEST ADMISSIBLE READINGS", of(Variable::Min(0)), of(Variable::Min(points - 1))),
            format!("; {} TO {}: LARGEST ADMISSIBLE READINGS", of(Variable::Max(0)), of(Variable::Max(points - 1))),
            format!("; {}: TOLERANCE, MM", of(Variable::Tolerance)),
            format!(
                "; {}: BASELINE RUNS, {}: POINTS OUT, {}: FIRST POINT OUT",
                of(Variable::Runs),
                of(Variable::Out),
                of(Variable::FirstOut)
            ),
            format!("; R PARAMETERS UP TO R{last} HAVE TO EXIST"),
            "; CALL THE PROBE AND SWITCH IT ON BEFORE THIS PROGRAM".to_owned(),
            "DEF REAL _MEASURED=0".to_owned(),
            "DEF INT _TOUCHED=0".to_owned(),
            "DEF INT _ATTEMPTS=0".to_owned(),
            "DEF INT _ISOUT=0".to_owned(),
            "DEF INT _ISFIRST=0".to_owned(),
            "TRAFOOF".to_owned(),
            "G17 G40 G90 G94 G710".to_owned(),
            "D0".to_owned(),
            format!("SPOS={}", number(self.settings.spindle_deg)),
        ];
        self.steps(steps, &mut lines);
        lines.push("M30".to_owned());
        lines.join("\n") + "\n"
    }

    fn variable(&self, variable: Variable) -> String {
        let r = |offset: usize| format!("R{}", self.settings.first_variable as usize + offset);
        match variable {
            Variable::Value(point) => r(point + 1),
            Variable::Min(point) => r(self.block + point + 1),
            Variable::Max(point) => r(2 * self.block + point + 1),
            Variable::Tolerance => r(3 * self.block),
            Variable::Runs => r(3 * self.block + 1),
            Variable::Out => r(3 * self.block + 2),
            Variable::FirstOut => r(3 * self.block + 3),
            Variable::Measured => "_MEASURED".to_owned(),
            Variable::Touched => "_TOUCHED".to_owned(),
            Variable::Attempts => "_ATTEMPTS".to_owned(),
            Variable::IsOut => "_ISOUT".to_owned(),
            Variable::IsFirst => "_ISFIRST".to_owned(),
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
        match condition {
            Condition::Less(variable, value) => format!("{}<{}", self.variable(variable), self.bracketed(value)),
            Condition::NotLess(variable, value) => format!("{}>={}", self.variable(variable), self.bracketed(value)),
        }
    }

    fn bracketed(&self, value: Value) -> String {
        match value {
            Value::Number(_) | Value::Of(_) => self.value(value),
            _ => format!("({})", self.value(value)),
        }
    }

    fn steps(&self, steps: &[Step], lines: &mut Vec<String>) {
        let Motion { probing_feed_mm_per_min, positioning_feed_mm_per_min, .. } = &self.settings.motion;
        let (probing, positioning) = (number(*probing_feed_mm_per_min), number(*positioning_feed_mm_per_min));
        let input = self.settings.probe_input;
        let number_of = |fault: Fault| self.settings.first_alarm + fault.number();
        let word = |axis: &str, at: f64| format!("{axis}={}", number(at));
        for step in steps {
            let written = match step {
                Step::Comment(text) => vec![remark(text)],
                Step::Set(variable, value) => vec![format!("{}={}", self.variable(*variable), self.value(*value))],
                Step::If(condition, inner) => self.nested("IF", *condition, inner),
                Step::While(condition, inner) => self.nested("WHILE", *condition, inner),
                Step::Rapid(target) => vec![format!("G0 SUPA {}", words(target))],
                Step::Guarded(axis, at) => {
                    let mut lines = vec![until_contact(input, &word(axis, *at), &positioning)];
                    lines.extend(watch(input, number_of(Fault::Obstacle), "obstacle before a point"));
                    lines
                }
                Step::Back(axis, at) => vec![to(&word(axis, *at), &positioning)],
                Step::Probe(axis, end) => vec![
                    until_contact(input, &word(axis, *end), &probing),
                    "STOPRE".to_owned(),
                    format!("_TOUCHED={}", touched(input)),
                    format!("_MEASURED={}", measured(axis)),
                ],
                Step::Alarm(fault, text) => alarm(number_of(*fault), text),
                Step::Stop(text) => stop(text).into(),
                Step::Message(text) => vec![message(text)],
            };
            lines.extend(written);
        }
    }

    /// Steps within `IF` or `WHILE`, indented.
    fn nested(&self, word: &str, condition: Condition, inner: &[Step]) -> Vec<String> {
        let mut within = Vec::new();
        self.steps(inner, &mut within);
        let mut lines = vec![format!("{word} {}", self.condition(condition))];
        lines.extend(within.into_iter().map(|line| format!("  {line}")));
        lines.push(format!("END{word}"));
        lines
    }
}

fn words(target: &Target) -> String {
    let words: Vec<String> = target.iter().map(|(axis, at)| format!("{axis}={}", number(*at))).collect();
    words.join(" ")
}
