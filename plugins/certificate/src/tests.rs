use abbe_core::{CALIBRATION_FORMAT, from_settings};
use serde_json::{Value, json};

use super::*;

/// A value of a certificate as a reader finds it.
#[derive(Debug, PartialEq)]
struct Stated {
    label: String,
    value: f64,
    unit: String,
    expanded: f64,
    factor: f64,
}

/// What a reader that shares no code with the writer finds: values, and the covariance by columns.
fn read(text: &str) -> (Vec<Stated>, Vec<Vec<f64>>) {
    let document = roxmltree::Document::parse(text).expect("XML");
    let words = |name: &str| -> Vec<String> {
        let node = document.descendants().find(|node| node.tag_name().name() == name).expect("the element");
        node.text().expect("its text").split(' ').map(str::to_owned).collect()
    };
    let numbers = |name: &str| -> Vec<f64> { words(name).iter().map(|word| word.parse().expect("a number")).collect() };
    let (values, expanded, factors) =
        (numbers("valueXMLList"), numbers("uncertaintyXMLList"), numbers("coverageFactorXMLList"));
    let units = words("unitXMLList");
    let listed = words("labelXMLList").into_iter().enumerate().map(|(at, label)| Stated {
        label,
        value: values[at],
        unit: units[at].clone(),
        expanded: expanded[at],
        factor: factors[at],
    });
    let columns = document.descendants().filter(|node| node.tag_name().name() == "column");
    let covariance = columns.map(|column| {
        let cells = column.descendants().filter(|node| node.tag_name().name() == "value");
        cells.map(|cell| cell.text().expect("a text").parse().expect("a number")).collect()
    });
    (listed.collect(), covariance.collect())
}

fn calibration() -> Calibration {
    let parameter = |name: &str, value: f64, unit: &str, u: f64, status: &str| json!({ "name": name, "value": value, "unit": unit, "standard_uncertainty": u, "status": status });
    let text = json!({
        "abbe_calibration": CALIBRATION_FORMAT,
        "estimate": "fit",
        "model": { "plugin": "serial-chain", "settings": {} },
        "parameters": [
            parameter("EXX[1]", -1.2e-5, "mm/mm", 3e-7, "estimated"),
            parameter("EB0C", 4.5e-5, "rad", 2e-6, "estimated"),
            parameter("EXB[2]", 7.25e-3, "mm/rad^2", 1e-3, "estimated"),
            parameter("EYY[1]", 1e-6, "1", 0.0, "fixed"),
        ],
        "artefacts": [],
        "covariance": {
            "order": ["EB0C", "EXX[1]", "EXB[2]"],
            "rows": [[4e-12, 1e-13, 0.0], [1e-13, 9e-14, 2e-11], [0.0, 2e-11, 1e-6]],
        },
        "data": [{ "file": "data/of a customer/touches & more.csv", "sha256": "ab".repeat(32), "rows": [[1, 9]] }],
        "outliers": [],
        "fit": {
            "observations": 9, "unknowns": 3, "rank": 3, "condition": 1, "degrees_of_freedom": 6, "sigma": 1,
            "iterations": 1, "termination": "converged", "residual_max_um": 0, "residual_mean_abs_um": 0,
            "residual_rms_um": 0, "null_space": []
        }
    });
    Calibration::from_json(&text.to_string()).expect("a calibration")
}

fn built(settings: &Value) -> Result<Dcc, SettingsError> {
    let settings: Settings = from_settings(settings)?;
    settings.check().map(|()| Dcc { settings })
}

fn written(settings: &Value, calibration: &Calibration) -> Result<String> {
    let dcc = built(settings).expect("settings");
    certificate(&dcc.settings, calibration, &certified(&dcc.settings.parameters, calibration)?)
}

