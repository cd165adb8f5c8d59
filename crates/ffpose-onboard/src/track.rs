//! A track of the poses, its state in a file, and its lines.

use std::ffi::OsString;
use std::fs::{self, File, remove_file, rename};
use std::io::Write;
use std::path::{Path, PathBuf};

use ffpose_track::{Estimate, Measurement, Mode, Parameters, STATE_BYTES, Step, Tracker};
use serde_json::{Map, Value, json};

use crate::answers::unpanicked;
use crate::error::{Error, Result};
use crate::estimator::Estimator;
use crate::files;
use crate::json;
use crate::options::TrackFiles;
use crate::pose::{Meaning, Outputs, document};

/// A number of settings that JSON has no other word for.
const INFINITE: &str = "inf";

/// Links one after the other that are followed, as Linux does.
const MOST_LINKS: usize = 40;

/// The line that forgets a track.
const RESET: &str = "reset";

/// A track, and the file of its state.
pub struct Track {
    tracker: Tracker,
    /// Of the model whose poses are tracked, and of the camera.
    tag: [u8; 32],
    state: Option<PathBuf>,
}

impl Track {
    /// Starts a track, or takes it up where a state was written, of a model that can be tracked.
    ///
    /// # Errors
    /// The model tells no uncertainty, the settings cannot be used, or the state is none, damaged, or of another model, camera or
    /// other settings, or cannot be written.
    pub fn open(estimator: &Estimator, files: &TrackFiles) -> Result<Self> {
        estimator.expect_uncertainty()?;
        let mut track = Self::new(estimator, files.settings.as_deref())?;
        track.state.clone_from(&files.state);
        if let Some(path) = &files.state {
            if files::exists(path)? {
                track.restore(path)?;
            }
            track.save(path)?; // one that cannot be written is told before there are frames
        }
        Ok(track)
    }

    /// Starts a track by the settings of a file, without a state.
    pub(crate) fn new(estimator: &Estimator, settings: Option<&Path>) -> Result<Self> {
        let tracker = Tracker::new(parameters(estimator, settings)?);
        let tracker = tracker.map_err(|error| Error::new(error.to_string()))?;
        let tracker = tracker.modulo(estimator.symmetry().clone());
        Ok(Self { tracker, tag: *estimator.tag(), state: None })
    }

    /// Poses an image at a time, seconds, and returns its line: what the track makes of it, and what the network says.
    ///
    /// An image that cannot be used, or none, is coasted over. `reset` in place of time and path forgets the track.
    ///
    /// # Errors
    /// The time is no number or not later than the one before: the track stays as it is.
    pub fn follow(
        &mut self,
        estimator: &mut Estimator,
        time: &str,
        path: &Path,
    ) -> Result<Map<String, Value>> {
        if time == RESET && path.as_os_str().is_empty() {
            self.reset();
            let line = Map::from_iter([
                ("accepted".into(), json!(false)),
                ("reason".into(), json!(RESET)),
            ]);
            return Ok(self.kept(line, None));
        }
        let seconds = time.parse().map_err(|_| {
            Error::new(format!("time: expected seconds before the path, got \"{time}\""))
        })?;
        self.expect_time(seconds)?;
        let (at, meaning) = (self.expected(seconds), *estimator.meaning());
        let look = || estimator.outputs(path, at);
        self.advance(seconds, (!path.as_os_str().is_empty()).then_some(look), &meaning)
    }

    /// Moves on to a time, seconds, with what a look at a frame gives, and returns the line.
    ///
    /// A look that fails or panics, or gives what no tracker can take, is an error in the line; the track coasts.
    fn advance(
        &mut self,
        seconds: f64,
        look: Option<impl FnOnce() -> Result<Outputs>>,
        meaning: &Meaning,
    ) -> Result<Map<String, Value>> {
        let looked = look.map(unpanicked).transpose();
        let (outputs, mut failed) =
            looked.map_or_else(|error| (None, Some(error)), |one| (one, None));
        let seen = outputs.as_ref().map(|outputs| measurement(outputs, meaning)).transpose();
        let seen = seen.unwrap_or_else(|error| {
            failed = Some(error);
            None
        });
        let step = self.step(seconds, seen.as_ref())?;
        let mut line = Map::from_iter([("time".into(), json!(seconds))]);
        line.extend(told(&step));
        if let Some(outputs) = &outputs {
            line.insert("measured".into(), document(outputs, meaning).into());
        }
        Ok(self.kept(line, failed))
    }

    /// Writes the state, and completes a line.
    fn kept(&self, mut line: Map<String, Value>, failed: Option<Error>) -> Map<String, Value> {
        let kept = self.state.as_deref().map(|path| self.save(path)).transpose();
        for (name, error) in [("error", failed), ("state_error", kept.err())] {
            if let Some(error) = error {
                line.insert(name.into(), error.to_string().into());
            }
        }
        line
    }

    /// Forgets all frames and their times.
    pub(crate) fn reset(&mut self) {
        self.tracker.reset();
    }

