//! Histories of simulated machines: what is found is what was put in, and nothing else.

use abbe_trend::{Change, Regressor, Series, Settings, State, Target, Test, Uncertain, analyse};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use rand_distr::{Distribution, StandardNormal, Uniform};

/// A machine whose one parameter does something, in units of its standard uncertainty.
struct Machine {
    random: ChaCha8Rng,
    tests: Vec<Test>,
}

impl Machine {
    /// Weekly tests with one to three gaps and two that are bad.
    fn new(seed: u64, weeks: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let absent: Vec<u64> = (0..1 + random.next_u64() % 3).map(|_| 2 + random.next_u64() % (weeks - 3)).collect();
        let bad: Vec<u64> = (0..2).map(|_| 2 + random.next_u64() % (weeks - 3)).collect();
        let test = |week: u64| Test { label: week.to_string(), at: week as f64, good: !bad.contains(&week) };
        let tests = (1..=weeks).filter(|week| !absent.contains(week)).map(test).collect();
        Self { random, tests }
    }

    fn uniform(&mut self, low: f64, high: f64) -> f64 {
        Uniform::new(low, high).map_or(low, |uniform| uniform.sample(&mut self.random))
    }

    /// A series that follows `truth`, with uncertainties between 0.8 and 1.5; a bad test is far off.
    fn series(&mut self, truth: impl Fn(f64) -> f64, exact_target: bool) -> Series {
        let tests = self.tests.clone();
        let value = |test: &Test| {
            let uncertainty = self.uniform(0.8, 1.5);
            let noise: f64 = StandardNormal.sample(&mut self.random);
            let value = truth(test.at) + uncertainty * noise + if test.good { 0.0 } else { 50.0 };
            Some(Uncertain { value, standard_uncertainty: uncertainty })
        };
        Series {
            name: "EC0Y".into(),
            unit: "rad".into(),
            values: tests.iter().map(value).collect(),
            shared: 0.0,
            target: exact_target.then_some(Target { value: 0.0, standard_uncertainty: 0.0 }),
            regressor: None,
            again: None,
            derived: false,
        }
    }

    fn judged(&self, series: Series) -> (State, Change) {
        let none = vec![None; self.tests.len()];
        let settings = Settings { target_at: Some(0.0), ..Settings::default() };
        let found = analyse("week", &self.tests, &[series], &none, &[], &settings);
        (found.parameters[0].state, found.parameters[0].change)
    }
}

/// Whether a value agrees with the truth within so many of its standard uncertainties.
fn agrees(found: Uncertain, truth: f64, factor: f64) -> bool {
    (found.value - truth).abs() <= factor * found.standard_uncertainty
}

#[test]
fn machines_in_control_change_in_few_cases() {
    // 700 machines each, decided at 0.001 for every form: a few by chance, never two percent. Three charts of 370 alarm in a fifth of 40
    // weeks; what counts of it scatters more than chance makes, at 0.001 again.
    for exact in [true, false] {
        let (mut changed, mut alarmed, mut watched) = (0, 0, 0);
        for seed in 0..700 {
            let mut machine = Machine::new(seed, 40);
            let series = machine.series(|_| 0.0, exact);
            let state = machine.judged(series).0;
            changed += usize::from(state == State::Changed);
            alarmed += usize::from(state == State::Alarm);
            watched += usize::from(state == State::Unconfirmed);
        }
        assert!(changed <= 9 && alarmed <= 4, "{changed} changed, {alarmed} alarmed of 700");
        assert!((35..280).contains(&watched), "{watched} of 700");
    }
}

/// What no form explains counts where all tests together scatter more than chance makes: a machine that wanders about.
#[test]
fn a_machine_that_wanders_is_in_alarm() {
    let mut told = 0;
    for seed in 4000..4200 {
        let mut machine = Machine::new(seed, 40);
        let phase = machine.uniform(0.0, 6.0);
        let series = machine.series(|at| 3.0 * (at / 4.0 * std::f64::consts::TAU + phase).sin(), true);
        told += usize::from(matches!(machine.judged(series).0, State::Alarm | State::Changed));
    }
    assert!(told >= 198, "{told} of 200");
}

#[test]
fn a_crash_is_found_in_its_week() {
    let (mut weeks, mut sizes) = (0, 0);
    for seed in 1000..1200 {
        let mut machine = Machine::new(seed, 40);
        let (week, size) = (machine.uniform(6.0, 40.0).floor(), machine.uniform(8.0, 30.0));
        let series = machine.series(|at| if at >= week { size } else { 0.0 }, seed % 2 == 0);
        let (_, Change::Step { size: found, first, earliest, latest }) = machine.judged(series) else {
            panic!("seed {seed}: no step in week {week}");
        };
        // A week without a good test hides when it was: the first good test after it shows it.
        let next = machine.tests.iter().position(|test| test.good && test.at >= week).unwrap();
        weeks += usize::from(first == next);
        assert!(earliest <= next && next <= latest, "seed {seed}");
        sizes += usize::from(agrees(found, size, 3.0));
    }
    assert!(weeks >= 198 && sizes >= 196, "{weeks} weeks, {sizes} sizes of 200");
}

