//! Exporter `uncertainty`: values, standard uncertainties, covariances and correlations of a calibration, as CSV.

use abbe_core::{
    Calibration, Context, Export, ExportedFile, KinematicModel, NamedCovariance, Result, SettingsError, Status,
};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::sampling::{exact, fixed};

abbe_core::register!(
    Export,
    "uncertainty",
    "values, standard uncertainties, correlations and covariances of all parameters, as CSV",
    Settings,
    example,
    build,
    "../reference/export-uncertainty.md",
);

/// There is nothing to set.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {}

fn example() -> Value {
    json!({})
}

fn build(_: Settings, _: &Context) -> Result<Box<dyn Export>, SettingsError> {
    Ok(Box::new(Uncertainty))
}

struct Uncertainty;

impl Export for Uncertainty {
    fn export(&self, calibration: &Calibration, _: &dyn KinematicModel) -> Result<Vec<ExportedFile>> {
        let NamedCovariance { order, rows } = &calibration.covariance;
        let standard: Vec<f64> = (0..order.len()).map(|index| rows[index][index].max(0.0).sqrt()).collect();
        let correlation = |row: usize, column: usize| match standard[row] * standard[column] {
            0.0 => String::new(),
            _ if row == column => fixed(1.0),
            product => fixed(rows[row][column] / product),
        };
        let files = [
            ("parameters.csv", parameters(calibration)),
            ("correlation.csv", matrix(order, correlation)),
            ("covariance.csv", matrix(order, |row, column| exact(rows[row][column]))),
        ];
        Ok(files.map(|(name, text)| ExportedFile { name: name.to_owned(), content: text.into_bytes() }).into())
    }
}

/// One line a parameter, of the machine first.
fn parameters(calibration: &Calibration) -> String {
    let mut text = "name,value,unit,standard_uncertainty,status\n".to_owned();
    for parameter in calibration.parameters.iter().chain(&calibration.artefacts) {
        let cells = [
            cell(&parameter.name),
            exact(parameter.value),
            parameter.unit.clone(),
            exact(parameter.standard_uncertainty),
            status(parameter.status).to_owned(),
        ];
        text.push_str(&cells.join(","));
        text.push('\n');
    }
    text
}

/// The status as calibrations write it.
fn status(status: Status) -> &'static str {
    match status {
        Status::Estimated => "estimated",
        Status::Fixed => "fixed",
        Status::Considered => "considered",
        Status::Confounded => "confounded",
    }
}

/// A square matrix with names above and before it.
fn matrix(names: &[String], entry: impl Fn(usize, usize) -> String) -> String {
    let header = std::iter::once("name".to_owned()).chain(names.iter().map(|name| cell(name)));
    let mut text = header.collect::<Vec<_>>().join(",");
    text.push('\n');
    for (row, name) in names.iter().enumerate() {
        let line = std::iter::once(cell(name)).chain((0..names.len()).map(|column| entry(row, column)));
        text.push_str(&line.collect::<Vec<_>>().join(","));
        text.push('\n');
    }
    text
}

/// A name as a cell, quoted where it would be more than one.
fn cell(name: &str) -> String {
    if name.contains([',', '"']) { format!("\"{}\"", name.replace('"', "\"\"")) } else { name.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{built, calibration, chain};

    #[test]
    fn parameters_and_matrices() {
        let model = chain("w b X Y Z t", json!({}), json!([{ "location": ["EC0Y"] }]));
        let mut calibration = calibration(model.as_ref(), &[("EC0Y", 2e-5), ("dxt", -0.25)]);
        calibration.artefacts.push(abbe_core::Estimated {
            name: "table.facet[1,5].d".to_owned(),
            value: 1.0 / 3.0,
            unit: "mm".to_owned(),
            standard_uncertainty: 0.0,
            status: Status::Confounded,
        });
        for parameter in calibration.parameters.iter_mut().filter(|parameter| parameter.value != 0.0) {
            parameter.status = Status::Estimated;
            parameter.standard_uncertainty = if parameter.name == "dxt" { 2e-3 } else { 1e-6 };
        }
        calibration.covariance.order = ["dxt", "table.facet[1,5].d", "EC0Y"].map(str::to_owned).to_vec();
        calibration.covariance.rows = vec![vec![4e-6, 0.0, -1e-9], vec![0.0, 0.0, 0.0], vec![-1e-9, 0.0, 1e-12]];
        let stage = built(&example(), build).unwrap();
        let files = stage.export(&calibration, model.as_ref()).unwrap();
        let text = |index: usize| String::from_utf8(files[index].content.clone()).unwrap();
        let names: Vec<&str> = files.iter().map(|file| file.name.as_str()).collect();
        assert_eq!(names, ["parameters.csv", "correlation.csv", "covariance.csv"]);
        let parameters = text(0);
        for line in [
            "name,value,unit,standard_uncertainty,status",
            "dxt,-2.5e-1,mm,2e-3,estimated",
            "dyt,0e0,mm,0e0,fixed",
            "EC0Y,2e-5,rad,1e-6,estimated",
            "\"table.facet[1,5].d\",3.333333333333333e-1,mm,0e0,confounded",
        ] {
            assert!(parameters.lines().any(|found| found == line), "{line} in {parameters}");
        }
        assert_eq!(parameters.lines().count(), 1 + calibration.parameters.len() + 1);
        assert_eq!(
            text(1),
            "name,dxt,\"table.facet[1,5].d\",EC0Y\ndxt,1.000000,,-0.500000\n\"table.facet[1,5].d\",,,\n\
             EC0Y,-0.500000,,1.000000\n"
        );
        assert_eq!(
            text(2),
            "name,dxt,\"table.facet[1,5].d\",EC0Y\ndxt,4e-6,0e0,-1e-9\n\"table.facet[1,5].d\",0e0,0e0,0e0\n\
             EC0Y,-1e-9,0e0,1e-12\n"
        );
    }
}
