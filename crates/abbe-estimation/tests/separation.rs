//! What people are told about directions that were lost, on machines and artefacts of many kinds.

use std::fs;
use std::path::Path;
use std::sync::Arc;

use abbe_balls as _;
use abbe_core::{
    Build, Context, Dataset, Kind, KinematicModel, ObservationSet, Plugin, Poses, Problem, Registry, StatusColumn,
    Variable, WeakDirection,
};
use abbe_estimation::SeparationTrials;
use abbe_facets as _;
use abbe_gauss_newton as _;
use abbe_length as _;
use abbe_serial_chain as _;
use nalgebra::{Matrix3, Vector3};
use serde_json::{Value, json};

fn plugin<T>(kind: Kind, name: &str, take: impl Fn(&Plugin) -> Option<T>) -> T {
    take(Registry::built_in().unwrap().find(kind, name).unwrap()).unwrap()
}

fn model(machine: &Value, context: &Context, data: &[&Dataset]) -> Arc<dyn KinematicModel> {
    plugin(Kind::Model, "serial-chain", |plugin| match &plugin.build {
        Build::Model(constructor) => Some(constructor.build(machine, context).unwrap().build(data).unwrap()),
        _ => None,
    })
}

/// A problem: machine, then (artefact, settings, touches file) in a folder, then patterns of parameters.
fn problem(folder: &Path, machine: &Value, artefacts: &[(&str, Value, &str)], parameters: &[&str]) -> Problem {
    let context = Context { base: folder.to_owned() };
    let data = artefacts.iter().map(|(_, _, file)| Arc::new(abbe_table::read(&folder.join(file)).unwrap()));
    let data: Vec<_> = data.collect();
    let readings: Vec<_> = data.iter().map(Arc::as_ref).collect();
    let model = model(machine, &context, &readings);
    let observed = artefacts.iter().zip(&data).map(|((name, settings, _), data)| {
        let observations = plugin(Kind::Artefact, name, |plugin| match &plugin.build {
            Build::Artefact(constructor) => {
                Some(constructor.build(settings, &context).unwrap().observe(data, &model).unwrap())
            }
            _ => None,
        });
        let stage = match *name {
            "length" => "bar",
            _ => "table",
        };
        ObservationSet::new(stage, observations)
    });
    let sets = observed.collect();
    let patterns: Vec<String> = parameters.iter().map(|pattern| (*pattern).to_owned()).collect();
    Problem::new("fit", "serial-chain", model, sets, &patterns).unwrap()
}

/// The lost directions and what is told about them.
fn told(problem: &Problem) -> Vec<(WeakDirection, Vec<String>)> {
    let estimator = plugin(Kind::Estimate, "gauss-newton", |plugin| match &plugin.build {
        Build::Estimate(constructor) => constructor.build(&json!({}), &Context { base: "".into() }).ok(),
        _ => None,
    });
    let lost = estimator.identify(problem).unwrap().null_space;
    let trials = SeparationTrials::new(problem, &problem.start()).unwrap();
    let told = lost.into_iter().map(|vector| {
        let sentences = trials.separating(&vector).unwrap();
        println!("{}\n    {}", vector.describe(), sentences.join("\n    "));
        assert_eq!(vector.separated_by, sentences);
        (vector, sentences)
    });
    told.collect()
}

/// What is told about the only direction that is lost.
fn told_of_one(problem: &Problem) -> Vec<String> {
    let mut told = told(problem);
    assert_eq!(told.len(), 1);
    told.remove(0).1
}

fn of_machine(vector: &WeakDirection) -> Vec<&str> {
    let names = vector.combination.iter().map(|part| part.name.as_str());
    let mut names: Vec<&str> = names.filter(|name| !name.starts_with("table.")).collect();
    names.sort_unstable();
    names
}

mod tango {
    use super::*;

    const DATA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../pipelines/data/tango-hu40t/exact");

    fn machine() -> Value {
        json!({
            "chain": "w C' B' X' b Z Y (S) t", "tool_length_mm": 326.674, "stylus_radius_mm": 3,
            "axes": {
                "X": { "range_mm": [-400, 400] }, "Y": { "range_mm": [-400, 400] }, "Z": { "range_mm": [150, 750] },
                "B": { "range_deg": [-90, 90] }, "C": { "range_deg": [-360, 360] }, "S": { "range_deg": [0, 360] }
            },
            "errors": [
                { "location": ["EA0B", "EC0B", "EX0C", "EA0C", "EB0C", "EB0Z", "EA0Y", "EC0Y", "EX0S", "EY0S"] },
                { "polynomial": ["EXX", "EYY", "EZZ"], "degrees": [1] },
                { "polynomial": ["EAC", "EXC"], "degrees": [1, 2, 3] },
                { "backlash": ["EXX", "EYY", "EZZ", "EBB", "ECC"] }
            ]
        })
    }

