//! Artefact plugin `rings`: the inside of rings, touched with the machine's probe.
//!
//! Equation: `R - r - |w| = 0` with the part w of p - P - c across the axis of the ring. p is the tip and P the nominal point on the
//! axis in the table frame, c the ring's own offset across its axis, R its radius, r the effective stylus radius.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use abbe_core::{
    AboveZero, Artefact, ColumnHeader, Contact, Context, DataRow, Dataset, Equations, Feature, InputFile,
    KinematicModel, Layout, Observations, ObservationsInfo, Quantity, Result, RowBatch, RowIndex, SettingsError,
    Target, not_negative, plain_naming, pose_columns, positive,
};
use abbe_dcc::CertifiedLength;
use abbe_probe::EffectiveRadius;
use nalgebra::{Matrix3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::size::{self, CertifiedDiameter, Diameter, Quantities, Size, sizes};

abbe_core::register!(
    Artefact,
    "rings",
    "touches on the inside of rings: a ring gauge, a bore",
    Settings,
    example,
    build,
    "../reference/artefact-rings.md",
);

/// Settings of the rings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// CSV file of the nominal rings: feature, x_mm, y_mm, z_mm of a point on the axis, ax, ay, az of the axis, diameter_mm, in the
    /// table frame.
    nominal: String,
    /// Standard uncertainty of one touch.
    #[schemars(with = "AboveZero")]
    standard_uncertainty_um: f64,
    /// Diameters that are estimated (`ring[1].diameter`) or stated by a certificate with uncertainty.
    #[serde(default)]
    diameters: Vec<Diameter>,
    /// Standard uncertainty of the effective stylus radius, shared by all touches.
    #[serde(default)]
    stylus_radius_standard_uncertainty_um: f64,
}

fn example() -> Value {
    json!({
        "nominal": "rings.csv",
        "standard_uncertainty_um": 0.5,
        "diameters": [{ "feature": 32, "standard_uncertainty_um": 0.1 }],
    })
}

fn build(mut settings: Settings, context: &Context) -> Result<Box<dyn Artefact>, SettingsError> {
    positive("standard_uncertainty_um", settings.standard_uncertainty_um)?;
    not_negative("stylus_radius_standard_uncertainty_um", settings.stylus_radius_standard_uncertainty_um)?;
    size::check(&mut settings.diameters, context)?;
    Ok(Box::new(Rings { nominal: context.path(&settings.nominal), settings }))
}

struct Rings {
    nominal: PathBuf,
    settings: Settings,
}

/// Cosine of the angle to the table's x from which an axis counts as along it: the ring's own x is the table's y then.
const ALONG_X: f64 = 0.9;

/// A nominal ring, table frame.
#[derive(Debug, Clone, PartialEq)]
struct Ring {
    label: String,
    point: Vector3<f64>,
    axis: Vector3<f64>,
    /// Unit directions across the axis, in which the ring may be off: the table's x (y for an axis along x) made perpendicular to the
    /// axis, and the direction that completes axis and x to a right-handed frame.
    across: [Vector3<f64>; 2],
    diameter: f64,
}

impl Ring {
    fn new(label: String, point: Vector3<f64>, axis: Vector3<f64>, diameter: f64) -> Self {
        let first = if axis.x.abs() > ALONG_X { Vector3::y() } else { Vector3::x() };
        let first = (first - first.dot(&axis) * axis).normalize();
        Self { label, point, axis, across: [first, axis.cross(&first)], diameter }
    }

    /// The part of a vector across the axis.
    fn across_part(&self, vector: Vector3<f64>) -> Vector3<f64> {
        vector - vector.dot(&self.axis) * self.axis
    }
}

impl Rings {
    fn read_nominal(&self) -> Result<Vec<Ring>> {
        let table = abbe_table::read(&self.nominal)?;
        abbe_table::unique_labels(&table, "feature")?;
        let labels = abbe_table::labels(&table, "feature")?;
        let points = abbe_table::points(&table, ["x", "y", "z"])?;
        let axes = abbe_table::vectors(&table, ["ax", "ay", "az"])?;
        let diameters = abbe_table::numbers(&table, "diameter", Quantity::Length)?;
        let rows = DataRow::enumerate(labels.iter().zip(points).zip(axes.into_iter().zip(diameters)));
        rows.map(|(row, ((label, point), (axis, &diameter)))| {
            let axis = Vector3::from(axis);
            if (axis.norm() - 1.0).abs() > 1e-2 {
                let message = format!("the axis of ring {label} has length {:.4}; 1 was expected", axis.norm());
                return Err(table.error_at(row, message).help("ax, ay, az are a unit vector along the axis"));
            }
            if diameter <= 0.0 {
                return Err(table.error_at(row, format!("ring {label} has the diameter {diameter} mm")));
            }
            Ok(Ring::new(label.to_string(), Vector3::from(point), axis.normalize(), diameter))
        })
        .collect()
    }
}

