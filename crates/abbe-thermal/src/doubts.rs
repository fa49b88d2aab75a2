//! What logs of temperatures and displacements cannot be: columns that were exchanged or copied, and displacements in another unit.

use abbe_core::{Dataset, Error, Quantity, Result};
use abbe_numerics::{Channel, InstrumentFault, instrument_faults, row_noise};

/// A column of a log: its name, and its numbers in the unit in which it is written.
type Column<'a> = (&'a str, Vec<f64>);

/// Most that temperatures of a machine differ by where a log begins, K, and the least that tells an exchange.
const ALIKE: f64 = 5.0;
const UNLIKE: f64 = 12.0;

/// Largest size of a displacement where a log begins, um, for which it counts from zero.
const ZERO: f64 = 5.0;

/// A column of temperatures and one of displacements that seem to be exchanged, in words: where the log begins the temperature is far
/// from the others and near zero, and with the displacement in its place all are alike.
pub fn exchanged(data: &Dataset) -> Option<String> {
    let of = |quantity: Quantity, factor: f64| -> Vec<Column<'_>> {
        let columns = data.columns.iter().filter(|column| column.header.quantity == quantity);
        let numbers = columns.filter_map(|column| {
            let name = column.header.name.as_str();
            Some((name, data.numbers(name)?.iter().map(|value| value * factor).collect()))
        });
        numbers.collect()
    };
    let (temperatures, displacements) = (of(Quantity::Temperature, 1.0), of(Quantity::Length, 1e3));
    let begin = |values: &[f64]| values.first().copied();
    let spread = |values: &[f64]| {
        let [low, high] = values.iter().fold([f64::MAX, f64::MIN], |[low, high], &it| [low.min(it), high.max(it)]);
        high - low
    };
    let first: Vec<f64> = temperatures.iter().filter_map(|(_, values)| begin(values)).collect();
    if first.len() < 2 || first.len() != temperatures.len() || spread(&first) < UNLIKE {
        return None;
    }
    for (place, (name, _)) in temperatures.iter().enumerate().filter(|(place, _)| first[*place].abs() < ZERO) {
        let fits = |value: &f64| {
            let mut with = first.clone();
            with[place] = *value;
            spread(&with) < ALIKE
        };
        let mut others = displacements.iter().filter_map(|(name, values)| Some((name, begin(values)?)));
        if let Some((other, value)) = others.find(|(_, value)| fits(value)) {
            return Some(format!(
                "{name} begins at {:.2} °C and {other} at {value:.2} um, and the other temperatures are near {:.1} °C: are these columns \
                 exchanged?",
                first[place],
                usual(&first, place)
            ));
        }
    }
    None
}

/// The mean of all but one.
fn usual(values: &[f64], but: usize) -> f64 {
    let sum: f64 = values.iter().enumerate().filter(|(place, _)| *place != but).map(|(_, value)| value).sum();
    sum / (values.len() - 1) as f64
}

/// Refuses displacements and angles of a data set of which one has the readings of another one, in ten rows one after the other or more: no
/// two sensors read the same to the last digit while they move. `names` are their columns, without units.
pub fn not_copied<'a>(data: &Dataset, names: impl IntoIterator<Item = &'a String>) -> Result<()> {
    let names: Vec<&String> = names.into_iter().collect();
    for quantity in [Quantity::Length, Quantity::Angle] {
        let of_quantity = names.iter().enumerate().filter(|(place, name)| {
            !names[..*place].contains(name) && data.column(name).is_some_and(|own| own.header.quantity == quantity)
        });
        let channels: Vec<Channel<'_>> = of_quantity
            .filter_map(|(_, name)| Some(Channel { name: name.as_str(), readings: data.numbers(name)? }))
            .collect();
        let mut faults = instrument_faults(&channels, None).into_iter();
        if let Some(fault) = faults.find(|fault| matches!(fault, InstrumentFault::Copy { .. })) {
            let error = Error::data(fault.describe(&channels, (1.0, "")));
            let error = error.help("measure again, or leave one of the two out");
            return Err(match data.files.first() {
                Some(file) => error.in_file(file),
                None => error,
            });
        }
    }
    Ok(())
}