#[test]
fn a_reader_finds_values_units_uncertainties_and_covariance() {
    let (stated, covariance) = read(&written(&example(), &calibration()).expect("a certificate"));
    let normal = 1.959_963_984_540_054;
    let expected = [
        ("EXX[1]", -1.2e-5, r"\one", 3e-7),
        ("EB0C", 4.5e-5, r"\radian", 2e-6),
        ("EXB[2]", 7.25e-3, r"\milli\metre\radian\tothe{-2}", 1e-3),
    ];
    assert_eq!(stated.len(), expected.len());
    for (found, (label, value, unit, u)) in stated.iter().zip(expected) {
        assert_eq!((found.label.as_str(), found.value, found.unit.as_str()), (label, value, unit));
        assert!((found.factor - normal).abs() < 1e-9, "{found:?}");
        assert!((found.expanded / (normal * u) - 1.0).abs() < 1e-9, "{found:?}");
    }
    assert_eq!(covariance, [[9e-14, 1e-13, 2e-11], [1e-13, 4e-12, 0.0], [2e-11, 0.0, 1e-6]]);
    // The schema takes no exponents in factors and probabilities.
    let text = written(&example(), &calibration()).expect("a certificate");
    let document = roxmltree::Document::parse(&text).expect("XML");
    for node in document.descendants().filter(|node| node.tag_name().name().starts_with("coverage")) {
        let texts = node.text().expect("a text").split(' ');
        texts.for_each(|text| assert!(text.bytes().all(|byte| byte == b'.' || byte.is_ascii_digit()), "{text}"));
    }
    // The ellipsoid: chi-squared with three degrees of freedom at 0.95 is 7.8147 (tables).
    let joint = document.descendants().find(|node| node.tag_name().name() == "coverageFactor").expect("the factor");
    let joint: f64 = joint.text().expect("a text").parse().expect("a number");
    assert!((joint * joint - 7.8147).abs() < 1e-4, "{joint}");
}

/// What is written is read by the reader of certificates, which shares no code with the writer: values, uncertainties, covariance.
#[test]
fn what_is_written_is_read_in_both_versions() {
    let calibration = calibration();
    for version in ["3.2.1", "3.3"] {
        let mut settings = example();
        settings["version"] = json!(version);
        let text = written(&settings, &calibration).expect("a certificate");
        assert!(text.contains(&format!("schemaVersion=\"{}", if version == "3.3" { "3.3.0" } else { version })));
        let item = |item: &str| abbe_dcc::CertificateFile {
            path: String::new(),
            item: abbe_core::Label(item.to_owned()),
            quantity: None,
        };
        let file = std::path::Path::new("certificate.xml");
        let read = abbe_dcc::DigitalCertificate::parse(file, &text, &item("123")).expect("the certificate");
        assert_eq!((read.identifier.as_str(), read.laboratory.as_str()), ("CAL-2026-0412", "Laboratory"));
        assert_eq!(read.remarks, Vec::<String>::new());
        let estimated = ["EXX[1]", "EB0C", "EXB[2]"];
        let index = |name: &str| {
            let parameter = calibration.parameters.iter().find(|parameter| parameter.name == name).expect("it");
            (read.of_unit(name, parameter.unit.parse().expect("a unit")).expect("the value"), parameter.value)
        };
        for one in estimated {
            let (here, value) = index(one);
            assert!((read.value(here) / value - 1.0).abs() < 1e-14, "{one}");
            for other in estimated {
                let expected = calibration.covariance.block(&[one, other])[(0, 1)];
                let found = read.covariance(here, index(other).0);
                assert!(
                    (found - expected).abs() <= 1e-12 * expected.abs(),
                    "{version} {one} {other}: {found} {expected}"
                );
            }
        }
        assert!(abbe_dcc::DigitalCertificate::parse(file, &text, &item("124")).is_err());
    }
}

/// Order of elements as the schema DCC 3.2.1 has it, and everything that only people know.
#[test]
fn the_certificate_says_who_what_and_when_in_the_order_of_the_schema() {
    let text = written(&example(), &calibration()).expect("a certificate");
    let document = roxmltree::Document::parse(&text).expect("XML");
    let children = |name: &str| -> Vec<String> {
        let node = document.descendants().find(|node| node.tag_name().name() == name).expect("the element");
        let elements = node.children().filter(roxmltree::Node::is_element);
        elements.map(|child| child.tag_name().name().to_owned()).collect()
    };
    for (name, expected) in [
        ("digitalCalibrationCertificate", "administrativeData measurementResults"),
        (
            "coreData",
            "countryCodeISO3166_1 usedLangCodeISO639_1 mandatoryLangCodeISO639_1 uniqueIdentifier beginPerformanceDate \
             endPerformanceDate performanceLocation",
        ),
        ("item", "name manufacturer model identifications"),
        ("contact", "name location"),
        ("respPerson", "person role mainSigner"),
        (
            "measurementResult",
            "name usedMethods usedSoftware measuringEquipments influenceConditions results measurementMetaData",
        ),
        ("realListXMLList", "labelXMLList valueXMLList unitXMLList expandedUncXMLList ellipsoidalRegionXMLList"),
    ] {
        assert_eq!(children(name).join(" "), expected, "{name}");
    }
    for words in
        ["CAL-2026-0412", "head of the laboratory", "touches &amp; more.csv", &"ab".repeat(32), "ISO 230-1:2012"]
    {
        assert!(text.contains(words), "{words}");
    }
    assert!(!text.contains("of a customer"), "where files lay is nobody's affair");
}