    /// TANGO rows that are kept, with one column fixed on request.
    fn rows(keep: impl Fn(&[&str]) -> bool) -> String {
        let text = fs::read_to_string(Path::new(DATA).join("touches.csv")).unwrap();
        let mut lines = text.lines().filter(|line| !line.starts_with('#'));
        let mut kept = format!("{}\n", lines.next().unwrap());
        for line in lines {
            let cells: Vec<&str> = line.split(',').collect();
            if !["1", "2"].contains(&cells[1]) && keep(&cells) {
                kept.push_str(line);
                kept.push('\n');
            }
        }
        kept
    }

    fn tango(touches: &str, bar: bool, parameters: &[&str]) -> Problem {
        let folder = tempfile::tempdir().unwrap();
        for file in ["facets.csv", "lengths.csv"] {
            fs::copy(Path::new(DATA).join(file), folder.path().join(file)).unwrap();
        }
        fs::write(folder.path().join("touches.csv"), touches).unwrap();
        let facets = json!({ "nominal": "facets.csv", "standard_uncertainty_um": 1 });
        let length = json!({ "standard_uncertainty_um": 1 });
        let mut artefacts = vec![("facets", facets, "touches.csv"), ("length", length, "lengths.csv")];
        artefacts.truncate(1 + usize::from(bar));
        problem(folder.path(), &machine(), &artefacts, parameters)
    }

    const SCALE: [&str; 8] = ["dxt", "dyt", "dzt", "EXX[1]", "EYY[1]", "EZZ[1]", "E?0?", "table.*"];

    #[test]
    fn without_a_bar_needs_a_length() {
        let told = told_of_one(&tango(&rows(|_| true), false, &SCALE));
        assert_eq!(told, ["measure a calibrated length along X, for instance a scale bar"]);
    }

    #[test]
    fn with_a_bar_lacks_nothing() {
        assert!(told(&tango(&rows(|_| true), true, &SCALE)).is_empty());
    }

    #[test]
    fn with_the_spindle_at_rest_needs_it_indexed() {
        let touches = rows(|cells| cells[7].parse::<f64>().unwrap() == 0.0);
        for (vector, told) in told(&tango(&touches, true, &["dxt", "dyt", "dzt", "E?0S", "E??[1]", "table.*"])) {
            assert_eq!(vector.combination.len(), 2);
            assert_eq!(told[0], "measure with the spindle S at other positions: it stands at 0° in all rows");
        }
    }

    #[test]
    fn approached_from_one_side_needs_the_other() {
        let touches = rows(|_| true);
        for parameters in [["dxt", "dyt", "dzt", "EZZ[b]"], ["EXX[1]", "EYY[1]", "dzt", "EZZ[b]"]] {
            let told = told_of_one(&tango(&touches, true, &[&parameters[..], &["table.*"]].concat()));
            assert_eq!(told, ["approach in both directions of Z: all rows have dir_Z = -1"]);
        }
    }

    #[test]
    fn without_recorded_directions_has_to_record_them() {
        let touches = rows(|_| true).replace("dir_Z", "ignored_um");
        let told = told_of_one(&tango(&touches, true, &["dxt", "EZZ[b]", "table.*"]));
        assert_eq!(told, ["approach in both directions of Z and record `dir_Z`: no row has it"]);
    }

    #[test]
    fn with_a_rotary_axis_at_rest_needs_it_turned() {
        let touches = rows(|cells| cells[5].parse::<f64>().unwrap() == 0.0);
        let lost = told(&tango(&touches, true, &["dxt", "dyt", "dzt", "EA0B", "EC0B", "E?0C", "table.*"]));
        assert!(!lost.is_empty());
        for (_, told) in lost {
            assert_eq!(told[0], "measure with B at other positions: it stands at 0° in all rows");
        }
    }

    #[test]
    fn whose_datum_is_free_needs_known_places() {
        for (_, told) in told(&tango(&rows(|_| true), true, &["dxt", "dyt", "dzt", "dxw", "dyw", "daw", "table.*"])) {
            assert_eq!(told.len(), 1);
            assert!(told[0].starts_with("touch features whose places on the table are known"), "{told:?}");
        }
    }