#[test]
fn wear_is_a_line_and_settling_comes_to_rest() {
    let (mut lines, mut rates, mut curves, mut sizes) = (0, 0, 0, 0);
    for seed in 2000..2200 {
        let mut machine = Machine::new(seed, 40);
        let sign = if seed % 2 == 0 { 1.0 } else { -1.0 };
        let rate = sign * machine.uniform(0.3, 1.0);
        let series = machine.series(|at| rate * at, seed % 3 != 0);
        if let (_, Change::Line { rate: found }) = machine.judged(series) {
            lines += 1;
            rates += usize::from(agrees(found, rate, 3.0));
        }
        let mut machine = Machine::new(seed + 10_000, 40);
        let (size, time) = (sign * machine.uniform(9.0, 20.0), machine.uniform(3.0, 9.0));
        let series = machine.series(|at| size * (1.0 - (-at / time).exp()), true);
        if let (_, Change::Exponential { amplitude, time_constant }) = machine.judged(series) {
            curves += 1;
            sizes += usize::from(agrees(amplitude, size, 3.0) && agrees(time_constant, time, 3.0));
        }
    }
    assert!(lines >= 196 && rates >= lines - 4, "{lines} lines, {rates} rates of 200");
    assert!(curves >= 190 && sizes >= curves - 6, "{curves} curves, {sizes} sizes of 200");
}

/// Without the temperature a season looks like a change; with it, it is none, and a crash in it is found all the same.
#[test]
fn a_season_needs_its_temperature() {
    let (mut seasonal, mut within, mut followed, mut crashes) = (0, 0, 0, 0);
    for seed in 3000..3200 {
        let mut machine = Machine::new(seed, 40);
        let coefficient = machine.uniform(1.5, 3.0);
        let (phase, scatter) = (machine.uniform(0.0, 6.0), machine.uniform(0.2, 0.5));
        let noise: Vec<f64> = (0..50).map(|_| machine.uniform(-1.0, 1.0) * scatter).collect();
        let temperature = |at: f64| 20.0 + 3.0 * (at / 52.0 * std::f64::consts::TAU + phase).sin() + noise[at as usize];
        let regressor = |declared: bool, tests: &[Test]| Regressor {
            name: "T01".into(),
            unit: "K".into(),
            reference: 20.0,
            values: tests.iter().map(|test| Some(temperature(test.at))).collect(),
            declared,
        };
        let truth = |at: f64| coefficient * (temperature(at) - 20.0);
        let series = machine.series(truth, true);
        let with = Series { regressor: Some(regressor(true, &machine.tests)), ..series.clone() };
        let none = vec![None; machine.tests.len()];
        let found = analyse("week", &machine.tests, &[with], &none, &[], &Settings::default());
        seasonal += usize::from(found.parameters[0].state != State::Changed);
        let line = found.parameters[0].seasonal.clone().unwrap();
        within += usize::from(agrees(line.coefficient, coefficient, 3.0));
        let tried = Series { regressor: Some(regressor(false, &machine.tests)), ..series };
        followed += usize::from(matches!(machine.judged(tried), (State::Changed, Change::Regressor { .. })));
        let week = 12.0 + (seed % 20) as f64;
        let crash = machine.series(|at| truth(at) + if at >= week { 12.0 } else { 0.0 }, true);
        let crash = Series { regressor: Some(regressor(true, &machine.tests)), ..crash };
        crashes += usize::from(matches!(machine.judged(crash), (State::Changed, Change::Step { .. })));
    }
    assert!(seasonal >= 197 && within >= 196, "{seasonal} seasonal, {within} within 3 u");
    assert!(followed >= 180 && crashes >= 190, "{followed} follow the temperature, {crashes} crashes");
}

/// What all tests share does not scatter: it makes no step at the first test, and hides none later.
#[test]
fn a_wrong_bar_is_no_change() {
    let (mut changed, mut found) = (0, 0);
    for seed in 4000..4200 {
        let mut machine = Machine::new(seed, 40);
        let bar: f64 = 2.0 * {
            let noise: f64 = StandardNormal.sample(&mut machine.random);
            noise
        };
        let shared = |series: Series| Series {
            shared: 2.0,
            values: (series.values.iter())
                .map(|value| {
                    value
                        .map(|value| Uncertain { standard_uncertainty: value.standard_uncertainty.hypot(2.0), ..value })
                })
                .collect(),
            ..series
        };
        let series = shared(machine.series(|_| bar, true));
        changed += usize::from(machine.judged(series).0 == State::Changed);
        let series = shared(machine.series(|at| bar + if at >= 20.0 { 4.0 } else { 0.0 }, true));
        found += usize::from(matches!(machine.judged(series).1, Change::Step { .. }));
    }
    assert!(changed <= 3 && found >= 196, "{changed} changed, {found} of 200 found");
}
