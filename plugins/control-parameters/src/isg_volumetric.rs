//! Exporter `isg-volumetric`: volumetric compensation of ISG kernels and Beckhoff TwinCAT CNC.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::PathBuf;

use abbe_compensation::active::Believed;
use abbe_compensation::check_confounded_anywhere;
use abbe_compensation::rigid::{Joint, LETTERS, Six};
use abbe_core::{
    AxisKind, Branch, Calibration, CommandCorrection, Context, Error, Export, ExportedFile, InputFile, KinematicModel,
    PathItem, Result, SettingsError,
};
use abbe_volumetric::{Ranges, Steps, check_axes, check_ranges, within};
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::isg_existing::Active;
use crate::motion_tables::{Curve, Tables, TipCorrection, text};

abbe_core::register!(
    Export,
    "isg-volumetric",
    "volumetric compensation of ISG and Beckhoff controls, with its configuration",
    Settings,
    example,
    build,
    "../reference/export-isg-volumetric.md",
);

/// Settings of the tables.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// Logical axis numbers in the control, one for every axis of the machine, by name: `{ X: 1, Y: 2, Z: 3 }`.
    axis_numbers: BTreeMap<String, u16>,
    /// Format of the tables.
    #[serde(default)]
    format: Format,
    /// Distance of points along linear axes.
    #[serde(default = "default_step_mm")]
    step_mm: f64,
    /// Distance of points along rotary axes.
    #[serde(default = "default_step_deg")]
    step_deg: f64,
    /// Ranges by axis, where they are not those of the machine.
    #[serde(default)]
    ranges: Ranges,
    /// Tables that were active when the machine was measured, `ISG_CSV` or `ETALON_EXCHANGE`, with errors over one axis each: the new
    /// errors are added to theirs.
    #[serde(default)]
    existing: Vec<String>,
    /// Largest length in these tables that is believed.
    #[serde(default = "one")]
    #[schemars(range(min = 0))]
    largest_mm: f64,
    /// Largest angle in these tables that is believed.
    #[serde(default = "one")]
    #[schemars(range(min = 0))]
    largest_deg: f64,
}

fn one() -> f64 {
    1.0
}

/// How tables are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Format {
    /// `ISG_CSV`: columns, one block an axis.
    #[default]
    IsgCsv,
    /// `ETALON_EXCHANGE`: one section an error.
    EtalonExchange,
}

fn default_step_mm() -> f64 {
    20.0
}

fn default_step_deg() -> f64 {
    5.0
}

