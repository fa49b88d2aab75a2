//! Ingest plugin `inspection-g800`: results of inspections as CAM posts let controls write them.
//!
//! `G800` has a nominal point of the surface and its normal, `G801` the measured centre of the tip and its radius.

use std::collections::BTreeMap;
use std::path::Path;

use abbe_core::{Context, Dataset, Error, Ingest, Result, SettingsError};
use serde_json::{Value, json};

use super::table::{Rows, Settings, Units, no_unit, stage};
use crate::log::{Word, shown, words};

abbe_core::register!(
    Ingest,
    "inspection-g800",
    "reads results of inspections that CAM posts write (G800, G801)",
    Settings,
    example,
    build,
    "../../reference/ingest-inspection-g800.md",
);

fn example() -> Value {
    json!({ "path": "results.txt", "units": "mm", "keep": { "set": [1] } })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Ingest>, SettingsError> {
    stage(settings, context, read)
}

/// What begins a line that says nothing of points.
const HEADINGS: [&str; 7] = ["RESULTSFILE", "DOCUMENTID", "MODELVERSION", "TIMESTAMP", "G331", "G330", "G802"];

/// Deviation beyond which a point is taken for one that was written wrongly, mm.
const FAR: f64 = 5.0;

/// How much the length of a normal may be off: digits that were cut.
const NO_UNIT_VECTOR: f64 = 0.01;

/// A nominal point that waits for its measured one.
struct Nominal {
    line: usize,
    point: [f64; 3],
    normal: [f64; 3],
}

/// The points of a text.
struct Points<'a> {
    path: &'a Path,
    scale: f64,
    set: usize,
    toolpath: String,
    nominal: BTreeMap<u32, Nominal>,
    /// Line of each point that is measured in this set and toolpath.
    measured: BTreeMap<u32, usize>,
    rows: Rows,
    missed: usize,
    mislabelled: usize,
}

pub(crate) fn read(path: &Path, text: &str, units: Option<Units>) -> Result<(Dataset, Vec<String>)> {
    let scale = units.ok_or_else(|| no_unit(path))?.scale();
    let columns = [
        "set",
        "toolpath",
        "feature",
        "X_mm",
        "Y_mm",
        "Z_mm",
        "x_mm",
        "y_mm",
        "z_mm",
        "nx",
        "ny",
        "nz",
        "tip_radius_mm",
    ];
    let mut points = Points {
        path,
        scale,
        set: 0,
        toolpath: String::new(),
        nominal: BTreeMap::new(),
        measured: BTreeMap::new(),
        rows: Rows::new(path, &columns),
        missed: 0,
        mislabelled: 0,
    };
    for (index, line) in text.lines().enumerate() {
        points.line(index + 1, line.trim_matches(|it: char| it == '%' || it.is_control() || it.is_whitespace()))?;
    }
    points.finish()
}

