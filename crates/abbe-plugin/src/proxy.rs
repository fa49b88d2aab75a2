//! The traits of `abbe-core` for objects of the other side. What they say of themselves is checked once, what they compute
//! every time: nothing behind this border may make the program panic or go on with numbers that are none.

use std::any::Any;
use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use abbe_core::{
    Artefact, Axis, Calibration, ColumnHeader, Contact, Dataset, Equations, Error, ErrorFunction, Estimate, Export,
    ExportedFile, Feature, Findings, Fit, Identifiability, Ingest, InputFile, KinematicModel, KnownInput, Layout,
    Model, MotionError, Observations, Parameter, PoseValues, Poses, Problem, Quantity, Result, StatusColumn, Target,
    Validate, Variable,
};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::abi::*;
use crate::peer::{Answer, Failure, Known, Peer, Transit};
use crate::served::{Lent, Served};
use crate::texts::{
    CheckText, FileText, FitText, InputText, JudgeText, MachineText, MotionText, ObservationsText, ProblemText, TipText,
};

/// Asks a method whose answer is a text.
fn ask<Q: Serialize + ?Sized, A: DeserializeOwned>(
    peer: &dyn Peer,
    method: u32,
    question: &Q,
    objects: &[Arc<Served>],
) -> Result<A> {
    let answer = ask_whole(peer, method, question, objects)?;
    let broken = |error| Error::data(format!("{} gave an answer that cannot be read: {error}", peer.who()));
    serde_json::from_str(&answer.text).map_err(broken)
}

/// Asks a method whose answer is an object.
fn ask_object<Q: Serialize + ?Sized>(
    peer: &dyn Peer,
    method: u32,
    question: &Q,
    objects: &[Arc<Served>],
) -> Result<Transit> {
    let answer = ask_whole(peer, method, question, objects)?;
    answer.objects.into_iter().next().ok_or_else(|| Error::data(format!("{} gave no object", peer.who())))
}

fn ask_whole<Q: Serialize + ?Sized>(
    peer: &dyn Peer,
    method: u32,
    question: &Q,
    objects: &[Arc<Served>],
) -> Result<Answer> {
    let text = serde_json::to_string(question)
        .map_err(|error| Error::data(format!("what {} is asked cannot be written: {error}", peer.who())))?;
    peer.call(method, &text, objects).map_err(|failure| failure.error(peer.who()))
}

/// Every value has to be a number.
fn finite<'a>(peer: &dyn Peer, what: &str, values: impl IntoIterator<Item = &'a f64>) -> Result<()> {
    // Zero times anything finite is zero: one sum instead of a branch for each number.
    let sum: f64 = values.into_iter().map(|value| value * 0.0).sum();
    match sum == 0.0 {
        true => Ok(()),
        false => Err(Error::data(format!("{} gave {what} that are not finite numbers", peer.who()))),
    }
}

/// Texts that live for ever: names of settings, of which a library has a handful.
fn interned(text: &str) -> &'static str {
    static KNOWN: Mutex<BTreeSet<&'static str>> = Mutex::new(BTreeSet::new());
    let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    match known.get(text) {
        Some(known) => known,
        None => {
            let forever: &'static str = Box::leak(text.to_owned().into_boxed_str());
            known.insert(forever);
            forever
        }
    }
}

/// The files that a stage reads; asked once, when it is built.
fn inputs(peer: &dyn Peer) -> Result<Vec<InputFile>> {
    let inputs: Vec<InputText> = ask(peer, ABBE_INPUTS, &(), &[])?;
    Ok(inputs.into_iter().map(|input| InputFile { setting: interned(&input.setting), path: input.path }).collect())
}

/// A machine of the other side.
struct Machine {
    peer: Arc<dyn Peer>,
    text: MachineText,
}

