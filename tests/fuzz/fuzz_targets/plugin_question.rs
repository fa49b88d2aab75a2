#![no_main]

abbe_fuzz::target!("plugin-question");
