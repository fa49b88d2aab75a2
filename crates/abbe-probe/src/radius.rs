//! The effective stylus radius in the rows of a data set.

use std::path::PathBuf;

use abbe_core::{
    ColumnHeader, DataRow, Dataset, Equations, KinematicModel, KnownInput, Layout, Orientation, ParameterRole,
    ProbeTerm, Quantity, Result, RowBatch, RowIndex, StatusRole,
};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use crate::term::value;

/// Name of the column of the feed, without its unit.
const FEED: &str = "feed";

/// The terms of a model: the index of the parameter, the stylus, and what it multiplies.
fn terms(model: &dyn KinematicModel) -> Vec<(usize, usize, ProbeTerm)> {
    let parameters = model.info().parameters.iter().enumerate();
    parameters
        .filter_map(|(index, parameter)| match parameter.role {
            ParameterRole::Probe { stylus, term } => Some((index, stylus, term)),
            _ => None,
        })
        .collect()
}

/// Whether the probe of a model has terms besides the stylus radius.
pub fn has_terms(model: &dyn KinematicModel) -> bool {
    !terms(model).is_empty()
}

/// Whether the probe of a model has a delay.
pub fn has_delay(model: &dyn KinematicModel) -> bool {
    terms(model).iter().any(|(_, _, term)| *term == ProbeTerm::Delay)
}

/// Refuses data without a feed if the probe of the model has a delay.
pub fn check_columns(headers: &[ColumnHeader], file: Option<&PathBuf>, model: &dyn KinematicModel) -> Result<()> {
    if !has_delay(model) {
        return Ok(());
    }
    abbe_table::require(headers, file, &[(FEED, Quantity::Speed)]).map_err(|error| {
        let help = "the model's `probe` has a `delay`, which needs the feed of every touch: add the column, or take `delay` out";
        error.help(help)
    })
}

/// Largest feed of a probe, mm/min: the rapid traverse of the fastest machines.
pub const LARGEST_FEED: f64 = 1e5;

/// Feeds at which people touch, mm/min. A slower touch takes a minute for a few millimetres, a faster one bends what it touches.
const USUAL_FEEDS: [f64; 2] = [5.0, 3000.0];

/// Tells of data whose touches are all slower than people touch, or of which some are faster.
fn tell_unusual(data: &Dataset, feeds: &[f64]) {
    let [slowest, fastest] = USUAL_FEEDS;
    let (least, most) = feeds
        .iter()
        .fold((f64::INFINITY, 0.0_f64), |(least, most), feed| (least.min(feed * 60.0), most.max(feed * 60.0)));
    if !feeds.is_empty() && (most < slowest || most > fastest) {
        let file = data.files.first().map(|file| file.display().to_string()).unwrap_or_default();
        tracing::warn!(
            "{file}: touches have feeds from {} to {} mm/min, and {slowest} to {fastest} mm/min are usual: is the \
             feed in the unit that its column says?",
            rounded(least),
            rounded(most)
        );
    }
}

/// Thousandths, as people read a feed.
fn rounded(feed: f64) -> f64 {
    (feed * 1e3).round() / 1e3
}

/// Refuses a feed that no touch has: it has no sign, and does not stand still.
fn check_feed(data: &Dataset, row: DataRow, feed: f64) -> Result<()> {
    let feed = feed * 60.0;
    if feed > 0.0 && feed <= LARGEST_FEED {
        return Ok(());
    }
    let message = format!("a feed of {feed} mm/min; more than 0 and {LARGEST_FEED} mm/min at most were expected");
    Err(data
        .error_at(row, message)
        .help("a feed has no sign: the direction of a touch is that of the surface. Is its unit that of the column?"))
}

/// The effective stylus radius of the rows of some observations: known inputs and what they do.
///
/// Its inputs come first among those of the observations: the stylus radius, then one for every term of the model's probe.
#[derive(Debug)]
pub struct EffectiveRadius {
    inputs: Vec<KnownInput>,
    /// The stylus and the term of every input after the first.
    terms: Vec<(usize, ProbeTerm)>,
    /// Stylus and feed of every row; empty without terms.
    rows: Vec<(usize, f64)>,
}

