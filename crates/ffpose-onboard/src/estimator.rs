//! A model that is ready to run, and the way from an image to a pose.

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use ffpose_track::Symmetry;
use ort::session::{RunOptions, Session, SessionInputs, SessionOutputs};
use ort::value::TensorRef;
use serde_json::{Map, Value};
use sha2::{Digest, Sha256};

use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::files;
use crate::metadata::Metadata;
use crate::model::Model;
use crate::options::{Setup, Taken};
use crate::picture::Picture;
use crate::pose::{Meaning, Outputs, Uncertainty, document};
use crate::reprojection::Reprojection;
use crate::runtime::{open_session, refused};
use crate::watch::Watch;

const INPUT: &str = "images";
const POINT: &str = "point";

/// A model that is ready to run.
pub struct Estimator {
    metadata: Metadata,
    /// Of the model, and of the camera where it is not the model's.
    tag: [u8; 32],
    /// The camera whose aspect ratio an image must have.
    camera: Option<Camera>,
    session: Session,
    /// The looks where an object is expected.
    near: Option<Session>,
    /// Whether the model says how far its poses may be off.
    tells_uncertainty: bool,
    /// What ends a run whose time is over; None where all have time.
    watch: Option<Watch>,
}

/// What limits a look.
#[derive(Clone, Copy, Default)]
pub(crate) struct Look {
    /// Where the object is expected, m, camera frame; None for everywhere.
    pub at: Option<[f64; 3]>,
    /// Until when its answer is of use.
    pub deadline: Deadline,
}

/// The end of the time for an image; None for no end.
#[derive(Clone, Copy, Default)]
pub(crate) struct Deadline(pub Option<Instant>);

impl Deadline {
    /// Whether it has come.
    pub fn is_past(self) -> bool {
        self.0.is_some_and(|end| Instant::now() >= end)
    }

    /// What was done, whatever it is, if it was done in time.
    fn keeps<T>(self, done: Result<T>) -> Result<Option<T>> {
        if self.is_past() { Ok(None) } else { done.map(Some) }
    }
}

impl Estimator {
    /// Opens a model, and runs it once on a black image, whose memory and plans later runs use.
    ///
    /// # Errors
    /// The model, ONNX Runtime, the library of the operator or the camera's file cannot be used.
    pub fn open(setup: &Setup) -> Result<Self> {
        let mut model = Model::read(&setup.model, setup.sha256.as_deref(), "--sha256")?;
        if model.metadata.takes_point {
            let found = "expected a model of whole frames, got that of a track's looks";
            return Err(Error::new(found).of(setup.model.display()));
        }
        let camera = adapt(&mut model.metadata, &setup.images)?;
        let session = open_session(setup, &setup.model, &model)?;
        let near = if setup.tracks { open_beside(setup, &model)? } else { None };
        let tag = tag(&model, &setup.images);
        let metadata = model.metadata;
        let watch = setup.has_deadlines.then(Watch::start).transpose()?;
        let tells_uncertainty = true;
        let mut estimator = Self { metadata, tag, camera, session, near, tells_uncertainty, watch };
        let size =
            3 * estimator.metadata.preprocessing.height * estimator.metadata.preprocessing.width;
        let black = vec![0.0; size];
        let points = [None, estimator.near.is_some().then_some([0.0, 0.0, 1.0])];
        for at in points.into_iter().take(1 + usize::from(estimator.near.is_some())) {
            let outputs = estimator
                .run(&black, Look { at, ..Look::default() })
                .map_err(|error| error.of("the model cannot be run"))?;
            estimator.tells_uncertainty &= outputs.is_some_and(|said| said.uncertainty.is_some());
        }
        Ok(estimator)
    }

    /// Returns the pose that an image file shows, as JSON without the image's name.
    ///
    /// # Errors
    /// The file is no image that can be used, of another aspect ratio than the camera's, or the network fails.
    pub fn pose(&mut self, path: &Path) -> Result<Map<String, Value>> {
        let outputs = self.outputs(path, None)?;
        Ok(document(&outputs, &self.metadata.meaning))
    }

    /// Returns what the network says of an image file, which it looks at once where the object is expected.
    pub(crate) fn outputs(&mut self, path: &Path, at: Option<[f64; 3]>) -> Result<Outputs> {
        let picture = Picture::read(path, self.metadata.white)?;
        let outputs = self.look(&picture, Look { at, ..Look::default() })?;
        outputs.ok_or_else(|| Error::new("expected an answer, got none"))
    }

