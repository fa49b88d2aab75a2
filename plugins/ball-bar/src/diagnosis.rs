//! Validator `circular-diagnosis`: which errors make the circles of ball bar tests, and how much of them.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use abbe_core::{
    Context, DataRow, Dataset, Error, Figure, Findings, Fit, Limit, ObservationSet, Owner, PathItem, Problem, Result,
    SetIndex, SettingsError, Unknown, Validate, positive,
};
use abbe_standards::circular::EDITION;
use nalgebra::{DMatrix, DVector};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

abbe_core::register!(
    Validate,
    "circular-diagnosis",
    "which errors make the circles of ball bar tests: contribution of each to G(b), ranked by share",
    Settings,
    example,
    build,
    "../reference/validate-circular-diagnosis.md",
);

/// Settings of the diagnosis.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// The column of labels that tells the circles apart, both directions of each together.
    #[serde(default = "file")]
    tests: String,
    /// Largest admissible values.
    #[serde(default)]
    limits: Limits,
}

/// Largest admissible values.
#[derive(Debug, Clone, PartialEq, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Limits {
    /// Limit of the contribution of every error to every circle.
    #[serde(default)]
    contribution_um: Option<Limit>,
}

fn file() -> String {
    "file".to_owned()
}

fn example() -> Value {
    json!({ "tests": "file", "limits": { "contribution_um": 20 } })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    if let Some(limit) = settings.limits.contribution_um {
        let under = |error: SettingsError| error.under([PathItem::Key("limits".to_owned())]);
        positive("contribution_um", limit.value).map_err(under)?;
    }
    Ok(Box::new(Diagnosis { settings }))
}

struct Diagnosis {
    settings: Settings,
}

impl Validate for Diagnosis {
    fn validate(&self, fits: &[&Fit], _: &[&Dataset]) -> Result<Findings> {
        let mut findings = Findings::default();
        for fit in fits {
            self.judge(fit, fits.len() > 1, &mut findings)?;
        }
        findings.remarks.push(format!(
            "G(b) is that of {EDITION} (its text was not at hand), about the least squares circle. A choice of this project: the parts that \
             errors have in it"
        ));
        Ok(findings)
    }
}

impl Diagnosis {
    fn judge(&self, fit: &Fit, several: bool, findings: &mut Findings) -> Result<()> {
        for circle in circles(fit, &self.settings.tests)? {
            let total = circle.range(&circle.measured);
            let mut ranked: Vec<Ranked> = errors(fit).into_iter().map(|error| circle.ranked(fit, error)).collect();
            ranked.sort_by(|one, other| other.contribution.total_cmp(&one.contribution));
            let sum: f64 = ranked.iter().map(|own| own.contribution).sum();
            let mut table = String::from("rank,error,kind,contribution_um,u_um,share_percent,without_um\n");
            let figure =
                |name: &str, value: f64| Figure::new(&fit.name, format!("{name}[{}]", circle.name), 1e3 * value, "um");
            findings.figures.push(figure("G(b)_lsc", total));
            findings.figures.push(figure("not explained", circle.range(&circle.residuals)));
            for (place, own) in ranked.iter().enumerate() {
                let share = if sum > 0.0 { 100.0 * own.contribution / sum } else { 0.0 };
                let _ = writeln!(
                    table,
                    "{},{},{},{:.4},{:.4},{share:.2},{:.4}",
                    place + 1,
                    own.error.name,
                    own.error.kind,
                    1e3 * own.contribution,
                    1e3 * own.uncertainty,
                    1e3 * own.without
                );
                let name = format!("{} {}", own.error.kind, own.error.name);
                let contribution = figure(&name, own.contribution).uncertain(1e3 * own.uncertainty);
                findings.figures.push(match self.settings.limits.contribution_um {
                    Some(limit) => contribution.limited(limit),
                    None => contribution,
                });
            }
            let of = if several { format!("{}-", fit.name) } else { String::new() };
            findings.tables.insert(format!("diagnosis-{of}{}.csv", circle.name), table);
            if let Some(largest) = ranked.first().filter(|largest| largest.contribution > 0.0) {
                findings.remarks.push(format!(
                    "{}: the largest part is {} ({}): {:.1} um by itself; G(b) about the least squares circle is {:.1} um, without it {:.1} um",
                    circle.name, largest.error.kind, largest.error.name, 1e3 * largest.contribution, 1e3 * total, 1e3 * largest.without
                ));
            }
        }
        Ok(())
    }
}

/// An error of the machine: some unknowns of a fit.
struct MachineError {
    /// Its symbol, without what tells its unknowns apart.
    name: String,
    /// What it is in the words of circular tests.
    kind: &'static str,
    /// Its unknowns, by their index in the problem.
    unknowns: Vec<usize>,
}

