//! Consoles of hosts that send lines ahead. A host keeps as many characters on their way as the control has room for, and the control
//! answers whenever it likes: replies stand anywhere among later echoes. What is read is what was measured, or the log is refused.

use std::collections::VecDeque;
use std::fmt::Write;

use proptest::prelude::*;

use super::{Aborted, Run, WANTED, Wanted, is_measured, read, runs};

/// What grbl has room for, characters.
const ROOM: usize = 128;

/// What a host shows.
#[derive(Debug, Clone, Copy)]
struct Host {
    prefix: &'static str,
    /// Whether comments are sent; else the header is copied to the top.
    comments: bool,
    confirmations: bool,
    /// Whether it waits for each reply.
    waits: bool,
}

fn hosts() -> impl Strategy<Value = Host> {
    let prefix = prop::sample::select(vec!["", ">>> ", "> ", "SND: 12 : ", "[Sent] "]);
    (prefix, any::<bool>(), prop::bool::weighted(0.8), prop::bool::weighted(0.1)).prop_map(
        |(prefix, comments, confirmations, waits)| Host {
            prefix: if prefix.starts_with('[') { "12:00:01 > " } else { prefix },
            comments,
            confirmations,
            waits,
        },
    )
}

/// A line of the program, and the answer of the control before it confirms the line.
type Line = (String, Option<String>);

impl Run {
    fn header(&self) -> Vec<String> {
        let unit = if self.inches { "INCH" } else { "MM" };
        let count = format!("(TOUCHES {} REPEATS {})", self.plan.len(), self.repeats);
        let plan = format!("(PLAN {})", self.plan().identity());
        vec!["(ABBE 1)".to_owned(), plan, format!("(UNITS {unit})"), "(FRAME MACHINE)".to_owned(), count]
    }

    /// The program as `abbe plan` writes it.
    fn program(&self) -> Vec<Line> {
        let scale = self.scale();
        let answer = |at: [f64; 4], hit: bool| {
            let [x, y, z] = [0, 1, 2].map(|axis| at[axis] / scale);
            Some(format!("[PRB:{x:.14},{y:.14},{z:.14},0.0,0.0,{:.14}:{}]", at[3], u8::from(hit)))
        };
        let mut lines: Vec<Line> = self.header().into_iter().map(|line| (line, None)).collect();
        let mut add = |line: &str, answer: Option<String>| lines.push((line.to_owned(), answer));
        add(if self.inches { "G20 G17 G40 G49 G80 G90 G94" } else { "G21 G17 G40 G49 G80 G90 G94" }, None);
        add("M0", None);
        let mut last = 0;
        for (touch, repeat, _, found) in self.all() {
            if touch + 1 != last {
                last = touch + 1;
                add(&format!("(touch {last} feature f{})", touch + 101), None);
                for height in [9.0, 5.0] {
                    add(&format!("G38.3 X1 Y2 Z{height} F1000"), answer([1.0, 2.0, height, 0.0], false));
                }
            }
            // The search finds the surface a little later than the touch that counts.
            let searched = found.map(|[x, y, z, c]| [x + 0.01, y, z, c]);
            add("G38.3 X5 F300", answer(searched.unwrap_or([5.0; 4]), searched.is_some()));
            add("G91 G1 X-0.5 F1000", None);
            add("G90", None);
            let line = format!("N{} G38.3 X5 F{}", 100 * (touch + 1) + repeat + 1, 50.0 / scale);
            add(&line, answer(found.unwrap_or([5.0; 4]), found.is_some()));
            add("G1 X1 F1000", None);
        }
        add("(END)", None);
        add("M2", None);
        lines
    }

    /// The console of a host, line by line; `late` says at each step whether the control is slower than the host. After so many lines
    /// the control stops with an alarm.
    fn streamed(&self, host: Host, late: &[bool], stop: usize) -> Vec<String> {
        let mut shown: Vec<String> = vec!["Grbl 1.1h ['$' for help]".to_owned()];
        let mut program: VecDeque<Line> = self.program().into();
        if !host.comments {
            shown.extend(self.header());
            program.retain(|(line, _)| !line.starts_with('('));
        }
        let (mut waiting, mut way, mut carried_out) = (VecDeque::<Line>::new(), 0, 0);
        let mut late = late.iter().copied().cycle();
        while !(program.is_empty() && waiting.is_empty()) {
            let room = match host.waits {
                true => waiting.is_empty(),
                false => program.front().is_some_and(|(line, _)| way + line.len() < ROOM),
            };
            if room && (waiting.is_empty() || late.next() == Some(true)) {
                let Some((line, answer)) = program.pop_front() else { continue };
                way += line.len() + 1;
                shown.push(format!("{}{line}", host.prefix));
                waiting.push_back((line, answer));
                continue;
            }
            let Some((line, answer)) = waiting.pop_front() else { continue };
            if carried_out == stop {
                shown.push("ALARM:4".to_owned());
                return shown;
            }
            carried_out += 1;
            way -= line.len() + 1;
            shown.extend(answer);
            if host.confirmations {
                shown.push("ok".to_owned());
            }
        }
        shown
    }
}

fn text(lines: &[String]) -> String {
    let mut text = String::new();
    for line in lines {
        let _ = writeln!(text, "{line}");
    }
    text
}

