//! The tool table of LinuxCNC.

use std::fmt::Write as _;

use super::{Entry, Increments, Locked};

/// One line a tool: number, pocket, length, diameter. A locked tool has a comment in its place, so that a change to it fails.
pub fn table(entries: &[Entry], locked: &[Locked], decimals: u32) -> String {
    let mut text = String::new();
    for Entry { number, value: [length, radius], recheck, .. } in entries {
        let (length, diameter) = (Increments::of(*length, decimals), Increments::of(2.0 * radius, decimals));
        let note = if *recheck { "recheck" } else { "ok" };
        let _ = writeln!(text, "T{number} P{number} Z{} D{diameter} ;{note}", length.signed());
    }
    for Locked { number, reason, .. } in locked {
        let _ = writeln!(text, ";T{number} locked: {reason}");
    }
    text
}
