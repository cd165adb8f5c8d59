"""The benchmark as a whole, on cases that take no time."""

import json
import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest
import torch

from benchmarks.__main__ import main
from benchmarks.filter import children
from benchmarks.filter import run as bench
from benchmarks.filter.cases import MATRICES, SCIPY, TORCH, Case, Plan, overhead_cases
from benchmarks.filter.worker import Request
from ffpose.arrays import instruction_set
from ffpose.bench.filter import OURS


def tiny_plan():
    cases = [
        Case("tokens", (4, 6), 1, work, 1, (OURS, TORCH, MATRICES))
        for work in ("forward", "forward+backward")
    ]
    cases.append(Case("sequence", (6, 2), 8, contenders=(OURS, TORCH, SCIPY)))
    return Plan({instruction_set(): [*cases, *overhead_cases()]}, 0.001, ("a note",))


@pytest.mark.slow
def test_run_prints_a_document_or_tables_and_draws(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(bench, "make_plan", lambda quick: tiny_plan())
    words = ["filter", "--quick", "--json", "--plot", str(tmp_path / "filter.png")]
    assert main(words) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["notes"] == ["a note"]
    assert [each["setting"]["allocator"] for each in document["processes"]] == ["default", "kept"]
    assert all(each["environment"]["torch"] == torch.__version__ for each in document["processes"])
    assert all(each["peaks"][0]["flops"] > 1e8 for each in document["processes"])
    assert len(document["results"]) == 3 + 4
    first = document["results"][0]
    assert set(first["timings"]) == {"default", "kept"}
    assert set(first["ratio"]) == {TORCH, MATRICES}
    assert {mean["group"] for mean in document["geometric_means"]} == {"other sizes"}
    assert [each["work"] for each in document["overheads"]] == ["forward", "recorded"]
    assert (tmp_path / "filter.png").read_bytes().startswith(b"\x89PNG")
    bench.run(quick=True)
    printed = capsys.readouterr().out
    assert "geometric mean" in printed
    assert "a note" in printed


def test_a_missing_folder_is_found_before_the_work(tmp_path, monkeypatch):
    monkeypatch.setattr(bench, "run_child", lambda *_: pytest.fail("measured first"))
    with pytest.raises(FileNotFoundError, match="expected an existing folder"):
        bench.run(plot=tmp_path / "absent" / "filter.png")


@pytest.mark.slow
def test_a_child_is_held_to_what_was_chosen(tmp_path):
    setting = children.Setting("scalar", "kept")
    request = Request([Case("tokens", (4, 6), 1)], 0.001)
    opening, measurement = children.run_child(setting, request, str(tmp_path))
    assert opening.environment["instruction_set"] == "scalar"
    assert measurement.case == request.cases[0]
    assert children.Setting("avx2", "default").variables() == {
        "FFPOSE_ISA": "avx2",
        "MKL_ENABLE_INSTRUCTIONS": "AVX2",
        "ATEN_CPU_CAPABILITY": "avx2",
    }


@pytest.mark.slow
def test_a_child_that_fails_is_quoted(tmp_path):
    setting = children.Setting("none", "default")
    with pytest.raises(RuntimeError, match=r"\(none, allocator default\) failed: .*got .none"):
        list(
            children.run_child(setting, Request([Case("tokens", (4, 6), 1)], 0.001), str(tmp_path))
        )


def measures(processes):
    """Whether one of the processes is a Python, which measures."""
    commands = (Path("/proc", each, "cmdline") for each in processes)
    return any(sys.executable.encode() in path.read_bytes() for path in commands if path.exists())


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="sees in /proc that the measuring has begun")
def test_an_interrupted_benchmark_leaves_nothing(tmp_path):
    words = ["filter", "--quick", "--json", "--plot", "filter.png"]
    child = subprocess.Popen(
        [sys.executable, "-m", "benchmarks", *words],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # a shell's background job, as this test may be part of, ignores the signal
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),
        env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
    )
    grandchildren = Path(f"/proc/{child.pid}/task/{child.pid}/children")
    deadline = time.monotonic() + 300  # on a busy machine
    # what imports start is another program, and is not waited for
    while not measures(grandchildren.read_text().split()) and time.monotonic() < deadline:
        time.sleep(0.1)
    os.killpg(child.pid, signal.SIGINT)  # as a terminal does: to parent and child
    printed, told = child.communicate(timeout=30)
    assert child.returncode == 130
    assert "interrupted" in told
    assert "Traceback" not in told
    assert printed == ""
    assert list(tmp_path.iterdir()) == []