    /// Refuses a time, seconds, that no frame can have next.
    pub(crate) fn expect_time(&self, time: f64) -> Result<()> {
        self.tracker.check_time(time).map_err(|error| Error::new(error.to_string()))
    }

    /// Where the object is expected at a time, seconds; None for anywhere.
    pub(crate) fn expected(&self, time: f64) -> Option<[f64; 3]> {
        self.tracker.expected(time, [0.0; 3])
    }

    /// Moves on to a time, seconds, with what a frame says.
    pub(crate) fn step(&mut self, time: f64, seen: Option<&Measurement>) -> Result<Step> {
        let step = self.tracker.step(time, seen, [0.0; 3]);
        step.map_err(|error| Error::new(error.to_string()))
    }

    /// Writes the state, by a file beside that is renamed: after a loss of power there is the old one or the new one, once this has
    /// returned the new one where a folder can be synced. A link stays, and what it points to is written.
    pub(crate) fn save(&self, path: &Path) -> Result<()> {
        let refused = |error| Error::new(format!("cannot be written: {error}")).of(path.display());
        let path = &resolved(path);
        let mut name = OsString::from(".");
        name.push(path.file_name().unwrap_or_default());
        name.push(".ffpose-new"); // no other's, whatever their states are called
        let beside = path.with_file_name(name);
        let mut file = File::create(&beside).map_err(refused)?;
        let write = || {
            file.write_all(&self.tracker.to_bytes(&self.tag))?;
            file.sync_all()?;
            drop(file); // Windows renames no open file
            rename(&beside, path)
        };
        write().map_err(|error| {
            let _ = remove_file(&beside); // what stays is written over by the next
            refused(error)
        })?;
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
        if let Ok(folder) = File::open(folder.unwrap_or(Path::new("."))) {
            let _ = folder.sync_all(); // some systems have none of a folder; the state is there
        }
        Ok(())
    }

    /// Takes up a state.
    pub(crate) fn restore(&mut self, path: &Path) -> Result<()> {
        let refused = |error: ffpose_track::Error| Error::new(error.to_string());
        let bytes = files::read(path, STATE_BYTES as u64 + 1);
        let tracker =
            bytes.and_then(|bytes| Tracker::from_bytes(&bytes, &self.tag).map_err(refused));
        let tracker = tracker.map_err(|error| error.of(path.display()))?;
        if tracker.parameters() != self.tracker.parameters() {
            let other = "state: expected one of these settings, got that of others";
            return Err(Error::new(other).of(path.display()));
        }
        self.tracker = tracker.modulo(self.tracker.symmetry().clone());
        Ok(())
    }
}

/// The file that a path links to, which need not be there yet.
fn resolved(path: &Path) -> PathBuf {
    let mut path = path.to_path_buf();
    for _ in 0..MOST_LINKS {
        match fs::read_link(&path) {
            Ok(to) => path = path.parent().unwrap_or(Path::new("")).join(to),
            Err(_) => break, // it is no link
        }
    }
    path
}

/// The settings of a track: the usual ones, what the model knows of its errors, and those of a file.
fn parameters(estimator: &Estimator, file: Option<&Path>) -> Result<Parameters> {
    if estimator.meaning().locates_camera {
        let found = "expected a model that locates an object, got one of a camera";
        return Err(Error::new(found));
    }
    let mut parameters = Parameters::default();
    if let Some([position, rotation]) = estimator.meaning().degrees_of_freedom {
        parameters.tails = position.min(rotation);
    }
    set(&mut parameters, estimator.tracking())?;
    if let Some(path) = file {
        let settings = json::read_fields(path);
        settings
            .and_then(|settings| set(&mut parameters, &settings))
            .map_err(|error| error.of(path.display()))?;
    }
    Ok(parameters)
}

/// Sets what settings name, and checks them all.
fn set(parameters: &mut Parameters, settings: &Map<String, Value>) -> Result<()> {
    for (name, value) in settings {
        let number =
            |value: &Value| if value == INFINITE { Some(f64::INFINITY) } else { value.as_f64() };
        let values: Option<Vec<f64>> = match value {
            Value::Array(values) => values.iter().map(number).collect(),
            value => number(value).map(|number| vec![number]),
        };
        let set = parameters.set(name, &values.unwrap_or_default());
        set.map_err(|error| Error::new(format!("{name}: {error}, got {value}")))?;
    }
    parameters.check().map_err(|error| Error::new(error.to_string()))
}

/// What a network says of a frame, as a tracker takes it.
///
/// # Errors
/// It has no uncertainty, or one that a tracker cannot take.
pub(crate) fn measurement(outputs: &Outputs, meaning: &Meaning) -> Result<Measurement> {
    if outputs.flagged(meaning) == Some(true) {
        return Ok(Measurement::flagged());
    }
    let said = outputs.uncertainty.as_ref().ok_or_else(|| {
        Error::new("expected a model that predicts uncertainty, got one that does not")
    })?;
    let mode = |orientation, probability| {
        Mode::new(
            outputs.translation,
            orientation,
            said.translation_covariance,
            said.rotation_covariance,
            probability,
        )
    };
    let modes = [(outputs.orientation, 0), (said.alternative, 1)];
    let [first, second] = modes.map(|(q, place)| mode(q, said.probabilities[place]));
    let measured = first.and_then(|first| Measurement::new(&[first, second?]));
    measured.map_err(|error| Error::new(error.to_string()))
}

