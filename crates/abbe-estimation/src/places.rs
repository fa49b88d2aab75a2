//! Features whose touches lie at the nominal place of another one, and touches that are far from that of their own: offsets of facets take
//! up the difference, and nothing else tells.

use std::collections::BTreeMap;

use abbe_core::{Contact, ObservationSet, Poses, Problem, RowIndex, SetIndex};
use nalgebra::Vector3;

/// A touch is at the place of another feature if it is nearer to it than this part of the distance between the two, and further from its
/// own than that part.
const NEAR: f64 = 0.25;
const FAR: f64 = 0.75;

/// Part of the features that may be exchanged: where more are, the artefact stands elsewhere.
const FEW: f64 = 0.25;

/// Fewest features that tell: two alone may be turned round together.
const FEWEST: usize = 3;

/// Fewest touches of a feature that are all at the place of another one, which was not touched at its own: of fewer it may be chance.
const ALL: usize = 3;

/// A touch is far from its feature beyond so many times what nine in ten are within, and beyond so many mm.
const OF_OTHERS: f64 = 10.0;
const AWAY: f64 = 100.0;

/// Sentences on features that were touched where another one should be, and on touches that are far from the place of their feature.
pub(crate) fn wrong_places(problem: &Problem) -> Vec<String> {
    let sets = SetIndex::enumerate(&problem.sets).filter(|(_, set)| set.info().contact == Contact::LinearAxes);
    sets.flat_map(|(index, set)| of_set(problem, index, set).unwrap_or_default()).collect()
}

fn of_set(problem: &Problem, index: SetIndex, set: &ObservationSet) -> Option<Vec<String>> {
    let (info, layout) = (set.info(), &set.info().layout);
    let labels = layout.data.labels("feature")?;
    let places: Vec<Vector3<f64>> = info.features.iter().map(|feature| Vector3::from(feature.point)).collect();
    let of_label: BTreeMap<&str, usize> =
        info.features.iter().enumerate().map(|(index, feature)| (feature.label.as_str(), index)).collect();
    let touch = |(row, tip): (RowIndex, Vector3<f64>)| {
        let feature = of_label.get(labels[layout.rows[row].data_row?].as_str())?;
        Some((row, (*feature, tip)))
    };
    let (rows, touches): (Vec<RowIndex>, Vec<Touch>) = tips(problem, set)?.into_iter().filter_map(touch).unzip();
    let label = |feature: usize| &info.features[feature].label;
    let apart = |one: usize, other: usize| (places[one] - places[other]).norm();
    let mut sentences = Vec::new();
    for Elsewhere { feature, at, is_exchanged } in elsewhere(&places, &touches) {
        let (one, other, apart) = (label(feature), label(at), apart(feature, at));
        let first = format!(
            "{}: feature {one} was touched at the nominal place of {other}, {apart:.1} mm from its own",
            set.name
        );
        sentences.push(match is_exchanged {
            true => format!(
                "{first}, and {other} at that of {one}: are the two labels exchanged? What is found of each then belongs to the other one"
            ),
            false => format!("{first}: are these its touches, and is the nominal place right? What is found of it then belongs to the other one"),
        });
    }
    let (far, usual) = far(&places, &touches);
    if let Some(first) = far.first()
        && let Some((file, origin)) = problem.origin(index, rows[*first])
    {
        let (feature, tip) = touches[*first];
        let count = if far.len() == 1 { "a touch lies".to_owned() } else { format!("{} touches lie", far.len()) };
        sentences.push(format!(
            "{}: {count} far from the nominal place of the feature, the first in {}, {:.0} mm from that of {}, and nine in ten are within \
             {usual:.1} mm: is a position wrong? A plane facet fits as well wherever it is touched, and the range of the machine is that of \
             its rows",
            set.name,
            origin.in_file(file),
            (tip - places[feature]).norm(),
            label(feature)
        ));
    }
    Some(sentences)
}

/// The places in the list of touches that are far from the nominal place of their feature, and what nine in ten are within, mm.
fn far(places: &[Vector3<f64>], touches: &[Touch]) -> (Vec<usize>, f64) {
    let distances: Vec<f64> = touches.iter().map(|(feature, tip)| (tip - places[*feature]).norm()).collect();
    let mut sorted = distances.clone();
    sorted.sort_by(f64::total_cmp);
    let Some(last) = sorted.len().checked_sub(2) else { return (Vec::new(), 0.0) };
    let usual = sorted[(sorted.len() * 9 / 10).min(last)];
    let is_far = |touch: &usize| distances[*touch] > AWAY.max(OF_OTHERS * usual);
    ((0..touches.len()).filter(is_far).collect(), usual)
}

