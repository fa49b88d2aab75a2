//! Some cases of each campaign; `cargo xtask campaign` runs them by the thousand.

use abbe_campaigns::{machines, tango};

#[test]
fn random_machines_keep_the_laws() {
    let report = machines::run(7, 250);
    println!("{}", report.text);
    assert!(report.broken.is_empty(), "{}", report.broken.join("\n"));
    // Every end is seen, or the campaign would prove nothing.
    for end in ["Full", "Marked", "Refused"] {
        assert!(report.text.contains(end), "{end}: {}", report.text);
    }
}

#[test]
fn robust_fits_settle_on_other_seeds() {
    let report = tango::run(1, 4);
    println!("{}", report.text);
    let failed: Vec<&String> = report.broken.iter().filter(|law| law.starts_with("seed")).collect();
    assert!(failed.is_empty(), "{failed:?}");
}
