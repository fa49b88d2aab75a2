//! Certificates that are written here, in the manner of the public examples of the PTB.

use std::path::Path;

use abbe_core::{Label, Unit};

use super::*;

/// A certificate with an item, its results and what else stands behind them.
fn certificate(version: &str, results: &str, conditions: &str) -> String {
    format!(
        r#"<?xml version="1.0" encoding="UTF-8"?>
<dcc:digitalCalibrationCertificate xmlns:dcc="https://ptb.de/dcc" xmlns:si="https://ptb.de/si" schemaVersion="{version}">
<dcc:administrativeData>
<dcc:coreData><dcc:uniqueIdentifier>2031-PL-7</dcc:uniqueIdentifier></dcc:coreData>
<dcc:items><dcc:item><dcc:name><dcc:content lang="en">ball plate</dcc:content></dcc:name><dcc:identifications>
<dcc:identification><dcc:issuer>manufacturer</dcc:issuer><dcc:value> KP-88 </dcc:value></dcc:identification>
</dcc:identifications></dcc:item></dcc:items>
<dcc:calibrationLaboratory><dcc:contact><dcc:name><dcc:content>Length laboratory</dcc:content></dcc:name></dcc:contact>
</dcc:calibrationLaboratory></dcc:administrativeData>
<dcc:measurementResults><dcc:measurementResult>{conditions}<dcc:results><dcc:result><dcc:data>
{results}
</dcc:data></dcc:result></dcc:results></dcc:measurementResult></dcc:measurementResults>
</dcc:digitalCalibrationCertificate>"#
    )
}

fn read(text: &str) -> Result<DigitalCertificate> {
    read_as(text, "KP-88", None)
}

fn read_as(text: &str, item: &str, quantity: Option<&str>) -> Result<DigitalCertificate> {
    let settings =
        CertificateFile { path: String::new(), item: Label(item.to_owned()), quantity: quantity.map(str::to_owned) };
    DigitalCertificate::parse(Path::new("plate.xml"), text, &settings)
}

fn refused(text: &str) -> String {
    read(text).expect_err("refused").to_string()
}

fn near(found: f64, expected: f64) -> bool {
    (found - expected).abs() <= 1e-12 * expected.abs()
}

/// Two lengths, in metres and micrometres.
const LENGTHS: &str = r"<dcc:quantity><si:realListXMLList><si:labelXMLList>L1 L2</si:labelXMLList>
<si:valueXMLList>0.1000002 200001.5</si:valueXMLList><si:unitXMLList>\metre \micro\metre</si:unitXMLList>
<si:expandedUncXMLList><si:uncertaintyXMLList>4e-7 0.6</si:uncertaintyXMLList><si:coverageFactorXMLList>2
</si:coverageFactorXMLList><si:coverageProbabilityXMLList>0.95</si:coverageProbabilityXMLList></si:expandedUncXMLList>
</si:realListXMLList></dcc:quantity>";

#[test]
fn expanded_uncertainties_become_standard_ones_in_millimetres() {
    let found = read(&certificate("3.2.1", LENGTHS, "")).expect("a certificate");
    assert_eq!((found.identifier.as_str(), found.laboratory.as_str()), ("2031-PL-7", "Length laboratory"));
    for (label, length, uncertainty) in [("L1", 100.0002, 2e-4), ("L2", 200.0015, 3e-4)] {
        let index = found.find(label, Unit::MM).expect("a length");
        assert!(near(found.value(index), length) && near(found.standard_uncertainty(index), uncertainty), "{label}");
    }
    assert_eq!(found.remarks, Vec::<String>::new());
    let error = found.find("L3", Unit::MM).expect_err("none").to_string();
    assert!(error.contains("no value `L3` in mm") && error.contains("`L1`"), "{error}");
    assert!(found.only(Unit::MM).expect_err("two").to_string().contains("several values in mm: `L1`, `L2`"));
    assert!(found.find("L1", Unit::RAD).is_err());
    assert!(found.of_unit("L1", Unit::RAD).expect_err("mm").to_string().contains("none of rad"));
}

