//! What axes do along a path that is recorded in passing: the direction and the velocity of each, from its commands and times.

use std::collections::BTreeMap;

use abbe_core::{Column, ColumnHeader, DataRow, Dataset, Error, Quantity, Result, Values};
use schemars::JsonSchema;
use serde::Deserialize;

/// Readings in passing: columns for the direction (`dir_X`) and the velocity (`velocity_X_mm_per_s`) of axes.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Motion {
    /// The linear axes that move along the path, by the names of their columns without unit.
    axes: Vec<String>,
    /// The column whose labels tell runs of one file apart. The rows of a run stand in the order in which they were passed.
    #[serde(default = "run")]
    runs: String,
    /// Way along the path behind each reversal of an axis whose rows are left out, because the axis has not settled yet. Rows at
    /// a reversal itself are always left out.
    #[serde(default)]
    #[schemars(range(min = 0.0, max = 1e6))]
    after_reversal_mm: f64,
}

fn run() -> String {
    "run".to_owned()
}

/// Times that differ by less than this part of the time between rows from those of a constant feed are rounded ones of it.
const ROUNDED: f64 = 0.02;

/// Rows on either side whose times tell the feed of a row, where the feed changes along the path.
const BESIDE: usize = 5;

/// Part of the way of an axis to the next row by which it moves at the first or the last row of a run; with less it turns there.
const TURNS: f64 = 0.25;

/// Times of the usual way from row to row, and mm, beyond which axes jump; and the times of it by which they have come back to their path.
const JUMPS: (f64, f64) = (10.0, 1.0);
const BACK: f64 = 3.0;

/// Rows are at one place if they are no further apart than this, mm.
const AT_ONE_PLACE: f64 = 1e-9;

impl Motion {
    /// Adds the columns, and says which rows stay.
    ///
    /// Fails for columns that are missing or there already, and where times do not grow along a run.
    pub fn add(&self, data: &mut Dataset) -> Result<Vec<bool>> {
        let wrong = |error: Error, key: &str| error.setting_at(&["motion", key]);
        if self.axes.is_empty() {
            return Err(wrong(Error::usage("at least one axis was expected").help("write `axes: [X, Y]`"), "axes"));
        }
        if !(0.0..=1e6).contains(&self.after_reversal_mm) {
            return Err(wrong(Error::usage("a way from 0 to 1e6 mm was expected"), "after_reversal_mm"));
        }
        let mut names = Vec::new();
        for axis in &self.axes {
            for name in [format!("dir_{axis}"), format!("velocity_{axis}_mm_per_s")] {
                let header = ColumnHeader::parse(&name);
                if data.column(&header.name).is_some() || names.contains(&header) {
                    let error = Error::usage(format!("there is a column `{name}` already"));
                    return Err(wrong(error.help("the data say it: leave this axis out"), "axes"));
                }
                names.push(header);
            }
        }
        let positions: Vec<&[f64]> = (self.axes.iter())
            .map(|axis| abbe_table::numbers(data, axis, Quantity::Length).map_err(|error| wrong(error, "axes")))
            .collect::<Result<_>>()?;
        let stated = match data.column("feed") {
            Some(_) => Some(abbe_table::numbers(data, "feed", Quantity::Speed)?),
            None => None,
        };
        let times = match stated {
            Some(_) => None,
            None => Some(abbe_table::numbers(data, "time", Quantity::Time)?),
        };
        let mut columns = vec![vec![f64::NAN; data.rows()]; names.len()];
        let mut stays = vec![false; data.rows()];
        for rows in self.runs(data).map_err(|error| wrong(error, "runs"))? {
            let path = Path::new(&rows, &positions);
            if let Some((place, off)) = path.beside() {
                let message = format!("the axes are {off:.1} mm beside the path of the rows around this one");
                return Err(data
                    .error_at(DataRow(path.rows[place]), message)
                    .help("look for a lost sign, a wrong unit or a wrong column; a row that is not of the run has to be taken out"));
            }
            let speeds = match (stated, times) {
                (Some(feed), _) => path.rows.iter().map(|row| feed[*row]).collect(),
                (_, Some(times)) => path.speeds(times).map_err(|row| {
                    let error = data.error_at(DataRow(row), "the time does not grow from the row before");
                    error
                        .help("the rows of a run stand in the order of their times; `runs` names what tells runs apart")
                })?,
                _ => Vec::new(),
            };
            let kept = path.settled(self.after_reversal_mm);
            for (place, (&row, speed)) in path.rows.iter().zip(speeds).enumerate() {
                stays[row] = kept[place];
                for axis in 0..self.axes.len() {
                    columns[2 * axis][row] = path.sense(place, axis);
                    columns[2 * axis + 1][row] = speed * path.tangents[place][axis];
                }
            }
        }
        for (header, numbers) in names.into_iter().zip(columns) {
            data.columns.push(Column { header, values: Values::Numbers(numbers) });
        }
        Ok(stays)
    }

