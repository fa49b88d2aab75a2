//! `abbe model`, and the location errors of every chain of three to five axes: what is told is checked by the rank of derivatives.

use std::collections::BTreeSet;

use abbe_core::{Context, Kind, KinematicModel, Poses, Variable};
use abbe_engine::{LocationErrors, Standing, prepare_text};
use nalgebra::DMatrix;
use serde_json::json;

use crate::support::{Variant, abbe, as_typed, recipes, registry, root, temporary, write};

/// Every chain of `linear` and some rotary axes, in every order, with the bed at every place.
fn chains(axes: &[&str]) -> Vec<String> {
    let mut orders: Vec<Vec<&str>> = vec![Vec::new()];
    for _ in axes {
        orders = orders
            .iter()
            .flat_map(|order| {
                let rest = axes.iter().filter(|axis| !order.contains(axis));
                rest.map(|axis| [order.as_slice(), &[*axis]].concat()).collect::<Vec<_>>()
            })
            .collect();
    }
    let with_bed = |order: &Vec<&str>| -> Vec<String> {
        (0..=order.len())
            .map(|bed| {
                let (workpiece, tool) = order.split_at(bed);
                format!("w {} b {} t", workpiece.join(" "), tool.join(" "))
                    .split_whitespace()
                    .collect::<Vec<_>>()
                    .join(" ")
            })
            .collect()
    };
    orders.iter().flat_map(with_bed).collect()
}

pub(crate) fn all_chains() -> Vec<String> {
    let sets: [&[&str]; 7] = [
        &["X", "Y", "Z"],
        &["X", "Y", "Z", "A"],
        &["X", "Y", "Z", "B"],
        &["X", "Y", "Z", "C"],
        &["X", "Y", "Z", "A", "C"],
        &["X", "Y", "Z", "B", "C"],
        &["X", "Y", "Z", "A", "B"],
    ];
    sets.into_iter().flat_map(chains).collect()
}

fn machine(chain: &str) -> (LocationErrors, std::sync::Arc<dyn KinematicModel>) {
    let text = format!(
        "abbe: 1\nname: t\nstages:\n  m:\n    model: serial-chain\n    chain: {chain}\n    tool_length_mm: 130\n    stylus_radius_mm: 0\n    errors: [{{ location: [\"E?0?\"] }}]\n"
    );
    let prepared = prepare_text(std::path::Path::new("t.yaml"), &text, &registry())
        .unwrap_or_else(|error| panic!("{chain}: {error}"));
    let described = prepared.described().unwrap_or_else(|error| panic!("{chain}: {error}")).remove(0);
    (described.locations.expect("a chain has location errors"), described.model)
}

/// Rank of the derivatives of poses to some parameters, at commands of their own, by singular values.
fn rank(model: &dyn KinematicModel, names: &[&str]) -> usize {
    let info = model.info();
    let mut random = crate::controls::law::uniform(77);
    let mut statuses = Vec::new();
    for _ in 0..40 {
        let mut status = vec![0.0; info.status.len()];
        for axis in &info.axes {
            status[axis.status] = random() * if axis.kind == abbe_core::AxisKind::Linear { 300.0 } else { 1.5 };
        }
        statuses.extend(status);
    }
    let wanted: Vec<Variable> =
        names.iter().map(|name| Variable::Parameter(info.parameter(name).expect("a parameter"))).collect();
    let mut poses = Poses::default();
    model.poses(&statuses, &info.nominal, &wanted, true, &mut poses).expect("poses");
    let rows = 2 * poses.position_derivatives.len() / wanted.len();
    let entry = |row: usize, column: usize| {
        let (pose, part) = (row / 6, row % 6);
        let at = pose * wanted.len() + column;
        if part < 3 { poses.position_derivatives[at][part] } else { 200.0 * poses.rotation_derivatives[at][part - 3] }
    };
    let mut matrix = DMatrix::from_fn(3 * rows, wanted.len(), entry);
    for mut column in matrix.column_iter_mut() {
        let norm = column.norm();
        if norm > 0.0 {
            column /= norm;
        }
    }
    let singular = matrix.singular_values();
    singular.iter().filter(|value| **value > 1e-9 * singular[0]).count()
}

