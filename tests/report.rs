//! The page about a run, and the summary on the terminal, as users get them.

use std::path::Path;

use serde_json::{Value, json};

use crate::support::{Small, as_typed, program, read, recipes, root, temporary, write};

/// Recipes that show most of what a page can have, and are quick.
const SHOWN: [&str; 4] = ["tango-hu40t", "ballbar-c600u", "tango-warming", "cylinder-kx8"];

fn run(recipe: &Path, out: &Path) -> String {
    let arguments = ["run".as_ref(), recipe.as_os_str(), "--out".as_ref(), out.as_os_str()];
    let printed = as_typed(&root(), &arguments);
    assert_eq!(printed.status, 0, "{}{}", printed.stdout, printed.stderr);
    printed.stdout
}

#[test]
fn pages_are_small_and_come_back_from_their_folders() {
    let out = temporary();
    for name in SHOWN {
        let file = recipes()[name].clone();
        let file = file.strip_prefix(root()).expect("a recipe of the workspace");
        let summary = run(file, out.path());
        assert!(summary.lines().count() <= 30, "{name}: {summary}");
        assert!(summary.lines().all(|line| line.chars().count() <= 120 || line.contains('/')), "{name}: {summary}");
        let first = summary.lines().next().expect("a line");
        assert!(
            ["PASS: ", "MACHINE NOT JUDGED: ", "FAIL: ", "NO LIMIT SET: "].iter().any(|word| first.starts_with(word)),
            "{first}"
        );
        let folder = out.path().join(name);
        let page = read(&folder.join("report.html"));
        assert!(page.len() < 3_000_000, "{name}: {} bytes", page.len());
        let again = out.path().join(format!("{name}.html"));
        let arguments = ["report".as_ref(), folder.as_os_str(), "--out".as_ref(), again.as_os_str()];
        let printed = as_typed(&root(), &arguments);
        assert_eq!((printed.status, printed.stderr.as_str()), (0, ""), "{name}");
        assert!(read(&again) == page, "{name}: the page from the folder differs");
        // Nothing from elsewhere: no address but those of namespaces, no attribute that loads.
        for asks in ["http://", "https://", " src=", "@import", "url(", "<link", "<iframe", "fetch("] {
            assert!(!page.contains(asks), "{name}: {asks}");
        }
        for part in ["verdict", "causes", "untold", "parameters", "residuals", "figures", "provenance"] {
            assert!(page.contains(&format!("<section id=\"{part}\">")), "{name}: {part}");
        }
    }
}

#[test]
fn the_page_does_not_say_when_the_run_was() {
    let small = Small::new();
    let pages = ["one", "two"].map(|out| {
        assert_eq!(small.abbe(&["run", "recipe.yaml", "--out", out]).status, 0);
        small.read(&format!("{out}/recipe/report.html"))
    });
    assert!(pages[0] == pages[1]);
}

/// What stands in files shows as text, in the page and in the summary.
#[test]
fn nothing_from_files_becomes_markup() {
    let small = Small::new();
    let recipe = small.read("recipe.yaml").replace("name: Eight facets", "name: '<script>alert(1)</script>\"&'");
    // A feature is a label of the data.
    let hostile = "<img src=x onerror=alert(2)>";
    let data = small.read("data/touches.csv").lines().enumerate().fold(String::new(), |text, (at, line)| {
        text + &if at == 0 {
            format!("{line},remark\n")
        } else {
            format!("{line},{}\n", if at % 2 == 0 { hostile } else { "b" })
        }
    });
    small.write("data/touches.csv", &data);
    small.write("recipe.yaml", &recipe);
    let printed = small.abbe(&["run", "recipe.yaml", "--out", "out"]);
    assert_eq!(printed.status, 0, "{}{}", printed.stdout, printed.stderr);
    let page = small.read("out/recipe/report.html");
    assert!(page.contains("&lt;script&gt;alert(1)&lt;/script&gt;"));
    assert!(page.contains("&lt;img src=x onerror"));
    assert!(!page.contains("<script>alert") && !page.contains("<img"));
}

