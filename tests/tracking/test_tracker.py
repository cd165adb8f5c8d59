"""The tracker against a textbook Kalman filter, its own noise, and malformed poses."""

import copy
import pickle
from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm, sqrtm
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from ffpose.config import PolarPoseConfig
from ffpose.geometry import Pose, PoseUncertainty
from ffpose.tracking import Settings, Tracker

PLAIN = Settings(gate=np.inf, tails=np.inf, said_views=np.inf, agreeing=1, coasting=np.inf)
"""A filter alone, which believes everything."""


def hat(v):
    """The matrix whose product with u is v x u."""
    return np.cross(v, np.eye(3)).T


def pose(t, rotation, ct, cr, in_view=1.0, threshold=None):
    said = PoseUncertainty(ct, cr, in_view, threshold)
    return Pose(t, rotation.as_quat(scalar_first=True), said)


def jacobian(v):
    """exp(v + e) = exp(v) exp(J e), by central differences of SciPy's rotations."""
    step, inverse = 1e-6, Rotation.from_rotvec(v).inv()
    return np.stack(
        [
            (
                (inverse * Rotation.from_rotvec(v + step * e)).as_rotvec()
                - (inverse * Rotation.from_rotvec(v - step * e)).as_rotvec()
            )
            / (2 * step)
            for e in np.eye(3)
        ],
        axis=1,
    )


class Textbook:
    """The same filter with whole matrices; transition and noise by Van Loan."""

    def __init__(self, settings, t, rotation, ct, cr):
        self.s = settings
        self.p, self.v, self.r, self.w = np.array(t), np.zeros(3), rotation, np.zeros(3)
        self.cov = np.zeros((18, 18))
        m = rotation.as_matrix()
        self.cov[:3, :3], self.cov[6:9, 6:9] = ct, m.T @ cr @ m
        self.cov[3:6, 3:6] = settings.velocity**2 * np.eye(3)
        self.cov[9:12, 9:12] = np.radians(settings.rate) ** 2 * np.eye(3)
        self.cov[12:, 12:] = np.eye(6)
        for place, bias, root in zip((0, 6), (12, 15), self.roots(rotation, ct, cr), strict=True):
            self.cov[place : place + 3, bias : bias + 3] = -root
            self.cov[bias : bias + 3, place : place + 3] = -root

    def roots(self, rotation, ct, cr):
        m = rotation.as_matrix()
        shares = 1 - self.s.position_noise, 1 - self.s.attitude_noise
        return sqrtm(ct * shares[0]).real, sqrtm(m.T @ cr @ m * shares[1]).real

    def predict(self, dt):
        s = self.s
        n = np.radians(s.orbital_rate)
        ray = n + np.cross(self.p, self.v) / (self.p @ self.p)
        seen = self.w - self.r.inv().apply(ray)
        turned = dt * np.sqrt(seen @ seen + np.trace(self.cov[9:12, 9:12]))
        a, g = np.zeros((12, 12)), np.zeros((12, 12))
        a[:3, 3:6] = np.eye(3)
        # gravity's gradient, centrifugal and Coriolis forces
        a[3:6, :3] = n @ n * (3 * np.outer(s.zenith, s.zenith) - np.eye(3)) - hat(n) @ hat(n)
        a[3:6, 3:6] = -2 * hat(n)
        a[6:9, 6:9], a[6:9, 9:] = -hat(self.w), np.eye(3)
        g[3:6, 3:6] = s.acceleration**2 * np.eye(3)
        turning = s.asymmetry**2 * np.linalg.norm(self.w) ** 3
        g[9:, 9:] = (np.radians(s.angular_acceleration) ** 2 + turning) * np.eye(3)
        loan = expm(np.block([[-a, g], [np.zeros((12, 12)), a.T]]) * dt)  # Van Loan, 1978
        f, q = np.eye(18), np.zeros((18, 18))
        f[:12, :12] = loan[12:, 12:].T
        q[:12, :12] = f[:12, :12] @ loan[:12, 12:]
        for place, angle in ((12, s.position_angle), (15, s.attitude_angle)):
            kept = np.exp(-turned / np.radians(angle))
            f[place : place + 3, place : place + 3] = kept * np.eye(3)
            q[place : place + 3, place : place + 3] = (1 - kept**2) * np.eye(3)
        self.p, self.v = np.split(f[:6, :6] @ np.concatenate([self.p, self.v]), 2)
        camera, body = (Rotation.from_rotvec(rate * dt) for rate in (n, self.w))
        self.r = camera.inv() * self.r * body  # both turn against the stars
        self.cov = f @ self.cov @ f.T + q

    def correct(self, t, rotation, ct, cr):
        s, m = self.s, rotation.as_matrix()
        st, sr = self.roots(rotation, ct, cr)
        h = np.zeros((6, 18))
        h[:3, :3], h[:3, 12:15], h[3:, 6:9], h[3:, 15:] = np.eye(3), st, np.eye(3), sr
        noise = np.zeros((6, 6))
        noise[:3, :3], noise[3:, 3:] = ct * s.position_noise, m.T @ cr @ m * s.attitude_noise
        turn = (self.r.inv() * rotation).as_rotvec()
        y = np.concatenate([t - self.p, turn])
        inverse = np.linalg.inv(h @ self.cov @ h.T + noise)
        gain = self.cov @ h.T @ inverse
        gain[12:] = 0  # considered (Schmidt)
        dx = gain @ y
        self.p, self.v, self.w = self.p + dx[:3], self.v + dx[3:6], self.w + dx[9:12]
        self.r = self.r * Rotation.from_rotvec(dx[6:9])
        joseph = np.eye(18) - gain @ h
        self.cov = joseph @ self.cov @ joseph.T + gain @ noise @ gain.T
        reset = np.eye(18)
        reset[6:9, 6:9] = jacobian(dx[6:9])
        self.cov = reset @ self.cov @ reset.T
        return y @ inverse @ y


