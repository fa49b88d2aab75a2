//! Blocks from the commands that LinuxCNC's interpreter prints.

use super::{DIGIT, NO_LENGTH, UNKNOWN};
use crate::geometry::{LETTERS, is_rotary};
use crate::options::Options;
use crate::tools::Tools;

/// Axes that are printed: X Y Z A B C.
const AXES: usize = 6;

/// Makes blocks of canonical commands: absolute coordinates, centres absolute, an axis where it moves.
pub struct Canonical {
    tools: Tools,
    /// Factor from what is printed to mm.
    unit: f64,
    /// The work offset that acts, and those of all systems, mm and degrees.
    system: usize,
    systems: [[f64; AXES]; 9],
    tool: Option<u32>,
    /// Length of the tool that acts, mm.
    length: f64,
    /// Where the axes stand, machine coordinates.
    at: [f64; AXES],
    is_rapid: Option<bool>,
    plane: [usize; 2],
    /// The feed as it is printed, until a block has it.
    feed: Option<String>,
    per_turn: bool,
    /// How far the path may be from the blocks (`G64 P`), as it is printed.
    rounding: String,
    /// Mist and flood.
    coolant: [bool; 2],
    ends_with_shuttle: bool,
    has_ended: bool,
    has_begun: bool,
    /// Lines of the program from which the written ones come.
    lines: Vec<u32>,
}

type Outcome<T> = Result<T, String>;

impl Canonical {
    /// At the start of a program.
    pub fn new(options: &Options) -> Self {
        let mut systems = [[0.0; AXES]; 9];
        for (system, offset) in &options.offsets {
            systems[*system].copy_from_slice(&offset[..AXES]);
        }
        Self {
            tools: options.tools.clone(),
            unit: 1.0,
            system: 0,
            systems,
            tool: None,
            length: 0.0,
            at: [0, 1, 2, 3, 4, 5].map(|axis| options.start[axis].unwrap_or(UNKNOWN)),
            is_rapid: None,
            plane: [0, 1],
            feed: None,
            per_turn: false,
            rounding: String::new(),
            coolant: [false; 2],
            ends_with_shuttle: false,
            has_ended: false,
            has_begun: false,
            lines: Vec::new(),
        }
    }

    /// Whether the program has come to its end.
    pub fn has_ended(&self) -> bool {
        self.has_ended
    }

    /// The line of the program from which a written line comes; lines count from 1.
    pub fn line_of(&self, written: usize) -> Option<usize> {
        self.lines.get(written.checked_sub(1)?).map(|line| *line as usize).filter(|line| *line > 0)
    }

    /// Appends what a printed line comes to.
    ///
    /// Fails, with what it is, for a command that is no motion of axes and nothing that a block can say.
    pub fn line(&mut self, text: &str, out: &mut Vec<u8>) -> Outcome<()> {
        let Some((number, name, arguments)) = command(text) else {
            return Err(format!("`{}` is no command of LinuxCNC's interpreter", text.trim()));
        };
        // What it prints of itself before the program, and of the line that brings axes to where they stand.
        if number.is_none_or(|number| number == 0) {
            return match name {
                "SET_G5X_OFFSET" => self.begin(out),
                _ => Ok(()),
            };
        }
        let number = number.unwrap_or_default();
        let arguments: Vec<&str> = arguments.split([',', ' ']).filter(|part| !part.is_empty()).collect();
        let block = self.block(name, &arguments)?;
        for block in block.into_iter().filter(|block| !block.is_empty()) {
            let is_move = block.starts_with("G0") || block.starts_with("G1 ") || block.contains('I');
            let text = if is_move { format!("N{number} {block}\n") } else { format!("{block}\n") };
            out.extend_from_slice(text.as_bytes());
            self.lines.push(number);
        }
        Ok(())
    }

    /// The state in which blocks are written.
    fn begin(&mut self, out: &mut Vec<u8>) -> Outcome<()> {
        if !std::mem::replace(&mut self.has_begun, true) {
            out.extend_from_slice(b"G21 G90 G90.1 G17 G94\n");
            self.lines.push(0);
        }
        Ok(())
    }

