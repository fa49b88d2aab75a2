//! Certificates, checked by programs of the PTB: the Schematron of `dcclib`, and the schema where there is a copy of it.

use std::process::Command;

use crate::support::{Variant, recipes, root, skipped, temporary, write};

/// Prints what is wrong with a certificate; nothing if all is well. The version is known to be older than the newest one, and values of
/// several units in one list are a recommendation. `1` is a folder with the schemas `dcc.xsd` (3.2.1), `SI_Format.xsd` (2.1) and `xmldsig.xsd`,
/// of which nothing is fetched; `-` is none. Its folder `3.3` has those of DCC 3.3.0 with D-SI 2.2.
const CHECK: &str = r#"
import sys
from lxml import etree
from dcclib.validation.schematron import SchematronValidator
document = etree.parse(sys.argv[1])
found = SchematronValidator.for_dcc().validate_tree(document)
for report in list(found.failed_assertions) + list(found.successful_reports):
    if report.role == "error":
        print(report.test, report.text)
if sys.argv[2] != "-":
    schema = etree.XMLSchema(etree.parse(sys.argv[2] + "/dcc.xsd"))
    if not schema.validate(document):
        print(schema.error_log)
"#;

#[test]
fn certificates_are_what_the_ptb_expects() {
    let has = |module: &str| {
        let found = Command::new("python3").args(["-c", &format!("import {module}")]).output();
        found.is_ok_and(|found| found.status.success())
    };
    if !has("dcclib") {
        skipped("certificates_are_what_the_ptb_expects", "the Python package dcclib is not installed");
        return;
    }
    let schemas = std::env::var("ABBE_DCC_SCHEMAS").unwrap_or_else(|_| {
        skipped(
            "the schema of certificates",
            "ABBE_DCC_SCHEMAS names no folder with dcc.xsd, SI_Format.xsd and xmldsig.xsd",
        );
        "-".to_owned()
    });
    for (version, schemas) in [("3.2.1", schemas.clone()), ("3.3", format!("{schemas}/3.3"))] {
        let has_schema = std::path::Path::new(&schemas).join("dcc.xsd").is_file();
        if !has_schema && schemas != "-/3.3" && schemas != "-" {
            skipped("the schema of certificates", &format!("{schemas} has no dcc.xsd"));
        }
        check(version, if has_schema { &schemas } else { "-" });
    }
}

/// A certificate of this version is valid, and mistakes in it are found.
fn check(version: &str, schemas: &str) {
    let outcome = Variant::of(&recipes()["cylinder-uncertainty"])
        .only(&["fit-both", "certificate"])
        .set("certificate", "version", version.into())
        .run();
    let (_, files) = outcome.exports.iter().find(|(stage, _)| stage == "certificate").expect("the certificate");
    let folder = temporary();
    let check = |text: &str| {
        let file = folder.path().join("certificate.xml");
        write(&file, text);
        let found = Command::new("python3").args(["-c", CHECK]).arg(&file).arg(schemas).current_dir(root()).output();
        let found = found.expect("Python");
        assert!(found.status.success(), "{}", String::from_utf8_lossy(&found.stderr));
        String::from_utf8_lossy(&found.stdout).into_owned()
    };
    let text = String::from_utf8_lossy(&files[0].content).into_owned();
    assert_eq!(check(&text), "", "{version}");
    // A value that is missing, and days in the wrong order, are found.
    let list = if version == "3.3" { "<si:valueExpandedMUXMLList>" } else { "<si:uncertaintyXMLList>" };
    assert!(text.contains(list), "{text}");
    // The Schematron does not count the lists of D-SI 2.2.
    if version != "3.3" {
        assert_ne!(check(&text.replacen(list, &format!("{list}1e-6 "), 1)), "");
    }
    let end = "<dcc:endPerformanceDate>2016-06-14";
    assert!(text.contains(end), "{text}");
    assert_ne!(check(&text.replacen(end, "<dcc:endPerformanceDate>1999-01-01", 1)), "");
}