    /// Returns what the network says of an image; None where it was not done in time.
    pub(crate) fn look(&mut self, picture: &Picture, look: Look) -> Result<Option<Outputs>> {
        if let Some(camera) = &self.camera {
            camera.expect_aspect(picture.width, picture.height)?;
        }
        let Some(input) = self.metadata.preprocessing.input(picture, look.deadline)? else {
            return Ok(None);
        };
        self.run(&input, look)?.map(Outputs::checked).transpose()
    }

    /// Refuses a model whose poses no tracker can take.
    ///
    /// # Errors
    /// It does not say how far they may be off.
    pub(crate) fn expect_uncertainty(&self) -> Result<()> {
        if self.tells_uncertainty {
            return Ok(());
        }
        Err(Error::new(
            "expected a model that predicts uncertainty, as a track needs it, got one that does not",
        ))
    }

    /// How the outputs are read.
    pub(crate) fn meaning(&self) -> &Meaning {
        &self.metadata.meaning
    }

    /// What the model says of its errors for a tracker.
    pub(crate) fn tracking(&self) -> &Map<String, Value> {
        &self.metadata.tracking
    }

    /// Rotations of the object modulo which the model tells attitudes.
    pub(crate) fn symmetry(&self) -> &Symmetry {
        &self.metadata.symmetry
    }

    /// What tells tracks of other models and cameras: the SHA-256 of the model's file, or of that and how its images are taken.
    pub(crate) fn tag(&self) -> &[u8; 32] {
        &self.tag
    }

    fn run(&mut self, input: &[f32], look: Look) -> Result<Option<Outputs>> {
        let shape = [1, 3, self.metadata.preprocessing.height, self.metadata.preprocessing.width];
        let tensor = TensorRef::from_array_view((shape, input)).map_err(|error| refused(&error))?;
        let (watch, deadline) = (self.watch.as_mut(), look.deadline);
        let Some((session, at)) = self.near.as_mut().zip(look.at) else {
            let inputs = ort::inputs![INPUT => tensor];
            return run_until(&mut self.session, watch, deadline, inputs.into());
        };
        #[allow(clippy::cast_possible_truncation)] // as Python hands it over
        let point = at.map(|part| part as f32);
        let point =
            TensorRef::from_array_view(([1, 3], &point[..])).map_err(|error| refused(&error))?;
        let inputs = ort::inputs![INPUT => tensor, POINT => point];
        run_until(session, watch, deadline, inputs.into())
    }
}

fn tag(model: &Model, images: &Taken) -> [u8; 32] {
    let mut hash = Sha256::new_with_prefix(model.digest);
    match (&model.metadata.preprocessing.reprojection, images) {
        (Some(reprojection), _) => hash.update(reprojection.source.to_bytes()),
        (None, Taken::Resized) => hash.update("resized"),
        (None, _) => return model.digest,
    }
    hash.finalize().into()
}

/// Opens the looks beside a model, `X.track.onnx` of `X.onnx`; None where there are none, and the model records none.
///
/// They are those whose digest the model records. One that records none takes any of its weights, but for where its own digest is
/// given: that would not cover them.
fn open_beside(setup: &Setup, whole: &Model) -> Result<Option<Session>> {
    let path = setup.model.with_extension("track.onnx");
    let recorded = whole.metadata.track_sha256.as_deref();
    if !files::exists(&path)? {
        return recorded.map_or(Ok(None), |_| {
            Err(Error::new(format!(
                "expected this file, a track's looks that {} was exported with, got none: copy it too, or export without --track",
                setup.model.display()
            ))
            .of(path.display()))
        });
    }
    if recorded.is_none() && setup.sha256.is_some() {
        return Err(Error::new(format!(
            "expected a model that records the SHA-256 of these looks, which --sha256 then covers, got {} without: export it anew \
             with --track, or move this file away",
            setup.model.display()
        ))
        .of(path.display()));
    }
    let beside = Model::read(&path, recorded, "of the model beside it")?;
    let weights = &beside.metadata.weights_sha256;
    let is_its = !weights.is_empty() && *weights == whole.metadata.weights_sha256;
    if !beside.metadata.takes_point || !is_its {
        let expected = "expected a track's looks of the weights of the model beside it";
        return Err(Error::new(expected).of(path.display()));
    }
    open_session(setup, &path, &beside).map(Some)
}

