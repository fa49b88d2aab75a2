//! Placements against differences, and what is refused.

use std::fs;

use abbe_core::{Build, Kind, ObservationSet, Problem, Registry};
use abbe_serial_chain as _;
use proptest::prelude::*;

use super::*;

const POINTS: &str =
    "# calibrated\npoint,x_mm,y_mm,z_mm,note\n0,0,0,0,a\n1,50.01,-0.002,0.004,b\n2,100.02,0.003,-0.01,c\n";
const PLACEMENTS: &str = "placement,x_mm,y_mm,z_mm,ux,uy,uz,vx,vy,vz\n\
    1,-30,20,-50,1,0,0,0,1,0\n2,10,-20,-80,0.707106781187,0,0.707106781187,0,1,0\n";
const DATA: &str = "point,placement,X_mm,Y_mm,Z_mm,meas_x,meas_y,meas_z\n\
    0,1,-30,20,50,1,1,1\n1,1,20,20,50,1,0,1\n2,1,70,20,50,0,0,1\n1,2,45,-20,55,1,1,1\n";

fn model() -> Arc<dyn KinematicModel> {
    let settings = json!({ "chain": "w X' b Y Z t", "tool_length_mm": 100, "stylus_radius_mm": 0,
        "errors": [{ "location": ["EC0Y"] }, { "polynomial": ["EXX"], "degrees": [1] }] });
    let registry = Registry::built_in().unwrap();
    let Build::Model(constructor) = &registry.find(Kind::Model, "serial-chain").unwrap().build else { panic!() };
    constructor.build(&settings, &Context { base: PathBuf::new() }).unwrap().build(&[]).unwrap()
}

/// The observations of these files, or the message of what is wrong with them.
fn observed(points: &str, placements: &str, data: &str) -> Result<Arc<dyn Observations>, String> {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in [("points.csv", points), ("placements.csv", placements), ("data.csv", data)] {
        fs::write(folder.path().join(name), text).unwrap();
    }
    let mut settings = json!({ "points": "points.csv", "placements": "placements.csv", "standard_uncertainty_um": 1,
        "calibration_standard_uncertainty_um": 0.2 });
    if points.starts_with('<') {
        settings = json!({ "certificate": { "path": "points.csv", "item": 7 }, "placements": "placements.csv",
            "standard_uncertainty_um": 1 });
    }
    let artefact =
        build(abbe_core::from_settings(&settings).unwrap(), &Context { base: folder.path().to_owned() }).unwrap();
    let data = Arc::new(abbe_table::read(&folder.path().join("data.csv")).unwrap());
    let observed = artefact
        .check(&data.headers(), data.files.first(), model().as_ref())
        .and_then(|()| artefact.observe(&data, &model()));
    observed.map_err(|error| error.to_string().replace(&format!("{}/", folder.path().display()), ""))
}

#[test]
fn names_are_those_of_placements_and_points_that_occur() {
    let observed = observed(POINTS, PLACEMENTS, &DATA.replace("1,2,45", "1,1,45")).unwrap();
    let names: Vec<&str> = observed.info().unknowns.iter().map(|unknown| unknown.name.as_str()).collect();
    assert_eq!(names, ["bar[1].x", "bar[1].y", "bar[1].z", "bar[1].a", "bar[1].b", "bar[1].c"]);
    assert_eq!(observed.info().inputs.len(), 9);
    assert_eq!(observed.info().inputs[4].parameter.name, "point[1].y");
    assert_eq!(observed.info().inputs[4].standard_uncertainty, 2e-4);
    assert_eq!(observed.info().layout.standard_uncertainties.len(), 3 + 2 + 1 + 3);
}

