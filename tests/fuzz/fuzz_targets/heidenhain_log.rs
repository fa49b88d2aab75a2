#![no_main]

abbe_fuzz::target!("heidenhain-log");
