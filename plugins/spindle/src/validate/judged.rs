//! Figures of runs, of a reversal and of a warm-up.

use abbe_core::{Calibration, Error, Figure, Findings, Fit, Passes, Result};
use abbe_standards::spindle::Harmonics;

use super::checked::{Checked, Form};
use super::{AxialFundamental, CentreName, Estimates, Spindle, agreement, tables, total, units};
use crate::motion::Motion;
use crate::parameters::value;
use crate::reversal::Reversal;
use crate::warm_up::WarmUp;

const UM: &str = "um";

/// The names of the runs of a calibration, in its order.
pub fn names(calibration: &Calibration) -> Vec<String> {
    let name = |name: &str| Some(name.strip_prefix("run[")?.strip_suffix("].speed")?.to_owned());
    calibration.parameters.iter().filter_map(|parameter| name(&parameter.name)).collect()
}

/// Figures of all runs, as read and with the form taken off, and their changes since the last check.
pub fn runs(
    settings: &Spindle,
    estimates: &Estimates<'_>,
    data: &[&dyn Passes],
    findings: &mut Findings,
) -> Result<()> {
    let form = Form::of(settings, estimates.reversal.as_ref().map(|(fit, _)| *fit));
    let mut speeds = tables::Speeds::default();
    for (fit, motion) in &estimates.motions {
        let known = names(&fit.calibration);
        if let Some(unknown) = settings.runs.iter().find(|run| !known.contains(run)) {
            let message = format!("`{}` has no run `{unknown}`; its runs are {}", fit.name, known.join(", "));
            return Err(Error::usage(message).setting("runs"));
        }
        let judged = known.iter().filter(|run| settings.is_judged(run));
        let judged: Vec<Checked> =
            judged.map(|run| Checked::new(&fit.calibration, motion, run, form.as_ref())).collect();
        let mut totals = total::figures(fit, motion, &judged, data, findings)?;
        for checked in judged {
            let run = checked.run.as_str();
            findings.remarks.extend(units::other_unit(&fit.calibration, motion, &checked));
            let mut own = of_run(settings, fit, motion, &checked);
            if let Some((last, of_last)) = &estimates.last {
                changes(settings, (last, of_last), &checked, form.as_ref(), &mut own, findings);
            }
            if form.is_some() {
                let read = Checked::new(&fit.calibration, motion, run, None);
                own.extend(as_read(of_run(settings, fit, motion, &read)));
            }
            own.extend(totals.remove(run).unwrap_or_default());
            tables::polar(settings, motion, &checked, findings);
            speeds.push(run, value(&fit.calibration, &format!("run[{run}].speed")), &own);
            findings.figures.extend(own);
        }
        findings.remarks.push(settings.definitions(motion));
    }
    agreement::tell(estimates, form.as_ref(), findings);
    if !estimates.motions.is_empty() {
        findings.tables.insert("speeds.csv".to_owned(), speeds.text());
        findings.remarks.push(of_form(form.is_some(), estimates.reversal.is_some()).to_owned());
        if settings.centre == CentreName::PolarChart
            && estimates.motions.iter().any(|(_, motion)| motion.radial.len() == 1)
        {
            let remark = "one radial sensor does not tell its eccentricity: from the centre of the polar chart it is in the figures";
            findings.remarks.push(remark.to_owned());
        }
    }
    Ok(())
}

fn of_form(is_known: bool, by_reversal: bool) -> &'static str {
    match (is_known, by_reversal) {
        (true, true) => {
            "the form of the artefact is taken off from order 2 on, as the reversal found it: order 1 of form and motion cannot be \
             separated"
        }
        (true, false) => "the form of the artefact is taken off as stated, without an uncertainty",
        _ => "radial figures contain the form of the artefact: no reversal tells it",
    }
}

fn named(name: &str, run: &str, sensor: Option<&str>) -> String {
    match sensor {
        Some(sensor) => format!("{name}[{run} {sensor}]"),
        None => format!("{name}[{run}]"),
    }
}

