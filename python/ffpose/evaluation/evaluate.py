"""Evaluation of trained weights on held-out images, compared with baselines that ignore the image.

The metrics are those of the paper's tables: errors of translation (Eq. 13) and orientation (Eq.
14), always as mean and median, and the scores of the ESA 2019 and SPEED+ 2021 challenges. The
rotation error is also split into in-plane and out-of-plane parts (`ffpose.evaluation.attitude`), as
a network may learn one and not the other.

The baselines are a mean pose (`ffpose.evaluation.baseline`), predicted for every image, and oracles
that know one part of the truth.
"""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from torch.utils.data import DataLoader

from ffpose import arrays
from ffpose._internal.cached import cached_property
from ffpose.datasets import (
    Conditions,
    Decoding,
    Part,
    PoseDataset,
    list_splits,
    open_dataset,
    read_conditions,
)
from ffpose.datasets.records import expect_in_front
from ffpose.errors import DataError
from ffpose.evaluation.baseline import mean_pose
from ffpose.evaluation.breakdown import breakdown
from ffpose.evaluation.calibration import (
    check_probability,
    summarize_flag,
    summarize_regions,
    truth_regions,
)
from ffpose.evaluation.confusion import LARGE_DEG, most_confused
from ffpose.evaluation.metrics import PoseErrors, error_statistics, pose_errors, summarized
from ffpose.evaluation.significance import circular_correlation, correlation
from ffpose.geometry import Camera, DistortedCamera, FloatArray
from ffpose.geometry.symmetry import IDENTITY, SymmetryGroup
from ffpose.imaging.images import image_files, read_rgb
from ffpose.imaging.preprocessing import Preprocessing
from ffpose.imaging.reprojection import Reprojection, agree, lens_of
from ffpose.imaging.undistortion import undistort
from ffpose.inference.load import load
from ffpose.inference.prediction import axis_length
from ffpose.models import PosePrediction, WeightsMetadata
from ffpose.onnx.metadata import ModelMetadata

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Evaluation:
    """Predictions on the images of one split, and the baseline on the same images.

    ``predicted`` are poses ``(N, 7)``, ``[t, q]``, and ``baseline`` is a constant one ``(7,)``.
    Covariances ``(N, 3, 3)`` are of the translation, m², and of the rotation vector ``r`` with
    ``R_true = exp([r]x) R_predicted``, rad², both in the camera frame; ``in_view`` are
    probabilities ``(N,)`` that the object is in the image, and ``in_view_empty`` those ``(M,)`` of
    images without it; ``alternative`` are second most likely attitudes ``(N, 4)``, and
    ``probabilities (N, 2)`` those of the predicted and of these. All of these are None for a
    network without uncertainty, the last two for one that tells no second mode too. Errors, of the
    baseline too, are to the nearest attitude of the same look by ``symmetry``; ``unfolded`` are
    larger symmetry groups, exact or near, modulo which the summary has errors too. ``axis_m`` is
    the length of axes as they are drawn, as of `ffpose.imaging.overlay.draw_axes`;
    ``baseline_of`` says whose mean pose the baseline is.

    Raises:
        ValueError: A probability is outside 0…1, a shape does not match, or there is one covariance
            alone; by what needs the regions, a covariance is not symmetric and positive definite.
    """

    dataset: PoseDataset
    predicted: FloatArray
    baseline: FloatArray
    seconds_per_image: float
    conditions: Conditions | None = None
    translation_covariance: FloatArray | None = None
    rotation_covariance: FloatArray | None = None
    degrees_of_freedom: tuple[float, float] | None = None
    in_view: FloatArray | None = None
    in_view_empty: FloatArray | None = None
    in_view_threshold: float | None = None
    symmetry: SymmetryGroup = IDENTITY
    unfolded: tuple[SymmetryGroup, ...] = ()
    alternative: FloatArray | None = None
    probabilities: FloatArray | None = None
    axis_m: float | None = None
    baseline_of: str = "the weights' training"

    def __post_init__(self) -> None:
        if (self.translation_covariance is None) != (self.rotation_covariance is None):
            raise ValueError("covariances: expected both or none, got one")
        for name, count in (("in_view", len(self.dataset)), ("in_view_empty", None)):
            if (probability := getattr(self, name)) is not None:
                check_probability(name, probability, count)

    @cached_property
    def errors(self) -> PoseErrors:
        """Errors of the predictions, image by image."""
        return self._errors(self.predicted, self.symmetry)

    @cached_property
    def truth(self) -> FloatArray:
        """True poses ``(N, 7)``, of attitudes of one look those nearest to the predicted."""
        return self.symmetry.folded(self.predicted, self.dataset.poses)

    @cached_property
    def baseline_errors(self) -> PoseErrors:
        """Errors of the baseline, image by image."""
        return self._errors(self._constant, self.symmetry)

    @cached_property
    def angles(self) -> tuple[FloatArray, FloatArray]:
        """Predicted and true roll, pitch and yaw ``(N, 3)`` each, degrees."""
        predicted, truth = (
            np.asarray(arrays.quaternion_to_euler(poses[:, 3:]), np.float64)
            for poses in (self.predicted, self.truth)
        )
        return predicted, truth

    @cached_property
    def region_probabilities(self) -> dict[str, FloatArray]:
        """`ffpose.evaluation.calibration.truth_regions`; none for a network without uncertainty."""
        if self.translation_covariance is None or self.rotation_covariance is None:
            return {}
        return truth_regions(
            self.predicted,
            self.truth,
            self.translation_covariance,
            self.rotation_covariance,
            self.degrees_of_freedom,
            self.alternative,
            self.probabilities,
            self.symmetry,
        )

    @cached_property
    def alternative_errors_deg(self) -> FloatArray | None:
        """Rotation errors ``(N,)`` of the second most likely attitudes; None where none are."""
        if self.alternative is None or self.probabilities is None:
            return None
        truth = self.symmetry.nearest(self.alternative, self.truth[:, 3:])
        return np.asarray(arrays.rotation_error(self.alternative, truth))

    @cached_property
    def ranking(self) -> NDArray[np.intp]:
        """Indices of the images from best to worst.

        By their ESA score; where labels locate the camera, the position error is divided by the
        spread of the positions instead of the distance.
        """
        score = self.errors.esa_score.numpy()
        if self.dataset.target == "camera":
            position = self.errors.translation_m.numpy() / self.dataset.spread
            score = position + np.radians(self.errors.rotation_deg.numpy())
        return np.argsort(score, kind="stable")

    def typical(self, count: int) -> list[int]:
        """Return the indices of the ``count`` images in the middle of the ranking, or of all."""
        begin = max(0, len(self.ranking) - count) // 2
        chosen: list[int] = self.ranking[begin : begin + count].tolist()
        return chosen

    def summary(self) -> dict[str, Any]:
        """Return the metrics of the model, the baseline and the oracles.

        Metrics are named as in `PoseError`, which has fewer where labels locate the camera;
        ``share_over_30_deg`` is that of attitudes which are farther off. ``median_intervals_95``
        holds bootstrap intervals of the medians; ``mean_pose_baseline`` the metrics of the constant
        pose and whose mean it is (``of``); ``oracles`` the rotation errors of two that know one
        part of the attitude and have the constant's error in the other: a model of such an error
        has learned at most the part that is known; ``correlation`` the correlation of predicted and
        true roll, pitch and yaw (circular for roll and yaw; None where one is constant);
        ``without_symmetry``, where errors are modulo one, its ``axes`` and the rotation errors to
        the labels as they are; ``modulo_unfolded`` the ``axes`` of each of ``unfolded`` and the
        rotation errors modulo it, with the constant pose's as ``mean_pose_baseline``; ``confusion``
        the turn of the object that most large errors are near, ``rotation_vector_deg``, and their
        ``share`` of all images (`ffpose.evaluation.confusion`); ``groups`` the medians by condition
        (`ffpose.evaluation.breakdown`); ``uncertainty``, for a network that predicts it, its
        calibration (`ffpose.evaluation.calibration`), and of one that tells two ``modes`` the share
        of attitudes over 30 degrees off, and of those that are so from both.
        """
        distance = np.linalg.norm(self.dataset.poses[:, :3], axis=1)
        located = self.dataset.target == "object"  # a world's origin is nothing to be far from
        uncertainty = self._uncertainty()
        return {
            "images": len(self.dataset),
            **error_statistics(self.errors),
            "seconds_per_image": self.seconds_per_image,
            "mean_pose_baseline": {
                "pose": self.baseline.tolist(),
                "of": self.baseline_of,
                **error_statistics(self.baseline_errors),
                "confusion": self._confusion(self._constant),
            },
            **self._modulo_others(),
            "confusion": self._confusion(self.predicted),
            "oracles": self._oracles(),
            "correlation": self._correlations(),
            "groups": breakdown(self.errors, distance if located else None, self.conditions),
            **({"uncertainty": uncertainty} if uncertainty else {}),
        }

    @property
    def _constant(self) -> FloatArray:
        return np.broadcast_to(self.baseline, self.dataset.poses.shape)

    def _errors(self, poses: FloatArray, group: SymmetryGroup) -> PoseErrors:
        """Return the errors of poses ``(N, 7)`` modulo a group."""
        truth = group.folded(poses, self.dataset.poses)
        return pose_errors(poses, truth, target=self.dataset.target)

    def _confusion(self, poses: FloatArray) -> dict[str, Any]:
        truth = self.symmetry.folded(poses, self.dataset.poses)
        turn, share = most_confused(poses[:, 3:], truth[:, 3:])
        return {"rotation_vector_deg": turn.tolist(), "share": share}

    def _modulo_others(self) -> dict[str, Any]:
        """Return the rotation errors regardless of the symmetry, and modulo each of `unfolded`."""
        result: dict[str, Any] = {}
        if len(self.symmetry) > 1:
            plain = _rotation_metrics(self._errors(self.predicted, IDENTITY))
            result["without_symmetry"] = {"axes": self.symmetry.to_json(), **plain}
        if self.unfolded:
            result["modulo_unfolded"] = [
                {
                    "axes": group.to_json(),
                    **_rotation_metrics(self._errors(self.predicted, group)),
                    "mean_pose_baseline": _rotation_metrics(self._errors(self._constant, group)),
                }
                for group in self.unfolded
            ]
        return result

    def _oracles(self) -> dict[str, dict[str, float]]:
        if self.dataset.target == "camera":  # whose ray to the origin means nothing
            return {}
        errors = self.baseline_errors
        across, inside = errors.out_of_plane_deg, errors.in_plane_deg
        none = inside.new_zeros(inside.shape)
        known = {
            "in_plane_known": errors._replace(rotation_deg=across, in_plane_deg=none),
            "out_of_plane_known": errors._replace(rotation_deg=inside, out_of_plane_deg=none),
        }
        return {name: _rotation_metrics(each) for name, each in known.items()}

    def _correlations(self) -> dict[str, float | None]:
        (roll_hat, pitch_hat, yaw_hat), (roll, pitch, yaw) = (angles.T for angles in self.angles)
        return {
            "roll": circular_correlation(roll_hat, roll),
            "pitch": correlation(pitch_hat, pitch),
            "yaw": circular_correlation(yaw_hat, yaw),
        }

    def _uncertainty(self) -> dict[str, Any]:
        """Return the calibration of covariances and flag; empty without them."""
        result: dict[str, Any] = {
            name: summarize_regions(probability)
            for name, probability in self.region_probabilities.items()
        }
        if self.translation_covariance is not None and self.rotation_covariance is not None:
            result["translation"]["median_sigma_m"] = _median_sigma(self.translation_covariance)
            sigma = _median_sigma(self.rotation_covariance)
            result["rotation"]["median_sigma_deg"] = float(np.degrees(sigma))
        if self.alternative_errors_deg is not None:
            rotation = self.errors.rotation_deg.numpy()
            nearer = np.minimum(rotation, self.alternative_errors_deg)
            result["modes"] = {
                "share_over_30_deg": float((rotation > LARGE_DEG).mean()),
                "share_over_30_deg_of_both": float((nearer > LARGE_DEG).mean()),
            }
        if self.in_view is not None:
            flag = summarize_flag(self.in_view, self.in_view_empty, self.in_view_threshold)
            result |= {"in_view": flag} if flag else {}
        return result


