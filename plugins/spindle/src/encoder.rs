//! The angle of the spindle: counted on, without slips, jumps and missing turns.

use std::borrow::Cow;
use std::f64::consts::{PI, TAU};

use abbe_core::{Error, Result};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::run::{Run, Step};
use crate::stretches::Stretch;

/// How the angle is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Encoder {
    /// Counted on over the turns.
    #[default]
    Counted,
    /// From 0 to 360 degrees in every turn: steps of more than half a turn are taken as the end of a turn.
    Wrapped,
}

/// Part of the usual step by which a step may differ from what time says.
const SLIP: f64 = 0.25;

/// Angle without readings that is missing, rad.
const MISSING: f64 = 0.25 * TAU;

/// Part of the speed by which the speeds of turns may differ.
const STEADY: f64 = 0.1;

/// Counts angles on, in the order of the readings.
pub struct Counter {
    encoder: Encoder,
    /// Turns that are added, and the last angle as it was written.
    turns: f64,
    before: Option<f64>,
}

impl Counter {
    /// At the begin of a run.
    pub fn new(encoder: Encoder) -> Self {
        Self { encoder, turns: 0.0, before: None }
    }

    /// The next angles counted on.
    pub fn counted<'a>(&mut self, angles: &'a [f64]) -> Cow<'a, [f64]> {
        if self.encoder == Encoder::Counted {
            return Cow::Borrowed(angles);
        }
        let counted = angles.iter().map(|angle| {
            self.turns -= ((angle - self.before.unwrap_or(*angle)) / TAU).round();
            self.before = Some(*angle);
            angle + self.turns * TAU
        });
        Cow::Owned(counted.collect())
    }
}

/// The usual steps of a run.
#[derive(Debug, Clone, Copy, Default)]
pub struct Usual {
    /// Of the angle, rad, with its sign.
    step: f64,
    /// Angle by time, rad/s.
    speed: f64,
    /// Middle and spread of steps beyond what time says, rad.
    middle: f64,
    spread: f64,
}

impl Usual {
    /// Of some steps of a run.
    pub fn of(steps: &[(u64, Step)]) -> Self {
        let of = |value: fn(&Step) -> f64| median(steps.iter().map(|(_, step)| value(step)).collect());
        let (step, time) = (of(|step| step.angle), of(|step| step.time));
        let timed = steps.iter().filter(|(_, step)| step.time > 0.0);
        let ratios = timed.map(|(_, step)| step.angle / step.time).collect();
        let speed = if time > 0.0 { median(ratios) } else { 0.0 };
        let beyond = || steps.iter().map(|(_, step)| step.angle - speed * step.time);
        let middle = median(beyond().collect());
        let spread = median(beyond().map(|beyond| (beyond - middle).abs()).collect());
        Self { step, speed, middle, spread }
    }
}

fn median(mut values: Vec<f64>) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Fails for a run of which nothing can be checked: it has too few readings, or its angle stands.
pub fn too_few(run: &Run) -> Result<()> {
    if run.count < 3 {
        return Err(run.error(format!("{} readings are no turn of a spindle", run.count)));
    }
    if run.usual.step == 0.0 {
        return Err(run
            .error("the angle of the spindle stands")
            .help("is the encoder connected, and its column right?"));
    }
    Ok(())
}

/// Turns of a run, the step behind the last reading included, and its speed, revolutions per minute.
pub fn turns_and_speed(run: &Run) -> (f64, f64) {
    let [span, time] = [run.angles, run.times].map(|[first, last]| last - first);
    ((span.abs() + run.usual.step.abs()) / TAU, span.abs() / TAU / time * 60.0)
}

/// The steps of a run as they are checked: an angle has to go on as time does, and turns have to take the same time.
pub struct Steps {
    /// Angle and time of the reading before; none before the first one.
    before: Option<[f64; 2]>,
    /// When the present turn began, s, and turns before it.
    begin: f64,
    turn: usize,
    /// The first turn with another speed.
    unsteady: Option<Error>,
}

impl Steps {
    /// At the begin of a run.
    pub fn new(run: &Run) -> Self {
        Self { before: None, begin: run.times[0], turn: 0, unsteady: None }
    }