fn example() -> Value {
    json!({ "axis_numbers": { "X": 1, "Y": 2, "Z": 3 }, "format": "isg-csv", "step_mm": 50 })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Export>, SettingsError> {
    settings.steps().check()?;
    check_ranges(&settings.ranges, "ranges")?;
    for (name, number) in &settings.axis_numbers {
        let at = [PathItem::Key("axis_numbers".to_owned())];
        if *number == 0 {
            return Err(SettingsError::new(name, "a number from 1 was expected").under(at));
        }
        if settings.axis_numbers.values().filter(|other| *other == number).count() > 1 {
            return Err(SettingsError::new(name, format!("two axes have the number {number}")).under(at));
        }
    }
    let existing = settings.existing.iter().map(|path| context.path(path)).collect();
    Ok(Box::new(IsgVolumetric { settings, existing }))
}

impl Settings {
    fn steps(&self) -> Steps {
        Steps { mm: self.step_mm, deg: self.step_deg }
    }
}

struct IsgVolumetric {
    settings: Settings,
    existing: Vec<PathBuf>,
}

/// Places in active tables are those of the machine to this much, mm.
const SAME: f64 = 1e-4;

const NOTE: &str = "\
Errors of ISO 230-1, actual minus nominal, mm and rad, of the body that the axis carries, in the directions of the machine
axes at zero; linear axes: told at the origin, rotary axes: at their centre PXA, ... The origin is that of the table frame with
all axes at zero. The manual does not say these conventions: try one point with a measurement before the table is used;
`negate XYZ` in the configuration turns all corrections round.
";

/// The note as lines of a comment.
fn comment(start: &str) -> String {
    NOTE.lines().map(|line| format!("{start} {line}\n")).collect()
}

impl IsgVolumetric {
    fn tables(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Tables> {
        check_axes(&self.settings.ranges, "ranges", model)?;
        let tables = Tables::new(calibration, model, (&self.settings.ranges, "ranges"), self.settings.steps())?;
        for joint in &tables.machine.joints {
            joint.letter()?;
            if !self.settings.axis_numbers.contains_key(&joint.name) {
                let message = format!("the number of axis {} in the control is missing", joint.name);
                return Err(Error::usage(message).setting("axis_numbers"));
            }
        }
        let unknown = |name: &&String| !tables.machine.joints.iter().any(|joint| joint.name == **name);
        if let Some(name) = self.settings.axis_numbers.keys().find(unknown) {
            let error = Error::usage(format!("the machine has no axis {name}"));
            return Err(within(error, &["axis_numbers", name]));
        }
        if tables.machine.joints.iter().filter(|joint| joint.kind == AxisKind::Linear).count() != 3 {
            return Err(Error::usage("the control corrects machines with exactly three linear axes X, Y and Z"));
        }
        if let Some(axis) = model.info().axes.iter().find(|axis| axis.endless) {
            let message = format!("axis {} turns without an end, and a table of this control has ends", axis.name);
            return Err(Error::usage(message).help("give the axis a range without `endless`, if it does not go beyond"));
        }
        check_confounded_anywhere(model, calibration, &self.settings.ranges)?;
        Ok(tables)
    }

    /// Adds what is active already.
    fn add_existing(&self, tables: &mut Tables, model: &dyn KinematicModel) -> Result<()> {
        let mut active = Active::default();
        let Settings { largest_mm, largest_deg, ranges, .. } = &self.settings;
        let believed = Believed::new(*largest_mm, *largest_deg, ranges);
        self.existing.iter().try_for_each(|path| active.read(path, &believed, &model.info().axes))?;
        let Active { mut constants, mut motions, .. } = active;
        for (name, expected) in places(tables) {
            let found = constants.remove(&name).unwrap_or(expected);
            if (found - expected).abs() > SAME {
                let message = format!("{name} is {found} in the active tables; of this machine it is {expected:.6}");
                return Err(Error::data(message)
                    .help("are they those of this machine and this tool?")
                    .setting("existing"));
            }
        }
        for (joint, curve) in tables.machine.joints.iter().zip(&mut tables.curves) {
            for (own, name) in curve.location.iter_mut().zip(location_names(&joint.name)) {
                *own += constants.remove(&name).unwrap_or_default();
            }
            curve.add(&motion_names(&joint.name).map(|name| motions.remove(&name).unwrap_or_default()));
        }
        match constants.into_keys().chain(motions.into_keys()).next() {
            None => Ok(()),
            Some(name) => {
                let message = format!("the active tables have {name}, which this exporter does not write");
                Err(Error::data(message).setting("existing"))
            }
        }
    }

    fn configuration(&self, tables: &Tables, files: &[(String, &str)]) -> String {
        let joints = &tables.machine.joints;
        let mut text = "# Volumetric compensation. In the start-up list:\n".to_owned();
        let records: usize = tables.curves.iter().map(|curve| curve.points.len() * 7 + 20).sum();
        writeln!(text, "#   vol_comp[0].max_records {}", records.max(2000)).ok();
        text.push_str("#   vol_comp[0].file_name   isg-volumetric.lis\n# In the program: #VOLCOMP ON [ID0]\n");
        text.push_str(&comment("#"));
        text.push_str("# chain: from workpiece to tool; the first workpiece_axes of it carry the workpiece (order not in the manual)\n");
        for joint in joints {
            writeln!(text, "{} {}", joint.name, self.settings.axis_numbers[&joint.name]).ok();
        }
        let chain: String = joints.iter().map(|joint| joint.name.as_str()).collect();
        let carry = joints.iter().filter(|joint| joint.branch == Branch::Workpiece).count();
        writeln!(text, "chain {chain}\nworkpiece_axes {carry}\nInterpolation GRID").ok();
        for (index, (name, format)) in files.iter().enumerate() {
            writeln!(text, "file[{index}] {name}\nfile_format[{index}] {format}").ok();
        }
        text
    }
}

/// Names of the location errors of an axis: `X0C`, ..., `C0C`.
fn location_names(axis: &str) -> [String; 6] {
    LETTERS.map(|letter| format!("{letter}0{axis}"))
}

/// Names of the error motions of an axis: `EXX`, ..., `ECX`.
fn motion_names(axis: &str) -> [String; 6] {
    LETTERS.map(|letter| format!("E{letter}{axis}"))
}

/// The zero position of the tip, and the centres of rotary axes.
fn places(tables: &Tables) -> Vec<(String, f64)> {
    let of = |prefix: &str, suffix: &str, point: &Vector3<f64>| -> Vec<(String, f64)> {
        let names = LETTERS[..3].iter().map(|letter| match suffix {
            "" => format!("{prefix}{letter}"),
            axis => format!("{prefix}{letter}{axis}"),
        });
        names.zip(point.iter().copied()).collect()
    };
    let mut all = of("P0", "", &tables.machine.tip.coords);
    for joint in tables.machine.joints.iter().filter(|joint| joint.kind == AxisKind::Rotary) {
        all.extend(of("P", &joint.name, &joint.point.coords));
    }
    all
}

/// A block of `ISG_CSV`: names, and rows of values.
fn block(names: &[String], rows: &[Vec<String>]) -> String {
    let lines = rows.iter().map(|row| format!("{}\n", row.join(" ")));
    format!("{}\n{}", names.join(" "), lines.collect::<String>())
}

fn places_block(tables: &Tables) -> String {
    let (names, values): (Vec<String>, Vec<String>) =
        places(tables).into_iter().map(|(name, value)| (name, text(value))).unzip();
    block(&names, &[values])
}

fn row(six: &Six) -> Vec<String> {
    six.iter().map(|value| text(*value)).collect()
}

fn axis_blocks(joint: &Joint, curve: &Curve) -> String {
    let located = block(&location_names(&joint.name), &[row(&curve.location)]);
    let mut names = vec![joint.name.clone()];
    names.extend(motion_names(&joint.name));
    let rows: Vec<Vec<String>> = (curve.points.iter().zip(&curve.motions))
        .map(|(point, motion)| [vec![point.to_string()], row(motion)].concat())
        .collect();
    format!("#\n{located}#\n{}", block(&names, &rows))
}

fn etalon_sections(joint: &Joint, curve: &Curve) -> String {
    let mut all = String::new();
    for (name, value) in location_names(&joint.name).iter().zip(&curve.location) {
        writeln!(all, "[{name}]\nVALUE = {}", text(*value)).ok();
    }
    for (component, name) in motion_names(&joint.name).iter().enumerate() {
        writeln!(all, "[{name}]\nGridpoints = {{").ok();
        for (point, motion) in curve.points.iter().zip(&curve.motions) {
            writeln!(all, "{point} {}", text(motion[component])).ok();
        }
        all.push_str("}\n");
    }
    all
}

impl Export for IsgVolumetric {
    fn inputs(&self) -> Vec<InputFile> {
        self.existing.iter().map(|path| InputFile { setting: "existing", path: path.clone() }).collect()
    }

    fn export(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Vec<ExportedFile>> {
        let mut tables = self.tables(calibration, model)?;
        self.add_existing(&mut tables, model)?;
        let each = |write: fn(&Joint, &Curve) -> String| -> String {
            tables.iter().map(|(joint, curve)| write(joint, curve)).collect()
        };
        let places = format!("{}{}", comment("//"), places_block(&tables));
        let contents = match self.settings.format {
            Format::IsgCsv => vec![("isg-volumetric.csv", "ISG_CSV", places + &each(axis_blocks))],
            Format::EtalonExchange => vec![
                ("isg-places.csv", "ISG_CSV", places),
                ("isg-volumetric.txt", "ETALON_EXCHANGE", each(etalon_sections)),
            ],
        };
        let named: Vec<(String, &str)> =
            contents.iter().map(|(name, format, _)| ((*name).to_owned(), *format)).collect();
        let mut files = vec![("isg-volumetric.lis".to_owned(), self.configuration(&tables, &named))];
        files.extend(contents.into_iter().map(|(name, _, content)| (name.to_owned(), content)));
        Ok(files.into_iter().map(|(name, text)| ExportedFile { name, content: text.into_bytes() }).collect())
    }

    fn correction(
        &self,
        calibration: &Calibration,
        model: &dyn KinematicModel,
    ) -> Result<Option<Box<dyn CommandCorrection>>> {
        let tables = self.tables(calibration, model)?;
        Ok(Some(Box::new(TipCorrection { tables, width: model.info().status.len() })))
    }
}
