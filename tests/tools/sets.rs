//! Random sets of other tools, masters, methods, limits, factors and events. An evaluation of its own, written from the
//! rules alone, has to come to the same values, verdicts and wear; without noise the truth has to come back. Laws hold.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use abbe_core::Calibration;
use serde_json::{Value, json};

use super::controls::{CONTROLS, Control, agrees};
use super::rows;
use crate::support::{Random, Variant, fit, recipes, temporary};

const SETS: u64 = 48;

/// A reading; quantity 0 is the length, 1 the radius.
#[derive(Debug, Clone)]
struct Line {
    session: usize,
    /// None for the master.
    tool: Option<usize>,
    quantity: usize,
    method: usize,
    repeat: usize,
    value: f64,
    minutes: f64,
    spoiled: bool,
}

/// A set: what the recipe and both files say, and what was true.
#[derive(Debug, Clone)]
struct Set {
    names: Vec<String>,
    presets: Vec<[f64; 2]>,
    wear_um: Vec<[f64; 2]>,
    master: (String, [f64; 2], f64),
    methods: Vec<(String, [f64; 2])>,
    setting_um: f64,
    spoiled: f64,
    k: f64,
    consistency: f64,
    breakage: f64,
    chip: f64,
    close: f64,
    wrong: f64,
    log: Vec<Line>,
    noise: bool,
    /// True sizes, mm, by session, tool and quantity.
    sizes: BTreeMap<(usize, usize, usize), f64>,
    /// Values that a method has wrong.
    dirty: Vec<(usize, usize, usize)>,
}

/// What happens to tools.
struct Events {
    swap: Option<(usize, usize, usize)>,
    chip: Option<(usize, usize, f64)>,
    breaks: Option<(usize, usize, f64)>,
    dirt: Option<(usize, usize, usize)>,
}

impl Events {
    fn new(random: &mut Random, tools: usize, sessions: usize) -> Self {
        let mut order: Vec<usize> = (0..tools).collect();
        (1..tools).rev().for_each(|place| order.swap(place, random.below(place + 1)));
        let mut session = |from: usize| from + random.below(sessions - from);
        let [swap, chip, breaks, dirt] = [session(0), session(1), session(1), session(0)];
        let is = |random: &mut Random| random.unit() < 0.7;
        Self {
            swap: is(random).then(|| (swap, order[0], order[1])),
            chip: is(random).then(|| (chip, order[tools - 1], random.within(0.6, 3.0))),
            breaks: is(random).then(|| (breaks, order[tools / 2], random.within(2.0, 9.0))),
            dirt: is(random).then(|| (dirt, random.below(tools), random.below(2))),
        }
    }
}

/// The tools as they are.
struct World<'a> {
    events: &'a Events,
    /// Minutes that each has cut.
    minutes: Vec<f64>,
    /// Wear, mm a minute.
    rates: Vec<[f64; 2]>,
    /// Sizes before the first cut, mm.
    new: Vec<[f64; 2]>,
    chip: f64,
}

impl World<'_> {
    /// The size in the place of a tool; none of a tool that is out of use, and no radius of one that broke.
    fn size(&self, session: usize, tool: usize, quantity: usize) -> Option<f64> {
        let broken = self.events.breaks.filter(|(at, broken, _)| tool == *broken && session >= *at);
        if broken.is_some_and(|(at, ..)| session > at || quantity == 1) {
            return None;
        }
        let inside = match self.events.swap {
            Some((at, one, other)) if at == session && tool == one => other,
            Some((at, one, other)) if at == session && tool == other => one,
            _ => tool,
        };
        let chipped = self.events.chip.filter(|(at, chipped, _)| session >= *at && inside == *chipped && quantity == 1);
        let lost = chipped.map_or(0.0, |(_, _, times)| times * self.chip * 1e-3) + broken.map_or(0.0, |it| it.2);
        Some(self.new[inside][quantity] - self.rates[inside][quantity] * self.minutes[inside] - lost)
    }
}

