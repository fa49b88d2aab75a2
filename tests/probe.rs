//! Lobing of touch probes against the figures of an independent evaluation (`tests/truth/probe-lobing-*`), on another machine with
//! styli, and what data cannot tell. Estimates never see the truth.

use std::sync::OnceLock;

use abbe_core::{Calibration, Status};
use abbe_engine::{Outcome, prepare};
use serde_json::{Map, Value, json};

use crate::support::{Variant, abbe, effect, fit, json_file, read, recipes, root, temporary, values, write};

fn truth(data: &str) -> Map<String, Value> {
    let file = root().join(format!("tests/truth/probe-lobing-{data}-truth.json"));
    json_file(&file)["parameters"].as_object().expect("parameters").clone()
}

fn recipe(data: &str) -> Variant {
    Variant::of(&recipes()[if data == "exact" { "probe-lobing-exact" } else { "probe-lobing" }])
}

/// The recipe as it stands in the repository, run once for all tests.
fn outcome(data: &str) -> &'static Outcome {
    static EXACT: OnceLock<Outcome> = OnceLock::new();
    static REALISTIC: OnceLock<Outcome> = OnceLock::new();
    let once = if data == "exact" { &EXACT } else { &REALISTIC };
    once.get_or_init(|| recipe(data).run())
}

const PLACE: [&str; 5] = ["sphere.ball[31].?", "dxt", "dyt", "EXX[b]", "EYY[b]"];
const FORM: [&str; 2] = ["sphere.*[???2]", "sphere.*[???3]"];

/// An estimate from the sphere alone on the machine as it truly is, but for these parameters.
fn of_sphere(recipe: Variant, parameters: &[&str], data: &str) -> Calibration {
    let folder = temporary();
    let mut recipe = recipe.only(&[]);
    let parameters: Vec<&str> = parameters.to_vec();
    // A drift needs the times of the table, which are not here.
    let errors = recipe.stage("hu40t")["errors"].as_array_mut().expect("errors");
    errors.retain(|line| line.get("drift").is_none());
    // The truth holds what is not estimated. The file has artefacts as well, which are no parameters of a machine.
    let machine: Map<String, Value> = truth(data)
        .into_iter()
        .filter(|(name, _)| !name.contains("ball[") && !name.contains("ring[") && !name.contains("facet["))
        .collect();
    let file = folder.path().join("laser.json");
    write(&file, &json!({ "parameters": machine }).to_string());
    recipe.0["stages"]["laser"] = json!({ "estimate": "stated", "machine": "hu40t", "path": file });
    recipe.0["stages"]["one"] = json!({ "estimate": "gauss-newton", "machine": "hu40t", "observations": ["sphere"],
        "parameters": parameters, "known": ["laser"] });
    let outcome = recipe.run();
    fit(&outcome, "one").calibration.clone()
}

/// The own name of a value: without the stage of its artefact.
fn own_name(name: &str) -> &str {
    ["sphere.", "table.", "bar.", "block.", "bore."].iter().find_map(|stage| name.strip_prefix(stage)).unwrap_or(name)
}

/// The largest error of the values that were estimated, in mm or rad over a long travel, with its name.
fn largest_error(calibration: &Calibration, truth: &Map<String, Value>, taken: impl Fn(&str) -> bool) -> (f64, String) {
    let mut largest = (0.0, String::new());
    for value in values(calibration).filter(|value| value.status == Status::Estimated && taken(&value.name)) {
        let Some(truth) = truth.get(own_name(&value.name)).and_then(Value::as_f64) else { continue };
        let off = (value.value - truth).abs() * effect(&value.unit).1;
        if off > largest.0 {
            largest = (off, value.name.clone());
        }
    }
    largest
}

/// The largest error of a group of values, in their own units.
fn off(calibration: &Calibration, truth: &Map<String, Value>, names: &[&str]) -> f64 {
    names
        .iter()
        .map(|name| (calibration.get(name).expect("a value").value - truth[*name].as_f64().expect("a number")).abs())
        .fold(0.0, f64::max)
}

