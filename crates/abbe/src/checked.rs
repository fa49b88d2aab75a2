//! What `abbe check` found, for a terminal: the verdict first, and no sentence twice.

use abbe_core::{EstimateSource, Identifiability, Kind, WeakDirection};
use abbe_engine::Planned;
use abbe_recipe::Recipe;
use abbe_report::number::short;

use crate::summary::{ALIKE, columns, section};
use crate::{lines, table, uncertainty_summary};

/// Most lines without `--explain`.
const LINES: usize = 40;

/// Most characters of the name of a recipe.
const NAME: usize = 200;

/// What the planned fits can determine, in lines that fit the terminal; in at most [`LINES`] lines unless it is to be explained.
pub fn text(recipe: &Recipe, planned: &[Planned], explain: bool) -> String {
    within(recipe, planned, explain, lines::width())
}

fn within(recipe: &Recipe, planned: &[Planned], explain: bool, width: usize) -> String {
    let stages = lines::counted(recipe.stages.len(), "stage", "stages");
    let mut text = format!("{}: {stages}\n{}\n", lines::cut(&recipe.name, NAME), verdict(recipe, planned));
    if !planned.is_empty() {
        text.push_str(&section("\nPlanned fits, judged at nominal contact", &fits(planned, width)));
    }
    let lost = sentences(planned, |found| found.null_space.iter().map(WeakDirection::advise).collect());
    let alike = sentences(planned, |found| found.equivalent_motion_errors.iter().map(|same| same.describe()).collect());
    let remarks = sentences(planned, |found| found.remarks.clone());
    for (title, told) in [("Not determined", lost), (ALIKE, alike), ("Remarks", remarks)] {
        if !told.is_empty() {
            text.push_str(&format!("\n{}", section(title, &told)));
        }
    }
    if planned.is_empty() {
        return lines::wrapped(&text, width);
    }
    if !explain {
        return shortened(&text, width);
    }
    let explained: String = planned.iter().map(|planned| explained(planned, width)).collect();
    lines::wrapped(&(text + &explained), width)
}

/// One line that says whether everything is determined.
fn verdict(recipe: &Recipe, planned: &[Planned]) -> String {
    let is_whole = |planned: &&Planned| planned.identifiability.rank == planned.identifiability.unknowns;
    let refused: Vec<&str> =
        planned.iter().filter(|planned| !planned.accepted).map(|planned| planned.estimate.as_str()).collect();
    let lost: Vec<&str> = (planned.iter())
        .filter(|planned| planned.accepted && !is_whole(planned))
        .map(|planned| planned.estimate.as_str())
        .collect();
    match (planned.len(), refused.is_empty(), lost.is_empty()) {
        (0, ..) => unjudged(recipe),
        (1, true, true) => "PASS: the data determine all unknowns".to_owned(),
        (count, true, true) => format!("PASS: the data determine all unknowns of {count} fits"),
        (_, true, false) => format!("PASS, but not all unknowns are determined: {}", lost.join(", ")),
        (_, false, _) => format!("FAIL: the data do not determine what is estimated: {}", refused.join(", ")),
    }
}

/// What is told where no fit is planned.
fn unjudged(recipe: &Recipe) -> String {
    let estimates = || recipe.stages.iter().filter(|stage| stage.kind == Kind::Estimate);
    let why = match estimates().count() {
        0 => "nothing is estimated",
        _ if estimates().all(|stage| stage.estimate_source == EstimateSource::Readings) => {
            "what is estimated is made of readings alone"
        }
        _ => "no estimate here is a fit to observations of a machine",
    };
    format!("NOTHING JUDGED: {why}, so that no fit was judged; settings and data can be read")
}

fn fits(planned: &[Planned], width: usize) -> String {
    let mut rows = vec![["", "equations", "unknowns", "rank", "condition"].map(str::to_owned).to_vec()];
    for planned in planned {
        let found = &planned.identifiability;
        rows.push(vec![
            planned.estimate.clone(),
            found.observations.to_string(),
            found.unknowns.to_string(),
            found.rank.to_string(),
            short(found.condition),
        ]);
    }
    table::within(&rows, &columns(4, 1), 1, width)
}

