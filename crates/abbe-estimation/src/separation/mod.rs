//! Which further measurements separate the unknowns that the recorded ones cannot separate.
//!
//! A lost direction is a change of parameters that has no effect on any recorded row. Here it is tried on measurements that
//! were not made: the features that are touched at other positions of an axis, from the other direction of approach or with
//! another stylus; a feature elsewhere; a calibrated length; another probe offset. A measurement separates the direction if the change has an
//! effect on it that is not only a shift of the new feature. As for rank, this is judged by the derivatives of the model and
//! of the observation equations, so it holds for any chain and any artefact.

mod direction;
mod gaps;
mod places;
mod statuses;

use abbe_core::{Contact, Problem, Result, StatusRole, Unknown, WeakDirection};

use crate::contact::rank_point;
use crate::probe_offset::{OFFSETS, tip_offsets, with_offset};

use direction::{Effect, LostDirection};
use gaps::{Gap, gaps};
use places::{places, recorded_statuses};
use statuses::statuses;

/// A measurement separates a lost direction if the ratio of the change along the direction to the largest change by a single
/// unknown is above this. A lost direction has a ratio of about 1e-12, dimensionless.
const SEEN: f64 = 1e-6;

/// Below this value of the same ratio a measurement separates the direction only weakly and is listed after others.
const WEAK: f64 = 1e-3;

/// Trials whose ratio is at least this part of the largest one count as equally good.
const ALIKE: f64 = 0.2;

/// Most measurements that are proposed for one direction.
const TOLD: usize = 3;

/// Most rows of a set that are tried at other statuses.
const ROWS: usize = 60;

/// A measurement that was not made.
struct Trial {
    /// Trials of one group differ in where they measure; only one of them is proposed.
    group: Group,
    /// What to do.
    sentence: String,
    /// What it would measure.
    measured: Measured,
}

/// What is new in a measurement, in the order of effort, the easiest first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Group {
    /// A status (its index) that never varies takes another value.
    Constant(usize),
    /// A status (its index) that varies takes a further value.
    Further(usize),
    /// A feature elsewhere.
    Place,
    /// A length that is known.
    Length,
    /// The recorded rows with another probe offset.
    Probe,
}

/// What a trial measures.
enum Measured {
    /// The rows of a problem.
    Rows(Box<Problem>),
    /// The rows of a problem measured with a probe whose own offset is not known: changes of these unknowns.
    OtherProbe(Box<Problem>, Vec<Unknown>),
    /// A point that is fixed on the table but not known there: the statuses at which the tip is on it.
    Point(Vec<Vec<f64>>),
    /// A length on the table along a unit vector of the table frame: the statuses at both ends.
    Length([Vec<f64>; 2], [f64; 3]),
}

/// The measurements that can be tried on a machine, beside those that were made.
pub struct SeparationTrials {
    /// The recorded rows (a part of them if there are many) at nominal contact, with the unknowns at their values.
    recorded: Problem,
    trials: Vec<Trial>,
    gaps: Vec<Gap>,
}

impl SeparationTrials {
    /// The trials for a problem whose unknowns have the values `x`. Rows are moved to nominal contact.
    pub fn new(problem: &Problem, x: &[f64]) -> Result<Self> {
        let recorded = rank_point(&thinned(problem), x)?;
        let mut trials = statuses(problem, &recorded)?;
        trials.extend(places(problem, &recorded)?);
        trials.extend(other_probes(&recorded)?);
        Ok(Self { recorded, trials, gaps: gaps(problem) })
    }

    /// Sentences that say which measurements separate a lost direction, the best first, at most three. If none does, a
    /// sentence that says what to do instead. Fails on a direction whose unknowns are not those of the problem.
    pub fn separating(&self, vector: &WeakDirection) -> Result<Vec<String>> {
        let direction = LostDirection::new(&self.recorded, vector)?;
        let lost = direction.effect(&Measured::Rows(Box::new(self.recorded.clone())))?;
        // A direction is rounded. So its effect on the recorded rows, which should be zero, is a lower limit for an effect
        // that counts.
        let seen = SEEN.max(10.0 * lost.relative());
        let mut effects = Vec::with_capacity(self.trials.len());
        for trial in &self.trials {
            // Another offset is the lever of rotations. A translation it shows at other commands only, which gaps tell better.
            let counts = trial.group != Group::Probe || direction.turns();
            effects.push(match direction.effect(&trial.measured) {
                Err(error) if error.fatal => return Err(error),
                Ok(effect) if counts => effect,
                // If the model cannot be evaluated there, nothing can be measured there.
                Ok(_) | Err(_) => Effect::default(),
            });
        }
        let found = self.best(&effects, seen);
        if found.is_empty() {
            let recorded = direction.effect(&Measured::Point(recorded_statuses(&self.recorded)))?;
            // A direction that does not move the tip at the recorded poses may move it between them.
            let still = recorded.moved <= seen * recorded.single;
            if let Some(sentence) = gaps::sentence(&self.gaps, &direction, seen).filter(|_| still) {
                return Ok(vec![sentence]);
            }
            effects.push(recorded);
            let moves = effects.iter().any(|effect| effect.moved > seen * effect.single);
            return Ok(vec![direction.without_measurement(moves)]);
        }
        Ok(found)
    }

