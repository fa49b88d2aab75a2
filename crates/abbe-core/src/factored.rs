//! Poses whose derivatives are in factors.

use nalgebra::Vector3;

use crate::model::Poses;

/// Tool poses relative to the workpiece, and their derivatives as sums of terms.
///
/// A term is a number, its factor, times a vector, its effect: the value of a function times what a unit of the error does that it is a
/// part of. Many parameters share an effect, so that a product with it is made once for all of them. The derivative of a pose to a
/// variable is the sum of the terms of that variable; a variable without terms has no effect.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FactoredPoses {
    /// The poses themselves, without derivatives.
    pub poses: Poses,
    /// The variable and the effect of every term, the same for all poses; terms of an effect stand together.
    pub terms: Vec<(usize, usize)>,
    /// Number of effects.
    pub effects: usize,
    /// The factors: poses x terms.
    pub factors: Vec<f64>,
    /// Effects on the position, mm per unit of the factor: poses x effects.
    pub position_effects: Vec<[f64; 3]>,
    /// Effects on the rotation vector, table frame: poses x effects; empty unless orientations were asked for.
    pub rotation_effects: Vec<[f64; 3]>,
}

impl FactoredPoses {
    /// Makes room for poses whose terms are these.
    pub fn reset(&mut self, poses: usize, orientation: bool, terms: impl Iterator<Item = (usize, usize)>) {
        self.poses.reset(poses, 0, orientation);
        self.terms.clear();
        self.terms.extend(terms);
        self.effects = self.terms.iter().map(|(_, effect)| effect + 1).max().unwrap_or(0);
        self.factors.clear();
        self.factors.reserve(poses * self.terms.len());
        self.position_effects.clear();
        self.position_effects.reserve(poses * self.effects);
        self.rotation_effects.clear();
    }

    /// Takes the derivatives of `poses` to this many variables as effects: every variable has its own, with the factor 1.
    pub fn take_derivatives(&mut self, variables: usize) {
        std::mem::swap(&mut self.position_effects, &mut self.poses.position_derivatives);
        std::mem::swap(&mut self.rotation_effects, &mut self.poses.rotation_derivatives);
        self.poses.position_derivatives.clear();
        self.poses.rotation_derivatives.clear();
        self.terms.clear();
        self.terms.extend((0..variables).map(|variable| (variable, variable)));
        self.effects = variables;
        self.factors.clear();
        self.factors.resize(self.poses.positions.len() * variables, 1.0);
    }

    /// The effects with the ranges of their terms.
    pub fn runs(&self) -> impl Iterator<Item = (usize, std::ops::Range<usize>)> {
        let mut end = 0;
        self.terms.chunk_by(|one, other| one.1 == other.1).map(move |run| {
            let first = end;
            end += run.len();
            (run[0].1, first..end)
        })
    }

    /// Writes the poses with their derivatives to this many variables.
    pub fn write(&self, variables: usize, out: &mut Poses) {
        out.reset(self.poses.positions.len(), variables, !self.poses.orientations.is_empty());
        out.positions.copy_from_slice(&self.poses.positions);
        out.orientations.copy_from_slice(&self.poses.orientations);
        let count = self.terms.len();
        for pose in 0..self.poses.positions.len() {
            for (&(variable, effect), factor) in self.terms.iter().zip(&self.factors[pose * count..]) {
                let (variable, effect) = (pose * variables + variable, pose * self.effects + effect);
                add(&mut out.position_derivatives[variable], *factor, &self.position_effects[effect]);
                if let Some(turned) = out.rotation_derivatives.get_mut(variable) {
                    add(turned, *factor, &self.rotation_effects[effect]);
                }
            }
        }
    }

    /// The sum of the rotation vectors that the variables make at a pose, if each has this value.
    pub(crate) fn turn(&self, pose: usize, value: impl Fn(usize) -> f64) -> Vector3<f64> {
        let factors = &self.factors[pose * self.terms.len()..];
        let mut turn = [0.0; 3];
        for (effect, run) in self.runs() {
            let terms = self.terms[run.clone()].iter().zip(&factors[run]);
            let size = terms.map(|(&(variable, _), factor)| value(variable) * factor).sum();
            add(&mut turn, size, &self.rotation_effects[pose * self.effects + effect]);
        }
        turn.into()
    }

    /// Adds the effects of the same poses on the rotation; `variable` is what a variable of theirs is here, none where it is left out.
    pub(crate) fn add_rotations(&mut self, other: &Self, variable: impl Fn(usize) -> Option<usize>) {
        self.add_effects(other, [&[], &other.rotation_effects], variable);
    }

    /// Adds the effects of the same poses, with the same variables, on the position.
    pub(crate) fn add_positions(&mut self, other: &Self) {
        self.add_effects(other, [&other.position_effects, &[]], Some);
    }

    /// Adds these effects of other poses on position and rotation, none where a list is empty, without those that are zero at all poses.
    fn add_effects(&mut self, other: &Self, lists: [&[[f64; 3]]; 2], variable: impl Fn(usize) -> Option<usize>) {
        let (poses, own, count) = (self.poses.positions.len(), self.effects, self.terms.len());
        let at = |list: &[[f64; 3]], pose: usize, effect: usize| list.get(pose * other.effects + effect).copied();
        let is_there = |list: &[[f64; 3]], effect| {
            (0..poses).any(|pose| at(list, pose, effect).is_some_and(|effect| effect != [0.0; 3]))
        };
        let acting: Vec<usize> =
            (0..other.effects).filter(|&effect| lists.iter().any(|list| is_there(list, effect))).collect();
        let (mut kept, mut terms) = (Vec::new(), Vec::new());
        for (term, &(of, effect)) in other.terms.iter().enumerate() {
            if let (Some(of), Ok(place)) = (variable(of), acting.binary_search(&effect)) {
                kept.push(term);
                terms.push((of, own + place));
            }
        }
        let mut factors = Vec::with_capacity(poses * (count + kept.len()));
        let mut joined = lists.map(|_| Vec::with_capacity(poses * (own + acting.len())));
        for pose in 0..poses {
            factors.extend_from_slice(&self.factors[pose * count..(pose + 1) * count]);
            factors.extend(kept.iter().map(|term| other.factors[pose * other.terms.len() + term]));
            for ((joined, before), list) in
                joined.iter_mut().zip([&self.position_effects, &self.rotation_effects]).zip(lists)
            {
                match before.is_empty() {
                    true => joined.extend(std::iter::repeat_n([0.0; 3], own)),
                    false => joined.extend_from_slice(&before[pose * own..(pose + 1) * own]),
                }
                joined.extend(acting.iter().map(|&effect| at(list, pose, effect).unwrap_or_default()));
            }
        }
        self.terms.extend(terms);
        self.factors = factors;
        [self.position_effects, self.rotation_effects] = joined;
        self.effects += acting.len();
    }
}

fn add(sum: &mut [f64; 3], factor: f64, effect: &[f64; 3]) {
    sum.iter_mut().zip(effect).for_each(|(sum, effect)| *sum += factor * effect);
}
