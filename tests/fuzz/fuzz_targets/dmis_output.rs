#![no_main]

abbe_fuzz::target!("dmis-output");
