//! Exporter `linuxcnc-kinematics`: a kinematics component for `halcompile`, with the lines of INI and HAL files that use it.

use std::path::PathBuf;
use std::sync::Arc;

use abbe_compensation::{Compensator, Correct, Settings as Correction, Travel, check_confounded_anywhere};
use abbe_core::{
    Build, Calibration, CommandCorrection, Context, Error, Export, ExportedFile, Kind, KinematicModel, PathItem,
    Registry, Result, SettingsError, StatusRole, machine_values,
};
use abbe_volumetric::{Ranges, Steps, check_axes, check_ranges};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::code;
use crate::joints::{Joint, joints, known, plain_name};
use crate::reversal::Reversal;
use crate::table::Table;

abbe_core::register!(
    Export,
    "linuxcnc-kinematics",
    "a kinematics component of LinuxCNC that corrects all errors of a calibration",
    Settings,
    example,
    build,
    "../reference/export-linuxcnc-kinematics.md",
);

/// Settings of the component.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// Its name: small letters, digits and `_`; files and module are named after it.
    #[serde(default = "default_component")]
    component: String,
    /// `model`: the exact kinematics in C with a solver. `table`: corrections on a grid.
    #[serde(default)]
    form: Form,
    /// Distance of the places of a table along linear axes.
    #[serde(default = "default_step_mm")]
    step_mm: f64,
    /// Distance of the places of a table along rotary axes.
    #[serde(default = "default_step_deg")]
    step_deg: f64,
    /// Ranges by axis, where they are not those of the machine.
    #[serde(default)]
    ranges: Ranges,
    /// What is corrected, how, and how far. The ends of travel are left to the control: `travel` is not used.
    #[serde(default)]
    correction: Option<Correction>,
}

/// How the component knows the errors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Form {
    /// The exact kinematics in C, and a solver.
    #[default]
    Model,
    /// Corrections on a grid.
    Table,
}

fn default_component() -> String {
    "abbekins".to_owned()
}

fn default_step_mm() -> f64 {
    50.0
}

fn default_step_deg() -> f64 {
    15.0
}

