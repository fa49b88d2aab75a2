//! Robust estimates from rows in parts: each pass asks all parts for their rows, weighed where they are linearised.

use std::collections::BTreeMap;

use abbe_core::{
    AskedOfPart, EquationIndex, Error, PartEvidence, Problem, Quantity, ResidualSums, Result, SetIndex, SizeSums,
    Triangle, Unknown, WeighedSums,
};
use abbe_numerics::{
    Accumulator, HuberPoint, InPasses, LeastSquares, Robust, RobustPass, RobustReport, RowWeight, Weighing,
};

use crate::judgement::Judgement;
use crate::parts::{RowsInParts, check, in_contact, of_no_rows, triangle};
use crate::residuals::{outliers, point_squares};
use crate::weighted::Weighted;

/// Width of a class of sizes, as a part of the size.
const SIZE_CLASS: f64 = 2e-3;

/// Width of a class of slopes.
const SLOPE_CLASS: f64 = 1e-3;

/// Where the rows of a part are weighed: the unknowns of the whole problem.
struct Place<'a> {
    names: &'a BTreeMap<&'a str, usize>,
    x: &'a [f64],
    weighing: &'a Weighing,
}

/// The rows of a part with their weights.
struct Weighed {
    weights: Vec<RowWeight>,
    factor: Triangle,
}

impl Place<'_> {
    /// Where the unknowns of a part stand among all.
    fn columns(&self, problem: &Problem) -> Result<Vec<usize>> {
        let place = |unknown: &Unknown| self.names.get(unknown.name.as_str()).copied();
        let columns: Option<Vec<usize>> = problem.unknowns.iter().map(place).collect();
        columns.ok_or_else(|| Error::data("a part of the rows has an unknown that all rows together have not"))
    }

    fn values(&self, columns: &[usize]) -> Vec<f64> {
        columns.iter().map(|column| self.x[*column]).collect()
    }

    fn weighed(&self, problem: &Problem) -> Result<Weighed> {
        check(problem)?;
        let rows = Weighted::new(problem)?;
        if rows.is_correlated() {
            let error = Error::usage("robust weights need rows that are independent, and these are given a covariance");
            return Err(error.help("leave out `robust`, or the covariance under `uncertainty` of the artefacts"));
        }
        let (columns, count) = (self.columns(problem)?, self.x.len());
        let own: Vec<String> = problem.unknowns.iter().map(|unknown| unknown.name.clone()).collect();
        let constraints = problem.constraints();
        let mut accumulator = Accumulator::new(own.len(), rows.rows());
        let (mut weights, mut wide) = (Vec::with_capacity(rows.rows()), Vec::new());
        rows.linearise(&self.values(&columns), &mut |first, residuals, derivatives| {
            wide.clear();
            wide.resize(residuals.len() * count, 0.0);
            let lines = derivatives.chunks_exact(own.len().max(1));
            for (line, wide) in lines.clone().zip(wide.chunks_exact_mut(count.max(1))) {
                columns.iter().zip(line).for_each(|(column, derivative)| wide[*column] = *derivative);
            }
            let keeps = &constraints[first..first + residuals.len()];
            let found = self.weighing.rows(self.x, residuals, &wide, keeps);
            for ((line, residual), row) in lines.zip(residuals).zip(&found) {
                accumulator.push(line, *residual, row.weight.sqrt());
            }
            weights.extend(found);
        })?;
        Ok(Weighed { weights, factor: triangle(&own, &accumulator.finish()) })
    }

    /// What the rows of a part tell on the way.
    fn pass(&self, problem: &Problem) -> Result<PartEvidence> {
        if problem.equations() == 0 {
            return Ok(without_rows(AskedOfPart::Rows, problem));
        }
        let Weighed { weights, factor } = self.weighed(problem)?;
        let mut sums = WeighedSums::default();
        for (row, constraint) in weights.iter().zip(problem.constraints()) {
            sums.objective += row.loss;
            if constraint {
                continue;
            }
            sums.weights += row.weight;
            sums.slopes += row.slope;
            let size = row.size.abs();
            if size > 0.0 {
                sums.sizes.add((size.ln() / SIZE_CLASS).floor(), size);
            }
        }
        Ok(PartEvidence { recorded: Some(factor), weighed: Some(sums), ..PartEvidence::default() })
    }

    /// What the rows of a part tell at the solution.
    fn solution(&self, problem: &Problem, robust: Robust) -> Result<PartEvidence> {
        if problem.equations() == 0 {
            let PartEvidence { nominal, .. } = without_rows(AskedOfPart::Start, problem);
            return Ok(PartEvidence { nominal, ..without_rows(AskedOfPart::Solution, problem) });
        }
        let Weighed { weights, .. } = self.weighed(problem)?;
        let x = self.values(&self.columns(problem)?);
        let of = |value: fn(&RowWeight) -> f64| weights.iter().map(value).collect::<Vec<f64>>();
        let report = RobustReport {
            weights: of(|row| row.weight),
            studentised: of(|row| row.size),
            slopes: of(|row| row.slope),
        };
        let kept: Vec<f64> = report.weights.iter().map(|weight| f64::from(*weight > 0.0)).collect();
        let own: Vec<String> = problem.unknowns.iter().map(|unknown| unknown.name.clone()).collect();
        let residuals = problem.residuals(&x)?;
        let mut sums = WeighedSums::default();
        for (set, range) in SetIndex::enumerate(&problem.sets).map(|(_, set)| &set.name).zip(problem.equation_ranges())
        {
            let all = range.len();
            let out = range.filter(|equation| kept[*equation] == 0.0).count();
            sums.left_out.insert(set.clone(), (out, all));
        }
        for ((slope, kept), constraint) in report.slopes.iter().zip(&kept).zip(problem.constraints()) {
            if *kept > 0.0 && !constraint {
                sums.used_slopes.add((slope / SLOPE_CLASS).floor(), *slope);
            }
        }
        sums.outliers = outliers(problem, &residuals, &report, robust);
        sums.found = sums.outliers.len();
        let nominal = triangle(&own, Judgement::new(problem, Some(&kept))?.factor());
        Ok(PartEvidence {
            nominal: Some(nominal),
            in_contact: in_contact(problem, &x, Some(&kept))?,
            residuals: Some(used_sums(problem, residuals, &report)?),
            weighed: Some(sums),
            ..PartEvidence::default()
        })
    }
}