/// Ranges of displacements of a machine that warms up, um: of the one that moves most, and the least of any.
const PLAUSIBLE: [f64; 2] = [0.5, 1000.0];
const STILL: f64 = 0.1;

/// Least range of the warmest sensor, K, with which a machine drifts.
const WARMED: f64 = 2.0;

/// Displacements, by name in mm, that hardly move while a machine warms up, or move farther than one does, in words: they may be in
/// another unit. `temperatures` are those of the same rows.
pub fn in_another_unit(displacements: &[(&str, &[f64])], temperatures: &[&[f64]]) -> Option<String> {
    let range = |values: &[f64]| {
        let finite = values.iter().copied().filter(|value| value.is_finite());
        let [low, high] = finite.fold([f64::MAX, f64::MIN], |[low, high], it| [low.min(it), high.max(it)]);
        (high - low).max(0.0)
    };
    if temperatures.iter().map(|values| range(values)).fold(0.0, f64::max) < WARMED {
        return None;
    }
    let ranges: Vec<(&str, f64)> = displacements.iter().map(|(name, values)| (*name, 1e3 * range(values))).collect();
    let (most, least) = (
        ranges.iter().max_by(|one, other| one.1.total_cmp(&other.1))?,
        ranges.iter().filter(|(_, range)| *range > 0.0).min_by(|one, other| one.1.total_cmp(&other.1))?,
    );
    let [low, high] = PLAUSIBLE;
    if !(low..=high).contains(&most.1) {
        return Some(format!(
            "{} moves most, by {:.3} um in all, while the machine warms up; {low} um to {high} um are usual: is it in the unit that its \
             column says?",
            most.0, most.1
        ));
    }
    if least.1 < STILL {
        return Some(format!(
            "{} moves by {:.4} um in all while the machine warms up, and {} by {:.1} um: is it in the unit that its column says?",
            least.0, least.1, most.0, most.1
        ));
    }
    quieter(displacements)
}

/// Part of the noise of the others below which that of a displacement is not that of its sensor. Inches are 25.4 times millimetres.
const QUIETER: f64 = 0.1;

/// A displacement, by name in mm, with far less noise than all others, in words: it may be in another unit. Noise of neighbouring rows
/// does not know how far a machine drifts. Nothing is told of readings without noise.
pub fn quieter(displacements: &[(&str, &[f64])]) -> Option<String> {
    let noises: Vec<f64> = displacements.iter().map(|(_, values)| white(values)).collect::<Option<_>>()?;
    let place = (0..noises.len()).min_by(|one, other| noises[*one].total_cmp(&noises[*other]))?;
    let others = || noises.iter().enumerate().filter(|(other, _)| *other != place).map(|(_, noise)| *noise);
    let least = others().reduce(f64::min)?;
    (noises[place] + digit(displacements[place].1) < QUIETER * least).then(|| {
        format!(
            "{} scatters from row to row by {:.4} um, and the others by {:.4} um or more: is it in the unit that its column says?",
            displacements[place].0,
            1e3 * noises[place],
            1e3 * least
        )
    })
}

/// The noise of readings from row to row; none where they are smooth or few.
fn white(values: &[f64]) -> Option<f64> {
    row_noise(values).filter(|noise| noise.is_white).map(|noise| noise.size)
}

