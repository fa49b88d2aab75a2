//! A program from its first line to its last: in constant memory, whatever its length.

use std::io::{BufRead, Write};
use std::rc::Rc;

use abbe_core::{Error, Result};
use sha2::{Digest, Sha256};

use crate::block::{Action, Move, Reader};
use crate::dialect::Dialect;
use crate::emit::Emitter;
use crate::machine::{Machine, Point, Space};
use crate::modal::{MachineOf, letter};
use crate::options::{MARK, Options};
use crate::plan::{Moved, Planned, Planner, Purpose};

/// What became of a program.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Summary {
    /// Lines that were read.
    pub lines: usize,
    /// Moves that were corrected.
    pub moves: usize,
    /// Blocks that were written for them.
    pub blocks: usize,
    /// Arcs that were programmed, and those written.
    pub arcs: [usize; 2],
    /// Moves that bring axes to a start: after a reversal, or after a move that is not corrected.
    pub take_ups: usize,
    /// Rapid moves that are as they were: to reference points, in machine coordinates, before all positions were known.
    pub uncorrected: usize,
    /// Largest correction of a linear axis at the end of a move, mm.
    pub largest: f64,
    /// Largest distance of the tip from the programmed path that was found along feed moves, mm, and its line.
    pub remaining: f64,
    /// The line of the program.
    pub remaining_line: usize,
    /// Work offsets that were taken to be zero: 0 is G54.
    pub assumed: Vec<usize>,
    /// What else was taken for granted, in words.
    pub remarks: Vec<String>,
}

/// What some editors put before a text in UTF-8. Controls do not read it.
const BYTE_ORDER_MARK: &[u8] = "\u{feff}".as_bytes();

/// Longest line that is read, bytes.
const LONGEST_LINE: usize = 1 << 16;

/// Lines that are planned together: few enough that their memory stays with the process and in the cache.
const TOGETHER: usize = 128;

/// Corrects a program: reads `source` to its end and writes the corrected text to `out`. `build` gives the machine with a tool of a
/// length, that of the calibration without one.
///
/// Fails with line and column at the first thing that cannot be corrected, and for a program without a block; what was written until
/// then is of no use.
pub fn compensate(
    source: &mut dyn BufRead,
    out: &mut dyn Write,
    build: &MachineOf<'_>,
    options: &Options,
) -> Result<Summary> {
    let mut keep = |_: Option<&Planned>, text: &[u8], _: usize| -> Result<()> {
        out.write_all(text).map_err(|error| Error::data(format!("the program cannot be written: {error}")))
    };
    run(source, &mut keep, build, options)
}

/// The mark of a calibration: the beginning of the hash of its text.
pub fn mark(calibration: &[u8]) -> String {
    Sha256::digest(calibration).iter().take(8).map(|byte| format!("{byte:02x}")).collect()
}

/// What happens to a planned move, or to other text, and its line.
pub(crate) type Keep<'a> = dyn FnMut(Option<&Planned>, &[u8], usize) -> Result<()> + 'a;

/// A line that waits for those before it.
enum Waiting {
    Text(Vec<u8>, Option<crate::modal::Motion>),
    Move(Vec<u8>),
}