impl Set {
    fn new(seed: u64) -> Self {
        let mut random = Random::new(seed);
        let r = &mut random;
        let (tools, sessions, repeats) = (3 + r.below(6), 4 + r.below(8), 3 + r.below(3));
        let names = (0..tools).map(|tool| match seed % 3 {
            0 => format!("{}", 7 * tool + 2),
            1 => format!("T{}-end mill", 90 - tool),
            _ => format!("{}", tool + 1),
        });
        let master = [r.within(60.0, 320.0), r.within(2.0, 22.0)].map(|it: f64| (it * 1e4).round() / 1e4);
        let kinds = ["camera", "contact", "laser"];
        let methods: Vec<(String, [f64; 2])> = (0..1 + (seed as usize + 1) % 3)
            .map(|kind| (kinds[kind].to_owned(), [r.within(0.3, 1.8), r.within(0.3, 1.8)]))
            .collect();
        let mut set = Self {
            names: names.collect(),
            presets: (0..tools).map(|_| [r.within(60.0, 260.0), r.within(1.5, 20.0)]).collect(),
            wear_um: (0..tools).map(|_| [r.within(15.0, 70.0).round(), r.within(12.0, 40.0).round()]).collect(),
            master: (["0", "M", "999"][seed as usize % 3].to_owned(), master, r.within(0.1, 1.5)),
            methods,
            setting_um: r.within(0.3, 2.5),
            spoiled: r.within(5.5, 8.0),
            k: r.within(1.6, 3.0),
            consistency: r.within(3.5, 5.0),
            breakage: r.within(250.0, 1200.0),
            chip: r.within(12.0, 40.0),
            close: r.within(60.0, 100.0),
            wrong: r.within(120.0, 240.0),
            log: Vec::new(),
            noise: seed.is_multiple_of(2),
            sizes: BTreeMap::new(),
            dirty: Vec::new(),
        };
        for pair in &mut set.presets {
            *pair = pair.map(|value| (value * 1e4).round() / 1e4);
        }
        let events = Events::new(r, tools, sessions);
        set.measure(r, (sessions, repeats), &events);
        set
    }

    fn measure(&mut self, random: &mut Random, (sessions, repeats): (usize, usize), events: &Events) {
        let tools = self.names.len();
        let loud = if self.noise { 1e-3 } else { 0.0 };
        let master = self.master.1.map(|value| value + loud * random.normal() * self.master.2);
        let mut pair = |size: f64| [(); 2].map(|()| loud * random.normal() * size);
        let new = self.presets.iter().map(|preset| {
            let off = pair(self.setting_um);
            [preset[0] + off[0], preset[1] + off[1]]
        });
        let new = new.collect();
        let total = 30.0 * sessions as f64;
        let rates = self.wear_um.iter().map(|pair| pair.map(|it| it * random.within(0.1, 1.6) / total * 1e-3));
        let mut world = World { events, minutes: vec![0.0; tools], rates: rates.collect(), new, chip: self.chip };
        let bias: Vec<[f64; 2]> = self.methods.iter().map(|_| [(); 2].map(|()| random.within(-0.02, 0.02))).collect();
        for session in 0..sessions {
            let growth = [0.025 * (1.0 - (-(session as f64) / 3.0).exp()), 0.0];
            for quantity in 0..2 {
                let off = |method: usize| bias[method][quantity] + growth[quantity];
                self.read((session, None, quantity), master[quantity], off, repeats, 0.0, random);
            }
            for tool in 0..tools {
                world.minutes[tool] += if session > 0 { random.within(20.0, 40.0).round() } else { 0.0 };
                let minutes = world.minutes[tool];
                for quantity in 0..2 {
                    let Some(size) = world.size(session, tool, quantity) else { continue };
                    self.sizes.insert((session, tool, quantity), size);
                    let is_dirty = events.dirt == Some((session, tool, quantity)) && self.methods.len() > 1;
                    let dirt = if is_dirty { 12e-3 * self.methods[0].1[quantity] } else { 0.0 };
                    self.dirty.extend(is_dirty.then_some((session, tool, quantity)));
                    let off = |method: usize| {
                        bias[method][quantity] + growth[quantity] + if method == 0 { dirt } else { 0.0 }
                    };
                    self.read((session, Some(tool), quantity), size, off, repeats, minutes, random);
                }
            }
        }
    }

