//! Reading PNG and JPEG files as RGB, 8 bits a channel.

use std::io::Cursor;
use std::path::Path;

use png::{BitDepth, Transformations};
use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;

use crate::error::{Error, Result};
use crate::files;

/// Largest number of pixels, Pillow's too: 256 MB of RGB.
pub const MAX_PIXELS: usize = 89_478_485;

/// Largest width and height, which bounds what a resize weighs pixels with; JPEG's too.
pub const MAX_SIDE: usize = u16::MAX as usize;

/// Largest number of bytes of a file.
const MAX_BYTES: u64 = 1 << 28;

const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";
const JPEG: &[u8] = b"\xff\xd8\xff";
const START_OF_SCAN: &[u8] = b"\xff\xda";
const END_OF_IMAGE: &[u8] = b"\xff\xd9";

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
    /// # Errors
    /// It is no file that can be read, no PNG or JPEG, damaged or cut short, has not 8 bits a channel, or is too large.
    pub fn read(path: &Path) -> Result<Self> {
        Self::decode(&files::read(path, MAX_BYTES)?)
    }

    fn decode(data: &[u8]) -> Result<Self> {
        if data.starts_with(PNG) {
            decode_png(data)
        } else if data.starts_with(JPEG) {
            decode_jpeg(data)
        } else {
            let start = data[..data.len().min(8)].escape_ascii();
            Err(Error::new(format!(
                "expected a PNG or JPEG file, got one that begins with \"{start}\""
            )))
        }
    }

    /// An image of samples whose channels are gray or RGB, and transparency behind them or not.
    fn from_samples(width: usize, height: usize, samples: Vec<u8>, channels: usize) -> Self {
        let pixels = match channels {
            3 => samples,
            4 => samples.chunks_exact(4).flat_map(|pixel| [pixel[0], pixel[1], pixel[2]]).collect(),
            _ => samples.chunks_exact(channels).flat_map(|pixel| [pixel[0]; 3]).collect(),
        };
        Self { width, height, pixels }
    }
}

fn expect_size(width: usize, height: usize) -> Result<()> {
    let is_side = |side| (1..=MAX_SIDE).contains(&side);
    if !is_side(width) || !is_side(height) || width * height > MAX_PIXELS {
        return Err(Error::new(format!(
            "expected an image of 1 to {MAX_SIDE} pixels a side and at most {MAX_PIXELS} in all, got {width}x{height}"
        )));
    }
    Ok(())
}

fn decode_png(data: &[u8]) -> Result<Picture> {
    let failed = |error: png::DecodingError| Error::new(format!("damaged PNG file: {error}"));
    let mut decoder = png::Decoder::new(Cursor::new(data));
    decoder.set_ignore_text_chunk(true); // which may say that they are large
    decoder.set_ignore_iccp_chunk(true);
    decoder.set_transformations(Transformations::EXPAND); // palettes and fewer bits, to 8
    let mut reader = decoder.read_info().map_err(failed)?;
    let (width, height) = (reader.info().width as usize, reader.info().height as usize);
    expect_size(width, height)?;
    let (color, depth) = reader.output_color_type();
    if depth != BitDepth::Eight {
        return Err(Error::new(format!("expected 8 bits a channel, got {}", depth as u8)));
    }
    let mut samples = vec![0; width * height * color.samples()];
    reader.next_frame(&mut samples).map_err(failed)?;
    Ok(Picture::from_samples(width, height, samples, color.samples()))
}

fn decode_jpeg(data: &[u8]) -> Result<Picture> {
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

    fn png_file(color: png::ColorType, depth: BitDepth, samples: &[u8]) -> Vec<u8> {
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, 2, 1);
        encoder.set_color(color);
        encoder.set_depth(depth);
        if color == png::ColorType::Indexed {
            encoder.set_palette(vec![10, 20, 30, 40, 50, 60]);
        }
        encoder.write_header().unwrap().write_image_data(samples).unwrap();
        file
    }

    #[test]
    fn every_kind_of_eight_bits_becomes_rgb() {
        use png::ColorType::{Grayscale, GrayscaleAlpha, Indexed, Rgb, Rgba};
        for (color, samples, expected) in [
            (Grayscale, &[1, 2][..], [1, 1, 1, 2, 2, 2]),
            (GrayscaleAlpha, &[1, 0, 2, 255], [1, 1, 1, 2, 2, 2]),
            (Indexed, &[1, 0], [40, 50, 60, 10, 20, 30]),
            (Rgb, &[1, 2, 3, 4, 5, 6], [1, 2, 3, 4, 5, 6]),
            (Rgba, &[1, 2, 3, 0, 4, 5, 6, 255], [1, 2, 3, 4, 5, 6]),
        ] {
            let picture = Picture::decode(&png_file(color, BitDepth::Eight, samples)).unwrap();
            assert_eq!(picture, Picture { width: 2, height: 1, pixels: expected.to_vec() });
        }
        let four_bits = Picture::decode(&png_file(Grayscale, BitDepth::Four, &[0x2f])).unwrap();
        assert_eq!(four_bits.pixels, [34, 34, 34, 255, 255, 255]); // times 255 / 15
    }

    #[test]
    fn other_depths_and_damaged_files_are_refused() {
        let deep = png_file(png::ColorType::Grayscale, BitDepth::Sixteen, &[0, 1, 2, 3]);
        let whole = png_file(png::ColorType::Grayscale, BitDepth::Eight, &[1, 2]);
        let mut altered = whole.clone();
        let place = altered.windows(4).position(|bytes| bytes == b"IDAT").unwrap();
        altered[place + 6] ^= 1;
        for (data, message) in [
            (&deep[..], "expected 8 bits a channel, got 16"),
            (&whole[..place], "damaged PNG file"),
            (&altered, "damaged PNG file"),
            (b"", "expected a PNG or JPEG file, got one that begins with \"\""),
            (b"GIF89a", "got one that begins with \"GIF89a\""),
            (b"\xff\xd8\xff\xda\x00\x01\x02", "damaged JPEG file: it is cut short"),
            (b"\xff\xd8\xff\xd9", "damaged JPEG file"),
        ] {
            let error = Picture::decode(data).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
    }
}
