//! The lines that go out, one for each image: its pose, or why it has none.

use std::any::Any;
use std::io::Write;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use serde_json::{Map, Value};

use crate::error::{Error, Result};

/// Writes a line for each image, and counts them.
pub struct Answers<W> {
    output: W,
    /// Images so far.
    pub images: u64,
    /// Those among them that have no pose.
    pub failed: u64,
}

impl<W: Write> Answers<W> {
    /// Writes to `output`.
    pub fn new(output: W) -> Self {
        Self { output, images: 0, failed: 0 }
    }

    /// Writes the line of one image, all of it in one write: what `pose` returns, an error among it where
    /// a track goes on without the image, or its error alone. A panic is an error of its image.
    ///
    /// # Errors
    /// The output cannot be written.
    pub fn give(
        &mut self,
        path: &Path,
        pose: impl FnOnce() -> Result<Map<String, Value>>,
    ) -> Result<()> {
        let mut fields = Map::from_iter([("image".into(), Value::from(path.to_string_lossy()))]);
        match unpanicked(pose) {
            Ok(pose) => {
                self.failed += u64::from(pose.contains_key("error"));
                fields.extend(pose);
            }
            Err(error) => {
                self.failed += 1;
                fields.insert("error".into(), error.to_string().into());
            }
        }
        self.images += 1;
        let line = format!("{}\n", Value::Object(fields));
        let written = self.output.write_all(line.as_bytes()).and_then(|()| self.output.flush());
        written.map_err(|error| Error::new(format!("standard output cannot be written: {error}")))
    }
}

/// Runs what an image is read and posed by; a panic is its error.
///
/// # Errors
/// It fails, or panics.
pub(crate) fn unpanicked<T>(run: impl FnOnce() -> Result<T>) -> Result<T> {
    // Images share the session of ONNX Runtime alone, where no panic unwinds: its errors are values.
    catch_unwind(AssertUnwindSafe(run)).unwrap_or_else(|cause| Err(panicked(&*cause)))
}

fn panicked(cause: &(dyn Any + Send)) -> Error {
    let text = cause.downcast_ref::<&str>().copied();
    let text = text.or_else(|| cause.downcast_ref::<String>().map(String::as_str));
    Error::new(format!(
        "expected an image or an error, got a panic, a bug of this program: {}",
        text.unwrap_or("no message")
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_the_error_of_its_image() {
        let mut output = Vec::new();
        let mut answers = Answers::new(&mut output);
        let pose = || Ok(Map::from_iter([("in_view".into(), Value::from(0.5))]));
        answers.give(Path::new("a.png"), pose).unwrap();
        answers.give(Path::new("b.png"), || panic!("row {}", 7)).unwrap();
        answers.give(Path::new("c.png"), || std::panic::panic_any(7)).unwrap();
        answers.give(Path::new("d.png"), || Err(Error::new("none"))).unwrap();
        answers.give(Path::new("e.png"), pose).unwrap();
        assert_eq!((answers.images, answers.failed), (5, 3));
        let lines = String::from_utf8(output).unwrap();
        let bug = "expected an image or an error, got a panic, a bug of this program";
        let expected = [
            r#"{"image":"a.png","in_view":0.5}"#,
            &format!(r#"{{"image":"b.png","error":"{bug}: row 7"}}"#),
            &format!(r#"{{"image":"c.png","error":"{bug}: no message"}}"#),
            r#"{"image":"d.png","error":"none"}"#,
            r#"{"image":"e.png","in_view":0.5}"#,
        ];
        assert_eq!(lines.lines().collect::<Vec<_>>(), expected);
    }
}
