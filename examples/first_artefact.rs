//! A first artefact: points whose places are known, touched by the tip. CONTRIBUTING.md goes through it.
//!
//!     cargo run --release -p abbe-examples --example first_artefact

use std::path::PathBuf;
use std::sync::Arc;

use abbe_core::{
    Artefact, ColumnHeader, Contact, Context, DataRow, Dataset, Equations, Feature, InputFile, KinematicModel,
    LabelText, Layout, Observations, ObservationsInfo, Quantity, Registry, Result, RowBatch, RowIndex, SettingsError,
    Target, plain_naming, pose_columns, positive,
};
use abbe_engine::prepare;
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::json;

use abbe_bundle as _;

// 1. The plugin registers itself: kind, name, one line, settings, an example of them, how it is built, and the text of its
//    reference page.
abbe_core::register!(
    Artefact,
    "known-points",
    "points whose places are known, touched by the tip",
    Settings,
    || json!({ "nominal": "points.csv", "standard_uncertainty_um": 1.0 }),
    build,
    "first_artefact.md",
);

/// Settings of known points. What stands here is what the schema of recipes says.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// CSV file of the points: feature, x_mm, y_mm, z_mm in the table frame.
    nominal: String,
    /// Standard uncertainty of one coordinate of a touch.
    standard_uncertainty_um: f64,
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Artefact>, SettingsError> {
    positive("standard_uncertainty_um", settings.standard_uncertainty_um)?;
    // Files are read later: building a stage does nothing that could be slow.
    let nominal = context.path(&settings.nominal);
    Ok(Box::new(KnownPoints { nominal, standard_uncertainty: settings.standard_uncertainty_um * 1e-3 }))
}

struct KnownPoints {
    nominal: PathBuf,
    /// mm.
    standard_uncertainty: f64,
}

impl KnownPoints {
    fn points(&self) -> Result<Vec<(String, [f64; 3])>> {
        let table = abbe_table::read(&self.nominal)?;
        let labels = abbe_table::labels(&table, "feature")?.iter().map(LabelText::to_string);
        Ok(labels.zip(abbe_table::points(&table, ["x", "y", "z"])?).collect())
    }
}

// 2. The artefact: what it reads, whether columns can be used, and the observations that it makes of rows.
impl Artefact for KnownPoints {
    fn inputs(&self) -> Vec<InputFile> {
        vec![InputFile { setting: "nominal", path: self.nominal.clone() }]
    }

    fn check(&self, headers: &[ColumnHeader], file: Option<&PathBuf>, model: &dyn KinematicModel) -> Result<()> {
        pose_columns(headers, file, model, &plain_naming)?;
        abbe_table::require(headers, file, &[("feature", Quantity::Label)])
    }

    fn observe(&self, data: &Arc<Dataset>, model: &Arc<dyn KinematicModel>) -> Result<Arc<dyn Observations>> {
        let model = model.as_ref();
        let points = self.points()?;
        let mut layout = Layout::new(data, model, &[&plain_naming])?;
        let mut point_of_row = Vec::new();
        for (row, label) in DataRow::enumerate(abbe_table::labels(data, "feature")?) {
            let place = points.iter().position(|(known, _)| known == label);
            point_of_row.push(place.ok_or_else(|| data.error_at(row, format!("there is no point `{label}`")))?);
            layout.push(model, row, &[self.standard_uncertainty; 3])?;
        }
        let feature =
            |(label, point): &(String, [f64; 3])| Feature { label: label.clone(), point: *point, shifts: Vec::new() };
        let features = points.iter().map(feature).collect();
        // No unknowns, no known inputs; the linear axes move until there is contact.
        let info = ObservationsInfo { features, ..ObservationsInfo::new(layout, Vec::new(), Contact::LinearAxes) };
        Ok(Arc::new(Touches { info, points, point_of_row }))
    }

