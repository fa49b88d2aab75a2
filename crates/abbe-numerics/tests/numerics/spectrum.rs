//! Proves rank, null space, the choice of unknowns to leave out and minimum-norm results on problems that lost
//! directions by construction, whatever the units of their unknowns.

use crate::problems::{Linear, Random, dot, norm};

/// A problem whose last `lost` columns are combinations of the others, in a random order, in units from 1e-12 to 1e6.
fn deficient(random: &mut Random) -> (Linear, usize) {
    let (free, lost) = (2 + random.below(8), 1 + random.below(4));
    let rows = 40 + random.below(40);
    let mut problem = Linear::random(random, rows, free);
    for _ in 0..lost {
        let mix: Vec<f64> = (0..free).map(|_| random.signed()).collect();
        for row in &mut problem.rows {
            let value = dot(&row[..free], &mix);
            row.push(value);
        }
    }
    let mut order: Vec<usize> = (0..free + lost).collect();
    random.shuffle(&mut order);
    for row in &mut problem.rows {
        *row = order.iter().map(|&column| row[column]).collect();
    }
    let units: Vec<f64> = order.iter().map(|_| 10.0_f64.powf(9.0 * random.signed() - 3.0)).collect();
    problem.scale_columns(&units);
    (problem, free)
}

#[test]
fn null_vectors_do_nothing_and_complete_the_rank() {
    let mut worst = 0.0_f64;
    for seed in 0..60 {
        let random = &mut Random::new(seed);
        let (problem, rank) = deficient(random);
        let n = problem.unknowns();
        let factor = problem.factor(5);
        let spectrum = factor.spectrum();
        assert_eq!((spectrum.singular_values().rank(1e-9), factor.singular_values().rank(1e-9)), (rank, rank));
        let basis = spectrum.null_basis(rank);
        assert_eq!(basis.len(), n - rank);
        for (singular_value, vector) in &basis {
            assert!(*singular_value < 1e-13, "{singular_value:e}");
            let largest = vector.iter().fold(0.0_f64, |largest, value| largest.max(value.abs()));
            assert!(largest == 1.0 && vector.contains(&1.0));
            let x: Vec<f64> = vector.iter().zip(spectrum.scale()).map(|(value, scale)| value * scale).collect();
            worst = worst.max(norm(&problem.apply(&x)) / norm(vector));
        }
        // Independent of one another: as a problem of their own they have full rank.
        let vectors: Vec<Vec<f64>> = (0..n).map(|row| basis.iter().map(|(_, vector)| vector[row]).collect()).collect();
        let own = Linear { residuals: vec![0.0; n], rows: vectors };
        assert_eq!(own.factor(n).singular_values().rank(1e-6), n - rank);
    }
    println!("largest effect of a null vector: {worst:.1e}");
    assert!(worst < 1e-12, "{worst:e}");
}

#[test]
fn null_vectors_and_their_order_do_not_depend_on_rounding() {
    for seed in 0..60 {
        let (mut problem, rank) = deficient(&mut Random::new(seed));
        let basis = problem.factor(5).spectrum().null_basis(rank);
        problem.rows.reverse();
        let again = problem.factor(7).spectrum().null_basis(rank);
        for ((_, one), (_, other)) in basis.iter().zip(&again) {
            assert!(one.iter().zip(other).all(|(one, other)| (one - other).abs() < 1e-8), "{seed}: {one:?} {other:?}");
        }
    }
}

#[test]
fn pairs_that_are_alike_come_out_as_pairs() {
    for seed in 0..40 {
        let random = &mut Random::new(seed);
        let free = 4 + random.below(6);
        let mut problem = Linear::random(random, 60, free);
        let mut others: Vec<usize> = (0..free).collect();
        random.shuffle(&mut others);
        // Each of some columns once more at the end, with another unit and sign.
        let twins = &others[..1 + random.below(3)];
        for row in &mut problem.rows {
            let copies: Vec<f64> = twins.iter().map(|&column| row[column]).collect();
            row.extend(copies);
        }
        let units: Vec<f64> = (0..problem.unknowns())
            .map(|_| 10.0_f64.powf(9.0 * random.signed() - 3.0) * if random.below(2) == 0 { 1.0 } else { -1.0 })
            .collect();
        problem.scale_columns(&units);
        let spectrum = problem.factor(9).spectrum();
        let mut found: Vec<(usize, usize)> = Vec::new();
        for (_, vector) in spectrum.null_basis(free) {
            let taking_part: Vec<usize> = (0..vector.len()).filter(|&index| vector[index] != 0.0).collect();
            assert_eq!(taking_part.len(), 2, "seed {seed}: {vector:?}");
            let [a, b] = [taking_part[0], taking_part[1]];
            let expected = -units[a].signum() * units[b].signum();
            assert!((vector[a] * vector[b] - expected).abs() < 1e-9, "{vector:?}");
            found.push((a, b));
        }
        found.sort_unstable();
        let mut pairs: Vec<(usize, usize)> = twins.iter().enumerate().map(|(k, &twin)| (twin, free + k)).collect();
        pairs.sort_unstable();
        assert_eq!(found, pairs);
    }
}

