//! A program of Fanuc that sets offsets of memory C: geometry and wear of H (length) and D (radius).

use std::fmt::Write as _;

use super::{Entry, Increments, Locked};

/// `G10 L10` and `L12` set the preset length and radius, `L11` and `L13` what is worn.
pub fn program(number: u32, entries: &[Entry], locked: &[Locked], decimals: u32) -> String {
    let mut text = format!("%\nO{number:04} (TOOL OFFSETS)\n(D OFFSETS ARE RADII)\nG21 G90\n");
    for Entry { number, preset, value, recheck } in entries {
        if *recheck {
            let _ = writeln!(text, "(T{number} RECHECK)");
        }
        for (place, [geometry, wear]) in [(0, [10, 11]), (1, [12, 13])] {
            let [base, more] = Increments::split(preset[place], value[place], decimals);
            let _ = writeln!(text, "G10 L{geometry} P{number} R{base}\nG10 L{wear} P{number} R{more}");
        }
    }
    for Locked { number, reason, .. } in locked {
        let _ = writeln!(text, "(T{number} LOCKED: {})", reason.to_uppercase());
    }
    text + "M30\n%\n"
}
