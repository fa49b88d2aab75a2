//! Artefact plugin `length`: lengths between two poses, calibrated or not.
//!
//! Equation: `|p2 - p1| - L = 0` with the tip positions of both ends in the table frame. L is an unknown of the artefact, or
//! the reference of the row, off by the error of its bar's calibration and expanded by `a (T - 20 °C)`; error, coefficient
//! and temperature are known inputs that all rows share. One calibrated length gives a self-calibration its scale.

mod certified;

use std::path::PathBuf;
use std::sync::Arc;

use abbe_core::{
    AboveZero, Absent, Artefact, Axis, AxisKind, ColumnHeader, Contact, Context, DataRow, Dataset, Equations, Error,
    InputFile, KinematicModel, KnownInput, LabelText, Layout, Observations, ObservationsInfo, Parameter, ParameterRole,
    PathItem, Poses, Quantity, RankPoint, Result, RowBatch, RowIndex, SettingsError, StatusColumn, Target, Unit,
    not_negative, pose_columns, positive,
};
use abbe_dcc::{CertificateFile, DigitalCertificate};
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use certified::Certified;

abbe_core::register!(
    Artefact,
    "length",
    "lengths between two poses: scale bars, laser interferometer, step gauges",
    Settings,
    example,
    build,
    "../reference/artefact-length.md",
);

/// Settings of the lengths.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// Standard uncertainty of one measured length.
    #[schemars(with = "AboveZero")]
    standard_uncertainty_um: f64,
    /// Whether the length is known (column `reference_mm`) or estimated: `length`, or `bar[1].length` for every label
    /// of the column `bar`.
    #[serde(default)]
    length: Length,
    /// Standard uncertainty of the calibration of the known length, shared by all rows.
    #[serde(default)]
    reference_standard_uncertainty_um: f64,
    /// The digital calibration certificate of the known lengths, in place of the column `reference_mm` and of
    /// `reference_standard_uncertainty_um`. The column `reference` of the data says the label of each length; without it the
    /// certificate has to state one length only.
    #[serde(default)]
    certificate: Option<CertificateFile>,
    /// Thermal expansion of the known length. If it is missing, the reference lengths hold at the temperature of the
    /// measurement.
    #[serde(default)]
    expansion: Option<Expansion>,
}

/// Linear thermal expansion from 20 °C (ISO 1).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[allow(non_snake_case, reason = "units are written as in column names")]
struct Expansion {
    /// Coefficient of linear thermal expansion.
    coefficient_per_K: f64,
    /// Its standard uncertainty, shared by all rows.
    #[serde(default)]
    standard_uncertainty_per_K: f64,
    /// Temperature of the artefact where the data have no column `T_degC`.
    #[serde(default)]
    temperature_degC: Option<f64>,
    /// Standard uncertainty of the temperature, shared by all rows.
    #[serde(default)]
    temperature_standard_uncertainty_K: f64,
}

/// The reference temperature of all lengths, °C (ISO 1).
const REFERENCE_TEMPERATURE: f64 = 20.0;

/// Whether the length is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Length {
    /// It is known: the column `reference_mm`.
    #[default]
    Known,
    /// It is estimated: an unknown of the artefact.
    Estimated,
}

