//! The error field: as it is, corrected, of other runs; in the volume of the linear axes for slices; ellipsoids of its uncertainty.

use abbe_core::{AxisKind, Calibration, KinematicModel, Poses, machine_values};
use abbe_volumetric::{is_machine_error, predict, standing};
use serde_json::{Value, json};

use super::floats;
use crate::analysis::{Analysis, same_machine, travel, unit};
use crate::run::FitResult;

/// Places of the volume at most.
const MOST: usize = 1000;

/// Positions along an axis of the volume at most.
const ALONG: usize = 21;

/// Probability of the ellipsoids.
const PROBABILITY: f64 = 0.95;

/// Ellipsoids at most.
const ELLIPSOIDS: usize = 27;

/// Places on a grid of the linear axes; the rotary axes stand still.
pub struct Volume {
    /// Name of each axis and its positions, mm.
    axes: Vec<(String, Vec<f64>)>,
    /// Where the others stand, for people.
    others: String,
    statuses: Vec<f64>,
    /// Tips of the machine without errors, mm.
    places: Vec<[f64; 3]>,
}

impl Volume {
    /// The volume; none without two or three linear axes.
    pub fn of(fit: &FitResult) -> Option<Self> {
        let model = fit.model.as_ref();
        let info = model.info();
        let mut status = standing(model);
        let (mut axes, mut columns, mut others) = (Vec::new(), Vec::new(), Vec::new());
        let known = travel(fit);
        let wide = |index: usize| known[index].filter(|[from, to]| to - from > 1e-6);
        let linear = |index: &usize| {
            let axis = &info.axes[*index];
            axis.kind == AxisKind::Linear && !axis.indexed && wide(*index).is_some()
        };
        let count = (0..info.axes.len()).filter(linear).count();
        if !(2..=3).contains(&count) {
            return None;
        }
        let points = (2..=ALONG).rev().find(|points| points.pow(count as u32) <= MOST).unwrap_or(2);
        for (index, axis) in info.axes.iter().enumerate() {
            if let (true, Some([from, to])) = (linear(&index), wide(index)) {
                let at = |number: usize| from + (to - from) * number as f64 / (points - 1) as f64;
                axes.push((axis.name.clone(), (0..points).map(at).collect::<Vec<f64>>()));
                columns.push(axis.status);
            } else if let Some([from, to]) = known[index] {
                // Where they would stand by themselves: at zero, if they reach it.
                status[axis.status] = 0.0_f64.clamp(from, to);
                let (symbol, factor) = unit(axis.kind);
                others.push(format!("{} {:.0} {symbol}", axis.name, status[axis.status] * factor));
            }
        }
        let mut rows = vec![status];
        for (column, (_, positions)) in columns.iter().zip(&axes) {
            let moved = |row: &Vec<f64>, at: f64| {
                let mut row = row.clone();
                row[*column] = at;
                row
            };
            rows = rows.iter().flat_map(|row| positions.iter().map(move |at| moved(row, *at))).collect();
        }
        let statuses = rows.concat();
        let mut nominal = Poses::default();
        model.poses(&statuses, &info.without_errors(), &[], false, &mut nominal).ok()?;
        Some(Self { axes, others: others.join(", "), statuses, places: nominal.positions })
    }

    /// Names of its axes.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.axes.iter().map(|(name, _)| name.as_str())
    }

    /// What the script needs; the last axis changes fastest.
    pub fn json(&self) -> Value {
        let axes = self.axes.iter().map(|(name, at)| json!({ "name": name, "at": at }));
        json!({ "axes": axes.collect::<Vec<_>>(), "others": self.others, "places": floats(self.places.iter().copied()) })
    }

    /// Statuses of its corners, middles of edges and of faces, and its middle.
    fn corners(&self) -> (Vec<f64>, Vec<[f64; 3]>) {
        let width = self.statuses.len() / self.places.len().max(1);
        let counts: Vec<usize> = self.axes.iter().map(|(_, at)| at.len()).collect();
        let is_corner = |index: &usize| {
            let mut rest = *index;
            counts.iter().rev().all(|count| {
                let place = rest % count;
                rest /= count;
                place == 0 || place == count / 2 || place == count - 1
            })
        };
        let chosen: Vec<usize> = (0..self.places.len()).filter(is_corner).collect();
        let statuses = chosen.iter().flat_map(|index| &self.statuses[index * width..(index + 1) * width]);
        (statuses.copied().collect(), chosen.iter().map(|index| self.places[*index]).collect())
    }
}

/// A field that can be shown.
pub struct Shown {
    /// What it is.
    pub name: String,
    /// At the places of the analysis, mm.
    field: Vec<[f64; 3]>,
    /// At the places of the volume, mm.
    volume: Vec<[f64; 3]>,
}

impl Shown {
    /// What the script needs.
    pub fn json(&self) -> Value {
        json!({
            "name": self.name,
            "field": floats(self.field.iter().copied()),
            "volume": floats(self.volume.iter().copied()),
        })
    }
}

