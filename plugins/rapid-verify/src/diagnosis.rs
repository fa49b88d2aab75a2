//! The cause of a pattern of deviations: the machine error, the change of the artefact or the failing touches that explain it
//! best.
//!
//! Differences between healthy runs (probing, seat of the artefact, its temperature) are no fault. Deviations are weighted
//! with the covariance of these differences, `C = sigma² I + sum e e^T`. A pattern that a poor seat could produce therefore
//! counts as a fault only as far as it is larger than usual for seats. For each candidate one size is fitted by generalised
//! least squares. Touches with errors of their own are set apart one at a time, as long as each explains far more than chance
//! would.

use nalgebra::{Cholesky, DMatrix, DVector};

/// What one cause does to the readings of all points, per unit of its size.
#[derive(Debug, Clone, PartialEq)]
pub struct Pattern {
    /// Its name: a parameter, or what happened to the artefact.
    pub name: String,
    /// Unit of its size, as parameters have it.
    pub unit: abbe_core::Unit,
    /// Derivative of every reading to the size, mm/unit.
    pub effect: Vec<f64>,
    /// Indices of the model parameters that change by the size; none for a change of the artefact.
    pub parameters: Vec<usize>,
}

/// The scatter between healthy runs.
#[derive(Debug, Clone, PartialEq)]
pub struct Scatter {
    /// Standard deviation of one reading by itself, mm.
    pub point: f64,
    /// Patterns that vary from run to run, each of one standard deviation: the change of every reading, mm.
    pub common: Vec<Vec<f64>>,
}

/// A cause with its size.
#[derive(Debug, Clone, PartialEq)]
pub struct Cause {
    /// Index among the patterns.
    pub pattern: usize,
    /// Size, in its unit.
    pub size: f64,
    /// Part of the weighted sum of squares that it explains, 0 to 1, once the failing touches are set apart.
    pub explained: f64,
    /// Difference of its score from the best one, as a weighted sum of squares.
    pub score_difference: f64,
}

/// What explains the deviations of a run.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Diagnosis {
    /// The best cause and those that cannot be told from it; empty if failing touches, or nothing, explain the run.
    pub causes: Vec<Cause>,
    /// Other causes that explain this run nearly as well.
    pub rivals: Vec<Cause>,
    /// Points whose touches have errors of their own, worst first.
    pub touches: Vec<usize>,
    /// Weighted sum of squares that is not explained, and its degrees of freedom.
    pub unexplained: (f64, usize),
    /// Weighted sum of squares that is left, and what causes and touches cost: the smaller, the better the explanation.
    pub score: f64,
}

impl Diagnosis {
    /// Whether the rest is the scatter of healthy runs: within five standard deviations of chi-squared.
    pub fn is_complete(&self) -> bool {
        let (squares, freedom) = self.unexplained;
        squares <= freedom as f64 + 5.0 * (2.0 * freedom as f64).sqrt()
    }
}

/// Weighted sum of squares that one more failing touch has to explain: the square of five standard deviations, far above the
/// largest of some dozens of readings.
const TOUCH: f64 = 25.0;

/// Weighted sum of squares that a cause has to explain before it is named: the square of three standard deviations.
pub(crate) const CAUSE: f64 = 9.0;

/// Patterns with a smaller angle between them are the same: no measurement of these points separates them.
const SAME: f64 = 1e-3;

/// Finds the causes of deviations, from the patterns of the candidates and the scatter of the readings.
pub struct Diagnoser<'a> {
    patterns: &'a [Pattern],
    cholesky: Cholesky<f64, nalgebra::Dyn>,
    /// Patterns in weighted readings.
    weighted: Vec<DVector<f64>>,
    /// Single readings in weighted readings.
    single: Vec<DVector<f64>>,
}

/// One explanation: a cause or none, and failing touches.
struct Explanation {
    cause: Option<usize>,
    touches: Vec<usize>,
    unexplained: f64,
    score: f64,
}

impl<'a> Diagnoser<'a> {
    /// None if the scatter of a reading is not positive.
    pub fn new(patterns: &'a [Pattern], scatter: &Scatter, points: usize) -> Option<Self> {
        let mut covariance = DMatrix::from_diagonal_element(points, points, scatter.point.powi(2));
        for common in &scatter.common {
            let common = DVector::from_column_slice(common);
            covariance += &common * common.transpose();
        }
        let cholesky = covariance.cholesky()?;
        let solve = |vector: DVector<f64>| cholesky.l_dirty().solve_lower_triangular(&vector);
        let weighted: Option<Vec<_>> =
            patterns.iter().map(|pattern| solve(DVector::from_column_slice(&pattern.effect))).collect();
        let unit = |index: usize| DVector::from_fn(points, |row, _| if row == index { 1.0 } else { 0.0 });
        let single: Option<Vec<_>> = (0..points).map(|index| solve(unit(index))).collect();
        Some(Self { patterns, weighted: weighted?, single: single?, cholesky })
    }

