//! Estimator plugin `gauss-newton`: weighted least squares on all observations at once, robust on request.
//!
//! Every equation counts with 1/u of its standard uncertainty. What the data can determine is judged at the contact points
//! of the start values, before anything is solved, and again at the solution; a direction that they cannot determine is an
//! error, unless `on_confounded` says what to do with it.

use abbe_core::{
    Build, CALIBRATION_FORMAT, Calibration, Combination, Constructor, Context, Covariance, Error, Estimate, Estimated,
    FitReport, Identifiability, NullVector, Outlier, Owner, Plugin, Problem, Result, SettingsError, Status,
    Termination, Unknown, inventory,
};
use abbe_numerics::{Accumulator, End, Factor, LeastSquares, Loss, Options, Robust, RobustReport, Spectrum, solve};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

inventory::submit! {
    Plugin::built_in(
        "gauss-newton",
        "weighted least squares on all observations at once, robust on request",
        abbe_core::schema_of::<Settings>,
        example,
        Build::Estimate(Constructor::Static(build)),
    )
}

/// Settings of the estimator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// What to do when the data cannot separate the chosen parameters.
    #[serde(default)]
    on_confounded: OnConfounded,
    /// Singular values below this part of the largest count as zero; columns have norm 1.
    #[serde(default = "default_tolerance")]
    rank_tolerance: f64,
    /// Weights that keep gross errors from the estimate.
    #[serde(default)]
    robust: Option<RobustSetting>,
    /// Take the stated standard uncertainties as they are, without the a-posteriori factor of the residuals.
    #[serde(default)]
    trust_uncertainties: bool,
    /// Most iterations.
    #[serde(default = "default_iterations")]
    iterations: usize,
}

fn default_tolerance() -> f64 {
    // Contact is solved to 1e-11 mm in 1e2 mm: what is lost shows at 1e-14, the weakest that one can use at 1e-7.
    1e-10
}

fn default_iterations() -> usize {
    50
}

/// What to do with confounded parameters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum OnConfounded {
    /// Stop and name them.
    #[default]
    Error,
    /// Leave as many at their start values as are lost, and mark them.
    Drop,
    /// Take the solution with the smallest effect of the unknowns, and mark those that take part.
    MinimumNorm,
}

/// Robust weights: the name of a loss, or a loss with its tuning.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[serde(untagged)]
enum RobustSetting {
    /// A loss with 95 % efficiency on normal noise.
    Name(LossName),
    /// A loss with its tuning.
    Tuned(Tuned),
}

/// A loss with its tuning.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Tuned {
    /// The loss.
    loss: LossName,
    /// Cutoff in units of the residuals' scale.
    #[serde(default)]
    cutoff: Option<f64>,
    /// Studentised residual from which a row is listed as an outlier.
    #[serde(default)]
    outlier_at: Option<f64>,
}

/// The losses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum LossName {
    /// Large residuals keep a bounded influence.
    Huber,
    /// Large residuals have none.
    Tukey,
}

impl<'de> Deserialize<'de> for RobustSetting {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        // Told apart here, because an untagged enum could not say what is wrong in either form.
        match Value::deserialize(deserializer)? {
            map @ Value::Object(_) => abbe_core::from_settings(&map).map(Self::Tuned),
            other => abbe_core::from_settings(&other).map(Self::Name),
        }
        .map_err(serde::de::Error::custom)
    }
}

impl RobustSetting {
    fn robust(&self) -> Robust {
        let (loss, cutoff, outlier_at) = match self {
            Self::Name(loss) => (*loss, None, None),
            Self::Tuned(tuned) => (tuned.loss, tuned.cutoff, tuned.outlier_at),
        };
        let usual = match loss {
            LossName::Huber => Robust::HUBER,
            LossName::Tukey => Robust::TUKEY,
        };
        Robust {
            loss: if loss == LossName::Huber { Loss::Huber } else { Loss::Tukey },
            cutoff: cutoff.unwrap_or(usual.cutoff),
            outlier_at: outlier_at.unwrap_or(usual.outlier_at),
        }
    }
}

