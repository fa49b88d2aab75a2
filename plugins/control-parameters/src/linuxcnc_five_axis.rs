//! Exporter `linuxcnc-five-axis`: HAL pins of the five-axis kinematics of LinuxCNC.

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

use crate::files::{file, rounded};
use crate::five_axis::{FiveAxes, Line, Transformation};

abbe_core::register!(
    Export,
    "linuxcnc-five-axis",
    "places of the rotary axes for the five-axis kinematics of LinuxCNC",
    Settings,
    example,
    build,
    "../reference/export-linuxcnc-five-axis.md",
);

/// Decimals of lengths, mm.
const DECIMALS: i32 = 6;

/// Nominal axes are as the module wants them to this much, mm or rad.
const SAME: f64 = 1e-9;

/// Settings of the pins.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// The kinematics that the control has loaded.
    module: Module,
    /// The module has the pin `conventional-directions` (LinuxCNC 2.10; up to 2.9 there is none, and axes turn the other way).
    #[serde(default)]
    has_conventional_directions: bool,
    /// The pins, mm, with which the machine was measured, by their names. New ones are these and the errors.
    existing: BTreeMap<String, f64>,
    /// Largest change of a pin.
    #[serde(default = "one")]
    largest_change_mm: f64,
}

/// Kinematics of LinuxCNC for tables.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
enum Module {
    /// A table C on a tilting table A.
    #[serde(rename = "xyzac-trt-kins")]
    Xyzac,
    /// A table C on a tilting table B.
    #[serde(rename = "xyzbc-trt-kins")]
    Xyzbc,
}

impl Module {
    fn name(self) -> &'static str {
        match self {
            Self::Xyzac => "xyzac-trt-kins",
            Self::Xyzbc => "xyzbc-trt-kins",
        }
    }

    /// The pins that location errors change.
    fn pins(self) -> [&'static str; 4] {
        match self {
            Self::Xyzac => ["x-rot-point", "y-rot-point", "y-offset", "z-offset"],
            Self::Xyzbc => ["x-rot-point", "y-rot-point", "x-offset", "z-offset"],
        }
    }

    /// The tilting axis, and the direction across it, among X, Y and Z, of its offset from C.
    fn tilting(self) -> (&'static str, Vector3<f64>, usize) {
        match self {
            Self::Xyzac => ("A", Vector3::x(), 1),
            Self::Xyzbc => ("B", Vector3::y(), 0),
        }
    }

    /// Whether the axes turn in conventional directions; fails for another machine, or if the module cannot turn as this one does.
    fn conventional(self, nominal: &Transformation, has_pin: bool) -> Result<bool> {
        let (tilting, direction, _) = self.tilting();
        let is = |line: &Line, name: &str, direction: Vector3<f64>| {
            line.name == name && (line.direction - direction).norm() < SAME
        };
        let turns = |sense: f64| match (&nominal.table[..], &nominal.head[..]) {
            ([first, second], []) => is(first, tilting, direction * sense) && is(second, "C", Vector3::z() * sense),
            _ => false,
        };
        // A table turns the workpiece the other way, so that the tool moves as commanded relative to it.
        match (turns(-1.0), turns(1.0), self) {
            (true, _, _) if has_pin => Ok(true),
            (true, _, _) => Err(Error::usage(format!(
                "{} up to LinuxCNC 2.9 turns both axes against convention; those of this machine turn as is conventional",
                self.name()
            ))
            .help("has_conventional_directions: true, where the module has this pin; else turn both axes and measure with `reverse: true`")
            .setting("has_conventional_directions")),
            (_, true, Self::Xyzbc) if has_pin => Err(Error::usage(
                "xyzbc-trt-kins with the pin `conventional-directions` is right in conventional directions only; in the others its \
                 inverse kinematics do not fit its forward ones",
            )
            .setting("module")),
            (_, true, _) => Ok(false),
            (false, false, _) => {
                let message =
                    format!("{} knows a tilting table {tilting} with a table C on it", self.name());
                Err(Error::usage(message)
                    .help("both axes turn conventionally, or both the other way (`reverse: true`)")
                    .setting("module"))
            }
        }
    }

    /// Changes of the pins, mm.
    fn changes(self, five: &FiveAxes) -> [f64; 4] {
        let moved =
            five.actual.table.iter().zip(&five.nominal.table).map(|(actual, nominal)| actual.point - nominal.point);
        let moved: Vec<Vector3<f64>> = moved.collect();
        let (tilting, turning) = (moved[0], moved[1]);
        let (_, _, across) = self.tilting();
        [turning.x, turning.y, tilting[across] - turning[across], tilting.z]
    }

    /// What the control knows after these changes.
    fn changed(self, mut known: Transformation, [x, y, offset, z]: [f64; 4]) -> Transformation {
        let (_, _, across) = self.tilting();
        known.table[1].point += Vector3::new(x, y, 0.0);
        known.table[0].point[across] += [x, y][across] + offset;
        known.table[0].point.z += z;
        known
    }
}