const ANGLES: [&str; 9] = ["EA0B", "EC0B", "EA0C", "EB0C", "EB0Z", "EA0Y", "EC0Y", "EBB[b]", "ECC[b]"];
const OFFSETS: [&str; 3] = ["EX0C", "EX0S", "EY0S"];
const SCALES: [&str; 3] = ["EXX[1]", "EYY[1]", "EZZ[1]"];
const REVERSALS: [&str; 2] = ["EXX[b]", "EYY[b]"];

fn condition(calibration: &Calibration) -> f64 {
    calibration.fit.condition
}

#[test]
fn exact_data_give_the_probe_back() {
    let truth = truth("exact");
    let mut parameters: Vec<&str> = PLACE.to_vec();
    parameters.push("probe.*");
    let found = of_sphere(recipe("exact"), &parameters, "exact");
    assert_eq!((found.fit.unknowns, found.fit.rank), (20, 20));
    // The set has a form, which this fit leaves out.
    parameters.extend(FORM);
    let found = of_sphere(recipe("exact"), &parameters, "exact");
    assert_eq!((found.fit.unknowns, found.fit.rank), (24, 24));
    assert!((condition(&found) - 32.6).abs() < 0.1, "{}", condition(&found));
    let off = largest_error(&found, &truth, |name| name != "probe.delay");
    assert!(off.0 < 3e-10, "{off:?}");
    let delay = found.get("probe.delay").expect("a delay").value;
    assert!((delay - 0.0038).abs() < 2e-12, "{delay}");
}

#[test]
fn a_nominal_machine_bends_only_what_looks_like_its_scale() {
    let (truth, found) = (truth("exact"), &fit(outcome("exact"), "qualified").calibration);
    let lobes = largest_error(found, &truth, |name| name.starts_with("probe.lobe") && name != "probe.lobe[cos0,2]");
    assert!(lobes.0 < 2.5e-7, "{lobes:?}");
    let off = |name: &str| (found.get(name).expect("a value").value - truth[name].as_f64().expect("a number")) * 1e3;
    assert!((off("probe.lobe[cos0,2]") - 0.404).abs() < 1e-3, "{}", off("probe.lobe[cos0,2]"));
    assert!((off("probe.r0") + 0.143).abs() < 1e-3, "{}", off("probe.r0"));
}

#[test]
fn three_ways_to_calibrate_the_machine() {
    let truth = truth("exact");
    // Unknowns, residuals in um; bounds of angles in urad, offsets in um, scales in um/m and reversals in um.
    for (name, unknowns, residual, bounds) in [
        ("ignored", 53, 1.64, [6.3, 2.9, 7.9, 1.75]),
        ("corrected", 53, 0.0205, [0.026, 0.008, 0.58, 0.17]),
        ("joint", 72, 4e-7, [1.2e-6, 8e-7, 1.4e-6, 2e-7]),
    ] {
        let found = &fit(outcome("exact"), name).calibration;
        assert_eq!((found.fit.unknowns, found.fit.rank), (unknowns, unknowns), "{name}");
        let rms = found.fit.residual_rms_um;
        assert!(rms < residual && (name == "joint" || rms > 0.9 * residual), "{name}: residuals of {rms} um");
        let errors = [(&ANGLES[..], 1e6), (&OFFSETS[..], 1e3), (&SCALES[..], 1e6), (&REVERSALS[..], 1e3)];
        for ((names, factor), bound) in errors.into_iter().zip(bounds) {
            let error = off(found, &truth, names) * factor;
            assert!(error < bound, "{name}: {names:?} are off by {error}");
        }
    }
}