#[test]
fn several_runs_and_a_calibration_stand_beside_each_other() {
    let small = Small::new();
    assert_eq!(small.abbe(&["run", "recipe.yaml", "--out", "before"]).status, 0);
    let better = small.read("recipe.yaml").replace("max_um: 1000", "max_um: 0.001");
    small.write("recipe.yaml", &better);
    assert_eq!(small.abbe(&["run", "recipe.yaml", "--out", "after"]).status, 3);
    let printed = small.abbe(&["report", "before/recipe", "after/recipe", "before/recipe/fine.calibration.json"]);
    assert_eq!((printed.status, printed.stdout.as_str()), (0, "Written: report.html\n"), "{}", printed.stderr);
    let page = small.read("report.html");
    for part in
        ["Beside each other", "before/recipe: fine", "after/recipe: fine", "Fail", "Machine not judged", "No limit set"]
    {
        assert!(page.contains(part), "{part}");
    }
    // The text of the first recipe is gone.
    assert!(page.contains("The recipe is not there any more as it was"));
    let printed = small.abbe(&["report", "before/recipe"]);
    assert_eq!(printed.status, 1);
    assert!(printed.stderr.contains("report.html is there already; it is not replaced"), "{}", printed.stderr);
}

#[test]
fn what_is_no_result_is_refused() {
    let small = Small::new();
    let told = |arguments: &[&str], part: &str| {
        let printed = small.abbe(arguments);
        assert_ne!(printed.status, 0, "{arguments:?}");
        assert!(printed.stderr.contains(part), "{arguments:?}: {}", printed.stderr);
    };
    told(&["report", "data"], "data is no folder with the results of a run");
    told(&["report", "nowhere.json"], "the file cannot be read");
    told(&["report", "recipe.yaml"], "this is not a JSON file");
    assert_eq!(small.abbe(&["run", "recipe.yaml"]).status, 0);
    small.write("out/recipe/fine.residuals.csv", "a,b\n");
    told(&["report", "out/recipe"], "fine.residuals.csv: the file is not as the run wrote it");
}

/// Tools have no rows: their outliers and what is locked are told all the same.
#[test]
fn outliers_and_locks_of_tools_are_told() {
    let out = temporary();
    let summary = run(Path::new("pipelines/tool-check.yaml"), out.path());
    assert!(summary.contains("locked: 3 (worn, session 14), 5 (broken, session 9)"), "{summary}");
    // A value has the digits of its uncertainty, a figure of the summary says which it is.
    assert!(summary.contains("17.0 ± 2.8 µm (k = 2), limit 30.00 µm"), "{summary}");
    let page = read(&out.path().join("tool-check/report.html"));
    let residuals = page.split("<section id=\"residuals\">").nth(1).expect("residuals");
    let residuals = residuals.split("</section>").next().expect("its end");
    let calibration: Value =
        serde_json::from_str(&read(&out.path().join("tool-check/tools.calibration.json"))).expect("JSON");
    let outliers = calibration["outliers"].as_array().expect("a list");
    assert!(!outliers.is_empty());
    for outlier in outliers {
        let place =
            format!("{}:{} (row {})", outlier["file"].as_str().expect("a file"), outlier["line"], outlier["row"]);
        assert!(residuals.contains(&place), "{place}");
    }
}

/// What was predicted without its fold stands beside what the whole fit left of the same rows.
#[test]
fn held_out_rows_have_a_chart() {
    let out = temporary();
    run(Path::new("pipelines/tango-hu40t.yaml"), out.path());
    let folder = out.path().join("tango-hu40t");
    let page = read(&folder.join("report.html"));
    let verdicts: Value = serde_json::from_str(&read(&folder.join("verdicts.json"))).expect("JSON");
    let verdicts = verdicts.get("verdicts").unwrap_or(&verdicts).as_array().expect("a list").clone();
    let unseen = verdicts.iter().find(|verdict| verdict["stage"] == "unseen").expect("a hold-out");
    let figures = unseen["figures"].as_array().expect("a list");
    let groups = figures.iter().filter(|figure| figure["of"] == "fit-S4r");
    let groups: Vec<&str> = groups.filter_map(|figure| figure["name"].as_str()?.strip_prefix("rms[group=")).collect();
    assert!(!groups.is_empty());
    let chart = page.split("aria-label=\"Predicted rows of fit-S4r by group, unseen\"").nth(1).expect("a chart");
    let chart = chart.split("</svg>").next().expect("its end");
    for group in groups {
        let label = group.trim_end_matches(']');
        assert!(chart.contains(&format!(">{label}</text>")), "{label}");
        assert!(chart.contains(&format!("<title>{label}: ")), "{label} has no residuals");
    }
}

