//! The program as a list of blocks that no control has had a part in: safe moves from touch to touch, checked on the nominal machine.

use std::collections::BTreeSet;

use abbe_core::{AxisKind, Error, KinematicModel, Result, Target};

use crate::settings::{AXIS_LETTERS, Measuring, Unreachable};
use crate::timing::seconds;
use crate::touch::Touches;
use crate::ways::Ways;

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
    /// The program waits so many seconds, because rotary axes have moved.
    Settle(f64),
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
    /// What its moves take, s: see [`Timing`](crate::Timing).
    pub seconds: f64,
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
        let mut ways = Ways::new(settings, touches, targets, model, lift)?;
        let all: Vec<usize> = (0..touches.list.len()).collect();
        let timed = touches.list.iter().any(|touch| touch.time.is_some());
        let route = ways.route(&all, settings.order_of(timed))?;
        let name = |(index, reason): &(usize, String)| {
            let touch = &touches.list[*index];
            format!("touch {} (feature {}): {reason}", touch.number, touch.feature)
        };
        let left_out: Vec<String> = route.left_out.iter().map(name).collect();
        let refused = !left_out.is_empty() && settings.unreachable == Unreachable::Refuse;
        if refused || route.made == 0 {
            return Err(unreachable(&left_out, touches.list.len()));
        }
        let unreached: BTreeSet<usize> = route.left_out.iter().map(|(index, _)| touches.list[*index].number).collect();
        let made = touches.without(&unreached);
        Ok(Self {
            seconds: seconds(settings, ways.axes(), &route.blocks, settings.repeats.get()),
            axes: ways.axes().to_vec(),
            blocks: route.blocks,
            hash: made.hash(model),
            touches: made,
            tip_diameter: 2.0 * model.info().stylus_radius,
            left_out,
        })
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
        .setting("unreachable")
}

/// The axes with the letters that the control has for them.
pub fn control_axes(settings: &Measuring, model: &dyn KinematicModel) -> Result<Vec<ControlAxis>> {
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
