//! The elements of a certificate, in the order of the schemas DCC 3.2.1 and 3.3.0.

use std::path::Path;

use abbe_core::{Calibration, Error, Estimated, Result};
use abbe_numerics::{coverage_factor, joint_coverage_factor};

use crate::conformity::{self, Statement};
use crate::element::Element;
use crate::settings::{Condition, Contact, Settings};
use crate::uncertainty::{Stated, listed};
use crate::units::dsi;

/// The document.
///
/// Fails for a unit that the D-SI does not have, and for fewer degrees of freedom than parameters.
pub fn certificate(settings: &Settings, calibration: &Calibration, certified: &[&Estimated]) -> Result<String> {
    let root = Element::of(
        "dcc:digitalCalibrationCertificate",
        vec![
            administrative(settings),
            Element::of("dcc:measurementResults", vec![measurement(settings, calibration, certified)?]),
        ],
    );
    let version = settings.version.word();
    let root = root
        .with("schemaVersion", version)
        .with("xmlns:dcc", "https://ptb.de/dcc")
        .with("xmlns:si", "https://ptb.de/si")
        .with("xmlns:xsi", "http://www.w3.org/2001/XMLSchema-instance")
        .with("xsi:schemaLocation", &format!("https://ptb.de/dcc https://ptb.de/dcc/v{version}/dcc.xsd"));
    root.document().map_err(|error| Error::data(format!("the certificate cannot be written as XML: {error}")))
}

/// Who, what, when and where.
fn administrative(settings: &Settings) -> Element {
    let day = |name: &str, day: &Option<String>| day.as_ref().map(|day| Element::text(name, day));
    let core = Element::of(
        "dcc:coreData",
        [
            Some(Element::text("dcc:countryCodeISO3166_1", &settings.country)),
            Some(Element::text("dcc:usedLangCodeISO639_1", "en")),
            Some(Element::text("dcc:mandatoryLangCodeISO639_1", "en")),
            Some(Element::text("dcc:uniqueIdentifier", &settings.identifier)),
            day("dcc:receiptDate", &settings.received),
            Some(Element::text("dcc:beginPerformanceDate", &settings.begin)),
            Some(Element::text("dcc:endPerformanceDate", &settings.end)),
            Some(Element::text("dcc:performanceLocation", settings.place.word())),
            day("dcc:issueDate", &settings.issued),
        ]
        .into_iter()
        .flatten()
        .collect(),
    );
    let condition = settings.item.condition.as_ref().map(|text| described(&format!("Condition: {text}")));
    let item = [named("dcc:name", &settings.item.name)].into_iter().chain(condition).chain([
        Element::of("dcc:manufacturer", vec![named("dcc:name", &settings.item.manufacturer)]),
        Element::text("dcc:model", &settings.item.model),
        identified("manufacturer", &settings.item.serial_number),
    ]);
    let item = Element::of("dcc:item", item.collect());
    let person = |(index, person): (usize, &crate::settings::Person)| {
        let mut elements = vec![
            Element::of("dcc:person", vec![named("dcc:name", &person.name)]),
            Element::text("dcc:role", &person.role),
        ];
        if index == 0 {
            elements.push(Element::text("dcc:mainSigner", "true"));
        }
        Element::of("dcc:respPerson", elements)
    };
    let statement = |norm: &str, reference: &str, text: &str| {
        Element::of(
            "dcc:statement",
            vec![
                Element::text("dcc:norm", norm),
                Element::text("dcc:reference", reference),
                named("dcc:declaration", text),
            ],
        )
    };
    Element::of(
        "dcc:administrativeData",
        vec![
            Element::of("dcc:dccSoftware", vec![software()]),
            core,
            Element::of("dcc:items", vec![item]),
            Element::of("dcc:calibrationLaboratory", vec![contact("dcc:contact", &settings.laboratory)]),
            Element::of("dcc:respPersons", settings.persons.iter().enumerate().map(person).collect()),
            contact("dcc:customer", &settings.customer),
            Element::of(
                "dcc:statements",
                statements(settings).map(|(norm, clause, text)| statement(norm, clause, &text)).collect(),
            ),
        ],
    )
}

