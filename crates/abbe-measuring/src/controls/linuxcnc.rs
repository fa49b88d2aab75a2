//! LinuxCNC: `G38.3`, which leaves #5061 to #5069 and #5070, O-words, and `(LOG,...)`.

use abbe_core::{AxisKind, Error, ExportedFile, Result};

use super::{Job, file, number};
use crate::language::plain;
use crate::programme::{Block, ControlAxis, TouchBlock};

/// Work offsets with the number of the variable of their X.
const OFFSETS: [(&str, u32); 9] = [
    ("G54", 5221),
    ("G55", 5241),
    ("G56", 5261),
    ("G57", 5281),
    ("G58", 5301),
    ("G59", 5321),
    ("G59.1", 5341),
    ("G59.2", 5361),
    ("G59.3", 5381),
];

/// The letters of axes in the order of their variables.
const LETTERS: &str = "XYZABCUVW";

pub fn write(job: &Job<'_>) -> Result<Vec<ExportedFile>> {
    let wanted = job.settings.work_offset.as_deref().unwrap_or("G59.3");
    let Some((offset, variable)) = OFFSETS.iter().find(|(name, _)| *name == wanted) else {
        return Err(Error::usage(format!("LinuxCNC has no work offset {wanted}"))
            .setting("work_offset")
            .suggest(wanted, OFFSETS.iter().map(|(name, _)| *name)));
    };
    let mut lines: Vec<String> = job.introduction().iter().map(|line| format!("({})", plain(line))).collect();
    lines.extend(subroutines(job));
    let units = if job.in_inches() { "G20" } else { "G21" };
    lines.push(format!("{units} G17 G40 G49 G80 G90 G94"));
    lines.push((*offset).to_owned());
    let sum: Vec<String> = (0..10).map(|axis| format!("ABS[#{}]", variable + axis)).collect();
    lines.extend([
        format!("o<abbe_offset> if [[{}] GT 0.0000001]", sum.join(" + ")),
        format!("(ABORT,{offset} has to be zero in all axes and not turned)"),
        "o<abbe_offset> endif".to_owned(),
        "o<abbe_g92> if [#5210 NE 0]".to_owned(),
        "(ABORT,an offset of G92 is active: cancel it with G92.1)".to_owned(),
        "o<abbe_g92> endif".to_owned(),
        "#<_abbe_misses> = 0".to_owned(),
    ]);
    if !job.dry {
        lines.push(format!("(LOGOPEN,{})", job.settings.log.as_deref().unwrap_or("abbe.log")));
        lines.extend(job.header("LINUXCNC").iter().map(|line| format!("(LOG,{line})")));
    }
    lines.extend(job.settings.spindle_deg.map(|angle| format!("M19 R{}", number(angle.rem_euclid(360.0)))));
    lines.extend(["(MSG,the tip is clear of everything?)".to_owned(), "M0".to_owned()]);
    for block in &job.program.blocks {
        add(job, block, &mut lines);
    }
    if !job.dry {
        lines.extend(["(LOG,END)".to_owned(), "(LOGCLOSE)".to_owned()]);
    }
    lines.push("M2".to_owned());
    Ok(vec![file(format!("{}.ngc", job.name()), &lines)])
}

fn add(job: &Job<'_>, block: &Block, lines: &mut Vec<String>) {
    match block {
        Block::Note(text) => lines.push(format!("({})", plain(text))),
        Block::Pause(text) => lines.extend([format!("(MSG,{})", plain(text)), "M0".to_owned()]),
        Block::Orient(angle) => lines.push(format!("M19 R{}", number(angle.rem_euclid(360.0)))),
        Block::Settle(seconds) => lines.push(format!("G4 P{}", number(*seconds))),
        Block::Swing(positions) => {
            let feed = number(job.settings.rotary_feed_deg_per_min);
            lines.push(format!("G1 {} F{feed}", job.words(positions, "")));
        }
        Block::Move(positions) => {
            let feed = job.length(job.settings.positioning_feed_mm_per_min);
            lines.push(format!("G38.3 {} F{feed}", job.words(positions, "")));
            lines.push("o<abbe_watch> call".to_owned());
        }
        Block::Touch(TouchBlock { number: touch, approach, end, back, .. }) => {
            let values =
                end.iter().chain(approach).chain(back).map(|(axis, value)| format!("[{}]", job.place(*axis, *value)));
            let values = values.collect::<Vec<_>>().join(" ");
            for repeat in 1..=job.settings.repeats.get() {
                lines.push(format!("o<abbe_touch> call [{touch}] [{repeat}] {values}"));
            }
        }
    }
}