fn example() -> Value {
    json!({ "standard_uncertainty_um": 0.9 })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Artefact>, SettingsError> {
    positive("standard_uncertainty_um", settings.standard_uncertainty_um)?;
    not_negative("reference_standard_uncertainty_um", settings.reference_standard_uncertainty_um)?;
    if let Some(expansion) = &settings.expansion {
        let under = |error: SettingsError| error.under([PathItem::Key("expansion".to_owned())]);
        for (name, value) in [
            ("standard_uncertainty_per_K", expansion.standard_uncertainty_per_K),
            ("temperature_standard_uncertainty_K", expansion.temperature_standard_uncertainty_K),
        ] {
            not_negative(name, value).map_err(under)?;
        }
        if settings.length == Length::Estimated {
            return Err(SettingsError::new("expansion", "a length that is estimated has no reference to expand"));
        }
    }
    let under = |error: SettingsError| error.under([PathItem::Key("certificate".to_owned())]);
    let certificate = settings.certificate.as_ref().map(|it| it.path(context)).transpose().map_err(under)?;
    if certificate.is_some() {
        if settings.length == Length::Estimated {
            return Err(SettingsError::new("certificate", "a length that is estimated has no certificate"));
        }
        if settings.reference_standard_uncertainty_um > 0.0 {
            let error = SettingsError::new("reference_standard_uncertainty_um", "the certificate states it");
            return Err(error.help("leave it out"));
        }
    }
    Ok(Box::new(Lengths { settings, certificate }))
}

struct Lengths {
    settings: Settings,
    /// The file of the certificate.
    certificate: Option<PathBuf>,
}

/// The columns of one end: `X1`, `B1` or, if it is the same at both ends, `B`; `dir1_X`. Rotary axes that the file does
/// not mention stand at zero.
fn naming(end: usize) -> impl Fn(&StatusColumn, Option<&Axis>) -> (Vec<String>, Absent) {
    move |status, axis| {
        let name = &status.name;
        let numbered = status.column_of_pose(end);
        match axis.map(|axis| axis.kind) {
            Some(AxisKind::Linear) => (vec![numbered], status.absent),
            Some(AxisKind::Rotary) => (vec![numbered, name.clone()], Absent::Default(0.0)),
            None => (vec![numbered, name.clone()], status.absent),
        }
    }
}

impl Lengths {
    /// The certificate of the lengths, if there is one.
    fn read(&self) -> Result<Option<DigitalCertificate>> {
        let file = self.certificate.as_ref().zip(self.settings.certificate.as_ref());
        file.map(|(path, settings)| DigitalCertificate::read(path, settings)).transpose()
    }
}

impl Artefact for Lengths {
    fn inputs(&self) -> Vec<InputFile> {
        self.certificate.iter().map(|path| InputFile { setting: "certificate", path: path.clone() }).collect()
    }

    fn check(&self, headers: &[ColumnHeader], file: Option<&PathBuf>, model: &dyn KinematicModel) -> Result<()> {
        pose_columns(headers, file, model, &naming(1))?;
        pose_columns(headers, file, model, &naming(2))?;
        let has_reference = headers.iter().any(|header| header.name == "reference");
        match (self.read()?, self.settings.length) {
            (Some(certificate), _) => {
                certificate.tell();
                match has_reference {
                    true => abbe_table::require(headers, file, &[("reference", Quantity::Label)]),
                    false => certificate.only(Unit::MM).map(drop),
                }
            }
            (None, Length::Known) => abbe_table::require(headers, file, &[("reference", Quantity::Length)]),
            (None, Length::Estimated) => Ok(()),
        }
    }

    fn observe(&self, data: &Arc<Dataset>, model: &Arc<dyn KinematicModel>) -> Result<Arc<dyn Observations>> {
        let model = model.as_ref();
        let mut layout = Layout::new(data, model, &[&naming(1), &naming(2)])?;
        for row in data.row_indices() {
            layout.push(model, row, &[self.settings.standard_uncertainty_um * 1e-3])?;
        }
        if layout.rows.is_empty() {
            return Err(Error::data("there is no length"));
        }
        let known = self.settings.length == Length::Known;
        let certified = self.read()?.map(|certificate| Certified::new(certificate, data)).transpose()?;
        let references = match &certified {
            Some(certified) => certified.lengths(),
            None if known => data.required_numbers("reference")?.to_vec(),
            None => vec![0.0; data.rows()],
        };
        if let Some((row, reference)) =
            DataRow::enumerate(&references).find(|(_, reference)| known && **reference <= 0.0)
        {
            return Err(data.error_at(row, format!("the reference length is {reference} mm")));
        }
        let mut lengths = Measured {
            info: ObservationsInfo::new(layout, Vec::new(), Contact::LinearAxes),
            references,
            own: Vec::new(),
            calibrations: Vec::new(),
            certified: None,
            excess: None,
        };
        match self.settings.length {
            Length::Estimated => lengths.estimate(model)?,
            Length::Known => {
                lengths.info.rank_point = RankPoint::AsRecorded;
                match certified {
                    Some(certified) => {
                        lengths.info.inputs.clone_from(&certified.errors.inputs);
                        lengths.certified = Some(certified);
                    }
                    None => lengths.know(&self.settings),
                }
                lengths.expand(&self.settings)?;
            }
        }
        Ok(Arc::new(lengths))
    }

    fn targets(&self, _: f64) -> Result<Vec<Target>> {
        // Lengths lie anywhere in the workspace: the data rows are the programme.
        Ok(Vec::new())
    }
}

/// Measured lengths.
struct Measured {
    info: ObservationsInfo,
    references: Vec<f64>,
    /// The unknown of every row, if lengths are estimated.
    own: Vec<usize>,
    /// The known input of every row that is the error of its calibration, if lengths are known.
    calibrations: Vec<usize>,
    /// The certificate of known lengths, where there is one.
    certified: Option<Certified>,
    /// Index of the expansion coefficient (the error of the temperature follows it), and for every row the temperature
    /// above the reference temperature, K.
    excess: Option<(usize, Vec<f64>)>,
}

/// The name of an own quantity of the bar of a row.
fn of_bar(bars: Option<&[LabelText]>, row: DataRow, own: &str) -> String {
    bars.map_or(own.to_owned(), |bars| format!("bar[{}].{own}", bars[row]))
}

impl Measured {
    /// Makes the lengths known, except for the error of the bar's calibration.
    fn know(&mut self, settings: &Settings) {
        let data = self.info.layout.data.clone();
        let bars = data.labels("bar");
        for row in data.row_indices() {
            let name = of_bar(bars, row, "reference_error");
            let known = self.info.inputs.iter().position(|input| input.parameter.name == name).unwrap_or_else(|| {
                // Added to the reference; zero if the calibration is correct.
                let parameter = Parameter::new(name, Unit::MM);
                let uncertainty = settings.reference_standard_uncertainty_um * 1e-3;
                let content = self.certificate(bars, row, uncertainty);
                self.info
                    .inputs
                    .push(KnownInput::new(parameter, 0.0, uncertainty).with_certificate("reference_error", content));
                self.info.inputs.len() - 1
            });
            self.calibrations.push(known);
        }
    }

    /// Makes the known lengths expand from 20 °C.
    fn expand(&mut self, settings: &Settings) -> Result<()> {
        let data = self.info.layout.data.clone();
        let Some(expansion) = &settings.expansion else { return Ok(()) };
        if let Some(temperature) =
            expansion.temperature_degC.filter(|stated| !abbe_table::TEMPERATURES.contains(stated))
        {
            let [from, to] = [abbe_table::TEMPERATURES.start(), abbe_table::TEMPERATURES.end()];
            let message = format!("`temperature_degC` is {temperature}; {from} to {to} was expected");
            return Err(Error::usage(message).setting("expansion"));
        }
        let temperatures = match (data.column("T"), expansion.temperature_degC) {
            (Some(_), _) => data.required_numbers("T")?.to_vec(),
            (None, Some(temperature)) => vec![temperature; data.rows()],
            (None, None) => {
                let error = Error::usage("the temperature of the lengths is not known");
                return Err(error
                    .help("add a column `T_degC`, or `temperature_degC` under `expansion`")
                    .setting("expansion"));
            }
        };
        let excess = temperatures.iter().map(|temperature| temperature - REFERENCE_TEMPERATURE).collect();
        self.excess = Some((self.info.inputs.len(), excess));
        let known = |name: &str, of, value, standard_uncertainty| {
            let parameter = Parameter::new(name, Unit::of(of));
            KnownInput::new(parameter, value, standard_uncertainty)
        };
        self.info.inputs.extend([
            known(
                "expansion_coefficient",
                Quantity::PerTemperature,
                expansion.coefficient_per_K,
                expansion.standard_uncertainty_per_K,
            ),
            known("temperature_error", Quantity::Temperature, 0.0, expansion.temperature_standard_uncertainty_K),
        ]);
        Ok(())
    }

    /// What the certificate of the bar of a row says: its label and the lengths that it has.
    fn certificate(&self, bars: Option<&[LabelText]>, row: DataRow, uncertainty: f64) -> String {
        let of_bar = |other: &DataRow| bars.is_none_or(|bars| bars[*other] == bars[row]);
        let mut lengths: Vec<f64> =
            DataRow::first(self.references.len()).filter(of_bar).map(|row| self.references[row]).collect();
        lengths.sort_by(f64::total_cmp);
        lengths.dedup();
        format!("bar {}: {lengths:?} mm, u = {uncertainty:e} mm", bars.map_or("", |bars| &bars[row]))
    }

    /// The known length of a row, and its derivatives to known inputs.
    fn reference(&self, RowIndex(row): RowIndex, inputs: &[f64]) -> (f64, Vec<(usize, f64)>) {
        let nominal = self.references[row];
        let mut derivatives = match &self.certified {
            Some(certified) => certified.of(row).to_vec(),
            None => vec![(self.calibrations[row], 1.0)],
        };
        let mut length = nominal + derivatives.iter().map(|(input, factor)| inputs[*input] * factor).sum::<f64>();
        if let Some((first, excess)) = &self.excess {
            let (coefficient, excess) = (inputs[*first], excess[row] + inputs[first + 1]);
            length += nominal * coefficient * excess;
            derivatives.extend([(*first, nominal * excess), (first + 1, nominal * coefficient)]);
        }
        (length, derivatives)
    }

    /// Makes the lengths unknown. They start from the lengths of the nominal machine.
    fn estimate(&mut self, model: &dyn KinematicModel) -> Result<()> {
        let data = self.info.layout.data.clone();
        let bars = data.labels("bar");
        let mut counts: Vec<f64> = Vec::new();
        let mut poses = Poses::default();
        let nominal = &model.info().nominal;
        for (row, layout) in data.row_indices().zip(&self.info.layout.rows) {
            let name = of_bar(bars, row, "length");
            let own = self.info.unknowns.iter().position(|unknown| unknown.name == name).unwrap_or_else(|| {
                self.info.unknowns.push(Parameter::new(name, Unit::MM).with_role(ParameterRole::Feature));
                self.info.start.push(0.0);
                counts.push(0.0);
                self.info.unknowns.len() - 1
            });
            self.own.push(own);
            let ends =
                [self.info.layout.poses.row(layout.first_pose), self.info.layout.poses.row(layout.first_pose + 1)]
                    .concat();
            model.poses(&ends, nominal, &[], false, &mut poses)?;
            self.info.start[own] += (Vector3::from(poses.positions[1]) - Vector3::from(poses.positions[0])).norm();
            counts[own] += 1.0;
        }
        for (start, count) in self.info.start.iter_mut().zip(counts) {
            *start /= count;
        }
        Ok(())
    }
}

impl Observations for Measured {
    fn info(&self) -> &ObservationsInfo {
        &self.info
    }

    fn evaluate(&self, batch: RowBatch<'_>, out: &mut Equations) -> Result<()> {
        for (&row, ends) in batch.rows.iter().zip(batch.positions.chunks_exact(2)) {
            let between = Vector3::from(ends[1]) - Vector3::from(ends[0]);
            let direction = between.normalize();
            match self.own.get(row.0) {
                Some(&unknown) => {
                    out.equation(between.norm() - batch.own[unknown]);
                    out.own(unknown, -1.0);
                }
                None => {
                    let (length, derivatives) = self.reference(row, batch.inputs);
                    out.equation(between.norm() - length);
                    derivatives.iter().for_each(|&(input, derivative)| out.input(input, -derivative));
                }
            }
            out.position((-direction).into());
            out.position(direction.into());
        }
        Ok(())
    }
}
