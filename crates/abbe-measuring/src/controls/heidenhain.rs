//! Heidenhain TNC: touch probe cycle 4 measures along any direction and leaves the tip in Q parameters, -1 in the fourth if there was
//! no contact; `M91` moves in machine coordinates, watched by the control as long as `M141` is not programmed. `FN 16` appends to the log.

use abbe_core::{Error, ExportedFile, Result};

use super::{Job, file, number};
use crate::language::plain;
use crate::programme::{Block, TouchBlock};

/// Folder of programs and masks on the control.
const FOLDER: &str = "TNC:\\ABBE\\";

// Q parameters: 1 to 4 result of the cycle, 20 touch, 21 repeat, 22 to 24 direction, 25 distance, 26 to 28 beginning, 30 attempts,
// 31 misses one after the other, 32 clock, 33 temperature, from 41 on where rotary axes stand.

pub fn write(job: &Job<'_>) -> Result<Vec<ExportedFile>> {
    if let Some((_, axis)) = job.program.linear().find(|(_, axis)| !"XYZ".contains(&axis.letter)) {
        let message = format!("touch probe cycle 4 moves X, Y and Z, and not {}", axis.letter);
        return Err(Error::usage(message).setting("axis_names"));
    }
    let settings = job.settings;
    let name = if job.dry { "DRYRUN" } else { "MEASURE" };
    let mut lines: Vec<String> = job.introduction().iter().map(|line| format!("; {}", plain(line))).collect();
    lines.push("FN 0: Q31 = +0".to_owned());
    if !job.dry {
        lines.push(printed(job, "HEAD"));
    }
    lines.extend(settings.spindle_deg.into_iter().flat_map(orient));
    lines.extend(["; the tip is clear of everything?".to_owned(), "M0".to_owned()]);
    for block in &job.program.blocks {
        add(job, block, &mut lines);
    }
    if !job.dry {
        lines.push(printed(job, "END"));
    }
    lines.push("M30".to_owned());
    if !job.dry {
        lines.extend(touch(job));
    }
    let units = if job.in_inches() { "INCH" } else { "MM" };
    let mut numbered = vec![format!("0 BEGIN PGM {name} {units}")];
    numbered.extend(lines.iter().enumerate().map(|(index, line)| format!("{} {line}", index + 1)));
    numbered.push(format!("{} END PGM {name} {units}", lines.len() + 1));
    let mut files = vec![file(format!("{name}.H"), &numbered)];
    if !job.dry {
        let mask = |name: &str, lines: &[String]| {
            let lines: Vec<String> =
                lines.iter().cloned().chain(["M_APPEND;".to_owned(), "M_CLOSE;".to_owned()]).collect();
            file(format!("{name}.A"), &lines)
        };
        let texts: Vec<String> = job.header("HEIDENHAIN").iter().map(|line| format!("\"{line}\";")).collect();
        files.push(mask("HEAD", &texts));
        files.push(mask("HIT", &[hit(job)]));
        files.push(mask("MISS", &["\"T%6.0LF R%2.0LF H0\",Q20,Q21;".to_owned()]));
        files.push(mask("END", &["\"END\";".to_owned()]));
    }
    Ok(files)
}

/// A feed of linear axes: mm/min, or tenths of an inch per minute.
fn feed(job: &Job<'_>, mm_per_min: f64) -> String {
    number(if job.in_inches() { mm_per_min / 2.54 } else { mm_per_min })
}

/// A number with its sign.
fn signed(text: String) -> String {
    if text.starts_with('-') { text } else { format!("+{text}") }
}

fn printed(job: &Job<'_>, mask: &str) -> String {
    let log = job.settings.log.as_deref().unwrap_or("ABBE.TXT");
    format!("FN 16: F-PRINT {FOLDER}{mask}.A / {FOLDER}{log}")
}

fn orient(angle: f64) -> [String; 3] {
    [
        "CYCL DEF 13.0 ORIENTATION".to_owned(),
        format!("CYCL DEF 13.1 ANGLE {}", number(angle.rem_euclid(360.0))),
        "M19".to_owned(),
    ]
}

fn add(job: &Job<'_>, block: &Block, lines: &mut Vec<String>) {
    let settings = job.settings;
    let words = |positions: &[(usize, f64)]| -> String {
        let word =
            |(axis, place): &(usize, f64)| format!("{}{}", job.axis(*axis).letter, signed(job.place(*axis, *place)));
        positions.iter().map(word).collect::<Vec<_>>().join(" ")
    };
    match block {
        Block::Note(text) => lines.push(format!("; {}", plain(text))),
        Block::Pause(text) => lines.extend([format!("; {}", plain(text)), "M0".to_owned()]),
        Block::Orient(angle) => lines.extend(orient(*angle)),
        Block::Settle(seconds) => {
            lines.extend(["CYCL DEF 9.0 DWELL TIME".to_owned(), format!("CYCL DEF 9.1 DWELL {}", number(*seconds))])
        }
        Block::Swing(positions) => {
            let feed = number(settings.rotary_feed_deg_per_min);
            lines.push(format!("L {} R0 F{feed} M91", words(positions)));
        }
        Block::Move(positions) => {
            let feed = feed(job, settings.positioning_feed_mm_per_min);
            lines.push(format!("L {} R0 F{feed} M91", words(positions)));
        }
        Block::Touch(TouchBlock { number: touch, approach, end, rotary, .. }) => {
            let mut set = |parameter: usize, value: String| {
                lines.push(format!("FN 0: Q{parameter} = {}", signed(value)));
            };
            set(20, number(*touch as f64));
            let letter = |axis: usize| "XYZ".find(&job.axis(axis).letter).unwrap_or_default();
            let mut distance = 0.0;
            for ((axis, from), (_, to)) in approach.iter().zip(end) {
                distance += (to - from).powi(2);
                set(22 + letter(*axis), job.length(to - from));
                set(26 + letter(*axis), job.length(*from));
            }
            set(25, job.length(distance.sqrt()));
            rotary.iter().enumerate().for_each(|(index, (_, place))| set(41 + index, number(*place)));
            for repeat in 1..=settings.repeats.get() {
                lines.extend([format!("FN 0: Q21 = +{repeat}"), "CALL LBL 10".to_owned()]);
            }
        }
    }
}

