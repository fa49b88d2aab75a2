//! Blocks of a program as moves.

use std::rc::Rc;

use crate::dialect::Dialect;
use crate::geometry::{Arc, Coordinates, Path, centre_of_radius, is_rotary, place, sweep};
use crate::lexer::{self, Line, Sense, Word};
use crate::machine::{Machine, Space};
use crate::modal::{MachineOf, Modal, Motion, Said, Special, letter, refused};
use crate::options::{MARK, Options};
use crate::plan::Moved;
use crate::refusal::Refusal;

/// A move of a program.
pub(crate) struct Move {
    pub(crate) motion: Motion,
    pub(crate) space: Space,
    pub(crate) machine: Rc<Machine>,
    /// The path, in coordinates of the machine.
    pub(crate) path: Path,
    /// Whether its start is known.
    pub(crate) has_start: bool,
    pub(crate) named: [bool; 9],
    /// How numbers are written: what is added to them, whether they are relative, the factor to mm.
    pub(crate) offset: Coordinates,
    pub(crate) relative: bool,
    pub(crate) arc_absolute: bool,
    pub(crate) inches: bool,
    /// F under G93, and its word.
    pub(crate) inverse_feed: Option<(f64, usize)>,
    pub(crate) motion_word: Option<usize>,
    pub(crate) late: Vec<usize>,
    pub(crate) line: Line,
}

impl Move {
    /// Whether it is an arc in rapid traverse, which holds its path all the same.
    pub(crate) fn is_fast_arc(&self) -> bool {
        self.path.arc.is_some() && self.line.words.iter().any(|word| word.name == "FMAX")
    }
}

/// What becomes of a line.
pub(crate) enum Action {
    /// It is copied. The motion that it makes modal, if it does.
    Copy(Option<Motion>),
    /// It is copied, and the axes stand at these positions afterwards, if they were moved to them.
    Jump { at: [Option<f64>; 9], moved: Box<[Moved; 9]>, space: Space, motion: Option<Motion>, is_rapid: bool },
    /// A move to correct.
    Move(Box<Move>),
}

/// Understands programs, line by line.
pub(crate) struct Reader<'a> {
    pub(crate) modal: Modal,
    pub(crate) options: &'a Options,
    pub(crate) build: &'a MachineOf<'a>,
    /// Whether a corrected program is read.
    reads_corrected: bool,
    pub(crate) has_ended: bool,
    /// Whether there was a block: comments, empty lines and what frames a program are none.
    pub(crate) has_block: bool,
    /// Whether the mark of a corrected program was seen, and its text.
    pub(crate) mark: Option<String>,
    pub(crate) klartext: Option<crate::klartext::Program>,
}

impl<'a> Reader<'a> {
    pub(crate) fn new(
        machine: Rc<Machine>,
        build: &'a MachineOf<'a>,
        options: &'a Options,
        reads_corrected: bool,
    ) -> Self {
        let klartext = (options.dialect == Dialect::Heidenhain).then(crate::klartext::Program::default);
        let modal = Modal::new(machine, options);
        Self { modal, options, build, reads_corrected, has_ended: false, has_block: false, mark: None, klartext }
    }

    /// Understands a line; its end of line is not part of it.
    pub(crate) fn line(&mut self, text: &[u8]) -> Result<Action, Refusal> {
        if let Some(start) = text.windows(MARK.len()).position(|window| window == MARK.as_bytes()) {
            if !self.reads_corrected {
                let help = "correct the program as it was before";
                return Err(Refusal::new(start, "", "this program is compensated already", help));
            }
            self.mark = Some(String::from_utf8_lossy(&text[start..]).trim_end_matches([')', ' ', '\r']).to_owned());
            return Ok(Action::Copy(None));
        }
        if let Some(column) = text.iter().position(|byte| *byte == b'\r') {
            let what = "a carriage return inside a line, where some controls end the block";
            return Err(Refusal::new(column, "", what, "write each block on a line of its own: LF, or CR LF"));
        }
        if self.has_ended {
            return self.after_end(text);
        }
        if self.klartext.is_some() {
            return self.klartext_line(text);
        }
        let line = lexer::line(text, self.options.dialect)?;
        if line.is_frame {
            return Ok(Action::Copy(None));
        }
        self.has_block |= !line.words.is_empty();
        if self.is_left_out(line.optional)? {
            return Ok(Action::Copy(None));
        }
        let said = self.modal.carry_out(&line, self.options, self.build)?;
        self.has_ended = said.is_end;
        self.act(line, said)
    }

