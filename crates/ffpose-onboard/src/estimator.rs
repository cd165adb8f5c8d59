//! A model that is ready to run, and the way from an image file to a pose.

use std::path::Path;

use ort::session::{Session, SessionOutputs};
use ort::value::TensorRef;
use serde_json::{Map, Value};

use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::metadata::Metadata;
use crate::model::Model;
use crate::options::{Options, Taken};
use crate::picture::Picture;
use crate::pose::{Outputs, Uncertainty, document};
use crate::reprojection::Reprojection;
use crate::runtime::{open_session, refused};

const INPUT: &str = "images";

/// A model that is ready to run.
pub struct Estimator {
    metadata: Metadata,
    /// The camera whose aspect ratio an image must have.
    camera: Option<Camera>,
    session: Session,
}

impl Estimator {
    /// Opens a model, and runs it once on a black image, whose memory and plans later runs use.
    ///
    /// # Errors
    /// The model, ONNX Runtime, the library of the operator or the camera's file cannot be used.
    pub fn open(options: &Options) -> Result<Self> {
        let mut model = Model::read(&options.model, options.sha256.as_deref())?;
        let camera = adapt(&mut model.metadata, &options.images)?;
        let session = open_session(options, &model)?;
        let mut estimator = Self { metadata: model.metadata, camera, session };
        let size =
            3 * estimator.metadata.preprocessing.height * estimator.metadata.preprocessing.width;
        estimator.run(&vec![0.0; size]).map_err(|error| error.of("the model cannot be run"))?;
        Ok(estimator)
    }

    /// Returns the pose that an image file shows, as JSON without the image's name.
    ///
    /// # Errors
    /// The file is no image that can be used, of another aspect ratio than the camera's, or the network fails.
    pub fn pose(&mut self, path: &Path) -> Result<Map<String, Value>> {
        let picture = Picture::read(path, self.metadata.white)?;
        if let Some(camera) = &self.camera {
            camera.expect_aspect(picture.width, picture.height)?;
        }
        let outputs = self.run(&self.metadata.preprocessing.input(&picture)?)?;
        document(&outputs, &self.metadata.meaning)
    }

    fn run(&mut self, input: &[f32]) -> Result<Outputs> {
        let shape = [1, 3, self.metadata.preprocessing.height, self.metadata.preprocessing.width];
        let tensor = TensorRef::from_array_view((shape, input)).map_err(|error| refused(&error))?;
        read_outputs(
            &self.session.run(ort::inputs![INPUT => tensor]).map_err(|error| refused(&error))?,
        )
    }
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
    if source.distortion.is_none() && metadata.preprocessing.camera(&source).agrees_with(&view) {
        return Ok(Some(source));
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
