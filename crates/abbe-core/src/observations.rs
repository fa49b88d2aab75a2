//! Observations of an artefact, made from a data set: rows of equations between poses, own unknowns and known inputs.

use std::any::Any;
use std::collections::{BTreeMap, BTreeSet};

use schemars::JsonSchema;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};

use crate::index::{LayoutEquation, RowIndex};
use crate::layout::Layout;
use crate::model::{KinematicModel, ModelInfo};
use crate::parameter::Parameter;
use abbe_results::Certificate;
use abbe_settings::Result;
use abbe_settings::{Quantity, Unit};

/// A named quantity that is not estimated. All rows that use it share its error.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct KnownInput {
    /// Own name, e.g. `length`.
    pub parameter: Parameter,
    /// Its value.
    pub value: f64,
    /// Its standard uncertainty.
    pub standard_uncertainty: f64,
    /// It belongs to the machine and not to the artefact (the stylus radius): inputs of this name of all artefacts are one
    /// quantity.
    #[serde(default)]
    pub shared: bool,
    /// The certificate that states it. Without one, name, value and uncertainty identify it.
    #[serde(default)]
    pub certificate: Option<Certificate>,
    /// It is this parameter of the model, by its index, and has the value and the uncertainty that this has in a problem.
    #[serde(default)]
    pub of_model: Option<usize>,
}

impl KnownInput {
    /// An input of the artefact with a value and its standard uncertainty, in the unit of the parameter.
    pub fn new(parameter: Parameter, value: f64, standard_uncertainty: f64) -> Self {
        Self { parameter, value, standard_uncertainty, shared: false, certificate: None, of_model: None }
    }

    /// A parameter of a model that equations depend on although poses do not, by its index.
    pub fn of_model(model: &dyn KinematicModel, parameter: usize) -> Self {
        let ModelInfo { parameters, nominal, .. } = model.info();
        let input = Self::new(parameters[parameter].clone(), nominal[parameter], 0.0);
        Self { of_model: Some(parameter), ..input }
    }

    /// The stylus radius of a machine, with its standard uncertainty in mm: one quantity for all artefacts that are touched.
    pub fn stylus_radius(model: &dyn KinematicModel, standard_uncertainty: f64) -> Self {
        let parameter = Parameter::new("stylus_radius", Unit::MM);
        Self::new(parameter, model.info().stylus_radius, standard_uncertainty).shared()
    }

    /// Makes it an input of the machine: one quantity for all artefacts that have an input of this name.
    pub fn shared(mut self) -> Self {
        self.shared = true;
        self
    }

    /// Sets the certificate that states it: the input is `quantity` on a certificate with this content.
    pub fn with_certificate(mut self, quantity: impl Into<String>, content: impl Into<String>) -> Self {
        self.certificate = Some(Certificate::new(quantity, content));
        self
    }

    /// The certificate that states it; without one, a certificate made from its name, value, unit and uncertainty.
    pub fn certificate(&self) -> Certificate {
        let Self { parameter: Parameter { name, unit, .. }, value, standard_uncertainty, .. } = self;
        let stated =
            || Certificate::new(name, format!("{name} = {value:e} {unit}, u = {standard_uncertainty:e} {unit}"));
        self.certificate.clone().unwrap_or_else(stated)
    }
}

/// How the equations of a row come to hold in a real measurement: axes move, or a reading takes up the difference.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Contact {
    /// The linear axes of all its poses move, by as little as possible, until the probe triggers.
    LinearAxes,
    /// The reading in this column (without unit) takes up the difference; nothing moves.
    Reading(String),
    /// The same of rows with several equations: each has a reading of its own, in these columns (without unit).
    Readings(Vec<String>),
    /// An observed pose takes up the difference: six equations, three of the position and three of the rotation vector from the
    /// predicted to the observed orientation.
    Pose {
        /// Columns of the position (without unit), which its equations have with a plus sign.
        position: [String; 3],
        /// Columns of the orientation: a quaternion w, x, y, z.
        orientation: [String; 4],
    },
    /// Such rows can be estimated, but not simulated yet. The text is the reason, for messages.
    NotSimulated(String),
}