/// What a part without rows tells.
fn without_rows(asked: AskedOfPart, problem: &Problem) -> PartEvidence {
    let own: Vec<String> = problem.unknowns.iter().map(|unknown| unknown.name.clone()).collect();
    PartEvidence { weighed: Some(WeighedSums::default()), ..of_no_rows(asked, &own) }
}

/// The sums of the residuals of rows that are not left out; their squares are those of their influences.
fn used_sums(problem: &Problem, residuals: Vec<f64>, report: &RobustReport) -> Result<ResidualSums> {
    let is_used = |equation: EquationIndex| report.weights[equation] > 0.0;
    let quantities = problem.quantities();
    let of = |angles: bool| {
        let own = EquationIndex::enumerate(&residuals)
            .filter(|(equation, _)| is_used(*equation) && (quantities[*equation] == Quantity::Angle) == angles);
        SizeSums::of(own.map(|(_, residual)| *residual))
    };
    let (lengths, angles) = (of(false), of(true));
    let points = point_squares(problem, &residuals, is_used);
    let influences = Weighted::new(problem)?.in_uncertainties(residuals);
    let influences = influences.iter().zip(&report.weights).map(|(residual, weight)| (residual * weight).powi(2));
    Ok(ResidualSums {
        lengths,
        angles,
        weighted_squares: influences.sum(),
        points: (points.len(), points.iter().sum()),
    })
}

/// The error where nobody can weigh rows again.
fn out_of_reach() -> Error {
    Error::usage("`robust` needs rows that can be read again and again, and other processes read these")
        .help("leave it out, or estimate all rows at once: `abbe run`")
        .setting("robust")
}

impl RowsInParts<'_> {
    /// What all rows tell at the solution of a robust estimate.
    pub(crate) fn weighed_solution(&self, x: &[f64], weighing: &Weighing) -> Result<PartEvidence> {
        let Weighing::Held { robust, .. } = weighing else { return Err(out_of_reach()) };
        let place = Place { names: self.columns(), x, weighing };
        self.parts().ask(&|_, problem| place.solution(problem, *robust))?.ok_or_else(out_of_reach)
    }

    /// Where the search for robust weights begins: nothing is known of the scale.
    pub fn huber_start(x: Vec<f64>) -> HuberPoint {
        HuberPoint { x, root: None, scale: f64::INFINITY }
    }
}

impl InPasses for RowsInParts<'_> {
    type Error = Error;

    fn is_final(&self, error: &Error) -> bool {
        error.fatal
    }

    fn has_stepped(&self, passes: usize, size: f64) {
        self.problem().monitor.iteration(passes, size);
    }

    fn pass(&self, x: &[f64], weighing: &Weighing) -> Result<RobustPass> {
        let place = Place { names: self.columns(), x, weighing };
        let all = self.parts().ask(&|_, problem| place.pass(problem))?.ok_or_else(out_of_reach)?;
        let sums = all.weighed.as_ref().ok_or_else(out_of_reach)?;
        Ok(RobustPass {
            factor: self.joined(x.len(), std::iter::once(all.recorded.as_ref()))?,
            objective: sums.objective,
            weights: sums.weights,
            slopes: sums.slopes,
            sizes: sums.sizes.counted(),
        })
    }
}
