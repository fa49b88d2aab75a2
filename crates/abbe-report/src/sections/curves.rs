//! The errors along their axes.

use abbe_core::{ErrorFunction, KinematicModel, Quantity, Result, StatusRole, machine_values};
use abbe_volumetric::standing;

use crate::analysis::{travel, unit};
use crate::chart::{Curve, curve};
use crate::html::{figure, paragraph};
use crate::run::FitResult;

/// Positions along an axis.
const POINTS: usize = 41;

/// The section for one estimate.
pub fn curves(fit: &FitResult) -> String {
    let info = fit.model.info();
    let travel = travel(fit);
    let mut charts = String::new();
    let mut silent: Vec<String> = Vec::new();
    for function in &info.error_functions {
        let Some(range) = travel.get(function.axis).copied().flatten().filter(|[from, to]| to > from) else { continue };
        let axis = &info.axes[function.axis];
        let (symbol, factor) = unit(axis.kind);
        let to_people = if function.quantity == Quantity::Angle { ("µrad", 1e6) } else { ("µm", 1e3) };
        match sampled(fit, function, range, factor, to_people.1) {
            Ok(Some(told)) => {
                let names = [&*format!("{} {symbol}", axis.name), to_people.0];
                charts.push_str(&curve(&function.symbol, names, &told));
            }
            Ok(None) => silent.push(function.symbol.clone()),
            Err(error) => charts.push_str(&paragraph(&format!("{}: {error}", function.symbol))),
        }
    }
    if charts.is_empty() {
        return paragraph("No error of an axis was estimated.");
    }
    let mut caption = "Line: axis comes in positive direction; dashed: in negative direction, where it makes a difference. Band: expanded \
                       uncertainty, k = 2. All other axes stand at zero."
        .to_owned();
    if !silent.is_empty() {
        caption.push_str(&format!(" Not estimated: {}.", silent.join(", ")));
    }
    figure(&format!("<div class=\"curves\">\n{charts}</div>\n"), &caption)
}

/// An error along its axis; none if it is zero and known.
fn sampled(
    fit: &FitResult,
    function: &ErrorFunction,
    [from, to]: [f64; 2],
    factor: f64,
    to_people: f64,
) -> Result<Option<Curve>> {
    let model: &dyn KinematicModel = fit.model.as_ref();
    let info = model.info();
    let values = machine_values(model, &fit.calibration);
    let column = info.axes[function.axis].status;
    let mut status = standing(model);
    let mut told = Curve { positions: Vec::new(), forward: Vec::new(), half: Vec::new(), backward: Vec::new() };
    for sign in [1.0, -1.0] {
        for (place, its) in info.status.iter().enumerate() {
            if matches!(its.role, StatusRole::Direction(_)) {
                status[place] = sign;
            }
        }
        for index in 0..POINTS {
            let position = from + (to - from) * index as f64 / (POINTS - 1) as f64;
            status[column] = position;
            let error = model.motion_error(function, &values, &status)?;
            if sign < 0.0 {
                told.backward.push(error.value * to_people);
                continue;
            }
            told.positions.push(position * factor);
            told.forward.push(error.value * to_people);
            told.half.push(2.0 * uncertainty(fit, &error.derivatives) * to_people);
        }
    }
    if told.forward.iter().chain(&told.half).chain(&told.backward).all(|value| *value == 0.0) {
        return Ok(None);
    }
    let largest = told.forward.iter().map(|value| value.abs()).fold(0.0, f64::max);
    if told.forward.iter().zip(&told.backward).all(|(one, other)| (one - other).abs() <= 1e-9 * largest) {
        told.backward.clear();
    }
    Ok(Some(told))
}

/// Standard uncertainty of a sum of parameters with these derivatives.
fn uncertainty(fit: &FitResult, derivatives: &[(usize, f64)]) -> f64 {
    let covariance = &fit.calibration.covariance;
    let parameters = &fit.model.info().parameters;
    let known: Vec<(usize, f64)> = derivatives
        .iter()
        .filter_map(|(index, slope)| Some((covariance.index(&parameters[*index].name)?, *slope)))
        .collect();
    let part = |(row, one): &(usize, f64)| {
        known.iter().map(|(column, other)| one * other * covariance.rows[*row][*column]).sum::<f64>()
    };
    known.iter().map(part).sum::<f64>().max(0.0).sqrt()
}
