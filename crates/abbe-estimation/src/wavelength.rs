//! The wavelengths that data may have: a sum of squares over a wavelength has many minima, and an iteration ends in the nearest.

use abbe_core::{Owner, ParameterRole, PeriodicError, Problem, Result, RowIndex, SetIndex, Unit, Unknown, in_parallel};

use crate::separation::spread_out;
use crate::weighted::Weighted;

/// Part of the nominal wavelength on either side within which the true one is looked for.
const RANGE: f64 = 0.05;

/// Rows that are looked at: enough for the few amplitudes of a wave.
const ROWS: usize = 300;

/// Steps to one wave more or less over all positions, which is half the width of a minimum.
const STEPS: f64 = 3.0;

/// Difference of sums of squares, in units of the scatter, up to which wavelengths explain the data alike.
const ALIKE: f64 = 16.0;

/// Minima that are refined, the lowest first; most steps of that, and the part of a step between two tries that is left.
const REFINED: usize = 8;
const REFINEMENTS: usize = 24;
const PRECISION: f64 = 1e-6;

/// Most wavelengths that are tried on either side.
const MOST: usize = 5_000;

/// A wavelength at which the sum of squares has a minimum.
#[derive(Debug, Clone, PartialEq)]
pub struct Wavelength {
    /// The wavelength, in its unit.
    pub value: f64,
    /// The amplitudes that go with it: index of the parameter and value.
    pub amplitudes: Vec<(usize, f64)>,
    /// Weighted sum of squares that is left.
    pub cost: f64,
    /// Whether it explains the data as the best one does: within four standard deviations of the scatter that is left.
    pub alike: bool,
}

/// The wavelengths within a twentieth of the nominal one at which the sum of squares has a minimum, the best first (of those that are
/// alike, the one next to the nominal one); `shape` is the index of the parameter, and all others have their present values but for the
/// amplitudes. Empty where the parameter is no wavelength, or no row tells it. Fails where the rows cannot be evaluated.
///
/// Frequencies are tried in steps of a third of a wave over all positions of the axis, or of its highest overtone; minima are two waves
/// wide (the periodogram of Lomb 1976). The lowest are refined.
pub fn wavelengths(problem: &Problem, shape: usize) -> Result<Vec<Wavelength>> {
    let info = problem.model.info();
    let of_shape =
        |period: &&PeriodicError| period.shapes.contains(&shape) && info.parameters[shape].role == ParameterRole::Shape;
    let periods: Vec<&PeriodicError> = info.periods.iter().filter(of_shape).collect();
    let Some(axis) = periods.first().map(|period| period.axis) else { return Ok(Vec::new()) };
    let mut waves = problem.clone();
    let amplitude = |unknown: &Unknown| {
        unknown.owner == Owner::Machine && periods.iter().any(|period| period.parameters.contains(&unknown.index))
    };
    waves.unknowns.retain(amplitude);
    if waves.unknowns.is_empty() {
        return Ok(Vec::new());
    }
    for unknown in &waves.unknowns {
        waves.machine_values[unknown.index] = 0.0;
    }
    let overtones = waves.unknowns.len().div_ceil(2) as f64;
    let Some(travel) = keep_telling_rows(&mut waves, info.axes[axis].status)? else { return Ok(Vec::new()) };
    let redundancy = waves.equations().saturating_sub(waves.unknowns.len()).max(1) as f64;
    let nominal = info.nominal[shape];
    let alone = of_waves_alone(&waves)?;
    let tried_at = |frequency: f64| -> Result<Option<Wavelength>> {
        let (value, mut waves) = (1.0 / frequency, alone.clone());
        waves.machine_values[shape] = value;
        let factor = Weighted::new(&waves)?.factor(&waves.start(), None)?;
        let step = factor.step();
        Ok(step.map(|step| {
            let amplitudes = waves.unknowns.iter().zip(step).map(|(unknown, size)| (unknown.index, size)).collect();
            Wavelength { value, amplitudes, cost: factor.remaining_cost(), alike: false }
        }))
    };
    // The amplitudes of overtones make minima narrower.
    let step = 1.0 / travel / STEPS / overtones;
    // Of a long way and a short wave the nearest wavelengths only.
    let range = (RANGE / nominal).min(step * MOST as f64);
    let count = (range / step).ceil().max(1.0) as i64;
    let frequency = |place: i64| 1.0 / nominal + range * place as f64 / count as f64;
    let all: Vec<i64> = (-count..=count).collect();
    let tried =
        in_parallel(&all, None, |place| Ok(tried_at(frequency(*place))?.map(|found| (frequency(*place), found))));
    let tried: Vec<(f64, Wavelength)> = tried.into_iter().filter_map(Result::transpose).collect::<Result<_>>()?;
    let lowest = |place: usize| {
        let beside = [place.checked_sub(1), Some(place + 1)].into_iter().flatten();
        beside.filter_map(|other| tried.get(other)).all(|(_, other)| tried[place].1.cost <= other.cost)
    };
    let mut places: Vec<usize> = (0..tried.len()).filter(|&place| lowest(place)).collect();
    places.sort_by(|&one, &other| tried[one].1.cost.total_cmp(&tried[other].1.cost));
    places.truncate(REFINED);
    let minima = in_parallel(&places, None, |&place| {
        let (middle, found) = &tried[place];
        let ends = [(middle - step).max(frequency(-count)), (middle + step).min(frequency(count))];
        refined(*middle, ends, found.clone(), PRECISION * step, tried_at)
    });
    let mut minima: Vec<Wavelength> = minima.into_iter().collect::<Result<_>>()?;
    let best = minima.iter().map(|minimum| minimum.cost).fold(f64::INFINITY, f64::min);
    let scatter = best / redundancy;
    minima.iter_mut().for_each(|minimum| minimum.alike = minimum.cost - best <= ALIKE * scatter);
    // Of those that the data do not tell apart, the one that was expected.
    let off = |minimum: &Wavelength| (minimum.value / nominal - 1.0).abs();
    minima.sort_by(|one, other| {
        let order = other.alike.cmp(&one.alike);
        let (by_cost, by_place) = (one.cost.total_cmp(&other.cost), off(one).total_cmp(&off(other)));
        order.then(if one.alike && other.alike { by_place } else { by_cost })
    });
    Ok(minima)
}

