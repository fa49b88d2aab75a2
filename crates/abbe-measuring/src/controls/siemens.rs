//! Siemens SINUMERIK: `MEAS` ends a block where the probe triggers, `$AC_MEA` tells whether it did, `$AA_MM` where in machine
//! coordinates; `SUPA` suppresses all offsets. `WRITE` appends to the log.

use abbe_core::{ExportedFile, Result};

use super::{Job, file, number};
use crate::language::siemens::{self, alarm, measured, remark, stop, to, touched, until_contact};
use crate::programme::{Block, TouchBlock};

/// The measuring input of the probe.
const INPUT: u32 = 1;

/// The R parameter that counts misses one after the other.
const MISSES: &str = "R990";

/// The number of the control's clock in seconds, within a month.
const CLOCK: &str = "$A_DAY*86400+$A_HOUR*3600+$A_MINUTE*60+$A_SECOND";

pub fn write(job: &Job<'_>) -> Result<Vec<ExportedFile>> {
    let settings = job.settings;
    let mut lines: Vec<String> = job.introduction().iter().map(|line| remark(line)).collect();
    if !job.dry {
        let reals = vec!["REAL"; 3 * job.program.linear().count()];
        lines.push(format!("EXTERN ABBE_TOUCH(INT,INT,{})", reals.join(",")));
        lines.push("DEF INT _ERR=0".to_owned());
    }
    let units = if job.in_inches() { "G700" } else { "G710" };
    lines.extend(["TRAFOOF".to_owned(), format!("G17 G40 G90 G94 {units}"), "D0".to_owned()]);
    lines.push(format!("{MISSES}=0"));
    if !job.dry {
        lines.extend(job.header("SIEMENS").iter().map(|line| written(job, &format!("\"{line}\""))));
    }
    lines.extend(settings.spindle_deg.map(|angle| format!("SPOS={}", number(angle))));
    lines.extend(stop("Tip clear of everything"));
    for block in &job.program.blocks {
        add(job, block, &mut lines);
    }
    if !job.dry {
        lines.push(written(job, "\"END\""));
    }
    lines.push("M30".to_owned());
    let name = if job.dry { "ABBE_DRY_RUN.MPF" } else { "ABBE_MEASURE.MPF" };
    let mut files = vec![file(name.to_owned(), &lines)];
    if !job.dry {
        files.push(file("ABBE_WATCH.SPF".to_owned(), &watch()));
        files.push(file("ABBE_TOUCH.SPF".to_owned(), &touch(job)));
    }
    Ok(files)
}

fn add(job: &Job<'_>, block: &Block, lines: &mut Vec<String>) {
    let settings = job.settings;
    match block {
        Block::Note(text) => lines.push(remark(text)),
        Block::Pause(text) => lines.extend(stop(text)),
        Block::Orient(angle) => lines.push(format!("SPOS={}", number(*angle))),
        // Seconds; the feed of moves stays.
        Block::Settle(seconds) => lines.push(format!("G4 F{}", number(*seconds))),
        Block::Swing(positions) => {
            lines.push(to(&job.words(positions, "="), &number(settings.rotary_feed_deg_per_min)));
        }
        Block::Move(positions) => {
            let feed = job.length(settings.positioning_feed_mm_per_min);
            lines.push(until_contact(INPUT, &job.words(positions, "="), &feed));
            lines.push("ABBE_WATCH".to_owned());
        }
        Block::Touch(TouchBlock { number: touch, approach, end, back, .. }) => {
            let values = end.iter().chain(approach).chain(back).map(|(axis, value)| job.place(*axis, *value));
            let values = values.collect::<Vec<_>>().join(",");
            for repeat in 1..=settings.repeats.get() {
                lines.push(format!("ABBE_TOUCH({touch},{repeat},{values})"));
            }
        }
    }
}

/// A line of the log: texts and values joined by `<<`.
fn written(job: &Job<'_>, text: &str) -> String {
    format!("WRITE(_ERR,\"{}\",{text})", job.settings.log.as_deref().unwrap_or("ABBE_LOG"))
}