fn example() -> Value {
    json!({ "robust": "tukey", "on_confounded": "error" })
}

fn build(settings: &Value, _: &Context) -> Result<Box<dyn Estimate>, SettingsError> {
    let settings: Settings = abbe_core::from_settings(settings)?;
    if !(settings.rank_tolerance > 0.0 && settings.rank_tolerance < 1.0) {
        return Err(SettingsError::new("rank_tolerance", "a number between 0 and 1 was expected"));
    }
    if settings.iterations == 0 {
        return Err(SettingsError::new("iterations", "at least one iteration is needed"));
    }
    if let Some(robust) = settings.robust.as_ref().map(RobustSetting::robust)
        && !(robust.cutoff > 0.0 && robust.outlier_at > 0.0)
    {
        return Err(SettingsError::new("robust", "cutoff and outlier_at have to be positive"));
    }
    Ok(Box::new(GaussNewton { settings }))
}

/// The estimator.
struct GaussNewton {
    settings: Settings,
}

/// A problem in residuals over their standard uncertainties.
struct Weighted<'a> {
    problem: &'a Problem,
    uncertainties: Vec<f64>,
}

impl<'a> Weighted<'a> {
    fn new(problem: &'a Problem) -> Self {
        Self { problem, uncertainties: problem.standard_uncertainties() }
    }
}

impl LeastSquares for Weighted<'_> {
    type Error = Error;

    fn unknowns(&self) -> usize {
        self.problem.unknowns.len()
    }

    fn rows(&self) -> usize {
        self.uncertainties.len()
    }

    fn linearise(&self, x: &[f64], sink: &mut dyn FnMut(usize, &[f64], &[f64])) -> Result<()> {
        let count = self.unknowns();
        let (mut residuals, mut derivatives) = (Vec::new(), Vec::new());
        let mut broken = None;
        self.problem.linearise(x, |block| {
            residuals.clear();
            derivatives.clear();
            for (row, residual) in block.residuals.iter().enumerate() {
                let uncertainty = self.uncertainties[block.first + row];
                let line = &block.jacobian[row * count..(row + 1) * count];
                residuals.push(residual / uncertainty);
                derivatives.extend(line.iter().map(|derivative| derivative / uncertainty));
                if !(residual.is_finite() && line.iter().all(|derivative| derivative.is_finite())) {
                    broken.get_or_insert(block.first + row);
                }
            }
            sink(block.first, &residuals, &derivatives);
        })?;
        broken.map_or(Ok(()), |equation| Err(not_finite(self.problem, equation)))
    }

    fn residuals(&self, x: &[f64]) -> Result<Vec<f64>> {
        let residuals = self.problem.residuals(x)?;
        Ok(residuals.iter().zip(&self.uncertainties).map(|(residual, uncertainty)| residual / uncertainty).collect())
    }
}

/// The error for an equation without a finite value: a pose or an artefact where the geometry is singular.
fn not_finite(problem: &Problem, equation: usize) -> Error {
    let (set, row) = problem.equation_rows()[equation];
    let error = Error::data("the equation of this row has no finite value; its geometry is singular")
        .stage(&problem.sets[set].name);
    match problem.origin(set, row) {
        Some((file, origin)) => error.at(file, origin.line, None),
        None => error,
    }
}

/// The factor of a problem at its own contact points.
fn factor_at_contact(problem: &Problem, x: &[f64]) -> Result<Factor> {
    factor(&problem.at_contact(x)?, x, None)
}

