//! Deviations of recorded values from the truth: noise, drift, lobing, outliers, resolution.

use std::collections::BTreeMap;
use std::f64::consts::TAU;

use abbe_core::{
    Contact, Error, ObservationSet, Problem, Quantity, Result, Row, SetIndex, SettingsError, Whole, from_settings,
    not_negative, positive,
};
use abbe_estimation::Variation;
use abbe_numerics::Generator;
use serde::Deserialize;
use serde_json::{Map, Value};

use crate::listed::Listed;
use crate::lobing::{Lobing, contact_directions};
use crate::measure::is_length;
use crate::sensors::Sensors;
use crate::truth::{key, known_only, machine_parameter};

/// How a measurement differs from the truth.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Noise {
    /// Standard deviation of the probe or the reading, mm; independent from equation to equation.
    pub probing_sigma_mm: StandardDeviation,
    /// Standard deviation of the surface, mm. It acts on a touch in the same way as the noise of the probe.
    pub surface_sigma_mm: StandardDeviation,
    /// Standard deviation of each component of an observed orientation, rad.
    pub orientation_sigma_rad: f64,
    /// Slow changes of the machine, by the file in which they happen: the name of the file without its extension, or the part
    /// of it after a hyphen (`s1` for `touches-s1.csv`). The empty name is for all files.
    pub drift: BTreeMap<String, Drift>,
    /// Lobing of the probe; its angles are those of the direction of approach in the frame of the tool.
    pub lobing: Option<Lobing>,
    /// Gross errors.
    pub outliers: Outliers,
    /// Step of the scales of the linear axes and of readings, mm; 0 if they have none.
    pub resolution_mm: f64,
    /// What sensors of temperature record. [`measure`](crate::measure) does not change them: the machine follows the true temperatures.
    pub sensors: Sensors,
}

/// A standard deviation, mm.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(untagged, expecting = "a number, or a map of artefact stages and numbers, was expected")]
pub enum StandardDeviation {
    /// The same for all artefact stages.
    All(f64),
    /// By artefact stage; zero for those that are not named.
    ByStage(BTreeMap<String, f64>),
}

impl Default for StandardDeviation {
    fn default() -> Self {
        Self::All(0.0)
    }
}

/// A slow change of a parameter of the machine:
/// `size ((1 - exp(-t / tau)) + 0.12 (sin(2 π t / period + phase) - sin(phase)))`, zero at time 0.
#[derive(Debug, Clone, PartialEq)]
pub struct Drift {
    /// The parameter, a length.
    pub parameter: String,
    /// Final change without the wave, mm, with its sign.
    pub size_mm: f64,
    /// Time constant, s.
    pub tau_s: f64,
    /// Period (s) and phase (rad) of the wave on top of it, if it has one.
    pub wave: Option<(f64, f64)>,
}

/// Height of the wave on top of a drift, as part of its size.
const WAVE: f64 = 0.12;

impl Drift {
    /// Change of the parameter at a time in s, mm.
    pub fn at(&self, time: f64) -> f64 {
        let wave = self.wave.map_or(0.0, |(period, phase)| (TAU * time / period + phase).sin() - phase.sin());
        self.size_mm * (1.0 - (-time / self.tau_s).exp() + WAVE * wave)
    }
}

/// Gross errors.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Outliers {
    /// Extra distance in mm, outwards, by the label in the column `touch` or, if no data have one, by the number of the data
    /// row in its file, from 1.
    pub listed: BTreeMap<String, f64>,
    /// Rows that are hit at random.
    pub random: Option<RandomOutliers>,
}

/// Gross errors at random.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct RandomOutliers {
    /// Part of the rows that is hit, 0 to 1.
    pub fraction: f64,
    /// By how much, mm; outwards or inwards.
    pub size_mm: f64,
}

/// `noise` as it stands in a truth file, without the keys that have several forms.
#[derive(Deserialize)]
struct Written {
    probing_sigma_mm: Option<StandardDeviation>,
    surface_sigma_mm: Option<StandardDeviation>,
    orientation_sigma_rad: Option<f64>,
    drift: Option<Map<String, Value>>,
    lobing: Option<Value>,
    outliers: Option<BTreeMap<String, f64>>,
    resolution_mm: Option<f64>,
    sensors: Option<Map<String, Value>>,
}

