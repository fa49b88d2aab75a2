//! An independent reading of the programs that are written for controllers: the subset of two languages that they use, and a
//! virtual machine with a probe. What is not known is refused.

pub mod expression;
pub mod fanuc;
pub mod siemens;

use std::collections::BTreeMap;

/// Numbers by the name of an axis.
pub type ByAxis = BTreeMap<String, f64>;

/// Something that triggers the probe: a row of a data file.
#[derive(Debug, Clone)]
pub struct Surface {
    pub label: String,
    pub axis: String,
    pub sense: f64,
    /// Where all other axes stand.
    pub others: ByAxis,
    /// From which side they came.
    pub directions: ByAxis,
    /// Where the probing axis triggers; the first probing of the point, then all others.
    pub readings: [f64; 2],
}

/// How a program ended.
#[derive(Debug, Clone, PartialEq)]
pub enum End {
    Done,
    Alarm(u32, String),
}

/// A machine with a probe.
pub struct Machine {
    pub positions: ByAxis,
    directions: ByAxis,
    pub surfaces: Vec<Surface>,
    /// The height from which other axes may move in rapid.
    pub retract: f64,
    /// Labels in the order of probing.
    pub probed: Vec<String>,
    pub messages: Vec<String>,
}

const NEAR: f64 = 1e-3;

impl Machine {
    pub fn new(surfaces: Vec<Surface>, retract: f64) -> Self {
        let axes: Vec<String> =
            surfaces.iter().flat_map(|surface| surface.others.keys().chain([&surface.axis]).cloned()).collect();
        // Somewhere that no point is.
        let positions = axes.into_iter().map(|axis| (axis, 7.5)).collect();
        let (directions, probed, messages) = (ByAxis::new(), Vec::new(), Vec::new());
        Self { positions, directions, surfaces, retract, probed, messages }
    }

    pub fn at(&self, axis: &str) -> Result<f64, String> {
        self.positions.get(axis).copied().ok_or_else(|| format!("the machine has no axis {axis}"))
    }

    fn go(&mut self, axis: &str, to: f64) -> Result<(), String> {
        let from = self.at(axis)?;
        if to != from {
            self.directions.insert(axis.to_owned(), (to - from).signum());
            self.positions.insert(axis.to_owned(), to);
        }
        Ok(())
    }

    /// A rapid move: Z alone upwards, or everything else at retract height.
    pub fn rapid(&mut self, target: &ByAxis) -> Result<(), String> {
        for (axis, &to) in target {
            if axis == "Z" && (target.len() > 1 || to < self.at("Z")?.min(self.retract)) {
                return Err(format!("rapid downwards or sideways with Z: {target:?}"));
            }
            if axis != "Z" && self.at("Z")? < self.retract {
                return Err(format!("rapid below the retract height: {target:?}"));
            }
        }
        target.iter().try_for_each(|(axis, &to)| self.go(axis, to))
    }

    /// A move in feed without an eye on the probe: back from contact only.
    pub fn feed(&mut self, target: &ByAxis) -> Result<(), String> {
        let [(axis, &to)] = target.iter().collect::<Vec<_>>()[..] else {
            return Err(format!("one axis was expected: {target:?}"));
        };
        let away = (to - self.at(axis)?).signum();
        if self.directions.get(axis).is_none_or(|direction| *direction * away > 0.0) && away != 0.0 {
            return Err(format!("feed towards something: {axis} to {to}"));
        }
        self.go(axis, to)
    }

    /// A move that ends where the probe triggers, or at its end; whether it triggered.
    pub fn probe(&mut self, target: &ByAxis) -> Result<bool, String> {
        let [(axis, &to)] = target.iter().collect::<Vec<_>>()[..] else {
            return Err(format!("one axis was expected: {target:?}"));
        };
        let from = self.at(axis)?;
        let sense = (to - from).signum();
        let near = |one: f64, other: f64| (one - other).abs() < NEAR;
        let found = self.surfaces.iter().position(|surface| {
            let there = |(axis, at): (&String, &f64)| self.positions.get(axis).is_some_and(|here| near(*here, *at));
            let came = |(axis, from): (&String, &f64)| self.directions.get(axis) == Some(from);
            surface.axis == *axis
                && surface.sense == sense
                && surface.others.iter().all(there)
                && surface.directions.iter().all(came)
        });
        let Some(found) = found else {
            self.go(axis, to)?;
            return Ok(false);
        };
        let surface = &mut self.surfaces[found];
        let reading = surface.readings[0];
        if (reading - from) * sense < 0.0 || (to - reading) * sense < 0.0 {
            // Behind the start, or out of reach.
            self.go(axis, to)?;
            return Ok(false);
        }
        surface.readings[0] = surface.readings[1];
        let label = surface.label.clone();
        self.probed.push(label);
        self.go(axis, reading)?;
        Ok(true)
    }
}

#[test]
fn what_is_not_known_is_refused() {
    let machine = || Machine::new(Vec::new(), 0.0);
    for line in [
        "G2 X1.",
        "#100=SIN[30]",
        "IF [#1 EQ 2] GOTO 1",
        "GOTO 5",
        "WHILE [#1 LT 2] DO1",
        "POPEN",
        "G31 X1.",
        "#100=1 2",
    ] {
        assert!(fanuc::run(line, &mut BTreeMap::new(), &mut machine()).is_err(), "{line}");
    }
    for line in [
        "G2 SUPA X=1",
        "G0 X=1",
        "R1=SIN(30)",
        "IF R1==2",
        "ENDIF",
        "CYCLE997()",
        "R1=1 2",
        "UNKNOWN=1",
        "R1=$AC_MEA[1]",
    ] {
        assert!(siemens::run(line, &mut BTreeMap::new(), &mut machine()).is_err(), "{line}");
    }
}

#[test]
fn expressions_have_their_values() {
    let mut variables = BTreeMap::new();
    let mut machine = Machine::new(Vec::new(), 0.0);
    let program = "#100=2+3*4\n#101=[2+3]*4\n#102=ABS[#100-20]\n#103=-1.5\nIF [#100 LT [#101-5]] THEN #104=7\nIF [#100 GE #101] THEN #105=7\nM30";
    assert_eq!(fanuc::run(program, &mut variables, &mut machine), Ok(End::Done));
    assert_eq!(variables, [(100, 14.0), (101, 20.0), (102, 6.0), (103, -1.5), (104, 7.0)].into());
    let mut variables = BTreeMap::new();
    let program = "DEF INT _A=1\nWHILE _A<4\n_A=_A+1\nR7=R7+_A\nENDWHILE\nIF R7>=(10-1)\nR8=2*(3-1)\nENDIF\nIF R7<9\nR9=1\nENDIF\nM30";
    assert_eq!(siemens::run(program, &mut variables, &mut machine), Ok(End::Done));
    assert_eq!(variables, [(7, 9.0), (8, 4.0)].into());
}
