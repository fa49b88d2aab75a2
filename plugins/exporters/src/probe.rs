//! Exporter `probe`: the effective stylus radius by direction of contact and feed, as a table for the probing cycles of a control.

use std::fmt::Write as _;

use abbe_core::{
    Calibration, Context, Error, Export, ExportedFile, KinematicModel, ParameterRole, Result, SettingsError,
    StatusRole, machine_values, positive,
};
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::sampling::fixed;

abbe_core::register!(
    Export,
    "probe",
    "effective stylus radius by direction of contact and feed, as CSV",
    Settings,
    example,
    build,
    "../reference/export-probe.md",
);

/// Settings of the table.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// Distance of directions in azimuth, which is counted from the tool's x to its y.
    #[serde(default = "default_azimuth_step")]
    azimuth_step_deg: f64,
    /// Elevations above the plane across the tool axis: 0 is a touch from the side, 90 one along the tool.
    #[serde(default = "default_elevations")]
    elevations_deg: Vec<f64>,
    /// Feeds of the probing cycles; needed if the probe has a delay.
    #[serde(default)]
    #[schemars(inner(range(min = 0.001, max = abbe_probe::LARGEST_FEED)))]
    feeds_mm_per_min: Vec<f64>,
}

fn default_azimuth_step() -> f64 {
    15.0
}

fn default_elevations() -> Vec<f64> {
    vec![0.0, 30.0, 60.0, 90.0]
}

/// Most lines of a table: what a control or a spreadsheet still takes.
const MOST: usize = 100_000;

fn example() -> Value {
    json!({ "azimuth_step_deg": 15, "elevations_deg": [0, 45, 90], "feeds_mm_per_min": [30, 120] })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Export>, SettingsError> {
    let step = settings.azimuth_step_deg;
    let turns = (360.0 / step).round();
    if !(0.1..=180.0).contains(&step) || (turns * step - 360.0).abs() > 1e-9 {
        return Err(SettingsError::new("azimuth_step_deg", "a step from 0.1 to 180 that divides 360 was expected"));
    }
    if settings.elevations_deg.is_empty() {
        return Err(SettingsError::new("elevations_deg", "one elevation at least was expected"));
    }
    let indexed =
        |key: &str, index: usize| vec![abbe_core::PathItem::Key(key.to_owned()), abbe_core::PathItem::Index(index)];
    for (index, elevation) in settings.elevations_deg.iter().enumerate() {
        if !(-90.0..=90.0).contains(elevation) {
            let error = SettingsError::new("", "an elevation from -90 to 90 was expected");
            return Err(error.under(indexed("elevations_deg", index)));
        }
    }
    for (index, feed) in settings.feeds_mm_per_min.iter().enumerate() {
        positive("", *feed).map_err(|error| error.under(indexed("feeds_mm_per_min", index)))?;
        if *feed > abbe_probe::LARGEST_FEED {
            let message = format!("{feed:e}: a number up to {} was expected", abbe_probe::LARGEST_FEED);
            return Err(SettingsError::new("", message).under(indexed("feeds_mm_per_min", index)));
        }
    }
    for (key, values) in
        [("elevations_deg", &settings.elevations_deg), ("feeds_mm_per_min", &settings.feeds_mm_per_min)]
    {
        let twice = (1..values.len()).find(|&index| values[..index].contains(&values[index]));
        if let Some(index) = twice {
            return Err(SettingsError::new("", format!("{} is there twice", values[index])).under(indexed(key, index)));
        }
    }
    let lines = turns as usize * settings.elevations_deg.len() * settings.feeds_mm_per_min.len().max(1);
    if lines > MOST {
        return Err(SettingsError::new(
            "azimuth_step_deg",
            format!("this gives {lines} lines; at most {MOST} were expected"),
        ));
    }
    Ok(Box::new(ProbeTable { settings }))
}

struct ProbeTable {
    settings: Settings,
}

impl Export for ProbeTable {
    fn export(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Vec<ExportedFile>> {
        if !abbe_probe::has_terms(model) {
            return Err(Error::usage("the model has no terms of a probe to tabulate")
                .help("list some under `probe` of the model, e.g. `probe: [r0, \"lobe[cos3]\", \"lobe[sin3]\"]`"));
        }
        if abbe_probe::has_delay(model) && self.settings.feeds_mm_per_min.is_empty() {
            return Err(Error::usage("the probe has a delay: its radius follows the feed")
                .setting("feeds_mm_per_min")
                .help("list the feeds of the probing cycles"));
        }
        let styli = match model.info().status_index(&StatusRole::Stylus) {
            Some(column) => model.info().status[column].levels.clone(),
            None => vec!["1".to_owned()],
        };
        let values = machine_values(model, calibration);
        let mut text = String::from(
            "stylus,feed_mm_per_min,azimuth_deg,elevation_deg,nx,ny,nz,effective_radius_mm,standard_uncertainty_um\n",
        );
        let feeds = match self.settings.feeds_mm_per_min.as_slice() {
            [] => &[0.0],
            feeds => feeds,
        };
        let turns = (360.0 / self.settings.azimuth_step_deg).round() as usize;
        for (stylus, label) in styli.iter().enumerate() {
            for feed in feeds {
                for elevation in &self.settings.elevations_deg {
                    for turn in 0..turns {
                        let azimuth = turn as f64 * self.settings.azimuth_step_deg;
                        let direction = direction(azimuth, *elevation);
                        let deviation = abbe_probe::deviation(model, &values, stylus, &direction, feed / 60.0);
                        let radius = model.info().stylus_radius + deviation;
                        let uncertainty = uncertainty(calibration, model, stylus, &direction, feed / 60.0);
                        let _ = write!(text, "{label},{feed},{azimuth},{elevation}");
                        for component in direction.iter() {
                            let _ = write!(text, ",{}", fixed(*component));
                        }
                        let _ = writeln!(text, ",{},{}", fixed(radius), fixed(uncertainty * 1e3));
                        // All azimuths are one at the pole.
                        if elevation.abs() == 90.0 {
                            break;
                        }
                    }
                }
            }
        }
        Ok(vec![ExportedFile { name: "probe-radii.csv".to_owned(), content: text.into_bytes() }])
    }
}

/// The unit vector with this azimuth and elevation in degrees, frame of the tool.
fn direction(azimuth: f64, elevation: f64) -> Vector3<f64> {
    let ((sine, cosine), (height, across)) = (azimuth.to_radians().sin_cos(), elevation.to_radians().sin_cos());
    Vector3::new(across * cosine, across * sine, height)
}

/// Standard uncertainty of the effective radius, mm, by the covariance of the calibration.
fn uncertainty(
    calibration: &Calibration,
    model: &dyn KinematicModel,
    stylus: usize,
    direction: &Vector3<f64>,
    feed: f64,
) -> f64 {
    let parameters = model.info().parameters.iter();
    let terms: Vec<(usize, f64)> = parameters
        .filter_map(|parameter| match parameter.role {
            ParameterRole::Probe { stylus: of, term } if of == stylus => {
                let row = calibration.covariance.index(&parameter.name)?;
                Some((row, abbe_probe::value(term, direction, feed).0))
            }
            _ => None,
        })
        .collect();
    let pairs = terms.iter().flat_map(|one| terms.iter().map(move |other| (one, other)));
    let rows = &calibration.covariance.rows;
    let variance: f64 = pairs.map(|((row, a), (column, b))| a * b * rows[*row][*column]).sum();
    variance.max(0.0).sqrt()
}
