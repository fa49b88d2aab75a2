use abbe_core::{Build, Kind, ObservationSet, Problem, Registry};
use abbe_serial_chain as _;

use super::*;

const BALLS: &str = "feature,x_mm,y_mm,z_mm\n1,110,0,60\n2,0,90,40\n";
const ROWS: &str = "X_mm,Y_mm,Z_mm,B_deg,C_deg,ball,meas_x_um,meas_y_um,meas_z_um\n\
    110,0,210,0,0,1,3,-2,5\n77.7817459,77.7817459,210,0,-45,1,12,4,-7\n0,90,190,0,0,2,1,2,3\n";

fn model(chain: &str) -> Arc<dyn KinematicModel> {
    let registry = Registry::built_in().unwrap();
    let Build::Model(constructor) = &registry.find(Kind::Model, "serial-chain").unwrap().build else { panic!() };
    let settings = json!({ "chain": chain, "tool_length_mm": 150, "stylus_radius_mm": 0,
        "errors": [{ "location": ["E?0B", "E?0C"] }, { "polynomial": ["E?X", "E?Y"], "degrees": [1] }] });
    constructor.build(&settings, &Context { base: PathBuf::new() }).unwrap().build(&[]).unwrap()
}

fn observed(chain: &str, rows: &str, directions: &str) -> Result<Problem, String> {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("balls.csv"), BALLS).unwrap();
    std::fs::write(folder.path().join("rows.csv"), rows).unwrap();
    let context = Context { base: folder.path().to_owned() };
    let settings = json!({ "nominal": "balls.csv", "standard_uncertainty_um": 0.5, "directions": directions });
    let artefact = abbe_core::from_settings(&settings).and_then(|settings| build(settings, &context)).unwrap();
    let model = model(chain);
    let made = || {
        let data = Arc::new(abbe_table::read(&folder.path().join("rows.csv"))?);
        artefact.check(&data.headers(), data.files.first(), model.as_ref())?;
        let sets = vec![ObservationSet::new("ball", artefact.observe(&data, &model)?)];
        Problem::new(
            "fit",
            "serial-chain",
            model.clone(),
            sets,
            &["E*".to_owned(), "dxt".to_owned(), "ball.*".to_owned()],
        )
    };
    made().map_err(|error| error.to_string().replace(&format!("{}/", folder.path().display()), ""))
}

#[test]
fn derivatives_are_those_of_differences() {
    for (chain, directions) in
        [("w C' b X Y Z B t", "tool"), ("w C' b X Y Z B t", "table"), ("w C' B' b X Y Z t", "tool")]
    {
        let problem = observed(chain, ROWS, directions).unwrap();
        let size = |index: usize| 1e-4 * (1.0 + 0.2 * index as f64) * if index.is_multiple_of(2) { 1.0 } else { -1.0 };
        let x: Vec<f64> = problem.start().iter().enumerate().map(|(index, start)| start + size(index)).collect();
        let mut analytic = Vec::new();
        problem.linearise(&x, |block| analytic.extend_from_slice(block.jacobian)).unwrap();
        assert_eq!(analytic.len(), 9 * x.len());
        for (column, unknown) in problem.unknowns.iter().enumerate() {
            let shifted = |by: f64| {
                let mut x = x.clone();
                x[column] += by;
                problem.residuals(&x).unwrap()
            };
            let step = if unknown.unit == Unit::MM { 1e-4 } else { 1e-6 };
            let (up, down) = (shifted(step), shifted(-step));
            for (row, (up, down)) in up.iter().zip(&down).enumerate() {
                let (expected, found) = ((up - down) / (2.0 * step), analytic[row * x.len() + column]);
                assert!(
                    (expected - found).abs() < 1e-5 + 1e-8 * expected.abs(),
                    "{chain} {}, row {row}: {found} {expected}",
                    unknown.name
                );
            }
        }
    }
}

/// The machine is perfect: a reading is the way from the ball to the tip, in the directions of who reads.
#[test]
fn readings_are_tip_minus_ball() {
    let rows = "X_mm,Y_mm,Z_mm,B_deg,C_deg,ball,meas_x_um,meas_y_um,meas_z_um\n110.01,0.02,210.03,0,0,1,10,20,30\n\
                0.01,-109.98,210.03,0,90,1,";
    // At C = 90 deg the ball that stood along x of the table stands along -y of the machine (the table turns the other way).
    for (directions, last) in [("tool", "10,20,30\n"), ("table", "-20,10,30\n")] {
        let problem = observed("w C' B' b X Y Z t", &format!("{rows}{last}"), directions).unwrap();
        for residual in problem.residuals(&problem.start()).unwrap() {
            assert!(residual.abs() < 1e-9, "{directions}: {residual}");
        }
    }
}

#[test]
fn rows_that_make_no_sense_are_refused() {
    let refused = |from: &str, to: &str| {
        observed("w C' B' b X Y Z t", &ROWS.replacen(from, to, 1), "tool").err().expect("it is refused")
    };
    assert!(refused(",2,1,2,3", ",7,1,2,3").contains("rows.csv:4: ball 7 is not among the nominal balls"));
    let far = refused("110,0,210", "110,20,210");
    assert!(far.contains("rows.csv:2: the tip is 20.0 mm further from ball 1 than the readings"), "{far}");
    assert!(refused("meas_z_um", "other_um").contains("meas_z"));
}
