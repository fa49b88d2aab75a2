//! Samples in the form of each file, random ones written by code of their own, and files that went wrong.

use std::fmt::Write;
use std::path::Path;

use abbe_core::Dataset;
use proptest::prelude::*;

use super::table::{Read, Units};
use super::{dmis, inspection, probe, qif};

fn read(read: Read, text: &str, units: Option<Units>) -> Result<(Dataset, Vec<String>), String> {
    read(Path::new("file.txt"), text, units).map_err(|error| error.to_string())
}

fn numbers(data: &Dataset, names: &[&str], row: usize) -> Vec<f64> {
    names.iter().map(|name| data.numbers(name).unwrap_or_else(|| panic!("no column {name}"))[row]).collect()
}

fn label<'a>(data: &'a Dataset, name: &str, row: usize) -> &'a str {
    &data.labels(name).unwrap_or_else(|| panic!("no column {name}"))[row]
}

const MM: Option<Units> = Some(Units::Millimetres);

/// As a post writes it: header lines in another order, numbers without digits on one side, two sets, a point that missed, and one
/// that is labelled wrongly.
const INSPECTION: &str = "%
START
RESULTSFILE PART-7
TIMESTAMP 251124 101500
MODELVERSION 2
DOCUMENTID 5f1c
TOOLPATHID 31
TOOLPATH FACES
G331 N1 A0. B0. C0. X0. Y0. Z0.
G330 N1 A0. B0. C0. X0 Y0 Z0 I0 R0
G800 N1 X10. Y-.5 Z.4187 I0. J0. K1. O0. U.1 L-.1
G801 N1 X10.0004 Y-.5002 Z3.4212 R3.
G800 N2 X10 Y5 Z0 I.7071 J0 K.7071 O0 U.1 L-.1
G800 N3 X0 Y0 Z0 I-1 J0 K0
G800 N3 X-3.001 Y0 Z0 R3
G802 N3 DEVIATION .001
END
START
TOOLPATHID 31
G800 N1 X10. Y-.5 Z.4187 I0. J0. K1. O0. U.1 L-.1
G801 N1 X10. Y-.5 Z3.4187 R3.
END
%
";

#[test]
fn inspection_results_are_read_as_posts_write_them() {
    let (data, remarks) = read(inspection::read, INSPECTION, MM).expect("data");
    assert_eq!(data.rows(), 3);
    let axes = ["X", "Y", "Z", "x", "y", "z", "nx", "ny", "nz", "tip_radius"];
    assert_eq!(numbers(&data, &axes, 0), [10.0004, -0.5002, 3.4212, 10.0, -0.5, 0.4187, 0.0, 0.0, 1.0, 3.0]);
    assert_eq!((label(&data, "set", 0), label(&data, "toolpath", 0), label(&data, "feature", 1)), ("1", "31", "3"));
    assert_eq!((label(&data, "set", 2), label(&data, "feature", 2), data.origins[2].line), ("2", "1", 21));
    assert_eq!(remarks.len(), 2, "{remarks:?}");
    assert!(
        remarks[0].starts_with("1 nominal points (G800) were not measured") && remarks[1].contains("labelled G800")
    );
    let (inches, _) = read(inspection::read, INSPECTION, Some(Units::Inches)).expect("data");
    assert!((numbers(&inches, &["X"], 0)[0] - 10.0004 * 25.4).abs() < 1e-12);
}