/// The machine that came over.
pub(crate) fn machine(object: &Transit) -> Result<Arc<dyn KinematicModel>, Failure> {
    match object {
        Transit::Local(served) => match served.as_ref() {
            Served::Machine(machine) => Ok(machine.clone()),
            _ => Err(Failure::of("the other side", "gives an object that is no machine")),
        },
        Transit::Remote(peer) => {
            let mut text: MachineText = ask(peer.as_ref(), ABBE_DESCRIBE, &(), &[])?;
            if text.nominal.is_empty() {
                text.nominal.resize(text.parameters.len(), 0.0);
            }
            check_machine(&text).map_err(|what| Failure::of(peer.who(), what))?;
            Ok(Arc::new(Machine { peer: peer.clone(), text }))
        }
    }
}

fn check_machine(text: &MachineText) -> Result<(), String> {
    if text.status.is_empty() {
        return Err("describes a machine whose poses have no status".to_owned());
    }
    if let Some(axis) = text.axes.iter().find(|axis| axis.status >= text.status.len()) {
        return Err(format!(
            "describes a machine whose axis {} has status {}, which is not there",
            axis.name, axis.status
        ));
    }
    if let Some(function) = text.error_functions.iter().find(|f| f.axis >= text.axes.len() || f.component >= 6) {
        return Err(format!("describes a machine whose error {} is of no axis or component", function.symbol));
    }
    if !text.stylus_radius.is_finite() || text.stylus_radius < 0.0 {
        return Err(format!("describes a machine with a stylus radius of {} mm", text.stylus_radius));
    }
    if text.nominal.len() != text.parameters.len() || !text.nominal.iter().all(|value| value.is_finite()) {
        return Err("describes a machine whose nominal values are not one finite number a parameter".to_owned());
    }
    let mut names = BTreeSet::new();
    match text.parameters.iter().find(|parameter| parameter.name.is_empty() || !names.insert(&parameter.name)) {
        Some(parameter) => {
            Err(format!("describes a machine with two parameters `{}`, or one without a name", parameter.name))
        }
        None => Ok(()),
    }
}

/// What is behind a proxy.
pub(crate) fn behind(proxy: &dyn Any) -> Option<Arc<dyn Peer>> {
    let machine = proxy.downcast_ref::<Machine>().map(|machine| machine.peer.clone());
    machine.or_else(|| proxy.downcast_ref::<Observed>().map(|observed| observed.peer.clone()))
}

impl KinematicModel for Machine {
    fn axes(&self) -> &[Axis] {
        &self.text.axes
    }

    fn status(&self) -> &[StatusColumn] {
        &self.text.status
    }

    fn parameters(&self) -> &[Parameter] {
        &self.text.parameters
    }

    fn nominal(&self) -> Vec<f64> {
        self.text.nominal.clone()
    }

    fn stylus_radius(&self) -> f64 {
        self.text.stylus_radius
    }

    fn evaluate(
        &self,
        statuses: &[f64],
        values: &[f64],
        wanted: &[Variable],
        orientation: bool,
        out: &mut Poses,
    ) -> Result<()> {
        out.reset(statuses.len() / self.text.status.len(), wanted.len(), orientation);
        let peer = self.peer.as_ref();
        peer.poses(statuses, values, wanted, out).map_err(|failure| failure.error(peer.who()))?;
        finite(peer, "positions", out.positions.as_flattened())?;
        finite(peer, "derivatives", out.position_derivatives.as_flattened())?;
        let norm = |turn: &[f64; 4]| turn.iter().map(|part| part * part).sum::<f64>();
        // A comparison that NaN fails too.
        if !out.orientations.iter().all(|turn| (norm(turn) - 1.0).abs() < 1e-6) {
            return Err(Error::data(format!("{} gave orientations that are no unit quaternions", peer.who())));
        }
        finite(peer, "derivatives of orientations", out.rotation_derivatives.as_flattened())
    }

    fn behind(&self) -> Option<&dyn Any> {
        Some(self)
    }

    fn settings(&self) -> Value {
        self.text.settings.clone()
    }

