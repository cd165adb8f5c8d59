"""``ffpose bench filter``, on sizes that take no time."""

import json

import pytest
import torch

from ffpose.bench import filter as bench
from ffpose.bench.filter import DIMS, DIMS_FIRST, Result, our_filter, torch_filter
from ffpose.bench.timing import OURS, percentiles
from ffpose.cli import main

SMALL = (("grid", (4, 6, 3)), ("tokens", (4, 6)), ("sequence", (6, 2)))


@pytest.fixture(autouse=True)
def _small(monkeypatch):
    monkeypatch.setattr(bench, "FEW", SMALL)
    monkeypatch.setattr(bench, "BATCHES", (1, 2))


@pytest.mark.parametrize(("kind", "size"), SMALL)
def test_both_filters_compute_the_same(kind, size):
    x = torch.randn(2, *size, generator=torch.Generator().manual_seed(1))
    spectrum = list(size)
    spectrum[DIMS[kind][-1]] = size[DIMS[kind][-1]] // 2 + 1
    weight = torch.randn(*spectrum, 2, generator=torch.Generator().manual_seed(2))
    ours = our_filter(kind)(x, weight)
    torch.testing.assert_close(ours, torch_filter(DIMS[kind])(x, weight))
    if kind != "tokens":
        first = torch_filter(DIMS_FIRST[kind])(x.movedim(-1, 1), weight.movedim(-2, 0))
        torch.testing.assert_close(ours, first.movedim(1, -1))


def test_the_weight_of_a_network_in_channels_last_may_have_that_layout():
    weight = torch.randn(4, 4, 3, 2, generator=torch.Generator().manual_seed(1))
    x = torch.randn(2, 4, 6, 3, generator=torch.Generator().manual_seed(2))
    strided = weight.contiguous(memory_format=torch.channels_last)
    assert strided.stride(-1) != 1
    theirs = torch_filter(DIMS["grid"])
    torch.testing.assert_close(theirs(x, strided), theirs(x, weight))


def test_a_document_a_table_and_a_plot(tmp_path, capsys):
    plot = tmp_path / "filter.png"
    assert main(["bench", "filter", "--quick", "--json", "--plot", str(plot)]) == 0
    document = json.loads(capsys.readouterr().out)
    assert len(document["results"]) == len(SMALL) * 2 * 2
    assert {each["threads"] for each in document["results"]} == {1}
    assert plot.read_bytes().startswith(b"\x89PNG")
    assert main(["bench", "filter", "--quick"]) == 0
    assert "times as fast as torch.fft" in capsys.readouterr().out


def test_ratios_are_to_the_fastest_rival():
    seconds = {OURS: 2.0, bench.LAST: 8.0, bench.FIRST: 6.0}
    latencies = {name: percentiles([value]) for name, value in seconds.items()}
    result = Result("grid", (4, 6, 3), 1, "forward", 1, latencies)
    assert result.ratio(bench.LAST) == 4.0
    assert result.ratio(bench.LAST, bench.FIRST) == 3.0


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["filter", "base"], 2, "network: expected with model, got base with filter"),
        (["filter", "--batch", "1"], 2, "batch: expected with model"),
        (["filter", "--plot", "absent/a.png"], 1, "expected an existing folder"),
    ],
)
def test_what_cannot_be_measured_is_refused(words, code, message, capsys):
    assert main(["bench", *words]) == code
    assert message in capsys.readouterr().err
