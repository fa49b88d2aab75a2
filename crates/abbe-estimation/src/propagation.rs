//! The covariance of the estimates by the law of propagation (JCGM 100, JCGM 102:2011, eq. 3), input by input.
//!
//! Rows that are independent, or correlated by a covariance that is also their weight, give `(J^T W J)^-1` times the square
//! of the a-posteriori factor. Inputs that give no weights are propagated with the sensitivities `G = -(J^T W J)^-1 J^T W K`
//! of the estimates: the scatter of repeats (K = their deviations) and considered quantities (K = derivatives to known inputs
//! and to parameters of an earlier estimate), as in Rahman (2016), eq. 8-3.

use abbe_core::{
    Contribution, Correlated, EquationIndex, JointCoverage, ParameterBudget, Problem, RepeatedTogether, Result,
    SetIndex, UncertaintyBudget, in_parallel,
};
use abbe_numerics::{
    CovarianceRoot, Factor, coverage_factor, dot, effective_degrees_of_freedom, joint_coverage_factor,
    rectangular_coverage_factor,
};

use crate::weighted::Weighted;

/// Correlations above this are listed.
const STRONG: f64 = 0.95;

/// Contributions below this part of a standard uncertainty are rounding.
const NOTHING: f64 = 1e-6;

/// Contribution of one independent input to the covariance of the estimates.
struct Part {
    /// Its name in budgets.
    input: String,
    /// Covariance of the unknowns.
    covariance: Vec<Vec<f64>>,
    /// Whether the a-posteriori factor applies: the uncertainty of rows was stated, not found by repeats.
    stated: bool,
    /// That factor; 1 where it does not apply.
    scale: f64,
    /// Degrees of freedom of the factor, or of the scatter of repeats.
    degrees_of_freedom: f64,
}

/// The covariance of the unknowns, by contributions of independent inputs.
pub struct Propagation {
    parts: Vec<Part>,
    /// Covariance of unknowns (rows) with considered quantities (columns).
    cross: Vec<Vec<f64>>,
    /// The a-posteriori factors.
    scales: AposterioriFactors,
}

/// The a-posteriori factors on stated uncertainties, with their degrees of freedom.
#[derive(Clone)]
pub enum AposterioriFactors {
    /// One for all readings; its degrees of freedom are infinite if stated uncertainties are trusted.
    Common(f64, f64),
    /// One for every set; the uncertainties of the problem already contain it.
    PerSet(Vec<(f64, f64)>),
}

impl AposterioriFactors {
    /// What the rows of a set contribute, by the covariance that follows from their uncertainties.
    fn part(&self, input: String, mut covariance: Vec<Vec<f64>>, set: SetIndex) -> Part {
        let (scale, degrees_of_freedom) = match self {
            Self::Common(scale, freedom) => (*scale, *freedom),
            Self::PerSet(all) => {
                let (scale, freedom) = all[set.0];
                covariance.iter_mut().flatten().for_each(|entry| *entry /= scale * scale);
                (scale, freedom)
            }
        };
        Part { input, covariance, stated: true, scale, degrees_of_freedom }
    }
}

/// The linearised problem of a propagation.
pub struct Linearisation<'a> {
    /// The problem at its contact points.
    pub problem: &'a Problem,
    /// The unknowns.
    pub x: &'a [f64],
    /// Rows that take part, 0 or 1.
    pub kept: Option<&'a [f64]>,
    /// A root of the covariance of the unknowns that follows from all rows there.
    pub root: CovarianceRoot,
}

/// What the rows of every set tell, and all of them, with columns for what is considered after those of the unknowns.
pub(crate) struct RowsOfSets {
    pub of_sets: Vec<Factor>,
    pub extended: Factor,
}

impl RowsOfSets {
    /// The rows of a problem at x, those that are kept. None where repeats are pooled or a certificate constrains rows, whose uncertainty is
    /// not that of the rows alone.
    pub fn new(problem: &Problem, x: &[f64], kept: Option<&[f64]>) -> Result<Option<Self>> {
        if problem.constraints().contains(&true) || !problem.repeated_together().is_empty() {
            return Ok(None);
        }
        let mut extended = problem.with_values(x);
        extended.unknowns.extend(problem.considered.unknowns.iter().cloned());
        let of_sets = Weighted::new(&extended)?.factors(&extended.start(), kept, &problem.equation_ranges())?;
        let extended = match of_sets.as_slice() {
            [only] => Some(only.clone()),
            several => Factor::combined(&several.iter().collect::<Vec<_>>()),
        };
        Ok(extended.map(|extended| Self { of_sets, extended }))
    }

