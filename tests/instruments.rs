//! Instruments that are dead, stuck, cut off at their range or read twice, readings that are those of another label, and files that
//! contradict themselves: no verdict rests on them without a word. The same recipes with their own data say nothing.

use std::fs;
use std::path::Path;

use abbe_core::Decision;
use abbe_engine::{Outcome, prepare};
use serde_json::json;

use crate::misread::changed;
use crate::support::{Random, Variant, abbe, read, recipes, registry, stem, temporary, write};

/// What a change does to the cell of a row.
type Change<'a> = &'a dyn Fn(usize, &str) -> String;

fn number(cell: &str) -> f64 {
    cell.parse().expect("a number")
}

/// A recipe with a change of one column of the table that a stage reads.
fn with(recipe: &mut Variant, folder: &Path, (stage, column): (&str, &str), change: Change<'_>) {
    let own = folder.join(format!("{stage}-{column}"));
    fs::create_dir_all(&own).expect("a folder");
    let file = changed(&recipe.path(stage, "path"), &own, column, change);
    recipe.stage(stage)["path"] = json!(file);
}

/// The cells of a column.
fn cells(file: &Path, column: &str) -> Vec<String> {
    let text = read(file);
    let mut lines = text.lines().filter(|line| !line.starts_with('#'));
    let place = lines.next().and_then(|header| header.split(',').position(|name| name == column)).expect("the column");
    lines.map(|line| line.split(',').nth(place).expect("a cell").to_owned()).collect()
}

fn remarks(outcome: &Outcome, stage: &str) -> String {
    assert!(outcome.failures.is_empty(), "{:?}", outcome.failures.first().map(|failure| &failure.error));
    outcome
        .verdicts
        .iter()
        .filter(|verdict| verdict.stage == stage)
        .flat_map(|verdict| verdict.remarks.clone())
        .collect()
}

fn decision(outcome: &Outcome, stage: &str) -> Decision {
    outcome.verdicts.iter().find(|verdict| verdict.stage == stage).expect("the verdict").decision
}

/// What a run says in its JSON, whatever its status.
fn said(recipe: &Variant, folder: &Path) -> String {
    let (file, out) = (recipe.write(folder), folder.join("out"));
    let printed =
        abbe(folder, &["run".as_ref(), file.as_os_str(), "--json".as_ref(), "--out".as_ref(), out.as_os_str()]);
    format!("{}\n{}", printed.stdout, printed.stderr)
}

const FAULTS: [&str; 7] = [
    "was it connected?",
    "transducer read twice?",
    "at the end of its range?",
    "did it stick?",
    "are they copies",
    "is one direction in another unit?",
    "with the sign turned",
];