/// Nominal contact of a row that has a reading: linear axes move until the reading has its nominal value.
///
/// In a real measurement the axes do not move in this way. It is computed to judge rank and condition without the part of the
/// reading that comes from errors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct NominalReading {
    /// Residual of each of its equations at the nominal reading, mm or rad: nominal reading minus recorded reading.
    pub residuals: Vec<f64>,
    /// The linear axes that move while the row is measured, by their indices among the axes of the model. All others keep
    /// their commands.
    pub axes: Vec<usize>,
}

/// Whether the equations depend on the orientation of the tool, and on which.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Orientation {
    /// The equations do not depend on it.
    #[default]
    Unused,
    /// They depend on the exact orientation of the model.
    Exact,
    /// They depend on the orientation to first order in the errors: the nominal orientation, turned by the sum of the
    /// rotation vectors of the single errors. Products of rotations, which are of second order, are left out. Instruments
    /// that add up angular errors are described in this way.
    FirstOrder,
}

/// Where rank and condition of the rows are judged.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum RankPoint {
    /// At the recorded poses, which give the same information as nominal contact. Example: a known length holds between any
    /// two poses, and no unknown absorbs its deviation.
    #[default]
    AsRecorded,
    /// In nominal contact ([`Observations::contact_tip`]).
    InContact,
    /// At nominal readings, by the index of the row; rows without one are judged as recorded.
    NominalReading(
        #[serde(deserialize_with = "by_row")]
        #[schemars(with = "BTreeMap<String, NominalReading>")]
        BTreeMap<RowIndex, NominalReading>,
    ),
}

impl RankPoint {
    /// The default for a kind of contact: nominal contact if linear axes move until there is contact, else the recorded
    /// poses.
    pub fn of(contact: &Contact) -> Self {
        if *contact == Contact::LinearAxes { Self::InContact } else { Self::AsRecorded }
    }

    /// The rows that have a nominal reading, by their index.
    pub fn nominal_readings(&self) -> impl Iterator<Item = (&RowIndex, &NominalReading)> {
        let rows = if let Self::NominalReading(rows) = self { Some(rows) } else { None };
        rows.into_iter().flatten()
    }

    /// Placeholder where a serialised text has no rank point: no row has a nominal reading. [`of`](Self::of) then gives the
    /// value.
    fn not_said() -> Self {
        Self::NominalReading(BTreeMap::new())
    }
}

/// Reads a map by row. The keys of a JSON object are texts, and serde does not always turn them into numbers.
fn by_row<'de, D: Deserializer<'de>>(deserializer: D) -> Result<BTreeMap<RowIndex, NominalReading>, D::Error> {
    let by_text = BTreeMap::<String, NominalReading>::deserialize(deserializer)?;
    let row =
        |text: &str| text.parse().map(RowIndex).map_err(|_| D::Error::custom(format!("`{text}` is no index of a row")));
    by_text.into_iter().map(|(text, nominal)| Ok((row(&text)?, nominal))).collect()
}

/// Approach of a row by one linear axis.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Approach {
    /// Index of the linear axis that moves until contact; the others stay where they are.
    pub axis: usize,
    /// The column (without unit) that records the trigger position, beside the column of the axis.
    pub reading: String,
}

/// A feature of an artefact in the table frame: nominal position and the unknowns that shift it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Feature {
    /// Its label.
    pub label: String,
    /// Nominal point, mm.
    pub point: [f64; 3],
    /// The own unknowns that shift it: (index of the unknown, unit direction).
    pub shifts: Vec<(usize, [f64; 3])>,
}

/// Where the tip is sent to measure a feature.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Target {
    /// Label of the feature.
    pub feature: String,
    /// Nominal tip position, table frame, mm.
    pub tip: [f64; 3],
    /// Unit direction of approach, table frame; none if any direction is possible.
    pub approach: Option<[f64; 3]>,
}

