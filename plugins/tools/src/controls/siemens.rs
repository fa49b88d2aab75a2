//! A program of SINUMERIK that sets cutting edge data and locks tools.

use std::fmt::Write as _;

use super::{Entry, Increments, Locked};

/// `$TC_DP3` and `$TC_DP6` are preset length and radius, `$TC_DP12` and `$TC_DP15` what is worn; bit 2 of `$TC_TP8` locks.
pub fn program(entries: &[Entry], locked: &[Locked], decimals: u32) -> String {
    let mut text = "; tool offsets, cutting edge 1\n".to_owned();
    for Entry { number, preset, value, recheck } in entries {
        if *recheck {
            let _ = writeln!(text, "; T{number} recheck");
        }
        for (place, [geometry, wear]) in [(0, [3, 12]), (1, [6, 15])] {
            let [base, more] = Increments::split(preset[place], value[place], decimals);
            let _ = writeln!(text, "$TC_DP{geometry}[{number},1]={base}\n$TC_DP{wear}[{number},1]={more}");
        }
    }
    for Locked { number, reason, .. } in locked {
        let _ = writeln!(text, "; T{number} locked: {reason}\n$TC_TP8[{number}]=$TC_TP8[{number}] B_OR 4");
    }
    text + "M30\n"
}
