//! Estimator plugin `combine`: one calibration of several, by generalised least squares with the inputs that they share.
//!
//! Calibration i knows the parameters `x_i = E_i x`, with the covariance `C_i = R_i + sum over inputs of s_ik u_k^2 s_ik^T`:
//! R_i comes from its own measurements, s_ik are its sensitivities to the inputs k. As in every estimate, only measurements
//! determine the weights; inputs are considered: `x = N^-1 sum E_i^T R_i^-1 x_i` with `N = sum E_i^T R_i^-1 E_i`. Its
//! sensitivities follow from the same sums, and its covariance is `N^-1 + sum over inputs of s_k u_k^2 s_k^T`, where every
//! shared input counts once. For linear problems this is the estimate from all measurements at once.
//!
//! The residuals `v_i = x_i - E_i x` and their full covariance V show whether the calibrations agree: `v^T V^+ v` is a
//! chi-squared quantity with the rank of V as its degrees of freedom.

use std::collections::BTreeMap;

use abbe_core::{
    Calibration, CombinedAgreement, ConsideredInput, Context, Error, Estimate, EstimateSource, Fit, FitReport,
    Identifiability, Problem, Result, SettingsError, Status,
};
use abbe_estimation::calibration;
use abbe_numerics::chi_squared_upper_tail;
use nalgebra::{DMatrix, DVector};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

abbe_core::register!(
    Estimate,
    "combine",
    "one calibration of several, with the inputs that they share, and whether they agree",
    Settings,
    example,
    build,
    "../reference/estimate-combine.md",
    EstimateSource::Combination,
);

/// Settings of a combination.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// Probability that calibrations that agree are refused.
    #[serde(default = "default_significance")]
    significance: f64,
    /// What to do with calibrations that do not agree.
    #[serde(default)]
    on_disagreement: OnDisagreement,
}

fn default_significance() -> f64 {
    0.01
}

/// What to do with calibrations that do not agree.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum OnDisagreement {
    /// Stop and name the parameter that differs most.
    #[default]
    Error,
    /// Continue; the calibration file states that they do not agree.
    Warn,
}