#[test]
fn what_only_people_know_has_no_default() {
    let example = example();
    let keys = example.as_object().expect("settings").keys();
    for key in keys {
        let mut other = example.clone();
        other.as_object_mut().expect("settings").remove(key);
        let error = built(&other).err().unwrap_or_else(|| panic!("{key} is not needed"));
        assert!(error.to_string().contains(key.as_str()), "{key}: {error}");
    }
    for (pointer, value, words) in [
        ("/laboratory/name", json!(" "), "is empty"),
        ("/laboratory/country", json!("Germany"), "two capital letters"),
        ("/customer/city", json!("Town\u{1b}[2J"), "control characters"),
        ("/begin", json!("2026-02-30"), "a day as"),
        ("/end", json!("2026-03-01"), "not before `begin`"),
        ("/persons", json!([]), "at least one"),
        ("/conditions/0/unit", json!("furlong"), "no unit of a condition"),
        ("/conditions/0/from", json!(30), "the smaller number first"),
    ] {
        let mut other = example.clone();
        *other.pointer_mut(pointer).expect("a setting") = value;
        let error = built(&other).err().unwrap_or_else(|| panic!("{pointer} passes"));
        assert!(error.to_string().contains(words), "{pointer}: {error}");
    }
}

/// EB0C is 45 µrad with u = 2 µrad: the guard band of 1.65 u is 3.3 µrad on either side of a limit.
#[test]
fn conformity_is_stated_by_the_rule() {
    let calibration = calibration();
    let stated = |limits: Value| -> Result<Vec<[String; 3]>> {
        let mut settings = example();
        settings["limits"] = limits;
        let text = written(&settings, &calibration)?;
        let document = roxmltree::Document::parse(&text).expect("XML");
        let of = |node: roxmltree::Node<'_, '_>, name: &str| {
            let found = node.descendants().find(|node| node.tag_name().name() == name);
            found.and_then(|node| node.text()).map(str::to_owned)
        };
        let data = document.descendants().filter(|node| node.tag_name().name() == "metaData");
        Ok(data.filter_map(|node| Some([of(node, "conformity")?, of(node, "norm")?, of(node, "value")?])).collect())
    };
    let rule = "iso-14253-1-2017";
    for (limit, decision, status, norm) in [
        (48.4, rule, "pass", "ISO 14253-1:2017"),
        (48.2, rule, "conditionalPass", "ISO 14253-1:2017"),
        (44.9, rule, "conditionalFail", "ISO 14253-1:2017"),
        (41.6, rule, "fail", "ISO 14253-1:2017"),
        (45.1, "simple", "pass", "JCGM 106:2012, 8.2 (simple acceptance)"),
        (44.9, "simple", "fail", "JCGM 106:2012, 8.2 (simple acceptance)"),
    ] {
        let found = stated(json!({ "EB0C": { "limit": limit, "decision": decision }, "E*[2]": 1 }));
        assert!(found.is_err_and(|error| error.to_string().contains("EXB[2] has the unit mm/rad^2")));
        let found = stated(json!({ "E*0C": 1, "EB0C": { "limit": limit, "decision": decision } })).expect("statements");
        assert_eq!(found.len(), 1);
        assert_eq!((found[0][0].as_str(), found[0][1].as_str()), (status, norm), "{limit} {decision}");
        let written: f64 = found[0][2].parse().expect("a number");
        assert!((written / (limit * 1e-6) - 1.0).abs() < 1e-12, "{written}");
    }
    assert_eq!(stated(json!({ "EXX*": 12.1, "EB0C": 10 })).expect("statements").len(), 2);
    assert!(stated(json!({ "EYY*": 1 })).is_err_and(|error| error.to_string().contains("no certified parameter")));
    let mut settings = example();
    settings["limits"] = json!({ "EB0C": -1 });
    assert!(built(&settings).is_err_and(|error| error.to_string().contains("limits.EB0C")));
}

#[test]
fn only_what_is_determined_is_certified() {
    let mut calibration = calibration();
    let mut some = example();
    some["parameters"] = json!(["E??[*]"]);
    assert_eq!(read(&written(&some, &calibration).expect("a certificate")).0.len(), 2);
    some["parameters"] = json!(["EYY*"]);
    assert!(written(&some, &calibration).expect_err("fixed").to_string().contains("no estimated parameter"));
    calibration.parameters[1].status = Status::Confounded;
    let error = written(&example(), &calibration).expect_err("confounded");
    assert!(error.to_string().contains("do not determine EB0C"), "{error}");
}

