//! When references have to be measured again, so that what has moved since is known as well as it is wanted.
//!
//! A reference that reads a(t) x, x being the unknowns with the covariance S, tells all that has moved until it is measured. At a later
//! time t the variance of what has moved since t0 is (a(t) - a(t0)) S (a(t) - a(t0))'. Only what follows the time is left of it.

use abbe_core::{Error, PathItem, Problem, Quantity, Result, SetIndex, in_parallel, matches};

use crate::candidates::Candidate;
use crate::order::at_time;
use crate::settings::{Again, Ordering};
use crate::{PlanFigures, wrong};

/// When a reference has to be measured again.
#[derive(Debug, Clone, PartialEq)]
pub struct Revisit {
    /// Its label.
    pub reference: String,
    /// When it is measured, s; the first time is the beginning of the plan.
    pub times: Vec<f64>,
    /// Until when this holds, s.
    pub until: f64,
    /// The largest standard uncertainty of what has moved since the last time, mm.
    pub largest: f64,
    /// What a row takes, s.
    pub row: f64,
}

impl Revisit {
    /// The shortest time from one measurement to the next one, s; none if one is enough.
    pub fn shortest(&self) -> Option<f64> {
        self.times.windows(2).map(|pair| pair[1] - pair[0]).min_by(f64::total_cmp)
    }
}

/// Points in time; between two of them derivatives run straight.
const POINTS: usize = 1025;

/// Says when each reference is measured again; `figures` are those of the planned measurements, which end at `end`.
///
/// Fails for references that read no length, for patterns that match nothing, for times that the model does not know, and if nothing
/// would be left of the time between two measurements.
pub(crate) fn revisits(
    contact: &Problem,
    (candidates, set): (&[Candidate], SetIndex),
    (ordering, again): (&Ordering, &Again),
    (figures, end): (&PlanFigures, f64),
) -> Result<Vec<Revisit>> {
    let covariance = covariance(contact, again, figures)?;
    let until = again.until_s.unwrap_or(end);
    if until <= ordering.start_s {
        return Err(at_again("until_s", format!("{until} s: a time behind the beginning of the plan was expected")));
    }
    let references =
        candidates.iter().filter(|candidate| ordering.references.iter().any(|label| label.0 == candidate.label));
    references
        .map(|reference| {
            let course = Course::new(contact, (reference, set), [ordering.start_s, until])?;
            let row = ordering.row(reference);
            let (times, largest) =
                course.times(&covariance, again.standard_uncertainty_um * 1e-3, row * reference.rows.len() as f64)?;
            Ok(Revisit { reference: reference.label.clone(), times, until, largest, row })
        })
        .collect()
}

/// What is unknown of the unknowns, row by row: what was stated, or what the plan leaves open.
fn covariance(contact: &Problem, again: &Again, figures: &PlanFigures) -> Result<Vec<f64>> {
    if again.changes.is_empty() {
        return Ok(figures.covariance.clone());
    }
    let names: Vec<&str> = contact.unknowns.iter().map(|unknown| unknown.name.as_str()).collect();
    let mut covariance = vec![0.0; names.len() * names.len()];
    for (line, change) in again.changes.iter().enumerate() {
        for (index, pattern) in change.parameters.iter().enumerate() {
            let mut fitting = (0..names.len()).filter(|unknown| matches(pattern, names[*unknown])).peekable();
            if fitting.peek().is_none() {
                let mut error = at_again("changes", format!("`{pattern}` matches nothing that is estimated"));
                error.setting.extend([
                    PathItem::Index(line),
                    PathItem::Key("parameters".to_owned()),
                    PathItem::Index(index),
                ]);
                return Err(error.suggest(pattern, names.iter().copied()));
            }
            fitting.for_each(|unknown| {
                covariance[unknown * names.len() + unknown] = change.standard_uncertainty.powi(2);
            });
        }
    }
    Ok(covariance)
}

fn at_again(key: &str, message: impl Into<String>) -> Error {
    let mut error = wrong("order", message);
    error.setting.extend([PathItem::Key("again".to_owned()), PathItem::Key(key.to_owned())]);
    error
}

