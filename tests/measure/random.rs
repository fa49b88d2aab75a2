//! Programs of random machines in all five languages: the right place, side, sense and order; their time; inches; and plans of a time.

use std::collections::BTreeSet;
use std::fmt::Write;

use super::faces::moves_the_tip;
use super::klartext::RAPID;
use super::{CONTROLS, Planned, SPHERE};
use crate::controls::law::{seeds, uniform};
use crate::models::all_chains;
use crate::support::{fit, read, registry, write};

/// A random chain of three to five axes, three of them linear.
pub fn chain(random: &mut impl FnMut() -> f64) -> String {
    let chains = all_chains();
    // The few chains of three and four axes as often as those of five.
    let axes = 3 + (random() * 3.0) as usize;
    let of_size: Vec<&String> = chains
        .iter()
        .filter(|chain| chain.chars().filter(|letter| "XYZABC".contains(*letter)).count() == axes)
        .collect();
    of_size[(random() * of_size.len() as f64) as usize % of_size.len()].clone()
}

/// Random settings of a program; whether it is in inches.
pub fn settings(random: &mut impl FnMut() -> f64) -> (String, bool) {
    let mut text = format!("    unreachable: leave-out\n    rapid_feed_mm_per_min: {RAPID}\n");
    let inches = random() < 0.5;
    text.push_str(if inches { "    units: inch\n" } else { "" });
    if random() < 0.5 {
        let _ = writeln!(text, "    search_feed_mm_per_min: {:.0}", 100.0 + 300.0 * random());
    }
    let _ = writeln!(text, "    measuring_feed_mm_per_min: {:.0}", 20.0 + 60.0 * random());
    let _ = writeln!(text, "    positioning_feed_mm_per_min: {:.0}", 800.0 + 2000.0 * random());
    let _ = writeln!(text, "    rotary_feed_deg_per_min: {:.0}", 500.0 + 3000.0 * random());
    let _ =
        writeln!(text, "    approach_mm: {:.1}\n    overtravel_mm: {:.1}", 3.0 + 4.0 * random(), 1.5 + 2.0 * random());
    let _ = writeln!(text, "    repeats: {}", 1 + (random() * 3.0) as usize);
    if random() < 0.5 {
        let _ = writeln!(text, "    settle_s: {:.2}", 0.1 + 4.0 * random());
    }
    (text, inches)
}

/// The plan with another limit in the place of its number.
pub fn limited<'a>(limit: &'a str) -> impl Fn(&str) -> String + 'a {
    move |recipe| {
        let lines = recipe.lines().map(|line| if line.starts_with("  number: ") { limit } else { line });
        lines.collect::<Vec<_>>().join("\n") + "\n"
    }
}

pub fn seconds(planned: &Planned) -> f64 {
    planned.record["program"]["seconds"].as_f64().expect("the time of a program")
}

/// The touches in their order, without repeats: every one of the plan as often as `more` says, one after another, touches of one
/// indexation together.
pub fn in_order(planned: &Planned, (hits, misses): (&[usize], usize), more: &str, what: &str) -> Vec<usize> {
    let repeats: usize = more.split("repeats: ").nth(1).and_then(|rest| rest[..1].parse().ok()).expect("repeats");
    assert_eq!((hits.len(), misses), (repeats * planned.touches.len(), 0), "{what}");
    let order: Vec<usize> = hits.chunks(repeats).map(|same| same[0]).collect();
    assert!(hits.chunks(repeats).all(|same| same.iter().all(|touch| *touch == same[0])), "{what}{hits:?}");
    assert_eq!(order.iter().collect::<BTreeSet<_>>().len(), planned.touches.len(), "{what}");
    let at = |touch: &usize| -> Vec<String> {
        let rotary = planned.touches[touch].iter().filter(|(name, _)| name.ends_with("_deg"));
        rotary.map(|(name, place)| format!("{name}{place:.3}")).collect()
    };
    let changes = order.windows(2).filter(|pair| at(&pair[0]) != at(&pair[1])).count();
    assert_eq!(changes + 1, order.iter().map(at).collect::<BTreeSet<_>>().len(), "{what}");
    order
}

