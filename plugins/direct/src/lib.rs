//! Artefact plugin `direct`: one error along a stated line, read by laser interferometer, straightness probe, square block,
//! angular optics or level.
//!
//! With n the direction that is read, s = 1 where the body whose motion is read carries the tool and -1 where it carries the table, p
//! the tip in the table frame and p0 that of the machine without errors, a reading of a displacement is `s n.(p - p0)`; that of a
//! straightness takes off `s slope position` for the straightedge's own slope; the legs of a square block are two straightnesses with one
//! angle of the block; that of an angle is `s` times the sum of the angular errors about n, tool relative to table. All
//! have an offset and, where there is time, a drift for every run. (Soons 1993, sections 3.2 and 5.1.1.)
//!
//! The whole kinematics predicts a reading: the effect of other errors through their Abbe offsets is not taken for the
//! measured error.

mod line;
mod observed;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use abbe_core::{
    AboveZero, Artefact, ColumnHeader, Context, DataRow, Dataset, Error, InputFile, KinematicModel, Label, LabelText,
    Observations, PathItem, Quantity, Result, SettingsError, Target, nearest, pose_columns, positive,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::line::Line;

abbe_core::register!(
    Artefact,
    "direct",
    "single errors read along a line: laser interferometer, straightness probe, square, level",
    Settings,
    example,
    build,
    "../reference/artefact-direct.md",
);

/// Settings of direct measurements.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// The column of labels that tells measurements apart.
    #[serde(default = "default_measurement")]
    measurement: String,
    /// The measurements, by their labels.
    measurements: BTreeMap<String, Measurement>,
    /// Standard uncertainty of one reading of a length, for measurements that do not state their own.
    #[serde(default)]
    #[schemars(with = "Option<AboveZero>")]
    standard_uncertainty_um: Option<f64>,
    /// Standard uncertainty of one reading of an angle, for measurements that do not state their own.
    #[serde(default)]
    #[schemars(with = "Option<AboveZero>")]
    standard_uncertainty_urad: Option<f64>,
}

fn default_measurement() -> String {
    "file".to_owned()
}

/// One measurement.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Measurement {
    /// The kind of reading.
    kind: Kind,
    /// The axis that moves; its positions are in the columns `position_mm` (or `position_deg`) and `direction`. None
    /// for angles at one pose.
    #[serde(default)]
    moves: Option<String>,
    /// The two axes that move along a square, as the column `leg` says. Each leg is read in the direction of the other.
    #[serde(default)]
    legs: Option<[String; 2]>,
    /// The direction of the reading: X, Y or Z of the table frame, or a vector. For angles: the axis of the rotation.
    /// Default for a displacement: the direction of the motion.
    #[serde(default)]
    direction: Option<Direction>,
    /// The body whose motion is read. Default: the body that the moving axis carries.
    #[serde(default)]
    body: Option<Body>,
    /// Positions of the other linear axes.
    #[serde(default)]
    at_mm: BTreeMap<String, f64>,
    /// Positions of the other rotary axes. Default: 0.
    #[serde(default)]
    at_deg: BTreeMap<String, f64>,
    /// The stylus of the machine whose tip is the measured point. Default: the tip of the tool.
    #[serde(default)]
    stylus: Option<Label>,
    /// Name of the straightedge, for measurements against the same face that share its slope.
    #[serde(default)]
    slope: Option<String>,
    /// The columns whose labels tell runs apart; each run has its own datum and drift. Default: `run`, for squares also
    /// `leg`.
    #[serde(default)]
    datum: Option<Vec<String>>,
    /// Whether a drift is estimated for every datum. Default: yes if there is a column `time_s`.
    #[serde(default)]
    drift: Option<bool>,
    /// Standard uncertainty of one reading of a length.
    #[serde(default)]
    #[schemars(with = "Option<AboveZero>")]
    standard_uncertainty_um: Option<f64>,
    /// Standard uncertainty of one reading of an angle.
    #[serde(default)]
    #[schemars(with = "Option<AboveZero>")]
    standard_uncertainty_urad: Option<f64>,
}

