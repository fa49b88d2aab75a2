//! Which location errors of a machine are independent, found from its derivatives and from no table.
//!
//! A location error moves the tool as seen from the workpiece. What offsets and turns of workpiece and tool do as well is no
//! property of the machine. Of the rest some do the same as others: on `b Y X Z` a turn of Y about C turns X with it, so that
//! the squareness of X to Y is `EC0X`. This holds for the derivatives at many poses, so it is their rank that tells.

use abbe_core::{Absent, AxisKind, KinematicModel, ModelInfo, ParameterRole, Poses, Result, Variable};

use crate::preference::Convention;

/// A location error and what it is on this machine.
#[derive(Debug, Clone, PartialEq)]
pub struct LocationError {
    /// Its name.
    pub name: String,
    /// The axis, by its index.
    pub axis: usize,
    /// 0..6: x, y, z, a, b, c.
    pub component: usize,
    /// What it is.
    pub standing: Standing,
}

/// What a location error is among the others of its machine.
#[derive(Debug, Clone, PartialEq)]
pub enum Standing {
    /// It belongs to the set of independent ones. Each of the others may take its place, alone.
    Independent {
        /// Whether positions of one tip tell it; else only several tool lengths or directions of the tool do.
        by_position: bool,
        /// Errors that may stand in its place.
        substitutes: Vec<String>,
    },
    /// It moves the tool as these independent ones do together with offsets and turns of workpiece and tool: name, and how much of it
    /// one unit is, in the units of memory.
    Dependent(Vec<(String, f64)>),
    /// Offsets and turns of workpiece and tool do the same.
    SetUp,
}

/// The location errors of a machine.
#[derive(Debug, Clone, PartialEq)]
pub struct LocationErrors {
    /// All of them that the model has, in its order.
    pub all: Vec<LocationError>,
    /// Directions that positions of one tip tell of all location errors, workpiece and tool together; and how many parameters these are.
    pub by_position: (usize, usize),
    /// The same for poses: positions and directions of the tool.
    pub by_pose: (usize, usize),
}

impl LocationErrors {
    /// The independent ones.
    pub fn independent(&self) -> impl Iterator<Item = &LocationError> {
        self.all.iter().filter(|error| matches!(error.standing, Standing::Independent { .. }))
    }

    /// The error of this name.
    pub fn get(&self, name: &str) -> Option<&LocationError> {
        self.all.iter().find(|error| error.name == name)
    }

    /// Which of the errors `others` do, together with offsets and turns of workpiece and tool, what the error `name` does; of
    /// several ways that of those which stand first. None if they cannot; names that this chain does not have do not count.
    pub fn same_as(&self, name: &str, others: &[&str]) -> Option<Vec<String>> {
        let independent: Vec<&str> = self.independent().map(|error| error.name.as_str()).collect();
        let amounts = |error: &LocationError| -> Vec<f64> {
            let of = |member: &&str| match &error.standing {
                Standing::Independent { .. } => f64::from(*member == error.name),
                Standing::Dependent(of) => of.iter().find(|(other, _)| other == member).map_or(0.0, |(_, part)| *part),
                Standing::SetUp => 0.0,
            };
            independent.iter().map(of).collect()
        };
        let mut basis = Basis::default();
        let mut members = Vec::new();
        for error in others.iter().filter_map(|other| self.get(other)).filter(|error| error.name != name) {
            basis.push(members.len(), amounts(error));
            members.push(&error.name);
        }
        let parts = basis.push(members.len(), amounts(self.get(name)?))?;
        Some(parts.into_iter().map(|(member, _)| members[member].clone()).collect())
    }
}

/// How much of each of some parameters, by their indices.
type Parts = Vec<(usize, f64)>;

/// Poses that are tried.
const POSES: usize = 60;

/// Ranges of axes that have none, mm and rad.
const TRAVEL: [f64; 2] = [-250.0, 250.0];
const TURN: [f64; 2] = [-1.9, 1.9];

/// Length that makes angles comparable to lengths, mm.
const LEVER: f64 = 300.0;

