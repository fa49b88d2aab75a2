#![no_main]

abbe_fuzz::target!("program-linuxcnc");