/// Looks whether a move was stopped by the probe.
fn watch() -> Vec<String> {
    let mut lines = vec!["PROC ABBE_WATCH".to_owned()];
    lines.extend(siemens::watch(INPUT, 65010, "The probe met something on its way"));
    lines.push("M17".to_owned());
    lines
}

fn touch(job: &Job<'_>) -> Vec<String> {
    let settings = job.settings;
    let linear: Vec<&str> = job.program.linear().map(|(_, axis)| axis.letter.as_str()).collect();
    let parameters = ["E", "A", "B"]
        .map(|kind| linear.iter().map(|letter| format!("REAL _{kind}{letter}")).collect::<Vec<_>>().join(","));
    let words =
        |kind: &str| linear.iter().map(|letter| format!("{letter}=_{kind}{letter}")).collect::<Vec<_>>().join(" ");
    let back: Vec<String> = linear.iter().map(|letter| format!("{letter}=IC(_B{letter})")).collect();
    let (end, beginning, back) = (words("E"), words("A"), back.join(" "));
    let fast = job.length(settings.positioning_feed_mm_per_min);
    let attempts = settings.retries.get() + 1;
    let probe = |feed: f64| {
        [until_contact(INPUT, &end, &job.length(feed)), "STOPRE".to_owned(), format!("_HIT={}", touched(INPUT))]
    };
    let mut lines = vec![
        format!("PROC ABBE_TOUCH(INT _T,INT _R,{})", parameters.join(",")),
        "DEF INT _TRIED=0".to_owned(),
        "DEF INT _HIT=0".to_owned(),
        "DEF INT _ERR=0".to_owned(),
        "DEF REAL _K=0".to_owned(),
        "DEF REAL _J=0".to_owned(),
        format!("WHILE _TRIED<{attempts}"),
    ];
    if let Some(search) = settings.search_feed_mm_per_min {
        lines.extend(probe(search));
        lines.push("IF _HIT>=1".to_owned());
        lines.push(to(&back, &fast));
        lines.extend(probe(settings.measuring_feed_mm_per_min));
        lines.push("ENDIF".to_owned());
    } else {
        lines.extend(probe(settings.measuring_feed_mm_per_min));
    }
    lines.push(format!("_K={}", settings.clock.as_deref().unwrap_or(CLOCK)));
    lines.extend(settings.temperature.iter().map(|value| format!("_J={value}")));
    lines.push("IF _HIT>=1".to_owned());
    lines.push(written(job, &logged(job)));
    lines.extend([format!("_TRIED={attempts}"), format!("{MISSES}=0"), "ELSE".to_owned()]);
    lines.push(written(job, "\"T\"<<_T<<\" R\"<<_R<<\" H0\""));
    lines.extend([
        "_TRIED=_TRIED+1".to_owned(),
        "ENDIF".to_owned(),
        to(&beginning, &fast),
        "ENDWHILE".to_owned(),
        "IF _HIT<1".to_owned(),
        format!("{MISSES}={MISSES}+1"),
        "ENDIF".to_owned(),
        format!("IF {MISSES}>={}", settings.misses.get()),
    ]);
    lines.extend(alarm(65011, "Too many misses: is the artefact where the plan has it"));
    lines.extend(["ENDIF".to_owned(), "M17".to_owned()]);
    lines
}

fn logged(job: &Job<'_>) -> String {
    let steps = 10_usize.pow(job.decimals() as u32);
    let mut text = "\"T\"<<_T<<\" R\"<<_R<<\" H1\"".to_owned();
    let mut add = |letter: &str, value: String| text.push_str(&format!("<<\" {letter}\"<<{value}"));
    job.program.linear().for_each(|(_, axis)| {
        add(&axis.letter, format!("ROUND({}*{steps})/{steps}", measured(&axis.letter)));
    });
    job.program.rotary().for_each(|(_, axis)| {
        add(&axis.letter, format!("ROUND($AA_IM[{}]*10000)/10000", axis.letter));
    });
    add("F", job.length(job.settings.measuring_feed_mm_per_min));
    add("K", "_K".to_owned());
    if job.settings.temperature.is_some() {
        add("J", "ROUND(_J*100)/100".to_owned());
    }
    text
}
