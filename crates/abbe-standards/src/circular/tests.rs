use super::*;

/// Numbers from -1 to 1 without a law.
fn random(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed.wrapping_mul(2_862_933_555_777_941_757).wrapping_add(3_037_000_493);
    move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 / f64::from(1 << 23) - 1.0
    }
}

fn seeds() -> u64 {
    std::env::var("ABBE_SEEDS").ok().and_then(|text| text.parse().ok()).unwrap_or(60)
}

fn samples(degrees: impl Iterator<Item = i32>, radius: impl Fn(f64) -> f64) -> Vec<Sample> {
    degrees
        .map(|degree| {
            let angle = f64::from(degree).to_radians();
            Sample { angle, radius: radius(angle) }
        })
        .collect()
}

#[test]
fn worked_example_of_an_ellipse() {
    // 100 + 0.01 cos 2t has its axes along the coordinates: both definitions of G are the difference of the axes.
    let trace = Trace::new(&samples(0..360, |angle| 100.0 + 0.01 * (2.0 * angle).cos()));
    assert!((trace.minimum_zone().expect("a zone").width - 0.02).abs() < 1e-12);
    assert!((trace.about_least_squares().expect("a range") - 0.02).abs() < 1e-12);
    let [most, least] = trace.as_set_up(100.0).expect("samples");
    assert!((most - 0.01).abs() < 1e-12 && (least + 0.01).abs() < 1e-12);
    // The other direction is 0.004 larger from 40 to 60 degrees.
    let back = samples((0..360).rev(), |angle| {
        100.0
            + 0.01 * (2.0 * angle).cos()
            + if (40.0..=60.0).contains(&angle.to_degrees().round()) { 0.004 } else { 0.0 }
    });
    let both = Bidirectional::of(&trace, &Trace::new(&back)).expect("both");
    let (size, angle) = both.hysteresis.expect("hysteresis");
    assert!((size - 0.004).abs() < 1e-6 && (39.5..60.5).contains(&angle.to_degrees()), "{size} {angle}");
    // 21 of 720 samples are 0.004 larger.
    assert!((both.radial_deviation(100.0) - 0.004 * 21.0 / 720.0).abs() < 5e-5);
}

#[test]
fn an_overshoot_is_told_by_the_angle_also_where_angles_begin_again() {
    let of = |angle: f64| 150.0 + 0.01 * (3.0 * angle).sin() + 0.002 * angle.cos();
    let plain = Trace::new(&samples(0..360, of));
    let over = Trace::new(&samples(-45..406, |angle| if (0.0..TAU).contains(&angle) { of(angle) } else { 160.0 }));
    assert_eq!((over.left_out(), over.samples().len()), (91, 360));
    let mut wrapped = samples(-45..406, |angle| if (0.0..TAU).contains(&angle) { of(angle) } else { 160.0 });
    wrapped.iter_mut().for_each(|sample| sample.angle = sample.angle.rem_euclid(TAU));
    let wrapped = Trace::new(&wrapped);
    wrapped.samples().iter().zip(plain.samples()).for_each(|(one, other)| {
        assert!((one.radius - other.radius).abs() < 1e-15);
    });
    assert!(
        (wrapped.minimum_zone().expect("a zone").width - plain.minimum_zone().expect("a zone").width).abs() < 1e-12
    );
}

#[test]
fn an_arc_has_nothing_but_f() {
    let arc = Trace::new(&samples(-20..201, |angle| 100.0 + 0.01 * angle.cos()));
    assert!(!arc.is_full() && arc.minimum_zone().is_none() && arc.about_least_squares().is_none());
    assert!(arc.as_set_up(100.0).is_some() && Bidirectional::of(&arc, &arc).is_none());
    // Almost all around is an arc as well; too few samples are no circle; none have no figure at all.
    assert!(!Trace::new(&samples(0..350, |_| 100.0)).is_full());
    assert!(!Trace::new(&samples((0..360).step_by(45), |_| 100.0)).is_full());
    assert_eq!(Trace::new(&[]).as_set_up(100.0), None);
    // A single sample that is missing is no matter.
    assert!(Trace::new(&samples((0..360).filter(|degree| *degree != 77), |_| 100.0)).is_full());
}

/// Samples at steps of about a degree: each is off by up to `jitter` degrees, or lies anywhere.
fn uneven(random: &mut impl FnMut() -> f64, count: usize, jitter: Option<f64>) -> Vec<Sample> {
    let degrees = |place: usize, random: &mut dyn FnMut() -> f64| match jitter {
        // The sum of twelve numbers from -1 to 1 is twice a normal one.
        Some(jitter) => place as f64 + jitter * 0.5 * (0..12).map(|_| random()).sum::<f64>(),
        None => 0.5 * count as f64 * (1.0 + random()),
    };
    let mut degrees: Vec<f64> = (0..count).map(|place| degrees(place, random)).collect();
    if jitter.is_none() {
        degrees.sort_by(f64::total_cmp);
    }
    degrees.into_iter().map(|degree| Sample { angle: degree.to_radians(), radius: 100.0 }).collect()
}

