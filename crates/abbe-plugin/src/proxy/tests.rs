//! Motion errors and nominal values across the border; which errors are fatal and which are refusals.

use std::any::Any;
use std::sync::Arc;

use abbe_core::{
    Absent, Axis, AxisKind, Branch, Dataset, Equations, Error, ErrorFunction, KinematicModel, Layout, ModelInfo,
    MotionError, Parameter, ParameterRole, PoseBatch, Poses, PosesMut, Quantity, RankPoint, Result, RowBatch, RowIndex,
    StatusColumn, StatusRole, Unit, Variable,
};
use serde_json::{Value, json};

use super::{machine, observations};
use crate::abi::*;
use crate::peer::{Answer, Failure, Peer, Received};
use crate::served::Served;

/// A machine with the error EXX = amplitude sin(x / wavelength).
struct Wave {
    info: ModelInfo,
    /// The parameter that it names as the amplitude.
    amplitude: usize,
}

impl Wave {
    fn new(nominal: &[f64]) -> Self {
        let axis = Axis {
            name: "X".to_owned(),
            kind: AxisKind::Linear,
            branch: Branch::Tool,
            sense: 1.0,
            direction: [1.0, 0.0, 0.0],
            range: None,
            indexed: false,
            endless: false,
            status: 0,
        };
        let axes = vec![axis];
        let column = |name: &str, role, quantity, absent| StatusColumn {
            name: name.to_owned(),
            role,
            quantity,
            levels: Vec::new(),
            absent: Absent::Default(absent),
        };
        let parameters = ["EXX[sin]", "EXX.wavelength"].map(|name| Parameter::new(name, Unit::MM));
        let [amplitude, wavelength] = parameters;
        let motion = ParameterRole::Motion { axis: 0, component: 0 };
        let parameters = vec![amplitude.with_role(motion), wavelength.with_role(ParameterRole::Shape)];
        let status = vec![
            column("X", StatusRole::Command(0), Quantity::Length, 0.0),
            column("time", StatusRole::Time, Quantity::Time, f64::NAN),
        ];
        let exx = ErrorFunction { symbol: "EXX".to_owned(), axis: 0, component: 0, quantity: Quantity::Length };
        let info = ModelInfo {
            nominal: nominal.to_vec(),
            nominal_uncertainties: vec![0.0, 1e-4],
            error_functions: vec![exx],
            ..ModelInfo::new(axes, status, parameters, Value::Null)
        };
        Self { info, amplitude: 0 }
    }

    /// The same with something else changed.
    fn with(mut self, change: impl FnOnce(&mut ModelInfo)) -> Self {
        change(&mut self.info);
        self
    }
}

impl KinematicModel for Wave {
    fn info(&self) -> &ModelInfo {
        &self.info
    }

    fn evaluate(&self, _: PoseBatch<'_>, _: PosesMut<'_>) -> Result<()> {
        Err(Error::data("not needed here"))
    }

    fn motion_error(&self, _: &ErrorFunction, values: &[f64], status: &[f64]) -> Result<MotionError> {
        if status[0] > 100.0 {
            return Err(Error::data("X is beyond the range of EXX"));
        }
        assert!(status[1].is_nan(), "an unknown status stays unknown");
        let phase = status[0] / values[1];
        let slope = -values[0] * phase.cos() * phase / values[1];
        let derivatives = vec![(self.amplitude, phase.sin()), (1, slope)];
        Ok(MotionError { value: values[0] * phase.sin(), derivatives })
    }
}

/// The other side, without a border in between.
struct Opposite(Served);

impl Peer for Opposite {
    fn who(&self) -> &str {
        "the plugin `wave`"
    }

    fn call(&self, method: u32, text: &str, _: &[Arc<Served>]) -> Result<Answer, Failure> {
        self.0.dispatch(method, text, &[]).map(|(text, _)| Answer { text, objects: Vec::new() })
    }

    fn poses(&self, _: &[f64], _: &[f64], _: &[Variable], _: &mut Poses) -> Result<(), Failure> {
        Err(Failure::of(self.who(), "has no poses"))
    }

