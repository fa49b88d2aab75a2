//! What the controls understand: every code, what it means here, and which dialects have it.

use std::fmt::Write as _;

/// The language of a control.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Dialect {
    /// LinuxCNC.
    Linuxcnc,
    /// ISO 6983-1 as most controls read it.
    Iso,
    /// Fanuc.
    Fanuc,
    /// SINUMERIK.
    Siemens,
    /// Heidenhain plain text.
    Heidenhain,
    /// grbl and its kin.
    Grbl,
}

impl Dialect {
    /// All of them.
    pub const ALL: [Self; 6] = [Self::Linuxcnc, Self::Iso, Self::Fanuc, Self::Siemens, Self::Heidenhain, Self::Grbl];

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Linuxcnc => "linuxcnc",
            Self::Iso => "iso",
            Self::Fanuc => "fanuc",
            Self::Siemens => "siemens",
            Self::Heidenhain => "heidenhain",
            Self::Grbl => "grbl",
        }
    }

    /// The dialect of this name.
    pub fn of_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|dialect| dialect.name() == name)
    }

    /// Whether `G10 L2 P0` sets an offset on top of the others, and not that which acts.
    pub(crate) fn has_external_offset(self) -> bool {
        matches!(self, Self::Fanuc | Self::Iso)
    }

    pub(crate) fn is_siemens(self) -> bool {
        self == Self::Siemens
    }

    pub(crate) fn has_semicolon_comments(self) -> bool {
        !matches!(self, Self::Fanuc)
    }

    pub(crate) fn has_bracket_comments(self) -> bool {
        !matches!(self, Self::Siemens | Self::Heidenhain)
    }

    /// Whether blocks with `/` run always: grbl has no switch for them.
    pub(crate) fn always_runs_optional_blocks(self) -> bool {
        self == Self::Grbl
    }

    pub(crate) fn has_blanks_in_numbers(self) -> bool {
        matches!(self, Self::Linuxcnc | Self::Grbl)
    }

    /// Whether a program begins with its number, `O1001`.
    pub(crate) fn has_program_numbers(self) -> bool {
        matches!(self, Self::Fanuc | Self::Iso)
    }

    /// Whether a number needs a point to count in mm.
    pub(crate) fn needs_points(self) -> bool {
        self == Self::Fanuc
    }

    /// Whether M5 and M9 act at the end of their block.
    pub(crate) fn stops_late(self) -> bool {
        !matches!(self, Self::Linuxcnc | Self::Grbl)
    }

    /// Whether F under G93 is 1/minutes; where that differs from control to control it is not known.
    pub(crate) fn counts_inverse_minutes(self) -> Option<bool> {
        (self != Self::Iso).then_some(true)
    }

    /// Whether arcs have no coordinate outside of their plane: a helix is written in another way there, or not at all.
    pub(crate) fn has_flat_arcs(self) -> bool {
        self == Self::Heidenhain
    }

    /// Codes of inches and of mm where the unit at the start is a parameter of the control, or depends on the machine.
    pub(crate) fn unit_codes(self) -> Option<[&'static str; 2]> {
        match self {
            Self::Linuxcnc | Self::Iso | Self::Fanuc => Some(["G20", "G21"]),
            Self::Siemens => Some(["G70", "G71"]),
            Self::Heidenhain | Self::Grbl => None,
        }
    }

    /// Whether numbers are absolute or relative at the start is a parameter of the control.
    pub(crate) fn starts_absolute(self) -> bool {
        !matches!(self, Self::Iso | Self::Fanuc)
    }

    fn bit(self) -> u8 {
        match self {
            Self::Linuxcnc => L,
            Self::Iso => I,
            Self::Fanuc => F,
            Self::Siemens => S,
            Self::Grbl => G,
            Self::Heidenhain => 0,
        }
    }
}

/// What a code means.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Meaning {
    Rapid,
    Feed,
    /// Clockwise or not.
    Arc {
        clockwise: bool,
    },
    Plane([usize; 2]),
    Inches(bool),
    Relative(bool),
    ArcAbsolute(bool),
    /// F per minute, per revolution.
    FeedPerTime,
    InverseTime,
    /// A work offset, from 0; none is the machine itself.
    System(Option<usize>),
    ToolLength,
    ToolLengthOff,
    ToolCentre(bool),
    /// Only this block is in machine coordinates.
    MachineBlock,
    /// Drives to a reference point.
    Home,
    SetSystem,
    Shift,
    /// Takes back a shift of the origin.
    NoShift,
    /// Not corrected, no position follows from it.
    Keep,
    /// Its words are no positions.
    Dwell,
    /// Its axis words name axes, and are no positions.
    Names,
    Refuse(&'static str, &'static str),
}

