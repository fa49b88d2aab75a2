//! Random histories: other machines, other events, other weeks. The touches come from a forward model of its own, written from the
//! conventions alone; what is found has to be what was put in.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use serde_json::{Value, json};

use super::{alarms, number, parameter, trend, uncertain};
use crate::support::{Random, Variant, read, recipes, root, temporary, write};

const WEEKS: u64 = 40;
const HISTORIES: u64 = 6;
const LENGTH: f64 = 214.0814;
const NAMES: [&str; 13] =
    ["EY0A", "EZ0A", "EB0A", "EC0A", "EX0C", "EY0C", "EA0C", "EB0C", "EC0Y", "EXX[1]", "EYY[1]", "EZZ[1]", "EXX[b]"];

/// A programmed touch.
pub(super) struct Touch {
    feature: usize,
    angles: [f64; 2],
    direction: [f64; 3],
    group: u32,
    place: Vector3<f64>,
}

type Errors = BTreeMap<&'static str, f64>;

/// Location of an axis: small turns about x, then y, then z, and a shift.
fn location(errors: &Errors, axis: char) -> Isometry3<f64> {
    let of = |letter: char| errors.get(format!("E{letter}0{axis}").as_str()).copied().unwrap_or(0.0);
    let turn = |axis: Vector3<f64>, angle: f64| UnitQuaternion::new(axis * angle);
    let turned = turn(Vector3::z(), of('C')) * turn(Vector3::y(), of('B')) * turn(Vector3::x(), of('A'));
    Isometry3::from_parts(Translation3::new(of('X'), of('Y'), of('Z')), turned)
}

/// The table seen from the bed: `w C' A' b`, where a positive command turns the table backwards.
fn table(errors: &Errors, [a, c]: [f64; 2]) -> Isometry3<f64> {
    let turn = |axis: Vector3<f64>, angle: f64| Isometry3::rotation(axis * -angle.to_radians());
    location(errors, 'A') * turn(Vector3::x(), a) * location(errors, 'C') * turn(Vector3::z(), c)
}

/// The tip in table coordinates: `b X Y Z t`.
fn tip(errors: &Errors, command: &Vector3<f64>, touch: &Touch) -> Vector3<f64> {
    let of = |name: &str| errors.get(name).copied().unwrap_or(0.0);
    let x = Translation3::new(command.x * (1.0 + of("EXX[1]")) + of("EXX[b]") * touch.direction[0], 0.0, 0.0);
    let y = location(errors, 'Y') * Translation3::new(0.0, command.y * (1.0 + of("EYY[1]")), 0.0);
    let z = Translation3::new(0.0, 0.0, command.z * (1.0 + of("EZZ[1]")) - 160.0);
    let point = (x * y * z) * nalgebra::Point3::origin();
    (table(errors, touch.angles).inverse() * point).coords
}

/// The balls, table frame.
fn balls() -> [Vector3<f64>; 2] {
    [Vector3::new(95.0, 20.0, 90.0), Vector3::new(-105.0, -45.0, 130.0)]
}

/// The programme of the set: which ball, from which side, at which angles.
pub(super) fn programme() -> Vec<Touch> {
    let text = read(&root().join("pipelines/data/history/exact/touches.csv"));
    let rows = text.lines().filter(|line| !line.starts_with('#')).skip(1);
    let touch = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        let cell = |index: usize| cells[index].parse::<f64>().expect("a number");
        (cells[12] == "1").then(|| Touch {
            feature: cell(1) as usize - 1,
            place: Vector3::new(cell(2), cell(3), cell(4)),
            angles: [cell(5), cell(6)],
            direction: [cell(7), cell(8), cell(9)],
            group: cell(11) as u32,
        })
    };
    rows.filter_map(touch).collect()
}

/// Where the machine stops when it touches a ball at `centre` from the side of the programme, `distance` from the centre.
fn stop(errors: &Errors, touch: &Touch, centre: &Vector3<f64>, distance: f64) -> Vector3<f64> {
    let nominal = tip(&Errors::new(), &touch.place, touch) - balls()[touch.feature];
    let target = centre + nominal.normalize() * distance;
    let mut command = touch.place;
    for _ in 0..8 {
        let missing = target - tip(errors, &command, touch);
        command += table(errors, touch.angles).rotation * missing;
    }
    command
}

/// What happens to an artefact, and to the stylus that touches it, mm.
#[derive(Default)]
pub(super) struct Worn {
    /// The first week.
    pub from: u64,
    /// How much longer the bar is.
    pub length: f64,
    /// How much larger each ball is, in radius.
    pub balls: [f64; 2],
    /// How much larger the stylus is, in radius.
    pub stylus: f64,
}

