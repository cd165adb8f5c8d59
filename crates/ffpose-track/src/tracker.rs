//! Which of several tracks the frames speak for.

use core::array::from_fn;

use libm::{exp, log};
use nalgebra::Vector3;

use crate::error::Error;
use crate::filter::{Covariance, Filter, Innovation};
use crate::measurement::{Measurement, Mode, finite};
use crate::parameters::Parameters;
use crate::symmetry::Symmetry;

/// The most attitudes that are followed at once.
pub const HYPOTHESES: usize = 3;

// Evidence is counted in independent views: a frame that shows what the last one showed says hardly anything new.
/// What a frame says at least.
const OLD_VIEW: f64 = 0.02;
/// What a hypothesis begins with, and what a frame that it believes leaves it at least, for a pose of probability one.
const BEGINNING: f64 = 0.2;
/// The most that it can gather, so that a changed attitude is believed in the end.
const MOST: f64 = 4.0;
/// By how much another must be ahead to lead.
const AHEAD: f64 = 0.25;

// Hypotheses this close are one.
const SAME_ANGLE: f64 = 0.087;
const SAME_RATE: f64 = 0.017;
const SAME_POSITION: f64 = 0.05;

/// What became of a frame.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub enum Outcome {
    /// It has corrected the track.
    Accepted,
    /// Another attitude leads from now on: it speaks for that one, or nothing has spoken for the one before ([`Step::accepted`]).
    Switched,
    /// It is too far from what was expected, and the track goes on without it.
    Gated,
    /// It does not show the object ([`Measurement::flagged`]), and the track goes on without it.
    Flagged,
    /// There is none, and the track goes on without it.
    Coasted,
    /// There is no track yet.
    Acquiring,
    /// The track has gone too long without a frame that it could believe, or too many views spoke against it, and has ended.
    Lost,
}

impl Outcome {
    /// The outcome in a word, as trajectories and lines have it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Accepted => "accepted",
            Self::Switched => "switched",
            Self::Gated => "gated",
            Self::Flagged => "flagged",
            Self::Coasted => "coasted",
            Self::Acquiring => "acquiring",
            Self::Lost => "lost",
        }
    }
}

/// Motion of the object at the time of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Position, m, camera frame.
    pub position: [f64; 3],
    /// Orientation `(w, x, y, z)` from the object's to the camera's axes, `w` not negative.
    pub orientation: [f64; 4],
    /// Velocity, m/s, camera axes; with a gyro that against a camera that does not turn.
    pub velocity: [f64; 3],
    /// Angular velocity relative to the camera, rad/s, object's axes.
    pub rate: [f64; 3],
    /// Covariance of the errors of position (m, camera axes), velocity (m/s), attitude (rad, object's axes:
    /// `R_true = R exp([θ]×)`) and angular velocity (rad/s; of that against a camera that does not turn).
    pub covariance: Covariance,
}

/// What a frame has brought.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// What became of the frame.
    pub outcome: Outcome,
    /// Whether the frame has corrected the track that leads.
    pub accepted: bool,
    /// The motion; None without a track.
    pub estimate: Option<Estimate>,
    /// Squared Mahalanobis distance (6 degrees of freedom) of the frame from what the track that led before it expected; None where
    /// none did, or none does now, or the frame has no pose.
    pub nis: Option<f64>,
    /// Which of the frame's modes that track was compared with; None as above.
    pub mode: Option<usize>,
}

/// One attitude that is followed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Hypothesis {
    pub(crate) filter: Filter,
    /// Evidence, in independent views.
    pub(crate) score: f64,
    /// Frames that it has believed.
    pub(crate) agreed: f64,
    /// The time of the last of them.
    pub(crate) last: f64,
    /// Independent views among them, and the sum of their squared distances.
    pub(crate) views: f64,
    pub(crate) squares: f64,
    /// Angle turned since the last frame with a pose, and since the last that it has believed, rad.
    pub(crate) turned: f64,
    pub(crate) turned_unbelieved: f64,
}

