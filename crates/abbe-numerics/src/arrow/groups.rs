//! Which unknowns can be eliminated, and with which others.

use std::collections::BTreeSet;

/// Unknowns that an unknown may meet in rows and still be eliminated with them.
const PARTNERS: usize = 48;

/// Unknowns of a group at most.
const LARGEST: usize = 64;

/// Unknowns in groups that no row has two of, and the unknowns that all rows share.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Groups {
    members: Vec<Vec<usize>>,
    shared: Vec<usize>,
    places: Vec<Place>,
}

/// Where an unknown stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Place {
    /// Its place among the shared ones.
    Shared(usize),
    /// Its group.
    Own(usize),
}

impl Groups {
    fn new(unknowns: usize, members: Vec<Vec<usize>>) -> Self {
        let mut places = vec![Place::Shared(0); unknowns];
        for (group, members) in members.iter().enumerate() {
            members.iter().for_each(|&member| places[member] = Place::Own(group));
        }
        let shared: Vec<usize> = (0..unknowns).filter(|&unknown| matches!(places[unknown], Place::Shared(_))).collect();
        shared.iter().enumerate().for_each(|(place, &unknown)| places[unknown] = Place::Shared(place));
        Self { members, shared, places }
    }

    /// The same with more shared unknowns after all others.
    #[must_use]
    pub fn with_shared(&self, more: usize) -> Self {
        Self::new(self.unknowns() + more, self.members.clone())
    }

    /// Number of all unknowns.
    pub fn unknowns(&self) -> usize {
        self.places.len()
    }

    /// The unknowns of every group, ascending.
    pub fn members(&self) -> &[Vec<usize>] {
        &self.members
    }

    /// The unknowns that are in no group, ascending.
    pub fn shared(&self) -> &[usize] {
        &self.shared
    }

    /// Number of unknowns in groups.
    pub fn eliminated(&self) -> usize {
        self.unknowns() - self.shared.len()
    }

    pub(super) fn place(&self, unknown: usize) -> Place {
        self.places[unknown]
    }
}

/// Finds the groups of unknowns from the rows that they occur in.
///
/// ```
/// use abbe_numerics::GroupSearch;
///
/// // Unknown 0 is shared; 1 and 2 occur in one row, 3 alone.
/// let mut search = GroupSearch::new(vec![false, true, true, true]);
/// search.row(&[0, 1, 2], &[1.0, 0.5, 2.0]);
/// search.row(&[0, 1, 3], &[1.0, 0.0, 2.0]);
/// let groups = search.groups();
/// assert_eq!(groups.members(), [vec![1, 2], vec![3]]);
/// assert_eq!(groups.shared(), [0]);
/// ```
#[derive(Debug, Clone)]
pub struct GroupSearch {
    /// Which unknowns may be eliminated.
    own: Vec<bool>,
    /// The others that each occurs in a row with, some more than are allowed at most.
    met: Vec<BTreeSet<usize>>,
}

impl GroupSearch {
    /// Of all unknowns those that may be eliminated.
    pub fn new(own: Vec<bool>) -> Self {
        let met = vec![BTreeSet::new(); own.len()];
        Self { own, met }
    }

    /// Takes note of a row: unknowns, and its derivatives to them.
    pub fn row(&mut self, unknowns: &[usize], derivatives: &[f64]) {
        let entries = unknowns.iter().zip(derivatives);
        let own: Vec<usize> =
            entries.filter(|(unknown, entry)| self.own[**unknown] && **entry != 0.0).map(|(own, _)| *own).collect();
        for one in &own {
            let met = &mut self.met[*one];
            for other in own.iter().filter(|other| *other != one) {
                if met.len() > PARTNERS {
                    break;
                }
                met.insert(*other);
            }
        }
    }

    /// Adds what was seen of other rows of the same unknowns.
    pub fn join(&mut self, other: Self) {
        for (met, own) in self.met.iter_mut().zip(other.met) {
            for unknown in own {
                if met.len() > PARTNERS {
                    break;
                }
                met.insert(unknown);
            }
        }
    }

    /// The groups of the rows so far. An unknown that meets too many others is shared, as one of a whole artefact is, and so are those
    /// of a group that is too large.
    pub fn groups(&self) -> Groups {
        let is_own = |unknown: usize| self.own[unknown] && self.met[unknown].len() <= PARTNERS;
        let mut seen = vec![false; self.own.len()];
        let mut members = Vec::new();
        for first in (0..self.own.len()).filter(|&unknown| is_own(unknown)) {
            if seen[first] {
                continue;
            }
            seen[first] = true;
            let (mut group, mut next) = (vec![first], 0);
            while let Some(&unknown) = group.get(next) {
                next += 1;
                for &other in self.met[unknown].iter().filter(|&&other| is_own(other)) {
                    if !seen[other] {
                        seen[other] = true;
                        group.push(other);
                    }
                }
            }
            if group.len() <= LARGEST {
                group.sort_unstable();
                members.push(group);
            }
        }
        Groups::new(self.own.len(), members)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_meets_many_is_shared() {
        // Unknown 0 occurs with all others, which occur two by two.
        let count = 2 * PARTNERS + 1;
        let mut search = GroupSearch::new(vec![true; count]);
        (1..count).step_by(2).for_each(|one| search.row(&[0, one, one + 1], &[1.0, 2.0, 3.0]));
        let groups = search.groups();
        assert_eq!(groups.shared(), [0]);
        assert_eq!((groups.members().len(), groups.eliminated()), (PARTNERS, count - 1));
        assert_eq!(groups.members()[1], [3, 4]);
    }

    #[test]
    fn a_long_chain_is_shared_and_an_unseen_unknown_is_alone() {
        let mut search = GroupSearch::new(vec![true; LARGEST + 2]);
        (0..LARGEST).for_each(|one| search.row(&[one, one + 1], &[1.0, f64::NAN]));
        let groups = search.groups();
        assert_eq!(groups.members(), [vec![LARGEST + 1]]);
        assert_eq!(groups.shared().len(), LARGEST + 1);
    }
}