/// Rows that are evaluated together, with all that their equations depend on.
#[derive(Debug, Clone, Copy)]
pub struct RowBatch<'a> {
    /// Indices of the rows.
    pub rows: &'a [RowIndex],
    /// Tip positions of their poses, one after another in the order of the rows, table frame, mm.
    pub positions: &'a [[f64; 3]],
    /// Tool orientations as unit quaternions w, x, y, z; empty unless the observations ask for them.
    pub orientations: &'a [[f64; 4]],
    /// Values of the own unknowns.
    pub own: &'a [f64],
    /// Values of the known inputs.
    pub inputs: &'a [f64],
}

/// Residuals and derivatives as an artefact writes them, equation by equation.
#[derive(Debug, Clone, Default)]
pub struct Equations {
    pub(crate) residuals: Vec<f64>,
    pub(crate) by_position: Vec<[f64; 3]>,
    pub(crate) by_rotation: Vec<[f64; 3]>,
    pub(crate) by_own: Vec<(usize, usize, f64)>,
    pub(crate) by_input: Vec<(usize, usize, f64)>,
}

impl Equations {
    /// Forgets all equations.
    pub fn clear(&mut self) {
        self.residuals.clear();
        self.by_position.clear();
        self.by_rotation.clear();
        self.by_own.clear();
        self.by_input.clear();
    }

    /// The residuals.
    pub fn residuals(&self) -> &[f64] {
        &self.residuals
    }

    /// Derivatives to tip positions, equation by equation, pose by pose.
    pub fn by_position(&self) -> &[[f64; 3]] {
        &self.by_position
    }

    /// Derivatives to rotation vectors, in the same order; empty if the equations do not depend on orientations.
    pub fn by_rotation(&self) -> &[[f64; 3]] {
        &self.by_rotation
    }

    /// Derivatives to own unknowns: (equation, unknown, derivative).
    pub fn by_own(&self) -> &[(usize, usize, f64)] {
        &self.by_own
    }

    /// Derivatives to known inputs: (equation, input, derivative).
    pub fn by_input(&self) -> &[(usize, usize, f64)] {
        &self.by_input
    }

    /// Adds the equations of another list.
    pub fn append(&mut self, other: &Self) {
        let first = self.residuals.len();
        let moved = |&(equation, index, derivative): &(usize, usize, f64)| (first + equation, index, derivative);
        self.residuals.extend_from_slice(&other.residuals);
        self.by_position.extend_from_slice(&other.by_position);
        self.by_rotation.extend_from_slice(&other.by_rotation);
        self.by_own.extend(other.by_own.iter().map(moved));
        self.by_input.extend(other.by_input.iter().map(moved));
    }

    /// Starts the next equation with its residual (the left side of the observation equation), mm or rad.
    pub fn equation(&mut self, residual: f64) {
        self.residuals.push(residual);
    }

    /// Derivative of the current equation to the tip position of the next pose of its row: once for every pose.
    pub fn position(&mut self, derivative: [f64; 3]) {
        self.by_position.push(derivative);
    }

    /// Derivative of the current equation to the rotation vector of the next pose: once for every pose, and only if
    /// the observations ask for orientations.
    pub fn rotation(&mut self, derivative: [f64; 3]) {
        self.by_rotation.push(derivative);
    }

    /// Derivative of the current equation to an own unknown.
    pub fn own(&mut self, unknown: usize, derivative: f64) {
        self.by_own.push((self.residuals.len() - 1, unknown, derivative));
    }

    /// Derivative of the current equation to a known input.
    pub fn input(&mut self, input: usize, derivative: f64) {
        self.by_input.push((self.residuals.len() - 1, input, derivative));
    }
}