    /// The rows of every run, in their order.
    fn runs(&self, data: &Dataset) -> Result<Vec<Vec<usize>>> {
        let labels = match data.column(&self.runs) {
            None if self.runs == run() => None,
            _ => Some(abbe_table::labels(data, &self.runs)?),
        };
        let mut runs: BTreeMap<(usize, &str), Vec<usize>> = BTreeMap::new();
        for (row, origin) in data.origins.iter().enumerate() {
            let label = labels.map_or("", |labels| labels[row].as_str());
            runs.entry((origin.file, label)).or_default().push(row);
        }
        Ok(runs.into_values().collect())
    }
}

/// The rows of a run at which the axes move.
struct Path {
    rows: Vec<usize>,
    /// Places of these rows, mm.
    points: Vec<Vec<f64>>,
    /// Unit vectors along the path.
    tangents: Vec<Vec<f64>>,
    /// Way along the path from the first row, mm.
    ways: Vec<f64>,
}

impl Path {
    /// Rows at the place of the row before are left out: the axes stand there.
    fn new(rows: &[usize], positions: &[&[f64]]) -> Self {
        let (mut kept, mut points): (Vec<usize>, Vec<Vec<f64>>) = (Vec::new(), Vec::new());
        for &row in rows {
            let point: Vec<f64> = positions.iter().map(|axis| axis[row]).collect();
            if points.last().is_none_or(|last| length(&between(last, &point)) > AT_ONE_PLACE) {
                kept.push(row);
                points.push(point);
            }
        }
        let tangents: Vec<Vec<f64>> = (0..points.len()).map(|place| tangent(&points, place)).collect();
        let mut ways = vec![0.0; points.len()];
        for place in 1..points.len() {
            let chord = length(&between(&points[place - 1], &points[place]));
            ways[place] = ways[place - 1] + chord * bulge(&tangents[place - 1], &tangents[place]);
        }
        Self { rows: kept, points, tangents, ways }
    }

    /// The first place to which the axes jump from their path and from which they jump back to it, with its distance from the path, mm.
    /// A jump to another path, or to the first row of a run, is none.
    fn beside(&self) -> Option<(usize, f64)> {
        let steps: Vec<f64> = self.points.windows(2).map(|pair| length(&between(&pair[0], &pair[1]))).collect();
        let mut sorted = steps.clone();
        sorted.sort_by(f64::total_cmp);
        let usual = *sorted.get(sorted.len() / 2)?;
        let is_jump = |step: &usize| steps[*step] > (JUMPS.0 * usual).max(JUMPS.1);
        let jumps: Vec<usize> = (0..steps.len()).filter(is_jump).collect();
        jumps.windows(2).find_map(|jumps| {
            let &[away, back] = jumps else { return None };
            let apart = length(&between(&self.points[away], &self.points[back + 1]));
            (apart <= BACK * usual * (back + 1 - away) as f64).then(|| (away + 1, steps[away]))
        })
    }

    /// The way of an axis from one row to the next.
    fn step(&self, place: usize, axis: usize) -> f64 {
        self.points[place + 1][axis] - self.points[place][axis]
    }

    /// Whether an axis turns at a row.
    fn turns(&self, place: usize, axis: usize) -> bool {
        let last = self.points.len() - 1;
        if last == 0 {
            return true;
        }
        if place > 0 && place < last {
            return self.step(place - 1, axis) * self.step(place, axis) < 0.0;
        }
        let step = if place == 0 { 0 } else { last - 1 };
        let along = self.step(step, axis) / length(&between(&self.points[step], &self.points[step + 1]));
        along != 0.0 && self.tangents[place][axis] / along < TURNS
    }

    /// The direction of an axis at a row, by its way to the row and from there: +1 or -1, and +1 if it stands all the time.
    fn sense(&self, place: usize, axis: usize) -> f64 {
        let before = (0..place).rev().map(|step| self.step(step, axis));
        let after = (place..self.points.len().saturating_sub(1)).map(|step| self.step(step, axis));
        let moved = before.chain(after).find(|step| *step != 0.0).unwrap_or(1.0);
        moved.signum()
    }

    /// Which rows stay: those at which no axis turns, and that are this way behind the last one at which one does.
    fn settled(&self, after: f64) -> Vec<bool> {
        let mut turned = f64::NEG_INFINITY;
        let mut stays = |place: usize| {
            let turns = (0..self.points[place].len()).any(|axis| self.turns(place, axis));
            if turns {
                turned = self.ways[place];
            }
            !turns && self.ways[place] - turned >= after
        };
        (0..self.points.len()).map(&mut stays).collect()
    }

