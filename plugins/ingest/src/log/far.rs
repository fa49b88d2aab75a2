//! Whether a log is where its plan expected it. What is not has been measured with another tool, on an artefact that stands
//! elsewhere, or is no log of this plan.

use std::collections::BTreeMap;

use abbe_core::{Error, Result};

use super::record::is_rotary;

/// Positions beyond which a touch is no touch of the plan.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bounds {
    /// Of the linear axes together, mm.
    pub(crate) length: f64,
    /// Of each rotary axis, rad.
    pub(crate) angle: f64,
}

/// A touch, and how far each axis is away from the plan: mm or rad.
#[derive(Debug, Clone)]
pub(crate) struct Away {
    pub(crate) number: u32,
    pub(crate) repeat: u32,
    pub(crate) line: usize,
    pub(crate) axes: BTreeMap<char, f64>,
    /// The expected positions of the rotary axes, rad.
    pub(crate) turned: Vec<f64>,
}

impl Away {
    /// Along X, Y and Z together with axes that are parallel to them.
    fn shift(&self) -> [f64; 3] {
        let of = |axis| self.axes.get(&axis).copied().unwrap_or(0.0);
        [of('X') + of('U'), of('Y') + of('V'), of('Z') + of('W')]
    }

    fn distance(&self) -> f64 {
        let linear = self.axes.iter().filter(|(axis, _)| !is_rotary(**axis));
        linear.map(|(_, away)| away * away).sum::<f64>().sqrt()
    }

    fn is_far(&self, bounds: Bounds) -> bool {
        self.distance() > bounds.length
            || self.axes.iter().any(|(axis, away)| is_rotary(*axis) && away.abs() > bounds.angle)
    }

    fn described(&self) -> String {
        let axis = |(axis, away): (&char, &f64)| match is_rotary(*axis) {
            true => format!("{axis} {:+.4}°", away.to_degrees()),
            false => format!("{axis} {away:+.4} mm"),
        };
        let axes: Vec<String> = self.axes.iter().filter(|(_, away)| away.abs() > 1e-6).map(axis).collect();
        let repeat = if self.repeat > 1 { format!(" (repeat {})", self.repeat) } else { String::new() };
        format!("touch {}{repeat} in line {}: {}", self.number, self.line, axes.join(", "))
    }
}

/// Touches that a message lists.
const LISTED: usize = 5;

/// Fails if touches are farther away from the plan than they may be; says what it looks like. `wrong` places the error.
pub(crate) fn near(all: &[Away], bounds: Bounds, wrong: impl Fn(usize, String) -> Error) -> Result<()> {
    let far: Vec<&Away> = all.iter().filter(|away| away.is_far(bounds)).collect();
    let Some(first) = far.first() else { return Ok(()) };
    let listed: Vec<String> = far.iter().take(LISTED).map(|away| away.described()).collect();
    let more = if far.len() > LISTED { format!(", and {} more", far.len() - LISTED) } else { String::new() };
    let [is, touches] = if far.len() == 1 { ["is", "touch"] } else { ["are", "touches"] };
    let message = format!(
        "{} {touches} of {} {is} farther from the plan than {} mm or {:.3}°: {}{more}",
        far.len(),
        all.len(),
        bounds.length,
        bounds.angle.to_degrees(),
        listed.join("; ")
    );
    Err(wrong(first.line, message).help(format!(
        "{}; `far_mm` and `far_deg` say how far from the plan a touch may be",
        looks_like(all, &far, bounds)
    )))
}