    /// The factor of all rows with the columns of the unknowns of the problem.
    pub fn without_considered(&self, problem: &Problem) -> Factor {
        self.extended.without_unknowns(|column| column >= problem.unknowns.len())
    }
}

impl Propagation {
    /// Propagates all inputs. With `split` every artefact is an input by itself.
    pub fn new(at: &Linearisation<'_>, scales: AposterioriFactors, split: bool) -> Result<Self> {
        let Linearisation { problem, x, kept, root: covariance_root } = at;
        let (problem, x, kept) = (*problem, *x, *kept);
        let repeated_together = problem.repeated_together();
        let repeated = |set: SetIndex| repeated_together.iter().any(|together| together.sets.contains(&set));
        // A constraint of a certificate has a weight as a row has, but its uncertainty is that of its known inputs.
        let constraints = problem.constraints();
        let constrained = constraints.contains(&true);
        let mut parts = Vec::new();
        if let AposterioriFactors::Common(..) = scales
            && !split
            && repeated_together.is_empty()
            && !constrained
        {
            parts.push(scales.part("rows".to_owned(), covariance_root.covariance(), SetIndex(0)));
        } else {
            let ranges = problem.equation_ranges();
            let scatter = |(equation, constraint): (EquationIndex, &bool)| match (constraint, kept) {
                (true, _) => 0.0,
                (false, kept) => kept.map_or(1.0, |kept| kept[equation]),
            };
            let scattering: Option<Vec<f64>> =
                constrained.then(|| EquationIndex::enumerate(&constraints).map(scatter).collect());
            let factors = Weighted::new(problem)?.factors(x, scattering.as_deref().or(kept), &ranges)?;
            let of_rows: Vec<(SetIndex, &Factor)> = SetIndex::enumerate(&problem.sets)
                .map(|(index, _)| index)
                .zip(&factors)
                .filter(|(index, _)| !repeated(*index))
                .collect();
            let covariances = in_parallel(&of_rows, None, |(_, factor)| covariance_root.part(factor));
            for ((index, _), covariance) in of_rows.into_iter().zip(covariances) {
                parts.push(scales.part(problem.sets[index].name.clone(), covariance, index));
            }
        }
        let cross = propagate_shared(at, &repeated_together, &mut parts)?;
        Ok(Self { parts, cross, scales })
    }

    /// The same from the factors of the rows of every set, and from the factor of all rows with the columns of what is considered after
    /// those of the unknowns. Every artefact is an input by itself; repeats and constraints there are none.
    pub fn of_factors(
        problem: &Problem,
        root: &CovarianceRoot,
        (of_sets, extended): (&[Factor], &Factor),
        scales: AposterioriFactors,
    ) -> Self {
        let sets = SetIndex::enumerate(&problem.sets).zip(of_sets);
        let mut parts: Vec<Part> =
            sets.map(|((index, set), factor)| scales.part(set.name.clone(), root.part(factor), index)).collect();
        let cross = match problem.considered.unknowns.is_empty() {
            true => vec![Vec::new(); problem.unknowns.len()],
            false => shared(problem, &[], &root.sensitivities(extended), &mut parts),
        };
        Self { parts, cross, scales }
    }

    /// Whether the a-posteriori factor multiplies any contribution. It does not if all rows have the scatter of repeats.
    pub fn is_scaled(&self) -> bool {
        self.parts.iter().any(|part| part.stated)
    }

    /// The covariance of the unknowns followed by the considered quantities.
    pub fn covariance(&self, problem: &Problem) -> Vec<Vec<f64>> {
        let own = problem.unknowns.len();
        let mut covariance = vec![vec![0.0; own]; own];
        for part in &self.parts {
            let factor = part.scale.powi(2);
            for (row, line) in covariance.iter_mut().zip(&part.covariance) {
                row.iter_mut().zip(line).for_each(|(value, part)| *value += factor * part);
            }
        }
        for (row, cross) in covariance.iter_mut().zip(&self.cross) {
            row.extend(cross);
        }
        for (column, line) in problem.considered.covariance.iter().enumerate() {
            covariance.push(self.cross.iter().map(|row| row[column]).chain(line.iter().copied()).collect());
        }
        covariance
    }

