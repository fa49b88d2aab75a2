//! The summary of a run that fits on a screen: verdict first. `--verbose` prints all.

use std::borrow::Cow;
use std::io::{self, IsTerminal};
use std::path::Path;

use abbe_report::number::short;
use abbe_report::{
    FitResult, Run, decided, judged, judged_remarks, main_fit, micrometres, told_figure, undetermined, used,
};

use crate::lines::cut;

/// Lines of each part: figures with limits, estimates, what is lost, remarks, failures.
const FIGURES: usize = 3;
const ESTIMATES: usize = 6;
const LOST: usize = 2;
const REMARKS: usize = 2;
const FAILURES: usize = 3;
const CAUSES: usize = 3;
const SAID: usize = 6;

/// The summary; no line is longer than `width`, but for paths.
pub fn text(run: &Run, folder: &Path, width: usize) -> String {
    let (word, _, sentence) = decided(run);
    let mut lines = vec![format!("{}: {}", word.to_uppercase(), run.title)];
    lines.extend(wrapped(&format!("{sentence}{}", undetermined(run)), width));
    lines.extend(failures(run));
    lines.extend(figures(run));
    lines.extend(said(run));
    if let Some(fit) = main_fit(run) {
        lines.extend(volumetric(fit));
    }
    lines.push(String::new());
    if !run.fits.is_empty() {
        lines.extend(estimates(&run.fits));
    }
    lines.extend(lost(&run.fits));
    lines.extend(remarks(run));
    lines.push(String::new());
    let mut text: String = lines.iter().map(|line| cut(line, width) + "\n").collect();
    let folder = folder.display().to_string().replace('\n', "\u{240a}");
    text.push_str(&format!("Report: {}\n", Path::new(&folder).join(abbe_engine::REPORT).display()));
    text.push_str(&format!("Results: {folder} (all values here: --verbose)\n"));
    text
}

/// Lines of words that fit, with an indent.
fn wrapped(text: &str, width: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split_whitespace() {
        let last = lines.len() - 1;
        match 1 + lines[last].chars().count() + word.chars().count() > width && !lines[last].is_empty() {
            true => lines.push(format!("  {word}")),
            false => {
                let space = if lines[last].is_empty() { "  " } else { " " };
                lines[last].push_str(space);
                lines[last].push_str(word);
            }
        }
    }
    lines
}

fn more(lines: &mut Vec<String>, all: usize, shown: usize) {
    if all > shown {
        lines.push(format!("  {} more in the report", all - shown));
    }
}

fn failures(run: &Run) -> Vec<String> {
    let failures = run.record.as_ref().map_or(&[][..], |record| &record.failures);
    let told = failures.iter().take(FAILURES).map(|failure| {
        let message = failure.message.lines().next().unwrap_or_default();
        format!("  {} ({}): {message}", failure.stage, failure.kind.key())
    });
    let mut lines = told.collect();
    more(&mut lines, failures.len(), FAILURES);
    lines
}

/// The figures with limits, the worst first.
fn figures(run: &Run) -> Vec<String> {
    let all: Vec<_> = judged(run).collect();
    let told = all.iter().take(FIGURES).map(|(verdict, figure)| {
        let of = figure.of.as_ref().map_or(String::new(), |of| format!(" of {of}"));
        let (value, limit) = told_figure(figure);
        let value = if value.contains('±') { format!("{value} (k = 2)") } else { value };
        let limit = if limit.is_empty() { limit } else { format!(", limit {limit}") };
        let part = used(figure);
        let part = if part.is_finite() { format!(" ({:.0} %)", part * 100.0) } else { String::new() };
        let decision = figure.decision.map_or(String::new(), |decision| decision.to_string());
        format!("  {decision}: {} {}{of}: {value}{limit}{part}", verdict.stage, figure.name)
    });
    let mut lines = told.collect();
    more(&mut lines, all.len(), FIGURES);
    lines
}

/// Remarks of verdicts on a machine or tool: the first of each, then the second of each, and so on.
fn said(run: &Run) -> Vec<String> {
    let all: Vec<(&str, &[String])> =
        judged_remarks(run).map(|(verdict, remarks)| (verdict.stage.as_str(), remarks)).collect();
    let longest = all.iter().map(|(_, remarks)| remarks.len()).max().unwrap_or(0);
    let in_turn =
        (0..longest).flat_map(|turn| all.iter().filter_map(move |(stage, said)| Some((stage, said.get(turn)?))));
    let mut lines: Vec<String> = in_turn.map(|(stage, remark)| format!("  {stage}: {remark}")).collect();
    let count = lines.len();
    lines.truncate(SAID);
    more(&mut lines, count, SAID);
    lines
}

/// The volumetric error of an estimate and its largest causes.
fn volumetric(fit: &FitResult) -> Vec<String> {
    let Ok(Some(found)) = fit.analysis() else { return Vec::new() };
    let mut lines = vec![
        String::new(),
        format!(
            "Volumetric error by {}, k = 2: RMS {}, largest {}",
            fit.name,
            micrometres(found.rms),
            micrometres(found.largest)
        ),
        format!("  largest at {}", found.at),
    ];
    let causes: Vec<_> = found.causes.iter().filter(|cause| cause.part.loss.value > 0.0).take(CAUSES).collect();
    let wide = causes.iter().map(|cause| cause.name.chars().count()).max().unwrap_or(0);
    for cause in causes {
        let doubt = if cause.is_confounded { " ?" } else { "" };
        let (name, loss) = (&cause.name, micrometres(cause.part.loss));
        lines.push(format!("  without {name:<wide$}  RMS less by {loss}: {}{doubt}", cause.meaning));
    }
    lines
}

