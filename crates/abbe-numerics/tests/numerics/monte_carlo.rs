//! Proves the propagation of distributions on the examples of the GUM and its supplements, and the statistics of trials
//! against truth, definitions and sorting.

use abbe_numerics::{
    AdaptiveProcedure, Generator, Interval, Trials, compare_with_gum, coverage_factor, least_trials,
    numerical_tolerance,
};

/// Trials `range` of a calculation with seed 1, each writing the results of one trial.
fn run(quantities: usize, range: std::ops::Range<usize>, trial: impl Fn(&mut Generator, &mut [f64])) -> Trials {
    let mut trials = Trials::new(quantities);
    let mut results = vec![0.0; quantities];
    for k in range {
        trial(&mut Generator::new(1, k as u64), &mut results);
        trials.push(&results);
    }
    trials
}

fn close(found: f64, expected: f64, tolerance: f64) {
    assert!((found - expected).abs() <= tolerance, "{found} is not {expected}");
}

fn ends(interval: Interval, low: f64, high: f64, tolerance: f64) {
    close(interval.low, low, tolerance);
    close(interval.high, high, tolerance);
}

#[test]
fn a_sum_of_four_is_that_of_the_examples() {
    // JCGM 101:2008, 9.2.2, 9.2.3 and 9.2.4.
    let trials = run(3, 0..200_000, |generator, results| {
        results[0] = (0..4).map(|_| generator.normal()).sum();
        let [a, b, c, d] = [(); 4].map(|()| generator.uniform());
        results[1] = a + b + c + d;
        results[2] = a + b + c + 10.0 * d;
    });
    assert_eq!(trials.count(), 200_000);
    let (mean, uncertainty) = (trials.mean(), trials.standard_uncertainties());
    let framework = |u: f64| coverage_factor(0.95, f64::INFINITY) * u;
    let digits = |quantity: usize, u: f64, digits: u32| {
        let interval = trials.symmetric_interval(quantity, 0.95);
        compare_with_gum(0.0, framework(u), interval, numerical_tolerance(u, digits))
    };
    for (quantity, u, end) in [(0, 2.0, 3.92), (1, 2.0, 3.88), (2, 10.149, 17.0)] {
        close(mean[quantity], 0.0, 4.0 * u / 200_000_f64.sqrt());
        close(uncertainty[quantity], u, 0.01 * u);
        // Four standard deviations of a quantile.
        let scatter = if quantity == 2 { 0.1 } else { 0.045 };
        ends(trials.symmetric_interval(quantity, 0.95), -end, end, scatter);
        // All three distributions are symmetric; what is symmetric and of one peak is shortest.
        let symmetric = trials.symmetric_interval(quantity, 0.95).length();
        let shortest = trials.shortest_interval(quantity, 0.95).length();
        assert!(shortest <= symmetric && shortest > symmetric - 0.03 * u, "{shortest}, {symmetric}");
    }
    assert!(digits(0, 2.0, 2).agrees, "{:?}", digits(0, 2.0, 2));
    // +-3.92 instead of +-3.88: right to one digit.
    assert!(digits(1, 2.0, 1).agrees && !digits(1, 2.0, 3).agrees, "{:?}", digits(1, 2.0, 1));
    let far = digits(2, 10.149, 2);
    assert!(!far.agrees);
    close(far.low_difference, 2.9, 0.1);
    close(far.high_difference, 2.9, 0.1);
    close(framework(10.149), 19.9, 0.05);
}

#[test]
fn validation_needs_both_ends() {
    // Four rectangular quantities exactly (Irwin & Hall): the tail of x from the end is x^4 / 24.
    let end = (2.0 - 0.6_f64.powf(0.25)) * 2.0 * 3.0_f64.sqrt();
    let exact = Interval { low: -end, high: end };
    let agreement = compare_with_gum(0.0, 3.92, exact, numerical_tolerance(2.0, 2));
    assert!(agreement.agrees);
    close(agreement.low_difference, 0.04, 0.001);
    close(agreement.high_difference, 0.04, 0.001);
    assert!(!compare_with_gum(0.0, 3.92, exact, numerical_tolerance(2.0, 3)).agrees);
    assert!(!compare_with_gum(0.02, 3.92, exact, 0.05).agrees && !compare_with_gum(-0.02, 3.92, exact, 0.05).agrees);
    assert!(!compare_with_gum(f64::NAN, 3.92, exact, 0.05).agrees);
}

