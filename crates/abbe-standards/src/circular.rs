//! Circular tests in the manner of ISO 230-4: ball bar, grid encoder or encoders of the axes.
//!
//! The text of the standard was not at hand; symbols and formulas are those in general use. Two definitions of the circular
//! deviation G are in use, and both are offered and named: [`Trace::minimum_zone`] (the minimum zone: the ring of the smallest width) and
//! [`Trace::about_least_squares`] (range about the least squares circle). That D, F and H are counted from the least squares
//! circle of both directions together is a choice of this project.
//!
//! Lengths are in one unit, angles in rad.

use std::f64::consts::TAU;

use abbe_geometry::{Circle, FitError, circle};
use nalgebra::Vector2;

pub use crate::zone::Zone;
use crate::zone::smallest;

/// The edition that the symbols follow.
pub const EDITION: &str = "ISO 230-4:2005, in its manner";

/// How much wider than the median step a gap in a full circle may be.
const GAP: f64 = 2.5;
/// The part of the steps that are not the widest ones, and how many times further than these from the median a gap of uneven steps may be.
const USUAL: f64 = 0.95;
const UNEVEN: f64 = 5.0;
/// The gap that is no matter whatever the step is, rad.
const SMALL_GAP: f64 = 2.0 * TAU / 360.0;
/// Fewest samples of a full circle.
const FEWEST: usize = 12;
/// Angles closer than this are one, rad.
const SAME: f64 = 1e-7;

/// A sample: the angle in the plane of the circle, and the distance from the nominal centre.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Angle, rad.
    pub angle: f64,
    /// Distance.
    pub radius: f64,
}

/// What one direction left.
#[derive(Debug, Clone, PartialEq)]
pub struct Trace {
    samples: Vec<Sample>,
    left_out: usize,
    travel: f64,
    full: bool,
}

impl Trace {
    /// A trace of samples in the order of time, steps below half a turn. Of more than a turn the middle one is kept: the overshoot
    /// at both ends is told by the angle, whether angles go on beyond a turn or begin again.
    pub fn new(samples: &[Sample]) -> Self {
        let unwrapped = unwrapped(samples);
        let angles = || unwrapped.iter().map(|sample| sample.angle);
        let low = angles().fold(f64::INFINITY, f64::min);
        let travel = angles().fold(f64::NEG_INFINITY, f64::max) - low;
        let earliest = low + (0.5 * (travel - TAU)).max(0.0) - SAME;
        // The turn begins at a sample, so that no gap at its ends is wider than a step.
        let first = angles().filter(|angle| *angle >= earliest).fold(f64::INFINITY, f64::min);
        let inside = |angle: f64| angle >= first - SAME && (travel < TAU - SAME || angle < first + TAU - SAME);
        let kept: Vec<Sample> = unwrapped.iter().copied().filter(|sample| inside(sample.angle)).collect();
        let full = is_full(&kept);
        Self { left_out: samples.len() - kept.len(), samples: kept, travel, full }
    }

    /// The samples of the turn.
    pub fn samples(&self) -> &[Sample] {
        &self.samples
    }

    /// From the smallest to the largest angle of all samples, overshoot included, rad.
    pub fn travel(&self) -> f64 {
        self.travel
    }

    /// How many samples of an overshoot were left out.
    pub fn left_out(&self) -> usize {
        self.left_out
    }

    /// Whether it goes all around. An arc has no figure but F as set up.
    pub fn is_full(&self) -> bool {
        self.full
    }

    /// The circle by least squares.
    pub fn least_squares(&self) -> Result<Circle, FitError> {
        least_squares(&[self])
    }

    /// G as the range of the distances from the centre of the least squares circle: `max r - min r`; none for an arc.
    pub fn about_least_squares(&self) -> Option<f64> {
        range_about_least_squares(&[self])
    }

    /// G as the width of the smallest ring that holds the trace, none for an arc.
    pub fn minimum_zone(&self) -> Option<Zone> {
        smallest_zone(&[self])
    }

    /// F max and F min from the nominal centre and radius as set up: `max (r - nominal)`, `min (r - nominal)`.
    pub fn as_set_up(&self, nominal: f64) -> Option<[f64; 2]> {
        self.about([0.0, 0.0], nominal)
    }

    /// F max and F min of the distances from a centre, less the nominal radius: `max (r - nominal)`, `min (r - nominal)`.
    pub fn about(&self, centre: [f64; 2], nominal: f64) -> Option<[f64; 2]> {
        let from = || self.radii(centre).map(|radius| radius - nominal);
        Some([from().reduce(f64::max)?, from().reduce(f64::min)?])
    }

    /// Distances from a centre.
    pub fn radii(&self, centre: [f64; 2]) -> impl Iterator<Item = f64> + '_ {
        self.samples.iter().map(move |sample| {
            let [x, y] = point(sample);
            (x - centre[0]).hypot(y - centre[1])
        })
    }
}

/// Bidirectional directions of a circle.
#[derive(Debug, Clone, PartialEq)]
pub struct Bidirectional {
    /// The least squares circle through the samples of both.
    pub circle: Circle,
    /// G(b) as the smallest ring that holds both.
    pub minimum_zone: Option<Zone>,
    /// G(b) as the range about the least squares circle.
    pub about_least_squares: Option<f64>,
    /// Hysteresis: the largest difference of the distances in both directions at one angle, and the angle (0 to 2 pi).
    pub hysteresis: Option<(f64, f64)>,
}