    fn error_functions(&self) -> Vec<ErrorFunction> {
        self.text.error_functions.clone()
    }

    fn motion_error(&self, function: &ErrorFunction, values: &[f64], status: &[f64]) -> Result<MotionError> {
        let status = status.iter().copied().map(Some).collect();
        let question = MotionText { function: function.clone(), values: values.to_vec(), status };
        let peer = self.peer.as_ref();
        let error: MotionError = ask(peer, ABBE_MOTION_ERROR, &question, &[])?;
        if error.derivatives.iter().any(|by| by.0 >= self.text.parameters.len()) {
            return Err(Error::data(format!("{} gave a derivative to a parameter that is not there", peer.who())));
        }
        finite(peer, "motion errors", std::iter::once(&error.value).chain(error.derivatives.iter().map(|by| &by.1)))?;
        Ok(error)
    }
}

/// Observations of the other side.
struct Observed {
    peer: Arc<dyn Peer>,
    text: ObservationsText,
}

/// The observations that came over, made of the data set `given`.
pub(crate) fn observations(object: &Transit, given: Option<&Arc<Dataset>>) -> Result<Arc<dyn Observations>, Failure> {
    match object {
        Transit::Local(served) => match served.as_ref() {
            Served::Observations(observations, _) => Ok(observations.clone()),
            _ => Err(Failure::of("the other side", "gives an object that is no observations")),
        },
        Transit::Remote(peer) => {
            let mut text: ObservationsText = ask(peer.as_ref(), ABBE_DESCRIBE, &(), &[])?;
            text.layout.data = match (text.data.take(), given) {
                (Some(data), _) => Arc::new(data),
                (None, Some(given)) => given.clone(),
                (None, None) => return Err(Failure::of(peer.who(), "gives observations without a data set")),
            };
            check_observations(&text).map_err(|what| Failure::of(peer.who(), what))?;
            Ok(Arc::new(Observed { peer: peer.clone(), text }))
        }
    }
}

fn check_observations(text: &ObservationsText) -> Result<(), String> {
    let layout = &text.layout;
    let (poses, equations) = (layout.poses.len(), layout.standard_uncertainties.len());
    for (index, row) in layout.rows.iter().enumerate() {
        let inside = row.first_pose.checked_add(row.poses).is_some_and(|end| end <= poses)
            && row.first_equation.checked_add(row.equations).is_some_and(|end| end <= equations)
            && row.data_row.is_none_or(|data_row| data_row < layout.data.rows());
        if !inside {
            return Err(format!(
                "gives observations whose row {index} names a pose, equation or data row that is not there"
            ));
        }
    }
    if layout.standard_uncertainties.iter().any(|value| !(*value > 0.0 && value.is_finite())) {
        return Err("gives equations whose standard uncertainty is no positive number".to_owned());
    }
    if text.start.len() != text.unknowns.len() {
        return Err(format!("gives {} start values for {} unknowns", text.start.len(), text.unknowns.len()));
    }
    if layout.data.origins.iter().any(|origin| origin.file >= layout.data.files.len()) {
        return Err("gives data rows of a file that is not there".to_owned());
    }
    if let Some(equation) = text.angles.iter().find(|equation| **equation >= equations) {
        return Err(format!("says that equation {equation} is of an angle, and there is no such equation"));
    }
    let unknown = |(index, _): &(usize, [f64; 3])| *index >= text.unknowns.len();
    match text.features.iter().find(|feature| feature.shifts.iter().any(unknown)) {
        Some(feature) => Err(format!("gives a feature {} that an unknown shifts which is not there", feature.label)),
        None => Ok(()),
    }
}

impl Observations for Observed {
    fn layout(&self) -> &Layout {
        &self.text.layout
    }

    fn unknowns(&self) -> &[Parameter] {
        &self.text.unknowns
    }

    fn start(&self) -> Vec<f64> {
        self.text.start.clone()
    }

    fn inputs(&self) -> &[KnownInput] {
        &self.text.inputs
    }

