//! In which order chosen measurements are made, so that what changes with time is told apart from what does not, and when references
//! are measured again.
//!
//! What follows the time (a drift, thermal states) is among the unknowns of the planned estimate, or nothing depends on the order. Only
//! its columns change with the order: for given columns A of the others the determinant of the information is that of what is left of
//! them, B, beside A.

use abbe_core::{DataRow, Error, PathItem, Problem, Result, RowIndex, SetIndex, StatusRole, in_parallel};
use abbe_numerics::{DesignProblem, Generator, Lower};

use crate::again::{Revisit, revisits};
use crate::candidates::Candidate;
use crate::settings::{Ordering, Planning};
use crate::{PlanFigures, Scaled, wrong};

/// An order of measurements.
#[derive(Debug, Clone, PartialEq)]
pub struct Order {
    /// The candidates in their order: label, and when they begin, s.
    pub sequence: Vec<(String, f64)>,
    /// When the last one ends, s.
    pub end: f64,
    /// Rows of the candidates' data set in their order, and when each is measured, s.
    pub rows: Vec<(DataRow, f64)>,
    /// Figures of the plan in this order.
    pub figures: PlanFigures,
    /// Figures of the same measurements in the order of the list, references at its beginning. None if they do not determine all unknowns.
    pub as_listed: Option<PlanFigures>,
    /// D-efficiency of random orders relative to this one: that of the median of them.
    pub random_efficiency: f64,
    /// When references have to be measured again, if that was wanted.
    pub revisits: Vec<Revisit>,
}

/// Points in time at which derivatives are taken; between two of them they run straight.
const POINTS: usize = 129;

/// Random orders with which one is compared.
const RANDOM: u64 = 200;

/// Number of the first stream of random numbers of orders; the choice of candidates uses lower ones.
const STREAM: u64 = 1 << 40;

/// Exchanges that a search tries at most.
const TRIED: usize = 20_000;

/// A change of a derivative below this part of its column is none.
const ROUNDING: f64 = 1e-9;

/// Chosen measurements that are to be ordered, one for each time that a candidate is measured.
struct Sequencing<'a> {
    candidates: &'a [Candidate],
    /// The candidate of each measurement.
    measurements: Vec<usize>,
    ordering: &'a Ordering,
    /// First and last time at which derivatives are known, s.
    span: [f64; 2],
    /// For each point in time the scaled rows of all candidates, equation after equation, in the columns that follow the time.
    at_times: Vec<Vec<f64>>,
    /// These columns, and how many of them count.
    moving: Vec<usize>,
    counted: Side,
    nuisance: Option<Side>,
    /// The first equation of each candidate among all of their equations.
    first: Vec<usize>,
}

/// Columns of which the determinant is taken: what is left of the moving ones beside the others.
struct Side {
    /// Places among the moving columns.
    moving: Vec<usize>,
    /// For each equation of the candidates the row of the fixed columns, in units in which their information is 1.
    fixed: Vec<f64>,
    /// Number of fixed columns.
    count: usize,
    /// What was measured already: fixed times moving, moving times moving.
    cross: Vec<f64>,
    own: Vec<f64>,
}

