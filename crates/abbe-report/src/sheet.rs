//! Parameters and figures of runs as one table for spreadsheets.

use abbe_core::{Error, Result, Status};

use crate::run::Run;

/// Columns; values are in the unit of their row.
const COLUMNS: [&str; 10] =
    ["run", "kind", "of", "stage", "name", "value", "unit", "standard_uncertainty", "limit", "status"];

/// One row for every parameter and every figure of every run.
pub fn csv(runs: &[Run]) -> Result<String> {
    let wrong = |error: &dyn std::fmt::Display| Error::data(format!("the table cannot be written: {error}"));
    let mut writer = csv::WriterBuilder::new().terminator(csv::Terminator::Any(b'\n')).from_writer(Vec::new());
    writer.write_record(COLUMNS).map_err(|error| wrong(&error))?;
    for row in runs.iter().flat_map(rows) {
        writer.write_record(&row).map_err(|error| wrong(&error))?;
    }
    let bytes = writer.into_inner().map_err(|error| wrong(&error))?;
    String::from_utf8(bytes).map_err(|error| wrong(&error))
}

fn rows(run: &Run) -> Vec<[String; 10]> {
    let number = |value: Option<f64>| value.map_or(String::new(), |value| value.to_string());
    let mut rows = Vec::new();
    for fit in &run.fits {
        for known in &fit.calibration.parameters {
            let status = match known.status {
                Status::Fixed => "fixed",
                Status::Estimated => "estimated",
                Status::Considered => "considered",
                Status::Confounded => "confounded",
            };
            let [name, of, parameter, unit] = [&run.name, &fit.name, &known.name, &known.unit].map(|text| inert(text));
            let (value, uncertainty) = (known.value.to_string(), known.standard_uncertainty.to_string());
            let none = String::new;
            let kind = "parameter".to_owned();
            rows.push([name, kind, of, none(), parameter, value, unit, uncertainty, none(), status.to_owned()]);
        }
    }
    for verdict in &run.verdicts {
        for figure in &verdict.figures {
            let of = figure.of.as_deref().unwrap_or_default();
            let [name, of, stage, unit] = [run.name.as_str(), of, &verdict.stage, &figure.unit].map(inert);
            let (value, limit) = (number(figure.value), number(figure.limit));
            let uncertainty = number(figure.standard_uncertainty);
            let decision = figure.decision.map_or(String::new(), |decision| decision.to_string());
            let kind = "figure".to_owned();
            rows.push([name, kind, of, stage, inert(&figure.name), value, unit, uncertainty, limit, decision]);
        }
    }
    rows
}

/// Text that a spreadsheet does not take for a formula.
fn inert(text: &str) -> String {
    if text.starts_with(['=', '+', '-', '@', '\t', '\r']) { format!("'{text}") } else { text.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_are_no_formulas() {
        assert_eq!(["=1+1", "@a", "-x", "EXX[1]"].map(inert), ["'=1+1", "'@a", "'-x", "EXX[1]"]);
    }
}