/// A test of a standard whose readings are changed is told and decides nothing; as it was it says nothing.
fn told_and_undecided((name, judge): (&str, &str), changes: &[((&str, &str), Change<'_>)], word: &str) {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()[name]);
    let good = remarks(&recipe.run(), judge);
    assert!(!FAULTS.iter().any(|fault| good.contains(fault)), "{name}: {good}");
    changes.iter().for_each(|(place, change)| with(&mut recipe, folder.path(), *place, change));
    let outcome = recipe.run();
    let said = remarks(&outcome, judge);
    assert!(said.contains(word), "{name} {judge}: {said}");
    assert_eq!(decision(&outcome, judge), Decision::Inconclusive, "{name} {judge}: {said}");
}

const ROTARY: (&str, &str) = ("standards-rotary-interpolation", "c-axis");

#[test]
fn a_transducer_of_an_r_test_that_is_dead_decides_nothing() {
    let dead: Change<'_> = &|_, _| "-0.0".to_owned();
    told_and_undecided(ROTARY, &[(("read-c", "meas_y_um"), dead)], FAULTS[0]);
    told_and_undecided(ROTARY, &[(("read-c", "meas_x_um"), dead), (("read-c", "meas_y_um"), dead)], FAULTS[0]);
    let stuck: Change<'_> = &|row, cell| if row < 11 { cell.to_owned() } else { "3.0".to_owned() };
    told_and_undecided(ROTARY, &[(("read-c", "meas_x_um"), stuck)], FAULTS[3]);
    let x = cells(&Variant::of(&recipes()[ROTARY.0]).path("read-c", "path"), "meas_x_um");
    let copy: Change<'_> = &|row, _| x[row].clone();
    told_and_undecided(ROTARY, &[(("read-c", "meas_y_um"), copy)], FAULTS[1]);
}

#[test]
fn a_transducer_that_has_its_own_earlier_readings_decides_nothing() {
    let of = |column: &str| cells(&Variant::of(&recipes()[ROTARY.0]).path("read-c", "path"), column);
    for column in ["meas_x_um", "meas_y_um", "meas_z_um"] {
        let own = of(column);
        let back: Change<'_> = &|row, _| own[row.min(49 - row)].clone();
        told_and_undecided(ROTARY, &[(("read-c", column), back)], "has its own earlier readings");
    }
    let own = of("meas_z_um");
    let again: Change<'_> = &|row, _| own[row % 6].clone();
    told_and_undecided(ROTARY, &[(("read-c", "meas_z_um"), again)], "has its own earlier readings");
}

#[test]
fn calibrated_lengths_in_the_place_of_measured_ones_decide_nothing() {
    let file = Variant::of(&recipes()["standards-cmm"]).path("lengths-beside", "path");
    let references = cells(&file, "reference_mm");
    let copied: Change<'_> = &|row, cell| if row < 6 { cell.to_owned() } else { references[row].clone() };
    told_and_undecided(
        ("standards-cmm", "e150"),
        &[(("lengths-beside", "measured_mm"), copied)],
        "were measured as calibrated",
    );
}

#[test]
fn readings_that_are_cut_off_decide_nothing() {
    let clipped = |most: f64| move |_: usize, cell: &str| format!("{}", number(cell).clamp(-most, most));
    let (five, three) = (clipped(5.0), clipped(3.0));
    let circular = ("standards-circular", "circles");
    told_and_undecided(circular, &[(("slow", "reading_um"), &five), (("fast", "reading_um"), &five)], FAULTS[2]);
    told_and_undecided(("standards-positioning", "positioning"), &[(("linear", "reading_um"), &three)], FAULTS[2]);
}

/// Angles in another unit: what is left of a turn is no circle that was measured.
#[test]
fn angles_of_many_turns_decide_nothing() {
    let word = "turns, and a circle is measured over one";
    let good = remarks(&Variant::of(&recipes()["standards-circular"]).run(), "circles");
    assert!(!good.contains(word), "{good}");
    for factor in [5.0, 25.0, 57.29577951308232] {
        let folder = temporary();
        let mut recipe = Variant::of(&recipes()["standards-circular"]);
        for stage in ["slow", "fast"] {
            let larger = |_: usize, cell: &str| format!("{}", factor * number(cell));
            with(&mut recipe, folder.path(), (stage, "angle_deg"), &larger);
        }
        let outcome = recipe.run();
        let said = remarks(&outcome, "circles");
        assert_eq!(said.matches(word).count(), 2, "{factor}: {said}");
        assert_ne!(decision(&outcome, "circles"), Decision::Pass, "{factor}: {said}");
        let kept =
            outcome.verdicts.iter().filter(|verdict| verdict.stage == "circles").flat_map(|verdict| &verdict.figures);
        let kept = kept.filter(|figure| figure.limit.is_some() && figure.inconclusive.is_none() && figure.passes());
        assert_eq!(kept.count(), 0, "{factor}");
    }
}

/// The cells of rows in one direction, times a factor.
fn times(recipe: &Variant, stage: &str, way: &str, factor: f64) -> impl Fn(usize, &str) -> String + use<> {
    let ways = cells(&recipe.path(stage, "path"), "direction");
    let way = way.to_owned();
    move |row, cell| match ways[row] == way {
        true => format!("{}", factor * number(cell)),
        false => cell.to_owned(),
    }
}

/// What a verdict says of readings of one direction that are changed by a factor; no limit of the changed test is kept.
fn one_direction(name: &str, judge: &str, stage: &str, columns: &[&str], (way, factor): (&str, f64)) -> String {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()[name]).only(&[judge]);
    let change = times(&recipe, stage, way, factor);
    let file = stem(&recipe.path(stage, "path"));
    for column in columns {
        with(&mut recipe, folder.path(), (stage, column), &change);
    }
    let outcome = recipe.run();
    let kept = outcome.verdicts.iter().flat_map(|verdict| &verdict.figures).filter(|figure| {
        figure.name.contains(&file) && figure.limit.is_some() && figure.inconclusive.is_none() && figure.passes()
    });
    let kept: Vec<&String> = kept.map(|figure| &figure.name).collect();
    let said = remarks(&outcome, judge);
    if said.contains(FAULTS[5]) || said.contains(FAULTS[6]) {
        assert_eq!(kept, [""; 0], "{name} {stage} {way} {factor}");
    }
    said
}

#[test]
fn one_direction_in_another_unit_decides_nothing() {
    let um: &[&str] = &["reading_um"];
    let cases: [(&str, &str, &str, &[&str]); 9] = [
        ("standards-positioning", "positioning", "linear", um),
        ("standards-positioning", "positioning", "rotary", &["reading_urad"]),
        ("standards-positioning", "positioning-long", "long", um),
        ("standards-diagonals", "diagonals", "ppp", um),
        ("standards-diagonals", "diagonals", "zx-np", um),
        ("standards-circular", "arc-of-a-circle", "arc", um),
        ("standards-circular", "circles", "slow", um),
        ("standards-circular", "circles", "fast", um),
        (ROTARY.0, ROTARY.1, "read-c", &["meas_x_um", "meas_y_um", "meas_z_um"]),
    ];
    for (name, judge, stage, columns) in cases {
        for way in ["-1", "1"] {
            for (factor, word) in [(1e-3, true), (1e3, true), (1.0, false), (0.5, false), (2.0, false)] {
                // Deviations of circles that are a thousand times as large are none.
                if factor > 100.0 && name == "standards-circular" {
                    continue;
                }
                let said = one_direction(name, judge, stage, columns, (way, factor));
                assert_eq!(said.contains(FAULTS[5]), word, "{name} {stage} {way} {factor}: {said}");
            }
        }
    }
    // In inches for millimetres, or the other way round.
    for (name, judge, stage) in [
        ("standards-positioning", "positioning", "linear"),
        ("standards-diagonals", "diagonals", "ppp"),
        ("standards-circular", "arc-of-a-circle", "arc"),
        ("standards-circular", "circles", "fast"),
    ] {
        let said = one_direction(name, judge, stage, um, ("-1", 1.0 / 25.4));
        assert!(said.contains(FAULTS[5]), "{name} {stage}: {said}");
    }
}

#[test]
fn one_direction_with_turned_signs_decides_nothing() {
    for (name, judge, stage, column) in [
        ("standards-positioning", "positioning", "linear", "reading_um"),
        ("standards-positioning", "positioning", "rotary", "reading_urad"),
        ("standards-diagonals", "diagonals", "ppp", "reading_um"),
        ("standards-diagonals", "diagonals", "npp", "reading_um"),
        ("standards-diagonals", "diagonals", "pnp", "reading_um"),
        ("standards-diagonals", "diagonals", "nnp", "reading_um"),
    ] {
        for way in ["-1", "1"] {
            let said = one_direction(name, judge, stage, &[column], (way, -1.0));
            assert!(said.contains(FAULTS[6]), "{name} {stage} {way}: {said}");
        }
    }
    // All signs turned are those of another machine.
    let recipe = Variant::of(&recipes()["standards-positioning"]);
    assert!(!remarks(&recipe.run(), "positioning").contains(FAULTS[6]));
}

#[test]
fn a_beam_that_is_lost_decides_nothing() {
    let lost: Change<'_> = &|row, cell| if (4..22).contains(&row) { "0.00".to_owned() } else { cell.to_owned() };
    told_and_undecided(("standards-positioning", "positioning-long"), &[(("long", "reading_um"), lost)], FAULTS[3]);
}

#[test]
fn repeats_and_styli_that_are_copies_decide_nothing() {
    let recipe = Variant::of(&recipes()["standards-cmm"]);
    let measured = cells(&recipe.path("lengths", "path"), "measured_mm");
    let first: Change<'_> = &|row, _| measured[row - row % 3].clone();
    told_and_undecided(("standards-cmm", "e0"), &[(("lengths", "measured_mm"), first)], FAULTS[4]);
    let file = recipe.path("sphere", "path");
    let styli = cells(&file, "stylus");
    let columns = ["x_mm", "y_mm", "z_mm"].map(|name| (name, cells(&file, name)));
    let of = |label: &str| (0..styli.len()).filter(|row| styli[*row] == label).collect::<Vec<_>>();
    let (two, three) = (of("2"), of("3"));
    let pasted = columns.clone().map(|(name, cells)| {
        let (two, three) = (two.clone(), three.clone());
        let change = move |row: usize, cell: &str| match three.iter().position(|own| *own == row) {
            Some(place) => cells[two[place]].clone(),
            None => cell.to_owned(),
        };
        (name, change)
    });
    let changes: Vec<((&str, &str), Change<'_>)> =
        pasted.iter().map(|(name, change)| (("sphere", *name), change as Change<'_>)).collect();
    told_and_undecided(("standards-cmm", "probing"), &changes, FAULTS[4]);
}

/// A CMM that shows micrometres repeats them.
#[test]
fn coarse_lengths_that_repeat_are_no_copies() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["standards-cmm"]);
    let measured = cells(&recipe.path("lengths", "path"), "measured_mm");
    let coarse: Change<'_> = &|row, _| format!("{:.3}", number(&measured[row - row % 3]));
    with(&mut recipe, folder.path(), ("lengths", "measured_mm"), coarse);
    let said = remarks(&recipe.run(), "e0");
    assert!(!said.contains(FAULTS[4]), "{said}");
}

/// The same instruments where an estimate is made of them.
#[test]
fn dead_and_copied_channels_of_an_estimate_fail() {
    let folder = temporary();
    let of = |stage: &str, column: &str, change: Change<'_>| {
        let mut recipe = Variant::of(&recipes()["standards-rtest"]);
        with(&mut recipe, folder.path(), (stage, column), change);
        recipe
    };
    let same: Change<'_> = &|_, cell| cell.to_owned();
    assert!(of("c-turns", "meas_y_um", same).run().failures.is_empty());
    let x = cells(&Variant::of(&recipes()["standards-rtest"]).path("c-turns", "path"), "meas_x_um");
    let (copy, dead): (Change<'_>, Change<'_>) = (&|row, _| x[row].clone(), &|_, _| "0.0".to_owned());
    let half: Change<'_> = &|row, cell| if row < 25 { x[row].clone() } else { cell.to_owned() };
    for (stage, column, change, word, estimate) in [
        ("c-turns", "meas_y_um", copy, FAULTS[1], "c-axis"),
        ("c-turns", "meas_y_um", half, FAULTS[1], "c-axis"),
        ("a-turns", "meas_x_um", dead, FAULTS[0], "a-axis"),
        ("c-turns", "meas_z_um", dead, FAULTS[0], "c-axis"),
    ] {
        let recipe = of(stage, column, change);
        let outcome = recipe.run();
        let failed = outcome.failures.iter().find(|failure| failure.error.to_string().contains(word));
        assert!(failed.is_some_and(|failure| failure.stage == estimate), "{column}: {:?}", outcome.failures);
        // `abbe check` tells, too.
        let planned = prepare(&recipe.write(folder.path()), &registry()).and_then(|it| it.check()).expect("a plan");
        let told = planned.iter().flat_map(|planned| &planned.identifiability.remarks).any(|it| it.contains(word));
        assert!(told, "{column}");
    }
    let clipped: Change<'_> = &|_, cell| format!("{}", number(cell).clamp(-2.0, 2.0));
    let outcome = of("c-turns", "meas_x_um", clipped).run();
    let told = outcome.remarks.iter().any(|remark| remark.text.contains(FAULTS[2]));
    assert!(told && outcome.failures.is_empty(), "{:?}", outcome.remarks);
}

#[test]
fn a_week_that_is_a_copy_of_another_is_told() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["history"]);
    let good = recipe.run();
    assert!(!good.remarks.iter().any(|remark| remark.text.contains(FAULTS[4])), "{:?}", good.remarks);
    let file = recipe.path("touches", "path");
    let text = read(&file);
    let is_of = |line: &str, week: &str| line.rsplit(',').next() == Some(week);
    let week_20: Vec<&str> = text.lines().filter(|line| is_of(line, "20")).collect();
    let kept = text.lines().filter(|line| !is_of(line, "21"));
    let copy = week_20.iter().map(|line| format!("{},21", line.rsplit_once(',').expect("a label").0));
    let all: Vec<String> = kept.map(str::to_owned).chain(copy).collect();
    let file = folder.path().join("touches.csv");
    write(&file, &(all.join("\n") + "\n"));
    recipe.stage("touches")["path"] = json!(file);
    let outcome = recipe.run();
    let told = outcome.remarks.iter().filter(|remark| remark.text.contains(FAULTS[4])).collect::<Vec<_>>();
    assert!(told.len() == 1 && told[0].estimate == "weekly", "{:?}", outcome.remarks);
}

