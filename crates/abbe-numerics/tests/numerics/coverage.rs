//! Proves coverage factors against the tables of the GUM and its second supplement, closed forms and direct sums.

use abbe_numerics::{
    Generator, binomial_band, chi_squared_quantile, chi_squared_upper_tail, coverage_factor,
    effective_degrees_of_freedom, hotelling_quantile, hotelling_upper_tail, joint_coverage_factor,
    rectangular_coverage_factor, two_sided_normal,
};

fn close(found: f64, expected: f64, tolerance: f64) {
    assert!((found - expected).abs() <= tolerance, "{found} is not {expected}");
}

#[test]
fn factors_of_one_quantity_are_those_of_the_table() {
    // JCGM 100:2008, table G.2.
    for (probability, degrees_of_freedom, factor) in [
        (0.6827, 1.0, 1.84),
        (0.6827, 10.0, 1.05),
        (0.95, 1.0, 12.71),
        (0.95, 2.0, 4.30),
        (0.95, 5.0, 2.57),
        (0.95, 10.0, 2.23),
        (0.95, 50.0, 2.01),
        (0.9545, 4.0, 2.87),
        (0.99, 10.0, 3.17),
        (0.99, 16.0, 2.92),
        (0.9973, 5.0, 5.51),
        (0.95, f64::INFINITY, 1.96),
        (0.99, f64::INFINITY, 2.576),
    ] {
        close(coverage_factor(probability, degrees_of_freedom), factor, 0.00501);
    }
    for probability in [0.1, 0.5, 0.9, 0.95, 0.99, 0.9973, 1.0 - 1e-6] {
        // Closed forms for one and two degrees of freedom.
        let cauchy = (std::f64::consts::FRAC_PI_2 * probability).tan();
        close(coverage_factor(probability, 1.0) / cauchy, 1.0, 1e-9);
        let two = probability * (2.0 / ((1.0 + probability) * (1.0 - probability))).sqrt();
        close(coverage_factor(probability, 2.0) / two, 1.0, 1e-9);
        close(two_sided_normal(coverage_factor(probability, f64::INFINITY)), 1.0 - probability, 1e-9);
    }
}

#[test]
fn many_degrees_of_freedom_come_to_the_normal_distribution() {
    for probability in [0.5, 0.95, 0.9999] {
        let normal = coverage_factor(probability, f64::INFINITY);
        for power in 2..=15 {
            let degrees_of_freedom = 10.0_f64.powi(power);
            // The first two terms of Cornish and Fisher's expansion, what is left out being of the third power.
            let square = normal * normal;
            let first = (square + 1.0) / 4.0 / degrees_of_freedom;
            let second = ((5.0 * square + 16.0) * square + 3.0) / 96.0 / degrees_of_freedom.powi(2);
            let tolerance = 1e-11 + 2.0 * first.powi(3);
            close(coverage_factor(probability, degrees_of_freedom) / normal, 1.0 + first + second, tolerance);
        }
    }
}

#[test]
fn factors_of_several_quantities_are_those_of_the_table() {
    // JCGM 102:2011, table 1, and Bonferroni's.
    let ellipsoids = [1.96, 2.45, 2.80, 3.08, 3.33];
    let rectangles = [1.96, 2.24, 2.39, 2.50, 2.58];
    for quantities in 1..=5 {
        close(joint_coverage_factor(quantities, 0.95, f64::INFINITY), ellipsoids[quantities - 1], 0.005);
        close(rectangular_coverage_factor(quantities, 0.95, f64::INFINITY), rectangles[quantities - 1], 0.005);
    }
    for probability in [0.5, 0.95, 0.999] {
        let one = coverage_factor(probability, f64::INFINITY);
        close(joint_coverage_factor(1, probability, f64::INFINITY), one, 1e-9);
        close(rectangular_coverage_factor(1, probability, f64::INFINITY), one, 1e-9);
    }
    let many = rectangular_coverage_factor(1000, 0.95, f64::INFINITY);
    close(two_sided_normal(many) * 1000.0, 0.05, 1e-9);
}