#[test]
fn inspection_results_that_went_wrong_are_refused() {
    for (from, to, expected) in [
        ("START\nRESULTS", "HELLO\nRESULTS", "file.txt:2: `HELLO` is no line of inspection results"),
        ("START\nRESULTS", "STARTX\nRESULTS", "file.txt:2: `STARTX` is no line of inspection results"),
        ("TOOLPATHID", "TOOLPATHIDX", "is no line of inspection results"),
        ("TOOLPATHID", "TOOLPATHID G800 N9 X1", "G800 stands in the line of a TOOLPATHID"),
        ("TOOLPATHID", "TOOLPATHID 2G800 N1", "2G800 stands in the line of a TOOLPATHID"),
        ("G801 N1 X10.0004", "G801 N7 X10.0004", "file.txt:12: point 7 is measured, and has no G800 before"),
        ("G801 N1 X10.0004 Y-.5002 Z3.4212", "G801 N1 X100004 Y-.5002 Z3.4212", "is a decimal point missing"),
        ("Z3.4212 R3.", "Z3.4212", "a G801 has the radius R of the tip"),
        ("Z3.4212 R3.", "Z3.42", "a G801 has the radius R of the tip"),
        ("Z3.4212 R3.", "Z3,4,2 R3.", "file.txt:12:27: a number was expected behind `Z`"),
        (
            "I0. J0. K1. O0. U.1 L-.1\nG801 N1 X10.0004",
            "I0. J0. K10 O0. U.1 L-.1\nG801 N1 X10.0004",
            "the normal I J K has the length 10.0000",
        ),
        (
            "I0. J0. K1. O0. U.1 L-.1\nG801 N1 X10.0004",
            "I0. J0. K-1. O0. U.1 L-.1\nG801 N1 X10.0004",
            "does the normal point into the material",
        ),
        ("G800 N2", "G800 N1", "file.txt:13: point 1 stands in line 12 already"),
        (
            "G800 N3 X0 Y0 Z0 I-1 J0 K0\n",
            "G800 N3 X0 Y0 Z0 I-1 J0 K0\nG800 N3 X0 Y0 Z0 I-1 J0 K0\n",
            "point 3 stands in line 14 already",
        ),
        (
            "G800 N3 X-3.001 Y0 Z0 R3\n",
            "G800 N3 X-3.001 Y0 Z0 R3\nG801 N3 X-3.001 Y0 Z0 R3\n",
            "point 3 is measured in line 15 already",
        ),
        ("G800 N3 X0 Y0 Z0 I-1", "G800 N3 Y0 Z0 I-1", "file.txt:14: the line has no X"),
    ] {
        let text = INSPECTION.replacen(from, to, 1);
        assert_ne!(text, INSPECTION, "{from}");
        let told = read(inspection::read, &text, MM).expect_err(&text);
        assert!(told.contains(expected), "{from} -> {to}: {told}");
    }
    assert!(
        read(inspection::read, INSPECTION, None).expect_err("no unit").contains("write `units: mm` or `units: in`")
    );
    assert!(read(inspection::read, "START\nEND\n", MM).expect_err("empty").contains("no measured point"));
}

const DMIS: &str = "$$ results of a plate
FILNAM/'PLATE 7',5.3
UNITS/MM,ANGDEC
F(H1)=FEAT/CIRCLE,INNER,CART,50.0,50.0,0.0,0.0,0.0,1.0,20.0
F(S1) = FEAT/SPHERE,OUTER,CART,100.0,50.0,10.0,25.4
OUTPUT/FA(H1)
FA(H1)=FEAT/CIRCLE,INNER,CART,50.0012,49.9987,0.0004,$
  0.0,0.0,1.0,20.0031
OUTPUT/FA(S1),TA(T1)
FA(S1)=FEAT/SPHERE,OUTER,CART,100.002,50.001,9.999,25.4003 $$ a ball
FA(P1)=FEAT/PLANE,CART,0,0,0,0,0,1
TA(T1)=TOL/FLAT,0.023,INTOL
";

