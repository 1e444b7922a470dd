#![no_main]

wavex_fuzz::target!(returns);