#[test]
fn noisy_data_agree_within_their_uncertainty() {
    let truth = truth("realistic");
    let worst = |name: &str, taken: &dyn Fn(&str) -> bool| {
        let found = &fit(outcome("realistic"), name).calibration;
        let estimated = values(found).filter(|value| value.status == Status::Estimated && taken(&value.name));
        let ratio = estimated.filter_map(|value| {
            let truth = truth.get(own_name(&value.name))?.as_f64()?;
            Some(((value.value - truth) / value.standard_uncertainty).abs())
        });
        ratio.fold(0.0, f64::max)
    };
    let sigma = |name: &str| fit(outcome("realistic"), name).calibration.fit.sigma;
    let all = |_: &str| true;
    let machine = |name: &str| name.starts_with('E');
    // Lobing that is ignored biases the machine by up to ten of the uncertainties that were stated.
    assert!((sigma("ignored") - 2.9).abs() < 0.1 && worst("ignored", &machine) * sigma("ignored") > 8.0);
    assert!((sigma("corrected") - 1.06).abs() < 0.02 && worst("corrected", &machine) < 1.75);
    assert!((sigma("joint") - 1.01).abs() < 0.01 && worst("joint", &all) < 2.65 && worst("joint", &machine) < 1.7);
    assert!(worst("corrected", &all) < 2.65);
    // A bore by the probe and the machine of the joint fit: its diameter too.
    let bore = values(&fit(outcome("realistic"), "bore").calibration).filter(|value| value.status == Status::Estimated);
    let off = bore.map(|value| {
        let truth = truth[value.name.strip_prefix("ring.").expect("of the ring")].as_f64().expect("a number");
        assert!((value.value - truth).abs() < 2.65 * value.standard_uncertainty, "{}", value.name);
    });
    assert_eq!(off.count(), 3);
    // The sphere alone, on the machine as it truly is.
    let mut parameters: Vec<&str> = PLACE.to_vec();
    parameters.extend(FORM);
    parameters.extend(["probe.*", "sphere.*.diameter"]);
    let found = of_sphere(recipe("realistic"), &parameters, "realistic");
    assert!((found.fit.sigma - 0.99).abs() < 0.01, "{}", found.fit.sigma);
    let cosine = found.get("probe.lobe[cos3]").expect("a value");
    assert!((cosine.standard_uncertainty - 0.040e-3).abs() < 0.002e-3, "{}", cosine.standard_uncertainty);
}

/// A figure of the validator `probing`, by its estimate and the beginning and end of its name.
fn figure(data: &str, of: &str, begins: &str, ends: &str) -> f64 {
    let verdict = outcome(data).verdicts.iter().find(|verdict| verdict.stage == "probing").expect("a verdict");
    let mut found = verdict.figures.iter().filter(|figure| {
        figure.of.as_deref() == Some(of) && figure.name.starts_with(begins) && figure.name.ends_with(ends)
    });
    let value = found.next().and_then(|figure| figure.value).unwrap_or_else(|| panic!("no {begins} {ends}"));
    assert!(found.next().is_none(), "{begins} {ends} is not one figure");
    value
}

#[test]
fn probing_errors_as_an_independent_evaluation_has_them() {
    for data in ["exact", "realistic"] {
        let expected = json_file(&root().join(format!("tests/truth/probe-lobing-{data}-expected.json")));
        let number = |value: &Value| value.as_f64().expect("a number");
        let mut checked = 0;
        let mut check = |begins: &str, ends: &str, expected: &Value| {
            let form = figure(data, "joint", begins, ends);
            assert!((form - number(&expected["range_um"])).abs() < 1e-3, "{data} {begins} {form}");
            checked += 1;
        };
        check("P_FTU,2D[ring 32", "60 mm/min]", &expected["ring36"]);
        check("P_FTU,3D[ball 31", "60 mm/min]", &expected["sphere25"]);
        for gauge in expected["lobing"].as_array().expect("gauges") {
            let (angle, feed) = (number(&gauge["S_deg"]), number(&gauge["feed_mm_per_min"]));
            check("P_FTU,3D[sphere 31", &format!(", S {angle} deg, {feed} mm/min]"), gauge);
            let deviation =
                figure(data, "joint", "standard deviation[sphere", &format!(", S {angle} deg, {feed} mm/min]"));
            assert!((deviation - number(&gauge["std_um"])).abs() < 1e-3);
        }
        assert_eq!(checked, 10);
    }
    // With the lobing of the sphere alone taken off.
    assert!((figure("exact", "qualified", "P_FTU,2D[ring", "corrected]") - 0.902).abs() < 1e-3);
    assert!((figure("exact", "qualified", "P_FTU,3D[ball", "corrected]") - 1.114).abs() < 1e-3);
}

