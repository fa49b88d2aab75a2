//! A reading of programs that shares nothing with the corrector: what the axes of a machine do, in small steps. It knows the codes that
//! corrected programs have and panics at all others.

mod klartext;

use std::collections::BTreeMap;

use abbe_core::{AxisKind, Poses, StatusRole};

use crate::controls::law::{ByAxis, Machine};

/// One block of motion.
#[derive(Debug, Clone)]
pub struct Block {
    pub line: usize,
    pub is_rapid: bool,
    /// Positions of the axes, mm and degrees, from the start to the end.
    pub path: Vec<ByAxis>,
    /// F under G93.
    pub inverse_feed: Option<f64>,
    pub is_arc: bool,
    /// Whether the tip is programmed.
    pub is_tip: bool,
    /// Whether its numbers are positions of the machine (G53), which nobody corrects.
    pub is_machine: bool,
}

/// Steps of a path: mm, degrees, and the sagitta of arcs in mm.
const STEP: f64 = 0.5;
const TURN: f64 = 0.05;
const SAGITTA: f64 = 1e-5;

pub struct Control<'a> {
    pub machine: &'a Machine,
    pub offsets: BTreeMap<String, ByAxis>,
    pub tools: BTreeMap<u32, f64>,
    /// Length of the tool while the program names none with a number.
    pub length: f64,
    at: ByAxis,
    motion: u32,
    plane: (&'static str, &'static str),
    relative: bool,
    absolute_centres: bool,
    inches: bool,
    inverse: bool,
    system: String,
    /// The length that counts.
    offset: f64,
    tip: bool,
}

fn words(text: &str) -> Vec<(String, f64, bool)> {
    let mut plain = String::new();
    let mut depth = 0;
    for letter in text.chars() {
        match letter {
            ';' if depth == 0 => break,
            '(' if !plain.ends_with(['C', 'c']) => depth += 1,
            ')' if depth > 0 => depth -= 1,
            _ if depth > 0 => {}
            letter => plain.push(letter.to_ascii_uppercase()),
        }
    }
    let mut rest = plain.replace([' ', '\t', '\r'], "");
    let mut found = Vec::new();
    while !rest.is_empty() {
        let end = rest.find(|letter: char| !letter.is_ascii_alphabetic()).unwrap_or(rest.len());
        let (name, after) = rest.split_at(end);
        let (mut name, mut after) = (name.to_owned(), after.to_owned());
        let mut is_relative = false;
        if let Some(value) = after.strip_prefix('=') {
            let value = value.to_owned();
            if let Some(text) = value.strip_prefix('"') {
                let close = text.find('"').expect("a text ends") + 2;
                rest = value[close..].to_owned();
                continue;
            }
            is_relative = value.starts_with("IC(");
            if value.starts_with("AC(") && ["I", "J", "K"].contains(&name.as_str()) {
                name.push('A');
            }
            let inner = value.split(['(', ')']).nth(1).map(str::to_owned);
            after = match inner {
                Some(inner) if value.contains('(') && value.as_bytes()[0].is_ascii_alphabetic() => {
                    inner + value.split_once(')').expect("closed").1
                }
                _ => value,
            };
        }
        let digits = after.find(|letter: char| !"+-.0123456789".contains(letter)).unwrap_or(after.len());
        let value = after[..digits].parse().unwrap_or(f64::NAN);
        found.push((name, value, is_relative));
        rest = after[digits..].to_owned();
    }
    found
}

impl<'a> Control<'a> {
    pub fn new(machine: &'a Machine) -> Self {
        let axes = machine.model.info().axes.iter().map(|axis| (axis.name.clone(), 0.0));
        Self {
            machine,
            offsets: BTreeMap::new(),
            tools: BTreeMap::new(),
            length: 0.0,
            at: axes.collect(),
            motion: 0,
            plane: ("X", "Y"),
            relative: false,
            absolute_centres: false,
            inches: false,
            inverse: false,
            system: "G54".to_owned(),
            offset: 0.0,
            tip: false,
        }
    }

    fn shift(&self, axis: &str) -> f64 {
        let of_system = self.offsets.get(&self.system).and_then(|offset| offset.get(axis)).copied().unwrap_or(0.0);
        of_system + if axis == "Z" && !self.tip { self.offset } else { 0.0 }
    }