/// Derivatives of what a reference reads to the unknowns, over the time.
struct Course {
    times: Vec<f64>,
    /// For each time the rows of its equations that are lengths.
    rows: Vec<Vec<f64>>,
    unknowns: usize,
}

impl Course {
    fn new(contact: &Problem, (reference, set): (&Candidate, SetIndex), [from, to]: [f64; 2]) -> Result<Self> {
        let mut alone = contact.clone();
        for (index, own) in SetIndex::enumerate(&mut alone.sets) {
            own.rows.retain(|row| index == set && reference.rows.contains(row));
        }
        if !alone.quantities().contains(&Quantity::Length) {
            let message = format!("the reference {} reads no length", reference.label);
            return Err(at_again("standard_uncertainty_um", message));
        }
        let times: Vec<f64> =
            (0..POINTS).map(|point| from + (to - from) * point as f64 / (POINTS - 1) as f64).collect();
        let rows = in_parallel(&times, None, |time| Self::rows(&at_time(&alone, set, |_| *time)?));
        let rows = rows.into_iter().collect::<Result<_>>().map_err(|error| match error.setting.is_empty() {
            true => Error { setting: at_again("until_s", "").setting, ..error },
            false => error,
        })?;
        Ok(Self { times, rows, unknowns: contact.unknowns.len() })
    }

    fn rows(problem: &Problem) -> Result<Vec<f64>> {
        let lengths: Vec<bool> =
            problem.quantities().into_iter().map(|quantity| quantity == Quantity::Length).collect();
        let mut rows = Vec::new();
        problem.linearise(&problem.start(), |block| {
            for (_, _, derivatives) in block.lines().filter(|(equation, ..)| lengths[*equation]) {
                rows.extend_from_slice(derivatives);
            }
        })?;
        Ok(rows)
    }

    /// Standard uncertainty of what has moved between two times, that of the equation which moves most.
    fn moved(&self, covariance: &[f64], from: usize, to: usize) -> f64 {
        let n = self.unknowns;
        let each = self.rows[from].chunks_exact(n.max(1)).zip(self.rows[to].chunks_exact(n.max(1)));
        let variance = |(before, after): (&[f64], &[f64])| {
            let change: Vec<f64> = after.iter().zip(before).map(|(after, before)| after - before).collect();
            let moving: Vec<usize> = (0..n).filter(|unknown| change[*unknown] != 0.0).collect();
            let of = |row: &usize| -> f64 {
                moving.iter().map(|column| change[*row] * covariance[row * n + column] * change[*column]).sum()
            };
            moving.iter().map(of).sum::<f64>()
        };
        each.map(variance).fold(0.0, f64::max).sqrt()
    }

    /// When it is measured, each time at the last moment, and the largest standard uncertainty in between, mm.
    fn times(&self, covariance: &[f64], wanted: f64, takes: f64) -> Result<(Vec<f64>, f64)> {
        let (mut last, mut largest) = (0, 0.0_f64);
        let mut times = vec![self.times[0]];
        for point in 1..self.times.len() {
            let moved = self.moved(covariance, last, point);
            if moved <= wanted {
                largest = largest.max(moved);
                continue;
            }
            if last + 1 == point || self.times[point - 1] - self.times[last] < takes {
                let message = format!(
                    "{:.3} µm have moved {:.0} s after {:.0} s already, by their standard uncertainty, and the reference itself takes \
                     {takes:.0} s: it cannot be held so well",
                    moved * 1e3,
                    self.times[point] - self.times[last],
                    self.times[last]
                );
                return Err(at_again("standard_uncertainty_um", message).help("want less, or know better what moves"));
            }
            last = point - 1;
            times.push(self.times[last]);
            largest = largest.max(self.moved(covariance, last, point));
        }
        Ok((times, largest))
    }
}

impl Ordering {
    /// What a row of a candidate takes, s.
    pub(crate) fn row(&self, candidate: &Candidate) -> f64 {
        match candidate.duration > 0.0 {
            true => candidate.duration / candidate.rows.len() as f64,
            false => self.duration_s,
        }
    }
}