def evaluate(
    weights: str | Path,
    kind: str,
    root: Path,
    split: Part = "test",
    *,
    batch_size: int = 32,
    reproject: bool = False,
    decoding: Decoding | None = None,
    device: str = "auto",
    empty: Path | None = None,
    symmetry: SymmetryGroup | None = None,
    unfolded: tuple[SymmetryGroup, ...] = (),
) -> Evaluation:
    """Evaluate weights on the images of a split, or of ``"all"``.

    ``weights`` are what `ffpose.load` takes; their header defines the preprocessing, and what
    ``decoding`` leaves open. The baseline is the mean pose of the training split of ``root``, where
    that is none of the images; else of the weights' training, else of the images themselves. A
    warning says why a split that is there cannot be read. With ``reproject`` images of another
    camera are reprojected into the network's view; ``empty`` is a folder of images that do not show
    the object, for miss rate and AUROC; errors are modulo ``symmetry``, that of the training for
    None, and told modulo each of ``unfolded`` too.

    Raises:
        FileNotFoundError: The weights or a file of the dataset are missing.
        ValueError: The weights were altered, their camera is not that of the images, the labels
            do not locate what they do, the device cannot be had, or ``empty`` is given for a
            network that does not predict whether the object is in view.
        ffpose.DataError: An image or a label cannot be used.
    """
    empty_images = [] if empty is None else image_files(empty, "empty")
    estimator = load(weights, resize=True, device=device, warm_up=0)
    metadata = estimator.metadata
    decoding = (decoding or Decoding()).completed(metadata.undistorted, metadata.white)
    dataset = open_dataset(kind, root, split, metadata.preprocessing, decoding=decoding)
    dataset.expect_target(metadata.locates)
    expect_in_front(dataset.records)
    dataset.preprocessing = choose_preprocessing(metadata, dataset.camera, reproject=reproject)
    baseline, baseline_of = _baseline(metadata, kind, root, split, dataset)
    conditions = read_conditions(root, dataset.names)
    lens = dataset.records[0].lens
    empty_in_view = []
    for image in empty_images:
        picture = _decoded(image, decoding.white, lens)
        found = estimator.run(dataset.preprocessing.array(picture)[None])
        if "in_view" not in found:
            raise ValueError(
                "empty: expected weights that predict whether the object is in view, got others"
            )
        empty_in_view.append(found["in_view"])
    loader = DataLoader(dataset, batch_size=batch_size)
    began = time.perf_counter()
    batches = [estimator.run(batch.image.numpy()) for batch in loader]
    seconds = (time.perf_counter() - began) / len(dataset)
    outputs = {
        name: np.concatenate([batch[name] for batch in batches]).astype(np.float64)
        for name in batches[0]
    }
    predicted = np.concatenate([outputs.pop(name) for name in PosePrediction._fields], axis=1)
    if empty_in_view:
        outputs["in_view_empty"] = np.concatenate(empty_in_view).astype(np.float64)
    return Evaluation(
        dataset,
        predicted,
        baseline,
        seconds,
        conditions,
        in_view_threshold=metadata.in_view_threshold,
        degrees_of_freedom=metadata.config.degrees_of_freedom,
        symmetry=metadata.symmetry if symmetry is None else symmetry,
        unfolded=unfolded,
        axis_m=axis_length(metadata.config),
        baseline_of=baseline_of,
        **outputs,
    )