fn estimates(fits: &[FitResult]) -> Vec<String> {
    let mut lines = vec!["Estimates".to_owned()];
    let wide = fits.iter().map(|fit| fit.name.chars().count()).max().unwrap_or(0);
    for fit in fits.iter().take(ESTIMATES) {
        let report = &fit.calibration.fit;
        let mut line = format!("  {:<wide$}  {} unknowns, rank {}", fit.name, report.unknowns, report.rank);
        if report.observations > 0 {
            line.push_str(&format!(", {} equations, residual RMS ", report.observations));
            let angles = report.residual_rms_urad.map(|rms| format!("{} µrad", short(rms)));
            let lengths = (report.residual_rms_um > 0.0 || angles.is_none())
                .then(|| format!("{} µm", short(report.residual_rms_um)));
            let radial = report.residual_radial_rms_um.filter(|_| report.residual_rms_um > 0.0);
            let lengths = lengths.map(|lengths| match radial {
                Some(radial) => format!("{lengths} a coordinate, {} µm radial", short(radial)),
                None => lengths,
            });
            line.push_str(&lengths.into_iter().chain(angles).collect::<Vec<_>>().join(" and "));
            line.push_str(&format!(", sigma {}", short(report.sigma)));
        }
        let outliers = fit.calibration.outliers.len();
        if outliers > 0 {
            line.push_str(&format!(", {outliers} outlier{}", if outliers == 1 { "" } else { "s" }));
        }
        lines.push(line);
    }
    more(&mut lines, fits.len(), ESTIMATES);
    lines
}

fn lost(fits: &[FitResult]) -> Vec<String> {
    let all: Vec<String> = fits
        .iter()
        .flat_map(|fit| {
            let report = &fit.calibration.fit;
            // What to do stands first: it must not be cut.
            let lost = report.null_space.iter().map(|direction| match direction.separated_by.first() {
                Some(measurement) => format!("{measurement} ({})", direction.describe()),
                None => direction.describe(),
            });
            let same = report.equivalent_motion_errors.iter().map(abbe_core::EquivalentMotionError::describe);
            lost.chain(same).map(|text| format!("  {}: {text}", fit.name))
        })
        .collect();
    listed("Not determined, or by the choice of functions only", &all, LOST)
}

fn remarks(run: &Run) -> Vec<String> {
    let remarks = run.record.iter().flat_map(|record| &record.remarks);
    let all: Vec<String> = remarks.map(|remark| format!("  {}: {}", remark.estimate, remark.text)).collect();
    listed("Look at this first", &all, REMARKS)
}

fn listed(heading: &str, all: &[String], most: usize) -> Vec<String> {
    if all.is_empty() {
        return Vec::new();
    }
    let mut lines = vec![heading.to_owned()];
    lines.extend(all.iter().take(most).cloned());
    more(&mut lines, all.len(), most);
    lines
}

/// The text with coloured verdicts, on a terminal that may have colours.
pub fn coloured(text: &str) -> Cow<'_, str> {
    let wanted = io::stdout().is_terminal() && std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty());
    if wanted { painted(text).into() } else { text.into() }
}

/// What a line of a verdict begins with, and its colour.
const COLOURS: [(&str, &str); 11] = [
    ("PASS:", "1;32"),
    ("PASS, OF THE FIT ALONE:", "1"),
    ("FAIL:", "1;31"),
    ("FAILED:", "1;31"),
    ("INCONCLUSIVE:", "1;33"),
    ("NO LIMIT SET:", "1"),
    ("NO ESTIMATE:", "1"),
    ("NOTHING JUDGED:", "1"),
    ("  pass:", "32"),
    ("  fail:", "31"),
    ("  inconclusive:", "33"),
];

fn painted(text: &str) -> String {
    let line = |line: &str| {
        let found = COLOURS.iter().find_map(|(word, colour)| Some((*word, *colour, line.strip_prefix(word)?)));
        found.map_or(line.to_owned(), |(word, colour, rest)| format!("\u{1b}[{colour}m{word}\u{1b}[0m{rest}"))
    };
    text.split('\n').map(line).collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn verdicts_alone_are_coloured_and_lines_are_cut() {
        assert_eq!(painted("PASS: a\nso PASS: b\n"), "\u{1b}[1;32mPASS:\u{1b}[0m a\nso PASS: b\n");
        assert_eq!((cut("µµµµ", 4), cut("µµµµµ", 4)), ("µµµµ".to_owned(), "µµµ…".to_owned()));
        assert_eq!(cut("two\nlines", 20), "two lines");
        assert_eq!(wrapped("one two three four", 12), ["  one two", "  three four"]);
        assert_eq!(wrapped("", 12), [""]);
    }
}
