//! What the data cannot tell, and which measurement would.

use abbe_core::Status;

use crate::analysis::main_fit;
use crate::html::{details, escape, list, paragraph};
use crate::run::{FitResult, Run};

/// Most directions that are listed for one estimate.
const MOST: usize = 12;

/// The section.
pub fn untold(run: &Run) -> String {
    let mut html = String::new();
    let main = main_fit(run).map(|fit| fit.name.as_str());
    let (first, others): (Vec<&FitResult>, Vec<&FitResult>) =
        run.fits.iter().partition(|fit| Some(fit.name.as_str()) == main);
    html.extend(first.into_iter().map(of_fit));
    let others: String = others.into_iter().map(of_fit).collect();
    if !others.is_empty() {
        html.push_str(&details("The other estimates", html.is_empty(), &others));
    }
    let remarks = run.record.iter().flat_map(|record| &record.remarks);
    let remarks: Vec<String> = remarks.map(|remark| format!("{}: {}", remark.estimate, remark.text)).collect();
    if !remarks.is_empty() {
        html.push_str("<h3>Look at this before you trust the results</h3>\n");
        html.push_str(&list(&remarks));
    }
    if html.is_empty() {
        html = paragraph("Nothing is lost: the data determine everything that was estimated.");
    }
    html + &main_fit(run).map_or(String::new(), assumed)
}

/// Errors of the machine that the main estimate takes as they are: nothing here tells how large they are.
fn assumed(fit: &FitResult) -> String {
    let info = fit.model.info();
    let is_fixed = |name: &str| fit.calibration.get(name).is_some_and(|known| known.status == Status::Fixed);
    let of_machine = info.parameters.iter().filter(|parameter| abbe_volumetric::is_machine_error(parameter.role));
    let names: Vec<&str> = of_machine.map(|parameter| parameter.name.as_str()).filter(|name| is_fixed(name)).collect();
    if names.is_empty() {
        return String::new();
    }
    let more = if names.len() > MOST { format!(", and {} more", names.len() - MOST) } else { String::new() };
    let names = names[..names.len().min(MOST)].join(", ");
    paragraph(&format!("Not estimated but taken as given: {names}{more}. Nothing here tells how large these are."))
}

fn of_fit(fit: &FitResult) -> String {
    let report = &fit.calibration.fit;
    let mut items = String::new();
    for direction in report.null_space.iter().take(MOST) {
        items.push_str(&format!("<li>{}", escape(&direction.describe())));
        if !direction.separated_by.is_empty() {
            items.push_str(".<br><b>To do:</b> ");
            items.push_str(&escape(&direction.separated_by.join("; or ")));
        }
        items.push_str("</li>\n");
    }
    if report.null_space.len() > MOST {
        items.push_str(&format!(
            "<li>{} more directions stand in the calibration</li>\n",
            report.null_space.len() - MOST
        ));
    }
    for same in &report.equivalent_motion_errors {
        items.push_str(&format!("<li>{}</li>\n", escape(&same.describe())));
    }
    if let Some(budget) = &fit.calibration.uncertainty {
        // Places on an artefact go together because the artefact moves as a whole: they say nothing of the machine.
        let of_machine = |name: &str| fit.calibration.parameters.iter().any(|parameter| parameter.name == name);
        let mut pairs: Vec<_> =
            budget.correlations.iter().filter(|pair| of_machine(&pair.one) && of_machine(&pair.other)).collect();
        pairs.sort_by(|one, other| other.correlation.abs().total_cmp(&one.correlation.abs()));
        let named =
            pairs.iter().take(5).map(|pair| format!("{} and {} ({:+.3})", pair.one, pair.other, pair.correlation));
        if !pairs.is_empty() {
            let more = if pairs.len() > 5 { format!(", and {} more pairs", pairs.len() - 5) } else { String::new() };
            let text = format!("hardly told apart: {}{more}", named.collect::<Vec<_>>().join(", "));
            items.push_str(&format!("<li>{}</li>\n", escape(&text)));
        }
    }
    for value in &report.implausible {
        items.push_str(&format!("<li>{}</li>\n", escape(&format!("{}: no machine has such an error", value.name))));
    }
    if items.is_empty() { items } else { format!("<h3>{}</h3>\n<ul>\n{items}</ul>\n", escape(&fit.name)) }
}
