//! Settings of a certificate: what only people know.

use std::collections::BTreeMap;

use abbe_core::{Limit, PathItem, SettingsError};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::units::dsi;

/// Settings of the exporter.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Version of the DCC. Default: 3.2.1.
    #[serde(default)]
    pub version: Version,
    /// Number of the certificate, which no other one has.
    pub identifier: String,
    /// Country of the laboratory, two capital letters (ISO 3166-1).
    pub country: String,
    /// First day of the measurements, as 2026-03-02.
    pub begin: String,
    /// Their last day.
    pub end: String,
    /// Where they were made.
    pub place: Place,
    /// Day of issue. Without it the page is a draft.
    #[serde(default)]
    pub issued: Option<String>,
    /// Day on which the item was received, where that matters.
    #[serde(default)]
    pub received: Option<String>,
    /// Additions to, deviations from and exclusions from the methods; `none` if there are none. Without it the page is a draft.
    #[serde(default)]
    pub deviations: Option<String>,
    /// Whether the item was adjusted or repaired. Without it the page is a draft.
    #[serde(default)]
    pub adjustment: Option<Adjustment>,
    /// Which results are from others, and from whom.
    #[serde(default)]
    pub external: Option<String>,
    /// Who calibrated.
    pub laboratory: Contact,
    /// Who is responsible; the first one signs.
    pub persons: Vec<Person>,
    /// For whom it was calibrated.
    pub customer: Contact,
    /// What was calibrated.
    pub item: Item,
    /// By which methods; the standard or the paper under `norms`.
    pub methods: Vec<Method>,
    /// With which equipment.
    pub equipment: Vec<Equipment>,
    /// Under which conditions, the temperature first.
    pub conditions: Vec<Condition>,
    /// The parameters that are certified, by patterns. Default: all of the machine that were estimated.
    #[serde(default)]
    pub parameters: Vec<String>,
    /// Largest admissible sizes of parameters, by patterns: statements of conformity, with the rule that decides. In um, urad or um/m,
    /// as the parameter is a length, an angle or a number.
    #[serde(default)]
    pub limits: BTreeMap<String, Limit>,
    /// Probability of the expanded uncertainties, and of the ellipsoid around all values. The schema takes coverage factors from 1.
    #[serde(default = "usual")]
    #[schemars(range(min = 0.7, max = 0.9999))]
    pub coverage_probability: f64,
}

fn usual() -> f64 {
    0.95
}

/// A version of the schema.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, JsonSchema)]
pub enum Version {
    /// DCC 3.2.1 with D-SI 2.1, which most programs read.
    #[default]
    #[serde(rename = "3.2.1")]
    Dcc321,
    /// DCC 3.3.0 with D-SI 2.2.
    #[serde(rename = "3.3")]
    Dcc330,
}

impl Version {
    /// As the schema has it.
    pub fn word(self) -> &'static str {
        match self {
            Self::Dcc321 => "3.2.1",
            Self::Dcc330 => "3.3.0",
        }
    }
}

/// A place of measurements.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Place {
    /// The laboratory.
    Laboratory,
    /// At the customer's.
    Customer,
    /// A branch of the laboratory.
    LaboratoryBranch,
    /// A branch of the customer.
    CustomerBranch,
    /// Another one.
    Other,
}

impl Place {
    /// As the schema has it.
    pub fn word(self) -> &'static str {
        match self {
            Self::Laboratory => "laboratory",
            Self::Customer => "customer",
            Self::LaboratoryBranch => "laboratoryBranch",
            Self::CustomerBranch => "customerBranch",
            Self::Other => "other",
        }
    }
}

/// Whether results are from before or after an adjustment (ISO/IEC 17025, 7.8.4.1 d).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Adjustment {
    /// Nothing was adjusted.
    None,
    /// The results are from before an adjustment.
    Before,
    /// They are from after it.
    After,
}

impl Adjustment {
    /// In words.
    pub fn words(self) -> &'static str {
        match self {
            Self::None => "The item was neither adjusted nor repaired.",
            Self::Before => "The results are from before an adjustment or repair.",
            Self::After => "The results are from after an adjustment or repair.",
        }
    }
}

/// A company.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Contact {
    /// Its name.
    pub name: String,
    /// Its town.
    pub city: String,
    /// Its country, two capital letters (ISO 3166-1).
    pub country: String,
    /// Post code.
    #[serde(default)]
    pub post_code: Option<String>,
    /// Street with its number.
    #[serde(default)]
    pub street: Option<String>,
    /// Address of e-mail.
    #[serde(default)]
    pub e_mail: Option<String>,
}

/// A person.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Person {
    /// Name.
    pub name: String,
    /// What this person is there, e.g. head of the laboratory.
    pub role: String,
}

