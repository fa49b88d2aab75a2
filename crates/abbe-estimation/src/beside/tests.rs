use abbe_numerics::Generator;

use super::*;

/// A programme of touches on a machine with a table that swivels and turns, and a tool that may swivel, too.
struct Programme {
    touches: Vec<Touch>,
    /// The stretch of the programme that a touch is in: a position of the rotary axes.
    stretches: Vec<usize>,
    /// Whether all facets were touched at their points.
    is_aimed: bool,
}

fn turned(axis: Vector3<f64>, angle: f64) -> Matrix3<f64> {
    *nalgebra::Rotation3::from_axis_angle(&nalgebra::Unit::new_normalize(axis), angle).matrix()
}

/// A good programme: facets that lie anyhow or as faces of a block, touched at their points, or anywhere around these on purpose.
fn programme(random: &mut Generator) -> Programme {
    let count = 3 + random.index(20);
    let is_block = random.index(2) == 0;
    let normal = |random: &mut Generator| {
        let mut normal = Vector3::from_fn(|_, _| random.normal());
        if is_block {
            let axis = normal.iamax();
            normal = Vector3::from_fn(|part, _| if part == axis { normal[axis].signum() } else { 0.0 });
        }
        normal.normalize()
    };
    let facets: Vec<Vector3<f64>> = (0..count).map(|_| normal(random)).collect();
    let positions = 2 + random.index(8);
    // How far around their points, mm: not at all, within errors, on a part of the facet, anywhere, in a grid of places.
    let around = [0.0, 0.3, 3.0, 30.0][random.index(4)];
    let grid = [0.0, 15.0, 40.0][random.index(3)];
    // The artefact as a whole, and the set-up and errors of the machine.
    let off = Vector3::from_fn(|_, _| [0.1, 1.0, 8.0][random.index(3)] * random.normal());
    let swivels = random.index(2) == 0;
    let mut made = Programme { touches: Vec::new(), stretches: Vec::new(), is_aimed: around < 1.0 && grid == 0.0 };
    for position in 0..positions {
        let (a, c) = (1.0 * random.uniform(), std::f64::consts::PI * random.uniform());
        let machine = turned(Vector3::z(), c) * turned(Vector3::x(), a);
        let tool = if swivels { machine * turned(Vector3::y(), 0.8 * random.uniform()) } else { machine };
        let errors = Vector3::from_fn(|_, _| 0.1 * random.normal());
        for (facet, normal) in facets.iter().enumerate() {
            if random.index(5) == 0 {
                continue;
            }
            for _ in 0..1 + random.index(3) {
                let in_plane = Matrix3::identity() - normal * normal.transpose();
                let place = Vector3::from_fn(|_, _| around * random.uniform() + grid * (random.index(3) as f64 - 1.0));
                made.touches.push(Touch {
                    facet,
                    beside: in_plane * (off + errors + place),
                    effects: [tool, machine, Matrix3::identity()].map(|frame| in_plane * frame),
                    stylus: None,
                });
                made.stretches.push(position);
            }
        }
    }
    made
}

#[test]
fn touches_where_they_are_meant_to_be_get_no_word() {
    let told = (0..5_000).filter(|seed| displaced(&programme(&mut Generator::new(*seed, 1)).touches).is_some());
    let told: Vec<u64> = told.collect();
    assert!(told.is_empty(), "{told:?}");
}

/// A part of the rows with a displacement of 5 to 100 mm in the axes of a frame: the share that is told.
fn mistaken(seeds: std::ops::Range<u64>, frame: Frame) -> [usize; 3] {
    let mut counts = [0; 3];
    for seed in seeds {
        let random = &mut Generator::new(seed, 2);
        let mut made = programme(random);
        let positions = made.stretches.last().copied().unwrap_or_default() + 1;
        let from = random.index(positions);
        let to = (from + 1 + random.index(positions)).min(positions);
        let size = 5.0 * 20.0_f64.powf(0.5 + 0.5 * random.uniform() / 3.0_f64.sqrt());
        let direction = match frame {
            Frame::Tool => Vector3::z(),
            _ => Vector3::from_fn(|_, _| random.normal()).normalize(),
        };
        let effects = |touch: &Touch| touch.effects[frame as usize] * (size * direction);
        let own: Vec<usize> =
            (0..made.touches.len()).filter(|place| (from..to).contains(&made.stretches[*place])).collect();
        let is_part = own.len() >= FEWEST && 2 * own.len() <= made.touches.len();
        for place in &own {
            let by = effects(&made.touches[*place]);
            made.touches[*place].beside += by;
        }
        if !is_part || !made.is_aimed {
            continue;
        }
        counts[0] += 1;
        if let Some(found) = displaced(&made.touches) {
            counts[1] += 1;
            let is_right = found.touches.iter().all(|place| own.contains(place)) && found.frames.contains(&frame);
            counts[2] += usize::from(is_right);
        }
    }
    counts
}

#[test]
fn a_part_of_the_rows_that_is_displaced_is_told() {
    for frame in FRAMES {
        let [all, told, right] = mistaken(0..2000, frame);
        assert!(all > 200 && told * 10 >= all * 6 && right * 100 >= told * 95, "{frame:?}: {all} {told} {right}");
    }
}
