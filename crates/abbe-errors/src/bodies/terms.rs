//! What a body does to the frame that it carries.

use abbe_core::{PathItem, Quantity, Result, SettingsError, Unit};
use abbe_thermal::{Beam, Segment, TemperaturePlane};

use super::geometry::{Vector, cross, difference, directions, dot, sum, times};
use super::temperatures::Temperatures;
use super::{Body, BodyKind};
use crate::families::{Argument, Functions, Term};
use crate::log::key;

/// Where the errors of a body act.
#[derive(Debug, Clone, PartialEq)]
pub struct Mount {
    /// The point that rotations of the frame turn about, machine coordinates with all axes at zero, mm; for the tool one for each stylus.
    pub origins: Vec<[f64; 3]>,
    /// The axis whose command decides which part of the body counts; none if it stands still.
    pub guide: Option<Guide>,
}

/// An axis that a body guides or measures, or that moves it.
#[derive(Debug, Clone, PartialEq)]
pub struct Guide {
    /// Its name.
    pub axis: String,
    /// Movement of what it carries for a command of 1 mm, machine frame.
    pub along: [f64; 3],
    /// Motion errors act in the frame that moves with the axis.
    pub moving: bool,
}

/// Parts of a section's plane for 1 K at one sensor: its index, and temperature on the axis and both gradients.
type OfSensor = (usize, TemperaturePlane);

/// Commands may be beyond the end of a body by this part of its length, and are then taken as its end.
const BEYOND: f64 = 0.01;

/// Largest sine of the angle between a body and its axis.
const PARALLEL: f64 = 1e-6;

/// What counts of a body.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Reach {
    /// Its end, seen from where it is held.
    Held,
    /// Its end, seen from its guide, which is at `at_zero + rate * command`.
    Slides,
    /// The carriage on it.
    Guideway,
    /// The mark under the reading head: +1, or -1 if the scale moves.
    Scale(f64),
}

/// Shift and rotation of a frame.
#[derive(Debug, Clone, Copy, Default)]
struct Twist {
    shift: Vector,
    turn: Vector,
}

impl Twist {
    /// ex, ey, ez, ea, eb, ec.
    fn six(self) -> [f64; 6] {
        let Self { shift, turn } = self;
        [shift[0], shift[1], shift[2], turn[0], turn[1], turn[2]]
    }
}

/// The six errors of a frame that follow the temperatures of a body, in the unit of memory; the coefficient of all of them is the factor
/// of the body. They are zero where a temperature is not known.
#[derive(Debug)]
pub struct BodyTerms {
    beam: Beam,
    sections: Vec<Vec<OfSensor>>,
    directions: [Vector; 3],
    begin: Vector,
    held: f64,
    at_zero: f64,
    /// mm on the body for a command of 1 mm.
    rate: f64,
    reach: Reach,
    mount: Mount,
    /// From the guideway to the line of the scale.
    to_scale: Vector,
    temperatures: Temperatures,
    /// Relative uncertainty of the coefficient of expansion.
    uncertainty: f64,
}

impl BodyTerms {
    /// The errors of a body whose settings are checked, at a frame.
    ///
    /// `range` is the travel of the axis that guides it, mm; `labels` are those of the series of its logs. Fails for a body that is not parallel to this axis, for a travel beyond its
    /// ends, and for logs that are wrong.
    pub fn new(body: &Body, mount: Mount, range: Option<[f64; 2]>, labels: &[String]) -> Result<Self, SettingsError> {
        let (beam, sections) = beam(body)?;
        let along = body.direction();
        let reach = match (body.kind()?, body.slides) {
            (BodyKind::Between(..), false) => Reach::Held,
            (BodyKind::Between(..), true) => Reach::Slides,
            (BodyKind::Guideway(_), _) => Reach::Guideway,
            (BodyKind::Scale(_), slides) => Reach::Scale(if slides { -1.0 } else { 1.0 }),
        };
        let mut rate = 0.0;
        if let Some(guide) = &mount.guide {
            let cosine = dot(guide.along, along);
            if cosine.abs() < 1.0 - 0.5 * PARALLEL * PARALLEL {
                let message = format!("the body is not parallel to the axis {}, which it has to be", guide.axis);
                return Err(SettingsError::new("end_mm", message));
            }
            let moves = if body.slides { -1.0 } else { 1.0 };
            rate = moves * cosine.signum();
        }
        let at_zero = body.at_zero_mm.unwrap_or(0.0);
        let on_guideway = sum(body.begin_mm, times(along, at_zero));
        let found = Self {
            held: body.held_at_mm.clamp(0.0, beam.length()),
            beam,
            sections,
            directions: directions(along),
            begin: body.begin_mm,
            at_zero,
            rate,
            reach,
            mount,
            to_scale: body.scale_point_mm.map_or([0.0; 3], |point| difference(point, on_guideway)),
            temperatures: Temperatures::new(body, labels)?,
            uncertainty: body.standard_uncertainty_per_K.unwrap_or(0.0) / body.expansion_per_K.abs(),
        };
        let ends = range.filter(|_| found.mount.guide.is_some()).unwrap_or_default();
        match ends.iter().find(|end| found.beyond(**end)) {
            None => Ok(found),
            Some(end) => Err(SettingsError::new("at_zero_mm", found.too_far(*end))
                .help("lengthen the body, or say where on it the axis is at zero")),
        }
    }

