//! The six kinds of stage.
//!
//! A stage is built from its settings without reading files. `inputs` lists the files that it will read, so that missing
//! files are found before the run.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use crate::dataset::{ColumnHeader, Dataset};
use crate::model::KinematicModel;
use crate::observations::{Observations, Target};
use crate::problem::Problem;
use crate::table::Table;
use abbe_results::Findings;
use abbe_results::{AskedOfPart, Calibration, Identifiability, PartEvidence};
use abbe_settings::{Error, Result};

/// A file that a stage reads.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct InputFile {
    /// The setting that names it.
    pub setting: &'static str,
    /// Where it is.
    pub path: PathBuf,
}

/// Measurements from files or another source.
pub trait Ingest: Send + Sync {
    /// The files that it reads.
    fn inputs(&self) -> Vec<InputFile>;

    /// The columns, without reading rows.
    fn headers(&self) -> Result<Vec<ColumnHeader>>;

    /// The data set.
    fn read(&self) -> Result<Dataset>;

    /// How many rows a batch has, if estimates are to read the rows in batches and never hold all of them. Default: none, all are
    /// held.
    fn batch_rows(&self) -> Option<usize> {
        None
    }

    /// The same rows in batches. Fails where [`batch_rows`](Self::batch_rows) is none, and for files that cannot be read so.
    fn batches(&self) -> Result<Box<dyn Batches + '_>> {
        Err(Error::usage("this stage reads all rows at once"))
    }

    /// Whether its files are tables, in which other numbers can be written. Default: they are.
    fn is_of_tables(&self) -> bool {
        true
    }

    /// The same stage with a table of a program in the place of its files. What its settings do to rows and columns they do to
    /// those of the table. Default: it takes none.
    fn with_table(self: Box<Self>, _table: Arc<Table>) -> Result<Box<dyn Ingest>> {
        Err(Error::usage("this stage reads files of its own format, and no table can take their place")
            .help("`ingest: csv` and the readers of Parquet and Arrow take tables"))
    }
}

/// The rows of a data set in batches, each of which is read when it is asked for, from any thread.
pub trait Batches: Send + Sync {
    /// How many batches there are.
    fn count(&self) -> usize;

    /// The rows of a batch. None may be left of it; each says where it stands in its file, as in a data set of all rows.
    fn read(&self, batch: usize) -> Result<Batch>;
}

/// A batch of the rows of a data set.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Batch {
    /// Its rows.
    pub data: Dataset,
    /// How many rows are left out of it because a number was not measured.
    pub left_out: usize,
}

/// The rows of a data set in their order, as often as they are asked for: a data set that is held, or one that is read in batches.
pub trait Passes: Sync {
    /// Shows all rows once, some at a time; data sets without rows are not shown. Those of one pass have the same columns, and each
    /// names its own files. Ends with the first error of `look`.
    fn pass(&self, look: &mut dyn FnMut(&Dataset) -> Result<()>) -> Result<()>;
}

impl Passes for &Dataset {
    fn pass(&self, look: &mut dyn FnMut(&Dataset) -> Result<()>) -> Result<()> {
        (**self).pass(look)
    }
}

impl Passes for Dataset {
    fn pass(&self, look: &mut dyn FnMut(&Dataset) -> Result<()>) -> Result<()> {
        if self.rows() > 0 { look(self) } else { Ok(()) }
    }
}

/// Observations of an artefact from a data set.
pub trait Artefact: Send + Sync {
    /// The files that it reads.
    fn inputs(&self) -> Vec<InputFile>;

    /// Fails if a data set with these columns, measured on this machine, cannot be used. `file` is for the message.
    fn check(&self, headers: &[ColumnHeader], file: Option<&PathBuf>, model: &dyn KinematicModel) -> Result<()>;

    /// Makes the observations. Rows of features that this artefact does not have are skipped; other artefacts may use them.
    fn observe(&self, data: &Arc<Dataset>, model: &Arc<dyn KinematicModel>) -> Result<Arc<dyn Observations>>;

    /// The observations of some rows of a data set, as [`observe`](Self::observe); none if no row is one of this artefact. It is asked
    /// only where [rows are independent](Self::rows_are_independent). Default: it fails without rows.
    fn observe_some(
        &self,
        data: &Arc<Dataset>,
        model: &Arc<dyn KinematicModel>,
    ) -> Result<Option<Arc<dyn Observations>>> {
        self.observe(data, model).map(Some)
    }

    /// Whether the observations of some rows of a data set, and those of its other rows, are together those of all: an equation, the
    /// name of an unknown or of a known input, its start value and its uncertainty do not depend on which other rows are there.
    /// Only then one estimate can be made of rows that no process has all of. Default: they may depend on it.
    fn rows_are_independent(&self) -> bool {
        false
    }

