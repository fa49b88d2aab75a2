//! The tests of a problem: rows in which one rotary axis turns a pivot ball about the tool ball.

use abbe_core::{
    AxisKind, Branch, EquationIndex, Error, Feature, IndexRange, KinematicModel, ObservationSet, Owner, Poses, Problem,
    Result, RowIndex, SetIndex, Unit, Unknown, Variable,
};
use nalgebra::{DMatrix, Vector3};

/// Largest motion of axes that stand still in a test: mm, rad.
const STILL: f64 = 1e-3;
const STILL_ANGLE: f64 = 1e-5;

/// Shortest arc that determines centre and radius of its circle separately.
const SHORTEST_ARC_DEG: f64 = 30.0;

/// Largest distance of the tool ball from the line of the axis, as part of the radius.
const BESIDE: f64 = 0.1;

/// Largest deviation of the derivative of an equation from that of a distance.
const DISTANCE: f64 = 1e-6;

/// A test: one rotary axis sweeps an arc, everything else stands still.
#[derive(Debug, Clone, PartialEq)]
pub struct Sweep {
    /// Its label.
    pub name: String,
    /// Equations of the problem.
    pub equations: Vec<EquationIndex>,
    /// Index of the axis that moves.
    pub axis: usize,
    /// Set and index of the feature that is the pivot.
    pub pivot: (SetIndex, usize),
    /// Commands of the axis, rad.
    pub angles: Vec<f64>,
    /// Distance from tool ball to pivot by the nominal machine, mm.
    pub nominal: Vec<f64>,
    /// Measured distance, mm.
    pub measured: Vec<f64>,
    /// Nominal distance of the pivot from the axis, mm.
    pub radius: f64,
    /// Nominal height of the tool ball above the plane of the pivot's circle, along the axis, mm.
    pub height: f64,
}

/// Residuals and derivatives of a problem as it is.
pub struct Linearisation {
    pub residuals: Vec<f64>,
    /// Equations x unknowns.
    pub jacobian: DMatrix<f64>,
}

impl Linearisation {
    /// Of a problem, to some unknowns, at the problem's own values.
    pub fn new(problem: &Problem, unknowns: Vec<Unknown>) -> Result<Self> {
        let mut problem = problem.clone();
        problem.unknowns = unknowns;
        let (rows, columns) = (problem.equations(), problem.unknowns.len());
        let mut residuals = Vec::with_capacity(rows);
        let mut entries = Vec::with_capacity(rows * columns);
        problem.linearise(&problem.start(), |block| {
            residuals.extend_from_slice(block.residuals);
            entries.extend_from_slice(block.jacobian);
        })?;
        if let Some(equation) = residuals.iter().position(|residual| !residual.is_finite()) {
            let (set, row) = problem.equation_rows()[EquationIndex(equation)];
            let error = Error::data("the equation of this row has no finite value").stage(&problem.sets[set].name);
            return Err(problem.error_at_row(set, row, error));
        }
        Ok(Self { residuals, jacobian: DMatrix::from_row_slice(rows, columns, &entries) })
    }
}

/// The tests of a problem (at nominal values), told apart by the labels in `column`.
pub fn sweeps(problem: &Problem, column: &str) -> Result<Vec<Sweep>> {
    let mut found = Vec::new();
    for ((index, set), equations) in SetIndex::enumerate(&problem.sets).zip(problem.equation_ranges()) {
        let tests = labelled(set, equations, column).and_then(|tests| {
            let pivots = Pivots::new(problem, index)?;
            tests.into_iter().map(|(name, rows)| pivots.sweep(name, &rows)).collect::<Result<Vec<_>>>()
        });
        found.extend(tests.map_err(|error| error.stage(&set.name))?);
    }
    Ok(found)
}

/// A row of a test: its index in the layout, and its equation in the problem.
#[derive(Debug, Clone, Copy)]
struct Sample {
    row: RowIndex,
    equation: EquationIndex,
}

