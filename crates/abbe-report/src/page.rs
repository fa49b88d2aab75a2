//! The page as one file.

use sha2::{Digest, Sha256};

use crate::analysis::main_fit;
use crate::base64::base64;
use crate::html::{details, escape};
use crate::run::{FitResult, Run};
use crate::sections::{
    Scene, acceptance, budget, causes, compared, correlations, curves, has_lobes, history, parameters, probe,
    provenance, residuals, selection, tables, trend, untold, verdict,
};

const STYLE: &str = include_str!("style.css");
const SCRIPT: &str = concat!(include_str!("script.js"), include_str!("machine.js"), include_str!("viewer.js"));

/// Viewers of a page at most: browsers draw in space on some canvases only. Other runs have their plane views.
const VIEWERS: usize = 8;

/// Parts of each of several runs that the list of parts names.
const LISTED: [&str; 4] = ["-verdict", "-causes", "-residuals", "-scene"];

/// One page about one run, or about several beside each other.
pub fn page(runs: &[Run]) -> String {
    let title = match runs {
        [one] => one.title.clone(),
        _ => format!("{} calibrations beside each other", runs.len()),
    };
    let names: Vec<&str> = runs.iter().map(|run| run.name.as_str()).collect();
    whole(&title, &names, &parts_of(runs))
}

/// The parts of such a page: identifier, name and content.
pub fn parts_of(runs: &[Run]) -> Vec<(String, String, String)> {
    let mut parts: Vec<(String, String, String)> = Vec::new();
    let mut part = |id: &str, name: &str, html: &str| parts.push((id.to_owned(), name.to_owned(), html.to_owned()));
    if runs.len() > 1 {
        part("compared", "Beside each other", &compared(runs));
        part("history", "From run to run", &history(runs));
    }
    for (number, run) in runs.iter().enumerate() {
        // One run has short names.
        let (id, of) = match runs.len() {
            1 => (String::new(), String::new()),
            _ => (format!("{}-", number + 1), format!(", {}", run.name)),
        };
        part(&format!("{id}verdict"), &format!("Verdict{of}"), &verdict(run));
        for (stage, analysis, quality) in &run.trends {
            let verdict = run.verdicts.iter().find(|verdict| verdict.stage == *stage);
            let remarks = verdict.map_or(&[][..], |verdict| &verdict.remarks);
            part(&format!("{id}{stage}"), &format!("Over time, {stage}{of}"), &trend(analysis, quality, remarks));
        }
        let charts = acceptance(run);
        if !charts.is_empty() {
            part(&format!("{id}acceptance"), &format!("Acceptance tests{of}"), &charts);
        }
        let worst = causes(run);
        if !worst.is_empty() {
            part(&format!("{id}causes"), &format!("Worst figure and causes{of}"), &worst);
        }
        // Readings that are judged as they are have no unknowns.
        if !run.fits.is_empty() {
            part(&format!("{id}untold"), &format!("What the data cannot tell{of}"), &untold(run));
        }
    }
    let named: Vec<(String, &FitResult)> = runs
        .iter()
        .flat_map(|run| run.fits.iter().map(move |fit| (run, fit)))
        .map(|(run, fit)| (if runs.len() == 1 { fit.name.clone() } else { format!("{}: {}", run.name, fit.name) }, fit))
        .collect();
    if !named.is_empty() {
        part("parameters", "Parameters", &parameters(&named));
    }
    let selections: String = named
        .iter()
        .map(|(name, fit)| (name, selection(fit)))
        .filter(|(_, html)| !html.is_empty())
        .map(|(name, html)| details(name, true, &html))
        .collect();
    if !selections.is_empty() {
        part("selection", "Selected by prediction", &selections);
    }
    let mains: Vec<(&str, &FitResult)> =
        runs.iter().filter_map(|run| Some((run.name.as_str(), main_fit(run)?))).collect();
    for (number, run) in runs.iter().enumerate() {
        let (id, of) = match runs.len() {
            1 => (String::new(), String::new()),
            _ => (format!("{}-", number + 1), format!(", {}", run.name)),
        };
        let main = main_fit(run);
        let view = main.map(|main| Scene::of(main, runs.len().min(VIEWERS)));
        let viewer = (number < VIEWERS).then_some(number + 1);
        let linked = viewer.zip(view.as_ref());
        if !run.fits.is_empty() {
            part(&format!("{id}residuals"), &format!("Residuals{of}"), &all_residuals(run, main, linked));
        }
        if let (Some(view), Some(main)) = (view, main) {
            // The first viewer shows the fields of the other runs as well.
            let others = mains.iter().skip(1).filter(|_| number == 0).copied().collect::<Vec<_>>();
            let html = view.section(viewer, main, &others);
            if !html.is_empty() {
                part(&format!("{id}scene"), &format!("Where it was measured, {}{of}", main.name), &html);
            }
        }
        if let Some(main) = main.filter(|main| !main.model.info().error_functions.is_empty()) {
            let heading = format!("Errors along axes, {}{of}", main.name);
            part(&format!("{id}curves"), &heading, &curves(main));
        }
        let is_main = |fit: &FitResult| main.is_some_and(|main| main.name == fit.name);
        let probes = run.fits.iter().filter(|fit| has_lobes(fit));
        let probes: String = probes.map(|fit| details(&fit.name, is_main(fit), &probe(fit))).collect();
        if !probes.is_empty() {
            part(&format!("{id}probe"), &format!("Probe{of}"), &probes);
        }
        if let Some(main) = main {
            part(&format!("{id}correlations"), &format!("Correlations, {}{of}", main.name), &correlations(main));
        }
        part(&format!("{id}figures"), &format!("Fits and validators{of}"), &tables(run));
        let budgets = run.fits.iter().filter(|fit| fit.calibration.uncertainty.is_some());
        let budgets: String = budgets.map(|fit| details(&fit.name, false, &budget(fit))).collect();
        if !budgets.is_empty() {
            part(&format!("{id}budget"), &format!("Budgets of uncertainty{of}"), &budgets);
        }
        part(&format!("{id}provenance"), &format!("Provenance{of}"), &provenance(run));
    }
    parts
}

