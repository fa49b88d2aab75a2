//! Uncertainties and covariance of a list of values, as D-SI 2.1 and D-SI 2.2 name them.

use crate::contents::{number, plain};
use crate::element::Element;
use crate::settings::Version;
use crate::units::product;

/// What is stated of the uncertainty of values.
pub struct Stated<'a, C> {
    /// Units of the values.
    pub units: &'a [String],
    /// Expanded uncertainties, and the coverage factor of each.
    pub expanded: Vec<f64>,
    pub factors: Vec<f64>,
    /// The covariance of two values, by their numbers.
    pub covariance: C,
    /// The coverage factor of the ellipsoid.
    pub joint: f64,
    /// The coverage probability of all.
    pub probability: f64,
}

/// An element with a list, separated by space.
pub fn listed(name: &str, cells: impl Iterator<Item = String>) -> Element {
    Element::text(name, cells.collect::<Vec<_>>().join(" "))
}

impl<C: Fn(usize, usize) -> f64> Stated<'_, C> {
    /// The elements behind values and units.
    pub fn elements(&self, version: Version) -> Vec<Element> {
        match version {
            Version::Dcc321 => vec![
                Element::of("si:expandedUncXMLList", self.univariate("si:uncertaintyXMLList")),
                Element::of("si:ellipsoidalRegionXMLList", self.region()),
            ],
            Version::Dcc330 => {
                let expanded = Element::of("si:expandedMUXMLList", self.univariate("si:valueExpandedMUXMLList"));
                let region = Element::of("si:ellipsoidalRegionMUXMLList", self.region_of_lists());
                vec![
                    Element::of("si:measurementUncertaintyUnivariateXMLList", vec![expanded]),
                    Element::of("si:measurementUncertaintyMultivariateXMLList", vec![region]),
                ]
            }
        }
    }

    fn univariate(&self, uncertainty: &str) -> Vec<Element> {
        vec![
            listed(uncertainty, self.expanded.iter().copied().map(number)),
            listed("si:coverageFactorXMLList", self.factors.iter().copied().map(plain)),
            listed("si:coverageProbabilityXMLList", self.factors.iter().map(|_| plain(self.probability))),
        ]
    }

    fn count(&self) -> usize {
        self.units.len()
    }

    /// Value and unit of the entries of a column.
    fn entries(&self, column: usize) -> impl Iterator<Item = (String, String)> {
        let entry =
            move |row: usize| (number((self.covariance)(row, column)), product(&self.units[row], &self.units[column]));
        (0..self.count()).map(entry)
    }

    /// The ellipsoid with an element for each covariance.
    fn region(&self) -> Vec<Element> {
        let column = |column: usize| {
            let entry = |(value, unit): (String, String)| {
                let entry = vec![Element::text("si:value", value), Element::text("si:unit", unit)];
                Element::of("si:covariance", entry)
            };
            Element::of("si:column", self.entries(column).map(entry).collect())
        };
        vec![
            Element::of("si:covarianceMatrix", (0..self.count()).map(column).collect()),
            Element::text("si:coverageFactor", plain(self.joint)),
            Element::text("si:coverageProbability", plain(self.probability)),
        ]
    }

    /// The ellipsoid with lists in each column.
    fn region_of_lists(&self) -> Vec<Element> {
        let column = |column: usize| {
            let (values, units): (Vec<String>, Vec<String>) = self.entries(column).unzip();
            let lists =
                vec![listed("si:valueXMLList", values.into_iter()), listed("si:unitXMLList", units.into_iter())];
            Element::of("si:columnXMLList", vec![Element::of("si:covarianceXMLList", lists)])
        };
        vec![
            Element::of("si:covarianceMatrixXMLList", (0..self.count()).map(column).collect()),
            Element::text("si:coverageFactorXMLList", plain(self.joint)),
            Element::text("si:coverageProbabilityXMLList", plain(self.probability)),
        ]
    }
}