def covariances(rng):
    half = rng.normal(size=(2, 3, 3)) * np.array([0.1, 0.03])[:, None, None]
    return half @ half.transpose(0, 2, 1) + np.array([1e-4, 1e-5])[:, None, None] * np.eye(3)


ORBIT = {"orbital_rate": (0.03, 0.0, 0.04), "zenith": (0.0, 1.0, 0.0)}
"""Close to a low orbit's 0.065 deg/s."""


@pytest.mark.parametrize("orbit", [{}, ORBIT])
def test_equals_a_textbook_filter_with_whole_matrices(orbit):
    settings = replace(PLAIN, **orbit)
    rng = np.random.default_rng(3)
    rotation, t, time = Rotation.random(random_state=4), np.array([1.0, -2.0, 15.0]), 0.0
    rate, velocity = np.array([0.03, -0.05, 0.02]), np.array([0.05, 0.02, -0.1])
    ct, cr = covariances(rng)
    textbook, tracker = Textbook(settings, t, rotation, ct, cr), Tracker(settings)
    tracker.step(time, pose(t, rotation, ct, cr))
    for _ in range(40):
        dt = rng.uniform(0.05, 2.0)
        time += dt
        t, rotation = t + velocity * dt, rotation * Rotation.from_rotvec(rate * dt)
        ct, cr = covariances(rng)
        seen_t = t + rng.normal(size=3) * 0.05
        seen_r = rotation * Rotation.from_rotvec(rng.normal(size=3) * 0.02)
        expected = tracker.expected(time)
        textbook.predict(dt)
        np.testing.assert_allclose(expected, textbook.p, atol=1e-9)
        nis = textbook.correct(seen_t, seen_r, ct, cr)
        step = tracker.step(time, pose(seen_t, seen_r, ct, cr))
        mine = step.estimate
        np.testing.assert_allclose(step.nis, nis, rtol=1e-6)
        np.testing.assert_allclose(mine.t, textbook.p, atol=1e-9)
        np.testing.assert_allclose(mine.v, textbook.v, atol=1e-9)
        of_camera = textbook.r.inv().apply(np.radians(settings.orbital_rate))
        np.testing.assert_allclose(np.radians(mine.w), textbook.w - of_camera, atol=1e-9)
        q = Rotation.from_quat(mine.q, scalar_first=True)
        assert (q.inv() * textbook.r).magnitude() < 1e-9
        np.testing.assert_allclose(mine.covariance, textbook.cov[:12, :12], atol=1e-10)


