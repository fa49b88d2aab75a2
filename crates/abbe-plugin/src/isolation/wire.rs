//! What goes over the socket: a text (JSON) and numbers, each with its length before it.

use std::io::{self, Read, Write};
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use abbe_core::{Equations, Poses, Variable};
use serde::{Deserialize, Serialize};

use crate::peer::Failure;

/// An object, from the point of view of the side that writes.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(super) enum Reference {
    Mine(u64),
    Yours(u64),
}

/// A question or an answer; `lengths` are those of the lists of numbers that follow.
#[derive(Debug, Serialize, Deserialize)]
pub(super) enum Frame {
    List,
    Create { kind: u32, name: String, settings: String, base: String },
    Call { object: u64, method: u32, text: String, objects: Vec<Reference> },
    Poses { object: u64, lengths: [usize; 3], orientation: bool },
    Equations { object: u64, lengths: [usize; 5] },
    Release { object: u64 },
    Answer { text: String, objects: Vec<Reference> },
    Numbers { lengths: Vec<usize> },
    Failed(Failure),
}

/// Largest accepted number of bytes or of numbers. A larger one is taken as an error of the other side.
const LONGEST: u64 = 1 << 28;

/// Bytes for which there is room before they come.
const AT_ONCE: u64 = 1 << 20;

/// One end of the socket.
pub(super) struct Wire {
    socket: UnixStream,
    buffer: Vec<u8>,
}

impl Wire {
    pub fn new(socket: UnixStream) -> Self {
        Self { socket, buffer: Vec::new() }
    }

    /// Writes a frame, until this moment at the latest.
    pub fn write(&mut self, frame: &Frame, numbers: &[&[f64]], until: Option<Instant>) -> io::Result<()> {
        encode(frame, numbers, &mut self.buffer)?;
        Timed { socket: &self.socket, until }.write_all(&self.buffer)
    }

    /// Reads a frame, until this moment at the latest, however slowly it comes.
    pub fn read(&mut self, until: Option<Instant>) -> io::Result<(Frame, Vec<f64>)> {
        decode(Timed { socket: &self.socket, until }, &mut self.buffer)
    }
}

/// The socket up to a moment.
struct Timed<'a> {
    socket: &'a UnixStream,
    until: Option<Instant>,
}

impl Timed<'_> {
    /// What is left of the time.
    fn left(&self) -> io::Result<Option<Duration>> {
        let Some(until) = self.until else { return Ok(None) };
        match until.saturating_duration_since(Instant::now()) {
            Duration::ZERO => Err(io::Error::from(io::ErrorKind::TimedOut)),
            left => Ok(Some(left)),
        }
    }
}

impl Read for Timed<'_> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        if let Some(left) = self.left()? {
            self.socket.set_read_timeout(Some(left))?;
        }
        self.socket.read(into)
    }
}

impl Write for Timed<'_> {
    fn write(&mut self, from: &[u8]) -> io::Result<usize> {
        if let Some(left) = self.left()? {
            self.socket.set_write_timeout(Some(left))?;
        }
        self.socket.write(from)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// The bytes of a frame.
pub(super) fn encode(frame: &Frame, numbers: &[&[f64]], into: &mut Vec<u8>) -> io::Result<()> {
    into.clear();
    into.extend_from_slice(&[0; 16]);
    serde_json::to_writer(&mut *into, frame)?;
    let text = into.len() as u64 - 16;
    let count = numbers.iter().map(|list| list.len() as u64).sum::<u64>();
    into[..8].copy_from_slice(&text.to_le_bytes());
    into[8..16].copy_from_slice(&count.to_le_bytes());
    for number in numbers.iter().copied().flatten() {
        into.extend_from_slice(&number.to_le_bytes());
    }
    Ok(())
}

/// Reads a frame from its bytes. What a frame says of its length takes no memory before the bytes are there.
pub(super) fn decode(mut from: impl Read, buffer: &mut Vec<u8>) -> io::Result<(Frame, Vec<f64>)> {
    let mut lengths = [0; 16];
    from.read_exact(&mut lengths)?;
    let length = |at: usize| lengths[at..at + 8].iter().rev().fold(0_u64, |all, byte| all << 8 | u64::from(*byte));
    let (text, count) = (length(0), length(8));
    if text > LONGEST || count > LONGEST {
        return Err(io::Error::new(io::ErrorKind::InvalidData, "a frame says that it is longer than any is"));
    }
    let all = text + 8 * count;
    buffer.clear();
    buffer.reserve(all.min(AT_ONCE) as usize);
    if from.take(all).read_to_end(buffer)? as u64 != all {
        return Err(io::Error::from(io::ErrorKind::UnexpectedEof));
    }
    let (text, numbers) = buffer.split_at(text as usize);
    let frame = serde_json::from_slice(text)?;
    let (numbers, _) = numbers.as_chunks::<8>();
    Ok((frame, numbers.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect()))
}

/// Cuts numbers into lists.
pub(super) fn split<const N: usize>(numbers: &[f64], lengths: [usize; N]) -> Result<[&[f64]; N], &'static str> {
    let mut lists = [&[][..]; N];
    let mut rest = numbers;
    for (list, length) in lists.iter_mut().zip(lengths) {
        (*list, rest) = rest.split_at_checked(length).ok_or("gives fewer numbers than it says")?;
    }
    Ok(lists)
}

