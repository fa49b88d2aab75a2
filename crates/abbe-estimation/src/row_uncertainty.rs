//! The uncertainty of an artefact's rows as its settings state it: standard uncertainties and covariances.

use std::collections::BTreeMap;

use abbe_core::{
    CovarianceBlock, DataRow, Dataset, EquationUncertainty, Error, Label, LabelText, Layout, LayoutEquation, Names,
    Observations, PathItem, Quantity, Result, Row, RowIndex, SettingsError, Values, positive,
};
use nalgebra::DMatrix;

use crate::row_settings::{Ids, RowSettings, RowUncertainty, SharedError};

/// Refuses settings that contradict each other, numbers that are no standard uncertainties, and ids without a letter.
pub fn check(settings: &RowSettings) -> Result<(), SettingsError> {
    let ids: Vec<&Label> = match &settings.id {
        None => Vec::new(),
        Some(Ids::All(id)) => vec![id],
        Some(Ids::Of(map)) => map.values().collect(),
    };
    if ids.iter().any(|id| id.0.trim().is_empty()) {
        return Err(SettingsError::new("id", "a text was expected: a serial number, or the number of a certificate"));
    }
    let Some(rows) = &settings.uncertainty else { return Ok(()) };
    let at = |error: SettingsError| error.under([PathItem::Key("uncertainty".to_owned())]);
    check_rows(rows).map_err(at)
}

/// The settings for equations of one quantity.
struct Stated<'a> {
    quantity: Quantity,
    /// In words.
    name: &'static str,
    /// Unit of the settings.
    unit: &'static str,
    /// Factor from their unit to the unit in memory.
    factor: f64,
    standard: &'a BTreeMap<String, f64>,
    directions: &'a [f64],
    row_covariance: &'a [Vec<f64>],
}

impl Stated<'_> {
    fn setting(&self, name: &str) -> String {
        format!("{name}_{}", self.unit)
    }

    /// The equations of a row that are of this quantity.
    fn members(&self, row: &Row, quantities: &[Quantity]) -> Vec<LayoutEquation> {
        row.equation_indices().filter(|&equation| quantities[equation] == self.quantity).collect()
    }

    /// Covariance of the equations of a row, mm² or rad².
    fn covariance(&self) -> Result<DMatrix<f64>> {
        let size = self.row_covariance.len();
        if let Some(row) = self.row_covariance.iter().find(|row| row.len() != size) {
            return Err(Error::data(format!("a row has {} numbers; {size} were expected", row.len())));
        }
        let equations: Vec<usize> = (0..size).collect();
        let matrix = DMatrix::from_fn(size, size, |row, column| self.row_covariance[row][column]);
        // Checked in the unit of the settings, so that messages show the given numbers.
        let block = CovarianceBlock::new("one row", &equations, &matrix)?;
        Ok(block.covariance * self.factor.powi(2))
    }

    /// Fails if no equation is of this quantity.
    fn require(&self, setting: &str, quantities: &[Quantity]) -> Result<()> {
        if quantities.contains(&self.quantity) {
            return Ok(());
        }
        let message = format!("{setting} states {}, but no equation of this artefact is one", self.name);
        Err(Error::data(message).setting("uncertainty"))
    }

    /// Fails if `given` numbers are not as many as the `members` of a row.
    fn directions(&self, setting: &str, given: usize, members: usize, row: &Row) -> Result<()> {
        if given == members {
            return Ok(());
        }
        let name = self.name;
        let mut error = Error::data(format!(
            "`{setting}` is for {given} {name}, but a row of this artefact has {members} equations that are {name}"
        ));
        let others = row.equations - members;
        if members > 0 && others > 0 {
            error = error.help(format!(
                "state its {others} other equations in their own unit, those of lengths with `_um`, those of angles with `_urad`"
            ));
        }
        Err(error.setting("uncertainty"))
    }
}

/// Standard uncertainty of the error of a quantity.
fn shared_of(error: &SharedError, quantity: Quantity) -> Option<f64> {
    if quantity == Quantity::Angle { error.standard_uncertainty_urad } else { error.standard_uncertainty_um }
}

