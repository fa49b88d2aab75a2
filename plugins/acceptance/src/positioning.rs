//! Validator `positioning`: accuracy and repeatability of axes after ISO 230-2:2014, and in the manner of VDI/DGQ 3441.

use std::fmt::Write as _;

use abbe_core::{
    Context, Dataset, EstimateSource, Figure, Findings, PathItem, Result, SettingsError, Validate, not_negative,
};
use abbe_standards::positioning::plan::{Axis, Fault, faults};
use abbe_standards::positioning::uncertainty::{Expanded, Linear, Rotary, Terms};
use abbe_standards::positioning::{Positioning, Vdi};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::common::{Acceptance, Judge, Limits, check_limits, doubted, figure, lacks_most, quieter_than, undecided};
use crate::targets::Readings;

abbe_core::register!(
    Validate,
    "positioning",
    "accuracy and repeatability of positioning of linear and rotary axes (ISO 230-2, VDI/DGQ 3441)",
    Settings,
    example,
    build,
    "../reference/validate-positioning.md",
    EstimateSource::Readings,
);

/// Settings of the figures of positioning.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// What is known of the measurement. Without it figures have no uncertainty.
    #[serde(default)]
    uncertainty: Option<Uncertainty>,
    /// Whether the figures in the manner of VDI/DGQ 3441 are told, too.
    #[serde(default)]
    vdi_dgq_3441: bool,
    /// Largest admissible values, each for all axes: `A_um`, `R_up_um`, `mean_B_urad`, ..
    #[serde(default)]
    limits: Limits,
}

/// What is known of the measurement. Ranges are full widths; what is left out counts as zero.
#[derive(Debug, Clone, Copy, Default, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
#[allow(non_snake_case, reason = "units and symbols are written as in columns")]
pub struct Uncertainty {
    /// Expanded uncertainty (k = 2) of the device, which grows with length.
    device_U_um_per_m: f64,
    /// Lateral misalignment of the beam over the whole travel.
    misalignment_mm: f64,
    /// Coefficient of expansion of the machine.
    #[schemars(range(min = 0, max = 1000))]
    alpha_um_per_m_K: f64,
    /// Range of the temperature.
    #[schemars(range(min = 0, max = 200))]
    temperature_range_K: f64,
    /// Range of the coefficient of expansion.
    #[schemars(range(min = 0, max = 1000))]
    alpha_range_um_per_m_K: f64,
    /// How far the temperature is from 20 °C.
    #[schemars(range(min = -100, max = 100))]
    offset_from_20_K: f64,
    /// Range of the drift between two readings, E_VE.
    eve_range_um: f64,
    /// Of rotary axes.
    rotary: RotaryUncertainty,
}

/// What is known of the measurement of a rotary axis.
#[derive(Debug, Clone, Copy, Default, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
#[allow(non_snake_case, reason = "units and symbols are written as in columns")]
pub struct RotaryUncertainty {
    /// Expanded uncertainty (k = 2) of the device.
    device_U_urad: f64,
    /// Range of the drift between two readings, E_VE.
    eve_range_urad: f64,
}

impl Uncertainty {
    /// Refuses what is no range.
    pub fn check(&self) -> Result<(), SettingsError> {
        not_negative("device_U_um_per_m", self.device_U_um_per_m)?;
        not_negative("misalignment_mm", self.misalignment_mm)?;
        not_negative("alpha_um_per_m_K", self.alpha_um_per_m_K)?;
        not_negative("temperature_range_K", self.temperature_range_K)?;
        not_negative("alpha_range_um_per_m_K", self.alpha_range_um_per_m_K)?;
        not_negative("eve_range_um", self.eve_range_um)?;
        if !self.offset_from_20_K.is_finite() {
            return Err(SettingsError::new("offset_from_20_K", "a finite number was expected"));
        }
        let under = |error: SettingsError| error.under([PathItem::Key("rotary".to_owned())]);
        not_negative("device_U_urad", self.rotary.device_U_urad).map_err(under)?;
        not_negative("eve_range_urad", self.rotary.eve_range_urad).map_err(under)?;
        Ok(())
    }