/// The name of the file says what is written.
#[test]
fn a_report_is_markdown_or_a_table_as_its_name_says() {
    let small = Small::new();
    assert_eq!(small.abbe(&["run", "recipe.yaml", "--out", "one"]).status, 0);
    let moved = small.read("recipe.yaml").replace("max_um: 1000", "max_um: 0.001");
    small.write("recipe.yaml", &moved);
    assert_eq!(small.abbe(&["run", "recipe.yaml", "--out", "two"]).status, 3);
    let report = |more: &[&str]| {
        let printed = small.abbe(&[&["report"], more].concat());
        assert_eq!((printed.status, printed.stderr.as_str()), (0, ""), "{more:?}");
    };
    report(&["one/recipe", "--out", "one.md"]);
    insta::assert_snapshot!("markdown", rounded(&small.read("one.md")));
    report(&["one/recipe", "two/recipe", "--out", "both.md"]);
    let both = small.read("both.md");
    assert!(both.starts_with("# 2 calibrations beside each other\n"), "{both}");
    assert!(both.contains("## ✗ Fail: Eight facets (two/recipe)"), "{both}");
    report(&["one/recipe", "two/recipe", "--out", "both.csv"]);
    let table = small.read("both.csv");
    let header = "run,kind,of,stage,name,value,unit,standard_uncertainty,limit,status";
    assert_eq!(table.lines().next(), Some(header));
    // Every parameter with all its digits, and every figure.
    let calibration: Value = serde_json::from_str(&small.read("one/recipe/fine.calibration.json")).expect("JSON");
    for known in calibration["parameters"].as_array().expect("a list") {
        let value = known["value"].as_f64().expect("a number");
        let begin = format!("one/recipe,parameter,fine,,{},", known["name"].as_str().expect("a name"));
        let row = table.lines().find_map(|line| line.strip_prefix(&begin)).expect(&begin);
        assert_eq!(row.split(',').next().and_then(|text| text.parse().ok()), Some(value), "{begin}{row}");
    }
    assert!(table.lines().any(|line| line.starts_with("two/recipe,figure,") && line.ends_with(",fail")), "{table}");
    // Others may read it, as any new file.
    let permissions = |name: &str| small.folder.path().join(name).metadata().expect("a file").permissions();
    small.write("any.txt", "");
    assert_eq!(permissions("both.csv"), permissions("any.txt"));
    // What is there stays, and a name that says nothing is refused before anything is read.
    assert_eq!(small.abbe(&["report", "one/recipe", "--out", "both.csv"]).status, 1);
    let printed = small.abbe(&["report", "nowhere", "--out", "report.txt"]);
    assert_eq!(printed.status, 2);
    assert!(printed.stderr.contains("end it with .html, .pdf, .md (Markdown) or .csv"), "{}", printed.stderr);
}

/// A browser that is not there, or that is none, is told.
#[test]
fn a_browser_that_prints_nothing_is_told() {
    let small = Small::new();
    assert_eq!(small.abbe(&["run", "recipe.yaml"]).status, 0);
    for (browser, status, part) in [
        ("no-such-browser", 2, "the browser `no-such-browser` does not start"),
        ("true", 1, "the browser `true` printed no page"),
    ] {
        let mut command = program(small.folder.path(), &["report", "out/recipe", "--out", "page.pdf"]);
        let output = command.env("ABBE_BROWSER", browser).output().expect("it runs");
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(status), "{said}");
        assert!(said.contains(part) && said.contains("ABBE_BROWSER"), "{said}");
        assert!(!small.folder.path().join("page.pdf").exists());
    }
}