const VOLTAGE: [f64; 5] = [5.007, 4.994, 5.005, 4.990, 4.999];
const CURRENT: [f64; 5] = [19.663e-3, 19.639e-3, 19.640e-3, 19.685e-3, 19.678e-3];
const PHASE: [f64; 5] = [1.0456, 1.0438, 1.0468, 1.0428, 1.0433];

/// Resistance, reactance and impedance in ohm.
fn impedance([voltage, current, phase]: [f64; 3]) -> [f64; 3] {
    let z = voltage / current;
    [z * phase.cos(), z * phase.sin(), z]
}

fn correlations(covariance: &[Vec<f64>]) -> [f64; 3] {
    let of = |a: usize, b: usize| covariance[a][b] / (covariance[a][a] * covariance[b][b]).sqrt();
    [of(0, 1), of(0, 2), of(1, 2)]
}

/// Means of V, I and phi, and the covariance of the means.
fn inputs() -> ([f64; 3], Vec<Vec<f64>>) {
    let mut observations = Trials::new(3);
    (0..5).for_each(|k| observations.push(&[VOLTAGE[k], CURRENT[k], PHASE[k]]));
    let mean = observations.mean();
    let of_mean = observations.covariance().iter().map(|row| row.iter().map(|value| value / 5.0).collect()).collect();
    ([mean[0], mean[1], mean[2]], of_mean)
}

#[test]
fn simultaneous_observations_are_those_of_the_example() {
    // JCGM 100:2008, H.2, table H.2.
    let (mean, covariance) = inputs();
    let uncertainty: Vec<f64> = (0..3).map(|i| covariance[i][i].sqrt()).collect();
    for (found, expected, last) in [
        (mean[0], 4.9990, 5e-5),
        (mean[1], 19.6610e-3, 5e-8),
        (mean[2], 1.044_46, 5e-6),
        (uncertainty[0], 0.0032, 5e-5),
        (uncertainty[1], 0.0095e-3, 5e-8),
        (uncertainty[2], 0.000_75, 5e-6),
    ] {
        close(found, expected, last);
    }
    for (found, expected) in correlations(&covariance).into_iter().zip([-0.36, 0.86, -0.65]) {
        close(found, expected, 0.005);
    }
}

