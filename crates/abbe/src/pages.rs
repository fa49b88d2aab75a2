//! The reference pages of plugins.

use std::io;
use std::path::Path;

use abbe_core::{Error, Registry, Result};
use abbe_engine::refuse_temporary_place;

/// Writes the reference pages of all plugins, and a list of them. A file that is no page is never replaced.
pub fn write(registry: &Registry, folder: &Path) -> Result<String> {
    let of_plugin = |plugin| (abbe_recipe::page_name(plugin), abbe_recipe::page(plugin));
    let mut pages: Vec<(String, String)> = registry.iter().map(of_plugin).collect();
    pages.push(("README.md".to_owned(), abbe_recipe::index(registry.iter())));
    let wrong = |file: &Path, error: io::Error| {
        let (place, why) = match error.kind() {
            io::ErrorKind::NotADirectory | io::ErrorKind::AlreadyExists => {
                (folder, "it is there already, and is no folder".to_owned())
            }
            _ => (file, abbe_files::why(&error)),
        };
        Error::usage(format!("{}: {why}", place.display())).help("name another folder")
    };
    refuse_temporary_place(folder)?;
    for (name, _) in &pages {
        let file = folder.join(name);
        match abbe_files::read(&file, abbe_files::LARGEST_TEXT) {
            Ok(there) if !there.starts_with(abbe_recipe::PAGE_MARK.as_bytes()) => {
                let message = format!("{} is there and is no page of a plugin; it is not replaced", file.display());
                return Err(Error::usage(message).help("name another folder"));
            }
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(wrong(&file, error)),
            Err(_) if file.symlink_metadata().is_ok() => {
                let message = format!("{} is a link that leads to nothing; it is not replaced", file.display());
                return Err(Error::usage(message).help("name another folder"));
            }
            _ => {}
        }
    }
    // A signal waits until all are there.
    crate::interrupt::while_writing(|| {
        let is_new = !folder.exists();
        std::fs::create_dir_all(folder).map_err(|error| wrong(folder, error))?;
        let written = crate::outputs::replace_all(pages.iter().map(|(name, text)| (folder.join(name), text.as_str())));
        if written.is_err() && is_new {
            // It is removed only if nothing is in it.
            let _ = std::fs::remove_dir(folder);
        }
        written
    })?;
    Ok(format!("{} pages in {}\n", pages.len() - 1, folder.display()))
}