#[test]
fn sessions_of_a_tool_that_are_copies_are_told() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["tool-check"]);
    let word = "readings of tool 4 are those of an earlier session";
    let good = said(&recipe, folder.path());
    assert!(!good.contains("of an earlier session to the last digit"), "{good}");
    let file = recipe.path("log", "path");
    let names = ["session", "tool", "quantity", "method", "repeat", "value_mm"];
    let columns = names.map(|name| cells(&file, name));
    let same = |one: usize, other: usize| (1..5).all(|column| columns[column][one] == columns[column][other]);
    let first = |row: usize| (0..row).find(|other| columns[0][*other] == "1" && same(*other, row)).unwrap_or(row);
    let copied: Change<'_> =
        &|row, cell| if columns[1][row] == "4" { columns[5][first(row)].clone() } else { cell.to_owned() };
    with(&mut recipe, folder.path(), ("log", "value_mm"), copied);
    let said = said(&recipe, folder.path());
    assert!(said.contains(word), "{said}");
}

const THREE_AXES: &str = "rapid-verify-three-axis";

#[test]
fn a_verify_run_that_contradicts_itself_is_refused() {
    let folder = temporary();
    let refused = |stage: &str, column: &str, change: Change<'_>| -> Vec<String> {
        let mut recipe = Variant::of(&recipes()[THREE_AXES]).only(&["calibrated", "before-the-cut"]);
        with(&mut recipe, folder.path(), (stage, column), change);
        let run = prepare(&recipe.write(folder.path()), &registry()).expect("a recipe").run(&Default::default());
        match run {
            Ok(outcome) => outcome.failures.iter().map(|failure| failure.error.to_string()).collect(),
            Err(error) => vec![error.to_string()],
        }
    };
    let word = "from `measured_mm` in this row";
    let same: Change<'_> = &|_, cell| cell.to_owned();
    assert_eq!(refused("today", "Z_mm", same), Vec::<String>::new());
    for (stage, by) in [("today", 5.0), ("today", 0.012), ("baseline", 5.0)] {
        // Rows whose approach axis is another one stay as they are.
        let z = cells(&Variant::of(&recipes()[THREE_AXES]).path(stage, "path"), "measured_mm");
        let shifted: Change<'_> = &|row, cell| match cell == z[row] && (stage == "today" || row % 5 == 0) {
            true => format!("{:.4}", number(cell) + by),
            false => cell.to_owned(),
        };
        let found = refused(stage, "Z_mm", shifted);
        assert!(found.iter().any(|error| error.contains(word)), "{stage} {by}: {found:?}");
    }
}

