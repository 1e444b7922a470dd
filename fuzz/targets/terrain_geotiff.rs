#![no_main]

wavex_fuzz::target!(terrain_geotiff);