    /// Readings of a size by all methods; one of the repeats may be bad, which is no majority.
    fn read(
        &mut self,
        (session, tool, quantity): (usize, Option<usize>, usize),
        size: f64,
        off: impl Fn(usize) -> f64,
        repeats: usize,
        minutes: f64,
        random: &mut Random,
    ) {
        let loud = if self.noise { 1e-3 } else { 0.0 };
        for method in 0..self.methods.len() {
            let bad = (random.unit() < 0.02).then(|| random.below(repeats));
            for repeat in 0..repeats {
                let spoiled = bad == Some(repeat);
                let spoil = if spoiled { random.within(0.06, 0.3) } else { 0.0 };
                let sign = if random.unit() < 0.5 { -1.0 } else { 1.0 };
                let noise = loud * random.normal() * self.methods[method].1[quantity];
                let value = ((size + off(method) + sign * spoil + noise) * 1e9).round() / 1e9;
                self.log.push(Line { session, tool, quantity, method, repeat, value, minutes, spoiled });
            }
        }
    }

    fn log_text(&self) -> String {
        let mut text = "session,tool,quantity,method,repeat,value_mm,time_s,spindle_degC,cutting_min\n".to_owned();
        for (index, line) in self.log.iter().enumerate() {
            let tool = line.tool.map_or(self.master.0.as_str(), |tool| &self.names[tool]);
            let (quantity, method) = (["length", "radius"][line.quantity], &self.methods[line.method].0);
            let Line { session, repeat, value, minutes, .. } = line;
            let time = session * 86_400 + index;
            writeln!(text, "{session},{tool},{quantity},{method},{repeat},{value:.9},{time},24.5,{minutes}")
                .expect("text");
        }
        text
    }

    fn table_text(&self) -> String {
        let mut text = "tool,length_mm,radius_mm,wear_limit_length_um,wear_limit_radius_um\n".to_owned();
        for (name, ([length, radius], [more, wider])) in self.names.iter().zip(self.presets.iter().zip(&self.wear_um)) {
            writeln!(text, "{name},{length:.4},{radius:.4},{more},{wider}").expect("text");
        }
        text
    }

    fn recipe(&self, folder: &std::path::Path) -> Variant {
        crate::support::write(&folder.join("log.csv"), &self.log_text());
        crate::support::write(&folder.join("tools.csv"), &self.table_text());
        let repeatability: serde_json::Map<String, Value> =
            self.methods.iter().map(|(name, s)| (name.clone(), json!({ "length": s[0], "radius": s[1] }))).collect();
        let mut recipe = Variant::of(&recipes()["tool-check"]).only(&["tools", "history"]);
        recipe.stage("log")["path"] = json!(folder.join("log.csv"));
        *recipe.stage("tools") = json!({
            "estimate": "tool-dimensions",
            "from": "log",
            "table": folder.join("tools.csv"),
            "master": {
                "tool": self.master.0, "length_mm": self.master.1[0], "radius_mm": self.master.1[1],
                "standard_uncertainty_um": self.master.2,
            },
            "repeatability_um": repeatability,
            "setting_standard_uncertainty_um": self.setting_um,
            "spoiled_factor": self.spoiled,
            "coverage_factor": self.k,
            "consistency_factor": self.consistency,
            "limits": {
                "breakage_um": self.breakage, "chip_um": self.chip, "match_um": self.close, "wrong_um": self.wrong,
            },
        });
        recipe
    }

    fn run(&self) -> Found {
        let folder = temporary();
        let outcome = self.recipe(folder.path()).run();
        let (_, files) = outcome.exports.iter().find(|(stage, _)| stage == "history").expect("tables");
        let text = |end: &str| {
            let file = files.iter().find(|file| file.name.ends_with(end)).expect("a table");
            String::from_utf8(file.content.clone()).expect("text")
        };
        let verdicts = rows(&text("verdicts.csv"));
        Found { calibration: fit(&outcome, "tools").calibration.clone(), verdicts, set: self.clone() }
    }
}

/// What the program found.
struct Found {
    calibration: Calibration,
    verdicts: Vec<BTreeMap<String, String>>,
    set: Set,
}

impl Found {
    fn key(&self, row: &BTreeMap<String, String>) -> (usize, usize) {
        let tool = self.set.names.iter().position(|name| *name == row["tool"]).expect("a tool");
        (row["session"].parse().expect("a number"), tool)
    }

