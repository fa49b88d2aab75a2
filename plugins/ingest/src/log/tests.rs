//! Random logs in the form of each control, written by code of their own, read back; and logs that went wrong.

mod ahead;
mod refused;

use std::fmt::Write;
use std::path::{Path, PathBuf};

use abbe_core::{Dataset, Ingest, Result};
use proptest::prelude::*;
use serde_json::{Value, json};

use super::controls::{Control, FANUC, HEIDENHAIN, LINUXCNC, SIEMENS, Settings};
use super::far::Bounds;
use super::matched::{Aborted, Repeats, Time, Told, Wanted, matched};
use super::plan::Plan;

const WANTED: Wanted = Wanted {
    repeats: Repeats::Keep,
    aborted: Aborted::Refuse,
    time: Time::Log,
    bounds: Bounds { length: 2.0, angle: 0.002 },
    tool_length: None,
    stylus_diameter: None,
};

/// A plan as text, and what its measuring program found.
#[derive(Debug, Clone)]
struct Run {
    /// Planned X, Y, Z in mm and C in degrees.
    plan: Vec<[f64; 4]>,
    repeats: usize,
    /// What is measured at each touch and repeat: misses before it, and the deviation if it hits in the end.
    tries: Vec<(usize, Option<[f64; 3]>)>,
    inches: bool,
    offset: Option<[f64; 4]>,
    pads: Vec<usize>,
    stale: bool,
}

fn runs() -> impl Strategy<Value = Run> {
    let position = || (-4_000_000_i64..4_000_000).prop_map(|steps| steps as f64 * 1e-4);
    let angle = (-3_600_000_i64..3_600_000).prop_map(|steps| steps as f64 * 1e-4);
    let touch = (position(), position(), position(), angle).prop_map(|(x, y, z, c)| [x, y, z, c]);
    let away = || (-5000_i64..5000).prop_map(|steps| steps as f64 * 1e-4);
    let found = prop::option::weighted(0.85, (away(), away(), away()).prop_map(|(x, y, z)| [x, y, z]));
    (
        prop::collection::vec(touch, 1..12),
        1_usize..4,
        any::<bool>(),
        prop::option::of((position(), position(), position())),
        any::<bool>(),
    )
        .prop_flat_map(move |(plan, repeats, inches, offset, stale)| {
            let tries = prop::collection::vec((0_usize..3, found.clone()), plan.len() * repeats);
            (tries, prop::collection::vec(0_usize..4, 40)).prop_map(move |(tries, pads)| Run {
                plan: plan.clone(),
                repeats,
                tries,
                inches,
                offset: offset.map(|(x, y, z)| [x, y, z, 45.0]),
                pads,
                stale,
            })
        })
}

impl Run {
    fn plan_text(&self) -> String {
        let mut text = "touch,feature,X_mm,Y_mm,Z_mm,C_deg,dir_X,nx,time_s\n".to_owned();
        for (index, [x, y, z, c]) in self.plan.iter().enumerate() {
            let direction = if index % 2 == 0 { 1 } else { -1 };
            let _ = writeln!(text, "{},f{},{x},{y},{z},{c},{direction},0.6,{index}", index + 1, index + 101);
        }
        text
    }

    fn plan(&self) -> Plan {
        plan(&self.plan_text())
    }

    /// Positions in machine coordinates of a touch that hits: mm and degrees.
    fn found(&self, touch: usize, away: [f64; 3]) -> [f64; 4] {
        let [x, y, z, c] = self.plan[touch];
        [x + away[0], y + away[1], z + away[2], c]
    }

    /// Touch and repeat, misses before, and positions.
    fn all(&self) -> impl Iterator<Item = (usize, usize, usize, Option<[f64; 4]>)> {
        self.tries.iter().enumerate().map(|(index, (misses, away))| {
            let touch = index / self.repeats;
            (touch, index % self.repeats, *misses, away.map(|away| self.found(touch, away)))
        })
    }

