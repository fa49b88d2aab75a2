//! The baseline and the verify program, independent of any controller: logic and motion are written here once, and each
//! controller translates them into its language.

/// A variable of the programs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Variable {
    /// The tolerance that the baseline was made with, mm.
    Tolerance,
    /// First reading of the baseline at a point (from 0).
    Value(usize),
    /// Smallest admissible reading.
    Min(usize),
    /// Largest admissible reading.
    Max(usize),
    /// Number of baseline runs that are stored.
    Runs,
    /// Points out of tolerance in the last verify run.
    Out,
    /// Number (from 1) of the first point that was out.
    FirstOut,
    /// Reading of the last probing.
    Measured,
    /// Whether it touched: 1 or 0.
    Touched,
    /// Probings of a point so far.
    Attempts,
    /// Whether the point is out: 1 or 0.
    IsOut,
    /// Whether this is the first run of the baseline: 1 or 0.
    IsFirst,
}

/// Something that has a value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Value {
    /// A number.
    Number(f64),
    /// A variable.
    Of(Variable),
    /// The sum of a variable and another.
    Sum(Variable, Variable),
    /// A variable plus one.
    Next(Variable),
    /// The difference of two variables.
    Difference(Variable, Variable),
}

/// `variable < value` or the opposite. There is no equality: on some controllers a variable that was never set equals nothing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Condition {
    /// The variable is smaller.
    Less(Variable, Value),
    /// It is not.
    NotLess(Variable, Value),
}

impl Condition {
    /// The opposite.
    pub fn opposite(self) -> Self {
        match self {
            Self::Less(variable, value) => Self::NotLess(variable, value),
            Self::NotLess(variable, value) => Self::Less(variable, value),
        }
    }
}

/// Positions of axes by name: mm, and degrees of rotary axes.
pub type Target = Vec<(String, f64)>;

/// The alarms, by number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// A verify run found points out of tolerance.
    NoGo,
    /// There is no baseline.
    NoBaseline,
    /// The stored baseline was made with another tolerance.
    OtherTolerance,
    /// The probe triggered where nothing should be.
    Obstacle,
    /// Nothing was touched in the baseline.
    NoContact,
    /// Work coordinates are not those of the machine.
    WorkOffset,
}

impl Fault {
    /// Its number after the first alarm number.
    pub fn number(self) -> u32 {
        self as u32
    }
}

/// A step of a program.
#[derive(Debug, Clone, PartialEq)]
pub enum Step {
    /// For people who read the program.
    Comment(String),
    /// A variable gets a value.
    Set(Variable, Value),
    /// Steps under a condition.
    If(Condition, Vec<Step>),
    /// Steps as long as a condition holds.
    While(Condition, Vec<Step>),
    /// Rapid motion where nothing is in the way, machine coordinates.
    Rapid(Target),
    /// Motion in feed that watches the probe: it stops at an obstacle, with an alarm.
    Guarded(String, f64),
    /// Motion in feed away from contact, one axis.
    Back(String, f64),
    /// Probing along an axis as far as this; sets [`Variable::Measured`] and [`Variable::Touched`].
    Probe(String, f64),
    /// Stops the program.
    Alarm(Fault, String),
    /// Shows a message without stopping.
    Message(String),
    /// Shows a message and waits until the operator confirms it.
    Stop(String),
}

/// A point as the program probes it, machine coordinates.
#[derive(Debug, Clone, PartialEq)]
pub struct Stop {
    /// Its label.
    pub label: String,
    /// The axis that probes.
    pub axis: String,
    /// Where probing begins and where it gives up.
    pub start: f64,
    /// Where it gives up.
    pub end: f64,
    /// Rapid moves at retract height: rotary axes first.
    pub positioning: Vec<Target>,
    /// Where the retract axis is lowered to.
    pub lowered: f64,
}

/// All that the programs need.
#[derive(Debug, Clone, PartialEq)]
pub struct Programme {
    /// The points in the order in which they are probed.
    pub stops: Vec<Stop>,
    /// The axis that retracts, and where it is then.
    pub retract: (String, f64),
    /// Tolerance, mm.
    pub tolerance: f64,
}

/// Tolerances closer than this are one, mm.
const SAME: f64 = 1e-5;

impl Programme {
    fn approach(&self, stop: &Stop) -> Vec<Step> {
        let mut steps: Vec<Step> = stop.positioning.iter().cloned().map(Step::Rapid).collect();
        steps.push(Step::Guarded(self.retract.0.clone(), stop.lowered));
        steps
    }

    fn retract(&self) -> Step {
        Step::Rapid(vec![self.retract.clone()])
    }

    /// Refuses a tolerance that is not the stored one.
    fn same_tolerance(&self) -> Vec<Step> {
        let alarm = || vec![Step::Alarm(Fault::OtherTolerance, "other tolerance stored".to_owned())];
        vec![
            Step::If(Condition::Less(Variable::Tolerance, Value::Number(self.tolerance - SAME)), alarm()),
            Step::If(Condition::NotLess(Variable::Tolerance, Value::Number(self.tolerance + SAME)), alarm()),
        ]
    }

