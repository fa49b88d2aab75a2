//! One estimate of many shards: rounds of jobs, each of which asks all shards at the values that the answers before lead to.
//!
//! The iteration of the estimator runs on the answers that are there, from the start each time. Where it asks for one that is not
//! there, the values at which it asks are the next round; so the rounds are the steps of the iteration of all rows at once.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use abbe_core::{AskedOfPart, Error, PartEvidence, Parts, Registry, Result};
use abbe_engine::{OfParts, Part, prepared};
use abbe_recipe::Template;

use crate::BROKEN;
use crate::manifest::{Family, Job, Manifest, Point, Shard};
use crate::plan::name_of_shard;
use crate::store::Store;
use crate::worker::{Found, Registries, adapted};

/// What became of the estimates in shards of a fleet.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Rounds {
    /// Estimates whose shards have a new round to do.
    pub asked: Vec<String>,
    /// Estimates whose present round is not done.
    pub open: Vec<String>,
    /// Estimates that `merge` can write.
    pub done: Vec<String>,
    /// Estimates that cannot be made, with the reason.
    pub failed: Vec<(String, String)>,
}

/// Puts the next round of every estimate in shards into the manifest, which is written anew if one of them has a next round. It is
/// called in the folder where the paths of the fleet start.
///
/// # Errors
/// If the manifest or the recipes cannot be read, or the disk does not take the new manifest.
pub fn next_round(manifest: &mut Manifest, registries: &Registries<'_>) -> Result<Rounds> {
    let mut rounds = Rounds::default();
    if !manifest.has_shards() {
        return Ok(rounds);
    }
    let (mut jobs, mut points) = (Vec::new(), manifest.head.points.clone());
    let mut shards = Vec::new();
    manifest.each_job(0..manifest.head.jobs, |_, job| {
        let Some(shard) = &job.shard else {
            jobs.push(job);
            return Ok(());
        };
        let is_last = shard.number + 1 == shard.all;
        shards.push(job);
        if is_last {
            let family = &manifest.head.families[shards[0].family];
            let taken = std::mem::take(&mut shards);
            jobs.extend(asked_again(family, taken, &manifest.store(), registries, (&mut rounds, &mut points))?);
        }
        Ok(())
    })?;
    if !rounds.asked.is_empty() {
        let head = crate::manifest::Head { points, ..manifest.head.clone() };
        *manifest = Manifest::write(&manifest.path, head, &jobs)?;
    }
    Ok(rounds)
}

/// The shards of one estimate as they are asked next.
fn asked_again(
    family: &Family,
    mut shards: Vec<Job>,
    store: &Store,
    registries: &Registries<'_>,
    (rounds, points): (&mut Rounds, &mut BTreeMap<String, Point>),
) -> Result<Vec<Job>> {
    let Some(Shard { of, asked: present, .. }) = shards[0].shard.clone() else { return Ok(shards) };
    let estimate = Estimate::new(family, &shards, store, registries)?;
    let (asked, at) = match estimate.of_all() {
        Ok(Answer::Found(..)) => {
            rounds.done.push(of);
            return Ok(shards);
        }
        Ok(Answer::Asks(asked, at)) => (asked, at),
        Err(error) => {
            rounds.failed.push((of, error.to_string()));
            return Ok(shards);
        }
    };
    let is_present = present == asked && (asked == AskedOfPart::Start || points.get(&of) == Some(&at));
    if is_present {
        rounds.open.push(of);
        return Ok(shards);
    }
    // At the start every shard knows the values itself.
    match asked {
        AskedOfPart::Start => drop(points.remove(&of)),
        _ => drop(points.insert(of.clone(), at)),
    }
    let Estimate { texts, .. } = estimate;
    for (job, text) in shards.iter_mut().zip(&texts) {
        let Some(shard) = &mut job.shard else { continue };
        (shard.asked, shard.round) = (asked, shard.round + 1);
        job.name = name_of_shard(shard);
        job.job = job.hash(&family.recipe, text.value(), points);
    }
    rounds.asked.push(of);
    Ok(shards)
}

/// What all answers lead to.
pub(crate) enum Answer {
    /// The estimate.
    Found(Box<OfParts>),
    /// Answers that are not there: what is asked, and at which values.
    Asks(AskedOfPart, Point),
}

