//! Derivatives of poses to parameters and commands.

use abbe_core::Variable;
use nalgebra::Vector3;

use crate::model::{CoefficientPlace, FunctionBasis, ParameterUse, SerialChain, Source, Work};

/// Derivatives of position or rotation to the errors of every slot, and to the command of every axis.
pub(crate) type ByErrorAndCommand<'a> = (&'a [[Vector3<f64>; 6]], &'a [Vector3<f64>]);

/// Variables to which derivatives are wanted, each with its index among all of them.
#[derive(Default)]
pub(crate) struct Wanted {
    pub coefficients: Vec<(usize, CoefficientPlace)>,
    /// Index among all variables, parameter, bases.
    pub shapes: Vec<(usize, usize, Vec<usize>)>,
    /// Index among all variables, axis.
    pub commands: Vec<(usize, usize)>,
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
    pub used: &'a [usize],
}

impl SerialChain {
    /// The wanted variables, coefficients of one error together.
    pub fn sorted(&self, wanted: &[Variable]) -> Wanted {
        let mut sorted = Wanted::default();
        for (index, variable) in wanted.iter().enumerate() {
            match *variable {
                Variable::Parameter(parameter) => match self.uses[parameter] {
                    ParameterUse::Coefficient(place) => sorted.coefficients.push((index, place)),
                    ParameterUse::Factor(basis) => {
                        let coefficients = &self.bases[basis].coefficients;
                        sorted.coefficients.extend(coefficients.iter().map(|(_, place)| (index, *place)));
                    }
                    ParameterUse::Shape(first) => {
                        let follows = |basis: &usize| {
                            let arguments = &self.bases[*basis].arguments;
                            *basis == first || arguments.contains(&Source::Parameter(parameter))
                        };
                        sorted.shapes.push((index, parameter, (0..self.bases.len()).filter(follows).collect()));
                    }
                    ParameterUse::Radius => {}
                },
                Variable::Command(axis) => sorted.commands.push((index, axis)),
            }
        }
        sorted
    }

    /// Derivatives of position or rotation, as in `by`, to the wanted variables. Derivatives that are zero are not written.
    pub fn derivatives(
        &self,
        wanted: &Wanted,
        at: At<'_>,
        work: &Work,
        by: ByErrorAndCommand<'_>,
        (buffers, out): (&mut Buffers, &mut [[f64; 3]]),
    ) {
        for coefficients in wanted.coefficients.chunk_by(of_one_error) {
            let by_error = by.0[coefficients[0].1.slot][coefficients[0].1.component];
            for (index, place) in coefficients {
                let function = work.functions[place.function];
                // Of piecewise functions most are zero at a given command.
                if function != 0.0 {
                    // A factor acts in several errors.
                    let effect = by_error * function;
                    out[*index].iter_mut().zip(effect.iter()).for_each(|(sum, effect)| *sum += effect);
                }
            }
        }
        for (index, parameter, bases) in &wanted.shapes {
            let through = bases
                .iter()
                .map(|&basis| self.through(&self.bases[basis], Source::Parameter(*parameter), at, by, buffers));
            out[*index] = through.sum::<Vector3<f64>>().into();
        }
        // The motion itself, and the errors that change with the command.
        for &(index, axis) in &wanted.commands {
            let source = Source::Status(self.info.axes[axis].status);
            let bases = at.used.iter().map(|&basis| &self.bases[basis]);
            let through = bases.fold(by.1[axis], |sum, basis| sum + self.through(basis, source, at, by, buffers));
            out[index] = through.into();
        }
    }

    /// The derivative to `source` through the functions of a basis.
    fn through(
        &self,
        basis: &FunctionBasis,
        source: Source,
        at: At<'_>,
        by: ByErrorAndCommand<'_>,
        (each, slopes): &mut Buffers,
    ) -> Vector3<f64> {
        if !basis.slopes_by(source, at.status, at.values, each, slopes) {
            return Vector3::zeros();
        }
        let errors = basis.errors(at.values, slopes);
        errors.map(|(slot, component, slope)| by.0[slot][component] * slope).sum()
    }
}
