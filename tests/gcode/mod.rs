//! An independent reading of the programs that are written for controllers: the subset of two languages that they use, and a
//! virtual machine with a probe. What is not known is refused. Rapid verification and programs that measure a plan run on the same
//! interpreters, each in its own world.

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

/// What a program can ask of a machine with a probe. Lengths are in the unit of the program.
pub trait World {
    /// Where an axis stands.
    fn place(&self, axis: &str) -> Result<f64, String>;
    /// So many millimetres are a unit of length from here on.
    fn unit(&mut self, millimetres: f64) -> Result<(), String>;
    fn rapid(&mut self, target: &ByAxis) -> Result<(), String>;
    /// A move without an eye on the probe.
    fn feed(&mut self, target: &ByAxis, feed: f64) -> Result<(), String>;
    /// A move that ends where the probe triggers, or at its end; whether it triggered.
    fn probe(&mut self, target: &ByAxis, feed: f64) -> Result<bool, String>;
    fn wait(&mut self, seconds: f64);
    /// What the clock of the control says, s.
    fn clock(&self) -> f64;
    fn message(&mut self, text: &str);
    /// A line of the log.
    fn log(&mut self, line: String) -> Result<(), String>;
}

/// A machine with a probe, for programs of rapid verification.
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

    fn at(&self, axis: &str) -> Result<f64, String> {
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
}

impl World for Machine {
    fn place(&self, axis: &str) -> Result<f64, String> {
        self.at(axis)
    }

    fn unit(&mut self, millimetres: f64) -> Result<(), String> {
        if millimetres == 1.0 { Ok(()) } else { Err("its variables are in millimetres".to_owned()) }
    }

    fn wait(&mut self, _: f64) {}

    fn clock(&self) -> f64 {
        0.0
    }

    fn message(&mut self, text: &str) {
        self.messages.push(text.to_owned());
    }

    fn log(&mut self, line: String) -> Result<(), String> {
        Err(format!("`{line}`: nothing takes down a log"))
    }