fn example() -> Value {
    json!({ "component": "abbekins", "form": "table", "step_mm": 50, "step_deg": 15,
        "correction": { "correct": "five-axes" } })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Export>, SettingsError> {
    plain_name(&settings.component)?;
    let steps = Steps { mm: settings.step_mm, deg: settings.step_deg };
    steps.check()?;
    check_ranges(&settings.ranges, "ranges")?;
    let correction = settings.correction.clone().unwrap_or_default();
    correction.check().map_err(|error| error.under([PathItem::Key("correction".to_owned())]))?;
    if correction.travel == Travel::Hold {
        let error = SettingsError::new("travel", "a component cannot hold an axis at the end of its travel");
        return Err(error.help("the control does").under([PathItem::Key("correction".to_owned())]));
    }
    let correction = Correction { travel: Travel::Allow, ..correction };
    Ok(Box::new(Kinematics { settings, steps, correction }))
}

struct Kinematics {
    settings: Settings,
    steps: Steps,
    correction: Correction,
}

/// What the files do, as numbers.
struct Parts {
    joints: Vec<Joint>,
    values: Vec<f64>,
    table: Option<Table>,
    /// One a joint.
    reversals: Vec<Option<Reversal>>,
}

impl Kinematics {
    fn parts(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Parts> {
        check_axes(&self.settings.ranges, "ranges", model)?;
        let (joints, values) = (joints(model)?, machine_values(model, calibration));
        check_confounded_anywhere(model, calibration, &self.settings.ranges)?;
        let ranges = &self.settings.ranges;
        let reversals = joints.iter().map(|joint| Reversal::new(model, &values, &joints, joint, ranges));
        let reversals = reversals.collect::<Result<_>>()?;
        let compensator = Compensator::new(model, &values, &self.correction).map_err(in_correction)?;
        // Errors that are too large to be believed are refused in both forms. Rotary axes stand: near a pole at an end of travel
        // they would ask for places far beyond it.
        let position = Correction { correct: Correct::Position, ..self.correction.clone() };
        let check = Compensator::new(model, &values, &position).map_err(in_correction)?;
        check.correct(&places(model, &joints)).map_err(in_correction)?;
        let table = match self.settings.form {
            Form::Model => None,
            Form::Table => Some(Table::new(model, &compensator, &joints, (ranges, self.steps))?),
        };
        Ok(Parts { joints, values, table, reversals })
    }
}

fn in_correction(mut error: Error) -> Error {
    if !error.setting.is_empty() {
        error.setting.insert(0, PathItem::Key("correction".to_owned()));
    }
    error
}

/// Statuses with every joint at both ends and in the middle of its travel; at 0 if its range is not known.
fn places(model: &dyn KinematicModel, joints: &[Joint]) -> Vec<f64> {
    let base = known(model, joints, &vec![0.0; model.info().status.len()]);
    let mut statuses = vec![base];
    for joint in joints {
        let Some([from, to]) = model.info().axes[joint.axis].range else { continue };
        let at = |position: f64| {
            let move_ = move |mut status: Vec<f64>| {
                status[joint.status] = position;
                status
            };
            statuses.iter().cloned().map(move_)
        };
        statuses = at(from).chain(at(0.5 * (from + to))).chain(at(to)).collect();
    }
    statuses.concat()
}

impl Export for Kinematics {
    fn export(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Vec<ExportedFile>> {
        let Parts { joints, values, table, reversals } = self.parts(calibration, model)?;
        let (code, form) = match &table {
            None => (code::model(model, &values, &joints, &self.correction)?, "its exact kinematics"),
            Some(table) => (code::table(table, &joints), "corrections on a grid"),
        };
        let name = &self.settings.component;
        let title = format!("Kinematics of a calibrated machine: {form}.");
        let file = |name: String, text: String| ExportedFile { name, content: text.into_bytes() };
        let mut files = vec![file(format!("{name}.comp"), code::component(name, &title, &joints, &code))];
        let mut ini = ini_header(name, &joints);
        for (number, (joint, reversal)) in joints.iter().zip(&reversals).enumerate() {
            let Some(reversal) = reversal else { continue };
            let own = format!("{name}-{}.txt", joint.letter.to_lowercase());
            ini.push_str(&format!(
                "\n# Reversal of {}.\n[JOINT_{number}]\nCOMP_FILE = {own}\nCOMP_FILE_TYPE = 1\n",
                joint.letter
            ));
            files.push(file(own, reversal.text()));
        }
        files.push(file(format!("{name}.ini"), ini));
        files.push(file(
            format!("{name}.hal"),
            "# Instead of the line that loads trivkins.\nloadrt [KINS]KINEMATICS\n".to_owned(),
        ));
        Ok(files)
    }

    fn correction(
        &self,
        calibration: &Calibration,
        model: &dyn KinematicModel,
    ) -> Result<Option<Box<dyn CommandCorrection>>> {
        let parts = self.parts(calibration, model)?;
        let exact = match parts.table {
            Some(_) => None,
            None => {
                code::model(model, &parts.values, &parts.joints, &self.correction)?;
                Some((machine_of(calibration)?, self.correction.clone()))
            }
        };
        let directions = parts.joints.iter().map(|joint| model.info().status_index(&StatusRole::Direction(joint.axis)));
        let base = known(model, &[], &vec![0.0; model.info().status.len()]);
        Ok(Some(Box::new(Predicted { directions: directions.collect(), base, parts, exact })))
    }
}

/// The machine of a calibration once more: a prediction outlives what it was made from.
fn machine_of(calibration: &Calibration) -> Result<Arc<dyn KinematicModel>> {
    let registry = Registry::built_in()?;
    let wrong = |error: SettingsError| Error::usage(error.to_string());
    let plugin = registry.find(Kind::Model, &calibration.model.plugin).map_err(wrong)?;
    let Build::Model(constructor) = &plugin.build else {
        return Err(Error::usage(format!("{} is no model", calibration.model.plugin)));
    };
    let context = Context { base: PathBuf::new() };
    let model = constructor.build(&calibration.model.settings, &context);
    model.map_err(wrong)?.build(&[])
}

/// What a control with the component and the compensation files does.
struct Predicted {
    parts: Parts,
    /// The column of the direction of each joint.
    directions: Vec<Option<usize>>,
    /// The status with all joints at zero, without directions.
    base: Vec<f64>,
    /// The machine itself, without a table.
    exact: Option<(Arc<dyn KinematicModel>, Correction)>,
}

impl Predicted {
    /// Statuses with the commands of the component, which knows neither directions nor spindles.
    fn component(&self, programmed: &[f64]) -> Result<Vec<f64>> {
        let joints = &self.parts.joints;
        let mut statuses = self.base.repeat(programmed.len() / self.base.len().max(1));
        for (status, from) in statuses.chunks_mut(self.base.len()).zip(programmed.chunks(self.base.len())) {
            joints.iter().for_each(|joint| status[joint.status] = from[joint.status]);
        }
        if let Some((model, correction)) = &self.exact {
            return Ok(Compensator::new(model.as_ref(), &self.parts.values, correction)?.correct(&statuses)?.0);
        }
        if let Some(table) = &self.parts.table {
            for status in statuses.chunks_mut(self.base.len()) {
                let commands: Vec<f64> = joints.iter().map(|joint| status[joint.status] * joint.factor).collect();
                for (joint, by) in joints.iter().zip(table.at(&commands)) {
                    status[joint.status] += by / joint.factor;
                }
            }
        }
        Ok(statuses)
    }
}

impl CommandCorrection for Predicted {
    fn commands(&self, programmed: &[f64]) -> Result<Vec<f64>> {
        let corrected = self.component(programmed)?;
        let mut commands = programmed.to_vec();
        for (to, from) in commands.chunks_mut(self.base.len()).zip(corrected.chunks(self.base.len())) {
            for ((joint, reversal), direction) in
                self.parts.joints.iter().zip(&self.parts.reversals).zip(&self.directions)
            {
                let command = from[joint.status];
                let direction = direction.map_or(0.0, |column| to[column]);
                let trim = reversal.as_ref().map_or(0.0, |own| own.trim(command * joint.factor, direction));
                to[joint.status] = command + trim / joint.factor;
            }
        }
        Ok(commands)
    }
}

fn ini_header(name: &str, joints: &[Joint]) -> String {
    let letters: Vec<&str> = joints.iter().map(|joint| joint.letter).collect();
    format!(
        "# Build and install: halcompile --install {name}.comp
# Lines for the INI file of LinuxCNC; the limits of joints have to leave room for corrections. Home the machine before use.
[KINS]
KINEMATICS = {name}
JOINTS = {}

[TRAJ]
COORDINATES = {}
LINEAR_UNITS = mm
ANGULAR_UNITS = degree

# The component knows no directions. Reversal along the own axis of a joint is in its COMP_FILE, with which LinuxCNC ignores
# BACKLASH. Reversal in other directions stays.
",
        joints.len(),
        letters.join(" ")
    )
}