/// The quantity of every equation of observations.
fn quantities(observations: &dyn Observations) -> Vec<Quantity> {
    let rows = RowIndex::enumerate(&observations.info().layout.rows);
    rows.flat_map(|(index, row)| (0..row.equations).map(move |equation| observations.info().quantity(index, equation)))
        .collect()
}

fn stated(rows: &RowUncertainty) -> [Stated<'_>; 2] {
    [
        Stated {
            quantity: Quantity::Length,
            name: "lengths",
            unit: "um",
            factor: 1e-3,
            standard: &rows.standard_um,
            directions: &rows.directions_um,
            row_covariance: &rows.row_covariance_um2,
        },
        Stated {
            quantity: Quantity::Angle,
            name: "angles",
            unit: "urad",
            factor: 1e-6,
            standard: &rows.standard_urad,
            directions: &rows.directions_urad,
            row_covariance: &rows.row_covariance_urad2,
        },
    ]
}

fn has_row_covariance(rows: &RowUncertainty) -> bool {
    !(rows.row_covariance_um2.is_empty() && rows.row_covariance_urad2.is_empty())
}

fn check_rows(rows: &RowUncertainty) -> Result<(), SettingsError> {
    let wrong = |name: &str, message: &str| Err(SettingsError::new(name, message));
    let directions = !(rows.directions_um.is_empty() && rows.directions_urad.is_empty());
    let ways = [rows.column.is_some(), rows.by.is_some(), directions, rows.covariance.is_some()];
    if ways.iter().filter(|given| **given).count() > 1 {
        return wrong("", "one of `column`, `by`, `directions_um` (`_urad`) and `covariance` was expected");
    }
    if rows.by.is_some() == (rows.standard_um.is_empty() && rows.standard_urad.is_empty()) {
        let message =
            "`by` and `standard_um` (`standard_urad`) belong together: a label column, and numbers for its labels";
        return wrong("", message);
    }
    if rows.covariance.is_some() && (has_row_covariance(rows) || !rows.shared.is_empty()) {
        return wrong("covariance", "a full covariance leaves nothing to add: leave out the other covariances");
    }
    for stated in stated(rows) {
        let key = |name: &str| PathItem::Key(stated.setting(name));
        for (label, value) in stated.standard {
            positive(label, *value).map_err(|error| error.under([key("standard")]))?;
        }
        for (index, value) in stated.directions.iter().enumerate() {
            if !(*value > 0.0 && value.is_finite()) {
                let error = SettingsError::new("", format!("{value}: a positive number was expected"));
                return Err(error.under([key("directions"), PathItem::Index(index)]));
            }
        }
        if !stated.row_covariance.is_empty() {
            let name = stated.setting("row_covariance") + "2";
            stated.covariance().map_err(|error| SettingsError::new(&name, error.message))?;
        }
    }
    for (index, shared) in rows.shared.iter().enumerate() {
        let under = |error: SettingsError| error.under([PathItem::Key("shared".to_owned()), PathItem::Index(index)]);
        let mut given = false;
        for stated in stated(rows) {
            let Some(value) = shared_of(shared, stated.quantity) else { continue };
            positive(&stated.setting("standard_uncertainty"), value).map_err(under)?;
            given = true;
        }
        if !given {
            let message = "`standard_uncertainty_um` or `standard_uncertainty_urad` was expected";
            return Err(under(SettingsError::new("", message)));
        }
    }
    Ok(())
}

