//! Measured quantities: labels, values, units, uncertainties and covariance.

use abbe_core::Result;
use nalgebra::DMatrix;
use roxmltree::Node;

use crate::MOST_VALUES;
use crate::units::DsiUnit;
use crate::xml::{Xml, child, names, ref_types, shown, text};

/// A quantity of the results, with one value or a list of them.
#[derive(Debug, Clone, PartialEq)]
pub struct Quantity {
    /// Line of the file.
    pub line: usize,
    /// Its names and refTypes.
    pub names: Vec<String>,
    /// The names of the list that it stands in.
    pub(crate) list: Vec<String>,
    /// Labels of the values.
    pub labels: Vec<String>,
    /// Values in the units of memory; as written where the unit is of another kind.
    pub values: Vec<f64>,
    pub(crate) units: Vec<Option<DsiUnit>>,
    /// What is known of their errors, in the units of memory.
    pub uncertainty: Uncertainty,
}

/// What is known of the errors of values.
#[derive(Debug, Clone, PartialEq)]
pub enum Uncertainty {
    /// Nothing.
    None,
    /// Standard uncertainties; nothing is known of correlations.
    Standard(Vec<f64>),
    /// The covariance.
    Covariance(DMatrix<f64>),
}

/// Quantities that are no result of the calibration of the item: what it should be, and by how much it is off.
const OTHERS: [&str; 9] = [
    "basic_nominalValue",
    "basic_measurementError",
    "basic_referenceValue",
    "basic_acceptanceLimitLower",
    "basic_acceptanceLimitUpper",
    "basic_tolerance",
    "basic_toleranceLimitLower",
    "basic_toleranceLimitUpper",
    "basic_calibrationValue",
];

/// Elements in which quantities belong to something else than the item.
const ELSEWHERE: [&str; 5] =
    ["measurementMetaData", "influenceConditions", "usedMethods", "measuringEquipments", "itemQuantities"];

impl Quantity {
    /// The standard uncertainty of a value, in the unit of memory; zero if none is stated.
    pub fn standard_uncertainty(&self, value: usize) -> f64 {
        self.covariance(value, value).sqrt()
    }

    /// The covariance of two values, in the units of memory.
    pub fn covariance(&self, one: usize, other: usize) -> f64 {
        match &self.uncertainty {
            Uncertainty::Standard(all) if one == other => all[one].powi(2),
            Uncertainty::None | Uncertainty::Standard(_) => 0.0,
            Uncertainty::Covariance(matrix) => matrix[(one, other)],
        }
    }
}

