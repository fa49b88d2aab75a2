//! Columns that are likely in another unit than their name says, though their numbers can be read: told, because nobody can know.

use abbe_core::ranges::AT_REST;
use abbe_core::{Dataset, Quantity};

use crate::circles::contradicted_angles;
use crate::copied_sensors::copied_sensors;
use crate::lengths::{stands, two_references};

/// How far a sensor in °F is from the others at most, once it is converted, K: parts of a machine at rest.
const ALIKE: f64 = 8.0;

/// Part of a log that measurements cover at least if their times, in minutes, were read as seconds.
const COVERED: f64 = 0.5;

/// Seconds in a minute.
const MINUTE: f64 = 60.0;

/// What is doubtful in the columns of a data set, in words.
pub(crate) fn doubts(data: &Dataset) -> Vec<String> {
    let kinds = [likely_fahrenheit, likely_turned, copied_sensors, contradicted_angles, two_references, stands];
    kinds.into_iter().filter_map(|doubt| doubt(data)).collect()
}

/// Columns of temperatures that begin as no machine at rest does, and would if they were in °F, in words.
fn likely_fahrenheit(data: &Dataset) -> Option<String> {
    let columns = data.columns.iter().filter(|column| column.header.quantity == Quantity::Temperature);
    let first = |name: &str| data.numbers(name)?.iter().copied().find(|value| value.is_finite());
    let firsts: Vec<(&str, f64)> =
        columns.filter_map(|column| Some((column.header.name.as_str(), first(&column.header.name)?))).collect();
    let in_fahrenheit = |(_, value): &(&str, f64)| !AT_REST.contains(value) && AT_REST.contains(&celsius(*value));
    let (doubtful, others): (Vec<_>, Vec<_>) = firsts.into_iter().partition(in_fahrenheit);
    let (name, value) = doubtful.first()?;
    if others.is_empty() {
        return Some(format!(
            "all temperatures begin from {:.1} to {:.1}, as {name} at {value:.1}: no machine at rest is so warm; are they in °F? \
             {value:.1} °F are {:.1} °C, and `unit: degF` under `columns` of the stage says it",
            doubtful.iter().map(|(_, value)| *value).fold(f64::INFINITY, f64::min),
            doubtful.iter().map(|(_, value)| *value).fold(f64::NEG_INFINITY, f64::max),
            celsius(*value)
        ));
    }
    let mut rest: Vec<f64> = others.iter().map(|(_, value)| *value).collect();
    rest.sort_by(f64::total_cmp);
    let middle = rest[rest.len() / 2];
    let (name, value) = doubtful.iter().find(|(_, value)| (celsius(*value) - middle).abs() < ALIKE)?;
    Some(format!(
        "{name} begins at {value:.1} °C, and the other temperatures at {middle:.1} °C: is it in °F? {value:.1} °F are {:.1} °C",
        celsius(*value)
    ))
}

/// How much colder than all others a sensor below zero is at least, K, and how much warmer one that cannot be: a spindle that was stopped
/// shortly before is less warm.
const COLDER: f64 = 20.0;
const WARMER: f64 = 65.0;

/// A sensor that begins below zero, or far above the others, while all others begin as a machine at rest does, in words; or all of them,
/// where those of a machine at rest with turned signs do.
fn likely_turned(data: &Dataset) -> Option<String> {
    let columns = data.columns.iter().filter(|column| column.header.quantity == Quantity::Temperature);
    let first = |name: &str| data.numbers(name)?.iter().copied().find(|value| value.is_finite());
    let firsts = columns.filter_map(|column| Some((column.header.name.as_str(), first(&column.header.name)?)));
    let firsts: Vec<(&str, f64)> = firsts.collect();
    let (cold, others): (Vec<_>, Vec<_>) = firsts.iter().copied().partition(|(_, value)| *value < 0.0);
    if let ([(name, value), ..], []) = (&cold[..], &others[..])
        && cold.iter().all(|(_, value)| AT_REST.contains(&-value))
    {
        return Some(format!(
            "all temperatures begin below 0 °C, as {name} at {value:.1} °C: are their signs turned? A machine at rest is hardly so cold"
        ));
    }
    let mut odd = (0..firsts.len()).filter_map(|place| {
        let (name, value) = firsts[place];
        let others: Vec<f64> =
            (0..firsts.len()).filter(|other| *other != place).map(|other| firsts[other].1).collect();
        let [least, most] = ends(&others)?;
        let is_cold = value < 0.0 && value < least - COLDER;
        let is_odd = AT_REST.contains(&least) && AT_REST.contains(&most) && (is_cold || value > most + WARMER);
        is_odd.then(|| {
            let cause = if is_cold { "is its sign turned" } else { "is it in another unit" };
            format!(
                "{name} begins at {value:.1} °C, and the other temperatures from {least:.1} to {most:.1} °C: is the sensor broken, or \
                 {cause}?"
            )
        })
    });
    odd.next()
}

fn celsius(fahrenheit: f64) -> f64 {
    (fahrenheit - 32.0) / 1.8
}

/// Tells rows of stages whose times are likely in minutes, beside the logs of their machine.
pub(crate) fn tell_minutes(rows: &[(&str, &Dataset)], logs: &[Dataset]) {
    for (stage, rows) in rows {
        let told = logs.iter().find_map(|log| likely_minutes(rows, log));
        told.iter().for_each(|told| tracing::warn!("{stage}: {told}"));
    }
}

