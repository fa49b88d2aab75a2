//! What stands on the table of a machine in the tests: a ball on its rod, or faces. All lengths in mm, table frame. It shares no code
//! with the checks of `abbe-measuring`.

use super::machine::{dot, minus, norm};

/// The shank of the probe is this thick up to this height, and the rest of it so.
const SHANK: (f64, f64, f64) = (2.0, 40.0, 20.0);

/// What the probe may touch and must not run into.
pub trait Body {
    /// Distance of a point from the surface, positive outside.
    fn gap(&self, point: [f64; 3]) -> f64;

    /// At how many steps of a move the rest of the probe is looked at once.
    fn stride(&self) -> usize {
        1
    }

    /// What the rest of the probe is in, if the tip is here and the spindle there.
    fn meets(&self, tip: [f64; 3], up: [f64; 3]) -> Option<&'static str>;

    /// How far the centre of a tip with this radius is from contact with a feature: from its surface, and from its place along it.
    fn contact(&self, feature: &str, normal: [f64; 3], tip: [f64; 3], radius: f64) -> [f64; 2];
}

/// A ball on a rod.
pub struct Ball {
    pub centre: [f64; 3],
    pub radius: f64,
    pub stand: [[f64; 3]; 2],
}

/// Radius of the rod.
const ROD: f64 = 5.0;

impl Body for Ball {
    fn gap(&self, point: [f64; 3]) -> f64 {
        norm(minus(point, self.centre)) - self.radius
    }

    fn meets(&self, tip: [f64; 3], up: [f64; 3]) -> Option<&'static str> {
        for step in 0..=50 {
            let height = 3.0 * f64::from(step);
            let place = [0, 1, 2].map(|axis| tip[axis] + height * up[axis]);
            let own = if height < SHANK.1 { SHANK.0 } else { SHANK.2 };
            if norm(minus(place, self.centre)) < self.radius + own - 1.0 && height > 0.0 {
                return Some("the shank is in the ball");
            }
            if from_rod(place, self.stand) < ROD + own - 0.5 {
                return Some("the probe is in the stand");
            }
        }
        None
    }

    fn contact(&self, _: &str, normal: [f64; 3], tip: [f64; 3], radius: f64) -> [f64; 2] {
        let from = minus(tip, self.centre);
        let along = norm(from) * (1.0 - (dot(from, normal) / norm(from)).powi(2)).max(0.0).sqrt();
        let beside = if dot(from, normal) > 0.0 { along } else { f64::INFINITY };
        [norm(from) - self.radius - radius, beside]
    }
}

/// Distance from a line between two points.
fn from_rod(point: [f64; 3], [low, high]: [[f64; 3]; 2]) -> f64 {
    let along = minus(high, low);
    let part = (dot(minus(point, low), along) / dot(along, along)).clamp(0.0, 1.0);
    norm(minus(point, [0, 1, 2].map(|axis| low[axis] + part * along[axis])))
}

/// A face that is touched: a disc around a point, off its nominal place along its normal.
#[derive(Debug, Clone)]
pub struct Face {
    pub feature: String,
    pub point: [f64; 3],
    pub normal: [f64; 3],
    pub off: f64,
}

/// Discs that are touched, and the block on which they are if they are on one.
pub struct Faces {
    pub faces: Vec<Face>,
    pub radius: f64,
    pub thickness: f64,
    /// Two corners.
    pub block: Option<[[f64; 3]; 2]>,
}

impl Face {
    /// Distance of a point from a disc of this radius and thickness: from the plane first, and across from the rim.
    fn distance(&self, point: [f64; 3], radius: f64, thickness: f64) -> f64 {
        let from = minus(point, self.point);
        let height = dot(from, self.normal) - self.off;
        let across = norm([0, 1, 2].map(|axis| from[axis] - dot(from, self.normal) * self.normal[axis])) - radius;
        let (above, beside) = (height.max(-thickness - height), across);
        if above <= 0.0 && beside <= 0.0 { above.max(beside) } else { above.max(0.0).hypot(beside.max(0.0)) }
    }
}

/// A block is so much lower than its faces: these may be off inwards.
const LOWER: f64 = 0.2;

impl Faces {
    /// Faces of a block do not stand out of it by anything that the shank would meet first.
    fn obstacle(&self, point: [f64; 3]) -> f64 {
        if self.block.is_some() { self.block_distance(point) } else { self.gap(point) }
    }

    fn block_distance(&self, point: [f64; 3]) -> f64 {
        let Some([from, to]) = self.block else { return f64::INFINITY };
        let out = [0, 1, 2].map(|axis| (from[axis] + LOWER - point[axis]).max(point[axis] - to[axis] + LOWER));
        if out.iter().all(|out| *out <= 0.0) {
            return out.into_iter().fold(f64::NEG_INFINITY, f64::max);
        }
        norm(out.map(|out| out.max(0.0)))
    }
}

impl Body for Faces {
    fn gap(&self, point: [f64; 3]) -> f64 {
        let of = |face: &Face| face.distance(point, self.radius, self.thickness);
        self.faces.iter().map(of).fold(self.block_distance(point), f64::min)
    }

    fn stride(&self) -> usize {
        4
    }

    /// Points on the surface of the probe.
    fn meets(&self, tip: [f64; 3], up: [f64; 3]) -> Option<&'static str> {
        let side = if up[0].abs() < 0.7 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
        let one = minus(side, up.map(|part| part * dot(side, up)));
        let one = one.map(|part| part / norm(one));
        let other = [up[1] * one[2] - up[2] * one[1], up[2] * one[0] - up[0] * one[2], up[0] * one[1] - up[1] * one[0]];
        let at = |height: f64, radius: f64, turn: f64| {
            [0, 1, 2].map(|axis| {
                tip[axis] + height * up[axis] + radius * (turn.cos() * one[axis] + turn.sin() * other[axis])
            })
        };
        let thin = (1..20).map(|step| (2.0 * f64::from(step), SHANK.0));
        let flat = (1..=4).map(|step| (SHANK.1 + 0.5, SHANK.2 * f64::from(step) / 4.0));
        let thick = (1..28).map(|step| (SHANK.1 + 4.0 * f64::from(step), SHANK.2));
        for (height, radius) in thin.chain(flat).chain(thick) {
            if self.obstacle(at(height, 0.0, 0.0)) > radius + 0.1 {
                continue;
            }
            let around = (0..16).map(|step| f64::from(step) * std::f64::consts::TAU / 16.0);
            if around.into_iter().any(|turn| self.obstacle(at(height, radius - 0.1, turn)) < 0.0) {
                return Some("the probe is in what stands on the table");
            }
        }
        None
    }

    fn contact(&self, feature: &str, normal: [f64; 3], tip: [f64; 3], radius: f64) -> [f64; 2] {
        let Some(face) = self.faces.iter().find(|face| face.feature == feature) else { return [f64::INFINITY; 2] };
        let from = minus(tip, face.point);
        let height = dot(from, face.normal);
        let beside = norm(minus(from, face.normal.map(|part| part * height)));
        let turned = norm(minus(normal, face.normal)) < 1e-3;
        [height - face.off - radius, if turned { beside } else { f64::INFINITY }]
    }
}