/// The rows of a set (and its equations) by test, in the order in which the tests appear.
fn labelled(
    set: &ObservationSet,
    equations: IndexRange<EquationIndex>,
    column: &str,
) -> Result<Vec<(String, Vec<Sample>)>> {
    let layout = &set.info().layout;
    let labels = abbe_table::labels(&layout.data, column).map_err(|error| {
        let help = error.help.clone().unwrap_or_else(|| "name the column that tells the tests apart".to_owned());
        error.help(help).setting("tests")
    })?;
    let mut tests: Vec<(String, Vec<Sample>)> = Vec::new();
    for (&row, equation) in set.rows.iter().zip(equations) {
        let Some(data_row) = layout.rows[row].data_row.filter(|_| layout.rows[row].poses == 1) else {
            return Err(no_distance());
        };
        if layout.rows[row].equations != 1 {
            return Err(no_distance());
        }
        let sample = Sample { row, equation };
        match tests.iter_mut().find(|(name, _)| *name == labels[data_row]) {
            Some((_, rows)) => rows.push(sample),
            None => tests.push((labels[data_row].to_string(), vec![sample])),
        }
    }
    Ok(tests)
}

fn no_distance() -> Error {
    Error::usage("the closed form takes distances between the tool ball and a pivot ball, one a row")
        .help("use another estimator for other observations")
}

/// The features of a set as seen by its equations.
struct Pivots<'a> {
    problem: &'a Problem,
    set: SetIndex,
    features: &'a [Feature],
    /// Residuals and derivatives to the shifts of all features, in their order.
    linearisation: Linearisation,
}

impl<'a> Pivots<'a> {
    fn new(problem: &'a Problem, set: SetIndex) -> Result<Self> {
        let features = &problem.sets[set].info().features;
        let shifts = features.iter().flat_map(|feature| &feature.shifts);
        let unknowns =
            shifts.map(|&(index, _)| Unknown { name: String::new(), unit: Unit::MM, owner: Owner::Set(set), index });
        let linearisation = Linearisation::new(problem, unknowns.collect())?;
        Ok(Self { problem, set, features, linearisation })
    }

    /// The one feature that moves the equation of a row, and its derivatives to the shifts of that feature.
    fn pivot(&self, EquationIndex(equation): EquationIndex) -> Option<(usize, Vec<f64>)> {
        let mut first = 0;
        let mut found = None;
        for (index, feature) in self.features.iter().enumerate() {
            let shifts = first..first + feature.shifts.len();
            first = shifts.end;
            let by: Vec<f64> = shifts.map(|column| self.linearisation.jacobian[(equation, column)]).collect();
            if by.iter().any(|derivative| *derivative != 0.0) {
                if found.is_some() {
                    return None;
                }
                found = Some((index, by));
            }
        }
        found
    }

    /// Centre of a feature with the fixed values of its unknowns.
    fn centre(&self, feature: usize) -> Vector3<f64> {
        let own = &self.problem.sets[self.set].own;
        let shifts = self.features[feature].shifts.iter();
        shifts.fold(Vector3::from(self.features[feature].point), |point, &(index, direction)| {
            point + own[index] * Vector3::from(direction)
        })
    }

