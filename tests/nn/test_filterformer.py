"""Block and encoder: what acts on what, by laws that hold for any weights."""

import pytest
import torch
from torch import nn

from ffpose.nn import FILTERS, Filterformer, FilterformerBlock, SpectralFilter, make_filter

GRID, DIM = (3, 4), 8


@pytest.fixture(autouse=True)
def _seed():
    torch.manual_seed(0)


def encoder(**options):
    defaults = {"depth": 2, "heads": 2, "hidden": 16, "filter": "grid", "extra_tokens": 1}
    return Filterformer(GRID, DIM, **(defaults | options)).eval()


@pytest.mark.parametrize("filter", FILTERS)
@pytest.mark.parametrize("norm", ["pre", "post"])
@pytest.mark.parametrize("extra_tokens", [0, 1])
def test_shape_and_gradients_for_every_choice(filter, norm, extra_tokens):
    model = encoder(filter=filter, norm=norm, extra_tokens=extra_tokens).train()
    x = torch.randn(2, extra_tokens + 12, DIM)
    y = model(x)
    assert y.shape == x.shape
    y.square().mean().backward()
    assert all(parameter.grad is not None for parameter in model.parameters())
    assert any(isinstance(module, SpectralFilter) for module in model.modules()) == (
        filter != "none"
    )


def test_filters_of_both_layouts_by_torch_fft():
    x = torch.randn(2, 12, DIM)
    tokens, grid = make_filter("tokens", GRID, DIM), make_filter("grid", GRID, DIM)
    weight = torch.view_as_complex(tokens.weight)
    expected = torch.fft.irfft2(torch.fft.rfft2(x) * weight, s=(12, DIM))
    torch.testing.assert_close(tokens(x), expected)
    weight = torch.view_as_complex(grid[1].weight)
    spectrum = torch.fft.rfft2(x.view(2, 3, 4, DIM), dim=(1, 2)) * weight
    expected = torch.fft.irfft2(spectrum, s=GRID, dim=(1, 2)).reshape(x.shape)
    torch.testing.assert_close(grid(x), expected)


def test_block_is_three_residual_sublayers():
    block = FilterformerBlock(DIM, SpectralFilter((12, DIM)), heads=2, dropout=0.5).eval()
    x = torch.randn(2, 12, DIM)
    expected = x
    expected = expected + block.filter.sublayer(block.filter.norm(expected))
    normed = block.attention.norm(expected)
    attention = block.attention.sublayer.attention
    expected = expected + attention(normed, normed, normed, need_weights=False)[0]
    normed = block.feed_forward.norm(expected)
    expected = expected + block.feed_forward.sublayer(normed)
    torch.testing.assert_close(block(x), expected)


def test_pose_token_stays_out_of_the_filter():
    class Erase(nn.Module):
        def forward(self, x):
            seen.append(x.shape)
            return torch.zeros_like(x)

    seen = []
    block = FilterformerBlock(DIM, Erase(), heads=2, extra_tokens=1).eval()
    without = FilterformerBlock(DIM, None, heads=2, extra_tokens=1).eval()
    without.load_state_dict(block.state_dict(), strict=False)
    x = torch.randn(2, 13, DIM)
    torch.testing.assert_close(block(x), without(x))
    assert seen == [(2, 12, DIM)]


def test_without_filter_the_order_of_tokens_means_nothing():
    x, order = torch.randn(2, 13, DIM), torch.randperm(13)
    plain = encoder(filter="none")
    torch.testing.assert_close(plain(x[:, order]), plain(x)[:, order])
    filtered = encoder(filter="grid")
    assert not torch.allclose(filtered(x[:, order]), filtered(x)[:, order])


@pytest.mark.parametrize("filter", FILTERS)
@pytest.mark.parametrize("norm", ["pre", "post"])
@pytest.mark.parametrize("depth", [1, 2])
def test_outputs_are_the_leading_tokens_of_all_and_so_are_their_gradients(filter, norm, depth):
    whole = encoder(filter=filter, norm=norm, depth=depth).double()
    leading = encoder(filter=filter, norm=norm, depth=depth, outputs=2).double()
    leading.load_state_dict(whole.state_dict())
    x = torch.randn(3, 13, DIM, dtype=torch.float64)
    results = []
    for model, part in ((whole, slice(2)), (leading, slice(None))):
        entry = x.clone().requires_grad_()
        tokens = model(entry)[:, part]
        tokens.square().sum().backward()
        results.append([tokens, entry.grad, *(p.grad for p in model.parameters())])
    for expected, got in zip(*results, strict=True):
        torch.testing.assert_close(got, expected, rtol=1e-10, atol=1e-12)


def test_images_do_not_mix():
    model, x = encoder(filter="tokens"), torch.randn(3, 13, DIM)
    torch.testing.assert_close(model(x)[1:2], model(x[1:2]))


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"filter": "fourier"}, r"filter: expected one of .*'tokens', 'grid', 'none'.*'fourier'"),
        ({"norm": "both"}, r"norm: expected one of .*'pre', 'post'.*'both'"),
        ({"heads": 3}, "heads: expected a divisor of dim 8, got 3"),
        ({"outputs": 14}, r"outputs: expected None, or 1 to 13 .* \(it is 2\), got 14"),
        ({"outputs": 1, "depth": 0}, r"outputs: expected None, .* \(it is 0\), got 1"),
    ],
)
def test_wrong_construction(options, text):
    with pytest.raises(ValueError, match=text):
        encoder(**options)


@pytest.mark.parametrize("shape", [(2, 12, DIM), (2, 13, 7), (13, DIM)])
def test_wrong_input(shape):
    with pytest.raises(ValueError, match=r"x: expected shape \(B, 13, 8\), got"):
        encoder()(torch.zeros(shape))
