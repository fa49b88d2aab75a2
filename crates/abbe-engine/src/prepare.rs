//! From a recipe to built stages, with all checks that need no data rows.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use abbe_core::{
    Artefact, Build, ColumnHeader, Constructor, Context, Dataset, Error, Estimate, EstimateSource, Export, Ingest,
    InputFile, Kind, Model, Origin, PathItem, Plugin, Registry, Result, SettingsError, Validate,
    from_settings_in_range, ranges,
};
use abbe_estimation::Plausible;
use abbe_recipe::{Library, Recipe, Stage};
use serde_json::Value;

use crate::described::with_all_locations;
use crate::given::Given;
use crate::record::{FileRecord, PluginRecord};
use crate::row_settings::ArtefactRowSettings;
use crate::run::{has_problem, has_rows};
use crate::saved::{self, SavedCalibration};
use crate::staging::refuse_temporary;

/// The stages of a recipe, built and checked as far as that goes without data rows.
pub struct Prepared {
    /// The recipe.
    pub recipe: Recipe,
    /// The places of its stages by their names.
    places: BTreeMap<String, usize>,
    pub(crate) ingests: BTreeMap<String, Box<dyn Ingest>>,
    pub(crate) artefacts: BTreeMap<String, Box<dyn Artefact>>,
    pub(crate) rows: BTreeMap<String, ArtefactRowSettings>,
    pub(crate) models: BTreeMap<String, Box<dyn Model>>,
    /// The same machines with all location errors of their chains, where errors are listed line by line.
    pub(crate) with_locations: BTreeMap<String, Box<dyn Model>>,
    pub(crate) estimators: BTreeMap<String, Arc<dyn Estimate>>,
    /// Calibrations that were made outside this recipe, by their estimate stages.
    pub(crate) saved: BTreeMap<String, SavedCalibration>,
    pub(crate) plausible: BTreeMap<String, Plausible>,
    pub(crate) validators: BTreeMap<String, Box<dyn Validate>>,
    pub(crate) exporters: BTreeMap<String, Box<dyn Export>>,
    /// The plugins that the recipe uses.
    pub(crate) plugins: Vec<PluginRecord>,
    /// Every file that the recipe reads, itself first.
    pub(crate) files: Vec<PathBuf>,
    /// Whether the text of the recipe was read from its file.
    pub(crate) is_of_its_file: bool,
    /// The record of the recipe, if a program gives its text.
    pub(crate) given_recipe: Option<FileRecord>,
    /// The digests of tables that a program gives in the place of files, by their stages.
    pub(crate) tables: BTreeMap<String, String>,
}

/// Bytes of the largest file that a stage may read which is no measurement: nominal places, statements, tables of a control.
const LARGEST_INPUT: u64 = 4 << 30;

/// Reads a recipe, builds its stages and checks them.
///
/// Fails with [`abbe_core::Class::Use`] on everything that is wrong with the recipe, the files that it names and their
/// headers.
pub fn prepare(path: &Path, registry: &Registry) -> Result<Prepared> {
    prepared(Recipe::read(path, registry)?, registry).map(Prepared::of_its_file)
}

/// Builds the stages of a recipe and checks them, as [`prepare`]. Its text need not be that of the file at its path.
pub fn prepared(recipe: Recipe, registry: &Registry) -> Result<Prepared> {
    built(recipe, registry, &Given::default())
}

