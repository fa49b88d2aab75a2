//! Plain text of Heidenhain: which text is written, what is refused, and where.

use super::*;

fn programs(machine: &Machine, text: &str, options: &Options) -> String {
    corrected(machine, text, options, 1.0).unwrap_or_else(|error| panic!("{error}\n{text}")).0
}

/// A program around blocks that know where the axes stand.
fn around(blocks: &str) -> String {
    format!("BEGIN PGM A MM\nTOOL CALL 5 Z S3000\nL X+0 Y+0 Z+50 R0 FMAX M3\n{blocks}END PGM A MM\n")
}

#[test]
fn three_axes_make_the_programmed_path() {
    for seed in seeds(1) {
        law("three-axis", Dialect::Heidenhain, false, seed);
    }
}

#[test]
fn five_axes_make_the_programmed_path() {
    for seed in seeds(1) {
        for name in ["table-table", "head-table"] {
            law(name, Dialect::Heidenhain, false, seed);
        }
    }
}

#[test]
fn programmed_tips_make_the_programmed_path() {
    for seed in seeds(1) {
        for name in ["table-table", "head-table"] {
            law(name, Dialect::Heidenhain, true, seed);
        }
    }
}

/// `heidenhain-refuse.h`, line by line: the end of its arc is off its circle.
#[test]
fn the_public_program_is_handled_up_to_its_arc() {
    let table = Machine::public("table-table");
    let text = public("heidenhain-refuse.h");
    let mut options = Options::new(Dialect::Heidenhain);
    refused(&table, &text, &options, 2, "the length of the tool 5 is not known");
    options.tools.only = Some(95.5);
    refused(&table, &text, &options, 5, "not known");
    (options.start, options.stays_at_tool_change) = ([Some(0.0); 9], true);
    refused(&table, &text, &options, 7, "off its circle by 8.0278 mm");
    // An end on the circle of radius 15 and 10 around (20, 20) that the tip at (10, 5) is on.
    let text = text.replace("C X+30 Y+20 DR+", "C X+35 Y+10 DR+");
    let of_tool = with_tool(&table, Some(95.5));
    let run = |text: &str| {
        let mut control = Control::new(&of_tool);
        control.length = 95.5;
        control.run_klartext(text)
    };
    let programmed = run(&text);
    let done = programs(&table, &text, &options);
    let off = worst(&of_tool, &programmed, &run(&done));
    assert!(off <= TOLERANCE, "{off}\n{done}");
    // The tip on the workpiece: the table has turned back.
    let (line, end) = (4, [10.0, 5.0, -5.0]);
    let block = programmed.iter().find(|block| block.line == line + 1).expect("a block");
    let at = block.path.last().expect("a position");
    assert!((at["A"] + 10.0).abs() < 1e-9 && (at["C"] - 15.0).abs() < 1e-9, "{at:?}");
    let zero = at.keys().map(|axis| (axis.clone(), 0.0)).collect::<ByAxis>();
    let [tip, origin] = [at, &zero].map(|at| tips(&of_tool, &[(at.clone(), ByAxis::new())], false)[0]);
    for axis in 0..3 {
        let length = if axis == 2 { 95.5 } else { 0.0 };
        assert!((tip[axis] - origin[axis] - length - end[axis]).abs() < 1e-9, "{tip:?} {origin:?}");
    }
}

