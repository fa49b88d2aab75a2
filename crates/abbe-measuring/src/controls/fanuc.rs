//! Fanuc and Haas: `G31` stops at the skip signal and leaves where in #5061 to #5063, in the work offset that is active; without a
//! signal these hold the end of the block. `DPRNT` writes the log to the port that `POPEN` opened.

use abbe_core::{AxisKind, Error, ExportedFile, Result};

use super::{Job, file, number};
use crate::language::fanuc::{
    STOPPED_MM, alarm, guarded, remark, skipped, stop, until_contact, was_stopped, zero_offset,
};
use crate::language::plain;
use crate::programme::{Block, Positions, TouchBlock};

/// Arguments of the macro call for X, Y and Z: the end of the touch, its beginning, the way back; with their local variables.
const ARGUMENTS: [[(&str, u32); 3]; 3] =
    [[("X", 24), ("Y", 25), ("Z", 26)], [("U", 21), ("V", 22), ("W", 23)], [("Q", 17), ("R", 18), ("S", 19)]];

/// Variables that the programs use: misses one after the other, then where rotary axes stand.
const MISSES: u32 = 140;

/// Numbers of the programs.
const MAIN: u32 = 9910;

pub fn write(job: &Job<'_>) -> Result<Vec<ExportedFile>> {
    if let Some((_, axis)) = job.program.linear().find(|(_, axis)| !"XYZ".contains(&axis.letter)) {
        let message = format!("`G31` along {}: the first three axes of the control are X, Y and Z", axis.letter);
        return Err(Error::usage(message).setting("axis_names"));
    }
    let settings = job.settings;
    let program = if job.dry { MAIN + 2 } else { MAIN };
    let mut lines = vec!["%".to_owned(), format!("O{program:04}(ABBE {})", plain(job.name()).to_uppercase())];
    lines.extend(job.introduction().iter().map(|line| remark(line)));
    let units = if job.in_inches() { "G20" } else { "G21" };
    lines.push(format!("{units} G17 G40 G49 G80 G90 G94"));
    lines.push(settings.work_offset.clone().unwrap_or_else(|| "G59".to_owned()));
    lines.extend(zero_offset(&alarm(105, "work offset is not zero")));
    lines.push(format!("#{MISSES}=0"));
    if !job.dry {
        lines.push("POPEN".to_owned());
        lines.extend(job.header("FANUC").iter().map(|line| format!("DPRNT[{}]", line.replace(' ', "*"))));
    }
    if settings.spindle_deg.is_some_and(|angle| angle != 0.0) {
        let error = Error::usage("the angle at which M19 stops the spindle is a parameter of the control");
        return Err(error.setting("spindle_deg").help("set the parameter, and write `spindle_deg: 0` here"));
    }
    lines.extend(settings.spindle_deg.map(|_| "M19".to_owned()));
    lines.push(stop("tip clear of everything"));
    for block in &job.program.blocks {
        add(job, block, &mut lines)?;
    }
    if !job.dry {
        lines.extend(["DPRNT[END]".to_owned(), "PCLOS".to_owned()]);
    }
    lines.push("M30".to_owned());
    if !job.dry {
        lines.extend(touch(job));
    }
    lines.push("%".to_owned());
    Ok(vec![file(format!("O{program:04}.nc"), &lines)])
}

fn add(job: &Job<'_>, block: &Block, lines: &mut Vec<String>) -> Result<()> {
    let settings = job.settings;
    match block {
        Block::Note(text) => lines.push(remark(text)),
        Block::Pause(text) => lines.push(stop(text)),
        Block::Orient(_) => {
            return Err(Error::usage("`M19` has one angle only, and this plan orients the spindle"));
        }
        // Milliseconds, without a point: so on Fanuc and on Haas.
        Block::Settle(seconds) => lines.push(format!("G4 P{:.0}", (seconds * 1e3).max(1.0))),
        Block::Swing(positions) => {
            lines.push(format!("G1 {} F{}", job.words(positions, ""), number(settings.rotary_feed_deg_per_min)));
        }
        Block::Move(positions) => {
            let ends = |(axis, place): &(usize, f64)| (job.axis(*axis).letter.as_str(), job.place(*axis, *place));
            let axes: Vec<(&str, String)> = positions.iter().map(ends).collect();
            let [feed, stopped] = [settings.positioning_feed_mm_per_min, STOPPED_MM].map(|mm| job.length(mm));
            lines.extend(guarded("G31", &axes, [&feed, &stopped], &alarm(103, "obstacle on the way")));
        }
        Block::Touch(TouchBlock { number: touch, approach, end, back, rotary }) => {
            for (index, (_, place)) in rotary.iter().enumerate() {
                lines.push(format!("#{}={}", MISSES as usize + 1 + index, number(*place)));
            }
            let arguments = |positions: &Positions, names: &[(&str, u32); 3]| -> Vec<String> {
                let argument = |(axis, value): &(usize, f64)| {
                    let place = "XYZ".find(&job.axis(*axis).letter).unwrap_or_default();
                    format!("{}{}", names[place].0, job.place(*axis, *value))
                };
                positions.iter().map(argument).collect()
            };
            let all = [end, approach, back].into_iter().zip(&ARGUMENTS);
            let all: Vec<String> = all.flat_map(|(positions, names)| arguments(positions, names)).collect();
            for repeat in 1..=settings.repeats.get() {
                lines.push(format!("G65 P{} A{touch}.0 B{repeat}.0 {}", MAIN + 1, all.join(" ")));
            }
        }
    }
    Ok(())
}

