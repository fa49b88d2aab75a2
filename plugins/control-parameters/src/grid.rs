//! Exporter `grid`: corrections of commands at nodes over the workspace, for software of one's own and for plots.

use std::path::PathBuf;

use abbe_compensation::active::Believed;
use abbe_compensation::{Compensator, Correct, Settings as Correction, Travel, check_confounded};
use abbe_core::{
    Calibration, CommandCorrection, Context, Error, Export, ExportedFile, InputFile, KinematicModel, PathItem, Result,
    SettingsError, machine_values, positive,
};
use abbe_volumetric::{Grid, Ranges, position_unit, rounded_position, within};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::files::{file, rounded};
use crate::grid_file;
use crate::lattice::{Corrected, Lattice, Set, Side, When, directions};

abbe_core::register!(
    Export,
    "grid",
    "corrections of commands over the workspace, as CSV or VTK",
    Settings,
    example,
    build,
    "../reference/export-grid.md",
);

/// Decimals of corrections: nm, and 0.02 urad.
const DECIMALS: i32 = 6;

/// Settings of the grid.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// The nodes: `points`, or `step_mm` with `step_deg`. Axes with a single point stand still.
    grid: Grid,
    /// `csv`, or `vtk` for at most three axes that vary.
    #[serde(default)]
    format: Format,
    /// What is corrected: `position`, `five-axes`, or a list of linear axes.
    #[serde(default)]
    correct: Correct,
    /// Largest correction of the tip; beyond it the errors are not believed.
    #[serde(default = "one")]
    largest_tip_correction_mm: f64,
    /// Largest correction of a rotary axis that a file of corrections may have.
    #[serde(default = "one")]
    #[schemars(range(min = 0))]
    largest_deg: f64,
    /// File of corrections (CSV, from this exporter) that was active when the machine was measured: the new ones are added to them.
    #[serde(default)]
    existing: Option<String>,
}

/// How the file is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Format {
    /// One line a node.
    #[default]
    Csv,
    /// Legacy VTK, rectilinear grid, ASCII.
    Vtk,
}

fn one() -> f64 {
    1.0
}