/// Orders the chosen candidates.
///
/// Fails if nothing that is estimated follows the time, and where the model does not know the times that are planned.
pub fn order(
    contact: &Problem,
    (candidates, scaled, choice): (&[Candidate], &Scaled, &DesignProblem),
    chosen: &[usize],
    wanted: &Planning,
) -> Result<Option<Order>> {
    let Some(ordering) = &wanted.order else { return Ok(None) };
    let sequencing = Sequencing::new(contact, (candidates, scaled, choice), chosen, (wanted, ordering))?;
    let listed = sequencing.measurements.clone();
    let searches: Vec<u64> = (0..wanted.restarts.get() as u64).collect();
    let found = in_parallel(&searches, None, |search| {
        let mut generator = Generator::new(wanted.seed, STREAM + search);
        let start = if *search == 0 { listed.clone() } else { shuffled(&listed, &mut generator) };
        sequencing.exchanged(start, &mut generator)
    });
    let best = found.into_iter().fold(None, |best: Option<(Vec<usize>, f64)>, found| match best {
        Some(best) if best.1 >= found.1 => Some(best),
        _ => Some(found),
    });
    let undetermined = || wrong("order", "in no order do these measurements determine all unknowns");
    let (best, value) = best.filter(|(_, value)| value.is_finite()).ok_or_else(undetermined)?;
    let mut random: Vec<f64> = (0..RANDOM)
        .map(|trial| {
            let mut generator = Generator::new(wanted.seed, 2 * STREAM + trial);
            sequencing.value(&shuffled(&listed, &mut generator))
        })
        .collect();
    random.sort_by(f64::total_cmp);
    let figures = |order: &[usize]| sequencing.figures(contact, (scaled, choice), order, wanted);
    let times = sequencing.times(&best);
    let layout = contact.set_named(&wanted.candidates).map(|set| &contact.sets[set].info().layout);
    let rows = best.iter().zip(&times).flat_map(|(&candidate, &from)| {
        let rows = sequencing.candidates[candidate].rows.iter().zip(sequencing.row_times(candidate, from));
        rows.filter_map(|(&row, time)| Some((layout?.rows[row].data_row?, time))).collect::<Vec<_>>()
    });
    let of_best = figures(&best)?.ok_or_else(undetermined)?;
    let again = ordering.again.as_ref().zip(contact.set_named(&wanted.candidates));
    let revisits = again
        .map(|(again, set)| revisits(contact, (candidates, set), (ordering, again), (&of_best, sequencing.span[1])));
    Ok(Some(Order {
        rows: rows.collect(),
        end: sequencing.span[1],
        figures: of_best,
        revisits: revisits.transpose()?.unwrap_or_default(),
        as_listed: figures(&listed)?,
        random_efficiency: ((random[random.len() / 2] - value) / choice.of_interest as f64).exp(),
        sequence: best.iter().zip(times).map(|(&index, from)| (candidates[index].label.clone(), from)).collect(),
    }))
}

fn shuffled(order: &[usize], generator: &mut Generator) -> Vec<usize> {
    let mut order = order.to_vec();
    for last in (1..order.len()).rev() {
        order.swap(last, generator.index(last + 1));
    }
    order
}

