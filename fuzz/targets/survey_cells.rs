#![no_main]

wavex_fuzz::target!(survey_cells);