/// The residuals of all estimates; those of the main one are open, and linked to its viewer.
fn all_residuals(run: &Run, main: Option<&FitResult>, view: Option<(usize, &Scene<'_>)>) -> String {
    let is_main = |fit: &FitResult| main.is_some_and(|main| main.name == fit.name);
    let known = run.fits.iter().filter(|fit| !fit.residuals.rows.is_empty() || !fit.calibration.outliers.is_empty());
    let html: String = known
        .map(|fit| details(&fit.name, is_main(fit), &residuals(fit, view.filter(|_| is_main(fit)), &run.verdicts)))
        .collect();
    if html.is_empty() { "<p>No residuals are known.</p>\n".to_owned() } else { html }
}

/// The page with its parts: identifier, name and content.
pub fn whole(title: &str, names: &[&str], parts: &[(String, String, String)]) -> String {
    let body: String = parts
        .iter()
        .map(|(id, name, html)| format!("<section id=\"{id}\">\n<h2>{}</h2>\n{html}</section>\n", escape(name)))
        .collect();
    let is_listed = |id: &str| {
        let of_one = id.starts_with(|first: char| first.is_ascii_digit());
        !of_one || LISTED.iter().any(|end| id.ends_with(end))
    };
    let links: String = parts
        .iter()
        .filter(|(id, ..)| is_listed(id))
        .map(|(id, name, _)| format!("<li><a href=\"#{id}\">{}</a></li>\n", escape(name)))
        .collect();
    let policy = format!(
        "default-src 'none'; style-src 'sha256-{}'; script-src 'sha256-{}'; base-uri 'none'; form-action 'none'",
        hash(STYLE),
        hash(SCRIPT)
    );
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta http-equiv=\"Content-Security-Policy\" \
         content=\"{policy}\">\n<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<meta name=\"color-scheme\" \
         content=\"light dark\">\n<title>{title}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<a class=\"skip\" \
         href=\"#main\">To the content</a>\n<header>\n<h1>{title}</h1>\n<p>{names}</p>\n<nav aria-label=\"Parts of the \
         page\">\n<ul>\n{links}</ul>\n</nav>\n</header>\n<main id=\"main\">\n{body}</main>\n<script>{SCRIPT}</script>\n</body>\n</html>\n",
        title = escape(title),
        names = escape(&names.join(", ")),
    )
}

