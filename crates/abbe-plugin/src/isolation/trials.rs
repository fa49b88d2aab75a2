//! Messages of the other process, read from any bytes ([`crate::trials`]).

use abbe_core::{Equations, Poses, from_json};

use super::Listed;
use super::wire::{Frame, decode, encode, read_equations, read_poses, split, variable};
use crate::peer::Failure;
use crate::trials::nowhere;

/// A message, as what it may be an answer to.
pub fn message(bytes: &[u8]) -> Result<(), String> {
    let (frame, numbers) = decode(bytes, &mut Vec::new()).map_err(|error| error.to_string())?;
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
    let bytes = |(frame, numbers): (Frame, &[&[f64]])| {
        let mut bytes = Vec::new();
        encode(&frame, numbers, &mut bytes).ok().map(|()| bytes)
    };
    frames.into_iter().filter_map(bytes).collect()
}

/// A list of plugins.
pub fn list(text: &str) -> Result<(), String> {
    let listed: Listed = from_json(text).map_err(|error| error.to_string())?;
    let (file, origin, create) = nowhere();
    listed.plugins.into_iter().try_for_each(|about| about.plugin(file, &origin, create.clone()).map(drop))
}