    /// The blocks of a command.
    fn block(&mut self, name: &str, arguments: &[&str]) -> Outcome<Vec<String>> {
        let numbers = || -> Outcome<Vec<f64>> {
            let read = arguments.iter().map(|text| text.parse::<f64>());
            read.collect::<Result<_, _>>().map_err(|_| format!("`{name}` with what are no numbers"))
        };
        let one = |text: String| Ok(vec![text]);
        let none = || Ok(Vec::new());
        match name {
            "STRAIGHT_TRAVERSE" => self.straight(true, arguments, &numbers()?),
            "STRAIGHT_FEED" => self.straight(false, arguments, &numbers()?),
            "ARC_FEED" => self.arc(arguments, &numbers()?),
            "USE_LENGTH_UNITS" => self.units(arguments),
            "SELECT_PLANE" => {
                let (plane, code) = match arguments {
                    ["CANON_PLANE_XY"] => ([0, 1], "G17"),
                    ["CANON_PLANE_XZ"] => ([2, 0], "G18"),
                    ["CANON_PLANE_YZ"] => ([1, 2], "G19"),
                    _ => return Err(format!("the plane {}", arguments.join(" "))),
                };
                self.plane = plane;
                one(code.to_owned())
            }
            "SET_G5X_OFFSET" => self.offset(&numbers()?),
            "SET_G92_OFFSET" if numbers()?.iter().all(|number| *number == 0.0) => none(),
            "SET_G92_OFFSET" => {
                Err("an origin where the axes stand (G92), and they stand at corrected positions".to_owned())
            }
            "SET_XY_ROTATION" if numbers()?.iter().all(|number| *number == 0.0) => none(),
            "SET_XY_ROTATION" => Err("coordinates that are rotated".to_owned()),
            "USE_TOOL_LENGTH_OFFSET" => self.tool_length(&numbers()?),
            "SET_FEED_RATE" => {
                self.feed = arguments
                    .first()
                    .filter(|_| numbers().is_ok_and(|feed| feed[0] > 0.0))
                    .map(|feed| (*feed).to_owned());
                none()
            }
            "SET_FEED_MODE" => {
                let per_turn = numbers()?.get(1) == Some(&1.0);
                match std::mem::replace(&mut self.per_turn, per_turn) == per_turn {
                    true => none(),
                    false => one(if per_turn { "G95" } else { "G94" }.to_owned()),
                }
            }
            "SELECT_TOOL" => {
                self.tool = numbers()?.first().map(|number| *number as u32);
                one(format!("T{}", self.tool.unwrap_or(0)))
            }
            "CHANGE_TOOL" => one("M6".to_owned()),
            "DWELL" => one(format!("G4 P{}", arguments.first().unwrap_or(&"0"))),
            "PROGRAM_STOP" if self.ends_with_shuttle => Err("an exchange of pallets (M60)".to_owned()),
            "PROGRAM_STOP" => one("M0".to_owned()),
            "OPTIONAL_PROGRAM_STOP" => one("M1".to_owned()),
            "PALLET_SHUTTLE" => {
                self.ends_with_shuttle = true;
                none()
            }
            "PROGRAM_END" => {
                self.has_ended = true;
                one(if self.ends_with_shuttle { "M30" } else { "M2" }.to_owned())
            }
            "SET_MOTION_CONTROL_MODE" => match arguments {
                ["CANON_EXACT_PATH"] => one("G61".to_owned()),
                ["CANON_EXACT_STOP"] => one("G61.1".to_owned()),
                ["CANON_CONTINUOUS", tolerance] => {
                    self.rounding = (*tolerance).to_owned();
                    one(self.continuous())
                }
                _ => Err(format!("the path mode {}", arguments.join(" "))),
            },
            "SET_NAIVECAM_TOLERANCE" => Ok(self.joined(arguments, &numbers()?).into_iter().collect()),
            "COMMENT" | "MESSAGE" | "ON_RESET" | "SET_FEED_REFERENCE" | "START_CHANGE" => none(),
            _ => self.auxiliary(name, arguments),
        }
    }

    fn continuous(&self) -> String {
        match self.rounding.parse::<f64>() {
            Ok(rounding) if rounding > 0.0 => format!("G64 P{}", self.rounding),
            _ => "G64".to_owned(),
        }
    }

    /// How far blocks that are joined to one may be from it (`G64 Q`), where that is another distance than P.
    fn joined(&self, printed: &[&str], numbers: &[f64]) -> Option<String> {
        let rounding: f64 = self.rounding.parse().ok()?;
        let (printed, joined) = printed.first().zip(numbers.first())?;
        ((joined - rounding).abs() > DIGIT).then(|| format!("{} Q{printed}", self.continuous()))
    }