impl Points<'_> {
    fn wrong(&self, line: usize, message: impl Into<String>) -> Error {
        Error::data(message).at(self.path, line, None)
    }

    fn line(&mut self, line: usize, content: &str) -> Result<()> {
        let first = content.split_whitespace().next().unwrap_or_default();
        match first {
            "" | "END" => Ok(()),
            "START" => {
                self.close();
                self.set += 1;
                self.toolpath.clear();
                Ok(())
            }
            "TOOLPATHID" | "TOOLPATH" => {
                let name = content[first.len()..].trim();
                if let Some(point) = name.split_whitespace().find(|word| word.contains("G80")) {
                    let error = self.wrong(line, format!("{point} stands in the line of a {first}"));
                    return Err(error.help("each point has a line of its own: was a line end lost?"));
                }
                // One toolpath may be named by both lines, in either order.
                if first == "TOOLPATHID" || self.toolpath.is_empty() {
                    self.close();
                    self.toolpath = name.to_owned();
                }
                Ok(())
            }
            _ if content.starts_with("G800") || content.starts_with("G801") => self.point(line, content),
            _ if HEADINGS.iter().any(|heading| content.starts_with(heading)) => Ok(()),
            _ => {
                let error = self.wrong(line, format!("`{}` is no line of inspection results", shown(content)));
                Err(error.help("START, TOOLPATHID, .., G330, G331, G800, G801, G802 and END were expected"))
            }
        }
    }

    /// What was not measured before a new set or toolpath begins has missed.
    fn close(&mut self) {
        self.missed += self.nominal.len();
        self.nominal.clear();
        self.measured.clear();
    }

    fn point(&mut self, line: usize, content: &str) -> Result<()> {
        let found = words(&content[4..]).map_err(|(message, column)| {
            Error::data(message).at(self.path, line, Some(column + 4)).help("was the file cut?")
        })?;
        let of = |letter: char| found.iter().find(|word: &&Word| word.letter == letter).map(|word| word.value);
        let needed = |letter: char| {
            of(letter).ok_or_else(|| self.wrong(line, format!("the line has no {letter}: `{}`", shown(content))))
        };
        let number = needed('N')?;
        if number.fract() != 0.0 || !(0.0..4e9).contains(&number) {
            return Err(self.wrong(line, format!("N is {number}; a whole number was expected")));
        }
        let number = number as u32;
        let at = [needed('X')? * self.scale, needed('Y')? * self.scale, needed('Z')? * self.scale];
        let has_normal = ['I', 'J', 'K'].into_iter().all(|letter| of(letter).is_some());
        let is_nominal = content.starts_with("G800");
        match (is_nominal, has_normal, of('R')) {
            (true, true, None) => {
                let normal = [needed('I')?, needed('J')?, needed('K')?];
                self.nominal(line, number, at, normal)
            }
            // Some posts label both lines of a pair G800: the second one is known by its radius.
            (_, false, Some(radius)) => {
                self.mislabelled += usize::from(is_nominal);
                self.measured(line, number, at, radius * self.scale)
            }
            (true, ..) => {
                Err(self.wrong(line, "a G800 has a normal I J K and no R; one of a measured point has R and no normal"))
            }
            (false, ..) => Err(self.wrong(line, "a G801 has the radius R of the tip, and no normal I J K")),
        }
    }

    fn nominal(&mut self, line: usize, number: u32, point: [f64; 3], normal: [f64; 3]) -> Result<()> {
        let length = normal.iter().map(|it| it * it).sum::<f64>().sqrt();
        if (length - 1.0).abs() > NO_UNIT_VECTOR {
            return Err(self.wrong(line, format!("the normal I J K has the length {length:.4}; 1 was expected")));
        }
        let first = self.nominal.get(&number).map(|first| first.line).or_else(|| self.measured.get(&number).copied());
        if let Some(first) = first {
            let error = self.wrong(line, format!("point {number} stands in line {first} already"));
            return Err(error.help("a repeated run begins with START; was the file written twice?"));
        }
        self.nominal.insert(number, Nominal { line, point, normal: normal.map(|it| it / length) });
        Ok(())
    }

    fn measured(&mut self, line: usize, number: u32, centre: [f64; 3], radius: f64) -> Result<()> {
        let Some(nominal) = self.nominal.remove(&number) else {
            let message = match self.measured.get(&number) {
                Some(first) => format!("point {number} is measured in line {first} already"),
                None => format!("point {number} is measured, and has no G800 before"),
            };
            return Err(self.wrong(line, message).help("each G801 follows the G800 of the same N"));
        };
        if !(0.0..1000.0).contains(&radius) {
            return Err(self.wrong(line, format!("the radius R of the tip is {radius} mm")));
        }
        let Nominal { point: [x, y, z], normal: [nx, ny, nz], .. } = nominal;
        let along = (centre[0] - x) * nx + (centre[1] - y) * ny + (centre[2] - z) * nz - radius;
        let away = (0..3).map(|k| (centre[k] - radius * [nx, ny, nz][k] - [x, y, z][k]).powi(2)).sum::<f64>().sqrt();
        if away > FAR {
            let message = format!(
                "point {number} was measured {away:.3} mm away from its nominal point ({along:+.3} mm along the normal); at most {FAR} mm were expected"
            );
            return Err(self.wrong(line, message).help(
                "is a decimal point missing, are the units others, or does the normal point into the material?",
            ));
        }
        let [cx, cy, cz] = centre;
        let labels = [self.set.max(1).to_string(), self.toolpath.clone(), number.to_string()];
        self.rows.push(line, &labels.each_ref().map(String::as_str), &[cx, cy, cz, x, y, z, nx, ny, nz, radius]);
        self.measured.insert(number, line);
        Ok(())
    }

    fn finish(mut self) -> Result<(Dataset, Vec<String>)> {
        self.close();
        let mut remarks = Vec::new();
        if self.missed > 0 {
            remarks.push(format!("{} nominal points (G800) were not measured and are left out", self.missed));
        }
        if self.mislabelled > 0 {
            remarks.push(format!(
                "{} measured points are labelled G800; they are known by R, and taken",
                self.mislabelled
            ));
        }
        Ok((self.rows.finish("measured point (G801)")?, remarks))
    }
}
