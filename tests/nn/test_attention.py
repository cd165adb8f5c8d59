"""Self-attention against torch's module, and its dropout by laws that hold for any draw."""

import pytest
import torch
from torch import nn
from torch.nn.functional import scaled_dot_product_attention

from ffpose.nn import attention
from ffpose.nn.attention import SelfAttention, dropout_attention


@pytest.fixture(autouse=True)
def _seed():
    torch.manual_seed(0)


def attentions(dim=24, heads=3, dropout=0.0):
    """Ours and torch's from the same seed, ours under the name that its files give it."""
    torch.manual_seed(1)
    theirs = nn.MultiheadAttention(dim, heads, dropout=dropout, batch_first=True)
    torch.manual_seed(1)
    return SelfAttention(dim, heads, dropout), theirs


def test_attention_starts_as_torchs_and_has_its_names():
    ours, theirs = attentions()
    expected = {f"attention.{name}": value for name, value in theirs.state_dict().items()}
    assert ours.state_dict().keys() == expected.keys()
    assert all(torch.equal(value, expected[name]) for name, value in ours.state_dict().items())


@pytest.mark.parametrize("training", [False, True])
@pytest.mark.parametrize("shape", [(1, 1, 24), (2, 50, 24), (3, 197, 24)])
def test_attention_gives_torchs_numbers_and_gradients(shape, training):
    ours, theirs = (module.train(training) for module in attentions())
    for bias in (theirs.in_proj_bias, theirs.out_proj.bias):  # they start at zero
        nn.init.normal_(bias)
    ours.attention.load_state_dict(theirs.state_dict())
    x = torch.randn(shape, requires_grad=True)
    found = []
    for y, module in ((ours(x), ours), (theirs(x, x, x, need_weights=False)[0], theirs)):
        found.append((y, *torch.autograd.grad(y.square().sum(), (x, *module.parameters()))))
    for got, wanted in zip(*found, strict=True):
        torch.testing.assert_close(got, wanted, rtol=0, atol=2e-6 * wanted.abs().max().item())


def test_attention_drops_its_weights_in_training_alone():
    ours, theirs = attentions(dropout=0.5)
    x = torch.randn(1, 5, 24)
    expected = theirs.eval()(x, x, x)[0]
    torch.testing.assert_close(ours.eval()(x), expected)
    with torch.no_grad():
        drawn = torch.cat([ours.train()(x) for _ in range(2000)])
    assert not torch.allclose(drawn[0], drawn[1])
    # The result is linear in the weights, so that its mean is the result without dropout.
    error = (drawn.mean(0) - expected[0]) / (drawn.std(0) / len(drawn) ** 0.5)
    assert error.abs().max() < 5


@pytest.mark.parametrize("autocast", [False, True])
def test_attention_in_bfloat16(autocast):
    ours, theirs = attentions()
    x = torch.randn(2, 50, 24)
    expected = theirs.eval()(x, x, x)[0]
    ours = ours.eval() if autocast else ours.eval().bfloat16()
    with torch.autocast("cpu", torch.bfloat16, enabled=autocast):
        got = ours(x if autocast else x.bfloat16())
    assert got.dtype == torch.bfloat16
    assert (got.float() - expected).abs().max() < 2**-6 * expected.abs().max()


@pytest.fixture(params=[1, 200, 1 << 19])
def block(request, monkeypatch):
    """Blocks of one head, of a few, and of all."""
    monkeypatch.setattr(attention, "BLOCK", request.param)


def heads(batch=2, count=3, queries=7, keys=9, dtype=torch.float64):
    shapes = [(queries, 4), (keys, 4), (keys, keys)]
    query, key, _ = (torch.randn(batch, count, *shape, dtype=dtype) for shape in shapes)
    return query, key, torch.eye(keys, dtype=dtype).expand(batch, count, keys, keys)


def weights_of(query, key):
    return (query @ key.mT / query.shape[-1] ** 0.5).softmax(-1)


@pytest.mark.usefixtures("block")
@pytest.mark.parametrize("rate", [0.1, 0.5, 0.9])
def test_each_weight_is_dropped_or_grows(rate):
    query, key, identity = heads(keys=40)
    ratios = dropout_attention(query, key, identity, rate) / weights_of(query, key)
    kept = ratios > 0
    torch.testing.assert_close(
        ratios[kept], torch.full_like(ratios[kept], 1 / (1 - rate)), rtol=1e-4, atol=0
    )
    assert (ratios[~kept] == 0).all()
    deviation = (rate * (1 - rate) / kept.numel()) ** 0.5
    assert abs((~kept).double().mean().item() - rate) < 5 * deviation


