//! Random numbers of one trial. They do not depend on the thread and on the order of the trials.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use rand_distr::{ChiSquared, Distribution, StandardNormal, StudentT};

/// Random numbers of one trial of a Monte Carlo calculation.
///
/// Every trial has its own stream of the generator ChaCha8. So its numbers do not depend on how many numbers other trials
/// use. ChaCha passes the tests that JCGM 101:2008, C.3 asks a generator to pass, and repeats after 2^70 bytes of each of
/// 2^64 streams.
#[derive(Debug, Clone)]
pub struct Generator(ChaCha8Rng);

impl Generator {
    /// The numbers of trial `trial` of a calculation with `seed`, from their beginning.
    pub fn new(seed: u64, trial: u64) -> Self {
        let mut generator = ChaCha8Rng::seed_from_u64(seed);
        generator.set_stream(trial);
        Self(generator)
    }

    /// The numbers of trial `trial` from a place far behind their beginning, which others do not reach: 2^58 places, 1,024 numbers of 32
    /// bits apart. So what is drawn for one of many things depends neither on their order nor on who draws.
    ///
    /// ```
    /// use abbe_numerics::Generator;
    ///
    /// let of_row = |row: u64| Generator::at(1, 7, row << 6).normal();
    /// assert_eq!(of_row(12), of_row(12));
    /// assert_ne!(of_row(12), of_row(13));
    /// ```
    pub fn at(seed: u64, trial: u64, place: u64) -> Self {
        let mut generator = Self::new(seed, trial);
        generator.0.set_word_pos(u128::from(place >> 6) << 10);
        generator
    }

    /// A normal number of mean 0 and variance 1.
    pub fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }

    /// A number of a rectangular distribution of mean 0 and variance 1: between minus and plus the root of 3.
    pub fn uniform(&mut self) -> f64 {
        // 52 bits, in the middle of their steps: exact, symmetric, and never an end of the range.
        let fraction = ((self.0.next_u64() >> 12) as f64 + 0.5) / (1_u64 << 52) as f64;
        3.0_f64.sqrt() * (2.0 * fraction - 1.0)
    }

    /// A number of Student's distribution, scaled to variance 1; infinite degrees of freedom mean the normal one.
    ///
    /// NaN unless `degrees_of_freedom > 2`: there is no variance below.
    pub fn student(&mut self, degrees_of_freedom: f64) -> f64 {
        if degrees_of_freedom == f64::INFINITY {
            return self.normal();
        }
        match StudentT::new(degrees_of_freedom) {
            Ok(student) if degrees_of_freedom > 2.0 => {
                student.sample(&mut self.0) * (1.0 - 2.0 / degrees_of_freedom).sqrt()
            }
            _ => f64::NAN,
        }
    }

    /// The factor of all normal numbers of a trial that makes them Student's together: `sqrt(ν / χ²)` with the degrees of freedom ν
    /// (JCGM 101:2008, 6.4.9.4, for several quantities). It is 1 for infinite degrees of freedom.
    ///
    /// NaN unless `degrees_of_freedom > 0`.
    pub fn student_factor(&mut self, degrees_of_freedom: f64) -> f64 {
        if degrees_of_freedom == f64::INFINITY {
            return 1.0;
        }
        match ChiSquared::new(degrees_of_freedom) {
            Ok(chi_squared) => (degrees_of_freedom / chi_squared.sample(&mut self.0)).sqrt(),
            Err(_) => f64::NAN,
        }
    }

    /// An index of `0..count`, all with the same probability; 0 if `count` is 0.
    pub fn index(&mut self, count: usize) -> usize {
        // The high half of the product. Some indices are more probable than others by less than count / 2^64.
        ((u128::from(self.0.next_u64()) * count as u128) >> 64) as usize
    }
}

/// A number as good as a random one (the finaliser of SplitMix64: Steele, Lea and Flood 2014, OOPSLA). No two numbers give the same.
pub fn mixed(number: u64) -> u64 {
    let mut mixed = number.wrapping_add(0x9e37_79b9_7f4a_7c15);
    mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    mixed ^ (mixed >> 31)
}
