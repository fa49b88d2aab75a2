//! The program as a list of blocks that no control has had a part in: safe moves from touch to touch, checked on the nominal machine.

use std::collections::BTreeSet;

use abbe_core::{Axis, AxisKind, Error, KinematicModel, Result, Target};

use crate::path::{Leg, Path, Refusal, Stop};
use crate::settings::{AXIS_LETTERS, Measuring, TouchOrder, Unreachable};
use crate::touch::{Touch, Touches, position};

/// Positions of axes by their index among [`Programme::axes`]: mm or degrees, with at most four decimals.
pub type Positions = Vec<(usize, f64)>;

/// An axis as the control knows it.
#[derive(Debug, Clone, PartialEq)]
pub struct ControlAxis {
    /// Its letter; that of the spindle is S.
    pub letter: String,
    /// Linear or rotary.
    pub kind: AxisKind,
}

/// A step of the program.
#[derive(Debug, Clone, PartialEq)]
pub enum Block {
    /// For people who read the program.
    Note(String),
    /// Waits for the operator.
    Pause(String),
    /// Rotary axes move; nothing is near.
    Swing(Positions),
    /// The spindle stops at this angle, degrees.
    Orient(f64),
    /// Linear axes move, and stop with an alarm where the probe triggers.
    Move(Positions),
    /// A touch, from its beginning and back there.
    Touch(TouchBlock),
}

/// A touch of the program.
#[derive(Debug, Clone, PartialEq)]
pub struct TouchBlock {
    /// Its number in the plan.
    pub number: usize,
    /// Where it begins: all linear axes.
    pub approach: Positions,
    /// Where it gives up: all linear axes.
    pub end: Positions,
    /// The way back from the surface before the slow touch: differences of all linear axes.
    pub back: Positions,
    /// Where the rotary axes stand.
    pub rotary: Positions,
}

/// A whole program.
#[derive(Debug, Clone, PartialEq)]
pub struct Programme {
    /// The axes of the machine, in the order of the model.
    pub axes: Vec<ControlAxis>,
    /// The steps.
    pub blocks: Vec<Block>,
    /// The touches that it makes, with the numbers of the plan.
    pub touches: Touches,
    /// The first digits of the hash of these touches.
    pub hash: String,
    /// Diameter of the tip ball, mm.
    pub tip_diameter: f64,
    /// Touches that cannot be reached, with the reasons.
    pub left_out: Vec<String>,
}

/// Reasons that an error lists.
const REASONS: usize = 20;

impl Programme {
    /// The program of a plan; `lift` is the height of a dry run above the touches, in which nothing is touched.
    ///
    /// Fails if a touch cannot be reached, with all that cannot and the reasons, unless these are to be left out.
    pub fn new(
        settings: &Measuring,
        touches: &Touches,
        targets: &[Target],
        model: &dyn KinematicModel,
        lift: Option<f64>,
    ) -> Result<Self> {
        let axes = control_axes(settings, model)?;
        let path = Path::new(settings, touches, targets, model, lift)?;
        let mut program = Self {
            axes,
            blocks: Vec::new(),
            touches: touches.clone(),
            hash: String::new(),
            tip_diameter: 2.0 * model.info().stylus_radius,
            left_out: Vec::new(),
        };
        let mut writer = Writer { model, settings, lift, at: vec![None; model.info().axes.len()], made: 0 };
        let mut last: Option<Stop> = None;
        let mut unreached = BTreeSet::new();
        for touch in sequence(settings, touches, model) {
            let way = path.stop(touch).and_then(|stop| Ok((path.way(last.as_ref(), &stop)?, stop)));
            match way {
                Ok((legs, stop)) => {
                    writer.add(&mut program.blocks, touch, &stop, &legs);
                    last = Some(stop);
                }
                Err(Refusal::Reason(reason)) => {
                    unreached.insert(touch.number);
                    program.left_out.push(format!("touch {} (feature {}): {reason}", touch.number, touch.feature));
                }
                Err(Refusal::Failed(error)) => return Err(error),
            }
        }
        if !program.left_out.is_empty() && settings.unreachable == Unreachable::Refuse {
            return Err(unreachable(&program.left_out, touches.list.len()));
        }
        if last.is_none() {
            return Err(unreachable(&program.left_out, touches.list.len()));
        }
        program.touches = touches.without(&unreached);
        program.hash = program.touches.hash(model);
        Ok(program)
    }

    /// The linear axes, by index.
    pub fn linear(&self) -> impl Iterator<Item = (usize, &ControlAxis)> {
        self.axes.iter().enumerate().filter(|(_, axis)| axis.kind == AxisKind::Linear)
    }

