"""The filters of the networks, by each instruction set of the machine, against sums in float64."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from ffpose import _rust

PROGRAM = """
import numpy as np
import reference
from ffpose import _rust

assert _rust.isa() == {isa!r}
rng = np.random.default_rng(0)
for layout, shape in [
    ("tokens", (2, 196, 256)),
    ("tokens", (2, 784, 128)),
    ("tokens", (1, 784, 256)),
    ("grid", (3, 14, 14, 40)),
    ("grid", (2, 28, 28, 20)),
    ("grid", (1, 56, 56, 17)),
]:
    x, grad = rng.normal(size=(2, *shape)).astype(np.float32)
    rows, columns, *channels = shape[1:]
    weight = rng.normal(size=(rows, columns // 2 + 1, *channels, 2)).astype(np.float32)
    y = _rust.spectral_filter(x, weight, layout)
    for_x, for_weight = _rust.spectral_filter_backward(grad, x, weight, layout, True, True)
    expected = (
        reference.spectral_filter(x, weight, layout),
        *reference.spectral_filter_backward(grad, x, weight, layout),
    )
    for name, got, exact in zip("y x weight".split(), (y, for_x, for_weight), expected):
        error = np.abs(got - exact).max()
        tolerance = reference.spectral_tolerance(exact, rows * columns, np.float32)
        assert error <= tolerance, f"{{name}} {{layout}} {{shape}}: {{error}} > {{tolerance}}"
"""


@pytest.mark.parametrize("isa", _rust.isas())
def test_gradients_at_the_sizes_of_networks(isa):
    environment = os.environ | {"FFPOSE_ISA": isa}
    program = PROGRAM.format(isa=isa)
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=environment
        | {"PYTHONPATH": os.pathsep.join([str(Path(__file__).parents[1]), *sys.path])},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