/// A derivative that is this part of its size away from what others do is rounding.
const ROUNDING: f64 = 1e-8;

/// The location errors of a model that lists all of them; errors that it does not list do not exist here.
///
/// Fails if the model cannot be evaluated within the ranges of its axes.
pub fn location_errors(model: &dyn KinematicModel) -> Result<LocationErrors> {
    let info = model.info();
    let convention = Convention::of(model);
    let indices = |wanted: fn(&ParameterRole) -> bool| -> Vec<usize> {
        (0..info.parameters.len()).filter(|&index| wanted(&info.parameters[index].role)).collect()
    };
    let set_up: Vec<usize> = indices(|role| *role == ParameterRole::SetUp)
        .into_iter()
        .filter(|&index| !info.parameters[index].name.starts_with("stylus["))
        .collect();
    let mut locations = indices(|role| matches!(role, ParameterRole::Location { .. }));
    locations.retain(|&index| !info.parameters[index].name.contains('['));
    let mut order = locations.clone();
    order.sort_by_key(|&index| convention.is_zero(&info.parameters[index].name));
    let poses = derivatives(model, &[set_up.clone(), locations.clone()].concat(), true)?;
    let positions = derivatives(model, &[set_up.clone(), locations.clone()].concat(), false)?;
    let column = |of: &[Vec<f64>], index: usize| {
        let place = set_up.iter().chain(&locations).position(|other| *other == index).unwrap_or_default();
        of[place].clone()
    };
    let rank = |of: &[Vec<f64>]| {
        let mut basis = Basis::default();
        set_up.iter().chain(&order).for_each(|&index| drop(basis.push(index, column(of, index))));
        basis.members.len()
    };
    let count = set_up.len() + locations.len();
    let by_pose = (rank(&poses), count);
    let by_position = (rank(&positions), count);
    // In order of preference, each that adds something to set-up and to those before it.
    let mut basis = Basis::default();
    set_up.iter().for_each(|&index| drop(basis.push(index, column(&poses, index))));
    let mut standings: Vec<(usize, Option<Parts>)> = Vec::new();
    for &index in &order {
        standings.push((index, basis.push(index, column(&poses, index))));
    }
    // What one tip tells is told first; the rest needs other tools.
    let mut seen = Basis::default();
    set_up.iter().for_each(|&index| drop(seen.push(index, column(&positions, index))));
    let chosen: Vec<usize> = standings.iter().filter(|(_, of)| of.is_none()).map(|(index, _)| *index).collect();
    let seen: Vec<usize> =
        chosen.iter().copied().filter(|&index| seen.push(index, column(&positions, index)).is_none()).collect();
    let name = |index: usize| info.parameters[index].name.clone();
    let combinations: Vec<(usize, Parts)> = standings
        .iter()
        .filter_map(|(index, of)| {
            Some((*index, of.as_ref()?.iter().copied().filter(|(member, _)| chosen.contains(member)).collect()))
        })
        .collect();
    let all = locations.iter().filter_map(|&index| {
        let ParameterRole::Location { axis, component } = info.parameters[index].role else { return None };
        let dependent = combinations.iter().find(|(other, _)| *other == index);
        let standing = match dependent {
            Some((_, of)) if of.is_empty() => Standing::SetUp,
            Some((_, of)) => Standing::Dependent(of.iter().map(|(member, part)| (name(*member), *part)).collect()),
            None => {
                let takes_part = |(_, of): &&(usize, Parts)| of.iter().any(|(member, _)| *member == index);
                let substitutes = combinations.iter().filter(takes_part).map(|(other, _)| name(*other)).collect();
                Standing::Independent { by_position: seen.contains(&index), substitutes }
            }
        };
        Some(LocationError { name: name(index), axis, component, standing })
    });
    Ok(LocationErrors { all: all.collect(), by_position, by_pose })
}

