//! What a block of plain text begins with, and M functions: what they mean here.

use std::fmt::Write as _;

/// What a block is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Statement {
    Begin,
    End,
    Line,
    Centre,
    Arc,
    RadiusArc,
    /// M functions alone, or after `STOP`.
    Auxiliary,
    ToolCall,
    ToolDefinition,
    Shift,
    Preset,
    TipOn,
    TipOff,
    Keep,
    Refuse(&'static str, &'static str),
}

/// What an M function does that matters here.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Effect {
    Keep,
    End,
    ToolChange,
    Machine,
    OtherDatum,
    /// Rotary axes take the shorter way, from here or until here.
    ShorterWay(bool),
    TipOn,
    TipOff,
    Refuse(&'static str, &'static str),
}

use Effect::{Machine, OtherDatum, ShorterWay, TipOff, TipOn, ToolChange};
use Statement::{Keep, Refuse};

const CYCLE: Statement = Refuse("a cycle, whose moves are not known", "write out its moves");
const TURNED: Statement = Refuse("mirror, scale or rotation of coordinates", "let the CAM system turn the path");
const TANGENT: Statement =
    Refuse("its path follows from the blocks beside it", "let the CAM system write L, CC with C, and CR");
const POLAR: Statement = Refuse("polar coordinates", "write right-angled ones: L, CC with C, and CR");
const FREE: Statement = Refuse("free contours, which only the control computes", "write L, CC with C, and CR");
const LABEL: Statement = Refuse("a subprogram or a repetition", "write out its moves");
const VARIABLE: Statement =
    Refuse("a Q parameter, whose value is known to the control alone", "write out what it stands for");
const TILTED: Statement = Refuse("a tilted plane", "let the CAM system write positions of the axes, or use M128");
const PROBING: Statement =
    Refuse("a probing move, whose target is never corrected", "leave probing to another program");

/// Blocks by what they begin with; the longest that fits counts. What is not here is refused.
const STATEMENTS: &[(&str, Statement)] = &[
    ("BEGIN PGM", Statement::Begin),
    ("END PGM", Statement::End),
    ("BLK FORM", Keep),
    ("TOOL CALL", Statement::ToolCall),
    ("TOOL DEF", Statement::ToolDefinition),
    ("L", Statement::Line),
    ("CC", Statement::Centre),
    ("C", Statement::Arc),
    ("CR", Statement::RadiusArc),
    ("STOP", Statement::Auxiliary),
    ("FUNCTION TCPM", Statement::TipOn),
    ("FUNCTION RESET TCPM", Statement::TipOff),
    ("FUNCTION MODE MILL", Keep),
    ("CYCL DEF 7", Statement::Shift),
    ("CYCL DEF 9", Keep),
    ("CYCL DEF 13", Keep),
    ("CYCL DEF 32", Keep),
    ("CYCL DEF 247", Statement::Preset),
    ("PLANE RESET STAY", Keep),
    ("CT", TANGENT),
    ("RND", TANGENT),
    ("CHF", TANGENT),
    ("APPR", TANGENT),
    ("DEP", TANGENT),
    ("LP", POLAR),
    ("CP", Refuse("a helix, or an arc in polar coordinates", "write a helix as lines, an arc as CC with C")),
    ("CTP", POLAR),
    ("LN", Refuse("tool vectors", "write positions of the rotary axes")),
    ("FPOL", FREE),
    ("FL", FREE),
    ("FLT", FREE),
    ("FC", FREE),
    ("FCT", FREE),
    ("FSELECT", FREE),
    ("SPL", Refuse("a spline", "write it as lines and arcs")),
    ("LBL", LABEL),
    ("CALL LBL", LABEL),
    ("CALL PGM", LABEL),
    ("CYCL CALL", CYCLE),
    ("CYCL DEF", CYCLE),
    ("CYCL DEF 8", TURNED),
    ("CYCL DEF 10", TURNED),
    ("CYCL DEF 11", TURNED),
    ("CYCL DEF 19", TILTED),
    ("CYCL DEF 26", TURNED),
    ("PATTERN DEF", CYCLE),
    ("CONTOUR DEF", CYCLE),
    ("SEL", LABEL),
    ("TRANS", Refuse("a change of coordinates that is not followed", "use CYCL DEF 7, or `--offset`")),
    ("PLANE", TILTED),
    ("TCH PROBE", PROBING),
    ("FN", VARIABLE),
    ("Q", VARIABLE),
    ("QL", VARIABLE),
    ("QR", VARIABLE),
    ("QS", VARIABLE),
    ("FUNCTION", Refuse("a function that is not known here", "write it in another way")),
];

