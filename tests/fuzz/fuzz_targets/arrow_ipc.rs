#![no_main]

abbe_fuzz::target!("arrow-ipc");
