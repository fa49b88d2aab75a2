//! Rows that are shown some at a time: the results are those of rows that are held, to the last byte.

use abbe_core::{DataRow, LabelText, Passes};
use nalgebra::{DMatrix, DVector};

use super::*;

/// Shows so many rows at a time.
struct Shown<'a>(&'a Dataset, usize);

impl Passes for Shown<'_> {
    fn pass(&self, look: &mut dyn FnMut(&Dataset) -> Result<()>) -> Result<()> {
        let rows: Vec<DataRow> = self.0.row_indices().collect();
        rows.chunks(self.1).try_for_each(|rows| look(&self.0.of_rows(rows)))
    }
}

fn in_passes(settings: &Value, data: &[&Dataset], rows: usize) -> Result<Calibration> {
    let motion: Motion = from_settings(settings).expect("settings");
    let shown: Vec<Shown<'_>> = data.iter().map(|data| Shown(data, rows)).collect();
    motion.estimate_readings_in_passes("motion", &shown.iter().map(|data| data as &dyn Passes).collect::<Vec<_>>())
}

fn text(calibration: &Calibration) -> String {
    serde_json::to_string(calibration).expect("JSON")
}

/// A run with what does not come back, off the grid of angles.
fn random_run(random: &mut Random, spindle: &Simulated, turns: f64, per_turn: f64) -> Dataset {
    let start = random.between(-3.0, 3.0);
    let angles = Sampling { turns, per_turn, jitter: 0.2, start }.angles(random);
    let swing = swing(random, 8);
    run(spindle, &angles, 1.0, swing)
}

#[test]
fn whatever_is_shown_at_a_time_bytes_are_the_same() {
    for seed in 0..6 {
        let mut random = Random(100 + seed);
        let spindle = Simulated::new(&mut random, 3 + seed as usize);
        let (turns, per_turn) = (random.between(3.0, 12.0), random.between(60.0, 90.0));
        let set = random_run(&mut random, &spindle, turns, per_turn);
        let settings = spindle.settings(seed % 2 == 0);
        let held = text(&estimate(&settings, &[&set]).expect("an estimate"));
        for rows in [1, 7, 64, 100_000] {
            let found = in_passes(&settings, &[&set], rows).expect("an estimate");
            assert!(text(&found) == held, "seed {seed}, {rows} rows");
        }
    }
}

/// Runs of one data set, told apart by labels, whose angle begins again with every turn.
#[test]
fn runs_and_turns_go_on_over_what_is_shown() {
    let mut random = Random(9);
    let mut all: Option<(Dataset, Vec<LabelText>)> = None;
    let mut spindle = Simulated::new(&mut random, 5);
    for rpm in [300.0, 1200.0, 4800.0] {
        spindle.rpm = rpm;
        let set = random_run(&mut random, &spindle, 5.0, 70.0);
        let labels = vec![format!("run-{rpm}").into(); set.rows()];
        match &mut all {
            Some((all, known)) => {
                all.append(set).expect("the same columns");
                known.extend(labels);
            }
            None => all = Some((set, labels)),
        }
    }
    let (mut set, labels) = all.expect("runs");
    let Values::Numbers(angles) = &mut set.columns[0].values else { panic!("angles") };
    angles.iter_mut().for_each(|angle| *angle = angle.rem_euclid(TAU));
    set.columns.push(Column { header: ColumnHeader::parse("file"), values: Values::Labels(labels) });
    let mut settings = spindle.settings(true);
    settings["speeds_rpm"] = json!([300, 1200, 4800]);
    settings["encoder"] = json!("wrapped");
    let held = estimate(&settings, &[&set]).expect("an estimate");
    assert!(held.get("run[1200].ecc.x").is_some() && held.get("run[4800].async.z").is_some());
    for rows in [1, 13, 350, 351] {
        let found = in_passes(&settings, &[&set], rows).expect("an estimate");
        assert!(text(&found) == text(&held), "{rows} rows");
    }
    // The first run once more behind the others.
    let Values::Labels(labels) = &mut set.columns[5].values else { panic!("labels") };
    *labels.last_mut().expect("a row") = "run-300".into();
    let [held, found] = [usize::MAX, 10].map(|rows| in_passes(&settings, &[&set], rows).unwrap_err().to_string());
    assert!(held.contains("the run `run-300` goes on here") && found == held, "{found}");
}

