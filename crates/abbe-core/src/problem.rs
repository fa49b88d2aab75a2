//! A problem: model + observations + chosen unknowns + selected rows.
//!
//! Whoever holds a problem can have it solved again, on other rows (hold-out), with other inputs (Monte Carlo) or from
//! other start values, by any estimator.

use std::ops::Range;
use std::sync::Arc;
use std::sync::mpsc::{channel, sync_channel};

use serde::{Deserialize, Serialize};

use crate::calibration::{Calibration, ModelRecord};
use crate::considered::{Considered, Input, candidates, check_constraints, consider_parameters, inputs};
use crate::dataset::RowOrigin;
use crate::error::{Error, Result};
use crate::model::{KinematicModel, Poses, Variable};
use crate::observations::{Contact, Equations, Observations, PoseValues};
use crate::parallel::{cores, is_one_of_several};
use crate::pattern::matches;
use crate::pose_table::PoseTable;
use crate::uncertainty::{CovarianceBlock, EquationUncertainty, Pooled};
use crate::unit::{Quantity, Unit};

/// Rows that are evaluated together: enough to amortise a call, few enough for their derivatives to stay in the cache.
pub(crate) const CHUNK: usize = 128;

/// The observations of one artefact stage, with the rows that take part.
#[derive(Clone)]
pub struct ObservationSet {
    /// Name of the artefact stage.
    pub name: String,
    /// The observations.
    pub observations: Arc<dyn Observations>,
    /// Indices of the rows that take part, ascending.
    pub rows: Vec<usize>,
    /// Values of the known inputs.
    pub inputs: Vec<f64>,
    /// Who they are, as far as it was declared.
    pub ids: Vec<Option<String>>,
    /// Start or fixed values of the own unknowns.
    pub own: Vec<f64>,
    /// How uncertain the equations are, in the order of the layout.
    pub uncertainty: Arc<EquationUncertainty>,
    /// Statuses that stand in for the recorded ones.
    pub(crate) moved: Option<Arc<PoseTable>>,
    /// What is added to the residuals, in the order of the layout.
    pub(crate) disturbances: Option<Arc<Vec<f64>>>,
}

impl ObservationSet {
    /// All rows of some observations, with their nominal inputs, own unknowns at their start values and equations as
    /// uncertain as the artefact says, independent of one another.
    pub fn new(name: &str, observations: Arc<dyn Observations>) -> Self {
        let standard = observations.layout().standard_uncertainties.clone();
        Self {
            name: name.to_owned(),
            rows: (0..observations.layout().rows.len()).collect(),
            inputs: observations.inputs().iter().map(|input| input.value).collect(),
            ids: vec![None; observations.inputs().len()],
            own: observations.start(),
            uncertainty: Arc::new(EquationUncertainty::independent(standard)),
            moved: None,
            disturbances: None,
            observations,
        }
    }

    /// The statuses of all poses: recorded, or where contact was found.
    pub fn poses(&self) -> &PoseTable {
        self.moved.as_deref().unwrap_or_else(|| &self.observations.layout().poses)
    }

    /// Makes these the statuses of all poses, in the order of the layout, instead of the recorded ones.
    pub fn move_to(&mut self, poses: PoseTable) {
        self.moved = Some(Arc::new(poses));
    }

    /// What is added to the residuals of the equations, in the order of the layout; none if nothing is.
    pub fn disturbances(&self) -> Option<&[f64]> {
        self.disturbances.as_ref().map(|disturbances| disturbances.as_slice())
    }

    /// Makes these what is added to the residuals, in the order of the layout.
    pub fn disturb(&mut self, disturbances: Vec<f64>) {
        self.disturbances = Some(Arc::new(disturbances));
    }

    /// The same observations with other statuses of all poses.
    pub fn with_poses(&self, poses: PoseTable) -> Self {
        Self { moved: Some(Arc::new(poses)), ..self.clone() }
    }

