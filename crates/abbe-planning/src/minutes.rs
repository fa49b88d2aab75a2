//! The best plan whose measuring program takes no longer than a time.
//!
//! What a program takes is no sum over candidates: rotary axes swing from one indexation to the next. So designs are searched for a
//! ladder of sums, each candidate costing its own touches and a usual way to it, and the program of each is timed. The ladder does not
//! depend on the time that is allowed, and the best design within it is taken: more time is therefore never worse.

use abbe_core::Result;
use abbe_measuring::Timing;
use abbe_numerics::DesignProblem;

use crate::settings::Planning;
use crate::until::{is_enough, out_of_reach, reached, reached_by};
use crate::{Ground, Plan, best, searched, too_few, wrong};

/// A step of the ladder.
const STEP: f64 = 1.06;

/// Random starts of each step, at most.
const TRIALS: usize = 4;

/// The ladder ends where a program takes so many times what is allowed.
const BEYOND: f64 = 1.3;

/// Steps that a ladder has at most.
const STEPS: usize = 400;

/// Candidates of the list, so far apart, between which a usual way is taken: parts of the list.
const APART: [f64; 3] = [0.0, 0.25, 0.5];

/// A design with its program's time.
struct Timed {
    value: f64,
    seconds: f64,
    repeats: usize,
    design: Vec<usize>,
    searches: usize,
}

/// The best plan whose program takes so many minutes at most; where an uncertainty is wanted, the shortest one that reaches it.
///
/// Fails if none does, with what the shortest takes that determines all unknowns.
pub fn within(problem: &abbe_core::Problem, wanted: &Planning, minutes: f64, timing: &Timing<'_>) -> Result<Plan> {
    let allowed = 60.0 * minutes;
    let mut ground = Ground::new(problem, wanted)?;
    let touches = touches(&ground);
    forbid_unreached(&mut ground, &touches, timing)?;
    ground.check(&ground.choice(None))?;
    let repeats = match &wanted.repeats {
        Some(repeats) if repeats.times.is_none() => 1..=repeats.most.get(),
        _ => wanted.stated_repeats()..=wanted.stated_repeats(),
    };
    let mut all: Vec<Timed> = Vec::new();
    for repeats in repeats {
        ground = ground.repeated(repeats)?;
        let costs = costs(&touches, timing, repeats)?;
        ground.found.iter_mut().zip(costs).for_each(|(candidate, cost)| candidate.duration = cost);
        all.extend(ladder(&ground, &touches, timing, allowed)?);
    }
    let shortest = all.iter().map(|timed| timed.seconds).fold(f64::INFINITY, f64::min);
    all.retain(|timed| timed.seconds <= allowed);
    if all.is_empty() {
        let error = too_few(wanted, problem.unknowns.len());
        return Err(match shortest.is_finite() {
            true => error.help(format!("the shortest program that was found takes {:.1} minutes", shortest / 60.0)),
            false => error,
        });
    }
    match &wanted.until {
        // Best first; of those that are as good, the shortest.
        None => all.sort_by(|one, other| other.value.total_cmp(&one.value).then(one.seconds.total_cmp(&other.seconds))),
        Some(_) => {
            all.sort_by(|one, other| one.seconds.total_cmp(&other.seconds).then(other.value.total_cmp(&one.value)))
        }
    }
    let mut nearest: Option<Plan> = None;
    for timed in &all {
        ground = ground.repeated(timed.repeats)?;
        let choice = ground.choice(None);
        if let Some(until) = &wanted.until {
            let Some(figures) = ground.figures(&choice, &timed.design) else { continue };
            let found = reached((&figures, &timed.design, &ground), until)?;
            if !is_enough(&found) {
                if nearest.as_ref().is_none_or(|best| found.ratio() < ratio(best)) {
                    let mut plan = ground.plan(&choice, &timed.design, timed.searches)?;
                    plan.reached = Some(found);
                    nearest = Some(plan);
                }
                continue;
            }
        }
        let mut plan = ground.plan(&choice, &timed.design, timed.searches)?;
        // Going back to references, and an order against drift, take time of their own.
        if let Some(order) = &plan.order {
            let rows: Vec<usize> = order.rows.iter().map(|(row, _)| row.0).collect();
            if timing.seconds(&rows, true, timed.repeats)? > allowed {
                continue;
            }
        }
        let until = wanted.until.as_ref();
        plan.reached = until.map(|until| reached_by(&plan, (&timed.design, &ground), until)).transpose()?;
        if plan.reached.as_ref().is_none_or(is_enough) {
            return Ok(plan);
        }
        if nearest.as_ref().is_none_or(|best| ratio(&plan) < ratio(best)) {
            nearest = Some(plan);
        }
    }
    match nearest {
        Some(plan) => Err(out_of_reach(&plan)),
        None => Err(wrong("minutes", "no order of measurements fits into this time")
            .help("allow more, or fewer `references`, or a smaller number of `times`")),
    }
}

/// What a plan reaches as a part of what was wanted.
fn ratio(plan: &Plan) -> f64 {
    plan.reached.as_ref().map_or(f64::INFINITY, |reached| reached.ratio())
}