/// A feature that was touched where another one should be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Elsewhere {
    feature: usize,
    at: usize,
    /// Whether the other one was touched at the place of this one; such a pair is there once.
    is_exchanged: bool,
}

/// A feature and the tip at a touch of it.
type Touch = (usize, Vector3<f64>);

/// Pairs of features with most of their touches at the place of the other one, and features with all of theirs at the place of one that
/// is where it should be; none if the others are not where they should be either.
fn elsewhere(places: &[Vector3<f64>], touches: &[Touch]) -> Vec<Elsewhere> {
    // Touches of each feature, and those of them at the place of another one.
    let mut counts: BTreeMap<usize, (usize, BTreeMap<usize, usize>)> = BTreeMap::new();
    for (feature, tip) in touches {
        let own = (tip - places[*feature]).norm();
        let is_at = |(index, place): &(usize, &Vector3<f64>)| {
            let apart = (*place - places[*feature]).norm();
            index != feature && (tip - *place).norm() < NEAR * apart && own > FAR * apart
        };
        let (all, elsewhere) = counts.entry(*feature).or_default();
        *all += 1;
        // Several may be near: features stand in groups.
        let distance = |(_, place): &(usize, &Vector3<f64>)| (tip - *place).norm();
        let there = places.iter().enumerate().filter(is_at);
        if let Some((other, _)) = there.min_by(|one, other| distance(one).total_cmp(&distance(other))) {
            *elsewhere.entry(other).or_default() += 1;
        }
    }
    let is_at = |one: usize, other: usize| {
        let count = counts.get(&one).map(|(all, elsewhere)| (all, elsewhere.get(&other)));
        count.is_some_and(|(all, elsewhere)| elsewhere.is_some_and(|elsewhere| 2 * elsewhere > *all))
    };
    let all =
        counts.iter().flat_map(|(feature, (all, elsewhere))| elsewhere.iter().map(move |at| (*feature, *all, at)));
    let found = all.filter_map(|(feature, all, (&at, &elsewhere))| {
        let is_exchanged = is_at(feature, at) && is_at(at, feature);
        let is_told = if is_exchanged { feature < at } else { all >= ALL && elsewhere == all };
        is_told.then_some(Elsewhere { feature, at, is_exchanged })
    });
    let found: Vec<Elsewhere> = found.collect();
    let is_told = counts.len() >= FEWEST && found.len() as f64 <= (FEW * counts.len() as f64).max(1.0);
    if is_told { found } else { Vec::new() }
}

/// The tips of all rows with one pose, table frame, mm, at the start of the estimate.
fn tips(problem: &Problem, set: &ObservationSet) -> Option<Vec<(RowIndex, Vector3<f64>)>> {
    let layout = &set.info().layout;
    let rows: Vec<RowIndex> = set.rows.iter().copied().filter(|row| layout.rows[*row].poses == 1).collect();
    let statuses: Vec<f64> =
        rows.iter().flat_map(|row| set.poses().row(layout.rows[*row].first_pose)).copied().collect();
    let mut poses = Poses::default();
    problem.model.poses(&statuses, &problem.machine_values, &[], false, &mut poses).ok()?;
    Some(rows.into_iter().zip(poses.positions.into_iter().map(Vector3::from)).collect())
}

#[cfg(test)]
mod tests {
    use abbe_numerics::Generator;

    use super::*;

    /// The pairs that are exchanged.
    fn exchanged_pairs(places: &[Vector3<f64>], touches: &[Touch]) -> Vec<[usize; 2]> {
        let pair = |found: Elsewhere| {
            assert!(found.is_exchanged, "{found:?}");
            [found.feature, found.at]
        };
        elsewhere(places, touches).into_iter().map(pair).collect()
    }