    /// The equations of the rows that take part, in the order of the layout.
    fn taken(&self) -> Vec<usize> {
        let rows = self.rows.iter().map(|&row| self.observations.layout().rows[row]);
        rows.flat_map(|row| row.first_equation..row.first_equation + row.equations).collect()
    }

    /// The poses of some rows.
    pub(crate) fn poses_of<'a>(&'a self, rows: &'a [usize]) -> impl Iterator<Item = usize> + 'a {
        let rows = rows.iter().map(|&row| &self.observations.layout().rows[row]);
        rows.flat_map(|row| row.first_pose..row.first_pose + row.poses)
    }

    fn equations(&self, rows: &[usize]) -> usize {
        rows.iter().map(|&row| self.observations.layout().rows[row].equations).sum()
    }
}

/// Whose an unknown is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Owner {
    /// A parameter of the model.
    Machine,
    /// An own unknown of the observation set with this index.
    Set(usize),
    /// A known input of the problem ([`Problem::inputs`]); never estimated.
    Input,
}

/// Something to be estimated.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Unknown {
    /// Name in results: `EXX[1]`, `table.facet[7].d`.
    pub name: String,
    /// Unit of its value.
    pub unit: Unit,
    /// Whose it is.
    pub owner: Owner,
    /// Its index among the parameters of its owner.
    pub index: usize,
}

/// Residuals and derivatives of some equations of a problem; equations come in the order of sets and rows.
#[derive(Debug)]
pub struct Block<'a> {
    /// The first equation of the block.
    pub first: usize,
    /// Residuals, mm or rad.
    pub residuals: &'a [f64],
    /// Derivatives, equations x unknowns, row by row.
    pub jacobian: &'a [f64],
}

/// The scatter of repeats of some sets of a problem that were repeated together.
#[derive(Debug, Clone, PartialEq)]
pub struct Scatter {
    /// The sets.
    pub sets: Vec<usize>,
    /// The scatter over all equations of the problem, zero where other sets are.
    pub pooled: Pooled,
}

/// Model, observations, unknowns and rows: what an estimator solves.
#[derive(Clone)]
pub struct Problem {
    /// Name of the estimate.
    pub name: String,
    /// The model.
    pub model: Arc<dyn KinematicModel>,
    /// Its plugin.
    pub model_plugin: String,
    /// The observations.
    pub sets: Vec<ObservationSet>,
    /// What is estimated: machine parameters in the model's order, then the sets' own unknowns.
    pub unknowns: Vec<Unknown>,
    /// Start or fixed value of every model parameter.
    pub machine: Vec<f64>,
    /// The known inputs of all sets; those of the machine stand here once.
    pub inputs: Vec<Input>,
    /// What is considered: not estimated, but its uncertainty counts.
    pub considered: Considered,
}

impl Problem {
    /// A problem over all rows, everything unknown starting from zero.
    ///
    /// `patterns` choose the unknowns by name; one that matches nothing is an error with its index in the setting
    /// `parameters`.
    pub fn new(
        name: &str,
        model_plugin: &str,
        model: Arc<dyn KinematicModel>,
        sets: Vec<ObservationSet>,
        patterns: &[String],
    ) -> Result<Self> {
        let mut candidates = candidates(model.as_ref(), &sets);
        let mut chosen = vec![false; candidates.len()];
        for (index, pattern) in patterns.iter().enumerate() {
            let mut found = false;
            for (chosen, candidate) in chosen.iter_mut().zip(&candidates) {
                if matches(pattern, &candidate.name) {
                    (*chosen, found) = (true, true);
                }
            }
            if !found {
                let names = candidates.iter().map(|candidate| candidate.name.as_str());
                let mut error = Error::usage(format!(
                    "`{pattern}` matches no parameter of the machine and none of the observed artefacts"
                ))
                .help("a machine parameter exists only if the model's `errors` list it")
                .suggest(pattern, names);
                error.setting = vec![
                    crate::settings::PathItem::Key("parameters".to_owned()),
                    crate::settings::PathItem::Index(index),
                ];
                return Err(error);
            }
        }
        let mut chosen = chosen.into_iter();
        candidates.retain(|_| chosen.next() == Some(true));
        let machine = model.nominal();
        let (inputs, mut considered) = inputs(&sets)?;
        consider_parameters(&mut considered, model.as_ref(), &candidates);
        sets.iter().try_for_each(check_constraints)?;
        Ok(Self {
            name: name.to_owned(),
            model,
            model_plugin: model_plugin.to_owned(),
            sets,
            unknowns: candidates,
            machine,
            inputs,
            considered,
        })
    }