#[test]
fn correlated_inputs_give_the_results_of_the_example() {
    // JCGM 100:2008, H.2, tables H.3 and H.4: first by linear propagation, then by trials as in JCGM 102:2011.
    let (mean, covariance) = inputs();
    let estimate = impedance(mean);
    let slopes: Vec<Vec<f64>> = (0..3)
        .map(|input| {
            let step = 1e-6 * mean[input];
            let at = |step: f64| {
                let mut shifted = mean;
                shifted[input] += step;
                impedance(shifted)
            };
            let (up, down) = (at(step), at(-step));
            (0..3).map(|output| (up[output] - down[output]) / (2.0 * step)).collect()
        })
        .collect();
    let linear = |a: usize, b: usize| -> f64 {
        let inner = |i: usize| (0..3).map(|j| covariance[i][j] * slopes[j][b]).sum::<f64>();
        (0..3).map(|i| slopes[i][a] * inner(i)).sum()
    };
    let linear: Vec<Vec<f64>> = (0..3).map(|a| (0..3).map(|b| linear(a, b)).collect()).collect();

    // The lower triangular root of the covariance of the inputs.
    let mut root = [[0.0; 3]; 3];
    for row in 0..3 {
        for column in 0..=row {
            let rest = covariance[row][column] - (0..column).map(|k| root[row][k] * root[column][k]).sum::<f64>();
            root[row][column] = if row == column { rest.sqrt() } else { rest / root[column][column] };
        }
    }
    let trials = run(3, 0..100_000, |generator, results| {
        let normal = [(); 3].map(|()| generator.normal());
        let input = |row: usize| mean[row] + (0..3).map(|k| root[row][k] * normal[k]).sum::<f64>();
        results.copy_from_slice(&impedance([input(0), input(1), input(2)]));
    });

    let expected = [(127.732, 0.071), (219.847, 0.295), (254.260, 0.236)];
    let found = trials.mean();
    for (output, (value, uncertainty)) in expected.into_iter().enumerate() {
        close(estimate[output], value, 5e-4);
        // The example cuts the 0.2956 of the reactance to 0.295.
        close(linear[output][output].sqrt(), uncertainty, 1e-3);
        close(found[output], value, 5e-4 + 4.0 * uncertainty / 100_000_f64.sqrt());
        close(trials.standard_uncertainties()[output], uncertainty, 1e-3 + 0.01 * uncertainty);
        let interval = trials.symmetric_interval(output, 0.95);
        ends(interval, value - 1.96 * uncertainty, value + 1.96 * uncertainty, 5e-4 + 0.03 * uncertainty);
    }
    let by_trials = trials.covariance();
    for (k, expected) in [-0.588, -0.485, 0.993].into_iter().enumerate() {
        close(correlations(&linear)[k], expected, 5e-4);
        close(correlations(&by_trials)[k], expected, 5e-4 + 0.015 * (1.0 - expected * expected));
    }
}

#[test]
fn covariance_is_stable_whatever_the_sizes() {
    // The same three quantities as they are, about 100 with a spread of 1e-12, and in units from 1e-12 to 1e12.
    let correlated = |generator: &mut Generator| {
        let (a, b) = (generator.normal(), generator.uniform());
        [a, 0.6 * a + 0.8 * b, 1e-3 * b]
    };
    let plain = run(3, 0..20_000, |generator, results| results.copy_from_slice(&correlated(generator))).covariance();
    for (one, other, expected) in [(0, 1, 0.6), (0, 2, 0.0), (1, 2, 0.8e-3), (1, 1, 1.0), (2, 2, 1e-6)] {
        close(plain[one][other], expected, 0.03 * (plain[one][one] * plain[other][other]).sqrt());
    }
    let units = [1e-12, 1e2, 1e12];
    let mixed = run(3, 0..20_000, |generator, results| {
        let values = correlated(generator);
        results.iter_mut().zip(values).zip(units).for_each(|((result, value), unit)| *result = value * unit);
    });
    let far = run(3, 0..20_000, |generator, results| {
        let values = correlated(generator);
        results.iter_mut().zip(values).for_each(|(result, value)| *result = 1e6 + 1e-3 * value);
    });
    // A spread of 70 units in the last place.
    let tiny = run(1, 0..20_000, |generator, results| results[0] = 100.0 + 1e-12 * correlated(generator)[0]);
    close(tiny.standard_uncertainties()[0] / 1e-12 / plain[0][0].sqrt(), 1.0, 1e-3);
    close(tiny.symmetric_interval(0, 0.95).length() / 1e-12, 3.92, 0.15);
    for one in 0..3 {
        for other in 0..3 {
            let size = (plain[one][one] * plain[other][other]).sqrt();
            let scaled = mixed.covariance()[one][other] / units[one] / units[other];
            close(scaled / size, plain[one][other] / size, 1e-12);
            close(far.covariance()[one][other] * 1e6 / size, plain[one][other] / size, 1e-5);
            assert_eq!(mixed.covariance()[one][other], mixed.covariance()[other][one]);
        }
    }
}