    fn equations(&self, _: RowBatch<'_>, _: &mut Equations) -> Result<(), Failure> {
        Err(Failure::of(self.who(), "has no equations"))
    }

    fn as_any(&self) -> &dyn Any {
        self
    }
}

fn across(wave: Wave) -> Result<Arc<dyn KinematicModel>, Failure> {
    machine(&Received::Remote(Arc::new(Opposite(Served::Machine(Arc::new(wave))))))
}

const AT: [f64; 2] = [3.7, f64::NAN];

#[test]
fn nominal_values_and_motion_errors_cross_the_border() {
    let here = Wave::new(&[0.0, 0.635]);
    let there = across(Wave::new(&[0.0, 0.635])).unwrap();
    assert_eq!(there.info().nominal, [0.0, 0.635]);
    assert_eq!(there.info().nominal_uncertainties, [0.0, 1e-4]);
    let function = &there.info().error_functions[0];
    let values = [0.1, 0.7];
    let found = there.motion_error(function, &values, &AT).unwrap();
    assert_eq!(found, here.motion_error(function, &values, &AT).unwrap());
    assert!(found.value.abs() > 1e-3 && found.derivatives[1].1.abs() > 1e-3, "{found:?}");
    let beyond = there.motion_error(function, &values, &[101.0, f64::NAN]).unwrap_err();
    assert_eq!(beyond.message, "X is beyond the range of EXX");
}

#[test]
fn what_is_no_motion_error_is_refused() {
    let refused = |wave: Wave, function: &ErrorFunction, values: &[f64]| {
        across(wave).unwrap().motion_error(function, values, &AT).unwrap_err().message
    };
    let wave = || Wave::new(&[0.0, 0.635]);
    let function = wave().info.error_functions.remove(0);
    let of_another = ErrorFunction { axis: 1, ..function.clone() };
    assert!(refused(wave(), &of_another, &[0.0, 1.0]).contains("a motion error of another machine"));
    assert!(refused(wave(), &function, &[1.0]).contains("a motion error of another machine"));
    let outside = Wave { amplitude: 2, ..wave() };
    assert!(refused(outside, &function, &[0.0, 1.0]).contains("a parameter that is not there"));
    // 3.7 / 0 is infinite, its sine none.
    assert!(refused(wave(), &function, &[0.1, 0.0]).contains("the plugin `wave`"));
}

#[test]
fn nominal_values_are_zero_unless_told_and_one_a_parameter() {
    assert_eq!(across(Wave::new(&[])).unwrap().info().nominal, [0.0, 0.0]);
    for wrong in [&[0.0][..], &[0.0, 1.0, 2.0], &[0.0, f64::NAN]] {
        assert!(across(Wave::new(wrong)).is_err(), "{wrong:?}");
    }
    let uncertain =
        |uncertainties: &[f64]| across(Wave::new(&[]).with(|info| info.nominal_uncertainties = uncertainties.to_vec()));
    assert_eq!(uncertain(&[]).unwrap().info().nominal_uncertainties, [0.0, 0.0]);
    for wrong in [&[0.0][..], &[0.0, -1.0], &[0.0, f64::NAN]] {
        assert!(uncertain(wrong).is_err(), "{wrong:?}");
    }
}

#[test]
fn roles_of_what_is_not_there_are_refused() {
    let refused = |change: fn(&mut ModelInfo)| match across(Wave::new(&[]).with(change)) {
        Err(failure) => failure.error("").message,
        Ok(_) => panic!("it was taken"),
    };
    let message = refused(|info| info.status[0].role = StatusRole::Other);
    assert!(message.contains("axis X has status 0, whose role is not the command of this axis"), "{message}");
    let message = refused(|info| info.status[1].role = StatusRole::Velocity(1));
    assert!(message.contains("status time is of an axis that is not there"), "{message}");
    let message = refused(|info| info.status[1].role = StatusRole::Other);
    assert!(message.contains("status time does not say its role"), "{message}");
    let message = refused(|info| info.parameters[0].role = ParameterRole::Other);
    assert!(message.contains("error EXX no parameter has the role of"), "{message}");
    for role in [ParameterRole::Motion { axis: 1, component: 0 }, ParameterRole::Location { axis: 0, component: 6 }] {
        let Err(failure) = across(Wave::new(&[]).with(|info| info.parameters[0].role = role)) else { panic!("taken") };
        assert!(failure.error("").message.contains("parameter EXX[sin] is of no axis or component"));
    }
}