/// The M functions that are known: number, whether they act at the end of their block, and what they do.
const AUXILIARY: &[(u32, bool, Effect)] = &[
    (0, true, Effect::Keep),
    (1, true, Effect::Keep),
    (2, true, Effect::End),
    (3, false, Effect::Keep),
    (4, false, Effect::Keep),
    (5, true, Effect::Keep),
    (6, true, ToolChange),
    (8, false, Effect::Keep),
    (9, true, Effect::Keep),
    (13, false, Effect::Keep),
    (14, false, Effect::Keep),
    (30, true, Effect::End),
    (89, false, Effect::Refuse("it calls a cycle, whose moves are not known", "write out its moves")),
    (90, false, Effect::Keep),
    (91, false, Machine),
    (92, false, OtherDatum),
    (94, false, Effect::Refuse("it counts a rotary axis anew", "leave it out, and write angles within one turn")),
    (97, true, Effect::Refuse("it changes the path of the tool", "let the CAM system write the path of the tool")),
    (98, true, Effect::Refuse("it changes the path of the tool", "let the CAM system write the path of the tool")),
    (99, true, Effect::Refuse("it calls a cycle, whose moves are not known", "write out its moves")),
    (101, false, Effect::Refuse("another tool may replace this one, with another length", "leave it out")),
    (102, true, Effect::Keep),
    (103, false, Effect::Keep),
    (107, false, Effect::Keep),
    (108, true, Effect::Keep),
    (109, false, Effect::Keep),
    (110, false, Effect::Keep),
    (111, true, Effect::Keep),
    (112, false, Effect::Refuse("it changes the path of the tool", "leave it out")),
    (113, true, Effect::Keep),
    (114, false, Effect::Refuse("it moves the linear axes when a rotary axis turns", "use M128")),
    (115, true, Effect::Keep),
    (116, false, Effect::Keep),
    (117, true, Effect::Keep),
    (118, false, Effect::Refuse("the path is changed by hand", "leave it out")),
    (120, false, Effect::Refuse("it changes the path of the tool", "let the CAM system write the path of the tool")),
    (124, false, Effect::Refuse("it leaves out points of the path", "leave it out")),
    (126, false, ShorterWay(true)),
    (127, true, ShorterWay(false)),
    (128, false, TipOn),
    (129, true, TipOff),
    (130, false, Effect::Refuse("a position in coordinates that are not tilted", "write it as another position")),
    (134, false, Effect::Keep),
    (135, true, Effect::Keep),
    (136, false, Effect::Keep),
    (137, true, Effect::Keep),
    (138, false, Effect::Refuse("it chooses the axes that tilt", "leave it out")),
    (140, false, Effect::Refuse("a move along the tool, whose end is not known", "write its end as a position")),
    (141, false, Effect::Keep),
    (144, false, Effect::Refuse("it changes the kinematics that the control counts with", "use M128")),
    (145, true, Effect::Keep),
    (148, false, Effect::Keep),
    (149, true, Effect::Keep),
    (150, false, Effect::Keep),
];

/// Numbers of M functions that belong to the control, and are refused if they are not known here; others are the machine's.
const OF_THE_CONTROL: std::ops::Range<u32> = 89..200;

/// The block that begins with this text (upper case), and how long its beginning is.
pub(super) fn statement(text: &[u8]) -> Option<(usize, Statement)> {
    let mut found: Option<(usize, Statement)> = None;
    for (name, statement) in STATEMENTS {
        if let Some(length) = length_of(text, name)
            && found.is_none_or(|(longest, _)| length > longest)
        {
            found = Some((length, *statement));
        }
    }
    found
}

/// How long `name` is at the beginning of a text that may have more blanks; none if something else stands there.
fn length_of(text: &[u8], name: &str) -> Option<usize> {
    let mut at = 0;
    for (index, part) in name.split(' ').enumerate() {
        let blanks = text[at..].iter().take_while(|byte| byte.is_ascii_whitespace()).count();
        if (index > 0) != (blanks > 0) || !text[at + blanks..].starts_with(part.as_bytes()) {
            return None;
        }
        at += blanks + part.len();
    }
    let is_digit = name.as_bytes().last().is_some_and(u8::is_ascii_digit);
    let goes_on = |next: &u8| if is_digit { next.is_ascii_digit() } else { next.is_ascii_alphabetic() };
    (!text.get(at).is_some_and(goes_on)).then_some(at)
}

/// Whether an M function acts at the end of its block, and what it does; none for one that is not known.
pub(super) fn auxiliary(number: u32) -> Option<(bool, Effect)> {
    match AUXILIARY.iter().find(|known| known.0 == number) {
        Some((_, is_late, effect)) => Some((*is_late, *effect)),
        None if OF_THE_CONTROL.contains(&number) => None,
        None => Some((false, Effect::Keep)),
    }
}

/// Both as tables in Markdown.
pub(crate) fn table() -> String {
    let mut text = String::from("| Heidenhain | |\n|---|---|\n");
    for (name, statement) in STATEMENTS {
        let said = match statement {
            Statement::Line | Statement::Arc | Statement::RadiusArc => "corrected".to_owned(),
            Keep | Statement::Auxiliary | Statement::ToolDefinition => "kept as it is".to_owned(),
            Refuse(why, _) => format!("refused: {why}"),
            _ => "followed".to_owned(),
        };
        let _ = writeln!(text, "| `{name}` | {said} |");
    }
    for (number, is_late, effect) in AUXILIARY {
        let said = match effect {
            Effect::Keep | ShorterWay(_) => "kept as it is",
            Machine | OtherDatum => "kept as it is; the position is followed",
            Effect::Refuse(..) => "refused",
            _ => "followed",
        };
        let more = match effect {
            Effect::Refuse(why, _) => format!(": {why}"),
            _ if *is_late => "; at the end of its block".to_owned(),
            _ => String::new(),
        };
        let _ = writeln!(text, "| `M{number}` | {said}{more} |");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_beginning_counts() {
        fn of(text: &str) -> Option<(&str, Statement)> {
            statement(text.as_bytes()).map(|(length, statement)| (&text[..length], statement))
        }
        assert_eq!(of("L X+5"), Some(("L", Statement::Line)));
        assert_eq!(of("CC"), Some(("CC", Statement::Centre)));
        assert_eq!(of("CYCL  DEF 7.1 X+5"), Some(("CYCL  DEF 7", Statement::Shift)));
        assert_eq!(of("CYCL DEF 70.0"), Some(("CYCL DEF", CYCLE)));
        assert_eq!(of("PLANE RESET STAY"), Some(("PLANE RESET STAY", Keep)));
        assert_eq!(of("PLANE RESET TURN"), Some(("PLANE", TILTED)));
        assert_eq!(of("Q5 = 3"), Some(("Q", VARIABLE)));
        assert!(of("LBLX").is_none() && of("X+5").is_none());
    }
}
