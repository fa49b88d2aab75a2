//! Exporter `siemens-kinematics`: vectors of a tool carrier with orientation capability of a SINUMERIK control.

use std::fmt::Write as _;

use abbe_core::{
    Calibration, CommandCorrection, Context, Error, Export, ExportedFile, KinematicModel, PathItem, Result,
    SettingsError, positive,
};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::files::{file, rounded};
use crate::five_axis::{FiveAxes, Line, Transformation, across};

abbe_core::register!(
    Export,
    "siemens-kinematics",
    "places and directions of the rotary axes for Siemens tool carriers",
    Settings,
    example,
    build,
    "../reference/export-siemens-kinematics.md",
);

/// Decimals of lengths, mm.
const DECIMALS: i32 = 6;

/// Decimals of directions and of angles in degrees.
const FINE: i32 = 9;

/// Present directions are those of the nominal axes to this much.
const SAME: f64 = 1e-2;

/// Settings of the tool carrier.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// Number of the tool carrier.
    #[serde(default = "first")]
    carrier: u32,
    /// Its vectors, with which the machine was measured. New ones are these and the errors.
    existing: Vectors,
    /// Length of the tool of the calibration as the control knows it, from the tool adapter down.
    tool_length_mm: f64,
    /// Largest change of a component of a vector.
    #[serde(default = "one")]
    largest_change_mm: f64,
}

/// Vectors of a tool carrier; type T has no I4, type P no I1.
#[derive(Debug, Clone, Copy, PartialEq, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Vectors {
    /// `$TC_CARR1` to `3`, mm.
    #[serde(rename = "I1", default)]
    i1: [f64; 3],
    /// `$TC_CARR4` to `6`, mm.
    #[serde(rename = "I2")]
    i2: [f64; 3],
    /// `$TC_CARR15` to `17`, mm.
    #[serde(rename = "I3")]
    i3: [f64; 3],
    /// `$TC_CARR18` to `20`, mm.
    #[serde(rename = "I4", default)]
    i4: [f64; 3],
    /// `$TC_CARR7` to `9`: direction of the first rotary axis.
    #[serde(rename = "V1")]
    v1: [f64; 3],
    /// `$TC_CARR10` to `12`: direction of the second rotary axis.
    #[serde(rename = "V2")]
    v2: [f64; 3],
}

impl Vectors {
    fn offsets(&self) -> [Vector3<f64>; 4] {
        [self.i1, self.i2, self.i3, self.i4].map(Vector3::from)
    }

    fn directions(&self) -> [Vector3<f64>; 2] {
        [self.v1, self.v2].map(Vector3::from)
    }
}

/// What turns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// The tool.
    T,
    /// The part.
    P,
    /// The tool by the first axis, the part by the second.
    M,
}

impl Kind {
    fn of(nominal: &Transformation) -> Result<Self> {
        match (nominal.head.len(), nominal.table.len()) {
            (2, 0) => Ok(Self::T),
            (0, 2) => Ok(Self::P),
            (1, 1) => Ok(Self::M),
            (head, table) => {
                let message = format!("the machine has {head} rotary axes of the tool and {table} of the part");
                Err(Error::usage(message).help(
                    "a tool carrier with two rotary axes was expected; `export: set-points` corrects any machine",
                ))
            }
        }
    }

    /// The first and the second axis.
    fn lines(self, of: &Transformation) -> Vec<Line> {
        of.head.iter().chain(&of.table).cloned().collect()
    }

    /// The same axes with others in their places.
    fn with(self, mut of: Transformation, lines: &[Line]) -> Transformation {
        let (head, table) = lines.split_at(of.head.len());
        (of.head, of.table) = (head.to_vec(), table.to_vec());
        of
    }

    /// I1 to I4 for the places of both axes: of the head from the tool adapter, of the table from the origin of the machine.
    fn offsets(self, [first, second]: [Vector3<f64>; 2]) -> [Vector3<f64>; 4] {
        match self {
            Self::T => [-first, first - second, second, Vector3::zeros()],
            Self::P => [Vector3::zeros(), first, second - first, -second],
            Self::M => [-first, first, second, -second],
        }
    }

    /// Places of both axes for I1 to I4, or their moves for changes of these.
    fn places(self, [_, i2, i3, _]: [Vector3<f64>; 4]) -> [Vector3<f64>; 2] {
        match self {
            Self::T => [i2 + i3, i3],
            Self::P => [i2, i2 + i3],
            Self::M => [i2, i3],
        }
    }

    /// The axes at the ends of I2 and I3; along these an offset may have any length.
    fn ends(self) -> [&'static [usize]; 2] {
        match self {
            Self::T => [&[0, 1], &[1]],
            Self::P => [&[0], &[0, 1]],
            Self::M => [&[0], &[1]],
        }
    }
}

