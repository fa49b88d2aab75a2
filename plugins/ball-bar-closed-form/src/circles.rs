//! Validator `ball-bar-circles`: how far the circles of ball bar tests are off centre, how round they are, and what the polar plot
//! makes of them.

use abbe_core::{Context, Dataset, Figure, Findings, Fit, Limit, PathItem, Result, SettingsError, Validate, positive};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::evaluation::Evaluated;
use crate::reduction::Projection;
use crate::sweep::Sweep;
use crate::system::System;
use crate::{ECCENTRIC, Evaluation, default_column};

abbe_core::register!(
    Validate,
    "ball-bar-circles",
    "centre offsets and roundness of ball bar tests, and the error of their polar plots",
    Settings,
    example,
    build,
    "../reference/validate-ball-bar-circles.md",
);

/// Settings of the circles.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// The column of labels that tells the tests apart; one axis moves in each.
    #[serde(default = "default_column")]
    tests: String,
    /// Largest admissible values.
    #[serde(default)]
    limits: Limits,
}

/// Largest admissible values over all tests.
#[derive(Debug, Clone, PartialEq, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Limits {
    /// Limit of the offset of a circle from the tool ball.
    #[serde(default)]
    eccentricity_um: Option<Limit>,
    /// Limit of the range of the lengths about their circle.
    #[serde(default)]
    roundness_um: Option<Limit>,
    /// Limit of the shift of a centre by the polar plot.
    #[serde(default)]
    polar_plot_error_um: Option<Limit>,
}

fn example() -> Value {
    json!({ "tests": "test", "limits": { "eccentricity_um": 100 } })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    let limits = &settings.limits;
    for (name, limit) in [
        ("eccentricity_um", limits.eccentricity_um),
        ("roundness_um", limits.roundness_um),
        ("polar_plot_error_um", limits.polar_plot_error_um),
    ] {
        let under = |error: SettingsError| error.under([PathItem::Key("limits".to_owned())]);
        limit.map_or(Ok(0.0), |limit| positive(name, limit.value)).map_err(under)?;
    }
    Ok(Box::new(Circles { settings }))
}

struct Circles {
    settings: Settings,
}

/// What is told of an offset that bends the polar plot.
pub fn eccentric(test: &str, offset: f64) -> String {
    format!(
        "the circle of test `{test}` is {:.1} um off its centre: above {:.0} um the polar plot shows an ovality that the axis does not have; align the tool ball better, or do not use the polar plot",
        offset * 1e3,
        ECCENTRIC * 1e3
    )
}

impl Validate for Circles {
    fn validate(&self, fits: &[&Fit], _: &[&Dataset]) -> Result<Findings> {
        let mut findings = Findings::default();
        for fit in fits {
            self.judge(fit, &mut findings)?;
        }
        Ok(findings)
    }
}

impl Circles {
    fn judge(&self, fit: &Fit, findings: &mut Findings) -> Result<()> {
        let sweeps = System::new(&fit.problem, &self.settings.tests)?.sweeps;
        let squared = Evaluated::new(&sweeps, Evaluation::SquaredLength)?.circles;
        let plotted = Evaluated::new(&sweeps, Evaluation::PolarPlot)?.circles;
        let limits = &self.settings.limits;
        let columns: [(&str, Option<Limit>, Vec<f64>); 3] = [
            ("eccentricity", limits.eccentricity_um, squared.iter().map(|circle| circle.offset.norm()).collect()),
            ("roundness", limits.roundness_um, sweeps.iter().map(roundness).collect()),
            (
                "polar plot error",
                limits.polar_plot_error_um,
                squared.iter().zip(&plotted).map(|(one, other)| (one.offset - other.offset).norm()).collect(),
            ),
        ];
        for (name, limit, values) in &columns {
            let largest = values.iter().copied().fold(0.0, f64::max);
            findings.figures.push(Figure::new(&fit.name, *name, largest * 1e3, "um").limited(*limit));
        }
        for (name, _, values) in &columns {
            let tests = sweeps.iter().zip(values);
            findings
                .figures
                .extend(tests.map(|(sweep, value)| {
                    Figure::new(&fit.name, format!("{name}[{}]", sweep.name), value * 1e3, "um")
                }));
        }
        for (sweep, circle) in sweeps.iter().zip(&squared) {
            let offset = circle.offset.norm();
            if offset > ECCENTRIC {
                findings.remarks.push(format!("{}: {}", fit.name, eccentric(&sweep.name, offset)));
            }
        }
        Ok(())
    }
}

/// Range of the lengths of a test about the circle of their squares.
fn roundness(sweep: &Sweep) -> f64 {
    let found = Projection::new(&sweep.angles).of(sweep.measured.iter().map(|length| length * length));
    let deviations = sweep.angles.iter().zip(&sweep.measured).map(|(angle, length)| {
        let square = found[0] + found[1] * angle.cos() + found[2] * angle.sin();
        length - square.max(0.0).sqrt()
    });
    let (least, most) =
        deviations.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), value| (a.min(value), b.max(value)));
    most - least
}