#[test]
fn without_the_dependent_ones_nothing_is_lost() {
    let mut smallest = 1.0_f64;
    for seed in 0..60 {
        let random = &mut Random::new(500 + seed);
        let (problem, rank) = deficient(random);
        let dependent = problem.factor(50).spectrum().dependent(rank, &(0..problem.unknowns()).collect::<Vec<_>>());
        assert_eq!(dependent.len(), problem.unknowns() - rank);
        assert!(dependent.is_sorted_by(|a, b| a < b));
        let mut rest = problem.clone();
        for row in &mut rest.rows {
            let mut index = 0..row.len();
            row.retain(|_| !dependent.contains(&index.next().unwrap_or(0)));
        }
        let values = rest.factor(50).singular_values();
        smallest = smallest.min(values.values()[rank - 1] / values.values()[0]);
        assert_eq!(values.rank(1e-9), rank);
    }
    println!("smallest singular value that is left: {smallest:.1e}");
    // Leaving out what takes part most keeps what remains well determined.
    assert!(smallest > 1e-4, "{smallest:e}");
}

/// What the last unknown of the order loses is hardly its own: without it, an error of its start value would be fifty times as large in
/// another one.
#[test]
fn what_hardly_takes_part_in_what_is_lost_is_not_left_out() {
    for (share, left_out) in [(0.02, 1), (0.5, 2)] {
        let mut problem = Linear::random(&mut Random::new(11), 20, 3);
        for row in &mut problem.rows {
            row[1] = row[0] + share * row[2];
        }
        let norms: Vec<f64> = (0..3).map(|column| 1.0 / norm(&problem.column(column))).collect();
        problem.scale_columns(&norms);
        assert_eq!(problem.factor(20).spectrum().dependent(2, &[0, 1, 2]), [left_out]);
    }
}

#[test]
fn of_all_steps_the_shortest() {
    let mut worst = [0.0_f64; 4];
    for seed in 0..40 {
        let random = &mut Random::new(900 + seed);
        let (problem, rank) = deficient(random);
        let spectrum = problem.factor(6).spectrum();
        let step = spectrum.step(rank);
        let scaled: Vec<f64> = step.iter().zip(spectrum.scale()).map(|(step, scale)| step / scale).collect();
        let after: Vec<f64> = problem.apply(&step).iter().zip(&problem.residuals).map(|(by, r)| by + r).collect();
        for column in (0..problem.unknowns()).map(|index| problem.column(index)) {
            worst[0] = worst[0].max(dot(&column, &after).abs() / norm(&column) / norm(&after));
        }
        for (_, vector) in spectrum.null_basis(rank) {
            worst[1] = worst[1].max(dot(&vector, &scaled).abs() / norm(&vector) / norm(&scaled));
        }
        // Moore and Penrose: J C J^T J = J with C the covariance, and leverages that add up to the rank.
        let covariance = spectrum.covariance_root(rank).covariance();
        let unit = 1.0 / spectrum.scale()[0];
        let column = problem.column(0);
        let gradient: Vec<f64> = (0..problem.unknowns()).map(|k| dot(&problem.column(k), &column)).collect();
        let x: Vec<f64> = covariance.iter().map(|row| dot(row, &gradient)).collect();
        let again = problem.apply(&x);
        let missed: Vec<f64> = again.iter().zip(&column).map(|(again, value)| again - value).collect();
        worst[2] = worst[2].max(norm(&missed) / unit);
        let leverages: f64 = spectrum.covariance_root(rank).leverages(&problem.rows.concat()).iter().sum();
        worst[3] = worst[3].max((leverages - rank as f64).abs());
    }
    println!("largest deviations: {}", worst.map(|value| format!("{value:.0e}")).join(" "));
    assert!(worst.iter().all(|&deviation| deviation < 1e-9), "{worst:?}");
}

#[test]
fn an_unknown_without_effect_is_lost_alone() {
    let mut problem = Linear::random(&mut Random::new(3), 20, 4);
    problem.scale_columns(&[1.0, 0.0, 1e-9, 1e4]);
    let factor = problem.factor(20);
    let spectrum = factor.spectrum();
    assert_eq!((spectrum.singular_values().rank(1e-9), factor.step()), (3, None));
    let basis = spectrum.null_basis(3);
    let expected: (f64, Vec<f64>) = (0.0, vec![0.0, 1.0, 0.0, 0.0]);
    assert!(basis[0].0 < 1e-15 && basis[0].1 == expected.1, "{basis:?}");
    assert_eq!(spectrum.dependent(3, &[0, 1, 2, 3]), [1]);
    assert!(spectrum.step(3)[1].abs() < 1e-14);
}

#[test]
fn what_is_not_finite_has_no_rank() {
    for broken in [f64::NAN, f64::INFINITY] {
        let mut problem = Linear::random(&mut Random::new(4), 20, 3);
        problem.rows[7][1] = broken;
        let factor = problem.factor(20);
        assert_eq!(factor.singular_values().rank(1e-9), 0);
        assert_eq!(factor.spectrum().singular_values().rank(1e-9), 0);
        assert_eq!(factor.step(), None);
    }
}
