//! The images to pose: those of a folder, or of lines that come in.

use std::io::{self, BufRead};
use std::path::{Path, PathBuf};

use crate::error::{Error, Result};

const ENDINGS: [&str; 3] = ["png", "jpg", "jpeg"];

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

fn is_image(path: &Path) -> bool {
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase());
    ending.is_some_and(|ending| ENDINGS.contains(&ending.as_str()))
}

/// Returns the path in the next line, in UTF-8; `None` at the end.
///
/// # Errors
/// The input cannot be read.
pub fn next_line(input: &mut impl BufRead) -> Result<Option<PathBuf>> {
    let mut line = Vec::new();
    let read = input.read_until(b'\n', &mut line);
    if read.map_err(|error| Error::new(format!("standard input cannot be read: {error}")))? == 0 {
        return Ok(None);
    }
    let text = String::from_utf8_lossy(&line);
    Ok(Some(text.trim_end_matches(['\r', '\n']).into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_line_is_a_path() {
        let mut input = &b"a b.png\nc.png\r\n\nlast"[..];
        let mut paths = Vec::new();
        while let Some(path) = next_line(&mut input).unwrap() {
            paths.push(path);
        }
        assert_eq!(paths, ["a b.png", "c.png", "", "last"].map(PathBuf::from));
    }

    #[test]
    fn a_folder_gives_its_images() {
        let error = of_folder(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/src")))
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("expected files that end in .png, .jpg, .jpeg, got none"),
            "{error}"
        );
        assert!(of_folder(Path::new("/nowhere/at/all")).is_err());
        for (name, expected) in
            [("a.PNG", true), ("b.jpeg", true), ("gt.csv", false), ("png", false)]
        {
            assert_eq!(is_image(Path::new(name)), expected, "{name}");
        }
    }
}