#[test]
fn errors_name_the_same_row() {
    type Change = fn(&mut Vec<(&'static str, Vec<f64>)>);
    let cases: [(Change, &str); 7] = [
        (|c| c[0].1[100..].iter_mut().for_each(|s| *s += 0.05), "run.csv:102: the angle of the spindle goes on by"),
        (|c| c[0].1[100..].iter_mut().for_each(|s| *s -= 0.5), "run.csv:102: the angle of the spindle goes back"),
        (|c| c.iter_mut().for_each(|c| drop(c.1.drain(100..120))), "run.csv:102: readings are missing before this one"),
        (
            |c| c[1].1[200..].iter_mut().enumerate().for_each(|(row, t)| *t += 0.3 * row as f64 * 0.002_083),
            "turn 1 has 600 rpm, the run",
        ),
        (|c| c[1].1.swap(20, 30), "the time goes back"),
        (|c| c[2].1.iter_mut().for_each(|r| *r = r.min(0.0215)), "r1 reads its largest value, 21.5000 um,"),
        (|c| c[4].1.fill(0.4), "z reads 400 um all the time"),
    ];
    for (number, (change, expected)) in cases.into_iter().enumerate() {
        let (settings, mut columns) = usual();
        change(&mut columns);
        let set = data(&columns);
        let held = estimate(&settings, &[&set]).unwrap_err();
        assert!(held.to_string().contains(expected), "case {number}: {held}");
        for rows in [1, 50, 99] {
            assert_eq!(in_passes(&settings, &[&set], rows).unwrap_err(), held, "case {number}, {rows} rows");
        }
    }
}

/// Least squares on all rows, as they are.
fn by_rows(set: &Dataset, sensor: &str, highest: usize, line: bool) -> Vec<f64> {
    let of = |name: &str| set.numbers(name).expect("numbers");
    let (angles, times, readings) = (of("S"), of("time"), of(sensor));
    let (first, last) = (times[0], times[times.len() - 1]);
    let unknowns = 1 + 2 * highest + usize::from(line);
    let rows = DMatrix::from_fn(readings.len(), unknowns, |row, place| {
        let angle = place.div_ceil(2) as f64 * angles[row];
        match place {
            0 => 1.0,
            _ if place > 2 * highest => (times[row] - 0.5 * (first + last)) / (0.5 * (last - first)),
            _ if place % 2 == 1 => angle.cos(),
            _ => angle.sin(),
        }
    });
    let right = DVector::from_iterator(readings.len(), readings.iter().map(|reading| reading - readings[0]));
    let factor = rows.qr();
    let found = factor.r().solve_upper_triangular(&(factor.q().transpose() * right)).expect("a triangle");
    found.iter().copied().collect()
}

#[test]
fn sums_by_bins_are_least_squares_of_all_rows() {
    for seed in 0..8 {
        let mut random = Random(500 + seed);
        let highest = [2, 5, 24, 60][seed as usize % 4];
        let spindle = Simulated::new(&mut random, highest);
        let set = random_run(&mut random, &spindle, 6.0, 2.6 * highest as f64 + 40.0);
        let line = seed % 2 == 0;
        let found = estimate(&spindle.settings(line), &[&set]).expect("an estimate");
        let expected = by_rows(&set, "z", highest, line);
        for order in 1..=highest {
            for (part, place) in [("cos", 2 * order - 1), ("sin", 2 * order)] {
                let own = found.get(&format!("run[{}].sync.z[{part}{order}]", spindle.rpm)).expect("a harmonic");
                let apart = (own.value - expected[place]).abs();
                assert!(apart <= 1e-9 * own.standard_uncertainty, "seed {seed}, {part}{order}: {apart:e} {own:?}");
            }
        }
    }
}

/// A gap in every turn: harmonics are hardly told apart, and rows are read once more.
#[test]
fn harmonics_that_are_hardly_told_apart_are_found_by_another_pass() {
    let mut random = Random(77);
    let spindle = Simulated::new(&mut random, 9);
    let angles = Sampling { turns: 8.0, per_turn: 400.0, jitter: 0.1, start: 0.0 }.angles(&mut random);
    let angles: Vec<f64> = angles.into_iter().filter(|angle| angle.rem_euclid(TAU) > 0.24 * TAU).collect();
    let swing = swing(&mut random, 8);
    let set = run(&spindle, &angles, 1.0, swing);
    let mut settings = spindle.settings(true);
    settings["sectors"] = json!(4);
    let found = estimate(&settings, &[&set]).expect("an estimate");
    assert!(found.fit.condition > 100.0, "{}", found.fit.condition);
    let expected = by_rows(&set, "z", 9, true);
    for order in 1..=9 {
        let own = found.get(&format!("run[{}].sync.z[cos{order}]", spindle.rpm)).expect("a harmonic");
        assert!((own.value - expected[2 * order - 1]).abs() <= 1e-9 * own.standard_uncertainty, "{order}");
    }
    for rows in [1, 333] {
        assert!(text(&in_passes(&settings, &[&set], rows).expect("an estimate")) == text(&found), "{rows} rows");
    }
}
