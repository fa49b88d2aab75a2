//! Exporter `volumetric`: the volumetric error over the workspace, with its covariance and its region of uncertainty.

use abbe_core::{
    Calibration, Context, Export, ExportedFile, KinematicModel, PathItem, Result, SettingsError, StatusRole,
};
use abbe_volumetric::{Grid, position_unit, predict, rounded_position, within};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::sampling::{exact, fixed};

abbe_core::register!(
    Export,
    "volumetric",
    "volumetric error over the workspace with its uncertainty ellipsoids, as CSV",
    Settings,
    example,
    build,
    "../reference/export-volumetric.md",
);

/// Settings of the table.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// The poses.
    grid: Grid,
    /// Probability with which the ellipsoids hold the error.
    #[serde(default = "default_probability")]
    probability: f64,
    /// What the machine does: position a tool, or measure with a probe.
    #[serde(default)]
    task: Task,
}

/// Which error is written (Soons 1993, eq. 2.31 and 2.34).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Task {
    /// The error of the tip: its position minus its nominal position.
    #[default]
    Position,
    /// The error of the indicated coordinates: the indicated position minus the position of the tip. It is the error of
    /// the tip with the other sign.
    Measure,
}

impl Task {
    fn sign(self) -> f64 {
        if self == Self::Measure { -1.0 } else { 1.0 }
    }

    /// What a file says of errors that are not those of the tip.
    fn comment(self) -> &'static str {
        match self {
            Self::Position => "",
            Self::Measure => {
                "# task: measure; errors of the indicated coordinates, indicated minus actual: minus the positioning error of the tip\n"
            }
        }
    }
}

fn default_probability() -> f64 {
    0.95
}