/// A drift as it stands in a truth file.
#[derive(Deserialize)]
struct WrittenDrift {
    component: Option<String>,
    parameter: Option<String>,
    gain_mm: Option<f64>,
    range_mm: Option<f64>,
    tau_s: f64,
    sign: Option<f64>,
    wave_period_s: Option<f64>,
    wave_phase_rad: Option<f64>,
}

/// Lobing as it stands in a truth file.
#[derive(Deserialize)]
struct WrittenLobing {
    amplitude_mm: f64,
    lobes: Option<Whole<0, 999>>,
    phase_rad: Option<f64>,
}

const KEYS: [&str; 8] = [
    "probing_sigma_mm",
    "surface_sigma_mm",
    "orientation_sigma_rad",
    "drift",
    "lobing",
    "outliers",
    "resolution_mm",
    "sensors",
];
const DRIFT_KEYS: [&str; 8] =
    ["component", "parameter", "gain_mm", "range_mm", "tau_s", "sign", "wave_period_s", "wave_phase_rad"];
const DRIFT_NOTES: [&str; 2] = ["formula", "duration_s"];
const LOBING_KEYS: [&str; 3] = ["amplitude_mm", "lobes", "phase_rad"];

impl Noise {
    /// Reads `noise` of a truth file.
    pub(crate) fn from_json(noise: &Map<String, Value>) -> Result<Self, SettingsError> {
        let written: Written = from_settings(&known_only("noise", noise, &KEYS, &[]))?;
        let lobing = match written.lobing {
            None => None,
            Some(Value::Object(lobing)) => Some(read_lobing(&lobing).map_err(|error| error.under([key("lobing")]))?),
            Some(_) => {
                tracing::warn!("noise: `lobing` is a text, which is not simulated; a map with `amplitude_mm` would be");
                None
            }
        };
        Ok(Self {
            probing_sigma_mm: written.probing_sigma_mm.unwrap_or_default(),
            surface_sigma_mm: written.surface_sigma_mm.unwrap_or_default(),
            orientation_sigma_rad: written.orientation_sigma_rad.unwrap_or(0.0),
            drift: read_drifts(&written.drift.unwrap_or_default()).map_err(|error| error.under([key("drift")]))?,
            lobing,
            outliers: read_outliers(written.outliers.unwrap_or_default())?,
            resolution_mm: written.resolution_mm.unwrap_or(0.0),
            sensors: Sensors::from_json(&written.sensors.unwrap_or_default())
                .map_err(|error| error.under([key("sensors")]))?,
        })
    }

    /// Refuses values that are not finite, and negative sizes.
    pub(crate) fn check(&self) -> Result<(), SettingsError> {
        for (name, sigma) in
            [("probing_sigma_mm", &self.probing_sigma_mm), ("surface_sigma_mm", &self.surface_sigma_mm)]
        {
            match sigma {
                StandardDeviation::All(value) => size(name, *value)?,
                StandardDeviation::ByStage(values) => {
                    for (stage, value) in values {
                        size(stage, *value).map_err(|error| error.under([key(name)]))?;
                    }
                }
            }
        }
        for (file, drift) in &self.drift {
            let place = [key("drift"), key(file)];
            drift.check().map_err(|error| error.under(place.into_iter().take(if file.is_empty() { 1 } else { 2 })))?;
        }
        if let Some(lobing) = &self.lobing {
            size("amplitude_mm", lobing.amplitude)
                .and_then(|()| finite("phase_rad", lobing.phase))
                .map_err(|error| error.under([key("lobing")]))?;
        }
        not_negative("orientation_sigma_rad", self.orientation_sigma_rad)?;
        self.outliers.check().map_err(|error| error.under([key("outliers")]))?;
        self.sensors.check().map_err(|error| error.under([key("sensors")]))?;
        size("resolution_mm", self.resolution_mm)
    }