    fn named(&self) -> BTreeMap<(usize, usize), (String, String)> {
        let both = |row: &BTreeMap<String, String>| (row["verdict"].clone(), row["looks_like"].clone());
        self.verdicts.iter().map(|row| (self.key(row), both(row))).collect()
    }

    fn value(&self, session: usize, tool: usize, quantity: usize) -> (f64, f64) {
        let (name, what) = (&self.set.names[tool], ["length", "radius"][quantity]);
        let last = self.verdicts.iter().map(|row| self.key(row)).filter(|key| key.1 == tool).map(|key| key.0).max();
        let name = if last == Some(session) { format!("{what}[{name}]") } else { format!("{what}[{name},{session}]") };
        let found = self.calibration.get(&name).unwrap_or_else(|| panic!("no {name}"));
        (found.value, found.standard_uncertainty)
    }
}

/// A value with its own variance, without the master's, mm.
#[derive(Debug, Clone, Copy)]
struct Own {
    value: f64,
    variance: f64,
    agrees: bool,
}

/// The rules, evaluated anew.
struct Rules<'a>(&'a Set);

impl Rules<'_> {
    /// Median, bad readings, mean: mean and number of readings.
    fn mean(&self, session: usize, tool: Option<usize>, quantity: usize, method: usize) -> Option<(f64, f64)> {
        let of =
            |line: &&Line| (line.session, line.tool, line.quantity, line.method) == (session, tool, quantity, method);
        let mut values: Vec<f64> = self.0.log.iter().filter(of).map(|line| line.value).collect();
        values.sort_by(f64::total_cmp);
        let (low, high) = (values.get(values.len().checked_sub(1)? / 2)?, values[values.len() / 2]);
        let (middle, most) = ((low + high) / 2.0, self.0.spoiled * self.0.methods[method].1[quantity] * 1e-3);
        values.retain(|value| (value - middle).abs() <= most);
        Some((values.iter().sum::<f64>() / values.len() as f64, values.len() as f64))
    }

    fn own(&self, session: usize, tool: usize, quantity: usize) -> Option<Own> {
        let mut parts = Vec::new();
        for method in 0..self.0.methods.len() {
            let s2 = (self.0.methods[method].1[quantity] * 1e-3).powi(2);
            let (mean, n) = self.mean(session, Some(tool), quantity, method)?;
            let (master, n0) = self.mean(session, None, quantity, method).expect("a master");
            parts.push((mean - (master - self.0.master.1[quantity]), s2 / n + s2 / n0));
        }
        let sum: f64 = parts.iter().map(|part| 1.0 / part.1).sum();
        let value = parts.iter().map(|part| part.0 / part.1).sum::<f64>() / sum;
        let differ = |one: &(f64, f64), other: &(f64, f64)| {
            (one.0 - other.0).abs() > self.0.consistency * (one.1 + other.1).sqrt()
        };
        let agrees = !parts.iter().any(|one| parts.iter().any(|other| differ(one, other)));
        Some(Own { value, variance: 1.0 / sum, agrees })
    }

    /// Verdicts, looks and the values.
    fn verdicts(&self) -> BTreeMap<(usize, usize), (String, String)> {
        let keys: std::collections::BTreeSet<(usize, usize)> = self.0.sizes.keys().map(|key| (key.0, key.1)).collect();
        let mut before: BTreeMap<usize, Own> = BTreeMap::new();
        let mut all = BTreeMap::new();
        for (session, tool) in keys {
            let own = [0, 1].map(|quantity| self.own(session, tool, quantity));
            let (name, like) = self.verdict(tool, own, before.get(&tool).copied());
            if ["ok", "recheck"].contains(&name)
                && let Some(radius) = own[1]
            {
                before.insert(tool, radius);
            }
            all.insert((session, tool), (name.to_owned(), like));
        }
        all
    }

    fn verdict(&self, tool: usize, own: [Option<Own>; 2], before: Option<Own>) -> (&'static str, String) {
        let set = self.0;
        let shared = (set.master.2.powi(2) + set.setting_um.powi(2)) * 1e-6;
        let short = [0, 1].map(|it| own[it].map(|own: Own| (set.presets[tool][it] - own.value) * 1e3));
        let spread = [0, 1].map(|it| own[it].map(|own: Own| set.k * (own.variance + shared).sqrt() * 1e3));
        let drop = own[1]
            .zip(before)
            .map(|(now, then)| ((then.value - now.value) * 1e3, set.k * (now.variance + then.variance).sqrt() * 1e3));
        if let ([Some(length), Some(radius)], [Some(more), Some(wider)]) = (short, spread)
            && (length.abs() > set.wrong + more || radius.abs() > set.wrong + wider)
        {
            let mut alike: Vec<(f64, usize)> = Vec::new();
            for other in (0..set.names.len()).filter(|other| *other != tool) {
                let off = |it: usize| (own[it].map_or(f64::NAN, |own| own.value) - set.presets[other][it]) * 1e3;
                if off(0).abs() < set.close - more && off(1).abs() < set.close - wider {
                    alike.push((off(0).hypot(off(1)), other));
                }
            }
            alike.sort_by(|one, other| one.0.total_cmp(&other.0));
            if let Some((_, other)) = alike.first() {
                return ("wrong-tool", set.names[*other].clone());
            }
        }
        let beyond = |it: usize, limit: f64| short[it].zip(spread[it]).is_some_and(|(short, u)| short > limit + u);
        let below = |it: usize, limit: f64| short[it].zip(spread[it]).is_some_and(|(short, u)| short < limit - u);
        let limits = set.wear_um[tool];
        let name = if beyond(0, set.breakage) {
            "broken"
        } else if drop.is_some_and(|(drop, u)| drop > set.chip + u) {
            "chipped"
        } else if beyond(0, limits[0]) || beyond(1, limits[1]) {
            "worn"
        } else if !below(0, limits[0])
            || !below(1, limits[1])
            || !below(0, set.breakage)
            || drop.is_some_and(|(drop, u)| drop >= set.chip - u)
            || own.iter().flatten().any(|own| !own.agrees)
        {
            "recheck"
        } else {
            "ok"
        };
        (name, String::new())
    }

    /// Slope, um a minute, its standard uncertainty, and the minute at which the limit is reached.
    fn wear(&self, tool: usize, quantity: usize) -> Option<(f64, f64, f64)> {
        let verdicts = self.verdicts();
        let mut points = Vec::new();
        for ((session, _), (name, _)) in verdicts.iter().filter(|(key, _)| key.1 == tool) {
            let minutes = self.0.log.iter().find(|line| line.session == *session && line.tool == Some(tool));
            if let (true, Some(own)) =
                (["ok", "recheck", "worn"].contains(&name.as_str()), self.own(*session, tool, quantity))
            {
                points.push((minutes.expect("a reading").minutes, own));
            }
        }
        let n = points.len() as f64;
        let (t, v) = points.iter().fold((0.0, 0.0), |sum, point| (sum.0 + point.0 / n, sum.1 + point.1.value / n));
        let squares: f64 = points.iter().map(|point| (point.0 - t).powi(2)).sum();
        if points.len() < 2 || squares == 0.0 {
            return None;
        }
        let slope = points.iter().map(|point| (point.0 - t) * (point.1.value - v)).sum::<f64>() / squares;
        let variance = points.iter().map(|point| point.1.variance).sum::<f64>() / n;
        let limit = self.0.presets[tool][quantity] - self.0.wear_um[tool][quantity] * 1e-3;
        Some((slope * 1e3, (variance / squares).sqrt() * 1e3, t + (limit - v) / slope))
    }
}

