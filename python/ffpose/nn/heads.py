"""The regression head: a fixed multi-layer perceptron and one whose last layer is generated.

Ye et al., Sensors 2023, 23, 8633, section 3.1, name "a class hyper-network design" and leave its
form open; the form here is that of the network it descends from (HyperPose): the weights of the
last layer are computed from the very vector that is regressed, so that they adapt to each image.
"""

from __future__ import annotations

from torch import Tensor, nn


class HyperHead(nn.Module):
    """Regresses a few numbers from a latent vector ``z``: ``static(z) + W(z) h + b(z)``.

    ``static`` is ``dim -> hidden -> out_features``; ``h = swish(Linear(z))`` has ``mlp_dim``
    entries; ``W(z)`` and ``b(z)`` come from a second perceptron of ``z``, whose last layer starts
    at zero: the head begins as the static one, at its scale, and the generated part grows from
    there.

    Args:
        dim: Entries of ``z``.
        out_features: Entries of the result.
        hidden: Width of the static perceptron.
        mlp_dim: Width of the generated one: 128 for translation, 256 for orientation (Table 1).
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
        """The static part's last bias ``(out_features,)``: about the result before training."""
        last = self.static[-1]
        assert isinstance(last, nn.Linear)
        return last.bias

    def forward(self, z: Tensor) -> Tensor:
        """Return ``(B, out_features)`` for ``z (B, dim)``.

        Raises:
            ValueError: ``z`` has another shape.
        """
        if z.dim() != 2 or z.shape[1] != self.dim:
            raise ValueError(f"z: expected shape (B, {self.dim}), got {tuple(z.shape)}")
        generated = self.generator(z).unflatten(1, (self.out_features, -1))
        weight, bias = generated[..., :-1], generated[..., -1]  # (B, out, mlp_dim), (B, out)
        adapted = (weight @ self.features(z).unsqueeze(-1)).squeeze(-1)
        result: Tensor = self.static(z) + adapted + bias
        return result