#[test]
fn dmis_output_is_read_with_its_nominal_features() {
    let (data, remarks) = read(dmis::read, DMIS, None).expect("data");
    let axes = ["X", "Y", "Z", "diameter", "x", "y", "z"];
    assert_eq!(numbers(&data, &axes, 0), [50.0012, 49.9987, 0.0004, 20.0031, 50.0, 50.0, 0.0]);
    assert_eq!(numbers(&data, &axes, 1), [100.002, 50.001, 9.999, 25.4003, 100.0, 50.0, 10.0]);
    assert_eq!((label(&data, "point", 0), label(&data, "kind", 1), data.origins[1].line), ("H1", "sphere", 10));
    assert!(remarks.len() == 1 && remarks[0].starts_with("1 measured features are no point"), "{remarks:?}");
    let (inches, _) = read(dmis::read, &DMIS.replace("UNITS/MM", "UNITS/INCH"), None).expect("data");
    assert!((numbers(&inches, &["Y"], 1)[0] - 50.001 * 25.4).abs() < 1e-12);
    for (from, to, expected) in [
        ("UNITS/MM,ANGDEC\n", "", "the file does not say the unit"),
        ("UNITS/MM", "UNITS/PARSEC", "file.txt:3:1: UNITS is `PARSEC`"),
        ("49.9987", "49.99x", "file.txt:7:1: `49.99X` is no number"),
        ("FA(S1)=FEAT/SPHERE", "FA(H1)=FEAT/SPHERE", "file.txt:10:1: FA(H1) stands in line 7 already"),
        ("FA(S1)=FEAT/SPHERE", "FA(H2)=FEAT/POINT,POL", ""),
        ("FA(S1)=FEAT/SPHERE,OUTER,CART", "FA(S1)=FEAT/SPHERE,OUTER,POL", "only Cartesian coordinates are read"),
        ("CART,100.002,50.001,9.999,25.4003", "CART,100.002,50.001,9.999", "has 3 numbers; 4 were expected"),
        ("FA(S1)=FEAT/SPHERE,OUTER,", "FA(S1)=FEAT/CIRCLE,INNER,", "FA(S1) is a circle, and F(S1) is a sphere"),
        ("TA(T1)=TOL/FLAT,0.023,INTOL", "TA(T1)=TOL/FLAT,$", "the file ends in a statement that goes on"),
        ("FA(S1)=", "FA(S1=", "file.txt:10:1: `FA(S1=FEAT/SPHERE,"),
        ("FA(S1)=", "FAS1)=", "is no feature; F(NAME)=FEAT/.. or FA(NAME)=FEAT/.. was expected"),
        ("FA(S1)=FEAT", "FA(S1) FEAT", "is no feature"),
        ("FA(S1)=FEAT", "FA(S1)=FEATX", "is no feature"),
        ("FA(S1)=FEAT", "FA()=FEAT", "is no feature"),
        ("FA(S1)=FEAT", "X(S1)=FEAT", "is no feature"),
        ("50.0012,49", "50,0012,49", "has 8 numbers; 4 or 7 were expected"),
        ("25.4003", "25.4003,7,8", "has 6 numbers; 4 were expected"),
        ("25.4003", "-25.4003", "a diameter of -25.4003; one above 0 was expected"),
        ("20.0031", "0", "a diameter of 0; one above 0 was expected"),
        ("100.002,", "1 00.002,", "file.txt:10:1: there is a blank within a number"),
        ("100.002,", "100 .002,", "there is a blank within a number"),
        ("100.002,50.001", "100.002 -50.001", "there is a blank within a number"),
        ("UNITS/MM", "UNITS/MM,INCH", "UNITS has two units of lengths, MM and INCH"),
    ] {
        assert!(DMIS.contains(from), "{from}");
        let told = read(dmis::read, &DMIS.replacen(from, to, 1), None).expect_err(from);
        assert!(told.contains(expected), "{from} -> {to}: {told}");
    }
    let (_, remarks) = read(dmis::read, &DMIS.replace("FA(S1)", "FA(S2)"), None).expect("data");
    assert_eq!(remarks[1..], ["1 of 2 nominal features were not measured, the first is F(S1)"]);
    // A text may say anything, and a cylinder its length behind its diameter.
    let cylinder = "TEXT/OUTFIL,'FA(H1 = FEAT/ 1 2'\nFA(C1)=FEAT/CYLNDR,OUTER,CART, 1, -2, 3, 0, 0, 1, 8, 30\n";
    let (cylinder, _) = read(dmis::read, &format!("{DMIS}{cylinder}"), None).expect("data");
    assert_eq!(numbers(&cylinder, &["X", "Y", "Z", "diameter"], 2), [1.0, -2.0, 3.0, 8.0]);
    assert!(
        read(dmis::read, DMIS, Some(Units::Inches))
            .expect_err("another unit")
            .contains("UNITS is MM, and `units` of the recipe says in")
    );
}

/// As results are written by the community's samples: units, nominal features, items, measured features of one run.
const QIF: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<QIFDocument xmlns="http://qifstandards.org/xsd/qif3" versionQIF="3.0.0" idMax="90">
  <FileUnits><PrimaryUnits>
    <LinearUnit><SIUnitName>meter</SIUnitName><UnitName>mm</UnitName><UnitConversion><Factor>0.001</Factor></UnitConversion></LinearUnit>
  </PrimaryUnits></FileUnits>
  <Features>
    <FeatureNominals n="2">
      <CircleFeatureNominal id="9"><FeatureDefinitionId>8</FeatureDefinitionId><Location>50 50 0</Location><Normal>0 0 1</Normal></CircleFeatureNominal>
      <PointFeatureNominal id="20"><Location>100 50 10</Location></PointFeatureNominal>
    </FeatureNominals>
    <FeatureItems n="2">
      <CircleFeatureItem id="10"><FeatureNominalId>9</FeatureNominalId><FeatureName>H1</FeatureName></CircleFeatureItem>
      <PointFeatureItem id="21"><FeatureNominalId>20</FeatureNominalId></PointFeatureItem>
    </FeatureItems>
  </Features>
  <Results><MeasurementResultsSet n="1"><MeasurementResults id="30">
    <MeasuredFeatures n="3">
      <CircleFeatureMeasurement id="11"><FeatureItemId>10</FeatureItemId>
        <Location>50.0012 49.9987 0.0004</Location><Normal>0 0 1</Normal><Diameter>20.0031</Diameter></CircleFeatureMeasurement>
      <PointFeatureMeasurement id="22"><FeatureItemId>21</FeatureItemId><Location>100.002 50.001 9.999</Location></PointFeatureMeasurement>
      <PlaneFeatureMeasurement id="23"><FeatureItemId>21</FeatureItemId></PlaneFeatureMeasurement>
    </MeasuredFeatures>
  </MeasurementResults></MeasurementResultsSet></Results>
