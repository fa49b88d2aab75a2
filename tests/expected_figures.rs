//! Every figure that is expected of the simulated tests of standards, as recipes find it. No number of the expected values is left out:
//! each is a figure of a verdict, a number that the crate of the standards compares by itself, or a number of the data.

use std::collections::{BTreeMap, BTreeSet};

use abbe_core::{Decision, Figure};
use serde_json::{Value, json};

use crate::standards::{DATA, figures, on, recipe};
use crate::support::{json_file, root};

/// The expected numbers of one kind of data, and which of them were not compared yet.
struct Ledger {
    data: &'static str,
    expected: Value,
    left: BTreeSet<String>,
}

/// The places of all numbers, `/cmm/E0/E_max_um`.
fn numbers(value: &Value, at: &str, found: &mut BTreeSet<String>) {
    match value {
        Value::Number(_) => {
            found.insert(at.to_owned());
        }
        Value::Array(all) => {
            all.iter().enumerate().for_each(|(place, own)| numbers(own, &format!("{at}/{place}"), found));
        }
        Value::Object(all) => all.iter().for_each(|(key, own)| numbers(own, &format!("{at}/{key}"), found)),
        _ => {}
    }
}

impl Ledger {
    fn of(data: &'static str) -> Self {
        let expected = json_file(&root().join(format!("tests/truth/standards-{data}-expected.json")));
        let mut left = BTreeSet::new();
        numbers(&expected, "", &mut left);
        Self { data, expected, left }
    }

    fn has(&self, at: &str) -> bool {
        self.expected.pointer(at).is_some()
    }

    /// The number at a place, which counts as compared from now on.
    fn take(&mut self, at: &str) -> f64 {
        self.left.remove(at);
        self.expected.pointer(at).and_then(Value::as_f64).unwrap_or_else(|| panic!("{}: no number at {at}", self.data))
    }

    /// The numbers below a place count as compared: where, is said beside the call.
    fn elsewhere(&mut self, is: impl Fn(&str) -> bool) {
        let before = self.left.len();
        self.left.retain(|at| !is(at));
        assert!(self.left.len() < before, "{}: nothing is compared elsewhere", self.data);
    }
}

/// Whether two numbers agree in the tenth digit, which is the last one of the expected values. What is below a femtometre, or a
/// billionth of a microradian, is rounding.
fn agree(found: f64, expected: f64) -> bool {
    let digit = if expected == 0.0 { 0.0 } else { 10.0_f64.powf(expected.abs().log10().floor() - 9.0) };
    (found - expected).abs() <= 1.001 * digit + 1e-9
}

/// All figures of a run, by name.
struct Found {
    figures: BTreeMap<String, Figure>,
    of: String,
}

impl Found {
    fn of(name: &str, recipe: &crate::support::Variant) -> Self {
        let outcome = recipe.run();
        assert!(outcome.failures.is_empty(), "{name} fails");
        let all = outcome.verdicts.iter().flat_map(|verdict| verdict.figures.clone());
        Self { figures: all.map(|figure| (figure.name.clone(), figure)).collect(), of: name.to_owned() }
    }

    fn get(&self, name: &str) -> &Figure {
        self.figures.get(name).unwrap_or_else(|| panic!("{}: no {name} of {:?}", self.of, self.figures.keys()))
    }

    /// The figure of this name has the number at that place, to its ten digits.
    fn is(&self, ledger: &mut Ledger, name: &str, unit: &str, at: &str) {
        let (figure, expected) = (self.get(name), ledger.take(at));
        let found = figure.value.expect("a value");
        assert_eq!(figure.unit, unit, "{} {name}", self.of);
        assert!(agree(found, expected), "{} {name}: {found} instead of {expected}", self.of);
    }
}

/// Figures of an axis by their names here and in the expected values, with their uncertainties.
const POSITIONING: [(&str, &str, &str); 12] = [
    ("A", "A", "U_A"),
    ("A up", "A_up", "U_A"),
    ("A down", "A_down", "U_A"),
    ("E", "E", "U_E"),
    ("E up", "E_up", "U_E"),
    ("E down", "E_down", "U_E"),
    ("M", "M", "U_M"),
    ("R", "R", "U_R"),
    ("R up", "R_up", "U_R"),
    ("R down", "R_down", "U_R"),
    ("B", "B", "U_B"),
    ("mean B", "B_mean", "U_B"),
];

const VDI: [(&str, &str); 6] = [
    ("VDI P", "P"),
    ("VDI Pa", "Pa"),
    ("VDI Ps", "Ps_max"),
    ("VDI mean Ps", "Ps_mean"),
    ("VDI U", "U_max"),
    ("VDI mean U", "U_mean"),
];