impl EffectiveRadius {
    /// That of the rows of a layout, which are the touches of `data`. `standard_uncertainty` is that of the stylus radius, mm.
    ///
    /// Fails if the probe of the model has a delay and the data have no feed.
    pub fn new(model: &dyn KinematicModel, layout: &Layout, standard_uncertainty: f64) -> Result<Self> {
        let of_model = terms(model);
        let mut inputs = vec![KnownInput::stylus_radius(model, standard_uncertainty)];
        inputs.extend(of_model.iter().map(|(index, ..)| KnownInput::of_model(model, *index)));
        let mut rows = Vec::new();
        if !of_model.is_empty() {
            let feeds = match has_delay(model) {
                true => Some(abbe_table::numbers(&layout.data, FEED, Quantity::Speed)?),
                false => None,
            };
            let stylus = model.info().status_index(&StatusRole::Stylus);
            for row in &layout.rows {
                let feed = feeds.zip(row.data_row).map_or(0.0, |(feeds, data_row)| feeds[data_row]);
                if let (Some(_), Some(data_row)) = (feeds, row.data_row) {
                    check_feed(&layout.data, data_row, feed)?;
                }
                // A stylus that the model does not describe is refused with the poses.
                let stylus =
                    stylus.filter(|_| row.poses > 0).map_or(0.0, |column| layout.poses.row(row.first_pose)[column]);
                rows.push((stylus as usize, feed));
            }
            if feeds.is_some() {
                tell_unusual(&layout.data, &rows.iter().map(|(_, feed)| *feed).collect::<Vec<f64>>());
            }
        }
        let terms = of_model.into_iter().map(|(_, stylus, term)| (stylus, term)).collect();
        Ok(Self { inputs, terms, rows })
    }

    /// One that is the same in all directions, whatever terms the model has: for what was not touched in single directions.
    pub fn constant(model: &dyn KinematicModel, standard_uncertainty: f64) -> Self {
        let inputs = vec![KnownInput::stylus_radius(model, standard_uncertainty)];
        Self { inputs, terms: Vec::new(), rows: Vec::new() }
    }

    /// Its inputs: they have to come first among those of the observations.
    pub fn inputs(&self) -> &[KnownInput] {
        &self.inputs
    }

    /// Which orientation of the tool it needs.
    pub fn orientation(&self) -> Orientation {
        if self.terms.is_empty() { Orientation::Unused } else { Orientation::Exact }
    }

    /// Whether it is the same in all directions, at these values of the inputs.
    pub fn is_constant(&self, inputs: &[f64]) -> bool {
        self.terms.iter().zip(&inputs[1..]).all(|(_, value)| *value == 0.0)
    }

    /// The radius in a row that touches a surface with this outward unit normal (table frame). `pose` is the pose of the row among
    /// those of the batch.
    pub fn at(&self, row: RowIndex, pose: usize, batch: &RowBatch<'_>, normal: &Vector3<f64>) -> ContactRadius {
        let mut radius = ContactRadius { value: batch.inputs[0], ..ContactRadius::default() };
        let Some(&(stylus, feed)) = self.rows.get(row.0) else { return radius };
        let [w, x, y, z] = batch.orientations[pose];
        let tool = UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z));
        let seen = tool.inverse_transform_vector(normal);
        let mut slope = Vector3::zeros();
        let inputs = self.terms.iter().zip(&batch.inputs[1..]).enumerate();
        for (index, (&(_, term), coefficient)) in inputs.filter(|(_, ((of, _), _))| *of == stylus) {
            let (value, by_direction) = value(term, &seen, feed);
            radius.value += coefficient * value;
            slope += *coefficient * by_direction;
            radius.by_terms.push((index + 1, value));
        }
        radius.by_normal = tool.transform_vector(&slope);
        // The tool turned by a small t sees n turned by -t: the radius changes by -t . (n x slope).
        radius.by_rotation = Some(-normal.cross(&radius.by_normal));
        radius
    }
}

/// The effective stylus radius at a contact, mm, with its derivatives.
#[derive(Debug, Clone, Default)]
pub struct ContactRadius {
    /// Its value.
    pub value: f64,
    /// Derivative to the outward normal, table frame.
    pub by_normal: Vector3<f64>,
    /// Derivative to the rotation vector of the tool, table frame; none without terms.
    by_rotation: Option<Vector3<f64>>,
    /// Derivatives to the inputs after the first.
    by_terms: Vec<(usize, f64)>,
}

impl ContactRadius {
    /// Writes the equation of a touch, `residual = distance - ... - radius`, with its derivatives to tip, orientation and inputs.
    ///
    /// `by_tip` is the derivative of the whole residual to the tip: the normal, less what the radius does where the normal turns with
    /// the tip.
    pub fn write(&self, residual: f64, by_tip: &Vector3<f64>, out: &mut Equations) {
        out.equation(residual);
        out.position((*by_tip).into());
        if let Some(by_rotation) = &self.by_rotation {
            out.rotation((-by_rotation).into());
        }
        out.input(0, -1.0);
        self.by_terms.iter().for_each(|&(input, value)| out.input(input, -value));
    }
}

/// Deviation of the effective radius of a stylus (by its index) from the stylus radius, mm, by the terms of a model with these values of
/// its parameters. `direction` is the outward unit normal of the surface seen from the probe, `feed` is in mm/s.
pub fn deviation(
    model: &dyn KinematicModel,
    machine_values: &[f64],
    stylus: usize,
    direction: &Vector3<f64>,
    feed: f64,
) -> f64 {
    let of_stylus = terms(model).into_iter().filter(|(_, of, _)| *of == stylus);
    of_stylus.map(|(index, _, term)| machine_values[index] * value(term, direction, feed).0).sum()
}
