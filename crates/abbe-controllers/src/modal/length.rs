//! The length of the tool that acts: what sets it, and what leaves it open.

use std::rc::Rc;

use super::{MachineOf, Modal, refused};
use crate::lexer::{Line, Word};
use crate::machine::Space;
use crate::options::Options;
use crate::refusal::Refusal;

impl Modal {
    /// Why it is not known, after a change of the tool, which length acts, or that it is that of another tool.
    pub(super) fn left_open(&self, options: &Options) -> Option<String> {
        if options.dialect.is_siemens() {
            // Which cutting edge acts without a D is a machine datum (20270, CUTTING_EDGE_DEFAULT).
            return (!self.has_edge).then(|| "the tool was changed, and no D says which length acts".to_owned());
        }
        let (tool, acts) = self.tool.zip(self.length)?;
        let own = options.tools.length(tool).filter(|own| *own != acts)?;
        Some(format!("tool {tool} is in the spindle, {own} mm long, and a length of {acts} mm acts"))
    }

    /// After a move along the tool in machine coordinates, or to a reference point: some controls take the length back.
    pub(crate) fn leaves_length(&mut self, moves_along: bool, options: &Options) {
        if moves_along && options.dialect.has_program_numbers() && self.length.is_some() && self.space == Space::Joints
        {
            self.at[2] = None;
            self.open_length =
                Some("G53, G28 and G30 take the length of the tool back on some of these controls".to_owned());
        }
    }

    pub(super) fn set_length(
        &mut self,
        word: &Word,
        on: bool,
        line: &Line,
        options: &Options,
        build: &MachineOf<'_>,
    ) -> Result<(), Refusal> {
        self.open_length = None;
        let number = match line.words.iter().find(|word| word.letter == b'H') {
            // LinuxCNC takes the tool in the spindle, or with a changer that puts tools anywhere, tool 0.
            Some(of) if on && of.value == 0.0 && options.dialect == crate::dialect::Dialect::Linuxcnc => {
                if options.tools.by_number.contains_key(&0) {
                    let help = "write the H of the tool, or leave H out";
                    return Err(refused(
                        word,
                        "H0 is the tool in the spindle or tool 0, as the control is set up",
                        help,
                    ));
                }
                self.tool
            }
            Some(of) => Some(of.value as u32),
            None if on && options.dialect.has_program_numbers() && !options.tools.by_number.is_empty() => {
                let what = "G43 without an H takes the last one on these controls, whichever tool is in the spindle";
                return Err(refused(word, what, "write its H"));
            }
            None => self.tool,
        };
        // H0 is no tool.
        let on = on && number != Some(0);
        if let Some((own, called)) = self.tool.zip(number).filter(|(own, called)| on && own != called)
            && let [Some(of_own), Some(of_called)] = [own, called].map(|number| options.tools.length(number))
            && of_own != of_called
        {
            let message = format!(
                "tool {own} is in the spindle, {of_own} mm long, and the length of tool {called} is called, {of_called} mm"
            );
            let help = "if both numbers are meant for this tool, give the length of its tip: `--tool-length-mm`";
            return Err(refused(word, &message, help));
        }
        let length = match on {
            false => None,
            true => {
                let found = number.map_or(options.tools.only, |number| options.tools.length(number));
                let help = options.tools.help();
                Some(found.ok_or_else(|| {
                    let number = number.map_or("of the spindle".to_owned(), |number| number.to_string());
                    refused(word, &format!("the length of the tool {number} is not known"), help)
                })?)
            }
        };
        let moves = line.words.iter().any(|word| word.letter == b'Z');
        if options.dialect.has_program_numbers() && length != self.length && !moves && self.space == Space::Joints {
            // Some of these controls move Z at once.
            self.at[2] = None;
        }
        let failed = |error: abbe_core::Error| refused(word, &error.message, "is the length right?");
        self.use_length(length, options, build).map_err(failed)
    }

    /// The machine with a tool of this length.
    pub(crate) fn use_length(
        &mut self,
        length: Option<f64>,
        options: &Options,
        build: &MachineOf<'_>,
    ) -> abbe_core::Result<()> {
        if length != self.length {
            self.machine = Rc::new(build(length.or(options.tools.only))?);
            self.length = length;
        }
        Ok(())
    }
}
