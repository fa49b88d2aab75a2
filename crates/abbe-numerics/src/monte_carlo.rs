//! Propagation of distributions (JCGM 101:2008, clause 7; JCGM 102:2011, clause 7): statistics of the results of many trials,
//! and the decision when there are enough trials.
//!
//! This module runs no trials. Results have to be pushed in the order of the trials, for any threads that calculated them;
//! then the same trials give the same bits.

/// Number of trials whose values are kept; later ones are only counted in bins.
const KEPT: usize = 1 << 14;

/// Bins in one standard deviation of the kept values.
const BINS_PER_DEVIATION: usize = 1000;

/// How far the bins reach to either side of the mean, in standard deviations of the kept values.
const REACH: usize = 10;

/// Fewest trials in a batch of the adaptive procedure (JCGM 101:2008, 7.9.4 b).
const LEAST_BATCH: usize = 10_000;

/// Fewest trials from which a coverage interval of `probability` can be read: the smallest whole number that is at
/// least `100 / (1 - probability)` (JCGM 101:2008, 7.9.4 b). `usize::MAX` for a probability of 1.
pub fn least_trials(probability: f64) -> usize {
    let least = 100.0 / (1.0 - probability);
    // 1 - 0.9 is a little less than 0.1, which must not make 1001 of 1000.
    (least * (1.0 - 1e-12)).ceil() as usize
}

/// A coverage interval, both ends included, in the unit of its quantity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interval {
    /// Its lower end.
    pub low: f64,
    /// Its upper end.
    pub high: f64,
}

impl Interval {
    const UNKNOWN: Self = Self { low: f64::NAN, high: f64::NAN };

    /// Distance of the ends.
    pub fn length(&self) -> f64 {
        self.high - self.low
    }
}

/// Results of trials, one number per quantity and trial.
///
/// Memory does not grow with the number of trials: the values of the first 16,384 are kept and give exact intervals. Then the
/// values of each quantity are counted in 20,000 bins, a thousandth of its standard deviation wide, over 10 standard
/// deviations to either side of its mean. Values outside are counted on either side, and the extremes are known exactly. The
/// ends of intervals are exact to the width of a bin if they are within the bins. A quantity that was constant in the first
/// trials has one bin for this value.
///
/// A quantity with a value that is not finite has NaN for results; other quantities are not affected.
#[derive(Debug, Clone)]
pub struct Trials {
    count: usize,
    /// The first trial. Everything is summed up relative to it, because a spread of 1e-12 about 100 would otherwise be
    /// lost in the rounding of the mean.
    origin: Vec<f64>,
    /// Mean relative to the origin.
    mean: Vec<f64>,
    /// Sums of products of differences from the mean: the lower triangle, row by row.
    products: Vec<f64>,
    /// Differences of the newest trial from the mean before it; kept to spare an allocation per trial.
    differences: Vec<f64>,
    values: Vec<Values>,
}

impl Trials {
    /// Of `quantities` quantities, before the first trial.
    pub fn new(quantities: usize) -> Self {
        Self {
            count: 0,
            origin: vec![0.0; quantities],
            mean: vec![0.0; quantities],
            products: vec![0.0; quantities * (quantities + 1) / 2],
            differences: vec![0.0; quantities],
            values: vec![Values::Kept(Vec::new()); quantities],
        }
    }

    /// Adds the results of one trial, as many as there are quantities, each in the unit of its quantity.
    pub fn push(&mut self, results: &[f64]) {
        debug_assert_eq!(results.len(), self.origin.len(), "a trial gives one result per quantity");
        if self.count == 0 {
            self.origin.copy_from_slice(results);
        }
        if self.count == KEPT {
            self.turn_to_bins();
        }
        self.count += 1;
        let count = self.count as f64;
        let each = results.iter().zip(&self.origin).zip(self.mean.iter_mut().zip(&mut self.differences));
        for (((result, origin), (mean, difference)), values) in each.zip(&mut self.values) {
            let shifted = result - origin;
            *difference = shifted - *mean;
            *mean += *difference / count;
            match values {
                Values::Kept(kept) => kept.push(*result),
                Values::Binned(bins) => bins.count(shifted),
            }
        }
        let weight = (count - 1.0) / count;
        let mut products = self.products.iter_mut();
        for (row, difference) in self.differences.iter().enumerate() {
            let weighted = difference * weight;
            for (product, other) in products.by_ref().take(row + 1).zip(&self.differences) {
                *product += weighted * other;
            }
        }
    }

