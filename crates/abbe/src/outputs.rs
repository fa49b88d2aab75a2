//! Files that commands write where users want them: whole or not at all, and never in the place of somebody's file.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use abbe_core::{Error, Result};
use abbe_engine::{refuse_temporary_place, temporary_file};
use abbe_files::is_same;

/// What was found, and what is to be written.
pub struct Written {
    /// What to print.
    pub text: String,
    /// The files: where, and what.
    pub files: Vec<(PathBuf, Vec<u8>)>,
}

impl Written {
    /// Writes the files, none of which may exist: all of them or none.
    pub fn write(&self) -> Result<()> {
        self.files.iter().try_for_each(|(path, _)| is_free(path))?;
        let filled = |(path, content): &(PathBuf, Vec<u8>)| {
            let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
            let mut file = temporary_file(folder)?;
            file.write_all(content)?;
            Ok(file)
        };
        let filled: Vec<_> = (self.files.iter())
            .map(|file| filled(file).map_err(|error| cannot_be_written(&file.0, &error)))
            .collect::<Result<_>>()?;
        let mut written: Vec<&Path> = Vec::new();
        for (file, (path, _)) in filled.into_iter().zip(&self.files) {
            if let Err(error) = file.persist_noclobber(path) {
                // What was written a moment ago is this program's own.
                written.iter().for_each(|path| drop(std::fs::remove_file(path)));
                return Err(cannot_be_written(path, &error.error));
            }
            written.push(path);
        }
        Ok(())
    }
}

/// Fails if there is something of this name, and for a name of temporary folders.
pub fn is_free(path: &Path) -> Result<()> {
    refuse_temporary_place(path)?;
    match path.symlink_metadata() {
        Ok(_) => {
            let message = format!("{} is there already; it is not replaced", path.display());
            Err(Error::data(message).help("name another file"))
        }
        Err(_) => Ok(()),
    }
}

/// Fails for a name that ends as that of a folder does: `f/` would be written in the place of the file f.
pub fn is_file_name(path: &Path) -> Result<()> {
    let text = path.as_os_str().to_string_lossy();
    let is_folder = text.ends_with(std::path::is_separator) || path.file_name().is_none() || text.ends_with("/.");
    match is_folder {
        false => Ok(()),
        true => Err(Error::usage(format!("{} names a folder, and a file is to be written", path.display()))
            .help("leave out what stands behind the name of the file")),
    }
}

/// Fails if two options name one file, however it is written: one of the two would be lost.
pub fn are_different(named: &[(&str, &Path)]) -> Result<()> {
    for (index, (option, file)) in named.iter().enumerate() {
        if let Some((other, _)) = named[..index].iter().find(|(_, earlier)| is_same(earlier, file)) {
            return Err(Error::usage(format!("`{other}` and `{option}` name the same file"))
                .help("give each a file of its own"));
        }
    }
    Ok(())
}

/// Writes a file whole or not at all, in the place of an earlier one, whose permissions it takes; what else was linked to that is not
/// touched. A link stays one.
pub fn replace(file: &Path, content: &str) -> Result<()> {
    replace_all([(file.to_owned(), content)])
}

/// Writes files as [`replace`] does, and none if the disk does not take them all.
pub fn replace_all<'a>(files: impl IntoIterator<Item = (PathBuf, &'a str)>) -> Result<()> {
    let written = |(file, content): (PathBuf, &str)| {
        let place = abbe_files::place(&file);
        let folder = place.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let written = temporary_file(folder).and_then(|mut new| {
            new.write_all(content.as_bytes())?;
            // Who may read and write it stays as it was. A disk may know no permissions.
            let _ = place.metadata().and_then(|earlier| new.as_file().set_permissions(earlier.permissions()));
            // It stays open: one that is closed is what a command has left that was killed.
            Ok(new)
        });
        match written {
            Ok(new) => Ok((file, place, new)),
            Err(error) => Err(cannot_be_written(&file, &error)),
        }
    };
    let written: Vec<_> = files.into_iter().map(written).collect::<Result<_>>()?;
    for (file, place, new) in written {
        new.persist(&place).map_err(|error| cannot_be_written(&file, &error.error))?;
    }
    Ok(())
}

/// Fails if no file can be written there: the folder is asked for room for a name, and nothing stays. So it does for a name of temporary
/// folders.
pub fn can_be_written(file: &Path) -> Result<()> {
    refuse_temporary_place(file)?;
    let place = abbe_files::place(file);
    let folder = place.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    temporary_file(folder).map(drop).map_err(|error| cannot_be_written(file, &error))
}

/// What is said of a file that cannot be written.
pub fn cannot_be_written(file: &Path, error: &io::Error) -> Error {
    let (why, help) = match error.kind() {
        io::ErrorKind::NotFound => ("its folder does not exist".to_owned(), "make the folder, or name another file"),
        io::ErrorKind::StorageFull => (abbe_files::why(error), "make room, or name a file on another disk"),
        _ => (abbe_files::why(error), "name another file"),
    };
    Error::data(format!("{} cannot be written: {why}", file.display())).help(help)
}