impl Hypothesis {
    /// By what the variances of this track differ from those that the network's own make.
    ///
    /// The network errs more in some scenes than it says, and less in others. How much shows in how frames differ from what was
    /// expected, once the view has changed: the mean of a scaled inverse χ² distribution of the scale (Gelman and others,
    /// *Bayesian Data Analysis*, 3rd edition, 2013, section 2.6), whose prior is the scale of one.
    fn scale(&self, parameters: &Parameters) -> f64 {
        let said = parameters.said_views;
        if said.is_infinite() {
            return 1.0;
        }
        (said + self.squares / parameters.ordinary_nis) / (said + self.views)
    }
}

/// A spacecraft's motion from the poses of its images.
///
/// A track is there once [`Parameters::agreeing`] frames agree. A network that takes one side of the object for another does so
/// in many frames on end, so that a frame's word counts by the angle that the object has turned since the last: what no
/// hypothesis explains becomes one of its own, and the one with most evidence leads.
#[derive(Clone, Debug, PartialEq)]
pub struct Tracker {
    pub(crate) parameters: Parameters,
    pub(crate) symmetry: Symmetry,
    /// Time of the last frame.
    pub(crate) time: Option<f64>,
    /// Time of the last one that was looked at.
    pub(crate) looked: Option<f64>,
    pub(crate) camera_rate: Vector3<f64>,
    pub(crate) hypotheses: [Option<Hypothesis>; HYPOTHESES],
    pub(crate) leading: Option<usize>,
}

impl Tracker {
    /// A tracker that has seen nothing.
    ///
    /// # Errors
    ///
    /// A setting is out of its range.
    pub fn new(parameters: Parameters) -> Result<Self, Error> {
        parameters.check()?;
        Ok(Self {
            parameters,
            symmetry: Symmetry::default(),
            time: None,
            looked: None,
            camera_rate: Vector3::zeros(),
            hypotheses: [None; HYPOTHESES],
            leading: None,
        })
    }

    /// The tracker of poses by a network that tells attitudes modulo a symmetry; a state does not hold it.
    ///
    /// Of the attitudes that look alike each track takes the nearest to its own.
    #[must_use]
    pub fn modulo(self, symmetry: Symmetry) -> Self {
        Self { symmetry, ..self }
    }

    /// The symmetry modulo which attitudes are told.
    #[must_use]
    pub fn symmetry(&self) -> &Symmetry {
        &self.symmetry
    }

    /// The settings.
    #[must_use]
    pub fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// The time of the last frame, seconds.
    #[must_use]
    pub fn time(&self) -> Option<f64> {
        self.time
    }

    /// Checks that the next frame may have a time, seconds.
    ///
    /// # Errors
    ///
    /// It is NaN or infinite, or not later than the last where a track leads, or earlier by no more than `coasting`.
    pub fn check_time(&self, time: f64) -> Result<(), Error> {
        finite("time", [time].iter())?;
        let Some(last) = self.time.filter(|last| time <= *last) else { return Ok(()) };
        let follows = self.hypotheses.iter().any(Option::is_some);
        // a leader of one frame may be of the wrong time itself
        let leads = self
            .leading
            .is_some_and(|place| self.hypotheses[place].is_some_and(|one| one.agreed > 1.0));
        if follows && (leads || last - time <= self.parameters.coasting) {
            return Err(Error::Time { last, got: time });
        }
        Ok(())
    }

    /// Forgets all frames, and their times, as if it had seen none.
    pub fn reset(&mut self) {
        self.time = None;
        self.looked = None;
        self.camera_rate = Vector3::zeros();
        self.hypotheses = [None; HYPOTHESES];
        self.leading = None;
    }

