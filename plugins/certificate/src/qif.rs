//! Exporter `qif-results`: measured points, corrected by the calibration, as results of the Quality Information Framework (QIF 3, ISO
//! 23952).

use std::collections::BTreeMap;
use std::path::PathBuf;

use abbe_compensation::{Measured, MeasuredPoints};
use abbe_core::{
    Calibration, Context, DataRow, Dataset, Error, Export, ExportedFile, InputFile, KinematicModel, Quantity, Result,
    SettingsError, positive,
};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

use crate::element::Element;
use crate::mistaken_places::{FAR, LEAST_SPREAD, Mistaken, length, mistaken, shift_and_spread};

abbe_core::register!(
    Export,
    "qif-results",
    "measured points, corrected by the calibration, as QIF 3 results",
    Settings,
    example,
    build,
    "../reference/export-qif-results.md",
);

/// Settings of the measured points.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// CSV file of measured positions, one a row: a column for every axis (`X_mm`, `B_deg`) and for all that its errors depend on; the
    /// label `run`, if points were measured several times; `x_mm`, `y_mm`, `z_mm`, the nominal points in the table frame, if they are
    /// known.
    path: String,
    /// The column of the point's label.
    #[serde(default = "default_feature")]
    feature: String,
    /// Largest correction of a point; beyond it the errors are not believed.
    #[serde(default = "default_largest")]
    largest_correction_mm: f64,
}

fn default_feature() -> String {
    "feature".to_owned()
}

fn default_largest() -> f64 {
    1.0
}

