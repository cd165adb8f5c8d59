//! JPEG files.

use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;

use crate::error::{Error, Result};
use crate::picture::{MAX_SIDE, Picture, expect_size};

/// What a file begins with.
pub const MAGIC: &[u8] = b"\xff\xd8\xff";

/// Behind 0xff.
const END_OF_IMAGE: u8 = 0xd9;

/// Reads an image.
///
/// # Errors
/// It is damaged, cut short, too large, or neither gray nor RGB or YCbCr.
pub fn decode(data: &[u8]) -> Result<Picture> {
    let failed =
        |error: zune_jpeg::errors::DecodeErrors| Error::new(format!("damaged JPEG file: {error}"));
    expect_end(data)?;
    let options = DecoderOptions::new_safe()
        .set_strict_mode(true)
        .set_max_width(MAX_SIDE)
        .set_max_height(MAX_SIDE);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(data), options);
    decoder.decode_headers().map_err(failed)?;
    let (width, height) = decoder.dimensions().unwrap_or_default();
    expect_size(width, height)?;
    let components = decoder.info().map_or(0, |info| info.components);
    let (channels, wanted) = match decoder.input_colorspace() {
        Some(ColorSpace::Luma) => (1, ColorSpace::Luma),
        // Adobe's marker says of three components what of four is CMYK and YCCK; they are seen to later.
        _ if components == 3 => (3, ColorSpace::RGB),
        other => {
            let other = other.map_or("none".into(), |space| format!("{space:?}"));
            return Err(Error::new(format!(
                "expected gray or color of RGB or YCbCr, got {components} components, {other}"
            )));
        }
    };
    decoder.set_options(options.jpeg_set_out_colorspace(wanted));
    let samples = decoder.decode().map_err(failed)?;
    Ok(Picture::from_samples(width, height, samples, channels))
}

/// Refuses a file that stops before the marker of its end; the decoder takes one that lacks no more than the last rows.
///
/// Segments are stepped over by their lengths, as they may hold another image, and scans by what can be no marker. What is behind
/// the end is none of the image's.
fn expect_end(data: &[u8]) -> Result<()> {
    let mut rest = &data[2..]; // behind the start of the image
    while let Some(place) = rest.windows(2).position(|pair| pair[0] == 0xff && is_marker(pair[1])) {
        let (marker, behind) = (rest[place + 1], &rest[place + 2..]);
        if marker == END_OF_IMAGE {
            return Ok(());
        }
        let length =
            behind.first_chunk().map_or(usize::MAX, |pair| u16::from_be_bytes(*pair).into());
        rest = behind.get(length..).unwrap_or_default();
    }
    Err(Error::new("damaged JPEG file: it is cut short"))
}

/// Whether a byte behind 0xff is that of a marker with a length, or of the end: not of a level 0xff in a scan, a restart, or a fill byte.
fn is_marker(byte: u8) -> bool {
    !matches!(byte, 0x00 | 0x01 | 0xd0..=0xd8 | 0xff)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_end_is_that_of_the_image_itself() {
        let start = b"\xff\xd8".as_slice();
        let thumbnail = b"\xff\xe1\x00\x08\xff\xda\xff\xd9\xff\xda".as_slice(); // six bytes in a segment
        let scan = b"\xff\xda\x00\x03\x00 1\xff\x00 2\xff\xd7 3\xff\xff".as_slice();
        let end = b"\xff\xd9".as_slice();
        for (parts, is_whole) in [
            (&[start, end][..], true),
            (&[start, scan, end], true),
            (&[start, scan, scan, end], true),
            (&[start, thumbnail, scan, end], true),
            (&[start, scan, end, b"trailer \xff\xda"], true),
            (&[start, scan, end, start, scan], true), // a second image
            (&[start], false),
            (&[start, scan], false),
            (&[start, thumbnail, scan], false),
            (&[start, thumbnail], false),
            (&[start, &thumbnail[..4], end], false),
            (&[start, scan, b"\xff"], false),
        ] {
            assert_eq!(expect_end(&parts.concat()).is_ok(), is_whole, "{parts:?}");
        }
    }

    #[test]
    fn damaged_files_are_refused() {
        for (data, message) in [
            (&b"\xff\xd8\xff\xda\x00\x01\x02"[..], "damaged JPEG file: it is cut short"),
            (b"\xff\xd8\xff\xd9", "damaged JPEG file"),
        ] {
            let error = decode(data).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
    }
}