    /// Moves on to the time of a frame, seconds, and takes in what it says.
    ///
    /// Times grow. Where nothing is followed any may come, and where no track leads one that is earlier by more than
    /// [`Parameters::coasting`]: of one wrong time no more is left than of a gap.
    ///
    /// `measurement` is None for a frame that never came. `camera_rate` is the camera's own angular velocity since the last frame,
    /// rad/s along its axes, where a gyro measures it; else zero.
    ///
    /// # Errors
    ///
    /// The time is not later than the last where it must be, or a number is not finite; nothing has changed then.
    pub fn step(
        &mut self,
        time: f64,
        measurement: Option<&Measurement>,
        camera_rate: [f64; 3],
    ) -> Result<Step, Error> {
        self.check_time(time)?;
        finite("camera_rate", camera_rate.iter())?;
        let turning = Vector3::from(camera_rate).norm();
        if turning > 0.0 && self.parameters.has_orbit() {
            let expected =
                "zero with an orbital rate, of a camera that keeps its attitude to the Earth";
            return Err(Error::Parameter { name: "camera_rate", expected, got: turning });
        }
        if self.time.is_some_and(|last| time <= last) {
            self.reset();
        }
        let elapsed = self.time.map_or(0.0, |last| time - last);
        self.time = Some(time);
        self.looked = measurement.map_or(self.looked, |_| Some(time));
        self.camera_rate = Vector3::from(camera_rate);

        let poses = measurement.filter(|measurement| **measurement != Measurement::flagged());
        let before = self.leading;
        let mut frame = Frame {
            time,
            explained: [false; crate::MODES],
            corrected: [false; HYPOTHESES],
            of_leader: None,
        };
        for place in 0..HYPOTHESES {
            self.follow(place, elapsed, poses, &mut frame);
        }
        // before a pose is followed in the place of a leader that has ended
        self.leading = self.leading.filter(|place| self.hypotheses[*place].is_some());
        let kept = self.leading;
        if let Some(poses) = poses {
            let explained = frame.explained;
            let followed: [_; HYPOTHESES] =
                from_fn(|place| self.hypotheses[place].as_ref().map(|one| one.filter.orientation));
            let poses = poses.unfolded(&self.symmetry, &followed);
            for (_, pose) in poses.modes().filter(|(mode, _)| !explained[*mode]) {
                self.propose(pose, &mut frame);
            }
        }
        self.unite(&frame);
        self.choose();
        let unbelieved = match (measurement, poses) {
            (None, _) => Outcome::Coasted,
            (_, None) => Outcome::Flagged,
            _ => Outcome::Gated,
        };
        Ok(self.told([before, kept], unbelieved, &frame))
    }

    /// The motion at the time of the last frame; None without a track.
    #[must_use]
    pub fn estimate(&self) -> Option<Estimate> {
        self.motion(self.leading?)
    }

    /// Where to look for the object in a frame at `time`, seconds: its expected position, m, camera frame.
    ///
    /// None where the whole frame must be searched: without a track, where the last frame that came did not correct it, or where
    /// this one comes too late or the object would be behind the camera. `camera_rate` is as for [`Self::step`].
    #[must_use]
    pub fn expected(&self, time: f64, camera_rate: [f64; 3]) -> Option<[f64; 3]> {
        let leader = self.hypotheses[self.leading?]?;
        let elapsed = time - self.time?;
        let lasts = time - leader.last <= self.parameters.coasting;
        if leader.last < self.looked? || !(elapsed > 0.0 && lasts) {
            return None;
        }
        let position =
            leader.filter.position_after(elapsed, &Vector3::from(camera_rate), &self.parameters);
        (position.z > 0.0).then(|| position.into())
    }

    /// The motion of the next best attitude that frames have agreed on; None if there is none.
    #[must_use]
    pub fn alternative(&self) -> Option<Estimate> {
        self.motion(self.best(|place| Some(place) != self.leading)?)
    }

