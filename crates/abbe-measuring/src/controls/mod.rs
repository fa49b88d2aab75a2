//! Writers of programs, one for each control, and what they share.

mod fanuc;
mod grbl;
mod heidenhain;
mod linuxcnc;
mod siemens;

use abbe_core::{AxisKind, ExportedFile, Result};

use crate::language;
use crate::programme::{ControlAxis, Positions, Programme};
use crate::settings::{Control, Measuring, Units};

/// The files of a program; a dry run touches nothing.
pub fn write(settings: &Measuring, program: &Programme, dry: bool) -> Result<Vec<ExportedFile>> {
    let job = Job { settings, program, dry };
    match settings.control {
        Control::Linuxcnc => linuxcnc::write(&job),
        Control::Fanuc => fanuc::write(&job),
        Control::Siemens => siemens::write(&job),
        Control::Heidenhain => heidenhain::write(&job),
        Control::Grbl => grbl::write(&job),
    }
}

/// A program to write.
struct Job<'a> {
    settings: &'a Measuring,
    program: &'a Programme,
    dry: bool,
}

impl Job<'_> {
    /// `measure` or `dry-run`.
    fn name(&self) -> &'static str {
        if self.dry { "dry-run" } else { "measure" }
    }

    fn axis(&self, index: usize) -> &ControlAxis {
        &self.program.axes[index]
    }

    fn in_inches(&self) -> bool {
        self.settings.units == Units::Inch
    }

    /// mm in a unit of length of the program.
    fn unit(&self) -> f64 {
        if self.in_inches() { 25.4 } else { 1.0 }
    }

    /// Decimals of a length in the log.
    fn decimals(&self) -> usize {
        if self.in_inches() { 5 } else { 4 }
    }

    /// A length, or a feed of linear axes, in the unit of the program.
    fn length(&self, mm: f64) -> String {
        language::number(mm / self.unit(), self.decimals())
    }

    /// A position of an axis in the unit of the program.
    fn place(&self, axis: usize, place: f64) -> String {
        if self.axis(axis).kind == AxisKind::Linear { self.length(place) } else { number(place) }
    }

    /// Words such as `X12.5 Y-3.0`, `between` letter and number.
    fn words(&self, positions: &Positions, between: &str) -> String {
        let word =
            |(axis, place): &(usize, f64)| format!("{}{between}{}", self.axis(*axis).letter, self.place(*axis, *place));
        positions.iter().map(word).collect::<Vec<_>>().join(" ")
    }

    /// Sentences at the beginning of a program, for the operator.
    fn introduction(&self) -> Vec<String> {
        let mut lines = vec![if self.dry {
            format!("Dry run, {} mm above the touches: nothing is touched", self.settings.dry_run_mm)
        } else {
            "Measures a plan with a touch probe".to_owned()
        }];
        let section: f64 = self.settings.probe.iter().map(|section| section.length_mm).sum();
        lines.extend([
            format!(
                "Plan {}, {} touches, machine coordinates in {} and degrees",
                self.program.hash,
                self.program.touches.list.len(),
                if self.in_inches() { "inches" } else { "mm" }
            ),
            format!("Moves take {:.1} minutes at the programmed feeds", self.program.seconds / 60.0),
            format!(
                "Diameter of the tip {} mm, probe checked to {} mm above the tip",
                number(self.program.tip_diameter),
                number(section)
            ),
            "Call the probe, switch it on, and take its tip clear of everything before the start".to_owned(),
            "No tool length and no transformation of rotary axes are active".to_owned(),
        ]);
        lines.extend(self.program.left_out.iter().map(|left_out| format!("Left out: {left_out}")));
        lines
    }

    /// The lines of a log before the first touch.
    fn header(&self, control: &str) -> Vec<String> {
        vec![
            "ABBE 1".to_owned(),
            format!("PLAN {}", self.program.hash),
            format!("CONTROL {control}"),
            format!("UNITS {}", if self.in_inches() { "INCH" } else { "MM" }),
            "FRAME MACHINE".to_owned(),
            format!("TOOL L0.0000 D{:.*}", self.decimals(), self.program.tip_diameter / self.unit()),
            format!("TOUCHES {} REPEATS {}", self.program.touches.list.len(), self.settings.repeats.get()),
        ]
    }
}

/// A number with at most four decimals, and at least one.
fn number(value: f64) -> String {
    language::number(value, 4)
}

fn file(name: String, lines: &[String]) -> ExportedFile {
    ExportedFile { name, content: (lines.join("\n") + "\n").into_bytes() }
}
