//! Plain text of Heidenhain, read word by word: what the blocks of random and of corrected programs do. It panics at
//! all others, and where block numbers have gaps.

use super::{Block, Control, straight};
use crate::controls::law::ByAxis;

/// What a program has set besides the state of a control.
#[derive(Default)]
struct State {
    is_numbered: bool,
    /// The next block number.
    number: usize,
    /// CC: positions of the axes of the plane, mm.
    pole: ByAxis,
    shift: ByAxis,
    /// The length of the tool without DL.
    length: f64,
}

/// `X+10.5` as `X` and 10.5.
fn split(word: &str) -> (&str, f64) {
    let end = word.find(|letter: char| "+-.0123456789".contains(letter)).unwrap_or(word.len());
    let value = word[end..].parse().unwrap_or(f64::NAN);
    (&word[..end], value)
}

impl Control<'_> {
    /// Everything that a program in plain text moves.
    pub fn run_klartext(&mut self, text: &str) -> Vec<Block> {
        let mut state = State { length: self.length, ..State::default() };
        let mut blocks = Vec::new();
        let mut is_open = false;
        for (index, line) in text.lines().enumerate() {
            let (before, _) = line.split_once(';').unwrap_or((line, ""));
            let before = before.replace("F MAX", "FMAX");
            let mut words: Vec<&str> = before.split_whitespace().collect();
            let number = words.first().and_then(|first| first.parse::<usize>().ok());
            state.is_numbered |= index == 0 && number.is_some();
            if state.is_numbered && !is_open {
                assert_eq!(number, Some(state.number), "line {}: {line}", index + 1);
                state.number += 1;
                words.remove(0);
            }
            is_open = line.trim_end().ends_with('~');
            let Some(first) = words.first() else { continue };
            match *first {
                "END" => break,
                first if first.starts_with('*') => {}
                _ => blocks.extend(self.klartext_block(index + 1, &words, &mut state)),
            }
        }
        blocks
    }

    fn klartext_block(&mut self, line: usize, words: &[&str], state: &mut State) -> Option<Block> {
        let unit = |axis: &str, inches: bool| if inches && !"ABC".contains(axis) { 25.4 } else { 1.0 };
        match (words[0], words.get(1).copied().unwrap_or_default()) {
            ("BEGIN", _) => self.inches = words.last() == Some(&"INCH"),
            ("BLK" | "STOP", _) => {}
            ("TOOL", "CALL") => {
                for word in &words[2..] {
                    match split(word) {
                        ("Z", _) => self.plane = ("X", "Y"),
                        ("Y", _) => self.plane = ("Z", "X"),
                        ("X", _) => self.plane = ("Y", "Z"),
                        ("", number) => {
                            state.length = self.tools.get(&(number as u32)).copied().unwrap_or(self.length);
                            self.offset = state.length;
                        }
                        ("DL", more) => self.offset = state.length + more * unit("Z", self.inches),
                        ("S" | "F" | "DR", _) => {}
                        _ => panic!("line {line}: {word}"),
                    }
                }
            }
            ("FUNCTION", "TCPM") => self.begin_tip(),
            ("FUNCTION", "RESET") => self.end_tip(),
            ("CYCL", "DEF") => {
                let Some(("", number)) = words.get(2).map(|word| split(word)) else { panic!("line {line}") };
                if (7.05..7.95).contains(&number) {
                    let (name, value) = split(words[3]);
                    let own = name.trim_start_matches('I').to_owned();
                    let base = if name.len() > 1 { state.shift.get(&own).copied().unwrap_or(0.0) } else { 0.0 };
                    state.shift.insert(own.clone(), base + value * unit(&own, self.inches));
                } else {
                    assert!(number == 7.0 || number == 247.0, "line {line}: {words:?}");
                }
            }
            (word, _) if word.starts_with("Q339=") => {
                self.system = format!("G{}", 53.0 + split(&word[5..]).1);
                state.shift.clear();
            }
            ("CC", "") => state.pole.clone_from(&self.at),
            ("CC", _) => {
                for word in &words[1..] {
                    let (name, value) = split(word);
                    let own = name.trim_start_matches('I');
                    let base = if name.len() > 1 { self.at[own] } else { self.klartext_shift(own, state) };
                    state.pole.insert(own.to_owned(), base + value * unit(own, self.inches));
                }
            }
            (first, _) if first == "L" || first == "C" || first == "CR" || first.starts_with('M') => {
                return self.klartext_move(line, words, state);
            }
            _ => panic!("line {line}: {words:?}"),
        }
        None
    }

    fn klartext_shift(&self, axis: &str, state: &State) -> f64 {
        self.shift(axis) + state.shift.get(axis).copied().unwrap_or(0.0)
    }

    fn klartext_move(&mut self, line: usize, words: &[&str], state: &State) -> Option<Block> {
        let has = |wanted: &str| words.contains(&wanted);
        if has("M128") {
            self.begin_tip();
        }
        let from = self.at.clone();
        let mut to = from.clone();
        let (mut radius, mut moves) = (None, false);
        for word in &words[usize::from(!words[0].starts_with('M'))..] {
            let (name, value) = split(word);
            let own = name.strip_prefix('I').filter(|rest| !rest.is_empty()).unwrap_or(name);
            if self.at.contains_key(own) && own.len() == 1 {
                let by = value * if self.inches && !"ABC".contains(own) { 25.4 } else { 1.0 };
                let target = match (has("M91"), own == name) {
                    (true, true) => by,
                    (false, false) => from[own] + by,
                    (false, true) => by + self.klartext_shift(own, state),
                    _ => panic!("line {line}: {word}"),
                };
                to.insert(own.to_owned(), target);
                moves = true;
            } else {
                match (name, *word) {
                    ("R", "R0") | ("F" | "M", _) | ("DR", _) | (_, "FMAX") => {}
                    ("R", _) => radius = Some(value),
                    _ => panic!("line {line}: {word}"),
                }
            }
        }
        let block = moves.then(|| {
            self.at.clone_from(&to);
            let is_arc = words[0] != "L";
            let path = match is_arc {
                false => straight(&from, &to),
                true => {
                    self.motion = if has("DR+") { 3 } else { 2 };
                    assert!(has("DR+") != has("DR-") && (words[0] == "CR") == radius.is_some(), "line {line}");
                    let unit = if self.inches { 25.4 } else { 1.0 };
                    let centre = |axis: &str, letter: &str| {
                        (letter.to_owned(), (state.pole[axis] - self.shift(axis)) / unit, false)
                    };
                    let letters = |axis: &str| match axis {
                        "X" => "IA",
                        "Y" => "JA",
                        _ => "KA",
                    };
                    let (first, second) = self.plane;
                    let own = match radius {
                        Some(radius) => vec![("R".to_owned(), radius, false)],
                        None => [first, second].map(|axis| centre(axis, letters(axis))).to_vec(),
                    };
                    let third = ["X", "Y", "Z"].into_iter().find(|axis| ![first, second].contains(axis)).expect("one");
                    assert_eq!(from[third], to[third], "line {line}: C has no third coordinate");
                    self.arc(&from, &to, &own)
                }
            };
            let path = if self.tip { path.iter().map(|at| self.axes_of(at)).collect() } else { path };
            Block {
                line,
                is_rapid: has("FMAX") && !is_arc,
                path,
                inverse_feed: None,
                is_arc,
                is_tip: self.tip,
                is_machine: has("M91"),
            }
        });
        if has("M129") {
            self.end_tip();
        }
        block
    }
}