/// Runs a session, until a deadline if there is one: None where it has come before the outputs, when the run is terminated.
fn run_until(
    session: &mut Session,
    watch: Option<&mut Watch>,
    deadline: Deadline,
    inputs: SessionInputs<'_, '_>,
) -> Result<Option<Outputs>> {
    let Some((watch, end)) = watch.zip(deadline.0) else {
        let outputs = session.run(inputs).map_err(|error| refused(&error));
        return deadline.keeps(outputs.and_then(|outputs| read_outputs(&outputs)));
    };
    if deadline.is_past() {
        return Ok(None);
    }
    let options = Arc::new(RunOptions::new().map_err(|error| refused(&error))?);
    let ended = Arc::clone(&options);
    // A run that cannot be terminated ends by itself.
    let terminate = move || drop(ended.terminate());
    let outputs = watch.over(end, terminate, || session.run_with_options(inputs, &*options))?;
    let outputs = outputs.map_err(|error| refused(&error));
    deadline.keeps(outputs.and_then(|outputs| read_outputs(&outputs)))
}

/// Prepares a model for the images to come; returns the camera whose aspect ratio they must have, `None` for any.
fn adapt(metadata: &mut Metadata, images: &Taken) -> Result<Option<Camera>> {
    let path = match images {
        Taken::Resized => return Ok(None),
        Taken::ByModelsCamera if metadata.undistorted => {
            return Err(Error::new(
                "expected --camera FILE, whose distortion is taken out of images as in training, or --resize for images \
                 without distortion, got neither",
            ));
        }
        Taken::ByModelsCamera => return Ok(metadata.camera.clone()),
        Taken::ByCamera(path) => path,
    };
    let source = Camera::read(path)?;
    let view = metadata.view.clone().ok_or_else(|| {
        Error::new(
            "--camera: expected a model that knows the camera of its input, to which images are reprojected, got one that \
             does not; --resize takes images of any camera as they are",
        )
    })?;
    let agrees = metadata.preprocessing.camera(&source).agrees_with(&view);
    if agrees && source.lens() == metadata.distortion {
        return Ok(Some(source));
    }
    if let Some(distortion) = metadata.distortion {
        return Err(Error::new(format!(
            "--camera: expected that of training, with the distortion {distortion:?}, which was not taken out, got another; \
             --resize takes images as they are"
        )));
    }
    metadata.preprocessing.reprojection = Some(Reprojection { source, view });
    Ok(None)
}

fn read_outputs(outputs: &SessionOutputs) -> Result<Outputs> {
    let square =
        |values: [f64; 9]| [0, 3, 6].map(|row| [values[row], values[row + 1], values[row + 2]]);
    let uncertainty = if outputs.contains_key("in_view") {
        let [in_view] = numbers(outputs, "in_view")?;
        Some(Uncertainty {
            translation_covariance: square(numbers(outputs, "translation_covariance")?),
            rotation_covariance: square(numbers(outputs, "rotation_covariance")?),
            in_view,
            alternative: numbers(outputs, "alternative")?,
            probabilities: numbers(outputs, "probabilities")?,
        })
    } else {
        None
    };
    let (translation, orientation) =
        (numbers(outputs, "translation")?, numbers(outputs, "orientation")?);
    Ok(Outputs { translation, orientation, uncertainty })
}

/// Returns the `N` numbers of an output.
fn numbers<const N: usize>(outputs: &SessionOutputs, name: &str) -> Result<[f64; N]> {
    let output = outputs
        .get(name)
        .ok_or_else(|| Error::new(format!("expected an output {name}, got none")))?;
    let (shape, values) = output.try_extract_tensor::<f32>().map_err(|error| refused(&error))?;
    let values: [f32; N] = values.try_into().map_err(|_| {
        Error::new(format!("{name}: expected {N} numbers, got those of shape {shape:?}"))
    })?;
    Ok(values.map(f64::from))
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn what_is_done_after_the_deadline_is_not_kept() {
        let past = Deadline(Some(Instant::now()));
        let later = Deadline(Some(Instant::now() + Duration::from_hours(1)));
        assert!(past.is_past() && !later.is_past() && !Deadline::default().is_past());
        assert_eq!(past.keeps(Ok(1)).unwrap(), None);
        assert_eq!(past.keeps::<u8>(Err(Error::new("terminated"))).unwrap(), None);
        for deadline in [later, Deadline::default()] {
            assert_eq!(deadline.keeps(Ok(1)).unwrap(), Some(1));
            assert!(deadline.keeps::<u8>(Err(Error::new("failed"))).is_err());
        }
    }
}
