"""The compact residual network: its maps, its blocks' start, what is not built."""

import pytest
import torch

from ffpose.models import build_backbone
from ffpose.models.compact_resnet import REDUCTIONS, WIDTHS, BasicBlock, CompactResNet


@pytest.fixture(autouse=True)
def _seed():
    torch.manual_seed(0)


@pytest.mark.parametrize("name", WIDTHS)
def test_maps_have_the_widths_and_reductions_of_the_name(name):
    maps = build_backbone(name, REDUCTIONS).eval()(torch.randn(1, 3, 32, 48))
    expected = [
        (1, channels, 32 // reduction, 48 // reduction)
        for reduction, channels in zip(REDUCTIONS, WIDTHS[name][1:], strict=True)
    ]
    assert [tuple(each.shape) for each in maps] == expected
    assert build_backbone(name, REDUCTIONS).channels == WIDTHS[name][1:]


def test_a_side_that_is_no_multiple_is_rounded_up():
    (last,) = build_backbone("compact_resnet_narrow", (16,))(torch.randn(2, 3, 33, 50))
    assert last.shape[2:] == (3, 4)


def test_maps_are_asked_for_in_any_order():
    backbone = build_backbone("compact_resnet_narrow", (8, 4, 8)).eval()
    first, second, third = backbone(torch.randn(1, 3, 32, 32))
    assert first is third
    assert second.shape[-1] == 2 * first.shape[-1]


@pytest.mark.parametrize("reduction", REDUCTIONS)
def test_nothing_is_computed_for_nothing(reduction):
    model = CompactResNet((4, 4, 8, 8), reduction)
    model(torch.randn(2, 3, 32, 32))[-1].square().sum().backward()
    assert all(parameter.grad is not None for parameter in model.parameters())


@pytest.mark.parametrize(("channels", "stride"), [(8, 1), (8, 2), (4, 1)])
def test_a_block_begins_as_its_skip_connection(channels, stride):
    block, x = BasicBlock(channels, 8, stride), torch.randn(2, channels, 6, 6)
    torch.testing.assert_close(block(x), block.skip(x).relu())
    assert isinstance(block.skip, torch.nn.Identity) == (channels == 8 and stride == 1)


def test_refused_reductions_and_weights(tmp_path):
    with pytest.raises(ValueError, match=r"gives reductions \(4, 8, 16\), expected \[2\]"):
        build_backbone("compact_resnet_narrow", (2, 8))
    with pytest.raises(
        ValueError, match="expected no pretrained weights for compact_resnet_narrow, got"
    ):
        build_backbone("compact_resnet_narrow", (8,), tmp_path / "weights.safetensors")
