//! Every figure of the simulated tests against what others computed of them.

use std::path::PathBuf;

use serde_json::Value;

use crate::circular::{Bidirectional, Sample, Trace};
use crate::lengths::{Judged, Measured, Permissible, Set, judge, sets};
use crate::probing::{ball, multi_stylus};
use crate::rotary_interpolation::{Path, ranges};

const DATA: [&str; 2] = ["exact", "realistic"];
/// Calibrated diameter of the sphere, mm.
const DIAMETER: f64 = 24.998_74;

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn expected(data: &str) -> Value {
    let path = root().join(format!("tests/truth/standards-{data}-expected.json"));
    serde_json::from_str(&std::fs::read_to_string(path).expect("figures")).expect("JSON")
}

/// The columns of a file, as text.
struct Table(Vec<String>, Vec<Vec<String>>);

impl Table {
    fn read(data: &str, file: &str) -> Self {
        let text = std::fs::read_to_string(root().join(format!("pipelines/data/standards/{data}/{file}")));
        let text = text.expect("readings");
        let cells = |line: &str| line.split(',').map(str::to_owned).collect::<Vec<_>>();
        let mut lines = text.lines().filter(|line| !line.starts_with('#')).map(cells);
        Self(lines.next().expect("a header"), lines.collect())
    }

    fn texts(&self, name: &str) -> Vec<String> {
        let column = self.0.iter().position(|other| other == name).expect("a column");
        self.1.iter().map(|row| row[column].clone()).collect()
    }

    fn numbers(&self, name: &str) -> Vec<f64> {
        self.texts(name).iter().map(|cell| cell.parse().expect("a number")).collect()
    }
}

/// Whether a figure is the expected one, to its ten digits.
fn same(found: f64, expected: &Value, name: &str) {
    let expected = expected.as_f64().unwrap_or_else(|| panic!("no {name}"));
    let digit = if expected == 0.0 { 0.0 } else { 10.0_f64.powf(expected.abs().log10().floor() - 9.0) };
    let tolerance = 1.001 * digit + 1e-9;
    assert!((found - expected).abs() <= tolerance, "{name}: {found} is not {expected}");
}

fn traces(data: &str, file: &str, nominal: f64) -> [Trace; 2] {
    let table = Table::read(data, file);
    let (ways, angles, readings) = (table.texts("direction"), table.numbers("angle_deg"), table.numbers("reading_um"));
    ["1", "-1"].map(|way| {
        let rows = (0..ways.len()).filter(|row| ways[*row] == way);
        let of = |row: usize| Sample { angle: angles[row].to_radians(), radius: nominal + 1e-3 * readings[row] };
        Trace::new(&rows.map(of).collect::<Vec<_>>())
    })
}

#[test]
fn circles() {
    for data in DATA {
        for file in ["ballbar-xy-f500.csv", "ballbar-xy-f2000.csv"] {
            let figures = &expected(data)["circular"][file];
            let [ccw, cw] = traces(data, file, 150.0);
            let both = Bidirectional::of(&ccw, &cw).expect("both");
            let check = |name: &str, mm: f64| same(1e3 * mm, &figures[name], &format!("{data} {file} {name}"));
            for (trace, way) in [(&ccw, "ccw"), (&cw, "cw")] {
                check(&format!("G_{way}"), trace.minimum_zone().expect("a zone").width);
                check(&format!("G_{way}_lsc"), trace.about_least_squares().expect("a range"));
                let centred = trace.about(both.circle.centre.into(), 150.0).expect("samples");
                let set_up = trace.as_set_up(150.0).expect("samples");
                for (values, how) in [(centred, ""), (set_up, "_as_set_up")] {
                    check(&format!("F_max_{way}{how}"), values[0]);
                    check(&format!("F_min_{way}{how}"), values[1]);
                }
            }
            check("G_b", both.minimum_zone.expect("a zone").width);
            check("G_b_lsc", both.about_least_squares.expect("a range"));
            check("D", both.radial_deviation(150.0));
            same(1e3 * both.circle.centre.x, &figures["centre_um"][0], "centre");
            same(1e3 * both.circle.centre.y, &figures["centre_um"][1], "centre");
            let (size, angle) = both.hysteresis.expect("hysteresis");
            check("H", size);
            assert!((angle.to_degrees() - figures["H_at_deg"].as_f64().expect("an angle")).abs() < 1e-6, "{file}");
        }
        let figures = &expected(data)["circular"]["ballbar-zx-arc.csv"];
        for (trace, way) in traces(data, "ballbar-zx-arc.csv", 100.0).iter().zip(["ccw", "cw"]) {
            let [most, least] = trace.as_set_up(100.0).expect("samples");
            same(1e3 * most, &figures[format!("F_max_{way}")], "F max");
            same(1e3 * least, &figures[format!("F_min_{way}")], "F min");
            assert!(trace.minimum_zone().is_none() && trace.about_least_squares().is_none());
        }
    }
}

