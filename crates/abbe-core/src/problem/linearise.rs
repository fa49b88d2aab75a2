//! Residuals and derivatives of a problem: the chain rule over the poses of the model and the equations of the artefacts.

use std::ops::Range;
use std::sync::mpsc::{channel, sync_channel};

use super::evaluation::Evaluation;
use super::rows::ObservationSet;
use super::{Owner, Problem};
use crate::index::{EquationIndex, IndexRange, ListedBy, RowIndex, SetIndex};
use crate::model::{PoseBatch, Poses, Variable};
use crate::observations::{Contact, Equations, Orientation};
use abbe_settings::{Error, Result, free_threads};

/// Rows that are evaluated together: enough to amortise a call, few enough for their derivatives to stay in the cache.
pub const CHUNK: usize = 128;

/// Residuals and derivatives of some equations of a problem; equations come in the order of sets and rows.
#[derive(Debug)]
pub struct Block<'a> {
    /// The first equation of the block.
    pub first: EquationIndex,
    /// Residuals, mm or rad.
    pub residuals: &'a [f64],
    /// Derivatives, equations x unknowns, row by row.
    pub jacobian: &'a [f64],
}

impl Block<'_> {
    /// Its equations.
    pub fn equations(&self) -> IndexRange<EquationIndex> {
        IndexRange::new(self.first, self.residuals.len())
    }

    /// Its equations, each with its residual and its derivatives.
    pub fn lines(&self) -> impl Iterator<Item = (EquationIndex, f64, &[f64])> {
        lines(self.first, self.residuals, self.jacobian)
    }
}

/// Residuals and derivatives of some equations of a problem, without the columns that are zero in all of them.
///
/// The rows of a run depend on a part of the unknowns: of hundreds, some tens.
#[derive(Debug)]
pub struct CompactBlock<'a> {
    /// The first equation of the block.
    pub first: EquationIndex,
    /// Residuals, mm or rad.
    pub residuals: &'a [f64],
    /// The indices of the unknowns that the derivatives are to, ascending. Derivatives to all others are zero.
    pub unknowns: &'a [usize],
    /// Derivatives, equations x these unknowns, row by row.
    pub derivatives: &'a [f64],
}

impl CompactBlock<'_> {
    /// Its equations, each with its residual and its derivatives to the unknowns of the block.
    pub fn lines(&self) -> impl Iterator<Item = (EquationIndex, f64, &[f64])> {
        lines(self.first, self.residuals, self.derivatives)
    }

    /// Its derivatives to all of `count` unknowns, equations x unknowns, row by row.
    pub fn fill(&self, count: usize, jacobian: &mut Vec<f64>) {
        jacobian.clear();
        jacobian.resize(self.residuals.len() * count, 0.0);
        for ((_, _, derivatives), line) in self.lines().zip(jacobian.chunks_exact_mut(count.max(1))) {
            self.unknowns.iter().zip(derivatives).for_each(|(&unknown, derivative)| line[unknown] = *derivative);
        }
    }
}

fn lines<'a>(
    first: EquationIndex,
    residuals: &'a [f64],
    derivatives: &'a [f64],
) -> impl Iterator<Item = (EquationIndex, f64, &'a [f64])> {
    let width = derivatives.len() / residuals.len().max(1);
    IndexRange::new(first, residuals.len())
        .zip(residuals)
        .enumerate()
        .map(move |(line, (equation, residual))| (equation, *residual, &derivatives[line * width..(line + 1) * width]))
}

impl Problem {
    /// Residuals at `x`, in the order of the equations.
    pub fn residuals(&self, x: &[f64]) -> Result<Vec<f64>> {
        let mut residuals = Vec::with_capacity(self.equations());
        let problem = self.without_unknowns(|_| true);
        problem.at_values(self, x).linearise(&[], |block| residuals.extend_from_slice(block.residuals))?;
        Ok(residuals)
    }