/// As [`prepared`], with what a program gives in the place of files.
pub(crate) fn built(recipe: Recipe, registry: &Registry, given: &Given) -> Result<Prepared> {
    let loaded = |library: &&Library| {
        registry.iter().any(|plugin| matches!(&plugin.origin, Origin::Library { file, .. } if *file == library.path))
    };
    if let Some(library) = recipe.libraries.iter().find(|library| !loaded(library)) {
        let mut error = Error::usage(format!("the plugin library {} has not been loaded", library.path.display()));
        error.place = library.place.clone();
        return Err(error);
    }
    let mut prepared = Prepared {
        ingests: BTreeMap::new(),
        artefacts: BTreeMap::new(),
        rows: BTreeMap::new(),
        models: BTreeMap::new(),
        with_locations: BTreeMap::new(),
        estimators: BTreeMap::new(),
        saved: BTreeMap::new(),
        plausible: BTreeMap::new(),
        validators: BTreeMap::new(),
        exporters: BTreeMap::new(),
        files: if given.recipe.is_some() { Vec::new() } else { vec![recipe.path.clone()] },
        is_of_its_file: false,
        given_recipe: given.recipe_record(&recipe.path),
        tables: BTreeMap::new(),
        plugins: Vec::new(),
        places: recipe.stages.iter().enumerate().map(|(place, stage)| (stage.name.clone(), place)).collect(),
        recipe,
    };
    prepared.files.extend(prepared.recipe.libraries.iter().map(|library| library.path.clone()));
    let context = Context { base: prepared.recipe.base.clone() };
    for stage in prepared.recipe.stages.clone() {
        let inputs = prepared.build(&stage, registry, &context)?;
        let inputs = prepared.take_table(&stage, given, inputs)?;
        prepared.files.extend(stage.files.iter().cloned());
        for InputFile { setting, path } in inputs {
            if !path.is_file() && prepared.is_planned(&stage.name) {
                continue;
            }
            let refused = |message: String, help: &str| {
                let error = Error::usage(message).help(help).setting(setting);
                prepared.recipe.locate(error.stage(&stage.name))
            };
            refuse_temporary(&path)
                .map_err(|error| prepared.recipe.locate(error.setting(setting).stage(&stage.name)))?;
            let size = match abbe_files::open(&path).and_then(|file| file.metadata()) {
                Ok(found) => found.len(),
                Err(error) if error.kind() == io::ErrorKind::NotFound => {
                    let help = "relative paths start at the folder of the recipe";
                    let message = match path.as_os_str().is_empty() {
                        true => "the name of a file was expected, and this is an empty text".to_owned(),
                        false => format!("{} does not exist", path.display()),
                    };
                    return Err(refused(message, help));
                }
                Err(error) => {
                    let help = "name files that can be read; a pattern takes whatever matches it";
                    return Err(refused(
                        format!("{} cannot be read: {}", path.display(), abbe_files::why(&error)),
                        help,
                    ));
                }
            };
            if stage.kind != Kind::Ingest && size > LARGEST_INPUT {
                let (found, most) = (size >> 30, LARGEST_INPUT >> 30);
                let message = format!("{} has {found} GiB; {most} at most were expected", path.display());
                return Err(refused(message, "name the file that is meant"));
            }
            prepared.files.push(path);
        }
        if stage.kind == Kind::Estimate && stage.estimate_source == EstimateSource::Calibration {
            let saved = SavedCalibration::new(&stage, prepared.estimators[&stage.name].as_ref(), registry);
            let saved = saved.map_err(|error| prepared.recipe.locate(error.stage(&stage.name)))?;
            prepared.saved.insert(stage.name.clone(), saved);
        }
    }
    prepared.files.dedup();
    prepared.files.iter().try_for_each(|file| refuse_temporary(file))?;
    for stage in &prepared.recipe.stages {
        prepared.check_stage(stage).map_err(|error| prepared.recipe.locate(error.stage(&stage.name)))?;
    }
    Ok(prepared)
}

impl Prepared {
    /// The same, with a recipe whose text is that of its file.
    pub(crate) fn of_its_file(self) -> Self {
        Self { is_of_its_file: true, ..self }
    }

    /// Every file that the recipe reads, itself first.
    pub fn files(&self) -> &[PathBuf] {
        &self.files
    }

    /// The plugins that take part.
    pub fn plugins(&self) -> &[PluginRecord] {
        &self.plugins
    }

    /// The files of measurements of an ingest stage (its setting `path`), in the order in which they are read.
    pub fn measured_files(&self, ingest: &str) -> Result<Vec<PathBuf>> {
        let none = || {
            let error = Error::usage(format!("`{ingest}` reads no files of measurements by a setting `path`"));
            self.recipe.locate(error.stage(ingest))
        };
        let files = self.ingests.get(ingest).ok_or_else(none)?.inputs().into_iter();
        let files: Vec<PathBuf> = files.filter(|file| file.setting == "path").map(|file| file.path).collect();
        if files.is_empty() { Err(none()) } else { Ok(files) }
    }

