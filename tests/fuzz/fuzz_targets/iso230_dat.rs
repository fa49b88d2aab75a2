#![no_main]

abbe_fuzz::target!("iso230-dat");
