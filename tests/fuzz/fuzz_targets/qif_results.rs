#![no_main]

abbe_fuzz::target!("qif-results");
