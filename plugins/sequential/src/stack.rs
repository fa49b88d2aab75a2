//! New rows and what is known, as one least squares problem.

use abbe_core::{Error, Problem, Result};
use abbe_estimation::Weighted;
use abbe_numerics::{Accumulator, Factor, LeastSquares, Sink};

use crate::knowledge::{Knowledge, States};

/// The rows of a problem of states, then those of what is known of them.
pub struct Stack<'a> {
    pub states: &'a States,
    pub knowledge: Option<&'a Knowledge>,
    rows: Weighted<'a>,
}

impl<'a> Stack<'a> {
    pub fn new(states: &'a States, knowledge: Option<&'a Knowledge>) -> Result<Self> {
        Ok(Self { states, knowledge, rows: Weighted::new(&states.problem)? })
    }

    /// Rows that something is known of.
    pub fn known(&self) -> usize {
        self.knowledge.map_or(0, |known| known.places.len())
    }

    /// The rows of what is known at `z`: residuals, and derivatives to all states.
    pub fn known_rows(&self, z: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let Some(known) = self.knowledge else { return (Vec::new(), Vec::new()) };
        let (count, rows) = (z.len(), known.places.len());
        let off: Vec<f64> = known.places.iter().zip(&known.values).map(|(&place, value)| z[place] - value).collect();
        let mut derivatives = vec![0.0; rows * count];
        let mut residuals = vec![0.0; rows];
        for row in 0..rows {
            for (column, &place) in known.places.iter().enumerate() {
                derivatives[row * count + place] = known.root[(row, column)];
                residuals[row] += known.root[(row, column)] * off[column];
            }
        }
        (residuals, derivatives)
    }

    /// Calls `put` with residual, derivatives to all states and inputs, and whether the row scatters, for every row at `z`: those
    /// of the problem, then those of what is known. Rows of certificates do not scatter; their inputs have their uncertainty.
    pub fn each_row(&self, z: &[f64], mut put: impl FnMut(f64, &[f64], bool)) -> Result<()> {
        let problem = self.states.problem.with_values(z);
        let mut extended = problem.clone();
        let inputs = self.states.inputs.iter().map(|&(place, _)| problem.considered.unknowns[place].clone());
        extended.unknowns.extend(inputs);
        let constraints = problem.constraints();
        let width = extended.unknowns.len();
        Weighted::new(&extended)?.linearise(&extended.start(), &mut |first, residuals, derivatives| {
            for (row, residual) in residuals.iter().enumerate() {
                put(*residual, &derivatives[row * width..(row + 1) * width], !constraints[first + row]);
            }
        })?;
        let (residuals, derivatives) = self.known_rows(z);
        let count = z.len();
        for (row, residual) in residuals.into_iter().enumerate() {
            let mut line = derivatives[row * count..(row + 1) * count].to_vec();
            line.extend(
                self.knowledge.iter().flat_map(|known| known.by_input.row(row).iter().copied().collect::<Vec<_>>()),
            );
            put(residual, &line, true);
        }
        Ok(())
    }

    /// The factor of rows that were judged elsewhere, with those of what is known.
    pub fn with_known(&self, judged: &Factor) -> Factor {
        let count = judged.unknowns();
        let columns: Vec<Vec<f64>> = (0..count).map(|column| judged.column(column)).collect();
        let mut accumulator = Accumulator::new(count, count + self.known());
        for row in 0..count {
            let line: Vec<f64> = columns.iter().map(|column| column[row]).collect();
            accumulator.push(&line, 0.0, 1.0);
        }
        let (_, derivatives) = self.known_rows(&vec![0.0; count]);
        derivatives.chunks_exact(count.max(1)).for_each(|line| accumulator.push(line, 0.0, 1.0));
        accumulator.finish()
    }
}

impl LeastSquares for Stack<'_> {
    type Error = Error;

    fn is_final(&self, error: &Error) -> bool {
        self.rows.is_final(error)
    }

    fn is_out_of_time(&self, error: &Error) -> bool {
        self.rows.is_out_of_time(error)
    }

    fn has_stepped(&self, iteration: usize, size: f64) {
        self.rows.has_stepped(iteration, size);
    }

    fn unknowns(&self) -> usize {
        self.rows.unknowns()
    }

    fn rows(&self) -> usize {
        self.rows.rows() + self.known()
    }

    fn linearise(&self, x: &[f64], sink: Sink<'_>) -> Result<()> {
        self.rows.linearise(x, &mut *sink)?;
        let (residuals, derivatives) = self.known_rows(x);
        if !residuals.is_empty() {
            sink(self.rows.rows(), &residuals, &derivatives);
        }
        Ok(())
    }
}

/// The name of what a row of a problem tells: its file and line.
pub fn row_name(problem: &Problem, equation: usize) -> Option<String> {
    let (set, row) = *problem.equation_rows().get(equation)?;
    let stage = &problem.sets[set].name;
    let found = problem.origin(set, row);
    Some(found.map_or(format!("a certificate of `{stage}`"), |(file, origin)| {
        format!("the row of `{stage}` in {}:{}", file.display(), origin.line)
    }))
}