    fn quantity(&self, row: usize, equation: usize) -> Quantity {
        match self.text.angles.contains(&(self.text.layout.rows[row].first_equation + equation)) {
            true => Quantity::Angle,
            false => Quantity::Length,
        }
    }

    fn needs_orientation(&self) -> bool {
        self.text.needs_orientation
    }

    fn evaluate(&self, rows: &[usize], poses: PoseValues<'_>, own: &[f64], inputs: &[f64], out: &mut Equations) {
        let first = out.residuals().len();
        if self.try_evaluate(rows, poses, own, inputs, out).is_err() {
            let wanted: usize = rows.iter().map(|&row| self.text.layout.rows[row].equations).sum();
            (out.residuals().len()..first + wanted).for_each(|_| out.equation(f64::NAN));
        }
    }

    fn try_evaluate(
        &self,
        rows: &[usize],
        poses: PoseValues<'_>,
        own: &[f64],
        inputs: &[f64],
        out: &mut Equations,
    ) -> Result<()> {
        let peer = self.peer.as_ref();
        let mut given = Equations::default();
        peer.equations(rows, poses, Known { own, inputs }, &mut given).map_err(|failure| failure.error(peer.who()))?;
        self.check(rows, &given)?;
        out.append(&given);
        Ok(())
    }

    fn behind(&self) -> Option<&dyn Any> {
        Some(self)
    }

    fn contact_tip(&self, row: usize, tip: [f64; 3], own: &[f64], inputs: &[f64]) -> Option<[f64; 3]> {
        let question = TipText { row, tip, own: own.to_vec(), inputs: inputs.to_vec() };
        ask(self.peer.as_ref(), ABBE_CONTACT_TIP, &question, &[]).unwrap_or_default()
    }

    fn features(&self) -> Vec<Feature> {
        self.text.features.clone()
    }

    fn contact(&self) -> Contact {
        self.text.contact.clone()
    }
}

impl Observed {
    /// Whether the equations are as many, and of as many poses, as the layout says, and of what there is.
    fn check(&self, rows: &[usize], given: &Equations) -> Result<()> {
        let peer = self.peer.as_ref();
        let rows = || rows.iter().map(|&row| self.text.layout.rows[row]);
        let (equations, poses): (usize, usize) =
            (rows().map(|row| row.equations).sum(), rows().map(|row| row.equations * row.poses).sum());
        let turned = if self.text.needs_orientation { poses } else { 0 };
        let found = (given.residuals().len(), given.by_position().len(), given.by_rotation().len());
        if found != (equations, poses, turned) {
            return Err(Error::data(format!(
                "{} gave {} equations with {} derivatives to positions and {} to rotations; {equations}, {poses} and {turned} were expected",
                peer.who(),
                found.0,
                found.1,
                found.2
            )));
        }
        let outside = given.by_own().iter().any(|by| by.1 >= self.text.unknowns.len())
            || given.by_input().iter().any(|by| by.1 >= self.text.inputs.len());
        if outside {
            return Err(Error::data(format!(
                "{} gave a derivative to an unknown or input that is not there",
                peer.who()
            )));
        }
        finite(peer, "residuals", given.residuals())?;
        finite(peer, "derivatives", given.by_position().as_flattened())?;
        finite(peer, "derivatives", given.by_rotation().as_flattened())?;
        finite(peer, "derivatives", given.by_own().iter().chain(given.by_input()).map(|by| &by.2))
    }
}

/// The estimator that came over.
pub(crate) fn estimator(object: &Transit) -> Arc<dyn Estimate> {
    match object {
        Transit::Local(served) => match served.as_ref() {
            Served::Estimate(estimator) => estimator.clone(),
            _ => Arc::new(NoEstimator),
        },
        Transit::Remote(peer) => Arc::new(Estimator { peer: peer.clone() }),
    }
}

/// Stands where the other side gave something that is no estimator.
struct NoEstimator;

