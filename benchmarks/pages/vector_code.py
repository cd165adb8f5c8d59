"""The filter against torch.fft in MKL's vector code, where MKL would run its baseline code.

MKL asks `mkl_serv_intel_cpu_true` whether the processor is Intel's; a preloaded library of one line
answers yes (https://danieldk.eu/Posts/2020-08-31-MKL-Zen.html).
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.filter.cases import make_plan
from benchmarks.filter.report import make_document
from benchmarks.filter.run import measure
from benchmarks.machine import environment
from ffpose._internal import machine

CODE = "int mkl_serv_intel_cpu_true(void) { return 1; }"


def vector_code() -> dict[str, Any] | None:
    """Measure the cases of ``--quick`` with MKL in its vector code; None where it needs no help.

    That is where MKL runs that code anyway or there is no MKL, and where there is no C compiler.

    Returns:
        The code that MKL ran, and the ratios to torch.fft by case.
    """
    compiler = shutil.which(os.environ.get("CC", "cc"))
    if environment()["mkl_code"] != "baseline" or compiler is None:
        return None
    plan = make_plan(quick=True)
    with tempfile.TemporaryDirectory(prefix="ffpose-bench-") as folder:
        library = Path(folder, "mkl.so")
        command = [compiler, "-shared", "-fPIC", "-xc", "-", "-o", str(library)]
        subprocess.run(command, input=CODE, text=True, check=True)
        before = os.environ.get("LD_PRELOAD")
        with machine.environment(LD_PRELOAD=f"{library}:{before}" if before else str(library)):
            openings, comparisons = measure(plan)
    results = make_document(openings, comparisons, ())["results"]
    return {
        "mkl_code": openings[0].environment["mkl_code"],
        "results": [{name: each[name] for name in ("case", "ratio")} for each in results],
    }
