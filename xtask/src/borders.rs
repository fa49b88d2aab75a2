//! Borders between the crates of the workspace: dependencies that are not listed here are refused, in tests as well.

use serde_json::Value;

use crate::Outcome;

/// What a crate may depend on.
struct Border {
    name: &'static str,
    /// What it uses.
    uses: &'static [&'static str],
    /// What its own tests use besides.
    tested_with: &'static [&'static str],
}

const fn border(name: &'static str, uses: &'static [&'static str]) -> Border {
    Border { name, uses, tested_with: &[] }
}

/// The folder `crates`: arrows point one way, see docs/architecture.md.
const CRATES: [Border; 31] = [
    border("abbe-settings", &[]),
    border("abbe-files", &[]),
    border("abbe-results", &["abbe-settings"]),
    border("abbe-core", &["abbe-results", "abbe-settings"]),
    border("abbe-numerics", &[]),
    border("abbe-errors", &["abbe-core", "abbe-thermal"]),
    border("abbe-geometry", &["abbe-numerics"]),
    border("abbe-kinematics", &["abbe-core"]),
    border("abbe-standards", &["abbe-geometry", "abbe-results"]),
    border("abbe-table", &["abbe-core", "abbe-files"]),
    border("abbe-assembly", &["abbe-core", "abbe-estimation", "abbe-files", "abbe-table"]),
    border("abbe-dcc", &["abbe-core", "abbe-files"]),
    border("abbe-thermal", &["abbe-core", "abbe-numerics"]),
    border("abbe-probe", &["abbe-core", "abbe-table"]),
    Border {
        name: "abbe-estimation",
        uses: &["abbe-core", "abbe-numerics"],
        tested_with: &[
            "abbe-balls",
            "abbe-facets",
            "abbe-gauss-newton",
            "abbe-length",
            "abbe-serial-chain",
            "abbe-table",
        ],
    },
    border("abbe-measuring", &["abbe-core", "abbe-estimation"]),
    border("abbe-planning", &["abbe-core", "abbe-estimation", "abbe-measuring", "abbe-numerics"]),
    border("abbe-simulation", &["abbe-core", "abbe-estimation", "abbe-numerics", "abbe-probe"]),
    Border { name: "abbe-volumetric", uses: &["abbe-core", "abbe-numerics"], tested_with: &["abbe-serial-chain"] },
    Border {
        name: "abbe-compensation",
        uses: &["abbe-core", "abbe-errors", "abbe-numerics", "abbe-table", "abbe-thermal", "abbe-volumetric"],
        tested_with: &["abbe-serial-chain"],
    },
    border("abbe-controllers", &["abbe-compensation", "abbe-core"]),
    border("abbe-trend", &["abbe-core", "abbe-numerics", "abbe-volumetric"]),
    border("abbe-history", &["abbe-core", "abbe-files", "abbe-trend"]),
    border("abbe-plugin", &["abbe-core", "abbe-estimation", "abbe-files"]),
    border("abbe-recipe", &["abbe-core", "abbe-estimation", "abbe-files", "abbe-planning"]),
    border(
        "abbe-engine",
        &[
            "abbe-core",
            "abbe-estimation",
            "abbe-files",
            "abbe-geometry",
            "abbe-measuring",
            "abbe-planning",
            "abbe-recipe",
            "abbe-simulation",
            "abbe-table",
        ],
    ),
    border("abbe-fleet", &["abbe-core", "abbe-engine", "abbe-files", "abbe-history", "abbe-recipe"]),
    border(
        "abbe-report",
        &["abbe-core", "abbe-engine", "abbe-estimation", "abbe-files", "abbe-probe", "abbe-trend", "abbe-volumetric"],
    ),
    border(
        "abbe",
        &[
            "abbe-bundle",
            "abbe-compensation",
            "abbe-controllers",
            "abbe-core",
            "abbe-engine",
            "abbe-files",
            "abbe-fleet",
            "abbe-history",
            "abbe-kinematics",
            "abbe-plugin",
            "abbe-recipe",
            "abbe-report",
            "abbe-table",
            "abbe-trend",
            "abbe-volumetric",
        ],
    ),
    // Outside `crates`: nothing depends on them.
    border("abbe-stock-library", &["abbe-bundle", "abbe-plugin"]),
    border("xtask", &[]),
];

/// Packages that may use the whole workspace: nothing depends on them.
const ABOVE_ALL: [&str; 5] = ["abbe-benches", "abbe-campaigns", "abbe-examples", "abbe-python", "abbe-tests"];

/// The crates that plugins may use.
const FOR_PLUGINS: [&str; 18] = [
    "abbe-assembly",
    "abbe-compensation",
    "abbe-core",
    "abbe-dcc",
    "abbe-errors",
    "abbe-estimation",
    "abbe-files",
    "abbe-geometry",
    "abbe-kinematics",
    "abbe-measuring",
    "abbe-numerics",
    "abbe-probe",
    "abbe-simulation",
    "abbe-standards",
    "abbe-table",
    "abbe-thermal",
    "abbe-trend",
    "abbe-volumetric",
];

/// What vendors' plugins may use.
const FOR_VENDORS: [&str; 1] = ["abbe-plugin"];

/// A dependency of a package of the workspace on another.
struct Arrow<'a> {
    from: &'a str,
    to: &'a str,
    /// Whether the package is in the folder `plugins`.
    of_plugin: bool,
    /// Whether only its tests or its build use the other.
    tests_only: bool,
}

