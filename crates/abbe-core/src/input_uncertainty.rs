//! What a recipe says about the uncertainty of an artefact's rows: settings that are the same for all artefacts.

use std::collections::BTreeMap;

use nalgebra::DMatrix;
use schemars::JsonSchema;
use serde::Deserialize;

use crate::dataset::{Dataset, Values};
use crate::error::{Error, Result};
use crate::observations::Layout;
use crate::settings::{PathItem, SettingsError, positive};
use crate::uncertainty::{CovarianceBlock, EquationUncertainty, Pooled};

/// The uncertainty of an artefact's rows, beyond the one number that the artefact itself takes.
#[derive(Debug, Clone, PartialEq, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct InputUncertainty {
    /// Standard uncertainties and covariances of rows. They weigh.
    #[serde(default)]
    pub uncertainty: Option<RowUncertainty>,
    /// The scatter of repeats, from rows with the columns `cycle` and `day`. It propagates; it does not weigh.
    #[serde(default)]
    pub pooled: Option<PooledRepeats>,
}

/// Standard uncertainties and covariances of rows.
#[derive(Debug, Clone, PartialEq, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RowUncertainty {
    /// Column (name without unit) with the standard uncertainty of every row.
    #[serde(default)]
    pub column: Option<String>,
    /// Label column by which `standard_um` gives standard uncertainties: feature, group, direction.
    #[serde(default)]
    pub by: Option<String>,
    /// Standard uncertainty of the rows with a label; rows with other labels keep theirs.
    #[serde(default)]
    pub standard_um: BTreeMap<String, f64>,
    /// Standard uncertainty of each equation of a row: of a ball centre along x, y, z.
    #[serde(default)]
    pub directions_um: Vec<f64>,
    /// Covariance of the equations of every row with each other.
    #[serde(default)]
    pub row_covariance_um2: Vec<Vec<f64>>,
    /// Errors that all rows with the same label share.
    #[serde(default)]
    pub shared: Vec<SharedError>,
    /// CSV file with the full covariance of all rows, `touch,1_um2,2_um2,...`: the first column has the labels of the rows in
    /// a column of the data of that name, and so has the header.
    #[serde(default)]
    pub covariance: Option<String>,
}

/// An error that all rows with the same label share, beside their own.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SharedError {
    /// The label column.
    pub by: String,
    /// Standard uncertainty of the shared error.
    pub standard_uncertainty_um: f64,
}

/// How repeats are pooled (Rahman 2016, section 5.6).
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PooledRepeats {
    /// `cycle`: what differs between days at the same cycle counts, what changes in the course of a day does not. `day`:
    /// what differs between the cycles of a day counts, what changes from day to day does not. Without it all repeats are
    /// one group.
    #[serde(default)]
    pub by: Option<String>,
}

/// The columns that tell repetitions apart.
const REPETITION: [&str; 2] = ["day", "cycle"];

impl InputUncertainty {
    /// Refuses settings that contradict each other, and numbers that are no standard uncertainties.
    pub fn check(&self) -> Result<(), SettingsError> {
        let Some(rows) = &self.uncertainty else { return Ok(()) };
        let at = |error: SettingsError| error.under([PathItem::Key("uncertainty".to_owned())]);
        rows.check().map_err(at)
    }
}

impl RowUncertainty {
    fn check(&self) -> Result<(), SettingsError> {
        let wrong = |name: &str, message: &str| Err(SettingsError::new(name, message));
        let ways =
            [self.column.is_some(), self.by.is_some(), !self.directions_um.is_empty(), self.covariance.is_some()];
        if ways.iter().filter(|given| **given).count() > 1 {
            return wrong("", "one of `column`, `by`, `directions_um` and `covariance` was expected");
        }
        if self.by.is_some() == self.standard_um.is_empty() {
            return wrong("", "`by` and `standard_um` belong together: a label column, and numbers for its labels");
        }
        if self.covariance.is_some() && !(self.shared.is_empty() && self.row_covariance_um2.is_empty()) {
            return wrong("covariance", "a full covariance leaves nothing to add: leave out the other covariances");
        }
        for (label, value) in &self.standard_um {
            let under = |error: SettingsError| error.under([PathItem::Key("standard_um".to_owned())]);
            positive(label, *value).map_err(under)?;
        }
        for (index, value) in self.directions_um.iter().enumerate() {
            if !(*value > 0.0 && value.is_finite()) {
                let error = SettingsError::new("", format!("{value}: a positive number was expected"));
                return Err(error.under([PathItem::Key("directions_um".to_owned()), PathItem::Index(index)]));
            }
        }
        for (index, shared) in self.shared.iter().enumerate() {
            let under =
                |error: SettingsError| error.under([PathItem::Key("shared".to_owned()), PathItem::Index(index)]);
            positive("standard_uncertainty_um", shared.standard_uncertainty_um).map_err(under)?;
        }
        if !self.row_covariance_um2.is_empty() {
            self.row_covariance().map_err(|error| SettingsError::new("row_covariance_um2", error.message))?;
        }
        Ok(())
    }

