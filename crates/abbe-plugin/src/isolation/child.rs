//! The other process.

use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::sync::{Arc, Mutex};

use abbe_core::{Context, Error, Kind, Result};

use super::time::Time;
use super::wire::{Content, Frame, Wire};
use super::{Connection, Listed, locked};
use crate::loader::{About, Library, hashed, load_sealed};
use crate::peer::Failure;
use crate::sandbox::{Allowance, confine};
use crate::served::{Served, create};
use crate::spare::Spare;

/// The other process: gives up what a plugin does not need ([`Allowance`]), loads the library and serves it on standard input until the
/// program that started it is gone.
pub fn serve(path: &Path, sha256: &str, allowance: &Allowance) -> Result<()> {
    let gone = |error: std::io::Error| Error::data(format!("the program that isolates a plugin is gone: {error}"));
    let socket = UnixStream::from(std::io::stdin().as_fd().try_clone_to_owned().map_err(gone)?);
    let connection = Arc::new(Connection {
        wire: Mutex::new(Wire::new(socket)),
        holder: Mutex::new(None),
        objects: Mutex::default(),
        released: Mutex::default(),
        spare: Spare::default(),
        child: None,
        words: None,
        who: "the program".to_owned(),
        time: Time::unlimited(),
        lost: Arc::default(),
    });
    let library = hashed(path, Some(sha256)).and_then(|hashed| hashed.sealed(path)).and_then(|sealed| {
        confine(allowance).map_err(|what| Error::data(format!("an isolated plugin cannot be confined: {what}")))?;
        load_sealed(path, sealed)
    });
    loop {
        let Ok((question, numbers)) = locked(&connection.wire).read(None) else { return Ok(()) };
        let answer = match (question, &library) {
            (Frame::Release { object }, _) => {
                locked(&connection.objects).served.remove(&object);
                continue;
            }
            (_, Err(error)) => Err(Failure::from(error.clone())),
            (Frame::List, Ok(library)) => {
                Ok((Frame::Answer { text: listed(library), objects: Vec::new() }, Content::Nothing))
            }
            (Frame::Create { kind, name, settings, base }, Ok(library)) => {
                created(library, kind, &name, &settings, base).map(|stage| {
                    let objects = vec![connection.give(&Arc::new(stage))];
                    (Frame::Answer { text: String::new(), objects }, Content::Nothing)
                })
            }
            (question, Ok(_)) => connection.work(question, &numbers),
        };
        let (frame, content) = answer.unwrap_or_else(|failure| (Frame::Failed(failure), Content::Nothing));
        let mut wire = locked(&connection.wire);
        for object in std::mem::take(&mut *locked(&connection.released)) {
            wire.write(&Frame::Release { object }, &[], None).map_err(gone)?;
        }
        wire.write(&frame, &content.lists(), None).map_err(gone)?;
        wire.give_back(numbers);
        connection.keep(content);
    }
}

fn listed(library: &Library) -> String {
    let plugins = library.plugins.iter().map(|plugin| About {
        kind: Kind::ALL.iter().position(|kind| *kind == plugin.kind()).unwrap_or_default() as u32,
        name: plugin.name.to_string(),
        version: plugin.version.to_string(),
        about: plugin.about.to_string(),
        reference: plugin.reference.to_string(),
        schema: plugin.schema.get().to_string(),
        example: plugin.example.get().to_string(),
    });
    let listed = Listed { name: library.name.clone(), version: library.version.clone(), plugins: plugins.collect() };
    serde_json::to_string(&listed).unwrap_or_default()
}

fn created(library: &Library, kind: u32, name: &str, settings: &str, base: String) -> Result<Served, Failure> {
    let of_kind = |plugin: &&abbe_core::Plugin| Kind::ALL.get(kind as usize) == Some(&plugin.kind());
    let plugin = library.plugins.iter().filter(of_kind).find(|plugin| plugin.name == name);
    let plugin = plugin.ok_or_else(|| Failure::of("the library", format!("has no plugin `{name}`")))?;
    create(plugin, settings, &Context { base: base.into() })
}
