//! The tracker for Python: numbers in, a dictionary out.

use ffpose_track::{
    Axis, Error, Estimate, MODES, Measurement, Mode, Parameters, Step, Symmetry, TAG_BYTES, Tracker,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};

type Matrix = [[f64; 3]; 3];

/// Position, orientation, their covariances, and the probability.
type Pose = ([f64; 3], [f64; 4], Matrix, Matrix, f64);

/// Axes of symmetry: direction, and number of turns about it, 0 for any angle.
type Axes = Vec<([f64; 3], u32)>;

/// The tracker of ffpose-track; `ffpose.tracking.Tracker` explains it.
#[pyclass(name = "Tracker", module = "ffpose._rust")]
pub(crate) struct PyTracker(Tracker);

#[pymethods]
impl PyTracker {
    /// A tracker with settings by name, each a list of numbers, angles in degrees; those left out are the usual ones.
    #[new]
    fn new(settings: &Bound<'_, PyDict>, axes: Axes) -> PyResult<Self> {
        let mut parameters = Parameters::default();
        for (name, value) in settings {
            let values: Vec<f64> = value.extract()?;
            let name: String = name.extract()?;
            parameters.set(&name, &values).map_err(|error| {
                PyValueError::new_err(format!("{name}: {error}, got {values:?}"))
            })?;
        }
        modulo(Tracker::new(parameters), axes)
    }

    /// The tracker of `state`, whose tag of 32 bytes must be the same.
    #[staticmethod]
    fn from_state(state: &[u8], tag: [u8; TAG_BYTES], axes: Axes) -> PyResult<Self> {
        modulo(Tracker::from_bytes(state, &tag), axes)
    }

    /// The tracker as bytes, with a tag of 32 bytes.
    fn state<'py>(&self, py: Python<'py>, tag: [u8; TAG_BYTES]) -> Bound<'py, PyBytes> {
        PyBytes::new(py, &self.0.to_bytes(&tag))
    }

    /// Move on to a frame at `time` that shows one of `poses`, or not the object where there is none; None is no frame.
    fn step<'py>(
        &mut self,
        py: Python<'py>,
        time: f64,
        poses: Option<Vec<Pose>>,
        camera_rate: [f64; 3],
    ) -> PyResult<Bound<'py, PyDict>> {
        let measurement = poses.map(|poses| measured(&poses)).transpose().map_err(raised)?;
        let step = self.0.step(time, measurement.as_ref(), camera_rate).map_err(raised)?;
        told(py, &step)
    }

    /// Where to look for the object in a frame at `time`, meters in the camera frame, or None for everywhere.
    fn expected(&self, time: f64, camera_rate: [f64; 3]) -> Option<[f64; 3]> {
        self.0.expected(time, camera_rate)
    }

    /// The next best attitude that frames have agreed on, or None.
    fn alternative<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyDict>>> {
        self.0.alternative().map(|estimate| motion(py, &estimate)).transpose()
    }

    /// Seconds of the last frame, or None.
    #[getter]
    fn time(&self) -> Option<f64> {
        self.0.time()
    }
}

fn modulo(tracker: Result<Tracker, Error>, axes: Axes) -> PyResult<PyTracker> {
    let axes: Vec<_> = axes.into_iter().map(|(direction, fold)| Axis { direction, fold }).collect();
    let made = tracker.and_then(|tracker| Ok(tracker.modulo(Symmetry::new(&axes)?)));
    made.map(PyTracker).map_err(raised)
}

fn measured(poses: &[Pose]) -> Result<Measurement, Error> {
    if poses.is_empty() {
        return Ok(Measurement::flagged());
    }
    if poses.len() > MODES {
        return Err(Error::Modes { got: poses.len() });
    }
    let mode = |(t, q, c, r, probability): &Pose| Mode::new(*t, *q, *c, *r, *probability);
    let mut modes = [mode(&poses[0])?; MODES];
    for (place, pose) in modes.iter_mut().zip(poses) {
        *place = mode(pose)?;
    }
    Measurement::new(&modes[..poses.len()])
}

fn told<'py>(py: Python<'py>, step: &Step) -> PyResult<Bound<'py, PyDict>> {
    let told = PyDict::new(py);
    told.set_item("outcome", step.outcome.name())?;
    told.set_item("accepted", step.accepted)?;
    told.set_item("nis", step.nis)?;
    told.set_item("mode", step.mode)?;
    told.set_item("estimate", step.estimate.map(|one| motion(py, &one)).transpose()?)?;
    Ok(told)
}

fn motion<'py>(py: Python<'py>, estimate: &Estimate) -> PyResult<Bound<'py, PyDict>> {
    let motion = PyDict::new(py);
    motion.set_item("position", estimate.position)?;
    motion.set_item("orientation", estimate.orientation)?;
    motion.set_item("velocity", estimate.velocity)?;
    motion.set_item("rate", estimate.rate)?;
    let covariance: [[f64; 12]; 12] = estimate.covariance.into();
    motion.set_item("covariance", covariance)?;
    Ok(motion)
}

fn raised(error: Error) -> PyErr {
    PyValueError::new_err(error.to_string())
}