/// The uncertainty of the rows of observations by these settings; `covariance` is the file that they name.
///
/// Fails on columns and labels that are not there, on numbers that are no uncertainties, on lengths for angles and angles
/// for lengths, and on matrices that are no covariance of these rows.
pub fn of_rows(
    rows: &RowUncertainty,
    observations: &dyn Observations,
    covariance: Option<&Dataset>,
) -> Result<EquationUncertainty> {
    let (layout, quantities) = (&observations.info().layout, quantities(observations));
    let mut uncertainty = EquationUncertainty::independent(layout.standard_uncertainties.clone());
    if let Some(covariance) = covariance {
        return full(layout, &quantities, covariance);
    }
    set_standard(rows, layout, &quantities, &mut uncertainty.standard)?;
    if rows.shared.is_empty() && !has_row_covariance(rows) {
        return Ok(uncertainty);
    }
    let parts = covariances(rows, layout, &quantities, &uncertainty.standard)?;
    let joined = components(uncertainty.standard.len(), &parts);
    for (index, members) in joined.iter().enumerate() {
        let place: BTreeMap<LayoutEquation, usize> =
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

/// The columns with standard uncertainties, at most one of each quantity.
fn columns<'a>(rows: &RowUncertainty, data: &'a Dataset) -> Result<Vec<(Quantity, &'a [f64])>> {
    let mut columns: Vec<(Quantity, &[f64])> = Vec::new();
    for name in rows.column.iter().flat_map(Names::as_slice) {
        let numbers = data.required_numbers(name).map_err(|error| error.setting("uncertainty"))?;
        let wrong = |message: String| Err(Error::data(message).setting("uncertainty"));
        match data.column(name).map(|column| column.header.quantity) {
            Some(quantity @ (Quantity::Length | Quantity::Angle)) => {
                if columns.iter().any(|(other, _)| *other == quantity) {
                    return wrong(format!("`{name}` is a second column of the same quantity; one was expected"));
                }
                columns.push((quantity, numbers));
            }
            _ => return wrong(format!("the column `{name}` holds neither lengths nor angles")),
        }
    }
    Ok(columns)
}

fn set_standard(rows: &RowUncertainty, layout: &Layout, quantities: &[Quantity], standard: &mut [f64]) -> Result<()> {
    let data = &layout.data;
    let columns = columns(rows, data)?;
    let labels = rows.by.as_deref().map(|by| labels(data, by)).transpose()?;
    for stated in stated(rows) {
        let numbers = columns.iter().find(|(quantity, _)| *quantity == stated.quantity).map(|(_, numbers)| *numbers);
        if numbers.is_some() {
            stated.require("`column`", quantities)?;
        }
        if !stated.standard.is_empty() {
            stated.require(&format!("`{}`", stated.setting("standard")), quantities)?;
        }
        if let Some(labels) = &labels
            && let Some(label) = stated.standard.keys().find(|label| !labels.iter().any(|own| own == *label))
        {
            let message = format!("`{}` names `{label}`, which is in no row", stated.setting("standard"));
            let error = Error::data(message).suggest(label, labels.iter().map(LabelText::as_str));
            return Err(error.setting("uncertainty"));
        }
        for row in &layout.rows {
            let Some(data_row) = row.data_row else { continue };
            let members = stated.members(row, quantities);
            let mut set = |value: f64| members.iter().for_each(|&equation| standard[equation] = value);
            if let Some(value) = numbers.map(|numbers| numbers[data_row]) {
                if !(value > 0.0 && value.is_finite()) {
                    let unit = if stated.quantity == Quantity::Angle { "rad" } else { "mm" };
                    let message = format!("the standard uncertainty {value} {unit} of this row is not positive");
                    return Err(data.error_at(data_row, message));
                }
                set(value);
            }
            if let Some(value) = labels.as_ref().and_then(|labels| stated.standard.get(labels[data_row].as_str())) {
                set(value * stated.factor);
            }
            if !stated.directions.is_empty() {
                let setting = stated.setting("directions");
                stated.directions(&setting, stated.directions.len(), members.len(), row)?;
                for (&equation, value) in members.iter().zip(stated.directions) {
                    standard[equation] = value * stated.factor;
                }
            }
        }
    }
    Ok(())
}

/// The covariances whose sum is the total: of every single equation or row, and of shared errors.
fn covariances(
    rows: &RowUncertainty,
    layout: &Layout,
    quantities: &[Quantity],
    standard: &[f64],
) -> Result<Vec<(Vec<LayoutEquation>, Part)>> {
    let mut parts = Vec::new();
    for stated in stated(rows) {
        let of_row = (!stated.row_covariance.is_empty()).then(|| stated.covariance()).transpose()?;
        for row in &layout.rows {
            let members = stated.members(row, quantities);
            match &of_row {
                Some(covariance) if row.data_row.is_some() => {
                    let setting = stated.setting("row_covariance") + "2";
                    stated.directions(&setting, covariance.nrows(), members.len(), row)?;
                    parts.push((members, Part::Matrix(covariance.clone())));
                }
                _ => {
                    let own = |equation: LayoutEquation| (vec![equation], Part::Same(standard[equation].powi(2)));
                    parts.extend(members.into_iter().map(own));
                }
            }
        }
        for shared in &rows.shared {
            let Some(value) = shared_of(shared, stated.quantity) else { continue };
            stated.require("`shared`", quantities)?;
            let labels = labels(&layout.data, &shared.by)?;
            let mut groups: BTreeMap<(&str, usize), Vec<LayoutEquation>> = BTreeMap::new();
            for row in &layout.rows {
                let Some(data_row) = row.data_row else { continue };
                for (direction, equation) in stated.members(row, quantities).into_iter().enumerate() {
                    groups.entry((&labels[data_row], direction)).or_default().push(equation);
                }
            }
            let variance = (value * stated.factor).powi(2);
            parts.extend(groups.into_values().map(|equations| (equations, Part::Same(variance))));
        }
    }
    Ok(parts)
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

fn labels<'a>(data: &'a Dataset, name: &str) -> Result<&'a [LabelText]> {
    data.required_labels(name).map_err(|error| error.setting("uncertainty"))
}

