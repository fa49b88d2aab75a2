//! The way through touches in an order, as blocks that no control has had a part in. Stops and ways are computed once, however often
//! other touches and orders are asked for.

use std::collections::BTreeMap;

use abbe_core::{Axis, AxisKind, KinematicModel, Result, Target};

use crate::path::{Leg, Path, Refusal, Stop};
use crate::programme::{Block, ControlAxis, Positions, TouchBlock, control_axes};
use crate::settings::{Measuring, TouchOrder};
use crate::touch::{Touch, Touches, position};

/// Stops and ways between touches of a list.
pub struct Ways<'a> {
    settings: &'a Measuring,
    touches: &'a Touches,
    model: &'a dyn KinematicModel,
    axes: Vec<ControlAxis>,
    path: Path<'a>,
    lift: Option<f64>,
    /// The stop of a touch, or why there is none.
    stops: BTreeMap<usize, Result<Stop, String>>,
    /// The way from one touch to another; the first one has none before it.
    legs: BTreeMap<(Option<usize>, usize), Result<Vec<Leg>, String>>,
}

/// The way through some touches.
pub struct Route {
    /// The steps.
    pub blocks: Vec<Block>,
    /// How many touches are made.
    pub made: usize,
    /// Places in the list of those that cannot be reached, with the reasons.
    pub left_out: Vec<(usize, String)>,
}

/// A reason is an answer, a failure is none.
fn answered<T>(found: std::result::Result<T, Refusal>) -> Result<Result<T, String>> {
    match found {
        Ok(found) => Ok(Ok(found)),
        Err(Refusal::Reason(reason)) => Ok(Err(reason)),
        Err(Refusal::Failed(error)) => Err(error),
    }
}

impl<'a> Ways<'a> {
    pub fn new(
        settings: &'a Measuring,
        touches: &'a Touches,
        targets: &[Target],
        model: &'a dyn KinematicModel,
        lift: Option<f64>,
    ) -> Result<Self> {
        let axes = control_axes(settings, model)?;
        let path = Path::new(settings, touches, targets, model, lift)?;
        Ok(Self { settings, touches, model, axes, path, lift, stops: BTreeMap::new(), legs: BTreeMap::new() })
    }

    /// The axes of the machine, in the order of the model.
    pub fn axes(&self) -> &[ControlAxis] {
        &self.axes
    }

    /// The stop of a touch, or the reason why there is none.
    pub fn stop(&mut self, touch: usize) -> Result<Result<Stop, String>> {
        if let Some(known) = self.stops.get(&touch) {
            return Ok(known.clone());
        }
        let found = answered(self.path.stop(&self.touches.list[touch]))?;
        self.stops.insert(touch, found.clone());
        Ok(found)
    }

    fn legs(
        &mut self,
        last: Option<(usize, &Stop)>,
        (touch, stop): (usize, &Stop),
    ) -> Result<Result<Vec<Leg>, String>> {
        let key = (last.map(|(last, _)| last), touch);
        if let Some(known) = self.legs.get(&key) {
            return Ok(known.clone());
        }
        let found = answered(self.path.way(last.map(|(_, stop)| stop), stop))?;
        self.legs.insert(key, found.clone());
        Ok(found)
    }

    /// The way through these touches.
    pub fn route(&mut self, touches: &[usize], order: TouchOrder) -> Result<Route> {
        let mut route = Route { blocks: Vec::new(), made: 0, left_out: Vec::new() };
        let axes = self.axes.clone();
        let (model, settings, lift) = (self.model, self.settings, self.lift);
        let mut writer = Writer { model, settings, axes: &axes, lift, at: vec![None; axes.len()], made: 0 };
        let mut last: Option<(usize, Stop)> = None;
        for touch in self.sequence(touches, order) {
            let way = match self.stop(touch)? {
                Ok(stop) => {
                    let last = last.as_ref().map(|(touch, stop)| (*touch, stop));
                    self.legs(last, (touch, &stop))?.map(|legs| (legs, stop))
                }
                Err(reason) => Err(reason),
            };
            match way {
                Ok((legs, stop)) => {
                    writer.add(&mut route.blocks, &self.touches.list[touch], &stop, &legs);
                    route.made += 1;
                    last = Some((touch, stop));
                }
                Err(reason) => route.left_out.push((touch, reason)),
            }
        }
        Ok(route)
    }

    /// Touches in the order of the program.
    fn sequence(&self, touches: &[usize], order: TouchOrder) -> Vec<usize> {
        if order == TouchOrder::Planned {
            return touches.to_vec();
        }
        let (axes, list) = (&self.model.info().axes, &self.touches.list);
        let rotary: Vec<usize> = axes.iter().enumerate().filter_map(rotary_index).collect();
        let turned =
            |touch: usize| -> Vec<f64> { rotary.iter().map(|&axis| list[touch].status[axes[axis].status]).collect() };
        let sides =
            |touch: usize| -> Vec<Option<f64>> { rotary.iter().map(|&axis| list[touch].directions[axis]).collect() };
        let mut groups: Vec<Vec<usize>> = Vec::new();
        for &touch in touches {
            let same = |group: &&mut Vec<usize>| {
                let near = turned(group[0]).iter().zip(turned(touch)).all(|(one, other)| (one - other).abs() < 1e-7);
                near && sides(group[0]) == sides(touch)
            };
            match groups.iter_mut().find(same) {
                Some(group) => group.push(touch),
                None => groups.push(vec![touch]),
            }
        }
        let swing = |one: &Vec<usize>, other: &Vec<usize>| {
            let (one, other) = (turned(one[0]), turned(other[0]));
            one.iter().zip(other).map(|(one, other)| (one - other).abs()).fold(0.0, f64::max)
        };
        let mut order: Vec<usize> = Vec::new();
        for group in nearest_first(groups, |one, other| swing(one, other)) {
            order.extend(nearest_first(group, |&one, &other| (list[one].tip - list[other].tip).norm()));
        }
        order
    }
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
    axes: &'a [ControlAxis],
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
                let (spindle, rotary): (Vec<usize>, Vec<usize>) =
                    self.kinds(AxisKind::Rotary).into_iter().partition(|&axis| self.axes[axis].is_spindle());
                let moved = self.moved(&rotary, status);
                let oriented = self.moved(&spindle, status);
                blocks.extend(oriented.first().map(|(_, angle)| Block::Orient(*angle)));
                let turns = !moved.is_empty() || !oriented.is_empty();
                if !moved.is_empty() {
                    blocks.push(Block::Swing(moved));
                }
                if turns && self.settings.settle_s > 0.0 {
                    blocks.push(Block::Settle(self.settings.settle_s));
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