impl Rings {
    /// The nominal rings, if a stylus of this radius goes into all of them.
    fn read_nominal_of(&self, stylus_radius: f64) -> Result<Vec<Ring>> {
        let rings = self.read_nominal()?;
        let narrow = rings.iter().position(|ring| ring.diameter <= 2.0 * stylus_radius);
        let Some(row) = narrow else { return Ok(rings) };
        let table = abbe_table::read(&self.nominal)?;
        let message = format!(
            "ring {} has the diameter {} mm, and the ball of the stylus {} mm: it does not go in",
            rings[row].label,
            rings[row].diameter,
            2.0 * stylus_radius
        );
        let help = "is `diameter_mm` a radius, and is `stylus_radius_mm` of the model right?";
        Err(table.error_at(DataRow(row), message).help(help))
    }
}

impl Rings {
    /// The certificates of diameters.
    fn certificates(&self) -> impl Iterator<Item = &CertifiedLength> {
        self.settings.diameters.iter().filter_map(|diameter| diameter.certificate.as_ref())
    }
}

impl Artefact for Rings {
    fn inputs(&self) -> Vec<InputFile> {
        let nominal = InputFile { setting: "nominal", path: self.nominal.clone() };
        [nominal].into_iter().chain(self.certificates().map(CertifiedLength::input)).collect()
    }

    fn check(&self, headers: &[ColumnHeader], file: Option<&PathBuf>, model: &dyn KinematicModel) -> Result<()> {
        pose_columns(headers, file, model, &plain_naming)?;
        self.certificates().try_for_each(CertifiedLength::tell)?;
        abbe_probe::check_columns(headers, file, model)?;
        abbe_table::require(headers, file, &[("feature", Quantity::Label)])?;
        let nominal = abbe_table::read_headers(&self.nominal)?;
        let columns = [
            ("feature", Quantity::Label),
            ("x", Quantity::Length),
            ("y", Quantity::Length),
            ("z", Quantity::Length),
            ("ax", Quantity::Ratio),
            ("ay", Quantity::Ratio),
            ("az", Quantity::Ratio),
            ("diameter", Quantity::Length),
        ];
        abbe_table::require(&nominal, Some(&self.nominal), &columns)
    }

    fn observe(&self, data: &Arc<Dataset>, model: &Arc<dyn KinematicModel>) -> Result<Arc<dyn Observations>> {
        let model = model.as_ref();
        let nominal = self.read_nominal_of(model.info().stylus_radius)?;
        let by_label: BTreeMap<&str, usize> =
            nominal.iter().enumerate().map(|(index, ring)| (ring.label.as_str(), index)).collect();
        let labels = abbe_table::labels(data, "feature")?.iter();
        let of_rows: Vec<Option<usize>> = labels.map(|label| by_label.get(label.as_str()).copied()).collect();
        let touched = abbe_table::touched(&of_rows, &self.nominal)?;
        let mut layout = Layout::new(data, model, &[&plain_naming])?;
        for (row, _) in &touched.rows {
            layout.push(model, *row, &[self.settings.standard_uncertainty_um * 1e-3])?;
        }
        let rings: Vec<Ring> = touched.features.iter().map(|&ring| nominal[ring].clone()).collect();
        let uncertainty = self.settings.stylus_radius_standard_uncertainty_um * 1e-3;
        let radius = EffectiveRadius::new(model, &layout, uncertainty)?;
        let mut quantities = Quantities { inputs: radius.inputs().to_vec(), ..Quantities::default() };
        let mut features = Vec::new();
        for ring in &rings {
            let shifts = ["x", "y"].iter().zip(ring.across).map(|(own, direction)| {
                (quantities.unknown(format!("ring[{}].{own}", ring.label), 0.0), direction.into())
            });
            features.push(Feature { label: ring.label.clone(), point: ring.point.into(), shifts: shifts.collect() });
        }
        let labels: Vec<(&str, f64)> = rings.iter().map(|ring| (ring.label.as_str(), ring.diameter)).collect();
        let (sizes, diameters) = sizes(&self.settings.diameters, "ring", &labels, &mut quantities, &mut layout)?;
        let Quantities { unknowns, start, inputs } = quantities;
        let orientation = radius.orientation();
        let info = ObservationsInfo {
            start,
            inputs,
            features,
            orientation,
            ..ObservationsInfo::new(layout, unknowns, Contact::LinearAxes)
        };
        let ring_of_row = touched.rows.iter().map(|(_, ring)| *ring).collect();
        Ok(Arc::new(Touches { info, rings, sizes, ring_of_row, diameters, radius }))
    }

