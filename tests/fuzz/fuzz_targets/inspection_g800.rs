#![no_main]

abbe_fuzz::target!("inspection-g800");
