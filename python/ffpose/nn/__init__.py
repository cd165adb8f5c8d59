"""Layers: the spectral filter as a module, and the parts of the networks built on it."""

from ffpose._internal.choices import FilterKind, NormPlace, PositionKind
from ffpose.nn.filterformer import (
    FILTERS,
    Filterformer,
    FilterformerBlock,
    make_filter,
)
from ffpose.nn.heads import HyperHead
from ffpose.nn.orientation import QuaternionActivation
from ffpose.nn.position import PositionCode
from ffpose.nn.spectral import GlobalFilter, SequenceFilter, SpectralFilter

__all__ = [
    "FILTERS",
    "FilterKind",
    "Filterformer",
    "FilterformerBlock",
    "GlobalFilter",
    "HyperHead",
    "NormPlace",
    "PositionCode",
    "PositionKind",
    "QuaternionActivation",
    "SequenceFilter",
    "SpectralFilter",
    "make_filter",
]