impl Estimate for NoEstimator {
    fn estimate(&self, _: &Problem) -> Result<Calibration> {
        Err(Error::data("the other side gave an object that is no estimator"))
    }

    fn identify(&self, _: &Problem) -> Result<Identifiability> {
        Err(Error::data("the other side gave an object that is no estimator"))
    }
}

/// An estimator of the other side.
pub(crate) struct Estimator {
    pub peer: Arc<dyn Peer>,
}

impl Estimator {
    fn ask<A: DeserializeOwned>(&self, method: u32, problem: &Problem) -> Result<A> {
        let mut objects = Vec::new();
        let text = ProblemText::of(problem, &mut objects);
        ask(self.peer.as_ref(), method, &text, &objects)
    }

    /// A calibration has to be as good as one in a file.
    fn checked(&self, calibration: Calibration) -> Result<Calibration> {
        let text = calibration.to_json().and_then(|text| Calibration::from_json(&text));
        text.map_err(|error| Error::data(format!("{} gave a wrong calibration: {error}", self.peer.who())))
    }
}

impl Estimate for Estimator {
    fn estimate(&self, problem: &Problem) -> Result<Calibration> {
        self.ask(ABBE_SOLVE, problem).and_then(|calibration| self.checked(calibration))
    }

    fn explain(&self, problem: &Problem) -> Result<Calibration> {
        self.ask(ABBE_EXPLAIN, problem).and_then(|calibration| self.checked(calibration))
    }

    fn values(&self, problem: &Problem) -> Result<Vec<f64>> {
        let values: Vec<f64> = self.ask(ABBE_VALUES, problem)?;
        match values.len() == problem.unknowns.len() {
            true => Ok(values),
            false => Err(Error::data(format!(
                "{} gave {} values for {} unknowns",
                self.peer.who(),
                values.len(),
                problem.unknowns.len()
            ))),
        }
    }

    fn reconsider(&self, fit: &Fit) -> Result<Calibration> {
        let mut objects = Vec::new();
        let text = FitText::of(fit, &mut objects);
        ask(self.peer.as_ref(), ABBE_RECONSIDER, &text, &objects).and_then(|calibration| self.checked(calibration))
    }

    fn identify(&self, problem: &Problem) -> Result<Identifiability> {
        self.ask(ABBE_IDENTIFY, problem)
    }

    fn accepts(&self, found: &Identifiability) -> bool {
        ask(self.peer.as_ref(), ABBE_ACCEPTS, found, &[]).unwrap_or(false)
    }
}

/// A stage of the other side, with the files that it reads.
pub(crate) struct Stage {
    peer: Arc<dyn Peer>,
    inputs: Vec<InputFile>,
    observations: Vec<(&'static str, String)>,
}

impl Stage {
    pub fn new(peer: Arc<dyn Peer>) -> Result<Self> {
        Ok(Self { inputs: inputs(peer.as_ref())?, observations: Vec::new(), peer })
    }

    pub fn validator(peer: Arc<dyn Peer>) -> Result<Self> {
        let named: Vec<(String, String)> = ask(peer.as_ref(), ABBE_OBSERVATIONS, &(), &[])?;
        let observations = named.into_iter().map(|(setting, stage)| (interned(&setting), stage)).collect();
        Ok(Self { observations, ..Self::new(peer)? })
    }
}

impl Ingest for Stage {
    fn inputs(&self) -> Vec<InputFile> {
        self.inputs.clone()
    }

    fn headers(&self) -> Result<Vec<ColumnHeader>> {
        ask(self.peer.as_ref(), ABBE_HEADERS, &(), &[])
    }

