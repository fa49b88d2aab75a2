//! Times that fall from row to row: all of them, or some amid others that grow.

use std::collections::BTreeSet;

use abbe_core::{DataRow, Dataset, ObservationSet, Problem, Values};

/// Fewest steps from row to row in a file that tell, and the part of them that may fall: where more do, rows stand in another order than
/// they were measured in.
const STEPS: usize = 10;
const FEW: f64 = 0.1;

/// Sentences on times that fall in every row, and on some that fall although rows follow each other in time.
pub(crate) fn falling(problem: &Problem) -> Vec<String> {
    let of_set = |set: &ObservationSet| {
        let layout = &set.info().layout;
        let own = set.rows.iter().filter_map(|&row| layout.rows[row].data_row);
        let rows: BTreeSet<DataRow> = own.chain(layout.merged.iter().copied()).collect();
        Some(format!("{}: {}", set.name, falling_times(&layout.data, rows)?))
    };
    problem.sets.iter().filter_map(of_set).collect()
}

/// A sentence on the times of rows of a data set, in their order, that fall in every row, or in some although rows follow each other in
/// time; none without a column `time`. A clock may begin anew with a label, such as a run or a day.
pub fn falling_times(data: &Dataset, rows: impl IntoIterator<Item = DataRow>) -> Option<String> {
    let times = data.numbers("time")?;
    let rows: Vec<DataRow> = rows.into_iter().filter(|row| times[*row].is_finite()).collect();
    if falls_always(&rows, times) {
        return Some("the time falls from row to row: its sign, or the order of the rows, may be wrong".to_owned());
    }
    let of_file = |one: &DataRow, next: &DataRow| data.origins[*one].file == data.origins[*next].file;
    let files = || rows.chunk_by(of_file).filter(|rows| rows.len() > STEPS);
    let fallen = files().find(|rows| falls_in_each_run(data, rows, times)).and_then(|rows| {
        let file = data.files.get(data.origins[rows[0]].file)?;
        Some(format!(
            "in `{}` the time falls from row to row: its sign, or the order of the rows, may be wrong",
            file.display()
        ))
    });
    fallen.or_else(|| files().find_map(|rows| falls_somewhere(data, rows, times)))
}

fn falls_always(rows: &[DataRow], times: &[f64]) -> bool {
    let time = |row: Option<&DataRow>| row.map(|row| times[*row]);
    time(rows.first()) > time(rows.last()) && rows.windows(2).all(|pair| times[pair[1]] <= times[pair[0]])
}

/// Whether the times of the rows of a file fall all along each of its runs, by their labels; those that stand alone say nothing.
fn falls_in_each_run(data: &Dataset, rows: &[DataRow], times: &[f64]) -> bool {
    let labels = data.labels("run");
    let of_run = |one: &DataRow, next: &DataRow| labels.is_none_or(|labels| labels[*one] == labels[*next]);
    let runs: Vec<&[DataRow]> = rows.chunk_by(of_run).filter(|run| run.len() > 2).collect();
    runs.iter().map(|run| run.len()).sum::<usize>() > STEPS && runs.iter().all(|run| falls_always(run, times))
}

fn falls_somewhere(data: &Dataset, rows: &[DataRow], times: &[f64]) -> Option<String> {
    let falls: Vec<usize> = (1..rows.len()).filter(|place| times[rows[*place]] < times[rows[place - 1]]).collect();
    if falls.len() as f64 > FEW * (rows.len() - 1) as f64 {
        return None;
    }
    let borders = borders(data, rows);
    let falls: Vec<usize> = falls.into_iter().filter(|place| !borders.contains(place)).collect();
    let first = *falls.first()?;
    let [before, after] = [rows[first - 1], rows[first]];
    let origin = data.origins[after];
    let place = data.files.get(origin.file).map_or_else(|| origin.in_words(), |file| origin.in_file(file));
    let more = match falls.len() {
        1 => String::new(),
        count => format!(" (the first of {count})"),
    };
    Some(format!(
        "the time falls from {} s to {} s at {place}{more}, and grows from row to row elsewhere: is it right? A drift, and whatever else \
         follows the time, takes it as it is",
        times[before], times[after]
    ))
}

