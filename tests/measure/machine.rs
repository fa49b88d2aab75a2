//! A machine with a probe and something to touch that is not quite where the plan has it. Moves are followed in small steps.

use std::collections::BTreeSet;
use std::sync::Arc;

use abbe_core::{AxisKind, KinematicModel, Poses};

use super::bodies::Body;
use crate::gcode::World;

/// Positions by letter: mm and degrees.
pub use crate::gcode::ByAxis;

pub struct Machine {
    pub model: Arc<dyn KinematicModel>,
    pub at: ByAxis,
    /// What is touched.
    pub body: Box<dyn Body>,
    /// Whether the last watched move was stopped by the probe.
    pub triggered: bool,
    /// Stops of the probe that the control does not notice, counted down.
    pub blind: usize,
    /// An axis that moves in the wrong direction.
    pub flipped: Option<String>,
    pub log: Vec<String>,
    /// What ended the program, if not its end.
    pub alarm: Option<String>,
    /// Rotary moves.
    pub swings: usize,
    /// mm in a unit of length of the program, once it has said its unit.
    pub unit: Option<f64>,
    /// What its moves took, s: from places that it has named.
    pub seconds: f64,
    named: BTreeSet<String>,
    known: bool,
    /// The tip is where it could not be, after the probe was not noticed.
    passed: bool,
}

impl Machine {
    /// The rotary axes stand where the first touch has them.
    pub fn new(model: Arc<dyn KinematicModel>, body: Box<dyn Body>, first: &ByAxis) -> Self {
        let mut at: ByAxis = model.info().axes.iter().map(|axis| (axis.name.clone(), 0.0)).collect();
        at.extend(first.clone());
        let (log, alarm, flipped) = (Vec::new(), None, None);
        Self {
            model,
            at,
            body,
            triggered: false,
            blind: 0,
            flipped,
            log,
            alarm,
            swings: 0,
            unit: None,
            seconds: 0.0,
            named: BTreeSet::new(),
            known: false,
            passed: false,
        }
    }

