//! Runs: the readings of one turning spindle at one speed, as two looks at them tell. The first one finds what is usual, the second one
//! finds the readings that are not.

use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::path::PathBuf;

use abbe_core::{Error, Passes, Result};
use abbe_numerics::{Chosen, Ends};

use crate::encoder::{Steps, Usual, too_few, turns_and_speed};
use crate::readings::Expected;
use crate::sensors::{check_range, clipped};
use crate::stretches::{Stretch, each_stretch};

/// Steps that are looked at to know the usual one.
const LOOKED_AT: usize = 4096;

/// Fewest readings in turn that no two sensors have in common.
const SAME: usize = 30;

/// Most sensors of a run.
pub const SENSORS: usize = 3;

/// A step from one reading to the next, and what sensors read then.
#[derive(Debug, Clone, Copy)]
pub struct Step {
    /// rad
    pub angle: f64,
    /// s
    pub time: f64,
    /// mm
    pub readings: [f64; SENSORS],
}

/// What the first look at a run tells.
pub struct Run {
    /// Its label, or that of its file.
    pub label: String,
    file: Option<PathBuf>,
    /// Number of readings.
    pub count: usize,
    /// First and last angle, rad.
    pub angles: [f64; 2],
    /// First and last time, s.
    pub times: [f64; 2],
    /// First readings of the sensors, mm.
    pub readings: Vec<f64>,
    /// The ends of the readings of the sensors.
    pub ends: Vec<Ends>,
    /// How many readings of each pair of sensors, one after the other, are the same: so far, and at most.
    pub same: BTreeMap<[usize; 2], [usize; 2]>,
    /// Some steps, by the number of the reading that they lead to: all of a short run, else chosen at random, at the same numbers in all
    /// runs of one length.
    pub steps: Vec<(u64, Step)>,
    pub usual: Usual,
    /// Turns, the step behind the last reading included.
    pub turns: f64,
    /// Mean speed, revolutions per minute.
    pub speed: f64,
}

impl Run {
    /// An error about the run as a whole.
    pub fn error(&self, message: impl std::fmt::Display) -> Error {
        let error = Error::data(format!("run `{}`: {message}", self.label));
        match &self.file {
            Some(file) => error.in_file(file),
            None => error,
        }
    }

    /// Whole turns: what remains belongs to the last one.
    pub fn whole_turns(&self) -> usize {
        (self.turns + 1e-6).floor() as usize
    }

    /// Whether its angle grows.
    pub fn is_forward(&self) -> bool {
        self.angles[1] > self.angles[0]
    }

    /// The turn of an angle, from 0.
    pub fn turn(&self, angle: f64) -> usize {
        let turned = (angle - self.angles[0]).abs() / TAU;
        ((turned + 1e-9).floor() as usize).min(self.whole_turns().saturating_sub(1))
    }
}

/// A run that the first look has begun.
pub struct Begun {
    run: Run,
    chosen: Chosen<Step>,
}

impl Begun {
    fn new(stretch: &Stretch<'_>) -> Self {
        let run = Run {
            label: stretch.label.to_owned(),
            file: stretch.file().cloned(),
            count: 0,
            angles: [stretch.angles[0]; 2],
            times: [stretch.times[0]; 2],
            readings: stretch.readings.iter().map(|readings| readings[0]).collect(),
            ends: vec![Ends::default(); stretch.readings.len()],
            same: BTreeMap::new(),
            steps: Vec::new(),
            usual: Usual::default(),
            turns: 0.0,
            speed: 0.0,
        };
        Self { run, chosen: Chosen::new(LOOKED_AT) }
    }

    fn add(&mut self, stretch: &Stretch<'_>) {
        let Self { run, chosen } = self;
        for (index, (angle, time)) in stretch.angles.iter().zip(stretch.times).enumerate() {
            let number = stretch.first + index as u64;
            if number > 0 {
                chosen.push(number, || {
                    let mut readings = [0.0; SENSORS];
                    readings.iter_mut().zip(stretch.readings).for_each(|(own, all)| *own = all[index]);
                    Step { angle: angle - run.angles[1], time: time - run.times[1], readings }
                });
            }
            (run.angles[1], run.times[1]) = (*angle, *time);
        }
        for (ends, readings) in run.ends.iter_mut().zip(stretch.readings) {
            readings.iter().zip(stretch.first..).for_each(|(reading, number)| ends.push(number, *reading));
        }
        let sensors = stretch.readings.len();
        for pair in (0..sensors).flat_map(|one| (one + 1..sensors).map(move |other| [one, other])) {
            let [now, most] = run.same.entry(pair).or_default();
            for (one, other) in stretch.readings[pair[0]].iter().zip(stretch.readings[pair[1]].iter()) {
                *now = if one == other { *now + 1 } else { 0 };
                *most = (*most).max(*now);
            }
        }
        run.count += stretch.angles.len();
    }

