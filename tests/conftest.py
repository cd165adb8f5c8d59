"""One thread for matrix products, as the tests' are small; and a cache of the tests' own."""

import os

import pytest

from figures import blank_figures

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(variable, "1")


def pytest_report_header():
    """Say what machine code the tests reach."""
    from ffpose import _rust

    return f"instruction sets: {', '.join(_rust.isas())}"


@pytest.fixture
def undrawn(monkeypatch):
    """Figures are blank."""
    blank_figures(monkeypatch)


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory):
    """Frames of datasets go into a folder that pytest removes, not into the user's."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FFPOSE_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield
