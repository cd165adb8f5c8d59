//! The one kind of error: a sentence for whoever reads the log.

use std::fmt;

/// Why a model, or a frame, cannot be used.
#[derive(Debug)]
pub struct Error(String);

/// What can fail with a sentence.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// An error that says `message`.
    pub fn new(message: impl Into<String>) -> Self {
        Self(message.into())
    }

    /// This error, with a part put before it: the file that it is about, for one.
    #[must_use]
    pub fn of(self, part: impl fmt::Display) -> Self {
        Self(format!("{part}: {self}"))
    }
}

impl fmt::Display for Error {
    /// Writes one line, also where a library's message has several.
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let words: Vec<&str> =
            self.0.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
        formatter.write_str(&words.join(" "))
    }
}

#[cfg(test)]
mod tests {
    use super::Error;

    #[test]
    fn an_error_is_one_line() {
        let error = Error::new("expected a\n  model,\n\ngot none\n").of("easy.onnx");
        assert_eq!(error.to_string(), "easy.onnx: expected a model, got none");
    }
}
