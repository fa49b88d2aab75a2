#![no_main]

abbe_fuzz::target!("parquet");
