//! The modal state of a control, and what a block changes of it.

mod length;

use std::rc::Rc;

use crate::dialect::{Meaning, code_name, meaning, meaning_of_name};
use crate::geometry::{Coordinates, LETTERS, place};
use crate::lexer::{Line, Word};
use crate::machine::{Machine, Space};
use crate::options::Options;
use crate::refusal::Refusal;

/// The motion of a block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Motion {
    Rapid,
    Feed,
    Clockwise,
    CounterClockwise,
}

impl Motion {
    /// The number of its code.
    pub(crate) fn code(self) -> u8 {
        match self {
            Self::Rapid => 0,
            Self::Feed => 1,
            Self::Clockwise => 2,
            Self::CounterClockwise => 3,
        }
    }

    pub(crate) fn is_arc(self) -> bool {
        matches!(self, Self::Clockwise | Self::CounterClockwise)
    }
}

/// Builds the machine with a tool of a length; that of the calibration if none is given.
pub type MachineOf<'a> = dyn Fn(Option<f64>) -> abbe_core::Result<Machine> + 'a;

/// The state of a control.
pub(crate) struct Modal {
    pub(crate) motion: Option<Motion>,
    pub(crate) plane: [usize; 2],
    pub(crate) relative: bool,
    pub(crate) arc_absolute: bool,
    pub(crate) inches: bool,
    pub(crate) inverse: bool,
    pub(crate) system: Option<usize>,
    systems: [Coordinates; 9],
    /// Systems whose offsets are known.
    known: [bool; 9],
    pub(crate) shift: Coordinates,
    tool: Option<u32>,
    next_tool: Option<u32>,
    pub(crate) length: Option<f64>,
    /// Whether a D came after the last T (SINUMERIK).
    has_edge: bool,
    /// Why it is not known which length acts, after a change of the tool.
    pub(crate) open_length: Option<String>,
    /// Whether rotary axes take the shorter way (M126).
    pub(crate) takes_shorter_way: bool,
    pub(crate) space: Space,
    /// Where the axes stand, in `space`.
    pub(crate) at: [Option<f64>; 9],
    pub(crate) machine: Rc<Machine>,
    /// Work offsets that were taken to be zero.
    pub(crate) assumed: Vec<usize>,
    /// Whether the program has said its unit, and whether its numbers are absolute.
    pub(crate) has_unit: bool,
    pub(crate) has_distance: bool,
    /// Whether the program has named a work offset, or that none acts; and whether one acts that it has not named.
    has_system: bool,
    pub(crate) uses_unnamed_system: bool,
}

/// What a block asks for besides its modal codes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Special {
    None,
    Dwell,
    Names,
    Home,
    SetSystem,
    Shift,
    MachineBlock,
    ToolChange,
}

/// What a block says.
pub(crate) struct Said {
    pub(crate) special: Special,
    /// The word of its motion.
    pub(crate) motion_word: Option<usize>,
    /// The program ends with it.
    pub(crate) is_end: bool,
    /// Words that have to stay with the end of the motion.
    pub(crate) late: Vec<usize>,
}

const MULTIPLE: &str = "write one of them in a block of its own";

impl Modal {
    pub(crate) fn new(machine: Rc<Machine>, options: &Options) -> Self {
        let mut systems = [[0.0; 9]; 9];
        let mut known = [false; 9];
        for (index, offset) in &options.offsets {
            if let Some(system) = systems.get_mut(*index) {
                (*system, known[*index]) = (*offset, true);
            }
        }
        Self {
            motion: None,
            plane: [0, 1],
            relative: false,
            arc_absolute: false,
            inches: false,
            inverse: false,
            system: Some(0),
            systems,
            known,
            shift: [0.0; 9],
            tool: None,
            next_tool: None,
            length: None,
            has_edge: false,
            open_length: None,
            takes_shorter_way: false,
            space: Space::Joints,
            at: options.start,
            machine,
            assumed: Vec::new(),
            has_unit: false,
            has_distance: false,
            has_system: false,
            uses_unnamed_system: false,
        }
    }

