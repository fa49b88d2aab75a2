//! Limits that readings in another unit exceed: all figures of a test are too large by what one unit is of another.

use std::collections::BTreeMap;

use abbe_core::{Decision, Figure};

/// What a figure is larger than its limit by where somebody should look at the unit. A machine may be worse than its limits, and hardly
/// ten times.
const FAR: f64 = 10.0;

/// What readings are too large by if they are in another unit: inches, and the next larger or smaller one of the metre.
const UNITS: [f64; 2] = [25.4, 1e3];

/// Units of figures that follow the readings.
const FOLLOWING: [&str; 2] = ["um", "urad"];

/// What a figure is about: what stands in brackets behind its name.
fn run(figure: &Figure) -> &str {
    let (_, run) = figure.name.rsplit_once('[').unwrap_or_default();
    run.trim_end_matches(']')
}

/// Sentences on tests all of whose limits are exceeded, one by more than ten times, and none of them with readings in another unit.
///
/// One figure that is far too large, where others keep their limits, is no unit: readings in another unit make all of them larger.
pub fn limits_in_another_unit(figures: &[Figure]) -> Vec<String> {
    let mut shares: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    for figure in figures.iter().filter(|figure| FOLLOWING.contains(&figure.unit.as_str())) {
        let Some((value, limit)) = figure.value.zip(figure.limit).filter(|(_, limit)| *limit > 0.0) else { continue };
        // What is not decided, or keeps its limit, is far from none.
        let share = if figure.decide() == Some(Decision::Fail) { value.abs() / limit } else { 0.0 };
        shares.entry(run(figure)).or_default().push(share);
    }
    let told = |(run, shares): (&str, Vec<f64>)| {
        let (least, most) = shares.iter().fold((f64::MAX, 0.0_f64), |(low, high), own| (low.min(*own), high.max(*own)));
        let factor = UNITS.into_iter().find(|factor| most <= *factor)?;
        (least > 1.0 && most > FAR).then(|| {
            let all = if shares.len() == 1 {
                format!("the limit is exceeded {most:.1} times, and it would be kept")
            } else {
                format!("all {} limits are exceeded, one of them {most:.1} times, and they would be kept", shares.len())
            };
            format!("{run}: {all} with the readings divided by {factor}: is the unit of the column right?")
        })
    };
    shares.into_iter().filter_map(told).collect()
}

#[cfg(test)]
mod tests {
    use abbe_core::Limit;

    use super::*;

    /// Figures of one run with a limit of 20 each.
    fn figures(values: &[f64], unit: &str) -> Vec<Figure> {
        let one = |(number, value): (usize, &f64)| {
            Figure::new("", format!("F{number}[X]"), *value, unit).limited(Limit::from(20.0))
        };
        values.iter().enumerate().map(one).collect()
    }

    #[test]
    fn readings_in_another_unit_are_asked_about() {
        let said = |values: &[f64]| limits_in_another_unit(&figures(values, "um")).join("; ");
        // Machines that use half of their limits and more.
        for factor in UNITS {
            for part in [0.5, 0.8, 1.0] {
                let found = said(&[20.0 * part * factor, 6.0 * factor]);
                assert!(found.starts_with("X: all 2 limits are exceeded"), "{factor} {part}: {found}");
                let words = format!("divided by {factor}: is the unit of the column right?");
                assert!(found.ends_with(&words), "{factor} {part}: {found}");
            }
        }
        assert!(said(&[20.0 * 25.4]).starts_with("X: the limit is exceeded 25.4 times"));
        assert!(!limits_in_another_unit(&figures(&[20.0 * 500.0], "urad")).is_empty());
    }

    #[test]
    fn machines_that_fail_get_no_word() {
        for values in [
            // Within ten times, all of them or one.
            &[20.0 * 9.9, 20.0 * 9.0][..],
            &[20.0 * 9.9],
            &[21.0, 20.5],
            &[20.0, 1.0],
            // One figure alone is far too large, and what would still not keep its limit.
            &[20.0 * 20.0, 12.0],
            &[20.0 * 20.0, 20.0],
            &[20.0 * 1001.0, 20.0 * 500.0],
            &[],
        ] {
            assert_eq!(limits_in_another_unit(&figures(values, "um")), Vec::<String>::new(), "{values:?}");
        }
        // A share of a limit is in no unit, and what was not measured has no value.
        assert_eq!(limits_in_another_unit(&figures(&[400.0], "1")), Vec::<String>::new());
        assert_eq!(limits_in_another_unit(&figures(&[f64::NAN], "um")), Vec::<String>::new());
        // Another run is another column.
        let mut both = figures(&[400.0], "um");
        both.push(Figure::new("", "F0[Y]", 5.0, "um").limited(Limit::from(20.0)));
        assert!(limits_in_another_unit(&both)[0].starts_with("X: "));
        both[0].inconclusive = Some("too few readings".to_owned());
        assert_eq!(limits_in_another_unit(&both), Vec::<String>::new());
    }
}
