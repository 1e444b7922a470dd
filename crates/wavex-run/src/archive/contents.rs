//! Reads and writes the files of an archive, as a folder or a `.tar.zst`.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::{Read, Seek, Write};
use std::path::{Component, Path, PathBuf};

use super::digest;
use super::paths::plain;
use super::{ARCHIVE, Archive, FORMAT, JOB, RESOLVED, RESULTS, SEAL};
use wavex_formats::{Error, Result, regular_file};
use wavex_line::stage::own_file;

/// Extension of a packed archive.
const PACKED: &str = ".tar.zst";
/// Maximum total size of an archive's files, bytes; they are texts.
const MOST_BYTES: u64 = 1 << 30;
/// Maximum number of files of an archive.
const MOST_FILES: usize = 100_000;
/// Maximum number of folders within folders.
const MOST_DEPTH: usize = 16;
/// Maximum size of a long name or of other attributes of a packed file, bytes.
const MOST_ATTRIBUTES: u64 = 1 << 16;
/// Compression level: the default of zstd.
const LEVEL: i32 = 3;
const REMEDY: &str = "give an archive made by `wavex run --archive`";
/// Magic number of a zstd file (RFC 8878, section 3.1.1).
const MAGIC: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];
/// Extensions of other archive formats, and of incomplete forms of `.tar.zst`.
const OTHERS: [&str; 15] = [
    ".zip", ".tar", ".gz", ".tgz", ".bz2", ".tbz", ".tbz2", ".xz", ".txz", ".lzma", ".zst", ".tzst", ".7z",
    ".rar", ".lz4",
];

/// Files of an archive.
#[derive(Debug)]
pub(super) struct Contents {
    /// Path of the archive.
    path: PathBuf,
    /// Absolute path of the folder that the archive is, or unpacks to.
    folder: PathBuf,
    /// Contents by relative path.
    files: BTreeMap<String, Vec<u8>>,
}

/// Returns whether an archive of this name is packed into one file.
pub(super) fn is_packed(path: &Path) -> bool {
    path.file_name().is_some_and(|name| name.to_string_lossy().ends_with(PACKED))
}

/// Extension of another archive format, if the name has one.
pub(super) fn other_kind(path: &Path) -> Option<&'static str> {
    let name = path.file_name()?.to_string_lossy().to_lowercase();
    OTHERS.into_iter().find(|end| name.ends_with(end) && !is_packed(path))
}

/// Absolute path of the folder that an archive is, or unpacks to.
///
/// The folder need not exist, but its parent must.
pub(super) fn folder_of(path: &Path) -> Result<PathBuf> {
    let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let parent = parent.canonicalize().map_err(Error::io(parent, "find the folder"))?;
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    Ok(parent.join(name.strip_suffix(PACKED).unwrap_or(&name)))
}

impl Contents {
    /// Reads an archive without validating its files.
    ///
    /// # Errors
    /// If it is not an archive, or larger than 1 GiB.
    pub(super) fn read(path: &Path) -> Result<Contents> {
        let files = if path.is_dir() { read_files(path)? } else { read_packed(path)? };
        if files.is_empty() {
            return Err(Error::unusable(path, "not an archive: it contains no files", REMEDY));
        }
        if !files.contains_key(ARCHIVE) && !files.contains_key(SEAL) {
            return Err(Error::unusable(path, format!("not an archive: {ARCHIVE} is missing"), REMEDY));
        }
        // Normalise the path, so that it ends in a name even if given as `name/.`.
        let whole = plain(&std::path::absolute(path).map_err(Error::io(path, "find"))?);
        Ok(Contents { path: path.to_owned(), folder: folder_of(&whole)?, files })
    }

    /// Folder that the archive is, or unpacks to.
    pub(super) fn folder(&self) -> &Path {
        &self.folder
    }

    /// Parses the description of the archive.
    ///
    /// # Errors
    /// If the format version is unknown or the archive is damaged.
    pub(super) fn archive(&self) -> Result<Archive> {
        let text = self.text(ARCHIVE)?;
        let unusable = |problem: String| Error::unusable(&self.path.join(ARCHIVE), problem, REMEDY);
        let value: serde_json::Value =
            serde_json::from_str(text).map_err(|error| unusable(format!("invalid JSON: {error}")))?;
        if value["format"] != FORMAT {
            let problem =
                format!("archive format {} is not supported, only format {FORMAT}", value["format"]);
            return Err(Error::unusable(&self.path.join(ARCHIVE), problem, "use a newer wavex"));
        }
        let archive: Archive = serde_json::from_value(value)
            .map_err(|error| unusable(format!("invalid description of an archive: {error}")))?;
        let mut files = archive.inputs.files.iter().chain(&archive.outputs.files);
        match files.find(|file| !is_below(Path::new(&file.path))) {
            Some(file) => Err(unusable(format!("the path {:?} leads out of its folder", file.path))),
            None => Ok(archive),
        }
    }

