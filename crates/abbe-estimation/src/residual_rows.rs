//! The residuals of a fit one by one, each with the row that it is of.

use abbe_core::{Axis, DataRow, EquationIndex, Evaluation, Fit, Quantity, Result, RowIndex, SetIndex};

/// The residual of an equation of a row that was measured.
#[derive(Debug, Clone, PartialEq)]
pub struct RowResidual {
    /// The observations that it belongs to.
    pub set: SetIndex,
    /// The row of these observations.
    pub row: RowIndex,
    /// The row of the data set.
    pub data_row: DataRow,
    /// Whether it is of an angle.
    pub is_angle: bool,
    /// The residual, mm or rad.
    pub value: f64,
    /// Standard uncertainty of the equation, mm or rad.
    pub uncertainty: f64,
    /// Tip in the table frame, mm; none for an equation without a pose.
    pub tip: Option<[f64; 3]>,
    /// Unit direction in which the residual grows when the tip moves, table frame; none if it depends on no tip.
    pub direction: Option<[f64; 3]>,
    /// Commands of the axes of the model at the first pose of the row, mm or rad; NaN for an equation without a pose.
    pub commands: Vec<f64>,
}

/// Rows that are evaluated together.
const CHUNK: usize = 256;

/// The residuals of a fit at its values, in the order of the equations. Fails where the model fails.
pub fn residual_rows(fit: &Fit) -> Result<Vec<RowResidual>> {
    let mut found = Vec::new();
    if fit.problem.sets.is_empty() {
        return Ok(found);
    }
    let problem = fit.problem.starting_from(&fit.calibration);
    let x = problem.values_of(&fit.calibration);
    let (residuals, quantities) = (problem.residuals(&x)?, problem.quantities());
    let problem = problem.with_values(&x);
    let uncertainties = problem.standard_uncertainties();
    let axes = &problem.model.info().axes;
    let mut equation = 0;
    let mut work = Evaluation::default();
    for index in SetIndex::first(problem.sets.len()) {
        let set = &problem.sets[index];
        let layout = &set.info().layout;
        for rows in set.rows.chunks(CHUNK) {
            problem.evaluate(index, rows, &[], &mut work)?;
            let (mut pose, mut slope) = (0, 0);
            for &row in rows {
                let its = &layout.rows[row];
                let first = its.poses > 0;
                let status = its.pose_indices().next().map(|pose| set.poses().row(pose));
                let command = |axis: &Axis| status.map_or(f64::NAN, |status| status[axis.status]);
                let commands: Vec<f64> = axes.iter().map(command).collect();
                let tip = first.then(|| work.poses.positions[pose]);
                pose += its.poses;
                for _ in 0..its.equations {
                    let at = EquationIndex(equation);
                    equation += 1;
                    let direction =
                        work.equations.by_position().get(slope).filter(|_| first).copied().and_then(of_length_one);
                    slope += its.poses;
                    let Some(data_row) = its.data_row else { continue };
                    found.push(RowResidual {
                        set: index,
                        row,
                        data_row,
                        is_angle: quantities[at] == Quantity::Angle,
                        value: residuals[at],
                        uncertainty: uncertainties[at],
                        tip,
                        direction,
                        commands: commands.clone(),
                    });
                }
            }
        }
    }
    Ok(found)
}

/// A direction of length 1; none of what has no direction.
fn of_length_one(slope: [f64; 3]) -> Option<[f64; 3]> {
    let size = slope.iter().map(|part| part * part).sum::<f64>().sqrt();
    (size > 0.0 && size.is_finite()).then(|| slope.map(|part| part / size))
}
