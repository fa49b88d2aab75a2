//! Bad input: every case is a small change of a recipe that works, with the message as a snapshot and the exit status.

use crate::support::{SMALL, Small};

/// A change of a file of the small recipe.
enum Edit {
    /// In this file, this text, becomes that one.
    Replace(&'static str, &'static str, &'static str),
    /// This file has this content.
    Write(&'static str, &'static str),
    /// This file keeps its header and some rows.
    Rows(&'static str, usize),
    /// This file does not exist.
    Remove(&'static str),
    /// A cell of this file: row (0 is the header), column, content.
    Cell(&'static str, usize, usize, &'static str),
}

use Edit::{Cell, Remove, Replace, Rows, Write};

const RECIPE: &str = "recipe.yaml";
const MACHINE: &str = "data/machine.yaml";
const TOUCHES: &str = "data/touches.csv";
const FACETS: &str = "data/facets.csv";
const LENGTHS: &str = "data/lengths.csv";

/// Makes the changes, runs the recipe, compares what the program says.
fn check(case: &str, status: i32, edits: &[Edit]) {
    let small = Small::new();
    for edit in edits {
        match *edit {
            Replace(file, old, new) => {
                let text = small.read(file);
                assert!(text.contains(old), "{case}: {file} has no {old}");
                small.write(file, &text.replacen(old, new, 1));
            }
            Write(file, text) => small.write(file, text),
            Rows(file, count) => {
                let text = small.read(file);
                let kept: Vec<&str> = text.lines().take(1 + count).collect();
                small.write(file, &(kept.join("\n") + "\n"));
            }
            Remove(file) => std::fs::remove_file(small.path(file)).expect("the file was there"),
            Cell(file, row, column, content) => {
                let text = small.read(file);
                let mut rows: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
                rows[row][column] = content;
                let rows: Vec<String> = rows.into_iter().map(|row| row.join(",")).collect();
                small.write(file, &(rows.join("\n") + "\n"));
            }
        }
    }
    let printed = small.abbe(&["run", RECIPE, "--out", "out"]);
    insta::assert_snapshot!(case, printed.stderr);
    assert_eq!(printed.status, status, "{case}: {}", printed.stderr);
    assert!(!printed.stderr.is_empty(), "{case}: nothing is said");
    if !printed.stdout.is_empty() {
        // What did not need the failed stage is there, and the record says what is not.
        let record: serde_json::Value = serde_json::from_str(&small.read("out/recipe/run.json")).expect("JSON");
        assert!(printed.stdout.contains("\nFailed\n"), "{case}: {}", printed.stdout);
        for failure in record["failures"].as_array().expect("failures") {
            let stage = failure["stage"].as_str().expect("a name");
            assert!(!small.path(&format!("out/recipe/{stage}.calibration.json")).exists(), "{case}: {stage}");
            assert!(printed.stdout.contains(&format!("\n  {stage} (")), "{case}: {}", printed.stdout);
        }
        return;
    }
    assert!(!small.path("out/recipe").exists(), "{case}: there are results");
}

fn check_all(status: i32, cases: &[(&str, &[Edit])]) {
    for (case, edits) in cases {
        check(case, status, edits);
    }
}

#[test]
fn the_small_recipe_works() {
    let small = Small::new();
    let printed = small.abbe(&["run", RECIPE, "--out", "out"]);
    assert_eq!((printed.status, printed.stderr.as_str()), (0, ""));
}

#[test]
fn a_recipe_that_is_no_recipe() {
    check_all(
        2,
        &[
            ("yaml_syntax", &[Replace(RECIPE, "path: data/touches.csv }", "path: data/touches.csv")]),
            ("yaml_tab", &[Replace(RECIPE, "  runs:", "\truns:")]),
            ("duplicate_key", &[Replace(RECIPE, "  runs:  ", "  touches:")]),
            ("no_version", &[Replace(RECIPE, "abbe: 1\n", "")]),
            ("later_version", &[Replace(RECIPE, "abbe: 1", "abbe: 2")]),
            ("unknown_top_key", &[Replace(RECIPE, "sets:", "set:")]),
            ("no_stages", &[Write(RECIPE, "abbe: 1\nname: Nothing\n")]),
            ("empty_recipe", &[Write(RECIPE, "")]),
            ("no_recipe", &[Remove(RECIPE)]),
            ("stage_without_kind", &[Replace(RECIPE, "ingest: csv, path: data/lengths.csv", "path: data/lengths.csv")]),
            (
                "stage_of_two_kinds",
                &[Replace(RECIPE, "{ ingest: csv, path: data/l", "{ ingest: csv, export: linuxcnc, path: data/l")],
            ),
        ],
    );
}

#[test]
fn references() {
    check_all(
        2,
        &[
            ("unknown_stage", &[Replace(RECIPE, "from: touches", "from: touchs")]),
            ("reference_to_nothing", &[Replace(RECIPE, "of: [rough, fine]", "of: [rough, best]")]),
            ("stage_of_the_wrong_kind", &[Replace(RECIPE, "from: touches", "from: machine")]),
            ("reference_is_missing", &[Replace(RECIPE, "from: touches, ", "")]),
            ("cycle", &[Replace(RECIPE, r#""table.*"]"#, "\"table.*\"]\n    start: fine")]),
            ("estimate_starts_from_itself", &[Replace(RECIPE, "start: rough", "start: fine")]),
            ("unknown_set", &[Replace(RECIPE, r#"["@tool", "table"#, r#"["@tools", "table"#)]),
            ("validator_of_what_was_not_observed", &[Replace(RECIPE, "rows: table", "rows: tabel")]),
        ],
    );
}

#[test]
fn settings() {
    check_all(
        2,
        &[
            ("unknown_plugin", &[Replace(RECIPE, "artefact: facets", "artefact: facet")]),
            ("unknown_plugin_without_neighbour", &[Replace(RECIPE, "export: error-table", "export: excel")]),
            ("unknown_setting", &[Replace(RECIPE, "nominal:", "nominel:")]),
            ("unknown_setting_of_an_estimate", &[Replace(RECIPE, "start: rough", "robbust: tukey")]),
            ("unknown_choice", &[Replace(RECIPE, "start: rough", "robust: tuckey")]),
            ("setting_of_the_wrong_type", &[Replace(RECIPE, "_um: 1.6", "_um: [1.6]")]),
            ("setting_is_missing", &[Replace(RECIPE, ", standard_uncertainty_um: 1.6", "")]),
            ("negative_uncertainty", &[Replace(RECIPE, "_um: 1.6", "_um: -1.6")]),
            ("zero_uncertainty", &[Replace(RECIPE, "_um: 0.9", "_um: 0")]),
            ("unknown_parameter", &[Replace(RECIPE, r#"EX0C, "EXX[1]""#, r#"EX0D, "EXX[1]""#)]),
            ("pattern_matches_nothing", &[Replace(RECIPE, r#""EXX[1]", "t"#, r#""EXX[2]", "t"#)]),
            ("no_parameters", &[Replace(RECIPE, r#"parameters: ["@tool", "table.*"]"#, "# none")]),
            ("unknown_limit", &[Replace(RECIPE, "max_um: 1000", "maximum_um: 1000")]),
            ("limit_without_unit", &[Replace(RECIPE, "max_um: 1000", "max: 1000")]),
            ("limit_is_text", &[Replace(RECIPE, "max_um: 1000", "max_um: small")]),
            ("limit_without_a_value", &[Replace(RECIPE, "max_um: 1000", "max_um: { decision: simple }")]),
            ("unknown_key_of_a_limit", &[Replace(RECIPE, "max_um: 1000", "max_um: { limit: 1000, decison: simple }")]),
            ("unknown_rule", &[Replace(RECIPE, "max_um: 1000", "max_um: { limit: 1000, decision: simpel }")]),
            (
                "unknown_rule_in_a_map",
                &[Replace(RECIPE, "max_um: 1000", "max_um: { limit: 1000, decision: { rule: sample } }")],
            ),
            (
                "setting_that_a_rule_has_not",
                &[Replace(RECIPE, "max_um: 1000", "max_um: { limit: 1000, decision: { rule: simple, w_um: 1 } }")],
            ),
            (
                "unknown_rule_of_an_uncertainty",
                &[Replace(
                    RECIPE,
                    "residuals, of: [rough, fine], limits: { max_um: 1000 }",
                    "uncertainty, of: fine, parameters: [{ names: [EX0C], expanded_um: { limit: 9, decision: simpl } }]",
                )],
            ),
            ("unknown_column_of_folds", &[Replace(RECIPE, "column: group", "column: grup")]),
            ("step_of_zero", &[Replace(RECIPE, "step_mm: 100", "step_mm: 0")]),
        ],
    );
}

#[test]
fn the_machine() {
    check_all(
        2,
        &[
            ("chain_without_bed", &[Replace(MACHINE, "X' b Z", "X' Z")]),
            ("chain_without_axes", &[Replace(MACHINE, "w C' B' X' b Z Y (S) t", "w b t")]),
            ("prime_and_branch_disagree", &[Replace(MACHINE, "X' b Z Y", "X' b Z' Y")]),
            ("prime_twice", &[Replace(MACHINE, "w C' B' X'", "w C' B' X'' ")]),
            ("axis_twice", &[Replace(MACHINE, "b Z Y", "b Z Z")]),
            ("unknown_axis_in_chain", &[Replace(MACHINE, "b Z Y", "b Z Q")]),
            ("axis_that_the_chain_has_not", &[Replace(MACHINE, "  Y: {", "  V: {")]),
            ("unknown_setting_of_an_axis", &[Replace(MACHINE, "direction: [0, 1, 0]", "directon: [0, 1, 0]")]),
            ("range_of_the_wrong_unit", &[Replace(MACHINE, "B: { range_deg", "B: { range_mm")]),
            ("misspelt_key_of_the_machine", &[Replace(MACHINE, "stylus_radius_mm", "stylus_radus_mm")]),
            ("tool_length_is_text", &[Replace(MACHINE, "326.674", "long")]),
            ("negative_stylus_radius", &[Replace(MACHINE, "stylus_radius_mm: 3", "stylus_radius_mm: -3")]),
            ("machine_file_is_missing", &[Remove(MACHINE)]),
            ("machine_file_is_no_yaml", &[Write(MACHINE, "name: [TANGO\nchain: w b t\n")]),
            ("unknown_error", &[Replace(RECIPE, "[EA0B, EX0C]", "[EA0B, EX0Q]")]),
            ("no_error_symbol", &[Replace(RECIPE, "[EA0B, EX0C]", "[EA0B, runout]")]),
            ("motion_error_as_location", &[Replace(RECIPE, "[EA0B, EX0C]", "[EA0B, EXX]")]),
            ("unknown_family", &[Replace(RECIPE, "backlash: [EXX]", "backlsh: [EXX]")]),
            ("polynomial_without_degrees", &[Replace(RECIPE, ", degrees: [1]", "")]),
            ("error_declared_twice", &[Replace(RECIPE, "[EXX, EYY, EZZ]", "[EXX, EXX, EZZ]")]),
        ],
    );
}

#[test]
fn files_and_their_headers() {
    check_all(
        2,
        &[
            ("data_file_is_missing", &[Remove(TOUCHES)]),
            ("nominal_file_is_missing", &[Remove(FACETS)]),
            ("pattern_without_files", &[Replace(RECIPE, "path: data/touches.csv", "path: data/touch-*.csv")]),
            ("column_of_an_axis_is_missing", &[Cell(TOUCHES, 0, 2, "U_mm")]),
            ("column_of_features_is_missing", &[Cell(TOUCHES, 0, 1, "facet")]),
            ("column_of_the_nominal_file_is_missing", &[Cell(FACETS, 0, 6, "n3")]),
            ("column_of_lengths_is_missing", &[Cell(LENGTHS, 0, 7, "ref_mm")]),
            ("column_without_unit", &[Cell(TOUCHES, 0, 2, "X")]),
            ("column_of_the_wrong_unit", &[Cell(TOUCHES, 0, 5, "B_mm")]),
            ("column_twice", &[Cell(TOUCHES, 0, 3, "X_mm")]),
            ("same_column_in_two_units", &[Cell(TOUCHES, 0, 3, "X_um")]),
        ],
    );
}

#[test]
fn rows_of_data() {
    check_all(
        1,
        &[
            ("file_is_empty", &[Write(TOUCHES, "")]),
            ("nominal_file_is_empty", &[Write(FACETS, "")]),
            ("no_data_rows", &[Rows(TOUCHES, 0)]),
            ("no_nominal_rows", &[Rows(FACETS, 0)]),
            ("text_in_a_column_of_numbers", &[Cell(TOUCHES, 12, 3, "high")]),
            ("not_a_number", &[Cell(TOUCHES, 12, 3, "NaN")]),
            ("infinite", &[Cell(TOUCHES, 12, 3, "inf")]),
            ("empty_cell", &[Cell(TOUCHES, 12, 3, "")]),
            ("decimal_comma", &[Cell(TOUCHES, 12, 3, "1,5")]),
            ("direction_is_neither", &[Cell(TOUCHES, 12, 8, "2"), Replace(RECIPE, "EX0C, \"", "\"EXX[b]\", \"")]),
            (
                "axis_moves_that_the_chain_has_not",
                &[Replace(MACHINE, "Y (S) t", "Y t"), Replace(MACHINE, "  S: {", "# S: {"), Cell(TOUCHES, 12, 7, "90")],
            ),
            (
                "command_beyond_the_range_of_an_error",
                &[
                    Replace(
                        RECIPE,
                        "- { polynomial: [EXX,",
                        "- { legendre: [EXX], degrees: [2], range_mm: [-150, 200] }\n      - { polynomial: [EXX,",
                    ),
                    Replace(RECIPE, "\"EXX[1]\"", "\"EXX[*]\""),
                ],
            ),
            ("unknown_label_in_folds", &[Replace(RECIPE, "[[2], [3]]", "[[2], [33]]")]),
            ("feature_without_nominal", &[Cell(TOUCHES, 12, 1, "77")]),
            ("feature_twice_in_the_nominal_file", &[Cell(FACETS, 2, 0, "3")]),
            ("zero_normal", &[Cell(FACETS, 1, 4, "0"), Cell(FACETS, 1, 5, "0"), Cell(FACETS, 1, 6, "0")]),
            ("normal_is_no_unit_vector", &[Cell(FACETS, 1, 4, "2")]),
            ("reference_length_of_zero", &[Cell(LENGTHS, 1, 7, "0")]),
            (
                "everything_is_ignored",
                &[Replace(
                    RECIPE,
                    "path: data/touches.csv",
                    "path: data/touches.csv, keep: { group: [1] }, ignore: { group: [1] }",
                )],
            ),
        ],
    );
}

#[test]
fn what_the_data_cannot_tell() {
    check_all(
        1,
        &[
            ("too_few_touches", &[Rows(TOUCHES, 5), Replace(RECIPE, "[[2], [3]]", "2")]),
            (
                "scale_without_a_length",
                &[
                    Replace(
                        RECIPE,
                        "observations: [table, bar]\n    parameters: [\"@tool\", EX0C, \"EXX[1]\"",
                        "observations: [table]\n    parameters: [\"@tool\", EX0C, \"E??[1]\"",
                    ),
                    Replace(RECIPE, "  bar:     { artefact: length, from: runs, standard_uncertainty_um: 0.9 }\n", ""),
                    Replace(RECIPE, "observations: [table, bar]", "observations: [table]"),
                ],
            ),
            ("two_that_cannot_be_told_apart", &[Replace(RECIPE, "EX0C, \"", "dzt, daw, \"")]),
            ("too_few_iterations", &[Replace(RECIPE, "start: rough", "iterations: 1")]),
            ("parameter_without_effect", &[Replace(RECIPE, "EX0C, \"", "dbt, \"")]),
            (
                "backlash_without_direction",
                &[Cell(TOUCHES, 0, 8, "way_X"), Replace(RECIPE, "EX0C, \"", "\"EXX[b]\", \"")],
            ),
            ("placement_of_the_workpiece", &[Replace(RECIPE, "EX0C, \"", "dxw, dyw, dzw, \"")]),
        ],
    );
}

#[test]
fn results_that_cannot_be_written() {
    check("output_folder_is_a_file", 1, &[Write("out", "not a folder")]);

    // Files that are not ours are not replaced.
    let small = Small::new();
    small.write("out/recipe/diary.txt", "Dear diary");
    let printed = small.abbe(&["run", RECIPE, "--out", "out"]);
    assert_eq!((printed.status, printed.stdout.as_str()), (1, ""));
    insta::assert_snapshot!("folder_of_results_holds_something_else", printed.stderr);
    assert_eq!(small.read("out/recipe/diary.txt"), "Dear diary");
}

#[test]
fn a_failed_limit_is_no_error_but_a_status() {
    let small = Small::new();
    small.write(RECIPE, &SMALL.replace("max_um: 1000", "max_um: 0.001"));
    let printed = small.abbe(&["run", RECIPE, "--out", "out"]);
    assert_eq!((printed.status, printed.stderr.as_str()), (3, ""));
    assert!(printed.stdout.contains("FAIL"), "{}", printed.stdout);
    assert!(small.path("out/recipe/verdicts.json").is_file());
}

#[test]
fn errors_are_objects_for_machines() {
    let small = Small::new();
    small.write(RECIPE, &SMALL.replace("from: touches", "from: touchs"));
    for command in ["run", "check"] {
        let printed = small.abbe(&[command, RECIPE, "--json"]);
        assert_eq!((printed.status, printed.stderr.as_str()), (2, ""), "{command}");
        insta::assert_snapshot!("error_as_json", printed.stdout);
    }
}

#[test]
fn what_run_refuses_before_it_reads_rows_check_refuses_too() {
    let cases =
        [("from: touches", "from: touchs", 2), ("nominal:", "nominel:", 2), ("[EA0B, EX0C]", "[EA0B, EX0Q]", 2)];
    for (old, new, status) in cases {
        let small = Small::new();
        small.write(RECIPE, &SMALL.replace(old, new));
        let [run, check] = ["run", "check"].map(|command| small.abbe(&[command, RECIPE]));
        assert_eq!((run.status, check.status), (status, status), "{new}");
        assert_eq!(run.stderr, check.stderr, "{new}");
    }
}

#[test]
fn knots_between_which_nothing_was_measured_are_told() {
    let small = Small::new();
    let positions = (1..20).chain(31..50).map(|step| 10 * step);
    let rows: String = positions.map(|x| format!("0,{x},{x}.001\n")).collect();
    small.write("lengths.csv", &format!("X1_mm,X2_mm,reference_mm\n{rows}"));
    small.write(
        "gap.yaml",
        "abbe: 1\nname: A gap\nstages:\n  rows: { ingest: csv, path: lengths.csv }\n  \
         laser: { artefact: length, from: rows, standard_uncertainty_um: 0.2 }\n  machine:\n    model: serial-chain\n    \
         chain: w b X t\n    tool_length_mm: 100\n    stylus_radius_mm: 0\n    axes: { X: { range_mm: [0, 500] } }\n    errors:\n      \
         - { piecewise: [EXX], degree: 2, continuity: 1, knots_mm: [100, 210, 230, 250, 270, 290, 400] }\n  \
         fit: { estimate: gauss-newton, machine: machine, observations: laser, parameters: [\"EXX*\"] }\n",
    );
    let told = small.abbe(&["run", "gap.yaml"]);
    assert_eq!(told.status, 1, "{}", told.stderr);
    let text = told.stderr.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ");
    assert!(text.contains("measure with X between 190 and 310 mm: no row has it there"), "{text}");
}

#[test]
fn a_scale_whose_temperature_is_not_known_is_told() {
    let small = Small::new();
    small.write("lengths.csv", "X1_mm,X2_mm,reference_mm\n0,100,100\n0,200,200\n0,300,300\n");
    let recipe = |ingest: &str| {
        format!(
            "abbe: 1\nname: An expanding scale\nstages:\n  rows: {{ ingest: csv, path: lengths.csv{ingest} }}\n  \
             laser: {{ artefact: length, from: rows, standard_uncertainty_um: 0.2 }}\n  machine:\n    model: serial-chain\n    \
             chain: w b X t\n    tool_length_mm: 100\n    stylus_radius_mm: 0\n    errors:\n      \
             - {{ polynomial: [EXX], degrees: [1] }}\n      \
             - {{ expansion: [EXX], temperature: T_X, coefficient_per_K: 11.5e-6 }}\n  \
             fit: {{ estimate: gauss-newton, machine: machine, observations: laser, parameters: [\"EXX[1]\"] }}\n"
        )
    };
    small.write("scale.yaml", &recipe(""));
    let told = small.abbe(&["run", "scale.yaml"]);
    assert_ne!(told.status, 0);
    let text = told.stderr.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ");
    assert!(text.contains("has no column `T_X_degC`"), "{text}");
    // Readings without any scatter have no uncertainty that could be estimated.
    let known = recipe(", constants: { T_X_degC: 30 }");
    small.write("scale.yaml", &known);
    let told = small.abbe(&["run", "scale.yaml", "--out", "out"]);
    assert_eq!(told.status, 1, "{}", told.stdout);
    assert!(told.stderr.contains("all residuals are exactly zero"), "{}", told.stderr);
    small
        .write("scale.yaml", &known.replace("observations: laser,", "observations: laser, trust_uncertainties: true,"));
    let found = small.abbe(&["run", "scale.yaml", "--out", "out"]);
    assert_eq!(found.status, 0, "{}", found.stderr);
    let calibration: serde_json::Value =
        serde_json::from_str(&small.read("out/scale/fit.calibration.json")).expect("a calibration");
    let parameters = calibration["parameters"].as_array().expect("parameters");
    let scale = parameters.iter().find(|parameter| parameter["name"] == "EXX[1]").expect("a parameter");
    // Ten degrees of expansion, which the data do not show, are taken back by the gain.
    let value = scale["value"].as_f64().expect("a value");
    assert!((value + 11.5e-5).abs() < 1e-9, "{value}");
}