    /// Relative standard uncertainty of the coefficient of expansion.
    pub fn relative_uncertainty(&self) -> f64 {
        self.uncertainty
    }

    /// Which of the errors ex, ey, ez, ea, eb, ec may differ from zero.
    pub fn components(&self) -> [bool; 6] {
        let [along, ..] = self.directions;
        std::array::from_fn(|component| match (self.reach, component) {
            (Reach::Scale(_), 0..3) => along[component].abs() > 1e-12,
            (Reach::Scale(_), _) => false,
            (_, 0..3) => true,
            // A body along an axis of the machine has no roll about it.
            _ => along[component - 3].abs() < 1.0 - 1e-12,
        })
    }

    fn beyond(&self, command: f64) -> bool {
        let place = self.at_zero + self.rate * command;
        let allowed = BEYOND * self.beam.length();
        self.mount.guide.is_some() && (place < -allowed || place > self.beam.length() + allowed)
    }

    fn too_far(&self, command: f64) -> String {
        let axis = self.mount.guide.as_ref().map_or("", |guide| guide.axis.as_str());
        let place = self.at_zero + self.rate * command;
        let length = self.beam.length();
        format!(
            "with {axis} at {command:.3} mm the place {place:.3} mm of the body counts, which is only {length:.3} mm long"
        )
    }

    /// The place of an argument, if it is there.
    fn command(&self) -> Option<usize> {
        self.mount.guide.as_ref().map(|_| 0)
    }

    fn time(&self) -> Option<usize> {
        self.temperatures.by_time().then(|| self.command().map_or(0, |_| 1))
    }

    fn series(&self) -> Option<usize> {
        self.temperatures.series().and_then(|_| self.time()).map(|place| place + 1)
    }

    fn stylus(&self) -> Option<usize> {
        let before = [self.command(), self.time(), self.series()].into_iter().flatten().count();
        (self.mount.origins.len() > 1).then_some(before)
    }

    /// The place of the first temperature among the arguments.
    fn first(&self) -> usize {
        [self.command(), self.time(), self.series(), self.stylus()].into_iter().flatten().count()
    }

    fn elevations(&self, arguments: &[f64]) -> Option<Vec<f64>> {
        let [time, label] = [self.time(), self.series()].map(|place| place.map(|place| arguments[place]));
        self.temperatures.at(time, label, &arguments[self.first()..])
    }

    /// The planes of the sections for elevations of the sensors.
    fn planes(&self, elevations: &[f64]) -> Vec<TemperaturePlane> {
        let of_section = |sensors: &Vec<OfSensor>| {
            sensors.iter().fold(TemperaturePlane::default(), |sum, (sensor, part)| TemperaturePlane {
                on_axis: sum.on_axis + elevations[*sensor] * part.on_axis,
                along_y: sum.along_y + elevations[*sensor] * part.along_y,
                along_z: sum.along_z + elevations[*sensor] * part.along_z,
            })
        };
        self.sections.iter().map(of_section).collect()
    }

    /// What is seen and from where, on the body.
    fn places(&self, command: f64) -> (f64, f64) {
        let place = (self.at_zero + self.rate * command).clamp(0.0, self.beam.length());
        match self.reach {
            Reach::Held => (self.beam.length(), self.held),
            Reach::Slides => (self.beam.length(), place),
            Reach::Guideway | Reach::Scale(_) => (place, self.held),
        }
    }