#[test]
fn few_trials_are_what_the_definitions_say() {
    let mut trials = Trials::new(2);
    assert!(trials.mean()[0].is_nan() && trials.covariance()[0][1].is_nan());
    assert!(trials.symmetric_interval(0, 0.95).low.is_nan() && trials.shortest_interval(0, 0.95).low.is_nan());
    trials.push(&[3.0, 1.0]);
    assert_eq!(trials.mean(), [3.0, 1.0]);
    assert!(trials.standard_uncertainties()[0].is_nan());
    assert_eq!(trials.symmetric_interval(0, 0.95), Interval { low: 3.0, high: 3.0 });
    assert_eq!(trials.shortest_interval(0, 0.95), Interval { low: 3.0, high: 3.0 });
    trials.push(&[5.0, 0.0]);
    assert_eq!(trials.covariance(), [[2.0, -1.0], [-1.0, 0.5]]);
    assert!(trials.symmetric_interval(2, 0.95).low.is_nan());
    assert!(trials.symmetric_interval(0, 1.0).low.is_nan());

    // 1, 4, 9 ... 400 in any order. p M = 10: q = 10, r = 5, from the 5th to the 15th; the shortest from the first.
    // p M = 7: q = 7, r = (20 - 7 + 1) / 2 = 7. p M = 18.5 of 37 is not whole: q = 19, r = 9.
    for (count, probability, low, high) in [(20, 0.5, 5, 15), (20, 0.35, 7, 14), (37, 0.5, 9, 28)] {
        let mut trials = Trials::new(1);
        (0..count).for_each(|k| trials.push(&[((7 * k % count + 1) as f64).powi(2)]));
        let square = |rank: usize| (rank as f64).powi(2);
        let symmetric = trials.symmetric_interval(0, probability);
        assert_eq!(symmetric, Interval { low: square(low), high: square(high) });
        let shortest = trials.shortest_interval(0, probability);
        assert_eq!(shortest, Interval { low: 1.0, high: square(1 + high - low) });
    }
}

/// Results of three quantities, normal, skew and with two peaks, each with its standard deviation.
fn shapes(generator: &mut Generator) -> [f64; 3] {
    let normal = generator.normal();
    let side = if generator.index(2) == 0 { -3.0 } else { 3.0 };
    [normal, (0.5 * generator.normal()).exp(), side + 0.1 * generator.uniform()]
}

#[test]
fn bins_are_as_good_as_sorting() {
    let count = 100_000;
    let mut exact = vec![Vec::new(); 3];
    let trials = run(3, 0..count, |generator, results| results.copy_from_slice(&shapes(generator)));
    for k in 0..count {
        let values = shapes(&mut Generator::new(1, k as u64));
        exact.iter_mut().zip(values).for_each(|(list, value)| list.push(value));
    }
    exact.iter_mut().for_each(|values| values.sort_by(f64::total_cmp));
    for (quantity, deviation) in trials.standard_uncertainties().into_iter().enumerate() {
        for probability in [0.3, 0.6827, 0.95, 0.99, 0.9999] {
            let covered = (probability * count as f64).round() as usize;
            let first = (count - covered).div_ceil(2);
            let sorted = &exact[quantity];
            let found = trials.symmetric_interval(quantity, probability);
            ends(found, sorted[first - 1], sorted[first + covered - 1], 1e-3 * deviation);
            let shortest = trials.shortest_interval(quantity, probability);
            let length = |start: usize| sorted[start + covered] - sorted[start];
            let least = (0..count - covered).map(length).fold(f64::INFINITY, f64::min);
            close(shortest.length(), least, 2e-3 * deviation);
            // It is an interval of that many values too.
            let inside =
                sorted.partition_point(|v| *v <= shortest.high) - sorted.partition_point(|v| *v < shortest.low);
            assert!(inside.abs_diff(covered) < 300, "{inside} for {covered}");
        }
    }
}