impl Xml<'_> {
    /// The quantities of the results, or those of one name or refType.
    pub(crate) fn quantities(&self, root: Node<'_, '_>, chosen: Option<&str>) -> Result<Vec<Quantity>> {
        let results = root.descendants().filter(|node| node.tag_name().name() == "results");
        let nodes = results.flat_map(|node| node.descendants()).filter(|node| {
            node.tag_name().name() == "quantity"
                && !node.ancestors().any(|it| ELSEWHERE.contains(&it.tag_name().name()))
        });
        let mut found = Vec::new();
        let mut count = 0;
        for node in nodes {
            let is_chosen = match chosen {
                Some(chosen) => ref_types(node).chain(names(node)).any(|name| name == chosen),
                None => !ref_types(node).any(|name| OTHERS.contains(&name)),
            };
            if let Some(list) = data(node).filter(|_| is_chosen) {
                let quantity = self.quantity(node, list)?;
                count += quantity.values.len();
                if count > MOST_VALUES {
                    let message =
                        format!("the certificate states more than {MOST_VALUES} values, the most that are read");
                    return Err(self.wrong(node, message).help("name the quantity that counts: `quantity`"));
                }
                found.push(quantity);
            }
        }
        if found.is_empty() {
            let message = match chosen {
                Some(chosen) => format!("the certificate has no quantity with the name or refType `{chosen}`"),
                None => {
                    "the certificate states no value: a dcc:quantity with si:real or si:realListXMLList was expected"
                        .to_owned()
                }
            };
            return Err(self.wrong(root, message));
        }
        Ok(found)
    }

    fn quantity(&self, node: Node<'_, '_>, list: Node<'_, '_>) -> Result<Quantity> {
        let expected =
            |name: &str| self.wrong(list, format!("a <{name}> was expected in <{}>", list.tag_name().name()));
        let written = child(list, &["value", "valueXMLList"]).ok_or_else(|| expected("valueXMLList"))?;
        let mut values = self.numbers(written)?;
        let count = values.len();
        if count == 0 || count > MOST_VALUES {
            return Err(self.wrong(written, format!("{count} values; 1 to {MOST_VALUES} were expected")));
        }
        let unit = child(list, &["unit", "unitXMLList"]).ok_or_else(|| expected("unitXMLList"))?;
        let units: Vec<Option<DsiUnit>> = text(unit).split_whitespace().map(DsiUnit::parse).collect();
        let units = self.spread(unit, units, count)?;
        for (value, unit) in values.iter_mut().zip(&units) {
            *value *= unit.map_or(1.0, |unit| unit.factor);
        }
        let own = ref_types(node).chain(names(node)).map(str::to_owned).collect();
        let parent = node.ancestors().skip(1).find(|it| it.tag_name().name() == "list");
        Ok(Quantity {
            line: self.line(node),
            names: own,
            list: parent.map(|list| names(list).into_iter().map(str::to_owned).collect()).unwrap_or_default(),
            labels: self.labels(node, list, count)?,
            uncertainty: self.uncertainty(list, &units)?,
            values,
            units,
        })
    }

    /// The labels of the values of a quantity: its own, those of the list that it stands in, its name, or their numbers.
    fn labels(&self, node: Node<'_, '_>, list: Node<'_, '_>, count: usize) -> Result<Vec<String>> {
        if let Some(own) = child(list, &["labelXMLList"]) {
            let labels: Vec<String> = text(own).split_whitespace().map(str::to_owned).collect();
            return match labels.len() == count {
                true => Ok(labels),
                false => Err(self.wrong(own, format!("{} labels for {count} values", labels.len()))),
            };
        }
        if let Some(own) = child(list, &["label"]).map(text).filter(|own| count == 1 && !own.is_empty()) {
            return Ok(vec![own.to_owned()]);
        }
        let beside = node.parent().into_iter().flat_map(|it| it.children());
        let beside = beside.filter_map(|it| child(it, &["charsXMLList"])).map(text);
        if let Some(labels) = beside.map(|it| it.split_whitespace().collect::<Vec<_>>()).find(|it| it.len() == count)
            && count > 1
        {
            return Ok(labels.into_iter().map(str::to_owned).collect());
        }
        match names(node).first() {
            Some(name) if count == 1 => Ok(vec![(*name).to_owned()]),
            _ => Ok((1..=count).map(|number| number.to_string()).collect()),
        }
    }

    /// One for each of `count` values: a list of one is for all.
    fn spread<T: Clone>(&self, node: Node<'_, '_>, list: Vec<T>, count: usize) -> Result<Vec<T>> {
        match list.len() {
            1 => Ok(vec![list[0].clone(); count]),
            own if own == count => Ok(list),
            own => {
                let name = node.tag_name().name();
                Err(self.wrong(node, format!("{own} entries in <{name}> for {count} values")))
            }
        }
    }

    fn uncertainty(&self, list: Node<'_, '_>, units: &[Option<DsiUnit>]) -> Result<Uncertainty> {
        let standard = self.standard(list, units)?;
        let matrix = list
            .descendants()
            .find(|node| ["covarianceMatrix", "covarianceMatrixXMLList"].contains(&node.tag_name().name()));
        match (matrix, standard) {
            (Some(matrix), standard) => {
                self.covariance(matrix, units, standard.as_deref()).map(Uncertainty::Covariance)
            }
            (None, Some(standard)) => Ok(Uncertainty::Standard(standard)),
            (None, None) => Ok(Uncertainty::None),
        }
    }

    /// Standard uncertainties in the units of memory, from expanded ones or as stated.
    fn standard(&self, list: Node<'_, '_>, units: &[Option<DsiUnit>]) -> Result<Option<Vec<f64>>> {
        let count = units.len();
        let joint = |node: &Node<'_, '_>| node.tag_name().name().to_lowercase().contains("region");
        let nodes: Vec<Node<'_, '_>> =
            list.descendants().filter(|it| !it.ancestors().take(9).any(|it| joint(&it))).collect();
        let find = |names: &[&str]| nodes.iter().copied().find(|node| names.contains(&node.tag_name().name()));
        let expanded = find(&["uncertainty", "uncertaintyXMLList", "valueExpandedMU", "valueExpandedMUXMLList"]);
        let stated = find(&["standardUnc", "standardUncXMLList", "valueStandardMU", "valueStandardMUXMLList"]);
        let (node, factors) = match (expanded, stated) {
            (Some(node), _) => {
                let factor = node.parent().and_then(|it| child(it, &["coverageFactor", "coverageFactorXMLList"]));
                let factor =
                    factor.ok_or_else(|| self.wrong(node, "the expanded uncertainty has no coverageFactor"))?;
                let factors = self.spread(factor, self.numbers(factor)?, count)?;
                if factors.iter().any(|factor| *factor <= 0.0) {
                    return Err(self.wrong(factor, "a coverage factor above 0 was expected"));
                }
                (node, factors)
            }
            (None, Some(node)) => (node, vec![1.0; count]),
            (None, None) => return Ok(None),
        };
        let mut uncertainties = self.spread(node, self.numbers(node)?, count)?;
        if uncertainties.iter().any(|uncertainty| *uncertainty < 0.0) {
            return Err(self.wrong(node, "an uncertainty of at least 0 was expected"));
        }
        for ((uncertainty, factor), unit) in uncertainties.iter_mut().zip(factors).zip(units) {
            *uncertainty *= unit.map_or(1.0, |unit| unit.factor) / factor;
        }
        Ok(Some(uncertainties))
    }

    /// The covariance in the units of memory.
    fn covariance(
        &self,
        node: Node<'_, '_>,
        units: &[Option<DsiUnit>],
        standard: Option<&[f64]>,
    ) -> Result<DMatrix<f64>> {
        let count = units.len();
        let columns: Vec<Node<'_, '_>> = node.children().filter(Node::is_element).collect();
        let wrong_size = |found: usize| {
            let message = format!("{found} entries where the covariance of {count} values has {count}");
            self.wrong(node, message)
        };
        if columns.len() != count {
            return Err(wrong_size(columns.len()));
        }
        let mut matrix = DMatrix::zeros(count, count);
        for (column, element) in columns.into_iter().enumerate() {
            let mut row = 0;
            for entry in element.children().filter(Node::is_element) {
                let expected = |name: &str| self.wrong(entry, format!("a <{name}> was expected in the covariance"));
                let value = child(entry, &["value", "valueXMLList"]).ok_or_else(|| expected("value"))?;
                let unit = child(entry, &["unit", "unitXMLList"]).ok_or_else(|| expected("unit"))?;
                let values = self.numbers(value)?;
                let written: Vec<&str> = text(unit).split_whitespace().collect();
                let written = self.spread(unit, written, values.len())?;
                for (value, written) in values.into_iter().zip(written) {
                    let place = (row < count).then_some((row, column)).ok_or_else(|| wrong_size(row + 1))?;
                    let product = units[row].zip(units[column]).map(|(one, other)| one.times(other, 1));
                    let factor = match (product, DsiUnit::parse(written)) {
                        (Some(product), Some(unit)) if unit.powers == product.powers => unit.factor,
                        (None, _) => 1.0,
                        _ => {
                            let message = format!("`{}` is no unit of a covariance of these values", shown(written));
                            return Err(self.wrong(unit, message));
                        }
                    };
                    matrix[place] = value * factor;
                    row += 1;
                }
            }
            if row != count {
                return Err(wrong_size(row));
            }
        }
        self.is_covariance(node, &matrix, standard)?;
        Ok(matrix)
    }

    /// Fails unless a matrix is a covariance, and that of the uncertainties that are stated beside it.
    fn is_covariance(&self, node: Node<'_, '_>, matrix: &DMatrix<f64>, standard: Option<&[f64]>) -> Result<()> {
        let of = |row: usize| matrix[(row, row)].max(0.0).sqrt();
        for row in 0..matrix.nrows() {
            if matrix[(row, row)] < 0.0 {
                return Err(self.wrong(node, format!("the variance of value {} is negative", row + 1)));
            }
            if let Some(stated) = standard.map(|standard| standard[row])
                && (stated - of(row)).abs() > 0.02 * of(row).max(stated)
            {
                let message = format!(
                    "the covariance gives value {} the standard uncertainty {:e}, and U / k gives it {stated:e}",
                    row + 1,
                    of(row)
                );
                return Err(self.wrong(node, message).help("ask the laboratory which of them is right"));
            }
            for column in 0..row {
                let (here, there) = (matrix[(row, column)], matrix[(column, row)]);
                let scale = of(row) * of(column);
                if (here - there).abs() > 1e-6 * scale || here.abs() > scale * (1.0 + 1e-6) {
                    let (row, column) = (row + 1, column + 1);
                    let message =
                        format!("the values {row} and {column} have no correlation from -1 to 1, or two of them");
                    return Err(self.wrong(node, message));
                }
            }
        }
        Ok(())
    }
}

/// The element with the values of a quantity; of a quantity in several units the first that is understood.
fn data<'a, 'input>(node: Node<'a, 'input>) -> Option<Node<'a, 'input>> {
    const LISTS: [&str; 2] = ["real", "realListXMLList"];
    let Some(hybrid) = child(node, &["hybrid"]) else { return child(node, &LISTS) };
    let is_understood = |list: &Node<'_, '_>| {
        let unit = child(*list, &["unit", "unitXMLList"]).map(text).unwrap_or_default();
        unit.split_whitespace().next().and_then(DsiUnit::parse).is_some()
    };
    hybrid.children().filter(|it| LISTS.contains(&it.tag_name().name())).find(is_understood)
}