/// What happens to a machine.
pub(super) struct Story {
    baseline: Errors,
    settling: (f64, f64),
    wear: f64,
    season: f64,
    crash: (u64, &'static str, f64),
    bad: u64,
    missing: u64,
    temperatures: Vec<f64>,
    worn: Worn,
}

impl Story {
    /// A machine to which nothing happens.
    pub fn quiet(random: &mut Random) -> Self {
        let never = WEEKS + 1;
        let story = Self::new(random);
        Self {
            settling: (0.0, 1.0),
            wear: 0.0,
            season: 0.0,
            crash: (never, "EX0C", 0.0),
            bad: never,
            missing: never,
            ..story
        }
    }

    /// The same machine, to which this happens.
    pub fn with(self, worn: Worn, crash: (u64, &'static str, f64)) -> Self {
        Self { worn, crash, ..self }
    }

    pub fn new(random: &mut Random) -> Self {
        let size = |name: &str| match name {
            "EXX[b]" => 0.002,
            _ if name.starts_with("EX0") || name.starts_with("EY0") || name.starts_with("EZ0") => 0.03,
            _ => 5e-5,
        };
        let baseline: Errors =
            NAMES.iter().map(|name| (*name, random.sign() * size(name) * random.within(0.3, 1.0))).collect();
        let jumps = [("EX0C", 0.010), ("EY0C", 0.010), ("EY0A", 0.010), ("EB0A", 4e-5), ("EA0C", 4e-5), ("EB0C", 4e-5)];
        let (name, jump) = jumps[random.below(6)];
        let phase = random.within(0.0, 6.0);
        let temperature = |random: &mut Random, week: u64| {
            20.0 + 3.0 * (week as f64 / 52.0 * std::f64::consts::TAU + phase).sin() + 0.4 * random.normal()
        };
        let temperatures = (0..=WEEKS).map(|week| temperature(random, week)).collect();
        let crash = 8 + random.below(30) as u64;
        let other = |random: &mut Random| loop {
            let week = 4 + random.below(33) as u64;
            if week.abs_diff(crash) > 1 {
                return week;
            }
        };
        let bad = other(random);
        let missing = std::iter::repeat_with(|| other(random)).find(|week| *week != bad).expect("a week");
        Self {
            baseline,
            settling: (random.sign() * random.within(2.5e-5, 5e-5), random.within(3.0, 8.0)),
            wear: random.sign() * random.within(4e-5, 8e-5),
            season: random.sign() * random.within(2e-6, 4e-6),
            crash: (crash, name, random.sign() * jump * random.within(0.7, 1.5)),
            bad,
            missing,
            temperatures,
            worn: Worn::default(),
        }
    }

    fn errors(&self, week: u64) -> Errors {
        let mut errors = self.baseline.clone();
        let mut add = |name: &'static str, change: f64| *errors.entry(name).or_default() += change;
        add("EC0Y", self.settling.0 * (1.0 - (-(week as f64) / self.settling.1).exp()));
        add("EXX[b]", self.wear * week as f64);
        add("EYY[1]", self.season * (self.temperatures[week as usize] - 20.0));
        if week >= self.crash.0 {
            add(self.crash.1, self.crash.2);
        }
        errors
    }

    /// The tables of touches and temperatures.
    fn measure(&self, random: &mut Random, programme: &[Touch]) -> (String, String) {
        let mut touches =
            String::from("touch,feature,X_mm,Y_mm,Z_mm,A_deg,C_deg,dir_X,dir_Y,dir_Z,time_s,group,week\n");
        let mut temperatures = String::from("week,time_s,T01_degC\n");
        for week in 1..=WEEKS {
            let _ = writeln!(temperatures, "{week},0,{}", self.temperatures[week as usize]);
            if week == self.missing {
                continue;
            }
            let errors = self.errors(week);
            let mut shift =
                || Vector3::new(random.within(-0.1, 0.1), random.within(-0.1, 0.1), random.within(-0.1, 0.1));
            let first = balls()[0] + shift();
            let towards = (balls()[1] + shift() - first).normalize();
            let worn = if week >= self.worn.from { &self.worn } else { &Worn::default() };
            let centres = [first, first + towards * (LENGTH + worn.length)];
            for (number, touch) in programme.iter().enumerate() {
                let slipped = week == self.bad && touch.feature == 1 && touch.group > 4;
                let centre = centres[touch.feature]
                    + if slipped { Vector3::new(0.015, -0.012, 0.006) } else { Vector3::zeros() };
                let distance = 13.0 + worn.balls[touch.feature] + worn.stylus;
                let at = stop(&errors, touch, &centre, distance + 0.0007 * random.normal());
                let [a, c] = touch.angles;
                let [x, y, z] = touch.direction;
                let (name, feature, group) = (number + 1, touch.feature + 1, touch.group);
                let _ = writeln!(
                    touches,
                    "{name},{feature},{:.7},{:.7},{:.7},{a},{c},{x},{y},{z},0,{group},{week}",
                    at.x, at.y, at.z
                );
            }
        }
        (touches, temperatures)
    }
}

fn analysed(story: &Story, seed: u64, programme: &[Touch]) -> Value {
    analysed_by(story, seed, programme, |variant| variant)
}

/// What the recipe, changed by `change`, tells of what is measured on a machine.
pub(super) fn analysed_by(
    story: &Story,
    seed: u64,
    programme: &[Touch],
    change: impl FnOnce(Variant) -> Variant,
) -> Value {
    let folder = temporary();
    let (touches, temperatures) = story.measure(&mut Random(seed | 1), programme);
    let paths = ["touches.csv", "temperature.csv"].map(|name| folder.path().join(name));
    write(&paths[0], &touches);
    write(&paths[1], &temperatures);
    let unit = |name: &str| match name {
        "EXX[b]" => "mm",
        _ if name.ends_with("[1]") => "mm/mm",
        _ if name.starts_with("EX") || name.starts_with("EY0") || name.starts_with("EZ") => "mm",
        _ => "rad",
    };
    let values: BTreeMap<&str, Value> =
        story.baseline.iter().map(|(name, value)| (*name, json!({ "value": value, "unit": unit(name) }))).collect();
    let variant = Variant::of(&recipes()["history"])
        .set("touches", "path", json!(paths[0]))
        .set("temperature", "path", json!(paths[1]))
        .set("baseline", "values", json!(values));
    trend(&change(variant).run())
}

#[test]
fn other_machines_tell_their_own_story() {
    let programme = programme();
    let (mut told, mut within, mut asked, mut others) = (0, 0, 0, 0);
    for seed in 1..=HISTORIES {
        let mut random = Random(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1);
        random.unit();
        let story = Story::new(&mut random);
        let found = analysed(&story, seed.wrapping_mul(0xD1B5_4A32_D192_ED03), &programme);
        assert_eq!(found["analysis"]["missing"], json!([story.missing.to_string()]), "{seed}");
        let bad = found["quality"].as_array().expect("tests").iter().filter(|test| test["good"] == false);
        let bad: Vec<String> = bad.map(|test| test["label"].as_str().unwrap_or_default().to_owned()).collect();
        assert_eq!(bad, [story.bad.to_string()], "{seed}");
        let mut judge = |value: &Value, truth: f64| {
            let (value, uncertainty) = uncertain(value);
            asked += 1;
            within += usize::from((value - truth).abs() <= 3.0 * uncertainty);
        };
        let settling = &parameter(&found, "EC0Y")["change"];
        if settling["form"] == "exponential" {
            told += 1;
            judge(&settling["amplitude"], story.settling.0);
            judge(&settling["time_constant"], story.settling.1);
        }
        let wear = &parameter(&found, "EXX[b]")["change"];
        if wear["form"] == "line" {
            told += 1;
            judge(&wear["rate"], story.wear);
        }
        let season = parameter(&found, "EYY[1]");
        assert_ne!(season["state"], "changed", "{seed}");
        judge(&season["seasonal"]["coefficient"], story.season);
        let (week, name, size) = story.crash;
        let jump = &parameter(&found, name)["change"];
        assert_eq!(jump["form"], "step", "{seed}: {name} in week {week}");
        let first = &found["analysis"]["tests"][jump["first"].as_u64().expect("a test") as usize];
        assert!((number(&first["at"]) - week as f64).abs() <= 1.0, "{seed}: week {week}");
        judge(&jump["size"], size);
        assert!(alarms(&found, name, "sum").first().is_some_and(|first| first.abs_diff(week) <= 1));
        let known = [name, "EC0Y", "EXX[b]", "EYY[1]"];
        let silent = NAMES.iter().filter(|other| !known.contains(other));
        others += silent.filter(|other| parameter(&found, other)["state"] == "changed").count();
    }
    assert!(told >= 2 * HISTORIES - 1 && others <= 1, "{told} told, {others} others");
    assert!(within >= asked - 1, "{within} of {asked} within three uncertainties");
}

/// A machine whose errors turn the other way is another machine: the forward model would not fit.
#[test]
fn the_forward_model_has_the_signs_of_the_conventions() {
    let programme = programme();
    let mut random = Random(99);
    let story = Story::new(&mut random);
    let found = analysed(&story, 7, &programme);
    let first = |name: &str| uncertain(&parameter(&found, name)["values"][0]);
    for name in ["EB0A", "EX0C", "EA0C", "EC0Y", "EXX[1]"] {
        let (value, uncertainty) = first(name);
        let truth = story.errors(1)[name];
        assert!((value - truth).abs() < 5.0 * uncertainty, "{name}: {value} against {truth}");
        assert!((value + truth).abs() > 3.0 * uncertainty, "{name} has no sign");
    }
}
