//! The poses of a batch, evaluated side by side.

use abbe_core::{Error, PoseBatch, Result};
use abbe_kinematics::{Derivatives, EvaluatedPose, Evaluations, Given};

use crate::derivatives::{At, Wanted};
use crate::model::{Room, SerialChain};

/// Buffers for poses that are evaluated side by side.
struct Work {
    /// Functions x poses.
    functions: Vec<f64>,
    /// Arguments of the functions of a basis x poses.
    arguments: Vec<f64>,
    of_pose: Vec<f64>,
    /// Errors x poses.
    errors: Vec<f64>,
    /// Axes x poses.
    commands: Vec<f64>,
    /// Coordinates x poses.
    tips: Vec<f64>,
    poses: Evaluations,
    room: Room,
}

/// A term of an error, which stands at 6 x slot + component: the value of a coefficient times a function.
struct Term {
    error: usize,
    basis: usize,
    function: usize,
    value: f64,
}

/// The values of the functions at a pose.
#[derive(Clone, Copy)]
pub(crate) struct ValuesAtPose<'a> {
    /// Functions x poses.
    all: &'a [f64],
    poses: usize,
    pose: usize,
}

impl ValuesAtPose<'_> {
    /// The value of a function.
    pub fn of(&self, function: usize) -> f64 {
        self.all[function * self.poses + self.pose]
    }
}

/// A pose of a batch with the values of the functions there.
pub(crate) struct AtPose<'a> {
    pub functions: ValuesAtPose<'a>,
    pub pose: EvaluatedPose<'a>,
}

impl SerialChain {
    /// Buffers for poses of a batch of so many.
    fn work(&self, count: usize) -> Work {
        let poses = if count == 1 { Evaluations::one() } else { Evaluations::side_by_side() };
        let width = poses.poses();
        Work {
            functions: vec![0.0; self.functions * width],
            arguments: Vec::new(),
            of_pose: Vec::new(),
            errors: vec![0.0; 6 * self.chain.slots() * width],
            commands: vec![0.0; self.info.axes.len() * width],
            tips: vec![0.0; 3 * width],
            poses,
            room: Room::default(),
        }
    }

    /// What the errors of a pose are the sum of, with these values; terms of one error stand together.
    fn terms(&self, used: &[usize], values: &[f64]) -> Vec<Term> {
        let coefficients = used.iter().flat_map(|&basis| &self.bases[basis].coefficients);
        let terms = coefficients.map(|(parameter, place)| Term {
            error: 6 * place.slot + place.component,
            basis: place.basis,
            function: place.function,
            value: values[*parameter],
        });
        let mut terms: Vec<Term> = terms.filter(|term| term.value != 0.0).collect();
        terms.sort_by_key(|term| term.error);
        terms
    }

    /// The variables of a batch, sorted.
    pub fn wanted(&self, batch: &PoseBatch<'_>) -> Wanted {
        self.sorted(batch.wanted, &self.in_use(batch.values, batch.wanted))
    }

