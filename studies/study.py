"""Definition of an ablation study: a training, and what its variants change in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from ffpose.errors import hint
from ffpose.training.config import TrainConfig

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Config = TypeVar("Config", bound="DataclassInstance")


class Published(NamedTuple):
    """Published figures of a variant: means over a test set, or medians.

    Attributes:
        translation_m: Translation error, meters.
        rotation_deg: Rotation error, degrees.
        latency_ms: Milliseconds an image; None where it is not printed.
    """

    translation_m: float
    rotation_deg: float
    latency_ms: float | None = None


@dataclass(frozen=True)
class Variant:
    """One training of a study.

    Attributes:
        name: Of the variant, and what the folders of its runs begin with.
        about: What it changes, in a few words.
        changes: Fields of the study's training to change: nested, as `TrainConfig` is.
        paper: What a paper prints of it.
    """

    name: str
    about: str
    changes: Mapping[str, Any] = field(default_factory=dict)
    paper: Published | None = None


@dataclass(frozen=True)
class Study:
    """A training and its variants.

    Attributes:
        name: What the command line calls it.
        about: What it asks, in a sentence.
        base: The training that the variants change. ``out`` and ``seed`` are set by each run; a
            relative ``data.root`` lies in the study's folder.
        variants: In the order of the table.
        notes: What the reader of the table should know.
        medians: Whether the paper's numbers are medians; else they are means.

    Raises:
        ValueError: Two variants have one name.
    """

    name: str
    about: str
    base: TrainConfig
    variants: tuple[Variant, ...]
    notes: str = ""
    medians: bool = False

    def __post_init__(self) -> None:
        names = [variant.name for variant in self.variants]
        if len(set(names)) < len(names):
            raise ValueError(f"variants: expected distinct names, got {', '.join(names)}")

    def config(self, variant: Variant) -> TrainConfig:
        """Return the training of a variant.

        Raises:
            ValueError: It changes a field that there is not, or to a value that cannot be.
        """
        return changed(self.base, variant.changes)

    def choose(self, names: Sequence[str]) -> tuple[Variant, ...]:
        """Return the variants of these names, in the study's order; all for no names.

        Raises:
            ValueError: There is none of a name; the message lists the names.
        """
        known = [variant.name for variant in self.variants]
        for name in names:
            if name not in known:
                raise ValueError(f"variants: expected one of {', '.join(known)}, got {name!r}")
        return tuple(each for each in self.variants if not names or each.name in names)


def changed(config: Config, changes: Mapping[str, Any], place: str = "") -> Config:
    """Return a configuration with some fields changed, those of its parts by nested mappings.

    Args:
        config: A dataclass.
        changes: Field name to value; to a mapping where the field is a dataclass or a mapping,
            whose other entries stay.
        place: Dotted name of ``config``, for the error.

    Raises:
        ValueError: A field that there is not, with the most similar that there is.

    Examples:
        >>> from ffpose.training.config import DataConfig
        >>> base = TrainConfig(DataConfig("urso", Path("a")), Path("b"), model_fields={"depth": 2})
        >>> new = changed(base, {"data": {"count": 5}, "model_fields": {"dim": 8}})
        >>> new.data.count, new.model_fields
        (5, {'depth': 2, 'dim': 8})
    """
    known = [field.name for field in fields(config)]
    values = {}
    for name, value in changes.items():
        if name not in known:
            expected = f"expected one of {place}{{{', '.join(known)}}}"
            raise ValueError(f"changes: {expected}, got {name!r}{hint(name, known)}")
        values[name] = _value(getattr(config, name), value, f"{place}{name}")
    return replace(config, **values)


def _value(old: Any, new: Any, place: str) -> Any:
    """Return what a field becomes; JSON brings no tuples and no paths."""
    part = is_dataclass(old) and not isinstance(old, type)
    if (part or isinstance(old, dict)) and not isinstance(new, Mapping):
        raise ValueError(f"{place}: expected a mapping of fields, got {new!r}")
    if part:
        return changed(old, new, f"{place}.")
    if isinstance(old, dict):
        return {**old, **new}
    if isinstance(old, tuple):
        return tuple(new)
    return Path(new) if isinstance(old, Path) else new
