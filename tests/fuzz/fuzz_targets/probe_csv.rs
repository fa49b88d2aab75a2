#![no_main]

abbe_fuzz::target!("probe-csv");
