//! What is known of a certificate so far. Each element that ISO/IEC 17025 asks for and that is missing makes it a draft.

use std::collections::BTreeMap;

use abbe_core::{Limit, SettingsError};
use schemars::JsonSchema;
use serde::Deserialize;

use crate::settings::{Adjustment, Condition, Contact, Equipment, Item, Method, Person, Place, Settings};

/// Settings of the readable certificate: those of `export: dcc`, and none of them has to be there.
#[derive(Debug, Clone, PartialEq, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Draft {
    /// Number of the certificate, which no other one has.
    pub identifier: Option<String>,
    /// First day of the measurements, as 2026-03-02.
    pub begin: Option<String>,
    /// Their last day.
    pub end: Option<String>,
    /// Where they were made.
    pub place: Option<Place>,
    /// Day of issue.
    pub issued: Option<String>,
    /// Day on which the item was received, where that matters.
    pub received: Option<String>,
    /// Additions to, deviations from and exclusions from the methods; `none` if there are none.
    pub deviations: Option<String>,
    /// Whether the item was adjusted or repaired.
    pub adjustment: Option<Adjustment>,
    /// Which results are from others, and from whom.
    pub external: Option<String>,
    /// Country of the laboratory, two capital letters (ISO 3166-1).
    pub country: Option<String>,
    /// Who calibrated.
    pub laboratory: Option<Contact>,
    /// Who is responsible; the first one authorizes the certificate.
    pub persons: Vec<Person>,
    /// For whom it was calibrated.
    pub customer: Option<Contact>,
    /// What was calibrated.
    pub item: Option<Item>,
    /// By which methods; the standard or the paper under `norms`.
    pub methods: Vec<Method>,
    /// With which equipment.
    pub equipment: Vec<Equipment>,
    /// Under which conditions, the temperature first.
    pub conditions: Vec<Condition>,
    /// The parameters that are certified, by patterns. Default: all of the machine that were estimated.
    pub parameters: Vec<String>,
    /// Largest admissible sizes of parameters, by patterns: statements of conformity, with the rule that decides. In um, urad or um/m,
    /// as the parameter is a length, an angle or a number.
    pub limits: BTreeMap<String, Limit>,
    /// Probability of the expanded uncertainties.
    #[schemars(range(min = 0.7, max = 0.9999))]
    pub coverage_probability: Option<f64>,
}

impl Draft {
    /// Fails for what is there and is wrong. What is missing is no error.
    pub fn check(&self) -> Result<(), SettingsError> {
        self.filled().check()
    }

    /// The settings of a whole certificate, with words in place of what is missing.
    pub fn filled(&self) -> Settings {
        let text = |text: &Option<String>| text.clone().unwrap_or_else(|| "missing".to_owned());
        let contact = |contact: &Option<Contact>| contact.clone().unwrap_or_else(Contact::missing);
        let day = |day: &Option<String>| day.clone().unwrap_or_else(|| "2000-01-01".to_owned());
        let begin = self.begin.clone().or_else(|| self.end.clone());
        Settings {
            version: crate::settings::Version::default(),
            identifier: text(&self.identifier),
            country: self.country.clone().unwrap_or_else(|| "XX".to_owned()),
            begin: day(&begin),
            end: day(&self.end.clone().or(begin.clone())),
            place: self.place.unwrap_or(Place::Other),
            issued: self.issued.clone(),
            received: self.received.clone(),
            deviations: self.deviations.clone(),
            adjustment: self.adjustment,
            external: self.external.clone(),
            laboratory: contact(&self.laboratory),
            persons: or_one(&self.persons, Person::missing),
            customer: contact(&self.customer),
            item: self.item.clone().unwrap_or_else(Item::missing),
            methods: or_one(&self.methods, Method::missing),
            equipment: or_one(&self.equipment, Equipment::missing),
            conditions: or_one(&self.conditions, Condition::missing),
            parameters: self.parameters.clone(),
            limits: self.limits.clone(),
            coverage_probability: self.coverage_probability.unwrap_or(0.95),
        }
    }

    /// What is missing, with the clause of ISO/IEC 17025:2017 that asks for it.
    pub fn missing(&self) -> Vec<String> {
        let mut missing = Vec::new();
        let mut needs = |is_there: bool, what: &str, clause: &str| {
            if !is_there {
                missing.push(format!("{what} ({clause})"));
            }
        };
        let has_address = |contact: &Contact| contact.street.is_some() && contact.post_code.is_some();
        needs(self.laboratory.is_some(), "name and address of the laboratory: `laboratory`", "7.8.2.1 b");
        if let Some(laboratory) = &self.laboratory {
            needs(has_address(laboratory), "street and post code of the laboratory", "7.8.2.1 b");
        }
        needs(self.place.is_some(), "place of the measurements: `place`", "7.8.2.1 c");
        needs(self.identifier.is_some(), "number of the certificate: `identifier`", "7.8.2.1 d");
        needs(self.customer.is_some(), "name and contact of the customer: `customer`", "7.8.2.1 e");
        if let Some(customer) = &self.customer {
            let is_reached = customer.street.is_some() || customer.e_mail.is_some();
            needs(is_reached, "street or e-mail of the customer", "7.8.2.1 e");
        }
        needs(!self.methods.is_empty(), "methods: `methods`", "7.8.2.1 f");
        needs(self.item.is_some(), "identification of the item: `item`", "7.8.2.1 g");
        if let Some(item) = &self.item {
            needs(item.condition.is_some(), "condition of the item: `condition`", "7.8.2.1 g");
        }
        needs(self.begin.is_some() && self.end.is_some(), "days of the measurements: `begin`, `end`", "7.8.2.1 i");
        needs(self.issued.is_some(), "day of issue: `issued`", "7.8.2.1 j");
        needs(self.deviations.is_some(), "deviations from the methods, or `none`: `deviations`", "7.8.2.1 n");
        needs(!self.persons.is_empty(), "who authorizes it: `persons`", "7.8.2.1 o");
        let has_temperature = self.conditions.iter().any(|condition| ["degC", "K"].contains(&condition.unit.as_str()));
        needs(has_temperature, "conditions, with a temperature: `conditions`", "7.8.4.1 b");
        needs(!self.equipment.is_empty(), "equipment: `equipment`", "7.8.4.1 c");
        for one in self.equipment.iter().filter(|one| one.traceability.is_none()) {
            needs(false, &format!("traceability of {}: `traceability`", one.name), "7.8.4.1 c");
        }
        needs(self.adjustment.is_some(), "whether it was adjusted: `adjustment`", "7.8.4.1 d");
        missing
    }
}

fn or_one<T: Clone>(list: &[T], missing: fn() -> T) -> Vec<T> {
    if list.is_empty() { vec![missing()] } else { list.to_vec() }
}

impl From<&Settings> for Draft {
    fn from(settings: &Settings) -> Self {
        let settings = settings.clone();
        Self {
            identifier: Some(settings.identifier),
            begin: Some(settings.begin),
            end: Some(settings.end),
            place: Some(settings.place),
            issued: settings.issued,
            received: settings.received,
            deviations: settings.deviations,
            adjustment: settings.adjustment,
            external: settings.external,
            country: Some(settings.country),
            laboratory: Some(settings.laboratory),
            persons: settings.persons,
            customer: Some(settings.customer),
            item: Some(settings.item),
            methods: settings.methods,
            equipment: settings.equipment,
            conditions: settings.conditions,
            parameters: settings.parameters,
            limits: settings.limits,
            coverage_probability: Some(settings.coverage_probability),
        }
    }
}
