//! The nominal points of an artefact, and the touch of one of them along a single axis.
//!
//! A touch is `n . (p - P) - d - r = 0` with the tip p, the nominal point P and the outward unit normal n in the table frame, the
//! offset d of the facet and the stylus radius r, solved for the command of the approach axis; all other axes stay where they
//! are (Muelaner et al. 2014, section 4.1).

use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};
use std::path::{Path, PathBuf};

use abbe_core::{
    Absent, Axis, AxisKind, ColumnHeader, DataRow, Dataset, Error, KinematicModel, PoseTable, Poses, Quantity, Result,
    StatusColumn, Values, Variable, plain_naming, pose_columns,
};
use nalgebra::{DMatrix, DVector, Vector3};

/// One nominal point.
#[derive(Debug, Clone, PartialEq)]
pub struct Point {
    /// Its label.
    pub label: String,
    /// The label of the facet that it lies on.
    pub facet: String,
    /// Nominal position, table frame, mm.
    pub position: Vector3<f64>,
    /// Outward unit normal of its facet, table frame.
    pub normal: Vector3<f64>,
    /// Name of the axis that moves until contact.
    pub axis: String,
    /// The sense in which it moves, +1 or -1.
    pub sense: f64,
}

/// The nominal file.
#[derive(Debug, Clone, PartialEq)]
pub struct Points {
    /// The points, in the order of the file.
    pub list: Vec<Point>,
    /// The whole file: rotary positions, directions, stylus, allowances.
    pub data: Dataset,
}

/// Columns that a nominal file needs.
const COLUMNS: [(&str, Quantity); 9] = [
    ("point", Quantity::Label),
    ("facet", Quantity::Label),
    ("x", Quantity::Length),
    ("y", Quantity::Length),
    ("z", Quantity::Length),
    ("nx", Quantity::Ratio),
    ("ny", Quantity::Ratio),
    ("nz", Quantity::Ratio),
    ("approach", Quantity::Label),
];

/// Checks the columns of a nominal file without reading its rows.
pub fn check_headers(path: &PathBuf) -> Result<Vec<ColumnHeader>> {
    let headers = abbe_table::read_headers(path)?;
    abbe_table::require(&headers, Some(path), &COLUMNS)?;
    Ok(headers)
}

impl Points {
    /// Reads a nominal file.
    pub fn read(path: &Path) -> Result<Self> {
        let data = abbe_table::read(path)?;
        abbe_table::unique_labels(&data, "point")?;
        let labels = abbe_table::labels(&data, "point")?;
        let facets = abbe_table::labels(&data, "facet")?;
        let approaches = abbe_table::labels(&data, "approach")?;
        let positions = abbe_table::points(&data, ["x", "y", "z"])?;
        let normals = abbe_table::vectors(&data, ["nx", "ny", "nz"])?;
        let mut list: Vec<Point> = Vec::new();
        for row in data.row_indices() {
            let (position, normal) = (Vector3::from(positions[row]), Vector3::from(normals[row]));
            // Files round their normals; one that is far from a unit vector is a mistake and not a rounding.
            if (normal.norm() - 1.0).abs() > 1e-2 {
                let message =
                    format!("the normal of point {} has length {:.4}; 1 was expected", labels[row], normal.norm());
                return Err(data.error_at(row, message).help("nx, ny, nz are the outward unit normal"));
            }
            let (axis, sense) = approach(&approaches[row]).map_err(|message| data.error_at(row, message))?;
            let (label, facet) = (labels[row].to_string(), facets[row].to_string());
            list.push(Point { label, facet, position, normal: normal.normalize(), axis, sense });
        }
        if list.is_empty() {
            return Err(Error::data("there is no point").in_file(path));
        }
        Ok(Self { list, data })
    }

    /// Indices by label.
    pub fn by_label(&self) -> BTreeMap<&str, usize> {
        self.list.iter().enumerate().map(|(index, point)| (point.label.as_str(), index)).collect()
    }

    /// The status of every point with its linear axes at zero: rotary axes, stylus and directions as the file has them.
    pub fn statuses(&self, model: &dyn KinematicModel) -> Result<PoseTable> {
        let file = self.data.files.first();
        let naming = |status: &StatusColumn, axis: Option<&Axis>| match axis {
            Some(axis) if axis.kind == AxisKind::Linear => (Vec::new(), Absent::Default(0.0)),
            _ => plain_naming(status, axis),
        };
        let columns = pose_columns(&self.data.headers(), file, model, &naming)?;
        let mut table = PoseTable::new(model);
        for row in self.data.row_indices() {
            table.push(&self.data, row, model, &columns)?;
        }
        Ok(table)
    }

