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
    for Statement { line, text: statement, has_gap } in statements(path, text)? {
        let wrong = |message: String| Error::data(message).at(path, line, Some(1));
        if let Some(rest) = statement.strip_prefix("UNITS/") {
            scale = Some(stated(rest, units).map_err(wrong)?);
        }
        let Some((name, definition)) = named(&statement).map_err(wrong)? else { continue };
        let is_actual = statement.starts_with("FA(");
        if has_gap {
            return Err(wrong(format!("there is a blank within a number of `{}`", shown(&statement))));
        }
        let Some((kind, cells)) = cells(definition).map_err(wrong)? else {
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
        if !kind.numbers.contains(&numbers.len()) {
            let expected: Vec<String> = kind.numbers.iter().map(usize::to_string).collect();
            return Err(wrong(format!(
                "`{}` has {} numbers; {} were expected",
                shown(&statement),
                numbers.len(),
                expected.join(" or ")
            )));
        }
        let diameter = kind.diameter.map(|place| numbers[place.min(numbers.len() - 1)]);
        if let Some(diameter) = diameter.filter(|diameter| *diameter <= 0.0) {
            return Err(wrong(format!(
                "`{}` has a diameter of {diameter}; one above 0 was expected",
                shown(&statement)
            )));
        }
        let at = [0, 1, 2].map(|k| numbers[k] * scale);
        let feature = Feature { line, kind: kind.name, at, diameter: diameter.unwrap_or(0.0) * scale };
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
    let mut remarks = Vec::new();
    if others > 0 {
        remarks.push(format!("{others} measured features are no point, sphere, circle or cylinder, and are left out"));
    }
    let missing: Vec<&str> =
        nominal.keys().filter(|name| !found.iter().any(|(own, _)| own == *name)).map(String::as_str).collect();
    if let (false, [first, ..]) = (found.is_empty(), missing.as_slice()) {
        remarks.push(format!(
            "{} of {} nominal features were not measured, the first is F({first})",
            missing.len(),
            nominal.len()
        ));
    }
    Ok((rows.finish("measured point, sphere, circle or cylinder (FA)")?, remarks))
}

/// A statement.
struct Statement {
    /// The line in which it begins.
    line: usize,
    /// Quoted texts as they are, all else in capitals and without blanks.
    text: String,
    /// Whether a blank that was left out stood between digits.
    has_gap: bool,
}

/// All statements: a `$` at the end goes on in the next line, `$$` begins a comment.
fn statements(path: &Path, text: &str) -> Result<Vec<Statement>> {
    let mut statements: Vec<Statement> = Vec::new();
    let mut goes_on = false;
    let mut last = 0;
    for (index, line) in text.lines().enumerate() {
        let content = line.split("$$").next().unwrap_or_default().trim();
        if content.is_empty() {
            continue;
        }
        let (content, more) = content.strip_suffix('$').map_or((content, false), |content| (content, true));
        let (mut is_quoted, mut is_gap, mut has_gap) = (false, false, false);
        let mut compact = String::new();
        let is_of_number = |letter: char| letter.is_ascii_digit() || letter == '.';
        for letter in content.chars() {
            is_quoted ^= letter == '\'';
            if !is_quoted && letter.is_whitespace() {
                is_gap = true;
                continue;
            }
            let goes_on = is_of_number(letter) || "+-".contains(letter);
            has_gap |= is_gap && goes_on && compact.chars().next_back().is_some_and(is_of_number);
            is_gap = false;
            compact.push(if is_quoted { letter } else { letter.to_ascii_uppercase() });
        }
        match statements.last_mut().filter(|_| goes_on) {
            Some(statement) => {
                statement.text.push_str(&compact);
                statement.has_gap |= has_gap;
            }
            None => statements.push(Statement { line: index + 1, text: compact, has_gap }),
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

/// Name and definition of `F(name)=FEAT/..` or `FA(name)=FEAT/..`; none for other statements.
///
/// Fails for one that is damaged: it begins as one, or has a definition.
fn named(statement: &str) -> Result<Option<(&str, &str)>, String> {
    let rest = statement.strip_prefix("FA(").or_else(|| statement.strip_prefix("F("));
    let found = rest.and_then(|rest| rest.split_once(")=FEAT/")).filter(|(name, _)| !name.is_empty());
    // What is quoted is a text.
    let defines = || statement.split('\'').step_by(2).any(|part| part.contains("FEAT/"));
    match found {
        None if rest.is_some() || defines() => {
            Err(format!("`{}` is no feature; F(NAME)=FEAT/.. or FA(NAME)=FEAT/.. was expected", shown(statement)))
        }
        found => Ok(found),
    }
}

/// Units of lengths, in mm.
const LENGTHS: [(&str, f64); 5] = [("MM", 1.0), ("CM", 10.0), ("M", 1000.0), ("INCH", 25.4), ("FEET", 304.8)];

/// The unit of lengths of a statement `UNITS/`.
fn stated(rest: &str, units: Option<Units>) -> Result<f64, String> {
    let length = |word: &str| LENGTHS.iter().find(|(name, _)| *name == word).map(|(_, scale)| *scale);
    let mut words = rest.split(',');
    let written = words.next().unwrap_or_default();
    let stated = length(written)
        .ok_or_else(|| format!("UNITS is `{}`; MM, CM, M, INCH or FEET was expected", shown(written)))?;
    if let Some(second) = words.find(|word| length(word).is_some()) {
        return Err(format!("UNITS has two units of lengths, {written} and {second}"));
    }
    match units {
        Some(units) if units.scale() != stated => {
            Err(format!("UNITS is {written}, and `units` of the recipe says {}", units.name()))
        }
        _ => Ok(stated),
    }
}

/// A kind of features.
struct FeatureKind {
    word: &'static str,
    name: &'static str,
    /// How many numbers its definition may have: the place, and mostly a direction; a cylinder may have a length at the end.
    numbers: &'static [usize],
    /// Where its diameter stands if all are there; else it is the last one.
    diameter: Option<usize>,
}

const KINDS: [FeatureKind; 4] = [
    FeatureKind { word: "POINT", name: "point", numbers: &[3, 6], diameter: None },
    FeatureKind { word: "SPHERE", name: "sphere", numbers: &[4], diameter: Some(3) },
    FeatureKind { word: "CIRCLE", name: "circle", numbers: &[4, 7], diameter: Some(6) },
    FeatureKind { word: "CYLNDR", name: "cylinder", numbers: &[4, 7, 8], diameter: Some(6) },
];

/// What a definition says: the kind, and its numbers as written; none for kinds that have no centre.
fn cells(definition: &str) -> Result<Option<(&'static FeatureKind, Vec<&str>)>, String> {
    let mut words: Vec<&str> = definition.split(',').collect();
    let Some(kind) = KINDS.iter().find(|kind| kind.word == words[0]) else { return Ok(None) };
    words.remove(0);
    if words.first().is_some_and(|word| ["INNER", "OUTER"].contains(word)) {
        words.remove(0);
    }
    match words.first().copied() {
        Some("CART") => {
            words.remove(0);
            Ok(Some((kind, words)))
        }
        other => {
            Err(format!("`{}` instead of CART: only Cartesian coordinates are read", shown(other.unwrap_or_default())))
        }
    }
}
