//! Estimator plugin `stated`: what a report states of a machine, such as that of a laser interferometer, or a truth.
//!
//! Values with a standard uncertainty count as estimated, and as independent of each other unless a certificate states their covariance;
//! those without one are exact. A
//! parameter that is not stated keeps its nominal value without an uncertainty.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use abbe_core::{
    Calibration, Context, DataRow, Dataset, Error, Estimate, EstimateSource, FitReport, Identifiability, InputFile,
    PathItem, Problem, Result, SettingsError, Unit, matches,
};
use abbe_dcc::{CertificateFile, DigitalCertificate, ValueIndex};
use abbe_estimation::calibration;
use abbe_files::{LARGEST_RESULT, read_text};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

abbe_core::register!(
    Estimate,
    "stated",
    "takes what a report or a truth states of a machine: values with standard uncertainties",
    Settings,
    example,
    build,
    "../reference/estimate-stated.md",
    EstimateSource::Statement,
);

/// Settings of stated values.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// A CSV file with the columns `parameter`, `value`, `unit` and, unless all is exact, `standard_uncertainty`; or a JSON
    /// file with `parameters` and perhaps `standard_uncertainties` by name, in mm and rad.
    #[serde(default)]
    path: Option<String>,
    /// A digital calibration certificate of the machine, such as `export: dcc` writes: the values that it labels with names of
    /// parameters, with their covariance. `item` is the serial number of the machine.
    #[serde(default)]
    certificate: Option<CertificateFile>,
    /// The stated values, by the name of the parameter.
    #[serde(default)]
    values: BTreeMap<String, Stated>,
    /// Names and patterns in the file or the certificate that are ignored, such as those of artefacts.
    #[serde(default)]
    ignore: Vec<String>,
}

/// The stated value of one parameter.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Stated {
    /// Its value.
    value: f64,
    /// Its standard uncertainty. Default: the value is exact.
    #[serde(default)]
    standard_uncertainty: f64,
    /// Unit of both: as in calibration files (`mm`, `rad`, `mm/mm`) or as people read it (`um`, `urad`, `um/m`).
    unit: String,
}

