//! Poses from images without Python: a model of `ffpose export` in ONNX Runtime, one JSON line per image.

use std::env;
use std::io::{self, Write};
use std::process::ExitCode;

use ffpose_onboard::answers::Answers;
use ffpose_onboard::error::Result;
use ffpose_onboard::estimator::Estimator;
use ffpose_onboard::frames::{self, Lines};
use ffpose_onboard::options::{Command, Options, Source, Taken};
use ffpose_onboard::track::Track;

const FAILED: u8 = 1;
const WRONG_USAGE: u8 = 2;
const SOME_FAILED: u8 = 3;

fn main() -> ExitCode {
    let options = match Command::parse(env::args_os().skip(1)) {
        Ok(Command::Run(options)) => options,
        Ok(Command::Print(text)) => {
            if let Err(error) = writeln!(io::stdout(), "{text}") {
                say(&format!("standard output cannot be written: {error}"));
                return FAILED.into();
            }
            return ExitCode::SUCCESS;
        }
        Err(message) => {
            say(&format!("{message}; --help tells more"));
            return WRONG_USAGE.into();
        }
    };
    match run(&options) {
        Ok(Outcome { failed: 0, .. }) => ExitCode::SUCCESS,
        Ok(Outcome { images, failed }) => {
            say(&if matches!(options.source, Source::Track(_)) {
                format!("{failed} of {images} lines have an error")
            } else {
                format!("{failed} of {images} images have no pose")
            });
            SOME_FAILED.into()
        }
        Err(error) => {
            say(&error.to_string());
            FAILED.into()
        }
    }
}

/// Writes a line to standard error, where there is somebody who reads it.
fn say(text: &str) {
    let _ = writeln!(io::stderr(), "ffpose-onboard: {text}");
}

struct Outcome {
    images: u64,
    failed: u64,
}

/// Poses the images one by one: the line of each is out before the next is looked at.
fn run(options: &Options) -> Result<Outcome> {
    if let (Source::Folder(folder), Taken::ByModelsCamera) =
        (&options.source, &options.setup.images)
    {
        frames::expect_no_camera(folder)?;
    }
    let mut estimator = Estimator::open(&options.setup)?;
    let mut answers = Answers::new(io::stdout().lock());
    match &options.source {
        Source::Folder(folder) => {
            for path in frames::of_folder(folder)? {
                answers.give(&path, || estimator.pose(&path))?;
            }
        }
        Source::Track(settings) => {
            let mut track = Track::open(&estimator, settings)?;
            let mut lines = Lines::new(io::stdin().lock());
            while let Some(line) = lines.next_line()? {
                let (time, path) = line.timed();
                answers.give(path, || {
                    line.expect_whole()?;
                    track.follow(&mut estimator, time, path)
                })?;
            }
        }
        Source::Stdin => {
            let mut lines = Lines::new(io::stdin().lock());
            while let Some(line) = lines.next_line()? {
                answers.give(&line.path, || {
                    line.expect_whole()?;
                    estimator.pose(&line.path)
                })?;
            }
        }
    }
    Ok(Outcome { images: answers.images, failed: answers.failed })
}