#[test]
fn rotary_axes() {
    let axes = [
        ("rtest-c.csv", "C_deg", [0.0, 0.0, 1.0], [110.0, 0.0, 60.0]),
        ("rtest-a.csv", "A_deg", [1.0, 0.0, 0.0], [0.0, 0.0, 140.0]),
    ];
    for data in DATA {
        for (file, axis, direction, from_axis) in axes {
            let figures = &expected(data)["rotary"][file];
            let table = Table::read(data, file);
            let path = Path::new(direction, from_axis, -1.0).expect("a path");
            let ways: Vec<bool> = table.texts("direction").iter().map(|way| way == "1").collect();
            let names = ["meas_x", "meas_y", "meas_z"];
            let readings = names.map(|name| table.numbers(&format!("{name}_um")));
            let angles = table.numbers(axis);
            let split =
                (0..ways.len()).map(|row| path.split(angles[row].to_radians(), [0, 1, 2].map(|k| readings[k][row])));
            let split: Vec<[f64; 3]> = split.collect();
            let parts = ["radial", "tangential", "axial"];
            let along =
                parts.iter().enumerate().map(|(place, name)| (*name, split.iter().map(|own| own[place]).collect()));
            for (name, values) in along.chain(names.into_iter().zip(readings.iter().cloned())) {
                let values: Vec<f64> = values;
                let found = ranges(&values, &ways);
                for (way, value) in [("up", found.up), ("down", found.down), ("both", found.both)] {
                    same(value.expect("a range"), &figures[name][way], &format!("{data} {file} {name} {way}"));
                }
            }
        }
    }
}

fn lengths(data: &str, file: &str) -> Vec<Measured> {
    let table = Table::read(data, file);
    let values = table.numbers("reference_mm").into_iter().zip(table.numbers("measured_mm"));
    let of = |(line, (reference, measured))| Measured { line, reference, measured };
    table.texts("group").into_iter().zip(values).map(of).collect()
}

/// Largest and smallest error (um), largest share of the limit.
fn figures_of(all: &[Measured], permissible: &Permissible) -> [f64; 3] {
    let most = |of: &dyn Fn(&Measured) -> f64| all.iter().map(of).fold(f64::NEG_INFINITY, f64::max);
    [most(&|own| 1e3 * own.error()), -most(&|own| -1e3 * own.error()), most(&|own| own.share(permissible))]
}

