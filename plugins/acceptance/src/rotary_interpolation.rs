//! Validator plugin `rotary-interpolation`: R-test figures in the manner of ISO 10791-6.

use abbe_core::{
    Context, DataRow, Dataset, Error, EstimateSource, Findings, Quantity, Result, SettingsError, Validate, not_negative,
};
use abbe_standards::rotary_interpolation::{EDITION, Path, ranges};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::common::{
    Acceptance, Judge, Key, Limits, Sheet, check_limits, directions, doubted, faults, finite, names, run_name,
    too_quiet, undecided,
};

abbe_core::register!(
    Validate,
    "rotary-interpolation",
    "a rotary axis turns and linear axes follow a ball, in the manner of ISO 10791-6: ranges of readings",
    Rotary,
    example,
    build,
    "../reference/validate-rotary-interpolation.md",
    EstimateSource::Readings,
);

/// Settings of the test.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Rotary {
    /// The rotary axis that turns, or one of those that turn together: the name of its column, without its unit.
    axis: String,
    /// Direction of the axis in the machine frame. Without it, and `ball_from_axis_mm`, there are no radial, tangential and axial
    /// ranges: two rotary axes turn together, or a ball bar reads along one direction.
    #[serde(default)]
    direction: Option<[f64; 3]>,
    /// The nominal centre of the ball at angle 0 less a point of the axis, machine frame.
    #[serde(default)]
    ball_from_axis_mm: Option<[f64; 3]>,
    /// Columns of the readings along x, y and z of the machine, without their unit; or the one column of a ball bar.
    #[serde(default = "readings")]
    readings: Vec<String>,
    /// Standard uncertainty of a reading. Ranges have that of a difference of two.
    #[serde(default)]
    standard_uncertainty_um: f64,
    /// Largest admissible ranges, of both ways together where both were measured: `radial_um`, `tangential_um`, `axial_um`, `x_um`, `y_um`,
    /// `z_um`, and `reading_um` of a single reading.
    #[serde(default)]
    limits: Limits,
}

fn readings() -> Vec<String> {
    ["meas_x", "meas_y", "meas_z"].map(str::to_owned).to_vec()
}

fn example() -> Value {
    json!({ "axis": "C", "direction": [0, 0, 1], "ball_from_axis_mm": [110, 0, 60], "limits": { "radial_um": 20 } })
}

static KEYS: [Key; 7] = [
    ("radial_um", "radial"),
    ("tangential_um", "tangential"),
    ("axial_um", "axial"),
    ("x_um", "x"),
    ("y_um", "y"),
    ("z_um", "z"),
    ("reading_um", "reading"),
];

/// Those of readings, by how many there are.
fn keys_of_readings(count: usize) -> &'static [Key] {
    if count == 1 { &KEYS[6..] } else { &KEYS[3..6] }
}

fn build(settings: Rotary, _: &Context) -> Result<Box<dyn Validate>, SettingsError> {
    if settings.direction.is_some_and(|direction| Path::new(direction, [1.3, -2.1, 0.7], 1.0).is_none()) {
        return Err(SettingsError::new("direction", "a vector that is not zero was expected"));
    }
    if settings.ball_from_axis_mm.iter().flatten().any(|value| !value.is_finite()) {
        return Err(SettingsError::new("ball_from_axis_mm", "finite numbers were expected"));
    }
    if settings.direction.is_some() != settings.ball_from_axis_mm.is_some() {
        let missing = if settings.direction.is_some() { "ball_from_axis_mm" } else { "direction" };
        let message = "`direction` and `ball_from_axis_mm` belong together: one of the two is missing";
        return Err(SettingsError::new(missing, message));
    }
    if !matches!(settings.readings.len(), 1 | 3) {
        let message = format!("{} columns of readings; one or three were expected", settings.readings.len());
        return Err(SettingsError::new("readings", message));
    }
    if settings.readings.len() == 1 && settings.direction.is_some() {
        let message =
            "a single reading has no radial, tangential and axial part: leave `direction` and `ball_from_axis_mm` out";
        return Err(SettingsError::new("direction", message));
    }
    not_negative("standard_uncertainty_um", settings.standard_uncertainty_um)?;
    check_limits(&settings.limits, &names(&KEYS))?;
    Ok(Box::new(Judge(settings)))
}

/// Angles that are the same place, rad.
const SAME_ANGLE: f64 = 1e-4;

/// Fewest angles, and the least turn, rad, that decide. Some axes turn by a part of a turn only.
const FEWEST_ANGLES: usize = 8;
const LEAST_TURN: f64 = 0.5 * std::f64::consts::PI * (1.0 - 1e-9);

/// Distance of the ball from the axis.
fn radius(axis: [f64; 3], ball: [f64; 3]) -> f64 {
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    (dot(ball, ball) - dot(ball, axis).powi(2) / dot(axis, axis)).max(0.0).sqrt()
}