    /// Deviation of every equation from zero when it is measured, mm. `problem` has the true values and is at nominal
    /// contact.
    pub(crate) fn errors(&self, problem: &Problem, seed: u64) -> Result<Vec<f64>> {
        self.known_stages(problem)?;
        let directions = self.lobing.map(|_| contact_directions(problem)).transpose()?;
        let listed = Listed::new(&self.outliers.listed, problem);
        let mut errors = Vec::with_capacity(problem.equations());
        for (index, set) in SetIndex::enumerate(&problem.sets) {
            let sigma = self.probing_sigma_mm.of(set).hypot(self.surface_sigma_mm.of(set));
            let is_measured = takes_noise(set);
            for &row in &set.rows {
                let Row { equations, data_row, .. } = set.info().layout.rows[row];
                let Some(data_row) = data_row.filter(|_| is_measured) else {
                    errors.extend(std::iter::repeat_n(0.0, equations));
                    continue;
                };
                // Every row has its own stream: its numbers do not depend on the rows before it.
                let mut generator = Generator::new(seed, (index.0 as u64) << 32 | row.0 as u64);
                let first = errors.len();
                errors.extend((0..equations).map(|_| generator.normal()));
                let gross = listed.of(set, data_row) + self.outliers.draw(&mut generator);
                let is_angle = |equation| set.info().angles.contains(&equation);
                let of_row = set.info().layout.rows[row].equation_indices();
                for (error, equation) in errors[first..].iter_mut().zip(of_row) {
                    *error =
                        if is_angle(equation) { self.orientation_sigma_rad * *error } else { sigma * *error + gross };
                }
                if let (Some(lobing), Some(directions)) = (&self.lobing, &directions)
                    && let Some([x, y, z]) = directions[first]
                {
                    errors[first] += lobing.pretravel_variation([-x, -y, -z]);
                }
            }
        }
        listed.warn();
        Ok(errors)
    }

    /// Fails if a standard deviation is stated for a stage that is not observed.
    fn known_stages(&self, problem: &Problem) -> Result<()> {
        for (name, sigma) in
            [("probing_sigma_mm", &self.probing_sigma_mm), ("surface_sigma_mm", &self.surface_sigma_mm)]
        {
            let StandardDeviation::ByStage(values) = sigma else { continue };
            let stages = || problem.sets.iter().map(|set| set.name.as_str());
            if let Some(stage) = values.keys().find(|stage| stages().all(|known| known != stage.as_str())) {
                return Err(Error::usage(format!("noise.{name}: no artefact stage `{stage}` is observed"))
                    .help(format!("observed are {}", stages().collect::<Vec<_>>().join(", ")))
                    .suggest(stage, stages()));
            }
        }
        Ok(())
    }

    /// The drift of every row.
    pub(crate) fn variations(&self, problem: &Problem) -> Result<Vec<Variation>> {
        if self.drift.is_empty() {
            return Ok(Vec::new());
        }
        let mut variations = BTreeMap::new();
        let rows: usize = problem.sets.iter().map(|set| set.rows.len()).sum();
        let (mut place, mut drifted) = (0, false);
        for drift in self.drift.values() {
            variations.insert(drift.parameter.as_str(), drift.variation(problem, rows)?);
        }
        for (index, set) in SetIndex::enumerate(&problem.sets) {
            let times = set.info().layout.data.numbers("time");
            for &row in &set.rows {
                let data_row = set.info().layout.rows[row].data_row;
                // Rows without a time see no drift.
                if let Some((times, data_row)) = times.zip(data_row)
                    && let Some(drift) = problem.origin(index, row).and_then(|(file, _)| self.drift_of(file))
                    && let Some(variation) = variations.get_mut(drift.parameter.as_str())
                {
                    variation.values[place] = drift.at(times[data_row]);
                    drifted = true;
                }
                place += 1;
            }
        }
        if !drifted {
            let files = self.drift.keys().filter(|name| !name.is_empty()).map(|name| format!("`{name}`"));
            let files: Vec<String> = files.collect();
            return Err(Error::usage("noise.drift: no row drifts").help(match files.is_empty() {
                true => "the data need a column `time_s`".to_owned(),
                false => format!("no data file with a column `time_s` is named {}", files.join(" or ")),
            }));
        }
        Ok(variations.into_values().collect())
    }

    /// The drift that happens while a file is measured.
    fn drift_of(&self, file: &std::path::Path) -> Option<&Drift> {
        let stem = file.file_stem()?.to_string_lossy();
        let parts = stem.match_indices('-').map(|(at, _)| &stem[at + 1..]);
        std::iter::once(stem.as_ref()).chain(parts).chain([""]).find_map(|name| self.drift.get(name))
    }

