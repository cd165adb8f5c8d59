//! PGM files: gray levels as they are, behind a line of text.
//!
//! See <https://netpbm.sourceforge.net/doc/pgm.html>; of its two forms the binary one, of the magic number P5.

#![allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // of numbers from 0 to 255

use crate::error::{Error, Result};
use crate::levels::White;
use crate::picture::{Picture, expect_size, white_of};

/// What a file begins with.
pub const MAGIC: &[u8] = b"P5";

/// Reads an image.
///
/// # Errors
/// It is damaged, cut short, too large, or of more than 8 bits and no level is said to be white.
pub fn decode(data: &[u8], white: Option<White>) -> Result<Picture> {
    let mut header = Header { data, place: MAGIC.len() };
    if !header.data.get(header.place).is_some_and(|&byte| is_space(byte)) {
        return Err(damaged("expected a space behind P5"));
    }
    let (width, height) = (header.number("width")?, header.number("height")?);
    let maximum = header.number("level of white")?;
    expect_size(width, height)?;
    let maximum = u16::try_from(maximum).ok().filter(|&level| level > 0);
    let maximum = maximum.ok_or_else(|| damaged("expected a level of white from 1 to 65535"))?;
    let bytes = if maximum > 255 { 2 } else { 1 };
    let samples = data[header.place..].get(..width * height * bytes);
    let samples = samples.ok_or_else(|| {
        let (expected, got) = (width * height * bytes, data.len() - header.place);
        damaged(&format!("expected {expected} bytes of pixels, got {got}"))
    })?;
    let gray = if bytes == 1 {
        let stretched = |level: u8| f64::from(level) / f64::from(maximum) * 255.0;
        let table: Vec<u8> =
            (0..=255).map(|level| stretched(level).round_ties_even().min(255.0) as u8).collect();
        samples.iter().map(|&level| table[usize::from(level)]).collect()
    } else {
        let white = white_of(white)?;
        let levels = samples.chunks_exact(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]]));
        white.scale(&levels.map(|level| level.min(maximum)).collect::<Vec<_>>())?
    };
    Ok(Picture::from_samples(width, height, gray, 1))
}

struct Header<'a> {
    data: &'a [u8],
    place: usize,
}

impl Header<'_> {
    /// Reads a number, what separates it from what came before, and the one space behind it.
    fn number(&mut self, name: &str) -> Result<usize> {
        let mut digits = String::new();
        while let Some(byte) = self.next() {
            if byte == b'#' {
                while self.next().is_some_and(|byte| byte != b'\n' && byte != b'\r') {}
            } else if !is_space(byte) {
                digits.push(char::from(byte));
            } else if !digits.is_empty() {
                break;
            }
            if digits.len() > 10 {
                break; // more than any number that can be used
            }
        }
        let number = if digits.len() > 10 { None } else { digits.parse().ok() };
        number.ok_or_else(|| {
            damaged(&format!("expected a number for {name}, got \"{}\"", digits.escape_default()))
        })
    }

    fn next(&mut self) -> Option<u8> {
        let byte = self.data.get(self.place).copied();
        self.place += usize::from(byte.is_some());
        byte
    }
}

/// Whether a byte is C's white space.
fn is_space(byte: u8) -> bool {
    byte.is_ascii_whitespace() || byte == 0x0b
}

fn damaged(what: &str) -> Error {
    Error::new(format!("damaged PGM file: {what}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gray(data: &[u8], white: Option<White>) -> Vec<u8> {
        let picture = decode(data, white).unwrap();
        assert_eq!((picture.width, picture.height), (2, 1));
        assert!(picture.pixels.chunks_exact(3).all(|pixel| pixel == [pixel[0]; 3]));
        picture.pixels.into_iter().step_by(3).collect()
    }

    #[test]
    fn levels_are_stretched_to_white() {
        assert_eq!(gray(b"P5 2 1 255\n\x07\xff", None), [7, 255]);
        assert_eq!(gray(b"P5\n# a comment\n2\t1 # and another\n15\n\x05\xff", None), [85, 255]);
        let white = Some(White::Level(1023.0));
        assert_eq!(gray(b"P5 2 1 1023 \x03\xff\x02\x00", white), [255, 128]); // 127.62
        assert_eq!(gray(b"P5 2 1 256 \xff\xff\x00\x80", Some(White::Level(256.0))), [255, 128]);
        assert_eq!(gray(b"P5 2 1 255\n\x07\xff, and more", white), [7, 255]);
    }

    #[test]
    fn what_cannot_be_read_is_told() {
        for (data, message) in [
            (&b"P5 2 1 255\n\x07"[..], "expected 2 bytes of pixels, got 1"),
            (b"P5 2 1 256\n\x07\x07\x07\x07", "the model's weights state none"),
            (b"P5 2 x 255\n\x07\x07", "expected a number for height, got \"x\""),
            (b"P5 2 1 65536\n\x07\x07", "expected a level of white from 1 to 65535"),
            (b"P5 2 1 0\n\x07\x07", "expected a level of white from 1 to 65535"),
            (b"P5 99999999999999999999", "expected a number for width, got \"99999999999\""),
            (b"P5 9999999999 1 255 ", "expected an image of 1 to 65535"),
            (b"P5 0 1 255 ", "expected an image of 1 to 65535"),
            (b"P5 2", "expected a number for height, got \"\""),
            (b"P52 1 255 \x07\x07", "expected a space behind P5"),
            (b"P5", "expected a space behind P5"),
        ] {
            let error = decode(data, None).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
    }
}