const SET_UP: [&str; 12] = ["dxt", "dyt", "dzt", "dat", "dbt", "dct", "dxw", "dyw", "dzw", "daw", "dbw", "dcw"];

fn names<'a>(more: &[&'a str]) -> Vec<&'a str> {
    [SET_UP.as_slice(), more].concat()
}

/// Checks what is told of one chain.
fn check(chain: &str) {
    let (locations, model) = machine(chain);
    let all: Vec<&str> = locations.all.iter().map(|error| error.name.as_str()).collect();
    let independent: Vec<&str> = locations.independent().map(|error| error.name.as_str()).collect();
    let set_up = rank(model.as_ref(), &SET_UP);
    let whole = rank(model.as_ref(), &names(&all));
    assert_eq!(whole, set_up + independent.len(), "{chain}: the set is not as large as what there is");
    assert_eq!(rank(model.as_ref(), &names(&independent)), whole, "{chain}: {independent:?} are not independent");
    assert_eq!(locations.by_pose.0, whole, "{chain}");
    for error in &locations.all {
        let name = error.name.as_str();
        match &error.standing {
            Standing::SetUp => {
                assert_eq!(rank(model.as_ref(), &names(&[name])), set_up, "{chain}: {name} is not set-up")
            }
            Standing::Dependent(of) => {
                assert_ne!(rank(model.as_ref(), &names(&[name])), set_up, "{chain}: {name} is set-up alone");
                let members: Vec<&str> = of.iter().map(|(member, _)| member.as_str()).collect();
                let with = [members.as_slice(), &[name]].concat();
                assert_eq!(
                    rank(model.as_ref(), &names(&with)),
                    set_up + members.len(),
                    "{chain}: {name} is not {of:?}"
                );
            }
            Standing::Independent { substitutes, .. } => {
                for substitute in substitutes {
                    let others: Vec<&str> = independent.iter().copied().filter(|other| *other != name).collect();
                    let exchanged = [others.as_slice(), &[substitute.as_str()]].concat();
                    assert_eq!(
                        rank(model.as_ref(), &names(&exchanged)),
                        whole,
                        "{chain}: {substitute} does not replace {name}"
                    );
                }
            }
        }
    }
}

#[test]
fn location_errors_of_every_chain_of_three_axes_are_independent() {
    for chain in all_chains().iter().filter(|chain| chain.split_whitespace().count() == 6) {
        check(chain);
        // The three squarenesses.
        assert_eq!(machine(chain).0.independent().count(), 3, "{chain}");
    }
}

/// A part of the chains of four and five axes here, other ones for each of the remainders; all of them by `ABBE_MODEL_CHAINS=1`.
#[test]
fn location_errors_of_chains_of_four_and_five_axes_are_independent() {
    let step = std::env::var("ABBE_MODEL_CHAINS").ok().and_then(|step| step.parse().ok()).unwrap_or(37);
    let chains: Vec<String> = all_chains().into_iter().filter(|chain| chain.split_whitespace().count() > 6).collect();
    assert_eq!(chains.len(), 3 * 120 + 3 * 720);
    let mut counts: BTreeSet<(usize, usize)> = BTreeSet::new();
    for chain in chains.iter().step_by(step) {
        check(chain);
        counts.insert((chain.split_whitespace().count() - 3, machine(chain).0.independent().count()));
    }
    println!("axes and independent location errors: {counts:?}");
}

#[test]
fn what_one_tip_tells_does_not_count_rounding() {
    // A turn of the last axis about itself does not move the tip: nine of set-up, and six of these machines.
    for chain in ["w b X Y Z B C t", "w b X Y Z A C t", "w X' b Y Z B C t", "w X' Y' b Z A C t", "w A' X' b Y Z C t"] {
        assert_eq!(machine(chain).0.by_position.0, 15, "{chain}");
    }
}

