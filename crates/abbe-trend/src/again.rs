//! When to measure again: the first time at which the limit of a parameter may be exceeded with more than the accepted risk.

use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, Normal};

use crate::change::{Uncertain, minimum};
use crate::least_squares::fit;

/// How the future of a parameter is told.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Forecast {
    /// A straight line through the last tests. Value and slope count as independent of each other.
    #[default]
    Line,
    /// The same line with the covariance of value and slope: the interval is shorter where the line grows.
    CorrelatedLine,
    /// A random walk with a trend; how far it walks follows from all tests by maximum likelihood.
    RandomWalk,
}

/// Limit, risk and forecast.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AgainRule {
    /// Largest admissible size of the parameter, in its unit.
    pub limit: f64,
    /// Accepted probability that it is exceeded.
    pub risk: f64,
    /// Tests that the line goes through.
    pub tests: usize,
    /// How the future is told.
    pub forecast: Forecast,
}

/// When to measure again.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Again {
    /// What has to be kept.
    pub rule: AgainRule,
    /// The value at the last test.
    pub value: Uncertain,
    /// Its change for each unit of time.
    pub rate: Uncertain,
    /// Whole units of time from the last test for which the risk is accepted; none if it never ends within `MOST`.
    pub after: Option<u64>,
    /// Whether the limit is exceeded with more than the risk already.
    pub now: bool,
    /// Time from the last test at which the value itself is expected to reach the limit; none if it moves away from it or is
    /// beyond it.
    pub reached: Option<f64>,
}

/// Units of time that are looked at.
pub const MOST: u64 = 100_000;

/// A forecast: value, slope, and the variance of the value a time later.
struct Future {
    value: Uncertain,
    rate: Uncertain,
    /// Variance after a time: `constant + linear t + square t²`.
    variance: [f64; 3],
}

/// Applies a rule to values at ascending times (not relative to a target); `end` is the last test. None with fewer than
/// three values.
pub fn again(rule: &AgainRule, at: &[f64], values: &[f64], uncertainties: &[f64], end: f64) -> Option<Again> {
    let future = match rule.forecast {
        Forecast::Line | Forecast::CorrelatedLine => {
            let from = at.len().saturating_sub(rule.tests);
            line(rule.forecast, &at[from..], &values[from..], &uncertainties[from..], end)?
        }
        Forecast::RandomWalk => random_walk(at, values, uncertainties, end)?,
    };
    let factor = Normal::standard().inverse_cdf(1.0 - rule.risk);
    let within = |time: u64| {
        let time = time as f64;
        let [constant, linear, square] = future.variance;
        let spread = (constant + linear * time + square * time * time).max(0.0).sqrt();
        (future.value.value + future.rate.value * time).abs() + factor * spread <= rule.limit
    };
    let now = !within(0);
    let after = if now { Some(0) } else { (1..=MOST).find(|time| !within(*time)).map(|time| time - 1) };
    let (value, rate) = (future.value.value, future.rate.value);
    let towards = rate.signum() * rule.limit - value;
    let reached = (rate != 0.0 && value.abs() <= rule.limit).then(|| towards / rate).filter(|time| time.is_finite());
    Some(Again { rule: *rule, value: future.value, rate: future.rate, after, now, reached })
}

fn line(forecast: Forecast, at: &[f64], values: &[f64], uncertainties: &[f64], end: f64) -> Option<Future> {
    if at.len() < 3 {
        return None;
    }
    let columns = [vec![1.0; at.len()], at.iter().map(|at| at - end).collect()];
    let fitted = fit(&columns, values, uncertainties)?;
    let (value, rate) = (fitted.value(0), fitted.value(1));
    let together = if forecast == Forecast::Line { 0.0 } else { fitted.covariance[(0, 1)] };
    Some(Future { value: value.into(), rate: rate.into(), variance: [value.1.powi(2), 2.0 * together, rate.1.powi(2)] })
}

/// Level and slope after the last test, by a Kalman filter that starts knowing nothing.
struct Filtered {
    state: [f64; 2],
    covariance: [f64; 3],
    log_likelihood: f64,
}

/// The filter for a random walk with `walk` as variance for each unit of time: the first two values determine the state.
fn filtered(walk: f64, at: &[f64], values: &[f64], uncertainties: &[f64]) -> Filtered {
    let interval = at[1] - at[0];
    let (one, two) = (uncertainties[0].powi(2), uncertainties[1].powi(2));
    let mut state = [values[1], (values[1] - values[0]) / interval];
    // Of level, of both, of slope: the level is the second value, the slope the difference of both.
    let mut covariance = [two, two / interval, (one + two + walk * interval) / interval.powi(2)];
    let mut log_likelihood = 0.0;
    for index in 2..at.len() {
        let time = at[index] - at[index - 1];
        predict(&mut state, &mut covariance, time, walk);
        let variance = covariance[0] + uncertainties[index].powi(2);
        let innovation = values[index] - state[0];
        log_likelihood -= 0.5 * (variance.ln() + innovation * innovation / variance);
        let (level, slope) = (covariance[0] / variance, covariance[1] / variance);
        state = [state[0] + level * innovation, state[1] + slope * innovation];
        covariance = [
            covariance[0] - level * covariance[0],
            covariance[1] - level * covariance[1],
            covariance[2] - slope * covariance[1],
        ];
    }
    Filtered { state, covariance, log_likelihood }
}