    /// The model with the settings that the fit used.
    pub fn model_record(&self) -> ModelRecord {
        ModelRecord { plugin: self.model_plugin.clone(), settings: self.model.settings() }
    }

    /// The same problem on other rows of one set.
    pub fn with_rows(&self, set: usize, rows: Vec<usize>) -> Self {
        let mut problem = self.clone();
        problem.sets[set].rows = rows;
        problem
    }

    /// The same problem without some of its unknowns, which stay at their start values.
    pub fn without(&self, dropped: impl Fn(&Unknown) -> bool) -> Self {
        let mut problem = self.clone();
        problem.unknowns.retain(|unknown| !dropped(unknown));
        problem
    }

    /// The same problem with the values of a calibration as start (and as fixed values of what is not estimated).
    pub fn starting_from(&self, calibration: &Calibration) -> Self {
        let mut problem = self.clone();
        for (value, parameter) in problem.machine.iter_mut().zip(problem.model.parameters()) {
            if let Some(known) = calibration.parameters.iter().find(|known| known.name == parameter.name) {
                *value = known.value;
            }
        }
        for set in &mut problem.sets {
            for (value, parameter) in set.own.iter_mut().zip(set.observations.unknowns()) {
                let name = format!("{}.{}", set.name, parameter.name);
                if let Some(known) = calibration.artefacts.iter().find(|known| known.name == name) {
                    *value = known.value;
                }
            }
        }
        problem
    }

    /// The same problem with other errors of its readings: `disturbances`, one for every equation of the problem, are added
    /// to its residuals.
    pub fn disturbed(&self, disturbances: &[f64]) -> Self {
        let mut problem = self.clone();
        let mut rest = disturbances;
        for set in &mut problem.sets {
            let taken = set.taken();
            let (own, others) = rest.split_at(taken.len());
            rest = others;
            let mut all = vec![0.0; set.uncertainty.standard.len()];
            if let Some(before) = &set.disturbances {
                all.copy_from_slice(before);
            }
            taken.into_iter().zip(own).for_each(|(equation, disturbance)| all[equation] += disturbance);
            set.disturbances = Some(Arc::new(all));
        }
        problem
    }

    /// Adds `change` to the value of something that is not estimated.
    pub fn shift(&mut self, unknown: &Unknown, change: f64) {
        match unknown.owner {
            Owner::Machine => self.machine[unknown.index] += change,
            Owner::Set(set) => self.sets[set].own[unknown.index] += change,
            Owner::Input => {
                for &(set, input) in &self.inputs[unknown.index].users {
                    self.sets[set].inputs[input] += change;
                }
            }
        }
    }

    /// The same problem with the standard uncertainties of the readings of every set multiplied by a factor; those of
    /// constraints stay what their certificates state.
    pub fn with_variance_factors(&self, factors: &[f64]) -> Self {
        let mut problem = self.clone();
        for (set, &factor) in problem.sets.iter_mut().zip(factors).filter(|(_, factor)| **factor != 1.0) {
            let uncertainty = Arc::make_mut(&mut set.uncertainty);
            for row in set.observations.layout().rows.iter().filter(|row| row.data_row.is_some()) {
                let own = row.first_equation..row.first_equation + row.equations;
                uncertainty.standard[own].iter_mut().for_each(|standard| *standard *= factor);
            }
            uncertainty.blocks.iter_mut().for_each(|block| block.covariance *= factor * factor);
        }
        problem
    }

