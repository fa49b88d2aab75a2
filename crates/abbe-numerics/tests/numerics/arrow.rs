//! Problems of block arrow structure: eliminated group by group they give what one dense triangle of all unknowns gives.

use abbe_numerics::{Accumulator, ArrowAccumulator, ArrowFactor, Factor, GroupSearch, Groups};

use crate::problems::Random;

const TOLERANCE: f64 = 1e-10;

struct Row {
    unknowns: Vec<usize>,
    derivatives: Vec<f64>,
    residual: f64,
    source: usize,
}

/// A random problem: shared unknowns first, then those of groups, which come from two sources.
struct Case {
    own: Vec<bool>,
    rows: Vec<Row>,
}

/// What makes some unknowns undetermined.
#[derive(Clone, Copy, PartialEq, Debug)]
enum Lost {
    Nothing,
    /// In every third group two unknowns do the same.
    TwinsInGroups,
    /// In every fourth group an unknown does nothing.
    IdleInGroups,
    /// Two shared unknowns do the same.
    TwinsShared,
    /// A shared unknown does what the first unknowns of all groups do together.
    SharedAsOwn,
    /// Every fifth group has fewer rows than unknowns.
    FewRows,
    /// A group has no row.
    NoRows,
}

const ALL: [Lost; 7] = [
    Lost::Nothing,
    Lost::TwinsInGroups,
    Lost::IdleInGroups,
    Lost::TwinsShared,
    Lost::SharedAsOwn,
    Lost::FewRows,
    Lost::NoRows,
];

impl Case {
    fn new(seed: u64, lost: Lost) -> Self {
        let mut random = Random::new(seed);
        let mut uniform = |low: f64, high: f64| low + (high - low) * (random.signed() + 1.0) / 2.0;
        let (shared, groups) = (uniform(2.0, 7.0) as usize, uniform(3.0, 25.0) as usize);
        let scales: Vec<f64> = (0..shared).map(|_| 10_f64.powf(uniform(-4.0, 4.0))).collect();
        let (mut own, mut rows) = (vec![false; shared], Vec::new());
        for group in 0..groups {
            let count = uniform(2.0, 5.0) as usize;
            let first = own.len();
            own.extend(vec![true; count]);
            let of_group: Vec<f64> = (0..count).map(|_| 10_f64.powf(uniform(-3.0, 3.0))).collect();
            let number = match lost {
                Lost::NoRows if group == 1 => 0,
                Lost::FewRows if group % 5 == 0 => count - 1,
                _ => count + 1 + uniform(0.0, 6.0) as usize,
            };
            for _ in 0..number {
                let mut line: Vec<f64> = scales.iter().map(|scale| scale * uniform(-1.0, 1.0)).collect();
                let mut of_own: Vec<f64> = of_group.iter().map(|scale| scale * uniform(-1.0, 1.0)).collect();
                match lost {
                    Lost::TwinsInGroups if group % 3 == 0 => of_own[1] = -3.0 * of_own[0],
                    Lost::IdleInGroups if group % 4 == 0 => of_own[0] = 0.0,
                    Lost::TwinsShared => line[1] = 0.25 * line[0],
                    Lost::SharedAsOwn => line[0] = of_own[0],
                    _ => {}
                }
                line.extend(of_own);
                rows.push(Row {
                    unknowns: (0..shared).chain(first..first + count).collect(),
                    derivatives: line,
                    residual: uniform(-1.0, 1.0),
                    source: usize::from(group % 2 == 1),
                });
            }
        }
        // Rows without own unknowns, as of known lengths.
        for _ in 0..shared + 3 {
            let mut line: Vec<f64> = scales.iter().map(|scale| scale * uniform(-1.0, 1.0)).collect();
            match lost {
                Lost::TwinsShared => line[1] = 0.25 * line[0],
                Lost::SharedAsOwn => line[0] = 0.0,
                _ => {}
            }
            rows.push(Row {
                unknowns: (0..shared).collect(),
                derivatives: line,
                residual: uniform(-1.0, 1.0),
                source: 0,
            });
        }
        // Rows of groups need not come together.
        for place in (1..rows.len()).rev().step_by(3) {
            rows.swap(place, uniform(0.0, place as f64) as usize);
        }
        Self { own, rows }
    }

    fn dense(&self) -> Factor {
        let mut accumulator = Accumulator::new(self.own.len(), self.rows.len());
        self.rows.iter().for_each(|row| accumulator.push_some(&row.unknowns, &row.derivatives, row.residual, 0.5));
        accumulator.finish()
    }

    fn groups(&self) -> Groups {
        let mut search = GroupSearch::new(self.own.clone());
        self.rows.iter().for_each(|row| search.row(&row.unknowns, &row.derivatives));
        search.groups()
    }

    fn arrow(&self) -> ArrowFactor {
        let groups = self.groups();
        let mut accumulator = ArrowAccumulator::new(&groups, &[self.rows.len(), 10]);
        for row in &self.rows {
            accumulator.push(row.source, &row.unknowns, &row.derivatives, row.residual, 0.5).expect("one group a row");
        }
        accumulator.finish()
    }
}

