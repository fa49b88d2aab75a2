//! Which measurements to make: a plan with the data file to fill in.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use abbe_core::{DataRow, Dataset, Error, Identifiability, Monitor, Problem, Result, Values, WeakDirection, Whole};
use abbe_measuring::{Control, Measuring};
use abbe_planning::{Generation, LargestOfInput, Order, Plan, PlanFigures, Planning, Revisit, generate, plan};
use abbe_recipe::Stage;
use abbe_table::Layout as FileLayout;
use serde_json::{Value, json};

use crate::folder::write_folder;
use crate::prepare::Prepared;
use crate::problems::Taken;
use crate::run::{Datasets, has_rows};

/// Chosen measurements, in memory.
#[derive(Clone)]
pub struct Measurements {
    /// The planned estimate.
    pub estimate: String,
    /// The plan.
    pub plan: Plan,
    /// Identifiability of the planned estimate with these measurements.
    pub identifiability: Identifiability,
    /// Whether its estimator accepts this identifiability.
    pub accepted: bool,
    /// What the moves of the measuring program take, s, if one is written.
    pub seconds: Option<f64>,
    /// The text of `plan.json`.
    pub record: String,
    /// The data files with the chosen rows, relative to the folder that they are written into.
    pub files: BTreeMap<PathBuf, Vec<u8>>,
}

/// The record of a plan among its files.
const RECORD: &str = "plan.json";

impl Prepared {
    /// Chooses the measurements that the key `plan` of the recipe asks for.
    ///
    /// Fails if there is no such key, and as [`abbe_planning::plan`] does.
    pub fn plan(&self) -> Result<Measurements> {
        self.plan_for(None)
    }

    /// As [`Self::plan`]; the measuring program is one for this control, whatever the recipe has.
    pub fn plan_for(&self, control: Option<Control>) -> Result<Measurements> {
        let wanted = self.recipe.plan.as_ref().ok_or_else(|| {
            Error::usage("the recipe says nothing of what is to be planned")
                .help("add `plan: { estimate: .., candidates: .., number: .. }` to it")
                .in_file(&self.recipe.path)
        })?;
        let stage = self.recipe_stage(&wanted.estimate)?;
        if !has_rows(&stage) {
            let error = Error::usage(format!("`{}` has no machine and observations of its own", stage.name))
                .help("name an estimate with `machine` and `observations`");
            return Err(self.recipe.locate_plan(error.setting("estimate")));
        }
        let generated = match &wanted.generate {
            Some(generation) => Some(self.generated(stage, wanted, generation)?),
            None => None,
        };
        let data =
            self.read(&Monitor::default(), generated.as_ref().map(|generated| (generated.ingest, &generated.data)))?;
        let problem = self.located(stage, self.problem(stage, &data, &mut Taken::default()))?;
        let estimator = &self.estimators[&stage.name];
        let candidates = match &generated {
            Some(generated) => &generated.data,
            None => &data[self.artefact(&wanted.candidates)?.0],
        };
        let settings = self.measuring(wanted, control)?;
        let located = |error| self.recipe.locate_plan(error);
        let made = |problem: &Problem| {
            let plan = match settings.as_ref().filter(|_| wanted.minutes.is_some()) {
                None => plan(problem, wanted, None).map_err(located),
                Some(settings) => self.timed(wanted, stage, settings, candidates, |timing| {
                    plan(problem, wanted, Some(timing)).map_err(located)
                }),
            };
            plan.map_err(|error| match estimator.identify(problem) {
                // These are not determined for any choice.
                Ok(all) if all.rank < all.unknowns => with_lost(error, &all),
                _ => error,
            })
        };
        let plan = match &generated {
            None => made(&problem)?,
            Some(_) => self.in_its_time((stage, &data), wanted, problem, made)?,
        };
        let identifiability = self.located(stage, estimator.identify(&plan.problem))?;
        let accepted = self.located(stage, estimator.accepts(&identifiability))?;
        let rows = rows_of(&plan, None, candidates);
        let (programs, seconds) = match settings {
            None => (Vec::new(), None),
            Some(settings) => {
                let settings = Measuring { repeats: Whole::new(plan.repeats as u64), ..settings };
                let (files, seconds) = self.programs(wanted, stage, &settings, candidates, &rows)?;
                (files, Some(seconds))
            }
        };
        let mut files = match &generated {
            Some(generated) => {
                let path = PathBuf::from(GENERATED);
                let text = chosen(&path, &generated.text, &rows_of(&plan, None, &generated.data), &generated.data)?;
                BTreeMap::from([(path, text)])
            }
            None => {
                let data = &data[self.artefact(&wanted.candidates)?.0];
                let layouts = self.layouts()?;
                let is_other = |file: &&PathBuf| layouts.get(*file).is_some_and(|own| *own != FileLayout::default());
                if let Some(file) = data.files.iter().find(is_other) {
                    let error =
                        Error::usage("the candidates are in a file with a layout of its own, which is not written");
                    return Err(error.in_file(file).help(
                        "save the candidates with commas, points and the names of the data set, or let `generate` make them",
                    ));
                }
                of_files(data, &plan)?
            }
        };
        let record = serde_json::to_string_pretty(&record(&stage.name, (&plan, seconds), &identifiability))
            .map_err(|error| Error::data(format!("the plan cannot be written: {error}")))?
            + "\n";
        if files.insert(PathBuf::from(RECORD), record.clone().into_bytes()).is_some() {
            return Err(Error::usage(format!(
                "a file of candidates is named `{RECORD}`, as the record of the plan is"
            ))
            .help("give the file of candidates another name"));
        }
        for (name, content) in programs {
            if files.insert(name.clone(), content).is_some() {
                let error = Error::usage(format!("a file of candidates is named `{}`", name.display()));
                return Err(error.help("give the file of candidates another name"));
            }
        }
        Ok(Measurements { estimate: stage.name.clone(), plan, identifiability, accepted, seconds, record, files })
    }
}

