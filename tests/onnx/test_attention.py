"""Attention becomes one operator of ONNX Runtime, or standard ones; what it cannot do, torch's."""

import onnxruntime
import pytest
import torch
from torch import nn
from torch.nn.functional import scaled_dot_product_attention

import ffpose.onnx
import onnx
from ffpose.nn import Filterformer


class Attention(nn.Module):
    """Attention of tokens (B, N, 24), with three heads and what else is asked of it."""

    def __init__(self, **options):
        super().__init__()
        self.options = options

    def forward(self, x):
        heads = x.unflatten(-1, (3, -1)).transpose(1, 2)
        mixed = scaled_dot_product_attention(heads, heads.flip(2), heads.cos(), **self.options)
        return mixed.transpose(1, 2).flatten(2)


def operators(path):
    return {(node.domain, node.op_type) for node in onnx.load(path).graph.node}


def computed(path, x):
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    (y,) = session.run(None, {session.get_inputs()[0].name: x.numpy()})
    return torch.from_numpy(y)


FUSED = ("com.microsoft", "MultiHeadAttention")


@pytest.mark.parametrize(("filter", "fused"), [("custom", True), ("matmul", False)])
@pytest.mark.parametrize("scale", [None, 0.3])
def test_both_ways_give_torchs_numbers(tmp_path, filter, fused, scale):
    module, path = Attention(scale=scale).eval(), tmp_path / "attention.onnx"
    ffpose.onnx.export(module, [torch.randn(2, 10, 24)], path, filter)
    assert (FUSED in operators(path)) == fused
    assert fused or {domain for domain, _ in operators(path)} == {""}
    x = torch.randn(3, 10, 24)
    torch.testing.assert_close(computed(path, x), module(x), rtol=1e-5, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "dtype"),
    [
        ({"attn_mask": torch.ones(10, 10, dtype=torch.bool).tril()}, torch.float32),
        ({"is_causal": True}, torch.float32),
        ({}, torch.float64),
    ],
)
def test_what_the_operator_cannot_do_stays_torchs(tmp_path, options, dtype):
    module, path = Attention(**options).eval(), tmp_path / "attention.onnx"
    ffpose.onnx.export(module, [torch.randn(2, 10, 24, dtype=dtype)], path)
    assert FUSED not in operators(path)
    x = torch.randn(3, 10, 24, dtype=dtype)
    torch.testing.assert_close(computed(path, x), module(x), rtol=1e-5, atol=1e-6)


class OneKey(nn.Module):
    """Attention of three heads to the keys of one, tokens (B, N, 24)."""

    def forward(self, x):
        heads = x.unflatten(-1, (3, -1)).transpose(1, 2)
        return scaled_dot_product_attention(heads, heads[:, :1].flip(2), heads[:, :1].cos())


def test_keys_of_one_head_for_all_queries_stay_torchs(tmp_path):
    path, x = tmp_path / "attention.onnx", torch.randn(3, 10, 24)
    ffpose.onnx.export(OneKey().eval(), [torch.randn(2, 10, 24)], path)
    assert FUSED not in operators(path)
    torch.testing.assert_close(computed(path, x), OneKey()(x), rtol=1e-5, atol=1e-6)


@pytest.mark.slow
def test_every_block_has_one_and_the_last_has_one_query(tmp_path):
    encoder = Filterformer((3, 4), 8, depth=3, heads=2, filter="none", extra_tokens=1, outputs=1)
    path = tmp_path / "encoder.onnx"
    ffpose.onnx.export(encoder.eval(), [torch.randn(2, 13, 8)], path)
    nodes = [node for node in onnx.load(path).graph.node if node.domain == "com.microsoft"]
    assert [node.op_type for node in nodes] == ["MultiHeadAttention"] * 3
    x = torch.randn(3, 13, 8)
    torch.testing.assert_close(computed(path, x), encoder(x), rtol=1e-5, atol=1e-6)
