//! A problem: model + observations + chosen unknowns + selected rows.
//!
//! Whoever holds a problem can have it solved again, on other rows (hold-out), with other inputs (Monte Carlo) or from
//! other start values, by any estimator.

use std::ops::Range;
use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use crate::calibration::{Calibration, ModelRecord};
use crate::dataset::RowOrigin;
use crate::error::{Error, Result};
use crate::model::{AxisKind, KinematicModel, Poses, Variable};
use crate::observations::{Contact, Equations, Observations, PoseValues};
use crate::pattern::matches;
use crate::pose_table::PoseTable;
use crate::unit::Unit;

/// Rows that are evaluated together: enough to amortise a call, few enough for their derivatives to stay in the cache.
const CHUNK: usize = 64;

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
    /// Start or fixed values of the own unknowns.
    pub own: Vec<f64>,
    /// Statuses that stand in for the recorded ones.
    moved: Option<Arc<PoseTable>>,
}

impl ObservationSet {
    /// All rows of some observations, with their nominal inputs, own unknowns at zero.
    pub fn new(name: &str, observations: Arc<dyn Observations>) -> Self {
        Self {
            name: name.to_owned(),
            rows: (0..observations.layout().rows.len()).collect(),
            inputs: observations.inputs().iter().map(|input| input.value).collect(),
            own: observations.start(),
            moved: None,
            observations,
        }
    }

    fn poses(&self) -> &PoseTable {
        self.moved.as_deref().unwrap_or_else(|| &self.observations.layout().poses)
    }

    fn equations(&self, rows: &[usize]) -> usize {
        rows.iter().map(|&row| self.observations.layout().rows[row].equations).sum()
    }
}

/// Whose an unknown is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Owner {
    /// A parameter of the model.
    Machine,
    /// An own unknown of the observation set with this index.
    Set(usize),
}

/// Something to be estimated.
#[derive(Debug, Clone, PartialEq)]
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

