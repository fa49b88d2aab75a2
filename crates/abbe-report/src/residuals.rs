//! Residuals of a fit, each with where its row was read; and the table in which they are kept beside the calibration.
//!
//! The page is always made from what the table says, so that it can be made again from the folder of a run.

use std::collections::{BTreeMap, BTreeSet};

use abbe_core::{AxisKind, ColumnHeader, Dataset, Error, Fit, LabelText, Quantity, Result, Values};
use abbe_estimation::residual_rows;

/// Residuals in the order of the equations.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Residuals {
    /// Names of the columns of labels.
    pub labels: Vec<String>,
    /// Names of the axes, and the units of their commands: `mm` or `deg`.
    pub axes: Vec<(String, String)>,
    /// One for each equation of a row that was measured.
    pub rows: Vec<Residual>,
}

/// The residual of an equation.
#[derive(Debug, Clone, PartialEq)]
pub struct Residual {
    /// Artefact stage.
    pub stage: String,
    /// File that the row stands in.
    pub file: String,
    /// Line in the file; 0 in a file that has no lines.
    pub line: usize,
    /// Number of the data row in the file, from 1.
    pub row: usize,
    /// Whether it is of an angle.
    pub is_angle: bool,
    /// The residual, µm or µrad.
    pub value: f64,
    /// Standard uncertainty of the equation, µm or µrad.
    pub uncertainty: f64,
    /// Time of the row, s.
    pub time: Option<f64>,
    /// Tip in the table frame, mm; none for an equation without a pose.
    pub tip: Option<[f64; 3]>,
    /// Unit direction in which the residual grows when the tip moves, table frame; none if it depends on no tip.
    pub direction: Option<[f64; 3]>,
    /// Labels in the order of the columns.
    pub labels: Vec<String>,
    /// Commands of the axes, mm or degrees.
    pub commands: Vec<f64>,
}

impl Residual {
    /// The residual over its standard uncertainty.
    pub fn normalised(&self) -> f64 {
        if self.uncertainty > 0.0 { self.value / self.uncertainty } else { 0.0 }
    }

    /// Where it was read, for people.
    pub fn place(&self) -> String {
        match self.line {
            0 => format!("{} (row {})", self.file, self.row),
            line => format!("{}:{line} (row {})", self.file, self.row),
        }
    }
}

/// Columns of the table that are always there.
const FIXED: [&str; 15] = [
    "stage",
    "file",
    "line",
    "row",
    "residual_um",
    "uncertainty_um",
    "residual_urad",
    "uncertainty_urad",
    "time_s",
    "tip_x_mm",
    "tip_y_mm",
    "tip_z_mm",
    "direction_x",
    "direction_y",
    "direction_z",
];

impl Residuals {
    /// The residuals of a fit at its values. Fails where the model fails.
    pub fn of(fit: &Fit) -> Result<Self> {
        let info = fit.problem.model.info();
        let unit = |kind| if kind == AxisKind::Linear { "mm" } else { "deg" };
        let axes = info.axes.iter().map(|axis| (axis.name.clone(), unit(axis.kind).to_owned())).collect();
        let mut found = Self { labels: label_columns(fit), axes, rows: Vec::new() };
        let factor = |kind| if kind == AxisKind::Linear { 1.0 } else { 180.0 / std::f64::consts::PI };
        let factors: Vec<f64> = info.axes.iter().map(|axis| factor(axis.kind)).collect();
        let columns: Vec<Vec<Option<&[LabelText]>>> =
            fit.problem.sets.iter().map(|set| columns_of(&set.info().layout.data, &found.labels)).collect();
        for of_row in residual_rows(fit)? {
            let set = &fit.problem.sets[of_row.set];
            let data = &set.info().layout.data;
            let origin = data.origins[of_row.data_row];
            let factor = if of_row.is_angle { 1e6 } else { 1e3 };
            found.rows.push(Residual {
                stage: set.name.clone(),
                file: data.files[origin.file].display().to_string(),
                line: origin.line,
                row: origin.row,
                is_angle: of_row.is_angle,
                value: of_row.value * factor,
                uncertainty: of_row.uncertainty * factor,
                time: data.numbers("time").map(|times| times[of_row.data_row]),
                tip: of_row.tip,
                direction: of_row.direction,
                labels: columns[of_row.set.0]
                    .iter()
                    .map(|column| column.map_or(String::new(), |cells| cells[of_row.data_row].to_string()))
                    .collect(),
                commands: of_row.commands.iter().zip(&factors).map(|(command, factor)| command * factor).collect(),
            });
        }
        Ok(found)
    }

