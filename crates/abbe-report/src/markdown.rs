//! A run as Markdown: what a comment of a CI needs, verdict first.

use std::fmt::Write;

use abbe_core::{Decision, Figure, Verdict};

use crate::analysis::{Analysis, main_fit};
use crate::number::short;
use crate::run::{FitResult, Run};
use crate::sections::{compared_cells, decided, judged, judged_remarks, micrometres, told_figure, undetermined, used};

/// Lines of each part; the page has all of them.
const FIGURES: usize = 10;
const CAUSES: usize = 3;
const LOST: usize = 10;
const REMARKS: usize = 10;

/// Headings of the table of several runs.
const COMPARED: [&str; 6] = ["run", "verdict", "estimate", "RMS volumetric error", "largest", "largest cause"];

/// One run, or several beside each other.
pub fn markdown(runs: &[Run]) -> String {
    let mut text = String::new();
    if runs.len() > 1 {
        let _ = writeln!(text, "# {} calibrations beside each other\n", runs.len());
        let rows: Vec<Vec<String>> = runs.iter().map(|run| compared_cells(run).to_vec()).collect();
        text.push_str(&table(&COMPARED, &rows));
        text.push_str("\n± is k = 2. Each run has its own travel.\n\n");
    }
    for run in runs {
        let (word, class, sentence) = decided(run);
        let mark = match class {
            "pass" => "✓ ",
            "fail" => "✗ ",
            _ => "",
        };
        let of = if runs.len() > 1 { format!(" ({})", plain(&run.name)) } else { String::new() };
        let _ = writeln!(text, "## {mark}{word}: {}{of}\n", plain(&run.title));
        let _ = writeln!(text, "{}\n", plain(&format!("{sentence}{}", undetermined(run))));
        text.push_str(&failures(run));
        text.push_str(&figures(run));
        if let Some(fit) = main_fit(run) {
            text.push_str(&volumetric(fit));
        }
        text.push_str(&listed("What the data cannot tell", &lost(&run.fits), LOST));
        let remarks = run.record.iter().flat_map(|record| &record.remarks);
        let remarks: Vec<String> = remarks.map(|remark| format!("{}: {}", remark.estimate, remark.text)).collect();
        text.push_str(&listed("Look at this before you trust the results", &remarks, REMARKS));
        text.push_str(&estimates(&run.fits));
    }
    text
}

/// Text that Markdown shows as it is.
fn plain(text: &str) -> String {
    let mut shown = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '\n' | '\r' | '\t' => shown.push(' '),
            '\\' | '`' | '*' | '_' | '[' | ']' | '<' | '>' | '|' | '#' | '~' | '&' | '$' => {
                shown.extend(['\\', letter])
            }
            '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' => shown.push('\u{fffd}'),
            letter if letter.is_control() => {}
            letter => shown.push(letter),
        }
    }
    shown
}

fn table(head: &[&str], rows: &[Vec<String>]) -> String {
    if rows.is_empty() {
        return String::new();
    }
    let mut text = format!("| {} |\n|{}\n", head.join(" | "), "---|".repeat(head.len()));
    for row in rows {
        let cells: Vec<String> = row.iter().map(|cell| plain(cell)).collect();
        let _ = writeln!(text, "| {} |", cells.join(" | "));
    }
    text
}

/// A list with its heading; nothing if it is empty.
fn listed(heading: &str, all: &[String], most: usize) -> String {
    if all.is_empty() {
        return String::new();
    }
    let mut text = format!("### {heading}\n\n");
    for one in all.iter().take(most) {
        let _ = writeln!(text, "- {}", plain(one));
    }
    if all.len() > most {
        let _ = writeln!(text, "- {} more in the report", all.len() - most);
    }
    text + "\n"
}

fn failures(run: &Run) -> String {
    let all = run.record.iter().flat_map(|record| &record.failures);
    let all: Vec<String> = all.map(|failure| format!("{}: {}", failure.stage, failure.message)).collect();
    listed("Stages without a result", &all, REMARKS)
}