/// Goes through a program.
pub(crate) fn run(
    source: &mut dyn BufRead,
    keep: &mut Keep<'_>,
    build: &MachineOf<'_>,
    options: &Options,
) -> Result<Summary> {
    check(options)?;
    let machine = Rc::new(build(options.tools.only)?);
    check_axes(options, &machine)?;
    let mut run = Run {
        is_perfect: machine.is_perfect(),
        reader: Reader::new(machine, build, options, false),
        planner: Planner::new(options),
        emitter: Emitter::new(options),
        options,
        keep,
        waiting: Vec::new(),
        moves: Vec::new(),
        summary: Summary::default(),
        is_marked: false,
        has_told_system: false,
        frame: None,
    };
    let mut lines = Lines::new(source, options);
    let (mut count, mut is_open) = (0, false);
    while let Some(line) = lines.next()? {
        count += 1;
        let before = run.moves.len() + run.summary.moves + run.summary.uncorrected;
        let has_end = line.ends_with(b"\n") || line.ends_with(b"\r");
        run.line(line, count)?;
        is_open = !has_end && run.moves.len() + run.summary.moves + run.summary.uncorrected > before;
    }
    run.flush()?;
    if is_open && !run.reader.has_ended {
        let text = format!(
            "Line {count}: the program ends with a move, without an end of this line and without an end of program: is the file whole?"
        );
        run.summary.remarks.push(text);
    }
    if !run.reader.has_block {
        let error = Error::data("the program has no block: there is nothing to correct").in_file(&options.file);
        return Err(error.help("is this the file with the program, and is it whole?"));
    }
    run.summary.lines = count;
    run.summary.assumed.clone_from(&run.reader.modal.assumed);
    Ok(run.summary)
}

/// Refuses offsets and positions of axes that the machine does not have.
fn check_axes(options: &Options, machine: &Machine) -> Result<()> {
    let offsets = options.offsets.values().flat_map(|offset| offset.iter().map(|value| *value != 0.0).enumerate());
    let named = offsets.chain(options.start.iter().map(|at| at.is_some_and(|at| at != 0.0)).enumerate());
    match named.into_iter().find(|(axis, is_named)| *is_named && !machine.has(*axis)) {
        Some((axis, _)) => {
            let message = format!(
                "an offset or a start of {}, an axis that the machine of the calibration does not have",
                letter(axis)
            );
            Err(Error::usage(message).help("leave it out of `--offset` and `--start`"))
        }
        None => Ok(()),
    }
}

fn check(options: &Options) -> Result<()> {
    let digit = 10_f64.powi(-(options.decimals as i32));
    if 0.9 * digit > options.tolerance {
        let message = format!(
            "numbers of {} decimals are off by up to {} µm, and the tolerance is {} µm",
            options.decimals,
            900.0 * digit,
            options.tolerance * 1e3
        );
        return Err(Error::usage(message).help("allow more: `--tolerance-um`, or write more `--decimals`"));
    }
    Ok(())
}

struct Run<'a, 'b> {
    is_perfect: bool,
    reader: Reader<'a>,
    planner: Planner<'a>,
    emitter: Emitter<'a>,
    options: &'a Options,
    keep: &'b mut Keep<'b>,
    waiting: Vec<(Waiting, usize)>,
    #[expect(clippy::vec_box, reason = "a move is large, and is handed on several times")]
    moves: Vec<Box<Move>>,
    summary: Summary,
    is_marked: bool,
    /// Whether it was told that no work offset is named.
    has_told_system: bool,
    /// In which coordinates, and with which tool, the last move was.
    frame: Option<(Space, Rc<Machine>)>,
}