/// What an estimate from the sphere says of its unknowns: those of the null space, and whether its estimate was refused.
fn lost(parameters: &[&str], keep: Option<Value>, probe: &[&str], form: &[&str]) -> String {
    let mut recipe = recipe("exact").only(&[]);
    if let Some(keep) = keep {
        recipe = recipe.set("sphere-touches", "keep", keep);
    }
    let list = recipe.0["stages"]["nominal"]["probe"].as_array_mut().expect("terms");
    list.extend(probe.iter().map(|term| json!(term)));
    recipe.0["stages"]["nominal"]["errors"]
        .as_array_mut()
        .expect("errors")
        .push(json!({ "polynomial": ["EXX"], "degrees": [1] }));
    let own = recipe.0["stages"]["sphere"]["form"].as_array_mut().expect("a form");
    own.extend(form.iter().map(|term| json!(term)));
    recipe.0["stages"]["sphere"]["diameters"] = json!([{ "feature": 31, "estimated": true }]);
    recipe.0["stages"]["one"] = json!({ "estimate": "gauss-newton", "machine": "nominal", "observations": ["sphere"],
        "parameters": parameters });
    let folder = temporary();
    let printed = abbe(folder.path(), &["check", recipe.write(folder.path()).to_str().expect("UTF-8")]);
    printed.stdout + &printed.stderr
}

