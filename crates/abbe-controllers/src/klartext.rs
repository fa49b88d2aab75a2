//! Heidenhain plain text: refused until it is understood.

use crate::block::Action;
use crate::modal::{MachineOf, Modal};
use crate::options::Options;
use crate::refusal::Refusal;

/// A program in plain text.
#[derive(Default)]
pub(crate) struct Program {
    pub(crate) has_ended: bool,
}

impl Program {
    pub(crate) fn line(
        &mut self,
        text: &[u8],
        _: &mut Modal,
        _: &Options,
        _: &MachineOf<'_>,
    ) -> Result<Action, Refusal> {
        let word = String::from_utf8_lossy(text).trim().to_owned();
        let help = "write the program in the ISO dialect of the control";
        Err(Refusal::new(0, &word, "the plain text dialect `heidenhain` is not corrected", help))
    }
}
