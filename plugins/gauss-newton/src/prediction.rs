//! Leaves out what makes predictions no better: sensors and time constants without which readings that no estimate has seen are
//! predicted as well.

use std::collections::BTreeSet;

use abbe_core::{
    Calibration, Class, Error, Owner, ParameterRole, PathItem, PredictedStructure, Problem, Result, RowIndex,
    SelectionByPrediction, SetIndex, Unknown, matches,
};

use crate::GaussNewton;
use crate::select::{Select, without};

/// Value of coefficients in the place of zero where effects of shapes are asked.
const TINY: f64 = 1e-9;

/// Rows that are left out together.
struct Run {
    label: String,
    rows: BTreeSet<(SetIndex, RowIndex)>,
}

/// The candidates that a structure leaves out, and its error.
struct Tried {
    left_out: BTreeSet<usize>,
    error: f64,
}

impl GaussNewton {
    /// The estimate with the fewest unknowns whose predictions are as good as the best ones.
    pub(crate) fn estimate_predicted(
        &self,
        problem: &Problem,
        select: &Select,
        explained: bool,
    ) -> Result<Calibration> {
        select.candidates(problem)?;
        // More time constants than there are do not settle; fewer may.
        let (start, failed) = match self.estimate_all(problem, false) {
            Ok(all) => (problem.with_values(&problem.values_of(&all)), None),
            Err(error) if error.fatal || error.class != Class::Data => return Err(error),
            Err(error) => (problem.clone(), Some(error)),
        };
        let runs = runs(problem, select)?;
        let tried = self.tried(&start, select, &runs)?;
        let best = tried.iter().map(|tried| tried.error).fold(f64::INFINITY, f64::min);
        let as_good = tried.iter().filter(|tried| tried.error <= best * (1.0 + select.worse()));
        let unknowns = |tried: &&Tried| select.without(&start, &tried.left_out).unknowns.len();
        let Some(chosen) = as_good.min_by_key(unknowns) else {
            let none = || Error::data("no choice of these candidates predicts any run").setting("select");
            return Err(failed.unwrap_or_else(none));
        };
        let reduced = self.without_idle_shapes(select.without(&start, &chosen.left_out))?;
        let names = |kept: bool| {
            let stays = |unknown: &&Unknown| reduced.unknowns.iter().any(|own| own.name == unknown.name) == kept;
            let of_candidates = problem.unknowns.iter().filter(|unknown| select.is_candidate(unknown));
            of_candidates.filter(stays).map(|unknown| unknown.name.clone()).collect()
        };
        let structure = |tried: &Tried| PredictedStructure {
            left_out: tried.left_out.iter().map(|&index| select.candidates[index].clone()).collect(),
            error: tried.error,
        };
        let selection = SelectionByPrediction {
            runs: runs.iter().map(|run| run.label.clone()).collect(),
            worse: select.worse(),
            kept: names(true),
            left_out: names(false),
            chosen: structure(chosen),
            tried: tried.iter().map(structure).collect(),
        };
        let mut calibration = self.estimate_all(&reduced, explained)?;
        calibration.fit.selection_by_prediction = Some(selection);
        Ok(calibration)
    }

    /// Structures from all candidates downwards, each without the candidate that predictions need least, as long as they do not get
    /// much worse.
    fn tried(&self, problem: &Problem, select: &Select, runs: &[Run]) -> Result<Vec<Tried>> {
        let of = |left_out: BTreeSet<usize>| -> Result<Option<Tried>> {
            let error = self.error_of(problem, select, &left_out, runs)?;
            Ok(error.map(|error| Tried { left_out, error }))
        };
        let mut tried: Vec<Tried> = of(BTreeSet::new())?.into_iter().collect();
        let (mut left_out, mut error) = (BTreeSet::new(), tried.first().map_or(f64::INFINITY, |all| all.error));
        while left_out.len() < select.candidates.len() {
            let mut best: Option<Tried> = None;
            for candidate in (0..select.candidates.len()).filter(|candidate| !left_out.contains(candidate)) {
                let more = left_out.iter().copied().chain([candidate]).collect();
                let Some(found) = of(more)? else { continue };
                if best.as_ref().is_none_or(|best| found.error < best.error) {
                    best = Some(found);
                }
            }
            let Some(best) = best else { break };
            let much_worse = best.error > error * (1.0 + select.worse());
            (left_out, error) = (best.left_out.clone(), best.error);
            tried.push(best);
            if much_worse {
                break;
            }
        }
        Ok(tried)
    }