    /// The speed at every row, mm/s; the row whose time does not grow if there is one.
    fn speeds(&self, times: &[f64]) -> std::result::Result<Vec<f64>, usize> {
        let times: Vec<f64> = self.rows.iter().map(|row| times[*row]).collect();
        if let Some(place) = (1..times.len()).find(|place| times[*place] <= times[place - 1]) {
            return Err(self.rows[place]);
        }
        let all = 0..times.len();
        let ([start, speed], off) = line(&times, &self.ways);
        let between = (times.last().unwrap_or(&0.0) - times.first().unwrap_or(&0.0)) / times.len() as f64;
        if start.is_finite() && off <= ROUNDED * between * speed {
            return Ok(vec![speed; times.len()]);
        }
        let of = |place: usize| {
            let near = place.saturating_sub(BESIDE)..(place + BESIDE + 1).min(all.end);
            slope_at(&times[near.clone()], &self.ways[near], times[place])
        };
        Ok(all.clone().map(of).collect())
    }
}

fn between(from: &[f64], to: &[f64]) -> Vec<f64> {
    from.iter().zip(to).map(|(from, to)| to - from).collect()
}

fn length(vector: &[f64]) -> f64 {
    vector.iter().map(|part| part * part).sum::<f64>().sqrt()
}

/// The unit vector along the circle through a point and its neighbours, or through the first or last three points; a line has it, too.
///
/// Inversion about the point turns the circle into a line along its tangent.
fn tangent(points: &[Vec<f64>], place: usize) -> Vec<f64> {
    let last = points.len() - 1;
    // The two other points, and the signs with which they count.
    let (others, signs) = match place {
        _ if last == 0 => return vec![0.0; points[0].len()],
        _ if last == 1 => ([0, 1], [-1.0, 1.0]),
        0 => ([1, 2], [1.0, -1.0]),
        _ if place == last => ([last - 2, last - 1], [1.0, -1.0]),
        _ => ([place - 1, place + 1], [-1.0, 1.0]),
    };
    let mut sum = vec![0.0; points[place].len()];
    for (other, sign) in others.into_iter().zip(signs) {
        let way = between(&points[place], &points[other]);
        let square = length(&way).powi(2);
        if square > 0.0 {
            sum.iter_mut().zip(&way).for_each(|(sum, way)| *sum += sign * way / square);
        }
    }
    let size = length(&sum);
    if size > 0.0 { sum.iter().map(|part| part / size).collect() } else { sum }
}

/// Arc over chord of a circle with these tangents at its ends.
fn bulge(from: &[f64], to: &[f64]) -> f64 {
    let half = 0.5 * length(&between(from, to));
    if half < 1e-6 { 1.0 } else { half.min(1.0).asin() / half.min(1.0) }
}

/// Least-squares line of ways over times: `[start, speed]`, and the largest distance from it.
fn line(times: &[f64], ways: &[f64]) -> ([f64; 2], f64) {
    let count = times.len() as f64;
    let [t, s] = [times, ways].map(|all| all.iter().sum::<f64>() / count);
    let (mut tt, mut ts) = (0.0, 0.0);
    for (time, way) in times.iter().zip(ways) {
        tt += (time - t).powi(2);
        ts += (time - t) * (way - s);
    }
    let speed = if tt > 0.0 { ts / tt } else { 0.0 };
    let off = times.iter().zip(ways).map(|(time, way)| (way - s - speed * (time - t)).abs()).fold(0.0, f64::max);
    ([s - speed * t, speed], off)
}

/// The slope at a time of the least-squares parabola of ways over times; of the line through fewer than three.
fn slope_at(times: &[f64], ways: &[f64], at: f64) -> f64 {
    let ([_, slope], _) = line(times, ways);
    if times.len() < 3 {
        return slope;
    }
    // The square less its own line is orthogonal to lines.
    let moved: Vec<f64> = times.iter().map(|time| time - at).collect();
    let squares: Vec<f64> = moved.iter().map(|time| time * time).collect();
    let ([start, along], _) = line(&moved, &squares);
    let bend: Vec<f64> = moved.iter().zip(&squares).map(|(time, square)| square - start - along * time).collect();
    let weight: f64 = bend.iter().map(|bend| bend * bend).sum();
    let part: f64 = bend.iter().zip(ways).map(|(bend, way)| bend * way).sum();
    // The slope of the square is zero at `at`, so that of what is left is that of its line with the other sign.
    if weight > 0.0 { slope - along * part / weight } else { slope }
}

#[cfg(test)]
#[path = "motion/tests.rs"]
mod tests;