    fn read(&self) -> Result<Dataset> {
        let data: Dataset = ask(self.peer.as_ref(), ABBE_READ, &(), &[])?;
        let rows = data.rows();
        let wrong = data.columns.iter().find(|column| match &column.values {
            abbe_core::Values::Numbers(numbers) => numbers.len() != rows || numbers.iter().any(|n| !n.is_finite()),
            abbe_core::Values::Labels(labels) => labels.len() != rows,
        });
        if let Some(column) = wrong {
            let name = &column.header.header;
            return Err(Error::data(format!(
                "{} gave a column `{name}` that has not {rows} cells, or cells that are not finite numbers",
                self.peer.who()
            )));
        }
        match data.origins.iter().all(|origin| origin.file < data.files.len()) {
            true => Ok(data),
            false => Err(Error::data(format!("{} gave rows of a file that it does not name", self.peer.who()))),
        }
    }
}

impl Artefact for Stage {
    fn inputs(&self) -> Vec<InputFile> {
        self.inputs.clone()
    }

    fn check(&self, headers: &[ColumnHeader], file: Option<&PathBuf>, model: &dyn KinematicModel) -> Result<()> {
        let question = CheckText { headers: headers.to_vec(), file: file.cloned() };
        Lent::during(model, |model| ask(self.peer.as_ref(), ABBE_CHECK, &question, &[model]))
    }

    fn observe(&self, data: &Arc<Dataset>, model: &dyn KinematicModel) -> Result<Arc<dyn Observations>> {
        let peer = self.peer.as_ref();
        let object = Lent::during(model, |lent| ask_object(peer, ABBE_OBSERVE, data.as_ref(), &[lent]))?;
        let observed = observations(&object, Some(data)).map_err(|failure| failure.error(peer.who()))?;
        let (poses, width) = (&observed.layout().poses, model.status().len());
        if !poses.is_empty() && poses.row(0).len() != width {
            let message =
                format!("{} gave poses of {} statuses; the machine has {width}", peer.who(), poses.row(0).len());
            return Err(Error::data(message));
        }
        Ok(observed)
    }

    fn targets(&self, stylus_radius: f64) -> Result<Vec<Target>> {
        ask(self.peer.as_ref(), ABBE_TARGETS, &stylus_radius, &[])
    }
}

impl Model for Stage {
    fn inputs(&self) -> Vec<InputFile> {
        self.inputs.clone()
    }

    fn build(&self, data: &[&Dataset]) -> Result<Arc<dyn KinematicModel>> {
        let object = ask_object(self.peer.as_ref(), ABBE_BUILD, data, &[])?;
        machine(&object).map_err(|failure| failure.error(self.peer.who()))
    }
}

impl Validate for Stage {
    fn inputs(&self) -> Vec<InputFile> {
        self.inputs.clone()
    }

    fn observations(&self) -> Vec<(&'static str, String)> {
        self.observations.clone()
    }

    fn validate(&self, fits: &[&Fit], data: &[&Dataset]) -> Result<Findings> {
        let mut objects = Vec::new();
        let fits = fits.iter().map(|fit| FitText::of(fit, &mut objects)).collect();
        let question = JudgeText { fits, data: data.iter().map(|data| (*data).clone()).collect() };
        ask(self.peer.as_ref(), ABBE_JUDGE, &question, &objects)
    }
}

impl Export for Stage {
    fn inputs(&self) -> Vec<InputFile> {
        self.inputs.clone()
    }

    fn export(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Vec<ExportedFile>> {
        let peer = self.peer.as_ref();
        let files: Vec<FileText> = Lent::during(model, |model| ask(peer, ABBE_WRITE, calibration, &[model]))?;
        let files: Vec<ExportedFile> = files.into_iter().map(ExportedFile::from).collect();
        let outside = |name: &str| {
            let path = std::path::Path::new(name);
            name.is_empty() || path.components().any(|part| !matches!(part, std::path::Component::Normal(_)))
        };
        match files.iter().find(|file| outside(&file.name)) {
            Some(file) => {
                Err(Error::data(format!("{} wants to write `{}`, outside of its folder", peer.who(), file.name)))
            }
            None => Ok(files),
        }
    }
}

#[cfg(test)]
mod tests;