    /// Spindle and coolant.
    fn auxiliary(&mut self, name: &str, arguments: &[&str]) -> Outcome<Vec<String>> {
        let is_first = arguments.first().is_none_or(|spindle| *spindle == "0");
        let words = match name {
            "SET_SPINDLE_SPEED" if is_first => format!("S{}", arguments.get(1).unwrap_or(&"0")),
            "START_SPINDLE_CLOCKWISE" if is_first => "M3".to_owned(),
            "START_SPINDLE_COUNTERCLOCKWISE" if is_first => "M4".to_owned(),
            "STOP_SPINDLE_TURNING" if is_first => "M5".to_owned(),
            "SET_SPINDLE_MODE" if arguments.get(1).is_some_and(|speed| speed.parse() == Ok(0.0)) => String::new(),
            "MIST_ON" => {
                self.coolant[0] = true;
                "M7".to_owned()
            }
            "FLOOD_ON" => {
                self.coolant[1] = true;
                "M8".to_owned()
            }
            "MIST_OFF" | "FLOOD_OFF" => {
                self.coolant[usize::from(name == "FLOOD_OFF")] = false;
                // M9 ends both.
                let [mist, flood] = self.coolant;
                format!("M9{}{}", if mist { " M7" } else { "" }, if flood { " M8" } else { "" })
            }
            _ => return Err(format!("`{name}`, which is no motion of axes and has no block here")),
        };
        Ok(vec![words])
    }

    fn units(&mut self, arguments: &[&str]) -> Outcome<Vec<String>> {
        let (unit, code) = match arguments {
            ["CANON_UNITS_MM"] => (1.0, "G21"),
            ["CANON_UNITS_INCHES"] => (25.4, "G20"),
            _ => return Err(format!("the unit {}", arguments.join(" "))),
        };
        if unit != self.unit && self.length != 0.0 {
            return Err(
                "another unit while the length of a tool acts: LinuxCNC's interpreter keeps its number".to_owned()
            );
        }
        match std::mem::replace(&mut self.unit, unit) == unit {
            true => Ok(Vec::new()),
            false => Ok(vec![code.to_owned()]),
        }
    }

    /// A printed coordinate as the position of its axis.
    fn machine(&self, axis: usize, printed: f64) -> f64 {
        let own = if is_rotary(axis) { printed } else { printed * self.unit };
        own + self.systems[self.system][axis] + if axis == 2 { self.length } else { 0.0 }
    }

    /// The words of axes that move, and of those that have to be named.
    fn words(&mut self, printed: &[&str], numbers: &[f64], named: &[usize]) -> Outcome<String> {
        let mut words = String::new();
        for axis in 0..AXES {
            let to = self.machine(axis, numbers[axis]);
            let unit = if is_rotary(axis) { 1.0 } else { self.unit };
            if (to - self.at[axis]).abs() <= 1.5 * DIGIT * unit && !named.contains(&axis) {
                continue;
            }
            let letter = char::from(LETTERS[axis]);
            if to < UNKNOWN / 2.0 {
                return Err(format!("{letter} moves from a position that the program does not say: give `--start`"));
            }
            self.at[axis] = to;
            words.push_str(&format!(" {letter}{}", number(printed[axis])));
        }
        Ok(words)
    }

    fn straight(&mut self, is_rapid: bool, printed: &[&str], numbers: &[f64]) -> Outcome<Vec<String>> {
        if numbers.len() != AXES {
            return Err("a move of other axes than X Y Z A B C".to_owned());
        }
        let words = self.words(printed, numbers, &[])?;
        if words.is_empty() {
            return Ok(Vec::new());
        }
        self.is_rapid = Some(is_rapid);
        let feed = if is_rapid { String::new() } else { self.fed() };
        Ok(vec![format!("G{}{words}{feed}", u8::from(!is_rapid))])
    }

    fn fed(&mut self) -> String {
        self.feed.take().map(|feed| format!(" F{feed}")).unwrap_or_default()
    }

    /// `ARC_FEED(first end, second end, first centre, second centre, turns, end along the third axis, A, B, C)`.
    fn arc(&mut self, printed: &[&str], numbers: &[f64]) -> Outcome<Vec<String>> {
        let [.., _, _, _] = printed else { return Err("an arc without its numbers".to_owned()) };
        if numbers.len() != 9 || numbers[4].abs() != 1.0 {
            return Err("an arc of more than one turn".to_owned());
        }
        let [first, second] = self.plane;
        let third = 3 - first - second;
        let (mut ends, mut of) = ([0.0; AXES], [""; AXES]);
        for (axis, index) in [(first, 0), (second, 1), (third, 5), (3, 6), (4, 7), (5, 8)] {
            (ends[axis], of[axis]) = (numbers[index], printed[index]);
        }
        let words = self.words(&of, &ends, &self.plane.clone())?;
        let code = if numbers[4] < 0.0 { "G2" } else { "G3" };
        let centre = |axis: usize, index: usize| format!(" {}{}", ["I", "J", "K"][axis], number(printed[index]));
        let centres = [centre(first, 2), centre(second, 3)].concat();
        Ok(vec![format!("{code}{words}{centres}{}", self.fed())])
    }