    fn at_values(mut self, other: &Self, x: &[f64]) -> Self {
        let values = other.with_values(x);
        self.machine_values = values.machine_values;
        for (set, with) in self.sets.iter_mut().zip(values.sets) {
            set.own = with.own;
        }
        self
    }

    /// Residuals and derivatives at `x`, block by block, in the order of the equations.
    ///
    /// If there is much to do and a core is free, the next blocks are evaluated while `sink` processes the last one.
    pub fn linearise(&self, x: &[f64], mut sink: impl FnMut(Block<'_>)) -> Result<()> {
        let mut jacobian = Vec::new();
        self.linearise_compact(x, |block| {
            block.fill(self.unknowns.len(), &mut jacobian);
            sink(Block { first: block.first, residuals: block.residuals, jacobian: &jacobian });
        })
    }

    /// The same without the columns that are zero in a whole block.
    pub fn linearise_compact(&self, x: &[f64], mut sink: impl FnMut(CompactBlock<'_>)) -> Result<()> {
        let at = self.with_values(x);
        let columns = Columns::of(self);
        let chunks: Vec<(SetIndex, &[RowIndex])> = SetIndex::enumerate(&at.sets)
            .flat_map(|(set, of)| of.rows.chunks(CHUNK).map(move |rows| (set, rows)))
            .collect();
        let mut first = EquationIndex(0);
        let mut take = |linear: &Linearised| {
            sink(linear.block(first));
            first += linear.residuals.len();
        };
        let threads = self.threads(self.unknowns.len());
        if threads > 1 && at.linearise_on(threads, &columns, &chunks, &mut take)? {
            return Ok(());
        }
        let (mut work, mut linear) = (Evaluation::default(), Linearised::default());
        for (set, rows) in chunks {
            at.linearise_rows(set, rows, &columns, &mut work, &mut linear)?;
            take(&linear);
        }
        Ok(())
    }

    /// Evaluates chunks on threads, and takes the results in their order. False, and nothing taken, where the system gives no threads.
    fn linearise_on(
        &self,
        threads: usize,
        columns: &Columns,
        chunks: &[(SetIndex, &[RowIndex])],
        take: &mut dyn FnMut(&Linearised),
    ) -> Result<bool> {
        std::thread::scope(|scope| {
            // Thread k evaluates the chunks k, k + threads, and so on. The results are taken from the threads in turn.
            let mut from = Vec::with_capacity(threads);
            for first in 0..threads {
                let (send, receive) = sync_channel::<Result<Linearised>>(AHEAD);
                let (give_back, used) = channel::<Linearised>();
                let evaluate = move || {
                    let mut work = Evaluation::default();
                    for &(set, rows) in chunks.iter().skip(first).step_by(threads) {
                        let mut linear = used.try_recv().unwrap_or_default();
                        let done = self.linearise_rows(set, rows, columns, &mut work, &mut linear).map(|()| linear);
                        let failed = done.is_err();
                        // After an error, or without all threads, nothing more is received.
                        if send.send(done).is_err() || failed {
                            return;
                        }
                    }
                };
                if std::thread::Builder::new().spawn_scoped(scope, evaluate).is_err() {
                    return Ok(false);
                }
                from.push((receive, give_back));
            }
            for (receive, give_back) in from.iter().cycle() {
                // The first thread without a result would have had the next chunk: all chunks are done.
                let Ok(linear) = receive.recv() else { break };
                let linear = linear?;
                take(&linear);
                // The thread may have ended; this is no error.
                let _ = give_back.send(linear);
            }
            Ok(true)
        })
    }

    /// Number of threads for an evaluation of all rows with derivatives to this many variables; 1 if more would not save
    /// time.
    pub fn threads(&self, variables: usize) -> usize {
        let work = self.equations() * (POSE + variables);
        if work < WORTH_A_THREAD { 1 } else { free_threads() }
    }

    /// Residuals and derivatives of some rows of a set at the problem's own values.
    pub(super) fn linearise_rows(
        &self,
        index: SetIndex,
        rows: &[RowIndex],
        columns: &Columns,
        work: &mut Evaluation,
        out: &mut Linearised,
    ) -> Result<()> {
        let set = &self.sets[index];
        self.evaluate_rows(index, rows, columns, work)?;
        let of_rows = columns.of_rows(index, &work.equations);
        let (count, place) = (of_rows.len(), |column: usize| of_rows.partition_point(|other| *other < column));
        let equations = work.equations.residuals.len();
        out.residuals.clear();
        out.residuals.extend_from_slice(&work.equations.residuals);
        let mut jacobian = std::mem::take(&mut work.jacobian);
        jacobian.clear();
        jacobian.resize(equations * count, 0.0);
        let places = work.factored.terms.iter().map(|&(variable, _)| {
            let (column, factor) = columns.machine[variable];
            (place(column), factor)
        });
        let places: Vec<(usize, f64)> = places.collect();
        work.chain_factored(set, rows, &places, count, &mut jacobian);
        columns.each_own(index, &work.equations, |equation, (column, factor), derivative| {
            jacobian[equation * count + place(column)] += factor * derivative;
        });
        out.keep_columns(&mut jacobian, &of_rows);
        work.jacobian = jacobian;
        Ok(())
    }

    /// Evaluates poses, with derivatives in factors, and equations of some rows of a set at the problem's own values.
    pub(super) fn evaluate_rows(
        &self,
        index: SetIndex,
        rows: &[RowIndex],
        columns: &Columns,
        work: &mut Evaluation,
    ) -> Result<()> {
        let set = &self.sets[index];
        self.monitor.check()?;
        self.evaluate_factored(set, &columns.wanted, rows, work).map_err(|error| self.of_row(index, rows, error))?;
        self.equations_of(set, rows, &work.factored.poses, &mut work.equations)?;
        let of_positions = || work.equations.by_position.iter().any(|by| *by != [0.0; 3]);
        if set.info().orientation == Orientation::FirstOrder && of_positions() {
            self.add_positions(&work.statuses, &columns.wanted, &mut work.factored)?;
        }
        Ok(())
    }

    /// Evaluates poses and equations of some rows of a set at the problem's own values.
    pub fn evaluate(&self, set: SetIndex, rows: &[RowIndex], wanted: &[Variable], work: &mut Evaluation) -> Result<()> {
        self.monitor.check()?;
        self.evaluate_poses(set, rows, wanted, work).map_err(|error| self.of_row(set, rows, error))?;
        self.equations_of(&self.sets[set], rows, &work.poses, &mut work.equations)
    }

    /// Evaluates rows again that have moved, and keeps the derivatives of their poses as they were.
    pub fn evaluate_again(&self, set: SetIndex, rows: &[RowIndex], work: &mut Evaluation) -> Result<()> {
        let Poses { position_derivatives, rotation_derivatives, .. } = std::mem::take(&mut work.poses);
        self.evaluate(set, rows, &[], work)?;
        work.poses.position_derivatives = position_derivatives;
        work.poses.rotation_derivatives = rotation_derivatives;
        Ok(())
    }

    /// The equations of some rows at their poses.
    fn equations_of(&self, set: &ObservationSet, rows: &[RowIndex], poses: &Poses, out: &mut Equations) -> Result<()> {
        out.clear();
        let inputs = set.inputs_with(&self.machine_values);
        set.observations.evaluate(set.batch(rows, poses, &inputs), out)?;
        if let Some(disturbances) = &set.disturbances {
            let residuals = out.residuals.iter_mut().zip(set.equations_of(rows));
            residuals.for_each(|(value, equation)| *value += disturbances[equation]);
        }
        Ok(())
    }

    fn evaluate_poses(
        &self,
        set: SetIndex,
        rows: &[RowIndex],
        wanted: &[Variable],
        work: &mut Evaluation,
    ) -> Result<()> {
        let set = &self.sets[set];
        work.take_statuses(set, rows);
        match set.info().orientation {
            Orientation::FirstOrder => {
                self.first_order(&work.statuses, wanted, &mut work.factored)?;
                self.add_positions(&work.statuses, wanted, &mut work.factored)?;
                work.factored.write(wanted.len(), &mut work.poses);
                Ok(())
            }
            orientation => {
                let exact = orientation == Orientation::Exact;
                self.model.poses(&work.statuses, &self.machine_values, wanted, exact, &mut work.poses)
            }
        }
    }

    /// The same with derivatives in factors.
    fn evaluate_factored(
        &self,
        set: &ObservationSet,
        wanted: &[Variable],
        rows: &[RowIndex],
        work: &mut Evaluation,
    ) -> Result<()> {
        work.take_statuses(set, rows);
        let Evaluation { statuses, factored, .. } = work;
        match set.info().orientation {
            Orientation::FirstOrder => self.first_order(statuses, wanted, factored),
            orientation => {
                let (values, orientation) = (&self.machine_values, orientation == Orientation::Exact);
                self.model.factored(PoseBatch { statuses, values, wanted, orientation }, factored)
            }
        }
    }

    /// An error with the place of the row whose pose it names.
    fn of_row(&self, set: SetIndex, rows: &[RowIndex], mut error: Error) -> Error {
        let Some(pose) = error.pose.take().filter(|_| error.place.is_none()) else { return error };
        let poses = |row: &&RowIndex| self.sets[set].poses_of(std::slice::from_ref(*row)).count();
        let mut before = 0;
        let row = rows.iter().find(|row| {
            before += poses(row);
            before > pose
        });
        let error = match row {
            Some(&row) => self.error_at_row(set, row, error),
            None => error,
        };
        let recorded = self.sets[set].moved.is_none() || self.sets[set].info().contact != Contact::LinearAxes;
        match &error.help {
            Some(help) if !recorded => {
                let help = format!(
                    "{help}; the place is where the model meets the artefact: if the row has another, check stylus and placement"
                );
                error.help(help)
            }
            _ => error,
        }
    }
}

/// Columns of the Jacobian of a problem.
pub(super) struct Columns {
    /// The parameters of the model that are unknown, and the column of each with its factor there.
    wanted: Vec<Variable>,
    pub(super) machine: Vec<(usize, f64)>,
    of_sets: Vec<ColumnsOfSet>,
}

/// The columns of a set with their factors; none for what is not unknown.
struct ColumnsOfSet {
    /// Those of its own unknowns.
    own: Vec<Option<(usize, f64)>>,
    /// Those of its known inputs.
    inputs: Vec<Option<(usize, f64)>>,
}

impl ListedBy<SetIndex> for ColumnsOfSet {}

impl Columns {
    pub(super) fn of(problem: &Problem) -> Self {
        let none = |set: &ObservationSet| ColumnsOfSet {
            own: vec![None; set.own.len()],
            inputs: vec![None; set.inputs.len()],
        };
        let (mut wanted, mut machine) = (Vec::new(), Vec::new());
        let mut of_sets: Vec<_> = problem.sets.iter().map(none).collect();
        for (column, unknown) in problem.unknowns.iter().enumerate() {
            let mut parameter = |index: usize, place: (usize, f64)| {
                wanted.push(Variable::Parameter(index));
                machine.push(place);
                for (of_set, set) in of_sets.iter_mut().zip(&problem.sets) {
                    let inputs = of_set.inputs.iter_mut().zip(&set.info().inputs);
                    inputs.filter(|(_, input)| input.of_model == Some(index)).for_each(|(own, _)| *own = Some(place));
                }
            };
            match unknown.owner {
                Owner::Machine => parameter(unknown.index, (column, 1.0)),
                Owner::Tie => {
                    let members = &problem.ties[unknown.index].members;
                    members.iter().for_each(|&(index, factor)| parameter(index, (column, factor)));
                }
                Owner::Set(set) => of_sets[set].own[unknown.index] = Some((column, 1.0)),
                Owner::Input => {
                    for &(set, input) in &problem.inputs[unknown.index].users {
                        of_sets[set].inputs[input] = Some((column, 1.0));
                    }
                }
            }
        }
        Self { wanted, machine, of_sets }
    }

    /// Calls `take` for every derivative of some equations of a set to an own unknown or a known input that is unknown, with the equation,
    /// and the column with its factor.
    pub(super) fn each_own(
        &self,
        set: SetIndex,
        equations: &Equations,
        mut take: impl FnMut(usize, (usize, f64), f64),
    ) {
        let ColumnsOfSet { own, inputs } = &self.of_sets[set];
        let own = equations.by_own.iter().map(|by| (by, own));
        let inputs = equations.by_input.iter().map(|by| (by, inputs));
        for (&(equation, index, derivative), columns) in own.chain(inputs) {
            if let Some(column) = columns[index] {
                take(equation, column, derivative);
            }
        }
    }

    /// The columns that some equations of a set may have, ascending: of many thousands of own unknowns those of these equations alone.
    fn of_rows(&self, set: SetIndex, equations: &Equations) -> Vec<usize> {
        let ColumnsOfSet { own, inputs } = &self.of_sets[set];
        let own = equations.by_own.iter().filter_map(|by| own[by.1]);
        let inputs = equations.by_input.iter().filter_map(|by| inputs[by.1]);
        let all = self.machine.iter().copied().chain(own).chain(inputs);
        let mut columns: Vec<usize> = all.map(|(column, _)| column).collect();
        columns.sort_unstable();
        columns.dedup();
        columns
    }
}

/// Residuals and derivatives of some rows, as in a [`CompactBlock`].
#[derive(Default)]
pub(super) struct Linearised {
    residuals: Vec<f64>,
    unknowns: Vec<usize>,
    derivatives: Vec<f64>,
}

impl Linearised {
    /// As a block that begins with this equation.
    pub(super) fn block(&self, first: EquationIndex) -> CompactBlock<'_> {
        let Self { residuals, unknowns, derivatives } = self;
        CompactBlock { first, residuals, unknowns, derivatives }
    }

    /// Takes the columns of a matrix (row by row, these columns) that are not zero; the room that it had before is left in its place.
    fn keep_columns(&mut self, jacobian: &mut Vec<f64>, columns: &[usize]) {
        let count = columns.len();
        let mut sizes = vec![0.0; count];
        for line in jacobian.chunks_exact(count.max(1)) {
            // This sum is faster than a test of each value. NaN counts as not zero.
            sizes.iter_mut().zip(line).for_each(|(size, value): (&mut f64, _)| *size += value.abs());
        }
        self.unknowns.clear();
        self.unknowns.extend(columns.iter().zip(&sizes).filter(|(_, size)| **size != 0.0).map(|(column, _)| *column));
        if self.unknowns.len() == count {
            return std::mem::swap(&mut self.derivatives, jacobian);
        }
        self.derivatives.clear();
        // Columns that are kept stand side by side more often than not.
        let places: Vec<usize> = (0..count).filter(|place| sizes[*place] != 0.0).collect();
        let runs: Vec<Range<usize>> =
            places.chunk_by(|one, other| one + 1 == *other).map(|run| run[0]..run[0] + run.len()).collect();
        self.derivatives.reserve(self.unknowns.len() * self.residuals.len());
        for line in jacobian.chunks_exact(count.max(1)) {
            runs.iter().for_each(|run| self.derivatives.extend_from_slice(&line[run.clone()]));
        }
    }
}

/// Number of derivatives from which several threads save time.
const WORTH_A_THREAD: usize = 100_000;

/// Cost of a pose without derivatives, as a number of derivatives.
const POSE: usize = 25;

/// Blocks that a thread evaluates ahead of those that are taken.
const AHEAD: usize = 4;
