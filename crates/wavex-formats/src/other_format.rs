//! Recordings of another format than their reader expects, recognised by content and extension.

use std::path::Path;

use super::Error;
use super::extensions::{COMPRESSED_PULSES, HDF5, LAS, LAZ, PULSES, SPD, WFM, extension};

/// Content of a recording format.
pub(super) struct FormatContent {
    /// First bytes; empty if they are not known.
    signature: &'static [u8],
    /// Name of the format.
    name: &'static str,
    /// Stage that reads it.
    pub(super) reader: &'static str,
    /// Extensions, the usual one first.
    pub(super) extensions: &'static [&'static str],
}

/// All formats.
pub(super) const CONTENTS: [FormatContent; 5] = [
    FormatContent { signature: b"LASF", name: "LAS", reader: "read_las", extensions: &[LAS, LAZ] },
    FormatContent {
        signature: b"PulseWavesPulse",
        name: "PulseWaves",
        reader: "read_pulsewaves",
        extensions: &[PULSES, COMPRESSED_PULSES],
    },
    FormatContent { signature: b"", name: "SDF", reader: "read_sdf", extensions: &["sdf", WFM] },
    FormatContent { signature: b"ARROW1", name: "Arrow", reader: "read_arrow", extensions: &["arrow"] },
    FormatContent {
        signature: b"\x89HDF\r\n\x1a\n",
        name: "HDF5",
        reader: "read_hdf5",
        extensions: &[HDF5, "hdf5", SPD],
    },
];

/// Number of bytes that decide on the format.
pub const DECISIVE_BYTES: usize = 16;

/// Returns the error for a file that another stage reads; `None` if none is known.
///
/// `start` are its first bytes, at most; without a known signature in them, the extension decides.
pub fn other_format(path: &Path, start: &[u8], reader: &str) -> Option<Error> {
    let own = extension(path);
    let expected = CONTENTS.iter().find(|format| format.reader == reader)?.name;
    let by_content =
        CONTENTS.iter().find(|format| !format.signature.is_empty() && start.starts_with(format.signature));
    let by_extension = CONTENTS.iter().find(|format| format.extensions.contains(&own.as_str()));
    let found = by_content.or(by_extension).filter(|format| format.reader != reader)?;
    let problem = match by_content {
        Some(_) => format!("this is {}, not {expected}", found.name),
        None => format!("by its extension this is {}, not {expected}", found.name),
    };
    let rename = match (found.extensions.contains(&own.as_str()), found.extensions.first()) {
        (false, Some(usual)) => format!("rename it to .{usual}, and "),
        _ => String::new(),
    };
    Some(Error::unusable(path, problem, format!("{rename}read it with the stage `{}`", found.reader)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn content_is_stronger_than_extension() {
        for (name, start, reader, expected) in [
            (
                "a.laz",
                &b"LASF\x04"[..],
                "read_pulsewaves",
                "this is LAS, not PulseWaves; read it with the stage `read_las`",
            ),
            (
                "a.las",
                b"PulseWavesPulse\0",
                "read_las",
                "this is PulseWaves, not LAS; rename it to .pls, and read it with the stage `read_pulsewaves`",
            ),
            (
                "a.sdf",
                b"",
                "read_las",
                "by its extension this is SDF, not LAS; read it with the stage `read_sdf`",
            ),
            (
                "a.LAZ",
                b"",
                "read_sdf",
                "by its extension this is LAS, not SDF; read it with the stage `read_las`",
            ),
        ] {
            let error = other_format(Path::new(name), start, reader).map(|error| error.to_string());
            assert_eq!(error, Some(format!("{name}: {expected}")));
        }
        for (name, start, reader) in [
            ("a.las", &b"text"[..], "read_las"),
            ("a.txt", b"text", "read_las"),
            ("a.pls", b"LASF", "read_las"),
        ] {
            assert!(other_format(Path::new(name), start, reader).is_none(), "{name}");
        }
    }
}
