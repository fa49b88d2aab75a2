//! Stages of the other side.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use abbe_core::{
    Artefact, AxisKind, Calibration, ColumnHeader, Dataset, Error, Export, ExportedFile, Figure, Findings, Fit, Ingest,
    InputFile, KinematicModel, Model, Observations, ObservationsInfo, Result, Target, Validate,
};
use serde::Serialize;

use super::{ask, ask_whole, machine, observations};
use crate::abi::*;
use crate::peer::{Peer, Received, broken};
use crate::served::{Lent, Served};
use crate::texts::{CheckText, FileText, FitText, InputText, JudgeText};

/// Asks a method whose answer is an object.
fn ask_object<Q: Serialize + ?Sized>(
    peer: &dyn Peer,
    method: u32,
    question: &Q,
    objects: &[Arc<Served>],
) -> Result<Received> {
    let answer = ask_whole(peer, method, question, objects)?;
    answer.objects.into_iter().next().ok_or_else(|| broken(peer.who(), "gave no object"))
}

/// A text that is never freed. Used for names of settings only: a library has few of them.
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
            let what =
                format!("gave a column `{name}` that has not {rows} cells, or cells that are not finite numbers");
            return Err(broken(self.peer.who(), what));
        }
        let mut files =
            data.origins.iter().map(|origin| origin.file).chain(data.stated_tips.iter().map(|tip| tip.file));
        match files.all(|file| file < data.files.len()) {
            true => Ok(data),
            false => Err(broken(self.peer.who(), "gave rows of a file that it does not name")),
        }
    }
}

/// An axis that should move until contact, or while a reading is taken, and is no linear axis of the machine.
fn not_linear(info: &ObservationsInfo, model: &dyn KinematicModel) -> Option<usize> {
    let approached = info.approaches.iter().map(|approach| approach.axis);
    let read = info.rank_point.nominal_readings().flat_map(|(_, nominal)| nominal.axes.iter().copied());
    let linear = |axis: usize| model.info().axes.get(axis).is_some_and(|axis| axis.kind == AxisKind::Linear);
    approached.chain(read).find(|axis| !linear(*axis))
}

impl Artefact for Stage {
    fn inputs(&self) -> Vec<InputFile> {
        self.inputs.clone()
    }

    fn check(&self, headers: &[ColumnHeader], file: Option<&PathBuf>, model: &dyn KinematicModel) -> Result<()> {
        let question = CheckText { headers: headers.to_vec(), file: file.cloned() };
        Lent::during(model, |model| ask(self.peer.as_ref(), ABBE_CHECK, &question, &[model]))
    }

    fn observe(&self, data: &Arc<Dataset>, model: &Arc<dyn KinematicModel>) -> Result<Arc<dyn Observations>> {
        let peer = self.peer.as_ref();
        let object = ask_object(peer, ABBE_OBSERVE, data.as_ref(), &[Arc::new(Served::Machine(model.clone()))])?;
        let observed = observations(&object, Some(data)).map_err(|failure| failure.error(peer.who()))?;
        let (poses, width) = (&observed.info().layout.poses, model.info().status.len());
        let given = poses.indices().next().map_or(width, |first| poses.row(first).len());
        if given != width {
            return Err(broken(peer.who(), format!("gave poses of {given} statuses; the machine has {width}")));
        }
        match not_linear(observed.info(), model.as_ref()) {
            Some(axis) => {
                Err(broken(peer.who(), format!("gave rows that axis {axis} meets, which is no linear axis here")))
            }
            None => Ok(observed),
        }
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

    /// Only the library knows.
    fn accepts_data(&self) -> bool {
        true
    }

    fn validate(&self, fits: &[&Fit], data: &[&Dataset]) -> Result<Findings> {
        let mut objects = Vec::new();
        let fits = fits.iter().map(|fit| FitText::of(fit, &mut objects)).collect();
        let question = JudgeText { fits, data: data.iter().map(|data| (*data).clone()).collect() };
        let peer = self.peer.as_ref();
        let found: Findings = ask(peer, ABBE_JUDGE, &question, &objects)?;
        stays_inside(peer, found.tables.keys())?;
        found.figures.iter().try_for_each(|figure| is_sound(peer, figure))?;
        Ok(found)
    }
}

/// Refuses a figure that contradicts itself. The decision about a limit follows from the rule of the limit. A plugin that
/// cannot decide says so by `inconclusive`.
fn is_sound(peer: &dyn Peer, figure: &Figure) -> Result<()> {
    let (who, name) = (peer.who(), &figure.name);
    if let Some(uncertainty) = figure.standard_uncertainty.filter(|uncertainty| *uncertainty < 0.0) {
        return Err(Error::data(format!("{who} gave the figure `{name}` the standard uncertainty {uncertainty}")));
    }
    match (figure.decision, figure.decide()) {
        (Some(stated), Some(decided)) if stated != decided => {
            let message = format!("{who} says `{stated}` of the figure `{name}`, whose limit says `{decided}`");
            Err(Error::data(message).help("a plugin that cannot tell says why under `inconclusive`"))
        }
        (Some(stated), None) => {
            Err(Error::data(format!("{who} says `{stated}` of the figure `{name}`, which has no limit")))
        }
        _ => Ok(()),
    }
}

/// Refuses names of files outside of the folder of a stage.
fn stays_inside<'a>(peer: &dyn Peer, mut names: impl Iterator<Item = &'a String>) -> Result<()> {
    let outside = |name: &&String| {
        let path = std::path::Path::new(name);
        name.is_empty() || path.components().any(|part| !matches!(part, std::path::Component::Normal(_)))
    };
    match names.find(outside) {
        Some(name) => Err(broken(peer.who(), format!("wants to write `{name}`, outside of its folder"))),
        None => Ok(()),
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
        stays_inside(peer, files.iter().map(|file| &file.name))?;
        Ok(files)
    }
}