    /// What stands after the end: LinuxCNC reads no more of it; other controls may go on with another program.
    fn after_end(&self, text: &[u8]) -> Result<Action, Refusal> {
        let dialect = self.options.dialect;
        let found = match dialect {
            Dialect::Linuxcnc | Dialect::Heidenhain => Ok(Line::default()),
            _ => lexer::line(text, dialect),
        };
        let column = match found {
            // Blocks between M30 and END PGM are subprograms, and what calls them is refused.
            _ if dialect == Dialect::Heidenhain => crate::klartext::begins(text).then_some(0),
            Ok(line) => line.words.first().map(|word| word.span.start),
            Err(refusal) => Some(refusal.column),
        };
        match column {
            Some(column) => {
                let help = "correct each program in a file of its own";
                Err(Refusal::new(
                    column,
                    "",
                    "a block after the end of the program: another program, or a subprogram",
                    help,
                ))
            }
            None => Ok(Action::Copy(None)),
        }
    }

    fn klartext_line(&mut self, text: &[u8]) -> Result<Action, Refusal> {
        let Some(mut program) = self.klartext.take() else { return Ok(Action::Copy(None)) };
        let action = program.line(text, self);
        self.has_ended = program.has_ended;
        self.klartext = Some(program);
        action
    }

    /// Whether the switch of the control leaves a block out that has a `/` at this place.
    pub(crate) fn is_left_out(&self, optional: Option<usize>) -> Result<bool, Refusal> {
        let runs_always = self.options.dialect.always_runs_optional_blocks();
        match (optional, self.options.block_delete.or(runs_always.then_some(false))) {
            (None, _) => Ok(false),
            (Some(column), Some(true)) if runs_always => {
                let what = "a block that this control runs whatever a switch says";
                let help = "leave out `--block-delete on`, or take these blocks out of the program";
                Err(Refusal::new(column, "/", what, help))
            }
            (_, Some(is_on)) => Ok(is_on),
            (Some(column), None) => {
                let what = "a block that a switch of the control leaves out";
                let help = "say how the switch stands: `--block-delete on` or `off`";
                Err(Refusal::new(column, "/", what, help))
            }
        }
    }

    fn act(&mut self, line: Line, said: Said) -> Result<Action, Refusal> {
        let motion = said.motion_word.and(self.modal.motion);
        let names_axis = line.words.iter().any(|word| place(word.letter).is_some());
        match said.special {
            Special::Dwell => {
                // Where X is how long it dwells, nothing else moves.
                let is_time = |word: &Word| {
                    self.options.dialect.has_program_numbers() && motion.is_none() && b"XU".contains(&word.letter)
                };
                let moved = line.words.iter().find(|word| place(word.letter).is_some() && !is_time(word));
                return match moved {
                    Some(word) => Err(refused(word, "a position beside a dwell", APART)),
                    None => Ok(Action::Copy(motion)),
                };
            }
            Special::Names => {
                let named = line.words.iter().find(|word| place(word.letter).is_some());
                return match named.filter(|_| motion.is_some()) {
                    Some(word) => Err(refused(word, "a position, or the name of an axis of another code", APART)),
                    None => Ok(Action::Copy(motion)),
                };
            }
            Special::SetSystem | Special::Shift => {
                self.modal.set_offsets(said.special, &line, self.options)?;
                return Ok(Action::Copy(motion));
            }
            Special::Home => {
                let moved = if names_axis { named(&line) } else { [true; 9] };
                (0..9).filter(|axis| moved[*axis]).for_each(|axis| self.modal.at[axis] = None);
                self.modal.leaves_length(moved[2], self.options);
                return Ok(self.jump(motion, true, Moved::to(moved)));
            }
            Special::MachineBlock => {
                self.machine_block(&line)?;
                self.modal.leaves_length(named(&line)[2], self.options);
                return Ok(self.jump(motion, true, Moved::to(named(&line))));
            }
            Special::ToolChange => {
                // Where the control drives to for it, and whether it comes back, is not in the program.
                if let Some(word) = line.words.iter().find(|word| place(word.letter).is_some()) {
                    let help = "write M6 in a block of its own; or say `--tool-change stays` if no axis moves for it";
                    return Err(refused(word, "a move beside a change of the tool", help));
                }
                self.modal.at = [None; 9];
                return Ok(self.jump(motion, false, [Moved::To; 9]));
            }
            Special::None => {}
        }
        let is_arc = self.modal.motion.is_some_and(Motion::is_arc);
        let has_centre = line.words.iter().any(|word| b"IJK".contains(&word.letter));
        self.check_letters(&line, is_arc)?;
        match (names_axis || is_arc && has_centre, self.modal.motion) {
            (false, _) => Ok(Action::Copy(motion)),
            (true, Some(motion)) => self.motion(line, said, motion),
            (true, None) => match line.words.iter().find(|word| place(word.letter).is_some()) {
                Some(word) => Err(refused(word, "no motion code stands before it", "write G0 or G1")),
                None => Ok(Action::Copy(None)),
            },
        }
    }