    fn turn_to_bins(&mut self) {
        let deviations = self.standard_uncertainties();
        let each = self.values.iter_mut().zip(deviations).zip(self.mean.iter().zip(&self.origin));
        for ((values, deviation), (mean, origin)) in each {
            if let Values::Kept(kept) = values {
                let mut bins = Bins::new(*mean, deviation);
                kept.iter().for_each(|value| bins.count(value - origin));
                *values = Values::Binned(bins);
            }
        }
    }

    /// Number of quantities.
    pub fn quantities(&self) -> usize {
        self.origin.len()
    }

    /// Number of trials.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Mean of each quantity: its estimate (JCGM 101:2008, 7.6). NaN without trials.
    pub fn mean(&self) -> Vec<f64> {
        if self.count == 0 {
            return vec![f64::NAN; self.quantities()];
        }
        self.origin.iter().zip(&self.mean).map(|(origin, mean)| origin + mean).collect()
    }

    /// Standard deviation of each quantity, its standard uncertainty (JCGM 101:2008, 7.6). NaN with fewer than two
    /// trials.
    pub fn standard_uncertainties(&self) -> Vec<f64> {
        (0..self.quantities()).map(|quantity| self.covariance_of(quantity, quantity).sqrt()).collect()
    }

    /// Covariance matrix of the quantities, row by row, symmetric to the last bit (JCGM 102:2011, 7.6): sums of
    /// products over one less than the number of trials. NaN with fewer than two trials.
    pub fn covariance(&self) -> Vec<Vec<f64>> {
        let row = |row: usize| (0..self.quantities()).map(|column| self.covariance_of(row, column)).collect();
        (0..self.quantities()).map(row).collect()
    }

    fn covariance_of(&self, one: usize, other: usize) -> f64 {
        if self.count < 2 {
            return f64::NAN;
        }
        let (row, column) = (one.max(other), one.min(other));
        self.products[row * (row + 1) / 2 + column] / (self.count - 1) as f64
    }

    /// The interval that leaves out as many values below as above (JCGM 101:2008, 7.7.2).
    ///
    /// With fewer than [`least_trials`] it is not reliable; with very few it covers all values. NaN without trials, for an
    /// index without a quantity, and unless `0 < probability < 1`.
    pub fn symmetric_interval(&self, quantity: usize, probability: f64) -> Interval {
        let Some(ordered) = self.ordered(quantity) else { return Interval::UNKNOWN };
        let Some(covered) = covered(self.count, probability) else { return Interval::UNKNOWN };
        let first = (self.count - covered).div_ceil(2);
        Interval { low: ordered.at(first.max(1)), high: ordered.at((first + covered).min(self.count)) }
    }

    /// The shortest interval that holds as many values as the symmetric one (JCGM 101:2008, 7.7.3 and 5.3.4), the first
    /// of equally short ones.
    ///
    /// Its ends scatter more from run to run than those of the symmetric one, because the length hardly changes about
    /// the shortest. NaN in the cases of [`symmetric_interval`](Self::symmetric_interval).
    pub fn shortest_interval(&self, quantity: usize, probability: f64) -> Interval {
        let Some(ordered) = self.ordered(quantity) else { return Interval::UNKNOWN };
        let Some(covered) = covered(self.count, probability) else { return Interval::UNKNOWN };
        let mut shortest = Interval { low: ordered.at(1), high: ordered.at((1 + covered).min(self.count)) };
        ordered.each_start(self.count - covered, covered, |first| {
            let interval = Interval { low: ordered.at(first), high: ordered.at(first + covered) };
            if interval.length() < shortest.length() {
                shortest = interval;
            }
        });
        shortest
    }

