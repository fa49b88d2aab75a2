use super::plan::{Axis, Fault, faults};
use super::uncertainty::{Linear, Rotary};
use super::*;

/// A figure of a target, and one in the manner of VDI/DGQ 3441.
type OfTarget = fn(&AtTarget) -> Option<f64>;
type OfVdi = fn(&Vdi) -> f64;

fn target(position: f64, up: &[f64], down: &[f64]) -> Target {
    Target { position, up: up.to_vec(), down: down.to_vec() }
}

fn is(found: Option<f64>, expected: f64) {
    let found = found.expect("a figure");
    assert!((found - expected).abs() < 1e-9 * expected.abs().max(1.0), "{found} instead of {expected}");
}

/// Worked by hand: s is √2 at 0 up, 0 else.
#[test]
fn worked_example() {
    let targets = [
        target(200.0, &[5.0, 5.0], &[1.0, 1.0]),
        target(0.0, &[2.0, 4.0], &[2.0, 2.0]),
        target(90.0, &[-1.0, -1.0], &[-2.0, -2.0]),
    ];
    let found = Positioning::of(&targets);
    assert_eq!(found.targets.iter().map(|target| target.position).collect::<Vec<_>>(), [0.0, 90.0, 200.0]);
    is(found.reversal, 4.0);
    is(found.mean_reversal, 2.0);
    is(found.systematic_up, 6.0);
    is(found.systematic_down, 4.0);
    is(found.systematic, 7.0);
    is(found.mean_deviation, 4.5);
    let root = 2.0_f64.sqrt();
    is(found.repeatability_up, 4.0 * root);
    is(found.repeatability_down, 0.0);
    // 2 √2 + 1 at 0; 4 √2 there is more; 4 at 200 is less.
    is(found.repeatability, 4.0 * root);
    is(found.accuracy_up, 3.0 + 2.0 * root + 1.0);
    is(found.accuracy_down, 4.0);
    is(found.accuracy, 3.0 + 2.0 * root + 2.0);
    let vdi = found.vdi().expect("figures");
    is(Some(vdi.largest_spread), 3.0 * root);
    is(Some(vdi.mean_spread), root);
    is(Some(vdi.mean_reversal), 2.0);
    // At 0: 2.5 + 0.5 + 1.5 √2 = 5.12 is above 3 + 2 = 5; the lowest is at 90: -1.5 - 0.5.
    is(Some(vdi.uncertainty), 3.0 + 1.5 * root + 2.0);
}

#[test]
fn single_runs_have_neither_repeatability_nor_accuracy() {
    let found = Positioning::of(&[target(0.0, &[1.0], &[0.0]), target(1.0, &[3.0], &[2.5])]);
    is(found.systematic, 3.0);
    is(found.reversal, 1.0);
    assert_eq!((found.repeatability, found.accuracy, found.repeatability_up), (None, None, None));
    assert_eq!((found.accuracy_down, found.vdi()), (None, None));
}

#[test]
fn what_a_target_lacks_no_figure_of_the_axis_hides() {
    let mut targets =
        vec![target(0.0, &[1.0, 2.0], &[0.0, 1.0]), target(1.0, &[3.0, 3.0], &[]), target(2.0, &[1.0, 1.0], &[0.0])];
    let found = Positioning::of(&targets);
    is(found.systematic_up, 2.0);
    assert!(found.accuracy_up.is_some() && found.repeatability_up.is_some());
    let absent = [
        found.systematic_down,
        found.systematic,
        found.reversal,
        found.mean_reversal,
        found.mean_deviation,
        found.accuracy,
    ];
    assert_eq!(absent, [None; 6]);
    targets[1].up[0] = f64::NAN;
    let found = Positioning::of(&targets);
    assert_eq!((found.systematic_up, found.accuracy_up, found.repeatability_up), (None, None, None));
    for few in [&targets[..0], &targets[..1]] {
        let found = Positioning::of(few);
        assert_eq!((found.systematic_up, found.reversal, found.slope()), (None, None, None));
    }
}

#[test]
fn slopes_of_lines() {
    let line: Vec<Target> = [0.0, 10.0, 25.0].map(|at| target(at, &[3.0 + 2.0 * at], &[1.0 + 2.0 * at])).to_vec();
    is(Positioning::of(&line).slope(), 2.0);
    let one_way: Vec<Target> = line.iter().map(|target| Target { down: Vec::new(), ..target.clone() }).collect();
    is(Positioning::of(&one_way).slope(), 2.0);
    let mut mixed = line;
    mixed[0].up.clear();
    mixed[2].down.clear();
    assert_eq!(Positioning::of(&mixed).slope(), None);
}

