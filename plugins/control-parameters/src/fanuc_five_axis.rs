//! Exporter `fanuc-five-axis`: places of rotary axes in the parameters of Fanuc controls.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use abbe_core::{
    Calibration, CommandCorrection, Context, Error, Export, ExportedFile, KinematicModel, PathItem, Result,
    SettingsError, positive,
};
use nalgebra::{Isometry3, Translation3, Vector3};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::files::file;
use crate::five_axis::{FiveAxes, Transformation, across};

abbe_core::register!(
    Export,
    "fanuc-five-axis",
    "places of the rotary axes for Fanuc controls",
    Settings,
    example,
    build,
    "../reference/export-fanuc-five-axis.md",
);

/// First parameters of the vectors: table, first to second axis of the table, tool to its (second) axis, second to first one.
const VECTORS: [u32; 4] = [19700, 19703, 19709, 19712];

/// Settings of the parameters.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// Least input increment of the control.
    increment: Increment,
    /// Vectors, mm, with which the machine was measured, by their first parameters: `19700`, `19703`, `19709`, `19712`. New ones are
    /// these and the errors.
    existing: BTreeMap<String, [f64; 3]>,
    /// Length of the tool of the calibration as the control knows it, with its holder.
    tool_length_mm: f64,
    /// Largest change of a component of a vector.
    #[serde(default = "one")]
    largest_change_mm: f64,
}

/// Increment systems for machines in mm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
enum Increment {
    /// 0.001 mm.
    #[serde(rename = "IS-B")]
    B,
    /// 0.0001 mm.
    #[serde(rename = "IS-C")]
    C,
}

impl Increment {
    fn per_mm(self) -> f64 {
        match self {
            Self::B => 1e3,
            Self::C => 1e4,
        }
    }

    /// Whole increments.
    fn count(self, lengths: Vector3<f64>) -> Vector3<f64> {
        lengths.map(|length| (length * self.per_mm()).round())
    }
}

fn one() -> f64 {
    1.0
}

