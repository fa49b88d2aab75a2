//! Ingest plugin `probe-csv`: maps of heights that bCNC saves (`.probe`).

use std::path::Path;

use abbe_core::{Context, Dataset, Error, Ingest, Result, SettingsError};
use serde_json::{Value, json};

use super::table::{Rows, Settings, Units, no_unit, number, stage};

abbe_core::register!(
    Ingest,
    "probe-csv",
    "reads maps of heights that bCNC saves (.probe)",
    Settings,
    example,
    build,
    "../../reference/ingest-probe-csv.md",
);

fn example() -> Value {
    json!({ "path": "plate.probe", "units": "mm" })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Ingest>, SettingsError> {
    stage(settings, context, read)
}

/// A line, and the numbers in it.
type Numbers<'a> = (usize, &'a str, Vec<f64>);

/// How far a point may lie from its place in the grid, in steps.
const OFF_GRID: f64 = 0.01;

pub(crate) fn read(path: &Path, text: &str, units: Option<Units>) -> Result<(Dataset, Vec<String>)> {
    let scale = units.ok_or_else(|| no_unit(path))?.scale();
    let mut lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()).map(|(index, line)| {
        let numbers: Option<Vec<f64>> = line.split_whitespace().map(number).collect();
        let numbers = numbers.ok_or_else(|| {
            Error::data(format!("`{}` are no numbers", crate::log::shown(line.trim()))).at(path, index + 1, Some(1))
        })?;
        Ok((index + 1, line, numbers))
    });
    let mut header = |what: &str, count: usize| -> Result<Numbers<'_>> {
        let missing = || Error::data(format!("the file ends before its {what}")).in_file(path);
        let (line, written, numbers) = lines.next().ok_or_else(missing)??;
        match numbers.len() == count {
            true => Ok((line, written, numbers)),
            false => Err(Error::data(format!("{} numbers; {what} were expected, {count} numbers", numbers.len()))
                .at(path, line, Some(1))
                .help("a file of bCNC begins with xmin xmax nx, ymin ymax ny, and zmin zmax feed")),
        }
    };
    let x = grid(path, header("xmin xmax nx", 3)?)?;
    let y = grid(path, header("ymin ymax ny", 3)?)?;
    let (line, _, z) = header("zmin zmax feed", 3)?;
    if z[2] <= 0.0 || z[0] > z[1] {
        return Err(Error::data("zmin zmax feed were expected, with a feed above zero").at(path, line, Some(1)));
    }
    let feed = z[2] * scale / 60.0;
    let mut rows = Rows::new(path, &["feature", "X_mm", "Y_mm", "Z_mm", "feed_mm_per_min"]);
    let mut count = 0;
    for found in lines {
        let (line, _, numbers) = found?;
        let wrong = |message: String| Error::data(message).at(path, line, Some(1));
        let [px, py, pz] = <[f64; 3]>::try_from(numbers).map_err(|numbers| {
            wrong(format!("{} numbers; x y z were expected", numbers.len())).help("was the file cut?")
        })?;
        // bCNC writes rows of x, from ymin on.
        let place = [count % x.count, count / x.count];
        for (axis, own, grid, place) in [("x", px, &x, place[0]), ("y", py, &y, place[1])] {
            if (own - grid.at(place)).abs() > OFF_GRID * grid.step() || place >= grid.count {
                let message =
                    format!("point {} has {axis} = {own}; {} was expected by the grid", count + 1, grid.at(place));
                return Err(wrong(message).help("points are lost, doubled or mixed up"));
            }
        }
        if pz < z[0] - 1e-6 || pz > z[1] + 1e-6 {
            return Err(wrong(format!("z = {pz} is not between zmin = {} and zmax = {}", z[0], z[1])));
        }
        count += 1;
        rows.push(line, &[&count.to_string()], &[px * scale, py * scale, pz * scale, feed]);
    }
    if count != x.count * y.count && count > 0 {
        let message = format!("{count} points; {} times {} were expected by the grid", x.count, y.count);
        return Err(Error::data(message).in_file(path).help("the probing was aborted, or the file is cut"));
    }
    Ok((rows.finish("point")?, Vec::new()))
}

/// Positions of one axis.
struct Grid {
    from: f64,
    to: f64,
    count: usize,
}

impl Grid {
    fn at(&self, place: usize) -> f64 {
        self.from + self.step() * place as f64
    }

    fn step(&self) -> f64 {
        if self.count > 1 { (self.to - self.from) / (self.count - 1) as f64 } else { 1.0 }
    }
}

fn grid(path: &Path, (line, written, numbers): Numbers<'_>) -> Result<Grid> {
    let count = numbers[2];
    if count.fract() != 0.0 || !(1.0..1e6).contains(&count) || numbers[1] < numbers[0] {
        let message =
            format!("`{}`: the smallest and the largest position and their number were expected", written.trim());
        return Err(Error::data(message).at(path, line, Some(1)));
    }
    Ok(Grid { from: numbers[0], to: numbers[1], count: count as usize })
}
