//! Logs of controls in the forms that their programs write, read back.

use std::path::Path;

use abbe_core::{Dataset, from_settings};
use proptest::prelude::*;
use serde_json::{Value, json};

use super::{Lines, Settings};

fn lines(settings: Value) -> Lines {
    let mut all = json!({ "path": "log.txt" });
    let own = settings.as_object().expect("a map").clone();
    all.as_object_mut().expect("a map").extend(own);
    Lines::new(&from_settings::<Settings>(&all).expect("settings")).expect("patterns")
}

fn read(settings: Value, text: &str) -> Result<Dataset, String> {
    lines(settings).read(Path::new("log.txt"), text).map_err(|error| error.to_string())
}

fn numbers<'a>(data: &'a Dataset, name: &str) -> &'a [f64] {
    data.numbers(name).unwrap_or_else(|| panic!("no column {name}"))
}

/// Touches: number, three coordinates in mm, and whether the stylus touched.
fn touches() -> impl Strategy<Value = Vec<([f64; 3], bool)>> {
    let coordinate = || (-9_999_999_i64..9_999_999).prop_map(|steps| steps as f64 * 1e-4);
    prop::collection::vec(([coordinate(), coordinate(), coordinate()], prop::bool::weighted(0.8)), 1..40)
}

proptest! {
    #[test]
    fn what_controls_write_comes_back(touches in touches(), form in 0_usize..4) {
        // LinuxCNC `(LOG,...)`, Fanuc DPRNT, a text of Heidenhain's FN 16, and answers of grbl.
        type Write = fn(usize, [f64; 3], bool) -> String;
        let (settings, write): (Value, Write) = match form {
            0 => (
                json!({ "line": r"T(?<touch>\d+) X(?<X_mm>\S+) Y(?<Y_mm>\S+) Z(?<Z_mm>\S+)", "skip": [r"T\d+ MISS", r"\(.*\)"] }),
                |touch, [x, y, z], hit| match hit {
                    true => format!("T{touch} X{x:.4} Y{y:.4} Z{z:.4}\n(a comment)\n"),
                    false => format!("T{touch} MISS\n"),
                },
            ),
            1 => (
                json!({ "line": r"T\s*(?<touch>\d+)X\s*(?<X_mm>\S+)Y\s*(?<Y_mm>\S+)Z\s*(?<Z_mm>\S+)", "skip": ["%", r"T\s*\d+MISS"] }),
                |touch, [x, y, z], hit| match hit {
                    true => format!("T{touch:4}X{x:10.4}Y{y:10.4}Z{z:10.4}\r\n"),
                    false => format!("%\r\nT{touch:4}MISS\r\n"),
                },
            ),
            2 => (
                json!({
                    "line": r"TOUCH\s+(?<touch>\d+)\s+(?<X_mm>\S+)\s+(?<Y_mm>\S+)\s+(?<Z_mm>\S+)", "decimal": "comma",
                    "begins_after": "BEGIN", "ends_before": "END", "skip": [r"TOUCH\s+\d+\s+---"]
                }),
                |touch, [x, y, z], hit| match hit {
                    true => format!("  TOUCH {touch}  {x:+.4} {y:+.4}   {z:+.4}  \n").replace('.', ","),
                    false => format!("  TOUCH {touch} ---\n\n"),
                },
            ),
            _ => (
                json!({ "line": r"\[PRB:(?<X_mm>[^,]+),(?<Y_mm>[^,]+),(?<Z_mm>[^,]+):1\]", "headings": [r"> touch (?<touch>\d+)"], "skip": [r"\[PRB:.*:0\]", "ok"] }),
                |touch, [x, y, z], hit| format!("> touch {touch}\n[PRB:{x:.4},{y:.4},{z:.4}:{}]\nok\n", u8::from(hit)),
            ),
        };
        let body: String = touches.iter().enumerate().map(|(touch, (at, hit))| write(touch, *at, *hit)).collect();
        let text = if form == 2 { format!("whatever\nBEGIN\n{body}END\nwhatever\n") } else { body };
        let expected: Vec<(usize, [f64; 3])> = (touches.iter().enumerate())
            .filter_map(|(touch, (at, hit))| hit.then_some((touch, *at))).collect();
        let data = match read(settings, &text) {
            Err(error) => return { prop_assert!(expected.is_empty() && error.contains("no line of the file"), "{error}"); Ok(()) },
            Ok(data) => data,
        };
        prop_assert_eq!(data.rows(), expected.len());
        for (row, (touch, at)) in expected.iter().enumerate() {
            // A miss shifts nothing: each measurement has the number of its touch.
            prop_assert_eq!(&data.labels("touch").expect("touches")[row], &touch.to_string());
            for (name, value) in ["X", "Y", "Z"].into_iter().zip(at) {
                let nearest: f64 = format!("{value:.4}").parse().expect("a number");
                prop_assert_eq!(numbers(&data, name)[row], nearest);
            }
            let line = text.lines().nth(data.origins.get(row).expect("an origin").line - 1).expect("a line");
            prop_assert!(form == 3 || line.contains(&touch.to_string()), "{line}");
        }
    }

    #[test]
    fn any_text_is_read_or_refused_with_its_line(text in "[ -~\n]{0,400}", pattern in "[ -~]{0,20}") {
        let settings = json!({ "path": "log.txt", "line": format!("{pattern}(?<X_mm>.*)"), "skip": [pattern] });
        if let Ok(lines) = Lines::new(&from_settings::<Settings>(&settings).expect("settings")) {
            let _ = lines.read(Path::new("log.txt"), &text);
        }
    }
}