/// Derivatives of poses (or of positions) within the ranges of all axes to some parameters: one column each.
fn derivatives(model: &dyn KinematicModel, parameters: &[usize], orientation: bool) -> Result<Vec<Vec<f64>>> {
    let info = model.info();
    let statuses: Vec<f64> = (0..POSES).flat_map(|pose| status(info, pose)).collect();
    let wanted: Vec<Variable> = parameters.iter().map(|&index| Variable::Parameter(index)).collect();
    let mut poses = Poses::default();
    model.poses(&statuses, &info.without_errors(), &wanted, orientation, &mut poses)?;
    let column = |place: usize| {
        let of = |all: &[[f64; 3]], factor: f64| -> Vec<f64> {
            all.iter().skip(place).step_by(wanted.len()).flatten().map(|part| part * factor).collect()
        };
        let positions = of(&poses.position_derivatives, 1.0);
        if orientation { [positions, of(&poses.rotation_derivatives, LEVER)].concat() } else { positions }
    };
    let mut columns: Vec<Vec<f64>> = (0..wanted.len()).map(column).collect();
    // What moves nothing moves by rounding: a turn of the last axis about itself, at the tip.
    let largest = columns.iter().map(|column| norm(column)).fold(0.0, f64::max);
    columns.iter_mut().filter(|column| norm(column) <= ROUNDING * largest).for_each(|column| column.fill(0.0));
    Ok(columns)
}

fn norm(column: &[f64]) -> f64 {
    column.iter().map(|part| part * part).sum::<f64>().sqrt()
}

/// The status of a pose: commands that fill the ranges evenly and without a pattern (additive recurrence by roots of primes).
fn status(info: &ModelInfo, pose: usize) -> Vec<f64> {
    let absent = |absent: &Absent| match absent {
        Absent::Default(value) if value.is_finite() => *value,
        _ => 0.0,
    };
    let mut status: Vec<f64> = info.status.iter().map(|column| absent(&column.absent)).collect();
    const PRIMES: [f64; 12] = [2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0, 19.0, 23.0, 29.0, 31.0, 37.0];
    for (place, axis) in info.axes.iter().enumerate() {
        let [from, to] = axis.range.unwrap_or(if axis.kind == AxisKind::Linear { TRAVEL } else { TURN });
        let step = PRIMES[place % PRIMES.len()].sqrt() * (1 + place / PRIMES.len()) as f64;
        status[axis.status] = from + (to - from) * ((pose + 1) as f64 * step).fract();
    }
    status
}

/// Columns that are independent of one another, orthogonalised one after another (Gram and Schmidt, twice).
#[derive(Default)]
struct Basis {
    members: Vec<usize>,
    directions: Vec<Vec<f64>>,
    /// Each member in terms of the directions up to its own.
    made_of: Vec<Vec<f64>>,
}

impl Basis {
    /// Adds a column if it is independent; else tells how much of each member it is.
    fn push(&mut self, index: usize, column: Vec<f64>) -> Option<Parts> {
        let size = norm(&column);
        let (mut rest, mut parts) = (column, vec![0.0; self.directions.len()]);
        for _ in 0..2 {
            for (direction, part) in self.directions.iter().zip(&mut parts) {
                let along: f64 = direction.iter().zip(&rest).map(|(one, other)| one * other).sum();
                rest.iter_mut().zip(direction).for_each(|(rest, direction)| *rest -= along * direction);
                *part += along;
            }
        }
        let left = norm(&rest);
        if left > ROUNDING * size && size > 0.0 {
            parts.push(left);
            self.members.push(index);
            self.directions.push(rest.into_iter().map(|part| part / left).collect());
            self.made_of.push(parts);
            return None;
        }
        // Back substitution: the members that make up these parts.
        let mut of = vec![0.0; parts.len()];
        for place in (0..parts.len()).rev() {
            of[place] = parts[place] / self.made_of[place][place];
            for (part, made_of) in parts[..place].iter_mut().zip(&self.made_of[place]) {
                *part -= of[place] * made_of;
            }
        }
        let counts = |(place, part): &(usize, f64)| (part * norm(&self.made_of[*place])).abs() > 1e3 * ROUNDING * size;
        Some(of.into_iter().enumerate().filter(counts).map(|(place, part)| (self.members[place], part)).collect())
    }
}
