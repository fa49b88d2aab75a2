//! Logs that are not those of the plan, and what is told of them.

use std::fmt::Write;

use super::{WANTED, Wanted, plan, read, refused};

const PLAN: &str = "X_mm,Y_mm,Z_mm,C_deg,feature\n100,0,50,0,a\n0,100,50,0,b\n0,0,80,0,c\n100,0,50,90,d\n0,100,50,90,e\n0,0,80,90,f\n50,50,80,90,g\n50,50,80,0,h\n";

/// A log of `PLAN` whose touches are this far away from it.
fn away(of: impl Fn(usize) -> [f64; 3]) -> String {
    let plan = plan(PLAN);
    let mut text = format!(
        "ABBE 1\nPLAN {}\nCONTROL LINUXCNC\nUNITS MM\nFRAME MACHINE\nTOOL L120 D6\nTOUCHES 8\n",
        plan.identity()
    );
    for touch in 0..8 {
        let [x, y, z] = of(touch);
        let [px, py, pz] = ["X", "Y", "Z"].map(|axis| plan.data.numbers(axis).expect("positions")[touch]);
        let c = plan.data.numbers("C").expect("positions")[touch].to_degrees();
        let _ = writeln!(text, "T{} R1 H1 X{:.4} Y{:.4} Z{:.4} C{c:.4}", touch + 1, px + x, py + y, pz + z);
    }
    text + "END\n"
}

#[test]
fn a_log_that_is_too_far_off_says_what_it_looks_like() {
    // The direction in which each touch of `PLAN` sees a shift.
    let seen = |touch: usize, shift: [f64; 3]| {
        let normal = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]][match touch {
            0 | 3 => 0,
            1 | 4 => 1,
            _ => 2,
        }];
        let along: f64 = (0..3).map(|k| normal[k] * shift[k]).sum();
        normal.map(|n| n * along)
    };
    let turned = |touch: usize| if (3..7).contains(&touch) { [-3.0, 4.0, 0.0] } else { [4.0, 3.0, 0.0] };
    for (text, expected) in [
        (away(|_| [0.0; 3]), None),
        (away(|touch| seen(touch, [0.0, 0.0, -5.0])), Some("is the length of the tool wrong")),
        (away(|touch| seen(touch, [3.0, -4.0, 0.5])), Some("does the artefact stand elsewhere")),
        (away(|touch| seen(touch, turned(touch))), Some("does the artefact stand at another place of the table")),
        (
            away(|touch| if touch == 4 { [0.0, 2.5, 0.0] } else { [0.0; 3] }),
            Some("1 touch of 8 is farther from the plan than 2 mm or 0.115°: touch 5 in line 12: Y +2.5000 mm"),
        ),
        (away(|touch| if touch == 4 { [0.0, 2.5, 0.0] } else { [0.0; 3] }), Some("these touches alone are far")),
        (away(|_| [0.0; 3]).replace("C90.0000", "C91.0000"), Some("rotary axes stood elsewhere")),
        (away(|_| [0.0; 3]).replace("UNITS MM", "UNITS INCH").replace("L120", "L4.7"), Some("farther from the plan")),
        (away(|_| [0.0; 3]).replace("C90.0000", "C-270.0000"), None),
    ] {
        match (read(0, &text, &plan(PLAN), &WANTED), expected) {
            (Ok(_), None) => {}
            (Err(error), Some(expected)) => assert!(error.to_string().contains(expected), "{error}"),
            (told, expected) => panic!("{told:?} {expected:?}"),
        }
    }
}