    /// The job as run.
    pub(super) fn resolved_job(&self) -> Result<&str> {
        self.text(RESOLVED)
    }

    fn text(&self, name: &str) -> Result<&str> {
        let bytes = self.files.get(name);
        let text = bytes.and_then(|bytes| std::str::from_utf8(bytes).ok());
        text.ok_or_else(|| Error::unusable(&self.path, format!("not an archive: {name} is missing"), REMEDY))
    }

    /// Lists differences from the sealed state: changed, missing or added files.
    pub(super) fn tampering(&self) -> Vec<String> {
        let Ok(seal) = self.text(SEAL) else {
            return vec![format!("{SEAL}: missing: the integrity of the archive cannot be verified")];
        };
        let mut sealed: BTreeMap<&str, &str> = BTreeMap::new();
        let mut problems = Vec::new();
        for (at, line) in seal.lines().enumerate() {
            match line.split_once("  ") {
                Some((digest, name)) => drop(sealed.insert(name, digest)),
                None => problems.push(format!("{SEAL}: line {}: expected digest and name", at + 1)),
            }
        }
        for name in [ARCHIVE, JOB, RESOLVED] {
            if !sealed.contains_key(name) {
                problems.push(format!("{SEAL}: lacks the digest of {name}"));
            }
        }
        for (name, digest) in &sealed {
            match self.files.get(*name) {
                None => problems.push(format!("{name}: missing from the archive")),
                Some(bytes) if digest::of_bytes(bytes) != **digest => {
                    problems.push(format!(
                        "{name}: the file or its digest in {SEAL} was changed after the archive was made"
                    ));
                }
                Some(_) => {}
            }
        }
        let known = |name: &&String| *name != SEAL && !sealed.contains_key(name.as_str());
        problems
            .extend(self.files.keys().filter(known).map(|name| format!("{name}: not sealed: added later")));
        problems
    }

    /// Seal: the digest of the seal file, which covers the whole archive; empty if missing.
    pub(super) fn seal(&self) -> String {
        self.files.get(SEAL).map(|text| digest::of_bytes(text)).unwrap_or_default()
    }

    /// Digest of the results; none in archives without it.
    pub(super) fn results(&self) -> Option<String> {
        self.files.get(RESULTS).map(|text| digest::of_bytes(text))
    }

    /// Number of sealed files.
    pub(super) fn count(&self) -> usize {
        self.files.len().saturating_sub(1)
    }
}

fn too_large(path: &Path) -> Error {
    Error::unusable(path, format!("not an archive: larger than {MOST_BYTES} bytes"), REMEDY)
}

/// Reads to the end; `None` if the input exceeds the remaining limit.
fn read_whole(input: impl Read, left: &mut u64) -> std::io::Result<Option<Vec<u8>>> {
    let mut bytes = Vec::new();
    input.take(*left + 1).read_to_end(&mut bytes)?;
    let rest = left.checked_sub(bytes.len() as u64);
    *left = rest.unwrap_or(0);
    Ok(rest.map(|_| bytes))
}

/// Reads all files of a folder, by relative path.
pub(super) fn read_files(folder: &Path) -> Result<BTreeMap<String, Vec<u8>>> {
    let mut files = BTreeMap::new();
    read_folder(folder, "", MOST_DEPTH, &mut { MOST_BYTES }, &mut files)?;
    Ok(files)
}

fn read_folder(
    folder: &Path,
    prefix: &str,
    depth: usize,
    left: &mut u64,
    files: &mut BTreeMap<String, Vec<u8>>,
) -> Result<()> {
    for entry in folder.read_dir().map_err(Error::io(folder, "list"))? {
        let entry = entry.map_err(Error::io(folder, "list"))?;
        let path = entry.path();
        let name = format!("{prefix}{}", entry.file_name().to_string_lossy());
        let kind = entry.file_type().map_err(Error::io(&path, "open"))?;
        if kind.is_dir() && depth > 0 {
            read_folder(&path, &format!("{name}/"), depth - 1, left, files)?;
        } else if !kind.is_file() || files.len() >= MOST_FILES {
            let problem = match (kind.is_dir(), kind.is_file()) {
                (true, _) => format!("not an archive: more than {MOST_DEPTH} folders within each other"),
                (_, true) => format!("not an archive: more than {MOST_FILES} files"),
                _ => "not a file of an archive: a link, pipe or device".to_owned(),
            };
            return Err(Error::unusable(&path, problem, REMEDY));
        } else {
            let file = regular_file(&path)?;
            let bytes = read_whole(file, left).map_err(Error::io(&path, "read"))?;
            files.insert(name, bytes.ok_or_else(|| too_large(&path))?);
        }
    }
    Ok(())
}

