//! Converts between geodetic, projected and earth-centred coordinates.
//!
//! `forward` reads lines `longitude latitude height` (degrees, degrees, m on the system's
//! ellipsoid) and prints coordinates in a coordinate reference system. `inverse` reads such
//! coordinates and prints geodetic ones. `ecef` reads earth-centred coordinates, m.
//! `tests/python/check_crs.py` compares the results with other programs.
//!
//!     cargo run --example project -- EPSG:2154 forward < places.txt
//!     cargo run --example project -- zone.wkt inverse geoid=egm96 geoid_dir=geoids unit=us_ft < coordinates.txt
//!     cargo run --example project -- utm:33N wkt

use std::io::{BufRead, Write};
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use wavex_geodesy::crs::{Crs, Named, Unit};
use wavex_geodesy::ellipsoid::Geodetic;

fn main() -> Result<()> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [system, action, options @ ..] = words.as_slice() else {
        bail!("usage: project SYSTEM forward|inverse|ecef|wkt [geoid=NAME geoid_dir=FOLDER unit=m|ft|us_ft]");
    };
    let crs = system_of(system, options)?;
    let mut out = std::io::stdout().lock();
    if action == "wkt" {
        return Ok(writeln!(out, "{}", crs.wkt())?);
    }
    for line in std::io::stdin().lock().lines() {
        let line = line?;
        let numbers: Vec<f64> = line.split_whitespace().map(str::parse).collect::<Result<_, _>>()?;
        let point: [f64; 3] = numbers.try_into().ok().context("a line is three numbers")?;
        match act(&crs, action, point) {
            Ok([x, y, z]) => writeln!(out, "{x} {y} {z}")?,
            Err(error) => writeln!(out, "{error}")?,
        }
    }
    Ok(())
}

fn system_of(word: &str, options: &[String]) -> Result<Crs> {
    let option = |key: &str| options.iter().find_map(|word| word.strip_prefix(key)?.strip_prefix('='));
    let named = match Named::parse(word)? {
        Some(named) => named,
        None => Named::Wkt(std::fs::read_to_string(word).with_context(|| word.to_string())?),
    };
    let geoid = match option("geoid") {
        Some(name) => {
            Some(Arc::new(wavex_formats::geoid::find(Path::new(option("geoid_dir").unwrap_or(".")), name)?))
        }
        None => None,
    };
    let unit =
        option("unit").map(|word| Unit::of_word(word).context("the unit is m, ft or us_ft")).transpose()?;
    let nowhere = Geodetic { latitude_rad: 0.0, longitude_rad: 0.0, height_m: 0.0 };
    Ok(Crs::new(&named, nowhere, geoid, unit)?)
}

fn act(crs: &Crs, action: &str, point: [f64; 3]) -> Result<[f64; 3]> {
    let [x, y, z] = point;
    Ok(match action {
        "forward" => crs.from_geodetic(Geodetic {
            latitude_rad: y.to_radians(),
            longitude_rad: x.to_radians(),
            height_m: z,
        })?,
        "inverse" => {
            let place = crs.to_geodetic(point)?;
            [place.longitude_rad.to_degrees(), place.latitude_rad.to_degrees(), place.height_m]
        }
        "ecef" => crs.from_ecef(point)?,
        _ => bail!("{action}: not one of forward, inverse, ecef, wkt"),
    })
}