def _baseline(
    metadata: WeightsMetadata | ModelMetadata,
    kind: str,
    root: Path,
    split: Part,
    dataset: PoseDataset,
) -> tuple[FloatArray, str]:
    """Return the mean pose to compare with, and whose it is."""
    if split not in ("all", "train") and "train" in list_splits(kind, root):
        try:
            training = open_dataset(kind, root, "train", metadata.preprocessing)
            return mean_pose(training.poses), f"the split train of {root.resolve().name}"
        except FileNotFoundError:
            pass  # its labels are elsewhere
        except DataError as error:
            logger.warning(
                "the baseline is not of the split train, which gives no mean pose: %s", error
            )
    if isinstance(metadata, WeightsMetadata) and metadata.mean_pose is not None:
        return metadata.mean_pose, "the weights' training"
    return mean_pose(dataset.poses), "the images themselves"


def _decoded(path: Path, white: float | str | None, lens: DistortedCamera | None) -> Image.Image:
    """Decode an image without a label as those with one: ``lens`` is theirs, if it is taken out."""
    picture = read_rgb(path, white)
    if lens is None:
        return picture
    if picture.size != (lens.width, lens.height):
        expected = f"{lens.width}x{lens.height} pixels, as images of the set's camera have"
        raise DataError(f"expected {expected}, got {picture.width}x{picture.height}", path)
    return undistort(picture, lens)