fn example() -> Value {
    json!({ "increment": "IS-C", "existing": { "19700": [0, 0, -50], "19703": [0, 0, 0] }, "tool_length_mm": 120 })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Export>, SettingsError> {
    positive("largest_change_mm", settings.largest_change_mm)?;
    if !settings.tool_length_mm.is_finite() {
        return Err(SettingsError::new("tool_length_mm", "a length in mm was expected"));
    }
    for (name, vector) in &settings.existing {
        let known = VECTORS.iter().any(|number| number.to_string() == *name);
        if !known || !vector.iter().all(|part| part.is_finite()) {
            let message = "three numbers in mm of 19700, 19703, 19709 or 19712 were expected";
            return Err(SettingsError::new(name, message).under([PathItem::Key("existing".to_owned())]));
        }
    }
    Ok(Box::new(FanucFiveAxis { settings }))
}

struct FanucFiveAxis {
    settings: Settings,
}

/// A vector to or between axes.
struct Vector {
    number: u32,
    nominal: Vector3<f64>,
    change: Vector3<f64>,
    /// Directions of the axes at its ends: along these it may have any length.
    ends: Vec<Vector3<f64>>,
}

/// What the file says.
struct Numbers {
    five: FiveAxes,
    /// Type of the mechanism (19680).
    kind: u32,
    /// First parameters and vectors in increments.
    vectors: Vec<(u32, Vector3<f64>)>,
    /// What moves work offsets, in increments.
    shift: Vector3<f64>,
}

/// Type of the mechanism, and its vectors. `tool` is from the tip to the controlled point.
fn vectors(five: &FiveAxes, tool: Vector3<f64>) -> Result<(u32, Vec<Vector>)> {
    let moved = |of: &Transformation| {
        let places = of.table.iter().chain(&of.head).map(|line| line.point.coords - tool);
        places.collect::<Vec<_>>()
    };
    let (nominal, actual) = (moved(&five.nominal), moved(&five.actual));
    let directions: Vec<_> = five.nominal.table.iter().chain(&five.nominal.head).map(|line| line.direction).collect();
    let to = |number: u32, axis: usize| Vector {
        number,
        nominal: nominal[axis],
        change: actual[axis] - nominal[axis],
        ends: vec![directions[axis]],
    };
    let between = |number: u32, from: usize, to: usize| Vector {
        number,
        nominal: nominal[to] - nominal[from],
        change: actual[to] - nominal[to] - (actual[from] - nominal[from]),
        ends: vec![directions[to], directions[from]],
    };
    match (five.nominal.table.len(), five.nominal.head.len()) {
        (2, 0) => Ok((12, vec![to(19700, 0), between(19703, 0, 1)])),
        (1, 1) => Ok((21, vec![to(19700, 0), to(19709, 1)])),
        (0, 2) => Ok((2, vec![to(19709, 1), between(19712, 1, 0)])),
        (table, head) => {
            let message = format!("the machine has {table} rotary axes of the table and {head} of the tool");
            Err(Error::usage(message).help("two rotary axes were expected; `export: set-points` corrects any machine"))
        }
    }
}

impl FanucFiveAxis {
    fn numbers(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Numbers> {
        let five = FiveAxes::new(calibration, model)?;
        let (kind, found) = vectors(&five, Vector3::z() * self.settings.tool_length_mm)?;
        let wanted = |name: &String| found.iter().any(|vector| vector.number.to_string() == *name);
        if let Some(name) = self.settings.existing.keys().find(|name| !wanted(name)) {
            return Err(existing(Error::usage(format!("a mechanism of type {kind} has no vector {name}")), name));
        }
        let mut vectors = Vec::new();
        for vector in &found {
            let new = self.present(vector)? + vector.change;
            vectors.push((vector.number, self.settings.increment.count(new)));
        }
        let zero = five.nominal.table.last().map(|line| line.point).unwrap_or_default();
        let shift = self.settings.increment.count(five.workpiece * zero - zero);
        Ok(Numbers { five, kind, vectors, shift })
    }

    /// The present vector, which has to be that of the nominal machine.
    fn present(&self, vector: &Vector) -> Result<Vector3<f64>> {
        let (name, most) = (vector.number.to_string(), self.settings.largest_change_mm);
        let Some(present) = self.settings.existing.get(&name) else {
            return Err(existing(Error::usage(format!("the present vector {name}, mm, was expected")), &name));
        };
        let off = across(Vector3::from(*present) - vector.nominal, &vector.ends).norm();
        if off > most {
            let message = format!("{name} is {off:.3} mm off the axes of the nominal machine of the calibration");
            let help = "are the order of the axes and the tool length those of the control?";
            return Err(existing(Error::usage(message).help(help), &name));
        }
        let change = vector.change.amax();
        if change.is_nan() || change > most {
            let message = format!("{name} would change by {change:.4} mm; at most {most} mm are allowed");
            let error = Error::data(message).help("is the calibration that of this machine? else allow more");
            return Err(error.setting("largest_change_mm"));
        }
        Ok(Vector3::from(*present))
    }

    /// The change of a vector as the control gets it.
    fn change(&self, number: u32, counts: Vector3<f64>) -> Vector3<f64> {
        let present = self.settings.existing.get(&number.to_string()).copied().unwrap_or_default();
        counts / self.settings.increment.per_mm() - Vector3::from(present)
    }
}

fn existing(mut error: Error, name: &str) -> Error {
    error.setting = ["existing", name].map(|key| PathItem::Key(key.to_owned())).to_vec();
    error
}

impl Export for FanucFiveAxis {
    fn export(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Vec<ExportedFile>> {
        let Numbers { kind, vectors, shift, .. } = self.numbers(calibration, model)?;
        let mut text = "%\n".to_owned();
        for (number, counts) in vectors {
            for (number, count) in (number..).zip(counts.iter()) {
                writeln!(text, "N{number}P{};", count + 0.0).ok();
            }
        }
        text.push_str("%\n");
        let decimals = if self.settings.increment == Increment::B { 3 } else { 4 };
        let [x, y, z] = [shift.x, shift.y, shift.z].map(|count| count / self.settings.increment.per_mm() + 0.0);
        let offsets = format!(
            "%\nO0001 (ONCE, FOR WORK OFFSETS SET BEFORE, TYPE {kind})\n(FROM MEMORY: P0 MOVES ALL OF THEM, G91 ADDS)\n\
             G21\nG91 G10 L2 P0 X{x:.decimals$} Y{y:.decimals$} Z{z:.decimals$}\nG90\nM30\n%\n"
        );
        Ok(vec![file("five-axis.prm", text), file("work-offsets.nc", offsets)])
    }

    fn correction(
        &self,
        calibration: &Calibration,
        model: &dyn KinematicModel,
    ) -> Result<Option<Box<dyn CommandCorrection>>> {
        let Numbers { five, kind, vectors, shift } = self.numbers(calibration, model)?;
        let changes: Vec<Vector3<f64>> = vectors.iter().map(|(number, counts)| self.change(*number, *counts)).collect();
        let mut new = five.nominal.clone();
        if let [first, second] = changes[..] {
            let moves = match kind {
                12 => [first, first + second],
                21 => [first, second],
                _ => [first + second, first],
            };
            new.table.iter_mut().chain(&mut new.head).zip(moves).for_each(|(line, by)| line.point += by);
        }
        let shift = shift / self.settings.increment.per_mm();
        Ok(Some(five.predicted(new, Isometry3::from(Translation3::from(shift)))))
    }
}