impl Rotary {
    /// Where the ball is, with the sense in which the linear axes follow it; none for a ball on the axis.
    fn path(&self, data: &Dataset, angles: &[f64], (direction, ball): ([f64; 3], [f64; 3])) -> Result<Option<Path>> {
        let [x, y, z] = ["X", "Y", "Z"].map(|axis| finite(data, axis, Quantity::Length));
        let (x, y, z) = (x?, y?, z?);
        let ways = [1.0, -1.0].map(|sense| Path::new(direction, ball, sense));
        let [Some(plus), Some(minus)] = ways else { return Ok(None) };
        // How far the way of the linear axes is from that of the ball, radial directions from the first row.
        let off = |path: &Path| {
            let radius = radius(direction, ball);
            let (first, mut most) = (path.radial(angles[0]), (0.0_f64, 0));
            for (row, angle) in angles.iter().enumerate() {
                let radial = path.radial(*angle);
                let way = [x[row] - x[0], y[row] - y[0], z[row] - z[0]];
                let square: f64 = (0..3).map(|k| (way[k] - radius * (radial[k] - first[k])).powi(2)).sum();
                most = if square.sqrt() > most.0 { (square.sqrt(), row) } else { most };
            }
            most
        };
        let (one, other) = (off(&plus), off(&minus));
        let (path, (distance, row)) = if one.0 <= other.0 { (plus, one) } else { (minus, other) };
        if distance > 1e-3 * radius(direction, ball).max(1.0) {
            let message = format!("the linear axes are {distance:.3} mm off the way of the ball here");
            let error = data.error_at(DataRow(row), message);
            return Err(error.help("are `axis`, `direction` and `ball_from_axis_mm` those of this test?"));
        }
        Ok(Some(path))
    }

    /// What keeps the test from deciding: few angles, a small part of a turn, or one way alone.
    fn lacking(&self, angles: &[f64], ways: &[bool]) -> Option<String> {
        let mut places: Vec<f64> = angles.to_vec();
        places.sort_by(f64::total_cmp);
        places.dedup_by(|next, place| (*next - *place).abs() < SAME_ANGLE);
        let turned = places.last().zip(places.first()).map_or(0.0, |(last, first)| last - first);
        let is_both_ways = ways.iter().any(|way| *way) && !ways.iter().all(|way| *way);
        (places.len() < FEWEST_ANGLES || turned < LEAST_TURN || !is_both_ways).then(|| {
            format!(
                "{} was at {} angles over {:.1} deg{}: {FEWEST_ANGLES} angles over {:.0} deg, both ways, are needed to decide",
                self.axis,
                places.len(),
                turned.to_degrees(),
                if is_both_ways { "" } else { ", one way" },
                LEAST_TURN.to_degrees()
            )
        })
    }

    fn judge(&self, data: &Dataset, findings: &mut Findings) -> Result<()> {
        let run = run_name(data);
        let angles = finite(data, &self.axis, Quantity::Angle)?;
        let ways = directions(data)?;
        let columns: Vec<&[f64]> =
            self.readings.iter().map(|name| finite(data, name, Quantity::Length)).collect::<Result<_>>()?;
        if angles.is_empty() {
            return Err(Error::data(format!("{run}: there is no reading to judge")).setting("from"));
        }
        findings.remarks.extend(doubted(&run, &columns));
        let named: Vec<(&str, &[f64])> =
            self.readings.iter().map(String::as_str).zip(columns.iter().copied()).collect();
        let faults = faults(&named, 1e-3 * self.standard_uncertainty_um, (1e3, "um"));
        findings.remarks.extend(faults.iter().map(|fault| format!("{run}: {fault}")));
        let um: Vec<f64> = columns.iter().flat_map(|column| column.iter().map(|value| 1e3 * value)).collect();
        findings.remarks.extend(too_quiet(&run, &um, self.standard_uncertainty_um, "um"));
        let lacking = self.lacking(angles, &ways);
        findings.remarks.extend(lacking.iter().map(|lacking| format!("{run}: {lacking}")));
        let mut all: Vec<(&str, &'static str, Vec<f64>)> = Vec::new();
        let of_axis = self.direction.zip(self.ball_from_axis_mm);
        let path = of_axis.map(|of_axis| self.path(data, angles, of_axis)).transpose()?;
        match path {
            None => {}
            Some(Some(path)) => {
                let split: Vec<[f64; 3]> = (0..angles.len())
                    .map(|row| path.split(angles[row], [columns[0][row], columns[1][row], columns[2][row]]))
                    .collect();
                for (place, (key, name)) in KEYS[..3].iter().copied().enumerate() {
                    all.push((name, key, split.iter().map(|own| own[place]).collect()));
                }
            }
            Some(None) => {
                findings.remarks.push(format!("{run}: the ball is on the axis: there is no radial direction"))
            }
        }
        for (place, (key, _)) in keys_of_readings(columns.len()).iter().copied().enumerate() {
            all.push((&self.readings[place], key, columns[place].to_vec()));
        }
        let u = self.standard_uncertainty_um;
        let uncertainty = (u > 0.0).then_some(2.0_f64.sqrt() * u);
        let mut sheet = Sheet::new(&run, &self.limits).lacking(lacking);
        for (name, key, values) in all {
            let found = ranges(&values, &ways);
            // Both ways together are judged, or the one that was measured.
            let alone = found.both.is_none();
            for (way, value, judged) in
                [("up", found.up, alone), ("down", found.down, alone), ("both", found.both, true)]
            {
                let (name, Some(value)) = (format!("{name} {way}"), value.map(|value| 1e3 * value)) else { continue };
                match judged {
                    true => sheet.limit(&name, value, uncertainty, key),
                    false => sheet.tell(&name, value, "um").standard_uncertainty = uncertainty,
                }
            }
        }
        let mut figures = sheet.finish(&KEYS);
        undecided(&mut figures, &faults);
        findings.figures.extend(figures);
        Ok(())
    }
}

impl Acceptance for Rotary {
    fn findings(&self, data: &[&Dataset]) -> Result<Findings> {
        let mut findings = Findings::default();
        data.iter().try_for_each(|data| self.judge(data, &mut findings))?;
        findings.remarks.push(format!(
            "{EDITION} (its text was not at hand). A choice of this project: its figures are ranges of readings as set up, not centred"
        ));
        Ok(findings)
    }
}