    /// The status of every point in nominal contact of a machine without errors.
    pub fn in_contact(&self, model: &dyn KinematicModel) -> Result<PoseTable> {
        let mut table = self.statuses(model)?;
        for ((row, point), pose) in DataRow::enumerate(&self.list).zip(table.indices()) {
            axis_index(model, &point.axis).map_err(|message| self.data.error_at(row, message))?;
            let tip = point.position + model.info().stylus_radius * point.normal;
            if !reach(model, table.row_mut(pose), tip)? {
                let message = format!("the linear axes cannot bring the tip to point {}", point.label);
                return Err(self.data.error_at(row, message).help("is the chain that of this artefact's machine?"));
            }
            let touch = Touch::new(model, point, table.row(pose))?;
            self.check_approach(row, &touch)?;
        }
        Ok(table)
    }

    /// Fails, with the line of the nominal file, if it has another stylus or another axis of approach of a point, or other positions of
    /// rotary axes, than a row in which this point was touched.
    pub fn check_touched(
        &self,
        nominal: DataRow,
        model: &dyn KinematicModel,
        (data, row): (&Dataset, DataRow),
    ) -> Result<()> {
        let place =
            || data.origins[row].in_file(data.files.get(data.origins[row].file).map_or(Path::new(""), |file| file));
        let refuse = |what: &str, here: String, there: String| {
            let label = &self.list[nominal.0].label;
            let message = format!("point {label} has {what} {here} here, and was touched with {there} ({})", place());
            Err(self
                .data
                .error_at(nominal, message)
                .help("which one is right? Programs and directions are made of this file"))
        };
        for name in ["stylus", "approach"] {
            let [here, there] = [(&self.data, nominal), (data, row)].map(|(data, row)| label(data, name, row));
            if let (Some(here), Some(there)) = (here, there)
                && here != there
            {
                return refuse(name, here, there);
            }
        }
        for axis in model.info().axes.iter().filter(|axis| axis.kind == AxisKind::Rotary) {
            let [here, there] =
                [(&self.data, nominal), (data, row)].map(|(data, row)| Some(data.numbers(&axis.name)?[row]));
            if let (Some(here), Some(there)) = (here, there)
                && ((here - there + PI).rem_euclid(TAU) - PI).abs() > ELSEWHERE_ANGLE
            {
                let deg = |angle: f64| format!("{:.4} deg", angle.to_degrees());
                return refuse(&format!("{} at", axis.name), deg(here), deg(there));
            }
        }
        Ok(())
    }

    /// Fails, with the line of the nominal file, if the approach of its row does not lead against the facet.
    pub fn check_approach(&self, row: DataRow, touch: &Touch<'_>) -> Result<()> {
        touch.meets(&touch.model.info().nominal).map_err(|error| match error.place {
            None => Error { help: error.help.clone(), ..self.data.error_at(row, error.message) },
            Some(_) => error,
        })
    }
}

/// Largest difference, rad, of a rotary axis from where it was.
pub const ELSEWHERE_ANGLE: f64 = 1e-3;

/// A cell as text; of an approach its axis, because one with the other sign leads away from its facet.
fn label(data: &Dataset, name: &str, row: DataRow) -> Option<String> {
    let text = match &data.column(name)?.values {
        Values::Numbers(numbers) => numbers[row].to_string(),
        Values::Labels(labels) => labels[row].to_string(),
    };
    if name == "approach" { approach(&text).ok().map(|(axis, _)| axis) } else { Some(text) }
}

/// Axis and sense of an approach such as `-Z`.
fn approach(text: &str) -> Result<(String, f64), String> {
    let sense = if text.starts_with('-') { -1.0 } else { 1.0 };
    match text.strip_prefix(['-', '+']).map(str::trim) {
        Some(axis) if !axis.is_empty() => Ok((axis.to_owned(), sense)),
        _ => Err(format!("the approach `{text}` was found; a sign and an axis were expected, such as -Z")),
    }
}

/// The index of the linear axis of that name.
pub fn axis_index(model: &dyn KinematicModel, name: &str) -> Result<usize, String> {
    let linear = |axis: &&Axis| axis.kind == AxisKind::Linear;
    let names: Vec<&str> = model.info().axes.iter().filter(linear).map(|axis| axis.name.as_str()).collect();
    model
        .info()
        .axes
        .iter()
        .position(|axis| axis.name == name && axis.kind == AxisKind::Linear)
        .ok_or_else(|| format!("the approach is along {name}; the linear axes of the machine are {}", names.join(", ")))
}