/// SHA-256 of a text as base64, as content security policies have it.
fn hash(text: &str) -> String {
    base64(&Sha256::digest(text.as_bytes()))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use abbe_core::{Calibration, Figure, Findings, Limit, Quantities, Verdict};
    use serde_json::json;

    /// The result of readings that are no geometry: no axes, no rows.
    fn without_a_machine() -> Run {
        let text = json!({
            "abbe_calibration": 1,
            "estimate": "spindle",
            "model": { "plugin": "growth", "settings": {} },
            "parameters": [
                { "name": "gain", "value": 0.002, "unit": "mm", "standard_uncertainty": 1e-4, "status": "estimated" },
                { "name": "time_constant_s", "value": 900, "unit": "s", "standard_uncertainty": 20, "status": "estimated" },
            ],
            "artefacts": [],
            "covariance": { "order": ["gain", "time_constant_s"], "rows": [[1e-8, 0], [0, 400]] },
            "outliers": [],
            "fit": {
                "observations": 100, "unknowns": 2, "rank": 2, "condition": 1, "degrees_of_freedom": 98, "sigma": 1,
                "iterations": 1, "termination": "converged", "residual_max_um": 0, "residual_mean_abs_um": 0,
                "residual_rms_um": 0, "null_space": []
            }
        });
        let calibration = Calibration::from_json(&text.to_string()).unwrap();
        let model = Arc::new(Quantities::of(&calibration).unwrap());
        let figure = Figure::new("spindle", "growth", 12.0, "um").uncertain(0.5).limited(Limit::from(10.0));
        let findings =
            Findings { figures: vec![figure], remarks: vec!["a <remark>".to_owned()], ..Findings::default() };
        Run {
            name: "warm".to_owned(),
            title: "A spindle & its \"growth\"".to_owned(),
            fits: vec![FitResult::new("spindle", calibration, model, crate::Residuals::default())],
            verdicts: vec![Verdict::new("judge", "growth", findings)],
            trends: Vec::new(),
            acceptance: Vec::new(),
            record: None,
            recipe: None,
        }
    }

    #[test]
    fn an_estimate_without_a_machine_has_a_page() {
        let run = without_a_machine();
        let page = page(std::slice::from_ref(&run));
        for part in
            ["✗</span> Fail", "gain", "time_constant_s", "there is no volumetric error", "a &lt;remark&gt;", "120 %"]
        {
            assert!(page.contains(part), "{part}: {page}");
        }
        assert!(page.contains("<title>A spindle &amp; its &quot;growth&quot;</title>"));
        assert!(!page.contains("NaN") && !page.contains("class=\"viewer\""));
        assert_eq!(super::page(std::slice::from_ref(&run)), page);
    }

    #[test]
    fn a_run_without_estimates_has_a_page() {
        let run = Run { fits: Vec::new(), ..without_a_machine() };
        let told = page(&[run]);
        assert!(told.contains("id=\"verdict\"") && told.contains("id=\"causes\"") && told.contains("id=\"figures\""));
        // What only an estimate has is left out.
        for part in ["untold", "parameters", "residuals"] {
            assert!(!told.contains(&format!("id=\"{part}\"")) && !told.contains(&format!("#{part}\"")), "{part}");
            assert!(page(&[without_a_machine()]).contains(&format!("id=\"{part}\"")), "{part}");
        }
        assert!(!told.contains("Nothing is lost") && !told.contains("The fits"), "{told}");
    }

    #[test]
    fn the_policy_allows_the_own_script_and_style_alone() {
        let page = page(&[without_a_machine()]);
        let between = |start: &str, end: &str| {
            let from = page.find(start).unwrap() + start.len();
            page[from..][..page[from..].find(end).unwrap()].to_owned()
        };
        let policy = between("Content-Security-Policy\" content=\"", "\"");
        assert!(policy.starts_with("default-src 'none'; "), "{policy}");
        for (start, end) in [("<style>", "</style>"), ("<script>", "</script>")] {
            assert!(policy.contains(&format!("'sha256-{}'", hash(&between(start, end)))), "{start}");
            assert_eq!(page.matches(start).count(), 1);
        }
        assert!(!policy.contains("unsafe"));
    }
}
