//! Artefact plugin `calibrated-points`: a bar or plate with calibrated points that is placed on the table, once or several
//! times, and whose points the machine measures: multi-feature bar, ball plate, hole plate.
//!
//! Equation: `R^T (p - T Q_j) = 0` in the directions of the artefact that were measured. p is the tip in the table frame,
//! Q_j the calibrated point in the artefact's frame, `T = T_nominal E(x, y, z, a, b, c)` its placement with the rotation R
//! (Viprey et al. 2019, section 3). Placements are known as far as they are not chosen as unknowns; errors of the calibration
//! are known inputs that all measurements share.

mod calibrated;
mod placement;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use abbe_core::{
    AboveZero, Artefact, ColumnHeader, Contact, Context, DataRow, Dataset, Equations, Error, InputFile, KinematicModel,
    LabelText, Layout, ListedBy, Observations, ObservationsInfo, Parameter, Quantity, Result, RowBatch, RowIndex,
    SettingsError, Target, Unit, not_negative, plain_naming, pose_columns, positive,
};
use abbe_dcc::CertificateFile;
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use calibrated::Source;
use placement::Placement;

abbe_core::register!(
    Artefact,
    "calibrated-points",
    "a bar or plate with calibrated points, placed on the table and measured point by point",
    Settings,
    example,
    build,
    "../reference/artefact-calibrated-points.md",
);

/// Settings of an artefact with calibrated points.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// CSV file of the calibrated points in the artefact's own frame: point, x_mm, y_mm, z_mm; a plate
    /// without z_mm is plane. Either this or `certificate`.
    #[serde(default)]
    points: Option<String>,
    /// The digital calibration certificate of the artefact: its points with their covariance, in place of `points` and
    /// `calibration_standard_uncertainty_um`.
    #[serde(default)]
    certificate: Option<CertificateFile>,
    /// The column of the point's label, there and in the data.
    #[serde(default = "default_point")]
    point: String,
    /// CSV file of the nominal placements in the table frame: label, x_mm, y_mm, z_mm of the artefact's origin, ux, uy, uz of
    /// its x direction, vx, vy, vz of its y direction.
    placements: String,
    /// The column of the placement's label, there and in the data. With a single placement the data need no such
    /// column.
    #[serde(default = "default_placement")]
    placement: String,
    /// What the unknowns of a placement are called: `bar` gives `bar[1].x`, `.y`, `.z`, `.a`, `.b`, `.c`.
    #[serde(default = "default_name")]
    name: String,
    /// Standard uncertainty of one measured coordinate.
    #[schemars(with = "AboveZero")]
    standard_uncertainty_um: f64,
    /// Standard uncertainty of every coordinate of the calibration, shared by all measurements of the point.
    #[serde(default)]
    calibration_standard_uncertainty_um: f64,
}

fn default_point() -> String {
    "point".to_owned()
}

fn default_placement() -> String {
    "placement".to_owned()
}

fn default_name() -> String {
    "bar".to_owned()
}

/// Columns of the data (without unit) that say whether a direction of the artefact was measured; one that is not there counts as 1.
const MEASURED: [&str; 3] = ["meas_x", "meas_y", "meas_z"];

/// Own names of the coordinates, and of the errors of a placement.
const ERRORS: [&str; 6] = ["x", "y", "z", "a", "b", "c"];