/// D-SI 2.2 has other names for the same.
#[test]
fn both_ways_to_name_uncertainties_are_read() {
    let new = r"<dcc:quantity><si:realListXMLList><si:labelXMLList>1.x 1.y</si:labelXMLList><si:valueXMLList>10 20
</si:valueXMLList><si:unitXMLList>\milli\metre</si:unitXMLList><si:measurementUncertaintyUnivariateXMLList>
<si:expandedMUXMLList><si:valueExpandedMUXMLList>0.003</si:valueExpandedMUXMLList><si:coverageFactorXMLList>3
</si:coverageFactorXMLList></si:expandedMUXMLList></si:measurementUncertaintyUnivariateXMLList>
<si:measurementUncertaintyMultivariateXMLList><si:ellipsoidalRegionMUXMLList><si:covarianceMatrixXMLList>
<si:columnXMLList><si:covarianceXMLList><si:valueXMLList>1.0 0.5</si:valueXMLList><si:unitXMLList>\micro\metre\tothe{2}
</si:unitXMLList></si:covarianceXMLList></si:columnXMLList><si:columnXMLList><si:covarianceXMLList><si:valueXMLList>0.5 1
</si:valueXMLList><si:unitXMLList>\micro\metre\tothe{2}</si:unitXMLList></si:covarianceXMLList></si:columnXMLList>
</si:covarianceMatrixXMLList></si:ellipsoidalRegionMUXMLList></si:measurementUncertaintyMultivariateXMLList>
</si:realListXMLList></dcc:quantity>";
    let found = read(&certificate("3.3.0", new, "")).expect("a certificate");
    let [x, y] = ["1.x", "1.y"].map(|label| found.find(label, Unit::MM).expect("a length"));
    assert!(near(found.standard_uncertainty(x), 1e-3) && near(found.covariance(x, y), 0.5e-6));
    let standard = LENGTHS
        .replace("expandedUncXMLList>", "standardMUXMLList>")
        .replace("uncertaintyXMLList>", "valueStandardMUXMLList>");
    let found = read(&certificate("3.3.0", &standard, "")).expect("a certificate");
    assert!(near(found.standard_uncertainty(found.find("L1", Unit::MM).expect("L1")), 4e-4));
}

fn covariance(entries: [[&str; 2]; 2]) -> String {
    let column = |column: usize| {
        let entry = |row: usize| {
            format!(
                r"<si:covariance><si:value>{}</si:value><si:unit>\milli\metre\milli\metre</si:unit></si:covariance>",
                entries[row][column]
            )
        };
        format!("<si:column>{}{}</si:column>", entry(0), entry(1))
    };
    let region = format!(
        "<si:ellipsoidalRegionXMLList><si:covarianceMatrix>{}{}</si:covarianceMatrix></si:ellipsoidalRegionXMLList>",
        column(0),
        column(1)
    );
    let with = LENGTHS.replace("</si:realListXMLList>", &format!("{region}</si:realListXMLList>"));
    certificate("3.2.1", &with, "")
}

/// The inputs give the covariance back: C = sum of c_ik c_jk u_k².
#[test]
fn inputs_have_the_covariance_of_the_certificate() {
    let found = read(&covariance([["4e-8", "-5e-8"], ["-5e-8", "9e-8"]])).expect("a certificate");
    let [one, other] = ["L1", "L2"].map(|label| found.find(label, Unit::MM).expect("a length"));
    let errors = Errors::new(&found, &[(other, "second".to_owned())], 0);
    assert_eq!(errors.inputs.len(), 2, "the list makes the inputs, whichever of its values is used");
    let names: Vec<&str> = errors.inputs.iter().map(|input| input.parameter.name.as_str()).collect();
    assert_eq!(names, ["certificate[L1]", "second"]);
    let errors = Errors::new(&found, &[(one, "a".to_owned()), (other, "b".to_owned())], 0);
    let product = |one: ValueIndex, other: ValueIndex| -> f64 {
        let of = |index: ValueIndex, input: usize| {
            errors.of(index).iter().find(|(own, _)| *own == input).map_or(0.0, |(_, factor)| *factor)
        };
        let inputs = errors.inputs.iter().enumerate();
        inputs.map(|(k, input)| of(one, k) * of(other, k) * input.standard_uncertainty.powi(2)).sum()
    };
    assert!(near(product(one, one), 4e-8) && near(product(other, other), 9e-8) && near(product(one, other), -5e-8));
    assert!(near(errors.error(other, &[2.0, 1.0]), 2.0 * -1.25 + 1.0));
    // The same certificate makes the same inputs; another number or another value makes others.
    let again = read(&covariance([["4e-8", "-5e-8"], ["-5e-8", "9e-8"]])).expect("a certificate");
    let identity = |certificate: &DigitalCertificate| {
        let index = certificate.find("L1", Unit::MM).expect("L1");
        Errors::new(certificate, &[(index, "x".to_owned())], 0).inputs[0].certificate().identity()
    };
    assert_eq!(identity(&found), identity(&again));
    let other = covariance([["4e-8", "-5e-8"], ["-5e-8", "9e-8"]]).replace("2031-PL-7", "2032-PL-1");
    assert_ne!(identity(&found), identity(&read(&other).expect("a certificate")));
    // Values that are the same error have one input.
    let found = read(&covariance([["4e-8", "6e-8"], ["6e-8", "9e-8"]])).expect("a certificate");
    let errors =
        Errors::new(&found, &[(one, "a".to_owned()), (found.find("L2", Unit::MM).expect("L2"), "b".to_owned())], 0);
    assert_eq!(errors.inputs.len(), 1);
    assert!(near(errors.error(found.find("L2", Unit::MM).expect("L2"), &[1.0]), 1.5));
}

