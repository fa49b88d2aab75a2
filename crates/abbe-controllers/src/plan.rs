//! Moves as corrected pieces: split where the correction bows, and looked at between the points where it was computed.

use std::ops::Range;

use abbe_core::{Error, Result};

use crate::block::Move;
use crate::fit::{Grid, pieces_of_segment};
use crate::geometry::{Coordinates, Path, is_rotary};
use crate::machine::{Point, Space};
use crate::modal::Motion;
use crate::options::Options;

/// What a piece is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Purpose {
    /// A rapid move: only its end counts.
    Rapid,
    /// A part of a programmed path.
    Path,
    /// Axes go on to where the correction for another direction, or after an uncorrected move, has them; the tool stands in the program.
    TakeUp,
}

/// A corrected piece of a move.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Piece {
    /// As it is written, in coordinates of the machine.
    pub(crate) path: Path,
    /// The part of the move.
    pub(crate) part: [f64; 2],
    /// Directions of approach of the programmed path.
    pub(crate) directions: Coordinates,
    pub(crate) purpose: Purpose,
    /// Steps between points that were computed.
    pub(crate) steps: usize,
}

/// What a line that is copied does with an axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Moved {
    /// It stays where it stands.
    No,
    /// It comes to a position, which may be unknown.
    To,
    /// It moves by this, mm or degrees, from where it stands.
    By(f64),
}

impl Moved {
    /// Axes that come to positions; the others stay.
    pub(crate) fn to(named: [bool; 9]) -> [Self; 9] {
        named.map(|is_named| if is_named { Self::To } else { Self::No })
    }
}

/// A move with its pieces.
pub(crate) struct Planned {
    pub(crate) of: Box<Move>,
    pub(crate) pieces: Vec<Piece>,
    /// Largest distance of the tip, mm, that was found along it.
    pub(crate) remaining: f64,
}

/// A part of a move in which no axis turns around.
struct Segment {
    part: [f64; 2],
    directions: Coordinates,
    steps: usize,
    /// Whether its start is computed, and is not the end of what was before.
    has_start: bool,
}

/// Plans moves one after the other.
pub(crate) struct Planner<'a> {
    options: &'a Options,
    /// Where the axes stand as it is written, and of which axes that is known.
    pub(crate) written: Option<Coordinates>,
    known: [bool; 9],
    /// Directions of the last moves of the axes.
    directions: Coordinates,
    /// Exact corrected position at the end of the last move, if that was corrected.
    last: Option<Coordinates>,
}

/// Part of the tolerance that is aimed at: between the places that are looked at a little more may remain.
const AIMED: f64 = 0.9;

/// Most times that a move is planned anew.
const ATTEMPTS: u32 = 10;

impl<'a> Planner<'a> {
    pub(crate) fn new(options: &'a Options) -> Self {
        Self { options, written: None, known: [true; 9], directions: [1.0; 9], last: None }
    }

    /// Axes have moved without a correction; the others stand where they were written.
    pub(crate) fn jumped(&mut self, at: &[Option<f64>; 9], moved: &[Moved; 9]) {
        let known = |axis: usize| match self.written {
            Some(written) => Some(written[axis]).filter(|_| self.known[axis]),
            None => self.options.start[axis],
        };
        let before: [Option<f64>; 9] = std::array::from_fn(known);
        let is_first = self.written.is_none();
        let now: [Option<f64>; 9] = std::array::from_fn(|axis| match moved[axis] {
            _ if is_first => at[axis],
            Moved::No => before[axis],
            Moved::To => at[axis],
            // From where it was written, which is not where the program has it.
            Moved::By(way) => before[axis].map(|before| before + way),
        });
        for axis in 0..9 {
            if let (Some(before), Some(now)) = (before[axis], now[axis])
                && now != before
            {
                self.directions[axis] = (now - before).signum();
            }
        }
        self.known = now.map(|at| at.is_some());
        self.written = Some(now.map(|at| at.unwrap_or(0.0)));
        self.last = None;
    }

    /// What was before tells nothing of the next correction: another tool, or other coordinates.
    pub(crate) fn forget(&mut self) {
        self.last = None;
    }

