//! The images to pose: those of a folder, or of lines that come in.

use std::io::{self, BufRead, Read};
use std::path::{Path, PathBuf};

use crate::error::{Error, Result};
use crate::files;

const ENDINGS: [&str; 4] = ["png", "jpg", "jpeg", "pgm"];

/// Largest number of bytes of a line: Linux's for a path.
const MAX_LINE: usize = 4096;

/// Returns the image files of a folder, by name.
///
/// # Errors
/// The folder cannot be read, or has no images.
pub fn of_folder(folder: &Path) -> Result<Vec<PathBuf>> {
    let failed =
        |error: io::Error| Error::new(format!("cannot be read: {error}")).of(folder.display());
    let entries =
        folder.read_dir().map_err(failed)?.collect::<io::Result<Vec<_>>>().map_err(failed)?;
    let mut paths: Vec<PathBuf> =
        entries.iter().map(std::fs::DirEntry::path).filter(|path| is_image(path)).collect();
    if paths.is_empty() {
        let endings = ENDINGS.join(", .");
        return Err(Error::new(format!("expected files that end in .{endings}, got none"))
            .of(folder.display()));
    }
    paths.sort();
    Ok(paths)
}

/// The camera of the images of a folder, as `ffpose render` writes it and `ffpose predict` takes it.
const CAMERA: &str = "camera.json";

/// Refuses a folder whose images are of a camera beside them, which is not taken unless it is named.
///
/// # Errors
/// There is one.
pub fn expect_no_camera(folder: &Path) -> Result<()> {
    let path = folder.join(CAMERA);
    if !files::exists(&path)? {
        return Ok(());
    }
    Err(Error::new(format!(
        "expected --camera {}, the camera beside the images, or --resize for that of the model, got neither",
        path.display()
    )))
}

/// Whether a path has the ending of an image, and is not hidden, as what macOS leaves beside each file.
fn is_image(path: &Path) -> bool {
    let is_hidden = path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b"."));
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase());
    !is_hidden && ending.is_some_and(|ending| ENDINGS.contains(&ending.as_str()))
}

/// The lines of an input, each a path in UTF-8.
pub struct Lines<R> {
    input: R,
    /// Whether the end of the last line has yet to come.
    is_within: bool,
}

/// A line, or the beginning of one that is too long.
#[derive(Debug, PartialEq)]
pub struct Line {
    /// What it names.
    pub path: PathBuf,
    is_whole: bool,
}

impl<R: BufRead> Lines<R> {
    /// The lines of `input`.
    pub fn new(input: R) -> Self {
        Self { input, is_within: false }
    }

    /// Returns the next line; `None` at the end. Of one that is too long it returns the beginning at once, and passes over the
    /// rest when it is called again.
    ///
    /// # Errors
    /// The input cannot be read.
    pub fn next_line(&mut self) -> Result<Option<Line>> {
        self.read_next()
            .map_err(|error| Error::new(format!("standard input cannot be read: {error}")))
    }

    fn read_next(&mut self) -> io::Result<Option<Line>> {
        if self.is_within {
            self.input.skip_until(b'\n')?;
        }
        let mut bytes = Vec::new();
        self.input.by_ref().take(MAX_LINE as u64 + 1).read_until(b'\n', &mut bytes)?;
        if bytes.is_empty() {
            return Ok(None);
        }
        self.is_within = bytes.len() > MAX_LINE && !bytes.ends_with(b"\n");
        bytes.truncate(MAX_LINE);
        let text = String::from_utf8_lossy(&bytes);
        let path = text.trim_end_matches(['\r', '\n']).into();
        Ok(Some(Line { path, is_whole: !self.is_within }))
    }
}

impl Line {
    /// Splits the line `TIME PATH` of a track at its first space; the path is empty where a frame never came.
    #[must_use]
    pub fn timed(&self) -> (&str, &Path) {
        let text = self.path.to_str().unwrap_or_default(); // it was made of a string
        let (time, path) = text.split_once(' ').unwrap_or((text, ""));
        (time, Path::new(path))
    }

    /// Refuses a line that is too long.
    ///
    /// # Errors
    /// It is.
    pub fn expect_whole(&self) -> Result<()> {
        if self.is_whole {
            return Ok(());
        }
        Err(Error::new(format!("expected a line of at most {MAX_LINE} bytes, got a longer one")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lines(mut input: &[u8]) -> Vec<Line> {
        let mut lines = Lines::new(&mut input);
        std::iter::from_fn(|| lines.next_line().unwrap()).collect()
    }

    #[test]
    fn each_line_is_a_path() {
        let paths = ["a b.png", "c.png", "", "last"];
        let expected = paths.map(|path| Line { path: path.into(), is_whole: true });
        assert_eq!(lines(b"a b.png\nc.png\r\n\nlast"), expected);
    }

    #[test]
    fn a_line_has_an_end() {
        let longest = "a".repeat(MAX_LINE);
        let input = format!("{longest}\n{longest}b\nb.png\n{}", longest.repeat(50));
        let whole: Vec<bool> = lines(input.as_bytes()).iter().map(|line| line.is_whole).collect();
        assert_eq!(whole, [true, false, true, false]);
        assert_eq!(lines(input.as_bytes())[2].path, Path::new("b.png"));
        let error = lines(input.as_bytes())[1].expect_whole().unwrap_err().to_string();
        assert_eq!(error, "expected a line of at most 4096 bytes, got a longer one");
        let mut endless = Lines::new(io::BufReader::new(io::repeat(b'a')));
        assert_eq!(endless.next_line().unwrap().unwrap().path, Path::new(&longest));
    }

    #[test]
    fn a_folder_gives_its_images() {
        let error = of_folder(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/src")))
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("expected files that end in .png, .jpg, .jpeg, .pgm, got none"),
            "{error}"
        );
        assert!(of_folder(Path::new("/nowhere/at/all")).is_err());
        for (name, expected) in
            [("a.PNG", true), ("a.pgm", true), ("b.jpeg", true), ("gt.csv", false), ("png", false)]
        {
            assert_eq!(is_image(Path::new(name)), expected, "{name}");
            assert!(!is_image(&Path::new("a").join(format!("._{name}"))));
        }
    }
}