/// What was calibrated.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Item {
    /// What it is, e.g. five-axis machining centre.
    pub name: String,
    /// Who made it.
    pub manufacturer: String,
    /// Its type.
    pub model: String,
    /// Its number.
    pub serial_number: String,
    /// Its condition when it was calibrated. Without it the page is a draft.
    #[serde(default)]
    pub condition: Option<String>,
}

/// A method.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Method {
    /// Its name.
    pub name: String,
    /// Standards and papers with their editions.
    #[serde(default)]
    pub norms: Vec<String>,
}

/// An instrument or an artefact.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Equipment {
    /// What it is.
    pub name: String,
    /// Its number.
    pub serial_number: String,
    /// What makes it traceable: its certificate and who issued it. Without it the page is a draft.
    #[serde(default)]
    pub traceability: Option<String>,
}

/// What influences the values, from its smallest to its largest value.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Condition {
    /// What it is, e.g. temperature of the air.
    pub name: String,
    /// Smallest value.
    pub from: f64,
    /// Largest value.
    pub to: f64,
    /// Unit: degC, K, %, hPa, mm, um, s, N or 1.
    pub unit: String,
}

/// Settings that a stage can be built from.
pub fn example() -> Value {
    json!({
        "identifier": "CAL-2026-0412", "country": "DE", "begin": "2026-03-02", "end": "2026-03-03", "place": "customer",
        "laboratory": { "name": "Laboratory", "city": "Musterstadt", "country": "DE" },
        "persons": [{ "name": "A. Person", "role": "head of the laboratory" }],
        "customer": { "name": "Customer", "city": "Musterstadt", "country": "DE" },
        "item": { "name": "machining centre", "manufacturer": "Maker", "model": "M1", "serial_number": "123" },
        "methods": [{ "name": "touches of the table", "norms": ["ISO 230-1:2012"] }],
        "equipment": [{ "name": "touch probe", "serial_number": "456" }],
        "conditions": [{ "name": "temperature of the air", "from": 19.8, "to": 20.4, "unit": "degC" }]
    })
}

impl Settings {
    /// Fails, with the setting, for texts that are empty or cannot stand in XML, for countries and days that are none, and for lists
    /// without an entry.
    pub fn check(&self) -> Result<(), SettingsError> {
        let named = |name: &str, text: &str| worded(text).map_err(|message| SettingsError::new(name, message));
        named("identifier", &self.identifier)?;
        country("country", &self.country)?;
        for (name, text) in [("deviations", &self.deviations), ("external", &self.external)] {
            text.iter().try_for_each(|text| named(name, text))?;
        }
        for (name, text) in [("issued", &self.issued), ("received", &self.received)] {
            text.iter().try_for_each(|text| day(name, text).map(drop))?;
        }
        let [begin, end] = [day("begin", &self.begin)?, day("end", &self.end)?];
        if end < begin {
            return Err(SettingsError::new(
                "end",
                format!("{}: not before `begin` ({}) was expected", self.end, self.begin),
            ));
        }
        for (name, contact) in [("laboratory", &self.laboratory), ("customer", &self.customer)] {
            contact.check().map_err(|error| error.under([PathItem::Key(name.to_owned())]))?;
        }
        for (key, text) in [
            ("name", &self.item.name),
            ("manufacturer", &self.item.manufacturer),
            ("model", &self.item.model),
            ("serial_number", &self.item.serial_number),
        ]
        .into_iter()
        .chain(self.item.condition.as_ref().map(|condition| ("condition", condition)))
        {
            named(key, text).map_err(|error| error.under([PathItem::Key("item".to_owned())]))?;
        }
        let persons: Vec<Vec<&str>> = self.persons.iter().map(|one| vec![one.name.as_str(), &one.role]).collect();
        let methods: Vec<Vec<&str>> = (self.methods.iter())
            .map(|one| [one.name.as_str()].into_iter().chain(one.norms.iter().map(String::as_str)).collect())
            .collect();
        let equipment: Vec<Vec<&str>> = self
            .equipment
            .iter()
            .map(|one| {
                let traceability = one.traceability.iter().map(String::as_str);
                [one.name.as_str(), &one.serial_number].into_iter().chain(traceability).collect()
            })
            .collect();
        let conditions: Vec<Vec<&str>> = self.conditions.iter().map(|one| vec![one.name.as_str()]).collect();
        for (name, texts) in
            [("persons", persons), ("methods", methods), ("equipment", equipment), ("conditions", conditions)]
        {
            if texts.is_empty() {
                return Err(SettingsError::new(name, "at least one was expected"));
            }
            texts.into_iter().flatten().try_for_each(|text| named(name, text))?;
        }
        self.conditions.iter().try_for_each(Condition::check)?;
        if let Some((pattern, limit)) = self.limits.iter().find(|(_, limit)| limit.value <= 0.0) {
            let message = format!("{}: a limit above 0 was expected", limit.value);
            return Err(SettingsError::new(pattern, message).under([PathItem::Key("limits".to_owned())]));
        }
        match (0.7..=0.9999).contains(&self.coverage_probability) {
            true => Ok(()),
            false => Err(SettingsError::new("coverage_probability", "a number from 0.7 to 0.9999 was expected")),
        }
    }
}

