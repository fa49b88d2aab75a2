//! Features whose touches lie at the nominal place of each other: offsets of facets take up the difference, and nothing else tells.

use std::collections::BTreeMap;

use abbe_core::{Contact, ObservationSet, Poses, Problem, RowIndex};
use nalgebra::Vector3;

/// A touch is at the place of another feature if it is nearer to it than this part of the distance between the two, and further from its
/// own than that part.
const NEAR: f64 = 0.25;
const FAR: f64 = 0.75;

/// Part of the features that may be exchanged: where more are, the artefact stands elsewhere.
const FEW: f64 = 0.25;

/// Fewest features that tell: two alone may be turned round together.
const FEWEST: usize = 3;

/// Sentences on pairs of features each of which was touched where the other one should be.
pub(crate) fn exchanged_places(problem: &Problem) -> Vec<String> {
    let sets = problem.sets.iter().filter(|set| set.info().contact == Contact::LinearAxes);
    sets.flat_map(|set| of_set(problem, set).unwrap_or_default()).collect()
}

fn of_set(problem: &Problem, set: &ObservationSet) -> Option<Vec<String>> {
    let (info, layout) = (set.info(), &set.info().layout);
    let labels = layout.data.labels("feature")?;
    let places: Vec<Vector3<f64>> = info.features.iter().map(|feature| Vector3::from(feature.point)).collect();
    let of_label: BTreeMap<&str, usize> =
        info.features.iter().enumerate().map(|(index, feature)| (feature.label.as_str(), index)).collect();
    let touch = |(row, tip): (RowIndex, Vector3<f64>)| {
        let feature = of_label.get(labels[layout.rows[row].data_row?].as_str())?;
        Some((*feature, tip))
    };
    let touches: Vec<(usize, Vector3<f64>)> = tips(problem, set)?.into_iter().filter_map(touch).collect();
    let sentence = |[one, other]: [usize; 2]| {
        let apart = (places[one] - places[other]).norm();
        let [one, other] = [one, other].map(|feature| &info.features[feature].label);
        format!(
            "{}: feature {one} was touched at the nominal place of {other}, {apart:.1} mm from its own, and {other} at that of {one}: are \
             the two labels exchanged? What is found of each then belongs to the other one",
            set.name
        )
    };
    Some(exchanged_pairs(&places, &touches).into_iter().map(sentence).collect())
}

/// Pairs of features with most of their touches at the place of the other one; none if the others are not where they should be either.
fn exchanged_pairs(places: &[Vector3<f64>], touches: &[(usize, Vector3<f64>)]) -> Vec<[usize; 2]> {
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
        let count = counts.get(&one).map(|(all, elsewhere)| (*all, elsewhere.get(&other).copied().unwrap_or_default()));
        count.is_some_and(|(all, elsewhere)| 2 * elsewhere > all)
    };
    let touched: Vec<usize> = counts.keys().copied().collect();
    let pairs =
        touched.iter().enumerate().flat_map(|(place, one)| touched[place + 1..].iter().map(|other| [*one, *other]));
    let pairs: Vec<[usize; 2]> = pairs.filter(|[one, other]| is_at(*one, *other) && is_at(*other, *one)).collect();
    let is_told = touched.len() >= FEWEST && pairs.len() as f64 <= (FEW * touched.len() as f64).max(1.0);
    if is_told { pairs } else { Vec::new() }
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

    /// A feature and the tip at a touch of it.
    type Touch = (usize, Vector3<f64>);

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
            let found = exchanged_pairs(&places, &touches);
            assert!(found.is_empty() || found == [[0, 1]], "{seed}: {found:?}");
            named += usize::from(!found.is_empty());
        }
        assert!(named > 600, "{named}");
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