    /// The uncertainty budget of every unknown.
    pub fn budget(&self, problem: &Problem, probability: f64) -> UncertaintyBudget {
        let machine = problem.unknowns.iter().filter(|unknown| unknown.is_of_machine()).count();
        // Most unknowns have the degrees of freedom of the one before.
        let mut last = (f64::NAN, f64::NAN);
        let mut coverage_factor_of = |freedom: f64| {
            if last.0 != freedom {
                last = (freedom, coverage_factor(probability, freedom));
            }
            last.1
        };
        let parameters = problem.unknowns.iter().enumerate().map(|(index, unknown)| {
            let variance = |part: &Part| part.covariance[index][index].max(0.0);
            let parts: Vec<(f64, &Part)> =
                self.parts.iter().map(|part| (part.scale.powi(2) * variance(part), part)).collect();
            let standard_uncertainty = parts.iter().map(|(variance, _)| variance).sum::<f64>().sqrt();
            let own = |of_rows: bool| {
                let parts = parts.iter().filter(move |(_, part)| part.stated == of_rows);
                parts.map(|(variance, part)| (*variance, part.degrees_of_freedom))
            };
            // One factor for all readings is one estimate: its contributions are added before the effective degrees of
            // freedom are computed.
            let mut freedom: Vec<(f64, f64)> = match self.scales {
                AposterioriFactors::Common(_, freedom) => {
                    vec![(own(true).map(|(variance, _)| variance).sum(), freedom)]
                }
                AposterioriFactors::PerSet(_) => own(true).collect(),
            };
            freedom.extend(own(false));
            let freedom = effective_degrees_of_freedom(&freedom);
            let coverage_factor = coverage_factor_of(freedom);
            let mut contributions: Vec<Contribution> = parts
                .iter()
                .filter(|(variance, _)| variance.sqrt() > NOTHING * standard_uncertainty)
                .map(|(variance, part)| Contribution {
                    input: part.input.clone(),
                    standard_uncertainty: variance.sqrt(),
                })
                .collect();
            contributions.sort_by(|a, b| b.standard_uncertainty.total_cmp(&a.standard_uncertainty));
            ParameterBudget {
                name: unknown.name.clone(),
                unit: unknown.unit.to_string(),
                standard_uncertainty,
                stated_standard_uncertainty: self.parts.iter().map(variance).sum::<f64>().sqrt(),
                degrees_of_freedom: freedom.is_finite().then_some(freedom),
                coverage_factor,
                expanded_uncertainty: coverage_factor * standard_uncertainty,
                contributions,
            }
        });
        let parameters: Vec<ParameterBudget> = parameters.collect();
        let of_machine = problem.unknowns.iter().zip(&parameters).filter(|(unknown, _)| unknown.is_of_machine());
        let freedom =
            of_machine.filter_map(|(_, parameter)| parameter.degrees_of_freedom).fold(f64::INFINITY, f64::min);
        let ellipsoid_factor = joint_coverage_factor(machine.max(1), probability, freedom);
        UncertaintyBudget {
            coverage_probability: probability,
            scale: match self.scales {
                AposterioriFactors::Common(scale, _) => scale,
                AposterioriFactors::PerSet(_) => 1.0,
            },
            joint: JointCoverage {
                quantities: machine,
                degrees_of_freedom: freedom.is_finite().then_some(freedom),
                ellipsoid_factor: Some(ellipsoid_factor).filter(|factor| factor.is_finite()),
                rectangle_factor: rectangular_coverage_factor(machine.max(1), probability, freedom),
            },
            parameters,
            correlations: correlations(problem, &self.covariance(problem)),
        }
    }
}

