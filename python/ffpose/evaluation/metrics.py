"""Pose errors, per batch and accumulated over batches and processes, computed by the Rust core.

* Translation error: Euclidean distance in meters (Ye et al., Sensors 2023, 23, 8633, Eq. 13).
* Rotation error: the angle of the rotation from prediction to label, in degrees (Eq. 14); q and -q
  are the same rotation. `ffpose.evaluation.attitude` defines its in-plane and out-of-plane parts.
* ESA score (Kelvins pose estimation challenge, 2019): mean of relative translation error plus
  rotation error in radians.
* SPEED+ score (2021): as the ESA score, but an error below the calibration's accuracy (0.002173
  relative, 0.169 degrees) counts as zero.

Where labels locate the camera, the ray to the world's origin and its length mean nothing: only the
translation and rotation errors are there.

The paper's Tables 1-4 are means and Table 5 medians; both are always computed.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torchmetrics import Metric
from torchmetrics.utilities import dim_zero_cat

from ffpose import arrays
from ffpose.evaluation.attitude import rotation_parts
from ffpose.evaluation.confusion import LARGE_DEG
from ffpose.evaluation.significance import median_interval
from ffpose.geometry import Target

SUMMARIZED = {
    "translation_error_m": "translation_m",
    "relative_translation_error": "relative_translation",
    "rotation_error_deg": "rotation_deg",
    "in_plane_error_deg": "in_plane_deg",
    "out_of_plane_error_deg": "out_of_plane_deg",
}
"""Errors of which mean and median are computed: name, and field of `PoseErrors`."""

SCORES = {"esa_score": "esa_score", "speed_plus_score": "speed_plus_score"}
"""Scores of which the mean is computed: name, and field of `PoseErrors`."""


class PoseErrors(NamedTuple):
    """Errors of each sample, float64 ``(N,)`` on the CPU.

    All but the first two are NaN where labels locate the camera.

    Attributes:
        translation_m: Translation error, meters.
        rotation_deg: Rotation error, degrees.
        esa_score: ESA score of the sample.
        speed_plus_score: SPEED+ score of the sample.
        relative_translation: Translation error divided by the true distance.
        in_plane_deg: Twist about the true viewing ray, degrees.
        out_of_plane_deg: Angle between true and predicted viewing directions, degrees.
    """

    translation_m: Tensor
    rotation_deg: Tensor
    esa_score: Tensor
    speed_plus_score: Tensor
    relative_translation: Tensor
    in_plane_deg: Tensor
    out_of_plane_deg: Tensor

    def named(self) -> dict[str, NDArray[np.float64]]:
        """Return the errors by their names in `SUMMARIZED` and `SCORES`; none that are NaN."""
        names = {field: name for name, field in (SUMMARIZED | SCORES).items()}
        found = defined(self, {names[field]: field for field in self._fields})
        return {name: values.numpy() for name, values in found.items()}


def pose_error(
    t_hat: Tensor, q_hat: Tensor, t: Tensor, q: Tensor, *, target: Target = "object"
) -> PoseErrors:
    """Return the errors of each prediction, computed in float64.

    Args:
        t_hat: Predicted translations ``(N, 3)``, meters, any floating dtype and device.
        q_hat: Predicted quaternions ``(N, 4)``, ``(w, x, y, z)``.
        t: True translations ``(N, 3)``.
        q: True quaternions ``(N, 4)``.
        target: What the poses locate.

    Raises:
        TypeError: An argument is no tensor, or not of floating dtype.
        ValueError: A shape is wrong, a value is NaN or infinite, a quaternion is zero, or a true
            translation of an object is zero, for which no relative error exists.
    """
    named = {"t_hat": t_hat, "q_hat": q_hat, "t": t, "q": q}
    for name, tensor in named.items():
        if not isinstance(tensor, Tensor):
            raise TypeError(f"{name}: expected a torch.Tensor, got {type(tensor).__name__}")
        if not tensor.is_floating_point():
            raise TypeError(f"{name}: expected a floating dtype, got {tensor.dtype}")
    pairs = {
        name: tensor.detach().cpu().double().contiguous().numpy() for name, tensor in named.items()
    }
    translation = torch.from_numpy(arrays.translation_error(pairs["t_hat"], pairs["t"]))
    rotation = torch.from_numpy(arrays.rotation_error(pairs["q_hat"], pairs["q"]))
    if target == "camera":
        undefined = torch.full_like(translation, torch.nan)
        return PoseErrors(translation, rotation, *[undefined] * (len(PoseErrors._fields) - 2))
    esa_score = torch.from_numpy(arrays.esa_score(**pairs))
    speed_plus_score = torch.from_numpy(arrays.speed_plus_score(**pairs))
    distance = torch.linalg.vector_norm(torch.from_numpy(pairs["t"]), dim=1)
    parts = map(torch.from_numpy, rotation_parts(pairs["q_hat"], pairs["t"], pairs["q"]))
    return PoseErrors(
        translation, rotation, esa_score, speed_plus_score, translation / distance, *parts
    )


def pose_errors(
    predicted: NDArray[np.float64], truth: NDArray[np.float64], *, target: Target = "object"
) -> PoseErrors:
    """Return the errors of poses ``(N, 7)``, ``[t, q]``, as `pose_error`."""
    t_hat, q_hat, t, q = (
        torch.from_numpy(part.copy())  # torch warns of what is read-only
        for poses in (predicted, truth)
        for part in (poses[:, :3], poses[:, 3:])
    )
    return pose_error(t_hat, q_hat, t, q, target=target)


def defined(errors: PoseErrors, fields: Mapping[str, str]) -> dict[str, Tensor]:
    """Return errors ``(N,)`` by name, for ``fields`` by name, without those that are NaN."""
    values = {name: getattr(errors, field) for name, field in fields.items()}
    return {name: each for name, each in values.items() if not bool(each.isnan().any())}


def named_errors(errors: PoseErrors) -> dict[str, NDArray[np.float64]]:
    """Return the errors ``(N,)`` whose means and medians are computed, by name (`SUMMARIZED`)."""
    return {name: values.numpy() for name, values in defined(errors, SUMMARIZED).items()}


class PoseError(Metric):
    """Mean and median pose errors over all samples of all processes.

    Examples:
        >>> metric = PoseError()
        >>> q = torch.tensor([[1.0, 0.0, 0.0, 0.0]])
        >>> metric.update(torch.tensor([[3.0, 4.0, 10.0]]), -q, torch.tensor([[0.0, 0.0, 10.0]]), q)
        >>> float(metric.compute()["mean_translation_error_m"])
        5.0
    """

    is_differentiable = False
    full_state_update = False

    def __init__(self, target: Target = "object", **kwargs: Any) -> None:
        """Build an empty metric of poses that locate ``target``; see `torchmetrics.Metric`."""
        super().__init__(**kwargs)
        self.set_dtype(torch.float64)  # also of no samples, as a process may have
        self.target = target
        for name in PoseErrors._fields:
            self.add_state(name, default=[], dist_reduce_fx="cat")

    def update(self, t_hat: Tensor, q_hat: Tensor, t: Tensor, q: Tensor) -> None:
        """Add a batch; arguments and errors are those of `pose_error`."""
        errors = pose_error(t_hat, q_hat, t, q, target=self.target)
        for name, error in zip(PoseErrors._fields, errors, strict=True):
            getattr(self, name).append(error.to(self.device))

    def compute(self) -> dict[str, Tensor]:
        """Return the metrics over all samples so far, scalar tensors.

        ``esa_score`` and ``speed_plus_score``, and ``mean_`` and ``median_`` of each of
        `SUMMARIZED`, without those that are NaN. The median of an even number of samples is the
        mean of the middle two.

        Raises:
            ValueError: There are no samples.
        """
        return summarized(PoseErrors(*(dim_zero_cat(getattr(self, n)) for n in PoseErrors._fields)))


def summarized(errors: PoseErrors) -> dict[str, Tensor]:
    """Return the metrics of errors, as `PoseError.compute`."""
    if len(errors.translation_m) == 0:
        raise ValueError("pose error: expected at least one sample, got none")
    return {
        **{
            f"{statistic}_{name}": value
            for name, values in defined(errors, SUMMARIZED).items()
            for statistic, value in (("mean", values.mean()), ("median", values.quantile(0.5)))
        },
        **{name: values.mean() for name, values in defined(errors, SCORES).items()},
    }


def error_statistics(errors: PoseErrors) -> dict[str, Any]:
    """Return the metrics of errors, as `PoseError.compute`, their intervals and the large ones.

    ``share_over_30_deg`` is that of attitudes which are farther off, and ``median_intervals_95``
    has bootstrap intervals of the medians by name.
    """
    return {
        **{name: float(value) for name, value in summarized(errors).items()},
        "share_over_30_deg": float((errors.rotation_deg > LARGE_DEG).double().mean()),
        "median_intervals_95": {
            f"median_{name}": list(median_interval(values))
            for name, values in named_errors(errors).items()
        },
    }