    /// The nominal tip with rotary axes at their positions; X, Y and Z of the tip as they are programmed.
    fn tip_of(&self, at: &ByAxis) -> [f64; 3] {
        let origin = at.keys().map(|axis| (axis.clone(), 0.0)).collect::<ByAxis>();
        let [tip, zero] = [at, &origin].map(|at| tips(self.machine, &[(at.clone(), ByAxis::new())], false)[0]);
        [tip[0] - zero[0], tip[1] - zero[1], tip[2] - zero[2] - self.offset]
    }

    /// Positions of the axes for a programmed tip: the nominal tip is linear in X, Y and Z.
    fn axes_of(&self, programmed: &ByAxis) -> ByAxis {
        let mut at = programmed.clone();
        ["X", "Y", "Z"].iter().for_each(|axis| set(&mut at, axis, 0.0));
        let base = self.tip_of(&at);
        let columns = ["X", "Y", "Z"].map(|axis| {
            let mut moved = at.clone();
            moved.insert(axis.to_owned(), 100.0);
            let tip = self.tip_of(&moved);
            nalgebra::Vector3::from([0, 1, 2].map(|row| (tip[row] - base[row]) / 100.0))
        });
        let goal = ["X", "Y", "Z"].map(|axis| programmed[axis]);
        let lacks = nalgebra::Vector3::from([0, 1, 2].map(|row| goal[row] - base[row]));
        let solved = nalgebra::Matrix3::from_columns(&columns).try_inverse().expect("X, Y and Z") * lacks;
        ["X", "Y", "Z"].iter().zip(solved.iter()).for_each(|(axis, value)| set(&mut at, axis, *value));
        at
    }

    /// Everything that a program moves.
    pub fn run(&mut self, text: &str) -> Vec<Block> {
        let mut blocks = Vec::new();
        for (index, line) in text.lines().enumerate() {
            if line.starts_with('%') || line.starts_with('O') {
                continue;
            }
            if let Some(block) = self.block(index + 1, &words(line.trim_start_matches('/'))) {
                blocks.push(block);
            }
        }
        blocks
    }

    fn block(&mut self, line: usize, words: &[(String, f64, bool)]) -> Option<Block> {
        let value = |name: &str| words.iter().find(|word| word.0 == name).map(|word| word.1);
        let (mut machine_coordinates, mut sets_offset) = (false, false);
        for (name, number, _) in words {
            match (name.as_str(), (number * 10.0).round() as i64) {
                ("G", code @ (0 | 10 | 20 | 30)) => self.motion = (code / 10) as u32,
                ("G", 170) => self.plane = ("X", "Y"),
                ("G", 180) => self.plane = ("Z", "X"),
                ("G", 190) => self.plane = ("Y", "Z"),
                ("G", 200 | 700) => self.inches = true,
                ("G", 210 | 710) => self.inches = false,
                ("G", 900) => self.relative = false,
                ("G", 910) => self.relative = true,
                ("G", 901) => self.absolute_centres = true,
                ("G", 911) => self.absolute_centres = false,
                ("G", 930) => self.inverse = true,
                ("G", 940) => self.inverse = false,
                ("G", 530) => machine_coordinates = true,
                ("G", code @ 540..=590) => self.system = format!("G{}", code / 10),
                ("G", 100) => sets_offset = true,
                ("G", 430 | 434) => {
                    let tool = value("H").expect("H") as u32;
                    self.offset = self.tools.get(&tool).copied().unwrap_or(self.length);
                    if (number - 43.4).abs() < 1e-9 {
                        self.begin_tip();
                    }
                }
                ("G", 490) => {
                    self.end_tip();
                    self.offset = 0.0;
                }
                ("TRAORI", _) => {
                    self.offset = self.length;
                    self.begin_tip();
                }
                ("TRAFOOF", _) => self.end_tip(),
                ("D", code) => self.offset = if code == 0 { 0.0 } else { self.length },
                ("G", 40 | 400 | 800 | 610 | 611 | 640 | 980 | 990 | 970) => {}
                (
                    "CFTCP" | "IA" | "JA" | "KA" | "N" | "F" | "S" | "T" | "M" | "H" | "X" | "Y" | "Z" | "A" | "B"
                    | "C" | "I" | "J" | "K" | "R" | "CR" | "L" | "P" | "",
                    _,
                ) => {}
                (name, _) => panic!("line {line}: {name} {number}"),
            }
        }
        let unit = |axis: &str| if self.inches && !"ABC".contains(axis) { 25.4 } else { 1.0 };
        if sets_offset {
            let system = format!("G{}", 53 + value("P").expect("P") as u32);
            let own: Vec<(String, f64)> = ["X", "Y", "Z", "A", "B", "C"]
                .iter()
                .filter_map(|axis| Some(((*axis).to_owned(), value(axis)? * unit(axis))))
                .collect();
            self.offsets.entry(system).or_default().extend(own);
            return None;
        }
        let named: Vec<String> = self.at.keys().filter(|axis| value(axis).is_some()).cloned().collect();
        let has_centre = ["I", "J", "K"].iter().any(|name| value(name).is_some());
        if named.is_empty() && !(has_centre && self.motion > 1) {
            return None;
        }
        let from = self.at.clone();
        let mut to = from.clone();
        for axis in named {
            let word = words.iter().find(|word| word.0 == axis).expect("it is named");
            let by = word.1 * unit(&axis);
            let target = match (machine_coordinates, self.relative || word.2) {
                (true, _) => by,
                (false, true) => from[&axis] + by,
                (false, false) => by + self.shift(&axis),
            };
            to.insert(axis, target);
        }
        self.at.clone_from(&to);
        let is_arc = self.motion > 1;
        let path = if is_arc { self.arc(&from, &to, words) } else { straight(&from, &to) };
        let path = if self.tip { path.iter().map(|at| self.axes_of(at)).collect() } else { path };
        let inverse_feed = (self.inverse && self.motion > 0).then(|| value("F").expect("every block has its F"));
        Some(Block {
            line,
            is_rapid: self.motion == 0,
            path,
            inverse_feed,
            is_arc,
            is_tip: self.tip,
            is_machine: machine_coordinates,
        })
    }

