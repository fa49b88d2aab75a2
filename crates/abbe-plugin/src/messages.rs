//! What crosses the border as text: the JSON Schemas of questions and answers, and a listener for what is really asked.

use std::sync::OnceLock;

use abbe_core::{Calibration, ColumnHeader, Dataset, Findings, Identifiability, ModelInfo, MotionError, Target};
use schemars::generate::SchemaSettings;
use schemars::{JsonSchema, SchemaGenerator};
use serde_json::{Map, Value, json};

use crate::abi::*;
use crate::peer::{Answer, Details, Failure};
use crate::texts::{
    CheckText, FileText, FitText, InputText, JudgeText, MotionText, ObservationsText, ProblemText, TipText,
};

/// A question of the program to an object of a plugin, and the answer.
#[derive(Debug, Clone, PartialEq)]
pub struct Message {
    /// Whom it was: "the plugin `x` of libx.so".
    pub who: String,
    /// Its name, by which [`schemas`] knows it.
    pub name: &'static str,
    /// The question. Objects stand in it by their indices.
    pub question: Value,
    /// The answer; none if it is an error.
    pub answer: Option<Value>,
    /// The details of an error.
    pub failure: Option<Value>,
}

type Listener = Box<dyn Fn(Message) + Send + Sync>;

static LISTENER: OnceLock<Listener> = OnceLock::new();

/// Lets `listener` hear all that plugins of loaded libraries are asked from now on, and what they answer. A second listener of the
/// process hears nothing.
///
/// Tests show with it that the pages have what is really said.
pub fn listen(listener: impl Fn(Message) + Send + Sync + 'static) {
    let _ = LISTENER.set(Box::new(listener));
}

/// Tells the listener, if there is one.
pub(crate) fn heard(who: &str, method: u32, question: &str, answer: &Result<Answer, Failure>) {
    let Some(listener) = LISTENER.get() else { return };
    let value = |text: &str| serde_json::from_str::<Value>(text).ok();
    let (answered, failure) = match answer {
        Ok(answer) => (value(&answer.text), None),
        Err(failure) => (None, (failure.status == ABBE_FAILED_WITH_DETAILS).then(|| value(&failure.text)).flatten()),
    };
    let of_observations = answered.as_ref().is_some_and(|answer| answer.get("layout").is_some());
    let named = MESSAGES.iter().filter(|message| message.method == method);
    let Some(named) = named
        .clone()
        .find(|message| message.is_of_observations == of_observations)
        .or_else(|| named.clone().next_back())
    else {
        return;
    };
    let question = value(question).unwrap_or_default();
    listener(Message { who: who.to_owned(), name: named.name, question, answer: answered, failure });
}

/// A kind of message.
#[derive(Clone, Copy)]
struct Kind {
    method: u32,
    name: &'static str,
    about: &'static str,
    is_of_observations: bool,
    /// The schemas of question and answer.
    schemas: fn() -> [Value; 2],
}

const fn kind(method: u32, name: &'static str, about: &'static str, schemas: fn() -> [Value; 2]) -> Kind {
    Kind { method, name, about, is_of_observations: false, schemas }
}

/// All kinds of message but the failure.
static MESSAGES: [Kind; 20] = [
    kind(ABBE_DESCRIBE, "describe-machine", "Machine: what it is.", between::<(), ModelInfo>),
    Kind {
        is_of_observations: true,
        ..kind(ABBE_DESCRIBE, "describe-observations", "Observations: what they are.", between::<(), ObservationsText>)
    },
    kind(ABBE_INPUTS, "inputs", "Stages: the files that they read.", between::<(), Vec<InputText>>),
    kind(ABBE_HEADERS, "headers", "Ingest: the columns.", between::<(), Vec<ColumnHeader>>),
    kind(ABBE_READ, "read", "Ingest: the data set.", between::<(), Dataset>),
    kind(
        ABBE_CHECK,
        "check",
        "Artefact: whether columns can be used. Object 0 is the machine.",
        between::<CheckText, ()>,
    ),
    kind(
        ABBE_OBSERVE,
        "observe",
        "Artefact: the observations of a data set. Object 0 is the machine; the object of the answer are the observations.",
        between::<Dataset, ()>,
    ),
    kind(
        ABBE_TARGETS,
        "targets",
        "Artefact: the nominal programme, for a stylus radius, mm.",
        between::<f64, Vec<Target>>,
    ),
    kind(
        ABBE_BUILD,
        "build",
        "Model: the machine, which is the object of the answer. The data sets may be none.",
        between::<Vec<Dataset>, ()>,
    ),
    kind(
        ABBE_MOTION_ERROR,
        "motion-error",
        "Machine: a motion error at a status, with one value for each parameter.",
        between::<MotionText, MotionError>,
    ),
    kind(
        ABBE_CONTACT_TIP,
        "contact-tip",
        "Observations: the tip in nominal contact; null where contact does not fix it.",
        between::<TipText, Option<[f64; 3]>>,
    ),
    kind(ABBE_SOLVE, "solve", "Estimate: solve.", between::<ProblemText, Calibration>),
    kind(ABBE_EXPLAIN, "explain", "Estimate: solve, with uncertainty budgets.", between::<ProblemText, Calibration>),
    kind(ABBE_VALUES, "values", "Estimate: only the values of the unknowns.", between::<ProblemText, Vec<f64>>),
    kind(ABBE_ANALYSE, "analyse", "Estimate: analyse a fit of another estimate.", between::<FitText, Calibration>),
    kind(
        ABBE_IDENTIFY,
        "identify",
        "Estimate: what the data can determine, without solving.",
        between::<ProblemText, Identifiability>,
    ),
    kind(
        ABBE_ACCEPTS,
        "accepts",
        "Estimate: whether it would solve a problem with this identifiability.",
        between::<Identifiability, bool>,
    ),
    kind(
        ABBE_OBSERVATIONS,
        "observations",
        "Validate: the observations that its settings name, each with the setting.",
        between::<(), Vec<(String, String)>>,
    ),
    kind(ABBE_JUDGE, "judge", "Validate: judge fits and data.", between::<JudgeText, Findings>),
    kind(
        ABBE_WRITE,
        "write",
        "Export: the files of a calibration. Object 0 is the machine.",
        between::<Calibration, Vec<FileText>>,
    ),
];