    /// Covariance of the equations of a row, mm².
    fn row_covariance(&self) -> Result<CovarianceBlock> {
        let rows = &self.row_covariance_um2;
        let size = rows.len();
        if let Some(row) = rows.iter().find(|row| row.len() != size) {
            return Err(Error::data(format!("a row has {} numbers; {size} were expected", row.len())));
        }
        let equations: Vec<usize> = (0..size).collect();
        CovarianceBlock::new(
            "one row",
            &equations,
            &DMatrix::from_fn(size, size, |row, column| rows[row][column] * 1e-6),
        )
    }

    /// What these settings say of the rows of a layout; `covariance` is the file that they name.
    ///
    /// Fails on columns and labels that are not there, on numbers that are no uncertainties, and on matrices that are no
    /// covariance of these rows.
    pub fn of_rows(&self, layout: &Layout, covariance: Option<&Dataset>) -> Result<EquationUncertainty> {
        let mut uncertainty = EquationUncertainty::independent(layout.standard_uncertainties.clone());
        if let Some(covariance) = covariance {
            return full(layout, covariance);
        }
        self.set_standard(layout, &mut uncertainty.standard)?;
        if self.shared.is_empty() && self.row_covariance_um2.is_empty() {
            return Ok(uncertainty);
        }
        let parts = self.covariances(layout, &uncertainty.standard)?;
        let joined = components(uncertainty.standard.len(), &parts);
        for (index, members) in joined.iter().enumerate() {
            let place: BTreeMap<usize, usize> =
                members.iter().enumerate().map(|(row, member)| (*member, row)).collect();
            let mut matrix = DMatrix::<f64>::zeros(members.len(), members.len());
            for (equations, part) in parts.iter().filter(|(equations, _)| place.contains_key(&equations[0])) {
                for (row, one) in equations.iter().enumerate() {
                    for (column, other) in equations.iter().enumerate() {
                        matrix[(place[one], place[other])] += part.at(row, column);
                    }
                }
            }
            for (row, &equation) in members.iter().enumerate() {
                uncertainty.standard[equation] = matrix[(row, row)].sqrt();
            }
            if members.len() > 1 {
                let name = format!("correlated rows {}", index + 1);
                uncertainty.blocks.push(CovarianceBlock::new(&name, members, &matrix)?);
            }
        }
        Ok(uncertainty)
    }

    fn set_standard(&self, layout: &Layout, standard: &mut [f64]) -> Result<()> {
        let (data, per_row) = (&layout.data, self.directions_um.len());
        let numbers = match &self.column {
            None => None,
            Some(name) => Some(data.required_numbers(name).map_err(|error| error.setting("uncertainty"))?),
        };
        let labels = self.by.as_deref().map(|by| labels(data, by)).transpose()?;
        if let Some(labels) = &labels
            && let Some(label) = self.standard_um.keys().find(|label| !labels.contains(label))
        {
            let message = format!("`standard_um` names `{label}`, which is in no row");
            return Err(Error::data(message).suggest(label, labels.iter().map(String::as_str)).setting("uncertainty"));
        }
        for row in &layout.rows {
            let Some(data_row) = row.data_row else { continue };
            let equations = &mut standard[row.first_equation..row.first_equation + row.equations];
            if let Some(numbers) = numbers {
                let value = numbers[data_row];
                if !(value > 0.0 && value.is_finite()) {
                    let message = format!("the standard uncertainty {value} mm of this row is not positive");
                    return Err(data.error_at(data_row, message));
                }
                equations.fill(value);
            }
            if let Some(value) = labels.as_ref().and_then(|labels| self.standard_um.get(&labels[data_row])) {
                equations.fill(value * 1e-3);
            }
            if per_row > 0 {
                if equations.len() != per_row {
                    return Err(directions("directions_um", per_row, equations.len()));
                }
                equations.iter_mut().zip(&self.directions_um).for_each(|(to, value)| *to = value * 1e-3);
            }
        }
        Ok(())
    }

