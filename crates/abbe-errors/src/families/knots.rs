//! Knots: where pieces of a function meet.

use abbe_core::{PathItem, SettingsError};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Commands at which a piecewise function or a spline has its knots.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum Knots {
    /// One by one, increasing.
    Listed(Vec<f64>),
    /// At equal distances.
    Even(EvenKnots),
}

/// Knots at equal distances.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EvenKnots {
    /// The first knot.
    pub from: f64,
    /// The last knot.
    pub to: f64,
    /// From each to the next.
    pub step: f64,
}

impl<'de> Deserialize<'de> for Knots {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        // Told apart here, because an untagged enum could not say what is wrong in either form.
        match serde_json::Value::deserialize(deserializer)? {
            map @ serde_json::Value::Object(_) => abbe_core::from_settings(&map).map(Self::Even),
            list => abbe_core::from_settings(&list).map(Self::Listed),
        }
        .map_err(serde::de::Error::custom)
    }
}

/// More knots than this are a slip of the pen: a step in the wrong unit.
const MOST: f64 = 1000.0;

impl Knots {
    /// The knots in their own unit.
    fn places(&self, what: &str, fewest: usize) -> Result<Vec<f64>, SettingsError> {
        let places = match self {
            Self::Listed(places) => places.clone(),
            Self::Even(even) => even.places()?,
        };
        if places.len() < fewest {
            let message = format!("{what} has {fewest} knots at least; {} are given", places.len());
            return Err(SettingsError::new("", message));
        }
        if !places[..1].iter().all(|first| first.is_finite()) {
            return Err(SettingsError::new("", "finite numbers were expected").under([PathItem::Index(0)]));
        }
        match places.windows(2).position(|pair| !(pair[0] < pair[1] && pair[1].is_finite())) {
            None => Ok(places),
            Some(index) => {
                Err(SettingsError::new("", format!("knots have to increase; {} does not", places[index + 1]))
                    .under([PathItem::Index(index + 1)]))
            }
        }
    }
}

impl EvenKnots {
    fn places(self) -> Result<Vec<f64>, SettingsError> {
        let Self { from, to, step } = self;
        let intervals = (to - from) / step;
        if !(step > 0.0 && intervals > 0.0 && intervals < MOST) {
            let message = format!(
                "knots from {from} to {to} in steps of {step}: a smaller `from`, a larger `to` and a positive `step` were expected"
            );
            return Err(SettingsError::new("", message));
        }
        if (intervals - intervals.round()).abs() > 1e-9 * intervals {
            let message = format!("the step {step} does not divide the way from {from} to {to}");
            return Err(SettingsError::new("step", message));
        }
        let last = intervals.round();
        // Both ends are exact.
        Ok((0..=last as usize).map(|k| (from * (last - k as f64) + to * k as f64) / last).collect())
    }
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
        (Some(knots), None) => knots.places(what, fewest).map_err(under("knots_mm")),
        (None, Some(knots)) => {
            let places = knots.places(what, fewest).map_err(under("knots_deg"))?;
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
