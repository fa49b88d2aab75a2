#![no_main]

abbe_fuzz::target!("run-record");