#[test]
fn the_squareness_of_x_and_y_has_the_name_of_the_axis_that_is_carried() {
    let is_independent = |chain: &str, name: &str| machine(chain).0.independent().any(|error| error.name == name);
    // A turn of the axis next to the bed turns everything: its partner has the name.
    assert!(is_independent("w b Y X Z t", "EC0X") && !is_independent("w b Y X Z t", "EC0Y"));
    assert!(is_independent("w b X Y Z t", "EC0Y") && !is_independent("w b X Y Z t", "EC0X"));
    assert!(is_independent("w X' Y' b Z t", "EC0X") && !is_independent("w X' Y' b Z t", "EC0Y"));
}

#[test]
fn a_machine_is_shown_by_chain_by_file_and_by_recipe() {
    let printed = abbe(&root(), &["model", "w C' A' b X Y Z t"]);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    insta::assert_snapshot!("chain", printed.stdout);
    let printed = abbe(&root(), &["model", "pipelines/robot-ur5.yaml"]);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    assert!(printed.stdout.contains("positions of one tip tell 27"), "{}", printed.stdout);
    insta::assert_snapshot!("robot", printed.stdout);
    let folder = temporary();
    write(
        &folder.path().join("machine.yaml"),
        "name: K\nchain: w B' b X Y Z t\ntool_length_mm: 100\nstylus_radius_mm: 1\naxes: { X: { range_mm: [0, 500] } }\n",
    );
    let printed = abbe(folder.path(), &["model", "machine.yaml"]);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    assert!(printed.stdout.contains("0 to 500 mm"), "{}", printed.stdout);
    let printed = as_typed(folder.path(), &["model", "w Q b X t"]);
    assert_eq!(printed.status, 2, "{}", printed.stdout);
    assert!(!printed.stderr.contains("chain.yaml"), "{}", printed.stderr);
}

/// A confounded location error is told with the one that stands in its place; one that is not listed, too.
#[test]
fn check_names_the_substitute_of_a_location_error() {
    let mut recipe = Variant::of(&recipes()["first-steps"]);
    recipe.stage("machine")["errors"][0]["location"].as_array_mut().expect("a list").push(json!("EC0B"));
    recipe.stage("machine")["errors"] =
        json!([{ "location": ["E?0B", "E?0C", "E?0X", "E?0Y", "E?0Z", "EX0S", "EY0S"] }]);
    recipe.stage("fit")["parameters"] = json!(["dxt", "dyt", "dzt", "E?0?", "table.*"]);
    let folder = temporary();
    let file = recipe.write(folder.path());
    let printed = abbe(folder.path(), &["check", file.to_str().expect("UTF-8"), "--explain"]);
    assert!(printed.stdout.contains("on this chain `"), "{}{}", printed.stdout, printed.stderr);
    let mut recipe = Variant::of(&recipes()["first-steps"]);
    recipe.stage("fit")["parameters"] = json!(["dxt", "EB0X"]);
    let file = recipe.write(folder.path());
    let printed = as_typed(folder.path(), &["check", file.to_str().expect("UTF-8")]);
    assert_eq!(printed.status, 2);
    assert!(printed.stderr.contains("on this chain `EB0X`"), "{}", printed.stderr);
}

