//! What a recipe says about errors that are plausible.

use std::collections::BTreeMap;

use abbe_core::{Error, ParameterRole, PathItem, Problem, Quantity, Result, SettingsError, Unit, matches, positive};
use schemars::JsonSchema;
use serde::Deserialize;

/// The largest plausible errors of some parameters, by name or pattern, and how far features of artefacts may be from
/// their nominal places. For other parameters and features the values for their kind hold.
#[derive(Debug, Clone, PartialEq, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Plausible {
    /// Errors that are lengths, mm: `{ EX0C: 20, "d?t": 400, "table.*": 2000 }`. For an error motion: its largest value
    /// over the recorded travel; for an artefact stage (`table`): what its features may be off their nominal places.
    #[serde(default)]
    pub mm: BTreeMap<String, f64>,
    /// Errors that are angles, mrad.
    #[serde(default)]
    pub mrad: BTreeMap<String, f64>,
    /// Errors that are times, s: the delay of a probe, the lag of an axis.
    #[serde(default)]
    pub s: BTreeMap<String, f64>,
}

impl Plausible {
    fn all(&self) -> impl Iterator<Item = ([&str; 2], f64)> {
        let of = |key: &'static str, bounds| {
            let bounds: &BTreeMap<String, f64> = bounds;
            bounds.iter().map(move |(name, bound)| ([key, name.as_str()], *bound))
        };
        of("mm", &self.mm).chain(of("mrad", &self.mrad)).chain(of("s", &self.s))
    }

    /// Refuses bounds that are no positive numbers.
    pub fn check(&self) -> Result<(), SettingsError> {
        let at = |path: [&str; 2]| path.map(|key| PathItem::Key(key.to_owned()));
        self.all().try_for_each(|(path, bound)| positive("", bound).map(drop).map_err(|error| error.under(at(path))))
    }

    /// What is stated for a parameter or a feature of this name, mm, rad or s. The longest pattern says most.
    pub fn stated(&self, name: &str, unit: Unit) -> Option<f64> {
        let (own, factor) = match unit.of {
            Quantity::Length | Quantity::PerTemperature => (&self.mm, 1.0),
            Quantity::Angle => (&self.mrad, 1e-3),
            Quantity::Time => (&self.s, 1.0),
            _ => return None,
        };
        let stated = own.iter().filter(|(pattern, _)| matches(pattern, name));
        let most = stated.max_by_key(|(pattern, _)| pattern.trim_matches(['*', '?']).len());
        most.map(|(_, bound)| bound * factor)
    }

    /// Fails if a pattern matches no parameter of the machine that makes errors of this quantity, and no place of a feature.
    pub fn check_names(&self, problem: &Problem) -> Result<()> {
        let parameters = || problem.model.info().parameters.iter();
        let features = problem.sets.iter().flat_map(|set| {
            let own = set.info().unknowns.iter();
            let places = own.filter(|own| own.role == ParameterRole::Feature && own.unit == Unit::MM);
            places.map(|own| format!("{}.{}", set.name, own.name))
        });
        let features: Vec<String> = features.collect();
        let is_of_feature =
            |[key, pattern]: [&str; 2]| key == "mm" && features.iter().any(|name| matches(pattern, name));
        let has_one = |[key, pattern]: [&str; 2], any: bool| {
            let quantity = match key {
                "mm" => Quantity::Length,
                "mrad" => Quantity::Angle,
                _ => Quantity::Time,
            };
            parameters().any(|parameter| matches(pattern, &parameter.name) && (any || parameter.unit.of == quantity))
        };
        let Some((path, _)) = self.all().find(|(path, _)| !has_one(*path, false) && !is_of_feature(*path)) else {
            return Ok(());
        };
        let names = parameters().map(|parameter| &parameter.name).chain(&features).map(String::as_str);
        let mut error = match has_one(path, true) {
            true => Error::usage(format!("`{}` is no error in {}: it belongs under the other unit", path[1], path[0])),
            false => Error::usage(format!("`{}` matches no parameter of the machine and no feature", path[1]))
                .suggest(path[1], names),
        };
        error.setting = ["plausible"].iter().chain(&path).map(|key| PathItem::Key((*key).to_owned())).collect();
        Err(error)
    }
}