    /// The covariances that add up: of every equation or row by itself, and of what is shared.
    fn covariances(&self, layout: &Layout, standard: &[f64]) -> Result<Vec<(Vec<usize>, Part)>> {
        let mut parts = Vec::new();
        let size = self.row_covariance_um2.len();
        for row in &layout.rows {
            let equations: Vec<usize> = (row.first_equation..row.first_equation + row.equations).collect();
            if size == 0 || row.data_row.is_none() {
                parts
                    .extend(equations.iter().map(|&equation| (vec![equation], Part::Same(standard[equation].powi(2)))));
            } else if size == row.equations {
                parts.push((equations, Part::Matrix(self.row_covariance()?.covariance)));
            } else {
                return Err(directions("row_covariance_um2", size, row.equations));
            }
        }
        for shared in &self.shared {
            let labels = labels(&layout.data, &shared.by)?;
            let mut groups: BTreeMap<(&str, usize), Vec<usize>> = BTreeMap::new();
            for row in &layout.rows {
                let Some(data_row) = row.data_row else { continue };
                for direction in 0..row.equations {
                    let group = groups.entry((&labels[data_row], direction)).or_default();
                    group.push(row.first_equation + direction);
                }
            }
            let variance = (shared.standard_uncertainty_um * 1e-3).powi(2);
            parts.extend(groups.into_values().map(|equations| (equations, Part::Same(variance))));
        }
        Ok(parts)
    }
}

/// A covariance of some equations.
enum Part {
    /// The same number for all pairs: a common error.
    Same(f64),
    /// A matrix.
    Matrix(DMatrix<f64>),
}

impl Part {
    fn at(&self, row: usize, column: usize) -> f64 {
        match self {
            Self::Same(value) => *value,
            Self::Matrix(matrix) => matrix[(row, column)],
        }
    }
}

fn directions(setting: &str, given: usize, equations: usize) -> Error {
    let message =
        format!("`{setting}` is for {given} directions, but a row of this artefact has {equations} equations");
    Error::data(message).setting("uncertainty")
}

fn labels<'a>(data: &'a Dataset, name: &str) -> Result<&'a [String]> {
    data.required_labels(name).map_err(|error| error.setting("uncertainty"))
}

/// Equations that parts tie together, each list ascending.
fn components(equations: usize, parts: &[(Vec<usize>, Part)]) -> Vec<Vec<usize>> {
    let mut root: Vec<usize> = (0..equations).collect();
    fn find(root: &mut [usize], mut at: usize) -> usize {
        while root[at] != at {
            root[at] = root[root[at]];
            at = root[at];
        }
        at
    }
    for (members, _) in parts {
        for &member in &members[1..] {
            let (one, other) = (find(&mut root, members[0]), find(&mut root, member));
            root[one.max(other)] = one.min(other);
        }
    }
    let mut lists: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for equation in 0..equations {
        let first = find(&mut root, equation);
        lists.entry(first).or_default().push(equation);
    }
    lists.into_values().collect()
}

