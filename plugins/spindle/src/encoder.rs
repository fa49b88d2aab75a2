//! The angle of the spindle: counted on, without slips, jumps and missing turns.

use std::borrow::Cow;
use std::f64::consts::{PI, TAU};

use abbe_core::Result;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::readings::Run;

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

/// Steps that are looked at to know the usual one.
const LOOKED_AT: usize = 4096;

/// Part of the usual step by which a step may differ from what time says.
const SLIP: f64 = 0.25;

/// Angle without readings that is missing, rad.
const MISSING: f64 = 0.25 * TAU;

/// Part of the speed by which the speeds of turns may differ.
const STEADY: f64 = 0.1;

impl Encoder {
    /// The angle counted on.
    pub fn counted(self, angles: &[f64]) -> Cow<'_, [f64]> {
        if self == Self::Counted {
            return Cow::Borrowed(angles);
        }
        let (mut turns, mut before) = (0.0, angles.first().copied().unwrap_or(0.0));
        let counted = angles.iter().map(|angle| {
            turns -= ((angle - before) / TAU).round();
            before = *angle;
            angle + turns * TAU
        });
        Cow::Owned(counted.collect())
    }
}

/// The usual steps of a run.
struct Usual {
    /// Of the angle, rad, with its sign.
    step: f64,
    /// Angle by time, rad/s.
    speed: f64,
    /// Middle and spread of steps beyond what time says, rad.
    middle: f64,
    spread: f64,
}

impl Usual {
    fn of(run: &Run<'_>) -> Self {
        let steps = run.angles.len() - 1;
        let every = steps.div_ceil(LOOKED_AT).max(1);
        let looked = || (0..steps).step_by(every);
        let of = |index: usize| (run.angles[index + 1] - run.angles[index], run.times[index + 1] - run.times[index]);
        let step = median(looked().map(|index| of(index).0).collect());
        let time = median(looked().map(|index| of(index).1).collect());
        let ratios = looked().map(of).filter(|(_, time)| *time > 0.0).map(|(angle, time)| angle / time).collect();
        let speed = if time > 0.0 { median(ratios) } else { 0.0 };
        let beyond = || looked().map(|index| of(index).0 - speed * of(index).1);
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

/// Fails for an angle that does not go on as time does; sets turns and speed.
pub fn check(run: &mut Run<'_>, encoder: Encoder) -> Result<()> {
    if run.angles.len() < 3 {
        return Err(run.error(format!("{} readings are no turn of a spindle", run.angles.len())));
    }
    let usual = Usual::of(run);
    if usual.step == 0.0 {
        return Err(run
            .error("the angle of the spindle stands")
            .help("is the encoder connected, and its column right?"));
    }
    (1..run.angles.len()).try_for_each(|index| check_step(run, &usual, encoder, index))?;
    count_turns(run, &usual)?;
    check_speed(run)
}

fn check_step(run: &Run<'_>, usual: &Usual, encoder: Encoder, index: usize) -> Result<()> {
    let step = run.angles[index] - run.angles[index - 1];
    let time = run.times[index] - run.times[index - 1];
    if time < 0.0 {
        let message = format!("the time goes back from {} s to {} s", run.times[index - 1], run.times[index]);
        return Err(run.error_at(index, message).help("readings of a run have to stand in the order of time"));
    }
    let expected = usual.speed * time + usual.middle;
    let allowed = SLIP * usual.step.abs() + 8.0 * usual.spread;
    // Single readings that are missing agree with the time, and times in coarse steps with the usual step of the angle.
    let is_unusual = (step - usual.step).abs() > SLIP * usual.step.abs();
    let slipped = usual.speed != 0.0 && is_unusual && (step - expected).abs() > allowed;
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
        return Err(run.error_at(index, message).help(help));
    }
    if slipped {
        let message = format!(
            "the angle of the spindle goes on by {told:.3} deg in {time:.6} s, and {wanted:.3} deg were expected"
        );
        return Err(run
            .error_at(index, message)
            .help("the encoder slips or jumps here: measure again, or leave out what is behind it"));
    }
    if step.abs() > MISSING && step.abs() > 1.5 * usual.step.abs() {
        let message =
            format!("readings are missing before this one: over {:.1} deg of a turn", step.abs().to_degrees());
        return Err(run.error_at(index, message).help("every turn has to be read all round: measure again"));
    }
    Ok(())
}

/// Fails for less than two turns.
fn count_turns(run: &mut Run<'_>, usual: &Usual) -> Result<()> {
    let last = run.angles.len() - 1;
    let span = (run.angles[last] - run.angles[0]).abs();
    run.turns = (span + usual.step.abs()) / TAU;
    if run.whole_turns() < 2 {
        let message = format!(
            "its angle covers {:.2} turns, and two whole ones at least were expected: their scatter is the uncertainty",
            run.turns
        );
        return Err(run.error(message).help("is the angle in the unit that its column says (`S_deg`, `S_rad`)?"));
    }
    let time = run.times[last] - run.times[0];
    if time <= 0.0 {
        return Err(run.error("the time stands while the spindle turns").help("is the column of the time right?"));
    }
    run.speed = span / TAU / time * 60.0;
    Ok(())
}

/// Fails where the speed changes.
fn check_speed(run: &Run<'_>) -> Result<()> {
    let (mut begin, mut turn) = (run.times[0], 0);
    for index in 1..run.angles.len() {
        let end = (turn + 1) as f64 * TAU;
        let [before, now] = [index - 1, index].map(|index| (run.angles[index] - run.angles[0]).abs());
        if now < end {
            continue;
        }
        let part = (end - before) / (now - before);
        let time = run.times[index - 1] + part * (run.times[index] - run.times[index - 1]);
        let speed = 60.0 / (time - begin);
        if (speed - run.speed).abs() > STEADY * run.speed {
            let message = format!("turn {} has {speed:.0} rpm, the run {:.0} rpm", turn + 1, run.speed);
            return Err(run.error_at(index, message).help("a run has one speed: leave out where it comes up or down"));
        }
        (begin, turn) = (time, turn + 1);
    }
    Ok(())
}