INERTIA = np.array([[1.0, 0.1, -0.2], [0.1, 2.0, 0.05], [-0.2, 0.05, 2.5]])


def free(q, w, seconds):
    """Attitude and angular velocity of a free body after a time, by SciPy."""

    def change(_, state):
        scalar, vector, w = state[0], state[1:4], state[4:]
        dq = np.concatenate([[-vector @ w], scalar * w + np.cross(vector, w)]) / 2
        return np.concatenate([dq, np.linalg.solve(INERTIA, np.cross(INERTIA @ w, w))])

    start = np.concatenate([q.as_quat(scalar_first=True), w])
    end = solve_ivp(change, (0, seconds), start, "DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    return Rotation.from_quat(end[:4], scalar_first=True), end[4:]


def test_a_body_of_known_inertia_turns_by_eulers_equations():
    """Frames without errors for ten seconds, then five without frames, covariance included."""
    xx, yy, zz = np.diag(INERTIA)
    moments = (xx, yy, zz, INERTIA[0, 1], INERTIA[0, 2], INERTIA[1, 2])
    settings = replace(PLAIN, inertia=moments, asymmetry=0, angular_acceleration=0, acceleration=0)
    tracker, spread = Tracker(settings), 1e-8 * np.eye(3)
    q, w = Rotation.random(random_state=5), np.radians([3.0, -2.0, 2.5])
    for frame in range(21):
        step = tracker.step(frame / 2, pose([0, 0, 20], q, spread, spread))
        if frame < 20:
            q, w = free(q, w, 0.5)
    before = step.estimate
    after = tracker.step(15.0, None).estimate
    start, rate = Rotation.from_quat(before.q, scalar_first=True), np.radians(before.w)
    assert np.linalg.norm(rate - w) < 1e-4
    q, w = free(start, rate, 5.0)
    assert (Rotation.from_quat(after.q, scalar_first=True).inv() * q).magnitude() < 1e-4
    np.testing.assert_allclose(np.radians(after.w), w, atol=1e-6)

    # how small changes of attitude and angular velocity go on, by central differences
    small, columns = 1e-5, []
    for axis in np.eye(6):
        ends = [
            free(
                start * Rotation.from_rotvec(sign * small * axis[:3]),
                rate + sign * small * axis[3:],
                5,
            )
            for sign in (1, -1)
        ]
        turn = (ends[1][0].inv() * ends[0][0]).as_rotvec()
        columns.append(np.concatenate([turn, ends[0][1] - ends[1][1]]) / (2 * small))
    f = np.array(columns).T
    expected = f @ before.covariance[6:, 6:] @ f.T
    got = after.covariance[6:, 6:]
    np.testing.assert_allclose(got, expected, atol=2e-3 * abs(expected).max())


def walk(rng, settings, frames, dt):
    """One run of the model itself: a motion, frames with its noise, and the truths."""
    s = settings
    p, v = np.array([0.0, 0.0, 20.0]), rng.normal(size=3) * s.velocity
    r, w = Rotation.random(random_state=rng), rng.normal(size=3) * np.radians(s.rate)
    a, b = rng.normal(size=(2, 3))
    ct, cr = np.diag([0.05, 0.05, 0.3]) ** 2, np.diag([0.02, 0.03, 0.015]) ** 2
    substeps = 10
    for _ in range(frames):
        m = r.as_matrix()
        body = m.T @ cr @ m
        n = rng.normal(size=(2, 3))
        shares = s.position_noise, s.attitude_noise
        et = sqrtm(ct).real @ (np.sqrt(1 - shares[0]) * a + np.sqrt(shares[0]) * n[0])
        er = sqrtm(body).real @ (np.sqrt(1 - shares[1]) * b + np.sqrt(shares[1]) * n[1])
        # the frame's own covariance is of its camera's axes, and turned by its own attitude
        seen = r * Rotation.from_rotvec(er)
        turned = seen.as_matrix()
        yield (p.copy(), v.copy(), r, w.copy()), pose(p + et, seen, ct, turned @ body @ turned.T)
        turn = 0.0
        for _ in range(substeps):
            h = dt / substeps
            p = p + v * h
            v = v + rng.normal(size=3) * s.acceleration * np.sqrt(h)
            r = r * Rotation.from_rotvec(w * h)
            w = w + rng.normal(size=3) * np.radians(s.angular_acceleration) * np.sqrt(h)
            seen_rate = w - r.inv().apply(np.cross(p, v) / (p @ p))
            turn += np.linalg.norm(seen_rate) * h
        for bias, angle in ((a, s.position_angle), (b, s.attitude_angle)):
            kept = np.exp(-turn / np.radians(angle))
            bias *= kept
            bias += np.sqrt(1 - kept**2) * rng.normal(size=3)


@pytest.mark.parametrize("factor", [0.5, 3.0])
def test_a_track_learns_how_large_errors_are_from_views_that_differ(factor):
    own = replace(PLAIN, position_noise=1, attitude_noise=1, asymmetry=0, ordinary_nis=6)
    ct, cr = np.diag([0.05, 0.05, 0.3]) ** 2, np.diag([0.02, 0.03, 0.015]) ** 2
    rng = np.random.default_rng(5)
    trackers = Tracker(own), Tracker(replace(own, said_views=1))
    for frame in range(300):
        turn = Rotation.from_rotvec([0, 0.2 * frame, 0])
        noise = rng.multivariate_normal(np.zeros(3), ct), rng.multivariate_normal(np.zeros(3), cr)
        r = Rotation.from_rotvec(factor * noise[1]) * turn
        seen = pose([0, 0, 20] + factor * noise[0], r, ct, cr)
        said, learned = (tracker.step(frame, seen).estimate for tracker in trackers)
    np.testing.assert_array_equal(learned.t, said.t)
    np.testing.assert_array_equal(learned.q, said.q)
    scale = np.trace(learned.covariance) / np.trace(said.covariance)
    np.testing.assert_allclose(learned.covariance, scale * said.covariance, atol=1e-12)
    np.testing.assert_allclose(scale, factor**2, rtol=0.1)


@pytest.mark.slow
def test_covariances_are_those_of_the_errors_on_the_models_own_noise():
    settings = replace(PLAIN, velocity=0.05, rate=2.0, angular_acceleration=0.02, asymmetry=0)
    nees, nis = [], []
    for seed in range(60):
        tracker = Tracker(settings)
        for frame, ((p, v, r, w), seen) in enumerate(
            walk(np.random.default_rng([seed, 1]), settings, 60, 0.5)
        ):
            step = tracker.step(0.5 * frame, seen)
            if frame % 20 == 19:
                mine = step.estimate
                turn = Rotation.from_quat(mine.q, scalar_first=True).inv() * r
                error = [p - mine.t, v - mine.v, turn.as_rotvec(), w - np.radians(mine.w)]
                error = np.concatenate(error)
                nees.append(error @ np.linalg.solve(mine.covariance, error))
            if frame > 5:
                nis.append(step.nis)
    # the mean of n independent χ² of 12 degrees of freedom, runs being independent
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 12 * 60) / 60
    for age in range(3):
        assert low < np.mean(nees[age::3]) < high
    assert 5.7 < np.mean(nis) < 6.3


