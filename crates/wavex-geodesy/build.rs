//! Compresses the area of use and the WKT of all EPSG codes; as text they would be a fifth of the program.
#![allow(clippy::print_stdout, reason = "cargo reads instructions from standard output")]

use std::collections::HashMap;
use std::error::Error;
use std::io::Write as _;
use std::path::PathBuf;
use std::{env, fs};

use flate2::Compression;
use flate2::write::DeflateEncoder;

/// Systems per block: one block is unpacked to look up a code.
const PER_BLOCK: usize = 64;

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-changed=areas_of_use.txt");
    let areas = fs::read_to_string("areas_of_use.txt")?;
    let boxes: HashMap<&str, &str> = areas
        .lines()
        .filter_map(|line| line.split_once(':'))
        .flat_map(|(area, codes)| codes.split_whitespace().map(move |code| (code, area)))
        .collect();
    // A few rows of the table are empty.
    let known = (0..=u16::MAX).filter_map(crs_definitions::from_code).filter(|known| !known.wkt.is_empty());
    let line = |code: u16, wkt: &str| {
        let code = code.to_string();
        format!("{code}\t{}\t{wkt}\n", boxes.get(code.as_str()).unwrap_or(&""))
    };
    let lines: Vec<(u16, String)> = known.map(|known| (known.code, line(known.code, known.wkt))).collect();
    let mut bytes = Vec::new();
    let mut blocks = Vec::new();
    for block in lines.chunks(PER_BLOCK) {
        blocks.push((block[0].0, bytes.len()));
        let mut encoder = DeflateEncoder::new(&mut bytes, Compression::best());
        for (_, line) in block {
            encoder.write_all(line.as_bytes())?;
        }
        encoder.finish()?;
    }
    let folder = PathBuf::from(env::var_os("OUT_DIR").ok_or("cargo sets OUT_DIR")?);
    fs::write(folder.join("epsg.deflate"), bytes)?;
    fs::write(folder.join("epsg_blocks.rs"), format!("&{blocks:?}"))?;
    Ok(())
}
