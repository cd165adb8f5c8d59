//! The records of a protobuf message, as ONNX files are made of: enough to read their metadata.
//!
//! See <https://protobuf.dev/programming-guides/encoding>, "Message Structure".

use crate::error::{Error, Result};

/// Returns the length-delimited fields of a message, by number; the others are skipped. Nothing follows an error.
pub fn records(message: &[u8]) -> Records<'_> {
    Records { reader: Reader { message, place: 0 } }
}

/// The fields of [`records`].
pub struct Records<'a> {
    reader: Reader<'a>,
}

impl<'a> Iterator for Records<'a> {
    type Item = Result<(u64, &'a [u8])>;

    fn next(&mut self) -> Option<Self::Item> {
        let reader = &mut self.reader;
        while reader.place < reader.message.len() {
            let found = reader.record().transpose();
            if !matches!(found, Some(Ok(_)) | None) {
                reader.place = reader.message.len();
            }
            if found.is_some() {
                return found;
            }
        }
        None
    }
}

struct Reader<'a> {
    message: &'a [u8],
    place: usize,
}

impl<'a> Reader<'a> {
    /// Reads a field; None of one without a length.
    fn record(&mut self) -> Result<Option<(u64, &'a [u8])>> {
        let key = self.number()?;
        let (field, kind) = (key >> 3, key & 7);
        let place = self.place;
        let bytes = match kind {
            0 => self.number().map(|_| None)?,
            1 => self.bytes(8).map(|_| None)?,
            2 => {
                let length = self.number()?;
                Some(self.bytes(length)?)
            }
            5 => self.bytes(4).map(|_| None)?,
            _ => return Err(Error::new(format!("unknown wire type {kind} at byte {place}"))),
        };
        // Other readers take the lower 32 bits of a key, and would find another field.
        if field == 0 || key > u64::from(u32::MAX) {
            return Err(Error::new(format!("a record of field {field} at byte {place}")));
        }
        Ok(bytes.map(|bytes| (field, bytes)))
    }

    /// Reads a number of seven bits a byte, the lowest first.
    fn number(&mut self) -> Result<u64> {
        let mut value = 0;
        for shift in (0..64).step_by(7) {
            let &byte = self.message.get(self.place).ok_or_else(|| {
                Error::new(format!("a number does not end at byte {}", self.place))
            })?;
            self.place += 1;
            value |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return Ok(value);
            }
        }
        Err(Error::new(format!("a number does not end at byte {}", self.place)))
    }

    fn bytes(&mut self, length: u64) -> Result<&'a [u8]> {
        let rest = &self.message[self.place..];
        let bytes = usize::try_from(length).ok().and_then(|length| rest.get(..length));
        let bytes = bytes.ok_or_else(|| {
            let size = self.message.len();
            Error::new(format!("{length} bytes at byte {} of {size}", self.place))
        })?;
        self.place += bytes.len();
        Ok(bytes)
    }
}

#[cfg(test)]
mod tests {
    use crate::error::Result;

    fn records(message: &[u8]) -> Result<Vec<(u64, &[u8])>> {
        super::records(message).collect()
    }

    #[test]
    fn only_records_with_a_length_are_given() {
        // Field 1: number 300; field 2: "ab"; field 3: four bytes; field 4: eight; field 16: "".
        let message = b"\x08\xac\x02\x12\x02ab\x1d1234\x2112345678\x82\x01\x00";
        assert_eq!(records(message).unwrap(), [(2, &b"ab"[..]), (16, &b""[..])]);
        assert_eq!(records(b"").unwrap(), []);
    }

    #[test]
    fn what_is_cut_short_or_no_message_is_refused() {
        for message in [
            &b"\x12\x03ab"[..],
            b"\x08\xac",
            b"\x1d123",
            b"\x13",
            b"\x02\x00",
            b"\xea\x80\x80\x80\x10\x00", // field 13 and 2^32
        ] {
            assert!(records(message).is_err(), "{message:?}");
        }
        assert!(records(&[0x08, 255, 255, 255, 255, 255, 255, 255, 255, 255, 255, 255]).is_err());
        assert!(records(b"\x12\xff\xff\xff\xff\xff\xff\xff\xff\x7fab").is_err()); // 2^63 - 1 bytes
    }
}