fn factor(problem: &Problem, x: &[f64], weights: Option<&[f64]>) -> Result<Factor> {
    let weighted = Weighted::new(problem);
    let count = weighted.unknowns();
    let mut accumulator = Accumulator::new(count, weighted.rows());
    weighted.linearise(x, &mut |first, residuals, derivatives| {
        for (row, residual) in residuals.iter().enumerate() {
            let weight = weights.map_or(1.0, |weights| weights[first + row].sqrt());
            accumulator.push(&derivatives[row * count..(row + 1) * count], *residual, weight);
        }
    })?;
    Ok(accumulator.finish())
}

fn identifiability(problem: &Problem, factor: &Factor, tolerance: f64) -> Identifiability {
    let singular_values = factor.singular_values();
    let rank = singular_values.rank(tolerance);
    let null_space = if rank < factor.unknowns() { null_space(problem, &factor.spectrum(), rank) } else { Vec::new() };
    Identifiability {
        observations: factor.rows(),
        unknowns: problem.unknowns.len(),
        rank,
        condition: singular_values.condition(rank),
        null_space,
    }
}

/// The lost directions with the names and in the units of the unknowns, those with the largest effect first.
fn null_space(problem: &Problem, spectrum: &Spectrum, rank: usize) -> Vec<NullVector> {
    let null_space = spectrum.null_basis(rank).into_iter().map(|(singular_value, direction)| {
        let mut parts: Vec<(f64, Combination)> = Vec::new();
        for (unknown, (&effect, &scale)) in problem.unknowns.iter().zip(direction.iter().zip(spectrum.scale())) {
            if effect != 0.0 {
                let combination = Combination {
                    name: unknown.name.clone(),
                    coefficient: effect * scale,
                    unit: unknown.unit.to_string(),
                };
                parts.push((effect.abs(), combination));
            }
        }
        parts.sort_by(|a, b| b.0.total_cmp(&a.0));
        let unit = parts.first().map_or(1.0, |(_, largest)| largest.coefficient);
        let combination = parts.into_iter().map(|(_, mut part)| {
            part.coefficient /= unit;
            part
        });
        NullVector { singular_value, combination: combination.collect() }
    });
    null_space.collect()
}

/// The error for data that cannot determine what was chosen.
fn confounded(found: &Identifiability) -> Error {
    let lost: Vec<String> = found.null_space.iter().map(NullVector::describe).collect();
    Error::data(format!(
        "the data determine {} of {} unknowns:\n- {}",
        found.rank,
        found.unknowns,
        lost.join("\n- ")
    ))
    .help("leave what has no effect and one of each combination out of `parameters`, add measurements that tell them apart, or set `on_confounded`")
}

impl GaussNewton {
    fn robust(&self) -> Option<Robust> {
        self.settings.robust.as_ref().map(RobustSetting::robust)
    }

    /// Refuses what cannot be solved at all.
    fn check(problem: &Problem) -> Result<()> {
        let (equations, unknowns) = (problem.equations(), problem.unknowns.len());
        if unknowns == 0 {
            return Err(Error::usage("there is nothing to estimate").setting("parameters"));
        }
        if equations < unknowns {
            return Err(Error::data(format!(
                "{equations} equations cannot determine {unknowns} unknowns: there are too few touches"
            ))
            .help("measure more, or choose fewer parameters"));
        }
        Ok(())
    }

