//! The rows of a problem: which rows are used, their uncertainty, where they were read.

use std::borrow::Cow;
use std::sync::Arc;

use super::Problem;
use crate::dataset::RowOrigin;
use crate::index::{EquationIndex, IndexRange, LayoutEquation, PoseIndex, RowIndex, SetIndex};
use crate::model::Poses;
use crate::observations::{Observations, ObservationsInfo, RowBatch};
use crate::pose_table::PoseTable;
use crate::uncertainty::{CovarianceBlock, EquationUncertainty, PooledRepeatability};
use abbe_settings::Error;
use abbe_settings::Quantity;

/// The observations of one artefact stage, with the rows that take part.
#[derive(Clone)]
pub struct ObservationSet {
    /// Name of the artefact stage.
    pub name: String,
    /// The observations.
    pub observations: Arc<dyn Observations>,
    /// Indices of the rows that take part, ascending.
    pub rows: Vec<RowIndex>,
    /// Values of the known inputs; those that are parameters of the model follow from its values ([`inputs_with`](Self::inputs_with)).
    pub inputs: Vec<f64>,
    /// The declared identities of the known inputs; none where none was declared.
    pub ids: Vec<Option<String>>,
    /// Start or fixed values of the own unknowns.
    pub own: Vec<f64>,
    /// Uncertainty of the equations, in the order of the layout.
    pub uncertainty: Arc<EquationUncertainty>,
    /// Statuses that replace the recorded ones.
    pub(super) moved: Option<Arc<PoseTable>>,
    /// What is added to the residuals, in the order of the layout.
    pub(super) disturbances: Option<Arc<Vec<f64>>>,
}

impl ObservationSet {
    /// All rows of some observations. Known inputs have their stated values and own unknowns their start values. The
    /// equations are independent and have the standard uncertainties of the layout.
    pub fn new(name: &str, observations: Arc<dyn Observations>) -> Self {
        let info = observations.info();
        let standard = info.layout.standard_uncertainties.clone();
        Self {
            name: name.to_owned(),
            rows: info.layout.row_indices().collect(),
            inputs: info.inputs.iter().map(|input| input.value).collect(),
            ids: vec![None; info.inputs.len()],
            own: info.start.clone(),
            uncertainty: Arc::new(EquationUncertainty::independent(standard)),
            moved: None,
            disturbances: None,
            observations,
        }
    }

    /// What the observations are.
    pub fn info(&self) -> &ObservationsInfo {
        self.observations.info()
    }

    /// The batch of some rows at these poses, with these values of the inputs and the own values of this set.
    pub fn batch<'a>(&'a self, rows: &'a [RowIndex], poses: &'a Poses, inputs: &'a [f64]) -> RowBatch<'a> {
        let Poses { positions, orientations, .. } = poses;
        RowBatch { rows, positions, orientations, own: &self.own, inputs }
    }

    /// Values of the inputs if the parameters of the model have `machine_values`.
    pub fn inputs_with(&self, machine_values: &[f64]) -> Cow<'_, [f64]> {
        let mut values = Cow::Borrowed(self.inputs.as_slice());
        for (index, input) in self.info().inputs.iter().enumerate() {
            if let Some(parameter) = input.of_model {
                values.to_mut()[index] = machine_values[parameter];
            }
        }
        values
    }

    /// The statuses of all poses: the recorded ones, or those that replace them.
    pub fn poses(&self) -> &PoseTable {
        self.moved.as_deref().unwrap_or_else(|| &self.info().layout.poses)
    }

    /// Replaces the recorded statuses of all poses, in the order of the layout.
    pub fn set_poses(&mut self, poses: PoseTable) {
        self.moved = Some(Arc::new(poses));
    }

    /// What is added to the residuals of the equations, in the order of the layout; none if nothing is added.
    pub fn disturbances(&self) -> Option<&[f64]> {
        self.disturbances.as_ref().map(|disturbances| disturbances.as_slice())
    }

    /// Sets what is added to the residuals, in the order of the layout.
    pub fn disturb(&mut self, disturbances: Vec<f64>) {
        self.disturbances = Some(Arc::new(disturbances));
    }

    /// The statuses of all poses, to be changed.
    pub fn poses_mut(&mut self) -> &mut PoseTable {
        let recorded = || Arc::new(self.observations.info().layout.poses.clone());
        Arc::make_mut(self.moved.get_or_insert_with(recorded))
    }

    /// What is added to the residuals, in the order of the layout, to be changed.
    pub fn disturbances_mut(&mut self) -> &mut [f64] {
        let none = || Arc::new(vec![0.0; self.observations.info().layout.standard_uncertainties.len()]);
        let all: &mut Vec<f64> = Arc::make_mut(self.disturbances.get_or_insert_with(none));
        all
    }

    /// The same observations with other statuses of all poses.
    pub fn with_poses(&self, poses: PoseTable) -> Self {
        Self { moved: Some(Arc::new(poses)), ..self.clone() }
    }

    /// The equations of the rows that take part, in the order of the layout.
    pub fn taken(&self) -> Vec<LayoutEquation> {
        self.equations_of(&self.rows).collect()
    }

    /// The equations of some rows.
    pub fn equations_of<'a>(&'a self, rows: &'a [RowIndex]) -> impl Iterator<Item = LayoutEquation> + 'a {
        rows.iter().flat_map(|&row| self.info().layout.rows[row].equation_indices())
    }

    /// The poses of some rows.
    pub fn poses_of<'a>(&'a self, rows: &'a [RowIndex]) -> impl Iterator<Item = PoseIndex> + 'a {
        rows.iter().flat_map(|&row| self.info().layout.rows[row].pose_indices())
    }

    fn equations(&self, rows: &[RowIndex]) -> usize {
        rows.iter().map(|&row| self.info().layout.rows[row].equations).sum()
    }
}