    /// Number of equations.
    pub fn equations(&self) -> usize {
        self.sets.iter().map(|set| set.equations(&set.rows)).sum()
    }

    /// The start value of every unknown.
    pub fn start(&self) -> Vec<f64> {
        self.unknowns
            .iter()
            .map(|unknown| match unknown.owner {
                Owner::Machine => self.machine[unknown.index],
                Owner::Set(set) => self.sets[set].own[unknown.index],
                Owner::Input => self.inputs[unknown.index].value(&self.sets),
            })
            .collect()
    }

    /// The problem with the unknowns' start values replaced by `x`.
    pub fn at(&self, x: &[f64]) -> Self {
        let mut problem = self.clone();
        for (unknown, &value) in self.unknowns.iter().zip(x) {
            match unknown.owner {
                Owner::Machine => problem.machine[unknown.index] = value,
                Owner::Set(set) => problem.sets[set].own[unknown.index] = value,
                Owner::Input => {
                    for &(set, input) in &self.inputs[unknown.index].users {
                        problem.sets[set].inputs[input] = value;
                    }
                }
            }
        }
        problem
    }

    /// Standard uncertainty of every equation, mm or rad.
    pub fn standard_uncertainties(&self) -> Vec<f64> {
        let sets = self.sets.iter();
        sets.flat_map(|set| set.taken().into_iter().map(|equation| set.uncertainty.standard[equation])).collect()
    }

    /// Equations of the problem that are correlated.
    pub fn covariance_blocks(&self) -> Vec<CovarianceBlock> {
        let mut all = Vec::new();
        for (set, range) in self.sets.iter().zip(self.equation_ranges()) {
            if set.uncertainty.blocks.is_empty() {
                continue;
            }
            all.extend(set.uncertainty.of(&set.taken()).blocks.into_iter().map(|mut block| {
                block.equations.iter_mut().for_each(|equation| *equation += range.start);
                block
            }));
        }
        all
    }

    /// The scatter of repeats. Sets with the same repetitions were repeated together: they share the deviations.
    pub fn scatters(&self) -> Vec<Scatter> {
        let mut all: Vec<Scatter> = Vec::new();
        let equations = self.equations();
        for (index, (set, range)) in self.sets.iter().zip(self.equation_ranges()).enumerate() {
            let Some(pooled) = set.uncertainty.of(&set.taken()).pooled else { continue };
            let same = |scatter: &&mut Scatter| {
                (&scatter.pooled.by, &scatter.pooled.repetitions) == (&pooled.by, &pooled.repetitions)
            };
            if all.iter_mut().find(same).is_none() {
                let deviations = vec![vec![0.0; equations]; pooled.repetitions.len()];
                all.push(Scatter { sets: Vec::new(), pooled: Pooled { deviations, ..pooled.clone() } });
            }
            if let Some(scatter) = all.iter_mut().find(same) {
                scatter.sets.push(index);
                for (line, own) in scatter.pooled.deviations.iter_mut().zip(&pooled.deviations) {
                    line[range.clone()].copy_from_slice(own);
                }
            }
        }
        all
    }

    /// Which equations are constraints: what a certificate states, and nobody measured here. They do not scatter, and are
    /// never weighed down.
    pub fn constraints(&self) -> Vec<bool> {
        let rows = self.equation_rows().into_iter();
        rows.map(|(set, row)| self.sets[set].observations.layout().rows[row].data_row.is_none()).collect()
    }

    /// For every equation the set and the row that it belongs to.
    pub fn equation_rows(&self) -> Vec<(usize, usize)> {
        let mut all = Vec::with_capacity(self.equations());
        for (index, set) in self.sets.iter().enumerate() {
            for &row in &set.rows {
                all.extend(std::iter::repeat_n((index, row), set.observations.layout().rows[row].equations));
            }
        }
        all
    }

