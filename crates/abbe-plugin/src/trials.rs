//! What comes from libraries and from the processes of isolated plugins, read from any bytes.
//!
//! For campaigns that look for input which does harm (`cargo xtask fuzz`). Programs have no use for it.

use std::path::Path;
use std::sync::Arc;

use abbe_core::{Equations, ErrorFunction, Findings, Ingest, Origin, Poses, RowBatch, Validate, Variable, harmless};

use crate::loader::{Create, truncated};
use crate::peer::{Answer, Failure, Peer, Received};
use crate::proxy;
use crate::served::Served;

pub use crate::isolation::trials::{list, message, messages, question, questions};

/// An object that answers every question with the same text, and with nothing where numbers are wanted.
struct Says(String);

impl Peer for Says {
    fn who(&self) -> &str {
        "the plugin"
    }

    fn call(&self, _: u32, _: &str, _: &[Arc<Served>]) -> Result<Answer, Failure> {
        Ok(Answer { text: self.0.clone(), objects: Vec::new() })
    }

    fn poses(&self, _: &[f64], _: &[f64], _: &[Variable], _: &mut Poses) -> Result<(), Failure> {
        Ok(())
    }

    fn equations(&self, _: RowBatch<'_>, _: &mut Equations) -> Result<(), Failure> {
        Ok(())
    }

    fn as_any(&self) -> &dyn std::any::Any {
        self
    }
}

/// A text as the answer to every question that a stage, a machine and observations are asked; an error if none takes it.
pub fn answer(text: &str) -> Result<(), String> {
    let peer: Arc<dyn Peer> = Arc::new(Says(text.to_owned()));
    let given = || Received::Remote(peer.clone());
    let mut taken = Vec::new();
    let machine = proxy::machine(&given());
    if let Ok(machine) = &machine {
        let (info, mut out) = (machine.info(), Poses::default());
        let _ = machine.poses(&vec![0.0; info.status.len()], &info.nominal, &[], true, &mut out);
        let function =
            ErrorFunction { symbol: "EXX".to_owned(), axis: 0, component: 0, quantity: abbe_core::Quantity::Length };
        let _ = machine.motion_error(&function, &info.nominal, &vec![0.0; info.status.len()]);
    }
    taken.push(machine.map(drop));
    taken.push(proxy::observations(&given(), Some(&Arc::default())).map(drop));
    let stage = proxy::Stage::new(peer.clone());
    if let Ok(stage) = &stage {
        let _ = (stage.headers(), stage.read());
        let _: abbe_core::Result<Findings> = Validate::validate(stage, &[], &[]);
    }
    taken.push(stage.map(drop).map_err(Failure::from));
    match taken.iter().any(Result::is_ok) {
        true => Ok(()),
        false => taken.into_iter().find_map(Result::err).map_or(Ok(()), |failure| Err(failure.text)),
    }
}

/// A failure with this status and this text, told as an error.
pub fn failure(status: u32, text: &str) -> Result<(), String> {
    let error = Failure { status, text: text.to_owned() }.error("the plugin");
    let _ = Failure { status, text: text.to_owned() }.settings_error("the plugin").to_string();
    Err(harmless(&error.to_string()).into_owned())
}

/// The bytes of a file that may be a library; an error if it is cut off.
pub fn library_file(bytes: &[u8]) -> Result<(), String> {
    if truncated(bytes) { Err("the file is shorter than it says".to_owned()) } else { Ok(()) }
}

/// Where the plugins of a list seem to come from, and a function that makes none of their stages.
pub(crate) fn nowhere() -> (&'static Path, Origin, Create) {
    let file = Path::new("libvendor.so");
    let origin = Origin::Library { file: file.to_owned(), sha256: String::new() };
    (file, origin, Arc::new(|_, _, who| Err(Failure::of(who, "is not there"))))
}