    fn scale(&self) -> f64 {
        if self.inches { 25.4 } else { 1.0 }
    }

    /// The log of a control, in the manner of this one.
    fn log(&self, form: usize) -> String {
        let numeral = |value: f64, pad: usize| match form {
            // `%f`, a padded field with the sign before its blanks, a plain real, a comma.
            0 => format!("{value:.14}"),
            1 => format!("{}{}{:.14}", if value.is_sign_negative() { "-" } else { "" }, " ".repeat(pad), value.abs()),
            2 => format!("{value:.17E}").replace("E-", "EX-"),
            _ => format!("{value:+.14}").replace('.', ","),
        };
        let integer = |value: usize, pad: usize| match form {
            0 => format!("{value}.000000"),
            1 => format!("{}{value:03}", " ".repeat(pad)),
            _ => value.to_string(),
        };
        let mut pads = self.pads.iter().copied().cycle();
        let mut next = || pads.next().unwrap_or(0);
        let control = ["LINUXCNC", "FANUC", "SIEMENS", "HEIDENHAIN"][form];
        let mut text = ["", "%\r\n\u{12}", "%_N_LOG_MPF\n;$PATH=/_N_MPF_DIR\n", ""][form].to_owned();
        let unit = if self.inches { "INCH" } else { "MM" };
        let frame = if self.offset.is_some() { "WORK" } else { "MACHINE" };
        let _ =
            write!(text, "ABBE 1\nPLAN {}\nCONTROL {control}\nUNITS {unit}\nFRAME {frame}\n", self.plan().identity());
        let offset = self.offset.unwrap_or_default();
        if self.offset.is_some() {
            text.push_str("OFFSET");
            for (axis, value) in "XYZC".chars().zip(offset) {
                let scaled = if axis == 'C' { value } else { value / self.scale() };
                let _ = write!(text, " {axis}{}", numeral(scaled, next()));
            }
            text.push('\n');
        }
        let _ = writeln!(text, "TOOL L{} D{}", 120.0 / self.scale(), 6.0 / self.scale());
        let _ =
            writeln!(text, "TOUCHES {}{}REPEATS {}", self.plan.len(), if form == 3 { "\n" } else { " " }, self.repeats);
        let separator = if form == 1 { "" } else { " " };
        let mut clock = 0.0;
        for (touch, repeat, misses, found) in self.all() {
            clock += 1.5;
            for hit in (0..misses).map(|_| false).chain([found.is_some()]) {
                let number = integer(touch + 1, next());
                let mut line = [format!("T{number}"), format!("R{}", repeat + 1), format!("H{}", usize::from(hit))]
                    .join(separator);
                let at = found.filter(|_| hit).or(self.stale.then_some([7.0; 4]));
                for (axis, (value, offset)) in "XYZC".chars().zip(at.unwrap_or_default().into_iter().zip(offset)) {
                    if at.is_some() {
                        let value = if axis == 'C' { value - offset } else { (value - offset) / self.scale() };
                        let _ = write!(line, "{separator}{axis}{}", numeral(value, next()));
                    }
                }
                if hit {
                    let _ = write!(line, "{separator}F{}{separator}K{clock}", 50.0 / self.scale());
                }
                let blanks = " ".repeat(if form == 1 { 0 } else { next() });
                let _ = write!(text, "{blanks}{line}{}", if form == 1 { "\r\n" } else { "\n" });
            }
        }
        text + ["END\n", "END\r\n%", "END\n", "END"][form]
    }

