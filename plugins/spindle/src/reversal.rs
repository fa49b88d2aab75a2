//! Estimator plugin `donaldson-reversal`: the form of the artefact, and the motion of the spindle without it.

use abbe_core::{
    Calibration, ColumnHeader, Combination, Context, Dataset, Error, Estimate, EstimateSource, Identifiability, Passes,
    Problem, Result, SettingsError, Status, WeakDirection, positive,
};
use nalgebra::DMatrix;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::doubts::tell_aliased;
use crate::encoder::Encoder;
use crate::evaluated::{Evaluated, Fits, evaluate};
use crate::harmonics::Basis;
use crate::motion::{check_highest, check_plausible, held, plausible, readings_alone};
use crate::parameters::{Combined, Found, of_order};
use crate::readings::{Columns, Expected, check_columns};
use crate::rests::{Fitted, Wanted};
use crate::run::{Run, Step};
use crate::sensors::{RadialSensors, check_radial};
use crate::speed::{Speeds, check_speeds, plausible_rpm};

/// The name of the plugin.
pub const PLUGIN: &str = "donaldson-reversal";

abbe_core::register!(
    Estimate,
    "donaldson-reversal",
    "form of an artefact and motion of a spindle, told apart by turning the artefact and the sensor round",
    Reversal,
    example,
    build,
    "../reference/estimate-donaldson-reversal.md",
    EstimateSource::Readings,
);

/// Settings of the reversal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Reversal {
    /// The radial sensor by its column without unit, and where it stands in the first set-up. In the second one it stands opposite,
    /// and the artefact is turned by 180 degrees on the spindle.
    pub radial: RadialSensors,
    /// The highest harmonic that is fitted.
    #[serde(default = "harmonics")]
    #[schemars(range(min = 2, max = 500))]
    pub harmonics: u16,
    /// A straight line in time is fitted, too: drift while a run lasts.
    #[serde(default)]
    pub linear_drift: bool,
    /// How the angle is written.
    #[serde(default)]
    pub encoder: Encoder,
    /// Columns of the angle, of the time and of the run.
    #[serde(default)]
    pub columns: Columns,
    /// Smallest and largest range that readings of a sensor may have.
    #[serde(default = "plausible")]
    pub plausible_um: [f64; 2],
    /// The speed that was set: a run that is off by more than 5 % is refused.
    #[serde(default)]
    pub speed_rpm: Option<f64>,
    /// Slowest and fastest speed of a run where none is stated.
    #[serde(default = "plausible_rpm")]
    pub plausible_rpm: [f64; 2],
}

fn harmonics() -> u16 {
    24
}

fn example() -> Value {
    json!({ "radial": { "r1": { "azimuth_deg": 0 } }, "harmonics": 24, "linear_drift": true })
}

fn build(settings: Reversal, _: &Context) -> Result<Box<dyn Estimate>, SettingsError> {
    check_radial(&settings.radial)?;
    check_plausible(settings.plausible_um)?;
    check_speeds(settings.plausible_rpm, &[])?;
    settings.speed_rpm.map(|speed| positive("speed_rpm", speed)).transpose()?;
    check_highest(settings.harmonics)?;
    if settings.radial.len() != 1 {
        return Err(SettingsError::new("radial", "one sensor was expected: the one that is turned round"));
    }
    Ok(Box::new(settings))
}

/// Part of the speed by which the two runs may differ.
const SAME_SPEED: f64 = 0.05;

/// Most by which the asynchronous parts of both set-ups may differ: it is one spindle at one speed.
const SAME_SCATTER: f64 = 1.6;

/// Tells of a set-up that scatters far more than the other one (both in mm).
fn tell_scatter(name: &str, [first, second]: [f64; 2]) {
    let ratio = second / first;
    if !(1.0 / SAME_SCATTER..SAME_SCATTER).contains(&ratio) && first.max(second) > 0.0 {
        tracing::warn!(
            "{name}: the asynchronous part of the second set-up is {ratio:.2} times that of the first: has its sensor another range or \
             unit, or another mount?"
        );
    }
}

/// Part of the range of readings by which copies may differ: rounding.
const COPIED: f64 = 1e-6;