/// Difference of `measured_mm` and the position of the approach axis in the same row, mm, that rounding makes.
const ROUNDED: f64 = 1e-3;

/// Whether the approach axis stands in a row where the touch was measured, and how far it is from there, mm; none if its column is not
/// there.
fn off(data: &Dataset, row: DataRow, axis: &str, measured: f64) -> Option<f64> {
    Some(data.numbers(axis)?[row] - measured).filter(|off| off.is_finite())
}

/// Whether the columns of approach axes hold where the touches were measured, as `measured_mm` does, and not where the axes were sent:
/// so it is if most rows agree. `touched` are the rows, their approach axes and `measured_mm`.
///
/// Fails for a row that does not agree while most do: one of the two is that of another day.
pub fn holds_trigger(data: &Dataset, touched: &[(DataRow, &str, f64)]) -> Result<bool> {
    let offs: Vec<(DataRow, &str, f64)> = touched
        .iter()
        .filter_map(|(row, axis, measured)| Some((*row, *axis, off(data, *row, axis, *measured)?)))
        .collect();
    let different: Vec<_> = offs.iter().filter(|(.., off)| off.abs() > ROUNDED).collect();
    if 2 * different.len() >= offs.len() {
        return Ok(false);
    }
    different.first().map_or(Ok(true), |(row, axis, off)| Err(contradicted(data, *row, axis, *off)))
}

/// The error for a row whose approach axis is not where the touch was measured.
pub fn contradicted(data: &Dataset, row: DataRow, axis: &str, off: f64) -> Error {
    let message = format!(
        "`{axis}` is {off:.4} mm from `measured_mm` in this row, and both are the position of the approach axis at the trigger"
    );
    data.error_at(row, message).help("is one of the two columns that of another run, or from before a shift of zero?")
}

/// Refuses rows whose approach axes are not where the touches were measured.
pub fn check_trigger(data: &Dataset, touched: &[(DataRow, &str, f64)]) -> Result<()> {
    for (row, axis, measured) in touched {
        if let Some(off) = off(data, *row, axis, *measured).filter(|off| off.abs() > ROUNDED) {
            return Err(contradicted(data, *row, axis, off));
        }
    }
    Ok(())
}

/// Steps after which a search ends; Newton's iteration needs three or four.
const STEPS: usize = 20;

/// Lengths below this are rounding of double precision, mm.
const NOTHING: f64 = 1e-10;

/// Moves the linear axes of a status, by the smallest step, until the nominal tip is at `goal`; false if they cannot reach
/// it.
fn reach(model: &dyn KinematicModel, status: &mut [f64], goal: Vector3<f64>) -> Result<bool> {
    let linear: Vec<usize> =
        (0..model.info().axes.len()).filter(|&axis| model.info().axes[axis].kind == AxisKind::Linear).collect();
    let wanted: Vec<Variable> = linear.iter().map(|&axis| Variable::Command(axis)).collect();
    let nominal = &model.info().nominal;
    let mut poses = Poses::default();
    for _ in 0..STEPS {
        model.poses(status, nominal, &wanted, false, &mut poses)?;
        let missing = goal - Vector3::from(poses.positions[0]);
        if missing.norm() < NOTHING {
            return Ok(true);
        }
        let by = DMatrix::from_fn(3, linear.len(), |row, column| poses.position_derivatives[column][row]);
        let missing = DVector::from_column_slice(missing.as_slice());
        let finite = by.iter().chain(&missing).all(|value| value.is_finite());
        let step = finite.then(|| by.svd(true, true).solve(&missing, 1e-9)).and_then(Result::ok);
        let Some(step) = step else { return Ok(false) };
        for (axis, step) in linear.iter().zip(&step) {
            status[model.info().axes[*axis].status] += step;
        }
    }
    Ok(false)
}

/// A touch of one point from one status.
pub struct Touch<'a> {
    /// The machine.
    pub model: &'a dyn KinematicModel,
    /// What is touched.
    pub point: &'a Point,
    /// Index of the approach axis.
    pub axis: usize,
    /// The status in contact.
    pub status: Vec<f64>,
}

/// Smallest motion of the tip along the normal, mm/mm, with which an approach axis can touch a facet.
const ALONG: f64 = 1e-3;