#[test]
fn what_a_sphere_cannot_tell_is_said() {
    let all = |more: &[&'static str]| -> Vec<&'static str> { [&PLACE[..], &["probe.*"], &FORM[..], more].concat() };
    let told = lost(&all(&[]), None, &[], &[]);
    let words: Vec<&str> = told.split_whitespace().collect();
    assert!(words.windows(4).any(|words| words == ["one", "872", "24", "24"]), "{told}");
    let file = recipe("exact").path("sphere-touches", "path");
    let text = read(&file);
    let lines: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
    let feed = lines[0].iter().position(|name| *name == "feed_mm_per_min").expect("a feed");
    let one_feed: Vec<&str> = lines.iter().filter(|line| line[feed] == "30.0").map(|line| line[0]).collect();
    assert_eq!(one_feed.len(), 436);
    for (parameters, keep, probe, form, names) in [
        (all(&["sphere.*.diameter"]), None, &[][..], &[][..], &["probe.r0", "diameter"][..]),
        (all(&["dzt"]), None, &[], &[], &["dzt", "ball[31].z"]),
        (all(&[]), Some(json!({ "touch": one_feed })), &[], &[], &["probe.r0", "probe.delay", "at other feeds"]),
        (all(&["sphere.*[cos0,2]"]), None, &[], &["cos0,2"], &["form[cos0,2]", "lobe[cos0,2]"]),
        (
            all(&["sphere.*[???4]"]),
            None,
            &["lobe[cos4]", "lobe[sin4]"],
            &["cos4", "sin4"],
            &["form[cos4]", "lobe[cos4]"],
        ),
        (all(&["EXX[1]"]), None, &[], &[], &["EXX[1]", "form[cos2]"]),
        (all(&[]), Some(json!({ "group": [1] })), &[], &[], &["form[cos2]", "dxt"]),
    ] {
        let told = lost(&parameters, keep, probe, form);
        for name in names {
            assert!(told.contains(name), "{name} is not named:\n{told}");
        }
        assert!(told.contains("Not determined"), "{told}");
        assert!(told.contains("do not change when") || told.contains("cannot be told apart"), "{told}");
    }
}

/// Another machine: a head that carries two styli, and a sphere and plane faces that they touch.
fn other_machine(folder: &std::path::Path, seed: u64) -> (Value, Value) {
    let mut random = crate::controls::law::uniform(seed);
    let (mut touches, mut balls) = (
        String::from("feature,X_mm,Y_mm,Z_mm,C_deg,A_deg,S_deg,stylus,feed_mm_per_min\n"),
        String::from("feature,x_mm,y_mm,z_mm,diameter_mm\n"),
    );
    balls.push_str("1,40,25,60,20\n");
    let mut faces = String::from("feature,X_mm,Y_mm,Z_mm,C_deg,A_deg,S_deg,stylus,feed_mm_per_min\n");
    let mut facets = String::from("feature,x_mm,y_mm,z_mm,nx,ny,nz\n");
    for (index, normal) in [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1]].into_iter().enumerate() {
        let [x, y, z] = normal.map(|part| 80.0 * f64::from(part));
        facets.push_str(&format!("{},{x},{y},{},{},{},{}\n", index + 11, z + 40.0, normal[0], normal[1], normal[2]));
    }
    for stylus in [1, 2] {
        for spindle in [0.0, 65.0, 150.0, 270.0] {
            for feed in [40.0, 160.0] {
                for step in 0..40 {
                    // Directions all over the upper hemisphere, and a little around to make each set of touches another one.
                    let height = 0.02 + 0.96 * f64::from(step) / 39.0;
                    let (azimuth, across) =
                        (2.399_963 * f64::from(step) + 0.3 * random(), (1.0 - height * height).sqrt());
                    let [x, y, z] = [across * azimuth.cos(), across * azimuth.sin(), height].map(|part| 12.0 * part);
                    // The simulation moves the linear axes until there is contact.
                    touches.push_str(&format!(
                        "1,{},{},{},0,0,{spindle},{stylus},{feed}\n",
                        40.0 + x,
                        25.0 + y,
                        60.0 + z + 150.0
                    ));
                }
            }
        }
        for tilt in [0.0, 40.0, -55.0] {
            for turn in [0.0, 75.0, 200.0] {
                for facet in 11..16 {
                    faces.push_str(&format!("{facet},0,0,200,{turn},{tilt},30,{stylus},80\n"));
                }
            }
        }
    }
    let rings = "feature,x_mm,y_mm,z_mm,ax,ay,az,diameter_mm\n5,-60,30,50,0,0.6,0.8,40\n".to_owned();
    let mut bores = String::from("feature,X_mm,Y_mm,Z_mm,C_deg,A_deg,S_deg,stylus,feed_mm_per_min\n");
    for step in 0..24 {
        // Across the axis: the table's x, and (0, 0.8, -0.6).
        let (sine, cosine) = (f64::from(step) * std::f64::consts::PI / 12.0).sin_cos();
        let [x, y, z] = [-60.0 + 18.0 * cosine, 30.0 + 14.4 * sine, 50.0 - 10.8 * sine];
        bores.push_str(&format!("5,{x},{y},{},0,0,{},1,80\n", z + 150.0, if step % 2 == 0 { 0 } else { 90 }));
    }
    for (name, text) in [
        ("rings.csv", &rings),
        ("bores.csv", &bores),
        ("touches.csv", &touches),
        ("balls.csv", &balls),
        ("faces.csv", &faces),
        ("facets.csv", &facets),
    ] {
        write(&folder.join(name), text);
    }
    let terms = ["r0", "delay", "lobe[cos0,2]", "lobe[cos3]", "lobe[sin3]", "lobe[cos2]", "lobe[sin2,1]"];
    let recipe = json!({ "abbe": 1, "name": "star", "stages": {
        "touches": { "ingest": "csv", "path": "touches.csv" }, "faces": { "ingest": "csv", "path": "faces.csv" },
        "bores": { "ingest": "csv", "path": "bores.csv" },
        "bore": { "artefact": "rings", "from": "bores", "nominal": "rings.csv", "standard_uncertainty_um": 0.4,
            "diameters": [{ "feature": 5, "standard_uncertainty_um": 0.1 }] },
        "sphere": { "artefact": "balls", "from": "touches", "nominal": "balls.csv", "standard_uncertainty_um": 0.3, "form": ["cos2", "sin2"] },
        "block": { "artefact": "facets", "from": "faces", "nominal": "facets.csv", "standard_uncertainty_um": 0.5 },
        "machine": { "model": "serial-chain", "chain": "w C' A' Y' b X Z (S) t", "tool_length_mm": 150, "stylus_radius_mm": 2,
            "styli": { "2": { "tip_mm": [30, 0, -150] } }, "probe": terms,
            "axes": { "X": { "range_mm": [-500, 500] }, "Y": { "range_mm": [-500, 500] }, "Z": { "range_mm": [-500, 800] } },
            "errors": [{ "location": ["EA0C", "EB0C", "EC0A"] }, { "polynomial": ["EYX"], "degrees": [1] }] },
        "fit": { "estimate": "gauss-newton", "machine": "machine", "observations": ["sphere", "block", "bore"],
            "parameters": ["probe.*", "stylus[2].*", "dxt", "dyt", "EA0C", "EB0C", "sphere.*", "block.*", "bore.*"] },
    } });
    let mut truth = json!({ "EA0C": 2e-5 * (random() - 0.5), "EB0C": 3e-5 * (random() - 0.5), "dxt": 0.02 * random(), "dyt": -0.03 * random(),
        "stylus[2].x": 0.01, "stylus[2].y": -0.02 * random(), "stylus[2].z": 0.015,
        "ball[1].x": 0.01, "ball[1].y": -0.015, "ball[1].z": 0.02 * random(),
        "ring[5].x": 0.03 * random(), "ring[5].y": -0.02, "ball[1].form[cos2]": 2e-4 * random(), "ball[1].form[sin2]": -1e-4 });
    for prefix in ["", "stylus[2]."] {
        for term in terms {
            let size = match term {
                "r0" => 0.02,
                "delay" => 0.005,
                _ => 0.006,
            };
            truth[format!("{prefix}probe.{term}")] = json!(size * (random() - 0.5));
        }
    }
    for facet in 11..16 {
        truth[format!("facet[{facet}].d")] = json!(0.04 * (random() - 0.5));
    }
    (recipe, truth)
}

