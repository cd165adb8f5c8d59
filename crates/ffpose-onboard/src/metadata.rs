//! What an exported model says of itself, as `ffpose.onnx.metadata` writes it; an altered file is refused.

use std::collections::HashMap;

use ffpose_track::{Axis, Symmetry};
use serde_json::{Map, Value};
use sha2::{Digest, Sha256};

use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::levels::White;
use crate::pose::Meaning;
use crate::preprocessing::Preprocessing;
use crate::records::records;

const FORMAT: &str = "2";
const CHECKSUM: &str = "ffpose_sha256";

/// Number of the field in ONNX's `ModelProto`; within an entry, 1 is the key and 2 the value.
const METADATA_PROPS: u64 = 14;

/// What an exported model says of itself.
#[derive(Debug)]
pub struct Metadata {
    /// Turns an image into the network's input.
    pub preprocessing: Preprocessing,
    /// Whether spectral filters are computed by the library of ffpose's operator.
    pub needs_operators: bool,
    /// The camera of the images trained on; `None` where it is not known.
    pub camera: Option<Camera>,
    /// The camera of the network's input; `None` where it is not known.
    pub view: Option<Camera>,
    /// How its outputs are read.
    pub meaning: Meaning,
    /// Whether the graph looks once, at a point that is its second input.
    pub takes_point: bool,
    /// SHA-256 of the weights that were exported, hexadecimal; empty where it is not known.
    pub weights_sha256: String,
    /// SHA-256 of the file of the looks of a track, hexadecimal; `None` where there was none at the export.
    pub track_sha256: Option<String>,
    /// Rotations of the object modulo which attitudes are told.
    pub symmetry: Symmetry,
    /// What a tracker expects of the network's errors: settings by their names.
    pub tracking: Map<String, Value>,
    /// Whether the images trained on were undistorted.
    pub undistorted: bool,
    /// Their distortion, where they were taken as they are.
    pub distortion: Option<[f64; 5]>,
    /// What became 255 in images trained on that have more than 8 bits.
    pub white: Option<White>,
}

impl Metadata {
    /// Reads the metadata of a model, given the bytes of its file.
    ///
    /// # Errors
    /// It is no ONNX file, not of `ffpose export`, altered, or newer than this program.
    pub fn of(data: &[u8]) -> Result<Self> {
        let entries = entries(data).map_err(|error| {
            error.of("expected an ONNX file, got one that is cut short or none")
        })?;
        let version = entries.get("ffpose_version").map_or("unknown", String::as_str);
        match entries.get("ffpose_format").map(String::as_str) {
            Some(FORMAT) => {}
            None => {
                return Err(Error::new(
                    "expected a model that `ffpose export` wrote, got one without its metadata",
                ));
            }
            Some(format) => {
                return Err(Error::new(format!(
                    "expected a model of format {FORMAT}, which ffpose-onboard {} reads, got format {format}, written by ffpose \
                     {version}",
                    env!("CARGO_PKG_VERSION")
                )));
            }
        }
        check_bytes(data, entries.get(CHECKSUM))?;
        Self::from_entries(&entries)
            .map_err(|error| error.of(format!("expected metadata that ffpose {version} wrote")))
    }

    fn from_entries(entries: &HashMap<String, String>) -> Result<Self> {
        choice(entries, "architecture", &["FilterformerPose", "PolarPose", "UrsoNet", "PoseNet"])?;
        choice(entries, "quaternion_order", &["wxyz"])?;
        let preprocessing = Preprocessing::from_json(&json(entries, "preprocessing")?)?;
        let decoding =
            if entries.contains_key("decoding") { json(entries, "decoding")? } else { Value::Null };
        Ok(Self {
            view: view(entries, &preprocessing)?,
            preprocessing,
            needs_operators: choice(entries, "filter", &["custom", "matmul", "none"])? == "custom",
            camera: camera(entries, "camera")?,
            meaning: Meaning {
                in_view_threshold: numbers::<1>(entries, "in_view_threshold")?.map(|[value]| value),
                degrees_of_freedom: numbers(entries, "degrees_of_freedom")?,
                locates_camera: entries.contains_key("locates")
                    && choice(entries, "locates", &["object", "camera"])? == "camera",
            },
            takes_point: entries.get("takes_point").is_some_and(|value| value == "true"),
            weights_sha256: entries.get("weights_sha256").cloned().unwrap_or_default(),
            track_sha256: entries.get("track_sha256").cloned(),
            symmetry: symmetry(entries)?,
            tracking: match entries.get("tracking").map(|text| serde_json::from_str(text)) {
                None => Map::new(),
                Some(Ok(Value::Object(settings))) => settings,
                Some(_) => return Err(Error::new("tracking: expected settings by their names")),
            },
            undistorted: decoding["undistorted"] == true,
            distortion: match &decoding["distortion"] {
                Value::Null => None,
                value => Some(serde_json::from_value(value.clone()).map_err(|error| {
                    Error::new(format!("decoding: expected a distortion of five numbers: {error}"))
                })?),
            },
            white: match &decoding["white"] {
                Value::Null => None,
                value => Some(White::from_json(value)?),
            },
        })
    }
}

