//! Validator `influence`: which rows have a large influence on a fit, and which disagree with the others: leverages,
//! studentised residuals and Cook's distances (Soons 1993, section 3.2.2; Montgomery & Peck 1982), with a table of all rows
//! for residual plots.
//!
//! Rows count as in least squares with their standard uncertainties; outliers of a robust fit are left out, and covariances
//! between rows are not considered.

use std::collections::BTreeMap;

use abbe_core::{
    Context, Dataset, Error, Figure, Findings, Fit, Problem, Quantity, Result, RowIndex, SetIndex, SettingsError,
    Validate,
};
use abbe_numerics::{Accumulator, Influence as Diagnostics, coverage_factor};
use abbe_volumetric::position_unit;
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::figures::{Limits, ONE, check_limits, judged, outliers};

abbe_core::register!(
    Validate,
    "influence",
    "which rows hold a fit, and which do not go with the others; residuals as a table",
    Settings,
    example,
    build,
    "../reference/validate-influence.md",
);

/// Settings of the diagnostics.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// Probability that a row stands out by chance although all rows agree.
    #[serde(default = "default_significance")]
    significance: f64,
    /// Largest admissible values: `largest_leverage`, `largest_studentised_residual`, `largest_cook_distance`, `standing_out`.
    #[serde(default)]
    limits: Limits,
}

fn default_significance() -> f64 {
    0.05
}

const FIGURES: [&str; 4] =
    ["largest_leverage", "largest_studentised_residual", "largest_cook_distance", "standing_out"];

/// Largest number of rows that are named one by one.
const TOLD: usize = 5;

/// A row with a leverage this near 1 is not checked by any other row.
const ALONE: f64 = 1e-9;

fn example() -> Value {
    json!({ "significance": 0.05, "limits": { "largest_cook_distance": 1 } })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    check_limits(&settings.limits, &FIGURES)?;
    if !(settings.significance > 0.0 && settings.significance < 1.0) {
        return Err(SettingsError::new("significance", "a probability between 0 and 1 was expected"));
    }
    Ok(Box::new(Influence { settings }))
}

struct Influence {
    settings: Settings,
}

impl Validate for Influence {
    fn needs_rows(&self) -> bool {
        true
    }

    fn validate(&self, fits: &[&Fit], _: &[&Dataset]) -> Result<Findings> {
        judged(fits, &self.settings.limits, |fit, found| self.judge(fit, found))
    }
}

/// An equation that takes part.
struct Row {
    set: SetIndex,
    row: RowIndex,
    quantity: Quantity,
    /// mm or rad.
    residual: f64,
    uncertainty: f64,
    leverage: f64,
}

impl Influence {
    fn judge(&self, fit: &Fit, found: &mut Findings) -> Result<()> {
        let rows = rows(fit)?;
        let weighted: Vec<f64> = rows.iter().map(|row| row.residual / row.uncertainty).collect();
        let leverages: Vec<f64> = rows.iter().map(|row| row.leverage).collect();
        let told = Diagnostics::new(&weighted, &leverages, fit.calibration.fit.rank);
        let largest =
            |values: &[f64]| values.iter().map(|value| value.abs()).filter(|value| !value.is_nan()).fold(0.0, f64::max);
        // Bonferroni: one of all of them, on either side.
        let freedom = rows.len() as f64 - fit.calibration.fit.rank as f64 - 1.0;
        let limit = coverage_factor(1.0 - self.settings.significance / rows.len() as f64, freedom);
        let mut standing_out: Vec<usize> = (0..rows.len()).filter(|&row| told.deleted[row].abs() > limit).collect();
        standing_out.sort_by(|&a, &b| told.deleted[b].abs().total_cmp(&told.deleted[a].abs()));
        let figure = |name: &str, value: f64| Figure::new(&fit.name, name, value, ONE);
        found.figures.extend([
            figure("largest leverage", largest(&leverages)),
            figure("largest studentised residual", largest(&told.studentised)),
            figure("largest cook distance", largest(&told.cook)),
            figure("standing out", standing_out.len() as f64),
        ]);
        let alone: Vec<usize> = (0..rows.len()).filter(|&row| leverages[row] > 1.0 - ALONE).collect();
        if !alone.is_empty() {
            let places = places(&fit.problem, &rows, &alone);
            found.remarks.push(format!(
                "{}: nothing checks these rows, which settle an unknown by themselves: {places}",
                fit.name
            ));
        }
        if !standing_out.is_empty() {
            let places = places(&fit.problem, &rows, &standing_out);
            found.remarks.push(format!("{}: these rows do not go with the others: {places}", fit.name));
        }
        found.tables.insert(format!("{}.csv", fit.name), table(&fit.problem, &rows, &told));
        Ok(())
    }
}