/// What is told of an unknown or superfluous location error leads to an estimate without one, whatever is listed and estimated.
#[test]
fn advice_on_location_errors_comes_to_an_end() {
    let chains = all_chains();
    let folder = temporary();
    for seed in 1..=60 {
        let mut random = crate::controls::law::uniform(seed);
        let chain = &chains[(random() * chains.len() as f64) as usize % chains.len()];
        let (locations, _) = machine(chain);
        let all: Vec<String> = locations.all.iter().map(|error| error.name.clone()).collect();
        let mut listed: Vec<String> = all.iter().filter(|_| random() < 0.2).cloned().collect();
        let asked = all[(random() * all.len() as f64) as usize % all.len()].clone();
        listed.retain(|name| *name != asked);
        let mut wanted: Vec<String> = listed.iter().filter(|_| random() < 0.5).cloned().collect();
        wanted.push(asked.clone());
        write(&folder.path().join("poses.csv"), &some_poses(chain, seed));
        let mut told = Vec::new();
        loop {
            let text = estimate_of(chain, &listed, &wanted);
            let prepared = prepare_text(&folder.path().join("t.yaml"), &text, &registry())
                .unwrap_or_else(|error| panic!("{chain}: {error}"));
            let advice = match prepared.check() {
                Ok(planned) => {
                    planned[0].identifiability.remarks.iter().find(|text| text.contains("on this chain")).cloned()
                }
                Err(error) => error.help.clone(),
            };
            let Some(advice) = advice else { break };
            told.push(advice.clone());
            assert!(told.len() <= wanted.len() + 2, "{chain}, {listed:?}, {wanted:?}: {told:#?}");
            let names: Vec<String> = advice.split('`').skip(1).step_by(2).map(str::to_owned).collect();
            let of_chain = |text: &str| -> Vec<String> {
                text.split('`')
                    .skip(1)
                    .step_by(2)
                    .filter(|name| all.iter().any(|own| own == name))
                    .map(str::to_owned)
                    .collect()
            };
            let subject = names.iter().find(|name| all.contains(name)).expect("a location error").clone();
            if let Some((_, rest)) = advice.split_once("estimate ") {
                let (instead, rest) = rest.split_once(" in its place").expect("what is estimated instead");
                wanted.retain(|name| *name != subject);
                for name in of_chain(instead) {
                    assert!(!wanted.contains(&name), "{chain}: {advice}");
                    wanted.push(name);
                }
                if let Some((unlisted, _)) = rest.split_once("to be listed") {
                    let unlisted = unlisted.split(';').next_back().unwrap_or_default();
                    listed.extend(of_chain(unlisted));
                }
            } else if advice.contains("list it under `errors`") {
                listed.push(subject);
            } else {
                assert!(advice.contains("leave"), "{chain}: {advice}");
                wanted.retain(|name| *name != subject);
            }
        }
        // One step about what was asked: nothing that is proposed is refused.
        let about: Vec<&String> = told.iter().filter(|advice| advice.contains(&format!("`{asked}`"))).collect();
        assert!(about.len() <= 2, "{chain}: {told:#?}");
    }
}

/// Poses of a chain, its own axes all moving.
fn some_poses(chain: &str, seed: u64) -> String {
    let mut random = crate::controls::law::uniform(seed);
    let axes: Vec<&str> =
        chain.split_whitespace().filter(|word| word.chars().all(|c| c.is_ascii_uppercase())).collect();
    let unit = |axis: &&str| if ["A", "B", "C"].contains(axis) { "deg" } else { "mm" };
    let mut text =
        axes.iter().map(|axis| format!("{axis}_{}", unit(axis))).collect::<Vec<_>>().join(",") + ",x_mm,y_mm,z_mm\n";
    for _ in 0..40 {
        let command = |axis: &&str, random: f64| (random - 0.5) * if unit(axis) == "deg" { 160.0 } else { 600.0 };
        let cells: Vec<String> = axes.iter().map(|axis| command(axis, random()).to_string()).collect();
        let seen: Vec<String> = (0..3).map(|_| (random() * 400.0).to_string()).collect();
        text.push_str(&([cells, seen].concat().join(",") + "\n"));
    }
    text
}

fn estimate_of(chain: &str, listed: &[String], wanted: &[String]) -> String {
    let errors = if listed.is_empty() { "[]".to_owned() } else { format!("[{{ location: {} }}]", json!(listed)) };
    let mut parameters = wanted.to_vec();
    parameters.extend(["dxt", "dyt", "dzt", "tracker.*"].map(str::to_owned));
    format!(
        "abbe: 1\nname: t\nstages:\n  poses: {{ ingest: csv, path: poses.csv }}\n  tracker: {{ artefact: positions, from: poses, standard_uncertainty_um: 2 }}\n  m:\n    model: serial-chain\n    chain: {chain}\n    tool_length_mm: 130\n    stylus_radius_mm: 0\n    errors: {errors}\n  fit: {{ estimate: gauss-newton, machine: m, observations: tracker, parameters: {}, trust_uncertainties: true }}\n",
        json!(parameters)
    )
}