    /// Plans moves of one machine and one kind of coordinates. Errors have the index of their move as their pose.
    #[expect(clippy::vec_box, reason = "a move is large, and is handed on several times")]
    pub(crate) fn plan(&mut self, moves: Vec<Box<Move>>) -> Result<Vec<Planned>> {
        if !moves.is_empty() {
            self.known = [true; 9];
        }
        let mut segments = Vec::with_capacity(moves.len());
        for (index, of) in moves.iter().enumerate() {
            segments.push(self.segments(of, 0).map_err(|error| error.at_pose(index))?);
        }
        let (points, owners) = points_of(&moves, &segments);
        let corrected = match moves.first() {
            Some(first) => first.machine.corrected(first.space, &points).map_err(|error| located(error, &owners))?,
            None => Vec::new(),
        };
        let mut rest = corrected.as_slice();
        let mut planned = Vec::with_capacity(moves.len());
        let mut starts = Vec::with_capacity(moves.len());
        for (of, segments) in moves.into_iter().zip(&segments) {
            starts.push((self.written, self.last));
            let count = segments.iter().map(Segment::points).sum();
            let (own, after) = rest.split_at(count);
            rest = after;
            let pieces = self.pieces(&of, segments, own, 0);
            planned.push(Planned { of, pieces, remaining: 0.0 });
        }
        self.verify(&mut planned, &starts)?;
        Ok(planned)
    }

    /// Looks at all pieces between their points, and plans those anew that are off.
    fn verify(&self, planned: &mut [Planned], starts: &[(Option<Coordinates>, Option<Coordinates>)]) -> Result<()> {
        let looked: Vec<(usize, f64)> = remaining(planned)?;
        for (index, found) in looked {
            planned[index].remaining = planned[index].remaining.max(found);
        }
        for (index, (own, start)) in planned.iter_mut().zip(starts).enumerate() {
            let mut attempt = 0;
            while own.remaining > AIMED * self.options.tolerance {
                attempt += 1;
                if attempt > ATTEMPTS {
                    let tolerance = self.options.tolerance * 1e3;
                    let message = format!(
                        "{:.3} µm remain along this move, more than the tolerance of {tolerance} µm",
                        own.remaining * 1e3
                    );
                    let machine = &own.of.machine;
                    let turns = machine.places().any(|axis| is_rotary(axis) && machine.corrects(axis));
                    let is_held = machine.places().any(|axis| !is_rotary(axis) && !machine.corrects(axis));
                    let help = match (turns, is_held) {
                        (true, _) => {
                            "near a pole of the rotary axes correct the tip alone: `--correct position`; or allow more"
                        }
                        (false, true) => {
                            "correct all linear axes (`--correct position`): what those make that are not corrected remains; or allow \
                             more: `--tolerance-um`"
                        }
                        (false, false) => {
                            "allow more: `--tolerance-um`, or more `--decimals`; where axes are held at the ends of their travel, move the \
                             program"
                        }
                    };
                    return Err(Error::data(message).help(help).at_pose(index));
                }
                let at = |error: Error| error.at_pose(index);
                let mut again = Self { written: start.0, last: start.1, directions: self.directions, ..*self };
                let segments = finer(&own.pieces, own, attempt);
                let (points, _) = points_of(std::slice::from_ref(&own.of), std::slice::from_ref(&segments));
                let corrected = own.of.machine.corrected(own.of.space, &points).map_err(at)?;
                own.pieces = again.pieces(&own.of, &segments, &corrected, attempt);
                own.remaining =
                    remaining(std::slice::from_ref(own)).map_err(at)?.iter().map(|found| found.1).fold(0.0, f64::max);
            }
        }
        Ok(())
    }

    /// The parts of a move between places where an axis turns around.
    fn segments(&mut self, of: &Move, attempt: u32) -> Result<Vec<Segment>> {
        let steps = steps(of) << attempt;
        let mut found = Vec::with_capacity(1);
        let mut push = |part: [f64; 2], directions: Coordinates, last: &mut Coordinates, known: bool| {
            let has_start = !known || directions != *last && of.machine.has_directions();
            let share = ((part[1] - part[0]) * steps as f64).ceil().max(1.0) as usize;
            let steps = if of.path.arc.is_some() { share.max(2).next_power_of_two() } else { share };
            let steps = if of.motion == Motion::Rapid { 1 } else { steps };
            *last = directions;
            found.push(Segment { part, directions, steps, has_start });
        };
        let mut known = self.last.is_some();
        // The end of the last move is known when this one is planned.
        self.last.get_or_insert([0.0; 9]);
        let mut last = self.directions;
        if of.motion == Motion::Rapid || !of.machine.has_directions() {
            let directions = if of.machine.has_directions() { self.moved(of, [0.0, 1.0])? } else { last };
            push([0.0, 1.0], directions, &mut last, known);
            self.directions = last;
            return Ok(found);
        }
        let mut ends = vec![0.0];
        ends.extend(self.turns(of)?);
        ends.push(1.0);
        for part in ends.windows(2) {
            self.directions = last;
            let directions = self.moved(of, [part[0], part[1]])?;
            push([part[0], part[1]], directions, &mut last, known);
            known = true;
        }
        self.directions = last;
        Ok(found)
    }