#[test]
fn uncertainties_of_long_and_short_axes() {
    let linear = Linear {
        device: 1.0,
        misalignment: 2.0,
        expansion: 12.0,
        temperature_range: 1.0,
        expansion_range: 2.0,
        offset: -3.0,
        drift_range: 12.0_f64.sqrt(),
    };
    let terms = linear.terms(1000.0).expect("terms");
    let unit = 12.0_f64.sqrt().recip();
    is(Some(terms.device), 0.5);
    is(Some(terms.misalignment), 2.0 * unit);
    is(Some(terms.temperature), 12.0 * unit);
    is(Some(terms.expansion), 6.0 * unit);
    is(Some(terms.drift), 1.0);
    let common: f64 = 0.25 + (4.0 + 144.0 + 36.0) / 12.0;
    let five = terms.expanded(5).expect("figures");
    is(Some(five.systematic), 2.0 * (common + 0.2).sqrt());
    is(Some(five.mean_deviation), 2.0 * (common + 0.1).sqrt());
    is(Some(five.reversal), 2.0 * 0.4_f64.sqrt());
    is(five.repeatability, 4.0);
    is(five.accuracy, 2.0 * (common + 1.2).sqrt());
    let single = terms.expanded(1).expect("figures");
    assert_eq!((single.repeatability, single.accuracy), (None, None));
    assert_eq!((terms.expanded(0), linear.terms(0.0)), (None, None));
    is(Some(Rotary { device: 3.0, drift_range: 0.0 }.terms().common()), 1.5);
}

#[test]
fn wrong_plans_are_told() {
    let plan = |positions: &[f64], runs: usize| -> Vec<Target> {
        positions.iter().map(|at| target(*at, &vec![0.0; runs], &vec![0.0; runs])).collect()
    };
    let good = [0.0, 210.0, 390.0, 605.0, 810.0, 1000.0];
    assert_eq!(faults(Axis::Linear, &plan(&good, 5)), []);
    assert_eq!(faults(Axis::Linear, &plan(&good[..4], 5)), [Fault::TooFewTargets { found: 4, needed: 5 }]);
    assert_eq!(faults(Axis::Linear, &plan(&good, 3)), [Fault::TooFewRuns { found: 3, needed: 5 }]);
    let steps = [0.0, 90.0, 180.0, 270.0, 360.0];
    let told = faults(Axis::Rotary, &plan(&steps, 5));
    assert_eq!(told, [Fault::TooFewTargets { found: 5, needed: 8 }, Fault::Equidistant(90.0)]);
    // Beyond 2 m: one run each way, and a target every 250 mm.
    let long: Vec<f64> = (0..=12).map(|step| 250.0 * f64::from(step) + f64::from(step % 2) * 30.0).collect();
    assert_eq!(faults(Axis::Linear, &plan(&long, 1)), []);
    let wide: Vec<f64> = [0.0, 500.0, 1100.0, 1600.0, 2300.0, 3000.0].to_vec();
    assert_eq!(faults(Axis::Linear, &plan(&wide, 1)), [Fault::TooFewTargets { found: 6, needed: 13 }]);
    let mut holes = plan(&good, 5);
    holes[2].down.pop();
    holes.iter_mut().for_each(|target| target.up.clear());
    assert_eq!(faults(Axis::Linear, &holes), [Fault::OneDirection, Fault::MissingRuns(vec![390.0])]);
    assert_eq!(faults(Axis::Linear, &[]), []);
}

/// Rows of a file of the data: position, direction, reading.
fn targets_of(name: &str) -> Vec<Target> {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../pipelines/data/standards/realistic");
    let text = std::fs::read_to_string(folder.join(name)).expect("the data");
    let mut targets: Vec<Target> = Vec::new();
    for line in text.lines().skip(1) {
        let cells: Vec<f64> = line.split(',').map(|cell| cell.parse().expect("a number")).collect();
        let place = targets.iter().position(|target| target.position == cells[2]).unwrap_or_else(|| {
            targets.push(target(cells[2], &[], &[]));
            targets.len() - 1
        });
        let target = &mut targets[place];
        if cells[1] > 0.0 { &mut target.up } else { &mut target.down }.push(cells[3]);
    }
    targets
}

/// Compares with all digits that are given, ten.
fn agrees(name: &str, found: Option<f64>, expected: &serde_json::Value) {
    match (found, expected.as_f64()) {
        (None, None) => {}
        (Some(found), Some(expected)) => {
            assert!((found - expected).abs() <= 1e-9 * expected.abs() + 1e-12, "{name}: {found} for {expected}");
        }
        (found, expected) => panic!("{name}: {found:?} for {expected:?}"),
    }
}