fn read_packed(path: &Path) -> Result<BTreeMap<String, Vec<u8>>> {
    let mut file = regular_file(path)?;
    let mut begin = Vec::new();
    (&file).take(MAGIC.len() as u64).read_to_end(&mut begin).map_err(Error::io(path, "read"))?;
    if begin != MAGIC {
        return Err(Error::unusable(path, "not an archive: neither a folder nor a .tar.zst file", REMEDY));
    }
    let mut from_start = || file.rewind().and_then(|()| file.try_clone()).map_err(Error::io(path, "read"));
    if !is_moderate(from_start()?).map_err(|error| damaged(path, &error))? {
        return Err(too_large(path));
    }
    let unpacked = unpack(from_start()?).map_err(|error| damaged(path, &error))?;
    unpacked.ok_or_else(|| too_large(path))
}

/// The unpacked stream, up to the maximum size of an archive.
fn unpacked(packed: impl Read) -> std::io::Result<impl Read> {
    // Headers and padding take at most this much per file.
    let overhead = 1024 * MOST_FILES as u64;
    Ok(zstd::stream::read::Decoder::new(packed)?.take(MOST_BYTES + overhead))
}

/// Whether a packed archive has few enough entries with short enough names.
///
/// The names would be read into memory whole. The end of the stream is not checked.
fn is_moderate(packed: impl Read) -> std::io::Result<bool> {
    let mut tar = tar::Archive::new(unpacked(packed)?);
    for (count, entry) in tar.entries()?.raw(true).enumerate() {
        let entry = entry?;
        let kind = entry.header().entry_type();
        let is_long = !kind.is_file() && entry.header().size()? > MOST_ATTRIBUTES;
        // A long name is an entry of its own.
        if is_long || count >= 2 * MOST_FILES {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Unpacks an archive; `None` if its files are too large.
fn unpack(packed: impl Read) -> std::io::Result<Option<BTreeMap<String, Vec<u8>>>> {
    let (mut files, mut left) = (BTreeMap::new(), MOST_BYTES);
    let mut tar = tar::Archive::new(unpacked(packed)?);
    for entry in tar.entries()? {
        let entry = entry?;
        if !entry.header().entry_type().is_file() {
            continue;
        }
        let name = entry.path()?.into_owned();
        // The first component is the folder's own name.
        let steps: Vec<String> = name.components().filter_map(step).skip(1).collect();
        let Some(bytes) = read_whole(entry, &mut left)? else { return Ok(None) };
        files.insert(steps.join("/"), bytes);
    }
    // Read to the very end, so that truncation there is detected as well.
    Ok(read_whole(tar.into_inner(), &mut left)?.map(|_| files))
}

/// Error for a file that starts like a packed archive but cannot be unpacked.
fn damaged(path: &Path, error: &std::io::Error) -> Error {
    let problem = match error.kind() {
        std::io::ErrorKind::UnexpectedEof => {
            "damaged archive: the file is truncated, its data end too early".to_owned()
        }
        _ => format!("damaged or not an archive: cannot unpack it: {error}"),
    };
    Error::unusable(path, problem, "get a complete copy")
}

/// Whether a relative path stays below the folder at which it starts.
pub(super) fn is_below(path: &Path) -> bool {
    let mut steps = path.components();
    steps.clone().next().is_some() && steps.all(|step| matches!(step, Component::Normal(_)))
}

/// A normal path component; archives contain no others.
fn step(step: Component) -> Option<String> {
    match step {
        Component::Normal(step) => Some(step.to_string_lossy().into_owned()),
        _ => None,
    }
}

/// Text of the seal: one line per file with digest and path, in the format of `b3sum`.
pub(super) fn seal(files: &BTreeMap<String, Vec<u8>>) -> String {
    files.iter().map(|(name, bytes)| format!("{}  {name}\n", digest::of_bytes(bytes))).collect()
}

/// Writes files to a folder and syncs them to disk with their names.
pub(super) fn write_folder(folder: &Path, files: &BTreeMap<String, Vec<u8>>) -> Result<()> {
    let mut folders = BTreeSet::from([folder.to_path_buf()]);
    for (name, bytes) in files {
        let path = folder.join(name);
        let parent = path.parent().unwrap_or(folder);
        fs::create_dir_all(parent).map_err(Error::io(parent, "create the folder"))?;
        let mut file = fs::File::create(&path).map_err(Error::io(&path, "create"))?;
        file.write_all(bytes).and_then(|()| file.sync_all()).map_err(Error::io(&path, "write"))?;
        folders.insert(parent.to_path_buf());
    }
    folders
        .iter()
        .try_for_each(|folder| own_file::sync_folder(folder).map_err(Error::io(folder, "write the folder")))
}

/// Packs files as a folder of this name; `seconds` since 1970 is the time of all files.
pub(super) fn pack(
    name: &str,
    files: &BTreeMap<String, Vec<u8>>,
    seconds: u64,
    to: impl Write,
) -> std::io::Result<()> {
    let mut tar = tar::Builder::new(zstd::stream::write::Encoder::new(to, LEVEL)?);
    for (path, bytes) in files {
        let mut header = tar::Header::new_gnu();
        header.set_size(bytes.len() as u64);
        header.set_mode(0o644);
        header.set_mtime(seconds);
        tar.append_data(&mut header, format!("{name}/{path}"), bytes.as_slice())?;
    }
    tar.into_inner()?.finish()?.flush()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sealed(files: &[(&str, &str)]) -> BTreeMap<String, Vec<u8>> {
        let files = files.iter().map(|(name, text)| ((*name).to_owned(), text.as_bytes().to_vec()));
        let mut files: BTreeMap<String, Vec<u8>> = files.collect();
        files.insert(SEAL.to_owned(), seal(&files).into_bytes());
        files
    }

    fn example() -> BTreeMap<String, Vec<u8>> {
        let long = format!("lines/{}_lstat.txt", "a".repeat(120));
        sealed(&[
            (ARCHIVE, "{}"),
            (JOB, "a"),
            (RESOLVED, "b"),
            (&long, "# a name longer than a header's field"),
        ])
    }

    #[test]
    fn a_folder_and_a_packed_one_hold_the_same() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().canonicalize().unwrap();
        let files = example();
        write_folder(&folder.join("flight"), &files).unwrap();
        let packed = folder.join("flight.tar.zst");
        pack("flight", &files, 1_700_000_000, fs::File::create(&packed).unwrap()).unwrap();
        for path in [folder.join("flight"), packed, folder.join("flight/.")] {
            let contents = Contents::read(&path).unwrap();
            assert_eq!((&contents.files, contents.folder()), (&files, folder.join("flight").as_path()));
            assert_eq!((contents.tampering(), contents.count()), (vec![], 4));
        }
    }

    #[test]
    fn every_tampering_is_named() {
        let with = |change: fn(&mut BTreeMap<String, Vec<u8>>)| {
            let mut files = example();
            change(&mut files);
            Contents { path: "a".into(), folder: "a".into(), files }.tampering()
        };
        let changed =
            |files: &mut BTreeMap<String, Vec<u8>>| drop(files.insert(JOB.to_owned(), b"A".to_vec()));
        assert_eq!(
            with(changed),
            ["job.toml: the file or its digest in archive.b3 was changed after the archive was made"]
        );
        assert_eq!(with(|files| drop(files.remove(JOB))), ["job.toml: missing from the archive"]);
        let added = |files: &mut BTreeMap<String, Vec<u8>>| drop(files.insert("new".to_owned(), vec![]));
        assert_eq!(with(added), ["new: not sealed: added later"]);
        let unsealed = ["archive.b3: missing: the integrity of the archive cannot be verified"];
        assert_eq!(with(|files| drop(files.remove(SEAL))), unsealed);
        let emptied = with(|files| drop(files.insert(SEAL.to_owned(), b"x\n".to_vec())));
        assert_eq!(
            emptied[..2],
            ["archive.b3: line 1: expected digest and name", "archive.b3: lacks the digest of archive.json"]
        );
    }

    #[test]
    fn what_is_no_archive_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let problem = |path: &Path| {
            Contents::read(path).and_then(|contents| contents.archive()).unwrap_err().to_string()
        };
        let empty = problem(folder.path());
        assert!(
            empty.ends_with(
                "not an archive: it contains no files; give an archive made by `wavex run --archive`"
            ),
            "{empty}"
        );
        fs::write(folder.path().join("a.txt"), "").unwrap();
        let other = problem(folder.path());
        assert!(other.contains("not an archive: archive.json is missing; "), "{other}");
        fs::write(folder.path().join(ARCHIVE), "{\"format\": 2}").unwrap();
        let newer = problem(folder.path());
        assert!(
            newer.ends_with("archive format 2 is not supported, only format 1; use a newer wavex"),
            "{newer}"
        );
        fs::write(folder.path().join(ARCHIVE), "{\"format\": 1}").unwrap();
        let torn = problem(folder.path());
        assert!(torn.contains("invalid description of an archive: missing field"), "{torn}");
        for (name, content) in [("a.tar.zst", "not packed"), ("geo.toml", "[a]\n"), ("empty", "")] {
            fs::write(folder.path().join(name), content).unwrap();
            let other = problem(&folder.path().join(name));
            let expected = format!("{name}: not an archive: neither a folder nor a .tar.zst file; {REMEDY}");
            assert!(other.ends_with(&expected), "{other}");
        }
    }

    #[test]
    fn a_packed_archive_that_is_not_whole_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.tar.zst");
        let mut whole = Vec::new();
        pack("a", &example(), 1_700_000_000, &mut whole).unwrap();
        for length in MAGIC.len()..whole.len() {
            fs::write(&path, &whole[..length]).unwrap();
            let cut = Contents::read(&path).unwrap_err().to_string();
            let expected = "a.tar.zst: damaged archive: the file is truncated, its data end too early; get a complete copy";
            assert!(cut.ends_with(expected), "{length} of {}: {cut}", whole.len());
        }
        let no_tar = zstd::encode_all([7u8; 2000].as_slice(), LEVEL).unwrap();
        fs::write(&path, no_tar).unwrap();
        let other = Contents::read(&path).unwrap_err().to_string();
        let expected = "a.tar.zst: damaged or not an archive: cannot unpack it: ";
        assert!(other.contains(expected) && other.ends_with("; get a complete copy"), "{other}");
    }

    #[test]
    fn long_names_and_many_files_are_refused_before_they_take_memory() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.tar.zst");
        for kind in [tar::EntryType::GNULongName, tar::EntryType::XHeader] {
            let mut tar = tar::Builder::new(zstd::stream::write::Encoder::new(Vec::new(), LEVEL).unwrap());
            let mut header = tar::Header::new_gnu();
            header.set_entry_type(kind);
            header.set_size(MOST_ATTRIBUTES + 1);
            let name = vec![b'a'; MOST_ATTRIBUTES as usize + 1];
            tar.append_data(&mut header, "a", name.as_slice()).unwrap();
            fs::write(&path, tar.into_inner().unwrap().finish().unwrap()).unwrap();
            let error = Contents::read(&path).unwrap_err().to_string();
            assert!(error.contains("not an archive: larger than 1073741824 bytes"), "{error}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn links_and_deep_folders_in_an_archive_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        write_folder(folder, &example()).unwrap();
        std::os::unix::fs::symlink("/dev/zero", folder.join("endless")).unwrap();
        let error = Contents::read(folder).unwrap_err().to_string();
        assert!(error.contains("endless: not a file of an archive: a link, pipe or device; "), "{error}");
        fs::remove_file(folder.join("endless")).unwrap();
        fs::create_dir_all(folder.join("a/".repeat(MOST_DEPTH + 1))).unwrap();
        let error = Contents::read(folder).unwrap_err().to_string();
        assert!(error.contains("more than 16 folders within each other"), "{error}");
    }

    #[test]
    fn paths_that_leave_their_folder_are_refused() {
        assert!(is_below(Path::new("lines/a.txt")));
        for path in ["", "/etc/passwd", "../a", "a/../../b"] {
            assert!(!is_below(Path::new(path)), "{path}");
        }
    }

    #[test]
    fn other_kinds_of_archives_are_refused() {
        let found = ["a.zip", "b/x.tar.gz", "x.TGZ", "x.zst", "x.TAR.ZST", "x.tar"]
            .map(|name| other_kind(Path::new(name)));
        assert_eq!(found, [".zip", ".gz", ".tgz", ".zst", ".zst", ".tar"].map(Some));
        for name in ["flight7", "flight.tar.zst", "day.1", "zip", "a.zip/flight"] {
            assert_eq!(other_kind(Path::new(name)), None, "{name}");
        }
    }

    #[test]
    fn the_seal_is_the_digest_of_its_text() {
        let of = |files| Contents { path: "a".into(), folder: "a".into(), files }.seal();
        let files = example();
        assert_eq!(of(files.clone()), digest::of_bytes(&files[SEAL]));
        assert_eq!(of(BTreeMap::new()), "");
    }
}
