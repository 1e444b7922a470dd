//! Formats of recordings: reader stages, extensions and companion files.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

use super::container::ContainerReader;
use super::extensions::{
    COMPRESSED_PACKETS, COMPRESSED_PULSES, COMPRESSED_WAVES, HDF5, LAS, LAZ, PACKETS, PULSES, SPD, WAVES,
    WFM, beside, by_stem, extension, folder_of, has_extension, usual_names,
};
use super::{Error, Result, las, pulsewaves, unsupported};

/// Reads the times of the first and the last shot of a recording, s.
pub type FirstLastTime = fn(&Path) -> Result<Option<[f64; 2]>>;

/// Format of a recording.
#[derive(Debug)]
pub struct RecordingFormat {
    /// Name of the stage that reads the format.
    pub reader: &'static str,
    /// Extensions, in lower case.
    pub extensions: &'static [&'static str],
    /// Extensions of companion files with the waveforms, in lower case.
    pub companions: &'static [&'static str],
    /// Reads the number of shots from the header of a file; `None` if headers do not have it.
    pub shot_count: Option<fn(&Path) -> Result<u64>>,
    /// What headers count instead of shots, of which there are about as many; `None` if they count shots.
    pub counted: Option<&'static str>,
    /// Reads the times of the first and the last record, s, as stored; `None` if this needs the whole file.
    pub first_last_s: Option<FirstLastTime>,
}

/// All supported formats, in the order of the manual.
pub const FORMATS: &[RecordingFormat] = &[
    RecordingFormat {
        reader: "read_las",
        extensions: &[LAS, LAZ],
        companions: &[PACKETS, COMPRESSED_PACKETS],
        shot_count: Some(first_returns_of_las),
        counted: Some("first returns by the header, or else of points"),
        first_last_s: Some(times_of_las),
    },
    RecordingFormat {
        reader: "read_pulsewaves",
        extensions: &[PULSES, COMPRESSED_PULSES],
        companions: &[WAVES, COMPRESSED_WAVES],
        shot_count: Some(|path| Ok(pulsewaves::Reader::open(path)?.pulse_count())),
        counted: None,
        first_last_s: Some(times_of_pulsewaves),
    },
    RecordingFormat {
        reader: "read_sdf",
        extensions: &["sdf", WFM],
        companions: &[],
        shot_count: None,
        counted: None,
        first_last_s: None,
    },
    RecordingFormat {
        reader: "read_arrow",
        extensions: &["arrow"],
        companions: &[],
        shot_count: None,
        counted: None,
        first_last_s: Some(times_of_container),
    },
    RecordingFormat {
        reader: "read_hdf5",
        extensions: &[HDF5, "hdf5", SPD],
        companions: &[],
        shot_count: None,
        counted: None,
        first_last_s: None,
    },
];

impl RecordingFormat {
    /// Format of a recording, by its extension in any case; `None` if unknown.
    pub fn of(recording: &Path) -> Option<&'static RecordingFormat> {
        let extension = extension(recording);
        FORMATS.iter().find(|format| format.extensions.contains(&extension.as_str()))
    }

    /// Format that a stage reads; `None` if it reads none.
    pub fn read_by(stage: &str) -> Option<&'static RecordingFormat> {
        FORMATS.iter().find(|format| format.reader == stage)
    }

    /// All extensions, as in ".las, .laz and .arrow".
    pub fn all_extensions() -> String {
        let all = FORMATS.iter().flat_map(|format| format.extensions);
        let mut all: Vec<String> = all.map(|extension| format!(".{extension}")).collect();
        let last = all.pop().unwrap_or_default();
        format!("{} and {last}", all.join(", "))
    }
}

/// Stage that reads files with this extension.
///
/// # Errors
/// If the format is not supported, with an alternative if one is known.
pub fn reader_of(input: &str) -> std::result::Result<&'static str, String> {
    if let Some(error) = unsupported(Path::new(input)) {
        return Err(error.to_string());
    }
    let format = RecordingFormat::of(Path::new(input)).map(|format| format.reader);
    format.ok_or_else(|| {
        format!(
            "{input}: unknown recording format; supported extensions: {}",
            RecordingFormat::all_extensions()
        )
    })
}

/// Stage that reads files with this extension, of recordings with small footprints.
///
/// # Errors
/// As [`reader_of`], and for recordings with large footprints.
pub fn small_footprint_reader_of(input: &str) -> std::result::Result<&'static str, String> {
    match reader_of(input)? {
        "read_hdf5" if !has_extension(Path::new(input), SPD) => Err(format!(
            "{input}: its waveforms are profiles of large footprints, which this command does not decompose; \
             `wavex init {input} job.toml` writes a job that measures ground and heights, `wavex explain` measures one shot, and `wavex view {input}` shows all"
        )),
        reader => Ok(reader),
    }
}

