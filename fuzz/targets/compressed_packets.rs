#![no_main]

wavex_fuzz::target!(compressed_packets);
