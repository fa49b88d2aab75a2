//! The speed of a run against the speeds that were set: it tells a time in another unit.

use abbe_core::{Result, SettingsError, positive};

use crate::run::Run;

/// Speeds that a run may have.
#[derive(Debug, Clone, Copy)]
pub struct Speeds<'a> {
    /// Slowest and fastest one, revolutions per minute.
    pub plausible: [f64; 2],
    /// Those that were set, revolutions per minute; empty if they are not stated.
    pub stated: &'a [f64],
}

/// Part of a stated speed that a run may be off.
const NEAR: f64 = 0.05;

/// Other units of time, and how many seconds they have.
const UNITS: [(&str, f64); 4] = [("min", 60.0), ("ms", 1e-3), ("us", 1e-6), ("h", 3600.0)];

/// 10 to 30,000 revolutions per minute: spindles of machine tools.
pub fn plausible_rpm() -> [f64; 2] {
    [10.0, 30_000.0]
}

/// Fails for speeds that are none.
pub fn check_speeds(plausible_rpm: [f64; 2], speeds_rpm: &[f64]) -> Result<(), SettingsError> {
    let [slowest, fastest] = plausible_rpm;
    if !(slowest > 0.0 && fastest > slowest && fastest.is_finite()) {
        let message = "two numbers above zero, the larger one last, were expected";
        return Err(SettingsError::new("plausible_rpm", message));
    }
    speeds_rpm.iter().try_for_each(|speed| positive("speeds_rpm", *speed).map(drop))
}

impl Speeds<'_> {
    /// The stated speed next to this one, if it is near.
    pub fn nearest(&self, speed: f64) -> Option<f64> {
        let off = |stated: &f64| (speed / stated - 1.0).abs();
        let nearest = self.stated.iter().copied().min_by(|one, other| off(one).total_cmp(&off(other)));
        nearest.filter(|nearest| off(nearest) <= NEAR)
    }

    fn has(&self, speed: f64) -> bool {
        match self.stated.is_empty() {
            true => (self.plausible[0]..=self.plausible[1]).contains(&speed),
            false => self.nearest(speed).is_some(),
        }
    }

    /// Fails for a run with another speed, and says in which unit its time would fit.
    pub fn check(&self, run: &Run) -> Result<()> {
        if self.has(run.speed) {
            return Ok(());
        }
        let message = match self.stated.is_empty() {
            true => format!(
                "it has {:.4} rpm, and {} to {} rpm were expected (`plausible_rpm`)",
                run.speed, self.plausible[0], self.plausible[1]
            ),
            false => {
                let stated: Vec<String> = self.stated.iter().map(f64::to_string).collect();
                format!("it has {:.4} rpm; the speeds that were set are {} rpm", run.speed, stated.join(", "))
            }
        };
        let other = UNITS.iter().find(|(_, seconds)| self.has(run.speed / seconds));
        Err(run.error(message).help(match other {
            Some((unit, seconds)) => format!(
                "with a time in {unit} it would have {:.1} rpm: is the time in the unit that its column says?",
                run.speed / seconds
            ),
            None => "are angle and time in the units that their columns say? else state the speed".to_owned(),
        }))
    }
}