    /// The nominal programme: nominal tip positions for each feature.
    fn targets(&self, stylus_radius: f64) -> Result<Vec<Target>>;
}

/// A machine description.
pub trait Model: Send + Sync {
    /// The files that it reads.
    fn inputs(&self) -> Vec<InputFile> {
        Vec::new()
    }

    /// The kinematic model. Settings that depend on the data (the time scale of a drift) are taken from `data`. Without data
    /// they have to be in the settings; else the model can be used only to check names.
    fn build(&self, data: &[&Dataset]) -> Result<Arc<dyn KinematicModel>>;
}

/// A solver of problems, or a source of calibrations that were made by other means
/// ([`EstimateSource`](crate::EstimateSource)).
pub trait Estimate: Send + Sync {
    /// The files that it reads.
    fn inputs(&self) -> Vec<InputFile> {
        Vec::new()
    }

    /// Reads a calibration that was made outside this recipe and saved in a file. It is read before the run.
    fn read_calibration(&self) -> Result<Calibration> {
        Err(Error::usage("this estimator makes its estimates; it recalls none"))
    }

    /// One calibration of several: the parameters of `problem`, which has no rows, from `fits`.
    fn combine(&self, _problem: &Problem, _fits: &[&Fit]) -> Result<Calibration> {
        Err(Error::usage("this estimator makes one estimate; it combines no others").setting("of"))
    }

    /// Fails if readings with these columns cannot be used: one list for each stage under `from`
    /// ([`EstimateSource::Readings`](crate::EstimateSource::Readings)).
    fn check_readings(&self, _headers: &[Vec<ColumnHeader>]) -> Result<()> {
        Ok(())
    }

    /// What readings tell that are no geometry, in the order of `from`
    /// ([`EstimateSource::Readings`](crate::EstimateSource::Readings)). The result has the settings of this estimator in place of
    /// those of a model, so that it can be used again without the readings.
    fn estimate_readings(&self, _name: &str, _data: &[&Dataset]) -> Result<Calibration> {
        Err(Error::usage("this estimator solves problems of a machine; it takes no readings by `from`").setting("from"))
    }

    /// Whether it can estimate from readings that are read in batches, by
    /// [`estimate_readings_in_passes`](Self::estimate_readings_in_passes). Default: it needs all rows at once.
    fn accepts_readings_in_passes(&self) -> bool {
        false
    }

    /// As [`estimate_readings`](Self::estimate_readings), of rows that are shown again and again and need not be held. What it keeps of
    /// them does not grow with their number.
    fn estimate_readings_in_passes(&self, _name: &str, _data: &[&dyn Passes]) -> Result<Calibration> {
        Err(Error::usage("this estimator needs all rows at once").setting("from"))
    }

    /// Whether [`estimate_readings`](Self::estimate_readings) needs no iteration: then a check makes the estimate, too, and asks
    /// validators and exporters of it.
    fn estimates_readings_at_once(&self) -> bool {
        false
    }

    /// Solves the problem. For stated machine parameters ([`EstimateSource::Statement`](crate::EstimateSource::Statement)) the
    /// problem has no rows.
    fn estimate(&self, problem: &Problem) -> Result<Calibration>;

    /// Fails if it cannot estimate from rows in parts with its settings. Default: it needs all rows at once.
    fn accepts_parts(&self) -> Result<()> {
        Err(Error::usage("this estimator needs all rows at once").help("`gauss-newton` estimates from parts"))
    }

    /// The same for parts that can be asked again and again ([`Parts::ask`]). Default: as [`accepts_parts`](Self::accepts_parts).
    fn accepts_batches(&self) -> Result<()> {
        self.accepts_parts()
    }

    /// Solves a problem whose rows lie in `parts`, none of which has all; `problem` has the unknowns of all of them and no rows. The
    /// result is that of all rows at once, as far as rounding goes. Default: as [`accepts_parts`](Self::accepts_parts).
    fn estimate_parts(&self, _problem: &Problem, _parts: &dyn Parts) -> Result<Calibration> {
        self.accepts_parts().and(Err(Error::usage("this estimator makes no estimate of parts")))
    }

    /// Solves the problem and explains the result: uncertainty budgets, and the combinations that are determined worst.
    fn explain(&self, problem: &Problem) -> Result<Calibration> {
        self.estimate(problem)
    }

    /// The values of the unknowns only, from start values that are almost right. Monte Carlo calls this for every trial.
    fn values(&self, problem: &Problem) -> Result<Vec<f64>> {
        self.estimate(problem).map(|calibration| problem.values_of(&calibration))
    }