/// The least step between two different readings: their digits, or less.
fn digit(values: &[f64]) -> f64 {
    let mut all: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    all.sort_by(f64::total_cmp);
    all.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 0.0).reduce(f64::min).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use abbe_core::{Column, ColumnHeader, RowOrigin, Values};

    use super::*;

    fn log(columns: &[(&str, [f64; 3])]) -> Dataset {
        let column = |(header, values): &(&str, [f64; 3])| {
            let header = ColumnHeader::parse(header);
            let factor = if header.quantity == Quantity::Length { 1e-3 } else { 1.0 };
            Column { header, values: Values::Numbers(values.iter().map(|value| factor * value).collect()) }
        };
        let origins = (1..=3).map(|row| RowOrigin { file: 0, line: row + 1, row }).collect();
        Dataset { columns: columns.iter().map(column).collect(), origins, ..Dataset::default() }
    }

    #[test]
    fn exchanged_columns_are_found() {
        let good = [("T01_degC", [20.3, 20.4, 20.3]), ("T02_degC", [20.8, 25.0, 31.0]), ("z_um", [0.04, 8.0, 36.8])];
        assert_eq!(exchanged(&log(&good)), None);
        let wrong = [("T01_degC", good[0].1), ("T02_degC", good[2].1), ("z_um", good[1].1)];
        let said = exchanged(&log(&wrong)).expect("a word");
        assert!(said.contains("T02") && said.contains("exchanged"), "{said}");
        // A machine that is warm already, a cold hall, and a sensor outside in winter.
        for (one, other, drift) in [(20.0, 45.0, 0.0), (2.0, 4.0, 3.0), (0.5, 21.0, 0.2)] {
            let log = log(&[("T01_degC", [one; 3]), ("T02_degC", [other; 3]), ("z_um", [drift, 4.0, 9.0])]);
            assert_eq!(exchanged(&log), None);
        }
    }

    #[test]
    fn other_units_are_found() {
        let (warm, cold): ([f64; 3], [f64; 3]) = ([20.0, 25.0, 31.0], [20.0, 20.1, 20.0]);
        let of = |z: [f64; 3], temperature: [f64; 3]| {
            in_another_unit(&[("z", &z), ("x", &[0.0, 1e-3, 2e-3])], &[&temperature])
        };
        assert_eq!(of([0.0, 8e-3, 30e-3], warm), None);
        assert!(of([0.0, 8.0, 30.0], warm).is_some_and(|said| said.starts_with("z moves most")));
        assert!(of([0.0, 8e-6, 30e-6], warm).is_some_and(|said| said.starts_with("z moves by")));
        assert!(in_another_unit(&[("z", &[0.0, 7e-5])], &[&warm]).is_some_and(|said| said.contains("0.070 um")));
        assert_eq!(of([0.0, 8e-6, 30e-6], cold), None);
    }

    #[test]
    fn channels_with_less_noise_are_found() {
        let mut found = [0, 0];
        for seed in 0..2_000 {
            let mut generator = abbe_numerics::Generator::new(seed, 0);
            let rows = 30 + seed as usize % 300;
            let digits = [1e-7, 1e-5, 1e-4][seed as usize % 3];
            let of = |size: f64, noise: f64, generator: &mut abbe_numerics::Generator| -> Vec<f64> {
                let curve = |row: usize| size * (1.0 - (-4.0 * row as f64 / rows as f64).exp());
                (0..rows).map(|row| curve(row) + noise * generator.normal()).collect()
            };
            let noise = 1e-5 * 10_f64.powf(generator.normal().clamp(-1.0, 1.0));
            let mut x = of(5e-3 * generator.normal(), noise, &mut generator);
            let mut y = of(5e-3 * generator.normal(), 2.0 * noise, &mut generator);
            let mut z = of(30e-3 * generator.normal(), noise, &mut generator);
            for values in [&mut x, &mut y, &mut z] {
                values.iter_mut().for_each(|value| *value = (*value / digits).round() * digits);
            }
            assert_eq!(quieter(&[("x", &x), ("y", &y), ("z", &z)]), None, "{seed}");
            let inches: Vec<f64> = z.iter().map(|value| value / 25.4).collect();
            if noise > 2.0 * digits {
                let said = quieter(&[("x", &x), ("y", &y), ("z", &inches)]).unwrap_or_default();
                found[usize::from(said.starts_with("z scatters"))] += 1;
            }
            // Without noise there is nothing to compare.
            let smooth = of(30e-3, 0.0, &mut generator);
            assert_eq!(quieter(&[("x", &x), ("z", &smooth)]), None, "{seed}");
        }
        // Of few rows noise is not known well, and it may be hidden by digits.
        assert!(found[1] > 2 * found[0], "{found:?}");
    }
}
