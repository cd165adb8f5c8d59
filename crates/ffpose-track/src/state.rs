//! A tracker as bytes, to be taken up again after a restart.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use crate::error::Error;
use crate::filter::{Covariance, Cross, ERRORS, Filter, MOTION};
use crate::parameters::{self, Parameters};
use crate::symmetry::Symmetry;
use crate::tracker::{HYPOTHESES, Hypothesis, Tracker};

/// The first bytes of each state; the number is the format's version.
const MAGIC: [u8; 8] = *b"FFTRACK8";

/// Bytes that say whose track it is, such as the digest of a network's file and of the camera.
pub const TAG_BYTES: usize = 32;

/// Numbers of a hypothesis: whether there is one, score, frames, time, views, angles, state and covariances.
const OF_HYPOTHESIS: usize = 8 + 13 + OF_COVARIANCE + OF_CROSS;
const OF_COVARIANCE: usize = MOTION * MOTION;
const OF_CROSS: usize = MOTION * ERRORS;

/// Numbers of a tracker.
const NUMBERS: usize = parameters::NUMBERS + 2 + 3 + 1 + HYPOTHESES * OF_HYPOTHESIS;

/// Bytes of a state.
pub const STATE_BYTES: usize = MAGIC.len() + TAG_BYTES + 8 * NUMBERS + 8;

impl Tracker {
    /// The tracker as bytes, exact; `tag` says whose track it is.
    #[must_use]
    pub fn to_bytes(&self, tag: &[u8; TAG_BYTES]) -> [u8; STATE_BYTES] {
        let mut bytes = [0; STATE_BYTES];
        let mut writer = Writer { bytes: &mut bytes, at: 0 };
        writer.put(&MAGIC);
        writer.put(tag);
        writer.numbers(&self.parameters.to_array());
        writer.numbers(&[self.time, self.looked].map(|time| time.unwrap_or(f64::NAN)));
        writer.numbers(self.camera_rate.as_slice());
        writer.numbers(&[self.leading.map_or(-1.0, |place| place as f64)]);
        for hypothesis in &self.hypotheses {
            match hypothesis {
                None => writer.at += 8 * OF_HYPOTHESIS,
                Some(one) => writer.hypothesis(one),
            }
        }
        let sum = checksum(&bytes[..STATE_BYTES - 8]);
        bytes[STATE_BYTES - 8..].copy_from_slice(&sum.to_le_bytes());
        bytes
    }

    /// The tracker of [`Self::to_bytes`], whose tag must be the same.
    ///
    /// # Errors
    ///
    /// The bytes are no state, cut short or damaged, or have another tag.
    pub fn from_bytes(bytes: &[u8], tag: &[u8; TAG_BYTES]) -> Result<Self, Error> {
        let fault = |reason| Error::State { reason };
        if !bytes.starts_with(&MAGIC) {
            let is_other = bytes.starts_with(&MAGIC[..MAGIC.len() - 1]);
            return Err(fault(if is_other {
                "expected a state of this version, got that of another, which is to be removed"
            } else {
                "expected the saved state of a tracker, got other bytes"
            }));
        }
        if bytes.len() != STATE_BYTES {
            return Err(fault("expected the saved state of a tracker, got it cut short or longer"));
        }
        let (body, sum) = bytes.split_at(STATE_BYTES - 8);
        if checksum(body).to_le_bytes() != sum {
            return Err(fault("damaged: its checksum is not that of its bytes"));
        }
        if body[MAGIC.len()..MAGIC.len() + TAG_BYTES] != *tag {
            return Err(fault("expected one of this model and camera, got that of another"));
        }
        let mut reader = Reader { bytes: body, at: MAGIC.len() + TAG_BYTES };
        let parameters = Parameters::from_array(reader.numbers());
        parameters.check()?;
        let [time, looked] = reader.numbers::<2>().map(|time| Some(time).filter(|t| t.is_finite()));
        let camera_rate = Vector3::from(reader.numbers::<3>());
        let [leading] = reader.numbers();
        let mut hypotheses = [None; HYPOTHESES];
        for place in &mut hypotheses {
            *place = reader.hypothesis();
            if place.is_some_and(|one: Hypothesis| !one.filter.is_sound()) {
                return Err(fault("expected finite numbers and positive covariances"));
            }
        }
        let leading = (0..HYPOTHESES)
            .find(|place| (*place as f64).total_cmp(&leading).is_eq())
            .filter(|place| hypotheses[*place].is_some());
        Ok(Self {
            parameters,
            symmetry: Symmetry::default(),
            time,
            looked,
            camera_rate,
            hypotheses,
            leading,
        })
    }
}

struct Writer<'a> {
    bytes: &'a mut [u8; STATE_BYTES],
    at: usize,
}

impl Writer<'_> {
    fn put(&mut self, bytes: &[u8]) {
        self.bytes[self.at..self.at + bytes.len()].copy_from_slice(bytes);
        self.at += bytes.len();
    }

    fn numbers(&mut self, numbers: &[f64]) {
        for number in numbers {
            self.put(&number.to_le_bytes());
        }
    }

    fn hypothesis(&mut self, one: &Hypothesis) {
        let filter = &one.filter;
        self.numbers(&[1.0, one.score, one.agreed, one.last, one.views, one.squares]);
        self.numbers(&[one.turned, one.turned_unbelieved]);
        self.numbers(filter.position.as_slice());
        self.numbers(filter.velocity.as_slice());
        self.numbers(filter.orientation.coords.as_slice());
        self.numbers(filter.rate.as_slice());
        self.numbers(filter.covariance.as_slice());
        self.numbers(filter.cross.as_slice());
    }
}

struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Reader<'_> {
    fn numbers<const COUNT: usize>(&mut self) -> [f64; COUNT] {
        core::array::from_fn(|_| {
            let mut bytes = [0; 8];
            bytes.copy_from_slice(&self.bytes[self.at..self.at + 8]);
            self.at += 8;
            f64::from_le_bytes(bytes)
        })
    }

    fn vector(&mut self) -> Vector3<f64> {
        Vector3::from(self.numbers::<3>())
    }

    fn hypothesis(&mut self) -> Option<Hypothesis> {
        let [present, score, agreed, last, views, squares, turned, turned_unbelieved] =
            self.numbers();
        let (position, velocity) = (self.vector(), self.vector());
        let [i, j, k, w] = self.numbers();
        let orientation = UnitQuaternion::new_unchecked(Quaternion::new(w, i, j, k));
        let rate = self.vector();
        let covariance = Covariance::from_column_slice(&self.numbers::<OF_COVARIANCE>());
        let cross = Cross::from_column_slice(&self.numbers::<OF_CROSS>());
        let filter = Filter { position, velocity, orientation, rate, covariance, cross };
        (present != 0.0).then_some(Hypothesis {
            filter,
            score,
            agreed,
            last,
            views,
            squares,
            turned,
            turned_unbelieved,
        })
    }
}

/// FNV-1a, 64 bits: against damage, not against malice.
fn checksum(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |sum, byte| {
        (sum ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3)
    })
}
