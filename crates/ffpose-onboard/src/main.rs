//! Poses from images without Python: a model of `ffpose export` in ONNX Runtime, one JSON line per image.
//!
//! `frames → picture → preprocessing (resize) → estimator (metadata, runtime) → pose → a line`.

mod error;
mod estimator;
mod frames;
mod metadata;
mod options;
mod picture;
mod pose;
mod preprocessing;
mod records;
mod resize;
mod runtime;

use std::env;
use std::io::{self, Write};
use std::path::Path;
use std::process::ExitCode;

use serde_json::{Map, Value};

use error::{Error, Result};
use estimator::Estimator;
use options::{Command, Options, Source};

const FAILED: u8 = 1;
const WRONG_USAGE: u8 = 2;
const SOME_FAILED: u8 = 3;

fn main() -> ExitCode {
    let options = match Command::parse(env::args_os().skip(1)) {
        Ok(Command::Run(options)) => options,
        Ok(Command::Print(text)) => {
            println!("{text}");
            return ExitCode::SUCCESS;
        }
        Err(message) => {
            eprintln!("ffpose-onboard: {message}; --help tells more");
            return WRONG_USAGE.into();
        }
    };
    match run(&options) {
        Ok(Count { failed: 0, .. }) => ExitCode::SUCCESS,
        Ok(Count { frames, failed }) => {
            eprintln!("ffpose-onboard: {failed} of {frames} images have no pose");
            SOME_FAILED.into()
        }
        Err(error) => {
            eprintln!("ffpose-onboard: {error}");
            FAILED.into()
        }
    }
}

#[derive(Default)]
struct Count {
    frames: u64,
    failed: u64,
}

fn run(options: &Options) -> Result<Count> {
    let mut estimator = Estimator::open(options)?;
    let mut count = Count::default();
    match &options.source {
        Source::Folder(folder) => {
            for path in frames::of_folder(folder)? {
                print_frame(&mut estimator, &path, &mut count)?;
            }
        }
        Source::Stdin => {
            let mut input = io::stdin().lock();
            while let Some(path) = frames::next_line(&mut input)? {
                print_frame(&mut estimator, &path, &mut count)?;
            }
        }
    }
    Ok(count)
}

/// Prints the line of one image: all of it in one write, before the next image is looked at.
fn print_frame(estimator: &mut Estimator, path: &Path, count: &mut Count) -> Result<()> {
    let mut fields = Map::from_iter([("image".into(), Value::from(path.to_string_lossy()))]);
    match estimator.pose(path) {
        Ok(pose) => fields.extend(pose),
        Err(error) => {
            count.failed += 1;
            fields.insert("error".into(), error.to_string().into());
        }
    }
    count.frames += 1;
    let line = format!("{}\n", Value::Object(fields));
    let mut output = io::stdout().lock();
    let written = output.write_all(line.as_bytes()).and_then(|()| output.flush());
    written.map_err(|error| Error::new(format!("standard output cannot be written: {error}")))
}