#[test]
fn lengths_of_a_cmm() {
    for data in DATA {
        let figures = &expected(data)["cmm"];
        for (name, file, constant) in [("E0", "lengths-e0.csv", 1.9e-3), ("EL150", "lengths-el150.csv", 2.4e-3)] {
            let permissible = Permissible { constant, slope: 1e-3 / 300.0, most: None };
            let (all, figures) = (lengths(data, file), &figures[name]);
            let sets = sets(&all);
            // Lengths of 300 mm to six decimals and more: their difference has twelve digits behind the point.
            let keys = ["E_max_um", "E_min_um", "largest_E_over_MPE"];
            for (key, found) in keys.into_iter().zip(figures_of(&all, &permissible)) {
                same(found, &figures[key], &format!("{data} {name} {key}"));
            }
            assert_eq!(serde_json::json!(all.len()), figures["measurements"]);
            if let Some(count) = figures.get("sets") {
                let one_outside =
                    |set: &&Set| set.places.iter().filter(|place| !all[**place].is_inside(&permissible)).count() == 1;
                assert_eq!(serde_json::json!(sets.len()), *count);
                assert_eq!(
                    serde_json::json!(sets.iter().filter(one_outside).count()),
                    figures["sets_with_one_outside"]
                );
            }
            let outside: Vec<u64> =
                (1..).zip(&all).filter(|(_, own)| !own.is_inside(&permissible)).map(|(n, _)| n).collect();
            assert_eq!(serde_json::json!(outside), figures["outside"]);
            let found = judge(&all, &sets, &[], |own| own.is_inside(&permissible));
            match figures["verdict"].as_str() == Some("pass") {
                true => assert_eq!(found, Judged::Inside),
                false => assert!(matches!(&found, Judged::Repeat(open) if open.len() == 1), "{found:?}"),
            }
            if name == "E0" {
                let widest = sets.iter().filter_map(|set| set.range).fold(0.0, f64::max);
                same(1e3 * widest, &figures["R0_max_um"], "R0");
                if widest > 0.0 {
                    let set = sets.iter().find(|set| set.range == Some(widest)).expect("the widest");
                    assert_eq!(set.line, figures["R0_at"]["group"].to_string());
                    same(set.reference, &figures["R0_at"]["reference_mm"], "the length of R0");
                }
            }
            if name == "E0" && data == "realistic" {
                let repeats = lengths(data, "lengths-e0-repeat.csv");
                assert_eq!(judge(&all, &sets, &repeats, |own| own.is_inside(&permissible)), Judged::Inside);
                let repeated = &expected(data)["cmm"]["E0_repeat"];
                for (place, own) in repeats.iter().enumerate() {
                    same(1e3 * own.error(), &repeated["errors_um"][place], "a repeat");
                    same(1e3 * permissible.at(own.reference), &repeated["limit_um"], "its limit");
                }
            }
        }
    }
}

#[test]
fn a_sphere_by_one_stylus_and_by_five() {
    for data in DATA {
        let table = Table::read(data, "sphere-points.csv");
        let (styli, axes) = (table.texts("stylus"), ["x_mm", "y_mm", "z_mm"].map(|axis| table.numbers(axis)));
        let of = |stylus: usize| -> Vec<[f64; 3]> {
            let rows = (0..styli.len()).filter(|row| styli[*row] == stylus.to_string());
            rows.map(|row| [0, 1, 2].map(|axis| axes[axis][row])).collect()
        };
        let figures = &expected(data)["cmm"];
        let (single, figures) = (&figures["probing_single"], &figures["probing_multi"]);
        let one = ball(&of(0)).expect("a sphere");
        (0..3).for_each(|axis| same(one.centre[axis], &single["centre_mm"][axis], "the centre"));
        let of_five: usize = (1..=5).map(|own| of(own).len()).sum();
        assert_eq!(
            [&serde_json::json!(of(0).len()), &serde_json::json!(of_five)],
            [&single["points"], &figures["points"]]
        );
        same(1e3 * one.form, &single["PFTU_um"], "PFTU");
        same(1e3 * (2.0 * one.radius - DIAMETER), &single["PSTU_um"], "PSTU");
        let five = multi_stylus(&(1..=5).map(of).collect::<Vec<_>>()).expect("spheres").expect("five");
        same(1e3 * five.all.form, &figures["PFTM_um"], "PFTM");
        same(1e3 * (2.0 * five.all.radius - DIAMETER), &figures["PSTM_um"], "PSTM");
        same(1e3 * five.largest_location(), &figures["PLTM_um"], "PLTM");
        (0..3).for_each(|axis| same(1e3 * five.location[axis], &figures["PLTM_by_axis_um"][axis], "PLTM by axis"));
    }
}
