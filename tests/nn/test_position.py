"""Position codes: learned or sinusoidal, half for the row, half for the column."""

import math

import pytest
import torch

from ffpose.nn import PositionCode


@pytest.mark.parametrize("kind", ["learned", "sinusoidal"])
def test_a_code_is_its_rows_and_its_columns_half(kind):
    code = PositionCode((3, 5), 8, kind)(torch.zeros(2, 15, 8))[0].detach().view(3, 5, 8)
    assert (code[:, :1, :4] == code[..., :4]).all()
    assert (code[:1, :, 4:] == code[..., 4:]).all()
    assert len(torch.unique(code.flatten(0, 1), dim=0)) == 15


def test_sinusoidal_numbers_by_hand():
    code = PositionCode((4, 2), 8, "sinusoidal")(torch.zeros(1, 8, 8))[0].view(4, 2, 8)
    expected = [math.sin(3), math.sin(3 / 100), math.cos(3), math.cos(3 / 100)]
    torch.testing.assert_close(code[3, 0, :4], torch.tensor(expected))


def test_learned_code_is_trained_and_saved_sinusoids_are_neither():
    assert set(PositionCode((3, 5), 8).state_dict()) == {"rows", "columns"}
    sinusoidal = PositionCode((3, 5), 8, "sinusoidal")
    assert not sinusoidal.state_dict()
    assert not list(sinusoidal.parameters())


@pytest.mark.parametrize(
    ("dim", "kind", "text"),
    [
        (8, "rotary", r"'learned', 'sinusoidal'.*'rotary'"),
        (7, "learned", "dim: expected a multiple of 2 for the learned code, got 7"),
        (6, "sinusoidal", "dim: expected a multiple of 4 for the sinusoidal code, got 6"),
    ],
)
def test_wrong_construction(dim, kind, text):
    with pytest.raises(ValueError, match=text):
        PositionCode((3, 5), dim, kind)


def test_tokens_of_another_grid():
    with pytest.raises(ValueError, match=r"expected shape \(B, 15, 8\), got \(2, 14, 8\)"):
        PositionCode((3, 5), 8)(torch.zeros(2, 14, 8))
