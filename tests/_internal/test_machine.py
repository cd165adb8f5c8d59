"""Facts about the machine, against what torch and NumPy say."""

import os
import platform

import numpy as np
import pytest
import torch

from ffpose._internal.machine import NOT_INSTALLED, bfloat16_instructions, cores, package_versions


@pytest.mark.skipif(platform.machine() != "x86_64", reason="expected what torch tells of x86")
def test_bfloat16_instructions_are_those_that_torch_finds():
    found = bfloat16_instructions()
    assert ("avx512_bf16" in found) == torch.cpu._is_avx512_bf16_supported()
    assert set(found) <= {"avx512_bf16", "amx_bf16"}


def test_versions_of_packages_that_are_there_and_that_are_not():
    found = package_versions("numpy", "no-such-package")
    assert found == {"numpy": np.__version__, "no-such-package": NOT_INSTALLED}


def test_there_are_no_more_cores_than_the_machine_has():
    assert 1 <= cores() <= os.cpu_count()
