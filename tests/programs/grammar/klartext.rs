//! Random programs in plain text of Heidenhain.

use std::f64::consts::{PI, TAU};

use super::{AXES, Writer};

struct Klartext<'a> {
    of: &'a mut Writer,
    is_numbered: bool,
    /// Steps of numbers and lengths of a program, in its unit.
    digits: f64,
    mm: f64,
    is_tip: bool,
}

/// Writes a program.
pub fn write(of: &mut Writer) {
    let (is_numbered, in_inches) = (of.chance(0.7), of.chance(0.3));
    let (digits, mm) = if in_inches { (1e4, 1.0 / 25.4) } else { (1e3, 1.0) };
    of.at = of.at.map(|at| (at * mm * digits).round() / digits);
    let mut klartext = Klartext { of, is_numbered, digits, mm, is_tip: false };
    klartext.program(if in_inches { "INCH" } else { "MM" });
}

impl Klartext<'_> {
    fn rounded(&self, value: f64) -> f64 {
        (value * self.digits).round() / self.digits + 0.0
    }

    /// A position between two lengths in mm.
    fn within(&mut self, from: f64, to: f64) -> f64 {
        let value = (from + (self.of.random)() * (to - from)) * self.mm;
        self.rounded(value)
    }

    fn block(&mut self, words: &str) {
        let number = self.of.number;
        self.of.number += 1;
        if self.is_numbered {
            self.of.text.push_str(&format!("{number} "));
        }
        self.of.text.push_str(words);
        if self.of.chance(0.15) {
            self.of.text.push_str(" ; as G1 X99 was");
        }
        self.of.text.push('\n');
    }

    fn program(&mut self, unit: &str) {
        self.block(&format!("BEGIN PGM RANDOM {unit}"));
        self.block("BLK FORM 0.1 Z X-50 Y-50 Z-20");
        self.block("BLK FORM 0.2 X+50 Y+50 Z+0");
        self.block("* - the only part");
        self.block("TOOL CALL 2 Z S3000 F500 DR+0.1");
        let start = self.everywhere();
        self.block(&format!("L{start} R0 FMAX M3"));
        if self.of.wanted.tip {
            let by_function = self.of.chance(0.4);
            self.block(if by_function { "FUNCTION TCPM F TCP AXIS POS PATHCTRL AXIS" } else { "M128 F2000" });
            self.is_tip = !by_function;
        }
        self.of.at[2] = self.rounded(self.of.at[2] - 5.0 * self.mm);
        let start = self.everywhere();
        self.block(&format!("L{start} F500"));
        for _ in 0..self.of.wanted.blocks {
            self.something();
        }
        if self.of.wanted.tip {
            self.block(if self.is_tip { "M129" } else { "FUNCTION RESET TCPM" });
        }
        self.block("M30");
        self.block(&format!("END PGM RANDOM {unit}"));
    }

    /// Words of all axes where they are.
    fn everywhere(&self) -> String {
        let linear = AXES.iter().zip(self.of.at).map(|(axis, at)| format!(" {axis}{at:+.4}"));
        let rotary = self.of.wanted.rotary.iter().zip(&self.of.turned).map(|(axis, at)| format!(" {axis}{at:+.3}"));
        linear.chain(rotary).collect()
    }

    fn word(&mut self, axis: &str, from: f64, to: f64) -> String {
        if self.of.chance(0.2) { format!(" I{axis}{:+.4}", to - from) } else { format!(" {axis}{to:+.4}") }
    }

    fn something(&mut self) {
        let choice = (self.of.random)();
        match choice {
            _ if choice < 0.45 => self.line(),
            _ if choice < 0.80 => self.arc(),
            _ if choice < 0.84 => self.block("L F550"),
            _ if choice < 0.88 => self.again(),
            _ => self.rapid(),
        }
    }

    fn line(&mut self) {
        let mut words = String::new();
        for (axis, letter) in AXES.iter().enumerate().take(3) {
            if axis == 0 || self.of.chance(0.6) {
                let (low, high) = if axis == 2 { (0.0, 80.0) } else { (-60.0, 60.0) };
                let (from, to) = (self.of.at[axis], self.within(low, high));
                words.push_str(&self.word(letter, from, to));
                self.of.at[axis] = to;
            }
        }
        for index in 0..self.of.turned.len() {
            if self.of.chance(0.5) {
                let from = self.of.turned[index];
                let to = super::rounded((from + (self.of.random)() * 24.0 - 12.0).clamp(-40.0, 40.0));
                words.push_str(&self.word(self.of.wanted.rotary[index], from, to));
                self.of.turned[index] = to;
            }
        }
        let end = ["", " R0", " F600", " R0 F600 M8", " M9"][((self.of.random)() * 5.0) as usize % 5];
        self.block(&format!("L{words}{end}"));
    }

    /// The tip is programmed no longer, and then again.
    fn again(&mut self) {
        if !self.is_tip {
            return self.line();
        }
        self.of.at[1] = self.within(-60.0, 60.0);
        let here = self.everywhere();
        self.block(&format!("L{here} M129"));
        self.of.turned.fill(0.0);
        let here = self.everywhere();
        self.block(&format!("L{here} R0 FMAX"));
        self.of.at[0] = self.within(-60.0, 60.0);
        let here = self.everywhere();
        self.block(&format!("L{here} F500 M128"));
    }

    fn rapid(&mut self) {
        let mut words = String::new();
        for (axis, letter) in AXES.iter().enumerate().take(2) {
            let (from, to) = (self.of.at[axis], self.within(-60.0, 60.0));
            words.push_str(&self.word(letter, from, to));
            self.of.at[axis] = to;
        }
        self.block(&format!("L{words} R0 F MAX"));
    }

    fn arc(&mut self) {
        let at = self.of.at;
        let against = self.of.chance(0.5);
        let radius = self.within(1.0, 25.0);
        let begin = (self.of.random)() * TAU;
        let centre = [self.rounded(at[0] - radius * begin.cos()), self.rounded(at[1] - radius * begin.sin())];
        let turn = (0.3 + 5.8 * (self.of.random)()) * if against { 1.0 } else { -1.0 };
        let is_whole = self.of.chance(0.1);
        let start = [at[0] - centre[0], at[1] - centre[1]];
        let (own, angle) = (start[0].hypot(start[1]), start[1].atan2(start[0]) + turn);
        let mut end = [self.rounded(centre[0] + own * angle.cos()), self.rounded(centre[1] + own * angle.sin())];
        if is_whole {
            end = [at[0], at[1]];
        }
        if (0..2).any(|axis| (centre[axis].abs() + own) > 110.0 * self.mm) {
            return self.line();
        }
        let words: String = (0..2).map(|axis| self.word(AXES[axis], at[axis], end[axis])).collect();
        let sense = if against { "DR+" } else { "DR-" };
        let has_radius = !is_whole && self.of.chance(0.35) && (turn.abs() - PI).abs() > 0.2;
        (self.of.at[0], self.of.at[1]) = (end[0], end[1]);
        if has_radius {
            let sign = if turn.abs() < PI { "+" } else { "-" };
            return self.block(&format!("CR{words} R{sign}{own:.6} {sense} R0"));
        }
        let centre: String = (0..2).map(|axis| self.word(AXES[axis], at[axis], centre[axis])).collect();
        self.block(&format!("CC{centre}"));
        self.block(&format!("C{words} {sense}"));
    }
}
