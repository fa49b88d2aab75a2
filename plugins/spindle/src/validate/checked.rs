//! A run as an estimate tells it: values, covariance, and the readings of sensors as sums of them.

use abbe_core::{Calibration, Fit, NamedCovariance};
use abbe_standards::spindle::{Fundamental, Harmonics, rotating};
use nalgebra::{DMatrix, DVector};

use super::{Spindle, form_order};
use crate::motion::Motion;
use crate::parameters::{of_order, value};
use crate::sensors::between;

/// Coefficients of harmonics as sums of values.
#[derive(Default, Clone)]
struct Linear {
    cos: Vec<Vec<(usize, f64)>>,
    sin: Vec<Vec<(usize, f64)>>,
}

impl Linear {
    fn new(highest: usize) -> Self {
        Self { cos: vec![Vec::new(); highest + 1], sin: vec![Vec::new(); highest + 1] }
    }

    fn of(&self, values: &[f64]) -> Harmonics {
        let sums = |lists: &[Vec<(usize, f64)>]| {
            lists.iter().map(|terms| terms.iter().map(|(place, factor)| values[*place] * factor).sum()).collect()
        };
        Harmonics { cos: sums(&self.cos), sin: sums(&self.sin) }
    }
}

/// The form of an artefact: coefficients (whether of a cosine, order, mm) and their covariance.
#[derive(Default)]
pub struct Form {
    coefficients: Vec<(bool, usize, f64)>,
    covariance: DMatrix<f64>,
}

impl Form {
    /// From a reversal, or as the settings state it, without uncertainty.
    pub fn of(settings: &Spindle, reversal: Option<&Fit>) -> Option<Self> {
        if let Some(fit) = reversal {
            let calibration = &fit.calibration;
            let own = |name: &str| {
                let (cos, order) = form_order(name.strip_prefix("form[")?.strip_suffix(']')?)?;
                (order > 1).then_some((cos, order, value(calibration, name)?))
            };
            let names: Vec<&String> = calibration.covariance.order.iter().filter(|name| own(name).is_some()).collect();
            let coefficients = names.iter().filter_map(|name| own(name)).collect();
            return Some(Self { coefficients, covariance: block(&calibration.covariance, &names) });
        }
        let stated = settings.form_um.iter();
        let coefficients: Vec<(bool, usize, f64)> = stated
            .filter_map(|(name, value)| form_order(name).map(|(cos, order)| (cos, order, value * 1e-3)))
            .collect();
        let covariance = DMatrix::zeros(coefficients.len(), coefficients.len());
        (!coefficients.is_empty()).then_some(Self { coefficients, covariance })
    }
}

fn block(covariance: &NamedCovariance, names: &[&String]) -> DMatrix<f64> {
    covariance.block(names)
}

/// A run.
pub struct Checked {
    /// Name of the run.
    pub run: String,
    /// Values, mm: those of the run, then the form.
    pub values: Vec<f64>,
    covariance: DMatrix<f64>,
    /// Places of the eccentricity.
    eccentric: Vec<usize>,
    backward: Vec<usize>,
    /// Radial sensors, then the axial one.
    sensors: Vec<Linear>,
    between: Option<f64>,
    highest: usize,
}

impl Checked {
    /// A run of a calibration; the form is taken off if there is one.
    pub fn new(calibration: &Calibration, motion: &Motion, run: &str, form: Option<&Form>) -> Self {
        let prefix = format!("run[{run}].");
        let is_length = |name: &&String| {
            name.strip_prefix(&prefix).is_some_and(|own| !own.starts_with("mean.") && !own.starts_with("drift."))
        };
        let names: Vec<&String> = calibration.covariance.order.iter().filter(is_length).collect();
        let own = block(&calibration.covariance, &names);
        let of_form = form.map_or(0, |form| form.coefficients.len());
        let size = names.len() + of_form;
        let mut covariance = DMatrix::zeros(size, size);
        covariance.view_mut((0, 0), (names.len(), names.len())).copy_from(&own);
        let mut values: Vec<f64> = names.iter().map(|name| value(calibration, name).unwrap_or(0.0)).collect();
        if let Some(form) = form {
            covariance.view_mut((names.len(), names.len()), (of_form, of_form)).copy_from(&form.covariance);
            values.extend(form.coefficients.iter().map(|(.., value)| value));
        }
        let place = |own: &str| names.iter().position(|name| name.strip_prefix(&prefix) == Some(own));
        let places = |list: [&str; 2]| list.iter().filter_map(|own| place(own)).collect();
        let highest = usize::from(motion.harmonics);
        let mut checked = Self {
            run: run.to_owned(),
            values,
            covariance,
            eccentric: places(["ecc.x", "ecc.y"]),
            backward: places(["back.cos", "back.sin"]),
            sensors: Vec::new(),
            between: between(&motion.radial),
            highest,
        };
        for (number, (sensor, radial)) in motion.radial.iter().enumerate() {
            let mut linear = checked.of_sensor(sensor, &place);
            checked.add_fundamental(&mut linear, number, sensor, &place);
            if let Some(form) = form {
                take_off(&mut linear, form, names.len(), radial.azimuth_deg.to_radians());
            }
            checked.sensors.push(linear);
        }
        let axial = motion.axial.iter().map(|axial| checked.of_sensor(axial, &place)).collect::<Vec<_>>();
        checked.sensors.extend(axial);
        checked
    }

    fn of_sensor(&self, sensor: &str, place: &dyn Fn(&str) -> Option<usize>) -> Linear {
        let mut linear = Linear::new(self.highest);
        for order in 1..=self.highest {
            let [cos, sin] = of_order(&format!("sync.{sensor}"), order).map(|name| place(&name));
            linear.cos[order].extend(cos.map(|place| (place, 1.0)));
            linear.sin[order].extend(sin.map(|place| (place, 1.0)));
        }
        linear
    }