    pub(crate) fn jump(&self, motion: Option<Motion>, is_rapid: bool, moved: [Moved; 9]) -> Action {
        Action::Jump { at: self.modal.at, moved: Box::new(moved), space: self.modal.space, motion, is_rapid }
    }

    pub(crate) fn machine_block(&mut self, line: &Line) -> Result<(), Refusal> {
        for word in &line.words {
            let Some(axis) = place(word.letter) else { continue };
            self.check_axis(word, axis)?;
            if self.modal.space == Space::Workpiece {
                let help = "switch the tool centre point off before";
                return Err(refused(word, "a position of the machine while the tip is programmed", help));
            }
            if self.modal.relative || word.sense == Sense::Relative {
                return Err(refused(word, "a relative position in machine coordinates", "write G90"));
            }
            // Whether a SINUMERIK leaves the length of the tool out here is a machine datum (10760, G53_TOOLCORR).
            let is_open = self.options.dialect.is_siemens() && self.modal.length.is_some() && axis < 3;
            self.modal.at[axis] = (!is_open).then(|| word.value * self.modal.unit(axis));
        }
        Ok(())
    }

    fn check_axis(&self, word: &Word, axis: usize) -> Result<(), Refusal> {
        if !self.modal.machine.has(axis) {
            let help = "the calibration is that of another machine, or the axis is not in its model";
            return Err(refused(word, "an axis that the machine of the calibration does not have", help));
        }
        self.check_point(word)
    }

    fn check_point(&self, word: &Word) -> Result<(), Refusal> {
        if self.options.dialect.needs_points() && !self.options.integers_are_mm && !word.has_point && word.value != 0.0
        {
            let help = "write a point, or say `--integers-are-mm` if the control counts so";
            return Err(refused(word, "a number without a point is micrometres on some of these controls", help));
        }
        Ok(())
    }

    fn check_letters(&self, line: &Line, is_arc: bool) -> Result<(), Refusal> {
        let has_other = line.words.iter().any(|word| {
            word.letter == b'M'
                || word.letter == b'G' && WITH_NUMBERS.iter().any(|code| (word.value - code).abs() < 1e-6)
        });
        for word in &line.words {
            let is_known = match word.letter {
                b'I' | b'J' | b'K' | b'R' => is_arc,
                b'P' | b'Q' | b'L' | b'E' => has_other,
                b'N' | b'O' | b'@' => false,
                0 if word.name == "CR" => is_arc,
                _ => true,
            };
            if !is_known {
                return Err(refused(
                    word,
                    "a word that is not known here",
                    "leave it out, or write it in a block that needs it",
                ));
            }
        }
        Ok(())
    }