    /// Fails at the first step that is none.
    pub fn check(&mut self, run: &Run, encoder: Encoder, stretch: &Stretch<'_>) -> Result<()> {
        for (index, (&angle, &time)) in stretch.angles.iter().zip(stretch.times).enumerate() {
            if let Some([before, then]) = self.before {
                check_step(run, encoder, stretch, index, [before, then])?;
                let end = (self.turn + 1) as f64 * TAU;
                let turned = (angle - run.angles[0]).abs();
                if turned >= end {
                    self.end_turn(run, stretch, index, (end, turned), [before, then]);
                }
            }
            self.before = Some([angle, time]);
        }
        Ok(())
    }

    /// A turn ends between a reading and the one before.
    fn end_turn(
        &mut self,
        run: &Run,
        stretch: &Stretch<'_>,
        index: usize,
        (end, turned): (f64, f64),
        [before, then]: [f64; 2],
    ) {
        let before = (before - run.angles[0]).abs();
        let part = (end - before) / (turned - before);
        let time = then + part * (stretch.times[index] - then);
        let speed = 60.0 / (time - self.begin);
        if (speed - run.speed).abs() > STEADY * run.speed && self.unsteady.is_none() {
            let message = format!("turn {} has {speed:.0} rpm, the run {:.0} rpm", self.turn + 1, run.speed);
            let error = stretch.error_at(index, message);
            self.unsteady = Some(error.help("a run has one speed: leave out where it comes up or down"));
        }
        (self.begin, self.turn) = (time, self.turn + 1);
    }

    /// Fails for less than two turns, and where the speed changes.
    pub fn finish(self, run: &Run) -> Result<()> {
        if run.whole_turns() < 2 {
            let message = format!(
                "its angle covers {:.2} turns, and two whole ones at least were expected: their scatter is the uncertainty",
                run.turns
            );
            return Err(run.error(message).help("is the angle in the unit that its column says (`S_deg`, `S_rad`)?"));
        }
        if run.times[1] <= run.times[0] {
            return Err(run.error("the time stands while the spindle turns").help("is the column of the time right?"));
        }
        self.unsteady.map_or(Ok(()), Err)
    }
}

fn check_step(
    run: &Run,
    encoder: Encoder,
    stretch: &Stretch<'_>,
    index: usize,
    [before, then]: [f64; 2],
) -> Result<()> {
    let (usual, now) = (&run.usual, stretch.times[index]);
    let (step, time) = (stretch.angles[index] - before, now - then);
    let is_unusual = (step - usual.step).abs() > SLIP * usual.step.abs();
    if !is_unusual && time >= 0.0 {
        return Ok(());
    }
    if time < 0.0 {
        let message = format!("the time goes back from {then} s to {now} s");
        let error = stretch.error_at(index, message);
        return Err(error.help("readings of a run have to stand in the order of time"));
    }
    let expected = usual.speed * time + usual.middle;
    let allowed = SLIP * usual.step.abs() + 8.0 * usual.spread;
    // Single readings that are missing agree with the time, and times in coarse steps with the usual step of the angle.
    let slipped = usual.speed != 0.0 && (step - expected).abs() > allowed;
    let [told, wanted] = [step, if usual.speed == 0.0 { usual.step } else { expected }].map(f64::to_degrees);
    if step * usual.step <= 0.0 {
        let message =
            format!("the angle of the spindle goes back: by {told:.3} deg, and {wanted:.3} deg were expected");
        let wraps = encoder == Encoder::Counted && (step.abs() - TAU).abs() < PI;
        let help = if wraps {
            "write `encoder: wrapped` if it begins again with every turn"
        } else {
            "the encoder slips or jumps here: measure again, or leave out what is behind it"
        };
        return Err(stretch.error_at(index, message).help(help));
    }
    if slipped {
        let message = format!(
            "the angle of the spindle goes on by {told:.3} deg in {time:.6} s, and {wanted:.3} deg were expected"
        );
        return Err(stretch
            .error_at(index, message)
            .help("the encoder slips or jumps here: measure again, or leave out what is behind it"));
    }
    if step.abs() > MISSING && step.abs() > 1.5 * usual.step.abs() {
        let message =
            format!("readings are missing before this one: over {:.1} deg of a turn", step.abs().to_degrees());
        return Err(stretch.error_at(index, message).help("every turn has to be read all round: measure again"));
    }
    Ok(())
}
