//! The usual mistakes of a set-up, tried one by one: which of them explains residuals, or errors that no machine has?

use std::f64::consts::PI;

use abbe_core::{Axis, AxisKind, ModelInfo, Monitor, ObservationSet, Problem, Quantity, Result, StatusRole};
use abbe_numerics::{End, Options, solve_from};

use crate::plausibility::large_errors_at;
use crate::plausible::Plausible;
use crate::reading_units::other_units;
use crate::separation::spread_out;
use crate::weighted::Weighted;

/// Makes of a status what it is without a mistake.
type Correction = Box<dyn Fn(&mut [f64])>;

/// A mistake in recorded commands.
struct Mistake {
    /// `with B negated`.
    without: String,
    correct: Correction,
    /// For a unit: the axes that are read in it, and the factor that corrects them.
    scaled: Option<(Vec<usize>, f64)>,
}

/// Iterations of a trial: what is right converges in a few.
const ITERATIONS: usize = 15;

/// Most rows of a set that mistakes are tried on, unless there are many unknowns.
const ROWS: usize = 500;

/// A mistake explains the residuals if these fall to less than this part.
const FALLS: f64 = 0.3;

/// It explains implausible errors if residuals do not become larger than this many times.
const STAYS: f64 = 1.5;

/// Median of the residuals in standard uncertainties from which a fit is no good.
const GOOD: f64 = 5.0;

/// Residuals, mm and rad, that no right correction leaves: those of machines are far smaller.
const LEFT: [f64; 2] = [1.0, 10e-3];

/// Part of the travel that recorded commands cover if they are not too large by a unit.
const COVERED: f64 = 0.1;

/// Most mistakes that are told.
const TOLD: usize = 2;

/// Sentences on the mistakes that explain a problem best, the best first; none if none does.
///
/// `plausible` tells which errors are none. Only mistakes in what was recorded are tried: signs, swapped columns, units; of readings the
/// units with which they scatter from row to row as stated.
pub fn likely_mistakes(problem: &Problem, plausible: &Plausible) -> Result<Vec<String>> {
    // Some rows tell a sign or a unit as well as all.
    let quiet = spread(problem, ROWS).watched_by(Monitor::default());
    let (as_it_is, as_recorded) = (Trial::new(&quiet, plausible), off(&quiet));
    let mut found = Vec::new();
    let explains = |trial: &Trial| match &as_it_is {
        None => trial.is_plausible,
        Some(now) if now.is_plausible => trial.is_plausible && trial.median < FALLS * now.median,
        Some(now) => trial.is_plausible && { trial.median < STAYS * now.median || trial.in_uncertainties < GOOD },
    };
    for (without, added) in other_units(problem, &quiet) {
        problem.monitor.check()?;
        let trial = Trial::new(&quiet.disturbed(&added), plausible).filter(|trial| trial.in_uncertainties < GOOD);
        found.extend(trial.filter(&explains).map(|trial| (without, trial)));
    }
    for Mistake { without, correct, scaled } in mistakes(quiet.model.info()) {
        // Whoever watches the work can end it here.
        problem.monitor.check()?;
        if scaled.is_some_and(|(axes, factor)| factor < 1.0 && cover_their_travel(&quiet, &axes)) {
            continue;
        }
        let other = with_commands(&quiet, correct);
        // Anything fits well where all lengths are a thousand times shorter, but not at the places that are nominal.
        if off(&other).is_none_or(|off| as_recorded.is_some_and(|recorded| off >= recorded)) {
            continue;
        }
        let Some(trial) = Trial::new(&other, plausible).filter(Trial::is_of_a_machine) else { continue };
        if explains(&trial) {
            found.push((without, trial));
        }
    }
    found.sort_by(|(_, a), (_, b)| a.median.total_cmp(&b.median));
    let least = found.first().map_or(0.0, |(_, trial)| trial.median);
    let sentence = |(without, trial): (String, Trial)| match &as_it_is {
        Some(now) if trial.median < FALLS * now.median => {
            format!("{without} the residuals fall from {} to {}", now.size(), trial.size())
        }
        Some(_) => format!("{without} all errors are plausible, and the residuals are {}", trial.size()),
        None => format!("{without} the fit succeeds, and the residuals are {}", trial.size()),
    };
    let near = found.into_iter().filter(|(_, trial)| trial.median <= 3.0 * least + 1e-6);
    Ok(near.take(TOLD).map(sentence).collect())
}

/// The problem with at most so many rows of every set, or all that it takes to determine its unknowns.
pub(crate) fn spread(problem: &Problem, rows: usize) -> Problem {
    let mut few = problem.clone();
    let most = rows.max(4 * problem.unknowns.len());
    for set in &mut few.sets {
        set.rows = spread_out(set.rows.len(), most).into_iter().map(|place| set.rows[place]).collect();
    }
    few
}

/// How far the nominal machine is off at the recorded commands, the median of lengths (of angles where there are none).
fn off(problem: &Problem) -> Option<f64> {
    let residuals = problem.residuals(&problem.start()).ok()?;
    median(of_main_quantity(residuals, problem.quantities()).1)
}

/// The residuals of lengths, or of angles where there are no lengths.
fn of_main_quantity(residuals: Vec<f64>, quantities: Vec<Quantity>) -> (Quantity, Vec<f64>) {
    let main = if quantities.contains(&Quantity::Length) { Quantity::Length } else { Quantity::Angle };
    let of_main = residuals.into_iter().zip(quantities).filter(|(_, quantity)| *quantity == main);
    (main, of_main.map(|(residual, _)| residual).collect())
}

