//! Positioning of a linear or rotary axis after ISO 230-2:2014, and in the manner of VDI/DGQ 3441.
//!
//! The texts were not at hand: the figures of ISO 230-2 are those in general use, and real published reports agree with B, M and A.
//! Those of VDI/DGQ 3441 are a choice of this project (\[M\] in the documentation), as are parts of the uncertainty.
//!
//! Positions and readings are in any units, which are those of all figures. A reading is the deviation actual minus nominal. What the
//! readings do not allow is `None`: R and A of single runs, all that needs both directions where one was measured, and every figure
//! over all targets if a target lacks what it needs.

pub mod plan;
pub mod uncertainty;

/// The readings at one target.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Target {
    /// The nominal position.
    pub position: f64,
    /// Readings after a positive approach, one a run.
    pub up: Vec<f64>,
    /// Readings after a negative approach, one a run.
    pub down: Vec<f64>,
}

/// What the readings of one target tell (ISO 230-2:2014, clause 3; terms and definitions).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct AtTarget {
    /// Nominal position.
    pub position: f64,
    /// Mean of the positive approaches, x̄ᵢ↑.
    pub mean_up: Option<f64>,
    /// Mean of the negative approaches, x̄ᵢ↓.
    pub mean_down: Option<f64>,
    /// Mean bidirectional deviation, x̄ᵢ = (x̄ᵢ↑ + x̄ᵢ↓) / 2.
    pub mean: Option<f64>,
    /// Reversal error Bᵢ = x̄ᵢ↑ - x̄ᵢ↓, with its sign.
    pub reversal: Option<f64>,
    /// Standard deviation of the positive approaches, with n - 1.
    pub s_up: Option<f64>,
    /// Standard deviation of the negative approaches, with n - 1.
    pub s_down: Option<f64>,
    /// Unidirectional repeatability Rᵢ↑ = 4 sᵢ↑.
    pub repeatability_up: Option<f64>,
    /// Unidirectional repeatability Rᵢ↓ = 4 sᵢ↓.
    pub repeatability_down: Option<f64>,
    /// Bidirectional repeatability Rᵢ = max(2 sᵢ↑ + 2 sᵢ↓ + |Bᵢ|, Rᵢ↑, Rᵢ↓).
    pub repeatability: Option<f64>,
}

/// Mean; none for no reading or one that is no finite number.
fn mean(readings: &[f64]) -> Option<f64> {
    let finite = !readings.is_empty() && readings.iter().all(|reading| reading.is_finite());
    finite.then(|| readings.iter().sum::<f64>() / readings.len() as f64)
}

/// Standard deviation with n - 1; none for fewer than two readings.
fn deviation(readings: &[f64]) -> Option<f64> {
    let mean = mean(readings)?;
    let squares: f64 = readings.iter().map(|reading| (reading - mean).powi(2)).sum();
    (readings.len() > 1).then(|| (squares / (readings.len() as f64 - 1.0)).sqrt())
}

impl AtTarget {
    /// Evaluates a target.
    ///
    /// ```
    /// use abbe_standards::positioning::{AtTarget, Target};
    ///
    /// let found = AtTarget::of(&Target { position: 100.0, up: vec![2.0, 4.0], down: vec![0.0, 0.0] });
    /// assert_eq!((found.reversal, found.repeatability_down), (Some(3.0), Some(0.0)));
    /// // 2 s of either direction and the reversal are 5.83; 4 s of one direction are 5.66.
    /// assert_eq!(found.repeatability, Some(2.0 * 2.0_f64.sqrt() + 3.0));
    /// ```
    pub fn of(target: &Target) -> Self {
        let (mean_up, mean_down) = (mean(&target.up), mean(&target.down));
        let (s_up, s_down) = (deviation(&target.up), deviation(&target.down));
        let reversal = mean_up.zip(mean_down).map(|(up, down)| up - down);
        let repeatability = match (s_up, s_down, reversal) {
            (Some(up), Some(down), Some(reversal)) => {
                Some((2.0 * up + 2.0 * down + reversal.abs()).max(4.0 * up).max(4.0 * down))
            }
            _ => None,
        };
        Self {
            position: target.position,
            mean_up,
            mean_down,
            mean: mean_up.zip(mean_down).map(|(up, down)| 0.5 * (up + down)),
            reversal,
            s_up,
            s_down,
            repeatability_up: s_up.map(|s| 4.0 * s),
            repeatability_down: s_down.map(|s| 4.0 * s),
            repeatability,
        }
    }

