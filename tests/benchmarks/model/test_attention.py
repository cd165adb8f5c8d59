"""The benchmark of networks with ours and torch's attention, on one that takes no time."""

import json
import re
from dataclasses import replace

import pytest
import torch
from torch import nn

from benchmarks.__main__ import main
from benchmarks.model import attention as bench
from benchmarks.model.attention import NetworkPlan, NetworkResult
from benchmarks.model.networks import (
    BEFORE,
    FFT,
    PRECISIONS,
    SDPA,
    TASKS,
    BuiltInAttention,
    NetworkCase,
    PlainAttention,
    TorchFftFilter,
    contender,
    networks,
    random_images,
    with_attention,
)
from benchmarks.timing import Timing
from ffpose.bench.filter import OURS
from ffpose.config import CONFIGS, PRESETS
from ffpose.nn import SpectralFilter
from ffpose.nn.attention import SelfAttention


@pytest.fixture(autouse=True)
def _speck(monkeypatch):
    """A network so small that its images take a millisecond."""
    fields = {"dim": 8, "depth": 1, "heads": 2, "feed_forward": 8, "head_hidden": 8}
    fields |= {"backbone": "test_efficientnet", "image_size": (32, 48)}
    monkeypatch.setitem(CONFIGS, "speck", replace(CONFIGS["tiny"], **fields))
    monkeypatch.setitem(PRESETS, "speck", CONFIGS["speck"])


@pytest.mark.slow
def test_run_prints_tables_or_a_document(monkeypatch, capsys):
    cases = [NetworkCase("speck", 2, task, kind) for task in TASKS for kind in PRECISIONS]
    cases.append(NetworkCase("speck", 1, threads=2))
    monkeypatch.setattr(bench, "make_plan", lambda quick: NetworkPlan(cases, 0.001, ("a note",)))
    before = torch.get_num_threads()
    assert main(["attention", "--quick", "--json"]) == 0
    assert torch.get_num_threads() == before
    document = json.loads(capsys.readouterr().out)
    assert document["notes"] == ["a note"]
    assert document["environment"]["torch"] == torch.__version__
    assert [NetworkCase(**each["case"]) for each in document["results"]] == cases
    for each in document["results"]:
        medians = {name: timing["median"] for name, timing in each["timings"].items()}
        for name in (BEFORE, SDPA, FFT):
            assert each["ratio"][name] == pytest.approx(medians[name] / medians[OURS])
        assert each["images_per_second"] == pytest.approx(each["case"]["batch"] / medians[OURS])
        assert each["largest_difference"] < 1e-5
    assert main(["attention", "--quick"]) == 0
    printed = capsys.readouterr().out
    assert re.findall(r"(\d threads?): ffpose", printed) == ["1 thread", "2 threads"]
    assert "a note" in printed


def test_a_ratio_by_hand():
    timings = {OURS: Timing(0.5, 0.4, 0.6, 5, 1), BEFORE: Timing(2.0, 1.0, 3.0, 5, 1)}
    timings[SDPA] = Timing(1.5, 1.0, 2.0, 5, 1)
    timings[FFT] = Timing(1.0, 1.0, 1.0, 5, 1)
    result = NetworkResult(NetworkCase("speck", 8), timings, 0.0)
    assert (result.ratios, result.images_per_second) == ({BEFORE: 4.0, SDPA: 3.0, FFT: 2.0}, 16.0)


@pytest.mark.parametrize("filter", ["tokens", "grid"])
def test_contenders_differ_in_attention_or_filter_alone(filter):
    models = networks("speck", filter)
    layers = {SelfAttention, BuiltInAttention, PlainAttention, SpectralFilter, TorchFftFilter}
    assert {
        name: {type(each) for each in model.modules()} & layers for name, model in models.items()
    } == {
        OURS: {SelfAttention, SpectralFilter},
        BEFORE: {BuiltInAttention, SpectralFilter},
        SDPA: {PlainAttention, SpectralFilter},
        FFT: {SelfAttention, TorchFftFilter},
    }
    ours, *others = (model.state_dict() for model in models.values())
    for theirs in others:
        assert ours.keys() == theirs.keys()
        assert all(torch.equal(value, theirs[name]) for name, value in ours.items())


def test_plain_attention_drops_as_torch_does(monkeypatch):
    """In training its dropout is torch's, of the rate of the layer whose place it takes."""
    rates = []
    torchs = nn.functional.scaled_dot_product_attention

    def attend(*args, dropout_p):
        rates.append(dropout_p)
        return torchs(*args, dropout_p=dropout_p)

    monkeypatch.setattr("benchmarks.model.networks.scaled_dot_product_attention", attend)
    plain = PlainAttention(nn.MultiheadAttention(8, 2, dropout=0.25, batch_first=True), 1)
    x = torch.randn(2, 5, 8)
    assert plain.train()(x).shape == (2, 1, 8)
    expected = plain.attention.eval()(x[:, :1], x, x, need_weights=False)[0]
    torch.testing.assert_close(plain.eval()(x), expected)
    assert rates == [0.25, 0.0]


@pytest.mark.parametrize("kind", [BuiltInAttention, PlainAttention])
def test_attention_that_takes_the_place_of_ours_is_in_its_mode(kind):
    """In evaluation nothing is dropped: a call gives what the call before it gave."""
    model = with_attention(networks("speck")[OURS].eval(), kind)
    assert not any(module.training for module in model.modules())


@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_training_step_moves_every_weight_and_inference_none(precision):
    for model in networks("speck").values():
        images = random_images(model, 2)
        before = {name: value.clone() for name, value in model.named_parameters()}
        contender(model, images, NetworkCase("speck", 2, "inference", precision)).call()
        assert all(torch.equal(value, before[name]) for name, value in model.named_parameters())
        contender(model, images, NetworkCase("speck", 2, "training step", precision)).call()
        same = [name for name, each in model.named_parameters() if torch.equal(each, before[name])]
        assert not same


def test_a_contender_that_computes_something_else_is_refused(monkeypatch):
    monkeypatch.setattr(BuiltInAttention, "forward", lambda self, x: nn.functional.relu(x))
    with pytest.raises(RuntimeError, match=r"nn\.MultiheadAttention differ from ffpose's by"):
        bench.measure(NetworkCase("speck", 1), 0.001)


def test_the_whole_plan_and_the_quick_one(monkeypatch):
    monkeypatch.setattr(bench, "cores", lambda: 2)
    cases = bench.make_plan(quick=False).cases
    assert len(set(cases)) == len(cases) == 3 * 2 * 2 * 2 * 2 + 2
    assert set(bench.make_plan(quick=True).cases) < set(cases)
    monkeypatch.setattr(bench, "cores", lambda: 1)
    alone = bench.make_plan(quick=False)
    assert {case.threads for case in alone.cases} == {1}
    assert "one core: two threads are not measured" in alone.notes
