//! The program that measures a plan, for the key `program` under `plan`.

use std::path::PathBuf;

use abbe_core::{DataRow, Dataset, Error, PathItem, Result};
use abbe_measuring::{Control, Measuring, Timing, Touches};
use abbe_planning::Planning;
use abbe_recipe::Stage;

use crate::prepare::Prepared;

/// The files of a measuring program, and what its moves take, s.
pub(crate) type Program = (Vec<(PathBuf, Vec<u8>)>, f64);

impl Prepared {
    /// What the measuring program is to be; none if none is wanted. A control that is given takes the place of that of the recipe.
    pub(crate) fn measuring(&self, wanted: &Planning, control: Option<Control>) -> Result<Option<Measuring>> {
        let mut settings = match (&wanted.program, control) {
            (None, None) => return Ok(None),
            (Some(settings), _) => settings.clone(),
            (None, Some(_)) => {
                let error = Error::usage("the recipe says nothing of the probe and of where it is clear");
                let help = "add `program: { control: .., probe: [..], clearance: .. }` to `plan`; see docs/measure.md";
                return Err(self.recipe.locate_plan(error.help(help)));
            }
        };
        settings.control = control.unwrap_or(settings.control);
        Ok(Some(settings))
    }

    /// Does something with what the programs of these candidates take.
    pub(crate) fn timed<T>(
        &self,
        wanted: &Planning,
        stage: &Stage,
        settings: &Measuring,
        candidates: &Dataset,
        make: impl FnOnce(&Timing<'_>) -> Result<T>,
    ) -> Result<T> {
        let (_, artefact) = self.artefact(&wanted.candidates)?;
        let model = self.located(stage, self.machine(stage)?.1.build(&[]))?;
        let rows: Vec<(DataRow, Option<f64>)> = candidates.row_indices().map(|row| (row, None)).collect();
        let targets = artefact.targets(model.info().stylus_radius).map_err(|error| self.of_program(error))?;
        let touches = Touches::of_candidates(candidates, &rows, &targets, model.as_ref())
            .map_err(|error| self.of_program(error))?;
        let timing =
            Timing::new(settings, &touches, &targets, model.as_ref()).map_err(|error| self.of_program(error))?;
        make(&timing)
    }

    /// The files of the measuring program of these rows.
    pub(crate) fn programs(
        &self,
        wanted: &Planning,
        stage: &Stage,
        settings: &Measuring,
        candidates: &Dataset,
        rows: &[(DataRow, Option<f64>)],
    ) -> Result<Program> {
        let (_, artefact) = self.artefact(&wanted.candidates)?;
        let model = self.located(stage, self.machine(stage)?.1.build(&[]))?;
        let written = artefact.targets(model.info().stylus_radius).and_then(|targets| {
            let touches = Touches::of_candidates(candidates, rows, &targets, model.as_ref())?;
            settings.files(&touches, &targets, model.as_ref())
        });
        let written = written.map_err(|error| self.of_program(error))?;
        let files = written.files.into_iter().map(|file| (PathBuf::from(file.name), file.content));
        Ok((files.collect(), written.seconds))
    }

    fn of_program(&self, mut error: Error) -> Error {
        if error.place.is_none() {
            error.setting.insert(0, PathItem::Key("program".to_owned()));
        }
        self.recipe.locate_plan(error)
    }
}