fn example() -> Value {
    json!({ "grid": { "points": { "X": 9, "Y": 9, "Z": 7 } }, "format": "csv", "correct": "position" })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Export>, SettingsError> {
    let grid = [PathItem::Key("grid".to_owned())];
    settings.grid.check().map_err(|error| error.under(grid.clone()))?;
    if settings.grid.poses.is_some() {
        return Err(SettingsError::new("poses", "`points`, or `step_mm` with `step_deg`, were expected").under(grid));
    }
    if settings.grid.both_directions {
        let message = "the reversal of every axis is always written; leave this out";
        return Err(SettingsError::new("both_directions", message).under(grid));
    }
    positive("largest_tip_correction_mm", settings.largest_tip_correction_mm)?;
    settings.correction().check()?;
    let existing = settings.existing.as_ref().map(|path| context.path(path));
    Ok(Box::new(Corrections { settings, existing }))
}

impl Settings {
    /// Limits of travel are those of programs: a control checks them before it corrects.
    fn correction(&self) -> Correction {
        Correction {
            correct: self.correct.clone(),
            largest_tip_correction_mm: self.largest_tip_correction_mm,
            travel: Travel::Allow,
            ..Correction::default()
        }
    }
}

struct Corrections {
    settings: Settings,
    existing: Option<PathBuf>,
}

impl Corrections {
    fn lattice(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Lattice> {
        let width = model.info().status.len();
        let statuses = self.settings.grid.statuses(model).map_err(|error| within(error, &["grid"]))?;
        let sides = sides(model, &statuses)?;
        let mut lattice = Lattice { width, sides, corrected: Vec::new(), sets: Vec::new() };
        let start: Vec<f64> = statuses.iter().take(width).copied().collect();
        let mut statuses: Vec<f64> = Vec::with_capacity(statuses.len());
        for node in lattice.nodes() {
            let mut status = start.clone();
            lattice.sides.iter().zip(node).for_each(|(side, at)| status[side.column] = at / side.factor);
            statuses.extend(status);
        }
        let directions = directions(model);
        for status in statuses.chunks_mut(width) {
            directions.iter().for_each(|(_, column)| status[*column] = 1.0);
        }
        check_confounded(model, calibration, &statuses)?;
        let values = machine_values(model, calibration);
        let correction = self.settings.correction();
        let compensator = Compensator::new(model, &values, &correction)?;
        let forward = compensator.correct(&statuses)?.0;
        lattice.corrected = corrected_axes(model, &self.settings.correct);
        let set = |name: String, when, from: &[f64], to: &[f64]| Set {
            name,
            when,
            values: differences(&lattice.corrected, width, from, to),
        };
        let mut sets = vec![set("forward".to_owned(), When::Always, &statuses, &forward)];
        for (name, column) in directions {
            let mut reversed = statuses.clone();
            reversed.chunks_mut(width).for_each(|status| status[column] = -1.0);
            let found =
                set(format!("reverse_{name}"), When::Reversed(column), &forward, &compensator.correct(&reversed)?.0);
            if found.values.iter().flatten().any(|value| *value != 0.0) {
                sets.push(found);
            }
        }
        lattice.sets = sets;
        Ok(lattice)
    }
}

/// The axes that vary on a grid: linear ones first, by their names.
fn sides(model: &dyn KinematicModel, statuses: &[f64]) -> Result<Vec<Side>> {
    let width = model.info().status.len().max(1);
    let mut sides: Vec<Side> = (model.info().axes.iter())
        .map(|axis| {
            let (unit, factor) = position_unit(axis);
            let all = statuses.iter().skip(axis.status).step_by(width);
            let mut nodes: Vec<f64> = all.map(|at| rounded_position(at * factor)).collect();
            nodes.sort_by(f64::total_cmp);
            nodes.dedup();
            Side { label: format!("{}_{unit}", axis.name), column: axis.status, factor, nodes }
        })
        .filter(|side| side.nodes.len() > 1)
        .collect();
    let is_endless = |side: &&Side| model.info().axes.iter().any(|axis| axis.status == side.column && axis.endless);
    if let Some(side) = sides.iter().find(is_endless) {
        let message = format!("{} turns without an end, and a grid has ends: hold this axis", side.label);
        return Err(Error::usage(message).setting("grid"));
    }
    let is_rotary = |side: &Side| side.factor != 1.0;
    sides.sort_by(|a, b| (is_rotary(a), &a.label).cmp(&(is_rotary(b), &b.label)));
    match sides.is_empty() {
        true => Err(Error::usage("at least one axis has to vary").setting("grid")),
        false => Ok(sides),
    }
}

/// The axes whose commands are corrected, as [`Correct`] tells.
fn corrected_axes(model: &dyn KinematicModel, correct: &Correct) -> Vec<Corrected> {
    let axes = model.info().axes.iter().filter(|axis| !axis.indexed);
    axes.map(|axis| (axis, position_unit(axis)))
        .filter(|(axis, (unit, _))| match correct {
            Correct::Position => *unit == "mm",
            Correct::FiveAxes => true,
            Correct::Axes(names) => names.contains(&axis.name),
        })
        .map(|(axis, (unit, factor))| Corrected {
            label: format!("d{}_{unit}", axis.name),
            column: axis.status,
            factor,
        })
        .collect()
}

/// Changes of commands, as the file has them.
fn differences(axes: &[Corrected], width: usize, from: &[f64], to: &[f64]) -> Vec<Vec<f64>> {
    let of_point = |(from, to): (&[f64], &[f64])| {
        let change = |axis: &Corrected| rounded((to[axis.column] - from[axis.column]) * axis.factor, DECIMALS);
        axes.iter().map(change).collect()
    };
    from.chunks(width).zip(to.chunks(width)).map(of_point).collect()
}

impl Export for Corrections {
    fn inputs(&self) -> Vec<InputFile> {
        self.existing.iter().map(|path| InputFile { setting: "existing", path: path.clone() }).collect()
    }

    fn export(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Vec<ExportedFile>> {
        let mut lattice = self.lattice(calibration, model)?;
        if let Some(path) = &self.existing {
            let (largest_mm, ranges) = (self.settings.largest_tip_correction_mm, Ranges::new());
            let settings = ["largest_tip_correction_mm", "largest_deg", "grid"];
            let believed = Believed { settings, ..Believed::new(largest_mm, self.settings.largest_deg, &ranges) };
            let active = grid_file::read(path, model, &believed)?;
            let added = lattice.add(&active, DECIMALS);
            added.map_err(|message| Error::usage(message).in_file(path).setting("existing"))?;
            grid_file::check_coverage(&active, &lattice.sides, path)?;
        }
        Ok(vec![match self.settings.format {
            Format::Csv => file("corrections.csv", csv(&lattice)),
            Format::Vtk => file("corrections.vtk", vtk(&lattice)?),
        }])
    }

    fn correction(
        &self,
        calibration: &Calibration,
        model: &dyn KinematicModel,
    ) -> Result<Option<Box<dyn CommandCorrection>>> {
        Ok(Some(Box::new(self.lattice(calibration, model)?)))
    }
}

fn joined(values: &[f64], by: &str) -> String {
    values.iter().map(f64::to_string).collect::<Vec<_>>().join(by)
}

fn csv(lattice: &Lattice) -> String {
    let labels = lattice.sides.iter().map(|side| &side.label).chain(lattice.corrected.iter().map(|axis| &axis.label));
    let labels: Vec<&str> = labels.map(String::as_str).collect();
    let mut text = format!("{NOTE}set,{}\n", labels.join(","));
    let nodes = lattice.nodes();
    for set in &lattice.sets {
        for (node, values) in nodes.iter().zip(&set.values) {
            text.push_str(&format!("{},{},{}\n", set.name, joined(node, ","), joined(values, ",")));
        }
    }
    text
}

const NOTE: &str = "\
# Add the corrections to the commands: those of the set `forward` always, those of `reverse_X` while the last move of X was negative.
# Linear between nodes in every axis; the values at the ends hold beyond them.
";

fn vtk(lattice: &Lattice) -> Result<String> {
    let sides = &lattice.sides;
    if sides.len() > 3 {
        return Err(Error::usage(format!("{} axes vary; a file for VTK has at most three", sides.len()))
            .help("let the others stand still, or write `format: csv`")
            .setting("format"));
    }
    let labels: Vec<&str> = sides.iter().map(|side| side.label.as_str()).collect();
    let nodes = |place: usize| sides.get(place).map_or_else(|| vec![0.0], |side| side.nodes.clone());
    let [x, y, z] = [0, 1, 2].map(nodes);
    let mut text = format!(
        "# vtk DataFile Version 3.0\nCorrections of commands; x y z are {}\nASCII\nDATASET RECTILINEAR_GRID\nDIMENSIONS {} {} \
         {}\n",
        labels.join(" "),
        x.len(),
        y.len(),
        z.len()
    );
    for (name, nodes) in [("X", &x), ("Y", &y), ("Z", &z)] {
        text.push_str(&format!("{name}_COORDINATES {} double\n{}\n", nodes.len(), joined(nodes, " ")));
    }
    text.push_str(&format!("POINT_DATA {}\n", x.len() * y.len() * z.len()));
    // There x changes fastest, in the lattice the last side.
    let index = |i: usize, j: usize, k: usize| (i * y.len() + j) * z.len() + k;
    for set in &lattice.sets {
        for (place, axis) in lattice.corrected.iter().enumerate() {
            text.push_str(&format!("SCALARS {}_{} double 1\nLOOKUP_TABLE default\n", set.name, axis.label));
            for (k, j) in (0..z.len()).flat_map(|k| (0..y.len()).map(move |j| (k, j))) {
                let row: Vec<f64> = (0..x.len()).map(|i| set.values[index(i, j, k)][place]).collect();
                text.push_str(&format!("{}\n", joined(&row, " ")));
            }
        }
    }
    Ok(text)
}