#[test]
fn other_sets_are_judged_as_the_rules_say() {
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    let (mut noisy, mut rates) = (0, 0);
    for seed in 1..=SETS {
        let set = Set::new(seed);
        let (found, rules) = (set.run(), Rules(&set));
        assert_eq!(found.named(), rules.verdicts(), "set {seed}");
        found.named().into_values().for_each(|(name, _)| *counts.entry(name).or_default() += 1);
        for &(session, tool, quantity) in set.sizes.keys() {
            let (value, uncertainty) = found.value(session, tool, quantity);
            let own = rules.own(session, tool, quantity).expect("a value");
            let wanted = (own.variance + set.master.2.powi(2) * 1e-6).sqrt();
            assert!((value - own.value).abs() < 1e-12 * value.abs() + 2e-13, "set {seed}: {value} {own:?}");
            assert!((uncertainty / wanted - 1.0).abs() < 1e-9, "set {seed}: {uncertainty} {wanted}");
            let size = set.sizes[&(session, tool, quantity)];
            let here = format!("set {seed} session {session} tool {tool} quantity {quantity}");
            if set.dirty.contains(&(session, tool, quantity)) {
                continue;
            }
            // Without noise readings have 1e-9 mm.
            let most = if set.noise { 5.0 * uncertainty } else { 2e-9 };
            assert!((value - size).abs() < most, "{here}: {value} {size}");
            noisy += usize::from(set.noise);
        }
        let told: Vec<usize> = found.calibration.outliers.iter().map(|outlier| outlier.line).collect();
        let spoiled = set.log.iter().enumerate().filter(|(_, line)| line.spoiled).map(|(index, _)| index + 2);
        assert_eq!(told, sorted_as(&told, spoiled.collect()), "set {seed}");
        for tool in 0..set.names.len() {
            for quantity in 0..2 {
                let name = format!("wear[{}].{}", set.names[tool], ["length", "radius"][quantity]);
                match (found.calibration.get(&name), rules.wear(tool, quantity)) {
                    (None, None) => {}
                    (Some(rate), Some((slope, uncertainty, _))) => {
                        // mm/s and um/min.
                        let [value, wanted] = [rate.value * 6e4, rate.standard_uncertainty * 6e4];
                        assert!((value - slope).abs() < 1e-9, "set {seed} {name}: {value} {slope}");
                        assert!((wanted / uncertainty - 1.0).abs() < 1e-6, "set {seed} {name}");
                        rates += 1;
                    }
                    (one, other) => panic!("set {seed} {name}: {one:?} {other:?}"),
                }
            }
        }
    }
    // Every verdict has to occur, or nothing was tried.
    for name in ["ok", "wrong-tool", "broken", "chipped", "worn", "recheck"] {
        assert!(counts.get(name).is_some_and(|count| *count >= 10), "{counts:?}");
    }
    assert!(noisy > 1000 && rates > 300, "{noisy} {rates}");
}