#[test]
fn a_tolerance_beyond_the_stock_is_refused_and_missing_stock_told() {
    let recipe = |stock: f64, tolerance: f64| {
        let mut recipe = Variant::of(&recipes()[THREE_AXES]).only(&["calibrated", "before-the-cut"]);
        let nominal = recipe.path("artefact", "nominal");
        recipe.0["stages"]["cut"] = json!({
            "validate": "verify-cut", "of": "calibrated", "from": "today", "nominal": nominal, "stock_mm": stock,
            "tolerance_um": tolerance,
        });
        recipe
    };
    let folder = temporary();
    let run =
        prepare(&recipe(0.3, 1000.0).write(folder.path()), &registry()).expect("a recipe").run(&Default::default());
    let errors: Vec<String> = match run {
        Ok(outcome) => outcome.failures.iter().map(|failure| failure.error.to_string()).collect(),
        Err(error) => vec![error.to_string()],
    };
    assert!(
        errors.iter().any(|error| error.contains("a tolerance below the stock that is planned, 300 um")),
        "{errors:?}"
    );
    // Without stock planned the surface is the finished one, and both signs are possible.
    let outcome = recipe(0.0, 1000.0).run();
    assert!(remarks(&outcome, "cut").contains("below the finished surface"), "{}", remarks(&outcome, "cut"));
}