fn example() -> Value {
    json!({ "significance": 0.01 })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Estimate>, SettingsError> {
    if !(settings.significance > 0.0 && settings.significance < 1.0) {
        return Err(SettingsError::new("significance", "a number between 0 and 1 was expected"));
    }
    Ok(Box::new(Combination { settings }))
}

struct Combination {
    settings: Settings,
}

/// Eigenvalues below this part of the largest count as zero; quantities are scaled to unit variance before.
const ZERO: f64 = 1e-10;

/// Most names that an error lists.
const NAMED: usize = 8;

/// The values of one calibration for the parameters that are combined.
struct Known<'a> {
    calibration: &'a Calibration,
    /// Index of each among the combined parameters.
    places: Vec<usize>,
    values: DVector<f64>,
    /// Covariance from its own measurements.
    noise: DMatrix<f64>,
    /// The inverse of that covariance.
    weight: DMatrix<f64>,
    /// Sensitivities to its inputs.
    inputs: Vec<(&'a ConsideredInput, DVector<f64>)>,
}

impl<'a> Known<'a> {
    fn new(fit: &'a Fit, problem: &Problem) -> Result<Self> {
        let calibration = &fit.calibration;
        let covariance = &calibration.covariance;
        let (mut places, mut columns) = (Vec::new(), Vec::new());
        for (place, unknown) in problem.unknowns.iter().enumerate() {
            let Some(found) = calibration.parameters.iter().find(|parameter| parameter.name == unknown.name) else {
                continue;
            };
            let unit = unknown.unit.to_string();
            if found.unit != unit {
                return Err(Error::data(format!(
                    "`{}` is in {} in {}, and in {unit} here: the models differ",
                    unknown.name, found.unit, fit.name
                )));
            }
            if found.status == Status::Confounded {
                let message = format!("the data of `{}` cannot separate `{}` from others", fit.name, unknown.name);
                return Err(Error::data(message).help("leave it out by `parameters`").setting("of"));
            }
            let column = covariance.index(&unknown.name);
            if let Some(column) = column.filter(|&column| covariance.rows[column][column] > 0.0) {
                places.push(place);
                columns.push(column);
            }
        }
        if places.is_empty() {
            let message = format!("`{}` has estimated none of the parameters that are combined", fit.name);
            return Err(Error::data(message).setting("of"));
        }
        let (rows, size) = (&covariance.rows, columns.len());
        let mut noise = DMatrix::from_fn(size, size, |row, column| rows[columns[row]][columns[column]]);
        let mut inputs = Vec::new();
        for input in calibration.inputs.iter().flatten() {
            let sensitivity = DVector::from_iterator(size, columns.iter().map(|&column| input.sensitivities[column]));
            noise -= &sensitivity * sensitivity.transpose() * input.standard_uncertainty.powi(2);
            inputs.push((input, sensitivity));
        }
        let of_order = |name: &String| calibration.get(name).map_or(f64::NAN, |found| found.value);
        let values = DVector::from_iterator(size, columns.iter().map(|&column| of_order(&covariance.order[column])));
        let weight = inverse(&noise).ok_or_else(|| {
            Error::data(format!("the covariance of `{}` is singular without the inputs that it considers", fit.name))
                .help("leave out by `parameters` what its measurements do not tell by themselves")
                .setting("of")
        })?;
        Ok(Self { calibration, places, values, noise, weight, inputs })
    }
}

/// The inverse of a covariance, scaled to unit diagonal on the way; None if it is not positive definite.
fn inverse(matrix: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let size = matrix.nrows();
    let scale: Vec<f64> = (0..size).map(|row| matrix[(row, row)].sqrt()).collect();
    if scale.iter().any(|scale| !(*scale > 0.0 && scale.is_finite())) {
        return None;
    }
    let scaled = DMatrix::from_fn(size, size, |row, column| matrix[(row, column)] / scale[row] / scale[column]);
    let inverse = scaled.cholesky()?.inverse();
    Some(DMatrix::from_fn(size, size, |row, column| inverse[(row, column)] / scale[row] / scale[column]))
}

/// Refuses parameters that one calibration has estimated and another one has held fixed: the other parameters of the two then
/// have different meanings.
///
///
/// A calibration without observations, such as that of `stated`, holds no parameter in this sense.
fn same_free_parameters(fits: &[&Fit]) -> Result<()> {
    for one in fits {
        let free = |status: Status| matches!(status, Status::Estimated | Status::Confounded);
        let free: Vec<&str> = (one.calibration.parameters.iter())
            .filter(|parameter| free(parameter.status))
            .map(|parameter| parameter.name.as_str())
            .collect();
        for other in fits.iter().filter(|other| other.calibration.fit.observations > 0) {
            let parameters = other.calibration.parameters.iter();
            let held = parameters.filter(|it| it.status == Status::Fixed && free.contains(&it.name.as_str()));
            let mut held: Vec<&str> = held.map(|parameter| parameter.name.as_str()).collect();
            if held.is_empty() {
                continue;
            }
            let more = if held.len() > NAMED { format!(" and {} more", held.len() - NAMED) } else { String::new() };
            held.truncate(NAMED);
            return Err(Error::data(format!(
                "`{}` has estimated {}{more}, which `{}` holds: their other parameters do not mean the same",
                one.name,
                held.join(", "),
                other.name
            ))
            .help(format!(
                "estimate the same parameters in both, or let `{}` know them: `known: {}`",
                other.name, one.name
            ))
            .setting("of"));
        }
    }
    Ok(())
}

/// The combined parameters.
struct Combined<'a> {
    x: DVector<f64>,
    /// Covariance from measurements.
    noise: DMatrix<f64>,
    /// The inputs, each once, with the sensitivities of the combined parameters.
    inputs: Vec<(&'a ConsideredInput, DVector<f64>)>,
}

impl<'a> Combined<'a> {
    fn new(known: &[Known<'a>], problem: &Problem) -> Result<Self> {
        let size = problem.unknowns.len();
        let mut normal = DMatrix::<f64>::zeros(size, size);
        for one in known {
            for (row, &place) in one.places.iter().enumerate() {
                for (column, &other) in one.places.iter().enumerate() {
                    normal[(place, other)] += one.weight[(row, column)];
                }
            }
        }
        let lost = (0..size).find(|&row| normal[(row, row)] <= 0.0);
        let noise = inverse(&normal).ok_or_else(|| {
            let name = lost.map_or("some parameter", |row| problem.unknowns[row].name.as_str());
            Error::data(format!("none of the calibrations has estimated {name}"))
        })?;
        let summed = |of: &dyn Fn(&Known<'a>) -> Option<DVector<f64>>| {
            let mut sum = DVector::<f64>::zeros(size);
            for one in known {
                let Some(vector) = of(one) else { continue };
                let weighted = &one.weight * vector;
                one.places.iter().zip(weighted.iter()).for_each(|(&place, value)| sum[place] += value);
            }
            &noise * sum
        };
        // Differences to one of the values lose fewer digits than the values themselves.
        let mut reference = DVector::<f64>::zeros(size);
        for one in known.iter().rev() {
            one.places.iter().zip(one.values.iter()).for_each(|(&place, value)| reference[place] = *value);
        }
        let off = summed(&|one| {
            Some(DVector::from_iterator(
                one.places.len(),
                one.places.iter().zip(one.values.iter()).map(|(&place, value)| value - reference[place]),
            ))
        });
        let mut identities: BTreeMap<&str, &ConsideredInput> = BTreeMap::new();
        for one in known {
            for (input, _) in &one.inputs {
                let first = *identities.entry(input.identity.as_str()).or_insert(input);
                first.agrees_with(input)?;
            }
        }
        let inputs = identities.into_values().map(|input| {
            let sensitivity = summed(&|one| one.of_input(input).cloned());
            (input, sensitivity)
        });
        let inputs = inputs.collect();
        Ok(Self { x: reference + off, noise, inputs })
    }
}

impl Known<'_> {
    fn of_input(&self, input: &ConsideredInput) -> Option<&DVector<f64>> {
        self.inputs.iter().find(|(own, _)| own.identity == input.identity).map(|(_, sensitivity)| sensitivity)
    }
}

/// How well the calibrations agree, and the stacked value with the largest deviation relative to its standard uncertainty.
fn agreement(known: &[Known<'_>], combined: &Combined<'_>) -> (CombinedAgreement, usize) {
    let stacked: usize = known.iter().map(|one| one.places.len()).sum();
    let size = combined.x.len();
    let mut design = DMatrix::<f64>::zeros(stacked, size);
    let mut gain = DMatrix::<f64>::zeros(size, stacked);
    let mut covariance = DMatrix::<f64>::zeros(stacked, stacked);
    let mut values = DVector::<f64>::zeros(stacked);
    let mut first = 0;
    for one in known {
        let count = one.places.len();
        for (row, &place) in one.places.iter().enumerate() {
            design[(first + row, place)] = 1.0;
            values[first + row] = one.values[row] - combined.x[place];
        }
        covariance.view_mut((first, first), (count, count)).copy_from(&one.noise);
        let mut spread = DMatrix::<f64>::zeros(size, count);
        for (row, &place) in one.places.iter().enumerate() {
            spread.row_mut(place).copy_from(&one.weight.row(row));
        }
        gain.view_mut((0, first), (size, count)).copy_from(&(&combined.noise * spread));
        first += count;
    }
    for (input, _) in &combined.inputs {
        let mut sensitivity = DVector::<f64>::zeros(stacked);
        let mut first = 0;
        for one in known {
            if let Some(own) = one.of_input(input) {
                sensitivity.rows_mut(first, own.len()).copy_from(own);
            }
            first += one.places.len();
        }
        covariance += &sensitivity * sensitivity.transpose() * input.standard_uncertainty.powi(2);
    }
    // The residuals are small beside the terms that cancel in them: scales are those of the values, not of the residuals.
    let scale: Vec<f64> = (0..stacked).map(|row| covariance[(row, row)].sqrt()).collect();
    let projection = DMatrix::identity(stacked, stacked) - &design * &gain;
    let of_residuals = &projection * &covariance * projection.transpose();
    let scaled =
        DMatrix::from_fn(stacked, stacked, |row, column| of_residuals[(row, column)] / scale[row] / scale[column]);
    let off = DVector::from_fn(stacked, |row, _| values[row] / scale[row]);
    let eigen = scaled.clone().symmetric_eigen();
    let zero = ZERO * eigen.eigenvalues.max().max(1.0);
    let (mut chi_squared, mut degrees_of_freedom) = (0.0, 0);
    for (value, vector) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
        if *value > zero {
            chi_squared += vector.dot(&off).powi(2) / value;
            degrees_of_freedom += 1;
        }
    }
    let probability =
        if degrees_of_freedom == 0 { 1.0 } else { chi_squared_upper_tail(chi_squared, degrees_of_freedom as f64) };
    // If there is one independent difference, all deviations have the same size: the value with the largest part of its
    // uncertainty is chosen.
    let size = |row: usize| match scaled[(row, row)] > zero {
        true => (off[row].abs() / scaled[(row, row)].sqrt() * 1e3).round(),
        false => 0.0,
    };
    let order = |&one: &usize, &other: &usize| {
        size(one).total_cmp(&size(other)).then(scaled[(one, one)].total_cmp(&scaled[(other, other)]))
    };
    let worst = (0..stacked).max_by(order).unwrap_or_default();
    (CombinedAgreement { chi_squared, degrees_of_freedom, probability }, worst)
}

impl Combination {
    fn judge(
        &self,
        known: &[Known<'_>],
        fits: &[&Fit],
        problem: &Problem,
        combined: &Combined<'_>,
    ) -> Result<FitReport> {
        let (agreement, worst) = agreement(known, combined);
        let stacked: Vec<(usize, usize)> = known
            .iter()
            .enumerate()
            .flat_map(|(one, known)| known.places.iter().map(move |&place| (one, place)))
            .collect();
        if agreement.probability < self.settings.significance {
            let (one, place) = stacked[worst];
            let message = format!(
                "the calibrations do not agree within their uncertainties: chi-squared {:.1} with {} degrees of freedom, \
                 probability {:.1e}; {} of `{}` is off most",
                agreement.chi_squared,
                agreement.degrees_of_freedom,
                agreement.probability,
                problem.unknowns[place].name,
                fits[one].name
            );
            match self.settings.on_disagreement {
                OnDisagreement::Error => {
                    let help =
                        "find out which one is wrong, or write `on_disagreement: warn` to combine them all the same";
                    return Err(Error::data(message).help(help).setting("of"));
                }
                OnDisagreement::Warn => tracing::warn!("{}: {message}", problem.name),
            }
        }
        let freedom = agreement.degrees_of_freedom;
        let sigma = if freedom > 0 { (agreement.chi_squared / freedom as f64).sqrt() } else { 1.0 };
        Ok(FitReport {
            observations: stacked.len(),
            degrees_of_freedom: freedom,
            sigma,
            iterations: 1,
            agreement: Some(agreement),
            ..FitReport::without_rows(problem.unknowns.len())
        })
    }
}

impl Estimate for Combination {
    fn combine(&self, problem: &Problem, fits: &[&Fit]) -> Result<Calibration> {
        if fits.len() < 2 {
            return Err(Error::usage("two estimates or more were expected").setting("of"));
        }
        same_free_parameters(fits)?;
        for fit in fits.iter().filter(|fit| fit.calibration.inputs.is_none()) {
            tracing::warn!(
                "{}: its file tells no identities of inputs: what it shares with others counts twice",
                fit.name
            );
        }
        let estimated = |name: &str| {
            let known = |fit: &&&Fit| fit.calibration.covariance.index(name).is_some();
            fits.iter().any(|fit| known(&fit))
        };
        let missing =
            fits.iter().flat_map(|fit| fit.calibration.parameters.iter().map(move |it| (fit, it))).find(|(_, it)| {
                let here = problem.model.info().parameters.iter().any(|parameter| parameter.name == it.name);
                it.status == Status::Estimated && !here
            });
        if let Some((fit, parameter)) = missing {
            let message = format!(
                "the machine of `{}` has no {}, which `{}` has estimated",
                problem.name, parameter.name, fit.name
            );
            return Err(Error::usage(message).help("name a `machine` that has the errors of all").setting("of"));
        }
        let mut problem = problem.without_unknowns(|unknown| !estimated(&unknown.name));
        let known = fits.iter().map(|fit| Known::new(fit, &problem)).collect::<Result<Vec<_>>>()?;
        let combined = Combined::new(&known, &problem)?;
        let report = self.judge(&known, fits, &problem, &combined)?;
        // A parameter that all calibrations hold fixed keeps its value.
        for one in known.iter().rev() {
            problem = held(&problem, one.calibration);
        }
        for (input, _) in &combined.inputs {
            problem.consider(input, "combined")?;
        }
        let covariance = covariance(&combined);
        Ok(calibration(&problem, combined.x.as_slice(), covariance, Vec::new(), report))
    }

    fn estimate(&self, _: &Problem) -> Result<Calibration> {
        Err(Error::usage("a combination is made of other estimates, not of measurements: it cannot be made again"))
    }

    fn identify(&self, _: &Problem) -> Result<Identifiability> {
        Err(Error::usage("a combination is made of other estimates: there is nothing to judge beforehand"))
    }
}

/// The problem with the values, other than zero, of the machine parameters that a calibration holds fixed.
fn held(problem: &Problem, calibration: &Calibration) -> Problem {
    let mut problem = problem.clone();
    for (value, parameter) in problem.machine_values.iter_mut().zip(&problem.model.info().parameters) {
        let known = calibration.parameters.iter().find(|known| known.name == parameter.name);
        if let Some(known) = known.filter(|known| known.status == Status::Fixed && known.value != 0.0) {
            *value = known.value;
        }
    }
    problem
}

/// The covariance of the combined parameters, followed by their inputs.
fn covariance(combined: &Combined<'_>) -> Vec<Vec<f64>> {
    let (own, count) = (combined.x.len(), combined.inputs.len());
    let mut all = DMatrix::<f64>::zeros(own + count, own + count);
    all.view_mut((0, 0), (own, own)).copy_from(&combined.noise);
    for (index, (input, sensitivity)) in combined.inputs.iter().enumerate() {
        let variance = input.standard_uncertainty.powi(2);
        let mut block = all.view_mut((0, 0), (own, own));
        block += sensitivity * sensitivity.transpose() * variance;
        for row in 0..own {
            all[(row, own + index)] = sensitivity[row] * variance;
            all[(own + index, row)] = sensitivity[row] * variance;
        }
        all[(own + index, own + index)] = variance;
    }
    // Makes the matrix exactly symmetric.
    let entry = |row: usize, column: usize| all[(row.max(column), row.min(column))];
    (0..own + count).map(|row| (0..own + count).map(|column| entry(row, column)).collect()).collect()
}