def steady(seconds, rng, settings=None):
    tracker = Tracker(settings)
    for frame in range(2 * seconds):
        said = np.diag([0.01, 0.01, 0.04]), 1e-3 * np.eye(3)
        seen = pose([0, 0, 20 - 0.05 * frame], Rotation.from_rotvec([0, 0.02 * frame, 0]), *said)
        step = tracker.step(0.5 * frame, seen)
    return tracker, step


def test_velocity_and_angular_velocity_in_the_units_of_their_names():
    _, step = steady(60, np.random.default_rng(0))
    np.testing.assert_allclose(step.estimate.v, [0, 0, -0.1], atol=0.01)
    np.testing.assert_allclose(step.estimate.w, np.degrees([0, 0.04, 0]), atol=0.2)
    deviations = step.estimate.standard_deviations
    np.testing.assert_allclose(deviations[:6] ** 2, np.diag(step.estimate.covariance)[:6])
    np.testing.assert_allclose(
        np.radians(deviations[6:]) ** 2, np.diag(step.estimate.covariance)[6:]
    )


def test_an_orbit_bends_the_way_of_a_free_body():
    """Clohessy and Wiltshire: a body that rests above falls behind by 12 pi heights an orbit."""
    n = np.radians(0.05)
    tracker = Tracker(replace(PLAIN, coasting=np.inf, acceleration=0, velocity=1e-9, **ORBIT))
    start = np.array([0.0, 1.0, 30.0])  # the zenith is +y, the orbit's normal (0.6, 0, 0.8)
    tiny = 1e-12 * np.eye(3)
    tracker.step(0, pose(start, Rotation.identity(), tiny, tiny))
    tracker.step(1e-9, pose(start, Rotation.identity(), tiny, tiny))
    height, along, across = start[1], start @ [-0.8, 0, 0.6], start @ [0.6, 0, 0.8]
    for orbits in (0.25, 1):
        angle = 2 * np.pi * orbits
        got = tracker.expected(angle / n) @ np.array([[0, 1, 0], [-0.8, 0, 0.6], [0.6, 0, 0.8]]).T
        wanted = [(4 - 3 * np.cos(angle)) * height, 0, np.cos(angle) * across]
        wanted[1] = along + 6 * (np.sin(angle) - angle) * height
        np.testing.assert_allclose(got, wanted, atol=1e-3)