#[test]
fn quantiles_of_many_normal_trials_are_the_true_ones() {
    // The standard deviation of a 2.5 % quantile of 200,000 trials is 0.006 about the truth.
    let unit = 1e-4;
    let trials = run(1, 0..200_000, |generator, results| results[0] = 20.0 + unit * generator.normal());
    let interval = trials.symmetric_interval(0, 0.95);
    ends(interval, 20.0 - 1.959_964 * unit, 20.0 + 1.959_964 * unit, 0.02 * unit);
    let mut exact: Vec<f64> = (0..200_000).map(|k| 20.0 + unit * Generator::new(1, k).normal()).collect();
    exact.sort_by(f64::total_cmp);
    ends(interval, exact[4_999], exact[194_999], 1e-3 * unit);
    ends(trials.symmetric_interval(0, 0.5), exact[49_999], exact[149_999], 1e-3 * unit);
}

#[test]
fn the_shortest_interval_of_a_skew_quantity_starts_at_its_end() {
    for count in [10_000, 100_000] {
        // The inverse of the exponential distribution at a rectangular quantity.
        let trials = run(1, 0..count, |generator, results| {
            results[0] = -(0.5 - generator.uniform() / 12.0_f64.sqrt()).ln();
        });
        let shortest = trials.shortest_interval(0, 0.95);
        ends(shortest, 0.0, 20.0_f64.ln(), 0.2);
        assert!((0.0..0.02).contains(&shortest.low), "{shortest:?}");
        ends(trials.symmetric_interval(0, 0.95), -0.975_f64.ln(), -0.025_f64.ln(), 0.3);
        assert!(shortest.length() < trials.symmetric_interval(0, 0.95).length() - 0.3);
    }
}

#[test]
fn quantities_that_hardly_vary_have_intervals() {
    // Always 0.1; 0.1 but for one trial in a thousand; 0 but for one in four.
    let trials = run(3, 0..40_000, |generator, results| {
        let rare = generator.index(1000) == 0;
        results[0] = 0.1;
        results[1] = if rare { 0.3 } else { 0.1 };
        results[2] = f64::from(u8::from(generator.index(4) == 0));
    });
    for quantity in 0..2 {
        ends(trials.symmetric_interval(quantity, 0.95), 0.1, 0.1, 1e-5);
        ends(trials.shortest_interval(quantity, 0.95), 0.1, 0.1, 1e-5);
    }
    assert_eq!((trials.mean()[0], trials.standard_uncertainties()[0]), (0.1, 0.0));
    assert_eq!(trials.symmetric_interval(0, 0.95), Interval { low: 0.1, high: 0.1 });
    ends(trials.symmetric_interval(2, 0.95), 0.0, 1.0, 1e-3);
    ends(trials.shortest_interval(2, 0.7), 0.0, 0.0, 1e-3);

    // The first differences come after the values went into bins.
    let mut late = Trials::new(1);
    (0..30_000).for_each(|k| late.push(&[if k < 20_000 { 5.0 } else { 5.0 + f64::from(k % 3 - 1) }]));
    ends(late.symmetric_interval(0, 0.5), 5.0, 5.0, 0.0);
    let wide = late.symmetric_interval(0, 0.99);
    assert!((4.0..5.0).contains(&wide.low) && wide.high > 5.0 && wide.high <= 6.0, "{wide:?}");
}

#[test]
fn what_is_not_finite_spoils_its_own_quantity_only() {
    for at in [0, 100, 20_000] {
        for wrong in [f64::NAN, f64::INFINITY] {
            let mut trials = Trials::new(2);
            (0..20_010).for_each(|k| trials.push(&[if k == at { wrong } else { 1.0 }, f64::from(k % 10)]));
            assert!(!trials.mean()[0].is_finite() && trials.symmetric_interval(0, 0.95).low.is_nan());
            close(trials.mean()[1], 4.5, 1e-9);
            close(trials.covariance()[1][1], 8.25, 0.01);
            ends(trials.symmetric_interval(1, 0.95), 0.0, 9.0, 0.01);
        }
    }
}