#[test]
fn what_is_no_log_of_this_plan_is_refused_by_line() {
    let good = away(|_| [0.001, 0.0, 0.0]);
    let plan = plan(PLAN);
    assert!(read(0, &good, &plan, &WANTED).is_ok());
    for (from, to, expected) in [
        ("ABBE 1", "ABBE 2", "log.txt:1: the log has version 2"),
        ("ABBE 1", "HELLO", "`ABBE 1` was expected"),
        ("PLAN ", "PLAN X", "16 digits 0-9 A-F were expected"),
        (&plan.identity(), "0123456789ABCDEF", "log.txt:2: the log belongs to the plan 0123456789ABCDEF"),
        (
            "CONTROL LINUXCNC",
            "CONTROL FANUC",
            "log.txt:3: CONTROL is `FANUC`; LINUXCNC was expected (read it by `ingest: dprnt`)",
        ),
        ("UNITS MM\n", "", "the header of the log has no line UNITS"),
        ("UNITS MM", "UNITS CM", "MM or INCH was expected"),
        ("UNITS MM", "UNITS MM\nUNITS MM", "UNITS stands twice"),
        ("FRAME MACHINE", "FRAME WORK", "FRAME is WORK, but the header has no line OFFSET"),
        ("FRAME MACHINE", "FRAME MACHINE\nOFFSET X1", "log.txt:6: FRAME is MACHINE, and still there is an OFFSET"),
        ("FRAME MACHINE", "FRAME WORK\nOFFSET X0 Y0 Z0", "log.txt:6: OFFSET has no C"),
        ("TOUCHES 8", "TOUCHES 9", "TOUCHES is 9, but `plan.csv` has 8 touches"),
        ("T3 R1", "T9 R1", "log.txt:10: `plan.csv` has no touch 9"),
        ("T3 R1", "T3 R2", "log.txt:10: there is no repeat 2: REPEATS is 1"),
        ("T3 R1", "T2 R1", "log.txt:10: touch 2 (repeat 1) stands in line 9 already"),
        ("T3 R1", "T3", "log.txt:10: the line has no R"),
        ("T3 R1 H1", "T3 R1 H2", "log.txt:10:7: `H` is neither 1 (hit) nor 0 (miss)"),
        ("T3 R1 H1", "T3.5 R1 H1", "log.txt:10:1: `T` is no whole number"),
        ("T3 R1 H1", "T3 R1 H1 Q5", "log.txt:10:10: `Q` is no word of a touch"),
        ("T3 R1 H1", "T3 R1 H1 A5", "log.txt:10: the axis A moves, and the plan does not have it"),
        ("T3 R1 H1", "T3 R1 H1 K5", "one has K, one has not"),
        ("T3 R1 H1 X0.0010", "T3 R1 H1", "no position of the axis X"),
        ("T3 R1 H1 X0.0010", "T3 R1 H1 Xabc", "log.txt:10:11: a number was expected behind `X`"),
        ("END\n", "", "the log has no END"),
        ("END\n", "END\nT1 R1 H0\n", "stands behind END"),
        ("END\n", "ABBE 1\n", "log.txt:16: a second log begins here; the first one begins in line 1"),
    ] {
        let told = refused(0, &good.replacen(from, to, 1), &plan);
        assert!(told.contains(expected), "{from} -> {to}: {told}");
    }
    let without = good.lines().filter(|line| !line.starts_with("T3 ")).collect::<Vec<_>>().join("\n");
    assert!(refused(0, &without, &plan).contains("the first is touch 3 (repeat 1)"));
    let tool = |length| Wanted { tool_length: Some(length), ..WANTED };
    assert!(read(0, &good, &plan, &tool(120.0)).is_ok());
    assert!(
        read(0, &good, &plan, &tool(121.0))
            .expect_err("another tool")
            .to_string()
            .contains("log.txt:6: the length of the tool was 120 mm")
    );
}

#[test]
fn the_console_says_what_it_does_not_understand() {
    let plan = plan("X_mm,Y_mm,Z_mm\n1,2,3\n4,5,6\n");
    let head = format!("(ABBE 1)\n(PLAN {})\n(UNITS MM)\n(FRAME MACHINE)\n(TOUCHES 2)\n", plan.identity());
    let text = |body: &str| format!("{head}{body}");
    let two =
        "G21\nok\nN101G38.3X9F50 < [PRB:1.001,2.000,3.000:1] < ok\nN201 G38.3 X9\n[PRB:4.001,5.000,6.000:1]\nok\n";
    let (data, _) = read(4, &text(&format!("{two}M30\nok\n")), &plan, &WANTED).expect("a log");
    assert_eq!(data.numbers("X").expect("X"), [1.001, 4.001]);
    assert_eq!(data.numbers("feed").expect("feeds"), [50.0 / 60.0; 2]);
    for (body, expected) in [
        (two.to_owned(), "the log has no END"),
        (two.replace("ok\nN201 G38.3 X9\n", "") + "M2\n", "log.txt:8: an answer `[PRB:..]` to no probing move"),
        (two.replace("[PRB:4.001,5.000,6.000:1]\n", "") + "M2\n", "log.txt:9: 1 probing moves have no answer"),
        (two.replace("[PRB:4.001,5.000,6.000:1]", "[PRB:4.001,5.0"), "is no answer to a probing move"),
        (two.replace("[PRB:4.001,5.000,6.000:1]", "[PRB:4.001,5.000:1]") + "M2\n", "2 positions; 3 to 9 were expected"),
        (two.replace("N201", "N101") + "M2\n", "touch 1 (repeat 1) stands in line 8 already"),
        (two.replace("N201", "N200") + "M2\n", "the line number ends in 00"),
        (two.replacen("ok\nN201", "error:9\nN201", 1) + "M2\n", "log.txt:8: the control refused a line"),
        (two.replacen("ok\nN201", "ALARM:5\nN201", 1) + "M2\n", "the log has no END"),
        (format!("{two}(ABBE 1)\n{two}M2\n"), "a second log begins here"),
    ] {
        let told = refused(4, &text(&body), &plan);
        assert!(told.contains(expected), "{body}\n{told}");
    }
    assert!(refused(4, two, &plan).contains("`ABBE 1` was expected"));
}
