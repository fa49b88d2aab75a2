//! Points with calibrated coordinates.

use abbe_core::{Error, Result, Unit};

use crate::{DigitalCertificate, Quantity, ValueIndex, listed};

/// A point: its label and its coordinates x, y, z, as far as they are stated. A plane plate has no z.
#[derive(Debug, Clone, PartialEq)]
pub struct CertifiedPoint {
    /// Its label.
    pub label: String,
    /// The values of x, y and z.
    pub coordinates: [Option<ValueIndex>; 3],
}

/// The number of a coordinate.
fn coordinate(word: &str) -> Option<usize> {
    ["x", "y", "z"].iter().position(|name| word.eq_ignore_ascii_case(name))
}

impl Quantity {
    /// The coordinate that its names, or the ends of its refTypes, say.
    fn coordinate(&self) -> Option<usize> {
        self.names.iter().find_map(|name| name.split([' ', '_', '-']).find_map(coordinate))
    }
}

impl DigitalCertificate {
    /// The points whose coordinates it states, in their order. A coordinate is a value with the label `3.x`; or the value `3` of a
    /// quantity with the name `x`; or the quantity `x` of a list with the name `3`.
    ///
    /// # Errors
    /// If there is none, if a coordinate is stated twice, or if a point lacks x or y, or a z that others have.
    pub fn points(&self) -> Result<Vec<CertifiedPoint>> {
        let mut points: Vec<CertifiedPoint> = Vec::new();
        for index in self.values(Unit::MM) {
            let Some((label, coordinate)) = self.place(index) else { continue };
            let place = points.iter().position(|point| point.label == label).unwrap_or_else(|| {
                points.push(CertifiedPoint { label: label.to_owned(), coordinates: [None; 3] });
                points.len() - 1
            });
            if let Some(other) = points[place].coordinates[coordinate].replace(index) {
                return Err(self.twice(&format!("{label}.{}", ["x", "y", "z"][coordinate]), other, index));
            }
        }
        if points.is_empty() {
            let labels: Vec<&str> = self.values(Unit::MM).map(|index| self.label(index)).collect();
            let message = "the certificate states no coordinates of points: lengths with labels as `3.x`, or quantities with the \
                           names x, y and z, were expected";
            let error = Error::data(message).in_file(&self.file);
            return Err(if labels.is_empty() { error } else { error.help(format!("it states {}", listed(&labels))) });
        }
        let is_plane = points.iter().all(|point| point.coordinates[2].is_none());
        let lacks = |point: &&CertifiedPoint| {
            let least = if is_plane { 2 } else { 3 };
            point.coordinates[..least].iter().any(Option::is_none)
        };
        match points.iter().find(lacks) {
            Some(point) => {
                let message = format!("the certificate does not state all coordinates of point `{}`", point.label);
                Err(Error::data(message).in_file(&self.file))
            }
            None => Ok(points),
        }
    }

    /// The point and the coordinate that a value is.
    fn place(&self, index: ValueIndex) -> Option<(&str, usize)> {
        let quantity = &self.quantities[index.quantity];
        let label = quantity.labels[index.value].as_str();
        if let Some((point, last)) = label.rsplit_once(['.', '_'])
            && let (Some(coordinate), false) = (coordinate(last), point.is_empty())
        {
            return Some((point, coordinate));
        }
        let own = quantity.coordinate()?;
        // A single value has the name of its quantity, which is the coordinate: the list has the name of the point.
        match quantity.values.len() == 1 && quantity.names.iter().any(|name| name == label) {
            true => quantity.list.first().map(|point| (point.as_str(), own)),
            false => Some((label, own)),
        }
    }
}