    fn targets(&self, _stylus_radius: f64) -> Result<Vec<Target>> {
        let target = |(feature, tip)| Target { feature, tip, approach: None };
        Ok(self.points()?.into_iter().map(target).collect())
    }
}

struct Touches {
    info: ObservationsInfo,
    points: Vec<(String, [f64; 3])>,
    point_of_row: Vec<usize>,
}

// 3. The observations: residuals as functions of tip positions, with their derivatives. No machine is in sight.
impl Observations for Touches {
    fn info(&self) -> &ObservationsInfo {
        &self.info
    }

    fn evaluate(&self, batch: RowBatch<'_>, out: &mut Equations) -> Result<()> {
        for (&row, position) in batch.rows.iter().zip(batch.positions) {
            let (_, point) = &self.points[self.point_of_row[row]];
            for axis in 0..3 {
                out.equation(position[axis] - point[axis]);
                let mut derivative = [0.0; 3];
                derivative[axis] = 1.0;
                out.position(derivative);
            }
        }
        Ok(())
    }

    // Rank is judged where the tip is on the point, whatever the machine's errors are.
    fn contact_tip(&self, row: RowIndex, _tip: [f64; 3], _own: &[f64], _inputs: &[f64]) -> Result<Option<[f64; 3]>> {
        Ok(Some(self.points[self.point_of_row[row]].1))
    }
}

/// Prints what it finds.
pub fn main() -> Result<()> {
    for (name, found, truth) in scales()? {
        println!("{name}: {:+.6} µm/m, put in: {:+.6}", found * 1e6, truth * 1e6);
    }
    Ok(())
}

/// The scales of a machine that are found from touches of a grid of points, and those that the touches were made with.
pub fn scales() -> Result<Vec<(&'static str, f64, f64)>> {
    let truth = [("EXX[1]", 12e-6), ("EYY[1]", -20e-6), ("EZZ[1]", 5e-6)];
    let (mut points, mut touches) = ("feature,x_mm,y_mm,z_mm\n".to_owned(), "feature,X_mm,Y_mm,Z_mm\n".to_owned());
    for number in 0..8 {
        let point = [0, 1, 2].map(|axis| if number >> axis & 1 == 0 { 50.0 } else { 450.0 });
        let [x, y, z] = point;
        points.push_str(&format!("{number},{x},{y},{z}\n"));
        // Where the axes stand when a tip with these scales is on the point.
        let [x, y, z] = [0, 1, 2].map(|axis| point[axis] / (1.0 + truth[axis].1));
        touches.push_str(&format!("{number},{x},{y},{z}\n"));
    }
    let recipe = json!({
        "abbe": 1, "name": "Known points",
        "stages": {
            "touches": { "ingest": "csv", "path": "touches.csv" },
            "points": { "artefact": "known-points", "from": "touches", "nominal": "points.csv", "standard_uncertainty_um": 1 },
            "machine": {
                "model": "serial-chain", "chain": "w b X Y Z t", "tool_length_mm": 0, "stylus_radius_mm": 0,
                "errors": [{ "polynomial": ["EXX", "EYY", "EZZ"], "degrees": [1] }],
            },
            "fit": { "estimate": "gauss-newton", "machine": "machine", "observations": ["points"], "parameters": ["E*"],
                // Readings without noise have no scatter to judge by.
                "trust_uncertainties": true },
        },
    });
    let folder = tempfile::tempdir().expect("a folder");
    for (name, text) in [("points.csv", &points), ("touches.csv", &touches), ("recipe.yaml", &recipe.to_string())] {
        std::fs::write(folder.path().join(name), text).expect("it can be written");
    }
    let outcome =
        prepare(&folder.path().join("recipe.yaml"), &Registry::built_in()?)?.run(&abbe_core::Monitor::default())?;
    let found = |name: &str| outcome.fits[0].calibration.get(name).map_or(f64::NAN, |estimated| estimated.value);
    Ok(truth.map(|(name, truth)| (name, found(name), truth)).into())
}
