//! The examples do what they say.

#[path = "first_artefact.rs"]
mod first_artefact;
#[path = "fit_and_predict.rs"]
mod fit_and_predict;
#[path = "own_estimator.rs"]
mod own_estimator;

#[test]
fn a_first_artefact_finds_the_scales() {
    for (name, found, truth) in first_artefact::scales().unwrap() {
        assert!((found - truth).abs() < 1e-14, "{name}: {found:e} and {truth:e}");
    }
}

#[test]
fn the_tip_is_off_by_some_micrometres() {
    let deviations = fit_and_predict::deviations().unwrap();
    assert_eq!(deviations.len(), 1);
    let size = deviations[0].1.iter().map(|part| part * part).sum::<f64>().sqrt();
    assert!((1e-3..1.0).contains(&size), "{size} mm");
}

#[test]
fn two_iterations_find_the_same() {
    let compared = own_estimator::compared().unwrap();
    assert!(compared.len() > 15);
    for (name, [own, other], uncertainty) in compared {
        // Normal equations have the square of the condition number: half of the digits are lost.
        assert!((own - other).abs() <= 1e-5 * uncertainty, "{name}: {own:e} and {other:e}");
    }
}

#[test]
fn every_example_runs_to_its_end() {
    for run in [first_artefact::main, fit_and_predict::main, own_estimator::main] {
        run().unwrap();
    }
}