/// Whether the readings of the first sensor of a run are those of another one times `sign` and a constant, at the readings that were
/// chosen of both: all of short runs.
fn is_copy(one: &Run, other: &Run, sign: f64) -> bool {
    let read = |run: &Run, step: &Step| step.readings[0] - run.readings[0];
    let range = one.steps.iter().fold(0.0_f64, |most, (_, step)| most.max(read(one, step).abs()));
    one.count == other.count
        && one
            .steps
            .iter()
            .zip(&other.steps)
            .all(|((_, first), (_, second))| (read(other, second) - sign * read(one, first)).abs() <= COPIED * range)
}

impl Reversal {
    fn expected(&self) -> Expected<'_> {
        Expected {
            columns: &self.columns,
            encoder: self.encoder,
            sensors: self.radial.keys().map(String::as_str).collect(),
            axial: None,
            plausible: self.plausible_um.map(|value| value * 1e-3),
            speeds: Speeds { plausible: self.plausible_rpm, stated: self.speed_rpm.as_slice() },
        }
    }

    /// Name and azimuth (rad) of the sensor.
    fn sensor(&self) -> (&str, f64) {
        let mut sensors = self.radial.iter();
        sensors.next().map_or(("", 0.0), |(name, sensor)| (name.as_str(), sensor.azimuth_deg.to_radians()))
    }

    /// Parameters as combinations of the coefficients of both runs: `cos K S` and `sin K S` of the first, then of the second.
    fn combined(&self, basis: &Basis) -> Vec<Combined> {
        let (sensor, azimuth) = self.sensor();
        let second = basis.unknowns();
        let mut all = Vec::new();
        for order in 2..=basis.highest {
            let (cos, sin) = (Basis::cos(order), Basis::sin(order));
            let (sin_turn, cos_turn) = (order as f64 * azimuth).sin_cos();
            // h(psi), psi = azimuth - S: cos K psi = cos Ka cos KS + sin Ka sin KS.
            let form = |by_cos: f64, by_sin: f64| {
                let half = |place: usize, factor: f64| [(place, 0.5 * factor), (second + place, 0.5 * factor)];
                half(cos, by_cos).into_iter().chain(half(sin, by_sin)).collect::<Vec<_>>()
            };
            let [form_cos, form_sin] = of_order("form", order);
            all.push(Combined::length(form_cos, form(cos_turn, sin_turn)));
            all.push(Combined::length(form_sin, form(sin_turn, -cos_turn)));
            let [motion_cos, motion_sin] = of_order(&format!("sync.{sensor}"), order);
            all.push(Combined::length(motion_cos, vec![(cos, 0.5), (second + cos, -0.5)]));
            all.push(Combined::length(motion_sin, vec![(sin, 0.5), (second + sin, -0.5)]));
        }
        all
    }

    /// Adds order 1: what each set-up reads, which is eccentricity, form and motion at once.
    fn add_fundamental(&self, found: &mut Found, both: &[Fitted]) -> Vec<WeakDirection> {
        let (sensor, azimuth) = self.sensor();
        let fundamental = |setup: usize, part: &str| format!("reversal[{setup}].fundamental.{sensor}[{part}]");
        for (setup, fitted) in both.iter().enumerate() {
            for (part, place) in [("cos", Basis::cos(1)), ("sin", Basis::sin(1))] {
                found.fixed(fundamental(setup + 1, part), fitted.values[0][place], "mm");
            }
        }
        let motions = of_order(&format!("sync.{sensor}"), 1);
        let forms = of_order("form", 1);
        forms.iter().chain(&motions).for_each(|name| found.fixed(name.clone(), 0.0, "mm"));
        for parameter in &mut found.parameters {
            let is_first = parameter.name.contains("].fundamental.") || forms.contains(&parameter.name);
            if is_first || motions.contains(&parameter.name) {
                parameter.status = Status::Confounded;
            }
        }
        let part = |name: String, coefficient: f64| Combination { name, coefficient, unit: "mm".to_owned() };
        let lost = |name: &String, in_first: [f64; 2], in_second: [f64; 2]| {
            let of = |setup: usize, [cos, sin]: [f64; 2]| {
                [part(fundamental(setup, "cos"), -cos), part(fundamental(setup, "sin"), -sin)]
            };
            let others =
                of(1, in_first).into_iter().chain(of(2, in_second)).filter(|part| part.coefficient.abs() > 1e-12);
            WeakDirection {
                singular_value: 0.0,
                combination: [part(name.clone(), 1.0)].into_iter().chain(others).collect(),
                separated_by: Vec::new(),
            }
        };
        let (sin, cos) = azimuth.sin_cos();
        vec![
            lost(&forms[0], [cos, sin], [cos, sin]),
            lost(&forms[1], [sin, -cos], [sin, -cos]),
            lost(&motions[0], [1.0, 0.0], [-1.0, 0.0]),
            lost(&motions[1], [0.0, 1.0], [0.0, -1.0]),
        ]
    }

    fn check_pair(&self, runs: &[Evaluated]) -> Result<()> {
        let [Evaluated { run: one, .. }, Evaluated { run: other, .. }] = runs else {
            let message =
                format!("{} runs were found, and two were expected: before and after the reversal", runs.len());
            return Err(Error::data(message).setting("from"));
        };
        if (one.speed / other.speed - 1.0).abs() > SAME_SPEED {
            let message = format!("it has {:.0} rpm, and the other one {:.0} rpm", other.speed, one.speed);
            return Err(other
                .error(message)
                .help("the motion of a spindle changes with its speed: reverse at one speed"));
        }
        if one.is_forward() != other.is_forward() {
            return Err(other
                .error("the angle of the spindle falls in one set-up and grows in the other")
                .help("a spindle moves otherwise when it turns the other way: measure both set-ups in one sense, and see that the angle has one sign in both files"));
        }
        for (sign, what) in [(1.0, ""), (-1.0, "minus ")] {
            if is_copy(one, other, sign) {
                let message = format!(
                    "its readings are {what}those of the first set-up, but for a constant: the artefact was not reversed, or a file is \
                     there twice"
                );
                return Err(other.error(message));
            }
        }
        Ok(())
    }
}

