//! The certificate as a page for people: one file of HTML that prints on A4, with the elements of ISO/IEC 17025:2017, 7.8.2.1 and 7.8.4.1.

use std::fmt::Write as _;

use abbe_core::{Calibration, Error, Estimated, Result, Unit};
use abbe_numerics::coverage_factor;

use crate::conformity::{self, Statement};
use crate::contents::{measured_files, statements};
use crate::draft::Draft;
use crate::settings::{Contact, Place};
use crate::symbols::meaning;

/// How the page looks, on a screen and on paper.
const STYLE: &str = include_str!("page.css");

/// The page.
///
/// Fails for degrees of freedom that give no coverage factor, and for limits of parameters that have none.
pub fn page(draft: &Draft, calibration: &Calibration, certified: &[&Estimated]) -> Result<String> {
    let missing = draft.missing();
    let number = draft.identifier.as_deref().map_or_else(gap, escaped);
    let mut html = String::new();
    let title = title(&missing);
    let _ = write!(
        html,
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\n<title>{title} {}</title>\n<style>\n{STYLE}</style></head>\n\
         <body{}>\n<div class=\"running\">{title} {number}</div>\n",
        draft.identifier.as_deref().map_or_else(String::new, escaped),
        if missing.is_empty() { "" } else { " class=\"draft\"" }
    );
    html.push_str(&head(draft, &number, title, &missing));
    html.push_str(&item(draft));
    html.push_str(&measurement(draft));
    html.push_str(&results(draft, calibration, certified)?);
    html.push_str(&conformity(&conformity::statements(&draft.filled(), certified)?));
    html.push_str(&remarks(draft, calibration));
    html.push_str(&signature(draft));
    let what = if missing.is_empty() { "certificate" } else { "draft" };
    let _ = write!(html, "<p class=\"end\">End of {what} {number}</p>\n</body></html>\n");
    Ok(html)
}

/// What the page is: nothing that lacks an element is called a certificate.
fn title(missing: &[String]) -> &'static str {
    if missing.is_empty() { "Calibration certificate" } else { "Draft of a calibration certificate" }
}

/// A text as HTML has it.
fn escaped(text: &str) -> String {
    let escape = |letter: char| match letter {
        '&' => "&amp;".to_owned(),
        '<' => "&lt;".to_owned(),
        '>' => "&gt;".to_owned(),
        '"' => "&quot;".to_owned(),
        letter if letter.is_control() => "?".to_owned(),
        letter => letter.to_string(),
    };
    text.chars().map(escape).collect()
}

/// What stands where something is missing.
fn gap() -> String {
    "<span class=\"gap\">missing</span>".to_owned()
}

fn or_gap(text: Option<&str>) -> String {
    text.map_or_else(gap, escaped)
}

/// A table of two columns: names and what they are, which is HTML.
fn facts(rows: &[(&str, String)]) -> String {
    let row = |(name, what): &(&str, String)| format!("<tr><th>{name}</th><td>{what}</td></tr>\n");
    format!("<table class=\"facts\">\n{}</table>\n", rows.iter().map(row).collect::<String>())
}

fn list(items: impl Iterator<Item = String>) -> String {
    format!("<ul>{}</ul>\n", items.map(|item| format!("<li>{item}</li>")).collect::<String>())
}

fn address(contact: Option<&Contact>) -> String {
    let Some(contact) = contact else { return gap() };
    let town = [contact.post_code.as_deref(), Some(contact.city.as_str())].into_iter().flatten().collect::<Vec<_>>();
    let town = format!("{}, {}", town.join(" "), contact.country);
    let lines = [Some(contact.name.as_str()), contact.street.as_deref(), Some(&town), contact.e_mail.as_deref()];
    lines.into_iter().flatten().map(escaped).collect::<Vec<_>>().join("<br>")
}

