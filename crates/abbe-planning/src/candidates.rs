//! The candidates of a plan.

use std::collections::BTreeMap;

use abbe_core::{DataRow, Dataset, EquationIndex, Label, Problem, Result, RowIndex};

use crate::settings::Planning;
use crate::wrong;

/// Measurements that are made together.
pub struct Candidate {
    /// Its label, or the number of its data row, after the name of its file if there are several.
    pub label: String,
    /// Its rows in the set of the candidates.
    pub rows: Vec<RowIndex>,
    /// Its equations in the problem.
    pub equations: Vec<EquationIndex>,
    /// What it takes, s; 0 where the data do not say.
    pub duration: f64,
    /// How often it is required.
    pub required: usize,
    /// Whether it must not be chosen.
    pub forbidden: bool,
}

/// The column with the time that a row takes.
const DURATION: &str = "duration";

/// The candidates in the order of the data.
///
/// Fails if the estimate does not observe the stage, if a column is missing, and if a named candidate does not exist.
pub fn candidates(problem: &Problem, wanted: &Planning) -> Result<Vec<Candidate>> {
    let set = problem.set_named(&wanted.candidates).ok_or_else(|| {
        let message = format!("`{}` does not observe `{}`", wanted.estimate, wanted.candidates);
        wrong("candidates", message).suggest(&wanted.candidates, problem.sets.iter().map(|set| set.name.as_str()))
    })?;
    let layout = &problem.sets[set].info().layout;
    let data = &layout.data;
    let labels =
        wanted.by.as_deref().map(|by| data.required_labels(by).map_err(|error| error.setting("by"))).transpose()?;
    let durations = match wanted.budget_s {
        Some(_) => Some(data.required_numbers(DURATION).map_err(|error| error.setting("budget_s"))?),
        None => data.numbers(DURATION),
    };
    let mut found: Vec<Candidate> = Vec::new();
    let mut places: BTreeMap<String, usize> = BTreeMap::new();
    for (equation, (of, row)) in EquationIndex::enumerate(problem.equation_rows()) {
        if of != set {
            continue;
        }
        let Some(data_row) = layout.rows[row].data_row else { continue };
        let label = labels.map_or_else(|| own_label(data, data_row), |labels| labels[data_row].to_string());
        let place = *places.entry(label.clone()).or_insert_with(|| {
            let (rows, equations) = (Vec::new(), Vec::new());
            found.push(Candidate { label, rows, equations, duration: 0.0, required: 0, forbidden: false });
            found.len() - 1
        });
        let candidate = &mut found[place];
        candidate.equations.push(equation);
        if candidate.rows.last() != Some(&row) {
            candidate.rows.push(row);
            candidate.duration += durations.map_or(0.0, |durations| durations[data_row]);
        }
    }
    named("required", &wanted.required, &mut found, |candidate| candidate.required += 1);
    named("forbidden", &wanted.forbidden, &mut found, |candidate| candidate.forbidden = true);
    Ok(found)
}

/// Name of a row that is a candidate by itself: `113`, or `beams:113` where there are several files.
fn own_label(data: &Dataset, data_row: DataRow) -> String {
    let origin = data.origins[data_row];
    let several = data.files.get(origin.file).filter(|_| data.files.len() > 1);
    match several.and_then(|file| file.file_stem()) {
        Some(file) => format!("{}:{}", file.display(), origin.row),
        None => origin.row.to_string(),
    }
}

/// Marks the candidates that a setting names. A recipe may name rows that other data do not have: that is told.
fn named(key: &str, labels: &[Label], candidates: &mut [Candidate], mark: impl Fn(&mut Candidate)) {
    for (index, label) in labels.iter().enumerate() {
        match candidates.iter_mut().find(|candidate| candidate.label == label.0) {
            Some(candidate) => mark(candidate),
            None => tracing::warn!(
                "plan.{key}[{index}]: there is no candidate {} in these data; it is passed over",
                label.0
            ),
        }
    }
}
