//! What a recipe says about the rows of an artefact: settings that are the same for all artefacts.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::Deserialize;

use abbe_core::{AboveZero, Error, KnownInput, Label, Names, PathItem, Result, matches};

/// The uncertainty of an artefact's rows, beyond the one number that the artefact itself takes, and which rows no fit uses.
#[derive(Debug, Clone, PartialEq, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RowSettings {
    /// Standard uncertainties and covariances of rows. They are the weights of the rows in the fit.
    #[serde(default)]
    pub uncertainty: Option<RowUncertainty>,
    /// The scatter of repeats, from rows with the columns `cycle` and `day`. It is part of the uncertainties of the
    /// results, and does not change the weights of the rows.
    #[serde(default)]
    pub pooled: Option<PooledRepeats>,
    /// Identities of the known inputs. Inputs with the same `id` share one error, in all estimates of all days. Either
    /// one text for all inputs of the artefact (its serial number, or that of its certificate), or texts by the own
    /// name of an input or a pattern of names (`stylus_radius`, `bar[1].*`). An input without an `id` is identified by
    /// what its certificate says.
    #[serde(default)]
    pub id: Option<Ids>,
    /// Rows that no estimate uses: by label column, the labels of rows that validators with these `observations` predict.
    #[serde(default)]
    pub unseen: BTreeMap<String, Vec<Label>>,
}

/// Standard uncertainties and covariances of rows. Settings that end in `_um` are for equations that are lengths, those
/// that end in `_urad` for equations that are angles.
#[derive(Debug, Clone, PartialEq, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RowUncertainty {
    /// Column (name without unit) with the standard uncertainty of every row: a length is for equations that are lengths, an
    /// angle for those that are angles; a list names one of each.
    #[serde(default)]
    pub column: Option<Names>,
    /// Label column by which `standard_um` and `standard_urad` give standard uncertainties: feature, group, direction.
    #[serde(default)]
    pub by: Option<String>,
    /// Standard uncertainty of the lengths in rows with a label; rows with other labels keep theirs.
    #[serde(default)]
    #[schemars(with = "BTreeMap<String, AboveZero>")]
    pub standard_um: BTreeMap<String, f64>,
    /// Standard uncertainty of the angles in rows with a label.
    #[serde(default)]
    #[schemars(with = "BTreeMap<String, AboveZero>")]
    pub standard_urad: BTreeMap<String, f64>,
    /// Standard uncertainty of each length of a row: of a ball centre along x, y, z.
    #[serde(default)]
    #[schemars(with = "Vec<AboveZero>")]
    pub directions_um: Vec<f64>,
    /// Standard uncertainty of each angle of a row: of an orientation about x, y, z.
    #[serde(default)]
    #[schemars(with = "Vec<AboveZero>")]
    pub directions_urad: Vec<f64>,
    /// Covariance of the lengths of every row with each other.
    #[serde(default)]
    pub row_covariance_um2: Vec<Vec<f64>>,
    /// Covariance of the angles of every row with each other.
    #[serde(default)]
    pub row_covariance_urad2: Vec<Vec<f64>>,
    /// Errors that all rows with the same label share.
    #[serde(default)]
    pub shared: Vec<SharedError>,
    /// CSV file with the full covariance of all rows, `touch,1_um2,2_um2,...`: the first column has the labels of the rows in
    /// a column of the data of that name, and so has the header; `1.1`, `1.2`, ... are the equations of row 1 where there are
    /// several.
    #[serde(default)]
    pub covariance: Option<String>,
}

/// An error that all rows with the same label share, in addition to their own errors.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SharedError {
    /// The label column.
    pub by: String,
    /// Standard uncertainty of the shared error of lengths.
    #[serde(default)]
    #[schemars(with = "Option<AboveZero>")]
    pub standard_uncertainty_um: Option<f64>,
    /// Standard uncertainty of the shared error of angles.
    #[serde(default)]
    #[schemars(with = "Option<AboveZero>")]
    pub standard_uncertainty_urad: Option<f64>,
}

/// How repeats are pooled (Rahman 2016, section 5.6).
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PooledRepeats {
    /// `cycle`: the scatter is that between days at the same cycle, without changes in the course of a day. `day`: the
    /// scatter is that between the cycles of a day, without changes from day to day. If it is missing, all repeats are
    /// one group.
    #[serde(default)]
    pub by: Option<String>,
}

/// Identities of the known inputs of an artefact.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(untagged, expecting = "a text, or texts by the names of known inputs, was expected")]
pub enum Ids {
    /// One identity for all inputs, except those of the machine.
    All(Label),
    /// By the own name of the input, or a pattern of names.
    Of(BTreeMap<String, Label>),
}

impl Ids {
    /// The declared id of every input of an artefact; none where none is.
    ///
    /// Fails on a name that no input has.
    pub fn of_inputs(&self, inputs: &[KnownInput]) -> Result<Vec<Option<String>>> {
        let map = match self {
            Self::All(id) => {
                return Ok(inputs.iter().map(|input| (!input.shared).then(|| id.0.clone())).collect());
            }
            Self::Of(map) => map,
        };
        let names = || inputs.iter().map(|input| input.parameter.name.as_str());
        if let Some(pattern) = map.keys().find(|pattern| !names().any(|name| matches(pattern, name))) {
            let mut error =
                Error::usage(format!("`{pattern}` is no known input of this artefact")).suggest(pattern, names());
            if error.help.is_none() {
                error = error.help(format!("there are: {}", names().collect::<Vec<_>>().join(", ")));
            }
            error.setting = ["id", pattern].map(|key| PathItem::Key(key.to_owned())).to_vec();
            return Err(error);
        }
        let id = |name: &str| map.iter().find(|(pattern, _)| matches(pattern, name)).map(|(_, id)| id.0.clone());
        Ok(names().map(id).collect())
    }
}
