#![no_main]

wavex_fuzz::target!(trajectory_text);
