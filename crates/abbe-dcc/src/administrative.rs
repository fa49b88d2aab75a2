//! Who, what and when, and what has to be known before values are used.

use abbe_core::{Error, Result};
use roxmltree::Node;

use crate::units::DsiUnit;
use crate::xml::{Xml, at, child, children, names, ref_types, shown, text};

/// How far from 20 °C (ISO 1) a calibration may be before it is told, K.
const USUAL_K: f64 = 1.0;

/// Kelvin at 0 °C.
const ZERO_CELSIUS_K: f64 = 273.15;

impl Xml<'_> {
    /// Fails unless the document is a certificate of a version that is read.
    pub(crate) fn is_certificate(&self, root: Node<'_, '_>) -> Result<()> {
        let (name, version) = (root.tag_name().name(), root.attribute("schemaVersion").unwrap_or_default());
        if name == "digitalCalibrationCertificate" && version.starts_with("3.") {
            return Ok(());
        }
        let found = format!("<{} schemaVersion=\"{}\">", shown(name), shown(version));
        let message = format!("the document is {found}; a digitalCalibrationCertificate of version 3 was expected");
        Err(self.wrong(root, message).help("ask the laboratory for a DCC of version 3.2.1 or 3.3.0"))
    }

    /// The number of the certificate.
    pub(crate) fn identifier(&self, root: Node<'_, '_>) -> Result<String> {
        let node = at(root, &["administrativeData", "coreData", "uniqueIdentifier"]);
        let identifier = node.map(text).filter(|text| !text.is_empty());
        identifier
            .map(str::to_owned)
            .ok_or_else(|| Error::data("the certificate has no uniqueIdentifier").in_file(self.file))
    }

    /// The name of the laboratory; empty if it has none.
    pub(crate) fn laboratory(&self, root: Node<'_, '_>) -> String {
        let contact = at(root, &["administrativeData", "calibrationLaboratory", "contact"]);
        contact.and_then(|contact| names(contact).first().copied()).unwrap_or_default().to_owned()
    }

    /// Fails unless the certificate is of the item with this number.
    pub(crate) fn is_of(&self, root: Node<'_, '_>, item: &str) -> Result<()> {
        let items: Vec<Node<'_, '_>> = root.descendants().filter(|node| node.tag_name().name() == "items").collect();
        let numbers: Vec<String> = (items.iter().flat_map(|items| items.descendants()))
            .filter(|node| node.tag_name().name() == "identification")
            .filter_map(|node| child(node, &["value"]).map(text))
            .filter(|number| !number.is_empty())
            .map(shown)
            .collect();
        if numbers.contains(&shown(item)) {
            return Ok(());
        }
        let place = items.first().copied().unwrap_or(root);
        let found = match numbers[..] {
            [] => "no item with a number".to_owned(),
            _ => crate::listed(&numbers.iter().map(String::as_str).collect::<Vec<_>>()),
        };
        let message = format!("the certificate is of {found}; the item `{item}` was expected");
        Err(self.wrong(place, message).help("take the certificate of the item that was used, or correct `item`"))
    }

    /// What has to be known of a certificate that is used.
    pub(crate) fn remarks(&self, root: Node<'_, '_>) -> Vec<String> {
        let mut remarks = Vec::new();
        if children(root, "Signature").next().is_some() {
            remarks.push("the certificate is signed, and the signature was not checked".to_owned());
        }
        if let Some((least, most)) = self.temperatures(root)
            && (least < 20.0 - USUAL_K || most > 20.0 + USUAL_K)
        {
            remarks.push(format!(
                "calibrated at {least:.2} °C to {most:.2} °C; the values count as those at 20 °C (ISO 1), where a certificate \
                 states them"
            ));
        }
        let is = |node: &Node<'_, '_>, name: &str, value: &str| {
            node.tag_name().name() == name && text(*node).split_whitespace().any(|word| word == value)
        };
        let invalid = root
            .descendants()
            .find(|node| ["valid", "validXMLList"].iter().any(|name| is(node, name, "false") || is(node, name, "0")));
        if let Some(node) = invalid {
            remarks.push(format!("a statement in line {} says that it is not valid", self.line(node)));
        }
        let fails = root.descendants().filter(|node| {
            ["conformity", "conformityXMLList"].iter().any(|name| is(node, name, "fail") || is(node, name, "noPass"))
        });
        let lines: Vec<String> = fails.map(|node| self.line(node).to_string()).take(5).collect();
        if !lines.is_empty() {
            remarks.push(format!("it states that the item does not conform (line {})", lines.join(", ")));
        }
        let substituted = at(root, &["administrativeData", "coreData", "reportAmendedSubstituted"]);
        if let Some(replaced) = substituted.and_then(|node| at(node, &["replacedUniqueIdentifier"])) {
            remarks.push(format!("it takes the place of the certificate {}", shown(text(replaced))));
        }
        remarks
    }

    /// The smallest and the largest temperature among the conditions, °C.
    fn temperatures(&self, root: Node<'_, '_>) -> Option<(f64, f64)> {
        let is_temperature = |node: &Node<'_, '_>| {
            let is_named = |name: &str| name.to_lowercase().contains("temperat");
            ref_types(*node).any(is_named) || names(*node).into_iter().any(is_named)
        };
        let conditions = root.descendants().filter(|node| node.tag_name().name() == "influenceConditions");
        let quantities = conditions.flat_map(|node| node.descendants()).filter(|node| {
            node.tag_name().name() == "quantity" && node.ancestors().take(6).any(|it| is_temperature(&it))
        });
        let degrees = quantities.flat_map(|node| node.descendants()).filter_map(|node| {
            let unit = ["unit", "unitXMLList"].iter().find_map(|name| children(node, name).next());
            let value = ["value", "valueXMLList"].iter().find_map(|name| children(node, name).next())?;
            let unit = DsiUnit::parse(text(unit?).split_whitespace().next()?)?;
            let zero = match (unit.is_celsius, unit.powers == [0, 0, 0, 1, 0]) {
                (true, _) => 0.0,
                (false, true) => ZERO_CELSIUS_K,
                (false, false) => return None,
            };
            Some(self.numbers(value).ok()?.into_iter().map(move |value| value * unit.factor - zero))
        });
        let degrees: Vec<f64> = degrees.flatten().collect();
        let least = degrees.iter().copied().reduce(f64::min)?;
        Some((least, degrees.into_iter().fold(least, f64::max)))
    }
}