const L: u8 = 1;
const I: u8 = 2;
const F: u8 = 4;
const S: u8 = 8;
const G: u8 = 16;
const ALL: u8 = L | I | F | S | G;

/// A code: ten times its number, the dialects that have it, its modal group (0 for none) and what it means.
struct Code(u16, u8, u8, Meaning);

use Meaning::{
    ArcAbsolute, Dwell, Feed, FeedPerTime, Home, Inches, InverseTime, Keep, MachineBlock, Names, NoShift, Plane, Rapid,
    Refuse, Relative, SetSystem, Shift, System, ToolCentre, ToolLength, ToolLengthOff,
};

const RADIUS: Meaning = Refuse(
    "the path of the tool is not the programmed one under cutter compensation",
    "let the CAM system write the path of the tool",
);
const CYCLE: Meaning = Refuse("a canned cycle", "write out its moves");
const PROBING: Meaning = Refuse("a probing move, whose target is never corrected", "leave probing to another program");
const SPLINE: Meaning = Refuse("a spline", "write it as lines and arcs");
const THREAD: Meaning = Refuse("motion that is tied to the spindle", "leave it to another program");
const SHIFTED: Meaning = Refuse("a frame that shifts coordinates", "use G54 and `--offset`");
const COMPRESSED: Meaning = Refuse("a compressor, which changes the path", "switch it off: COMPOF");
const SCALED: Meaning = Refuse("mirror, scale or rotation of coordinates", "let the CAM system turn the path");
const MACRO: Meaning = Refuse("a macro call, whose moves are not known", "write out its moves");
const VECTOR: Meaning = Refuse("tool vectors", "write positions of the rotary axes");
const POLAR: Meaning = Refuse("polar coordinates", "write right-angled ones");
const UNKNOWN_OFFSET: Meaning = Refuse("an offset that is not known here", "use G54 to G59 and `--offset`");

