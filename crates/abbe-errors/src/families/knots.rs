//! Knots: where pieces of a function meet.

use abbe_core::{PathItem, Series, SettingsError};

/// Commands at which a piecewise function or a spline has its knots.
pub type Knots = Series;

/// The knots in their own unit.
fn places(knots: &Knots, what: &str, fewest: usize) -> Result<Vec<f64>, SettingsError> {
    let places = knots.values()?;
    if places.len() < fewest {
        let message = format!("{what} has {fewest} knots at least; {} are given", places.len());
        return Err(SettingsError::new("", message));
    }
    Ok(places)
}

/// The knots of a setting `knots_mm` or `knots_deg`, mm or rad, increasing.
pub(crate) fn knots(
    what: &str,
    mm: &Option<Knots>,
    deg: &Option<Knots>,
    fewest: usize,
) -> Result<Vec<f64>, SettingsError> {
    let under = |name: &str| {
        let name = PathItem::Key(name.to_owned());
        move |error: SettingsError| error.under([name])
    };
    match (mm, deg) {
        (Some(knots), None) => places(knots, what, fewest).map_err(under("knots_mm")),
        (None, Some(knots)) => {
            let places = places(knots, what, fewest).map_err(under("knots_deg"))?;
            Ok(places.into_iter().map(f64::to_radians).collect())
        }
        (Some(_), Some(_)) => Err(SettingsError::new("knots_deg", "there is `knots_mm` already")),
        (None, None) => {
            Err(SettingsError::new("", format!("{what} needs `knots_mm` (or `knots_deg` of a rotary axis)")))
        }
    }
}

/// Refuses inner knots that are not between the ends of a range.
pub(crate) fn within(knots: &[f64], range: [f64; 2], degrees: bool) -> Result<(), SettingsError> {
    let Some(index) = knots.iter().position(|knot| !(range[0] < *knot && *knot < range[1])) else { return Ok(()) };
    let (setting, unit) = if degrees { ("knots_deg", 1f64.to_degrees()) } else { ("knots_mm", 1.0) };
    let [knot, from, to] = [knots[index], range[0], range[1]].map(|place| (place * unit * 1e9).round() / 1e9);
    let message = format!("the knot {knot} is not between {from} and {to}, the ends of the range");
    Err(SettingsError::new("", message).under([PathItem::Key(setting.to_owned()), PathItem::Index(index)]))
}