impl Estimate for Reversal {
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
        let rests = Wanted { sectors: 1, between: None };
        let fits = Fits { highest: usize::from(self.harmonics), linear_drift: self.linear_drift, rests };
        let (evaluated, sizes) = evaluate(data, &self.expected(), fits)?;
        self.check_pair(&evaluated)?;
        let (mut runs, mut both, mut scatter) = (Vec::new(), Vec::new(), [0.0; 2]);
        for (setup, Evaluated { run, fitted }) in evaluated.into_iter().enumerate() {
            let (fitted, left) = fitted?;
            scatter[setup] = left.squares[0];
            tell_aliased(&run, usize::from(self.harmonics), fitted.condition);
            runs.push(run);
            both.push(fitted);
        }
        let unknowns = both[0].basis.unknowns();
        let mut covariance = DMatrix::zeros(2 * unknowns, 2 * unknowns);
        let (mut raw, mut found) = (Vec::new(), Found::default());
        for (setup, (run, fitted)) in runs.iter().zip(&both).enumerate() {
            let first = setup * unknowns;
            covariance.view_mut((first, first), (unknowns, unknowns)).copy_from(&fitted.covariance);
            raw.extend_from_slice(&fitted.values[0]);
            found.fixed(format!("reversal[{}].speed", setup + 1), run.speed, "rpm");
        }
        tell_scatter(name, scatter.map(f64::sqrt));
        let freedom = runs.iter().map(Run::whole_turns).min().unwrap_or(2) as f64 - 1.0;
        let combined = self.combined(&both[0].basis);
        found.add(&combined, &raw, &covariance, freedom);
        let lost = self.add_fundamental(&mut found, &both);
        // Order 1 has eight unknowns of four that are determined.
        let (all, determined) = (combined.len() + 8, combined.len() + 4);
        let condition = both.iter().map(|fitted| fitted.condition).fold(1.0, f64::max);
        let mut report = sizes.report(all, determined, condition);
        report.null_space = lost;
        Ok(found.calibration(name, PLUGIN, json!(self), "scatter of single turns", report))
    }

    fn estimate(&self, _: &Problem) -> Result<Calibration> {
        Err(readings_alone())
    }

    fn identify(&self, _: &Problem) -> Result<Identifiability> {
        Err(readings_alone())
    }
}
