//! Plugins in processes of their own: a crash or a hang of a vendor's code becomes an error of its stage.
//!
//! Every stage gets a process of its own, in which the same program runs ([`serve`]). Both sides communicate over one socket, the
//! standard input of the child. There is one question at a time; while a side works on it, it may ask questions, too.

mod child;
mod time;
pub(crate) mod trials;
mod watch;
mod wire;

use std::any::Any;
use std::collections::BTreeMap;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::os::unix::net::UnixStream;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread::{JoinHandle, ThreadId};
use std::time::{Duration, Instant};

use abbe_core::{
    Equations, Error, Origin, PoseBatch, Poses, Result, RowBatch, RowIndex, Variable, from_json, harmless,
};

use crate::loader::{About, Create, Library, hashed};
use crate::peer::{Answer, Failure, Peer, Received};
use crate::questions::{check_poses, check_rows, guarded};
use crate::sandbox::named;
use crate::served::Served;
use time::Time;
use wire::{Frame, Reference, Wire};

pub use child::serve;

/// How plugins are isolated.
#[derive(Debug, Clone)]
pub struct Limits {
    /// The program that is started, with the arguments before file and hash: it has to call [`serve`].
    pub program: PathBuf,
    /// Its first arguments.
    pub arguments: Vec<String>,
    /// How long a plugin may work without sending an answer or a question.
    pub answer_timeout: Duration,
    /// How long a stage of it may work altogether.
    pub total_time: Duration,
    /// Memory of the process, MiB.
    pub memory_limit_mib: u64,
}

/// Variables of the environment that a plugin's process gets: where libraries are, language and time. Others may hold secrets.
const ENVIRONMENT: [&str; 7] =
    ["LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH", "LANG", "LC_ALL", "TZ", "RUST_BACKTRACE", "MALLOC_ARENA_MAX"];

/// The thread that uses the socket; none if it is free.
type Holder = Option<ThreadId>;

/// One end of the socket.
pub(crate) struct Connection {
    wire: Mutex<Wire>,
    /// The thread that uses the socket.
    holder: Mutex<Holder>,
    objects: Mutex<Objects>,
    /// Objects of the other side that are released with the next question.
    released: Mutex<Vec<u64>>,
    /// The other process; none in the process that was started for a plugin.
    child: Option<Arc<Mutex<Child>>>,
    /// Passes on what the other process says on its standard error.
    words: Option<JoinHandle<()>>,
    who: String,
    time: Time,
    /// Why the other side is lost. Who asks after that is told the same.
    lost: Arc<OnceLock<Failure>>,
}

/// Our objects for the other side, by number.
#[derive(Default)]
struct Objects {
    served: BTreeMap<u64, Arc<Served>>,
    next: u64,
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Drop for Connection {
    fn drop(&mut self) {
        if let Some(child) = &self.child {
            let mut child = locked(child);
            let _ = child.kill();
            let _ = child.wait();
            self.let_speak();
        }
    }
}

impl Connection {
    /// Asks the other side; answers its questions until it answers ours.
    fn ask(self: &Arc<Self>, frame: &Frame, numbers: &[&[f64]]) -> Result<(Frame, Vec<f64>), Failure> {
        let me = std::thread::current().id();
        if *locked(&self.holder) == Some(me) {
            return Err(Failure::of(&self.who, "was asked while it waited for an answer to a question of its own"));
        }
        let mut wire = locked(&self.wire);
        if let Some(lost) = self.lost.get() {
            return Err(lost.clone());
        }
        *locked(&self.holder) = Some(me);
        let started = Instant::now();
        let answer = self.converse(&mut wire, frame, numbers);
        self.time.spend(started.elapsed());
        *locked(&self.holder) = None;
        match answer {
            Ok((Frame::Failed(failure), _)) => Err(failure),
            Ok(answer) => Ok(answer),
            // The reason is not looked for while others wait to state theirs: who watches the process may have ended it.
            Err(error) => {
                let known = self.lost.get().cloned();
                let reason = known.unwrap_or_else(|| self.reason(&error));
                Err(self.lost.get_or_init(|| reason).clone())
            }
        }
    }

    fn converse(self: &Arc<Self>, wire: &mut Wire, frame: &Frame, numbers: &[&[f64]]) -> io::Result<(Frame, Vec<f64>)> {
        let started = Instant::now();
        for object in std::mem::take(&mut *locked(&self.released)) {
            wire.write(&Frame::Release { object }, &[], self.time.until(started))?;
        }
        wire.write(frame, numbers, self.time.until(started))?;
        loop {
            let (frame, numbers) = wire.read(self.time.until(started))?;
            match frame {
                Frame::Answer { .. } | Frame::Numbers { .. } | Frame::Failed(_) => return Ok((frame, numbers)),
                question => self.answer(wire, question, &numbers, started)?,
            }
        }
    }