fn entries(data: &[u8]) -> Result<HashMap<String, String>> {
    let mut found = HashMap::new();
    for record in records(data) {
        let (field, entry) = record?;
        if field != METADATA_PROPS {
            continue;
        }
        let parts = records(entry).collect::<Result<HashMap<u64, &[u8]>>>()?;
        let text = |number| {
            let bytes = parts.get(&number).copied().unwrap_or_default().to_vec();
            String::from_utf8(bytes).map_err(|error| Error::new(format!("metadata: {error}")))
        };
        found.insert(text(1)?, text(2)?);
    }
    Ok(found)
}

/// Checks that the file ends in the record of its checksum, and that the bytes before it have it.
fn check_bytes(data: &[u8], expected: Option<&String>) -> Result<()> {
    let expected = expected
        .ok_or_else(|| Error::new("the file was altered: expected its SHA-256 in it, got none"))?;
    let record = checksum_record(expected);
    let content = data.strip_suffix(&record[..]);
    let got = sha256(content.unwrap_or(data));
    if content.is_none() || got != *expected {
        return Err(Error::new(format!(
            "the file was altered: expected SHA-256 {expected}, got {got}"
        )));
    }
    Ok(())
}

/// Returns the SHA-256 of bytes, hexadecimal.
pub fn sha256(data: &[u8]) -> String {
    format!("{:x}", Sha256::digest(data))
}

/// Returns the record of `ffpose_sha256`, all of whose lengths are one byte; of a digest that is too long, nothing's record.
fn checksum_record(digest: &str) -> Vec<u8> {
    let field = |number: u8, content: &[u8]| {
        let length = u8::try_from(content.len()).unwrap_or(u8::MAX);
        [&[number << 3 | 2, length][..], content].concat()
    };
    let entry = [field(1, CHECKSUM.as_bytes()), field(2, digest.as_bytes())].concat();
    field(14, &entry)
}

fn entry<'a>(entries: &'a HashMap<String, String>, name: &str) -> Result<&'a str> {
    entries
        .get(name)
        .map(String::as_str)
        .ok_or_else(|| Error::new(format!("expected the entry {name}, got none")))
}

fn choice<'a>(entries: &'a HashMap<String, String>, name: &str, known: &[&str]) -> Result<&'a str> {
    let value = entry(entries, name)?;
    if known.contains(&value) {
        return Ok(value);
    }
    Err(Error::new(format!("{name}: expected one of {}, got {value}", known.join(", "))))
}

fn json(entries: &HashMap<String, String>, name: &str) -> Result<Value> {
    serde_json::from_str(entry(entries, name)?)
        .map_err(|error| Error::new(error.to_string()).of(name))
}

/// Reads a list of `N` numbers, or a number where `N` is one; `None` for null.
fn numbers<const N: usize>(
    entries: &HashMap<String, String>,
    name: &str,
) -> Result<Option<[f64; N]>> {
    let value = json(entries, name)?;
    let found: Option<Vec<f64>> = match &value {
        Value::Null => return Ok(None),
        Value::Array(values) => values.iter().map(Value::as_f64).collect(),
        number => number.as_f64().map(|number| vec![number]),
    };
    let found = found.and_then(|values| <[f64; N]>::try_from(values).ok());
    found.map(Some).ok_or_else(|| Error::new(format!("{name}: expected {N} numbers, got {value}")))
}

/// Reads the axes of a symmetry, each with the number of its turns or "any"; without an entry there is none.
fn symmetry(entries: &HashMap<String, String>) -> Result<Symmetry> {
    if !entries.contains_key("symmetry") {
        return Ok(Symmetry::default());
    }
    let value = json(entries, "symmetry")?;
    let axis = |value: &Value| {
        let numbers = value["axis"].as_array()?.iter().map(Value::as_f64);
        let fold = match &value["fold"] {
            Value::String(any) if any == "any" => 0,
            number => u32::try_from(number.as_u64()?).ok().filter(|fold| *fold > 1)?,
        };
        Some(Axis { direction: numbers.collect::<Option<Vec<_>>>()?.try_into().ok()?, fold })
    };
    let all: Option<Vec<Axis>> =
        value.as_array().and_then(|values| values.iter().map(axis).collect());
    let expected = || Error::new(format!("symmetry: expected axes with their folds, got {value}"));
    Symmetry::new(&all.ok_or_else(expected)?).map_err(|error| Error::new(error.to_string()))
}

