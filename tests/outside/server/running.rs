//! A server of its own: in a temporary folder, on this computer alone, ended with the test.

use std::net::TcpListener;
use std::os::unix::fs::chown;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use postgres::{Client, NoTls};
use tempfile::TempDir;

use crate::support::{skipped, temporary, write};

/// Seconds after which the server ends whatever happens to the test.
const LONGEST: &str = "600";

/// The password of its user, for connections by network.
pub const PASSWORD: &str = "geheim und lang";

/// Who may run a server where the tests are run by root, which servers refuse.
const USERS: [&str; 2] = ["postgres", "nobody"];

pub struct Running {
    process: Child,
    folder: TempDir,
    port: u16,
}

impl Drop for Running {
    fn drop(&mut self) {
        // At once, with all that it does: `timeout` passes it on.
        let _ = Command::new("kill").args(["-INT", &self.process.id().to_string()]).status();
        let begun = Instant::now();
        while begun.elapsed() < Duration::from_secs(120) {
            if matches!(self.process.try_wait(), Ok(Some(_))) {
                return;
            }
            sleep(Duration::from_millis(20));
        }
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// A program of the server, and the user who may run it.
struct Programs {
    folder: Option<PathBuf>,
    user: Option<(u32, u32)>,
}

impl Programs {
    /// Those of this computer; or why there are none.
    fn find() -> Result<Self, &'static str> {
        let is_there = |program: &Path| {
            let asked = Command::new(program).arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status();
            asked.is_ok_and(|status| status.success())
        };
        let mut folders: Vec<Option<PathBuf>> = vec![None];
        let installed = std::fs::read_dir("/usr/lib/postgresql").into_iter().flatten().flatten();
        let mut installed: Vec<PathBuf> = installed.map(|version| version.path().join("bin")).collect();
        installed.sort();
        folders.extend(installed.into_iter().rev().map(Some));
        let named = |folder: &Option<PathBuf>, name: &str| folder.as_ref().map_or(name.into(), |own| own.join(name));
        let whole = |folder: &Option<PathBuf>| ["initdb", "postgres"].iter().all(|name| is_there(&named(folder, name)));
        let folder = folders.into_iter().find(whole).ok_or("PostgreSQL is not installed (Debian: postgresql)")?;
        if !is_there(Path::new("timeout")) {
            return Err("there is no program `timeout`, which bounds the server");
        }
        let user = match number(&["-u"]) {
            Some(0) => {
                let known = |user: &str| Some((number(&["-u", user])?, number(&["-g", user])?));
                Some(USERS.into_iter().find_map(known).ok_or("a server refuses root, and there is no other user")?)
            }
            _ => None,
        };
        Ok(Self { folder, user })
    }

    fn command(&self, program: &str, before: &[&str]) -> Command {
        let path = self.folder.as_ref().map_or(program.into(), |folder| folder.join(program));
        let mut words = before.iter().map(|word| Path::new(word).to_owned()).chain([path]);
        let mut command = Command::new(words.next().expect("a program"));
        command.args(words).current_dir("/").stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        command.env_clear().envs(std::env::var_os("PATH").map(|path| ("PATH", path)));
        if let Some((user, group)) = self.user {
            command.uid(user).gid(group);
        }
        command
    }
}

fn number(arguments: &[&str]) -> Option<u32> {
    let said = Command::new("id").args(arguments).output().ok()?;
    String::from_utf8(said.stdout).ok()?.trim().parse().ok()
}

impl Running {
    /// Starts a server; none, and the test is skipped, where that cannot be.
    pub fn start(test: &str) -> Option<Self> {
        let programs = Programs::find().map_err(|reason| skipped(test, reason)).ok()?;
        let folder = temporary();
        let password = folder.path().join("password");
        write(&password, PASSWORD);
        for path in [folder.path(), &password] {
            let (user, group) = programs.user.unzip();
            chown(path, user, group).expect("the folder can be given away");
        }
        let data = folder.path().join("data");
        // Who comes by the socket, which the folder protects, is trusted; who comes by network needs the password.
        let made = programs
            .command("initdb", &["timeout", "120"])
            .args([
                "--username=abbe",
                "--auth-local=trust",
                "--auth-host=scram-sha-256",
                "--encoding=UTF8",
                "--locale=C",
            ])
            .arg("--no-sync")
            .arg(format!("--pwfile={}", password.display()))
            .arg(&data)
            .status();
        assert!(made.is_ok_and(|status| status.success()), "initdb fails");
        let port = TcpListener::bind("127.0.0.1:0").and_then(|free| free.local_addr()).expect("a free port").port();
        let mut server = programs.command("postgres", &["timeout", "--signal=INT", "--kill-after=20", LONGEST]);
        server.arg("-D").arg(&data).arg("-p").arg(port.to_string()).arg("-k").arg(folder.path());
        for setting in [
            "listen_addresses=127.0.0.1",
            "fsync=off",
            "shared_buffers=16MB",
            "max_connections=20",
            "max_wal_size=64MB",
        ] {
            server.args(["-c", setting]);
        }
        let mut running = Self { process: server.spawn().expect("the server starts"), folder, port };
        let begun = Instant::now();
        while running.client("postgres").is_err() {
            let ended = running.process.try_wait().expect("a process");
            assert!(
                ended.is_none() && begun.elapsed() < Duration::from_secs(300),
                "the server does not answer: {ended:?}"
            );
            sleep(Duration::from_millis(50));
        }
        for name in ["plant", "other"] {
            running.raw("postgres").batch_execute(&format!("CREATE DATABASE {name}")).expect("a data base");
        }
        Some(running)
    }

    fn client(&self, database: &str) -> Result<Client, postgres::Error> {
        let folder = self.folder.path().display();
        Client::connect(&format!("host={folder} port={} user=abbe dbname={database}", self.port), NoTls)
    }

    /// A connection for statements of the test.
    pub fn raw(&self, database: &str) -> Client {
        self.client(database).expect("the server answers")
    }

    /// The address by the socket, without a password.
    pub fn by_socket(&self, database: &str) -> String {
        let folder = self.folder.path().display().to_string().replace('/', "%2F");
        format!("postgres://abbe@{folder}:{}/{database}", self.port)
    }

    /// The address by network.
    pub fn by_network(&self, database: &str) -> String {
        format!("postgres://abbe@127.0.0.1:{}/{database}", self.port)
    }
}