    /// The deviations, as lines of the summary.
    pub(crate) fn summary(&self) -> Vec<String> {
        let um = |value: f64| format!("{:.3} µm", value * 1e3);
        let mut lines = Vec::new();
        for (what, sigma) in [("probe", &self.probing_sigma_mm), ("surface", &self.surface_sigma_mm)] {
            match sigma {
                StandardDeviation::All(0.0) => {}
                StandardDeviation::All(sigma) => lines.push(format!("{what}: standard deviation {}", um(*sigma))),
                StandardDeviation::ByStage(values) => lines.extend(
                    values.iter().map(|(stage, sigma)| format!("{what}, {stage}: standard deviation {}", um(*sigma))),
                ),
            }
        }
        if self.orientation_sigma_rad > 0.0 {
            lines.push(format!("orientation: standard deviation {:.3} µrad", self.orientation_sigma_rad * 1e6));
        }
        for (file, drift) in &self.drift {
            let file = if file.is_empty() { String::new() } else { format!(" in `{file}`") };
            lines.push(format!("drift{file}: {} by {}", drift.parameter, um(drift.size_mm)));
        }
        if let Some(lobing) = &self.lobing {
            lines.push(format!("lobing: {} with {} lobes", um(lobing.amplitude), lobing.lobes));
        }
        if !self.outliers.listed.is_empty() {
            lines.push(format!("outliers: {}", self.outliers.listed.len()));
        }
        if let Some(RandomOutliers { fraction, size_mm }) = self.outliers.random {
            lines.push(format!("outliers: {:.1} % of the rows by {}", fraction * 100.0, um(size_mm)));
        }
        if self.resolution_mm > 0.0 {
            // Ten digits, so that the factor of the unit leaves no rounding behind.
            let rounded: Option<f64> = format!("{:.9e}", self.resolution_mm * 1e3).parse().ok();
            lines.push(format!("resolution: {} µm", rounded.unwrap_or(self.resolution_mm * 1e3)));
        }
        lines.extend(self.sensors.summary());
        lines
    }
}

/// Whether noise is added to the equations of a set. It is not added to readings of angles.
fn takes_noise(set: &ObservationSet) -> bool {
    match &set.info().contact {
        Contact::LinearAxes | Contact::Pose { .. } => true,
        Contact::Reading(column) => is_length(set, column),
        Contact::Readings(columns) => columns.iter().all(|column| is_length(set, column)),
        Contact::NotSimulated(_) => false,
    }
}

impl StandardDeviation {
    fn of(&self, set: &ObservationSet) -> f64 {
        match self {
            Self::All(sigma) => *sigma,
            Self::ByStage(sigmas) => sigmas.get(&set.name).copied().unwrap_or(0.0),
        }
    }
}

impl Drift {
    fn check(&self) -> Result<(), SettingsError> {
        bounded("gain_mm", self.size_mm)?;
        positive("tau_s", self.tau_s)?;
        if let Some((period, phase)) = self.wave {
            positive("wave_period_s", period)?;
            finite("wave_phase_rad", phase)?;
        }
        Ok(())
    }

    /// A variation of its parameter that is zero on all rows.
    fn variation(&self, problem: &Problem, rows: usize) -> Result<Variation> {
        let name = &self.parameter;
        let names = || problem.model.info().parameters.iter().map(|parameter| parameter.name.as_str());
        let parameter = machine_parameter(problem, name).ok_or_else(|| {
            Error::usage(format!("noise.drift: the machine has no parameter `{name}`"))
                .help("the set-up parameters dxt, dyt, dzt always exist, others if the model's `errors` list them")
                .suggest(name, names())
        })?;
        if problem.model.info().parameters[parameter].unit.of != Quantity::Length
            || problem.model.info().parameters[parameter].unit.per.is_some()
        {
            return Err(Error::usage(format!("noise.drift: `{name}` is no length; drifts are in mm")));
        }
        Ok(Variation { parameter, values: vec![0.0; rows] })
    }
}

impl Outliers {
    fn check(&self) -> Result<(), SettingsError> {
        for (row, distance) in &self.listed {
            bounded(row, *distance)?;
        }
        let Some(RandomOutliers { fraction, size_mm }) = self.random else { return Ok(()) };
        bounded("size_mm", size_mm)?;
        match (0.0..=1.0).contains(&fraction) {
            true => Ok(()),
            false => Err(SettingsError::new("fraction", format!("{fraction}: a number from 0 to 1 was expected"))),
        }
    }