fn example() -> Value {
    json!({ "grid": { "points": 5, "axes": { "X": { "from_mm": -400, "to_mm": 400 } } }, "probability": 0.95 })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Export>, SettingsError> {
    settings.grid.check().map_err(|error| error.under([PathItem::Key("grid".to_owned())]))?;
    if !(settings.probability > 0.0 && settings.probability < 1.0) {
        return Err(SettingsError::new("probability", "a number between 0 and 1 was expected"));
    }
    Ok(Box::new(VolumetricTable { settings }))
}

struct VolumetricTable {
    settings: Settings,
}

impl Export for VolumetricTable {
    fn export(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Vec<ExportedFile>> {
        let statuses = self.settings.grid.statuses(model).map_err(|error| within(error, &["grid"]))?;
        let errors = predict(model, calibration, &statuses)?;
        let columns = self.position_columns(model);
        let mut text = self.settings.task.comment().to_owned();
        columns.iter().for_each(|column| text.extend([column.header.as_str(), ","]));
        text.push_str(COLUMNS);
        for (status, error) in statuses.chunks(model.info().status.len()).zip(&errors) {
            let ellipsoid = error.ellipsoid(self.settings.probability)?;
            let um = |value: &f64| fixed(value * 1e3);
            let mut cells: Vec<String> = columns
                .iter()
                .map(|column| rounded_position(status[column.status] * column.factor).to_string())
                .collect();
            cells.extend(error.mean.iter().map(|value| um(&(self.settings.task.sign() * value))));
            cells.push(um(&error.size()));
            let upper = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];
            cells.extend(upper.map(|(row, column)| exact(error.covariance[row][column] * 1e6)));
            cells.extend(ellipsoid.standard_uncertainties.iter().map(um));
            cells.extend(ellipsoid.directions.iter().flatten().copied().map(fixed));
            cells.extend((0..3).map(|axis| ellipsoid.semi_axes.map_or_else(String::new, |axes| um(&axes[axis]))));
            cells.push(ellipsoid.nonzero.to_string());
            text.push_str(&cells.join(","));
            text.push('\n');
        }
        Ok(vec![ExportedFile { name: "volumetric.csv".to_owned(), content: text.into_bytes() }])
    }
}

/// The columns after those of the pose.
const COLUMNS: &str = "x_um,y_um,z_um,size_um,xx_um2,yy_um2,zz_um2,xy_um2,xz_um2,yz_um2,u1_um,u2_um,u3_um,\
                       d1x,d1y,d1z,d2x,d2y,d2z,d3x,d3y,d3z,a1_um,a2_um,a3_um,nonzero\n";

/// A column that tells the pose.
struct PositionColumn {
    header: String,
    status: usize,
    factor: f64,
}

impl VolumetricTable {
    /// The axes, then the directions of approach if they differ from row to row.
    fn position_columns(&self, model: &dyn KinematicModel) -> Vec<PositionColumn> {
        let axes = model.info().axes.iter().map(|axis| {
            let (unit, factor) = position_unit(axis);
            PositionColumn { header: format!("{}_{unit}", axis.name), status: axis.status, factor }
        });
        let directions = model.info().status.iter().enumerate();
        let directions = directions
            .filter(|(_, column)| self.settings.grid.both_directions && matches!(column.role, StatusRole::Direction(_)))
            .map(|(status, column)| PositionColumn { header: column.name.clone(), status, factor: 1.0 });
        axes.chain(directions).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{built, calibration, chain, key_error};

    fn table(settings: Value, calibration: &Calibration, model: &dyn KinematicModel) -> String {
        let files = built(&settings, build).unwrap().export(calibration, model).unwrap();
        assert_eq!(files.len(), 1);
        assert_eq!(files[0].name, "volumetric.csv");
        String::from_utf8(files[0].content.clone()).unwrap()
    }

    #[test]
    fn a_gain_with_its_uncertainty() {
        let errors = json!([{ "polynomial": ["EXX"], "degrees": [1] }, { "backlash": ["EXX"] }]);
        let model = chain("w B' b X t", json!({ "X": { "range_mm": [-100, 100] } }), errors);
        let mut calibration = calibration(model.as_ref(), &[("EXX[1]", 1e-5), ("EXX[b]", 5e-4)]);
        calibration.covariance.order = vec!["EXX[1]".to_owned()];
        calibration.covariance.rows = vec![vec![1e-10]];
        // At B = 0 and X = 100: error 1e-5 * 100 + 0.5e-3 mm, u = 1e-5 * 100 mm along x.
        let (columns, one) = (COLUMNS.trim_end(), "1.959964");
        let grid = json!({ "points": { "X": 3 }, "both_directions": true });
        let text = table(json!({ "grid": grid.clone() }), &calibration, model.as_ref());
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 1 + 6);
        assert_eq!(lines[0], format!("B_deg,X_mm,dir_X,{columns}"));
        let middle = "0e0,0e0,0e0,0e0,0e0,0e0,0.000000,0.000000,0.000000,1.000000,0.000000,0.000000,0.000000,1.000000,\
                      0.000000,0.000000,0.000000,1.000000,0.000000,0.000000,0.000000,0";
        assert_eq!(lines[2], format!("0,0,1,0.500000,0.000000,0.000000,0.500000,{middle}"));
        assert_eq!(lines[5], format!("0,0,-1,-0.500000,0.000000,0.000000,0.500000,{middle}"));
        let end = lines[3].split(',').collect::<Vec<_>>();
        assert_eq!(end[..7], ["0", "100", "1", "1.500000", "0.000000", "0.000000", "1.500000"]);
        assert!((end[7].parse::<f64>().unwrap() - 1.0).abs() < 1e-12);
        assert_eq!(end[13..16], ["1.000000", "0.000000", "0.000000"]);
        assert_eq!((end[25], *end.last().unwrap()), (one, "1"));
        // Where the tip went too far the scale shows too little: minus the error of the tip, and the same uncertainty.
        let measured = table(json!({ "grid": grid, "task": "measure" }), &calibration, model.as_ref());
        let mut measured = measured.lines();
        assert!(measured.next().unwrap().starts_with("# task: measure; errors of the indicated coordinates"));
        for (position, measure) in lines.iter().zip(measured).skip(1) {
            let [position, measure] = [position, measure].map(|line| line.split(',').collect::<Vec<_>>());
            let x = |cells: &[&str]| cells[3].parse::<f64>().unwrap();
            assert_eq!(x(&measure), -x(&position));
            assert_eq!((&measure[..3], &measure[6..]), (&position[..3], &position[6..]));
        }
        // The table turned by a right angle sees the error along another of its axes.
        let pose = json!({ "grid": { "poses": [{ "X_mm": 100, "B_deg": 90 }] } });
        let text = table(pose, &calibration, model.as_ref());
        let turned: Vec<&str> = text.lines().nth(1).unwrap().split(',').collect();
        assert_eq!(turned[..3], ["90", "100", "0.000000"]);
        assert_eq!(turned[4].trim_start_matches('-'), "1.500000");
    }

    #[test]
    fn errors_point_at_the_setting() {
        let model = chain("w b X Y Z t", json!({}), json!([]));
        let stage = |settings| built(&settings, build);
        let export = stage(json!({ "grid": { "poses": [{ "V_mm": 1 }] } })).unwrap();
        assert_eq!(
            key_error(export.export(&calibration(model.as_ref(), &[]), model.as_ref())),
            "grid.poses[0].V_mm: the machine has no axis V"
        );
        let cases = [
            (json!({}), "the setting `grid` is missing"),
            (json!({ "grid": {} }), "grid: `points`, `step_mm` with `step_deg`, or `poses` were expected"),
            (
                json!({ "grid": { "points": 2 }, "probability": 1 }),
                "probability: a number between 0 and 1 was expected",
            ),
        ];
        for (settings, expected) in cases {
            assert_eq!(stage(settings).err().unwrap().to_string(), expected);
        }
        assert!(stage(example()).is_ok());
    }
}