#[test]
fn tolerances_are_half_of_the_last_digit() {
    for (uncertainty, digits, tolerance) in [
        (0.000_35, 2, 0.000_005),
        (0.000_35, 1, 0.000_05),
        (2.0, 1, 0.5),
        (2.0, 2, 0.05),
        (2.0, 3, 0.005),
        (10.149, 2, 0.5),
        (9.96, 2, 0.5),
        (9.94, 2, 0.05),
        (0.096, 1, 0.05),
        (35.0, 2, 0.5),
        (4.2e7, 2, 5e5),
        (1e-12, 1, 5e-13),
    ] {
        assert_eq!(numerical_tolerance(uncertainty, digits), tolerance, "{uncertainty} with {digits}");
    }
    assert_eq!(numerical_tolerance(0.0, 2), 0.0);
    assert!(numerical_tolerance(f64::NAN, 2).is_nan() && numerical_tolerance(f64::INFINITY, 2).is_nan());
    let least = [0.9, 0.95, 0.99, 0.999, 0.6827, 0.9545].map(least_trials);
    assert_eq!(least, [1000, 2000, 10_000, 100_000, 316, 2198]);
}

/// Pushes batches until the procedure ends: the procedure and the number of batches.
fn adapt(
    mut adaptive: AdaptiveProcedure,
    quantities: usize,
    trial: impl Fn(&mut Generator, &mut [f64]),
) -> (AdaptiveProcedure, usize) {
    let mut batches = 0;
    while !adaptive.finished() {
        let first = adaptive.trials();
        adaptive.push_batch(&run(quantities, first..first + adaptive.batch(), &trial));
        batches += 1;
        assert_eq!(adaptive.trials(), batches * adaptive.batch());
    }
    (adaptive, batches)
}

#[test]
fn the_adaptive_procedure_stops_when_results_are_stable() {
    let trial = |generator: &mut Generator, results: &mut [f64]| {
        results[0] = generator.normal();
        results[1] = 7.25;
        results[2] = 1e-9 * generator.uniform() - 0.1;
        // A quantity that is nothing but rounding.
        results[3] = 0.3 + f64::from(generator.index(2) as u32) * 5e-17;
    };
    let (one, batches) = adapt(AdaptiveProcedure::new(1, 0.95, 1_000_000), 4, trial);
    assert!(one.stable() && one.unstable().is_empty());
    assert!(one.ratios().iter().all(|ratio| *ratio <= 1.0), "{:?}", one.ratios());
    assert_eq!(one.ratios()[1], 0.0);
    assert!((2..20).contains(&batches), "{batches}");
    assert_eq!(one.trials(), 10_000 * batches);
}

#[test]
fn the_adaptive_procedure_says_what_is_not_stable() {
    // Three digits of 1.01 ask for about (2 x 2.7 / 0.005)^2 trials because of the ends of the interval: 1.2 million.
    let trial = |generator: &mut Generator, results: &mut [f64]| {
        results[0] = 5.0;
        results[1] = 1.01 * generator.normal();
    };
    let (three, batches) = adapt(AdaptiveProcedure::new(3, 0.95, 35_000), 2, trial);
    assert!(!three.stable() && three.finished());
    assert_eq!((batches, three.trials(), three.unstable()), (3, 30_000, vec![1]));
    assert!(three.ratios()[1] > 1.0 && three.ratios()[0] == 0.0);
    // Not even room for a batch, or for a second one.
    let (less, batches) = adapt(AdaptiveProcedure::new(1, 0.95, 500), 2, trial);
    assert_eq!((batches, less.trials(), less.stable(), less.unstable()), (1, 500, false, vec![0, 1]));
    let (single, batches) = adapt(AdaptiveProcedure::new(1, 0.95, 19_999), 2, trial);
    assert_eq!((batches, single.stable()), (1, false));
    assert_eq!(AdaptiveProcedure::new(1, 0.95, 1_000_000).batch(), 10_000);
    assert_eq!(AdaptiveProcedure::new(1, 0.999, 1_000_000).batch(), 100_000);
    // What is not finite is never stable.
    let (wrong, _) = adapt(AdaptiveProcedure::new(1, 0.95, 30_000), 1, |_, results| results[0] = f64::NAN);
    assert_eq!((wrong.stable(), wrong.unstable()), (false, vec![0]));
}

