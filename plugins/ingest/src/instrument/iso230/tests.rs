//! A sample of our own, random tests written by code of their own, and files that went wrong.

use proptest::prelude::*;

use super::*;

const POSITIONS: Wanted = Wanted { units: None, deviations_in: None, swap: false };

fn of(text: &str, wanted: Wanted) -> Result<Dataset, String> {
    read(Path::new("x.dat"), text, wanted).map(|(data, _)| data).map_err(|error| error.to_string())
}

/// Three targets, two runs, indices from 1; a key that nobody needs.
const SAMPLE: &str = "# X axis, laser interferometer
MACHINE=\"mill 3\"
UNIT=mm
CYCLES=2
POSITIONS=3
TGT_DATA[1]=0.000
TGT_DATA[2]=101.337
TGT_DATA[3]=203.911
REF_DATA_FWD[1,1]=0.0004
REF_DATA_FWD[2,1]=101.3391
REF_DATA_FWD[3,1]=203.9142
REF_DATA_FWD[1,2]=0.0006
REF_DATA_FWD[2,2]=101.3389
REF_DATA_FWD[3,2]=203.9145
REF_DATA_BWD[1,1]=-0.0011
REF_DATA_BWD[2,1]=101.3370
REF_DATA_BWD[3,1]=203.9120
REF_DATA_BWD[1,2]=-.0009
REF_DATA_BWD[2,2]=101.3372
REF_DATA_BWD[3,2]=203.9121
";

#[test]
fn a_test_is_read_in_the_order_in_which_it_was_made() {
    let data = of(SAMPLE, POSITIONS).expect("data");
    assert_eq!(data.rows(), 12);
    let (runs, directions) = (data.labels("run").expect("runs"), data.labels("direction").expect("directions"));
    let (positions, readings) = (data.numbers("position").expect("mm"), data.numbers("reading").expect("mm"));
    let row = |row: usize| (runs[abbe_core::DataRow(row)].as_str(), directions[abbe_core::DataRow(row)].as_str());
    assert_eq!([row(0), row(3), row(6)], [("1", "1"), ("1", "-1"), ("2", "1")]);
    let at = |row: usize| (positions[abbe_core::DataRow(row)], readings[abbe_core::DataRow(row)]);
    assert_eq!(at(1).0, 101.337);
    assert!((at(1).1 - 0.0021).abs() < 1e-12, "{:?}", at(1));
    // The way back begins at the far end.
    assert_eq!(at(3).0, 203.911);
    assert!((at(3).1 - 0.001).abs() < 1e-12, "{:?}", at(3));
    // The same file, its directions the other way round.
    let swapped = of(SAMPLE, Wanted { swap: true, ..POSITIONS }).expect("data");
    assert_eq!(swapped.labels("direction").expect("directions")[abbe_core::DataRow(0)], "-1");
}

#[test]
fn what_is_missing_or_contradicts_itself_is_told() {
    let cases = [
        ("UNIT=mm\n", "", "the unit of its targets"),
        ("UNIT=mm", "UNIT=cubit", "x.dat:3:6: UNIT is `cubit`, which is not known"),
        ("CYCLES=2", "CYCLES=3", "x.dat:4: CYCLES is 3, and there are readings of 2 runs"),
        ("POSITIONS=3", "POSITIONS=4", "there is no TGT_DATA[4]"),
        ("POSITIONS=3", "POSITIONS=2", "TGT_DATA[3] is beyond the 2 POSITIONS"),
        ("TGT_DATA[2]=101.337", "TGT_DATA[2]=1O1", "x.dat:7:13: `1O1` is no number"),
        ("TGT_DATA[2]=101.337", "TGT_DATA[1]=101.337", "stands in line 6 already"),
        ("REF_DATA_BWD[2,2]=101.3372\n", "", "there is no REF_DATA_BWD[2,2]"),
        ("REF_DATA_FWD[3,2]", "REF_DATA_FWD[4,2]", "belongs to no target"),
        ("REF_DATA_FWD[3,2]", "REF_DATA_FWD[3]", "has two indices"),
        ("REF_DATA_FWD[3,2]", "REF_DATA_FWD[3;2]", "indices from 0 or 1"),
        ("CYCLES=2", "CYCLES 2", "x.dat:4:1: `CYCLES 2`: a line KEY=value"),
    ];
    for (from, to, expected) in cases {
        let error = of(&SAMPLE.replacen(from, to, 1), POSITIONS).expect_err(expected);
        assert!(error.contains(expected), "{from} -> {to}: {error}");
    }
    let stated = Wanted { units: Some(Axis::Inches), ..POSITIONS };
    let error = of(SAMPLE, stated).expect_err("two units");
    assert!(error.contains("UNIT is `mm`, and the recipe says in"), "{error}");
    let empty = of("UNIT=mm\nTGT_DATA[0]=0\n", POSITIONS).expect_err("no readings");
    assert!(empty.contains("there is no reading"), "{empty}");
}

proptest! {
    /// Random tests in any unit and from both first indices, as positions and as deviations: the same readings.
    #[test]
    fn positions_and_deviations_give_the_same(
        targets in prop::collection::vec(-500.0..500.0f64, 2..6),
        runs in 1usize..4,
        base in 0usize..2,
        unit in prop::sample::select(vec![("mm", 1.0), ("in", 25.4), ("deg", 1f64.to_radians())]),
        seed in any::<u32>(),
    ) {
        let (name, scale) = unit;
        let deviation = |target: usize, run: usize, back: usize| -> f64 {
            (f64::from(seed % 1000) + 7.0 * target as f64 + 3.0 * run as f64 + 31.0 * back as f64).sin() * 1e-3
        };
        let head = format!("UNIT={name}\nCYCLES={runs}\nPOSITIONS={}\n", targets.len());
        let (mut positions, mut deviations) = (head.clone(), head);
        for (index, target) in targets.iter().enumerate() {
            let line = format!("TGT_DATA[{}]={target:.9}\n", index + base);
            positions.push_str(&line);
            deviations.push_str(&line);
            for run in 0..runs {
                for (back, key) in READINGS.iter().enumerate() {
                    let value = deviation(index, run, back);
                    let place = format!("{key}[{},{}]", index + base, run + base);
                    positions.push_str(&format!("{place}={:.12}\n", target + value));
                    deviations.push_str(&format!("{place}={value:.15}\n"));
                }
            }
        }
        let same = match name { "mm" => Deviation::Millimetres, "in" => Deviation::Inches, _ => Deviation::Degrees };
        let one = of(&positions, POSITIONS).expect("positions");
        let wanted = Wanted { deviations_in: Some(same), ..POSITIONS };
        let other = of(&deviations, wanted).expect("deviations");
        prop_assert_eq!(one.rows(), 2 * runs * targets.len());
        let (a, b) = (one.numbers("reading").expect("one"), other.numbers("reading").expect("other"));
        for row in one.row_indices() {
            // Targets have nine decimals here.
            prop_assert!((a[row] - b[row]).abs() < 1e-9 * scale + 1e-12);
        }
        let back = one.labels("direction").expect("directions");
        for row in one.row_indices() {
            let (run, place) = (row.0 / (2 * targets.len()), row.0 % (2 * targets.len()));
            let backward = place >= targets.len();
            let index = if backward { 2 * targets.len() - 1 - place } else { place };
            let expected = deviation(index, run, usize::from(backward)) * scale;
            prop_assert!((b[row] - expected).abs() < 1e-12);
            prop_assert_eq!(back[row].as_str(), if backward { "-1" } else { "1" });
        }
    }
}