/// What is stated of the whole calibration: standard, clause, words.
pub fn statements(settings: &Settings) -> impl Iterator<Item = (&'static str, &'static str, String)> {
    const COMPETENCE: &str = "ISO/IEC 17025:2017";
    let always = [
        (COMPETENCE, "7.8.2.1 l", "The results relate to the item that was calibrated only.".to_owned()),
        (
            "JCGM 100:2008",
            "6",
            "The expanded uncertainty is the standard uncertainty multiplied by the coverage factor that is stated with it."
                .to_owned(),
        ),
    ];
    let deviations = settings.deviations.iter();
    let deviations = deviations.map(|text| format!("Additions to, deviations and exclusions from the methods: {text}"));
    let external = settings.external.iter().map(|text| format!("Results from external providers: {text}"));
    let adjustment = settings.adjustment.map(|adjustment| adjustment.words().to_owned());
    let more = (deviations.map(|text| (COMPETENCE, "7.8.2.1 n", text)))
        .chain(external.map(|text| (COMPETENCE, "7.8.2.1 p", text)))
        .chain(adjustment.map(|text| (COMPETENCE, "7.8.4.1 d", text)));
    always.into_iter().chain(more)
}

/// How it was measured, and what came out.
fn measurement(settings: &Settings, calibration: &Calibration, certified: &[&Estimated]) -> Result<Element> {
    let methods = settings.methods.iter().map(|method| {
        let norms = method.norms.iter().map(|norm| Element::text("dcc:norm", norm));
        Element::of("dcc:usedMethod", [named("dcc:name", &method.name)].into_iter().chain(norms).collect())
    });
    let equipment = settings.equipment.iter().map(|one| {
        let traceability = one.traceability.as_ref().map(|text| described(&format!("Traceability: {text}")));
        let elements = [named("dcc:name", &one.name)].into_iter().chain(traceability);
        let number = identified("manufacturer", &one.serial_number);
        Element::of("dcc:measuringEquipment", elements.chain([number]).collect())
    });
    let conditions = settings.conditions.iter().map(condition);
    let result = Element::of(
        "dcc:result",
        vec![
            named("dcc:name", "Errors of the machine"),
            Element::of(
                "dcc:data",
                vec![Element::of(
                    "dcc:quantity",
                    vec![named("dcc:name", "Error parameters"), values(settings, calibration, certified)?],
                )],
            ),
        ],
    );
    let mut elements = vec![
        named("dcc:name", &format!("Estimate {}", calibration.estimate)),
        Element::of("dcc:usedMethods", methods.collect()),
        Element::of("dcc:usedSoftware", vec![software()]),
        Element::of("dcc:measuringEquipments", equipment.collect()),
        Element::of("dcc:influenceConditions", conditions.collect()),
        Element::of("dcc:results", vec![result]),
    ];
    let files = measured_files(calibration).map(|(name, hash)| {
        let name = named("dcc:name", &printable(name));
        Element::of("dcc:metaData", vec![name, Element::text("dcc:reference", format!("SHA-256 {hash}"))])
    });
    let mut more: Vec<Element> = conformity::statements(settings, certified)?.iter().map(statement).collect();
    more.extend(files);
    if !more.is_empty() {
        elements.push(Element::of("dcc:measurementMetaData", more));
    }
    Ok(Element::of("dcc:measurementResult", elements))
}

/// A statement of conformity, with its limit.
fn statement(stated: &Statement) -> Element {
    let limit = vec![Element::text("si:value", number(stated.limit)), Element::text("si:unit", &stated.unit)];
    let limit = vec![named("dcc:name", "largest admissible size"), Element::of("si:real", limit)];
    Element::of(
        "dcc:metaData",
        vec![
            named("dcc:name", &format!("Conformity of {}", label(&stated.parameter))),
            Element::text("dcc:norm", stated.rule),
            named("dcc:declaration", &stated.declaration),
            Element::text("dcc:conformity", stated.status),
            Element::of("dcc:data", vec![Element::of("dcc:quantity", limit)]),
        ],
    )
}