fn positioning(ledger: &mut Ledger) {
    let found = Found::of("positioning", &recipe("positioning"));
    for (file, unit) in [("direct-x", "um"), ("direct-c", "urad"), ("direct-long", "um")] {
        let base = format!("/positioning/{file}.csv");
        for (name, key, uncertainty) in POSITIONING {
            let (name, at) = (format!("{name}[{file}]"), format!("{base}/{key}"));
            if !ledger.has(&at) {
                assert!(!found.figures.contains_key(&name), "{name} cannot be told");
                continue;
            }
            found.is(ledger, &name, unit, &at);
            let stated = ledger.take(&format!("{base}/uncertainty/{uncertainty}"));
            let u = found.get(&name).standard_uncertainty.expect("u");
            assert!(agree(2.0 * u, stated), "{name}: {u} instead of {stated} / 2");
            let arcsec = format!("{at}_arcsec");
            if ledger.has(&arcsec) {
                let value = found.get(&name).value.expect("a value");
                let seconds = (1e-6 * value).to_degrees() * 3600.0;
                assert!(agree(seconds, ledger.take(&arcsec)), "{name}: {seconds} seconds of arc");
            }
        }
        for (name, key) in VDI {
            let (name, at) = (format!("{name}[{file}]"), format!("{base}/vdi3441/{key}"));
            match ledger.has(&at) {
                true => found.is(ledger, &name, unit, &at),
                false => assert!(!found.figures.contains_key(&name), "{name}"),
            }
        }
    }
    // Target by target, and term by term of the uncertainty: `expected_figures_of_three_axes` of abbe-standards.
    ledger.elsewhere(|at| at.starts_with("/positioning/"));
}

fn diagonals(ledger: &mut Ledger) {
    let found = Found::of(ledger.data, &on("diagonals", ledger.data));
    for diagonal in ["ppp", "npp", "pnp", "nnp", "xy-pp", "xy-np", "yz-pp", "yz-np", "zx-pp", "zx-np"] {
        let base = format!("/diagonal/{diagonal}");
        for (name, key, _) in POSITIONING {
            found.is(ledger, &format!("{name}[direct-diagonal-{diagonal}]"), "um", &format!("{base}/{key}"));
        }
        let name = format!("slope[direct-diagonal-{diagonal}]");
        found.is(ledger, &name, "um/m", &format!("{base}/slope_um_per_m"));
        // The travels of the machine are 400, 300 and 250 mm.
        let travels = match diagonal.get(..2) {
            Some("xy") => vec![400.0, 300.0],
            Some("yz") => vec![300.0, 250.0],
            Some("zx") => vec![250.0, 400.0],
            _ => vec![400.0, 300.0, 250.0],
        };
        let length = travels.iter().map(|travel| travel * travel).sum::<f64>().sqrt();
        assert!(agree(length, ledger.take(&format!("{base}/length_mm"))), "{diagonal}");
    }
    for kind in ["body", "face"] {
        for figure in ["E_d", "B_d"] {
            found.is(ledger, &format!("{figure}[{kind}]"), "um", &format!("/diagonal/{kind}/{figure}"));
        }
    }
    for face in ["xy", "yz", "zx"] {
        let at = format!("/diagonal/squareness_from_face_diagonals_urad/{face}");
        found.is(ledger, &format!("squareness[{face}]"), "urad", &at);
    }
}

fn circles(ledger: &mut Ledger) {
    let found = Found::of(ledger.data, &on("circular", ledger.data));
    for file in ["ballbar-xy-f500", "ballbar-xy-f2000"] {
        let base = format!("/circular/{file}.csv");
        let mut is = |name: String, unit: &str, key: &str| {
            found.is(ledger, &format!("{name}[{file}]"), unit, &format!("{base}/{key}"));
        };
        for way in ["ccw", "cw"] {
            is(format!("G_{way}"), "um", &format!("G_{way}"));
            is(format!("G_{way}_lsc"), "um", &format!("G_{way}_lsc"));
            for end in ["max", "min"] {
                is(format!("F_{end}_{way}"), "um", &format!("F_{end}_{way}"));
                is(format!("F_{end}_{way} as set up"), "um", &format!("F_{end}_{way}_as_set_up"));
            }
        }
        for (name, key) in [("G(b)", "G_b"), ("G(b)_lsc", "G_b_lsc"), ("D", "D"), ("H", "H")] {
            is(name.to_owned(), "um", key);
        }
        is("angle of H".to_owned(), "deg", "H_at_deg");
        is("centre along 0 deg".to_owned(), "um", "centre_um/0");
        is("centre along 90 deg".to_owned(), "um", "centre_um/1");
    }
    for (way, end) in [("ccw", "max"), ("ccw", "min"), ("cw", "max"), ("cw", "min")] {
        let name = format!("F_{end}_{way} as set up[ballbar-zx-arc]");
        found.is(ledger, &name, "um", &format!("/circular/ballbar-zx-arc.csv/F_{end}_{way}"));
    }
    let mut of_arc = found.figures.keys().filter(|name| name.ends_with("[ballbar-zx-arc]"));
    assert!(of_arc.all(|name| name.contains("as set up")), "an arc has F only");
    // What makes the circles: `circles::to_first_order_it_is_the_usual_diagnosis`.
    ledger.elsewhere(|at| at.starts_with("/circular/diagnostics/"));
}