    pub(crate) fn motion(&mut self, line: Line, said: Said, motion: Motion) -> Result<Action, Refusal> {
        self.check_length(&line, motion)?;
        let offset = self.modal.offset();
        let (mut target, mut named) = (self.modal.at, [false; 9]);
        let mut moved = [Moved::No; 9];
        for word in &line.words {
            let Some(axis) = place(word.letter) else { continue };
            self.check_axis(word, axis)?;
            named[axis] = true;
            let value = word.value * self.modal.unit(axis);
            let relative = match word.sense {
                Sense::Modal => self.modal.relative,
                Sense::Relative => true,
                Sense::Absolute => false,
                Sense::Shortest if self.modal.machine.travel(axis).is_some() => false,
                Sense::Shortest => {
                    return Err(refused(word, "the shorter way of an axis without ends", "write the position itself"));
                }
            };
            moved[axis] = if relative { Moved::By(value) } else { Moved::To };
            target[axis] = match (relative, self.modal.at[axis]) {
                (false, _) => Some(value + offset[axis]),
                (true, Some(at)) => Some(at + value),
                (true, None) => return Err(refused(word, "a relative move from a position that is not known", START)),
            };
            self.check_travel(word, axis, target[axis])?;
            self.check_way(word, axis, target[axis], relative)?;
        }
        let places: Vec<usize> = self.modal.machine.places().collect();
        let start_known = places.iter().all(|axis| self.modal.at[*axis].is_some());
        if let Some(unknown) = places.iter().find(|axis| target[**axis].is_none()) {
            self.modal.at = target;
            if motion == Motion::Rapid {
                return Ok(self.jump(said.motion_word.and(Some(motion)), true, moved));
            }
            let what = format!("a move in feed while the position of {} is not known", letter(*unknown));
            return Err(first(&line, &what, START));
        }
        if motion != Motion::Rapid && !start_known {
            return Err(first(&line, "a move in feed from a position that is not known", START));
        }
        let to = target.map(|at| at.unwrap_or(0.0));
        let from = if start_known { self.modal.at.map(|at| at.unwrap_or(0.0)) } else { to };
        let mut path = Path { from, to, arc: None };
        if motion.is_arc() {
            path.arc = Some(self.arc(&line, &path, motion, &offset)?);
        }
        let feed = line.words.iter().position(|word| word.letter == b'F');
        let inverse_feed = match (self.modal.inverse && motion != Motion::Rapid, feed) {
            (false, _) => None,
            (true, Some(index)) => {
                self.inverse_meaning(&line.words[index])?;
                Some((line.words[index].value, index))
            }
            (true, None) => return Err(first(&line, "every block under G93 needs its own F", "write its F")),
        };
        self.modal.at = target;
        Ok(Action::Move(Box::new(Move {
            motion,
            space: self.modal.space,
            machine: Rc::clone(&self.modal.machine),
            path,
            has_start: start_known,
            named,
            offset,
            relative: self.modal.relative,
            arc_absolute: self.modal.arc_absolute,
            inches: self.modal.inches,
            inverse_feed,
            motion_word: said.motion_word,
            late: said.late,
            line,
        })))
    }

    /// Refuses turns whose sense the control chooses: more than half a turn of an axis without ends, or by the shorter way.
    fn check_way(&self, word: &Word, axis: usize, target: Option<f64>, relative: bool) -> Result<(), Refusal> {
        let (Some(from), Some(to)) = (self.modal.at[axis], target) else { return Ok(()) };
        if relative || !is_rotary(axis) || (to - from).abs() <= 180.0 {
            return Ok(());
        }
        let help = "write it in smaller turns, or relative";
        if self.modal.machine.is_endless(axis) {
            return Err(refused(word, "more than half a turn of an axis without ends, which way is not known", help));
        }
        if word.sense == Sense::Shortest || self.modal.takes_shorter_way {
            let what = "the shorter way is not the one between the ends of this axis: has it ends?";
            return Err(refused(word, what, help));
        }
        Ok(())
    }

    /// Refuses cuts, and moves along the tool, while it is not known which length acts.
    fn check_length(&self, line: &Line, motion: Motion) -> Result<(), Refusal> {
        let is_siemens = self.options.dialect.is_siemens();
        let [i, j] = self.modal.plane;
        if is_siemens && [i, j] != [0, 1] && self.modal.space == Space::Joints && self.modal.length.is_some() {
            let axis = letter(3 - i - j);
            let what =
                format!("the length of the tool acts along {axis} in this plane; a calibration has the tool along Z");
            return Err(first(line, &what, "write the arc as lines in G17, or D0 before it"));
        }
        let Some(what) = &self.modal.open_length else { return Ok(()) };
        let names_it = line.words.iter().any(|word| word.letter == b'Z');
        if motion == Motion::Rapid && (!names_it || self.options.dialect == Dialect::Linuxcnc) {
            return Ok(());
        }
        let help = if is_siemens { "write D1 after it" } else { "write G43 with its H, or G49" };
        Err(first(line, what, help))
    }

    fn inverse_meaning(&self, word: &Word) -> Result<(), Refusal> {
        let known =
            self.options.inverse_is_seconds.is_some() || self.options.dialect.counts_inverse_minutes().is_some();
        if !known {
            let help = "say which: `--inverse-time minutes` or `seconds`";
            return Err(refused(word, "F under G93 is 1/minutes on some controls, and seconds on others", help));
        }
        Ok(())
    }