impl<'a> Touch<'a> {
    /// A touch; fails if the machine has no such approach axis.
    pub fn new(model: &'a dyn KinematicModel, point: &'a Point, status: &[f64]) -> Result<Self> {
        let axis = axis_index(model, &point.axis).map_err(Error::data)?;
        Ok(Self { model, point, axis, status: status.to_vec() })
    }

    /// Distance of the tip from the nominal facet, without radius and offset, and its derivatives.
    fn distance(&self, values: &[f64], status: &[f64], wanted: &[Variable]) -> Result<(f64, Vec<f64>)> {
        let mut poses = Poses::default();
        self.model.poses(status, values, wanted, false, &mut poses)?;
        let distance = self.point.normal.dot(&(Vector3::from(poses.positions[0]) - self.point.position));
        let by = poses.position_derivatives.iter();
        Ok((distance, by.map(|by| self.point.normal.dot(&Vector3::from(*by))).collect()))
    }

    /// The distance at the status itself.
    pub fn distance_here(&self, values: &[f64]) -> Result<f64> {
        Ok(self.distance(values, &self.status, &[])?.0)
    }

    /// How far the tip is beside the line along the normal of the point, mm.
    pub fn beside_here(&self, values: &[f64]) -> Result<f64> {
        let mut poses = Poses::default();
        self.model.poses(&self.status, values, &[], false, &mut poses)?;
        Ok((Vector3::from(poses.positions[0]) - self.point.position).cross(&self.point.normal).norm())
    }

    /// The position of the approach axis at which the distance of the tip from the nominal facet is `goal`: the full
    /// nonlinear touch.
    pub fn reading(&self, values: &[f64], goal: f64) -> Result<f64> {
        let place = self.model.info().axes[self.axis].status;
        let mut status = self.status.clone();
        for _ in 0..STEPS {
            let (distance, by) = self.distance(values, &status, &[Variable::Command(self.axis)])?;
            let step = (goal - distance) / self.slope(by[0])?;
            status[place] += step;
            if step.abs() < NOTHING {
                return Ok(status[place]);
            }
        }
        Err(Error::data(format!("the approach along {} does not meet point {}", self.point.axis, self.point.label)))
    }

    /// Fails if the approach does not lead against the facet.
    fn meets(&self, values: &[f64]) -> Result<()> {
        let (_, by) = self.distance(values, &self.status, &[Variable::Command(self.axis)])?;
        self.slope(by[0]).map(drop)
    }

    fn slope(&self, by: f64) -> Result<f64> {
        let Point { axis, label, sense, .. } = self.point;
        if by * sense < -ALONG {
            return Ok(by);
        }
        if by * sense > ALONG {
            let message = format!("the approach along {axis} leads away from the facet of point {label}");
            return Err(Error::data(message).help("`nx, ny, nz` is the outward normal, and `approach` goes against it"));
        }
        Err(Error::data(format!("the approach along {axis} passes point {label} instead of touching its facet"))
            .help("the approach has to have a part along the normal of the facet"))
    }

    /// Derivatives of the reading to parameters (by index), then to changes of the artefact: shifts along and rotations about
    /// x, y, z of the table frame, and its expansion (1/1).
    pub fn sensitivities(&self, values: &[f64], parameters: &[usize]) -> Result<(Vec<f64>, [f64; 7])> {
        let mut wanted: Vec<Variable> = parameters.iter().map(|&index| Variable::Parameter(index)).collect();
        wanted.push(Variable::Command(self.axis));
        let (_, mut by) = self.distance(values, &self.status, &wanted)?;
        let slope = self.slope(by.pop().unwrap_or_default())?;
        let Point { position, normal, .. } = self.point;
        let moment = position.cross(normal);
        let artefact =
            [normal.x, normal.y, normal.z, moment.x, moment.y, moment.z, normal.dot(position)].map(|part| part / slope);
        Ok((by.into_iter().map(|part| -part / slope).collect(), artefact))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use abbe_core::{Build, Context, Kind, Registry};
    use abbe_serial_chain as _;
    use serde_json::json;

    use super::*;

    fn folder(machine: &str) -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../pipelines/data/rapid-verify/exact").join(machine)
    }

