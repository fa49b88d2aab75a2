use std::path::PathBuf;

use abbe_core::RowOrigin;

use super::*;

fn data(columns: &[(&str, Vec<f64>)], runs: &[&str]) -> Dataset {
    let number = |(name, values): &(&str, Vec<f64>)| Column {
        header: ColumnHeader::parse(name),
        values: Values::Numbers(values.clone()),
    };
    let labels = Values::Labels(runs.iter().map(|run| (*run).into()).collect());
    let of_runs = Column { header: ColumnHeader::parse("run"), values: labels };
    Dataset {
        columns: columns.iter().map(number).chain([of_runs]).collect(),
        origins: (0..runs.len()).map(|row| RowOrigin { file: 0, line: row + 2, row: row + 1 }).collect(),
        files: vec![PathBuf::from("circle.csv")],
        ..Dataset::default()
    }
}

fn motion(after_reversal_mm: f64) -> Motion {
    Motion { axes: ["X", "Y"].map(str::to_owned).to_vec(), runs: run(), after_reversal_mm }
}

/// A circle of 150 mm at 50 mm/s, in steps of a degree from `from`, both ways; times in ms.
fn circle(from: i32, count: usize) -> Dataset {
    let angles: Vec<f64> = (0..count).map(|k| f64::from(from + k as i32).to_radians()).collect();
    let there = angles.iter().chain(angles.iter().rev());
    let on = |of: fn(f64) -> f64| there.clone().map(|angle| 150.0 * of(*angle)).collect();
    let times = (0..count).map(|k| k as f64 * 3.0_f64.to_radians()).map(|time| (time * 1e3).round() / 1e3);
    let times: Vec<f64> = times.clone().chain(times.map(|time| 100.0 + time)).collect();
    let runs: Vec<&str> = (0..2 * count).map(|row| if row < count { "1" } else { "2" }).collect();
    data(&[("X_mm", on(f64::cos)), ("Y_mm", on(f64::sin)), ("time_s", times)], &runs)
}

#[test]
fn velocities_and_directions_of_a_circle_are_those_of_its_angle() {
    let count = 360;
    let mut data = circle(0, count);
    let stays = motion(0.0).add(&mut data).unwrap();
    let [x, y, dir_x, dir_y] = ["velocity_X", "velocity_Y", "dir_X", "dir_Y"].map(|name| data.numbers(name).unwrap());
    for row in 0..2 * count {
        let (degrees, sense) = if row < count { (row, 1.0) } else { (2 * count - 1 - row, -1.0) };
        let at = (degrees as f64).to_radians();
        let expected = [-50.0 * sense * at.sin(), 50.0 * sense * at.cos()];
        for (found, expected) in [x[row], y[row]].into_iter().zip(expected) {
            assert!((found - expected).abs() < 1e-3, "{degrees}: {found} instead of {expected}");
        }
        assert_eq!(stays[row], degrees % 90 != 0, "{degrees} {sense}");
        if stays[row] {
            assert_eq!([dir_x[row], dir_y[row]], expected.map(f64::signum), "{degrees} {sense}");
        }
    }
    // The feed that is stated counts, and times are not needed.
    let mut stated = circle(-45, 450);
    stated.columns.remove(2);
    stated
        .columns
        .push(Column { header: ColumnHeader::parse("feed_mm_per_min"), values: Values::Numbers(vec![40.0; 900]) });
    motion(0.0).add(&mut stated).unwrap();
    let speed = stated.numbers("velocity_X").unwrap()[100].hypot(stated.numbers("velocity_Y").unwrap()[100]);
    assert!((speed - 40.0).abs() < 1e-9, "{speed}");
}

#[test]
fn rows_behind_reversals_can_be_left_out() {
    let mut data = circle(-45, 450);
    // A degree is 2.6 mm: 1, 2 and 3 degrees behind.
    let stays = motion(10.0).add(&mut data).unwrap();
    for (row, stays) in stays.iter().take(450).enumerate() {
        let behind = (row as i32 - 45).rem_euclid(90);
        // None is known before the first row.
        assert_eq!(*stays, row < 45 || behind > 3, "{row}");
    }
    let backward: Vec<i32> = (0..450).filter(|row| !stays[450 + row]).map(|row| 404 - row as i32).collect();
    assert_eq!(&backward[..4], [360, 359, 358, 357]);
}