#[test]
fn a_full_circle_at_uneven_angles_is_no_arc() {
    let jitters = [Some(0.1), Some(0.2), Some(0.3), Some(0.5), None];
    let mut arcs = [0; 5];
    for seed in 0..seeds() * 10 {
        for ((place, jitter), count) in jitters.into_iter().enumerate().zip([360, 361, 361, 365, 400]) {
            let trace = Trace::new(&uneven(&mut random(seed), count, jitter));
            arcs[place] += u64::from(!trace.is_full());
        }
    }
    assert!(arcs[..4].iter().all(|count| *count == 0) && arcs[4] <= seeds() / 5, "{arcs:?} of {}", seeds() * 10);
}

#[test]
fn an_arc_at_uneven_angles_is_none_of_a_full_circle() {
    for seed in 0..seeds() {
        for (jitter, count) in [(Some(0.1), 354), (Some(0.2), 352), (Some(0.5), 345), (None, 320)] {
            let trace = Trace::new(&uneven(&mut random(seed), count, jitter));
            assert!(!trace.is_full(), "{seed} {jitter:?}");
        }
    }
}

/// The width of the ring about the best of many centres, by a search that knows distances alone.
fn by_trying(points: &[[f64; 2]]) -> f64 {
    let width = |x: f64, y: f64| {
        let radii = points.iter().map(|point| (point[0] - x).hypot(point[1] - y));
        let (most, least) = radii.fold((f64::MIN, f64::MAX), |(most, least), r| (most.max(r), least.min(r)));
        most - least
    };
    let (mut best, mut step) = ([0.0, 0.0, width(0.0, 0.0)], 0.05);
    while step > 1e-9 {
        let around = (0..24).map(|part| {
            let angle = TAU * f64::from(part) / 24.0;
            let (x, y) = (best[0] + step * angle.cos(), best[1] + step * angle.sin());
            [x, y, width(x, y)]
        });
        let next = around.reduce(|a, b| if b[2] < a[2] { b } else { a }).expect("some");
        if next[2] < best[2] { best = next } else { step *= 0.8 }
    }
    best[2]
}

#[test]
fn the_zone_is_no_wider_than_any_that_is_tried() {
    for seed in 0..seeds() {
        let mut next = random(seed);
        let mut of = || {
            let coefficients: Vec<f64> = (0..10).map(|_| 0.01 * next()).collect();
            let resolution = if seed % 2 == 0 { 1e-4 } else { 1e-9 };
            let centre = [0.05 * next(), 0.05 * next()];
            samples((0..360).step_by(4), |angle| {
                let lobes: f64 =
                    coefficients.iter().enumerate().map(|(k, c)| c * (k as f64 * angle + c * 1e4).cos()).sum();
                let radius = 150.0 + lobes + centre[0] * angle.cos() + centre[1] * angle.sin();
                (radius / resolution).round() * resolution
            })
        };
        let (one, other) = (Trace::new(&of()), Trace::new(&of()));
        for traces in [vec![&one], vec![&one, &other]] {
            let zone = smallest_zone(&traces).unwrap_or_else(|| panic!("seed {seed}: no zone"));
            let tried = by_trying(&points(&traces));
            assert!(zone.width <= tried * (1.0 + 1e-9), "seed {seed}: {} {tried}", zone.width);
            assert!(zone.width >= tried * (1.0 - 5e-3), "seed {seed}: {} {tried}", zone.width);
            let about = range_about_least_squares(&traces).expect("a range");
            assert!(zone.width <= about * (1.0 + 1e-12), "seed {seed}");
        }
    }
}

#[test]
fn hysteresis_does_not_need_samples_at_the_same_angles() {
    let one = Trace::new(&samples(0..360, |_| 100.0));
    let other: Vec<Sample> = (0..500)
        .map(|place| {
            let angle = -TAU * f64::from(place) / 500.0;
            Sample { angle, radius: 100.0 + 0.01 * (angle - 1.0).cos().powi(9) }
        })
        .collect();
    let (size, angle) = hysteresis(&one, &Trace::new(&other), [0.0, 0.0]).expect("hysteresis");
    assert!((size - 0.01).abs() < 1e-5);
    assert!(((angle - 1.0).sin()).abs() < 0.02);
}
