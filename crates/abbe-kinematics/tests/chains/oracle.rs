//! Proves nothing by itself: the conventions' section 2 once more, written with 4 x 4 matrices and without any of the
//! code under test, and random machines to hold against it. The tests of `serial-chain` use it too.

use nalgebra::{Matrix3, Matrix4, Vector3};

/// Numbers that look random and are the same in every run (splitmix64).
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ 0x5851_f42d_4c95_7f2d)
    }

    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Between -1 and 1.
    pub fn signed(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    pub fn below(&mut self, count: usize) -> usize {
        (self.bits() % count as u64) as usize
    }

    pub fn one_in(&mut self, count: usize) -> bool {
        self.below(count) == 0
    }

    pub fn vector(&mut self, size: f64) -> Vector3<f64> {
        Vector3::new(self.signed(), self.signed(), self.signed()) * size
    }

    /// Six errors: translations up to `mm`, angles up to `rad`.
    pub fn errors(&mut self, mm: f64, rad: f64) -> [f64; 6] {
        std::array::from_fn(|component| self.signed() * if component < 3 { mm } else { rad })
    }
}

#[derive(Debug, Clone)]
pub struct OracleAxis {
    pub rotary: bool,
    /// Not necessarily of unit length.
    pub direction: Vector3<f64>,
    pub point: Vector3<f64>,
    pub reverse: bool,
    /// Motion errors act in the frame at zero.
    pub fixed: bool,
}

/// A machine: axes from workpiece to tool, the first `bed` of them carry the workpiece.
#[derive(Debug, Clone)]
pub struct Machine {
    pub axes: Vec<OracleAxis>,
    pub bed: usize,
    pub tip: Vector3<f64>,
}

/// Errors of a machine, as the conventions name them.
#[derive(Debug, Clone)]
pub struct MachineErrors {
    pub location: Vec<[f64; 6]>,
    pub motion: Vec<[f64; 6]>,
    pub workpiece: [f64; 6],
    pub tool: [f64; 6],
}

impl MachineErrors {
    pub fn none(axes: usize) -> Self {
        Self { location: vec![[0.0; 6]; axes], motion: vec![[0.0; 6]; axes], workpiece: [0.0; 6], tool: [0.0; 6] }
    }
}

pub fn translation(by: Vector3<f64>) -> Matrix4<f64> {
    let mut matrix = Matrix4::identity();
    for i in 0..3 {
        matrix[(i, 3)] = by[i];
    }
    matrix
}

/// Rodrigues' formula.
fn rotation(about: Vector3<f64>, angle: f64) -> Matrix4<f64> {
    let [x, y, z] = (about / about.norm()).into();
    let cross = Matrix3::new(0.0, -z, y, z, 0.0, -x, -y, x, 0.0);
    let turn = Matrix3::identity() + cross * angle.sin() + cross * cross * (1.0 - angle.cos());
    let mut matrix = Matrix4::identity();
    for i in 0..3 {
        for k in 0..3 {
            matrix[(i, k)] = turn[(i, k)];
        }
    }
    matrix
}

/// E(ex, ey, ez, ea, eb, ec) = [Rz(ec) Ry(eb) Rx(ea) | (ex, ey, ez)].
pub fn error_matrix(errors: &[f64; 6]) -> Matrix4<f64> {
    let [x, y, z, a, b, c] = *errors;
    translation(Vector3::new(x, y, z))
        * rotation(Vector3::z(), c)
        * rotation(Vector3::y(), b)
        * rotation(Vector3::x(), a)
}

impl Machine {
    /// T of one branch, from the bed outwards.
    fn branch(&self, outwards: &[usize], sign: f64, commands: &[f64], errors: &MachineErrors) -> Matrix4<f64> {
        let mut total = Matrix4::identity();
        let mut origin = Vector3::zeros();
        for &k in outwards {
            let axis = &self.axes[k];
            let command = commands[k] * sign * if axis.reverse { -1.0 } else { 1.0 };
            let mut step = Matrix4::identity();
            if axis.rotary {
                step = translation(axis.point - origin);
                origin = axis.point;
            }
            let moved = match axis.rotary {
                true => rotation(axis.direction, command),
                false => translation(axis.direction / axis.direction.norm() * command),
            };
            let (location, motion) = (error_matrix(&errors.location[k]), error_matrix(&errors.motion[k]));
            total *= step * location * if axis.fixed { motion * moved } else { moved * motion };
        }
        total
    }

    /// The tool frame, its origin at the tip, seen from the table frame.
    pub fn tool_in_table(&self, commands: &[f64], errors: &MachineErrors) -> Matrix4<f64> {
        let workpiece: Vec<usize> = (0..self.bed).rev().collect();
        let tool: Vec<usize> = (self.bed..self.axes.len()).collect();
        let table = self.branch(&workpiece, -1.0, commands, errors) * error_matrix(&errors.workpiece);
        let tool = self.branch(&tool, 1.0, commands, errors) * translation(self.tip) * error_matrix(&errors.tool);
        table.try_inverse().expect("a rigid motion") * tool
    }

    /// Two to seven axes of any kind, on either side, in any order.
    pub fn random(random: &mut Random) -> Self {
        let count = 2 + random.below(6);
        let axes = (0..count).map(|_| {
            let letter = [Vector3::x(), Vector3::y(), Vector3::z()][random.below(3)];
            OracleAxis {
                rotary: random.one_in(2),
                direction: if random.one_in(3) { random.vector(2.0) + letter * 3.0 } else { letter },
                point: random.vector(300.0),
                reverse: random.one_in(4),
                fixed: random.one_in(2),
            }
        });
        Self { axes: axes.collect(), bed: random.below(count + 1), tip: random.vector(250.0) }
    }

    pub fn random_commands(&self, random: &mut Random) -> Vec<f64> {
        self.axes.iter().map(|axis| random.signed() * if axis.rotary { 3.0 } else { 400.0 }).collect()
    }

    pub fn random_errors(&self, random: &mut Random, mm: f64, rad: f64) -> MachineErrors {
        let mut list = || (0..self.axes.len()).map(|_| random.errors(mm, rad)).collect();
        let (location, motion) = (list(), list());
        MachineErrors { location, motion, workpiece: random.errors(mm, rad), tool: random.errors(mm, rad) }
    }

    /// The lengths that the tip's position is the sum of: what rounding is relative to.
    pub fn size(&self, commands: &[f64]) -> f64 {
        let axes = self.axes.iter().zip(commands);
        self.tip.norm()
            + axes.map(|(axis, command)| if axis.rotary { axis.point.norm() } else { command.abs() }).sum::<f64>()
    }
}

/// The rotation part.
pub fn turn(matrix: &Matrix4<f64>) -> Matrix3<f64> {
    matrix.fixed_view::<3, 3>(0, 0).into_owned()
}

/// The translation part.
pub fn place(matrix: &Matrix4<f64>) -> Vector3<f64> {
    matrix.fixed_view::<3, 1>(0, 3).into_owned()
}

/// Rotation vector of a small rotation.
pub fn rotation_vector(turn: &Matrix3<f64>) -> Vector3<f64> {
    let sine =
        Vector3::new(turn[(2, 1)] - turn[(1, 2)], turn[(0, 2)] - turn[(2, 0)], turn[(1, 0)] - turn[(0, 1)]) / 2.0;
    let size = sine.norm();
    if size < 1e-12 { sine } else { sine * (size.asin() / size) }
}
