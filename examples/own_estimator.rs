//! An estimator of one's own: Levenberg and Marquardt's iteration, as a plugin that recipes name. Rank, uncertainty, advice
//! and the file come from `abbe-estimation`.
//!
//!     cargo run --release -p abbe-examples --example own_estimator

use std::path::Path;

use abbe_core::{
    Build, Calibration, Constructor, Context, Error, Estimate, Identifiability, Plugin, Problem, Registry, Result,
    SettingsError, inventory,
};
use abbe_engine::prepare;
use abbe_estimation::{EstimatorSolution, Judgement, UncertaintyEvaluation, Weighted, confounded};
use abbe_numerics::LeastSquares;
use nalgebra::{DMatrix, DVector};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use abbe_bundle as _;

inventory::submit! {
    Plugin::built_in(
        "levenberg-marquardt",
        "least squares by the iteration of Levenberg and Marquardt",
        abbe_core::schema_of::<Settings>,
        || json!({ "damping": 1e-3 }),
        Build::Estimate(Constructor::Static(build)),
    )
}

/// Settings of the estimator.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// Damping of the first step, as a part of the squares of the columns.
    #[serde(default = "default_damping")]
    damping: f64,
}

fn default_damping() -> f64 {
    1e-3
}

fn build(settings: &Value, _: &Context) -> Result<Box<dyn Estimate>, SettingsError> {
    let Settings { damping } = abbe_core::from_settings(settings)?;
    abbe_core::positive("damping", damping)?;
    Ok(Box::new(LevenbergMarquardt { damping }))
}

struct LevenbergMarquardt {
    damping: f64,
}

/// Normal equations: information `A^T A`, its product `A^T e` with the residuals, and their square.
fn normal_equations(rows: &Weighted<'_>, x: &[f64]) -> Result<(DMatrix<f64>, DVector<f64>, f64)> {
    let count = x.len();
    let (mut information, mut right, mut cost) = (DMatrix::zeros(count, count), DVector::zeros(count), 0.0);
    rows.linearise(x, &mut |_, residuals, derivatives| {
        let block = DMatrix::from_row_slice(residuals.len(), count, derivatives);
        information.gemm_tr(1.0, &block, &block, 1.0);
        right.gemv_tr(1.0, &block, &DVector::from_column_slice(residuals), 1.0);
        cost += residuals.iter().map(|residual| residual * residual).sum::<f64>();
    })?;
    Ok((information, right, cost))
}

impl LevenbergMarquardt {
    const EVALUATION: UncertaintyEvaluation = UncertaintyEvaluation {
        rank_tolerance: 1e-10,
        trust_uncertainties: false,
        coverage_probability: 0.95,
        explained: true,
    };

    /// The iteration: a damped step is taken if it makes the residuals smaller, else it is damped more.
    fn solve(&self, problem: &Problem) -> Result<EstimatorSolution> {
        let rows = Weighted::new(problem)?;
        let (mut x, mut damping) = (problem.start(), self.damping);
        let (mut information, mut right, mut cost) = normal_equations(&rows, &x)?;
        for iteration in 1..=200 {
            let mut damped = information.clone();
            (0..x.len()).for_each(|k| damped[(k, k)] *= 1.0 + damping);
            let step = damped.cholesky().map(|root| -root.solve(&right));
            let step = step.ok_or_else(|| Error::data("the normal equations are singular"))?;
            // In standard uncertainties of all rows together.
            let size = (step.transpose() * &information * &step)[0].max(0.0).sqrt();
            let next: Vec<f64> = x.iter().zip(step.iter()).map(|(value, step)| value + step).collect();
            match normal_equations(&rows, &next) {
                Ok(better) if better.2 <= cost => {
                    (information, right, cost) = better;
                    (x, damping) = (next, damping * 0.1);
                    if size < 1e-9 * (1.0 + cost.sqrt()) {
                        return Ok(solved(x, iteration, size));
                    }
                }
                Err(error) if error.fatal => return Err(error),
                // At the minimum a step changes only rounding.
                _ if size < 1e-9 => return Ok(solved(x, iteration, size)),
                _ => damping = damping.max(1e-12) * 10.0,
            }
        }
        Err(Error::data("the iteration does not converge"))
    }
}

/// What the iteration found; rank, scatter and uncertainty follow from it.
fn solved(x: Vec<f64>, iterations: usize, last_step: f64) -> EstimatorSolution {
    EstimatorSolution { x, factor: None, robust: None, iterations, last_step: Some(last_step), gradient_cosine: None }
}

impl Estimate for LevenbergMarquardt {
    fn estimate(&self, problem: &Problem) -> Result<Calibration> {
        let found = self.identify(problem)?;
        if !self.accepts(&found)? {
            return Err(confounded(&found));
        }
        Self::EVALUATION.calibration(problem, self.solve(problem)?, None, None)
    }

    fn identify(&self, problem: &Problem) -> Result<Identifiability> {
        Self::EVALUATION.identify(problem, &Judgement::new(problem, None)?)
    }
}

/// Prints what it finds.
pub fn main() -> Result<()> {
    for (name, [ours, theirs], uncertainty) in compared()? {
        println!("{name}: {ours:e}, by gauss-newton {theirs:e}, standard uncertainty {uncertainty:.1e}");
    }
    Ok(())
}

/// The parameters of a recipe, estimated here and by `gauss-newton`, with their standard uncertainties.
pub fn compared() -> Result<Vec<(String, [f64; 2], f64)>> {
    let registry = Registry::built_in()?;
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("../pipelines");
    let text = std::fs::read_to_string(source.join("first-steps.yaml")).expect("the recipe is there");
    let mut recipe: Value = serde_yaml::from_str(&text).expect("the recipe is YAML");
    let stages = recipe["stages"].as_object_mut().expect("stages");
    for (stage, setting) in [("touches", "path"), ("table", "nominal")] {
        let path = stages[stage][setting].as_str().expect("a path");
        stages[stage][setting] = json!(source.join(path));
    }
    stages["fit"].as_object_mut().expect("settings").remove("robust");
    stages.insert("own".to_owned(), stages["fit"].clone());
    stages["own"]["estimate"] = json!("levenberg-marquardt");
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("recipe.yaml");
    std::fs::write(&file, recipe.to_string()).expect("it can be written");
    let outcome = prepare(&file, &registry)?.run(&abbe_core::Monitor::default())?;
    let of = |name: &str| outcome.fits.iter().find(|fit| fit.name == name).expect("an estimate");
    let (own, other) = (&of("own").calibration, &of("fit").calibration);
    let pairs = own.parameters.iter().zip(&other.parameters);
    let values = pairs.map(|(own, other)| (own.name.clone(), [own.value, other.value], own.standard_uncertainty));
    Ok(values.collect())
}
