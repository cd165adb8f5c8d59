//! JPEG files.

use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;

use crate::error::{Error, Result};
use crate::picture::{MAX_SIDE, Picture, expect_size};

/// What a file begins with.
pub const MAGIC: &[u8] = b"\xff\xd8\xff";

const START_OF_SCAN: &[u8] = b"\xff\xda";
const END_OF_IMAGE: &[u8] = b"\xff\xd9";

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
    let (channels, wanted) = match decoder.input_colorspace() {
        Some(ColorSpace::Luma) => (1, ColorSpace::Luma),
        Some(ColorSpace::RGB | ColorSpace::YCbCr) => (3, ColorSpace::RGB),
        other => {
            return Err(Error::new(format!(
                "expected gray or color of RGB or YCbCr, got {other:?}"
            )));
        }
    };
    decoder.set_options(options.jpeg_set_out_colorspace(wanted));
    let samples = decoder.decode().map_err(failed)?;
    Ok(Picture::from_samples(width, height, samples, channels))
}

/// Refuses a file that stops within its last scan, where neither marker can be among the data; the decoder takes one that
/// lacks no more than the last rows.
fn expect_end(data: &[u8]) -> Result<()> {
    let last = |marker: &[u8]| data.windows(marker.len()).rposition(|bytes| bytes == marker);
    if last(END_OF_IMAGE) < last(START_OF_SCAN) {
        return Err(Error::new("damaged JPEG file: it is cut short"));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

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
