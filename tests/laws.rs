//! Changes that must not change an estimate: the order of rows, the names of features, the distribution of data over files,
//! the border between tool length and tool offset.

use abbe_core::Calibration;
use abbe_engine::prepare;
use serde_json::{Value, json};

use crate::support::{
    Small, Variant, fit, read, recipes, recipes_with_every_plugin, registry, root, temporary, values, write,
};

const FITS: [&str; 2] = ["fit-S3", "fit-S4r"];
const DATA: [&str; 2] = ["exact", "realistic"];

fn base(data: &str) -> Variant {
    Variant::tango(data).only(&FITS)
}

/// A change of the data: reads files that the recipe names, writes changed ones, and lets the recipe read those.
type Change = fn(Variant, &Small) -> Variant;

/// Compares all estimates after a change with those before, to 1e-9 in their own units; `name` tells what a parameter is
/// called afterwards.
fn check(change: Change, name: fn(&str) -> String) {
    for data in DATA {
        let small = Small::new();
        let changed = change(base(data), &small).run();
        let before = base(data).run();
        for estimate in FITS {
            let [old, new] = [&before, &changed].map(|outcome| &fit(outcome, estimate).calibration);
            compare(&format!("{data} {estimate}"), old, new, name);
        }
    }
}

fn compare(what: &str, old: &Calibration, new: &Calibration, name: fn(&str) -> String) {
    assert_eq!(values(old).count(), values(new).count(), "{what}");
    for was in values(old) {
        let now = new.get(&name(&was.name)).unwrap_or_else(|| panic!("{what}: {} is gone", was.name));
        assert_eq!((&now.unit, now.status), (&was.unit, was.status), "{what}: {}", was.name);
        let off = (now.value - was.value).abs();
        assert!(off <= 1e-9, "{what}: {} moved by {off:e} {}", was.name, was.unit);
    }
    let rows = |calibration: &Calibration| calibration.outliers.len();
    assert_eq!(rows(new), rows(old), "{what}");
}

/// Header and rows of the file that a stage reads.
fn rows(recipe: &Variant, stage: &str, setting: &str) -> (String, Vec<String>) {
    let text = read(&recipe.path(stage, setting));
    let mut lines = text.lines().map(str::to_owned);
    (lines.next().expect("a header"), lines.collect())
}

fn write_rows(small: &Small, name: &str, header: &str, rows: &[String]) -> Value {
    let path = small.path(name);
    write(&path, &format!("{header}\n{}\n", rows.join("\n")));
    json!(path)
}

#[test]
fn the_order_of_rows_does_not_matter() {
    check(
        |recipe, small| {
            let (header, mut rows) = rows(&recipe, "touches", "path");
            let before = rows.clone();
            // A shuffle by a linear congruential generator: the same on every machine.
            let mut state: u64 = 20_260_101;
            for last in (1..rows.len()).rev() {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                rows.swap(last, (state >> 33) as usize % (last + 1));
            }
            assert_ne!(rows, before);
            let path = write_rows(small, "shuffled.csv", &header, &rows);
            recipe.set("touches", "path", path)
        },
        str::to_owned,
    );
}

/// The new name of a feature.
fn renamed(feature: &str) -> String {
    format!("side {feature} of the table")
}

#[test]
fn the_names_of_features_do_not_matter() {
    check(
        |recipe, small| {
            let (header, mut touches) = rows(&recipe, "touches", "path");
            for row in &mut touches {
                let cells: Vec<&str> = row.split(',').collect();
                *row = [&[cells[0], &renamed(cells[1])], &cells[2..]].concat().join(",");
            }
            let touches = write_rows(small, "touches.csv", &header, &touches);
            let (header, mut facets) = rows(&recipe, "table", "nominal");
            for row in &mut facets {
                let (feature, rest) = row.split_once(',').expect("a feature");
                *row = format!("{},{rest}", renamed(feature));
            }
            let facets = write_rows(small, "facets.csv", &header, &facets);
            let ignored = json!({ "feature": [renamed("1"), renamed("2")] });
            recipe.set("touches", "path", touches).set("touches", "ignore", ignored).set("table", "nominal", facets)
        },
        |name| match name.strip_prefix("table.facet[").and_then(|rest| rest.strip_suffix("].d")) {
            Some(feature) => format!("table.facet[{}].d", renamed(feature)),
            None => name.to_owned(),
        },
    );
}

