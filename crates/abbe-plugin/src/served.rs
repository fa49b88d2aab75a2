//! Objects that the other side may use, and their methods.

use std::sync::{Arc, PoisonError, RwLock};

use abbe_core::{
    Artefact, Build, Calibration, Context, Dataset, Estimate, Export, Fit, Identifiability, Ingest, KinematicModel,
    Model, Observations, Plugin, SettingsError, Validate, from_json,
};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::abi::*;
use crate::peer::{Failure, Peer, Received};
use crate::proxy;
use crate::questions::check_tip;
use crate::texts::{
    CheckText, FileText, FitText, InputText, JudgeText, MotionText, ObservationsText, ProblemText, TipText,
};

/// An object that the other side may use.
pub(crate) enum Served {
    Ingest(Box<dyn Ingest>),
    Artefact(Box<dyn Artefact>),
    Model(Box<dyn Model>),
    Estimate(Arc<dyn Estimate>),
    Validate(Box<dyn Validate>),
    Export(Box<dyn Export>),
    Machine(Arc<dyn KinematicModel>),
    /// A machine that is only borrowed.
    #[cfg_attr(not(feature = "host"), allow(dead_code, reason = "a vendor's side lends nothing"))]
    Lent(Arc<Lent>),
    /// Observations, and the data set that the other side has of them.
    Observations(Arc<dyn Observations>, Option<Arc<Dataset>>),
}