    fn ordered(&self, quantity: usize) -> Option<Ordered<'_>> {
        let origin = *self.origin.get(quantity)?;
        if self.count == 0 || !self.mean[quantity].is_finite() {
            return None;
        }
        Some(match &self.values[quantity] {
            Values::Kept(kept) => {
                let mut sorted = kept.clone();
                sorted.sort_unstable_by(f64::total_cmp);
                Ordered::Kept(sorted)
            }
            Values::Binned(bins) => {
                let mut sum = 0;
                let add = |count: &u32| {
                    sum += *count as usize;
                    sum
                };
                Ordered::Binned { bins, up_to: bins.counts.iter().map(add).collect(), origin }
            }
        })
    }
}

/// How many of `count` values lie between the ends of an interval, one end counted: `q` of JCGM 101:2008, 7.7.2. The
/// whole part of `p M + 1/2` is `p M` itself where that is whole.
fn covered(count: usize, probability: f64) -> Option<usize> {
    let valid = probability > 0.0 && probability < 1.0;
    valid.then(|| ((probability * count as f64 + 0.5).floor() as usize).min(count))
}

/// What is kept of the values of one quantity.
#[derive(Debug, Clone)]
enum Values {
    /// All of them, in order of trials.
    Kept(Vec<f64>),
    /// How many there are in each bin.
    Binned(Bins),
}

/// Counts of the values of one quantity, relative to its origin.
#[derive(Debug, Clone)]
struct Bins {
    /// Lower end of the first bin.
    low: f64,
    /// Width of a bin; 0 for the one bin of a quantity that did not vary.
    width: f64,
    /// Values below the bins, in each bin, and above the bins.
    counts: Vec<u32>,
    least: f64,
    largest: f64,
}

impl Bins {
    fn new(mean: f64, deviation: f64) -> Self {
        let width = deviation / BINS_PER_DEVIATION as f64;
        // One bin only for a deviation of zero or NaN.
        let bins = if width > 0.0 { 2 * REACH * BINS_PER_DEVIATION } else { 1 };
        let low = if width > 0.0 { mean - REACH as f64 * deviation } else { mean };
        let width = if width > 0.0 { width } else { 0.0 };
        Self { low, width, counts: vec![0; bins + 2], least: f64::INFINITY, largest: f64::NEG_INFINITY }
    }

    fn count(&mut self, value: f64) {
        self.least = self.least.min(value);
        self.largest = self.largest.max(value);
        let last = self.counts.len() - 1;
        let cell = if value < self.low {
            0
        } else if self.width > 0.0 {
            // A cast saturates, so that what lies above the bins comes to the last cell.
            (((value - self.low) / self.width) as usize).saturating_add(1).min(last)
        } else {
            1 + usize::from(value > self.low)
        };
        self.counts[cell] = self.counts[cell].saturating_add(1);
    }

    /// Ends of a cell; those on the outside end at the extremes, and so does a bin that an extreme lies in.
    fn ends(&self, cell: usize) -> (f64, f64) {
        let bins = self.counts.len() - 2;
        let low = if cell == 0 { self.least } else { self.low + (cell - 1) as f64 * self.width };
        let high = if cell > bins { self.largest } else { self.low + cell as f64 * self.width };
        (low.max(self.least), high.min(self.largest))
    }
}

/// The values of one quantity in order of size.
enum Ordered<'a> {
    Kept(Vec<f64>),
    /// With the number of values up to and with each cell.
    Binned {
        bins: &'a Bins,
        up_to: Vec<usize>,
        origin: f64,
    },
}

impl Ordered<'_> {
    /// The value of a rank, the least being 1. The values of a bin are taken to be evenly spread on it.
    fn at(&self, rank: usize) -> f64 {
        match self {
            Self::Kept(sorted) => sorted.get(rank.saturating_sub(1)).copied().unwrap_or(f64::NAN),
            Self::Binned { bins, up_to, origin } => {
                let cell = up_to.partition_point(|&sum| sum < rank).min(up_to.len() - 1);
                let (low, high) = bins.ends(cell);
                let before = up_to[cell] - bins.counts[cell] as usize;
                let share = (rank.saturating_sub(before) as f64 - 0.5) / f64::from(bins.counts[cell]);
                origin + (low + share * (high - low))
            }
        }
    }

    /// Calls `visit` with the ranks 1 to `last` at which a shortest interval of `covered` values can start. Between two
    /// ends of bins the length changes evenly with the rank, so that only starts and ends next to ends of bins count.
    fn each_start(&self, last: usize, covered: usize, mut visit: impl FnMut(usize)) {
        match self {
            Self::Kept(_) => (1..=last).for_each(visit),
            Self::Binned { up_to, .. } => {
                for &sum in up_to {
                    let starts = [Some(sum), Some(sum + 1), sum.checked_sub(covered), (sum + 1).checked_sub(covered)];
                    starts.into_iter().flatten().filter(|start| (1..=last).contains(start)).for_each(&mut visit);
                }
            }
        }
    }
}