    /// Root mean square of what is predicted wrong of runs that were left out, in stated standard uncertainties; none if no estimate
    /// of the others can be made.
    fn error_of(
        &self,
        problem: &Problem,
        select: &Select,
        left_out: &BTreeSet<usize>,
        runs: &[Run],
    ) -> Result<Option<f64>> {
        let reduced = self.without_idle_shapes(select.without(problem, left_out))?;
        let reduced = reduced.watched_by(problem.monitor.without_events());
        let (mut squares, mut count) = (0.0, 0_usize);
        for run in runs {
            let [trained, held] = [false, true].map(|held| of_run(&reduced, run, held));
            let calibration = match self.estimate_all(&trained, false) {
                Ok(calibration) => calibration,
                Err(error) if error.fatal || error.class == Class::Interrupted => return Err(error),
                Err(_) => return Ok(None),
            };
            let mut held = held.starting_from(&calibration);
            held.unknowns.clear();
            for (residual, uncertainty) in held.residuals(&[])?.into_iter().zip(held.standard_uncertainties()) {
                squares += (residual / uncertainty).powi(2);
                count += 1;
            }
        }
        Ok(Some((squares / count.max(1) as f64).sqrt()))
    }

    /// The problem without shapes (time constants) of which no coefficient is left.
    pub(crate) fn without_idle_shapes(&self, problem: Problem) -> Result<Problem> {
        let info = problem.model.info();
        let is_shape = |unknown: &Unknown| {
            unknown.owner == Owner::Machine && info.parameters[unknown.index].role == ParameterRole::Shape
        };
        if !problem.unknowns.iter().any(is_shape) {
            return Ok(problem);
        }
        // Where no coefficient is zero a shape without an effect has none left.
        let nonzero = |(index, value): (usize, f64)| if value == 0.0 { TINY * (1 + index) as f64 } else { value };
        let start: Vec<f64> = problem.start().into_iter().enumerate().map(nonzero).collect();
        let factor = self.weighted(&problem)?.factor(&start, None)?;
        let norms = factor.norms();
        let unknowns = problem.unknowns.iter().zip(norms);
        let idle = unknowns.filter(|(unknown, norm)| is_shape(unknown) && **norm == 0.0);
        let idle: Vec<String> = idle.map(|(unknown, _)| unknown.name.clone()).collect();
        Ok(problem.without_unknowns(|unknown| idle.contains(&unknown.name)))
    }
}

impl Select {
    fn is_candidate(&self, unknown: &Unknown) -> bool {
        self.candidates.iter().any(|pattern| matches(pattern, &unknown.name))
    }

    /// The problem without what some candidates match; it has its nominal value.
    fn without(&self, problem: &Problem, left_out: &BTreeSet<usize>) -> Problem {
        without(problem, |unknown| {
            unknown.owner == Owner::Machine
                && left_out.iter().any(|&index| matches(&self.candidates[index], &unknown.name))
        })
    }
}

/// The rows of a run, or all others.
fn of_run(problem: &Problem, run: &Run, held: bool) -> Problem {
    let mut part = problem.clone();
    for (index, set) in SetIndex::enumerate(&mut part.sets) {
        set.rows.retain(|row| run.rows.contains(&(index, *row)) == held);
    }
    part
}

/// The runs of a problem: rows with the same label, or parts of the time.
fn runs(problem: &Problem, select: &Select) -> Result<Vec<Run>> {
    let mut runs: Vec<Run> = Vec::new();
    let (ends, parts) = (times(problem), select.parts().get() as u64);
    let part = |time: f64| ((time - ends[0]) / (ends[1] - ends[0]) * parts as f64) as u64;
    for (index, set) in SetIndex::enumerate(&problem.sets) {
        let layout = &set.info().layout;
        let labels = select.runs.as_ref().and_then(|column| layout.data.labels(column));
        let times = layout.data.numbers("time").filter(|_| select.runs.is_none());
        for &row in &set.rows {
            let Some(data_row) = layout.rows[row].data_row else { continue };
            let label = match (labels, times) {
                (Some(labels), _) => labels[data_row].to_string(),
                (None, Some(times)) => format!("part {}", part(times[data_row]).min(parts - 1) + 1),
                (None, None) => continue,
            };
            match runs.iter_mut().find(|run| run.label == label) {
                Some(run) => drop(run.rows.insert((index, row))),
                None => runs.push(Run { label, rows: [(index, row)].into() }),
            }
        }
    }
    if runs.len() > 1 {
        return Ok(runs);
    }
    let (setting, message) = match &select.runs {
        Some(column) => ("runs", format!("no data have several labels in a column `{column}`")),
        None => {
            ("by", "no data have a column `time_s` with several times, to predict a part from the others".to_owned())
        }
    };
    let error = Error::data(message).help("the rows of one run are predicted from those of the others");
    Err(Error { setting: ["select", setting].map(|key| PathItem::Key(key.to_owned())).to_vec(), ..error })
}

/// First and last time of all rows.
fn times(problem: &Problem) -> [f64; 2] {
    let mut ends = [f64::INFINITY, f64::NEG_INFINITY];
    for set in &problem.sets {
        let layout = &set.info().layout;
        let Some(times) = layout.data.numbers("time") else { continue };
        for data_row in set.rows.iter().filter_map(|&row| layout.rows[row].data_row) {
            ends = [ends[0].min(times[data_row]), ends[1].max(times[data_row])];
        }
    }
    ends
}