/// The errors at some statuses, mm; none where the model fails.
fn errors(model: &dyn KinematicModel, calibration: &Calibration, statuses: &[f64]) -> Option<Vec<[f64; 3]>> {
    let info = model.info();
    let mut values = machine_values(model, calibration);
    for (parameter, (value, nominal)) in info.parameters.iter().zip(values.iter_mut().zip(&info.nominal)) {
        if !is_machine_error(parameter.role) {
            *value = *nominal;
        }
    }
    let (mut actual, mut nominal) = (Poses::default(), Poses::default());
    model.poses(statuses, &values, &[], false, &mut actual).ok()?;
    model.poses(statuses, &info.nominal, &[], false, &mut nominal).ok()?;
    let both = actual.positions.iter().zip(&nominal.positions);
    Some(both.map(|(actual, nominal)| [0, 1, 2].map(|part| actual[part] - nominal[part])).collect())
}

/// The field before and after corrections, and in other runs of such a machine.
pub fn shown(fit: &FitResult, found: &Analysis, volume: Option<&Volume>, others: &[(&str, &FitResult)]) -> Vec<Shown> {
    let mut all = Vec::new();
    let mut add = |name: String, fit: &FitResult, calibration: &Calibration| {
        let model = fit.model.as_ref();
        let field = errors(model, calibration, found.statuses());
        let of_volume = volume.map_or(Some(Vec::new()), |volume| errors(model, calibration, &volume.statuses));
        if let (Some(field), Some(volume)) = (field, of_volume) {
            all.push(Shown { name, field, volume });
        }
    };
    let own = if others.is_empty() { "before: as calibrated".to_owned() } else { "as calibrated".to_owned() };
    add(own, fit, &fit.calibration);
    for (name, other) in others.iter().filter(|(_, other)| same_machine(fit, other)) {
        add(format!("in {name}"), other, &other.calibration);
    }
    if let Some(first) = found.causes.first().filter(|cause| cause.part.loss.value > 0.0) {
        add(format!("after: {} corrected", first.name), fit, &corrected(fit, &first.parameters));
    }
    if !found.three().is_empty() {
        add("after: the three largest causes corrected".to_owned(), fit, &corrected(fit, found.three()));
    }
    all
}

/// A calibration in which some parameters of the model are nominal.
fn corrected(fit: &FitResult, parameters: &[usize]) -> Calibration {
    let info = fit.model.info();
    let mut calibration = fit.calibration.clone();
    for index in parameters {
        let name = &info.parameters[*index].name;
        for known in calibration.parameters.iter_mut().filter(|known| known.name == *name) {
            known.value = info.nominal[*index];
        }
    }
    calibration
}

/// Places and half axes of the ellipsoids in which the error lies with 95 %, errors of the machine alone.
pub fn ellipsoids(fit: &FitResult, volume: Option<&Volume>, found: &Analysis) -> Value {
    let model = fit.model.as_ref();
    let (statuses, places) = match volume {
        Some(volume) => volume.corners(),
        None => {
            let width = model.info().status.len().max(1);
            let every = found.field.len().div_ceil(ELLIPSOIDS).max(1);
            let rows = found.statuses().chunks(width).step_by(every).flatten().copied().collect();
            (rows, found.field.iter().step_by(every).map(|(place, _)| *place).collect())
        }
    };
    let known = predict(model, &machine_alone(fit), &statuses).unwrap_or_default();
    let (mut at, mut half) = (Vec::new(), Vec::new());
    for (place, error) in places.into_iter().zip(known) {
        let Ok(region) = error.ellipsoid(PROBABILITY) else { continue };
        let Some(sizes) = region.semi_axes else { continue };
        at.push(place);
        half.extend(region.directions.iter().zip(sizes).map(|(to, size)| to.map(|part| part * size)));
    }
    json!({ "places": floats(at.into_iter()), "axes": floats(half.into_iter()) })
}

/// The calibration without what depends on a set-up.
fn machine_alone(fit: &FitResult) -> Calibration {
    let mut calibration = fit.calibration.clone();
    let is_machine = |name: &str| {
        let found = fit.model.info().parameters.iter().find(|parameter| parameter.name == name);
        found.is_some_and(|parameter| is_machine_error(parameter.role))
    };
    calibration.parameters.retain(|known| is_machine(&known.name));
    let covariance = &mut calibration.covariance;
    let kept: Vec<usize> = (0..covariance.order.len()).filter(|index| is_machine(&covariance.order[*index])).collect();
    let part = |row: &usize| kept.iter().map(|column| covariance.rows[*row][*column]).collect();
    let rows: Vec<Vec<f64>> = kept.iter().map(part).collect();
    covariance.order = kept.iter().map(|index| covariance.order[*index].clone()).collect();
    covariance.rows = rows;
    calibration
}