    /// The table as CSV.
    pub fn to_csv(&self) -> Result<String> {
        let wrong = |error: &dyn std::fmt::Display| Error::data(format!("the residuals cannot be written: {error}"));
        let mut writer = csv::WriterBuilder::new().terminator(csv::Terminator::Any(b'\n')).from_writer(Vec::new());
        let mut header: Vec<String> = FIXED.iter().map(|name| (*name).to_owned()).collect();
        header.extend(self.labels.iter().cloned());
        header.extend(self.axes.iter().map(|(name, unit)| format!("{name}_{unit}")));
        writer.write_record(&header).map_err(|error| wrong(&error))?;
        let mut cells: Vec<String> = Vec::with_capacity(header.len());
        for row in &self.rows {
            cells.clear();
            let sizes = [fixed(row.value, 4), format!("{:.4e}", row.uncertainty)];
            let none = [String::new(), String::new()];
            let (lengths, angles) = if row.is_angle { (none, sizes) } else { (sizes, none) };
            cells.extend([row.stage.clone(), row.file.clone(), row.line.to_string(), row.row.to_string()]);
            cells.extend(lengths.into_iter().chain(angles));
            cells.push(row.time.filter(|time| time.is_finite()).map_or(String::new(), |time| fixed(time, 3)));
            cells.extend([0, 1, 2].map(|part| row.tip.map_or(String::new(), |tip| fixed(tip[part], 4))));
            cells.extend([0, 1, 2].map(|part| row.direction.map_or(String::new(), |to| fixed(to[part], 4))));
            cells.extend(row.labels.iter().cloned());
            cells.extend(row.commands.iter().map(|command| fixed(*command, 5)));
            writer.write_record(&cells).map_err(|error| wrong(&error))?;
        }
        let bytes = writer.into_inner().map_err(|error| wrong(&error))?;
        String::from_utf8(bytes).map_err(|error| wrong(&error))
    }

    /// Reads a table. Fails on text that is no such table, with the line.
    pub fn from_csv(text: &str) -> Result<Self> {
        let mut reader = csv::Reader::from_reader(text.as_bytes());
        let no_table = |error: csv::Error| Error::data(format!("this is no table of residuals: {error}"));
        let headers = reader.headers().map_err(no_table)?.clone();
        if headers.iter().take(FIXED.len()).ne(FIXED) {
            return Err(Error::data(format!(
                "this is no table of residuals: its columns begin with {}",
                FIXED.join(", ")
            )));
        }
        let more = || headers.iter().skip(FIXED.len());
        let is_label = |name: &&str| ColumnHeader::parse(name).quantity == Quantity::Label;
        let labels: Vec<String> = more().take_while(is_label).map(str::to_owned).collect();
        let axis = |name: &str| {
            let (axis, unit) = name.rsplit_once('_').unwrap_or((name, ""));
            (axis.to_owned(), unit.to_owned())
        };
        let axes: Vec<(String, String)> = more().skip(labels.len()).map(axis).collect();
        let mut rows = Vec::new();
        for record in reader.records() {
            let record = record.map_err(no_table)?;
            let line = record.position().map_or(0, csv::Position::line);
            let text = |column: usize| record.get(column).unwrap_or_default();
            let number = |column: usize| {
                text(column).parse::<f64>().map_err(|_| {
                    let name = headers.get(column).unwrap_or_default();
                    Error::data(format!("line {line}: `{}` is no number of `{name}`", text(column)))
                })
            };
            let optional = |column: usize| if text(column).is_empty() { Ok(None) } else { number(column).map(Some) };
            let is_angle = text(4).is_empty();
            let at = if is_angle { 6 } else { 4 };
            let three = |from: usize| -> Result<Option<[f64; 3]>> {
                let parts = [optional(from)?, optional(from + 1)?, optional(from + 2)?];
                Ok(if let [Some(x), Some(y), Some(z)] = parts { Some([x, y, z]) } else { None })
            };
            let commands = FIXED.len() + labels.len();
            rows.push(Residual {
                stage: text(0).to_owned(),
                file: text(1).to_owned(),
                line: number(2)? as usize,
                row: number(3)? as usize,
                is_angle,
                value: number(at)?,
                uncertainty: number(at + 1)?,
                time: optional(8)?,
                tip: three(9)?,
                direction: three(12)?,
                labels: (0..labels.len()).map(|label| text(FIXED.len() + label).to_owned()).collect(),
                commands: (0..axes.len()).map(|axis| number(commands + axis)).collect::<Result<_>>()?,
            });
        }
        Ok(Self { labels, axes, rows })
    }

