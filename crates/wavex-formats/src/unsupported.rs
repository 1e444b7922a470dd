//! Recording formats that wavex cannot read, recognised by extension, with workarounds.

use std::path::Path;

use super::Error;
use super::extensions::extension;
use super::misplaced::misplaced;

/// Extensions, problem and remedy of each format.
const UNSUPPORTED: [(&[&str], &str, &str); 2] = [
    (
        &["rxp"],
        "RIEGL RXP is not supported",
        "export the waveforms with RIEGL's software as .sdf or .wfm, or as LAS 1.3 or 1.4 with waveforms, and read that",
    ),
    (
        &["f5"],
        "F5, the layout of HydroVISH in HDF5, is not supported",
        "copy its waveforms into the open waveform container (.arrow), for example with h5py and pyarrow: schemas/container.json \
         lists the columns, examples/write_container.rs writes one",
    ),
];

/// Returns the error for a known but unsupported format, or for a path that is no recording.
///
/// `None` for all other paths.
pub fn unsupported(path: &Path) -> Option<Error> {
    let own = extension(path);
    let known = UNSUPPORTED.iter().find(|(extensions, ..)| extensions.contains(&own.as_str()));
    known.map(|(_, problem, remedy)| Error::unusable(path, *problem, *remedy)).or_else(|| misplaced(path))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_that_cannot_be_read_have_a_way_round() {
        for (name, begins) in [
            ("a.rxp", "a.rxp: RIEGL RXP is not supported; export "),
            ("a.f5", "a.f5: F5, the layout of HydroVISH in HDF5, is not supported; copy "),
        ] {
            let error = unsupported(Path::new(name)).unwrap().to_string();
            assert!(error.starts_with(begins), "{error}");
        }
        assert!(["a.las", "rxp", "a"].iter().all(|name| unsupported(Path::new(name)).is_none()));
    }
}