    /// What is added to coordinates of the program.
    pub(crate) fn offset(&mut self) -> Coordinates {
        let mut offset = self.shift;
        if let Some(system) = self.system {
            self.uses_unnamed_system |= !self.has_system;
            if !self.known[system] && !self.assumed.contains(&system) {
                self.assumed.push(system);
            }
            (0..9).for_each(|axis| offset[axis] += self.systems[system][axis]);
        }
        if self.space == Space::Joints {
            offset[2] += self.length.unwrap_or(0.0);
        }
        offset
    }

    /// Factor from the numbers of the program to mm.
    pub(crate) fn unit(&self, axis: usize) -> f64 {
        if self.inches && !crate::geometry::is_rotary(axis) { 25.4 } else { 1.0 }
    }

    /// Carries out all of a block but its motion.
    pub(crate) fn carry_out(&mut self, line: &Line, options: &Options, build: &MachineOf<'_>) -> Result<Said, Refusal> {
        let mut said = Said { special: Special::None, motion_word: None, is_end: false, late: Vec::new() };
        check_twice(line)?;
        let (mut groups, mut length, mut centre) = (Vec::new(), None, None);
        for (index, word) in line.words.iter().enumerate() {
            let meaning = match word.letter {
                b'G' => {
                    let (group, meaning) = code(word, options)?;
                    if group != 0 && groups.contains(&group) {
                        return Err(refused(word, "two codes of one modal group in a block", MULTIPLE));
                    }
                    groups.push(group);
                    meaning
                }
                b'M' => {
                    self.auxiliary(word, index, options, &mut said)?;
                    continue;
                }
                b'T' if word.value.is_nan() => continue,
                b'T' => {
                    self.next_tool = Some(word.value as u32);
                    if options.dialect.is_siemens() {
                        (self.tool, self.has_edge) = (self.next_tool, false);
                    }
                    continue;
                }
                b'D' if options.dialect.is_siemens() => {
                    if word.value > 1.0 && options.tools.only.is_none() {
                        let help = "give one length for all tools: `--tool-length-mm`";
                        return Err(refused(
                            word,
                            "a table of lengths has the first cutting edge of a tool alone",
                            help,
                        ));
                    }
                    (length, self.has_edge) = (Some((word, word.value != 0.0)), true);
                    continue;
                }
                0 => siemens_name(word)?,
                _ => continue,
            };
            let special = |said: &mut Said, special| match said.special {
                Special::None => {
                    said.special = special;
                    Ok(())
                }
                _ => Err(refused(word, "two codes that take the numbers of a block", MULTIPLE)),
            };
            match meaning {
                Meaning::Rapid => self.begin(Motion::Rapid, index, &mut said),
                Meaning::Feed => self.begin(Motion::Feed, index, &mut said),
                Meaning::Arc { clockwise: true } => self.begin(Motion::Clockwise, index, &mut said),
                Meaning::Arc { clockwise: false } => self.begin(Motion::CounterClockwise, index, &mut said),
                Meaning::Plane(plane) => self.plane = plane,
                Meaning::Inches(inches) => (self.inches, self.has_unit) = (inches, true),
                Meaning::Relative(relative) => (self.relative, self.has_distance) = (relative, true),
                Meaning::ArcAbsolute(absolute) => self.arc_absolute = absolute,
                Meaning::FeedPerTime => self.inverse = false,
                Meaning::InverseTime => self.inverse = true,
                Meaning::System(system) => (self.system, self.has_system) = (system, true),
                Meaning::ToolLength => length = Some((word, true)),
                Meaning::ToolLengthOff => {
                    length = Some((word, false));
                    if options.dialect.has_program_numbers() {
                        centre = Some((word, false));
                    }
                }
                Meaning::ToolCentre(on) => {
                    centre = Some((word, on));
                    // SINUMERIK takes the tool that is active; with one length for all tools it need not be called before.
                    let has_length =
                        options.dialect.is_siemens() && (self.length.is_some() || options.tools.only.is_none());
                    if on && !has_length {
                        length = Some((word, true));
                    }
                }
                Meaning::MachineBlock => special(&mut said, Special::MachineBlock)?,
                Meaning::Home => special(&mut said, Special::Home)?,
                Meaning::SetSystem => special(&mut said, Special::SetSystem)?,
                Meaning::Shift => special(&mut said, Special::Shift)?,
                Meaning::Dwell => special(&mut said, Special::Dwell)?,
                Meaning::Names => special(&mut said, Special::Names)?,
                Meaning::NoShift => self.shift = [0.0; 9],
                Meaning::Keep => {}
                Meaning::Refuse(what, help) => return Err(refused(word, what, help)),
            }
        }
        if let (None, Some(word)) = (length, line.words.iter().find(|word| word.letter == b'H'))
            && options.dialect.has_program_numbers()
            && self.length.is_some()
        {
            let help = "write G43 with it, or G49 for H0";
            return Err(refused(
                word,
                "an H alone, which changes the length of the tool on some of these controls",
                help,
            ));
        }
        // The length counts where tips are computed: first off, or on.
        if let Some((word, false)) = centre {
            self.set_centre(false, word)?;
        }
        if let Some((word, on)) = length {
            self.set_length(word, on, line, options, build)?;
        }
        if let Some((word, true)) = centre {
            self.set_centre(true, word)?;
        }
        Ok(said)
    }