    /// Order 1 of a radial sensor.
    fn add_fundamental(&self, linear: &mut Linear, number: usize, sensor: &str, place: &dyn Fn(&str) -> Option<usize>) {
        let Some(between) = self.between else {
            linear.cos[1].extend(place(&format!("fundamental.{sensor}[cos]")).map(|place| (place, 1.0)));
            linear.sin[1].extend(place(&format!("fundamental.{sensor}[sin]")).map(|place| (place, 1.0)));
            return;
        };
        let (along_x, along_y) = if number == 0 { (1.0, 0.0) } else { (between.cos(), between.sin()) };
        for (index, place) in self.eccentric.iter().chain(&self.backward).enumerate() {
            let mut unit = [0.0; 4];
            unit[index] = 1.0;
            let fundamental = Fundamental { eccentricity: [unit[0], unit[1]], backward: [unit[2], unit[3]] };
            let [x, y] = fundamental.along();
            linear.cos[1].push((*place, along_x * x[0] + along_y * y[0]));
            linear.sin[1].push((*place, along_x * x[1] + along_y * y[1]));
        }
    }

    /// The values, the eccentricity of the artefact set to zero.
    pub fn centred(&self, values: &[f64]) -> Vec<f64> {
        let mut centred = values.to_vec();
        self.eccentric.iter().for_each(|place| centred[*place] = 0.0);
        centred
    }

    /// Harmonics of a sensor.
    pub fn sensor(&self, number: usize, values: &[f64]) -> Harmonics {
        self.sensors[number].of(values)
    }

    /// Harmonics along the direction that turns with the spindle, of a pair.
    pub fn rotating(&self, values: &[f64]) -> Option<Harmonics> {
        let between = self.between?;
        let (x, other) = (self.sensor(0, values), self.sensor(1, values));
        let y = other.combined(1.0 / between.sin(), &x, -between.cos() / between.sin());
        Some(rotating(&x, &y))
    }

    /// The standard uncertainty of what depends on the values like this, to first order.
    pub fn uncertainty(&self, change: &dyn Fn(&[f64]) -> f64) -> f64 {
        let mut unit = vec![0.0; self.values.len()];
        let gradient = DVector::from_fn(self.values.len(), |place, _| {
            unit[place] = 1.0;
            let slope = change(&unit);
            unit[place] = 0.0;
            slope
        });
        (&self.covariance * &gradient).dot(&gradient).max(0.0).sqrt()
    }

    /// An amplitude and its standard uncertainty, mm.
    fn amplitude(&self, cos: impl Fn(&[f64]) -> f64, sin: impl Fn(&[f64]) -> f64) -> (f64, f64) {
        let (one, other) = (cos(&self.values), sin(&self.values));
        let size = one.hypot(other);
        let slope = |by: &[f64]| if size > 0.0 { (one * cos(by) + other * sin(by)) / size } else { 0.0 };
        (size, self.uncertainty(&slope))
    }

    /// Size and phase (rad) of the eccentricity with the standard uncertainty of its size; none without a pair.
    pub fn eccentricity(&self) -> Option<(f64, f64, f64)> {
        let [x, y] = self.eccentric[..] else { return None };
        let (size, uncertainty) = self.amplitude(|values| values[x], |values| values[y]);
        Some((size, uncertainty, self.values[y].atan2(self.values[x])))
    }

    /// Amplitude of the fundamental that goes round against the spindle.
    pub fn backward(&self) -> Option<(f64, f64)> {
        let [cos, sin] = self.backward[..] else { return None };
        Some(self.amplitude(|values| values[cos], |values| values[sin]))
    }

    /// Amplitude of an order of a sensor, mm.
    pub fn order(&self, sensor: usize, order: usize) -> (f64, f64) {
        let linear = &self.sensors[sensor];
        let sum = |terms: &[(usize, f64)], values: &[f64]| -> f64 {
            terms.iter().map(|(place, factor)| values[*place] * factor).sum()
        };
        self.amplitude(|values| sum(&linear.cos[order], values), |values| sum(&linear.sin[order], values))
    }
}

/// Takes the form off what a sensor at this azimuth reads: h(azimuth - S).
fn take_off(linear: &mut Linear, form: &Form, first: usize, azimuth: f64) {
    for (index, (of_cos, order, _)) in form.coefficients.iter().enumerate() {
        if *order >= linear.cos.len() {
            continue;
        }
        let (sin, cos) = (*order as f64 * azimuth).sin_cos();
        let (by_cos, by_sin) = if *of_cos { (cos, sin) } else { (sin, -cos) };
        linear.cos[*order].push((first + index, -by_cos));
        linear.sin[*order].push((first + index, -by_sin));
    }
}

impl Checked {
    /// Harmonics of one prefix alone.
    pub fn of_prefix(calibration: &Calibration, prefix: &str, highest: usize) -> Self {
        let start = format!("{prefix}[");
        let names: Vec<&String> = calibration.covariance.order.iter().filter(|name| name.starts_with(&start)).collect();
        let mut linear = Linear::new(highest);
        for order in 1..=highest {
            let [cos, sin] = of_order(prefix, order).map(|own| names.iter().position(|name| **name == own));
            linear.cos[order].extend(cos.map(|place| (place, 1.0)));
            linear.sin[order].extend(sin.map(|place| (place, 1.0)));
        }
        Self {
            run: String::new(),
            values: names.iter().map(|name| value(calibration, name).unwrap_or(0.0)).collect(),
            covariance: block(&calibration.covariance, &names),
            eccentric: Vec::new(),
            backward: Vec::new(),
            sensors: vec![linear],
            between: None,
            highest,
        }
    }
}