/// Number of first returns in the header of a LAS file, or of points if first returns are not counted.
///
/// Near the number of shots: several points of a shot may be first returns, as of two receivers, and shots may lack
/// theirs.
fn first_returns_of_las(path: &Path) -> Result<u64> {
    let reader = las::Reader::open(path)?;
    let header = reader.header();
    // Some writers do not count by return.
    let is_counted = |first: &u64| *first > 0 && *first <= header.n_points;
    Ok(header.n_points_by_return.first().copied().filter(is_counted).unwrap_or(header.n_points))
}

/// Times of the first and the last point of a LAS file.
fn times_of_las(path: &Path) -> Result<Option<[f64; 2]>> {
    let mut reader = las::Reader::open(path)?;
    let mut point = las::Point::default();
    let mut times_s = [0.0; 2];
    for (at, time_s) in [0, reader.header().n_points.saturating_sub(1)].into_iter().zip(&mut times_s) {
        reader.seek(at)?;
        if !reader.next_point(&mut point)? {
            return Ok(None);
        }
        *time_s = point.gps_time;
    }
    Ok(Some(times_s))
}

/// Times of the first and the last pulse of a PulseWaves file.
fn times_of_pulsewaves(path: &Path) -> Result<Option<[f64; 2]>> {
    let mut reader = pulsewaves::Reader::open(path)?;
    let Some(last) = reader.pulse_count().checked_sub(1) else { return Ok(None) };
    Ok(Some([reader.pulse(0)?.gps_time_s, reader.pulse(last)?.gps_time_s]))
}

/// Times of the first and the last shot of a container; `None` for a stream.
fn times_of_container(path: &Path) -> Result<Option<[f64; 2]>> {
    let mut reader = ContainerReader::open(path)?;
    reader.skip_samples();
    let first_s = reader.next_line()?.filter(|line| line.rows() > 0).and_then(|line| line.shot(0).gps_time_s);
    if !reader.seek_last() {
        return Ok(None);
    }
    let last = reader.next_line()?.filter(|line| line.rows() > 0);
    let last_s = last.and_then(|line| line.shot(line.rows() - 1).gps_time_s);
    Ok(first_s.zip(last_s).map(|(first_s, last_s)| [first_s, last_s]))
}

/// Extensions of the companion files of a recording.
fn companion_extensions(recording: &Path) -> &'static [&'static str] {
    RecordingFormat::of(recording).map_or(&[], |format| format.companions)
}

/// Companion files of a recording, at most one of each extension.
///
/// Their extensions may have any case; lower case is preferred.
pub fn companions(recording: &Path) -> Vec<PathBuf> {
    companion_extensions(recording).iter().filter_map(|extension| beside(recording, extension)).collect()
}

/// Companion files of a recording; for each missing one, the names that it would usually have.
pub fn companion_names(recording: &Path) -> Vec<PathBuf> {
    let names = |extension: &&str| {
        beside(recording, extension).map_or(usual_names(recording, extension).to_vec(), |found| vec![found])
    };
    companion_extensions(recording).iter().flat_map(names).collect()
}

/// Companion files of many recordings; lists each folder once.
#[derive(Clone, Debug, Default)]
pub struct CompanionIndex {
    /// Files with the extension of a companion, by folder and stem.
    folders: BTreeMap<PathBuf, BTreeMap<OsString, Vec<PathBuf>>>,
}

impl CompanionIndex {
    /// Files with the stem of a recording and an extension of its companions, in any case.
    ///
    /// Empty if the folder is missing or the user has no permission to list it.
    ///
    /// # Errors
    /// If listing the folder fails for another reason.
    pub fn of(&mut self, recording: &Path) -> Result<Vec<PathBuf>> {
        let wanted = companion_extensions(recording);
        if wanted.is_empty() {
            return Ok(Vec::new());
        }
        let folder = folder_of(recording);
        if !self.folders.contains_key(folder) {
            let files = by_stem(folder, is_companion).map_err(Error::io(folder, "list"))?;
            self.folders.insert(folder.to_owned(), files);
        }
        let Some(files) = self.folders.get(folder) else { return Ok(Vec::new()) };
        let of_stem = files.get(recording.file_stem().unwrap_or_default()).map_or(&[][..], Vec::as_slice);
        Ok(of_stem.iter().filter(|other| wanted.contains(&extension(other).as_str())).cloned().collect())
    }
}