</QIFDocument>
"#;

#[test]
fn qif_results_are_read_with_their_nominal_features() {
    let (data, remarks) = read(qif::read, QIF, None).expect("data");
    let axes = ["X", "Y", "Z", "diameter", "x", "y", "z"];
    let near = |row, expected: [f64; 7]| {
        let own = numbers(&data, &axes, row);
        assert!(own.iter().zip(expected).all(|(own, expected)| (own - expected).abs() < 1e-12), "{own:?}");
    };
    near(0, [50.0012, 49.9987, 0.0004, 20.0031, 50.0, 50.0, 0.0]);
    near(1, [100.002, 50.001, 9.999, 0.0, 100.0, 50.0, 10.0]);
    assert_eq!((label(&data, "feature", 0), label(&data, "point", 1), label(&data, "kind", 1)), ("H1", "21", "point"));
    assert_eq!((label(&data, "run", 0), data.origins[1].line, remarks.len()), ("30", 20, 1));
    let inches = QIF.replace("<Factor>0.001<", "<Factor>0.0254<").replace("<UnitName>mm<", "<UnitName>Inch<");
    let (inches, _) = read(qif::read, &inches, None).expect("data");
    assert!((numbers(&inches, &["X"], 0)[0] - 50.0012 * 25.4).abs() < 1e-9);
    for (from, to, expected) in [
        ("</QIFDocument>", "", "the file is no XML"),
        ("versionQIF=\"3.0.0\"", "versionQIF=\"2.1\"", "a QIFDocument of version 3 was expected"),
        ("<FileUnits>", "<OtherUnits>", "the file is no XML"),
        ("LinearUnit><SI", "AngularUnit><SI", "the file is no XML"),
        (
            "<UnitName>mm",
            "<UnitName>inch",
            "file.txt:4:5: the UnitName is inch, which is 25.4 mm, and the Factor says 1 mm",
        ),
        ("<Factor>0.001<", "<Factor>0.00<!-- a -->1<", "a comment inside of a text"),
        ("<SIUnitName>meter", "<SIUnitName>parsec", "file.txt:4:5: the LinearUnit is no multiple of the metre"),
        ("<Factor>0.001<", "<Factor>0,001<", "no multiple of the metre"),
        (
            "50.0012 49.9987 0.0004",
            "50.0012 49.9987",
            "file.txt:19:9: the Location is `50.0012 49.9987`; three numbers were expected",
        ),
        ("<Location>50.0012", "<Location linearUnit=\"inch\">50.0012", "has a unit of its own"),
        (
            "<FeatureItemId>21</FeatureItemId><Location>",
            "<FeatureItemId>10</FeatureItemId><Location>",
            "file.txt:20:7: the feature `H1` is measured in line 18 already",
        ),
        (
            "<FeatureItemId>21</FeatureItemId><Location>",
            "<FeatureItemId>77</FeatureItemId><Location>",
            "there is no feature with the id 77",
        ),
        ("<Diameter>20.0031", "<Diameter>20,0031", "the Diameter is `20,0031`"),
    ] {
        let text = QIF.replacen(from, to, 1);
        assert_ne!(text, QIF, "{from}");
        let told = read(qif::read, &text, None).expect_err(from);
        assert!(told.contains(expected), "{from} -> {to}: {told}");
    }
    let start = QIF.find("  <FileUnits>").expect("units");
    let end = QIF.find("  <Features>").expect("features");
    let without = format!("{}{}", &QIF[..start], &QIF[end..]);
    assert!(read(qif::read, &without, None).expect_err("no unit").contains("does not say the unit"));
    assert!(read(qif::read, &without, MM).is_ok());
    assert!(read(qif::read, QIF, Some(Units::Inches)).expect_err("another unit").contains("`units` says in"));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn random_inspections_come_back(
        points in prop::collection::vec(((-9999_i64..9999), (-9999_i64..9999), (-2999_i64..2999), 0_usize..6, any::<bool>()), 1..40),
        inches in any::<bool>(),
    ) {
        let decimal = |steps: i64| {
            let written = format!("{:.3}", steps as f64 * 1e-3);
            written.trim_end_matches('0').replacen("0.", ".", usize::from(steps.abs() < 1000 && steps != 0))
        };
        let normals = [("1.", "0", "0."), ("0.", "1.", "0"), ("0", "0.", "1"), ("-1", "0.", "0"), ("0", "-1.", "0"), (".6", "0", ".8")];
        let mut text = String::from("START\n");
        for (index, (x, y, away, normal, hit)) in points.iter().enumerate() {
            let (i, j, k) = normals[*normal];
            let _ = writeln!(text, "G800 N{} X{} Y{} Z0. I{i} J{j} K{k} O0. U0. L0.", index + 1, decimal(*x), decimal(*y));
            if *hit {
                let _ = writeln!(text, "G801 N{} X{} Y{} Z.001 R.1", index + 1, decimal(*x + away / 50), decimal(*y));
            }
        }
        let units = if inches { Units::Inches } else { Units::Millimetres };
        let measured: Vec<_> = points.iter().enumerate().filter(|(_, point)| point.4).collect();
        match read(inspection::read, &text, Some(units)) {
            Err(told) => prop_assert!(measured.is_empty(), "{}\n{}", told, text),
            Ok((data, _)) => {
                prop_assert_eq!(data.rows(), measured.len());
                for (row, (index, (x, y, away, ..))) in measured.into_iter().enumerate() {
                    prop_assert_eq!(label(&data, "feature", row), (index + 1).to_string());
                    let expected = [(x + away / 50) as f64 * 1e-3, *y as f64 * 1e-3, 1e-3, *x as f64 * 1e-3];
                    for (own, expected) in numbers(&data, &["X", "Y", "Z", "x"], row).into_iter().zip(expected) {
                        prop_assert!((own - expected * units.scale()).abs() < 1e-12, "{own} {expected}\n{text}");
                    }
                }
            }
        }
    }

    #[test]
    fn maps_of_heights_come_back_or_are_refused(
        nx in 1_usize..8, ny in 1_usize..8, heights in prop::collection::vec(-2000_i64..2000, 64), lost in prop::option::of(0_usize..64),
    ) {
        let mut text = format!("-10.0 {} {nx}\n5 {} {ny}\n-3.0 3.0 50.0\n\n", -10.0 + 2.5 * (nx - 1) as f64, 5 + 4 * (ny - 1));
        for place in (0..nx * ny).filter(|place| Some(*place) != lost) {
            let _ = writeln!(text, "{} {} {}", -10.0 + 2.5 * (place % nx) as f64, 5 + 4 * (place / nx), heights[place] as f64 * 1e-3);
        }
        match read(probe::read, &text, MM) {
            Ok((data, _)) => {
                prop_assert!(lost.is_none_or(|lost| lost >= nx * ny) && data.rows() == nx * ny);
                for (place, height) in heights.iter().enumerate().take(nx * ny) {
                    let expected = [-10.0 + 2.5 * (place % nx) as f64, (5 + 4 * (place / nx)) as f64, *height as f64 * 1e-3];
                    prop_assert_eq!(numbers(&data, &["X", "Y", "Z"], place), expected);
                }
            }
            Err(told) => prop_assert!(lost.is_some_and(|lost| lost < nx * ny), "{}\n{}", told, text),
        }
        prop_assert!(read(probe::read, &text, None).is_err());
    }

    #[test]
    fn any_text_is_read_or_refused(text in "[ -~\n]{0,300}") {
        for reader in [inspection::read as Read, dmis::read, probe::read, qif::read] {
            let _ = read(reader, &text, MM);
            let _ = read(reader, &format!("UNITS/MM\nFA(A)=FEAT/{text}"), None);
            let _ = read(reader, &format!("G800 {text}\nG801{text}"), MM);
            let _ = read(reader, &QIF.replacen("50.0012", &text, 1), MM);
            let _ = read(reader, &format!("0 1 2\n0 1 2\n0 1 5\n{text}"), MM);
        }
    }
}
