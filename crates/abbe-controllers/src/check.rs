//! What remains of the errors along the path of a corrected program.

use std::io::BufRead;
use std::rc::Rc;

use abbe_core::{Error, Result};

use crate::block::{Action, Move, Reader};
use crate::geometry::Path;
use crate::machine::{Machine, Point, Space};
use crate::modal::{MachineOf, Motion};
use crate::options::Options;
use crate::plan::{Piece, Planned, Purpose, distance};
use crate::program::{Lines, Summary, run};

/// The largest error of a kind, and where.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Worst {
    /// Distance of the tip from the programmed path, mm.
    pub distance: f64,
    /// Line of the corrected program.
    pub line: usize,
    /// Line of the program that was corrected.
    pub of: usize,
}

/// What a corrected program does.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Checked {
    /// Blocks of motion.
    pub blocks: usize,
    /// Places along the path that were looked at.
    pub places: usize,
    /// The largest error along feed moves.
    pub path: Worst,
    /// The largest error at the ends of rapid moves.
    pub rapid: Worst,
    /// What the mark of the corrected program says.
    pub mark: Option<String>,
}

/// Places that are looked at between two computed points.
const FINER: usize = 4;

/// Blocks that are looked at together.
const TOGETHER: usize = 256;

/// Reads a program and its corrected one, and looks along the path of the corrected one where the tip of the machine with errors is.
///
/// The corrected text is read from a fresh state; the tip of its numbers is that of the exact kinematics. Which block corresponds
/// to which part of the program follows from planning the correction again.
///
/// Fails if the corrected program has other blocks than the program asks for with these options.
pub fn check(
    source: &mut dyn BufRead,
    corrected: &mut dyn BufRead,
    build: &MachineOf<'_>,
    options: &Options,
    corrected_file: &std::path::Path,
) -> Result<Checked> {
    let own = Options { file: corrected_file.to_owned(), ..options.clone() };
    let machine = Rc::new(build(options.tools.only)?);
    if machine.is_perfect() {
        return Ok(Checked::default());
    }
    let mut other = Other {
        reader: Reader::new(machine, build, &own, true),
        lines: Lines::new(corrected, &own),
        options: &own,
        checked: Checked::default(),
        waiting: Vec::new(),
    };
    let mut keep = |planned: Option<&Planned>, _: &[u8], line: usize| -> Result<()> {
        let Some(planned) = planned else { return Ok(()) };
        for piece in &planned.pieces {
            other.piece(planned, piece, line)?;
        }
        Ok(())
    };
    let _: Summary = run(source, &mut keep, build, options)?;
    other.look()?;
    if let Some((line, _)) = other.next_move()? {
        return Err(other.differs(line, "more blocks of motion than the program asks for"));
    }
    other.checked.mark = other.reader.mark.take();
    Ok(other.checked)
}

/// A block of the corrected program, and what it should do.
struct Pair {
    machine: Rc<Machine>,
    space: Space,
    found: Path,
    goal: Path,
    piece: Piece,
    line: usize,
    of: usize,
}

struct Other<'a> {
    reader: Reader<'a>,
    lines: Lines<'a>,
    options: &'a Options,
    checked: Checked,
    waiting: Vec<Pair>,
}

impl Other<'_> {
    fn differs(&self, line: usize, what: &str) -> Error {
        let help = "check it with the options that it was corrected with";
        Error::data(format!("the corrected program has {what}")).help(help).at(&self.options.file, line, None)
    }

    /// The next move of the corrected program.
    fn next_move(&mut self) -> Result<Option<(usize, Move)>> {
        loop {
            let Some(line) = self.lines.next()? else { return Ok(None) };
            let end = line.iter().rposition(|byte| !b"\r\n".contains(byte)).map_or(0, |last| last + 1);
            let text = line[..end].to_vec();
            let number = self.lines.number;
            let action = self.reader.line(&text).map_err(|refusal| refusal.at(&self.options.file, number, &text))?;
            if let Action::Move(of) = action {
                return Ok(Some((number, *of)));
            }
        }
    }

    fn piece(&mut self, planned: &Planned, piece: &Piece, of: usize) -> Result<()> {
        let Some((line, found)) = self.next_move()? else {
            return Err(self.differs(self.lines.number, "fewer blocks of motion than the program asks for"));
        };
        self.checked.blocks += 1;
        if found.space != planned.of.space {
            return Err(self.differs(line, "other coordinates than the program"));
        }
        let is_rapid = found.motion == Motion::Rapid;
        if is_rapid != (piece.purpose == Purpose::Rapid) && !planned.of.is_fast_arc() {
            let asked = if piece.purpose == Purpose::Rapid {
                "in feed for a rapid one"
            } else {
                "that is rapid for one in feed"
            };
            return Err(self.differs(line, &format!("a move {asked}")));
        }
        let goal = planned.of.path;
        let pair =
            Pair { machine: found.machine, space: found.space, found: found.path, goal, piece: *piece, line, of };
        let is_other = |last: &Pair| !Rc::ptr_eq(&last.machine, &pair.machine) || last.space != pair.space;
        if self.waiting.len() >= TOGETHER || self.waiting.last().is_some_and(is_other) {
            self.look()?;
        }
        self.waiting.push(pair);
        Ok(())
    }

    /// Looks along the blocks that wait.
    fn look(&mut self) -> Result<()> {
        let pairs = std::mem::take(&mut self.waiting);
        let Some(first) = pairs.first() else { return Ok(()) };
        let (mut points, mut goals, mut owners) = (Vec::new(), Vec::new(), Vec::new());
        for (index, pair) in pairs.iter().enumerate() {
            let count = match pair.piece.purpose {
                Purpose::Path => pair.piece.steps * FINER,
                _ => 1,
            };
            let start = if pair.piece.purpose == Purpose::Path { 0 } else { 1 };
            for step in start..=count {
                let along = step as f64 / count as f64;
                let part = pair.piece.part[0] + along * (pair.piece.part[1] - pair.piece.part[0]);
                let directions = pair.piece.directions;
                points.push(Point { at: pair.found.at(along), directions });
                goals.push(Point { at: pair.goal.at(part), directions });
                owners.push(index);
            }
        }
        let actual = first.machine.actual(first.space, &points)?;
        let goals = first.machine.goals(first.space, &goals)?;
        for ((index, actual), goal) in owners.into_iter().zip(actual).zip(goals) {
            let pair = &pairs[index];
            let worst =
                if pair.piece.purpose == Purpose::Rapid { &mut self.checked.rapid } else { &mut self.checked.path };
            let distance = distance(&actual, &goal);
            if distance > worst.distance {
                *worst = Worst { distance, line: pair.line, of: pair.of };
            }
            self.checked.places += 1;
        }
        Ok(())
    }
}