    /// Mean and twice the standard deviation of one direction.
    fn band(mean: Option<f64>, s: Option<f64>) -> Option<[f64; 2]> {
        mean.zip(s).map(|(mean, s)| [mean - 2.0 * s, mean + 2.0 * s])
    }

    fn band_up(&self) -> Option<[f64; 2]> {
        Self::band(self.mean_up, self.s_up)
    }

    fn band_down(&self) -> Option<[f64; 2]> {
        Self::band(self.mean_down, self.s_down)
    }
}

/// The figures of an axis, ISO 230-2:2014.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Positioning {
    /// By target, in the order of their positions.
    pub targets: Vec<AtTarget>,
    /// Reversal error of the axis, B = max |Bᵢ|.
    pub reversal: Option<f64>,
    /// Mean reversal error of the axis: mean of Bᵢ with its sign.
    pub mean_reversal: Option<f64>,
    /// Unidirectional systematic deviation, E↑ = range of x̄ᵢ↑.
    pub systematic_up: Option<f64>,
    /// Unidirectional systematic deviation, E↓ = range of x̄ᵢ↓.
    pub systematic_down: Option<f64>,
    /// Bidirectional systematic deviation, E = range of all x̄ᵢ↑ and x̄ᵢ↓ together.
    pub systematic: Option<f64>,
    /// Mean bidirectional deviation, M = range of x̄ᵢ.
    pub mean_deviation: Option<f64>,
    /// Unidirectional repeatability, R↑ = max Rᵢ↑.
    pub repeatability_up: Option<f64>,
    /// Unidirectional repeatability, R↓ = max Rᵢ↓.
    pub repeatability_down: Option<f64>,
    /// Bidirectional repeatability, R = max Rᵢ.
    pub repeatability: Option<f64>,
    /// Unidirectional accuracy, A↑ = max(x̄ᵢ↑ + 2 sᵢ↑) - min(x̄ᵢ↑ - 2 sᵢ↑).
    pub accuracy_up: Option<f64>,
    /// Unidirectional accuracy, A↓.
    pub accuracy_down: Option<f64>,
    /// Bidirectional accuracy, A: as A↑, over both directions together.
    pub accuracy: Option<f64>,
}

/// Smallest and largest of what all targets have; none if one lacks it, or if there are no targets.
fn ends(values: impl IntoIterator<Item = Option<f64>>) -> Option<[f64; 2]> {
    let mut ends: Option<[f64; 2]> = None;
    for value in values {
        let value = value.filter(|value| value.is_finite())?;
        let [low, high] = ends.unwrap_or([value; 2]);
        ends = Some([low.min(value), high.max(value)]);
    }
    ends
}

fn range(values: impl IntoIterator<Item = Option<f64>>) -> Option<f64> {
    ends(values).map(|[low, high]| high - low)
}

fn largest(values: impl IntoIterator<Item = Option<f64>>) -> Option<f64> {
    ends(values).map(|[_, high]| high)
}

/// Lower and upper ends of bands, as a list of both.
fn edges(bands: impl IntoIterator<Item = Option<[f64; 2]>>) -> Vec<Option<f64>> {
    bands.into_iter().flat_map(|band| [band.map(|[low, _]| low), band.map(|[_, high]| high)]).collect()
}

