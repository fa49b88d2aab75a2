//! How long the other process may take.

use std::sync::Mutex;
use std::time::{Duration, Instant};

use super::locked;

/// Limits of time, and what was spent.
pub(super) struct Time {
    /// For one answer or question; none: as long as it takes.
    answer: Option<Duration>,
    /// For all answers together, and what is left of it.
    total: Duration,
    left: Mutex<Duration>,
}

impl Time {
    pub fn limited(answer: Duration, total: Duration) -> Self {
        Self { answer: Some(answer), total, left: Mutex::new(total) }
    }

    pub fn unlimited() -> Self {
        Self { answer: None, ..Self::limited(Duration::MAX, Duration::MAX) }
    }

    /// When the next message has to be there, in a conversation that was started then.
    pub fn until(&self, started: Instant) -> Option<Instant> {
        let answer = Instant::now().checked_add(self.answer?)?;
        let total = started.checked_add(*locked(&self.left));
        Some(total.map_or(answer, |total| total.min(answer)))
    }

    /// A conversation has taken this long.
    pub fn spend(&self, time: Duration) {
        let mut left = locked(&self.left);
        *left = left.saturating_sub(time);
    }

    /// Which limit was not kept.
    pub fn limit(&self) -> String {
        match locked(&self.left).is_zero() {
            true => format!("took more than {} s altogether", self.total.as_secs_f64()),
            false => format!("gave no answer within {} s", self.answer.unwrap_or_default().as_secs_f64()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shorter_limit_holds_and_is_told() {
        let second = Duration::from_secs(1);
        let time = Time::limited(second * 100, second * 10);
        let started = Instant::now();
        assert_eq!(time.until(started), Some(started + second * 10));
        time.spend(second * 4);
        assert_eq!(time.until(started), Some(started + second * 6));
        assert_eq!(time.limit(), "gave no answer within 100 s");
        time.spend(second * 60);
        assert_eq!(time.until(started), Some(started));
        assert_eq!(time.limit(), "took more than 10 s altogether");
        assert_eq!(Time::unlimited().until(started), None);
    }
}
