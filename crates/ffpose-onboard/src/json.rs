//! JSON files of users, as `ffpose._internal.files.read_json` in Python reads them: UTF-8, with or without a byte order mark,
//! each key once.

use std::fmt;
use std::path::Path;
use std::result;

use serde_core::de::{Deserialize, Deserializer, Error as _, MapAccess, Visitor};
use serde_json::{Map, Value};

use crate::error::{Error, Result};
use crate::files;

/// Largest number of bytes of a file.
const MAX_BYTES: u64 = 1 << 16;

const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

/// Returns the fields of the object that a file holds.
///
/// # Errors
/// It cannot be read, is no JSON object, or has a key twice.
pub fn read_fields(path: &Path) -> Result<Map<String, Value>> {
    fields_of(&files::read(path, MAX_BYTES)?)
}

fn fields_of(data: &[u8]) -> Result<Map<String, Value>> {
    let text = data.strip_prefix(BYTE_ORDER_MARK).unwrap_or(data);
    let fields: Distinct = serde_json::from_slice(text)
        .map_err(|error| Error::new(format!("expected a JSON object: {error}")))?;
    Ok(fields.0)
}

/// The fields of an object, each key once: of two of a kind serde would take the last.
struct Distinct(Map<String, Value>);

impl<'de> Deserialize<'de> for Distinct {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> result::Result<Self, D::Error> {
        deserializer.deserialize_map(OfFields)
    }
}

struct OfFields;

impl<'de> Visitor<'de> for OfFields {
    type Value = Distinct;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("an object")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut entries: A) -> result::Result<Distinct, A::Error> {
        let mut fields = Map::new();
        while let Some((name, value)) = entries.next_entry::<String, Value>()? {
            if fields.contains_key(&name) {
                return Err(A::Error::custom(format!(
                    "expected each key once, got \"{name}\" twice"
                )));
            }
            fields.insert(name, value);
        }
        Ok(Distinct(fields))
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn an_object_is_read_with_or_without_a_byte_order_mark() {
        let expected = json!({"gate": 20, "zenith": [0, -1, 0.5]});
        for mark in ["", "\u{feff}"] {
            let text = format!("{mark}{expected}\n");
            assert_eq!(Value::Object(fields_of(text.as_bytes()).unwrap()), expected);
        }
    }

    #[test]
    fn what_is_no_object_or_has_a_key_twice_is_told() {
        for (text, message) in [
            ("", "expected a JSON object: EOF"),
            ("[1]", "invalid type: sequence, expected an object"),
            ("{\"gate\": NaN}", "expected a JSON object: expected value"),
            ("{} {}", "trailing characters"),
            ("{\"cy\": 1, \"c\\u0079\": 1}", "expected each key once, got \"cy\" twice"),
        ] {
            let error = fields_of(text.as_bytes()).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
        assert!(fields_of(b"{\"\xe9\": 1}").is_err());
    }
}
