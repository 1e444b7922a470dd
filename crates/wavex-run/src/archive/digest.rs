//! Digests of files.

use std::io::{ErrorKind, Read};
use std::path::Path;

use wavex_formats::{Error, Result, regular_file};

/// Buffer size, bytes.
const BUFFER: usize = 1 << 20;

/// Size and BLAKE3 digest of a regular file.
pub(crate) fn of_file(path: &Path) -> Result<(u64, String)> {
    let mut file = regular_file(path)?;
    let mut hasher = blake3::Hasher::new();
    let mut buffer = vec![0; BUFFER];
    loop {
        let read = match file.read(&mut buffer) {
            Err(error) if error.kind() == ErrorKind::Interrupted => continue,
            read => read.map_err(Error::io(path, "read"))?,
        };
        match buffer.get(..read) {
            None | Some([]) => break,
            Some(bytes) => hasher.update(bytes),
        };
    }
    Ok((hasher.count(), hasher.finalize().to_hex().to_string()))
}

/// BLAKE3 digest of a file.
pub fn digest_of(path: &Path) -> Result<String> {
    of_file(path).map(|(_, digest)| digest)
}

/// BLAKE3 digest of bytes in memory.
pub(super) fn of_bytes(bytes: &[u8]) -> String {
    blake3::hash(bytes).to_hex().to_string()
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn digests_are_those_of_b3sum() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        fs::write(&path, "").unwrap();
        // Test vector of BLAKE3 for input length 0.
        let nothing = "af1349b9f5f9a1a6a0404dea36dcc9499bcb25c9adc112b7cc9a93cae41f3262";
        assert_eq!(of_file(&path).unwrap(), (0, nothing.to_owned()));
        assert_eq!(of_bytes(b""), nothing);
        // Test vector for input length 102400: bytes 0 to 250, repeated.
        let bytes: Vec<u8> = (0..102_400u32).map(|at| (at % 251) as u8).collect();
        fs::write(&path, &bytes).unwrap();
        let expected = "bc3e3d41a1146b069abffad3c0d44860cf664390afce4d9661f7902e7943e085";
        assert_eq!(of_file(&path).unwrap(), (102_400, expected.to_owned()));
    }
}