/// Numerical tolerance of a standard uncertainty with `digits` meaningful decimal digits: half a unit of the last digit (JCGM
/// 101:2008, 7.9.2), in the unit of the uncertainty. 0 digits count as 1.
///
/// 0 for an uncertainty of 0, NaN for one that is not finite.
pub fn numerical_tolerance(standard_uncertainty: f64, digits: u32) -> f64 {
    if standard_uncertainty == 0.0 || !standard_uncertainty.is_finite() {
        return standard_uncertainty * 0.0;
    }
    // Formatting rounds before it finds the exponent: with two digits 9.96 is 10 = 10 x 10^0, not 100 x 10^-1.
    let decimals = digits.clamp(1, 17) - 1;
    let rounded = format!("{:.*e}", decimals as usize, standard_uncertainty.abs());
    let exponent = rounded.split_once('e').and_then(|(_, exponent)| exponent.parse::<i64>().ok());
    let unit = exponent.map(|exponent| exponent - i64::from(decimals));
    unit.and_then(|unit| format!("0.5e{unit}").parse().ok()).unwrap_or(f64::NAN)
}

/// Comparison of the interval of the GUM uncertainty framework with that of a Monte Carlo calculation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Agreement {
    /// Distance of the lower ends, in the unit of the quantity.
    pub low_difference: f64,
    /// Distance of the upper ends, in the unit of the quantity.
    pub high_difference: f64,
    /// Whether neither is larger than the numerical tolerance: the framework is validated in this case.
    pub agrees: bool,
}

/// Compares `estimate - expanded` to `estimate + expanded` with the interval of a Monte Carlo calculation of the same
/// probability (JCGM 101:2008, clause 8); the tolerance is that of [`numerical_tolerance`].
pub fn compare_with_gum(estimate: f64, expanded: f64, interval: Interval, tolerance: f64) -> Agreement {
    let low_difference = (estimate - expanded - interval.low).abs();
    let high_difference = (estimate + expanded - interval.high).abs();
    let agrees = low_difference <= tolerance && high_difference <= tolerance;
    Agreement { low_difference, high_difference, agrees }
}

/// The adaptive procedure (JCGM 101:2008, 7.9.4, for several quantities as in JCGM 102:2011, 7.8): batches of trials
/// until estimates, standard uncertainties and both ends of the symmetric intervals are stable to the wanted digits.
///
/// Stable is a quantity if twice the standard deviation of the average over batches of each of these four is no larger
/// than the numerical tolerance of the standard uncertainty of all its values.
#[derive(Debug, Clone)]
pub struct AdaptiveProcedure {
    /// Meaningful decimal digits of the standard uncertainties, 1 or 2 as a rule.
    digits: u32,
    /// Probability of the intervals.
    probability: f64,
    /// Most trials in all.
    most: usize,
    trials: usize,
    batches: usize,
    progress: Vec<Progress>,
}

/// Statistics of the batches for one quantity.
#[derive(Debug, Clone, Copy, Default)]
struct Progress {
    /// All values.
    values: Spread,
    /// Estimate, standard uncertainty, lower and upper end of the interval of the batches.
    figures: [Spread; 4],
}

impl Progress {
    /// Twice the largest standard deviation of an average over its tolerance; infinite where something is not finite.
    fn ratio(&self, digits: u32) -> f64 {
        let uncertainty = self.values.deviation();
        if uncertainty == 0.0 {
            return 0.0;
        }
        // A quantity whose variation is only rounding cannot be more exact than its rounding.
        let rounding = 4.0 * f64::EPSILON * self.values.mean().abs();
        let tolerance = numerical_tolerance(uncertainty, digits).max(rounding);
        let largest = self.figures.iter().map(Spread::deviation_of_mean).fold(0.0, |largest: f64, deviation| {
            if deviation.is_nan() { f64::INFINITY } else { largest.max(deviation) }
        });
        let ratio = 2.0 * largest / tolerance;
        if ratio.is_nan() { f64::INFINITY } else { ratio }
    }
}