/// The second list in the order of the first, if they have the same entries.
fn sorted_as(first: &[usize], mut second: Vec<usize>) -> Vec<usize> {
    second.sort_by_key(|line| first.iter().position(|other| other == line));
    second
}

#[test]
fn a_bias_of_the_setter_in_a_session_changes_nothing() {
    for seed in [2, 5, 9, 16] {
        let set = Set::new(seed);
        let mut other = set.clone();
        for line in &mut other.log {
            line.value +=
                0.01 * (line.session as f64).sin() * (1.0 + line.method as f64) - 0.004 * line.quantity as f64;
        }
        let (one, other) = (set.run(), other.run());
        assert_eq!(one.named(), other.named(), "set {seed}");
        for &(session, tool, quantity) in set.sizes.keys() {
            let [a, b] = [&one, &other].map(|found| found.value(session, tool, quantity).0);
            assert!((a - b).abs() < 3e-9, "set {seed}: {a} {b}");
        }
    }
}

#[test]
fn the_order_of_tools_changes_nothing() {
    for seed in [1, 6, 11] {
        let set = Set::new(seed);
        let mut other = set.clone();
        // The log from the last tool to the first, in each session.
        other.log.sort_by_key(|line| (line.session, std::cmp::Reverse(line.tool)));
        let named = other.run().named();
        assert_eq!(set.run().named(), named, "set {seed}");
        let folder = temporary();
        let recipe = set.recipe(folder.path());
        let text = set.table_text();
        let mut lines: Vec<&str> = text.lines().collect();
        lines[1..].reverse();
        crate::support::write(&folder.path().join("tools.csv"), &(lines.join("\n") + "\n"));
        let verdict = &recipe.run().verdicts[0];
        let count = verdict.figures.iter().filter(|figure| figure.name.contains(",session=")).count();
        assert_eq!(count, named.len());
        for ((session, tool), (name, _)) in &named {
            let end = format!("[tool={},session={session}]", set.names[*tool]);
            let is = |name: &str, figure: &str| figure.starts_with(name) && figure.ends_with(&end);
            assert!(verdict.figures.iter().any(|figure| is(name, &figure.name)), "set {seed}: {name}{end}");
        }
    }
}