/// Settings with all that ISO/IEC 17025 asks for.
fn complete() -> Value {
    let mut all = example();
    for (pointer, key, value) in [
        ("", "issued", "2026-03-09"),
        ("", "deviations", "none"),
        ("", "adjustment", "none"),
        ("/laboratory", "street", "Way 1 <b>"),
        ("/laboratory", "post_code", "12345"),
        ("/customer", "e_mail", "quality@example.org"),
        ("/item", "condition", "as used in production"),
        ("/equipment/0", "traceability", "certificate 12 of a laboratory"),
    ] {
        all.pointer_mut(pointer).expect("a map")[key] = json!(value);
    }
    all
}

fn read_page(settings: &Value) -> String {
    let draft: Draft = from_settings(settings).expect("settings");
    draft.check().expect("settings");
    let calibration = calibration();
    page(&draft, &calibration, &certified(&draft.parameters, &calibration).expect("parameters")).expect("a page")
}

/// Every element that ISO/IEC 17025 asks for: without it the page is a draft that names it; with all it is none.
#[test]
fn a_page_is_a_draft_until_all_is_there() {
    // Title and heading say what the page is.
    let called = |page: &str, title: &str| {
        page.contains(&format!("<title>{title} ")) && page.contains(&format!("<h1>{title}</h1>"))
    };
    let page = read_page(&complete());
    assert!(called(&page, "Calibration certificate") && page.contains("End of certificate"), "{page}");
    assert!(
        !page.contains("DRAFT: ") && !page.contains("class=\"gap\"") && !page.contains("class=\"draft\""),
        "{page}"
    );
    for (pointer, key, words) in [
        ("", "identifier", "7.8.2.1 d"),
        ("", "begin", "7.8.2.1 i"),
        ("", "end", "7.8.2.1 i"),
        ("", "place", "7.8.2.1 c"),
        ("", "issued", "7.8.2.1 j"),
        ("", "deviations", "7.8.2.1 n"),
        ("", "adjustment", "7.8.4.1 d"),
        ("", "laboratory", "7.8.2.1 b"),
        ("/laboratory", "street", "7.8.2.1 b"),
        ("", "persons", "7.8.2.1 o"),
        ("", "customer", "7.8.2.1 e"),
        ("/customer", "e_mail", "7.8.2.1 e"),
        ("", "item", "7.8.2.1 g"),
        ("/item", "condition", "7.8.2.1 g"),
        ("", "methods", "7.8.2.1 f"),
        ("", "equipment", "7.8.4.1 c"),
        ("/equipment/0", "traceability", "7.8.4.1 c"),
        ("", "conditions", "7.8.4.1 b"),
    ] {
        let mut some = complete();
        some.pointer_mut(pointer).and_then(Value::as_object_mut).expect("a map").remove(key);
        let page = read_page(&some);
        let banner =
            page.split("class=\"banner\"").nth(1).and_then(|rest| rest.split("</div>").next()).expect("a banner");
        assert!(banner.contains(words), "{key}: {banner}");
        assert_eq!(banner.matches("<li>").count(), 1, "{key}: {banner}");
        let title = "Draft of a calibration certificate";
        assert!(called(&page, title) && !page.contains("<h1>Calibration"), "{key}");
        assert!(page.contains("End of draft") && !page.contains("End of certificate"), "{key}");
    }
    let nothing = read_page(&json!({}));
    assert!(nothing.matches("<li>").count() >= 12, "{nothing}");
    assert!(nothing.contains("12.0") && nothing.contains("DRAFT"), "results stand there all the same");
}

/// Numbers to two digits of U, units for people; what people write cannot become markup.
#[test]
fn a_page_states_values_for_people() {
    let mut settings = complete();
    settings["limits"] = json!({ "EB0C": { "limit": 48.2, "decision": "iso-14253-1-2017" } });
    let page = read_page(&settings);
    for words in [
        "<td class=\"number\">\u{2212}12.00</td><td class=\"number\">0.59</td><td>µm/m</td>",
        "<td class=\"number\">45.0</td><td class=\"number\">3.9</td><td>µrad</td>",
        "Way 1 &lt;b&gt;",
        "touches &amp; more.csv",
        "not decided",
        "ISO 14253-1:2017",
        "95 %",
        "End of certificate CAL-2026-0412",
        "relate to the item that was calibrated only",
    ] {
        assert!(page.contains(words), "{words}: {page}");
    }
    assert!(!page.contains("of a customer"));
    for wrong in [
        json!({ "begin": "2026-02-30" }),
        json!({ "identifier": " " }),
        json!({ "begin": "2026-03-02", "end": "2026-03-01" }),
    ] {
        let draft: Draft = from_settings(&wrong).expect("settings");
        assert!(draft.check().is_err(), "{wrong}");
    }
}