/// Plans that are made at most until the times of the last one are those of its machine. Two are enough where times change no choice.
const PASSES: usize = 4;

impl Prepared {
    /// The plan of a machine whose times are those of the plan. The scale of a drift is that of the data, and the times of
    /// generated candidates are none yet: an order says when they are measured, and that is when the drift will be estimated.
    fn in_its_time(
        &self,
        (stage, data): (&Stage, &Datasets),
        wanted: &Planning,
        problem: Problem,
        made: impl Fn(&Problem) -> Result<Plan>,
    ) -> Result<Plan> {
        let (ingest, _) = self.artefact(&wanted.candidates)?;
        let mut plan = made(&problem)?;
        let mut known = problem.model.info().settings.clone();
        for _ in 1..PASSES {
            let Some(timed) = plan.order.as_ref().and_then(|order| at_times_of(&data[ingest], order)) else { break };
            let mut timed_data = data.clone();
            timed_data.insert(ingest.to_owned(), Arc::new(timed));
            let model = self.located(stage, self.built_machine(stage, &timed_data))?;
            if model.info().settings == known {
                break;
            }
            known = model.info().settings.clone();
            let problem = self.problem_on(stage, model, data, &mut Taken::default());
            plan = made(&self.located(stage, problem)?)?;
        }
        Ok(plan)
    }
}

/// The data set with the first and the last time of an order. None without a column of times, which a machine without a drift may lack.
fn at_times_of(data: &Dataset, order: &Order) -> Option<Dataset> {
    let (first, last) = (order.rows.first()?.1, order.rows.iter().map(|(_, time)| *time).reduce(f64::max)?);
    let mut timed = data.clone();
    let column = timed.columns.iter_mut().find(|column| column.header.name == "time")?;
    let Values::Numbers(times) = &mut column.values else { return None };
    let end = times.len().checked_sub(1)?;
    times.iter_mut().enumerate().for_each(|(row, time)| *time = if row == end { last } else { first });
    Some(timed)
}

impl Prepared {
    /// All candidates that the key `plan` of the recipe generates, as the text of a data file.
    ///
    /// Fails if it generates none, or the machine reaches none.
    pub fn candidates(&self) -> Result<String> {
        let nothing = || Error::usage("the recipe generates no candidates").in_file(&self.recipe.path);
        let wanted = self.recipe.plan.as_ref().ok_or_else(nothing)?;
        let generation = wanted.generate.as_ref().ok_or_else(nothing)?;
        Ok(self.generated(self.recipe_stage(&wanted.estimate)?, wanted, generation)?.text)
    }
}

/// Candidates that were generated on a grid, instead of data that an ingest stage reads.
struct Generated<'a> {
    ingest: &'a str,
    text: String,
    data: Arc<Dataset>,
}

/// The file with the chosen candidates, if candidates were generated.
const GENERATED: &str = "candidates.csv";