def test_in_an_orbit_a_body_turns_against_the_stars():
    """The camera turns on; what a track coasts to is where a free body is then."""
    turning, rate = np.radians([0.03, 0, 0.04]), np.radians([0.0, 1.5, 0.5])
    start, said = Rotation.random(random_state=5), 1e-8 * np.eye(3)

    def truth(time):
        camera, body = (Rotation.from_rotvec(vector * time) for vector in (turning, rate))
        return camera.inv() * start * body

    def coasted(**settings):
        tracker = Tracker(replace(PLAIN, angular_acceleration=0, asymmetry=0, **settings))
        for time in np.arange(0, 60, 0.5):
            tracker.step(time, pose(np.array([0, 0, 15.0]), truth(time), said, said))
        return tracker.step(90, None).estimate

    def error(estimate):
        found = Rotation.from_quat(estimate.q, scalar_first=True)
        return np.degrees((found.inv() * truth(90)).magnitude())

    with_orbit = coasted(**ORBIT)
    assert error(with_orbit) < 1e-3
    assert error(coasted()) > 0.5
    of_camera = truth(90).inv().apply(turning)
    np.testing.assert_allclose(with_orbit.w, np.degrees(rate - of_camera), atol=1e-4)


def test_with_an_orbit_there_is_no_gyro():
    tracker = Tracker(Settings(**ORBIT))
    with pytest.raises(ValueError, match="camera_rate: expected zero with an orbital rate"):
        tracker.step(0, GOOD, camera_rate=(0.01, 0, 0))


def test_where_to_look_is_known_while_frames_correct_the_track():
    tracker = Tracker()
    assert tracker.expected(1) is None
    tracker, _ = steady(20, np.random.default_rng(0))
    np.testing.assert_allclose(tracker.expected(20), [0, 0, 18], atol=0.1)
    assert tracker.expected(19.5) is None  # the last frame's time
    assert tracker.expected(30) is None  # later than a track lasts
    turned = tracker.expected(20, camera_rate=(0, 10, 0))  # by 5 degrees: it moves to the left
    np.testing.assert_allclose(turned[0] / turned[2], -np.tan(np.radians(5)), atol=0.01)
    tracker.step(20, None)  # one that never came is no reason to search
    np.testing.assert_allclose(tracker.expected(21), [0, 0, 17.9], atol=0.1)
    resumed = Tracker.from_state(tracker.state())
    empty = pose([3, 3, 9], Rotation.identity(), np.eye(3), np.eye(3), 0.01, 0.5)
    for each in (tracker, resumed):
        each.step(20.5, empty)
        each.step(21, None)
        assert each.expected(21.5) is None  # the last that came does not show it


def test_flagged_frames_and_frames_without_a_pose_are_coasted():
    tracker, _ = steady(20, np.random.default_rng(0))
    empty = pose([3, 3, 9], Rotation.identity(), np.eye(3), np.eye(3), 0.01, 0.5)
    assert tracker.step(20, empty).outcome == "flagged"
    assert tracker.step(20.5, None).outcome == "coasted"
    assert Tracker().step(0, empty).outcome == "acquiring"


