//! Exporter `linuxcnc-temperature`: a HAL component whose pins take temperatures and give offsets of axes.

use abbe_compensation::{LineSettings, ThermalLine, ThermalLines, ThermalState};
use abbe_core::{
    Calibration, CommandCorrection, Context, Error, Export, ExportedFile, KinematicModel, PathItem, Result,
    SettingsError,
};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::joints::{joints, plain_name};

abbe_core::register!(
    Export,
    "linuxcnc-temperature",
    "a component of LinuxCNC whose pins take temperatures and give offsets of axes",
    Settings,
    example,
    build,
    "../reference/export-linuxcnc-temperature.md",
);

/// Settings of the component.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// Its name: small letters, digits and `_`; files and module are named after it.
    #[serde(default = "default_component")]
    component: String,
    /// Which axes, and where their lines are taken.
    #[serde(default)]
    lines: LineSettings,
    /// Fastest change of an offset.
    #[serde(default = "ten")]
    largest_rate_um_per_s: f64,
    /// What one count of an external offset is.
    #[serde(default = "tenth")]
    count_um: f64,
}

fn default_component() -> String {
    "abbetemp".to_owned()
}

fn ten() -> f64 {
    10.0
}

fn tenth() -> f64 {
    0.1
}

fn example() -> Value {
    json!({ "component": "abbetemp", "lines": { "axes": ["X", "Z"], "at": { "Y_mm": 100 } }, "largest_rate_um_per_s": 10,
        "count_um": 0.1 })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Export>, SettingsError> {
    plain_name(&settings.component)?;
    settings.lines.check().map_err(|error| error.under([PathItem::Key("lines".to_owned())]))?;
    for (name, value, [from, to]) in [
        ("largest_rate_um_per_s", settings.largest_rate_um_per_s, [1e-3, 1e6]),
        ("count_um", settings.count_um, [1e-3, 100.0]),
    ] {
        if !(from..=to).contains(&value) {
            return Err(SettingsError::new(name, format!("{value:e}: a number from {from} to {to} was expected")));
        }
    }
    Ok(Box::new(Temperature { settings }))
}

struct Temperature {
    settings: Settings,
}

const COMPONENT: &str = include_str!("temperature.c");

/// Numbers of a C array.
fn numbers(values: impl Iterator<Item = f64>) -> String {
    values.map(|value| format!("{value:e}")).collect::<Vec<_>>().join(", ")
}

/// The name of a pin for a sensor.
fn pin(input: &str) -> String {
    let letter = |letter: char| if letter.is_ascii_alphanumeric() { letter.to_ascii_lowercase() } else { '_' };
    input.chars().map(letter).collect()
}

impl Temperature {
    /// The lines, with the letters of their axes.
    fn lines(
        &self,
        calibration: &Calibration,
        model: &dyn KinematicModel,
    ) -> Result<(ThermalLines, Vec<&'static str>)> {
        let joints = joints(model)?;
        let lines = ThermalLines::new(calibration, model, &self.settings.lines)?;
        let letter = |line: &ThermalLine| {
            let joint = joints.iter().find(|joint| joint.axis == line.axis);
            joint.map(|joint| joint.letter).ok_or_else(|| Error::usage("LinuxCNC has no such axis"))
        };
        let letters = lines.lines.iter().map(letter).collect::<Result<Vec<_>>>()?;
        let inputs = inputs(&lines.states);
        for (index, one) in inputs.iter().enumerate() {
            if let Some(other) = inputs[..index].iter().find(|other| pin(&other.input) == pin(&one.input)) {
                let message = format!("{} and {} would be the same pin of LinuxCNC", other.input, one.input);
                return Err(Error::usage(message).help("rename one of the columns"));
            }
        }
        Ok((lines, letters))
    }

    fn component(&self, lines: &ThermalLines, letters: &[&str]) -> String {
        let inputs = inputs(&lines.states);
        let mut pins: Vec<String> = inputs
            .iter()
            .map(|state| {
                format!("pin in float reading_{} = {:e} \"{}\";", pin(&state.input), state.reference, state.header)
            })
            .collect();
        for letter in letters.iter().map(|letter| letter.to_lowercase()) {
            pins.push(format!("pin in float position_{letter} \"axis.{letter}.pos-cmd, mm\";"));
            pins.push(format!("pin out float offset_{letter} \"mm\";"));
            pins.push(format!("pin out s32 counts_{letter} \"axis.{letter}.eoffset-counts\";"));
        }
        let gains = lines.lines.iter().map(|line| {
            let of_state = |[offset, slope]: &[f64; 2]| format!("{{{offset:e}, {slope:e}}}");
            format!("    {{{}}}", line.parts.iter().map(of_state).collect::<Vec<_>>().join(", "))
        });
        let write = letters.iter().enumerate().map(|(index, letter)| {
            let letter = letter.to_lowercase();
            format!("offset_{letter} = last[{index}];\n    counts_{letter} = (int)floor(last[{index}] / scale + 0.5);")
        });
        let states = || lines.states.iter();
        let least = |state: &ThermalState| state.range[0].min(state.reference);
        let most = |state: &ThermalState| state.range[1].max(state.reference);
        let named = |names: Vec<String>| names.join(", ");
        COMPONENT
            .replace("@NAME@", &self.settings.component)
            .replace("@TITLE@", "Thermal offsets of a calibrated machine.")
            .replace("@PINS@", &pins.join("\n"))
            .replace("@SCALE@", &format!("{:e}", self.settings.count_um * 1e-3))
            .replace("@RATE@", &format!("{:e}", self.settings.largest_rate_um_per_s * 1e-3))
            .replace("@STATES@", &lines.states.len().to_string())
            .replace("@AXES@", &letters.len().to_string())
            .replace("@TIMES@", &numbers(states().map(|state| state.time_constant.unwrap_or(0.0))))
            .replace("@FROM@", &numbers(states().map(|state| state.reference)))
            .replace("@LEAST@", &numbers(states().map(least)))
            .replace("@MOST@", &numbers(states().map(most)))
            .replace("@REFERENCES@", &numbers(lines.lines.iter().map(|line| line.reference)))
            .replace("@GAINS@", &gains.collect::<Vec<_>>().join(",\n"))
            .replace("@READINGS@", &named(states().map(|state| format!("reading_{}", pin(&state.input))).collect()))
            .replace(
                "@POSITIONS@",
                &named(letters.iter().map(|letter| format!("position_{}", letter.to_lowercase())).collect()),
            )
            .replace("@WRITE@", &write.collect::<Vec<_>>().join("\n    "))
    }

    fn hal(&self, lines: &ThermalLines, letters: &[&str]) -> String {
        let name = &self.settings.component;
        let module = name.replace('_', "-");
        let mut text = format!(
            "# Build and install: halcompile --install {name}.comp\n\
             # [AXIS_L] OFFSET_AV_RATIO in the INI file leaves speed and acceleration to the offsets, such as 0.1.\n\
             loadrt {name}\naddf {module} servo-thread\n"
        );
        for letter in letters.iter().map(|letter| letter.to_lowercase()) {
            text += &format!(
                "net {module}-position-{letter} axis.{letter}.pos-cmd => {module}.position-{letter}\n\
                 net {module}-counts-{letter} {module}.counts-{letter} => axis.{letter}.eoffset-counts\n\
                 setp axis.{letter}.eoffset-scale {}\nsetp axis.{letter}.eoffset-enable 1\n",
                self.settings.count_um * 1e-3
            );
        }
        text += "# Connect the sensors:\n";
        for state in inputs(&lines.states) {
            let reading = pin(&state.input).replace('_', "-");
            text += &format!("# net {reading} your-sensor => {module}.reading-{reading}  # {}\n", state.header);
        }
        text
    }
}

/// One state for each sensor.
fn inputs(states: &[ThermalState]) -> Vec<&ThermalState> {
    let mut found: Vec<&ThermalState> = Vec::new();
    for state in states {
        if !found.iter().any(|known| known.input == state.input) {
            found.push(state);
        }
    }
    found
}

impl Export for Temperature {
    fn export(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Vec<ExportedFile>> {
        let (lines, letters) = self.lines(calibration, model)?;
        let name = &self.settings.component;
        let file = |name: String, text: String| ExportedFile { name, content: text.into_bytes() };
        Ok(vec![
            file(format!("{name}.comp"), self.component(&lines, &letters)),
            file(format!("{name}.hal"), self.hal(&lines, &letters)),
        ])
    }

    fn correction(
        &self,
        calibration: &Calibration,
        model: &dyn KinematicModel,
    ) -> Result<Option<Box<dyn CommandCorrection>>> {
        Ok(Some(Box::new(self.lines(calibration, model)?.0)))
    }
}