/// A line whose feed grows: times are those of a constant acceleration.
#[test]
fn a_feed_that_changes_is_followed() {
    let times: Vec<f64> = (0..50).map(|k| 0.1 * f64::from(k)).collect();
    let way: Vec<f64> = times.iter().map(|time| 10.0 * time + 2.0 * time * time).collect();
    let (x, y) = (way.iter().map(|way| 0.6 * way).collect(), way.iter().map(|way| -0.8 * way).collect());
    let mut data = data(&[("X_mm", x), ("Y_mm", y), ("time_s", times.clone())], &["1"; 50]);
    assert_eq!(motion(0.0).add(&mut data).unwrap(), [true; 50]);
    let [x, y] = ["velocity_X", "velocity_Y"].map(|name| data.numbers(name).unwrap());
    for (row, time) in times.iter().enumerate() {
        let speed = 10.0 + 4.0 * time;
        assert!((x[row] - 0.6 * speed).abs() < 1e-9 && (y[row] + 0.8 * speed).abs() < 1e-9, "{row}: {}", x[row]);
    }
    assert_eq!(data.numbers("dir_Y").unwrap()[3], -1.0);
}

#[test]
fn rows_at_which_the_axes_stand_are_left_out() {
    let at = |x: [f64; 6]| {
        data(&[("X_mm", x.to_vec()), ("Y_mm", vec![0.0; 6]), ("time_s", (0..6).map(f64::from).collect())], &["1"; 6])
    };
    let stays = motion(0.0).add(&mut at([0.0, 1.0, 1.0, 2.0, 3.0, 3.0])).unwrap();
    assert_eq!(stays, [true, true, false, true, true, false]);
    assert!(motion(0.0).add(&mut at([1.0; 6])).unwrap().iter().all(|stays| !stays));
}

#[test]
fn what_is_wrong_is_told() {
    let told = |motion: Motion, data: &mut Dataset| motion.add(data).unwrap_err().to_string();
    let mut data = circle(0, 20);
    if let Values::Numbers(times) = &mut data.columns[2].values {
        times[7] = times[6];
    }
    let message = told(motion(0.0), &mut data);
    assert!(message.contains("circle.csv:9: the time does not grow from the row before"), "{message}");
    let named = |axes: &[&str]| Motion { axes: axes.iter().map(|axis| (*axis).to_owned()).collect(), ..motion(0.0) };
    assert!(told(named(&["X", "U"]), &mut circle(0, 20)).contains('U'));
    assert!(told(named(&["X", "X"]), &mut circle(0, 20)).contains("there is a column `dir_X` already"));
    assert!(told(named(&[]), &mut circle(0, 20)).contains("at least one axis"));
    assert!(told(Motion { runs: "cycle".to_owned(), ..motion(0.0) }, &mut circle(0, 20)).contains("cycle"));
    assert!(told(motion(-1.0), &mut circle(0, 20)).contains("from 0 to 1e6"));
}

/// A position with a lost sign, in another unit or beyond the travel is no reversal, also where several rows have it.
#[test]
fn rows_beside_their_path_are_refused() {
    // Circles in uneven steps, lines there and back, arcs with a gap between them: none of them jumps away and back.
    for from in (-180..180).step_by(7) {
        assert!(motion(5.0).add(&mut circle(from, 200)).is_ok(), "{from}");
    }
    let there: Vec<f64> = (0..60).map(|k| f64::from(k) * 5.0).collect();
    let back: Vec<f64> = there.iter().chain(there.iter().rev()).copied().collect();
    let times: Vec<f64> = (0..120).map(f64::from).collect();
    let mut both = data(&[("X_mm", back.clone()), ("Y_mm", vec![0.0; 120]), ("time_s", times.clone())], &["1"; 120]);
    assert!(motion(0.0).add(&mut both).is_ok());
    let gap: Vec<f64> = (0..120).map(|k| f64::from(k) + if k < 60 { 0.0 } else { 300.0 }).collect();
    let mut arcs = data(&[("X_mm", gap), ("Y_mm", vec![0.0; 120]), ("time_s", times)], &["1"; 120]);
    assert!(motion(0.0).add(&mut arcs).is_ok());
    for (first, count) in (5..300).step_by(11).zip([1, 2, 3, 7].into_iter().cycle()) {
        for change in [|x: f64| x + 1e4, |x: f64| x / 25.4, |x: f64| -x] {
            let mut data = circle(20, 320);
            let Values::Numbers(x) = &mut data.columns[0].values else { panic!("numbers") };
            let off = (first..first + count).map(|row| (change(x[row]) - x[row]).abs()).fold(f64::MAX, f64::min);
            (first..first + count).for_each(|row| x[row] = change(x[row]));
            match motion(20.0).add(&mut data) {
                Err(error) => {
                    let message = error.to_string();
                    let line = format!("circle.csv:{}: the axes are ", first + 2);
                    assert!(
                        message.contains(&line) && message.contains("beside the path"),
                        "{first} {count}: {message}"
                    );
                }
                // A sign hardly counts near zero.
                Ok(_) => assert!(off < 40.0, "{first} {count}: {off}"),
            }
        }
    }
}
