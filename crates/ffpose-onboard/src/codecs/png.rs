//! PNG files.

use std::io::Cursor;

use ::png::{BitDepth, ColorType, Decoder, DecodingError, Transformations};

use crate::error::{Error, Result};
use crate::levels::White;
use crate::picture::{Picture, expect_size, white_of};

/// What a file begins with.
pub const MAGIC: &[u8] = b"\x89PNG\r\n\x1a\n";

/// Reads an image.
///
/// # Errors
/// It is damaged, cut short, too large, or has several channels of 16 bits, or one and no level is said to be white.
pub fn decode(data: &[u8], white: Option<White>) -> Result<Picture> {
    let failed = |error: DecodingError| Error::new(format!("damaged PNG file: {error}"));
    let mut decoder = Decoder::new(Cursor::new(data));
    decoder.ignore_checksums(false); // else zlib's own is not computed
    decoder.set_ignore_text_chunk(true); // which may say that they are large
    decoder.set_ignore_iccp_chunk(true);
    decoder.set_transformations(Transformations::EXPAND); // palettes and fewer bits, to 8
    let mut reader = decoder.read_info().map_err(failed)?;
    let info = reader.info();
    let (width, height, is_gray) =
        (info.width as usize, info.height as usize, info.color_type == ColorType::Grayscale);
    expect_size(width, height)?;
    let (color, depth) = reader.output_color_type();
    let channels = color.samples();
    if depth == BitDepth::Eight {
        let mut samples = vec![0; width * height * channels];
        reader.next_frame(&mut samples).map_err(failed)?;
        return Ok(Picture::from_samples(width, height, samples, channels));
    }
    if !is_gray {
        return Err(Error::new(
            "expected 8 bits a channel, or one channel of 16 bits with a white level, got several of 16",
        ));
    }
    let white = white_of(white)?;
    let mut samples = vec![0; 2 * width * height * channels];
    reader.next_frame(&mut samples).map_err(failed)?;
    let pixels = samples.chunks_exact(2 * channels); // transparency is behind the level
    let levels: Vec<u16> = pixels.map(|pixel| u16::from_be_bytes([pixel[0], pixel[1]])).collect();
    Ok(Picture::from_samples(width, height, white.scale(&levels)?, 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(color: ColorType, depth: BitDepth, samples: &[u8]) -> Vec<u8> {
        let mut file = Vec::new();
        let mut encoder = ::png::Encoder::new(&mut file, 2, 1);
        encoder.set_color(color);
        encoder.set_depth(depth);
        if color == ColorType::Indexed {
            encoder.set_palette(vec![10, 20, 30, 40, 50, 60]);
        }
        encoder.write_header().unwrap().write_image_data(samples).unwrap();
        file
    }

    #[test]
    fn every_kind_of_eight_bits_becomes_rgb() {
        use ColorType::{Grayscale, GrayscaleAlpha, Indexed, Rgb, Rgba};
        for (color, samples, expected) in [
            (Grayscale, &[1, 2][..], [1, 1, 1, 2, 2, 2]),
            (GrayscaleAlpha, &[1, 0, 2, 255], [1, 1, 1, 2, 2, 2]),
            (Indexed, &[1, 0], [40, 50, 60, 10, 20, 30]),
            (Rgb, &[1, 2, 3, 4, 5, 6], [1, 2, 3, 4, 5, 6]),
            (Rgba, &[1, 2, 3, 0, 4, 5, 6, 255], [1, 2, 3, 4, 5, 6]),
        ] {
            let picture = decode(&file(color, BitDepth::Eight, samples), None).unwrap();
            assert_eq!(picture, Picture { width: 2, height: 1, pixels: expected.to_vec() });
        }
        let four_bits = decode(&file(Grayscale, BitDepth::Four, &[0x2f]), None).unwrap();
        assert_eq!(four_bits.pixels, [34, 34, 34, 255, 255, 255]); // times 255 / 15
    }

    #[test]
    fn one_channel_of_sixteen_bits_has_a_white_level() {
        let deep = file(ColorType::Grayscale, BitDepth::Sixteen, &[0x0f, 0xff, 0x04, 0x00]);
        let picture = decode(&deep, Some(White::Level(4095.0))).unwrap();
        assert_eq!(picture.pixels, [255, 255, 255, 64, 64, 64]); // 1024 / 4095 * 255 = 63.77
        let mut marked = deep.clone();
        let place = marked.windows(4).position(|bytes| bytes == b"IDAT").unwrap() - 4;
        let transparent = b"\0\0\0\x02tRNS\x04\0\x12\xff\x08\x3c";
        marked.splice(place..place, transparent.iter().copied());
        assert_eq!(decode(&marked, Some(White::Level(4095.0))).unwrap(), picture);
    }

    #[test]
    fn other_depths_and_damaged_files_are_refused() {
        let deep = file(ColorType::Grayscale, BitDepth::Sixteen, &[0, 1, 2, 3]);
        let deep_color = file(ColorType::Rgb, BitDepth::Sixteen, &[0; 12]);
        let whole = file(ColorType::Grayscale, BitDepth::Eight, &[1, 2]);
        let mut altered = whole.clone();
        let place = altered.windows(4).position(|bytes| bytes == b"IDAT").unwrap();
        altered[place + 6] ^= 1;
        for (data, message) in [
            (&deep[..], "the model's weights state none"),
            (&deep_color, "got several of 16"),
            (&whole[..place], "damaged PNG file"),
            (&altered, "damaged PNG file"),
        ] {
            let error = decode(data, None).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
    }
}