/// The touches of each candidate: places of its rows in the data.
fn touches(ground: &Ground<'_>) -> Vec<Vec<usize>> {
    let set = ground.contact.set_named(&ground.wanted.candidates);
    let layout = set.map(|set| &ground.contact.sets[set].info().layout);
    let of_rows = |rows: &Vec<abbe_core::RowIndex>| {
        let data_row = |row: &abbe_core::RowIndex| layout.and_then(|layout| layout.rows[*row].data_row);
        rows.iter().filter_map(data_row).map(|row| row.0).collect()
    };
    ground.found.iter().map(|candidate| of_rows(&candidate.rows)).collect()
}

/// Forbids candidates of which the program cannot make the touches: one of them where it refuses such a plan, else all.
fn forbid_unreached(ground: &mut Ground<'_>, touches: &[Vec<usize>], timing: &Timing<'_>) -> Result<()> {
    let refuses =
        ground.wanted.program.as_ref().is_none_or(|program| program.unreachable == abbe_measuring::Unreachable::Refuse);
    let (mut forbidden, mut first) = (0, None);
    for (candidate, touches) in ground.found.iter_mut().zip(touches) {
        let refusals = touches.iter().map(|&touch| timing.refusal(touch)).collect::<Result<Vec<Option<String>>>>()?;
        let unreached = refusals.iter().flatten().count();
        if unreached == touches.len() || (refuses && unreached > 0) {
            forbidden += usize::from(!candidate.forbidden);
            first = first.or_else(|| Some(format!("{}: {}", candidate.label, refusals.into_iter().flatten().next()?)));
            candidate.forbidden = true;
            candidate.required = 0;
        }
    }
    if let Some(first) = first.filter(|_| forbidden > 0) {
        let of = ground.found.len();
        tracing::warn!(
            "{forbidden} of {of} candidates are not chosen, because the program cannot make their touches: {first}"
        );
    }
    Ok(())
}

/// What each candidate costs, s: its own touches, and usual ways to other ones.
fn costs(touches: &[Vec<usize>], timing: &Timing<'_>, repeats: usize) -> Result<Vec<f64>> {
    let of = |touches: &[usize]| timing.seconds(touches, false, repeats);
    let alone = touches.iter().map(|touches| of(touches)).collect::<Result<Vec<f64>>>()?;
    let count = touches.len();
    let mut costs = Vec::with_capacity(count);
    for (index, own) in touches.iter().enumerate() {
        let (mut ways, mut tried) = (0.0, 0.0);
        for part in APART {
            let other = (index + 1 + (part * count as f64) as usize) % count;
            if other != index && alone[other] > 0.0 {
                ways += (of(&[own.as_slice(), &touches[other]].concat())? - alone[index] - alone[other]).max(0.0);
                tried += 1.0;
            }
        }
        // A candidate that takes no time at all would be chosen without end.
        costs.push((alone[index] + ways / f64::max(tried, 1.0)).max(1e-3));
    }
    Ok(costs)
}

/// Designs for more and more time, until their programs take longer than is allowed by far, or nothing is left to choose.
fn ladder(ground: &Ground<'_>, touches: &[Vec<usize>], timing: &Timing<'_>, allowed: f64) -> Result<Vec<Timed>> {
    let wanted = ground.wanted;
    let every: f64 = ground.found.iter().filter(|one| !one.forbidden).map(|one| one.duration).sum();
    let mut sum = least(ground, &ground.choice(None));
    let mut all: Vec<Timed> = Vec::new();
    let restarts = TRIALS.min(wanted.restarts.get());
    for _ in 0..STEPS {
        let choice = ground.choice(Some(sum));
        let designs = searched(&choice, restarts, wanted.seed);
        let found = best(&designs).filter(|best| best.value > f64::NEG_INFINITY);
        if let Some(design) = found.filter(|design| choice.figures(&design.chosen).is_some()) {
            let known = all.last().is_some_and(|last| last.design == design.chosen);
            let rows: Vec<usize> = design.chosen.iter().flat_map(|&index| touches[index].iter().copied()).collect();
            let seconds = timing.seconds(&rows, false, ground.repeats)?;
            if !known {
                let alike = designs
                    .iter()
                    .filter(|other| (other.value - design.value).abs() <= 1e-6 * design.value.abs().max(1.0));
                let searches = alike.count();
                let (value, repeats) = (design.value, ground.repeats);
                all.push(Timed { value, seconds, repeats, design: design.chosen.clone(), searches });
            }
            let number = wanted.number.is_some_and(|number| design.chosen.len() >= number.get());
            if seconds > BEYOND * allowed || (number && sum > every) {
                break;
            }
        }
        if sum > every && !wanted.replications {
            break;
        }
        sum *= STEP;
    }
    Ok(all)
}

/// The smallest sum for which there may be enough equations: the cheapest ones.
fn least(ground: &Ground<'_>, choice: &DesignProblem) -> f64 {
    let required: f64 = ground.found.iter().map(|one| one.duration * one.required as f64).sum();
    let missing = choice.unknowns.saturating_sub(ground.scaled.measured_rows);
    let mut offers: Vec<(f64, usize)> = ground
        .found
        .iter()
        .filter(|one| !one.forbidden && !one.equations.is_empty())
        .map(|one| (one.duration, one.equations.len()))
        .collect();
    offers.sort_by(|one, other| (one.0 / one.1 as f64).total_cmp(&(other.0 / other.1 as f64)));
    let (mut sum, mut equations) = (0.0, 0);
    for (cost, of) in offers {
        if equations >= missing && sum > 0.0 {
            break;
        }
        sum += cost;
        equations += of;
    }
    sum.max(required)
}