    fn solve(&self, problem: &Problem, lost: Option<Identifiability>) -> Result<Calibration> {
        let rank = lost.as_ref().map_or(problem.unknowns.len(), |lost| lost.rank);
        let options = Options { iterations: self.settings.iterations, tolerance: 1e-9, rank, robust: self.robust() };
        let solution = solve(&Weighted::new(problem), &problem.start(), &options)?;
        let failed = match solution.end {
            End::Converged => None,
            End::NoProgress => Some("no step makes the residuals smaller".to_owned()),
            End::IterationLimit => {
                Some(format!("it still moves at the limit of {} iterations", self.settings.iterations))
            }
        };
        if let Some(failed) = failed {
            return Err(Error::data(format!("the iteration does not converge: {failed}")).help(
                "check units, signs and features of the data, choose fewer parameters, or `start` from a calibration",
            ));
        }
        let at_contact = problem.at_contact(&solution.x)?;
        // What is left out by its weight does not inform; what is weighed down still does.
        let kept: Option<Vec<f64>> = (solution.robust.as_ref())
            .map(|robust| robust.weights.iter().map(|weight| f64::from(*weight > 0.0)).collect());
        let factor = factor(&at_contact, &solution.x, kept.as_deref())?;
        let mut found = identifiability(problem, &factor, self.settings.rank_tolerance);
        let covariance = match lost {
            None if found.rank < rank => return Err(confounded(&found)),
            None => factor.whitener(rank).covariance(),
            Some(lost) => {
                // Second order must not make look determined at the solution what is not at the start.
                let condition = factor.singular_values().condition(rank);
                found = Identifiability { observations: found.observations, condition, ..lost };
                factor.whitener(rank).covariance()
            }
        };
        let residuals = problem.residuals(&solution.x)?;
        let spread = Spread::new(problem, &residuals, solution.robust.as_ref(), self.robust(), rank);
        let scale =
            if self.settings.trust_uncertainties || spread.degrees_of_freedom == 0 { 1.0 } else { spread.sigma };
        let mut covariance: Vec<Vec<f64>> =
            covariance.into_iter().map(|row| row.into_iter().map(|value| value * scale * scale).collect()).collect();
        consider(&at_contact, &solution.x, kept.as_deref(), &mut covariance)?;
        let outliers = match (&solution.robust, self.robust()) {
            (Some(report), Some(robust)) => outliers(problem, &residuals, report, robust),
            _ => Vec::new(),
        };
        let fit = FitReport {
            observations: spread.used,
            unknowns: problem.unknowns.len(),
            rank: found.rank,
            condition: found.condition,
            degrees_of_freedom: spread.degrees_of_freedom,
            sigma: spread.sigma,
            iterations: solution.iterations,
            termination: Termination::Converged,
            residual_max_um: spread.max * 1e3,
            residual_mean_abs_um: spread.mean_abs * 1e3,
            residual_rms_um: spread.rms * 1e3,
            null_space: found.null_space,
        };
        Ok(calibration(problem, &solution.x, covariance, outliers, fit))
    }
}

impl Estimate for GaussNewton {
    fn estimate(&self, problem: &Problem) -> Result<Calibration> {
        Self::check(problem)?;
        let factor = factor_at_contact(problem, &problem.start())?;
        if factor.is_surely_full_rank(self.settings.rank_tolerance) {
            return self.solve(problem, None);
        }
        let found = identifiability(problem, &factor, self.settings.rank_tolerance);
        if found.rank == found.unknowns {
            return self.solve(problem, None);
        }
        match self.settings.on_confounded {
            OnConfounded::Error => Err(confounded(&found)),
            OnConfounded::MinimumNorm if !problem.known.unknowns.is_empty() => {
                let error = Error::usage("a minimum-norm solution has no definite answer to what `known` takes over");
                Err(error.help("use `on_confounded: drop`").setting("on_confounded"))
            }
            OnConfounded::MinimumNorm => self.solve(problem, Some(found)),
            OnConfounded::Drop => {
                let dropped = factor.spectrum().dependent(found.rank);
                let names: Vec<&str> = dropped.iter().map(|&index| problem.unknowns[index].name.as_str()).collect();
                tracing::warn!("{}: left at their start values: {}", problem.name, names.join(", "));
                let reduced = problem.without(|unknown| names.contains(&unknown.name.as_str()));
                let mut calibration = self.solve(&reduced, None)?;
                // Whoever shares a lost direction has a value only as long as those left behind have theirs.
                let parts = found.null_space.iter().flat_map(|vector| &vector.combination);
                let shared: Vec<&str> = parts.map(|part| part.name.as_str()).collect();
                for estimated in calibration.parameters.iter_mut().chain(&mut calibration.artefacts) {
                    if shared.contains(&estimated.name.as_str()) || names.contains(&estimated.name.as_str()) {
                        estimated.status = Status::Confounded;
                    }
                }
                calibration.fit.unknowns = found.unknowns;
                calibration.fit.null_space = found.null_space;
                Ok(calibration)
            }
        }
    }