/// A fit by plain least squares, from the nominal machine.
struct Trial {
    /// Median size of the residuals of lengths, or of angles where there are no lengths, mm or rad.
    median: f64,
    quantity: Quantity,
    /// The same of all residuals in standard uncertainties.
    in_uncertainties: f64,
    is_plausible: bool,
}

impl Trial {
    /// None if there is no solution.
    fn new(problem: &Problem, plausible: &Plausible) -> Option<Self> {
        let weighted = Weighted::new(problem).ok()?;
        let options = Options { iterations: ITERATIONS, tolerance: 1e-3, ..Options::USUAL };
        let solution = solve_from(&weighted, &problem.start(), None, &options).ok()?;
        if solution.end == End::NoProgress && !solution.x.iter().all(|value| value.is_finite()) {
            return None;
        }
        let residuals = problem.residuals(&solution.x).ok()?;
        let in_uncertainties = median(weighted.in_uncertainties(residuals.clone()))?;
        let (quantity, residuals) = of_main_quantity(residuals, problem.quantities());
        let size = median(residuals)?;
        let large = large_errors_at(plausible, &problem.with_values(&solution.x)).ok()?;
        Some(Self {
            median: size,
            quantity,
            in_uncertainties,
            is_plausible: !large.iter().any(|large| large.is_implausible()),
        })
    }

    fn is_of_a_machine(&self) -> bool {
        self.median < LEFT[usize::from(self.quantity == Quantity::Angle)]
    }

    /// The median for people.
    fn size(&self) -> String {
        let (value, small, large) = match self.quantity {
            Quantity::Angle => (self.median * 1e6, "µrad", "mrad"),
            _ => (self.median * 1e3, "µm", "mm"),
        };
        if value < 1e3 { format!("{value:.2} {small}") } else { format!("{:.1} {large}", value * 1e-3) }
    }
}

/// The median of sizes; none if there are none, or some are no numbers.
fn median(values: Vec<f64>) -> Option<f64> {
    let mut sizes: Vec<f64> = values.into_iter().map(f64::abs).collect();
    sizes.sort_by(f64::total_cmp);
    sizes.get(sizes.len() / 2).copied().filter(|median| median.is_finite())
}

/// The usual mistakes in recorded commands of a machine.
fn mistakes(machine: &ModelInfo) -> Vec<Mistake> {
    let mut found = Vec::new();
    let mut mistake = |without: String, correct: Correction, scaled: Option<(Vec<usize>, f64)>| {
        found.push(Mistake { without, correct, scaled });
    };
    for (index, axis) in machine.axes.iter().enumerate() {
        let negated: Vec<usize> =
            machine.status_index(&StatusRole::Direction(index)).into_iter().chain([axis.status]).collect();
        let negate = move |status: &mut [f64]| negated.iter().for_each(|&value| status[value] = -status[value]);
        mistake(format!("with {} negated", axis.name), Box::new(negate), None);
    }
    for kind in [AxisKind::Linear, AxisKind::Rotary] {
        let alike: Vec<(&str, usize)> =
            machine.axes.iter().filter(|axis| axis.kind == kind).map(named_status).collect();
        for (place, &(name, one)) in alike.iter().enumerate() {
            for &(other_name, other) in &alike[place + 1..] {
                let swap = move |status: &mut [f64]| status.swap(one, other);
                mistake(format!("with {name} and {other_name} swapped"), Box::new(swap), None);
            }
        }
        for &(factor, unit) in units(kind) {
            // All of them, then one after the other.
            let each = if alike.len() > 1 { alike.chunks(1) } else { [].chunks(1) };
            for read in alike.chunks(alike.len().max(1)).chain(each) {
                let (names, values): (Vec<&str>, Vec<usize>) = read.iter().copied().unzip();
                let scaled = Some((values.clone(), factor));
                let scale = move |status: &mut [f64]| values.iter().for_each(|&value| status[value] *= factor);
                mistake(format!("with {} read as {unit}", names.join(", ")), Box::new(scale), scaled);
            }
        }
    }
    found
}

/// Whether the recorded commands of one of these columns of the status cover a part of the travel of their axis: then they are not too
/// large by a unit, or they would be beyond it.
fn cover_their_travel(problem: &Problem, columns: &[usize]) -> bool {
    let axes = problem.model.info().axes.iter().filter(|axis| columns.contains(&axis.status));
    axes.filter_map(|axis| Some((axis.status, axis.range?))).any(|(column, [from, to])| {
        let commands = problem.sets.iter().flat_map(|set| {
            let poses = set.poses();
            poses.indices().map(move |pose| poses.row(pose)[column])
        });
        let [least, most] = commands
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[least, most], command| [least.min(command), most.max(command)]);
        most - least > COVERED * (to - from)
    })
}

fn named_status(axis: &Axis) -> (&str, usize) {
    (&axis.name, axis.status)
}

/// What numbers may be read as by mistake, with the factor that corrects them.
fn units(kind: AxisKind) -> &'static [(f64, &'static str)] {
    match kind {
        AxisKind::Linear => &[
            (25.4, "in inches"),
            (1.0 / 25.4, "in mm and not in inches"),
            (1e3, "in metres"),
            (1e-3, "in micrometres"),
        ],
        AxisKind::Rotary => &[(180.0 / PI, "in radians"), (PI / 180.0, "in degrees and not in radians")],
    }
}

/// The problem with other recorded commands.
pub(crate) fn with_commands(problem: &Problem, change: impl Fn(&mut [f64])) -> Problem {
    let mut problem = problem.clone();
    let changed = |set: &ObservationSet| {
        let mut poses = set.poses().clone();
        for pose in poses.indices() {
            change(poses.row_mut(pose));
        }
        set.with_poses(poses)
    };
    problem.sets = problem.sets.iter().map(changed).collect();
    problem
}
