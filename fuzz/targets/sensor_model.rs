#![no_main]

wavex_fuzz::target!(sensor_model);
