//! Images as RGB, 8 bits a channel, and the files that hold them.

use std::path::Path;

use crate::codecs::{jpeg, pgm, png};
use crate::error::{Error, Result};
use crate::files;
use crate::levels::White;

/// Largest number of pixels, Pillow's too: 256 MB of RGB.
pub const MAX_PIXELS: usize = 89_478_485;

/// Largest width and height, which bounds what a resize weighs pixels with; JPEG's too.
pub const MAX_SIDE: usize = u16::MAX as usize;

/// Largest number of bytes of a file.
const MAX_BYTES: u64 = 1 << 28;

/// An RGB image.
#[derive(Debug, PartialEq)]
pub struct Picture {
    /// In pixels.
    pub width: usize,
    /// In pixels.
    pub height: usize,
    /// Red, green and blue, `(height, width, 3)`.
    pub pixels: Vec<u8>,
}

impl Picture {
    /// Reads a file, whose kind shows in its first bytes; transparency is dropped.
    ///
    /// `white` becomes 255 in gray images of more than 8 bits.
    ///
    /// # Errors
    /// It is no file that can be read, no PNG, JPEG or PGM, damaged or cut short, has more than 8 bits and no level that is white,
    /// or is too large.
    pub fn read(path: &Path, white: Option<White>) -> Result<Self> {
        Self::decode(&files::read(path, MAX_BYTES)?, white)
    }

    fn decode(data: &[u8], white: Option<White>) -> Result<Self> {
        if data.starts_with(png::MAGIC) {
            png::decode(data, white)
        } else if data.starts_with(jpeg::MAGIC) {
            jpeg::decode(data)
        } else if data.starts_with(pgm::MAGIC) {
            pgm::decode(data, white)
        } else {
            let start = data[..data.len().min(8)].escape_ascii();
            Err(Error::new(format!(
                "expected a PNG, JPEG or PGM file, got one that begins with \"{start}\""
            )))
        }
    }

    /// An image of samples whose channels are gray or RGB, and transparency behind them or not.
    pub fn from_samples(width: usize, height: usize, samples: Vec<u8>, channels: usize) -> Self {
        let pixels = match channels {
            3 => samples,
            4 => samples.chunks_exact(4).flat_map(|pixel| [pixel[0], pixel[1], pixel[2]]).collect(),
            _ => samples.chunks_exact(channels).flat_map(|pixel| [pixel[0]; 3]).collect(),
        };
        Self { width, height, pixels }
    }
}

/// Refuses an image of no pixels, or of too many.
///
/// # Errors
/// It is one.
pub fn expect_size(width: usize, height: usize) -> Result<()> {
    let is_side = |side| (1..=MAX_SIDE).contains(&side);
    if !is_side(width) || !is_side(height) || width * height > MAX_PIXELS {
        return Err(Error::new(format!(
            "expected an image of 1 to {MAX_SIDE} pixels a side and at most {MAX_PIXELS} in all, got {width}x{height}"
        )));
    }
    Ok(())
}

/// Returns the level that is white in an image of more than 8 bits.
///
/// # Errors
/// There is none.
pub fn white_of(white: Option<White>) -> Result<White> {
    white.ok_or_else(|| {
        Error::new(
            "expected 8 bits a channel, got more, for which a level must be white: the model's weights state none",
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_files_are_refused() {
        for (data, message) in [
            (&b""[..], "expected a PNG, JPEG or PGM file, got one that begins with \"\""),
            (b"GIF89a", "got one that begins with \"GIF89a\""),
            (b"P6 2 1 255 ", "got one that begins with \"P6 2 1 2\""),
        ] {
            let error = Picture::decode(data, None).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
    }

    #[test]
    fn sizes_are_bounded() {
        for (width, height) in [(1, MAX_SIDE), (MAX_SIDE, 1365), (9459, 9459)] {
            expect_size(width, height).unwrap();
        }
        for (width, height) in [(0, 1), (1, 0), (1, 1 << 16), (usize::MAX, 2), (9460, 9460)] {
            let error = expect_size(width, height).unwrap_err().to_string();
            assert!(error.ends_with(&format!("got {width}x{height}")), "{error}");
        }
    }
}
