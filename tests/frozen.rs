//! Files of every format number, written by the program that introduced the number. They stay readable with the same meaning.

use std::path::PathBuf;

use abbe_core::{
    CALIBRATION_FORMAT, Calibration, Error, Kind, Outlier, SelectionDirection, Status, Termination, VERDICTS_FORMAT,
    Verdict,
};
use abbe_engine::{RUN_FORMAT, RunRecord, model_of, prepare};
use serde_json::{Value, json};

use crate::plugins::valid;
use crate::support::{files_in, fit, json_file, read, registry, root, stem};

fn folder() -> PathBuf {
    root().join("tests/frozen")
}

fn text(name: &str) -> String {
    read(&folder().join(name))
}

fn calibration(name: &str) -> Calibration {
    Calibration::from_json(&text(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

/// Value, standard uncertainty and status.
fn told(calibration: &Calibration, name: &str) -> (f64, f64, Status) {
    let found = calibration.get(name).unwrap_or_else(|| panic!("no {name}"));
    (found.value, found.standard_uncertainty, found.status)
}

#[test]
fn a_calibration_of_format_1_is_read() {
    let robust = calibration("calibration-1.json");
    assert_eq!((robust.estimate.as_str(), robust.model.plugin.as_str()), ("robust", "serial-chain"));
    assert_eq!(told(&robust, "EC0Y"), (0.000015685523955595094, 1.9172183295465556e-6, Status::Estimated));
    assert_eq!(told(&robust, "dxt"), (0.0, 0.0, Status::Confounded));
    assert_eq!(told(&robust, "ECY[1]"), (0.0, 0.0, Status::Fixed));
    assert_eq!(told(&robust, "bar.expansion_coefficient"), (0.0000115, 1e-6, Status::Considered));
    assert_eq!(robust.get("EBX[3]").map(|found| found.unit.as_str()), Some("rad/mm^3"));
    assert_eq!((robust.parameters.len(), robust.artefacts.len(), robust.covariance.order.len()), (20, 3, 8));
    assert_eq!(robust.covariance.rows[1][5], 3.600065796602046e-10);
    let outlier = Outlier {
        stage: "bar".to_owned(),
        file: "recipe-1/lengths.csv".to_owned(),
        line: 8,
        row: 7,
        residual_um: 78.43927455178346,
        weight: 0.0,
    };
    assert_eq!((robust.outliers.len(), &robust.outliers[0]), (2, &outlier));
    let fit = &robust.fit;
    assert_eq!((fit.observations, fit.unknowns, fit.rank, fit.degrees_of_freedom), (30, 6, 5, 25));
    assert_eq!((fit.sigma, fit.iterations, fit.termination), (0.9557684235728441, 24, Termination::Converged));
    assert_eq!((fit.residual_rms_um, fit.residual_rms_urad), (0.8333131023692358, None));
    assert_eq!(fit.null_space[0].describe(), "dxt has no effect on these measurements");
    assert_eq!(fit.weakest[0].singular_value, 0.01437616033396642);
    assert_eq!(
        fit.equivalent_motion_errors[0].describe(),
        "1 µrad of ECY moves the tip as 0.04 µm of EYY does at every recorded pose: ECY not being estimated, the values of the \
         others contain it"
    );
    let budget = robust.uncertainty.as_ref().expect("a budget");
    assert_eq!((budget.coverage_probability, budget.scale, budget.joint.quantities), (0.95, fit.sigma, 5));
    let of_eyy = budget.parameters.iter().find(|parameter| parameter.name == "EYY[1]").expect("EYY[1]");
    assert_eq!((of_eyy.contributions.len(), of_eyy.standard_uncertainty), (4, 2.3554003765524133e-6));
}

#[test]
fn a_selection_and_trials_of_format_1_are_read() {
    let selected = calibration("calibration-1-selected.json");
    let selection = selected.fit.selection.as_ref().expect("a selection");
    assert_eq!((&selection.kept, &selection.left_out), (&vec!["EXX[2]".to_owned()], &vec!["EYY[2]".to_owned()]));
    assert_eq!((selection.direction, selection.level), (SelectionDirection::Backward, 0.001));
    assert_eq!((selection.steps[0].entered, selection.steps[0].probability), (false, 0.47041321176572204));
    assert_eq!(told(&selected, "ECY[2]"), (1.0229836829836826e-10, 7.151790034316843e-12, Status::Considered));

    let trials = calibration("calibration-1-trials.json");
    let found = trials.monte_carlo.as_ref().expect("trials");
    assert_eq!((found.trials, found.seed, found.failed, found.stable), (2000, 1, 0, None));
    let of_ecy = &found.parameters[0];
    assert_eq!((of_ecy.name.as_str(), of_ecy.degrees_of_freedom), ("ECY[1]", Some(8.0)));
    assert_eq!(of_ecy.shortest_interval, [3.1357148521201926e-8, 4.594928069451029e-8]);
    assert_eq!(of_ecy.gum.as_ref().map(|gum| (gum.tolerance, gum.validated)), Some((5e-10, false)));
    assert_eq!(trials.fit.residual_rms_urad, Some(0.44662914449274255));
    assert_eq!(trials.uncertainty, None);
}

#[test]
fn verdicts_of_format_1_are_read() {
    let verdicts = Verdict::list_from_json(&text("verdicts-1.json")).unwrap_or_else(|error| panic!("{error}"));
    let told: Vec<(&str, &str, bool)> =
        verdicts.iter().map(|verdict| (verdict.stage.as_str(), verdict.plugin.as_str(), verdict.pass)).collect();
    let expected = [
        ("residuals", "residuals", true),
        ("too-good", "residuals", false),
        ("unseen", "hold-out", true),
        ("effects", "influence", true),
    ];
    assert_eq!(told, expected);
    let figure = |verdict: usize, name: &str| {
        verdicts[verdict].figures.iter().find(|figure| figure.name == name).unwrap_or_else(|| panic!("no {name}"))
    };
    let max = figure(0, "max");
    assert_eq!((max.of.as_deref(), max.value, max.limit), (Some("robust"), Some(1.7928862730229866), Some(10.0)));
    assert_eq!((max.unit.as_str(), max.detail, max.passes()), ("um", false, true));
    assert!(figure(0, "rms[group=1]").detail);
    let rms = figure(1, "rms");
    assert_eq!((rms.value, rms.limit, rms.passes()), (Some(0.8835439782307696), Some(0.01), false));
    assert_eq!(
        verdicts[0].remarks,
        ["robust: largest rms: group 1 (1.0 µm)", "selected: largest rms: group 1 (1.0 µm)"]
    );
    assert!(verdicts[1].remarks.is_empty());
}

#[test]
fn the_record_of_a_run_of_format_1_is_read() {
    let run = RunRecord::from_json(&text("run-1.json")).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!((run.version.as_str(), run.recipe.as_str(), run.started_unix_s), ("0.1.0", "recipe-1", 1795316816));
    assert_eq!((run.inputs.len(), run.inputs[0].file.as_str()), (3, "recipe-1.yaml"));
    assert_eq!(run.inputs[1].sha256.len(), 64);
    let last = run.plugins.last().expect("plugins");
    assert_eq!((last.kind, last.name.as_str(), last.origin.as_str()), (Kind::Validate, "influence", "built-in"));

    let run = RunRecord::from_json(&text("run-1-library.json")).unwrap_or_else(|error| panic!("{error}"));
    let vendor = run.plugins.iter().find(|plugin| plugin.kind == Kind::Model).expect("a model");
    assert_eq!(
        (vendor.name.as_str(), vendor.origin.as_str(), vendor.version.as_str()),
        ("vendor-three-axis", "libthreeaxis.so", "1.0.0")
    );
    assert_eq!(vendor.sha256.as_ref(), Some(&run.inputs[1].sha256));
}

/// A recipe says the same as ever: the same stages leave the same estimates, of the same parameters, and the same verdicts.
#[test]
fn a_recipe_of_format_1_is_run() {
    let prepared = prepare(&folder().join("recipe-1.yaml"), &registry()).unwrap_or_else(|error| panic!("{error}"));
    let outcome = prepared.run(&abbe_core::Monitor::default()).unwrap_or_else(|error| panic!("{error}"));
    let stages: Vec<&str> = outcome.verdicts.iter().map(|verdict| verdict.stage.as_str()).collect();
    assert_eq!(stages, ["residuals", "too-good", "unseen", "effects"]);
    for name in ["calibration-1.json", "calibration-1-selected.json", "calibration-1-trials.json"] {
        let frozen = calibration(name);
        let now = &fit(&outcome, &frozen.estimate).calibration;
        assert_eq!((now.fit.unknowns, now.fit.rank), (frozen.fit.unknowns, frozen.fit.rank), "{name}");
        for then in frozen.parameters.iter().chain(&frozen.artefacts) {
            let (value, _, status) = told(now, &then.name);
            assert_eq!(status, then.status, "{name}: {}", then.name);
            // An estimator may get better: what it finds stays within what was known.
            let off = (value - then.value).abs();
            assert!(off <= 0.5 * then.standard_uncertainty, "{name}: {}: {value}, {} then", then.name, then.value);
        }
    }
}

#[test]
fn models_of_frozen_calibrations_are_built() {
    for file in files_in(&folder()).iter().filter(|file| stem(file).starts_with("calibration-")) {
        let calibration = Calibration::from_json(&read(file)).unwrap_or_else(|error| panic!("{error}"));
        let model = model_of(&calibration, &registry()).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
        let names: Vec<&str> = model.info().parameters.iter().map(|parameter| parameter.name.as_str()).collect();
        let kept: Vec<&str> = calibration.parameters.iter().map(|parameter| parameter.name.as_str()).collect();
        assert_eq!(names, kept, "{}", file.display());
    }
}

/// A result format: its name in file names, the key of its number, its number, its reader, which gives what is read as JSON again.
struct Format {
    name: &'static str,
    key: &'static str,
    number: u32,
    read: fn(&str) -> Result<Value, Error>,
}

const FORMATS: [Format; 3] = [
    Format {
        name: "calibration",
        key: "abbe_calibration",
        number: CALIBRATION_FORMAT,
        read: |text| Calibration::from_json(text).map(|read| json!(read)),
    },
    Format {
        name: "verdicts",
        key: "abbe_verdicts",
        number: VERDICTS_FORMAT,
        read: |text| Verdict::list_from_json(text).map(|read| json!(read)),
    },
    Format {
        name: "run",
        key: "abbe_run",
        number: RUN_FORMAT,
        read: |text| RunRecord::from_json(text).map(|read| json!(read)),
    },
];

impl Format {
    /// Its frozen files with their format numbers.
    fn files(&self) -> Vec<(u32, PathBuf)> {
        let number = |file: &PathBuf| {
            let name = stem(file);
            let number = name.strip_prefix(self.name)?.strip_prefix('-')?.split('-').next()?.parse().ok()?;
            Some((number, file.clone()))
        };
        files_in(&folder()).iter().filter_map(number).collect()
    }
}

#[test]
fn every_format_number_has_a_frozen_file() {
    for format in &FORMATS {
        for number in 1..=format.number {
            let found = format.files().iter().any(|(of, _)| *of == number);
            assert!(found, "no {}-{number}.json: see docs/formats.md, \"How a number is raised\"", format.name);
        }
    }
}

/// Nothing in a frozen file gets lost on the way through the program.
#[test]
fn frozen_files_are_read_whole() {
    for format in &FORMATS {
        for (_, file) in format.files().iter().filter(|(number, _)| *number == format.number) {
            let (name, frozen) = (file.display(), json_file(file));
            let read = (format.read)(&read(file)).unwrap_or_else(|error| panic!("{name}: {error}"));
            if let Some(lost) = lost(&frozen, &read) {
                panic!("{name}: {lost} is lost");
            }
            let schema = json_file(&root().join(format!("docs/schemas/{}.schema.json", format.name)));
            valid(&name.to_string(), &schema, &frozen);
        }
    }
}

/// Where `now` lacks something that stands in `then`, or has something else there; it may have more keys.
fn lost(then: &Value, now: &Value) -> Option<String> {
    let under = |place: String, rest: String| if rest.is_empty() { place } else { format!("{place}/{rest}") };
    match (then, now) {
        (Value::Object(then), Value::Object(now)) => then.iter().find_map(|(key, then)| match now.get(key) {
            Some(now) => lost(then, now).map(|rest| under(key.clone(), rest)),
            None => Some(key.clone()),
        }),
        (Value::Array(then), Value::Array(now)) if then.len() == now.len() => (then.iter().zip(now).enumerate())
            .find_map(|(index, (then, now))| lost(then, now).map(|rest| under(index.to_string(), rest))),
        _ => (then != now).then(String::new),
    }
}

#[test]
fn keys_that_are_not_known_yet_are_read_over() {
    for format in &FORMATS {
        for (_, file) in format.files() {
            let frozen = json_file(&file);
            let (mut more, mut places) = (frozen.clone(), 0);
            add_keys(&mut more, &mut places);
            assert!(places > 3, "{}: {places} places", file.display());
            let read = (format.read)(&more.to_string()).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
            let before = (format.read)(&frozen.to_string()).unwrap_or_else(|error| panic!("{error}"));
            assert!(read == before, "{} is read as something else", file.display());
        }
    }
}

/// Adds a key to every map, apart from the settings of a model: these are for its plugin, which refuses what it does not know.
fn add_keys(value: &mut Value, places: &mut usize) {
    match value {
        Value::Array(items) => items.iter_mut().for_each(|item| add_keys(item, places)),
        Value::Object(map) => {
            map.iter_mut().filter(|(key, _)| *key != "settings").for_each(|(_, item)| add_keys(item, places));
            map.insert("added_later".to_owned(), json!({ "some": ["thing", 1] }));
            *places += 1;
        }
        _ => {}
    }
}

#[test]
fn another_format_number_is_refused_with_both() {
    let mut said = String::new();
    for format in &FORMATS {
        let (_, file) = format.files().into_iter().next().expect("a frozen file");
        for number in [json!(format.number + 1), json!(0), json!("1"), json!(1.5), Value::Null] {
            let mut other = json_file(&file);
            if other.is_array() {
                other = json!({ "verdicts": other });
            }
            other[format.key] = number.clone();
            match (format.read)(&other.to_string()) {
                Err(error) => said.push_str(&format!("{} {number}: {error}\n", format.name)),
                Ok(_) => panic!("{} {number} is taken", format.name),
            }
        }
    }
    insta::assert_snapshot!("other_format_numbers", said);
}

#[test]
fn broken_verdicts_and_records_are_refused_with_a_reason() {
    let changed = |name: &str, change: fn(&mut Value)| {
        let mut value = json_file(&folder().join(name));
        change(&mut value);
        serde_json::to_string_pretty(&value).expect("JSON")
    };
    let verdicts = |change| changed("verdicts-1.json", change);
    let run = |change| changed("run-1-library.json", change);
    let cases: Vec<(&str, &Format, String)> = vec![
        ("verdicts not_json", &FORMATS[1], "[".to_owned()),
        ("verdicts no_list", &FORMATS[1], "{}".to_owned()),
        ("verdicts no_pass", &FORMATS[1], verdicts(|it| drop(it[1].as_object_mut().expect("a map").remove("pass")))),
        ("verdicts text_value", &FORMATS[1], verdicts(|it| it[0]["figures"][1]["value"] = json!("1.5"))),
        ("verdicts stage_twice", &FORMATS[1], verdicts(|it| it[1]["stage"] = json!("residuals"))),
        ("run not_json", &FORMATS[2], "abbe".to_owned()),
        ("run no_number", &FORMATS[2], run(|it| drop(it.as_object_mut().expect("a map").remove("abbe_run")))),
        ("run no_inputs", &FORMATS[2], run(|it| drop(it.as_object_mut().expect("a map").remove("inputs")))),
        ("run no_kind", &FORMATS[2], run(|it| it["plugins"][0]["kind"] = json!("oracle"))),
        ("run no_hash", &FORMATS[2], run(|it| it["inputs"][1]["sha256"] = json!("28093505"))),
        ("run no_hash_of_library", &FORMATS[2], run(|it| it["plugins"][2]["sha256"] = json!("xyz"))),
        ("run negative_time", &FORMATS[2], run(|it| it["duration_s"] = json!(-1.0))),
    ];
    let mut said = String::new();
    for (case, format, text) in &cases {
        match (format.read)(text) {
            Err(error) => said.push_str(&format!("{case}: {error}\n")),
            Ok(_) => panic!("{case} is taken"),
        }
    }
    insta::assert_snapshot!("broken_verdicts_and_records", said);
}
