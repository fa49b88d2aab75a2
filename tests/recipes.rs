//! Every recipe of the repository: what `run` and `check` print, and what stands in the calibrations.
//!
//! Numbers are rounded so that they hold on other machines: to three digits in the summary, and in calibrations to the digits
//! that the data determine. In recipes without noise (`*-exact`) numbers that are only rounding are replaced.

use std::fmt::Write;
use std::path::Path;

use abbe_core::{Calibration, Estimated, Status, Verdict};
use serde_json::Value;
use tempfile::TempDir;

use crate::at_the_limit::only_what_is_drawn_is_uncertain;
use crate::support::{
    Printed, abbe, effect, files_in, read, recipes, recipes_with_every_plugin, root, temporary, tree, values,
};

/// A recipe whose residuals are nothing but rounding.
fn is_exact(recipe: &str) -> bool {
    recipe.ends_with("-exact")
}

/// What a recipe has to warn of, if that is what it shows.
fn warning(recipe: &str) -> Option<&'static str> {
    (recipe == "tango-warming-retrain").then_some("friday: the new rows do not agree with what is known")
}

/// Runs a recipe of the workspace, with results in a folder of its own.
fn run(recipe: &str, file: &Path) -> (Printed, TempDir) {
    let out = temporary();
    let printed = abbe(&root(), &[Path::new("run"), file, Path::new("--out"), out.path()]);
    assert_eq!(printed.status, 0, "{recipe}: {}", printed.stderr);
    (printed, out)
}

#[test]
fn every_recipe_runs_and_says_what_it_found() {
    let twice = recipes_with_every_plugin();
    assert!(twice.len() > 10, "{twice:?}");
    for (recipe, results) in run_all(|recipe| !is_exact(recipe)) {
        if twice.contains_key(&recipe) {
            let (_, again) = run(&recipe, &Path::new("pipelines").join(format!("{recipe}.yaml")));
            are_the_same_bytes(&recipe, &results.path().join(&recipe), &again.path().join(&recipe));
        }
    }
}

/// On data without noise.
#[test]
fn every_exact_recipe_runs_and_says_what_it_found() {
    assert!(run_all(is_exact).count() > 0, "there are none");
}

/// Runs some recipes, and compares what they say with what was reviewed; gives each with the folder of its results.
fn run_all(chosen: impl Fn(&str) -> bool) -> impl Iterator<Item = (String, TempDir)> {
    let chosen: Vec<_> = recipes().into_iter().filter(|(recipe, _)| chosen(recipe)).collect();
    chosen.into_iter().map(|(recipe, file)| {
        let file = file.strip_prefix(root()).expect("a recipe of the workspace").to_owned();
        let (printed, out) = run(&recipe, &file);
        match warning(&recipe) {
            Some(warning) => {
                assert!(printed.stderr.lines().all(|line| line.contains(warning)), "{recipe}: {}", printed.stderr);
                assert!(!printed.stderr.is_empty(), "{recipe} is silent");
            }
            None => assert_eq!(printed.stderr, "", "{recipe}"),
        }
        let summary = printed.stdout.replace(&out.path().display().to_string(), "<out>");
        insta::assert_snapshot!(format!("{recipe}__run"), rounded(&summary, is_exact(&recipe)));

        let results = out.path().join(&recipe);
        let verdicts = std::fs::read_to_string(results.join("verdicts.json")).unwrap_or_else(|_| "[]".to_owned());
        let verdicts: Vec<Verdict> = serde_json::from_str(&verdicts).expect("verdicts");
        only_what_is_drawn_is_uncertain(&recipe, &verdicts);
        let mut calibrations = 0;
        for file in files_in(&results) {
            let name = file.file_name().expect("a name").to_string_lossy().into_owned();
            let Some(estimate) = name.strip_suffix(".calibration.json") else { continue };
            let calibration = Calibration::from_json(&read(&file)).unwrap_or_else(|error| panic!("{name}: {error}"));
            calibrations += 1;
            // Those of every week are compared with their set (`history.rs`).
            if calibration.group.is_some() {
                continue;
            }
            insta::assert_snapshot!(format!("{recipe}__{estimate}"), told(&calibration, is_exact(&recipe)));
        }
        // Recipes that judge readings alone estimate nothing.
        let estimates = read(&root().join(&file)).contains("estimate:");
        assert_eq!(calibrations > 0, estimates, "{recipe} leaves no calibration");
        (recipe, out)
    })
}

/// Two runs give the same files, byte for byte.
fn are_the_same_bytes(recipe: &str, one: &Path, other: &Path) {
    assert_eq!(tree(one), tree(other), "{recipe}");
    for file in tree(one) {
        let [mut first, mut second] = [one, other].map(|folder| read(&folder.join(&file)));
        if file.as_os_str() == "run.json" {
            (first, second) = (without_times(&first), without_times(&second));
        }
        assert!(first == second, "{recipe}: {} differs", file.display());
    }
}