    fn begin_tip(&mut self) {
        if !self.tip {
            self.tip = true;
            let tip = self.tip_of(&self.at);
            ["X", "Y", "Z"].iter().zip(tip).for_each(|(axis, value)| set(&mut self.at, axis, value));
        }
    }

    fn end_tip(&mut self) {
        if self.tip {
            self.at = self.axes_of(&self.at);
            self.tip = false;
        }
    }

    fn arc(&self, from: &ByAxis, to: &ByAxis, words: &[(String, f64, bool)]) -> Vec<ByAxis> {
        let unit = if self.inches { 25.4 } else { 1.0 };
        let value = |name: &str| words.iter().find(|word| word.0 == name).map(|word| word.1 * unit);
        let (first, second) = self.plane;
        let flat = |at: &ByAxis| nalgebra::Vector2::new(at[first], at[second]);
        let (start, end) = (flat(from), flat(to));
        let letter = |axis: &str| match axis {
            "X" => "I",
            "Y" => "J",
            _ => "K",
        };
        let against = self.motion == 3;
        let centre = match value("R").or(value("CR")) {
            Some(radius) => {
                // Of the two centres the one whose turn is short for a positive radius.
                let chord = end - start;
                let height = (radius * radius - chord.norm_squared() / 4.0).max(0.0).sqrt();
                let across = nalgebra::Vector2::new(-chord.y, chord.x).normalize() * height;
                let both = [start + chord / 2.0 + across, start + chord / 2.0 - across];
                let is_short = |centre: &nalgebra::Vector2<f64>| {
                    turn(start - centre, end - centre, against).abs() < std::f64::consts::PI
                };
                if is_short(&both[0]) == (radius > 0.0) { both[0] } else { both[1] }
            }
            None if self.absolute_centres => {
                let of = |axis: &str| value(letter(axis)).unwrap_or(0.0) + self.shift(axis);
                nalgebra::Vector2::new(of(first), of(second))
            }
            None => {
                let of = |axis: &str| match value(&format!("{}A", letter(axis))) {
                    Some(absolute) => absolute + self.shift(axis),
                    None => from[axis] + value(letter(axis)).unwrap_or(0.0),
                };
                nalgebra::Vector2::new(of(first), of(second))
            }
        };
        let (one, other) = (start - centre, end - centre);
        assert!((one.norm() - other.norm()).abs() < 0.012, "the end is off the circle: {words:?}");
        let angle = turn(one, other, against);
        let most = (8.0 * SAGITTA / one.norm()).sqrt();
        let count = (angle.abs() / most).ceil().max(2.0) as usize;
        let begin = one.y.atan2(one.x);
        // An axis turns around at quarters of the circle, and beside them where the radius changes: d/dt (r cos(w t)) = 0.
        let quarter = std::f64::consts::FRAC_PI_2;
        let beside = ((other.norm() - one.norm()) / (one.norm() * angle)).atan();
        let turns = (-10..=10).map(|count| (f64::from(count) * quarter + beside - begin) / angle);
        let mut parts: Vec<f64> = (0..=count).map(|step| step as f64 / count as f64).collect();
        parts.extend(turns.filter(|part| *part > 1e-7 && *part < 1.0 - 1e-7));
        parts.extend(near_ends(count));
        parts.sort_by(f64::total_cmp);
        let along = |part: f64| {
            let mut at = between(from, to, part);
            if part < 1.0 {
                let radius = one.norm() + part * (other.norm() - one.norm());
                let angle = begin + part * angle;
                at.insert(first.to_owned(), centre.x + radius * angle.cos());
                at.insert(second.to_owned(), centre.y + radius * angle.sin());
            }
            at
        };
        parts.into_iter().map(along).collect()
    }
}