    /// Works on a question of the other side and writes the answer.
    fn answer(self: &Arc<Self>, wire: &mut Wire, question: Frame, numbers: &[f64], started: Instant) -> io::Result<()> {
        if let Frame::Release { object } = question {
            locked(&self.objects).served.remove(&object);
            return Ok(());
        }
        match guarded(|| self.work(question, numbers)) {
            Ok((frame, numbers)) => {
                let lists: Vec<&[f64]> = numbers.iter().map(Vec::as_slice).collect();
                wire.write(&frame, &lists, self.time.until(started))
            }
            Err(failure) => wire.write(&Frame::Failed(failure), &[], self.time.until(started)),
        }
    }

    fn work(self: &Arc<Self>, question: Frame, numbers: &[f64]) -> Result<(Frame, Vec<Vec<f64>>), Failure> {
        let wrong = |what: &str| Failure::of("the other side", what);
        match question {
            Frame::Call { object, method, text, objects } => {
                let objects: Vec<Received> = objects.into_iter().map(|one| self.take(one)).collect::<Result<_, _>>()?;
                let (text, objects) = self.object(object)?.dispatch(method, &text, &objects)?;
                let objects = objects.into_iter().map(|object| self.give(&object)).collect();
                Ok((Frame::Answer { text, objects }, Vec::new()))
            }
            Frame::Poses { object, lengths, orientation } => {
                let [statuses, values, wanted] = wire::split(numbers, lengths).map_err(wrong)?;
                let wanted: Vec<Variable> = wanted.iter().copied().map(wire::variable).collect();
                let mut out = Poses::default();
                self.object(object)?.machine(|machine| {
                    let info = machine.info();
                    let poses = check_poses(info, &PoseBatch { statuses, values, wanted: &wanted, orientation })?;
                    if !wire::carries(poses, wanted.len()) {
                        return Err(wrong("asks for more derivatives than a message has room for"));
                    }
                    Ok(machine.poses(statuses, values, &wanted, orientation, &mut out)?)
                })?;
                let lists = wire::poses_lists(&out);
                Ok((Frame::Numbers { lengths: lists.iter().map(Vec::len).collect() }, lists))
            }
            Frame::Equations { object, lengths } => {
                let [rows, positions, orientations, own, inputs] = wire::split(numbers, lengths).map_err(wrong)?;
                let served = self.object(object)?;
                let Served::Observations(observations, _) = served.as_ref() else {
                    return Err(Failure::of("the other side", "asks an object for equations that has none"));
                };
                let rows: Vec<RowIndex> = rows.iter().map(|&row| RowIndex(row as usize)).collect();
                let (positions, orientations) = (wire::points(positions).0, wire::quaternions(orientations).0);
                let mut out = Equations::default();
                let batch = RowBatch { rows: &rows, positions, orientations, own, inputs };
                check_rows(observations.info(), &batch)?;
                observations.evaluate(batch, &mut out)?;
                let lists = wire::equation_lists(&out);
                Ok((Frame::Numbers { lengths: lists.iter().map(Vec::len).collect() }, lists))
            }
            _ => Err(wrong("asks what cannot be asked here")),
        }
    }

    fn object(&self, number: u64) -> Result<Arc<Served>, Failure> {
        let object = locked(&self.objects).served.get(&number).cloned();
        object.ok_or_else(|| Failure::of("the other side", format!("names the object {number}, which is not there")))
    }

    /// Gives an object of ours a number for the other side. A proxy for an object of the other side is sent as that object.
    fn give(self: &Arc<Self>, object: &Arc<Served>) -> Reference {
        if let Some(peer) = object.peer()
            && let Some(theirs) = peer.as_any().downcast_ref::<Remote>()
            && Arc::ptr_eq(&theirs.connection, self)
        {
            return Reference::Yours(theirs.object);
        }
        let mut objects = locked(&self.objects);
        let number = objects.next;
        objects.next += 1;
        objects.served.insert(number, object.clone());
        Reference::Mine(number)
    }

    fn take(self: &Arc<Self>, reference: Reference) -> Result<Received, Failure> {
        match reference {
            Reference::Yours(number) => self.object(number).map(Received::Local),
            Reference::Mine(object) => {
                Ok(Received::Remote(Arc::new(Remote { connection: self.clone(), object, who: self.who.clone() })))
            }
        }
    }