impl AdaptiveProcedure {
    /// Wants standard uncertainties with `digits` meaningful decimal digits (1 or 2 as a rule) and intervals of
    /// `probability`, with no more than `most` trials in all.
    pub fn new(digits: u32, probability: f64, most: usize) -> Self {
        Self { digits, probability, most, trials: 0, batches: 0, progress: Vec::new() }
    }

    /// Number of trials in a batch: 10,000, or [`least_trials`] if these are more; not more than there may be in all.
    pub fn batch(&self) -> usize {
        least_trials(self.probability).max(LEAST_BATCH).min(self.most).max(1)
    }

    /// Adds a batch: the [`batch`](Self::batch) trials that follow those of the batches before, of the same quantities.
    pub fn push_batch(&mut self, batch: &Trials) {
        if self.batches == 0 {
            self.progress = vec![Progress::default(); batch.quantities()];
        }
        debug_assert_eq!(self.progress.len(), batch.quantities(), "all batches are of the same quantities");
        self.batches += 1;
        self.trials += batch.count();
        let results = batch.mean().into_iter().zip(batch.standard_uncertainties());
        for ((quantity, progress), (mean, uncertainty)) in self.progress.iter_mut().enumerate().zip(results) {
            let interval = batch.symmetric_interval(quantity, self.probability);
            progress.values.add(batch.count() as f64, mean, uncertainty);
            let figures = [mean, uncertainty, interval.low, interval.high];
            progress.figures.iter_mut().zip(figures).for_each(|(spread, figure)| spread.add(1.0, figure, 0.0));
        }
    }

    /// Number of trials so far.
    pub fn trials(&self) -> usize {
        self.trials
    }

    /// How stable each quantity is: twice the largest standard deviation of its four averages over its numerical
    /// tolerance, stable up to 1. It falls with the root of the number of trials. Infinite before the second batch.
    pub fn ratios(&self) -> Vec<f64> {
        if self.batches < 2 {
            return vec![f64::INFINITY; self.progress.len()];
        }
        self.progress.iter().map(|progress| progress.ratio(self.digits)).collect()
    }

    /// The quantities that are not stable yet. A quantity that does not vary is stable from the second batch on.
    pub fn unstable(&self) -> Vec<usize> {
        let ratios = self.ratios().into_iter().enumerate();
        ratios.filter(|(_, ratio)| *ratio > 1.0).map(|(quantity, _)| quantity).collect()
    }

    /// Whether there are two batches or more and every quantity is stable.
    pub fn stable(&self) -> bool {
        self.batches >= 2 && self.unstable().is_empty()
    }

    /// Whether no further batch is needed, or none may follow: ask [`stable`](Self::stable) which of both.
    pub fn finished(&self) -> bool {
        self.stable() || self.trials.saturating_add(self.batch()) > self.most.max(1)
    }
}

/// Mean and sum of squares of what comes one after another, relative to the first.
#[derive(Debug, Clone, Copy, Default)]
struct Spread {
    count: f64,
    origin: f64,
    mean: f64,
    squares: f64,
}

impl Spread {
    /// Adds `count` values of which mean and standard deviation are known (Chan, Golub & LeVeque 1979).
    fn add(&mut self, count: f64, mean: f64, deviation: f64) {
        if self.count == 0.0 {
            self.origin = mean;
        }
        let difference = mean - self.origin - self.mean;
        let total = self.count + count;
        self.squares += (count - 1.0) * deviation * deviation + difference * difference * self.count * count / total;
        self.mean += difference * count / total;
        self.count = total;
    }

    fn mean(&self) -> f64 {
        self.origin + self.mean
    }

    fn deviation(&self) -> f64 {
        (self.squares / (self.count - 1.0)).sqrt()
    }

    fn deviation_of_mean(&self) -> f64 {
        self.deviation() / self.count.sqrt()
    }
}

#[cfg(test)]
mod tests;
