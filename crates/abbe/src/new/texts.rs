//! The files that a calibration begins with.

use std::fmt::Write as _;

use abbe_core::AxisKind;
use abbe_kinematics::StructuralLoop;

use super::Method;

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

/// Whether a rotary axis turns about the axis of the spindle or of the table: all round.
fn turns_round(direction: [f64; 3]) -> bool {
    direction[2] != 0.0
}

impl Method {
    /// Name of the artefact stage.
    pub fn stage(self) -> &'static str {
        match self {
            Self::Table => "table",
            Self::Ball => "ball",
            Self::Balls => "balls",
        }
    }

    /// The artefact plugin.
    fn plugin(self) -> &'static str {
        if self == Self::Table { "facets" } else { "balls" }
    }

    /// The file of nominal values.
    pub fn nominal_file(self) -> &'static str {
        if self == Self::Table { "facets.csv" } else { "balls.csv" }
    }

    /// Nominal places, table frame.
    pub fn nominal(self) -> String {
        match self {
            Self::Table => faces(),
            Self::Ball => "feature,x_mm,y_mm,z_mm,diameter_mm\n1,90,30,120,25\n".to_owned(),
            Self::Balls => "feature,x_mm,y_mm,z_mm,diameter_mm\n1,110,20,60,25\n2,-70,100,140,25\n3,-60,-90,60,25\n4,40,-60,180,25\n".to_owned(),
        }
    }

    /// What is touched, for people.
    fn touched(self) -> &'static str {
        match self {
            Self::Table => "the faces of the machine's own table, or of a block on it",
            Self::Ball => "a ball on the table",
            Self::Balls => "balls on the table",
        }
    }
}

/// Three places on the top of a block and two on each of its sides.
fn faces() -> String {
    let mut text = "feature,x_mm,y_mm,z_mm,nx,ny,nz\n".to_owned();
    let mut add = |place: [f64; 3], normal: [f64; 3], number: usize| {
        let cells: Vec<String> = place.iter().chain(&normal).map(f64::to_string).collect();
        let _ = writeln!(text, "{number},{}", cells.join(","));
    };
    let mut number = 0;
    let mut next = || {
        number += 1;
        number
    };
    for [x, y] in [[100.0, 80.0], [-110.0, 70.0], [20.0, -100.0]] {
        add([x, y, 0.0], [0.0, 0.0, 1.0], next());
    }
    for side in [1.0, -1.0] {
        for [along, below] in [[-70.0, -20.0], [80.0, -45.0]] {
            add([side * 150.0, along, below], [side, 0.0, 0.0], next());
            add([along, side * 150.0, below], [0.0, side, 0.0], next());
        }
    }
    text
}

/// What `abbe plan` chooses.
#[derive(Debug, Clone, Copy)]
pub enum Choice {
    /// So many positions of the rotary axes, with all touches there.
    Groups(usize),
    /// So many touches.
    Rows(usize),
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
    /// What was left out, for the reader of the recipe.
    pub remarks: &'a [String],
    /// Whether verdicts are asked.
    pub judged: bool,
}

impl Recipe<'_> {
    /// The text of the recipe.
    pub fn text(&self) -> String {
        let Self { chain, method, .. } = self;
        let stage = method.stage();
        let turns = chain.axes.iter().any(|axis| axis.kind() == AxisKind::Rotary && !axis.indexed);
        // Without rotary axes nothing but the form of a ball tells squareness.
        let pattern = if turns || *method == Method::Table { "" } else { ", pattern: twenty-five" };
        let mut text = format!(
            "# Calibration of a machine with the axes {chain}\n# by touching {}.\n\
             # `abbe check` says what these touches tell, `abbe run` what the machine is.\n\
             abbe: 1\nname: Calibration of my machine\n\nstages:\n  \
             touches: {{ ingest: csv, path: touches.csv }}             # positions of the axes when the stylus touched\n  \
             {stage}: {{ artefact: {}, from: touches, nominal: {}, standard_uncertainty_um: 2{pattern} }}   # of one touch\n\n  \
             machine: {{ model: serial-chain, file: machine.yaml }}\n\n",
            method.touched(),
            method.plugin(),
            method.nominal_file()
        );
        if !self.left_out.is_empty() {
            let line = format!("Not told by these touches: {}", self.left_out.join(", "));
            wrapped(&line, 110).iter().for_each(|line| text.push_str(&format!("  # {line}\n")));
        }
        // Brackets have a meaning of their own in YAML.
        let quoted = |name: &String| if name.contains('[') { format!("\"{name}\"") } else { name.clone() };
        let parameters: Vec<String> = self.parameters.iter().map(quoted).collect();
        let _ = write!(
            text,
            "  fit:\n    estimate: gauss-newton\n    machine: machine\n    observations: [{stage}]\n    parameters: [{}, \"{stage}.*\"]\n    \
             robust: tukey                       # gross errors lose their influence and are listed\n",
            parameters.join(", ")
        );
        if self.judged {
            text.push_str(
                "\n  residuals: { validate: residuals, of: fit, limits: { rms_um: 10 } }   # what is not explained\n",
            );
            if let Some(folds) = self.folds {
                let _ = writeln!(
                    text,
                    "  unseen: {{ validate: hold-out, of: fit, rows: {stage}, column: group, folds: {folds} }}   # positions that were left out"
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
        let rotary = self.chain.axes.iter().filter(|axis| axis.kind() == AxisKind::Rotary && !axis.indexed);
        let indexations: Vec<String> = rotary
            .map(|axis| match turns_round(axis.direction()) {
                true => format!("{}: {{ from: 0, to: 300, step: 60 }}", axis.name),
                false => format!("{}: {{ from: -60, to: 60, step: 30 }}", axis.name),
            })
            .collect();
        let choice = match self.choice {
            Choice::Groups(number) => {
                format!(
                    "  by: group                             # touches at one position of the rotary axes\n  number: {number}\n"
                )
            }
            Choice::Rows(number) => format!("  number: {number}\n"),
        };
        let indexed = match indexations.is_empty() {
            true => "{ reach_deg: 90 }".to_owned(),
            false => format!("{{ reach_deg: 90, indexations_deg: {{ {} }} }}", indexations.join(", ")),
        };
        format!(
            "\n# `abbe plan recipe.yaml --out plan` chooses touches that the axes reach; they go into touches.csv.\nplan:\n  \
             estimate: fit\n  candidates: {}\n{choice}  generate: {indexed}\n",
            self.method.stage()
        )
    }
}