fn one() -> f64 {
    1.0
}

fn example() -> Value {
    json!({ "module": "xyzac-trt-kins",
        "existing": { "x-rot-point": 0.0, "y-rot-point": 0.0, "y-offset": 0.0, "z-offset": -120.0 } })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Export>, SettingsError> {
    positive("largest_change_mm", settings.largest_change_mm)?;
    let (pins, module) = (settings.module.pins(), settings.module.name());
    let wrong = |pin: &str, message: String| {
        Err(SettingsError::new(pin, message).under([PathItem::Key("existing".to_owned())]))
    };
    for (pin, value) in &settings.existing {
        if !pins.contains(&pin.as_str()) {
            return wrong(pin, format!("errors change no such pin of {module}; expected: {}", pins.join(", ")));
        }
        if !value.is_finite() {
            return wrong(pin, "a number in mm was expected".to_owned());
        }
    }
    if let Some(pin) = pins.into_iter().find(|pin| !settings.existing.contains_key(*pin)) {
        return wrong(pin, format!("the present value of this pin of {module}, mm, was expected"));
    }
    Ok(Box::new(LinuxcncFiveAxis { settings }))
}

struct LinuxcncFiveAxis {
    settings: Settings,
}

/// What the files say.
struct Numbers {
    five: FiveAxes,
    conventional: bool,
    /// New values of the pins, as they are written, mm.
    pins: [f64; 4],
    /// What is added to work offsets, as it is written, mm.
    shift: Vector3<f64>,
}

impl LinuxcncFiveAxis {
    fn numbers(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Numbers> {
        let five = FiveAxes::new(calibration, model)?;
        let module = self.settings.module;
        let conventional = module.conventional(&five.nominal, self.settings.has_conventional_directions)?;
        let most = self.settings.largest_change_mm;
        let mut pins = self.existing();
        for ((pin, value), change) in module.pins().into_iter().zip(&mut pins).zip(module.changes(&five)) {
            if change.is_nan() || change.abs() > most {
                let message = format!("{pin} would change by {change:.4} mm; at most {most} mm are allowed");
                return Err(Error::data(message)
                    .help("is the calibration that of this machine? else allow more")
                    .setting("largest_change_mm"));
            }
            *value = rounded(*value + change, DECIMALS);
        }
        let zero = five.nominal.table.last().map(|line| line.point).unwrap_or_default();
        let shift = (five.workpiece * zero - zero).map(|part| rounded(part, DECIMALS));
        Ok(Numbers { five, conventional, pins, shift })
    }

    /// The present values of the pins.
    fn existing(&self) -> [f64; 4] {
        self.settings.module.pins().map(|pin| self.settings.existing.get(pin).copied().unwrap_or_default())
    }
}

impl Export for LinuxcncFiveAxis {
    fn export(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Vec<ExportedFile>> {
        let Numbers { conventional, pins, shift, .. } = self.numbers(calibration, model)?;
        let module = self.settings.module.name();
        let mut hal = "# Places of the rotary axes with their location errors, mm. They replace the present values of these pins.\n\
            # Their other errors stay: directions, zeros of rotary axes, what the module has no pin for.\n"
            .to_owned();
        for (pin, value) in self.settings.module.pins().into_iter().zip(pins) {
            writeln!(hal, "setp {module}.{pin} {value:.6}").ok();
        }
        if self.settings.has_conventional_directions {
            writeln!(hal, "setp {module}.conventional-directions {}", u8::from(conventional)).ok();
        }
        let word = |(axis, (parameter, by)): (&str, (i32, &f64))| format!(" {axis}[#[{parameter}+20*#5220]{by:+.6}]");
        let words: String = ["X", "Y", "Z"].into_iter().zip((5201..).zip(shift.iter())).map(word).collect();
        let offsets = format!(
            "(Moves a work offset that was set before the new pins. Run once for each of them, or set them anew.)\n\
             G21\nG10 L2 P0{words}\nM2\n"
        );
        Ok(vec![file("five-axis.hal", hal), file("work-offsets.ngc", offsets)])
    }

    fn correction(
        &self,
        calibration: &Calibration,
        model: &dyn KinematicModel,
    ) -> Result<Option<Box<dyn CommandCorrection>>> {
        let Numbers { five, pins, shift, .. } = self.numbers(calibration, model)?;
        let existing = self.existing();
        let changes = std::array::from_fn(|place| pins[place] - existing[place]);
        let new = self.settings.module.changed(five.nominal.clone(), changes);
        Ok(Some(five.predicted(new, Isometry3::from(Translation3::from(shift)))))
    }
}