const LOGS: [&str; 3] = ["constant", "stepped", "mixed"];

#[test]
fn a_drift_in_another_unit_and_exchanged_columns_are_told() {
    let folder = temporary();
    let words = ["is it in the unit that its column says?", "are these columns exchanged?"];
    let recipe = || {
        let mut recipe = Variant::of(&recipes()["thermal-spindle"]).only(&["spindle", "unseen", "warm-up"]);
        recipe.stage("spindle")["uncertainty"] = json!("ordinary");
        recipe
    };
    let good = said(&recipe(), folder.path());
    assert!(!words.iter().any(|word| good.contains(word)), "{good}");
    let mut small = recipe();
    let thousandth: Change<'_> = &|_, cell| format!("{}", 1e-3 * number(cell));
    for log in LOGS {
        for column in ["drift_x_um", "drift_y_um", "drift_z_um"] {
            with(&mut small, folder.path(), (log, column), thousandth);
        }
    }
    assert!(remarks(&small.run(), "warm-up").contains(words[0]), "{}", remarks(&small.run(), "warm-up"));
    assert!(said(&small, folder.path()).contains("moves most"));
    let exchange = |recipe: &mut Variant, log: &str, [one, other]: [&str; 2]| {
        let file = recipe.path(log, "path");
        let [first, second] = [one, other].map(|name| cells(&file, name));
        with(recipe, folder.path(), (log, one), &|row, _| second[row].clone());
        with(recipe, folder.path(), (log, other), &|row, _| first[row].clone());
    };
    let mut exchanged = recipe();
    exchange(&mut exchanged, "constant", ["T34_degC", "drift_z_um"]);
    assert!(said(&exchanged, folder.path()).contains(words[1]));
    let mut warm_up = Variant::of(&recipes()["spindle-motion"]);
    assert!(!said(&warm_up, folder.path()).contains(words[1]));
    exchange(&mut warm_up, "half-hour", ["T02_degC", "drift_z_um"]);
    assert!(said(&warm_up, folder.path()).contains(words[1]));
}

