"""Regression head: a static multi-layer perceptron plus one with a generated last layer.

Ye et al., Sensors 2023, 23, 8633, section 3.1, mention "a class hyper-network design" without
details; the form here is that of its predecessor HyperPose: the weights of the last layer are
computed from the input vector itself, so that they adapt to each image.
"""

from __future__ import annotations

from torch import Tensor, nn

from ffpose.errors import expect_shape


class HyperHead(nn.Module):
    """Regression from a latent vector ``z``: ``static(z) + W(z) h + b(z)``.

    ``static`` is ``dim -> hidden -> out_features``; ``h = swish(Linear(z))`` has ``mlp_dim``
    entries; ``W(z)`` and ``b(z)`` come from a second perceptron of ``z``, whose last layer is
    initialized to zero, so that at first only the static part contributes.

    Args:
        dim: Size of ``z``.
        out_features: Size of the output.
        hidden: Hidden width of the static perceptron.
        mlp_dim: Hidden width of the generated one: 128 for translation, 256 for orientation
            (Table 1).
    """

    def __init__(
        self, dim: int, out_features: int, *, hidden: int = 1024, mlp_dim: int = 128
    ) -> None:
        super().__init__()
        self.dim, self.out_features = dim, out_features
        self.static = nn.Sequential(
            nn.Linear(dim, hidden), nn.GELU(), nn.Linear(hidden, out_features)
        )
        self.features = nn.Sequential(nn.Linear(dim, mlp_dim), nn.SiLU())
        last = nn.Linear(mlp_dim, out_features * (mlp_dim + 1))
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        self.generator = nn.Sequential(nn.Linear(dim, mlp_dim), nn.SiLU(), last)

    @property
    def bias(self) -> nn.Parameter:
        """Last bias ``(out_features,)`` of the static part, about the output before training."""
        last = self.static[-1]
        assert isinstance(last, nn.Linear)
        return last.bias

    def forward(self, z: Tensor) -> Tensor:
        """Return ``(B, out_features)`` for ``z (B, dim)``.

        Raises:
            ValueError: ``z`` is not ``(B, dim)``.
        """
        expect_shape("z", z, self.dim)
        generated = self.generator(z).unflatten(1, (self.out_features, -1))
        weight, bias = generated[..., :-1], generated[..., -1]  # (B, out, mlp_dim), (B, out)
        adapted = (weight @ self.features(z).unsqueeze(-1)).squeeze(-1)
        result: Tensor = self.static(z) + adapted + bias
        return result