/// Description of observations: everything that is known without evaluating an equation.
///
/// ```
/// # use abbe_core::{Contact, Layout, ObservationsInfo, Orientation, Parameter, Unit};
/// # fn info(layout: Layout) -> ObservationsInfo {
/// let zero = Parameter::new("zero", Unit::MM);
/// ObservationsInfo {
///     orientation: Orientation::Exact,
///     ..ObservationsInfo::new(layout, vec![zero], Contact::Reading("reading".to_owned()))
/// }
/// # }
/// ```
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
pub struct ObservationsInfo {
    /// The data set, the rows with their poses and equations, and the standard uncertainty of each equation.
    pub layout: Layout,
    /// Own unknowns, with own names (`facet[7].d`).
    #[serde(default)]
    pub unknowns: Vec<Parameter>,
    /// Their start values.
    #[serde(default)]
    pub start: Vec<f64>,
    /// Known inputs.
    #[serde(default)]
    pub inputs: Vec<KnownInput>,
    /// Whether the equations depend on tool orientations.
    #[serde(default)]
    pub orientation: Orientation,
    /// Equations, by their index in the layout, that are of angles (rad); all others are of lengths (mm).
    #[serde(default)]
    pub angles: BTreeSet<LayoutEquation>,
    /// The features in the table frame, to compare or plot them.
    #[serde(default)]
    pub features: Vec<Feature>,
    /// How the equations of a row come to hold in a real measurement.
    pub contact: Contact,
    /// Where rank and condition are judged.
    #[serde(default = "RankPoint::not_said")]
    pub rank_point: RankPoint,
    /// For every row the only axis that moves until contact; empty if all linear axes move.
    #[serde(default)]
    pub approaches: Vec<Approach>,
}

impl ObservationsInfo {
    /// Observations of lengths, without known inputs and features. The unknowns start from zero. The rank point is
    /// [`RankPoint::of`] the contact.
    pub fn new(layout: Layout, unknowns: Vec<Parameter>, contact: Contact) -> Self {
        let rank_point = RankPoint::of(&contact);
        Self {
            layout,
            start: vec![0.0; unknowns.len()],
            unknowns,
            inputs: Vec::new(),
            orientation: Orientation::Unused,
            angles: BTreeSet::new(),
            features: Vec::new(),
            contact,
            rank_point,
            approaches: Vec::new(),
        }
    }

    /// The quantity of an equation, counted in its row: length (mm) or angle (rad).
    pub fn quantity(&self, row: RowIndex, equation: usize) -> Quantity {
        match self.angles.contains(&(self.layout.rows[row].first_equation + equation)) {
            true => Quantity::Angle,
            false => Quantity::Length,
        }
    }

    /// The approach of a row; none if all linear axes move until contact.
    pub fn approach(&self, row: RowIndex) -> Option<&Approach> {
        self.approaches.get(row.0)
    }

    /// Nominal contact of a row that has a reading. None if the row is judged as recorded, because its reading gives more
    /// information than the errors do.
    pub fn nominal_reading(&self, row: RowIndex) -> Option<&NominalReading> {
        match &self.rank_point {
            RankPoint::NominalReading(rows) => rows.get(&row),
            _ => None,
        }
    }
}

/// The observations that an artefact made of a data set. Immutable; used from several threads at once.
pub trait Observations: Any + Send + Sync {
    /// What the observations are.
    fn info(&self) -> &ObservationsInfo;

    /// Residuals and derivatives of some rows, in the order of the batch. The equations of a row depend only on the row and
    /// on its values in the batch, not on other rows.
    ///
    /// Fails if an equation has no residual or derivative. Observations of a loaded plugin library can also fail because the
    /// library fails.
    fn evaluate(&self, batch: RowBatch<'_>, out: &mut Equations) -> Result<()>;

    /// Tip position of a row with one pose in nominal contact, table frame, mm; `_tip` is the tip position by the model. It
    /// is on the feature as estimated, without the lateral offset of the recorded contact. None if contact does not fix the
    /// tip.
    fn contact_tip(&self, _row: RowIndex, _tip: [f64; 3], _own: &[f64], _inputs: &[f64]) -> Result<Option<[f64; 3]>> {
        Ok(None)
    }
}