/// Number of the first command; lower numbers are those of parameters.
const COMMANDS: f64 = 4_294_967_296.0;

pub(super) fn number(variable: &Variable) -> f64 {
    match *variable {
        Variable::Parameter(index) => index as f64,
        Variable::Command(index) => COMMANDS + index as f64,
    }
}

pub(super) fn variable(number: f64) -> Variable {
    match number >= COMMANDS {
        true => Variable::Command((number - COMMANDS) as usize),
        false => Variable::Parameter(number as usize),
    }
}

/// Whether a message has room for poses with derivatives to so many variables.
pub(super) fn carries(poses: usize, wanted: usize) -> bool {
    // Three numbers of a position and four of an orientation; three of each for every derivative.
    let numbers = (poses as u64).saturating_mul((wanted as u64).saturating_mul(6).saturating_add(7));
    numbers <= LONGEST
}

pub(super) fn points(numbers: &[f64]) -> (&[[f64; 3]], &[f64]) {
    numbers.as_chunks()
}

pub(super) fn quaternions(numbers: &[f64]) -> (&[[f64; 4]], &[f64]) {
    numbers.as_chunks()
}

pub(super) fn poses_lists(poses: &Poses) -> Vec<Vec<f64>> {
    vec![
        poses.positions.as_flattened().to_vec(),
        poses.orientations.as_flattened().to_vec(),
        poses.position_derivatives.as_flattened().to_vec(),
        poses.rotation_derivatives.as_flattened().to_vec(),
    ]
}

/// Reads an answer into poses of the requested size.
pub(super) fn read_poses(answer: &Frame, numbers: &[f64], out: &mut Poses) -> Result<(), &'static str> {
    let lists: [&mut [f64]; 4] = [
        out.positions.as_flattened_mut(),
        out.orientations.as_flattened_mut(),
        out.position_derivatives.as_flattened_mut(),
        out.rotation_derivatives.as_flattened_mut(),
    ];
    let Frame::Numbers { lengths } = answer else { return Err("answered something else than poses") };
    let fits = lengths.len() == 4 && lengths.iter().zip(&lists).all(|(length, list)| *length == list.len());
    if !fits || numbers.len() != lengths.iter().sum::<usize>() {
        return Err("gave another number of poses or derivatives than it was asked for");
    }
    let mut rest = numbers;
    for list in lists {
        let (own, others) = rest.split_at(list.len());
        list.copy_from_slice(own);
        rest = others;
    }
    Ok(())
}

pub(super) fn equation_lists(equations: &Equations) -> Vec<Vec<f64>> {
    let triples = |list: &[(usize, usize, f64)]| -> Vec<f64> {
        list.iter().flat_map(|by| [by.0 as f64, by.1 as f64, by.2]).collect()
    };
    vec![
        equations.residuals().to_vec(),
        equations.by_position().as_flattened().to_vec(),
        equations.by_rotation().as_flattened().to_vec(),
        triples(equations.by_own()),
        triples(equations.by_input()),
    ]
}

/// Adds the equations of an answer.
pub(super) fn read_equations(answer: &Frame, numbers: &[f64], out: &mut Equations) -> Result<(), String> {
    let Frame::Numbers { lengths } = answer else { return Err("answered something else than equations".to_owned()) };
    let lengths: [usize; 5] =
        lengths.as_slice().try_into().map_err(|_| "gave another number of lists than equations have".to_owned())?;
    let [residuals, positions, rotations, own, inputs] = split(numbers, lengths)?;
    let (mut own, mut inputs) = (points(own).0.iter().peekable(), points(inputs).0.iter().peekable());
    for (index, &residual) in residuals.iter().enumerate() {
        out.equation(residual);
        while let Some(by) = own.next_if(|by| by[0] as usize == index) {
            out.own(by[1] as usize, by[2]);
        }
        while let Some(by) = inputs.next_if(|by| by[0] as usize == index) {
            out.input(by[1] as usize, by[2]);
        }
    }
    points(positions).0.iter().for_each(|by| out.position(*by));
    points(rotations).0.iter().for_each(|by| out.rotation(*by));
    Ok(())
}
