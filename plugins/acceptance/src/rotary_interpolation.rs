//! Validator plugin `rotary-interpolation`: R-test figures in the manner of ISO 10791-6.

use abbe_core::{
    Column, Context, DataRow, Dataset, Error, EstimateSource, Findings, Quantity, Result, SettingsError, Validate,
    not_negative,
};
use abbe_standards::rotary_interpolation::{EDITION, Path, ranges};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::both_directions::{place_of_angle, smaller_direction};
use crate::channel_units::other_unit;
use crate::common::{
    Acceptance, Judge, Key, Limits, MOST_STEPS, Sheet, against, check_limits, directions, doubted, faults, finite,
    names, run_name, too_quiet, undecided,
};
use crate::rotary_readings::mirrored;

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
    #[schemars(inner(range(min = -100000, max = 100000)))]
    ball_from_axis_mm: Option<[f64; 3]>,
    /// The axis turns against ISO 841, or carries the tool, so that the linear axes follow the ball by its angle and not against it.
    #[serde(default)]
    reverse: bool,
    /// Columns of the readings along x, y and z of the machine, without their unit; or the one column of a ball bar.
    #[serde(default = "readings")]
    readings: Vec<String>,
    /// Standard uncertainty of a reading. Ranges have that of a difference of two. 0: it is not known, and ranges have none.
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

/// Direction of the axis, and the ball at angle 0 from a point of it.
type OfAxis = ([f64; 3], [f64; 3]);

/// Part of the distance of the ball from the axis by which linear axes are off its way at most.
const ON_ITS_WAY: f64 = 1e-3;

/// Fewest steps against their direction that are no order of rows by chance.
const FEWEST_STEPS: usize = 6;

/// How far the way of the linear axes is at most from that of the ball, radial directions from the first row, and in which row.
fn off(path: &Path, radius: f64, angles: &[f64], [x, y, z]: [&[f64]; 3]) -> (f64, usize) {
    let (first, mut most) = (path.radial(angles[0]), (0.0_f64, 0));
    for (row, angle) in angles.iter().enumerate() {
        let radial = path.radial(*angle);
        let way = [x[row] - x[0], y[row] - y[0], z[row] - z[0]];
        let square: f64 = (0..3).map(|k| (way[k] - radius * (radial[k] - first[k])).powi(2)).sum();
        most = if square.sqrt() > most.0 { (square.sqrt(), row) } else { most };
    }
    most
}

/// The columns with whose signs turned, or which exchanged, the linear axes are on the way of the ball, and how far they are off then.
fn likely(
    path: &Path,
    radius: f64,
    (angles, axis): (&[f64], &str),
    places: [&[f64]; 3],
    most: f64,
) -> Option<(String, f64)> {
    let names = ["X_mm", "Y_mm", "Z_mm"];
    let negated = |values: &[f64]| values.iter().map(|value| -value).collect::<Vec<f64>>();
    let mut found: Vec<(String, f64)> = Vec::new();
    let mut tried = |words: String, left: f64| {
        if left <= most {
            found.push((words, left));
        }
    };
    for (place, name) in names.iter().enumerate() {
        let own = negated(places[place]);
        let mut corrected = places;
        corrected[place] = &own;
        tried(format!("the sign of `{name}` turned"), off(path, radius, angles, corrected).0);
    }
    tried(format!("the sign of `{axis}_deg` turned"), off(path, radius, &negated(angles), places).0);
    for [one, other] in [[0, 1], [1, 2], [0, 2]] {
        let mut corrected = places;
        corrected.swap(one, other);
        tried(format!("`{}` and `{}` exchanged", names[one], names[other]), off(path, radius, angles, corrected).0);
    }
    let left = found.iter().map(|(_, left)| *left).reduce(f64::max)?;
    Some((found.into_iter().map(|(words, _)| words).collect::<Vec<_>>().join(", or "), left))
}

impl Rotary {
    /// Where the ball is, as the linear axes follow it, and a sentence on a way that is mirrored; none for a ball on the axis.
    fn path(&self, data: &Dataset, angles: &[f64], of_axis: OfAxis) -> Result<Option<(Path, Option<String>)>> {
        let [x, y, z] = ["X", "Y", "Z"].map(|axis| finite(data, axis, Quantity::Length));
        let places = [x?, y?, z?];
        let (direction, ball) = of_axis;
        let sense = if self.reverse { 1.0 } else { -1.0 };
        let ways = [sense, -sense].map(|sense| Path::new(direction, ball, sense));
        let [Some(expected), Some(mirrored)] = ways else { return Ok(None) };
        let radius = radius(direction, ball);
        let most = ON_ITS_WAY * radius.max(1.0);
        let (distance, row) = off(&expected, radius, angles, places);
        if distance <= most {
            return Ok(Some((expected, None)));
        }
        let likely = likely(&expected, radius, (angles, &self.axis), places, most);
        if off(&mirrored, radius, angles, places).0 > most {
            let message = format!("the linear axes are {distance:.3} mm off the way of the ball here");
            let help = "are `axis`, `direction` and `ball_from_axis_mm` those of this test?";
            let help = likely.map_or_else(
                || help.to_owned(),
                |(words, left)| format!("with {words} they are {left:.3} mm off at most: is that what is wrong?"),
            );
            return Err(data.error_at(DataRow(row), message).help(help));
        }
        let corrected = likely.map_or_else(String::new, |(words, left)| format!(", and {left:.3} mm with {words}"));
        let sentence = format!(
            "the linear axes follow a ball that turns the other way round: they are {distance:.3} mm off its way{corrected}. Is this sign \
             wrong, or has the axis to be told `reverse: {}`?",
            !self.reverse
        );
        Ok(Some((mirrored, Some(sentence))))
    }