    /// The same as [`values`](Self::values) of a problem whose rows lie in `parts`. Default: as [`estimate_parts`](Self::estimate_parts).
    fn values_of_parts(&self, problem: &Problem, parts: &dyn Parts) -> Result<Vec<f64>> {
        self.estimate_parts(problem, parts).map(|calibration| problem.values_of(&calibration))
    }

    /// Fails if it cannot analyse an estimate whose rows are read in batches, by [`analyse_parts`](Self::analyse_parts). Default: it
    /// needs all rows at once.
    fn accepts_analysis_of_parts(&self) -> Result<()> {
        Err(Error::usage("this analysis needs all rows of the estimate at once").setting("of"))
    }

    /// As [`analyse`](Self::analyse), of an estimate whose rows lie in `parts`; its problem has no rows.
    fn analyse_parts(&self, _fit: &Fit, _parts: &dyn Parts) -> Result<Calibration> {
        self.accepts_analysis_of_parts().and(Err(Error::usage("this estimator analyses no rows in parts")))
    }

    /// As [`values`](Self::values), of many problems that differ from `problem` by errors of rows and by what is not estimated, and whose
    /// start values are its own: what they have in common is computed once. Monte Carlo asks for this.
    fn values_near<'a>(&'a self, _problem: &Problem) -> Box<ValuesOf<'a>> {
        Box::new(|problem| self.values(problem))
    }

    /// Analyses an earlier estimate, which the recipe names under `of`.
    fn analyse(&self, _fit: &Fit) -> Result<Calibration> {
        Err(Error::usage("this estimator makes its own estimate; it takes no other one by `of`").setting("of"))
    }

    /// Identifiability of the problem at its start values, judged at nominal contact, without solving it.
    fn identify(&self, problem: &Problem) -> Result<Identifiability>;

    /// Whether what earlier estimates know of the unknowns ([`Problem::priors`]) counts; else unknowns only start there.
    fn counts_priors(&self) -> bool {
        false
    }

    /// As [`identify`](Self::identify), of a problem whose rows lie in `parts`. Default: as [`accepts_parts`](Self::accepts_parts).
    fn identify_parts(&self, _problem: &Problem, _parts: &dyn Parts) -> Result<Identifiability> {
        self.accepts_parts().and(Err(Error::usage("this estimator judges no rows in parts")))
    }

    /// Whether it would solve a problem with this identifiability.
    fn accepts(&self, found: &Identifiability) -> Result<bool> {
        Ok(found.rank == found.unknowns)
    }
}

/// The values of the unknowns of a problem.
pub type ValuesOf<'a> = dyn Fn(&Problem) -> Result<Vec<f64>> + Sync + 'a;

/// A question to some of the rows of a problem, with their number in the order of the rows.
pub type QuestionToRows<'a> = dyn Fn(usize, &Problem) -> Result<PartEvidence> + Sync + 'a;

/// The rows of a problem, in parts that are read again each time that something is asked of them.
pub trait Parts {
    /// How many parts there are.
    fn count(&self) -> usize;

    /// What a part tells at some values of the unknowns of the whole problem, by their names.
    fn evidence(&self, part: usize, asked: AskedOfPart, at: &BTreeMap<String, f64>) -> Result<Arc<PartEvidence>>;

    /// What all rows answer to a question, asked of problems each of which has some of them and their unknowns; answers are joined in the
    /// order of the rows. Default: none, where other processes read the rows.
    fn ask(&self, _question: &QuestionToRows<'_>) -> Result<Option<PartEvidence>> {
        Ok(None)
    }

    /// Rows that are chosen at random of all, some ten thousand, as a problem of their own. Default: none, as for [`ask`](Self::ask).
    fn sample(&self) -> Result<Option<Problem>> {
        Ok(None)
    }
}

impl dyn Parts + '_ {
    /// Shows all rows, in problems each of which has some of them and their unknowns, with the number of each in the order of the rows.
    /// Several threads may show at the same time, in any order. Fails where other processes read the rows.
    pub fn show(&self, look: &(dyn Fn(usize, &Problem) -> Result<()> + Sync)) -> Result<()> {
        let seen = self.ask(&|number, problem| look(number, problem).map(|()| PartEvidence::default()))?;
        seen.map(drop).ok_or_else(|| Error::usage("these rows cannot be read again: other processes have them"))
    }
}

/// An estimate with everything that is needed to validate it or to repeat it on other rows.
pub struct Fit {
    /// Name of the estimate.
    pub name: String,
    /// The problem that was solved.
    pub problem: Arc<Problem>,
    /// The estimator that solved it.
    pub estimator: Arc<dyn Estimate>,
    /// The result.
    pub calibration: Calibration,
}

/// Validates calibrations.
pub trait Validate: Send + Sync {
    /// The files that it reads.
    fn inputs(&self) -> Vec<InputFile> {
        Vec::new()
    }