/// Sets of a problem that were repeated together, with the scatter of their repeats.
#[derive(Debug, Clone, PartialEq)]
pub struct RepeatedTogether {
    /// The sets.
    pub sets: Vec<SetIndex>,
    /// The scatter over all equations of the problem, zero where other sets are.
    pub pooled: PooledRepeatability,
}

impl Problem {
    /// Standard uncertainty of every equation, mm or rad.
    pub fn standard_uncertainties(&self) -> Vec<f64> {
        let sets = self.sets.iter();
        sets.flat_map(|set| set.taken().into_iter().map(|equation| set.uncertainty.standard[equation])).collect()
    }

    /// Equations of the problem that are correlated.
    pub fn covariance_blocks(&self) -> Vec<CovarianceBlock<EquationIndex>> {
        let mut all = Vec::new();
        for (set, range) in self.sets.iter().zip(self.equation_ranges()) {
            if !set.uncertainty.blocks.is_empty() {
                all.extend(set.uncertainty.blocks_of(&set.taken(), range.start()));
            }
        }
        all
    }

    /// The sets that were repeated together, those with the same repetitions: they share the deviations.
    pub fn repeated_together(&self) -> Vec<RepeatedTogether> {
        let mut all: Vec<RepeatedTogether> = Vec::new();
        let equations = self.equations();
        for ((index, set), range) in SetIndex::enumerate(&self.sets).zip(self.equation_ranges()) {
            let Some(pooled) = set.uncertainty.pooled_of(&set.taken()) else { continue };
            let same = |together: &&mut RepeatedTogether| {
                (&together.pooled.by, &together.pooled.repetitions) == (&pooled.by, &pooled.repetitions)
            };
            if all.iter_mut().find(same).is_none() {
                let deviations = vec![vec![0.0; equations]; pooled.repetitions.len()];
                all.push(RepeatedTogether {
                    sets: Vec::new(),
                    pooled: PooledRepeatability { deviations, ..pooled.clone() },
                });
            }
            if let Some(together) = all.iter_mut().find(same) {
                together.sets.push(index);
                for (line, own) in together.pooled.deviations.iter_mut().zip(&pooled.deviations) {
                    line[range.clone()].copy_from_slice(own);
                }
            }
        }
        all
    }

    /// Which equations are constraints: statements of a certificate that were not measured here. They do not scatter, and
    /// robust weights never reduce their weight.
    pub fn constraints(&self) -> Vec<bool> {
        let rows = self.equation_rows().into_iter();
        rows.map(|(set, row)| self.sets[set].info().layout.rows[row].data_row.is_none()).collect()
    }

    /// For every equation the set and the row that it belongs to.
    pub fn equation_rows(&self) -> Vec<(SetIndex, RowIndex)> {
        let mut all = Vec::with_capacity(self.equations());
        for (index, set) in SetIndex::enumerate(&self.sets) {
            for &row in &set.rows {
                all.extend(std::iter::repeat_n((index, row), set.info().layout.rows[row].equations));
            }
        }
        all
    }

    /// The quantity of every equation (length or angle), in the order of the equations.
    pub fn quantities(&self) -> Vec<Quantity> {
        let mut all = Vec::with_capacity(self.equations());
        for ObservationSet { observations, rows, .. } in &self.sets {
            for &row in rows {
                let equations = 0..observations.info().layout.rows[row].equations;
                all.extend(equations.map(|equation| observations.info().quantity(row, equation)));
            }
        }
        all
    }

    /// Where a row was read.
    pub fn origin(&self, set: SetIndex, row: RowIndex) -> Option<(&std::path::Path, RowOrigin)> {
        let observations = &self.sets[set].observations;
        let data = &observations.info().layout.data;
        let origin = data.origins[observations.info().layout.rows[row].data_row?];
        Some((&data.files[origin.file], origin))
    }

    /// An error with the place where a row was read.
    pub fn error_at_row(&self, set: SetIndex, row: RowIndex, error: Error) -> Error {
        match self.origin(set, row) {
            Some((file, origin)) => origin.blame(error, file),
            None => error,
        }
    }

    /// The range of equations of every set.
    pub fn equation_ranges(&self) -> Vec<IndexRange<EquationIndex>> {
        let mut first = EquationIndex(0);
        let ranges = self.sets.iter().map(|set| {
            let range = IndexRange::new(first, set.equations(&set.rows));
            first = range.end();
            range
        });
        ranges.collect()
    }

    /// Number of equations.
    pub fn equations(&self) -> usize {
        self.sets.iter().map(|set| set.equations(&set.rows)).sum()
    }

    /// The same problem with other errors of its readings: adds `disturbances` to its residuals, one for every equation of
    /// the problem.
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

    /// The same problem with the standard uncertainties of the readings of every set multiplied by a factor; those of
    /// constraints do not change.
    pub fn with_variance_factors(&self, factors: &[f64]) -> Self {
        let mut problem = self.clone();
        for (set, &factor) in problem.sets.iter_mut().zip(factors).filter(|(_, factor)| **factor != 1.0) {
            let uncertainty = Arc::make_mut(&mut set.uncertainty);
            for row in set.observations.info().layout.rows.iter().filter(|row| row.data_row.is_some()) {
                uncertainty.standard[row.equation_indices()].iter_mut().for_each(|standard| *standard *= factor);
            }
            uncertainty.blocks.iter_mut().for_each(|block| block.covariance *= factor * factor);
        }
        problem
    }
}