/// What is not motion stays byte for byte, numbers run on, words that act at an end go there.
#[test]
fn text_stays_and_numbers_run_on() {
    let mill = Machine::public("three-axis");
    let mut options = options(Dialect::Heidenhain);
    (options.tolerance, options.decimals) = (1e-4, 5);
    let text = "0 BEGIN PGM A MM\r\n1 BLK FORM 0.1 Z X+0 Y+0 Z-20\r\n2 * - face\r\n\
                3 TOOL CALL \"MILL; 10\" Z S3000 DL+0.1 ; X99\r\n4 CYCL DEF 32.0 TOLERANCE\r\n5 CYCL DEF 32.1 T0.01\r\n\
                6 L  X+0 Y+0 Z+60 R0 FMAX M3 ; X99\r\n7 L Z+10 F500 M8\r\n8 L IX+150 Y+90 R0 F800 M9 ; far\r\n\
                9 CC X+150 Y+70\r\n10 C X+150 Y+50 DR- FMAX M5\r\n11 CR X+100 Y+50 R-30 DR+ R0 F300\r\n\
                12 CYCL DEF 247 DATUM SETTING ~\r\n     Q339=+1 ;DATUM NUMBER\r\n13 M30\r\n14 END PGM A MM\r\n";
    let done = programs(&mill, text, &options);
    let lines: Vec<&str> = done.split_terminator("\r\n").collect();
    assert!(lines[1].starts_with("1 ; abbe compensated: calibration 0123456789abcdef"), "{done}");
    for (line, was) in [(0, 0), (2, 1), (3, 2), (4, 3), (5, 4), (6, 5)] {
        let own = text.split("\r\n").nth(was).expect("a line").split_once(' ').expect("a number").1;
        assert_eq!(lines[line], format!("{line} {own}"));
    }
    assert!(lines[7].starts_with("7 L X") && lines[7].ends_with(" R0 FMAX M3 ; X99"), "{}", lines[7]);
    assert!(lines[8].starts_with("8 L X") && lines[8].ends_with(" F500 M8"), "{}", lines[8]);
    let feed = lines.iter().position(|line| line.contains("F800")).expect("a feed");
    let far: Vec<&str> = lines[feed..].iter().copied().take_while(|line| !line.contains(" CC ")).collect();
    assert!(far.len() > 1 && far[0].ends_with(" R0 F800 ; far") && far[far.len() - 1].ends_with(" M9"), "{far:?}");
    assert!(
        far[1..].iter().all(|line| line.contains(" L X+") && !line.contains(" R0") && !line.contains('F')),
        "{far:?}"
    );
    let at = |text: &str| lines.iter().position(|line| line.contains(text)).expect("it is there");
    let moves = |line: &&&str| [" L ", " C "].iter().any(|name| line.contains(name));
    let fast: Vec<&&str> = lines[at(" CC X+150 Y+70")..=at(" M5")].iter().filter(moves).collect();
    assert!(!fast.is_empty() && fast.iter().all(|line| line.contains(" FMAX")), "{fast:?}");
    assert_eq!(done.matches(" M5").count(), 1);
    assert!(done.contains("     Q339=+1 ;DATUM NUMBER\r\n"), "{done}");
    let last = lines.len() - 2;
    assert_eq!(lines[last + 1], format!("{last} END PGM A MM"));
    // Every line as the control counts: that of the interpreter, which refuses gaps.
    let lengths = |text: &str| {
        let of_tool = with_tool(&mill, Some(95.6));
        let mut control = Control::new(&of_tool);
        control.length = 95.6;
        let offset = [("X", 12.5), ("Y", -3.25), ("Z", 40.0)].map(|(axis, at)| (axis.to_owned(), at));
        control.offsets.insert("G54".to_owned(), offset.into());
        let text = text.replace("\"MILL; 10\"", "5").replace(" DL+0.1", "").replace("CYCL DEF 32", "CYCL DEF 7.0 ; ");
        // An arc in rapid traverse holds its path, too.
        let slow = |line: &str| if line.contains(" M3") { line.to_owned() } else { line.replace(" FMAX", "") };
        control.run_klartext(&text.lines().map(|line| slow(line) + "\n").collect::<String>())
    };
    let off = worst(&with_tool(&mill, Some(95.6)), &lengths(text), &lengths(&done));
    assert!(off <= TOLERANCE, "{off}\n{done}");
    // Without numbers there are none; a second correction is refused.
    let plain: String = text
        .lines()
        .map(|line| line.trim_start_matches(|byte: char| byte.is_ascii_digit()).to_owned() + "\n")
        .collect();
    assert!(
        programs(&mill, &plain, &options).lines().all(|line| !line.starts_with(|byte: char| byte.is_ascii_digit()))
    );
    refused(&mill, &done, &options, 2, "compensated already");
    options.dialect = Dialect::Iso;
    assert!(corrected(&mill, text, &options, 1.0).is_err());
}

