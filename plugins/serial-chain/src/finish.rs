//! From what a builder has collected to the model and its description.

use abbe_core::{ErrorFunction, ModelInfo, PeriodicError};
use abbe_errors::Group;
use serde_json::Value;

use crate::builder::{Builder, quantity_of};
use crate::model::{CoefficientPlace, ParameterUse, Room, SerialChain, Source};
use crate::settings::{Evaluation, Settings};

impl Builder {
    /// The model; `resolved` are settings from which it can be built again without data.
    pub fn finish(self, settings: &Settings, resolved: Value) -> SerialChain {
        let info = ModelInfo {
            error_functions: self.error_functions(),
            periods: self.periods(),
            nominal_uncertainties: self.nominal_uncertainties(),
            nominal: self.nominal,
            stylus_radius: settings.stylus_radius_mm,
            ..ModelInfo::new(self.axes, self.status, self.parameters, resolved)
        };
        SerialChain {
            chain: self.chain,
            info,
            uses: self.uses,
            bases: self.bases,
            functions: self.functions,
            tips: self.tips,
            stylus_status: self.stylus_status,
            first_order: settings.evaluation == Evaluation::FirstOrder,
        }
    }

    fn nominal_uncertainties(&self) -> Vec<f64> {
        let of = |role: &ParameterUse| match role {
            ParameterUse::Coefficient(CoefficientPlace { basis, .. }) | ParameterUse::Factor(basis) => {
                self.bases[*basis].functions.nominal_uncertainty()
            }
            ParameterUse::Shape(_) | ParameterUse::Radius => 0.0,
        };
        self.uses.iter().map(of).collect()
    }

    /// The motion errors that have coefficients.
    fn error_functions(&self) -> Vec<ErrorFunction> {
        let motions = self.candidates.iter().filter(|(group, _)| *group == Group::Motion);
        let there = motions.filter_map(|(_, candidate)| {
            let of_it =
                |place: &CoefficientPlace| place.slot == candidate.slot && place.component == candidate.component;
            let mut places = self.bases.iter().flat_map(|basis| &basis.coefficients);
            let axis = candidate.axis.filter(|_| places.any(|(_, place)| of_it(place)))?;
            let (symbol, component) = (candidate.symbol.clone(), candidate.component);
            Some(ErrorFunction { symbol, axis, component, quantity: quantity_of(component) })
        });
        there.collect()
    }

    /// The parts of motion errors that repeat.
    fn periods(&self) -> Vec<PeriodicError> {
        let mut periods = Vec::new();
        for basis in &self.bases {
            let mut room = Room::default();
            let status = vec![0.0; self.status.len()];
            let arguments = basis.arguments_at(&status, &self.nominal, &mut room);
            let Some(length) = basis.functions.period(arguments) else { continue };
            let shapes = basis.arguments.iter().filter_map(|source| match source {
                Source::Parameter(index) => Some(*index),
                Source::Status(_) => None,
            });
            let shapes: Vec<usize> = shapes.collect();
            for (_, candidate) in self.candidates.iter().filter(|(group, _)| *group == Group::Motion) {
                let of_it =
                    |place: &CoefficientPlace| place.slot == candidate.slot && place.component == candidate.component;
                let own = basis.coefficients.iter().filter(|(_, place)| of_it(place));
                let parameters: Vec<usize> = own.map(|(parameter, _)| *parameter).collect();
                if let (Some(axis), false) = (candidate.axis, parameters.is_empty()) {
                    let (symbol, shapes) = (candidate.symbol.clone(), shapes.clone());
                    periods.push(PeriodicError { symbol, axis, length, parameters, shapes });
                }
            }
        }
        periods
    }
}