    fn accepts(&self, found: &Identifiability) -> bool {
        found.rank == found.unknowns || self.settings.on_confounded != OnConfounded::Error
    }

    fn identify(&self, problem: &Problem) -> Result<Identifiability> {
        let factor = factor_at_contact(problem, &problem.start())?;
        Ok(identifiability(problem, &factor, self.settings.rank_tolerance))
    }
}

/// Adds what the uncertainty of known parameters does to the estimates, `G K G^T` with their covariance K and the answer
/// G of the estimates to them; appends the known ones themselves.
fn consider(problem: &Problem, x: &[f64], kept: Option<&[f64]>, covariance: &mut Vec<Vec<f64>>) -> Result<()> {
    let known = &problem.known;
    let (own, others) = (problem.unknowns.len(), known.unknowns.len());
    if others == 0 {
        return Ok(());
    }
    let mut extended = problem.at(x);
    extended.unknowns.extend(known.unknowns.iter().cloned());
    let answer = factor(&extended, &extended.start(), kept)?.sensitivity(own);
    let times = |row: &[f64], column: usize| -> f64 {
        row.iter().zip(&known.covariance).map(|(answer, line)| answer * line[column]).sum()
    };
    let cross: Vec<Vec<f64>> =
        answer.iter().map(|row| (0..others).map(|column| times(row, column)).collect()).collect();
    for row in 0..own {
        for column in 0..=row {
            let added: f64 = cross[row].iter().zip(&answer[column]).map(|(a, b)| a * b).sum();
            covariance[row][column] += added;
            covariance[column][row] = covariance[row][column];
        }
    }
    for (row, cross) in covariance.iter_mut().zip(&cross) {
        row.extend(cross);
    }
    for (column, line) in known.covariance.iter().enumerate() {
        covariance.push(cross.iter().map(|row| row[column]).chain(line.iter().copied()).collect());
    }
    Ok(())
}

/// How the residuals scatter.
struct Spread {
    used: usize,
    degrees_of_freedom: usize,
    sigma: f64,
    max: f64,
    mean_abs: f64,
    rms: f64,
}

impl Spread {
    /// Of the rows that are not left out by their weight. The a-posteriori factor of a robust estimate is that of Huber
    /// (1981, section 7.6): the mean square of the influence over the square of its mean slope, with his correction for
    /// the number of unknowns.
    fn new(
        problem: &Problem,
        residuals: &[f64],
        report: Option<&RobustReport>,
        robust: Option<Robust>,
        rank: usize,
    ) -> Self {
        let uncertainties = problem.standard_uncertainties();
        let used: Vec<usize> =
            (0..residuals.len()).filter(|&row| report.is_none_or(|report| report.weights[row] > 0.0)).collect();
        let count = used.len();
        let degrees_of_freedom = count.saturating_sub(rank);
        let free = degrees_of_freedom.max(1) as f64;
        let influence = |row: usize| {
            let weight = report.map_or(1.0, |report| report.weights[row]);
            (weight * residuals[row] / uncertainties[row]).powi(2)
        };
        let mean_square = used.iter().map(|&row| influence(row)).sum::<f64>() / free;
        let correction = match (report, robust) {
            (Some(report), Some(robust)) if count > 0 => {
                let slopes: Vec<f64> =
                    used.iter().map(|&row| robust.influence_slope(report.studentised[row])).collect();
                let mean = slopes.iter().sum::<f64>() / count as f64;
                let variance = slopes.iter().map(|slope| (slope - mean).powi(2)).sum::<f64>() / count as f64;
                (1.0 + rank as f64 / count as f64 * variance / mean.powi(2)) / mean
            }
            _ => 1.0,
        };
        let sizes = || used.iter().map(|&row| residuals[row].abs());
        let mean = |sum: f64| if count > 0 { sum / count as f64 } else { 0.0 };
        Self {
            used: count,
            degrees_of_freedom,
            sigma: mean_square.sqrt() * correction,
            max: sizes().fold(0.0, f64::max),
            mean_abs: mean(sizes().sum()),
            rms: mean(sizes().map(|size| size * size).sum()).sqrt(),
        }
    }
}

