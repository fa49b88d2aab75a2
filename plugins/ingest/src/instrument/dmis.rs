//! Ingest plugin `dmis-output`: features that a coordinate measuring machine reports (DMIS output, ISO 22093).

use std::collections::BTreeMap;
use std::path::Path;

use abbe_core::{Context, Dataset, Error, Ingest, Result, SettingsError};
use serde_json::{Value, json};

use super::table::{Rows, Settings, Units, no_unit, number, stage};
use crate::log::shown;

abbe_core::register!(
    Ingest,
    "dmis-output",
    "reads measured features of a DMIS output file",
    Settings,
    example,
    build,
    "../../reference/ingest-dmis-output.md",
);

fn example() -> Value {
    json!({ "path": "plate.dmo", "keep": { "kind": ["sphere"] } })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Ingest>, SettingsError> {
    stage(settings, context, read)
}

/// A feature: its kind, centre or point, and diameter where it has one.
#[derive(Debug, Clone)]
struct Feature {
    line: usize,
    kind: &'static str,
    at: [f64; 3],
    diameter: f64,
}

pub(crate) fn read(path: &Path, text: &str, units: Option<Units>) -> Result<(Dataset, Vec<String>)> {
    let (mut scale, mut nominal) = (units.map(Units::scale), BTreeMap::new());
    let mut actual: BTreeMap<String, usize> = BTreeMap::new();
    let mut found: Vec<(String, Feature)> = Vec::new();
    let mut others = 0;
    for (line, statement) in statements(path, text)? {
        let wrong = |message: String| Error::data(message).at(path, line, Some(1));
        if let Some(rest) = statement.strip_prefix("UNITS/") {
            scale = Some(stated(rest, units).map_err(wrong)?);
        }
        let Some((name, definition)) = named(&statement) else { continue };
        let is_actual = statement.starts_with("FA(");
        if !definition.starts_with("FEAT/") {
            continue;
        }
        let Some((kind, cells, has_diameter)) = cells(definition).map_err(wrong)? else {
            others += usize::from(is_actual);
            continue;
        };
        let scale = scale.ok_or_else(|| no_unit(path))?;
        let mut numbers = Vec::new();
        for cell in &cells {
            numbers.push(
                number(cell)
                    .ok_or_else(|| wrong(format!("`{}` is no number in `{}`", shown(cell), shown(&statement))))?,
            );
        }
        let needed = if has_diameter { 4 } else { 3 };
        if numbers.len() < needed {
            return Err(wrong(format!(
                "`{}` has {} numbers; {needed} were expected",
                shown(&statement),
                numbers.len()
            )));
        }
        let diameter = if has_diameter { numbers.last().copied().unwrap_or(0.0) * scale } else { 0.0 };
        let feature = Feature { line, kind, at: [0, 1, 2].map(|k| numbers[k] * scale), diameter };
        match is_actual {
            false => {
                nominal.insert(name.to_owned(), feature);
            }
            true => {
                if let Some(first) = actual.insert(name.to_owned(), line) {
                    let error = wrong(format!("FA({name}) stands in line {first} already"));
                    return Err(error.help("give each run a file of its own"));
                }
                found.push((name.to_owned(), feature));
            }
        }
    }
    table(path, &found, &nominal, others)
}

fn table(
    path: &Path,
    found: &[(String, Feature)],
    nominal: &BTreeMap<String, Feature>,
    others: usize,
) -> Result<(Dataset, Vec<String>)> {
    let has_nominal = !found.is_empty() && found.iter().all(|(name, _)| nominal.contains_key(name));
    let mut columns = vec!["feature", "point", "kind", "X_mm", "Y_mm", "Z_mm", "diameter_mm"];
    if has_nominal {
        columns.extend(["x_mm", "y_mm", "z_mm"]);
    }
    let mut rows = Rows::new(path, &columns);
    for (name, feature) in found {
        let mut numbers = feature.at.to_vec();
        numbers.push(feature.diameter);
        if let Some(nominal) = nominal.get(name).filter(|_| has_nominal) {
            if nominal.kind != feature.kind {
                let message = format!("FA({name}) is a {}, and F({name}) is a {}", feature.kind, nominal.kind);
                return Err(Error::data(message).at(path, feature.line, Some(1)));
            }
            numbers.extend(nominal.at);
        }
        rows.push(feature.line, &[name, name, feature.kind], &numbers);
    }
    let remark = format!("{others} measured features are no point, sphere, circle or cylinder, and are left out");
    Ok((
        rows.finish("measured point, sphere, circle or cylinder (FA)")?,
        if others > 0 { vec![remark] } else { Vec::new() },
    ))
}

/// Statements with the line in which each begins: a `$` at the end goes on in the next line, `$$` begins a comment. Quoted texts
/// stay as they are, all else is in capitals and without blanks.
fn statements(path: &Path, text: &str) -> Result<Vec<(usize, String)>> {
    let mut statements: Vec<(usize, String)> = Vec::new();
    let mut goes_on = false;
    let mut last = 0;
    for (index, line) in text.lines().enumerate() {
        let content = line.split("$$").next().unwrap_or_default().trim();
        if content.is_empty() {
            continue;
        }
        let (content, more) = content.strip_suffix('$').map_or((content, false), |content| (content, true));
        let mut is_quoted = false;
        let mut compact = String::new();
        for letter in content.chars() {
            is_quoted ^= letter == '\'';
            if is_quoted || !letter.is_whitespace() {
                compact.push(if is_quoted { letter } else { letter.to_ascii_uppercase() });
            }
        }
        match statements.last_mut().filter(|_| goes_on) {
            Some((_, statement)) => statement.push_str(&compact),
            None => statements.push((index + 1, compact)),
        }
        (goes_on, last) = (more, index + 1);
    }
    match goes_on {
        true => Err(Error::data("the file ends in a statement that goes on (`$`)")
            .at(path, last, None)
            .help("is the file cut?")),
        false => Ok(statements),
    }
}

/// Name and definition of `F(name)=..` or `FA(name)=..`.
fn named(statement: &str) -> Option<(&str, &str)> {
    let rest = statement.strip_prefix("FA(").or_else(|| statement.strip_prefix("F("))?;
    rest.split_once(")=")
}

/// The unit of lengths of a statement `UNITS/`.
fn stated(rest: &str, units: Option<Units>) -> Result<f64, String> {
    let written = rest.split(',').next().unwrap_or_default();
    let stated = match written {
        "MM" => 1.0,
        "CM" => 10.0,
        "M" => 1000.0,
        "INCH" => 25.4,
        "FEET" => 304.8,
        _ => return Err(format!("UNITS is `{}`; MM, CM, M, INCH or FEET was expected", shown(written))),
    };
    match units {
        Some(units) if units.scale() != stated => {
            Err(format!("UNITS is {written}, and `units` of the recipe says {}", units.name()))
        }
        _ => Ok(stated),
    }
}

/// Kind, numbers as written, and whether the last is a diameter.
type Cells<'a> = (&'static str, Vec<&'a str>, bool);

/// What a definition says; none for kinds that have no centre.
fn cells(definition: &str) -> Result<Option<Cells<'_>>, String> {
    let mut words: Vec<&str> = definition["FEAT/".len()..].split(',').collect();
    let (kind, has_diameter) = match words[0] {
        "POINT" => ("point", false),
        "SPHERE" => ("sphere", true),
        "CIRCLE" => ("circle", true),
        "CYLNDR" => ("cylinder", true),
        _ => return Ok(None),
    };
    words.remove(0);
    if words.first().is_some_and(|word| ["INNER", "OUTER"].contains(word)) {
        words.remove(0);
    }
    match words.first().copied() {
        Some("CART") => {
            words.remove(0);
            Ok(Some((kind, words, has_diameter)))
        }
        other => {
            Err(format!("`{}` instead of CART: only Cartesian coordinates are read", shown(other.unwrap_or_default())))
        }
    }
}