/// A program of a random machine: what it measures where the ball is off, its time where it is not, and an axis the other way round.
#[test]
fn programs_of_random_machines_measure_the_plan_in_the_time_that_they_say() {
    let (mut touched, mut turned, mut worst) = (0, 0, 0.0_f64);
    for seed in seeds(5) {
        let mut random = uniform(900 + seed);
        let (control, file, _) = CONTROLS[seed as usize % CONTROLS.len()];
        let chain = chain(&mut random);
        let (more, inches) = settings(&mut random);
        let number = format!("  number: {}", 4 + (random() * 4.0) as usize);
        let what = format!("{seed}: {chain} {control}\n{more}");
        let planned = match Planned::of(&chain, control, SPHERE, &more, &limited(&number)) {
            Ok(planned) => planned,
            // Too few indexations for this chain; nothing was written.
            Err(message) if message.contains("too small to determine") => {
                Planned::of(&chain, control, SPHERE, &more, &limited("  number: 12"))
                    .unwrap_or_else(|error| panic!("{what}{error}"))
            }
            Err(message) => panic!("{what}{message}"),
        };
        let off = [0, 1, 2].map(|_| 0.16 * random() - 0.08);
        let mut machine = planned.machine(off);
        let (hits, misses) =
            planned.measured(control, file, &mut machine).unwrap_or_else(|error| panic!("{what}{error}"));
        assert_eq!(machine.unit, Some(if inches { 25.4 } else { 1.0 }), "{what}");
        let order = in_order(&planned, (&hits, misses), &more, &what);
        touched += order.len();
        // With the ball in its place all moves take what was said, within the digits of the program.
        let mut machine = planned.machine([0.0; 3]);
        planned.measured(control, file, &mut machine).unwrap_or_else(|error| panic!("{what}{error}"));
        let apart = (machine.seconds / seconds(&planned) - 1.0).abs();
        assert!(apart < 1e-3, "{what}{} s, said are {} s", machine.seconds, seconds(&planned));
        worst = worst.max(apart);
        // An axis that goes the other way, one after another of those that the plan moves.
        for axis in machine.model.info().axes.clone() {
            let moves = moves_the_tip(&planned, &mut planned.machine([0.0; 3]), &axis.name);
            if moves && random() < 0.7 {
                let mut machine = planned.machine([0.0; 3]);
                machine.flipped = Some(axis.name.clone());
                let found = planned.measured(control, file, &mut machine);
                let all = found.as_ref().is_ok_and(|(again, misses)| again.len() == hits.len() && *misses == 0);
                assert!(!all, "{what}{}: {found:?}", axis.name);
                turned += 1;
            }
        }
    }
    println!("{touched} touches; {turned} axes the other way; times within {worst:.1e}");
    assert!(turned > 0);
}

/// The chosen plan of a time takes no longer, by its own word and by the sum of the moves of its program; more time is never worse.
#[test]
fn a_plan_of_minutes_keeps_its_time_and_more_time_is_never_worse() {
    for seed in seeds(2) {
        let mut random = uniform(40 + seed);
        let (control, file, _) = CONTROLS[(seed as usize + 2) % CONTROLS.len()];
        let chain = chain(&mut random);
        let (more, _) = settings(&mut random);
        let one_touch = |line: &&str| !line.contains("repeats:");
        let more: String = more.lines().filter(one_touch).map(|line| format!("{line}\n")).collect();
        let repeats = if seed % 2 == 0 { "" } else { "  repeats: { noise_um: 1.9, most: 3 }\n" };
        let of = |minutes: f64| {
            Planned::of(
                &chain,
                control,
                SPHERE,
                &more,
                &limited(&format!("  minutes: {minutes:.3}\n  restarts: 3\n{repeats}")),
            )
        };
        let what = format!("{seed}: {chain} {control}\n{more}{repeats}");
        // So little that no plan is made of it says how much is needed.
        let refused = of(0.05).err().expect("too little time");
        let least: f64 = refused
            .split_once("the shortest program that was found takes ")
            .and_then(|(_, rest)| rest.split(' ').next()?.parse().ok())
            .unwrap_or_else(|| panic!("{what}{refused}"));
        let mut before: Option<(f64, f64)> = None;
        for factor in [1.02, 1.0 + 0.5 * random(), 1.6, 1.7 + random(), 3.0] {
            let minutes = least.max(0.1) * factor;
            let planned = match of(minutes) {
                Ok(planned) => planned,
                // The least is told with one decimal.
                Err(message) if before.is_none() && factor < 1.6 => {
                    assert!(message.contains("too small to determine"), "{what}{message}");
                    continue;
                }
                Err(message) => panic!("{what}{message}"),
            };
            let said = seconds(&planned);
            assert!(said <= 60.0 * minutes * (1.0 + 1e-9), "{what}{said} s in {minutes} minutes");
            let mut machine = planned.machine([0.0; 3]);
            let (hits, _) =
                planned.measured(control, file, &mut machine).unwrap_or_else(|error| panic!("{what}{error}"));
            assert!((machine.seconds / said - 1.0).abs() < 1e-3, "{what}{} s, said are {said} s", machine.seconds);
            let times = planned.record["program"]["repeats"].as_u64().expect("a number") as usize;
            assert_eq!(hits.len(), times * planned.touches.len(), "{what}");
            let value = planned.record["figures"]["log_determinant"].as_f64().expect("a number");
            println!(
                "{seed} {chain}: {minutes:.2} minutes, {said:.0} s, {} touches, {times} times: {value:.3}",
                planned.touches.len()
            );
            if let Some((minutes, less)) = before {
                assert!(value >= less - 1e-9, "{what}{value}, with {minutes} minutes {less}");
            }
            before = before.filter(|(_, less)| *less > value).or(Some((minutes, value)));
        }
        assert!(before.is_some(), "{what}");
    }
}

