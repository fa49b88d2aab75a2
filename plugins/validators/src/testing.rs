//! A fit for tests: facets touched by a perfect three-axis machine, so that every offset is the mean of its touches.

use std::fs;
use std::path::Path;
use std::sync::Arc;

use abbe_balls as _;
use abbe_core::{
    Build, Context, Error, Findings, Fit, Kind, ObservationSet, Plugin, Problem, Registry, Validate, path_text,
};
use abbe_facets as _;
use abbe_gauss_newton as _;
use abbe_serial_chain as _;
use serde_json::{Value, json};
use tempfile::TempDir;

/// Label, point, normal.
pub type Facet = (&'static str, [f64; 3], [f64; 3]);
/// Facet, group, time in s, distance beyond the nominal point along the normal in µm.
pub type Touch = (&'static str, &'static str, f64, f64);

/// Four facets that look upwards: they tell three of six rigid motions.
pub const UPWARDS: [Facet; 4] = [
    ("a", [100.0, 100.0, 50.0], [0.0, 0.0, 1.0]),
    ("b", [-100.0, 100.0, 50.0], [0.0, 0.0, 1.0]),
    ("c", [-100.0, -100.0, 50.0], [0.0, 0.0, 1.0]),
    ("d", [100.0, -100.0, 50.0], [0.0, 0.0, 1.0]),
];

fn plugin<T>(kind: Kind, name: &str, take: impl Fn(&Plugin) -> Option<T>) -> T {
    take(Registry::built_in().unwrap().find(kind, name).unwrap()).unwrap()
}

/// A validator in a folder.
pub fn validator(name: &str, folder: &Path, settings: &Value) -> Result<Box<dyn Validate>, String> {
    let context = Context { base: folder.to_owned() };
    plugin(Kind::Validate, name, |plugin| match &plugin.build {
        Build::Validate(constructor) => Some(constructor.build(settings, &context)),
        _ => None,
    })
    .map_err(|error| error.to_string())
}

/// The fit of the facets' offsets to touches, robust on request.
pub fn fit(facets: &[Facet], touches: &[Touch], robust: bool) -> (TempDir, Fit) {
    let mut nominal = "feature,x_mm,y_mm,z_mm,nx,ny,nz\n".to_owned();
    for (label, [x, y, z], [nx, ny, nz]) in facets {
        nominal.push_str(&format!("{label},{x},{y},{z},{nx},{ny},{nz}\n"));
    }
    let mut rows = "feature,group,time_s,X_mm,Y_mm,Z_mm\n".to_owned();
    for (label, group, time, offset) in touches {
        let (_, point, normal) = facets.iter().find(|(other, _, _)| other == label).unwrap();
        let [x, y, z] = [0, 1, 2].map(|axis| point[axis] + (3.0 + offset * 1e-3) * normal[axis]);
        rows.push_str(&format!("{label},{group},{time},{x},{y},{}\n", z + 100.0));
    }
    let machine = json!({ "chain": "w b X Y Z t", "tool_length_mm": 100, "stylus_radius_mm": 3 });
    fit_to("facets", &nominal, &rows, &machine, robust)
}

/// The fit of an artefact's own unknowns to touches on it, with a machine that has no errors, robust on request. `nominal`
/// and `touches` are files.
pub fn fit_to(artefact: &str, nominal: &str, touches: &str, machine: &Value, robust: bool) -> (TempDir, Fit) {
    let folder = tempfile::tempdir().unwrap();
    let context = Context { base: folder.path().to_owned() };
    fs::write(folder.path().join("nominal.csv"), nominal).unwrap();
    let file = folder.path().join("touches.csv");
    fs::write(&file, touches).unwrap();
    let model = plugin(Kind::Model, "serial-chain", |plugin| match &plugin.build {
        Build::Model(constructor) => constructor.build(machine, &context).unwrap().build(&[]).ok(),
        _ => None,
    });
    let settings = json!({ "nominal": "nominal.csv", "standard_uncertainty_um": 1 });
    let data = Arc::new(abbe_table::read(&file).unwrap());
    let observations = plugin(Kind::Artefact, artefact, |plugin| match &plugin.build {
        Build::Artefact(constructor) => {
            Some(constructor.build(&settings, &context).unwrap().observe(&data, &model).unwrap())
        }
        _ => None,
    });
    let settings = if robust { json!({ "robust": "tukey" }) } else { json!({}) };
    let estimator = plugin(Kind::Estimate, "gauss-newton", |plugin| match &plugin.build {
        Build::Estimate(constructor) => constructor.build(&settings, &context).ok(),
        _ => None,
    });
    let sets = vec![ObservationSet::new("table", observations)];
    let problem = Problem::new("fit", "serial-chain", model, sets, &["table.*".to_owned()]).unwrap();
    let calibration = estimator.estimate(&problem).unwrap();
    let fit = Fit { name: "fit".to_owned(), problem: Arc::new(problem), estimator: Arc::from(estimator), calibration };
    (folder, fit)
}

/// What a validator finds of a fit, or the text of its error after the setting that it points at.
pub fn judge(name: &str, folder: &Path, settings: &Value, fit: &Fit) -> Result<Findings, String> {
    let found = validator(name, folder, settings)?.validate(&[fit], &[]);
    found.map_err(|error: Error| {
        let text = error.to_string().replace(&format!("{}/", folder.display()), "");
        format!("{}: {text}", path_text(&error.setting))
    })
}

/// The value of a figure of the fit.
pub fn figure(findings: &Findings, name: &str) -> f64 {
    figure_of(findings, "fit", name)
}

/// The value of a figure of a fit of some name.
pub fn figure_of(findings: &Findings, of: &str, name: &str) -> f64 {
    let found = findings.figures.iter().find(|figure| figure.of.as_deref() == Some(of) && figure.name == name);
    found.unwrap_or_else(|| panic!("no figure {name} of {of} in {findings:?}")).value.unwrap_or(f64::NAN)
}

/// Checks figures to a picometre.
pub fn check(findings: &Findings, expected: &[(&str, f64)]) {
    for (name, value) in expected {
        let found = figure(findings, name);
        assert!((found - value).abs() < 1e-6, "{name}: {found}, expected {value}");
    }
}

mod every_validator {
    use super::*;

    #[test]
    fn builds_its_example() {
        let registry = Registry::built_in().unwrap();
        let names: Vec<&str> = registry
            .iter()
            .filter(|plugin| plugin.kind() == Kind::Validate)
            .map(|plugin| {
                assert!(validator(&plugin.name, Path::new(""), plugin.example.get()).is_ok(), "{}", plugin.name);
                plugin.name.as_ref()
            })
            .collect();
        assert_eq!(
            names,
            [
                "artefact-cmm",
                "cause",
                "compare",
                "compensated",
                "consistency",
                "geometric-bias",
                "hold-out",
                "influence",
                "minimal-set",
                "probe",
                "repeatability",
                "repeats",
                "residuals",
                "sphericity",
                "tip-cmm",
                "uncertainty"
            ]
        );
    }
}