    /// The rotary axes but the spindle, by index.
    pub fn rotary(&self) -> impl Iterator<Item = (usize, &ControlAxis)> {
        self.axes.iter().enumerate().filter(|(_, axis)| axis.kind == AxisKind::Rotary && !axis.is_spindle())
    }
}

impl ControlAxis {
    /// Whether it is the spindle, which is oriented and not positioned.
    pub fn is_spindle(&self) -> bool {
        self.letter == "S"
    }
}

fn unreachable(reasons: &[String], touches: usize) -> Error {
    let listed: Vec<String> = reasons.iter().take(REASONS).map(|reason| format!("\n- {reason}")).collect();
    let more = match reasons.len().saturating_sub(REASONS) {
        0 => String::new(),
        more => format!("\n- and {more} more"),
    };
    let message = format!(
        "{} of {touches} touches cannot be reached by the measuring program:{}{more}",
        reasons.len(),
        listed.concat()
    );
    Error::usage(message)
        .help("change probe, clearance, solids or plan; `unreachable: leave-out` writes a program of the others")
}

/// The axes with the letters that the control has for them.
fn control_axes(settings: &Measuring, model: &dyn KinematicModel) -> Result<Vec<ControlAxis>> {
    let axes = &model.info().axes;
    if let Some(name) = settings.axis_names.keys().find(|name| !axes.iter().any(|axis| axis.name == **name)) {
        let error = Error::usage(format!("the machine has no axis {name}")).setting("axis_names");
        return Err(error.suggest(name, axes.iter().map(|axis| axis.name.as_str())));
    }
    let mut control: Vec<ControlAxis> = Vec::new();
    for axis in axes {
        let letter = match settings.axis_names.get(&axis.name) {
            Some(letter) => letter.clone(),
            None if axis.indexed && axis.name.starts_with('S') => "S".to_owned(),
            None => axis.name.clone(),
        };
        if letter != "S" && !(letter.len() == 1 && AXIS_LETTERS.contains(&letter)) {
            let message = format!("no control has an axis {letter}; one of the letters {AXIS_LETTERS} was expected");
            return Err(Error::usage(message).setting("axis_names").help("write `axis_names: { C1: C }`"));
        }
        if control.iter().any(|other| other.letter == letter) {
            return Err(Error::usage(format!("two axes are called {letter} on the control")).setting("axis_names"));
        }
        control.push(ControlAxis { letter, kind: axis.kind });
    }
    Ok(control)
}

/// The touches in the order of the program.
fn sequence<'a>(settings: &Measuring, touches: &'a Touches, model: &dyn KinematicModel) -> Vec<&'a Touch> {
    let all: Vec<&Touch> = touches.list.iter().collect();
    let timed = all.iter().any(|touch| touch.time.is_some());
    let default = if timed { TouchOrder::Planned } else { TouchOrder::Shortest };
    if settings.order.unwrap_or(default) == TouchOrder::Planned {
        return all;
    }
    let rotary: Vec<usize> = model.info().axes.iter().enumerate().filter_map(rotary_index).collect();
    let turned = |touch: &Touch| -> Vec<f64> {
        rotary.iter().map(|&axis| touch.status[model.info().axes[axis].status]).collect()
    };
    let sides = |touch: &Touch| -> Vec<Option<f64>> { rotary.iter().map(|&axis| touch.directions[axis]).collect() };
    let mut groups: Vec<Vec<&Touch>> = Vec::new();
    for touch in all {
        let same = |group: &&mut Vec<&Touch>| {
            let near = turned(group[0]).iter().zip(turned(touch)).all(|(one, other)| (one - other).abs() < 1e-7);
            near && sides(group[0]) == sides(touch)
        };
        match groups.iter_mut().find(same) {
            Some(group) => group.push(touch),
            None => groups.push(vec![touch]),
        }
    }
    let swing = |one: &Vec<&Touch>, other: &Vec<&Touch>| {
        let (one, other) = (turned(one[0]), turned(other[0]));
        one.iter().zip(other).map(|(one, other)| (one - other).abs()).fold(0.0, f64::max)
    };
    let mut order: Vec<&Touch> = Vec::new();
    for group in nearest_first(groups, |one, other| swing(one, other)) {
        order.extend(nearest_first(group, |one, other| (one.tip - other.tip).norm()));
    }
    order
}

fn rotary_index((index, axis): (usize, &Axis)) -> Option<usize> {
    (axis.kind == AxisKind::Rotary).then_some(index)
}

/// From the first item always to the nearest that is left.
fn nearest_first<T>(mut items: Vec<T>, distance: impl Fn(&T, &T) -> f64) -> Vec<T> {
    let mut order: Vec<T> = Vec::new();
    while !items.is_empty() {
        let next = match order.last() {
            None => 0,
            Some(last) => (0..items.len())
                .min_by(|&one, &other| distance(last, &items[one]).total_cmp(&distance(last, &items[other])))
                .unwrap_or_default(),
        };
        order.push(items.remove(next));
    }
    order
}