fn first() -> u32 {
    1
}

fn one() -> f64 {
    1.0
}

fn example() -> Value {
    json!({ "existing": { "I2": [0, 0, -50], "I3": [0, 0, 0], "I4": [0, 0, 50], "V1": [-1, 0, 0], "V2": [0, 0, -1] },
        "tool_length_mm": 120 })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Export>, SettingsError> {
    positive("largest_change_mm", settings.largest_change_mm)?;
    let wrong = |setting: &str, message: &str| Err(SettingsError::new(setting, message));
    if settings.carrier == 0 {
        return wrong("carrier", "tool carriers are counted from 1");
    }
    if !settings.tool_length_mm.is_finite() {
        return wrong("tool_length_mm", "a length in mm was expected");
    }
    let existing = |error: SettingsError| error.under([PathItem::Key("existing".to_owned())]);
    for (name, vector) in ["I1", "I2", "I3", "I4"].into_iter().zip(settings.existing.offsets()) {
        if !vector.iter().all(|part| part.is_finite()) {
            return Err(existing(SettingsError::new(name, "three numbers in mm were expected")));
        }
    }
    for (name, vector) in ["V1", "V2"].into_iter().zip(settings.existing.directions()) {
        if !(vector.norm() > SAME && vector.norm().is_finite()) {
            return Err(existing(SettingsError::new(name, "a direction was expected")));
        }
    }
    Ok(Box::new(SiemensKinematics { settings }))
}

struct SiemensKinematics {
    settings: Settings,
}

/// What the file says.
struct Numbers {
    five: FiveAxes,
    kind: Kind,
    /// Both axes at the points that the present vectors have.
    nominal: Vec<Line>,
    offsets: [Vector3<f64>; 4],
    directions: [Vector3<f64>; 2],
    /// Translation, mm, and angles about X, Y and Z, degrees, of the basic frame: first Z, then the new Y, then the new X.
    frame: (Vector3<f64>, Vector3<f64>),
}

impl Numbers {
    /// The motion of the workpiece that the frame is, in the frame of the commands.
    fn workpiece(&self, tool: Translation3<f64>) -> Isometry3<f64> {
        let (shift, angles) = self.frame;
        let [a, b, c] = [angles.x, angles.y, angles.z].map(f64::to_radians);
        let frame = Isometry3::from_parts(Translation3::from(shift), UnitQuaternion::from_euler_angles(a, b, c));
        tool * frame * tool.inverse()
    }
}

impl SiemensKinematics {
    fn numbers(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Numbers> {
        let five = FiveAxes::new(calibration, model)?;
        let kind = Kind::of(&five.nominal)?;
        let (mut nominal, mut actual) = (kind.lines(&five.nominal), kind.lines(&five.actual));
        self.check(kind, &nominal)?;
        // The vectors have their own point of each axis. With its direction the place of an axis depends on this point.
        for (axis, place) in kind.places(self.settings.existing.offsets()).into_iter().enumerate() {
            let along = (self.tool() * Point3::from(place) - nominal[axis].point).dot(&nominal[axis].direction);
            for line in [&mut nominal[axis], &mut actual[axis]] {
                line.point += line.direction * along;
            }
        }
        let moves = [0, 1].map(|axis| actual[axis].point - nominal[axis].point);
        let offsets = self.offsets(kind.offsets(moves))?;
        let [first, second] = self.settings.existing.directions();
        let directions =
            [turned("V1", first, &nominal[0], &actual[0])?, turned("V2", second, &nominal[1], &actual[1])?];
        let tool = self.tool();
        let frame = tool.inverse() * five.workpiece * tool;
        let (a, b, c) = frame.rotation.euler_angles();
        let frame = (
            frame.translation.vector.map(|part| rounded(part, DECIMALS)),
            Vector3::new(a, b, c).map(|angle| rounded(angle.to_degrees(), FINE)),
        );
        Ok(Numbers { five, kind, nominal, offsets, directions, frame })
    }

    /// Fails unless the present vectors are those of the nominal machine: another order or sense of them would be seen here.
    fn check(&self, kind: Kind, nominal: &[Line]) -> Result<()> {
        let places = [0, 1].map(|axis| (self.tool().inverse() * nominal[axis].point).coords);
        let [_, i2, i3, _] = kind.offsets(places);
        let present = self.settings.existing.offsets();
        for ((name, off), ends) in [("I2", present[1] - i2), ("I3", present[2] - i3)].into_iter().zip(kind.ends()) {
            let directions: Vec<Vector3<f64>> = ends.iter().map(|&axis| nominal[axis].direction).collect();
            let off = across(off, &directions).norm();
            if off > self.settings.largest_change_mm {
                let message = format!("{name} is {off:.3} mm off the axes of the nominal machine of the calibration");
                let help =
                    "are the order of the axes, the sense of the vectors and the tool length those of the control?";
                let mut error = Error::usage(message).help(help);
                error.setting = ["existing", name].map(|key| PathItem::Key(key.to_owned())).to_vec();
                return Err(error);
            }
        }
        Ok(())
    }

    /// Places of the frame of the commands from those that the control shows, which has the tool in it.
    fn tool(&self) -> Translation3<f64> {
        Translation3::new(0.0, 0.0, self.settings.tool_length_mm)
    }

    /// New offsets, as they are written.
    fn offsets(&self, changes: [Vector3<f64>; 4]) -> Result<[Vector3<f64>; 4]> {
        let most = self.settings.largest_change_mm;
        let largest = changes.iter().map(|change| change.amax()).fold(0.0, f64::max);
        if largest.is_nan() || largest > most {
            let message = format!("a vector would change by {largest:.4} mm; at most {most} mm are allowed");
            return Err(Error::data(message)
                .help("is the calibration that of this machine? else allow more")
                .setting("largest_change_mm"));
        }
        let mut offsets = self.settings.existing.offsets();
        for (offset, change) in offsets.iter_mut().zip(changes) {
            *offset = (*offset + change).map(|part| rounded(part, DECIMALS));
        }
        Ok(offsets)
    }
}

/// The present direction of an axis with its orientation errors, as it is written.
fn turned(name: &str, present: Vector3<f64>, nominal: &Line, actual: &Line) -> Result<Vector3<f64>> {
    let sense = present.dot(&nominal.direction).signum();
    if (present.normalize() * sense - nominal.direction).norm() > SAME {
        let message = format!("{name} is not the direction of {}, about which the machine turns there", nominal.name);
        let mut error = Error::usage(message).help(
            "the first axis is that of the head, or the one next to the bed; directions are those of the machine frame",
        );
        error.setting = vec![PathItem::Key("existing".to_owned()), PathItem::Key(name.to_owned())];
        return Err(error);
    }
    // The part of the error that moves the axis is added to what the control has.
    let moved = present.normalize() + (actual.direction - nominal.direction) * sense;
    Ok(moved.normalize().map(|part| rounded(part, FINE)))
}

impl Export for SiemensKinematics {
    fn export(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Vec<ExportedFile>> {
        let Numbers { kind, offsets, directions, frame: (shift, angles), .. } = self.numbers(calibration, model)?;
        let carrier = self.settings.carrier;
        let mut text = format!(
            "; Tool carrier {carrier}, type {kind:?}, with the location errors of its rotary axes, mm\n\
             ; Zeros of rotary axes, squareness and error motions stay.\n"
        );
        let mut vector = |from: u32, vector: Vector3<f64>, decimals: usize| {
            for (number, part) in (from..).zip(vector.iter()) {
                writeln!(text, "$TC_CARR{number}[{carrier}]={part:.decimals$}").ok();
            }
        };
        let [i1, i2, i3, i4] = offsets;
        if kind != Kind::P {
            vector(1, i1, 6);
        }
        vector(4, i2, 6);
        vector(7, directions[0], 9);
        vector(10, directions[1], 9);
        vector(15, i3, 6);
        if kind != Kind::T {
            vector(18, i4, 6);
        }
        let words = |part: Vector3<f64>, decimals: usize| {
            format!("X,{:.decimals$},Y,{:.decimals$},Z,{:.decimals$}", part.x, part.y, part.z)
        };
        writeln!(
            text,
            "; The errors move the workpiece. Once, for zeros that were set before (not checked by a source):"
        )
        .ok();
        writeln!(text, "$P_CHBFR[0]=CTRANS({}):CROT({}):$P_CHBFR[0]", words(shift, 6), words(angles, 9)).ok();
        text.push_str("M30\n");
        Ok(vec![file("siemens-kinematics.mpf", text)])
    }

    fn correction(
        &self,
        calibration: &Calibration,
        model: &dyn KinematicModel,
    ) -> Result<Option<Box<dyn CommandCorrection>>> {
        let numbers = self.numbers(calibration, model)?;
        let Numbers { five, kind, nominal, offsets, directions, .. } = &numbers;
        let existing = self.settings.existing;
        let present = existing.offsets();
        let moves = kind.places(std::array::from_fn(|place| offsets[place] - present[place]));
        let mut lines = nominal.clone();
        for (axis, line) in lines.iter_mut().enumerate() {
            line.point += moves[axis];
            let had = existing.directions()[axis];
            let sense = had.dot(&line.direction).signum();
            line.direction = (line.direction + (directions[axis] - had.normalize()) * sense).normalize();
        }
        let new = kind.with(five.nominal.clone(), &lines);
        Ok(Some(five.predicted(new, numbers.workpiece(self.tool()))))
    }
}
