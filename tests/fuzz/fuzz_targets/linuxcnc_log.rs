#![no_main]

abbe_fuzz::target!("linuxcnc-log");