fn predict(state: &mut [f64; 2], covariance: &mut [f64; 3], time: f64, walk: f64) {
    state[0] += state[1] * time;
    covariance[0] += 2.0 * time * covariance[1] + time * time * covariance[2] + walk * time;
    covariance[1] += time * covariance[2];
}

fn random_walk(at: &[f64], values: &[f64], uncertainties: &[f64], end: f64) -> Option<Future> {
    if at.len() < 4 || at.windows(2).any(|pair| pair[1] <= pair[0]) {
        return None;
    }
    let typical = uncertainties.iter().map(|u| u * u).sum::<f64>() / at.len() as f64;
    let unlikely = |logarithm: f64| -filtered(logarithm.exp(), at, values, uncertainties).log_likelihood;
    let (low, high) = ((1e-8 * typical).ln(), (1e6 * typical).ln());
    let coarse = (0..60).map(|index| low + (high - low) * f64::from(index) / 59.0);
    let best = coarse.min_by(|one, other| unlikely(*one).total_cmp(&unlikely(*other)))?;
    let width = (high - low) / 59.0;
    let walk = minimum(best - width, best + width, unlikely).exp();
    let Filtered { mut state, mut covariance, .. } = filtered(walk, at, values, uncertainties);
    predict(&mut state, &mut covariance, end - at[at.len() - 1], walk);
    Some(Future {
        value: Uncertain::from((state[0], covariance[0].max(0.0).sqrt())),
        rate: Uncertain::from((state[1], covariance[2].max(0.0).sqrt())),
        variance: [covariance[0], 2.0 * covariance[1] + walk, covariance[2]],
    })
}

#[cfg(test)]
mod tests {
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    fn rule(forecast: Forecast) -> AgainRule {
        AgainRule { limit: 4.5, risk: 0.05, tests: 12, forecast }
    }

    /// The rule in words, with numbers that were worked out by hand.
    #[test]
    fn the_line_keeps_the_limit_as_long_as_the_rule_says() {
        // Twelve tests that lie on a line exactly: u(value) and u(slope) are those of the closed form.
        let at: Vec<f64> = (29..=40).map(f64::from).collect();
        let values: Vec<f64> = at.iter().map(|at| -4.0 - 0.06 * (at - 40.0)).collect();
        let found = again(&rule(Forecast::Line), &at, &values, &[0.14; 12], 40.0).unwrap();
        let spread: f64 = at.iter().map(|at| (at - 34.5f64).powi(2)).sum();
        let (slope, value) = (0.14 / spread.sqrt(), 0.14 * (1.0 / 12.0 + 5.5f64.powi(2) / spread).sqrt());
        assert!((found.rate.standard_uncertainty - slope).abs() < 1e-12);
        assert!((found.value.standard_uncertainty - value).abs() < 1e-12);
        let kept = |n: f64| 4.0 + 0.06 * n + 1.644_853_6 * (value.powi(2) + (n * slope).powi(2)).sqrt() <= 4.5;
        let expected = (0..100).take_while(|n| kept(f64::from(*n))).count() as u64 - 1;
        assert_eq!(found.after, Some(expected));
        assert!((found.reached.unwrap() - 0.5 / 0.06).abs() < 1e-9);
        let correlated = again(&rule(Forecast::CorrelatedLine), &at, &values, &[0.14; 12], 40.0).unwrap();
        assert!(correlated.after < found.after);
    }

    #[test]
    fn what_is_beyond_the_limit_is_due_now_and_what_stands_still_never() {
        let at: Vec<f64> = (1..=12).map(f64::from).collect();
        let found = again(&rule(Forecast::Line), &at, &[4.6; 12], &[0.1; 12], 12.0).unwrap();
        assert!(found.now && found.after == Some(0) && found.reached.is_none());
        let still = again(&rule(Forecast::RandomWalk), &at, &[0.0; 12], &[1e-9; 12], 12.0).unwrap();
        assert!(!still.now && still.after.is_none_or(|after| after > 1000));
        assert_eq!(again(&rule(Forecast::Line), &at[..2], &[0.0; 2], &[0.1; 2], 2.0), None);
    }

    /// 5 % of random walks exceed the limit at the time that follows from their history: the forecast is honest.
    #[test]
    fn forecasts_of_random_walks_hold() {
        let (mut exceeded, mut told, mut left) = (0, 0, 0.0);
        for seed in 0..2000 {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            let mut draw = || -> f64 { StandardNormal.sample(&mut random) };
            let mut level = 0.0;
            let at: Vec<f64> = (0..40).map(f64::from).collect();
            let values: Vec<f64> = (0..40)
                .map(|_| {
                    level += 0.3 * draw() + 0.05;
                    level + 0.2 * draw()
                })
                .collect();
            let rule = AgainRule { limit: level.abs() + 2.0, risk: 0.05, tests: 12, forecast: Forecast::RandomWalk };
            let Some(Again { after: Some(after), now: false, .. }) = again(&rule, &at, &values, &[0.2; 40], 39.0)
            else {
                continue;
            };
            told += 1;
            left += after as f64;
            for _ in 0..=after {
                level += 0.3 * draw() + 0.05;
            }
            exceeded += usize::from(level.abs() > rule.limit);
        }
        let share = exceeded as f64 / f64::from(told);
        assert!(told > 1500 && left / f64::from(told) > 2.0);
        // A forecast one step beyond the accepted risk, with a walk that is estimated: close to 5 %, never far more.
        assert!((0.02..0.10).contains(&share), "{share}");
    }
}