#[test]
fn chi_squared_has_its_quantiles() {
    for (probability, degrees_of_freedom, value) in [
        (0.95, 1.0, 3.841_459),
        (0.95, 2.0, 5.991_465),
        (0.95, 3.0, 7.814_728),
        (0.95, 10.0, 18.307_038),
        (0.05, 10.0, 3.940_299),
        (0.99, 5.0, 15.086_272),
        (0.95, 100.0, 124.342_113),
    ] {
        close(chi_squared_quantile(probability, degrees_of_freedom), value, 1e-6);
        close(chi_squared_upper_tail(value, degrees_of_freedom), 1.0 - probability, 1e-7);
    }
    // Two degrees of freedom: an exponential distribution.
    for value in [0.0, 1e-3, 1.0, 50.0, 600.0] {
        close(chi_squared_upper_tail(value, 2.0) / (-value / 2.0).exp(), 1.0, 1e-9);
    }
    for degrees_of_freedom in [0.5, 7.3, 5e4, 2e6] {
        for probability in [0.025, 0.5, 0.975, 0.999_999] {
            let value = chi_squared_quantile(probability, degrees_of_freedom);
            close(chi_squared_upper_tail(value, degrees_of_freedom), 1.0 - probability, 2e-9);
        }
    }
    assert_eq!(chi_squared_upper_tail(-1.0, 3.0), 1.0);
    assert_eq!(chi_squared_upper_tail(f64::INFINITY, 3.0), 0.0);
}

#[test]
fn what_makes_no_sense_is_not_a_number() {
    for wrong in [0.0, 1.0, -0.5, 1.5, f64::NAN] {
        assert!(coverage_factor(wrong, 5.0).is_nan());
        assert!(joint_coverage_factor(2, wrong, f64::INFINITY).is_nan());
        assert!(rectangular_coverage_factor(2, wrong, f64::INFINITY).is_nan());
        assert!(chi_squared_quantile(wrong, 5.0).is_nan());
    }
    for wrong in [0.0, -1.0, f64::NAN] {
        assert!(coverage_factor(0.95, wrong).is_nan());
        assert!(chi_squared_quantile(0.95, wrong).is_nan());
        assert!(chi_squared_upper_tail(1.0, wrong).is_nan());
    }
    assert!(
        joint_coverage_factor(0, 0.95, f64::INFINITY).is_nan()
            && rectangular_coverage_factor(0, 0.95, f64::INFINITY).is_nan()
    );
    assert!(chi_squared_upper_tail(f64::NAN, 2.0).is_nan());
    assert_eq!(binomial_band(10, f64::NAN, 0.95), (0, 10));
    assert_eq!(binomial_band(10, 0.5, 1.0), (0, 10));
}

/// Probability of each count of successes.
fn binomial(trials: usize, probability: f64) -> Vec<f64> {
    let mut row = vec![1.0];
    for _ in 0..trials {
        let mut next = vec![0.0; row.len() + 1];
        for (count, share) in row.iter().enumerate() {
            next[count] += share * (1.0 - probability);
            next[count + 1] += share * probability;
        }
        row = next;
    }
    row
}

#[test]
fn a_band_of_counts_is_the_smallest_central_one() {
    // P(X <= 1) = 11/1024, P(X <= 2) = 56/1024.
    assert_eq!(binomial_band(10, 0.5, 0.95), (2, 8));
    // P(X = 0) = 1/4 of two trials is what the tail may have.
    assert_eq!(binomial_band(2, 0.5, 0.5), (1, 1));
    assert_eq!(binomial_band(10, 0.0, 0.95), (0, 0));
    assert_eq!(binomial_band(10, 1.0, 0.95), (10, 10));
    assert_eq!(binomial_band(0, 0.3, 0.95), (0, 0));
    for trials in [1, 2, 7, 40, 200, 400] {
        for probability in [0.01, 0.3, 0.5, 0.6827, 0.95, 0.999] {
            let shares = binomial(trials, probability);
            for confidence in [0.5, 0.9, 0.99, 0.999] {
                let (low, high) = binomial_band(trials, probability, confidence);
                let sum = |counts: &[f64]| counts.iter().sum::<f64>();
                let tail = (1.0 - confidence) / 2.0 + 1e-13;
                let context = format!("{trials} trials, {probability}, {confidence}: {low} to {high}");
                assert!(sum(&shares[..low]) <= tail && sum(&shares[high + 1..]) <= tail, "{context}");
                assert!(sum(&shares[..=low]) > tail && (high == 0 || sum(&shares[high..]) > tail), "{context}");
                assert!(sum(&shares[low..=high]) >= confidence - 1e-12, "{context}");
            }
        }
    }
}