#[test]
fn what_comes_later_does_not_change_a_verdict() {
    for seed in [3, 4, 8, 13] {
        let set = Set::new(seed);
        let all = set.run().named();
        let half = set.log.last().expect("a reading").session / 2;
        let mut early = set.clone();
        early.log.retain(|line| line.session <= half);
        let kept: BTreeMap<_, _> = all.into_iter().filter(|((session, _), _)| *session <= half).collect();
        assert_eq!(early.run().named(), kept, "set {seed}");
    }
}

#[test]
fn a_world_twice_as_large_has_the_same_verdicts() {
    for seed in [7, 10, 12] {
        let set = Set::new(seed);
        let mut large = set.clone();
        large.log.iter_mut().for_each(|line| line.value *= 2.0);
        large.presets.iter_mut().chain(&mut large.wear_um).for_each(|pair| *pair = pair.map(|value| 2.0 * value));
        large.master.1 = large.master.1.map(|value| 2.0 * value);
        large.methods.iter_mut().for_each(|(_, s)| *s = s.map(|value| 2.0 * value));
        for length in [
            &mut large.master.2,
            &mut large.setting_um,
            &mut large.breakage,
            &mut large.chip,
            &mut large.close,
            &mut large.wrong,
        ] {
            *length *= 2.0;
        }
        assert_eq!(set.run().named(), large.run().named(), "set {seed}");
    }
}

/// What controls have to know after the last session, by the rules.
fn wanted(set: &Set, numbers: &[u32]) -> Control {
    let (rules, verdicts) = (Rules(set), Rules(set).verdicts());
    let last = set.log.last().expect("a reading").session;
    let mut control = Control::default();
    for (tool, number) in numbers.iter().enumerate() {
        let session = verdicts.keys().filter(|key| key.1 == tool).map(|key| key.0).max().expect("a session");
        let own = [0, 1].map(|quantity| rules.own(session, tool, quantity));
        match (own, verdicts[&(session, tool)].0.as_str()) {
            ([Some(length), Some(radius)], "ok" | "recheck") if session == last => {
                control.tools.insert(*number, (length.value, radius.value));
            }
            _ => control.locked.push(*number),
        }
    }
    control
}

#[test]
fn controls_get_the_offsets_of_other_sets() {
    let (mut tools, mut locked) = (0, 0);
    for seed in 1..=SETS {
        let (set, folder) = (Set::new(seed), temporary());
        let mut recipe = set.recipe(folder.path());
        // Numbers that are not those of the log.
        let numbers: Vec<u32> = (0..set.names.len()).map(|tool| 301 + 3 * tool as u32).collect();
        let by_name: BTreeMap<&String, &u32> = set.names.iter().zip(&numbers).collect();
        let decimals = 3 + (seed % 3) as i32;
        for (control, _, _) in CONTROLS {
            recipe.0["stages"][control] = json!({
                "export": "tool-offsets", "of": "tools", "control": control, "decimals": decimals, "numbers": by_name,
            });
        }
        let (outcome, wanted) = (recipe.run(), wanted(&set, &numbers));
        for (control, name, reader) in CONTROLS {
            let (_, files) = outcome.exports.iter().find(|(stage, _)| stage == control).expect("offsets");
            let file = files.iter().find(|file| file.name.ends_with(name)).expect("a file");
            let mut found = reader(&String::from_utf8(file.content.clone()).expect("text"));
            found.locked.sort_unstable();
            let increment = 10_f64.powi(-decimals);
            assert!(agrees(&found, &wanted, increment), "set {seed} {control}: {found:#?} {wanted:#?}");
            // What is worn turned: a tool that is too short is told to be too long.
            let turned = found.tools.iter().map(|(number, (length, radius))| {
                let tool = numbers.iter().position(|other| other == number).expect("a tool");
                (*number, (2.0 * set.presets[tool][0] - length, 2.0 * set.presets[tool][1] - radius))
            });
            let turned = Control { tools: turned.collect(), locked: found.locked.clone() };
            assert!(turned.tools.is_empty() || !agrees(&turned, &wanted, increment), "set {seed} {control}");
        }
        tools += wanted.tools.len();
        locked += wanted.locked.len();
    }
    assert!(tools > 100 && locked > 40, "{tools} {locked}");
}