    #[test]
    fn with_a_rotary_axis_at_two_positions_needs_more() {
        let touches = rows(|cells| ["0.0000", "90.0000"].contains(&cells[6]) && cells[5] == "0.0000");
        let lost = told(&tango(&touches, true, &["dxt", "dyt", "EXC[?]", "EAC[?]", "table.*"]));
        assert!(!lost.is_empty());
        for (vector, told) in lost {
            // Two odd functions that agree at 90° agree at -90° as well.
            let odd = vector.combination.iter().all(|part| part.name.ends_with("[1]") || part.name.ends_with("[3]"));
            let at = if odd { "60°" } else { "-90°" };
            assert_eq!(
                told,
                [format!("measure with C at further positions, for instance {at}: the rows have 0°, 90°")]
            );
        }
    }

    #[test]
    fn does_not_see_what_does_nothing_to_the_tip() {
        let told = told_of_one(&tango(&rows(|_| true), true, &["dxt", "dyt", "dbt", "table.*"]));
        assert_eq!(told, ["leave it out: it does nothing to the tip, no touch can tell it"]);
    }
}

mod cylinder {
    use super::*;

    fn machine() -> Value {
        json!({
            "chain": "w C' A' Y' b X Z (S) t", "tool_length_mm": 262.5, "stylus_radius_mm": 2.5,
            "axes": { "A": { "direction": [0.5f64.sqrt(), 0.0, -0.5f64.sqrt()] } },
            "errors": [{ "location": ["EY0C", "EA0C", "EB0C", "EX0C", "EB0A", "EC0A", "EB0Z", "EC0Y"] }]
        })
    }

    /// Where the linear axes stand while the tip of the stylus is at a place of the table, with A and C as given: mm.
    fn linear_axes(model: &dyn KinematicModel, rotary_deg: [f64; 2], tip: &Vector3<f64>) -> [f64; 3] {
        let info = model.info();
        let axis = |name: &str| info.axes.iter().position(|axis| axis.name == name).unwrap();
        let value_of = |column: &StatusColumn| match column.name.as_str() {
            "A" => rotary_deg[0].to_radians(),
            "C" => rotary_deg[1].to_radians(),
            _ => 0.0,
        };
        let status: Vec<f64> = info.status.iter().map(value_of).collect();
        let wanted = ["X", "Y", "Z"].map(|name| Variable::Command(axis(name)));
        let mut pose = Poses::default();
        model.poses(&status, &info.nominal, &wanted, false, &mut pose).unwrap();
        // The tip moves in proportion to linear axes.
        let columns: Vec<Vector3<f64>> = pose.position_derivatives.iter().map(|&along| along.into()).collect();
        let miss = tip - Vector3::from(pose.positions[0]);
        Matrix3::from_columns(&columns).lu().solve(&miss).unwrap().into()
    }

    /// A table of 500 mm, touched at 12 facets of one section or of two.
    fn cylinder(heights: &[f64], parameters: &[&str]) -> Problem {
        let folder = tempfile::tempdir().unwrap();
        let mut facets = "feature,x_mm,y_mm,z_mm,nx,ny,nz\n".to_owned();
        let mut touches = "feature,X_mm,Y_mm,Z_mm,A_deg,C_deg,S_deg\n".to_owned();
        let machine_model = model(&machine(), &Context { base: folder.path().to_owned() }, &[]);
        let features: Vec<(f64, usize)> =
            heights.iter().flat_map(|&height| (0..12).map(move |facet| (height, facet))).collect();
        let mut tips = Vec::new();
        for (height, facet) in &features {
            let (sin, cos) = (*facet as f64 * 30.0).to_radians().sin_cos();
            let (x, y) = (250.0 * cos, 250.0 * sin);
            facets.push_str(&format!("f{height}-{facet},{x},{y},{height},{cos},{sin},0\n"));
            tips.push(Vector3::new(x + 2.5 * cos, y + 2.5 * sin, *height));
        }
        for indexation in 0..23 {
            let a = [-30, -15, 0, 15, 30][indexation % 5];
            let c = (indexation * 75) % 360;
            for ((height, facet), tip) in features.iter().zip(&tips) {
                let [x, y, z] = linear_axes(machine_model.as_ref(), [f64::from(a), c as f64], tip);
                touches.push_str(&format!("f{height}-{facet},{x},{y},{z},{a},{c},0\n"));
            }
        }
        fs::write(folder.path().join("facets.csv"), facets).unwrap();
        fs::write(folder.path().join("touches.csv"), touches).unwrap();
        let settings = json!({ "nominal": "facets.csv", "standard_uncertainty_um": 1 });
        problem(folder.path(), &machine(), &[("facets", settings, "touches.csv")], parameters)
    }