fn figures(run: &Run) -> String {
    let all: Vec<(&Verdict, &Figure)> = judged(run).collect();
    let rows = all.iter().take(FIGURES).map(|(verdict, figure)| {
        let (value, limit) = told_figure(figure);
        let part = used(figure);
        let decision = figure.decision.unwrap_or(Decision::Inconclusive).to_string();
        let percent = if part.is_finite() { format!("{:.0} %", part * 100.0) } else { "–".to_owned() };
        let name = format!("{} {}", verdict.stage, figure.name);
        vec![decision, name, figure.of.clone().unwrap_or_default(), value, limit, percent]
    });
    let mut text = table(&["decision", "figure", "of", "value", "limit", "used"], &rows.collect::<Vec<_>>());
    if all.len() > FIGURES {
        let _ = writeln!(text, "\n{} more in the report.", all.len() - FIGURES);
    }
    if !text.is_empty() {
        text.push('\n');
    }
    let said = judged_remarks(run);
    let said: Vec<String> =
        said.flat_map(|(verdict, all)| all.iter().map(|remark| format!("{}: {remark}", verdict.stage))).collect();
    text + &listed("Remarks", &said, REMARKS)
}

fn volumetric(fit: &FitResult) -> String {
    let Ok(Some(found)) = Analysis::of(fit) else { return String::new() };
    let mut text = format!(
        "Volumetric error by {} (k = 2): RMS **{}**, largest **{}** at {}.\n\n",
        plain(&fit.name),
        plain(&micrometres(found.rms)),
        plain(&micrometres(found.largest)),
        plain(&found.at)
    );
    let causes = found.causes.iter().filter(|cause| cause.part.loss.value > 0.0).take(CAUSES);
    let rows = causes.map(|cause| {
        let loss = format!("{}{}", micrometres(cause.part.loss), if cause.is_proven() { "" } else { " (not proven)" });
        let doubt = if cause.is_confounded { " ?" } else { "" };
        let advice = cause.advice(found.rms.value).to_owned();
        vec![format!("{}{doubt}", cause.name), cause.meaning.clone(), cause.value.clone(), loss, advice]
    });
    let rows: Vec<Vec<String>> = rows.collect();
    text.push_str(&table(&["largest causes", "what it is", "value", "RMS less without it", "what to do"], &rows));
    if rows.is_empty() { text } else { text + "\n" }
}

fn lost(fits: &[FitResult]) -> Vec<String> {
    let of_fit = |fit: &FitResult| -> Vec<String> {
        let report = &fit.calibration.fit;
        let lost = report.null_space.iter().map(|direction| match direction.separated_by.is_empty() {
            true => direction.describe(),
            false => format!("{}. To do: {}", direction.describe(), direction.separated_by.join("; or ")),
        });
        let same = report.equivalent_motion_errors.iter().map(abbe_core::EquivalentMotionError::describe);
        lost.chain(same).map(|text| format!("{}: {text}", fit.name)).collect()
    };
    fits.iter().flat_map(of_fit).collect()
}

fn estimates(fits: &[FitResult]) -> String {
    let rows = fits.iter().map(|fit| {
        let report = &fit.calibration.fit;
        let counts = [report.observations, report.unknowns, report.rank].map(|count| count.to_string());
        let mut cells = vec![fit.name.clone()];
        cells.extend(counts);
        let radial = report.residual_radial_rms_um.map_or("–".to_owned(), short);
        cells.extend([short(report.residual_rms_um), radial, short(report.sigma)]);
        cells.push(fit.calibration.outliers.len().to_string());
        cells
    });
    let head = ["estimate", "equations", "unknowns", "rank", "residual RMS µm", "radial RMS µm", "sigma", "outliers"];
    let text = table(&head, &rows.collect::<Vec<_>>());
    if text.is_empty() { text } else { text + "\n" }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_from_files_becomes_markup() {
        assert_eq!(plain("a|b\n<img> `c` [d](e)_\u{202e}"), "a\\|b \\<img\\> \\`c\\` \\[d\\](e)\\_\u{fffd}");
        assert_eq!(
            table(&["one", "two"], &[vec!["1|".to_owned(), "2".to_owned()]]),
            "| one | two |\n|---|---|\n| 1\\| | 2 |\n"
        );
        assert_eq!(table(&["one"], &[]), "");
        assert_eq!(listed("All", &["a".to_owned(), "b".to_owned()], 1), "### All\n\n- a\n- 1 more in the report\n\n");
    }
}