impl Run<'_, '_> {
    fn line(&mut self, line: &[u8], number: usize) -> Result<()> {
        let end = line.iter().rposition(|byte| !b"\r\n".contains(byte)).map_or(0, |last| last + 1);
        let text = &line[..end];
        let action = self
            .reader
            .line(text)
            .map_err(|refusal| refusal.or_written_out(self.options.dialect).at(&self.options.file, number, text))?;
        let has_begun = self.reader.klartext.as_ref().is_none_or(|program| program.has_begun);
        if !self.is_marked && !self.is_perfect && has_begun && !is_head(text, self.options.dialect) {
            self.mark(&line[end..]);
        }
        if !matches!(action, Action::Copy(_)) {
            self.tell_assumptions(number);
        }
        match action {
            Action::Copy(motion) => self.waiting.push((Waiting::Text(line.to_vec(), motion), number)),
            Action::Jump { at, moved, space, motion, is_rapid } => {
                self.summary.uncorrected += usize::from(is_rapid);
                self.waiting.push((Waiting::Text(line.to_vec(), motion), number));
                self.flush()?;
                // In other coordinates it is not known how those that stay were written.
                let is_same = |(own, machine): &(Space, Rc<Machine>)| {
                    *own == space && (space == Space::Joints || Rc::ptr_eq(machine, &self.reader.modal.machine))
                };
                let stays = self.frame.as_ref().is_some_and(is_same);
                self.planner.jumped(&at, if stays { &moved } else { &[Moved::To; 9] });
                self.frame = Some((space, Rc::clone(&self.reader.modal.machine)));
            }
            Action::Move(_) if self.is_perfect => {
                self.summary.moves += 1;
                self.summary.blocks += 1;
                self.waiting.push((Waiting::Text(line.to_vec(), None), number));
            }
            Action::Move(of) => {
                let is_same =
                    |(space, machine): &(Space, Rc<Machine>)| *space == of.space && Rc::ptr_eq(machine, &of.machine);
                if !self.frame.as_ref().is_some_and(is_same) {
                    self.flush()?;
                    self.changed(&of)?;
                }
                self.moves.push(of);
                self.waiting.push((Waiting::Move(line.to_vec()), number));
            }
        }
        if self.waiting.len() >= TOGETHER {
            self.flush()?;
        }
        Ok(())
    }

    /// What a control takes from its parameters and the program does not say before its first move.
    fn tell_assumptions(&mut self, number: usize) {
        let (modal, dialect) = (&mut self.reader.modal, self.options.dialect);
        if let Some([inches, mm]) = dialect.unit_codes().filter(|_| !modal.has_unit) {
            let text =
                format!("Line {number}: neither {inches} nor {mm} stands before the first move; numbers count as mm");
            self.summary.remarks.push(text);
        }
        if !dialect.starts_absolute() && !modal.has_distance {
            let text =
                format!("Line {number}: neither G90 nor G91 stands before the first move; numbers count as absolute");
            self.summary.remarks.push(text);
        }
        (modal.has_unit, modal.has_distance) = (true, true);
        // Other controls begin with G54; here it is a parameter, and often none acts (G500).
        if dialect == Dialect::Siemens && modal.uses_unnamed_system && !self.has_told_system {
            self.has_told_system = true;
            let text = format!("Line {number}: no work offset (G54, .., G500) is named before this move; G54 counts");
            self.summary.remarks.push(text);
        }
    }

    /// Another tool, or other coordinates: where the axes stand is told in them.
    fn changed(&mut self, of: &Move) -> Result<()> {
        let before = self.frame.replace((of.space, Rc::clone(&of.machine)));
        self.planner.forget();
        let (Some((space, machine)), Some(written)) = (before, self.planner.written) else { return Ok(()) };
        self.planner.written = match (space, of.space) {
            (Space::Joints, Space::Workpiece) => Some(of.machine.on_workpiece(&written)?),
            (Space::Workpiece, Space::Joints) => {
                let point = Point { at: written, directions: [1.0; 9] };
                machine.joints(Space::Workpiece, &[point])?.first().copied()
            }
            _ => Some(written),
        };
        Ok(())
    }

    fn mark(&mut self, eol: &[u8]) {
        self.is_marked = true;
        let tolerance = self.options.tolerance * 1e3;
        let words = format!("{MARK}: calibration {}, tolerance {tolerance} um", self.options.calibration);
        let comment =
            if self.options.dialect.has_bracket_comments() { format!("({words})") } else { format!("; {words}") };
        let eol = if eol.is_empty() { b"\n" } else { eol };
        self.waiting.push((Waiting::Text([comment.as_bytes(), eol].concat(), None), 0));
    }