#[test]
fn degrees_of_freedom_add_up_as_those_of_the_end_gauge() {
    // JCGM 100:2008, H.1.6, in nm: there the sum is rounded to 32 nm, which gives 16.7.
    let parts = [(25.0_f64, 18.0), (9.7, 25.6), (2.9, 50.0), (16.6, 2.0)].map(|(u, freedom)| (u * u, freedom));
    close(effective_degrees_of_freedom(&parts), 16.76, 0.01);
    // In mm, and with a part that is known perfectly.
    let small = parts.map(|(variance, freedom)| (variance * 1e-180, freedom));
    close(effective_degrees_of_freedom(&small), 16.76, 0.01);
    let equal = [(2.0, 10.0), (2.0, f64::INFINITY)];
    close(effective_degrees_of_freedom(&equal), 40.0, 1e-12);
    close(effective_degrees_of_freedom(&[(3.0, 7.0)]), 7.0, 1e-12);
    close(effective_degrees_of_freedom(&[(3.0, 7.0), (0.0, 1.0)]), 7.0, 1e-12);
    for infinite in [&[][..], &[(1.0, f64::INFINITY), (0.0, 3.0)], &[(0.0, 3.0)]] {
        assert_eq!(effective_degrees_of_freedom(infinite), f64::INFINITY);
    }
}

/// T² with q = 1 is Student's t squared; with q = 2 and 10 degrees of freedom 20/9 F(0.95; 2, 9) = 20/9 * 4.2565.
#[test]
fn the_squared_distance_of_a_found_covariance_is_wider_than_chi_squared() {
    let t = coverage_factor(0.95, 12.0);
    assert!((hotelling_quantile(0.95, 1, 12.0) / (t * t) - 1.0).abs() < 1e-9);
    assert!((hotelling_quantile(0.95, 2, 10.0) - 20.0 / 9.0 * 4.2565).abs() < 1e-3);
    let stated = hotelling_quantile(0.95, 4, f64::INFINITY);
    assert!((stated - 9.4877).abs() < 1e-4);
    assert!((hotelling_upper_tail(stated, 4, f64::INFINITY) - 0.05).abs() < 1e-9);
    let found = hotelling_quantile(0.95, 4, 15.0);
    assert!((hotelling_upper_tail(found, 4, 15.0) - 0.05).abs() < 1e-9);
    assert!(hotelling_quantile(0.95, 16, 15.0).is_nan());
    assert!(hotelling_quantile(0.95, 16, 15.4).is_nan());
    // F(0.95; 3, 13) = 3.4105; chi-squared gives 2.80.
    let position = joint_coverage_factor(3, 0.95, 15.0);
    assert!((position - (45.0 / 13.0 * 3.4105_f64).sqrt()).abs() < 1e-3 && (position - 3.44).abs() < 5e-3);
    assert!(joint_coverage_factor(16, 0.95, 15.0).is_nan());
    // Student's t with 15 degrees of freedom at 1 - 0.05 / 10 / 2.
    assert!((rectangular_coverage_factor(10, 0.95, 15.0) - 3.286).abs() < 1e-3);
}

#[test]
fn quantiles_are_found_whatever_the_degrees_of_freedom() {
    // Degrees of freedom of sums (Welch-Satterthwaite) are no whole numbers; those of 92 and rounding once did not end.
    let mut random = Generator::new(11, 0);
    for case in 0..4000 {
        let whole = 1.0 + (case % 300) as f64;
        let freedom = whole * [1.0, 1.0 + 1e-12, 1.0 + 1e-15, 1.0 + 0.3 * random.uniform().abs()][case % 4];
        let probability = [0.5, 0.95, 0.9987, 1.0 - 1e-6][case / 4 % 4];
        let factor = coverage_factor(probability, freedom);
        let quantities = 1 + case % 7;
        let squared = hotelling_quantile(probability, 1, freedom);
        assert!(
            (squared.sqrt() / factor - 1.0).abs() < 1e-9,
            "{freedom} at {probability}: {factor}, {}",
            squared.sqrt()
        );
        if quantities as f64 <= freedom {
            let region = hotelling_quantile(probability, quantities, freedom);
            let tail = hotelling_upper_tail(region, quantities, freedom);
            assert!((tail / (1.0 - probability) - 1.0).abs() < 1e-6, "{quantities} of {freedom}: {tail}");
        }
    }
}
