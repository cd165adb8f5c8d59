"""Data files of the pages: what is measured into them, and how they are written and read."""

import json
import os
import shutil
from dataclasses import asdict
from pathlib import Path

import pytest

from benchmarks.__main__ import main
from benchmarks.filter.cases import Case, Plan, overhead_cases
from benchmarks.model import attention
from benchmarks.model.contenders import COMPILED, COMPILED_ALONE, DFT, MATMUL, TORCH_ALONE
from benchmarks.model.networks import NetworkCase
from benchmarks.model.subjects import GFNET, GlobalFilterNetwork, subject
from benchmarks.pages import documents, vector_code
from benchmarks.pages.documents import Effort, Figures, read, write
from ffpose import DataError
from ffpose.arrays import instruction_set


@pytest.fixture
def root(tmp_path):
    """Folders as in the sources, and a page without figures for each that has some."""
    (tmp_path / documents.FOLDER).mkdir(parents=True)
    (tmp_path / documents.IMAGES).mkdir()
    for page in (
        "README.md",
        *(f"docs/{name}.md" for name in ("index", "filter", "benchmarks", "deployment")),
    ):
        (tmp_path / page).write_text("<!-- figures views --><!-- end figures -->")
    return tmp_path


def test_a_file_is_read_as_it_was_written(root):
    figures = Figures(
        "a machine", "a note", True, (1, 2), {"torch": "2"}, {"a": {"b": [{"c": {}}]}}
    )
    write("views", figures, root)
    assert read("views", root) == figures
    assert json.loads((root / "docs/figures/views.json").read_text())["threads"] == [1, 2]


@pytest.mark.parametrize("text", [None, "{", "[]", '{"threads": [1]}'])
def test_a_file_that_is_none_is_an_error(root, text):
    if text is not None:
        (root / "docs/figures/views.json").write_text(text)
    with pytest.raises(DataError, match=r"views\.json: expected figures of views"):
        read("views", root)


def test_the_command_measures_and_writes_pages(root, monkeypatch, capsys):
    monkeypatch.chdir(root)
    efforts = []

    def views(effort, folder):
        efforts.append(effort)
        return {"latencies": {"1 1": {"p50": 1 / 3}, "2 1": {"p50": 2 / 3}}}

    monkeypatch.setitem(documents.DOCUMENTS, "views", views)
    words = ["pages", "views", "--quick", "--threads", "2", "1", "--machine", "M", "--note", "N"]
    assert main(words) == 0
    assert efforts == [Effort(True, (1, 2))]
    written = read("views", root)
    assert (written.machine, written.note, written.quick) == ("M", "N", True)
    assert written.environment["instruction_set"] == instruction_set()
    assert written.results["latencies"]["1 1"]["p50"] == 0.3333
    assert "| 1 | 0.50 |" in (root / "README.md").read_text()
    before = (root / "README.md").read_text()
    assert main(["pages"]) == 0
    assert (root / "README.md").read_text() == before
    assert efforts == [Effort(True, (1, 2))]
    assert "views: 1 thread, 2 threads" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["none"], "DOC: expected some of filter, base"),
        (["views", "--threads", "0", "1"], "threads: expected 1, and more if you like, got [0, 1]"),
        (["views", "--threads", "2"], "threads: expected 1, and more if you like, got [2]"),
        ([], "views.json: expected figures of views"),
    ],
)
def test_what_cannot_be_measured_or_written_is_refused(root, monkeypatch, capsys, words, message):
    monkeypatch.chdir(root)
    assert main(["pages", *words]) == 1
    assert message in capsys.readouterr().err


@pytest.mark.slow
def test_the_filter_without_its_timings(root, monkeypatch):
    cases = [Case("tokens", (4, 6), 1), Case("tokens", (4, 6), 1, threads=2), *overhead_cases()]
    plan = Plan({instruction_set(): cases, "scalar": cases}, 0.001, ())
    monkeypatch.setattr(documents, "filter_plan", lambda quick: plan)
    monkeypatch.setattr(documents, "vector_code", lambda: None)
    found = documents.DOCUMENTS["filter"](Effort(False, (1,)), root)
    assert {each["case"]["threads"] for each in found["results"]} == {1}
    assert {each["isa"] for each in found["results"]} == {instruction_set()}
    assert not {"timings", "flops"} & set(found["results"][0])
    assert (root / documents.IMAGES / "filter.png").read_bytes().startswith(b"\x89PNG")


def test_networks_are_measured_at_batch_1_with_the_contenders_that_are_shown(root, monkeypatch):
    small = GlobalFilterNetwork((64, 64), dim=4, depth=1, classes=3)
    monkeypatch.setattr("benchmarks.model.subjects.GlobalFilterNetwork", lambda: small)
    plans = []

    def measure(network, plan_of):
        plans.append(plan_of(subject(GFNET, root)))
        raise RuntimeError(network)

    monkeypatch.setattr(documents.deployment, "measure", measure)
    for name in ("small", "soyuz"):
        with pytest.raises(RuntimeError, match=name):
            documents.DOCUMENTS[name](Effort(False, (2,)), root)
    few, all_ = plans
    assert (few.batches, few.threads, few.starts) == ((1,), (2,), 0)
    assert all_.starts == 3
    assert not {COMPILED, COMPILED_ALONE} & {*few.names, *all_.names}
    assert TORCH_ALONE in few.names
    assert {MATMUL, DFT} & set(all_.names) > {MATMUL, DFT} & set(few.names)
    assert max(few.seconds, all_.seconds) <= documents.NETWORK_SECONDS


def test_attention_is_measured_with_each_number_of_threads(root, monkeypatch):
    measured = []
    monkeypatch.setattr(attention, "measure_all", lambda plan: measured.extend(plan.cases) or [])
    documents.DOCUMENTS["attention"](Effort(False, (1, 2)), root)
    assert [case.threads for case in measured] == [1] * 6 + [2] * 6
    assert measured[6] == NetworkCase(**{**asdict(measured[0]), "threads": 2})


@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
def test_vector_code_is_a_preloaded_library(monkeypatch):
    monkeypatch.setattr(vector_code, "environment", lambda: {"mkl_code": "baseline"})
    monkeypatch.delenv("LD_PRELOAD", raising=False)
    seen = []

    def measure(plan):
        library = Path(os.environ["LD_PRELOAD"])
        seen.append(b"mkl_serv_intel_cpu_true" in library.read_bytes())
        raise RuntimeError("enough")

    monkeypatch.setattr(vector_code, "measure", measure)
    with pytest.raises(RuntimeError, match="enough"):
        vector_code.vector_code()
    assert seen == [True]
    assert "LD_PRELOAD" not in os.environ


@pytest.mark.parametrize("code", ["vectorized", ""])
def test_vector_code_needs_no_help_where_mkl_runs_it_or_is_not(monkeypatch, code):
    monkeypatch.setattr(vector_code, "environment", lambda: {"mkl_code": code})
    assert vector_code.vector_code() is None