    /// Deviations in weighted readings.
    fn weigh(&self, deviations: &[f64]) -> DVector<f64> {
        let deviations = DVector::from_column_slice(deviations);
        self.cholesky.l_dirty().solve_lower_triangular(&deviations).unwrap_or(deviations)
    }

    /// The best explanation of these deviations, mm.
    pub fn diagnose(&self, deviations: &[f64]) -> Diagnosis {
        let deviations = self.weigh(deviations);
        let usable = |index: &usize| self.weighted[*index].norm() > 0.0;
        let mut found = vec![self.explain(None, &deviations)];
        found.extend((0..self.patterns.len()).filter(usable).map(|index| self.explain(Some(index), &deviations)));
        found.sort_by(|one, other| one.score.total_cmp(&other.score));
        let best = &found[0];
        let size_of_all = self.without(&best.touches, &deviations).norm_squared();
        let cause = |explanation: &Explanation| {
            let pattern = explanation.cause?;
            let size = self.size(pattern, &explanation.touches, &deviations);
            let explained = 1.0 - explanation.unexplained / size_of_all.max(f64::MIN_POSITIVE);
            Some(Cause { pattern, size, explained, score_difference: explanation.score - best.score })
        };
        let mut diagnosis = Diagnosis { touches: best.touches.clone(), score: best.score, ..Diagnosis::default() };
        diagnosis.unexplained =
            (best.unexplained, deviations.len() - best.touches.len() - usize::from(best.cause.is_some()));
        let Some(first) = best.cause else { return diagnosis };
        for explanation in &found {
            let Some(cause) = cause(explanation) else { continue };
            if self.same(first, cause.pattern) {
                diagnosis.causes.push(cause);
            } else if explanation.score - best.score < CAUSE {
                diagnosis.rivals.push(cause);
            }
        }
        // Causes with the same pattern have the same score, except for rounding: machine errors come before the artefact, the
        // rest as declared.
        diagnosis.causes.sort_by_key(|cause| (self.patterns[cause.pattern].parameters.is_empty(), cause.pattern));
        diagnosis
    }

    /// Whether two causes have the same pattern.
    pub fn same(&self, one: usize, other: usize) -> bool {
        let of = |index: usize| DVector::from_column_slice(&self.patterns[index].effect).normalize();
        let (one, other) = (of(one), of(other));
        (&one - one.dot(&other) * &other).norm() < SAME
    }

    /// The failing touches that belong to a cause, or to no cause.
    fn explain(&self, cause: Option<usize>, deviations: &DVector<f64>) -> Explanation {
        let mut basis = Basis::default();
        let mut left = deviations.clone();
        if let Some(cause) = cause {
            basis.add(&self.weighted[cause], &mut left);
        }
        let mut touches: Vec<usize> = Vec::new();
        while touches.len() < (deviations.len() / 4).max(2) {
            let gain = |index: usize| basis.gain(&self.single[index], &left);
            let rest = (0..self.single.len()).filter(|index| !touches.contains(index));
            let Some(worst) = rest.max_by(|&one, &other| gain(one).total_cmp(&gain(other))) else { break };
            if gain(worst) < TOUCH {
                break;
            }
            basis.add(&self.single[worst], &mut left);
            touches.push(worst);
        }
        let squares = left.norm_squared();
        let cost = TOUCH * touches.len() as f64 + if cause.is_some() { CAUSE } else { 0.0 };
        Explanation { cause, touches, unexplained: squares, score: squares + cost }
    }

    /// Weighted readings without the parts that failing touches could explain.
    fn without(&self, touches: &[usize], values: &DVector<f64>) -> DVector<f64> {
        let (mut basis, mut left) = (Basis::default(), values.clone());
        touches.iter().for_each(|&touch| basis.add(&self.single[touch], &mut left));
        left
    }

    /// The size of a cause, with failing touches set apart.
    fn size(&self, cause: usize, touches: &[usize], deviations: &DVector<f64>) -> f64 {
        let pattern = self.without(touches, &self.weighted[cause]);
        pattern.dot(deviations) / pattern.norm_squared()
    }

