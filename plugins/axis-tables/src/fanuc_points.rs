//! The points of one axis in stored pitch error compensation of Fanuc.

/// Numbers and values of the points of an axis. The value of a point is the step between the ends of its section, read from the
/// negative side.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Points {
    /// Number of the reference point (3620).
    pub reference: i64,
    /// Number of the point furthest in negative direction, for travel in positive direction (3621).
    pub first: i64,
    /// The same for travel in negative direction (3626); 0 if there is one curve for both.
    pub first_negative: i64,
    /// Value at the reference point where it is approached against the direction of the reference return (3627).
    pub at_reference: i64,
    /// The points repeat with every turn.
    pub is_turn: bool,
    forward: Vec<i64>,
    reverse: Vec<i64>,
    end: u16,
}

impl Points {
    /// From the counts at the ends of sections, positive and negative travel, the index of the reference point among them, and the first
    /// number that is free.
    pub fn new(reference: usize, counts: &[Vec<i64>; 2], is_turn: bool, returns_negative: bool, next: u16) -> Self {
        let steps = |values: &[i64]| {
            let steps: Vec<i64> = values.windows(2).map(|pair| pair[1] - pair[0]).collect();
            // The first point of a turn is its last one.
            let before = steps.last().copied().filter(|_| is_turn);
            before.into_iter().chain(steps).collect::<Vec<i64>>()
        };
        let [forward, reverse] = counts;
        let has_directions = forward != reverse;
        let against = if returns_negative { forward } else { reverse };
        let at_reference = against.get(reference).copied().filter(|_| has_directions).unwrap_or_default();
        let (forward, reverse) = (steps(forward), if has_directions { steps(reverse) } else { Vec::new() });
        // Sections are numbered by their positive ends: that of the reference point ends there.
        let first = i64::from(next) + i64::from(reference == 0 && !is_turn);
        let first_negative = if has_directions { first + forward.len() as i64 } else { 0 };
        let used = first + (forward.len() + reverse.len()) as i64;
        Self {
            reference: first + reference as i64 - i64::from(!is_turn),
            first,
            first_negative,
            at_reference,
            is_turn,
            forward,
            reverse,
            end: u16::try_from(used).unwrap_or(u16::MAX),
        }
    }

    /// The first number after these points.
    pub fn end(&self) -> u16 {
        self.end
    }

    /// Number of the point furthest in positive direction (3622).
    pub fn last(&self) -> i64 {
        self.first + self.forward.len() as i64 - 1
    }

    /// Whether travel in both directions has its own points.
    pub fn has_directions(&self) -> bool {
        !self.reverse.is_empty()
    }

    /// Numbers and values.
    pub fn values(&self) -> impl Iterator<Item = (i64, i64)> {
        (self.first..).zip(self.forward.iter().chain(&self.reverse).copied())
    }

    /// The largest value, without its sign.
    pub fn largest(&self) -> i64 {
        self.values().map(|(_, value)| value.abs()).max().unwrap_or_default()
    }

    /// Whether nothing is corrected.
    pub fn is_zero(&self) -> bool {
        self.largest() == 0 && self.at_reference == 0
    }

    /// A line for people.
    pub fn note(&self) -> String {
        format!("points {} to {}, reference point {}", self.first, self.end.saturating_sub(1), self.reference)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Series 0i-PB, B-63980EN, p. 100: points around the reference point 40 from -400 mm, every 50 mm.
    #[test]
    fn numbers_are_those_of_the_manual() {
        let curve = vec![2, 4, 5, 6, 4, 4, 3, 3, 2, 4, 5, 5, 4, 3, 1, 1, 2];
        let points = Points::new(8, &[curve.clone(), curve], false, false, 33);
        assert_eq!((points.reference, points.first, points.last(), points.end()), (40, 33, 48, 49));
        let values: Vec<i64> = points.values().map(|(_, value)| value).collect();
        assert_eq!(values, [2, 1, 1, -2, 0, -1, 0, -1, 2, 1, 0, -1, -1, -2, 0, 1]);
        // A turn in steps of 45 degrees, from point 60.
        let curve = vec![0, 1, 2, 1, 0, -1, -1, 1, 0];
        let points = Points::new(0, &[curve.clone(), curve], true, false, 60);
        assert_eq!((points.reference, points.first, points.last()), (60, 60, 68));
        let values: Vec<i64> = points.values().map(|(_, value)| value).collect();
        assert_eq!(values[0], values[8]);
        assert_eq!(values[1..].iter().sum::<i64>(), 0);
    }

    #[test]
    fn each_direction_has_its_points() {
        let points = Points::new(0, &[vec![0, 1, 3], vec![5, 5, 4]], false, false, 0);
        assert_eq!((points.reference, points.first, points.last(), points.first_negative), (0, 1, 2, 3));
        assert_eq!(points.at_reference, 5);
        assert_eq!(points.values().collect::<Vec<_>>(), [(1, 1), (2, 2), (3, 0), (4, -1)]);
        assert_eq!(Points::new(0, &[vec![-5, 1], vec![0, 1]], false, true, 0).at_reference, -5);
    }
}