    /// A remark on readings that range over less than the drift that is stated: they are in another unit.
    pub fn quiet(&self, readings: &Readings) -> Option<String> {
        let drift = match readings.axis {
            Axis::Linear => self.eve_range_um,
            Axis::Rotary => self.rotary.eve_range_urad,
        };
        quieter_than(&readings.name, &readings.in_order, (drift, "is the range of the drift alone"), readings.unit)
    }

    /// The contributions to the readings of an axis.
    pub fn terms(&self, readings: &Readings) -> Option<Terms> {
        match readings.axis {
            Axis::Linear => Linear {
                device: self.device_U_um_per_m,
                misalignment: self.misalignment_mm,
                expansion: self.alpha_um_per_m_K,
                temperature_range: self.temperature_range_K,
                expansion_range: self.alpha_range_um_per_m_K,
                offset: self.offset_from_20_K,
                drift_range: self.eve_range_um,
            }
            .terms(readings.travel()),
            Axis::Rotary => {
                Some(Rotary { device: self.rotary.device_U_urad, drift_range: self.rotary.eve_range_urad }.terms())
            }
        }
    }
}

/// Names of figures: symbols of ISO 230-2.
const NAMES: [&str; 12] = ["A", "A up", "A down", "E", "E up", "E down", "M", "R", "R up", "R down", "B", "mean B"];
/// The one that has a sign.
const SIGNED: &str = "mean B";
/// A figure in the manner of VDI/DGQ 3441.
type OfVdi = fn(&Vdi) -> f64;
/// Those in the manner of VDI/DGQ 3441.
const VDI: [(&str, OfVdi); 6] = [
    ("VDI P", |vdi| vdi.uncertainty),
    ("VDI Pa", |vdi| vdi.deviation),
    ("VDI Ps", |vdi| vdi.largest_spread),
    ("VDI mean Ps", |vdi| vdi.mean_spread),
    ("VDI U", |vdi| vdi.largest_reversal),
    ("VDI mean U", |vdi| vdi.mean_reversal),
];

fn key(name: &str, unit: &str) -> String {
    format!("{}_{unit}", name.split('[').next().unwrap_or(name).trim_matches('|').replace(' ', "_"))
}

fn example() -> Value {
    json!({
        "uncertainty": { "device_U_um_per_m": 0.8, "misalignment_mm": 1.0, "eve_range_um": 1.2 },
        "limits": { "A_um": 20, "B_um": 5 },
    })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    let under = |key: &'static str| move |error: SettingsError| error.under([PathItem::Key(key.to_owned())]);
    settings.uncertainty.iter().try_for_each(Uncertainty::check).map_err(under("uncertainty"))?;
    let vdi = VDI.iter().map(|(name, _)| *name).filter(|_| settings.vdi_dgq_3441);
    let keys: Vec<String> =
        NAMES.into_iter().chain(vdi).flat_map(|name| ["um", "urad"].map(|unit| key(name, unit))).collect();
    check_limits(&settings.limits, &keys.iter().map(String::as_str).collect::<Vec<_>>())?;
    Ok(Box::new(Judge(settings)))
}

impl Acceptance for Settings {
    fn findings(&self, data: &[&Dataset]) -> Result<Findings> {
        let mut findings = Findings::default();
        findings.remarks.push(
            "after ISO 230-2:2014 as in general use (its text was not at hand): s with n - 1, A and R of 2 s; U(E), U(M) and U(B) \
             from rectangular ranges with k = 2, U(R) and U(A) are a choice of this project"
                .to_owned(),
        );
        if self.vdi_dgq_3441 {
            findings.remarks.push(
                "VDI figures are in the manner of VDI/DGQ 3441, whose text was not at hand: their definitions are a choice"
                    .to_owned(),
            );
        }
        for data in data {
            let readings = Readings::of(data)?;
            let copied = doubted(&readings.name, &[&readings.in_order]);
            let faults = readings.faults(copied.is_some());
            findings.remarks.extend(copied);
            findings.remarks.extend(faults.iter().map(|fault| format!("{}: {fault}", readings.name)));
            findings.remarks.extend(self.uncertainty.and_then(|stated| stated.quiet(&readings)));
            let first = findings.figures.len();
            let lacking = self.judge(&readings, &mut findings);
            let why: Vec<String> = faults.into_iter().chain(lacking).collect();
            undecided(&mut findings.figures[first..], &why);
        }
        self.absent(&mut findings.figures);
        Ok(findings)
    }
}