/// The same problem for a machine without errors, which is evaluated in a fraction of the time, with the same residuals. What
/// amplitudes do there differs by products of errors.
fn of_waves_alone(waves: &Problem) -> Result<Problem> {
    let info = waves.model.info();
    let mut alone = waves.clone();
    for (value, (parameter, nominal)) in
        alone.machine_values.iter_mut().zip(info.parameters.iter().zip(info.without_errors()))
    {
        if parameter.role != ParameterRole::Shape {
            *value = nominal;
        }
    }
    let (as_is, without) = (waves.residuals(&waves.start())?, alone.residuals(&alone.start())?);
    let errors: Vec<f64> = as_is.iter().zip(without).map(|(as_is, without)| as_is - without).collect();
    Ok(alone.disturbed(&errors))
}

/// The minimum between two frequencies, from one between them on: parabolas through the last three, and a golden section where they lead
/// nowhere (Brent 1973, chapter 5).
fn refined(
    middle: f64,
    [mut low, mut high]: [f64; 2],
    found: Wavelength,
    precision: f64,
    tried_at: impl Fn(f64) -> Result<Option<Wavelength>>,
) -> Result<Wavelength> {
    const GOLDEN: f64 = 0.381_966_011_250_105_1;
    let (mut best, mut at) = (found, middle);
    // The second and third best frequency with what is left there.
    let (mut second, mut third) = ((at, best.cost), (at, best.cost));
    let (mut step, mut before) = (0.0_f64, 0.0_f64);
    for _ in 0..REFINEMENTS {
        let centre = f64::midpoint(low, high);
        if (at - centre).abs() <= 2.0 * precision - 0.5 * (high - low) {
            break;
        }
        let by_parabola = parabola((at, best.cost), second, third).filter(|step| {
            let (next, halves) = (at + step, step.abs() < 0.5 * before.abs());
            halves && next - low >= 2.0 * precision && high - next >= 2.0 * precision
        });
        before = if by_parabola.is_some() { step } else { if at < centre { high - at } else { low - at } };
        step = by_parabola.unwrap_or(GOLDEN * before);
        let next = at + if step.abs() < precision { precision.copysign(step) } else { step };
        let Some(other) = tried_at(next)? else { break };
        if other.cost < best.cost {
            *(if next > at { &mut low } else { &mut high }) = at;
            (third, second) = (second, (at, best.cost));
            (at, best) = (next, other);
        } else {
            *(if next > at { &mut high } else { &mut low }) = next;
            if other.cost <= second.1 || second.0 == at {
                (third, second) = (second, (next, other.cost));
            } else if other.cost <= third.1 || third.0 == at || third.0 == second.0 {
                third = (next, other.cost);
            }
        }
    }
    Ok(best)
}