#[test]
fn a_covariance_that_is_none_is_refused() {
    for (entries, words) in [
        ([["4e-8", "0"], ["0", "16e-8"]], "U / k gives it 3"),
        ([["4e-8", "7e-8"], ["7e-8", "9e-8"]], "no correlation from -1 to 1"),
        ([["4e-8", "1e-8"], ["2e-8", "9e-8"]], "or two of them"),
        ([["-4e-8", "0"], ["0", "9e-8"]], "negative"),
    ] {
        let error = refused(&covariance(entries));
        assert!(error.contains(words), "{error}");
    }
    let text = covariance([["4e-8", "0"], ["0", "9e-8"]]);
    assert!(refused(&text.replacen("<si:column>", "<si:column/><si:column>", 1)).contains("3 entries where"));
    assert!(
        refused(&text.replacen(r"\milli\metre\milli\metre", r"\milli\metre", 1)).contains("no unit of a covariance")
    );
}

/// The three ways in which coordinates are told.
#[test]
fn points_are_found_by_labels_names_and_lists() {
    let real = |name: &str, value: &str| {
        format!(
            r"<dcc:quantity><dcc:name><dcc:content lang='de'>Koordinate {name}</dcc:content><dcc:content lang='en'>{name}</dcc:content>
</dcc:name><si:real><si:value>{value}</si:value><si:unit>\milli\metre</si:unit><si:expandedUnc><si:uncertainty>0.0004
</si:uncertainty><si:coverageFactor>2</si:coverageFactor></si:expandedUnc></si:real></dcc:quantity>"
        )
    };
    let in_lists = ["A", "B"].map(|point| {
        let name = format!("<dcc:name><dcc:content>{point}</dcc:content></dcc:name>");
        let by = if point == "A" { "0" } else { "50.001" };
        format!("<dcc:list>{name}{}{}</dcc:list>", real("X", by), real("Y", "-0.002"))
    });
    let list = |kind: &str, values: &str| {
        format!(
            r"<dcc:quantity refType='plate_{kind}'><si:realListXMLList><si:valueXMLList>{values}</si:valueXMLList>
<si:unitXMLList>\milli\metre</si:unitXMLList></si:realListXMLList></dcc:quantity>"
        )
    };
    let labels = "<dcc:quantity><dcc:charsXMLList>A B</dcc:charsXMLList></dcc:quantity>";
    let in_columns = format!("<dcc:list>{labels}{}{}</dcc:list>", list("x", "0 50.001"), list("y", "-0.002 -0.002"));
    let labelled = LENGTHS
        .replace("L1 L2", "A.x A.y B.x B.y")
        .replace("0.1000002 200001.5", "0 -0.002 50.001 -0.002")
        .replace(r"\metre \micro\metre", r"\milli\metre")
        .replace("4e-7 0.6", "0.0004");
    for (text, has_uncertainty) in [(in_lists.concat(), true), (in_columns, false), (labelled, true)] {
        let found = read(&certificate("3.2.1", &text, "")).expect("a certificate");
        let points = found.points().expect("points");
        assert_eq!(points.iter().map(|point| point.label.as_str()).collect::<Vec<_>>(), ["A", "B"], "{text}");
        let [x, y, z] = points[1].coordinates;
        assert_eq!((found.value(x.expect("x")), found.value(y.expect("y")), z), (50.001, -0.002, None));
        assert_eq!(found.standard_uncertainty(x.expect("x")) > 0.0, has_uncertainty);
    }
    let text = certificate("3.2.1", &real("X", "1"), "");
    assert!(read(&text).expect("a certificate").points().expect_err("no name").to_string().contains("no coordinates"));
    let text = certificate("3.2.1", &list("x", "0 1"), "");
    assert!(
        read(&text)
            .expect("a certificate")
            .points()
            .expect_err("no y")
            .to_string()
            .contains("all coordinates of point `1`")
    );
}