#[test]
fn expected_figures_of_three_axes() {
    let path =
        std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/truth/standards-realistic-expected.json");
    let text = std::fs::read_to_string(path).expect("expected figures");
    let expected: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let linear = Linear {
        device: 0.8,
        misalignment: 1.0,
        expansion: 11.0,
        temperature_range: 0.6,
        expansion_range: 2.0,
        offset: 3.0,
        drift_range: 1.2,
    };
    for (name, runs) in [("direct-x.csv", 5), ("direct-c.csv", 5), ("direct-long.csv", 1)] {
        let (found, of) = (Positioning::of(&targets_of(name)), &expected["positioning"][name]);
        let travel = found.targets[found.targets.len() - 1].position - found.targets[0].position;
        let terms = if name == "direct-c.csv" {
            Rotary { device: 3.0, drift_range: 4.0 }.terms()
        } else {
            linear.terms(travel).expect("terms")
        };
        let expanded = terms.expanded(runs).expect("uncertainties");
        let all = [
            ("B", found.reversal),
            ("B_mean", found.mean_reversal),
            ("E_up", found.systematic_up),
            ("E_down", found.systematic_down),
            ("E", found.systematic),
            ("M", found.mean_deviation),
            ("R_up", found.repeatability_up),
            ("R_down", found.repeatability_down),
            ("R", found.repeatability),
            ("A_up", found.accuracy_up),
            ("A_down", found.accuracy_down),
            ("A", found.accuracy),
        ];
        all.iter().for_each(|(key, value)| agrees(&format!("{name} {key}"), *value, &of[*key]));
        let each: [(&str, OfTarget); 9] = [
            ("mean_up", |at| at.mean_up),
            ("mean_down", |at| at.mean_down),
            ("B_i", |at| at.reversal),
            ("mean_bi", |at| at.mean),
            ("s_up", |at| at.s_up),
            ("s_down", |at| at.s_down),
            ("R_i_up", |at| at.repeatability_up),
            ("R_i_down", |at| at.repeatability_down),
            ("R_i", |at| at.repeatability),
        ];
        for (key, value) in each {
            for (place, at) in found.targets.iter().enumerate() {
                agrees(&format!("{name} {key} {place}"), value(at), &of[key][place]);
            }
        }
        let vdi = found.vdi();
        let of_vdi: [(&str, OfVdi); 6] = [
            ("Pa", |vdi| vdi.deviation),
            ("U_max", |vdi| vdi.largest_reversal),
            ("U_mean", |vdi| vdi.mean_reversal),
            ("Ps_max", |vdi| vdi.largest_spread),
            ("Ps_mean", |vdi| vdi.mean_spread),
            ("P", |vdi| vdi.uncertainty),
        ];
        of_vdi.iter().for_each(|(key, value)| agrees(key, vdi.as_ref().map(value), &of["vdi3441"][*key]));
        let stated = &of["uncertainty"];
        let uncertainties = [
            ("U_E", Some(expanded.systematic)),
            ("U_M", Some(expanded.mean_deviation)),
            ("U_B", Some(expanded.reversal)),
            ("U_R", expanded.repeatability),
            ("U_A", expanded.accuracy),
        ];
        uncertainties.iter().for_each(|(key, value)| agrees(key, *value, &stated[*key]));
        agrees("device", Some(terms.device), &stated["terms"]["device"]);
        agrees("eve", Some(terms.drift), &stated["terms"]["eve"]);
    }
}

/// Random tests against sums written out in one go, over all readings instead of target by target.
#[test]
fn random_axes_agree_with_a_plain_evaluation() {
    let mut state = 11_u64;
    let mut next = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 / f64::from(1 << 24)
    };
    let seeds = std::env::var("ABBE_SEEDS").ok().and_then(|seeds| seeds.parse().ok()).unwrap_or(300);
    for _ in 0..seeds {
        let (count, runs) = (2 + (12.0 * next()) as usize, 1 + (6.0 * next()) as usize);
        let mut targets = Vec::new();
        for place in 0..count {
            let mut readings = || -> Vec<f64> { (0..runs).map(|_| 20.0 * next() - 10.0).collect() };
            targets.push(target(place as f64, &readings(), &readings()));
        }
        let found = Positioning::of(&targets);
        let plain_mean = |list: &[f64]| list.iter().sum::<f64>() / runs as f64;
        let plain_s = |list: &[f64]| {
            let sum: f64 = list.iter().sum();
            let squares: f64 = list.iter().map(|one| one * one).sum();
            ((squares - sum * sum / runs as f64) / (runs as f64 - 1.0)).max(0.0).sqrt()
        };
        let (mut top, mut bottom) = (f64::NEG_INFINITY, f64::INFINITY);
        let (mut high, mut low, mut worst, mut reversal) = (top, bottom, 0.0_f64, 0.0_f64);
        for one in &targets {
            for list in [&one.up, &one.down] {
                let (mean, s) = (plain_mean(list), plain_s(list));
                (high, low) = (high.max(mean), low.min(mean));
                (top, bottom) = (top.max(mean + 2.0 * s), bottom.min(mean - 2.0 * s));
                worst = worst.max(4.0 * s);
            }
            let own = (plain_mean(&one.up) - plain_mean(&one.down)).abs();
            reversal = reversal.max(own);
            worst = worst.max(own + 2.0 * (plain_s(&one.up) + plain_s(&one.down)));
        }
        is(found.systematic, high - low);
        is(found.reversal, reversal);
        if runs == 1 {
            assert_eq!((found.accuracy, found.repeatability), (None, None));
        } else {
            assert!((found.accuracy.expect("A") - (top - bottom)).abs() < 1e-6);
            assert!((found.repeatability.expect("R") - worst).abs() < 1e-6);
        }
    }
}