impl Arrow<'_> {
    fn is_allowed(&self) -> bool {
        let Self { from, to, of_plugin, tests_only } = *self;
        if ABOVE_ALL.contains(&from) {
            return true;
        }
        if let Some(border) = CRATES.iter().find(|border| border.name == from) {
            return border.uses.contains(&to) || (tests_only && border.tested_with.contains(&to));
        }
        // The bundle knows the plugins and nothing else; a plugin knows no other, but is tested with a model and an estimator.
        let is_plugin = |name: &str| !CRATES.iter().any(|border| border.name == name) && name != "abbe-bundle";
        match (of_plugin, from) {
            (false, _) => false,
            (true, "abbe-bundle") => is_plugin(to) && !to.starts_with("abbe-vendor"),
            (true, vendor) if vendor.starts_with("abbe-vendor") => {
                FOR_VENDORS.contains(&to) || tests_only && is_plugin(to)
            }
            (true, _) => FOR_PLUGINS.contains(&to) || tests_only && is_plugin(to),
        }
    }
}

/// Checks the borders.
pub fn check(packages: &[Value]) -> Outcome {
    let mut wrong = Vec::new();
    for package in packages {
        let from = package["name"].as_str().unwrap_or_default();
        let of_plugin = package["manifest_path"].as_str().is_some_and(|path| path.contains("/plugins/"));
        for dependency in package["dependencies"].as_array().into_iter().flatten() {
            let to = dependency["name"].as_str().unwrap_or_default();
            let arrow = Arrow { from, to, of_plugin, tests_only: !dependency["kind"].is_null() };
            if to.starts_with("abbe") && !arrow.is_allowed() {
                let what = if arrow.tests_only { "the tests of " } else { "" };
                wrong.push(format!("{what}{from} must not depend on {to} (xtask/src/borders.rs)"));
            }
        }
    }
    if wrong.is_empty() { Ok(()) } else { Err(wrong.join("; ")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_allowed_is_denied() {
        let arrow = |from, to, of_plugin, tests_only| Arrow { from, to, of_plugin, tests_only }.is_allowed();
        assert!(arrow("abbe-engine", "abbe-core", false, false));
        assert!(!arrow("abbe-core", "abbe-numerics", false, false));
        assert!(!arrow("abbe-core", "abbe-facets", false, true));
        assert!(arrow("abbe-estimation", "abbe-facets", false, true));
        assert!(!arrow("abbe-estimation", "abbe-facets", false, false));
        assert!(!arrow("abbe-new", "abbe-core", false, false));
        assert!(arrow("abbe-facets", "abbe-core", true, false));
        assert!(!arrow("abbe-facets", "abbe-engine", true, false));
        assert!(!arrow("abbe-facets", "abbe-balls", true, false));
        assert!(arrow("abbe-facets", "abbe-serial-chain", true, true));
        assert!(!arrow("abbe-facets", "abbe-bundle", true, true));
        assert!(arrow("abbe-bundle", "abbe-facets", true, false));
        assert!(!arrow("abbe-bundle", "abbe-core", true, false));
        assert!(!arrow("abbe-vendor-hexapod", "abbe-core", true, false));
    }
}