impl Bidirectional {
    /// Figures of two traces in opposite directions; none unless both go all around.
    pub fn of(one: &Trace, other: &Trace) -> Option<Self> {
        if !(one.full && other.full) {
            return None;
        }
        let circle = least_squares(&[one, other]).ok()?;
        Some(Self {
            minimum_zone: smallest_zone(&[one, other]),
            about_least_squares: range_about_least_squares(&[one, other]),
            hysteresis: hysteresis(one, other, circle.centre.into()),
            circle,
        })
    }

    /// D, the mean bidirectional radial deviation: radius of the least squares circle less the nominal one.
    pub fn radial_deviation(&self, nominal: f64) -> f64 {
        self.circle.radius - nominal
    }
}

fn point(sample: &Sample) -> [f64; 2] {
    let (sin, cos) = sample.angle.sin_cos();
    [sample.radius * cos, sample.radius * sin]
}

fn points(traces: &[&Trace]) -> Vec<[f64; 2]> {
    traces.iter().flat_map(|trace| trace.samples.iter().map(point)).collect()
}

fn least_squares(traces: &[&Trace]) -> Result<Circle, FitError> {
    let points: Vec<Vector2<f64>> = points(traces).into_iter().map(Vector2::from).collect();
    circle(&points).map(|fitted| fitted.shape)
}

fn range_about_least_squares(traces: &[&Trace]) -> Option<f64> {
    if !traces.iter().all(|trace| trace.full) {
        return None;
    }
    let centre: [f64; 2] = least_squares(traces).ok()?.centre.into();
    let radii = || traces.iter().flat_map(|trace| trace.radii(centre));
    Some(radii().reduce(f64::max)? - radii().reduce(f64::min)?)
}

fn smallest_zone(traces: &[&Trace]) -> Option<Zone> {
    if !traces.iter().all(|trace| trace.full) {
        return None;
    }
    smallest(&points(traces), least_squares(traces).ok()?.centre.into())
}

/// Each angle as near as possible to the one before.
fn unwrapped(samples: &[Sample]) -> Vec<Sample> {
    let mut before: Option<f64> = None;
    samples
        .iter()
        .map(|sample| {
            let angle = before.map_or(sample.angle, |last| sample.angle + TAU * ((last - sample.angle) / TAU).round());
            before = Some(angle);
            Sample { angle, ..*sample }
        })
        .collect()
}

/// Angles from 0 to a turn, increasing, and the distances there.
fn around(trace: &Trace, centre: [f64; 2]) -> Vec<(f64, f64)> {
    let wrap = |angle: f64| {
        let angle = angle.rem_euclid(TAU);
        if angle > TAU - SAME { 0.0 } else { angle }
    };
    let mut all: Vec<(f64, f64)> =
        trace.samples.iter().map(|sample| wrap(sample.angle)).zip(trace.radii(centre)).collect();
    all.sort_by(|one, other| one.0.total_cmp(&other.0));
    all
}

fn is_full(samples: &[Sample]) -> bool {
    if samples.len() < FEWEST {
        return false;
    }
    let mut angles: Vec<f64> = samples.iter().map(|sample| sample.angle.rem_euclid(TAU)).collect();
    angles.sort_by(f64::total_cmp);
    let after = angles.iter().cycle().skip(1);
    let mut gaps: Vec<f64> = angles.iter().zip(after).map(|(one, next)| (next - one).rem_euclid(TAU)).collect();
    gaps.sort_by(f64::total_cmp);
    let at = |part: f64| gaps[((part * gaps.len() as f64) as usize).min(gaps.len() - 1)];
    let (median, wide, largest) = (at(0.5), at(USUAL), at(1.0));
    let uneven = median + UNEVEN * (wide - median);
    largest <= (GAP * median).max(SMALL_GAP).max(uneven) && largest < TAU / 8.0
}

/// `max |r one - r other|` at the same angle, straight between samples where the other direction has none there.
fn hysteresis(one: &Trace, other: &Trace, centre: [f64; 2]) -> Option<(f64, f64)> {
    let (one, other) = (around(one, centre), around(other, centre));
    let differences = |of: &[(f64, f64)], from: &[(f64, f64)]| -> Vec<(f64, f64)> {
        of.iter().map(|(angle, radius)| ((radius - between(from, *angle)).abs(), *angle)).collect()
    };
    let mut all = differences(&one, &other);
    all.extend(differences(&other, &one));
    all.into_iter().reduce(|most, next| if next.0 > most.0 { next } else { most })
}

/// The distance at an angle, straight between neighbours all around.
fn between(samples: &[(f64, f64)], angle: f64) -> f64 {
    let next = samples.partition_point(|(own, _)| *own < angle - SAME);
    let (high, high_radius) = samples[next % samples.len()];
    if (high - angle).abs() <= SAME {
        return high_radius;
    }
    let (low, low_radius) = samples[(next + samples.len() - 1) % samples.len()];
    let way = (high - low).rem_euclid(TAU);
    low_radius + (angle - low).rem_euclid(TAU) / way * (high_radius - low_radius)
}

#[cfg(test)]
mod tests;