/// Datum shifts, presets, machine positions, the plane of the tool axis.
#[test]
fn coordinates_are_followed() {
    let mill = with_tool(&Machine::public("three-axis"), Some(95.5));
    let mut options = options(Dialect::Heidenhain);
    options.offsets.insert(1, [-20.0, 7.0, 35.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let run = |text: &str, length: f64| {
        let own = with_tool(&mill, Some(length));
        let mut control = Control::new(&own);
        control.length = length;
        for (system, at) in [("G54", [12.5, -3.25, 40.0]), ("G55", [-20.0, 7.0, 35.0])] {
            control.offsets.insert(system.to_owned(), ["X", "Y", "Z"].map(str::to_owned).into_iter().zip(at).collect());
        }
        control.run_klartext(text)
    };
    let text = around(
        "L X+20 Y+10 Z+5 F500\nCYCL DEF 7.0 DATUM SHIFT\nCYCL DEF 7.1 X+30\nCYCL DEF 7.2 IY-4\nL X+40 IY+5\n\
         CC IX+10 IY+0\nC IX+20 IY+0 DR+\nCYCL DEF 247 DATUM SETTING ~\n  Q339=+2 ;DATUM NUMBER\n\
         L X+50 Y+20\nCC\nL IX+12\nC IX-24 IY+0 DR-\n",
    );
    let done = programs(&mill, &text, &options);
    let off = worst(&mill, &run(&text, 95.5), &run(&done, 95.5));
    assert!(off <= TOLERANCE, "{off}\n{done}");
    // M91 stays, and what comes after starts there.
    let text = around("L Z+200 R0 FMAX M91\nL X+10 Y+10 R0 FMAX\nL Z+5 F500\n");
    let done = programs(&mill, &text, &options);
    assert!(done.contains("\nL Z+200 R0 FMAX M91\n"), "{done}");
    let last = |blocks: Vec<Block>| blocks[2..].to_vec();
    let off = worst(&mill, &last(run(&text, 95.5)), &last(run(&done, 95.5)));
    assert!(off <= TOLERANCE, "{off}\n{done}");
    assert!((run(&text, 95.5)[1].path.last().expect("a place")["Z"] - 200.0).abs() < 1e-9);
    // After M92 the position is not known.
    refused(&mill, &around("L Z+200 FMAX M92\nL X+10 F500\n"), &options, 5, "the position of Z");
    // Other planes: the machine of the calibration has its tool along Z.
    refused(&mill, &around("TOOL CALL 6 Y S500\n"), &options, 4, "a tool along Y");
    options.tools.only = Some(0.0);
    for (axis, arc) in [("Y", "CC Z+50 X+20\nC Z+70 X+20 DR-\n"), ("X", "CC Y+20 Z+50\nC Y+20 Z+70 DR+\n")] {
        let text = around(&format!("TOOL CALL 6 {axis} S500\nL X+10 Y+10 Z+50 R0 FMAX\nL X+0 Y+0 F500\n{arc}"));
        let done = programs(&mill, &text, &options);
        let of_tool = with_tool(&mill, Some(0.0));
        let off = worst(&of_tool, &run(&text, 0.0), &run(&done, 0.0));
        assert!(off <= TOLERANCE, "{off}\n{done}");
    }
}

/// What is not followed is refused by line, column and word.
#[test]
fn constructs_that_are_not_followed_are_refused() {
    let table = Machine::public("table-table");
    let mut options = options(Dialect::Heidenhain);
    for (block, word) in [
        ("L X+10 Y+10 RL F500", "`RL`"),
        ("L X+10 RR", "`RR`"),
        ("X+10 R0", "`X+10`"),
        ("L X+Q5", "`X+Q5`"),
        ("Q5 = +3", "`Q`"),
        ("FN 0: Q5 = +3", "`FN`"),
        ("LBL 1", "`LBL`"),
        ("CALL LBL 1 REP2", "`CALL LBL`"),
        ("CYCL CALL", "`CYCL CALL`"),
        ("CYCL DEF 200 DRILLING ~", "`CYCL DEF`"),
        // What goes on in the next line would not be read.
        ("L X+10 ~\n  Y+10 F500", "`~`"),
        ("L X+10 ; to the end ~", "`~`"),
        ("CC X+1 ~\nY+2", "`~`"),
        ("M3 ~\nM8", "`~`"),
        ("TOOL CALL 5 Z ~\nDL+1", "`~`"),
        ("CYCL DEF 10.0 ROTATION", "`CYCL DEF 10`"),
        ("CYCL DEF 8.0 MIRROR IMAGE", "`CYCL DEF 8`"),
        ("CYCL DEF 19.0 WORKING PLANE", "`CYCL DEF 19`"),
        ("CYCL DEF 7.1 #5", "`#5`"),
        ("CYCL DEF 7.1 C+5", "`C5`"),
        ("CYCL DEF 247 Q339=+12", "`Q339=+12`"),
        ("PLANE SPATIAL SPA+0 SPB+45 SPC+0 STAY", "`PLANE`"),
        ("TCH PROBE 4.0 MEASURING IN 3-D", "`TCH PROBE`"),
        ("CT X+10 Y+10", "`CT`"),
        ("RND R5", "`RND`"),
        ("CHF 2", "`CHF`"),
        ("APPR LT X+5 LEN5 RL", "`APPR`"),
        ("DEP LT LEN5", "`DEP`"),
        ("LP PR+10 PA+30", "`LP`"),
        ("CP IPA+720 IZ-5 DR+", "`CP`"),
        ("FPOL X+5 Y+5", "`FPOL`"),
        ("SPL X+5 Y+5", "`SPL`"),
        ("LN X+5 TX+0 TY+0 TZ+1", "`LN`"),
        ("L X+10 M99", "`M99`"),
        ("L X+10 M89", "`M89`"),
        ("L X+10 M114", "`M114`"),
        ("M140 MB50", "`MB50`"),
        ("M119", "`M119`"),
        ("L IX+10 FMAX M91", "`X10`"),
        ("C X+10 Y+0 DR+", "an arc without a centre"),
        ("CC X+5", "`CC`"),
        ("CC X+5 Z+5", "`Z5`"),
        ("CR X+10 Y+0 R+2 DR+", "`R2`"),
        ("CR X+10 Y+0 R+20", "without a sense"),
        ("CR X+10 Y+0 DR+", "without a radius"),
        ("CR X+10 Y+0 Z+5 R+20 DR+", "`Z5`"),
        ("L X+5 IX+3", "twice"),
        ("L X+5 FT3", "`FT3`"),
        ("L X+5,5", "`X+5,5`"),
        ("FUNCTION TCPM F TCP AXIS SPAT PATHCTRL AXIS", "`AXIS`"),
        ("FUNCTION TCPM F TCP AXIS POS PATHCTRL VECTOR", "`PATHCTRL`"),
        ("FUNCTION TCPM F TCP", "is not said"),
        ("TOOL DEF 3 L+80 R+5", "`TOOL DEF`"),
        ("TOOL CALL 3 Z S+Q1", "`S+Q1`"),
        ("/ L X+5", "`/`"),
        ("NONSENSE", "`NONSENSE`"),
    ] {
        let text = around(&format!("{block}\n"));
        refused(&table, &text, &options, 4, word);
        refused(&table, &text.replace("\n", "\r\n"), &options, 4, word);
    }
    for (blocks, line, word) in [
        ("M128\nL Z+100 FMAX M91\n", 5, "`Z100`"),
        ("M128\nTOOL CALL 6 Z\n", 5, "`TOOL CALL`"),
        ("M128\nFUNCTION RESET TCPM\n", 5, "another function"),
        ("FUNCTION TCPM F TCP AXIS POS PATHCTRL AXIS\nM129\n", 5, "`M129`"),
        ("CC X+5 Y+0\nM128\nC X+10 Y+0 DR+\n", 6, "without a centre"),
        ("CC X+50 Y+0\nC X+10 Y+0 DR+\n", 5, "off its circle by 10"),
    ] {
        refused(&table, &around(blocks), &options, line, word);
    }
    refused(&table, "L X+5\n", &options, 1, "BEGIN PGM");
    refused(&table, &format!("{}{}", around("M30\n"), around("")), &options, 6, "after the end of the program");
    refused(&table, "BEGIN PGM A\n", &options, 1, "without a unit");
    (options.tools.only, options.tools.by_number) = (None, [(5, 95.5)].into());
    for (call, says) in
        [("TOOL CALL \"MILL\" Z", "names"), ("TOOL CALL 5.1 Z", "step"), ("TOOL CALL 6 Z", "tool 6 is not known")]
    {
        refused(&table, &around(&format!("{call}\n")), &options, 4, says);
    }
    let switched = around("L X+10 A+5 F500\n/L X+20\nM2\nQ5 = 3\n");
    options.block_delete = Some(true);
    assert!(programs(&table, &switched, &options).contains("\n/L X+20\nM2\nQ5 = 3\n"));
    options.block_delete = Some(false);
    let done = programs(&table, &switched, &options);
    assert!(done.contains("\n/L X") && !done.contains("\n/L X+20\n") && !done.contains("\nL X+20"), "{done}");
}

/// As users do it: corrected and checked; 5 µm in one number are found by their line.
#[test]
fn corrected_plain_text_is_checked() {
    let folder = temporary();
    let at = folder.path();
    write(&at.join("fit.calibration.json"), &calibration("three-axis").to_string());
    let text = "0 BEGIN PGM A MM\n1 TOOL CALL 5 Z S3000\n2 L X+0 Y+0 Z+50 R0 FMAX M3\n3 L Z-5 F500\n4 L X+120 Y+80\n\
                5 CC X+120 Y+60\n6 C X+120 Y+40 DR-\n7 L X+0\n8 CC X+0 Y+20\n9 C X+0 Y+0 DR+ FMAX\n10 M30\n11 END PGM A MM\n";
    write(&at.join("part.h"), text);
    let run = |out: &str| {
        let fixed = ["compensate", "fit.calibration.json", "part.h", "--dialect", "heidenhain", "--out", out];
        abbe(at, &[&fixed[..], &["--tool-length-mm", "95.5", "--check", "--json"]].concat())
    };
    let done = run("new.h");
    assert_eq!(done.status, 0, "{}{}", done.stdout, done.stderr);
    let text = read(&at.join("new.h"));
    let lines: Vec<&str> = text.lines().collect();
    let mut found = 0;
    for (index, line) in lines.iter().enumerate().filter(|(_, line)| line.contains(" L ") && !line.contains("FMAX")) {
        let place = line.find('Y').expect("it is there") + 1;
        let end = line[place..].find(' ').map_or(line.len(), |end| place + end);
        let number: f64 = line[place..end].parse().expect("a number");
        let wrong = format!("{}{:+.4}{}", &line[..place], number + 0.005, &line[end..]);
        let file = format!("wrong-{index}.h");
        write(&at.join(&file), &(text.replace(line, &wrong)));
        let checked = run(&file);
        if checked.stderr.contains("off its circle") {
            continue;
        }
        assert_eq!(checked.status, 3, "{wrong}: {}{}", checked.stdout, checked.stderr);
        let json: serde_json::Value = serde_json::from_str(&checked.stdout).expect("JSON");
        let worst = json["check"]["path"]["line"].as_u64().expect("a line") as usize;
        assert!(worst == index + 1 || worst == index + 2, "line {worst} for {}", index + 1);
        found += 1;
        if found > 5 {
            break;
        }
    }
    assert!(found > 2, "{found}");
}