    /// The sentence of one trial of every group that sees the direction, the best first.
    fn best(&self, effects: &[Effect], seen: f64) -> Vec<String> {
        let mut groups: Vec<Group> = self.trials.iter().map(|trial| trial.group).collect();
        groups.sort();
        groups.dedup();
        let mut found: Vec<(bool, &str)> = Vec::new();
        for group in groups {
            let trials = || self.trials.iter().zip(effects).filter(|(trial, _)| trial.group == group);
            let largest = trials().map(|(_, effect)| effect.relative()).fold(0.0, f64::max);
            // Of the trials with effects of the same order of magnitude, the first is the simplest.
            let simplest = trials().find(|(_, effect)| largest > seen && effect.relative() >= ALIKE * largest);
            found.extend(simplest.map(|(trial, _)| (largest < WEAK, trial.sentence.as_str())));
        }
        found.sort_by_key(|(weak, _)| *weak);
        found.into_iter().take(TOLD).map(|(_, sentence)| sentence.to_owned()).collect()
    }
}

/// Trials of the recorded rows with other probe offsets. A model with several styli has them among its statuses.
fn other_probes(recorded: &Problem) -> Result<Vec<Trial>> {
    if recorded.model.info().status_index(&StatusRole::Stylus).is_some() {
        return Ok(Vec::new());
    }
    let offsets = tip_offsets(recorded);
    let own: Vec<Unknown> = offsets.iter().map(|(_, offset)| offset.clone()).collect();
    let mut trials = Vec::new();
    for (letter, offset) in &offsets {
        for shift in OFFSETS {
            if let Some(rows) = with_offset(recorded, offset, shift)? {
                let sentence = format!(
                    "measure with another probe offset too, for instance a tip {} mm further along {letter} of the tool",
                    shift.abs()
                );
                trials.push(Trial {
                    group: Group::Probe,
                    sentence,
                    measured: Measured::OtherProbe(Box::new(rows), own.clone()),
                });
            }
        }
    }
    Ok(trials)
}

/// Sentences that say which measurements separate a lost direction of a problem whose unknowns have the values `x`.
///
/// For one direction; see [`SeparationTrials`] for several.
pub fn separating_measurements(problem: &Problem, x: &[f64], vector: &WeakDirection) -> Result<Vec<String>> {
    SeparationTrials::new(problem, x)?.separating(vector)
}

/// The problem with at most `ROWS` rows of every set, evenly spread but not in step with any order of features.
pub(crate) fn thinned(problem: &Problem) -> Problem {
    let mut problem = problem.clone();
    for set in &mut problem.sets {
        set.rows = spread_out(set.rows.len(), ROWS).into_iter().map(|place| set.rows[place]).collect();
    }
    problem
}

/// At most `most` of `count` places, ascending, spread out by the golden section: no regular pattern of rows is missed.
pub(crate) fn spread_out(count: usize, most: usize) -> Vec<usize> {
    const GOLDEN: f64 = 0.618_033_988_749_894_9;
    if count <= most {
        return (0..count).collect();
    }
    let mut places: Vec<usize> = (0..most).map(|k| ((k as f64 * GOLDEN).fract() * count as f64) as usize).collect();
    places.sort_unstable();
    places.dedup();
    places
}

/// What is done to a feature, what that is called, and what the feature then is: it is touched where linear axes move until there is contact; a laser, a bar or
/// a tracker measures.
fn words(problem: &Problem) -> [&'static str; 3] {
    match problem.sets.iter().all(|set| set.info().contact == Contact::LinearAxes) {
        true => ["touch", "touch", "touched"],
        false => ["measure", "measurement", "measured"],
    }
}

/// Numbers of a list for people: `0°, 90°`, at most six of them.
fn listed(numbers: &[String]) -> String {
    const SHOWN: usize = 6;
    let shown = numbers.iter().take(SHOWN).cloned().collect::<Vec<_>>().join(", ");
    if numbers.len() > SHOWN { format!("{shown}, ...") } else { shown }
}
