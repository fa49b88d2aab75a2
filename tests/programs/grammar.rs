//! Random programs in the manner of each control: lines and arcs in three planes, helices, relative blocks, inches, inverse time.

mod klartext;

use std::f64::consts::{PI, TAU};
use std::fmt::Write as _;

use abbe_controllers::Dialect;

use crate::controls::law::uniform;

const AXES: [&str; 3] = ["X", "Y", "Z"];

pub struct Wanted {
    pub dialect: Dialect,
    /// Letters of rotary axes.
    pub rotary: &'static [&'static str],
    /// Whether the tip is programmed.
    pub tip: bool,
    pub blocks: usize,
}

struct Writer {
    wanted: Wanted,
    random: Box<dyn FnMut() -> f64>,
    text: String,
    at: [f64; 3],
    turned: Vec<f64>,
    relative: bool,
    motion: u32,
    number: usize,
}

/// A program of a seed.
pub fn program(wanted: Wanted, seed: u64) -> String {
    let turned = vec![0.0; wanted.rotary.len()];
    let mut writer = Writer {
        random: Box::new(uniform(seed)),
        text: String::new(),
        at: [0.0, 0.0, 60.0],
        turned,
        relative: false,
        motion: 0,
        number: 0,
        wanted,
    };
    if writer.wanted.dialect == Dialect::Heidenhain {
        klartext::write(&mut writer);
        return writer.text;
    }
    writer.head();
    for _ in 0..writer.wanted.blocks {
        writer.something();
    }
    writer.tail();
    writer.text
}

fn rounded(value: f64) -> f64 {
    (value * 1e3).round() / 1e3 + 0.0
}

impl Writer {
    fn within(&mut self, from: f64, to: f64) -> f64 {
        rounded(from + (self.random)() * (to - from))
    }

    fn chance(&mut self, part: f64) -> bool {
        (self.random)() < part
    }

    fn block(&mut self, words: &str) {
        let dialect = self.wanted.dialect;
        self.number += 10;
        let mut line = String::new();
        if self.chance(0.5) {
            let _ = write!(line, "N{} ", self.number);
        }
        line.push_str(words);
        if self.chance(0.15) {
            line.push_str(match dialect {
                Dialect::Siemens => " ; as G1 X99 was",
                _ => " (as G1 X99 was)",
            });
        }
        let is_free = matches!(dialect, Dialect::Linuxcnc | Dialect::Grbl);
        if is_free && self.chance(0.1) && !line.contains('(') {
            line = line.replace(' ', "").to_lowercase();
        }
        self.text.push_str(&line);
        self.text.push('\n');
    }

    fn head(&mut self) {
        let dialect = self.wanted.dialect;
        match dialect {
            Dialect::Fanuc | Dialect::Iso => self.text.push_str("%\nO1234 (RANDOM)\nG21 G17 G40 G90 G54\n"),
            Dialect::Siemens => self.text.push_str("; random\nG71 G17 G90 G54\n"),
            _ => self.text.push_str("G21 G17 G90 G54 G94\n"),
        }
        let rotary: String = self.wanted.rotary.iter().map(|axis| format!(" {axis}0.")).collect();
        if self.wanted.tip {
            let on = if dialect == Dialect::Siemens { "T=\"MILL\" D1\nTRAORI" } else { "G43.4 H2" };
            if dialect == Dialect::Siemens {
                self.text.push_str(&format!("{on}\nG0 X0. Y0. Z60.{rotary}\n"));
            } else {
                self.text.push_str(&format!("G0 X0. Y0.{rotary}\n{on} Z60.\n"));
            }
        } else {
            self.text.push_str(&format!("G0 X0. Y0. Z60.{rotary}\n"));
        }
        let first = format!("G1 Z{:.3} F500.", self.at[2] - 5.0);
        self.at[2] -= 5.0;
        self.motion = 1;
        self.block(&first);
    }

    fn tail(&mut self) {
        if self.relative {
            self.block("G90");
        }
        if self.wanted.tip {
            let off = if self.wanted.dialect == Dialect::Siemens { "TRAFOOF" } else { "G49" };
            self.block(off);
        }
        self.block("M30");
    }

    fn something(&mut self) {
        let choice = (self.random)();
        match choice {
            _ if choice < 0.45 => self.line(),
            _ if choice < 0.80 => self.arc(),
            _ if choice < 0.88 => {
                self.relative = !self.relative;
                let code = if self.relative { "G91" } else { "G90" };
                self.block(code);
            }
            _ if choice < 0.93 => self.inverse(),
            _ => self.rapid(),
        }
    }

    /// A word of a position.
    fn word(&self, axis: &str, from: f64, to: f64) -> String {
        format!("{axis}{:.3}", if self.relative { to - from } else { to })
    }

