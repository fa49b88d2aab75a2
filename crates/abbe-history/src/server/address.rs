//! Where a server is: an address without a password, and what the environment and a service file add to it.

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use abbe_core::{Error, Result};
use abbe_files::read_text;
use postgres::Config;
use postgres::config::{Host, SslMode};

/// How long a server may take to answer at first.
const CONNECT: Duration = Duration::from_secs(10);

/// Bytes of a service file at most.
const LARGEST_SERVICE_FILE: u64 = 1 << 20;

/// A server that can be connected to.
pub(crate) struct Address {
    /// The server as messages name it: host and data base.
    pub(crate) name: String,
    pub(crate) config: Config,
}

impl Address {
    /// Reads an address `postgres://USER@HOST:PORT/DATABASE`, or `postgres:///?service=NAME`.
    ///
    /// No message has the address: what cannot be read may hold a password.
    pub(crate) fn of(text: &str) -> Result<Self> {
        Self::with(text, |name| std::env::var(name).ok())
    }

    fn with(text: &str, variable: impl Fn(&str) -> Option<String>) -> Result<Self> {
        let (text, service) = without_service(text);
        let mut config: Config = text.parse().map_err(|_| {
            Error::usage("the address of the history cannot be read")
                .help("`postgres://USER@HOST:PORT/DATABASE` was expected, or `postgres:///?service=NAME`")
        })?;
        if config.get_password().is_some() {
            return Err(with_password());
        }
        if let Some(service) = service {
            let file = service_file(&variable)?;
            add_service(&mut config, &service, &file)?;
        }
        if config.get_user().is_none()
            && let Some(user) = variable("PGUSER")
        {
            config.user(&user);
        }
        if let Some(password) = variable("PGPASSWORD").filter(|password| !password.is_empty()) {
            config.password(password);
        }
        if config.get_dbname().is_none() {
            return Err(Error::usage("the address of the history names no data base")
                .help("`postgres://USER@HOST:PORT/DATABASE` was expected"));
        }
        if config.get_hosts().is_empty() {
            config.host("127.0.0.1");
        }
        check_way(&config)?;
        config.connect_timeout(CONNECT).tcp_user_timeout(3 * CONNECT).keepalives_idle(3 * CONNECT);
        config.application_name("abbe");
        Ok(Self { name: name(&config), config })
    }
}

fn with_password() -> Error {
    Error::usage("the address of the history has a password in it").help(
        "take it out: the password comes from the variable PGPASSWORD, or from a service file (`postgres:///?service=NAME`)",
    )
}

/// The address without the key `service`, and its value.
fn without_service(text: &str) -> (String, Option<String>) {
    let Some((address, query)) = text.split_once('?') else { return (text.to_owned(), None) };
    let (named, others): (Vec<&str>, Vec<&str>) = query.split('&').partition(|key| key.starts_with("service="));
    let service = named.first().and_then(|key| key.split_once('=')).map(|(_, value)| value.to_owned());
    let address = if others.is_empty() { address.to_owned() } else { format!("{address}?{}", others.join("&")) };
    (address, service)
}

/// The service file of libpq.
fn service_file(variable: &impl Fn(&str) -> Option<String>) -> Result<PathBuf> {
    let home = || Some(Path::new(&variable("HOME")?).join(".pg_service.conf"));
    let file = variable("PGSERVICEFILE").map(PathBuf::from).or_else(home);
    file.ok_or_else(|| Error::usage("there is no service file").help("name one in the variable PGSERVICEFILE"))
}

/// Adds what a service file says of a service. No message has a value of it.
fn add_service(config: &mut Config, service: &str, file: &Path) -> Result<()> {
    let text = read_text(file, LARGEST_SERVICE_FILE)
        .map_err(|error| Error::usage(format!("the service file {}: {error}", file.display())))?;
    let known = section(&text, service).ok_or_else(|| {
        Error::usage(format!("the service file {} has no section [{service}]", file.display()))
            .help("it names services as `[plant]`, and under each host, port, dbname, user and password")
    })?;
    for (key, value) in known {
        let wrong = || Error::usage(format!("the service file {}: [{service}] {key}: ", file.display()));
        match key.as_str() {
            "host" | "hostaddr" => drop(config.host(&value)),
            "port" => {
                let port = value.parse().map_err(|_| {
                    let mut error = wrong();
                    error.message += "a number was expected";
                    error
                })?;
                config.port(port);
            }
            "dbname" => drop(config.dbname(&value)),
            "user" => drop(config.user(&value)),
            "password" => drop(config.password(&value)),
            "sslmode" if value == "disable" => drop(config.ssl_mode(SslMode::Disable)),
            "sslmode" => drop(config.ssl_mode(SslMode::Require)),
            // What libpq has besides (times, names of programs) changes nothing here.
            _ => {}
        }
    }
    Ok(())
}