/// An estimate in shards.
pub(crate) struct Estimate<'a> {
    family: &'a Family,
    shards: &'a [Job],
    store: &'a Store,
    registry: Registry,
    /// The recipe of each shard.
    texts: Vec<Template>,
}

impl<'a> Estimate<'a> {
    /// The estimate of all shards of a combination, in their order.
    pub fn new(family: &'a Family, shards: &'a [Job], store: &'a Store, registries: &Registries<'_>) -> Result<Self> {
        let recipe = Path::new(&family.recipe);
        let (template, registry) = (Template::read(recipe, recipe)?, registries(recipe)?);
        let texts = shards.iter().map(|job| adapted(&template, job, family.dealt_out(), &registry));
        Ok(Self { family, shards, store, texts: texts.collect::<Result<_>>()?, registry })
    }

    /// The estimate, or what has to be asked before.
    pub fn of_all(&self) -> Result<Answer> {
        let none = Point::new();
        let start = (0..self.shards.len()).map(|shard| self.part(shard, AskedOfPart::Start, &none));
        let Some(known) = start.collect::<Result<Option<Vec<Arc<Part>>>>>()? else {
            return Ok(Answer::Asks(AskedOfPart::Start, none));
        };
        let answers = Answers { estimate: self, known: &known, missing: RefCell::default() };
        let first = prepared(self.texts[0].recipe(&self.registry)?, &self.registry)?;
        let stage = self.family.shards_of.as_deref().unwrap_or_default();
        match first.of_parts(stage, &known, &answers) {
            Ok(found) => Ok(Answer::Found(Box::new(found))),
            Err(error) => match answers.missing.take() {
                Some((asked, at)) => Ok(Answer::Asks(asked, at)),
                None => Err(error),
            },
        }
    }

    /// What the estimate is, as the result of a run.
    pub fn as_run(&self, of_parts: OfParts) -> Result<Found> {
        let first = prepared(self.texts[0].recipe(&self.registry)?, &self.registry)?;
        let mut inputs = Vec::new();
        for input in self.shards.iter().flat_map(|job| &job.inputs) {
            if !inputs.contains(input) {
                inputs.push(input.clone());
            }
        }
        Ok(Found {
            recipe: first.recipe.id.clone(),
            calibrations: vec![of_parts.calibration],
            verdicts: Vec::new(),
            failures: of_parts.failures,
            remarks: Vec::new(),
            inputs,
            plugins: first.plugins().to_vec(),
        })
    }

    /// The answer of a shard; none if it is not there.
    fn part(&self, shard: usize, asked: AskedOfPart, at: &Point) -> Result<Option<Arc<Part>>> {
        let mut job = self.shards[shard].clone();
        let Some(own) = &mut job.shard else { return Ok(None) };
        own.asked = asked;
        let points = match asked {
            AskedOfPart::Start => BTreeMap::new(),
            _ => BTreeMap::from([(own.of.clone(), at.clone())]),
        };
        let hash = job.hash(&self.family.recipe, self.texts[shard].value(), &points);
        let Some(content) = self.store.get(&hash) else { return Ok(None) };
        let part = serde_json::from_slice(&content).map_err(|error| {
            Error::data(format!("this is no result of a shard: {error}"))
                .in_file(&self.store.result_file(&hash))
                .help(BROKEN)
        })?;
        Ok(Some(Arc::new(part)))
    }
}

/// The answers that are there, as parts.
struct Answers<'a> {
    estimate: &'a Estimate<'a>,
    known: &'a [Arc<Part>],
    /// The first question without an answer.
    missing: RefCell<Option<(AskedOfPart, Point)>>,
}

impl Parts for Answers<'_> {
    fn count(&self) -> usize {
        self.known.len()
    }

    fn evidence(&self, part: usize, asked: AskedOfPart, at: &Point) -> Result<Arc<PartEvidence>> {
        let found = match asked {
            AskedOfPart::Start => Some(self.known[part].clone()),
            _ => self.estimate.part(part, asked, at)?,
        };
        match found {
            Some(found) => Ok(Arc::new(found.evidence.clone())),
            None => {
                self.missing.replace(Some((asked, at.clone())));
                Err(Error { fatal: true, ..Error::data("an answer of a shard is not there yet") })
            }
        }
    }
}

impl Manifest {
    /// Whether an estimate of this fleet is made of shards.
    pub fn has_shards(&self) -> bool {
        self.head.families.iter().any(|family| family.shards_of.is_some())
    }
}