impl Prepared {
    fn generated(&self, stage: &Stage, wanted: &Planning, generation: &Generation) -> Result<Generated<'_>> {
        let observed = stage.reference("observations");
        if !observed.contains(&wanted.candidates) {
            let error = Error::usage(format!("`{}` does not observe `{}`", stage.name, wanted.candidates));
            let error = error.setting("candidates").suggest(&wanted.candidates, observed.iter().map(String::as_str));
            return Err(self.recipe.locate_plan(error));
        }
        let (ingest, artefact) = self.artefact(&wanted.candidates)?;
        let model = self.located(stage, self.machine(stage)?.1.build(&[]))?;
        let text = generate(generation, artefact, model.as_ref()).map_err(|error| self.recipe.locate_plan(error))?;
        let data = Arc::new(abbe_table::parse(Path::new(GENERATED), text.as_bytes())?);
        Ok(Generated { ingest, text, data })
    }
}

impl Measurements {
    /// The expected standard uncertainties of the unknowns, in the planned order if there is one.
    pub fn standard_uncertainties(&self) -> Vec<f64> {
        self.plan.order.as_ref().map_or(&self.plan.figures, |order| &order.figures).standard_uncertainties()
    }

    /// Writes everything into the folder `out`, which must not exist or be empty: whole or not at all.
    pub fn write(&self, out: &Path) -> Result<()> {
        write_folder(out, &self.files)
    }
}

/// The error with the directions that all candidates together do not determine.
fn with_lost(error: Error, all: &Identifiability) -> Error {
    let lost: Vec<String> = all.null_space.iter().map(WeakDirection::describe).collect();
    Error { message: format!("{}:\n- {}", error.message, lost.join("\n- ")), ..error }
}

/// The chosen rows as in their files, under the header of their file.
fn of_files(data: &Dataset, plan: &Plan) -> Result<BTreeMap<PathBuf, Vec<u8>>> {
    let mut files = BTreeMap::new();
    for (index, path) in data.files.iter().enumerate() {
        let of_file = rows_of(plan, Some(index), data);
        if of_file.is_empty() {
            continue;
        }
        let text = abbe_table::read_text(path)?;
        // What is packed comes out as text.
        let unpacked = abbe_files::without_packing(path);
        let name = unpacked.file_name().map_or_else(|| PathBuf::from("plan.csv"), PathBuf::from);
        if files.insert(name, chosen(path, &text, &of_file, data)?).is_some() {
            return Err(Error::usage("two files of candidates have the same name")
                .help("give one of them another name")
                .in_file(path));
        }
    }
    Ok(files)
}

/// The chosen rows of a file, or of all, in the order in which they are measured, with their time if that is planned.
fn rows_of(plan: &Plan, file: Option<usize>, data: &Dataset) -> Vec<(DataRow, Option<f64>)> {
    let all: Vec<(DataRow, Option<f64>)> = match &plan.order {
        Some(order) => order.rows.iter().map(|&(row, time)| (row, Some(time))).collect(),
        None => plan.data_rows.iter().map(|&row| (row, None)).collect(),
    };
    all.into_iter().filter(|(row, _)| file.is_none_or(|file| data.origins[*row].file == file)).collect()
}

/// The column of times.
const TIME: &str = "time_s";

/// Some rows of a file, under its header, at their times.
fn chosen(path: &Path, text: &str, rows: &[(DataRow, Option<f64>)], data: &Dataset) -> Result<Vec<u8>> {
    let all: Vec<&str> = text.lines().collect();
    let header = all.iter().find(|line| !line.starts_with('#') && !line.trim().is_empty());
    let lines = rows.iter().filter_map(|&(row, _)| all.get(data.origins[row].line - 1));
    let mut written = format!("# {} rows, chosen by `abbe plan`\n", rows.len());
    header.into_iter().chain(lines).for_each(|line| written.extend([line, "\n"]));
    // The comment and the header are the first two lines.
    let timed = rows.iter().enumerate().filter_map(|(row, (_, time))| Some((row + 3, (*time)?)));
    let timed: Vec<(usize, String)> = timed.map(|(line, time)| (line, format!("{:.3}", time))).collect();
    if timed.is_empty() {
        return Ok(written.into_bytes());
    }
    let has_times = data.columns.iter().any(|column| column.header.header == TIME);
    let written = match has_times {
        true => {
            let cells = timed.into_iter().map(|(line, time)| (line, [(TIME.to_owned(), time)].into())).collect();
            abbe_table::with_cells(path, written.as_bytes(), &cells)?
        }
        false => {
            let cells = timed.into_iter().map(|(line, time)| (line, vec![time])).collect();
            abbe_table::with_columns(path, written.as_bytes(), &[TIME], &cells)?
        }
    };
    Ok(written.into_bytes())
}