def _rotation_metrics(errors: PoseErrors) -> dict[str, float]:
    """Return means and medians of the rotation errors and their parts."""
    return {name: float(value) for name, value in summarized(errors).items() if "_deg" in name}


def _median_sigma(covariance: FloatArray) -> float:
    """Return the median over covariances ``(N, 3, 3)`` of the RMS standard deviation."""
    return float(np.median(np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 3)))


def choose_preprocessing(
    metadata: WeightsMetadata | ModelMetadata, camera: Camera | None, *, reproject: bool
) -> Preprocessing:
    """Return the preprocessing from images of a set's camera to the network's input.

    ``camera`` is None for images of several; with ``reproject`` those of a camera other than the
    weights' are reprojected into the network's view.

    Raises:
        ValueError: The camera differs from the weights', or has distortion that those of training
            had not, and ``reproject`` is false; or has not the distortion that they had; or the
            images are of several, and the weights of one.
    """
    plain, view = metadata.preprocessing, metadata.config.view_camera
    if view is None:
        return plain
    if camera is None:
        raise ValueError("expected images of the weights' camera, got a set of several cameras")
    if agree(plain.camera(camera), view) and lens_of(camera) == metadata.distortion:
        return plain
    if metadata.distortion is not None:
        raise ValueError(
            "expected images of the weights' camera, with the distortion"
            f" {metadata.distortion}, which was not taken out in training, got a set of {camera}"
        )
    if reproject:
        return Reprojection.of(plain, camera, view)
    if lens_of(camera) is not None:
        raise ValueError(
            f"expected images of a camera without distortion, got a set of {camera}; "
            "--data.undistort takes it out"
        )
    expected = plain.image_camera(view, camera.width, camera.height)
    raise ValueError(
        f"expected images of the weights' camera, {expected}, got a set of {camera}; "
        "--reproject turns them into the network's view"
    )