#[test]
fn how_data_are_spread_over_files_does_not_matter() {
    check(
        |recipe, small| {
            let (header, rows) = rows(&recipe, "touches", "path");
            let (morning, evening) = rows.split_at(150);
            let files = [("morning.csv", morning), ("evening.csv", evening)];
            let files = files.map(|(name, rows)| write_rows(small, name, &header, rows));
            recipe.set("touches", "path", json!(files))
        },
        str::to_owned,
    );
}

#[test]
fn where_the_tool_length_ends_and_the_offset_begins_does_not_matter() {
    let (before, length) = (base("exact").run(), 300.0);
    let shorter = base("exact").set("hu40t", "tool_length_mm", json!(length)).run();
    for estimate in FITS {
        let [old, new] = [&before, &shorter].map(|outcome| &fit(outcome, estimate).calibration);
        for was in values(old) {
            let now = new.get(&was.name).expect("the same unknowns").value;
            let expected = if was.name == "dzt" { was.value + length - 326.674 } else { was.value };
            assert!((now - expected).abs() <= 1e-9, "{estimate}: {} {now}, not {expected}", was.name);
        }
    }
}

/// Models, artefacts and estimators that recipes use, on data that a virtual machine makes.
#[test]
fn all_that_recipes_use_keeps_the_laws() {
    let registry = registry();
    let mut seen = std::collections::BTreeSet::new();
    // One whose rows alone tell what others take from last month.
    let folder = temporary();
    let alone = Variant::tango("exact").only(&["fit-S3"]).set("fit-S3", "estimate", json!("sequential"));
    let alone = ("tango-sequential".to_owned(), alone.write(folder.path()));
    for (recipe, file) in recipes_with_every_plugin().into_iter().chain([alone]) {
        let prepared = prepare(&file, &registry).unwrap_or_else(|error| panic!("{error}"));
        let laws = prepared.laws().unwrap_or_else(|error| panic!("{recipe}: {error}"));
        assert!(laws.broken.is_empty(), "{recipe}: {:#?}", laws.broken);
        laws.skipped.iter().for_each(|why| println!("{recipe}: {why}"));
        for (stage, plugin) in laws.seen {
            let kind = prepared.recipe.stages.iter().find(|other| other.name == stage).expect("a stage").kind;
            seen.insert((kind, plugin));
        }
    }
    use abbe_core::Kind;
    let wanted = registry.iter().filter(|plugin| match plugin.kind() {
        Kind::Artefact | Kind::Model => true,
        // Others are given no measurements.
        Kind::Estimate => plugin.estimate_source == abbe_core::EstimateSource::Measurements,
        _ => false,
    });
    let wanted: std::collections::BTreeSet<_> = wanted.map(|plugin| (plugin.kind(), plugin.name.to_string())).collect();
    assert_eq!(seen, wanted, "a plugin is in no recipe that shows that it keeps the laws");
}

/// Observations whose derivative to the height of the tip has the wrong sign.
struct Flipped(std::sync::Arc<dyn abbe_core::Observations>);

impl abbe_core::Observations for Flipped {
    fn info(&self) -> &abbe_core::ObservationsInfo {
        self.0.info()
    }

    fn evaluate(&self, batch: abbe_core::RowBatch<'_>, out: &mut abbe_core::Equations) -> abbe_core::Result<()> {
        let mut right = abbe_core::Equations::default();
        self.0.evaluate(batch, &mut right)?;
        for (equation, (residual, [x, y, z])) in right.residuals().iter().zip(right.by_position()).enumerate() {
            out.equation(*residual);
            out.position([*x, *y, -z]);
            let of = |list: &[(usize, usize, f64)]| -> Vec<(usize, f64)> {
                list.iter().filter(|by| by.0 == equation).map(|by| (by.1, by.2)).collect()
            };
            of(right.by_own()).into_iter().for_each(|(unknown, derivative)| out.own(unknown, derivative));
            of(right.by_input()).into_iter().for_each(|(input, derivative)| out.input(input, derivative));
        }
        Ok(())
    }
}

#[test]
fn a_derivative_with_the_wrong_sign_breaks_a_law() {
    let outcome = Variant::of(&recipes()["first-steps"]).run();
    let mut problem = abbe_core::Problem::clone(&outcome.fits[0].problem);
    let flipped = Flipped(problem.sets[0].observations.clone());
    problem.sets[0].observations = std::sync::Arc::new(flipped);
    let broken =
        abbe_estimation::laws::check_observations(&problem, abbe_core::SetIndex(0)).expect("the machine has poses");
    assert!(!broken.is_empty());
    assert!(broken.iter().all(|law| law.contains("the derivative to z of the tip of pose 0")), "{broken:#?}");
}