    /// From where to where each axis went, in mm or degrees; none without rows.
    pub fn travel(&self, axis: &str) -> Option<[f64; 2]> {
        let column = self.axes.iter().position(|(name, _)| name == axis)?;
        let positions = self.rows.iter().map(|row| row.commands[column]).filter(|position| position.is_finite());
        let range = positions.fold([f64::INFINITY, f64::NEG_INFINITY], |[from, to], at| [from.min(at), to.max(at)]);
        (range[0] <= range[1]).then_some(range)
    }
}

/// A number with so many decimals; zero has no sign.
fn fixed(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

/// Most labels of a column that tell something.
const MOST_LABELS: usize = 500;

/// The columns of labels that group rows, in the order of the data sets.
fn label_columns(fit: &Fit) -> Vec<String> {
    let (mut names, mut seen) = (Vec::new(), BTreeSet::new());
    for set in &fit.problem.sets {
        for column in &set.info().layout.data.columns {
            let Values::Labels(labels) = &column.values else { continue };
            let name = &column.header.name;
            let distinct: BTreeSet<&LabelText> = labels.iter().take(100_000).collect();
            let groups = distinct.len() <= MOST_LABELS && (distinct.len() < labels.len() || labels.len() == 1);
            // The file is a column of the table already.
            if groups && !FIXED.contains(&name.as_str()) && seen.insert(name) {
                names.push(name.clone());
            }
        }
    }
    names
}

/// The columns of labels of these names; none for one that the data do not have.
fn columns_of<'a>(data: &'a Dataset, names: &[String]) -> Vec<Option<&'a [LabelText]>> {
    let mut columns: BTreeMap<&str, &[LabelText]> = BTreeMap::new();
    for column in &data.columns {
        if let Values::Labels(labels) = &column.values {
            columns.entry(&column.header.name).or_insert(labels);
        }
    }
    names.iter().map(|name| columns.get(name.as_str()).copied()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Residuals {
        let row = |value: f64, is_angle| Residual {
            stage: "table".to_owned(),
            file: "a,b.csv".to_owned(),
            line: 3,
            row: 2,
            is_angle,
            value,
            uncertainty: 1.6,
            time: Some(40.5),
            tip: (!is_angle).then_some([1.0, -2.5, 0.0]),
            direction: (!is_angle).then_some([0.0, -0.6, 0.8]),
            labels: vec!["a \"quoted\"\nlabel".to_owned()],
            commands: vec![-179.1025, f64::NAN],
        };
        let axes = [("X", "mm"), ("B", "deg")].map(|(name, unit)| (name.to_owned(), unit.to_owned())).to_vec();
        Residuals { labels: vec!["feature".to_owned()], axes, rows: vec![row(-4.25, false), row(0.5, true)] }
    }

    #[test]
    fn what_is_written_is_read() {
        let text = table().to_csv().unwrap();
        let read = Residuals::from_csv(&text).unwrap();
        // NaN is not equal to itself.
        assert_eq!(format!("{read:?}"), format!("{:?}", table()));
        assert_eq!(read.to_csv().unwrap(), text);
        assert_eq!((read.travel("X"), read.travel("B"), read.travel("C")), (Some([-179.1025; 2]), None, None));
    }

    #[test]
    fn what_is_no_table_is_refused() {
        assert!(Residuals::from_csv("a,b\n1,2\n").unwrap_err().message.contains("no table of residuals"));
        let text = table().to_csv().unwrap().replace("-4.25", "four");
        assert_eq!(Residuals::from_csv(&text).unwrap_err().message, "line 2: `four` is no number of `residual_um`");
    }
}
