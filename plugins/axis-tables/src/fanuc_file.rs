//! Reads stored pitch error compensation of Fanuc from parameter text, and says where its reference points are.

use std::collections::BTreeMap;
use std::path::Path;

use abbe_compensation::AxisTable;
use abbe_compensation::active::Believed;
use abbe_core::{Error, KinematicModel, Result};
use abbe_volumetric::{position_unit, rounded_position, within};

use crate::existing::{Placed, text, wrong};

/// Where axes have their reference points, and how they return to them.
#[derive(Debug, Default)]
pub struct Places {
    /// Reference points by axis, mm or rad; zero where none stands here.
    pub reference: BTreeMap<usize, f64>,
    /// Axes whose reference return ends in negative direction.
    pub negative_return: Vec<usize>,
}

impl Places {
    /// The place of the reference point, mm or rad.
    pub fn of(&self, axis: usize) -> f64 {
        self.reference.get(&axis).copied().unwrap_or_default()
    }

    /// Whether the reference return ends in negative direction.
    pub fn returns_negative(&self, axis: usize) -> bool {
        self.negative_return.contains(&axis)
    }

    /// The index of the point of a table that is the reference point.
    pub fn index(&self, table: &AxisTable, model: &dyn KinematicModel) -> Result<usize> {
        let axis = &model.info().axes[table.input];
        let (unit, factor) = position_unit(axis);
        let place = self.of(table.input);
        let found = table.positions.iter().position(|point| ((point - place) * factor).abs() < 1e-6);
        let place = rounded_position(place * factor);
        let refused =
            |message: String, help: &str| Err(within(Error::usage(message).help(help), &["reference_points"]));
        match found {
            None => refused(
                format!("the reference point of {} at {place} {unit} is no point of its table", axis.name),
                "other `ranges` or another step fit",
            ),
            Some(index) if table.repeats && index != 0 => refused(
                format!("the table of {} has to begin at its reference point, {place} {unit}", axis.name),
                "a turn from there, under `ranges`, fits",
            ),
            Some(index) => Ok(index),
        }
    }
}

/// What a file has of the compensation.
#[derive(Debug, Default)]
pub struct InFile {
    /// Values in mm and rad as they stand in the file.
    pub tables: Vec<AxisTable>,
    /// Parameter 3605 by the number of the axis.
    bits: BTreeMap<u16, String>,
    /// Axes that `axis_numbers` does not name, with the first and last numbers of their points.
    others: Vec<(u16, [i64; 2])>,
}

impl InFile {
    /// Parameter 3605 of an axis, where bit 0 says whether both directions have their own points.
    pub fn bits(&self, axis: u16, both: bool) -> String {
        let bits = self.bits.get(&axis).map_or("00000000", String::as_str);
        format!("{}{}", bits.get(..7).unwrap_or("0000000"), u8::from(both))
    }

    /// The number of another axis that has one of these points.
    pub fn owner(&self, first: i64, last: i64) -> Option<u16> {
        self.others.iter().find(|(_, [from, to])| first <= *to && last >= *from).map(|(axis, _)| *axis)
    }
}

/// Numbers of a parameter text.
#[derive(Default)]
struct Numbers {
    of_axes: BTreeMap<(u16, u16), i64>,
    /// Values of points, with their lines.
    points: BTreeMap<i64, (i64, usize)>,
}

impl Numbers {
    /// Points of axes without a name.
    fn of_others(&self, numbered: &BTreeMap<u16, usize>, bits: &BTreeMap<u16, String>) -> Vec<(u16, [i64; 2])> {
        let mut others = Vec::new();
        for ((_, axis), _) in self.of_axes.iter().filter(|((number, _), interval)| *number == 3624 && **interval != 0) {
            let of = |number: u16| self.of_axes.get(&(number, *axis)).copied().unwrap_or_default();
            if numbered.contains_key(axis) {
                continue;
            }
            let (first, last) = (of(3620).min(of(3621)), of(3622));
            others.push((*axis, [first, last]));
            if bits.get(axis).is_some_and(|bits| bits.ends_with('1')) {
                others.push((*axis, [of(3626), of(3626) + last - first]));
            }
        }
        others
    }
}

