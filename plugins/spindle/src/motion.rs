//! Estimator plugin `spindle-motion`: harmonics of runs.

use std::collections::{BTreeMap, BTreeSet};

use abbe_core::{
    AboveZero, Calibration, ColumnHeader, Context, Dataset, Error, Estimate, EstimateSource, Identifiability, Passes,
    Problem, Result, SettingsError, positive,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::doubts::{Sensor, tell_aliased, tell_coarse, tell_copied, tell_silent, tell_turned, tell_unlike};
use crate::encoder::Encoder;
use crate::evaluated::{Evaluated, Fits, evaluate};
use crate::harmonics::Basis;
use crate::parameters::{Combined, Found, of_order};
use crate::readings::{Columns, Expected, check_columns};
use crate::rests::{Left, Wanted};
use crate::run::Run;
use crate::sensors::{Radial, RadialSensors, between, check_radial};
use crate::speed::{Speeds, check_speeds, plausible_rpm};

/// The name of the plugin.
pub const PLUGIN: &str = "spindle-motion";

abbe_core::register!(
    Estimate,
    "spindle-motion",
    "error motions of a spindle: harmonics of sensors against its encoder, by runs",
    Motion,
    example,
    build,
    "../reference/estimate-spindle-motion.md",
    EstimateSource::Readings,
);

/// Settings of the harmonics of a spindle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Motion {
    /// Radial sensors by their columns without unit: a pair, one, or none. The first one by name is the direction x of the results.
    #[serde(default)]
    pub radial: RadialSensors,
    /// The column of the axial sensor, without its unit.
    #[serde(default)]
    pub axial: Option<String>,
    /// The highest harmonic that is fitted.
    #[serde(default = "harmonics")]
    #[schemars(range(min = 2, max = 500))]
    pub harmonics: u16,
    /// A straight line in time is fitted, too: drift while the run lasts.
    #[serde(default)]
    pub linear_drift: bool,
    /// Sectors of a turn in which the range of the asynchronous part is taken.
    #[serde(default = "sectors")]
    #[schemars(range(min = 4, max = 10000))]
    pub sectors: u16,
    /// Speeds that were set: a run is called by the nearest one, and one that is off by more than 5 % is refused. Without
    /// them it is called by its speed in three digits, and a time in another unit may not be seen.
    #[serde(default)]
    #[schemars(inner(range(min = 1e-3, max = 1e6)))]
    pub speeds_rpm: Vec<f64>,
    /// Slowest and fastest speed of a run where none is stated.
    #[serde(default = "plausible_rpm")]
    pub plausible_rpm: [f64; 2],
    /// What runs are called by.
    #[serde(default)]
    pub named_by: NamedBy,
    /// How the angle is written.
    #[serde(default)]
    pub encoder: Encoder,
    /// Columns of the angle, of the time and of the run.
    #[serde(default)]
    pub columns: Columns,
    /// Standard uncertainty of a reading, for ranges of single readings. The harmonics do not need it.
    #[serde(default)]
    #[schemars(with = "Option<AboveZero>")]
    pub standard_uncertainty_um: Option<f64>,
    /// Smallest and largest range that readings of a sensor may have.
    #[serde(default = "plausible")]
    pub plausible_um: [f64; 2],
    /// Take a fundamental of which much goes round against the spindle, even more than with it, without a word.
    #[serde(default)]
    pub accept_backward: bool,
}

/// What a run is called by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum NamedBy {
    /// Its speed in revolutions per minute.
    #[default]
    Speed,
    /// Its label: by default the name of its file.
    Label,
}

fn harmonics() -> u16 {
    24
}

fn sectors() -> u16 {
    128
}

/// Part of the eccentricity that may go round against the spindle before it is told, and what is never told, um. An artefact on a spindle
/// runs on a circle; an ellipse shows another azimuth, or another scale, of one of two sensors.
const ELLIPSE: f64 = 0.15;
const CLEAR_UM: f64 = 0.3;

/// 10 nm to 1 mm.
pub fn plausible() -> [f64; 2] {
    [0.01, 1000.0]
}

fn example() -> Value {
    json!({
        "radial": { "r1": { "azimuth_deg": 0 }, "r2": { "azimuth_deg": 90 } },
        "axial": "z",
        "harmonics": 24,
        "linear_drift": true,
        "standard_uncertainty_um": 0.006,
    })
}