const ACCEPTED: Wanted = Wanted { aborted: Aborted::Accept, ..WANTED };

/// Whether a line of the console is one of the host, the copied header among them.
fn is_sent(line: &str) -> bool {
    !(line == "ok" || line.starts_with("[PRB") || line.starts_with("Grbl"))
}

fn lateness() -> impl Strategy<Value = Vec<bool>> {
    (prop::collection::vec(any::<bool>(), 1..60), any::<bool>())
        .prop_map(|(late, all)| if all { vec![true] } else { late })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(192))]

    #[test]
    fn replies_among_later_lines_are_read_right(mut run in runs(), host in hosts(), late in lateness()) {
        run.offset = None;
        let text = text(&run.streamed(host, &late, usize::MAX));
        match read(4, &text, &run.plan(), &WANTED) {
            Ok((data, _)) => run.compare(&data, 1e-11, false)?,
            Err(error) => prop_assert!(run.tries.iter().all(|(_, away)| away.is_none()), "{}\n{}", error, text),
        }
    }

    /// The end that was sent ahead is none: the log is an aborted one, and what was answered before the alarm counts.
    #[test]
    fn an_alarm_among_lines_that_were_sent_ahead_aborts(mut run in runs(), host in hosts(), late in lateness(), at in 0.0..1.0_f64) {
        run.offset = None;
        let probes = |lines: &[Line]| lines.iter().rposition(|(_, answer)| answer.is_some()).unwrap_or_default();
        let lines: Vec<Line> = run.program().into_iter().filter(|(line, _)| host.comments || !line.starts_with('(')).collect();
        let stop = (at * probes(&lines) as f64) as usize;
        let text = text(&run.streamed(host, &late, stop));
        prop_assert!(read(4, &text, &run.plan(), &WANTED).is_err(), "{}", text);
        let made = lines[..stop].iter().filter(|(line, answer)| {
            line.starts_with('N') && answer.as_ref().is_some_and(|answer| answer.ends_with(":1]"))
        });
        let made = made.count();
        match read(4, &text, &run.plan(), &ACCEPTED) {
            Ok((data, _)) => {
                prop_assert_eq!(data.rows(), made, "{}", text);
                is_measured(&run, &data, &text)?;
            }
            Err(error) => prop_assert_eq!(made, 0, "{}\n{}", error, text),
        }
    }

    /// Lines that the console has lost or shown twice, some in one place: no touch gets the answer of another one. As many sent lines as
    /// confirmed ones make up for each other, and so may a comment in a log of two touches.
    #[test]
    fn a_console_that_lost_lines_gives_no_wrong_number(mut run in runs(), host in hosts(), late in lateness(), at in 0_usize..10_000, count in 1_usize..9, twice in any::<bool>(), accept in any::<bool>()) {
        run.offset = None;
        let host = Host { confirmations: true, ..host };
        let mut lines = run.streamed(host, &late, usize::MAX);
        let from = at % lines.len();
        let to = (from + count).min(lines.len());
        let confirmed = lines[from..to].iter().filter(|line| *line == "ok").count();
        let sent = lines[from..to].iter().filter(|line| line.starts_with(host.prefix) && is_sent(line)).count();
        prop_assume!(confirmed != sent && (run.plan.len() > 2 || !host.comments));
        match twice {
            false => drop(lines.drain(from..to)),
            true => {
                let again = lines[from..to].to_vec();
                drop(lines.splice(to..to, again));
            }
        }
        let text = text(&lines);
        let wanted = if accept { ACCEPTED } else { WANTED };
        if let Ok((data, _)) = read(4, &text, &run.plan(), &wanted) {
            is_measured(&run, &data, &text)?;
        }
    }
}

/// An echo and an answer are lost together: without counting confirmations the answers shift by one touch.
#[test]
fn a_lost_echo_and_a_lost_answer_do_not_make_up_for_each_other() {
    let run = Run {
        plan: vec![[1.0, 2.0, 3.0, 0.0]; 6],
        repeats: 1,
        tries: (0..6).map(|touch| (0, Some([0.1 * f64::from(touch), 0.0, 0.0]))).collect(),
        inches: false,
        offset: None,
        pads: vec![0],
        stale: false,
    };
    let host = Host { prefix: "> ", comments: true, confirmations: true, waits: false };
    let lines = run.streamed(host, &[true, true, false], usize::MAX);
    assert!(read(4, &text(&lines), &run.plan(), &WANTED).is_ok());
    let echo = lines.iter().position(|line| line.contains("N301 ")).expect("an echo");
    let answer = (echo + 1..lines.len()).filter(|line| lines[*line].starts_with("[PRB")).nth(3).expect("an answer");
    let without: Vec<String> = lines
        .iter()
        .enumerate()
        .filter(|(line, _)| ![echo, answer].contains(line))
        .map(|(_, line)| line.clone())
        .collect();
    let error = read(4, &text(&without), &run.plan(), &ACCEPTED).expect_err("it is out of step").to_string();
    assert!(error.contains("confirmed") && error.contains("another number of lines"), "{error}");
    // A host that shows no confirmations cannot tell.
    let silent: Vec<String> = without.into_iter().filter(|line| line != "ok").collect();
    assert!(read(4, &text(&silent), &run.plan(), &ACCEPTED).is_ok());
}
