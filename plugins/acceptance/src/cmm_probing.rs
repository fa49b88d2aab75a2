//! Validator plugin `cmm-probing`: a sphere by one stylus and by several, in the manner of ISO 10360-5.

use abbe_core::{
    Context, Dataset, Error, EstimateSource, Findings, Quantity, Result, SettingsError, Validate, not_negative,
    positive,
};
use abbe_standards::probing::{Edition, Gauge, MultiStylus, ball, multi_stylus};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::common::{
    Acceptance, Judge, Key, Limits, Sheet, check_limits, copied_points, doubted, finite, lacks_most, names, run_name,
    undecided, unmeasured,
};

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
    /// Expanded uncertainty (k = 2) of every figure, from the form and the calibration of the sphere.
    #[serde(default)]
    expanded_uncertainty_um: Option<f64>,
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

const KEYS: [Key; 5] =
    [("PFTU_um", "P_FTU"), ("PSTU_um", "|P_STU|"), ("PFTM_um", "P_FTM"), ("PSTM_um", "|P_STM|"), ("PLTM_um", "P_LTM")];

fn build(settings: Probing, _: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    positive("diameter_mm", settings.diameter_mm)?;
    settings.expanded_uncertainty_um.map(|value| not_negative("expanded_uncertainty_um", value)).transpose()?;
    check_limits(&settings.limits, &names(&KEYS))?;
    Ok(Box::new(Judge(settings)))
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
    fn judge(&self, data: &Dataset, findings: &mut Findings) -> Result<()> {
        let (run, all) = (run_name(data), points(data)?);
        let [x, y, z] = ["x", "y", "z"].map(|axis| finite(data, axis, Quantity::Length));
        let columns = [x?, y?, z?];
        let same = unmeasured(&columns).map(|same| format!("{run}: {same}"));
        let doubted = same.or_else(|| doubted(&run, &columns));
        let copied = copied_points("stylus", &all);
        if doubted.is_none() {
            findings.remarks.extend(copied.iter().map(|copied| format!("{run}: {copied}")));
        }
        findings.remarks.extend(doubted);
        // Fewer points have less form: a sphere through four has none.
        let mut why = copied;
        for (label, points) in all.iter().filter(|(_, points)| points.len() != POINTS) {
            let text = format!("stylus {label} has {} points; the test has {POINTS}", points.len());
            findings.remarks.push(format!("{run}: {text}"));
            why.extend(Some(text).filter(|_| lacks_most(points.len(), POINTS)));
        }
        let broken = |error| Error::data(format!("{run}: {error}")).setting("from");
        let mut sheet = Sheet::new(&run, &self.limits);
        let uncertainty = self.expanded_uncertainty_um.map(|expanded| 0.5 * expanded);
        let edition = Edition::Iso10360Part5Of2010;
        if let Some((_, points)) = all.iter().find(|(label, _)| *label == self.single) {
            let probed = ball(points).map_err(broken)?;
            sheet.limit(edition.form(Gauge::Sphere), 1e3 * probed.form, uncertainty, "PFTU_um");
            let size = 1e3 * (2.0 * probed.radius - self.diameter_mm);
            sheet.limit_size(edition.size(Gauge::Sphere), size, uncertainty, "PSTU_um");
        } else {
            findings.remarks.push(format!("{run}: there is no stylus `{}`: P_FTU and P_STU are absent", self.single));
        }
        let others: Vec<Vec<[f64; 3]>> =
            all.iter().filter(|(label, _)| *label != self.single).map(|(_, points)| points.clone()).collect();
        if let Some(multi) = multi_stylus(&others).map_err(broken)? {
            let [form, size, location] = MultiStylus::SYMBOLS;
            sheet.limit(form, 1e3 * multi.all.form, uncertainty, "PFTM_um");
            sheet.limit_size(size, 1e3 * (2.0 * multi.all.radius - self.diameter_mm), uncertainty, "PSTM_um");
            sheet.limit(location, 1e3 * multi.largest_location(), uncertainty, "PLTM_um");
            for (axis, value) in ["x", "y", "z"].into_iter().zip(multi.location) {
                sheet.tell(&format!("{location} {axis}"), 1e3 * value, "um").detail = true;
            }
        } else {
            findings.remarks.push(format!("{run}: there are no two other styli: P_FTM, P_STM and P_LTM are absent"));
        }
        let mut figures = sheet.finish(&KEYS);
        undecided(&mut figures, &why);
        findings.figures.extend(figures);
        Ok(())
    }
}

impl Acceptance for Probing {
    fn findings(&self, data: &[&Dataset]) -> Result<Findings> {
        let mut findings = Findings::default();
        data.iter().try_for_each(|data| self.judge(data, &mut findings))?;
        findings.remarks.push(format!(
            "{}, in its manner: least squares spheres; P_LTM = largest range of the centres along an axis",
            Edition::Iso10360Part5Of2010.name()
        ));
        Ok(findings)
    }
}
