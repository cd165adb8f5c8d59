import pytest

from benchmarks.filter import cases as bench
from benchmarks.filter.cases import CHANNELS_FIRST, COMPILED, COPY, HALF, SCIPY, Case
from ffpose.arrays import instruction_set


def test_the_whole_table(monkeypatch):
    monkeypatch.delenv("FFPOSE_ISA", raising=False)
    monkeypatch.setattr(bench, "instruction_set", lambda: "avx512")
    monkeypatch.setattr(bench, "cores", lambda: 2)
    made = bench.make_plan(quick=False)
    assert list(made.cases) == ["avx512", "avx2", "scalar"]
    one_thread = [case for case in made.cases["avx512"] if case.threads == 1]
    assert len({(case.kind, case.size) for case in one_thread}) == 42 + 1
    assert {case.batch for case in one_thread if case.group == "tokens"} == {1, 8, 32}
    assert {case.batch for case in one_thread if case.group == "few tokens"} == {64}
    assert {case.threads for case in made.cases["avx512"]} == {1, 2}
    assert all(len(set(cases)) == len(cases) for cases in made.cases.values())


@pytest.mark.parametrize(("cores", "threads"), [(1, {1}), (2, {1, 2}), (16, {1, 2, 16})])
def test_two_threads_are_measured_and_as_many_as_there_are_cores(monkeypatch, cores, threads):
    monkeypatch.setattr(bench, "cores", lambda: cores)
    cases = bench.make_plan(quick=False).cases[instruction_set()]
    assert {case.threads for case in cases} == threads
    assert len({case.label for case in cases if case.threads == max(threads)}) > 50


def test_a_forced_instruction_set_is_the_only_one(monkeypatch):
    monkeypatch.setenv("FFPOSE_ISA", instruction_set())
    assert list(bench.make_plan(quick=False).cases) == [instruction_set()]


def test_who_takes_part():
    (largest, other) = bench.with_rivals(
        [Case("grid", (28, 28, 256), 32), Case("sequence", (50, 64), 1)],
        frozenset((SCIPY, COMPILED)),
    )
    assert {HALF, COPY} <= set(largest.contenders)
    assert SCIPY not in largest.contenders
    assert {SCIPY, COMPILED} <= set(other.contenders)


def test_every_grid_and_sequence_has_a_rival_with_its_channels_first():
    made = bench.make_plan(quick=False)
    with_channels = [
        case
        for cases in made.cases.values()
        for case in cases
        if case.kind != "tokens" and case.size != bench.OVERHEAD_SIZE
    ]
    assert with_channels
    assert all(CHANNELS_FIRST in case.contenders for case in with_channels)


def test_without_a_compiler_or_scipy_it_says_so(monkeypatch):
    monkeypatch.setenv("CXX", "a-compiler-that-there-is-not")
    monkeypatch.setattr(bench.importlib.util, "find_spec", lambda name: None)
    rivals, notes = bench.available_rivals(quick=False)
    assert not {COMPILED, SCIPY} & rivals
    assert any("C++ compiler" in note for note in notes)
    assert any("SciPy is not installed" in note for note in notes)
