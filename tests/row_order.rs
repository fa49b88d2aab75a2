//! Signs that the order of rows contradicts.

use serde_json::json;

use crate::misread::changed;
use crate::support::{Variant, abbe, recipes, temporary};

/// What a recipe says where columns of files of a stage have the other sign.
fn negated(name: &str, stage: &str, columns: &[&str]) -> String {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()[name]);
    let paths = recipe.stage(stage)["path"].clone();
    let paths = paths.as_array().cloned().unwrap_or_else(|| vec![paths]);
    let other = |(index, file): (usize, &serde_json::Value)| {
        let mut file = std::path::PathBuf::from(file.as_str().expect("a path"));
        for column in columns {
            let own = folder.path().join(format!("{index}-{column}"));
            std::fs::create_dir(&own).expect("a folder");
            file = changed(&file, &own, column, |_, cell| match cell.strip_prefix('-') {
                Some(positive) => positive.to_owned(),
                None => format!("-{cell}"),
            });
        }
        json!(file)
    };
    recipe.stage(stage)["path"] = paths.iter().enumerate().map(other).collect();
    let file = recipe.write(folder.path());
    let out = folder.path().join("out");
    let printed = abbe(folder.path(), &["run".as_ref(), file.as_os_str(), "--out".as_ref(), out.as_os_str()]);
    printed.stderr.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ")
}

const AGAINST: &str = "the axes move against";
const ROUND: &str = "run round against the column `angle`";

#[test]
fn directions_that_are_turned_are_told_by_the_order_of_rows() {
    for (columns, told) in [(&[][..], None), (&["direction"], Some("`dir_C`")), (&["dir_X", "dir_Y"], Some("`dir_X`"))]
    {
        let text = negated("standards-rtest", "c-turns", columns);
        assert_eq!(text.contains(AGAINST), told.is_some(), "{columns:?}: {text}");
        assert!(told.is_none_or(|told| text.contains(told)), "{columns:?}: {text}");
    }
    // Touches have an approach each: their order says nothing.
    assert!(!negated("first-steps", "touches", &["dir_X"]).contains(AGAINST));
}

#[test]
fn circles_that_run_against_their_angles_are_told() {
    for (columns, told) in [(&[][..], false), (&["X_mm"], true), (&["X_mm", "Y_mm"], false)] {
        let text = negated("standards-ball-bar", "circles", columns);
        assert_eq!(text.contains(ROUND), told, "{columns:?}: {text}");
    }
}

/// A circle that began elsewhere than its column `angle` says: the readings then belong to other directions.
#[test]
fn angles_beside_those_of_the_positions_are_told() {
    let folder = temporary();
    for (degrees, told) in [(0.0, false), (1.0, false), (8.0, true), (-45.0, true), (90.0, true)] {
        let mut recipe = Variant::of(&recipes()["standards-ball-bar"]);
        let other = |file: &serde_json::Value| {
            let file = std::path::PathBuf::from(file.as_str().expect("a path"));
            json!(changed(&file, folder.path(), "angle_deg", |_, cell| {
                (cell.parse::<f64>().expect("an angle") + degrees).to_string()
            }))
        };
        let files: Vec<serde_json::Value> =
            recipe.stage("circles")["path"].as_array().expect("files").iter().map(other).collect();
        recipe.stage("circles")["path"] = json!(files);
        let file = recipe.write(folder.path());
        let printed = abbe(folder.path(), &["check".as_ref(), file.as_os_str()]);
        let text = printed.stderr.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ");
        let words = format!("the column `angle` is {degrees:.1} degrees beside the angle of the positions of X and Y");
        assert_eq!(text.contains(&words), told, "{degrees}: {text}");
        assert_eq!(text.contains("beside the angle of the positions"), told, "{degrees}: {text}");
        assert!(!told || text.contains("ballbar-xy-f500.csv:"), "{text}");
    }
}

/// Robust weights leave out the rows in which the spindle is turned, where its angles are wrong: what these rows tell is gone.
#[test]
fn outliers_that_gather_where_one_axis_is_turned_are_told() {
    let folder = temporary();
    for (rounded, told) in [(false, false), (true, true)] {
        let mut recipe = Variant::of(&recipes()["first-steps"]);
        let file = std::path::PathBuf::from(recipe.stage("touches")["path"].as_str().expect("a path"));
        let file = changed(&file, folder.path(), "S_deg", |_, cell| match rounded {
            true => format!("{}", (cell.parse::<f64>().expect("an angle") / 100.0).round() * 100.0),
            false => cell.to_owned(),
        });
        recipe.stage("touches")["path"] = json!(file);
        let file = recipe.write(folder.path());
        let out = folder.path().join("out");
        let printed = abbe(folder.path(), &["run".as_ref(), file.as_os_str(), "--out".as_ref(), out.as_os_str()]);
        let text = [printed.stdout, printed.stderr].concat();
        let words = text.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ");
        let sentence = "4 of the 12 rows of table in which S is not where it usually is are outliers";
        assert_eq!(words.contains(sentence), told, "{words}");
        assert_eq!(words.contains("is not where it usually is"), told, "{words}");
    }
}

/// A copy of a file of a stage in which two columns are exchanged.
fn exchanged(name: &str, stage: &str, [one, other]: [&str; 2]) -> String {
    let (folder, mut recipe) = (temporary(), Variant::of(&recipes()[name]));
    recipe.stage(stage)["path"] = json!(crate::told::exchanged(&recipe.path(stage, "path"), folder.path(), one, other));
    let file = recipe.write(folder.path());
    let printed = abbe(folder.path(), &["check".as_ref(), file.as_os_str()]);
    [printed.stdout, printed.stderr]
        .concat()
        .split_whitespace()
        .filter(|word| *word != "│")
        .collect::<Vec<_>>()
        .join(" ")
}

#[test]
fn directions_of_rotary_axes_that_touches_contradict_are_told() {
    for (columns, told) in [(&[][..], None), (&["dir_C"], Some("`dir_C`")), (&["dir_B"], Some("`dir_B`"))] {
        let text = negated("first-steps", "touches", columns);
        assert_eq!(text.contains(AGAINST), told.is_some(), "{columns:?}: {text}");
        assert!(told.is_none_or(|told| text.contains(told)), "{columns:?}: {text}");
    }
}

#[test]
fn columns_of_directions_that_are_exchanged_are_told() {
    for (name, stage, columns, axes) in [
        ("first-steps", "touches", ["dir_B", "dir_C"], ["B", "C"]),
        ("standards-rtest", "c-turns", ["dir_X", "dir_Y"], ["X", "Y"]),
        ("standards-rtest", "a-turns", ["dir_Y", "dir_Z"], ["Y", "Z"]),
        ("standards-interpolation", "tests", ["dir_A", "dir_C"], ["A", "C"]),
        ("standards-interpolation", "tests", ["dir_X", "dir_Y"], ["X", "Y"]),
    ] {
        let text = exchanged(name, stage, columns);
        let is_told = |[one, other]: [&str; 2]| {
            text.contains(&format!("{one} moves as `dir_{other}` says and {other} as `dir_{one}` does"))
        };
        let [one, other] = axes;
        assert!(is_told([one, other]) || is_told([other, one]), "{name} {columns:?}: {text}");
    }
    // Two axes that are approached from one side each tell nothing.
    assert!(!exchanged("standards-rtest", "c-turns", ["dir_Z", "dir_Z"]).contains("are the two columns exchanged"));
}