    /// Directions after a part of a move.
    fn moved(&self, of: &Move, part: [f64; 2]) -> Result<Coordinates> {
        let mut directions = self.directions;
        if !of.has_start {
            return Ok(directions);
        }
        let begin = if of.motion == Motion::Rapid && of.space == Space::Workpiece { part[1] - 1e-3 } else { part[0] };
        let ends = [begin, part[1]].map(|part| Point { at: of.path.at(part), directions });
        let joints = of.machine.joints(of.space, &ends)?;
        for axis in 0..9 {
            let by = joints[1][axis] - joints[0][axis];
            if by.abs() > STANDS {
                directions[axis] = by.signum();
            }
        }
        Ok(directions)
    }

    /// Parts of a move at which an axis turns around.
    fn turns(&self, of: &Move) -> Result<Vec<f64>> {
        if of.space == Space::Joints {
            return Ok(of.path.turns());
        }
        let parts = parts_for_turns((8 * steps(of)).max(128));
        let points: Vec<Point> =
            parts.iter().map(|part| Point { at: of.path.at(*part), directions: self.directions }).collect();
        let joints = of.machine.joints(of.space, &points)?;
        let mut found = Vec::new();
        for axis in of.machine.places() {
            for (at, joints) in parts.windows(3).zip(joints.windows(3)) {
                let [first, second] = [0, 1].map(|step| joints[step + 1][axis] - joints[step][axis]);
                if first * second < 0.0 && first.abs().max(second.abs()) > STANDS {
                    // The vertex of the parabola through three points: where the slope, which is known in the middle of steps, is zero.
                    let slopes = [first / (at[1] - at[0]), second / (at[2] - at[1])];
                    let middles = [0.5 * (at[0] + at[1]), 0.5 * (at[1] + at[2])];
                    let vertex = slopes[0] / (slopes[0] - slopes[1]);
                    found.push((middles[0] + vertex * (middles[1] - middles[0])).clamp(0.0, 1.0));
                }
            }
        }
        found.retain(|part| *part > 1e-9 && *part < 1.0 - 1e-9);
        found.sort_by(f64::total_cmp);
        found.dedup_by(|next, part| *next - *part < 1e-9);
        Ok(found)
    }

    /// The pieces of a move from its corrected points.
    fn pieces(&mut self, of: &Move, segments: &[Segment], corrected: &[Coordinates], attempt: u32) -> Vec<Piece> {
        let grid = Grid::new(self.options, of);
        let mut pieces = Vec::with_capacity(segments.len());
        let mut rest = corrected;
        for segment in segments {
            let (own, after) = rest.split_at(segment.points());
            rest = after;
            let mut points = Vec::with_capacity(segment.steps + 1);
            if let (false, Some(last)) = (segment.has_start, self.last) {
                points.push(last);
            }
            points.extend_from_slice(own);
            let (first, end) = (points[0], points[points.len() - 1]);
            let written = self.written.unwrap_or(of.path.from);
            let piece = |path: Path, part: [f64; 2], purpose: Purpose, steps: usize| Piece {
                path,
                part,
                directions: segment.directions,
                purpose,
                steps,
            };
            self.last = Some(end);
            if of.motion == Motion::Rapid {
                let to = grid.rounded(&end, &written);
                pieces.push(piece(Path { from: written, to, arc: None }, segment.part, Purpose::Rapid, 1));
                self.written = Some(to);
                continue;
            }
            let start = grid.rounded(&first, &written);
            let mut from = written;
            if grid.is_apart(&written, &start) {
                let part = [segment.part[0]; 2];
                pieces.push(piece(Path { from: written, to: start, arc: None }, part, Purpose::TakeUp, 1));
                from = start;
            }
            let parts: Vec<f64> = (0..=segment.steps)
                .map(|step| segment.part[0] + (segment.part[1] - segment.part[0]) * step as f64 / segment.steps as f64)
                .collect();
            let tolerance = self.options.tolerance * 0.5_f64.powi(attempt as i32 + 1);
            let found = pieces_of_segment(&grid, of, &parts, &points, from, tolerance, attempt);
            for (path, Range { start, end }) in found {
                from = path.to;
                pieces.push(piece(path, [parts[start], parts[end]], Purpose::Path, end - start));
            }
            self.written = Some(from);
        }
        pieces
    }
}

impl Segment {
    fn points(&self) -> usize {
        self.steps + usize::from(self.has_start)
    }
}

/// A move of an axis, mm and degrees, below which it stands.
const STANDS: f64 = 1e-9;

/// Parts of a move between which axes are looked at for turns: equal steps, and ever shorter ones towards the ends, because a turn
/// shows only between two steps.
fn parts_for_turns(count: usize) -> Vec<f64> {
    let step = 1.0 / count as f64;
    let short: Vec<f64> = (1..=SHORTER).map(|halved| step * 0.5_f64.powi(halved)).collect();
    let first = short.iter().rev().copied();
    let last = short.iter().map(|short| 1.0 - short);
    let equal = (1..count).map(|index| index as f64 * step);
    std::iter::once(0.0).chain(first).chain(equal).chain(last).chain([1.0]).collect()
}