#[test]
fn headings_hold_for_the_lines_below() {
    let settings = json!({
        "headings": [r"INDEX B(?<B_deg>\S+) C(?<C_deg>\S+)", r"C(?<C_deg>\S+)"],
        "line": r"(?<feature>\w+) (?<X_mm>\S+)", "units": { "X_mm": "in", "B_deg": "rad" },
    });
    let data = read(settings, "INDEX B0.5 C90\nface 1\nC180\nface 2\n").expect("data");
    assert_eq!(numbers(&data, "B"), [0.5, 0.5]);
    assert_eq!(numbers(&data, "C"), [90_f64.to_radians(), 180_f64.to_radians()]);
    assert_eq!(numbers(&data, "X"), [25.4, 50.8]);
    assert_eq!(data.labels("feature").expect("labels"), ["face", "face"]);
}

#[test]
fn what_does_not_fit_is_refused_with_line_and_column() {
    let simple = json!({ "line": r"T(?<touch>\d+) X(?<X_mm>\S+)" });
    let above = json!({ "line": r"X(?<X_mm>\S+)", "headings": [r"C(?<C_deg>\S+)"] });
    let optional = json!({ "line": r"X(?<X_mm>\S+)?", "headings": [r"B(?<B_deg>\S+)( C(?<C_deg>\S+))?"] });
    let between = json!({ "line": r"X(?<X_mm>\S+)", "begins_after": "BEGIN", "ends_before": "END" });
    for (settings, text, expected) in [
        (&simple, "T1 X2\nALARM 5\n", "log.txt:2:1: `ALARM 5` is no line of this log"),
        (&simple, "T1 X2\n  T2 Xabc\n", "log.txt:2:7: `X_mm` is `abc`"),
        (&simple, "T1 X2 Y3\n", "`T1 X2 Y3` is no line of this log"),
        (&simple, "T1 X1e999\n", "which is not a finite number"),
        (&simple, "\n\n", "no line of the file matches `line`"),
        (&above, "X1\n", "log.txt:1:1: `C_deg` has no value: no heading above this line has it"),
        (&optional, "B1 C2\nX1\nB1\nX1\n", "log.txt:4:1: `C_deg` has no value: no heading above this line has it"),
        (&optional, "B1 C2\nX\n", "log.txt:2:1: `X_mm` has no value: its group matches nothing in this line"),
        (&between, "X1\n", "no line matches `begins_after`: `^(?:BEGIN)$`"),
        (&between, "BEGIN\nX1\n", "no line matches `ends_before`"),
        (&between, "END\nBEGIN\nX1\n", "no line matches `ends_before`"),
    ] {
        let told = read(settings.clone(), text).expect_err("an error");
        assert!(told.contains(expected), "{told}");
    }
}

#[test]
fn patterns_that_make_no_columns_are_refused() {
    for (settings, expected) in [
        (json!({ "line": "X" }), "line: no named group"),
        (json!({ "line": "(?<X_mm" }), "line: `(?<X_mm` is no regular expression"),
        (json!({ "line": "(?<X_mm>.*)", "headings": ["T"] }), "headings[0]: no named group"),
        (json!({ "line": "(?<X_mm>.*)", "headings": ["(?<X_deg>.*)"] }), "headings: two groups give the column `X`"),
        (json!({ "line": "(?<X_mm>.*)", "skip": ["a", "("] }), "skip[1]: `(` is no regular expression"),
        (json!({ "line": "(?<X_mm>.*)", "units": { "X_mm": "deg" } }), "units.X_mm: `deg` is no unit of `X_mm`"),
        (json!({ "line": "(?<X_mm>.*)", "units": { "Y_mm": "in" } }), "units.Y_mm: no group has this name"),
    ] {
        let mut all = json!({ "path": "log.txt" });
        all.as_object_mut().expect("a map").extend(settings.as_object().expect("a map").clone());
        let told = Lines::new(&from_settings::<Settings>(&all).expect("settings")).expect_err("an error").to_string();
        assert!(told.contains(expected), "{told}");
    }
}
