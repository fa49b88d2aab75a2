use super::*;

fn rules() -> [(&'static str, Rule); 4] {
    let probability = 0.95;
    [
        ("simple", Rule::Simple {}),
        ("iso14253-1:1998", Rule::Iso14253Of1998 { probability }),
        ("iso14253-1:2017", Rule::Iso14253Of2017 { probability }),
        ("binary-guarded", Rule::Binary { probability }),
    ]
}

fn file(path: &str) -> String {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    std::fs::read_to_string(root.join(path)).expect("a file of the project")
}

#[test]
fn expected_decisions_and_probabilities() {
    let expected: serde_json::Value =
        serde_json::from_str(&file("tests/truth/standards-realistic-expected.json")).expect("JSON");
    let text = file("pipelines/data/standards/realistic/decisions.csv");
    let cases = expected["conformance"].as_array().expect("cases");
    assert_eq!(text.lines().count(), cases.len() + 1);
    for (line, case) in text.lines().skip(1).zip(cases) {
        let cells: Vec<Option<f64>> = line.split(',').map(|cell| cell.parse().ok()).collect();
        let measured = Measured {
            value: cells[1].expect("a value"),
            expanded: cells[4].expect("U"),
            coverage: cells[5].expect("k"),
        };
        let tolerance = Tolerance { lower: cells[2], upper: cells[3] };
        let conforms = probability(measured.value, measured.standard_uncertainty(), tolerance);
        assert!((conforms - case["p_conform"].as_f64().expect("p")).abs() < 1e-10, "{line}: {conforms}");
        for (name, rule) in rules() {
            let band = guard_band(rule, measured);
            assert!((band - case["guard_band_um"][name].as_f64().expect("w")).abs() < 1e-12, "{line} {name}: {band}");
            let word = match (decide(rule, measured, tolerance), name) {
                (Decision::Pass, _) => "conforms",
                (Decision::Fail, _) => "does not conform",
                (Decision::Inconclusive, _) => "neither proved",
            };
            assert_eq!(case["verdict"][name], word, "{line} {name}");
            let risk = specific_risk(rule, measured, tolerance);
            let of_answer = match word {
                "conforms" => Some(1.0 - conforms),
                "does not conform" => Some(conforms),
                _ => None,
            };
            assert_eq!(risk, of_answer);
        }
    }
}

/// Normal numbers by the polar method, of a generator that shares no code with the project.
fn normals(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed;
    let mut uniform = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1_u64 << 53) as f64 * 2.0 - 1.0
    };
    move || loop {
        let (x, y) = (uniform(), uniform());
        let square = x * x + y * y;
        if square > 0.0 && square < 1.0 {
            return x * (-2.0 * square.ln() / square).sqrt();
        }
    }
}

/// A machine exactly at its limit is measured: accepting it is as likely as conforming. The guarded rule accepts one in twenty.
#[test]
fn of_machines_at_the_limit_one_in_twenty_is_accepted() {
    let mut normal = normals(2017);
    let machines = 10_000;
    let (limit, u) = (10.0, 0.5);
    let mut accepted = [0_u32; 4];
    for _ in 0..machines {
        let value = limit + u * normal();
        let measured = Measured { value, expanded: 2.0 * u, coverage: 2.0 };
        for (count, (_, rule)) in accepted.iter_mut().zip(rules()) {
            let decision = decide(rule, measured, Tolerance { lower: None, upper: Some(limit) });
            assert_eq!(decision, rule.decide(Some(value), Some(u), limit));
            *count += u32::from(decision == Decision::Pass);
        }
    }
    // 99 % bands of binomial counts: 0.5, 0.02275 (2 u), 0.0495 (1.65 u).
    let within = |count: u32, p: f64| {
        let mean = p * f64::from(machines);
        (f64::from(count) - mean).abs() <= 2.576 * (mean * (1.0 - p)).sqrt()
    };
    assert!(within(accepted[0], 0.5), "{accepted:?}");
    assert!(within(accepted[1], normal_of(-2.0)) && accepted[3] == accepted[1], "{accepted:?}");
    assert!(within(accepted[2], normal_of(-1.65)), "{accepted:?}");
    let most = 0.05 * f64::from(machines) + 2.576 * (0.05 * 0.95 * f64::from(machines)).sqrt();
    assert!(f64::from(accepted[2]) <= most, "{accepted:?}");
}

fn normal_of(number: f64) -> f64 {
    abbe_results::normal_below(number)
}

#[test]
fn probabilities_of_one_and_two_limits() {
    let upper = Tolerance { upper: Some(1.0), lower: None };
    let lower = Tolerance { lower: Some(-1.0), upper: None };
    assert!((probability(1.0, 0.3, upper) - 0.5).abs() < 1e-15);
    assert!((probability(0.0, 1.0, upper) - probability(0.0, 1.0, lower)).abs() < 1e-15);
    assert_eq!([0.9, 1.0, 1.1].map(|value| probability(value, 0.0, upper)), [1.0, 1.0, 0.0]);
    assert_eq!(acceptance_zone(Tolerance { lower: Some(-1.0), upper: Some(1.0) }, 1.4), None);
    assert_eq!(acceptance_zone(upper, 0.25), Some([f64::NEG_INFINITY, 0.75]));
    let broken = Measured { value: 0.0, expanded: -1.0, coverage: 2.0 };
    assert_eq!(decide(Rule::Binary { probability: 0.95 }, broken, upper), Decision::Fail);
    let nothing = Measured { value: f64::NAN, expanded: 1.0, coverage: 2.0 };
    assert_eq!(decide(Rule::Iso14253Of2017 { probability: 0.95 }, nothing, upper), Decision::Fail);
}

/// Global risks against items that are drawn, and against a closed form.
#[test]
fn global_risks_are_those_of_drawn_items() {
    let tolerance = Tolerance { lower: Some(-2.0), upper: Some(2.0) };
    let process = Process { mean: 0.3, deviation: 1.2 };
    let (u, band) = (0.4, 0.66);
    let [consumer, producer] = global_risks(process, u, band, tolerance).expect("risks");
    let mut normal = normals(106);
    let count = 200_000;
    let mut found = [0_u32; 2];
    for _ in 0..count {
        let item = process.mean + process.deviation * normal();
        let accepted = (item + u * normal()).abs() <= 2.0 - band;
        found[0] += u32::from(accepted && item.abs() > 2.0);
        found[1] += u32::from(!accepted && item.abs() <= 2.0);
    }
    for (drawn, risk) in found.iter().zip([consumer, producer]) {
        let mean = risk * f64::from(count);
        assert!((f64::from(*drawn) - mean).abs() < 4.0 * mean.sqrt(), "{drawn} {mean}");
    }
    // One limit in the middle of the process, no band: both risks are atan(u / deviation) / (2 π).
    let half = Tolerance { upper: Some(process.mean), lower: None };
    for risk in global_risks(process, u, 0.0, half).expect("risks") {
        let expected = (u / process.deviation).atan() / (2.0 * std::f64::consts::PI);
        assert!((risk - expected).abs() < 1e-9, "{risk} {expected}");
    }
    assert_eq!(global_risks(process, 0.0, 0.0, half), None);
}