/// The readers, by the names of the controls.
pub const READERS: [(&str, &str); 5] = [
    ("linuxcnc", "linuxcnc-log"),
    ("fanuc", "dprnt"),
    ("siemens", "siemens-log"),
    ("heidenhain", "heidenhain-log"),
    ("grbl", "grbl-log"),
];

/// Where the fit of a log has the ball, beside its nominal place; the message if there is none.
fn fitted(planned: &Planned, reader: &str, log: &str, more: &str) -> Result<[f64; 3], String> {
    let begun = planned.folder.path().join("begun");
    write(&begun.join("measure.log"), log);
    write(&begun.join("plan.csv"), &planned.files["plan.csv"]);
    let recipe = read(&begun.join("recipe.yaml"));
    let ingest = format!("{{ ingest: {reader}, path: measure.log, plan: plan.csv, repeats: average{more} }}");
    let recipe = recipe.replacen("{ ingest: csv, path: touches.csv }", &ingest, 1);
    assert!(recipe.contains(reader), "{recipe}");
    write(&begun.join("logged.yaml"), &recipe);
    let outcome = abbe_engine::prepare(&begun.join("logged.yaml"), &registry())
        .and_then(|prepared| prepared.run(&abbe_core::Monitor::default()))
        .map_err(|error| format!("{error} {}", error.help.as_deref().unwrap_or_default()))?;
    let calibration = &fit(&outcome, "fit").calibration;
    Ok(["x", "y", "z"].map(|axis| calibration.get(&format!("ball.ball[1].{axis}")).expect("the ball").value))
}

/// Programs in inches and in millimetres leave logs that their readers understand; of two runs in one file the last one counts, if so
/// wanted.
#[test]
fn logs_of_programs_are_read_back_whatever_their_unit_and_however_many_runs_they_have() {
    for (index, (control, file, _)) in CONTROLS.into_iter().enumerate() {
        for unit in ["mm", "inch"] {
            let more = format!("    units: {unit}\n    repeats: 2\n    search_feed_mm_per_min: 200\n");
            let planned = Planned::of("w C' A' b X Y Z t", control, SPHERE, &more, &|recipe| {
                // As many indexations as make rounding small.
                limited("  number: 12")(recipe)
            });
            let planned = planned.unwrap_or_else(|error| panic!("{control}: {error}"));
            let off = super::random(3 * index + usize::from(unit == "mm"));
            let run = |off: [f64; 3]| {
                let mut machine = planned.machine(off);
                planned.measured(control, file, &mut machine).unwrap_or_else(|error| panic!("{control}: {error}"));
                machine.log.join("\n") + "\n"
            };
            let reader = READERS.iter().find(|(name, _)| *name == control).expect("a reader").1;
            let near = |found: [f64; 3], what: &str| {
                for axis in 0..3 {
                    let apart = (found[axis] - off[axis]).abs();
                    assert!(apart < 0.012, "{control} {unit}, {what}: {found:?}, the ball is off by {off:?}");
                }
            };
            let log = run(off);
            assert!(log.contains(if unit == "mm" { "UNITS MM" } else { "UNITS INCH" }), "{log}");
            near(fitted(&planned, reader, &log, "").unwrap_or_else(|error| panic!("{control}: {error}")), "one run");
            // A log in the other unit is nowhere near the plan.
            let other = match unit {
                "mm" => log.replace("UNITS MM", "UNITS INCH"),
                _ => log.replace("UNITS INCH", "UNITS MM"),
            };
            let error = fitted(&planned, reader, &other, "").expect_err("another unit");
            assert!(error.contains("touch"), "{error}");
            // The control has appended.
            let first = run([0.0; 3]);
            let both = first.clone() + &log;
            let error = fitted(&planned, reader, &both, "").expect_err("two runs");
            assert!(error.contains("a second run of a program begins here; the file has 2 of them"), "{error}");
            assert!(error.contains("runs: last"), "{error}");
            near(
                fitted(&planned, reader, &both, ", runs: last").unwrap_or_else(|error| panic!("{control}: {error}")),
                "two",
            );
            // A last run that was stopped does not count beside a whole one; alone it is refused as it would be.
            let cut: String = first.lines().take(first.lines().count() / 2).map(|line| format!("{line}\n")).collect();
            let found = fitted(&planned, reader, &(log.clone() + &cut), ", runs: last");
            near(found.unwrap_or_else(|error| panic!("{control}: {error}")), "the last one was stopped");
            let error = fitted(&planned, reader, &(cut.clone() + &cut), ", runs: last").expect_err("both were stopped");
            assert!(error.contains("END"), "{control}: {error}");
        }
    }
}
