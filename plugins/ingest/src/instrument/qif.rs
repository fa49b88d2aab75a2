//! Ingest plugin `qif-results`: measured features of results in the Quality Information Framework (QIF 3, ISO 23952).

use std::collections::BTreeMap;
use std::path::Path;

use abbe_core::{Context, Dataset, Error, Ingest, Result, SettingsError};
use roxmltree::{Document, Node, TextPos};
use serde_json::{Value, json};

use super::table::{Rows, Settings, Units, no_unit, number, stage};
use crate::log::shown;

abbe_core::register!(
    Ingest,
    "qif-results",
    "reads measured features of QIF 3 results",
    Settings,
    example,
    build,
    "../../reference/ingest-qif-results.md",
);

fn example() -> Value {
    json!({ "path": "plate.qif", "keep": { "kind": ["circle"] } })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Ingest>, SettingsError> {
    stage(settings, context, read)
}

/// Names of units of length, in small letters, and their size, mm.
const NAMED: [(&[&str], f64); 5] = [
    (&["m", "meter", "metre"], 1000.0),
    (&["cm", "centimeter", "centimetre"], 10.0),
    (&["mm", "millimeter", "millimetre"], 1.0),
    (&["um", "µm", "micrometer", "micrometre", "micron"], 1e-3),
    (&["in", "inch", "inches"], 25.4),
];

/// Elements with a measured feature that has a point or a centre, and their kinds.
const KINDS: [(&str, &str); 4] = [
    ("PointFeatureMeasurement", "point"),
    ("EdgePointFeatureMeasurement", "edge-point"),
    ("SphereFeatureMeasurement", "sphere"),
    ("CircleFeatureMeasurement", "circle"),
];

/// A document, and the unit of its lengths.
struct Qif<'a> {
    path: &'a Path,
    document: &'a Document<'a>,
    scale: f64,
}

/// Name and nominal point of each feature, by the id of its item.
type Items<'a> = BTreeMap<&'a str, (&'a str, Option<[f64; 3]>)>;

/// A measured feature.
struct Measured<'a> {
    line: usize,
    run: String,
    name: String,
    kind: &'static str,
    at: [f64; 3],
    diameter: f64,
    nominal: Option<&'a [f64; 3]>,
}

pub(crate) fn read(path: &Path, text: &str, units: Option<Units>) -> Result<(Dataset, Vec<String>)> {
    let document = Document::parse(text).map_err(|error| {
        let place = error.pos();
        let error = Error::data(format!("the file is no XML: {error}"));
        error.at(path, place.row as usize, Some(place.col as usize)).help("is the file cut?")
    })?;
    if let Some(place) = divided(&document) {
        let error = Error::data("a comment inside of a text");
        return Err(error.at(path, place.row as usize, Some(place.col as usize)).help("take it out"));
    }
    let root = document.root_element();
    let version = root.attribute("versionQIF").unwrap_or_default();
    if root.tag_name().name() != "QIFDocument" || !version.starts_with("3.") {
        let found = format!("<{} versionQIF=\"{}\">", root.tag_name().name(), shown(version));
        let error = Error::data(format!("the document is {found}; a QIFDocument of version 3 was expected"));
        return Err(error.in_file(path));
    }
    let mut qif = Qif { path, document: &document, scale: 1.0 };
    qif.scale = qif.unit(root, units)?;
    let nominal = qif.nominal(root)?;
    let (measured, others) = qif.measured(root, &nominal)?;
    let has_nominal = !measured.is_empty() && measured.iter().all(|feature| feature.nominal.is_some());
    let mut columns = vec!["feature", "point", "kind", "run", "X_mm", "Y_mm", "Z_mm", "diameter_mm"];
    if has_nominal {
        columns.extend(["x_mm", "y_mm", "z_mm"]);
    }
    let mut rows = Rows::new(path, &columns);
    for feature in &measured {
        let mut numbers = feature.at.to_vec();
        numbers.push(feature.diameter);
        numbers.extend(feature.nominal.filter(|_| has_nominal).into_iter().flatten());
        rows.push(feature.line, &[&feature.name, &feature.name, feature.kind, &feature.run], &numbers);
    }
    let remark = format!("{others} measured features are no point, sphere or circle, and are left out");
    let data = rows.finish("measured point, sphere or circle")?;
    Ok((data, if others > 0 { vec![remark] } else { Vec::new() }))
}