/// The errors of the machine that a fit estimates. Cosine and sine of a pitch are one error.
fn errors(fit: &Fit) -> Vec<MachineError> {
    let mut found: Vec<MachineError> = Vec::new();
    for (index, unknown) in fit.problem.unknowns.iter().enumerate() {
        if !matches!(unknown.owner, Owner::Machine | Owner::Tie) {
            continue;
        }
        let name = match unknown.name.split_once(':') {
            Some((pitch, _)) => format!("{pitch}]"),
            None => unknown.name.clone(),
        };
        match found.iter_mut().find(|known| known.name == name) {
            Some(known) => known.unknowns.push(index),
            None => found.push(MachineError { kind: kind(&name), name, unknowns: vec![index] }),
        }
    }
    found
}

/// What a symbol is called in circular tests.
fn kind(name: &str) -> &'static str {
    let (symbol, bracket) = name.split_once('[').unwrap_or((name, ""));
    let letters: Vec<char> = symbol.chars().collect();
    let positioning = letters.get(1) == letters.get(2);
    let length = matches!(letters.get(1), Some('X' | 'Y' | 'Z'));
    match bracket.trim_end_matches(']') {
        "lag" => "servo mismatch",
        "b" if positioning => "backlash",
        "b" if length => "lateral play",
        "1" if positioning => "scale error",
        bracket if bracket.starts_with("cyc") || bracket.starts_with("per") => "cyclic error",
        "" if letters.get(2) == Some(&'0') && !length => "squareness",
        "" => "location",
        _ if positioning => "positioning",
        _ if length => "straightness",
        _ => "angular error",
    }
}

/// An error with what it does to a circle, mm.
struct Ranked {
    error: MachineError,
    /// Range of the readings of this error alone, about the best centre.
    contribution: f64,
    uncertainty: f64,
    /// G(b) of the readings without this error.
    without: f64,
}

/// A circle: the rows of one test.
struct Circle {
    name: String,
    /// Readings as the errors of the machine make them: derivatives of the readings, rows x unknowns.
    derivatives: DMatrix<f64>,
    /// Values of the unknowns, less those of a perfect machine.
    values: DVector<f64>,
    /// An orthonormal basis of the readings that a centre beside its place gives.
    centring: DMatrix<f64>,
    /// Readings less those of the perfect machine, mm.
    measured: DVector<f64>,
    /// What the fit does not explain, mm.
    residuals: DVector<f64>,
}

/// The circles of a fit.
fn circles(fit: &Fit, column: &str) -> Result<Vec<Circle>> {
    let problem = &fit.problem;
    let (x, own) = (problem.values_of(&fit.calibration), problem.unknowns.len());
    let centres = centres(problem)?;
    let mut extended = problem.with_values(&x);
    extended.unknowns.extend(centres.iter().map(|(_, unknown)| unknown.clone()));
    let (mut residuals, mut jacobian) = (Vec::new(), Vec::new());
    extended.linearise(&extended.start(), |block| {
        residuals.extend_from_slice(block.residuals);
        jacobian.extend_from_slice(block.jacobian);
    })?;
    let all = DMatrix::from_row_slice(residuals.len(), extended.unknowns.len(), &jacobian);
    let nominal = problem.model.info();
    let perfect = |unknown: &Unknown| match unknown.owner {
        Owner::Machine => nominal.nominal[unknown.index],
        _ => 0.0,
    };
    let machine = |unknown: &Unknown| matches!(unknown.owner, Owner::Machine | Owner::Tie);
    let value = |(unknown, value): (&Unknown, &f64)| if machine(unknown) { value - perfect(unknown) } else { 0.0 };
    let values = DVector::from_iterator(own, problem.unknowns.iter().zip(&x).map(value));
    let mut found = Vec::new();
    for ((index, set), equations) in SetIndex::enumerate(&problem.sets).zip(problem.equation_ranges()) {
        let equations: Vec<usize> = equations.map(|equation| equation.0).collect();
        for (name, rows) in tests(set, column)? {
            let rows: Vec<usize> = rows.iter().map(|row| equations[*row]).collect();
            let derivatives = DMatrix::from_fn(rows.len(), own, |row, unknown| all[(rows[row], unknown)]);
            let beside: Vec<usize> = centres
                .iter()
                .enumerate()
                .filter(|(_, (set, _))| *set == index)
                .map(|(place, _)| own + place)
                .collect();
            let beside = DMatrix::from_fn(rows.len(), beside.len(), |row, place| all[(rows[row], beside[place])]);
            let left = DVector::from_iterator(rows.len(), rows.iter().map(|row| -residuals[*row]));
            let measured = &derivatives * &values + &left;
            let values = values.clone();
            found.push(Circle { name, derivatives, values, centring: basis(beside), measured, residuals: left });
        }
    }
    Ok(found)
}