    /// Random facets, and touches on them by a machine with a set-up that is off, aimed at their points or anywhere around these.
    fn touched(random: &mut Generator) -> (Vec<Vector3<f64>>, Vec<Touch>) {
        let mut vector = |size: f64| Vector3::from_fn(|_, _| size * random.uniform());
        let (count, each) = (3 + (vector(1.0).x.abs() * 20.0) as usize, 1 + (vector(1.0).x.abs() * 8.0) as usize);
        let shift = vector(3.0);
        // Some on one plane, some in a row of one pitch.
        let places: Vec<Vector3<f64>> = match (vector(1.0).x * 10.0) as i32 % 3 {
            0 => (0..count).map(|_| vector(150.0)).collect(),
            1 => (0..count).map(|_| vector(150.0).component_mul(&Vector3::new(1.0, 1.0, 0.0))).collect(),
            _ => (0..count).map(|place| Vector3::new(25.0 * place as f64, 0.0, 0.0)).collect(),
        };
        let beside = [0.0, 1.0, 20.0][(vector(1.0).x.abs() * 1.7) as usize % 3];
        let touches = (0..count).flat_map(|feature| (0..each).map(move |_| feature));
        let touches =
            touches.map(|feature| (feature, places[feature] + shift + vector(beside) + Vector3::z() * 3.0)).collect();
        (places, touches)
    }

    #[test]
    fn features_that_are_where_they_should_be_get_no_word() {
        for seed in 0..5000 {
            let (places, touches) = touched(&mut Generator::new(seed, 3));
            assert_eq!(exchanged_pairs(&places, &touches), Vec::<[usize; 2]>::new(), "{seed}");
        }
    }

    #[test]
    fn of_several_places_near_a_touch_the_nearest_is_meant() {
        let place = |x: f64, y: f64| Vector3::new(x, y, 200.0);
        let places = [place(100.0, -120.0), place(100.0, 160.0), place(130.0, -150.0), place(-90.0, 20.0)];
        // The second and the third exchanged; the first is near the third.
        let touches: Vec<Touch> = [(0, 0), (1, 2), (2, 1), (3, 3)].map(|(of, at)| (of, places[at])).to_vec();
        assert_eq!(exchanged_pairs(&places, &touches), [[1, 2]]);
    }

    #[test]
    fn exchanged_features_are_named() {
        let mut named = 0;
        for seed in 0..1000 {
            let (places, mut touches) = touched(&mut Generator::new(seed, 4));
            touches.iter_mut().for_each(|(feature, _)| *feature = if *feature < 2 { 1 - *feature } else { *feature });
            let found = elsewhere(&places, &touches);
            assert!(found.iter().all(|found| found.feature < 2), "{seed}: {found:?}");
            named += usize::from(matches!(found[..], [Elsewhere { is_exchanged: true, .. }]));
        }
        assert!(named > 600, "{named}");
    }

    /// Touches of one feature that are copies of those of another one.
    #[test]
    fn a_feature_that_was_touched_at_another_is_named() {
        let mut named = 0;
        for seed in 0..2000 {
            let (places, touches) = touched(&mut Generator::new(seed, 5));
            let others = touches.iter().filter(|(feature, _)| *feature != 0);
            let copies = touches.iter().filter(|(feature, _)| *feature == 1).map(|(_, tip)| (0, *tip));
            let copied: Vec<Touch> = others.copied().chain(copies).collect();
            let found = elsewhere(&places, &copied);
            assert!(
                found.is_empty() || found == [Elsewhere { feature: 0, at: 1, is_exchanged: false }],
                "{seed}: {found:?}"
            );
            named += usize::from(!found.is_empty());
        }
        assert!(named > 600, "{named}");
    }

    #[test]
    fn touches_far_from_their_features_are_found() {
        for seed in 0..5000 {
            let mut random = Generator::new(seed, 6);
            let (places, mut touches) = touched(&mut random);
            assert_eq!(far(&places, &touches).0, Vec::<usize>::new(), "{seed}");
            let wrong = random.index(touches.len());
            touches[wrong].1.z += 700.0;
            assert_eq!(far(&places, &touches).0, [wrong], "{seed}");
        }
    }

    /// An artefact that stands turned round is no exchange of labels.
    #[test]
    fn a_whole_artefact_elsewhere_is_not_told_as_labels() {
        let places: Vec<Vector3<f64>> =
            (0..12).map(|place| Vector3::new(f64::from(place) * 20.0 - 110.0, 0.0, 0.0)).collect();
        let touches: Vec<(usize, Vector3<f64>)> = places.iter().map(|place| -place).enumerate().collect();
        assert_eq!(exchanged_pairs(&places, &touches), Vec::<[usize; 2]>::new());
    }
}