fn example() -> Value {
    json!({
        "points": "bar.csv",
        "placements": "positionings.csv",
        "placement": "positioning",
        "standard_uncertainty_um": 0.3,
        "calibration_standard_uncertainty_um": 0.15,
    })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Artefact>, SettingsError> {
    positive("standard_uncertainty_um", settings.standard_uncertainty_um)?;
    not_negative("calibration_standard_uncertainty_um", settings.calibration_standard_uncertainty_um)?;
    if settings.name.is_empty() || settings.name.contains(['[', ']', '*', '?']) {
        return Err(SettingsError::new("name", "a name without brackets and wildcards was expected"));
    }
    let points = Source::new(&settings, context)?;
    let placements = context.path(&settings.placements);
    Ok(Box::new(CalibratedPoints { settings, points, placements }))
}

struct CalibratedPoints {
    settings: Settings,
    points: Source,
    placements: PathBuf,
}

/// The contents of a file, with their labels.
struct Labelled<T> {
    labels: Vec<String>,
    items: Vec<T>,
}

impl<T> Labelled<T> {
    fn index(&self) -> BTreeMap<&str, usize> {
        self.labels.iter().enumerate().map(|(index, label)| (label.as_str(), index)).collect()
    }
}

impl CalibratedPoints {
    fn read_placements(&self) -> Result<Labelled<Placement>> {
        let table = abbe_table::read(&self.placements)?;
        let labels = abbe_table::labels(&table, &self.settings.placement).map_err(of_placement)?;
        abbe_table::unique_labels(&table, &self.settings.placement)?;
        let origins = abbe_table::points(&table, ["x", "y", "z"])?;
        let along_x = abbe_table::vectors(&table, ["ux", "uy", "uz"])?;
        let along_y = abbe_table::vectors(&table, ["vx", "vy", "vz"])?;
        let rows = DataRow::enumerate(origins.into_iter().zip(along_x).zip(along_y));
        let placements = rows.map(|(row, ((origin, u), v))| {
            Placement::new(origin.into(), u.into(), v.into()).ok_or_else(|| {
                table.error_at(row, "u and v are not the x and y directions of a frame").help(
                    "ux, uy, uz and vx, vy, vz are two directions at right angles, the artefact's x and y in the table frame",
                )
            })
        });
        let labels = labels.iter().map(LabelText::to_string).collect();
        Ok(Labelled { labels, items: placements.collect::<Result<_>>()? })
    }

    /// Index of the placement of every data row: by its column, or the only one there is.
    fn placement_of_rows(&self, data: &Dataset, placements: &Labelled<Placement>) -> Result<Vec<usize>> {
        let column = &self.settings.placement;
        if data.column(column).is_none() && placements.items.len() == 1 {
            return Ok(vec![0; data.rows()]);
        }
        let known = placements.index();
        let labels = DataRow::enumerate(abbe_table::labels(data, column).map_err(of_placement)?);
        let of_rows = labels.map(|(row, label)| {
            known.get(label.as_str()).copied().ok_or_else(|| {
                let file = self.placements.display();
                data.error_at(row, format!("{column} `{label}` is not in the file `{file}`"))
            })
        });
        of_rows.collect()
    }
}

/// An error about the column of placements.
fn of_placement(error: Error) -> Error {
    error.setting("placement")
}

/// The directions that were measured in every data row.
fn measured(data: &Dataset) -> Result<Vec<Vec<usize>>> {
    let mut rows = vec![Vec::new(); data.rows()];
    for (direction, column) in MEASURED.iter().enumerate() {
        let flags = match data.column(column) {
            Some(_) => abbe_table::numbers(data, column, Quantity::Ratio)?.to_vec(),
            None => vec![1.0; data.rows()],
        };
        for (row, flag) in DataRow::enumerate(flags) {
            if flag == 1.0 {
                rows[row.0].push(direction);
            } else if flag != 0.0 {
                return Err(data.error_at(row, format!("`{column}` is {flag}; 0 or 1 was expected")));
            }
        }
    }
    match rows.iter().position(Vec::is_empty) {
        Some(row) => Err(data
            .error_at(DataRow(row), "no direction of this point was measured")
            .help("one of meas_x, meas_y and meas_z has to be 1; leave the row out if none is")),
        None => Ok(rows),
    }
}

impl Artefact for CalibratedPoints {
    fn inputs(&self) -> Vec<InputFile> {
        vec![self.points.input(), InputFile { setting: "placements", path: self.placements.clone() }]
    }

    fn check(&self, headers: &[ColumnHeader], file: Option<&PathBuf>, model: &dyn KinematicModel) -> Result<()> {
        pose_columns(headers, file, model, &plain_naming)?;
        abbe_table::require(headers, file, &[(&self.settings.point, Quantity::Label)])
            .map_err(|error| error.setting("point"))?;
        let lengths = ["x", "y", "z"].map(|name| (name, Quantity::Length));
        let directions = ["ux", "uy", "uz", "vx", "vy", "vz"].map(|name| (name, Quantity::Ratio));
        self.points.check(&self.settings.point)?;
        let (placements, label) = (abbe_table::read_headers(&self.placements)?, self.settings.placement.as_str());
        let required = |columns: &[_]| abbe_table::require(&placements, Some(&self.placements), columns);
        required(&[(label, Quantity::Label)]).map_err(of_placement)?;
        required(&[&lengths[..], &directions].concat())
    }

    fn observe(&self, data: &Arc<Dataset>, model: &Arc<dyn KinematicModel>) -> Result<Arc<dyn Observations>> {
        self.observe_some(data, model)?.ok_or_else(|| abbe_table::untouched(self.points.file()))
    }

    fn observe_some(
        &self,
        data: &Arc<Dataset>,
        model: &Arc<dyn KinematicModel>,
    ) -> Result<Option<Arc<dyn Observations>>> {
        let model = model.as_ref();
        let (points, placements) = (self.points.read(&self.settings)?, self.read_placements()?);
        let known = points.places();
        let labels = abbe_table::labels(data, &self.settings.point).map_err(|error| error.setting("point"))?;
        let of_rows: Vec<Option<usize>> = labels.iter().map(|label| known.get(label.as_str()).copied()).collect();
        let Some(touched) = abbe_table::touched_by_some(&of_rows) else { return Ok(None) };
        let (placed, directions) = (self.placement_of_rows(data, &placements)?, measured(data)?);

        let mut layout = Layout::new(data, model, &[&plain_naming])?;
        let uncertainty = self.settings.standard_uncertainty_um * 1e-3;
        let mut used: Vec<usize> = touched.rows.iter().map(|(row, _)| placed[row.0]).collect();
        used.sort_unstable();
        used.dedup();
        let mut rows = Vec::new();
        for &(row, point) in &touched.rows {
            layout.push(model, row, &vec![uncertainty; directions[row.0].len()])?;
            // Every placement of a row is among those that are used.
            let placement = used.partition_point(|placement| *placement < placed[row.0]);
            rows.push(Measurement { point, placement, directions: directions[row.0].clone() });
        }
        let named = |name: String, of| Parameter::new(name, Unit::of(of));
        let name = &self.settings.name;
        let unknowns = used.iter().flat_map(|&placement| {
            let label = &placements.labels[placement];
            ERRORS.iter().enumerate().map(move |(error, own)| {
                named(format!("{name}[{label}].{own}"), if error < 3 { Quantity::Length } else { Quantity::Angle })
            })
        });
        let (inputs, errors) = points.errors(&touched.features);
        let info =
            ObservationsInfo { inputs, ..ObservationsInfo::new(layout, unknowns.collect(), Contact::LinearAxes) };
        Ok(Some(Arc::new(Measured {
            info,
            points: touched.features.iter().map(|&point| points.points[point]).collect(),
            errors,
            placements: used.iter().map(|&placement| placements.items[placement].clone()).collect(),
            rows,
        })))
    }

    fn rows_are_independent(&self) -> bool {
        true
    }

    fn targets(&self, _: f64) -> Result<Vec<Target>> {
        let (points, placements) = (self.points.read(&self.settings)?, self.read_placements()?);
        let placed = placements.items.iter().flat_map(|placement| {
            let points = points.labels.iter().zip(&points.points);
            points.map(|(label, point)| Target {
                feature: label.clone(),
                tip: placement.place(point, &[0.0; 6]).into(),
                approach: None,
            })
        });
        Ok(placed.collect())
    }
}

/// One measured point.
struct Measurement {
    point: usize,
    placement: usize,
    /// The directions of the artefact that were measured.
    directions: Vec<usize>,
}

impl ListedBy<RowIndex> for Measurement {}

/// Measured points. They are not stated as features: a point has as many positions as the artefact has placements.
struct Measured {
    info: ObservationsInfo,
    points: Vec<Vector3<f64>>,
    /// The inputs that make the error of each coordinate of these, with their derivatives.
    errors: Vec<[Vec<(usize, f64)>; 3]>,
    placements: Vec<Placement>,
    rows: Vec<Measurement>,
}

impl Measured {
    /// The calibrated point of a measurement, with the errors of the calibration.
    fn point(&self, measurement: &Measurement, inputs: &[f64]) -> Vector3<f64> {
        let errors = &self.errors[measurement.point];
        let error = |along: usize| errors[along].iter().map(|(input, factor)| inputs[*input] * factor).sum::<f64>();
        self.points[measurement.point] + Vector3::new(error(0), error(1), error(2))
    }
}

impl Observations for Measured {
    fn info(&self) -> &ObservationsInfo {
        &self.info
    }

    fn evaluate(&self, batch: RowBatch<'_>, out: &mut Equations) -> Result<()> {
        for (&row, position) in batch.rows.iter().zip(batch.positions) {
            let measurement = &self.rows[row];
            let first = 6 * measurement.placement;
            let placement = &self.placements[measurement.placement];
            let seen = placement.seen(&Vector3::from(*position), &batch.own[first..first + 6]);
            let from_point = seen.point - self.point(measurement, batch.inputs);
            for &direction in &measurement.directions {
                out.equation(from_point[direction]);
                out.position(seen.by_point.row(direction).transpose().into());
                for (error, derivative) in seen.by_error.row(direction).iter().enumerate() {
                    out.own(first + error, *derivative);
                }
                let errors = &self.errors[measurement.point][direction];
                errors.iter().for_each(|(input, factor)| out.input(*input, -factor));
            }
        }
        Ok(())
    }

    fn contact_tip(&self, row: RowIndex, _: [f64; 3], own: &[f64], inputs: &[f64]) -> Result<Option<[f64; 3]>> {
        let measurement = &self.rows[row];
        let first = 6 * measurement.placement;
        let placement = &self.placements[measurement.placement];
        Ok(Some(placement.place(&self.point(measurement, inputs), &own[first..first + 6]).into()))
    }
}

#[cfg(test)]
mod tests;
