//! Artefact plugin `probed-points`: points of an uncalibrated artefact, each touched along one axis.

use std::path::PathBuf;
use std::sync::Arc;

use abbe_core::{
    AboveZero, Approach, Artefact, ColumnHeader, Contact, Context, DataRow, Dataset, Equations, Error, Feature,
    InputFile, KinematicModel, Layout, ListedBy, Observations, ObservationsInfo, Parameter, ParameterRole, Quantity,
    Result, RowBatch, RowIndex, SettingsError, Target, Unit, plain_naming, pose_columns, positive,
};
use abbe_probe::EffectiveRadius;
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::points::{Point, Points, axis_index, check_headers, holds_trigger};

abbe_core::register!(
    Artefact,
    "probed-points",
    "points of an uncalibrated artefact, each touched along one axis: rapid verification",
    Settings,
    example,
    build,
    "../reference/artefact-probed-points.md",
);

/// Settings of the points.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// CSV file of the nominal points: point, facet, x_mm, y_mm, z_mm, nx, ny, nz in the table frame, approach (`-Z`).
    nominal: String,
    /// Standard uncertainty of one touch along the normal.
    #[schemars(with = "AboveZero")]
    standard_uncertainty_um: f64,
}

fn example() -> Value {
    json!({ "nominal": "points.csv", "standard_uncertainty_um": 0.5 })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Artefact>, SettingsError> {
    positive("standard_uncertainty_um", settings.standard_uncertainty_um)?;
    Ok(Box::new(ProbedPoints {
        nominal: context.path(&settings.nominal),
        standard_uncertainty: settings.standard_uncertainty_um * 1e-3,
    }))
}

struct ProbedPoints {
    nominal: PathBuf,
    standard_uncertainty: f64,
}

impl Artefact for ProbedPoints {
    fn inputs(&self) -> Vec<InputFile> {
        vec![InputFile { setting: "nominal", path: self.nominal.clone() }]
    }

    fn check(&self, headers: &[ColumnHeader], file: Option<&PathBuf>, model: &dyn KinematicModel) -> Result<()> {
        pose_columns(headers, file, model, &plain_naming)?;
        abbe_probe::check_columns(headers, file, model)?;
        abbe_table::require(headers, file, &[("point", Quantity::Label), ("measured", Quantity::Length)])?;
        check_headers(&self.nominal).map(drop)
    }

    fn observe(&self, data: &Arc<Dataset>, model: &Arc<dyn KinematicModel>) -> Result<Arc<dyn Observations>> {
        let model = model.as_ref();
        let nominal = Points::read(&self.nominal)?;
        let by_label = nominal.by_label();
        let mut layout = Layout::new(data, model, &[&plain_naming])?;
        let measured = abbe_table::numbers(data, "measured", Quantity::Length)?;
        let (mut points, mut facets): (Vec<Touched>, Vec<Point>) = (Vec::new(), Vec::new());
        let mut touched = Vec::new();
        for (row, label) in DataRow::enumerate(abbe_table::labels(data, "point")?) {
            let Some(&index) = by_label.get(label.as_str()) else { continue };
            let point = &nominal.list[index];
            let axis = axis_index(model, &point.axis).map_err(|message| data.error_at(row, message))?;
            nominal.check_touched(DataRow(index), model, (data.as_ref(), row))?;
            let pose = layout.poses.end();
            layout.push(model, row, &[self.standard_uncertainty])?;
            touched.push((row, point.axis.as_str(), measured[row]));
            // What triggered is the reading; the column of the axis may hold where it was sent.
            layout.poses.row_mut(pose)[model.info().axes[axis].status] = measured[row];
            let known = facets.iter().position(|facet| facet.facet == point.facet);
            let facet = known.unwrap_or_else(|| {
                facets.push(point.clone());
                facets.len() - 1
            });
            points.push(Touched { point: point.clone(), facet, axis });
        }
        holds_trigger(data, &touched)?;
        if points.is_empty() {
            let error = Error::data(format!("no row touches a point of {}", self.nominal.display()));
            return Err(error.help("`point` in the data and in the nominal file have to agree"));
        }
        let unknowns = facets.iter().map(|facet| {
            Parameter::new(format!("facet[{}].d", facet.facet), Unit::MM).with_role(ParameterRole::Feature)
        });
        let features = facets.iter().enumerate().map(|(index, facet)| Feature {
            label: facet.facet.clone(),
            point: facet.position.into(),
            shifts: vec![(index, facet.normal.into())],
        });
        let approach = |touched: &Touched| Approach { axis: touched.axis, reading: "measured".to_owned() };
        let radius = EffectiveRadius::new(model, &layout, 0.0)?;
        let info = ObservationsInfo {
            inputs: radius.inputs().to_vec(),
            orientation: radius.orientation(),
            features: features.collect(),
            approaches: points.iter().map(approach).collect(),
            ..ObservationsInfo::new(layout, unknowns.collect(), Contact::LinearAxes)
        };
        Ok(Arc::new(Touches { info, points, radius }))
    }

    fn targets(&self, stylus_radius: f64) -> Result<Vec<Target>> {
        let targets = Points::read(&self.nominal)?.list.into_iter().map(|point| Target {
            tip: (point.position + stylus_radius * point.normal).into(),
            approach: Some((-point.normal).into()),
            feature: point.label,
        });
        Ok(targets.collect())
    }
}

/// What a row touches.
struct Touched {
    point: Point,
    /// Index of its facet.
    facet: usize,
    /// Index of the approach axis.
    axis: usize,
}

impl ListedBy<RowIndex> for Touched {}

/// Touches on points.
struct Touches {
    info: ObservationsInfo,
    /// What every row touches.
    points: Vec<Touched>,
    radius: EffectiveRadius,
}

impl Observations for Touches {
    fn info(&self) -> &ObservationsInfo {
        &self.info
    }

    fn evaluate(&self, batch: RowBatch<'_>, out: &mut Equations) -> Result<()> {
        for (pose, (&row, tip)) in batch.rows.iter().zip(batch.positions).enumerate() {
            let Touched { point, facet, .. } = &self.points[row];
            let distance = point.normal.dot(&(Vector3::from(*tip) - point.position));
            let radius = self.radius.at(row, pose, &batch, &point.normal);
            radius.write(distance - batch.own[*facet] - radius.value, &point.normal, out);
            out.own(*facet, -1.0);
        }
        Ok(())
    }

    fn contact_tip(&self, row: RowIndex, _: [f64; 3], own: &[f64], inputs: &[f64]) -> Result<Option<[f64; 3]>> {
        if !self.radius.is_constant(inputs) {
            return Ok(None);
        }
        let Touched { point, facet, .. } = &self.points[row];
        Ok(Some((point.position + (own[*facet] + inputs[0]) * point.normal).into()))
    }
}