/// Where a comment, or an instruction, stands inside of a text: whoever reads its first piece would lose the others.
fn divided(document: &Document<'_>) -> Option<TextPos> {
    let is_between = |node: &Node<'_, '_>| node.is_comment() || node.is_pi();
    let is_text = |node: Option<Node<'_, '_>>| {
        node.is_some_and(|node| node.is_text() && node.text().is_some_and(|text| !text.trim().is_empty()))
    };
    let divides = |node: &Node<'_, '_>| {
        let before = node.prev_siblings().find(|node| !is_between(node));
        is_between(node) && is_text(before) && is_text(node.next_siblings().find(|node| !is_between(node)))
    };
    document.descendants().find(divides).map(|node| document.text_pos_at(node.range().start))
}

/// The children of an element with a name.
fn children<'a, 'input>(node: Node<'a, 'input>, name: &'static str) -> impl Iterator<Item = Node<'a, 'input>> {
    node.children().filter(move |child| child.tag_name().name() == name)
}

/// The text of a child.
fn text<'a>(node: Node<'a, '_>, name: &'static str) -> Option<&'a str> {
    children(node, name).next().and_then(|child| child.text()).map(str::trim)
}

impl Qif<'_> {
    fn line(&self, node: Node<'_, '_>) -> usize {
        self.document.text_pos_at(node.range().start).row as usize
    }

    fn wrong(&self, node: Node<'_, '_>, message: impl Into<String>) -> Error {
        let place = self.document.text_pos_at(node.range().start);
        Error::data(message).at(self.path, place.row as usize, Some(place.col as usize))
    }

    /// mm in the primary unit of lengths.
    fn unit(&self, root: Node<'_, '_>, units: Option<Units>) -> Result<f64> {
        let primary = children(root, "FileUnits").flat_map(|node| children(node, "PrimaryUnits"));
        let Some(unit) = primary.flat_map(|node| children(node, "LinearUnit")).next() else {
            return units.map(Units::scale).ok_or_else(|| no_unit(self.path));
        };
        let is_metre = text(unit, "SIUnitName").is_some_and(|name| ["meter", "metre"].contains(&name));
        let conversion = children(unit, "UnitConversion").next();
        let factor = match conversion {
            None => Some(1.0),
            Some(conversion) => text(conversion, "Factor").and_then(number).filter(|factor| *factor > 0.0),
        };
        let has_offset = conversion.is_some_and(|it| text(it, "Offset").and_then(number).is_some_and(|it| it != 0.0));
        let Some(factor) = factor.filter(|_| is_metre && !has_offset) else {
            let message = "the LinearUnit is no multiple of the metre: SIUnitName meter and a Factor were expected";
            return Err(self.wrong(unit, message));
        };
        let scale = factor * 1000.0;
        // The name is for people; where it is a known one and means another length, nobody knows which is right.
        let named = text(unit, "UnitName").and_then(|name| {
            let is_it = |(names, _): &&(&[&str], f64)| names.contains(&name.trim().to_lowercase().as_str());
            NAMED.iter().find(is_it).map(|(_, scale)| (name, *scale))
        });
        if let Some((name, of_name)) = named.filter(|(_, of_name)| (of_name / scale - 1.0).abs() > 1e-6) {
            let message =
                format!("the UnitName is {}, which is {of_name} mm, and the Factor says {scale} mm", name.trim());
            return Err(self.wrong(unit, message).help("which one is right? Correct the other"));
        }
        match units {
            Some(units) if (units.scale() / scale - 1.0).abs() > 1e-9 => {
                let message = format!("the LinearUnit is {scale} mm, and `units` says {}", units.name());
                Err(self.wrong(unit, message).help("leave out `units`: the file says its unit"))
            }
            _ => Ok(scale),
        }
    }

    /// The point or centre of an element `Location`, mm.
    fn location(&self, node: Node<'_, '_>) -> Result<Option<[f64; 3]>> {
        let Some(place) = children(node, "Location").next() else { return Ok(None) };
        if place.has_attribute("linearUnit") {
            let error = self.wrong(place, "the Location has a unit of its own (linearUnit), which is not read");
            return Err(error.help("write the file in its primary unit"));
        }
        let written = place.text().unwrap_or_default();
        let numbers: Option<Vec<f64>> = written.split_whitespace().map(number).collect();
        let point = numbers.and_then(|numbers| <[f64; 3]>::try_from(numbers).ok());
        let point = point.ok_or_else(|| {
            self.wrong(place, format!("the Location is `{}`; three numbers were expected", shown(written.trim())))
        })?;
        Ok(Some(point.map(|it| it * self.scale)))
    }

    /// Name and nominal point of each feature, by the id of its item.
    fn nominal<'n>(&self, root: Node<'n, '_>) -> Result<Items<'n>> {
        let mut points = BTreeMap::new();
        let features = || children(root, "Features");
        for node in features().flat_map(|it| children(it, "FeatureNominals")).flat_map(|it| it.children()) {
            if let (Some(id), Some(point)) = (node.attribute("id"), self.location(node)?) {
                points.insert(id, point);
            }
        }
        let mut items = BTreeMap::new();
        for node in features().flat_map(|it| children(it, "FeatureItems")).flat_map(|it| it.children()) {
            let Some(id) = node.attribute("id") else { continue };
            let name = text(node, "FeatureName").unwrap_or(id);
            let nominal = text(node, "FeatureNominalId").and_then(|nominal| points.get(nominal)).copied();
            if items.insert(id, (name, nominal)).is_some() {
                return Err(self.wrong(node, format!("there are two features with the id {id}")));
            }
        }
        Ok(items)
    }

    /// The measured features, and how many there are of other kinds.
    fn measured<'n>(&self, root: Node<'_, '_>, items: &'n Items<'_>) -> Result<(Vec<Measured<'n>>, usize)> {
        let (mut found, mut others) = (Vec::new(), 0);
        let mut seen: BTreeMap<(usize, &str), usize> = BTreeMap::new();
        let results = root.descendants().filter(|node| node.tag_name().name() == "MeasurementResults");
        for (run, results) in results.enumerate() {
            let features = children(results, "MeasuredFeatures").flat_map(|it| it.children());
            for node in features.filter(Node::is_element) {
                let kind = KINDS.iter().find(|(element, _)| *element == node.tag_name().name());
                let Some((_, kind)) = kind else {
                    others += 1;
                    continue;
                };
                let id =
                    text(node, "FeatureItemId").ok_or_else(|| self.wrong(node, "the feature has no FeatureItemId"))?;
                let (name, nominal) = items
                    .get(id)
                    .ok_or_else(|| self.wrong(node, format!("there is no feature with the id {}", shown(id))))?;
                // The text of the id lives as long as the list of items.
                let id = items.get_key_value(id).map_or("", |(id, _)| *id);
                if let Some(first) = seen.insert((run, id), self.line(node)) {
                    let error = self.wrong(node, format!("the feature `{name}` is measured in line {first} already"));
                    return Err(error.help("each run has MeasurementResults of its own"));
                }
                let at = self.location(node)?;
                let at = at.ok_or_else(|| self.wrong(node, "the measured feature has no Location"))?;
                let diameter = match text(node, "Diameter") {
                    Some(written) => number(written).ok_or_else(|| {
                        self.wrong(node, format!("the Diameter is `{}`; a number was expected", shown(written)))
                    })?,
                    None => 0.0,
                };
                found.push(Measured {
                    line: self.line(node),
                    run: results.attribute("id").map_or_else(|| (run + 1).to_string(), str::to_owned),
                    name: (*name).to_owned(),
                    kind,
                    at,
                    diameter: diameter * self.scale,
                    nominal: nominal.as_ref(),
                });
            }
        }
        Ok((found, others))
    }
}
