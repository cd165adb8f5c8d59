import json

import numpy as np
import pytest
import torch
from scipy import fft

from ffpose.bench import filter as bench


def test_the_rival_is_the_filter_of_the_paper():
    generator = np.random.default_rng(1)
    x = generator.standard_normal((2, 6, 8))
    weight = generator.standard_normal((6, 5, 2))
    expected = fft.irfft2(fft.rfft2(x) * (weight[..., 0] + 1j * weight[..., 1]), s=(6, 8))
    got = bench.torch_fft_filter(torch.from_numpy(x), torch.from_numpy(weight), "tokens")
    np.testing.assert_allclose(got.numpy(), expected, atol=1e-12)


@pytest.mark.parametrize("backward", [False, True])
@pytest.mark.parametrize(("layout", "size"), [("tokens", (6, 8)), ("grid", (4, 6, 3))])
def test_both_sides_of_a_measurement_compute_the_same(layout, size, backward):
    threads = torch.get_num_threads()
    result = bench.measure(bench.Case(layout, size, 2, backward, 1), seconds=0.001)
    assert result.largest_difference < 1e-5
    assert result.ratio == result.torch_fft.median / result.ffpose.median
    assert torch.get_num_threads() == threads


def test_geometric_mean_by_hand():
    assert bench.geometric_mean([1.0, 2.0, 4.0]) == pytest.approx(2.0)


def test_run_writes_a_document_and_a_picture(tmp_path, monkeypatch, capsys):
    todo = [bench.Case("tokens", (4, 6), 1, backward, 1) for backward in (False, True)]
    monkeypatch.setattr(bench, "cases", lambda quick: todo)
    bench.run(tmp_path / "filter.json", tmp_path / "filter.png", quick=True)
    document = json.loads((tmp_path / "filter.json").read_text())
    assert [entry["case"]["backward"] for entry in document["results"]] == [False, True]
    assert set(document["geometric_mean_ratio"]) == {
        "tokens, forward, 1 thread",
        "tokens, forward+backward, 1 thread",
    }
    assert document["environment"]["torch"] == torch.__version__
    assert (tmp_path / "filter.png").read_bytes().startswith(b"\x89PNG")
    assert "geometric mean" in capsys.readouterr().out


def test_a_missing_folder_is_found_before_the_work(tmp_path, monkeypatch):
    monkeypatch.setattr(bench, "measure", lambda *_: pytest.fail("measured first"))
    with pytest.raises(FileNotFoundError, match="expected an existing folder"):
        bench.run(json_path=tmp_path / "absent" / "filter.json")