fn set(at: &mut ByAxis, axis: &str, value: f64) {
    at.insert(axis.to_owned(), value);
}

/// The turn from one direction to another, a whole one if they are the same.
fn turn(one: nalgebra::Vector2<f64>, other: nalgebra::Vector2<f64>, against: bool) -> f64 {
    let angle = one.perp(&other).atan2(one.dot(&other));
    let whole = 2.0 * std::f64::consts::PI;
    match against {
        true if angle <= 1e-9 => angle + whole,
        false if angle >= -1e-9 => angle - whole,
        _ => angle,
    }
}

fn between(from: &ByAxis, to: &ByAxis, part: f64) -> ByAxis {
    from.iter().map(|(axis, at)| (axis.clone(), at + part * (to[axis] - at))).collect()
}

fn straight(from: &ByAxis, to: &ByAxis) -> Vec<ByAxis> {
    let steps =
        from.iter().map(|(axis, at)| (to[axis] - at).abs() / if "ABC".contains(axis.as_str()) { TURN } else { STEP });
    let count = steps.fold(1.0, f64::max).ceil() as usize;
    let mut parts: Vec<f64> = (0..=count).map(|step| step as f64 / count as f64).collect();
    parts.extend(near_ends(count));
    parts.sort_by(f64::total_cmp);
    parts.into_iter().map(|part| between(from, to, part)).collect()
}

/// Ever shorter steps towards the ends of a block: where the tip is programmed an axis may turn around just before its end.
fn near_ends(count: usize) -> impl Iterator<Item = f64> {
    (1..=12).map(move |halved| 0.5_f64.powi(halved) / count as f64).flat_map(|part| [part, 1.0 - part])
}

/// Tips in the table frame at positions with directions (+1 where none is said).
pub fn tips(machine: &Machine, points: &[(ByAxis, ByAxis)], with_errors: bool) -> Vec<[f64; 3]> {
    tips_with(machine, points, with_errors, &[])
}

/// The same with other statuses, by their names.
pub fn tips_with(
    machine: &Machine,
    points: &[(ByAxis, ByAxis)],
    with_errors: bool,
    others: &[(&str, f64)],
) -> Vec<[f64; 3]> {
    let info = machine.model.info();
    let mut statuses = Vec::new();
    for (at, directions) in points {
        let mut status = vec![0.0; info.status.len()];
        for axis in &info.axes {
            let place = at.get(&axis.name).copied().unwrap_or(0.0);
            status[axis.status] = if axis.kind == AxisKind::Rotary { place.to_radians() } else { place };
        }
        for (index, column) in info.status.iter().enumerate() {
            if let StatusRole::Direction(axis) = column.role {
                status[index] = directions.get(&info.axes[axis].name).copied().unwrap_or(1.0);
            }
        }
        for (name, value) in others {
            let index = info.status.iter().position(|column| column.name == *name).expect("a status");
            status[index] = *value;
        }
        statuses.extend(status);
    }
    let values = if with_errors { &machine.values } else { &machine.model.info().nominal };
    let mut poses = Poses::default();
    machine.model.poses(&statuses, values, &[], false, &mut poses).expect("poses");
    poses.positions
}
