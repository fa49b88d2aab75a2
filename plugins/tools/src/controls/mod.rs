//! Files of controls.

pub mod fanuc;
pub mod heidenhain;
pub mod linuxcnc;
pub mod siemens;

/// A tool with its offsets.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// Its number in the control.
    pub number: u32,
    /// Length and radius as they were set, mm.
    pub preset: [f64; 2],
    /// Length and radius as they are, mm.
    pub value: [f64; 2],
    /// Whether it has to be measured again.
    pub recheck: bool,
}

/// A tool that must not be used.
#[derive(Debug, Clone, PartialEq)]
pub struct Locked {
    /// Its number in the control.
    pub number: u32,
    /// Length and radius as they were set, mm.
    pub preset: [f64; 2],
    /// Why.
    pub reason: &'static str,
}

/// A length in increments of a control.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Increments {
    count: i64,
    decimals: u32,
}

impl Increments {
    /// The nearest to a length in mm.
    pub fn of(length: f64, decimals: u32) -> Self {
        Self { count: (length * 10_f64.powi(decimals as i32)).round() as i64, decimals }
    }

    /// A length as base and what is to be added, negative for a tool that is shorter than its preset. The sum is rounded, not
    /// the parts.
    pub fn split(preset: f64, value: f64, decimals: u32) -> [Self; 2] {
        let [base, total] = [preset, value].map(|length| Self::of(length, decimals));
        [base, Self { count: total.count - base.count, decimals }]
    }

    /// With its sign, also where it is positive.
    pub fn signed(self) -> String {
        if self.count < 0 { self.to_string() } else { format!("+{self}") }
    }
}

impl std::fmt::Display for Increments {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (one, size) = (10_u64.pow(self.decimals), self.count.unsigned_abs());
        let sign = if self.count < 0 { "-" } else { "" };
        write!(f, "{sign}{}.{:0width$}", size / one, size % one, width = self.decimals as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn increments_are_rounded_once() {
        let text = |length, decimals| Increments::of(length, decimals).to_string();
        assert_eq!(text(-0.0004, 3), "0.000");
        assert_eq!(text(-0.0006, 3), "-0.001");
        assert_eq!(text(152.412_96, 4), "152.4130");
        assert_eq!(text(3.0, 2), "3.00");
        let [base, wear] = Increments::split(10.000_4, 9.999_4, 3).map(|it| it.to_string());
        assert_eq!((base.as_str(), wear.as_str()), ("10.000", "-0.001"));
        assert_eq!(Increments::of(0.0, 3).signed(), "+0.000");
    }
}