#[test]
fn a_star_probe_on_another_machine() {
    let machines = std::env::var("ABBE_PROBE_MACHINES").ok().and_then(|number| number.parse().ok()).unwrap_or(6);
    for seed in 1..=machines {
        let folder = temporary();
        let (recipe, truth) = other_machine(folder.path(), seed);
        let file = folder.path().join("recipe.yaml");
        write(&file, &recipe.to_string());
        let stated = folder.path().join("truth.json");
        write(&stated, &json!({ "parameters": truth }).to_string());
        let simulated = prepare(&file, &crate::support::registry())
            .and_then(|prepared| prepared.simulate(&stated, seed, None))
            .unwrap_or_else(|error| panic!("{error}"));
        let out = folder.path().join("measured");
        simulated.write(&out).unwrap_or_else(|error| panic!("{error}"));
        let outcome = prepare(&out.join(&simulated.recipe), &crate::support::registry())
            .and_then(|prepared| prepared.run(&abbe_core::Monitor::default()))
            .unwrap_or_else(|error| panic!("{error}"));
        let found = &fit(&outcome, "fit").calibration;
        assert_eq!(found.fit.rank, found.fit.unknowns, "{seed}: {:?}", found.fit.null_space);
        // Derivatives at these values, against differences: tips, orientations, unknowns and terms of the probe.
        let problem = fit(&outcome, "fit").problem.starting_from(found);
        for set in problem.set_indices() {
            let broken = abbe_estimation::laws::check_observations(&problem, set).expect("poses");
            assert!(broken.is_empty(), "{seed}: {broken:?}");
        }
        let mut compared = 0;
        for value in values(found).filter(|value| value.status == Status::Estimated) {
            let name = own_name(&value.name);
            let expected = truth[name].as_f64().unwrap_or_else(|| panic!("no truth of {name}"));
            assert!((value.value - expected).abs() < 2e-9, "seed {seed}: {name} is {} and not {expected}", value.value);
            compared += 1;
        }
        assert_eq!(compared, 14 + 3 + 2 + 2 + 5 + 5 + 2, "{seed}");
    }
}