    /// What each equation is an equation of, lengths or angles, in the order of the equations.
    pub fn quantities(&self) -> Vec<Quantity> {
        let mut all = Vec::with_capacity(self.equations());
        for ObservationSet { observations, rows, .. } in &self.sets {
            for &row in rows {
                let equations = 0..observations.layout().rows[row].equations;
                all.extend(equations.map(|equation| observations.quantity(row, equation)));
            }
        }
        all
    }

    /// Where a row was read.
    pub fn origin(&self, set: usize, row: usize) -> Option<(&std::path::Path, RowOrigin)> {
        let observations = &self.sets[set].observations;
        let data = &observations.layout().data;
        let origin = data.origins[observations.layout().rows[row].data_row?];
        Some((&data.files[origin.file], origin))
    }

    /// An error with the place where a row was read.
    pub fn at_row(&self, set: usize, row: usize, error: Error) -> Error {
        match self.origin(set, row) {
            Some((file, origin)) => error.at(file, origin.line, None),
            None => error,
        }
    }

    /// Residuals at `x`, in the order of the equations.
    pub fn residuals(&self, x: &[f64]) -> Result<Vec<f64>> {
        let mut residuals = Vec::with_capacity(self.equations());
        let problem = self.without(|_| true);
        problem.at_values(self, x).linearise(&[], |block| residuals.extend_from_slice(block.residuals))?;
        Ok(residuals)
    }

    fn at_values(mut self, other: &Self, x: &[f64]) -> Self {
        let values = other.at(x);
        self.machine = values.machine;
        for (set, with) in self.sets.iter_mut().zip(values.sets) {
            set.own = with.own;
        }
        self
    }

