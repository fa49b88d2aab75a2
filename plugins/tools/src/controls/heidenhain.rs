//! The tool table of Heidenhain.

use std::fmt::Write as _;

use super::{Entry, Increments, Locked};

/// Columns stand where the header has them: `L` and `R` are presets, `DL` and `DR` what is worn (negative: undersize), `TL` is
/// `L` for a locked tool, which has no `DL` and `DR`.
pub fn table(entries: &[Entry], locked: &[Locked], decimals: u32) -> String {
    let mut text = "BEGIN TOOL .T MM\r\n".to_owned();
    line(&mut text, ["T", "NAME", "L", "R", "DL", "DR", "TL"], "DOC");
    let mut lines: Vec<(u32, [String; 4], &str, &str)> = Vec::new();
    for Entry { number, preset, value, recheck } in entries {
        let [length, longer] = Increments::split(preset[0], value[0], decimals).map(Increments::signed);
        let [radius, wider] = Increments::split(preset[1], value[1], decimals).map(Increments::signed);
        lines.push((*number, [length, radius, longer, wider], "", if *recheck { "RECHECK" } else { "" }));
    }
    for Locked { number, preset, reason } in locked {
        let [length, radius] = preset.map(|value| Increments::of(value, decimals).signed());
        lines.push((*number, [length, radius, String::new(), String::new()], "L", reason));
    }
    lines.sort_by_key(|(number, ..)| *number);
    for (number, [length, radius, longer, wider], lock, note) in lines {
        let number = number.to_string();
        let name = format!("T{number}");
        line(&mut text, [&number, &name, &length, &radius, &longer, &wider, lock], &note.to_uppercase());
    }
    text + "[END]\r\n"
}

fn line(text: &mut String, [number, name, length, radius, longer, wider, lock]: [&str; 7], note: &str) {
    let columns = format!("{number:<7}{name:<17}{length:<13}{radius:<13}{longer:<11}{wider:<11}{lock:<4}{note}");
    let _ = write!(text, "{}\r\n", columns.trim_end());
}
