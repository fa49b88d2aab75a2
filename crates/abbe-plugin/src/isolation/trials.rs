//! Messages of the other process, read from any bytes ([`crate::trials`]).

use std::os::unix::net::UnixStream;
use std::sync::{Arc, Mutex};

use abbe_core::{Equations, KinematicModel, Observations, Poses, from_json};
use serde::de::IgnoredAny;

use super::time::Time;
use super::wire::{Frame, Wire, decode, encode, read_equations, read_poses, split, variable};
use super::{Connection, Listed};
use crate::abi::{ABBE_CONTACT_TIP, ABBE_DESCRIBE, ABBE_MOTION_ERROR};
use crate::peer::Failure;
use crate::served::Served;
use crate::trials::nowhere;

/// Bytes of the two lengths of a message.
const HEAD: usize = 16;

/// A message whose lengths are right: those of its text, and of the numbers after that. A change of a message makes them wrong, and
/// nothing else of it would be read.
fn mended(bytes: &[u8]) -> Option<Vec<u8>> {
    let rest = bytes.get(HEAD..)?;
    let mut texts = serde_json::Deserializer::from_slice(rest).into_iter::<IgnoredAny>();
    texts.next()?.ok()?;
    let text = texts.byte_offset();
    let count = (rest.len() - text) / 8;
    let mut mended = [(text as u64).to_le_bytes(), (count as u64).to_le_bytes()].concat();
    mended.extend_from_slice(&rest[..text + 8 * count]);
    Some(mended)
}

/// What is read of a message, with other lengths if those that it states are wrong.
fn read(bytes: &[u8]) -> Result<(Frame, Vec<f64>), String> {
    let read = |bytes: &[u8]| decode(bytes, &mut Vec::new()).map_err(|error| error.to_string());
    read(bytes).or_else(|error| mended(bytes).map_or(Err(error), |mended| read(&mended)))
}

/// A message, as a question of another process that was lent a machine (object 0) and observations (object 1).
pub fn question(
    bytes: &[u8],
    machine: &Arc<dyn KinematicModel>,
    observations: &Arc<dyn Observations>,
) -> Result<(), String> {
    let (question, numbers) = read(bytes)?;
    // Nobody is at the other end: what would be asked there fails.
    let (ours, _) = UnixStream::pair().map_err(|error| error.to_string())?;
    let connection = Arc::new(Connection {
        wire: Mutex::new(Wire::new(ours)),
        holder: Mutex::new(None),
        objects: Mutex::default(),
        released: Mutex::default(),
        child: None,
        words: None,
        who: "the plugin".to_owned(),
        time: Time::unlimited(),
        lost: Arc::default(),
    });
    for served in [Served::Machine(machine.clone()), Served::Observations(observations.clone(), None)] {
        let _ = connection.give(&Arc::new(served));
    }
    let told = |failure: Failure| failure.error("the plugin").message;
    let (answer, numbers) = connection.work(question, &numbers).map_err(told)?;
    let lists: Vec<&[f64]> = numbers.iter().map(Vec::as_slice).collect();
    encode(&answer, &lists, &mut Vec::new()).map_err(|error| error.to_string())
}

/// A question of each sort about a machine (object 0) and observations (object 1).
pub fn questions(machine: &dyn KinematicModel, observations: &dyn Observations) -> Vec<Vec<u8>> {
    let (info, seen) = (machine.info(), observations.info());
    let (status, values) = (vec![1.0; info.status.len()], vec![1e-6; info.parameters.len()]);
    let (own, inputs) = (seen.start.clone(), vec![0.0; seen.inputs.len()]);
    let positions = vec![1.0; seen.layout.rows.first().map_or(0, |row| 3 * row.poses)];
    let motion = serde_json::json!({ "function": info.error_functions.first(), "values": values, "status": status });
    let tip = serde_json::json!({ "row": 0, "tip": [0, 0, 0], "own": own, "inputs": inputs });
    let call = |object: u64, method: u32, text: String| Frame::Call { object, method, text, objects: Vec::new() };
    let poses = |wanted: usize, orientation: bool| Frame::Poses {
        object: 0,
        lengths: [status.len(), values.len(), wanted],
        orientation,
    };
    let lists = [&[0.0][..], &positions, &[], &own, &inputs];
    let frames: [(Frame, &[&[f64]]); 8] = [
        (call(0, ABBE_DESCRIBE, String::new()), &[]),
        (call(0, ABBE_MOTION_ERROR, motion.to_string()), &[]),
        (call(1, ABBE_DESCRIBE, String::new()), &[]),
        (call(1, ABBE_CONTACT_TIP, tip.to_string()), &[]),
        (poses(0, true), &[&status, &values]),
        (poses(2, false), &[&status, &values, &[0.0, 4_294_967_296.0]]),
        (poses(1, true), &[&status, &values, &[1.0]]),
        (Frame::Equations { object: 1, lengths: lists.map(<[f64]>::len) }, &lists),
    ];
    frames.into_iter().filter_map(bytes).collect()
}

/// The bytes of a message.
fn bytes((frame, numbers): (Frame, &[&[f64]])) -> Option<Vec<u8>> {
    let mut bytes = Vec::new();
    encode(&frame, numbers, &mut bytes).ok().map(|()| bytes)
}

/// A message, as what it may be an answer to.
pub fn message(bytes: &[u8]) -> Result<(), String> {
    let (frame, numbers) = read(bytes)?;
    let mut poses = Poses::default();
    poses.reset(2, 1, true);
    let _ = read_poses(&frame, &numbers, &mut poses);
    let _ = read_equations(&frame, &numbers, &mut Equations::default());
    match frame {
        Frame::Poses { lengths, .. } => {
            let [_, _, wanted] = split(&numbers, lengths)?;
            let _: Vec<_> = wanted.iter().copied().map(variable).collect();
        }
        Frame::Equations { lengths, .. } => drop(split(&numbers, lengths)?),
        Frame::Failed(failure) => drop(failure.error("the plugin")),
        _ => {}
    }
    Ok(())
}

/// One message of each sort.
pub fn messages() -> Vec<Vec<u8>> {
    let failure = Failure::of("the plugin", "fails");
    let frames: [(Frame, &[&[f64]]); 7] = [
        (Frame::List, &[]),
        (Frame::Answer { text: "{}".to_owned(), objects: Vec::new() }, &[]),
        (Frame::Numbers { lengths: vec![6, 8, 6, 6] }, &[&[0.5; 26]]),
        (Frame::Numbers { lengths: vec![1, 3, 3, 3, 3] }, &[&[0.0, 1.0, 2.0, 3.0, 0.0, 1.0, 2.0], &[0.0; 6]]),
        (Frame::Poses { object: 1, lengths: [3, 1, 1], orientation: false }, &[&[0.0; 5]]),
        (Frame::Equations { object: 1, lengths: [1, 3, 4, 0, 0] }, &[&[0.0; 8]]),
        (Frame::Failed(failure), &[]),
    ];
    frames.into_iter().filter_map(bytes).collect()
}

/// A list of plugins.
pub fn list(text: &str) -> Result<(), String> {
    let listed: Listed = from_json(text).map_err(|error| error.to_string())?;
    let (file, origin, create) = nowhere();
    listed.plugins.into_iter().try_for_each(|about| about.plugin(file, &origin, create.clone()).map(drop))
}
