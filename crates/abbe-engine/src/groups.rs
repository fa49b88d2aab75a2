//! Estimates for every group of rows: those of one week, one day, one file. Each is a problem of its own, with own unknowns of
//! what was put on anew.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use abbe_core::{DataRow, Dataset, Error, Fit, Group, Kind, ListedBy, Monitor, Problem, Result, in_parallel};
use abbe_estimation::{comparisons, copied_runs, copies, remarks};
use abbe_recipe::Stage;

use crate::evidence::{Digests, of_problem};
use crate::outcome::Failure;
use crate::plausibility::EXACT;
use crate::prepare::Prepared;
use crate::problems::Taken;
use crate::record::Remark;
use crate::run::Datasets;
use crate::told::{gathered, untold};

/// The value of `per` for the rows of one file each.
const FILE: &str = "file";

/// Rows of data sets, by the names of their ingest stages.
type RowsOfDatasets = BTreeMap<String, Vec<DataRow>>;

/// The problem of one group.
pub(crate) struct GroupProblem {
    /// Name of its estimate.
    pub name: String,
    pub group: Group,
    pub problem: Problem,
}

impl ListedBy<DataRow> for GroupProblem {}

/// The stage of an estimate, by the name of the estimate: one of a group is called after both.
pub(crate) fn stage_name(estimate: &str) -> &str {
    estimate.split_once('.').map_or(estimate, |(stage, _)| stage)
}

/// Whether an estimate is that of a stage, or of one of its groups.
pub(crate) fn is_of(fit: &Fit, stage: &str) -> bool {
    fit.name == stage || fit.calibration.group.is_some() && stage_name(&fit.name) == stage
}

impl Prepared {
    /// The problems of all groups, by the stages that have groups.
    pub(crate) fn group_problems(&self, data: &Datasets) -> Result<BTreeMap<String, Vec<GroupProblem>>> {
        let mut all = BTreeMap::new();
        for stage in self.stages(Kind::Estimate) {
            let Some(by) = &stage.per else { continue };
            let groups = self.located(stage, self.groups(stage, by, data))?;
            let problem = |(group, rows): &(Group, BTreeMap<String, Vec<DataRow>>)| {
                let mut own = data.clone();
                for (ingest, rows) in rows {
                    own.insert(ingest.clone(), Arc::new(data[ingest].of_rows(rows)));
                }
                let name = format!("{}.{}-{}", stage.name, group.by, group.label);
                // The rows of all groups together have been warned of.
                let problem = untold(|| self.problem(stage, &own, &mut Taken::default()));
                let problem = self.located(stage, problem);
                Ok(GroupProblem { problem: Problem { name: name.clone(), ..problem? }, name, group: group.clone() })
            };
            let problems: Result<Vec<GroupProblem>> = in_parallel(&groups, None, problem).into_iter().collect();
            all.insert(stage.name.clone(), problems?);
        }
        Ok(all)
    }

    /// The groups of an estimate, in the order of their times, each with its rows of every data set that is divided.
    fn groups(&self, stage: &Stage, by: &str, data: &Datasets) -> Result<Vec<(Group, RowsOfDatasets)>> {
        let mut ingests = BTreeSet::new();
        for name in stage.reference("observations") {
            let (ingest, _) = self.artefact(name)?;
            ingests.insert(ingest);
            ingests.extend(self.repeats(name)?);
        }
        let mut labels: Vec<String> = Vec::new();
        let mut rows: BTreeMap<String, RowsOfDatasets> = BTreeMap::new();
        for ingest in ingests {
            for (row, label) in DataRow::enumerate(labels_of(&data[ingest], by)?) {
                if !rows.contains_key(&label) {
                    check_label(&label, by).map_err(|message| data[ingest].error_at(row, message))?;
                    labels.push(label.clone());
                }
                rows.entry(label).or_default().entry(ingest.to_owned()).or_default().push(row);
            }
        }
        let mut groups = timed(by, &labels);
        groups.sort_by(|one, other| one.at.total_cmp(&other.at));
        let with_rows = |group: Group| {
            let rows = rows.remove(&group.label).unwrap_or_default();
            (group, rows)
        };
        Ok(groups.into_iter().map(with_rows).collect())
    }

