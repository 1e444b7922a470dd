#![no_main]

wavex_fuzz::target!(archive_tar);
