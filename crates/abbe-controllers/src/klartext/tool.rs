//! Tools of plain text: what calls them, and their lengths.

use crate::block::{Action, Reader};
use crate::machine::Space;
use crate::modal::letter;
use crate::plan::Moved;
use crate::refusal::Refusal;

use super::Program;
use super::words::Cursor;

impl Program {
    /// `TOOL CALL 5 Z S3000 DL+0.1`.
    pub(super) fn tool_call(
        &mut self,
        mut cursor: Cursor<'_>,
        start: usize,
        reader: &mut Reader<'_>,
    ) -> Result<Action, Refusal> {
        let mut call = ToolCall::default();
        cursor.skip_blanks();
        call.read(&mut cursor)?;
        let refused = |what: &str, help: &str| Refusal::new(start, "TOOL CALL", what, help);
        if let Some(axis) = call.axis {
            self.pole = None;
            reader.modal.plane = [[1, 2], [2, 0], [0, 1]][axis];
        }
        let is_new = call.number.is_some() || call.has_name;
        if !is_new && call.longer.is_none() {
            return Ok(Action::Copy(None));
        }
        if reader.modal.space == Space::Workpiece {
            let help = "switch it off before: M129, or FUNCTION RESET TCPM";
            return Err(refused("a change of the tool while the tip is programmed", help));
        }
        let tools = &reader.options.tools;
        if is_new {
            let help = tools.help();
            self.length = match call.number {
                Some(0.0) => None,
                _ if tools.only.is_some() => tools.only,
                Some(number) if number.fract() == 0.0 => {
                    let found = tools.length(number as u32);
                    let unknown = || refused(&format!("the length of the tool {number} is not known"), help);
                    Some(found.ok_or_else(unknown)?)
                }
                Some(_) => return Err(refused("the length of a step of a tool is not known", ONE_LENGTH)),
                None => return Err(refused("a table of lengths has numbers of tools, and no names", ONE_LENGTH)),
            };
        }
        let more = call.longer.unwrap_or(0.0) * reader.modal.unit(2);
        let length = self.length.map(|length| length + more);
        let plane = reader.modal.plane;
        if length.is_some_and(|length| length != 0.0) && plane != [0, 1] {
            let axis = letter(3 - plane[0] - plane[1]);
            let what = format!("a tool along {axis}; the machine of the calibration has it along Z");
            return Err(refused(&what, "correct this part of the program with a calibration that has the tool so"));
        }
        let failed = |error: abbe_core::Error| refused(&error.message, "is the length right?");
        reader.modal.use_length(length, reader.options, reader.build).map_err(failed)?;
        if !is_new || reader.options.stays_at_tool_change {
            return Ok(Action::Copy(None));
        }
        reader.modal.at = [None; 9];
        Ok(reader.jump(None, false, [Moved::To; 9]))
    }
}

/// What a tool call says.
#[derive(Default)]
struct ToolCall {
    number: Option<f64>,
    has_name: bool,
    /// The axis of the tool: 0 is X.
    axis: Option<usize>,
    /// DL.
    longer: Option<f64>,
}

impl ToolCall {
    fn read(&mut self, cursor: &mut Cursor<'_>) -> Result<(), Refusal> {
        let help = "write a number or a name, Z, S, F, DL, DR and DR2";
        loop {
            cursor.skip_blanks();
            let from = cursor.at;
            let Some(byte) = cursor.peek(0) else { return Ok(()) };
            let is_first = self.number.is_none() && !self.has_name && self.axis.is_none();
            if byte.is_ascii_digit() && is_first {
                self.number = Some(cursor.number(from)?);
            } else if byte == b'"' && is_first {
                cursor.at += 1;
                while cursor.peek(0).is_some_and(|next| next != b'"') {
                    cursor.at += 1;
                }
                if !cursor.takes(b"\"") {
                    return Err(cursor.refused(from, "a name without an end", "close it with `\"`"));
                }
                self.has_name = true;
            } else if (b'X'..=b'Z').contains(&byte) && self.axis.is_none() {
                cursor.at += 1;
                self.axis = Some(usize::from(byte - b'X'));
            } else if cursor.takes(b"DL") {
                self.longer = Some(cursor.number(from)?);
            } else if cursor.takes(b"DR2") || cursor.takes(b"DR") || cursor.takes(b"S") || cursor.takes(b"F") {
                cursor.number(from)?;
            } else {
                return Err(cursor.refused(from, "a word of a tool call that is not known here", help));
            }
        }
    }
}

const ONE_LENGTH: &str = "give one length for all tools: `--tool-length-mm`";

/// `TOOL DEF 5` brings a tool; with a length it is a table of its own.
pub(super) fn definition(mut cursor: Cursor<'_>, start: usize) -> Result<Action, Refusal> {
    loop {
        cursor.skip_blanks();
        match cursor.peek(0) {
            None => return Ok(Action::Copy(None)),
            Some(b'L') => {
                let help = "leave the length out, and give it: `--tools tool.tbl`";
                return Err(Refusal::new(start, "TOOL DEF", "a length of a tool that the program defines", help));
            }
            Some(_) => cursor.at += 1,
        }
    }
}