/// What an earlier calibration knows of a problem: values that are not estimated again, with their covariance.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Known {
    /// The parameters.
    pub unknowns: Vec<Unknown>,
    /// Their covariance, in their units.
    pub covariance: Vec<Vec<f64>>,
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
    /// What is considered: not estimated, but its uncertainty counts.
    pub known: Known,
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
        let mut candidates: Vec<Unknown> = Vec::new();
        let machine = model.parameters().iter().enumerate();
        candidates.extend(machine.map(|(index, parameter)| Unknown {
            name: parameter.name.clone(),
            unit: parameter.unit,
            owner: Owner::Machine,
            index,
        }));
        for (set, observations) in sets.iter().enumerate() {
            let own = observations.observations.unknowns().iter().enumerate();
            candidates.extend(own.map(|(index, parameter)| Unknown {
                name: format!("{}.{}", observations.name, parameter.name),
                unit: parameter.unit,
                owner: Owner::Set(set),
                index,
            }));
        }
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
        let machine = vec![0.0; model.parameters().len()];
        Ok(Self {
            name: name.to_owned(),
            model,
            model_plugin: model_plugin.to_owned(),
            sets,
            unknowns: candidates,
            machine,
            known: Known::default(),
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

    /// The same problem with what a calibration knows: its values hold, those that are chosen here start from them, and the
    /// covariance of the others counts.
    pub fn knowing(&self, calibration: &Calibration) -> Self {
        let mut problem = self.starting_from(calibration);
        let everything =
            Self::new(&self.name, &self.model_plugin, self.model.clone(), self.sets.clone(), &["*".to_owned()]);
        let candidates = everything.map_or_else(|_| Vec::new(), |everything| everything.unknowns);
        let order = &calibration.covariance.order;
        let mut places = Vec::new();
        for unknown in candidates {
            let chosen = self.unknowns.iter().any(|chosen| chosen.name == unknown.name);
            if let Some(place) = order.iter().position(|name| *name == unknown.name).filter(|_| !chosen) {
                problem.known.unknowns.push(unknown);
                places.push(place);
            }
        }
        let rows = &calibration.covariance.rows;
        let entry = |row: usize| places.iter().map(|&column| rows[row][column]).collect();
        problem.known.covariance = places.iter().map(|&row| entry(row)).collect();
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
            }
        }
        problem
    }

    /// Standard uncertainty of every equation, mm or rad.
    pub fn standard_uncertainties(&self) -> Vec<f64> {
        let mut all = Vec::with_capacity(self.equations());
        for set in &self.sets {
            let uncertainties = &set.observations.layout().standard_uncertainties;
            for row in set.rows.iter().map(|&row| &set.observations.layout().rows[row]) {
                all.extend_from_slice(&uncertainties[row.first_equation..row.first_equation + row.equations]);
            }
        }
        all
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

    /// Where a row was read.
    pub fn origin(&self, set: usize, row: usize) -> Option<(&std::path::Path, RowOrigin)> {
        let observations = &self.sets[set].observations;
        let data = &observations.layout().data;
        let origin = data.origins[observations.layout().rows[row].data_row?];
        Some((&data.files[origin.file], origin))
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
    pub fn linearise(&self, x: &[f64], mut sink: impl FnMut(Block<'_>)) -> Result<()> {
        let at = self.at(x);
        let count = self.unknowns.len();
        let mut wanted = Vec::new();
        let mut machine_columns = Vec::new();
        for (column, unknown) in self.unknowns.iter().enumerate() {
            if unknown.owner == Owner::Machine {
                wanted.push(Variable::Parameter(unknown.index));
                machine_columns.push(column);
            }
        }
        let mut work = Workspace::default();
        let mut first = 0;
        let mut jacobian = Vec::new();
        for (index, set) in at.sets.iter().enumerate() {
            let mut own_columns = vec![None; set.own.len()];
            for (column, unknown) in self.unknowns.iter().enumerate() {
                if unknown.owner == Owner::Set(index) {
                    own_columns[unknown.index] = Some(column);
                }
            }
            for rows in set.rows.chunks(CHUNK) {
                at.evaluate(index, rows, &wanted, &mut work)?;
                let equations = work.equations.residuals.len();
                jacobian.clear();
                jacobian.resize(equations * count, 0.0);
                work.chain(set, rows, wanted.len(), |equation, derivatives, weight| {
                    let line = &mut jacobian[equation * count..(equation + 1) * count];
                    for (derivative, &column) in derivatives.iter().zip(&machine_columns) {
                        line[column] += dot(derivative, weight);
                    }
                });
                for &(equation, own, derivative) in &work.equations.by_own {
                    if let Some(column) = own_columns[own] {
                        jacobian[equation * count + column] += derivative;
                    }
                }
                sink(Block { first, residuals: &work.equations.residuals, jacobian: &jacobian });
                first += equations;
            }
        }
        Ok(())
    }

    /// Evaluates poses and equations of some rows of a set at the problem's own values.
    fn evaluate(&self, set: usize, rows: &[usize], wanted: &[Variable], work: &mut Workspace) -> Result<()> {
        let set = &self.sets[set];
        let orientation = set.observations.needs_orientation();
        work.statuses.clear();
        for row in rows.iter().map(|&row| &set.observations.layout().rows[row]) {
            for pose in row.first_pose..row.first_pose + row.poses {
                work.statuses.extend_from_slice(set.poses().row(pose));
            }
        }
        self.model.evaluate(&work.statuses, &self.machine, wanted, orientation, &mut work.poses)?;
        work.equations.clear();
        let poses = PoseValues { positions: &work.poses.positions, orientations: &work.poses.orientations };
        set.observations.evaluate(rows, poses, &set.own, &set.inputs, &mut work.equations);
        Ok(())
    }

    /// The same problem with every touched row moved to where, by the model at `x`, nominal contact is: the linear axes
    /// bring the tip to [`Observations::contact_tip`], or move by as little as possible until the row's equations hold.
    ///
    /// Rank and condition are judged there. At recorded positions the residuals, and the offsets with which features are
    /// met beside their points, act as if they were information: they lift the singular values that are really zero.
    pub fn at_contact(&self, x: &[f64]) -> Result<Self> {
        let mut moved = self.at(x);
        let linear: Vec<(Variable, usize)> = (self.model.axes().iter().enumerate())
            .filter(|(_, axis)| axis.kind == AxisKind::Linear)
            .map(|(index, axis)| (Variable::Command(index), axis.status))
            .collect();
        let wanted: Vec<Variable> = linear.iter().map(|(variable, _)| *variable).collect();
        let mut work = Workspace::default();
        for set in 0..moved.sets.len() {
            if moved.sets[set].observations.contact() != Contact::LinearAxes || linear.is_empty() {
                continue;
            }
            let mut poses = moved.sets[set].poses().clone();
            for chunk in self.sets[set].rows.chunks(CHUNK) {
                moved.sets[set].moved = Some(Arc::new(poses.clone()));
                // Newton's iteration converges quadratically: a step below 1e-5 mm leaves nothing that a double holds.
                let moved_set = moved.sets[set].clone();
                for _ in 0..8 {
                    moved.evaluate(set, chunk, &wanted, &mut work)?;
                    let table = Arc::make_mut(moved.sets[set].moved.get_or_insert_default());
                    if work.step_to_contact(&moved_set, chunk, &linear, table) < 1e-5 {
                        break;
                    }
                }
                poses = moved.sets[set].poses().clone();
            }
            moved.sets[set].moved = Some(Arc::new(poses));
        }
        Ok(moved)
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

/// Buffers of an evaluation.
#[derive(Default)]
struct Workspace {
    statuses: Vec<f64>,
    poses: Poses,
    equations: Equations,
}

impl Workspace {
    /// Calls `add` with (equation, derivatives of a pose to the variables, d(residual)/d(that pose)) for every equation
    /// and pose; once for positions and, where they are needed, once for rotations.
    fn chain(
        &self,
        set: &ObservationSet,
        rows: &[usize],
        variables: usize,
        mut add: impl FnMut(usize, &[[f64; 3]], &[f64; 3]),
    ) {
        let (mut equation, mut weight, mut first_pose) = (0, 0, 0);
        for row in rows.iter().map(|&row| &set.observations.layout().rows[row]) {
            for _ in 0..row.equations {
                for pose in first_pose..first_pose + row.poses {
                    let range = pose * variables..(pose + 1) * variables;
                    add(equation, &self.poses.position_derivatives[range.clone()], &self.equations.by_position[weight]);
                    if let Some(by_rotation) = self.equations.by_rotation.get(weight) {
                        add(equation, &self.poses.rotation_derivatives[range], by_rotation);
                    }
                    weight += 1;
                }
                equation += 1;
            }
            first_pose += row.poses;
        }
    }

    /// Moves the linear axes of every row by the smallest step that makes its linearised equations hold; returns the
    /// largest step in mm.
    fn step_to_contact(
        &self,
        set: &ObservationSet,
        rows: &[usize],
        linear: &[(Variable, usize)],
        table: &mut PoseTable,
    ) -> f64 {
        let count = linear.len();
        let mut gradients = vec![0.0; self.equations.by_position.len() * count];
        let mut entry = 0;
        self.chain(set, rows, count, |_, derivatives, weight| {
            for (k, derivative) in derivatives.iter().enumerate() {
                gradients[entry * count + k] = dot(derivative, weight);
            }
            entry += 1;
        });
        if !self.equations.by_rotation.is_empty() {
            return 0.0; // Orientations are not touched into place by linear axes.
        }
        let (mut equation, mut entry, mut pose, mut largest) = (0, 0, 0, 0.0_f64);
        for &index in rows {
            let row = &set.observations.layout().rows[index];
            let free = row.poses * count;
            let tip = (row.poses == 1).then(|| self.poses.positions[pose]);
            let contact =
                tip.and_then(|tip| Some((tip, set.observations.contact_tip(index, tip, &set.own, &set.inputs)?)));
            let (gradient, residual) = match contact {
                Some((tip, contact)) => (
                    DMatrix::from_fn(3, count, |axis, k| self.poses.position_derivatives[pose * count + k][axis]),
                    DVector::from_fn(3, |axis, _| tip[axis] - contact[axis]),
                ),
                None => (
                    DMatrix::from_row_slice(
                        row.equations,
                        free,
                        &gradients[entry * count..entry * count + row.equations * free],
                    ),
                    DVector::from_column_slice(&self.equations.residuals[equation..equation + row.equations]),
                ),
            };
            equation += row.equations;
            entry += row.equations * row.poses;
            pose += row.poses;
            if free == 0 {
                continue;
            }
            let Ok(step) = gradient.svd(true, true).solve(&-residual, 1e-6) else {
                continue;
            };
            for end in 0..row.poses {
                for (k, (_, status)) in linear.iter().enumerate() {
                    let step = step[end * count + k];
                    table.row_mut(row.first_pose + end)[*status] += step;
                    largest = largest.max(step.abs());
                }
            }
        }
        largest
    }
}

fn dot(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