/// `run.json` without when the run was and how long it took.
fn without_times(text: &str) -> String {
    let mut record: Value = serde_json::from_str(text).expect("run.json");
    let map = record.as_object_mut().expect("an object");
    for time in ["started_unix_s", "duration_s"] {
        assert!(map.remove(time).is_some_and(|value| value.is_number()), "{time}");
    }
    record.to_string()
}

#[test]
fn every_recipe_can_be_checked() {
    for (recipe, file) in recipes() {
        let file = file.strip_prefix(root()).expect("a recipe of the workspace").to_owned();
        let Printed { status, stdout, stderr } = abbe(&root(), &[Path::new("check"), &file]);
        assert_eq!((status, stderr.as_str()), (0, ""), "{recipe}");
        insta::assert_snapshot!(format!("{recipe}__check"), rounded(&stdout, false));
    }
}

/// A calibration without its covariance, rounded to what the data tell: values to a hundredth of their standard
/// uncertainty, or to what the truth comes back to where there is no noise, and to four digits at most.
fn told(calibration: &Calibration, exact: bool) -> String {
    let fit = &calibration.fit;
    let mut text = format!(
        "{} by {}: {} equations, {} unknowns, rank {}, {} degrees of freedom, {:?}\n",
        calibration.estimate,
        calibration.model.plugin,
        fit.observations,
        fit.unknowns,
        fit.rank,
        fit.degrees_of_freedom,
        fit.termination,
    );
    for vector in &fit.null_space {
        writeln!(text, "lost: {}", vector.describe()).expect("text");
    }
    for outlier in &calibration.outliers {
        writeln!(
            text,
            "outlier: {} row {}, {}:{}, {:.0} µm, weight {:.1}",
            outlier.stage, outlier.row, outlier.file, outlier.line, outlier.residual_um, outlier.weight
        )
        .expect("text");
    }
    // Without noise a fit with a complete model leaves rounding only; its uncertainties are rounding, too.
    let noise = exact && fit.residual_max_um < 1e-3;
    for estimated in values(calibration) {
        let Estimated { name, value, unit, standard_uncertainty, status } = estimated;
        let known = *status == Status::Considered;
        let status = serde_json::to_value(status).expect("a status is text");
        let status = status.as_str().expect("a status is text");
        // What an earlier fit of exact data knows is rounding here, too.
        // Times and speeds have no effect at the tip.
        let has_effect = unit.starts_with("mm") || unit.starts_with("rad");
        let rounding = has_effect && (noise || (exact && known && *standard_uncertainty < tolerance(unit)));
        let step = if rounding { tolerance(unit) } else { ten_to(standard_uncertainty * 0.01) };
        let value = if rounding { untied(*value, step) } else { to_step(*value, step) };
        write!(text, "{name:<22}{unit:<12}{status:<12}{value:>11.3e}").expect("text");
        if !rounding && *standard_uncertainty > 0.0 {
            write!(text, " ± {standard_uncertainty:.1e}").expect("text");
        }
        text.push('\n');
    }
    text
}

/// The power of ten above what the ill-conditioned fit of exact data returns the truth to: 1e-3 µm or 1e-2 µrad at the end
/// of the travel.
fn tolerance(unit: &str) -> f64 {
    let (angle, factor) = effect(unit);
    10.0 * ten_to(if angle { 1e-8 } else { 1e-6 } / factor)
}

/// The power of ten at or below a number.
fn ten_to(number: f64) -> f64 {
    if number > 0.0 { 10_f64.powf(number.log10().floor()) } else { 0.0 }
}

/// The multiple of `step` that is nearest; never minus zero.
fn to_step(value: f64, step: f64) -> f64 {
    let rounded = if step > 0.0 { (value / step).round() * step } else { value };
    if rounded == 0.0 { 0.0 } else { rounded }
}

/// The nearest multiple of `step` for a value that is right up to rounding: true values have few digits, and one that ends
/// in 5 would fall to this side or that.
fn untied(value: f64, step: f64) -> f64 {
    to_step(value + 0.0371 * step.copysign(value), step)
}

/// The text with every decimal number rounded to three digits and put in the same place.
///
/// A value with its uncertainty is left as the program rounds it. Where there is no noise, what is below 0.01 is shown as
/// `~`, and so is a value that its own tiny uncertainty covers; blanks are pressed together there, because the width of
/// rounding varies.
fn rounded(text: &str, exact: bool) -> String {
    let mut lines = Vec::new();
    for line in text.lines() {
        // Where residuals are rounding it is chance which indexation has the largest.
        let line = if exact && line.contains("(0.0 µm)") { "  <where rounding is largest>" } else { line };
        let mut new = String::new();
        let mut rest = line;
        while let Some(start) = rest.find(|c: char| c.is_ascii_digit()) {
            let (mut before, mut from) = rest.split_at(start);
            // Digits of a name: `EXX[1]`, `fit-S4`, `touches.csv:68`.
            let named = before.ends_with(|c: char| c.is_alphabetic() || "[/_".contains(c));
            if let Some(blank) = before.strip_suffix('-')
                && blank.ends_with([' ', '('])
            {
                (before, from) = rest.split_at(start - 1);
            }
            new.push_str(before);
            let (number, mut after) = from.split_at(number(from));
            let mut was = number.to_owned();
            let mut short = if named { was.clone() } else { shorter(number, exact) };
            if let Some(pair) = after.strip_prefix(" ± ") {
                let (uncertainty, behind) = pair.split_at(self::number(pair));
                was = format!("{number} ± {uncertainty}");
                short = if exact { told_by(number, uncertainty) } else { was.clone() };
                after = behind;
            }
            if before.ends_with("  ") {
                new.push_str(&" ".repeat(was.chars().count().saturating_sub(short.chars().count())));
            }
            new.push_str(&short);
            rest = after;
        }
        new.push_str(rest);
        lines.push(if exact { pressed(&new) } else { new.trim_end().to_owned() });
    }
    lines.join("\n") + "\n"
}

