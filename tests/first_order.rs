//! What linearising costs: the TANGO test evaluated to first order in the errors.

use serde_json::json;

use crate::support::{Variant, effect, fit, values};

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