/// The points of [`POINTS`] in a certificate; `more` stands behind the units.
fn certificate(more: &str) -> String {
    let labels = "0.x 0.y 0.z 1.x 1.y 1.z 2.x 2.y 2.z";
    format!(
        r#"<d:digitalCalibrationCertificate xmlns:d="https://ptb.de/dcc" xmlns:s="https://ptb.de/si" schemaVersion="3.3.0">
<d:administrativeData><d:coreData><d:uniqueIdentifier>P-1</d:uniqueIdentifier></d:coreData><d:items><d:item><d:identifications>
<d:identification><d:value>7</d:value></d:identification></d:identifications></d:item></d:items></d:administrativeData>
<d:measurementResults><d:measurementResult><d:results><d:result><d:data><d:quantity><s:realListXMLList>
<s:labelXMLList>{labels}</s:labelXMLList><s:valueXMLList>0 0 0 50.01 -0.002 0.004 100.02 0.003 -0.01</s:valueXMLList>
<s:unitXMLList>\milli\metre</s:unitXMLList>{more}</s:realListXMLList></d:quantity></d:data></d:result></d:results>
</d:measurementResult></d:measurementResults></d:digitalCalibrationCertificate>"#
    )
}

/// Without covariance a certificate is what a table is; with one, residuals follow the inputs by c, and c u² c^T is the covariance.
#[test]
fn a_certificate_gives_points_with_their_covariance() {
    let expanded = "<s:expandedUncXMLList><s:uncertaintyXMLList>0.0004</s:uncertaintyXMLList><s:coverageFactorXMLList>2\
        </s:coverageFactorXMLList></s:expandedUncXMLList>";
    let table = observed(POINTS, PLACEMENTS, DATA).unwrap();
    let certified = observed(&certificate(expanded), PLACEMENTS, DATA).unwrap();
    let names = |observed: &Arc<dyn Observations>| -> Vec<(String, f64)> {
        let inputs = observed.info().inputs.iter();
        inputs.map(|input| (input.parameter.name.clone(), input.standard_uncertainty)).collect()
    };
    assert_eq!(names(&table), names(&certified));

    let q = [0.0, 0.0, 0.0, 50.01, -0.002, 0.004, 100.02, 0.003, -0.01];
    let covariance = |row: usize, column: usize| 1e-12 * q[row] * q[column] + if row == column { 1e-8 } else { 0.0 };
    let column = |column: usize| {
        let entries: Vec<String> = (0..9).map(|row| format!("{:e}", covariance(row, column))).collect();
        format!(
            "<s:columnXMLList><s:covarianceXMLList><s:valueXMLList>{}</s:valueXMLList><s:unitXMLList>\\milli\\metre\\tothe{{2}}\
            </s:unitXMLList></s:covarianceXMLList></s:columnXMLList>",
            entries.join(" ")
        )
    };
    let columns: String = (0..9).map(column).collect();
    let joint = format!("<s:covarianceMatrixXMLList>{columns}</s:covarianceMatrixXMLList>");
    let certified = observed(&certificate(&joint), PLACEMENTS, DATA).unwrap();
    let info = certified.info();
    let (own, rows) = (vec![0.0; info.unknowns.len()], [RowIndex(0), RowIndex(1), RowIndex(3)]);
    let residuals = |inputs: &[f64]| {
        let mut out = Equations::default();
        let batch = RowBatch {
            rows: &rows,
            positions: &[[-30.0, 20.0, -50.0], [20.0, 20.0, -50.0], [45.0, -20.0, -45.0]],
            orientations: &[],
            own: &own,
            inputs,
        };
        certified.evaluate(batch, &mut out).unwrap();
        out
    };
    let zero = vec![0.0; info.inputs.len()];
    let found = residuals(&zero);
    let count = found.residuals().len();
    assert_eq!(count, 3 + 2 + 3);
    // Derivatives as stated and by differences; then the covariance of the coordinates that each equation has.
    let mut by_input = vec![vec![0.0; zero.len()]; count];
    found.by_input().iter().for_each(|&(equation, input, derivative)| by_input[equation][input] += derivative);
    for input in 0..zero.len() {
        let mut moved = zero.clone();
        moved[input] = 1e-3;
        for (equation, residual) in residuals(&moved).residuals().iter().enumerate() {
            let difference = (residual - found.residuals()[equation]) / 1e-3;
            assert!((difference - by_input[equation][input]).abs() < 1e-8, "{equation} {input}");
        }
    }
    let coordinates = [0, 1, 2, 3, 5, 3, 4, 5];
    for (one, of_one) in coordinates.iter().enumerate() {
        for (other, of_other) in coordinates.iter().enumerate() {
            let inputs = info.inputs.iter().enumerate();
            let propagated: f64 = inputs
                .map(|(k, input)| by_input[one][k] * by_input[other][k] * input.standard_uncertainty.powi(2))
                .sum();
            let expected = covariance(*of_one, *of_other);
            assert!((propagated - expected).abs() < 1e-12 * 1e-8, "{one} {other}: {propagated} {expected}");
        }
    }
    let error = observed(&certificate("").replace(">7<", ">8<"), PLACEMENTS, DATA).err().unwrap();
    assert!(error.contains("the item `7` was expected"), "{error}");
}