/// When a reference is measured again.
fn revisit(revisit: &Revisit) -> Value {
    json!({
        "candidate": revisit.reference,
        "times_s": revisit.times,
        "until_s": revisit.until,
        "largest_standard_uncertainty_mm": revisit.largest,
    })
}

/// How large the uncertainty of a known input may be, in its own unit.
fn input(input: &LargestOfInput) -> Value {
    let largest = input.part.zip(input.stated).map(|(part, stated)| part * stated);
    json!({
        "name": input.name,
        "standard_uncertainty": input.stated,
        "largest_standard_uncertainty": largest,
        "suffices": input.part.is_some(),
    })
}

/// `plan.json`.
fn record(estimate: &str, (plan, seconds): (&Plan, Option<f64>), found: &Identifiability) -> Value {
    let figures = |figures: &PlanFigures| {
        json!({
            "equations": figures.equations,
            "log_determinant": figures.log_determinant,
            "condition": figures.condition,
            "response_variance_mean": figures.response_variance[0],
            "response_variance_max": figures.response_variance[1],
        })
    };
    let chosen = plan
        .chosen
        .iter()
        .map(|chosen| json!({ "candidate": chosen.label, "times": chosen.times, "required": chosen.required }));
    let unknowns = plan.problem.unknowns.iter().zip(plan.figures.standard_uncertainties());
    let unknowns = unknowns.map(|(unknown, uncertainty)| {
        json!({ "name": unknown.name, "unit": unknown.unit.to_string(), "standard_uncertainty": uncertainty })
    });
    let order = plan.order.as_ref().map(|order| {
        let sequence = order.sequence.iter().map(|(label, from)| json!({ "candidate": label, "start_s": from }));
        let uncertainties = plan.problem.unknowns.iter().zip(order.figures.standard_uncertainties());
        let uncertainties =
            uncertainties.map(|(unknown, value)| json!({ "name": unknown.name, "standard_uncertainty": value }));
        json!({
            "sequence": sequence.collect::<Vec<_>>(),
            "figures": figures(&order.figures),
            "as_listed": order.as_listed.as_ref().map(figures),
            "efficiency_as_listed": order.as_listed.as_ref().map(|listed| order.figures.efficiency_of(listed)),
            "efficiency_of_random": order.random_efficiency,
            "again": order.revisits.iter().map(revisit).collect::<Vec<_>>(),
            "unknowns": uncertainties.collect::<Vec<_>>(),
        })
    });
    let mut record = json!({
        "abbe_plan": 1,
        "estimate": estimate,
        "candidates": plan.candidates,
        "chosen": chosen.collect::<Vec<_>>(),
        "figures": figures(&plan.figures),
        "spread_evenly": plan.spread_evenly.as_ref().map(figures),
        "efficiency_spread_evenly": plan.spread_evenly.as_ref().map(|evenly| plan.figures.efficiency_of(evenly)),
        "efficiency_of_random": plan.random_efficiency,
        "searches_that_found_it": plan.searches_that_found_it,
        "unknowns": unknowns.collect::<Vec<_>>(),
        "rank": found.rank,
        "null_space": found.null_space,
    });
    if let (Some(reached), Some(record)) = (&plan.reached, record.as_object_mut()) {
        let reached = json!({
            "worst": reached.worst,
            "expanded": reached.expanded,
            "wanted": reached.wanted,
            "coverage_factor": reached.coverage_factor,
            "largest_standard_uncertainty_of_row": reached.largest_of_row,
            "inputs": reached.largest_of_inputs.iter().map(input).collect::<Vec<_>>(),
        });
        record.insert("until".to_owned(), reached);
    }
    if let (Some(seconds), Some(record)) = (seconds, record.as_object_mut()) {
        let program = json!({
            "seconds": seconds,
            "repeats": plan.repeats,
            "standard_uncertainty_of_mean_mm": plan.of_mean,
        });
        record.insert("program".to_owned(), program);
    }
    if let (Some(order), Some(record)) = (order, record.as_object_mut()) {
        record.insert("order".to_owned(), order);
    }
    record
}