/// Title, what is missing, and who it is from and for.
fn head(draft: &Draft, number: &str, title: &str, missing: &[String]) -> String {
    let mut html = format!("<h1>{title}</h1>\n");
    if !missing.is_empty() {
        let items = missing.iter().map(|what| escaped(what).replace('`', ""));
        let _ = write!(
            html,
            "<div class=\"banner\"><strong>DRAFT: this is no certificate yet.</strong> ISO/IEC 17025:2017 asks for:\n{}</div>\n",
            list(items)
        );
    }
    let days = match (draft.begin.as_deref(), draft.end.as_deref()) {
        (Some(begin), Some(end)) if begin == end => escaped(begin),
        (begin, end) => format!("{} to {}", or_gap(begin), or_gap(end)),
    };
    let mut rows = vec![
        ("Number", number.to_owned()),
        ("Laboratory", address(draft.laboratory.as_ref())),
        ("Customer", address(draft.customer.as_ref())),
        ("Place of calibration", draft.place.map_or_else(gap, |place| place_of(place, draft))),
        ("Days of calibration", days),
        ("Day of issue", or_gap(draft.issued.as_deref())),
    ];
    if let Some(received) = &draft.received {
        rows.insert(4, ("Item received", escaped(received)));
    }
    html.push_str(&facts(&rows));
    html
}

fn place_of(place: Place, draft: &Draft) -> String {
    let town =
        |contact: Option<&Contact>| contact.map_or_else(gap, |it| escaped(&format!("{}, {}", it.city, it.country)));
    match place {
        Place::Laboratory => format!("at the laboratory, {}", town(draft.laboratory.as_ref())),
        Place::Customer => format!("at the customer's, {}", town(draft.customer.as_ref())),
        Place::LaboratoryBranch => "at a branch of the laboratory".to_owned(),
        Place::CustomerBranch => "at a branch of the customer".to_owned(),
        Place::Other => "elsewhere".to_owned(),
    }
}

fn item(draft: &Draft) -> String {
    let of =
        |text: fn(&crate::settings::Item) -> &str| draft.item.as_ref().map_or_else(gap, |item| escaped(text(item)));
    let condition = draft.item.as_ref().and_then(|item| item.condition.as_deref());
    let rows = [
        ("Item", of(|item| &item.name)),
        ("Manufacturer", of(|item| &item.manufacturer)),
        ("Type", of(|item| &item.model)),
        ("Serial number", of(|item| &item.serial_number)),
        ("Condition", or_gap(condition)),
        ("Adjustment", draft.adjustment.map_or_else(gap, |adjustment| adjustment.words().to_owned())),
    ];
    format!("<h2>Item</h2>\n{}", facts(&rows))
}

/// Methods, equipment with its traceability, conditions.
fn measurement(draft: &Draft) -> String {
    let methods = draft.methods.iter().map(|method| match method.norms.is_empty() {
        true => escaped(&method.name),
        false => escaped(&format!("{} ({})", method.name, method.norms.join(", "))),
    });
    let equipment = draft.equipment.iter().map(|one| {
        let named = escaped(&format!("{}, number {}", one.name, one.serial_number));
        format!("{named}. Traceable by: {}", or_gap(one.traceability.as_deref()))
    });
    let conditions = draft.conditions.iter().map(|one| {
        let unit = match one.unit.as_str() {
            "degC" => "°C",
            "um" => "µm",
            "1" => "",
            unit => unit,
        };
        let range = if one.from == one.to { format!("{}", one.from) } else { format!("{} to {}", one.from, one.to) };
        escaped(format!("{}: {range} {unit}", one.name).trim_end())
    });
    let or_missing = |items: Vec<String>| if items.is_empty() { gap() } else { list(items.into_iter()) };
    let rows = [
        ("Methods", or_missing(methods.collect())),
        ("Deviations from the methods", or_gap(draft.deviations.as_deref())),
        ("Equipment", or_missing(equipment.collect())),
        ("Conditions", or_missing(conditions.collect())),
    ];
    format!("<h2>Measurement</h2>\n{}", facts(&rows))
}

/// A value with its expanded uncertainty to two significant digits of the latter (GUM 7.2.6).
fn rounded(value: f64, expanded: f64) -> [String; 2] {
    // A rehearsal has uncertainties of zero.
    let decimals = if expanded > 0.0 && expanded.is_finite() { 1 - expanded.log10().floor() as i32 } else { -1 };
    match usize::try_from(decimals).ok().filter(|decimals| *decimals <= 9) {
        Some(decimals) => [value, expanded].map(|number| format!("{number:.decimals$}")),
        None => [format!("{value:.3e}"), format!("{expanded:.1e}")],
    }
    .map(|number| match number.trim_matches(['-', '0', '.']).is_empty() {
        true => number.trim_start_matches('-').to_owned(),
        false => number.replace('-', "\u{2212}"),
    })
}