    /// The twist in the directions of the body at the point where it acts.
    fn twist(&self, planes: &[TemperaturePlane], command: f64) -> Result<Twist> {
        let (seen, from) = self.places(command);
        let (there, here) = (self.beam.at(planes, seen)?, self.beam.at(planes, from)?);
        let lever = seen - from;
        // Elongation is that of the scale, wherever the body is guided.
        let fixed = if self.reach == Reach::Slides { self.beam.at(planes, self.held)? } else { here };
        Ok(self.what_counts(Twist {
            shift: [
                there.elongation - fixed.elongation,
                there.deflection_y - here.deflection_y - here.rotation_z * lever,
                there.deflection_z - here.deflection_z + here.rotation_y * lever,
            ],
            turn: [0.0, there.rotation_y - here.rotation_y, there.rotation_z - here.rotation_z],
        }))
    }

    /// How the twist changes with the command.
    fn twist_slope(&self, planes: &[TemperaturePlane], command: f64) -> Result<Twist> {
        let (seen, from) = self.places(command);
        let lever = seen - from;
        let slope = match self.reach {
            Reach::Held => Twist::default(),
            Reach::Slides => {
                let change = self.beam.slope_at(planes, from)?;
                Twist {
                    shift: [0.0, -change.rotation_z * lever, change.rotation_y * lever],
                    turn: [0.0, -change.rotation_y, -change.rotation_z],
                }
            }
            Reach::Guideway | Reach::Scale(_) => {
                let (change, here) = (self.beam.slope_at(planes, seen)?, self.beam.at(planes, from)?);
                Twist {
                    shift: [
                        change.elongation,
                        change.deflection_y - here.rotation_z,
                        change.deflection_z + here.rotation_y,
                    ],
                    turn: [0.0, change.rotation_y, change.rotation_z],
                }
            }
        };
        let Twist { shift, turn } = self.what_counts(slope);
        Ok(Twist { shift: times(shift, self.rate), turn: times(turn, self.rate) })
    }

    /// The part of a twist that a guideway or a scale says.
    fn what_counts(&self, Twist { shift, turn }: Twist) -> Twist {
        match self.reach {
            Reach::Held | Reach::Slides => Twist { shift, turn },
            Reach::Guideway => Twist { shift: [0.0, shift[1], shift[2]], turn },
            Reach::Scale(sign) => Twist { shift: [sign * shift[0], 0.0, 0.0], turn: [0.0; 3] },
        }
    }

    /// The point where the twist acts, to the origin of the frame.
    fn lever(&self, arguments: &[f64]) -> Option<Vector> {
        let stylus = self.stylus().map_or(0, |place| arguments[place] as usize);
        let origin = *self.mount.origins.get(stylus)?;
        let place = match self.reach {
            Reach::Guideway if self.is_left_behind() => self.at_zero + self.rate * self.command_of(arguments),
            // A frame that moves goes with the carriage.
            Reach::Guideway => self.at_zero,
            _ => self.beam.length(),
        };
        Some(difference(origin, sum(self.begin, times(self.directions[0], place))))
    }

    /// Motion errors act in a frame that does not go with the carriage.
    fn is_left_behind(&self) -> bool {
        self.mount.guide.as_ref().is_some_and(|guide| !guide.moving)
    }

    fn command_of(&self, arguments: &[f64]) -> f64 {
        self.command().map_or(0.0, |place| arguments[place])
    }

    /// Shift and rotation of the frame at its origin.
    fn at_origin(&self, twist: Twist, lever: Vector) -> Twist {
        let by_scale = times(self.directions[0], -dot(self.directions[0], cross(twist.turn, self.to_scale)));
        Twist { shift: sum(sum(twist.shift, cross(twist.turn, lever)), by_scale), turn: twist.turn }
    }

    /// The errors at the frame.
    fn errors(&self, elevations: &[f64], arguments: &[f64]) -> Option<Twist> {
        let twist = self.twist(&self.planes(elevations), self.command_of(arguments)).ok()?;
        Some(self.at_origin(self.to_machine(twist), self.lever(arguments)?))
    }

    /// How the errors change with the command.
    fn errors_slope(&self, elevations: &[f64], arguments: &[f64]) -> Option<Twist> {
        let (planes, command) = (self.planes(elevations), self.command_of(arguments));
        let slope = self.to_machine(self.twist_slope(&planes, command).ok()?);
        let mut found = self.at_origin(slope, self.lever(arguments)?);
        if self.reach == Reach::Guideway && self.is_left_behind() {
            let turn = self.to_machine(self.twist(&planes, command).ok()?).turn;
            found.shift = sum(found.shift, times(cross(turn, self.directions[0]), -self.rate));
        }
        Some(found)
    }