/// The equations of a fit that are no outliers, with their leverages.
fn rows(fit: &Fit) -> Result<Vec<Row>> {
    let problem = &fit.problem;
    let left_out = outliers(problem, &fit.calibration);
    let estimated = |name: &String| fit.calibration.covariance.order.contains(name);
    // Unknowns that a selection left out are not used.
    let problem = problem.without_unknowns(|unknown| !estimated(&unknown.name)).starting_from(&fit.calibration);
    if !problem.covariance_blocks().is_empty() {
        let error = Error::usage("influence is that of rows that are independent, and these are given a covariance");
        return Err(error.help("leave the validator out, or the covariance under `uncertainty` of the artefacts"));
    }
    let x = problem.values_of(&fit.calibration);
    let (uncertainties, equations, quantities) =
        (problem.standard_uncertainties(), problem.equation_rows(), problem.quantities());
    let takes_part: Vec<bool> = equations.iter().map(|row| !left_out.contains(row)).collect();
    let count = problem.unknowns.len();
    let mut accumulator = Accumulator::new(count, equations.len());
    problem.linearise(&x, |block| {
        for (equation, residual, line) in block.lines() {
            if takes_part[equation] {
                accumulator.push(line, residual, 1.0 / uncertainties[equation]);
            }
        }
    })?;
    let covariance_root = accumulator.finish().covariance_root(fit.calibration.fit.rank.min(count));
    let mut rows = Vec::new();
    problem.linearise(&x, |block| {
        let leverages = covariance_root.leverages(block.jacobian);
        for ((equation, residual, _), leverage) in block.lines().zip(leverages) {
            if takes_part[equation] {
                let (set, row) = equations[equation];
                let uncertainty = uncertainties[equation];
                rows.push(Row {
                    set,
                    row,
                    quantity: quantities[equation],
                    residual,
                    uncertainty,
                    leverage: (leverage / (uncertainty * uncertainty)).min(1.0),
                });
            }
        }
    })?;
    Ok(rows)
}

/// Where the first of some rows stand.
fn places(problem: &Problem, rows: &[Row], of: &[usize]) -> String {
    let place = |row: &Row| {
        let stage = &problem.sets[row.set].name;
        match problem.origin(row.set, row.row) {
            Some((file, origin)) => format!("{stage} ({})", origin.in_file(file)),
            None => stage.clone(),
        }
    };
    let mut told: Vec<String> = Vec::new();
    for &index in of {
        let place = place(&rows[index]);
        if !told.contains(&place) {
            told.push(place);
        }
    }
    let more = told.len().saturating_sub(TOLD);
    told.truncate(TOLD);
    let rest = if more > 0 { format!(" and {more} more") } else { String::new() };
    told.join(", ") + &rest
}

/// One line an equation: its place in the data, the positions of the axes, and its influence on the fit.
fn table(problem: &Problem, rows: &[Row], told: &Diagnostics) -> String {
    let axes = &problem.model.info().axes;
    let mut text = "stage,file,line".to_owned();
    for axis in axes {
        text.push_str(&format!(",{}_{}", axis.name, position_unit(axis).0));
    }
    text.push_str(",residual_um,residual_urad,leverage,studentised,deleted,cook\n");
    let mut lines: BTreeMap<(SetIndex, RowIndex), String> = BTreeMap::new();
    for (index, row) in rows.iter().enumerate() {
        let place = lines.entry((row.set, row.row)).or_insert_with(|| place(problem, row));
        let (um, urad) = match row.quantity {
            Quantity::Angle => (String::new(), format!("{:.6}", row.residual * 1e6)),
            _ => (format!("{:.6}", row.residual * 1e3), String::new()),
        };
        let numbers = [row.leverage, told.studentised[index], told.deleted[index], told.cook[index]];
        // Figures that do not exist for a row that no other row checks stay empty.
        let numbers = numbers.map(|value| if value.is_finite() { format!("{value:.6}") } else { String::new() });
        text.push_str(&format!("{place},{um},{urad},{}\n", numbers.join(",")));
    }
    text
}