    /// The console of a host, which may send lines ahead.
    fn console(&self, host: usize, ahead: bool) -> String {
        let prefix = ["", ">>> ", "> ", "SND: 12 : "][host];
        let unit = if self.inches { "INCH" } else { "MM" };
        let mut text = String::from("Grbl 1.1h ['$' for help]\n[TLO:0.000]\n[PRB:0.000,0.000,0.000:0]\nok\n");
        for line in [
            "ABBE 1",
            &format!("PLAN {}", self.plan().identity()),
            &format!("UNITS {unit}"),
            "FRAME MACHINE",
            &format!("TOUCHES {} REPEATS {}", self.plan.len(), self.repeats),
        ] {
            let _ = write!(text, "{prefix}({line})\nok\n");
        }
        let (mut sent, mut answers) = (Vec::new(), Vec::new());
        for (touch, repeat, misses, found) in self.all() {
            for hit in (0..misses).map(|_| None).chain([found]) {
                let [x, y, z, c] = hit.unwrap_or([1.0; 4]);
                let scale = self.scale();
                let at = format!(
                    "{:.14},{:.14},{:.14},0.0,0.0,{c:.14}:{}",
                    x / scale,
                    y / scale,
                    z / scale,
                    usize::from(hit.is_some())
                );
                sent.push(format!("{prefix}G38.3 X5 F300 (search)\n"));
                answers.push("[PRB:9.000,9.000,9.000,0,0,0:1]\nok\n".to_owned());
                sent.push(format!("{prefix}N{} G91 G38.3 X1 F{}\n", 100 * (touch + 1) + repeat + 1, 50.0 / scale));
                answers.push(format!("[PRB:{at}]\nok\n"));
            }
        }
        match ahead {
            true => sent
                .chunks(3)
                .zip(answers.chunks(3))
                .for_each(|(sent, answers)| text += &(sent.concat() + &answers.concat())),
            false => sent.iter().zip(&answers).for_each(|(sent, answer)| text += &format!("{sent}{answer}")),
        }
        text + prefix + "(END)\nok\n"
    }

    /// Whether a data set is what was measured.
    fn compare(&self, data: &Dataset, tolerance: f64, has_clock: bool) -> Result<(), TestCaseError> {
        let expected: Vec<_> =
            self.all().filter_map(|(touch, repeat, _, found)| Some((touch, repeat, found?))).collect();
        prop_assert_eq!(data.rows(), expected.len());
        let label = |name: &str, row: usize| data.labels(name).expect("labels")[row].clone();
        let number = |name: &str, row: usize| data.numbers(name).expect("numbers")[row];
        for (row, (touch, repeat, [x, y, z, c])) in expected.into_iter().enumerate() {
            prop_assert_eq!(label("touch", row), (touch + 1).to_string());
            prop_assert_eq!(label("repeat", row), (repeat + 1).to_string());
            prop_assert_eq!(label("feature", row), format!("f{}", touch + 101));
            prop_assert_eq!(number("dir_X", row), if touch % 2 == 0 { 1.0 } else { -1.0 });
            for (name, value) in [("X", x), ("Y", y), ("Z", z), ("C", c.to_radians())] {
                prop_assert!((number(name, row) - value).abs() < tolerance, "{} {} {}", name, number(name, row), value);
            }
            prop_assert!((number("feed", row) - 50.0 / 60.0).abs() < 1e-12);
            prop_assert_eq!(data.numbers("time").is_some(), has_clock);
        }
        Ok(())
    }
}

fn plan(text: &str) -> Plan {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("plan.csv");
    std::fs::write(&path, text).expect("written");
    Plan { path: PathBuf::from("plan.csv"), ..Plan::read(&path).expect("a plan") }
}

const FORMS: [&Control; 4] = [&LINUXCNC, &FANUC, &SIEMENS, &HEIDENHAIN];

fn read(form: usize, text: &str, plan: &Plan, wanted: &Wanted) -> Result<Told> {
    let path = Path::new("log.txt");
    let log = match FORMS.get(form) {
        Some(control) => control.log(path, text, (1, usize::MAX))?,
        None => super::grbl::Console::new().expect("patterns").log(path, text, (1, usize::MAX))?,
    };
    matched(path, &log, plan, wanted)
}

