//! Recognition of products by their groups and data sets.

use std::path::Path;

use wavex_formats::{Error, Result};

use super::group::{Link, links};
use super::input::{COPY_AGAIN, Input};
use super::{gedi, lvis, spd, superblock};

/// Most groups that are named like beams; GEDI has eight.
const MOST_BEAMS: usize = 64;

/// Product of an HDF5 file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Product {
    /// GEDI L1B: waveforms of up to eight beams.
    GediL1b,
    /// LVIS L1B: waveforms of one beam.
    LvisL1b,
    /// SPD: pulses of a laser scanner.
    Spd,
}

/// Recognises the product of a file.
///
/// # Errors
/// If the file cannot be read, or has no waveforms that are supported; the message says what it has.
pub fn product_of(path: &Path) -> Result<Product> {
    let mut input = Input::open(path)?;
    let root = superblock::root(&mut input)?;
    let root = links(&input, root)?;
    recognise(&input, &root)
}

/// Recognises a product by the members of the root group.
pub fn recognise(input: &Input, root: &[Link]) -> Result<Product> {
    if lvis::has_waveforms(root) {
        return Ok(Product::LvisL1b);
    }
    let has = |name: &str| root.iter().any(|(link, _)| link.eq_ignore_ascii_case(name));
    let refused = |problem: &str, remedy: &str| Err(Error::unusable(input.path(), problem, remedy));
    let mut results = false;
    let beams = || root.iter().filter(|(name, _)| name.starts_with("BEAM"));
    // Links to the same group of many members would take time in proportion to the product of both.
    if beams().count() > MOST_BEAMS {
        return refused(&format!("{} beams, at most {MOST_BEAMS}", beams().count()), COPY_AGAIN);
    }
    for (_, at) in beams() {
        let members = links(input, *at)?;
        if gedi::has_waveforms(&members) {
            return Ok(Product::GediL1b);
        }
        results |= members
            .iter()
            .any(|(name, _)| matches!(name.as_str(), "rh" | "pai" | "agbd" | "elev_lowestmode"));
    }
    if results {
        let problem = "GEDI L2 or L4: it holds results, not waveforms";
        return refused(problem, "give the GEDI01_B file of the same orbit");
    }
    if beams().count() > 0 {
        return refused("a GEDI file whose beams have no waveforms", "give a whole GEDI01_B file");
    }
    if spd::is_spd(input, root)? {
        return Ok(Product::Spd);
    }
    if has("SHOTNUMBER") || has("RXWAVE") {
        return refused("an LVIS file without RXWAVE, SHOTNUMBER or Z0", "give the level 1B file");
    }
    const MOST_NAMES: usize = 8;
    let names: Vec<&str> = root.iter().take(MOST_NAMES).map(|(name, _)| name.as_str()).collect();
    let more = if root.len() > MOST_NAMES { ", ..." } else { "" };
    let problem =
        format!("neither GEDI L1B nor LVIS L1B nor SPD; its root group has: {}{more}", names.join(", "));
    refused(&problem, "give a file of these products")
}