/// The subprogram of a touch.
fn touch(job: &Job<'_>) -> Vec<String> {
    let settings = job.settings;
    let letters: Vec<&str> = job.program.linear().map(|(_, axis)| axis.letter.as_str()).collect();
    let place = |letter: &str| "XYZ".find(letter).unwrap_or_default();
    let direction: Vec<String> = letters.iter().map(|letter| format!("I{letter}+Q{}", 22 + place(letter))).collect();
    let beginning: Vec<String> = letters.iter().map(|letter| format!("{letter}+Q{}", 26 + place(letter))).collect();
    let probe = |speed: f64, distance: &str, back: &str| {
        vec![
            "TCH PROBE 4.0 MEASURING IN 3-D".to_owned(),
            "TCH PROBE 4.1 Q1".to_owned(),
            format!("TCH PROBE 4.2 {}", direction.join(" ")),
            format!("TCH PROBE 4.3 ABST+{distance} F{} MB{back} REFERENCE SYSTEM:1", feed(job, speed)),
            "FN 9: IF +Q4 EQU -1 GOTO LBL 12".to_owned(),
        ]
    };
    let mut lines = ["LBL 10", "FN 0: Q30 = +0", "LBL 11"].map(str::to_owned).to_vec();
    if let Some(search) = settings.search_feed_mm_per_min {
        lines.extend(probe(search, "Q25", &job.length(settings.back_off_mm)));
    }
    // From beside the surface that was found no further than a touch may go.
    let rest = match settings.search_feed_mm_per_min {
        Some(_) => job.length(settings.back_off_mm + settings.overtravel_mm),
        None => "Q25".to_owned(),
    };
    lines.extend(probe(settings.measuring_feed_mm_per_min, &rest, "+Q25"));
    let clock = settings.clock.as_deref().map(|clock| format!("FN 0: Q32 = +{clock}"));
    lines.push("FN 0: Q31 = +0".to_owned());
    lines.push(clock.unwrap_or_else(|| "FN 18: SYSREAD Q32 = ID320 NR1 IDX0".to_owned()));
    lines.extend(settings.temperature.iter().map(|value| format!("FN 0: Q33 = +{value}")));
    let home = format!("L {} R0 F{} M91", beginning.join(" "), feed(job, settings.positioning_feed_mm_per_min));
    lines.extend([
        printed(job, "HIT"),
        home.clone(),
        "FN 9: IF +0 EQU +0 GOTO LBL 13".to_owned(),
        "LBL 12".to_owned(),
        printed(job, "MISS"),
        home,
        "FN 1: Q30 = +Q30 + +1".to_owned(),
        format!("FN 12: IF +Q30 LT +{} GOTO LBL 11", settings.retries.get() + 1),
        "FN 1: Q31 = +Q31 + +1".to_owned(),
        format!("FN 12: IF +Q31 LT +{} GOTO LBL 13", settings.misses.get()),
        "FN 14: ERROR = 1000".to_owned(),
        "LBL 13".to_owned(),
        "LBL 0".to_owned(),
    ]);
    lines
}

/// The mask of the line of a hit.
fn hit(job: &Job<'_>) -> String {
    let (mut text, mut values) = ("T%6.0LF R%2.0LF H1".to_owned(), "Q20,Q21".to_owned());
    for (_, axis) in job.program.linear() {
        text.push_str(&format!(" {}%9.{}LF", axis.letter, job.decimals()));
        values.push_str(&format!(",Q{}", 1 + "XYZ".find(&axis.letter).unwrap_or_default()));
    }
    let all = job.program.axes.iter().filter(|axis| axis.kind == abbe_core::AxisKind::Rotary);
    for (index, axis) in all.enumerate().filter(|(_, axis)| !axis.is_spindle()) {
        text.push_str(&format!(" {}%9.4LF", axis.letter));
        values.push_str(&format!(",Q{}", 41 + index));
    }
    text.push_str(&format!(" F{} K%12.0LF", job.length(job.settings.measuring_feed_mm_per_min)));
    values.push_str(",Q32");
    if job.settings.temperature.is_some() {
        text.push_str(" J%6.2LF");
        values.push_str(",Q33");
    }
    format!("\"{text}\",{values};")
}