fn example() -> Value {
    json!({ "values": { "EXX[1]": { "value": -8.6, "standard_uncertainty": 0.4, "unit": "um/m" } } })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Estimate>, SettingsError> {
    if settings.path.is_none() && settings.certificate.is_none() && settings.values.is_empty() {
        return Err(SettingsError::new("", "`path`, `certificate` or `values` was expected: what is stated?"));
    }
    if !settings.ignore.is_empty() && settings.path.is_none() && settings.certificate.is_none() {
        let message = "there is no file of which something could be ignored";
        return Err(SettingsError::new("ignore", message).help("leave out `ignore`, and `values` that do not count"));
    }
    let certificate = settings.certificate.as_ref().map(|certificate| certificate.path(context)).transpose();
    let certificate = certificate.map_err(|error| error.under([PathItem::Key("certificate".to_owned())]))?;
    for (name, stated) in &settings.values {
        let at = |error: SettingsError| error.under(["values", name].map(|key| PathItem::Key(key.to_owned())));
        if !(stated.standard_uncertainty >= 0.0 && stated.standard_uncertainty.is_finite()) {
            return Err(at(SettingsError::new("standard_uncertainty", "a number of at least zero was expected")));
        }
        if !stated.value.is_finite() {
            return Err(at(SettingsError::new("value", "a finite number was expected")));
        }
    }
    Ok(Box::new(Statement { path: settings.path.as_ref().map(|path| context.path(path)), certificate, settings }))
}

struct Statement {
    path: Option<PathBuf>,
    /// The file of the certificate.
    certificate: Option<PathBuf>,
    settings: Settings,
}

/// A parameter with value and standard uncertainty in the unit that it has in memory, and where that stands.
struct Entry {
    name: String,
    value: f64,
    standard_uncertainty: f64,
    /// Its value in the certificate, if it is from there.
    certified: Option<ValueIndex>,
    /// The place of an error about it in messages.
    place: Box<dyn Fn(String) -> Error>,
}

/// The factor from a stated unit to that of a parameter; None if it is a unit of something else.
fn factor(stated: &str, unit: Unit) -> Option<f64> {
    let (people, factor) = unit.for_people();
    let mut written = String::new();
    for letter in people.chars() {
        match letter {
            'µ' => written.push('u'),
            '²' => written.push_str("^2"),
            '³' => written.push_str("^3"),
            '⁴'..='⁹' => written.push_str(&format!("^{}", letter as u32 - '⁰' as u32)),
            other => written.push(other),
        }
    }
    match stated {
        _ if stated == unit.to_string() => Some(1.0),
        _ if stated == people || stated == written => Some(1.0 / factor),
        _ => None,
    }
}

impl Statement {
    /// Everything that is stated of the parameters of a problem.
    fn entries(&self, problem: &Problem, certificate: Option<&DigitalCertificate>) -> Result<Vec<Entry>> {
        let mut entries = match &self.path {
            None => Vec::new(),
            Some(path) if path.extension().is_some_and(|extension| extension == "json") => {
                of_json(path)?.into_iter().filter(|entry| !self.ignores(&entry.name)).collect()
            }
            Some(path) => self.of_table(path, problem)?,
        };
        if let Some(certificate) = certificate {
            entries.extend(self.of_certificate(certificate, problem)?);
        }
        for (name, stated) in &self.settings.values {
            let at = |message: String, key: &str| {
                let mut error = Error::usage(message);
                error.setting = ["values", name, key].map(|key| PathItem::Key(key.to_owned())).to_vec();
                error.setting.retain(|item| *item != PathItem::Key(String::new()));
                error
            };
            let place = {
                let name = name.clone();
                move |message: String| {
                    let mut error = Error::usage(message);
                    error.setting = ["values", &name].map(|key| PathItem::Key(key.to_owned())).to_vec();
                    error
                }
            };
            let unit = self.unit(name, problem).map_err(&place)?;
            let factor = factor(&stated.unit, unit).ok_or_else(|| at(wrong_unit(name, &stated.unit, unit), "unit"))?;
            let (value, standard_uncertainty) = (stated.value * factor, stated.standard_uncertainty * factor);
            entries.push(Entry {
                name: name.clone(),
                value,
                standard_uncertainty,
                certified: None,
                place: Box::new(place),
            });
        }
        Ok(entries)
    }

    fn unit(&self, name: &str, problem: &Problem) -> Result<Unit, String> {
        let parameters = &problem.model.info().parameters;
        let found = parameters.iter().find(|parameter| parameter.name == *name);
        found.map(|parameter| parameter.unit).ok_or_else(|| no_parameter(name, problem))
    }

    /// The rows of a table.
    fn of_table(&self, path: &Path, problem: &Problem) -> Result<Vec<Entry>> {
        let table = abbe_table::read(path)?;
        let labels = |column: &str| table.required_labels(column);
        let (names, values, units) = (labels("parameter")?, labels("value")?, labels("unit")?);
        abbe_table::unique_labels(&table, "parameter")?;
        let uncertainties = table.labels("standard_uncertainty");
        let mut entries = Vec::new();
        for (row, name) in DataRow::enumerate(names).filter(|(_, name)| !self.ignores(name)) {
            let unit = self.unit(name, problem).map_err(|message| table.error_at(row, message))?;
            let factor = factor(&units[row], unit);
            let factor = factor.ok_or_else(|| table.error_at(row, wrong_unit(name, &units[row], unit)))?;
            let value = number(&table, row, &values[row])? * factor;
            let standard_uncertainty = match uncertainties {
                Some(cells) => number(&table, row, &cells[row])? * factor,
                None => 0.0,
            };
            let (file, line) = (path.to_owned(), table.origins[row].line);
            let place = Box::new(move |message: String| Error::data(message).at(&file, line, None));
            entries.push(Entry { name: name.to_string(), value, standard_uncertainty, certified: None, place });
        }
        Ok(entries)
    }

    /// The certificate, if there is one.
    fn read(&self) -> Result<Option<DigitalCertificate>> {
        let file = self.certificate.as_ref().zip(self.settings.certificate.as_ref());
        let certificate = file.map(|(path, settings)| DigitalCertificate::read(path, settings)).transpose()?;
        if let Some(certificate) = &certificate {
            certificate.tell();
        }
        Ok(certificate)
    }

    /// The values of a certificate.
    fn of_certificate(&self, certificate: &DigitalCertificate, problem: &Problem) -> Result<Vec<Entry>> {
        let entry = |name: &str| {
            let file = certificate.file.clone();
            let place = move |message: String| Error::data(message).in_file(&file);
            let unit = self.unit(name, problem).map_err(&place)?;
            let index = certificate.of_unit(name, unit)?;
            let (value, standard_uncertainty) = (certificate.value(index), certificate.standard_uncertainty(index));
            let name = name.to_owned();
            Ok(Entry { name, value, standard_uncertainty, certified: Some(index), place: Box::new(place) })
        };
        certificate.labels().filter(|name| !self.ignores(name)).map(entry).collect()
    }

    fn ignores(&self, name: &str) -> bool {
        self.settings.ignore.iter().any(|pattern| matches(pattern, name))
    }

    fn calibration(&self, problem: &Problem) -> Result<Calibration> {
        let mut problem = problem.clone();
        let certificate = self.read()?;
        let mut uncertain: BTreeMap<String, (f64, Option<ValueIndex>)> = BTreeMap::new();
        let mut seen: Vec<String> = Vec::new();
        for Entry { name, value, standard_uncertainty, certified, place } in
            self.entries(&problem, certificate.as_ref())?
        {
            let parameters = &problem.model.info().parameters;
            let index = parameters.iter().position(|parameter| parameter.name == name);
            let index = index.ok_or_else(|| place(no_parameter(&name, &problem)))?;
            if seen.contains(&name) {
                return Err(place(format!("`{name}` is stated twice")));
            }
            if !(standard_uncertainty >= 0.0 && standard_uncertainty.is_finite() && value.is_finite()) {
                return Err(place(format!(
                    "`{name}` needs a finite value with a standard uncertainty of at least zero"
                )));
            }
            problem.machine_values[index] = value;
            if standard_uncertainty > 0.0 {
                uncertain.insert(name.clone(), (standard_uncertainty, certified));
            }
            seen.push(name);
        }
        let problem = problem.without_unknowns(|unknown| !uncertain.contains_key(&unknown.name));
        let (x, count) = (problem.start(), problem.unknowns.len());
        let stated = |unknown: usize| uncertain[&problem.unknowns[unknown].name];
        let joint = |row: usize, column: usize| {
            certificate
                .as_ref()
                .zip(stated(row).1.zip(stated(column).1))
                .map_or(0.0, |(certificate, (one, other))| certificate.covariance(one, other))
        };
        let variance = |row: usize, column: usize| match row == column {
            true => stated(row).0.powi(2),
            false => joint(row, column),
        };
        let covariance = (0..count).map(|row| (0..count).map(|column| variance(row, column)).collect()).collect();
        Ok(calibration(&problem, &x, covariance, Vec::new(), FitReport::without_rows(count)))
    }
}

fn no_parameter(name: &str, problem: &Problem) -> String {
    let names = problem.model.info().parameters.iter().map(|parameter| parameter.name.as_str());
    match abbe_core::nearest(name, names) {
        Some(near) => format!("`{name}` is no parameter of the machine; did you mean `{near}`?"),
        None => format!(
            "`{name}` is no parameter of the machine: a machine parameter exists only if the model's `errors` list it; what is of \
             no concern is named under `ignore`"
        ),
    }
}

fn wrong_unit(name: &str, given: &str, unit: Unit) -> String {
    format!("`{given}` is no unit of `{name}`; `{unit}` or `{}` was expected", unit.for_people().0)
}

fn number(table: &Dataset, row: DataRow, cell: &str) -> Result<f64> {
    cell.trim().parse().map_err(|_| table.error_at(row, format!("`{cell}` is not a number")))
}

/// The names and numbers of a truth, in mm and rad.
fn of_json(path: &Path) -> Result<Vec<Entry>> {
    let file = path.to_owned();
    let wrong = move |message: String| Error::data(message).in_file(&file);
    let text = read_text(path, LARGEST_RESULT).map_err(|error| wrong(format!("the file cannot be read: {error}")))?;
    let value: Value = serde_json::from_str(&text).map_err(|error| {
        let (line, column) = (error.line(), error.column());
        Error::data(format!("this is not a JSON file: {error}")).at(path, line, Some(column))
    })?;
    let numbers = |key: &str| -> Result<BTreeMap<String, f64>> {
        let Some(map) = value.get(key) else { return Ok(BTreeMap::new()) };
        let map = map.as_object().ok_or_else(|| wrong(format!("`{key}` has to be a map of names to numbers")))?;
        let number = |(name, value): (&String, &Value)| {
            let number = value.as_f64().ok_or_else(|| wrong(format!("`{key}`: `{name}` is not a number")));
            Ok((name.clone(), number?))
        };
        map.iter().map(number).collect()
    };
    let (values, uncertainties) = (numbers("parameters")?, numbers("standard_uncertainties")?);
    if values.is_empty() {
        return Err(wrong("`parameters` is missing: a map of names to numbers in mm and rad".to_owned()));
    }
    if let Some(name) = uncertainties.keys().find(|name| !values.contains_key(*name)) {
        return Err(wrong(format!("`{name}` has a standard uncertainty and no value")));
    }
    let entry = |(name, value): (String, f64)| {
        let standard_uncertainty = uncertainties.get(&name).copied().unwrap_or(0.0);
        Entry { name, value, standard_uncertainty, certified: None, place: Box::new(wrong.clone()) }
    };
    Ok(values.into_iter().map(entry).collect())
}

impl Estimate for Statement {
    fn inputs(&self) -> Vec<InputFile> {
        let file = |setting: &'static str, path: &Option<PathBuf>| path.clone().map(|path| InputFile { setting, path });
        file("path", &self.path).into_iter().chain(file("certificate", &self.certificate)).collect()
    }

    fn estimate(&self, problem: &Problem) -> Result<Calibration> {
        if !problem.sets.is_empty() {
            return Err(Error::usage("what is stated is not made of measurements: it cannot be made again"));
        }
        self.calibration(problem)
    }

    fn identify(&self, _: &Problem) -> Result<Identifiability> {
        Err(Error::usage("what is stated is not made of measurements: there is nothing to judge beforehand"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use abbe_core::Quantity;

    #[test]
    fn units_are_those_of_files_or_of_people() {
        let squared = Unit::per(Quantity::Length, Quantity::Length, 2);
        let cases = [
            ("mm", Unit::MM, Some(1.0)),
            ("um", Unit::MM, Some(1e-3)),
            ("µm", Unit::MM, Some(1e-3)),
            ("urad", Unit::RAD, Some(1e-6)),
            ("um/m^2", squared, Some(1e-9)),
            ("mm/mm^2", squared, Some(1.0)),
            ("um/m", squared, None),
            ("mm", Unit::RAD, None),
        ];
        for (stated, unit, expected) in cases {
            match (factor(stated, unit), expected) {
                (Some(found), Some(expected)) => assert!((found / expected - 1.0).abs() < 1e-12, "{stated}"),
                (found, expected) => assert_eq!(found, expected, "{stated}"),
            }
        }
    }
}