/// Adds what repeats and known inputs do; gives the covariance of the unknowns with what is considered.
fn propagate_shared(
    at: &Linearisation<'_>,
    repeated_together: &[RepeatedTogether],
    parts: &mut Vec<Part>,
) -> Result<Vec<Vec<f64>>> {
    let Linearisation { problem, x, kept, root: covariance_root } = at;
    let (problem, x, kept) = (*problem, *x, *kept);
    let (own, considered) = (problem.unknowns.len(), &problem.considered);
    if considered.unknowns.is_empty() && repeated_together.is_empty() {
        return Ok(vec![Vec::new(); own]);
    }
    let mut extended = problem.with_values(x);
    extended.unknowns.extend(considered.unknowns.iter().cloned());
    let columns: Vec<Vec<f64>> =
        repeated_together.iter().flat_map(|together| together.pooled.deviations.clone()).collect();
    let answer =
        covariance_root.sensitivities(&Weighted::with_columns(&extended, &columns)?.factor(&extended.start(), kept)?);
    Ok(shared(problem, repeated_together, &answer, parts))
}

/// The same from the sensitivities of the estimates (unknowns x columns) to what is considered, and to the deviations of repeats.
fn shared(
    problem: &Problem,
    repeated_together: &[RepeatedTogether],
    answer: &[Vec<f64>],
    parts: &mut Vec<Part>,
) -> Vec<Vec<f64>> {
    let (own, considered) = (problem.unknowns.len(), &problem.considered);
    let mut first = considered.unknowns.len();
    for together in repeated_together {
        let (pooled, repetitions) = (&together.pooled, together.pooled.repetitions.len());
        let degrees_of_freedom = pooled.degrees_of_freedom as f64;
        let names: Vec<&str> = together.sets.iter().map(|&set| problem.sets[set].name.as_str()).collect();
        let root: Vec<&[f64]> = answer.iter().map(|row| &row[first..first + repetitions]).collect();
        parts.push(Part {
            input: format!("{} (repeats pooled by {})", names.join(", "), pooled.by),
            covariance: symmetric(own, |row, column| dot(root[row], root[column]) / degrees_of_freedom),
            stated: false,
            scale: 1.0,
            degrees_of_freedom,
        });
        first += repetitions;
    }
    let mut sources: Vec<&String> = Vec::new();
    for source in &considered.sources {
        if !sources.contains(&source) {
            sources.push(source);
        }
    }
    let mut cross = vec![vec![0.0; considered.unknowns.len()]; own];
    for source in sources {
        let members: Vec<usize> =
            (0..considered.sources.len()).filter(|&index| considered.sources[index] == *source).collect();
        let spread = |row: &[f64], column: usize| -> f64 {
            members.iter().map(|&member| row[member] * considered.covariance[member][column]).sum()
        };
        let of_source: Vec<Vec<f64>> =
            answer.iter().map(|row| members.iter().map(|&column| spread(row, column)).collect()).collect();
        for (row, of_source) in cross.iter_mut().zip(&of_source) {
            members.iter().zip(of_source).for_each(|(&member, value)| row[member] += value);
        }
        let own_answer = |row: usize| -> Vec<f64> { members.iter().map(|&member| answer[row][member]).collect() };
        let covariance = symmetric(own, |row, column| dot(&of_source[row], &own_answer(column)));
        let degrees_of_freedom = f64::INFINITY;
        parts.push(Part { input: source.clone(), covariance, stated: false, scale: 1.0, degrees_of_freedom });
    }
    cross
}

/// A symmetric matrix from the entries of its lower triangle.
fn symmetric(size: usize, entry: impl Fn(usize, usize) -> f64) -> Vec<Vec<f64>> {
    (0..size).map(|row| (0..size).map(|column| entry(row.max(column), row.min(column))).collect()).collect()
}

/// Pairs of unknowns with an absolute correlation above [`STRONG`], the strongest first.
fn correlations(problem: &Problem, covariance: &[Vec<f64>]) -> Vec<Correlated> {
    let mut pairs = Vec::new();
    for (row, one) in problem.unknowns.iter().enumerate() {
        for (column, other) in problem.unknowns.iter().enumerate().take(row) {
            let correlation = covariance[row][column] / (covariance[row][row] * covariance[column][column]).sqrt();
            if correlation.abs() > STRONG {
                pairs.push(Correlated { one: other.name.clone(), other: one.name.clone(), correlation });
            }
        }
    }
    let size = |pair: &Correlated| (pair.correlation.abs() * 1e6).round();
    pairs.sort_by(|a, b| size(b).total_cmp(&size(a)));
    pairs
}
