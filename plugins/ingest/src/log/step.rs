//! Whether the answers of a control that reads lines ahead belong to the moves that they are taken for: the control confirms every line
//! by `ok`, in the order of sending, and answers a probing move before it confirms it. So the confirmations before an answer are as
//! many as the lines before its move.

/// How many lines a host has shown that it sent.
#[derive(Debug, Clone, Copy, Default)]
pub struct Sent {
    /// Lines that a control confirms.
    lines: i64,
    /// Those that are comments alone: some hosts do not send them.
    comments: i64,
    /// Pauses (M0): some hosts make them by themselves.
    pauses: usize,
}

/// An answer and the confirmations before it, beside the lines that were sent before its move: how many more they are.
#[derive(Debug, Clone, Copy)]
struct Answer {
    line: usize,
    confirmed: i64,
    /// Without comments, and with them.
    ahead: [i64; 2],
    pauses: usize,
}

/// The answers of a run, and the confirmations so far.
#[derive(Debug, Default)]
pub struct Steps {
    sent: Sent,
    confirmed: i64,
    answers: Vec<Answer>,
}

impl Steps {
    /// The lines so far.
    pub fn sent(&self) -> Sent {
        self.sent
    }

    /// A line with words was sent.
    pub fn line(&mut self, is_pause: bool) {
        self.sent.lines += 1;
        self.sent.pauses += usize::from(is_pause);
    }

    /// A line with nothing but a comment was sent.
    pub fn comment(&mut self) {
        self.sent.comments += 1;
    }

    /// The control has confirmed so many lines.
    pub fn confirm(&mut self, lines: usize) {
        self.confirmed += lines as i64;
    }

    /// The answer to a move before which this was sent.
    pub fn answer(&mut self, line: usize, before: Sent) {
        let ahead = [before.lines, before.lines + before.comments].map(|sent| self.confirmed - sent);
        self.answers.push(Answer { line, confirmed: self.confirmed, ahead, pauses: before.pauses });
    }

    /// The line of the first answer that is out of step with the one before it, and how many lines were confirmed since then. None if
    /// the host does not show confirmations.
    pub fn out_of_step(&self) -> Option<(usize, i64)> {
        let (first, last) = (self.answers.first()?, self.answers.last()?);
        if first.confirmed == last.confirmed {
            return None;
        }
        let wrong = |way: usize| {
            let mut pairs = self.answers.windows(2).filter(|pair| pair[0].pauses == pair[1].pauses);
            pairs.find(|pair| pair[0].ahead[way] != pair[1].ahead[way])
        };
        let (without, with) = (wrong(0)?, wrong(1)?);
        let later = if without[1].line > with[1].line { without } else { with };
        Some((later[1].line, later[1].confirmed - later[0].confirmed))
    }
}