    fn sweep(&self, name: String, samples: &[Sample]) -> Result<Sweep> {
        let model = self.problem.model.as_ref();
        let set = &self.problem.sets[self.set];
        let status = |sample: &Sample| set.poses().row(set.info().layout.rows[sample.row].first_pose);
        let statuses: Vec<&[f64]> = samples.iter().map(status).collect();
        let axis = moving(model, &name, &statuses)?;
        let angles: Vec<f64> = statuses.iter().map(|status| status[model.info().axes[axis].status]).collect();
        let mut poses = Poses::default();
        let wanted = [Variable::Command(axis)];
        model.poses(&statuses.concat(), &self.problem.machine_values, &wanted, true, &mut poses)?;
        let of_rows = samples.iter().map(|sample| self.pivot(sample.equation).ok_or_else(no_distance));
        let of_rows = of_rows.collect::<Result<Vec<_>>>()?;
        let pivot = of_rows[0].0;
        let centre = self.centre(pivot);
        let (mut nominal, mut measured) = (Vec::new(), Vec::new());
        for ((sample, position), (feature, by)) in samples.iter().zip(&poses.positions).zip(&of_rows) {
            if *feature != pivot {
                let message = format!(
                    "test `{name}` measures to the balls {} and {}; one pivot a test was expected",
                    self.features[pivot].label, self.features[*feature].label
                );
                return Err(Error::data(message));
            }
            let bar = Vector3::from(*position) - centre;
            let shifts = &self.features[pivot].shifts;
            let is_distance = shifts.iter().zip(by).all(|((_, direction), derivative)| {
                (derivative + Vector3::from(*direction).dot(&bar.normalize())).abs() < DISTANCE
            });
            if !is_distance {
                return Err(no_distance());
            }
            nominal.push(bar.norm());
            measured.push(bar.norm() - self.linearisation.residuals[sample.equation]);
        }
        // Velocity v and angular velocity w of the tool seen from the table, a unit of command: v = w x (tip - line).
        let turning = |place: usize| {
            let velocity = Vector3::from(poses.position_derivatives[place]);
            let along = Vector3::from(poses.rotation_derivatives[place]).normalize();
            (along, velocity.cross(&along))
        };
        let (along, beside) = turning(samples.len() / 2);
        let bar = Vector3::from(poses.positions[samples.len() / 2]) - centre;
        let height = bar.dot(&along);
        let radius = (beside - (bar - height * along)).norm();
        let sweep = Sweep {
            name,
            equations: samples.iter().map(|sample| sample.equation).collect(),
            axis,
            pivot: (self.set, pivot),
            angles,
            nominal,
            measured,
            radius,
            height,
        };
        sweep.check(&model.info().axes[axis].name, beside.norm())?;
        Ok(sweep)
    }
}

/// The one rotary axis under the table that moves in a test.
fn moving(model: &dyn KinematicModel, name: &str, statuses: &[&[f64]]) -> Result<usize> {
    let moves = |index: &usize| {
        let axis = &model.info().axes[*index];
        let values = statuses.iter().map(|status| status[axis.status]);
        let (least, most) =
            values.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), value| (a.min(value), b.max(value)));
        most - least > if axis.kind == AxisKind::Linear { STILL } else { STILL_ANGLE }
    };
    let moving: Vec<usize> = (0..model.info().axes.len()).filter(moves).collect();
    let help =
        "the column under `tests` has to tell the tests apart; use `gauss-newton` for tests with several moving axes";
    let [axis] = moving.as_slice() else {
        let names: Vec<&str> = moving.iter().map(|&axis| model.info().axes[axis].name.as_str()).collect();
        let what = if names.is_empty() { "no axis moves".to_owned() } else { format!("{} move", names.join(" and ")) };
        return Err(Error::data(format!("in test `{name}` {what}; one rotary axis was expected to")).help(help));
    };
    let moved = &model.info().axes[*axis];
    if moved.kind != AxisKind::Rotary || moved.branch != Branch::Workpiece {
        let message = format!(
            "in test `{name}` {} moves; the closed form takes rotary axes that carry the table, one a test",
            moved.name
        );
        return Err(Error::data(message).help(help));
    }
    Ok(*axis)
}

impl Sweep {
    /// Refuses geometry that gives no circle.
    fn check(&self, axis: &str, beside: f64) -> Result<()> {
        let name = &self.name;
        if self.radius < 1.0 || self.nominal.iter().any(|nominal| *nominal < 1.0) {
            let message =
                format!("in test `{name}` the pivot stands on the line of {axis}, or the tool ball in the pivot");
            return Err(Error::data(message).help("are the nominal balls in the table frame?"));
        }
        if beside > BESIDE * self.radius {
            let message = format!("in test `{name}` the tool ball stands {beside:.3} mm beside the line of {axis}");
            return Err(Error::data(message).help("the closed form needs it on the line; use `gauss-newton`"));
        }
        let (least, most) =
            self.angles.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), &angle| (a.min(angle), b.max(angle)));
        let arc = (most - least).to_degrees();
        if arc < SHORTEST_ARC_DEG {
            let message = format!(
                "test `{name}` sweeps {arc:.1} deg only; from less than {SHORTEST_ARC_DEG} deg the centre of a circle cannot be told from its radius"
            );
            return Err(Error::data(message));
        }
        Ok(())
    }
}
