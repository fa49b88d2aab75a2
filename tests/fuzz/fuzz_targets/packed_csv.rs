#![no_main]

abbe_fuzz::target!("packed-csv");
