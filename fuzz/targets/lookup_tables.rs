#![no_main]

wavex_fuzz::target!(lookup_tables);