impl Positioning {
    /// Evaluates an axis. Targets may stand in any order; a range over fewer than two of them is none.
    pub fn of(targets: &[Target]) -> Self {
        let mut targets: Vec<AtTarget> = targets.iter().map(AtTarget::of).collect();
        targets.sort_by(|one, other| one.position.total_cmp(&other.position));
        let all = targets.as_slice();
        if all.len() < 2 || all.iter().any(|target| !target.position.is_finite()) {
            return Self { targets, ..Self::default() };
        }
        let of = |value: fn(&AtTarget) -> Option<f64>| all.iter().map(value);
        let bands = |band: fn(&AtTarget) -> Option<[f64; 2]>| all.iter().map(band);
        let reversals: Option<Vec<f64>> = of(|target| target.reversal).collect();
        Self {
            reversal: largest(of(|target| target.reversal.map(f64::abs))),
            mean_reversal: reversals.and_then(|all| mean(&all)),
            systematic_up: range(of(|target| target.mean_up)),
            systematic_down: range(of(|target| target.mean_down)),
            systematic: range(of(|target| target.mean_up).chain(of(|target| target.mean_down))),
            mean_deviation: range(of(|target| target.mean)),
            repeatability_up: largest(of(|target| target.repeatability_up)),
            repeatability_down: largest(of(|target| target.repeatability_down)),
            repeatability: largest(of(|target| target.repeatability)),
            accuracy_up: range(edges(bands(AtTarget::band_up))),
            accuracy_down: range(edges(bands(AtTarget::band_down))),
            accuracy: range(edges(bands(AtTarget::band_up).chain(bands(AtTarget::band_down)))),
            targets,
        }
    }

    /// Slope of the straight line by least squares through the mean bidirectional deviations, reading per position; through those
    /// of one direction where only that was measured.
    pub fn slope(&self) -> Option<f64> {
        let deviation = |target: &AtTarget| target.mean.or(target.mean_up).or(target.mean_down);
        let both = self.targets.iter().all(|target| target.mean.is_some());
        let same = |value: fn(&AtTarget) -> Option<f64>| self.targets.iter().all(|target| value(target).is_some());
        if !(both || same(|target| target.mean_up) || same(|target| target.mean_down)) {
            return None;
        }
        let deviations: Vec<f64> = self.targets.iter().map(deviation).collect::<Option<_>>()?;
        let count = deviations.len() as f64;
        let position = self.targets.iter().map(|target| target.position).sum::<f64>() / count;
        let mean = mean(&deviations)?;
        let pairs = self.targets.iter().zip(&deviations);
        let (mut product, mut square) = (0.0, 0.0);
        for (target, deviation) in pairs {
            product += (target.position - position) * (deviation - mean);
            square += (target.position - position).powi(2);
        }
        (square > 0.0).then(|| product / square)
    }

    /// Figures in the manner of VDI/DGQ 3441; none unless every target has two readings in either direction.
    pub fn vdi(&self) -> Option<Vdi> {
        let spread = |target: &AtTarget| Some(3.0 * (target.s_up? + target.s_down?));
        let reversals: Vec<f64> =
            self.targets.iter().map(|target| target.reversal.map(f64::abs)).collect::<Option<_>>()?;
        let spreads: Vec<f64> = self.targets.iter().map(spread).collect::<Option<_>>()?;
        let half = |place: usize| 0.5 * (reversals[place] + spreads[place]);
        let edge = |sign: f64| {
            let value = move |(place, target): (usize, &AtTarget)| Some(target.mean? + sign * half(place));
            self.targets.iter().enumerate().map(value).collect::<Vec<_>>()
        };
        Some(Vdi {
            deviation: self.mean_deviation?,
            largest_reversal: self.reversal?,
            mean_reversal: mean(&reversals)?,
            largest_spread: largest(spreads.iter().copied().map(Some))?,
            mean_spread: mean(&spreads)?,
            uncertainty: ends(edge(1.0))?[1] - ends(edge(-1.0))?[0],
        })
    }
}

/// Figures in the manner of VDI/DGQ 3441. The text was not at hand: what they are is a choice.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Vdi {
    /// Position deviation Pa: range of the mean bidirectional deviations.
    pub deviation: f64,
    /// Largest reversal U = max |Bᵢ|.
    pub largest_reversal: f64,
    /// Mean of |Bᵢ|.
    pub mean_reversal: f64,
    /// Largest scatter Ps = max 6 (sᵢ↑ + sᵢ↓) / 2.
    pub largest_spread: f64,
    /// Mean scatter.
    pub mean_spread: f64,
    /// Position uncertainty P = max(x̄ᵢ + (Uᵢ + Psᵢ)/2) - min(x̄ᵢ - (Uᵢ + Psᵢ)/2).
    pub uncertainty: f64,
}

#[cfg(test)]
mod published;
#[cfg(test)]
mod tests;