/// Places in a list of rows at which a label changes that stays for two rows or more on average, such as a run, a day or an indexation: the
/// clock may begin anew there, or the rows are sorted by this label.
fn borders(data: &Dataset, rows: &[DataRow]) -> BTreeSet<usize> {
    let mut borders = BTreeSet::new();
    for column in &data.columns {
        let Values::Labels(labels) = &column.values else { continue };
        let changes = (1..rows.len()).filter(|place| labels[rows[*place]] != labels[rows[place - 1]]);
        let changes: Vec<usize> = changes.collect();
        if 2 * changes.len() <= rows.len() {
            borders.extend(changes);
        }
    }
    borders
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use abbe_numerics::Generator;

    use super::*;

    fn told(rows: &[(String, f64)]) -> Option<String> {
        let rows: String = rows.iter().map(|(labels, time)| format!("{labels},{time}\n")).collect();
        let text = format!("touch,run,group,feature,time_s\n{rows}");
        let data = abbe_table::parse(Path::new("touches.csv"), text.as_bytes()).unwrap();
        falling_times(&data, data.row_indices())
    }

    /// Rows of some runs with a clock each or one for all, in the order of measurement or sorted by feature or in no order.
    fn rows(random: &mut Generator, kind: usize) -> Vec<(String, f64)> {
        let (runs, groups, features) = (1 + random.index(4), 1 + random.index(6), 2 + random.index(8));
        let (mut rows, mut time) = (Vec::new(), 0.0);
        for run in 0..runs {
            if kind.is_multiple_of(2) {
                time = 100.0 * random.uniform();
            }
            for group in 0..groups {
                for feature in 0..features {
                    // Digits of a second: some are the same.
                    time += (4.0 * random.uniform().abs()).round();
                    rows.push((run, group, feature, time));
                }
            }
        }
        match kind / 2 {
            0 => {}
            1 => rows.sort_by_key(|row| (row.2, row.0, row.1)),
            2 => rows.sort_by_key(|row| (row.0, row.2, row.1)),
            _ => (1..rows.len()).rev().for_each(|last| rows.swap(last, random.index(last + 1))),
        }
        let row = |(touch, (run, group, feature, time)): (usize, (usize, usize, usize, f64))| {
            (format!("{touch},{run},{group}.{run},{feature}"), time)
        };
        rows.into_iter().enumerate().map(row).collect()
    }

    #[test]
    fn clocks_that_begin_anew_and_sorted_rows_get_no_word() {
        for seed in 0..4000 {
            let mut random = Generator::new(seed, 5);
            let kind = random.index(8);
            let rows = rows(&mut random, kind);
            let told = told(&rows);
            // Rows in no order may fall throughout by chance if there are two or three.
            assert!(told.is_none() || rows.len() < 8, "{seed} {kind}: {told:?} {rows:?}");
        }
    }

    #[test]
    fn one_time_that_falls_is_told() {
        for seed in 0..500 {
            let mut random = Generator::new(seed, 6);
            let mut rows: Vec<(String, f64)> =
                (0..40).map(|row| (format!("{row},1,{},{}", row / 10, row % 10), 10.0 * f64::from(row))).collect();
            let row = 1 + random.index(38);
            rows[row].1 += if seed % 2 == 0 { 50.0 } else { -50.0 };
            // Where a group ends, its clock may begin anew.
            let at = row + usize::from(seed % 2 == 0);
            let words = told(&rows);
            assert_eq!(words.is_some(), !at.is_multiple_of(10) || row < 5, "{seed} {row}: {words:?}");
        }
    }
}
