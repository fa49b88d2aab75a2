//! Poses to first order in the errors: the nominal way, and beside it what each error does.

use nalgebra::{Rotation3, Vector3};
use pulp::{Arch, Scalar, Simd, WithSimd};

use super::{Evaluations, Given, OF_SLOT, sign_of, vector};
use crate::chain::{Chain, Derivatives, Evaluation};
use crate::frame::{Frame, MOST, any};
use crate::number::{Number, Vector};

/// An evaluation to first order without derivatives: compiled for each kind of vector unit.
struct ToFirstOrder<'a> {
    chain: &'a Chain,
    given: Given<'a>,
    rotations: bool,
    out: &'a mut Evaluations,
}

impl WithSimd for ToFirstOrder<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { chain, given, rotations, out } = self;
        out.walk_nominally(simd, chain, given, rotations);
    }
}

impl Evaluations {
    /// The poses of a chain to first order in the errors, with all derivatives of these if some are wanted
    /// ([`Chain::evaluate_first_order`]). Without derivatives rotations are those without errors unless they are wanted.
    pub fn evaluate_first_order(
        &mut self,
        chain: &Chain,
        given: Given<'_>,
        derivatives: Derivatives<'_>,
        rotations: bool,
    ) {
        if derivatives == Derivatives::None {
            self.make_room(chain, derivatives, chain.slots());
            let (poses, whole) = (self.poses, ToFirstOrder { chain, given, rotations, out: self });
            return match poses {
                1 => whole.with_simd(Scalar),
                _ => Arch::new().dispatch(whole),
            };
        }
        let (poses, mut one) = (self.poses, Evaluation::default());
        for pose in 0..poses {
            let of_pose = |list: &[f64]| -> Vec<f64> { list.iter().skip(pose).step_by(poses).copied().collect() };
            let (commands, errors, tip) = (of_pose(given.commands), of_pose(given.errors), of_pose(given.tips));
            let errors = errors.as_chunks().0;
            chain.evaluate_first_order(&commands, errors, &Vector3::new(tip[0], tip[1], tip[2]), &mut one);
            self.take(pose, &one);
        }
    }

    /// Takes a pose that was evaluated alone.
    fn take(&mut self, pose: usize, one: &Evaluation) {
        let poses = self.poses;
        let write = |list: &mut Vec<f64>, numbers: &[f64]| {
            list.resize(poses * numbers.len(), 0.0);
            let places = list.iter_mut().skip(pose).step_by(poses);
            places.zip(numbers).for_each(|(place, number)| *place = *number);
        };
        let coordinates = |vectors: &[Vector3<f64>]| -> Vec<f64> { vectors.iter().flatten().copied().collect() };
        write(&mut self.positions, one.position.as_slice());
        write(&mut self.rotations, one.rotation.as_slice());
        write(&mut self.by_error, &coordinates(one.by_error.as_flattened()));
        write(&mut self.turn_by_error, &coordinates(one.turn_by_error.as_flattened()));
        write(&mut self.by_command, &coordinates(&one.by_command));
        write(&mut self.turn_by_command, &coordinates(&one.turn_by_command));
    }

    /// Walks both branches as if there were no errors, and adds what these do, to first order.
    #[inline(always)]
    fn walk_nominally<S: Simd>(&mut self, simd: S, chain: &Chain, given: Given<'_>, rotations: bool) {
        let [workpiece, tool] = self.ends(chain, given, || Frame::nominal_bed(simd));
        let (table, tip) = (workpiece.directions, tool.origin);
        let noted = S::as_simd_f64s(&self.slots).0;
        let none = Vector::all(simd, &Vector3::zeros());
        let (mut shift, mut turn) = (none, none);
        for (slot, errors) in given.errors.chunks_exact(6 * self.poses).enumerate() {
            let (shifts, turns) = errors.split_at(3 * self.poses);
            let (sign, first) = (Number::all(simd, sign_of(slot, chain.axes())), OF_SLOT * slot);
            if any(shifts) {
                shift = shift + Vector::at(simd, noted, first) * sign;
            }
            if any(turns) {
                let own = Vector::at(simd, noted, first + 1) * sign;
                turn = turn + own;
                shift = shift + own.cross(tip - Vector::at(simd, noted, first + 2));
            }
        }
        self.write_pose(table.inwards(tip - workpiece.origin + shift), table.all_inwards(tool.directions.0));
        if !rotations {
            return;
        }
        let mut turns = [0.0; 3 * MOST];
        let turns = &mut turns[..3 * self.poses];
        table.inwards(turn).write(S::as_mut_simd_f64s(turns).0, 0);
        for pose in 0..self.poses {
            let turned = Rotation3::new(vector(turns, 0, (self.poses, pose))) * self.pose(pose).rotation();
            let numbers = self.rotations.iter_mut().skip(pose).step_by(self.poses);
            numbers.zip(&turned).for_each(|(number, turned)| *number = *turned);
        }
    }

    /// Notes the errors of a slot in bed coordinates, and where they turn.
    #[inline(always)]
    pub(super) fn note<S: Simd>(&mut self, frame: &Frame<S>, slot: usize, (shifts, turns): (&[f64], &[f64])) {
        let noted = S::as_mut_simd_f64s(&mut self.slots).0;
        let outwards = |errors: &[f64]| frame.directions.outwards(Vector::at(frame.simd, S::as_simd_f64s(errors).0, 0));
        let first = OF_SLOT * slot;
        if any(shifts) {
            outwards(shifts).write(noted, first);
        }
        if any(turns) {
            outwards(turns).write(noted, first + 1);
            frame.origin.write(noted, first + 2);
        }
    }
}