/// The name of the schema of errors with details.
pub const FAILURE: &str = "failure";

/// The JSON Schema of every message by its name: a map with `question` and `answer`. That of a failure is alone.
///
/// Source: JSON Schema, draft 2020-12.
///
/// ```
/// let schemas = abbe_plugin::messages::schemas();
/// assert_eq!(schemas["accepts"]["properties"]["answer"]["type"], "boolean");
/// ```
pub fn schemas() -> Map<String, Value> {
    let messages = MESSAGES.iter().map(|message| (message.name.to_owned(), message.schema()));
    let mut failure = part::<Details>("", true);
    failure["$schema"] = json!(DRAFT);
    failure["title"] = json!(FAILURE);
    failure["description"] = json!("The text of a reply with the status ABBE_FAILED_WITH_DETAILS.");
    messages.chain([(FAILURE.to_owned(), failure)]).collect()
}

const DRAFT: &str = "https://json-schema.org/draft/2020-12/schema";

impl Kind {
    fn schema(&self) -> Value {
        let [question, answer] = (self.schemas)();
        json!({
            "$schema": DRAFT,
            "title": self.name,
            "description": self.about,
            "type": "object",
            "properties": { "question": question, "answer": answer },
            "required": ["question", "answer"],
            "additionalProperties": false,
        })
    }
}

/// Questions as the program writes them, answers as it reads them.
fn between<Q: JsonSchema, A: JsonSchema>() -> [Value; 2] {
    [part::<Q>("/properties/question", false), part::<A>("/properties/answer", true)]
}

/// The schema of a type that stands at `place` of a larger one.
fn part<T: JsonSchema>(place: &str, is_read: bool) -> Value {
    let mut settings = SchemaSettings::draft2020_12();
    settings.definitions_path = format!("{place}/$defs").into();
    settings = if is_read { settings.for_deserialize() } else { settings.for_serialize() };
    let mut generator = SchemaGenerator::new(settings);
    let mut schema = T::json_schema(&mut generator).to_value();
    let definitions = generator.take_definitions(true);
    if !definitions.is_empty() {
        schema["$defs"] = Value::Object(definitions);
    }
    in_plain_words(&mut schema);
    schema
}

/// Descriptions without the links and the line ends of the source.
fn in_plain_words(schema: &mut Value) {
    match schema {
        Value::Object(map) => {
            for (key, value) in map {
                match value {
                    Value::String(text) if key == "description" => *text = without_links(text),
                    value => in_plain_words(value),
                }
            }
        }
        Value::Array(list) => list.iter_mut().for_each(in_plain_words),
        _ => {}
    }
}

/// A text without its links: "[`X`](crate::X)" and "[`X`]" become "`X`", "[words](X)" become "words".
fn without_links(text: &str) -> String {
    let (mut words, mut rest) = (String::new(), text);
    while let Some((before, from)) = rest.split_once('[') {
        words.push_str(before);
        let Some((inside, after)) = from.split_once(']') else {
            words.push('[');
            rest = from;
            break;
        };
        let linked = after.strip_prefix('(').and_then(|target| target.split_once(')'));
        rest = linked.map_or(after, |(_, after)| after);
        match linked.is_some() || inside.starts_with('`') {
            true => words.push_str(inside),
            false => words.push_str(&format!("[{inside}]")),
        }
    }
    words.push_str(rest);
    words.replace("\n\n", "\r").replace('\n', " ").replace('\r', "\n\n")
}

#[cfg(test)]
mod tests {
    use super::{MESSAGES, schemas, without_links};

    #[test]
    fn every_method_has_a_schema() {
        let methods: std::collections::BTreeSet<u32> = MESSAGES.iter().map(|message| message.method).collect();
        let source = include_str!("abi.rs");
        let after = source.split("Machines and observations: their description").nth(1).unwrap();
        let named = after.lines().filter(|line| line.starts_with("pub const ABBE_")).count();
        assert_eq!(methods.len(), named);
        assert_eq!(schemas().len(), MESSAGES.len() + 1);
    }

    #[test]
    fn links_are_left_out() {
        let text = "Index of [`A::b`](crate::A::b) and [`C`], as [words](Self::x)\nof `EXX[1]` say.\n\nMore [of] it";
        assert_eq!(without_links(text), "Index of `A::b` and `C`, as words of `EXX[1]` say.\n\nMore [of] it");
        assert_eq!(without_links("ends [`X`]"), "ends `X`");
        assert_eq!(without_links("no end [of"), "no end [of");
    }
}
