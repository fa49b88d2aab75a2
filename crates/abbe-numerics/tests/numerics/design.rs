//! Exchange against trying everything, on problems that are small enough.

use abbe_numerics::{Criterion, Design, DesignProblem, Generator};

const ALL: [Criterion; 5] = [Criterion::D, Criterion::A, Criterion::E, Criterion::G, Criterion::Condition];

/// Candidates with random rows; each of `blocks` says how many.
fn choice(seed: u64, unknowns: usize, blocks: &[usize], criterion: Criterion) -> DesignProblem {
    let mut generator = Generator::new(seed, 0);
    let mut ends = Vec::new();
    blocks.iter().for_each(|rows| ends.push(ends.last().copied().unwrap_or(0) + rows));
    let rows = (0..ends[blocks.len() - 1] * unknowns).map(|_| generator.normal()).collect();
    DesignProblem {
        unknowns,
        of_interest: unknowns,
        rows,
        ends,
        measured: vec![0.0; unknowns * unknowns],
        costs: vec![1.0; blocks.len()],
        required: Vec::new(),
        allowed: vec![true; blocks.len()],
        replications: false,
        number: Some(unknowns + 1),
        budget: None,
        criterion,
    }
}

fn by_exchange(choice: &DesignProblem, restarts: u64) -> Design {
    let designs = (0..restarts).filter_map(|trial| choice.exchange(&mut Generator::new(7, trial)));
    designs.max_by(|one, other| one.value.total_cmp(&other.value)).expect("a design")
}

/// The best of all designs that are allowed.
fn by_trying(choice: &DesignProblem) -> Design {
    fn go(choice: &DesignProblem, chosen: &mut Vec<usize>, from: usize, best: &mut Option<Design>) {
        let cost: f64 = chosen.iter().map(|&index| choice.costs[index]).sum();
        if choice.budget.is_some_and(|budget| cost > budget) {
            return;
        }
        if choice.number.is_none_or(|number| chosen.len() == number)
            && choice.required.iter().all(|index| chosen.contains(index))
        {
            let design = choice.design(chosen.clone());
            if best.as_ref().is_none_or(|best| design.value > best.value) {
                *best = Some(design);
            }
        }
        if choice.number.is_some_and(|number| chosen.len() == number) {
            return;
        }
        for index in from..choice.candidates() {
            if choice.allowed[index] || choice.required.contains(&index) {
                chosen.push(index);
                go(choice, chosen, if choice.replications { index } else { index + 1 }, best);
                chosen.pop();
            }
        }
    }
    let mut best = None;
    go(choice, &mut Vec::new(), 0, &mut best);
    best.expect("a design")
}

#[track_caller]
fn same(choice: &DesignProblem, what: &str) {
    let (found, best) = (by_exchange(choice, 60), by_trying(choice));
    assert!(
        (found.value - best.value).abs() <= 1e-9 * best.value.abs().max(1.0),
        "{what}: {found:?}, the best is {best:?}"
    );
}

#[test]
fn the_best_of_all_designs_is_found() {
    for criterion in ALL {
        for seed in 0..5 {
            let single = choice(seed, 3, &[1; 9], criterion);
            same(&single, &format!("{criterion:?} {seed}"));
            same(&DesignProblem { replications: true, ..single }, &format!("{criterion:?} {seed}, replicated"));
            let blocks = choice(seed, 4, &[2, 1, 3, 2, 1, 1, 4, 2], criterion);
            same(&DesignProblem { number: Some(3), ..blocks }, &format!("{criterion:?} {seed}, blocks"));
        }
    }
}

#[test]
fn what_is_required_forbidden_or_measured_counts() {
    for criterion in ALL {
        let mut bound = choice(11, 3, &[1; 10], criterion);
        (bound.required, bound.allowed[4], bound.allowed[5]) = (vec![2], false, false);
        let found = by_exchange(&bound, 40);
        assert!(found.chosen.contains(&2) && !found.chosen.contains(&4) && !found.chosen.contains(&5), "{found:?}");
        same(&bound, "required and forbidden");
        // Three numbers more of one unknown.
        bound.measured[0] = 50.0;
        same(&DesignProblem { number: Some(3), ..bound }, "measured");
    }
}

#[test]
fn some_unknowns_may_count_alone() {
    for criterion in ALL {
        for seed in 20..24 {
            same(
                &DesignProblem { of_interest: 2, ..choice(seed, 4, &[1; 9], criterion) },
                &format!("{criterion:?} {seed}"),
            );
        }
    }
}

#[test]
fn a_budget_is_kept() {
    for criterion in [Criterion::D, Criterion::A] {
        let mut bound = choice(31, 2, &[1; 8], criterion);
        (bound.number, bound.budget) = (None, Some(5.0));
        bound.costs = vec![1.0, 2.0, 1.0, 0.5, 3.0, 1.5, 1.0, 2.0];
        let found = by_exchange(&bound, 100);
        assert!(found.chosen.iter().map(|&index| bound.costs[index]).sum::<f64>() <= 5.0);
        same(&bound, "budget");
        assert_eq!(DesignProblem { required: vec![4, 1, 5], ..bound }.exchange(&mut Generator::new(1, 0)), None);
    }
}

#[test]
fn figures_are_those_of_the_covariance() {
    // A line through y at -1, 0, 1: variances 1/3 and 1/2, uncorrelated; what is read at 1 has 1/3 + 1/2.
    let line = DesignProblem {
        rows: vec![1.0, -1.0, 1.0, 0.0, 1.0, 1.0],
        ends: vec![1, 2, 3],
        ..choice(0, 2, &[1; 3], Criterion::D)
    };
    let figures = line.figures(&[0, 1, 2]).expect("determined");
    let near = |found: f64, expected: f64| assert!((found - expected).abs() < 1e-14, "{found}, expected {expected}");
    near(figures.log_determinant, 6.0_f64.ln());
    near(figures.mean_variance, (1.0 / 3.0 + 0.5) / 2.0);
    near(figures.worst_variance, 0.5);
    near(figures.condition, 1.0);
    near(figures.response_variance[0], 2.0 / 3.0);
    near(figures.response_variance[1], 5.0 / 6.0);
    assert_eq!(line.figures(&[1, 1]), None);
    assert_eq!(line.design(vec![1]).value, f64::NEG_INFINITY);
}

#[test]
fn the_same_numbers_give_the_same_design() {
    let choice = choice(5, 6, &[1; 60], Criterion::D);
    let design = |trial| choice.exchange(&mut Generator::new(3, trial));
    assert_eq!(design(4), design(4));
}
