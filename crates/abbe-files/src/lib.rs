//! Opens and reads the files that people name: recipes, truths, calibrations, data, libraries.
//!
//! A named pipe would hang the program, and a device fill its memory. So only regular files are opened, and what is read as a whole
//! has a bound on its size. Tables may be packed by gzip or Zstandard.

mod packed;

use std::fs::{self, File, Metadata};
use std::io::{self, Read};
use std::path::{Component, Path, PathBuf};

pub use packed::{Content, Packing, content_of, is_of_packing, most_content, open_content, without_packing};

/// Bytes of the largest recipe, machine file or truth: 16 MiB. People write these.
pub const LARGEST_TEXT: u64 = 16 << 20;

/// Bytes of the largest file that a program has written as one text: 512 MiB.
pub const LARGEST_RESULT: u64 = 512 << 20;

/// Opens a regular file, or one that a link leads to.
///
/// # Errors
/// As [`File::open`]; and [`io::ErrorKind::InvalidInput`] for a folder, a named pipe, a socket, a device or what Linux shows of itself as
/// files, which are not opened.
pub fn open(path: &Path) -> io::Result<File> {
    let opened = || {
        // Opening a named pipe waits for somebody who writes: it is looked at first.
        regular(&fs::metadata(path)?)?;
        not_of_the_system(path)?;
        let file = File::open(path)?;
        regular(&file.metadata()?)?;
        Ok(file)
    };
    opened().map_err(in_words)
}

/// An error with the words of [`why`].
fn in_words(error: io::Error) -> io::Error {
    io::Error::new(error.kind(), why(&error))
}

/// The content of a regular file of `most` bytes at most.
///
/// # Errors
/// As [`open`]; and [`io::ErrorKind::FileTooLarge`] for a file that is larger.
pub fn read(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let mut content = Vec::new();
    open(path)?.take(most.saturating_add(1)).read_to_end(&mut content).map_err(in_words)?;
    match content.len() as u64 > most {
        true => {
            let message = format!("it is larger than {} MiB, the most that is read", most >> 20);
            Err(io::Error::new(io::ErrorKind::FileTooLarge, message))
        }
        false => Ok(content),
    }
}

/// The text in UTF-8 of a regular file of `most` bytes at most.
///
/// # Errors
/// As [`read`]; and [`io::ErrorKind::InvalidData`] for a file that is no text in UTF-8.
pub fn read_text(path: &Path, most: u64) -> io::Result<String> {
    String::from_utf8(read(path, most)?).map_err(|error| {
        let text = &error.as_bytes()[..error.utf8_error().valid_up_to()];
        let line = 1 + text.iter().filter(|&&byte| byte == b'\n').count();
        let message = format!("it is no text in UTF-8 (line {line}, byte {} of the file)", text.len() + 1);
        io::Error::new(io::ErrorKind::InvalidData, message)
    })
}

/// Why a file cannot be read or written, for people: what they can do something about comes without numbers of the system.
pub fn why(error: &io::Error) -> String {
    match error.kind() {
        io::ErrorKind::StorageFull => "the disk is full".to_owned(),
        io::ErrorKind::FileTooLarge if error.raw_os_error().is_some() => {
            "it would be larger than files may be here (`ulimit -f`)".to_owned()
        }
        io::ErrorKind::QuotaExceeded => "the quota of the disk is used up".to_owned(),
        kind => {
            let text = error.to_string();
            // The number, and the path of a temporary file that nobody knows behind it, are of no use.
            match text.rsplit_once(" (os error ") {
                Some((words, _)) => of_the_system(kind).unwrap_or(words).to_owned(),
                None => text,
            }
        }
    }
}

/// What the system says in words of its own that are not for people.
fn of_the_system(kind: io::ErrorKind) -> Option<&'static str> {
    Some(match kind {
        io::ErrorKind::NotFound => "there is no such file or folder",
        io::ErrorKind::PermissionDenied => "this user has no permission",
        io::ErrorKind::AlreadyExists => "something is there already",
        io::ErrorKind::NotADirectory => "something on the way to it is no folder",
        io::ErrorKind::IsADirectory => "it is a folder",
        io::ErrorKind::DirectoryNotEmpty => "it is a folder with something in it",
        io::ErrorKind::ReadOnlyFilesystem => "the disk can only be read",
        io::ErrorKind::InvalidFilename => "the name is too long for the disk, or has letters that it does not take",
        io::ErrorKind::ResourceBusy => "it is in use",
        _ => return None,
    })
}