/// Values, expanded uncertainties and covariance.
fn values(settings: &Settings, calibration: &Calibration, certified: &[&Estimated]) -> Result<Element> {
    let probability = settings.coverage_probability;
    let unit = |parameter: &&Estimated| {
        dsi(&parameter.unit).ok_or_else(|| {
            Error::data(format!(
                "the unit {} of {} is none that a certificate can state",
                parameter.unit, parameter.name
            ))
        })
    };
    let units: Vec<String> = certified.iter().map(unit).collect::<Result<_>>()?;
    let factor = |parameter: &&Estimated| {
        coverage_factor(probability, calibration.degrees_of_freedom(|name| name == parameter.name))
    };
    let factors: Vec<f64> = certified.iter().map(factor).collect();
    let freedom = calibration.degrees_of_freedom(|name| certified.iter().any(|parameter| parameter.name == name));
    let joint = joint_coverage_factor(certified.len(), probability, freedom);
    if !joint.is_finite() || factors.iter().any(|factor| !factor.is_finite()) {
        let message =
            format!("{freedom:.1} degrees of freedom are too few for an ellipsoid of {} parameters", certified.len());
        return Err(Error::usage(message).help("certify fewer parameters").setting("parameters"));
    }
    calibration.check_covariance_of(certified.iter().map(|one| one.name.as_str()))?;
    let covariance = calibration.covariance.block(&certified.iter().map(|one| one.name.as_str()).collect::<Vec<_>>());
    let stated = Stated {
        units: &units,
        expanded: certified.iter().zip(&factors).map(|(one, factor)| factor * one.standard_uncertainty).collect(),
        factors,
        covariance: |row, column| covariance[(row, column)],
        joint,
        probability,
    };
    let mut elements = vec![
        listed("si:labelXMLList", certified.iter().map(|one| label(&one.name))),
        listed("si:valueXMLList", certified.iter().map(|one| number(one.value))),
        listed("si:unitXMLList", units.iter().cloned()),
    ];
    elements.extend(stated.elements(settings.version));
    Ok(Element::of("si:realListXMLList", elements))
}

/// What influences the values, with the ends of its range.
fn condition(condition: &Condition) -> Element {
    let real = |name: &str, value: f64| {
        let unit = dsi(&condition.unit).unwrap_or_default();
        let real = vec![Element::text("si:value", number(value)), Element::text("si:unit", unit)];
        Element::of("dcc:quantity", vec![named("dcc:name", name), Element::of("si:real", real)])
    };
    let range = vec![real("smallest", condition.from), real("largest", condition.to)];
    let elements = vec![named("dcc:name", &condition.name), Element::of("dcc:data", range)];
    Element::of("dcc:influenceCondition", elements)
}

fn software() -> Element {
    let release = format!("v {}", env!("CARGO_PKG_VERSION"));
    Element::of("dcc:software", vec![named("dcc:name", "Abbe"), Element::text("dcc:release", release)])
}

fn contact(name: &str, contact: &Contact) -> Element {
    let mut location =
        vec![Element::text("dcc:city", &contact.city), Element::text("dcc:countryCode", &contact.country)];
    location.extend(contact.post_code.iter().map(|code| Element::text("dcc:postCode", code)));
    location.extend(contact.street.iter().map(|street| Element::text("dcc:street", street)));
    let mut elements = vec![named("dcc:name", &contact.name)];
    elements.extend(contact.e_mail.iter().map(|address| Element::text("dcc:eMail", address)));
    elements.push(Element::of("dcc:location", location));
    Element::of(name, elements)
}

fn identified(issuer: &str, value: &str) -> Element {
    let one = vec![Element::text("dcc:issuer", issuer), Element::text("dcc:value", value)];
    Element::of("dcc:identifications", vec![Element::of("dcc:identification", one)])
}

/// A description.
fn described(text: &str) -> Element {
    named("dcc:description", text)
}

/// An element with a text in the language of the certificate.
fn named(name: &str, text: &str) -> Element {
    Element::of(name, vec![Element::text("dcc:content", text).with("lang", "en")])
}

/// A number with all its digits.
pub fn number(value: f64) -> String {
    format!("{value:e}")
}

/// A factor or a probability: the schema takes no exponent there.
pub fn plain(value: f64) -> String {
    value.to_string()
}

/// A name in a list whose items are separated by white space.
fn label(name: &str) -> String {
    name.split_whitespace().collect::<Vec<_>>().join("_")
}

/// The files that the results rest on, with their SHA-256: by their names alone, wherever they lay when the estimate was made.
pub(crate) fn measured_files(calibration: &Calibration) -> impl Iterator<Item = (&str, &str)> {
    calibration.data.iter().filter_map(|record| {
        let name = Path::new(&record.file).file_name().and_then(|name| name.to_str());
        Some((name.unwrap_or(&record.file), record.sha256.as_deref()?))
    })
}

/// A text without the characters that XML does not have.
fn printable(text: &str) -> String {
    text.chars().map(|letter| if letter.is_control() { '?' } else { letter }).collect()
}