    /// The change of the size that explains the remaining deviations, with failing touches set apart.
    pub fn step(&self, cause: usize, touches: &[usize], left: &[f64]) -> f64 {
        self.size(cause, touches, &self.weigh(left))
    }
}

/// Orthonormal directions that are already explained.
#[derive(Default)]
struct Basis(Vec<DVector<f64>>);

impl Basis {
    /// The part of a vector that is not yet explained; none if this part is only rounding.
    fn new_part(&self, vector: &DVector<f64>) -> Option<DVector<f64>> {
        let mut part = vector.clone();
        // The second pass removes the rounding of the first one.
        for _ in 0..2 {
            for direction in &self.0 {
                part -= direction.dot(&part) * direction;
            }
        }
        (part.norm() > 1e-6 * vector.norm()).then(|| part.normalize())
    }

    /// The additional part of the squares of `left` that a vector would explain.
    fn gain(&self, vector: &DVector<f64>, left: &DVector<f64>) -> f64 {
        self.new_part(vector).map_or(0.0, |part| part.dot(left).powi(2))
    }

    fn add(&mut self, vector: &DVector<f64>, left: &mut DVector<f64>) {
        if let Some(part) = self.new_part(vector) {
            *left -= part.dot(left) * &part;
            self.0.push(part);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use abbe_core::Unit;

    fn pattern(name: &str, effect: &[f64]) -> Pattern {
        Pattern { name: name.to_owned(), unit: Unit::MM, effect: effect.to_vec(), parameters: vec![0] }
    }

    fn patterns() -> Vec<Pattern> {
        vec![
            pattern("a", &[1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0]),
            pattern("b", &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]),
            pattern("b again", &[-2.0, -4.0, -6.0, -8.0, -10.0, -12.0, -14.0, -16.0]),
            pattern("nothing", &[0.0; 8]),
        ]
    }

    #[test]
    fn one_pattern_is_named_with_its_size_and_with_what_has_the_same() {
        let patterns = patterns();
        let diagnoser = Diagnoser::new(&patterns, &Scatter { point: 1e-3, common: Vec::new() }, 8).unwrap();
        let deviations: Vec<f64> = patterns[1].effect.iter().map(|effect| 0.004 * effect).collect();
        let found = diagnoser.diagnose(&deviations);
        let named: Vec<(usize, f64)> = found.causes.iter().map(|cause| (cause.pattern, cause.size)).collect();
        assert_eq!(named.iter().map(|named| named.0).collect::<Vec<_>>(), [1, 2]);
        assert!((named[0].1 - 0.004).abs() < 1e-15 && (named[1].1 + 0.002).abs() < 1e-15, "{named:?}");
        assert!(found.is_complete() && found.touches.is_empty() && found.rivals.is_empty());
    }

    #[test]
    fn what_healthy_runs_do_is_no_fault() {
        let patterns = patterns();
        let common = vec![vec![0.01; 8]];
        let diagnoser = Diagnoser::new(&patterns, &Scatter { point: 1e-3, common }, 8).unwrap();
        let found = diagnoser.diagnose(&[0.012; 8]);
        assert!(found.causes.is_empty() && found.touches.is_empty() && found.is_complete(), "{found:?}");
        let found = diagnoser.diagnose(&[0.1; 8]);
        assert_eq!(found.causes[0].pattern, 0);
    }

    #[test]
    fn single_touches_are_set_apart_from_a_pattern() {
        let patterns = patterns();
        let diagnoser = Diagnoser::new(&patterns, &Scatter { point: 1e-3, common: Vec::new() }, 8).unwrap();
        let mut deviations = vec![0.0; 8];
        deviations[6] = 5.5;
        let found = diagnoser.diagnose(&deviations);
        assert!(found.causes.is_empty() && found.touches == [6] && found.is_complete(), "{found:?}");
        for (deviation, effect) in deviations.iter_mut().zip(&patterns[1].effect) {
            *deviation += 0.004 * effect;
        }
        let found = diagnoser.diagnose(&deviations);
        assert_eq!((found.causes[0].pattern, found.touches.as_slice()), (1, &[6][..]));
        assert!((found.causes[0].size - 0.004).abs() < 1e-12, "{found:?}");
    }

    #[test]
    fn deviations_that_nothing_explains_are_not_complete() {
        let patterns = patterns();
        let diagnoser = Diagnoser::new(&patterns, &Scatter { point: 1e-3, common: Vec::new() }, 8).unwrap();
        let found = diagnoser.diagnose(&[0.02, -0.02, 0.02, -0.02, 0.02, -0.02, 0.02, -0.02]);
        assert!(!found.is_complete(), "{found:?}");
    }
}