fn refused(form: usize, text: &str, plan: &Plan) -> String {
    match read(form, text, plan, &WANTED) {
        Ok(_) => panic!("not refused:\n{text}"),
        Err(error) => error.to_string(),
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(192))]

    #[test]
    fn logs_come_back(run in runs(), form in 0_usize..4) {
        let text = run.log(form);
        match read(form, &text, &run.plan(), &WANTED) {
            Ok((data, remarks)) => {
                run.compare(&data, 1e-11, true)?;
                let missed = run.tries.iter().filter(|(_, away)| away.is_none()).count();
                prop_assert_eq!(remarks.len(), usize::from(missed > 0));
            }
            Err(error) => prop_assert!(run.tries.iter().all(|(_, away)| away.is_none()), "{}\n{}", error, text),
        }
    }

    #[test]
    fn consoles_come_back(mut run in runs(), host in 0_usize..4, ahead in any::<bool>()) {
        run.offset = None;
        let text = run.console(host, ahead);
        match read(4, &text, &run.plan(), &WANTED) {
            Ok((data, _)) => run.compare(&data, 1e-11, false)?,
            Err(error) => prop_assert!(run.tries.iter().all(|(_, away)| away.is_none()), "{}\n{}", error, text),
        }
    }

    /// Whatever happens to a log: what is read of it is what was measured, or it is refused.
    #[test]
    fn logs_that_went_wrong_give_no_wrong_number(run in runs(), form in 0_usize..4, kind in 0_usize..6, at in 0_usize..1000, aborted in any::<bool>()) {
        went_wrong(&run, form, &run.log(form), kind, at, aborted)?;
    }

    /// The same of consoles whose host waits for each answer.
    #[test]
    fn consoles_that_went_wrong_give_no_wrong_number(mut run in runs(), host in 0_usize..4, kind in 0_usize..6, at in 0_usize..1000, aborted in any::<bool>()) {
        run.offset = None;
        went_wrong(&run, 4, &run.console(host, false), kind, at, aborted)?;
    }

    #[test]
    fn any_text_is_read_or_refused(text in "[ -~\n]{0,300}", form in 0_usize..5) {
        let plan = plan("X_mm,C_deg\n1,2\n");
        let _ = read(form, &text, &plan, &WANTED);
        let _ = read(form, &format!("ABBE 1\nPLAN {}\nUNITS MM\nFRAME MACHINE\nTOUCHES 1\n{text}\nEND\n", plan.identity()), &plan, &WANTED);
    }
}

/// Cuts a log between lines or within one, doubles, removes or exchanges lines, or doubles all of it. Each row that is read is the one
/// that was measured at this touch and repeat.
fn went_wrong(
    run: &Run,
    form: usize,
    text: &str,
    kind: usize,
    at: usize,
    aborted: bool,
) -> std::result::Result<(), TestCaseError> {
    let lines: Vec<&str> = text.split_inclusive('\n').collect();
    let (one, other) = (at % lines.len(), (at * 7 + 3) % lines.len());
    let mut changed: Vec<String> = lines.iter().map(|line| (*line).to_owned()).collect();
    match kind {
        0 => changed.truncate(one),
        1 => changed = vec![text.chars().take(at * text.chars().count() / 1000).collect()],
        2 => changed.insert(other, lines[one].to_owned()),
        3 => drop(changed.remove(one)),
        4 => changed.swap(one, other),
        _ => changed.extend_from_within(..),
    }
    let wanted = Wanted { aborted: if aborted { Aborted::Accept } else { Aborted::Refuse }, ..WANTED };
    let Ok((data, _)) = read(form, &changed.concat(), &run.plan(), &wanted) else { return Ok(()) };
    is_measured(run, &data, &changed.concat())
}

