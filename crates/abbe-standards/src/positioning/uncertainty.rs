//! Measurement uncertainty of the figures of ISO 230-2, in the manner of ISO/TR 230-9.
//!
//! The technical report was not at hand; it has rounded factors. Here all follows from the drift, which changes the difference of two
//! readings by the range E_VE, independently at each target, and from what grows with length and is common to all readings: a
//! rectangular range w has the standard uncertainty w / (2 √3). E and M are differences of two means, and have just what the formulas
//! say. B is one, too: its formula takes the drift as that of each reading, and is larger by √2 than it has to be. Those of R and A are
//! a choice of this project (\[M\] in the documentation).

/// What is known of the measurement of a linear axis. Ranges are full widths.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Linear {
    /// Expanded uncertainty (k = 2) of the device, µm per m.
    pub device: f64,
    /// Lateral misalignment over the whole travel, mm.
    pub misalignment: f64,
    /// Coefficient of expansion, µm/(m K).
    pub expansion: f64,
    /// Range of the temperature of the machine or its compensation, K.
    pub temperature_range: f64,
    /// Range of the coefficient of expansion, µm/(m K).
    pub expansion_range: f64,
    /// How far the temperature is from 20 °C, K.
    pub offset: f64,
    /// Range of the drift between two readings, E_VE, µm.
    pub drift_range: f64,
}

/// What is known of the measurement of a rotary axis.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Rotary {
    /// Expanded uncertainty (k = 2) of the device, µrad.
    pub device: f64,
    /// Range of the drift between two readings, E_VE, µrad.
    pub drift_range: f64,
}

/// Standard uncertainty of a rectangular distribution of this full width.
pub fn rectangular(width: f64) -> f64 {
    width / (2.0 * 3.0_f64.sqrt())
}

/// Standard uncertainties of the contributions, in the unit of the readings.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Terms {
    /// Of the device, over the whole travel.
    pub device: f64,
    /// Of the misalignment m: the range m² / (2 L).
    pub misalignment: f64,
    /// Of the temperature: the range α L R(T).
    pub temperature: f64,
    /// Of the coefficient of expansion: the range L R(α) ΔT.
    pub expansion: f64,
    /// Of the change between two readings by drift, E_VE.
    pub drift: f64,
}

impl Linear {
    /// The contributions over a travel (mm), µm; none for a travel that is not positive.
    pub fn terms(&self, travel: f64) -> Option<Terms> {
        let metres = 1e-3 * travel;
        (travel.is_finite() && travel > 0.0).then(|| Terms {
            device: 0.5 * self.device * metres,
            misalignment: rectangular(1e3 * self.misalignment * self.misalignment / (2.0 * travel)),
            temperature: rectangular(self.expansion * metres * self.temperature_range),
            expansion: rectangular(metres * self.expansion_range * self.offset.abs()),
            drift: rectangular(self.drift_range),
        })
    }
}

impl Rotary {
    /// The contributions, µrad.
    pub fn terms(&self) -> Terms {
        Terms { device: 0.5 * self.device, drift: rectangular(self.drift_range), ..Terms::default() }
    }
}

/// Expanded uncertainties (k = 2), in the unit of the readings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Expanded {
    /// Of E, E↑ and E↓.
    pub systematic: f64,
    /// Of M.
    pub mean_deviation: f64,
    /// Of B, and an upper bound for that of the mean reversal.
    pub reversal: f64,
    /// Of R, R↑ and R↓; none for single runs.
    pub repeatability: Option<f64>,
    /// Of A, A↑ and A↓; none for single runs.
    pub accuracy: Option<f64>,
}

impl Terms {
    /// The common contributions together: all but the drift.
    pub fn common(&self) -> f64 {
        [self.device, self.misalignment, self.temperature, self.expansion].iter().map(|u| u * u).sum::<f64>().sqrt()
    }

    /// Expanded uncertainties (k = 2) of the figures from n runs:
    /// U(E) = 2 √(c² + d²/n), U(M) = 2 √(c² + d²/(2n)), U(B) = 2 d √(2/n), U(R) = 4 d, U(A) = 2 √(c² + (1 + 1/n) d²), with the
    /// common part c and the drift d. None without a run.
    pub fn expanded(&self, runs: usize) -> Option<Expanded> {
        let (common, drift, n) = (self.common(), self.drift, runs as f64);
        let of = |part: f64| 2.0 * (common * common + part * drift * drift).sqrt();
        (runs > 0).then(|| Expanded {
            systematic: of(1.0 / n),
            mean_deviation: of(0.5 / n),
            reversal: 2.0 * drift * (2.0 / n).sqrt(),
            repeatability: (runs > 1).then_some(4.0 * drift),
            accuracy: (runs > 1).then(|| of(1.0 + 1.0 / n)),
        })
    }
}
