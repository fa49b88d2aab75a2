//! Beams that bend and grow without stress (Soons 1993, eq. 3.56 to 3.62).
//!
//! A beam lies along x and is held at x = 0. At its sections the temperature above the reference is a plane over y and z, between
//! them it changes straight along x. With the coefficient of expansion k:
//!
//! `elongation = int k T dx`, `rotation_y = int k dT/dz dx`, `rotation_z = -int k dT/dy dx`,
//! `deflection_y = int rotation_z dx`, `deflection_z = -int rotation_y dx`
//!
//! (Eq. 3.62 is printed with the deflection along x on its left side.) A beam that is hotter at +z bends to -z. Roll is not described,
//! and no forces of the process.

use abbe_core::{Error, Result};
use faer::Mat;

/// Temperature above the reference over a section.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct TemperaturePlane {
    /// On the axis of the beam, K.
    pub on_axis: f64,
    /// Gradient along y, K/mm.
    pub along_y: f64,
    /// Gradient along z, K/mm.
    pub along_z: f64,
}

/// Gradients along directions in which sensors hardly differ are not told by them: part of the largest distance.
const FLAT: f64 = 1e-6;

impl TemperaturePlane {
    /// The plane with the least squares through sensors of a section: y and z from the axis in mm, and the temperature above the
    /// reference in K; and the largest distance from it, K. A gradient that sensors do not tell is zero: one sensor alone gives the
    /// same temperature all over the section.
    ///
    /// Fails without a sensor and for values that are no numbers.
    pub fn through(sensors: &[[f64; 3]]) -> Result<(Self, f64)> {
        if sensors.is_empty() || !sensors.iter().flatten().all(|value| value.is_finite()) {
            return Err(Error::data("at least one sensor with its place and temperature was expected at a section"));
        }
        let count = sensors.len() as f64;
        let mean = [0, 1, 2].map(|part| sensors.iter().map(|sensor| sensor[part]).sum::<f64>() / count);
        let from_mean = |row: usize, part: usize| sensors[row][part] - mean[part];
        let places = Mat::from_fn(sensors.len(), 2, &from_mean);
        let right = Mat::from_fn(sensors.len(), 1, |row, _| from_mean(row, 2));
        let svd = places.thin_svd().map_err(|_| Error::data("no plane goes through the sensors of a section"))?;
        let largest = svd.S().column_vector().iter().copied().fold(0.0, f64::max);
        let mut gradient = [0.0; 2];
        for (index, value) in svd.S().column_vector().iter().enumerate() {
            if *value > FLAT * largest && *value > 0.0 {
                let part = (svd.U().col(index).transpose() * right.col(0)) / value;
                (0..2).for_each(|row| gradient[row] += part * svd.V()[(row, index)]);
            }
        }
        let [along_y, along_z] = gradient;
        let plane = Self { on_axis: mean[2] - along_y * mean[0] - along_z * mean[1], along_y, along_z };
        let off = |[y, z, temperature]: &[f64; 3]| (plane.at(*y, *z) - temperature).abs();
        Ok((plane, sensors.iter().map(off).fold(0.0, f64::max)))
    }

    /// The temperature above the reference at a place, K.
    pub fn at(&self, y: f64, z: f64) -> f64 {
        self.on_axis + self.along_y * y + self.along_z * z
    }
}

/// A part of a beam between two sections.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Segment {
    /// Its length, mm.
    pub length: f64,
    /// Coefficient of thermal expansion, 1/K.
    pub expansion: f64,
}

/// How a section of a beam has moved: mm and rad.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SectionDisplacement {
    /// Along x.
    pub elongation: f64,
    /// Along y.
    pub deflection_y: f64,
    /// Along z.
    pub deflection_z: f64,
    /// About y.
    pub rotation_y: f64,
    /// About z.
    pub rotation_z: f64,
}

impl SectionDisplacement {
    /// Behind a part of a segment: its length, and the planes at its ends.
    fn behind(self, length: f64, expansion: f64, from: TemperaturePlane, to: TemperaturePlane) -> Self {
        // int (a + (b - a) x/L) dx over the length, and the integral of that.
        let once = |a: f64, b: f64| expansion * length * (a + b) / 2.0;
        let twice = |a: f64, b: f64| expansion * length * length * (2.0 * a + b) / 6.0;
        Self {
            elongation: self.elongation + once(from.on_axis, to.on_axis),
            deflection_y: self.deflection_y + self.rotation_z * length - twice(from.along_y, to.along_y),
            deflection_z: self.deflection_z - self.rotation_y * length - twice(from.along_z, to.along_z),
            rotation_y: self.rotation_y + once(from.along_z, to.along_z),
            rotation_z: self.rotation_z - once(from.along_y, to.along_y),
        }
    }
}