/// The tables of a file. `numbered` has the axis of a number, `unit` is the detection unit of an axis.
pub fn read(
    path: &Path,
    numbered: &BTreeMap<u16, usize>,
    places: &Places,
    unit: &dyn Fn(usize) -> f64,
    model: &dyn KinematicModel,
    believed: &Believed<'_>,
) -> Result<InFile> {
    let mut found = InFile::default();
    let mut numbers = Numbers::default();
    for (line, text) in text(path)?.lines().enumerate() {
        let text = text.trim().trim_end_matches(';');
        let Some((number, rest)) = text.strip_prefix('N').map(|rest| rest.split_at(digits(rest))) else { continue };
        let fails = || wrong(path, line, format!("`{text}` is no line of parameters"));
        let number: u16 = number.parse().map_err(|_| fails())?;
        match number {
            3605 | 3620..=3627 => {
                for (axis, value) in values_of_axes(rest).ok_or_else(fails)? {
                    if number == 3605 {
                        let is_bits = value.len() == 8 && value.bytes().all(|bit| matches!(bit, b'0' | b'1'));
                        found.bits.insert(axis, Some(value).filter(|_| is_bits).ok_or_else(fails)?.to_owned());
                    } else {
                        numbers.of_axes.insert((number, axis), value.parse().map_err(|_| fails())?);
                    }
                }
            }
            10_000..=19_999 => {
                let value = rest.strip_prefix('P').and_then(|value| value.parse().ok()).ok_or_else(fails)?;
                numbers.points.insert(i64::from(number) - 10_000, (value, line));
            }
            _ => {}
        }
    }
    found.others = numbers.of_others(numbered, &found.bits);
    for (number, axis) in numbered {
        if numbers.of_axes.get(&(3624, *number)).is_none_or(|interval| *interval == 0) {
            continue;
        }
        let both = found.bits.get(number).is_some_and(|bits| bits.ends_with('1'));
        let (table, lines) = table(&numbers, *number, *axis, both, places, model)
            .map_err(|message| Error::data(format!("axis {number}: {message}")).in_file(path).setting("existing"))?;
        let table = table.map(|count| count * unit(*axis));
        Placed { table: &table, lines: [&lines[0], &lines[1]] }.check(believed, path, model)?;
        found.tables.push(table);
    }
    match found.tables.is_empty() {
        true => Err(Error::data("it has no points of axes under `axis_numbers`").in_file(path).setting("existing")),
        false => Ok(found),
    }
}

fn digits(text: &str) -> usize {
    text.find(|letter: char| !letter.is_ascii_digit()).unwrap_or(text.len())
}

/// Axes and values of `A1P0A2P-3`.
fn values_of_axes(text: &str) -> Option<Vec<(u16, &str)>> {
    let axes = text.strip_prefix('A')?.split('A');
    axes.map(|part| part.split_once('P').and_then(|(axis, value)| Some((axis.parse().ok()?, value)))).collect()
}

/// The table of an axis in detection units, with the lines of its points in both directions.
fn table(
    numbers: &Numbers,
    number: u16,
    axis: usize,
    both: bool,
    places: &Places,
    model: &dyn KinematicModel,
) -> Result<(AxisTable, [Vec<usize>; 2]), String> {
    let of = |parameter: u16| {
        let found = numbers.of_axes.get(&(parameter, number)).copied();
        found.ok_or_else(|| format!("N{parameter:05} is missing"))
    };
    let [reference, first, last, interval] = [of(3620)?, of(3621)?, of(3622)?, of(3624)?];
    let repeats = of(3625)? != 0;
    // A turn has its last section twice.
    let begin = first + i64::from(repeats);
    let index = reference + i64::from(!repeats) - first;
    if interval <= 0 || last < begin || last - begin > 100_000 || !(0..=last - begin + 1).contains(&index) {
        return Err("3620 to 3624 are no points around the reference point".to_owned());
    }
    let scale = of(3623)?.max(1) as f64;
    let factor = position_unit(&model.info().axes[axis]).1;
    let ends = 0..=last - begin + 1;
    let place = |end: i64| places.of(axis) + (end - index) as f64 * interval as f64 * 1e-3 / factor;
    let curve = |begin: i64, at_reference: f64| {
        let mut sum = 0.0;
        let mut values = vec![0.0];
        let mut lines = vec![0];
        for point in begin..=begin + last - first - i64::from(repeats) {
            let (value, line) =
                numbers.points.get(&point).ok_or_else(|| format!("N{:05} is missing", 10_000 + point))?;
            sum += *value as f64 * scale;
            values.push(sum);
            lines.push(*line);
        }
        let zero = values.get(index as usize).copied().unwrap_or_default() - at_reference;
        lines[0] = lines.get(1).copied().unwrap_or_default();
        Ok::<_, String>((values.into_iter().map(|value| value - zero).collect::<Vec<f64>>(), lines))
    };
    let against = if both { of(3627)? as f64 } else { 0.0 };
    let [forward_zero, reverse_zero] = if places.returns_negative(axis) { [against, 0.0] } else { [0.0, against] };
    let (forward, forwards) = curve(begin, forward_zero)?;
    let (reverse, reverses) =
        if both { curve(of(3626)? + i64::from(repeats), reverse_zero)? } else { (forward.clone(), forwards.clone()) };
    let table =
        AxisTable { input: axis, output: axis, positions: ends.map(place).collect(), forward, reverse, repeats };
    Ok((table, [forwards, reverses]))
}