    /// Solves the problems of all groups. A group that cannot be solved costs no other one.
    pub(crate) fn fit_groups(
        &self,
        stage: &Stage,
        problems: &[GroupProblem],
        digests: &Digests,
        monitor: &Monitor,
    ) -> Vec<std::result::Result<Fit, Failure>> {
        let fit = |group: &GroupProblem| {
            let problem = group.problem.watched_by(monitor.of_stage(&stage.name));
            let records = of_problem(&problem, digests);
            let mut told = [remarks(&problem), copies(&problem)].concat();
            let fitted = self.fit_untold(stage, problem).map(|mut fit| {
                told.extend(comparisons(&fit.problem, Some(&fit.problem.values_of(&fit.calibration))));
                fit.name.clone_from(&group.name);
                fit.calibration.group = Some(group.group.clone());
                fit.calibration.data = records;
                fit
            });
            (told, fitted)
        };
        let failed = |(group, result): (&GroupProblem, Result<Fit>)| {
            result.map_err(|error: Error| {
                let message = format!("{} {}: {}", group.group.by, group.group.label, error.message);
                let help = format!("leave it out by `ignore: {{ {}: [{}] }}`", group.group.by, group.group.label);
                let help = error.help.clone().map_or_else(|| help.clone(), |told| format!("{told}; or {help}"));
                let error = Error { message, ..error }.help(help);
                Failure { stage: group.name.clone(), kind: Kind::Estimate, error, needs: None }
            })
        };
        let (mut told, mut fits) = (Vec::new(), Vec::new());
        for (group, (sentences, fitted)) in problems.iter().zip(in_parallel(problems, None, fit)) {
            told.extend(sentences.into_iter().map(|sentence| (group.name.clone(), sentence)));
            fits.push(failed((group, fitted)));
        }
        gathered(told).iter().for_each(|sentence| tracing::warn!("{sentence}"));
        fits
    }
}

impl Prepared {
    /// Rows of one group that are those of another one to the last digit: a test that was not made.
    pub(crate) fn copied_groups(&self, fits: &[Fit], problems: &BTreeMap<String, Problem>) -> Vec<Remark> {
        let mut remarks = Vec::new();
        for stage in self.stages(Kind::Estimate).filter(|stage| stage.per.is_some()) {
            let own: Vec<&Fit> = fits.iter().filter(|fit| is_of(fit, &stage.name)).collect();
            let is_exact = own.iter().all(|fit| fit.calibration.fit.sigma <= EXACT);
            // A group with copies of its own rows tells them.
            if is_exact || own.iter().any(|fit| !copied(&fit.problem).is_empty()) {
                continue;
            }
            // All groups together.
            let Some(all) = problems.get(&stage.name) else { continue };
            let estimate = &stage.name;
            remarks.extend(copied(all).into_iter().map(|text| Remark { estimate: estimate.clone(), text }));
        }
        remarks
    }
}

/// Sentences on rows that are copies of others.
fn copied(problem: &Problem) -> Vec<String> {
    [copies(problem), copied_runs(problem)].concat()
}

/// The label of every row.
fn labels_of(data: &Dataset, by: &str) -> Result<Vec<String>> {
    if by != FILE {
        return data
            .required_labels(by)
            .map(|labels| labels.iter().map(|label| label.to_string()).collect())
            .map_err(|error| error.setting("per"));
    }
    let name = |file: usize| {
        let stem = data.files[file].file_stem().map(|stem| stem.to_string_lossy().into_owned());
        stem.unwrap_or_else(|| file.to_string())
    };
    Ok(data.origins.iter().map(|origin| name(origin.file)).collect())
}

/// Files are named after groups.
fn check_label(label: &str, by: &str) -> std::result::Result<(), String> {
    let fits = |letter: char| letter.is_alphanumeric() || matches!(letter, '-' | '_' | '.' | '+');
    if label.is_empty() || label.len() > 100 || !label.chars().all(fits) {
        return Err(format!(
            "`{label}` in `{by}` cannot name an estimate: at most 100 letters, digits, `-`, `_`, `+` and `.` were expected"
        ));
    }
    Ok(())
}

