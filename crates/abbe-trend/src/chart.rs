//! Control charts of the normalised deviations of a parameter from its target.

use abbe_core::in_parallel;
use serde::{Deserialize, Serialize};

use crate::run_length::{cumulative_sum, individuals, limit_for, moving_range, weighted_average};

/// How charts are made.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ChartDesign {
    /// Average number of tests between false alarms of every chart.
    pub run_length: f64,
    /// Weight of the newest value in the exponentially weighted moving average, 0 to 1.
    pub weight: f64,
    /// Reference value of the cumulative sums: half the change that they find fastest, in standard uncertainties.
    pub reference: f64,
}

impl Default for ChartDesign {
    fn default() -> Self {
        Self { run_length: 370.0, weight: 0.2, reference: 0.5 }
    }
}

/// Limits of the charts, in standard uncertainties.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ChartLimits {
    /// Of single values.
    pub individuals: f64,
    /// Of the difference of successive values.
    pub moving_range: f64,
    /// Of the weighted moving average itself.
    pub average: f64,
    /// Of either cumulative sum.
    pub sum: f64,
}

impl ChartDesign {
    /// The limits that give the run length, from the integral equations of the charts.
    pub fn limits(&self) -> ChartLimits {
        // Each solves some systems of equations: together they take as long as the slowest.
        let charts: [&(dyn Fn() -> f64 + Sync); 4] = [
            &|| limit_for(self.run_length, 0.1, 8.0, individuals),
            &|| limit_for(self.run_length, 0.1, 11.0, moving_range),
            &|| limit_for(self.run_length, 0.1, 6.0, |limit| weighted_average(self.weight, limit)),
            &|| limit_for(self.run_length, 0.1, 30.0, |limit| cumulative_sum(self.reference, limit)),
        ];
        let limits = in_parallel(&charts, None, |limit| limit());
        ChartLimits {
            individuals: limits[0],
            moving_range: limits[1],
            average: limits[2] * (self.weight / (2.0 - self.weight)).sqrt(),
            sum: limits[3],
        }
    }
}

/// The charts of one parameter, a value for each test.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Charts {
    /// Deviation from the target over its standard uncertainty.
    pub normalised: Vec<f64>,
    /// Absolute difference from the test before; none for the first.
    pub moving_range: Vec<Option<f64>>,
    /// Exponentially weighted moving average.
    pub average: Vec<f64>,
    /// Cumulative sum of what is above the target.
    pub above: Vec<f64>,
    /// Cumulative sum of what is below.
    pub below: Vec<f64>,
    /// Which charts are beyond their limits.
    pub alarms: Vec<Alarms>,
}

/// Which charts are beyond their limits at a test.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Alarms {
    /// Single values.
    pub individuals: bool,
    /// Moving range: the scatter, not the value.
    pub moving_range: bool,
    /// Weighted moving average.
    pub average: bool,
    /// Cumulative sums.
    pub sum: bool,
}

impl Alarms {
    /// Number of charts of the value that are beyond their limits. The moving range is one of the scatter.
    pub fn of_value(&self) -> usize {
        [self.individuals, self.average, self.sum].into_iter().filter(|alarm| *alarm).count()
    }
}

impl Charts {
    /// The charts of normalised deviations. All start at zero; an alarm resets none, so that what has changed stays visible.
    pub fn of(normalised: &[f64], design: &ChartDesign, limits: &ChartLimits) -> Self {
        let mut charts = Self::default();
        let (mut average, mut above, mut below) = (0.0, 0.0f64, 0.0f64);
        let mut last: Option<f64> = None;
        for &z in normalised {
            average += design.weight * (z - average);
            above = (above + z - design.reference).max(0.0);
            below = (below - z - design.reference).max(0.0);
            let range = last.map(|last| (z - last).abs());
            last = Some(z);
            charts.normalised.push(z);
            charts.moving_range.push(range);
            charts.average.push(average);
            charts.above.push(above);
            charts.below.push(below);
            charts.alarms.push(Alarms {
                individuals: z.abs() > limits.individuals,
                moving_range: range.is_some_and(|range| range > limits.moving_range),
                average: average.abs() > limits.average,
                sum: above.max(below) > limits.sum,
            });
        }
        charts
    }