/// Figures of a run; the first ones matter most.
fn of_run(settings: &Spindle, fit: &Fit, motion: &Motion, checked: &Checked) -> Vec<Figure> {
    let mut all = Vec::new();
    let figure = |name: &str, sensor: Option<&str>, (value, uncertainty): (f64, f64)| {
        Figure::new(&fit.name, named(name, &checked.run, sensor), value, UM).uncertain(uncertainty)
    };
    let asynchronous = |name: &str, sensor: Option<&str>, direction: &str| {
        let value = value(&fit.calibration, &format!("run[{}].async.{direction}", checked.run))?;
        // Two readings of one sector; what a rotating direction reads is as uncertain as a reading.
        let uncertainty = motion.standard_uncertainty_um.map(|reading| reading * std::f64::consts::SQRT_2);
        Some(Figure::new(&fit.name, named(name, &checked.run, sensor), value * 1e3, UM).uncertain(uncertainty))
    };
    let centred = |values: &[f64]| match settings.centre {
        CentreName::PolarChart => checked.centred(values),
        _ => values.to_vec(),
    };
    if checked.rotating(&checked.values).is_some() {
        let rotating = |values: &[f64]| checked.rotating(&centred(values)).unwrap_or_default();
        all.push(figure("synchronous rotating", None, settings.range(checked, &rotating)));
        all.extend(asynchronous("asynchronous rotating", None, "rotating"));
    }
    for (number, sensor) in motion.radial.keys().enumerate() {
        let fixed = |values: &[f64]| checked.sensor(number, &centred(values));
        all.push(figure("synchronous fixed", Some(sensor), settings.range(checked, &fixed)));
        all.extend(asynchronous("asynchronous fixed", Some(sensor), sensor));
    }
    if let Some(axial) = &motion.axial {
        let number = motion.radial.len();
        let all_orders = |values: &[f64]| checked.sensor(number, values);
        // The fundamental of an axial motion is an error: it is never taken off by a centre.
        let whole = Spindle { centre: CentreName::PolarChart, ..settings.clone() };
        let rest = |values: &[f64]| -> Harmonics { checked.sensor(number, values).without(1) };
        all.push(figure("synchronous axial", None, whole.range(checked, &all_orders)));
        let factor = match settings.axial_fundamental {
            AxialFundamental::TwiceAmplitude => 2e3,
            AxialFundamental::Amplitude => 1e3,
        };
        let (size, uncertainty) = checked.order(number, 1);
        all.push(figure("fundamental axial", None, (factor * size, factor * uncertainty)));
        all.push(figure("residual synchronous axial", None, whole.range(checked, &rest)));
        all.extend(asynchronous("asynchronous axial", None, axial));
    }
    if let Some((size, uncertainty, phase)) = checked.eccentricity() {
        all.push(figure("eccentricity", None, (size * 1e3, uncertainty * 1e3)));
        let name = named("eccentricity phase", &checked.run, None);
        let turned = if size > 0.0 { (uncertainty / size).to_degrees() } else { f64::NAN };
        all.push(Figure::new(&fit.name, name, phase.to_degrees(), "deg").uncertain(turned).detail());
    }
    if let Some((size, uncertainty)) = checked.backward() {
        all.push(figure("backward fundamental", None, (size * 1e3, uncertainty * 1e3)));
    }
    all
}

/// Radial synchronous figures with the form in them, as details.
fn as_read(figures: Vec<Figure>) -> impl Iterator<Item = Figure> {
    let radial = |figure: &Figure| {
        ["synchronous rotating", "synchronous fixed"].iter().any(|name| figure.name.starts_with(name))
    };
    figures.into_iter().filter(radial).map(|figure| {
        let name = figure.name.replacen('[', " as read[", 1);
        Figure { name, ..figure }.detail()
    })
}

