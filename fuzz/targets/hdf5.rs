#![no_main]

wavex_fuzz::target!(hdf5);
