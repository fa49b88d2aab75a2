//! The state that an input drives.

use abbe_core::Result;

use crate::log::SensorLog;

/// A state with gain 1 at rest, and its derivative to the logarithm of its time constant.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Response {
    /// The state at each time, in the unit of the input.
    pub values: Vec<f64>,
    /// Its derivative to ln(time constant).
    pub slopes: Vec<f64>,
}

/// Below this part of the time constant a series stands for differences of nearly equal numbers.
const SHORT: f64 = 0.02;

/// (1 - exp(-a))/a and its derivative to a.
fn mean_decay(a: f64) -> (f64, f64) {
    if a < SHORT {
        let value = 1.0 - a / 2.0 * (1.0 - a / 3.0 * (1.0 - a / 4.0 * (1.0 - a / 5.0 * (1.0 - a / 6.0))));
        let slope = -0.5 + a / 3.0 - a * a / 8.0 + a.powi(3) / 30.0 - a.powi(4) / 144.0 + a.powi(5) / 840.0;
        return (value, slope);
    }
    let value = -(-a).exp_m1() / a;
    (value, ((-a).exp() - value) / a)
}

/// State and slope after a time of `a` time constants, the input going from one value to another.
fn step([state, slope]: [f64; 2], [from, to]: [f64; 2], a: f64) -> [f64; 2] {
    let decay = (-a).exp();
    let (mean, mean_slope) = mean_decay(a);
    let next = decay * state - (-a).exp_m1() * from + (1.0 - mean) * (to - from);
    let next_slope = decay * slope + a * decay * (state - from) + a * mean_slope * (to - from);
    [next, next_slope]
}

/// The state of a sensor's input over a log, for one time constant.
#[derive(Debug, Clone, PartialEq)]
pub struct History {
    sensor: usize,
    time_constant: f64,
    /// State and slope at the rows of the log.
    rows: Vec<[f64; 2]>,
}

impl History {
    /// The state at all rows of the log; it is zero at the beginning.
    pub fn new(log: &SensorLog, sensor: usize, time_constant: f64) -> Self {
        Self::from_state(log, sensor, time_constant, 0.0)
    }

    /// The same for a machine that had long stood at its first reading.
    pub fn from_rest(log: &SensorLog, sensor: usize, time_constant: f64) -> Self {
        Self::from_state(log, sensor, time_constant, log.values(sensor)[0])
    }

    fn from_state(log: &SensorLog, sensor: usize, time_constant: f64, state: f64) -> Self {
        let times = log.times();
        let mut now = [state, 0.0];
        let mut rows = vec![now];
        for row in 0..times.len() - 1 {
            let length = times[row + 1] - times[row];
            now = step(now, log.ends(sensor, row, length), length / time_constant);
            rows.push(now);
        }
        Self { sensor, time_constant, rows }
    }

    /// State and its derivative to ln(time constant) at a time; `log` is the one that it was made from.
    ///
    /// Fails for a time outside the log.
    pub fn at(&self, log: &SensorLog, time: f64) -> Result<[f64; 2]> {
        let (row, within) = log.interval(time)?;
        Ok(step(self.rows[row], log.ends(self.sensor, row, within), within / self.time_constant))
    }
}

impl Response {
    /// The state of a sensor's input at some times; it is zero at the beginning of the log.
    ///
    /// Fails for a time outside the log.
    pub fn new(log: &SensorLog, sensor: usize, time_constant: f64, times: &[f64]) -> Result<Self> {
        let history = History::new(log, sensor, time_constant);
        let mut found = Self::default();
        for time in times {
            let [value, slope] = history.at(log, *time)?;
            found.values.push(value);
            found.slopes.push(slope);
        }
        Ok(found)
    }

    /// What is left of a state that was 1 at the beginning of the log, at some times.
    pub fn of_beginning(log: &SensorLog, time_constant: f64, times: &[f64]) -> Self {
        let of = |time: &f64| {
            let a = (time - log.times()[0]) / time_constant;
            ((-a).exp(), a * (-a).exp())
        };
        let (values, slopes) = times.iter().map(of).unzip();
        Self { values, slopes }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn series_and_closed_form_agree() {
        for a in [1e-9, 1e-4, 0.01, 0.0199999, 0.0200001, 0.5, 7.0, 40.0] {
            let (value, slope) = mean_decay(a);
            // In steps of a fiftieth: the mean of exp(-x) over 0..a, by Simpson's rule.
            let h = a / 2000.0;
            let simpson: f64 = (0..=2000)
                .map(|k| {
                    let weight = if k == 0 || k == 2000 {
                        1.0
                    } else if k % 2 == 1 {
                        4.0
                    } else {
                        2.0
                    };
                    weight * (-h * f64::from(k)).exp()
                })
                .sum::<f64>()
                / 6000.0;
            assert!((value - simpson).abs() < 1e-9, "{a}: {value} {simpson}");
            let d = 1e-5 * a.max(1e-3);
            let difference = (mean_decay(a + d).0 - mean_decay((a - d).max(0.0)).0) / (d + d.min(a));
            assert!((slope - difference).abs() < 1e-6, "{a}: {slope} {difference}");
        }
    }
}