    fn code(&mut self, motion: u32) -> String {
        let is_modal = self.motion == motion && self.chance(0.7);
        self.motion = motion;
        if is_modal { String::new() } else { format!("G{motion} ") }
    }

    fn target(&mut self, words: &mut Vec<String>) {
        let named: Vec<bool> = (0..3).map(|_| self.chance(0.6)).collect();
        for axis in 0..3 {
            if !named[axis] && (axis < 2 || !words.is_empty() || named.contains(&true)) {
                continue;
            }
            let (from, low) = (self.at[axis], if axis == 2 { 0.0 } else { -60.0 });
            let to = self.within(low, low + 120.0 - if axis == 2 { 40.0 } else { 0.0 });
            words.push(self.word(AXES[axis], from, to));
            self.at[axis] = to;
        }
        for index in 0..self.turned.len() {
            if self.chance(0.5) {
                let from = self.turned[index];
                let to = rounded((from + self.within(-12.0, 12.0)).clamp(-40.0, 40.0));
                words.push(self.word(self.wanted.rotary[index], from, to));
                self.turned[index] = to;
            }
        }
    }

    fn line(&mut self) {
        let mut words = Vec::new();
        self.target(&mut words);
        let code = self.code(1);
        let feed = if self.chance(0.2) { " F600." } else { "" };
        self.block(&format!("{code}{}{feed}", words.join(" ")));
    }

    fn inverse(&mut self) {
        let mut words = Vec::new();
        self.target(&mut words);
        if self.wanted.dialect == Dialect::Iso {
            self.motion = 1;
            return self.block(&format!("G1 {}", words.join(" ")));
        }
        self.motion = 1;
        self.block(&format!("G93 G1 {} F12.5", words.join(" ")));
        self.block("G94 F500.");
    }

    fn rapid(&mut self) {
        let (x, y) = (self.within(-60.0, 60.0), self.within(-60.0, 60.0));
        let words = [self.word("X", self.at[0], x), self.word("Y", self.at[1], y)].join(" ");
        (self.at[0], self.at[1]) = (x, y);
        self.motion = 0;
        self.block(&format!("G0 {words}"));
    }

    fn arc(&mut self) {
        let plane = ((self.random)() * 3.0) as usize % 3;
        let (i, j) = [(0, 1), (2, 0), (1, 2)][plane];
        let against = self.chance(0.5);
        let radius = self.within(1.0, 25.0);
        let begin = (self.random)() * TAU;
        let centre = [rounded(self.at[i] - radius * begin.cos()), rounded(self.at[j] - radius * begin.sin())];
        let short = self.chance(0.4);
        let turn = if short { 0.3 + 2.5 * (self.random)() } else { 0.3 + 5.8 * (self.random)() };
        let is_whole = !short && self.chance(0.15);
        let turn = if against { turn } else { -turn };
        let start = [self.at[i] - centre[0], self.at[j] - centre[1]];
        let (own, angle) = (start[0].hypot(start[1]), start[1].atan2(start[0]) + turn);
        let mut end = [rounded(centre[0] + own * angle.cos()), rounded(centre[1] + own * angle.sin())];
        if is_whole {
            end = [self.at[i], self.at[j]];
        }
        let low = |axis: usize| if axis == 2 { -40.0 } else { -110.0 };
        let reach = [centre[0] - own, centre[0] + own, centre[1] - own, centre[1] + own];
        if reach[0] < low(i) || reach[1] > 110.0 || reach[2] < low(j) || reach[3] > 110.0 {
            return self.line();
        }
        let third = 3 - i - j;
        let mut words = vec![self.word(AXES[i], self.at[i], end[0]), self.word(AXES[j], self.at[j], end[1])];
        if self.chance(0.3) {
            let to = rounded((self.at[third] + self.within(-3.0, 3.0)).clamp(low(third), 80.0));
            words.push(self.word(AXES[third], self.at[third], to));
            self.at[third] = to;
        }
        let letters = ["I", "J", "K"];
        if !is_whole && self.chance(0.35) && (turn.abs() - PI).abs() > 0.2 {
            let sign = if turn.abs() < PI { "" } else { "-" };
            let letter = if self.wanted.dialect == Dialect::Siemens { "CR=" } else { "R" };
            words.push(format!("{letter}{sign}{own:.6}"));
        } else {
            words.push(format!("{}{:.3}", letters[i], centre[0] - self.at[i]));
            words.push(format!("{}{:.3}", letters[j], centre[1] - self.at[j]));
        }
        (self.at[i], self.at[j]) = (end[0], end[1]);
        self.block(["G17", "G18", "G19"][plane]);
        let code = self.code(if against { 3 } else { 2 });
        self.block(&format!("{code}{}", words.join(" ")));
    }
}