/// A displacement that is another one is refused wherever drifts are read, one that stops is named, and a copied sensor is told.
#[test]
fn copied_drifts_and_sensors_are_told() {
    let folder = temporary();
    let copy = |recipe: &mut Variant, log: &str, [of, to]: [&str; 2], rows: std::ops::Range<usize>| {
        let values = cells(&recipe.path(log, "path"), of);
        with(recipe, folder.path(), (log, to), &|row, cell| match rows.contains(&row) {
            true => values[row].clone(),
            false => cell.to_owned(),
        });
    };
    let of = |name: &str, stages: &[&str]| {
        let mut recipe = Variant::of(&recipes()[name]).only(stages);
        if stages.contains(&"spindle") {
            recipe.stage("spindle")["uncertainty"] = json!("ordinary");
        }
        recipe
    };
    let refused = "transducer read twice?";
    for (name, stages, log) in [
        ("thermal-spindle", &["spindle"][..], "constant"),
        ("thermal-spindle", &["spindle", "unseen"], "stepped"),
        ("thermal-spindle", &["warm-up"], "constant"),
        ("spindle-motion", &["warm-up"], "half-hour"),
    ] {
        assert!(!said(&of(name, stages), folder.path()).contains(refused), "{name} {stages:?}");
        for (columns, rows) in [(["drift_x_um", "drift_z_um"], 0..usize::MAX), (["drift_x_um", "drift_y_um"], 60..90)] {
            let mut copied = of(name, stages);
            copy(&mut copied, log, columns, rows);
            let words = said(&copied, folder.path());
            assert!(words.contains(refused) && words.contains("`drift_x`"), "{name} {stages:?} {columns:?}: {words}");
        }
    }
    let (mut sensor, word) = (of("thermal-spindle", &["spindle"]), "is one sensor read twice?");
    assert!(!said(&sensor, folder.path()).contains(word));
    copy(&mut sensor, "constant", ["T14_degC", "T13_degC"], 0..usize::MAX);
    assert!(said(&sensor, folder.path()).contains(word));
    let mut stopped = of("thermal-spindle", &["spindle"]);
    let stays = cells(&stopped.path("constant", "path"), "drift_x_um")[300].clone();
    with(&mut stopped, folder.path(), ("constant", "drift_x_um"), &|row, cell| {
        if row > 300 { stays.clone() } else { cell.to_owned() }
    });
    let words = said(&stopped, folder.path());
    assert!(words.contains("drift_x reads the same from row 301") && words.contains("was it stuck?"), "{words}");
}