    /// Evaluates the poses of a batch, with derivatives to errors and commands where some are wanted, and shows them one after another.
    pub fn at_each_pose(
        &self,
        batch: PoseBatch<'_>,
        sorted: &mut Wanted,
        mut take: impl FnMut(usize, &Wanted, AtPose<'_>),
    ) -> Result<()> {
        let PoseBatch { statuses, values, wanted, orientation } = batch;
        let columns = self.info.status.len();
        let mut work = self.work(statuses.len() / columns);
        let mut buffers = (vec![0.0; self.functions], Vec::new());
        let used = self.in_use(values, wanted);
        let slots = self.slots_of(sorted);
        let derivatives = match (wanted.is_empty(), orientation) {
            (true, _) => Derivatives::None,
            (_, false) => Derivatives::OfPosition(&slots),
            (_, true) => Derivatives::OfPositionAndRotation(&slots),
        };
        let terms = self.terms(&used, values);
        let width = work.poses.poses();
        // Functions of what is the same at all poses have one value: of a run along an axis those of the other axes.
        let changes = changes(statuses, columns);
        let varies = |basis: usize| self.bases[basis].follows(&changes);
        let (used, same): (Vec<usize>, Vec<usize>) = used.iter().partition(|&&basis| varies(basis));
        let (terms, of_all): (Vec<_>, Vec<_>) = terms
            .chunk_by(|one, other| one.error == other.error)
            .partition(|of_error| of_error.iter().any(|term| varies(term.basis)));
        if let Some(status) = statuses.chunks_exact(columns).next() {
            self.functions_of(&same, &mut work, &status.repeat(width), values)
                .map_err(|(_, error)| error.at_pose(0))?;
            give_errors(&mut work, &of_all);
        }
        for (group, statuses) in statuses.chunks(columns * width).enumerate() {
            let of_group = |(place, error): (usize, Error)| error.at_pose(group * width + place);
            self.give(&mut work, statuses).map_err(of_group)?;
            self.functions_of(&used, &mut work, statuses, values).map_err(of_group)?;
            give_errors(&mut work, &terms);
            let Work { errors, commands, tips, poses, .. } = &mut work;
            let given = Given { commands, errors, tips };
            match self.first_order {
                true => poses.evaluate_first_order(&self.chain, given, derivatives, orientation),
                false => poses.evaluate(&self.chain, given, derivatives),
            }
            for (place, status) in statuses.chunks_exact(columns).enumerate() {
                self.slopes(sorted, At { status, values }, &mut buffers);
                let functions = ValuesAtPose { all: &work.functions, poses: width, pose: place };
                take(group * width + place, sorted, AtPose { functions, pose: work.poses.pose(place) });
            }
        }
        Ok(())
    }

    /// Writes the values of the functions of some bases at all poses that are evaluated together, one after another in `statuses`. Fails
    /// with the first of these at which one is not known, and its place.
    fn functions_of(
        &self,
        bases: &[usize],
        work: &mut Work,
        statuses: &[f64],
        values: &[f64],
    ) -> std::result::Result<(), (usize, Error)> {
        let Work { functions, arguments, of_pose, room, poses, .. } = work;
        let (width, columns) = (poses.poses(), self.info.status.len());
        let of_bases = || bases.iter().map(|&basis| &self.bases[basis]);
        let refused = of_bases().filter_map(|basis| {
            let mut at_poses = statuses.chunks_exact(columns).enumerate();
            at_poses.find_map(|(place, status)| {
                let known = self.arguments_known(basis, At { status, values }, room);
                known.err().map(|error| (place, error))
            })
        });
        if let Some(first) = refused.min_by_key(|(place, _)| *place) {
            return Err(first);
        }
        for basis in of_bases() {
            basis.arguments_side_by_side(statuses, columns, (values, width), arguments);
            let own = &mut functions[basis.first * width..(basis.first + basis.count) * width];
            basis.functions.values_side_by_side(width, arguments, of_pose, own);
        }
        Ok(())
    }

    /// Writes commands and tips of poses to their places among those that are evaluated together. Fails with the first pose that has no tip.
    fn give(&self, work: &mut Work, statuses: &[f64]) -> std::result::Result<(), (usize, Error)> {
        let width = work.poses.poses();
        for (place, status) in statuses.chunks_exact(self.info.status.len()).enumerate() {
            for (axis, command) in status[..self.info.axes.len()].iter().enumerate() {
                work.commands[axis * width + place] = *command;
            }
            for (coordinate, tip) in self.tip(status).map_err(|error| (place, error))?.iter().enumerate() {
                work.tips[coordinate * width + place] = *tip;
            }
        }
        Ok(())
    }
}

/// The columns of statuses that differ from pose to pose.
fn changes(statuses: &[f64], columns: usize) -> Vec<bool> {
    let mut changes = vec![false; columns];
    for status in statuses.chunks_exact(columns) {
        for (changes, (now, first)) in changes.iter_mut().zip(status.iter().zip(statuses)) {
            *changes |= now.to_bits() != first.to_bits();
        }
    }
    changes
}

/// Writes errors of all poses that are evaluated together, each the sum of its terms, whose functions are known. Errors without a term
/// stay zero.
fn give_errors(work: &mut Work, errors_of: &[&[Term]]) {
    let Work { functions, errors, poses, .. } = work;
    // A number that is known while this is compiled needs no loops.
    match poses.poses() {
        8 => give_sums::<8>(functions, errors, errors_of),
        4 => give_sums::<4>(functions, errors, errors_of),
        2 => give_sums::<2>(functions, errors, errors_of),
        _ => give_sums::<1>(functions, errors, errors_of),
    }
}

fn give_sums<const POSES: usize>(functions: &[f64], errors: &mut [f64], errors_of: &[&[Term]]) {
    let (functions, errors) = (functions.as_chunks::<POSES>().0, errors.as_chunks_mut::<POSES>().0);
    for of_error in errors_of {
        let Some(Term { error, .. }) = of_error.first() else { continue };
        let mut sum = [0.0; POSES];
        for term in *of_error {
            sum.iter_mut().zip(&functions[term.function]).for_each(|(sum, function)| *sum += term.value * function);
        }
        errors[*error] = sum;
    }
}
