//! The floating-point state of a thread: a library may change how numbers are rounded, or that tiny ones are zero.
#![allow(unsafe_code, reason = "reads and writes a control register; every block says why it is sound")]

use std::sync::atomic::{AtomicBool, Ordering};

/// Rounding, traps and the treatment of subnormal numbers; the flags of past operations are left out.
pub(crate) fn state() -> u64 {
    #[cfg(target_arch = "x86_64")]
    {
        let mut register = 0_u32;
        // SAFETY: stores the register into the four bytes that the pointer is of.
        unsafe { std::arch::asm!("stmxcsr [{}]", in(reg) &raw mut register, options(nostack, preserves_flags)) };
        u64::from(register & !0x3f)
    }
    #[cfg(target_arch = "aarch64")]
    {
        let register: u64;
        // SAFETY: reads a register.
        unsafe { std::arch::asm!("mrs {}, fpcr", out(reg) register, options(nomem, nostack, preserves_flags)) };
        register
    }
    #[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
    {
        0
    }
}

fn set(state: u64) {
    #[cfg(target_arch = "x86_64")]
    {
        let register = state as u32;
        // SAFETY: loads a value that this register had before.
        unsafe { std::arch::asm!("ldmxcsr [{}]", in(reg) &raw const register, options(nostack, preserves_flags)) };
    }
    #[cfg(target_arch = "aarch64")]
    // SAFETY: writes a value that this register had before.
    unsafe {
        std::arch::asm!("msr fpcr, {}", in(reg) state, options(nomem, nostack, preserves_flags));
    }
    #[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
    let _ = state;
}

/// Whether a library has changed the state in this process.
static CHANGED: AtomicBool = AtomicBool::new(false);

/// Whether a library has changed the state in this process; the state was restored.
#[cfg(all(feature = "host", unix))]
pub(crate) fn changed() -> bool {
    CHANGED.load(Ordering::Relaxed)
}

/// Runs `work` and restores the state if `work` changed it.
pub(crate) fn kept<T>(work: impl FnOnce() -> T) -> T {
    let before = state();
    let result = work();
    if state() != before {
        CHANGED.store(true, Ordering::Relaxed);
        set(before);
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[cfg(target_arch = "x86_64")]
    fn flushing_subnormals_is_undone() {
        let before = state();
        kept(|| set(before | 0x8040));
        assert_eq!(state(), before);
        let tiny = std::hint::black_box(f64::MIN_POSITIVE) / 2.0;
        assert!(tiny > 0.0);
    }
}