    fn check_travel(&self, word: &Word, axis: usize, target: Option<f64>) -> Result<(), Refusal> {
        let (Some(target), Some([from, to])) = (target, self.modal.machine.travel(axis)) else { return Ok(()) };
        let is_joint = self.modal.space == Space::Joints || is_rotary(axis);
        let more = 1e-9 * (to - from);
        if is_joint && !self.modal.machine.ignores_travel() && !(from - more..=to + more).contains(&target) {
            let what = format!("it brings {} to {target}, beyond its travel of {from} to {to}", letter(axis));
            return Err(refused(word, &what, "is `--offset` that of the machine? else `--travel allow`"));
        }
        Ok(())
    }

    fn arc(&self, line: &Line, path: &Path, motion: Motion, offset: &Coordinates) -> Result<Arc, Refusal> {
        let plane = self.modal.plane;
        let clockwise = motion == Motion::Clockwise;
        let in_plane = |at: &Coordinates| [at[plane[0]], at[plane[1]]];
        let (from, to) = (in_plane(&path.from), in_plane(&path.to));
        let of_siemens = || line.words.iter().find(|word| word.name == "CR");
        let radius = line.words.iter().find(|word| word.letter == b'R').or_else(of_siemens);
        let centres: Vec<&Word> = line.words.iter().filter(|word| b"IJK".contains(&word.letter)).collect();
        let centre = match (radius, centres.first()) {
            (Some(word), None) => {
                self.check_point(word)?;
                let radius = word.value * self.modal.unit(0);
                centre_of_radius(from, to, radius, clockwise).ok_or_else(|| {
                    let what = "the radius is shorter than half the distance from start to end, or these are one point";
                    refused(word, what, "correct the radius, or write the centre: I J K")
                })?
            }
            (None, Some(_)) => {
                let mut centre = if self.modal.arc_absolute { plane.map(|axis| offset[axis]) } else { from };
                for word in centres {
                    self.check_point(word)?;
                    let axis = usize::from(word.letter - b'I');
                    let Some(own) = plane.iter().position(|place| *place == axis) else {
                        if word.value == 0.0 {
                            continue;
                        }
                        return Err(refused(word, "it is not in the plane of the arc", "is G17, G18 or G19 right?"));
                    };
                    let value = word.value * self.modal.unit(axis);
                    centre[own] = match word.sense {
                        Sense::Absolute => offset[axis] + value,
                        _ => centre[own] + value,
                    };
                }
                let distance = |point: [f64; 2]| (point[0] - centre[0]).hypot(point[1] - centre[1]);
                let (first_radius, last_radius) = (distance(from), distance(to));
                if (first_radius - last_radius).abs() > OFF_CIRCLE || first_radius < 1e-6 {
                    let off = (first_radius - last_radius).abs();
                    let what = format!("the end of the arc is off its circle by {off:.4} mm");
                    return Err(first(line, &what, "correct the centre or the end"));
                }
                centre
            }
            (Some(word), Some(_)) => {
                return Err(refused(word, "an arc with a radius and a centre", "leave one of them out"));
            }
            (None, None) => return Err(first(line, "an arc without a centre or a radius", "write I J K or R")),
        };
        if let Some(word) = line.words.iter().find(|word| word.letter == b'P' && word.value != 1.0) {
            return Err(refused(word, "an arc of several turns", "write each turn as a block"));
        }
        Ok(Arc { plane, centre, sweep: sweep(from, to, centre, clockwise) })
    }
}

/// Codes that have numbers of their own besides those of axes: P, Q, L or E.
const WITH_NUMBERS: [f64; 4] = [5.1, 8.0, 61.0, 64.0];

/// Farthest that the end of an arc may be from its circle, mm.
const OFF_CIRCLE: f64 = 0.01;

const APART: &str = "write the motion in a block of its own";

const START: &str = "say where the axes stand: `--start X0,Y0,Z0`, or begin with a rapid move that names all axes; after M6 or TOOL CALL, which may \
                     move them, such a move is needed too, or `--tool-change stays`";

/// The axes that a block names.
pub(crate) fn named(line: &Line) -> [bool; 9] {
    let mut named = [false; 9];
    line.words.iter().filter_map(|word| place(word.letter)).for_each(|axis| named[axis] = true);
    named
}

/// A refusal of a whole block, at the word of its motion.
fn first(line: &Line, what: &str, help: &str) -> Refusal {
    let own = |word: &&Word| place(word.letter).is_some() || b"IJKR".contains(&word.letter);
    match line.words.iter().find(own).or(line.words.first()) {
        Some(word) => refused(word, what, help),
        None => Refusal::new(0, "", what, help),
    }
}