impl Contact {
    fn check(&self) -> Result<(), SettingsError> {
        let more = [("post_code", &self.post_code), ("street", &self.street), ("e_mail", &self.e_mail)];
        let texts = [("name", &self.name), ("city", &self.city)].into_iter();
        texts
            .chain(more.into_iter().filter_map(|(name, text)| Some((name, text.as_ref()?))))
            .try_for_each(|(name, text)| worded(text).map_err(|message| SettingsError::new(name, message)))?;
        country("country", &self.country)
    }
}

impl Condition {
    fn check(&self) -> Result<(), SettingsError> {
        if dsi(&self.unit).is_none() {
            let message =
                format!("`{}` is no unit of a condition: degC, K, %, hPa, mm, um, s, N or 1 was expected", self.unit);
            return Err(SettingsError::new("conditions", message));
        }
        match self.from.is_finite() && self.from <= self.to && self.to.is_finite() {
            true => Ok(()),
            false => {
                let message = format!(
                    "{} goes from {} to {}: the smaller number first was expected",
                    self.name, self.from, self.to
                );
                Err(SettingsError::new("conditions", message))
            }
        }
    }
}

/// Why a text is none that the schema takes: words with white space between them, and no control characters.
fn worded(text: &str) -> Result<(), String> {
    if text.trim().is_empty() {
        return Err("a text was expected, and this one is empty: a certificate needs it".to_owned());
    }
    match text.trim() == text && !text.chars().any(char::is_control) {
        true => Ok(()),
        false => {
            Err("a text without control characters, and without space before or behind it, was expected".to_owned())
        }
    }
}

fn country(name: &str, text: &str) -> Result<(), SettingsError> {
    match text.len() == 2 && text.bytes().all(|letter| letter.is_ascii_uppercase()) {
        true => Ok(()),
        false => Err(SettingsError::new(
            name,
            format!("`{text}`: a country as two capital letters (ISO 3166-1) was expected"),
        )),
    }
}

/// A day as year, month and day.
fn day(name: &str, text: &str) -> Result<[u32; 3], SettingsError> {
    let parts: Vec<&str> = text.split('-').collect();
    let has_digits =
        |(part, digits): (&&str, usize)| part.len() == digits && part.bytes().all(|digit| digit.is_ascii_digit());
    let numbers: Vec<u32> = parts.iter().filter_map(|part| part.parse().ok()).collect();
    match numbers[..] {
        [year, month, day] if parts.iter().zip([4, 2, 2]).all(has_digits) && is_day(year, month, day) => {
            Ok([year, month, day])
        }
        _ => Err(SettingsError::new(name, format!("`{text}`: a day as 2026-03-02 was expected"))),
    }
}

fn is_day(year: u32, month: u32, day: u32) -> bool {
    let is_leap = year.is_multiple_of(4) && (!year.is_multiple_of(100) || year.is_multiple_of(400));
    let days = match month {
        2 if is_leap => 29,
        2 => 28,
        4 | 6 | 9 | 11 => 30,
        1..=12 => 31,
        _ => return false,
    };
    (1..=days).contains(&day)
}

/// What stands where nothing is known yet.
const MISSING: &str = "missing";

impl Contact {
    /// One of which nothing is known.
    pub fn missing() -> Self {
        let text = || MISSING.to_owned();
        Self { name: text(), city: text(), country: "XX".to_owned(), post_code: None, street: None, e_mail: None }
    }
}

impl Person {
    /// One of whom nothing is known.
    pub fn missing() -> Self {
        Self { name: MISSING.to_owned(), role: MISSING.to_owned() }
    }
}

impl Item {
    /// One of which nothing is known.
    pub fn missing() -> Self {
        let text = || MISSING.to_owned();
        Self { name: text(), manufacturer: text(), model: text(), serial_number: text(), condition: None }
    }
}

impl Method {
    /// One of which nothing is known.
    pub fn missing() -> Self {
        Self { name: MISSING.to_owned(), norms: Vec::new() }
    }
}

impl Equipment {
    /// One of which nothing is known.
    pub fn missing() -> Self {
        Self { name: MISSING.to_owned(), serial_number: MISSING.to_owned(), traceability: None }
    }
}

impl Condition {
    /// One of which nothing is known.
    pub fn missing() -> Self {
        Self { name: MISSING.to_owned(), from: 0.0, to: 0.0, unit: "1".to_owned() }
    }
}