/// However rows are divided, their triangles are together those of all.
#[test]
fn parts_make_up_the_whole() {
    for (seed, lost) in (0..70).zip(ALL.into_iter().cycle()) {
        let case = Case::new(1000 + seed, lost);
        let (groups, whole) = (case.groups(), case.arrow());
        let size = 1 + seed as usize % 9;
        let mut search = GroupSearch::new(case.own.clone());
        for rows in case.rows.chunks(size) {
            let mut part = GroupSearch::new(case.own.clone());
            rows.iter().for_each(|row| part.row(&row.unknowns, &row.derivatives));
            search.join(part);
        }
        assert_eq!(search.groups(), groups);
        let part = |rows: &[Row]| {
            let mut part = ArrowAccumulator::new(&groups, &[rows.len(), 1]);
            for row in rows {
                part.push(row.source, &row.unknowns, &row.derivatives, row.residual, 0.5).expect("one group a row");
            }
            part
        };
        let mut all = ArrowAccumulator::new(&groups, &[10, 10]);
        case.rows.chunks(size).for_each(|rows| all.join(part(rows)));
        let found = all.finish();
        assert_eq!(found.rows(), whole.rows());
        let (one, other) = (found.spectrum(1e-9), whole.spectrum(1e-9));
        assert_eq!(one.rank, other.rank, "{seed}, {lost:?}");
        assert!((found.cost() / whole.cost() - 1.0).abs() < TOLERANCE);
        for (one, other) in found.norms().iter().zip(whole.norms()) {
            assert!(near(*one, *other, TOLERANCE * other), "{seed}, {lost:?}: {one} and {other}");
        }
        for (one, other) in found.of_sources().iter().zip(whole.of_sources()) {
            assert_eq!(one.rows(), other.rows());
        }
        if lost == Lost::Nothing {
            let (found, whole) = (found.step().expect("a step"), whole.step().expect("a step"));
            let size = whole.iter().fold(0.0_f64, |size, step| size.max(step.abs()));
            assert!(found.iter().zip(&whole).all(|(one, other)| near(*one, *other, TOLERANCE * size)), "{seed}");
        }
    }
}

fn near(one: f64, other: f64, size: f64) -> bool {
    (one - other).abs() <= size
}

#[test]
fn values_and_uncertainties_are_those_of_the_dense_way() {
    for seed in 0..60 {
        let case = Case::new(seed, Lost::Nothing);
        let (dense, arrow) = (case.dense(), case.arrow());
        assert_eq!(arrow.rows(), dense.rows());
        let covariance = dense.covariance_root(dense.unknowns()).covariance();
        let (expected, found) = (dense.step().expect("full rank"), arrow.step().expect("full rank"));
        let of_shared = arrow.of_shared().covariance_root(arrow.shared().len()).covariance();
        let mut variances = vec![f64::NAN; dense.unknowns()];
        arrow.shared().iter().enumerate().for_each(|(place, &unknown)| variances[unknown] = of_shared[place][place]);
        arrow.own_variances(1.0, &of_shared).into_iter().for_each(|(unknown, variance)| variances[unknown] = variance);
        for unknown in 0..dense.unknowns() {
            let uncertainty = covariance[unknown][unknown].sqrt();
            assert!(near(found[unknown], expected[unknown], 1e-9 * uncertainty), "value {unknown}, seed {seed}");
            assert!(
                near(variances[unknown].sqrt(), uncertainty, 1e-9 * uncertainty),
                "uncertainty {unknown}, seed {seed}"
            );
            assert!(
                near(arrow.norms()[unknown], dense.norms()[unknown], 1e-12 * dense.norms()[unknown]),
                "seed {seed}"
            );
        }
        for (one, first) in arrow.shared().iter().enumerate() {
            for (other, second) in arrow.shared().iter().enumerate() {
                let size = (covariance[*first][*first] * covariance[*second][*second]).sqrt();
                assert!(near(of_shared[one][other], covariance[*first][*second], 1e-9 * size), "seed {seed}");
            }
        }
        assert!(near(arrow.cost(), dense.cost(), 1e-12 * dense.cost()));
        assert!(near(arrow.remaining_cost(), dense.remaining_cost(), 1e-12 * dense.cost()));
        assert!(near(arrow.row_norm(&found), dense.row_norm(&expected), 1e-11 * dense.row_norm(&expected)));
        assert!(near(arrow.gradient_cosine(), dense.gradient_cosine(), 1e-12));
    }
}