/// All codes. What is not here is refused.
const CODES: &[Code] = &[
    Code(0, ALL, 1, Rapid),
    Code(10, ALL, 1, Feed),
    Code(20, ALL, 1, Meaning::Arc { clockwise: true }),
    Code(30, ALL, 1, Meaning::Arc { clockwise: false }),
    Code(40, ALL, 0, Dwell),
    Code(50, L, 1, SPLINE),
    Code(51, L, 1, SPLINE),
    Code(51, F, 0, Names),
    Code(52, L, 1, SPLINE),
    Code(53, L, 1, SPLINE),
    Code(61, F, 1, SPLINE),
    Code(62, F, 1, SPLINE),
    Code(70, L, 0, Refuse("X as a diameter", "program radii")),
    Code(80, L, 0, Keep),
    Code(80, F, 0, Keep),
    Code(90, I | F | S, 0, Keep),
    Code(100, L | I | F | G, 0, SetSystem),
    Code(121, F, 0, POLAR),
    Code(131, F, 0, Keep),
    Code(150, F, 0, Keep),
    Code(160, F, 0, POLAR),
    Code(170, ALL, 2, Plane([0, 1])),
    Code(180, ALL, 2, Plane([2, 0])),
    Code(190, ALL, 2, Plane([1, 2])),
    Code(200, L | I | F | G, 6, Inches(true)),
    Code(210, L | I | F | G, 6, Inches(false)),
    Code(280, L | I | F | G, 0, Home),
    Code(281, L | G, 0, Keep),
    Code(300, L | I | F | G, 0, Home),
    Code(301, L | G, 0, Keep),
    Code(310, I | F, 0, PROBING),
    Code(330, L | I | F | S, 1, THREAD),
    Code(331, L, 1, THREAD),
    Code(382, L | G, 1, PROBING),
    Code(383, L | G, 1, PROBING),
    Code(384, L | G, 1, PROBING),
    Code(385, L | G, 1, PROBING),
    Code(400, ALL, 7, Keep),
    Code(401, F, 7, Keep),
    Code(410, L | I | F | S, 7, RADIUS),
    Code(411, L, 7, RADIUS),
    Code(420, L | I | F | S, 7, RADIUS),
    Code(421, L, 7, RADIUS),
    Code(430, L | I | F, 8, ToolLength),
    Code(431, L | G, 8, Refuse("a tool offset that the control changes as it runs", "use G43 H and `--tools`")),
    Code(432, L, 8, Refuse("a second tool offset", "use one offset for each tool")),
    Code(434, F, 8, ToolCentre(true)),
    Code(435, F, 8, VECTOR),
    Code(440, I | F, 8, Refuse("a tool length that counts the other way", "use G43")),
    Code(490, L | I | F | G, 8, ToolLengthOff),
    Code(500, F, 11, Keep),
    Code(501, F, 11, Names),
    Code(510, F, 11, SCALED),
    Code(511, F, 11, SCALED),
    Code(520, L | F, 0, Shift),
    Code(530, L | I | F | G, 0, MachineBlock),
    Code(530, S, 0, MachineBlock),
    Code(540, ALL, 12, System(Some(0))),
    Code(550, ALL, 12, System(Some(1))),
    Code(560, ALL, 12, System(Some(2))),
    Code(570, ALL, 12, System(Some(3))),
    Code(541, F, 12, UNKNOWN_OFFSET),
    Code(542, F, 12, UNKNOWN_OFFSET),
    Code(580, L | I | F | G, 12, System(Some(4))),
    Code(590, L | I | F | G, 12, System(Some(5))),
    Code(591, L, 12, System(Some(6))),
    Code(592, L, 12, System(Some(7))),
    Code(593, L, 12, System(Some(8))),
    Code(600, S, 13, Keep),
    Code(610, L | F, 13, Keep),
    Code(611, L, 13, Keep),
    Code(640, L | F | S | G, 13, Keep),
    Code(630, F, 13, THREAD),
    Code(630, S, 1, THREAD),
    Code(650, F, 0, MACRO),
    Code(660, F, 0, MACRO),
    Code(661, F, 0, MACRO),
    Code(670, F, 0, Keep),
    Code(680, F, 16, SCALED),
    Code(682, F, 16, SCALED),
    Code(690, F, 16, Keep),
    Code(700, S, 6, Inches(true)),
    Code(710, S, 6, Inches(false)),
    Code(7000, S, 6, Inches(true)),
    Code(7100, S, 6, Inches(false)),
    Code(730, L | F, 1, CYCLE),
    Code(740, F, 1, CYCLE),
    Code(740, S, 0, Home),
    Code(750, S, 0, Home),
    Code(760, L | F, 1, CYCLE),
    // A group of its own on Fanuc's controls: `G0 G17 G40 G80` is a usual head.
    Code(800, L | G, 1, Keep),
    Code(800, I | F, 9, Keep),
    Code(810, L | I | F, 1, CYCLE),
    Code(820, L | I | F, 1, CYCLE),
    Code(830, L | I | F, 1, CYCLE),
    Code(840, L | I | F, 1, CYCLE),
    Code(850, L | I | F, 1, CYCLE),
    Code(860, L | I | F, 1, CYCLE),
    Code(870, L | I | F, 1, CYCLE),
    Code(880, L | I | F, 1, CYCLE),
    Code(890, L | I | F, 1, CYCLE),
    Code(900, ALL, 3, Relative(false)),
    Code(910, ALL, 3, Relative(true)),
    Code(901, L, 4, ArcAbsolute(true)),
    Code(911, L | G, 4, ArcAbsolute(false)),
    Code(
        920,
        L | I | F | G,
        0,
        Refuse(
            "it moves the origin to where the axes stand, and they stand at corrected positions",
            "set a work offset: G10 L2, or `--offset`",
        ),
    ),
    Code(921, L | G, 0, NoShift),
    Code(922, L, 0, NoShift),
    Code(923, L, 0, Refuse("an offset that is not known here", "set a work offset: G10 L2, or `--offset`")),
    Code(930, L | I | F | S | G, 5, InverseTime),
    Code(940, ALL, 5, FeedPerTime),
    Code(950, L | I | F | S, 5, FeedPerTime),
    Code(960, L | F | S, 14, Refuse("a constant cutting speed", "use G97")),
    Code(970, L | F | S, 14, Keep),
    Code(980, L | I | F, 10, Keep),
    Code(990, L | I | F, 10, Keep),
    Code(4500, S, 18, Keep),
    Code(4510, S, 18, Keep),
    Code(5000, S, 12, System(None)),
    Code(6010, S, 19, Keep),
    Code(6020, S, 19, Keep),
    Code(6410, S, 13, Keep),
    Code(6420, S, 13, Keep),
    Code(1530, S, 0, MachineBlock),
];

