//! Derivatives of poses to parameters and commands.

use std::ops::Range;

use abbe_core::Variable;
use abbe_kinematics::ByErrorAndCommand;
use nalgebra::Vector3;

use crate::evaluate::ValuesAtPose;
use crate::model::{CoefficientPlace, ParameterUse, SerialChain, Source};

/// Variables to which derivatives are wanted, each with its index among all of them.
#[derive(Default)]
pub(crate) struct Wanted {
    /// Coefficients of one error stand together.
    coefficients: Vec<(usize, CoefficientPlace)>,
    /// Slot and component of every error that they are of, with their range.
    errors: Vec<((usize, usize), Range<usize>)>,
    arguments: Vec<Argument>,
}

/// A variable that functions have as their argument: a shape, or the command of an axis.
pub(crate) struct Argument {
    /// Index among all variables.
    index: usize,
    source: Source,
    /// The axis, if it is a command: the motion itself changes with it, too.
    axis: Option<usize>,
    bases: Vec<usize>,
    /// Slot, component and slope of the errors that follow it, at the last pose.
    slopes: Vec<(usize, usize, f64)>,
}

/// Whether two coefficients add to the same error.
pub(crate) fn of_one_error((_, one): &(usize, CoefficientPlace), (_, other): &(usize, CoefficientPlace)) -> bool {
    (one.slot, one.component) == (other.slot, other.component)
}

/// Slopes of the functions of a basis to one argument, and to all arguments that come from one source.
pub(crate) type Buffers = (Vec<f64>, Vec<f64>);

/// Where derivatives are taken.
#[derive(Clone, Copy)]
pub(crate) struct At<'a> {
    pub status: &'a [f64],
    pub values: &'a [f64],
}

impl SerialChain {
    /// The wanted variables, coefficients of one error together. `used` are the bases that are evaluated.
    pub fn sorted(&self, wanted: &[Variable], used: &[usize]) -> Wanted {
        let mut sorted = Wanted::default();
        let argument = |index, source, axis, bases| Argument { index, source, axis, bases, slopes: Vec::new() };
        for (index, variable) in wanted.iter().enumerate() {
            match *variable {
                Variable::Parameter(parameter) => match self.uses[parameter] {
                    ParameterUse::Coefficient(place) => sorted.coefficients.push((index, place)),
                    ParameterUse::Factor(basis) => {
                        let coefficients = &self.bases[basis].coefficients;
                        sorted.coefficients.extend(coefficients.iter().map(|(_, place)| (index, *place)));
                    }
                    ParameterUse::Shape(first) => {
                        let source = Source::Parameter(parameter);
                        let follows = |basis: &usize| *basis == first || self.bases[*basis].arguments.contains(&source);
                        let bases = (0..self.bases.len()).filter(follows).collect();
                        sorted.arguments.push(argument(index, source, None, bases));
                    }
                    ParameterUse::Radius => {}
                },
                Variable::Command(axis) => {
                    let source = Source::Status(self.info.axes[axis].status);
                    let follows = |basis: &&usize| self.bases[**basis].arguments.contains(&source);
                    let bases = used.iter().filter(follows).copied().collect();
                    sorted.arguments.push(argument(index, source, Some(axis), bases));
                }
            }
        }
        let mut end = 0;
        sorted.errors = (sorted.coefficients.chunk_by(of_one_error))
            .map(|run| {
                let first = end;
                end += run.len();
                ((run[0].1.slot, run[0].1.component), first..end)
            })
            .collect();
        sorted
    }

    /// The slots with errors that the wanted variables change.
    pub fn slots_of(&self, wanted: &Wanted) -> Vec<bool> {
        let mut slots = vec![false; self.chain.slots()];
        let bases = wanted.arguments.iter().flat_map(|argument| &argument.bases);
        let of_arguments = bases.flat_map(|&basis| &self.bases[basis].coefficients);
        for (_, place) in wanted.coefficients.iter().chain(of_arguments) {
            slots[place.slot] = true;
        }
        slots
    }

    /// The slopes of errors to the wanted arguments at a pose: derivatives of position and of rotation follow from them.
    pub fn slopes(&self, wanted: &mut Wanted, at: At<'_>, (each, slopes): &mut Buffers) {
        for argument in &mut wanted.arguments {
            argument.slopes.clear();
            for basis in argument.bases.iter().map(|&basis| &self.bases[basis]) {
                if basis.slopes_by(argument.source, at.status, at.values, each, slopes) {
                    argument.slopes.extend(basis.errors(at.values, slopes));
                }
            }
        }
    }
}

impl Argument {
    /// The derivative to it at the last pose, of position or rotation as in `by`.
    fn effect(&self, by: ByErrorAndCommand<'_>) -> [f64; 3] {
        let motion = self.axis.map_or_else(Vector3::zeros, |axis| by.command(axis));
        let through = self.slopes.iter();
        through.fold(motion, |sum, (slot, component, slope)| sum + by.error(*slot, *component) * *slope).into()
    }
}

impl Wanted {
    /// Writes the derivatives of position or rotation, as in `by`, with the values of the functions and the slopes at the pose.
    /// Derivatives that are zero are not written.
    pub fn write(&self, functions: ValuesAtPose<'_>, by: ByErrorAndCommand<'_>, out: &mut [[f64; 3]]) {
        for ((slot, component), run) in &self.errors {
            let by_error = by.error(*slot, *component);
            for (index, place) in &self.coefficients[run.clone()] {
                let function = functions.of(place.function);
                // Of piecewise functions most are zero at a given command.
                if function != 0.0 {
                    // A factor acts in several errors.
                    let effect = by_error * function;
                    out[*index].iter_mut().zip(effect.iter()).for_each(|(sum, effect)| *sum += effect);
                }
            }
        }
        for argument in &self.arguments {
            out[argument.index] = argument.effect(by);
        }
    }

    /// The terms of the derivatives: variable and effect. The coefficients of an error share one, an argument has its own.
    pub fn terms(&self) -> impl Iterator<Item = (usize, usize)> {
        let errors = self.errors.iter().enumerate();
        let of_errors = errors.flat_map(|(effect, (_, run))| {
            self.coefficients[run.clone()].iter().map(move |(variable, _)| (*variable, effect))
        });
        let first = self.errors.len();
        let of_arguments = self.arguments.iter().enumerate();
        of_errors.chain(of_arguments.map(move |(index, argument)| (argument.index, first + index)))
    }

    /// Adds the factors of these terms at a pose, with the values of the functions there.
    pub fn add_factors(&self, functions: ValuesAtPose<'_>, out: &mut Vec<f64>) {
        out.extend(self.coefficients.iter().map(|(_, place)| functions.of(place.function)));
        out.extend(self.arguments.iter().map(|_| 1.0));
    }

    /// Adds the effects at a pose, on position or rotation as in `by`.
    pub fn add_effects(&self, by: ByErrorAndCommand<'_>, out: &mut Vec<[f64; 3]>) {
        out.extend(self.errors.iter().map(|((slot, component), _)| <[f64; 3]>::from(by.error(*slot, *component))));
        out.extend(self.arguments.iter().map(|argument| argument.effect(by)));
    }
}
