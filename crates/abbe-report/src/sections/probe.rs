//! The effective stylus radius by the direction of contact.

use abbe_core::{ModelInfo, ParameterRole, ProbeTerm, Status, StatusRole, machine_values};

use crate::chart::hemisphere;
use crate::html::{figure, paragraph};
use crate::run::FitResult;

/// The terms of a probe that are lobes, by the index of their parameter and their stylus.
fn lobes(info: &ModelInfo) -> impl Iterator<Item = (usize, usize)> {
    let roles = info.parameters.iter().map(|parameter| parameter.role).enumerate();
    roles.filter_map(|(index, role)| match role {
        ParameterRole::Probe { stylus, term } if !matches!(term, ProbeTerm::Radius | ProbeTerm::Delay) => {
            Some((index, stylus))
        }
        _ => None,
    })
}

/// Whether an estimate says how the radius follows the direction.
pub fn has_lobes(fit: &FitResult) -> bool {
    lobes(fit.model.info()).any(|(index, _)| {
        let known = fit.calibration.get(&fit.model.info().parameters[index].name);
        known.is_some_and(|known| known.status == Status::Estimated)
    })
}

/// The section for one estimate: a map for every stylus, of the lobes alone.
pub fn probe(fit: &FitResult) -> String {
    let info = fit.model.info();
    let mut values = vec![0.0; info.parameters.len()];
    let all = machine_values(fit.model.as_ref(), &fit.calibration);
    lobes(info).for_each(|(index, _)| values[index] = all[index]);
    let labels = info.status_index(&StatusRole::Stylus).map_or(&[][..], |column| info.status[column].levels.as_slice());
    let mut charts = String::new();
    for stylus in 0..labels.len().max(1) {
        let lobing = |azimuth: f64, elevation: f64| {
            let ((sine, cosine), (height, across)) = (azimuth.to_radians().sin_cos(), elevation.to_radians().sin_cos());
            let direction = [across * cosine, across * sine, height].into();
            abbe_probe::deviation(fit.model.as_ref(), &values, stylus, &direction, 0.0) * 1e3
        };
        let of = if labels.len() > 1 { format!(", stylus {}", labels[stylus]) } else { String::new() };
        let title = format!("Effective radius{of}");
        charts.push_str(&figure(&hemisphere(&title, "µm", lobing), &title));
    }
    let words = "How the effective stylus radius follows the direction of the surface's normal, seen along the tool: the pole, a touch \
                 along the tool, is in the middle, touches from the side are outside; 0° is the tool's x. What is the same in all \
                 directions, and the delay, are left out.";
    paragraph(words) + &charts
}