/// Runs of several weeks: what changed is told with its uncertainty, in one travel.
#[test]
fn weeks_beside_each_other_have_a_history() {
    let folder = temporary();
    let weeks = [1e-5, 1e-5, 2e-4];
    let mut arguments: Vec<std::ffi::OsString> = vec!["report".into()];
    for (week, squareness) in weeks.into_iter().enumerate() {
        let out = folder.path().join(format!("week-{week}"));
        simulated_into(&out, &json!({ "EC0Y": squareness, "EXX[b]": 1e-3 }), 7 + week as u64, |recipe| recipe);
        arguments.push(out.join("first-steps").into());
    }
    let page = folder.path().join("weeks.html");
    arguments.extend(["--out".into(), page.clone().into()]);
    let printed = as_typed(&root(), &arguments);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    let page = read(&page);
    let history = page.split("<section id=\"history\">").nth(1).expect("a history");
    let history = history.split("</section>").next().expect("its end");
    let first =
        history.split("over its uncertainty").nth(1).and_then(|rest| rest.split("</tr>").nth(1)).expect("a row");
    assert!(first.contains(">EC0Y µrad<"), "{first}");
    assert!(history.contains("Volumetric errors in one travel"), "{history}");
    // Calibrations of many weeks have no more viewers than a browser shows.
    let many = folder.path().join("many.html");
    let week = folder.path().join("week-0/first-steps");
    let mut arguments: Vec<std::ffi::OsString> = vec!["report".into()];
    arguments.extend((0..10).map(|_| week.clone().into()));
    arguments.extend(["--out".into(), many.clone().into()]);
    assert_eq!(as_typed(&root(), &arguments).status, 0);
    let many = read(&many);
    assert_eq!((many.matches("class=\"viewer\"").count(), many.matches("class=\"views\"").count()), (8, 10));
    assert_eq!(page.matches("class=\"viewer\"").count(), 3);
    for number in 1..=3 {
        assert!(page.contains(&format!("<section id=\"{number}-scene\">")), "{number}");
    }
}

/// The summary shortens; the whole text is there on demand.
#[test]
fn verbose_prints_all() {
    let small = Small::new();
    let brief = as_typed(small.folder.path(), &["run", "recipe.yaml"]).stdout;
    let whole = small.abbe(&["run", "recipe.yaml"]).stdout;
    assert!(
        brief.starts_with("MACHINE NOT JUDGED: Eight facets\n") && brief.contains("Report: out/recipe/report.html\n"),
        "{brief}"
    );
    assert!(whole.starts_with("Eight facets\n") && whole.contains("Estimated parameters"), "{whole}");
    insta::assert_snapshot!("brief_summary", rounded(&brief));
}

/// Numbers with three digits: others are those of the computer.
fn rounded(text: &str) -> String {
    let word = |word: &str| match word.trim_end_matches(',').trim_matches('*').parse::<f64>() {
        Ok(number) if word.contains('.') => format!("{number:.2e}"),
        _ => word.to_owned(),
    };
    text.lines().map(|line| line.split(' ').map(word).collect::<Vec<_>>().join(" ") + "\n").collect()
}

/// The machine of the first steps with these errors, as a virtual machine measures it; gives page and summary.
fn simulated(parameters: &Value, seed: u64, change: impl Fn(String) -> String) -> (String, String) {
    let folder = temporary();
    let summary = simulated_into(folder.path(), parameters, seed, change);
    (read(&folder.path().join("first-steps/report.html")), summary)
}