/// Makes blocks of statuses: only axes that move are named.
struct Writer<'a> {
    model: &'a dyn KinematicModel,
    settings: &'a Measuring,
    lift: Option<f64>,
    /// Where each axis stands, once it is known.
    at: Vec<Option<f64>>,
    /// Touches so far.
    made: usize,
}

impl Writer<'_> {
    fn add(&mut self, blocks: &mut Vec<Block>, touch: &Touch, stop: &Stop, legs: &[Leg]) {
        let pause = self.settings.pause;
        let due = pause
            .and_then(|pause| pause.touches)
            .is_some_and(|every| self.made > 0 && self.made.is_multiple_of(every.get()));
        let swings = legs.iter().any(|leg| matches!(leg, Leg::Swing(_))) && self.made > 0;
        if due {
            blocks.push(Block::Pause(format!("{} touches made", self.made)));
        } else if swings && pause.is_some_and(|pause| pause.at_swings) {
            blocks.push(Block::Pause("rotary axes move next".to_owned()));
        }
        blocks.push(Block::Note(format!("touch {} feature {}", touch.number, touch.feature)));
        for leg in legs {
            self.leg(blocks, leg);
        }
        let axes = self.kinds(AxisKind::Linear);
        let of = |status: &[f64]| -> Positions { axes.iter().map(|&axis| (axis, self.place(axis, status))).collect() };
        match self.lift {
            Some(_) => {
                self.leg(blocks, &Leg::Move(stop.end.clone()));
                self.leg(blocks, &Leg::Move(stop.approach.clone()));
            }
            None => {
                let stroke = self.settings.approach_mm + self.settings.overtravel_mm;
                let part = self.settings.back_off_mm / stroke;
                let back = |axis: usize| {
                    let status = self.model.info().axes[axis].status;
                    rounded((stop.approach[status] - stop.end[status]) * part)
                };
                let rotary = self.kinds(AxisKind::Rotary);
                blocks.push(Block::Touch(TouchBlock {
                    number: touch.number,
                    approach: of(&stop.approach),
                    end: of(&stop.end),
                    back: axes.iter().map(|&axis| (axis, back(axis))).collect(),
                    rotary: rotary.iter().map(|&axis| (axis, self.place(axis, &stop.approach))).collect(),
                }));
            }
        }
        self.leg(blocks, &Leg::Move(stop.retreat.clone()));
        self.made += 1;
    }

    fn leg(&mut self, blocks: &mut Vec<Block>, leg: &Leg) {
        match leg {
            Leg::Move(status) => {
                let moved = self.moved(&self.kinds(AxisKind::Linear), status);
                if !moved.is_empty() {
                    blocks.push(Block::Move(moved));
                }
            }
            Leg::First(axis, status) => {
                let moved = self.moved(&[*axis], status);
                blocks.push(Block::Move(moved));
            }
            Leg::Swing(status) => {
                let is_spindle = |axis: &usize| {
                    self.model.info().axes[*axis].indexed
                        && self.model.info().axes[*axis].name.starts_with('S')
                        && !self.settings.axis_names.contains_key(&self.model.info().axes[*axis].name)
                };
                let (spindle, rotary): (Vec<usize>, Vec<usize>) =
                    self.kinds(AxisKind::Rotary).into_iter().partition(is_spindle);
                let moved = self.moved(&rotary, status);
                let oriented = self.moved(&spindle, status);
                blocks.extend(oriented.first().map(|(_, angle)| Block::Orient(*angle)));
                if !moved.is_empty() {
                    blocks.push(Block::Swing(moved));
                }
            }
        }
    }

    fn kinds(&self, kind: AxisKind) -> Vec<usize> {
        let axes = self.model.info().axes.iter().enumerate();
        axes.filter(|(_, axis)| axis.kind == kind).map(|(index, _)| index).collect()
    }

    fn place(&self, axis: usize, status: &[f64]) -> f64 {
        rounded(position(&self.model.info().axes[axis], status))
    }

    /// The axes among these that are not there yet.
    fn moved(&mut self, axes: &[usize], status: &[f64]) -> Positions {
        let mut moved = Positions::new();
        for &axis in axes {
            let place = self.place(axis, status);
            if self.at[axis] != Some(place) {
                self.at[axis] = Some(place);
                moved.push((axis, place));
            }
        }
        moved
    }
}

/// To a tenth of a micrometre, or of a thousandth of a degree, without a minus sign before zero.
fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4 + 0.0
}