/// Each row of a log is what was measured at its touch and repeat.
fn is_measured(run: &Run, data: &Dataset, text: &str) -> std::result::Result<(), TestCaseError> {
    let measured: Vec<_> = run.all().collect();
    for row in 0..data.rows() {
        let label = |name: &str| data.labels(name).expect("labels")[row].parse::<usize>().expect("a number");
        let (touch, repeat) = (label("touch"), label("repeat"));
        let found = measured.iter().find(|it| (it.0 + 1, it.1 + 1) == (touch, repeat)).and_then(|it| it.3);
        let Some([x, y, z, c]) = found else {
            return Err(TestCaseError::fail(format!("touch {touch} did not hit\n{}", text)));
        };
        for (name, value) in [("X", x), ("Y", y), ("Z", z), ("C", c.to_radians())] {
            let own = data.numbers(name).expect("numbers")[row];
            prop_assert!((own - value).abs() < 1e-11, "{}: {} {}\n{}", name, own, value, text);
        }
    }
    prop_assert!(data.rows() <= measured.iter().filter(|it| it.3.is_some()).count());
    Ok(())
}

/// The text that was agreed for the identity of a plan, hashed by `sha256sum`.
#[test]
fn the_identity_of_a_plan_is_the_agreed_one() {
    let plan = plan("touch,X_mm,Z_mm,C_deg,feature\n2,-1,-0.0000001,-45.5,a\n1,12.3456,-0.5,90,b\n");
    // printf 'T1 C90.000000 X12.345600 Z-0.500000\nT2 C-45.500000 X-1.000000 Z0.000000\n' | sha256sum
    assert_eq!(plan.identity(), "E02A911A469D2005");
}

#[test]
fn a_stage_reads_files_and_takes_means_of_repeats() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).expect("written");
    write("plan.csv", "X_mm,feature\n1,a\n2,b\n");
    let identity = Plan::read(&folder.path().join("plan.csv")).expect("a plan").identity();
    write(
        "measure.log",
        &format!(
            "ABBE 1\nPLAN {identity}\nUNITS MM\nFRAME MACHINE\nTOUCHES 2\nREPEATS 2\nT1 R1 H1 X1.1\nT1 R2 H1 X1.3\nT2 R1 H0 X9\nT2 R2 H1 X2.5\nEND\n"
        ),
    );
    let stage = |settings: Value| -> Box<dyn Ingest> {
        let settings: Settings = abbe_core::from_settings(&settings).expect("settings");
        let context = abbe_core::Context { base: folder.path().to_owned() };
        super::controls::linuxcnc(settings, &context).expect("a stage")
    };
    let stage = stage(
        json!({ "path": "measure.log", "plan": "plan.csv", "repeats": "average", "keep": { "feature": ["a", "b"] } }),
    );
    let data = stage.read().expect("data");
    assert_eq!(stage.headers().expect("headers"), data.headers());
    assert_eq!((stage.inputs().len(), stage.is_of_tables()), (2, false));
    let means = data.numbers("X").expect("positions");
    assert!((means[0] - 1.2).abs() < 1e-12 && means[1] == 2.5 && means.len() == 2, "{means:?}");
    assert_eq!(data.labels("feature").expect("features"), ["a", "b"]);
}

/// Long logs of every form are read to their end.
#[test]
fn long_logs_are_read_to_their_end() {
    const TOUCHES: usize = 32_000;
    let run = Run {
        plan: (0..TOUCHES).map(|touch| [touch as f64 * 1e-3, 1.0, 2.0, 3.0]).collect(),
        repeats: 1,
        tries: vec![(1, Some([0.1, 0.0, 0.0])); TOUCHES],
        inches: false,
        offset: None,
        pads: vec![1],
        stale: true,
    };
    let plan = run.plan();
    for form in 0..5 {
        let text = if form < 4 { run.log(form) } else { run.console(1, true) };
        let (data, _) = read(form, &text, &plan, &WANTED).expect("a log");
        assert_eq!(data.rows(), TOUCHES, "{form}");
    }
}
