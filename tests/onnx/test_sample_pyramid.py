"""The operator that samples pyramids: in torch against SciPy, in a graph against torch."""

from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.ndimage import map_coordinates
from torch import nn

import ffpose.onnx
from ffpose.nn.pyramid import sample_pyramid
from ffpose.onnx.library import ELF_NAME, NAMES

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxscript")
pytest.importorskip("onnxruntime")

LIBRARY = Path(ffpose.onnx.__file__).parent
HAS_LIBRARY = any((LIBRARY / name).is_file() for name in (ELF_NAME, *NAMES.values()))


def arguments(batch=2, views=6):
    """Views that lie in part outside of their images, at each level."""
    generator = torch.Generator().manual_seed(batch)
    homographies = torch.rand(views, 3, 3, generator=generator) - 0.5
    homographies[:, :2, 2] += torch.tensor([20.0, 12.0])
    homographies[:, 2] *= 0.04
    homographies[:, 2, 2] = 1.0
    levels = torch.arange(views) % 4
    plane = 60 * torch.rand(2, 5, 33, generator=generator) - 30
    pyramid = [torch.rand(batch, 3, 24 >> n, 40 >> n, generator=generator) for n in range(4)]
    return homographies, levels.float(), plane, pyramid


class Sampled(nn.Module):
    """Samples of a plane that is constant."""

    def __init__(self, plane):
        super().__init__()
        self.register_buffer("plane", plane)

    def forward(self, homographies, levels, finest, half, quarter, eighth):
        return sample_pyramid(homographies, levels, self.plane, [finest, half, quarter, eighth])


def test_each_view_is_interpolated_from_its_level():
    homographies, levels, plane, pyramid = arguments()
    seen = sample_pyramid(
        homographies.double(), levels.double(), plane.double(), [p.double() for p in pyramid]
    )
    pixels = np.concatenate([plane.numpy(), np.ones((1, 5, 33))]).astype(np.float64)
    for view, (matrix, level) in enumerate(zip(homographies, levels.int().tolist(), strict=True)):
        x, y, depth = np.einsum("ij,jhw->ihw", matrix.double().numpy(), pixels)
        ahead = depth > 1e-3
        depth = np.where(ahead, depth, 1)
        at = np.stack([y / depth, x / depth]) / 2**level - 0.5
        for channel in range(3):
            image = pyramid[level][view // 3, channel].double().numpy()
            expected = map_coordinates(image, at, order=1, mode="grid-constant")
            np.testing.assert_allclose(
                seen[view, channel].numpy(), np.where(ahead, expected, 0), atol=1e-9
            )
    assert 0.1 < (seen != 0).double().mean() < 1


def test_it_is_differentiable():
    homographies, levels, plane, pyramid = arguments()
    homographies.requires_grad_()
    pyramid[0].requires_grad_()
    sample_pyramid(homographies, levels, plane, pyramid).sum().backward()
    assert homographies.grad.any()
    assert pyramid[0].grad.any()


@pytest.mark.slow
@pytest.mark.parametrize(
    "filter",
    [
        "matmul",
        pytest.param(
            "custom",
            marks=pytest.mark.skipif(not HAS_LIBRARY, reason="the operators are not built"),
        ),
    ],
)
def test_a_graph_samples_as_torch_does(filter, tmp_path):
    homographies, levels, plane, pyramid = arguments(batch=3, views=3)
    exported = ffpose.onnx.export(
        Sampled(plane).eval(), (homographies, levels, *pyramid), tmp_path / "sampled.onnx", filter
    )
    operators = {node.op_type for node in onnx.load(exported.path).graph.node}
    assert ("SamplePyramid" in operators) == (filter == "custom")
    assert exported.filter == ("custom" if filter == "custom" else "none")
    (difference,) = exported.differences.values()
    assert difference < 1e-5