    /// Tests with an alarm that nothing confirms: one chart of the value alone, and no chart at the next test. The last of all
    /// tests waits for the next one.
    pub fn unconfirmed(&self) -> Vec<usize> {
        let count = |index: usize| self.alarms.get(index).map_or(0, Alarms::of_value);
        let alone = |index: &usize| {
            let before = index.checked_sub(1).map_or(0, count);
            count(*index) == 1 && count(*index + 1) == 0 && before == 0
        };
        (0..self.alarms.len()).filter(alone).collect()
    }

    /// Whether another chart or the next test confirms an alarm.
    pub fn has_confirmed(&self) -> bool {
        !self.confirmed().is_empty()
    }

    /// Tests with an alarm that another chart or the next test confirms.
    pub fn confirmed(&self) -> Vec<usize> {
        let alone = self.unconfirmed();
        (0..self.alarms.len()).filter(|index| self.alarms[*index].of_value() > 0 && !alone.contains(index)).collect()
    }
}

#[cfg(test)]
mod tests {
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    /// Tests until the first alarm on a machine in control.
    fn run(seed: u64, design: &ChartDesign, limits: &ChartLimits, first: impl Fn(&Charts) -> Option<usize>) -> f64 {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut length = 512;
        let mut z: Vec<f64> = Vec::new();
        loop {
            while z.len() < length {
                z.push(StandardNormal.sample(&mut random));
            }
            if let Some(index) = first(&Charts::of(&z, design, limits)) {
                return (index + 1) as f64;
            }
            length *= 4;
        }
    }

    /// The mean run length of 1,000 machines lies within 99 % limits about the computed one, for every chart and designs apart.
    #[test]
    fn simulated_run_lengths_are_the_computed_ones() {
        type First = fn(&Charts) -> Option<usize>;
        let charts: [(&str, First); 4] = [
            ("individuals", |charts| charts.alarms.iter().position(|alarms| alarms.individuals)),
            ("moving range", |charts| charts.alarms.iter().position(|alarms| alarms.moving_range)),
            ("average", |charts| charts.alarms.iter().position(|alarms| alarms.average)),
            ("sum", |charts| charts.alarms.iter().position(|alarms| alarms.sum)),
        ];
        for (number, design) in
            [ChartDesign::default(), ChartDesign { run_length: 200.0, weight: 0.4, reference: 0.25 }].iter().enumerate()
        {
            let limits = design.limits();
            for (chart, (name, first)) in charts.iter().enumerate() {
                let seed = |machine: u64| machine + 10_000 * (1 + chart as u64 + 10 * number as u64);
                let lengths: Vec<f64> = (0..1000).map(|machine| run(seed(machine), design, &limits, first)).collect();
                let mean = lengths.iter().sum::<f64>() / 1000.0;
                let scatter = (lengths.iter().map(|length| (length - mean).powi(2)).sum::<f64>() / 999.0).sqrt();
                let apart = (mean - design.run_length) / (scatter / 1000f64.sqrt());
                assert!(apart.abs() < 2.576, "{name}: {mean:.1} against {}: {apart:.2}", design.run_length);
            }
        }
    }

    #[test]
    fn a_lone_alarm_is_unconfirmed_and_a_change_is_not() {
        let design = ChartDesign::default();
        let limits = design.limits();
        let mut z = vec![0.0; 20];
        z[7] = -3.4;
        let charts = Charts::of(&z, &design, &limits);
        assert_eq!((charts.unconfirmed(), charts.confirmed()), (vec![7], vec![]));
        z[12..].fill(8.0);
        let charts = Charts::of(&z, &design, &limits);
        assert_eq!((charts.unconfirmed(), charts.confirmed()), (vec![7], (12..20).collect()));
        // One test is enough if several charts say so.
        let mut z = vec![0.0; 20];
        z[19] = 25.0;
        assert_eq!(Charts::of(&z, &design, &limits).confirmed(), [19]);
    }
}