impl<'a> Sequencing<'a> {
    fn new(
        contact: &Problem,
        (candidates, scaled, choice): (&'a [Candidate], &Scaled, &DesignProblem),
        chosen: &[usize],
        (wanted, ordering): (&Planning, &'a Ordering),
    ) -> Result<Self> {
        let mut measurements = Vec::new();
        for (index, label) in ordering.references.iter().enumerate() {
            let Some(reference) = candidates.iter().position(|candidate| candidate.label == label.0) else {
                let mut error = wrong("order", format!("there is no candidate {}", label.0));
                error.setting.extend([PathItem::Key("references".to_owned()), PathItem::Index(index)]);
                return Err(error.suggest(&label.0, candidates.iter().map(|candidate| candidate.label.as_str())));
            };
            let known = chosen.iter().filter(|own| **own == reference).count();
            measurements.extend(std::iter::repeat_n(reference, ordering.times.get().saturating_sub(known)));
        }
        measurements.extend_from_slice(chosen);
        let mut first = vec![0];
        candidates.iter().for_each(|candidate| first.push(first[first.len() - 1] + candidate.equations.len()));
        let empty = || Side { moving: Vec::new(), fixed: Vec::new(), count: 0, cross: Vec::new(), own: Vec::new() };
        let mut found = Self {
            candidates,
            measurements,
            ordering,
            span: [ordering.start_s; 2],
            at_times: Vec::new(),
            moving: Vec::new(),
            counted: empty(),
            nuisance: None,
            first,
        };
        let whole: f64 = found.measurements.iter().map(|&candidate| found.duration(candidate)).sum();
        found.span[1] += whole;
        let set = contact.set_named(&wanted.candidates).ok_or_else(|| wrong("candidates", "they are not observed"))?;
        let p = scaled.order.len();
        let mut tables = Vec::new();
        for point in 0..POINTS {
            let time = found.span[0] + whole * point as f64 / (POINTS - 1) as f64;
            let at = at_time(contact, set, |_| time)?;
            tables.push(scaled.rows_of(&at, candidates).map_err(in_order)?);
        }
        let moves = |column: &usize| {
            let value = |table: &Vec<f64>, row: usize| table[row * p + column];
            (0..tables[0].len() / p)
                .any(|row| tables.iter().any(|table| (value(table, row) - value(&tables[0], row)).abs() > ROUNDING))
        };
        found.moving = (0..p).filter(moves).collect();
        if found.moving.is_empty() {
            let error = wrong("order", "nothing that is estimated follows the time, so that any order is as good");
            return Err(error.help("estimate a drift (`dzt[t1]`) or what follows temperatures, too"));
        }
        let fixed: Vec<usize> = (0..p).filter(|column| !found.moving.contains(column)).collect();
        let all: Vec<usize> = (0..found.moving.len()).collect();
        let side = |moving: Vec<usize>, fixed: Vec<usize>| {
            found
                .side((&scaled.measured, &tables[0]), p, moving, &fixed)
                .ok_or_else(|| wrong("order", "what does not follow the time is not determined by these measurements"))
        };
        let counted = side(all.clone(), fixed.clone())?;
        let is_nuisance = |column: &usize| *column >= choice.of_interest;
        let nuisance = match choice.of_interest < p {
            false => None,
            true => Some(side(
                all.into_iter().filter(|&place| is_nuisance(&found.moving[place])).collect(),
                fixed.into_iter().filter(is_nuisance).collect(),
            )?),
        };
        (found.counted, found.nuisance) = (counted, nuisance);
        let moving = &found.moving;
        let of_table = |table: Vec<f64>| -> Vec<f64> {
            table.chunks_exact(p).flat_map(|row| moving.iter().map(|&column| row[column]).collect::<Vec<_>>()).collect()
        };
        found.at_times = tables.into_iter().map(of_table).collect();
        Ok(found)
    }

    /// The columns of one side; none if the fixed ones are not determined.
    fn side(&self, (measured, table): (&[f64], &[f64]), p: usize, moving: Vec<usize>, fixed: &[usize]) -> Option<Side> {
        let count = fixed.len();
        let entry = |one: usize, other: usize| measured[one * p + other];
        let mut information: Vec<f64> =
            fixed.iter().flat_map(|&one| fixed.iter().map(move |&other| entry(one, other))).collect();
        let equations =
            self.measurements.iter().flat_map(|&candidate| self.first[candidate]..self.first[candidate + 1]);
        for equation in equations {
            let row = &table[equation * p..(equation + 1) * p];
            for (one, line) in fixed.iter().zip(information.chunks_exact_mut(count.max(1))) {
                fixed.iter().zip(line).for_each(|(&other, sum)| *sum += row[*one] * row[other]);
            }
        }
        let lower = Lower::of(&information, count)?;
        let columns: Vec<usize> = moving.iter().map(|&place| self.moving[place]).collect();
        let mut cross = vec![0.0; count * columns.len()];
        for (place, &column) in columns.iter().enumerate() {
            let mut line: Vec<f64> = fixed.iter().map(|&one| entry(one, column)).collect();
            lower.solve(&mut line);
            line.into_iter().enumerate().for_each(|(one, value)| cross[one * columns.len() + place] = value);
        }
        let own = columns.iter().flat_map(|&one| columns.iter().map(move |&other| entry(one, other))).collect();
        let scaled = table.chunks_exact(p).flat_map(|row| {
            let mut line: Vec<f64> = fixed.iter().map(|&column| row[column]).collect();
            lower.solve(&mut line);
            line
        });
        Some(Side { fixed: scaled.collect(), count, cross, own, moving })
    }

    /// What a candidate takes, s.
    fn duration(&self, candidate: usize) -> f64 {
        let candidate = &self.candidates[candidate];
        self.ordering.row(candidate) * candidate.rows.len() as f64
    }

    /// When the rows of a candidate are measured that begins at a time.
    fn row_times(&self, candidate: usize, from: f64) -> impl Iterator<Item = f64> {
        let (duration, rows) = (self.duration(candidate), self.candidates[candidate].rows.len());
        (0..rows).map(move |row| from + duration * row as f64 / rows as f64)
    }

    /// When measurements begin in an order.
    fn times(&self, order: &[usize]) -> Vec<f64> {
        let mut now = self.ordering.start_s;
        let begin = |&candidate: &usize| {
            let from = now;
            now += self.duration(candidate);
            from
        };
        order.iter().map(begin).collect()
    }

    /// The moving columns of an equation at a time, added to sums.
    fn add(&self, (candidate, from): (usize, f64), factor: f64, sums: &mut [Sums<'_>]) {
        let of = &self.candidates[candidate];
        let each = of.equations.len() / of.rows.len().max(1);
        let m = self.moving.len();
        let mut row = vec![0.0; m];
        for (index, time) in self.row_times(candidate, from).enumerate() {
            let share = (time - self.span[0]) / (self.span[1] - self.span[0]).max(f64::MIN_POSITIVE);
            let place = (share * (POINTS - 1) as f64).clamp(0.0, (POINTS - 1) as f64);
            let before = (place as usize).min(POINTS - 2);
            let part = place - before as f64;
            for own in 0..each {
                let equation = self.first[candidate] + index * each + own;
                for (column, value) in row.iter_mut().enumerate() {
                    let at = |point: usize| self.at_times[point][equation * m + column];
                    *value = (1.0 - part) * at(before) + part * at(before + 1);
                }
                sums.iter_mut().for_each(|sums| sums.add(equation, &row, factor));
            }
        }
    }

    fn sums(&self) -> Vec<Sums<'_>> {
        std::iter::once(&self.counted).chain(&self.nuisance).map(Sums::new).collect()
    }

    /// The logarithm of the determinant of the information of the unknowns that count, up to a constant.
    fn value(&self, order: &[usize]) -> f64 {
        let mut sums = self.sums();
        for (&candidate, from) in order.iter().zip(self.times(order)) {
            self.add((candidate, from), 1.0, &mut sums);
        }
        value_of(&sums)
    }

    /// The order after exchanges of two measurements, as long as they make it better.
    fn exchanged(&self, mut order: Vec<usize>, generator: &mut Generator) -> (Vec<usize>, f64) {
        let mut value = self.value(&order);
        let mut sums = self.sums();
        let times = self.times(&order);
        order.iter().zip(&times).for_each(|(&candidate, &from)| self.add((candidate, from), 1.0, &mut sums));
        let mut pairs: Vec<(usize, usize)> =
            (0..order.len()).flat_map(|one| (one + 1..order.len()).map(move |other| (one, other))).collect();
        let mut tried = 0;
        loop {
            let mut better = false;
            for last in (1..pairs.len()).rev() {
                pairs.swap(last, generator.index(last + 1));
            }
            for &(one, other) in &pairs {
                if order[one] == order[other] {
                    continue;
                }
                tried += 1;
                if tried > TRIED {
                    return (order, value);
                }
                let mut exchanged = order.clone();
                exchanged.swap(one, other);
                let [before, after] = [&order, &exchanged].map(|order| self.times(order));
                let mut changed = sums.clone();
                for place in one..=other {
                    let [was, is] = [(order[place], before[place]), (exchanged[place], after[place])];
                    if was != is {
                        self.add(was, -1.0, &mut changed);
                        self.add(is, 1.0, &mut changed);
                    }
                }
                let found = value_of(&changed);
                if found > value + 1e-9 * value.abs().max(1.0) || (found.is_finite() && !value.is_finite()) {
                    (order, value, sums, better) = (exchanged, found, changed, true);
                }
            }
            if !better {
                return (order, value);
            }
        }
    }

    /// Figures of the plan in an order, at the exact times; none if it does not determine all unknowns.
    fn figures(
        &self,
        contact: &Problem,
        (scaled, choice): (&Scaled, &DesignProblem),
        order: &[usize],
        wanted: &Planning,
    ) -> Result<Option<PlanFigures>> {
        let set = contact.set_named(&wanted.candidates).ok_or_else(|| wrong("candidates", "they are not observed"))?;
        let p = scaled.order.len();
        let (mut rows, mut ends) = (Vec::new(), Vec::new());
        let times = self.times(order);
        let mut done = vec![false; order.len()];
        // Each pass has every candidate once at most, because a row has one time in a problem.
        while done.contains(&false) {
            let mut pass: Vec<(usize, f64)> = Vec::new();
            for (place, done) in done.iter_mut().enumerate().filter(|(_, done)| !**done) {
                if !pass.iter().any(|(candidate, _)| *candidate == order[place]) {
                    pass.push((order[place], times[place]));
                    *done = true;
                }
            }
            let time_of = |row| {
                let of = |&(candidate, from): &(usize, f64)| {
                    let index = self.candidates[candidate].rows.iter().position(|own| *own == row)?;
                    self.row_times(candidate, from).nth(index)
                };
                pass.iter().find_map(of).unwrap_or(self.span[0])
            };
            let table = scaled.rows_of(&at_time(contact, set, time_of)?, self.candidates)?;
            for (candidate, _) in pass {
                rows.extend_from_slice(&table[self.first[candidate] * p..self.first[candidate + 1] * p]);
                ends.push(rows.len() / p);
            }
        }
        let all: Vec<usize> = (0..ends.len()).collect();
        let measured = DesignProblem {
            costs: vec![0.0; ends.len()],
            allowed: vec![true; ends.len()],
            required: Vec::new(),
            number: None,
            budget: None,
            rows,
            ends,
            ..choice.clone()
        };
        let figures = measured.figures(&all);
        Ok(figures.map(|figures| scaled.figures(&measured, &all, figures)))
    }
}

/// Sums of products of the moving columns with fixed ones and with each other.
#[derive(Clone)]
struct Sums<'a> {
    side: &'a Side,
    cross: Vec<f64>,
    own: Vec<f64>,
}

impl<'a> Sums<'a> {
    fn new(side: &'a Side) -> Self {
        Self { side, cross: side.cross.clone(), own: side.own.clone() }
    }