    fn offset(&mut self, numbers: &[f64]) -> Outcome<Vec<String>> {
        let [system, values @ ..] = numbers else { return Err("a work offset without its number".to_owned()) };
        let index = (*system as usize).checked_sub(1).filter(|index| *index < 9 && values.len() == AXES);
        let index = index.ok_or("a work offset that is not known")?;
        let factor = |axis: usize| if is_rotary(axis) { 1.0 } else { self.unit };
        let new: Vec<f64> = values.iter().enumerate().map(|(axis, value)| value * factor(axis)).collect();
        let mut blocks = Vec::new();
        let is_other = (0..AXES).any(|axis| (new[axis] - self.systems[index][axis]).abs() > DIGIT * factor(axis));
        if is_other {
            let words: String = (0..AXES)
                .filter(|axis| (new[*axis] - self.systems[index][*axis]).abs() > DIGIT * factor(*axis))
                .map(|axis| format!(" {}{}", char::from(LETTERS[axis]), values[axis]))
                .collect();
            blocks.push(format!("G10 L2 P{}{words}", index + 1));
            self.systems[index].copy_from_slice(&new);
        }
        if self.system != index {
            self.system = index;
            blocks.push(["G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3"][index].to_owned());
        }
        Ok(blocks)
    }

    fn tool_length(&mut self, numbers: &[f64]) -> Outcome<Vec<String>> {
        let [_, _, printed, ..] = numbers else { return Err("a tool offset without its numbers".to_owned()) };
        if numbers.iter().enumerate().any(|(axis, number)| axis != 2 && *number != 0.0) {
            return Err("a tool with offsets beside its length".to_owned());
        }
        self.length = printed * self.unit;
        if *printed == 0.0 {
            return Ok(vec!["G49".to_owned()]);
        }
        let near = |length: f64| (length - self.length).abs() <= DIGIT * self.unit;
        if near(NO_LENGTH) {
            return Err("the length of a tool that nobody gave: `--tools tool.tbl`, or `--tool-length-mm`".to_owned());
        }
        let own = self.tool.filter(|tool| self.tools.length(*tool).is_some_and(near));
        let other = || self.tools.by_number.iter().find(|(_, length)| near(**length)).map(|(number, _)| *number);
        match own.or_else(other) {
            Some(number) => Ok(vec![format!("G43 H{number}")]),
            None => Err("a tool offset that the control changes as it runs".to_owned()),
        }
    }
}

/// A printed number; there is no zero with a sign.
fn number(printed: &str) -> &str {
    match printed.parse::<f64>() {
        Ok(0.0) => "0",
        _ => printed,
    }
}

