#![no_main]

abbe_fuzz::target!("siemens-log");