    /// The observations that its settings name: (setting, stage).
    fn observations(&self) -> Vec<(&'static str, String)> {
        Vec::new()
    }

    /// The estimates under `of` that its settings name: (setting, stage).
    fn estimates(&self) -> Vec<(&'static str, String)> {
        Vec::new()
    }

    /// Whether it can judge observations that were not used in a fit (the reference `observations`). It then gets fits whose
    /// problem has these observations, the values of the calibration and no unknowns.
    fn accepts_other_observations(&self) -> bool {
        false
    }

    /// Whether it finds the features of other observations itself. Else an estimate that it judges has to know their places and sizes.
    fn finds_features(&self) -> bool {
        false
    }

    /// Whether it reads data of its own (the reference `from`).
    fn accepts_data(&self) -> bool {
        false
    }

    /// Whether it needs the rows of an estimate, or repeats the estimate. It cannot judge a calibration without rows, unless
    /// it gets other observations.
    fn needs_rows(&self) -> bool {
        false
    }

    /// Whether it can judge an estimate whose rows are read in batches, by [`validate_parts`](Self::validate_parts). Default: it needs
    /// all rows at once.
    fn accepts_rows_in_parts(&self) -> bool {
        false
    }

    /// As [`validate`](Self::validate), of estimates some of which have their rows in parts; the problems of these have no rows.
    fn validate_parts(&self, _fits: &[(&Fit, Option<&dyn Parts>)], _data: &[&Dataset]) -> Result<Findings> {
        Err(Error::usage("this validator needs all rows of an estimate at once").setting("of"))
    }

    /// Whether it can judge an estimate of readings that are no geometry, which has no machine.
    fn accepts_readings(&self) -> bool {
        false
    }

    /// Whether it judges what controls do with exported files (the reference `exports`).
    fn accepts_exports(&self) -> bool {
        false
    }

    /// Figures and limits for the given fits; `data` are the data sets of the stages under `from`, if any.
    fn validate(&self, fits: &[&Fit], data: &[&Dataset]) -> Result<Findings>;

    /// Fails where [`validate`](Self::validate) does. It is asked before a long run, of fits that are still to be made. Default: it
    /// validates; what takes long and refuses nothing may be left out.
    fn rehearse(&self, fits: &[&Fit], data: &[&Dataset]) -> Result<()> {
        self.validate(fits, data).map(drop)
    }

    /// Whether the data sets under `from` may be read in batches: then it gets them by [`validate_in_passes`](Self::validate_in_passes).
    /// Default: it needs all rows at once.
    fn accepts_data_in_passes(&self) -> bool {
        false
    }

    /// As [`validate`](Self::validate), with rows that are shown again and again and need not be held.
    fn validate_in_passes(&self, _fits: &[&Fit], _data: &[&dyn Passes]) -> Result<Findings> {
        Err(Error::usage("this validator needs all rows at once").setting("from"))
    }

    /// As [`validate`](Self::validate), with the exporters of the stages under `exports` and the names of these stages.
    fn validate_exports(&self, fits: &[&Fit], data: &[&Dataset], _exports: &[(&str, &dyn Export)]) -> Result<Findings> {
        self.validate(fits, data)
    }
}

/// A file to be written, whole or not at all.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ExportedFile {
    /// Its name inside the folder of the run.
    pub name: String,
    /// Its content.
    pub content: Vec<u8>,
}

/// Writes files for other programs: controllers, spreadsheets.
pub trait Export: Send + Sync {
    /// The files that it reads.
    fn inputs(&self) -> Vec<InputFile> {
        Vec::new()
    }

    /// Whether it can export an estimate of readings that are no geometry, which has no machine.
    fn accepts_readings(&self) -> bool {
        false
    }

    /// The files for a calibration; `model` is the calibration's own.
    fn export(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Vec<ExportedFile>>;

    /// The files for an estimate with its rows; those for its calibration unless the exporter needs more.
    fn export_fit(&self, fit: &Fit) -> Result<Vec<ExportedFile>> {
        self.export(&fit.calibration, fit.problem.model.as_ref())
    }

    /// What a control with these files does to the commands of a program; none if the files correct nothing.
    fn correction(
        &self,
        _calibration: &Calibration,
        _model: &dyn KinematicModel,
    ) -> Result<Option<Box<dyn CommandCorrection>>> {
        Ok(None)
    }
}

/// What a control does to the commands of a program before its motors get them.
pub trait CommandCorrection: Send + Sync {
    /// The statuses with the commands of the motors, for programmed statuses: points x columns of the status of the model. All
    /// columns but those of commands stay: directions of approach are those of the program.
    fn commands(&self, programmed: &[f64]) -> Result<Vec<f64>>;
}
