//! A model's file in memory: what is checked is what runs.

use std::path::Path;

use sha2::{Digest, Sha256};

use crate::error::{Error, Result};
use crate::files;
use crate::graph::expect_self_contained;
use crate::metadata::Metadata;

/// Largest number of bytes, that of a protobuf message.
const MAX_BYTES: u64 = i32::MAX as u64;

/// A model that was checked.
pub struct Model {
    /// What it says of itself.
    pub metadata: Metadata,
    /// The ONNX file.
    pub bytes: Vec<u8>,
    /// Its SHA-256.
    pub digest: [u8; 32],
}

impl Model {
    /// Reads a model's file, once.
    ///
    /// # Errors
    /// It is no file that can be read, or not the one of SHA-256 `digest`, which `source` gives; no ONNX file, not of `ffpose
    /// export`, altered, or newer than this program; or it needs another file.
    pub fn read(path: &Path, digest: Option<&str>, source: &str) -> Result<Self> {
        let bytes = files::read(path, MAX_BYTES);
        bytes
            .and_then(|bytes| Self::of(bytes, digest, source))
            .map_err(|error| error.of(path.display()))
    }

    fn of(bytes: Vec<u8>, digest: Option<&str>, source: &str) -> Result<Self> {
        let own = Sha256::digest(&bytes);
        let got = format!("{own:x}");
        if let Some(digest) = digest.filter(|digest| *digest != got) {
            return Err(Error::new(format!("expected SHA-256 {digest} ({source}), got {got}")));
        }
        let metadata = Metadata::of(&bytes)?;
        expect_self_contained(&bytes)?;
        Ok(Self { metadata, digest: own.into(), bytes })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_digest_is_told_before_anything_is_read() {
        // FIPS 180-4's example
        let digest = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        let error = |digest| {
            let model = Model::of(b"abc".to_vec(), Some(digest), "--sha256");
            model.err().unwrap().to_string()
        };
        assert!(error(digest).contains("expected an ONNX file"));
        let other = "0".repeat(64);
        assert_eq!(error(&other), format!("expected SHA-256 {other} (--sha256), got {digest}"));
    }
}