    /// Builds one stage; gives the files that it reads.
    fn build(&mut self, stage: &Stage, registry: &Registry, context: &Context) -> Result<Vec<InputFile>> {
        let wrong = |error: SettingsError| self.recipe.settings_error(&stage.name, error);
        let plugin = registry.find(stage.kind, &stage.plugin).map_err(wrong)?;
        let record = PluginRecord::of(plugin);
        if !self.plugins.contains(&record) {
            self.plugins.push(record);
        }
        let settings = &stage.settings;
        let name = stage.name.clone();
        let schema = plugin.schema.get();
        if plugin.kind() != Kind::Model {
            ranges::check(schema, settings).map_err(wrong)?;
        }
        match &plugin.build {
            Build::Ingest(constructor) => {
                let built = constructor.build(settings, context).map_err(wrong)?;
                let inputs = built.inputs();
                self.ingests.insert(name, built);
                Ok(inputs)
            }
            Build::Artefact(constructor) => {
                let built = constructor.build(settings, context).map_err(wrong)?;
                let rows = ArtefactRowSettings::new(stage, &context.base).map_err(wrong)?;
                let mut inputs = built.inputs();
                inputs.extend(rows.input().map(|path| InputFile { setting: "uncertainty", path: path.clone() }));
                self.artefacts.insert(name.clone(), built);
                self.rows.insert(name, rows);
                Ok(inputs)
            }
            Build::Model(constructor) => {
                let (settings, before) = self.model_settings(stage)?;
                let wrong = |error: SettingsError| wrong(saved::own_place(error, &before));
                ranges::check(schema, &settings).map_err(wrong)?;
                let built = constructor.build(&settings, context).map_err(wrong)?;
                let inputs = built.inputs();
                let all = with_all_locations(plugin, &settings).and_then(|all| constructor.build(&all, context).ok());
                self.with_locations.extend(all.map(|all| (name.clone(), all)));
                self.models.insert(name, built);
                Ok(inputs)
            }
            Build::Estimate(constructor) => {
                let estimator: Arc<dyn Estimate> = Arc::from(constructor.build(settings, context).map_err(wrong)?);
                let inputs = estimator.inputs();
                let at = |error: SettingsError| error.under([PathItem::Key("plausible".to_owned())]);
                let plausible: Plausible = from_settings_in_range(&stage.plausible).map_err(at).map_err(wrong)?;
                plausible.check().map_err(at).map_err(wrong)?;
                self.plausible.insert(name.clone(), plausible);
                self.estimators.insert(name, estimator);
                Ok(inputs)
            }
            Build::Validate(constructor) => {
                let built = constructor.build(settings, context).map_err(wrong)?;
                let inputs = built.inputs();
                self.validators.insert(name, built);
                Ok(inputs)
            }
            Build::Export(constructor) => {
                let built = constructor.build(settings, context).map_err(wrong)?;
                let inputs = built.inputs();
                self.exporters.insert(name, built);
                Ok(inputs)
            }
        }
    }

    /// Checks stages against each other: columns against the machine, observations that a validator names.
    fn check_stage(&self, stage: &Stage) -> Result<()> {
        self.check_groups(stage)?;
        self.check_batches(stage)?;
        match stage.kind {
            Kind::Ingest if self.is_planned(&stage.name) => Ok(()),
            Kind::Ingest => self.headers(&stage.name).map(drop),
            Kind::Estimate if stage.estimate_source == EstimateSource::Readings => self.check_readings(stage),
            Kind::Estimate if !has_problem(&stage) => Ok(()),
            Kind::Estimate => self.check_columns(stage, stage.reference("observations")),
            Kind::Validate => {
                let others = stage.reference("observations");
                if !others.is_empty() && !self.validators[&stage.name].accepts_other_observations() {
                    let message =
                        format!("`{}` judges what its estimates observe; it takes no other observations", stage.plugin);
                    return Err(Error::usage(message).setting("observations"));
                }
                if !stage.reference("from").is_empty() && !self.validators[&stage.name].accepts_data() {
                    let message = format!("`{}` judges estimates; it reads no data of its own", stage.plugin);
                    return Err(Error::usage(message).setting("from"));
                }
                self.check_exports(stage)?;
                self.check_machines(stage, self.validators[&stage.name].accepts_readings())?;
                for fit in stage.reference("of") {
                    let estimate = self.own_estimate(fit)?;
                    let validator = &self.validators[&stage.name];
                    let are_there = !self.has_batches(estimate) || validator.accepts_rows_in_parts();
                    if others.is_empty() && !(has_rows(&estimate) && are_there) && validator.needs_rows() {
                        let message = format!(
                            "`{}` asks about the rows that an estimate was made of, and `{fit}` brings none",
                            stage.plugin
                        );
                        let help =
                            "judge an estimate of this recipe, or name `observations` where the validator takes some";
                        return Err(Error::usage(message).help(help).setting("of"));
                    }
                    self.check_columns(estimate, others)?;
                }
                for (setting, name) in self.validators[&stage.name].estimates() {
                    let of = stage.reference("of");
                    if !of.contains(&name) {
                        let error = Error::usage(format!("`{name}` is not among the estimates under `of`"));
                        return Err(error.setting(setting).suggest(&name, of.iter().map(String::as_str)));
                    }
                }
                for (setting, name) in self.validators[&stage.name].observations() {
                    for fit in stage.reference("of") {
                        let estimate = self.own_estimate(fit)?;
                        let observed = estimate.reference("observations");
                        if self.has_batches(estimate) && !self.validators[&stage.name].accepts_rows_in_parts() {
                            let message = format!(
                                "`{}` needs all rows of `{fit}` at once, and these are read in batches",
                                stage.plugin
                            );
                            let help = "leave out `batch_rows` where they are read, or this stage";
                            return Err(Error::usage(message).help(help).setting(setting));
                        }
                        if !observed.contains(&name) {
                            return Err(Error::usage(format!("`{name}` is not among the observations of `{fit}`"))
                                .setting(setting)
                                .suggest(&name, observed.iter().map(String::as_str)));
                        }
                    }
                }
                Ok(())
            }
            Kind::Export => self.check_machines(stage, self.exporters[&stage.name].accepts_readings()),
            Kind::Artefact | Kind::Model => Ok(()),
        }
    }