#[test]
fn roles_cross_as_words() {
    let sensor = StatusRole::Sensor("T_ball_screw".to_owned());
    let location = ParameterRole::Location { axis: 0, component: 3 };
    let there = across(Wave::new(&[]).with(|info| {
        info.status[1].role = sensor.clone();
        info.parameters[1].role = location;
    }));
    let there = there.expect("roles that are there");
    assert_eq!((&there.info().status[1].role, there.info().parameters[1].role), (&sensor, location));
    assert_eq!(json!(there.info().status[0].role), json!({ "command": 0 }));
    assert_eq!(json!(location), json!({ "location": { "axis": 0, "component": 3 } }));
    assert_eq!(json!(there.info().parameters[0].role), json!({ "motion": { "axis": 0, "component": 0 } }));
    assert_eq!(json!(StatusRole::ThermalState("head".to_owned())), json!({ "thermal-state": "head" }));
    assert_eq!(json!(ParameterRole::SetUp), json!("set-up"));
}

#[test]
fn a_failure_of_the_code_is_fatal_and_a_refusal_of_numbers_is_not() {
    let error = |status: u32, text: &str| Failure { status, text: text.to_owned() }.error("the plugin `x`");
    let cases = [
        (ABBE_FAILED, "no such pose", false),
        (ABBE_FAILED, "", false),
        (ABBE_FAILED_WITH_DETAILS, r#"{"message":"no such pose","pose":3}"#, false),
        (ABBE_FAILED_WITH_DETAILS, r#"{"message":"the licence has expired","fault":true}"#, true),
        (ABBE_FAILED_WITH_DETAILS, "no such pose", true),
        (ABBE_PANICKED, "a bug", true),
        (ABBE_UNKNOWN_METHOD, "it has no `poses`", true),
        (77, "what is this", true),
    ];
    for (status, text, fatal) in cases {
        let error = error(status, text);
        assert_eq!(error.fatal, fatal, "{status}: {error}");
        // Through several borders.
        let mut again = Failure::from(error.clone()).error("the plugin `y`");
        again = Failure::from(again).error("the plugin `z`");
        assert_eq!(again, error);
    }
    assert!(Failure::of("the plugin `x`", "is gone").error("").fatal);
    let unreadable: serde_json::Error = serde_json::from_str::<f64>("{").unwrap_err();
    assert!(Failure::from(unreadable).error("").fatal);
    // Left out where it is empty, so that readers of such texts need not know it.
    assert!(!Failure::from(Error::data("no such pose")).text.contains("fault"));
}

#[test]
fn a_broken_promise_of_a_machine_is_fatal_and_a_refusal_is_not() {
    let there = across(Wave::new(&[0.0, 0.635])).unwrap();
    let function = &there.info().error_functions[0];
    let refused = there.motion_error(function, &[0.1, 0.7], &[101.0, f64::NAN]).unwrap_err();
    assert!(!refused.fatal, "{refused}");
    let outside = across(Wave { amplitude: 2, ..Wave::new(&[]) }).unwrap();
    assert!(outside.motion_error(function, &[0.0, 1.0], &AT).unwrap_err().fatal);
    // 3.7 / 0 is infinite, its sine none.
    assert!(there.motion_error(function, &[0.1, 0.0], &AT).unwrap_err().fatal);
    let mut out = Poses::default();
    assert!(there.poses(&AT, &[0.0, 1.0], &[], false, &mut out).unwrap_err().fatal, "it has no poses");
    for (what, turn) in [(f64::NAN, [1.0, 0.0, 0.0, 0.0]), (1.0, [1.0, 1.0, 0.0, 0.0])] {
        let peer = Answering { text: json!(Wave::new(&[]).info()), gives: vec![what], turn };
        let there = machine(&Received::Remote(Arc::new(peer))).ok().unwrap();
        assert!(there.poses(&AT, &[0.0, 1.0], &[], true, &mut out).unwrap_err().fatal, "{what} {turn:?}");
    }
}

/// The other side, which always gives the same answer.
struct Answering {
    text: Value,
    gives: Vec<f64>,
    turn: [f64; 4],
}

impl Peer for Answering {
    fn who(&self) -> &str {
        "the plugin `answering`"
    }

    fn call(&self, _: u32, _: &str, _: &[Arc<Served>]) -> Result<Answer, Failure> {
        Ok(Answer { text: self.text.to_string(), objects: Vec::new() })
    }

    fn poses(&self, _: &[f64], _: &[f64], _: &[Variable], out: &mut Poses) -> Result<(), Failure> {
        out.positions.fill([self.gives[0]; 3]);
        out.orientations.fill(self.turn);
        Ok(())
    }

    fn equations(&self, _: RowBatch<'_>, out: &mut Equations) -> Result<(), Failure> {
        self.gives.iter().for_each(|residual| out.equation(*residual));
        Ok(())
    }

    fn as_any(&self) -> &dyn Any {
        self
    }
}

#[test]
fn equations_of_another_number_or_that_are_none_are_faults() {
    let data = Arc::new(Dataset::default());
    let mut layout = Layout::new(&data, &Wave::new(&[]), &[]).unwrap();
    layout.push_constraint(&[1e-3, 1e-3]);
    let evaluate = |gives: &[f64]| {
        let text = json!({ "layout": layout, "contact": { "reading": "r" } });
        let peer = Answering { text, gives: gives.to_vec(), turn: [0.0; 4] };
        let there = observations(&Received::Remote(Arc::new(peer)), Some(&data)).ok().unwrap();
        let batch = RowBatch { rows: &[RowIndex(0)], positions: &[], orientations: &[], own: &[], inputs: &[] };
        there.evaluate(batch, &mut Equations::default())
    };
    evaluate(&[0.0, 1.0]).unwrap();
    for wrong in [&[][..], &[0.0], &[0.0; 3], &[0.0, f64::NAN]] {
        assert!(evaluate(wrong).unwrap_err().fatal, "{wrong:?}");
    }
}

#[test]
fn where_rank_is_judged_follows_from_contact_and_may_not_contradict_it() {
    let data = Arc::new(Dataset::default());
    let mut layout = Layout::new(&data, &Wave::new(&[]), &[]).unwrap();
    layout.push_constraint(&[1e-3]);
    let of = |contact: &Value, rank_point: Option<&Value>| {
        let mut text = json!({ "layout": layout, "contact": contact });
        if let Some(rank_point) = rank_point {
            text["rank_point"] = rank_point.clone();
        }
        let peer = Answering { text, gives: Vec::new(), turn: [0.0; 4] };
        observations(&Received::Remote(Arc::new(peer)), Some(&data)).map(|found| found.info().rank_point.clone()).ok()
    };
    let (axes, reading) = (json!("linear-axes"), json!({ "reading": "r" }));
    let nominal = json!({ "nominal-reading": { "0": { "residuals": [0.0], "axes": [0] } } });
    assert_eq!(of(&axes, None), Some(RankPoint::InContact));
    assert_eq!(of(&reading, None), Some(RankPoint::AsRecorded));
    assert_eq!(of(&axes, Some(&json!("as-recorded"))), Some(RankPoint::AsRecorded));
    assert!(matches!(of(&reading, Some(&nominal)), Some(RankPoint::NominalReading(rows)) if rows.len() == 1));
    assert_eq!((of(&axes, Some(&nominal)), of(&reading, Some(&json!("in-contact")))), (None, None));
}
