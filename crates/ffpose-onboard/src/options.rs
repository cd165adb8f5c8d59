//! The command line.

use std::env;
use std::ffi::{OsStr, OsString};
use std::path::PathBuf;

/// What `--help` prints.
pub const HELP: &str = "\
Print the pose of the spacecraft in each image, one JSON line each, as soon as it is known.

usage: ffpose-onboard --model FILE (--images DIR | --stdin | --track) [options]

  --model FILE      model of `ffpose export`
  --images DIR      pose the .png, .jpg, .jpeg and .pgm files of a folder, by name
  --stdin           pose the files whose paths come in lines on standard input, until it ends
  --track           pose and track the files whose times and paths come in lines \"TIME PATH\" on standard
                    input, seconds; \"TIME\" alone is a frame that never came, \"reset\" forgets the track. Where
                    X.track.onnx of `ffpose export --track` is beside the model X.onnx, each look goes
                    where the object is expected
  --state FILE      of a track: taken up if it is there, and written anew after each frame
  --settings FILE   of a track: JSON of what ffpose.tracking.Settings names (default: the model's)
  --threads N       threads that an image is computed with (default: ONNX Runtime's choice)
  --runtime PATH    ONNX Runtime's library (default: ORT_DYLIB_PATH, else libonnxruntime.so beside
                    this program or among the system's libraries)
  --sha256 HEX      SHA-256 that the model's file must have, of what was signed for a mission; without,
                    damage is told by the checksum in the file, but not what was changed on purpose
  --operators PATH  libffpose_ort.so, for models exported with --filter custom that have filters
  --camera FILE     camera that takes the images, if another than the model's: JSON of width, height, fx, fy,
                    cx, cy and, of a lens that distorts, distortion; images are reprojected by geometry.
                    A camera.json in the folder of --images is to be named so; none is looked for
                    beside paths that come in
  --resize          resize an image of any aspect ratio to the network's input, as if the model's
                    camera had taken it; without, another aspect ratio is an error of that image
  --help, --version

A line has the fields of `ffpose predict --json`, or image and error. Exit code 0: every image has a
pose; 1: nothing could be done, standard error says why; 2: wrong usage; 3: some images failed.";

/// The most threads that an image is computed with.
pub const MAX_THREADS: usize = 1024;

/// What is asked for.
#[derive(Debug, PartialEq)]
pub struct Options {
    /// The model and how it is run.
    pub setup: Setup,
    /// Where the images are.
    pub source: Source,
}

/// A model and how it is run.
#[derive(Debug, PartialEq)]
pub struct Setup {
    /// The ONNX file.
    pub model: PathBuf,
    /// Whether its looks where an object is expected are opened too, if they are beside it.
    pub tracks: bool,
    /// Whether looks may have to end in a time.
    pub has_deadlines: bool,
    /// That an image is computed with; `None`: as many as ONNX Runtime finds good.
    pub threads: Option<usize>,
    /// The digest that the ONNX file must have, hexadecimal.
    pub sha256: Option<String>,
    /// ONNX Runtime's library; `None`: of the system's name, beside this program or among the system's.
    pub runtime: Option<PathBuf>,
    /// The library of ffpose's operator.
    pub operators: Option<PathBuf>,
    /// What took the images.
    pub images: Taken,
}

/// What took the images.
#[derive(Debug, PartialEq)]
pub enum Taken {
    /// A camera like that of the images trained on.
    ByModelsCamera,
    /// The camera of a file, from which they are reprojected.
    ByCamera(PathBuf),
    /// Any, of whose images all are resized to the network's input.
    Resized,
}

/// Where the images are.
#[derive(Debug, PartialEq)]
pub enum Source {
    /// All of a folder.
    Folder(PathBuf),
    /// As named in lines on standard input.
    Stdin,
    /// As named with their times in lines on standard input, for a track.
    Track(TrackFiles),
}

/// The files of a track.
#[derive(Debug, Default, PartialEq)]
pub struct TrackFiles {
    /// Where its state is kept.
    pub state: Option<PathBuf>,
    /// Its settings.
    pub settings: Option<PathBuf>,
}

/// What a command line asks for.
#[derive(Debug, PartialEq)]
pub enum Command {
    /// To pose images.
    Run(Options),
    /// To print a text.
    Print(&'static str),
}

impl Command {
    /// Reads the arguments after the program's name.
    ///
    /// # Errors
    /// They are wrong; the text says what is.
    pub fn parse(arguments: impl IntoIterator<Item = OsString>) -> Result<Self, String> {
        let mut arguments = arguments.into_iter();
        let mut given = Given::default();
        while let Some(argument) = arguments.next() {
            let name = argument.to_string_lossy().into_owned();
            match name.as_str() {
                "--help" | "-h" => return Ok(Self::Print(HELP)),
                "--version" => {
                    return Ok(Self::Print(concat!("ffpose-onboard ", env!("CARGO_PKG_VERSION"))));
                }
                _ => given.take(&name, || arguments.next())?,
            }
        }
        given.options().map(Self::Run)
    }
}

#[derive(Default)]
struct Given {
    model: Option<PathBuf>,
    images: Option<PathBuf>,
    stdin: bool,
    track: bool,
    state: Option<PathBuf>,
    settings: Option<PathBuf>,
    threads: Option<usize>,
    sha256: Option<String>,
    runtime: Option<PathBuf>,
    operators: Option<PathBuf>,
    camera: Option<PathBuf>,
    resize: bool,
}

impl Given {
    fn take(
        &mut self,
        name: &str,
        mut next: impl FnMut() -> Option<OsString>,
    ) -> Result<(), String> {
        let mut value = || next().ok_or_else(|| format!("{name}: expected a value, got none"));
        match name {
            "--stdin" => self.stdin = true,
            "--track" => self.track = true,
            "--state" => self.state = Some(value()?.into()),
            "--settings" => self.settings = Some(value()?.into()),
            "--resize" => self.resize = true,
            "--camera" => self.camera = Some(value()?.into()),
            "--threads" => self.threads = Some(count(&value()?)?),
            "--sha256" => self.sha256 = Some(digest("--sha256", &value()?)?),
            "--model" => self.model = Some(value()?.into()),
            "--images" => self.images = Some(value()?.into()),
            "--runtime" => self.runtime = Some(value()?.into()),
            "--operators" => self.operators = Some(value()?.into()),
            _ => {
                return Err(format!("expected one of the options that --help lists, got {name}"));
            }
        }
        Ok(())
    }

    fn options(self) -> Result<Options, String> {
        const SOURCES: &str = "--images, --stdin or --track";
        let files = TrackFiles { state: self.state, settings: self.settings };
        if !self.track && files != TrackFiles::default() {
            return Err("expected --state and --settings with --track, got no --track".into());
        }
        let source = match (self.images, self.stdin, self.track) {
            (Some(folder), false, false) => Source::Folder(folder),
            (None, true, false) => Source::Stdin,
            (None, false, true) => Source::Track(files),
            (None, false, false) => return Err(format!("expected {SOURCES}, got neither")),
            _ => return Err(format!("expected {SOURCES}, got several")),
        };
        let setup = Setup {
            model: self.model.ok_or("expected --model, got none")?,
            tracks: self.track,
            has_deadlines: false,
            threads: self.threads,
            sha256: self.sha256,
            runtime: self.runtime.or_else(default_runtime),
            operators: self.operators,
            images: match (self.camera, self.resize) {
                (None, false) => Taken::ByModelsCamera,
                (Some(file), false) => Taken::ByCamera(file),
                (None, true) => Taken::Resized,
                (Some(_), true) => return Err("expected --camera or --resize, got both".into()),
            },
        };
        Ok(Options { setup, source })
    }
}

fn count(value: &OsString) -> Result<usize, String> {
    let text = value.to_string_lossy();
    let number = text.parse().ok().filter(|number| (1..=MAX_THREADS).contains(number));
    number
        .ok_or_else(|| format!("--threads: expected a number from 1 to {MAX_THREADS}, got {text}"))
}

pub(crate) fn digest(name: &str, value: &OsStr) -> Result<String, String> {
    let text = value.to_string_lossy().to_lowercase();
    if text.len() == 64 && text.bytes().all(|byte| byte.is_ascii_hexdigit()) {
        return Ok(text);
    }
    Err(format!("{name}: expected 64 hexadecimal digits, got {text}"))
}

/// Returns ONNX Runtime's library of the environment, where no other is named.
#[must_use]
pub fn default_runtime() -> Option<PathBuf> {
    env::var_os("ORT_DYLIB_PATH").filter(|path| !path.is_empty()).map(PathBuf::from)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(arguments: &str) -> Result<Command, String> {
        Command::parse(arguments.split_whitespace().map(OsString::from))
    }

    #[test]
    fn options_are_read() {
        let digest = "0A".repeat(32);
        let arguments = format!(
            "--stdin --model m.onnx --threads 2 --sha256 {digest} --runtime /r.so --operators o.so --camera c.json"
        );
        let setup = Setup {
            model: "m.onnx".into(),
            tracks: false,
            has_deadlines: false,
            threads: Some(2),
            sha256: Some("0a".repeat(32)),
            runtime: Some("/r.so".into()),
            operators: Some("o.so".into()),
            images: Taken::ByCamera("c.json".into()),
        };
        let expected = Options { setup, source: Source::Stdin };
        assert_eq!(parse(&arguments), Ok(Command::Run(expected)));
        assert_eq!(parse("--model x --help"), Ok(Command::Print(HELP)));
    }

    #[test]
    fn wrong_usage_is_told() {
        for (arguments, message) in [
            ("--stdin", "expected --model, got none"),
            ("--model m", "expected --images, --stdin or --track, got neither"),
            ("--model m --stdin --images d", "expected --images, --stdin or --track, got several"),
            ("--model m --stdin --state s", "expected --state and --settings with --track"),
            ("--model", "--model: expected a value"),
            ("--model m --stdin --threads 0", "--threads: expected a number from 1 to 1024, got 0"),
            ("--model m --stdin --threads two", "got two"),
            (
                "--model m --stdin --sha256 12ab",
                "--sha256: expected 64 hexadecimal digits, got 12ab",
            ),
            ("--model m --stdin --resize --camera c", "expected --camera or --resize, got both"),
            ("--any-camera", "got --any-camera"),
            ("image.png", "got image.png"),
        ] {
            let error = parse(arguments).unwrap_err();
            assert!(error.contains(message), "{error}");
        }
    }
}