#[test]
fn a_quantity_is_chosen_where_one_label_stands_twice() {
    let nominal = LENGTHS.replace("<dcc:quantity>", "<dcc:quantity refType='basic_nominalValue'>");
    let found = read(&certificate("3.2.1", &format!("{nominal}{LENGTHS}"), "")).expect("a certificate");
    assert_eq!(found.quantities.len(), 1);
    let [first, second] = ["gauge_first", "gauge_second"]
        .map(|kind| LENGTHS.replace("<dcc:quantity>", &format!("<dcc:quantity refType='{kind}'>")));
    let text = certificate("3.2.1", &format!("{first}{second}"), "");
    let error = read(&text).expect("a certificate").find("L1", Unit::MM).expect_err("twice").to_string();
    assert!(error.contains("`L1` is stated twice") && error.contains("`quantity`"), "{error}");
    assert!(read_as(&text, "KP-88", Some("gauge_second")).expect("one").find("L1", Unit::MM).is_ok());
    assert!(read_as(&text, "KP-88", Some("third")).expect_err("none").to_string().contains("name or refType `third`"));
}

#[test]
fn what_has_to_be_known_is_told() {
    let warm = |value: &str, unit: &str| {
        format!(
            r"<dcc:influenceConditions><dcc:influenceCondition refType='basic_temperature'><dcc:data><dcc:quantity><si:real>
<si:value>{value}</si:value><si:unit>{unit}</si:unit></si:real></dcc:quantity></dcc:data></dcc:influenceCondition>
</dcc:influenceConditions>"
        )
    };
    let remarks = |text: &str| read(text).expect("a certificate").remarks.join("; ");
    assert_eq!(remarks(&certificate("3.2.1", LENGTHS, &warm("20.4", r"\degreecelsius"))), "");
    assert_eq!(remarks(&certificate("3.2.1", LENGTHS, &warm("293.5", r"\kelvin"))), "");
    let told = remarks(&certificate("3.2.1", LENGTHS, &warm("23.5", r"\degreecelsius")));
    assert!(told.contains("calibrated at 23.50 °C to 23.50 °C"), "{told}");
    let signed = certificate("3.2.1", LENGTHS, "")
        .replace("</dcc:digitalCal", "<ds:Signature xmlns:ds='http://www.w3.org/2000/09/xmldsig#'/></dcc:digitalCal");
    assert!(remarks(&signed).contains("signature was not checked"));
    let fails = LENGTHS.replace(
        "</dcc:quantity>",
        "<dcc:x><dcc:conformity>fail</dcc:conformity><dcc:valid>false</dcc:valid></dcc:x></dcc:quantity>",
    );
    let told = remarks(&certificate("3.2.1", &fails, ""));
    assert!(told.contains("does not conform") && told.contains("not valid"), "{told}");
}

#[test]
fn what_is_no_certificate_of_the_item_is_refused_with_its_line() {
    let good = certificate("3.2.1", LENGTHS, "");
    let error = read_as(&good, "KP-89", None).expect_err("another").to_string();
    assert!(error.contains("is of `KP-88`; the item `KP-89` was expected") && error.contains("plate.xml:5"), "{error}");
    for (text, words) in [
        (good.replace("3.2.1", "2.4.0"), "of version 3 was expected"),
        (good.replace("digitalCalibrationCertificate", "other"), "<other"),
        (good[..good.len() / 2].to_owned(), "no XML"),
        (good.replace("?>\n", "?>\n<!DOCTYPE x [<!ENTITY a 'aaaaaaaaaa'>]>\n"), "has a DTD"),
        (good.replace("0.1000002", "0,1000002"), "`0,1000002` in <valueXMLList>; a number was expected"),
        (good.replace("0.1000002", "NaN"), "a number was expected"),
        (good.replace("0.1000002", "0.1000<!-- a -->002"), "a comment inside of a text"),
        (good.replace("L1 L2", "L1"), "1 labels for 2 values"),
        (good.replace("4e-7 0.6", "4e-7 0.6 1"), "3 entries in <uncertaintyXMLList> for 2 values"),
        (good.replace("4e-7 0.6", "-4e-7"), "at least 0"),
        (good.replace(">2\n", ">0\n"), "above 0"),
        (good.replace("coverageFactorXMLList", "other"), "no coverageFactor"),
        (good.replace("unitXMLList", "other"), "a <unitXMLList> was expected"),
        (good.replace("quantity>", "other>"), "states no value"),
        (good.replace("uniqueIdentifier", "other"), "no uniqueIdentifier"),
    ] {
        let error = refused(&text);
        assert!(error.contains(words) && error.contains("plate.xml"), "{words}: {error}");
    }
    assert!(refused(&good.replace("0.1000002", &"1 ".repeat(2000))).contains("1 to 1000 were expected"));
}

/// Elements in elements without an end neither overflow the stack nor take long.
#[test]
fn deep_nesting_ends() {
    let deep = "<dcc:list>".repeat(100_000);
    let ends = "</dcc:list>".repeat(100_000);
    let text = certificate("3.2.1", &format!("{deep}{LENGTHS}{ends}"), "");
    // Refused or read: either ends.
    let _ = read(&text);
}
