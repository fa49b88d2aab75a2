//! The files that a calibration begins with.

use std::fmt::Write as _;

use abbe_core::AxisKind;
use abbe_kinematics::StructuralLoop;

use super::methods::{Choice, turns_round};
use super::{Controller, Method, program};

/// Half the travel of a linear axis until its user knows better, mm.
const TRAVEL: f64 = 500.0;

/// What the machine file says of errors.
#[derive(Debug, Clone, Default)]
pub struct Errors {
    /// Independent location errors.
    pub locations: Vec<String>,
    /// Location errors that do what others do.
    pub others: Vec<String>,
    /// Positioning errors that get a scale: `EXX`.
    pub scales: Vec<String>,
}

/// The machine file.
pub fn machine(chain: &StructuralLoop, errors: &Errors) -> String {
    let mut text = format!(
        "# The machine. Numbers that end in `# fill in` are guesses: put those of your machine in their place.\n\
         name: My machine\n\
         chain: \"{chain}\"                # ISO 10791-6: from the workpiece to the tool, b is the bed\n\
         tool_length_mm: 150               # fill in: from the spindle nose to the centre of the stylus ball\n\
         stylus_radius_mm: 3               # fill in\n\
         axes:\n"
    );
    for axis in &chain.axes {
        let direction = axis.direction().map(|part| format!("{part}")).join(", ");
        let settings = match axis.kind() {
            AxisKind::Linear => format!("range_mm: [-{TRAVEL}, {TRAVEL}]"),
            AxisKind::Rotary => {
                let range = if turns_round(axis.direction()) { 360 } else { 90 };
                format!("range_deg: [-{range}, {range}], direction: [{direction}], point_mm: [0, 0, 0]")
            }
        };
        let what = if axis.kind() == AxisKind::Linear { "travel" } else { "range, and a point of its centre line" };
        let _ = writeln!(text, "  {}: {{ {settings} }}   # fill in: {what}", axis.name);
    }
    if errors.locations.is_empty() && errors.scales.is_empty() {
        return text;
    }
    text.push_str("errors:                             # that exist on this chain; `abbe model machine.yaml` says what they are\n");
    if !errors.locations.is_empty() {
        let _ = writeln!(text, "  - {{ location: [{}] }}", errors.locations.join(", "));
    }
    if !errors.others.is_empty() {
        let line = format!(
            "These location errors do on this chain what others or the set-up do: {}",
            errors.others.join(", ")
        );
        wrapped(&line, 100).iter().for_each(|line| text.push_str(&format!("  # {line}\n")));
    }
    if !errors.scales.is_empty() {
        let _ = writeln!(text, "  - {{ polynomial: [{}], degrees: [1] }}   # scales", errors.scales.join(", "));
    }
    text
}

/// Lines of words, none longer than `width` if its words are not.
fn wrapped(text: &str, width: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split(' ') {
        match lines.last_mut() {
            Some(line) if line.len() + 1 + word.len() <= width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

/// What the recipe says.
#[derive(Debug, Clone)]
pub struct Recipe<'a> {
    pub chain: &'a StructuralLoop,
    pub method: Method,
    /// Unknowns of the machine.
    pub parameters: &'a [String],
    /// Unknowns that the touches do not tell.
    pub left_out: &'a [String],
    pub choice: Choice,
    /// Folds of the validation; none without indexations.
    pub folds: Option<usize>,
    /// The exporter for the control.
    pub export: Option<&'a str>,
    /// The control that runs a measuring program.
    pub program: Option<Controller>,
    /// What was left out, for the reader of the recipe.
    pub remarks: &'a [String],
    /// Whether verdicts are asked.
    pub judged: bool,
}

impl Recipe<'_> {
    /// The text of the recipe.
    pub fn text(&self) -> String {
        let Self { chain, method, .. } = self;
        let (stage, ingest) = (method.stage(), method.ingest());
        let (artefact, comment) = method.artefact(chain);
        let [_, rows, _] = method.rows();
        let mut text = format!(
            "# Calibration of a machine with the axes {chain}\n# by {}.\n\
             # `abbe check` says what these {rows} tell, `abbe run` what the machine is.\n\
             abbe: 1\nname: Calibration of my machine\n\nstages:\n  \
             {ingest}: {{ ingest: csv, path: {} }}             # {}\n{}  \
             {stage}: {{ artefact: {artefact}, from: {ingest} }}   # {comment}\n\n  \
             machine: {{ model: serial-chain, file: machine.yaml }}\n\n",
            method.measured(),
            method.data_file(),
            method.data(),
            self.program
                .filter(|_| program::is_written(*method, chain))
                .map(|control| program::reader(control, ingest))
                .unwrap_or_default()
        );
        if !self.left_out.is_empty() {
            let line = format!("Not told by these {rows}: {}", self.left_out.join(", "));
            wrapped(&line, 110).iter().for_each(|line| text.push_str(&format!("  # {line}\n")));
        }
        // Brackets have a meaning of their own in YAML.
        let quoted = |name: &String| if name.contains('[') { format!("\"{name}\"") } else { name.clone() };
        // Known lengths have no unknowns of their own.
        let own = (*method != Method::Lengths).then(|| format!("\"{stage}.*\""));
        let parameters: Vec<String> = self.parameters.iter().map(quoted).chain(own).collect();
        let _ = write!(
            text,
            "  fit:\n    estimate: gauss-newton\n    machine: machine\n    observations: [{stage}]\n    parameters: [{}]\n    \
             robust: tukey                       # gross errors lose their influence and are listed\n",
            parameters.join(", ")
        );
        if self.judged {
            let _ = writeln!(
                text,
                "\n  residuals: {{ validate: residuals, of: fit, limits: {{ rms_um: {} }} }}   # what is not explained",
                method.largest_rms()
            );
            if let Some(folds) = self.folds {
                let _ = writeln!(
                    text,
                    "  unseen: {{ validate: hold-out, of: fit, rows: {stage}, column: {}, folds: {folds} }}   # predicted from the others",
                    method.held_out_by()
                );
            }
            text.push_str("  errors: { export: uncertainty, of: fit }\n");
        }
        if let Some(export) = self.export {
            let _ = writeln!(text, "  control: {{ export: {export}, of: fit }}");
        }
        for remark in self.remarks {
            wrapped(remark, 110).iter().for_each(|line| text.push_str(&format!("  # {line}\n")));
        }
        text.push_str(&self.plan());
        text
    }

    /// The key `plan`.
    fn plan(&self) -> String {
        let Self { chain, method, .. } = self;
        let [_, rows, _] = method.rows();
        let choice = match self.choice {
            Choice::Groups(number) => {
                format!(
                    "  by: group                             # {rows} at one position of the rotary axes\n  number: {number}\n"
                )
            }
            Choice::Rows(number) => format!("  number: {number}\n"),
        };
        let (what, generate) = match method.generates() {
            true => (
                format!("chooses {rows} that the axes reach; they go into"),
                format!("  generate:{}\n", method.grid(chain)),
            ),
            false => (format!("chooses among the {rows} of"), String::new()),
        };
        format!(
            "\n# `abbe plan recipe.yaml --out plan` {what} {}.\nplan:\n  estimate: fit\n  candidates: {}\n{choice}{}{generate}",
            method.data_file(),
            method.stage(),
            self.program.map(|control| program::program(*method, control, chain)).unwrap_or_default()
        )
    }
}