/// A machine that is lent for one call. Its use after that call is an error.
pub(crate) struct Lent(RwLock<Option<&'static dyn KinematicModel>>);

impl Lent {
    /// Lends a machine for as long as `with` runs.
    #[cfg(feature = "host")]
    pub fn during<T>(model: &dyn KinematicModel, with: impl FnOnce(Arc<Served>) -> T) -> T {
        struct TakeBack(Arc<Lent>);
        impl Drop for TakeBack {
            fn drop(&mut self) {
                *self.0.0.write().unwrap_or_else(PoisonError::into_inner) = None;
            }
        }
        // SAFETY: the reference is used under the read lock only, and `TakeBack` takes it away under the write lock before
        // this function returns or unwinds: nobody uses it for longer than `model` is borrowed.
        #[allow(unsafe_code)]
        let forever = unsafe { std::mem::transmute::<&dyn KinematicModel, &'static dyn KinematicModel>(model) };
        let lent = Arc::new(Self(RwLock::new(Some(forever))));
        let _back = TakeBack(lent.clone());
        with(Arc::new(Served::Lent(lent)))
    }
}

impl Served {
    /// Uses a machine, lent or not.
    pub fn machine<T>(&self, with: impl FnOnce(&dyn KinematicModel) -> Result<T, Failure>) -> Result<T, Failure> {
        match self {
            Self::Machine(machine) => with(machine.as_ref()),
            Self::Lent(lent) => match *lent.0.read().unwrap_or_else(PoisonError::into_inner) {
                Some(machine) => with(machine),
                None => Err(Failure::of("a machine", "was used after the call that lent it had ended")),
            },
            _ => Err(unknown("this object is no machine")),
        }
    }

    /// The object of the other side for which this one is a proxy, if it is one.
    pub fn peer(&self) -> Option<Arc<dyn Peer>> {
        match self {
            Self::Machine(machine) => proxy::peer_of(machine.as_ref()),
            Self::Observations(observations, _) => proxy::peer_of(observations.as_ref()),
            _ => None,
        }
    }

    /// Carries out a method; gives the text and the objects of the answer.
    pub fn dispatch(&self, method: u32, text: &str, objects: &[Received]) -> Result<(String, Vec<Arc<Self>>), Failure> {
        if let Self::Machine(_) | Self::Lent(_) = self {
            return self.machine(|machine| of_machine(machine, method, text)).map(alone);
        }
        match self {
            Self::Ingest(stage) => of_ingest(stage.as_ref(), method).map(alone),
            Self::Artefact(stage) => of_artefact(stage.as_ref(), method, text, objects),
            Self::Model(stage) => of_model(stage.as_ref(), method, text),
            Self::Estimate(stage) => of_estimator(stage.as_ref(), method, text, objects).map(alone),
            Self::Validate(stage) => of_validator(stage.as_ref(), method, text, objects).map(alone),
            Self::Export(stage) => of_exporter(stage.as_ref(), method, text, objects).map(alone),
            Self::Observations(observations, given) => {
                of_observations(observations.as_ref(), given.as_ref(), method, text).map(alone)
            }
            Self::Machine(_) | Self::Lent(_) => Err(unknown("handled above")),
        }
    }
}

fn alone(text: String) -> (String, Vec<Arc<Served>>) {
    (text, Vec::new())
}

fn unknown(what: &str) -> Failure {
    Failure { status: ABBE_UNKNOWN_METHOD, text: what.to_owned() }
}

fn no_method(method: u32) -> Failure {
    unknown(&format!("the object has no method {method}"))
}

fn read<T: DeserializeOwned>(text: &str) -> Result<T, Failure> {
    Ok(from_json(text)?)
}

fn write<T: Serialize>(value: T) -> Result<String, Failure> {
    Ok(serde_json::to_string(&value)?)
}

/// The machine among the objects of a question.
fn machine(objects: &[Received]) -> Result<Arc<dyn KinematicModel>, Failure> {
    let object = objects.first().ok_or_else(|| Failure::of("the other side", "gives no machine"))?;
    proxy::machine(object)
}

fn of_machine(machine: &dyn KinematicModel, method: u32, text: &str) -> Result<String, Failure> {
    match method {
        ABBE_DESCRIBE => write(machine.info()),
        ABBE_MOTION_ERROR => {
            let question: MotionText = read(text)?;
            let known = question.function.axis < machine.info().axes.len()
                && question.function.component < 6
                && question.values.len() == machine.info().parameters.len()
                && question.status.len() == machine.info().status.len();
            if !known {
                return Err(Failure::of("the other side", "asked for a motion error of another machine"));
            }
            let status: Vec<f64> = question.status.into_iter().map(|value| value.unwrap_or(f64::NAN)).collect();
            write(machine.motion_error(&question.function, &question.values, &status)?)
        }
        _ => Err(no_method(method)),
    }
}

fn of_observations(
    observations: &dyn Observations,
    given: Option<&Arc<Dataset>>,
    method: u32,
    text: &str,
) -> Result<String, Failure> {
    match method {
        ABBE_DESCRIBE => write(ObservationsText::of(observations, given)),
        ABBE_CONTACT_TIP => {
            let question: TipText = read(text)?;
            check_tip(observations.info(), &question)?;
            write(observations.contact_tip(question.row, question.tip, &question.own, &question.inputs)?)
        }
        _ => Err(no_method(method)),
    }
}

fn of_ingest(stage: &dyn Ingest, method: u32) -> Result<String, Failure> {
    match method {
        ABBE_INPUTS => write(InputText::of(stage.inputs())),
        ABBE_HEADERS => write(stage.headers()?),
        ABBE_READ => write(stage.read()?),
        _ => Err(no_method(method)),
    }
}

fn of_artefact(
    stage: &dyn Artefact,
    method: u32,
    text: &str,
    objects: &[Received],
) -> Result<(String, Vec<Arc<Served>>), Failure> {
    match method {
        ABBE_INPUTS => write(InputText::of(stage.inputs())).map(alone),
        ABBE_CHECK => {
            let CheckText { headers, file } = read(text)?;
            stage.check(&headers, file.as_ref(), machine(objects)?.as_ref())?;
            write(()).map(alone)
        }
        ABBE_OBSERVE => {
            let data = Arc::new(read::<Dataset>(text)?);
            let observations = stage.observe(&data, &machine(objects)?)?;
            Ok((write(())?, vec![Arc::new(Served::Observations(observations, Some(data)))]))
        }
        ABBE_TARGETS => write(stage.targets(read(text)?)?).map(alone),
        _ => Err(no_method(method)),
    }
}

fn of_model(stage: &dyn Model, method: u32, text: &str) -> Result<(String, Vec<Arc<Served>>), Failure> {
    match method {
        ABBE_INPUTS => write(InputText::of(stage.inputs())).map(alone),
        ABBE_BUILD => {
            let data: Vec<Dataset> = read(text)?;
            let machine = stage.build(&data.iter().collect::<Vec<_>>())?;
            Ok((write(())?, vec![Arc::new(Served::Machine(machine))]))
        }
        _ => Err(no_method(method)),
    }
}

fn of_estimator(stage: &dyn Estimate, method: u32, text: &str, objects: &[Received]) -> Result<String, Failure> {
    let problem = || read::<ProblemText>(text)?.problem(objects);
    match method {
        ABBE_SOLVE => write(stage.estimate(&problem()?)?),
        ABBE_EXPLAIN => write(stage.explain(&problem()?)?),
        ABBE_VALUES => write(stage.values(&problem()?)?),
        ABBE_ANALYSE => write(stage.analyse(&read::<FitText>(text)?.fit(objects)?)?),
        ABBE_IDENTIFY => write(stage.identify(&problem()?)?),
        ABBE_ACCEPTS => write(stage.accepts(&read::<Identifiability>(text)?)?),
        _ => Err(no_method(method)),
    }
}

fn of_validator(stage: &dyn Validate, method: u32, text: &str, objects: &[Received]) -> Result<String, Failure> {
    match method {
        ABBE_INPUTS => write(InputText::of(stage.inputs())),
        ABBE_OBSERVATIONS => write(stage.observations()),
        ABBE_JUDGE => {
            let JudgeText { fits, data } = read(text)?;
            let fits = fits.into_iter().map(|fit| fit.fit(objects)).collect::<Result<Vec<Fit>, _>>()?;
            write(stage.validate(&fits.iter().collect::<Vec<_>>(), &data.iter().collect::<Vec<_>>())?)
        }
        _ => Err(no_method(method)),
    }
}

fn of_exporter(stage: &dyn Export, method: u32, text: &str, objects: &[Received]) -> Result<String, Failure> {
    match method {
        ABBE_INPUTS => write(InputText::of(stage.inputs())),
        ABBE_WRITE => {
            let calibration: Calibration = read(text)?;
            let files = stage.export(&calibration, machine(objects)?.as_ref())?;
            write(files.into_iter().map(FileText::from).collect::<Vec<_>>())
        }
        _ => Err(no_method(method)),
    }
}

/// Builds a stage of a plugin, to be served.
pub(crate) fn create(plugin: &Plugin, settings: &str, context: &Context) -> Result<Served, Failure> {
    let settings: Value =
        from_json(settings).map_err(|error| SettingsError::new("", format!("the settings are no JSON: {error}")))?;
    Ok(match &plugin.build {
        Build::Ingest(constructor) => Served::Ingest(constructor.build(&settings, context)?),
        Build::Artefact(constructor) => Served::Artefact(constructor.build(&settings, context)?),
        Build::Model(constructor) => Served::Model(constructor.build(&settings, context)?),
        Build::Estimate(constructor) => Served::Estimate(Arc::from(constructor.build(&settings, context)?)),
        Build::Validate(constructor) => Served::Validate(constructor.build(&settings, context)?),
        Build::Export(constructor) => Served::Export(constructor.build(&settings, context)?),
    })
}