/// How often the first and the last step of [`parts_for_turns`] are halved.
const SHORTER: i32 = 12;

/// Steps of a move between points that are computed.
fn steps(of: &Move) -> usize {
    let (linear, rotary) = of.path.size();
    let turn = of.path.arc.map_or(0.0, |arc| arc.sweep.abs() / ARC_STEP);
    let wanted = (linear / of.machine.step()).max(rotary / ROTARY_STEP).max(turn);
    (wanted.ceil().max(1.0) as usize).min(MOST_STEPS)
}

/// Longest steps of rotary axes, degrees, and of arcs, rad.
const ROTARY_STEP: f64 = 1.0;
const ARC_STEP: f64 = 0.4;

/// Most steps of a move.
const MOST_STEPS: usize = 1 << 16;

/// The points that have to be computed, and the index of the move of each.
fn points_of(moves: &[Box<Move>], segments: &[Vec<Segment>]) -> (Vec<Point>, Vec<usize>) {
    let count = segments.iter().flatten().map(Segment::points).sum();
    let (mut points, mut owners) = (Vec::with_capacity(count), Vec::with_capacity(count));
    for (index, (of, segments)) in moves.iter().zip(segments).enumerate() {
        for segment in segments {
            for step in usize::from(!segment.has_start)..=segment.steps {
                let part = step as f64 / segment.steps as f64;
                let at = of.path.at(segment.part[0] + part * (segment.part[1] - segment.part[0]));
                points.push(Point { at, directions: segment.directions });
                owners.push(index);
            }
        }
    }
    (points, owners)
}

/// The same segments as before with finer steps.
fn finer(pieces: &[Piece], of: &Planned, attempt: u32) -> Vec<Segment> {
    let mut segments: Vec<Segment> = Vec::new();
    for piece in pieces.iter().filter(|piece| piece.purpose == Purpose::Path) {
        match segments.last_mut() {
            Some(last) if last.directions == piece.directions => last.part[1] = piece.part[1],
            _ => segments.push(Segment { part: piece.part, directions: piece.directions, steps: 1, has_start: true }),
        }
    }
    let all = (steps(&of.of) << attempt).min(MOST_STEPS);
    for segment in &mut segments {
        let share = ((segment.part[1] - segment.part[0]) * all as f64).ceil().max(2.0) as usize;
        segment.steps = share.next_power_of_two();
    }
    segments
}

fn located(mut error: Error, owners: &[usize]) -> Error {
    error.pose = error.pose.and_then(|pose| owners.get(pose).copied());
    error
}

/// The largest distance of the tip from the programmed path along moves: index of the move, mm.
fn remaining(planned: &[Planned]) -> Result<Vec<(usize, f64)>> {
    let Some(first) = planned.first() else { return Ok(Vec::new()) };
    let count = planned.iter().flat_map(|own| &own.pieces).map(|piece| piece.steps).sum();
    let (mut points, mut goals) = (Vec::with_capacity(count), Vec::with_capacity(count));
    let mut owners = Vec::with_capacity(count);
    for (index, own) in planned.iter().enumerate() {
        for piece in own.pieces.iter().filter(|piece| piece.purpose == Purpose::Path) {
            looked_at(piece, own, &mut points, &mut goals);
            owners.resize(points.len(), index);
        }
    }
    let of = &first.of;
    let actual = of.machine.actual(of.space, &points).map_err(|error| located(error, &owners))?;
    let goals = of.machine.goals(of.space, &goals).map_err(|error| located(error, &owners))?;
    let apart = actual.iter().zip(&goals).map(|(one, other)| distance(one, other));
    Ok(owners.into_iter().zip(apart).collect())
}

fn looked_at(piece: &Piece, own: &Planned, points: &mut Vec<Point>, goals: &mut Vec<Point>) {
    for step in 0..piece.steps {
        let along = (step as f64 + 0.5) / piece.steps as f64;
        let part = piece.part[0] + along * (piece.part[1] - piece.part[0]);
        points.push(Point { at: piece.path.at(along), directions: piece.directions });
        goals.push(Point { at: own.of.path.at(part), directions: piece.directions });
    }
}

/// Distance of two points.
pub(crate) fn distance(one: &[f64; 3], other: &[f64; 3]) -> f64 {
    (0..3).map(|axis| (one[axis] - other[axis]).powi(2)).sum::<f64>().sqrt()
}

/// Whether a coordinate is written.
pub(crate) fn is_written(of: &Move, axis: usize) -> bool {
    let is_tip = of.space == Space::Workpiece && !is_rotary(axis) && axis < 3;
    of.machine.has(axis) && (of.machine.corrects(axis) || of.named[axis] || is_tip)
}
