"""``ffpose bench filter``, on sizes that take no time."""

import json
from itertools import product

import pytest
import torch

from ffpose.bench import filter as bench
from ffpose.bench.filter import DIMS, FIRST, LAST, OURS, our_filter, torch_filter
from ffpose.bench.timing import percentiles
from ffpose.cli import main

SMALL = {"grid": ((4, 6, 3), (2, 2, 1)), "tokens": ((4, 6),), "sequence": ((6, 2),)}


@pytest.fixture(autouse=True)
def _small(monkeypatch):
    monkeypatch.setattr(bench, "SIZES", SMALL)
    monkeypatch.setattr(bench, "BATCHES", (1, 2))


@pytest.mark.parametrize("kind", SMALL)
def test_both_filters_compute_the_same(kind):
    (size, *_), dim = SMALL[kind], DIMS[kind]
    x = torch.randn(2, *size, generator=torch.Generator().manual_seed(1))
    spectrum = list(size)
    spectrum[dim[-1]] = size[dim[-1]] // 2 + 1
    weight = torch.randn(*spectrum, 2, generator=torch.Generator().manual_seed(2))
    ours = our_filter(x, weight, kind)
    torch.testing.assert_close(ours, torch_filter(x, weight, dim))
    if kind != "tokens":
        further = [place + 1 for place in dim]
        first = torch_filter(x.movedim(-1, 1), weight.movedim(-2, 0), further)
        torch.testing.assert_close(ours, first.movedim(1, -1))


def test_the_weight_of_a_network_in_channels_last_may_have_that_layout():
    weight = torch.randn(4, 4, 3, 2, generator=torch.Generator().manual_seed(1))
    x = torch.randn(2, 4, 6, 3, generator=torch.Generator().manual_seed(2))
    strided = weight.contiguous(memory_format=torch.channels_last)
    assert strided.stride(-1) != 1
    theirs = torch_filter(x, strided, DIMS["grid"])
    torch.testing.assert_close(theirs, torch_filter(x, weight, DIMS["grid"]))


@pytest.mark.slow
def test_a_document_a_table_and_a_plot(tmp_path, capsys):
    plot = tmp_path / "filter.png"
    assert main(["bench", "filter", "--quick", "--json", "--plot", str(plot)]) == 0
    document = json.loads(capsys.readouterr().out)
    assert {"environment", "ratio", "results"} == set(document)
    assert [tuple(each["size"]) for each in document["results"][::4]] == [
        sizes[0] for sizes in SMALL.values()
    ]
    cases = [(each["batch"], each["work"], each["threads"]) for each in document["results"]]
    assert cases == 3 * list(product((1, 2), ("forward", "forward+backward"), (1,)))
    assert plot.read_bytes().startswith(b"\x89PNG")
    assert main(["bench", "filter", "--quick"]) == 0
    assert "times as fast as torch.fft" in capsys.readouterr().out


def test_ratios_are_to_the_fastest_rival(monkeypatch, capsys):
    seconds = {OURS: 2.0, LAST: 8.0, FIRST: 6.0}
    monkeypatch.setattr(
        bench, "take_turns", lambda calls, _: {name: percentiles([seconds[name]]) for name in calls}
    )
    assert main(["bench", "filter", "--quick", "--json"]) == 0
    for last, best in json.loads(capsys.readouterr().out)["ratio"].values():
        assert last == pytest.approx(4.0)
        assert best == pytest.approx((3.0 * 4.0 * 3.0) ** (1 / 3))  # tokens have one layout


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