/// The macro of a touch: #1 its number, #2 the repeat, #30 attempts, #31 whether there was contact.
fn touch(job: &Job<'_>) -> Vec<String> {
    let settings = job.settings;
    let used: Vec<usize> = job.program.linear().filter_map(|(_, axis)| "XYZ".find(&axis.letter)).collect();
    let words = |of: &[(&str, u32); 3]| -> String {
        let word = |place: &usize| format!("{}#{}", &"XYZ"[*place..=*place], of[*place].1);
        used.iter().map(word).collect::<Vec<_>>().join(" ")
    };
    let (end, beginning, back) = (words(&ARGUMENTS[0]), words(&ARGUMENTS[1]), words(&ARGUMENTS[2]));
    let fast = job.length(settings.positioning_feed_mm_per_min);
    let stopped = job.length(STOPPED_MM);
    let attempts = settings.retries.get() + 1;
    let probe = |feed: f64| -> Vec<String> {
        let mut lines = vec![until_contact("G31", &end, &job.length(feed)), "#31=0".to_owned()];
        lines.extend(used.iter().map(|place| {
            let skipped = format!("#{}", 5061 + place);
            format!("IF {} THEN #31=1", was_stopped(&skipped, &format!("#{}", ARGUMENTS[0][*place].1), &stopped))
        }));
        lines
    };
    let mut lines = vec![format!("O{:04}(ABBE TOUCH)", MAIN + 1), "#30=0".to_owned()];
    lines.push(format!("WHILE [#30 LT {attempts}] DO1"));
    if let Some(search) = settings.search_feed_mm_per_min {
        lines.extend(probe(search));
        lines.push("IF [#31 LT 0.5] GOTO 20".to_owned());
        lines.extend([format!("G91 G1 {back} F{fast}"), "G90".to_owned()]);
    }
    lines.extend(probe(settings.measuring_feed_mm_per_min));
    lines.extend(["N20".to_owned(), "IF [#31 GT 0.5] GOTO 30".to_owned()]);
    lines.extend(["DPRNT[T#1[60]*R#2[20]*H0]".to_owned(), "GOTO 40".to_owned(), "N30".to_owned()]);
    lines.push(format!("#32={}", settings.clock.as_deref().unwrap_or("#3001/1000")));
    lines.extend(settings.temperature.iter().map(|value| format!("#33={value}")));
    lines.push(logged(job));
    lines.extend([
        format!("#30={attempts}"),
        "N40".to_owned(),
        format!("G1 {beginning} F{fast}"),
        "#30=#30+1".to_owned(),
        "END1".to_owned(),
        format!("IF [#31 LT 0.5] THEN #{MISSES}=#{MISSES}+1"),
        format!("IF [#31 GT 0.5] THEN #{MISSES}=0"),
        format!("IF [#{MISSES} GE {}] THEN {}", settings.misses.get(), alarm(106, "too many misses")),
        "M99".to_owned(),
    ]);
    lines
}

/// The line of a hit: trigger positions of linear axes, and where rotary axes stand.
fn logged(job: &Job<'_>) -> String {
    let mut line = "DPRNT[T#1[60]*R#2[20]*H1".to_owned();
    for (_, control) in job.program.linear() {
        let format = if job.in_inches() { "[35]" } else { "[44]" };
        line.push_str(&format!("*{}{}{format}", control.letter, skipped(&control.letter).unwrap_or_default()));
    }
    let rotary = job.program.axes.iter().filter(|axis| axis.kind == AxisKind::Rotary);
    for (index, control) in rotary.enumerate().filter(|(_, axis)| !axis.is_spindle()) {
        line.push_str(&format!("*{}#{}[44]", control.letter, MISSES as usize + 1 + index));
    }
    line.push_str(&format!("*F{}*K#32[73]", job.length(job.settings.measuring_feed_mm_per_min)));
    line.push_str(job.settings.temperature.as_ref().map_or("]", |_| "*J#33[42]]"));
    line
}