/// Length of the number that a text begins with.
fn number(text: &str) -> usize {
    let bytes = text.as_bytes();
    let digits = |from: usize| bytes[from..].iter().take_while(|byte| byte.is_ascii_digit()).count();
    let sign = usize::from(bytes.first() == Some(&b'-'));
    let mut length = sign + digits(sign);
    if bytes.get(length) == Some(&b'.') && digits(length + 1) > 0 {
        length += 1 + digits(length + 1);
    }
    if bytes.get(length) == Some(&b'e') {
        let sign = usize::from(bytes.get(length + 1) == Some(&b'-'));
        if digits(length + 1 + sign) > 0 {
            length += 1 + sign + digits(length + 1 + sign);
        }
    }
    length
}

/// A number in a text to three significant digits; `~` if it is rounding in a recipe without noise.
fn shorter(number: &str, exact: bool) -> String {
    let value: f64 = number.parse().expect("a number");
    match number.chars().filter(char::is_ascii_digit).count() {
        _ if !number.contains(['.', 'e']) => number.to_owned(),
        _ if exact && value.abs() < 0.01 => "~".to_owned(),
        digits if digits <= 3 || number.contains('e') => number.to_owned(),
        _ => three(value, to_step),
    }
}

/// A value with its uncertainty in a recipe without noise: what of both is not rounding.
fn told_by(number: &str, uncertainty: &str) -> String {
    let [value, size]: [f64; 2] = [number, uncertainty].map(|text| text.parse().expect("a number"));
    match size < 0.01 {
        true if value.abs() < 10.0 * size => "~ ± ~".to_owned(),
        true => format!("{} ± ~", three(value, untied)),
        false => format!("{number} ± {uncertainty}"),
    }
}

/// A number to three significant digits.
fn three(value: f64, round: fn(f64, f64) -> f64) -> String {
    let magnitude = if value == 0.0 { 0 } else { value.abs().log10().floor() as i32 };
    let decimals = (2 - magnitude).max(0) as usize;
    format!("{:.decimals$}", round(value, 10_f64.powi(magnitude - 2)))
}

/// The words of a line with two blanks wherever there are more, also before the first.
fn pressed(line: &str) -> String {
    let words: Vec<&str> = line.split("  ").map(str::trim).filter(|word| !word.is_empty()).collect();
    format!("{}{}", if line.starts_with("  ") { "  " } else { "" }, words.join("  "))
}

#[test]
fn rounding_keeps_what_is_told_and_drops_the_rest() {
    let cases = [
        ("  dxt   µm   61.12 ± 3.11", false, "  dxt   µm   61.12 ± 3.11"),
        ("  max µm   116.04   -4.3257", false, "  max µm      116     -4.33"),
        ("  EXX[1] in fit-S4r, row 67 (a.csv:68)", false, "  EXX[1] in fit-S4r, row 67 (a.csv:68)"),
        ("  (p = 2e-45), rank 29, group 11 (6.2 µm)", false, "  (p = 2e-45), rank 29, group 11 (6.2 µm)"),
        ("  row 288 is -121.31 µm off", false, "  row 288 is -121 µm off"),
        ("  EXY[3]   µm/m³   188.500004 ± 0.000038", true, "  EXY[3]  µm/m³  189 ± ~"),
        ("  EXY[3]   µm/m³   188.499998 ± 0.000043", true, "  EXY[3]  µm/m³  189 ± ~"),
        ("  rms µm   6.954e-7   2.2567", true, "  rms µm  ~  2.26"),
        ("  EZZ[2]   µm/m²   0.00016 ± 0.00046", true, "  EZZ[2]  µm/m²  ~ ± ~"),
        ("  EXX[1]   µm/m   -8.6400027 ± 0.0000040", true, "  EXX[1]  µm/m  -8.64 ± ~"),
        ("  fit-S4r: largest rms: group 27 (0.0 µm)", true, "  <where rounding is largest>"),
    ];
    for (text, exact, expected) in cases {
        assert_eq!(rounded(text, exact), format!("{expected}\n"));
    }
}