#[test]
fn what_the_dense_way_calls_undetermined_is_called_so() {
    for lost in ALL {
        for seed in 0..25 {
            let case = Case::new(1_000 + seed, lost);
            let (dense, arrow) = (case.dense(), case.arrow());
            let values = dense.singular_values();
            let rank = values.rank(TOLERANCE);
            assert_eq!(lost == Lost::Nothing, rank == dense.unknowns(), "{lost:?} {seed}");
            if dense.is_surely_full_rank(TOLERANCE) || lost != Lost::Nothing {
                assert_eq!(arrow.is_surely_full_rank(TOLERANCE), lost == Lost::Nothing, "{lost:?} {seed}");
            }
            let found = arrow.spectrum(TOLERANCE);
            assert_eq!(found.rank, rank, "{lost:?} {seed}: {found:?} {values:?}");
            if arrow.dependent().is_empty() {
                let told = found.ends.singular_values().values();
                assert!(near(told[0], values.values()[0], 1e-4 * told[0]), "{lost:?} {seed}: {told:?} {values:?}");
                let condition = values.condition(rank);
                assert!(near(found.condition, condition, 1e-3 * condition), "{lost:?} {seed}");
            }
            // What is said to have no effect has none, and every lost direction is told.
            let basis = found.ends.null_basis(found.told);
            assert_eq!(basis.len(), dense.unknowns() - rank, "{lost:?} {seed}");
            for (_, direction) in basis {
                let x: Vec<f64> =
                    direction.iter().zip(found.ends.scale()).map(|(effect, scale)| effect * scale).collect();
                assert!(dense.row_norm(&x) < 1e-4, "{lost:?} {seed}: {}", dense.row_norm(&x));
            }
        }
    }
}

#[test]
fn columns_of_zeros_are_those_of_unknowns_without_effect() {
    let case = Case::new(5, Lost::Nothing);
    let unknowns = case.own.len();
    for zero in [0, unknowns - 1] {
        let mask: Vec<bool> = (0..unknowns).map(|unknown| unknown == zero).collect();
        let found = case.arrow().with_zeros(&mask);
        assert_eq!(found.norms()[zero], 0.0);
        let spectrum = found.spectrum(TOLERANCE);
        assert_eq!((spectrum.rank, found.rows()), (unknowns - 1, case.rows.len()));
        assert!(near(found.cost(), case.dense().cost(), 1e-12 * found.cost()));
    }
}

#[test]
fn sources_make_up_the_whole() {
    let case = Case::new(7, Lost::Nothing);
    let arrow = case.arrow();
    let [one, other] = arrow.of_sources() else { panic!("two sources") };
    assert_eq!(one.rows() + other.rows(), case.rows.len());
    let root = arrow.of_shared().covariance_root(arrow.shared().len());
    let (whole, one, other) = (root.covariance(), root.part(one), root.part(other));
    for row in 0..whole.len() {
        let size = whole[row][row];
        assert!(
            near(one[row][row] + other[row][row], size, 1e-9 * size) && one[row][row] > 0.0 && other[row][row] > 0.0
        );
    }
}

#[test]
fn a_row_of_two_groups_is_refused() {
    let case = Case::new(9, Lost::Nothing);
    let groups = case.groups();
    let (one, other) = (groups.members()[0][0], groups.members()[1][0]);
    let mut accumulator = ArrowAccumulator::new(&groups, &[1]);
    let error = accumulator.push(0, &[one, other], &[1.0, 1.0], 0.0, 1.0).expect_err("two groups");
    assert_eq!((error.one, error.other), (one, other));
    assert!(accumulator.push(0, &[one, other], &[1.0, 0.0], 0.0, 1.0).is_ok());
}

#[test]
fn many_groups_in_any_order_take_memory_in_proportion() {
    // 30,000 groups of two unknowns: a dense triangle would have 14 GB.
    let (groups, shared) = (30_000, 4);
    let mut random = Random::new(11);
    let unknowns = shared + 2 * groups;
    let line = |round: usize, group: usize| {
        let place = (group as f64).mul_add(0.01, round as f64);
        [place.sin(), place.cos(), (2.0 * place).sin(), (3.0 * place).cos(), 1.0, (round as f64) - 1.5]
    };
    let truth: Vec<f64> = (0..unknowns).map(|_| random.signed()).collect();
    let columns = |group: usize| [0, 1, 2, 3, shared + 2 * group, shared + 2 * group + 1];
    let mut search = GroupSearch::new((0..unknowns).map(|unknown| unknown >= shared).collect());
    (0..groups).for_each(|group| search.row(&columns(group), &line(0, group)));
    let found = search.groups();
    let mut accumulator = ArrowAccumulator::new(&found, &[4 * groups]);
    for round in 0..4 {
        for group in 0..groups {
            let (columns, line) = (columns(group), line(round, group));
            let residual = -columns.iter().zip(line).map(|(&column, by)| truth[column] * by).sum::<f64>();
            accumulator.push(0, &columns, &line, residual, 1.0).expect("one group a row");
        }
    }
    let factor = accumulator.finish();
    assert!(factor.is_surely_full_rank(TOLERANCE));
    let step = factor.step().expect("full rank");
    assert!(step.iter().zip(&truth).all(|(found, truth)| near(*found, *truth, 1e-10)));
}