/// Stage, file, line and axis positions of the first pose of a row.
fn place(problem: &Problem, row: &Row) -> String {
    let set = &problem.sets[row.set];
    let (file, line) = problem
        .origin(row.set, row.row)
        .map_or_else(Default::default, |(file, origin)| (file.display().to_string(), origin.line.to_string()));
    let file = if file.contains([',', '"']) { format!("\"{}\"", file.replace('"', "\"\"")) } else { file };
    let layout = set.info().layout.rows[row.row];
    let mut text = format!("{},{file},{line}", set.name);
    for axis in &problem.model.info().axes {
        let position =
            (layout.poses > 0).then(|| set.poses().row(layout.first_pose)[axis.status] * position_unit(axis).1);
        text.push_str(&position.map_or(",".to_owned(), |position| format!(",{}", (position * 1e6).round() / 1e6)));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Touch, UPWARDS, check, judge};

    #[test]
    fn a_row_that_does_not_go_with_the_others_and_one_that_nothing_checks() {
        // Ten touches on a scatter by 1 µm, the eleventh is 30 µm off; b is touched once.
        let mut touches: Vec<Touch> = (0..10).map(|i| ("a", "1", 0.0, if i % 2 == 0 { 1.0 } else { -1.0 })).collect();
        touches.extend([("a", "1", 0.0, 30.0), ("b", "1", 0.0, 7.0)]);
        let (folder, fit) = crate::testing::fit(&UPWARDS, &touches, false);
        let settings = json!({ "limits": { "standing_out": 0, "largest_leverage": 1 } });
        let found = judge("influence", folder.path(), &settings, &fit).unwrap();
        // Leverages 1/11 and 1. Without the eleventh touch: mean 0, variance 10 / 9 µm².
        let deleted = 30.0 / (10.0 / 9.0 * 1.1_f64).sqrt();
        let studentised = deleted * (10.0 / (9.0 + deleted * deleted)).sqrt();
        check(
            &found,
            &[
                ("largest leverage", 1.0),
                ("largest studentised residual", studentised),
                ("largest cook distance", studentised * studentised / 11.0 / (2.0 * 10.0 / 11.0)),
                ("standing out", 1.0),
            ],
        );
        let failed: Vec<&str> =
            found.figures.iter().filter(|figure| !figure.passes()).map(|figure| figure.name.as_str()).collect();
        assert_eq!(failed, ["standing out"]);
        let ends = |remark: &str, line: usize| remark.ends_with(&format!("touches.csv:{line})"));
        assert!(ends(&found.remarks[0], 13) && found.remarks[0].contains("nothing checks"), "{:?}", found.remarks);
        assert!(ends(&found.remarks[1], 12) && found.remarks[1].contains("do not go"), "{:?}", found.remarks);
        let table = &found.tables["fit.csv"];
        let lines: Vec<&str> = table.lines().collect();
        assert_eq!(
            lines[0],
            "stage,file,line,X_mm,Y_mm,Z_mm,residual_um,residual_urad,leverage,studentised,deleted,cook"
        );
        assert_eq!(lines.len(), 13);
        let eleventh: Vec<&str> = lines[11].split(',').collect();
        assert_eq!((eleventh[0], eleventh[2], eleventh[3], eleventh[7]), ("table", "12", "100", ""));
        assert!((eleventh[6].parse::<f64>().unwrap() - 30.0 * 10.0 / 11.0).abs() < 1e-5, "{}", lines[11]);
        assert!((eleventh[10].parse::<f64>().unwrap() - deleted).abs() < 1e-5, "{}", lines[11]);
        assert!(lines[12].ends_with(",1.000000,,,"), "{}", lines[12]);
    }

    #[test]
    fn settings_that_make_no_sense() {
        let touches: [Touch; 3] = [("a", "1", 0.0, 1.0), ("a", "1", 0.0, 0.0), ("a", "1", 0.0, 2.0)];
        let (folder, fit) = crate::testing::fit(&UPWARDS, &touches, false);
        let wrong = |settings: Value| judge("influence", folder.path(), &settings, &fit).unwrap_err();
        assert_eq!(wrong(json!({ "significance": 5 })), "significance: a probability between 0 and 1 was expected");
        assert!(wrong(json!({ "limits": { "cook": 1 } })).starts_with("limits.cook: there is no figure `cook`"));
    }
}