/// The user's own file is named, whatever is wrong with it.
#[test]
fn what_is_wrong_with_a_machine_file_names_it() {
    let folder = temporary();
    let good = "name: K\nchain: w b X Y Z t\ntool_length_mm: 100\nstylus_radius_mm: 1\n";
    for text in [
        good.replace("tool_length_mm: 100\n", ""),
        good.replace("chain: w b X Y Z t\n", ""),
        good.replace("X Y Z", "X Y Q"),
        good.replace("chain:", "chian:"),
        good.replace("100", "1e99"),
        String::new(),
        "- 3\n".to_owned(),
    ] {
        write(&folder.path().join("mill.yaml"), &text);
        let printed = as_typed(folder.path(), &["model", "mill.yaml"]);
        assert_eq!(printed.status, 2, "{text}{}", printed.stdout);
        assert!(printed.stderr.contains("mill.yaml") && !printed.stderr.contains("machine.yaml"), "{}", printed.stderr);
        assert!(!printed.stderr.contains("around it") && !printed.stderr.contains("stage `"), "{}", printed.stderr);
    }
}

/// An indexed axis of the workpiece side is drawn as it is read.
#[test]
fn what_is_drawn_is_read() {
    for chain in ["w (C') b X Y Z t", "w (C)' b X Y Z t"] {
        let printed = abbe(&root(), &["model", chain]);
        assert_eq!(printed.status, 0, "{chain}: {}", printed.stderr);
        assert!(printed.stdout.contains("workpiece --- (C') ---"), "{}", printed.stdout);
    }
}

/// A robot of four joints, one of them linear, is one, and what rounding leaves of a zero is not shown.
#[test]
fn a_scara_is_shown_as_a_robot() {
    let folder = temporary();
    let text = "robot:\n  modified_dh:\n    - { d_mm: 300, theta_deg: 20 }\n    - { a_mm: 325, theta_deg: -40 }\n    - { a_mm: 275, alpha_deg: 180, linear: true, d_mm: 50 }\n    - { theta_deg: 30 }\n  tip_mm: [0, 0, 20]\ntool_length_mm: 0\nstylus_radius_mm: 0\n";
    write(&folder.path().join("scara.yaml"), text);
    let printed = abbe(folder.path(), &["model", "scara.yaml"]);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    for words in ["Product of exponentials", "(`dh`)", "(`modified_dh`, Craig)", "Linear joints (`linear: true`): Z1."]
    {
        assert!(printed.stdout.contains(words), "{words}: {}", printed.stdout);
    }
    assert!(!printed.stdout.contains("e-1"), "{}", printed.stdout);
    let printed = abbe(&root(), &["model", "w b X Y Z B C t"]);
    assert!(!printed.stdout.contains("Denavit"), "{}", printed.stdout);
}

/// Zero positions are told apart by what they are, and by whether the machine lists them.
#[test]
fn zero_positions_that_are_listed_are_marked() {
    let folder = temporary();
    let machine = "chain: w b C1 B1 B2 t\ntool_length_mm: 100\nstylus_radius_mm: 0\naxes: { B2: { point_mm: [300, 0, 0] } }\nerrors: [{ location: [EB0B2] }]\n";
    write(&folder.path().join("arm.yaml"), machine);
    let printed = abbe(folder.path(), &["model", "arm.yaml"]);
    let zero = printed
        .stdout
        .split("\nZero positions")
        .nth(1)
        .and_then(|rest| rest.split("\nFree").next())
        .unwrap_or_default();
    assert!(
        zero.contains("EB0B2 (listed)") && zero.contains("EC0C1") && !zero.contains("EC0C1 (listed)"),
        "{}",
        printed.stdout
    );
    assert!(zero.contains("one that is not listed is zero"), "{zero}");
}