/// The lines `key=value` under `[service]`.
fn section(text: &str, service: &str) -> Option<BTreeMap<String, String>> {
    let lines = text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'));
    let head = format!("[{service}]");
    let mut lines = lines.skip_while(|line| *line != head);
    lines.next()?;
    let pairs = lines.take_while(|line| !line.starts_with('[')).filter_map(|line| line.split_once('='));
    Some(pairs.map(|(key, value)| (key.trim().to_owned(), value.trim().to_owned())).collect())
}

/// What leaves the computer is not encrypted: that has to be wanted.
fn check_way(config: &Config) -> Result<()> {
    if config.get_ssl_mode() == SslMode::Require {
        return Err(Error::usage("this program does not encrypt connections to servers (sslmode)")
            .help("connect through a tunnel that ends on this computer, and name 127.0.0.1 as the host"));
    }
    let is_here = |host: &Host| match host {
        Host::Tcp(name) => name == "localhost" || name.parse().is_ok_and(|address: IpAddr| address.is_loopback()),
        #[cfg(unix)]
        Host::Unix(_) => true,
    };
    if config.get_ssl_mode() == SslMode::Disable || config.get_hosts().iter().all(is_here) {
        return Ok(());
    }
    Err(Error::usage("the way to this server is not encrypted").help(
        "use a tunnel that ends on this computer and name 127.0.0.1 as the host; or say `?sslmode=disable` where the network \
         itself is to be trusted",
    ))
}

/// Host and data base.
fn name(config: &Config) -> String {
    let host = match config.get_hosts().first() {
        Some(Host::Tcp(name)) => name.clone(),
        #[cfg(unix)]
        Some(Host::Unix(folder)) => folder.display().to_string(),
        _ => String::new(),
    };
    format!("{host}, data base {}", config.get_dbname().unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str) -> Result<Address> {
        Address::with(text, |name| (name == "PGPASSWORD").then(|| "geheim".to_owned()))
    }

    fn refused(text: &str) -> String {
        let error = of(text).err().unwrap_or_else(|| panic!("{text} is taken"));
        format!("{error} {:?}", error.help)
    }

    #[test]
    fn no_message_has_a_password() {
        for text in [
            "postgres://me:secret@127.0.0.1/plant",
            "postgres://me:sec/ret@127.0.0.1/plant",
            "postgres://me:secret@127.0.0.1:secret/plant",
            "postgres://127.0.0.1/plant?password=secret",
            "postgres://127.0.0.1/plant?user=me&password=secret",
            "postgres://127.0.0.1/plant?secret=secret",
            "postgres://me:secret@plant.example/plant",
            "postgres://me:%zz@secret",
        ] {
            let told = refused(text);
            assert!(!told.contains("secret") && !told.contains("sec/"), "{told}");
        }
    }

    #[test]
    fn the_password_is_that_of_the_environment() {
        let found = of("postgres://me@127.0.0.1:5433/plant").unwrap();
        assert_eq!(found.config.get_password(), Some(&b"geheim"[..]));
        assert_eq!(found.name, "127.0.0.1, data base plant");
        assert!(refused("postgres://me@127.0.0.1").contains("names no data base"));
    }

    #[test]
    fn what_leaves_the_computer_has_to_be_wanted() {
        assert!(refused("postgres://me@plant.example/db").contains("not encrypted"));
        assert!(refused("postgres://me@127.0.0.1/db?sslmode=require").contains("does not encrypt"));
        for text in ["postgres://me@plant.example/db?sslmode=disable", "postgres://me@%2Frun%2Fdb/db"] {
            assert!(of(text).is_ok(), "{text}");
        }
    }

    #[test]
    fn a_service_file_says_where() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("services");
        let text = "# plant\n[other]\nhost=x\n\n[plant]\nhost = 127.0.0.1\nport=5433\ndbname=history\nuser=me\npassword=secret\n[end]\n";
        std::fs::write(&file, text).unwrap();
        let path = file.display().to_string();
        let variable = |name: &str| (name == "PGSERVICEFILE").then(|| path.clone());
        let found = Address::with("postgres:///?service=plant", variable).unwrap();
        assert_eq!(found.config.get_password(), Some(&b"secret"[..]));
        assert_eq!(found.config.get_ports(), [5433]);
        assert_eq!(found.name, "127.0.0.1, data base history");
        let absent = Address::with("postgres:///?service=mill", variable).err().unwrap().message;
        assert!(absent.contains("no section [mill]") && !absent.contains("secret"), "{absent}");
    }
}