#[test]
fn stability_is_that_of_the_definition() {
    // Three batches of two numbers: 9 and 11, 10 and 14, 8 and 10, with intervals from the one to the other.
    let mut adaptive = AdaptiveProcedure::new(1, 0.95, 10_000);
    for (low, high) in [(9.0, 11.0), (10.0, 14.0), (8.0, 10.0)] {
        let mut batch = Trials::new(1);
        batch.push(&[low]);
        batch.push(&[high]);
        adaptive.push_batch(&batch);
    }
    // Averages of the upper ends: mean 35/3, squares 26/3, s^2 = 26/3 / (3 x 2). All six numbers: u = 2.066, 0.5.
    let s = (26.0_f64 / 3.0 / 6.0).sqrt();
    close(adaptive.ratios()[0], 2.0 * s / 0.5, 1e-12);
}

#[test]
fn random_numbers_have_the_variance_they_say() {
    let (freedom, count) = (7.0, 100_000);
    let trials = run(4, 0..count, |generator, results| {
        results.copy_from_slice(&[generator.normal(), generator.uniform(), generator.student(freedom), 0.0]);
        results[3] = generator.index(6) as f64;
    });
    let covariance = trials.covariance();
    for (quantity, (mean, variance)) in [(0.0, 1.0), (0.0, 1.0), (0.0, 1.0), (2.5, 35.0 / 12.0)].into_iter().enumerate()
    {
        close(trials.mean()[quantity], mean, 0.02);
        close(covariance[quantity][quantity] / variance, 1.0, 0.03);
        (0..quantity).for_each(|other| close(covariance[quantity][other], 0.0, 0.03));
    }
    let scaled = coverage_factor(0.95, freedom) * (1.0 - 2.0 / freedom).sqrt();
    ends(trials.symmetric_interval(2, 0.95), -scaled, scaled, 0.04);
    let rectangle = 0.95 * 3.0_f64.sqrt();
    ends(trials.symmetric_interval(1, 0.95), -rectangle, rectangle, 0.01);
    ends(trials.symmetric_interval(3, 0.99), 0.0, 5.0, 0.01);
    let generator = &mut Generator::new(3, 0);
    assert!(generator.student(2.0).is_nan() && generator.student(f64::NAN).is_nan());
    assert!(generator.student(f64::INFINITY).is_finite());
    assert_eq!((generator.index(0), generator.index(1)), (0, 0));
    let mut seen = [false; 6];
    (0..100).for_each(|_| seen[generator.index(6)] = true);
    assert_eq!(seen, [true; 6]);
}

#[test]
fn a_trial_is_the_same_on_any_thread() {
    let numbers = |seed: u64, trial: u64| {
        let mut generator = Generator::new(seed, trial);
        [generator.normal(), generator.uniform(), generator.student(4.0), generator.index(1000) as f64]
    };
    let one_by_one: Vec<[f64; 4]> = (0..64).map(|trial| numbers(9, trial)).collect();
    let threads: Vec<_> = (0..64).rev().map(|trial| std::thread::spawn(move || numbers(9, trial))).collect();
    let threaded: Vec<[f64; 4]> = threads.into_iter().rev().map(|thread| thread.join().expect("no panic")).collect();
    assert_eq!(one_by_one, threaded);
    assert!(one_by_one.iter().enumerate().all(|(k, row)| one_by_one[..k].iter().all(|other| other[1] != row[1])));
    assert_ne!(numbers(9, 0), numbers(10, 0));
    // Results are compared from version to version: these numbers must not change.
    let expected = [1.598_939_784_178_518, 0.633_032_913_582_157_5, -0.455_009_316_264_597_2, 444.0];
    numbers(1, 2).into_iter().zip(expected).for_each(|(found, expected)| close(found, expected, 1e-14));
}