    /// Moves a hypothesis on, and compares it with the frame; it ends where too little speaks for it, and unseen where it has
    /// believed none for too long.
    fn follow(
        &mut self,
        place: usize,
        elapsed: f64,
        measurement: Option<&Measurement>,
        frame: &mut Frame,
    ) {
        let Some(hypothesis) = &mut self.hypotheses[place] else { return };
        let parameters = &self.parameters;
        if frame.time - hypothesis.last > parameters.coasting {
            // so little is known after a long silence that nearly any frame would pass the gate
            self.hypotheses[place] = None;
            return;
        }
        let turned = hypothesis.filter.predict(elapsed, &self.camera_rate, parameters);
        hypothesis.turned += turned;
        hypothesis.turned_unbelieved += turned;
        let mut ends = false;
        if let Some(measurement) = measurement {
            let new = |turned: f64| OLD_VIEW + 1.0 - exp(-turned / parameters.attitude_angle);
            let news = new(hypothesis.turned);
            hypothesis.turned = 0.0;
            let own = [Some(hypothesis.filter.orientation)];
            let measurement = measurement.unfolded(&self.symmetry, &own);
            let found = closest(&hypothesis.filter, &measurement, parameters);
            let accepted = found.filter(|(_, _, innovation)| innovation.nis <= parameters.gate);
            if let Some((mode, pose, innovation)) = &accepted {
                hypothesis.filter.correct(innovation, parameters);
                let view = new(hypothesis.turned_unbelieved);
                hypothesis.turned_unbelieved = 0.0;
                hypothesis.views += view;
                hypothesis.squares += view * innovation.nis;
                let score = hypothesis.score + news * (2.0 * pose.probability - 1.0);
                hypothesis.score = score.max(BEGINNING * pose.probability);
                hypothesis.agreed += 1.0;
                hypothesis.last = frame.time;
                frame.explained[*mode] = true;
                frame.corrected[place] = true;
            } else {
                hypothesis.score -= news;
                ends = hypothesis.score <= 0.0;
            }
            hypothesis.score = hypothesis.score.clamp(0.0, MOST);
            if self.leading == Some(place) {
                frame.of_leader =
                    found.map(|(mode, _, innovation)| (mode, innovation.nis, accepted.is_some()));
            }
        }
        if ends || !hypothesis.filter.is_sound() {
            self.hypotheses[place] = None;
        }
    }

    /// Follows a pose that no hypothesis explains, in place of the least one that frames have not agreed on, that this one does not
    /// speak for, and that has no more evidence.
    fn propose(&mut self, pose: &Mode, frame: &mut Frame) {
        let score = BEGINNING * pose.probability;
        let weight = |place: usize| match &self.hypotheses[place] {
            None => -1.0,
            Some(young)
                if young.agreed < self.parameters.agreeing
                    && !frame.corrected[place]
                    && young.score <= score =>
            {
                young.score
            }
            Some(_) => f64::INFINITY,
        };
        let least = (0..HYPOTHESES).min_by(|a, b| weight(*a).total_cmp(&weight(*b)));
        let Some(place) = least.filter(|place| weight(*place).is_finite()) else { return };
        self.hypotheses[place] = Some(Hypothesis {
            filter: Filter::new(pose, &self.parameters),
            score,
            agreed: 1.0,
            last: frame.time,
            views: 0.0,
            squares: 0.0,
            turned: 0.0,
            turned_unbelieved: 0.0,
        });
        frame.corrected[place] = true;
    }

    /// Ends hypotheses that have become another one: both believe the frame.
    ///
    /// Of two that are near each other only one may believe what comes, as where the light has changed and the network's error with it.
    fn unite(&mut self, frame: &Frame) {
        for first in 0..HYPOTHESES {
            for second in first + 1..HYPOTHESES {
                let (Some(a), Some(b)) = (&self.hypotheses[first], &self.hypotheses[second]) else {
                    continue;
                };
                let believe = frame.corrected[first] && frame.corrected[second];
                if !(believe && a.filter.is_same(&b.filter, &self.symmetry)) {
                    continue;
                }
                let keeps_second = self.leading != Some(first)
                    && (self.leading == Some(second) || b.score > a.score);
                self.hypotheses[if keeps_second { first } else { second }] = None;
            }
        }
    }

    /// Chooses who leads: where none does, the one with most evidence, once frames have agreed on it.
    fn choose(&mut self) {
        let score =
            |place: usize| self.hypotheses[place].map_or(0.0, |hypothesis| hypothesis.score);
        let best = self.best(|_| true);
        self.leading = match (self.leading, best) {
            (Some(leader), Some(best)) if score(best) > score(leader) + AHEAD => Some(best),
            (Some(leader), _) => Some(leader),
            (None, best) => {
                best.filter(|best| (0..HYPOTHESES).all(|other| score(other) <= score(*best)))
            }
        };
    }

