//! Corrected points as lines and arcs whose numbers can be written.

use std::ops::Range;

use crate::block::Move;
use crate::geometry::{Arc, Coordinates, Path, centre_of_three, is_rotary, sweep};
use crate::modal::Motion;
use crate::options::Options;
use crate::plan::is_written;

/// The numbers that a block can have.
pub(crate) struct Grid {
    written: [bool; 9],
    /// The last digit, in mm or degrees.
    digit: [f64; 9],
    offset: Coordinates,
    relative: bool,
    /// Whether arcs have no coordinate outside of their plane.
    has_flat_arcs: bool,
    /// Distances, mm and degrees, from which axes are brought to a start.
    apart: [f64; 9],
}

impl Grid {
    pub(crate) fn new(options: &Options, of: &Move) -> Self {
        let has_flat_arcs = options.dialect.has_flat_arcs();
        let (mut written, mut digit, mut apart) = ([false; 9], [0.0; 9], [0.0; 9]);
        for axis in 0..9 {
            written[axis] = is_written(of, axis);
            let rotary = is_rotary(axis);
            let decimals = if rotary { options.rotary_decimals } else { options.decimals + usize::from(of.inches) };
            let unit = if of.inches && !rotary { 25.4 } else { 1.0 };
            digit[axis] = unit * 10_f64.powi(-(decimals as i32));
            let quarter = options.tolerance / 4.0;
            apart[axis] = if rotary { (quarter / LEVER).to_degrees() } else { quarter };
            apart[axis] = apart[axis].max(1.01 * digit[axis]);
        }
        Self { written, digit, offset: of.offset, relative: of.relative, has_flat_arcs, apart }
    }

    /// The nearest position that can be written. What is not written stays.
    pub(crate) fn rounded(&self, wanted: &Coordinates, written: &Coordinates) -> Coordinates {
        let mut found = *wanted;
        for axis in 0..9 {
            if !self.written[axis] {
                continue;
            }
            // Remainders of relative numbers are carried: they count from what was written.
            let base = if self.relative { written[axis] } else { self.offset[axis] };
            found[axis] = base + ((wanted[axis] - base) / self.digit[axis]).round() * self.digit[axis];
        }
        found
    }

    /// Whether an axis has to be brought from one position to another.
    pub(crate) fn is_apart(&self, one: &Coordinates, other: &Coordinates) -> bool {
        (0..9).any(|axis| self.written[axis] && (one[axis] - other[axis]).abs() > self.apart[axis])
    }
}

/// Distance, mm, of the tip from rotary axes by which their bows are judged before the tip is looked at.
const LEVER: f64 = 300.0;

/// Attempts after which an arc is written as lines.
const LAST_OF_ARCS: u32 = 2;

/// Pieces of a segment, with the range of its points each.
pub(crate) fn pieces_of_segment(
    grid: &Grid,
    of: &Move,
    parts: &[f64],
    points: &[Coordinates],
    from: Coordinates,
    tolerance: f64,
    attempt: u32,
) -> Vec<(Path, Range<usize>)> {
    // Most moves stay whole.
    let mut found = Vec::with_capacity(1);
    let segment = Points { grid, of, parts, points, tolerance };
    let last = points.len() - 1;
    match of.path.arc {
        Some(arc) if attempt <= LAST_OF_ARCS => segment.arcs(&arc, 0..last, from, &mut found),
        _ => segment.lines(0..last, from, &mut found),
    };
    found
}

struct Points<'a> {
    grid: &'a Grid,
    of: &'a Move,
    parts: &'a [f64],
    points: &'a [Coordinates],
    tolerance: f64,
}