/// Random robots: their lines, turned into Denavit-Hartenberg parameters by the program, are the same robot again.
#[test]
fn parameters_of_robots_give_their_lines_back() {
    let built = |settings: serde_json::Value| {
        let registry = registry();
        let plugin = registry.find(Kind::Model, "serial-chain").expect("the model");
        let abbe_core::Build::Model(constructor) = &plugin.build else { panic!("no model") };
        let model = constructor.build(&settings, &Context { base: std::path::PathBuf::new() }).expect("settings");
        model.build(&[]).expect("a model")
    };
    for seed in 1..=30 {
        let mut random = crate::controls::law::uniform(seed);
        let joints = 3 + (seed % 5) as usize;
        let mut lines = vec![json!({ "direction": [0, 0, 1] })];
        for _ in 1..joints {
            // Some are parallel to others, some cross them.
            let direction = match (random() * 4.0) as i64 {
                0 => [0.0, 0.0, 1.0],
                1 => [0.0, 1.0, 0.0],
                2 => [-1.0, 0.0, 0.0],
                _ => [random(), random(), 0.2 + random()],
            };
            let is_linear = random() < 0.2;
            let point = [400.0 * random(), if random() > 0.3 { 0.0 } else { 100.0 * random() }, 500.0 * random()];
            lines.push(json!({ "direction": direction, "point_mm": point, "linear": is_linear }));
        }
        let tip = [300.0 * random(), 20.0, 200.0];
        let settings = |robot: serde_json::Value| json!({ "robot": robot, "tool_length_mm": 0, "stylus_radius_mm": 0 });
        let robot = json!({ "lines": lines, "tip_mm": tip });
        let folder = temporary();
        write(&folder.path().join("robot.yaml"), &settings(robot.clone()).to_string());
        let printed = abbe(folder.path(), &["model", "robot.yaml"]);
        assert_eq!(printed.status, 0, "{}", printed.stderr);
        let one = built(settings(robot));
        for (title, key) in [("Denavit-Hartenberg parameters (`dh`)", "dh"), ("Modified ones", "modified_dh")] {
            let table = printed.stdout.split(title).nth(1).unwrap_or_else(|| panic!("{}", printed.stdout));
            let rows: Vec<Vec<&str>> =
                table.lines().skip(2).take(joints).map(|line| line.split_whitespace().collect()).collect();
            let number = |text: &str| -> f64 { text.parse().unwrap_or_else(|_| panic!("{text}")) };
            let links: Vec<_> = rows
                .iter()
                .map(|row| json!({ "name": row[0], "linear": row[0].starts_with(['X', 'Y', 'Z']), "a_mm": number(row[1]), "alpha_deg": number(row[2]), "d_mm": number(row[3]), "theta_deg": number(row[4]) }))
                .collect();
            let line = printed.stdout.lines().find(|line| line.contains("The tip is at")).expect("the tip");
            let at: Vec<f64> = line.split_whitespace().skip(4).take(3).map(number).collect();
            let other = built(settings(json!({ key: links, "tip_mm": at })));
            // Shown numbers have nine digits.
            for _ in 0..10 {
                let status: Vec<f64> = (0..joints).map(|_| 3.0 * random()).collect();
                let tip = |model: &dyn KinematicModel| {
                    let mut poses = Poses::default();
                    model.poses(&status, &model.info().nominal, &[], false, &mut poses).expect("a pose");
                    nalgebra::Vector3::from(poses.positions[0])
                };
                let apart = (tip(one.as_ref()) - tip(other.as_ref())).norm();
                assert!(apart < 1e-4, "seed {seed}, {key}: {apart} mm\n{}", printed.stdout);
            }
        }
    }
}

