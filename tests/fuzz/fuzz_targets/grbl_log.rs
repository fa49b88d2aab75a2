#![no_main]

abbe_fuzz::target!("grbl-log");