    fn finish(self) -> Run {
        let mut run = self.run;
        run.steps = self.chosen.items();
        run.usual = Usual::of(&run.steps);
        (run.turns, run.speed) = turns_and_speed(&run);
        run
    }
}

/// The first look at the runs of data sets, in their order; `also` sees the same.
pub fn first_look(
    data: &[&dyn Passes],
    expected: &Expected<'_>,
    also: &mut dyn FnMut(&Stretch<'_>),
) -> Result<Vec<Run>> {
    let (mut runs, mut present): (Vec<Run>, Option<Begun>) = (Vec::new(), None);
    each_stretch(data, expected, &mut |stretch| {
        if stretch.first == 0 {
            runs.extend(present.take().map(Begun::finish));
        }
        present.get_or_insert_with(|| Begun::new(stretch)).add(stretch);
        also(stretch);
        Ok(())
    })?;
    runs.extend(present.map(Begun::finish));
    Ok(runs)
}

/// The second look at runs; `also` sees them, each after its rows have been checked.
///
/// Fails for encoders that slip, turns that are missing, readings that are clipped, stuck or in a wrong unit: with the first row of the
/// first run that has something of this.
pub fn second_look(
    data: &[&dyn Passes],
    expected: &Expected<'_>,
    runs: &[Run],
    also: &mut dyn FnMut(&Stretch<'_>, &Run),
) -> Result<()> {
    let mut present: Option<Checks<'_>> = None;
    each_stretch(data, expected, &mut |stretch| {
        let changed = || Error::data("there are other runs than at the first look: the files have changed");
        if stretch.first == 0 {
            present.take().map_or(Ok(()), Checks::finish)?;
            present = Some(Checks::new(runs.get(stretch.run).ok_or_else(changed)?, expected)?);
        }
        let checks = present.as_mut().ok_or_else(changed)?;
        checks.look(stretch)?;
        also(stretch, checks.run);
        Ok(())
    })?;
    present.map_or(Ok(()), Checks::finish)
}

/// What the second look at a run has found.
struct Checks<'a> {
    run: &'a Run,
    expected: &'a Expected<'a>,
    steps: Steps,
    /// Clipped ends by sensors: the number of the first reading there, and the error.
    clipped: Vec<Option<(u64, Error)>>,
}

impl<'a> Checks<'a> {
    fn new(run: &'a Run, expected: &'a Expected<'a>) -> Result<Self> {
        too_few(run)?;
        let sensors = expected.sensors.iter().zip(&run.ends);
        Ok(Self {
            run,
            expected,
            steps: Steps::new(run),
            clipped: sensors.map(|(name, ends)| clipped(name, ends)).collect(),
        })
    }

    fn look(&mut self, stretch: &Stretch<'_>) -> Result<()> {
        self.steps.check(self.run, self.expected.encoder, stretch)?;
        for (number, error) in self.clipped.iter_mut().flatten() {
            let index = number.checked_sub(stretch.first).filter(|index| *index < stretch.angles.len() as u64);
            if let Some(index) = index {
                let placed = stretch.error_at(index as usize, error.message.clone());
                error.place = placed.place;
                error.message = placed.message;
            }
        }
        Ok(())
    }

    fn finish(self) -> Result<()> {
        self.steps.finish(self.run)?;
        self.expected.speeds.check(self.run)?;
        for ((name, ends), clipped) in self.expected.sensors.iter().zip(&self.run.ends).zip(self.clipped) {
            check_range(self.run, name, ends, self.expected.plausible)?;
            clipped.map_or(Ok(()), |(_, error)| Err(error))?;
        }
        not_copied(self.run, self.expected)
    }
}

/// Fails for a sensor with the readings of another one.
fn not_copied(run: &Run, expected: &Expected<'_>) -> Result<()> {
    let Some((pair, [_, most])) = run.same.iter().find(|(_, [_, most])| *most >= SAME) else { return Ok(()) };
    let [one, other] = pair.map(|sensor| expected.sensors[sensor]);
    let message = format!("{other} has the readings of {one} in {most} rows one after the other");
    Err(run.error(message).help("is a column copied, or are both plugs at one sensor?"))
}
