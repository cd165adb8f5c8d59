"""What the benchmark tells of the machine."""

from pathlib import Path

import pytest
import torch

from benchmarks.machine import environment

CPUINFO = Path("/proc/cpuinfo")


@pytest.mark.skipif(not CPUINFO.exists(), reason="expected Linux, which tells the vendor")
def test_mkl_says_which_code_it_runs():
    intel = "GenuineIntel" in CPUINFO.read_text()
    expected = "vectorized" if intel else "baseline"
    assert environment()["mkl_code"] == (expected if torch.backends.mkl.is_available() else "")