/// Fails for a range that is none.
pub fn check_plausible(plausible: [f64; 2]) -> Result<(), SettingsError> {
    match plausible[0] > 0.0 && plausible[1] > plausible[0] && plausible[1].is_finite() {
        true => Ok(()),
        false => Err(SettingsError::new("plausible_um", "two numbers above zero, the larger one last, were expected")),
    }
}

/// Fails for orders that are none.
pub fn check_highest(harmonics: u16) -> Result<(), SettingsError> {
    match (2..=500).contains(&harmonics) {
        true => Ok(()),
        false => Err(SettingsError::new("harmonics", format!("{harmonics} was found; 2 to 500 were expected"))),
    }
}

fn build(settings: Motion, _: &Context) -> Result<Box<dyn Estimate>, SettingsError> {
    check_radial(&settings.radial)?;
    check_plausible(settings.plausible_um)?;
    check_highest(settings.harmonics)?;
    if settings.radial.is_empty() && settings.axial.is_none() {
        return Err(SettingsError::new("radial", "at least one sensor was expected, here or under `axial`"));
    }
    if settings.axial.as_ref().is_some_and(|axial| settings.radial.contains_key(axial)) {
        return Err(SettingsError::new("axial", "this sensor is a radial one already"));
    }
    if !(4..=10_000).contains(&settings.sectors) {
        return Err(SettingsError::new("sectors", "4 to 10000 were expected"));
    }
    check_speeds(settings.plausible_rpm, &settings.speeds_rpm)?;
    if let Some(uncertainty) = settings.standard_uncertainty_um {
        positive("standard_uncertainty_um", uncertainty)?;
    }
    Ok(Box::new(settings))
}