#[test]
fn the_exported_radii_are_those_of_azimuth_and_elevation() {
    let outcome = outcome("exact");
    let (_, files) = outcome.exports.iter().find(|(stage, _)| stage == "radii").expect("a table");
    let text = String::from_utf8(files[0].content.clone()).expect("text");
    let truth = truth("exact");
    let mut rows = 0;
    for line in text.lines().skip(1) {
        let cells: Vec<f64> = line.split(',').map(|cell| cell.parse().expect("a number")).collect();
        let (feed, azimuth, elevation) = (cells[1], cells[2].to_radians(), cells[3].to_radians());
        let mut radius = 3.0 + truth["probe.r0"].as_f64().expect("a number") - 0.0038 * feed / 60.0;
        for (name, value) in &truth {
            let Some(term) = name.strip_prefix("probe.lobe[").and_then(|rest| rest.strip_suffix(']')) else { continue };
            let (around, along) = term[3..].split_once(',').unwrap_or((&term[3..], "0"));
            let (around, along): (i32, i32) = (around.parse().expect("a number"), along.parse().expect("a number"));
            let turning = if term.starts_with("cos") {
                (f64::from(around) * azimuth).cos()
            } else {
                (f64::from(around) * azimuth).sin()
            };
            radius += value.as_f64().expect("a number")
                * turning
                * elevation.cos().powi(around)
                * elevation.sin().powi(along);
        }
        assert!((cells[7] - radius).abs() < 6e-7, "{line}: {radius}");
        rows += 1;
    }
    assert_eq!(rows, 3 * (3 * 12 + 1));
}

/// A file of touches whose feeds are multiplied.
fn with_feeds(file: &str, factor: f64) -> String {
    let text = read(&root().join(file));
    let place = text.lines().next().and_then(|header| header.split(',').position(|name| name == "feed_mm_per_min"));
    let place = place.expect("a column of feeds");
    let rows = text.lines().enumerate().map(|(line, row)| {
        let cells = row.split(',').enumerate().map(|(column, cell)| match line > 0 && column == place {
            true => (cell.parse::<f64>().expect("a number") * factor).to_string(),
            false => cell.to_owned(),
        });
        cells.collect::<Vec<_>>().join(",")
    });
    rows.collect::<Vec<_>>().join("\n") + "\n"
}

#[test]
fn feeds_in_another_unit_do_not_pass_silently() {
    let run = |stage: &str, file: &str, factor: f64, wanted: &[&str]| {
        let folder = temporary();
        write(&folder.path().join("touches.csv"), &with_feeds(file, factor));
        recipe("realistic").only(wanted).set(stage, "path", json!("touches.csv")).write(folder.path());
        abbe(folder.path(), &["run", "recipe.yaml", "--out", "out"])
    };
    let sphere = "pipelines/data/probe-lobing/realistic/touches-lobing.csv";
    let table = "pipelines/data/probe-lobing/realistic/touches-facets.csv";
    // mm/s under mm/min: the delay is sixty times as long, and the feeds are no touches.
    let slow = run("sphere-touches", sphere, 1.0 / 60.0, &["qualified"]);
    assert_eq!(slow.status, 1, "{}", slow.stderr);
    for told in ["probe.delay = 0.2", "0.05 s is plausible at most", "plausible: { s:", "feeds from 0.5 to 2 mm/min"] {
        assert!(slow.stderr.contains(told), "`{told}` is not in\n{}", slow.stderr);
    }
    // With a known delay nothing but the feeds tells it.
    let known = run("table-touches", table, 1.0 / 60.0, &["qualified", "corrected"]);
    assert!(known.stderr.contains("touches have feeds from 1 to 1 mm/min"), "{}", known.stderr);
    // The other way round.
    let fast = run("sphere-touches", sphere, 60.0, &["qualified"]);
    assert!(fast.stderr.contains("feeds from 1800 to 7200 mm/min"), "{}", fast.stderr);
    // A delay before the contact.
    let folder = temporary();
    let text = read(&root().join(sphere));
    let swapped = text.replace(",30.0,", ",x,").replace(",120.0,", ",30.0,").replace(",x,", ",120.0,");
    write(&folder.path().join("touches.csv"), &swapped);
    recipe("realistic").only(&["qualified"]).set("sphere-touches", "path", json!("touches.csv")).write(folder.path());
    let early = abbe(folder.path(), &["run", "recipe.yaml", "--out", "out"]);
    assert!(early.stderr.contains("probe.delay = -0.00378 s is large for such an error"), "{}", early.stderr);
    let right = run("sphere-touches", sphere, 1.0, &["qualified"]);
    assert!((right.status, right.stderr.as_str()) == (0, ""), "{}", right.stderr);
}