    /// Residuals and derivatives at `x`, block by block, in the order of the equations.
    ///
    /// Where there is much to do and a core is free, the next blocks are evaluated while the sink takes the last one.
    pub fn linearise(&self, x: &[f64], mut sink: impl FnMut(Block<'_>)) -> Result<()> {
        let at = self.at(x);
        let columns = Columns::of(self);
        let chunks =
            || at.sets.iter().enumerate().flat_map(|(set, of)| of.rows.chunks(CHUNK).map(move |rows| (set, rows)));
        let mut first = 0;
        let mut take = |linear: &Linearised| {
            sink(Block { first, residuals: &linear.residuals, jacobian: &linear.jacobian });
            first += linear.residuals.len();
        };
        let threads = self.threads(self.unknowns.len());
        if threads == 1 {
            let (mut work, mut linear) = (Workspace::default(), Linearised::default());
            for (set, rows) in chunks() {
                at.linearise_rows(set, rows, &columns, &mut work, &mut linear)?;
                take(&linear);
            }
            return Ok(());
        }
        let chunks: Vec<(usize, &[usize])> = chunks().collect();
        std::thread::scope(|scope| {
            let (at, columns, chunks) = (&at, &columns, &chunks);
            // Every thread evaluates every so many-th chunk; they are taken in turn.
            let from = (0..threads).map(|first| {
                let (send, receive) = sync_channel::<Result<Linearised>>(AHEAD);
                let (give_back, used) = channel::<Linearised>();
                scope.spawn(move || {
                    let mut work = Workspace::default();
                    for &(set, rows) in chunks.iter().skip(first).step_by(threads) {
                        let mut linear = used.try_recv().unwrap_or_default();
                        let done = at.linearise_rows(set, rows, columns, &mut work, &mut linear).map(|()| linear);
                        let failed = done.is_err();
                        // Nobody listens any more after an error.
                        if send.send(done).is_err() || failed {
                            return;
                        }
                    }
                });
                (receive, give_back)
            });
            let from: Vec<_> = from.collect();
            for (receive, give_back) in from.iter().cycle() {
                // The first that has no more was the next in turn.
                let Ok(linear) = receive.recv() else { break };
                let linear = linear?;
                take(&linear);
                // The other side may be done.
                let _ = give_back.send(linear);
            }
            Ok(())
        })
    }

    /// Threads that are worth starting for an evaluation of all rows with derivatives to so many variables.
    pub(crate) fn threads(&self, variables: usize) -> usize {
        let work = self.equations() * (POSE + variables);
        if work < WORTH_A_THREAD || is_one_of_several() { 1 } else { cores() }
    }

    /// Residuals and derivatives of some rows of a set at the problem's own values.
    fn linearise_rows(
        &self,
        index: usize,
        rows: &[usize],
        columns: &Columns,
        work: &mut Workspace,
        out: &mut Linearised,
    ) -> Result<()> {
        let (set, count) = (&self.sets[index], self.unknowns.len());
        self.evaluate(index, rows, &columns.wanted, work)?;
        let equations = work.equations.residuals.len();
        out.residuals.clear();
        out.residuals.extend_from_slice(&work.equations.residuals);
        out.jacobian.clear();
        out.jacobian.resize(equations * count, 0.0);
        let jacobian = &mut out.jacobian;
        work.chain(set, rows, columns.wanted.len(), |equation, _, derivatives, weight| {
            if *weight == [0.0; 3] {
                return;
            }
            let line = &mut jacobian[equation * count..(equation + 1) * count];
            for (derivative, &column) in derivatives.iter().zip(&columns.machine) {
                line[column] += dot(derivative, weight);
            }
        });
        let (own, inputs) = &columns.of_sets[index];
        let own = work.equations.by_own.iter().map(|by| (by, own));
        let inputs = work.equations.by_input.iter().map(|by| (by, inputs));
        for (&(equation, index, derivative), columns) in own.chain(inputs) {
            if let Some(column) = columns[index] {
                jacobian[equation * count + column] += derivative;
            }
        }
        Ok(())
    }

    /// Evaluates poses and equations of some rows of a set at the problem's own values.
    pub(crate) fn evaluate(&self, set: usize, rows: &[usize], wanted: &[Variable], work: &mut Workspace) -> Result<()> {
        self.evaluate_poses(set, rows, wanted, work).map_err(|error| self.of_row(set, rows, error))?;
        let set = &self.sets[set];
        work.equations.clear();
        let poses = PoseValues { positions: &work.poses.positions, orientations: &work.poses.orientations };
        set.observations.try_evaluate(rows, poses, &set.own, &set.inputs, &mut work.equations)?;
        if let Some(disturbances) = &set.disturbances {
            let equations = rows.iter().map(|&row| set.observations.layout().rows[row]);
            let equations = equations.flat_map(|row| row.first_equation..row.first_equation + row.equations);
            work.equations.residuals.iter_mut().zip(equations).for_each(|(value, at)| *value += disturbances[at]);
        }
        Ok(())
    }

    fn evaluate_poses(&self, set: usize, rows: &[usize], wanted: &[Variable], work: &mut Workspace) -> Result<()> {
        let set = &self.sets[set];
        let orientation = set.observations.needs_orientation();
        work.statuses.clear();
        set.poses_of(rows).for_each(|pose| work.statuses.extend_from_slice(set.poses().row(pose)));
        match orientation && set.observations.first_order_orientation() {
            true => self.first_order(&work.statuses, wanted, &mut work.poses),
            false => self.model.evaluate(&work.statuses, &self.machine, wanted, orientation, &mut work.poses),
        }
    }

    /// An error with the place of the row whose pose it names.
    fn of_row(&self, set: usize, rows: &[usize], mut error: Error) -> Error {
        let Some(pose) = error.pose.take().filter(|_| error.place.is_none()) else { return error };
        let poses = |row: &&usize| self.sets[set].poses_of(std::slice::from_ref(*row)).count();
        let mut before = 0;
        let row = rows.iter().find(|row| {
            before += poses(row);
            before > pose
        });
        let error = match row {
            Some(&row) => self.at_row(set, row, error),
            None => error,
        };
        let recorded = self.sets[set].moved.is_none() || self.sets[set].observations.contact() != Contact::LinearAxes;
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

    /// The estimated values of a calibration in the order of this problem's unknowns; start values where it has none.
    pub fn values_of(&self, calibration: &Calibration) -> Vec<f64> {
        let start = self.start();
        let unknowns = self.unknowns.iter().zip(start);
        unknowns
            .map(|(unknown, start)| calibration.get(&unknown.name).map_or(start, |estimated| estimated.value))
            .collect()
    }

    /// The range of equations of every set.
    pub fn equation_ranges(&self) -> Vec<Range<usize>> {
        let mut first = 0;
        let ranges = self.sets.iter().map(|set| {
            let count = set.equations(&set.rows);
            first += count;
            first - count..first
        });
        ranges.collect()
    }
}

/// Where the derivatives of a problem go.
struct Columns {
    /// The parameters of the model that are unknown, and the column of each.
    wanted: Vec<Variable>,
    machine: Vec<usize>,
    of_sets: Vec<ColumnsOfSet>,
}

/// The columns of the own unknowns of a set, and of its known inputs; none for those that are not unknown.
type ColumnsOfSet = (Vec<Option<usize>>, Vec<Option<usize>>);

impl Columns {
    fn of(problem: &Problem) -> Self {
        let none = |set: &ObservationSet| (vec![None; set.own.len()], vec![None; set.inputs.len()]);
        let (mut wanted, mut machine) = (Vec::new(), Vec::new());
        let mut of_sets: Vec<_> = problem.sets.iter().map(none).collect();
        for (column, unknown) in problem.unknowns.iter().enumerate() {
            match unknown.owner {
                Owner::Machine => {
                    wanted.push(Variable::Parameter(unknown.index));
                    machine.push(column);
                }
                Owner::Set(set) => of_sets[set].0[unknown.index] = Some(column),
                Owner::Input => {
                    for &(set, input) in &problem.inputs[unknown.index].users {
                        of_sets[set].1[input] = Some(column);
                    }
                }
            }
        }
        Self { wanted, machine, of_sets }
    }
}

/// Residuals and derivatives (equations x unknowns, row by row) of some rows.
#[derive(Default)]
struct Linearised {
    residuals: Vec<f64>,
    jacobian: Vec<f64>,
}

/// Derivatives from which a thread of their own is worth starting.
const WORTH_A_THREAD: usize = 50_000;

/// Derivatives that cost as much as a pose without any.
const POSE: usize = 25;

/// Blocks that a thread evaluates ahead of those that are taken.
const AHEAD: usize = 4;

/// Buffers of an evaluation.
#[derive(Default)]
pub(crate) struct Workspace {
    statuses: Vec<f64>,
    pub(crate) poses: Poses,
    pub(crate) equations: Equations,
}

impl Workspace {
    /// Calls `add` with (equation, number of the pair of equation and pose, derivatives of the pose to the variables,
    /// d(residual)/d(that pose)) for every equation and pose; once for positions and, where they are needed, once for rotations.
    pub(crate) fn chain(
        &self,
        set: &ObservationSet,
        rows: &[usize],
        variables: usize,
        mut add: impl FnMut(usize, usize, &[[f64; 3]], &[f64; 3]),
    ) {
        let (mut equation, mut pair, mut first_pose) = (0, 0, 0);
        for row in rows.iter().map(|&row| &set.observations.layout().rows[row]) {
            for _ in 0..row.equations {
                for pose in first_pose..first_pose + row.poses {
                    let range = pose * variables..(pose + 1) * variables;
                    let by_position = &self.equations.by_position[pair];
                    add(equation, pair, &self.poses.position_derivatives[range.clone()], by_position);
                    if let Some(by_rotation) = self.equations.by_rotation.get(pair) {
                        add(equation, pair, &self.poses.rotation_derivatives[range], by_rotation);
                    }
                    pair += 1;
                }
                equation += 1;
            }
            first_pose += row.poses;
        }
    }
}

pub(crate) fn dot(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