#[test]
fn what_is_wrong_is_named() {
    let cases = [
        (POINTS, PLACEMENTS, DATA.replace("1,2,45", "1,3,45"), "placement `3` is not in the file `placements.csv`"),
        (POINTS, PLACEMENTS, DATA.replace("0,0,1\n", "0,0,0\n"), "no direction of this point was measured"),
        (POINTS, PLACEMENTS, DATA.replace("0,0,1\n", "0,0,2\n"), "`meas_z` is 2; 0 or 1 was expected"),
        (POINTS, PLACEMENTS, DATA.replace("placement", "positioning"), "there is no column `placement`"),
        (
            POINTS,
            &PLACEMENTS.replace(",0,1,0\n2", ",1,1,0\n2"),
            DATA.to_owned(),
            "u and v are not the x and y directions",
        ),
        (&POINTS.replace("\n2,100", "\n1,100"), PLACEMENTS, DATA.to_owned(), "point `1` is in line 4 already"),
    ];
    for (points, placements, data, expected) in cases {
        let error = observed(points, placements, &data).err().expect(expected);
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn rows_of_other_artefacts_are_left_to_them() {
    let observed = observed(POINTS, PLACEMENTS, &DATA.replace("\n1,2,45", "\nother,2,45")).unwrap();
    assert_eq!(observed.info().layout.rows.len(), 3);
}

#[test]
fn derivatives_are_those_of_the_residuals() {
    let set = ObservationSet::new("points", observed(POINTS, PLACEMENTS, DATA).unwrap());
    let mut problem = Problem::new("fit", "serial-chain", model(), vec![set], &["*".to_owned()]).unwrap();
    problem.unknowns.extend(problem.considered.unknowns.clone());
    let x: Vec<f64> = problem
        .unknowns
        .iter()
        .enumerate()
        .map(|(index, unknown)| if unknown.unit.of == Quantity::Length { 0.3 } else { 0.02 } * (1.0 + index as f64).sin())
        .collect();
    let count = problem.unknowns.len();
    let mut jacobian = Vec::new();
    problem.linearise(&x, |block| jacobian.extend_from_slice(block.jacobian)).unwrap();
    for column in 0..count {
        let at = |by: f64| {
            let mut x = x.clone();
            x[column] += by;
            problem.with_values(&x).residuals(&x).unwrap()
        };
        let step = 1e-5;
        for (row, (above, below)) in at(step).iter().zip(at(-step)).enumerate() {
            let difference = (above - below) / (2.0 * step);
            let analytic = jacobian[row * count + column];
            let name = &problem.unknowns[column].name;
            assert!((difference - analytic).abs() < 1e-7 * (1.0 + analytic.abs()), "{name}: {difference} {analytic}");
        }
    }
}

proptest! {
    #[test]
    fn what_is_placed_is_seen_where_it_was(
        u in prop::array::uniform3(-1.0..1.0_f64), away in prop::array::uniform3(-1.0..1.0_f64),
        point in prop::array::uniform3(-500.0..500.0_f64), errors in prop::array::uniform6(-0.5..0.5_f64),
    ) {
        let (u, away) = (Vector3::from(u), Vector3::from(away));
        prop_assume!(u.cross(&away).norm() > 1e-2);
        let placement = Placement::new(Vector3::new(1.0, -200.0, 30.0), u, u.cross(&away)).unwrap();
        let point = Vector3::from(point);
        let seen = placement.seen(&placement.place(&point, &errors), &errors);
        prop_assert!((seen.point - point).norm() < 1e-11, "{:?}", seen.point);
    }
}