    fn targets(&self, stylus_radius: f64) -> Result<Vec<Target>> {
        // Eight touches around at the nominal point.
        let mut targets = Vec::new();
        for ring in self.read_nominal()? {
            for step in 0..8 {
                let (sine, cosine) = (f64::from(step) * std::f64::consts::FRAC_PI_4).sin_cos();
                let outwards = cosine * ring.across[0] + sine * ring.across[1];
                targets.push(Target {
                    feature: ring.label.clone(),
                    tip: (ring.point + (ring.diameter / 2.0 - stylus_radius) * outwards).into(),
                    approach: Some(outwards.into()),
                });
            }
        }
        Ok(targets)
    }
}

/// Touches on the inside of rings.
struct Touches {
    info: ObservationsInfo,
    rings: Vec<Ring>,
    sizes: Vec<Size>,
    ring_of_row: Vec<usize>,
    diameters: Vec<CertifiedDiameter>,
    radius: EffectiveRadius,
}

impl Touches {
    /// A point of the axis of a ring.
    fn centre(&self, ring: usize, own: &[f64]) -> Vector3<f64> {
        let Ring { point, across, .. } = &self.rings[ring];
        point + own[2 * ring] * across[0] + own[2 * ring + 1] * across[1]
    }
}

impl Observations for Touches {
    fn info(&self) -> &ObservationsInfo {
        &self.info
    }

    fn evaluate(&self, batch: RowBatch<'_>, out: &mut Equations) -> Result<()> {
        let mut pose = 0;
        for &row in batch.rows {
            let Some(&index) = self.ring_of_row.get(row.0) else {
                self.diameters[row.0 - self.ring_of_row.len()].write(batch.own, batch.inputs, out);
                continue;
            };
            let ring = &self.rings[index];
            let from_axis = ring.across_part(Vector3::from(batch.positions[pose]) - self.centre(index, batch.own));
            let (distance, outwards) = (from_axis.norm(), from_axis.normalize());
            // Out of the material is towards the axis.
            let normal = -outwards;
            let along = ring.axis * ring.axis.transpose();
            let turning = -(Matrix3::identity() - along - outwards * outwards.transpose()) / distance;
            let (size, radius) = (self.sizes[index], self.radius.at(row, pose, &batch, &normal));
            let by_tip = normal - turning * radius.by_normal;
            radius.write(size.radius(batch.own, batch.inputs) - radius.value - distance, &by_tip, out);
            for (own, direction) in ring.across.iter().enumerate() {
                out.own(2 * index + own, -by_tip.dot(direction));
            }
            size.write(1.0, out);
            pose += 1;
        }
        Ok(())
    }

    fn contact_tip(
        &self,
        RowIndex(row): RowIndex,
        tip: [f64; 3],
        own: &[f64],
        inputs: &[f64],
    ) -> Result<Option<[f64; 3]>> {
        let Some(&index) = self.ring_of_row.get(row) else { return Ok(None) };
        if !self.radius.is_constant(inputs) {
            return Ok(None);
        }
        let (ring, centre) = (&self.rings[index], self.centre(index, own));
        let from_centre = Vector3::from(tip) - centre;
        let Some(outwards) = ring.across_part(from_centre).try_normalize(0.0) else { return Ok(None) };
        let along = from_centre.dot(&ring.axis) * ring.axis;
        Ok(Some((centre + along + (self.sizes[index].radius(own, inputs) - inputs[0]) * outwards).into()))
    }
}