/// Sums over rows that nobody makes, for artefacts with own unknowns, known inputs, ties, several poses, and orientations.
#[test]
fn gradients_are_those_of_the_rows() {
    for name in ["first-steps", "mill-direct", "robot-ur5", "standards-rtest", "linuxcnc-balls"] {
        for fit in Variant::of(&recipes()[name]).run().fits {
            let problem = fit.problem.with_values(&fit.problem.values_of(&fit.calibration));
            let broken = abbe_estimation::laws::check_gradient(&problem).expect("the machine has poses");
            assert!(broken.is_empty(), "{name}, {}: {broken:#?}", fit.name);
        }
    }
}

/// Observations that compute nothing, whatever the machine does.
struct Nothing(std::sync::Arc<dyn abbe_core::Observations>);

impl abbe_core::Observations for Nothing {
    fn info(&self) -> &abbe_core::ObservationsInfo {
        self.0.info()
    }

    fn evaluate(&self, batch: abbe_core::RowBatch<'_>, out: &mut abbe_core::Equations) -> abbe_core::Result<()> {
        for &row in batch.rows {
            for _ in 0..self.info().layout.rows[row].equations {
                out.equation(0.0);
                (0..self.info().layout.rows[row].poses).for_each(|_| out.position([0.0; 3]));
            }
        }
        Ok(())
    }
}

#[test]
fn observations_that_compute_nothing_break_a_law() {
    let outcome = Variant::of(&recipes()["first-steps"]).run();
    let mut problem = abbe_core::Problem::clone(&outcome.fits[0].problem);
    problem.sets[0].observations = std::sync::Arc::new(Nothing(problem.sets[0].observations.clone()));
    let broken =
        abbe_estimation::laws::check_observations(&problem, abbe_core::SetIndex(0)).expect("the machine has poses");
    assert_eq!(broken, ["no equation depends on a position, an orientation, an unknown or an input"]);
}

/// An artefact that says of its rows that they are independent.
struct Dependent(Box<dyn abbe_core::Artefact>);

impl abbe_core::Artefact for Dependent {
    fn inputs(&self) -> Vec<abbe_core::InputFile> {
        self.0.inputs()
    }

    fn check(
        &self,
        headers: &[abbe_core::ColumnHeader],
        file: Option<&std::path::PathBuf>,
        model: &dyn abbe_core::KinematicModel,
    ) -> abbe_core::Result<()> {
        self.0.check(headers, file, model)
    }

    fn observe(
        &self,
        data: &std::sync::Arc<abbe_core::Dataset>,
        model: &std::sync::Arc<dyn abbe_core::KinematicModel>,
    ) -> abbe_core::Result<std::sync::Arc<dyn abbe_core::Observations>> {
        self.0.observe(data, model)
    }

    fn observe_some(
        &self,
        data: &std::sync::Arc<abbe_core::Dataset>,
        model: &std::sync::Arc<dyn abbe_core::KinematicModel>,
    ) -> abbe_core::Result<Option<std::sync::Arc<dyn abbe_core::Observations>>> {
        self.0.observe_some(data, model)
    }

    fn rows_are_independent(&self) -> bool {
        true
    }

    fn targets(&self, stylus_radius: f64) -> abbe_core::Result<Vec<abbe_core::Target>> {
        self.0.targets(stylus_radius)
    }
}

#[test]
fn rows_that_depend_on_each_other_break_a_law() {
    let registry = registry();
    let broken = |recipe: &str, plugin: &str, settings: Value| {
        let outcome = Variant::of(&recipes()[recipe]).run();
        let problem = &outcome.fits[0].problem;
        let plugin = registry.find(abbe_core::Kind::Artefact, plugin).expect("a plugin");
        let abbe_core::Build::Artefact(build) = &plugin.build else { panic!("no artefact") };
        let artefact = build.build(&settings, &abbe_core::Context { base: root() });
        let artefact = Dependent(artefact.unwrap_or_else(|error| panic!("{error:?}")));
        let data = &problem.sets[0].info().layout.data;
        abbe_estimation::laws::check_independence(&artefact, data, &problem.model).expect("the machine has poses")
    };
    let nominal = "pipelines/data/tango-hu40t/realistic/facets.csv";
    let settings = json!({ "nominal": nominal, "standard_uncertainty_um": 1.6 });
    let none: [&str; 0] = [];
    assert_eq!(broken("first-steps", "facets", settings), none);
    // Where the tracker stands is first found from all positions.
    let broken = broken("robot-ur5", "positions", json!({ "standard_uncertainty_um": 30.0 }));
    assert!(broken.iter().any(|law| law.contains("starts elsewhere")), "{broken:?}");
}