    /// Fails where one estimate is needed and there is one for every group of rows.
    fn check_groups(&self, stage: &Stage) -> Result<()> {
        let is_divided = |name: &String| self.recipe_stage(name).is_ok_and(|named| named.per.is_some());
        let keys: &[&str] = match stage.kind {
            Kind::Validate if stage.reference("observations").is_empty() => &[],
            Kind::Ingest | Kind::Artefact => &[],
            _ => &["of", "known", "start", "machine"],
        };
        let wrong = |key: &&str| stage.reference(key).iter().any(is_divided);
        if let Some(key) = keys.iter().copied().find(wrong) {
            let message = format!("`{key}` names an estimate that is one for every group (`per`); one was expected");
            return Err(Error::usage(message).help("estimate it once more, without `per`").setting(key));
        }
        let known = ["known", "start"].into_iter().find(|key| !stage.reference(key).is_empty());
        match known.filter(|_| stage.per.is_some()) {
            Some(key) => Err(Error::usage(format!("`{key}` beside `per`: groups know nothing of other estimates"))
                .help("estimate without one of the two")
                .setting(key)),
            None => Ok(()),
        }
    }

    /// Fails for exports that a validator cannot judge: it takes none, or they are made of another estimate.
    fn check_exports(&self, stage: &Stage) -> Result<()> {
        let exports = stage.reference("exports");
        if !exports.is_empty() && !self.validators[&stage.name].accepts_exports() {
            let message = format!("`{}` judges no exported files", stage.plugin);
            return Err(Error::usage(message).help("`validate: compensated` does").setting("exports"));
        }
        for name in exports {
            let of = self.recipe_stage(name)?.reference("of");
            if let Some(fit) = stage.reference("of").iter().find(|fit| !of.contains(fit)) {
                let message = format!("`{name}` is made of {}, not of `{fit}`", of.join(", "));
                return Err(Error::usage(message).setting("exports"));
            }
        }
        Ok(())
    }

    /// Whether the file of an ingest stage does not exist yet, because its rows are candidates that the key `plan` generates.
    fn is_planned(&self, ingest: &str) -> bool {
        let planned = self.recipe.plan.as_ref().filter(|plan| plan.generate.is_some());
        let stage = planned.and_then(|plan| self.recipe_stage(&plan.candidates).ok());
        let reads = stage.is_some_and(|stage| stage.reference("from").iter().any(|from| from == ingest));
        reads && self.ingests.get(ingest).is_some_and(|built| built.inputs().iter().any(|input| !input.path.is_file()))
    }