/// The same, with its results in a folder; gives the summary.
fn simulated_into(results: &Path, parameters: &Value, seed: u64, change: impl Fn(String) -> String) -> String {
    let folder = temporary();
    let truth = json!({ "parameters": parameters, "noise": { "probing_sigma_mm": 0.0006, "surface_sigma_mm": { "table": 0.0015 } } });
    write(&folder.path().join("truth.json"), &truth.to_string());
    let recipe = recipes()["first-steps"].clone();
    let (out, seed) = (folder.path().join("out"), seed.to_string());
    let truth = folder.path().join("truth.json");
    let arguments: [&std::ffi::OsStr; 8] = [
        "simulate".as_ref(),
        recipe.as_ref(),
        "--truth".as_ref(),
        truth.as_ref(),
        "--seed".as_ref(),
        seed.as_ref(),
        "--out".as_ref(),
        out.as_ref(),
    ];
    let printed = as_typed(&root(), &arguments);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    let recipe = out.join("first-steps.yaml");
    write(&recipe, &change(read(&recipe)));
    run(&recipe, results)
}

/// The first row of the table of causes.
fn first_cause(page: &str) -> &str {
    let causes = page.split("<h3>The largest causes</h3>").nth(1).expect("causes");
    let row = causes.split("<tbody>\n<tr>").nth(1).expect("a table");
    row.split("</tr>").next().expect("a row")
}

/// Somebody who reads nothing but the page: what is wrong with this machine, and what is to be done?
#[test]
fn the_page_says_what_is_wrong_and_what_to_do() {
    for seed in [1, 2, 3] {
        let (page, summary) = simulated(&json!({ "EC0Y": 4e-4, "EXX[b]": 1e-3 }), seed, |recipe| recipe);
        let row = first_cause(&page);
        assert!(row.contains(">EC0Y<") && row.contains("Y out of square, turned about Z"), "{seed}: {row}");
        assert!(row.contains("squareness compensation") && !row.contains("not proven"), "{seed}: {row}");
        assert!(summary.contains("without EC0Y"), "{summary}");
        // Its only limits are those of residuals: that is no verdict on the machine.
        let verdict = page.split("<section id=\"verdict\">").nth(1).expect("a verdict");
        let verdict = verdict.split("</section>").next().expect("its end");
        assert!(verdict.contains("Machine not judged") && !verdict.contains("✓"), "{verdict}");
        assert!(verdict.contains("none judges the machine") && verdict.contains("first of all EC0Y"), "{verdict}");
        assert!(summary.starts_with("MACHINE NOT JUDGED: "), "{summary}");

        let (page, summary) = simulated(&json!({ "EC0Y": 1e-5, "EXX[b]": 0.06 }), seed, |recipe| recipe);
        let row = first_cause(&page);
        assert!(row.contains(">EXX[b]<") && row.contains("lost motion (backlash) of X"), "{seed}: {row}");
        assert!(row.contains("backlash compensation") && row.contains("µm at reversal (2 × "), "{seed}: {row}");
        assert!(summary.contains("lost motion (backlash) of X at reversal"), "{summary}");

        // A scale without a length: the plan is wrong, and a length is to be measured.
        let confounded = |recipe: String| {
            let free = recipe.replace("\"EYY[1]\", \"EZZ[1]\"", "\"E??[1]\"");
            free.replace("robust: tukey", "on_confounded: minimum-norm")
        };
        let (page, summary) = simulated(&json!({ "EC0Y": 1e-5 }), seed, confounded);
        let untold = page
            .split("<section id=\"untold\">")
            .nth(1)
            .expect("a section")
            .split("</section>")
            .next()
            .expect("its end");
        assert!(untold.contains("EXX[1]") && untold.contains("<b>To do:</b> measure"), "{seed}: {untold}");
        assert!(summary.contains("Not determined") && summary.contains("measure a calibrated length"), "{summary}");
    }
}

/// A good machine has no cause that is larger than a few micrometres.
#[test]
fn a_good_machine_has_small_causes() {
    let (page, summary) = simulated(&json!({ "EC0Y": 1e-6 }), 5, |recipe| recipe);
    assert!(page.contains("Machine not judged") && page.contains("a correction would gain nothing"));
    let rms = summary.split("RMS ").nth(1).and_then(|rest| rest.split(' ').next()).expect("an RMS");
    assert!(rms.parse::<f64>().expect("a number") < 5.0, "{summary}");
}