/// `   12 N5     STRAIGHT_FEED(..)`: the number of the line, if it has one, the name, what is in brackets.
fn command(text: &str) -> Option<(Option<u32>, &str, &str)> {
    let rest = text.trim().trim_start_matches(|byte: char| byte.is_ascii_digit()).trim_start();
    let (line, rest) = rest.strip_prefix('N')?.split_once(char::is_whitespace)?;
    let (name, arguments) = rest.trim().split_once('(')?;
    let is_name = |byte: char| byte.is_ascii_uppercase() || byte.is_ascii_digit() || byte == '_';
    (name.chars().all(is_name)).then_some((line.parse().ok(), name, arguments.strip_suffix(')')?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dialect::Dialect;

    fn options() -> Options {
        let mut options = Options::new(Dialect::Linuxcnc);
        options.tools.by_number.insert(4, 120.0);
        options
    }

    fn written(options: &Options, commands: &[&str]) -> Outcome<String> {
        let mut canonical = Canonical::new(options);
        let mut out = Vec::new();
        canonical.line("    1 N..... SET_G5X_OFFSET(1, 0.0000, 0.0000, 0.0000, 0.0000, 0.0000, 0.0000)", &mut out)?;
        for command in commands {
            canonical.line(&format!("   12 N7     {command}"), &mut out)?;
        }
        Ok(String::from_utf8(out).expect("text").replacen("G21 G90 G90.1 G17 G94\n", "", 1))
    }

    const FAR: &str = "-98765.0000, 0.0000, 0.0000, 0.0000";

    #[test]
    fn axes_are_named_where_they_move() {
        let options = Options { start: [Some(0.0); 9], ..options() };
        let text = written(
            &options,
            &[
                "STRAIGHT_TRAVERSE(0.0000, 0.0000, 5.0000, 0.0000, 0.0000, 0.0000)",
                "SET_FEED_RATE(100.0000)",
                "STRAIGHT_FEED(1.5000, -0.0000, 5.0000, 0.0000, 0.0000, 0.0000)",
                "STRAIGHT_FEED(1.5000, -2.0000, 5.0000, 0.0000, 0.0000, 0.0000)",
                "SELECT_PLANE(CANON_PLANE_XZ)",
                "ARC_FEED(9.0000, 1.5000, 7.0000, 1.5000, -1, -2.0000, 0.0000, 0.0000, 0.0000)",
                "PALLET_SHUTTLE()",
                "PROGRAM_END()",
            ],
        )
        .expect("blocks");
        assert_eq!(
            text,
            "N7 G0 Z5.0000\nN7 G1 X1.5000 F100.0000\nN7 G1 Y-2.0000\nG18\nN7 G2 X1.5000 Z9.0000 K7.0000 I1.5000\nM30\n"
        );
    }

    #[test]
    fn offsets_tools_and_units_are_written() {
        let text = written(
            &options(),
            &[
                "SET_G5X_OFFSET(2, 12.5000, 0.0000, 0.0000, 0.0000, 0.0000, 0.0000)",
                "SELECT_TOOL(4)",
                "START_CHANGE()",
                "CHANGE_TOOL(1)",
                "USE_TOOL_LENGTH_OFFSET(0.0000 0.0000 120.0000, 0.0000 0.0000 0.0000, 0.0000 0.0000 0.0000)",
                "USE_TOOL_LENGTH_OFFSET(0.0000 0.0000 0.0000, 0.0000 0.0000 0.0000, 0.0000 0.0000 0.0000)",
                "USE_LENGTH_UNITS(CANON_UNITS_INCHES)",
                "FLOOD_ON()",
                "MIST_ON()",
                "FLOOD_OFF()",
            ],
        );
        assert_eq!(text.as_deref(), Ok("G10 L2 P2 X12.5\nG55\nT4\nM6\nG43 H4\nG49\nG20\nM8\nM7\nM9 M7\n"));
    }

    /// What LinuxCNC 2.9 prints of `G64 P0.05 Q0.02`, `G64`, `G64 P0.1`, `G61`.
    #[test]
    fn path_modes_are_written() {
        let text = written(
            &options(),
            &[
                "SET_MOTION_CONTROL_MODE(CANON_CONTINUOUS, 0.050000)",
                "SET_NAIVECAM_TOLERANCE(0.0200)",
                "SET_MOTION_CONTROL_MODE(CANON_CONTINUOUS, 0.000000)",
                "SET_NAIVECAM_TOLERANCE(0.0000)",
                "SET_MOTION_CONTROL_MODE(CANON_CONTINUOUS, 0.100000)",
                "SET_NAIVECAM_TOLERANCE(0.1000)",
                "SET_MOTION_CONTROL_MODE(CANON_EXACT_PATH)",
            ],
        );
        let expected = "G64 P0.050000\nG64 P0.050000 Q0.0200\nG64\nG64 P0.100000\nG61\n";
        assert_eq!(text.as_deref(), Ok(expected));
    }

    #[test]
    fn what_has_no_block_is_refused() {
        let far = format!("STRAIGHT_FEED(-98760.0000, -98765.0000, {FAR})");
        for (command, said) in [
            ("STRAIGHT_PROBE(0, 0, 0, 0, 0, 0)", "STRAIGHT_PROBE"),
            ("SET_XY_ROTATION(15.0000)", "rotated"),
            ("SET_G92_OFFSET(1.0000, 0.0000, 0.0000, 0.0000, 0.0000, 0.0000)", "G92"),
            ("USE_TOOL_LENGTH_OFFSET(0.0000 0.0000 76543.0000, 0 0 0, 0 0 0)", "nobody gave"),
            ("USE_TOOL_LENGTH_OFFSET(0.0000 0.0000 7.0000, 0 0 0, 0 0 0)", "as it runs"),
            ("ARC_FEED(1, 0, 0, 0, -3, 0, 0, 0, 0)", "more than one turn"),
            ("START_SPINDLE_CLOCKWISE(1)", "START_SPINDLE_CLOCKWISE"),
            (&far, "--start"),
            ("nonsense", "no command"),
        ] {
            let error = written(&options(), &[command]).expect_err(command);
            assert!(error.contains(said), "{command}: {error}");
        }
    }
}