/// The kind of reading.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Kind {
    /// How far an axis moves along its own direction.
    #[default]
    Displacement,
    /// How far it moves across, relative to a straightedge of unknown slope.
    Straightness,
    /// Straightness along both legs of a square block that is turned by an unknown angle.
    Square,
    /// A rotation, by angular optics or levels.
    Angle,
}

impl Kind {
    fn quantity(self) -> Quantity {
        if self == Self::Angle { Quantity::Angle } else { Quantity::Length }
    }
}

/// A direction of the table frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged, expecting = "X, Y, Z or a list of three numbers was expected")]
enum Direction {
    /// X, Y or Z.
    Named(Letter),
    /// Any direction.
    Vector([f64; 3]),
}

/// A direction of the frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
enum Letter {
    /// x.
    X,
    /// y.
    Y,
    /// z.
    Z,
}

/// A body whose motion is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Body {
    /// The table relative to the tool.
    Table,
    /// The tool relative to the table.
    Tool,
}

fn example() -> Value {
    json!({
        "standard_uncertainty_um": 0.3,
        "measurements": {
            "EXX": { "kind": "displacement", "moves": "X", "at_mm": { "Y": 240, "Z": 310 }, "stylus": 2 },
            "EZY": { "kind": "straightness", "moves": "Y", "direction": "Z", "at_mm": { "X": 180, "Z": 310 } },
            "XY": { "kind": "square", "legs": ["X", "Y"], "at_mm": { "X": 330, "Y": 240, "Z": 310 } },
        },
    })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Artefact>, SettingsError> {
    if settings.measurements.is_empty() {
        return Err(SettingsError::new("measurements", "at least one measurement was expected"));
    }
    for (name, value) in [
        ("standard_uncertainty_um", settings.standard_uncertainty_um),
        ("standard_uncertainty_urad", settings.standard_uncertainty_urad),
    ] {
        value.map_or(Ok(0.0), |value| positive(name, value))?;
    }
    for (label, measurement) in &settings.measurements {
        let under = |error: SettingsError| error.under(place(label));
        if label.contains(['[', ']', '*', '?']) {
            return Err(under(SettingsError::new("", "a label without brackets and wildcards was expected")));
        }
        measurement.check().map_err(under)?;
        settings.uncertainty(measurement).map_err(under)?;
    }
    Ok(Box::new(Direct { settings }))
}

/// Where the settings of a measurement stand.
fn place(label: &str) -> [PathItem; 2] {
    [PathItem::Key("measurements".to_owned()), PathItem::Key(label.to_owned())]
}

impl Measurement {
    /// Checks what is wrong on any machine.
    fn check(&self) -> Result<(), SettingsError> {
        let wrong = |setting: &str, message: &str| Err(SettingsError::new(setting, message));
        match (self.kind, &self.moves, &self.legs) {
            (Kind::Square, Some(_), _) => return wrong("moves", "along a square two axes move: `legs: [X, Y]`"),
            (Kind::Square, _, None) => return wrong("legs", "the two axes that move along the square were expected"),
            (Kind::Square, _, Some([one, other])) if one == other => {
                return wrong("legs", "two different axes were expected");
            }
            (Kind::Displacement | Kind::Straightness, None, _) => {
                return wrong("moves", "the axis that moves was expected");
            }
            (Kind::Displacement | Kind::Straightness | Kind::Angle, _, Some(_)) => {
                return wrong("legs", "only a square has legs");
            }
            (Kind::Angle, None, None) if self.body.is_none() => {
                return wrong("body", "no axis moves: is it the table or the tool whose rotation is read?");
            }
            _ => {}
        }
        match (self.kind, &self.direction) {
            (Kind::Straightness | Kind::Angle, None) => {
                return wrong("direction", "the direction that is read was expected: X, Y, Z or a vector");
            }
            (Kind::Square, Some(_)) => {
                return wrong("direction", "each leg of a square is read in the direction of the other");
            }
            (_, Some(Direction::Vector(vector)))
                if !vector.iter().all(|part| part.is_finite()) || vector.iter().all(|part| *part == 0.0) =>
            {
                return wrong(
                    "direction",
                    "along this direction nothing can be read; three numbers, not all zero, were expected",
                );
            }
            _ => {}
        }
        if self.slope.is_some() && self.kind != Kind::Straightness {
            return wrong("slope", "only a straightness is read against a straightedge with a slope");
        }
        for (setting, at) in [("at_mm", &self.at_mm), ("at_deg", &self.at_deg)] {
            if let Some((axis, _)) = at.iter().find(|(_, value)| !value.is_finite()) {
                return Err(
                    SettingsError::new(axis, "a finite number was expected").under([PathItem::Key(setting.to_owned())])
                );
            }
        }
        Ok(())
    }

    /// The axes that move, each with the label of its leg.
    fn moving(&self) -> Vec<&str> {
        self.moves.iter().chain(self.legs.iter().flatten()).map(String::as_str).collect()
    }

    /// The columns that tell apart what has an offset of its own, of those that are there.
    fn datum_columns(&self, headers: &[ColumnHeader]) -> Vec<String> {
        match &self.datum {
            Some(columns) => columns.clone(),
            None => {
                let usual = if self.kind == Kind::Square { &["run", "leg"][..] } else { &["run"] };
                let there = |name: &&&str| headers.iter().any(|header| header.name == **name);
                usual.iter().filter(there).map(|name| (*name).to_owned()).collect()
            }
        }
    }

    /// Whether it has drifts.
    fn drifts(&self, headers: &[ColumnHeader]) -> bool {
        self.drift.unwrap_or_else(|| headers.iter().any(|header| header.name == "time"))
    }
}

impl Settings {
    /// Standard uncertainty of a reading, mm or rad.
    fn uncertainty(&self, measurement: &Measurement) -> Result<f64, SettingsError> {
        let own = [measurement.standard_uncertainty_um, measurement.standard_uncertainty_urad];
        let all = [self.standard_uncertainty_um, self.standard_uncertainty_urad];
        let names = ["standard_uncertainty_um", "standard_uncertainty_urad"];
        let (right, factor) = if measurement.kind == Kind::Angle { (1, 1e-6) } else { (0, 1e-3) };
        let what = if right == 1 { "an angle" } else { "a length" };
        if own[1 - right].is_some() {
            let message = format!("what is read is {what}: `{}` was expected", names[right]);
            return Err(SettingsError::new(names[1 - right], message));
        }
        let value = own[right].or(all[right]).ok_or_else(|| {
            SettingsError::new(names[right], format!("the standard uncertainty of a reading of {what} was expected"))
                .help(format!("write `{}` here, or beside `measurements` for all", names[right]))
        })?;
        Ok(positive(names[right], value)? * factor)
    }

    /// Checks the columns of the data.
    fn check_columns(
        &self,
        headers: &[ColumnHeader],
        file: Option<&PathBuf>,
        model: &dyn KinematicModel,
    ) -> Result<()> {
        abbe_table::require(headers, file, &[(&self.measurement, Quantity::Label)])?;
        for (label, measurement) in &self.measurements {
            let quantity = measurement.kind.quantity();
            if let Some(reading) = headers.iter().find(|header| header.name == "reading")
                && reading.quantity != quantity
            {
                let (is, suffix) = match quantity {
                    Quantity::Angle => ("an angle", "reading_urad"),
                    _ => ("a length", "reading_um"),
                };
                let message = format!("`{label}` reads {is}, but the readings are in `{}`", reading.header);
                let error = Error::usage(message).help(format!(
                    "`{suffix}` was expected; files with readings of another unit go to an ingest and an artefact stage of their own"
                ));
                return Err(file.map_or(error.clone(), |file| error.in_file(file)));
            }
            abbe_table::require(headers, file, &[("reading", quantity)])?;
            for axis in measurement.moving() {
                let axis = line::axis(model, axis).map_err(|error| at(label, error))?;
                let commands = model.info().status[model.info().axes[axis].status].quantity;
                abbe_table::require(headers, file, &[("position", commands)])?;
            }
            if measurement.kind == Kind::Square {
                abbe_table::require(headers, file, &[("leg", Quantity::Label)])?;
            }
            if measurement.drifts(headers) {
                abbe_table::require(headers, file, &[("time", Quantity::Time)])?;
            }
            for column in measurement.datum_columns(headers) {
                if !headers.iter().any(|header| header.name == column) {
                    abbe_table::require(headers, file, &[(&column, Quantity::Label)])?;
                }
            }
        }
        Ok(())
    }
}

/// An error in the settings of a measurement that shows only on a machine.
fn at(label: &str, error: SettingsError) -> Error {
    let error = error.under(place(label));
    Error { help: error.help, setting: error.path, ..Error::usage(error.message) }
}

struct Direct {
    settings: Settings,
}

impl Direct {
    /// The measurements on this machine, by label.
    fn lines(&self, headers: &[ColumnHeader], model: &dyn KinematicModel) -> Result<BTreeMap<&str, Line>> {
        let mut lines = BTreeMap::new();
        for (label, measurement) in &self.settings.measurements {
            let uncertainty = self.settings.uncertainty(measurement).map_err(|error| at(label, error))?;
            let line = Line::new(measurement, uncertainty, headers, model)?.map_err(|error| at(label, error))?;
            lines.insert(label.as_str(), line);
        }
        Ok(lines)
    }

    /// The label of every row, each that of a measurement; every measurement has rows.
    fn labels<'a>(&self, data: &'a Dataset) -> Result<&'a [LabelText]> {
        let labels =
            abbe_table::labels(data, &self.settings.measurement).map_err(|error| error.setting("measurement"))?;
        let known = &self.settings.measurements;
        if let Some((row, label)) = DataRow::enumerate(labels).find(|(_, label)| !known.contains_key(label.as_str())) {
            let message = format!("{} `{}` is not among the `measurements`", self.settings.measurement, label);
            let near = nearest(label, known.keys().map(String::as_str));
            let help = near.map_or_else(
                || "say what was measured there, or leave its rows out of the ingest stage".to_owned(),
                |near| format!("did you mean `{near}`?"),
            );
            return Err(data.error_at(row, message).help(help));
        }
        match known.keys().find(|label| !labels.iter().any(|own| own == *label)) {
            Some(label) => {
                let column = &self.settings.measurement;
                Err(at(label, SettingsError::new("", format!("no row of the data has the {column} `{label}`"))))
            }
            None => Ok(labels),
        }
    }
}

impl Artefact for Direct {
    fn inputs(&self) -> Vec<InputFile> {
        Vec::new()
    }

    fn check(&self, headers: &[ColumnHeader], file: Option<&PathBuf>, model: &dyn KinematicModel) -> Result<()> {
        self.settings.check_columns(headers, file, model)?;
        pose_columns(headers, file, model, &line::naming)?;
        self.lines(headers, model).map(drop)
    }

    fn observe(&self, data: &Arc<Dataset>, model: &Arc<dyn KinematicModel>) -> Result<Arc<dyn Observations>> {
        let model = model.as_ref();
        let headers = data.headers();
        self.settings.check_columns(&headers, data.files.first(), model)?;
        let labels = self.labels(data)?;
        let lines = self.lines(&headers, model)?;
        observed::observe(data, labels, &lines, model)
    }

    fn targets(&self, _: f64) -> Result<Vec<Target>> {
        // Instruments read along lines: the data rows are the programme.
        Ok(Vec::new())
    }
}
