//! Estimator plugin `ball-bar-closed-form`: circle and cone evaluation of ball bar tests of the rotary axes that carry the
//! table (Jiang & Cripps 2015, sections 3.3 and 3.4), and validator plugin `ball-bar-circles`: figures of the circles
//! themselves.
//!
//! In every test one rotary axis turns the pivot about the tool ball, which stands still. A test is reduced to three numbers:
//! the place of the axis relative to the tool ball, in two directions, and the size of the circle. All numbers depend
//! linearly on the errors, which a small linear system gives without iteration and without weights. The data of a test follow
//! from its equations and from the poses of the nominal machine. A test that does not suit the method is refused.

mod circles;
mod evaluation;
mod reduction;
mod sweep;
mod system;

use abbe_core::{Calibration, Context, Error, Estimate, Identifiability, Problem, Result, SettingsError};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use evaluation::Evaluated;
use system::System;

abbe_core::register!(
    Estimate,
    "ball-bar-closed-form",
    "circle and cone evaluation of ball bar tests of rotary axes, without iteration",
    Settings,
    example,
    build,
    "../reference/estimate-ball-bar-closed-form.md",
);

/// Settings of the closed form.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// How the circle of a test is found.
    #[serde(default)]
    evaluation: Evaluation,
    /// The column of labels that tells the tests apart; one axis moves in each.
    #[serde(default = "default_column")]
    tests: String,
    /// Take the stated standard uncertainties as they are, without the a-posteriori factor of the residuals.
    #[serde(default)]
    trust_uncertainties: bool,
}

/// How the circle of a test is found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Evaluation {
    /// As published: lengths are plotted along the nominal directions of the bar, and a circle is fitted to the plot. An offset o of
    /// the circle bends it by o²/R.
    PolarPlot,
    /// The squared length, which is the sum of a constant, a cosine and a sine of the angle.
    #[default]
    SquaredLength,
}

fn default_column() -> String {
    "test".to_owned()
}

fn example() -> Value {
    json!({ "evaluation": "polar-plot", "tests": "test" })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Estimate>, SettingsError> {
    Ok(Box::new(ClosedForm { settings }))
}

struct ClosedForm {
    settings: Settings,
}

/// Offsets above which an ovality appears in the polar plot that the machine does not have, mm (Zargarbashi & Mayer 2005; Jiang & Cripps
/// 2015, section 3.3).
const ECCENTRIC: f64 = 0.1;

impl ClosedForm {
    fn system(&self, problem: &Problem) -> Result<System> {
        if problem.unknowns.is_empty() {
            return Err(
                Error::usage("no parameters are chosen, so that there is nothing to estimate").setting("parameters")
            );
        }
        System::new(problem, &self.settings.tests)
    }

    fn solve(&self, system: &System) -> Result<(Evaluated, Vec<f64>)> {
        let lost = system.identifiability();
        if lost.rank < lost.unknowns {
            return Err(confounded(&lost));
        }
        let evaluated = Evaluated::new(&system.sweeps, self.settings.evaluation)?;
        let x = system.solve(&evaluated);
        Ok((evaluated, x))
    }
}

impl Estimate for ClosedForm {
    fn estimate(&self, problem: &Problem) -> Result<Calibration> {
        let system = self.system(problem)?;
        let (evaluated, x) = self.solve(&system)?;
        for (sweep, circle) in system.sweeps.iter().zip(&evaluated.circles) {
            let offset = circle.offset.norm();
            if offset > ECCENTRIC {
                tracing::warn!("{}: {}", problem.name, circles::eccentric(&sweep.name, offset));
            }
        }
        system.calibration(&x, self.settings.trust_uncertainties)
    }

    fn values(&self, problem: &Problem) -> Result<Vec<f64>> {
        self.solve(&self.system(problem)?).map(|(_, x)| x)
    }

    fn identify(&self, problem: &Problem) -> Result<Identifiability> {
        Ok(self.system(problem)?.identifiability())
    }
}

/// The error for tests that cannot determine what was chosen.
fn confounded(found: &Identifiability) -> Error {
    let lost: Vec<String> = found.null_space.iter().map(abbe_core::WeakDirection::advise).collect();
    let message = format!(
        "the circles of the tests determine {} of {} unknowns:\n- {}",
        found.rank,
        found.unknowns,
        lost.join("\n- ")
    );
    Error::data(message).help("leave what has no effect and one of each combination out of `parameters`, or add tests")
}

#[cfg(test)]
mod tests;