    fn to_machine(&self, twist: Twist) -> Twist {
        let seen = |vector: Vector| {
            let parts = vector.iter().zip(self.directions);
            parts.fold([0.0; 3], |total, (part, direction)| sum(total, times(direction, *part)))
        };
        Twist { shift: seen(twist.shift), turn: seen(twist.turn) }
    }
}

/// The beam of a body, and the sensors of its sections; at ends without a section are those of the nearest one.
fn beam(body: &Body) -> Result<(Beam, Vec<Vec<OfSensor>>), SettingsError> {
    let (length, names) = (body.length(), body.sensors());
    let [_, y, z] = directions(body.direction());
    let mut sections = Vec::new();
    for (index, section) in body.sections.iter().enumerate() {
        let mut sensors = Vec::new();
        let places: Vec<[f64; 2]> = section.sensors.values().map(|place| [dot(*place, y), dot(*place, z)]).collect();
        for (sensor, name) in section.sensors.keys().enumerate() {
            let one = |(place, [y, z]): (usize, &[f64; 2])| [*y, *z, f64::from(u8::from(place == sensor))];
            let unit: Vec<[f64; 3]> = places.iter().enumerate().map(one).collect();
            let at = [key("sections"), PathItem::Index(index), key("sensors")];
            let plane = TemperaturePlane::through(&unit);
            let (plane, _) = plane.map_err(|error| SettingsError::new("", error.message).under(at))?;
            sensors.extend(names.iter().position(|other| other == name).map(|sensor| (sensor, plane)));
        }
        sections.push(sensors);
    }
    let mut segments = Vec::new();
    let mut expansion = body.expansion_per_K;
    let mut last = 0.0;
    for (index, section) in body.sections.iter().enumerate() {
        if section.at_mm - last > 1e-9 {
            segments.push(Segment { length: section.at_mm - last, expansion });
            if index == 0 {
                sections.insert(0, sections[0].clone());
            }
        }
        last = section.at_mm;
        if index + 1 < body.sections.len() {
            expansion = section.expansion_per_K.unwrap_or(body.expansion_per_K);
        }
    }
    if length - last > 1e-9 {
        segments.push(Segment { length: length - last, expansion });
        sections.extend(sections.last().cloned());
    }
    let beam = Beam::new(segments).map_err(|error| SettingsError::new("sections", error.message))?;
    Ok((beam, sections))
}

impl Functions for BodyTerms {
    fn arguments(&self) -> Vec<Argument> {
        let command = self.mount.guide.as_ref().map(|guide| Argument::CommandOf(guide.axis.clone()));
        let time = self.time().map(|_| Argument::Time);
        let series = self.series().and_then(|_| self.temperatures.series().cloned()).map(Argument::Series);
        let stylus = self.stylus().map(|_| Argument::Stylus);
        let of_rows = self.temperatures.of_rows.iter().map(|name| Argument::Temperature(name.clone()));
        command.into_iter().chain(time).chain(series).chain(stylus).chain(of_rows).collect()
    }

    fn terms(&self) -> Vec<Term> {
        let unit = Unit::of(Quantity::Ratio);
        let term = |name: &&str| Term { unit: Some(unit), ..Term::new(format!("[{name}]"), 0) };
        ["ex", "ey", "ez", "ea", "eb", "ec"].iter().map(term).collect()
    }

    fn values(&self, arguments: &[f64], out: &mut [f64]) {
        let found = self.elevations(arguments).and_then(|elevations| self.errors(&elevations, arguments));
        out.copy_from_slice(&found.unwrap_or_default().six());
    }

    fn slopes(&self, by: usize, arguments: &[f64], out: &mut [f64]) {
        out.fill(0.0);
        let Some(elevations) = self.elevations(arguments) else { return };
        let found = match by.checked_sub(self.first()) {
            Some(place) => self.errors(&self.temperatures.slope(place), arguments),
            None if Some(by) == self.command() => self.errors_slope(&elevations, arguments),
            None => None,
        };
        out.copy_from_slice(&found.unwrap_or_default().six());
    }

    fn nominal(&self) -> f64 {
        1.0
    }

    fn nominal_uncertainty(&self) -> f64 {
        self.uncertainty
    }

    fn refused(&self, arguments: &[f64]) -> Option<String> {
        let command = self.command().map(|place| arguments[place]).filter(|command| self.beyond(*command));
        let label = self.series().map(|place| arguments[place]);
        let by_time = || self.time().and_then(|place| self.temperatures.refused(arguments[place], label));
        command.map(|command| self.too_far(command)).or_else(by_time)
    }
}
