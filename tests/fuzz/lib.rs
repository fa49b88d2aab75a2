//! What every target of cargo-fuzz is made of.

pub use {abbe_campaigns, libfuzzer_sys};

/// A target of the campaign of this name, as a program of cargo-fuzz.
#[macro_export]
macro_rules! target {
    ($name:literal) => {
        $crate::libfuzzer_sys::fuzz_target!(|input: &[u8]| {
            thread_local! {
                static TARGET: $crate::abbe_campaigns::fuzz::Target = $crate::abbe_campaigns::fuzz::target($name);
            }
            // An answer and a refusal are both right; what panics is not.
            let _ = TARGET.with(|target| target.read(input));
        });
    };
}