impl Points<'_> {
    /// Lines, as long as the points allow; gives where they end.
    fn lines(&self, range: Range<usize>, from: Coordinates, found: &mut Vec<(Path, Range<usize>)>) -> Coordinates {
        let (mut start, mut at) = (range.start, from);
        while start < range.end {
            let mut end = range.end;
            while end > start + 1 && !self.is_straight(start, end) {
                end = start + (end - start) / 2;
            }
            let to = self.grid.rounded(&self.points[end], &at);
            found.push((Path { from: at, to, arc: None }, start..end));
            (start, at) = (end, to);
        }
        at
    }

    /// Whether a line holds the points in between.
    fn is_straight(&self, start: usize, end: usize) -> bool {
        let line = Path { from: self.points[start], to: self.points[end], arc: None };
        self.holds(&line, start, end)
    }

    /// Whether a path holds the points in between. The first that it does not hold decides, so that many refused paths of many points
    /// take no time.
    fn holds(&self, path: &Path, start: usize, end: usize) -> bool {
        let whole = self.parts[end] - self.parts[start];
        (start + 1..end).all(|point| {
            let on = path.at((self.parts[point] - self.parts[start]) / whole);
            self.apart(&on, &self.points[point]) <= self.tolerance
        })
    }

    fn apart(&self, one: &Coordinates, other: &Coordinates) -> f64 {
        let by = |axis: usize| {
            let by = one[axis] - other[axis];
            if is_rotary(axis) { by.to_radians() * LEVER } else { by }
        };
        (0..9).map(|axis| by(axis).powi(2)).sum::<f64>().sqrt()
    }

    /// Arcs, halved until they hold the tolerance, and lines where not even the shortest does; gives where they end.
    fn arcs(
        &self,
        arc: &Arc,
        range: Range<usize>,
        from: Coordinates,
        found: &mut Vec<(Path, Range<usize>)>,
    ) -> Coordinates {
        let (start, end) = (range.start, range.end);
        if end - start < 2 {
            return self.lines(range, from, found);
        }
        let middle = (start + end) / 2;
        if let Some(path) = self.arc(arc, start, middle, end, from) {
            let to = path.to;
            found.push((path, range));
            return to;
        }
        let at = self.arcs(arc, start..middle, from, found);
        self.arcs(arc, middle..end, at, found)
    }

    /// The arc through three points, if it holds the tolerance with the numbers that can be written.
    fn arc(&self, arc: &Arc, start: usize, middle: usize, end: usize, from: Coordinates) -> Option<Path> {
        let turned = arc.sweep * (self.parts[end] - self.parts[start]);
        if turned.abs() > LARGEST_TURN {
            return None;
        }
        let [i, j] = arc.plane;
        let mut to = self.grid.rounded(&self.points[end], &from);
        if self.grid.has_flat_arcs {
            (0..9).filter(|axis| ![i, j].contains(axis)).for_each(|axis| to[axis] = from[axis]);
            if self.apart(&to, &self.points[end]) > self.tolerance {
                return None;
            }
        }
        let flat = |at: &Coordinates| [at[i], at[j]];
        let through = flat(&self.points[middle]);
        let centre = centre_of_three(flat(&from), through, flat(&to))?;
        let digit = self.grid.digit[i];
        let base = |place: usize| match self.of.arc_absolute {
            true => self.grid.offset[arc.plane[place]],
            false => from[arc.plane[place]],
        };
        let centre = [0, 1].map(|place| base(place) + ((centre[place] - base(place)) / digit).round() * digit);
        let radius = |at: &Coordinates| (at[i] - centre[0]).hypot(at[j] - centre[1]);
        let (first, last) = (radius(&from), radius(&to));
        if !(SMALLEST_RADIUS..=LARGEST_RADIUS).contains(&first) || (first - last).abs() > OFF_CIRCLE {
            return None;
        }
        let sweep = sweep(flat(&from), flat(&to), centre, self.of.motion == Motion::Clockwise);
        let path = Path { from, to, arc: Some(Arc { plane: arc.plane, centre, sweep }) };
        let holds = (sweep - turned).abs() < 0.1 && self.holds(&path, start, end);
        holds.then_some(path)
    }
}

/// Largest turn of one arc that is written, rad: half a circle.
const LARGEST_TURN: f64 = std::f64::consts::PI + 1e-6;

/// Radii, mm, between which controls make arcs of four decimals without a doubt.
const SMALLEST_RADIUS: f64 = 0.1;
const LARGEST_RADIUS: f64 = 1e5;

/// Farthest that the end of a written arc may be from its circle, mm. LinuxCNC allows 0.0127 mm with an inch, grbl 0.005 mm.
const OFF_CIRCLE: f64 = 1e-3;