    fn model(chain: &str) -> Arc<dyn KinematicModel> {
        let registry = Registry::built_in().unwrap();
        let Build::Model(build) = &registry.find(Kind::Model, "serial-chain").unwrap().build else { panic!() };
        let linear = ["EXX", "EYY", "EZZ", "EAX", "EBX", "ECX", "EAY", "EBY", "ECY", "EAZ", "EBZ", "ECZ"];
        let straight = ["EYX", "EZX", "EXY", "EZY", "EXZ", "EYZ"];
        let mut errors = vec![
            json!({ "polynomial": linear, "degrees": [1] }),
            json!({ "polynomial": straight, "degrees": [2] }),
            json!({ "location": ["EC0X", "EA0Z", "EB0Z"] }),
            json!({ "backlash": ["EXX", "EYY", "EZZ"] }),
        ];
        if chain.contains('C') {
            errors.push(json!({ "location": ["EB0A", "EC0A", "EY0A", "EZ0A", "EY0C", "EX0C", "EA0C", "EB0C"] }));
            errors.push(json!({ "polynomial": ["ECC", "EAA"], "degrees": [1] }));
        }
        let styli = json!({ "2": { "x_mm": 40, "y_mm": 0, "length_mm": 180 } });
        let settings =
            json!({ "chain": chain, "tool_length_mm": 180, "stylus_radius_mm": 3, "styli": styli, "errors": errors });
        build.build(&settings, &Context { base: PathBuf::new() }).unwrap().build(&[]).unwrap()
    }

    /// The position of the approach axis in full nonlinear contact, central differences of it, and the derivatives.
    #[test]
    fn sensitivities_are_those_of_the_full_touch() {
        for (machine, chain) in [("three-axis", "w X' Y' b Z t"), ("five-axis", "w C' A' b Y X Z t")] {
            let (model, points) = (model(chain), Points::read(&folder(machine).join("points.csv")).unwrap());
            let statuses = points.in_contact(model.as_ref()).unwrap();
            let all: Vec<usize> = (0..model.info().parameters.len()).collect();
            let place = |name: &str| model.info().parameters.iter().position(|other| other.name == name).unwrap();
            // A machine with errors, so that second order counts.
            let mut values = model.info().nominal.clone();
            for (name, value) in [("EXX[1]", 3e-5), ("EC0X", -2e-5), ("EA0Z", 1e-5), ("EYX[2]", 4e-7), ("dyt", 0.01)] {
                values[place(name)] = value;
            }
            for (pose, point) in statuses.indices().zip(&points.list) {
                let mut touch = Touch::new(model.as_ref(), point, statuses.row(pose)).unwrap();
                let goal = model.info().stylus_radius + 0.004;
                let reading = touch.reading(&values, goal).unwrap();
                touch.status[model.info().axes[touch.axis].status] = reading;
                assert!((touch.distance_here(&values).unwrap() - goal).abs() < 1e-9);
                let (by_parameter, by_artefact) = touch.sensitivities(&values, &all).unwrap();
                for (index, by) in by_parameter.iter().enumerate() {
                    // A tenth of a micrometre at the end of the travel.
                    let unit = model.info().parameters[index].unit;
                    let size = if unit.of == Quantity::Angle { 1e-6 } else { 1e-4 };
                    let step = unit.per.map_or(size, |(_, power)| size / 300.0_f64.powi(i32::from(power)));
                    let at = |change: f64| {
                        let mut changed = values.clone();
                        changed[index] += change;
                        touch.reading(&changed, goal).unwrap()
                    };
                    let difference = (at(step) - at(-step)) / (2.0 * step);
                    let name = &model.info().parameters[index].name;
                    let off = (by - difference).abs();
                    // A picometre of the readings, and what is of third order.
                    assert!(off <= 1e-9 / step + 1e-5 * by.abs(), "{} {name}: {by} {difference}", point.label);
                }
                // The artefact, moved as a whole: the set-up of the workpiece does the same.
                let (shifts, mut moved) = (["dxw", "dyw", "dzw", "daw", "dbw", "dcw"], by_artefact.to_vec());
                let expansion = moved.pop().unwrap();
                for (name, by) in shifts.iter().zip(moved) {
                    let set_up = by_parameter[place(name)];
                    // The contact is on the ball: its centre stands off by its radius, which turns with the artefact.
                    assert!((by - set_up).abs() <= 2e-2 + 1e-3 * by.abs(), "{} {name}: {by} {set_up}", point.label);
                }
                let larger = Point { position: point.position * (1.0 + 1e-6), ..point.clone() };
                let larger =
                    Touch { point: &larger, model: model.as_ref(), axis: touch.axis, status: touch.status.clone() };
                let difference = (larger.reading(&values, goal).unwrap() - reading) / 1e-6;
                assert!((expansion - difference).abs() < 1e-3 * expansion.abs().max(1.0), "{}", point.label);
            }
        }
    }
}