/// Names of SINUMERIK that are known: what they mean, and what is said of them.
const NAMES: &[(&str, Meaning)] = &[
    ("TRAORI", ToolCentre(true)),
    ("TRAFOOF", ToolCentre(false)),
    ("SUPA", MachineBlock),
    ("CFTCP", Keep),
    ("CFC", Keep),
    ("CFIN", Keep),
    ("FFWON", Keep),
    ("FFWOF", Keep),
    ("SOFT", Keep),
    ("BRISK", Keep),
    ("ORIAXES", Keep),
    ("ORIMKS", Keep),
    ("MSG", Keep),
    ("COMPOF", Keep),
    ("CIP", Refuse("a circle through a point in between", "write it with a centre: G2 or G3")),
    ("TRANS", SHIFTED),
    ("ATRANS", SHIFTED),
    ("ROT", SCALED),
    ("AROT", SCALED),
    ("SCALE", SCALED),
    ("MIRROR", SCALED),
    ("A3", VECTOR),
    ("B3", VECTOR),
    ("C3", VECTOR),
    ("A2", VECTOR),
    ("B2", VECTOR),
    ("C2", VECTOR),
    ("BSPLINE", SPLINE),
    ("CSPLINE", SPLINE),
    ("ASPLINE", SPLINE),
    ("POLY", SPLINE),
    ("COMPCAD", COMPRESSED),
    ("COMPON", COMPRESSED),
    ("COMPCURV", COMPRESSED),
];

/// The modal group and the meaning of a G-code; `number` is ten times its number.
pub(crate) fn meaning(dialect: Dialect, number: u16) -> Option<(u8, Meaning)> {
    let code = CODES.iter().find(|code| code.0 == number && code.1 & dialect.bit() != 0)?;
    Some((code.2, code.3))
}

/// The meaning of a name of SINUMERIK.
pub(crate) fn meaning_of_name(name: &str) -> Meaning {
    let known = NAMES.iter().find(|(known, _)| *known == name);
    known.map_or(Refuse("not known", "write it in another way"), |(_, meaning)| *meaning)
}

impl Meaning {
    /// What is said of it in a table.
    fn said(self) -> String {
        match self {
            Self::Rapid | Self::Feed | Self::Arc { .. } => "corrected".to_owned(),
            Self::Refuse(why, _) => format!("refused: {why}"),
            Self::Home | MachineBlock => "kept as it is; the position is followed".to_owned(),
            Self::Keep | Self::Dwell => "kept as it is".to_owned(),
            Self::Names => "kept as it is; axes that it names do not move".to_owned(),
            _ => "followed".to_owned(),
        }
    }
}

/// What every dialect supports, as a table in Markdown.
pub fn table() -> String {
    let dialects = [Dialect::Linuxcnc, Dialect::Iso, Dialect::Fanuc, Dialect::Siemens, Dialect::Grbl];
    let mut text = String::from("| code | linuxcnc | iso | fanuc | siemens | grbl |\n|---|---|---|---|---|---|\n");
    let mut numbers: Vec<u16> = CODES.iter().map(|code| code.0).collect();
    numbers.sort_unstable();
    numbers.dedup();
    for number in numbers {
        let _ = write!(text, "| `{}` |", code_name(number));
        for dialect in dialects {
            let said = meaning(dialect, number).map_or("refused".to_owned(), |(_, meaning)| meaning.said());
            let _ = write!(text, " {said} |");
        }
        text.push('\n');
    }
    text.push_str("\n| SINUMERIK | |\n|---|---|\n");
    for (name, meaning) in NAMES {
        let _ = writeln!(text, "| `{name}` | {} |", meaning.said());
    }
    text.push('\n');
    text.push_str(&crate::klartext::table());
    text
}

/// `G1`, `G43.4` of ten times its number.
pub(crate) fn code_name(number: u16) -> String {
    match number % 10 {
        0 => format!("G{}", number / 10),
        part => format!("G{}.{part}", number / 10),
    }
}