/// The full covariance of all measured rows from a table whose first column and headers are the rows' labels.
fn full(layout: &Layout, table: &Dataset) -> Result<EquationUncertainty> {
    let wrong = |message: String| {
        let error = Error::data(message).setting("uncertainty");
        table.files.first().map_or(error.clone(), |file| error.in_file(file))
    };
    let Some((first, columns)) = table.columns.split_first() else {
        return Err(wrong("the covariance has no columns".to_owned()));
    };
    let Values::Labels(lines) = &first.values else {
        return Err(wrong("the first column of a covariance has labels of rows".to_owned()));
    };
    let of_rows = labels(&layout.data, &first.header.name)?;
    let mut headers = Vec::new();
    for column in columns {
        let Some(label) = column.header.header.strip_suffix("_um2") else {
            return Err(wrong(format!("the column `{}` has no unit _um2", column.header.header)));
        };
        headers.push(label);
    }
    if lines.len() != columns.len() {
        return Err(wrong(format!(
            "the covariance has {} rows and {} columns; as many of both were expected",
            lines.len(),
            columns.len()
        )));
    }
    let mut places = Vec::new();
    for row in &layout.rows {
        let Some(data_row) = row.data_row else {
            return Err(wrong(
                "an artefact with constraints that are not measured takes no full covariance".to_owned(),
            ));
        };
        if row.equations != 1 {
            return Err(wrong(format!("rows with {} equations take no full covariance", row.equations)));
        }
        let label = &of_rows[data_row];
        let (line, column) =
            (lines.iter().position(|line| line == label), headers.iter().position(|line| line == label));
        let (Some(line), Some(column)) = (line, column) else {
            return Err(wrong(format!("the covariance has no row and column for {} {label}", first.header.name)));
        };
        places.push((line, column));
    }
    let mut numbers = Vec::new();
    for column in columns {
        numbers.push(match &column.values {
            Values::Numbers(numbers) => numbers.clone(),
            // A unit that only covariances have: their cells come as text.
            Values::Labels(cells) => cells
                .iter()
                .enumerate()
                .map(|(row, cell)| {
                    cell.trim().parse().map_err(|_| table.error_at(row, format!("`{cell}` is not a number")))
                })
                .collect::<Result<Vec<f64>>>()?,
        });
    }
    let size = places.len();
    let matrix = DMatrix::from_fn(size, size, |row, column| numbers[places[column].1][places[row].0] * 1e-6);
    let equations: Vec<usize> = (0..size).collect();
    let block = CovarianceBlock::new("the rows", &equations, &matrix).map_err(|error| wrong(error.message))?;
    let standard = (0..size).map(|row| block.covariance[(row, row)].sqrt()).collect();
    Ok(EquationUncertainty { standard, blocks: vec![block], pooled: None })
}

/// The rows of a layout by repetition, in the order in which repetitions appear: label, and rows.
fn repetitions(layout: &Layout) -> Result<Vec<(Vec<String>, Vec<usize>)>> {
    let data = &layout.data;
    let columns: Vec<&[String]> = REPETITION.iter().filter_map(|name| data.labels(name)).collect();
    if columns.is_empty() {
        let error = Error::data("the repeats have neither a column `cycle` nor a column `day`").setting("pooled");
        return Err(error);
    }
    let mut all: Vec<(Vec<String>, Vec<usize>)> = Vec::new();
    for (index, row) in layout.rows.iter().enumerate() {
        let Some(data_row) = row.data_row else { continue };
        let label: Vec<String> = columns.iter().map(|column| column[data_row].clone()).collect();
        match all.iter_mut().find(|(other, _)| *other == label) {
            Some((_, rows)) => rows.push(index),
            None => all.push((label, vec![index])),
        }
    }
    Ok(all)
}