/// Whether two paths are one file, however they are written: the same place, or links to the same content. Neither has to exist.
pub fn is_same(one: &Path, other: &Path) -> bool {
    place(one) == place(other) || has_same_content(one, other)
}

/// Where a file or folder is, or will be, with all links on the way to it followed and without any `..`: it stays the same place when
/// something on the way is removed or renamed.
///
/// A way that no folder can ever be at, such as one through a file, is given back as it is named.
pub fn place(file: &Path) -> PathBuf {
    fs::canonicalize(file).ok().or_else(|| followed(file)).unwrap_or_else(|| file.to_owned())
}

/// The place at the end of a way of which the last parts are not there yet.
fn followed(way: &Path) -> Option<PathBuf> {
    let mut place = if way.is_relative() { fs::canonicalize(".").ok()? } else { PathBuf::new() };
    for part in way.components() {
        match part {
            Component::CurDir => {}
            // What is not there will be a folder; a file, or a link that leads nowhere, has nothing above it.
            Component::ParentDir if place.is_dir() || is_absent(&place) => drop(place.pop()),
            Component::ParentDir => return None,
            Component::Prefix(_) | Component::RootDir | Component::Normal(_) => {
                place.push(part);
                place = fs::canonicalize(&place).unwrap_or(place);
            }
        }
    }
    Some(place)
}

fn is_absent(path: &Path) -> bool {
    path.symlink_metadata().is_err_and(|error| error.kind() == io::ErrorKind::NotFound)
}

#[cfg(unix)]
fn has_same_content(one: &Path, other: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let number = |path: &Path| fs::metadata(path).ok().map(|found| (found.dev(), found.ino()));
    number(one).is_some_and(|one| number(other) == Some(one))
}

#[cfg(not(unix))]
fn has_same_content(_: &Path, _: &Path) -> bool {
    false
}

fn regular(found: &Metadata) -> io::Result<()> {
    match found.is_file() {
        true => Ok(()),
        false => {
            let message = format!("it is {}; a file was expected", kind(found));
            Err(io::Error::new(io::ErrorKind::InvalidInput, message))
        }
    }
}

/// Refuses what Linux shows of itself below `/proc` and `/sys`: these count as regular files, and some wait for news for ever.
fn not_of_the_system(path: &Path) -> io::Result<()> {
    let is_of_it = |path: PathBuf| ["/proc", "/sys"].iter().any(|folder| path.starts_with(folder));
    match cfg!(target_os = "linux") && fs::canonicalize(path).is_ok_and(is_of_it) {
        true => Err(io::Error::new(io::ErrorKind::InvalidInput, "it is a part of the system; a file was expected")),
        false => Ok(()),
    }
}