/// The line of a frame; numbers are there while there is a track.
fn told(step: &Step) -> Map<String, Value> {
    let mut line = Map::new();
    let mut put = |name: &str, value: Value| line.insert(name.into(), value);
    put("accepted", json!(step.accepted));
    put("reason", json!(step.outcome.name()));
    if let Some(one) = &step.estimate {
        let Estimate { position, orientation, velocity, rate, covariance } = one;
        let rows: [[f64; 12]; 12] = (*covariance).into();
        put("translation_m", json!(position));
        put("orientation_wxyz", json!(orientation));
        put("velocity_m_s", json!(velocity));
        put("angular_velocity_deg_s", json!(rate.map(f64::to_degrees)));
        put("covariance", rows.iter().map(|row| json!(row)).collect::<Vec<_>>().into());
    }
    put("nis", json!(step.nis));
    line
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::Uncertainty;

    fn track() -> Track {
        Track { tracker: Tracker::new(Parameters::default()).unwrap(), tag: [0; 32], state: None }
    }

    fn outputs(rotation_variance: f64) -> Outputs {
        let diagonal = |last: f64| [[1e-3, 0.0, 0.0], [0.0, 1e-3, 0.0], [0.0, 0.0, last]];
        Outputs {
            translation: [0.0, 0.0, 9.0],
            orientation: [1.0, 0.0, 0.0, 0.0],
            uncertainty: Some(Uncertainty {
                translation_covariance: diagonal(1e-3),
                rotation_covariance: diagonal(rotation_variance),
                in_view: 1.0,
                alternative: [0.0, 1.0, 0.0, 0.0],
                probabilities: [1.0, 0.0],
            }),
        }
    }

    type Look = Box<dyn FnOnce() -> Result<Outputs>>;

    #[test]
    fn frames_that_cannot_be_used_are_coasted_over() {
        let mut track = track();
        let mut time = 0.0;
        let mut next = |look: Option<Look>| {
            time += 1.0;
            let line = track.advance(time, look, &Meaning::default()).unwrap();
            (line, track.tracker.time())
        };
        for _ in 0..5 {
            next(Some(Box::new(|| Ok(outputs(1e-3)))));
        }
        let looks: [(Look, &str); 3] = [
            (Box::new(|| Err(Error::new("cut short"))), "cut short"),
            (Box::new(|| panic!("row {}", 7)), "row 7"),
            (Box::new(|| Ok(outputs(0.0))), "rotation_covariance: expected a positive definite"),
        ];
        for (place, (look, message)) in looks.into_iter().enumerate() {
            let (line, time) = next(Some(look));
            assert_eq!(line["reason"], "coasted");
            assert_eq!(time, Some(6.0 + place as f64));
            assert!(line.contains_key("translation_m"), "{line:?}");
            assert!(line["error"].as_str().unwrap().contains(message), "{line:?}");
        }
        assert_eq!(next(None).0["reason"], "coasted");
        assert_eq!(next(Some(Box::new(|| Ok(outputs(1e-3))))).0["reason"], "accepted");
    }

    #[cfg(unix)]
    #[test]
    fn a_link_stays_and_what_it_points_to_is_written() {
        let folder = std::env::temp_dir().join(format!("ffpose-track-link-{}", std::process::id()));
        fs::create_dir_all(folder.join("data")).unwrap();
        let (link, state) = (folder.join("link"), folder.join("data/track.state"));
        std::os::unix::fs::symlink("data/next", &link).unwrap();
        std::os::unix::fs::symlink("track.state", folder.join("data/next")).unwrap();
        for _ in 0..2 {
            track().save(&link).unwrap(); // to a file that is not there yet, and to one that is
            assert!(link.is_symlink() && !state.is_symlink());
            assert_eq!(fs::read(&state).unwrap().len(), STATE_BYTES);
        }
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_state_that_cannot_be_written_hides_no_error_and_is_none_of_an_image() {
        let state = Some(PathBuf::from("/nowhere/at/all/track.state"));
        let mut track = Track { state, ..track() };
        let told = "/nowhere/at/all/track.state: cannot be written";
        let looks: [(Option<Look>, Option<&str>); 3] = [
            (Some(Box::new(|| Ok(outputs(1e-3)))), None),
            (Some(Box::new(|| Err(Error::new("cut short")))), Some("cut short")),
            (None, None),
        ];
        for (time, (look, error)) in looks.into_iter().enumerate() {
            let line = track.advance(time as f64, look, &Meaning::default()).unwrap();
            assert!(line["state_error"].as_str().unwrap().starts_with(told), "{line:?}");
            assert_eq!(line.get("error").and_then(Value::as_str), error);
        }
    }
}