    /// A rapid move: Z alone upwards, or everything else at retract height.
    fn rapid(&mut self, target: &ByAxis) -> Result<(), String> {
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
    fn feed(&mut self, target: &ByAxis, _: f64) -> Result<(), String> {
        let [(axis, &to)] = target.iter().collect::<Vec<_>>()[..] else {
            return Err(format!("one axis was expected: {target:?}"));
        };
        let away = (to - self.at(axis)?).signum();
        if self.directions.get(axis).is_none_or(|direction| *direction * away > 0.0) && away != 0.0 {
            return Err(format!("feed towards something: {axis} to {to}"));
        }
        self.go(axis, to)
    }

    fn probe(&mut self, target: &ByAxis, _: f64) -> Result<bool, String> {
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
    let fanuc = |line: &str| fanuc::run(&format!("{line}\nM30"), &mut BTreeMap::new(), &mut machine());
    assert_eq!(fanuc("#100=1\nIF [#100 EQ 1] GOTO 2\nN2\n(A COMMENT)"), Ok(End::Done));
    for line in [
        "G2 X1.",
        "G0 X1",
        "G31 X1.",
        "G20",
        "#100=SIN[30]",
        "#100=1 2",
        "#200=1",
        "#100=#5061",
        "#3000=300(TEXT)",
        "#3000=1(Text)",
        "#3000=1(LONGER THAN TWENTY-SIX LETTERS)",
        "IF [#1 EQ 2] THEN #2=1",
        "IF [#1 NOT 2] THEN #2=1",
        "GOTO 5",
        "GOTO 5\nWHILE [1 LT 0] DO1\nN5\nEND1",
        "WHILE [#1 LT 2] DO1",
        "WHILE [#1 LT 2] DO1\nEND1",
        "END1",
        "DPRNT[X]",
        "POPEN",
        "POPEN\nDPRNT[X]\nPCLOS",
        "M99",
        "G65 P9999 A1.",
        "G65 P9999 A1.\nM30\nO9998(OTHER)\nM99",
        "O9997(MAIN)\nG65 P9999 A1\nM30\nO9999(OTHER)\nM99",
    ] {
        assert!(fanuc(line).is_err(), "{line}");
    }
    let siemens = |line: &str| siemens::run(&format!("{line}\nM30"), &mut BTreeMap::new(), &mut machine());
    assert_eq!(siemens("DEF INT _A=1\nIF _A>=1\nMSG(\"TEXT\")\nELSE\nUNKNOWN\nENDIF"), Ok(End::Done));
    for line in [
        "G2 SUPA X=1",
        "G0 X=1",
        "G1 SUPA X=1",
        "G700",
        "R1=SIN(30)",
        "R1=1 2",
        "UNKNOWN=1",
        "R1=$AC_MEA[1]",
        "IF R1==2\nENDIF",
        "IF R1<2",
        "ENDIF",
        "ELSE",
        "WHILE R1<2\nELSE\nENDWHILE",
        "LOOP\nENDLOOP",
        "CYCLE997()",
        "SETAL(100)",
        "MSG(TEXT)",
        "DEF INT R1=0",
        "G17\nDEF INT _A=0",
        "WRITE(_ERR,\"LOG\",\"TEXT\")",
        "DEF INT _ERR=0\nWRITE(_ERR,\"LOG\",\"TEXT\")",
        "M17",
        "EXTERN OTHER(INT)",
    ] {
        assert!(siemens(line).is_err(), "{line}");
    }
    let other = "PROC OTHER(INT _A,REAL _B)\nR1=_A+_B\nM17";
    let calls = |main: &str| {
        let programs = [("MAIN", format!("{main}\nM30")), ("OTHER", other.to_owned())];
        let programs = programs.map(|(name, text)| (name.to_owned(), text)).into();
        let mut parameters = BTreeMap::new();
        siemens::run_among(&programs, "MAIN", &mut parameters, &mut machine()).map(|_| parameters[&1])
    };
    assert_eq!(calls("EXTERN OTHER(INT,REAL)\nOTHER(2,1.5)"), Ok(3.5));
    for main in ["OTHER(2,1.5)", "EXTERN OTHER(INT)\nOTHER(2)", "EXTERN OTHER(INT,REAL)\nOTHER(2)", "OTHER"] {
        assert!(calls(main).is_err(), "{main}");
    }
}

/// A macro has variables of its own, and the skip position stays where the probe triggered.
#[test]
fn macros_have_their_own_variables_and_readings_stay() {
    let none = ByAxis::new;
    let (label, axis) = ("P".to_owned(), "Z".to_owned());
    let surface = Surface { label, axis, sense: -1.0, others: none(), directions: none(), readings: [2.0, 2.0] };
    let mut variables = BTreeMap::new();
    let mut machine = Machine::new(vec![surface.clone()], 5.0);
    let program = "%\nO9001(MAIN)\n#1=3\nG65 P9002 A2.5 Z1.0\n#101=#1+#2\n#102=#5063\nM30\nO9002(PROBES)\n\
                   #100=#1\n#2=7\nG31 Z#26 F100.0\nG1 Z[#5063+4.0] F100.0\n#103=#5023\nM99\n%";
    assert_eq!(fanuc::run(program, &mut variables, &mut machine), Ok(End::Done));
    assert_eq!(variables, [(100, 2.5), (101, 3.0), (102, 2.0), (103, 6.0)].into());
    let (mut parameters, mut machine) = (BTreeMap::new(), Machine::new(vec![surface], 5.0));
    let program = "MEAS=1 G1 SUPA Z=1 F100\nSTOPRE\nR2=$AC_MEA[1]\nG1 SUPA Z=IC(4) F100\nSTOPRE\n\
                   R0=$AA_MM[Z]\nR1=$AA_IM[Z]\nM30";
    assert_eq!(siemens::run(program, &mut parameters, &mut machine), Ok(End::Done));
    assert_eq!(parameters, [(0, 2.0), (1, 6.0), (2, 1.0)].into());
    let early = program.replacen("STOPRE\n", "", 1);
    assert!(siemens::run(&early, &mut parameters, &mut Machine::new(Vec::new(), 5.0)).is_err());
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