fn is_companion(extension: &str) -> bool {
    FORMATS.iter().any(|format| format.companions.contains(&extension))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn extensions_belong_to_one_format() {
        let mut all: Vec<&str> = FORMATS.iter().flat_map(|format| format.extensions).copied().collect();
        all.extend(FORMATS.iter().flat_map(|format| format.companions));
        let count = all.len();
        all.sort_unstable();
        all.dedup();
        assert_eq!(all.len(), count);
        for format in FORMATS {
            for extension in format.extensions {
                let name = format!("a.{}", extension.to_uppercase());
                assert_eq!(RecordingFormat::of(Path::new(&name)).unwrap().reader, format.reader);
            }
        }
        assert!(
            RecordingFormat::of(Path::new("a.wdp")).is_none()
                && RecordingFormat::of(Path::new("las")).is_none()
        );
    }

    /// Names in order of preference; the index finds all of them.
    #[test]
    fn companion_extensions_have_any_case_and_lower_case_is_preferred() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        for (recording, names) in [
            ("a.pls", &["a.wvs", "a.WVS", "a.Wvs"][..]),
            ("a.PLS", &["a.wvs", "a.WVS", "a.WvS", "a.wVs"]),
            ("b.las", &["b.wdp", "b.WDP", "b.Wdp"]),
            ("b.LAZ", &["b.wdp", "b.WDP", "b.wDp"]),
            ("b.laz", &["b.wdz", "b.WDZ", "b.wDz"]),
            ("c.plz", &["c.wvz", "c.WVZ", "c.wVz"]),
            ("c.PLZ", &["c.wvs", "c.WVS"]),
        ] {
            names.iter().for_each(|name| fs::write(path(name), "").unwrap());
            for name in names {
                assert_eq!(companions(&path(recording)), [path(name)]);
                assert!(CompanionIndex::default().of(&path(recording)).unwrap().contains(&path(name)));
                fs::remove_file(path(name)).unwrap();
            }
            assert!(companions(&path(recording)).is_empty());
            assert!(CompanionIndex::default().of(&path(recording)).unwrap().is_empty());
        }
        fs::write(path("a.wdp"), "").unwrap();
        assert!(["a.pls", "a.arrow", "a"].iter().all(|name| companions(&path(name)).is_empty()));
        fs::write(path("a.wdz"), "").unwrap();
        assert_eq!(companions(&path("a.las")), ["a.wdp", "a.wdz"].map(path), "all are inputs");
    }

    #[test]
    fn folders_are_searched_for_all_extensions() {
        let searched = super::super::misplaced::RECORDINGS;
        for extension in FORMATS.iter().flat_map(|format| format.extensions) {
            assert!(searched.contains(extension), "{extension}");
        }
    }

    #[test]
    fn contents_of_all_formats_are_known() {
        let contents = super::super::other_format::CONTENTS.iter();
        let known: Vec<_> = contents.map(|format| (format.reader, format.extensions)).collect();
        let formats: Vec<_> = FORMATS.iter().map(|format| (format.reader, format.extensions)).collect();
        assert_eq!(known, formats);
    }

    #[test]
    fn the_extension_chooses_the_reader() {
        for (name, reader) in [
            ("a/B.LAS", "read_las"),
            ("b.laz", "read_las"),
            ("in/*.pls", "read_pulsewaves"),
            ("in/*.PLZ", "read_pulsewaves"),
            ("d.arrow", "read_arrow"),
            ("130621_101500.sdf", "read_sdf"),
            ("w.WFM", "read_sdf"),
        ] {
            assert_eq!(reader_of(name), Ok(reader));
        }
        let problem = "a.dat: unknown recording format; \
                       supported extensions: .las, .laz, .pls, .plz, .sdf, .wfm, .arrow, .h5, .hdf5 and .spd";
        assert_eq!(reader_of("a.dat"), Err(problem.to_owned()));
        let problem = small_footprint_reader_of("a.h5").unwrap_err();
        assert!(problem.contains("profiles of large footprints"), "{problem}");
        assert_eq!(small_footprint_reader_of("a.las"), Ok("read_las"));
        assert_eq!(small_footprint_reader_of("a.SPD"), Ok("read_hdf5"));
        for name in ["a.rxp", "a.f5"] {
            assert!(reader_of(name).unwrap_err().contains(" is not supported; "), "{name}");
        }
    }
}