impl Settings {
    /// Judges the readings of an axis; gives what the plan lacks where that is most of it.
    fn judge(&self, readings: &Readings, findings: &mut Findings) -> Option<String> {
        let found = Positioning::of(&readings.targets);
        let terms = self.uncertainty.and_then(|stated| stated.terms(readings));
        let expanded = terms.and_then(|terms| terms.expanded(readings.runs()));
        for (name, value, uncertainty) in values(&found, expanded.as_ref()) {
            self.tell(name, value, uncertainty.map(|expanded| 0.5 * expanded), readings, findings);
        }
        if self.vdi_dgq_3441 {
            let vdi = found.vdi();
            for (name, value) in VDI {
                self.tell(name, vdi.as_ref().map(value), None, readings, findings);
            }
        }
        if let Some(terms) = terms {
            findings.remarks.push(budget(readings, &terms));
        }
        let told = |fault: &Fault| format!("{}: {}", readings.name, words(fault, readings.axis));
        let (absent, others): (Vec<Fault>, Vec<Fault>) =
            faults(readings.axis, &readings.targets).into_iter().partition(leaves_figures_out);
        // Why there are no figures stands first: a summary has room for a few remarks.
        findings.remarks.splice(0..0, absent.iter().map(told));
        findings.remarks.extend(others.iter().map(told));
        findings.tables.insert(format!("positioning-{}.csv", readings.name), table(&found, readings));
        absent.iter().find(|fault| lacks_targets(fault)).map(|fault| words(fault, readings.axis))
    }

    /// Adds a figure. What a plan cannot give is absent, not zero; with a limit it is told without a value, which fails.
    fn tell(&self, name: &str, value: Option<f64>, u: Option<f64>, readings: &Readings, findings: &mut Findings) {
        let limit = self.limits.get(&key(name, readings.unit)).copied();
        let of = |name: &str, value: Option<f64>| {
            figure(format!("{name}[{}]", readings.name), value.unwrap_or(f64::NAN), readings.unit).uncertain(u)
        };
        // A limit of what has a sign is one of its size.
        let has_sign = name == SIGNED;
        if has_sign && let Some(value) = value {
            findings.figures.push(of(name, Some(value)));
        }
        match limit {
            Some(_) if has_sign => {
                findings.figures.push(of(&format!("|{name}|"), value.map(f64::abs)).limited(limit));
            }
            None if value.is_none() || has_sign => {}
            _ => findings.figures.push(of(name, value).limited(limit)),
        }
    }

    /// A limit in a unit that none of the axes has fails: what it asks for was not measured.
    fn absent(&self, figures: &mut Vec<Figure>) {
        for (limited, limit) in &self.limits {
            if !figures.iter().any(|figure| key(&figure.name, &figure.unit) == *limited) {
                let (name, unit) = limited.rsplit_once('_').unwrap_or((limited, "um"));
                figures.push(figure(name.replace('_', " "), f64::NAN, unit).limited(*limit));
            }
        }
    }
}

/// The figures by name, with their expanded uncertainties.
pub fn values<'a>(
    found: &Positioning,
    expanded: Option<&Expanded>,
) -> impl Iterator<Item = (&'a str, Option<f64>, Option<f64>)> {
    let systematic = expanded.map(|all| all.systematic);
    let accuracy = expanded.and_then(|all| all.accuracy);
    let repeatability = expanded.and_then(|all| all.repeatability);
    let reversal = expanded.map(|all| all.reversal);
    let all = [
        (found.accuracy, accuracy),
        (found.accuracy_up, accuracy),
        (found.accuracy_down, accuracy),
        (found.systematic, systematic),
        (found.systematic_up, systematic),
        (found.systematic_down, systematic),
        (found.mean_deviation, expanded.map(|all| all.mean_deviation)),
        (found.repeatability, repeatability),
        (found.repeatability_up, repeatability),
        (found.repeatability_down, repeatability),
        (found.reversal, reversal),
        (found.mean_reversal, reversal),
    ];
    NAMES.into_iter().zip(all).map(|(name, (value, uncertainty))| (name, value, uncertainty))
}