    fn begin(&mut self, motion: Motion, index: usize, said: &mut Said) {
        self.motion = Some(motion);
        said.motion_word = Some(index);
    }

    fn auxiliary(&mut self, word: &Word, index: usize, options: &Options, said: &mut Said) -> Result<(), Refusal> {
        use crate::dialect::Dialect;
        let linuxcnc = options.dialect == Dialect::Linuxcnc;
        match word.value as u32 {
            6 => {
                self.tool = self.next_tool;
                self.open_length = self.left_open(options);
                if !options.stays_at_tool_change {
                    if said.special != Special::None {
                        return Err(refused(word, "a change of the tool beside another code", MULTIPLE));
                    }
                    said.special = Special::ToolChange;
                }
            }
            97..=99 | 198 => {
                return Err(refused(word, "a subprogram, which is called from several places", "write out its moves"));
            }
            70..=73 if linuxcnc => {
                return Err(refused(word, "it saves or restores a state that is not followed", "write the codes out"));
            }
            428..=430 if linuxcnc => {
                return Err(refused(word, "it switches the kinematics", "correct programs for joints"));
            }
            0 | 1 | 60 => said.late.push(index),
            2 | 30 => {
                said.late.push(index);
                said.is_end = true;
            }
            17 if options.dialect.is_siemens() => {
                said.late.push(index);
                said.is_end = true;
            }
            5 | 9 if options.dialect.stops_late() => said.late.push(index),
            _ => {}
        }
        Ok(())
    }

    /// Switches between positions of the axes and of the tip.
    pub(crate) fn set_centre(&mut self, on: bool, word: &Word) -> Result<(), Refusal> {
        let space = if on { Space::Workpiece } else { Space::Joints };
        if space == self.space {
            return Ok(());
        }
        if on && self.length.is_none() {
            let help = "give it: `--tools tool.tbl`, or `--tool-length-mm`, and a tool in the program";
            return Err(refused(word, "the tip is programmed, and the length of the tool is not known", help));
        }
        let is_known = |axis: usize| self.at[axis].is_some();
        let here = self.at.map(|at| at.unwrap_or(0.0));
        let all = self.machine.places().all(is_known);
        let is_upright = self.machine.places().filter(|axis| *axis >= 3).all(|axis| self.at[axis] == Some(0.0));
        let failed = |error: abbe_core::Error| refused(word, &error.message, "does the machine have X, Y and Z?");
        let rise = if on { -1.0 } else { 1.0 } * self.length.unwrap_or(0.0);
        if all {
            let found = match on {
                true => self.machine.on_workpiece(&here),
                false => {
                    let point = crate::machine::Point { at: here, directions: [1.0; 9] };
                    self.machine.joints(Space::Workpiece, &[point]).map(|found| found[0])
                }
            };
            let found = found.map_err(failed)?;
            (0..3).filter(|axis| self.machine.has(*axis)).for_each(|axis| self.at[axis] = Some(found[axis]));
        } else if is_upright {
            self.at[2] = self.at[2].map(|at| at + rise);
        } else {
            self.at[..3].fill(None);
        }
        self.space = space;
        Ok(())
    }