    fn title(stop: &Stop) -> Step {
        let sign = if stop.end > stop.start { '+' } else { '-' };
        Step::Comment(format!("point {} approach {sign}{}", stop.label, stop.axis))
    }

    /// The baseline: stores what each point reads with its limits; run again, it widens the limits to all that was read.
    pub fn baseline(&self) -> Vec<Step> {
        use Variable::{IsFirst, Max, Measured, Min, Runs, Tolerance, Touched, Value as Stored};
        let mut steps = vec![
            Step::Comment("run once after calibration, and again to widen the limits to what repeats".to_owned()),
            Step::Comment("to begin anew set the number of baseline runs to 0".to_owned()),
            Step::Set(IsFirst, Value::Number(1.0)),
            Step::If(Condition::NotLess(Runs, Value::Number(1.0)), vec![Step::Set(IsFirst, Value::Number(0.0))]),
            Step::If(Condition::Less(IsFirst, Value::Number(1.0)), self.same_tolerance()),
            Step::Set(Tolerance, Value::Number(self.tolerance)),
            self.retract(),
        ];
        for (index, stop) in self.stops.iter().enumerate() {
            let (min, max) = (Min(index), Max(index));
            steps.push(Self::title(stop));
            steps.extend(self.approach(stop));
            steps.push(Step::Probe(stop.axis.clone(), stop.end));
            steps.push(Step::Back(stop.axis.clone(), stop.start));
            steps.push(self.retract());
            let alarm = Step::Alarm(Fault::NoContact, format!("no contact at {}", stop.label));
            steps.push(Step::If(Condition::Less(Touched, Value::Number(1.0)), vec![alarm]));
            let lower = Value::Difference(Measured, Tolerance);
            let upper = Value::Sum(Measured, Tolerance);
            steps.push(Step::If(
                Condition::NotLess(IsFirst, Value::Number(1.0)),
                vec![Step::Set(Stored(index), Value::Of(Measured)), Step::Set(min, lower), Step::Set(max, upper)],
            ));
            steps.push(Step::If(Condition::NotLess(min, lower), vec![Step::Set(min, lower)]));
            steps.push(Step::If(Condition::Less(max, upper), vec![Step::Set(max, upper)]));
        }
        steps
            .push(Step::If(Condition::NotLess(IsFirst, Value::Number(1.0)), vec![Step::Set(Runs, Value::Number(0.0))]));
        steps.push(Step::Set(Runs, Value::Next(Runs)));
        steps.push(Step::Stop("baseline stored".to_owned()));
        steps
    }

    /// The verify program: go, or an alarm.
    pub fn verify(&self) -> Vec<Step> {
        use Variable::{Attempts, FirstOut, IsOut, Max, Measured, Min, Out, Runs, Touched};
        let alarm = Step::Alarm(Fault::NoBaseline, "no baseline stored".to_owned());
        let mut steps = vec![
            Step::Comment("run before a critical cut".to_owned()),
            Step::If(Condition::Less(Runs, Value::Number(1.0)), vec![alarm]),
        ];
        steps.extend(self.same_tolerance());
        steps.extend([Step::Set(Out, Value::Number(0.0)), Step::Set(FirstOut, Value::Number(0.0)), self.retract()]);
        for (index, stop) in self.stops.iter().enumerate() {
            steps.push(Self::title(stop));
            steps.extend(self.approach(stop));
            let inside = vec![Step::Set(IsOut, Value::Number(0.0)), Step::Set(Attempts, Value::Number(2.0))];
            let below = Step::If(Condition::NotLess(Max(index), Value::Of(Measured)), inside);
            let within = Step::If(Condition::NotLess(Measured, Value::Of(Min(index))), vec![below]);
            let again = Step::Message(format!("{} out of tolerance: clean probe and artefact", stop.label));
            let attempt = vec![
                Step::Probe(stop.axis.clone(), stop.end),
                Step::Back(stop.axis.clone(), stop.start),
                Step::Set(Attempts, Value::Next(Attempts)),
                Step::Set(IsOut, Value::Number(1.0)),
                Step::If(Condition::NotLess(Touched, Value::Number(1.0)), vec![within]),
                Step::If(Condition::NotLess(IsOut, Value::Number(1.0)), vec![again]),
            ];
            steps.push(Step::Set(Attempts, Value::Number(0.0)));
            steps.push(Step::Comment("a point that is out is probed once more".to_owned()));
            steps.push(Step::While(Condition::Less(Attempts, Value::Number(2.0)), attempt));
            steps.push(self.retract());
            let number = Value::Number((index + 1) as f64);
            let first = Step::If(Condition::Less(FirstOut, Value::Number(1.0)), vec![Step::Set(FirstOut, number)]);
            let count = vec![Step::Set(Out, Value::Next(Out)), first];
            steps.push(Step::If(Condition::NotLess(IsOut, Value::Number(1.0)), count));
        }
        let no_go = Step::Alarm(Fault::NoGo, "no-go, find the cause".to_owned());
        steps.push(Step::If(Condition::NotLess(Out, Value::Number(1.0)), vec![no_go]));
        steps.push(Step::Message("go".to_owned()));
        steps
    }
}