fn results(draft: &Draft, calibration: &Calibration, certified: &[&Estimated]) -> Result<String> {
    let probability = draft.coverage_probability.unwrap_or(0.95);
    let mut rows = String::new();
    for one in certified {
        let unit: Unit = one.unit.parse().map_err(|message: String| Error::data(message))?;
        let (unit, factor) = unit.for_people();
        let k = coverage_factor(probability, calibration.degrees_of_freedom(|name| name == one.name));
        if !k.is_finite() {
            return Err(Error::usage(format!("the degrees of freedom of {} are too few for an uncertainty", one.name)));
        }
        let [value, expanded] = rounded(one.value * factor, k * one.standard_uncertainty * factor);
        let _ = writeln!(
            rows,
            "<tr><td class=\"symbol\">{}</td><td>{}</td><td class=\"number\">{value}</td><td class=\"number\">{expanded}</td><td>{}</td>\
             <td class=\"number\">{k:.2}</td></tr>",
            escaped(&one.name),
            escaped(&meaning(&one.name)),
            escaped(&unit)
        );
    }
    Ok(format!(
        "<h2>Results</h2>\n<table class=\"results\">\n<thead><tr><th>Symbol</th><th>Error of the machine, actual less nominal</th>\
         <th>Value</th><th>U</th><th>Unit</th><th>k</th></tr></thead>\n<tbody>\n{rows}</tbody></table>\n\
         <p>U is the expanded uncertainty: the standard uncertainty times the coverage factor k, for a coverage probability of {} % \
         (JCGM 100:2008, 6; degrees of freedom are counted). Symbols as in ISO 230-1; 1 µm/m = 10<sup>−6</sup>. The values are \
         correlated: their covariance stands in the digital certificate and in the file of the calibration.</p>\n",
        (probability * 1e4).round() / 1e2
    ))
}

fn conformity(stated: &[Statement]) -> String {
    if stated.is_empty() {
        return "<h2>Conformity</h2>\n<p>Nothing is stated about conformity.</p>\n".to_owned();
    }
    let row = |one: &Statement| {
        let status = match one.status {
            "pass" => "conforms",
            "fail" => "does not conform",
            "conditionalPass" => "within the limit by less than the guard band: not decided",
            _ => "beyond the limit by less than the guard band: not decided",
        };
        let what = one.declaration.split_once(": ").map_or(one.declaration.as_str(), |(_, numbers)| numbers);
        let what = what.replace(" um", " µm").replace(" urad", " µrad");
        let cells = [one.parameter.as_str(), &what, one.rule, status].map(escaped);
        format!(
            "<tr><td class=\"symbol\">{}</td><td>{}</td><td>{}</td><td>{}</td></tr>\n",
            cells[0], cells[1], cells[2], cells[3]
        )
    };
    format!(
        "<h2>Conformity</h2>\n<table class=\"results\"><thead><tr><th>Symbol</th><th>Value and limit</th><th>Decision rule</th>\
         <th>Statement</th></tr></thead>\n<tbody>\n{}</tbody></table>\n",
        stated.iter().map(row).collect::<String>()
    )
}

/// Statements, software and the data that the results rest on.
fn remarks(draft: &Draft, calibration: &Calibration) -> String {
    let settings = draft.filled();
    let stated = statements(&settings)
        .filter(|(_, clause, _)| !clause.ends_with(['n', 'd']))
        .map(|(norm, clause, text)| format!("{} ({norm}, {clause})", escaped(&text)));
    let files: Vec<String> = measured_files(calibration)
        .map(|(name, hash)| format!("{} <code>SHA-256 {}</code>", escaped(name), escaped(hash)))
        .collect();
    let mut html = format!("<h2>Remarks</h2>\n{}", list(stated));
    let software = format!("Abbe {}, estimate {}", env!("CARGO_PKG_VERSION"), calibration.estimate);
    let mut rows = vec![("Software", escaped(&software))];
    if !files.is_empty() {
        rows.push(("Files of measured data", list(files.into_iter())));
    }
    html.push_str(&facts(&rows));
    html
}

fn signature(draft: &Draft) -> String {
    let person = |person: &crate::settings::Person| {
        format!(
            "<div class=\"person\"><div class=\"line\"></div>{}<br>{}</div>",
            escaped(&person.name),
            escaped(&person.role)
        )
    };
    let persons: String = draft.persons.iter().map(person).collect();
    let persons = if persons.is_empty() { gap() } else { persons };
    format!("<h2>Authorized by</h2>\n<div class=\"persons\">{persons}</div>\n")
}