    /// The place of the hypothesis with most evidence among those that frames have agreed on and that are `allowed`.
    fn best(&self, allowed: impl Fn(usize) -> bool) -> Option<usize> {
        let mut best: Option<(usize, f64)> = None;
        for (place, hypothesis) in self.hypotheses.iter().enumerate() {
            if let Some(one) = hypothesis
                && one.agreed >= self.parameters.agreeing
                && allowed(place)
                && best.is_none_or(|(_, score)| one.score > score)
            {
                best = Some((place, one.score));
            }
        }
        best.map(|(place, _)| place)
    }

    /// What became of the frame, given who led before it and who of them it has left, and what it is where it corrects nothing.
    fn told(&self, [before, kept]: [Option<usize>; 2], unbelieved: Outcome, frame: &Frame) -> Step {
        let estimate = self.estimate();
        let outcome = match (before, self.leading) {
            (None, None) => Outcome::Acquiring,
            (Some(_), None) => Outcome::Lost,
            (None, Some(now)) if frame.corrected[now] => Outcome::Accepted,
            (None, Some(_)) => Outcome::Switched,
            (Some(_), now) if kept != now => Outcome::Switched,
            _ if frame.of_leader.is_some_and(|(_, _, accepted)| accepted) => Outcome::Accepted,
            _ => unbelieved,
        };
        let of_leader = frame.of_leader.filter(|_| estimate.is_some());
        Step {
            outcome,
            accepted: self.leading.is_some_and(|place| frame.corrected[place]),
            estimate,
            nis: of_leader.map(|(_, nis, _)| nis),
            mode: of_leader.map(|(mode, _, _)| mode),
        }
    }

    fn motion(&self, place: usize) -> Option<Estimate> {
        let hypothesis = self.hypotheses[place]?;
        let filter = &hypothesis.filter;
        let q = filter.orientation.quaternion();
        let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
        let camera_rate = self.camera_rate + self.parameters.orbital_rate();
        let of_camera = filter.orientation.inverse_transform_vector(&camera_rate);
        Some(Estimate {
            position: filter.position.into(),
            orientation: [q.w, q.i, q.j, q.k].map(|number| number * sign),
            velocity: filter.velocity.into(),
            rate: (filter.rate - of_camera).into(),
            covariance: filter.covariance * hypothesis.scale(&self.parameters),
        })
    }
}

impl Filter {
    /// Whether two tracks have become one.
    fn is_same(&self, other: &Self, symmetry: &Symmetry) -> bool {
        let orientation = symmetry.nearest(&other.orientation, [self.orientation].into_iter());
        let turn = orientation.inverse() * other.orientation;
        self.orientation.angle_to(&orientation) < SAME_ANGLE
            && (self.rate - turn * other.rate).norm() < SAME_RATE
            && (self.position - other.position).norm() < SAME_POSITION * self.position.norm()
    }
}

/// What the hypotheses make of a frame.
struct Frame {
    time: f64,
    /// Modes that a hypothesis has believed, and hypotheses that have believed one or begun with it.
    explained: [bool; crate::MODES],
    corrected: [bool; HYPOTHESES],
    /// The mode that the leader was compared with, its distance, and whether the leader has believed it.
    of_leader: Option<(usize, f64, bool)>,
}

/// The mode of a frame that a track most likely shows.
fn closest<'a>(
    filter: &Filter,
    measurement: &'a Measurement,
    parameters: &Parameters,
) -> Option<(usize, &'a Mode, Innovation)> {
    let cost = |pose: &Mode, nis: f64| nis - 2.0 * log(pose.probability);
    let mut best: Option<(usize, &Mode, Innovation)> = None;
    for (mode, pose) in measurement.modes() {
        if let Some(innovation) = filter.innovation(pose, parameters)
            && best
                .as_ref()
                .is_none_or(|(_, other, known)| cost(pose, innovation.nis) < cost(other, known.nis))
        {
            best = Some((mode, pose, innovation));
        }
    }
    best
}