    /// Tip and direction to the spindle, in the frame of the table.
    pub fn tip(&self, at: &ByAxis) -> ([f64; 3], [f64; 3]) {
        let info = self.model.info();
        let mut status = vec![0.0; info.status.len()];
        for axis in &info.axes {
            let turned = if self.flipped.as_ref() == Some(&axis.name) { -1.0 } else { 1.0 };
            let place = at[&axis.name] * turned;
            status[axis.status] = if axis.kind == AxisKind::Rotary { place.to_radians() } else { place };
        }
        let mut poses = Poses::default();
        self.model.poses(&status, &info.nominal, &[], true, &mut poses).expect("a pose");
        let [w, x, y, z] = poses.orientations[0];
        (poses.positions[0], [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)])
    }

    fn gap(&self, at: &ByAxis) -> f64 {
        self.body.gap(self.tip(at).0) - self.model.info().stylus_radius
    }

    /// Fails if the probe is in anything, the tip left aside.
    fn look(&self, at: &ByAxis) -> Result<(), String> {
        let (tip, up) = self.tip(at);
        self.body.meets(tip, up).map_or(Ok(()), |met| Err(format!("{met} at {at:?}")))
    }

    /// mm or degrees in a unit of the program.
    fn scale(&self, axis: &str) -> Result<f64, String> {
        let linear = self.model.info().axes.iter().any(|own| own.name == axis && own.kind == AxisKind::Linear);
        if linear { self.unit.ok_or_else(|| "no unit of length".to_owned()) } else { Ok(1.0) }
    }

    /// Where an axis stands, in the unit of the program.
    pub fn place(&self, axis: &str) -> Result<f64, String> {
        let at = self.at.get(axis).ok_or_else(|| format!("there is no axis {axis}"))?;
        Ok(at / self.scale(axis)?)
    }

    /// The program stands for so many seconds.
    pub fn wait(&mut self, seconds: f64) {
        self.seconds += seconds;
    }

    /// A move in a straight line of all axes, positions and feed in units of the program; a watched one stops where the probe triggers.
    pub fn go(&mut self, target: &ByAxis, feed: f64, watched: bool) -> Result<(), String> {
        let (mut metric, mut rate) = (ByAxis::new(), feed);
        for (axis, place) in target {
            let scale = self.scale(axis)?;
            metric.insert(axis.clone(), place * scale);
            let turns = self.model.info().axes.iter().any(|own| own.name == *axis && own.kind == AxisKind::Rotary);
            rate = if turns { feed } else { feed * scale };
        }
        let from = self.at.clone();
        self.straight(&metric, watched)?;
        if metric.keys().all(|axis| self.named.contains(axis)) {
            let gone = metric.keys().map(|axis| (self.at[axis] - from[axis]).powi(2)).sum::<f64>().sqrt();
            self.seconds += 60.0 * gone / rate;
        }
        self.named.extend(metric.into_keys());
        Ok(())
    }

    fn straight(&mut self, target: &ByAxis, watched: bool) -> Result<(), String> {
        let info = self.model.info();
        for axis in &info.axes {
            let Some(place) = target.get(&axis.name) else { continue };
            let place = if axis.kind == AxisKind::Rotary { place.to_radians() } else { *place };
            if axis.range.is_some_and(|[from, to]| !(from - 1e-4..=to + 1e-4).contains(&place)) {
                return Err(format!("{} is out of its travel", axis.name));
            }
            let turns = axis.kind == AxisKind::Rotary && target[&axis.name] != self.at[&axis.name];
            self.swings += usize::from(turns);
        }
        if let Some(unknown) = target.keys().find(|letter| !self.at.contains_key(*letter)) {
            return Err(format!("there is no axis {unknown}"));
        }
        let from = self.at.clone();
        let between = |part: f64| -> ByAxis {
            from.iter().map(|(axis, at)| (axis.clone(), at + part * (target.get(axis).unwrap_or(at) - at))).collect()
        };
        let longest = target.iter().map(|(axis, to)| (to - from[axis]).abs()).fold(0.0, f64::max);
        let steps = (longest / 0.4).ceil().max(1.0) as usize;
        let start = self.gap(&from);
        if watched && start <= 1e-7 && self.known && !self.passed {
            return Err("a watched move begins in contact".to_owned());
        }
        if !self.known {
            // Where the machine was before nobody knows.
            self.at = between(1.0);
            self.known = target.keys().any(|axis| ["X", "Y", "Z"].contains(&axis.as_str())) && self.gap(&self.at) > 8.0;
            self.triggered = false;
            return Ok(());
        }
        self.triggered = false;
        let unnoticed = watched && self.blind > 0;
        let blind = unnoticed || self.passed;
        let mut met = false;
        for step in 1..=steps {
            let (before, now) = ((step - 1) as f64 / steps as f64, step as f64 / steps as f64);
            let gap = self.gap(&between(now));
            if gap <= 0.0 && watched && !blind {
                let (mut free, mut hit) = (before, now);
                for _ in 0..40 {
                    let middle = (free + hit) / 2.0;
                    if self.gap(&between(middle)) > 0.0 { free = middle } else { hit = middle }
                }
                self.at = between(hit);
                self.triggered = true;
                return Ok(());
            }
            met |= gap <= 0.0;
            if gap < -1e-3 && gap < start - 1e-3 && !blind {
                return Err(format!("the tip goes into what it should touch: {target:?}"));
            }
            if !blind && gap > -1e-3 && (step % self.body.stride() == 0 || step == steps) {
                self.look(&between(now))?;
            }
        }
        self.blind -= usize::from(unnoticed && met);
        self.at = between(1.0);
        self.passed = blind && self.gap(&self.at) <= 0.0;
        Ok(())
    }
}

impl World for Machine {
    fn place(&self, axis: &str) -> Result<f64, String> {
        Machine::place(self, axis)
    }

    fn unit(&mut self, millimetres: f64) -> Result<(), String> {
        self.unit = Some(millimetres);
        Ok(())
    }

    fn rapid(&mut self, target: &ByAxis) -> Result<(), String> {
        Err(format!("a rapid move, which nothing watches: {target:?}"))
    }

    fn feed(&mut self, target: &ByAxis, feed: f64) -> Result<(), String> {
        self.go(target, feed, false)
    }

    fn probe(&mut self, target: &ByAxis, feed: f64) -> Result<bool, String> {
        self.go(target, feed, true)?;
        Ok(self.triggered)
    }

    fn wait(&mut self, seconds: f64) {
        Machine::wait(self, seconds);
    }

    fn clock(&self) -> f64 {
        self.seconds
    }

    fn message(&mut self, _: &str) {}

    fn log(&mut self, line: String) -> Result<(), String> {
        self.log.push(line);
        Ok(())
    }
}

pub fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|axis| a[axis] - b[axis])
}

pub fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

pub fn norm(a: [f64; 3]) -> f64 {
    dot(a, a).sqrt()
}
