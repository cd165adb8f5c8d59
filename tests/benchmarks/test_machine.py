"""What the benchmark tells of the machine."""

import platform
from pathlib import Path

import pytest
import torch

from benchmarks.machine import bfloat16_instructions, environment

CPUINFO = Path("/proc/cpuinfo")


@pytest.mark.skipif(not CPUINFO.exists(), reason="expected Linux, which tells the vendor")
def test_mkl_says_which_code_it_runs():
    intel = "GenuineIntel" in CPUINFO.read_text()
    expected = "vectorized" if intel else "baseline"
    assert environment()["mkl_code"] == (expected if torch.backends.mkl.is_available() else "")


@pytest.mark.skipif(platform.machine() != "x86_64", reason="expected what torch tells of x86")
def test_bfloat16_instructions_are_those_that_torch_finds():
    found = bfloat16_instructions()
    assert ("avx512_bf16" in found) == torch.cpu._is_avx512_bf16_supported()
    assert set(found) <= {"avx512_bf16", "amx_bf16"}
