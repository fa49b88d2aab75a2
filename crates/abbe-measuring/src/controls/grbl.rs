//! grbl and its relatives: `G38.3` stops where the probe triggers and answers `[PRB:x,y,z:1]` in machine coordinates, or `:0`. There are
//! no conditions: after a move that met something, the probe is triggered, and the next `G38.3` is alarm 4, which ends the program.

use abbe_core::{Error, ExportedFile, Result};

use super::{Job, file, number};
use crate::language::plain;
use crate::programme::{Block, TouchBlock};

/// Work offsets with the numbers that `G10 L2` has for them.
const OFFSETS: [&str; 6] = ["G54", "G55", "G56", "G57", "G58", "G59"];

/// Touches that line numbers can name; grbl's line numbers end at 9,999,999.
const MOST: usize = 99_999;

pub fn write(job: &Job<'_>) -> Result<Vec<ExportedFile>> {
    let settings = job.settings;
    let refuse = |name: &str, what: &str| Err(Error::usage(format!("grbl has no {what}")).setting(name));
    if settings.spindle_deg.is_some() || job.program.blocks.iter().any(|block| matches!(block, Block::Orient(_))) {
        return refuse("spindle_deg", "orientation of the spindle");
    }
    if settings.temperature.is_some() {
        return refuse("temperature", "temperatures in programs");
    }
    if settings.clock.is_some() {
        return refuse("clock", "clock in programs");
    }
    if settings.retries.get() > 1 {
        return refuse(
            "retries",
            "conditions, so that a miss is not tried again: `retries: 1` is the default and does nothing",
        );
    }
    if job.program.blocks.iter().any(|block| matches!(block, Block::Touch(touch) if touch.number > MOST)) {
        return refuse("touches", "line numbers for so many touches");
    }
    let wanted = settings.work_offset.as_deref().unwrap_or("G59");
    let Some(offset) = OFFSETS.iter().position(|name| *name == wanted) else {
        return refuse("work_offset", &format!("work offset {wanted}"));
    };
    let mut lines: Vec<String> = Vec::new();
    if !job.dry {
        lines.extend(job.header("GRBL").iter().map(|line| format!("({line})")));
    }
    lines.extend(job.introduction().iter().map(|line| format!("({})", plain(line))));
    let zero: Vec<String> = job.program.axes.iter().map(|axis| format!("{}0", axis.letter)).collect();
    let units = if job.in_inches() { "G20" } else { "G21" };
    if job.in_inches() {
        lines.push("(the control has to report inches: $13=1)".to_owned());
    }
    lines.extend([format!("{units} G17 G40 G49 G80 G90 G94"), "G92.1".to_owned()]);
    lines.push(format!("(the work offset {wanted} becomes zero)"));
    lines.extend([format!("G10 L2 P{} {}", offset + 1, zero.join(" ")), wanted.to_owned()]);
    lines.extend(["(the tip is clear of everything?)".to_owned(), "M0".to_owned()]);
    for block in &job.program.blocks {
        add(job, block, &mut lines);
    }
    if !job.dry {
        lines.push("(END)".to_owned());
    }
    lines.push("M2".to_owned());
    Ok(vec![file(format!("{}.gcode", job.name()), &lines)])
}

fn add(job: &Job<'_>, block: &Block, lines: &mut Vec<String>) {
    let settings = job.settings;
    let fast = job.length(settings.positioning_feed_mm_per_min);
    match block {
        Block::Note(text) => lines.push(format!("({})", plain(text))),
        Block::Pause(text) => lines.extend([format!("({})", plain(text)), "M0".to_owned()]),
        Block::Orient(_) => {}
        Block::Settle(seconds) => lines.push(format!("G4 P{}", number(*seconds))),
        Block::Swing(positions) => {
            lines.push(format!("G1 {} F{}", job.words(positions, ""), number(settings.rotary_feed_deg_per_min)));
        }
        Block::Move(positions) => lines.push(format!("G38.3 {} F{fast}", job.words(positions, ""))),
        Block::Touch(TouchBlock { number: touch, approach, end, back, .. }) => {
            let end = job.words(end, "");
            for repeat in 1..=settings.repeats.get() {
                if let Some(search) = settings.search_feed_mm_per_min {
                    lines.push(format!("G38.3 {end} F{}", job.length(search)));
                    lines.push(format!("G91 G1 {} F{fast}", job.words(back, "")));
                    lines.push("G90".to_owned());
                }
                let slow = job.length(settings.measuring_feed_mm_per_min);
                lines.push(format!("N{} G38.3 {end} F{slow}", 100 * touch + repeat));
                lines.push(format!("G1 {} F{fast}", job.words(approach, "")));
            }
        }
    }
}