    /// A sentence on rows that run against their directions.
    fn turned(&self, data: &Dataset, angles: &[f64], ways: &[bool]) -> Option<String> {
        let other = |column: &&Column| {
            let name = column.header.name.as_str();
            name != self.axis && name.len() == 1 && column.header.quantity == Quantity::Angle
        };
        let moves = |values: &[f64]| values.iter().any(|own| (own - values[0]).abs() > SAME_ANGLE);
        // Where two axes turn, directions may be those of the other one.
        let mut others = data.columns.iter().filter(other).filter_map(|column| data.numbers(&column.header.name));
        if others.any(moves) {
            return None;
        }
        let [positive, negative] = against(angles, ways);
        let (count, all) = (positive.0 + negative.0, positive.1 + negative.1);
        (count >= FEWEST_STEPS && count as f64 > MOST_STEPS * all as f64).then(|| {
            format!(
                "`{}` runs against `direction` in {count} of {all} steps: is the sign of `direction` or of `{0}` wrong?",
                self.axis
            )
        })
    }

    /// What keeps the test from deciding: one way with few angles, or over a small part of a turn.
    fn lacking(&self, angles: &[f64], ways: &[bool]) -> Option<String> {
        let measured = [true, false].map(|way| {
            let own = angles.iter().zip(ways).filter(|(_, own)| **own == way);
            let mut places: Vec<f64> = own.map(|(angle, _)| *angle).collect();
            places.sort_by(f64::total_cmp);
            places.dedup_by(|next, place| (*next - *place).abs() < SAME_ANGLE);
            (places.len(), places.last().zip(places.first()).map_or(0.0, |(last, first)| last - first))
        });
        let is_enough = |(count, turned): (usize, f64)| count >= FEWEST_ANGLES && turned >= LEAST_TURN;
        (!measured.into_iter().all(is_enough)).then(|| {
            let [positive, negative] =
                measured.map(|(count, turned)| format!("{count} angles over {:.1} deg", turned.to_degrees()));
            format!(
                "{} was at {positive} in the positive direction, and at {negative} in the negative one: {FEWEST_ANGLES} angles over {:.0} \
                 deg, both ways, are needed to decide",
                self.axis,
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
        let mut faults = faults(&named, 1e-3 * self.standard_uncertainty_um, (1e3, "um"));
        let um: Vec<Vec<f64>> = columns.iter().map(|column| column.iter().map(|value| 1e3 * value).collect()).collect();
        let places: Vec<usize> = angles.iter().map(|angle| place_of_angle(*angle)).collect();
        faults.extend(smaller_direction(&um.iter().map(Vec::as_slice).collect::<Vec<_>>(), &ways, &places, "um"));
        let named_um: Vec<(&str, &[f64])> =
            self.readings.iter().map(String::as_str).zip(um.iter().map(Vec::as_slice)).collect();
        faults.extend(other_unit(&named_um, self.standard_uncertainty_um, "um"));
        findings.remarks.extend(too_quiet(&run, &um.concat(), self.standard_uncertainty_um, "um"));
        let of_axis = self.direction.zip(self.ball_from_axis_mm);
        let path = of_axis.map(|of_axis| self.path(data, angles, of_axis)).transpose()?;
        if let Some(Some((path, way))) = &path {
            faults.extend(way.clone());
            let readings: Vec<[f64; 3]> =
                (0..angles.len()).map(|row| [columns[0][row], columns[1][row], columns[2][row]]).collect();
            let distance = of_axis.map_or(0.0, |(direction, ball)| radius(direction, ball));
            let names = [&self.readings[0], &self.readings[1], &self.readings[2]].map(String::as_str);
            faults.extend(mirrored(path, distance, angles, &readings, names).filter(|_| way.is_none()));
        }
        faults.extend(self.turned(data, angles, &ways));
        findings.remarks.extend(faults.iter().map(|fault| format!("{run}: {fault}")));
        let lacking = self.lacking(angles, &ways);
        findings.remarks.extend(lacking.iter().map(|lacking| format!("{run}: {lacking}")));
        let mut all: Vec<(&str, &'static str, Vec<f64>)> = Vec::new();
        match path {
            None => {}
            Some(Some((path, _))) => {
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

#[cfg(test)]
mod tests {
    use abbe_core::{ColumnHeader, RowOrigin, Values};
    use abbe_numerics::Generator;

    use super::*;

    const HEADERS: [&str; 8] = ["direction", "X_mm", "Y_mm", "Z_mm", "C_deg", "meas_x_um", "meas_y_um", "meas_z_um"];

    /// Rows in mm and rad: those of a C axis on a table that turns by `reverse` or not, on a random machine.
    fn rows(seed: u64, reverse: bool) -> Vec<[f64; 8]> {
        let mut generator = Generator::new(seed, 0);
        let mut next = move || generator.normal().clamp(-2.5, 2.5);
        let sense = if reverse { 1.0 } else { -1.0 };
        let (turn, steps) = ([120.0_f64, 200.0, 360.0][seed as usize % 3].to_radians(), 12 + seed as usize % 20);
        let place = [100.0 * next(), 100.0 * next(), 200.0];
        let (off, first) = ([0.02 * next(), 0.02 * next()], next());
        let count = 2 * steps;
        (0..count)
            .map(|row| {
                let way = if row < steps { 1.0 } else { -1.0 };
                let step = if row < steps { row } else { count - 1 - row };
                let angle = first + turn * step as f64 / (steps - 1) as f64;
                let (sin, cos) = (sense * angle).sin_cos();
                let readings = [off[0] * cos - off[1] * sin, off[0] * sin + off[1] * cos, 0.002 * way];
                let own = readings.map(|own| own + 3e-4 * next());
                let at =
                    [place[0] + 110.0 * cos, place[1] + 110.0 * sin, place[2]].map(|own| (1e5 * own).round() / 1e5);
                [way, at[0], at[1], at[2], angle, own[0], own[1], own[2]]
            })
            .collect()
    }

    fn data(rows: &[[f64; 8]]) -> Dataset {
        let column = |(place, header): (usize, &&str)| {
            let numbers = || rows.iter().map(|row| row[place]);
            let values = match place {
                0 => Values::Labels(numbers().map(|way| way.to_string().into()).collect()),
                _ => Values::Numbers(numbers().collect()),
            };
            Column { header: ColumnHeader::parse(header), values }
        };
        Dataset {
            columns: HEADERS.iter().enumerate().map(column).collect(),
            origins: (0..rows.len()).map(|row| RowOrigin { file: 0, line: row + 2, row: 0 }).collect(),
            files: vec!["c.csv".into()],
            ..Dataset::default()
        }
    }

    /// The remarks on a fault, and whether limits are decided; an error as its message and its help.
    fn judged(rows: &[[f64; 8]], reverse: bool) -> (String, bool) {
        let settings = json!({ "axis": "C", "direction": [0, 0, 1], "ball_from_axis_mm": [110, 0, 60], "reverse": reverse,
            "standard_uncertainty_um": 0.3, "limits": { "radial_um": 1e5, "x_um": 1e5, "axial_um": 1e5 } });
        let rotary: Rotary = abbe_core::from_settings(&settings).expect("settings");
        match rotary.findings(&[&data(rows)]) {
            Ok(found) => {
                let limited = found.figures.iter().filter(|figure| figure.limit.is_some());
                (
                    found.remarks.join("\n"),
                    limited.clone().count() > 0 && limited.clone().all(|own| own.inconclusive.is_none()),
                )
            }
            Err(error) => (error.to_string(), false),
        }
    }

    #[test]
    fn tests_that_are_right_decide_without_a_word() {
        for seed in 0..600 {
            let reverse = seed % 4 == 0;
            let (said, is_decided) = judged(&rows(seed, reverse), reverse);
            assert!(is_decided && !said.contains("wrong?"), "{seed}: {said}");
        }
    }

    #[test]
    fn columns_that_are_wrong_are_named_and_decide_nothing() {
        type Wrong = fn(&mut [f64; 8]);
        let wrong: [(&str, Wrong); 5] = [
            ("the sign of `X_mm` turned", |row| row[1] = -row[1]),
            ("the sign of `Y_mm` turned", |row| row[2] = -row[2]),
            ("`X_mm` and `Y_mm` exchanged", |row| row.swap(1, 2)),
            ("the sign of `C_deg` turned", |row| row[4] = -row[4]),
            ("is the sign of `direction`", |row| row[0] = -row[0]),
        ];
        for seed in 0..200 {
            let reverse = seed % 4 == 0;
            for (words, change) in wrong {
                let mut rows = rows(seed, reverse);
                rows.iter_mut().for_each(change);
                let (said, is_decided) = judged(&rows, reverse);
                assert!(!is_decided && said.contains(words), "{seed} {words}: {said}");
            }
            // The other way round of the setting is told as the setting, too.
            let (said, is_decided) = judged(&rows(seed, reverse), !reverse);
            assert!(!is_decided && said.contains(&format!("`reverse: {reverse}`")), "{seed}: {said}");
        }
    }
}