    /// Fails if the data of some artefact stages do not have the columns that the machine of an estimate needs.
    fn check_columns(&self, estimate: &Stage, observations: &[String]) -> Result<()> {
        if observations.is_empty() {
            return Ok(());
        }
        let (machine, model) = self.machine(estimate)?;
        let model = model.build(&[]).map_err(|error| error.stage(&machine.name))?;
        for name in observations {
            let (from, artefact) = self.artefact(name)?;
            let repeats = self.repeats(name)?;
            for ingest in std::iter::once(from).chain(repeats).filter(|ingest| !self.is_planned(ingest)) {
                let (headers, files) = (self.headers(ingest)?, self.ingests[ingest].inputs());
                let file = files.first().map(|file| &file.path);
                artefact.check(&headers, file, model.as_ref()).map_err(|error| error.stage(name))?;
            }
        }
        Ok(())
    }

    pub(crate) fn headers(&self, ingest: &str) -> Result<Vec<ColumnHeader>> {
        self.ingests[ingest].headers().map_err(|error| error.stage(ingest))
    }

    pub(crate) fn recipe_stage(&self, name: &str) -> Result<&Stage> {
        let stage = self.places.get(name).and_then(|place| self.recipe.stages.get(*place));
        stage.ok_or_else(|| Error::usage(format!("there is no stage `{name}`")))
    }

    /// The ingest stage that an artefact takes its rows from, and the artefact.
    pub(crate) fn artefact(&self, name: &str) -> Result<(&str, &dyn Artefact)> {
        let from = &self.recipe_stage(name)?.reference("from")[0];
        Ok((from, self.artefacts[name].as_ref()))
    }

    /// The ingest stage with the repeats of an artefact's rows.
    pub(crate) fn repeats(&self, artefact: &str) -> Result<Option<&str>> {
        Ok(self.recipe_stage(artefact)?.reference("repeats").first().map(String::as_str))
    }

    /// The estimate with its own machine and observations: the estimate itself, or the one that it analyses.
    pub(crate) fn own_estimate(&self, name: &str) -> Result<&Stage> {
        let stage = self.recipe_stage(name)?;
        match stage.reference("of").first() {
            Some(of) if stage.kind == Kind::Estimate && stage.estimate_source.may_analyse() => self.own_estimate(of),
            _ => Ok(stage),
        }
    }

    /// The model that an estimate uses, and the stage that it comes from: a model stage, or an estimate stage with a
    /// calibration that contains it.
    pub(crate) fn machine(&self, estimate: &Stage) -> Result<(&Stage, &dyn Model)> {
        let stage = self.machine_stage(estimate)?;
        match self.saved.get(&stage.name) {
            Some(saved) => Ok((stage, saved.model.as_ref())),
            None => Ok((stage, self.models[&stage.name].as_ref())),
        }
    }

    /// The logs of the sensors of a machine, and of the machine that it extends.
    pub(crate) fn logs(
        &self,
        machine: &Stage,
        read: impl Fn(&str) -> Result<Arc<Dataset>> + Copy,
    ) -> Result<Vec<Dataset>> {
        let mut logs = Vec::new();
        for name in machine.reference("logs") {
            logs.push(Dataset { is_log: true, ..read(name)?.as_ref().clone() });
        }
        if let (Kind::Model, Some(extended)) = (machine.kind, machine.reference("machine").first()) {
            logs.extend(self.logs(self.machine_stage(self.recipe_stage(extended)?)?, read)?);
        }
        Ok(logs)
    }

    /// The stage that the model of an estimate comes from.
    pub(crate) fn machine_stage(&self, estimate: &Stage) -> Result<&Stage> {
        let mut stage = self.recipe_stage(&estimate.name)?;
        while stage.kind != Kind::Model && stage.estimate_source != EstimateSource::Calibration {
            let next = stage.reference("machine").first().or(stage.reference("of").first());
            stage = self.recipe_stage(next.ok_or_else(|| Error::usage(format!("`{}` has no machine", stage.name)))?)?;
        }
        Ok(stage)
    }

    /// Stages of one kind, in the order in which they can run.
    pub(crate) fn stages(&self, kind: Kind) -> impl Iterator<Item = &Stage> {
        self.recipe.stages.iter().filter(move |stage| stage.kind == kind)
    }
}

/// Builds a plugin of the kind model from the settings that a calibration keeps.
pub(crate) fn build_model(plugin: &Plugin, settings: &Value) -> Result<Box<dyn Model>> {
    let build: &Constructor<dyn Model> = match &plugin.build {
        Build::Model(constructor) => constructor,
        _ => return Err(Error::data(format!("`{}` is no model plugin", plugin.name))),
    };
    build
        .build(settings, &Context { base: PathBuf::new() })
        .map_err(|error| Error::data(format!("the model of this calibration cannot be built: {error}")))
}