/// The rows with an equation beyond the limit, largest first.
fn outliers(problem: &Problem, residuals: &[f64], report: &RobustReport, robust: Robust) -> Vec<Outlier> {
    let mut found: Vec<Outlier> = Vec::new();
    let mut last = None;
    for (equation, (set, row)) in problem.equation_rows().into_iter().enumerate() {
        if report.studentised[equation].abs() < robust.outlier_at {
            continue;
        }
        let residual_um = residuals[equation] * 1e3;
        if last == Some((set, row))
            && let Some(same) = found.last_mut()
        {
            if residual_um.abs() > same.residual_um.abs() {
                same.residual_um = residual_um;
            }
            same.weight = same.weight.min(report.weights[equation]);
            continue;
        }
        last = Some((set, row));
        let origin = problem.origin(set, row);
        found.push(Outlier {
            stage: problem.sets[set].name.clone(),
            file: origin.map_or_else(String::new, |(file, _)| file.display().to_string()),
            line: origin.map_or(0, |(_, origin)| origin.line),
            row: origin.map_or(0, |(_, origin)| origin.row),
            residual_um,
            weight: report.weights[equation],
        });
    }
    found
}

fn calibration(
    problem: &Problem,
    x: &[f64],
    covariance: Vec<Vec<f64>>,
    outliers: Vec<Outlier>,
    fit: FitReport,
) -> Calibration {
    let lost = |name: &str| fit.null_space.iter().any(|vector| vector.combination.iter().any(|part| part.name == name));
    let estimated = |owner: Owner, index: usize, name: String, unit: abbe_core::Unit, fixed: f64| {
        let here = |unknown: &Unknown| unknown.owner == owner && unknown.index == index;
        let uncertainty = |column: usize| covariance[column][column].max(0.0).sqrt();
        let chosen = problem.unknowns.iter().position(here);
        let considered = problem.known.unknowns.iter().position(here);
        let (value, standard_uncertainty, status) = match (chosen, considered) {
            (Some(column), _) => {
                let status = if lost(&name) { Status::Confounded } else { Status::Estimated };
                (x[column], uncertainty(column), status)
            }
            (None, Some(known)) => (fixed, uncertainty(problem.unknowns.len() + known), Status::Considered),
            (None, None) => (fixed, 0.0, Status::Fixed),
        };
        Estimated { name, value, unit: unit.to_string(), standard_uncertainty, status }
    };
    let parameters = problem.model.parameters().iter().enumerate();
    let parameters = parameters.map(|(index, parameter)| {
        estimated(Owner::Machine, index, parameter.name.clone(), parameter.unit, problem.machine[index])
    });
    let mut artefacts = Vec::new();
    for (set, observations) in problem.sets.iter().enumerate() {
        for (index, own) in observations.observations.unknowns().iter().enumerate() {
            let name = format!("{}.{}", observations.name, own.name);
            artefacts.push(estimated(Owner::Set(set), index, name, own.unit, observations.own[index]));
        }
    }
    Calibration {
        abbe_calibration: CALIBRATION_FORMAT,
        estimate: problem.name.clone(),
        model: problem.model_record(),
        parameters: parameters.collect(),
        artefacts,
        covariance: Covariance {
            order: problem.unknowns.iter().chain(&problem.known.unknowns).map(|unknown| unknown.name.clone()).collect(),
            rows: covariance,
        },
        outliers,
        fit,
    }
}