def test_weights_are_dropped_one_without_another():
    """The four pieces of a random number, neighbors, rows and heads: pairs as often as chance."""
    query, key, identity = heads(batch=8, count=8, queries=64, keys=64, dtype=torch.float32)
    dropped = (dropout_attention(query, key, identity, 0.5) == 0).float() - 0.5
    flat = dropped.flatten()
    for distance in (1, 2, 3, 4, 64, 64 * 64, 64 * 64 * 8):
        pairs = flat[distance:] * flat[:-distance]
        assert abs(pairs.mean().item()) < 5 * 0.25 / len(pairs) ** 0.5
    assert abs(dropped.view(-1, 4).mean(0)).max() < 5 * 0.5 / (len(flat) / 4) ** 0.5


@pytest.mark.usefixtures("block")
def test_without_drops_it_is_torchs():
    query, key, value = (torch.randn(2, 3, n, 4, dtype=torch.float64) for n in (7, 9, 9))
    expected = scaled_dot_product_attention(query, key, value)
    torch.testing.assert_close(dropout_attention(query, key, value, 0.0), expected)


@pytest.mark.usefixtures("block")
@pytest.mark.parametrize("rate", [0.0, 0.3])
def test_gradients_are_the_difference_quotients(rate):
    def drawn(*heads):
        torch.manual_seed(3)
        return dropout_attention(*heads, rate)

    shapes = [(5, 4), (6, 4), (6, 3)]
    inputs = [torch.randn(2, 3, *s, dtype=torch.float64, requires_grad=True) for s in shapes]
    assert torch.autograd.gradcheck(drawn, inputs)


def test_no_images():
    query, key, value = (torch.randn(0, 3, 7, 4, requires_grad=True) for _ in range(3))
    result = dropout_attention(query, key, value, 0.5)
    result.sum().backward()
    assert result.shape == query.grad.shape == (0, 3, 7, 4)


@pytest.mark.parametrize("rate", [1.0, -0.1, 1 - 1e-6, float("nan")])
def test_a_rate_that_drops_all_or_none_is_refused(rate):
    with pytest.raises(ValueError, match=rf"rate: expected .* less than 1, got {rate}"):
        dropout_attention(*heads(), rate)


def test_training_with_dropout_writes_no_scores_of_all_heads():
    model = SelfAttention(32, 4, 0.1)
    x = torch.randn(2, 256, 32)
    saved = []
    with torch.autograd.graph.saved_tensors_hooks(lambda t: saved.append(t) or t, lambda t: t):
        model(x)
    scores = [t for t in saved if t.numel() >= 2 * 4 * 256 * 256]
    assert {t.dtype for t in scores} == {torch.bool}


def gradients(model, x):
    model.zero_grad()
    model(x).float().square().sum().backward()
    return [p.grad for p in model.parameters()]


@pytest.mark.parametrize("way", ["autocast", "throughout"])
def test_half_precision_is_computed_in_float32(way):
    model, x = SelfAttention(24, 3, 0.1), torch.randn(2, 50, 24)
    torch.manual_seed(2)
    expected = gradients(model, x)
    torch.manual_seed(2)
    if way == "autocast":
        with torch.autocast("cpu", torch.bfloat16):
            got = gradients(model, x)
    else:
        got = gradients(model.bfloat16(), x.bfloat16())
    for each, wanted in zip(got, expected, strict=True):
        assert (each - wanted).abs().max() < 2**-5 * wanted.abs().max()


def test_functional_transforms_take_torchs_attention():
    """The loss of no drops, as of a rate that drops nearly nothing."""
    model, x = SelfAttention(24, 3, 1e-9), torch.randn(2, 50, 24)

    def loss(parameters):
        return torch.func.functional_call(model, parameters, x).square().sum()

    found = torch.func.grad(loss)(dict(model.named_parameters()))
    expected = gradients(model.eval(), x)
    for each, wanted in zip(found.values(), expected, strict=True):
        torch.testing.assert_close(each, wanted)


def test_the_default_device_is_not_the_querys():
    inputs = heads()
    with torch.device("meta"):
        assert dropout_attention(*inputs, 0.5).device.type == "cpu"


def test_compiled_training_is_torchs():
    model, x = SelfAttention(24, 3, 0.1), torch.randn(2, 50, 24)
    found = gradients(torch.compile(model, fullgraph=True, backend="aot_eager"), x)
    assert all(gradient.isfinite().all() for gradient in found)
