//! What a program takes: the sum of its moves at their feeds.

use std::cell::RefCell;

use abbe_core::{KinematicModel, Result, Target};

use crate::programme::{Block, ControlAxis, Positions, TouchBlock};
use crate::settings::{Control, Measuring, TouchOrder};
use crate::touch::Touches;
use crate::ways::Ways;

/// What the moves of programs take that make some of many touches.
///
/// It is the sum of all moves at their programmed feeds, each touch with contact at its nominal place, and of the times to settle. The
/// first way to a position from wherever the machine stands counts nothing, nor do pauses, accelerations, and what a control takes
/// to compute.
pub struct Timing<'a> {
    ways: RefCell<Ways<'a>>,
    settings: &'a Measuring,
}

impl<'a> Timing<'a> {
    /// Of these touches. `targets` are all nominal touches of the artefact, whose features are in the way.
    ///
    /// Fails as [`Programme::new`](crate::Programme::new) does, but for touches that cannot be reached.
    pub fn new(
        settings: &'a Measuring,
        touches: &'a Touches,
        targets: &[Target],
        model: &'a dyn KinematicModel,
    ) -> Result<Self> {
        Ok(Self { ways: RefCell::new(Ways::new(settings, touches, targets, model, None)?), settings })
    }

    /// Why a touch cannot be reached; none if it can.
    pub fn refusal(&self, touch: usize) -> Result<Option<String>> {
        Ok(self.ways.borrow_mut().stop(touch)?.err())
    }

    /// What the program of some touches takes, s, each made so often. They are named by their places in the list. `timed` says that the
    /// plan has times, so that the program keeps their order unless its settings have another one.
    pub fn seconds(&self, touches: &[usize], timed: bool, repeats: usize) -> Result<f64> {
        let mut ways = self.ways.borrow_mut();
        let route = ways.route(touches, self.settings.order_of(timed))?;
        Ok(seconds(self.settings, ways.axes(), &route.blocks, repeats))
    }
}

impl Measuring {
    /// The order of touches of a plan with or without times.
    pub(crate) fn order_of(&self, timed: bool) -> TouchOrder {
        self.order.unwrap_or(if timed { TouchOrder::Planned } else { TouchOrder::Shortest })
    }
}

/// What these blocks take, s.
pub fn seconds(settings: &Measuring, axes: &[ControlAxis], blocks: &[Block], repeats: usize) -> f64 {
    let mut at: Vec<Option<f64>> = vec![None; axes.len()];
    let mut minutes = 0.0;
    for block in blocks {
        minutes += match block {
            Block::Note(_) | Block::Pause(_) | Block::Orient(_) => 0.0,
            Block::Settle(seconds) => seconds / 60.0,
            Block::Swing(positions) => travelled(&mut at, positions) / settings.rotary_feed_deg_per_min,
            Block::Move(positions) => travelled(&mut at, positions) / settings.positioning_feed_mm_per_min,
            Block::Touch(touch) => repeats as f64 * touched(settings, touch),
        };
    }
    60.0 * minutes
}

/// The way that axes go in a straight line, mm or degrees; none from a place that is not known.
fn travelled(at: &mut [Option<f64>], positions: &Positions) -> f64 {
    let mut square = Some(0.0);
    for (axis, place) in positions {
        square = square.zip(at[*axis]).map(|(square, from)| square + (place - from).powi(2));
        at[*axis] = Some(*place);
    }
    square.unwrap_or_default().sqrt()
}

/// What a touch takes from its beginning and back there, in minutes.
fn touched(settings: &Measuring, touch: &TouchBlock) -> f64 {
    let stroke =
        touch.approach.iter().zip(&touch.end).map(|((_, from), (_, to))| (to - from).powi(2)).sum::<f64>().sqrt();
    let to_contact = stroke * settings.approach_mm / (settings.approach_mm + settings.overtravel_mm);
    let back = touch.back.iter().map(|(_, by)| by.powi(2)).sum::<f64>().sqrt();
    let (fast, slow) = (settings.positioning_feed_mm_per_min, settings.measuring_feed_mm_per_min);
    // Heidenhain's cycle goes back by itself, in rapid traverse, and not beyond where it began.
    let own = if settings.control == Control::Heidenhain { settings.rapid_feed_mm_per_min } else { fast };
    match settings.search_feed_mm_per_min {
        None => to_contact / slow + to_contact / own,
        Some(search) => {
            let found = to_contact / search + back / own + back / slow;
            let home = if settings.control == Control::Heidenhain {
                back / own + (to_contact - back) / fast
            } else {
                to_contact / fast
            };
            found + home
        }
    }
}