/// The subroutines: a look whether a move met something, and a touch.
fn subroutines(job: &Job<'_>) -> Vec<String> {
    let mut lines = vec![
        "o<abbe_watch> sub".to_owned(),
        "o<abbe_met> if [#5070 NE 0]".to_owned(),
        "(ABORT,the probe met something on its way)".to_owned(),
        "o<abbe_met> endif".to_owned(),
        "o<abbe_watch> endsub".to_owned(),
    ];
    if job.dry {
        return lines;
    }
    let settings = job.settings;
    let linear: Vec<&str> = job.program.linear().map(|(_, axis)| axis.letter.as_str()).collect();
    // Arguments: touch, repeat, then the positions of its end, of its beginning, and the way back.
    let words = |first: usize| -> String {
        let words = linear.iter().enumerate().map(|(index, letter)| format!("{letter}#{}", first + index));
        words.collect::<Vec<_>>().join(" ")
    };
    let (end, beginning, back) = (words(3), words(3 + linear.len()), words(3 + 2 * linear.len()));
    let slow = job.length(settings.measuring_feed_mm_per_min);
    let fast = job.length(settings.positioning_feed_mm_per_min);
    lines.extend([
        "o<abbe_touch> sub".to_owned(),
        "#<tried> = 0".to_owned(),
        "#<hit> = 0".to_owned(),
        format!("o<abbe_try> while [[#<hit> EQ 0] AND [#<tried> LE {}]]", settings.retries.get()),
    ]);
    match settings.search_feed_mm_per_min {
        None => lines.push(format!("G38.3 {end} F{slow}")),
        Some(search) => lines.extend([
            format!("G38.3 {end} F{}", job.length(search)),
            "o<abbe_found> if [#5070 NE 0]".to_owned(),
            format!("G91 G1 {back} F{fast}"),
            "G90".to_owned(),
            format!("G38.3 {end} F{slow}"),
            "o<abbe_found> endif".to_owned(),
        ]),
    }
    lines.extend([
        "#<hit> = #5070".to_owned(),
        "o<abbe_hit> if [#<hit> NE 0]".to_owned(),
        format!("(LOG,T%d#1 R%d#2 H1 {} F{slow}{})", logged(job), extras(job)),
        "#<_abbe_misses> = 0".to_owned(),
        "o<abbe_hit> else".to_owned(),
        "(LOG,T%d#1 R%d#2 H0)".to_owned(),
        "o<abbe_hit> endif".to_owned(),
        format!("G1 {beginning} F{fast}"),
        "#<tried> = [#<tried> + 1]".to_owned(),
        "o<abbe_try> endwhile".to_owned(),
        "o<abbe_missed> if [#<hit> EQ 0]".to_owned(),
        "#<_abbe_misses> = [#<_abbe_misses> + 1]".to_owned(),
        "o<abbe_missed> endif".to_owned(),
        format!("o<abbe_lost> if [#<_abbe_misses> GE {}]", settings.misses.get()),
        "(ABORT,too many misses one after the other: is the artefact where the plan has it?)".to_owned(),
        "o<abbe_lost> endif".to_owned(),
        "o<abbe_touch> endsub".to_owned(),
    ]);
    let temperature = settings.temperature.iter().map(|value| format!("#<temperature> = {value}"));
    let clock = settings.clock.iter().map(|value| format!("#<clock> = {value}"));
    let at = lines.iter().position(|line| line == "#<hit> = #5070").map_or(lines.len(), |at| at + 1);
    lines.splice(at..at, clock.chain(temperature));
    lines
}

/// The positions at the trigger.
fn logged(job: &Job<'_>) -> String {
    let axes = job.program.axes.iter().filter(|axis| axis.kind == AxisKind::Linear || !axis.is_spindle());
    let word = |axis: &ControlAxis| {
        let variable = LETTERS.find(&axis.letter).unwrap_or_default() + 5061;
        let decimals = if axis.kind == AxisKind::Linear { job.decimals() } else { 4 };
        format!("{}%.{decimals}f#{variable}", axis.letter)
    };
    axes.map(word).collect::<Vec<_>>().join(" ")
}

/// Clock and temperature.
fn extras(job: &Job<'_>) -> String {
    let clock = job.settings.clock.as_ref().map_or("", |_| " K%.3f#<clock>");
    let temperature = job.settings.temperature.as_ref().map_or("", |_| " J%.2f#<temperature>");
    format!("{clock}{temperature}")
}