fn example() -> Value {
    json!({ "path": "points.csv", "feature": "hole" })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Export>, SettingsError> {
    positive("largest_correction_mm", settings.largest_correction_mm)?;
    Ok(Box::new(QifResults { path: context.path(&settings.path), settings }))
}

struct QifResults {
    path: PathBuf,
    settings: Settings,
}

/// The name of the file.
const FILE: &str = "results.qif";

/// Most points of a file: a document is held in memory as a whole.
const MOST: usize = 200_000;

impl Export for QifResults {
    fn inputs(&self) -> Vec<InputFile> {
        vec![InputFile { setting: "path", path: self.path.clone() }]
    }

    fn export(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Vec<ExportedFile>> {
        let table = abbe_table::read(&self.path)?;
        if table.rows() > MOST {
            let message = format!("{} points; at most {MOST} are written", table.rows());
            return Err(Error::data(message).in_file(&self.path));
        }
        let measured = MeasuredPoints::new(model, calibration, &self.path, self.settings.largest_correction_mm)?;
        let document = Document::new(&table, &self.settings.feature, &measured.tips)?;
        let text = document.element().document();
        let text = text.map_err(|error| Error::data(format!("the results cannot be written as XML: {error}")))?;
        Ok(vec![ExportedFile { name: FILE.to_owned(), content: text.into_bytes() }])
    }
}

/// How near to the nominal place of another point one is that is this one, over the spread of all.
const NEAR: f64 = 3.0;

/// Fewest points that two runs share, of which one that is elsewhere is told.
const FEWEST: usize = 5;

/// Most points that are looked for among the others.
const TRIED: usize = 100;

/// Points and their measurements.
struct Document<'a> {
    /// Label and nominal position of each point, mm.
    points: Vec<(&'a str, [f64; 3])>,
    /// The measurements of each run: its points and where they were found.
    runs: Vec<Vec<(usize, &'a Measured)>>,
    /// The label of each run, and its first row.
    labels: Vec<(&'a str, DataRow)>,
}

impl<'a> Document<'a> {
    fn new(table: &'a Dataset, feature: &str, tips: &'a [Measured]) -> Result<Self> {
        let labels = abbe_table::labels(table, feature).map_err(|error| error.setting("feature"))?;
        let runs = table.labels("run");
        let has_nominal = ["x", "y", "z"]
            .iter()
            .all(|name| table.column(name).is_some_and(|column| column.header.quantity == Quantity::Length));
        let nominal = if has_nominal { Some(abbe_table::points(table, ["x", "y", "z"])?) } else { None };
        let mut document = Self { points: Vec::new(), runs: Vec::new(), labels: Vec::new() };
        let mut places: BTreeMap<&str, usize> = BTreeMap::new();
        let mut run_places: BTreeMap<&str, usize> = BTreeMap::new();
        let mut rows = Vec::new();
        for ((row, label), tip) in DataRow::enumerate(labels).zip(tips) {
            let at = nominal.as_ref().map_or(tip.indicated, |nominal| nominal[row.0]);
            let count = document.points.len();
            let point = *places.entry(label).or_insert(count);
            match document.points.get(point) {
                None => document.points.push((label, at)),
                Some((_, other)) if has_nominal && *other != at => {
                    let message = format!("point `{label}` has another nominal position in an earlier row");
                    return Err(table.error_at(row, message));
                }
                Some(_) => {}
            }
            let run = runs.map_or("", |runs| runs[row].as_str());
            let count = document.runs.len();
            let run = *run_places.entry(run).or_insert(count);
            if run == count {
                document.runs.push(Vec::new());
                document.labels.push((runs.map_or("", |runs| runs[row].as_str()), row));
            }
            let of_point = document.runs[run].iter().filter(|(other, _)| *other == point);
            let earlier: Vec<&Measured> = of_point.map(|(_, tip)| *tip).collect();
            if !earlier.is_empty() && runs.is_none() {
                let error = table.error_at(row, format!("point `{label}` is measured twice"));
                return Err(error.help("write a column `run`, which says which measurement a row is"));
            }
            if earlier.iter().any(|earlier| earlier.indicated == tip.indicated) {
                let words =
                    format!("point `{label}` repeats an earlier row to the last digit: is the row there twice?");
                tracing::warn!("{}", table.error_at(row, words));
            }
            document.runs[run].push((point, tip));
            rows.push((row, point, tip));
        }
        document.tell_copied_runs(table);
        document.are_of_one_part(table, has_nominal)?;
        if has_nominal {
            document.are_where_they_are_said(table, &rows)?;
        }
        Ok(document)
    }

    /// Tells of a run all of whose points are those of an earlier one to the last digit, where digits are fine.
    fn tell_copied_runs(&self, table: &Dataset) {
        const FEWEST: usize = 4;
        const COARSE: f64 = 1e-4;
        let is_fine = |at: &[f64; 3]| at.iter().any(|own| (own / COARSE - (own / COARSE).round()).abs() > 1e-3);
        for (number, run) in self.runs.iter().enumerate() {
            let places: BTreeMap<usize, [f64; 3]> = run.iter().map(|(point, tip)| (*point, tip.indicated)).collect();
            let is_copy = |earlier: &Vec<(usize, &Measured)>| {
                let same = |(point, tip): &(usize, &Measured)| places.get(point) == Some(&tip.indicated);
                earlier.len() == run.len() && earlier.iter().all(same)
            };
            let copied = self.runs[..number].iter().position(is_copy);
            let tells = run.len() >= FEWEST && places.values().any(is_fine);
            if let Some(of) = copied.filter(|_| tells) {
                let (label, row) = self.labels[number];
                let words = format!(
                    "run `{label}` has the points of run `{}` to the last digit: was it copied?",
                    self.labels[of].0
                );
                tracing::warn!("{}", table.error_at(row, words));
            }
        }
    }

    /// Fails where all points of a run were found where a mistake in a column puts them: from their nominal places, or from another run
    /// where these are not known. Tells of a run that was found beside another one as a whole.
    fn are_of_one_part(&self, table: &Dataset, has_nominal: bool) -> Result<()> {
        for (number, run) in self.runs.iter().enumerate() {
            let (label, row) = self.labels[number];
            let named = if self.runs.len() > 1 { format!(" of run `{label}`") } else { String::new() };
            if has_nominal {
                let pairs = run.iter().map(|(point, tip)| (self.points[*point].1, tip.corrected));
                refuse(&named, "the nominal ones", pairs).map_err(|error| error.at(table, row))?;
            }
            let (Some(first), true) = (self.runs.first(), number > 0) else { continue };
            let places: BTreeMap<usize, [f64; 3]> = first.iter().map(|(point, tip)| (*point, tip.corrected)).collect();
            let pairs = run.iter().filter_map(|(point, tip)| Some((*places.get(point)?, tip.corrected)));
            let other = format!("those of run `{}`", self.labels[0].0);
            if !has_nominal {
                refuse(&named, &other, pairs.clone()).map_err(|error| error.at(table, row))?;
            }
            let differences = pairs.map(|(one, two)| [0, 1, 2].map(|axis| two[axis] - one[axis]));
            let differences: Vec<[f64; 3]> = differences.collect();
            if let Some(words) = shifted(&differences) {
                tracing::warn!("the points{named} lie {words} beside {other}: was the part moved, or a work offset?");
            }
            if differences.len() < FEWEST {
                continue;
            }
            let (shift, spread) = shift_and_spread(&differences);
            let off = |by: &[f64; 3]| length([0, 1, 2].map(|axis| by[axis] - shift[axis]));
            let alone = run.iter().filter(|(point, _)| places.contains_key(point)).zip(&differences);
            for ((point, _), by) in alone.filter(|(_, by)| off(by) > (FAR * spread).max(LEAST_SPREAD)) {
                let (label, size) = (self.points[*point].0, off(by));
                tracing::warn!(
                    "point `{label}`{named} lies {size:.3} mm from where it is in {other}, and half of all within {spread:.4} mm: is \
                     its position right?"
                );
            }
        }
        Ok(())
    }

    /// Fails where a point was found at the nominal place of another one, and far from its own.
    ///
    /// The part may lie beside its place: what counts is the difference from the others, which more than half of the points tell.
    fn are_where_they_are_said(&self, table: &Dataset, rows: &[(DataRow, usize, &Measured)]) -> Result<()> {
        let difference = |tip: &Measured, at: &[f64; 3]| [0, 1, 2].map(|axis| tip.corrected[axis] - at[axis]);
        let differences: Vec<[f64; 3]> =
            rows.iter().map(|(_, point, tip)| difference(tip, &self.points[*point].1)).collect();
        let (of_part, spread) = shift_and_spread(&differences);
        let (size, spread) =
            (|by: [f64; 3]| length([0, 1, 2].map(|axis| by[axis] - of_part[axis])), spread.max(LEAST_SPREAD));
        let far = rows.iter().zip(&differences).filter(|(_, by)| size(**by) > FAR * spread).take(TRIED);
        for ((row, point, tip), by) in far {
            let found = self.points.iter().find(|(_, at)| size(difference(tip, at)) < NEAR * spread);
            if let Some((other, _)) = found {
                let label = self.points[*point].0;
                let message = format!(
                    "point `{label}` was found {:.3} mm from its nominal place, and where `{other}` should be",
                    size(*by)
                );
                return Err(table
                    .error_at(*row, message)
                    .help("are nominal places exchanged, or was another point measured?"));
            }
        }
        Ok(())
    }

    /// The document. Ids: 1 is the definition of points, then nominal points, features, runs and measurements.
    fn element(&self) -> Element {
        let count = self.points.len();
        let (nominal, feature) = (|point: usize| 2 + point, |point: usize| 2 + count + point);
        let definition = Element::of("PointFeatureDefinition", Vec::new()).with("id", "1");
        let nominals = self.points.iter().enumerate().map(|(point, (_, at))| {
            let elements = vec![Element::text("FeatureDefinitionId", "1"), Element::text("Location", location(at))];
            Element::of("PointFeatureNominal", elements).with("id", &nominal(point).to_string())
        });
        let items = self.points.iter().enumerate().map(|(point, (label, _))| {
            let checked = Element::of("Checked", Vec::new());
            let elements = vec![
                Element::text("FeatureNominalId", nominal(point).to_string()),
                Element::text("FeatureName", label.split_whitespace().collect::<Vec<_>>().join(" ")),
                Element::of("DeterminationMode", vec![checked]),
            ];
            Element::of("PointFeatureItem", elements).with("id", &feature(point).to_string())
        });
        let features = vec![
            counted("FeatureDefinitions", vec![definition]),
            counted("FeatureNominals", nominals.collect()),
            counted("FeatureItems", items.collect()),
        ];
        let mut next = 2 + 2 * count;
        let mut id = || {
            next += 1;
            next - 1
        };
        let mut runs = Vec::new();
        for run in &self.runs {
            let own = id().to_string();
            let measurements = run.iter().map(|(point, tip)| {
                let place = Element::text("Location", location(&tip.corrected));
                let place = ["xCombinedUncertainty", "yCombinedUncertainty", "zCombinedUncertainty"]
                    .into_iter()
                    .enumerate()
                    .fold(place, |place, (axis, name)| {
                        place.with(name, &format!("{:.9}", tip.covariance[axis][axis].max(0.0).sqrt()))
                    });
                let elements = vec![Element::text("FeatureItemId", feature(*point).to_string()), place];
                Element::of("PointFeatureMeasurement", elements).with("id", &id().to_string())
            });
            let status = Element::text("InspectionStatusEnum", "NOT_CALCULATED");
            let elements = vec![
                counted("MeasuredFeatures", measurements.collect()),
                Element::of("InspectionStatus", vec![status]),
            ];
            runs.push(Element::of("MeasurementResults", elements).with("id", &own));
        }
        let unit = Element::of(
            "LinearUnit",
            vec![
                Element::text("SIUnitName", "meter"),
                Element::text("UnitName", "mm"),
                Element::of("UnitConversion", vec![Element::text("Factor", "0.001")]),
            ],
        );
        let results = Element::of("Results", vec![counted("MeasurementResultsSet", runs)]);
        let units = Element::of("FileUnits", vec![Element::of("PrimaryUnits", vec![unit])]);
        let elements =
            vec![Element::text("QPId", self.identifier()), units, Element::of("Features", features), results];
        Element::of("QIFDocument", elements)
            .with("xmlns", "http://qifstandards.org/xsd/qif3")
            .with("versionQIF", "3.0.0")
            .with("idMax", &(id() - 1).to_string())
    }

    /// An identifier in the form of a UUID (version 8) that follows from what was measured, as it is written: the same points give the
    /// same file.
    fn identifier(&self) -> String {
        let mut hash = Sha256::new();
        for (label, at) in &self.points {
            hash.update(format!("{label} {}\n", location(at)));
        }
        for (point, tip) in self.runs.iter().flatten() {
            hash.update(format!("{point} {}\n", location(&tip.corrected)));
        }
        let mut bytes: Vec<u8> = hash.finalize().iter().copied().take(16).collect();
        bytes[6] = 0x80 | (bytes[6] & 0x0f);
        bytes[8] = 0x80 | (bytes[8] & 0x3f);
        let digits: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        [&digits[..8], &digits[8..12], &digits[12..16], &digits[16..20], &digits[20..]].join("-")
    }
}

/// A mistake in a column, without its place.
struct Refused(String);

impl Refused {
    fn at(self, table: &Dataset, row: DataRow) -> Error {
        table.error_at(row, self.0).help("is the sign, the unit or the name of a column of this file wrong?")
    }
}

/// Fails where points, after where they are expected, were found where a mistake puts them.
fn refuse(named: &str, others: &str, pairs: impl Iterator<Item = ([f64; 3], [f64; 3])>) -> Result<(), Refused> {
    let (expected, found): (Vec<[f64; 3]>, Vec<[f64; 3]>) = pairs.unzip();
    mistaken(&expected, &found).map_or(Ok(()), |found| {
        let Mistaken { what, with, without } = found;
        Err(Refused(format!(
            "against {others} the points{named} are {what}: so they are within {with:.3} mm, and {without:.3} mm off as they are"
        )))
    })
}

/// Fewest points that two runs have in common for a word on where they lie.
const IN_COMMON: usize = 4;

/// How far points lie beside others as a whole, in words, if that is far more than they scatter.
fn shifted(differences: &[[f64; 3]]) -> Option<String> {
    let (shift, spread) = shift_and_spread(differences);
    let is_far = differences.len() >= IN_COMMON && length(shift) > FAR * spread.max(LEAST_SPREAD);
    is_far.then(|| {
        let [x, y, z] = shift.map(|part| format!("{:.3}", part + 0.0));
        format!("({x}, {y}, {z}) mm (they scatter by {spread:.3} mm)")
    })
}

/// A list with the number of its entries.
fn counted(name: &str, elements: Vec<Element>) -> Element {
    let count = elements.len().to_string();
    Element::of(name, elements).with("n", &count)
}

/// A position, mm.
fn location(at: &[f64; 3]) -> String {
    at.map(|value| format!("{:.9}", value + 0.0)).join(" ")
}