    /// Carries out `G10 L2`, or `G52`.
    pub(crate) fn set_offsets(&mut self, special: Special, line: &Line, options: &Options) -> Result<(), Refusal> {
        let value = |letter: u8| line.words.iter().find(|word| word.letter == letter);
        let first = line.words.iter().find(|word| word.letter == b'G');
        let of_block = |what: &str, help: &str| match first {
            Some(word) => refused(word, what, help),
            None => Refusal::new(0, "", what, help),
        };
        let system = match special {
            Special::Shift => None,
            _ => {
                let is_plain = value(b'L').is_some_and(|word| word.value == 2.0) && value(b'R').is_none();
                let number = value(b'P').map(|word| word.value).filter(|number| (0.0..=9.0).contains(number));
                match number {
                    Some(0.0) if is_plain && options.dialect.has_external_offset() => {
                        let help = "write P1 to P6, or say it by `--offset`";
                        return Err(of_block("`G10 L2 P0` is an offset that acts on top of the others", help));
                    }
                    Some(number) if is_plain && !self.relative => match number as usize {
                        0 => self.system,
                        number => Some(number - 1),
                    },
                    _ => {
                        return Err(of_block(
                            "only `G10 L2 P1` to `P9` in G90, without R, are followed",
                            "write the offset so",
                        ));
                    }
                }
            }
        };
        for word in &line.words {
            let Some(axis) = place(word.letter) else { continue };
            let value = word.value * self.unit(axis);
            match system {
                Some(system) => (self.systems[system][axis], self.known[system]) = (value, true),
                None => self.shift[axis] = value,
            }
        }
        Ok(())
    }
}

/// The group and the meaning of a G-code.
fn code(word: &Word, options: &Options) -> Result<(u8, Meaning), Refusal> {
    let number = word.value * 10.0;
    let unknown = || refused(word, "a code that is not known", "see docs/programs.md for those that are");
    if !(0.0..10_000.0).contains(&number) || (number - number.round()).abs() > 1e-6 {
        return Err(unknown());
    }
    meaning(options.dialect, number.round() as u16).ok_or_else(unknown)
}

fn siemens_name(word: &Word) -> Result<Meaning, Refusal> {
    let numbered = |prefix: char| {
        word.name
            .strip_prefix(prefix)
            .is_some_and(|rest| !rest.is_empty() && rest.bytes().all(|byte| byte.is_ascii_digit()))
    };
    if word.name == "CR" || numbered('M') || numbered('S') || numbered('H') {
        return Ok(Meaning::Keep);
    }
    if numbered('R') {
        return Err(refused(word, "a variable, whose value is known to the control alone", "write out its value"));
    }
    match meaning_of_name(&word.name) {
        Meaning::Refuse(what, help) => Err(refused(word, what, help)),
        known => Ok(known),
    }
}

/// Refuses a letter that stands twice.
fn check_twice(line: &Line) -> Result<(), Refusal> {
    for (index, word) in line.words.iter().enumerate() {
        let again = |other: &Word| other.letter == word.letter && other.name == word.name;
        if ![b'G', b'M'].contains(&word.letter) && line.words[..index].iter().any(again) {
            return Err(refused(word, "a letter that stands twice in a block", "leave one of them out"));
        }
    }
    Ok(())
}

/// A refusal of a word.
pub(crate) fn refused(word: &Word, what: &str, help: &str) -> Refusal {
    let shown = match word.letter {
        b'G' if word.value >= 0.0 && word.value < 6000.0 => code_name((word.value * 10.0).round() as u16),
        0 => word.name.clone(),
        letter => format!("{}{}", char::from(letter), word.value),
    };
    Refusal::new(word.span.start, &shown, what, help)
}

/// The letter of a place.
pub(crate) fn letter(place: usize) -> char {
    char::from(LETTERS[place])
}