    fn add(&mut self, equation: usize, moving: &[f64], factor: f64) {
        let (side, m) = (self.side, self.side.moving.len());
        let fixed = &side.fixed[equation * side.count..(equation + 1) * side.count];
        for (one, line) in fixed.iter().zip(self.cross.chunks_exact_mut(m.max(1))) {
            line.iter_mut().zip(&side.moving).for_each(|(sum, &place)| *sum += factor * one * moving[place]);
        }
        for (&one, line) in side.moving.iter().zip(self.own.chunks_exact_mut(m.max(1))) {
            line.iter_mut().zip(&side.moving).for_each(|(sum, &place)| *sum += factor * moving[one] * moving[place]);
        }
    }

    /// The logarithm of the determinant of what is left beside the fixed columns; minus infinity if nothing is left of one.
    fn log_determinant(&self) -> f64 {
        let m = self.side.moving.len();
        let mut left = self.own.clone();
        for line in self.cross.chunks_exact(m.max(1)) {
            for (one, row) in line.iter().zip(left.chunks_exact_mut(m.max(1))) {
                row.iter_mut().zip(line).for_each(|(sum, other)| *sum -= one * other);
            }
        }
        Lower::of(&left, m).map_or(f64::NEG_INFINITY, |lower| lower.log_determinant())
    }
}

fn value_of(sums: &[Sums<'_>]) -> f64 {
    let [counted, nuisance @ ..] = sums else { return f64::NEG_INFINITY };
    counted.log_determinant() - nuisance.first().map_or(0.0, Sums::log_determinant)
}

/// The problem with other times of the rows of a set.
pub(crate) fn at_time(contact: &Problem, set: SetIndex, time: impl Fn(RowIndex) -> f64) -> Result<Problem> {
    let Some(status) = contact.model.info().status_index(&StatusRole::Time) else {
        return Err(wrong("order", "nothing of this machine follows the time, so that any order is as good"));
    };
    let mut moved = contact.clone();
    let own = &contact.sets[set];
    let mut poses = own.poses().clone();
    for &row in &own.rows {
        for pose in own.poses_of(&[row]) {
            poses.row_mut(pose)[status] = time(row);
        }
    }
    moved.sets[set].set_poses(poses);
    Ok(moved)
}

fn in_order(error: Error) -> Error {
    if error.setting.is_empty() { error.setting("order") } else { error }
}