    /// Waits for the last messages of a process that has ended, so that they come before the error about its end.
    fn let_speak(&self) {
        within_a_second(|| self.words.as_ref().is_none_or(JoinHandle::is_finished).then_some(()));
    }

    /// The reason why the other side does not answer. Ends its process.
    fn reason(&self, error: &io::Error) -> Failure {
        let Some(child) = &self.child else { return Failure::of(&self.who, format!("is gone: {error}")) };
        let mut child = locked(child);
        if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) {
            let _ = child.kill();
            let _ = child.wait();
            return Failure::of(&self.who, format!("{}; its process was ended", self.time.limit()));
        }
        // The other side has closed the socket: its process is ending, or cannot be used any more.
        let status = within_a_second(|| match child.try_wait() {
            Ok(None) => None,
            ended => Some(ended),
        });
        self.let_speak();
        match status {
            Some(Ok(Some(status))) => match status.signal() {
                Some(signal) => Failure::of(&self.who, format!("crashed: its process was ended by {}", name(signal))),
                None => Failure::of(&self.who, format!("ended its process, with {status}")),
            },
            _ => {
                let _ = child.kill();
                Failure::of(&self.who, format!("broke the connection: {error}"))
            }
        }
    }
}

/// The name of a signal that ends a process after a crash.
fn name(signal: i32) -> String {
    let names = [(4, "SIGILL"), (6, "SIGABRT"), (7, "SIGBUS"), (8, "SIGFPE"), (9, "SIGKILL"), (11, "SIGSEGV")];
    let known = names.into_iter().find(|known| known.0 == signal);
    known.map_or_else(|| format!("signal {signal}"), |known| format!("signal {signal} ({})", known.1))
}

/// An object of the other process.
struct Remote {
    connection: Arc<Connection>,
    object: u64,
    who: String,
}

impl Drop for Remote {
    fn drop(&mut self) {
        locked(&self.connection.released).push(self.object);
    }
}

impl Peer for Remote {
    fn who(&self) -> &str {
        &self.who
    }

    fn call(&self, method: u32, text: &str, objects: &[Arc<Served>]) -> Result<Answer, Failure> {
        let objects: Vec<Reference> = objects.iter().map(|object| self.connection.give(object)).collect();
        let question = Frame::Call { object: self.object, method, text: text.to_owned(), objects };
        let answer = self.connection.ask(&question, &[]);
        match answer? {
            (Frame::Answer { text, objects }, _) => {
                let objects = objects.into_iter().map(|one| self.connection.take(one)).collect::<Result<_, _>>()?;
                Ok(Answer { text, objects })
            }
            _ => Err(Failure::of(&self.who, "answered something else")),
        }
    }

    fn poses(&self, statuses: &[f64], values: &[f64], wanted: &[Variable], out: &mut Poses) -> Result<(), Failure> {
        let wanted: Vec<f64> = wanted.iter().map(wire::number).collect();
        let question = Frame::Poses {
            object: self.object,
            lengths: [statuses.len(), values.len(), wanted.len()],
            orientation: !out.orientations.is_empty(),
        };
        let (answer, numbers) = self.connection.ask(&question, &[statuses, values, &wanted])?;
        wire::read_poses(&answer, &numbers, out).map_err(|what| Failure::of(&self.who, what))
    }

    fn equations(&self, batch: RowBatch<'_>, out: &mut Equations) -> Result<(), Failure> {
        let RowBatch { rows, positions, orientations, own, inputs } = batch;
        let rows: Vec<f64> = rows.iter().map(|row| row.0 as f64).collect();
        let lists = [&rows, positions.as_flattened(), orientations.as_flattened(), own, inputs];
        let question = Frame::Equations { object: self.object, lengths: lists.map(<[f64]>::len) };
        let (answer, numbers) = self.connection.ask(&question, &lists)?;
        wire::read_equations(&answer, &numbers, out).map_err(|what| Failure::of(&self.who, what))
    }

    fn as_any(&self) -> &dyn Any {
        self
    }
}

/// Calls `find` again and again for a second, until it gives a result.
fn within_a_second<T>(mut find: impl FnMut() -> Option<T>) -> Option<T> {
    (0..100).find_map(|_| {
        let found = find();
        if found.is_none() {
            std::thread::sleep(Duration::from_millis(10));
        }
        found
    })
}