/// Lengths in metres that only judge leave next to nothing of what is stated.
#[test]
fn unseen_lengths_in_another_unit_are_told() {
    let folder = temporary();
    let recipe = || Variant::of(&recipes()["cmm-checking-gauge"]).only(&["fit", "unseen"]);
    let word = "is the unit of these readings right?";
    assert!(!remarks(&recipe().run(), "unseen").contains(word));
    let mut metres = recipe();
    let text = read(&metres.path("other-beams", "path"));
    let mut rows = text.lines().filter(|line| !line.starts_with('#'));
    let header = rows.next().expect("a header");
    let is_length: Vec<bool> = header.split(',').map(|name| name.ends_with("_mm")).collect();
    let smaller = |row: &str| {
        let cells = row.split(',').zip(&is_length);
        let cells = cells.map(|(cell, is_length)| match is_length {
            true => format!("{}", number(cell) / 1000.0),
            false => cell.to_owned(),
        });
        cells.collect::<Vec<_>>().join(",")
    };
    let text: String = std::iter::once(header.to_owned()).chain(rows.map(smaller)).map(|row| row + "\n").collect();
    write(&folder.path().join("metres.csv"), &text);
    metres.stage("other-beams")["path"] = json!(folder.path().join("metres.csv"));
    let words = remarks(&metres.run(), "unseen");
    assert!(words.contains(word), "{words}");
}

#[test]
fn a_run_that_the_estimate_has_seen_is_no_prediction() {
    let mut recipe = Variant::of(&recipes()["thermal-spindle"]).only(&["spindle", "unseen"]);
    recipe.stage("spindle")["uncertainty"] = json!("ordinary");
    let word = "this is no prediction";
    assert!(!remarks(&recipe.run(), "unseen").contains(word));
    recipe.stage("unseen")["from"] = json!(["constant"]);
    let outcome = recipe.run();
    assert!(remarks(&outcome, "unseen").contains(word), "{}", remarks(&outcome, "unseen"));
    assert_eq!(decision(&outcome, "unseen"), Decision::Inconclusive);
}

/// Noise, quantisation and other samples of the same tests say nothing.
#[test]
fn good_readings_of_other_seeds_say_nothing() {
    let folder = temporary();
    for seed in 0..20 {
        for (name, ingests, columns) in [
            ("standards-rotary-interpolation", &["read-c", "read-a"][..], &["meas_x_um", "meas_y_um", "meas_z_um"][..]),
            ("standards-circular", &["slow", "fast", "arc"], &["reading_um"]),
            ("standards-positioning", &["linear", "long"], &["reading_um"]),
        ] {
            let mut recipe = Variant::of(&recipes()[name]);
            let step = [0.01, 0.1, 0.5, 1.0][seed as usize % 4];
            for (place, ingest) in ingests.iter().enumerate() {
                for (other, column) in columns.iter().enumerate() {
                    let random =
                        std::cell::RefCell::new(Random::new(1 + 100 * seed + 10 * place as u64 + other as u64));
                    let noisy: Change<'_> = &|_, cell| {
                        let value = number(cell) + 0.3 * random.borrow_mut().normal();
                        format!("{}", (value / step).round() * step)
                    };
                    with(&mut recipe, folder.path(), (ingest, column), noisy);
                }
            }
            let outcome = recipe.run();
            for verdict in &outcome.verdicts {
                let said = verdict.remarks.join("\n");
                assert!(!FAULTS.iter().any(|fault| said.contains(fault)), "{name}, seed {seed}, {step} um: {said}");
            }
        }
    }
}