/// Groups with their times: numbers as they are, dates as days, else the order in which they stand.
fn timed(by: &str, labels: &[String]) -> Vec<Group> {
    let numbers: Option<Vec<f64>> =
        labels.iter().map(|label| label.parse().ok().filter(|at: &f64| at.is_finite())).collect();
    let dates = || labels.iter().map(|label| day_of(label)).collect::<Option<Vec<f64>>>();
    let (times, unit) = match (by, numbers) {
        (FILE, _) => (None, ""),
        (_, Some(numbers)) => (Some(numbers), by),
        _ => (dates(), "day"),
    };
    let is_unique = |times: &Vec<f64>| {
        let mut sorted = times.clone();
        sorted.sort_by(f64::total_cmp);
        sorted.windows(2).all(|pair| pair[0] < pair[1])
    };
    // What is no number of weeks or days is a label like others.
    let is_time = |times: &Vec<f64>| times.iter().all(|time| time.abs() < LONGEST);
    let times = times.filter(is_unique).filter(is_time);
    let unit = if times.is_some() { unit } else { "test" };
    let at = |place: usize| times.as_ref().map_or(place as f64 + 1.0, |times| times[place]);
    let group = |(place, label): (usize, &String)| Group {
        by: by.to_owned(),
        label: label.clone(),
        at: at(place),
        unit: unit.to_owned(),
    };
    labels.iter().enumerate().map(group).collect()
}

/// Numbers of weeks, days and tests are below this one.
const LONGEST: f64 = 1e9;

/// Days from 1970-01-01 to a date as `2026-03-02` (Hinnant, chrono-compatible low-level date algorithms, 2021).
pub fn day_of(label: &str) -> Option<f64> {
    let mut parts = label.split('-');
    let mut next = |digits: usize| parts.next().filter(|part| part.len() == digits)?.parse::<i64>().ok();
    let (year, month, day) = (next(4)?, next(2)?, next(2)?);
    let is_leap = year % 4 == 0 && (year % 100 != 0 || year % 400 == 0);
    let days = match month {
        2 => 28 + i64::from(is_leap),
        4 | 6 | 9 | 11 => 30,
        _ => 31,
    };
    if parts.next().is_some() || !(1..=12).contains(&month) || !(1..=days).contains(&day) {
        return None;
    }
    let year = if month <= 2 { year - 1 } else { year };
    let era = year.div_euclid(400);
    let of_era = year.rem_euclid(400);
    let of_year = (153 * (month + if month > 2 { -3 } else { 9 }) + 2) / 5 + day - 1;
    Some((era * 146_097 + of_era * 365 + of_era / 4 - of_era / 100 + of_year - 719_468) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_that_do_not_exist_are_no_days() {
        for date in ["2026-02-29", "2026-02-31", "2100-02-29", "2026-04-31", "2026-13-01", "2026-00-10", "2026-01-00"] {
            assert_eq!(day_of(date), None, "{date}");
        }
        assert_eq!((day_of("2000-02-29"), day_of("2024-02-29")), (Some(11_016.0), Some(19_782.0)));
    }

    #[test]
    fn groups_have_times() {
        let labels = |labels: &[&str]| labels.iter().map(|label| (*label).to_owned()).collect::<Vec<_>>();
        let times = |by: &str, names: &[&str]| {
            let groups = timed(by, &labels(names));
            (groups.iter().map(|group| group.at).collect::<Vec<_>>(), groups[0].unit.clone())
        };
        assert_eq!(times("week", &["3", "10", "2"]), (vec![3.0, 10.0, 2.0], "week".into()));
        assert_eq!(times("day", &["1970-01-02", "2000-03-01"]), (vec![1.0, 11_017.0], "day".into()));
        assert_eq!(times("shift", &["late", "early"]), (vec![1.0, 2.0], "test".into()));
        // Two names of one number are two groups: their order alone is known.
        assert_eq!(times("week", &["1", "01"]), (vec![1.0, 2.0], "test".into()));
        assert_eq!(times("file", &["7", "3"]), (vec![1.0, 2.0], "test".into()));
        assert_eq!(day_of("2026-13-01"), None);
        assert_eq!(day_of("2026-1-1"), None);
    }
}