/// Starts a process that loads a library, and may read these files.
fn start(
    path: &Path,
    sha256: &str,
    limits: &Limits,
    may_read: &[PathBuf],
    who: &str,
) -> Result<Arc<Connection>, Failure> {
    let failed = |error: io::Error| Failure::of(who, format!("cannot be isolated: {error}"));
    let (ours, theirs) = UnixStream::pair().map_err(failed)?;
    let mut command = Command::new(&limits.program);
    command.args(&limits.arguments).arg(path).arg(sha256);
    command.arg("--memory-limit-mib").arg(limits.memory_limit_mib.to_string());
    for file in may_read {
        command.arg("--may-read").arg(file);
    }
    command.env_clear().envs(ENVIRONMENT.into_iter().filter_map(|name| Some((name, std::env::var_os(name)?))));
    command.stdin(Stdio::from(std::os::fd::OwnedFd::from(theirs))).stdout(Stdio::null());
    let mut child = command.stderr(Stdio::piped()).spawn().map_err(failed)?;
    let words = child.stderr.take().map(|said| {
        std::thread::Builder::new().name("plugin's words".to_owned()).spawn(|| pass_on(said)).map_err(failed)
    });
    let words = words.transpose()?;
    let (child, lost) = (Arc::new(Mutex::new(child)), Arc::default());
    watch::watch(&child, &lost, who).map_err(failed)?;
    Ok(Arc::new(Connection {
        wire: Mutex::new(Wire::new(ours)),
        holder: Mutex::new(None),
        objects: Mutex::default(),
        released: Mutex::default(),
        child: Some(child),
        words,
        who: who.to_owned(),
        time: Time::limited(limits.answer_timeout, limits.total_time),
        lost,
    }))
}

/// Bytes of the longest line of a process that is passed on at once.
const LONGEST_LINE: u64 = 1 << 16;

/// Bytes of what one process says that are passed on.
const MOST_SAID: usize = 1 << 20;

/// Writes what a process says on its standard error to that of this one, line by line, without what a terminal would obey. The rest of
/// what says too much is read, so that it goes on, and left out.
fn pass_on(said: impl Read) {
    let mut said = BufReader::new(said);
    let (mut line, mut passed) = (Vec::new(), 0);
    while passed < MOST_SAID
        && let Ok(length @ 1..) = said.by_ref().take(LONGEST_LINE).read_until(b'\n', &mut line)
    {
        let _ = io::stderr().write_all(harmless(&String::from_utf8_lossy(&line)).as_bytes());
        line.clear();
        passed += length;
    }
    if passed >= MOST_SAID {
        let _ = writeln!(io::stderr(), "a plugin says more than {} MiB: the rest is left out", MOST_SAID >> 20);
        let _ = io::copy(&mut said, &mut io::sink());
    }
}

/// The plugins of a library that is never loaded into this program: every stage runs in a process of its own.
pub fn isolated(path: &Path, pin: Option<&str>, limits: &Limits) -> Result<Library> {
    let sha256 = hashed(path, pin)?.sha256;
    let who = format!("the plugin library {}", path.display());
    let wrong = |failure: Failure| {
        let mut error = failure.error(&who);
        error.class = abbe_core::Class::Use;
        error
    };
    let connection = start(path, &sha256, limits, &[], &who).map_err(wrong)?;
    let (answer, _) = connection.ask(&Frame::List, &[]).map_err(wrong)?;
    let Frame::Answer { text, .. } = answer else { return Err(Error::usage(format!("{who} lists no plugins"))) };
    let listed: Listed = from_json(&text).map_err(|error| Error::usage(format!("{who}: {error}")))?;
    let origin = Origin::Library { file: path.to_owned(), sha256: sha256.clone() };
    let plugins = listed.plugins.into_iter().map(|about| {
        let create = in_a_process(path.to_owned(), sha256.clone(), limits.clone(), about.kind, about.name.clone());
        about.plugin(path, &origin, create).map_err(|what| Error::usage(format!("{who} {what}")))
    });
    let plugins = plugins.collect::<Result<_>>()?;
    Ok(Library { file: path.to_owned(), sha256, name: listed.name, version: listed.version, plugins })
}

/// The description of a library.
#[derive(serde::Serialize, serde::Deserialize)]
struct Listed {
    name: String,
    version: String,
    plugins: Vec<About>,
}

fn in_a_process(path: PathBuf, sha256: String, limits: Limits, kind: u32, name: String) -> Create {
    Arc::new(move |settings, base, who| {
        let connection = start(&path, &sha256, &limits, &named(settings, Path::new(base)), who)?;
        let question = Frame::Create { kind, name: name.clone(), settings: settings.to_owned(), base: base.to_owned() };
        match connection.ask(&question, &[])?.0 {
            Frame::Answer { objects, .. } => {
                let object = objects.into_iter().next().ok_or_else(|| Failure::of(who, "gave no stage"))?;
                connection.take(object)
            }
            _ => Err(Failure::of(who, "answered something else")),
        }
    })
}
