//! What linearising costs: the TANGO test evaluated to first order in the errors. Readings of angles, whose orientations are of first order.

use std::sync::Arc;

use abbe_core::{Equations, ObservationSet, Observations, ObservationsInfo, Problem, Result, RowBatch, SetIndex};
use serde_json::json;

use crate::support::{Variant, effect, fit, recipes, values};

#[test]
fn linearising_changes_estimates_by_second_order_amounts_only() {
    let estimates = ["fit-S3", "fit-S4r"];
    let exact = Variant::tango("exact").only(&estimates);
    let linear = exact.clone().set("hu40t", "evaluation", json!("first-order"));
    let (exact, linear) = (exact.run(), linear.run());
    let mut text = String::new();
    for estimate in estimates {
        let [exact, linear] = [&exact, &linear].map(|outcome| &fit(outcome, estimate).calibration);
        // The largest changes, as effects at the end of the travel.
        let mut largest = [("", 0.0), ("", 0.0)];
        for was in values(exact) {
            let now = linear.get(&was.name).expect("the same unknowns");
            let (angle, factor) = effect(&was.unit);
            let off = (now.value - was.value).abs() * factor * if angle { 1e6 } else { 1e3 };
            if off > largest[usize::from(angle)].1 {
                largest[usize::from(angle)] = (&was.name, off);
            }
        }
        let [(length, um), (angle, urad)] = largest;
        text.push_str(&format!(
            "{estimate}: lengths change by {um:.1e} µm at most ({length}), angles by {urad:.1e} µrad ({angle}); \
             RMS {:.1e} µm\n",
            linear.fit.residual_rms_um
        ));
        // Errors of the set-up are 0.3 mm, angles 1e-4 rad: products of two errors are below 0.1 µm, and a fit of many
        // unknowns may add up a few. That something changes shows that the setting has reached the model.
        assert!(um > 1e-4 && um < 1.0 && urad > 1e-4 && urad < 1.0, "{text}");
    }
    insta::assert_snapshot!("first_order", text);
}

/// Readings of a level on a face that bends: they follow the place, too.
struct OnABentFace(Arc<dyn Observations>);

/// Bends of the face along x, y and z, rad/mm.
const BENDS: [f64; 3] = [3e-6, -2e-6, 5e-6];

impl Observations for OnABentFace {
    fn info(&self) -> &ObservationsInfo {
        self.0.info()
    }

    fn evaluate(&self, batch: RowBatch<'_>, out: &mut Equations) -> Result<()> {
        let mut level = Equations::default();
        self.0.evaluate(batch, &mut level)?;
        for (equation, (residual, place)) in level.residuals().iter().zip(batch.positions).enumerate() {
            let bent: f64 = BENDS.iter().zip(place).map(|(bend, coordinate)| bend * coordinate).sum();
            out.equation(residual + bent);
            out.position(BENDS);
            out.rotation(level.by_rotation()[equation]);
            let own = level.by_own().iter().filter(|(of, _, _)| *of == equation);
            own.for_each(|(_, unknown, derivative)| out.own(*unknown, *derivative));
        }
        Ok(())
    }
}

/// Norms of derivatives, rad per unit, that are rounding.
const ROUNDING: f64 = 1e-12;

/// Derivatives of every 40th row to every unknown, and differences of residuals; the sum of products of both with the residuals.
fn check_derivatives(problem: &Problem, x: &[f64]) {
    let mut lines: Vec<Vec<f64>> = Vec::new();
    problem.linearise(x, |block| lines.extend(block.lines().map(|(_, _, line)| line.to_vec()))).unwrap();
    let residuals = problem.residuals(x).unwrap();
    let (gradient, again) = problem.gradient(x, &|_, residual| residual).unwrap();
    assert_eq!(again, residuals);
    let mut with_effect = 0;
    for (unknown, value) in x.iter().enumerate() {
        let norm = lines.iter().map(|line| line[unknown].powi(2)).sum::<f64>().sqrt();
        // An effect of a tenth of a microradian on all rows together: rounding is far below, and so are products of errors. Where a
        // function begins at the last row there is nothing but rounding.
        let has_effect = norm > ROUNDING;
        let step = if has_effect { 1e-7 / norm } else { value.abs().max(1.0) * 1e-7 };
        let at = |step: f64| {
            let mut moved = x.to_vec();
            moved[unknown] += step;
            problem.residuals(&moved).unwrap()
        };
        let (above, below) = (at(step), at(-step));
        let mut product = 0.0;
        for ((line, residual), (above, below)) in lines.iter().zip(&residuals).zip(above.iter().zip(&below)) {
            let difference = (above - below) / (2.0 * step);
            let name = &problem.unknowns[unknown].name;
            assert!(
                (line[unknown] - difference).abs() < (1e-5 * norm).max(ROUNDING),
                "{name}: {} {difference}",
                line[unknown]
            );
            product += line[unknown] * residual;
        }
        let size = norm.max(ROUNDING) * residuals.iter().map(|residual| residual * residual).sum::<f64>().sqrt();
        assert!((gradient[unknown] - product).abs() <= 1e-12 * size, "{product} {}", gradient[unknown]);
        with_effect += usize::from(has_effect);
    }
    assert!(with_effect > 100, "{with_effect}");
}

#[test]
fn angles_that_follow_the_place_have_the_derivatives_of_both() {
    let outcome = Variant::of(&recipes()["mill-direct-exact"]).only(&["fit-angles"]).run();
    let estimate = fit(&outcome, "fit-angles");
    let mut problem = Problem::clone(&estimate.problem);
    // Translations turn nothing, and move the place.
    let straight = ["EXX[1]", "EYY[1]", "EZZ[1]"].map(|name| problem.model.info().parameter(name).expect(name));
    for (parameter, size) in straight.into_iter().zip([2e-5, -3e-5, 4e-5]) {
        problem.machine_values[parameter] = size;
    }
    for set in SetIndex::first(problem.sets.len()) {
        problem.sets[set].rows = problem.sets[set].rows.iter().copied().step_by(40).collect();
    }
    let x = problem.values_of(&estimate.calibration);
    check_derivatives(&problem, &x);
    let mut bent = problem.clone();
    for set in SetIndex::first(bent.sets.len()) {
        let ObservationSet { observations, .. } = bent.sets[set].clone();
        bent.sets[set].observations = Arc::new(OnABentFace(observations));
    }
    check_derivatives(&bent, &x);
    assert_ne!(bent.residuals(&x).unwrap(), problem.residuals(&x).unwrap());
}
