//! The law of artefacts that say that their rows do not depend on each other.

use std::sync::Arc;

use abbe_core::{
    Artefact, DataRow, Dataset, Equations, KinematicModel, ObservationSet, Observations, Poses, Result, RowIndex,
};

/// By how much residuals of the same row may differ, relative to the larger of them and 1: rounding.
const ALLOWED: f64 = 1e-12;

/// Most rows that are looked at.
const MOST: usize = 400;

/// How an artefact that says [`Artefact::rows_are_independent`] breaks its word; empty if it keeps it, or does not say so.
///
/// Two halves of a data set, every other row, have together the rows, unknowns and known inputs of all of it: with the same names,
/// start values, uncertainties, residuals and contact tips. Of no rows there is nothing to observe.
pub fn check_independence(
    artefact: &dyn Artefact,
    data: &Arc<Dataset>,
    model: &Arc<dyn KinematicModel>,
) -> Result<Vec<String>> {
    if !artefact.rows_are_independent() || data.rows() < 4 {
        return Ok(Vec::new());
    }
    let some: Vec<DataRow> = data.row_indices().take(MOST).collect();
    let data = &if some.len() < data.rows() { Arc::new(data.of_rows(&some)) } else { data.clone() };
    let whole = Seen::new(data, None, artefact, model)?;
    let mut broken = Vec::new();
    let mut rows = 0;
    for half in 0..2 {
        let chosen: Vec<DataRow> = data.row_indices().skip(half).step_by(2).collect();
        let part = Seen::new(&Arc::new(data.of_rows(&chosen)), Some(&chosen), artefact, model)?;
        rows += part.rows.len();
        broken.extend(part.differs_from(&whole));
    }
    if !matches!(artefact.observe_some(&Arc::new(data.of_rows(&[])), model), Ok(None)) {
        broken.push("of no rows it observes something, or it fails".to_owned());
    }
    if rows != whole.rows.len() {
        broken.push(format!("halves of the data have {rows} rows, all of them {}", whole.rows.len()));
    }
    Ok(broken)
}

/// What an artefact makes of some data.
struct Seen {
    observations: Arc<dyn Observations>,
    rows: Vec<OfRow>,
}

/// A row, by the data row of all data.
struct OfRow {
    data_row: Option<DataRow>,
    uncertainties: Vec<f64>,
    residuals: Vec<f64>,
    contact: Option<[f64; 3]>,
}

impl Seen {
    fn new(
        data: &Arc<Dataset>,
        chosen: Option<&[DataRow]>,
        artefact: &dyn Artefact,
        model: &Arc<dyn KinematicModel>,
    ) -> Result<Self> {
        let observations = artefact.observe(data, model)?;
        let set = ObservationSet::new("", observations.clone());
        let info = observations.info();
        let inputs = set.inputs_with(&model.info().nominal).into_owned();
        let of_row = |row: RowIndex| -> Result<OfRow> {
            let layout = &info.layout.rows[row];
            let (mut poses, mut equations) = (Poses::default(), Equations::default());
            let statuses: Vec<f64> = set.poses_of(&[row]).flat_map(|pose| set.poses().row(pose).to_vec()).collect();
            model.poses(&statuses, &model.info().nominal, &[], true, &mut poses)?;
            observations.evaluate(set.batch(&[row], &poses, &inputs), &mut equations)?;
            let contact = match poses.positions.as_slice() {
                [tip] => observations.contact_tip(row, *tip, &info.start, &inputs)?,
                _ => None,
            };
            Ok(OfRow {
                data_row: layout.data_row.map(|own| chosen.map_or(own, |chosen| chosen[own.0])),
                uncertainties: info.layout.standard_uncertainties[layout.equation_indices()].to_vec(),
                residuals: equations.residuals().to_vec(),
                contact,
            })
        };
        let rows = info.layout.row_indices().map(of_row).collect::<Result<_>>()?;
        Ok(Self { rows, observations })
    }

    fn differs_from(&self, whole: &Self) -> Vec<String> {
        let mut broken = Vec::new();
        let (own, all) = (self.observations.info(), whole.observations.info());
        for (unknown, start) in own.unknowns.iter().zip(&own.start) {
            match all.unknowns.iter().position(|known| known == unknown) {
                None => broken.push(format!("`{}` is an unknown of some rows and not of all", unknown.name)),
                Some(place) if all.start[place] != *start => {
                    broken.push(format!("`{}` starts elsewhere without other rows", unknown.name));
                }
                Some(_) => {}
            }
        }
        for input in own.inputs.iter().filter(|input| !all.inputs.contains(input)) {
            broken.push(format!("`{}` is another known input without other rows", input.parameter.name));
        }
        let near = |one: &f64, other: &f64| (one - other).abs() <= ALLOWED * one.abs().max(1.0);
        let same = |one: &[f64], other: &[f64]| {
            one.len() == other.len() && one.iter().zip(other).all(|(one, other)| near(one, other))
        };
        for row in &self.rows {
            let Some(of_all) = whole.rows.iter().find(|other| other.data_row == row.data_row) else {
                broken.push("a row is one of some rows and not of all".to_owned());
                continue;
            };
            let contacts = [row.contact, of_all.contact].map(|tip| tip.map_or(Vec::new(), |tip| tip.to_vec()));
            if !same(&row.residuals, &of_all.residuals)
                || !same(&row.uncertainties, &of_all.uncertainties)
                || !same(&contacts[0], &contacts[1])
            {
                let number = row.data_row.map_or(0, |row| row.0 + 1);
                broken.push(format!("data row {number} has other equations, or another contact, without other rows"));
            }
        }
        broken
    }
}