/// Rows whose times lie in the first minutes of a log, and would cover it if they were in minutes, in words.
fn likely_minutes(rows: &Dataset, log: &Dataset) -> Option<String> {
    let times = |data: &Dataset| -> Option<Vec<f64>> {
        Some(data.numbers("time")?.iter().copied().filter(|time| time.is_finite()).collect())
    };
    let (own, of_log) = (times(rows)?, times(log)?);
    // Logs one behind the other have a clock each.
    let is_one_clock = of_log.len() > 1 && of_log.windows(2).all(|pair| pair[0] < pair[1]);
    let [from, to] = ends(&own).filter(|_| is_one_clock)?;
    let [first, last] = ends(&of_log)?;
    let fits = MINUTE * from >= first && MINUTE * to <= last && MINUTE * (to - from) > COVERED * (last - first);
    fits.then(|| {
        format!(
            "the times of its rows, {from:.1} s to {to:.1} s, lie in the first minutes of the log of temperatures, which goes to {last:.0} s: \
             are they in minutes? The name `time_min` of the column says it"
        )
    })
}

/// Smallest and largest of some values.
pub(crate) fn ends(values: &[f64]) -> Option<[f64; 2]> {
    let first = *values.first()?;
    Some(values.iter().fold([first; 2], |[least, most], value| [least.min(*value), most.max(*value)]))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Even random numbers from 0 to 1.
    struct Random(u64);

    impl Random {
        fn part(&mut self) -> f64 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 11) as f64 / (1_u64 << 53) as f64
        }
    }

    fn table(text: &str) -> Dataset {
        abbe_table::parse(std::path::Path::new("a.csv"), text.as_bytes()).expect("a table")
    }

    #[test]
    fn a_sensor_below_zero_beside_warm_ones_is_told() {
        for seed in 0..500 {
            let mut random = Random(seed);
            let room = 12.0 + 30.0 * random.part();
            let firsts: Vec<f64> = (0..4).map(|_| room + 4.0 * (random.part() - 0.5)).collect();
            let told = |values: &[f64]| {
                let row =
                    |by: f64| values.iter().map(|value| format!("{:.3}", value + by)).collect::<Vec<_>>().join(",");
                likely_turned(&table(&format!(
                    "time_s,Ta_degC,Tb_degC,Tc_degC,Td_degC\n0,{}\n60,{}\n",
                    row(0.0),
                    row(5.0)
                )))
            };
            assert_eq!(told(&firsts), None);
            let of = |value: f64| [&firsts[..2], &[value], &firsts[3..]].concat();
            assert!(told(&of(-firsts[2])).is_some_and(|told| told.starts_with("Tc begins at -")), "{firsts:?}");
            // Cool water, and a warm spindle.
            assert_eq!(told(&of(4.0)), None);
            assert_eq!(told(&of(room + 60.0)), None);
            assert!(told(&of(room + 70.0)).is_some_and(|told| told.starts_with("Tc begins at ")), "{firsts:?}");
            let turned: Vec<f64> = firsts.iter().map(|value| -value).collect();
            assert!(told(&turned).is_some_and(|told| told.contains("are their signs turned?")), "{firsts:?}");
        }
        // A cold hall, all of it.
        assert_eq!(likely_turned(&table("time_s,Ta_degC,Tb_degC\n0,-2,-1\n60,-1,0\n")), None);
    }

    /// Rooms from 12 to 45 °C, and machines that are some kelvin warmer, in both units.
    #[test]
    fn what_is_in_fahrenheit_is_told_and_what_is_in_celsius_is_not() {
        for seed in 0..500 {
            let mut random = Random(seed);
            let room = 12.0 + 33.0 * random.part();
            let sensors = 1 + (4.0 * random.part()) as usize;
            let firsts: Vec<f64> = (0..sensors).map(|_| room + 4.0 * (random.part() - 0.5)).collect();
            let fahrenheit = |value: &f64| 32.0 + 1.8 * value;
            let with = |values: &[f64]| {
                let names: Vec<String> = (0..sensors).map(|sensor| format!("T{sensor}_degC")).collect();
                let cells =
                    |by: f64| values.iter().map(|value| format!("{:.3}", value + by)).collect::<Vec<_>>().join(",");
                likely_fahrenheit(&table(&format!("time_s,{}\n0,{}\n60,{}\n", names.join(","), cells(0.0), cells(9.0))))
            };
            assert_eq!(with(&firsts), None, "seed {seed}");
            let all: Vec<f64> = firsts.iter().map(fahrenheit).collect();
            assert!(with(&all).expect("told").contains("are they in °F?"), "seed {seed}");
            if sensors > 1 {
                let mut one = firsts.clone();
                one[0] = fahrenheit(&one[0]);
                assert!(with(&one).expect("told").contains("T0 begins at"), "seed {seed}");
            }
        }
        assert_eq!(likely_fahrenheit(&table("time_s,X_mm\n0,68\n1,70\n")), None);
    }

    /// Measurements over most of a log; a clock that begins somewhere.
    #[test]
    fn minutes_that_were_read_as_seconds_are_told() {
        for seed in 0..500 {
            let mut random = Random(1000 + seed);
            let mut part = || random.part();
            let (begin, length) = (600.0 * part(), 3600.0 + 20_000.0 * part());
            let log: String =
                (0..=100).map(|row| format!("{},20\n", begin + length * f64::from(row) / 100.0 - 1200.0)).collect();
            let log = table(&format!("time_s,T_degC\n{log}"));
            let (from, share) = (0.2 * part() * length, 0.6 + 0.15 * part());
            let rows = |unit: f64| {
                let at = |row: i32| (begin + from + share * length * f64::from(row) / 40.0 - 1200.0) / unit;
                let rows: String = (0..=40).map(|row| format!("{},1\n", at(row))).collect();
                likely_minutes(&table(&format!("time_s,X_mm\n{rows}")), &log)
            };
            assert_eq!(rows(1.0), None, "seed {seed}");
            assert!(rows(60.0).expect("told").contains("are they in minutes?"), "seed {seed}");
        }
    }
}
