//! Touches on spheres that are fixed on the table: their tip positions by different models.

use std::collections::BTreeMap;
use std::sync::Arc;

use abbe_core::{
    Absent, Axis, DataRow, Dataset, Error, Feature, Fit, KinematicModel, LabelText, Layout, ObservationSet, Poses,
    Quantity, Result, RowIndex, SetIndex, StatusColumn, plain_naming,
};
use abbe_geometry::{Fitted, Sphere, sphere};
use nalgebra::Vector3;

/// The column that says which sphere a row touches.
const FEATURE: &str = "feature";

/// The touches on one sphere that are judged together.
pub struct Touches {
    /// Label of the touches, `feature=1, file=strategy-1`; empty if there is one group only.
    pub label: String,
    /// Statuses of their poses, row by row, as the model takes them.
    pub statuses: Vec<f64>,
    /// Nominal centre in the table frame, mm; none if it is not known.
    pub centre: Option<Vector3<f64>>,
    /// Nominal distance of the tip from the centre, radius of the sphere plus that of the stylus, mm; none if it is not known.
    pub reach: Option<f64>,
}

impl Touches {
    /// The touches of an artefact's rows, without those in `left_out`, by sphere and by the labels of `column`.
    ///
    /// Fails if the artefact's rows are no touches on spheres.
    pub fn of_rows(
        fit: &Fit,
        set: SetIndex,
        left_out: impl Fn(RowIndex) -> bool,
        column: Option<&str>,
    ) -> Result<Vec<Self>> {
        let set = &fit.problem.sets[set];
        let layout = &set.info().layout;
        let rows = set.rows.iter().copied().filter(|&row| layout.rows[row].poses > 0 && !left_out(row));
        let labels = Labels::of(&layout.data, column)?;
        let features = &set.info().features;
        let mut groups = Groups::default();
        for row in rows {
            let data_row = layout.rows[row].data_row.unwrap_or_default();
            let feature =
                labels.feature.and_then(|labels| features.iter().find(|other| other.label == labels[data_row]));
            let one = || features.first().filter(|_| features.len() == 1);
            let touched = match feature.or_else(one) {
                Some(feature) => nominal_touch(set, row, feature)?,
                None => None,
            };
            let touched = touched.ok_or_else(|| {
                Error::data(format!("the rows of `{}` are no touches on spheres", set.name)).setting("rows")
            })?;
            let touches = groups.of(labels.text(data_row), touched);
            touches.statuses.extend_from_slice(set.poses().row(layout.rows[row].first_pose));
        }
        Ok(groups.named())
    }

    /// The touches in a data set of its own, by the column `feature`, if there is one, and by the labels of `column`.
    ///
    /// Times are not passed on: a drift of the model during its own data has no meaning for these touches.
    pub fn of_data(
        data: &Dataset,
        model: &dyn KinematicModel,
        reach: Option<f64>,
        column: Option<&str>,
    ) -> Result<Vec<Self>> {
        let timeless = |status: &StatusColumn, axis: Option<&Axis>| match status.quantity {
            Quantity::Time => (Vec::new(), Absent::Default(f64::NAN)),
            _ => plain_naming(status, axis),
        };
        let mut layout = Layout::new(&Arc::new(data.clone()), model, &[&timeless])?;
        let labels = Labels::of(data, column)?;
        let mut groups = Groups::default();
        for row in data.row_indices() {
            let pose = layout.poses.end();
            layout.push(model, row, &[])?;
            let touches = groups.of(labels.text(row), (None, reach));
            touches.statuses.extend_from_slice(layout.poses.row(pose));
        }
        Ok(groups.named())
    }

    /// The least squares sphere through the tips by the model with these values of its parameters.
    pub fn sphere(&self, model: &dyn KinematicModel, values: &[f64]) -> Result<Fitted<Sphere>> {
        self.through(&tips(model, &self.statuses, values)?)
    }

    /// The least squares sphere through tips of these touches.
    pub fn through(&self, tips: &[Vector3<f64>]) -> Result<Fitted<Sphere>> {
        let place = if self.label.is_empty() { String::new() } else { format!("{}: ", self.label) };
        sphere(tips).map_err(|error| Error::data(format!("{place}{error}")))
    }
}

/// Tip positions in the table frame, mm.
pub fn tips(model: &dyn KinematicModel, statuses: &[f64], values: &[f64]) -> Result<Vec<Vector3<f64>>> {
    let mut poses = Poses::default();
    model.poses(statuses, values, &[], false, &mut poses)?;
    Ok(poses.positions.into_iter().map(Vector3::from).collect())
}

/// Nominal centre of the sphere that is touched, and nominal distance of the tip from it; none where they are not known.
type NominalTouch = (Option<Vector3<f64>>, Option<f64>);

/// The nominal touch of a row; none if it is no touch on a sphere.
fn nominal_touch(set: &ObservationSet, row: RowIndex, feature: &Feature) -> Result<Option<NominalTouch>> {
    let rows = &set.info().layout.rows;
    // A feature that can be off in all directions, with one equation a touch, is touched at a distance from its centre.
    if rows[row].poses != 1 || rows[row].equations != 1 || feature.shifts.len() != 3 {
        return Ok(None);
    }
    let own = &set.info().start;
    let shifts = feature.shifts.iter().map(|(index, direction)| own[*index] * Vector3::from(*direction));
    let centre = Vector3::from(feature.point) + shifts.sum::<Vector3<f64>>();
    let outside = centre + Vector3::z();
    let contact = set.observations.contact_tip(row, outside.into(), own, &set.inputs)?;
    Ok(contact.map(|contact| (Some(centre), Some((Vector3::from(contact) - centre).norm()))))
}

/// The labels that tell touches apart.
struct Labels<'a> {
    feature: Option<&'a [LabelText]>,
    split: Option<(&'a str, &'a [LabelText])>,
}

impl<'a> Labels<'a> {
    fn of(data: &'a Dataset, column: Option<&'a str>) -> Result<Self> {
        let feature = data.column(FEATURE).map(|_| abbe_table::labels(data, FEATURE)).transpose()?;
        let labels = |name| abbe_table::labels(data, name).map_err(|error| error.setting("column"));
        let split = column.map(|name| labels(name).map(|labels| (name, labels))).transpose()?;
        Ok(Self { feature, split })
    }

    /// Sphere and part of a row, for people: `["feature=1", "file=a"]`.
    fn text(&self, row: DataRow) -> Vec<String> {
        let feature = self.feature.map(|labels| (FEATURE, labels));
        feature.into_iter().chain(self.split).map(|(name, labels)| format!("{name}={}", labels[row])).collect()
    }
}

/// Touches by their labels, in the order in which they appear.
#[derive(Default)]
struct Groups {
    index: BTreeMap<Vec<String>, usize>,
    touches: Vec<Touches>,
}

impl Groups {
    fn of(&mut self, label: Vec<String>, (centre, reach): NominalTouch) -> &mut Touches {
        let index = match self.index.get(&label) {
            Some(&index) => index,
            None => {
                self.touches.push(Touches { label: label.join(", "), statuses: Vec::new(), centre, reach });
                self.index.insert(label, self.touches.len() - 1);
                self.touches.len() - 1
            }
        };
        &mut self.touches[index]
    }

    /// The touches; a single group needs no label.
    fn named(mut self) -> Vec<Touches> {
        if let [only] = self.touches.as_mut_slice() {
            only.label.clear();
        }
        self.touches
    }
}
