"""Facts about the machine, against what torch and NumPy say."""

import os

import numpy as np

from ffpose._internal.machine import NOT_INSTALLED, cores, package_versions


def test_versions_of_packages_that_are_there_and_that_are_not():
    found = package_versions("numpy", "no-such-package")
    assert found == {"numpy": np.__version__, "no-such-package": NOT_INSTALLED}


def test_there_are_no_more_cores_than_the_machine_has():
    assert 1 <= cores() <= os.cpu_count()