impl PooledRepeats {
    /// The scatter of `repeats` (their rows and residuals at nominal values) for the rows of `layout`.
    ///
    /// Every repetition has the rows of the others in the same order; `layout` has one repetition or several. Its scatter is
    /// that of one; several are taken for independent.
    pub fn of_rows(&self, layout: &Layout, repeats: &Layout, residuals: &[f64]) -> Result<Pooled> {
        let known = repetitions(repeats)?;
        let own = match repetitions(layout) {
            Ok(own) => own,
            Err(_) => {
                vec![(Vec::new(), (0..layout.rows.len()).filter(|&row| layout.rows[row].data_row.is_some()).collect())]
            }
        };
        for (_, rows) in known.iter().skip(1) {
            same_rows((repeats, &known[0].1), (repeats, rows))?;
        }
        for (_, rows) in &own {
            same_rows((repeats, &known[0].1), (layout, rows))?;
        }
        let groups = self.groups(repeats, &known)?;
        let count = groups.iter().max().map_or(0, |last| last + 1);
        let degrees_of_freedom = known.len() - count;
        if degrees_of_freedom == 0 {
            let by = self.by.as_deref().unwrap_or("repetition");
            return Err(Error::data(format!(
                "the repeats leave no degrees of freedom: every {by} was measured once only"
            ))
            .help("measure again, or pool by another column")
            .setting("pooled"));
        }
        let values = |rows: &[usize]| -> Vec<f64> {
            let rows = rows.iter().map(|&row| repeats.rows[row]);
            rows.flat_map(|row| residuals[row.first_equation..row.first_equation + row.equations].to_vec()).collect()
        };
        let measured: Vec<Vec<f64>> = known.iter().map(|(_, rows)| values(rows)).collect();
        let deviations: Vec<Vec<f64>> = (0..known.len())
            .map(|repetition| {
                let same: Vec<&Vec<f64>> = (0..known.len())
                    .filter(|&other| groups[other] == groups[repetition])
                    .map(|other| &measured[other])
                    .collect();
                let mean =
                    |equation: usize| same.iter().map(|values| values[equation]).sum::<f64>() / same.len() as f64;
                measured[repetition].iter().enumerate().map(|(equation, value)| value - mean(equation)).collect()
            })
            .collect();
        let mut pooled = Pooled {
            by: self.by.clone().unwrap_or_else(|| "all".to_owned()),
            repetitions: Vec::new(),
            deviations: Vec::new(),
            degrees_of_freedom,
        };
        for (label, rows) in &own {
            for ((of, _), deviation) in known.iter().zip(&deviations) {
                let mut line = vec![0.0; layout.standard_uncertainties.len()];
                let mut values = deviation.iter();
                for row in rows.iter().map(|&row| layout.rows[row]) {
                    line[row.first_equation..row.first_equation + row.equations]
                        .iter_mut()
                        .zip(values.by_ref())
                        .for_each(|(to, value)| *to = *value);
                }
                pooled.repetitions.push(format!("{} <- {}", label.join("."), of.join(".")));
                pooled.deviations.push(line);
            }
        }
        Ok(pooled)
    }

    /// The group of every repetition.
    fn groups(&self, repeats: &Layout, known: &[(Vec<String>, Vec<usize>)]) -> Result<Vec<usize>> {
        let Some(by) = &self.by else { return Ok(vec![0; known.len()]) };
        let present: Vec<&str> =
            REPETITION.iter().copied().filter(|name| repeats.data.labels(name).is_some()).collect();
        let Some(column) = present.iter().position(|name| name == by) else {
            let message = format!("repeats are pooled by {}, not by `{by}`", present.join(" or by "));
            return Err(Error::data(message).setting("pooled"));
        };
        let mut labels: Vec<&str> = Vec::new();
        let groups = known.iter().map(|(label, _)| {
            labels.iter().position(|other| *other == label[column]).unwrap_or_else(|| {
                labels.push(&label[column]);
                labels.len() - 1
            })
        });
        Ok(groups.collect())
    }
}

/// Refuses repetitions whose rows do not measure the same in the same order.
fn same_rows((one, rows): (&Layout, &[usize]), (other, others): (&Layout, &[usize])) -> Result<()> {
    let data_row = |layout: &Layout, row: usize| layout.rows[row].data_row.unwrap_or_default();
    for (&row, &other_row) in rows.iter().zip(others) {
        for name in ["feature", "group"] {
            let (expected, found) = (one.data.labels(name), other.data.labels(name));
            let (Some(expected), Some(found)) = (expected, found) else { continue };
            let (at, other_at) = (data_row(one, row), data_row(other, other_row));
            if expected[at] != found[other_at] {
                let message = format!(
                    "repeats measure the same rows in the same order: {name} {} was expected here, as in the first repetition, not {}",
                    expected[at], found[other_at]
                );
                return Err(other.data.error_at(other_at, message));
            }
        }
    }
    if rows.len() != others.len() {
        let last = others.last().map_or(0, |&row| data_row(other, row));
        let message = format!("a repetition with {} rows ends here; the first one has {}", others.len(), rows.len());
        return Err(other.data.error_at(last, message));
    }
    Ok(())
}