    const ALL: [&str; 8] = ["dxt", "dyt", "dzt", "EY0C", "EA0C", "EB0C", "E?0A", "table.*"];

    #[test]
    fn of_one_section_needs_another_height() {
        let lost = told(&cylinder(&[40.0], &ALL));
        let names: Vec<Vec<&str>> = lost.iter().map(|(vector, _)| of_machine(vector)).collect();
        assert!(names.contains(&vec!["EA0C", "EY0C"]), "{names:?}");
        assert!(names.contains(&vec!["EB0C", "dxt", "dzt"]), "{names:?}");
        let elsewhere = "touch a feature elsewhere, for instance near x = 0, y = 0, z = 140 mm of the table frame \
            (what is touched lies within x = -250 to 250, y = -250 to 250, z = 40 mm)";
        for (vector, told) in &lost {
            let spindle = "measure with the spindle S at other positions: it stands at 0° in all rows";
            let turns = of_machine(vector).contains(&"dxt");
            assert_eq!(*told, if turns { vec![spindle, elsewhere] } else { vec![elsewhere] });
        }
    }

    #[test]
    fn of_two_sections_lacks_nothing() {
        assert!(told(&cylinder(&[40.0, 140.0], &ALL)).is_empty());
    }
}

mod three_axes {
    use super::*;

    fn observed(artefact: &str, nominal: &str, touches: &str, errors: &Value, parameters: &[&str]) -> Problem {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("nominal.csv"), nominal).unwrap();
        fs::write(folder.path().join("touches.csv"), touches).unwrap();
        let machine = json!({
            "chain": "w b X Y Z t", "tool_length_mm": 100, "stylus_radius_mm": 0,
            "styli": { "2": { "tip_mm": [50, 0, -100] } }, "errors": errors,
        });
        let settings = json!({ "nominal": "nominal.csv", "standard_uncertainty_um": 1 });
        problem(folder.path(), &machine, &[(artefact, settings, "touches.csv")], parameters)
    }

    #[test]
    fn a_stylus_that_is_never_used_has_to_be() {
        let facets = "feature,x_mm,y_mm,z_mm,nx,ny,nz\na,0,0,0,0,0,1\n";
        let touches = "feature,X_mm,Y_mm,Z_mm,stylus\na,0,0,100,1\na,0,0,100,1\n";
        let told = told_of_one(&observed("facets", facets, touches, &json!([]), &["stylus[2].z", "table.*"]));
        assert_eq!(told, ["measure with stylus 2 as well: the rows have 1"]);
    }

    #[test]
    fn time_has_to_be_recorded() {
        let facets = "feature,x_mm,y_mm,z_mm,nx,ny,nz\na,0,0,0,0,0,1\n";
        let touches = "feature,X_mm,Y_mm,Z_mm\na,0,0,100\na,0,0,100\n";
        let drift = json!([{ "drift": ["dzt"], "degrees": [1], "time_s": { "": [0, 100] } }]);
        let told = told_of_one(&observed("facets", facets, touches, &drift, &["dzt[t1]", "table.*"]));
        assert_eq!(told, ["record `time`: no row has it"]);
    }

    #[test]
    fn a_ball_that_is_touched_on_top_needs_more_directions() {
        let balls = "feature,x_mm,y_mm,z_mm,diameter_mm\n1,0,0,0,20\n";
        let touches = "feature,X_mm,Y_mm,Z_mm\n1,0,0,110\n1,0,0,110\n1,0,0,110\n";
        for (_, told) in told(&observed("balls", balls, touches, &json!([]), &["table.*"])) {
            assert_eq!(told, ["touch table.ball[1] from more directions or at more indexations"]);
        }
    }
}

#[test]
fn a_direction_of_another_problem_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("facets.csv"), "feature,x_mm,y_mm,z_mm,nx,ny,nz\na,0,0,0,0,0,1\n").unwrap();
    fs::write(folder.path().join("touches.csv"), "feature,X_mm,Y_mm,Z_mm\na,0,0,100\n").unwrap();
    let machine = json!({ "chain": "w b X Y Z t", "tool_length_mm": 100, "stylus_radius_mm": 0 });
    let settings = json!({ "nominal": "facets.csv", "standard_uncertainty_um": 1 });
    let problem = problem(folder.path(), &machine, &[("facets", settings, "touches.csv")], &["dzt", "table.*"]);
    let (mut vector, _) = told(&problem).remove(0);
    vector.combination[0].name = "EXX[1]".to_owned();
    let error = abbe_estimation::separating_measurements(&problem, &problem.start(), &vector).unwrap_err();
    assert!(error.to_string().contains("`EXX[1]` is no unknown of `fit`"));
}