/// Groups of equations that are correlated by the parts, each list ascending.
fn components(equations: usize, parts: &[(Vec<LayoutEquation>, Part)]) -> Vec<Vec<LayoutEquation>> {
    let mut root: Vec<LayoutEquation> = LayoutEquation::first(equations).collect();
    fn find(root: &mut [LayoutEquation], mut at: LayoutEquation) -> LayoutEquation {
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
    let mut lists: BTreeMap<LayoutEquation, Vec<LayoutEquation>> = BTreeMap::new();
    for equation in LayoutEquation::first(equations) {
        let first = find(&mut root, equation);
        lists.entry(first).or_default().push(equation);
    }
    lists.into_values().collect()
}

/// The full covariance of all measured rows from a table whose first column and headers name their equations: by the row's
/// label, with `.1`, `.2`, ... where a row has several. Constraints that are not measured keep their own uncertainty.
fn full(layout: &Layout, quantities: &[Quantity], table: &Dataset) -> Result<EquationUncertainty> {
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
    if quantities.contains(&Quantity::Angle) {
        return Err(wrong("rows with angles take no full covariance".to_owned()));
    }
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
    let (mut places, mut equations) = (Vec::new(), Vec::new());
    for row in &layout.rows {
        let Some(data_row) = row.data_row else { continue };
        for equation in 0..row.equations {
            let label = match row.equations {
                1 => of_rows[data_row].to_string(),
                _ => format!("{}.{}", of_rows[data_row], equation + 1),
            };
            let (line, column) =
                (lines.iter().position(|line| *line == label), headers.iter().position(|line| *line == label));
            let (Some(line), Some(column)) = (line, column) else {
                return Err(wrong(format!("the covariance has no row and column for {} {label}", first.header.name)));
            };
            places.push((line, column));
            equations.push(row.first_equation + equation);
        }
    }
    let mut numbers = Vec::new();
    for column in columns {
        numbers.push(match &column.values {
            Values::Numbers(numbers) => numbers.clone(),
            // `_um2` is no unit of a quantity, so the cells were read as text.
            Values::Labels(cells) => DataRow::enumerate(cells)
                .map(|(row, cell)| {
                    cell.trim().parse().map_err(|_| table.error_at(row, format!("`{cell}` is not a number")))
                })
                .collect::<Result<Vec<f64>>>()?,
        });
    }
    let size = places.len();
    let matrix = DMatrix::from_fn(size, size, |row, column| numbers[places[column].1][places[row].0]);
    // Checked in µm², so that messages show the numbers of the file.
    let mut block = CovarianceBlock::new("the rows", &equations, &matrix).map_err(|error| wrong(error.message))?;
    block.covariance *= 1e-6;
    let mut standard = layout.standard_uncertainties.clone();
    for (row, &equation) in block.equations.iter().enumerate() {
        standard[equation] = block.covariance[(row, row)].sqrt();
    }
    Ok(EquationUncertainty { standard, blocks: vec![block], pooled: None })
}
