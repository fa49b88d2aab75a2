//! Motion errors and nominal values across the border.

use std::any::Any;
use std::sync::Arc;

use abbe_core::{
    Absent, Axis, AxisKind, Branch, Equations, Error, ErrorFunction, KinematicModel, MotionError, Parameter,
    PoseValues, Poses, Quantity, Result, StatusColumn, Unit, Variable,
};
use serde_json::Value;

use super::machine;
use crate::peer::{Answer, Failure, Known, Peer, Transit};
use crate::served::Served;

/// A machine with the error EXX = amplitude sin(x / wavelength).
struct Wave {
    axes: Vec<Axis>,
    status: Vec<StatusColumn>,
    parameters: Vec<Parameter>,
    nominal: Vec<f64>,
    uncertainties: Vec<f64>,
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
            status: 0,
        };
        let column = |name: &str, quantity, absent| StatusColumn {
            name: name.to_owned(),
            quantity,
            levels: Vec::new(),
            absent: Absent::Taken(absent),
        };
        let parameters = ["EXX[sin]", "EXX.wavelength"].map(|name| Parameter { name: name.to_owned(), unit: Unit::MM });
        Self {
            axes: vec![axis],
            status: vec![column("X", Quantity::Length, 0.0), column("time", Quantity::Time, f64::NAN)],
            parameters: parameters.to_vec(),
            nominal: nominal.to_vec(),
            uncertainties: vec![0.0, 1e-4],
            amplitude: 0,
        }
    }
}

impl KinematicModel for Wave {
    fn axes(&self) -> &[Axis] {
        &self.axes
    }

    fn status(&self) -> &[StatusColumn] {
        &self.status
    }

    fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }

    fn nominal(&self) -> Vec<f64> {
        self.nominal.clone()
    }

    fn nominal_uncertainties(&self) -> Vec<f64> {
        self.uncertainties.clone()
    }

    fn stylus_radius(&self) -> f64 {
        0.0
    }

    fn evaluate(&self, _: &[f64], _: &[f64], _: &[Variable], _: bool, _: &mut Poses) -> Result<()> {
        Err(Error::data("not needed here"))
    }

    fn settings(&self) -> Value {
        Value::Null
    }

    fn error_functions(&self) -> Vec<ErrorFunction> {
        vec![ErrorFunction { symbol: "EXX".to_owned(), axis: 0, component: 0, quantity: Quantity::Length }]
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

    fn equations(&self, _: &[usize], _: PoseValues<'_>, _: Known<'_>, _: &mut Equations) -> Result<(), Failure> {
        Err(Failure::of(self.who(), "has no equations"))
    }

    fn as_any(&self) -> &dyn Any {
        self
    }
}

fn across(wave: Wave) -> Result<Arc<dyn KinematicModel>, Failure> {
    machine(&Transit::Remote(Arc::new(Opposite(Served::Machine(Arc::new(wave))))))
}

const AT: [f64; 2] = [3.7, f64::NAN];

#[test]
fn nominal_values_and_motion_errors_cross_the_border() {
    let here = Wave::new(&[0.0, 0.635]);
    let there = across(Wave::new(&[0.0, 0.635])).unwrap();
    assert_eq!(there.nominal(), [0.0, 0.635]);
    assert_eq!(there.nominal_uncertainties(), [0.0, 1e-4]);
    let function = &there.error_functions()[0];
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
    let function = wave().error_functions().remove(0);
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
    assert_eq!(across(Wave::new(&[])).unwrap().nominal(), [0.0, 0.0]);
    for wrong in [&[0.0][..], &[0.0, 1.0, 2.0], &[0.0, f64::NAN]] {
        assert!(across(Wave::new(wrong)).is_err(), "{wrong:?}");
    }
    let uncertain = |uncertainties: &[f64]| across(Wave { uncertainties: uncertainties.to_vec(), ..Wave::new(&[]) });
    assert_eq!(uncertain(&[]).unwrap().nominal_uncertainties(), [0.0, 0.0]);
    for wrong in [&[0.0][..], &[0.0, -1.0], &[0.0, f64::NAN]] {
        assert!(uncertain(wrong).is_err(), "{wrong:?}");
    }
}
