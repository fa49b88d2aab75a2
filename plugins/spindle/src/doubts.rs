//! What runs say of their own sensors and encoder: signals that are lost, other units, an encoder that slips a little in every turn.

use std::f64::consts::{PI, TAU};

use abbe_numerics::Ends;

use crate::run::Run;

/// Ranges of readings that noise alone has, in its standard deviations.
const OF_NOISE: f64 = 10.0;

/// Tells of a sensor that moves by no more than its noise; `uncertainty` is that of a reading, mm.
pub fn tell_silent(run: &Run, name: &str, ends: &Ends, uncertainty: f64) {
    let [low, high] = ends.range().unwrap_or_default();
    if high - low < OF_NOISE * uncertainty {
        tracing::warn!(
            "run `{}`: {name} moves by {:.3} um, which is what its noise of {:.3} um does: does it see the artefact?",
            run.label,
            (high - low) * 1e3,
            uncertainty * 1e3
        );
    }
}

/// Fewest turns of a part of a run, and its angle and size that tell.
const TURNS: usize = 2;
const CREPT: f64 = 3.0 * PI / 180.0;
const CLEAR: f64 = 3.0;

/// Sums over the readings of a sensor in some turns, for their fundamental.
#[derive(Debug, Clone, Default)]
struct Part {
    turns: std::ops::Range<usize>,
    count: f64,
    readings: f64,
    /// Sums of cosine and sine, and of these times readings.
    plain: [f64; 2],
    read: [f64; 2],
}

impl Part {
    fn push(&mut self, reading: f64, [cos, sin]: [f64; 2]) {
        self.count += 1.0;
        self.readings += reading;
        self.plain = [self.plain[0] + cos, self.plain[1] + sin];
        self.read = [self.read[0] + reading * cos, self.read[1] + reading * sin];
    }

    /// Cosine and sine of the fundamental.
    fn fundamental(&self) -> [f64; 2] {
        let mean = self.readings / self.count.max(1.0);
        [0, 1].map(|part| 2.0 * (self.read[part] - mean * self.plain[part]) / self.count.max(1.0))
    }
}

/// The fundamental of a sensor in the first and in the last quarter of a run.
#[derive(Debug, Clone)]
pub struct Creeping([Part; 2]);

impl Creeping {
    /// Of a run of so many whole turns.
    pub fn new(whole: usize) -> Self {
        let quarter = whole / 4;
        Self([0..quarter, whole - quarter..whole].map(|turns| Part { turns, ..Part::default() }))
    }

    /// Adds a reading, from the first one on (mm); `turned` is the angle from the first one, and the cosine and sine are those of its own.
    pub fn push(&mut self, turned: f64, reading: f64, angle: [f64; 2]) {
        let turn = (turned / TAU) as usize;
        let parts = self.0.iter_mut().filter(|part| part.turns.contains(&turn));
        parts.for_each(|part| part.push(reading, angle));
    }

    /// Tells of a fundamental that turns while the run lasts: the artefact does not turn in the spindle, the encoder slips. `rest` is the
    /// RMS of what harmonics leave, mm.
    pub fn tell(&self, run: &Run, name: &str, rest: f64) {
        if self.0[0].turns.len() < TURNS {
            return;
        }
        let [first, last] = [0, 1].map(|part| self.0[part].fundamental());
        let [before, after] = [first, last].map(|[cos, sin]| sin.atan2(cos));
        let crept = (after - before + PI).rem_euclid(TAU) - PI;
        let size = first[0].hypot(first[1]).min(last[0].hypot(last[1]));
        if crept.abs() > CREPT && size > CLEAR * rest {
            tracing::warn!(
                "run `{}`: the fundamental of {name} turns by {:.1} deg from the first quarter of the run to the last one: does the encoder \
                 slip a little in every turn?",
                run.label,
                crept.to_degrees()
            );
        }
    }
}

/// Most that a size of one run may be larger or smaller than the median of others.
const ALIKE: f64 = 6.0;

/// Tells of runs whose values of one kind are far from those of the others; `what` are they, by the names of runs, mm.
pub fn tell_unlike(what: &str, values: &[(String, f64)]) {
    for (place, (run, value)) in values.iter().enumerate() {
        let others = values.iter().enumerate().filter(|(other, _)| *other != place);
        let mut others: Vec<f64> = others.map(|(_, (_, value))| *value).collect();
        others.sort_by(f64::total_cmp);
        let Some(median) = others.get(others.len() / 2).filter(|_| others.len() >= 2) else { continue };
        let ratio = value / median;
        if *median > 0.0 && !(1.0 / ALIKE..ALIKE).contains(&ratio) {
            tracing::warn!(
                "run `{run}`: {what} is {:.4} um, and {:.4} um in other runs: has a sensor another range or unit here?",
                value * 1e3,
                median * 1e3
            );
        }
    }
}