/// Sentences about fits, each once, with the fits that it is about.
fn sentences(planned: &[Planned], of: impl Fn(&Identifiability) -> Vec<String>) -> String {
    let mut told: Vec<(String, Vec<&str>)> = Vec::new();
    for planned in planned {
        for sentence in of(&planned.identifiability) {
            match told.iter_mut().find(|(known, _)| *known == sentence) {
                Some((_, fits)) => fits.push(&planned.estimate),
                None => told.push((sentence, vec![&planned.estimate])),
            }
        }
    }
    told.into_iter().map(|(sentence, fits)| format!("  {}: {sentence}\n", named(&fits, planned.len()))).collect()
}

/// Fits that are named one by one.
const NAMED: usize = 4;

fn named(fits: &[&str], all: usize) -> String {
    match fits.len() {
        count if count == all && all > 1 => "all fits".to_owned(),
        count if count > NAMED => format!("{} and {} more fits", fits[..NAMED].join(", "), count - NAMED),
        _ => fits.join(", "),
    }
}

/// The first lines of a text, if a terminal of this width does not show more than [`LINES`] for them.
fn shortened(text: &str, width: usize) -> String {
    let more = "`--explain` shows what is determined worst, correlations and uncertainty budgets";
    let whole = lines::wrapped(text, width);
    if whole.lines().count() < LINES {
        return lines::wrapped(&format!("{whole}\n{more}\n").replacen("\n\n\n", "\n\n", 1), width);
    }
    let (mut left, mut shown, mut short) = (LINES - 3, 0, String::new());
    for line in text.lines() {
        if left == 0 {
            break;
        }
        // A sentence that is longer than what is left is cut.
        let most = left.min(MOST_ROWS);
        let mut rows = lines::rows(line, width);
        if rows.len() > most {
            rows.truncate(most);
            if let Some(last) = rows.last_mut() {
                *last = last.chars().take(width.saturating_sub(4)).chain(" ...".chars()).collect();
            }
        }
        left -= rows.len();
        shown += 1;
        short.extend(rows.iter().map(|row| format!("{row}\n")));
    }
    let count = text.lines().count() - shown;
    let rest = if count > 0 { format!("{} more, and ", lines::counted(count, "line", "lines")) } else { String::new() };
    format!("{short}\n{}", lines::wrapped(&format!("{rest}{more}"), width))
}

/// Rows of a terminal that one sentence takes.
const MOST_ROWS: usize = 4;

/// What is determined worst, correlations, and the budget of a fit.
fn explained(planned: &Planned, width: usize) -> String {
    let (name, found) = (&planned.estimate, &planned.identifiability);
    let title = format!("{name}: what is determined worst (singular value, the largest being 1)");
    let mut text = format!("\n{}", section(&title, &uncertainty_summary::weakest(&found.weakest)));
    let Some(budget) = &found.uncertainty else { return text };
    let pairs = uncertainty_summary::correlations(budget);
    if !pairs.is_empty() {
        text.push_str(&format!("\n{name}: hardly told apart, correlation above 0.95\n  {pairs}\n"));
    }
    let machine = |parameter: &str| planned.machine.iter().any(|own| own == parameter);
    let percent = budget.coverage_probability * 100.0;
    let title =
        format!("{name}: expanded uncertainty ({percent} %) from the stated ones, and where its square comes from");
    text.push_str(&format!("\n{}", section(&title, &uncertainty_summary::budget(budget, machine, width))));
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_is_cut_to_forty_rows() {
        let line = format!("  {}\n", "word ".repeat(60));
        for (lines, width) in [(1, 80), (5, 80), (30, 80), (100, 80), (39, 400), (60, 30)] {
            let text = line.repeat(lines);
            let short = shortened(&text, width);
            // The last one is a sentence of this program's own.
            assert!(short.lines().count() <= LINES + 3, "{lines} lines at {width}: {short}");
            assert!(short.lines().all(|line| line.chars().count() <= width), "{lines} lines at {width}: {short}");
            assert!(short.contains("`--explain`"));
        }
    }
}