    /// The gross error that hits a row at random, mm.
    fn draw(&self, generator: &mut Generator) -> f64 {
        let Some(RandomOutliers { fraction, size_mm }) = self.random else { return 0.0 };
        let chance = 0.5 * (generator.uniform() / 3.0_f64.sqrt() + 1.0);
        let sign = if generator.index(2) == 0 { 1.0 } else { -1.0 };
        if chance < fraction { sign * size_mm } else { 0.0 }
    }
}

fn read_lobing(lobing: &Map<String, Value>) -> Result<Lobing, SettingsError> {
    let lobing: WrittenLobing = from_settings(&known_only("noise.lobing", lobing, &LOBING_KEYS, &[]))?;
    // A probe with three contacts has three lobes.
    let (lobes, phase) = (lobing.lobes.map_or(3, |lobes| lobes.get() as u32), lobing.phase_rad.unwrap_or(0.0));
    Ok(Lobing { amplitude: lobing.amplitude_mm, lobes, phase })
}

/// One drift for all files, or one for each.
fn read_drifts(written: &Map<String, Value>) -> Result<BTreeMap<String, Drift>, SettingsError> {
    if written.is_empty() {
        return Ok(BTreeMap::new());
    }
    if written.keys().any(|name| DRIFT_KEYS.contains(&name.as_str())) {
        return Ok(BTreeMap::from([(String::new(), read_drift(written)?)]));
    }
    let mut drifts = BTreeMap::new();
    for (file, drift) in written {
        let drift = match drift {
            Value::Null => continue,
            Value::Object(drift) => read_drift(drift).map_err(|error| error.under([key(file)]))?,
            _ => return Err(SettingsError::new(file, "a map with `component`, `gain_mm` and `tau_s` was expected")),
        };
        drifts.insert(file.clone(), drift);
    }
    Ok(drifts)
}

fn read_drift(written: &Map<String, Value>) -> Result<Drift, SettingsError> {
    let written: WrittenDrift = from_settings(&known_only("noise.drift", written, &DRIFT_KEYS, &DRIFT_NOTES))?;
    let named = written.parameter.or_else(|| {
        // `dzt(t), tool-workpiece Z, added to the tool tip`
        let component = written.component?;
        component.split(['(', ',', ' ']).next().map(str::to_owned)
    });
    let parameter = named.ok_or_else(|| SettingsError::new("", "the setting `component` is missing: what drifts?"))?;
    let size = written.gain_mm.or(written.range_mm);
    let size =
        size.ok_or_else(|| SettingsError::new("", "the setting `gain_mm` is missing: how far does it drift?"))?;
    let wave = written.wave_period_s.map(|period| (period, written.wave_phase_rad.unwrap_or(0.0)));
    Ok(Drift { parameter, size_mm: written.sign.unwrap_or(1.0) * size, tau_s: written.tau_s, wave })
}

fn read_outliers(mut written: BTreeMap<String, f64>) -> Result<Outliers, SettingsError> {
    let random = match (written.remove("fraction"), written.remove("size_mm")) {
        (None, None) => None,
        (Some(fraction), Some(size_mm)) => Some(RandomOutliers { fraction, size_mm }),
        _ => return Err(SettingsError::new("outliers", "`fraction` and `size_mm` belong together; one is missing")),
    };
    Ok(Outliers { listed: written, random })
}

/// Refuses a value that is no finite number.
pub(crate) fn finite(name: &str, value: f64) -> Result<(), SettingsError> {
    match value.is_finite() {
        true => Ok(()),
        false => Err(SettingsError::new(name, format!("{value}: a finite number was expected"))),
    }
}

/// No probe, no surface and no scale is off by as much, mm.
const LARGEST: f64 = 100.0;

/// Refuses a size that is negative, not finite, or larger than anything that is simulated.
fn size(setting: &str, value: f64) -> Result<(), SettingsError> {
    not_negative(setting, value)?;
    bounded(setting, value)
}

/// Refuses what is not finite, or larger on either side than anything that is simulated.
fn bounded(setting: &str, value: f64) -> Result<(), SettingsError> {
    finite(setting, value)?;
    match value.abs() <= LARGEST {
        true => Ok(()),
        false => Err(SettingsError::new(setting, format!("{value}: at most {LARGEST} mm were expected"))),
    }
}