/// The contributions in one sentence.
fn budget(readings: &Readings, terms: &Terms) -> String {
    let all = [
        ("device", terms.device),
        ("misalignment", terms.misalignment),
        ("temperature", terms.temperature),
        ("expansion", terms.expansion),
        ("drift of a reading", terms.drift),
    ];
    let told = all.iter().filter(|(_, u)| *u > 0.0).map(|(what, u)| format!("{what} {u:.3}")).collect::<Vec<_>>();
    format!("{}: standard uncertainties, {}: {}", readings.name, readings.unit, told.join(", "))
}

/// Whether figures are absent because of it, or decide nothing.
fn leaves_figures_out(fault: &Fault) -> bool {
    matches!(fault, Fault::MissingRuns(_) | Fault::TooFewRuns { .. } | Fault::OneDirection) || lacks_targets(fault)
}

/// Fewest targets that tell more of a travel than its ends.
const FEWEST_TARGETS: usize = 3;

/// Whether most of the targets are missing.
fn lacks_targets(fault: &Fault) -> bool {
    matches!(fault, Fault::TooFewTargets { found, needed } if *found < FEWEST_TARGETS || lacks_most(*found, *needed))
}

/// A sentence on what a plan lacks.
pub fn words(fault: &Fault, axis: Axis) -> String {
    let unit = if axis == Axis::Linear { "mm" } else { "deg" };
    match fault {
        Fault::TooFewTargets { found, needed } => {
            format!("{found} targets are too few for this travel: ISO 230-2 asks for {needed}")
        }
        Fault::TooFewRuns { found, needed } => {
            format!(
                "{found} runs in a direction: ISO 230-2 asks for {needed}; repeatability and accuracy are less certain or absent"
            )
        }
        Fault::OneDirection => {
            "only one direction was measured: there is no reversal and no bidirectional figure".to_owned()
        }
        Fault::MissingRuns(positions) => {
            let all: Vec<String> = positions.iter().map(|position| format!("{:.3}", position + 0.0)).collect();
            format!(
                "readings are missing at {} {unit}: figures that need them are absent or rest on fewer",
                all.join(", ")
            )
        }
        Fault::Equidistant(step) => format!(
            "all targets stand {step:.3} {unit} apart: an error that repeats with that distance or a part of it (the pitch of a \
             screw or scale) does not show; move each by a random part of the step"
        ),
    }
}

/// The table of targets that reports of the standard have.
fn table(found: &Positioning, readings: &Readings) -> String {
    let unit = readings.unit;
    let position = if readings.axis == Axis::Linear { "mm" } else { "deg" };
    let columns = ["mean_up", "mean_down", "mean", "B", "s_up", "s_down", "R_up", "R_down", "R"];
    let mut text = format!("target,position_{position},runs_up,runs_down");
    columns.iter().for_each(|column| write!(text, ",{column}_{unit}").unwrap_or_default());
    text.push('\n');
    for (number, (at, target)) in found.targets.iter().zip(&readings.targets).enumerate() {
        let _ = write!(text, "{},{:.4},{},{}", number + 1, at.position + 0.0, target.up.len(), target.down.len());
        let values = [
            at.mean_up,
            at.mean_down,
            at.mean,
            at.reversal,
            at.s_up,
            at.s_down,
            at.repeatability_up,
            at.repeatability_down,
            at.repeatability,
        ];
        for value in values {
            let cell = value.map_or(String::new(), |value| format!("{:.4}", value + 0.0));
            let _ = write!(text, ",{cell}");
        }
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Temperatures and coefficients that no workshop and no material has are refused by the schema, with their key.
    #[test]
    fn what_no_workshop_has_is_refused() {
        let told = |key: &str, value: f64| {
            let settings = json!({ "uncertainty": { key: value } });
            abbe_core::from_settings_in_range::<Settings>(&settings).err().map(|error| error.message)
        };
        for (key, most) in [("offset_from_20_K", 100.0), ("temperature_range_K", 200.0)] {
            assert_eq!(told(key, most), None, "{key}");
            assert!(told(key, 2000.0).is_some(), "{key}");
        }
        for key in ["alpha_um_per_m_K", "alpha_range_um_per_m_K"] {
            assert_eq!(told(key, 24.0), None, "{key}");
            assert!(told(key, 1e4).is_some(), "{key}");
        }
        assert!(told("offset_from_20_K", -2000.0).is_some());
    }
}