/// The offsets of the pivot balls, which are the centres of circles, with their set.
fn centres(problem: &Problem) -> Result<Vec<(SetIndex, Unknown)>> {
    let mut found = Vec::new();
    for (index, set) in SetIndex::enumerate(&problem.sets) {
        let info = set.info();
        if info.layout.rows.iter().any(|row| row.equations != 1 || row.data_row.is_none()) || info.features.is_empty() {
            let message = format!("`{}` has rows that are no lengths of a ball bar", set.name);
            return Err(Error::usage(message).help("estimate the errors of circles from `artefact: ball-bar` alone"));
        }
        for (own, _) in info.features.iter().flat_map(|feature| &feature.shifts) {
            let parameter = &info.unknowns[*own];
            let (name, unit) = (parameter.name.clone(), parameter.unit);
            found.push((index, Unknown { name, unit, owner: Owner::Set(index), index: *own }));
        }
    }
    Ok(found)
}

/// The equations of every test of a set, counted within the set.
fn tests(set: &ObservationSet, column: &str) -> Result<Vec<(String, Vec<usize>)>> {
    let layout = &set.info().layout;
    let labels = abbe_table::labels(&layout.data, column).map_err(|error| error.setting("tests"))?;
    let mut found: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for (place, row) in set.rows.iter().enumerate() {
        let data_row: DataRow = layout.rows[*row].data_row.unwrap_or_default();
        found.entry(&labels[data_row]).or_default().push(place);
    }
    Ok(found.into_iter().map(|(name, rows)| (name.to_owned(), rows)).collect())
}

/// Smallest part of the largest singular value that counts as a direction of its own: a centre above or below the plane of a circle has none.
const NO_DIRECTION: f64 = 1e-3;

/// An orthonormal basis of the columns.
fn basis(columns: DMatrix<f64>) -> DMatrix<f64> {
    let rows = columns.nrows();
    let svd = columns.svd(true, false);
    let (Some(u), largest) = (svd.u, svd.singular_values.max()) else { return DMatrix::zeros(rows, 0) };
    let kept: Vec<usize> =
        (0..svd.singular_values.len()).filter(|k| svd.singular_values[*k] > NO_DIRECTION * largest).collect();
    u.select_columns(&kept)
}

impl Circle {
    /// The readings about the best centre.
    fn centred(&self, readings: &DVector<f64>) -> DVector<f64> {
        readings - &self.centring * (self.centring.transpose() * readings)
    }

    /// The rows of the largest and of the smallest of some numbers.
    fn ends(readings: &DVector<f64>) -> (usize, usize) {
        (readings.imax(), readings.imin())
    }

    /// The range of readings about the best centre.
    fn range(&self, readings: &DVector<f64>) -> f64 {
        let centred = self.centred(readings);
        if centred.is_empty() { 0.0 } else { centred.max() - centred.min() }
    }

    /// What an error does.
    fn ranked(&self, fit: &Fit, error: MachineError) -> Ranked {
        let columns: Vec<DVector<f64>> = (error.unknowns.iter())
            .map(|unknown| self.centred(&self.derivatives.column(*unknown).into_owned()))
            .collect();
        let zero = DVector::zeros(self.measured.len());
        let alone = error
            .unknowns
            .iter()
            .zip(&columns)
            .fold(zero, |sum, (unknown, column)| sum + column * self.values[*unknown]);
        let (most, least) = Self::ends(&alone);
        // The range follows the unknowns by its two rows; of an error that is zero both are the first, so the steepest rows stand in.
        let slope = |column: &DVector<f64>| match most == least {
            true => column.max() - column.min(),
            false => column[most] - column[least],
        };
        let slopes: Vec<f64> = columns.iter().map(slope).collect();
        Ranked {
            contribution: alone[most] - alone[least],
            uncertainty: uncertainty(fit, &error, &slopes),
            without: self.range(&(&self.measured - &alone)),
            error,
        }
    }
}

/// Standard uncertainty of a sum of unknowns with these factors.
fn uncertainty(fit: &Fit, error: &MachineError, factors: &[f64]) -> f64 {
    let covariance = &fit.calibration.covariance;
    let name = |unknown: &usize| &fit.problem.unknowns[*unknown].name;
    let places: Vec<Option<usize>> = (error.unknowns.iter())
        .map(|unknown| covariance.order.iter().position(|other| other == name(unknown)))
        .collect();
    let mut variance = 0.0;
    for (one, a) in places.iter().zip(factors) {
        for (other, b) in places.iter().zip(factors) {
            if let (Some(one), Some(other)) = (one, other) {
                variance += a * b * covariance.rows[*one][*other];
            }
        }
    }
    variance.max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::kind;

    #[test]
    fn errors_have_the_names_of_circular_tests() {
        for (symbol, name) in [
            ("EXX[1]", "scale error"),
            ("EYY[b]", "backlash"),
            ("EXY[b]", "lateral play"),
            ("EYY[lag]", "servo mismatch"),
            ("EXX[cyc10]", "cyclic error"),
            ("EC0X", "squareness"),
            ("EYX[2]", "straightness"),
            ("EXX[2]", "positioning"),
            ("ECX[1]", "angular error"),
            ("EX0C", "location"),
        ] {
            assert_eq!(kind(symbol), name, "{symbol}");
        }
    }
}