/// Changes since the last check, and the harmonic that changed most.
fn changes(
    settings: &Spindle,
    (last, motion): (&Fit, &Motion),
    checked: &Checked,
    form: Option<&Form>,
    own: &mut Vec<Figure>,
    findings: &mut Findings,
) {
    if !names(&last.calibration).contains(&checked.run) {
        findings.remarks.push(format!("`{}` has no run `{}`: its change is not known", last.name, checked.run));
        return;
    }
    let before = Checked::new(&last.calibration, motion, &checked.run, form);
    let then = of_run(settings, last, motion, &before);
    let change = |figure: &Figure| {
        let old = then.iter().find(|old| old.name == figure.name && !figure.detail)?;
        let uncertainty = Some(figure.standard_uncertainty?.hypot(old.standard_uncertainty?));
        let (name, of) = (format!("change of {}", figure.name), figure.of.as_deref().unwrap_or_default());
        Some(Figure::new(of, name, figure.value? - old.value?, &figure.unit).uncertain(uncertainty))
    };
    let changed: Vec<Figure> = own.iter().filter_map(change).collect();
    own.extend(changed);
    let sensors = motion.radial.keys().chain(&motion.axial).enumerate();
    let orders = sensors
        .flat_map(|(number, sensor)| (2..=usize::from(motion.harmonics)).map(move |order| (number, sensor, order)));
    let by = |number: usize, order: usize| {
        let (now, then) = (checked.sensor(number, &checked.values), before.sensor(number, &before.values));
        now.combined(1.0, &then, -1.0).amplitude(order) * 1e3
    };
    let all = orders.map(|(number, sensor, order)| (by(number, order), number, sensor, order));
    if let Some((size, number, sensor, order)) = all.max_by(|one, other| one.0.total_cmp(&other.0)) {
        let uncertainty = checked.order(number, order).1.hypot(before.order(number, order).1) * 1e3;
        findings.remarks.push(format!(
            "run `{}`: since `{}` order {order} of {sensor} has changed most, by {size:.3} um (standard uncertainty {uncertainty:.3} um)",
            checked.run, last.name
        ));
    }
}

/// Part of the motion of the spindle from which on an artefact is less round than a master is.
const LESS_ROUND: f64 = 1.1;

/// Figures of a reversal.
pub fn reversal(settings: &Spindle, fit: &Fit, reversal: &Reversal, findings: &mut Findings) {
    let Some(sensor) = reversal.radial.keys().next() else { return };
    let highest = usize::from(reversal.harmonics);
    let mut sizes = Vec::new();
    for (name, prefix) in [
        ("form out of roundness".to_owned(), "form".to_owned()),
        (format!("reversal synchronous fixed[{sensor}]"), format!("sync.{sensor}")),
    ] {
        let checked = Checked::of_prefix(&fit.calibration, &prefix, highest);
        let (value, uncertainty) = settings.range(&checked, &|values| checked.sensor(0, values));
        sizes.push(value);
        findings.figures.push(Figure::new(&fit.name, name, value, UM).uncertain(uncertainty));
    }
    if let [form, motion] = sizes[..]
        && form > LESS_ROUND * motion
    {
        findings.remarks.push(format!(
            "{}: the artefact ({form:.3} um out of round) is less round than the spindle turns ({motion:.3} um): have both traces the \
             sign of the same side? With the sign of one of them turned, form and motion change places",
            fit.name
        ));
    }
    if settings.centre == CentreName::PolarChart {
        let remark = "a reversal tells no fundamental: its figures are counted from orders 2 on, whatever the centre";
        findings.remarks.push(remark.to_owned());
    }
}

/// Figures of a warm-up.
pub fn warm_up(fit: &Fit, warm_up: &WarmUp, findings: &mut Findings) {
    for drift in &warm_up.drift {
        let told = [
            ("end", "warm-up end", UM, 1e3),
            ("range", "warm-up range", UM, 1e3),
            ("slope", "warm-up slope", "um/min", 60e3),
            ("time_to_95", "warm-up time to 95", "min", 1.0 / 60.0),
        ];
        for (what, name, unit, factor) in told {
            if let Some(value) = value(&fit.calibration, &format!("{drift}.{what}")) {
                findings.figures.push(Figure::new(&fit.name, format!("{name}[{drift}]"), factor * value, unit));
            }
        }
        for sensor in &warm_up.temperatures {
            if let Some(gain) = fit.calibration.get(&format!("{drift}[{sensor}]")) {
                let figure = Figure::new(&fit.name, format!("gain[{drift} {sensor}]"), gain.value * 1e3, "um/K");
                findings.figures.push(figure.uncertain(gain.standard_uncertainty * 1e3).detail());
            }
        }
    }
    findings.remarks.push(format!(
        "warm-up in the manner of ISO 230-3:2020: end = last reading, slope = straight line through the last {} minutes, time to 95 % of \
         the way from the first to the last reading",
        warm_up.slope_over_min
    ));
}