impl Motion {
    /// What its readings have to be like.
    pub fn expected(&self) -> Expected<'_> {
        Expected {
            columns: &self.columns,
            encoder: self.encoder,
            sensors: self.radial.keys().chain(&self.axial).map(String::as_str).collect(),
            axial: self.axial.as_deref(),
            plausible: self.plausible_um.map(|value| value * 1e-3),
            speeds: self.speeds(),
        }
    }

    fn speeds(&self) -> Speeds<'_> {
        Speeds { plausible: self.plausible_rpm, stated: &self.speeds_rpm }
    }

    /// What a run is called.
    pub fn name(&self, run: &Run) -> String {
        if self.named_by == NamedBy::Label {
            return run.label.clone();
        }
        if let Some(nearest) = self.speeds().nearest(run.speed) {
            return nearest.to_string();
        }
        let step = 10_f64.powf(run.speed.log10().floor() - 2.0);
        format!("{}", ((run.speed / step).round() * step * 1e6).round() / 1e6)
    }

    fn fits(&self) -> Fits {
        let rests = Wanted { sectors: usize::from(self.sectors), between: between(&self.radial) };
        Fits { highest: usize::from(self.harmonics), linear_drift: self.linear_drift, rests }
    }

    /// The parameters of a run as combinations of the raw coefficients of its sensors.
    fn combined(&self, name: &str, basis: &Basis) -> Vec<Combined> {
        let of = |own: String| format!("run[{name}].{own}");
        let mut all = self.fundamental(&of, basis.unknowns());
        let sensors = self.radial.keys().map(|sensor| (sensor, 2)).chain(self.axial.iter().map(|axial| (axial, 1)));
        for (place, (sensor, lowest)) in sensors.enumerate() {
            let first = place * basis.unknowns();
            for order in lowest..=basis.highest {
                let [cos, sin] = of_order(&of(format!("sync.{sensor}")), order);
                all.push(Combined::length(cos, vec![(first + Basis::cos(order), 1.0)]));
                all.push(Combined::length(sin, vec![(first + Basis::sin(order), 1.0)]));
            }
            all.push(Combined::length(of(format!("mean.{sensor}")), vec![(first, 1.0)]));
            if let Some((line, half)) = basis.line() {
                let terms = vec![(first + line, 1.0 / half)];
                all.push(Combined { name: of(format!("drift.{sensor}")), unit: "mm/s", terms });
            }
        }
        all
    }

    /// The fundamental of radial sensors: with the spindle and against it, or both together.
    fn fundamental(&self, of: &dyn Fn(String) -> String, unknowns: usize) -> Vec<Combined> {
        let (cos, sin) = (Basis::cos(1), Basis::sin(1));
        let Some(between) = between(&self.radial) else {
            let one = |sensor: &String| {
                let named = |part: &str, place| {
                    Combined::length(of(format!("fundamental.{sensor}[{part}]")), vec![(place, 1.0)])
                };
                [named("cos", cos), named("sin", sin)]
            };
            return self.radial.keys().flat_map(one).collect();
        };
        // The second direction is a quarter of a turn beyond the first sensor: y = (r2 - r1 cos d) / sin d.
        let along_y = |place: usize| [(place, -between.cos() / between.sin()), (unknowns + place, 1.0 / between.sin())];
        let half = |x: usize, x_factor: f64, y: usize, y_factor: f64| {
            let y = along_y(y).map(|(place, factor)| (place, 0.5 * y_factor * factor));
            [(x, 0.5 * x_factor)].into_iter().chain(y).collect::<Vec<_>>()
        };
        vec![
            Combined::length(of("ecc.x".to_owned()), half(cos, 1.0, sin, 1.0)),
            Combined::length(of("ecc.y".to_owned()), half(sin, -1.0, cos, 1.0)),
            Combined::length(of("back.cos".to_owned()), half(cos, 1.0, sin, -1.0)),
            Combined::length(of("back.sin".to_owned()), half(sin, 1.0, cos, 1.0)),
        ]
    }

    /// Largest ranges of what is left within a sector, by the name of the direction.
    fn asynchronous(&self, run: &Run, left: &Left) -> Result<Vec<(String, f64)>> {
        if let Some((sector, count)) = left.sectors[0].fewest()
            && count < 2
        {
            let message =
                format!("sector {sector} of {} has {count} readings, two at least were expected", self.sectors);
            let help = format!("choose fewer `sectors`: there are {:.0} readings a turn", run.count as f64 / run.turns);
            return Err(run.error(message).help(help));
        }
        let names = self.radial.keys().chain(&self.axial).cloned();
        let mut all: Vec<(String, f64)> =
            names.zip(&left.sectors).filter_map(|(name, sectors)| Some((name, sectors.largest()?))).collect();
        if between(&self.radial).is_some() {
            all.extend(left.rotating.largest().map(|largest| ("rotating".to_owned(), largest)));
        }
        Ok(all)
    }

    /// Tells of sensors without a signal or without digits, and of an encoder that slips a little in every turn.
    fn tell_doubts(&self, run: &Run, left: &Left) {
        let radial = self.radial.keys().map(|name| (Sensor::Radial, name.as_str()));
        let axial = self.axial.iter().map(|name| (Sensor::Axial, name.as_str()));
        for (place, (sensor, ends)) in radial.chain(axial).zip(&run.ends).enumerate() {
            if let Some(uncertainty) = self.standard_uncertainty_um {
                tell_silent(run, sensor, ends, uncertainty * 1e-3);
                tell_coarse(run, (place, sensor.1), uncertainty * 1e-3);
            }
        }
        if let Some(name) = self.radial.keys().next() {
            left.creeping.tell(run, name, left.squares[0].sqrt());
        }
    }

    /// Fails where the fundamental goes round against the spindle, and tells where much of it does.
    fn check_sense(&self, run: &Run, found: &Found, name: &str) -> Result<()> {
        let size = |parts: [&str; 2]| {
            let of = |part: &str| {
                let name = format!("run[{name}].{part}");
                found
                    .parameters
                    .iter()
                    .find(|parameter| parameter.name == name)
                    .map_or(0.0, |parameter| parameter.value)
            };
            of(parts[0]).hypot(of(parts[1])) * 1e3
        };
        let (forward, backward) = (size(["ecc.x", "ecc.y"]), size(["back.cos", "back.sin"]));
        let names: Vec<&str> = self.radial.keys().map(String::as_str).collect();
        if !self.accept_backward && backward <= forward && backward > (ELLIPSE * forward).max(CLEAR_UM) {
            tracing::warn!(
                "run `{}`: {backward:.3} um of its fundamental go round against the spindle, {forward:.3} um with it, so that the path of \
                 the artefact is an ellipse: are the columns of {}, `azimuth_deg` and the units of both right? If it is so, write \
                 `accept_backward: true`",
                run.label,
                names.join(" and ")
            );
        }
        if self.accept_backward || backward <= forward {
            return Ok(());
        }
        let message = format!(
            "{backward:.3} um of its fundamental go round against the spindle, {forward:.3} um with it: are {} swapped, or is one of \
             them the column of another sensor{}?",
            names.join(" and "),
            self.axial.as_ref().map_or(String::new(), |axial| format!(" (`{axial}`)"))
        );
        Err(run.error(message).help(
            "check the columns, `azimuth_deg` and the sense of the angle; if the artefact is centred so well, write \
             `accept_backward: true`",
        ))
    }
}

