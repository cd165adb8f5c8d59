"""Self-attention whose scores do not go through memory, in training with dropout too."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.functional import linear, scaled_dot_product_attention

from ffpose._internal.torch_internals import transforms_at_work

LEVELS = 1 << 16
"""Number of values that a score's random number takes; four of them are drawn at a time."""

BLOCK = 1 << 19
"""Number of scores that are processed together: with their copies they fit the caches."""


def dropout_attention(query: Tensor, key: Tensor, value: Tensor, rate: float) -> Tensor:
    """Return ``dropout(softmax(query keyᵀ / √d)) value``, a block of scores at a time.

    Of the scores only the dropped ones are kept for the backward pass, a byte each; the weights are
    computed again (Dao et al., FlashAttention, 2022, Algorithm 4). torch's kernel for CPUs that
    works so knows no dropout: it writes scores, weights and random numbers of all heads.

    ``query`` is ``(B, heads, N, d)``, on the CPU, ``key`` and ``value`` ``(B, heads, M, d)``; half
    precision is computed in float32. ``rate`` is exact to 1 / `LEVELS`.

    Raises:
        ValueError: ``rate`` is not between 0 and 1, or drops everything.
    """
    kept = round((1 - rate) * LEVELS) if 0 <= rate < 1 else 0
    if kept == 0:
        raise ValueError(f"rate: expected at least 0 and less than 1, got {rate}")
    kind = torch.promote_types(query.dtype, torch.float32)
    with torch.autocast("cpu", enabled=False):
        result: Tensor = _DropoutAttention.apply(*(x.to(kind) for x in (query, key, value)), kept)
        return result.to(query.dtype)


class _DropoutAttention(torch.autograd.Function):
    """See `dropout_attention`; a block is of whole heads, ``(heads, N, M)``."""

    @staticmethod
    def forward(ctx: Any, query: Tensor, key: Tensor, value: Tensor, kept: int) -> Tensor:
        scale = query.shape[-1] ** -0.5
        scaled, keys, values = (x.flatten(0, 1) for x in (query * scale, key, value))
        result = query.new_empty(*scaled.shape[:2], values.shape[2])
        mask = query.new_empty(*scaled.shape[:2], keys.shape[1], dtype=torch.bool)
        for part in _blocks(mask):
            weights = _weights(scaled[part], keys[part])
            torch.le(_random(mask[part].shape), kept - 1 - LEVELS // 2, out=mask[part])
            weights *= mask[part].to(weights.dtype)
            torch.bmm(weights, values[part], out=result[part])
        result *= LEVELS / kept
        ctx.save_for_backward(scaled, keys, values, mask, result)
        ctx.kept = kept
        return result.view(*query.shape[:3], value.shape[3])

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, Tensor, Tensor, None]:
        scaled, keys, values, mask, result = ctx.saved_tensors
        lead = gradient.shape[:2]
        gradient = gradient.flatten(0, 1)
        # Of each row of weights with their gradients the softmax's backward pass takes the product.
        products = (gradient * result).sum(-1, keepdim=True)
        gradient = gradient * (LEVELS / ctx.kept)
        of_query, of_key, of_value = map(torch.empty_like, (scaled, keys, values))
        with torch.autocast("cpu", enabled=False):
            for part in _blocks(mask):
                weights = _weights(scaled[part], keys[part])
                factors = mask[part].to(weights.dtype)
                torch.bmm((weights * factors).mT, gradient[part], out=of_value[part])
                scores = torch.bmm(gradient[part], values[part].mT)
                scores.mul_(factors).sub_(products[part]).mul_(weights)
                torch.bmm(scores, keys[part], out=of_query[part])
                torch.bmm(scores.mT, scaled[part], out=of_key[part])
        of_query *= scaled.shape[-1] ** -0.5
        of_query, of_key, of_value = (
            x.view(*lead, *x.shape[1:]) for x in (of_query, of_key, of_value)
        )
        return of_query, of_key, of_value, None


def _weights(scaled: Tensor, keys: Tensor) -> Tensor:
    return torch.bmm(scaled, keys.mT).softmax(-1)


def _blocks(mask: Tensor) -> Iterator[slice]:
    heads = max(1, BLOCK // max(1, mask.shape[1:].numel()))
    for first in range(0, len(mask), heads):
        yield slice(first, first + heads)


def _random(shape: torch.Size) -> Tensor:
    """Draw 16-bit integers, four from each of torch's, which are drawn one after the other."""
    count = shape.numel()
    bits = torch.empty(-(-count // 4), dtype=torch.int64, device="cpu").random_(-(2**63), None)
    return bits.view(torch.int16)[:count].view(shape)


class SelfAttention(nn.Module):
    """Multi-head self-attention (Eq. 4-6); the first ``queries`` tokens attend, all by default.

    ``attention`` holds and initializes the parameters, and its forward would give the same result,
    but in evaluation on CPUs that writes all ``N x N`` scores to memory. This forward uses
    `scaled_dot_product_attention`, which processes the scores in blocks, in training as well. With
    dropout of attention weights torch has no such kernel for CPUs; there `dropout_attention` is,
    which can be differentiated once (twice within `torch.func`, or without dropout).
    """

    def __init__(self, dim: int, heads: int, dropout: float, queries: int | None = None) -> None:
        super().__init__()
        self.attention = nn.MultiheadAttention(dim, heads, dropout=dropout, batch_first=True)
        self.queries = queries

    def forward(self, x: Tensor) -> Tensor:
        """Return ``(B, queries, dim)`` for ``x (B, N, dim)``, or ``(B, N, dim)`` for all."""
        attention = self.attention
        batch, _, dim = x.shape
        weights = attention.in_proj_weight.view(3, dim, dim)
        biases = attention.in_proj_bias.view(3, dim)
        query, key, value = (
            linear(tokens, weights[part], biases[part])
            .view(batch, tokens.shape[1], attention.num_heads, attention.head_dim)
            .transpose(1, 2)
            for part, tokens in enumerate((x[:, : self.queries], x, x))
        )  # each (B, heads, N, dim / heads)
        dropout = attention.dropout if self.training else 0.0
        # On CPUs, unless compiled, which unrolls its loop, or transformed by `torch.func`.
        plain = not (torch.compiler.is_compiling() or transforms_at_work())
        in_blocks = query.device.type == "cpu" and plain
        if dropout > 0 and in_blocks:
            mixed = dropout_attention(query, key, value, dropout)
        else:
            mixed = scaled_dot_product_attention(query, key, value, dropout_p=dropout)
        result: Tensor = attention.out_proj(mixed.transpose(1, 2).flatten(2))
        return result