/// What the deviations look like, in words.
fn looks_like(all: &[Away], far: &[&Away], bounds: Bounds) -> String {
    if far.iter().any(|away| away.axes.iter().any(|(axis, away)| is_rotary(*axis) && away.abs() > bounds.angle)) {
        return "rotary axes stood elsewhere: is it the log of this plan?".to_owned();
    }
    // Few touches agree with a shift by chance.
    if far.len() <= FREEDOMS && far.len() * 2 < all.len() {
        return ALONE.to_owned();
    }
    let shifts = |of: &[&Away]| of.iter().map(|away| away.shift()).collect::<Vec<_>>();
    let all: Vec<&Away> = all.iter().collect();
    if let Some(shift) = common(&shifts(&all)) {
        let [x, y, z] = shift;
        let placed = format!("all touches agree with one shift of X {x:+.3}, Y {y:+.3}, Z {z:+.3} mm");
        return match z.abs() > 10.0 * x.hypot(y) {
            true => format!("{placed}: is the length of the tool wrong, or the height of the artefact?"),
            false => format!("{placed}: does the artefact stand elsewhere, or is the work offset another one?"),
        };
    }
    let mut poses: BTreeMap<Vec<i64>, Vec<&Away>> = BTreeMap::new();
    for away in &all {
        let pose = away.turned.iter().map(|angle| (angle * 1e6).round() as i64).collect();
        poses.entry(pose).or_default().push(away);
    }
    let many: Vec<Vec<&Away>> = poses.into_values().filter(|touches| touches.len() > FREEDOMS).collect();
    if many.len() > 1 && many.iter().all(|touches| common(&shifts(touches)).is_some()) {
        return "at each position of the rotary axes all touches agree with one shift, and it changes with these positions: \
                does the artefact stand at another place of the table, or is the length of the tool wrong?"
            .to_owned();
    }
    match far.len() * 2 < all.len() {
        true => ALONE.to_owned(),
        false => {
            "the touches agree with no one shift: is it the log of this plan, with its units and its offset?".to_owned()
        }
    }
}

const ALONE: &str = "these touches alone are far: did the stylus touch something else, or are lines mixed up?";

/// Unknowns of a shift.
const FREEDOMS: usize = 3;

/// Part of the deviations that a shift may leave.
const LEFT: f64 = 0.1;

/// The shift of the touched surfaces that explains the deviations, if one does. A touch tells of it what lies along its own
/// deviation d: shift · d/|d| = |d|.
fn common(deviations: &[[f64; 3]]) -> Option<[f64; 3]> {
    let size = |d: &[f64; 3]| (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
    let longest = deviations.iter().map(size).fold(0.0, f64::max);
    let (mut normal, mut right) = ([[0.0; 3]; 3], [0.0; 3]);
    for d in deviations.iter().filter(|d| size(d) > 0.0) {
        for i in 0..3 {
            // Weights |d|²: touches along which the shift is not seen tell no direction.
            right[i] += d[i] * size(d) * size(d);
            (0..3).for_each(|j| normal[i][j] += d[i] * d[j]);
        }
    }
    // Directions in which nothing is off, and none is told, have no shift.
    (0..3).for_each(|i| normal[i][i] += 1e-9 * longest * longest);
    let shift = solved(normal, right)?;
    let left = |d: &[f64; 3]| {
        let along = (shift[0] * d[0] + shift[1] * d[1] + shift[2] * d[2]) / size(d).max(f64::MIN_POSITIVE);
        size(d) - along
    };
    let rms = |values: Vec<f64>| (values.iter().map(|it| it * it).sum::<f64>() / values.len().max(1) as f64).sqrt();
    let all = rms(deviations.iter().map(size).collect());
    (rms(deviations.iter().map(left).collect()) < LEFT * all).then_some(shift)
}

/// The solution of three equations by Cramer's rule; none if they have no single one.
fn solved(a: [[f64; 3]; 3], b: [f64; 3]) -> Option<[f64; 3]> {
    let determinant = |m: &[[f64; 3]; 3]| {
        m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
            + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
    };
    let all = determinant(&a);
    let with = |column: usize| {
        let mut replaced = a;
        (0..3).for_each(|row| replaced[row][column] = b[row]);
        determinant(&replaced) / all
    };
    (all.abs() > 0.0).then(|| [with(0), with(1), with(2)])
}