impl Estimate for Motion {
    fn check_readings(&self, headers: &[Vec<ColumnHeader>]) -> Result<()> {
        check_columns(&self.expected(), headers)
    }

    fn estimates_readings_at_once(&self) -> bool {
        true
    }

    fn estimate_readings(&self, name: &str, data: &[&Dataset]) -> Result<Calibration> {
        self.estimate_readings_in_passes(name, &held(data))
    }

    fn accepts_readings_in_passes(&self) -> bool {
        true
    }

    fn estimate_readings_in_passes(&self, name: &str, data: &[&dyn Passes]) -> Result<Calibration> {
        let (mut found, mut names) = (Found::default(), BTreeSet::new());
        let (mut condition, mut unknowns) = (1.0_f64, 0);
        let mut asynchronous: BTreeMap<String, Vec<(String, f64)>> = BTreeMap::new();
        let (mut means, mut seen) = (Vec::new(), Vec::new());
        let (runs, sizes) = evaluate(data, &self.expected(), self.fits())?;
        for Evaluated { mut run, fitted } in runs {
            let called = self.name(&run);
            if !names.insert(called.clone()) {
                let message = format!("there is a run called `{called}` already");
                return Err(run.error(message).help("write `named_by: label`, or estimate repeats one by one"));
            }
            let (fitted, left) = fitted?;
            let combined = self.combined(&called, &fitted.basis);
            found.fixed(format!("run[{called}].speed"), run.speed, "rpm");
            found.fixed(format!("run[{called}].turns"), run.turns, "1");
            let freedom = run.whole_turns() as f64 - 1.0;
            found.add(&combined, &fitted.values.concat(), &fitted.covariance, freedom);
            self.check_sense(&run, &found, &called)?;
            self.tell_doubts(&run, &left);
            tell_aliased(&run, usize::from(self.harmonics), fitted.condition);
            for (direction, largest) in self.asynchronous(&run, &left)? {
                found.fixed(format!("run[{called}].async.{direction}"), largest, "mm");
                asynchronous.entry(direction).or_default().push((called.clone(), largest));
            }
            condition = condition.max(fitted.condition);
            unknowns += combined.len();
            // The first coefficient of a sensor is its mean.
            means.push((called, fitted.values.iter().map(|own| own[0]).collect::<Vec<f64>>()));
            seen.push((run.label.clone(), std::mem::take(&mut run.steps)));
        }
        let sensors: Vec<&str> = self.radial.keys().chain(&self.axial).map(String::as_str).collect();
        tell_turned(&sensors, &means);
        tell_copied(&seen);
        for (direction, values) in &asynchronous {
            tell_unlike(&format!("the asynchronous motion {direction}"), values);
        }
        let report = sizes.report(unknowns, unknowns, condition);
        Ok(found.calibration(name, PLUGIN, json!(self), "scatter of single turns", report))
    }

    fn estimate(&self, _: &Problem) -> Result<Calibration> {
        Err(readings_alone())
    }

    fn identify(&self, _: &Problem) -> Result<Identifiability> {
        Err(readings_alone())
    }
}

/// Data sets that are held, as those that are not.
pub fn held<'a>(data: &[&'a Dataset]) -> Vec<&'a dyn Passes> {
    data.iter().map(|data| *data as &dyn Passes).collect()
}

/// The error for a problem of a machine.
pub fn readings_alone() -> Error {
    Error::usage("this estimator reads data sets under `from`; it knows no machine").setting("from")
}

/// A sensor at azimuth 0.
impl Default for Radial {
    fn default() -> Self {
        Self { azimuth_deg: 0.0 }
    }
}