/// The step from the first of three places to the lowest of the parabola through their values; None if they are on a line.
fn parabola((at, value): (f64, f64), second: (f64, f64), third: (f64, f64)) -> Option<f64> {
    let left = (at - second.0) * (value - third.1);
    let right = (at - third.0) * (value - second.1);
    let step = ((at - third.0) * right - (at - second.0) * left) / (2.0 * (left - right));
    step.is_finite().then_some(step)
}

/// A sentence on wavelengths that explain the data as well as the one that is taken; none if there is no other.
pub fn rival_wavelengths(unknown: &Unknown, minima: &[Wavelength]) -> Option<String> {
    let (symbol, factor) = match unknown.unit {
        Unit::MM => ("mm", 1.0),
        Unit::RAD => ("deg", 1.0_f64.to_degrees()),
        _ => ("", 1.0),
    };
    let alike = minima.iter().filter(|minimum| minimum.alike);
    let alike: Vec<String> = alike.map(|minimum| format!("{:.6} {symbol}", minimum.value * factor)).collect();
    let [taken, others @ ..] = alike.as_slice() else { return None };
    (!others.is_empty()).then(|| {
        format!(
            "{} may also be {}, which explain the data as well as {taken} does: the uncertainty is that of this one alone; measure in \
             steps that are no multiple of any of them",
            unknown.name,
            others.join(" or ")
        )
    })
}

/// Leaves those rows that amplitudes have an effect on, not all of many; gives the range of the axis over them, none if there are none.
fn keep_telling_rows(problem: &mut Problem, status: usize) -> Result<Option<f64>> {
    let (rows, count) = (problem.equation_rows(), problem.unknowns.len());
    let mut telling: Vec<(SetIndex, RowIndex)> = Vec::new();
    problem.linearise(&problem.start(), |block| {
        for (equation, _, line) in block.lines() {
            let row = rows[equation];
            if line.iter().any(|derivative| *derivative != 0.0) && telling.last() != Some(&row) {
                telling.push(row);
            }
        }
    })?;
    let kept: Vec<(SetIndex, RowIndex)> =
        spread_out(telling.len(), ROWS).into_iter().map(|place| telling[place]).collect();
    let (mut first, mut last) = (f64::INFINITY, f64::NEG_INFINITY);
    for (index, set) in SetIndex::enumerate(&mut problem.sets) {
        set.rows = kept.iter().filter(|(of, _)| *of == index).map(|(_, row)| *row).collect();
        for pose in set.poses_of(&set.rows) {
            let position = set.poses().row(pose)[status];
            (first, last) = (first.min(position), last.max(position));
        }
    }
    Ok(Some(last - first).filter(|travel| *travel > 0.0 && kept.len() > count))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The lowest place of curves that are no parabolas, in a few tries.
    #[test]
    fn a_minimum_is_refined_to_its_precision() {
        let tried = std::cell::Cell::new(0);
        for case in 0..400 {
            let lowest = 0.05 + 0.9 * f64::from(case) / 400.0;
            let cost = |place: f64| match case % 4 {
                0 => (place - lowest).powi(2),
                1 => (3.0 * (place - lowest)).cosh(),
                2 => (place - lowest).exp() - place,
                _ => (place - lowest).abs().powf(1.5),
            };
            let at = |place: f64| Wavelength { value: place, amplitudes: Vec::new(), cost: cost(place), alike: false };
            let tried_at = |place: f64| {
                assert!((0.0..=1.0).contains(&place), "{place}");
                tried.set(tried.get() + 1);
                Ok(Some(at(place)))
            };
            let found = refined(0.5, [0.0, 1.0], at(0.5), 1e-6, tried_at).unwrap();
            assert!((found.value - lowest).abs() < 1e-5, "case {case}: {} for {lowest}", found.value);
            let beside = [found.value - 1e-5, found.value + 1e-5].map(|place| cost(place.clamp(0.0, 1.0)));
            assert!(beside.iter().all(|cost| *cost >= found.cost - 1e-12), "case {case}");
        }
        assert!(tried.get() < 400 * 20, "{}", tried.get());
    }
}
