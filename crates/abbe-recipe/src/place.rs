//! Where a history is kept.

use std::path::PathBuf;

/// What addresses of servers begin with.
const SERVERS: [&str; 2] = ["postgres://", "postgresql://"];

/// A file, or a PostgreSQL server.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum HistoryPlace {
    /// An SQLite file.
    File(PathBuf),
    /// The address of a server, without a password.
    Server(String),
}

impl HistoryPlace {
    /// Reads what people write: a path, or `postgres://USER@HOST/DATABASE`.
    ///
    /// # Errors
    /// A sentence for an address that has a password, and for addresses of something else. It does not repeat the address.
    pub fn parse(text: &str) -> Result<Self, String> {
        if text.is_empty() {
            return Err("the name of a file was expected, or the address of a server".to_owned());
        }
        if !text.contains("://") {
            return Ok(Self::File(PathBuf::from(text)));
        }
        let Some(address) = SERVERS.iter().find_map(|kind| text.strip_prefix(kind)) else {
            return Err("the name of a file was expected, or `postgres://USER@HOST/DATABASE`".to_owned());
        };
        let of_user = address.rsplit_once('@').map_or("", |(of_user, _)| of_user);
        let asked = address.split_once('?').map_or("", |(_, asked)| asked).to_lowercase();
        match of_user.contains(':') || asked.contains("password") {
            true => Err("an address without a password was expected: that comes from the variable PGPASSWORD, or from a service \
                         file (`postgres:///?service=NAME`)"
                .to_owned()),
            false => Ok(Self::Server(text.to_owned())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn servers_have_no_password() {
        assert_eq!(HistoryPlace::parse("plant.sqlite"), Ok(HistoryPlace::File("plant.sqlite".into())));
        for text in ["postgres://me@plant/abbe", "postgresql://plant:5433/abbe", "postgres:///?service=plant"] {
            assert_eq!(HistoryPlace::parse(text), Ok(HistoryPlace::Server(text.to_owned())));
        }
        for text in
            ["postgres://me:secret@plant/abbe", "postgres://plant/abbe?user=me&PASSWORD=secret", "http://secret/", ""]
        {
            assert!(!HistoryPlace::parse(text).unwrap_err().contains("secret"), "{text}");
        }
    }
}
