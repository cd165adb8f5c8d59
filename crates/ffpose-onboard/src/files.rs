//! Reading files whole: regular ones, up to a size, so that no file keeps the program waiting or fills its memory.

use std::fs::{File, FileType, OpenOptions};
use std::io::{self, Read};
use std::path::Path;

use crate::error::{Error, Result};

/// Returns the bytes of a regular file.
///
/// # Errors
/// It cannot be read, is a folder, named pipe, socket or device, or has more than `limit` bytes.
pub fn read(path: &Path, limit: u64) -> Result<Vec<u8>> {
    let failed = |error: io::Error| Error::new(format!("cannot be read: {error}"));
    let file = open(path).map_err(failed)?;
    let description = file.metadata().map_err(failed)?;
    if !description.is_file() {
        let kind = kind(description.file_type());
        return Err(Error::new(format!("expected a regular file, got {kind}")));
    }
    let mut data = Vec::new();
    if description.len() <= limit {
        // A file may grow meanwhile.
        file.take(limit + 1).read_to_end(&mut data).map_err(failed)?;
    }
    let size = description.len().max(data.len() as u64);
    if size > limit {
        return Err(Error::new(format!("expected a file of at most {limit} bytes, got {size}")));
    }
    Ok(data)
}

/// Whether there is a file, also one that cannot be read.
///
/// # Errors
/// Its folder does not tell.
pub fn exists(path: &Path) -> Result<bool> {
    path.try_exists()
        .map_err(|error| Error::new(format!("cannot be read: {error}")).of(path.display()))
}

/// Opens a file for reading, without waiting for the other end of a named pipe.
fn open(path: &Path) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.read(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::custom_flags(&mut options, libc::O_NONBLOCK);
    options.open(path)
}

fn kind(file: FileType) -> &'static str {
    #[cfg(unix)]
    if std::os::unix::fs::FileTypeExt::is_fifo(&file) {
        return "a named pipe";
    }
    if file.is_dir() { "a folder" } else { "a device or socket" }
}

#[cfg(test)]
mod tests {
    use std::env::temp_dir;
    use std::fs::{remove_file, write};
    use std::process::id;

    use super::*;

    fn refusal(path: &Path, limit: u64) -> String {
        read(path, limit).unwrap_err().to_string()
    }

    #[test]
    fn the_size_has_a_limit() {
        let path = temp_dir().join(format!("ffpose-onboard-files-{}", id()));
        write(&path, b"abc").unwrap();
        assert_eq!(read(&path, 3).unwrap(), b"abc");
        assert_eq!(refusal(&path, 2), "expected a file of at most 2 bytes, got 3");
        remove_file(&path).unwrap();
    }

    #[test]
    fn only_regular_files_are_read() {
        assert_eq!(refusal(&temp_dir(), 9), "expected a regular file, got a folder");
        assert!(refusal(Path::new("/nowhere/at/all"), 9).starts_with("cannot be read: "));
        assert!(exists(&temp_dir()).unwrap() && !exists(Path::new("/nowhere/at/all")).unwrap());
        #[cfg(unix)]
        {
            let zeros = refusal(Path::new("/dev/zero"), 9);
            assert_eq!(zeros, "expected a regular file, got a device or socket");
            let pipe = temp_dir().join(format!("ffpose-onboard-pipe-{}", id()));
            let made = std::process::Command::new("mkfifo").arg(&pipe).status().unwrap();
            assert!(made.success());
            assert_eq!(refusal(&pipe, 9), "expected a regular file, got a named pipe");
            remove_file(&pipe).unwrap();
        }
    }
}