fn camera(entries: &HashMap<String, String>, name: &str) -> Result<Option<Camera>> {
    let value = json(entries, name)?;
    if value.is_null() {
        return Ok(None);
    }
    Camera::from_json(&value).map(Some).map_err(|error| error.of(name))
}

/// Reads the camera of the network's input, which is of the input's size.
fn view(
    entries: &HashMap<String, String>,
    preprocessing: &Preprocessing,
) -> Result<Option<Camera>> {
    let view = camera(entries, "view_camera")?;
    let (width, height) = (preprocessing.width, preprocessing.height);
    match &view {
        Some(camera) if (camera.width, camera.height) != (width, height) => {
            Err(Error::new(format!(
                "view_camera: expected the size of the network's input, {width}x{height}, got {camera}"
            )))
        }
        _ => Ok(view),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ENTRIES: [(&str, &str); 9] = [
        ("ffpose_format", "2"),
        ("architecture", "FilterformerPose"),
        ("quaternion_order", "wxyz"),
        ("filter", "custom"),
        ("camera", r#"{"width": 128, "height": 96, "fx": 100, "fy": 100, "cx": 64, "cy": 48}"#),
        ("view_camera", r#"{"width": 6, "height": 4, "fx": 5, "fy": 5, "cx": 3, "cy": 2}"#),
        ("in_view_threshold", "0.25"),
        ("degrees_of_freedom", "[4.5, 3.25]"),
        (
            "preprocessing",
            r#"{"size": [4, 6], "mode": "resize", "mean": [0, 0, 0], "std": [1, 1, 1], "interpolation": "bicubic"}"#,
        ),
    ];

    /// A record; lengths below 2^14.
    fn record(number: u8, content: &[u8]) -> Vec<u8> {
        let (high, low) = (content.len() / 128, content.len() % 128);
        let [low, high] = [low + 128, high].map(|part| u8::try_from(part).unwrap());
        [&[number << 3 | 2, low, high][..], content].concat()
    }

    fn model(entries: &[(&str, &str)]) -> Vec<u8> {
        let entry = |(key, value): &(&str, &str)| {
            record(14, &[record(1, key.as_bytes()), record(2, value.as_bytes())].concat())
        };
        entries.iter().flat_map(entry).collect()
    }

    fn sealed(mut data: Vec<u8>) -> Vec<u8> {
        let seal = checksum_record(&sha256(&data));
        data.extend(seal);
        data
    }

    /// The entries, `name` among them as `value`.
    fn with<'a>(name: &str, value: &'a str) -> Vec<(&'a str, &'a str)> {
        ENTRIES.into_iter().map(|(key, old)| (key, if key == name { value } else { old })).collect()
    }

    #[test]
    fn the_entries_are_read() {
        let metadata = Metadata::of(&sealed(model(&ENTRIES))).unwrap();
        assert_eq!((metadata.preprocessing.height, metadata.preprocessing.width), (4, 6));
        assert!(metadata.needs_operators);
        assert_eq!(metadata.meaning.in_view_threshold, Some(0.25));
        assert_eq!(metadata.meaning.degrees_of_freedom, Some([4.5, 3.25]));
        let gaussian = Metadata::of(&sealed(model(&with("degrees_of_freedom", "null")))).unwrap();
        assert_eq!(gaussian.meaning.degrees_of_freedom, None);
        assert_eq!(metadata.camera.unwrap().to_string(), "128x96");
        assert_eq!(metadata.view.unwrap().to_string(), "6x4");
        let unknown = Metadata::of(&sealed(model(&with("camera", "null")))).unwrap();
        assert!(unknown.camera.is_none());
    }

    #[test]
    fn every_network_of_the_harness_is_read() {
        for name in ["FilterformerPose", "PolarPose", "UrsoNet", "PoseNet"] {
            Metadata::of(&sealed(model(&with("architecture", name)))).unwrap();
        }
    }

    #[test]
    fn how_images_are_decoded_is_read() {
        let plain = Metadata::of(&sealed(model(&ENTRIES))).unwrap();
        assert_eq!((plain.undistorted, plain.white), (false, None));
        for (decoding, expected) in [
            (r#"{"undistorted": true, "white": null}"#, (true, None)),
            (r#"{"undistorted": false, "white": 4095}"#, (false, Some(White::Level(4095.0)))),
            (r#"{"undistorted": false, "white": "p99"}"#, (false, Some(White::Percentile(99.0)))),
        ] {
            let entries = [&ENTRIES[..], &[("decoding", decoding)]].concat();
            let metadata = Metadata::of(&sealed(model(&entries))).unwrap();
            assert_eq!((metadata.undistorted, metadata.white), expected);
            assert!(metadata.distortion.is_none());
        }
        let of = |distortion: &str| {
            let decoding = format!(r#"{{"undistorted": false, "distortion": {distortion}}}"#);
            let entries = [&ENTRIES[..], &[("decoding", decoding.as_str())]].concat();
            Metadata::of(&sealed(model(&entries)))
        };
        let lens = of("[-0.3, 0.1, 0, 0, 0.5]").unwrap().distortion;
        assert_eq!(lens, Some([-0.3, 0.1, 0.0, 0.0, 0.5]));
        assert!(of("[-0.3, 0.1]").is_err());
    }

    #[test]
    fn what_the_network_locates_is_read() {
        assert!(!Metadata::of(&sealed(model(&ENTRIES))).unwrap().meaning.locates_camera);
        for (target, expected) in [("object", false), ("camera", true)] {
            let entries = [&ENTRIES[..], &[("locates", target)]].concat();
            let metadata = Metadata::of(&sealed(model(&entries))).unwrap();
            assert_eq!(metadata.meaning.locates_camera, expected);
        }
    }

    #[test]
    fn the_symmetry_is_read() {
        let read = |axes: &str| {
            let entries = [&ENTRIES[..], &[("symmetry", axes)]].concat();
            Metadata::of(&sealed(model(&entries)))
        };
        let plain = Metadata::of(&sealed(model(&ENTRIES))).unwrap().symmetry;
        assert_eq!(plain, Symmetry::default());
        let axes = [([0.0, 0.0, 1.0], 0), ([1.0, 0.0, 0.0], 2)];
        let axes = axes.map(|(direction, fold)| Axis { direction, fold });
        let cylinder = r#"[{"axis": [0, 0, 1], "fold": "any"}, {"axis": [1.0, 0, 0], "fold": 2}]"#;
        assert_eq!(read(cylinder).unwrap().symmetry, Symmetry::new(&axes).unwrap());
        for axes in [
            r#"{"axis": [0, 0, 1]}"#,
            r#"[{"axis": [0, 1], "fold": 2}]"#,
            r#"[{"axis": [0, 0, 1], "fold": -2}]"#,
            r#"[{"axis": [0, 0, 1], "fold": 0}]"#,
            r#"[{"axis": [0, 0, 1], "fold": "some"}]"#,
            r#"[{"axis": [0, 0, 0], "fold": 2}]"#,
        ] {
            assert!(read(axes).unwrap_err().to_string().contains("symmetry: expected"), "{axes}");
        }
    }

    #[test]
    fn the_digest_is_that_of_the_standard() {
        // FIPS 180-4's example, "abc"
        assert!(sha256(b"abc").starts_with("ba7816bf8f01cfea414140de5dae2223"));
    }

    #[test]
    fn what_is_not_ours_or_altered_is_refused() {
        let whole = sealed(model(&ENTRIES));
        let mut flipped = whole.clone();
        let place = flipped.windows(4).position(|bytes| bytes == b"0.25").unwrap();
        flipped[place + 3] = b'6';
        for (data, message) in [
            (b"no model".to_vec(), "expected an ONNX file"),
            (Vec::new(), "without its metadata"),
            (whole[..whole.len() - 1].to_vec(), "cut short"),
            (model(&ENTRIES), "its SHA-256 in it, got none"),
            (flipped, "altered: expected SHA-256"),
            ([whole, model(&[("comment", "mine")])].concat(), "altered: expected SHA-256"),
            (sealed(model(&with("ffpose_format", "1"))), "got format 1, written by ffpose unknown"),
            (
                sealed(model(&with("degrees_of_freedom", "[4]"))),
                "degrees_of_freedom: expected 2 numbers, got [4]",
            ),
            (
                sealed(model(&with("filter", "fast"))),
                "filter: expected one of custom, matmul, none, got fast",
            ),
            (sealed(model(&with("architecture", "LeNet"))), "got LeNet"),
            (
                sealed(model(&[&ENTRIES[..], &[("locates", "ship")]].concat())),
                "locates: expected one of object, camera, got ship",
            ),
            (sealed(model(&with("camera", "{}"))), "camera: expected the keys width, height"),
            (
                sealed(model(&with("view_camera", ENTRIES[4].1))),
                "view_camera: expected the size of the network's input, 6x4, got 128x96",
            ),
            (
                sealed(model(&[&ENTRIES[..], &[("decoding", r#"{"white": 0}"#)]].concat())),
                "white: expected a positive level",
            ),
            (sealed(model(&with("preprocessing", "{"))), "preprocessing: "),
            (sealed(model(&ENTRIES[..5])), "expected the entry"),
            (model(&[("ffpose_format", FORMAT), (CHECKSUM, &"0".repeat(300))]), "altered"),
        ] {
            let error = Metadata::of(&data).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
    }
}
