//! The program that measures a plan, for the key `program` under `plan`.

use std::path::PathBuf;

use abbe_core::{DataRow, Dataset, Error, PathItem, Result};
use abbe_measuring::{Control, Touches};
use abbe_planning::Planning;
use abbe_recipe::Stage;

use crate::prepare::Prepared;

impl Prepared {
    /// The files of the measuring program of these rows; none if no program is wanted. A control that is given takes the place of
    /// that of the recipe.
    pub(crate) fn programs(
        &self,
        wanted: &Planning,
        stage: &Stage,
        control: Option<Control>,
        candidates: &Dataset,
        rows: &[(DataRow, Option<f64>)],
    ) -> Result<Vec<(PathBuf, Vec<u8>)>> {
        let mut settings = match (&wanted.program, control) {
            (None, None) => return Ok(Vec::new()),
            (Some(settings), _) => settings.clone(),
            (None, Some(_)) => {
                let error = Error::usage("the recipe says nothing of the probe and of where it is clear");
                let help = "add `program: { control: .., probe: [..], clearance: .. }` to `plan`; see docs/measure.md";
                return Err(self.recipe.locate_plan(error.help(help)));
            }
        };
        settings.control = control.unwrap_or(settings.control);
        let (_, artefact) = self.artefact(&wanted.candidates)?;
        let model = self.located(stage, self.machine(stage)?.1.build(&[]))?;
        let files = artefact.targets(model.info().stylus_radius).and_then(|targets| {
            let touches = Touches::of_candidates(candidates, rows, &targets, model.as_ref())?;
            settings.files(&touches, &targets, model.as_ref())
        });
        let files = files.map_err(|mut error| {
            if error.place.is_none() {
                error.setting.insert(0, PathItem::Key("program".to_owned()));
            }
            self.recipe.locate_plan(error)
        })?;
        Ok(files.into_iter().map(|file| (PathBuf::from(file.name), file.content)).collect())
    }
}
