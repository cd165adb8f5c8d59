"""Builds ffpose for pip: maturin, once the operator's library is in the package (PEP 517)."""

from __future__ import annotations

import os
import shutil
import sys
from typing import Any

import maturin

from build_library import build_library

SOURCES = (
    "ffpose: built from its sources, which needs Rust and a C linker, as pip found no wheel for"
    " this machine; wheels need pip 20.3 or newer and, on Linux, glibc 2.28 or newer"
)


def build_wheel(*args: Any, **kwargs: Any) -> str:
    """Build a wheel; arguments and result are those of PEP 517."""
    print(SOURCES, file=sys.stderr)  # pip shows it where the build fails
    _find_cargo()
    build_library()
    return maturin.build_wheel(*args, **kwargs)


def build_editable(*args: Any, **kwargs: Any) -> str:
    """Build an editable wheel (PEP 660), whose sources and libraries are used in place."""
    _find_cargo()
    build_library()
    return maturin.build_editable(*args, **kwargs)


def __getattr__(hook: str) -> Any:
    """Return maturin's own hook for all else."""
    return getattr(maturin, hook)


def _find_cargo() -> None:
    """Install Rust for this build where there is none, as maturin does."""
    if not shutil.which("cargo") and not os.environ.get("MATURIN_NO_INSTALL_RUST"):
        from puccinialin import setup_rust

        os.environ.update(setup_rust())