/// A beam of segments, held at its beginning.
#[derive(Debug, Clone, PartialEq)]
pub struct Beam {
    segments: Vec<Segment>,
}

impl Beam {
    /// Fails without a segment, and for lengths that are not above 0 or coefficients that are no numbers.
    pub fn new(segments: Vec<Segment>) -> Result<Self> {
        let is_one =
            |segment: &Segment| segment.length > 0.0 && segment.length.is_finite() && segment.expansion.is_finite();
        if segments.is_empty() || !segments.iter().all(is_one) {
            return Err(Error::data("segments with lengths above 0 mm and coefficients of expansion were expected"));
        }
        Ok(Self { segments })
    }

    /// Its length, mm.
    pub fn length(&self) -> f64 {
        self.segments.iter().map(|segment| segment.length).sum()
    }

    /// The displacement of every section, one more than there are segments.
    ///
    /// Fails unless there is a plane for every section.
    pub fn sections(&self, planes: &[TemperaturePlane]) -> Result<Vec<SectionDisplacement>> {
        if planes.len() != self.segments.len() + 1 {
            let message =
                format!("a beam of {} segments has {} sections", self.segments.len(), self.segments.len() + 1);
            return Err(Error::data(format!("{message}; temperatures of {} are given", planes.len())));
        }
        let mut found = vec![SectionDisplacement::default()];
        let mut now = SectionDisplacement::default();
        for (segment, pair) in self.segments.iter().zip(planes.windows(2)) {
            now = now.behind(segment.length, segment.expansion, pair[0], pair[1]);
            found.push(now);
        }
        Ok(found)
    }

    /// The displacement at a place along the beam, mm from its beginning.
    ///
    /// Fails as [`sections`](Self::sections) does, and beyond the ends.
    pub fn at(&self, planes: &[TemperaturePlane], x: f64) -> Result<SectionDisplacement> {
        let sections = self.sections(planes)?;
        let (index, within) = self.segment(x)?;
        let Segment { expansion, .. } = self.segments[index];
        Ok(sections[index].behind(within, expansion, planes[index], self.plane(planes, index, within)))
    }

    /// How the displacement changes along the beam at a place, a mm: strain, slopes, curvatures. Between two segments it is that of
    /// the first one.
    ///
    /// Fails as [`at`](Self::at) does.
    pub fn slope_at(&self, planes: &[TemperaturePlane], x: f64) -> Result<SectionDisplacement> {
        let here = self.at(planes, x)?;
        let (index, within) = self.segment(x)?;
        let Segment { expansion, .. } = self.segments[index];
        let plane = self.plane(planes, index, within);
        Ok(SectionDisplacement {
            elongation: expansion * plane.on_axis,
            deflection_y: here.rotation_z,
            deflection_z: -here.rotation_y,
            rotation_y: expansion * plane.along_z,
            rotation_z: -expansion * plane.along_y,
        })
    }

    /// The segment of a place, and the way into it.
    fn segment(&self, x: f64) -> Result<(usize, f64)> {
        if !(0.0..=self.length()).contains(&x) {
            return Err(Error::data(format!("{x} mm is not on the beam, which is {} mm long", self.length())));
        }
        let (mut index, mut within) = (0, x);
        while within > self.segments[index].length && index + 1 < self.segments.len() {
            within -= self.segments[index].length;
            index += 1;
        }
        Ok((index, within))
    }

    /// The temperatures within a segment.
    fn plane(&self, planes: &[TemperaturePlane], segment: usize, within: f64) -> TemperaturePlane {
        let (from, to) = (planes[segment], planes[segment + 1]);
        let part = within / self.segments[segment].length;
        let between = |a: f64, b: f64| a + part * (b - a);
        TemperaturePlane {
            on_axis: between(from.on_axis, to.on_axis),
            along_y: between(from.along_y, to.along_y),
            along_z: between(from.along_z, to.along_z),
        }
    }
}
