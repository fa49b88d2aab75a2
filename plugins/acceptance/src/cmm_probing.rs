//! Validator plugin `cmm-probing`: a sphere by one stylus and by several, in the manner of ISO 10360-5.

use abbe_core::{
    Context, Dataset, Error, EstimateSource, Figure, Findings, Fit, Quantity, Result, SettingsError, Validate, positive,
};
use abbe_standards::probing::{Edition, Gauge, MultiStylus, ball, multi_stylus};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::common::{Limits, check_limits, figure, finite, no_data, run_name};

abbe_core::register!(
    Validate,
    "cmm-probing",
    "a sphere by one stylus and by several, in the manner of ISO 10360-5: P_FTU, P_STU, P_FTM, P_STM, P_LTM",
    Probing,
    example,
    build,
    "../reference/validate-cmm-probing.md",
    EstimateSource::Readings,
);

/// Points of a stylus in this test.
const POINTS: usize = 25;

/// Settings of a probing test.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Probing {
    /// Calibrated diameter of the sphere.
    diameter_mm: f64,
    /// The stylus of the test with a single one; all others are those of the test with several.
    #[serde(default = "single")]
    single: String,
    /// Largest admissible sizes: `PFTU_um`, `PSTU_um`, `PFTM_um`, `PSTM_um`, `PLTM_um`.
    #[serde(default)]
    limits: Limits,
}

fn single() -> String {
    "0".to_owned()
}

fn example() -> Value {
    json!({ "diameter_mm": 24.99874, "limits": { "PFTU_um": 1.9, "PSTU_um": 1.9 } })
}

const KEYS: [&str; 5] = ["PFTU_um", "PSTU_um", "PFTM_um", "PSTM_um", "PLTM_um"];

fn build(settings: Probing, _: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    positive("diameter_mm", settings.diameter_mm)?;
    check_limits(&settings.limits, &KEYS)?;
    Ok(Box::new(settings))
}

/// A stylus and its points.
type OfStylus<'a> = (&'a str, Vec<[f64; 3]>);

/// The points of each stylus, in the order in which they appear.
fn points(data: &Dataset) -> Result<Vec<OfStylus<'_>>> {
    let labels = abbe_table::labels(data, "stylus")?;
    let [x, y, z] = ["x", "y", "z"].map(|axis| finite(data, axis, Quantity::Length));
    let (x, y, z) = (x?, y?, z?);
    let mut all: Vec<OfStylus<'_>> = Vec::new();
    for (row, label) in labels.iter().enumerate() {
        let point = [x[row], y[row], z[row]];
        match all.iter_mut().find(|(other, _)| other == label) {
            Some((_, points)) => points.push(point),
            None => all.push((label, vec![point])),
        }
    }
    Ok(all)
}

impl Probing {
    fn limited(&self, symbol: &str, run: &str, value: f64) -> Figure {
        let limit = self.limits.get(&format!("{}_um", symbol.replace('_', ""))).copied();
        let value = if limit.is_some() { value.abs() } else { value };
        figure(format!("{symbol}[{run}]"), 1e3 * value, "um").limited(limit)
    }

    fn judge(&self, data: &Dataset, findings: &mut Findings) -> Result<()> {
        let (run, all) = (run_name(data), points(data)?);
        for (label, points) in all.iter().filter(|(_, points)| points.len() != POINTS) {
            let text = format!("{run}: stylus {label} has {} points; the test has {POINTS}", points.len());
            findings.remarks.push(text);
        }
        let broken = |error| Error::data(format!("{run}: {error}")).setting("from");
        let edition = Edition::Iso10360Part5Of2010;
        if let Some((_, points)) = all.iter().find(|(label, _)| *label == self.single) {
            let probed = ball(points).map_err(broken)?;
            findings.figures.push(self.limited(edition.form(Gauge::Sphere), &run, probed.form));
            let size = 2.0 * probed.radius - self.diameter_mm;
            findings.figures.push(self.limited(edition.size(Gauge::Sphere), &run, size));
        } else {
            findings.remarks.push(format!("{run}: there is no stylus `{}`: P_FTU and P_STU are absent", self.single));
        }
        let others: Vec<Vec<[f64; 3]>> =
            all.iter().filter(|(label, _)| *label != self.single).map(|(_, points)| points.clone()).collect();
        if let Some(multi) = multi_stylus(&others).map_err(broken)? {
            let size = 2.0 * multi.all.radius - self.diameter_mm;
            let values = [multi.all.form, size, multi.largest_location()];
            for (symbol, value) in MultiStylus::SYMBOLS.into_iter().zip(values) {
                findings.figures.push(self.limited(symbol, &run, value));
            }
            for (axis, value) in ["x", "y", "z"].into_iter().zip(multi.location) {
                findings.figures.push(figure(format!("P_LTM {axis}[{run}]"), 1e3 * value, "um").detail());
            }
        } else if !others.is_empty() {
            findings
                .remarks
                .push(format!("{run}: one stylus beside the single one: P_FTM, P_STM and P_LTM are absent"));
        }
        // What a limit asks for was not measured: it fails.
        for key in self.limits.keys() {
            let symbol = key.trim_end_matches("_um").replacen('P', "P_", 1);
            if !findings.figures.iter().any(|figure| figure.name == format!("{symbol}[{run}]")) {
                findings.figures.push(self.limited(&symbol, &run, f64::NAN));
            }
        }
        Ok(())
    }
}

impl Validate for Probing {
    fn accepts_data(&self) -> bool {
        true
    }

    fn accepts_readings(&self) -> bool {
        true
    }

    fn validate(&self, _: &[&Fit], data: &[&Dataset]) -> Result<Findings> {
        if data.is_empty() {
            return Err(no_data());
        }
        let mut findings = Findings::default();
        data.iter().try_for_each(|data| self.judge(data, &mut findings))?;
        findings.remarks.push(format!(
            "{}, in its manner: least squares spheres; P_LTM = largest range of the centres along an axis",
            Edition::Iso10360Part5Of2010.name()
        ));
        Ok(findings)
    }
}