def test_a_second_orientation_is_followed_beside_the_first():
    tracker, half = Tracker(), Rotation.from_rotvec([0, np.pi, 0])
    for frame in range(20):
        turn = Rotation.from_rotvec([0, 0.02 * frame, 0])
        other = (turn * half).as_quat(scalar_first=True)
        said = PoseUncertainty(
            0.01 * np.eye(3), 1e-3 * np.eye(3), 1.0, alternative=other, probabilities=(0.5, 0.5)
        )
        step = tracker.step(frame / 2, Pose([0, 0, 20], turn.as_quat(scalar_first=True), said))
    assert abs(step.estimate.q @ tracker.alternative.q) < 0.1
    first = Rotation.from_quat(step.estimate.q, scalar_first=True)
    assert min((first.inv() * each).magnitude() for each in (turn, turn * half)) < 0.05


@pytest.mark.parametrize(
    "copied", [copy.copy, copy.deepcopy, lambda t: pickle.loads(pickle.dumps(t))]
)
def test_a_copy_goes_its_own_way(copied):
    tracker, _ = steady(20, np.random.default_rng(0))
    ahead = copied(tracker)
    assert ahead.step(60, None).estimate is None  # lost
    assert tracker.time == 19.5
    assert tracker.step(20, None).estimate is not None


def test_a_state_is_that_of_its_model():
    tracker, _ = steady(20, np.random.default_rng(0))
    again = Tracker.from_state(tracker.state(b"network"), b"network")
    assert again.step(20, None).estimate.t.tolist() == tracker.step(20, None).estimate.t.tolist()
    with pytest.raises(ValueError, match="of this model and camera, got that of another"):
        Tracker.from_state(tracker.state(b"network"), b"other")


GOOD = pose([0, 0, 9], Rotation.identity(), np.eye(3), np.eye(3))
SKEW = pose([0, 0, 9], Rotation.identity(), np.eye(3), np.diag([1.0, 1.0, -1.0]))


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ((5.0, GOOD), ValueError, "time: expected later than 9.5 s, the frame before, got 5 s"),
        ((9.5, GOOD), ValueError, "time: expected later"),
        ((np.nan, GOOD), ValueError, "time: expected finite"),
        ((20.0, SKEW), ValueError, "rotation_covariance: expected a positive definite matrix"),
        ((20.0, Pose([0, 0, 9], [1, 0, 0, 0])), ValueError, "uncertainty, got one without"),
        ((20.0, [GOOD]), TypeError, "pose: expected a Pose, got list"),
    ],
)
def test_what_is_no_frame_is_refused_and_changes_nothing(arguments, error, message):
    tracker, _ = steady(10, np.random.default_rng(0))
    before = tracker.state()
    with pytest.raises(error, match=message):
        tracker.step(*arguments)
    assert tracker.state() == before


def test_a_network_tells_its_errors():
    class Header:
        config = PolarPoseConfig(degrees_of_freedom=(4.5, 3.25))
        tracking: ClassVar = {"attitude_angle": 18.0}

    assert Settings.of(Header) == Settings(tails=3.25, attitude_angle=18)
    Header.tracking, Header.config = None, PolarPoseConfig()
    assert Settings.of(Header) == Settings()
    Header.tracking = {"angle": 1.0}
    with pytest.raises(ValueError, match="tracking: expected fields of Settings, got angle"):
        Settings.of(Header)


def test_settings_out_of_range_are_refused():
    with pytest.raises(ValueError, match="attitude_noise: expected a share above 0, up to 1"):
        Tracker(Settings(attitude_noise=0))
    for inertia in ((1, 1, 3, 0, 0, 0), (1, 1, 1, 2, 0, 0), (0, 0, 0, 0, 0, 0)):
        with pytest.raises(ValueError, match="inertia: expected that of a body"):
            Tracker(Settings(inertia=inertia))
    with pytest.raises(ValueError, match=r"inertia: expected 6 numbers, got \[1.0, 2.0\]"):
        Tracker(Settings(inertia=(1, 2)))
    with pytest.raises(ValueError, match="zenith: expected a vector of norm 1, got 2"):
        Tracker(Settings(zenith=(0, 2, 0)))
    with pytest.raises(ValueError, match="orbital_rate: expected a vector across the zenith"):
        Tracker(Settings(orbital_rate=(0, 0.06, 0)))