/// The formula of a symbol, with its numbers, against tips that the program computes from the model with that error.
#[test]
fn a_symbol_is_explained_by_what_the_model_does() {
    let root = root();
    let told = |arguments: &[&str]| {
        let printed = abbe(&root, &[&["explain"], arguments].concat());
        assert_eq!(printed.status, 0, "{arguments:?}: {}", printed.stderr);
        printed.stdout.split_whitespace().collect::<Vec<_>>().join(" ")
    };
    let chain = "w C' A' b X Y Z t";
    // A table that turns by +10 µrad about z carries a point at (200, 0) to +y by 2 µm: the tool seems to go to -y.
    let text = told(&["EC0C", "--chain", chain, "--at", "X=200,Y=0"]);
    assert!(
        text.contains("(0, -2, 0) µm") && text.contains("-z ×") && text.contains("carries the workpiece"),
        "{text}"
    );
    // A head that turns by +10 µrad about x has its tip 200 mm below: it goes to +y by 2 µm.
    let text = told(&["EA0B", "--chain", "w b X Y Z B t"]);
    assert!(text.contains("(0, 2, 0) µm") && text.contains("carries the tool"), "{text}");
    for (symbol, expected) in [
        ("EXX", "linear positioning of X"),
        ("EAY[2]", "EAY[2] · Y^2"),
        ("EXX[b]", "dir(X)"),
        ("EBC[cos2]", "cos(2 C)"),
        ("dzt", "offset of the tool tip along z"),
        ("EB0Z", "on this chain"),
    ] {
        let text = told(&[symbol, "--chain", chain]);
        assert!(text.contains(expected), "{symbol}: {text}");
    }
    for (symbol, expected) in
        [("EA0Q", "near are `EA0"), ("EXX[spl3]", "is not listed"), ("nonsense", "no error and no parameter")]
    {
        let printed = abbe(&root, &["explain", symbol, "--chain", chain]);
        assert_eq!((printed.status, printed.stdout.as_str()), (2, ""), "{symbol}");
        let said = printed.stderr.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(said.contains(expected), "{symbol}: {said}");
    }
    assert_eq!(abbe(&root, &["explain", "EXX"]).status, 2);
    for position in ["X=1e300", "X=-1e7", "X=inf", "X"] {
        let printed = abbe(&root, &["explain", "EXX", "--chain", chain, "--at", position]);
        assert!(printed.status == 2 && printed.stderr.contains(position), "{}", printed.stderr);
    }
    // A machine file: its own functions, a spline without a formula among them.
    assert!(
        told(&["EX0B1", "--machine", "pipelines/robot-ur5.yaml"]).contains("one of the independent location errors")
    );
}

/// The arrows of the picture are what the model says, on machines of all kinds; a file is not replaced.
#[test]
fn a_machine_is_drawn_with_what_its_errors_do() {
    let folder = temporary();
    for (number, chain) in
        ["w b X Y Z t", "w C' A' b X Y Z t", "w b X Y Z C B t", "w b C1 B1 B2 B3 C2 B4 t", "w b U V W t"]
            .iter()
            .enumerate()
    {
        let file = format!("{number}.svg");
        let printed = abbe(folder.path(), &["model", chain, "--svg", &file]);
        assert_eq!(printed.status, 0, "{chain}: {}", printed.stderr);
        let text = std::fs::read_to_string(folder.path().join(&file)).expect("a picture");
        let axes: Vec<&str> = chain.split_whitespace().filter(|word| !["w", "b", "t"].contains(word)).collect();
        assert_eq!(text.matches("<g><title>").count(), 12 * axes.len(), "{chain}");
        assert_eq!(text.matches("<g>").count(), text.matches("</g>").count(), "{chain}");
        assert!(!text.contains("NaN") && !text.contains("inf"), "{chain}");
        for axis in axes {
            assert!(text.contains(&format!(">EX0{}</text>", axis.trim_end_matches('\''))), "{chain}");
        }
    }
    let text = std::fs::read_to_string(folder.path().join("1.svg")).expect("a picture");
    assert!(text.contains("EX0C: tip (-10, 0, 0) µm"), "the table goes to +x, the tool seems to go to -x");
    assert!(text.contains("EX0X: tip (10, 0, 0) µm"));
    let again = abbe(folder.path(), &["model", "w b X Y Z t", "--svg", "0.svg"]);
    assert!(again.status != 0 && again.stderr.contains("not replaced"), "{}", again.stderr);
    let wrong = abbe(folder.path(), &["model", "w b X Y Z t", "--svg", "new.svg", "--at", "Q=3"]);
    assert!(wrong.status == 2 && !folder.path().join("new.svg").exists(), "{}", wrong.stderr);
}