    /// Plans and writes what waits.
    fn flush(&mut self) -> Result<()> {
        let moves = std::mem::take(&mut self.moves);
        let numbers: Vec<usize> = (self.waiting.iter())
            .filter(|(waiting, _)| matches!(waiting, Waiting::Move(_)))
            .map(|(_, number)| *number)
            .collect();
        let planned = self.planner.plan(moves).map_err(|error| {
            let number = error.pose.and_then(|index| numbers.get(index));
            number.map_or_else(|| error.clone(), |number| error.clone().at(&self.options.file, *number, None))
        })?;
        let mut planned = planned.into_iter();
        let mut text = Vec::new();
        for (waiting, number) in std::mem::take(&mut self.waiting) {
            match waiting {
                Waiting::Text(text, motion) => {
                    self.emitter.motion = motion.or(self.emitter.motion);
                    (self.keep)(None, &self.emitter.copied(text, number == 0), number)?;
                }
                Waiting::Move(line) => {
                    let Some(own) = planned.next() else { continue };
                    text.clear();
                    self.emitter.lines(&own, &line, &mut text);
                    self.count(&own, number);
                    (self.keep)(Some(&own), &text, number)?;
                }
            }
        }
        Ok(())
    }

    fn count(&mut self, own: &Planned, number: usize) {
        let summary = &mut self.summary;
        summary.moves += 1;
        summary.blocks += own.pieces.len();
        summary.arcs[0] += usize::from(own.of.path.arc.is_some());
        summary.arcs[1] += own.pieces.iter().filter(|piece| piece.path.arc.is_some()).count();
        summary.take_ups += own.pieces.iter().filter(|piece| piece.purpose == Purpose::TakeUp).count();
        if let Some(last) = own.pieces.last() {
            let of_axis = |axis: usize| (last.path.to[axis] - own.of.path.to[axis]).abs();
            summary.largest = [0, 1, 2, 6, 7, 8].into_iter().map(of_axis).fold(summary.largest, f64::max);
        }
        if own.remaining > summary.remaining {
            (summary.remaining, summary.remaining_line) = (own.remaining, number);
        }
    }
}

/// Whether a line stands at the head of a program, before which nothing may stand.
fn is_head(text: &[u8], dialect: Dialect) -> bool {
    let text = text.trim_ascii();
    let first = text.first().copied().unwrap_or(b'%');
    let begins = dialect == Dialect::Heidenhain && crate::klartext::begins(text);
    begins
        || first == b'%'
        || text.starts_with(b";$PATH")
        || dialect.has_program_numbers() && first.eq_ignore_ascii_case(&b'O')
}

/// Lines of a program with their ends.
pub(crate) struct Lines<'a> {
    source: &'a mut dyn BufRead,
    options: &'a Options,
    line: Vec<u8>,
    /// The number of the last line, from 1.
    pub(crate) number: usize,
}

impl<'a> Lines<'a> {
    pub(crate) fn new(source: &'a mut dyn BufRead, options: &'a Options) -> Self {
        Self { source, options, line: Vec::new(), number: 0 }
    }

    /// The next line, the first without a byte order mark; none at the end.
    pub(crate) fn next(&mut self) -> Result<Option<&[u8]>> {
        use std::io::Read;
        self.line.clear();
        let mut limited = (&mut *self.source).take(LONGEST_LINE as u64 + 1);
        let read = limited.read_until(b'\n', &mut self.line);
        let read = read
            .map_err(|error| Error::data(format!("the program cannot be read: {error}")).in_file(&self.options.file))?;
        if read == 0 {
            return Ok(None);
        }
        self.number += 1;
        if self.number == 1 && self.line.starts_with(BYTE_ORDER_MARK) {
            self.line.drain(..BYTE_ORDER_MARK.len());
        }
        if read > LONGEST_LINE {
            let error = Error::data("a line of a program is longer than 65536 bytes").help("is this an NC program?");
            return Err(error.at(&self.options.file, self.number, None));
        }
        Ok(Some(&self.line))
    }
}