fn rotary_axes(ledger: &mut Ledger) {
    let found = Found::of(ledger.data, &on("rotary-interpolation", ledger.data));
    for file in ["rtest-c", "rtest-a"] {
        for name in ["radial", "tangential", "axial", "meas_x", "meas_y", "meas_z"] {
            for way in ["up", "down", "both"] {
                found.is(ledger, &format!("{name} {way}[{file}]"), "um", &format!("/rotary/{file}.csv/{name}/{way}"));
            }
        }
    }
}

fn cmms(ledger: &mut Ledger) {
    let mut recipe = on("cmm", ledger.data);
    if ledger.data == "exact" {
        recipe.0["stages"].as_object_mut().expect("stages").remove("repeats");
        recipe = recipe.set("e0", "from", json!("lengths"));
    }
    let found = Found::of(ledger.data, &recipe);
    for (file, symbol, key) in [("lengths-e0", "E_0", "E0"), ("lengths-el150", "E_150", "EL150")] {
        let base = format!("/cmm/{key}");
        found.is(ledger, &format!("{symbol} max[{file}]"), "um", &format!("{base}/E_max_um"));
        found.is(ledger, &format!("{symbol} min[{file}]"), "um", &format!("{base}/E_min_um"));
        found.is(ledger, &format!("largest |{symbol}|/MPE[{file}]"), "1", &format!("{base}/largest_E_over_MPE"));
        let outside =
            ledger.expected.pointer(&format!("{base}/outside")).and_then(Value::as_array).expect("a list").len();
        assert_eq!(found.get(&format!("values outside[{file}]")).value, Some(outside as f64));
    }
    found.is(ledger, "R_0 max[lengths-e0]", "um", "/cmm/E0/R0_max_um");
    let symbols = [
        ("P_FTU", "single/PFTU_um"),
        ("P_STU", "single/PSTU_um"),
        ("P_FTM", "multi/PFTM_um"),
        ("P_STM", "multi/PSTM_um"),
        ("P_LTM", "multi/PLTM_um"),
        ("P_LTM x", "multi/PLTM_by_axis_um/0"),
        ("P_LTM y", "multi/PLTM_by_axis_um/1"),
        ("P_LTM z", "multi/PLTM_by_axis_um/2"),
    ];
    for (symbol, key) in symbols {
        found.is(ledger, &format!("{symbol}[sphere-points]"), "um", &format!("/cmm/probing_{key}"));
    }
    let mut decided = found.figures.values().filter_map(|figure| figure.decision);
    assert!(decided.all(|decision| decision == Decision::Pass));
    // Counts, which values are outside, where R_0 is largest, the repeats with their limit and the place of the sphere:
    // `lengths_of_a_cmm` and `a_sphere_by_one_stylus_and_by_five` of abbe-standards.
    ledger.elsewhere(|at| at.starts_with("/cmm/"));
}

#[test]
fn every_expected_number_is_found() {
    let mut compared = Vec::new();
    for data in DATA {
        let mut ledger = Ledger::of(data);
        let all = ledger.left.len();
        circles(&mut ledger);
        diagonals(&mut ledger);
        rotary_axes(&mut ledger);
        cmms(&mut ledger);
        if data == "realistic" {
            positioning(&mut ledger);
            // Cases of decisions: `expected_decisions_and_probabilities` of abbe-standards.
            ledger.elsewhere(|at| at.starts_with("/conformance/"));
        }
        assert!(ledger.left.is_empty(), "{data}: nobody compares {:?}", ledger.left);
        compared.push(all);
    }
    // As many numbers as the files have.
    insta::assert_debug_snapshot!("expected_numbers", compared);
}

/// Digits are looked at: a figure that is off by two in the tenth is another one.
#[test]
fn the_tenth_digit_counts() {
    assert!(agree(19.41424402, 19.414_244_02) && agree(3.972e-15, 0.0) && agree(1_234.567_890_4, 1_234.567_89));
    assert!(!agree(19.414_244_05, 19.414_244_02) && !agree(-19.414_244_02, 19.414_244_02) && !agree(4e-9, 0.0));
}

/// What the diagonals hide is told with the numbers of the machine, and one diagonal of a face tells no squareness.
#[test]
fn diagonals_say_what_they_hide() {
    let outcome = recipe("diagonals").run();
    let told = outcome.verdicts[0].remarks.join("\n");
    let hidden = "body diagonals hide errors that cancel along them: a scale of X of 10.0 um/m with one of Y of -17.8 um/m \
                  or one of Z of -25.6 um/m changes none of them";
    assert!(told.contains(hidden) && told.contains("face zx diagonals hide"), "{told}");
    // Without the second diagonal of a face there is no squareness, and its limit fails.
    let alone = recipe("diagonals").set("diagonals", "from", json!(["ppp", "xy-pp"])).run();
    let absent = figures(&alone, "diagonals").iter().find(|figure| figure.name.contains("squareness")).expect("it");
    assert_eq!((absent.value, absent.decision), (None, Some(Decision::Fail)));
}