/// What something is that is no file, with its article.
fn kind(found: &Metadata) -> &'static str {
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        let kind = found.file_type();
        if kind.is_fifo() {
            return "a named pipe";
        } else if kind.is_socket() {
            return "a socket";
        } else if kind.is_char_device() || kind.is_block_device() {
            return "a device";
        }
    }
    if found.is_dir() { "a folder" } else { "something else" }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(path: &Path) -> String {
        read_text(path, 4).unwrap_err().to_string()
    }

    #[test]
    fn only_files_of_bounded_size_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a");
        for (content, expected) in [(&b"12"[..], Ok("12")), (b"1234", Ok("1234")), (b"", Ok(""))] {
            fs::write(&file, content).unwrap();
            assert_eq!(read_text(&file, 4).as_deref().map_err(ToString::to_string), expected.map_err(str::to_owned));
        }
        fs::write(&file, b"12345").unwrap();
        assert!(refused(&file).contains("larger than"));
        fs::write(&file, b"\n\xff").unwrap();
        assert_eq!(refused(&file), "it is no text in UTF-8 (line 2, byte 2 of the file)");
        assert_eq!(refused(folder.path()), "it is a folder; a file was expected");
        assert_eq!(read(&folder.path().join("b"), 4).unwrap_err().kind(), io::ErrorKind::NotFound);
        assert_eq!(refused(&folder.path().join("b")), "there is no such file or folder");
        assert_eq!(refused(&file.join("b")), "something on the way to it is no folder");
    }

    /// Whatever the system says, people get no number of it.
    #[test]
    fn numbers_of_the_system_are_left_out() {
        for number in 1..134 {
            let said = why(&io::Error::from_raw_os_error(number));
            assert!(!said.contains("os error") && said.len() > 3, "{number}: {said}");
        }
        assert_eq!(why(&io::Error::other("it is (os) x")), "it is (os) x");
    }

    #[cfg(unix)]
    #[test]
    fn one_file_has_many_names() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::create_dir(at("below")).unwrap();
        fs::write(at("a"), "").unwrap();
        fs::hard_link(at("a"), at("hard")).unwrap();
        std::os::unix::fs::symlink("a", at("soft")).unwrap();
        std::os::unix::fs::symlink("below", at("link")).unwrap();
        for (one, other) in [
            ("a", "./a"),
            ("a", "below/../a"),
            ("a", "hard"),
            ("soft", "hard"),
            ("new", "./below/../new"),
            ("below/new", "link/new"),
            ("below/link/../new", "below/link/.././new"),
            ("nowhere/new", "nowhere/./deep/../new"),
            ("new", "nowhere/../new"),
            ("a/../new", "a/../new"),
        ] {
            assert!(is_same(&at(one), &at(other)), "{one} {other}");
        }
        for (one, other) in [("a", "b"), ("a", "below/a"), ("new", "below/new"), ("nowhere/new", "elsewhere/new")] {
            assert!(!is_same(&at(one), &at(other)), "{one} {other}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn a_place_does_not_lead_through_what_may_be_removed() {
        let folder = tempfile::tempdir().unwrap();
        let root = fs::canonicalize(folder.path()).unwrap();
        fs::create_dir_all(root.join("a/b")).unwrap();
        fs::write(root.join("file"), "").unwrap();
        std::os::unix::fs::symlink("../b", root.join("a/b/link")).unwrap();
        std::os::unix::fs::symlink("nowhere", root.join("dangling")).unwrap();
        for (named, expected) in [
            ("a/../a", "a"),
            ("a/b/../b/../../a/b", "a/b"),
            ("a/b/link/link/new", "a/b/new"),
            ("a/b/link/../new/../other", "a/other"),
            ("new/deep/../er", "new/er"),
            ("new/../../../", "../.."),
            // As they are named.
            ("file/../new", "file/../new"),
            ("dangling/../new", "dangling/../new"),
        ] {
            let expected = root.join(expected);
            let expected = fs::canonicalize(&expected).unwrap_or(expected);
            assert_eq!(place(&root.join(named)), expected, "{named}");
        }
        assert_eq!(place(Path::new("../no-such/../no-such-file")), place(Path::new("..")).join("no-such-file"));
    }

    #[cfg(unix)]
    #[test]
    fn pipes_sockets_and_devices_are_not_opened() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        assert_eq!(refused(&pipe), "it is a named pipe; a file was expected");
        let socket = folder.path().join("socket");
        let _listener = std::os::unix::net::UnixListener::bind(&socket).unwrap();
        assert_eq!(refused(&socket), "it is a socket; a file was expected");
        assert_eq!(refused(Path::new("/dev/zero")), "it is a device; a file was expected");
        #[cfg(target_os = "linux")]
        for of_the_system in ["/proc/kmsg", "/proc/self/status", "/sys/kernel/notes"] {
            let path = Path::new(of_the_system);
            assert!(!path.exists() || refused(path) == "it is a part of the system; a file was expected");
        }
        // A link is what it leads to.
        let link = folder.path().join("link");
        std::os::unix::fs::symlink("/dev/zero", &link).unwrap();
        assert_eq!(refused(&link), "it is a device; a file was expected");
    }
}
